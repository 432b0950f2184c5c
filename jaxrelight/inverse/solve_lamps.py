"""Lamps that bring about given illuminances or a picture: where they stand, how they are aimed, how bright they are.

Light is linear in brightness, which starts from non-negative least squares. All else is solved for by rounds of
Levenberg–Marquardt with shadows held fixed; after each, shadow rays are cast anew, and a step counts only as far as it
still brings the lamps nearer to their targets.
"""

import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.inverse.lamp_brightness import with_bright_lamps
from jaxrelight.inverse.lamp_certainty import LampUnknown, certainty
from jaxrelight.inverse.lamp_problem import (
    LampProblem,
    Unknowns,
    found_placements,
    linearised,
    loss_at,
    on_host,
    solved,
    traced_bits,
)
from jaxrelight.inverse.lamp_setup import Box, Free, make_problem
from jaxrelight.inverse.lamp_targets import (
    LuxTarget,
    LuxTargets,
    PictureTarget,
    TargetFit,
    fits_of,
)
from jaxrelight.inverse.lamp_unknowns import (
    CUTOFFS,
    LampKind,
    Placement,
    centred,
    lamp_at,
    unknowns_of,
)
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lighting.measurement import measure
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.lights.local import Light
from jaxrelight.methods import check_whole
from jaxrelight.numerics.arrays import as_array
from jaxrelight.progress import Report
from jaxrelight.timing import timed

HELD_FIXED = (
    "shadow boundaries: visibility is held fixed in every slope, and cast anew after every round",
    "environment, emission, materials and geometry",
)
# A round moves unknowns by no more than this, and tries these shares of it.
_MAX_MOVE, _SHARES = 1.5, (1.0, 0.5, 0.2)
# Of single steps that are tried where none of these helps, damping over the largest singular value.
_DAMPINGS = 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0
# Steps of Levenberg–Marquardt in a round. Rounds end when they lower the loss by less than this share, or at this loss.
_STEPS, _MIN_GAIN, _SOLVED = 12, 1e-3, 1e-11
# By which starts differ from the lamps that are given, beside their places.
_AIM_SPREAD, _CONE_SPREAD = 0.4, 0.25


