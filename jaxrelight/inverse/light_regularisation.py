"""Regularised least squares in the space that a bidiagonalisation has seen: any strength, at no further product.

Unknowns are in units of their standard deviations under natural light, so ridge regression is the most likely light.
Where light is not to be negative, or sparse in wavelets, the alternating direction method of multipliers (Boyd et al.
2011 §3, §6.4) goes on with AᵀA as the bidiagonalisation has it, V BᵀB Vᵀ: no iteration needs a product.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.inverse.bidiagonalisation import Bidiagonal
from jaxrelight.inverse.light_grid import LightGrid

# Iterations of multipliers at most, how often their penalty is set anew, and the relative change that ends them.
_MAX_ITERATIONS, _PENALTY_EVERY, _TOLERANCE = 400, 20, 1e-4
# Strengths that are tried, relative to the largest singular value.
STRENGTHS = np.geomspace(1e-6, 1, 49)


@dataclasses.dataclass(frozen=True)
class Spectrum:
    """Singular values of what was seen, by problem: those of all channels where they are one.

    Attributes:
        values: descending, [k, c].
        right: their vectors as mixtures of V, [k, k, c]: axis 0 counts vectors of V, axis 1 singular values.
        shown: what b has of each left vector, [k, c].
    """

    values: Float[np.ndarray, "k c"]
    right: Float[np.ndarray, "k k c"]
    shown: Float[np.ndarray, "k c"]


def spectrum_of(state: Bidiagonal) -> Spectrum:
    """The singular value decomposition of B, by channel."""
    values, right, shown = [], [], []
    for channel in range(len(state.right_side)):
        left, of, turned = np.linalg.svd(state.matrix(channel), full_matrices=False)
        values.append(of)
        right.append(turned.T)
        shown.append(left[0] * state.right_side[channel])
    return Spectrum(np.stack(values, -1), np.stack(right, -1), np.stack(shown, -1))


def ridge_weights(spectrum: Spectrum, strength: float) -> Float[np.ndarray, "k c"]:
    """The y for which x = V y makes |A x − b|² + strength² |x|² least."""
    filtered = spectrum.values / (spectrum.values**2 + strength**2) * spectrum.shown
    return np.einsum("kjc,jc->kc", spectrum.right, filtered)


def ridge_of(state: Bidiagonal, gradient: Float[np.ndarray, "m c"], strength: float) -> Float[np.ndarray, "m c"]:
    """(V BᵀB Vᵀ + strength²)⁻¹ of any gradient, in the span of V."""
    shares = np.stack([np.einsum("mc,mc->c", v, gradient) for v in state.V])
    if state.joint:
        shares = np.broadcast_to(shares.sum(axis=1, keepdims=True), shares.shape)
    weights = np.zeros_like(shares)
    for channel in range(shares.shape[1]):
        B = state.matrix(channel)
        weights[:, channel] = np.linalg.solve(B.T @ B + strength**2 * np.eye(B.shape[1]), shares[:, channel])
    return state.mixed(weights)


@dataclasses.dataclass(frozen=True)
class Constraint:
    """What is asked of unknowns beside least squares.

    Attributes:
        grid: of the environment.
        deviations: of its coefficients.
        lamps: how many lamps follow them among the unknowns.
        not_negative: whether texels and lamps are at least 0.
        sparsity: factor on the sum of the coefficients' magnitudes; 0 for none.
    """

    grid: LightGrid
    deviations: Float[np.ndarray, " d"]
    lamps: int
    not_negative: bool
    sparsity: float = 0.0

    @property
    def is_any(self) -> bool:
        """Whether anything is asked."""
        return self.not_negative or self.sparsity > 0


class _Split:
    """One constraint of the method: a copy of some unknowns, times the square root of a diagonal."""

    def __init__(self, to: Callable, back: Callable, diagonal: np.ndarray, nearest: Callable):
        self.to, self.back, self.diagonal, self.nearest = to, back, diagonal, nearest
        self.copy = self.price = np.zeros(())

    def start(self, x: np.ndarray) -> None:
        """From unknowns."""
        self.copy = self.nearest(self.to(x), 1.0)
        self.price = np.zeros_like(self.copy)


def constrained(
    state: Bidiagonal,
    gradient: Float[np.ndarray, "m c"],
    strength: float,
    constraint: Constraint,
    start: Float[np.ndarray, "m c"],
) -> Float[np.ndarray, "m c"]:
    """The x that makes |A x − b|² + strength² |x|² and what is asked least, AᵀA taken as V BᵀB Vᵀ.

    Args:
        state: of the bidiagonalisation.
        gradient: Aᵀ b.
        strength: of the ridge.
        constraint: what is asked.
        start: where iterations begin.
    """
    m = len(gradient)
    splits, largest = _splits(constraint, m), max(float(state.diagonal.max()), 1e-12)
    # Between the strongest and the weakest that unknowns are held by.
    penalty = strength * largest / max(float(splits[0].diagonal.mean()), 1e-12)
    x = start
    for split in splits:
        split.start(x)
    solve = _solver(state, strength, splits, penalty)
    for iteration in range(_MAX_ITERATIONS):
        right = gradient + penalty * sum(split.back(split.copy - split.price) for split in splits)
        x = solve(right)
        primal = dual = size = 0.0
        for split in splits:
            image = split.to(x)
            before, split.copy = split.copy, split.nearest(image + split.price, penalty)
            split.price = split.price + image - split.copy
            primal += np.sum((image - split.copy) ** 2)
            dual += np.sum((split.copy - before) ** 2)
            size += np.sum(image**2)
        if max(primal, dual) <= _TOLERANCE**2 * max(size, 1e-30):
            break
        if iteration % _PENALTY_EVERY == _PENALTY_EVERY - 1:
            # Both residuals should shrink alike (Boyd et al. 2011 §3.4.1).
            factor = np.clip(np.sqrt(primal / max(dual, 1e-30)), 0.2, 5.0)
            if not 0.5 < factor < 2:
                penalty *= factor
                for split in splits:
                    split.price = split.price / factor
                solve = _solver(state, strength, splits, penalty)
    return _within(x, splits, constraint)


def _splits(constraint: Constraint, m: int) -> list[_Split]:
    d, lamps = constraint.grid.size, constraint.lamps
    deviations = constraint.deviations[:, None]
    splits = []
    if constraint.not_negative:

        def to_values(x):
            texels = np.asarray(constraint.grid.texels(jnp.asarray(x[:d] * deviations, jnp.float32)), np.float64)
            return np.concatenate([texels, x[d : d + lamps]])

        def to_unknowns(values):
            texels = jnp.asarray(values[:d], jnp.float32)
            coefficients = np.asarray(constraint.grid.basis.encode(texels.T).T, np.float64)
            rest = np.zeros((m - d - lamps, values.shape[1]))
            return np.concatenate([coefficients * deviations, values[d:], rest])

        diagonal = np.concatenate([constraint.deviations**2, np.ones(lamps), np.zeros(m - d - lamps)])
        splits.append(_Split(to_values, to_unknowns, diagonal, lambda values, _: np.maximum(values, 0)))
    if constraint.sparsity > 0:
        sparse = np.zeros(m)
        sparse[:d] = 1

        def shrunk(values, penalty):
            threshold = constraint.sparsity / penalty
            return np.sign(values) * np.maximum(np.abs(values) - threshold, 0)

        splits.append(_Split(lambda x: x * sparse[:, None], lambda v: v * sparse[:, None], sparse, shrunk))
    return splits


def _solver(state: Bidiagonal, strength: float, splits: list[_Split], penalty: float) -> Callable:
    """(V BᵀB Vᵀ + strength² + penalty · diagonals)⁻¹, by the formula of Woodbury, for each problem."""
    base = strength**2 + penalty * sum(split.diagonal for split in splits)
    inverse = 1 / np.maximum(base, 1e-20)
    V, channels = np.stack(state.V), len(state.right_side)
    k = len(V)
    grams = [state.matrix(channel).T @ state.matrix(channel) for channel in range(channels)]
    if state.joint:
        flat = np.moveaxis(V, 2, 1).reshape(k, -1).astype(np.float64)
        inner = (flat * np.tile(inverse, channels)[None]) @ flat.T
        small = np.linalg.solve(np.eye(k) + grams[0] @ inner, grams[0])

        def solve_jointly(right):
            scaled = inverse[:, None] * right
            shares = small @ (flat @ scaled.T.reshape(-1))
            return scaled - inverse[:, None] * (shares @ flat).reshape(channels, -1).T

        return solve_jointly
    small = []
    for channel in range(channels):
        own = V[:, :, channel].astype(np.float64)
        small.append(
            (own, np.linalg.solve(np.eye(k) + grams[channel] @ ((own * inverse[None]) @ own.T), grams[channel]))
        )

    def solve(right):
        scaled = inverse[:, None] * right
        columns = [
            of - inverse * ((inner @ (own @ of)) @ own) for (own, inner), of in zip(small, scaled.T, strict=True)
        ]
        return np.stack(columns, axis=-1)

    return solve


def _within(x: np.ndarray, splits: list[_Split], constraint: Constraint) -> np.ndarray:
    """Unknowns that keep what is asked exactly, as the last copy does."""
    d, lamps = constraint.grid.size, constraint.lamps
    if constraint.not_negative:
        values = splits[0].copy
        held = splits[0].back(values)
        return np.concatenate(
            [held[:d] / np.maximum(constraint.deviations, 1e-20)[:, None] ** 2, values[d:], x[d + lamps :]]
        )
    return np.concatenate([splits[-1].copy[:d], x[d:]])


def is_converged(state: Bidiagonal, weights: Float[np.ndarray, "k c"], tolerance: float) -> Bool[np.ndarray, " c"]:
    """Whether a ridge solution V y is that of the whole problem: |Aᵀ(A x − b) + strength² x|, relative to |Aᵀ b|."""
    if not state.steps:
        return np.zeros(len(state.right_side), bool)
    left = state.next_alpha * state.below[-1] * np.abs(weights[-1])
    return left <= tolerance * np.maximum(state.diagonal[0] * state.right_side, 1e-30)
