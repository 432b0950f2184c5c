"""Differentiable precomputed light transport and relighting in JAX.

The public names, each loaded when it is first used:

    scenes      load_scene, Scene, Part, Camera, Environment, environment, load_environment,
                Mesh, load_mesh, plane, sphere, box
    materials   lambert, phong, lobe, lobe_sum, ashikhmin_shirley, load_brdf, factor
    transport   Settings, precompute, load, exact, rebake
    lighting    Relighter
    images      read_image, write_image, tone_map, image_error
    speed       keep_compilations
    errors      InputError
"""

import importlib

_HOMES = {
    "scene.scene": ("load_scene", "Scene", "Part"),
    "geometry.camera": ("Camera",),
    "geometry.mesh": ("Mesh", "load_mesh"),
    "geometry.primitives": ("plane", "sphere", "box"),
    "lights.environment": ("Environment", "environment", "load_environment"),
    "brdf.lobes": ("lambert", "phong", "lobe", "lobe_sum"),
    "brdf.ashikhmin_shirley": ("ashikhmin_shirley",),
    "brdf.files": ("load_brdf",),
    "brdf.factors": ("factor",),
    "methods": ("Settings",),
    "precomputation.precompute": ("precompute",),
    "precomputation.load": ("load",),
    "transport.rebake": ("exact", "rebake"),
    "lighting.transport": ("Relighter",),
    "images": ("read_image", "write_image", "tone_map", "image_error"),
    "compilation_cache": ("keep_compilations",),
    "errors": ("InputError",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str):
    if name not in _HOME_OF:
        raise AttributeError(f"module 'jaxrelight' has no attribute '{name}'")
    return getattr(importlib.import_module(f"jaxrelight.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
