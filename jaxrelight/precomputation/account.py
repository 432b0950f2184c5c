"""What a precomputation left out, what that saved, and what it costs: measured on receivers that are done in full."""

import dataclasses
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.reflection import Reflection, of_group
from jaxrelight.files import store
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.natural_spectrum import natural_spectrum
from jaxrelight.lights.sky_panel import sky_panel
from jaxrelight.methods import Transport
from jaxrelight.numerics.arrays import as_array
from jaxrelight.precomputation.groups import Threads
from jaxrelight.precomputation.receiver_refinement import Refined
from jaxrelight.transport import bake
from jaxrelight.transport.compression import Clusters, compression
from jaxrelight.transport.model import frames_of
from jaxrelight.transport.visibility import trace_visibility

# Groups of receivers that are done in full, and receivers of them whose errors are summed at a time.
_GROUPS, _RECEIVER_CHUNK = 4, 8


@dataclasses.dataclass(frozen=True)
class Account:
    """What was left out of transport, what that saved, and what it costs.

    Attributes:
        receivers: their number.
        added_receivers: vertices, and backs of vertices, that were added where light needs them.
        even_receivers: how many there would be if added ones were as dense everywhere.
        vertex_rays: that were cast to find where vertices are needed.
        rays: that were cast for visibility.
        all_rays: one for each texel above each receiver's horizon.
        seconds_saved: that the others would have taken, at the rate of those of the sample; None where the account was
            read from a store, which keeps no times.
        rays_error: what they change of irradiance, relative, under a panel of skies.
        row_bytes: of rows of direct light, on disk.
        all_row_bytes: of all their coefficients, in single precision.
        rows_error: what the coefficients that are left out change of radiance, relative: of shared rows under natural
            light, of a number of coefficients under white noise.
        samples: receivers that were done in full for both errors.
        terms: of each material's rows.
        channels: of each material's rows: 1 where colour is a factor.
    """

    receivers: int
    added_receivers: int
    even_receivers: int
    vertex_rays: int
    rays: int
    all_rays: int
    seconds_saved: float | None
    rays_error: float
    row_bytes: int
    all_row_bytes: int
    rows_error: float
    samples: int
    terms: dict[str, int]
    channels: dict[str, int]

    @property
    def line(self) -> str:
        """It in words."""
        parts = []
        if self.rays < self.all_rays:
            saved = f", {self.seconds_saved:.0f} s," if (self.seconds_saved or 0) >= 1 else ""
            parts.append(f"{1 - self.rays / self.all_rays:.0%} of rays{saved} for {self.rays_error:.2%} of irradiance")
        if self.row_bytes < self.all_row_bytes:
            left, whole = 1 - self.row_bytes / self.all_row_bytes, self.all_row_bytes
            size = f"{whole / 1e6:,.0f} MB" if whole >= 1e6 else f"{whole / 1e3:,.0f} kB"
            parts.append(f"{left:.1%} of {size} of rows for {self.rows_error:.1%} of radiance")
        if self.added_receivers and self.even_receivers > self.receivers:
            left = 1 - self.receivers / self.even_receivers
            parts.append(f"{left:.0%} of evenly dense receivers: {self.added_receivers:,} are where light needs them")
        return f"{'; '.join(parts) or 'nothing'} ({self.samples} receivers done in full)"

    def to_record(self) -> dict:
        """What a header says of it: all but times, so that the same scene has the same store."""
        return {name: value for name, value in dataclasses.asdict(self).items() if name != "seconds_saved"}


def account_from(record: dict) -> Account:
    """What `Account.to_record` made."""
    return Account(**record, seconds_saved=None)


class DirectRows(NamedTuple):
    """The rows of one BRDF of a material.

    Attributes:
        material: its name.
        groups: of its receivers.
        reflection: of the BRDF.
        layer: that holds the rows of direct light; None where they are not stored.
    """

    material: str
    groups: Int[np.ndarray, " g"]
    reflection: Reflection
    layer: store.Layer | None


