"""From linear radiance to what a screen shows: exposure, clamp, sRGB (IEC 61966-2-1)."""

import numpy as np
from numpy.typing import ArrayLike

from jaxrelight.errors import InputError


def srgb_encode(linear: ArrayLike) -> np.ndarray:
    """Encode linear values in [0, 1] with the sRGB transfer curve; outside that range the curve is continued."""
    linear = np.asarray(linear)
    curved = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curved)


def srgb_decode(encoded: ArrayLike) -> np.ndarray:
    """Invert `srgb_encode`."""
    encoded = np.asarray(encoded)
    curved = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, curved)


def tone_map(pixels: ArrayLike, exposure: float = 0.0) -> np.ndarray:
    """Turn radiance into 8-bit sRGB: scale by 2^exposure, clamp to [0, 1], encode, round.

    Args:
        pixels: Linear radiance `[h, w, 3]`; a fourth channel is left out.
        exposure: Stops; 1 doubles the brightness.

    Returns:
        uint8 `[h, w, 3]`. NaN becomes 0, infinity 255.

    Raises:
        InputError: The shape is not that of an image, or `exposure` is not finite.
    """
    pixels = np.asarray(pixels)
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise InputError(f"an image to tone-map has shape [h, w, 3 or 4], not {list(pixels.shape)}")
    if not np.isfinite(exposure):
        raise InputError(f"exposure {exposure} is not a finite number of stops")
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = pixels[..., :3].astype(np.float32) * np.exp2(np.float32(exposure))
    return to_bytes(srgb_encode(to_unit(scaled)))


def to_unit(values: np.ndarray) -> np.ndarray:
    """Clamp to [0, 1], NaN to 0."""
    return np.clip(np.nan_to_num(values, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)


def to_bytes(unit: np.ndarray) -> np.ndarray:
    """Round values in [0, 1] to the nearest of 0…255."""
    return (unit * 255 + 0.5).astype(np.uint8)
