"""What every entry's example is held to, with one compiled program for a single item and one for a batch."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight.gradients.entry import Entry, Singular
from tests.operators.derivatives import check_derivatives, derivatives

# Step of one-sided differences, in float64.
_STEP = 1e-6
# Of the items of a batch, on the example's arguments.
_FACTORS = 1.0, 1.0 - 2e-3, 1.0 + 3e-3


def is_floating(leaf: Any) -> bool:
    """Whether a leaf of a pytree is an array of floats, which alone are differentiated."""
    return isinstance(leaf, jax.Array | np.ndarray) and bool(jnp.issubdtype(leaf.dtype, jnp.floating))


def of_type(tree: Any, dtype: type) -> Any:
    """A pytree with all its arrays of NumPy, those of floats of one type."""

    def converted(leaf):
        if is_floating(leaf):
            return np.asarray(leaf, dtype)
        return np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf

    return jax.tree.map(converted, tree)


class Law:
    """An example as a function of the floating arrays of its arguments alone, which gives floating arrays alone."""

    def __init__(self, entry: Entry, dtype: type = np.float64):
        self.entry, self.dtype = entry, dtype
        self.example = entry.example()
        self.primals, self.rest = eqx.partition(of_type(self.example.arguments, dtype), is_floating)
        self.program = derivatives(self.function)

    def function(self, *primals: Any) -> Any:
        """The example's, of the floating arrays among its arguments."""
        result = self.example.function(*eqx.combine(primals, self.rest))
        return [leaf for leaf in jax.tree.leaves(result) if jnp.issubdtype(leaf.dtype, jnp.floating)]

    @functools.cached_property
    def results(self) -> Any:
        """Shapes and types of the results."""
        return jax.eval_shape(self.function, *self.primals)

    def filled(self, number: float) -> list[np.ndarray]:
        """Arrays like the results, filled with a number."""
        return [np.full(one.shape, number, one.dtype) for one in self.results]

    def ordered_cotangent(self) -> list[np.ndarray]:
        """Some cotangent, always the same, that weighs all results differently."""
        return [np.cos(1 + np.arange(one.size, dtype=one.dtype)).reshape(one.shape) for one in self.results]

    def check_gradients(self) -> None:
        """Both modes against central differences, and against each other."""
        if self.example.along is None:
            check_derivatives(self.function, self.primals)
            return
        along, _ = eqx.partition(of_type(self.example.along, self.dtype), is_floating)
        cotangent = self.ordered_cotangent()
        slopes = self.program(self.primals, along, cotangent)[1]
        ahead, behind = (
            self.program(jax.tree.map(lambda a, t, s=s: a + s * _STEP * t, self.primals, along), along, cotangent)[0]
            for s in (1, -1)
        )
        for slope, a, b in zip(slopes, ahead, behind, strict=True):
            true = (np.asarray(a) - np.asarray(b)) / (2 * _STEP)
            np.testing.assert_allclose(slope, true, rtol=1e-5, atol=1e-6 * float(np.abs(true).max(initial=1)))
        some = jax.tree.map(lambda leaf: np.sin(1 + np.arange(leaf.size)).reshape(leaf.shape), self.primals)
        _, pushed, pulled = self.program(self.primals, some, cotangent)
        np.testing.assert_allclose(_product(pulled, some), _product(pushed, cotangent), rtol=1e-9)

    def check_second_order(self) -> None:
        """Both modes of the gradient."""
        cotangent = self.ordered_cotangent()

        def gradient(*primals):
            return jax.vjp(self.function, *primals)[1](cotangent)

        check_derivatives(gradient, self.primals)

    def check_singular(self, point: Singular) -> None:
        """Both modes at a singular point, along a direction."""
        primals, rest = eqx.partition(of_type(point.arguments, self.dtype), is_floating)
        tangents, _ = eqx.partition(of_type(point.along, self.dtype), is_floating)

        def function(*primals):
            result = self.example.function(*eqx.combine(primals, rest))
            return [leaf for leaf in jax.tree.leaves(result) if jnp.issubdtype(leaf.dtype, jnp.floating)]

        program = derivatives(function)
        shapes = jax.eval_shape(function, *primals)
        cotangent = [np.cos(1 + np.arange(one.size, dtype=one.dtype)).reshape(one.shape) for one in shapes]
        value, along, gradients = program(primals, tangents, cotangent)
        for leaf in jax.tree.leaves((value, along, gradients)):
            assert np.isfinite(leaf).all(), point.where
        forward = _product(along, cotangent)
        reverse = _product(gradients, tangents)
        np.testing.assert_allclose(reverse, forward, rtol=1e-8, atol=1e-10, err_msg=point.where)
        if point.slope == "finite":
            return
        if point.slope == "zero":
            wanted = {"zero": [np.zeros(one.shape) for one in shapes]}
        else:
            steps = {"ahead": (1,), "behind": (-1,), "smooth": (1, -1)}[point.slope]
            wanted = {}
            for sign in steps:
                moved = jax.tree.map(lambda a, t, sign=sign: a + sign * _STEP * t, primals, tangents)
                there = program(moved, tangents, cotangent)[0]
                wanted[sign] = [
                    (np.asarray(b) - np.asarray(a)) / (sign * _STEP) for a, b in zip(value, there, strict=True)
                ]
        for side, slopes in wanted.items():
            for slope, true in zip(along, slopes, strict=True):
                scale = max(1.0, float(np.abs(true).max(initial=0)))
                np.testing.assert_allclose(slope, true, rtol=1e-4, atol=2e-5 * scale, err_msg=f"{point.where}, {side}")

    def check_transpose(self) -> None:
        """The gradient by the last argument is what the code has for the transpose."""
        assert self.example.transpose is not None
        cotangent = self.ordered_cotangent()
        gradients = self.program(self.primals, self.primals, cotangent)[2][-1]
        given = cotangent[0] if len(cotangent) == 1 else cotangent
        own = jax.jit(self.example.transpose)(*eqx.combine(self.primals, self.rest), given)
        np.testing.assert_allclose(gradients, own, rtol=1e-10, atol=1e-12)


