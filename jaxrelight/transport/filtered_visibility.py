"""Visibility filtered by lobes: how much of a lobe around any direction reaches a receiver, from a few dozen bytes.

Glossy light is nearly the lobe's mean radiance times the share of the lobe that nothing blocks: filtered light ×
filtered visibility. Of visibility each receiver keeps signed angles to where it changes, at a few directions of the
world (Wang et al. 2009). They follow from geometry alone, so that a material is changed without them, and vary
linearly between receivers.

Axes: r receivers, m receivers of a group, s directions of the grid, f directions that were traced.
"""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Int8, UInt8

from jaxrelight.basis import cube_grid
from jaxrelight.transport.bake import Directions, unpack

# Cells along an edge of the grid's cube: 56 bytes a receiver.
CELLS = 3
# Angles are kept up to this one, in radians, beyond which no lobe reaches far.
MAX_ANGLE = 1.5
_MAX_CODE = 127
# Traced directions are compared in squares of so many to a side, in angles of so many steps to a radian.
_POOLED, _STEPS = 2, 10_000


@functools.partial(jax.jit, static_argnames="cells")
def visibility_distances(
    bits: UInt8[Array | np.ndarray, "m bytes"],
    frames: Float[Array | np.ndarray, "m 3 3"],
    directions: Directions,
    cells: int = CELLS,
) -> Int8[Array, "m s"]:
    """Codes of each receiver's signed angles: to the nearest direction that is blocked, less to the nearest open one.

    Only directions above the receiver's horizon count, so that a direction below it has the angles that lie nearest
    above. The angle is positive where the receiver sees the sky, and 0 at the edge of what blocks it.

    Args:
        bits: visibility of the directions, lowest bit first.
        frames: whose third row is the normal.
        directions: that were traced.
        cells: of the grid; see `basis.cube_grid`.
    """
    side = round((len(directions.vectors) // 6) ** 0.5)
    pool = _POOLED if side >= 16 * _POOLED else 1

    def in_squares(values):
        return values.reshape(-1, 6, side // pool, pool, side // pool, pool)

    def is_any(values):
        return jnp.any(in_squares(values), axis=(3, 5)).reshape(len(bits), -1)

    centres = jnp.sum(in_squares(directions.vectors.T), axis=(3, 5)).reshape(3, -1)
    centres = centres / jnp.linalg.norm(centres, axis=0, keepdims=True)
    grid = jnp.asarray(cube_grid.directions(cells), centres.dtype)
    cosines = jnp.clip(jnp.matmul(grid, centres, precision="highest"), -1, 1)
    # Whole numbers of 16 bits: the loop below is bound by what it reads.
    angles = jnp.rint(jnp.arccos(cosines) * _STEPS).astype(jnp.int16).T
    above = jnp.matmul(jnp.asarray(frames)[:, 2], directions.vectors.T, precision="highest") > 0
    visible = unpack(jnp.asarray(bits), jnp.float32) > 0
    is_open, is_blocked = is_any(above & visible), is_any(above & ~visible)
    furthest = jnp.asarray(round(math.pi * _STEPS), jnp.int16)

    def nearer(square, nearest):
        """The nearest of all squares so far, for all receivers and directions of the grid."""
        return tuple(
            jnp.minimum(angle, jnp.where(of[:, square, None], angles[square][None], furthest))
            for angle, of in zip(nearest, (is_open, is_blocked), strict=True)
        )

    none = jnp.full((len(bits), len(grid)), furthest)
    to_open, to_blocked = jax.lax.fori_loop(0, len(angles), nearer, (none, none))
    signed = (to_blocked.astype(jnp.float32) - to_open) / (_STEPS * MAX_ANGLE)
    return jnp.rint(jnp.clip(signed, -1, 1) * _MAX_CODE).astype(jnp.int8)


class FilteredVisibility(eqx.Module):
    """Signed angles to where the visibility of receivers changes, in codes of 8 bits.

    Attributes:
        codes: of the angles in the directions of a `basis.cube_grid`, 127 for `MAX_ANGLE`.
        cells: of the grid.
    """

    codes: Int8[Array, "r s"]
    cells: int = eqx.field(static=True, default=CELLS)

    @property
    def nbytes(self) -> int:
        """Bytes that are held."""
        return self.codes.nbytes

    def share(
        self,
        receivers: Int[Array, " b"],
        weights: Float[Array, " b"],
        direction: Float[Array, "3"],
        exponent: Float[Array, ""],
    ) -> Float[Array, ""]:
        """v(p, n): the share of the lobe max(0, p·ω)ⁿ that reaches a point between receivers, from 0 to 1.

        Edges are taken to be straight near the lobe, which is nearly a Gaussian: v = (1 + erf(d √((n + 1)/2)))/2, d the
        signed angle in the lobe's direction. Differentiable in weights, direction and exponent.

        Args:
            receivers: between which the point lies, by number.
            weights: theirs.
            direction: p, a unit vector of the world.
            exponent: n.
        """
        points, shares = cube_grid.bilinear(direction, self.cells)
        place = receivers[:, None] * self.codes.shape[1] + points[None]
        codes = self.codes.reshape(-1).at[place].get(mode="promise_in_bounds").astype(direction.dtype)
        angle = jnp.sum(weights[:, None] * codes * shares[None]) * (MAX_ANGLE / _MAX_CODE)
        return (1 + jax.lax.erf(angle * jnp.sqrt((exponent + 1) / 2))) / 2
