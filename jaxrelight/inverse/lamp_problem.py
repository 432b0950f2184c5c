"""The least squares of lamps: outputs and their slopes lamp by lamp, and one solve while shadows are held fixed."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxrelight.inverse.lamp_response import Bits, LampResponse
from jaxrelight.inverse.lamp_targets import LuxTargets, PictureTarget
from jaxrelight.inverse.lamp_unknowns import LampKind, Placement, lamp_at, placed, shown_unknowns
from jaxrelight.lighting.shadows import LightGroup

# Unknowns of all kinds.
Unknowns = tuple[Float[Array, "_ _"], ...]
# Levenberg–Marquardt begins with a damping of 1, which is much for residuals of order one.
_RESIDUAL_SCALE = 10.0
# Relative and absolute steps, of unknowns and of the loss, at which one solve ends.
_TOLERANCE = 1e-5, 1e-10


class LampProblem(eqx.Module):
    """All that outputs depend on beside the unknowns.

    Attributes:
        response: from lamps to outputs.
        kinds: the lamps.
        starts: of each kind, the placements about which its unknowns count.
        bits: of each kind, what its lamps' lights reach: [n, q, b] for q lights of each.
        others: outputs of lights that stay as they are.
        targets: of the outputs.
    """

    response: LampResponse
    kinds: tuple[LampKind, ...]
    starts: tuple[Placement, ...]
    bits: tuple[Bits, ...]
    others: Float[Array, " m"]
    targets: LuxTargets | PictureTarget


def lights_of(kind: LampKind, lamp: Any, placement: Placement) -> LightGroup:
    """The punctual lights of one lamp of a kind, as it is placed."""
    parts = lamp_at(lamp, kind.free, placement).parts()
    together = jax.tree.map(lambda *each: jnp.stack(each), *parts)
    return LightGroup(together, jnp.ones(len(parts), bool))


@eqx.filter_jit
def all_lights_of(kind: LampKind, placements: Placement) -> LightGroup:
    """The punctual lights of all lamps of a kind, one lamp's after the other's."""
    every = jax.vmap(lambda lamp, placement: lights_of(kind, lamp, placement))(kind.lamps, placements)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), every)


def traced_bits(
    response: LampResponse, kinds: tuple[LampKind, ...], placements: tuple[Placement, ...]
) -> tuple[Any, ...]:
    """Shadow rays towards all lamps, on the host."""
    every = []
    for kind, own in zip(kinds, placements, strict=True):
        bits, lamps = response.trace(all_lights_of(kind, own)), len(kind.numbers)
        every.append(jax.tree.map(lambda x, lamps=lamps: x.reshape(lamps, -1, x.shape[-1]), bits))
    return tuple(every)


@eqx.filter_custom_jvp
def outputs_of(unknowns: Unknowns, problem: LampProblem) -> Float[Array, " m"]:
    """Outputs by all light. Slopes in the unknowns, with shadows held fixed, are those of each lamp by itself."""
    return problem.others + sum(jnp.sum(own, axis=0) for own in _lamp_by_lamp(unknowns, problem, lambda f, x: f(x)))


@outputs_of.def_jvp
def _slopes_of_outputs(primals, tangents):
    unknowns, problem = primals
    outputs, slopes = outputs_and_slopes(unknowns, problem)
    change = sum(
        # outputs m, lamps n, unknowns p
        jnp.einsum("nmp,np->m", own, along, precision="highest")
        for own, along in zip(slopes, tangents[0], strict=True)
        if along is not None
    )
    return outputs, jnp.zeros_like(outputs) + change


def outputs_and_slopes(
    unknowns: Unknowns, problem: LampProblem
) -> tuple[Float[Array, " m"], tuple[Float[Array, "_ m _"], ...]]:
    """Outputs, and of each kind the slopes in its lamps' unknowns."""

    def with_slopes(outputs, values):
        value, push = jax.linearize(outputs, values)
        # [p, m]
        return value, jax.vmap(push)(jnp.eye(len(values), dtype=values.dtype)).T

    every = _lamp_by_lamp(unknowns, problem, with_slopes)
    return problem.others + sum(jnp.sum(value, axis=0) for value, _ in every), tuple(slopes for _, slopes in every)


def _lamp_by_lamp(
    unknowns: Unknowns, problem: LampProblem, ask: Callable[[Callable[[Array], Array], Array], Any]
) -> list[Any]:
    """Of each kind what is asked of its lamps, one after the other: of a lamp's outputs, and where its unknowns are."""
    every = []
    for kind, starts, bits, own in zip(problem.kinds, problem.starts, problem.bits, unknowns, strict=True):

        def of_lamp(given, kind=kind):
            lamp, box, start, seen, values = given

            def outputs(values):
                return problem.response.outputs(lights_of(kind, lamp, placed(kind, box, start, values)), seen)

            return ask(outputs, values)

        every.append(jax.lax.map(of_lamp, (kind.lamps, kind.box, starts, bits, own)))
    return every


