"""jaxrelight info: what a store, scene or image is."""

import collections
import dataclasses
import pathlib
from typing import TYPE_CHECKING

import tyro

if TYPE_CHECKING:
    from jaxrelight.brdf.material import Material


@dataclasses.dataclass(frozen=True)
class Info:
    """Say what a store, a scene, a mesh, an image or a measured BRDF is: its size, its settings, its error."""

    path: tyro.conf.Positional[pathlib.Path]
    """A store's folder, a .toml scene, a mesh, an image, or a .binary, .bsdf or .brdf file."""
    json: bool = False
    """Print one JSON object."""

    def run(self):
        """Runs the command."""
        from jaxrelight.commands.summary import summarize

        if self.path.is_dir():
            summary = _store(self.path)
        elif self.path.suffix.lower() in (".toml", ".ply", ".obj", ".stl", ".glb", ".gltf"):
            summary = _scene(self.path)
        elif self.path.suffix.lower() in (".binary", ".bsdf", ".brdf"):
            summary = _brdf(self.path)
        else:
            summary = _image(self.path)
        summarize({"command": "info", **summary}, self.json)


def _store(path: pathlib.Path) -> dict:
    import numpy as np

    from jaxrelight.commands.pictures import describe
    from jaxrelight.files import store
    from jaxrelight.lighting.prepare import open_store
    from jaxrelight.methods import Indirect

    header = store.read_header(path)
    relighter, used = open_store(path), set(store.layers_of(header))
    transport = relighter.transport
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
        "rows": transport.operator.shape[0],
        "materials": dict(terms),
        "bytes": {folder.name: store.bytes_on_disk(folder) for folder in layers},
        "unused_layers": [folder.name for folder in layers if folder.name not in used],
        "lights": len(transport.stored.local),
        "leaves_out": list(relighter.method.leaves_out(environment=True, local=bool(transport.stored.local))),
        **describe(relighter),
    }
    if isinstance(relighter.method, Indirect):
        return summary
    dropped = [block.dropped for block in transport.blocks if block.dropped is not None]
    if dropped:
        # Under light of root-mean-square radiance 1 over the texels, no row is further off than this.
        worst = max(float(np.sqrt(np.asarray(part).max())) for part in dropped)
        summary["largest_error_for_unit_light"] = worst * (6 * relighter.method.resolution**2) ** 0.5
    return summary


def _scene(path: pathlib.Path) -> dict:
    from jaxrelight.brdf.material import as_material
    from jaxrelight.commands.progress import notes
    from jaxrelight.scene.mesh_scene import open_scene

    scene = open_scene(path)
    notes(scene.notes)
    sky, camera = scene.lights.environment, scene.camera
    return {
        "kind": "scene",
        "scene": str(path),
        "meshes": {
            f"{i}:{part.name}": {
                "vertices": len(part.mesh.vertices),
                "faces": len(part.mesh.faces),
                "material": part.material,
            }
            for i, part in enumerate(scene.parts)
        },
        "vertices": sum(len(part.mesh.vertices) for part in scene.parts),
        "materials": {name: _kind(as_material(surface)) for name, surface in scene.materials.items()},
        "camera": {"width": camera.width, "height": camera.height, "fov_y": camera.fov_y},
        "environment": None if sky is None else {"width": sky.pixels.shape[1], "height": sky.pixels.shape[0]},
    }


def _kind(material: "Material") -> str:
    """A material in a word or two."""
    kind = "diffuse" if all(component.brdf.is_constant for component in material.components) else "glossy"
    return f"{kind}, textured" if material.needs_uv else kind


def _brdf(path: pathlib.Path) -> dict:
    from jaxrelight.brdf.files import load_brdf
    from jaxrelight.commands.progress import notes

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
    colour = pixels[..., :3]
    finite = np.isfinite(colour).all(axis=-1)
    return {
        "kind": "image",
        "image": str(path),
        "width": pixels.shape[1],
        "height": pixels.shape[0],
        "channels": pixels.shape[2],
        "largest": float(colour[finite].max()) if finite.any() else 0.0,
        "mean": [float(channel) for channel in colour[finite].mean(axis=0)] if finite.any() else [],
        "negative_pixels": int((colour[finite] < 0).any(axis=-1).sum()),
        "not_finite_pixels": int(np.logical_not(finite).sum()),
    }