@dataclasses.dataclass(frozen=True)
class InverseLamps:
    """Lamps that were solved for, and what is known of them.

    Attributes:
        lamps: all local lights in their order, those with something free as they were found.
        lights: the lamps with the environment.
        targets: each target, and what fresh shadows and the relighter itself make of it.
        residual: root mean square of what the solver made small: relative errors; of a picture the relative L2 error.
        starts: the residual of each start, the given lamps first.
        unknowns: each unknown with its standard deviation, and whether the targets determine it.
        held_fixed: what did not change, in words.
        seconds: by stage.
    """

    lamps: tuple[Light, ...]
    lights: Lights
    targets: tuple[TargetFit, ...]
    residual: float
    starts: tuple[float, ...]
    unknowns: tuple[LampUnknown, ...]
    held_fixed: tuple[str, ...]
    seconds: Mapping[str, float]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the unknowns that the targets do not determine: others give the same, at least nearby."""
        return tuple(one.name for one in self.unknowns if not one.is_determined)

    @property
    def largest_error(self) -> float:
        """Of all targets, relative, without its sign."""
        return max(abs(fit.error) for fit in self.targets)


def lamps(
    relighter: Relighter,
    targets: Mapping[str, LuxTarget] | Any,
    *,
    free: Free = ("intensity",),
    lights: LightsLike = None,
    box: Box | None = None,
    weight: Float[np.ndarray, "h w"] | None = None,
    starts: int = 4,
    rounds: int = 30,
    noise: float = 0.01,
    seed: int = 0,
    report: Report | None = None,
) -> InverseLamps:
    """Solves for lamps such that sensors meet targets of illuminance, or a picture that of a painted one.

        targets = {"desk": LuxTarget(mean=500, uniformity=0.6)}
        found = lamps(prepare(scene.at_sensors(), Indirect()), targets, free=["intensity", "aim"])

    Args:
        relighter: prepared of a scene at its sensors (`Scene.at_sensors`), or for a picture of its camera.
        targets: by the names of sensors; or radiance [h, w, 3] of the camera's picture, or with alpha [h, w, 4].
        free: what may change: "intensity", or "colour" for each channel's; "position"; "aim"; "cutoff", "beam", or
            "cone" for both; of all lamps, or of some by their numbers from 0.
        lights: by default the scene's own; local ones are the lamps, where the solver starts, too.
        box: ends [low, high] between which positions lie; of all lamps whose position is free, or by number.
        weight: of a target picture's pixels, from 0.
        starts: the first from the lamps as they are, others at random around; of intensities alone one is enough.
        rounds: the most of each start.
        noise: share of themselves to which targets are known, which deviations follow from.
        seed: of the starts.
        report: called with the progress.

    Raises:
        InputError: for targets or lamps that do not fit, by name.
    """
    check_whole("starts", starts, 1, math.inf)
    check_whole("rounds", rounds, 1, math.inf)
    if not 0 < noise < 1:
        raise InputError(f"noise is the share to which targets are known, between 0 and 1, not {noise!r}")
    given = relighter.scene_lights() if lights is None else as_lights(lights)
    begin, seconds = time.perf_counter(), {}
    with timed(seconds, "set up"):
        problem, given_placements, centre = make_problem(relighter, targets, given, free, box, weight)
    linear = all(set(kind.free) <= {"intensity", "colour"} for kind in problem.kinds)
    random, found = np.random.default_rng(seed), []
    with timed(seconds, "solve"):
        count = 1 if linear else starts
        for number in range(count):
            placements = given_placements
            if number:
                placements = tuple(
                    _displaced(kind, own, random) for kind, own in zip(problem.kinds, given_placements, strict=True)
                )
            found.append(_solve_start(problem, placements, rounds, functools.partial(_report, report, number, count)))
    losses = [loss for loss, _ in found]
    best = found[int(np.argmin(losses))][1]
    with timed(seconds, "certainty"):
        problem = _at(problem, best)
        unknowns = certainty(problem, _unknowns(problem), centre, noise)
    with timed(seconds, "check"):
        all_lamps = _lamps_in_world(problem, given, centre)
        all_lights = Lights(given.environment, all_lamps)
        fits = _fits(relighter, targets, all_lights, problem.targets)
    residuals = tuple(_residual(problem.targets, loss) for loss in losses)
    seconds["total"] = time.perf_counter() - begin
    return InverseLamps(all_lamps, all_lights, fits, min(residuals), residuals, unknowns, HELD_FIXED, seconds)


def _solve_start(problem: LampProblem, placements: tuple[Placement, ...], rounds: int, report):
    """Rounds from one start: the loss with fresh shadows, and the placements that have it."""
    problem = with_bright_lamps(_at(problem, placements))
    unknowns = _unknowns(problem)
    loss = float(loss_at(problem, unknowns))
    best = found_placements(problem, unknowns)
    for number in range(rounds):
        report(number, rounds)
        moved = solved(problem, unknowns, _STEPS)
        furthest = max(float(np.abs(np.asarray(new) - np.asarray(old)).max()) for new, old in _pairs(moved, unknowns))
        if not furthest > 0:
            break
        longest = min(1.0, _MAX_MOVE / furthest)
        along = tuple(longest * (new - old) for new, old in _pairs(moved, unknowns))
        scaled = (tuple(share * own for own in along) for share in _SHARES)
        for step in itertools.chain(scaled, _damped_steps(problem, unknowns)):
            tried = tuple(old + own for own, old in _pairs(step, unknowns))
            there = _at(problem, found_placements(problem, tried))
            own = _unknowns(there)
            fresh = float(loss_at(there, own))
            if fresh < loss:
                break
        else:
            break
        gain, loss, problem, unknowns = 1 - fresh / loss, fresh, there, own
        best = found_placements(problem, unknowns)
        if loss < _SOLVED or gain < _MIN_GAIN:
            break
    report(rounds, rounds)
    return loss, on_host(best)


def _damped_steps(problem: LampProblem, unknowns: Unknowns) -> Iterator[Unknowns]:
    """Single steps of ever larger damping, which turn towards steepest descent: where a shadow's edge is in the way."""
    residual, slopes = (np.asarray(x, float) for x in linearised(problem, unknowns))
    u, singular, v = np.linalg.svd(slopes, full_matrices=False)
    for damping in _DAMPINGS:
        filtered = singular / (singular**2 + (damping * max(singular.max(), 1e-30)) ** 2)
        step, at, parts = -(v.T * filtered) @ (u.T @ residual), 0, []
        step *= min(1.0, _MAX_MOVE / max(float(np.abs(step).max()), 1e-30))
        for own in unknowns:
            parts.append(as_array(step[at : at + own.size].reshape(own.shape), np.float32))
            at += own.size
        yield tuple(parts)