def account_of(
    method: Transport,
    tracer: Tracer,
    receivers: Receivers,
    visibility: store.Layer,
    rows: Sequence[DirectRows],
    finer: Refined | None,
) -> Account:
    """Does a few groups in full, and compares.

    Args:
        method: the dials.
        tracer: of the scene.
        receivers: of the layers.
        visibility: their layer.
        rows: of direct light.
        finer: how vertices were added to the scene; None where none may be.
    """
    chosen = np.sort(np.random.default_rng(0).permutation(len(receivers.filled))[:_GROUPS])
    texels = method.resolution * method.samples_per_side
    directions = cubemap.directions(texels)
    # In an order that does not depend on which thread is first: sums of floats do.
    full: dict[int, UInt8[np.ndarray, "m bytes"]] = dict.fromkeys(chosen.tolist(), np.zeros((0, 0), np.uint8))
    counts, start = [], time.perf_counter()

    def trace(group: int) -> None:
        full[group], count = trace_visibility(tracer, receivers.origins[group], receivers.normals[group], directions)
        counts.append(count)

    for _ in Threads().run(trace, chosen.tolist()):
        pass
    rate = sum(counts) / max(time.perf_counter() - start, 1e-9)
    kept = {group: visibility.read("bits", group) for group in full}
    every = [int(visibility.read("rays", group)[0]) for group in range(visibility.groups)]
    # Half of the texels are above a horizon, wherever it is: they lie symmetrically around the origin.
    all_rays = int(receivers.filled.sum()) * 3 * texels**2
    traced = int(np.sum(np.array(every) * receivers.filled / GROUP))
    coefficients = 6 * method.resolution**2
    stored = [one for one in rows if one.layer is not None]
    terms, channels = {}, {}
    for one in rows:
        terms[one.material] = terms.get(one.material, 0) + one.reflection.terms
        channels[one.material] = max(channels.get(one.material, 0), one.reflection.channels)
    sizes = [int(receivers.filled[one.groups].sum()) * one.reflection.terms * one.reflection.channels for one in stored]
    return Account(
        receivers=receivers.count,
        added_receivers=finer.added if finer else 0,
        even_receivers=max(finer.even if finer else 0, receivers.count),
        vertex_rays=finer.rays if finer else 0,
        rays=min(traced, all_rays),
        all_rays=all_rays,
        seconds_saved=max(0.0, (all_rays - traced) / rate),
        rays_error=_rays_error(full, kept, receivers, texels),
        row_bytes=sum(one.layer.nbytes for one in stored if one.layer is not None),
        all_row_bytes=4 * coefficients * sum(sizes),
        rows_error=_rows_error(method, kept, receivers, stored),
        samples=int(receivers.filled[chosen].sum()),
        terms=terms,
        channels=channels,
    )


def _rays_error(full, kept, receivers: Receivers, texels: int) -> float:
    """Of irradiance under every sky of the panel, relative to its root-mean-square."""
    skies, directions = sky_panel(texels), cubemap.directions(texels)
    off = size = 0.0
    for group, bits in full.items():
        for own in _some(int(receivers.filled[group])):
            cosines = np.maximum(receivers.normals[group, own] @ directions.T, 0)
            exact, here = (_seen(one[own], cosines) @ skies for one in (bits, kept[group]))
            off, size = off + np.sum((here - exact) ** 2), size + np.sum(exact**2)
    return float(np.sqrt(off / size)) if size > 0 else 0.0


def _some(count: int) -> list[slice]:
    """A few receivers after the other: at fine resolutions, what all of a group see takes gigabytes."""
    return [slice(start, min(start + _RECEIVER_CHUNK, count)) for start in range(0, count, _RECEIVER_CHUNK)]


def _seen(bits: UInt8[np.ndarray, "m bytes"], cosines: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m d"]:
    return np.unpackbits(bits, axis=1, bitorder="little", count=cosines.shape[1]) * cosines


def _rows_error(method: Transport, bits, receivers: Receivers, stored: Sequence[DirectRows]) -> float:
    """Of light terms under light of the natural spectrum, relative to their root-mean-square.

    Of a number of coefficients it is under white noise, which is more: the energy of what they leave out is known.
    """
    if method.coefficients == "all" or not stored:
        return 0.0
    held, basis, spectrum = compression(method), HaarFaces(method.resolution), natural_spectrum(method.resolution)
    directions = bake.directions_for(method.resolution, method.samples_per_side)
    off = size = 0.0
    for one in stored:
        assert one.layer is not None
        for group in np.intersect1d(one.groups, list(bits)).tolist():
            number = int(group - one.groups[0])
            arrays = {name: one.layer.read(name, number) for name in one.layer.arrays}
            if not isinstance(held, Clusters):
                off, size = off + arrays["dropped"].sum(dtype=float), size + arrays["total"].sum(dtype=float)
                continue
            frames, reflection = frames_of(receivers, np.array([group]))[0], of_group(one.reflection, number)
            exact = np.asarray(bake.bake_rows(as_array(bits[group]), frames, reflection, directions, basis))
            here = held.rows(arrays, exact.shape[1])
            for own in _some(int(receivers.filled[group])):
                off += np.sum(np.square((here[own] - exact[own]) * spectrum, dtype=float))
                size += np.sum(np.square(exact[own] * spectrum, dtype=float))
    return float(np.sqrt(off / size)) if size > 0 else 0.0
