"""Lighting by precomputed transport (Wang 2006 §4.3): light → light terms, and light terms → image."""

import pathlib
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.basis import latlong
from jaxrelight.basis.cubemap import Texels
from jaxrelight.brdf.outgoing import outgoing
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.brdf.texture import Weight
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.lighting.pixels import assembled
from jaxrelight.lighting.sun import sun_terms
from jaxrelight.lighting.view import MaterialPixels, View, make_view
from jaxrelight.lights.environment import Environment, coarsened, encode
from jaxrelight.lights.sun import split_sun
from jaxrelight.operators.algebra import Summed, parts_of
from jaxrelight.operators.clustered import Clustered
from jaxrelight.operators.contract import Operator
from jaxrelight.operators.sparse_rows import SparseRows
from jaxrelight.precomputation.load import load
from jaxrelight.transport.compression import padded_receivers
from jaxrelight.transport.model import Block, Transport

# Light terms [receivers, k, c] of every block of the operator; with a leading axis where they are of many lights.
LightTerms = tuple[Float[Array, "*n v k c"], ...]


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

    def light_vector(self, pixels: Float[Array | np.ndarray, "h w 3"], rotate_y=0.0, scale=1.0) -> Float[Array, "d c"]:
        """The operator's input for a lat-long map. Pure and differentiable in all three."""
        height, width = pixels.shape[:2]
        resampling = latlong.area_resampling(height, width, self.transport.settings.resolution)
        return encode(pixels, rotate_y, scale, resampling, self.transport.basis)

    def terms(self, light: Float[Array, "*n d c"]) -> LightTerms:
        """Light terms of a light vector: one application of the operator.

        Those of a block are followed by zeros, which nobody reads, up to one of few lengths, so that another scene of
        about the same size compiles nothing new. Of n light vectors, terms are [n, v, k, c], by one product for all,
        which is compiled anew for every n: with clusters, it costs less than one after the other.
        """
        each = self.transport.each
        return tuple(_with_emitted(_terms(operator, light, block), block) for block, operator in each)

    def light(self, environment: Environment, split_sun: bool = True) -> LightTerms:
        """Light terms under an environment: what a change of light costs.

        Args:
            environment: the light.
            split_sun: integrate the few texels of a sun, where there is one, by themselves, with a shadow ray from
                every receiver to each; what they bounce comes from the operator like all else. What is compressed is
                farthest off under a sun. As it is found by how much it outshines the rest, terms are linear in the
                light only to within what compression leaves out; without this they are linear.
        """
        transport = self.transport
        if transport.settings.coefficients == "all" or not split_sun:
            return self.terms(self._light_vector_of(environment))
        pixels = coarsened(environment.pixels, transport.settings.resolution)
        resampling = latlong.area_resampling(*pixels.shape[:2], transport.settings.resolution)
        arguments = pixels, environment.rotate_y, environment.scale, resampling, transport.basis
        rest, sun, texels, radiance = _split(*arguments)
        terms, radiance = self.terms(rest), np.asarray(radiance)
        if not radiance.any():
            return terms
        found = list(sun_terms(transport, np.asarray(texels), radiance))
        for number, (block, operator) in enumerate(transport.each):
            for bounced in parts_of(operator)[1:]:
                found[number] += _terms(bounced, sun, block)
        return tuple(part + more for part, more in zip(terms, found, strict=True))

    def light_many(self, environments: Sequence[Environment]) -> LightTerms:
        """Light terms [n, v, k, c] under each of n environments, all at once; no sun is split off.

        Those of the i-th, to be shaded, are `tuple(part[i] for part in terms)`.
        """
        return self.terms(jnp.stack([self._light_vector_of(one) for one in environments]))

    def _light_vector_of(self, environment: Environment) -> Float[Array, "d c"]:
        pixels = coarsened(environment.pixels, self.transport.settings.resolution)
        return self.light_vector(pixels, environment.rotate_y, environment.scale)

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

    def shade(self, terms: LightTerms, view: View, weights: tuple[Weight, ...] | None = None) -> Float[Array, "h w c"]:
        """Radiance of every pixel, 0 where no surface is seen: what a change of view costs, beside `view` itself.

        Terms are interpolated to the pixel, then closed by the view side of its own direction to the eye and by the
        weights at its texture coordinates: Σ_b w_b Σ_k view_side_bk · (T_b x)_k. Differentiable in terms and weights.

        Args:
            terms: from `light`.
            view: from `view`.
            weights: of the transport's blocks; by default those that they have.
        """
        blocks = self.transport.blocks
        reflections = tuple(_view_sides(block.reflection) for block in blocks)
        weights = tuple(block.weight for block in blocks) if weights is None else weights
        image = shade(reflections, weights, terms, view)
        for block, pixels in zip(blocks, view.materials, strict=True):
            if block.emission is not None:
                image = _add_emission(image, jnp.asarray(block.emission), pixels)
        return image

    def background(self, environment: Environment, view: View) -> Float[Array, "h w 3"]:
        """The environment in every pixel's direction."""
        u, v = view.image_coordinates
        return _look_up(environment.pixels, u, v, np.float32(environment.rotate_y / 360), environment.scale)

    def image(
        self, environment: Environment, view: View, terms: LightTerms | None = None, background: bool = True
    ) -> Float[np.ndarray, "h w 4"]:
        """A finished picture, RGBA: alpha 1 where a surface is seen, the environment behind unless told otherwise."""
        surface = np.asarray(self.shade(terms or self.light(environment), view))
        if background:
            surface = np.where(view.covered[..., None], surface, np.asarray(self.background(environment, view)))
        return np.concatenate([surface, view.covered[..., None]], axis=-1, dtype=np.float32)


