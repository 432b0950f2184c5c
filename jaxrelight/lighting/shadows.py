"""Shadow rays from surface points to lights. What they find is held fixed in derivatives."""

import collections
import functools
import hashlib
import weakref
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxrelight.errors import InputError
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.lights.local import Directional, Incident, Light, Punctual
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.numerics.buckets import bucket, filled_up
from jaxrelight.numerics.threads import in_parts

# Rays of a part of the work.
_RAY_CHUNK = 8192
# Bytes that are remembered of rays for each tracer, and what an entry costs beside its bits.
_MAX_REMEMBERED, _ENTRY_BYTES = 64 << 20, 300


class SurfacePoints(eqx.Module):
    """Points on surfaces to which light arrives, with padding whose normals are 0.

    Attributes:
        origins: of shadow rays, in scene space: the points, lifted off their surfaces.
        positions: of the points, in world units from the scene's centre.
        normals: unit shading normals; no ray starts towards a light behind them.
        radius: the length of scene space's unit in the world.
        tracer: of the scene.
    """

    origins: Float[Array, "p 3"]
    positions: Float[Array, "p 3"]
    normals: Float[Array, "p 3"]
    radius: Float[Array, ""]
    tracer: Tracer = eqx.field(static=True)

    def taken(self, chosen: Int[np.ndarray, " n"]) -> "SurfacePoints":
        """Some of the points, by number."""
        origins, positions, normals = (
            as_array(np.asarray(of)[chosen]) for of in (self.origins, self.positions, self.normals)
        )
        return SurfacePoints(origins, positions, normals, self.radius, self.tracer)

    def is_occluded(self, point: Int[np.ndarray, " r"], towards: Float[np.ndarray, "r 3"]) -> Bool[np.ndarray, " r"]:
        """Whether something hides distant light: of rays from points, by number. On the host."""
        return self._on_all_cores(self.tracer.occluded, point, towards)

    def distances(self, point: Int[np.ndarray, " r"], towards: Float[np.ndarray, "r 3"]) -> Float[np.ndarray, " r"]:
        """How far in the world the first surface along each ray is, infinite for none. On the host."""
        return float(self.radius) * self._on_all_cores(self.tracer.distances, point, towards)

    def _on_all_cores(self, query, point, *given):
        return _on_all_cores(query, np.asarray(self.origins), point, *given)


def surface_points(
    tracer: Tracer,
    positions: Float[np.ndarray, "p 3"],
    origins: Float[np.ndarray, "p 3"],
    normals: Float[np.ndarray, "p 3"],
    radius: float,
    least: int = 0,
) -> SurfacePoints:
    """Points in scene space, followed by padding up to one of few lengths.

    Args:
        tracer: of the scene.
        positions: in scene space, on the surfaces.
        origins: of rays, lifted off the surfaces.
        normals: unit shading normals, or zeros for points that nothing lights.
        radius: the length of scene space's unit in the world.
        least: the smallest number of points with padding.
    """
    length = bucket(max(len(positions), least), 1024)
    starts, scaled, shading = jax.device_put(
        tuple(filled_up(np.asarray(rows), length) for rows in (origins, positions * radius, normals))
    )
    return SurfacePoints(starts, scaled, shading, as_array(radius, np.float32), tracer)


class LightGroup(eqx.Module):
    """Punctual lights of one kind, whose arrays lead with their number n, filled up to one of few numbers.

    Attributes:
        lights: all of them.
        is_real: which of them are no filling, which reaches nothing.
    """

    lights: Punctual
    is_real: Bool[Array, " n"]


# The visibility of each group's lights from each point, packed into bits.
Visibility = tuple[UInt8[Array, "_ _"], ...]


def group_lights(lights: Sequence[Light], centre: Float[np.ndarray, "3"]) -> tuple[LightGroup, ...]:
    """The punctual parts of lights, stacked by their kinds.

    Args:
        lights: in the world.
        centre: of the scene, from which their positions count as those of `SurfacePoints` do.

    Raises:
        InputError: see `Punctual.relative_to`.
    """
    kinds: dict[object, list[Punctual]] = {}
    for light in lights:
        for part in light.parts():
            # Numbers that are no arrays would be compiled in, for every place of a light anew.
            part = jax.tree.map(as_array, part.relative_to(centre))
            leaves, structure = jax.tree.flatten(part)
            kinds.setdefault((structure, tuple((x.shape, x.dtype) for x in leaves)), []).append(part)
    return tuple(_stacked(parts) for parts in kinds.values())


