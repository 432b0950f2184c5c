"""Lighting by precomputed transport (Wang 2006 §4.3): light → light terms, and light terms → image."""

import functools
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.basis import latlong
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.lighting.view import MaterialPixels, View, make_view
from jaxrelight.lights.environment import Environment, coarsened, encode
from jaxrelight.operators.stacked import Stacked
from jaxrelight.transport.load import Transport, load, padded_receivers

# Light terms [receivers, k, c] of every material.
LightTerms = tuple[Float[Array, "v k c"], ...]


class Relighter:
    """Lights a precomputed scene.

    The two costs are apart: `light` is paid when the light changes, `shade` when the view changes.

        relighter = Relighter(load(folder))
        view = relighter.view(camera)
        image = relighter.shade(relighter.light(environment), view)
    """

    def __init__(self, transport: Transport):
        self.transport = transport

    @classmethod
    def open(cls, folder: str | pathlib.Path) -> "Relighter":
        """A relighter from a store."""
        return cls(load(folder))

    def light_vector(self, pixels: Float[Array, "h w 3"], rotate_y=0.0, scale=1.0) -> Float[Array, "d c"]:
        """The operator's input for a lat-long map. Pure and differentiable in all three."""
        height, width = pixels.shape[:2]
        resampling = latlong.area_resampling(height, width, self.transport.settings.resolution)
        return _light_vector(jnp.asarray(pixels), rotate_y, scale, resampling, self.transport.basis)

    def terms(self, light: Float[Array, "d c"]) -> LightTerms:
        """Light terms of a light vector: one application of the operator.

        Those of each material are followed by zeros, which nobody reads, up to one of few lengths.
        """
        operator, terms = self.transport.operator, tuple(r.terms for r in self.transport.reflections)
        if self.transport.settings.coefficients == "all":
            # Baked group by group, by compiled functions of one group.
            return _padded(_split(operator, operator.apply(light), terms))
        return _apply(operator, light, terms)

    def light(self, environment: Environment) -> LightTerms:
        """Light terms under an environment: what a change of light costs."""
        pixels = coarsened(environment.pixels, self.transport.settings.resolution)
        return self.terms(self.light_vector(jnp.asarray(pixels), environment.rotate_y, environment.scale))

    def view(self, camera: Camera | None = None) -> View:
        """A camera's view; by default the scene's camera.

        Raises:
            InputError: for another camera than the scene's where receivers are pixels.
        """
        own = self.transport.camera
        camera = camera or own
        if self.transport.settings.receivers == "pixels" and camera != own:
            raise InputError(
                "this store was precomputed for the pixels of one camera; "
                "for other views precompute with --receivers vertices"
            )
        return make_view(self.transport, camera)

    def shade(self, terms: LightTerms, view: View) -> Float[Array, "h w c"]:
        """Radiance of every pixel, 0 where no surface is seen: what a change of view costs, beside `view` itself.

        Terms are interpolated to the pixel, then closed by the view side of its own direction to the eye:
        Σ_k view_side_k · (T x)_k. Differentiable in the terms.
        """
        return shade(tuple(_view_sides(r) for r in self.transport.reflections), terms, view.materials, view.shape)

    def background(self, environment: Environment, view: View) -> Float[Array, "h w 3"]:
        """The environment in every pixel's direction."""
        return (
            _look_up(jnp.asarray(environment.pixels), *view.image_coordinates, jnp.float32(environment.rotate_y / 360))
            * environment.scale
        )

    def image(
        self, environment: Environment, view: View, terms: LightTerms | None = None, background: bool = True
    ) -> Float[np.ndarray, "h w 4"]:
        """A finished picture, RGBA: alpha 1 where a surface is seen, the environment behind unless told otherwise."""
        surface = np.asarray(self.shade(terms or self.light(environment), view))
        if background:
            surface = np.where(view.covered[..., None], surface, np.asarray(self.background(environment, view)))
        return np.concatenate([surface, view.covered[..., None]], axis=-1, dtype=np.float32)


_light_vector = jax.jit(encode)


@functools.partial(jax.jit, static_argnames="terms")
def _apply(operator: Stacked, light, terms: tuple[int, ...]) -> LightTerms:
    return _split(operator, operator.apply(light), terms)


def _split(operator: Stacked, product, terms: tuple[int, ...]) -> LightTerms:
    """The product by material."""
    parts = zip(terms, operator.starts[:-1], operator.starts[1:], strict=True)
    return tuple(product[start:end].reshape(-1, k, product.shape[1]) for k, start, end in parts)


def _padded(terms: LightTerms) -> LightTerms:
    return tuple(jnp.pad(part, ((0, padded_receivers(len(part)) - len(part)), (0, 0), (0, 0))) for part in terms)


@jax.jit
def _look_up(pixels, u, v, turn):
    return latlong.look_up(pixels, u + turn, v)


def _view_sides(reflection: Reflection) -> Reflection:
    """What the view needs of a reflection: of a fixed view only that there is one."""
    return FixedView(reflection.brdf, jnp.zeros(3)) if isinstance(reflection, FixedView) else reflection


@functools.partial(jax.jit, static_argnames="shape")
def shade(
    reflections: tuple[Reflection, ...], terms: LightTerms, materials: tuple[MaterialPixels, ...], shape
) -> Float[Array, "h w c"]:
    """Radiance of the pixels of all materials; see `Relighter.shade`."""
    height, width = shape
    channels = terms[0].shape[-1]
    image = jnp.zeros((height * width, channels), terms[0].dtype)
    for reflection, material, pixels in zip(reflections, terms, materials, strict=True):
        corners = material.at[pixels.receivers].get(mode="promise_in_bounds")
        # pixels p, corners b, terms k, channels c
        light = jnp.einsum("pb,pbkc->pkc", pixels.weights, corners, precision="highest")
        view = jax.vmap(reflection.view_side)(pixels.omega_o)
        # One-sided: nothing is seen from below the shading normal.
        radiance = jnp.where(pixels.omega_o[:, 2:] > 0, jnp.sum(view * light, axis=1), 0)
        image = image.at[pixels.pixel].set(radiance, mode="drop", unique_indices=False)
    return image.reshape(height, width, channels)
