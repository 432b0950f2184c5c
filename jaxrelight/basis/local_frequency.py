"""How fast an image varies around each of its pixels, by Daubechies wavelets (Bagher 2011 §2.4 and appendix A)."""

import numpy as np
from jaxtyping import Float
from scipy import ndimage

# ε of the appendix: what finer levels may add up to, of the largest, before they count.
_THRESHOLD = 0.01
_WAVELET = "db4"
# Levels by which the grid of a level's details is finer than that of its coefficients.
_FINER = 2
# Places of a grid that a coefficient of many levels stands after the middle of its pixels, of one level half of it.
_DELAY = 2.5


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
    height, width, _ = image.shape
    contrast = _contrast(image)
    largest = np.zeros((1, 1), np.float32)
    for level in reversed(range(len(contrast))):
        largest = np.maximum(_as_fine(largest, contrast[level].shape), 2.0 ** (level + 1) * contrast[level])
    # Rounding is no detail.
    least = 1e-6 * np.abs(image).max() if image.size else 0
    frequency = np.zeros((height, width))
    size_sum, contrast_sum = np.zeros((2, height, width), np.float32)
    for level, part in enumerate(contrast):
        full = _as_fine(part, (height, width))
        contrast_sum += full
        size_sum += np.float32(2.0 ** (level + 1)) * full
        counts = (size_sum >= threshold * largest) & (contrast_sum > least) & (frequency == 0)
        frequency[counts] = 0.5 ** (1.5 + level)
    return frequency


def _contrast(image: Float[np.ndarray, "h w c"]) -> list[Float[np.ndarray, "g v"]]:
    """Details of each level, the finest first, largest of all channels and within half a wavelength.

    A level's are on the grid of the second finer one, on which a wave has eight pixels or more: on that of the image,
    the same details would take an image for every level.
    """
    import pywt

    height, width, channels = image.shape
    contrast, coarse = [], [np.asarray(image[..., c], float) for c in range(channels)]
    for level in range(int(np.log2(min(height, width)))):
        largest = np.float32(0)
        for c in range(channels):
            coarse[c], details = pywt.dwt2(coarse[c], _WAVELET, "periodization")
            detail = pywt.idwt2((None, details), _WAVELET, "periodization")
            for _ in range(min(level, _FINER)):
                detail = pywt.idwt2((detail, (None,) * 3), _WAVELET, "periodization")
            largest = np.maximum(largest, np.abs(detail, out=detail).astype(np.float32))
        # Each level of orthonormal wavelets doubles what stands for a value.
        finer = min(level, _FINER)
        steps = level - finer
        grid = ndimage.maximum_filter(np.float32(0.5**steps) * largest, 2 ** (finer + 1) + 1, mode="wrap")
        # They are not symmetric: what stands at a place of the grid is of pixels before it.
        contrast.append(np.roll(grid, -round(_DELAY * (1 - 0.5**steps)), axis=(0, 1)))
    return contrast


def _as_fine(grid: Float[np.ndarray, "g v"], shape: tuple[int, ...]) -> Float[np.ndarray, "h w"]:
    """Each value for all pixels of a finer grid that it stands for."""
    return grid.repeat(shape[0] // grid.shape[0], axis=0).repeat(shape[1] // grid.shape[1], axis=1)


def mirrored(image: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "g v c"]:
    """The image four times, mirrored at its right and lower borders, so that it fits itself when it is repeated."""
    wide = np.concatenate([image, image[:, ::-1]], axis=1)
    return np.concatenate([wide, wide[::-1]], axis=0)


def around_sphere(latlong: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "g w c"]:
    """A lat-long map, and below it what follows beyond its lower pole: repeated, it is continuous in all directions."""
    return np.concatenate([latlong, np.roll(latlong[::-1], latlong.shape[1] // 2, axis=1)], axis=0)
