"""Neural surrogates of the MERL materials: shaped like measurements, and not measurements."""

import numpy as np

from fitting.brdf_samples import BrdfSamples, Grid


class Surrogates:
    """The networks of Sztrajman et al. 2021: f of the half and difference vectors, two hidden layers."""

    def __init__(self, path):
        with np.load(path) as weights:
            self._layers = [(weights[f"fc{i}"].astype(float), weights[f"b{i}"].astype(float)) for i in (1, 2, 3)]
            self.names = [str(name) for name in weights["names"]]

    def samples(self, index: int, grid: Grid) -> BrdfSamples:
        """One material over a grid."""
        omega_i, omega_o = grid.directions()
        half = omega_i + omega_o
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        # The light in the frame of the half vector.
        along = half[:, :2] / np.maximum(np.linalg.norm(half[:, :2], axis=-1, keepdims=True), 1e-9)
        flat = np.concatenate([along, np.zeros((len(half), 1))], axis=-1)
        side = np.stack([-along[:, 1], along[:, 0], np.zeros(len(half))], axis=-1)
        sine = np.linalg.norm(half[:, :2], axis=-1, keepdims=True)
        tangent = half[:, 2:] * flat - sine * [0, 0, 1]
        difference = [np.sum(omega_i * axis, axis=-1) for axis in (tangent, side, half)]
        x = np.stack([sine[:, 0], 0 * sine[:, 0], half[:, 2], *difference], axis=-1)
        for i, (matrix, bias) in enumerate(self._layers):
            x = x @ matrix[index] + bias[index]
            x = np.maximum(x, 0) if i < 2 else np.maximum(np.exp(x) - 1, 0)
        return BrdfSamples(omega_i, omega_o, x)
