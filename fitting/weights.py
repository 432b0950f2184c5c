"""Weights of samples, by name."""

import numpy as np
from jaxtyping import Float

from fitting.brdf_samples import BrdfSamples
from jaxrelight.errors import InputError


def _plain(samples: BrdfSamples) -> Float[np.ndarray, " s"]:
    return np.ones(len(samples.values))


def _cosine(samples: BrdfSamples) -> Float[np.ndarray, " s"]:
    return np.square(np.maximum(samples.omega_i[:, 2], 0))


def _log_cosine(samples: BrdfSamples) -> Float[np.ndarray, " s"]:
    cosine = np.maximum(samples.omega_i[:, 2], 0)
    reflected = cosine * np.maximum(np.mean(samples.values, axis=-1), 0)
    finite = np.isfinite(reflected)
    positive = reflected[finite & (reflected > 0)]
    typical = np.median(positive) if positive.size else 1.0
    return np.where(finite, np.square(cosine / (1 + np.where(finite, reflected, 0) / typical)), 0)


_WEIGHTS = {"plain": _plain, "cosine": _cosine, "log-cosine": _log_cosine}


def weights(name: str, samples: BrdfSamples) -> Float[np.ndarray, " s"]:
    """Weights of squared differences of f.

    `plain`: all 1. `cosine`: cos²θ_i, so that reflected light is compared, not f. `log-cosine`: the squared
    difference of log(1 + f cosθ_i / typical) to first order around the samples, cos²θ_i / (1 + f̄ cosθ_i / typical)²
    with f̄ the mean over channels and the median of f̄ cosθ_i as what is typical: highlights do not outweigh all else.

    Raises:
        InputError: for any other name.
    """
    if name not in _WEIGHTS:
        raise InputError(f"unknown weight '{name}'; there are {', '.join(_WEIGHTS)}")
    return _WEIGHTS[name](samples)
