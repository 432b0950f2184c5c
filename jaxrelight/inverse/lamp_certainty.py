"""How well targets determine what was unknown of lamps: deviations, and what is left open."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxrelight.inverse.lamp_problem import LampProblem, Unknowns, sensitivities
from jaxrelight.numerics.arrays import as_array

# Directions of unknowns with singular values below this share of the largest count as undetermined: slopes are in
# single precision. An unknown is, if it has more than this of its square in them.
_MIN_SINGULAR, _MIN_OPEN = 1e-4, 1e-2


class LampUnknown(NamedTuple):
    """One unknown of one lamp.

    Attributes:
        lamp: its number, from 0.
        what: is unknown.
        value: that was found; of aims 0, as they are told as degrees off the axis found.
        deviation: one standard deviation, infinite where the targets do not determine it.
        unit: of both.
        is_determined: whether the targets determine it, at least nearby.
    """

    lamp: int
    what: str
    value: float
    deviation: float
    unit: str
    is_determined: bool

    @property
    def name(self) -> str:
        """The lamp, counted from 1, and what."""
        return f"lamp {self.lamp + 1}: {self.what}"


def certainty(
    problem: LampProblem, unknowns: Unknowns, centre: Float[np.ndarray, "3"], noise: float
) -> tuple[LampUnknown, ...]:
    """What is known of each unknown, from the slopes where they were found.

    The covariance of unknowns is σ² (JᵀJ)⁺, where σ is that of the residuals, on what is determined.

    Args:
        problem: about the placements found.
        unknowns: there.
        centre: of the scene, in the world.
        noise: share of themselves to which targets are known.
    """
    slopes, shown, turns = sensitivities(problem, unknowns, as_array(centre, np.float32))
    slopes = np.asarray(slopes, float)
    _, singular, directions = np.linalg.svd(slopes, full_matrices=True)
    padded = np.zeros(len(directions))
    padded[: len(singular)] = singular
    known = padded > _MIN_SINGULAR * max(padded.max(), 1e-30)
    covariance = problem.targets.deviation(noise) ** 2 * (directions[known].T / padded[known] ** 2) @ directions[known]
    left_open, every, at = directions[~known], [], 0
    for kind, own, turn in zip(problem.kinds, shown, turns, strict=True):
        names = kind.unknown_names
        for row, number in enumerate(kind.numbers):
            columns = slice(at, at + len(names))
            at += len(names)
            change = np.asarray(turn[row], float)
            deviation = np.sqrt(np.maximum(np.diag(change @ covariance[columns, columns] @ change.T), 0))
            # Each shown unknown of a lamp follows from its own alone, but for aims, whose two are across each other.
            share = np.sum(left_open[:, columns] ** 2, axis=0) if len(left_open) else np.zeros(len(names))
            for (what, unit), value, spread, amount in zip(
                names, np.asarray(own[row], float), deviation, share, strict=True
            ):
                determined = bool(amount < _MIN_OPEN)
                spread = float(spread) if determined else float("inf")
                every.append(LampUnknown(number, what, float(value), spread, unit, determined))
    return tuple(sorted(every, key=lambda one: one.lamp))
