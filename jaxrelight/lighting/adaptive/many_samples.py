"""The reference of adaptive lighting: many samples of each of a few pixels."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.lighting.adaptive.view import AdaptiveView
from jaxrelight.lighting.picture_error import drawn_pixels
from jaxrelight.lighting.reference import Reference
from jaxrelight.numerics.random_numbers import MAX_POINTS

# Samples of a pixel, and the seed that draws them; those of users and of trials are others.
SAMPLES, _SEED = min(2048, MAX_POINTS), -3
# What samples bring about, as messages call it.
MEANS = "samples and what lies between"


class ManySamples(Reference):
    """Many samples of a few of a picture's pixels, whatever its plan."""

    name = f"{SAMPLES:,} samples a pixel"

    def __init__(self, relighter: Any, view: AdaptiveView, count: int, seed: int):
        """Chooses the pixels.

        Args:
            relighter: an `AdaptiveRelighter`.
            view: whose pixels.
            count: of the sample.
            seed: of their choice.
        """
        self._relighter = relighter
        (h, w), factor = view.shape, view.factor
        fine = np.asarray(view.surfaces.covered).reshape(h, factor, w, factor)
        shown = np.flatnonzero(fine.any(axis=(1, 3)))
        self.pixels = drawn_pixels(shown, count, seed)
        row, column = np.divmod(self.pixels, w)
        offset = np.arange(factor)
        rows = (row[:, None, None] * factor + offset[:, None]) * (w * factor)
        places = (rows + column[:, None, None] * factor + offset).reshape(len(self.pixels), -1)
        seen = np.isin(places, view.surfaces.pixels)
        self._owner: Int[np.ndarray, " n"] = np.nonzero(seen)[0]
        self._share = 1 / factor**2
        self.sample, _ = view.surfaces.taken(places[seen])

    def radiance(self, lit: Any) -> dict[str, Float[np.ndarray, "s 3"]]:
        """Under the environment without its sun."""
        if lit.mipmap is None:
            return {}
        exact = self._relighter.exact_radiance(lit, self.sample, SAMPLES, _SEED)
        return {MEANS: self.in_picture(exact)}

    def in_picture(self, radiance: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "s 3"]:
        """The picture's pixels, each the mean of what it has of the view's."""
        total = np.zeros((len(self.pixels), 3))
        np.add.at(total, self._owner, radiance)
        return total * self._share
