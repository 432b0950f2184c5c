"""Entries of `jaxrelight.inverse`: lamps that meet targets."""

import functools
from typing import Any

import jax
import numpy as np

from jaxrelight.geometry.sensors import Sensor, Sensors
from jaxrelight.gradients.entry import CHOICE, FILES, HOST, RAYS, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import numbers, scalar
from jaxrelight.inverse import lamp_targets, lamp_unknowns
from jaxrelight.inverse.lamp_targets import LuxTarget, LuxTargets, PictureTarget
from jaxrelight.inverse.lamp_unknowns import LampKind, Placement
from jaxrelight.lights.local import spot

_SOLVER = (
    "a step of the solver, compiled, with shadows held fixed; its slopes are of the functions that have entries, and "
    "are checked where lamps are tested"
)
_UNKNOWNS = np.array([0.3, -0.2, 0.1, 0.4, 0.2, -0.3, 0.5, -0.4])


@functools.cache
def _kind() -> LampKind:
    """A spot of which all is free but its colour, in a box."""
    lamp = jax.tree.map(lambda leaf: np.asarray(leaf)[None], spot([0.3, 1.0, 0.2], [0.1, 0.0, 0.4], 1.0, 40.0, 20.0))
    box: Any = np.array([[[-1.0, 0.5, -1.0], [1.0, 1.5, 1.0]]])
    reach: Any = scalar(0.5)
    return LampKind(lamp, box, reach, reach, ("intensity", "position", "aim", "cutoff", "beam"), (0,))


def _placement() -> Placement:
    """Where the spot stands."""
    values: Any = np.ones(1), np.array([0.3, 1.0, 0.2]), np.array([-0.19, -0.962, 0.19]), scalar(40.0), scalar(0.5)
    return Placement(*values)


def _placed_example() -> Example:
    kind, start = _kind(), _placement()
    box = None if kind.box is None else kind.box[0]
    return Example(lambda unknowns: lamp_unknowns.placed(kind, box, start, unknowns), (_UNKNOWNS,))


def _lamp_example() -> Example:
    kind = _kind()
    lamp = jax.tree.map(lambda leaf: np.asarray(leaf)[0], kind.lamps)
    return Example(lambda lamp, placed: lamp_unknowns.lamp_at(lamp, kind.free, placed), (lamp, _placement()))


@functools.cache
def _lux() -> LuxTargets:
    """A mean, bounds that are crossed, and values."""
    sensors = Sensors((Sensor("a", [[0, 0, 0], [1, 0, 0]]), Sensor("b", [[0, 0, 0]]), Sensor("c", [[0, 0, 0]])))
    asked = {"a": LuxTarget(mean=1.2, uniformity=0.9), "b": LuxTarget(min=2.0), "c": LuxTarget(values=[0.4])}
    return lamp_targets.lux_targets(asked, sensors)


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.inverse.lamp_unknowns", "placed"),
        differentiable_in="unknowns",
        example=_placed_example,
        fixed="the placement about which unknowns count, and the ends of ranges",
        dtypes="at least that of the kind",
    ),
    Entry(
        named("jaxrelight.inverse.lamp_unknowns", "lamp_at shown_unknowns"),
        differentiable_in="lamp, placement",
        example=_lamp_example,
        fixed="what is not free",
        nan="a lamp keeps nothing of what is free",
    ),
    Entry(
        named("jaxrelight.inverse.lamp_targets", "LuxTargets.residual"),
        differentiable_in="lux",
        example=lambda: Example(_lux().residual, (numbers(4),)),
        kinks="a bound that is just met has no slope",
        dtypes="at least that of the targets",
    ),
    Entry(
        named("jaxrelight.inverse.lamp_targets", "PictureTarget.residual"),
        differentiable_in="radiance",
        example=lambda: Example(
            lambda radiance: PictureTarget(*list(numbers(2, 6).astype(np.float32))).residual(radiance),  # pyright: ignore[reportArgumentType]
            (numbers(6),),
        ),
        dtypes="at least that of the targets",
    ),
    Exempt(
        named(
            "jaxrelight.inverse.lamp_problem",
            "lights_of all_lights_of outputs_of outputs_and_slopes found_placements solved linearised loss_at "
            "lamp_outputs sensitivities",
        ),
        _SOLVER,
    ),
    Exempt(
        named("jaxrelight.inverse.lamp_response", "LampResponse.outputs other_outputs passed_on rows_of_sensors"),
        _SOLVER,
    ),
    Exempt(named("jaxrelight.inverse.lamp_unknowns", "unknowns_of across_axis"), _SOLVER),
    Exempt(
        (
            *named("jaxrelight.inverse.lamp_problem", "traced_bits"),
            *named("jaxrelight.inverse.lamp_response", "LampResponse.trace make_response"),
            *named("jaxrelight.inverse.lamp_setup", "make_problem"),
            *named("jaxrelight.inverse.solve_lamps", "lamps"),
        ),
        RAYS,
    ),
    Exempt(
        (
            *named("jaxrelight.inverse.lamp_problem", "on_host"),
            *named("jaxrelight.inverse.lamp_certainty", "certainty"),
            *named("jaxrelight.inverse.lamp_brightness", "with_typical_brightness with_bright_lamps linear_targets"),
            *named(
                "jaxrelight.inverse.lamp_targets", "LuxTargets.linear PictureTarget.linear lux_targets picture_target"
            ),
            *named("jaxrelight.inverse.lamp_targets", "fits_of"),
            *named("jaxrelight.inverse.lamp_unknowns", "centred brightened split_brightness placement_of"),
        ),
        HOST,
    ),
    Exempt(named("jaxrelight.inverse.lamp_unknowns", "LampKind.fields checked_free"), CHOICE),
    Exempt(named("jaxrelight.inverse.lamp_files", "read_lamp_task"), FILES),
)
