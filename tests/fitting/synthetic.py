"""Lafortune samples made by NumPy in float64, and what other code makes of them."""

import dataclasses
import functools

import numpy as np
import scipy.optimize

from fitting.brdf_samples import Grid
from fitting.chart import EXPONENTS

# Of 256 pairs, as many as refits of texels compare functions in: one program fits to these and to those.
COARSE = Grid(half=10, difference=8, azimuth=5)


@dataclasses.dataclass(frozen=True)
class Texels:
    """Items with one lobe each, and their samples."""

    omega_i: np.ndarray  # [t, s, 3]
    omega_o: np.ndarray
    values: np.ndarray  # [t, s, c]
    C: np.ndarray  # [t, 3]
    exponent: np.ndarray  # [t]
    diffuse: np.ndarray  # [t, c]
    peak: np.ndarray  # [t, c]


def hemisphere(random: np.random.Generator, shape, least_cosine=0.05) -> np.ndarray:
    """Directions of uniform density, not nearer to the horizon than a cosine."""
    z, azimuth = random.uniform(least_cosine, 1, shape), random.uniform(0, 2 * np.pi, shape)
    sine = np.sqrt(1 - z * z)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], axis=-1)


def directions(random: np.random.Generator, shape) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of directions, half of them near the mirror direction, as a measurement would choose them."""
    omega_i = hemisphere(random, shape)
    near = omega_i * [-1, -1, 1] + 0.25 * random.normal(size=(*shape, 3))
    near /= np.linalg.norm(near, axis=-1, keepdims=True)
    near[..., 2] = np.abs(near[..., 2])
    return omega_i, np.where(random.uniform(size=shape)[..., None] < 0.5, near, hemisphere(random, shape))


def evaluate(C, exponent, diffuse, peak, omega_i, omega_o) -> np.ndarray:
    """diffuse/π + peak · max(0, ω_oᵀCω_i)ⁿ of one item: [s, c]."""
    dot = (omega_i * omega_o) @ C
    power = np.exp(exponent * np.log(np.where(dot > 0, dot, 1))) * (dot > 0)
    return diffuse / np.pi + power[:, None] * peak


@functools.cache
def texels(count: int, samples: int = 120, noise: float = 0.02, seed: int = 0) -> Texels:
    """Items of exponents 2 to 100, seen with multiplicative noise."""
    random = np.random.default_rng(seed)
    omega_i, omega_o = directions(random, (count, samples))
    exponent = np.exp(random.uniform(np.log(2), np.log(100), count))
    C = np.stack([-np.ones(count), -np.ones(count), random.uniform(0.6, 1.1, count)], axis=-1)
    C /= np.abs(C).max(axis=-1, keepdims=True)
    diffuse = random.uniform(0.05, 0.6, (count, 3))
    peak = random.uniform(0.1, 1, (count, 3)) * np.sqrt(exponent)[:, None] / 3
    items = zip(C, exponent, diffuse, peak, omega_i, omega_o, strict=True)
    values = np.stack([evaluate(*item) for item in items])
    values *= 1 + noise * random.normal(size=values.shape)
    return Texels(omega_i, omega_o, values, C, exponent, diffuse, peak)


def scipy_fit(omega_i, omega_o, values, root_weight, starts, lobes: int = 1) -> float:
    """Least sum of squared weighted residuals of isotropic lobes shared by channels, over starts of scipy's solver.

    Angle of C in the plane Cx = Cy and log exponent of each lobe are solved for with bounds on the exponent,
    diffuse albedo and lobe factors by non-negative least squares inside. A start is [l, 2]: angle, log exponent.
    """
    x = (omega_i * omega_o)[:, 0] + (omega_i * omega_o)[:, 1]
    z = (omega_i * omega_o)[:, 2]

    def residual(unknowns):
        columns = [np.full(len(x), 1 / np.pi)]
        for angle, log_exponent in unknowns.reshape(lobes, 2):
            peak = max(abs(np.cos(angle)), abs(np.sin(angle)))
            dot = (np.cos(angle) * x + np.sin(angle) * z) / peak
            columns.append(np.exp(np.exp(log_exponent) * np.log(np.where(dot > 0, dot, 1))) * (dot > 0))
        G = np.stack(columns, axis=-1) * root_weight[:, None]
        target = values * root_weight[:, None]
        return np.concatenate([G @ scipy.optimize.nnls(G, channel)[0] - channel for channel in target.T])

    low = np.tile([-20.0, np.log(EXPONENTS[0])], lobes)
    high = np.tile([20.0, np.log(EXPONENTS[1])], lobes)
    fits = [
        scipy.optimize.least_squares(residual, np.ravel(start), bounds=(low, high), xtol=1e-9, ftol=1e-9, max_nfev=99)
        for start in starts
    ]
    return min(2 * one.cost for one in fits)
