"""Entries of `jaxrelight.brdf`: BRDFs, their lobes and their factors."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false, reportCallIssue=false

import functools

import jax
import numpy as np

from jaxrelight.brdf import bandwidth, bilinear_warp, horizon, lobes, parametrisation, sub_lobes, tabulated
from jaxrelight.brdf.adaptive import Adaptive
from jaxrelight.brdf.alternating import refactored
from jaxrelight.brdf.ashikhmin_shirley import AshikhminShirley, ashikhmin_shirley
from jaxrelight.brdf.factored import Factored, Symmetric
from jaxrelight.brdf.parametrisation import DISC, POLAR
from jaxrelight.brdf.reflection import FixedView
from jaxrelight.brdf.separable import separable
from jaxrelight.gradients.entry import Entries, Entry, Example, named
from jaxrelight.gradients.examples import (
    ALONG_X,
    NORMAL,
    OMEGA_I,
    OMEGA_O,
    at_point,
    numbers,
    scalar,
    two_lobes,
)

_MIRROR = OMEGA_O * np.array([-1, -1, 1])
_ACROSS = np.array([0.6, 0.2, -0.1])
_HORIZON = np.array([0.6, 0.8, 0.0])


def _evaluate(brdf, omega_i, omega_o):
    return brdf.evaluate(omega_i, omega_o)


@functools.cache
def _factored() -> Factored:
    return Factored(*(numbers(2, 3, side, side).astype(np.float32) for side in (4, 4)))


def _factored_as(brdf) -> Factored:
    """Factors of the type of a BRDF."""
    return jax.tree.map(lambda maps: maps.astype(brdf.diffuse.dtype), _factored())


@functools.cache
def _adaptive() -> Adaptive:
    """Of three elevations of an isotropic surface."""
    phi, theta = np.array([-np.pi]), np.array([0.0, 0.7, 1.5])
    warp = bilinear_warp.sums(numbers(3, 4, 5))
    arrays = phi, theta, numbers(3, 6), numbers(3, 5), *warp, numbers(3, 3, 5, 5)
    return Adaptive(*(np.asarray(one, np.float32) for one in arrays))


def _shiny() -> AshikhminShirley:
    return ashikhmin_shirley(0.3, [0.2, 0.1, 0.3], 10.0, 25.0)


def _texel(number: int) -> np.ndarray:
    """The direction of a texel's centre on the disc of four texels a side."""
    return DISC.directions(4)[0][number]


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.brdf.lobes", "LobeSum.evaluate"),
        differentiable_in="brdf, omega_i, omega_o",
        example=lambda: Example(_evaluate, (two_lobes(), OMEGA_I, OMEGA_O)),
        orders=2,
        kinks="0 where a lobe's cosine is 0 or less; its exponent has no slope there",
        ends="exponents from 0; C as `lobe` makes it, max|C| = 1",
        singular=lambda: (
            at_point("at the peak", (lobes.phong(0.1, 0.5, 20.0), _MIRROR, OMEGA_O), 1, _ACROSS),
            at_point("exponent 0", (lobes.phong(0.1, 0.5, 0.0), OMEGA_I, OMEGA_O), 1, _ACROSS),
            at_point("lobes and eye apart by 90°", (lobes.phong(0.1, 0.5, 3.0), ALONG_X, NORMAL), 1, _ACROSS),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.lobes", "LobeSum.cosines"),
        differentiable_in="brdf, omega_i, omega_o",
        example=lambda: Example(lambda brdf, i, o: brdf.cosines(i, o), (two_lobes(), OMEGA_I, OMEGA_O)),
        orders=2,
    ),
    Entry(
        named("jaxrelight.brdf.lobes", "LobeSum.integral"),
        differentiable_in="brdf, omega_i, omega_o, weights; linear in the weights",
        example=lambda: Example(
            lambda brdf, i, o, weights: brdf.integral(i, o, weights),
            (two_lobes(), np.stack([OMEGA_I, NORMAL, _ACROSS + NORMAL], axis=1), OMEGA_O, numbers(3, 3)),
        ),
        kinks="as of `LobeSum.evaluate`",
    ),
    Entry(
        named("jaxrelight.brdf.lobes", "LobeSum.peak"),
        differentiable_in="brdf, omega_o",
        example=lambda: Example(lambda brdf, o: brdf.peak(o), (two_lobes(), OMEGA_O)),
        orders=2,
        kinks="0 where Cᵀω_o is the zero vector",
        singular=lambda: (at_point("the normal", (two_lobes(), NORMAL), 1, ALONG_X),),
    ),
    Entry(
        named("jaxrelight.brdf.lobes", "LobeSum.normal_albedo"),
        differentiable_in="brdf",
        example=lambda: Example(lambda brdf: brdf.normal_albedo, (two_lobes(),)),
        orders=2,
        nan="the albedo of a lobe along the normal depends on C_z alone",
    ),
    Entry(
        named("jaxrelight.brdf.lobes", "turned"),
        differentiable_in="vectors, angle",
        example=lambda: Example(lobes.turned, (OMEGA_I, scalar(0.4))),
        orders=2,
    ),
    Entry(
        named("jaxrelight.brdf.lobes", "lambert"),
        differentiable_in="albedo; linear",
        example=lambda: Example(lobes.lambert, (np.array([0.3, 0.2, 0.1]),)),
        orders=2,
        dtypes="of the arrays given; numbers of Python take JAX's own",
    ),
    Entry(
        named("jaxrelight.brdf.lobes", "phong"),
        differentiable_in="diffuse, specular, exponent",
        example=lambda: Example(lobes.phong, (np.array([0.3, 0.2, 0.1]), scalar(0.4), scalar(9.0))),
        orders=2,
        ends="exponent ≥ 0",
        dtypes="as of `lambert`",
    ),
    Entry(
        named("jaxrelight.brdf.lobes", "lobe lobe_sum"),
        differentiable_in="C, exponent, specular or peak; diffuse, turn",
        example=lambda: Example(
            lambda C, n, specular, diffuse, turn: lobes.lobe_sum(
                diffuse, [lobes.lobe(C, n, specular=specular)], turn=turn
            ),
            (np.array([-0.9, -0.8, 0.7]), scalar(5.0), scalar(0.3), np.array([0.3, 0.2, 0.1]), scalar(0.2)),
        ),
        kinks="where two components of C are the largest in length: the mean of both slopes",
        ends="exponent ≥ 0, max|C|ⁿ · specular finite",
        dtypes="as of `lambert`",
    ),
    Entry(
        named("jaxrelight.brdf.ashikhmin_shirley", "AshikhminShirley.evaluate"),
        differentiable_in="brdf, omega_i, omega_o",
        example=lambda: Example(_evaluate, (_shiny(), OMEGA_I, _ACROSS + NORMAL)),
        orders=2,
        kinks="where both directions are as high, the mean of both slopes; at the horizon the slope above it",
        ends="cosines of at least 1e-3; nu, nv ≥ 0",
        singular=lambda: (
            at_point("half vector along the normal", (_shiny(), _MIRROR, OMEGA_O), 1, np.array([0.3, 0.1, 0.0])),
            at_point("exponents 0", (ashikhmin_shirley(0.3, 0.2, 0.0, 0.0), OMEGA_I, NORMAL), 1, _ACROSS),
            at_point("light at the horizon", (_shiny(), _HORIZON, NORMAL), 1, NORMAL, "ahead"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.ashikhmin_shirley", "ashikhmin_shirley"),
        differentiable_in="kd, ks, nu, nv",
        example=lambda: Example(ashikhmin_shirley, (numbers(3), numbers(3), scalar(10.0), scalar(25.0))),
        orders=2,
        ends="reflectances within 0 … 1, exponents ≥ 0",
        dtypes="as of `lambert`",
    ),
    Entry(
        named("jaxrelight.brdf.tabulated", "half_difference"),
        differentiable_in="omega_i, omega_o",
        example=lambda: Example(tabulated.half_difference, (OMEGA_I, OMEGA_O)),
        orders=2,
        kinks="0 where an angle is undefined",
        singular=lambda: (
            at_point("equal directions", (OMEGA_I, OMEGA_I), 0, _ACROSS, "finite"),
            at_point("half vector along the normal", (_MIRROR, OMEGA_O), 0, _ACROSS, "finite"),
            at_point("opposite directions", (ALONG_X, -ALONG_X), 0, _ACROSS, "finite"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.tabulated", "Tabulated.evaluate"),
        differentiable_in="brdf, omega_i, omega_o",
        example=lambda: Example(
            lambda values, i, o: tabulated.Tabulated(values).evaluate(i, o),
            (numbers(4, 4, 4, 3), OMEGA_I, _ACROSS + NORMAL),
        ),
        kinks="between entries the slope of those ahead",
        ends="constant beyond the first and last entries of θ_h and θ_d",
        singular=lambda: (at_point("equal directions", (numbers(4, 4, 4, 3), OMEGA_I, OMEGA_I), 1, _ACROSS, "finite"),),
    ),
    Entry(
        named("jaxrelight.brdf.tabulated", "corners"),
        differentiable_in="angles (the weights; the entries are numbers)",
        example=lambda: Example(
            lambda h, d, p: tabulated.corners(tabulated.HalfDifference(h, d, p), (4, 4, 4)),
            (scalar(0.5), scalar(0.7), scalar(1.1)),
        ),
        kinks="as of `Tabulated.evaluate`",
    ),
    Entry(
        named("jaxrelight.brdf.adaptive", "Adaptive.evaluate"),
        differentiable_in="brdf, omega_i, omega_o",
        example=lambda: Example(_evaluate, (_adaptive(), OMEGA_I, _ACROSS + NORMAL)),
        fixed="the elevations and azimuths of the file, between which directions lie",
        kinks="between points of the file's grids the slope of those ahead",
        ends="cosθ_i of at least 1e-4",
        singular=lambda: (at_point("eye along the normal", (_adaptive(), OMEGA_I, NORMAL), 1, _ACROSS, "smooth"),),
    ),
    Entry(
        named("jaxrelight.brdf.bilinear_warp", "cell"),
        differentiable_in="place (the place in the cell; the cell is a number)",
        example=lambda: Example(lambda place: bilinear_warp.cell(place, 5), (scalar(0.3),)),
        kinks="between cells the slope of the cell ahead; at the ends that inside",
        singular=lambda: (
            at_point("the first point", (scalar(0),), 0, scalar(1), "ahead"),
            at_point("the last point", (scalar(1),), 0, scalar(1), "behind"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.bilinear_warp", "bracket"),
        differentiable_in="value, grid (the weights; the entries are numbers)",
        example=lambda: Example(bilinear_warp.bracket, (scalar(0.3), np.array([0.0, 0.5, 2.0]))),
        kinks="as of `cell`",
        singular=lambda: (
            at_point("an entry", (scalar(0.5), np.array([0.0, 0.5, 2.0])), 0, scalar(1), "finite"),
            at_point("the last entry", (scalar(2.0), np.array([0.0, 0.5, 2.0])), 0, scalar(1), "behind"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.bilinear_warp", "look_up"),
        differentiable_in="values, x, y, weights",
        example=lambda: Example(
            lambda values, x, y, weights: bilinear_warp.look_up(values, x, y, np.array([0, 2]), weights),
            (numbers(3, 2, 4, 5), scalar(0.3), scalar(0.6), numbers(2)),
        ),
        fixed="the slices",
        kinks="as of `cell`",
        singular=lambda: (
            at_point("a point", (numbers(3, 2, 4, 5), scalar(0.25), scalar(0.6), numbers(2)), 1, scalar(1), "ahead"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.bilinear_warp", "invert"),
        differentiable_in="density, along, down, x, y, weights",
        example=lambda: Example(
            lambda warp, x, y, weights: bilinear_warp.invert(*warp, x, y, np.array([0, 2]), weights),
            (bilinear_warp.sums(numbers(3, 4, 5)), scalar(0.3), scalar(0.6), numbers(2)),
        ),
        fixed="the slices",
        kinks="as of `cell`",
    ),
    Entry(
        named("jaxrelight.brdf.parametrisation", "Disc.place Polar.place Parametrisation.corners"),
        differentiable_in="omega (the weights; the texels are numbers)",
        example=lambda: Example(lambda omega: (DISC.corners(omega, 4), POLAR.corners(omega, 4)), (OMEGA_I,)),
        kinks="between texels the slope of those ahead; polar: none at the pole",
        ends="no slope in the half texel beyond the outermost centres",
        singular=lambda: (
            at_point("a texel's centre", (_texel(5),), 0, np.array([1.0, 0.7, 0.0]), "finite"),
            at_point("the normal", (NORMAL,), 0, ALONG_X, "finite"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.parametrisation", "look_up"),
        differentiable_in="maps, omega",
        example=lambda: Example(
            lambda maps, omega: [parametrisation.look_up(one, maps, omega) for one in (DISC, POLAR)],
            (numbers(2, 3, 4, 4), OMEGA_I),
        ),
        kinks="as of `Disc.place`",
    ),
    Entry(
        named("jaxrelight.brdf.factored", "Factored.light_side Factored.view_side"),
        differentiable_in="maps, omega",
        example=lambda: Example(lambda of, i, o: (of.light_side(i), of.view_side(o)), (_factored(), OMEGA_I, OMEGA_O)),
        kinks="as of `Disc.place`",
        singular=lambda: (
            at_point("a texel's centre", (_factored(), _texel(5), OMEGA_O), 1, np.array([1.0, 0.7, 0.0]), "ahead"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.factored", "Symmetric.light_side Symmetric.view_side Symmetric.as_factored"),
        differentiable_in="maps, signs, omega",
        example=lambda: Example(
            lambda maps, signs, o: (Symmetric(maps, signs).view_side(o), Symmetric(maps, signs).as_factored()),
            (numbers(2, 3, 4, 4), numbers(2, 3), OMEGA_O),
        ),
        kinks="as of `Disc.place`",
    ),
    Entry(
        named("jaxrelight.brdf.separable", "Separable.evaluate separable Separable.factors"),
        differentiable_in="brdf, omega_i, omega_o",
        example=lambda: Example(
            lambda factors, i, o: separable(factors).evaluate(i, o), (_factored(), OMEGA_I, OMEGA_O)
        ),
        kinks="as of `Disc.place`",
    ),
    Entry(
        named("jaxrelight.brdf.reflection", "FixedView.light_side FixedView.light_terms Reflection.light_terms"),
        differentiable_in="brdf, omega_i, omega_o",
        example=lambda: Example(
            lambda brdf, o, i: (
                FixedView(brdf, o).light_side(i),
                FixedView(brdf, o).light_terms(i[:, None], i[None, :, None]),
            ),
            (two_lobes(), OMEGA_O, OMEGA_I),
        ),
        orders=2,
        ends="0, and no slope, where the eye is at the horizon or below",
    ),
    Entry(
        named("jaxrelight.brdf.alternating", "refactored"),
        differentiable_in="brdf",
        example=lambda: Example(
            lambda brdf: refactored(brdf, _factored_as(brdf), (0, 0)), (lobes.phong([0.2, 0.1, 0.3], 0.5, 4.0),)
        ),
        fixed="the factors that it starts from",
        kinks="a black channel has black maps, with no slope",
    ),
    Entry(
        named("jaxrelight.brdf.horizon", "clip_lobe"),
        differentiable_in="peak, exponent",
        example=lambda: Example(horizon.clip_lobe, (OMEGA_I, scalar(6.3))),
        kinks="between entries of its table the slope of those ahead; at exponent 0 and at ±N that inside",
        ends="exponents held within 0 … 2¹⁴ − 1",
        singular=lambda: (
            at_point("exponent 0", (OMEGA_I, scalar(0)), 1, scalar(1), "ahead"),
            at_point("peak along the normal", (NORMAL, scalar(6.3)), 0, -NORMAL, "ahead"),
            at_point("peak below", (-NORMAL, scalar(6.3)), 0, NORMAL, "ahead"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.sub_lobes", "sub_lobes"),
        differentiable_in="peak, exponent",
        example=lambda: Example(lambda p, n: sub_lobes.sub_lobes(p, n, 7), (OMEGA_I, scalar(6.3))),
        kinks="between entries of its table the slope of those ahead",
        ends="exponents from 0; peaks other than −z",
        singular=lambda: (at_point("exponent 0", (OMEGA_I, scalar(0)), 1, scalar(1), "ahead"),),
    ),
    Entry(
        named("jaxrelight.brdf.bandwidth", "lobe_bandwidth"),
        differentiable_in="brdf, omega_i, omega_o",
        example=lambda: Example(bandwidth.lobe_bandwidth, (two_lobes(), OMEGA_I, OMEGA_O)),
        orders=2,
        kinks="no slope by an exponent of 0, where it is infinite",
        singular=lambda: (
            at_point(
                "exponent 0", (lobes.phong(0.1, 0.5, 0.0), OMEGA_I, OMEGA_O), 0, lobes.phong(0.0, 0.0, 1.0), "finite"
            ),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.bandwidth", "with_cosine"),
        differentiable_in="bandwidth",
        example=lambda: Example(bandwidth.with_cosine, (numbers(3),)),
        orders=2,
    ),
    Entry(
        named("jaxrelight.brdf.bandwidth", "to_square"),
        differentiable_in="omega",
        example=lambda: Example(bandwidth.to_square, (OMEGA_I,)),
        orders=2,
        kinks="at components of 0 the slope towards positive ones",
    ),
)
