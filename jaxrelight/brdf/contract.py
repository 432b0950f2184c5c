"""What every BRDF offers."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Brdf(eqx.Module):
    """A bidirectional reflectance distribution function in 1/sr, without the cosine.

    Directions are unit vectors in the local frame (x tangent, y binormal, z normal) and leave the surface: ω_i to the
    light, ω_o to the eye. `evaluate` takes one pair; vmap it for more. It is asked only above the surface.
    """

    @abc.abstractmethod
    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, " c"]:
        """f(ω_i, ω_o) of every channel."""

    def integral(
        self, omega_i: Float[Array, "3 t"], omega_o: Float[Array, "3"], weights: Float[Array, "c t"]
    ) -> Float[Array, " c"]:
        """Σ_t f(ω_t, ω_o) weights_t: what is reflected of light from many directions.

        Args:
            omega_i: local directions to the light, above the surface where they have weight.
            omega_o: local direction to the eye.
            weights: radiance × cosine × solid angle, or the like, by channel; a BRDF of one channel takes any.
        """
        values = jax.vmap(lambda omega: self.evaluate(omega, omega_o), in_axes=1, out_axes=1)(omega_i)
        return jnp.sum(values * weights, axis=1)

    @property
    @abc.abstractmethod
    def channels(self) -> int:
        """c, the number of colour channels."""

    @property
    def is_constant(self) -> bool:
        """Whether f is known to be the same for all directions, so that one factor of one texel is exact."""
        return False
