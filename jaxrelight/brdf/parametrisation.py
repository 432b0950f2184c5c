"""Square maps over the hemisphere of local directions (Wang 2006 §3.3.2)."""

import abc
import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.numerics import safe


class Place(NamedTuple):
    """A texel, and how far a direction is from its centre towards the next column (u) and row (v), in 0 … 1.

    The next column after the last is the first; the row is never the last.
    """

    row: Int[Array, ""]
    column: Int[Array, ""]
    u: Float[Array, ""]
    v: Float[Array, ""]


class Parametrisation(eqx.Module):
    """A side × side map over the hemisphere, its texels numbered row by row (y, x), looked up bilinearly."""

    @abc.abstractmethod
    def directions(self, side: int) -> tuple[Float[np.ndarray, "t 3"], Bool[np.ndarray, " t"]]:
        """The direction of every texel's centre, and whether it lies on the map's hemisphere.

        A texel off the hemisphere, which look-ups near the horizon touch, has the nearest direction at its edge.
        """

    @abc.abstractmethod
    def measure(self, side: int) -> Float[np.ndarray, " t"]:
        """Projected solid angle cosθ dω of every texel, up to a common factor."""

    @abc.abstractmethod
    def place(self, omega: Float[Array, "3"], side: int) -> Place:
        """Where a direction lies between the texels' centres; side is at least 2."""

    def corners(self, omega: Float[Array, "3"], side: int) -> tuple[Int[Array, "4"], Float[Array, "4"]]:
        """The four texels around a direction and their bilinear weights."""
        row, column, u, v = self.place(omega, side)
        right = (column + 1) % side
        texels = jnp.stack(
            [row * side + column, row * side + right, (row + 1) * side + column, (row + 1) * side + right]
        )
        return texels, jnp.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])


class Disc(Parametrisation):
    """x = (ω·s + 1)/2, y = (ω·t + 1)/2 (eq. 10): equal areas are equal projected solid angles."""

    def directions(self, side: int) -> tuple[Float[np.ndarray, "t 3"], Bool[np.ndarray, " t"]]:
        """Directions of every texel; one in a corner has that a twentieth of a texel within the edge before it.

        At the edge itself some BRDFs are without bound, and between it and the outermost texels others have roots.
        """
        centre = (np.arange(side) + 0.5) * (2 / side) - 1
        x, y = (grid.ravel() for grid in np.meshgrid(centre, centre))
        radius = np.hypot(x, y)
        inside = radius < 1
        shrink = np.where(inside, 1, (1 - 0.1 / side) / np.maximum(radius, 1))
        x, y = x * shrink, y * shrink
        return np.stack([x, y, np.sqrt(np.maximum(0, 1 - x * x - y * y))], axis=-1), inside

    def measure(self, side: int) -> Float[np.ndarray, " t"]:
        """The same for all."""
        return np.ones(side * side)

    def place(self, omega: Float[Array, "3"], side: int) -> Place:
        """Clamped at the map's border."""
        x, y = ((omega[axis] + 1) * (side / 2) - 0.5 for axis in (0, 1))
        column, row = (jnp.clip(jnp.floor(p), 0, side - 2) for p in (x, y))
        u, v = safe.clamp(x - column, 0, 1), safe.clamp(y - row, 0, 1)
        return Place(row.astype(jnp.int32), column.astype(jnp.int32), u, v)


class Polar(Parametrisation):
    """x = atan2(ω·s, ω·t) / 2π, y = √(1 − ω·n) (eq. 11): periodic in x, the pole at y = 0, the horizon at y = 1."""

    def directions(self, side: int) -> tuple[Float[np.ndarray, "t 3"], Bool[np.ndarray, " t"]]:
        """Directions of every texel; all lie on the hemisphere."""
        centre = (np.arange(side) + 0.5) / side
        azimuth, y = (grid.ravel() for grid in np.meshgrid(2 * np.pi * centre, centre))
        sine = y * np.sqrt(2 - y * y)
        omega = np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), 1 - y * y], axis=-1)
        return omega, np.ones(side * side, bool)

    def measure(self, side: int) -> Float[np.ndarray, " t"]:
        """cosθ dω = (1 − y²) 2y dy dx."""
        y = (np.arange(side) + 0.5) / side
        return np.repeat(2 * y * (1 - y * y), side)

    def place(self, omega: Float[Array, "3"], side: int) -> Place:
        """Around the circle in x; clamped at the pole and at the horizon in y."""
        pole = (omega[0] == 0) & (omega[1] == 0)
        x = jnp.arctan2(omega[0], jnp.where(pole, 1, omega[1])) * (side / (2 * math.pi)) - 0.5
        y = jnp.sqrt(jnp.maximum(1 - omega[2], 1e-12)) * side - 0.5
        column, row = jnp.floor(x), jnp.clip(jnp.floor(y), 0, side - 2)
        u, v = x - column, safe.clamp(y - row, 0, 1)
        return Place(row.astype(jnp.int32), column.astype(jnp.int32) % side, u, v)


DISC, POLAR = Disc(), Polar()
# By the names that files call them.
PARAMETRISATIONS: dict[str, Parametrisation] = {"disc": DISC, "polar": POLAR}


def name_of(parametrisation: Parametrisation) -> str:
    """What files call a parametrisation."""
    return next(name for name, one in PARAMETRISATIONS.items() if type(one) is type(parametrisation))


def look_up(
    parametrisation: Parametrisation, maps: Float[Array, "k c r r"], omega: Float[Array, "3"]
) -> Float[Array, "k c"]:
    """The maps' values in a direction. A map of one texel is a constant."""
    k, c, side, _ = maps.shape
    if side == 1:
        return maps[:, :, 0, 0]
    row, column, u, v = parametrisation.place(omega, side)
    # As a polynomial of u and v, whose four coefficients lie at one place, it takes two thirds of the time of four
    # corners blended.
    right, below = jnp.roll(maps, -1, axis=-1), jnp.roll(maps, -1, axis=-2)
    both = jnp.roll(below, -1, axis=-1) - below - right + maps

    def here(table):
        return table.reshape(k, c, side * side).at[:, :, row * side + column].get(mode="promise_in_bounds")

    return here(maps) + u * here(right - maps) + v * (here(below - maps) + u * here(both))
