"""An environment from pictures of a known scene, and what the pictures tell of it."""

import dataclasses
import math
import time
from collections.abc import Sequence
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.inverse.bidiagonalisation import Bidiagonal, begin, step
from jaxrelight.inverse.lamp_unknowns import brightened
from jaxrelight.inverse.light_certainty import LightCertainty, LightEstimate, certainty_of
from jaxrelight.inverse.light_grid import LightGrid, light_grid
from jaxrelight.inverse.light_problem import LightProblem, adjoint, applied, rendered, right_side, weights_of
from jaxrelight.inverse.light_solve import (
    STRENGTHS,
    Constraint,
    Spectrum,
    constrained,
    is_converged,
    ridge_weights,
    spectrum_of,
)
from jaxrelight.inverse.observations import Observed, Picture, observe
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.lights.local import Light
from jaxrelight.methods import Indirect
from jaxrelight.numerics.arrays import as_array
from jaxrelight.progress import Report

# Steps between two looks at whether more would change anything; what the solution may still move, and what held-out
# pixels may still gain.
_LOOK_EVERY, _SOLVED, _GAIN = 8, 3e-3, 2e-3
# Strengths that are tried of what is sparse, relative to what makes all coefficients 0, and of the ridge below what is
# best for a light of any sign.
_SPARSITIES, _WEAKER = tuple(np.geomspace(0.1, 1e-6, 11)), (1.0, 0.3, 0.1)
# The strongest ridge is taken under which pixels that are held out are missed by so much more than under the best: what
# a model misses is alike in neighbouring pixels, so that the best is too weak a ridge for other views.
_AS_GOOD = 1.03
# How often pixels at the top of a picture's range are given what the light of the moment makes of them.
_SATURATED_ROUNDS = 12
# Factors on lamps and exposures may be so many times what would make pictures as bright as they are.
_LAMP_RANGE, _EXPOSURE_RANGE = 10.0, 3.0


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
    grid, pictures = light_grid(unknowns), list(pictures)
    if not pictures:
        raise InputError("there are no pictures to solve for light; give at least one")
    linear = _linear(relighter)
    known = as_lights(lamps)
    if known.environment is not None:
        raise InputError("lamps are local lights; the environment is what is sought")
    seen, traced, alphas, means = _seen(linear, len(pictures), views)
    # What is at the top of a range counts, as a lower bound.
    observed = observe(pictures, alphas, masks, deviations, None, hold_out, seed)
    rows = tuple(_joined(*pair) for pair in zip(observed.used, observed.held_out, strict=True))
    fitted = np.concatenate([_is_fitted(*pair) for pair in zip(observed.used, observed.held_out, strict=True)])
    brightness = _brightness(rows, means)
    free = tuple(exposures != "known" and number > 0 for number in range(len(pictures)))
    spread = grid.spectrum * brightness * grid.basis.resolution
    by_lamp, lamp_scale = _lamp_pictures(linear, known.local, seen, brightness, means)
    problem = LightProblem(
        linear, seen, traced, grid, as_array(spread), by_lamp, rows, free, joint=exposures == "exposure"
    )
    solver = _Solver(problem, fitted, grid, spread, report, max_steps)
    solver.run(strength)
    notes = []
    if any(free):
        notes.append("the first picture's exposure is taken as it is given: it fixes the scale of the light")
    z, chosen = solver.solution(prior, strength, not_negative=not_negative)
    top = _at_the_top(rows, saturation) & fitted
    if top.any():
        z = solver.with_lower_bounds(z, top, prior, chosen, not_negative=not_negative)
    texels, factors, divisors = (np.asarray(part) for part in problem.split(jnp.asarray(z, jnp.float32)))
    factors = factors * lamp_scale
    texels = np.maximum(texels, 0) if not_negative else texels
    scales = _exposures(divisors, free, problem.joint)
    images = rendered(problem, jnp.asarray(texels), jnp.asarray(factors / lamp_scale, jnp.float32))
    image_rows = np.concatenate([np.asarray(one.rendered(image)) for one, image in zip(rows, images, strict=True)])
    shown_by = np.concatenate([np.broadcast_to(s, one.radiance.shape) for s, one in zip(scales, rows, strict=True)])
    weights, shown = weights_of(rows), np.concatenate([np.asarray(one.radiance) for one in rows])
    missed = (image_rows * shown_by - shown) * weights
    missed[top] = np.minimum(missed[top], 0)
    noise = np.sqrt(np.mean(missed[_judged(fitted)] ** 2, axis=0))
    certainty = certainty_of(solver.state, solver.spectrum, grid, spread, chosen, np.maximum(noise, 1e-12))
    return InverseLight(
        environment=Environment(np.maximum(np.asarray(grid.pixels(jnp.asarray(texels))), 0)),
        texels=texels,
        lamps=tuple(brightened(lamp, factor) for lamp, factor in zip(known.local, factors, strict=True)),
        lamp_factors=factors,
        exposures=scales,
        certainty=certainty,
        residual=_relative(missed, shown * weights, fitted),
        held_out=_relative(missed, shown * weights, ~fitted) if (~fitted).any() else None,
        strength=chosen,
        singular_values=solver.spectrum.values,
        applications=solver.applications,
        pixels=observed.count,
        saturated=int(top.sum()),
        pictures=tuple(np.asarray(image) * scale for image, scale in zip(images, scales, strict=True)),
        notes=tuple(notes),
        seconds=time.perf_counter() - start,
    )


