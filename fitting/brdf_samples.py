"""Samples of one material: values of a BRDF in pairs of directions."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

# By how much the length of a unit vector may be off, as where it was written with two digits.
_LENGTH_TOLERANCE = 0.01


@dataclasses.dataclass(frozen=True)
class BrdfSamples:
    """Values f(ω_i, ω_o) without the cosine; a value that is not finite marks a sample as missing.

    Directions are unit vectors in the local frame, whose z is the normal.

    Raises:
        InputError: if the shapes do not belong together, there are no samples, directions are not of unit length, or
            most samples have one below the surface.
    """

    omega_i: Float[np.ndarray, "s 3"]
    omega_o: Float[np.ndarray, "s 3"]
    values: Float[np.ndarray, "s c"]

    def __post_init__(self) -> None:
        s = len(self.values)
        if self.values.ndim != 2 or 0 in self.values.shape:
            raise InputError(f"samples of a BRDF need values of shape [samples, channels], not {self.values.shape}")
        for name in ("omega_i", "omega_o"):
            if getattr(self, name).shape != (s, 3):
                raise InputError(f"{name} must have the shape [{s}, 3], not {list(getattr(self, name).shape)}")
            length = np.linalg.norm(np.asarray(getattr(self, name), float), axis=-1)
            wrong = np.isfinite(length) & (np.abs(length - 1) > _LENGTH_TOLERANCE)
            if wrong.any():
                raise InputError(
                    f"{wrong.sum():,} of {s:,} vectors of {name} are not of length 1, the first of "
                    f"{length[wrong][0]:.3g}; divide each by its length"
                )
        below = s - int(self.is_above().sum())
        if below > s / 2:
            raise InputError(
                f"{below:,} of {s:,} samples have a direction below the surface (z < 0); the normal is z, so turn "
                "directions with y up, (x, y, z) to (x, -z, y), and leave out samples of the other side"
            )

    def is_above(self) -> Bool[np.ndarray, " s"]:
        """Whether neither direction is below the surface; a direction that is not finite is not known to be."""
        return ~((self.omega_i[:, 2] < 0) | (self.omega_o[:, 2] < 0))

    def is_finite(self) -> Bool[np.ndarray, " s"]:
        """Whether a sample and its directions are known."""
        return np.all([np.isfinite(part).all(axis=-1) for part in (self.values, self.omega_i, self.omega_o)], axis=0)

    def angles(self) -> dict[str, Float[np.ndarray, " s"]]:
        """In degrees: of the light ("incident"), of the half vector ("half"), and between both ("difference")."""
        half = self.omega_i + self.omega_o
        half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
        cosines = {
            "incident": self.omega_i[:, 2],
            "half": half[:, 2],
            "difference": np.sum(self.omega_i * half, axis=-1),
        }
        return {name: np.degrees(np.arccos(np.clip(cosine, -1, 1))) for name, cosine in cosines.items()}


@dataclasses.dataclass(frozen=True)
class Grid:
    """Pairs of directions by half and difference angle (Rusinkiewicz 1998), dense where highlights are.

    θ_h goes with the square of its index, as in the MERL tables; θ_d and φ_d are even. φ_h is 0 unless `rotations`
    turn every pair about the normal, for anisotropic materials. Pairs with a direction lower than `least_cosine` are
    left out.
    """

    half: int = 30
    difference: int = 12
    azimuth: int = 12
    rotations: int = 1
    least_cosine: float = float(np.cos(np.radians(80)))

    def directions(self) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"]]:
        """ω_i and ω_o."""
        h = np.pi / 2 * ((np.arange(self.half) + 0.5) / self.half) ** 2
        d = np.pi / 2 * (np.arange(self.difference) + 0.5) / self.difference
        # Half of the turn is the other half with ω_i and ω_o exchanged, when rotated by half a turn.
        p = np.pi * (np.arange(self.azimuth) + 0.5) / self.azimuth
        turn = 2 * np.pi * np.arange(self.rotations) / self.rotations
        h, d, p, turn = (part.ravel() for part in np.meshgrid(h, d, p, turn, indexing="ij"))
        around_half = np.stack([np.sin(d) * np.cos(p), np.sin(d) * np.sin(p), np.cos(d)], axis=-1)
        half = np.stack([np.sin(h), 0 * h, np.cos(h)], axis=-1)
        tilted = np.stack(
            [
                np.cos(h) * around_half[:, 0] + np.sin(h) * around_half[:, 2],
                around_half[:, 1],
                np.cos(h) * around_half[:, 2] - np.sin(h) * around_half[:, 0],
            ],
            axis=-1,
        )
        other = 2 * np.sum(tilted * half, axis=-1, keepdims=True) * half - tilted
        kept = (tilted[:, 2] >= self.least_cosine) & (other[:, 2] >= self.least_cosine)
        cosine, sine = np.cos(turn), np.sin(turn)

        def turned(v):
            return np.stack([cosine * v[:, 0] - sine * v[:, 1], sine * v[:, 0] + cosine * v[:, 1], v[:, 2]], -1)[kept]

        return turned(tilted), turned(other)


def sample(brdf: Brdf, grid: Grid = Grid()) -> BrdfSamples:
    """A BRDF at the pairs of a grid."""
    omega_i, omega_o = grid.directions()
    values = _evaluate(brdf, as_array(omega_i, jnp.float32), as_array(omega_o, jnp.float32))
    return BrdfSamples(omega_i, omega_o, np.asarray(values, float))


@jax.jit
def _evaluate(brdf, omega_i, omega_o):
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)
