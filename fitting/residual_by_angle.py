"""How far a BRDF is from samples, over all of them and by angle."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fitting.brdf_samples import BrdfSamples
from jaxrelight.brdf.contract import Brdf
from jaxrelight.numerics.arrays import as_array

# Edges of the bins by angle.
DEGREES = np.arange(0, 91, 10)


class Residual:
    """Weighted squares of BRDF − samples, and of the samples; what is not finite, or without weight, does not count.

    Every number it gives is a relative root mean square: that of the difference over that of the samples.
    """

    def __init__(self, brdf: Brdf, samples: BrdfSamples, weight: Float[np.ndarray, " s"]):
        values = evaluate(brdf, samples.omega_i, samples.omega_o)
        used = np.isfinite(samples.values).all(axis=-1) & (weight > 0)
        weight = np.where(used, weight, 0)
        known = np.where(used[:, None], samples.values, 0)
        apart = np.where(used[:, None], np.asarray(values, float) - known, 0)
        self._error = weight * np.square(apart).sum(axis=-1)
        self._size = weight * np.square(known).sum(axis=-1)
        self._bins = {name: np.digitize(angle, DEGREES) - 1 for name, angle in samples.angles().items()}

    def over(self, chosen: Bool[np.ndarray, " s"] | slice = slice(None)) -> float:
        """The relative residual of some of the samples; NaN if they are all black."""
        total = self._size[chosen].sum()
        return float(np.sqrt(self._error[chosen].sum() / total)) if total > 0 else float("nan")

    def by(self, name: str) -> Float[np.ndarray, " b"]:
        """Between any two of `DEGREES` of an angle of `BrdfSamples.angles`; NaN where there is no sample."""
        return np.array([self.over(self._bins[name] == b) for b in range(len(DEGREES) - 1)])

    def by_both(self, rows: str, columns: str) -> Float[np.ndarray, "b b"]:
        """Between any two of `DEGREES` of either angle; NaN where there is no sample."""
        row, column = self._bins[rows], self._bins[columns]
        every = range(len(DEGREES) - 1)
        return np.array([[self.over((row == i) & (column == j)) for j in every] for i in every])


def evaluate(brdf: Brdf, omega_i: Float[np.ndarray, "s 3"], omega_o: Float[np.ndarray, "s 3"]) -> Float[Array, "s c"]:
    """Values of a BRDF in pairs of directions."""
    return _evaluate(brdf, as_array(omega_i, jnp.float32), as_array(omega_o, jnp.float32))


@eqx.filter_jit
def _evaluate(brdf: Brdf, omega_i: Float[Array, "s 3"], omega_o: Float[Array, "s 3"]) -> Float[Array, "s c"]:
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)
