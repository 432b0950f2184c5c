"""Entries of `jaxrelight.inverse`: materials from pictures, and the sums over directions that lead to them."""

import functools

import jax
import numpy as np

from jaxrelight.brdf.reflection import FixedView
from jaxrelight.gradients.entry import CHOICE, CONTRACT, FILES, HOST, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import OMEGA_O, numbers, two_lobes
from jaxrelight.inverse.observations import Observed
from jaxrelight.transport.bake import directions_for

_SOLVER = (
    "a step of the solver, compiled, with visibility held fixed; its slopes are those of `with_materials`, `shade` and "
    "`Unknowns.materials`, and are checked where materials are tested"
)


@functools.cache
def _directions() -> np.ndarray:
    """Unit vectors above the surface."""
    vectors = np.abs(numbers(3, 12)) + 0.1
    return vectors / np.linalg.norm(vectors, axis=0)


def _integral(brdf, omega_i, omega_o, weights):
    return brdf.integral(omega_i, omega_o, weights)


def _light_terms(view, omega_i, weights):
    return view.light_terms(omega_i, weights)


@functools.cache
def _observed() -> Observed:
    pixels = np.array([0, 2, 5], np.int32)
    return Observed(*map(jax.numpy.asarray, (pixels, np.full((3, 3), 0.3, np.float32), np.ones((3, 3), np.float32))))


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.brdf.lobes", "LobeSum.integral"),
        differentiable_in="the BRDF, omega_i, omega_o, weights",
        example=lambda: Example(_integral, (two_lobes(), _directions(), OMEGA_O, np.abs(numbers(3, 12)))),
        kinks="as `LobeSum.evaluate`",
    ),
    Entry(
        named("jaxrelight.brdf.reflection", "FixedView.light_terms"),
        differentiable_in="the BRDF, omega_i, omega_o, weights",
        example=lambda: Example(
            _light_terms, (FixedView(two_lobes(), OMEGA_O), _directions(), np.abs(numbers(1, 3, 12)))
        ),
        kinks="0 where the eye is below the surface",
        nan="an eye that is no number is below the surface",
    ),
    Exempt(named("jaxrelight.brdf.contract", "Brdf.integral"), "the sum of `evaluate`, whose entry is of each BRDF"),
    Exempt(named("jaxrelight.brdf.reflection", "Reflection.light_terms"), CONTRACT),
    Entry(
        named("jaxrelight.transport.bake", "Directions.to_rays"),
        differentiable_in="texels",
        example=lambda: Example(directions_for(2, 2).to_rays, (numbers(24),)),
        orders=2,
    ),
    Exempt(
        named("jaxrelight.numerics.few_parameters", "of_few_parameters"),
        "a wrapper, whose derivatives are those of the function that it is given",
    ),
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
            *named("jaxrelight.inverse.materials", "materials"),
            *named("jaxrelight.inverse.material_unknowns", "Parameter.values Unknowns.start unknowns_of"),
            *named("jaxrelight.inverse.observations", "observe relative_residual"),
            *named("jaxrelight.commands.inverse_materials", "told lines_of"),
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
    Exempt(named("jaxrelight.commands.inverse_materials", "write_materials write_report"), FILES),
)