class _Solver:
    """The bidiagonalisation of a problem, with what its vectors make of pixels that are held out."""

    def __init__(
        self,
        problem: LightProblem,
        fitted: Bool[np.ndarray, "n 3"],
        grid: LightGrid,
        spread: Float[np.ndarray, " d"],
        report: Report | None,
        max_steps: int,
    ):
        self.problem, self.fitted, self.grid, self.spread = problem, fitted, grid, spread
        self.report, self.max_steps = report, max_steps
        self.b, self.held, self.applications = right_side(problem), [], 0
        self.judged = _judged(fitted)
        self.state = begin(np.where(fitted, self.b, 0), self._adjoint, joint=problem.joint)
        self.spectrum = Spectrum(np.zeros((0, 3)), np.zeros((0, 0, 3)), np.zeros((0, 3)))

    def _adjoint(self, numbers: np.ndarray) -> np.ndarray:
        return np.asarray(adjoint(self.problem, as_array(np.where(self.fitted, numbers, 0), np.float32)))

    def product(self, z: np.ndarray) -> Float[np.ndarray, "n 3"]:
        """A z, of all pixels."""
        self.applications += 1
        return np.asarray(applied(self.problem, as_array(z, np.float32)))

    def run(self, strength: float | None) -> None:
        """As many steps as change the light that is found, or what it makes of the pixels that are held out."""
        best = math.inf
        while not self.state.is_done and self.state.steps < self.max_steps:
            image = self.product(self.state.next_vector)
            self.held.append(image[self.judged].reshape(-1, 3))
            self.state = step(self.state, np.where(self.fitted, image, 0), self._adjoint)
            if self.report is not None:
                self.report("light", self.state.steps, self.max_steps)
            if self.state.steps % _LOOK_EVERY:
                continue
            self.spectrum = spectrum_of(self.state)
            chosen = strength or self.best_strength()
            error = self._judgement(ridge_weights(self.spectrum, chosen))
            solved = is_converged(self.state, ridge_weights(self.spectrum, chosen), _SOLVED).all()
            # What pictures tell is known once a vector was found that they do not tell.
            told = (self.spectrum.values.min(axis=0) > chosen).any()
            if solved and not told and error > (1 - _GAIN) * best:
                break
            best = min(best, error)
        self.spectrum = spectrum_of(self.state)
        if self.report is not None:
            self.report("light", self.max_steps, self.max_steps)

    def best_strength(self) -> float:
        """The strongest ridge under which pixels that are held out are met about as well as they can be."""
        tried = STRENGTHS * self.spectrum.values.max(initial=1e-30)
        errors = np.array([self._judgement(ridge_weights(self.spectrum, one)) for one in tried])
        return float(tried[np.flatnonzero(errors <= _AS_GOOD**2 * errors.min())[-1]])

    def _judgement(self, weights: Float[np.ndarray, "k c"]) -> float:
        made = sum(held * of[None] for held, of in zip(self.held, weights, strict=True))
        return float(np.sum((made - self.b[self.judged].reshape(-1, 3)) ** 2))

    def solution(
        self, prior: str, strength: float | None, *, not_negative: bool
    ) -> tuple[Float[np.ndarray, "m 3"], float]:
        """The unknowns under a prior, and the best ridge without a constraint, by which what is told is judged."""
        chosen = strength or self.best_strength()
        plain = self.state.mixed(ridge_weights(self.spectrum, chosen))
        gradient = self.state.gradient()
        best, found = math.inf, plain
        for constraint, ridge in self._candidates(prior, chosen, gradient, strength is not None, not_negative):
            if not constraint.is_any:
                return plain, chosen
            z = constrained(self.state, gradient, ridge, constraint, plain)
            error = float(np.sum((self.product(z) - self.b)[self.judged] ** 2))
            if error * _AS_GOOD**2 >= best:
                break
            best, found = error, z
        return found, chosen

    def _candidates(self, prior: str, chosen: float, gradient: np.ndarray, is_given: bool, not_negative: bool):
        lamps = self.problem.lamp_count
        if prior == "natural":
            # What may not be negative is regularised by that, too.
            factors = _WEAKER if not_negative and not is_given else _WEAKER[:1]
            return [(Constraint(self.grid, self.spread, lamps, not_negative), factor * chosen) for factor in factors]
        largest = np.abs(gradient[: self.grid.size]).max()
        ridge = chosen * 0.1
        every = [Constraint(self.grid, self.spread, lamps, not_negative, share * largest) for share in _SPARSITIES]
        return [(constraint, ridge) for constraint in every]

    def with_lower_bounds(
        self, z: np.ndarray, top: Bool[np.ndarray, "n 3"], prior: str, ridge: float, *, not_negative: bool
    ) -> np.ndarray:
        """The unknowns where some pixels are only known to be at least as bright as they are.

        Each round takes as seen there what the light of the moment makes, where that is more.
        """
        constraint = Constraint(self.grid, self.spread, self.problem.lamp_count, not_negative)
        for _ in range(_SATURATED_ROUNDS):
            made = self.product(z)
            b = np.where(top, np.maximum(self.b, made), self.b)
            gradient = np.asarray(self._adjoint(b), float)
            if constraint.is_any:
                new = constrained(self.state, gradient, ridge, constraint, z)
            else:
                new = _ridge_of(self.state, gradient, ridge)
            moved = np.linalg.norm(new - z) / max(np.linalg.norm(new), 1e-30)
            z = new
            if moved < 1e-3:
                break
        return z


