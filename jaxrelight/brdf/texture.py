"""Numbers that vary over a surface: an image by texture coordinates."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Texture(eqx.Module):
    """An image over the unit square of texture coordinates, repeated beyond it and looked up bilinearly.

    Row 0 is the top: (u, v) = (0, 1) is the image's upper left corner, as in OBJ files. An image of one pixel is a
    constant. Differentiable in the pixels.
    """

    pixels: Float[Array, "h w c"]

    @property
    def is_constant(self) -> bool:
        """Whether no texture coordinates are needed."""
        return self.pixels.shape[:2] == (1, 1)

    def look_up(self, uv: Float[Array, "2"]) -> Float[Array, " c"]:
        """The image at (u, v)."""
        if self.is_constant:
            return self.pixels[0, 0]
        h, w, c = self.pixels.shape
        flat = self.pixels.reshape(h * w, c)
        # The whole part goes first, so that far repetitions lose no more digits than their coordinates have lost.
        x, y = (uv[0] - jnp.floor(uv[0])) * w - 0.5, (1 - (uv[1] - jnp.floor(uv[1]))) * h - 0.5
        left, top = jnp.floor(x), jnp.floor(y)

        def texel(row, column):
            place = (row.astype(jnp.int32) % h) * w + column.astype(jnp.int32) % w
            return flat.at[place].get(mode="promise_in_bounds")

        def across(row):
            return texel(row, left) * (1 - (x - left)) + texel(row, left + 1) * (x - left)

        return across(top) * (1 - (y - top)) + across(top + 1) * (y - top)


# A product of textures; the empty one is 1.
Weight = tuple[Texture, ...]


def constant(values, dtype=jnp.float32) -> Texture:
    """The same numbers everywhere."""
    return Texture(jnp.atleast_1d(jnp.asarray(values, dtype))[None, None])


def look_up(weight: Weight, uv: Float[Array, "2"]) -> Float[Array, " c"]:
    """The product of textures at (u, v)."""
    value = jnp.ones(1, uv.dtype)
    for texture in weight:
        value = value * texture.look_up(uv)
    return value
