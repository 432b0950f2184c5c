"""The search for light: as many steps of a bidiagonalisation as change what is found, the ridge, and what is asked."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from jaxrelight.inverse.bidiagonalisation import begin, step
from jaxrelight.inverse.light_problem import adjoint, applied, right_side
from jaxrelight.inverse.light_regularisation import (
    STRENGTHS,
    Constraint,
    constrained,
    is_converged,
    ridge_of,
    ridge_weights,
    spectrum_of,
)
from jaxrelight.inverse.light_setup import LightTask
from jaxrelight.numerics.arrays import as_array
from jaxrelight.progress import Report

# Steps between two looks at whether more would change anything; what the solution may still move, and what held-out
# pixels may still gain.
_LOOK_EVERY, _SOLVED, _GAIN = 8, 3e-3, 2e-3
# The strongest ridge is taken under which pixels that are held out are missed by so much more than under the best: what
# a model misses is alike in neighbouring pixels, so that the best is too weak a ridge for other views.
_AS_GOOD = 1.03
# Sparsities that are tried, relative to what makes all coefficients 0; the ridge beside them; and ridges below what is
# best for a light of any sign, relative to that.
_SPARSITIES, _SPARSE_RIDGE, _WEAKER = tuple(np.geomspace(0.1, 1e-6, 11)), 0.1, (1.0, 0.3, 0.1)
# How often pixels at the top of a picture's range are given what the light of the moment makes of them.
_BOUNDED_ROUNDS = 12


@dataclasses.dataclass(frozen=True)
class LightSolution:
    """What was found.

    Attributes:
        unknowns: in units of their deviations, [m, 3].
        strength: of the ridge that is best without a constraint, by which what is told is judged.
        converged: whether more steps would change next to nothing.
    """

    unknowns: Float[np.ndarray, "m 3"]
    strength: float
    converged: bool


class LightSolver:
    """The bidiagonalisation of a task, with what its vectors make of the pixels that judge a fit.

    Attributes:
        task: what is solved.
        b: what pictures show.
        state: of the bidiagonalisation.
        spectrum: of it.
        applications: products with the map so far, and as many with its adjoint.
    """

    def __init__(self, task: LightTask, report: Report | None, max_steps: int):
        self.task, self._report, self._max_steps = task, report, max_steps
        self.b, self.applications = right_side(task.problem), 0
        self._shown: list[np.ndarray] = []
        self._judged = task.judged
        self.state = begin(np.where(task.fitted, self.b, 0), self.back, joint=task.problem.joint)
        self.spectrum = spectrum_of(self.state)

    def product(self, z: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "n 3"]:
        """A z, of all pixels."""
        self.applications += 1
        return np.asarray(applied(self.task.problem, as_array(z, np.float32)))

    def back(self, numbers: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
        """Aᵀ y, of pixels that are fitted."""
        return np.asarray(adjoint(self.task.problem, as_array(np.where(self.task.fitted, numbers, 0), np.float32)))

    def solve(self, strength: float | None, prior: str, *, not_negative: bool) -> LightSolution:
        """The unknowns under a prior and a ridge; without one, that which pixels that are held out ask for."""
        converged = self._run(strength)
        chosen = strength or self._best_strength()
        z, constraint, ridge = self._best(chosen, prior, not_negative=not_negative, is_given=strength is not None)
        if (self.task.bounded & self.task.fitted).any():
            z = self._with_lower_bounds(z, constraint, ridge)
        return LightSolution(z, chosen, converged)

    def _run(self, strength: float | None) -> bool:
        """As many steps as change the light that is found, or what it makes of the pixels that judge."""
        best, converged = math.inf, False
        while not self.state.is_done and self.state.steps < self._max_steps and not converged:
            image = self.product(self.state.next_vector)
            self._shown.append(image[self._judged])
            self.state = step(self.state, np.where(self.task.fitted, image, 0), self.back)
            if self._report is not None:
                self._report("light", self.state.steps, self._max_steps)
            if self.state.steps % _LOOK_EVERY == 0:
                self.spectrum = spectrum_of(self.state)
                chosen = strength or self._best_strength()
                weights = ridge_weights(self.spectrum, chosen)
                error = self._judgement(weights)
                # What pictures tell is known once each channel has a vector that they do not tell.
                ends = (self.spectrum.values.min(axis=0) <= chosen).all()
                solved = is_converged(self.state, weights, _SOLVED).all()
                converged = bool(solved and ends and error > (1 - _GAIN) * best)
                best = min(best, error)
        self.spectrum = spectrum_of(self.state)
        if self._report is not None:
            self._report("light", self._max_steps, self._max_steps)
        return converged or self.state.is_done

    def _best_strength(self) -> float:
        """The strongest ridge under which the pixels that judge are met about as well as they can be."""
        tried = STRENGTHS * self.spectrum.values.max()
        errors = np.array([self._judgement(ridge_weights(self.spectrum, one)) for one in tried])
        return float(tried[np.flatnonzero(errors <= _AS_GOOD**2 * errors.min())[-1]])

    def _judgement(self, weights: Float[np.ndarray, "k c"]) -> float:
        none = np.zeros((np.count_nonzero(self._judged), weights.shape[1]))
        return self._error(sum((shown * of[None] for shown, of in zip(self._shown, weights, strict=True)), none))

    def _error(self, made: Float[np.ndarray, "j 3"]) -> float:
        """The sum of squares that the pixels that judge are missed by."""
        differences = np.zeros(self.b.shape)
        differences[self._judged] = made - self.b[self._judged]
        return float(np.sum(self.task.missed(differences) ** 2))

    def _best(
        self, chosen: float, prior: str, *, not_negative: bool, is_given: bool
    ) -> tuple[Float[np.ndarray, "m 3"], Constraint, float]:
        """The unknowns by the candidate that meets the pixels that judge best, what it asks, and its ridge.

        A weaker one has to meet them better by more than what counts as about as well.
        """
        plain, gradient = self.state.mixed(ridge_weights(self.spectrum, chosen)), self.state.gradient()
        best, found = math.inf, None
        for constraint, ridge in self._candidates(chosen, prior, not_negative=not_negative, is_given=is_given):
            z = constrained(self.state, gradient, ridge, constraint, plain) if constraint.is_any else plain
            error = self._error(self.product(z)[self._judged])
            if found is not None and error * _AS_GOOD**2 >= best:
                break
            best, found = error, (z, constraint, ridge)
        assert found is not None
        return found

    def _candidates(
        self, chosen: float, prior: str, *, not_negative: bool, is_given: bool
    ) -> list[tuple[Constraint, float]]:
        problem = self.task.problem
        deviations, lamps = np.asarray(problem.deviations), problem.lamp_count
        if prior == "natural":
            # What may not be negative is regularised by that, too.
            factors = _WEAKER if not_negative and not is_given else _WEAKER[:1]
            constraint = Constraint(problem.grid, deviations, lamps, not_negative)
            return [(constraint, factor * chosen) for factor in factors]
        largest = np.abs(self.state.gradient()[: problem.grid.size]).max()
        every = [Constraint(problem.grid, deviations, lamps, not_negative, share * largest) for share in _SPARSITIES]
        return [(constraint, _SPARSE_RIDGE * chosen) for constraint in every]

    def _with_lower_bounds(
        self, z: Float[np.ndarray, "m 3"], constraint: Constraint, ridge: float
    ) -> Float[np.ndarray, "m 3"]:
        """The unknowns where some pixels are only known to be at least as bright as they are.

        Each round takes as seen there what the light of the moment makes, where that is more.
        """
        for _ in range(_BOUNDED_ROUNDS):
            b = np.where(self.task.bounded, np.maximum(self.b, self.product(z)), self.b)
            gradient = np.asarray(self.back(b), float)
            if constraint.is_any:
                new = constrained(self.state, gradient, ridge, constraint, z)
            else:
                new = ridge_of(self.state, gradient, ridge)
            moved = np.linalg.norm(new - z) / max(np.linalg.norm(new), 1e-30)
            z = new
            if moved < 1e-3:
                break
        return z
