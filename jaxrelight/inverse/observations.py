"""Pictures as a solver takes them: which pixels count, what they show, and how exact they are."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

# Pixels that show a surface in less than this share are left out.
_MIN_ALPHA = 0.999

Picture = Float[Array | np.ndarray, "h w c"]


class Observed(eqx.Module):
    """Some pixels of one picture.

    Attributes:
        pixels: their places in the flattened picture.
        radiance: what they show.
        weight: 1 over the standard deviation of each number, up to a common factor.
    """

    pixels: Int[Array, " p"]
    radiance: Float[Array, "p 3"]
    weight: Float[Array, "p 3"]

    def misfit(self, radiance: Float[Array, "h w 3"]) -> Float[Array, "p 3"]:
        """Weighted differences of a rendered picture from what is observed."""
        return (self.rendered(radiance) - self.radiance) * self.weight

    def rendered(self, radiance: Float[Array, "h w 3"]) -> Float[Array, "p 3"]:
        """A rendered picture at the pixels."""
        return radiance.reshape(-1, 3).at[self.pixels].get(mode="promise_in_bounds")


class Observations(eqx.Module):
    """The pixels of all pictures.

    Attributes:
        used: of each picture, the pixels that are fitted.
        held_out: those that are not, by which the fit is judged.
        saturated: numbers that were left out because they are at the top of a picture's range.
    """

    used: tuple[Observed, ...]
    held_out: tuple[Observed, ...]
    saturated: int = eqx.field(static=True)

    @property
    def count(self) -> int:
        """Numbers that are fitted."""
        return sum(int(np.count_nonzero(np.asarray(one.weight))) for one in self.used)


def observe(
    pictures: Sequence[Picture],
    alphas: Sequence[Float[np.ndarray, "h w"]],
    masks: Sequence[np.ndarray | None] | None,
    deviations: Sequence[Picture | float] | None,
    saturation: float | None,
    hold_out: float,
    seed: int,
) -> Observations:
    """Chooses pixels and weights.

    Args:
        pictures: linear radiance; a fourth channel is not read.
        alphas: of the views, the share of each pixel that shows a surface.
        masks: of the pixels that count; None for all.
        deviations: standard deviations of what pixels show; None where they are not known and the same for all.
        saturation: radiance from which a channel of a pixel is left out; None for none.
        hold_out: share of the pixels that is not fitted, from 0 to below 1.
        seed: of their choice.

    Raises:
        InputError: for pictures that do not fit the views, numbers that are not finite, or nothing to be fitted.
    """
    if not 0 <= hold_out < 1:
        raise InputError(f"the share of pixels that is held out is {hold_out:g}; it must be from 0 to below 1")
    random, used, held_out, saturated = np.random.default_rng(seed), [], [], 0
    for number, (given, alpha) in enumerate(zip(pictures, alphas, strict=True)):
        picture, name = np.asarray(given), f"picture {number + 1}"
        if picture.ndim != 3 or picture.shape[:2] != alpha.shape or picture.shape[2] < 3:
            raise InputError(
                f"{name} has the shape {picture.shape}; its view shows {alpha.shape[0]} × {alpha.shape[1]}"
            )
        picture = picture[..., :3].astype(np.float32)
        mask = alpha >= _MIN_ALPHA
        own = None if masks is None else masks[number]
        if own is not None:
            if np.shape(own) != alpha.shape:
                raise InputError(f"the mask of {name} has the shape {np.shape(own)}, and the picture {alpha.shape}")
            mask = mask & np.asarray(own, bool)
        if not np.isfinite(picture[mask]).all():
            raise InputError(f"{name} has pixels that are not finite; leave them out by a mask")
        weight = np.ones_like(picture)
        if deviations is not None:
            sigma = np.broadcast_to(np.asarray(deviations[number], np.float32), picture.shape)
            if not (sigma[mask] > 0).all():
                raise InputError(f"the standard deviations of {name} must be above 0")
            weight = 1 / np.where(sigma > 0, sigma, 1)
        if saturation is not None:
            too_bright = (picture >= saturation) & mask[..., None]
            weight, saturated = np.where(too_bright, 0, weight), saturated + int(too_bright.sum())
        pixels = random.permutation(np.flatnonzero(mask))
        # As many for every seed, so that nothing is compiled for another one.
        count = int(hold_out * len(pixels))
        for of, list_ in ((np.sort(pixels[count:]), used), (np.sort(pixels[:count]), held_out)):
            rows = picture.reshape(-1, 3)[of], weight.reshape(-1, 3)[of].astype(np.float32)
            list_.append(Observed(as_array(of.astype(np.int32)), *(as_array(row) for row in rows)))
    if not sum(np.count_nonzero(np.asarray(one.weight)) for one in used):
        raise InputError("no pixel of the pictures is left to be fitted; look at the masks and at what the views show")
    return Observations(tuple(used), tuple(held_out), saturated)


def relative_residual(observed: Sequence[Observed], rendered: Sequence[Float[np.ndarray, "h w 3"]]) -> float | None:
    """Root mean square of what is missed, weighted as the fit, over that of what is shown; None without pixels."""
    missed, shown = 0.0, 0.0
    for one, radiance in zip(observed, rendered, strict=True):
        pixels, target, weight = (np.asarray(part) for part in (one.pixels, one.radiance, one.weight))
        missed += float(np.sum(((radiance.reshape(-1, 3)[pixels] - target) * weight) ** 2))
        shown += float(np.sum((target * weight) ** 2))
    return float(np.sqrt(missed / shown)) if shown else None
