"""How exactly pictures tell what was found of materials, from the Jacobian there; and what they do not tell at all."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from jaxrelight.inverse.material_fit import LIGHT, ManyFound, Problem, jacobian
from jaxrelight.inverse.material_unknowns import Coordinates, Parameter

# The normal distribution's half width of a 95 % interval, in standard deviations.
_HALF_WIDTH = 1.96
# A number is not told where its deviation is above a quarter: of a colour, or of the logarithm of others.
_MAX_DEVIATION = 0.25
# Singular values of the Jacobian, its columns of length one, that rounding cannot tell from 0; and such columns.
_NULL, _NOTHING = 2e-5, 1e-6
# The share of a coordinate in null directions from which it is not told.
_SHARE = 1e-3
# How much of what light alone changes may be left where colours make up for it.
_AMBIGUITY = 1e-3


@dataclasses.dataclass(frozen=True)
class Estimate:
    """What is known of one parameter; arrays of its shape.

    Attributes:
        value: most likely.
        deviation: standard deviation, inf where nothing tells it; of exponents, ratios and the light's scale, to first
            order.
        low: lower end of the 95 % interval.
        high: upper end.
        determined: whether the pictures tell it.
    """

    value: Float[np.ndarray, "..."]
    deviation: Float[np.ndarray, "..."]
    low: Float[np.ndarray, "..."]
    high: Float[np.ndarray, "..."]
    determined: Bool[np.ndarray, "..."]

    @property
    def width(self) -> Float[np.ndarray, "..."]:
        """The interval's width, relative to the value."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray((self.high - self.low) / np.abs(self.value))


def certainty_of_few(
    problem: Problem, at: Coordinates, deviations_known: bool
) -> tuple[dict[str, Estimate], tuple[str, ...]]:
    """Estimates from the covariance σ²(JᵀJ)⁻¹, and the names of what the Jacobian's null space holds.

    Args:
        problem: the fit.
        at: what was found.
        deviations_known: whether weights are 1 over standard deviations; else the residual tells σ.
    """
    J = np.asarray(jacobian(problem, at), np.float64)
    J = J / np.concatenate([np.ravel(of) for of in _slopes(problem, at).values()])[None]
    length = np.linalg.norm(J, axis=0)
    is_seen = length > _NOTHING * length.max(initial=1e-300)
    unit = J[:, is_seen] / length[is_seen]
    _, singular, rows = np.linalg.svd(unit, full_matrices=False)
    is_null = singular < _NULL
    sigma = 1.0 if deviations_known else _sigma(problem, at, len(length))
    squares = (rows[~is_null] ** 2 / singular[~is_null, None] ** 2).sum(axis=0)
    deviation = np.full(len(length), np.inf)
    told = (rows[is_null] ** 2).sum(axis=0) < _SHARE
    deviation[is_seen] = np.where(told, sigma * np.sqrt(squares) / length[is_seen], np.inf)
    shaped = ravel_pytree(jax.tree.map(lambda x: np.zeros(x.shape), at))[1]
    by_key = {key: np.asarray(of, np.float64) for key, of in shaped(jnp.asarray(deviation)).items()}
    return _estimates(problem, at, by_key)


def certainty_of_many(
    problem: Problem, found: ManyFound, deviations_known: bool
) -> tuple[dict[str, Estimate], tuple[str, ...]]:
    """Estimates from the diagonal of JᵀJ alone: each number as if the others were known; and what no pixel tells."""
    count = sum(part.size for part in found.coordinates.values())
    sigma = 1.0 if deviations_known else _sigma(problem, found.coordinates, count)
    slopes = _slopes(problem, found.coordinates)
    deviations = {}
    most = max(float(jnp.max(part)) for part in found.reach.values())
    for key, curvature in found.curvature.items():
        told = np.asarray(found.reach[key]) > _NOTHING * most
        root = np.sqrt(np.maximum(np.asarray(curvature, np.float64), 0)) / slopes[key]
        deviations[key] = np.where(told & (root > 0), sigma / np.where(root > 0, root, 1), np.inf)
    return _estimates(problem, found.coordinates, deviations)


