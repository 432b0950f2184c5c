"""jaxrelight info: what a store, scene or image is."""

import collections
import dataclasses
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import tyro

from jaxrelight.commands.options import Json, Modules, Up, import_modules
from jaxrelight.commands.summary import summarize
from jaxrelight.methods import Transport
from jaxrelight.progress import notes

if TYPE_CHECKING:
    from jaxrelight.brdf.material import Material
    from jaxrelight.geometry.camera import Camera
    from jaxrelight.geometry.mesh import Mesh

# What the figures of a line are.
_MEANINGS = {
    "meshes": "vertices and faces that rays meet, after repair",
    "bounds": "smallest and largest x, y and z of all meshes in the scene, in metres",
    "file_bounds": "of a mesh file as it is, which by itself is scaled to a longest side of 1 m",
    "camera": "the scene's own; positions in metres, vertical field of view in degrees, picture in pixels",
    "framing_camera": "one that shows all of it: --origin and --target, or [camera] of a scene file",
    "lamp": "where a [[light]] of type point lights what that camera sees, in metres, and its intensity in W/sr",
    "environment": "pixels of its map",
    "lights": "local ones",
    "left_out": "when it was precomputed",
    "receivers": "points at which transport is known",
    "rows": "of the operator: receivers, times the terms of their materials",
    "chosen_resolution": "errors are of direct light at drawn receivers, without the twentieth that differs most",
    "kept_energy": "the share of transport's squares that the kept coefficients hold",
    "operator_bytes": "in memory",
    "bytes": "on disk, by layer",
    "unused_layers": "folders of the store that may be deleted",
    "largest_error_for_unit_light": "of radiance, of any receiver, under light of root-mean-square radiance 1",
    "largest": "value of a channel, linear",
    "mean": "of each channel, linear Rec.709",
    "negative_pixels": "with a channel below 0",
    "not_finite_pixels": "with NaN or infinity",
    "albedo_at_degrees": "reflected share of white light by its angle from the normal",
}


@dataclasses.dataclass(frozen=True)
class Info:
    """Say what a store, a scene, a mesh, an image or a measured BRDF is: its size, its settings, its error."""

    path: tyro.conf.Positional[pathlib.Path]
    """A store's folder, a .toml scene, a mesh, an image, or a .binary, .bsdf or .brdf file."""
    up: Up = "y"
    modules: Modules = ()
    json: Json = False

    def run(self) -> None:
        """Runs the command."""
        import_modules(self.modules)
        suffix = self.path.suffix.lower()
        if self.path.is_dir():
            summary = _store(self.path)
        elif suffix in (".toml", ".ply", ".obj", ".stl", ".glb", ".gltf"):
            summary = _scene(self.path, self.up)
        else:
            summary = _brdf(self.path) if suffix in (".binary", ".bsdf", ".brdf") else _image(self.path)
        summarize({"command": "info", **summary}, self.json, _MEANINGS)


def _store(path: pathlib.Path) -> dict:
    import numpy as np

    from jaxrelight.commands.pictures import describe
    from jaxrelight.files import store
    from jaxrelight.lighting.prepare import open_store
    from jaxrelight.precomputation.account import account_from

    header = store.read_header(path)
    relighter, used = open_store(path), set(store.layers_of(header))
    if (path / store.SENSOR_HEADER).is_file():
        used |= set(store.layers_of(store.read_header(path, store.SENSOR_HEADER)))
    transport, local = relighter.transport, relighter.transport.stored.local
    for name in sorted(used):
        store.open_layer(path / name).check()
    layers = sorted(folder for folder in path.iterdir() if folder.is_dir())
    terms = collections.Counter()
    for block in transport.blocks:
        terms[block.material] += block.reflection.terms
    summary = {
        "kind": "store",
        "store": str(path),
        "scene": header["scene"],
        "receivers": transport.receivers.count,
        "rows": transport.row_count,
        "materials": dict(terms),
        "filtered_lobes": {lobes.material: lobes.narrower for lobes in transport.lobes},
        "bytes": {folder.name: store.bytes_on_disk(folder) for folder in layers},
        "unused_layers": [folder.name for folder in layers if folder.name not in used],
        "lights": len(local),
        "leaves_out": list(relighter.method.leaves_out(environment=True, local=bool(local))),
        **describe(relighter),
    }
    if "account" in header:
        account = account_from(header["account"]["numbers"])
        summary["left_out"] = {"line": account.line, **dataclasses.asdict(account)}
    dropped = [block.dropped for block in transport.blocks if block.dropped is not None]
    if dropped and isinstance(relighter.method, Transport):
        # Under light of root-mean-square radiance 1 over the texels, no row is further off than this.
        worst = max(float(np.sqrt(np.asarray(part).max())) for part in dropped)
        summary["largest_error_for_unit_light"] = worst * (6 * relighter.method.resolution**2) ** 0.5
    return summary


