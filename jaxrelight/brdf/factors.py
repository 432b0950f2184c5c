"""Separable factors of a BRDF (Wang 2006 §3.3): the forms, and the one entry to them."""

from collections.abc import Callable, Iterator
from typing import Literal, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored, Symmetric
from jaxrelight.brdf.nonnegative import nonnegative_factors, nonnegative_rows
from jaxrelight.brdf.parametrisation import DISC, Parametrisation
from jaxrelight.brdf.singular import asymmetry, largest_eigen, largest_singular
from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

Form = Literal["svd", "symmetric", "normalised", "nonnegative"]

# The paper's (0, 0) spends terms on grazing angles, where measured BRDFs are large and hardly show. More of the cosine
# is nearer still in most pixels, and farther in the worst ones; unequal powers leave no symmetric form
# (`tests/benchmarks/pictures_by_terms.py`: six BRDFs under eight environments).
COSINE = (0.5, 0.5)

# Directions of which all pairs with others are evaluated at once; bytes of a matrix in double precision, and of any.
_ROWS, _DOUBLE, _MAX_MATRIX_BYTES = 256, 2**28, 3 * 2**29


@overload
def factor(
    brdf: Brdf,
    terms: int = 4,
    resolution: int = 48,
    *,
    form: Literal["svd", "normalised", "nonnegative"] = "svd",
    parametrisation: Parametrisation = DISC,
    cosine: tuple[float, float] = COSINE,
    error: float | None = None,
) -> Factored: ...
@overload
def factor(
    brdf: Brdf,
    terms: int = 4,
    resolution: int = 48,
    *,
    form: Form,
    parametrisation: Parametrisation = DISC,
    cosine: tuple[float, float] = COSINE,
    error: float | None = None,
) -> Factored | Symmetric: ...
def factor(
    brdf: Brdf,
    terms: int = 4,
    resolution: int = 48,
    *,
    form: Form = "svd",
    parametrisation: Parametrisation = DISC,
    cosine: tuple[float, float] = COSINE,
    error: float | None = None,
) -> Factored | Symmetric:
    """A BRDF as a sum of products of maps, for each channel by itself.

    Directions are sampled at the texel centres of a resolution² map (§4), each weighted by the projected solid angle
    of its texel, that is by its cosine. Texels off the hemisphere are continued by applying the BRDF at its edge to
    the other side's maps (Nyström's extension). A BRDF that is the same in all directions becomes one term of one
    texel, exactly. Not differentiable in the BRDF (`refactored` is); the maps are. Matrices above 256 MB are factored
    in single precision.

    Args:
        brdf: what to factor.
        terms: K, the number of products; the most where `error` is given.
        resolution: side of the maps.
        form: "svd", the products of least squared error (§3.3.1), √σ on either side; "symmetric", the same for a
            reciprocal BRDF by its eigenvectors, one map and a sign for each term; "normalised", a single term of
            light-side reflectance times the mean distribution over the view (Kautz and McCool 1999), non-negative;
            "nonnegative", products of maps that are nowhere negative, of a least squared error near by (alternating
            least squares, column by column, from the larger parts of the singular vectors).
        parametrisation: of the maps: `DISC` (eq. 10) or `POLAR` (eq. 11).
        cosine: powers of cosθ_i and of cosθ_o by which the error that is minimised is multiplied; the maps are those
            of the BRDF itself all the same. (0, 0) leaves the cosine out as the paper does, (1, 0) folds it in as Liu
            et al. 2004 do. Some of it keeps terms from being spent on peaks at grazing angles, which hardly show.
        error: as few terms as leave no more than this of any channel's weighted root mean square, 0 … 1.

    Raises:
        InputError: if `terms` do not reach `error`; if more terms are asked for than the map has directions, or than a
            form has; if the matrix would take more than 1.5 GB; if the symmetric form is asked of a BRDF that is not
            reciprocal, or with two different powers of the cosine; if the non-negative form is asked of one that is
            negative somewhere.
    """
    if form not in _FORMS:
        raise InputError(f"the form of factors is '{form}'; known are {', '.join(_FORMS)}")
    if brdf.is_constant:
        up = as_array([0.0, 0.0, 1.0])
        value = brdf.evaluate(up, up)[None, :, None, None]
        if form == "symmetric":
            return Symmetric(jnp.sqrt(jnp.abs(value)), jnp.sign(value[:, :, 0, 0]), parametrisation)
        return Factored(jnp.ones_like(value[:, :1]), value, parametrisation)
    samples = Samples(brdf, parametrisation, resolution, cosine)
    check_terms(terms, resolution, parametrisation)
    if error is None:
        return _FORMS[form](samples, terms)
    if not 0 < error < 1:
        raise InputError(f"the error of factors must lie between 0 and 1, not {error}")
    return _fewest(samples, form, terms, error)