def _pairs(new: Unknowns, old: Unknowns):
    return zip(new, old, strict=True)


def _at(problem: LampProblem, placements: tuple[Placement, ...]) -> LampProblem:
    """The problem about other placements, with shadows cast from there."""
    placements = jax.tree.map(lambda x: as_array(x, np.float32), placements)
    return dataclasses.replace(
        problem, starts=placements, bits=traced_bits(problem.response, problem.kinds, placements)
    )


def _unknowns(problem: LampProblem) -> Unknowns:
    """The unknowns of where a problem starts."""
    return tuple(_unknowns_of(kind, start) for kind, start in zip(problem.kinds, problem.starts, strict=True))


_unknowns_of = jax.jit(unknowns_of)


def _displaced(kind: LampKind, given: Placement, random: np.random.Generator) -> Placement:
    """Placements at random around the given ones: anywhere in their boxes."""
    given = jax.tree.map(lambda x: np.asarray(x, float), given)
    count = len(kind.numbers)
    position, axis = given.position, given.axis
    if "position" in kind.free:
        if kind.box is None:
            position = position + float(kind.reach) * random.normal(size=(count, 3))
        else:
            low, high = np.moveaxis(np.asarray(kind.box, float), 1, 0)
            position = low + (high - low) * random.uniform(size=(count, 3))
    if "aim" in kind.free:
        axis = axis + _AIM_SPREAD * random.normal(size=(count, 3))
        axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    cutoff = given.cutoff * np.exp(_CONE_SPREAD * random.normal(size=count)) if "cutoff" in kind.free else given.cutoff
    beam = random.uniform(0.1, 0.9, count) if "beam" in kind.free else given.beam
    cutoff = np.clip(cutoff, *CUTOFFS) if "cutoff" in kind.free else cutoff
    values: Any = given.brightness, position, axis, cutoff, beam
    return Placement(*values)


def _lamps_in_world(problem: LampProblem, given: Lights, centre: Float[np.ndarray, "3"]) -> tuple[Light, ...]:
    """All lamps as lights of the world: positions that were found in double precision, as all known ones are."""
    every = list(given.local)
    for kind, starts in zip(problem.kinds, problem.starts, strict=True):
        for row, number in enumerate(kind.numbers):
            lamp, placement = jax.tree.map(lambda x, row=row: x[row], (kind.lamps, starts))
            every[number] = centred(lamp_at(lamp, kind.free, placement), centre, 1.0)
    return tuple(every)


def _residual(targets: LuxTargets | PictureTarget, loss: float) -> float:
    """Root mean square of the residuals that are asked for; of a picture their length."""
    if isinstance(targets, PictureTarget):
        return math.sqrt(loss)
    asked = [np.asarray(x) > 0 for x in (targets.mean, targets.value, targets.low, targets.uniformity)]
    count = sum(int(np.count_nonzero(x)) for x in (*asked, np.isfinite(np.asarray(targets.high))))
    return math.sqrt(loss / max(count, 1))


def _fits(
    relighter: Relighter, targets: Any, lights: Lights, goal: LuxTargets | PictureTarget
) -> tuple[TargetFit, ...]:
    """What the relighter makes of every target."""
    if relighter.sensors is not None:
        return fits_of(targets, relighter.sensors, np.asarray(measure(relighter, lights).illuminance))
    view = relighter.view()
    radiance = relighter.shade(relighter.light(lights), view).radiance.reshape(-1)
    error = float(jnp.linalg.norm(goal.residual(radiance)))
    return (TargetFit("picture", 0.0, error, error),)


def _report(report: Report | None, start: int, starts: int, done: int, rounds: int) -> None:
    if report is not None:
        report("lamps", start * rounds + done, starts * rounds)
