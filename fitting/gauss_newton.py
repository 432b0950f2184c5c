"""Levenberg–Marquardt for batches of small problems: what is carried from step to step is k × k."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, PyTree, Scalar

from fitting.small_systems import solve_positive


class NormalEquations(eqx.Module):
    """The Gauss–Newton model of ½|r|² around a point: its value f, gradient Jᵀr and JᵀJ."""

    f: Float[Array, ""]
    gradient: Float[Array, " k"]
    hessian: Float[Array, "k k"]

    def as_minimum(self) -> optx.FunctionInfo:
        """The equations as Optimistix's searches take them."""
        operator = lx.MatrixLinearOperator(self.hessian, lx.positive_semidefinite_tag)
        return optx.FunctionInfo.EvalGradHessian(self.f, self.gradient, operator)


class _State(eqx.Module):
    at: NormalEquations
    trial: Array
    search: Any
    first: Bool[Array, ""]
    done: Bool[Array, ""]


class SmallLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Marquardt's method over the normal equations, with a trust region of Optimistix.

    `optimistix.LevenbergMarquardt` carries the linearised residual, arrays as long as the samples, and factorises J;
    under vmap both are paid for every item in every step. Here J becomes JᵀJ and Jᵀr where it is computed. Damping is
    relative to the diagonal of JᵀJ, so that the units of the unknowns do not matter.

    The unknowns are one array. `options["normal_equations"]`, a function of (unknowns, args), may give the model of
    the residual in a cheaper way than by differentiating it, which is what is done without.

    Attributes:
        rtol, atol: the solve ends when a step promises to lower ½|r|² by less than rtol · ½|r|² + atol.
        norm: not used; Optimistix asks for it.
        damping: of the first step.
        search: accepts steps, and sets the damping of the next.
    """

    rtol: float
    atol: float
    norm: Callable[[PyTree], Scalar] = optx.two_norm
    damping: float = 1e-2
    search: optx.AbstractSearch = optx.ClassicalTrustRegion()

    def init(
        self,
        fn: Callable,
        y: Array,
        args: PyTree,
        options: dict[str, Any],
        f_struct: PyTree,
        aux_struct: PyTree,
        tags: frozenset[object],
    ) -> _State:
        """Before the first evaluation."""
        del fn, args, options, f_struct, aux_struct, tags
        nothing = NormalEquations(jnp.zeros((), y.dtype), jnp.zeros(y.size, y.dtype), jnp.zeros((y.size,) * 2, y.dtype))
        search = self.search.init(jnp.ravel(y), nothing.as_minimum())
        search = jax.tree.map(lambda leaf: leaf.astype(y.dtype), search)
        return _State(nothing, y, search, jnp.array(True), jnp.array(False))

    def step(
        self, fn: Callable, y: Array, args: PyTree, options: dict[str, Any], state: _State, tags: frozenset[object]
    ) -> tuple[Array, _State, Any]:
        """Judges the trial point, and proposes the next one."""
        del tags
        model = options.get("normal_equations") or (lambda y, args: by_differentiation(fn, y, args))
        new = model(state.trial, args)
        step_size, accept, _, search = self.search.step(
            state.first, jnp.ravel(y), jnp.ravel(state.trial), state.at.as_minimum(), new.as_minimum(), state.search
        )
        at = jax.tree.map(lambda a, b: jnp.where(accept, a, b), new, state.at)
        y = jnp.where(accept, state.trial, y)
        diagonal = jnp.diagonal(at.hessian)
        # An unknown that moves nothing stays where it is.
        diagonal = jnp.maximum(diagonal, 1e-6 * jnp.max(diagonal)) + float(jnp.finfo(y.dtype).tiny) ** 0.5
        change = -solve_positive(at.hessian + jnp.diag(self.damping / step_size * diagonal), at.gradient)
        promised = -(at.gradient @ change + 0.5 * change @ at.hessian @ change)
        done = promised <= self.rtol * at.f + self.atol
        return y, _State(at, y + change.reshape(y.shape), search, jnp.array(False), done), None

    def terminate(
        self, fn: Callable, y: Array, args: PyTree, options: dict[str, Any], state: _State, tags: frozenset[object]
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """When no step promises to matter."""
        del fn, y, args, options, tags
        return state.done, optx.RESULTS.successful

    def postprocess(
        self,
        fn: Callable,
        y: Array,
        aux: Any,
        args: PyTree,
        options: dict[str, Any],
        state: _State,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Array, Any, dict[str, Any]]:
        """Nothing is left to do."""
        del fn, args, options, state, tags, result
        return y, aux, {}


def by_differentiation(fn: Callable, y: Array, args: Any) -> NormalEquations:
    """The model of any residual (fn returns it and anything else)."""
    residual, push = jax.linearize(lambda flat: jnp.ravel(fn(flat.reshape(y.shape), args)[0]), jnp.ravel(y))
    J = jax.vmap(push, out_axes=1)(jnp.eye(y.size, dtype=y.dtype))
    return NormalEquations(0.5 * jnp.sum(residual * residual), residual @ J, J.T @ J)
