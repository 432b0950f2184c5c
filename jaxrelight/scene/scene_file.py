"""Scene files: TOML that names meshes, materials, lights and a camera; `notebooks/guide/scenes.md` lists the keys."""

import dataclasses
import difflib
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxrelight.brdf import lobes
from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factoring import Factoring
from jaxrelight.brdf.files import load_brdf
from jaxrelight.brdf.files.fitted import read_fitted, read_lobes
from jaxrelight.brdf.files.sbrdf import read_sbrdf, spatial
from jaxrelight.brdf.material import Material, as_material, textured_lambert, textured_phong
from jaxrelight.brdf.separable import Separable
from jaxrelight.brdf.texture import Texture, constant
from jaxrelight.errors import InputError
from jaxrelight.files.toml_table import Table, read_toml
from jaxrelight.geometry import mesh as meshes
from jaxrelight.geometry import primitives
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.file_lights import Surroundings
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.geometry.subdivision import subdivided
from jaxrelight.lights.environment import Environment, load_environment
from jaxrelight.lights.lights import Lights
from jaxrelight.lights.local import Light
from jaxrelight.scene.lights import read_light
from jaxrelight.scene.materials import from_file, made_light, read_texture, weighted
from jaxrelight.scene.mesh_placement import UpAxis, placed
from jaxrelight.scene.scene import Part, Scene
from jaxrelight.scene.sensors import read_sensors
from jaxrelight.scene.surroundings import file_camera, file_lights

# Keys that say how a material becomes factors, and the types of materials that are not mixtures.
_FACTORING = "terms", "terms_error", "form", "parametrisation"
# In 'materials', the key of all parts of a file that are not named.
_OTHERS = "*"
_TYPES = "lambert, phong, lafortune, ashikhmin_shirley, measured, fitted, sbrdf"


def load_scene(path: str | pathlib.Path, *, zero_nonfinite: bool = False, up: UpAxis = "y") -> Scene:
    """Reads a scene file; paths in it are relative to it.

    Args:
        path: the file.
        zero_nonfinite: set NaN and infinite pixels of the environment to 0 instead of refusing it.
        up: the upward axis of mesh files, "y" or "z", where a [[mesh]] does not say.

    Raises:
        InputError: for anything unknown, missing, of the wrong shape or not finite, by name.
    """
    path = pathlib.Path(path)
    root = read_toml(path, "a scene")
    # A mesh file may bring one.
    camera = None if root.has("mesh") and not root.has("camera") else _camera(root.table("camera"))
    environment = (
        _environment(root.table("environment"), path.parent, zero_nonfinite) if root.has("environment") else None
    )
    lights = tuple(read_light(table, path.parent) for table in root.tables("light"))
    sensors = read_sensors(root)
    named = root.table("material", {})  # mesh files may bring all that is needed
    tables = {name: named.table(name) for name in named.names()}
    factors = {name: _factoring(table) for name, table in tables.items() if _has_any(table, _FACTORING)}
    reflections = {name: table.text("reflection") for name, table in tables.items() if table.has("reflection")}
    materials: dict[str, Brdf | Material] = {}
    mixtures, assumptions = {}, []
    for name, table in tables.items():
        if table.has("type") and table.text("type") == "mixture":
            mixtures[name] = table
        else:
            materials[name], notes = _material(table, path.parent)
            assumptions += [f"material {name}: {note}" for note in notes]
    plain = dict(materials)
    for name, table in mixtures.items():
        materials[name] = _mixture(table, path.parent, plain)
    parts = []
    for name, surface in materials.items():
        if (albedo := made_light(surface)) > 1.01:
            assumptions.append(f"[material.{name}]: reflects {albedo:.3g} times the light it gets; lower its colours")
    surroundings: list[tuple[str, Surroundings]] = []
    for table in root.tables("mesh"):
        mesh_parts, mesh_materials, notes, around = _parts(table, path.parent, materials, up)
        surroundings.append((pathlib.PurePath(table.text("file")).name if table.has("file") else "", around))
        parts += mesh_parts
        materials |= mesh_materials
        assumptions += notes
    root.finish()
    if not parts:
        raise InputError(f"{path}: the scene has no [[mesh]]; add one")
    for file, around in surroundings:
        more, notes = file_lights(file, around.lights, wanted=not root.has("light"))
        lights, assumptions = (*lights, *more), [*assumptions, *notes]
    frame = meshes.joint_bounds([part.mesh for part in parts])
    of_file, notes = file_camera(surroundings, frame, wanted=camera is None)
    camera, assumptions = camera or of_file, [*assumptions, *notes]
    if camera is None:
        camera = _camera(root.table("camera"))  # which tells that there is none
    lights = Lights(environment, lights)
    scene = Scene(parts, materials, camera, lights, path.stem, factors, tuple(assumptions), reflections, sensors)
    return scene.with_plain_materials()


