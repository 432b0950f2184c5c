"""What a picture is measured against: its method's exact radiance at a sample of a view's pixels."""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.lighting.exact_pixels import ExactPixels, NamedComponent, PixelVisibility, exact_pixels
from jaxrelight.lighting.picture_error import Shared, bright_pixels, drawn_pixels, shared_error
from jaxrelight.lighting.visible_surfaces import VisibleSurfaces
from jaxrelight.lights.environment import Environment

# Pixels of a picture that are compared by default, and the share of them that is drawn by brightness.
ERROR_SAMPLES, _BRIGHT = 256, 0.25
# How many are compared with twice the resolution, and the name of what that tells.
_FEW, FINER = 32, "rays and resolution"


class Sample(NamedTuple):
    """Some pixels of a view, and their exact radiance.

    Attributes:
        pixels: their places in the flattened picture.
        view: of them alone, as a picture of a single row.
        radiance: under a light, by the means that the picture has it by.
    """

    pixels: Int[np.ndarray, " s"]
    view: Any
    radiance: Callable[[Any], Mapping[str, Float[np.ndarray, "s 3"]]]


class Reference(abc.ABC):
    """The exact radiance of a view's pixels. Those that are drawn evenly are kept, and their rays cast once.

    The brightest are few and bring about most of a relative error, so that some pixels are drawn by their brightness
    under each light.

    Attributes:
        name: what messages call it.
    """

    name: str

    def __init__(self, shown: Int[np.ndarray, " n"], count: int, seed: int):
        """Draws the sample.

        Args:
            shown: pixels that show a surface, by their places in the flattened picture, ascending.
            count: of the sample; all of them where there are no more.
            seed: of the sample.
        """
        self._shown, self._seed = shown, seed
        self._bright_count = int(_BRIGHT * count) if count < len(shown) else 0
        self.even = self.of(drawn_pixels(shown, count - self._bright_count, seed))

    @abc.abstractmethod
    def of(self, pixels: Int[np.ndarray, " s"]) -> Sample:
        """Some pixels, ascending; casts their rays."""

    @property
    def evenly(self) -> float:
        """How many of the picture's pixels each stands for of those that are drawn evenly."""
        return len(self._shown) / max(len(self.even.pixels), 1)

    def samples(self, radiance: Float[np.ndarray, "n 3"]) -> tuple[list[Sample], list[Float[np.ndarray, " _"]]]:
        """The pixels to compare of a picture, and how many of the picture's each of them stands for.

        Args:
            radiance: of all of the picture's pixels.
        """
        even, shown = self.even, self._shown
        energy = np.sum(radiance[shown].astype(float) ** 2, axis=1)
        if not self._bright_count or not energy.sum() > 0:
            return [even], [np.full(len(even.pixels), self.evenly)]
        # How often a pixel is drawn, evenly and by brightness together.
        expected = len(even.pixels) / len(shown) + self._bright_count * energy / energy.sum()
        place, times = bright_pixels(energy, self._bright_count, self._seed)
        bright = self.of(shown[place])
        weights = [1 / expected[np.searchsorted(shown, even.pixels)], times / expected[place]]
        return [even, bright], weights

    def further(self, lit: Any, even: Mapping[str, Float[np.ndarray, "s 3"]]) -> dict[str, Shared]:
        """Relative errors that the picture shares with the reference, by name.

        Args:
            lit: the light.
            even: radiance of the pixels that are drawn evenly, under it.
        """
        return {}

    def divided(self, lit: Any, even: Mapping[str, Float[np.ndarray, "s 3"]]) -> dict[str, dict[str, float]]:
        """By means that several things make other than exact, how much of it each of those brings about, by its name.

        Args:
            lit: the light.
            even: radiance of the pixels that are drawn evenly, under it.
        """
        return {}


class ExactTransport(Reference):
    """Exact transport of an environment: rays through every texel of a cube map, and BRDFs as they are.

    Its own error, of one ray a texel and of texels themselves, is measured on a few pixels with four rays and texels
    in place of each.

    Attributes:
        few: those pixels.
    """

    name = "exact transport"

    def __init__(
        self,
        surfaces: VisibleSurfaces,
        taken: Callable[[Int[np.ndarray, " s"]], tuple[Any, VisibleSurfaces]],
        named: Callable[[int], Sequence[NamedComponent]],
        resolution: int,
        count: int,
        seed: int,
    ):
        """Casts the rays.

        Args:
            surfaces: of the view.
            taken: gives a view of a few of its pixels, and the surfaces of that.
            named: the components of a material of the relighter, by its number.
            resolution: side of the cube map's faces.
            count: of the sample.
            seed: of the sample.
        """
        self._taken, self._named, self._visibility = taken, named, PixelVisibility(resolution)
        super().__init__(surfaces.pixels, count, seed)
        self.few = np.sort(np.random.default_rng(seed).permutation(self.even.pixels)[:_FEW])
        self._coarse = np.searchsorted(self.even.pixels, self.few)
        self._finer = self._exact(self.few, PixelVisibility(2 * resolution))[1]

    def _exact(self, pixels: Int[np.ndarray, " s"], visibility: PixelVisibility) -> tuple[Any, ExactPixels]:
        view, seen = self._taken(pixels)
        components = [self._named(part.material) for part in seen.parts]
        return view, exact_pixels(seen, components, visibility.resolution, visibility.of(seen, pixels))

    def of(self, pixels: Int[np.ndarray, " s"]) -> Sample:
        """Some pixels, under the light's environment; nothing without one."""
        view, exact = self._exact(pixels, self._visibility)

        def radiance(lit: Any) -> dict[str, Float[np.ndarray, "s 3"]]:
            environment: Environment | None = lit.environment
            return {} if environment is None else exact.radiance(environment)

        return Sample(pixels, view, radiance)

    def further(self, lit: Any, even: Mapping[str, Float[np.ndarray, "s 3"]]) -> dict[str, Shared]:
        """What rays and texels that are finer change."""
        if lit.environment is None:
            return {}
        coarse, fine = (np.sum(list(of.values()), axis=0) for of in (even, self._finer.radiance(lit.environment)))
        return {FINER: shared_error(fine - coarse[self._coarse], fine)}


class _Kept(NamedTuple):
    """What is kept of a view, and what it was made of."""

    key: tuple
    holds: Any
    reference: Reference


def kept_reference(view: Any, key: tuple, holds: Any, make: Callable[[], Reference]) -> Reference:
    """The reference that a view keeps, made where it has none of that key: a view's rays are cast once.

    It is no part of the view as a pytree, so that no program depends on it.

    Args:
        view: any.
        key: of what the reference follows from, beside the view.
        holds: objects that the key has the identities of.
        make: makes it.
    """
    kept = view.__dict__.get("_reference")
    if kept is None or kept.key != key:
        kept = _Kept(key, holds, make())
        object.__setattr__(view, "_reference", kept)
    return kept.reference
