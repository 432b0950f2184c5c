"""Materials from pictures: their parameters, how exactly the pictures tell them, and which they do not tell."""

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import Material
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.inverse.material_certainty import Estimate, certainty_of_few, certainty_of_many, is_ambiguous
from jaxrelight.inverse.material_fit import FEW, LIGHT, Problem, Scene, curvature_at, rendered, search, solve_many
from jaxrelight.inverse.material_unknowns import Coordinates, Unknown, Unknowns, unknowns_of
from jaxrelight.inverse.observations import Picture, observe, relative_residual
from jaxrelight.inverse.views import views_of
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.methods import Indirect
from jaxrelight.numerics.arrays import as_array

# What is said where nothing tells how bright the lights are.
_AMBIGUOUS = (
    "the pictures tell colours and the strength of the lights only as products: the lights are held as they are given; "
    "s times as strong, they would make the same pictures with colours divided by s"
)


@dataclasses.dataclass(frozen=True)
class InverseMaterials:
    """Materials that pictures were solved for.

    Attributes:
        materials: by name, ready for `Relighter.with_materials`. What the pictures do not tell is as it was started
            from, or as the smoothness of a texture has it.
        estimates: of each parameter, by names such as "paint.exponent": values, standard deviations, 95 % intervals.
        undetermined: names of the numbers that the pictures do not tell: those in the null space of the Jacobian, or
            known no better than by half of their range. "paint.specular[0, 2]" is one entry; of textures, how many
            texels.
        light_scale: factor on the lights that were given; None where it was not sought.
        residual: root mean square of what the fit misses, over that of the pictures, both weighted.
        held_out: the same of pixels that were not fitted; None where none were held out.
        held: what stays as it was prepared whatever the materials are, in words.
        notes: what was assumed, one line each.
        pixels: how many numbers of the pictures were fitted.
        saturated: how many were left out because they are saturated.
        pictures: as the found materials make them.
        steps: of the solver.
        converged: whether the solver came to an end by itself.
        seconds: of the whole.
    """

    materials: dict[str, Brdf | Material]
    estimates: dict[str, Estimate]
    undetermined: tuple[str, ...]
    light_scale: Estimate | None
    residual: float
    held_out: float | None
    held: tuple[str, ...]
    notes: tuple[str, ...]
    pixels: int
    saturated: int
    pictures: tuple[Float[np.ndarray, "h w 3"], ...]
    steps: int
    converged: bool
    seconds: float


def materials(
    relighter: Relighter,
    pictures: Sequence[Picture],
    views: Sequence[Any] | Camera | None = None,
    lights: Sequence[LightsLike] | LightsLike = None,
    *,
    unknowns: Mapping[str, Unknown | Brdf | Material],
    light_scale: bool = False,
    masks: Sequence[Bool[np.ndarray, "h w"] | None] | None = None,
    deviations: Sequence[Picture | float] | None = None,
    saturation: float | None = None,
    hold_out: float = 0.1,
    smoothness: float = 1e-4,
    bounces: Literal["held", "followed"] | None = None,
    seed: int = 0,
) -> InverseMaterials:
    """Solves pictures of a known scene under known lights for its materials.

    Squares of weighted differences are least. Few numbers are sought by Levenberg–Marquardt, in logarithms of exponents
    and of ratios, and in colours above 0; what pictures are linear in is solved for directly; textures by conjugate
    gradients through the picture and its adjoint, with the squared differences of neighbouring texels added. What is
    held fixed is told in the result.

    Args:
        relighter: of the scene, prepared with materials of the same kinds as those that are sought.
        pictures: linear radiance, as `read_image` gives it.
        views: of the pictures: cameras, or what `relighter.view` gives; one for all, or the scene's.
        lights: of the pictures: one for all, or for each of a list of `Lights` its own; by default the scene's.
        unknowns: materials by name; a BRDF stands for `Unknown` of it, all of whose parameters but C are sought.
        light_scale: seek a factor on all lights, too. Where pictures tell it only as a product with colours, it is held
            at 1, which the result says.
        masks: of each picture, the pixels that count.
        deviations: of each picture, the standard deviation of its pixels, for weights and intervals; without, all count
            alike, and the residual tells it.
        saturation: radiance from which a channel of a pixel is left out.
        hold_out: share of the pixels that is not fitted, and tells the fit's error.
        smoothness: of textures, relative to what the average texel's pixels tell; 0 for none.
        bounces: see `Relighter.with_materials`.
        seed: of the pixels that are held out.

    Raises:
        InputError: for unknowns, pictures or masks that do not fit the scene.
    """
    start = time.perf_counter()
    pictures = list(pictures)
    if not pictures:
        raise InputError("there are no pictures to solve for materials; give at least one")
    if not smoothness >= 0:
        raise InputError(f"smoothness is {smoothness:g}; it must be at least 0")
    sought = unknowns_of(unknowns, _follows(relighter, bounces))
    seen, lit, traced, prepared = _scene(relighter, len(pictures), views, lights, sought, bounces)
    scene = Scene(prepared, lit, seen, traced, bounces)
    blank = _rendered_alpha(scene)
    observations = observe(pictures, blank, masks, deviations, saturation, hold_out, seed)
    problem = Problem(sought, scene, observations, jnp.float32(0))
    coordinates, notes = sought.start(), []
    if light_scale:
        if any(material.emission is not None for material in prepared.materials):
            raise InputError("the strength of lights cannot be sought where surfaces emit light; leave light_scale out")
        coordinates = {**coordinates, LIGHT: as_array(0.0, np.float32)}
        if is_ambiguous(problem, coordinates):
            coordinates.pop(LIGHT)
            notes.append(_AMBIGUOUS)
    linear = sought.is_linear and LIGHT not in coordinates
    is_few = sum(part.size for part in coordinates.values()) <= FEW and not _has_textures(sought)
    if is_few and not linear:
        found = search(problem, coordinates)
        at, steps, converged = found.coordinates, found.steps, found.converged
        estimates, undetermined = certainty_of_few(problem, at, deviations is not None)
    elif is_few:
        many = solve_many(problem, coordinates, linear)
        at, steps, converged = many.coordinates, many.steps, many.converged
        estimates, undetermined = certainty_of_few(problem, at, deviations is not None)
    else:
        strength = smoothness * curvature_at(problem, coordinates)
        problem = dataclasses.replace(problem, smoothness=jnp.float32(strength))
        many = solve_many(problem, coordinates, linear)
        at, steps, converged = many.coordinates, many.steps, many.converged
        estimates, undetermined = certainty_of_many(problem, many, deviations is not None)
    at = _with_undetermined_as_started(sought, coordinates, at, estimates)
    final = [np.asarray(picture) for picture in rendered(problem, at)]
    residual = relative_residual(observations.used, final)
    return InverseMaterials(
        materials=_as_given(sought, at, unknowns),
        estimates={key: one for key, one in estimates.items() if key != LIGHT},
        undetermined=undetermined,
        light_scale=estimates.get(LIGHT),
        residual=math.nan if residual is None else residual,
        held_out=relative_residual(observations.held_out, final),
        held=prepared.held,
        notes=tuple(notes),
        pixels=observations.count,
        saturated=observations.saturated,
        pictures=tuple(final),
        steps=steps,
        converged=converged,
        seconds=time.perf_counter() - start,
    )


