"""Spatial BRDFs: a Lafortune BRDF of its own in every texel of a map (McAllister 2002 §3)."""

import functools
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.texture import Footprint, Texture

# The weight of a lobe that reflects nothing, so that it has a direction and an exponent all the same.
_MIN_WEIGHT = 1e-9

Minification = Literal["levels", "averaged", "none"]


class SpatialLobes(eqx.Module):
    """Maps of the parameters of `LobeSum`, whose C and exponents are shared by the channels.

    Row 0 is the top: (u, v) = (0, 1) is the upper left corner, as of a `Texture`. Arrays lead with rows and columns;
    inside of `jax.vmap` over texels they lead with nothing.

    Attributes:
        diffuse: albedo.
        C: with max|C| = 1 in each lobe.
        exponent: n.
        scale: of each lobe at its peak.
        axis: (cos 2φ, sin 2φ), φ the angle from the tangent to the direction of anisotropy, which π turns into itself.
        coarser: levels of detail for surfaces far away, each of 2×2 texels of the one before; none may be given.
    """

    diffuse: Float[Array, "*hw c"]
    C: Float[Array, "*hw l 3"]
    exponent: Float[Array, "*hw l"]
    scale: Float[Array, "*hw l c"]
    axis: Float[Array, "*hw 2"]
    coarser: "tuple[SpatialLobes, ...]" = eqx.field(default=(), kw_only=True)

    @property
    def channels(self) -> int:
        """c, the number of colour channels."""
        return self.diffuse.shape[-1]

    @property
    def is_constant(self) -> bool:
        """Never: texels differ."""
        return False

    @property
    def lobes(self) -> int:
        """l, the number of lobes."""
        return self.C.shape[2]

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of texels."""
        return self.diffuse.shape[0], self.diffuse.shape[1]

    @functools.partial(jax.jit, static_argnames="minification")
    def packed(self, minification: Minification = "levels") -> "PackedLobes":
        """All parameters of a texel side by side, for many look-ups. Differentiable in the maps.

        Args:
            minification: what is seen of texels that are smaller than the picture's pixels: coarser "levels", as far as
                there are any; the "averaged" parameters of 2×2 texels and so on; or "none", single texels all the same.
        """
        finest = _side_by_side(self)
        if minification == "averaged":
            texture = Texture(finest).minified()
        elif minification == "levels" and self.coarser:
            flat = [_side_by_side(level).reshape(-1, finest.shape[-1]) for level in self.coarser]
            texture = Texture(finest, jnp.concatenate(flat))
        else:
            texture = Texture(finest)
        return PackedLobes(texture, self.lobes, self.channels)

    @jax.jit
    def at(self, uv: Float[Array, "*p u"], footprint: Float[Array, "*#p"] | float = 0.0) -> LobeSum:
        """The BRDFs at texture coordinates, see `PackedLobes.at`."""
        return self.packed().at(uv, footprint)


def _side_by_side(maps: SpatialLobes) -> Float[Array, "h w p"]:
    share = maps.scale / (maps.exponent + 2)[..., None]
    mean = jnp.mean(share, axis=-1)
    # Where a lobe is black its weight has no slope: exponents between black texels would have one of 1e7.
    weight = jnp.where(mean == 0, 0, jnp.abs(mean)) + _MIN_WEIGHT
    logarithm = weight * jnp.log(jnp.maximum(maps.exponent, 1e-6))
    parts = [maps.diffuse, weight[..., None] * maps.C, weight, logarithm, share, maps.axis]
    return jnp.concatenate([part.reshape(*maps.shape, -1) for part in parts], axis=-1)


class PackedLobes(eqx.Module):
    """`SpatialLobes` as one texture of what is interpolated, see `at`: a look-up reads one place.

    Attributes:
        texture: of c + (5 + c) · lobes + 2 channels.
        lobes: l.
        channels: c.
    """

    texture: Texture
    lobes: int = eqx.field(static=True)
    channels: int = eqx.field(static=True)

    @jax.jit
    def at(self, uv: Float[Array, "*p u"], footprint: Float[Array, "*#p"] | float = 0.0) -> LobeSum:
        """The BRDFs at texture coordinates; arrays lead with theirs. Differentiable in the maps.

        Parameters are interpolated between texels and levels. For scales these are the shares of light that lobes
        reflect, 2π·scale/(n + 2): a wide lobe as bright as a sharp one's peak would be too bright. C, by components
        and then to max|C| = 1 again, and exponents, by their logarithms, count by these shares: of a lobe that is black
        in one texel nothing is known there.

        Args:
            uv: texture coordinates.
            footprint: the area of them that a pixel of the picture covers.
        """
        covered = jnp.broadcast_to(jnp.asarray(footprint, uv.dtype), uv.shape[:-1])
        flat = jax.vmap(self.texture.look_up)(uv.reshape(-1, uv.shape[-1]), covered.reshape(-1))
        return self._lobes(flat.reshape(*uv.shape[:-1], -1))

    @jax.jit
    def around(self, uv: Float[Array, " u"], footprint: Footprint = 0.0) -> tuple[LobeSum, Float[Array, " m"]]:
        """The BRDFs of the texels around texture coordinates, four of a level, and their weights.

        The weighted sum of what they reflect is reflectance interpolated, where `at` interpolates parameters.
        """
        texels, weights = zip(*self.texture.around(uv, footprint), strict=True)
        return self._lobes(jnp.stack(texels)), jnp.stack(weights)

    @property
    @jax.jit
    def texels(self) -> LobeSum:
        """The BRDFs of all texels of the finest level."""
        return self._lobes(self.texture.pixels)

    def _lobes(self, flat: Float[Array, "*p t"]) -> LobeSum:
        """The BRDFs of packed parameters."""
        c, lobes = self.channels, self.lobes
        ends = np.cumsum([c, 3 * lobes, lobes, lobes, c * lobes])
        diffuse, C, weight, logarithm, share, axis = jnp.split(flat, ends, axis=-1)
        C = C.reshape(*C.shape[:-1], lobes, 1, 3)
        largest = jnp.max(jnp.abs(C), axis=-1, keepdims=True)
        C = jnp.where(largest > 0, C / jnp.where(largest > 0, largest, 1), 0)
        none = (axis[..., 0] == 0) & (axis[..., 1] == 0)
        angle = jnp.arctan2(axis[..., 1], jnp.where(none, 1, axis[..., 0])) / 2
        exponent = jnp.exp(logarithm / weight)[..., None]
        return LobeSum(diffuse, C, exponent, share.reshape(*share.shape[:-1], lobes, c) * (exponent + 2), angle)