@eqx.filter_jit
def found_placements(problem: LampProblem, unknowns: Unknowns) -> tuple[Placement, ...]:
    """Where unknowns put all lamps."""

    def of(kind: LampKind, start: Placement, own: Array) -> Placement:
        boxed = None if kind.box is None else 0
        return jax.vmap(lambda box, start, values: placed(kind, box, start, values), (boxed, 0, 0))(
            kind.box, start, own
        )

    return tuple(of(*one) for one in zip(problem.kinds, problem.starts, unknowns, strict=True))


@eqx.filter_jit
def solved(problem: LampProblem, unknowns: Unknowns, steps: int) -> Unknowns:
    """Levenberg–Marquardt's best unknowns after some steps, shadows held fixed."""

    def residual(unknowns, problem):
        return _RESIDUAL_SCALE * problem.targets.residual(outputs_of(unknowns, problem))

    solver = optx.LevenbergMarquardt(*_TOLERANCE)
    return optx.least_squares(residual, solver, unknowns, problem, max_steps=steps, throw=False).value


@eqx.filter_jit
def linearised(problem: LampProblem, unknowns: Unknowns) -> tuple[Float[Array, " r"], Float[Array, "r p"]]:
    """Residuals, and their slopes in all unknowns."""
    outputs, slopes = outputs_and_slopes(unknowns, problem)
    residual, push = jax.linearize(problem.targets.residual, outputs)
    every = jnp.concatenate([jnp.moveaxis(own, 1, 0).reshape(own.shape[1], -1) for own in slopes], axis=1)
    return residual, jax.vmap(push, in_axes=1, out_axes=1)(every)


@eqx.filter_jit
def loss_at(problem: LampProblem, unknowns: Unknowns) -> Float[Array, ""]:
    """The sum of squared residuals."""
    return jnp.sum(problem.targets.residual(outputs_of(unknowns, problem)) ** 2)


@eqx.filter_jit
def lamp_outputs(problem: LampProblem) -> tuple[Float[Array, "_ m _"], ...]:
    """What each lamp gives where it starts, by a brightness of 1: of all channels, or of each where those are free."""
    every = []
    for kind, starts, bits in zip(problem.kinds, problem.starts, problem.bits, strict=True):

        def of_lamp(given, kind=kind):
            lamp, start, seen = given

            def outputs(brightness):
                return problem.response.outputs(lights_of(kind, lamp, start._replace(brightness=brightness)), seen)

            return jax.vmap(outputs)(jnp.eye(start.brightness.shape[-1], dtype=start.brightness.dtype)).T

        every.append(jax.lax.map(of_lamp, (kind.lamps, starts, bits)))
    return tuple(every)


@eqx.filter_jit
def sensitivities(
    problem: LampProblem, unknowns: Unknowns, centre: Float[Array, "3"]
) -> tuple[Float[Array, "r p"], tuple[Float[Array, "_ _"], ...], tuple[Float[Array, "_ _ _"], ...]]:
    """What uncertainty is told from.

    Returns:
        The slopes of residuals in all unknowns; and of each kind, the unknowns as they are shown, and their slopes.
    """
    outputs, slopes = outputs_and_slopes(unknowns, problem)
    # [m, p] of all lamps
    every = jnp.concatenate([jnp.moveaxis(own, 1, 0).reshape(own.shape[1], -1) for own in slopes], axis=1)
    _, push = jax.linearize(problem.targets.residual, outputs)
    shown, turns = [], []
    for kind, starts, own in zip(problem.kinds, problem.starts, unknowns, strict=True):

        def values(box, start, values, kind=kind):
            return shown_unknowns(kind, start, placed(kind, box, start, values), centre)

        boxed = None if kind.box is None else 0
        shown.append(jax.vmap(values, (boxed, 0, 0))(kind.box, starts, own))
        turns.append(jax.vmap(jax.jacfwd(values, argnums=2), (boxed, 0, 0))(kind.box, starts, own))
    return jax.vmap(push, in_axes=1, out_axes=1)(every), tuple(shown), tuple(turns)


def on_host(placements: tuple[Placement, ...]) -> tuple[Placement, ...]:
    """Placements as arrays of NumPy."""
    return jax.tree.map(np.asarray, placements)
