"""How far an image is from its reference."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jaxrelight.errors import InputError


@dataclass(frozen=True)
class ImageError:
    """Result of `image_error`; every field is relative, so 0.01 is one percent.

    Attributes:
        trimmed: Relative L2 without the pixels that differ most; the one that targets are set on.
        untrimmed: Relative L2 over every covered pixel.
        mean_ratio: Mean of ours over mean of the reference; below 1 is too dark.
    """

    trimmed: float
    untrimmed: float
    mean_ratio: float

    def __str__(self) -> str:
        return f"relative L2 {self.trimmed:.4f} trimmed, {self.untrimmed:.4f} in all; mean ratio {self.mean_ratio:.4f}"


def image_error(ours: ArrayLike, reference: ArrayLike, alpha_above: float = 0.999, trim: float = 0.05) -> ImageError:
    """Compare RGB over the pixels that the reference covers: ‖ours − reference‖ / ‖reference‖.

    The trimmed figure leaves a fraction `trim` of the pixels, those with the largest |ours − reference|, out of both
    norms, so that a few edge pixels, sampled differently, do not hide the rest. A NaN in ours makes both figures NaN.

    Args:
        ours: Image `[h, w, 3 or 4]`; its alpha is not used.
        reference: Image `[h, w, 4]`, or `[h, w, 3]` where every pixel counts.
        alpha_above: A pixel counts where the reference's alpha is greater.
        trim: Fraction left out, in [0, 1).

    Raises:
        InputError: The images differ in size, nothing is covered, or the covered reference is black.
    """
    ours, reference = (_as_image(image, name) for image, name in ((ours, "our image"), (reference, "the reference")))
    if ours.shape[:2] != reference.shape[:2]:
        (h, w), (reference_h, reference_w) = ours.shape[:2], reference.shape[:2]
        raise InputError(f"our image is {w}x{h}, the reference {reference_w}x{reference_h}; render at the same size")
    if not 0 <= trim < 1:
        raise InputError(f"trim must be in [0, 1), not {trim}")

    covered = reference[..., 3] > alpha_above if reference.shape[2] == 4 else np.ones(reference.shape[:2], bool)
    got, wanted = ours[covered][:, :3], reference[covered][:, :3]
    if not covered.any():
        raise InputError(f"no pixel of the reference has alpha above {alpha_above}; nothing can be compared")
    if not wanted.any():
        raise InputError("the reference is black where it is covered; a relative error needs some light in it")

    with np.errstate(all="ignore"):
        difference = got - wanted
        distance = np.linalg.norm(difference, axis=-1)
        keep = distance <= np.quantile(distance, 1 - trim)
        return ImageError(
            trimmed=_ratio(difference[keep], wanted[keep]),
            untrimmed=_ratio(difference, wanted),
            mean_ratio=float(got.mean() / wanted.mean()),
        )


def _ratio(difference: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(difference) / np.linalg.norm(wanted))


def _as_image(image, name: str) -> np.ndarray:
    image = np.asarray(image, dtype=np.float64)
    if image.ndim != 3 or image.shape[2] not in (3, 4):
        raise InputError(f"{name} has shape {list(image.shape)}; [h, w, 3 or 4] is needed")
    return image
