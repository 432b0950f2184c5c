"""Lamps that bring about given illuminances or a picture: where they stand, how they are aimed, how bright they are.

Light is linear in brightness, which starts from non-negative least squares. All else is solved for by rounds of
Levenberg–Marquardt with shadows held fixed; after each, shadow rays are cast anew, and a step counts only as far as it
still brings the lamps nearer to their targets.
"""

import dataclasses
import functools
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.inverse.lamp_certainty import LampUnknown, certainty
from jaxrelight.inverse.lamp_problem import (
    LampProblem,
    Unknowns,
    found_placements,
    lamp_outputs,
    loss_at,
    on_host,
    solved,
    traced_bits,
)
from jaxrelight.inverse.lamp_response import make_response, other_outputs
from jaxrelight.inverse.lamp_targets import (
    LuxTarget,
    LuxTargets,
    PictureTarget,
    TargetFit,
    fits_of,
    lux_targets,
    picture_target,
)
from jaxrelight.inverse.lamp_unknowns import (
    CUTOFFS,
    LampKind,
    Placement,
    centred,
    checked_free,
    lamp_at,
    placement_of,
    split_brightness,
    unknowns_of,
)
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lighting.measurement import measure
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.lights.local import Light
from jaxrelight.methods import check_whole
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.progress import Report
from jaxrelight.timing import timed

# What is free of lamps: the same of all, or of some by their number from 0.
Free = Sequence[str] | Mapping[int, Sequence[str]]
# Two ends of a box in the world, for all lamps or by their number.
Ends = Sequence[Sequence[float]] | Float[np.ndarray, "2 3"]
Box = Ends | Mapping[int, Ends]

HELD_FIXED = (
    "shadow boundaries: visibility is held fixed in every slope, and cast anew after every round",
    "environment, emission, materials and geometry",
)
# A round moves unknowns by no more than this, and tries these shares of it.
_MAX_MOVE, _SHARES = 1.5, (1.0, 0.5, 0.25, 0.1)
# Steps of Levenberg–Marquardt in a round. Rounds end when they lower the loss by less than this share, or at this loss.
_STEPS, _LEAST_GAIN, _SOLVED = 12, 1e-3, 1e-11
# An unknown of order one moves a lamp by this share of the scene's half size; starts differ by it, and by these.
_REACH, _AIM_SPREAD, _CONE_SPREAD = 0.25, 0.4, 0.25
# How much brightnesses of the start are held together, so that none is dark from where no slope leads on.
_TOGETHER = 0.03


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

        relighter = prepare(scene.at_sensors(), Indirect())
        found = inverse.lamps(relighter, {"desk": LuxTarget(mean=500, uniformity=0.6)}, free=["intensity", "aim"])

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
        problem, given_placements, centre = _problem(relighter, targets, given, free, box, weight)
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


def _problem(
    relighter: Relighter, targets: Any, given: Lights, free: Free, box: Box | None, weight: Any
) -> tuple[LampProblem, tuple[Placement, ...], Float[np.ndarray, "3"]]:
    """What is to be solved, the lamps as they are given, and the scene's centre."""
    if is_traced((relighter, given)):
        raise InputError("lamps are solved for outside of jit: rays are cast on the way")
    sensors = relighter.sensors
    if sensors is not None and not isinstance(targets, Mapping):
        raise InputError("this was prepared at sensors; its targets are a dict of LuxTarget by the sensors' names")
    if sensors is None and isinstance(targets, Mapping):
        raise InputError(
            "targets of lux are for sensors, and this was prepared for a camera; prepare(scene.at_sensors())"
        )
    view: Any = relighter.view()
    if sensors is not None:
        if weight is not None:
            raise InputError("weights are of a picture's pixels; sensors have none, so leave them out")
        goal: LuxTargets | PictureTarget = lux_targets(targets, sensors)
    else:
        goal = picture_target(targets, tuple(view.shape), weight)
    surfaces = view_surfaces(relighter)
    centre, radius = np.asarray(surfaces.centre, float), float(surfaces.radius)
    response = make_response(relighter, view)
    kinds, placements = _kinds(given, free, box, centre, radius)
    of_kinds = {number for kind in kinds for number in kind.numbers}
    fixed = tuple(light for number, light in enumerate(given.local) if number not in of_kinds)
    others = other_outputs(relighter, view, Lights(given.environment, fixed), response.is_of_sensors)
    problem = LampProblem(response, kinds, placements, (), others, goal)
    return _with_typical_brightness(problem), placements, centre


