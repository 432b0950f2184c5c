"""Radiance of pixels by samples, as many for each as it is given: work in batches of one shape (Bagher 2011 §3.3).

A piece of work is a pixel and a run of samples. However counts differ, batches hold nothing else, and one shape is
compiled for each kind of BRDF.
"""

import functools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, UInt16

from jaxrelight.lighting.adaptive.sampled_brdf import SampledBrdf
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lights.environment_mipmap import EnvironmentMipmap
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import bucket
from jaxrelight.numerics.random_numbers import MAX_POINTS, random_rotation, vogel_points

# Samples of a piece of work; counts are multiples of it.
RUN = 16
# Pieces of a batch.
_BATCH = 8192
# Cells of the light are so much smaller than what a sample stands for, since what lies between cells is looked up:
# errors are 1 to 5 % smaller than with all of it, and 1 to 3 % than with half.
_COVERED = 0.7

# Whether something stands in the way of each ray: places of the pixels and world directions.
Blocked = Callable[[Int[np.ndarray, " r"], Float[np.ndarray, "r 3"]], Bool[np.ndarray, " r"]]


class SampleWork(eqx.Module):
    """The samples of one component's pixels, in batches of one shape.

    Attributes:
        place: the pixel of every piece of work; past the end for filling.
        first: the number of its first sample.
        number: samples of each pixel in all.
        visible: a bit for each sample of a piece, 1 where nothing hides its light; None without shadows.
    """

    place: Int[Array, "n b"]
    first: Int[Array, "n b"]
    number: Float[Array, " p"]
    visible: UInt16[Array, "n b"] | None = None


def estimate(
    part: SampledBrdf,
    light: EnvironmentMipmap,
    pixels: SurfacePixels,
    counts: Int[np.ndarray, " p"],
    seed: ArrayLike = 0,
    filtered: bool = True,
    blocked: Blocked | None = None,
    report: Callable[[int], None] | None = None,
) -> Float[Array, "p 3"]:
    """Mean reflected radiance; 0 where the count is. Differentiable in the light and the BRDF.

    Args:
        part: a component.
        light: the environment.
        pixels: any.
        counts: samples of each, rounded up to multiples of `RUN`, up to `MAX_POINTS`.
        seed: of the numbers that samples are drawn with.
        filtered: look up the mean of what a sample stands for; else the single texel, whose noise is larger.
        blocked: casts shadows; None for none.
        report: called with the number of samples that are under way.
    """
    dtype = jnp.result_type(light.radiance.values, pixels.omega_o)
    place, first, number = _listed(counts, dtype)
    total, waiting = as_array(np.zeros((len(number), 3)), dtype), []
    for batch in zip(place, first, strict=True):
        if report:
            # Work is handed out ahead of what is done, but by no more than a batch.
            jax.block_until_ready(total)
            report(RUN * len(batch[0]))
        # Directions are drawn in a program of their own: XLA would draw them anew for each of the BRDF's look-ups.
        drawn = _directions(part, pixels, number, *batch, seed)
        if blocked is None:
            total = _added(total, part, light, pixels, number, batch[0], drawn, filtered)
        else:
            waiting.append((batch[0], *_drawn(part, light, pixels, number, batch[0], drawn, filtered)))
            if len(waiting) > 1:
                # Rays are cast while the next batch is drawn.
                total = _lit(total, blocked, *waiting.pop(0))
    for batch in waiting:
        total = _lit(total, blocked, *batch)
    return _mean(total, number)


