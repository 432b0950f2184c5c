"""An environment from pictures of a known scene, and what the pictures tell of it."""

import dataclasses
import time
from collections.abc import Sequence
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.inverse.lamp_unknowns import brightened
from jaxrelight.inverse.light_certainty import LightCertainty, LightEstimate, certainty_of
from jaxrelight.inverse.light_problem import rendered, weights_of
from jaxrelight.inverse.light_setup import LightTask, light_task
from jaxrelight.inverse.light_solver import LightSolution, LightSolver
from jaxrelight.inverse.observations import Picture
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.lights import Lights, LightsLike
from jaxrelight.lights.local import Light
from jaxrelight.progress import Report


@dataclasses.dataclass(frozen=True)
class InverseLight:
    """Light that pictures were solved for.

    Attributes:
        environment: that was found, as a lat-long map.
        texels: its radiance on the grid of unknowns, [d, 3].
        lamps: the local lights, with the strengths that were found.
        lamp_factors: on what the lamps were given as, [l, 3].
        exposures: of each picture, the factor by channel from radiance to what it shows; 1 where it was known.
        certainty: what the pictures tell of the environment.
        residual: root mean square of what the fit misses, over that of the pictures, both weighted.
        held_out: the same of pixels that were not fitted; None where none were held out.
        strength: of the ridge, in units of the weighted pictures.
        singular_values: see `LightCertainty`.
        applications: products with the map from light to pictures, and as many with its adjoint.
        converged: whether more steps of the solver would change next to nothing.
        pixels: how many numbers of the pictures were fitted.
        saturated: how many at the top of a picture's range were taken as lower bounds.
        pictures: as the found light makes them, at the exposure of each.
        notes: what was assumed or fixed, one line each.
        seconds: of the whole.
    """

    environment: Environment
    texels: Float[np.ndarray, "d 3"]
    lamps: tuple[Light, ...]
    lamp_factors: Float[np.ndarray, "l 3"]
    exposures: Float[np.ndarray, "p 3"]
    certainty: LightCertainty
    residual: float
    held_out: float | None
    strength: float
    singular_values: Float[np.ndarray, "k 3"]
    applications: int
    converged: bool
    pixels: int
    saturated: int
    pictures: tuple[Float[np.ndarray, "h w 3"], ...]
    notes: tuple[str, ...]
    seconds: float

    @property
    def lights(self) -> Lights:
        """The environment and the lamps together."""
        return Lights(self.environment, self.lamps)

    def estimate(self, weights: Float[np.ndarray, " d"]) -> LightEstimate:
        """A weighted mean of the environment, how exactly it is known, and whether the pictures tell it at all.

        Args:
            weights: of every texel, in the order of `certainty.grid.directions`; their sum is made 1.

        Raises:
            InputError: for weights of another number, or that sum to 0.
        """
        return self.certainty.of_mean(weights, self.texels)