def check_types(entry: Entry) -> None:
    """Results have the type of the arguments; traced under x64, compiled never."""
    for dtype in (np.float32, np.float64):
        law = Law(entry, dtype)
        assert {leaf.dtype for leaf in law.results} == {np.dtype(dtype)}


class Batch:
    """Three items, each a little other than the example, with values and gradients of all of them."""

    def __init__(self, law: Law):
        self.law = law
        factors = [1.0, 1.0 - 2e-3, 1.0 + 3e-3]
        self.primals = jax.tree.map(
            lambda leaf: np.stack([leaf * np.asarray(f, leaf.dtype) for f in factors]), law.primals
        )

        def one(primals):
            value, pull = jax.vjp(law.function, *primals)
            return value, pull([jnp.ones_like(leaf) for leaf in value])

        self.single, self.batch = jax.jit(one), jax.jit(jax.vmap(one))

    def item(self, number: int) -> Any:
        """The arguments of one item."""
        return jax.tree.map(lambda leaf: np.asarray(leaf[number]), self.primals)

    def check_vmap(self) -> None:
        """A batch gives what its items give."""
        together = self.batch(self.primals)
        for number in range(3):
            alone = self.single(self.item(number))
            for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
                scale = float(np.abs(np.asarray(b)).max(initial=0))
                np.testing.assert_allclose(np.asarray(a)[number], b, rtol=1e-9, atol=1e-11 * max(scale, 1))

    def check_jit(self) -> None:
        """Compiled as a whole or function by function, the value is the same."""
        eager = self.law.function(*jax.device_put(self.item(1)))
        for a, b in zip(eager, self.single(self.item(1))[0], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11)

    def check_nan(self) -> None:
        """What is not a number in one item leaves values and gradients of the others as they were."""
        before = self.batch(self.primals)
        hit = jax.tree.map(np.copy, self.primals)
        for leaf in jax.tree.leaves(hit):
            leaf[1] = np.nan
        after = self.batch(hit)
        for a, b in zip(jax.tree.leaves(after), jax.tree.leaves(before), strict=True):
            np.testing.assert_array_equal(np.delete(a, 1, axis=0), np.delete(b, 1, axis=0))
        if not self.law.entry.nan:
            assert any(np.isnan(np.asarray(leaf)[1]).any() for leaf in after[0]), "a NaN does not come out"


def _product(a: Any, b: Any) -> float:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return float(sum(np.sum(np.asarray(x) * np.asarray(y)) for x, y in pairs))
