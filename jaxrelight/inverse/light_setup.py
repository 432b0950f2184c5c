"""What is known before light is solved for: the linear map, the pixels that count, and how large unknowns may be."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.inverse.lamp_unknowns import brightened
from jaxrelight.inverse.light_grid import light_grid
from jaxrelight.inverse.light_problem import LightProblem
from jaxrelight.inverse.observations import Observed, Picture, observe
from jaxrelight.inverse.views import views_of
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.lights import LightsLike, as_lights
from jaxrelight.lights.local import Light
from jaxrelight.methods import Adaptive, Indirect
from jaxrelight.numerics.arrays import as_array

# A lamp's strength may be so many times what would make pictures as bright as they are.
_LAMP_RANGE = 10.0


@dataclasses.dataclass(frozen=True)
class LightTask:
    """Pictures that are to be solved for light.

    Attributes:
        problem: the linear map.
        fitted: of its numbers, those that are fitted; the others are held out.
        bounded: those that are only known to be at least as bright as they are.
        lamps: whose strengths are unknown.
        lamp_scale: factor on what lamps were given as, of an unknown that is 1, [l, 1].
    """

    problem: LightProblem
    fitted: Bool[np.ndarray, "n 3"]
    bounded: Bool[np.ndarray, "n 3"]
    lamps: tuple[Light, ...]
    lamp_scale: Float[np.ndarray, "l 1"]

    @property
    def judged(self) -> Bool[np.ndarray, " n"]:
        """The rows that judge a fit: those that are held out; all, where none are."""
        held_out = np.logical_not(self.fitted.any(axis=1))
        return held_out if held_out.any() else np.logical_not(held_out)

    def missed(self, differences: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """What counts as missed of what is made less what is seen: of lower bounds only what falls short."""
        return np.where(self.bounded, np.minimum(differences, 0), differences)


def light_task(
    relighter: Relighter,
    pictures: Sequence[Picture],
    views: Sequence[Any] | Camera | None,
    *,
    unknowns: int | tuple[int, int],
    lamps: LightsLike,
    exposures: str,
    masks: Sequence[Bool[np.ndarray, "h w"] | None] | None,
    deviations: Sequence[Picture | float] | None,
    saturation: float | None,
    hold_out: float,
    seed: int,
) -> LightTask:
    """Sets up what `inverse.environment` solves; see there for the arguments.

    Raises:
        InputError: for a relighter that takes no environment, or pictures, views, masks or lamps that do not fit.
    """
    grid, known = light_grid(unknowns), as_lights(lamps)
    if not pictures:
        raise InputError("there are no pictures to solve for light; give at least one")
    if known.environment is not None:
        raise InputError("lamps are local lights; the environment is what is sought")
    for lamp in known.local:
        brightened(lamp, np.ones(3))  # refuses lights whose strength cannot be unknown
    linear = _linear(relighter)
    seen = views_of(linear, views, len(pictures))
    lit = linear.light(Environment(np.ones((32, 64, 3), np.float32)))
    traced = tuple(linear.trace(lit, view) for view in seen)
    even = [linear.shade(lit, view, of) for view, of in zip(seen, traced, strict=True)]
    observed = observe(pictures, [np.asarray(one.alpha) for one in even], masks, deviations, None, hold_out, seed)
    rows = tuple(_joined(*pair) for pair in zip(observed.used, observed.held_out, strict=True))
    fitted = np.concatenate([_is_fitted(*pair) for pair in zip(observed.used, observed.held_out, strict=True)])
    shown = np.concatenate([np.asarray(one.radiance) for one in rows])
    bounded = np.zeros(shown.shape, bool) if saturation is None else shown >= saturation
    if not shown[fitted].any():
        raise InputError("the pictures are black where pixels count; look at the files and the masks")
    means = [np.asarray(one.radiance) for one in even]
    brightness = _brightness(rows, means)
    by_lamp, lamp_scale = _lamp_pictures(linear, known.local, seen, brightness, means)
    problem = LightProblem(
        relighter=linear,
        views=seen,
        traced=traced,
        grid=grid,
        deviations=as_array(grid.spectrum * brightness * grid.basis.resolution),
        lamps=by_lamp,
        observed=rows,
        has_exposure=tuple(exposures != "known" and number > 0 for number in range(len(pictures))),
        joint=exposures == "exposure",
    )
    return LightTask(problem, fitted, bounded, known.local, lamp_scale)


def _linear(relighter: Relighter) -> Relighter:
    """The relighter whose pictures are linear in the environment."""
    if isinstance(relighter.method, Indirect) and not relighter.method.sky:
        raise InputError(
            "a relighter for local lights draws an environment anew for each light; prepare with Indirect(sky=True)"
        )
    if isinstance(relighter.method, Adaptive):
        raise InputError("adaptive lighting draws its samples for one light; prepare with another method")
    if isinstance(relighter, TransportRelighter) and relighter.method.split_sun:
        method = dataclasses.replace(relighter.method, split_sun=False)
        return TransportRelighter(dataclasses.replace(relighter.transport, method=method))
    return relighter


def _joined(used: Observed, held_out: Observed) -> Observed:
    """Both, one after the other."""
    names = "pixels", "radiance", "weight"
    return Observed(*(jnp.concatenate([getattr(one, name) for one in (used, held_out)]) for name in names))


def _is_fitted(used: Observed, held_out: Observed) -> Bool[np.ndarray, "p 3"]:
    fitted = np.zeros((len(used.pixels) + len(held_out.pixels), 3), bool)
    fitted[: len(used.pixels)] = True
    return fitted


def _brightness(rows: Sequence[Observed], even: Sequence[np.ndarray]) -> float:
    """The mean radiance of an even sky under which pictures would be as bright as they are."""
    shown = sum(float(np.asarray(one.radiance).sum()) for one in rows)
    made = sum(float(image.reshape(-1, 3)[np.asarray(one.pixels)].sum()) for one, image in zip(rows, even, strict=True))
    if not made > 0:
        raise InputError("the pictures show nothing that an environment lights; look at the views and the masks")
    return max(shown / made, 1e-12)


def _lamp_pictures(relighter: Relighter, lamps: Sequence[Light], seen, brightness: float, even):
    """Radiance of every picture by each lamp, times a factor by which an unknown of 1 is a bright lamp; the factors."""
    if not lamps:
        return tuple(as_array(np.zeros((0, *image.shape), np.float32)) for image in even), np.ones((0, 1))
    dark = relighter.light(None)
    base = [np.asarray(relighter.shade(dark, view).radiance) for view in seen]
    by_lamp = []
    for lamp in lamps:
        lit = relighter.light(lamp)
        by_lamp.append([np.asarray(relighter.shade(lit, v).radiance) - of for v, of in zip(seen, base, strict=True)])
    whole = brightness * sum(float(image.sum()) for image in even)
    sums = np.array([sum(float(image.sum()) for image in of) for of in by_lamp])
    scale = np.where(sums > 0, _LAMP_RANGE * whole / np.where(sums > 0, sums, 1), 1.0)
    pictures = tuple(
        as_array(np.stack([of[number] * s for of, s in zip(by_lamp, scale, strict=True)]), np.float32)
        for number in range(len(seen))
    )
    return pictures, scale[:, None]