def load_lights(path: str | pathlib.Path) -> tuple[Light, ...]:
    """Reads the [[light]] of a scene file, or of one that has nothing else.

    Raises:
        InputError: as `load_scene` does, or if there is none.
    """
    path = pathlib.Path(path)
    lights = tuple(read_light(table, path.parent) for table in read_toml(path, "a scene").tables("light"))
    if not lights:
        raise InputError(f"{path}: has no [[light]]; add one")
    return lights


def load_camera(path: str | pathlib.Path) -> Camera:
    """Reads the [camera] of a scene file, or of one that has nothing else.

    Raises:
        InputError: as `load_scene` does, or if there is none.
    """
    return _camera(read_toml(pathlib.Path(path), "a scene").table("camera"))


def _camera(table: Table) -> Camera:
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
        raise table.within(error) from None


def _environment(table: Table, folder: pathlib.Path, zero_nonfinite: bool) -> Environment:
    file, rotate_y, scale = table.text("file"), table.number("rotate_y", 0.0), table.number("scale", 1.0)
    layout = table.text("layout", "auto")
    table.finish()
    try:
        return load_environment(folder / file, rotate_y, scale, layout=layout, zero_nonfinite=zero_nonfinite)
    except InputError as error:
        raise table.within(error) from None


def _parts(
    table: Table, folder: pathlib.Path, materials: Mapping[str, Brdf | Material], up: UpAxis
) -> tuple[list[Part], dict[str, Brdf | Material], list[str], Surroundings]:
    """The parts of one [[mesh]], the materials that its file brings, what was assumed, and its lights and cameras."""
    if table.has("file") == table.has("primitive"):
        raise InputError(f"{table.where}: give either 'file' or 'primitive'")
    name = table.text("file" if table.has("file") else "primitive")
    short = pathlib.PurePath(name).name
    one_material = table.has("material") or table.has("primitive")
    chosen = table.table("materials") if table.has("materials") else None
    if chosen and one_material:
        raise InputError(f"{table.where}: give either 'material' for all of it or 'materials' by part")

    crease_angle = table.number("crease_angle") if table.has("crease_angle") else None
    if crease_angle is not None and table.has("primitive"):
        raise InputError(f"{table.where}: crease_angle is for files; primitives have normals")

    def known(owner: Table, key: str) -> str:
        material = owner.text(key)
        if material not in materials:
            close = difflib.get_close_matches(material, materials, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise InputError(f"{owner.where}: there is no [material.{material}]{hint}")
        return material

    around = Surroundings()
    try:
        if table.has("primitive"):
            read = [meshes.MeshPart(_primitive(table), short, None)]
        else:
            file = meshes.load_file(folder / name, crease_angle)
            read = [meshes.MeshPart(file.mesh, short, None)] if one_material else file.parts
            around = file.surroundings
        read, matrix = placed(table, read, up)
        read, around = _finished(table, read), around.moved(matrix)
    except InputError as error:
        raise table.within(error) from None
    if one_material:
        parts = [Part(part.mesh, known(table, "material"), short) for part in read]
        table.finish()
        return parts, {}, [], around
    overridden = {}
    if chosen:
        default = known(chosen, _OTHERS) if chosen.has(_OTHERS) else None
        for part in read:
            own = known(chosen, part.name) if chosen.has(part.name) else default
            overridden |= {part.name: own} if own else {}
        chosen.finish()
    table.finish()
    # Files of one name in several folders keep their materials apart.
    taken = any(other.startswith(f"{short}:") for other in materials)
    return *file_parts(name if taken else short, read, overridden), around


def file_parts(
    file: str, read: Sequence[meshes.MeshPart], overridden: Mapping[str, str]
) -> tuple[list[Part], dict[str, Brdf | Material], list[str]]:
    """Parts of a mesh file with its own materials, save those that are overridden by name."""
    parts, materials, notes, grey = [], {}, [], []
    for part in read:
        material = overridden.get(part.name)
        if material is None:
            material = f"{file}:{part.name}"
            materials[material], lines = from_file(part.material, part.uv_sets, coloured=part.mesh.colours is not None)
            notes += [f"{material}: {line}" for line in lines]
            grey += [] if part.material else [part.name]
        parts.append(Part(part.mesh, material, f"{file}:{part.name}" if len(read) > 1 else file))
    if grey:
        why = "; the .mtl library that an OBJ file names must lie beside it" if file.lower().endswith(".obj") else ""
        notes.append(f"{file}: says nothing about its materials, taken as grey: {', '.join(grey)}{why}")
    return parts, materials, notes


def _finished(table: Table, parts: Sequence[meshes.MeshPart]) -> list[meshes.MeshPart]:
    """Parts that are placed, subdivided, two-sided and with tangents as asked."""
    two_sided = table.truth("two_sided") if table.has("two_sided") else None
    tangents = table.text("tangents", "normal")
    if tangents not in ("normal", "uv"):
        raise InputError(f'\'tangents\' is "normal" or "uv", not {tangents!r}')
    normals = table.text("shading_normals", "corrected")
    if normals not in ("corrected", "pure"):
        raise InputError(f'\'shading_normals\' is "corrected" or "pure", not {normals!r}')
    max_edge = table.number("max_edge") if table.has("max_edge") else None
    finished = []
    for part in parts:
        mesh = part.mesh
        if tangents == "uv" and mesh.uv is None:
            raise InputError(f"'tangents' = \"uv\" needs texture coordinates, which '{part.name}' does not have")
        mesh = mesh if max_edge is None else subdivided(mesh, max_edge)
        mesh = dataclasses.replace(mesh, uv_tangents=tangents == "uv", pure_normals=normals == "pure")
        if two_sided is not None:
            mesh = meshes.with_back(mesh) if two_sided else dataclasses.replace(mesh, two_sided=False)
        finished.append(dataclasses.replace(part, mesh=mesh))
    return finished


def _primitive(table: Table) -> Mesh:
    kind = table.text("primitive")
    if kind == "plane":
        return primitives.plane(tuple(table.array("size", (2,), (1, 1))), table.whole("resolution", 64))
    if kind == "sphere":
        return primitives.sphere(table.number("radius", 0.5), table.whole("resolution", 64))
    if kind == "box":
        return primitives.box(tuple(table.array("size", (3,), (1, 1, 1))), table.whole("resolution", 16))
    raise InputError(f"{table.where}: primitive '{kind}' is not known; known are plane, sphere, box")


def _mixture(table: Table, folder: pathlib.Path, others: Mapping[str, Brdf | Material]) -> Material:
    """Other materials, each times a number, a colour or a mask."""
    table.text("type")
    components = []
    for part in table.tables("parts"):
        name = part.text("material")
        if name not in others:
            close = difflib.get_close_matches(name, others, n=1)
            hint = f"did you mean '{close[0]}'?" if close else "it must be a material that is no mixture itself"
            raise InputError(f"{part.where}: there is no [material.{name}] to mix; {hint}")
        for key in ("normal_map", "emission"):
            if getattr(as_material(others[name]), key) is not None:
                raise InputError(f"{part.where}: '{name}' has {key}; give it to the mixture instead")
        components += weighted(others[name], _colour(part, "weight", folder, data=True))
        part.finish()
    if not components:
        raise InputError(f"{table.where}: a mixture needs 'parts', a list of tables with 'material' and 'weight'")
    for key in (*_FACTORING, "reflection"):
        table.has(key)  # read elsewhere
    bumps, emission = _normal_map(table, folder), _emission(table)
    table.finish()
    return Material(tuple(components), bumps, emission)


def _colour(table: Table, key: str, folder: pathlib.Path, *, data: bool = False) -> Texture:
    """A number, a colour or an image file."""
    if not isinstance(table.get(key), str):
        return constant(table.not_negative(key))
    try:
        return read_texture(folder / table.text(key), data=data)
    except InputError as error:
        raise table.within(error) from None


def _normal_map(table: Table, folder: pathlib.Path) -> Texture | None:
    if not table.has("normal_map"):
        return None
    if not isinstance(table.get("normal_map"), str):
        table.array("normal_map", (3,))  # a colour, not a grey
    return _colour(table, "normal_map", folder, data=True)


def _material(table: Table, folder: pathlib.Path) -> tuple[Brdf | Material, list[str]]:
    """A material, and what was mended or approximated in its file."""
    kind, read = table.text("type"), []
    try:
        if kind == "lambert" and isinstance(table.get("albedo"), str):
            brdf = textured_lambert(_colour(table, "albedo", folder))
        elif kind == "phong" and any(isinstance(table.get(key), str) for key in ("diffuse", "specular")):
            colours = _colour(table, "diffuse", folder), _colour(table, "specular", folder)
            brdf = textured_phong(*colours, table.not_negative("exponent"))
        elif kind == "lambert":
            brdf = lobes.lambert(table.not_negative("albedo"))
        elif kind == "phong":
            brdf = lobes.phong(
                table.not_negative("diffuse"), table.not_negative("specular"), table.not_negative("exponent")
            )
        elif kind == "lafortune":
            brdf = read_lobes(table)
        elif kind == "ashikhmin_shirley":
            brdf = ashikhmin_shirley(table.channels("kd"), table.channels("ks"), table.number("nu"), table.number("nv"))
        elif kind == "measured":
            measured = load_brdf(folder / table.text("file"))
            brdf, read = measured.brdf, [*measured.notes, *measured.energy_notes()]
        elif kind == "fitted":
            brdf = read_fitted(folder / table.text("file"))
            if isinstance(brdf, Separable) and (asked := [key for key in _FACTORING if table.has(key)]):
                raise InputError(f"'{asked[0]}' is that of the file of factors; remove it, or fit factors anew")
        elif kind == "sbrdf":
            brdf = spatial(read_sbrdf(folder / table.text("maps")))
        else:
            raise InputError(f"type '{kind}' is not known; known are {_TYPES}")
    except InputError as error:
        raise table.within(error) from None
    bumps, emission = _normal_map(table, folder), _emission(table)
    table.finish()
    plain = bumps is None and emission is None
    return (brdf if plain else Material(as_material(brdf).components, bumps, emission)), read


def _emission(table: Table) -> np.ndarray | None:
    """Radiance; None where it is left out, or black."""
    if not table.has("emission"):
        return None
    radiance = np.broadcast_to(np.asarray(table.not_negative("emission"), np.float32), 3)
    return radiance if radiance.any() else None


def _has_any(table: Table, keys: Sequence[str]) -> bool:
    # Of each, so that none is unknown.
    return any([table.has(key) for key in keys])


def _factoring(table: Table) -> Factoring:
    values: dict[str, Any] = {
        "terms": table.whole("terms") if table.has("terms") else None,
        "error": table.number("terms_error") if table.has("terms_error") else None,
        "form": table.text("form", "svd"),
        "parametrisation": table.text("parametrisation", "disc"),
    }
    try:
        return Factoring(**values)
    except InputError as error:
        raise table.within(error) from None
