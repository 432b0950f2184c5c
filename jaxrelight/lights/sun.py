"""The few texels of a light that outshine all others, as a sun does: split off, to be integrated by themselves."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.basis import cubemap, latlong
from jaxrelight.lights.environment import coarsened
from jaxrelight.lights.sky import Sky
from jaxrelight.numerics.arrays import as_array

# The most texels, how many times as bright they are as the next one after them, and what share of the light's energy
# they hold together, at least. Of eight photographed skies and rooms, those with a sun are split at any rotation.
MOST, BRIGHTER, SHARE = 16, 4.0, 0.5
# Of a map's sun, radians between directions, as far as so many of them are enough; the coarsest cube map that it is
# looked for in, and the one that maps are made coarse for.
_APART, _MOST_DIRECTIONS, _COARSEST, _FINEST = 0.012, 64, 16, 64


class Split(NamedTuple):
    """A light in two parts.

    Attributes:
        rest: the light without its sun: of those texels, as much as the brightest of the others has.
        texels: numbers of the brightest.
        radiance: what was taken off them; 0 where a texel is none of the sun's.
    """

    rest: Float[Array, "d c"]
    texels: Int[Array, " n"]
    radiance: Float[Array, "n c"]

    @property
    def sun(self) -> Float[Array, "d c"]:
        """What was taken off, as a light."""
        return jnp.zeros_like(self.rest).at[self.texels].set(self.radiance)


@jax.jit
def split_sun(texels: Float[Array, "d c"]) -> Split:
    """Takes the sun off a light: rest + sun is the light. Pure; where there is no sun, nothing is taken.

    What compressed rows leave out is an error that grows with the light's coefficients, and a sun's are as large in
    fine levels as in coarse ones.

    Args:
        texels: radiance of d > 16 texels of a cube map.
    """
    largest = jnp.max(jnp.abs(texels))
    scaled = texels / jnp.where(largest > 0, largest, 1)
    energy = jnp.sum(jnp.square(scaled), axis=1)
    top, index = jax.lax.top_k(energy, MOST + 1)
    limit, top, index = top[-1], top[:-1], index[:-1]
    bright = (top > BRIGHTER**2 * limit) & (top > 0)
    is_sun = jnp.sum(jnp.where(bright, top, 0)) >= SHARE * jnp.sum(energy)
    stays = jnp.where(bright & is_sun, jnp.sqrt(limit / jnp.where(bright, top, 1)), 1.0)[:, None]
    # A product, not a difference: exactly 0 where all stays, however XLA may round.
    return Split(texels.at[index].multiply(stays), index, texels[index] * (1 - stays))


def without_sun(pixels: Float[np.ndarray, "h w 3"]) -> tuple[Float[np.ndarray, "h w 3"], Sky]:
    """A lat-long map without its sun, and that as directions; none where there is no sun.

    It is looked for in ever coarser cube maps, as a fine map's sun has more than a few pixels: each cell that outshines
    all others gives what it has above them. A cell is one direction where it is smaller than a sun, and several beside
    each other in coarse maps, for soft shadows.

    Args:
        pixels: radiance.
    """
    looked = coarsened(pixels, _FINEST)
    towards, area = _pixels_of(looked)
    flat = np.asarray(looked, float).reshape(-1, 3)
    rows = len(looked)
    n = 1 << max(0, int(np.floor(np.log2(rows / 2)))) if rows > 1 else 0
    while n >= min(_COARSEST, rows // 2) > 0:
        cell = cubemap.texel_of(towards, n)
        whole = np.maximum(np.bincount(cell, area, 6 * n * n), 1e-30)
        mean = np.stack([np.bincount(cell, area * one, 6 * n * n) for one in flat.T], axis=1) / whole[:, None]
        split = split_sun(as_array(mean, jnp.float32)) if len(mean) > MOST else None
        if split is not None and bool(jnp.any(split.radiance > 0)):
            return _taken(pixels, split, n)
        n //= 2
    return pixels, Sky(jnp.zeros((0, 3)), jnp.zeros((0, 3)))


def _taken(pixels, split: Split, n: int) -> tuple[Float[np.ndarray, "h w 3"], Sky]:
    """A map without what its pixels in the bright cells of a cube map have above the others, and that."""
    towards, area = _pixels_of(pixels)
    flat = np.asarray(pixels, float).reshape(-1, 3)
    cell, length = cubemap.texel_of(towards, n), np.linalg.norm(flat, axis=1)
    lit = np.asarray(split.texels)[np.asarray(split.radiance).any(axis=1)]
    # As bright as what is left of the brightest cell, at most.
    most = np.linalg.norm(np.asarray(split.rest, float)[lit], axis=1).max()
    bright = np.isin(cell, lit) & (length > most)
    rest = np.where(bright, most / np.where(bright, length, 1), 1)[:, None] * flat
    h, w = pixels.shape[:2]
    return rest.reshape(pixels.shape).astype(pixels.dtype), _directions(flat - rest, towards, area, cell, lit, (h, w))


def _pixels_of(pixels) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Directions to all pixels of a lat-long map, and their solid angles."""
    h, w = pixels.shape[:2]
    v, u = ((np.indices((h, w)) + 0.5) / np.array([[[h]], [[w]]])).reshape(2, -1)
    return latlong.directions(u, v), np.repeat(latlong.solid_angles(h, w), w)


def _directions(light, towards, area, cell, lit, shape: tuple[int, int]) -> Sky:
    """Of each lit cell its mean direction; of each of its pixels several, where those are larger than a sun."""
    pixel = np.pi / shape[0]
    if pixel <= _APART:
        energy = light * area[:, None]
        irradiance = np.stack([energy[cell == one].sum(axis=0) for one in lit])
        mean = np.stack([(energy.sum(axis=1) @ np.where((cell == one)[:, None], towards, 0)) for one in lit])
        mean /= np.linalg.norm(mean, axis=1, keepdims=True)
        return Sky(as_array(mean, jnp.float32), as_array(irradiance, jnp.float32))
    here = np.flatnonzero(light.any(axis=1))
    along = max(1, min(int(np.ceil(pixel / _APART)), int(np.sqrt(_MOST_DIRECTIONS / max(len(here), 1)))))
    u, v = latlong.coordinates(towards[here])
    step = (np.arange(along) + 0.5) / along - 0.5
    down, right = (x.ravel() for x in np.meshgrid(step, step, indexing="ij"))
    v, u = v[:, None] + down / shape[0], u[:, None] + right / shape[1]
    # By solid angle, which differs along a pixel near the poles.
    share = np.sin(np.pi * v)
    share /= share.sum(axis=1, keepdims=True)
    irradiance = (light[here] * area[here, None])[:, None] * share[..., None]
    found = latlong.directions(u, v).reshape(-1, 3)
    return Sky(as_array(found, jnp.float32), as_array(irradiance.reshape(-1, 3), jnp.float32))
