"""What every BRDF offers."""

import abc

import equinox as eqx
from jaxtyping import Array, Float


class Brdf(eqx.Module):
    """A bidirectional reflectance distribution function in 1/sr, without the cosine.

    Directions are unit vectors in the local frame (x tangent, y binormal, z normal) and leave the surface: ω_i to the
    light, ω_o to the eye. `evaluate` takes one pair; vmap it for more. It is asked only above the surface.
    """

    @abc.abstractmethod
    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, " c"]:
        """f(ω_i, ω_o) of every channel."""

    @property
    @abc.abstractmethod
    def channels(self) -> int:
        """c, the number of colour channels."""

    @property
    def is_constant(self) -> bool:
        """Whether f is known to be the same for all directions, so that one factor of one texel is exact."""
        return False