def _follows(relighter: Relighter, bounces: str | None) -> bool:
    """Whether pictures are products of several albedos."""
    return isinstance(relighter.method, Indirect) and bounces != "held"


def _scene(
    relighter: Relighter,
    count: int,
    views: Sequence[Any] | Camera | None,
    lights: Sequence[LightsLike] | LightsLike,
    unknowns: Unknowns,
    bounces: Literal["held", "followed"] | None,
) -> tuple[tuple, tuple, tuple, Relighter]:
    """Views, lights and what is traced of both for every picture, and the relighter with the materials of the start."""
    prepared = relighter.with_materials(unknowns.materials(unknowns.start()), bounces=bounces)
    seen = views_of(relighter, views, count)
    if isinstance(lights, list | tuple) and lights and all(isinstance(one, Lights) for one in lights):
        if len(lights) != count:
            raise InputError(f"{len(lights)} lights were given for {count} pictures; give one for each, or one for all")
        lit = tuple(prepared.light(one) for one in lights)
    else:
        given: Any = lights
        one = relighter.scene_lights() if lights is None else as_lights(given)
        if not one:
            raise InputError("the scene has no lights of its own; give those of the pictures")
        lit = (prepared.light(one),) * count
    return seen, lit, tuple(prepared.trace(*pair) for pair in zip(lit, seen, strict=True)), prepared


def _rendered_alpha(scene: Scene) -> list[Float[np.ndarray, "h w"]]:
    parts = zip(scene.lit, scene.views, scene.traced, strict=True)
    return [np.asarray(scene.relighter.shade(lit, view, traced).alpha) for lit, view, traced in parts]


def _has_textures(unknowns: Unknowns) -> bool:
    return any(one.is_texture for one in unknowns.parameters)


def _with_undetermined_as_started(
    unknowns: Unknowns, start: Coordinates, at: Coordinates, estimates: dict[str, Estimate]
) -> Coordinates:
    """What was found, colours at least 0, what nothing tells as it was started from; textures are smooth there."""
    kept = dict(at)
    for one in unknowns.parameters:
        values = at[one.key]
        if not one.is_texture:
            values = jnp.where(as_array(estimates[one.key].determined), values, start[one.key])
        kept[one.key] = jnp.maximum(values, 0) if one.form == "linear" else values
    return kept


def _as_given(
    unknowns: Unknowns, at: Coordinates, given: Mapping[str, Unknown | Brdf | Material]
) -> dict[str, Brdf | Material]:
    """Materials as they were started from: a BRDF where that was one, and no texture is sought."""
    found: dict[str, Brdf | Material] = {}
    for name, material in jax.tree.map(as_array, unknowns.materials(at)).items():
        own = given[name]
        start, textures = (own.start, own.textures) if isinstance(own, Unknown) else (own, {})
        plain = isinstance(start, Brdf) and not textures
        found[name] = material.components[0].brdf if plain else material
    return found
