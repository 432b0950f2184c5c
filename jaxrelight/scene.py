"""Scenes: meshes, materials, a camera and an environment, from TOML or from code."""

import dataclasses
import difflib
import pathlib
import tomllib
from collections.abc import Mapping, Sequence

import numpy as np

from jaxrelight.brdf import lobes
from jaxrelight.brdf.contract import Brdf
from jaxrelight.errors import InputError
from jaxrelight.geometry import mesh as meshes
from jaxrelight.geometry import primitives
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.lights.environment import Environment, load_environment


@dataclasses.dataclass(frozen=True)
class Part:
    """One mesh and the name of its material."""

    mesh: Mesh
    material: str
    name: str = "mesh"


@dataclasses.dataclass(frozen=True)
class Scene:
    """What is lit and seen.

    Attributes:
        parts: the meshes.
        materials: a BRDF by name.
        camera: the view, unless another is asked for.
        environment: the light, unless another is asked for.
        name: what messages call it.
        terms: factors of a material, by its name, where it is to have another number than the settings say.
    """

    parts: Sequence[Part]
    materials: Mapping[str, Brdf]
    camera: Camera
    environment: Environment | None = None
    name: str = "scene"
    terms: Mapping[str, int] = dataclasses.field(default_factory=dict)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was mended while the scene was read, one line each."""
        lines = [f"{part.name}: {note}" for part in self.parts for note in part.mesh.notes]
        return (*lines, *(self.environment.notes if self.environment else ()))


def load_scene(path: str | pathlib.Path, *, zero_nonfinite: bool = False) -> Scene:
    """Reads a scene file; paths in it are relative to it.

    Raises:
        InputError: for anything unknown, missing, of the wrong shape or not finite, by name.
    """
    path = pathlib.Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise InputError(f"{path}: cannot be read as a scene: {reason}") from None
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not a TOML file: {error}") from None
    root = _Table(content, str(path))
    if root.has("light"):
        raise InputError(f"{path}: [[light]] is not supported yet; remove the lights and give an [environment]")
    camera = _camera(root.table("camera"))
    environment = (
        _environment(root.table("environment"), path.parent, zero_nonfinite) if root.has("environment") else None
    )
    named = root.table("material")
    tables = {name: named.table(name) for name in named.names()}
    terms = {name: _terms(table) for name, table in tables.items() if table.has("terms")}
    materials = {name: _material(table) for name, table in tables.items()}
    parts = tuple(_part(table, path.parent, materials) for table in root.tables("mesh"))
    root.finish()
    if not parts:
        raise InputError(f"{path}: the scene has no [[mesh]]")
    return Scene(parts, materials, camera, environment, path.stem, terms)


class _Table:
    """A TOML table that is read key by key; what is left at the end was misspelt or is not supported."""

    def __init__(self, content, where: str):
        if not isinstance(content, dict):
            raise InputError(f"{where} must be a table")
        self._content, self.where, self._asked = content, where, set()

    def has(self, key: str) -> bool:
        self._asked.add(key)
        return key in self._content

    def names(self) -> list[str]:
        return list(self._content)

    def get(self, key: str, *default):
        if self.has(key):
            return self._content[key]
        if default:
            return default[0]
        unread = [name for name in self._content if name not in self._asked]
        close = difflib.get_close_matches(key, unread, n=1)
        fault = f"'{close[0]}' is not known; did you mean '{key}'?" if close else f"'{key}' is missing"
        raise InputError(f"{self.where}: {fault}")

    def table(self, key: str) -> "_Table":
        return _Table(self.get(key), f"{self.where}: [{key}]")

    def tables(self, key: str) -> list["_Table"]:
        entries = self.get(key, [])
        if not isinstance(entries, list):
            raise InputError(f"{self.where}: '{key}' must be written as [[{key}]]")
        return [_Table(entry, f"{self.where}: [[{key}]] number {i + 1}") for i, entry in enumerate(entries)]

    def text(self, key: str, *default) -> str:
        value = self.get(key, *default)
        if not isinstance(value, str):
            raise InputError(f"{self.where}: '{key}' must be text, not {value!r}")
        return value

    def number(self, key: str, *default) -> float:
        return float(self.array(key, (), *default))

    def whole(self, key: str, *default) -> int:
        value = self.get(key, *default)
        if not isinstance(value, int) or isinstance(value, bool):
            raise InputError(f"{self.where}: '{key}' must be a whole number, not {value!r}")
        return value

    def array(self, key: str, shape: tuple[int, ...], *default) -> np.ndarray:
        """Numbers of a given shape."""
        return self._numbers(key, [shape], *default)

    def channels(self, key: str, *default) -> np.ndarray:
        """One number, or one for each channel."""
        return self._numbers(key, [(), (3,)], *default)

    def _numbers(self, key, shapes, *default):
        value = self.get(key, *default)
        try:
            array = np.asarray(value, float)
            plain = all(type(item) in (int, float) for item in np.asarray(value, object).ravel())
        except (TypeError, ValueError, OverflowError):
            array, plain = None, False
        if array is None or not plain or array.shape not in shapes:
            wanted = " or ".join(
                "a number" if not shape else " × ".join(map(str, shape)) + " numbers" for shape in shapes
            )
            raise InputError(f"{self.where}: '{key}' must be {wanted}, not {value!r}")
        if not (np.abs(array) < np.finfo(np.float32).max).all():
            raise InputError(f"{self.where}: '{key}' must be finite, also as float32, not {value!r}")
        return array

    def finish(self):
        self._suggest_unknown()

    def _suggest_unknown(self):
        for key in self._content:
            if key not in self._asked:
                close = difflib.get_close_matches(key, self._asked, n=1)
                hint = f"; did you mean '{close[0]}'?" if close else f"; known are {', '.join(sorted(self._asked))}"
                raise InputError(f"{self.where}: '{key}' is not known{hint}")


def _camera(table: _Table) -> Camera:
    values = {
        "origin": tuple(table.array("origin", (3,))),
        "target": tuple(table.array("target", (3,))),
        "up": tuple(table.array("up", (3,), (0.0, 1.0, 0.0))),
        "fov_y": table.number("fov_y", Camera.fov_y),
        "width": table.whole("width", Camera.width),
        "height": table.whole("height", Camera.height),
    }
    table.finish()
    try:
        return Camera(**values)
    except InputError as error:
        raise _within(table, error) from None


def _environment(table: _Table, folder: pathlib.Path, zero_nonfinite: bool) -> Environment:
    file, rotate_y, scale = table.text("file"), table.number("rotate_y", 0.0), table.number("scale", 1.0)
    layout = table.text("layout", "auto")
    table.finish()
    try:
        return load_environment(folder / file, rotate_y, scale, layout=layout, zero_nonfinite=zero_nonfinite)
    except InputError as error:
        raise _within(table, error) from None


def _part(table: _Table, folder: pathlib.Path, materials: Mapping[str, Brdf]) -> Part:
    if table.has("file") == table.has("primitive"):
        raise InputError(f"{table.where}: give either 'file' or 'primitive'")
    name = table.text("file", "") or table.text("primitive")
    try:
        mesh = meshes.load_mesh(folder / name) if table.has("file") else _primitive(table)
        if table.has("normalize"):
            mesh = meshes.normalized(mesh, table.number("normalize"))
        if table.has("transform"):
            mesh = meshes.transformed(mesh, table.array("transform", (4, 4)))
    except InputError as error:
        raise _within(table, error) from None
    for key, what in (
        ("materials", "materials by part"),
        ("two_sided", "two-sided meshes"),
        ("tangents", "UV tangents"),
    ):
        if table.has(key):
            raise InputError(f"{table.where}: '{key}': {what} are not supported yet; remove the key")
    material = table.text("material")
    if material not in materials:
        close = difflib.get_close_matches(material, materials, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        raise InputError(f"{table.where}: there is no [material.{material}]{hint}")
    table.finish()
    return Part(mesh, material, pathlib.PurePath(name).name)


def _primitive(table: _Table) -> Mesh:
    kind = table.text("primitive")
    if kind == "plane":
        return primitives.plane(tuple(table.array("size", (2,), (1, 1))), table.whole("resolution", 64))
    if kind == "sphere":
        return primitives.sphere(table.number("radius", 0.5), table.whole("resolution", 64))
    if kind == "box":
        return primitives.box(tuple(table.array("size", (3,), (1, 1, 1))), table.whole("resolution", 16))
    raise InputError(f"{table.where}: primitive '{kind}' is not known; known are plane, sphere, box")


def _material(table: _Table) -> Brdf:
    kind = table.text("type")
    try:
        if kind == "lambert":
            if isinstance(table.get("albedo"), str):
                raise InputError("'albedo' as an image is not supported yet; give a colour")
            brdf = lobes.lambert(_not_negative(table, "albedo"))
        elif kind == "phong":
            brdf = lobes.phong(
                _not_negative(table, "diffuse"), _not_negative(table, "specular"), _not_negative(table, "exponent")
            )
        elif kind == "lafortune":
            made = [_lafortune_lobe(lobe) for lobe in table.tables("lobes")]
            brdf = lobes.lobe_sum(_not_negative(table, "diffuse"), made)
        elif kind in ("ashikhmin_shirley", "measured", "fitted", "sbrdf"):
            raise InputError(f"type '{kind}' is not supported yet; use lambert, phong or lafortune")
        else:
            raise InputError(f"type '{kind}' is not known; known are lambert, phong, lafortune")
    except InputError as error:
        raise _within(table, error) from None
    if table.has("normal_map"):
        raise InputError(f"{table.where}: 'normal_map' is not supported yet; remove it")
    table.finish()
    return brdf


def _within(table: _Table, error: InputError) -> InputError:
    """The error, told with the place in the scene file that it comes from."""
    message = str(error)
    return InputError(message if message.startswith(table.where) else f"{table.where}: {message}")


def _terms(table: _Table) -> int:
    terms = table.whole("terms")
    if terms < 1:
        raise InputError(f"{table.where}: 'terms' must be at least 1, not {terms}")
    return terms


def _not_negative(table: _Table, key: str) -> np.ndarray:
    value = table.channels(key)
    if (value < 0).any():
        raise InputError(f"{table.where}: '{key}' must not be negative")
    return value


def _lafortune_lobe(table: _Table):
    C = table._numbers("C", [(3,), (3, 3)])
    factors = {key: _not_negative(table, key) for key in ("specular", "peak") if table.has(key)}
    made = lobes.lobe(C, _not_negative(table, "exponent"), **factors)
    table.finish()
    return made
