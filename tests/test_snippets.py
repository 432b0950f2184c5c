"""Every Python snippet of the README, the guide and docstrings runs, and asserts its own result."""

import ast
import inspect
import pathlib
import re
import subprocess
import sys
import textwrap
from typing import Any

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.geometry.mesh import Mesh
from tests.scenes import ball_over_floor

ROOT = pathlib.Path(__file__).parents[1]
GUIDE = ROOT / "notebooks" / "guide"
PAGES = [ROOT / "README.md", *sorted(GUIDE.glob("*.md"))]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
WITH_SNIPPETS = [page for page in PAGES if BLOCK.search(page.read_text(encoding="utf-8"))]


@pytest.fixture
def folder(tmp_path, monkeypatch) -> pathlib.Path:
    """A current folder with the files that snippets read, and a cache folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    sky = np.random.default_rng(0).uniform(0.2, 1, (8, 16, 3)).astype(np.float32)
    for name in ("night.hdr", "sky.exr"):
        jr.write_image(tmp_path / name, sky)
    _write_obj(tmp_path / "bunny.obj", jr.sphere(0.5, 8))
    scene = _scene_of_the_guide().replace('"bunny.ply"          #', '"bunny.obj"          #')
    scene = scene.replace("512", "12").replace("resolution = 128", "resolution = 4")
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    return tmp_path


def _write_obj(path: pathlib.Path, mesh: Mesh) -> None:
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    path.write_text("\n".join(lines) + "\n")


def _scene_of_the_guide() -> str:
    match = re.search(
        r"^```toml\n(.*?)^```$", (GUIDE / "scenes.md").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    assert match
    return match[1]


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_SNIPPETS, ids=lambda page: page.name)
def test_snippets_run(page: pathlib.Path, folder: pathlib.Path):
    """The blocks of a page, one after the other, as a reader would paste them."""
    text = page.read_text(encoding="utf-8").replace("bunny.ply", "bunny.obj")
    code, names = "\n".join(BLOCK.findall(text)), {"__name__": "snippets"}
    if page.name == "README.md":
        # Fewer rays than a reader would cast.
        code = code.replace('receivers="vertices"', 'receivers="vertices", resolution=8')
    sys.modules["snippets"] = type(sys)("snippets")
    exec(compile(code, str(page), "exec"), names)
    assert "assert" in code or page.name == "README.md"
    if page.name == "README.md":
        picture = jr.read_image(folder / "bunny.png")
        assert picture.shape == (512, 512, 3)
        assert 0.02 < picture[..., :3].mean() < 1


def _snippet_of(thing: object) -> str:
    """The indented lines of a docstring."""
    lines = (inspect.getdoc(thing) or "").split("\n\n")[1].splitlines()
    assert all(line.startswith("    ") for line in lines)
    return textwrap.dedent("\n".join(lines))


def test_snippets_of_docstrings_run():
    """Those of `Relighter` and `LightLayers`; a search says that no other class or module has one."""
    camera = jr.Camera((0.3, 1.4, 2.2), (0, 0.2, 0), fov_y=45, width=12, height=10)
    lamps = [jr.point([1, 2, 1], 3), jr.point([-1, 2, 0], 2), jr.directional([0, -1, 0.2], 1)]
    scene = ball_over_floor(jr.phong(0.4, 0.2, 8), camera, quads=(1, 8))
    relighter = jr.prepare(scene, jr.Prefiltered(map_rows=32, receiver_tolerance=0))
    names = {"jr": jr, "relighter": relighter, "camera": camera, "lights": lamps, "LightLayers": jr.LightLayers}
    exec(_snippet_of(jr.Relighter), names)
    image: Any = names["image"]
    np.testing.assert_allclose(image.radiance, relighter.picture(lamps)[..., :3], rtol=1e-5, atol=1e-6)
    exec(_snippet_of(jr.LightLayers), names)
    moved: Any = [jr.point([1, 2, 0], 5 * np.array([1, 0.9, 0.8])), jr.directional([0, -1, 0.2], 2)]
    np.testing.assert_allclose(names["picture"], relighter.picture(moved)[..., :3], rtol=1e-5, atol=1e-6)
    pattern = re.compile(r"^ {4,}[a-z_]+ = (relighter|jr|LightLayers|layers)\b.*\n(?! *\S+ = )", re.MULTILINE)
    files = {
        path.name
        for root in ("jaxrelight", "fitting")
        for path in (ROOT / root).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.Module)
        if pattern.search(ast.get_docstring(node) or "")
    }
    assert files == {"contract.py", "light_layers.py"}


def test_scene_of_the_guide_loads(folder: pathlib.Path):
    scene = jr.load_scene(folder / "scene.toml")
    assert set(scene.materials) == {"lacquer", "floor"}
    assert scene.lights.environment is not None
    assert len(scene.lights.local) == 1


def test_links_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_dials_are_those_of_the_classes():
    """`dials.md` is what `write_dials.py` makes of the classes."""
    done = subprocess.run([sys.executable, str(GUIDE / "write_dials.py"), "--check"], cwd=ROOT, check=False)
    assert done.returncode == 0, "run python notebooks/guide/write_dials.py"


def test_readme_is_short():
    words = (ROOT / "README.md").read_text(encoding="utf-8").split()
    assert len(words) <= 1300