def _scene(path: pathlib.Path, up: Literal["y", "z"]) -> dict:
    from jaxrelight.brdf.material import as_material
    from jaxrelight.geometry.mesh import load_parts
    from jaxrelight.scene.framing import framing, lamp_for
    from jaxrelight.scene.mesh_placement import turned_up
    from jaxrelight.scene.mesh_scene import open_scene

    scene = open_scene(path, up=up)
    notes(scene.notes)
    shapes, of_file = [part.mesh for part in scene.parts], None
    if path.suffix.lower() != ".toml":
        # Without the floor that it is put on.
        shapes = [part.mesh for part in scene.parts if part.material != "floor"]
        of_file = _describe_bounds([part.mesh for part in turned_up(load_parts(path), up)])
    framed = framing(shapes)
    lamp, intensity = lamp_for(framed, shapes)
    sky, camera, meshes = scene.lights.environment, scene.camera, {}
    for number, part in enumerate(scene.parts):
        counts = {"vertices": len(part.mesh.vertices), "faces": len(part.mesh.faces)}
        meshes[f"{number}:{part.name}"] = {**counts, "material": part.material}
    return {
        "kind": "scene",
        "scene": str(path),
        "meshes": meshes,
        "vertices": sum(mesh["vertices"] for mesh in meshes.values()),
        "materials": {name: _kind(as_material(surface)) for name, surface in scene.materials.items()},
        "bounds": _describe_bounds(shapes),
        "file_bounds": of_file,
        "camera": _describe_camera(camera) | {"width": camera.width, "height": camera.height},
        "framing_camera": _describe_camera(framed.camera) | {"inside": framed.inside},
        "lamp": {"position": lamp.tolist(), "intensity": intensity},
        "environment": None if sky is None else {"width": sky.pixels.shape[1], "height": sky.pixels.shape[0]},
        "lights": len(scene.lights.local),
    }


def _describe_bounds(shapes: Sequence["Mesh"]) -> dict:
    from jaxrelight.geometry.mesh import joint_bounds

    low, high = joint_bounds(shapes)
    return {"low": low.tolist(), "high": high.tolist()}


def _describe_camera(camera: "Camera") -> dict:
    return {"origin": list(camera.origin), "target": list(camera.target), "fov_y": camera.fov_y}


def _kind(material: "Material") -> str:
    """A material in a word or two."""
    kind = "diffuse" if all(component.brdf.is_constant for component in material.components) else "glossy"
    return f"{kind}, textured" if material.needs_uv else kind


def _brdf(path: pathlib.Path) -> dict:
    from jaxrelight.brdf.files import load_brdf

    measured = load_brdf(path)
    notes([*measured.notes, *measured.energy_notes()])
    return {
        "kind": "brdf",
        "brdf": str(path),
        "format": measured.kind,
        "channels": measured.brdf.channels,
        "albedo_at_degrees": {str(degrees): share for degrees, share in measured.albedos().items()},
    }


def _image(path: pathlib.Path) -> dict:
    import numpy as np

    from jaxrelight.images import read_image

    pixels = read_image(path)
    finite = np.isfinite(pixels[..., :3]).all(axis=-1)
    colours = pixels[finite][:, :3]
    return {
        "kind": "image",
        "image": str(path),
        "width": pixels.shape[1],
        "height": pixels.shape[0],
        "channels": pixels.shape[2],
        "largest": float(colours.max()) if len(colours) else 0.0,
        "mean": colours.mean(axis=0).tolist() if len(colours) else [],
        "negative_pixels": int((colours < 0).any(axis=-1).sum()),
        "not_finite_pixels": int(np.count_nonzero(~finite)),
    }
