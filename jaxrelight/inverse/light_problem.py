"""Pictures as a linear map of an unknown environment, of unknown strengths of lamps, and of unknown exposures."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.inverse.light_grid import LightGrid
from jaxrelight.inverse.observations import Observed
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lights.environment import Environment

# Divisors of pictures whose exposure is unknown are so many times as large as that of the first, or less.
_EXPOSURE_RANGE = 3.0


class LightProblem(eqx.Module):
    """What unknown light is rendered and compared with. Unknowns are [m, 3]: wavelet coefficients, lamps, exposures.

    All unknowns are in units of their standard deviations, so that they are alike before any picture is seen.

    Attributes:
        relighter: of the scene.
        views: of the pictures.
        traced: of views and a light.
        grid: of the environment.
        deviations: standard deviations of the grid's coefficients, [d].
        lamps: radiance of every picture by each of l lamps as it was given, [l, h, w, 3].
        observed: the pixels of each picture, those that are held out, too.
        has_exposure: of each picture, whether its exposure is unknown.
        joint: whether an exposure is the same for all channels.
    """

    relighter: Relighter
    views: tuple[Any, ...]
    traced: tuple[Any, ...]
    grid: LightGrid
    deviations: Float[Array, " d"]
    lamps: tuple[Float[Array, "l h w 3"], ...]
    observed: tuple[Observed, ...]
    has_exposure: tuple[bool, ...] = eqx.field(static=True)
    joint: bool = eqx.field(static=True)

    @property
    def lamp_count(self) -> int:
        """How many lamps there are, l."""
        return len(self.lamps[0])

    @property
    def size(self) -> int:
        """m: coefficients, lamps, and unknown exposures."""
        return self.grid.size + self.lamp_count + sum(self.has_exposure)

    def split(self, unknowns: Float[Array, "m 3"]) -> tuple[Float[Array, "d 3"], Float[Array, "l 3"], Array]:
        """Radiance of the texels, factors on the lamps, and divisors of pictures' radiance."""
        d, lamps = self.grid.size, self.lamp_count
        texels = self.grid.texels(unknowns[:d] * self.deviations[:, None])
        return texels, unknowns[d : d + lamps], unknowns[d + lamps :] * _EXPOSURE_RANGE


def rendered(problem: LightProblem, texels: Float[Array, "d 3"], lamps: Float[Array, "l 3"]) -> list[Array]:
    """The pictures under an environment and lamps, with what surfaces emit, before any exposure."""
    lit = problem.relighter.light(Environment(problem.grid.pixels(texels)))
    parts = zip(problem.views, problem.traced, problem.lamps, strict=True)
    return [
        problem.relighter.shade(lit, view, traced).radiance
        + jnp.einsum("lhwc,lc->hwc", by_lamp, lamps, precision="highest")
        for view, traced, by_lamp in parts
    ]


def _weighted(problem: LightProblem, unknowns: Float[Array, "m 3"]) -> Float[Array, "n 3"]:
    """What unknowns make of the observed pixels, less what is seen there where an exposure is unknown."""
    texels, lamps, exposures = problem.split(unknowns)
    rows, number = [], 0
    for one, picture, free in zip(
        problem.observed, rendered(problem, texels, lamps), problem.has_exposure, strict=True
    ):
        own = one.rendered(picture)
        if free:
            factor = exposures[number]
            factor = jnp.broadcast_to(factor[:1], factor.shape) if problem.joint else factor
            own, number = own - one.radiance * factor[None], number + 1
        rows.append(own * one.weight)
    return jnp.concatenate(rows)


@eqx.filter_jit
def applied(problem: LightProblem, unknowns: Float[Array, "m 3"]) -> Float[Array, "n 3"]:
    """A x: the weighted numbers of all observed pixels that unknowns make, without what surfaces emit."""
    _, push = jax.linearize(lambda x: _weighted(problem, x), jnp.zeros_like(unknowns))
    return push(unknowns)


@eqx.filter_jit
def adjoint(problem: LightProblem, numbers: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
    """Aᵀ y. Pictures are affine in the unknowns, so that their gradient is the same everywhere."""
    like = jnp.zeros((problem.size, 3), numbers.dtype)
    return jax.vjp(lambda x: _weighted(problem, x), like)[1](numbers)[0]


def right_side(problem: LightProblem) -> Float[np.ndarray, "n 3"]:
    """b: what the pictures show beyond what surfaces emit; 0 where a picture's own exposure is unknown."""
    shown = [
        np.asarray(one.radiance * one.weight) * (0 if free else 1)
        for one, free in zip(problem.observed, problem.has_exposure, strict=True)
    ]
    return np.concatenate(shown) - np.asarray(_weighted(problem, jnp.zeros((problem.size, 3))))


def weights_of(observed: Sequence[Observed]) -> Float[np.ndarray, "n 3"]:
    """Weights of all numbers."""
    return np.concatenate([np.asarray(one.weight) for one in observed])
