"""Entries of `fitting`: what its functions of arrays can be differentiated in, see `jaxrelight.gradients`."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import functools

import jax
import numpy as np

from fitting import chart, residuals, samples, sbrdf, small_systems
from fitting.non_negative import solve_non_negative
from fitting.solve import Options, fit_lobes
from jaxrelight.brdf.lobes import LobeSum, lobe, lobe_sum
from jaxrelight.brdf.pairs import spread_pairs
from jaxrelight.gradients.entry import CHOICE, FILES, HOST, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import numbers

_C, _EXPONENT = np.array([[-0.7, -0.7, 0.9], [-0.5, -0.5, 1.0]]), np.array([6.0, 40.0])
_OPTIONS = Options(lobes=1)


@functools.cache
def _pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    # They are kept, so they must not be made of what is being traced.
    with jax.ensure_compile_time_eval():
        omega_i, omega_o = spread_pairs(count)
        return np.asarray(omega_i), np.asarray(omega_o)


def _products(count: int) -> np.ndarray:
    omega_i, omega_o = _pairs(count)
    return (omega_i * omega_o).T


def _residual(unknowns, values):
    """Of samples of equal weight."""
    omega_i, omega_o = (side.astype(values.dtype) for side in _pairs(40))
    own, _ = chart.chart_around(*(part.astype(values.dtype) for part in (_C, _EXPONENT)), anisotropic=False)
    given = samples.Samples(
        *((omega_i * omega_o).T, values, np.full(40, 40**-0.5, values.dtype), np.ones((), values.dtype)),
        *(np.zeros((), int) for _ in range(3)),
    )
    return residuals.residual(unknowns, (own, given))


def _fitted(brdf: LobeSum):
    """The fit of a lobe to what a BRDF reflects."""
    omega_i, omega_o = (side.astype(brdf.diffuse.dtype) for side in _pairs(64))
    values = jax.vmap(brdf.evaluate)(omega_i, omega_o)
    fit = fit_lobes(omega_i, omega_o, values[None], options=_OPTIONS).brdf
    return fit.diffuse, fit.C, fit.exponent, fit.scale


def _positive() -> np.ndarray:
    square = numbers(3, 3)
    return square @ square.T + np.eye(3)


ENTRIES: Entries = (
    Entry(
        named("fitting.chart", "Chart.lobes Chart.log_exponent_slope"),
        differentiable_in="chart, unknowns",
        example=lambda: Example(
            lambda centre, tangents, unknowns: (
                chart.Chart(centre, tangents).lobes(unknowns),
                chart.Chart(centre, tangents).log_exponent_slope(unknowns),
            ),
            (_C, numbers(2, 1, 3), numbers(2, 2)),
        ),
        kinks="where two components of C are the largest in length: the mean of both slopes",
    ),
    Entry(
        named("fitting.chart", "chart_around"),
        differentiable_in="C, exponent",
        example=lambda: Example(lambda C, n: chart.chart_around(C, n, anisotropic=True), (_C, _EXPONENT)),
        ends="exponents held within the range of fits",
    ),
    Entry(
        named("fitting.residuals", "columns"),
        differentiable_in="C, exponent, products",
        example=lambda: Example(residuals.columns, (_C, _EXPONENT, _products(20))),
        kinks="as of `LobeSum.evaluate`",
    ),
    Entry(
        named("fitting.residuals", "residual factors"),
        differentiable_in="unknowns, samples",
        example=lambda: Example(_residual, (numbers(2, 2), numbers(3, 40))),
        fixed="which columns have a factor above 0",
    ),
    Entry(
        named("fitting.samples", "prepare"),
        differentiable_in="omega_i, omega_o, values, weight",
        example=lambda: Example(
            lambda omega_i, omega_o: samples.prepare(
                omega_i, omega_o, numbers(20, 3).astype(omega_i.dtype), numbers(20).astype(omega_i.dtype)
            ),
            _pairs(20),
        ),
        orders=2,
        fixed="the scale, which is a unit; which samples are masked",
        nan="samples that are not finite are masked and counted",
    ),
    Entry(
        named("fitting.small_systems", "solve_positive"),
        differentiable_in="A, b",
        example=lambda: Example(lambda A, b: small_systems.solve_positive((A + A.T) / 2, b), (_positive(), numbers(3))),
        orders=2,
        ends="positive definite matrices",
    ),
    Entry(
        named("fitting.non_negative", "solve_non_negative"),
        differentiable_in="gram, moment",
        example=lambda: Example(
            lambda gram, moment: solve_non_negative((gram + gram.T) / 2, moment),
            (_positive(), np.array([1.0, -2.0, 3.0])),
        ),
        fixed="which factors are above 0",
        ends="columns that are no multiples of each other",
        nan="it is no optimum of any columns, and all factors are 0: samples are masked before",
    ),
    Entry(
        named("fitting.solve", "fit_lobes fit_one"),
        differentiable_in="values, weight; by the equations that hold at the optimum",
        example=lambda: Example(_fitted, (lobe_sum([0.3, 0.2, 0.1], [lobe([-0.8, -0.8, 0.9], 8.0, peak=0.5)]),)),
        fixed="the start, and which samples are masked",
        ends="fits that are determined by their samples",
        nan="samples that are not finite are masked and counted",
    ),
    Entry(
        named("fitting.sbrdf", "prepared"),
        differentiable_in="images, normals, lights, views",
        example=lambda: Example(
            lambda images, normals: sbrdf.prepared(
                images,
                np.ones((2, 5), bool),
                normals,
                *(side.astype(images.dtype) for side in _pairs(5)),
            ),
            (numbers(2, 5, 3), np.array([[0.1, 0.2, 0.97], [0.0, 0.1, 0.99]])),
        ),
        fixed="which samples are seen",
        nan="samples that are not finite are masked and counted",
    ),
    Exempt(
        (
            *named("fitting.gauss_newton", "NormalEquations.as_minimum SmallLevenbergMarquardt.init"),
            *named("fitting.gauss_newton", "SmallLevenbergMarquardt.step SmallLevenbergMarquardt.terminate"),
            *named("fitting.gauss_newton", "SmallLevenbergMarquardt.postprocess by_differentiation"),
            *named("fitting.residuals", "normal_equations"),
            *named("fitting.starts", "directions best_additions"),
        ),
        "steps of a solver: what it ends at is differentiable by the equations that hold there, see `fit_lobes`",
    ),
    Exempt(
        (
            *named("fitting.albedo_error", "albedo_error"),
            *named("fitting.sbrdf", "reached"),
            *named("fitting.stack_checks", "check_lights check_stack check_fit"),
            *named("fitting.prediction", "relative_error"),
            *named("fitting.residual_by_angle", "Residual.over Residual.by Residual.by_both evaluate"),
        ),
        CHOICE,
    ),
    Exempt(
        (
            *named("fitting.report", "write_report in_plane curves spheres residuals heat_map side_by_side"),
            *named("fitting.stack_files", "load_stack"),
        ),
        FILES,
    ),
    Exempt(
        (
            *named("fitting.blend", "blended uniform painted composed"),
            *named("fitting.brdf_samples", "BrdfSamples.is_above BrdfSamples.is_finite BrdfSamples.angles"),
            *named("fitting.brdf_samples", "Grid.directions sample"),
            *named("fitting.factors", "refined"),
            *named("fitting.lafortune", "fit_lafortune"),
            *named("fitting.normals", "estimated_normals"),
            *named("fitting.prediction", "predicted lambert_only"),
            *named("fitting.sbrdf", "fit_sbrdf packed as_level"),
            *named("fitting.sbrdf_levels", "coarser refitted mean_normals"),
            *named("fitting.scene_lobes", "with_lobes"),
            *named("fitting.stack", "Stack.towards_lights Stack.of stack_of array_of directions"),
            *named("fitting.weights", "weights"),
        ),
        HOST,
    ),
)
