"""What a Lafortune fit minimises: the residual left when all that is linear has been solved for."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fitting.chart import Chart
from fitting.gauss_newton import NormalEquations
from fitting.non_negative import solve_non_negative
from fitting.samples import Samples
from fitting.small_systems import solve_positive
from jaxrelight.brdf.lobes import LobeSum

# Differences of sums of squares up to so many units of rounding are as likely rounding as not.
_OF_ROUNDING = 100


def columns(C: Float[Array, "l 3"], exponent: Float[Array, " l"], products: Float[Array, "3 s"]) -> Float[Array, "m s"]:
    """1/π, then each lobe at unit scale, in every sample (m = 1 + l); f is linear in their factors."""
    count, dtype = len(exponent), products.dtype
    # Every lobe is a channel of its own.
    apart = LobeSum(
        diffuse=jnp.zeros(count, dtype), C=C[:, None], exponent=exponent[:, None], scale=jnp.eye(count, dtype=dtype)
    )
    lobes = jax.vmap(apart.evaluate, in_axes=(1, None), out_axes=1)(products, jnp.ones(3, dtype))
    return jnp.concatenate([jnp.full((1, products.shape[1]), 1 / math.pi, dtype), lobes])


def factors(weighted: Float[Array, "m s"], values: Float[Array, "c s"]) -> Float[Array, "c m"]:
    """The non-negative factors with which weighted columns fit the weighted values of each channel best."""
    gram = jnp.einsum("ms,ns->mn", weighted, weighted)
    moment = jnp.einsum("cs,ms->cm", values, weighted)
    return jax.vmap(solve_non_negative, in_axes=(None, 0))(gram, moment)


def residual(unknowns: Float[Array, "l q"], given: tuple[Chart, Samples]) -> Float[Array, "c s"]:
    """√weight · (fit − values) with the best factors: variable projection (Golub and Pereyra 1973)."""
    chart, samples = given
    G = columns(*chart.lobes(unknowns), samples.products) * samples.root_weight[None]
    values = samples.values * samples.root_weight[None]
    return factors(G, values) @ G - values


def normal_equations(unknowns: Float[Array, "l q"], given: tuple[Chart, Samples]) -> NormalEquations:
    """½|r|², Jᵀr and JᵀJ of `residual`, from the columns' derivatives h_j = ∂G/∂u_j alone.

    Unknown j moves the column of its lobe l(j). With a and A = GᵀG of the columns that are not held at 0,

        J_j = a_l(j) · (h_j − G A⁻¹ Gᵀh_j) − G A⁻¹ e_l(j) (h_jᵀ r),

    for each channel, and the two parts are orthogonal (Golub and Pereyra 1973, eq. 4.2).
    """
    chart, samples = given
    count, each = unknowns.shape

    def move(u):
        return columns(*chart.lobes(u), samples.products)

    # One tangent moves the same unknown of every lobe: each moves its own column.
    tangents = [jnp.zeros_like(unknowns).at[:, q].set(1) for q in range(each)]
    G, moved = zip(*(jax.jvp(move, (unknowns,), (tangent,)) for tangent in tangents), strict=True)
    h = jnp.stack([part[1:] for part in moved], axis=1).reshape(count * each, -1)
    stack = jnp.concatenate([G[0], h, samples.values]) * samples.root_weight[None]
    inner = jnp.einsum("ps,qs->pq", stack, stack)
    m = 1 + count
    G, h, values = stack[:m], stack[m : m + len(h)], stack[m + len(h) :]
    A, Gh, hh = inner[:m, :m], inner[:m, m : m + len(h)], inner[m : m + len(h), m : m + len(h)]
    a = jax.vmap(solve_non_negative, in_axes=(None, 0))(A, inner[m + len(h) :, :m])
    r = a @ G - values
    hr = jnp.einsum("js,cs->cj", h, r)
    of = jnp.repeat(jnp.arange(count) + 1, each)

    def channel(a, hr):
        free = a > 0
        both = free[:, None] & free[None]
        solve = jax.vmap(lambda b: solve_positive(jnp.where(both, A, jnp.eye(m, dtype=A.dtype)), b))
        projected = solve(jnp.where(free[None], Gh.T, 0))
        coupled = solve(jnp.where(both, jnp.eye(m, dtype=A.dtype), 0))
        along = hh - projected @ Gh
        # What moves a column along others changes nothing: what is left of it is rounding.
        moves = free[of] & (jnp.diagonal(along) > _OF_ROUNDING * float(jnp.finfo(A.dtype).eps) * jnp.diagonal(hh))
        a, hr = jnp.where(moves, a[of], 0), jnp.where(moves, hr, 0)
        return a * hr, jnp.outer(a, a) * along + jnp.outer(hr, hr) * coupled[of][:, of]

    gradient, hessian = jax.vmap(channel)(a, hr)
    return NormalEquations(0.5 * jnp.sum(r * r), jnp.sum(gradient, axis=0), jnp.sum(hessian, axis=0))
