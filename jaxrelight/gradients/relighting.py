"""Entries of the lighting methods in `jaxrelight.lighting`: from light and materials to a picture."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf.lobes import lambert, phong
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.mesh import transformed
from jaxrelight.geometry.primitives import box, plane
from jaxrelight.gradients.entry import Entries, Entry, Example, named
from jaxrelight.gradients.examples import numbers, scalar
from jaxrelight.lighting.light_layers import LightLayers
from jaxrelight.lighting.prepare import prepare
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.local import point
from jaxrelight.methods import Adaptive, Indirect, Method, Prefiltered, Transport
from jaxrelight.scene.scene import Part, Scene

_LAMP = 0.3, 1.5, 0.8
_LIGHT = "all numbers of lights: pixels, rotate_y and scale of the environment, and those of local lights"
_FIXED = "visibility and shadows, kept coefficients, quantised codes, what is taken as the sun"
_KINKS = "as of `texels_of`, `Point.at` and the other lights"
_NAN = "a NaN in the environment is looked for as a sun is, or does not reach the pixels that are shown"


@functools.cache
def _prepared(method: Method) -> Any:
    """A block over a floor, its view, and shadows of a lamp, all in single precision."""
    matrix = np.eye(4)
    matrix[:3, 3] = 0.1, 0.4, 0.0
    parts = [Part(plane((2, 2), 2), "paper"), Part(transformed(box((0.7, 0.6, 0.5), 1), matrix), "gloss")]
    camera = Camera((0.5, 1.1, 1.3), (0.1, 0.3, 0), fov_y=50, width=6, height=4)
    # It is kept, so it must not be made of what is being traced.
    with jax.ensure_compile_time_eval(), jax.enable_x64(False):
        scene = Scene(parts, {"paper": lambert([0.7, 0.6, 0.5]), "gloss": phong(0.2, 0.3, 6.0)}, camera)
        relighter = prepare(scene, method)
        view = relighter.view()
        pixels = np.ones((8, 16, 3), np.float32)
        traced = relighter.trace(relighter.light([Environment(pixels), point(_LAMP, 1.0)]), view)
        return jax.tree.map(np.asarray, (relighter, view, traced))


def _as(method: Method, dtype: Any) -> Any:
    """What is prepared, of a type."""

    def converted(leaf):
        return jax.device_put(leaf.astype(dtype) if np.issubdtype(leaf.dtype, np.floating) else leaf)

    with jax.ensure_compile_time_eval():
        return jax.tree.map(converted, _prepared(method))


def _picture(method: Method, pixels, turn, scale, intensity):
    """The picture and what is behind it."""
    relighter, view, traced = _as(method, pixels.dtype)
    lit = relighter.light([Environment(pixels, turn, scale), point(_LAMP, intensity)])
    return relighter.shade(lit, view, traced).radiance, relighter.background(lit, view)


def _example(method: Method) -> Example:
    light = numbers(8, 16, 3), scalar(13.0), scalar(1.5), numbers(3)
    return Example(functools.partial(_picture, method), light, along=(light[0], scalar(1), scalar(1), light[3]))


def _of_materials(method: Method, albedo, specular, exponent):
    """The picture of other materials."""
    relighter, view, traced = _as(method, albedo.dtype)
    other = relighter.with_materials({"paper": lambert(albedo), "gloss": phong(0.5 * albedo, specular, exponent)})
    lit = other.light([Environment(jnp.asarray(numbers(8, 16, 3), albedo.dtype)), point(_LAMP, albedo)])
    return other.shade(lit, view, traced).radiance


@functools.cache
def _layers() -> LightLayers:
    """Of two lamps."""
    with jax.ensure_compile_time_eval(), jax.enable_x64(False):
        return LightLayers(_as(_TRANSPORT, np.float32)[0], [point(_LAMP, 1.0), point((-0.5, 1.2, 0.9), 2.0)])


_TRANSPORT = Transport(resolution=4, coefficients=40)
_VERTICES = Transport(receivers="vertices", resolution=4, coefficients=40)
_INDIRECT = Indirect(gather_samples=64, sky_samples=4, bounces=1)
_OF_TRANSPORT = "jaxrelight.lighting.transport"

ENTRIES: Entries = (
    Entry(
        (
            *named(_OF_TRANSPORT, "TransportRelighter.light TransportRelighter.shade TransportRelighter.background"),
            *named(_OF_TRANSPORT, "TransportRelighter.light_vector TransportRelighter.terms"),
            *named(_OF_TRANSPORT, "TransportRelighter.light_many TransportRelighter.direct_terms"),
            *named(_OF_TRANSPORT, "TransportRelighter.shade_terms"),
            *named("jaxrelight.lighting.contract", "image_of"),
            *named("jaxrelight.lighting.direct_light", "shade_lights at_texel"),
            *named("jaxrelight.lighting.light_terms", "light_terms with_emitted"),
            *named("jaxrelight.lighting.shadows", "sum_over_lights"),
            *named("jaxrelight.lighting.sun", "sun_terms"),
            *named("jaxrelight.lighting.transport_view", "in_picture image_of_samples"),
            *named("jaxrelight.lighting.visible_surfaces", "emitted VisibleSurfaces.image VisibleSurfaces.emission"),
            *named("jaxrelight.lighting.visible_surfaces", "VisibleSurfaces.background"),
        ),
        differentiable_in=_LIGHT,
        example=lambda: _example(_TRANSPORT),
        fixed=_FIXED,
        kinks=_KINKS,
        nan=_NAN,
    ),
    Entry(
        (
            *named(_OF_TRANSPORT, "TransportRelighter.shade_lobes"),
            *named("jaxrelight.lighting.filtered_reflection", "filtered_radiance"),
        ),
        differentiable_in=_LIGHT,
        example=lambda: _example(_VERTICES),
        fixed=_FIXED,
        kinks=_KINKS,
        nan=_NAN,
    ),
    Entry(
        (
            *named(_OF_TRANSPORT, "TransportRelighter.with_materials TransportRelighter.relit"),
            *named(_OF_TRANSPORT, "TransportRelighter.rebake TransportRelighter.replace_lobes"),
        ),
        differentiable_in="all numbers of materials",
        example=lambda: Example(functools.partial(_of_materials, _TRANSPORT), (numbers(3), scalar(0.3), scalar(6.0))),
        fixed=_FIXED,
        kinks="as of the BRDFs",
    ),
    Entry(
        named("jaxrelight.lighting.light_layers", "LightLayers.picture LightLayers.move"),
        differentiable_in="gains; linear",
        example=lambda: Example(lambda gains: _layers().picture(gains), (numbers(2, 3),)),
        orders=2,
        fixed="the pictures of each light alone",
        dtypes="that of the pictures",
    ),
    Entry(
        (
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.light IndirectRelighter.shade"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.direct_light_at_cloud"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.irradiance_at_cloud add_irradiance"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.sky_light IndirectRelighter.add_bounces"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.final_gather IndirectRelighter.layers"),
            *named("jaxrelight.lighting.indirect", "IndirectRelighter.background IndirectRelighter.reflected_once"),
        ),
        differentiable_in=f"{_LIGHT}; albedos of the cloud",
        example=lambda: _example(_INDIRECT),
        fixed=f"{_FIXED}; the cloud of points and the links",
        kinks=_KINKS,
        nan=_NAN,
    ),
    Entry(
        named("jaxrelight.lighting.indirect", "IndirectRelighter.with_materials IndirectRelighter.relit"),
        differentiable_in="all numbers of materials",
        example=lambda: Example(functools.partial(_of_materials, _INDIRECT), (numbers(3), scalar(0.3), scalar(6.0))),
        fixed=f"{_FIXED}; the cloud of points and the links",
        kinks="as of the BRDFs",
    ),
    Entry(
        (
            *named("jaxrelight.lighting.prefiltered", "PrefilteredRelighter.light PrefilteredRelighter.shade"),
            *named("jaxrelight.lighting.prefiltered", "PrefilteredRelighter.background shade_environment"),
            *named("jaxrelight.lighting.prefiltered", "prefiltered_radiance"),
        ),
        differentiable_in=_LIGHT,
        example=lambda: _example(Prefiltered()),
        fixed=_FIXED,
        kinks=f"{_KINKS}; as of `PrefilteredMaps.look_up`",
        nan=_NAN,
    ),
    Entry(
        named("jaxrelight.lighting.prefiltered", "PrefilteredRelighter.with_materials"),
        differentiable_in="all numbers of materials",
        example=lambda: Example(
            functools.partial(_of_materials, Prefiltered()), (numbers(3), scalar(0.3), scalar(6.0))
        ),
        fixed=_FIXED,
        kinks="as of the BRDFs",
    ),
    Entry(
        (
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.light AdaptiveRelighter.shade"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.shade_plan"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.shade_uniform"),
            *named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.background"),
            *named("jaxrelight.lighting.adaptive.estimate", "estimate estimate_listed"),
            *named("jaxrelight.lighting.adaptive.hierarchy", "Hierarchy.interpolate"),
            *named("jaxrelight.lighting.adaptive.sampled_brdf", "SampledBrdf.towards BrdfSampler.draw"),
            *named("jaxrelight.lighting.adaptive.sampled_brdf", "BrdfSampler.direction BrdfSampler.weighed"),
        ),
        differentiable_in=_LIGHT,
        example=lambda: _example(Adaptive()),
        fixed="where samples are taken, how many, and the directions that are drawn; what is taken as the sun",
        kinks=_KINKS,
        nan=_NAN,
    ),
    Entry(
        named("jaxrelight.lighting.adaptive.relighter", "AdaptiveRelighter.with_materials"),
        differentiable_in="all numbers of materials",
        example=lambda: Example(
            functools.partial(_of_materials, Adaptive()),
            (numbers(3), scalar(0.3), scalar(6.0)),
            # Where all albedos grow alike, directions are drawn as before.
            along=(numbers(3), scalar(0.3), scalar(0)),
        ),
        fixed="where samples are taken, how many, and the directions that are drawn",
        kinks="as of the BRDFs",
    ),
)
