"""Layers of a store that are one thing each: geometry, textures, long tables, factors, the scene's own light."""

import contextlib
import dataclasses
import pathlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factoring import Factoring
from jaxrelight.brdf.factors import COSINE, factor_error
from jaxrelight.brdf.parametrisation import POLAR
from jaxrelight.brdf.separable import Separable
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.spatial_factors import FactorResidual, SpatialFactors, factor_spatial
from jaxrelight.brdf.texture import Texture, VertexColours
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.local import Light
from jaxrelight.lights.record import to_records
from jaxrelight.methods import Indirect, Transport
from jaxrelight.precomputation.load import read_factors, read_spatial_factors


def make_folder(folder: pathlib.Path) -> None:
    """Makes the folder of a store, if it is not there.

    Raises:
        InputError: if it cannot be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be used as a store: {error.strerror}") from None


def write_once(folder: pathlib.Path, arrays: dict[str, np.ndarray]) -> store.Layer:
    """A layer of a single group, if it is not there yet."""
    layer = store.make_layer(folder, {name: (a.shape, a.dtype) for name, a in arrays.items()}, 1)
    if layer.missing:
        layer.write(0, **arrays)
    return layer


def made_once(folder: pathlib.Path, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays of a layer of a single group: as they are stored, else as they are made, which are stored then."""
    with contextlib.suppress(InputError):
        layer = store.open_layer(folder)
        return next(layer.read_groups())
    arrays = make()
    write_once(folder, arrays)
    return arrays


def write_geometry(folder: pathlib.Path, surfaces: Surfaces) -> store.Layer:
    """The layer of a scene's triangles."""
    return write_once(
        folder,
        {
            "vertices": surfaces.vertices,
            "normals": surfaces.normals,
            "faces": surfaces.faces,
            "uv": surfaces.uv,
            "mesh_of_vertex": surfaces.mesh_of_vertex,
            "two_sided": surfaces.two_sided,
            "uv_tangents": surfaces.uv_tangents,
            "pure_normals": surfaces.pure_normals,
            "placement": np.array([*surfaces.centre, surfaces.radius]),
        },
    )


def write_lights(folder: pathlib.Path, lights: Sequence[Light]) -> dict | None:
    """What a header says of local lights, whose numbers are a layer."""
    records, arrays = to_records(lights)
    if not records:
        return None
    layer = f"lights-{store.key_of(records, *([name, array] for name, array in arrays.items()))}"
    write_once(folder / layer, arrays)
    return {"layer": layer, "each": records}


def write_environment(folder: pathlib.Path, environment: Environment | None) -> dict | None:
    """The scene's own light: its layer, and how it is placed."""
    if environment is None:
        return None
    pixels = np.asarray(environment.pixels)
    layer = write_once(folder / f"environment-{store.key_of(pixels)}", {"pixels": pixels})
    return {
        "pixels": layer.folder.name,
        "rotate_y": float(environment.rotate_y),
        "scale": float(environment.scale),
    }


def write_factor(folder: pathlib.Path, factor: Texture | VertexColours) -> str | list[float] | dict:
    """The name of a texture's layer, or the values of a constant one; with how it lies where that is not plain."""
    if isinstance(factor, VertexColours):
        return {"colours": "vertices"}
    if factor.is_constant:
        image: Any = np.asarray(factor.pixels[0, 0]).tolist()
    else:
        pixels = np.asarray(factor.pixels)
        image = write_once(folder / f"texture-{store.key_of(pixels)}", {"pixels": pixels}).folder.name
    if factor.has_plain_layout:
        return image
    placement = None if factor.placement is None else np.asarray(factor.placement).tolist()
    return {"image": image, "uv_set": factor.uv_set, "wrap": list(factor.wrap), "placement": placement}


def write_table(folder: pathlib.Path, values: np.ndarray) -> str:
    """The name of the layer of a BRDF's long array."""
    return write_once(folder / f"table-{store.key_of(values)}", {"values": values}).folder.name


def factors_of(
    folder: pathlib.Path, brdf: Brdf | SpatialLobes, described: dict, asked: Factoring, method: Transport | Indirect
) -> tuple[Factored | SpatialFactors | None, str | None, FactorResidual | None]:
    """Factors, from their layer if it exists, its name, and what they leave out.

    None for pixels unless the BRDF is constant. What is given as factors is taken as it is, whatever the method says.
    """
    if method.receivers == "pixels" and not brdf.is_constant:
        return None, None, None
    terms, resolution = 1, Transport.factor_resolution
    if isinstance(method, Transport):
        terms, resolution = method.terms, method.factor_resolution
    else:
        asked = Factoring()
    dials = () if isinstance(brdf, Separable) else (terms, resolution, *COSINE, "left", dataclasses.asdict(asked))
    key = store.key_of(described, *dials)
    path = folder / f"factors-{key}"
    spatial = isinstance(brdf, SpatialLobes)
    with contextlib.suppress(InputError):
        layer = store.open_layer(path)
        if spatial:
            return read_spatial_factors(layer), path.name, FactorResidual(*layer.read("left", 0).tolist())
        left = FactorResidual(*layer.read("left", 0).tolist()) if "left" in layer.arrays else None
        return read_factors(layer), path.name, left
    # The layer is missing or damaged.
    if spatial:
        spatial_factors, left = factor_spatial(brdf, asked.most_terms(terms, resolution), resolution)
        arrays = {
            "light_maps": spatial_factors.light_maps,
            "view_maps": spatial_factors.view_maps,
            "weights": spatial_factors.weights.pixels,
        }
        numbers = {"left": np.array(dataclasses.astuple(left))}
        write_once(path, {name: np.asarray(array) for name, array in (arrays | numbers).items()})
        return spatial_factors, path.name, left
    factors = brdf.factors if isinstance(brdf, Separable) else asked.factors(brdf, terms, resolution)
    is_polar = np.array(factors.parametrisation == POLAR)
    arrays: dict[str, Any] = {"light_maps": factors.light_maps, "view_maps": factors.view_maps, "is_polar": is_polar}
    left = None
    if not (isinstance(brdf, Separable) or brdf.is_constant):
        left = FactorResidual(0.0, factor_error(brdf, factors))
        arrays["left"] = np.array(dataclasses.astuple(left))
    write_once(path, {name: np.asarray(array) for name, array in arrays.items()})
    return factors, path.name, left


def plain(value: Any) -> Any:
    """Numbers as JSON knows them."""
    return jax.tree.map(lambda x: x.item() if isinstance(x, np.generic) else x, value)
