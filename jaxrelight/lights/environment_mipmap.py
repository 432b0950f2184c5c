"""An environment's means over ever larger cells: what samples look up, and how light varies around them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.basis import latlong
from jaxrelight.basis.local_frequency import around_sphere, local_frequency
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.sky import Sky, turned
from jaxrelight.lights.sun import without_sun
from jaxrelight.numerics.arrays import as_array, is_traced, on_host

# Rows of the finest level, at most: its cells, a sixth of a degree, are narrower than lobes of exponents to 100,000.
# All levels take eleven numbers for each of its pixels.
_MAX_ROWS = 1024
# Rows of the finest level of what predicts: it needs no finer map.
_DETAIL_ROWS = 512
# Steps from a level to the next. Cells one step too large or small for what a sample stands for cost quality: with one
# step the errors of samples are up to half as large again.
_STEPS = 2
# Numbers of a cell are this many, or a multiple, which are read and weighed at once: filtered samples take 15 to 25 %
# less time than with three.
_CHANNEL_CHUNK = 4


class Cells(eqx.Module):
    """Means of a lat-long map over cells, each level's as wide as four of the one before, by solid angle.

    Attributes:
        values: of all levels one after the other, the finest first, each followed by what lies on the way to the next;
            beyond the map's channels, zeros.
        rows: of the finest level, a power of two; twice as many columns.
        channels: of the map.
    """

    values: Float[Array, "t n"]
    rows: int = eqx.field(static=True)
    channels: int = eqx.field(static=True)

    def look_up(
        self, u: Float[Array, ""], v: Float[Array, ""], solid_angle: Float[Array, ""] | None = None
    ) -> Float[Array, " c"]:
        """The mean over about a solid angle, between the cells of a level; without one, or a small one, in a texel."""
        if solid_angle is None:
            row, column = (v * self.rows).astype(jnp.int32), (u * 2 * self.rows).astype(jnp.int32)
            place = jnp.clip(row, 0, self.rows - 1) * 2 * self.rows + (column & (2 * self.rows - 1))
            # Read alone, the zeros would cost more than they save.
            return jax.lax.dynamic_slice(self.values, (place, 0), (1, self.channels))[0]
        area = 2 * np.pi**2 / (2 * self.rows**2) * jnp.maximum(jnp.sin(np.pi * v), 0.5 / self.rows)
        step = jnp.round(0.5 * _STEPS * jnp.log2(solid_angle / area)).astype(jnp.int32)
        step = jnp.clip(step, 0, _STEPS * (self.rows.bit_length() - 1))
        level = step // _STEPS
        rows = self.rows >> level
        # Cells before a level: so many times 2·(rows² + rows²/4 + …).
        start = _STEPS * ((8 * self.rows**2 - 8 * rows**2) // 3) + step % _STEPS * 2 * rows**2
        # Environments are constant in their pixels.
        between = jnp.where(step > 0, 0.5, 0)
        x, y = u * (2 * rows) - between, v * rows - between
        left, top = jnp.floor(x), jnp.floor(y)
        right, down = (jnp.where(step > 0, part, 0) for part in (x - left, y - top))
        column, row = left.astype(jnp.int32), top.astype(jnp.int32)
        radiance = jnp.zeros(self.values.shape[1], self.values.dtype)
        for i in (0, 1):
            for j in (0, 1):
                # Rows are a power of two: columns go around by their bits.
                place = start + jnp.clip(row + i, 0, rows - 1) * (2 * rows) + ((column + j) & (2 * rows - 1))
                cell = self.values.at[place].get(mode="promise_in_bounds")
                radiance += (down if i else 1 - down) * (right if j else 1 - right) * cell
        return radiance[: self.channels]


class EnvironmentMipmap(eqx.Module):
    """An environment as samples see it. Linear in the environment and differentiable.

    Attributes:
        radiance: three channels, without the sun, as the environment is turned by 0.
        detail: of the mean of the channels, radiance, its square, and radiance times the square of bandwidth in cycles
            per radian: what predicts. None of an environment whose pixels are traced.
        sun: what outshines all that by far, as directions in the world.
        turn: by which the environment is turned about +y, as a part of the circle.
        scale: factor on radiance and detail.
    """

    radiance: Cells
    detail: Cells | None
    sun: Sky
    turn: Float[Array, ""]
    scale: Float[Array, ""]

    def radiance_at(self, omega: Float[Array, "3"], solid_angle: Float[Array, ""] | None = None) -> Float[Array, "3"]:
        """Mean radiance of about a solid angle around a direction; without one, of its texel."""
        return self.scale * self.radiance.look_up(*self._place(omega), solid_angle)

    def detail_at(
        self, omega: Float[Array, "3"], solid_angle: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        """Mean radiance, its mean square and root-mean-square bandwidth of about a solid angle around a direction."""
        assert self.detail is not None
        mean, square, varied = self.detail.look_up(*self._place(omega), solid_angle)
        some = (mean > 0) & (varied > 0)
        bandwidth = jnp.where(some, jnp.sqrt(jnp.where(some, varied, 1) / jnp.where(some, mean, 1)), 0)
        return self.scale * mean, self.scale**2 * square, bandwidth

    def _place(self, omega):
        u, v = latlong.finite_coordinates(omega)
        u = u + self.turn
        return u - jnp.floor(u), v


def light_bandwidth(pixels: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "g v"]:
    """Local angular bandwidth of a lat-long map in cycles per radian (Bagher 2011 §2.4), of a map of 2^n rows.

    A pixel is as wide as it is high in angle, the larger eigenvalue of the map's Jacobian.
    """
    rows = _power_of_two(len(pixels))
    even = latlong.resized(np.asarray(pixels, np.float32), rows, 2 * rows)
    return local_frequency(around_sphere(even))[:rows] * (rows / np.pi)


def environment_mipmap(environment: Environment) -> EnvironmentMipmap:
    """The mipmap of an environment, as it is turned and scaled."""
    pixels = environment.pixels
    if len(pixels) > _MAX_ROWS:
        # Before anything else: each of the steps below takes several times the memory of its map.
        pixels = latlong.resized(on_host(pixels), _MAX_ROWS, 2 * _MAX_ROWS)
    pixels, sun = without_sun(pixels)
    turn, scale = (as_array(number, pixels.dtype) for number in (environment.rotate_y / 360, environment.scale))
    sun = Sky(turned(sun.directions, environment.rotate_y), sun.irradiance * scale)
    known = jax.lax.stop_gradient(pixels)
    detail = None if is_traced(known) else _detail(np.asarray(known, np.float32))
    return EnvironmentMipmap(cells(on_host(pixels)), detail, sun, turn, scale)


def _detail(pixels: Float[np.ndarray, "h w 3"]) -> Cells:
    """See `EnvironmentMipmap.detail`; of a map without its sun, which no sample would find."""
    bandwidth = light_bandwidth(pixels)
    grey = pixels.mean(axis=2, keepdims=True)
    finest = latlong.resized(np.concatenate([grey, grey**2], axis=2), len(bandwidth), 2 * len(bandwidth))
    finest = np.concatenate([finest, finest[..., :1] * bandwidth[..., None] ** 2], axis=2)
    rows = min(len(bandwidth), _DETAIL_ROWS)
    return cells(latlong.resized(finest, rows, 2 * rows).astype(np.float32))


def cells(pixels: Float[Array | np.ndarray, "h w c"]) -> Cells:
    """All levels of a lat-long map of any size; differentiable where its pixels are JAX's."""
    return _compiled_cells(pixels) if isinstance(pixels, jax.Array) else _cells(pixels)


