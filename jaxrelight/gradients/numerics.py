"""Entries of `jaxrelight.numerics`."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import numpy as np

from jaxrelight.gradients.entry import Entries, Entry, Example, Exempt, Singular, named
from jaxrelight.gradients.examples import at_point, scalar
from jaxrelight.numerics import arrays, few_parameters, safe

_A, _B = np.array([0.3, -2.0, 0.7]), np.array([1.0, 0.2, 0.1])
_ZERO, _UP = np.zeros(3), np.array([0.0, 0.0, 1.0])

ENTRIES: Entries = (
    Entry(
        named("jaxrelight.numerics.safe", "power"),
        differentiable_in="base, exponent",
        example=lambda: Example(safe.power, (np.array([0.3, 0.9, 1.2]), np.array([0.5, 20.0, 3.0]))),
        orders=2,
        kinks="0 at and below base 0, for every exponent; 0 beyond exp(80), where the power is held",
        ends="base > 0; for exponents from 0 to 1 the slope grows without bound towards base 0",
        singular=lambda: (
            Singular("base 0", (np.zeros(()), np.full((), 3.0)), (np.ones(()), np.ones(()))),
            Singular("base 0, exponent 0", (np.zeros(()), np.zeros(())), (np.ones(()), np.ones(())), "zero"),
            Singular("base below 0", (np.full((), -0.5), np.full((), 0.5)), (np.ones(()), np.ones(()))),
        ),
    ),
    Entry(
        named("jaxrelight.numerics.safe", "clamp"),
        differentiable_in="values, least, most",
        example=lambda: Example(safe.clamp, (np.array([-0.3, 0.2, 3.0]), np.zeros(()), np.ones(()))),
        kinks="at both ends the slope inside",
        singular=lambda: (
            at_point("the lower end", (scalar(0), scalar(0), scalar(1)), 0, scalar(1), "ahead"),
            at_point("the upper end", (scalar(1), scalar(0), scalar(1)), 0, scalar(1), "behind"),
        ),
    ),
    Entry(
        named("jaxrelight.numerics.safe", "root"),
        differentiable_in="values",
        example=lambda: Example(safe.root, (np.array([0.3, 2.0, -1.0]),)),
        orders=2,
        kinks="0 at 0, where the slope is infinite, and below",
        singular=lambda: (Singular("0", (np.zeros(()),), (np.ones(()),), "zero"),),
    ),
    Entry(
        named("jaxrelight.numerics.safe", "norm"),
        differentiable_in="vector",
        example=lambda: Example(safe.norm, (_A,)),
        kinks="0 at the zero vector",
        orders=2,
        singular=lambda: (Singular("the zero vector", (_ZERO,), (_A,), "zero"),),
    ),
    Entry(
        named("jaxrelight.numerics.safe", "normalize"),
        differentiable_in="vector",
        example=lambda: Example(safe.normalize, (_A,)),
        orders=2,
        kinks="0 at the zero vector",
        singular=lambda: (Singular("the zero vector", (_ZERO,), (_A,), "zero"),),
    ),
    Entry(
        named("jaxrelight.numerics.safe", "angle"),
        differentiable_in="a, b",
        example=lambda: Example(safe.angle, (_A, _B)),
        orders=2,
        kinks="0 where the vectors are parallel or one is zero",
        singular=lambda: (
            Singular("equal vectors", (_UP, _UP), (_A, _ZERO), "zero"),
            Singular("opposite vectors", (_UP, -_UP), (_A, _ZERO), "zero"),
            Singular("the zero vector", (_ZERO, _UP), (_A, _ZERO), "zero"),
        ),
    ),
    Entry(
        named("jaxrelight.numerics.arrays", "as_array"),
        differentiable_in="values",
        example=lambda: Example(arrays.as_array, (_A,)),
        orders=2,
        dtypes="that asked for, else that of the values, at most as JAX is set",
    ),
    Entry(
        named("jaxrelight.numerics.few_parameters", "of_few_parameters"),
        differentiable_in="parameters and others, as the function is",
        example=lambda: Example(
            few_parameters.of_few_parameters(lambda exponent, vector: safe.power(vector, exponent)),
            (scalar(2.5), np.array([0.3, 2.0, 0.7])),
        ),
        orders=2,
        kinks="as of the function",
    ),
    Exempt(named("jaxrelight.numerics.arrays", "on_host"), "known numbers move to the host"),
    Exempt(
        named("jaxrelight.numerics.numbers", "as_numbers"),
        "known numbers become float64 on the host, to be checked there; traced ones pass through",
    ),
    Exempt(
        named("jaxrelight.numerics.random_numbers", "vogel_points random_rotation"),
        "from whole numbers, always float32: sample positions are held fixed",
    ),
    Exempt(named("jaxrelight.numerics.buckets", "filled_up"), "NumPy: layout of arrays"),
    Exempt(named("jaxrelight.numerics.unique_rows", "unique_rows"), "NumPy: indices"),
)