def _ridge_of(state: Bidiagonal, gradient: np.ndarray, ridge: float) -> np.ndarray:
    """(V BᵀB Vᵀ + ridge²)⁻¹ of a gradient, in the span of V."""
    shares = np.stack([np.einsum("mc,mc->c", v, gradient) for v in state.V])
    if state.joint:
        shares = np.broadcast_to(shares.sum(axis=1, keepdims=True), shares.shape)
    weights = np.zeros_like(shares)
    for channel in range(shares.shape[1]):
        B = state.matrix(channel)
        weights[:, channel] = np.linalg.solve(B.T @ B + ridge**2 * np.eye(B.shape[1]), shares[:, channel])
    return state.mixed(weights)


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


def _linear(relighter: Relighter) -> Relighter:
    """The relighter whose pictures are linear in the environment."""
    if isinstance(relighter.method, Indirect) and not relighter.method.sky:
        raise InputError(
            "a relighter for local lights draws an environment anew for each light; prepare with Indirect(sky=True)"
        )
    if isinstance(relighter, TransportRelighter) and relighter.method.split_sun:
        method = dataclasses.replace(relighter.method, split_sun=False)
        return TransportRelighter(dataclasses.replace(relighter.transport, method=method))
    return relighter


def _seen(relighter: Relighter, count: int, views: Sequence[Any] | Camera | None):
    """Views, what is traced under an even sky, coverage, and the pictures under that sky."""
    by_picture = list(views) if isinstance(views, list | tuple) else [views] * count
    if len(by_picture) != count:
        raise InputError(f"{len(by_picture)} views were given for {count} pictures; give one for each, or one for all")
    kept: dict[int, Any] = {}
    seen = []
    for one in by_picture:
        if one is None or isinstance(one, Camera):
            if id(one) not in kept:
                kept[id(one)] = relighter.view(one)
            one = kept[id(one)]
        seen.append(one)
    lit = relighter.light(Environment(np.ones((32, 64, 3), np.float32)))
    traced = tuple(relighter.trace(lit, view) for view in seen)
    images = [relighter.shade(lit, view, of) for view, of in zip(seen, traced, strict=True)]
    return tuple(seen), traced, [np.asarray(image.alpha) for image in images], [np.asarray(i.radiance) for i in images]


def _joined(used: Observed, held_out: Observed) -> Observed:
    """Both, one after the other."""
    return Observed(
        *(jnp.concatenate([getattr(used, name), getattr(held_out, name)]) for name in ("pixels", "radiance", "weight"))
    )


def _is_fitted(used: Observed, held_out: Observed) -> Bool[np.ndarray, "p 3"]:
    fitted = np.zeros((len(used.pixels) + len(held_out.pixels), 3), bool)
    fitted[: len(used.pixels)] = True
    return fitted


def _judged(fitted: Bool[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """The rows that judge a fit: those that are held out; all, where none are."""
    held_out = np.logical_not(fitted.any(axis=1))
    return held_out if held_out.any() else np.logical_not(held_out)


def _brightness(rows: Sequence[Observed], even: Sequence[np.ndarray]) -> float:
    """The mean radiance of an even sky under which pictures would be as bright as they are."""
    shown = sum(float(np.asarray(one.radiance).sum()) for one in rows)
    made = sum(float(image.reshape(-1, 3)[np.asarray(one.pixels)].sum()) for one, image in zip(rows, even, strict=True))
    if not made > 0:
        raise InputError("the pictures show nothing that an environment lights; look at the views and the masks")
    return max(shown / made, 1e-12)


def _lamp_pictures(relighter: Relighter, lamps: Sequence[Light], seen, brightness: float, even):
    """Radiance of every picture by each lamp, times a factor on all by which it is as bright as what is sought."""
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


def _at_the_top(rows: Sequence[Observed], saturation: float | None) -> Bool[np.ndarray, "n 3"]:
    shown = np.concatenate([np.asarray(one.radiance) for one in rows])
    return np.zeros(shown.shape, bool) if saturation is None else shown >= saturation


def _relative(missed: np.ndarray, shown: np.ndarray, chosen: np.ndarray) -> float:
    return float(np.sqrt(np.sum(missed[chosen] ** 2) / max(np.sum(shown[chosen] ** 2), 1e-30)))
