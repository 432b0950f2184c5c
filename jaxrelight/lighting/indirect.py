"""Lighting by direct-to-indirect transfer: local lights move, and many bounces follow (Hašan 2006 §3)."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.material import Component, Material
from jaxrelight.errors import InputError
from jaxrelight.gather.gather_cloud import FAR
from jaxrelight.geometry.tracer import OFFSET
from jaxrelight.lighting.antialiasing import averaged, joined, nearest_pixels
from jaxrelight.lighting.prefiltered import Seen, look
from jaxrelight.lighting.shadows import Shadows
from jaxrelight.lighting.transport import Relighter
from jaxrelight.lights.environment import Environment, coarsened
from jaxrelight.lights.local import Light
from jaxrelight.lights.sky import mean_radiance, nearest_directions
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.contract import Operator
from jaxrelight.transport.model import Transport

# Of a cube map as fine as maps of a sky in the cloud are read.
_SKY = 32


class IndirectRelighter:
    """Lights what one camera sees by lights at any place.

        relighter = IndirectRelighter(load(folder))
        image = relighter.image([jr.point([0, 1, 0], 3)])

    The parts are apart, and differentiable in lights, albedos and light of the cloud, while shadows stand still:
    `cloud_light` is what the points of the cloud reflect of lights, `spread` adds what they get from each other, and
    `gathered` what pixels get of it.
    """

    def __init__(self, transport: Transport, samples: int = 2):
        """From a store with gather samples.

        Args:
            transport: of the store.
            samples: of direct light along each side of a pixel.

        Raises:
            InputError: for a store of another kind.
        """
        if transport.cloud is None:
            raise InputError(f"{transport.folder}: a store for light of the sky; precompute with gather samples")
        self.transport, self.cloud = transport, transport.cloud
        self._samples = samples
        self._final = Relighter(transport)
        surfaces, points = transport.surfaces, transport.cloud.points
        places = as_array(points.positions * surfaces.radius + surfaces.centre, jnp.float32)
        # Nothing lights the sky.
        self._normals = as_array(np.where(points.of_sky[:, None], 0, points.normals), jnp.float32)
        self._dark = as_array(np.zeros(points.normals.shape), jnp.float32)
        lifted = points.positions + OFFSET * points.face_normals
        self.shadows = Shadows(transport.tracer, lifted, places, self._normals, surfaces.radius)
        self._sky_shares: dict[tuple[int, int], Array] = {}
        slot, albedo, emission = transport.cloud.slot_of, transport.cloud.albedo, transport.cloud.emission
        self.albedo, self.emission, self._slot = as_array(albedo), as_array(emission), as_array(slot)

    @functools.cached_property
    def view(self):
        """The pixels of the camera."""
        return self._final.view()

    @functools.cached_property
    def seen(self) -> Seen:
        """The samples of direct light."""
        transport, camera = self.transport, self.transport.camera
        components = {
            name: tuple(Component(block.brdf, block.weight) for block in transport.blocks if block.material == name)
            for name in transport.names
        }
        finer = dataclasses.replace(camera, width=self._samples * camera.width, height=self._samples * camera.height)
        maps = dict(zip(transport.material_of_mesh, transport.normal_maps, strict=True))
        materials = {name: Material(parts, maps.get(name)) for name, parts in components.items()}
        return look(transport.surfaces, transport.tracer, finer, transport.material_of_mesh, materials)

    @functools.cached_property
    def _nearest(self):
        transport, camera = self.transport, self.transport.camera
        assert transport.seen is not None
        angle = 2 * np.tan(np.radians(camera.fov_y) / 2) / camera.height
        eye = transport.surfaces.to_scene(np.asarray(camera.origin))
        return as_array(nearest_pixels(self.seen.gbuffer, transport.seen, eye, float(angle)))

    def cloud_light(
        self, lights: Sequence[Light], albedo: Float[Array, "g c"] | None = None, shadows: bool = True
    ) -> Float[Array, "g c"]:
        """Radiance that the cloud's points emit, and reflect of lights: g_d of the paper."""
        irradiance = self._dark
        for punctual in (one for light in lights for one in light.parts()):
            irradiance = _lit(irradiance, *self.shadows.arriving(punctual, shadows), self._normals)
        return _reflected(irradiance, self.albedo if albedo is None else albedo, self.emission)

    def sky_light(self, pixels: Float[Array | np.ndarray, "h w 3"], rotate_y=0.0, scale=1.0) -> Float[Array, "g c"]:
        """Radiance of the cloud's directions of the sky under a lat-long map. Pure and differentiable in all three.

        It was not reflected yet: `spread` it for one bounce more than light of lamps.

        Raises:
            InputError: for a store whose cloud has none.
        """
        sky = np.flatnonzero(self.cloud.points.of_sky)
        if not len(sky):
            raise InputError(f"{self.transport.folder}: precomputed without the sky; precompute with --sky")
        height, width = pixels.shape[:2]
        if (height, width) not in self._sky_shares:
            towards = self.cloud.points.positions[sky] / FAR
            self._sky_shares[height, width] = as_array(nearest_directions(towards, height, width))
        radiance = mean_radiance(pixels, rotate_y, scale, self._sky_shares[height, width], len(sky))
        return jnp.zeros_like(self._normals).at[sky].set(radiance)

    def spread(
        self, light: Float[Array, "g c"], bounces: int | None = None, albedo: Float[Array, "g c"] | None = None
    ) -> Float[Array, "g c"]:
        """(M + I) g: light of the cloud with what its points get from each other, so that pixels see `bounces`.

        Raises:
            InputError: for more than one bounce where the store is of one; where photons were shot, for others than
                the store's, or for albedos where they met any on their way.
        """
        bounces = self.transport.settings.bounces if bounces is None else bounces
        if bounces > 1 and self.cloud.between is None:
            raise InputError(
                f"{self.transport.folder}: precomputed for one bounce; precompute with --bounces 2 or more"
            )
        photons, most = self.transport.settings.photons, self.transport.settings.bounces
        if photons and bounces not in (1, most):
            raise InputError(f"{self.transport.folder}: photons were shot for {most} bounces, not {bounces}")
        if photons and bounces > 2 and albedo is not None:
            raise InputError(
                f"{self.transport.folder}: its photons met the albedos they were shot with; gather instead"
            )
        total = light
        for _ in range(min(bounces - 1, 1) if photons else bounces - 1):
            reflected = self.albedo if albedo is None else albedo
            total = _bounced(light, reflected, self.cloud.between, self._encoded(total), self._slot)
        return total

    def gathered(self, light: Float[Array, "g c"], by: Literal["all", "diffuse", "glossy"] = "all"):
        """Radiance [h, w, c] of the pixels by light of the cloud, as all of their BRDFs reflect it or some of them."""
        terms = self._final.terms(self._encoded(light))
        if by != "all":
            blocks = self.transport.blocks
            chosen = [block.brdf.is_constant == (by == "diffuse") for block in blocks]
            terms = tuple(part if one else jnp.zeros_like(part) for part, one in zip(terms, chosen, strict=True))
        return self._final.shade(terms, self.view)

    def indirect(
        self, lights: Sequence[Light], bounces: int | None = None, sky: Environment | None = None
    ) -> Float[Array, "h w c"]:
        """Radiance of the pixels by light that was reflected on its way to them, and by a sky in the cloud.

        Args:
            lights: any.
            bounces: the store's own number, or fewer.
            sky: an environment, for a store with directions of the sky.
        """
        return self.gathered(self._spread(lights, bounces, sky))

    def picture(
        self, lights: Sequence[Light], bounces: int | None = None, sky: Environment | None = None
    ) -> Float[Array, "h w 3"]:
        """Several samples of direct light a pixel, and one of indirect light; nothing where no surface is."""
        return joined(self.seen.lit_by(lights), self.indirect(lights, bounces, sky), self._nearest)

    def image(
        self,
        lights: Sequence[Light],
        bounces: int | None = None,
        behind: Environment | None = None,
        sky: Environment | None = None,
    ) -> Float[np.ndarray, "h w 4"]:
        """A finished picture, RGBA; an environment behind, which lights nothing: give it as `sky`, or a `Sky` of it."""
        found, alpha = np.asarray(self.picture(lights, bounces, sky)), self._pooled(self.seen.covered[..., None])
        if behind is not None:
            shown = np.where(self.seen.covered[..., None], 0, np.asarray(self.seen.background(behind)))
            found = found + self._pooled(shown)
        return np.concatenate([found, alpha], axis=-1, dtype=np.float32)

    def layers(
        self, lights: Sequence[Light], bounces: int | None = None, sky: Environment | None = None
    ) -> dict[str, Float[np.ndarray, "h w 3"]]:
        """Pictures that add up: direct and indirect light by what reflects it last; and again, of each light.

        "direct", "indirect.diffuse" and "indirect.glossy" are the picture, with "emission" where surfaces emit light;
        so are "light1", "light2" … and "sky", where there is one, with what emission gives them.
        """
        black = self.seen.image([])
        spread = self._spread(lights, bounces, sky)
        own = self.gathered(self._dark)
        found = {"direct": averaged(self.seen.lit_by(lights), self._samples)}
        for kind in ("diffuse", "glossy"):
            found[f"indirect.{kind}"] = joined(black, self.gathered(spread, kind) - own, self._nearest)
        none = 0
        if self.transport.emits:
            found["emission"] = joined(black, own, self._nearest)
            none = self.picture([], bounces)
        for number, light in enumerate(lights, 1):
            found[f"light{number}"] = self.picture([light], bounces) - none
        if sky is not None:
            found["sky"] = self.picture([], bounces, sky) - none
        return {name: np.asarray(picture) for name, picture in found.items()}

    def _spread(self, lights: Sequence[Light], bounces: int | None, sky: Environment | None) -> Float[Array, "g c"]:
        """Light of the cloud that pixels see."""
        bounces = self.transport.settings.bounces if bounces is None else bounces
        total = self._dark
        if bounces and (lights or self.transport.emits or sky is None):
            total = self.spread(self.cloud_light(lights), bounces)
        if sky is not None:
            light = self.sky_light(coarsened(sky.pixels, _SKY), sky.rotate_y, sky.scale)
            # It has not been reflected yet.
            total += self.spread(light, bounces + 1)
        return total

    def _pooled(self, samples: np.ndarray) -> Float[np.ndarray, "h w c"]:
        """Means over the samples of each pixel."""
        h, w = self.view.shape
        return samples.reshape(h, self._samples, w, self._samples, -1).mean(axis=(1, 3))

    def _encoded(self, light: Float[Array, "g c"]) -> Float[Array, "g c"]:
        return _encode(self.transport.basis, light)


@jax.jit
def _lit(irradiance, incident, visible, normals):
    """Irradiance with that of another light."""
    cosine = jnp.maximum(jnp.sum(incident.omega_i * normals, axis=1), 0)
    return irradiance + incident.irradiance * (cosine * visible)[:, None]


@jax.jit
def _reflected(irradiance, albedo, emission):
    return albedo / np.pi * irradiance + emission


@jax.jit
def _encode(basis, light):
    return basis.encode(light.T).T


@jax.jit
def _bounced(light, albedo, between: Operator, encoded: Float[Array, "g c"], slot) -> Float[Array, "g c"]:
    """Light of the cloud, and what its points reflect of encoded light."""
    return light + albedo * between.apply(encoded).at[slot].get(mode="promise_in_bounds")
