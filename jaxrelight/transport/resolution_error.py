"""What coarser cube maps change of what a few points reflect: measured with the light and the BRDFs as they are.

A point has rays through the texels of the finest map and of every coarser one, and sums exact rows of each times the
light of its texels (Wang 2006 eq. 3). Which rays met something is kept as bits, so that another light casts none.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from jaxrelight.basis import cubemap, latlong
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.reflection import FixedView
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import PixelWeight, Texture, look_up
from jaxrelight.files import store
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.geometry.gbuffer import trace_gbuffer
from jaxrelight.geometry.receivers import Receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.images.metric import image_error
from jaxrelight.lights.environment import Environment, coarsened
from jaxrelight.lights.natural_spectrum import natural_spectrum
from jaxrelight.numerics.arrays import as_array
from jaxrelight.transport import bake

# How many points are drawn, and the seed of all that is drawn.
POINTS, _SEED = 256, 0
# Rays along the longer side of the picture that tells which vertices are seen.
_SEEN_ALONG = 128
# Points whose irradiance is summed at a time, and those whose BRDFs are.
_IRRADIANCE_BATCH, _BRDF_BATCH = 8, 16


@dataclasses.dataclass(frozen=True)
class ChosenResolution:
    """A resolution that was chosen by need, and how far off it and others are.

    Attributes:
        resolution: that was chosen.
        finest: what coarser ones were compared with.
        tolerance: that it was chosen by.
        errors: of each coarser resolution, relative to the finest, trimmed as those of pictures.
        untrimmed: the same of all points.
        points: that were drawn.
        environment: a key of the light; None for natural light, of a scene that has no environment.
        sample: the layer of the points' visibility.
        layer: of the errors.
    """

    resolution: int
    finest: int
    tolerance: float
    errors: Mapping[int, float]
    untrimmed: Mapping[int, float]
    points: int
    environment: str | None
    sample: str
    layer: str

    def __str__(self) -> str:
        light = "" if self.environment else " under natural light, as the scene has no environment"
        coarser = [side for side in self.errors if side < self.resolution]
        so_much = f"resolution {self.resolution} was chosen{light}: "
        if self.resolution in self.errors:
            so_much += f"{self.errors[self.resolution]:.1%} off of {self.finest} on {self.points} points"
            return so_much + (f"; {coarser[-1]} would be {self.errors[coarser[-1]]:.1%}" if coarser else "")
        return so_much + (
            f"{coarser[-1]} would be {self.errors[coarser[-1]]:.1%} off of it on {self.points} points, and the "
            f"tolerance is {self.tolerance:.1%}"
        )

    def to_record(self) -> dict:
        """What a header says of it."""
        named = {name: {str(side): error for side, error in getattr(self, name).items()} for name in _TABLES}
        return {**dataclasses.asdict(self), **named}


_TABLES = "errors", "untrimmed"


def chosen_from(record: dict | None) -> ChosenResolution | None:
    """What `ChosenResolution.to_record` made; None where a header says nothing."""
    if not record:
        return None
    named = {name: {int(side): error for side, error in record[name].items()} for name in _TABLES}
    return ChosenResolution(**{**record, **named})


class Points(NamedTuple):
    """Receivers that were drawn, with a direction to the eye each.

    Attributes:
        slots: their places in the flattened groups, ascending.
        frames: their tangent frames.
        omega_o: local directions to the eye.
        uv: surface coordinates.
        footprint: area in the first set of texture coordinates that each stands for.
    """

    slots: Int[np.ndarray, " p"]
    frames: Float[np.ndarray, "p 3 3"]
    omega_o: Float[np.ndarray, "p 3"]
    uv: Float[np.ndarray, "p u"]
    footprint: Float[np.ndarray, " p"]


class PointRows(NamedTuple):
    """A BRDF that some of the points have in rows.

    Attributes:
        points: numbers of the points.
        brdf: it.
        weight: the factor on it over the surface.
    """

    points: Int[np.ndarray, " q"]
    brdf: Brdf | SpatialLobes
    weight: PixelWeight


def draw_slots(
    receivers: Receivers, surfaces: Surfaces, tracer: Tracer, camera: Camera, count: int = POINTS
) -> Int[np.ndarray, " p"]:
    """Places of some receivers in the flattened groups, ascending.

    Of pixels each is as likely as another. Vertices count by their share of what the camera sees, or by the area around
    them where it sees nothing: by area alone, an even floor around a small object would hide how far that is off. One
    is drawn of each of as many runs of receivers, which are in the order of groups, as of close ones.

    Args:
        receivers: of the scene.
        surfaces: of the scene.
        tracer: of the scene.
        camera: of the scene.
        count: of draws; of pixels, all where there are no more.
    """
    number_of = np.argsort(receivers.slot_of, kind="stable")
    weights = np.ones(len(number_of))
    if receivers.omega_o is None:
        weights = _shares(surfaces, tracer, camera, len(number_of))[number_of]
    place = np.flatnonzero(weights)
    if len(place) > count:
        ends = np.cumsum(weights) / weights.sum()
        drawn = (np.arange(count) + np.random.default_rng(_SEED).random(count)) / count
        place = np.unique(np.minimum(np.searchsorted(ends, drawn, side="right"), place[-1]))
    return receivers.slot_of[number_of[place]]


def points_of(
    receivers: Receivers, surfaces: Surfaces, slots: Int[np.ndarray, " p"], origin: Sequence[float] | np.ndarray
) -> Points:
    """Receivers as points.

    Args:
        receivers: of the scene.
        surfaces: of the scene.
        slots: from `draw_slots`.
        origin: the world position of the eye that vertices are looked at from; those that are turned away from it are
            seen from anywhere.
    """

    def of(values: np.ndarray) -> np.ndarray:
        return values.reshape(-1, *values.shape[2:])[slots]

    normals = of(receivers.normals)
    frames = frames_of_points(normals, of(receivers.tangents))
    if receivers.omega_o is not None:
        assert receivers.uv is not None
        assert receivers.footprint is not None
        omega_o = to_local(frames, of(receivers.omega_o))
        return Points(slots, frames, omega_o, of(receivers.uv), of(receivers.footprint))
    order = np.argsort(receivers.slot_of, kind="stable")
    number = order[np.searchsorted(receivers.slot_of[order], slots)]
    vertex = np.concatenate([np.arange(len(surfaces.vertices)), np.flatnonzero(surfaces.back >= 0)])[number]
    towards = surfaces.to_scene(origin) - of(receivers.positions)
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), np.finfo(float).tiny)
    height, turn = np.random.default_rng(_SEED).random((2, len(slots)))
    flat = np.sqrt(1 - height**2)
    anywhere = np.stack([flat * np.cos(2 * np.pi * turn), flat * np.sin(2 * np.pi * turn), height], axis=1)
    faces_eye = np.sum(towards * normals, axis=1, keepdims=True) > 0
    omega_o = np.where(faces_eye, to_local(frames, towards), anywhere.astype(frames.dtype))
    return Points(slots, frames, omega_o, surfaces.uv[vertex], np.zeros(len(slots)))


def _shares(surfaces: Surfaces, tracer: Tracer, camera: Camera, count: int) -> Float[np.ndarray, " v"]:
    """How much of a picture each vertex makes, and the back of each that has one; or areas, of an empty picture."""
    longest = max(camera.width, camera.height)
    width, height = (max(1, round(_SEEN_ALONG * side / longest)) for side in (camera.width, camera.height))
    seen = trace_gbuffer(surfaces, tracer, dataclasses.replace(camera, width=width, height=height))
    number = np.where(seen.back[:, None], surfaces.back[seen.corners], seen.corners)
    if len(number):
        return np.bincount(number.ravel(), np.maximum(seen.barycentric, 0).ravel(), count)
    corners = surfaces.vertices[surfaces.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    by_vertex = np.bincount(surfaces.faces.ravel(), np.repeat(area, 3), len(surfaces.vertices))
    return np.concatenate([by_vertex, by_vertex[surfaces.back >= 0]])


def key_of_light(environment: Environment | None) -> str | None:
    """What tells environments apart whose relative errors differ."""
    if environment is None:
        return None
    return store.key_of(np.asarray(environment.pixels), float(environment.rotate_y))


def light_of(environment: Environment | None, resolution: int) -> Float[np.ndarray, "d 3"]:
    """Mean radiance of texels: of an environment, or three lights of the natural spectrum in its place."""
    if environment is not None:
        pixels = latlong.rotate(coarsened(environment.pixels, resolution // 2), environment.rotate_y)
        flat, sums = np.asarray(pixels, float).reshape(-1, 3), np.zeros((6 * resolution**2, 3))
        # On the host: a program for this one product would take longer to compile.
        for texel, pixel, shared in latlong.overlaps(pixels.shape[0], pixels.shape[1], resolution):
            for channel in range(3):
                sums[:, channel] += np.bincount(texel, shared * flat[pixel, channel], len(sums))
        return (sums / cubemap.solid_angles(resolution)[:, None]).astype(np.float32)
    spectrum = natural_spectrum(resolution)
    drawn = np.random.default_rng(_SEED).standard_normal((3, len(spectrum))).astype(np.float32) * spectrum
    return np.asarray(HaarFaces(resolution).decode(as_array(drawn))).T


def radiance(
    points: Points,
    rows: Iterable[PointRows],
    bits: UInt8[np.ndarray, "p bytes"],
    light: Float[np.ndarray, "d 3"],
    resolution: int,
    samples: int = 1,
) -> Float[np.ndarray, "p 3"]:
    """What points reflect by exact rows of a resolution.

    Args:
        points: of a scene.
        rows: what they reflect by.
        bits: what is visible of the rays of each, `samples`² a texel.
        light: of the finest texels, see `light_of`.
        resolution: of the rows.
        samples: rays along a side of a texel.
    """
    texels, directions = _coarser(light, resolution), bake.directions_for(resolution, samples)
    irradiance, total = None, np.zeros((len(points.slots), 3))
    for own, brdf, weight in rows:
        if not len(own):
            continue
        if brdf.is_constant:
            if irradiance is None:
                irradiance = _irradiance(points, bits, texels, directions)
            reflected = irradiance[own] * _value(brdf)
        else:
            reflected = _reflected(points, own, brdf, bits, texels, directions)
        total[own] += reflected * _factors(weight, points, own)
    return total


def resolution_error(coarse: Float[np.ndarray, "p 3"], fine: Float[np.ndarray, "p 3"]) -> tuple[float, float]:
    """The relative error of some points, trimmed as that of pictures and not; 0 where they are black."""
    if not fine.any():
        return 0.0, 0.0
    error = image_error(coarse[None], fine[None])
    return error.trimmed, error.untrimmed


def _coarser(light: Float[np.ndarray, "d 3"], resolution: int) -> Float[np.ndarray, "c 3"]:
    """Means of the finest texels within coarser ones."""
    finest = round((len(light) / 6) ** 0.5)
    if resolution == finest:
        return light
    k, angles = finest // resolution, cubemap.solid_angles(finest)[:, None]
    sums = [
        values.reshape(6, resolution, k, resolution, k, -1).sum(axis=(2, 4)).reshape(6 * resolution**2, -1)
        for values in (light * angles, angles)
    ]
    return (sums[0] / sums[1]).astype(light.dtype)


def _irradiance(points: Points, bits, texels, directions: bake.Directions) -> Float[np.ndarray, "p 3"]:
    vectors, angles = (np.asarray(of) for of in (directions.vectors, directions.solid_angles))
    arriving = np.asarray(directions.to_rays(texels.T)).T * angles[:, None]
    normals, seen = points.frames[:, 2].astype(vectors.dtype), np.empty((len(bits), 3))
    for start in range(0, len(bits), _IRRADIANCE_BATCH):
        some = slice(start, start + _IRRADIANCE_BATCH)
        cosines = np.maximum(normals[some] @ vectors.T, 0)
        cosines *= np.unpackbits(bits[some], axis=1, bitorder="little")
        seen[some] = cosines @ arriving
    return seen


def _value(brdf: Brdf | SpatialLobes) -> Float[np.ndarray, " c"]:
    """Of a BRDF that is the same in all directions."""
    assert isinstance(brdf, Brdf)
    if isinstance(brdf, LobeSum):
        return np.asarray(brdf.diffuse) / np.pi
    up = as_array(np.array([0, 0, 1], np.float32))
    return np.asarray(brdf.evaluate(up, up))


def _reflected(points: Points, own, brdf, bits, texels, directions) -> Float[np.ndarray, "q 3"]:
    """By a BRDF that is not the same in all directions."""
    parts = []
    for start in range(0, len(own), _BRDF_BATCH):
        chosen = own[start : start + _BRDF_BATCH]
        padded = np.resize(chosen, _BRDF_BATCH)
        omega_o = as_array(points.omega_o[padded], np.float32)
        if isinstance(brdf, SpatialLobes):
            places = (as_array(of[padded], np.float32) for of in (points.uv, points.footprint))
            lobes = _lobes_at(brdf, *places)
            reflection = FixedView(jax.tree.map(lambda _: None, lobes), omega_o, lobes)
        else:
            reflection = FixedView(brdf, omega_o)
        frames = as_array(points.frames[padded], np.float32)
        terms = bake.bake_and_apply(as_array(bits[padded]), frames, reflection, directions, as_array(texels))
        parts.append(np.asarray(terms)[: len(chosen), 0])
    return np.concatenate(parts)


@eqx.filter_jit
def _lobes_at(brdf: SpatialLobes, uv: Float[Array, "m u"], footprint: Float[Array, " m"]) -> Brdf:
    return brdf.packed().at(uv, footprint)


def _factors(weight: PixelWeight, points: Points, own) -> Float[np.ndarray, "*q c"]:
    if all(isinstance(one, Texture) and one.is_constant for one in weight):
        constants = [np.asarray(one.pixels)[0, 0] for one in weight if isinstance(one, Texture)]
        return np.prod(np.broadcast_arrays(np.ones(1), *constants), axis=0)
    places = (as_array(of, np.float32) for of in (points.uv, points.footprint))
    return np.asarray(_looked_up(weight, *places))[own]


@jax.jit
def _looked_up(weight: PixelWeight, uv: Float[Array, "p u"], footprint: Float[Array, " p"]) -> Float[Array, "p c"]:
    return jax.vmap(look_up, in_axes=(None, 0, 0))(weight, uv, footprint)
