"""Unknown materials fitted to observed pictures: few numbers by Levenberg–Marquardt, many by conjugate gradients."""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxrelight.inverse.material_unknowns import Coordinates, Unknowns
from jaxrelight.inverse.observations import Observations
from jaxrelight.lighting.contract import Relighter

# The key of the light's strength among the coordinates: its logarithm.
LIGHT = "light"
# Numbers whose Jacobian is written out at most.
FEW = 64
# Steps of a search; a step is the last where the sum of squares would fall by less than this share.
MAX_STEPS, _TOLERANCE = 100, 1e-6
# Of linearisations of many numbers, by how much of the sum of squares before the first a further one has to lower it.
_MIN_FALL = 1e-6
# Of conjugate gradients: tolerance, and iterations.
_CG_TOLERANCE, _CG_STEPS = 1e-6, 500
# Random signs that estimate a diagonal.
_PROBES = 16


class Scene(eqx.Module):
    """What pictures of unknown materials are rendered with: all that stays.

    Attributes:
        relighter: with materials of the kinds that are sought.
        lit: a light for each picture.
        views: a view for each picture.
        traced: of both.
        bounces: see `Relighter.with_materials`.
    """

    relighter: Relighter
    lit: tuple[Any, ...]
    views: tuple[Any, ...]
    traced: tuple[Any, ...]
    bounces: Literal["held", "followed"] | None = eqx.field(static=True)

    def rendered(self, unknowns: Unknowns, coordinates: Coordinates) -> list[Float[Array, "h w 3"]]:
        """The pictures; differentiable in the coordinates."""
        changed: Any = self.relighter.with_materials(unknowns.materials(coordinates), bounces=self.bounces)
        parts = zip(self.lit, self.views, self.traced, strict=True)
        pictures = [changed.shade(changed.relit(lit), view, traced).radiance for lit, view, traced in parts]
        if LIGHT not in coordinates:
            return pictures
        return [picture * jnp.exp(coordinates[LIGHT]) for picture in pictures]


class Problem(eqx.Module):
    """A fit: what is sought, what is rendered, what was seen, and how smooth textures are taken to be.

    Attributes:
        unknowns: what is sought.
        scene: what is rendered.
        observations: what was seen.
        smoothness: factor on the squared differences of neighbouring texels.
    """

    unknowns: Unknowns
    scene: Scene
    observations: Observations
    smoothness: Float[Array, ""]

    def misfit(self, coordinates: Coordinates) -> list[Float[Array, "..."]]:
        """Weighted differences of rendered and observed pixels."""
        rendered = self.scene.rendered(self.unknowns, coordinates)
        return [one.misfit(radiance) for one, radiance in zip(self.observations.used, rendered, strict=True)]

    def roughness(self, coordinates: Coordinates) -> list[Float[Array, "..."]]:
        """Differences of neighbouring texels, which wrap around as textures do, weighted."""
        differences = []
        for one in self.unknowns.parameters:
            if one.is_texture:
                texels = coordinates[one.key]
                differences += [jnp.sqrt(self.smoothness) * (texels - jnp.roll(texels, 1, axis)) for axis in (0, 1)]
        return differences


@eqx.filter_jit
def rendered(problem: Problem, coordinates: Coordinates) -> list[Float[Array, "h w 3"]]:
    """The pictures of some coordinates."""
    return problem.scene.rendered(problem.unknowns, coordinates)


@eqx.filter_jit
def jacobian(problem: Problem, coordinates: Coordinates) -> Float[Array, "m p"]:
    """Derivatives of the weighted pixels in all coordinates, in the order of `ravel_pytree`."""
    flat, shaped = ravel_pytree(coordinates)

    def misfit(flat):
        return jnp.concatenate([part.reshape(-1) for part in problem.misfit(shaped(flat))])

    return jax.jacfwd(misfit)(flat)


class Search(NamedTuple):
    """What a search found, and after how many steps."""

    coordinates: Coordinates
    steps: int
    converged: bool


def search(problem: Problem, start: Coordinates) -> Search:
    """Few coordinates: Levenberg–Marquardt of Optimistix."""
    found, steps, converged = _searched(problem, start)
    return Search(found, int(steps), bool(converged))


@eqx.filter_jit
def _searched(problem: Problem, start: Coordinates):
    solver = optx.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE)
    # Sums of squares are of order 1 whatever the units of weights and pictures are.
    square = sum(jnp.sum((one.radiance * one.weight) ** 2) for one in problem.observations.used)
    scale = 1 / jnp.sqrt(jnp.maximum(square, jnp.finfo(jnp.float32).tiny))

    def misfit(coordinates, problem):
        return [part * scale for part in problem.misfit(coordinates)]

    solution = optx.least_squares(
        misfit, solver, start, problem, options={"jac": "fwd"}, max_steps=MAX_STEPS, throw=False
    )
    return solution.value, solution.stats["num_steps"], solution.result == optx.RESULTS.successful


class ManyFound(NamedTuple):
    """Many coordinates, and how well the pictures tell them.

    Attributes:
        coordinates: found.
        curvature: the diagonal of JᵀJ.
        reach: Jᵀ|J 1|, which is nothing where no pixel depends on a coordinate.
        steps: linearisations.
        converged: whether the last one lowered the sum of squares by next to nothing.
    """

    coordinates: Coordinates
    curvature: Coordinates
    reach: Coordinates
    steps: int
    converged: bool


