"""Separable factors of a BRDF by singular value decomposition (Wang 2006 §3.3)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.linalg
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.errors import InputError


class Factored(Reflection):
    """k light maps and k view maps over the disc of projected directions (eq. 10), looked up bilinearly.

    Map texels are in the order y, x of the local direction's (x + 1)/2, (y + 1)/2.
    """

    light_maps: Float[Array, "k c1 r r"]
    view_maps: Float[Array, "k c r r"]

    @property
    def channels(self) -> int:
        """Channels of the light maps: 1 for a BRDF that is the same in all directions, whose colour is the view's."""
        return self.light_maps.shape[1]

    @property
    def terms(self) -> int:
        """k, the number of maps of a side."""
        return self.light_maps.shape[0]

    def light_side(self, omega_i: Float[Array, "3"]) -> Float[Array, "k c"]:
        """g_k(ω_i)."""
        return _look_up(self.light_maps, omega_i)

    def view_side(self, omega_o: Float[Array, "3"]) -> Float[Array, "k c"]:
        """h_k(ω_o)."""
        return _look_up(self.view_maps, omega_o)

    @property
    def per_receiver(self) -> "Factored":
        """All receivers share the maps."""
        return Factored(False, False)  # pyright: ignore[reportArgumentType]


def _look_up(maps: Float[Array, "k c r r"], omega: Float[Array, "3"]) -> Float[Array, "k c"]:
    k, c, r, _ = maps.shape
    if r == 1:
        return maps[:, :, 0, 0]
    flat = maps.reshape(k, c, r * r)
    x, y = ((omega[axis] + 1) * (r / 2) - 0.5 for axis in (0, 1))
    column, row = (jnp.clip(jnp.floor(p), 0, r - 2) for p in (x, y))
    u, v = jnp.clip(x - column, 0, 1), jnp.clip(y - row, 0, 1)
    corner = (row * r + column).astype(jnp.int32)

    # As a polynomial of u and v, whose four coefficients lie at one place, it takes two thirds of the time of four
    # corners blended.
    right, below = jnp.roll(flat, -1, axis=-1), jnp.roll(flat, -r, axis=-1)
    both = jnp.roll(below, -1, axis=-1) - below - right + flat

    def at_corner(table):
        return table.at[:, :, corner].get(mode="promise_in_bounds")

    return at_corner(flat) + u * at_corner(right - flat) + v * (at_corner(below - flat) + u * at_corner(both))


def factor(brdf: Brdf, terms: int = 4, resolution: int = 48) -> Factored:
    """The best `terms` products of a BRDF sampled on a disc, for each channel by itself.

    Directions are sampled at the texel centres of a resolution² map of the unit disc (§4). On the disc, equal areas
    are equal projected solid angles, so the error that the SVD minimises is weighted by both cosines. √σ goes to
    either side. Texels beyond the disc's edge, which bilinear look-ups near the horizon touch, are continued by
    applying the BRDF at the edge to the other side's singular vectors (Nyström's extension). A BRDF that is the same
    in all directions becomes one term of one texel, exactly. Not differentiable: the maps are.

    Raises:
        InputError: if more terms are asked for than the disc has directions.
    """
    if brdf.is_constant:
        up = jnp.asarray([0.0, 0.0, 1.0])
        value = brdf.evaluate(up, up)[None, :, None, None]
        return Factored(jnp.ones_like(value[:, :1]), value)
    centre = (np.arange(resolution) + 0.5) * (2 / resolution) - 1
    x, y = (grid.ravel() for grid in np.meshgrid(centre, centre))
    radius = np.hypot(x, y)
    inside = radius < 1
    if not 1 <= terms <= inside.sum():
        raise InputError(f"{terms} terms cannot be had from {inside.sum()} directions; ask for fewer")
    shrink = np.where(inside, 1, (1 - 1e-6) / radius)
    x, y = x * shrink, y * shrink
    omega = jnp.asarray(np.stack([x, y, np.sqrt(np.maximum(0, 1 - x * x - y * y))], axis=-1))
    matrix = _sampled(brdf, omega, omega[inside])
    light_rest = _sampled(brdf, omega[~inside], omega[inside])
    view_rest = _sampled(brdf, omega[inside], omega[~inside])

    light = np.zeros((terms, len(matrix), resolution**2))
    view = np.zeros_like(light)
    for c in range(len(matrix)):
        same = next((b for b in range(c) if np.array_equal(matrix[b], matrix[c])), None)
        if same is not None:
            light[:, c], view[:, c] = light[:, same], view[:, same]
            continue
        u, sigma, v = _largest_singular(matrix[c][inside], terms)
        root = np.sqrt(sigma)
        over_root = np.where(sigma > 1e-12 * sigma[0], 1 / np.where(root > 0, root, 1), 0)
        light[:, c, inside] = root[:, None] * u.T
        view[:, c, inside] = root[:, None] * v.T
        light[:, c, ~inside] = over_root[:, None] * (light_rest[c] @ v).T
        view[:, c, ~inside] = over_root[:, None] * (view_rest[c].T @ u).T
    shape = (terms, len(matrix), resolution, resolution)
    return Factored(jnp.asarray(light.reshape(shape), omega.dtype), jnp.asarray(view.reshape(shape), omega.dtype))


def _sampled(brdf: Brdf, omega_i: Array, omega_o: Array) -> np.ndarray:
    """BRDF values [c, i, o]."""
    over_o = jax.vmap(brdf.evaluate, in_axes=(None, 0))
    values = jax.jit(lambda i, o: jax.lax.map(lambda one: over_o(one, o), i))(omega_i, omega_o)
    return np.moveaxis(np.asarray(values, float), -1, 0)


def _largest_singular(matrix: np.ndarray, terms: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(u [m, k], σ [k] descending, v [n, k]), with signs such that every u sums to no less than 0."""
    if terms > min(matrix.shape) // 4:
        u, sigma, vt = np.linalg.svd(matrix)
        u, sigma, vt = u[:, :terms], sigma[:terms], vt[:terms]
    else:
        found: Any = scipy.sparse.linalg.svds(matrix, terms, v0=np.ones(min(matrix.shape)), rng=0)
        u, sigma, vt = found[0][:, ::-1], found[1][::-1], found[2][::-1]
    sign = np.where(u.sum(axis=0) < 0, -1, 1)
    return u * sign, sigma, vt.T * sign
