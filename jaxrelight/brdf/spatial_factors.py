"""Factors shared by all texels of a spatial BRDF, for receivers that know no view (Wang 2006 §3.1 and eq. 1).

Every texel's lobes are written as Σ_b w_b shape_b, of a few shapes chosen among the texels' own, and the shapes are
factored together: Σ_b w_b(u, v) shape_b(ω_i, ω_o) ≈ Σ_k g_k(ω_i) · Σ_b w_b(u, v) h_bk(ω_o). Transport holds K terms
however many texels and shapes there are; weights multiply at the view, where they are as sharp as the map.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float, Int, PyTree

from jaxrelight.brdf.factors import COSINE, Samples
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.pairs import spread_pairs
from jaxrelight.brdf.parametrisation import DISC, look_up
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Footprint, Texture
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import float_dtype

# Shapes are sought until so little of the lobes is left, at most so many; among so many lobes, compared in so many
# pairs of directions. Lobes whose weights are solved for together.
TOLERANCE, MAX_SHAPES, _CANDIDATES, _PAIRS, _TEXEL_BATCH = 0.02, 24, 1024, 1024, 4096


class SpatialFactors(Reflection):
    """K light maps for all texels, K view maps of every shape, and the shapes' weights over the surface.

    Attributes:
        light_maps: g_k.
        view_maps: h_bk.
        weights: of shapes and channels, channels fastest.
    """

    light_maps: Float[Array, "k 1 r r"]
    view_maps: Float[Array, "k b r r"]
    weights: Texture

    @property
    def terms(self) -> int:
        """K."""
        return self.light_maps.shape[0]

    @property
    def channels(self) -> int:
        """One: colours are in the weights."""
        return 1

    @jax.jit
    def light_side(self, omega_i: Float[Array, "3"]) -> Float[Array, "k 1"]:
        """g_k(ω_i)."""
        return look_up(DISC, self.light_maps, omega_i)

    @jax.jit
    def view_side(self, omega_o: Float[Array, "3"]) -> Float[Array, "k c"]:
        """The view side of the mean of all texels."""
        return self.view_side_at(omega_o, jnp.full(2, 0.5, omega_o.dtype), jnp.inf)

    @jax.jit
    def view_side_at(self, omega_o: Float[Array, "3"], uv: Float[Array, " u"], footprint: Footprint) -> Array:
        """Σ_b w_b(u, v) h_bk(ω_o), [k, c]."""
        shapes = look_up(DISC, self.view_maps, omega_o)
        weights = self.weights.look_up(uv, footprint).reshape(shapes.shape[1], -1)
        return jnp.einsum("kb,bc->kc", shapes, weights, precision="highest")

    @property
    def per_receiver(self) -> PyTree[bool]:
        """All receivers share everything."""
        return jax.tree.map(lambda _: False, self)


@dataclasses.dataclass(frozen=True)
class FactorResidual:
    """What shared factors leave out.

    Attributes:
        shapes: relative root mean square of what the shapes leave of the texels' lobes.
        terms: of what K terms leave of the shapes, weighted as factors of a single BRDF are.
    """

    shapes: float
    terms: float


def factor_spatial(
    lobes: SpatialLobes,
    terms: int = 4,
    resolution: int = 48,
    *,
    tolerance: float = TOLERANCE,
    most_shapes: int = MAX_SHAPES,
) -> tuple[SpatialFactors, FactorResidual]:
    """Shared factors of a map's lobes, without its diffuse part, and what they leave out.

    Coarser levels of detail are means of the weights, and so of what the texels reflect.

    Args:
        lobes: of which one at least reflects something.
        terms: K.
        resolution: side of the light and view maps.
        tolerance: shapes are added until no more than this share of the lobes' root mean square is left by them …
        most_shapes: … or there are so many.
    """
    h, w = lobes.shape
    every = _lobes_of(lobes)
    strength = np.asarray(lobes.scale).mean(axis=-1).reshape(-1)
    pairs = tuple(map(np.asarray, spread_pairs(_PAIRS)))
    # Pairs are weighted as for factors: those at grazing angles are bright and seldom seen.
    at = np.sqrt(pairs[0][:, 2] * pairs[1][:, 2])
    chosen = _shapes(every, strength, pairs, at, tolerance, most_shapes)
    shapes = jax.tree.map(lambda leaf: leaf[chosen], every)
    basis = np.asarray(_values(shapes, *pairs)) * at  # [b, p]
    weights, error = _weights(every, np.asarray(lobes.scale).reshape(h * w, lobes.lobes, -1), basis, pairs, at)
    size = np.sqrt(np.mean(weights**2, axis=(0, 2)))
    light, view, left = _factored(shapes, size, terms, resolution)
    texture = Texture(as_array(weights.reshape(h, w, -1), float_dtype(lobes))).minified()
    return SpatialFactors(light, view, texture), FactorResidual(error, left)


def _lobes_of(lobes: SpatialLobes) -> LobeSum:
    """All lobes of all texels as grey BRDFs of one lobe and a peak of 1, one after the other; on the host."""
    total, axis = lobes.shape[0] * lobes.shape[1] * lobes.lobes, np.asarray(lobes.axis)
    arrays: Any = (
        np.zeros((total, 1)),
        np.asarray(lobes.C).reshape(total, 1, 1, 3),
        np.asarray(lobes.exponent).reshape(total, 1, 1),
        np.ones((total, 1, 1)),
        np.repeat(np.arctan2(axis[..., 1], axis[..., 0]).reshape(-1) / 2, lobes.lobes),
    )
    return LobeSum(*(one.astype(float_dtype(lobes)) for one in arrays))


@jax.jit
def _values(lobes: LobeSum, omega_i, omega_o) -> Float[Array, "n p"]:
    """What single lobes reflect in pairs of directions."""

    def one(lobe):
        return jax.vmap(lobe.evaluate)(omega_i, omega_o)[:, 0]

    return jax.lax.map(one, lobes, batch_size=64)


def _shapes(every: LobeSum, strength: np.ndarray, pairs, at, tolerance: float, most: int) -> Int[np.ndarray, " b"]:
    """The lobes that span the others best, by pivoted QR: each is the one of which the earlier ones miss most."""
    shine = np.flatnonzero(strength > 0)
    some = np.random.default_rng(0).choice(shine, min(_CANDIDATES, len(shine)), replace=False)
    columns = (np.asarray(_values(jax.tree.map(lambda leaf: leaf[some], every), *pairs)) * at).T * strength[some]
    factorisation: Any = scipy.linalg.qr(columns, mode="r", pivoting=True)
    r, order = factorisation
    left = np.cumsum(np.sum(r**2, axis=1)[::-1])[::-1]
    enough = int(np.argmax(np.append(left, 0) <= tolerance**2 * left[0]))
    return some[order[: max(1, min(enough, most))]]


def _weights(every: LobeSum, scale: Float[np.ndarray, "t l c"], basis, pairs, at) -> tuple[np.ndarray, float]:
    """Weights [t, b, c] of least squared error, and the relative root mean square of what is left."""
    texels, count, channels = scale.shape
    gram = np.asarray(basis, float) @ np.asarray(basis, float).T
    # A millionth of the mean is added to the diagonal, so that shapes that are nearly alike share their weight.
    inverse = np.linalg.inv(gram + 1e-6 * np.trace(gram) / len(gram) * np.eye(len(gram)))
    solve = (inverse @ np.asarray(basis, float)).astype(float_dtype(every))
    weights, missed, total = np.empty((texels, len(gram), channels)), 0.0, 0.0
    size = max(1, _TEXEL_BATCH // count)
    for start in range(0, texels, size):
        index = np.minimum(np.arange(start, start + size), texels - 1)
        lobes = jax.tree.map(lambda leaf, i=index: leaf.reshape(texels, count, *leaf.shape[1:])[i], every)
        solved, squared_error, squared_values = (
            np.asarray(of) for of in _solved(lobes, scale[index], basis, solve, *pairs, at)
        )
        kept = min(size, texels - start)
        weights[start : start + kept] = solved[:kept]
        missed, total = missed + float(squared_error[:kept].sum()), total + float(squared_values[:kept].sum())
    return weights, float(np.sqrt(missed / total)) if total else 0.0


@jax.jit
def _solved(lobes: LobeSum, scale, basis, solve, omega_i, omega_o, at):
    def texel(given):
        lobes, scale = given
        values = jax.vmap(lambda lobe: jax.vmap(lobe.evaluate)(omega_i, omega_o)[:, 0])(lobes) * at[None]
        values = jnp.einsum("lp,lc->pc", values, scale, precision="highest")
        weights = jnp.matmul(solve, values, precision="highest")
        off = values - jnp.matmul(basis.T, weights, precision="highest")
        return weights, jnp.sum(off**2), jnp.sum(values**2)

    return jax.lax.map(texel, (lobes, scale), batch_size=32)


def _factored(shapes: LobeSum, size: Float[np.ndarray, " b"], terms: int, resolution: int):
    """Light maps [k, 1, r, r], view maps [k, b, r, r], and the relative error of the terms.

    The matrices of the shapes beside each other, weighted by how much they are used, have the left singular vectors of
    the sum of their M Mᵀ; view maps are what those make of each shape.
    """
    single = [jax.tree.map(lambda leaf, b=b: leaf[b], shapes) for b in range(len(size))]
    samples = [Samples(shape, DISC, resolution, COSINE) for shape in single]
    first = samples[0]
    gram = 0.0
    for shape_samples, used in zip(samples, size, strict=True):
        matrix = used * shape_samples.matrix(0)
        gram = gram + matrix @ matrix.T
    gram = np.asarray(gram)
    square, u = scipy.linalg.eigh(gram, subset_by_index=[len(gram) - terms, len(gram) - 1])
    square, u = np.maximum(square[::-1], 0), u[:, ::-1]
    kept = square > 1e-12 * square[0]
    over = np.where(kept, 1 / np.where(kept, square, 1), 0)
    light_rest, view = 0.0, []
    for shape_samples, used in zip(samples, size, strict=True):
        projected = shape_samples.matrix(0).T @ u  # [o, k]
        view_rest = shape_samples.times(0, shape_samples.rest, shape_samples.light[:, None] * u, swapped=True)
        view.append(shape_samples.joined(projected / shape_samples.view[:, None], view_rest))
        light_rest = light_rest + used**2 * shape_samples.times(
            0, shape_samples.rest, shape_samples.view[:, None] * projected
        )
    light = first.joined(u / first.light[:, None], over * light_rest)
    left = np.sqrt(max(0.0, 1 - square.sum() / np.trace(gram)))
    return first.maps(light[:, None]), first.maps(np.stack(view, axis=1)), float(left)
