"""How much of the light that comes a material reflects, by the data and by a fit to it."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from fitting.brdf_samples import BrdfSamples
from fitting.residual_by_angle import evaluate
from jaxrelight.brdf.contract import Brdf

# Degrees of the light from the normal; beyond, tables are measured badly.
INCIDENCE = 5, 20, 35, 50, 65
# Outgoing directions of each, of equal projected solid angle.
_OUTGOING = 4096
# A sample stands for directions as near as this; beyond, nothing is known.
_NEAR = 0.35


def albedo_error(fit: Brdf, data: Brdf | BrdfSamples) -> float:
    """The largest relative difference of directional albedos of a fit and of the data, over `INCIDENCE`.

    An albedo is the share of light from one direction that is reflected into all others, over all channels. Of samples
    it is a sum in which each counts for the directions that it is nearest to, turned about the normal; the fit is
    summed over the same samples.

    Returns:
        The difference over the data's albedo; NaN where the data are black or say nothing.
    """
    sums = []
    for number, degrees in enumerate(INCIDENCE):
        omega_i, omega_o = _hemisphere(degrees, number)
        if isinstance(data, BrdfSamples):
            nearest, weight = _nearest(data, omega_i, omega_o)
            wanted = data.values[nearest]
            omega_i, omega_o = data.omega_i[nearest], data.omega_o[nearest]
        else:
            wanted, weight = np.asarray(evaluate(data, omega_i, omega_o), float), np.ones(len(omega_o))
        found = np.asarray(evaluate(fit, omega_i, omega_o), float)
        sums.append([np.abs(weight @ (found - wanted)).sum(), (weight @ wanted).sum()])
    difference, total = np.array(sums).T
    known = total > 0
    return float((difference[known] / total[known]).max()) if known.any() else float("nan")


def _hemisphere(degrees: float, number: int) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"]]:
    """A direction to the light, and outgoing ones of equal projected solid angle, turned for each number."""
    index = np.arange(_OUTGOING)
    radius, golden = np.sqrt((index + 0.5) / _OUTGOING), np.pi * (3 - 5**0.5)
    azimuth, turn = index * golden, number * golden
    omega_o = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - radius**2)], axis=-1)
    slant = np.radians(degrees)
    omega_i = np.array([np.sin(slant) * np.cos(turn), np.sin(slant) * np.sin(turn), np.cos(slant)])
    return np.broadcast_to(omega_i, omega_o.shape), omega_o


def _nearest(data: BrdfSamples, omega_i, omega_o) -> tuple[np.ndarray, Float[np.ndarray, " s"]]:
    """Samples that are the nearest to some pair of directions, and for how many they are."""
    known = np.flatnonzero(np.isfinite(data.values).all(axis=-1) & data.is_above())
    if not len(known):
        return known, np.zeros(0)
    tree = KDTree(_without_turn(data.omega_i[known], data.omega_o[known]))
    distance, place = tree.query(_without_turn(omega_i, omega_o), distance_upper_bound=_NEAR)
    chosen, count = np.unique(np.asarray(place)[np.isfinite(distance)], return_counts=True)
    return known[chosen], count.astype(float)


def _without_turn(omega_i, omega_o) -> Float[np.ndarray, "s 5"]:
    """Coordinates of pairs of directions that are the same for pairs turned about the normal, or mirrored."""
    across = np.hypot(omega_i[:, 0], omega_i[:, 1])
    safe = np.where(across > 1e-6, across, 1)
    cosine, sine = np.where(across > 1e-6, omega_i[:, 0] / safe, 1), np.where(across > 1e-6, omega_i[:, 1] / safe, 0)
    along = cosine * omega_o[:, 0] + sine * omega_o[:, 1]
    aside = np.abs(cosine * omega_o[:, 1] - sine * omega_o[:, 0])
    return np.stack([across, omega_i[:, 2], along, aside, omega_o[:, 2]], axis=-1)
