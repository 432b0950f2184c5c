"""The few texels of a light that outshine all others, as a sun does: split off, to be integrated by themselves."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.basis import cubemap, latlong
from jaxrelight.lights.environment import coarsened
from jaxrelight.lights.sky import Sky
from jaxrelight.numerics.arrays import as_array, is_traced

# The most texels, how many times as bright they are as the next one after them, and what share of the light's energy
# they hold together, at least. Of eight photographed skies and rooms, those with a sun are split at any rotation.
MAX_TEXELS, BRIGHTER, SHARE = 16, 4.0, 0.5
# Of a map's sun, radians between directions, as far as so many of them are enough; the coarsest cube map that it is
# looked for in, and the one that maps are made coarse for.
_APART, _MAX_DIRECTIONS, _COARSEST, _FINEST = 0.012, 64, 16, 64


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

    Differentiable, what is taken and from where held fixed.

    What compressed rows leave out is an error that grows with the light's coefficients, and a sun's are as large in
    fine levels as in coarse ones.

    Args:
        texels: radiance of the texels of a cube map; of d ≤ 16 of them all but one may be a sun's.
    """
    known = jax.lax.stop_gradient(texels)
    largest = jnp.max(jnp.abs(known))
    scaled = known / jnp.where(largest > 0, largest, 1)
    energy = jnp.sum(jnp.square(scaled), axis=1)
    # Behind a barrier, as XLA sorts all texels where it sees that the results are cut.
    top, index = jax.lax.optimization_barrier(jax.lax.top_k(energy, min(MAX_TEXELS + 1, len(energy))))
    limit, top, index = top[-1], top[:-1], index[:-1]
    bright = (top > BRIGHTER**2 * limit) & (top > 0)
    is_sun = jnp.sum(jnp.where(bright, top, 0)) >= SHARE * jnp.sum(energy)
    stays = jnp.where(bright & is_sun, jnp.sqrt(limit / jnp.where(bright, top, 1)), 1.0)[:, None]
    # A product, not a difference: exactly 0 where all stays, however XLA may round.
    rest = texels.at[index].multiply(stays, unique_indices=True)
    return Split(rest, index, texels[index] * (1 - stays))


def without_sun(pixels: Float[Array | np.ndarray, "h w 3"]) -> tuple[Float[Array, "h w 3"], Sky]:
    """A lat-long map without its sun, and the sun as 64 directions.

    Few of those carry light, and none does where there is no sun: light of all maps is of one structure.

    It is looked for in ever coarser cube maps, as a fine map's sun has more than a few pixels: each cell that outshines
    all others gives what it has above them. A cell is one direction where it is smaller than a sun, and several beside
    each other in coarse maps, for soft shadows.

    Linear in the pixels and differentiable, what is taken and from where held fixed.

    Args:
        pixels: radiance.
    """
    known = jax.lax.stop_gradient(pixels)
    if not is_traced(known):
        taken = _find_sun(np.asarray(known))
        if taken is None:
            directions = _Taken.nothing(1, 1).directions
            return as_array(pixels), Sky(*(as_array(x, pixels.dtype) for x in (directions, 0 * directions)))
        return _split(as_array(pixels), *map(as_array, taken))
    h, w = pixels.shape[:2]
    shapes = (h, w), (h, w), (_MAX_DIRECTIONS, 3), (_MAX_DIRECTIONS,), (_MAX_DIRECTIONS,)
    dtypes = pixels.dtype, np.int32, pixels.dtype, np.int32, pixels.dtype
    structure = tuple(jax.ShapeDtypeStruct(*one) for one in zip(shapes, dtypes, strict=True))

    def find(pixels) -> _Taken:
        taken = _find_sun(np.asarray(pixels)) or _Taken.nothing(h, w)
        return _Taken(*(np.asarray(x, one.dtype) for x, one in zip(taken, structure, strict=True)))

    return _split(pixels, *jax.pure_callback(find, structure, known, vmap_method="sequential"))


class _Taken(NamedTuple):
    """What is taken off a map.

    Attributes:
        stays: the share of each pixel's radiance that stays.
        slot: of the sum that takes the rest of each pixel's energy; past their end for pixels that keep all.
        directions: of the sun's light, unit vectors; padded.
        source: the slot whose energy each direction carries a part of.
        share: that part; 0 for padding.
    """

    stays: Float[np.ndarray, "h w"]
    slot: Int[np.ndarray, "h w"]
    directions: Float[np.ndarray, "n 3"]
    source: Int[np.ndarray, " n"]
    share: Float[np.ndarray, " n"]

    @classmethod
    def nothing(cls, h: int, w: int) -> "_Taken":
        """Where there is no sun."""
        n = _MAX_DIRECTIONS
        directions = np.tile([0.0, 1, 0], (n, 1))
        return cls(np.ones((h, w)), np.full((h, w), n), directions, np.zeros(n, int), np.zeros(n))


