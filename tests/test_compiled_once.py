"""Functions that loop are compiled once: called again with other values of the same shapes, they compile nothing."""

import functools
import pathlib
import re
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

import fitting
import jaxrelight as jr
from fitting.blend import uniform
from fitting.factors import refined
from fitting.normals import estimated_normals
from fitting.sbrdf_levels import coarser
from fitting.solve import Options, fit_lobes
from fitting.stack import stack_of
from jaxrelight.basis import latlong, zonal
from jaxrelight.basis.cubemap import Texels
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.albedo import largest_albedo, mean_albedo
from jaxrelight.brdf.alternating import refactored
from jaxrelight.brdf.bandwidth import bandwidth_table
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.files.load import BrdfFile
from jaxrelight.brdf.half_sampling import half_vectors
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import as_material
from jaxrelight.brdf.sampling import CellSampler, directional_albedo
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.spatial_factors import factor_spatial
from jaxrelight.lighting.prefiltered import PrefilteredRelighter
from jaxrelight.lighting.visible_surfaces import VisibleSurfaces
from jaxrelight.lights.environment import encode
from jaxrelight.lights.lights import LightsLike
from jaxrelight.lights.sun import without_sun
from jaxrelight.operators.clustered import Clustered, clustered
from jaxrelight.operators.clustering import cluster
from jaxrelight.operators.contract import as_lineax
from jaxrelight.operators.sparse_rows import SparseRows, sparse_rows
from jaxrelight.transport.bake import directions_for
from jaxrelight.transport.filtered_visibility import visibility_distances
from tests.compilations import compilations

UP: Any = np.array([0.0, 0.6, 0.8], np.float32)


def values(seed: int, *shape: int) -> Any:
    return np.random.default_rng(seed).uniform(0.1, 1, shape).astype(np.float32)


def indices(seed: int) -> Any:
    return np.arange(2) + seed


def paint(seed: int) -> LobeSum:
    return jr.phong(0.2 + 0.1 * seed, 0.5, 9 + seed)


def rows(seed: int) -> SparseRows:
    return sparse_rows(np.tile(np.arange(4, dtype=np.uint16), (6, 1)), values(seed, 6, 3, 4), 96)


def clusters(seed: int) -> Clustered:
    return clustered([cluster(values(seed, 4, 3, 96), np.ones(96), 0.0)[0]], 96)


def lobes(seed: int) -> SpatialLobes:
    shape = 2, 2
    C = np.broadcast_to([-1.0, -1, 0.9], (*shape, 1, 3)).astype(np.float32)
    axis = np.broadcast_to([1.0, 0], (*shape, 2)).astype(np.float32)
    arrays: Any = 0 * values(seed, *shape, 3), C, 3 + values(seed, *shape, 1), values(seed, *shape, 1, 3), axis
    return SpatialLobes(*map(jax.device_put, arrays))


def level(seed: int):
    return coarser(uniform(paint(seed), (2, 2)), np.ones((2, 2), bool), Options(), pairs=32)


def fit(seed: int):
    directions = values(seed, 2, 4, 40, 3)
    omega_i, omega_o = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return fit_lobes(omega_i, omega_o, values(seed, 4, 40, 3))


def normals(seed: int):
    lights = values(seed, 6, 3)
    return estimated_normals(stack_of(values(seed, 6, 3, 3, 3), lights / np.linalg.norm(lights, axis=1, keepdims=True)))


def sky(seed: int) -> jr.Environment:
    return jr.environment(values(seed, 8, 16, 3), 30.0 * seed, 1.0 + seed)


def with_sun(seed: int):
    pixels = values(seed, 8, 16, 3)
    pixels[2, 5] = 1e4
    return pixels


def scene(seed: int) -> jr.Scene:
    camera = jr.Camera((0.2, 1.2, 3.0), (0, 0, 0), fov_y=40.0, width=12, height=10)
    return jr.Scene([jr.Part(jr.sphere(1, 8), "skin")], {"skin": paint(seed)}, camera)


@functools.cache
def relighter(seed: int) -> PrefilteredRelighter:
    prepared = jr.prepare(scene(seed), jr.Prefiltered(map_rows=32, receiver_tolerance=0))
    assert isinstance(prepared, PrefilteredRelighter)
    return prepared


@functools.cache
def view(seed: int) -> VisibleSurfaces:
    return relighter(seed).view()


def shaded(seed: int, lights: LightsLike):
    return relighter(seed).shade(relighter(seed).light(lights), view(seed))


def background(seed: int):
    return relighter(seed).background(relighter(seed).light(sky(seed)), view(seed))


