"""Means over the sphere weighted by max(0, cos)ⁿ: lat-long maps convolved with the lobes of a cosine power.

Lobes of moderate exponents damp spherical harmonics (Ramamoorthi and Hanrahan 2001): a map is written in them once, and
each exponent reads its means from a few thousand numbers. Kernels that are sharper, or have an edge at the horizon, are
summed row by row.
"""

import functools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.basis import latlong

# A kernel is followed down to this share of its peak.
_MIN_KERNEL_WEIGHT = 1e-6


# Exponents whose lobes are filtered by harmonics, whose coefficients are followed down to this share.
_BY_HARMONICS, _MIN_BAND = (4.0, 1024.0), 1e-6
# Rows whose integrals are made at a time: all functions of a fine map's rows are several times the map.
_ROW_BATCH = 64
# Orders that harmonics are used to, each of which is compiled.
_ORDERS = 24, 32, 48, 64, 96, 128, 176


def filtered_maps(
    pixels: Float[Array | np.ndarray, "h w c"], exponents: Sequence[float], heights: Sequence[int]
) -> list[Float[Array, "_ _ c"]]:
    """The means of `zonal_means` for several exponents, each as a lat-long map of a number of rows of its own.

    Every pixel is a constant cell. Linear and differentiable in the pixels.

    Args:
        pixels: a map of any size.
        exponents: of the lobes.
        heights: rows of each map, even numbers; columns are twice as many.
    """
    pairs = list(zip(exponents, heights, strict=True))
    orders = {n: _order(n) for n, _ in pairs if _BY_HARMONICS[0] <= n <= _BY_HARMONICS[1]}
    # A map with fewer rows than that would ring.
    orders = {n: orders[n] for n, rows in pairs if n in orders and orders[n] <= rows}
    coefficients, height = None, pixels.shape[0]
    if orders:
        # An odd number of rows has no mirror image of each.
        even = pixels if height % 2 == 0 else latlong.resized(pixels, height + 1, pixels.shape[1])
        order = max(orders.values())
        coefficients = _analysed(jnp.asarray(even), _row_integrals(even.shape[0], order, pixels.dtype))
    maps, resized = [], {}
    for exponent, rows in pairs:
        if exponent in orders and coefficients is not None:
            order = orders[exponent]
            bands = lobe_bands(exponent, order).astype(pixels.dtype)
            functions = _at_rows(rows, order, pixels.dtype)
            maps.append(_synthesised(coefficients[: order + 1, : order + 1], bands, functions, rows))
            continue
        if rows not in resized:
            resized[rows] = jnp.asarray(latlong.resized(pixels, rows, 2 * rows))
        maps.append(zonal_means(resized[rows], exponent))
    return maps


def _order(exponent: float) -> int:
    """The order of harmonics that a lobe needs: one of few."""
    bands = np.abs(lobe_bands(exponent, max(_ORDERS)))
    needed = int(np.flatnonzero(bands > _MIN_BAND).max())
    return next((order for order in _ORDERS if order >= needed), max(_ORDERS))


def lobe_bands(exponent: float, order: int) -> Float[np.ndarray, " b"]:
    """A_l, l = 0 … order, of the lobe max(0, cosθ)ⁿ (n + 1)/2π, whose integral is 1.

    A_l = (n + 1) ∫₀¹ tⁿ P_l(t) dt: A_0 = 1, A_1 = (n + 1)/(n + 2), A_l = A_{l−2} (n − l + 2)/(n + l + 1).
    """
    bands = [1.0, (exponent + 1) / (exponent + 2)]
    for degree in range(2, order + 1):
        bands.append(bands[-2] * (exponent - degree + 2) / (exponent + degree + 1))
    return np.array(bands[: order + 1])


def _legendre(cosine: Float[np.ndarray, " p"], order: int) -> Float[np.ndarray, "m l p"]:
    """P_lm(cosθ), m and l = 0 … order, normalised so that P_lm e^{imφ} is orthonormal; 0 for m > l.

    The recurrence in l is the normalised one (Holmes and Featherstone 2002).
    """
    sine, m = np.sqrt(np.maximum(1 - cosine**2, 0)), np.arange(order + 1)[:, None]
    values = np.zeros((order + 1, order + 1, len(cosine)))
    diagonal = np.full(len(cosine), math.sqrt(1 / (4 * math.pi)))
    for degree in range(order + 1):
        if degree:
            diagonal = diagonal * sine * math.sqrt((2 * degree + 1) / (2 * degree))
            below = m[:degree].astype(float)
            a = np.sqrt((4 * degree**2 - 1) / (degree**2 - below**2))
            before = values[:degree, degree - 2] if degree > 1 else 0.0
            b = np.sqrt(np.maximum((degree - 1) ** 2 - below**2, 0) / (4 * (degree - 1) ** 2 - 1)) if degree > 1 else 0
            values[:degree, degree] = a * (cosine * values[:degree, degree - 1] - b * before)
        values[degree, degree] = diagonal
    return values