def factor_error(brdf: Brdf, factors: Factored | Symmetric, cosine: tuple[float, float] = COSINE) -> float:
    """What factors leave of a BRDF: the relative root mean square, weighted as in `factor`, of the worst channel.

    Args:
        brdf: of several directions.
        factors: of it.
        cosine: powers by which the error is weighted.
    """
    maps = factors.maps if isinstance(factors, Symmetric) else factors.light_maps
    samples = Samples(brdf, factors.parametrisation, maps.shape[-1], cosine)
    return float(_errors(samples, factors)[-1])


def check_terms(terms: int, resolution: int, parametrisation: Parametrisation = DISC) -> None:
    """Finds out, before long work, whether maps have enough directions for so many terms.

    Raises:
        InputError: if they have not.
    """
    count = int(parametrisation.directions(resolution)[1].sum())
    if not 1 <= terms <= count:
        raise InputError(f"{terms} terms cannot be had from {count} directions; ask for 1 to {count}")


class Samples:
    """A BRDF between the texels of a map: the weighted matrix of a channel, and products with unweighted rows."""

    def __init__(self, brdf: Brdf, parametrisation: Parametrisation, side: int, cosine: tuple[float, float]):
        omega, self.inside = parametrisation.directions(side)
        count = int(self.inside.sum())
        if count**2 * 4 > _MAX_MATRIX_BYTES:
            raise InputError(f"factors of resolution {side} need {count**2 * 4 / 2**30:.1f} GiB; ask for at most 128")
        self.brdf, self.parametrisation, self.side, self.cosine = brdf, parametrisation, side, cosine
        self.dtype = jax.dtypes.canonicalize_dtype(float)
        self.every, self.omega, self.rest = omega, omega[self.inside], omega[~self.inside]
        root = np.sqrt(parametrisation.measure(side)[self.inside])
        self.light, self.view = (root * self.omega[:, 2] ** power for power in cosine)
        self.channels, self._alike = brdf.channels, None

    def matrix(self, channel: int) -> Float[np.ndarray, "m m"]:
        """Weighted values [i, o] of one channel."""
        n = len(self.omega)
        values = np.empty((n, n), np.float64 if n * n * 8 <= _DOUBLE else np.float32)
        alike = np.ones((self.channels, self.channels), bool)
        for rows, block, same in self._blocks(self.omega, self.omega, channel):
            values[rows] = block
            values[rows] *= self.light[rows, None] * self.view
            alike &= same
        self._alike = alike
        return values

    def like(self, channel: int) -> int:
        """The first channel whose matrix is the same; `matrix` has been asked for an earlier one."""
        return channel if self._alike is None else int(np.argmax(self._alike[channel]))

    def times(
        self,
        channel: int,
        omega: Float[np.ndarray, "w 3"],
        vectors: Float[np.ndarray, "m k"],
        *,
        swapped: bool = False,
    ) -> Float[np.ndarray, "w k"]:
        """Σ_o f(ω, ω_o) vectors_o of any directions, or Σ_i f(ω_i, ω) vectors_i where swapped: [ω, vectors]."""
        products = np.zeros((len(omega), vectors.shape[1]))
        for rows, block, _ in self._blocks(omega, self.omega, channel, swapped):
            products[rows] = block.astype(float) @ vectors
        return products

    def _blocks(self, omega, other, channel, swapped=False) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Values [rows, other] of a few rows at a time, and which channels are alike in them."""
        # One shape, whatever is asked for: the last block overlaps the one before it, or its last row comes again.
        size, last = min(_ROWS, len(self.omega)), len(omega) - 1
        other, channel, swapped = as_array(other, self.dtype), as_array(channel), as_array(swapped)
        for start in range(0, len(omega), size):
            start = max(min(start, len(omega) - size), 0)
            chosen = as_array(omega[np.minimum(np.arange(start, start + size), last)], self.dtype)
            block, same = _evaluate(self.brdf, chosen, other, channel, swapped)
            rows = slice(start, min(start + size, len(omega)))
            yield rows, np.asarray(block)[: rows.stop - start], np.asarray(same)

    def joined(self, inside: Float[np.ndarray, "m k"], rest: Float[np.ndarray, "r k"]) -> Float[np.ndarray, "k t"]:
        """Texels [k, t] from values [·, k] at those on the hemisphere and those off it."""
        texels = np.zeros((inside.shape[1], self.side**2))
        texels[:, self.inside], texels[:, ~self.inside] = inside.T, rest.T
        return texels

    def maps(self, values: Float[np.ndarray, "k c t"]) -> Float[Array, "k c r r"]:
        """Texels [k, c, t] as maps."""
        k, c, _ = values.shape
        return as_array(values.reshape(k, c, self.side, self.side), self.dtype)


@eqx.filter_jit
def _evaluate(brdf: Brdf, omega, other, channel, swapped):
    def pair(one, another):
        return brdf.evaluate(jnp.where(swapped, another, one), jnp.where(swapped, one, another))

    def row(one):
        return jax.vmap(pair, in_axes=(None, 0))(one, other)

    values = jax.lax.map(row, omega)
    same = jnp.all(values[..., :, None] == values[..., None, :], axis=(0, 1))
    return jnp.take(values, channel, axis=-1), same


def _by_channel(samples: Samples, make: Callable[[int], tuple[np.ndarray, ...]]) -> list[np.ndarray]:
    """What make(channel) returns, arrays [k, …], for every channel in axis 1; channels alike share it."""
    by_channel = []
    for c in range(samples.channels):
        first = samples.like(c)
        by_channel.append(by_channel[first] if first < c else make(c))
    return [np.stack(parts, axis=1) for parts in zip(*by_channel, strict=True)]


def _svd(samples: Samples, terms: int) -> Factored:
    def make(c: int):
        u, sigma, v = largest_singular(samples.matrix(c), terms)
        root, over_root = _roots(sigma)
        light_rest = samples.times(c, samples.rest, samples.view[:, None] * v)
        view_rest = samples.times(c, samples.rest, samples.light[:, None] * u, swapped=True)
        light = samples.joined(root * u / samples.light[:, None], over_root * light_rest)
        return light, samples.joined(root * v / samples.view[:, None], over_root * view_rest)

    light, view = _by_channel(samples, make)
    return Factored(samples.maps(light), samples.maps(view), samples.parametrisation)


def _symmetric(samples: Samples, terms: int) -> Symmetric:
    """M = Q D Qᵀ: √|D| Q on both sides, and the sign of D. The singular values are |D|."""
    if samples.cosine[0] != samples.cosine[1]:
        raise InputError("the symmetric form needs the same power of the cosine on both sides")

    def make(c: int):
        matrix = samples.matrix(c)
        if asymmetry(matrix) > 1e-3:
            raise InputError("the symmetric form needs a reciprocal BRDF, and this one is not; use the form 'svd'")
        value, q = largest_eigen(matrix, terms)
        root, over_root = _roots(np.abs(value))
        rest = np.sign(value) * over_root * samples.times(c, samples.rest, samples.light[:, None] * q)
        return samples.joined(root * q / samples.light[:, None], rest), np.sign(value)

    maps, signs = _by_channel(samples, make)
    return Symmetric(samples.maps(maps), as_array(signs, samples.dtype), samples.parametrisation)


def _normalised(samples: Samples, terms: int) -> Factored:
    """Takes g = mean of f over ω_o and h = mean of f/g over ω_i: exact where f is a product, and never negative."""
    if terms != 1:
        raise InputError(f"the normalised form has one term, not {terms}")
    inside = samples.inside
    light = np.zeros((1, samples.channels, samples.side**2))
    view = np.zeros_like(light)
    over_i, over_o = (weight**2 / np.sum(weight**2) for weight in (samples.light, samples.view))
    for c in range(samples.channels):
        light[0, c] = samples.times(c, samples.every, over_o[:, None])[:, 0]
        mean = light[0, c, inside]
        shares = np.where(mean > 0, over_i / np.where(mean > 0, mean, 1), 0)
        view[0, c] = samples.times(c, samples.every, shares[:, None], swapped=True)[:, 0]
    return Factored(samples.maps(light), samples.maps(view), samples.parametrisation)


def _nonnegative(samples: Samples, terms: int) -> Factored:
    """The weighted matrix as a product of two that are nowhere negative."""

    def make(c: int):
        matrix = samples.matrix(c)
        if matrix.min() < 0:
            raise InputError("the non-negative form needs a BRDF that is nowhere negative; use the form 'svd'")
        g, h = nonnegative_factors(matrix, *largest_singular(matrix, terms))
        light_rest = samples.times(c, samples.rest, samples.view[:, None] * h)
        view_rest = samples.times(c, samples.rest, samples.light[:, None] * g, swapped=True)
        light = samples.joined(g / samples.light[:, None], nonnegative_rows(light_rest, h.T @ h))
        return light, samples.joined(h / samples.view[:, None], nonnegative_rows(view_rest, g.T @ g))

    light, view = _by_channel(samples, make)
    return Factored(samples.maps(light), samples.maps(view), samples.parametrisation)


_FORMS = {"svd": _svd, "symmetric": _symmetric, "normalised": _normalised, "nonnegative": _nonnegative}


def _fewest(samples: Samples, form: Form, terms: int, error: float) -> Factored | Symmetric:
    """The factors of the fewest terms whose error is small enough."""
    first = 0
    if form == "nonnegative":
        # Many terms take minutes: few are tried first, and twice as many each time.
        tried = 1
        while tried < terms and _errors(samples, _nonnegative(samples, tried))[-1] > error:
            first, tried = tried, 2 * tried
        terms = min(tried, terms)
    factors = _FORMS[form](samples, terms)
    errors = _errors(samples, factors)
    if errors[-1] > error:
        raise InputError(
            f"{terms} terms leave an error of {100 * errors[-1]:.2g} %, more than {100 * error:.2g} %; allow more"
        )
    if form != "nonnegative":  # whose first terms are not those of fewer
        return jax.tree.map(lambda maps: maps[: int(np.argmax(errors <= error)) + 1], factors)
    low, high = first, terms
    while high - low > 1:
        middle = (low + high) // 2
        fewer = _nonnegative(samples, middle)
        if _errors(samples, fewer)[-1] > error:
            low = middle
        else:
            high, factors = middle, fewer
    return factors


def _errors(samples: Samples, factors: Factored | Symmetric) -> np.ndarray:
    """Relative weighted error of the first 1, 2, … products, of the channel where it is largest: [k]."""
    maps = (
        (factors.maps, factors.signs[..., None, None] * factors.maps)
        if isinstance(factors, Symmetric)
        else (
            factors.light_maps,
            factors.view_maps,
        )
    )
    errors = np.zeros((samples.channels, factors.terms))
    for c in range(samples.channels):
        matrix = samples.matrix(c)
        g, h = (
            np.asarray(side, float).reshape(*side.shape[:2], -1)[:, c, samples.inside] * weight
            for side, weight in zip(maps, (samples.light, samples.view), strict=True)
        )
        square = np.vdot(matrix, matrix)
        along = np.cumsum(np.sum((g @ matrix) * h, axis=1))
        gram = np.cumsum(np.cumsum((g @ g.T) * (h @ h.T), axis=0), axis=1).diagonal()
        errors[c] = np.sqrt(np.maximum(square - 2 * along + gram, 0) / max(square, np.finfo(float).tiny))
    return errors.max(axis=0)


def _roots(sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """√σ, and its inverse where σ is more than rounding."""
    root = np.sqrt(sigma)
    good = sigma > 1e-12 * sigma[0]
    return root, np.where(good, 1 / np.where(good, root, 1), 0)