def solve_many(problem: Problem, start: Coordinates, linear: bool, max_steps: int = 12) -> ManyFound:
    """Many coordinates: linearised, solved by conjugate gradients through the picture and its adjoint, and again.

    Where pictures are linear in all, the second step takes away what single precision left of the first.
    """
    at, damping = start, 0.0 if linear else 1e-3
    value, converged, steps = float(_value(problem, at)), False, 0
    least = _MIN_FALL * value
    while steps < (2 if linear else max_steps) and not converged:
        trial, steps = _step(problem, at, jnp.float32(damping)), steps + 1
        new = float(_value(problem, trial))
        converged = (linear and steps > 1) or abs(value - new) <= max(least, _MIN_FALL * value)
        if new <= value:
            at, value, damping = trial, new, damping / 10
        else:
            damping = max(damping * 30, 1e-4)
    curvature, reach = _told(problem, at)
    return ManyFound(at, curvature, reach, steps, converged)


@eqx.filter_jit
def _value(problem: Problem, at: Coordinates) -> Float[Array, ""]:
    """The sum of squares."""
    parts = [*problem.misfit(at), *problem.roughness(at)]
    return sum((jnp.sum(part**2) for part in parts), jnp.zeros(()))


def _linearised(problem: Problem, at: Coordinates):
    """The misfit, J and Jᵀ of pixels, at some coordinates."""
    misfit, push = jax.linearize(problem.misfit, at)
    pull = jax.linear_transpose(push, at)
    return misfit, push, lambda of: pull(of)[0]


def _plus(a, b, factor=1.0):
    return jax.tree.map(lambda x, y: x + factor * y, a, b)


def _diagonal(push, pull, like: Coordinates) -> Coordinates:
    """The diagonal of JᵀJ, estimated from random signs."""

    def probe(total, key):
        signs = jax.tree.map(
            lambda x, k: jax.random.rademacher(k, x.shape, x.dtype),
            like,
            jax.tree.unflatten(jax.tree.structure(like), list(jax.random.split(key, len(jax.tree.leaves(like))))),
        )
        return _plus(total, jax.tree.map(jnp.multiply, signs, pull(push(signs)))), None

    keys = jax.random.split(jax.random.key(0), _PROBES)
    total, _ = jax.lax.scan(probe, jax.tree.map(jnp.zeros_like, like), keys)
    return jax.tree.map(lambda x: jnp.maximum(x / _PROBES, 0), total)


@eqx.filter_jit
def _step(problem: Problem, at: Coordinates, damping: Float[Array, ""]) -> Coordinates:
    misfit, push, pull = _linearised(problem, at)
    rough, rough_push = jax.linearize(problem.roughness, at)
    rough_pull = jax.linear_transpose(rough_push, at)
    diagonal = _diagonal(push, pull, at)
    largest = jnp.max(jnp.stack([jnp.max(part) for part in jax.tree.leaves(diagonal)]))
    # What no pixel tells stays where it is.
    scale = jax.tree.map(lambda d: d * damping + 1e-7 * largest, diagonal)

    # Numbers of order 1, as the tolerance counts them.
    unit = jnp.maximum(largest, jnp.finfo(largest.dtype).tiny)

    def normal(x):
        smooth = rough_pull(rough_push(x))[0]
        return jax.tree.map(lambda p, q, s, y: (p + q + s * y) / unit, pull(push(x)), smooth, scale, x)

    def divided(x):
        return jax.tree.map(lambda y, d: y / ((d + 4 * problem.smoothness) / unit + 1e-4), x, diagonal)

    gradient = _plus(pull(misfit), rough_pull(rough)[0])
    structure = jax.eval_shape(lambda: at)
    positive = lx.positive_semidefinite_tag
    solver = lx.CG(rtol=_CG_TOLERANCE, atol=_CG_TOLERANCE, max_steps=_CG_STEPS)
    preconditioner = lx.FunctionLinearOperator(divided, structure, positive)
    solution = lx.linear_solve(
        lx.FunctionLinearOperator(normal, structure, positive),
        jax.tree.map(lambda of: -of / unit, gradient),
        solver,
        options={"preconditioner": preconditioner},
        throw=False,
    )
    return _plus(at, solution.value)


@eqx.filter_jit
def _told(problem: Problem, at: Coordinates) -> tuple[Coordinates, Coordinates]:
    _, push, pull = _linearised(problem, at)
    reach = pull(jax.tree.map(jnp.abs, push(jax.tree.map(jnp.ones_like, at))))
    return _diagonal(push, pull, at), jax.tree.map(jnp.abs, reach)


def curvature_at(problem: Problem, at: Coordinates) -> float:
    """The mean of the diagonal of JᵀJ over the texels that pixels depend on."""
    curvature, reach = _told(problem, at)
    keys = [one.key for one in problem.unknowns.parameters if one.is_texture]
    values = np.concatenate([np.ravel(np.asarray(curvature[key])) for key in keys or curvature])
    seen = np.concatenate([np.ravel(np.asarray(reach[key])) for key in keys or reach])
    return float(values[seen > 0].mean()) if (seen > 0).any() else 0.0
