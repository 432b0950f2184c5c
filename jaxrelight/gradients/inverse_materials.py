"""Entries of `jaxrelight.inverse`: materials from pictures."""

import functools

import jax
import numpy as np

from jaxrelight.gradients.entry import CHOICE, HOST, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import numbers
from jaxrelight.inverse.observations import Observed

_SOLVER = (
    "a step of the solver, compiled, with visibility held fixed; its slopes are those of `with_materials`, `shade` and "
    "`Unknowns.materials`, and are checked where materials are tested"
)


@functools.cache
def _observed() -> Observed:
    pixels = np.array([0, 2, 5], np.int32)
    return Observed(*map(jax.numpy.asarray, (pixels, np.full((3, 3), 0.3, np.float32), np.ones((3, 3), np.float32))))


ENTRIES: Entries = (
    Exempt(
        named("jaxrelight.inverse.material_unknowns", "Unknowns.materials"),
        "from a solver's coordinates to materials: differentiable in them, and checked where materials are tested",
    ),
    Entry(
        named("jaxrelight.inverse.observations", "Observed.misfit"),
        differentiable_in="radiance",
        example=lambda: Example(_observed().misfit, (numbers(2, 3, 3),)),
        orders=2,
        fixed="which pixels are chosen, and what they weigh",
    ),
    Entry(
        named("jaxrelight.inverse.observations", "Observed.rendered"),
        differentiable_in="radiance",
        example=lambda: Example(_observed().rendered, (numbers(2, 3, 3),)),
        orders=2,
        fixed="which pixels are chosen",
    ),
    Exempt(
        (
            *named("jaxrelight.inverse.material_fit", "Scene.rendered Problem.misfit Problem.roughness rendered"),
            *named("jaxrelight.inverse.material_fit", "jacobian search solve_many curvature_at"),
        ),
        _SOLVER,
    ),
    Exempt(
        (
            *named("jaxrelight.inverse.material_certainty", "Estimate.width certainty_of_few certainty_of_many"),
            *named("jaxrelight.inverse.solve_materials", "materials"),
            *named("jaxrelight.inverse.material_unknowns", "Parameter.values Unknowns.start unknowns_of"),
            *named("jaxrelight.inverse.observations", "observe relative_residual"),
        ),
        HOST,
    ),
    Exempt(
        (
            *named("jaxrelight.inverse.material_certainty", "is_ambiguous"),
            *named("jaxrelight.inverse.material_unknowns", "Unknown.lobes Unknown.weight"),
        ),
        CHOICE,
    ),
)
