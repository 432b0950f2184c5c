"""BRDFs as a sampler asks for them: directions drawn by importance, and how fast they vary with the light."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxrelight.brdf.bandwidth import BandwidthTable, bandwidth_table, lobe_bandwidth, texture_bandwidth, with_cosine
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.half_sampling import HalfVectors, HalfVectorSampler, half_vectors
from jaxrelight.brdf.lobe_sampling import LobeSampler
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.brdf.texture import Texture


class SampledBrdf(eqx.Module):
    """A BRDF, or one for every texel, and what draws directions for it.

    Attributes:
        brdf: sums of lobes draw by their lobes, and need neither of the others.
        half: the distribution of half vectors.
        table: of bandwidth.
        map: of one for every texel, its bandwidth in cycles per texel.
    """

    brdf: Brdf | PackedLobes
    half: HalfVectors | None = None
    table: BandwidthTable | None = None
    map: Texture | None = None

    def towards(self, omega_o: Float[Array, "3"], uv: Float[Array, " u"], footprint: Float[Array, ""]) -> "BrdfSampler":
        """What one point reflects to the eye."""
        brdf = self.brdf.at(uv, footprint) if isinstance(self.brdf, PackedLobes) else self.brdf
        above = omega_o[2] > 0
        omega_o = jnp.where(above, omega_o, jnp.asarray([0, 0, 1], omega_o.dtype))
        if self.half is not None:
            sampler = self.half.towards(omega_o)
        else:
            assert isinstance(brdf, LobeSum)
            sampler = LobeSampler(brdf, omega_o)
        return BrdfSampler(self, brdf, jax.lax.stop_gradient(sampler), omega_o, above)

    def texture_bandwidth(self, uv: Float[Array, " u"], footprint: Float[Array, ""]) -> Float[Array, ""]:
        """How fast the BRDF itself varies from pixel to pixel, in cycles per pixel; 0 where it is one for all."""
        if self.map is None:
            return jnp.zeros((), uv.dtype)
        h, w = self.map.shape
        across = jnp.sqrt(jnp.maximum(footprint, 0)) * max(h, w)
        return jnp.minimum(self.map.look_up(uv)[0] * across, 0.5)


class BrdfSample(NamedTuple):
    """A sample.

    Attributes:
        omega_i: the direction to the light; the normal where nothing is reflected.
        weight: f(ω_i, ω_o) cosθ_i / density, differentiable in f; times radiance, an estimate of what is reflected.
        solid_angle: 1 / density, of which the n-th part is what one of n samples stands for.
    """

    omega_i: Float[Array, "3"]
    weight: Float[Array, " c"]
    solid_angle: Float[Array, ""]


class BrdfSampler(eqx.Module):
    """`SampledBrdf` at one point and one direction to the eye."""

    sampled: SampledBrdf
    brdf: Brdf
    sampler: LobeSampler | HalfVectorSampler
    omega_o: Float[Array, "3"]
    above: Bool[Array, ""]

    def draw(self, numbers: Float[Array, "2"]) -> BrdfSample:
        """The sample of two numbers from 0 to 1. Where it lies, and its density, stand still in derivatives."""
        return self.weighed(*self.direction(numbers))

    def direction(self, numbers: Float[Array, "2"]) -> tuple[Float[Array, "3"], Float[Array, ""]]:
        """A sample's direction and density, which may reflect nothing."""
        return jax.lax.stop_gradient(self.sampler.drawn(*numbers))

    def weighed(self, omega_i: Float[Array, "3"], density: Float[Array, ""]) -> BrdfSample:
        """The sample of a direction."""
        lit = self.above & (omega_i[2] > 0) & (density > 0)
        omega_i = jnp.where(lit, omega_i, jnp.asarray([0, 0, 1], omega_i.dtype))
        density = jnp.where(lit, density, 1)
        weight = jnp.where(lit, self.brdf.evaluate(omega_i, self.omega_o) * omega_i[2] / density, 0)
        return BrdfSample(omega_i, weight, 1 / density)

    def bandwidth(self, omega_i: Float[Array, "3"]) -> Float[Array, ""]:
        """How fast f · cosθ_i varies, in cycles per radian."""
        if self.sampled.table is not None:
            return with_cosine(self.sampled.table.look_up(omega_i, self.omega_o))
        assert isinstance(self.brdf, LobeSum)
        return with_cosine(lobe_bandwidth(self.brdf, omega_i, self.omega_o))


def sampled(brdf: Brdf | PackedLobes) -> SampledBrdf:
    """Finds what draws directions for a BRDF, and its bandwidth; seconds for one that is no sum of lobes."""
    if isinstance(brdf, LobeSum):
        return SampledBrdf(brdf)
    if isinstance(brdf, PackedLobes):
        return SampledBrdf(brdf, map=texture_bandwidth(brdf))
    return SampledBrdf(brdf, half_vectors(brdf), bandwidth_table(brdf))
