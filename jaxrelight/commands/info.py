"""jaxrelight info: what a store, scene or image is."""

import collections
import dataclasses
import pathlib
from typing import TYPE_CHECKING

import tyro

from jaxrelight.commands.options import Json, Modules, import_modules
from jaxrelight.commands.summary import summarize
from jaxrelight.methods import Transport
from jaxrelight.progress import notes

if TYPE_CHECKING:
    from jaxrelight.brdf.material import Material


@dataclasses.dataclass(frozen=True)
class Info:
    """Say what a store, a scene, a mesh, an image or a measured BRDF is: its size, its settings, its error."""

    path: tyro.conf.Positional[pathlib.Path]
    """A store's folder, a .toml scene, a mesh, an image, or a .binary, .bsdf or .brdf file."""
    modules: Modules = ()
    json: Json = False

    def run(self) -> None:
        """Runs the command."""
        import_modules(self.modules)
        suffix = self.path.suffix.lower()
        if self.path.is_dir():
            summary = _store(self.path)
        elif suffix in (".toml", ".ply", ".obj", ".stl", ".glb", ".gltf"):
            summary = _scene(self.path)
        else:
            summary = _brdf(self.path) if suffix in (".binary", ".bsdf", ".brdf") else _image(self.path)
        summarize({"command": "info", **summary}, self.json)


def _store(path: pathlib.Path) -> dict:
    import numpy as np

    from jaxrelight.commands.pictures import describe
    from jaxrelight.files import store
    from jaxrelight.lighting.prepare import open_store

    header = store.read_header(path)
    relighter, used = open_store(path), set(store.layers_of(header))
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
    dropped = [block.dropped for block in transport.blocks if block.dropped is not None]
    if dropped and isinstance(relighter.method, Transport):
        # Under light of root-mean-square radiance 1 over the texels, no row is further off than this.
        worst = max(float(np.sqrt(np.asarray(part).max())) for part in dropped)
        summary["largest_error_for_unit_light"] = worst * (6 * relighter.method.resolution**2) ** 0.5
    return summary


def _scene(path: pathlib.Path) -> dict:
    from jaxrelight.brdf.material import as_material
    from jaxrelight.scene.mesh_scene import open_scene

    scene = open_scene(path)
    notes(scene.notes)
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
        "camera": {"width": camera.width, "height": camera.height, "fov_y": camera.fov_y},
        "environment": None if sky is None else {"width": sky.pixels.shape[1], "height": sky.pixels.shape[0]},
        "lights": len(scene.lights.local),
    }


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