def _stacked(parts: list[Punctual]) -> LightGroup:
    count = len(parts)
    filling = bucket(count, 8) - count if count > 8 else 0
    filled = parts + parts[-1:] * filling
    if is_traced(parts):
        together = jax.tree.map(lambda *each: jnp.stack(each), *filled)
    else:
        together = jax.tree.map(lambda *each: as_array(np.stack([np.asarray(x) for x in each])), *filled)
    return LightGroup(together, as_array(np.arange(len(filled)) < count))


def all_visible(points: SurfacePoints, groups: Sequence[LightGroup]) -> Visibility:
    """What there is without shadows: every light reaches every point."""
    width = -(-len(points.positions) // 8)
    return tuple(_everywhere(group.is_real, width) for group in groups)


@functools.partial(jax.jit, static_argnames="width")
def _everywhere(is_real, width: int) -> UInt8[Array, "n b"]:
    return jnp.broadcast_to(jnp.where(is_real, 255, 0).astype(jnp.uint8)[:, None], (len(is_real), width))


def trace_visibility(points: SurfacePoints, groups: Sequence[LightGroup]) -> Visibility:
    """Which lights reach which points: a ray from each point towards each light that is in front of it.

    A light that comes again from where it was costs no rays. Where arrays are traced by JAX, it is one callback to the
    host; the result is held fixed in derivatives.

    Raises:
        InputError: under `jax.jit` where JAX runs on several processes.
    """
    points, groups = jax.lax.stop_gradient((points, tuple(groups)))
    if not is_traced((points, groups)):
        return tuple(as_array(_traced_group(points, group)) for group in groups)
    if jax.process_count() > 1:
        raise InputError(
            "shadow rays cannot be cast inside of jit on several processes; call trace outside and pass its result"
        )
    width = -(-len(points.positions) // 8)
    shapes = tuple(jax.ShapeDtypeStruct((len(group.is_real), width), np.uint8) for group in groups)
    # Distant lights are the same at all points; others are given at every point.
    incidents = tuple(_incidents(points, group) for group in groups)

    def on_host(origins, normals, radius, groups, incidents):
        tracer = points.tracer
        return tuple(
            _traced_directions(tracer, origins, normals, group)
            if isinstance(group.lights, Directional)
            else _traced_incidents(tracer, origins, radius, group.is_real, *incident)
            for group, incident in zip(groups, incidents, strict=True)
        )

    arguments = points.origins, points.normals, points.radius, groups, incidents
    return jax.pure_callback(on_host, shapes, *arguments, vmap_method="sequential")


def unpacked(bits: UInt8[Array, " b"], start: Int[Array, ""], count: int, dtype: DTypeLike) -> Float[Array, " p"]:
    """Visibility of some points by a light, 1 or 0."""
    return jax.lax.dynamic_slice_in_dim(jnp.unpackbits(bits), start, count).astype(dtype)


def sum_over_lights(
    one: Callable[[Punctual, UInt8[Array, " b"]], Float[Array, "p c"]],
    others: Float[Array, "p c"],
    lights: Punctual,
    bits: UInt8[Array, "n b"],
) -> Float[Array, "p c"]:
    """What each light of a group gives, added to what others give, in the precision of both.

    It is done for one light at a time; derivatives hold nothing of a light but the light itself. Filling, and lights
    that reach none of the points, cost nothing.

    Args:
        one: what a light with its packed visibility gives.
        others: what others give.
        lights: of a group.
        bits: their visibility.
    """
    first = jax.eval_shape(one, *jax.tree.map(lambda x: x[0], (lights, bits)))
    one = jax.checkpoint(one)

    def add(total, given):
        light, bits = given
        return jax.lax.cond(jnp.any(bits), lambda: total + one(light, bits), lambda: total), None

    return jax.lax.scan(add, others.astype(jnp.result_type(others, first)), (lights, bits))[0]


def _incidents(points: SurfacePoints, group: LightGroup):
    if isinstance(group.lights, Directional):
        return ()
    return jax.vmap(lambda light: _arriving(light, points.positions, points.normals))(group.lights)


def _traced_group(points: SurfacePoints, group: LightGroup) -> UInt8[np.ndarray, "n b"]:
    origins, normals, tracer = np.asarray(points.origins), np.asarray(points.normals), points.tracer
    if isinstance(group.lights, Directional):
        return _traced_directions(tracer, origins, normals, group)
    real = np.asarray(group.is_real)
    visible = np.zeros((len(real), -(-len(origins) // 8)), np.uint8)
    for number in np.flatnonzero(real):
        towards, distance, in_front = _arriving_from(group.lights, number, points.positions, points.normals)
        visible[number] = _cast(tracer, origins, in_front, towards, np.asarray(distance) / float(points.radius))
    return visible


def _traced_incidents(tracer, origins, radius, is_real, towards, distance, in_front) -> UInt8[np.ndarray, "n b"]:
    real = np.asarray(is_real)
    visible = np.zeros((len(real), -(-len(origins) // 8)), np.uint8)
    for number in np.flatnonzero(real):
        arrays = in_front[number], towards[number], np.asarray(distance[number]) / float(radius)
        visible[number] = _cast(tracer, np.asarray(origins), *arrays)
    return visible


def _traced_directions(tracer, origins, normals, group: LightGroup) -> UInt8[np.ndarray, "n b"]:
    """Visibility of parallel light, whose direction is one for all points. What carries no light is not traced."""
    lights = group.lights
    assert isinstance(lights, Directional)
    directions, origins, normals = np.asarray(lights.direction), np.asarray(origins), np.asarray(normals)
    lit = np.asarray(group.is_real) & np.asarray(lights.irradiance).any(axis=1)
    visible = np.zeros((len(lit), -(-len(origins) // 8)), np.uint8)
    for number in np.flatnonzero(lit):
        towards = -directions[number] / np.linalg.norm(directions[number])
        visible[number] = _cast(tracer, origins, normals @ towards > 0, towards, None)
    return visible


class Remembered:
    """Bits of rays that were cast before, the latest last."""

    def __init__(self):
        self.bits: collections.OrderedDict[bytes, np.ndarray] = collections.OrderedDict()
        self.held = 0

    def get(self, key: bytes) -> np.ndarray | None:
        """What is remembered, which is the latest then."""
        if key in self.bits:
            self.bits.move_to_end(key)
        return self.bits.get(key)

    def put(self, key: bytes, bits: np.ndarray) -> None:
        """Remembers, and forgets the oldest where there is too much."""
        self.bits[key] = bits
        self.held += len(bits) + _ENTRY_BYTES
        while len(self.bits) > 1 and self.held > _MAX_REMEMBERED:
            self.held -= len(self.bits.popitem(last=False)[1]) + _ENTRY_BYTES


_REMEMBERED: "weakref.WeakKeyDictionary[object, Remembered]" = weakref.WeakKeyDictionary()


def remembered_by(tracer: Tracer) -> Remembered:
    """What is remembered of a tracer's rays, as long as it lives."""
    return _REMEMBERED.setdefault(tracer, Remembered())


def _cast(tracer, origins, in_front, towards, distance) -> UInt8[np.ndarray, " b"]:
    """Which of some points a light reaches, packed.

    Args:
        tracer: of the scene.
        origins: of rays, in scene space.
        in_front: which points are lit unless something stands in the way.
        towards: the light, of each point, or one for all.
        distance: to the light in scene space; None for a distant one.
    """
    in_front = np.asarray(in_front)
    asked = np.flatnonzero(in_front)
    one_for_all, towards = np.ndim(towards) == 1, np.asarray(towards, np.float32)
    towards = towards if one_for_all else towards[asked]
    near = None if distance is None else np.asarray(distance)[asked] - 2 * OFFSET
    key = hashlib.blake2b(origins.data, digest_size=16)
    for array in (np.packbits(in_front), np.ascontiguousarray(towards), *([] if near is None else [near])):
        key.update(array.data)
    remembered = remembered_by(tracer)
    bits = remembered.get(key.digest())
    if bits is None:
        rays = np.broadcast_to(towards, (len(asked), 3))
        if near is None:
            hidden = _on_all_cores(tracer.occluded, origins, asked, rays)
        else:
            # Not as far as the light, so that a lamp's own surface does not hide it.
            hidden = _on_all_cores(tracer.blocked, origins, asked, rays, near)
        visible = np.zeros(len(origins), bool)
        visible[asked] = ~hidden
        bits = np.packbits(visible)
        remembered.put(key.digest(), bits)
    return bits


def _on_all_cores(query, origins, point, *given):
    def part(rows: slice):
        return query(origins[point[rows]], *(x[rows] for x in given))

    return np.concatenate(in_parts(part, len(point), _RAY_CHUNK))


@jax.jit
def _arriving_from(lights: Punctual, number, positions, normals):
    return _arriving(jax.tree.map(lambda x: x[number], lights), positions, normals)


def _arriving(light: Punctual, positions, normals):
    """Unit direction and distance to a light, and whether it is in front of each point and can arrive there."""
    incident: Incident = light.at(positions)
    in_front = jnp.sum(incident.omega_i * normals, axis=1) > 0
    in_front = in_front if incident.within is None else in_front & incident.within
    return incident.omega_i, incident.distance, in_front
