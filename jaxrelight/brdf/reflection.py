"""What baking and viewing need of a material: a light side and a view side."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.texture import Footprint


class Reflection(eqx.Module):
    """A sum of k products f(ω_i, ω_o) ≈ Σ_k light_side_k(ω_i) · view_side_k(ω_o) (Wang 2006 eq. 1), per channel.

    Transport bakes the light side; radiance is Σ_k view_side_k · (T x)_k. Both sides take one local direction above
    the surface.
    """

    @property
    @abc.abstractmethod
    def terms(self) -> int:
        """k, the number of products."""

    @property
    @abc.abstractmethod
    def channels(self) -> int:
        """Channels of the light side: 1 where all channels share it."""

    @abc.abstractmethod
    def light_side(self, omega_i: Float[Array, "3"]) -> Float[Array, "k c"]:
        """The factors of the incident direction."""

    @abc.abstractmethod
    def view_side(self, omega_o: Float[Array, "3"]) -> Float[Array, "k c"]:
        """The factors of the outgoing direction."""

    def light_terms(self, omega_i: Float[Array, "3 t"], weights: Float[Array, "k1 c t"]) -> Float[Array, "k c"]:
        """Σ_t light_side(ω_t) weights_t: the light terms of light from many directions.

        Args:
            omega_i: local directions.
            weights: what arrives from each; the same for all terms, or for each its own.
        """
        sides = jax.vmap(self.light_side, in_axes=1, out_axes=2)(omega_i)
        return jnp.sum(sides * weights, axis=-1)

    @property
    def is_constant(self) -> bool:
        """Whether it is known to be the same for all directions."""
        return False

    def view_side_at(self, omega_o: Float[Array, "3"], uv: Float[Array, " u"], footprint: Footprint) -> Array:
        """The same at texture coordinates, of which a pixel covers an area; where it varies over the surface."""
        return self.view_side(omega_o)

    @property
    @abc.abstractmethod
    def per_receiver(self) -> PyTree[bool]:
        """A tree (or a prefix of one) of booleans: True for arrays of which each receiver has its own."""


class FixedView(Reflection):
    """The exact BRDF for receivers whose direction to the eye is known: one term, all of it on the light side.

    Where parameters of the BRDF vary from receiver to receiver, `own` holds those arrays and `brdf` the others, as
    `eqx.partition` parts them.
    """

    brdf: Brdf
    omega_o: Float[Array, "*v 3"]
    own: Brdf | None = None

    @property
    def _whole(self) -> Brdf:
        return self.brdf if self.own is None else eqx.combine(self.own, self.brdf)

    @property
    def terms(self) -> int:
        """One."""
        return 1

    @property
    def channels(self) -> int:
        """The channels of the BRDF."""
        return self._whole.channels

    @jax.jit
    def light_side(self, omega_i: Float[Array, "3"]) -> Float[Array, "1 c"]:
        """f(ω_i, ω_o) itself; 0 where the eye is below the surface."""
        value = self._whole.evaluate(omega_i, self.omega_o)
        return jnp.where(self.omega_o[2] <= 0, 0, value)[None]

    @jax.jit
    def light_terms(self, omega_i: Float[Array, "3 t"], weights: Float[Array, "1 c t"]) -> Float[Array, "1 c"]:
        """What the BRDF reflects of all of it, see `Brdf.integral`."""
        return jnp.where(self.omega_o[2] <= 0, 0, self._whole.integral(omega_i, self.omega_o, weights[0]))[None]

    @jax.jit
    def view_side(self, omega_o: Float[Array, "3"]) -> Float[Array, "1 1"]:
        """One: the view is in the transport already."""
        return jnp.ones((1, 1), self.omega_o.dtype)

    @property
    def is_constant(self) -> bool:
        """Whether the BRDF is constant."""
        return self._whole.is_constant

    @property
    def per_receiver(self) -> PyTree[bool]:
        """Every receiver has its ω_o and its `own` parameters; all share the others."""
        shared = jax.tree.map(lambda _: False, self)
        own = jax.tree.map(lambda _: True, (self.omega_o, self.own))
        return eqx.tree_at(lambda of: (of.omega_o, of.own), shared, own, is_leaf=lambda of: of is None)


def of_group(reflection: Reflection, group: int) -> Reflection:
    """One group's part of a reflection whose own-per-receiver arrays lead with the group."""
    own, shared = eqx.partition(reflection, reflection.per_receiver)
    return eqx.combine(jax.tree.map(lambda x: x[group], own), shared)
