"""A picture of each light by itself: what is moved is lit anew, and strengths and colours are factors of a sum."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lights.local import Light


class LightLayers:
    """What an artist holds while lights are set, under any lighting method.

        layers = LightLayers(relighter, lights)
        layers.move(0, jr.point([1, 2, 0], 5))      # one light is computed
        picture = layers.picture([[1, 0.9, 0.8], 0, 2])  # none is: tinted, off, twice as strong

    Attributes:
        lights: as they stand.
        pictures: of each, with all of its bounces; without what surfaces emit.
        emitted: the picture of that.
    """

    def __init__(self, relighter: Relighter, lights: Sequence[Light]):
        """Lights each by itself."""
        self._relighter, self._view = relighter, relighter.view()
        self.emitted = self._radiance(None)
        self.lights = list(lights)
        self.pictures = jnp.stack([self._alone(light) for light in lights]) if lights else self.emitted[None][:0]

    def move(self, number: int, light: Light) -> None:
        """Puts another light in the place of one.

        Raises:
            InputError: if there is no such one.
        """
        if not 0 <= number < len(self.lights):
            raise InputError(f"light {number} is none of the {len(self.lights)}")
        self.lights[number] = light
        self.pictures = self.pictures.at[number].set(self._alone(light))

    def picture(self, gains: Sequence | Float[Array, "n ..."] | None = None) -> Float[Array, "h w c"]:
        """The sum, each light times a number or a colour, which is 1 without; linear in them.

        Raises:
            InputError: for another number of them than there are lights.
        """
        if gains is None:
            gains = [1.0] * len(self.lights)
        if len(gains) != len(self.lights):
            raise InputError(f"{len(gains)} gains were given for {len(self.lights)} lights")
        colours = [jnp.broadcast_to(jnp.asarray(gain, self.emitted.dtype), (3,)) for gain in gains]
        return _mixed(self.pictures, jnp.stack(colours), self.emitted) if colours else self.emitted

    def _alone(self, light: Light) -> Float[Array, "h w c"]:
        return self._radiance(light) - self.emitted

    def _radiance(self, lights: Light | None) -> Float[Array, "h w c"]:
        return self._relighter.shade(self._relighter.light(lights), self._view).radiance


@jax.jit
def _mixed(pictures, gains, emitted):
    return emitted + jnp.einsum("nhwc,nc->hwc", pictures, gains, precision="highest")
