"""What a picture is measured against: its method's exact radiance at a sample of a view's pixels."""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.lighting.exact_pixels import ExactPixels, NamedComponent, exact_pixels, traced_bits
from jaxrelight.lighting.picture_error import drawn_pixels
from jaxrelight.lighting.visible_surfaces import VisibleSurfaces
from jaxrelight.lights.environment import Environment

# Pixels of a picture that are compared by default.
ERROR_SAMPLES = 256
# Of those, how many are compared with twice the resolution, and the name of what that tells.
_FEW, FINER = 32, "rays and resolution"


class Reference(abc.ABC):
    """The exact radiance of a sample of a view's pixels; its rays are cast once.

    Attributes:
        pixels: the sample's places in the flattened picture.
        sample: a view of them alone, as a picture of a single row.
        name: what messages call it.
    """

    pixels: Int[np.ndarray, " s"]
    sample: Any
    name: str

    @abc.abstractmethod
    def radiance(self, lit: Any) -> Mapping[str, Float[np.ndarray, "s 3"]]:
        """Under a light, by the means that the picture has it by."""

    def further(self, lit: Any, radiance: Mapping[str, Float[np.ndarray, "s 3"]]) -> dict[str, float]:
        """Relative errors that the picture shares with the reference, by name.

        Args:
            lit: the light.
            radiance: under it, from `radiance`.
        """
        return {}


class ExactTransport(Reference):
    """Exact transport of an environment: rays through every texel of a cube map, and BRDFs as they are.

    Its own error, of one ray a texel and of texels themselves, is measured on a few pixels with four rays and texels
    in place of each.
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
        self.pixels = drawn_pixels(surfaces.pixels, count, seed)
        self._few = np.sort(np.random.default_rng(seed).permutation(len(self.pixels))[:_FEW])

        def exact(some: Int[np.ndarray, " s"], side: int) -> tuple[Any, ExactPixels]:
            view, seen = taken(some)
            components = [named(part.material) for part in seen.parts]
            return view, exact_pixels(seen, components, side, traced_bits(seen, side))

        self.sample, self._exact = exact(self.pixels, resolution)
        self._finer = exact(self.pixels[self._few], 2 * resolution)[1]

    def radiance(self, lit: Any) -> Mapping[str, Float[np.ndarray, "s 3"]]:
        """Under the light's environment; nothing without one."""
        environment: Environment | None = lit.environment
        return {} if environment is None else self._exact.radiance(environment)

    def further(self, lit: Any, radiance: Mapping[str, Float[np.ndarray, "s 3"]]) -> dict[str, float]:
        """What rays and texels that are finer change."""
        if lit.environment is None or not radiance:
            return {}
        fine = self._finer.radiance(lit.environment)
        coarse, fine = (np.sum(list(of.values()), axis=0) for of in (radiance, fine))
        size = np.linalg.norm(fine)
        return {FINER: float(np.linalg.norm(fine - coarse[self._few]) / size)} if size > 0 else {}


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
