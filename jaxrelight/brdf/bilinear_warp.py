"""Densities on the unit square that are bilinear between grid points, and the map that makes them uniform.

The map sends (x, y) to (share of the row's mass left of x, share of all mass in rows before y). Densities may depend
on further parameters: they, and the sums that the map needs, are then linear between the parameters' values.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.numerics import safe


def sums(density: Float[np.ndarray, "s y x"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `invert` needs of densities [s, y, x], in float64.

    Returns:
        The densities, scaled so that each has mass 1 in units of cells; along each row [s, y, x], and along the row
        masses [s, y], the mass before every grid point.
    """
    density = np.asarray(density, float)
    along = _mass_before(density)
    down = _mass_before(along[..., -1])
    total = down[:, -1]
    return density / total[:, None, None], along / total[:, None, None], down / total[:, None]


def _mass_before(values: np.ndarray) -> np.ndarray:
    """Integral of a piecewise linear function up to each of its points, which are 1 apart."""
    steps = np.cumsum((values[..., 1:] + values[..., :-1]) / 2, axis=-1)
    return np.concatenate([np.zeros_like(values[..., :1]), steps], axis=-1)


def cell(place: Float[Array, ""], count: int) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """The cell of a grid of `count` points over 0 … 1 that a place lies in, and where in it, 0 … 1."""
    place = safe.clamp(place, 0, 1) * (count - 1)
    below = jnp.minimum(jnp.floor(place), count - 2)
    return below.astype(jnp.int32), place - below


def bracket(value: Float[Array, ""], grid: Float[Array, " n"]) -> tuple[Int[Array, "2"], Float[Array, "2"]]:
    """The two entries of an ascending grid around a value and their linear weights; clamped at the ends."""
    if len(grid) == 1:
        return jnp.zeros(2, jnp.int32), jnp.asarray([1.0, 0.0], grid.dtype)
    below = jnp.clip(jnp.searchsorted(grid, value, side="right") - 1, 0, len(grid) - 2)
    low, high = grid[below], grid[below + 1]
    share = safe.clamp((value - low) / (high - low), 0, 1)
    return jnp.stack([below, below + 1]), jnp.stack([1 - share, share])


def look_up(
    values: Float[Array, "s ... y x"],
    x: Float[Array, ""],
    y: Float[Array, ""],
    slices: Int[Array, " k"],
    weights: Float[Array, " k"],
) -> Float[Array, "..."]:
    """Bilinear in x and y within 0 … 1; Σ_k weight_k of the slices."""
    (column, u), (row, v) = cell(x, values.shape[-1]), cell(y, values.shape[-2])
    across = jnp.stack([1 - u, u])
    down = jnp.stack([1 - v, v])
    return jnp.einsum("k,k...ij,i,j->...", weights, _patch(values, slices, row, column), down, across)


def _patch(values, slices, row, column):
    """The four points around a cell in some slices: [k, …, 2, 2]."""
    s, *rest, n_y, n_x = values.shape
    flat = values.reshape(s, -1, n_y * n_x)
    first = row * n_x + column
    places = jnp.stack([first, first + 1, first + n_x, first + n_x + 1])
    picked = flat.at[slices[:, None], :, places].get(mode="promise_in_bounds")
    return jnp.moveaxis(picked, 1, -1).reshape(len(slices), *rest, 2, 2)


def invert(
    density: Float[Array, "s y x"],
    along: Float[Array, "s y x"],
    down: Float[Array, "s y"],
    x: Float[Array, ""],
    y: Float[Array, ""],
    slices: Int[Array, " k"],
    weights: Float[Array, " k"],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Where the map sends (x, y) under Σ_k weight_k density_k; arrays as `sums` makes them."""
    _, n_y, n_x = density.shape
    (column, u), (row, v) = cell(x, n_x), cell(y, n_y)
    rows = jnp.stack([row, row + 1])

    def mixed(values):
        return jnp.tensordot(weights, values, axes=1)

    left, right = jnp.stack([1 - v, v]) @ mixed(_patch(density, slices, row, column))
    before = jnp.stack([1 - v, v]) @ mixed(along.at[slices[:, None], rows, column].get(mode="promise_in_bounds"))
    above, below = mixed(along.at[slices[:, None], rows, n_x - 1].get(mode="promise_in_bounds"))
    in_row = (1 - v) * above + v * below
    has_mass = in_row > 0
    share = jnp.where(has_mass, before + u * (left + u * (right - left) / 2), 0) / jnp.where(has_mass, in_row, 1)
    passed = mixed(down.at[slices, row].get(mode="promise_in_bounds"))
    return share, passed + v * (above + v * (below - above) / 2)
