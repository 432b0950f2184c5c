"""The reference of adaptive lighting: many samples of each of a few pixels."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.lighting.adaptive.view import AdaptiveView
from jaxrelight.lighting.reference import Reference, Sample
from jaxrelight.lighting.visible_surfaces import VisibleSurfaces
from jaxrelight.numerics.random_numbers import MAX_POINTS

# Samples of a pixel, and the seed that draws them; those of users and of trials are others.
SAMPLES, _SEED = min(2048, MAX_POINTS), -3
# What samples bring about, as messages call it.
MEANS = "samples and what lies between"


class TakenPixels(NamedTuple):
    """Some of a picture's pixels, each of one or more of the view's.

    Attributes:
        surfaces: the view's pixels, as a picture of a single row.
        owner: of each of them, the number of the picture's pixel that it is a part of.
        count: of the picture's pixels.
        share: of a pixel that one of the view's is.
    """

    surfaces: VisibleSurfaces
    owner: Int[np.ndarray, " n"]
    count: int
    share: float

    def in_picture(self, radiance: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "s 3"]:
        """The picture's pixels, each the mean of what it has of the view's."""
        total = np.zeros((self.count, 3))
        np.add.at(total, self.owner, radiance)
        return total * self.share


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
        self._relighter, self._view = relighter, view
        (h, w), factor = view.shape, view.factor
        fine = np.asarray(view.surfaces.covered).reshape(h, factor, w, factor)
        super().__init__(np.flatnonzero(fine.any(axis=(1, 3))), count, seed)

    def of(self, pixels: Int[np.ndarray, " s"]) -> Sample:
        """Some pixels, under the environment without its sun."""
        view, factor = self._view, self._view.factor
        columns = view.shape[1]
        row, column = np.divmod(pixels, columns)
        offset = np.arange(factor)
        rows = (row[:, None, None] * factor + offset[:, None]) * (columns * factor)
        places = (rows + column[:, None, None] * factor + offset).reshape(len(pixels), -1)
        seen = np.isin(places, view.surfaces.pixels)
        surfaces, _ = view.surfaces.taken(places[seen])
        taken = TakenPixels(surfaces, np.nonzero(seen)[0], len(pixels), 1 / factor**2)

        def radiance(lit: Any) -> dict[str, Float[np.ndarray, "s 3"]]:
            if lit.mipmap is None:
                return {}
            return {MEANS: taken.in_picture(self._relighter.exact_radiance(lit, surfaces, SAMPLES, _SEED))}

        return Sample(pixels, taken, radiance)
