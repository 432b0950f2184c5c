"""The rows of one material's groups, into the layers of a store."""

import dataclasses
import pathlib
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.reflection import Reflection, of_group
from jaxrelight.files import store
from jaxrelight.gather.gathered import Gathered
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.methods import Transport
from jaxrelight.numerics.arrays import as_array
from jaxrelight.precomputation.groups import complete
from jaxrelight.transport import bake
from jaxrelight.transport.compression import Clusters, Rows, bake_compressed, compression
from jaxrelight.transport.model import frames_of


@runtime_checkable
class Gathers(Protocol):
    """What gathers rows: `bounce.Gather`, `final_gather.FinalGather`, `photon_gather.PhotonGather`."""

    @property
    def emits(self) -> bool:
        """Whether surfaces emit light, which is gathered beside rows."""
        ...

    def rows(
        self,
        receivers: Receivers,
        group: int,
        frames: Float[np.ndarray, "m 3 3"],
        reflections: Sequence[Reflection],
        channels: Sequence[int] | None = None,
    ) -> list[Gathered]:
        """What one group of receivers gathers, by each of the reflections that it has."""
        ...

    def channels_of(self, reflections: Sequence[Reflection]) -> list[int]:
        """Channels of the rows of each of a material's reflections."""
        ...


@dataclasses.dataclass(frozen=True)
class MaterialRows:
    """Makes the rows of the groups of one material, by all of its reflections together.

    Attributes:
        folder: the store.
        receivers: all of them.
        groups: those of the material.
        each: the reflections of its BRDFs, and the records that name their layers.
    """

    folder: pathlib.Path
    receivers: Receivers
    groups: np.ndarray
    each: list[tuple[Reflection, dict]]

    def direct(self, method: Transport, visibility: store.Layer, report: Callable[[int, int], None]) -> None:
        """Completes the layers of direct light, from the visibility of all receivers."""
        kept, basis = compression(method), HaarFaces(method.resolution)
        directions = bake.directions_for(method.resolution, method.samples_per_side)
        layers = self._layers("transport", [kept.layout(one.terms, one.channels) for one, _ in self.each])

        def make(i: int, frames, lacking: list[int]) -> None:
            bits = as_array(visibility.read("bits", int(self.groups[i])))
            for number in lacking:
                reflection = of_group(self.each[number][0], i)
                layers[number].write(i, **bake_compressed(kept, bits, frames, reflection, directions, basis))

        self._complete(layers, make, report)

    def gathered(self, kind: str, kept: Clusters | Rows, gather: Gathers, report: Callable[[int, int], None]) -> None:
        """Completes the layers of what is gathered: receivers look around once for all that they reflect."""
        channels, layouts = gather.channels_of([one for one, _ in self.each]), []
        for (reflection, _), c in zip(self.each, channels, strict=True):
            layouts.append(kept.layout(reflection.terms, c))
            if gather.emits:
                layouts[-1]["emitted"] = (GROUP, reflection.terms, c), np.dtype(np.float32)
        layers = self._layers(kind, layouts)

        def make(i: int, frames, lacking: list[int]) -> None:
            # All are gathered together, also where some are there, since they share the rays.
            reflections = [of_group(one, i) for one, _ in self.each]
            by_reflection = gather.rows(self.receivers, int(self.groups[i]), frames, reflections, channels)
            for number in lacking:
                gathered = by_reflection[number]
                more = {} if gathered.emitted is None else {"emitted": gathered.emitted}
                layers[number].write(i, **kept.compress(gathered.rows, gathered.columns), **more)

        self._complete(layers, make, report)

    def _layers(self, kind: str, layouts) -> list[store.Layer]:
        names = [record[kind] for _, record in self.each]
        pairs = zip(names, layouts, strict=True)
        return [store.make_layer(self.folder / name, layout, len(self.groups)) for name, layout in pairs]

    def _complete(self, layers: Sequence[store.Layer], make, report: Callable[[int, int], None]):
        """Runs make(group, frames, numbers of the layers that lack it)."""
        if not any(layer.missing for layer in layers):
            return
        frames = frames_of(self.receivers, self.groups)

        def make_lacking(i: int) -> None:
            make(i, frames[i], [number for number, layer in enumerate(layers) if not layer.has(i)])

        complete(layers, self.receivers.filled[self.groups], make_lacking, report)