def view_surfaces(relighter: Any) -> Any:
    """The surfaces of a relighter's scene, of which lamps' positions count from the centre."""
    if hasattr(relighter, "precomputed"):
        return relighter.precomputed.stored.geometry.surfaces
    return relighter.geometry.surfaces if hasattr(relighter, "geometry") else relighter.transport.surfaces


def _kinds(
    given: Lights, free: Free, box: Box | None, centre: Float[np.ndarray, "3"], radius: float
) -> tuple[tuple[LampKind, ...], tuple[Placement, ...]]:
    """Lamps with something free, by their class and what that is."""
    if not given.local:
        raise InputError("there is no lamp to solve for; give the scene a [[light]], or lights = […]")
    asked = free if isinstance(free, Mapping) else dict.fromkeys(range(len(given.local)), free)
    boxes = box if isinstance(box, Mapping) else dict.fromkeys(range(len(given.local)), box)
    for what, numbers in (("free", asked), ("box", boxes)):
        for number in numbers:
            if not (isinstance(number, int) and 0 <= number < len(given.local)):
                raise InputError(
                    f"{what}: there is no lamp of number {number!r}; the first is 0, the last {len(given.local) - 1}"
                )
    groups: dict[Any, list[int]] = {}
    for number in sorted(asked):
        lamp = given.local[number]
        names = checked_free(number, lamp, asked[number])
        if names:
            boxed = "position" in names and boxes.get(number) is not None
            shapes = tuple((np.shape(x), np.asarray(x).dtype) for x in jax.tree.leaves(lamp))
            groups.setdefault((jax.tree.structure(lamp), shapes, names, boxed), []).append(number)
    if not groups:
        raise InputError(f"nothing of any lamp is free; name some of {', '.join(_words())}")
    kinds, placements = [], []
    for (_, _, names, boxed), numbers in groups.items():
        own, placed = [], []
        for number in numbers:
            lamp, brightness = split_brightness(centred(given.local[number], centre), names)
            own.append(lamp)
            placed.append(placement_of(lamp, brightness))
        ends = None
        if boxed:
            ends = as_array(np.stack([_ends(number, boxes[number]) - centre[None] for number in numbers]), np.float32)
        stacked = jax.tree.map(lambda *each: as_array(np.stack([np.asarray(x) for x in each])), *own)
        reach, typical = as_array(_REACH * radius, np.float32), as_array(1.0, np.float32)
        kinds.append(LampKind(stacked, ends, reach, typical, names, tuple(numbers)))
        placements.append(jax.tree.map(lambda *each: as_array(np.stack(each), np.float32), *placed))
    return tuple(kinds), tuple(placements)


def _words() -> tuple[str, ...]:
    return "intensity", "colour", "position", "aim", "cutoff", "beam", "cone"


def _ends(number: int, box: Any) -> Float[np.ndarray, "2 3"]:
    try:
        ends = np.asarray(box, float)
    except (TypeError, ValueError):
        ends = np.zeros(0)
    if ends.shape != (2, 3) or not np.isfinite(ends).all() or not (ends[0] <= ends[1]).all():
        raise InputError(f"the box of lamp {number + 1} must be [low, high] of three finite numbers each, not {box!r}")
    return ends


