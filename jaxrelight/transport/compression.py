"""What is kept of the rows of a group, how a layer holds it, and the operator that it makes."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxrelight.basis.haar import HaarFaces, levels
from jaxrelight.basis.truncation import Truncated
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.lights.natural_spectrum import natural_spectrum
from jaxrelight.methods import Indirect, Transport
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import bucket
from jaxrelight.operators.clustered import Cluster, Clustered, clustered, quantised_clusters
from jaxrelight.operators.clustering import cluster
from jaxrelight.operators.quantised import Quantised, quantised
from jaxrelight.operators.sparse_rows import SparseRows, smallest_index_type, sparse_rows
from jaxrelight.transport import bake

# Neighbours in a row that share a scale, where rows are codes: as many bytes as one for each level, and nearer.
_RUN = 16


class Opened(NamedTuple):
    """A layer's operator, and the energy by row and channel: what was left out, and all."""

    operator: SparseRows | Clustered
    dropped: Float[np.ndarray, "r c"]
    total: Float[np.ndarray, "r c"]


def compression(method: Transport) -> "Rows | Clusters":
    """What the method asks for, of direct light."""
    if method.coefficients == "shared":
        return shared(method)
    return Rows(int(method.coefficients), method.bits, natural_spectrum(method.resolution))


def shared(method: Transport) -> "Clusters":
    """The compression of bounced light, whatever direct light is kept as."""
    constant = levels(method.resolution) == 0
    return Clusters(method.compression_tolerance, method.bits, natural_spectrum(method.resolution), constant)


def of_cloud(method: Indirect, spectrum: Float[np.ndarray, " d"]) -> "Rows | Clusters":
    """The compression of what is gathered from a cloud, whose light has a spectrum."""
    if method.coefficients == "shared":
        constant = levels(math.isqrt(len(spectrum)), 1) == 0
        return Clusters(method.compression_tolerance, method.bits, spectrum, constant)
    return Rows(int(method.coefficients), method.bits, spectrum)


def bake_compressed(
    kept: "Rows | Clusters",
    bits: UInt8[Array, "m bytes"],
    frames: Float[Array, "m 3 3"],
    reflection: Reflection,
    directions: bake.Directions,
    basis: HaarFaces,
) -> dict[str, np.ndarray]:
    """Direct light of one group, as a layer holds it; see `bake`."""
    if isinstance(kept, Rows):
        given = bits, frames, reflection, directions, basis
        return kept.arrays(bake.bake_truncated(*given, kept.count, as_array(kept.spectrum)))
    rows = np.asarray(bake.bake_rows(bits, frames, reflection, directions, basis))
    return kept.compress(rows, np.arange(rows.shape[-1]))


def padded_receivers(count: int) -> int:
    """For how many receivers light terms of a material are computed: zeros past `count`, which nobody reads."""
    return bucket(count, 8 * GROUP)


