"""A BRDF turned about the normal: the direction of anisotropy of McAllister 2002 §3.1."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf


class Turned(Brdf):
    """f(R ω_i, R ω_o), with R turning by −angle about the normal: the BRDF's x axis lies at `angle` from the tangent.

    Attributes:
        brdf: what is turned.
        angle: in radians, from the tangent towards the binormal.
    """

    brdf: Brdf
    angle: Float[Array, ""]

    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, " c"]:
        """The BRDF of the turned directions."""
        return self.brdf.evaluate(turned(omega_i, self.angle), turned(omega_o, self.angle))

    @property
    def channels(self) -> int:
        """Those of the BRDF."""
        return self.brdf.channels

    @property
    def is_constant(self) -> bool:
        """Whether the BRDF is."""
        return self.brdf.is_constant


def turned(omega: Float[Array, "... 3"], angle: Float[Array, "..."]) -> Float[Array, "... 3"]:
    """Directions in a frame whose x and y axes lie at `angle` from those they are given in."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    x, y, z = omega[..., 0], omega[..., 1], omega[..., 2]
    return jnp.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=-1)
