"""A BRDF that is given as separable factors, rather than approximated by them."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored, Symmetric
from jaxrelight.brdf.parametrisation import DISC, Parametrisation


class Separable(Brdf):
    """f(ω_i, ω_o) = Σ_k g_k(ω_i) · h_k(ω_o) (Wang 2006 eq. 1), with maps over the disc (eq. 10) or polar ones (eq. 11).

    Between texels, and where g and h have both signs, the sum may be a little negative.
    """

    light_maps: Float[Array, "k c1 r r"]
    view_maps: Float[Array, "k c r r"]
    parametrisation: Parametrisation = DISC

    @property
    def factors(self) -> Factored:
        """The same, as baking and viewing take it."""
        return Factored(self.light_maps, self.view_maps, self.parametrisation)

    @jax.jit
    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, " c"]:
        """f(ω_i, ω_o) of every channel."""
        return jnp.sum(self.factors.light_side(omega_i) * self.factors.view_side(omega_o), axis=0)

    @property
    def channels(self) -> int:
        """c, the number of colour channels."""
        return self.view_maps.shape[1]

    @property
    def is_constant(self) -> bool:
        """Whether the maps have a single texel."""
        return self.light_maps.shape[-1] == self.view_maps.shape[-1] == 1


def separable(factors: Factored | Symmetric) -> Separable:
    """The BRDF that factors make; the signs of symmetric ones go to the view maps."""
    factors = factors.as_factored() if isinstance(factors, Symmetric) else factors
    return Separable(factors.light_maps, factors.view_maps, factors.parametrisation)