def list_work(
    part: SampledBrdf,
    pixels: SurfacePixels,
    counts: Int[np.ndarray, " p"],
    seed: ArrayLike = 0,
    blocked: Blocked | None = None,
) -> SampleWork:
    """The work of `estimate` with its shadow rays cast, so that `estimate_listed` needs nothing of the host.

    Args:
        part: a component.
        pixels: any.
        counts: samples of each, as `estimate` takes them.
        seed: of the numbers that samples are drawn with.
        blocked: casts shadows; None for none.
    """
    place, first, number = _listed(counts, pixels.omega_o.dtype)
    # Batches are of few numbers, since each number is compiled; filling is skipped.
    batches = bucket(len(place), 8) if len(place) > 8 else len(place)
    visible = None if blocked is None else np.zeros((batches, _BATCH), np.uint16)
    if blocked is not None and visible is not None:
        for batch, runs in enumerate(zip(place, first, strict=True)):
            drawn = _directions(part, pixels, number, *runs, seed)
            towards = np.asarray(_towards(part, pixels, runs[0], drawn))
            open_to_light = _visible(blocked, runs[0], towards) > 0
            visible[batch] = np.packbits(open_to_light, axis=1, bitorder="little").view(np.uint16)[:, 0]
    filled = np.full((batches, _BATCH), len(number), np.int32), np.zeros((batches, _BATCH), np.int32)
    for padded, listed in zip(filled, (place, first), strict=True):
        padded[: len(listed)] = listed
    places, firsts = map(as_array, filled)
    return SampleWork(places, firsts, number, None if visible is None else as_array(visible))


@functools.partial(jax.jit, static_argnames="filtered")
def estimate_listed(
    part: SampledBrdf,
    light: EnvironmentMipmap,
    pixels: SurfacePixels,
    work: SampleWork,
    seed: ArrayLike = 0,
    filtered: bool = True,
) -> Float[Array, "p 3"]:
    """`estimate` of listed work: pure, and differentiable in the light and the BRDF.

    Args:
        part: a component.
        light: the environment.
        pixels: as they were listed.
        work: from `list_work`.
        seed: as it was listed with.
        filtered: as `estimate` takes it.
    """
    number = work.number

    def add(total, place, first, visible):
        drawn = _directions(part, pixels, number, place, first, seed)
        contribution, _ = _pieces(part, light, pixels, number, place, drawn, filtered)
        if visible is not None:
            bits = (visible[:, None] >> jnp.arange(RUN, dtype=jnp.uint16)[None]) & 1
            contribution = contribution * bits[..., None].astype(contribution.dtype)
        return total.at[place].add(jnp.sum(contribution, axis=1), mode="drop")

    def step(total, batch):
        place, *rest = batch
        has_work = place[0] < len(number)
        return jax.lax.cond(has_work, lambda: jax.checkpoint(add)(total, place, *rest), lambda: total), None

    start = jnp.zeros((len(number), 3), jnp.result_type(light.radiance.values, pixels.omega_o))
    total, _ = jax.lax.scan(step, start, (work.place, work.first, work.visible))
    return _mean(total, number)


