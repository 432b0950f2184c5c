"""Differentiable precomputed light transport and relighting in JAX.

The public names, each loaded when it is first used:

    scenes      load_scene, Scene, Part, Camera, Sensor, sensor_grid, Mesh, load_mesh, plane, sphere, box,
                scene_of_mesh
    meshes      normalized, transformed, with_back, subdivided
    lights      Lights, Environment, environment, load_environment, load_lights, point, spot, directional, area,
                projector, shaped, sky_of, even_sky, Light, Punctual, Incident
    materials   lambert, phong, lobe, lobe_sum, ashikhmin_shirley, load_brdf, factor, Factoring, Brdf, LobeSum,
                Material, Component, Texture, VertexColours, constant, textured_lambert, textured_phong
    methods     Transport, Indirect, Prefiltered, Adaptive
    lighting    prepare, open_store, Relighter, Image, LightLayers, measure, Measurement
    operators   Operator, Dense, SparseRows, Clustered, Stacked, as_lineax, sharded
    images      read_image, write_image, tone_map, auto_exposure, image_error
    inverse     inverse.environment, inverse.materials, inverse.lamps: light, materials and lamps from pictures
    speed       keep_compilations
    errors      InputError
    version     __version__
"""

import importlib
from typing import Any

from jaxrelight.late_names import late_names

_HOMES = {
    "scene.scene": ("Scene", "Part"),
    "scene.scene_file": ("load_scene", "load_lights"),
    "scene.mesh_scene": ("scene_of_mesh",),
    "geometry.camera": ("Camera",),
    "geometry.sensors": ("Sensor", "sensor_grid"),
    "geometry.mesh": ("Mesh", "load_mesh", "normalized", "transformed", "with_back"),
    "geometry.subdivision": ("subdivided",),
    "geometry.primitives": ("plane", "sphere", "box"),
    "lights.lights": ("Lights",),
    "lights.environment": ("Environment", "environment", "load_environment"),
    "lights.local": ("Light", "Punctual", "Incident", "point", "spot", "directional"),
    "lights.area": ("area",),
    "lights.projector": ("projector",),
    "lights.shaped": ("shaped",),
    "lights.sky": ("sky_of", "even_sky"),
    "brdf.contract": ("Brdf",),
    "brdf.lobes": ("LobeSum", "lambert", "phong", "lobe", "lobe_sum"),
    "brdf.ashikhmin_shirley": ("ashikhmin_shirley",),
    "brdf.files": ("load_brdf",),
    "brdf.factors": ("factor",),
    "brdf.factoring": ("Factoring",),
    "brdf.material": ("Material", "Component", "textured_lambert", "textured_phong"),
    "brdf.texture": ("Texture", "VertexColours", "constant"),
    "methods": ("Transport", "Indirect", "Prefiltered", "Adaptive"),
    "lighting.prepare": ("prepare", "open_store"),
    "lighting.contract": ("Relighter", "Image"),
    "lighting.measurement": ("Measurement", "measure"),
    "lighting.light_layers": ("LightLayers",),
    "operators.contract": ("Operator", "as_lineax"),
    "operators.dense": ("Dense",),
    "operators.sparse_rows": ("SparseRows",),
    "operators.clustered": ("Clustered",),
    "operators.stacked": ("Stacked",),
    "operators.sharded": ("sharded",),
    "images": ("read_image", "write_image", "tone_map", "auto_exposure", "image_error"),
    "compilation_cache": ("keep_compilations",),
    "errors": ("InputError",),
    "": ("inverse",),
}
_load, _names = late_names("jaxrelight", _HOMES)
__all__ = sorted([*_names, "__version__"])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("jaxrelight")
    return _load(name)


def __dir__() -> list[str]:
    return __all__
