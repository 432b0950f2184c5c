"""jaxrelight info: what a store, scene or image is."""

import dataclasses
import pathlib
from typing import TYPE_CHECKING

import tyro

if TYPE_CHECKING:
    from jaxrelight.brdf.material import Material


@dataclasses.dataclass(frozen=True)
class Info:
    """Say what a store, a scene, a mesh or an image is: its size, its settings, its error."""

    path: tyro.conf.Positional[pathlib.Path]
    """A store's folder, a .toml scene, a mesh, or an image."""
    json: bool = False
    """Print one JSON object."""

    def run(self):
        """Runs the command."""
        from jaxrelight.commands.progress import summarize

        if self.path.is_dir():
            summary = _store(self.path)
        elif self.path.suffix.lower() in (".toml", ".ply", ".obj", ".stl", ".glb", ".gltf"):
            summary = _scene(self.path)
        else:
            summary = _image(self.path)
        summarize(summary, self.json)


def _store(path: pathlib.Path) -> dict:
    import numpy as np

    from jaxrelight import store
    from jaxrelight.transport.load import load

    header, transport = store.read_header(path), load(path)
    layers = sorted(folder for folder in path.iterdir() if (folder / "layout.json").exists())
    used = {header["geometry"], header["visibility"]}
    used |= {name for record in header["materials"] for name in store.layers_of(record)}
    summary = {
        "store": str(path),
        "scene": header["scene"],
        "receivers": transport.receivers.count,
        "rows": transport.operator.shape[0],
        "materials": {
            name: f"{sum(block.reflection.terms for block in transport.blocks if block.material == name)} terms"
            for name in dict.fromkeys(transport.names)
        },
        "settings": header["settings"],
        "operator_bytes": transport.operator.nbytes,
        "kept_energy": transport.kept,
        "bytes": {folder.name: store.open_layer(folder).nbytes for folder in layers},
        "unused_layers": [folder.name for folder in layers if folder.name not in used],
        "jaxrelight": header["jaxrelight"],
    }
    dropped = [block.dropped for block in transport.blocks if block.dropped is not None]
    if dropped:
        # Under light of root-mean-square radiance 1 over the texels, no row is further off than this.
        worst = max(float(np.sqrt(part.max())) for part in dropped)
        summary["largest_error_for_unit_light"] = worst * (6 * transport.settings.resolution**2) ** 0.5
    return summary


def _scene(path: pathlib.Path) -> dict:
    from jaxrelight.brdf.material import as_material
    from jaxrelight.commands.progress import notes
    from jaxrelight.mesh_scene import open_scene

    scene = open_scene(path)
    notes(scene.notes)
    environment = scene.environment
    return {
        "scene": str(path),
        "meshes": {
            f"{i}:{part.name}": f"{len(part.mesh.vertices):,} vertices, {len(part.mesh.faces):,} faces, {part.material}"
            for i, part in enumerate(scene.parts)
        },
        "vertices": sum(len(part.mesh.vertices) for part in scene.parts),
        "materials": {name: _kind(as_material(surface)) for name, surface in scene.materials.items()},
        "camera": f"{scene.camera.width} × {scene.camera.height} pixels, {scene.camera.fov_y}° high",
        "environment": "none" if environment is None else f"{environment.pixels.shape[1]} × {len(environment.pixels)}",
    }


def _kind(material: "Material") -> str:
    """A material in a word or two."""
    kind = "diffuse" if all(component.brdf.is_constant for component in material.components) else "glossy"
    return f"{kind}, textured" if material.needs_uv else kind


def _image(path: pathlib.Path) -> dict:
    import numpy as np

    from jaxrelight.images import read_image

    pixels = read_image(path)
    colour = pixels[..., :3]
    finite = np.isfinite(colour).all(axis=-1)
    return {
        "image": str(path),
        "size": f"{pixels.shape[1]} × {pixels.shape[0]}, {pixels.shape[2]} channels",
        "largest": float(colour[finite].max()) if finite.any() else 0.0,
        "mean": [float(channel) for channel in colour[finite].mean(axis=0)] if finite.any() else [],
        "negative_pixels": int((colour[finite] < 0).any(axis=-1).sum()),
        "not_finite_pixels": int(np.logical_not(finite).sum()),
    }