@functools.lru_cache(maxsize=4)
def _row_integrals(height: int, order: int, dtype: np.dtype) -> Float[np.ndarray, "m l r"]:
    """∫ P_lm sinθ dθ over each row of the upper half of a map."""
    place, weight = np.polynomial.legendre.leggauss(3 + 2 * order // height)
    step = np.pi / height
    polar = ((np.arange(height // 2) + 0.5) * step)[:, None] + place * (step / 2)
    # The sum over a row's places is made to be its exact solid angle, so that a constant has no other harmonics.
    sine = np.sin(polar) * weight
    exact = np.diff(-np.cos(np.arange(height // 2 + 1) * step))
    sine *= (exact / sine.sum(axis=1))[:, None]
    integrals = np.empty((order + 1, order + 1, height // 2), dtype)
    for start in range(0, height // 2, _ROW_BATCH):
        rows = slice(start, start + _ROW_BATCH)
        values = _legendre(np.cos(polar[rows]).ravel(), order).reshape(order + 1, order + 1, *polar[rows].shape)
        integrals[..., rows] = np.einsum("mlrg,rg->mlr", values, sine[rows])
    return integrals


@functools.lru_cache(maxsize=32)
def _at_rows(height: int, order: int, dtype: np.dtype) -> Float[np.ndarray, "m l r"]:
    """P_lm at the centres of the upper half's rows."""
    return _legendre(np.cos((np.arange(height // 2) + 0.5) * (np.pi / height)), order).astype(dtype)


@jax.jit
def _analysed(pixels: Float[Array, "h w c"], integrals: Float[Array, "m l r"]) -> Array:
    """Coefficients [m, l, c] in P_lm e^{imφ}, complex, φ from the first column's left edge."""
    width, order = pixels.shape[1], integrals.shape[0] - 1
    m = np.arange(order + 1)
    waves = jnp.fft.rfft(pixels, axis=1)
    # Sampled at the centres of cells, shorter waves are longer ones again.
    again = m % width
    waves = waves[:, np.minimum(again, width - again)]
    waves = jnp.where(jnp.asarray(again > width // 2)[None, :, None], waves.conj(), waves)
    # Cells are constant, and their centres half a column from the edge.
    cells = (2 * np.pi / width) * np.sinc(m / width) * np.exp(-1j * np.pi * m / width)
    waves = waves * jnp.asarray(cells, waves.dtype)[None, :, None]
    half = pixels.shape[0] // 2
    upper, lower = waves[:half], waves[half:][::-1]
    # P_lm is even about the equator where l + m is even.
    parts = jnp.concatenate([upper + lower, upper - lower], axis=-1)
    parts = jnp.concatenate([parts.real, parts.imag], axis=-1)
    summed = jnp.einsum("mlr,rmc->mlc", integrals.astype(pixels.dtype), parts, precision="highest")
    even, odd, even_imaginary, odd_imaginary = jnp.split(summed, 4, axis=-1)
    is_even = jnp.asarray((m[:, None] + m[None]) % 2 == 0)[..., None]
    return jax.lax.complex(jnp.where(is_even, even, odd), jnp.where(is_even, even_imaginary, odd_imaginary))


@functools.partial(jax.jit, static_argnames="height")
def _synthesised(
    coefficients: Array, bands: Float[Array, " b"], functions: Float[Array, "m l r"], height: int
) -> Float[Array, "{height} w c"]:
    """A map of what is damped by the bands of a lobe."""
    width, order = 2 * height, functions.shape[0] - 1
    damped = coefficients * bands.astype(coefficients.real.dtype)[None, :, None]
    m = np.arange(order + 1)
    is_even = jnp.asarray((m[:, None] + m[None]) % 2 == 0)[..., None]
    parts = jnp.concatenate([jnp.where(is_even, damped, 0), jnp.where(is_even, 0, damped)], axis=-1)
    parts = jnp.concatenate([parts.real, parts.imag], axis=-1)
    summed = jnp.einsum("mlr,mlc->rmc", functions.astype(parts.dtype), parts, precision="highest")
    even, odd, even_imaginary, odd_imaginary = jnp.split(summed, 4, axis=-1)
    even, odd = jax.lax.complex(even, even_imaginary), jax.lax.complex(odd, odd_imaginary)
    waves = (
        jnp.concatenate([even + odd, (even - odd)[::-1]])
        * jnp.asarray(width * np.exp(1j * np.pi * m / width), even.dtype)[None, :, None]
    )
    count = width // 2 + 1
    waves = waves[:, :count] if order + 1 >= count else jnp.pad(waves, ((0, 0), (0, count - order - 1), (0, 0)))
    return jnp.fft.irfft(waves, n=width, axis=1).astype(functions.dtype)


def zonal_means(pixels: Float[Array, "h w c"], exponent: float) -> Float[Array, "h w c"]:
    """∫ L(ω) max(0, p·ω)ⁿ dω / ∫ max(0, p·ω)ⁿ dω at p = the centre of every pixel. Linear and differentiable in L.

    The kernel is taken at the centres of pixels, so a map should have at least 4π√(n + 1) rows; its sum is what is
    divided by, so that a constant stays constant and means of what is not negative are not negative. Between two rows
    it depends on the difference of longitudes alone: rows are convolved by their Fourier transforms.

    Raises:
        ValueError: for an odd number of rows.
    """
    height = pixels.shape[0]
    if height % 2:
        raise ValueError(f"zonal means need an even number of rows, not {height}")
    return _means(pixels, jnp.asarray(exponent, pixels.dtype), _reach(exponent, height))


def _reach(exponent: float, height: int) -> int:
    """Rows to either side that the kernel is followed: one of few numbers, each of which is compiled."""
    angle = math.acos(_MIN_KERNEL_WEIGHT ** (1 / exponent)) if exponent > 0 else math.pi / 2
    rows = math.ceil(angle / math.pi * height) + 1
    return height - 1 if 4 * rows >= height else 2 ** math.ceil(math.log2(rows))


@functools.partial(jax.jit, static_argnames="reach")
def _means(pixels: Float[Array, "h w c"], exponent: Float[Array, ""], reach: int) -> Float[Array, "h w c"]:
    height, width, channels = pixels.shape
    dtype = pixels.dtype
    # Kernels of the lower half are those of the upper one upside down, and so serve the map upside down.
    mirrored = jnp.concatenate([pixels, pixels[::-1]], axis=-1)
    solid_angle = jnp.asarray(latlong.solid_angles(height, width), dtype)
    around = [(reach, reach)]
    waves = jnp.pad(jnp.fft.rfft(mirrored * solid_angle[:, None, None], axis=1), [*around, (0, 0), (0, 0)])
    solid_angle = jnp.pad(solid_angle, around)
    polar = (jnp.arange(-reach, height + reach, dtype=dtype) + 0.5) * (np.pi / height)
    turned = 2 * jnp.sin(jnp.arange(width, dtype=dtype) * (np.pi / width)) ** 2

    @jax.checkpoint  # The transpose makes kernels again: those of all rows are several times the map.
    def row(i):
        def near(rows):
            return jax.lax.dynamic_slice_in_dim(rows, i, 2 * reach + 1)

        # 1 − cos of the angle between two directions, without cancellation where they are close.
        there, here = near(polar), polar[i + reach]
        gap = 2 * jnp.sin((there - here) / 2)[:, None] ** 2 + (jnp.sin(there) * jnp.sin(here))[:, None] * turned[None]
        above = (gap < 1) & (near(solid_angle) > 0)[:, None]
        kernel = jnp.where(above, jnp.exp(exponent * jnp.log1p(-jnp.where(above, gap, 0))), 0)
        # A kernel is even in longitude: its transform is real.
        kernel = jnp.fft.rfft(kernel, axis=1).real
        return jnp.einsum("jm,jmc->mc", kernel, near(waves)) / jnp.sum(kernel[:, 0] * near(solid_angle))

    means = jnp.fft.irfft(jax.lax.map(row, jnp.arange(height // 2)), n=width, axis=1)
    return jnp.concatenate([means[..., :channels], means[::-1, :, channels:]]).astype(dtype)