@jax.jit
def _split(pixels, rotate_y, scale, resampling, basis):
    """Light vectors of an environment without its sun, and of the sun; its texels and their radiance."""
    split = split_sun(encode(pixels, rotate_y, scale, resampling, Texels(basis.resolution)))
    rest, sun = basis.encode(jnp.stack([split.rest.T, split.sun.T]))
    return rest.T, sun.T, split.texels, split.radiance


def _terms(operator: Operator, light: Float[Array, "*n d c"], block: Block) -> Float[Array, "*n v k c"]:
    """One block's light terms of a light or many, compiled unless the operator reads a store as it goes."""
    receivers = padded_receivers(len(block.groups) * GROUP)
    if isinstance(operator, Summed):
        first, *others = (_terms(part, light, block) for part in operator.operators)
        return sum(others, first)
    if isinstance(operator, SparseRows):
        return _compiled_terms(operator.with_filling(), light, receivers, block.reflection.terms)
    if isinstance(operator, Clustered):
        filled = operator.with_filling(receivers // GROUP)
        return _compiled_terms(filled, light, receivers, block.reflection.terms)
    return _product(operator, light, receivers, block.reflection.terms)


def _with_emitted(terms: Float[Array, "v k c"], block: Block) -> Float[Array, "v k c"]:
    """Light terms of the sky, and of what surfaces emit."""
    if block.emitted is None:
        return terms
    more = terms.shape[-3] - len(block.emitted)
    return terms + np.pad(block.emitted, ((0, more), (0, 0), (0, 0)))


@jax.jit
def _add_emission(image: Float[Array, "h w c"], emission: Float[Array, " c"], pixels: MaterialPixels):
    h, w, c = image.shape
    radiance = jnp.where(pixels.omega_o[:, 2:] > 0, emission, 0)
    return image.reshape(h * w, c).at[pixels.pixel].add(radiance, mode="drop").reshape(h, w, c)


def _product(operator: Operator, light: Float[Array, "*n d c"], receivers: int, terms: int) -> Float[Array, "*n v k c"]:
    """The product, its rows by receiver; cut, or followed by zeros, to a number of receivers."""
    found = operator.apply(light) if light.ndim == 2 else operator.apply_many(light)
    more = max(receivers * terms - found.shape[-2], 0)
    found = jnp.pad(found, [*[(0, 0)] * (found.ndim - 2), (0, more), (0, 0)])[..., : receivers * terms, :]
    return found.reshape(*found.shape[:-2], receivers, terms, found.shape[-1])


_compiled_terms = jax.jit(_product, static_argnames=("receivers", "terms"))


@jax.jit
def _look_up(pixels, u, v, turn, scale):
    return latlong.look_up(pixels, u + turn, v) * scale


def _view_sides(reflection: Reflection) -> Reflection:
    """What the view needs of a reflection: of a fixed view only that there is one."""
    return FixedView(reflection.brdf, jnp.zeros(3)) if isinstance(reflection, FixedView) else reflection


def shade(
    reflections: tuple[Reflection, ...],
    weights: tuple[Weight, ...],
    terms: LightTerms,
    view: View,
) -> Float[Array, "h w c"]:
    """Radiance of the pixels of all blocks; see `Relighter.shade`.

    Each block is compiled by itself: as the view moves, every block's number of pixels changes on its own.
    """
    parts: dict[int, Array] = {}
    for number, *block in zip(view.part_of_block, reflections, weights, terms, strict=True):
        parts[number] = _radiance(*block, view.parts[number], parts.get(number))
    return assembled([parts[number] for number in range(len(view.parts))], view.place, view.shape)


@jax.jit
def _radiance(
    reflection: Reflection,
    weight: Weight,
    terms: Float[Array, "v k c"],
    pixels: MaterialPixels,
    others: Float[Array, "p c"] | None,
) -> Float[Array, "p c"]:
    corners = terms.at[pixels.receivers].get(mode="promise_in_bounds")
    # pixels p, corners b, terms k, channels c
    light = jnp.einsum("pb,pbkc->pkc", pixels.weights, corners, precision="highest")
    view = outgoing(reflection, weight, pixels.omega_o, pixels.uv, pixels.footprint)
    radiance = jnp.sum(view * light, axis=1)
    return radiance if others is None else others + radiance
