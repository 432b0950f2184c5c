"""How fast an image varies around each of its pixels, by Daubechies wavelets (Bagher 2011 §2.4 and appendix A)."""

import numpy as np
from jaxtyping import Float
from scipy import ndimage

# ε of the appendix: what finer levels may add up to, of the largest, before they count.
_THRESHOLD = 0.01
_WAVELET = "db4"


def local_frequency(image: Float[np.ndarray, "h w c"], threshold: float = _THRESHOLD) -> Float[np.ndarray, "h w"]:
    """The highest frequency around each pixel, in cycles per pixel: 0, or up to √½ / 2.

    The image is repeated beyond its borders: lay it out so that it fits itself, see `mirrored`. Its details of each
    level of the wavelet pyramid, largest within half a wavelength, are what the coefficients involved in a pixel are;
    the middle of a level's octave is 2^−h / √2, h = 1 the finest. Levels are left out from the finest on while their
    sum stays below the threshold of the largest, counted as by the appendix, where a level of the same contrast as the
    next finer one is twice as large.

    Args:
        image: of sides that are powers of two.
        threshold: ε.
    """
    import pywt

    height, width, _ = image.shape
    count = int(np.log2(min(height, width)))
    contrast, coarse = np.zeros((count, height, width), np.float32), np.asarray(image, float)
    for level in range(count):
        coarse, details = pywt.dwt2(coarse, _WAVELET, "periodization", axes=(0, 1))
        detail = pywt.idwt2((None, details), _WAVELET, "periodization", axes=(0, 1))
        for _ in range(level):
            detail = pywt.idwt2((detail, (None,) * 3), _WAVELET, "periodization", axes=(0, 1))
        contrast[level] = ndimage.maximum_filter(np.abs(detail).max(axis=2), 2 ** (level + 1) + 1, mode="wrap")
    size = contrast * (2.0 ** np.arange(1, count + 1, dtype=np.float32))[:, None, None]
    # Rounding is no detail.
    least = 1e-6 * np.abs(image).max() if image.size else 0
    counts = (np.cumsum(size, axis=0) >= threshold * size.max(axis=0)) & (np.cumsum(contrast, axis=0) > least)
    return np.where(counts.any(axis=0), 0.5 ** (1.5 + np.argmax(counts, axis=0)), 0)


def mirrored(image: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "g v c"]:
    """The image four times, mirrored at its right and lower borders, so that it fits itself when it is repeated."""
    wide = np.concatenate([image, image[:, ::-1]], axis=1)
    return np.concatenate([wide, wide[::-1]], axis=0)


def around_sphere(latlong: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "g w c"]:
    """A lat-long map, and below it what follows beyond its lower pole: repeated, it is continuous in all directions."""
    return np.concatenate([latlong, np.roll(latlong[::-1], latlong.shape[1] // 2, axis=1)], axis=0)
