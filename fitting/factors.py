"""Separable factors refined between their texels, where a renderer looks them up (Wang 2006 §3.3)."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factors import COSINE
from jaxrelight.brdf.parametrisation import Parametrisation
from jaxrelight.numerics.arrays import as_array

# Directions for each texel of a map: fewer would leave texels that none determines.
_DIRECTIONS = 1.6


@dataclasses.dataclass(frozen=True)
class Refined:
    """Factors, and what refining them did.

    Attributes:
        factors: the refined ones.
        before, after: relative root mean square error, weighted as it was minimised, on directions not fitted to.
        steps: of the solver, the most of any channel.
    """

    factors: Factored
    before: float
    after: float
    steps: int


def refined(
    brdf: Brdf, start: Factored, cosine: tuple[float, float] = COSINE, *, steps: int = 60, seed: int = 0
) -> Refined:
    """Factors of least squared error over directions everywhere, not only through the texels' centres.

    Singular value decomposition knows a BRDF at the centres alone; what a bilinear look-up makes of its maps between
    them is left to chance. From there, held fixed, Optimistix minimises the error of the look-ups themselves.

    Args:
        brdf: what is factored.
        start: factors of it, as `factor` gives them.
        cosine: powers of cosθ_i and of cosθ_o in the error, as for `factor`.
        steps: of the solver, at most.
        seed: of the directions.
    """
    if brdf.is_constant:
        return Refined(start, 0.0, 0.0, 0)
    side = start.light_maps.shape[-1]
    fitted, held = (
        [_directions(start.parametrisation, side, seed + 2 * part + i) for i in range(2)] for part in range(2)
    )
    start_maps, maps, most, errors = (start.light_maps, start.view_maps), [], 0, []
    for c in range(brdf.channels):
        own, channel = tuple(as_array(np.asarray(maps)[:, c]) for maps in start_maps), as_array(c)
        refined_maps, count = _solve(brdf, own, fitted, cosine, start.parametrisation, channel, steps)
        errors.append([_error(brdf, m, held, cosine, start.parametrisation, channel) for m in (own, refined_maps)])
        maps.append(refined_maps)
        most = max(most, int(count))
    light, view = (as_array(np.stack([of_channel[i] for of_channel in maps], axis=1)) for i in range(2))
    before, after = (float(np.sqrt(sum(e[i][0] for e in errors) / sum(e[i][1] for e in errors))) for i in range(2))
    return Refined(Factored(light, view, start.parametrisation), before, after, most)


def _directions(parametrisation: Parametrisation, side: int, seed: int) -> Float[Array, "n 3"]:
    """Uniform in projected solid angle, a golden sequence turned at random: about evenly spread over the disc."""
    count = int(_DIRECTIONS * parametrisation.directions(side)[1].sum())
    turn, shift = np.random.default_rng(seed).random(2)
    square = (np.arange(count) + 0.5 + 0.9 * (shift - 0.5)) / count
    azimuth = 2 * np.pi * (turn + np.arange(count) * 0.6180339887498949)
    radius = np.sqrt(square)
    xyz = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - square)], axis=-1)
    return as_array(xyz, jax.dtypes.canonicalize_dtype(float))


def _looked_up(parametrisation: Parametrisation, maps: Float[Array, "k r r"], omega: Float[Array, "n 3"]):
    """Values [n, k] of maps: linear in them, with four texels each."""
    texels, weights = jax.vmap(lambda one: parametrisation.corners(one, maps.shape[-1]))(omega)
    flat = maps.reshape(len(maps), -1)
    return jnp.einsum("knb,nb->nk", flat[:, texels], weights)


def _problem(brdf, directions, cosine, channel):
    """Weighted values [n, m], and the weights of either side."""
    omega_i, omega_o = directions
    weights = [omega[:, 2] ** power for omega, power in zip(directions, cosine, strict=True)]
    over_o = jax.vmap(brdf.evaluate, in_axes=(None, 0))
    values = jax.lax.map(lambda one: over_o(one, omega_o)[:, channel], omega_i, batch_size=16)
    return values * weights[0][:, None] * weights[1][None], weights


def _apart(maps, values, weights, directions, parametrisation):
    sides = [
        weight[:, None] * _looked_up(parametrisation, side, omega)
        for side, weight, omega in zip(maps, weights, directions, strict=True)
    ]
    return jnp.matmul(sides[0], sides[1].T, precision="highest") - values


@eqx.filter_jit
def _solve(brdf, maps, directions, cosine, parametrisation, channel, steps: int):
    values, weights = _problem(brdf, directions, cosine, channel)
    size = jnp.sqrt(jnp.sum(values**2)) + jnp.finfo(values.dtype).tiny

    def loss(maps, _):
        return 0.5 * jnp.sum((_apart(maps, values, weights, directions, parametrisation) / size) ** 2)

    solver = optx.LBFGS(rtol=1e-5, atol=1e-9)
    start = jax.lax.stop_gradient(maps)
    solution = optx.minimise(loss, solver, start, max_steps=steps, throw=False)
    better = loss(solution.value, None) < loss(start, None)
    return jax.tree.map(lambda a, b: jnp.where(better, a, b), solution.value, start), solution.stats["num_steps"]


@eqx.filter_jit
def _error(brdf, maps, directions, cosine, parametrisation, channel):
    values, weights = _problem(brdf, directions, cosine, channel)
    return jnp.sum(_apart(maps, values, weights, directions, parametrisation) ** 2), jnp.sum(values**2)
