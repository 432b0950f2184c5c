"""Lafortune lobes for many items at once: one compiled solve, many starts, capped steps."""

import dataclasses
import enum
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from fitting.chart import EXPONENTS, Chart, chart_around
from fitting.gauss_newton import NormalEquations, SmallLevenbergMarquardt
from fitting.residuals import columns, factors, normal_equations, residual
from fitting.samples import Samples, prepare
from fitting.small_systems import solve_positive
from fitting.starts import best_additions
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

Arrays = Array | np.ndarray

# Items solved together: a slow one holds up as many, and their samples fit a processor's cache.
BLOCK = 64
# Lobes with peaks below this share of the samples' root mean square are left by rounding, which differs by processor.
_MIN_RELATIVE_PEAK = 1e-4


class Verdict(enum.IntEnum):
    """What a fit is worth; of several that apply, the first after GOOD. `fit_lafortune` alone gives the last two."""

    GOOD = 0
    NO_DATA = 1
    BLACK = 2
    CONSTANT = 3
    UNCERTAIN = 4
    AT_BOUND = 5
    POOR = 6
    ENERGY = 7
    HELD_OUT = 8

    def __str__(self) -> str:
        """Its name, in lower case."""
        return self.name.lower()

    def __format__(self, spec: str) -> str:
        """Its name, in lower case, formatted as text is."""
        return format(str(self), spec)

    @property
    def message(self) -> str:
        """What it means, and what may help."""
        return {
            Verdict.GOOD: "the residual is small and the samples determine the lobes",
            Verdict.NO_DATA: "fewer usable samples than unknowns: add samples, or fit fewer lobes",
            Verdict.BLACK: "all samples are zero",
            Verdict.CONSTANT: "no lobe lowers the residual: the samples are diffuse, or miss the highlight",
            Verdict.UNCERTAIN: "the samples do not determine a lobe: add directions near the highlight, or fit fewer",
            Verdict.AT_BOUND: f"an exponent is at an end of its range, {EXPONENTS[0]:g} to {EXPONENTS[1]:g}",
            Verdict.POOR: "the residual is large: try more lobes, anisotropic ones, or ones per channel",
            Verdict.ENERGY: "the lobes reflect more or less light than the data: weigh by log-cosine, try more lobes",
            Verdict.HELD_OUT: "a fit to the others misses what was held out: add samples, or fit fewer lobes",
        }[self]


@dataclasses.dataclass(frozen=True)
class Options:
    """How lobes are fitted.

    Attributes:
        lobes: how many, 1 to 3.
        anisotropic: whether Cx and Cy may differ.
        per_channel: whether each channel has C and exponents of its own.
        starts: how many places of the grid each added lobe is solved from, 1 to 7.
        exchanges: how often every lobe, one after the other, is taken out and sought anew.
        max_steps: of one solve.
        rtol: a solve ends when it promises to lower the loss by less than this share.
        poor: relative residual beyond which a fit is called poor.
    """

    lobes: int = 1
    anisotropic: bool = False
    per_channel: bool = False
    starts: int = 2
    exchanges: int = 1
    max_steps: int = 40
    rtol: float = 1e-5
    poor: float = 0.25

    def __post_init__(self) -> None:
        if self.lobes not in (1, 2, 3):
            raise InputError(f"lobes must be 1, 2 or 3, not {self.lobes}")
        if not 1 <= self.starts <= 7:
            raise InputError(f"starts must be from 1 to 7, not {self.starts}")
        if self.exchanges < 0 or self.max_steps < 1 or not self.rtol > 0 or not self.poor > 0:
            raise InputError("exchanges must be at least 0, max_steps at least 1, rtol and poor positive")


class Fits(eqx.Module):
    """What was found for each item; all arrays have the items' axis first.

    Attributes:
        brdf: lobes ordered by exponent, C with max|C| = 1, as the renderer takes them: `jax.vmap` over it.
        residual: root mean square of fit − values over that of the values, weighted; NaN where there are no data.
        exponent_deviation: standard deviation of log exponent, from the Jacobian, under independent errors as large as
            the residual; inf where nothing determines it.
        C_deviation: that of the direction of C, in radians; of its largest coordinate.
        verdict: a `Verdict`.
        masked: samples left out because they are not finite.
        below: samples left out because a direction is below the surface.
        used: samples with weight.
    """

    brdf: LobeSum
    residual: Float[Array, "*t"]
    exponent_deviation: Float[Array, "*t l c1"]
    C_deviation: Float[Array, "*t l c1"]
    verdict: Int[Array, "*t"]
    masked: Int[Array, "*t"]
    below: Int[Array, "*t"]
    used: Int[Array, "*t"]


