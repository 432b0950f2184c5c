"""Spatial BRDFs: a Lafortune BRDF of its own in every texel of a map (McAllister 2002 §3)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.texture import Texture


class SpatialLobes(eqx.Module):
    """Maps of the parameters of `LobeSum`, whose C and exponents are shared by the channels.

    Row 0 is the top: (u, v) = (0, 1) is the upper left corner, as of a `Texture`.

    Attributes:
        diffuse: albedo.
        C: with max|C| = 1 in each lobe.
        exponent: n.
        scale: of each lobe at its peak.
        axis: (cos 2φ, sin 2φ), φ the angle from the tangent to the direction of anisotropy, which π turns into itself.
    """

    diffuse: Float[Array, "h w c"]
    C: Float[Array, "h w l 3"]
    exponent: Float[Array, "h w l"]
    scale: Float[Array, "h w l c"]
    axis: Float[Array, "h w 2"]

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

    def packed(self) -> "PackedLobes":
        """All parameters of a texel side by side, for many look-ups. Differentiable in the maps."""
        h, w, lobes, _ = self.C.shape
        logarithm = jnp.log(jnp.maximum(self.exponent, 1e-6))
        maps = [self.diffuse, self.C, logarithm, self.scale, self.axis]
        whole = Texture(jnp.concatenate([part.reshape(h, w, -1) for part in maps], axis=-1))
        return PackedLobes(whole, lobes, self.channels)

    def at(self, uv: Float[Array, "*p 2"]) -> LobeSum:
        """The BRDFs at texture coordinates, see `PackedLobes.at`."""
        return self.packed().at(uv)


class PackedLobes(eqx.Module):
    """`SpatialLobes` as one texture of diffuse, C, log exponents, scale and axis: a look-up reads one place.

    Attributes:
        texture: of c + (4 + c) · lobes + 2 channels.
        lobes: l.
        channels: c.
    """

    texture: Texture
    lobes: int = eqx.field(static=True)
    channels: int = eqx.field(static=True)

    def at(self, uv: Float[Array, "*p 2"]) -> LobeSum:
        """The BRDFs at texture coordinates; arrays lead with theirs. Differentiable in the maps.

        Parameters are interpolated between texels: C by components and then to max|C| = 1 again, exponents by their
        logarithms, which spread a highlight evenly.
        """
        flat = jax.vmap(self.texture.look_up)(uv.reshape(-1, 2)).reshape(*uv.shape[:-1], -1)
        c, lobes = self.channels, self.lobes
        diffuse, C, logarithm, scale, axis = jnp.split(
            flat, [c, c + 3 * lobes, c + 4 * lobes, (c + 4) * lobes + c], axis=-1
        )
        C = C.reshape(*C.shape[:-1], lobes, 1, 3)
        largest = jnp.max(jnp.abs(C), axis=-1, keepdims=True)
        C = jnp.where(largest > 0, C / jnp.where(largest > 0, largest, 1), 0)
        none = (axis[..., 0] == 0) & (axis[..., 1] == 0)
        angle = jnp.arctan2(axis[..., 1], jnp.where(none, 1, axis[..., 0])) / 2
        return LobeSum(diffuse, C, jnp.exp(logarithm)[..., None], scale.reshape(*scale.shape[:-1], lobes, c), angle)

    def around(self, uv: Float[Array, "2"]) -> tuple[LobeSum, Float[Array, "4"]]:
        """The BRDFs of the four texels around texture coordinates, and their bilinear weights.

        The weighted sum of what they reflect is reflectance interpolated, where `at` interpolates parameters.
        """
        h, w = self.texture.pixels.shape[:2]
        x, y = uv[0] * w - 0.5, (1 - uv[1]) * h - 0.5
        left, top = jnp.floor(x), jnp.floor(y)
        columns, rows = left + jnp.asarray([0, 1, 0, 1]), top + jnp.asarray([0, 0, 1, 1])
        weights = jnp.maximum(1 - jnp.abs(x - columns), 0) * jnp.maximum(1 - jnp.abs(y - rows), 0)
        return self.at(jnp.stack([(columns + 0.5) / w, 1 - (rows + 0.5) / h], axis=-1)), weights
