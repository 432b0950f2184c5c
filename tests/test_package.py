"""The public surface, what importing costs, and which modules may know which."""

import ast
import functools
import graphlib
import importlib.metadata
import pathlib
import re
import subprocess
import sys

import pytest

import jaxrelight
from jaxrelight import inverse

ROOT = pathlib.Path(jaxrelight.__file__).parent

# From the bottom up: a module imports from folders above its own in this list, and from beside itself. Modules that lie
# in no folder are named here as folders are.
FOLDERS = (
    "late_names",
    "errors",
    "methods",
    "compilation_cache",
    "command_line",
    "progress",
    "timing",
    "numerics",
    "files",
    "images",
    "operators",
    "basis",
    "geometry",
    "brdf",
    "lights",
    "gather",
    "transport",
    "scene",
    "precomputation",
    "lighting",
    "inverse",
    "gradients",
    "commands",
    "cli",
)

# Beside the version.
PUBLIC = {
    "Adaptive",
    "Brdf",
    "Camera",
    "Clustered",
    "Component",
    "Dense",
    "Environment",
    "Factoring",
    "Image",
    "Incident",
    "Indirect",
    "InputError",
    "Light",
    "LightLayers",
    "Lights",
    "LobeSum",
    "Material",
    "Measurement",
    "Mesh",
    "Operator",
    "Part",
    "Prefiltered",
    "Punctual",
    "Relighter",
    "Scene",
    "Sensor",
    "SparseRows",
    "Stacked",
    "Texture",
    "Transport",
    "VertexColours",
    "area",
    "as_lineax",
    "ashikhmin_shirley",
    "auto_exposure",
    "box",
    "constant",
    "directional",
    "environment",
    "even_sky",
    "factor",
    "image_error",
    "keep_compilations",
    "lambert",
    "load_brdf",
    "load_environment",
    "load_lights",
    "load_mesh",
    "load_scene",
    "lobe",
    "lobe_sum",
    "measure",
    "normalized",
    "open_store",
    "phong",
    "plane",
    "point",
    "prepare",
    "projector",
    "read_image",
    "scene_of_mesh",
    "sensor_grid",
    "shaped",
    "sharded",
    "sky_of",
    "sphere",
    "spot",
    "subdivided",
    "textured_lambert",
    "textured_phong",
    "tone_map",
    "transformed",
    "with_back",
    "write_image",
}


@functools.cache
def _modules() -> dict[str, ast.Module]:
    """Every module of the package, parsed, by its name without the package's."""
    modules = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        modules[".".join(part for part in parts if part != "__init__")] = ast.parse(path.read_text(encoding="utf-8"))
    return modules


def _imported(tree: ast.Module) -> set[str]:
    """Everything that is imported anywhere in a module, with its full name; `from a import b` gives a.b."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute here"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@functools.cache
def _graph() -> dict[str, set[str]]:
    modules = _modules()
    graph = {}
    for name, tree in modules.items():
        graph[name] = set()
        for imported in _imported(tree):
            head, _, rest = imported.partition(".")
            if head != "jaxrelight":
                continue
            while rest not in modules:
                rest = rest.rpartition(".")[0]
            graph[name].add(rest)
    return graph


def test_public_names_are_those_documented():
    """The package's page lists each of them once, behind the topic that it belongs to."""
    assert set(jaxrelight.__all__) == {*PUBLIC, "inverse", "__version__"} == set(dir(jaxrelight))
    assert jaxrelight.__doc__ is not None
    listed = [line[16:] for line in jaxrelight.__doc__.splitlines() if line.startswith("    ")]
    listed = [line for line in listed if not line.startswith("inverse.")]
    assert sorted(re.findall(r"\w+", " ".join(listed))) == sorted({*jaxrelight.__all__} - {"inverse"})


