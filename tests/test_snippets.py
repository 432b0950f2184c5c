"""Every Python snippet of the README, the guide and docstrings runs, and asserts its own result."""

import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.geometry.mesh import Mesh

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
    found = re.search(
        r"^```toml\n(.*?)^```$", (GUIDE / "scenes.md").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    assert found
    return found[1]


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