def is_ambiguous(problem: Problem, at: Coordinates) -> bool:
    """Whether dividing all sought colours by what the lights are multiplied with changes no pixel that is fitted."""
    colours = {one.key: one for one in problem.unknowns.parameters if one.form != "log"}
    slopes = _slopes(problem, at)
    along = {key: jnp.zeros_like(of) for key, of in at.items()}
    alone = {**along, LIGHT: jnp.ones_like(at[LIGHT])}
    both = dict(alone)
    for key, one in colours.items():
        both[key] = -jnp.asarray(np.asarray(one.values(at[key])) / slopes[key], at[key].dtype)
    left, whole = (float(_length(problem, at, direction)) for direction in (both, alone))
    return left < _AMBIGUITY * whole


@eqx.filter_jit
def _length(problem: Problem, at: Coordinates, along: Coordinates) -> Float[Array, ""]:
    _, moved = jax.jvp(problem.misfit, (at,), (along,))
    return jnp.sqrt(sum((jnp.sum(part**2) for part in moved), jnp.zeros(())))


def _parameters(problem: Problem) -> dict[str, Parameter]:
    return {one.key: one for one in problem.unknowns.parameters}


def _slopes(problem: Problem, at: Coordinates) -> dict[str, Float[np.ndarray, "..."]]:
    """How fast colours grow with their coordinates, in the order of those; 1 for logarithms, which are told as such."""
    parameters, slopes = _parameters(problem), {}
    for key in sorted(at):
        values = np.asarray(at[key], np.float64)
        is_softplus = key in parameters and parameters[key].form == "softplus"
        step = 1e-4
        slopes[key] = np.ones_like(values)
        if is_softplus:
            one = parameters[key]
            slopes[key] = np.maximum((one.values(values + step) - one.values(values - step)) / (2 * step), 1e-9)
    return slopes


def _sigma(problem: Problem, at: Coordinates, unknowns: int) -> float:
    """The standard deviation of weighted pixels that the residual tells."""
    square = sum(float(jnp.sum(part**2)) for part in _misfit(problem, at))
    return float(np.sqrt(square / max(problem.observations.count - unknowns, 1)))


@eqx.filter_jit
def _misfit(problem: Problem, at: Coordinates):
    return problem.misfit(at)


def _estimates(
    problem: Problem, at: Coordinates, deviations: dict[str, Float[np.ndarray, "..."]]
) -> tuple[dict[str, Estimate], tuple[str, ...]]:
    parameters, estimates, undetermined = _parameters(problem), {}, []
    for key, deviation in deviations.items():
        coordinates = np.asarray(at[key], np.float64)
        determined = np.asarray(deviation <= _MAX_DEVIATION)
        is_log = key == LIGHT or parameters[key].form == "log"
        if is_log:
            value = np.exp(coordinates)
            with np.errstate(over="ignore"):
                low, high = (np.exp(coordinates + side * _HALF_WIDTH * deviation) for side in (-1, 1))
            own = value * deviation
        else:
            value, own = np.maximum(np.asarray(parameters[key].values(coordinates)), 0), deviation
            low, high = np.maximum(value - _HALF_WIDTH * own, 0), value + _HALF_WIDTH * own
        estimates[key] = Estimate(*(np.asarray(part) for part in (value, own, low, high, determined)))
        undetermined += _names(key, determined, key in parameters and parameters[key].is_texture)
    return estimates, tuple(undetermined)


def _names(key: str, determined: Bool[np.ndarray, "..."], is_texture: bool) -> list[str]:
    """What is not told of one parameter: by name where all of it, else entry by entry, and texels by their number."""
    missing = np.argwhere(~determined)
    if not len(missing):
        return []
    if is_texture:
        texels = ~determined.all(axis=-1)
        return [f"{key}: {np.count_nonzero(texels):,} of {texels.size:,} texels"] if texels.any() else []
    if determined.ndim == 0 or len(missing) == determined.size:
        return [key]
    return [f"{key}{list(map(int, place))}" for place in missing]