def _with_typical_brightness(problem: LampProblem) -> LampProblem:
    """The problem where brightness of order one is what lamps that are all alike need to reach the targets."""
    bits = traced_bits(problem.response, problem.kinds, problem.starts)
    problem = dataclasses.replace(problem, bits=bits)
    columns, wanted, left = _linear(problem)
    kinds, at = [], 0
    every = columns.sum(axis=1)
    alike = float(every @ wanted) / max(float(every @ every), 1e-30)
    for kind, start in zip(problem.kinds, problem.starts, strict=True):
        count = start.brightness.size
        own = columns[:, at : at + count].sum(axis=1)
        at += count
        scale = float(own @ left) / max(float(own @ own), 1e-30) if own.any() else 0.0
        known = float(np.asarray(start.brightness).mean())
        typical = alike if alike > 0 else scale if scale > 0 else known
        typical = typical if np.isfinite(typical) and typical > 0 else max(known, 1e-6)
        kinds.append(dataclasses.replace(kind, typical=as_array(typical, np.float32)))
    return dataclasses.replace(problem, kinds=tuple(kinds))


def _linear(problem: LampProblem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the targets that are linear, over the brightnesses of all lamps; what they are to be; and less others."""
    outputs = [np.asarray(own, float) for own in lamp_outputs(problem)]
    columns = np.concatenate([np.moveaxis(own, 1, 0).reshape(own.shape[1], -1) for own in outputs], axis=1)
    others = np.asarray(problem.others, float)
    if isinstance(problem.targets, PictureTarget):
        weight, wanted = problem.targets.linear()
        return weight[:, None] * columns, wanted - weight * others, wanted - weight * others
    rows, wanted = problem.targets.linear()
    return rows @ columns, wanted - rows @ others, wanted - rows @ others


def _with_bright_lamps(problem: LampProblem) -> LampProblem:
    """The problem at brightnesses of non-negative least squares, where those are free."""
    columns, wanted, _ = _linear(problem)
    if not len(wanted):
        return problem
    free, typical = [], []
    for kind, start in zip(problem.kinds, problem.starts, strict=True):
        is_free = "intensity" in kind.free or "colour" in kind.free
        free.append(np.full(start.brightness.size, is_free))
        typical.append(np.full(start.brightness.size, float(kind.typical)))
    is_free, scale = np.concatenate(free), np.concatenate(typical)
    if not is_free.any():
        return problem
    now = np.concatenate([np.asarray(start.brightness, float).ravel() for start in problem.starts])
    left = wanted - columns[:, ~is_free] @ now[~is_free]
    scaled = columns[:, is_free] * scale[is_free]
    together = _TOGETHER * np.linalg.norm(scaled) / math.sqrt(len(scaled.T)) * np.eye(len(scaled.T))
    # QR first: a picture has many rows.
    stacked, aims = np.concatenate([scaled, together]), np.concatenate([left, together.sum(axis=1)])
    q, r = np.linalg.qr(stacked)
    solution, _ = scipy.optimize.nnls(r, q.T @ aims)
    now[is_free] = solution * scale[is_free]
    starts, at = [], 0
    for start in problem.starts:
        shape = start.brightness.shape
        own = now[at : at + start.brightness.size].reshape(shape)
        at += start.brightness.size
        starts.append(start._replace(brightness=as_array(own, np.float32)))
    return dataclasses.replace(problem, starts=tuple(starts))


def _solve_start(problem: LampProblem, placements: tuple[Placement, ...], rounds: int, report):
    """Rounds from one start: the loss with fresh shadows, and the placements that have it."""
    problem = _with_bright_lamps(_at(problem, placements))
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
        for share in _SHARES:
            tried = tuple(old + share * longest * (new - old) for new, old in _pairs(moved, unknowns))
            there = _at(problem, found_placements(problem, tried))
            own = _unknowns(there)
            fresh = float(loss_at(there, own))
            if fresh < loss:
                break
        else:
            break
        gain, loss, problem, unknowns = 1 - fresh / loss, fresh, there, own
        best = found_placements(problem, unknowns)
        if loss < _SOLVED or gain < _LEAST_GAIN:
            break
    report(rounds, rounds)
    return loss, on_host(best)


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
    return Placement(given.brightness, position, axis, cutoff, beam)


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
