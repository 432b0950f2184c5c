"""Other rows of a precomputed scene, baked anew from its visibility: with nothing left out, or of other materials."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Integer

from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.reflection import Reflection, of_group
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.methods import Transport
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.clustered import Clustered
from jaxrelight.operators.contract import InBasis, Operator, Summed
from jaxrelight.operators.sparse_rows import SparseRows, sparse_rows
from jaxrelight.transport import bake
from jaxrelight.transport.compression import padded_receivers
from jaxrelight.transport.model import PrecomputedTransport, frames_of, streamed
from jaxrelight.transport.streamed import Streamed


def exact(transport: PrecomputedTransport) -> PrecomputedTransport:
    """The same scene with nothing of direct light left out: rows over all texels, baked from visibility at every use.

    The reference that the kept coefficients are measured against; factors, filtered lobes and bounced light stay what
    they are.

    Raises:
        InputError: of a store for local lights.
    """
    visibility, method = _visibility_of(transport), _transport_of(transport)
    blocks = []
    for block in transport.blocks:
        parts: list[Operator] = list(block.bounced)
        if method.coefficients != "all":
            parts = [InBasis(one, HaarFaces(method.resolution)) for one in parts]
        if block.has_direct:
            parts.insert(0, streamed(method, visibility, transport.receivers, block.groups, block.reflection))
        operator = parts[0] if len(parts) == 1 else Summed(tuple(parts))
        blocks.append(dataclasses.replace(block, operator=operator, dropped=None))
    method = dataclasses.replace(method, coefficients="all")
    basis = cubemap.Texels(method.resolution)
    return dataclasses.replace(transport, blocks=tuple(blocks), basis=basis, method=method, kept=1.0)


def rebake(transport: PrecomputedTransport, reflections: list[Reflection]) -> PrecomputedTransport:
    """The same scene with another reflection for each block, on the same visibility and kept coefficients; no ray.

    Pure and differentiable in the reflections' arrays, in both modes. Which coefficients are kept is held fixed: the
    derivative is that of the truncated operator, not of the choice. Clusters become rows over the coefficients that a
    group shares, since the few rows that it shares are of the old reflection.

    Raises:
        InputError: of a transport with bounces, or for local lights.
    """
    visibility, method = _visibility_of(transport), _transport_of(transport)
    if method.bounces:
        raise InputError("rebake: bounced light is not in the visibility that rows are baked from; precompute again")
    directions = bake.directions_for(method.resolution, method.samples_per_side)
    blocks = []
    for block, reflection in zip(transport.blocks, reflections, strict=True):
        groups, old = block.groups, block.operator
        if isinstance(old, Streamed):
            operator = Streamed(old.read_bits, old.frames, reflection, directions)
            blocks.append(dataclasses.replace(block, reflection=reflection, operator=operator))
            continue
        frames = frames_of(transport.receivers, groups)
        kept, counts = _kept(old, len(groups), reflection.terms)
        n = kept.shape[-1]
        values = [
            bake.bake_kept(
                as_array(visibility.read("bits", int(group))),
                frames[i],
                of_group(reflection, i),
                directions,
                transport.basis,
                kept[i],
            )
            * (np.arange(n) < counts[i])[None, None, None]
            for i, group in enumerate(groups)
        ]
        joined = jnp.concatenate(values).reshape(-1, reflection.channels, n)
        held = padded_receivers(len(groups) * GROUP) * reflection.terms
        operator = sparse_rows(kept.reshape(-1, n), joined, old.shape[1], held)
        blocks.append(dataclasses.replace(block, reflection=reflection, operator=operator))
    return dataclasses.replace(transport, blocks=tuple(blocks))


def _kept(
    old: Operator, groups: int, terms: int
) -> tuple[Integer[Array | np.ndarray, "g m k n"], Int[np.ndarray, " g"]]:
    """Numbers of the coefficients of every row, and how many count; zeros follow where a cluster has fewer."""
    if isinstance(old, SparseRows):
        n = old.indices.shape[-1]
        kept = old.indices.reshape(-1, n)[: old.row_count].reshape(groups, GROUP, terms, n)
        return kept, np.full(groups, n)
    assert isinstance(old, Clustered)
    supports = old.supports()
    counts = np.array([len(support) for support in supports])
    kept = np.zeros((groups, GROUP, terms, max(1, counts.max())), np.int32)
    for group, support in enumerate(supports):
        kept[group, ..., : len(support)] = support
    return kept, counts


def _visibility_of(transport: PrecomputedTransport) -> store.Layer:
    stored = transport.stored
    if stored.visibility is None:
        raise InputError(f"{stored.folder}: a store for local lights, whose rows are not baked from visibility")
    return stored.visibility


def _transport_of(transport: PrecomputedTransport) -> Transport:
    assert isinstance(transport.method, Transport)
    return transport.method
