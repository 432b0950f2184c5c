"""Entries of `jaxrelight.inverse`: light that is solved for."""

import functools

import numpy as np

from jaxrelight.basis.haar import HaarFaces
from jaxrelight.gradients.entry import FILES, HOST, RAYS, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import numbers
from jaxrelight.inverse.light_grid import LightGrid
from jaxrelight.operators.sparse_matrix import sparse_matrix

_INVERSE = "jaxrelight.inverse"
_STEP = (
    "a step of the solver, compiled, with visibility held fixed; its slopes are of the relighter's functions, which "
    "have entries, and are checked where what is found is tested"
)


@functools.cache
def _grids() -> tuple[LightGrid, LightGrid]:
    """A lat-long map, and a cube whose pixels are mixtures of texels."""
    from scipy import sparse

    mixing = sparse.random_array((32, 24), density=0.3, rng=np.random.default_rng(0), format="csr")
    # Of single precision, as those of `light_grid`: it is kept, whatever precision is asked for first.
    return LightGrid(HaarFaces(2, 2), None, 2), LightGrid(HaarFaces(2), sparse_matrix(sparse.csr_array(mixing)), 4)


ENTRIES: Entries = (
    Entry(
        named(f"{_INVERSE}.light_grid", "LightGrid.texels"),
        differentiable_in="coefficients (linear)",
        example=lambda: Example(_grids()[0].texels, (numbers(8, 3),)),
        orders=2,
        nan="a coefficient is part of all texels of a face",
    ),
    Entry(
        named(f"{_INVERSE}.light_grid", "LightGrid.pixels"),
        differentiable_in="texels (linear)",
        example=lambda: Example(_grids()[1].pixels, (numbers(24, 3),)),
        orders=2,
        fixed="which texels are in a pixel",
        nan="a texel is part of several pixels",
    ),
    Exempt(
        (*named(f"{_INVERSE}.light_problem", "LightProblem.split applied adjoint rendered"),),
        _STEP,
    ),
    Exempt(
        (
            *named(
                f"{_INVERSE}.bidiagonalisation", "Bidiagonal.gradient Bidiagonal.matrix Bidiagonal.mixed begin step"
            ),
            *named(f"{_INVERSE}.solve_light", "InverseLight.estimate InverseLight.lights environment"),
            *named(
                f"{_INVERSE}.light_certainty",
                "LightCertainty.details LightCertainty.of_mean LightCertainty.texel_deviations "
                "LightCertainty.texel_shares certainty_of",
            ),
            *named(
                f"{_INVERSE}.light_grid",
                "LightGrid.directions LightGrid.on_grid LightGrid.solid_angles LightGrid.spectrum light_grid",
            ),
            *named(f"{_INVERSE}.light_problem", "right_side weights_of"),
            *named(f"{_INVERSE}.light_setup", "LightTask.judged LightTask.missed light_task"),
            *named(f"{_INVERSE}.light_solver", "LightSolver.back LightSolver.product LightSolver.solve"),
            *named(f"{_INVERSE}.light_regularisation", "constrained is_converged ridge_of ridge_weights spectrum_of"),
        ),
        HOST,
    ),
    Exempt((f"{_INVERSE}.light_report.write_light_report",), FILES),
    Exempt((f"{_INVERSE}.views.views_of",), RAYS),
)