# By the file that loops. What is lit by a whole scene is counted in `lighting/test_compilations.py`.
FUNCTIONS: dict[str, list[Callable[[int], Any]]] = {
    "basis/zonal": [lambda seed: zonal.zonal_means(values(seed, 8, 16, 3), 2.0 + seed)],
    "brdf/albedo": [lambda seed: largest_albedo(as_material(paint(seed))), lambda seed: mean_albedo(paint(seed))],
    "brdf/alternating": [lambda seed: refactored(paint(seed), factor(paint(seed), 2, 8))],
    "brdf/bandwidth": [lambda seed: bandwidth_table(paint(seed), 16, 4)],
    "brdf/factors": [lambda seed: factor(paint(seed), 2, 8)],
    "brdf/files/load": [lambda seed: BrdfFile(paint(seed), "MERL", ()).albedos()],
    "brdf/half_sampling": [lambda seed: half_vectors(paint(seed))],
    "brdf/sampling": [
        lambda seed: directional_albedo(paint(seed), UP, 8, 16),
        lambda seed: CellSampler(paint(seed), UP, 8, 16).sample(jax.random.key(seed)),
    ],
    "brdf/spatial_factors": [lambda seed: factor_spatial(lobes(seed), 2, 8, most_shapes=2, tolerance=0.0)],
    "fitting/factors": [lambda seed: refined(paint(seed), factor(paint(seed), 2, 8), steps=2)],
    "fitting/normals": [normals],
    "fitting/sbrdf_levels": [level],
    "fitting/solve": [fit],
    "fitting/starts": [fit],
    "lighting/direct_light": [lambda seed: shaded(seed, jr.point([seed, 3.0, 1], 2.0 + seed))],
    "lighting/prefiltered": [lambda seed: shaded(seed, sky(seed)), background],
    "lights/sky": [lambda seed: jr.sky_of(sky(seed), 16)],
    "lights/sun": [lambda seed: without_sun(with_sun(seed))],
    "operators/clustered": [
        lambda seed: clusters(seed).apply(values(seed, 96, 3)),
        lambda seed: clusters(seed).apply_many(values(seed, 9, 96, 3)),
        lambda seed: clusters(seed).transpose(values(seed, 4, 3)),
        lambda seed: clusters(seed).rows(indices(seed)),
        lambda seed: as_lineax(clusters(seed)).mv(values(seed, 96, 3)),
    ],
    "operators/sparse_rows": [
        lambda seed: rows(seed).apply(values(seed, 96, 3)),
        lambda seed: rows(seed).apply_many(values(seed, 9, 96, 3)),
        lambda seed: rows(seed).transpose(values(seed, 6, 3)),
        lambda seed: rows(seed).rows(indices(seed)),
        lambda seed: as_lineax(rows(seed)).mv(values(seed, 96, 3)),
        lambda seed: latlong.area_resampling(8, 16, 4).apply(values(seed, 8, 16, 3)),
        lambda seed: encode(
            values(seed, 8, 16, 3), 20.0 * seed, 1.0 + seed, latlong.area_resampling(8, 16, 4), Texels(4)
        ),
        lambda seed: HaarFaces(4).encode(values(seed, 3, 96)),
        lambda seed: HaarFaces(4).decode(values(seed, 3, 96)),
    ],
    "transport/filtered_visibility": [
        lambda seed: visibility_distances(
            (255 * values(seed, 16, 12)).astype(np.uint8),
            np.tile(np.eye(3, dtype=np.float32), (16, 1, 1)),
            directions_for(4),
        )
    ],
}
ELSEWHERE = {
    *("lighting/filtered_reflection", "operators/multilinear"),
    *("transport/from_visibility", "inverse/material_fit"),
    *("lighting/adaptive/estimate", "lighting/adaptive/hierarchy", "lighting/adaptive/prediction"),
    *("lighting/shadows", "lighting/sun", "transport/bake", "gather/final_gather"),
    *("inverse/lamp_problem", "inverse/lamp_response"),
}
# What takes seconds to compile the first time.
DEAR = "fitting/factors", "fitting/sbrdf_levels", "fitting/solve"
CASES = [
    pytest.param(file, number, marks=[pytest.mark.slow] * (file in DEAR))
    for file, of_file in FUNCTIONS.items()
    for number in range(len(of_file))
]


@pytest.mark.parametrize(("file", "number"), CASES)
def test_other_values_compile_nothing(file: str, number: int):
    function = FUNCTIONS[file][number]
    function(0)
    with compilations() as compiled:
        function(1)
    assert not compiled


def test_every_file_that_loops_is_counted():
    loops = re.compile(r"lax\.(map|scan|fori_loop|while_loop|associative_scan)\(|pure_callback\(")
    modules = set()
    for root in (pathlib.Path(jr.__file__).parent, pathlib.Path(fitting.__file__).parent):
        within = "" if root.name == "jaxrelight" else f"{root.name}/"
        for path in root.rglob("*.py"):
            if loops.search(path.read_text()):
                modules.add(within + path.relative_to(root).with_suffix("").as_posix())
    assert modules == {*FUNCTIONS, *ELSEWHERE}