def fit_lobes(
    omega_i: Float[Arrays, "t s 3"] | Float[Arrays, "s 3"],
    omega_o: Float[Arrays, "t s 3"] | Float[Arrays, "s 3"],
    values: Float[Arrays, "t s c"],
    weight: Float[Arrays, "t s"] | Float[Arrays, " s"] | None = None,
    *,
    options: Options = Options(),
) -> Fits:
    """Fits diffuse/π + Σ_l scale_l · max(0, ω_oᵀC_lω_i)ⁿˡ to the samples of every item, in weighted least squares.

    Directions are local unit vectors, shared ones may leave out the items' axis; values are BRDF values without the
    cosine. Samples of weight 0, not finite, or with a direction below the surface take no part. Items do not influence
    each other. Albedos and scales are never negative. The result is deterministic, and differentiable in the values
    by the implicit function theorem.

    Raises:
        InputError: if shapes do not belong together.
    """
    values = as_array(values)
    if values.ndim != 3 or 0 in values.shape:
        raise InputError(f"values must have the shape [items, samples, channels], not {values.shape}")
    t, s, _ = values.shape
    dtype = jnp.result_type(values.dtype, jnp.float32)
    arrays = {
        "omega_i": (omega_i, (t, s, 3)),
        "omega_o": (omega_o, (t, s, 3)),
        "weight": (1.0 if weight is None else weight, (t, s)),
    }
    inputs = [_spread(name, array, shape, dtype) for name, (array, shape) in arrays.items()]
    return _fit_all(*inputs[:2], values.astype(dtype), inputs[2], options)


def _spread(name, array, shape, dtype):
    array = as_array(array, dtype)
    if array.ndim and array.shape != shape[len(shape) - array.ndim :]:
        raise InputError(f"{name} must have the shape {list(shape)} of the values' samples, not {list(array.shape)}")
    return jnp.broadcast_to(array, shape)


@functools.partial(jax.jit, static_argnames="options")
def _fit_all(omega_i, omega_o, values, weight, options: Options) -> Fits:
    count = len(values)
    padded = -count % BLOCK if count > BLOCK else 0
    inputs = (omega_i, omega_o, values, weight)
    inputs = [jnp.pad(a, [(0, padded)] + [(0, 0)] * (a.ndim - 1)) for a in inputs]
    size = min(BLOCK, count)
    blocks = [a.reshape(-1, size, *a.shape[1:]) for a in inputs]
    fit = functools.partial(fit_one, options=options)
    fits = jax.lax.map(lambda block: jax.vmap(fit)(*block), tuple(blocks))
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], fits)


def fit_one(
    omega_i: Float[Array, "s 3"],
    omega_o: Float[Array, "s 3"],
    values: Float[Array, "s c"],
    weight: Float[Array, " s"],
    options: Options,
) -> Fits:
    """`fit_lobes` of one item, without its axis: for use inside other compiled functions."""
    samples = prepare(omega_i, omega_o, values, weight)
    c, s = samples.values.shape
    # Channels that share C and exponent are one group; g groups of c / g channels.
    groups = samples.values.reshape(-1, 1 if options.per_channel else c, s)
    group_fits = jax.vmap(lambda values: _fit(dataclasses.replace(samples, values=values), options))(groups)
    scale = group_fits.factors[..., 1:]  # [g, c / g, l]
    brdf = LobeSum(
        diffuse=group_fits.factors[..., 0].ravel() * samples.scale,
        C=jnp.moveaxis(group_fits.C, 0, 1),
        exponent=group_fits.exponent.T,
        scale=scale.reshape(c, -1).T * samples.scale,
    )
    energy = jnp.sum(jnp.square(samples.values * samples.root_weight[None]))
    relative = jnp.sqrt(jnp.sum(group_fits.squares)) / jnp.sqrt(jnp.where(energy > 0, energy, 1))
    verdict = _judge(samples, group_fits, relative, options)
    return Fits(
        brdf,
        jnp.where(verdict == Verdict.NO_DATA, jnp.nan, relative),
        group_fits.exponent_deviation.T,
        group_fits.C_deviation.T,
        verdict,
        samples.masked,
        samples.below,
        samples.used,
    )


class _Found(eqx.Module):
    """Lobes of one group of channels, in the samples' units."""

    C: Float[Array, "l 3"]
    exponent: Float[Array, " l"]
    factors: Float[Array, "c m"]
    squares: Float[Array, ""]
    exponent_deviation: Float[Array, " l"]
    C_deviation: Float[Array, " l"]


def _fit(samples: Samples, options: Options) -> _Found:
    # The search only chooses the optimum; its derivatives are those of the last solve.
    C, exponent = _search(jax.lax.stop_gradient(samples), options)
    order = jnp.argsort(exponent)
    chart, start = chart_around(C[order], exponent[order], options.anisotropic)
    solution = _solve(start, (chart, samples), options)
    unknowns = solution.value
    C, exponent = chart.lobes(unknowns)
    G = columns(C, exponent, samples.products) * samples.root_weight[None]
    values = samples.values * samples.root_weight[None]
    a = factors(G, values)
    squares = jnp.sum(jnp.square(a @ G - values))
    freedom = samples.used * len(values) - unknowns.size - a.size
    at = jax.lax.stop_gradient(solution.state.at)
    exponent_deviation, C_deviation = _deviations(at, jax.lax.stop_gradient(unknowns), chart, freedom)
    return _Found(C, exponent, a, squares, exponent_deviation, C_deviation)


