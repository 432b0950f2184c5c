"""Small arguments that entries share."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import functools
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxrelight.brdf import lobes
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture
from jaxrelight.gradients.entry import Singular, Slope

# Unit vectors above the surface, at no special place.
OMEGA_I, OMEGA_O = np.array([0.36, -0.48, 0.8]), np.array([-0.48, -0.36, 0.8])
NORMAL, ALONG_X, ZERO = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.zeros(3)


def numbers(*shape: int, low: float = 0.1, high: float = 1.0) -> Float[np.ndarray, "..."]:
    """Numbers between two others, the same for the same shape."""
    return np.random.default_rng(shape).uniform(low, high, shape)


def scalar(value: float) -> Float[np.ndarray, ""]:
    """A number as an array."""
    return np.full((), value, float)


def in_argument(number: int, by: Any, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """A direction in one of the arguments alone."""
    nothing = jax.tree.map(np.zeros_like, arguments)
    return (*nothing[:number], by, *nothing[number + 1 :])


def at_point(where: str, arguments: tuple[Any, ...], number: int, by: Any, slope: Slope = "smooth") -> Singular:
    """A singular point along a direction in one of the arguments."""
    return Singular(where, arguments, in_argument(number, by, arguments), slope)


@functools.cache
def two_lobes() -> lobes.LobeSum:
    """A diffuse part, a lobe that is shared by the channels' and is turned, and one that is nearly Lambert's."""
    made = [lobes.lobe([-1, -0.8, 0.9], 6.5, peak=[0.5, 0.3, 0.2]), lobes.lobe([-0.7, -0.9, 1], 1.7, peak=0.2)]
    return lobes.lobe_sum([0.3, 0.2, 0.1], made, turn=0.4)


@functools.cache
def lobe_maps() -> SpatialLobes:
    """Lobes of 4×4 texels."""
    angle = numbers(4, 4)
    C = numbers(4, 4, 2, 3) * np.array([-1, -1, 1])
    maps = (
        numbers(4, 4, 3, high=0.5),
        C / np.abs(C).max(axis=-1, keepdims=True),
        numbers(4, 4, 2, low=2, high=20),
        numbers(4, 4, 2, 3),
        np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=-1),
    )
    return SpatialLobes(*(one.astype(np.float32) for one in maps))


@functools.cache
def texture() -> Texture:
    """An image of 4×4 texels with all coarser levels."""
    return Texture(numbers(4, 4, 3).astype(np.float32)).minified()