def _listed(counts, dtype):
    """Pieces of work in batches [n, _BATCH]: their pixels and first samples; and the samples of each pixel."""
    runs = np.minimum(-(-np.asarray(counts) // RUN), MAX_POINTS // RUN).astype(np.int64)
    place = np.repeat(np.arange(len(runs), dtype=np.int32), runs)
    first = ((np.arange(len(place)) - np.repeat(np.cumsum(runs) - runs, runs)) * RUN).astype(np.int32)
    # Padding belongs to no pixel.
    end = -(-len(place) // _BATCH) * _BATCH - len(place)
    place, first = np.pad(place, (0, end), constant_values=len(runs)), np.pad(first, (0, end))
    return place.reshape(-1, _BATCH), first.reshape(-1, _BATCH), as_array(runs * RUN, dtype)


def _lit(total, blocked, place, given, towards):
    # Held fixed in derivatives, its numbers are known there, too.
    towards = np.asarray(jax.lax.stop_gradient(towards))
    return _summed(total, given, as_array(_visible(blocked, place, towards)), place)


def _visible(blocked: Blocked, place, towards) -> Float[np.ndarray, "k n"]:
    """1 for rays that nothing blocks."""
    flat, point = towards.reshape(-1, 3), np.repeat(np.asarray(place), towards.shape[1])
    x, y, z = flat.T
    real = (x != 0) | (y != 0) | (z != 0)
    visible = np.zeros(len(flat), np.float32)
    visible[real] = ~blocked(*((point, flat) if real.all() else (point[real], flat[real])))
    return visible.reshape(towards.shape[:2])


@jax.jit
def _towards(part, pixels, place, drawn):
    """The world direction of each sample of each piece, 0 where it reflects nothing."""

    def piece(given):
        place, directions = given
        frame, omega_o, uv, footprint, _ = _of(pixels, place)
        point = part.towards(omega_o, uv, footprint)

        def sample(direction):
            drawn = point.weighed(*direction)
            omega = jnp.sum(drawn.omega_i[:, None] * frame, axis=0)
            return jnp.where((place < len(pixels.pixel)) & jnp.any(drawn.weight > 0), omega, 0)

        return jax.vmap(sample)(directions)

    return jax.vmap(piece)((place, drawn))


@jax.jit
def _directions(part, pixels, number, place, first, seed):
    """The [RUN, 3] directions of each piece in its pixel's frame, and their densities."""

    def piece(given):
        place, first = given
        _, omega_o, uv, footprint, pixel = _of(pixels, place)
        point, rotation = part.towards(omega_o, uv, footprint), random_rotation(pixel, seed)
        count = _count(number, place)
        return jax.vmap(lambda index: point.direction(vogel_points(index, count, rotation)))(first + jnp.arange(RUN))

    return jax.lax.stop_gradient(jax.vmap(piece)((place, first)))


def _pieces(part, light, pixels, number, place, drawn, filtered):
    """What each sample gives, and the world direction it comes from, 0 where it gives nothing: [RUN, 3] of a piece."""

    def piece(piece_inputs):
        place, directions = piece_inputs
        frame, omega_o, uv, footprint, _ = _of(pixels, place)
        count = _count(number, place)
        point = part.towards(omega_o, uv, footprint)

        def sample(direction):
            drawn = point.weighed(*direction)
            # The product is written out, since products of small matrices are slow.
            omega = jnp.sum(drawn.omega_i[:, None] * frame, axis=0)
            covered = _COVERED * drawn.solid_angle / count if filtered else None
            contribution = drawn.weight * light.radiance_at(omega, covered)
            real = (place < len(pixels.pixel)) & jnp.any(drawn.weight > 0)
            return contribution, jnp.where(real, omega, 0)

        return jax.vmap(sample)(directions)

    return jax.vmap(jax.checkpoint(piece))((place, drawn))


def _of(pixels, place):
    """What a place has; padding, what the last one has."""
    at = jnp.minimum(place, len(pixels.pixel) - 1)
    arrays = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint, pixels.pixel
    return tuple(x.at[at].get(mode="promise_in_bounds") for x in arrays)


def _count(number, place):
    """Samples of the pixel; 1 for padding, whose pixel may have none."""
    return jnp.maximum(number.at[jnp.minimum(place, len(number) - 1)].get(mode="promise_in_bounds"), 1)


@functools.partial(jax.jit, static_argnames="filtered")
def _drawn(part, light, pixels, number, place, drawn, filtered):
    return _pieces(part, light, pixels, number, place, drawn, filtered)


@jax.jit
def _summed(total, given, visible, place):
    return total.at[place].add(jnp.sum(given * visible[..., None], axis=1), mode="drop")


@jax.jit
def _mean(total, number):
    return total / jnp.maximum(number, 1)[:, None]


@functools.partial(jax.jit, static_argnames="filtered")
def _added(total, part, light, pixels, number, place, drawn, filtered):
    given, _ = _pieces(part, light, pixels, number, place, drawn, filtered)
    return total.at[place].add(jnp.sum(given, axis=1), mode="drop")
