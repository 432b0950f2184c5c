"""Runs every benchmark program, one after the other, each in its own process."""

import argparse
import pathlib
import subprocess
import sys
import tempfile

from tests.benchmarks.measuring import ROOT

PROGRAMS = (
    "precompute",
    "adaptive_rays",
    "coarse_meshes",
    "chosen_resolution",
    "scene_needs",
    "break_even",
    "kernels",
    "reference_images",
    "terms_curve",
    "filtered_visibility",
    "filtered_speed",
    "glossy_bounces",
    "picture_error",
    "factor_error",
    "pictures_by_terms",
    "shadow_error",
    "light_truncation",
    "mesh_size",
    "large_scenes",
    "large_skies",
    "terminator",
    "second_render",
    "starts",
    "many_textures",
    "quantised_rows",
    "clusters",
    "changed_light",
    "interreflections",
    "operators",
    "indirect",
    "light_moves",
    "gradient_cost",
    "inverse_lamps",
    "inverse_light",
    "inverse_materials",
    "adaptive",
    "adaptive_parts",
    "adaptive_promise",
    "fit_speed",
    "fit_materials",
    "fit_measured",
    "fit_sbrdf",
    "measured_material",
    "measured_vertices",
    "prefiltered",
    "sbrdf_frames",
    "sbrdf_sampling",
    "sbrdf_storage",
    "sbrdf_vertices",
    "composed_cow",
)


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.all", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small trials; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    with tempfile.TemporaryDirectory() as folder:
        options = {"precompute": ["--folder", folder]}
        if not quick:
            # Real indices from what `precompute` makes; a quick trial's are too few.
            options["kernels"] = ["--store", str(pathlib.Path(folder, "bunny_phong-4"))]
        failed = [name for name in PROGRAMS if not _succeeds(name, options.get(name, []), quick)]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


def _succeeds(name: str, options: list[str], quick: bool) -> bool:
    command = [sys.executable, "-m", f"tests.benchmarks.{name}", *options, *(["--quick"] if quick else [])]
    return subprocess.run(command, cwd=ROOT, check=False).returncode == 0


if __name__ == "__main__":
    main()