def test_public_names_of_inverse_problems():
    """Its page lists each of them once, they load, and the package's own page names the verbs."""
    assert inverse.__doc__ is not None
    assert jaxrelight.__doc__ is not None
    listed = [line[16:] for line in inverse.__doc__.splitlines() if line.startswith("    ")]
    assert sorted(re.findall(r"\w+", " ".join(listed))) == sorted(inverse.__all__) == sorted(dir(inverse))
    assert all(getattr(inverse, name).__name__ == name for name in inverse.__all__)
    assert all(f"inverse.{name}" in jaxrelight.__doc__ for name in inverse.__all__ if name.islower())
    with pytest.raises(AttributeError, match="has no attribute 'light'"):
        _ = inverse.light


def test_version_is_that_of_the_installed_package():
    assert jaxrelight.__version__ == importlib.metadata.version("jaxrelight")


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_public_name_loads(name: str):
    member = getattr(jaxrelight, name)
    assert callable(member)
    assert member.__doc__
    assert member.__name__ == name


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'bake'"):
        _ = jaxrelight.bake


@pytest.mark.parametrize("module", ["jaxrelight", "jaxrelight.cli", "fitting.cli"])
def test_import_is_light(module: str):
    """`--help` must not wait for JAX, nor for anything that reads files or traces rays."""
    heavy = "jax", "numpy", "scipy", "equinox", "lineax", "trimesh", "zstandard", "OpenEXR", "PIL", "embreex", "rich"
    code = f"import {module}, sys; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT.parent)
    assert done.stdout.strip() == "[]"


def _lacking(tree: ast.Module) -> list[str]:
    """Public functions, and public methods, of which a parameter or the result has no annotation."""
    lacking = []

    def search(node: ast.AST, inside: str | None) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef):
                search(child, child.name)
            elif isinstance(child, ast.FunctionDef):
                if child.name.startswith("_") and not child.name.endswith("__"):
                    continue
                given = child.args
                parameters = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
                decorators = {one.id for one in child.decorator_list if isinstance(one, ast.Name)}
                if inside and "staticmethod" not in decorators:
                    parameters = parameters[1:]
                missing = [one.arg for one in parameters if one is not None and one.annotation is None]
                if child.returns is None and child.name != "__init__":
                    missing.append("result")
                lacking.extend(f"{child.name}: {name}" for name in missing)
            elif not isinstance(child, ast.Lambda):
                search(child, inside)

    search(tree, None)
    return lacking


@pytest.mark.parametrize("package", ["jaxrelight", "fitting"])
def test_public_functions_are_annotated(package: str):
    paths = sorted((ROOT.parent / package).rglob("*.py"))
    assert paths
    lacking = {path.name: _lacking(ast.parse(path.read_text(encoding="utf-8"))) for path in paths}
    assert not {name: names for name, names in lacking.items() if names}


def test_a_missing_annotation_is_found():
    source = "def f(a, *, b: int): ...\nclass C:\n    def g(self, *c) -> None: ...\n    def _h(self, d): ..."
    assert _lacking(ast.parse(source)) == ["f: a", "f: result", "g: c"]


def test_embree_has_one_home():
    users = {
        name for name, tree in _modules().items() if any(i.partition(".")[0] == "embreex" for i in _imported(tree))
    }
    assert users == {"geometry.tracer"}


def test_fitting_is_not_needed():
    """But by commands, which call it."""
    for name, tree in _modules().items():
        if name.partition(".")[0] == "commands":
            continue
        assert not any(i.partition(".")[0] in ("fitting", "tests") for i in _imported(tree)), name


def test_modules_import_without_a_cycle():
    graphlib.TopologicalSorter(_graph()).prepare()


def test_folders_import_without_a_cycle():
    """Every folder has its place in `FOLDERS`, and imports from those before it alone."""
    graph = _graph()
    assert graph.pop("") == {"late_names"}, "the package's page loads its names when they are used"
    folder = {module: module.partition(".")[0] for module in graph}
    assert set(folder.values()) == set(FOLDERS)
    upward = [
        f"{module} imports {other}"
        for module, imported in graph.items()
        for other in imported - {""}
        if FOLDERS.index(folder[other]) > FOLDERS.index(folder[module])
    ]
    assert not upward