def environment(
    relighter: Relighter,
    pictures: Sequence[Picture],
    views: Sequence[Any] | Camera | None = None,
    *,
    unknowns: int | tuple[int, int] = 16,
    prior: Literal["natural", "sparse"] = "natural",
    not_negative: bool = True,
    lamps: LightsLike = None,
    exposures: Literal["known", "exposure", "white balance"] = "known",
    masks: Sequence[Bool[np.ndarray, "h w"] | None] | None = None,
    deviations: Sequence[Picture | float] | None = None,
    saturation: float | None = None,
    hold_out: float = 0.1,
    strength: float | None = None,
    max_steps: int = 200,
    seed: int = 0,
    report: Report | None = None,
) -> InverseLight:
    """Solves pictures of a known scene for the environment that lights it.

    Pictures are linear in the light, so this is least squares: through products with the map and its adjoint alone,
    regularised by what natural light is like, as strongly as pixels that are held out ask for.

    Args:
        relighter: of the scene, prepared by any method under which distant light is linear.
        pictures: linear radiance, as `read_image` gives it.
        views: of the pictures: cameras, or what `relighter.view` gives; one for all, or the scene's.
        unknowns: n for the 6×n×n texels of a cube map, or (height, width) of a lat-long map; powers of two.
        prior: "natural": wavelets of each level vary as in photographed environments. "sparse": few differ from 0.
        not_negative: whether light is at least 0 everywhere.
        lamps: local lights of the scene, each of whose strength by channel is unknown, too.
        exposures: "known"; or all but the first picture's are unknown, one factor a picture or one for each channel.
            The first picture fixes the scale, which nothing else would.
        masks: of each picture, the pixels that count.
        deviations: of each picture, the standard deviation of its pixels, for weights; without, all count alike.
        saturation: what pictures show at most: pixels there are at least as bright.
        hold_out: share of the pixels that is not fitted, chooses the ridge, and tells the fit's error.
        strength: of the ridge, instead; in units of the weighted pictures.
        max_steps: of the solver, each of a product with the map and one with its adjoint.
        seed: of the pixels that are held out.
        report: called with the progress.

    Raises:
        InputError: for a relighter that takes no environment, for pictures, views or masks that do not fit the scene,
            or other dials.
    """
    start = time.perf_counter()
    _check(prior, exposures, max_steps, strength, hold_out)
    task = light_task(
        relighter,
        list(pictures),
        views,
        unknowns=unknowns,
        lamps=lamps,
        exposures=exposures,
        masks=masks,
        deviations=deviations,
        saturation=saturation,
        hold_out=hold_out,
        seed=seed,
    )
    solver = LightSolver(task, report, max_steps)
    solution = solver.solve(strength, prior, not_negative=not_negative)
    problem, grid = task.problem, task.problem.grid
    texels, factors, divisors = (np.asarray(p) for p in problem.split(jnp.asarray(solution.unknowns, jnp.float32)))
    texels = np.maximum(texels, 0) if not_negative else texels
    scales = _exposures(divisors, problem.has_exposure, problem.joint)
    images = [np.asarray(image) for image in rendered(problem, jnp.asarray(texels), jnp.asarray(factors))]
    made = [image * scale.astype(np.float32) for image, scale in zip(images, scales, strict=True)]
    rows = [np.asarray(one.rendered(jnp.asarray(image))) for one, image in zip(problem.observed, made, strict=True)]
    weights, shown = weights_of(problem.observed), np.concatenate([np.asarray(o.radiance) for o in problem.observed])
    missed = task.missed(np.concatenate(rows) - shown) * weights
    noise = np.sqrt(np.mean(missed[task.judged] ** 2, axis=0))
    spread = np.asarray(problem.deviations)
    certainty = certainty_of(solver.state, solver.spectrum, grid, spread, solution.strength, np.maximum(noise, 1e-12))
    factors = factors * task.lamp_scale
    held_out = np.logical_not(task.fitted)
    return InverseLight(
        environment=Environment(np.maximum(np.asarray(grid.pixels(jnp.asarray(texels))), 0)),
        texels=texels,
        lamps=tuple(brightened(lamp, factor) for lamp, factor in zip(task.lamps, factors, strict=True)),
        lamp_factors=factors,
        exposures=scales,
        certainty=certainty,
        residual=_relative(missed, shown * weights, task.fitted),
        held_out=_relative(missed, shown * weights, held_out) if held_out.any() else None,
        strength=solution.strength,
        singular_values=solver.spectrum.values,
        applications=solver.applications,
        converged=solution.converged,
        pixels=int(np.count_nonzero(weights[task.fitted])),
        saturated=int((task.bounded & task.fitted).sum()),
        pictures=tuple(made),
        notes=_notes(
            task, solution, solver.state.steps, texels, judged_alone=strength is not None or bool(held_out.any())
        ),
        seconds=time.perf_counter() - start,
    )


def _notes(
    task: LightTask, solution: LightSolution, steps: int, texels: Float[np.ndarray, "d 3"], *, judged_alone: bool
) -> tuple[str, ...]:
    notes = []
    if any(task.problem.has_exposure):
        notes.append("the first picture's exposure is taken as it is given: it fixes the scale of the light")
    if not solution.converged:
        notes.append(f"the solver stopped after {steps} steps: pictures may tell more than is said; raise max_steps")
    if not judged_alone:
        notes.append("too few pixels count for any to be held out: the light may follow their noise")
    if (texels < 0).any():
        share = -texels[texels < 0].sum() / np.abs(texels).sum()
        notes.append(
            f"radiance is negative in places, {share:.1%} of all: the environment has 0 there, texels as found"
        )
    return tuple(notes)


def _check(prior: str, exposures: str, max_steps: int, strength: float | None, hold_out: float) -> None:
    if prior not in ("natural", "sparse"):
        raise InputError(f'prior is "natural" or "sparse", not {prior!r}')
    if exposures not in ("known", "exposure", "white balance"):
        raise InputError(f'exposures are "known", or "exposure" or "white balance" is sought, not {exposures!r}')
    if max_steps < 1:
        raise InputError(f"max_steps is {max_steps}; it must be at least 1")
    if strength is not None and not strength > 0:
        raise InputError(f"the strength of the ridge is {strength:g}; it must be above 0")
    if hold_out == 0 and strength is None:
        raise InputError("the ridge is chosen by pixels that are held out; hold some out, or give its strength")


def _exposures(divisors: np.ndarray, free: Sequence[bool], joint: bool) -> Float[np.ndarray, "p 3"]:
    """Factors from radiance to what pictures show."""
    scales, number = np.ones((len(free), 3)), 0
    for picture, is_free in enumerate(free):
        if is_free:
            own = np.broadcast_to(divisors[number][:1], 3) if joint else divisors[number]
            if not (own > 0).all():
                raise InputError(f"picture {picture + 1} has no exposure under which it fits the first; leave it out")
            scales[picture], number = 1 / own, number + 1
    return scales


def _relative(missed: np.ndarray, shown: np.ndarray, chosen: np.ndarray) -> float:
    return float(np.sqrt(np.sum(missed[chosen] ** 2) / max(np.sum(shown[chosen] ** 2), 1e-30)))