def _cells(pixels) -> Cells:
    numbers, (height, _, channels) = jnp if isinstance(pixels, jax.Array) else np, pixels.shape
    rows = _power_of_two(height)
    level = latlong.resized(numbers.pad(pixels, ((0, 0), (0, 0), (0, -channels % _CHANNEL_CHUNK))), rows, 2 * rows)
    levels = []
    while len(level) > 1:
        coarser = latlong.resized(level, len(level) // 2, len(level))
        towards = _between(coarser) - level
        levels += [level + k / _STEPS * towards for k in range(_STEPS)]
        level = coarser
    levels.append(level)
    return Cells(as_array(numbers.concatenate([one.reshape(-1, level.shape[-1]) for one in levels])), rows, channels)


_compiled_cells = jax.jit(_cells)


def _between(coarse):
    """A map of twice the rows and columns, linear between the centres of cells."""
    numbers = jnp if isinstance(coarse, jax.Array) else np
    columns = [3 * coarse + numbers.roll(coarse, way, axis=1) for way in (1, -1)]
    wide = numbers.stack(columns, axis=2).reshape(len(coarse), 2 * coarse.shape[1], -1)
    rows = [3 * wide + wide[np.clip(np.arange(len(wide)) + way, 0, len(wide) - 1)] for way in (-1, 1)]
    return numbers.stack(rows, axis=1).reshape(2 * len(coarse), *wide.shape[1:]) / 16


def _power_of_two(count: int) -> int:
    return 1 << max(0, int(np.ceil(np.log2(count))))
