"""Runs every benchmark program, one after the other, each in its own process."""

import argparse
import pathlib
import subprocess
import sys
import tempfile

from tests.benchmarks.measuring import ROOT


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.all", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small trials; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    with tempfile.TemporaryDirectory() as folder:
        # The stores that `precompute` makes give `kernels` real indices; those of a quick trial are too small for that.
        store = pathlib.Path(folder, "bunny_phong-4")
        programs = {
            "precompute": ["--folder", folder],
            "kernels": [] if quick else ["--store", str(store)],
            "reference_images": [],
            "terms_curve": [],
            "factor_error": [],
            "pictures_by_terms": [],
            "shadow_error": [],
            "light_truncation": [],
            "mesh_size": [],
            "large_scenes": [],
            "fit_speed": [],
            "fit_materials": [],
        }
        failed = [name for name, options in programs.items() if not _succeeds(name, options, quick)]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


def _succeeds(name: str, options: list[str], quick: bool) -> bool:
    command = [sys.executable, "-m", f"tests.benchmarks.{name}", *options, *(["--quick"] if quick else [])]
    return subprocess.run(command, cwd=ROOT, check=False).returncode == 0


if __name__ == "__main__":
    main()