def _find_sun(pixels: Float[np.ndarray, "h w 3"]) -> _Taken | None:
    """What `without_sun` takes; None where there is no sun."""
    looked = np.asarray(coarsened(pixels, _FINEST))
    rows, columns = looked.shape[:2]
    towards = _towards(np.arange(rows * columns), rows, columns)
    area = np.repeat(latlong.solid_angles(rows, columns), columns)
    flat = np.asarray(looked, float).reshape(-1, 3)
    n = 1 << max(0, int(np.floor(np.log2(rows / 2)))) if rows > 1 else 0
    while n >= min(_COARSEST, rows // 2) > 0:
        cell = cubemap.texel_of(towards, n)
        cell_area = np.maximum(np.bincount(cell, area, 6 * n * n), 1e-30)
        mean = (
            np.stack([np.bincount(cell, area * channel, 6 * n * n) for channel in flat.T], axis=1) / cell_area[:, None]
        )
        split = _brightest(mean) if len(mean) > MAX_TEXELS else None
        if split is not None:
            return _taken(pixels, *split, cell.reshape(rows, columns))
        n //= 2
    return None


def _brightest(texels: Float[np.ndarray, "d c"]) -> tuple[Int[np.ndarray, " n"], float] | None:
    """`split_sun` on the host: the texels of a sun, and the length of the brightest one's radiance that is left."""
    largest = np.abs(texels).max()
    energy = np.square(texels / (largest if largest > 0 else 1)).sum(axis=1)
    order = np.argsort(-energy, kind="stable")[: MAX_TEXELS + 1]
    top, limit = energy[order[:-1]], energy[order[-1]]
    bright = (top > BRIGHTER**2 * limit) & (top > 0)
    if not bright.any() or top[bright].sum() < SHARE * energy.sum():
        return None
    return order[:-1][bright], float(np.sqrt(limit) * largest)


def _taken(
    pixels: Float[np.ndarray, "h w 3"], lit: Int[np.ndarray, " n"], most: float, cells: Int[np.ndarray, "g v"]
) -> _Taken:
    """What a map's pixels in the bright cells have above the brightest that is left.

    Args:
        pixels: radiance.
        lit: the bright cells.
        most: length of the radiance that is left.
        cells: of the map that the sun was found in, the cell of every pixel: a finer pixel is in no other one.
    """
    h, w = pixels.shape[:2]
    flat = pixels.reshape(-1, 3)
    # Few pixels are bright: nothing else of them is computed in double precision for a whole map.
    length = np.sqrt(np.einsum("pc,pc->p", flat, flat, dtype=float))
    here = np.flatnonzero(length > most)
    row, column = np.divmod(here, w)
    cell = cells[row * cells.shape[0] // h, column * cells.shape[1] // w]
    bright = np.isin(cell, lit)
    here, cell = here[bright], cell[bright]
    towards = _towards(here, h, w)
    taken = _Taken.nothing(h, w)
    stays, slot = taken.stays.reshape(-1), taken.slot.reshape(-1)
    stays[here] = most / length[here]
    if np.pi / h <= _APART or len(here) > _MAX_DIRECTIONS:
        # Cells are smaller than a sun, or hold many pixels: one direction each.
        area = latlong.solid_angles(h, w)[here // w]
        energy = ((1 - stays[here]) * area)[:, None] * flat[here]
        for number, lit_cell in enumerate(one for one in lit if one in cell):
            in_cell = cell == lit_cell
            slot[here[in_cell]] = number
            mean = energy[in_cell].sum(axis=1) @ towards[in_cell]
            taken.directions[number] = mean / np.linalg.norm(mean)
            taken.source[number], taken.share[number] = number, 1
        return taken
    # Pixels are larger than a sun: several directions each, as far as there are enough.
    slot[here] = np.arange(len(here))
    along = max(1, min(int(np.ceil(np.pi / h / _APART)), int(np.sqrt(_MAX_DIRECTIONS / max(len(here), 1)))))
    u, v = latlong.coordinates(towards)
    step = (np.arange(along) + 0.5) / along - 0.5
    down, right = (x.ravel() for x in np.meshgrid(step, step, indexing="ij"))
    v, u = v[:, None] + down / h, u[:, None] + right / w
    # Light is shared by solid angle, which differs along a pixel near the poles.
    share = np.sin(np.pi * v)
    share /= share.sum(axis=1, keepdims=True)
    count = share.size
    taken.directions[:count] = latlong.directions(u, v).reshape(-1, 3)
    taken.source[:count], taken.share[:count] = np.repeat(np.arange(len(here)), along**2), share.ravel()
    return taken


@jax.jit
def _split(pixels, stays, slot, directions, source, share) -> tuple[Float[Array, "h w 3"], Sky]:
    h, w, channels = pixels.shape
    area = jnp.asarray(latlong.solid_angles(h, w), pixels.dtype)[:, None, None]
    energy = (pixels * (1 - stays)[..., None] * area).reshape(-1, channels)
    sums = jax.ops.segment_sum(energy, slot.reshape(-1), _MAX_DIRECTIONS)
    irradiance = sums.at[source].get(mode="promise_in_bounds") * share[:, None]
    # A product, not a difference: exactly 0 is taken where all stays.
    return pixels * stays[..., None].astype(pixels.dtype), Sky(directions.astype(pixels.dtype), irradiance)


def _towards(pixel: Int[np.ndarray, " p"], h: int, w: int) -> Float[np.ndarray, "p 3"]:
    """Directions to pixels of a lat-long map, numbered row by row."""
    row, column = np.divmod(pixel, w)
    return latlong.directions((column + 0.5) / w, (row + 0.5) / h)