def _search(samples: Samples, options: Options) -> tuple[Float[Array, "l 3"], Float[Array, " l"]]:
    """The best lobes from several starts, added one after the other."""
    values = samples.values * samples.root_weight[None]

    def add(C, exponent):
        there = columns(C, exponent, samples.products) * samples.root_weight[None]
        starts = best_additions(
            there, samples.products, values, samples.root_weight, options.starts, options.anisotropic
        )

        def from_start(new_C, new_exponent):
            together = jnp.concatenate([C, new_C[None]]), jnp.append(exponent, new_exponent)
            chart, start = chart_around(*together, options.anisotropic)
            solution = _solve(start, (chart, samples), options)
            return *chart.lobes(solution.value), solution.state.at.f

        fitted_C, fitted_exponent, losses = jax.vmap(from_start)(*starts)
        best = jnp.argmin(losses)
        return fitted_C[best], fitted_exponent[best], losses[best]

    def exchange(lobes, _):
        C, exponent, loss = lobes
        new = add(C[1:], exponent[1:])
        # A lobe that was kept goes to the end, so that each has its turn.
        old = jnp.roll(C, -1, axis=0), jnp.roll(exponent, -1), loss
        return jax.tree.map(lambda a, b: jnp.where(new[2] < loss, a, b), new, old), None

    # Lobes that point into the surface are 0 above it: they stand for those not found yet.
    dtype = samples.values.dtype
    absent = jnp.tile(jnp.asarray([0, 0, -1], dtype), (options.lobes, 1)), jnp.ones(options.lobes, dtype)
    turns = 1 if options.lobes == 1 else options.lobes * (1 + options.exchanges)
    (C, exponent, _), _ = jax.lax.scan(exchange, (*absent, jnp.asarray(jnp.inf, dtype)), length=turns)
    return C, exponent


def _solve(start, given, options: Options) -> optx.Solution:
    eps = float(jnp.finfo(start.dtype).eps)
    return optx.least_squares(
        residual,
        SmallLevenbergMarquardt(rtol=options.rtol, atol=eps * eps),
        start,
        given,
        options={"normal_equations": normal_equations},
        max_steps=options.max_steps,
        # A lobe without influence makes the Hessian singular: its derivatives are then 0.
        adjoint=optx.ImplicitAdjoint(lx.AutoLinearSolver(well_posed=False)),
        throw=False,
    )


def _deviations(
    at: NormalEquations, unknowns: Float[Array, "l q"], chart: Chart, freedom: Int[Array, ""]
) -> tuple[Float[Array, " l"], Float[Array, " l"]]:
    """Standard deviations of log exponent and of C, from (JᵀJ)⁻¹ and the residual over its degrees of freedom."""
    inverse = jax.vmap(lambda e: solve_positive(at.hessian, e))(jnp.eye(unknowns.size, dtype=unknowns.dtype))
    variance = jnp.diagonal(inverse) * 2 * at.f / jnp.maximum(freedom, 1)
    determined = (jnp.diagonal(at.hessian) > 0) & (freedom > 0) & jnp.isfinite(variance) & (variance >= 0)
    deviation, known = (of.reshape(unknowns.shape) for of in (jnp.sqrt(jnp.where(determined, variance, 0)), determined))
    exponent = jnp.where(known[:, 0], deviation[:, 0] * chart.log_exponent_slope(unknowns), jnp.inf)
    return exponent, jnp.max(jnp.where(known[:, 1:], deviation[:, 1:], jnp.inf), axis=1)


def _judge(samples: Samples, group_fits: _Found, relative: Float[Array, ""], options: Options) -> Int[Array, ""]:
    """The first verdict that applies."""
    g, c, m = group_fits.factors.shape
    active = jnp.any(group_fits.factors[..., 1:] > _MIN_RELATIVE_PEAK, axis=1)  # [g, l]
    uncertain = (group_fits.exponent_deviation > 1) | (group_fits.C_deviation > 1)
    ends = (group_fits.exponent < 2 * EXPONENTS[0]) | (group_fits.exponent > EXPONENTS[1] / 2)
    unknowns = g * (m - 1) * (3 if options.anisotropic else 2) + g * c * m
    applies = {
        Verdict.NO_DATA: samples.used * g * c < unknowns,
        Verdict.BLACK: ~jnp.any(samples.values != 0),
        Verdict.CONSTANT: ~jnp.any(active),
        Verdict.UNCERTAIN: jnp.any(active & uncertain),
        Verdict.AT_BOUND: jnp.any(active & ends),
        Verdict.POOR: ~(relative <= options.poor),
    }
    return jnp.select(list(applies.values()), [jnp.asarray(int(v)) for v in applies], int(Verdict.GOOD))
