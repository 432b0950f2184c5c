"""Separable factors as reflections: maps of either side, looked up bilinearly (Wang 2006 §3.3.2)."""

import jax
from jaxtyping import Array, Float, PyTree

from jaxrelight.brdf.parametrisation import DISC, Parametrisation, look_up
from jaxrelight.brdf.reflection import Reflection


class Factored(Reflection):
    """k light maps and k view maps over the hemisphere, looked up bilinearly.

    Map texels are in the order y, x of the parametrisation; the disc's are (x + 1)/2, (y + 1)/2 of the local direction.
    """

    light_maps: Float[Array, "k c1 r r"]
    view_maps: Float[Array, "k c r r"]
    parametrisation: Parametrisation = DISC

    @property
    def channels(self) -> int:
        """Channels of the light maps: 1 for a BRDF that is the same in all directions, whose colour is the view's."""
        return self.light_maps.shape[1]

    @property
    def terms(self) -> int:
        """k, the number of maps of a side."""
        return self.light_maps.shape[0]

    @property
    def is_constant(self) -> bool:
        """Whether there is but one texel to a map."""
        return self.light_maps.shape[-1] == self.view_maps.shape[-1] == 1

    @jax.jit
    def light_side(self, omega_i: Float[Array, "3"]) -> Float[Array, "k c"]:
        """g_k(ω_i)."""
        return look_up(self.parametrisation, self.light_maps, omega_i)

    @jax.jit
    def view_side(self, omega_o: Float[Array, "3"]) -> Float[Array, "k c"]:
        """h_k(ω_o)."""
        return look_up(self.parametrisation, self.view_maps, omega_o)

    @property
    def per_receiver(self) -> PyTree[bool]:
        """All receivers share the maps."""
        return jax.tree.map(lambda _: False, self)


class Symmetric(Reflection):
    """k maps that serve both sides and a sign for each, so that the sum is reciprocal whatever is left out of it."""

    maps: Float[Array, "k c r r"]
    signs: Float[Array, "k c"]
    parametrisation: Parametrisation = DISC

    @property
    def channels(self) -> int:
        """The channels of the BRDF."""
        return self.maps.shape[1]

    @property
    def terms(self) -> int:
        """k, the number of maps."""
        return self.maps.shape[0]

    @jax.jit
    def light_side(self, omega_i: Float[Array, "3"]) -> Float[Array, "k c"]:
        """q_k(ω_i)."""
        return look_up(self.parametrisation, self.maps, omega_i)

    @jax.jit
    def view_side(self, omega_o: Float[Array, "3"]) -> Float[Array, "k c"]:
        """sign_k · q_k(ω_o)."""
        return self.signs * look_up(self.parametrisation, self.maps, omega_o)

    def as_factored(self) -> Factored:
        """The same with maps of either side, the signs in those of the view."""
        return Factored(self.maps, self.signs[..., None, None] * self.maps, self.parametrisation)

    @property
    def per_receiver(self) -> PyTree[bool]:
        """All receivers share the maps."""
        return jax.tree.map(lambda _: False, self)
