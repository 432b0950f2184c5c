"""A scene of 40 materials whose textures have 40 sizes: loading it, and first pictures with nothing compiled."""

import argparse
import pathlib
import tempfile

import numpy as np
from PIL import Image

from tests.benchmarks.measuring import ROOT, Report
from tests.benchmarks.starts import Case

SCENE = """
[camera]
origin = [0, 0, 8]
target = [0, 0, 0]
fov_y = 45.0
width = 64
height = 64
[environment]
file = "sky.exr"
[[mesh]]
file = "squares.obj"
"""


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.many_textures", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="4 small textures; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    sizes = [20 + 7 * i for i in range(4)] if quick else [200 + 20 * i for i in range(40)]
    parameters = (
        f"{len(sizes)} PNGs of {sizes[0]} to {sizes[-1]} rows, a square each; pictures of 64² pixels; seconds, each "
        "picture of a new process with an empty folder of compiled programs, and of the same again"
    )
    with (
        Report("many_textures", "Textures of many sizes", parameters, not quick) as report,
        tempfile.TemporaryDirectory() as name,
    ):
        folder = pathlib.Path(name)
        write_scene(folder, sizes)
        rows = []
        for lighting, *dials in (("prefiltered",), ("transport", "--resolution", "8"), ("adaptive",)):
            arguments = ["render", str(folder / "scene.toml"), "--lighting", lighting, *dials, "--error-samples", "0"]
            case = Case(ROOT, folder / lighting, arguments, lighting == "transport")
            first, second = case.run(), case.run()
            figures = first.wall, first.compiling, first.programs, second.wall
            rows.append([lighting, *(f"{figure:.1f}" if isinstance(figure, float) else figure for figure in figures)])
        report.text(f"Loading the scene: {load_seconds(folder):.1f} s (reach: 6 s).")
        report.table(["lighting", "first picture", "of it compiling", "programs", "again"], rows)
        report.speed()


def write_scene(folder: pathlib.Path, sizes: list[int]):
    """Squares in a row each with a texture of its own."""
    from jaxrelight.images import write_image

    mesh, library = ["mtllib squares.mtl"], []
    for number, size in enumerate(sizes):
        pattern = np.random.default_rng(number).integers(0, 256, (8, 8, 3), dtype=np.uint8)
        Image.fromarray(pattern).resize((size, size + 7)).save(folder / f"{number}.png")
        x, y = number % 8 - 4, number // 8 - 2.5
        for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
            mesh += [f"v {x + u} {y + v} 0", f"vt {u} {v}"]
        corners = " ".join(f"{i}/{i}" for i in range(4 * number + 1, 4 * number + 5))
        mesh += [f"usemtl m{number}", f"f {corners}"]
        library += [f"newmtl m{number}", "Kd 1 1 1", f"map_Kd {number}.png"]
    (folder / "squares.obj").write_text("\n".join(mesh))
    (folder / "squares.mtl").write_text("\n".join(library))
    (folder / "scene.toml").write_text(SCENE)
    write_image(folder / "sky.exr", np.ones((4, 8, 3), np.float32))


def load_seconds(folder: pathlib.Path) -> float:
    """Of loading, by a process that has nothing else compiled or imported of the scene's."""
    import time

    from jaxrelight import load_scene

    start = time.perf_counter()
    load_scene(folder / "scene.toml")
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