class Rows:
    """The coefficients of every row that count most under light of a spectrum, the same number in all.

    Wang 2006 §4.1.1 keeps the largest.

    Attributes:
        count: of coefficients.
        spectrum: standard deviations of light's coefficients, relative to each other.
    """

    def __init__(self, count: int, bits: int, spectrum: Float[np.ndarray, " d"]):
        self.count = count
        self._bits = bits
        self._columns = len(spectrum)
        self.spectrum = spectrum

    @property
    def dial(self) -> Any:
        """What a layer's key has to tell of it."""
        return ["rows of natural light", self.count, *([] if self._bits == 32 else [self._bits])]

    def layout(self, terms: int, channels: int) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
        """Indices shared by the channels, and values."""
        shape = GROUP, terms, channels
        return {
            "indices": ((GROUP, terms, self.count), smallest_index_type(self._columns)),
            **_coded_layout("values", (*shape, self.count), (*shape, -(-self.count // _RUN)), self._bits),
            **_energies(terms, channels),
        }

    def compress(self, rows: Float[np.ndarray, "m k c n"], columns: Int[np.ndarray, " n"]) -> dict[str, np.ndarray]:
        """The arrays of a layer: the coefficients that matter most under light of the spectrum."""
        energy = np.square(rows, dtype=np.float64)
        count = min(self.count, len(columns))
        weighted = energy.sum(axis=2) * np.square(self.spectrum[columns])
        chosen = (
            np.sort(np.argpartition(-weighted, count - 1)[..., :count])
            if count
            else np.zeros((*rows.shape[:2], 0), int)
        )
        values = np.take_along_axis(rows, chosen[:, :, None], axis=3)
        total = energy.sum(axis=3)
        dropped = total - np.square(values, dtype=np.float64).sum(axis=3)
        # Filling counts nothing, whatever it is of.
        more = [(0, 0), (0, 0), (0, self.count - count)]
        indices, values = np.pad(columns[chosen], more), np.pad(values, [*more[:2], (0, 0), more[2]])
        return self.arrays(Truncated(indices, values, np.maximum(dropped, 0), total))  # pyright: ignore[reportArgumentType]

    def arrays(self, kept: Truncated) -> dict[str, np.ndarray]:
        """The arrays of a layer for a group's rows; they lead with receivers and terms."""
        values = np.asarray(kept.values)
        coded = _coded("values", values, self._bits, _RUN)
        lost = np.square(values - _decoded("values", coded, _RUN)).sum(axis=-1)
        return {
            "indices": np.asarray(kept.indices).astype(smallest_index_type(self._columns)),
            **coded,
            "dropped": (np.asarray(kept.dropped) + lost).astype(np.float32),
            "total": np.asarray(kept.total, np.float32),
        }

    def open(self, layer: store.Layer) -> Opened:
        """Row-sparse; of padded length, so that few shapes are compiled."""
        arrays = layer.read_all()
        indices, values = arrays["indices"], arrays["values"]
        _check(layer, indices, self._columns)
        g, m, k, c, n = values.shape
        rows: np.ndarray | Quantised = values.reshape(-1, c, n)
        if "values_scale" in arrays:
            rows = Quantised(rows, arrays["values_scale"].reshape(g * m * k, c, -1), min(_RUN, n))
        held = padded_receivers(g * m) * k
        operator = sparse_rows(indices.reshape(-1, n), rows, self._columns, held)
        return Opened(operator, arrays["dropped"].reshape(-1, c), arrays["total"].reshape(-1, c))


class Clusters:
    """As few shared rows over as few coefficients as leave out no more than a tolerance of light of some spectrum.

    Nothing is left out of constant light, whose coefficients are those marked.
    """

    def __init__(
        self, tolerance: float, bits: int, spectrum: Float[np.ndarray, " d"], constant: Bool[np.ndarray, " d"]
    ):
        self._constant = constant
        self._tolerance = tolerance
        self._bits = bits
        self._columns = len(spectrum)
        self._spectrum = spectrum

    @property
    def dial(self) -> Any:
        """What a layer's key has to tell of it."""
        return ["clusters of constants", self._tolerance, *([] if self._bits == 32 else [self._bits])]

    def layout(self, terms: int, channels: int) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
        """The arrays of a `Cluster`, as long as it is; the basis coefficient by coefficient."""
        return {
            "support": ((-1,), smallest_index_type(self._columns)),
            **_coded_layout("basis", (-1, -1), (-1, 1), self._bits),
            **_coded_layout("weights", (channels, -1, GROUP * terms), (channels, -1, 1), self._bits),
            **_energies(terms, channels),
        }

    def compress(self, rows: Float[np.ndarray, "m k c n"], columns: Int[np.ndarray, " n"]) -> dict[str, np.ndarray]:
        """The arrays of a layer for a group's rows, which are given over some coefficients and are 0 elsewhere."""
        m, k, c, n = rows.shape
        group_cluster, dropped = cluster(
            rows.reshape(m * k, c, n), self._spectrum[columns], self._tolerance, self._constant[columns]
        )
        coded = _coded("basis", np.ascontiguousarray(group_cluster.basis.T), self._bits)
        coded |= _coded("weights", group_cluster.weights, self._bits)
        if self._bits < 32:
            basis, weights = (_decoded(name, coded) for name in ("basis", "weights"))
            lost = _mixed(group_cluster.weights, group_cluster.basis.T) - _mixed(weights, basis)
            dropped = dropped + np.square(lost).sum(axis=-1)
        return {
            "support": columns[group_cluster.support].astype(smallest_index_type(self._columns)),
            **coded,
            "dropped": dropped.reshape(m, k, c),
            "total": np.einsum("mkcd,mkcd->mkc", rows, rows),
        }

    def rows(self, group: Mapping[str, np.ndarray], terms: int) -> Float[np.ndarray, "m k c d"]:
        """A group's rows from the arrays of a layer, over all coefficients.

        Args:
            group: the arrays.
            terms: of each receiver.
        """
        basis, weights = (_decoded(name, group) for name in ("basis", "weights"))
        rows = np.zeros((weights.shape[2], len(weights), self._columns), np.float32)
        rows[..., group["support"]] = _mixed(weights, basis)
        return rows.reshape(-1, terms, *rows.shape[1:])

    def open(self, layer: store.Layer) -> Opened:
        """Clustered."""
        clusters, energies = [], []
        for group in layer.read_groups():
            _check(layer, group["support"], self._columns)
            basis, weights = (_decoded(name, group) for name in ("basis", "weights"))
            clusters.append(Cluster(group["support"], basis.T, weights))
            energies.append([group[name].reshape(-1, group[name].shape[-1]) for name in ("dropped", "total")])
        dropped, total = (np.concatenate(parts) for parts in zip(*energies, strict=True))
        operator = clustered(clusters, self._columns)
        return Opened(operator if self._bits == 32 else quantised_clusters(operator, self._bits), dropped, total)


def _check(layer: store.Layer, indices: np.ndarray, columns: int):
    if indices.size and indices.max() >= columns:
        raise InputError(f"{layer.folder}: indices are out of range; delete this folder and run precompute again")


def _mixed(weights: Float[np.ndarray, "c q r"], basis: Float[np.ndarray, "s q"]) -> Float[np.ndarray, "r c s"]:
    return np.einsum("cqr,sq->rcs", weights, basis, optimize=True)


def _coded_layout(name: str, shape: tuple[int, ...], scales: tuple[int, ...], bits: int):
    """The layout of an array that is kept as it is, or as codes and scales."""
    if bits == 32:
        return {name: (shape, np.dtype(np.float32))}
    return {name: (shape, np.dtype(f"int{bits}")), f"{name}_scale": (scales, np.dtype(np.float32))}


def _coded(name: str, values: np.ndarray, bits: int, run: int | None = None) -> dict[str, np.ndarray]:
    if bits == 32:
        return {name: values}
    coded = quantised(values, bits, run) if values.size else None
    if coded is None:
        return {name: values.astype(f"int{bits}"), f"{name}_scale": np.zeros((*values.shape[:-1], 1), np.float32)}
    return {name: np.asarray(coded.codes), f"{name}_scale": np.asarray(coded.scale)}


def _decoded(name: str, arrays: Mapping[str, np.ndarray], run: int | None = None) -> np.ndarray:
    codes, scale = arrays[name], arrays.get(f"{name}_scale")
    if scale is None or not codes.size:
        return codes.astype(np.float32)
    return codes * np.repeat(scale, run or codes.shape[-1], axis=-1)[..., : codes.shape[-1]]


def _energies(terms: int, channels: int) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    energy = (GROUP, terms, channels), np.dtype(np.float32)
    return {"dropped": energy, "total": energy}
