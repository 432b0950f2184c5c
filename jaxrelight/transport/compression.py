"""What is kept of the rows of a group, how a layer holds it, and the operator that it makes."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrelight import store
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.buckets import bucket
from jaxrelight.errors import InputError
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.lights.natural_spectrum import natural_spectrum
from jaxrelight.operators.clustered import Cluster, Clustered, cluster, clustered
from jaxrelight.operators.sparse_rows import SparseRows, smallest_index_type, sparse_rows
from jaxrelight.transport import bake
from jaxrelight.transport.settings import Settings

# Rows of bounced light of a group, over the coefficients of light; None where there are none.
Bounced = Float[np.ndarray, "m k c d"] | None


class Opened(NamedTuple):
    """A layer's operator, and the energy by row and channel: what was left out, and all."""

    operator: SparseRows | Clustered
    dropped: Float[np.ndarray, "r c"]
    total: Float[np.ndarray, "r c"]


def compression(settings: Settings) -> "Rows | Clusters":
    """What the settings ask for: where nothing of direct light is compressed, what clusters keep of bounced light."""
    clusters = settings.operator == "clusters" or settings.coefficients == "all"
    return Clusters(settings) if clusters else Rows(settings)


def padded_receivers(count: int) -> int:
    """For how many receivers light terms of a material are computed: zeros past `count`, which nobody reads."""
    return bucket(count, 8 * GROUP)


class Rows:
    """The largest coefficients of every row, the same number in all (Wang 2006 §4.1.1)."""

    def __init__(self, settings: Settings):
        self._count = int(settings.coefficients)
        self._basis = HaarFaces(settings.resolution)
        self._directions = bake.directions_for(settings.resolution, settings.samples_per_side)
        self._columns = 6 * settings.resolution**2

    @property
    def dial(self):
        """What a layer's key has to tell of it."""
        return self._count

    def layout(self, terms: int, channels: int) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
        """Indices shared by the channels, and values."""
        return {
            "indices": ((GROUP, terms, self._count), smallest_index_type(self._columns)),
            "values": ((GROUP, terms, channels, self._count), np.dtype(np.float32)),
            **_energies(terms, channels),
        }

    def compress(self, bits, frames, reflection: Reflection, bounced: Bounced = None) -> dict[str, np.ndarray]:
        """Of the sum of direct and bounced light."""
        more = () if bounced is None else (jnp.asarray(bounced),)
        kept = bake.bake_truncated(bits, frames, reflection, self._directions, self._basis, self._count, *more)
        return {
            "indices": np.asarray(kept.indices).astype(smallest_index_type(self._columns)),
            "values": np.asarray(kept.values),
            "dropped": np.asarray(kept.dropped),
            "total": np.asarray(kept.total),
        }

    def open(self, layer: store.Layer) -> Opened:
        """Row-sparse; of padded length, so that few shapes are compiled."""
        arrays = layer.read_all(["indices", "values", "dropped", "total"])
        indices, values = arrays["indices"], arrays["values"]
        _check(layer, indices, self._columns)
        g, m, k, c, n = values.shape
        held = padded_receivers(g * m) * k
        operator = sparse_rows(indices.reshape(-1, n), values.reshape(-1, c, n), self._columns, held)
        return Opened(operator, arrays["dropped"].reshape(-1, c), arrays["total"].reshape(-1, c))


class Clusters:
    """As few shared rows over as few coefficients as leave out no more than a tolerance."""

    def __init__(self, settings: Settings):
        self._tolerance = settings.tolerance
        self._basis = HaarFaces(settings.resolution)
        self._directions = bake.directions_for(settings.resolution, settings.samples_per_side)
        self._columns = 6 * settings.resolution**2
        self._spectrum = natural_spectrum(settings.resolution)

    @property
    def dial(self):
        """What a layer's key has to tell of it."""
        return ["clusters", self._tolerance]

    def layout(self, terms: int, channels: int) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
        """The arrays of a `Cluster`, as long as it is."""
        real = np.dtype(np.float32)
        return {
            "support": ((-1,), smallest_index_type(self._columns)),
            "basis": ((-1, -1), real),
            "weights": ((channels, -1, GROUP * terms), real),
            **_energies(terms, channels),
        }

    def compress(self, bits, frames, reflection: Reflection, bounced: Bounced = None) -> dict[str, np.ndarray]:
        """Of the sum of direct and bounced light."""
        rows = np.asarray(bake.bake_rows(bits, frames, reflection, self._directions, self._basis))
        return self.compress_rows(rows if bounced is None else rows + bounced)

    def compress_rows(self, rows: Float[np.ndarray, "m k c d"]) -> dict[str, np.ndarray]:
        """Of rows that are written out."""
        m, k, c, d = rows.shape
        found, dropped = cluster(rows.reshape(m * k, c, d), self._spectrum, self._tolerance)
        return {
            "support": found.support.astype(smallest_index_type(self._columns)),
            "basis": found.basis,
            "weights": found.weights,
            "dropped": dropped.reshape(m, k, c),
            "total": np.einsum("mkcd,mkcd->mkc", rows, rows),
        }

    def open(self, layer: store.Layer) -> Opened:
        """Clustered."""
        clusters, energies = [], []
        for group in layer.read_groups():
            _check(layer, group["support"], self._columns)
            clusters.append(Cluster(group["support"], group["basis"], group["weights"]))
            energies.append([group[name].reshape(-1, group[name].shape[-1]) for name in ("dropped", "total")])
        dropped, total = (np.concatenate(parts) for parts in zip(*energies, strict=True))
        return Opened(clustered(clusters, self._columns), dropped, total)


def _check(layer: store.Layer, indices: np.ndarray, columns: int):
    if indices.size and indices.max() >= columns:
        raise InputError(f"{layer.folder}: indices are out of range; delete this folder and run precompute again")


def _energies(terms: int, channels: int) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    energy = (GROUP, terms, channels), np.dtype(np.float32)
    return {"dropped": energy, "total": energy}
