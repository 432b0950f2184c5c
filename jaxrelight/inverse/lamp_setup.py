"""From lights, targets and what is free to the problem that is solved; what does not fit is refused here."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.inverse.lamp_brightness import with_typical_brightness
from jaxrelight.inverse.lamp_problem import LampProblem
from jaxrelight.inverse.lamp_response import make_response, other_outputs
from jaxrelight.inverse.lamp_targets import LuxTargets, PictureTarget, lux_targets, picture_target
from jaxrelight.inverse.lamp_unknowns import (
    FREE,
    LampKind,
    Placement,
    centred,
    checked_free,
    placement_of,
    split_brightness,
)
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lights.lights import Lights
from jaxrelight.numerics.arrays import as_array, is_traced

# What is free of lamps: the same of all, or of some by their number from 0.
Free = Sequence[str] | Mapping[int, Sequence[str]]
# Two ends of a box in the world, for all lamps or by their number.
Ends = Sequence[Sequence[float]] | Float[np.ndarray, "2 3"]
Box = Ends | Mapping[int, Ends]

# An unknown of order one moves a lamp by this share of the scene's half size.
_REACH = 0.25


def make_problem(
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
    surfaces = _surfaces_of(relighter)
    centre, radius = np.asarray(surfaces.centre, float), float(surfaces.radius)
    response = make_response(relighter, view)
    kinds, placements = _kinds(given, free, box, centre, radius)
    of_kinds = {number for kind in kinds for number in kind.numbers}
    fixed = tuple(light for number, light in enumerate(given.local) if number not in of_kinds)
    others = other_outputs(relighter, view, Lights(given.environment, fixed), response.is_of_sensors)
    problem = LampProblem(response, kinds, placements, (), others, goal)
    return with_typical_brightness(problem), placements, centre


def _surfaces_of(relighter: Any) -> Any:
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
        raise InputError(f"nothing of any lamp is free; name some of {', '.join(FREE)}")
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


def _ends(number: int, box: Any) -> Float[np.ndarray, "2 3"]:
    try:
        ends = np.asarray(box, float)
    except (TypeError, ValueError):
        ends = np.zeros(0)
    if ends.shape != (2, 3) or not np.isfinite(ends).all() or not (ends[0] <= ends[1]).all():
        raise InputError(f"the box of lamp {number + 1} must be [low, high] of three finite numbers each, not {box!r}")
    return ends
