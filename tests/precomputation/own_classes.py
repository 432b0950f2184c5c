"""A BRDF and a light outside of the package, as users write them."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.lights.local import Incident, Point, Punctual


class Ggx(Brdf):
    """The microfacet model of Walter et al. (2007), with Schlick's Fresnel term, above a diffuse base."""

    diffuse: Float[Array, "3"]
    f0: Float[Array, "3"]
    roughness: float
    lobes: tuple[Float[Array, ""], ...]
    power: int = eqx.field(static=True)

    def __init__(self, colour: str, roughness: float):
        """Takes other things than its fields."""
        self.diffuse = jnp.asarray({"red": [0.4, 0.1, 0.1], "grey": [0.3, 0.3, 0.3]}[colour])
        self.f0, self.roughness = jnp.full(3, 0.04), roughness
        self.lobes, self.power = (jnp.asarray(0.75), jnp.asarray(0.25)), 5

    @jax.jit
    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, "3"]:
        """f(ω_i, ω_o) of every channel."""
        half = (omega_i + omega_o) / jnp.linalg.norm(omega_i + omega_o)
        square = self.roughness**4
        height = 1 / (math.pi * square * (half[2] ** 2 * (1 - 1 / square) + 1 / square) ** 2)
        fresnel = self.f0 + (1 - self.f0) * (1 - jnp.dot(omega_i, half)) ** self.power
        return self.diffuse / math.pi + sum(self.lobes) * fresnel * height / 4

    @property
    def channels(self) -> int:
        """Three."""
        return 3

    @property
    def is_constant(self) -> bool:
        """Never."""
        return False


class Striped(Punctual):
    """Another light, in stripes of the world."""

    lamp: Point
    width: Float[Array, ""]
    axis: int = eqx.field(static=True)

    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """What the other light gives, in every second stripe."""
        incident = self.lamp.at(positions)
        lit = jnp.floor(positions[:, self.axis] / self.width) % 2 == 0
        return incident._replace(irradiance=incident.irradiance * lit[:, None], within=lit)
