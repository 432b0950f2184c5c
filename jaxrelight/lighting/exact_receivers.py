"""Exact transport of a view's pixels and of the receivers that they lie between.

Of a picture from rows of receivers, it tells what the rows leave out from what lies between receivers.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from jaxrelight.brdf.reflection import Reflection
from jaxrelight.files.store import Layer
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.lighting.reference import ExactTransport
from jaxrelight.lighting.transport_means import COEFFICIENTS, REST, blocks_by_means, terms_alone
from jaxrelight.lights.environment import Environment, texels_of
from jaxrelight.methods import Transport
from jaxrelight.transport import bake
from jaxrelight.transport.model import Block, PrecomputedTransport, frames_of

# Receivers that are baked at once.
_RECEIVER_BATCH = 128


class _Inputs(NamedTuple):
    """What exact rows of some receivers of a block are baked from; filled up."""

    receivers: Int[np.ndarray, " n"]
    bits: UInt8[np.ndarray, "n bytes"]
    frames: Float[np.ndarray, "n 3 3"]
    reflection: Reflection


class ExactReceivers:
    """Exact light terms of some receivers of precomputed transport, from the visibility that its store has."""

    def __init__(self, transport: PrecomputedTransport, receivers: Mapping[int, Int[np.ndarray, " n"]]):
        """Reads their visibility.

        Args:
            transport: with rows.
            receivers: numbers among those of a block, by the block's number.
        """
        method, visibility = transport.method, transport.stored.visibility
        assert isinstance(method, Transport)
        assert visibility is not None
        self._resolution = method.resolution
        self._directions = bake.directions_for(method.resolution, method.samples_per_side)
        self._inputs = {
            number: [
                _inputs(transport, visibility, transport.blocks[number], own[start : start + _RECEIVER_BATCH])
                for start in range(0, len(own), _RECEIVER_BATCH)
            ]
            for number, own in receivers.items()
        }

    def terms(
        self, environment: Environment, others: tuple[Float[Array, "_ _ _"], ...]
    ) -> tuple[Float[Array, "_ _ _"], ...]:
        """Light terms of direct light: exact ones of those receivers, and the ones given of all others."""
        texels, every = texels_of(environment, self._resolution), list(others)
        for number, chunks in self._inputs.items():
            for of in chunks:
                exact = bake.bake_and_apply(of.bits, of.frames, of.reflection, self._directions, texels)
                every[number] = _replaced(every[number], of.receivers, exact)
        return tuple(every)


def _inputs(transport: PrecomputedTransport, visibility: Layer, block: Block, own: Int[np.ndarray, " n"]) -> _Inputs:
    # Filling repeats the first.
    own = np.concatenate([own, np.full(_RECEIVER_BATCH - len(own), own[0])])
    group, member = np.divmod(own, GROUP)
    bits = {number: visibility.read("bits", block.first_group + number) for number in np.unique(group).tolist()}
    frames = frames_of(transport.receivers, block.first_group + np.unique(group))
    reflection = block.reflection
    each, shared = eqx.partition(reflection, reflection.per_receiver)
    return _Inputs(
        own,
        np.stack([bits[of][one] for of, one in zip(group.tolist(), member.tolist(), strict=True)]),
        frames[np.searchsorted(np.unique(group), group), member].astype(np.float32),
        eqx.combine(jax.tree.map(lambda x: x[group, member], each), shared),
    )


@jax.jit
def _replaced(terms: Float[Array, "v k c"], receivers: Int[Array, " n"], exact: Float[Array, "n k c"]):
    return terms.at[receivers].set(exact)


class ExactAtVertices(ExactTransport):
    """Exact transport that divides what rows and interpolation bring about, at a few pixels."""

    def __init__(self, relighter: Any, *exact: Any):
        """Reads the visibility of the vertices around those pixels.

        Args:
            relighter: a `TransportRelighter` whose receivers are vertices.
            exact: what `ExactTransport` takes.
        """
        super().__init__(*exact)
        self._relighter, self._view = relighter, self._taken(self.few)[0]
        self._numbers = blocks_by_means(relighter.transport)
        receivers: dict[int, list[np.ndarray]] = {}
        for part, corners in zip(self._view.surfaces.parts, self._view.corners, strict=True):
            name = relighter.materials[part.material].name
            for number in (number for of in self._numbers.values() for number in of):
                if relighter.transport.blocks[number].material == name:
                    receivers.setdefault(number, []).append(np.asarray(corners.receivers).ravel())
        every = {number: np.unique(np.concatenate(of)) for number, of in receivers.items()}
        self._receivers = ExactReceivers(relighter.transport, every)

    def divided(self, lit: Any, even: Mapping[str, Float[np.ndarray, "s 3"]]) -> dict[str, dict[str, float]]:
        """What coefficients that rows leave out bring about, and what the rest does."""
        if lit.environment is None:
            return {}
        terms = self._relighter.direct_terms(lit)
        exact, divided = self._receivers.terms(lit.environment, terms), {}
        for means, numbers in self._numbers.items():
            kept, whole, nothing = (
                np.asarray(self._relighter.shade_terms(terms_alone(of, own), self._view))[0]
                for of, own in ((terms, numbers), (exact, numbers), (terms, ()))
            )
            between = whole - nothing - even[means][self._coarse]
            divided[means] = {COEFFICIENTS: _length(kept - whole), REST[means]: _length(between)}
        return divided


def _length(of: Float[np.ndarray, "s 3"]) -> float:
    return float(np.linalg.norm(of.astype(float)))
