"""What pictures tell of the light, and what they do not: from the singular values of the map from light to pictures.

Before any picture, unknowns have the standard deviations of natural light, σ/μ of them, where σ is what the pictures
miss and μ the strength of the ridge. Pictures lower the variance along each right singular vector by s²/(s² + μ²).
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.inverse.bidiagonalisation import Bidiagonal
from jaxrelight.inverse.light_grid import LightGrid
from jaxrelight.inverse.light_regularisation import Spectrum

# A mean of the light is told where pictures take away this share of its variance, or more.
DETERMINED = 0.9
# Texels whose variance is computed together.
_CHUNK = 512


@dataclasses.dataclass(frozen=True)
class LightEstimate:
    """A weighted mean of the light, by channel.

    Attributes:
        value: of the light that was found.
        deviation: standard deviation, given the pictures.
        share: of the variance before the pictures, what they take away: 1 where they tell the mean, 0 where they tell
            nothing of it.
        determined: whether they tell it, in all channels.
    """

    value: Float[np.ndarray, "3"]
    deviation: Float[np.ndarray, "3"]
    share: Float[np.ndarray, "3"]
    determined: bool


@dataclasses.dataclass(frozen=True)
class LightCertainty:
    """What pictures tell of an environment.

    Attributes:
        grid: of the environment.
        deviations: of its coefficients under natural light.
        seen: orthonormal vectors of unknowns, times the square root of the share that pictures take away of the
            variance along each, [k, d, 3].
        prior: standard deviation of an unknown before the pictures, [3].
        singular_values: of the map from unknowns to pictures, descending, [k, 3].
        strength: of the ridge; singular values above it are told.
    """

    grid: LightGrid
    deviations: Float[np.ndarray, " d"]
    seen: Float[np.ndarray, "k d 3"]
    prior: Float[np.ndarray, "3"]
    singular_values: Float[np.ndarray, "k 3"]
    strength: float

    @property
    def told(self) -> tuple[int, ...]:
        """How many unknown numbers the pictures tell, in each channel."""
        return tuple(int(count) for count in np.count_nonzero(self.singular_values > self.strength, axis=0))

    def texel_shares(self) -> Float[np.ndarray, "d 3"]:
        """Of every texel, the share of the variance of its radiance that pictures take away: 0 where none sees it."""
        before, after = self._variances()
        return 1 - after / np.maximum(before, np.finfo(float).tiny)[:, None]

    def texel_deviations(self) -> Float[np.ndarray, "d 3"]:
        """The standard deviation of every texel's radiance, given the pictures."""
        return np.sqrt(np.maximum(self._variances()[1], 0)) * self.prior[None]

    def details(self) -> Float[np.ndarray, " d"]:
        """How sharply pictures see each direction: the angle, in degrees, of the finest detail that they tell there.

        It is the side of the square of as many texels as share one told number: of a texel of solid angle Ω whose own
        radiance makes up a share R of what is found there, √(Ω/R); 180 at most.
        """
        d = self.grid.size
        kernel = np.zeros(d)
        for start in range(0, d, _CHUNK):
            rows = self._rows(np.arange(start, min(start + _CHUNK, d)))
            # Of the resolution matrix T F T⁻¹ the diagonal, T = decode · deviations and F what is told.
            towards = np.einsum("im,kmc->ikc", rows * self.deviations[None], self.seen, optimize=True)
            back = np.einsum("im,kmc->ikc", rows / self.deviations[None], self.seen, optimize=True)
            kernel[start : start + len(rows)] = np.mean(np.sum(towards * back, axis=1), axis=1)
        angle = np.degrees(np.sqrt(self.grid.solid_angles / np.maximum(kernel, 1e-9)))
        return np.minimum(angle, 180.0)

    def of_mean(self, weights: Float[np.ndarray, " d"], texels: Float[np.ndarray, "d 3"]) -> LightEstimate:
        """The mean of the found light under weights.

        Args:
            weights: of every texel; their sum is made 1.
            texels: the radiance that was found.

        Raises:
            InputError: for weights of another number, or that sum to 0.
        """
        weights = np.asarray(weights, float)
        if weights.shape != (self.grid.size,) or not np.isfinite(weights).all() or abs(weights.sum()) < 1e-12:
            raise InputError(f"weights are {self.grid.size:,} finite numbers, one for each texel, whose sum is not 0")
        weights = weights / weights.sum()
        coefficients = np.asarray(self.grid.basis.encode(jnp.asarray(weights, jnp.float32)), float) * self.deviations
        before = np.sum(coefficients**2)
        told = np.sum(np.einsum("m,kmc->kc", coefficients, self.seen) ** 2, axis=0)
        share = np.clip(told / before, 0, 1)
        deviation = np.sqrt(before * (1 - share)) * self.prior
        return LightEstimate(weights @ texels, deviation, share, bool((share >= DETERMINED).all()))

    def _variances(self) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d 3"]]:
        """Of every texel before the pictures, and given them, in units of the prior variance."""
        d = self.grid.size
        before, after = np.zeros(d), np.zeros((d, 3))
        for start in range(0, d, _CHUNK):
            rows = self._rows(np.arange(start, min(start + _CHUNK, d))) * self.deviations[None]
            chosen = slice(start, start + len(rows))
            before[chosen] = np.sum(rows**2, axis=1)
            told = np.einsum("im,kmc->ikc", rows, self.seen, optimize=True)
            after[chosen] = before[chosen][:, None] - np.sum(told**2, axis=1)
        return before, after

    def _rows(self, texels: np.ndarray) -> Float[np.ndarray, "i d"]:
        """Rows of the matrix that decodes coefficients: the coefficients of single texels."""
        alone = np.zeros((len(texels), self.grid.size), np.float32)
        alone[np.arange(len(texels)), texels] = 1
        return np.asarray(self.grid.basis.encode(jnp.asarray(alone)), float)


def certainty_of(
    state: Bidiagonal,
    spectrum: Spectrum,
    grid: LightGrid,
    deviations: Float[np.ndarray, " d"],
    strength: float,
    noise: Float[np.ndarray, "3"],
) -> LightCertainty:
    """What pictures tell.

    Args:
        state: of the bidiagonalisation.
        spectrum: of it.
        grid: of the environment.
        deviations: of its coefficients.
        strength: of the ridge.
        noise: root mean square of what weighted pictures miss, by channel.
    """
    share = np.sqrt(spectrum.values**2 / (spectrum.values**2 + strength**2))
    V = np.stack([v[: grid.size] for v in state.V])
    seen = np.einsum("kmc,kjc,jc->jmc", V, spectrum.right, share, optimize=True)
    return LightCertainty(grid, deviations, seen.astype(np.float32), noise / strength, spectrum.values, strength)
