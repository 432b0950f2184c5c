"""Bounced light: rows gathered from the compressed rows of all that each receiver sees (Wang 2006 §3.2, §4.2).

With light terms T at the vertices, those of the light that is reflected once more are (eq. 8)

    T'_k(x) = Σ_ω light_side_k(ω) cosθ dω Σ_λ outgoing_λ(x̃, −ω) T_λ(x̃)

over the texels ω of a coarse cube map that something is hit in, x̃ being what is hit. This is a product of matrices: one
of how much each receiver sees of each vertex, and the clusters that hold T.
"""

import copy
import functools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.basis import cubemap
from jaxrelight.brdf.outgoing import outgoing
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.files import store
from jaxrelight.gather.gathered import Gathered
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import filled_up
from jaxrelight.operators.clustered import Cluster, Clustered
from jaxrelight.operators.clustering import as_clusters
from jaxrelight.operators.contract import Operator, parts_of
from jaxrelight.operators.sparse_rows import SparseRows
from jaxrelight.transport import bake
from jaxrelight.transport.hits import SPARED, GatherRays, Hits, trace_hits
from jaxrelight.transport.model import Block, PrecomputedTransport

# Numbers in a matrix of how much is seen, of several groups of vertices at once: what stays in cache. Sixteen times as
# many took 2.6 times as long.
_MAX_MATRIX_SIZE = 2**20


class _Part(NamedTuple):
    """Clusters of the groups of a block, and a number for each size, −1 where there is nothing."""

    clusters: list[Cluster]
    size: Int[np.ndarray, " g"]


class Gather:
    """Gathers rows of light that is reflected once more than that of a transport.

    Attributes:
        key: of what is gathered from, and how.
        channels: of what is gathered: those of the transport's rows, and of what closes them.
        emits: whether surfaces emit light.
        resolution: side of the faces of the cube map that receivers look around with.
    """

    def __init__(
        self,
        transport: PrecomputedTransport,
        key: str,
        resolution: int,
        nearest: bool = False,
        rays: Literal["adaptive", "all"] = "all",
    ):
        """From a transport of vertices, whose operators are `SparseRows`, `Clustered` or sums of them.

        Args:
            transport: light that leaves the vertices.
            key: of all that it follows from.
            resolution: side of the faces of the cube map that receivers look around with (the paper's is 32).
            nearest: take the rows of the nearest vertex at each hit, as the paper does, not those of the face's three.
            rays: 'adaptive' casts none where the receivers' visibility is open, see `with_visibility`.
        """
        assert transport.method.receivers == "vertices"
        self.resolution = resolution
        enclosed = transport.geometry.enclosed
        more = [*([SPARED] if rays == "adaptive" else []), *([enclosed] if enclosed.any() else [])]
        self.key = store.key_of(key, resolution, nearest, *more)
        self._transport, self._is_adaptive = transport, rays == "adaptive"
        self._visibility: store.Layer | None = None
        self._cast: list[GatherRays] = []
        self._nearest = nearest
        self._parts = [[_part(one, block) for one in parts_of(block.operator)] for block in transport.blocks]
        closing = [_outgoing_shape(block)[-1] for block in transport.blocks]
        emitted = [len(block.emission) for block in transport.blocks if block.emission is not None]
        self.channels = max(*closing, *emitted, transport.operator.shape[2])
        self.emits = transport.emits
        self._directions = bake.directions_for(resolution)

    def with_visibility(self, visibility: store.Layer) -> "Gather":
        """The same for the receivers of a layer of visibility, at which no ray has been cast yet."""
        gather = copy.copy(self)
        gather._visibility, gather._cast = visibility if self._is_adaptive else None, []
        return gather

    @property
    def rays(self) -> GatherRays:
        """Those that rows have been gathered along so far."""
        return GatherRays.total(self._cast)

    def rows(
        self,
        receivers: Receivers,
        group: int,
        frames: Float[np.ndarray, "m 3 3"],
        reflections: Sequence[Reflection],
        channels: Sequence[int] | None = None,
    ) -> list[Gathered]:
        """What one group of receivers gathers, by each of the reflections that it has.

        Args:
            receivers: all of them.
            group: which one.
            frames: of its receivers.
            reflections: theirs.
            channels: of the rows of each, all the same; by default no more than there need be.
        """
        hits = self.hits(receivers, group)
        self._cast.append(hits.rays)
        m, terms = len(frames), [reflection.terms for reflection in reflections]
        c = max(channels or self.channels_of(reflections))
        seen = np.zeros((m, len(self._directions.vectors)), bool)
        seen[hits.receiver, hits.texel] = True
        bits = as_array(np.packbits(seen, axis=1, bitorder="little"))
        texels = cubemap.Texels(self.resolution)
        sides = [bake.bake_rows(bits, frames, one, self._directions, texels) for one in reflections]
        light_side = _side_by_side(sides)
        closings = list(self._closings(hits))
        columns = self._columns(closings)
        place = np.zeros(self._transport.operator.shape[1], np.int64)
        place[columns] = np.arange(len(columns))
        # There is a line for each coefficient; those of several coefficients are added to at once.
        lines = np.zeros((len(columns), m * sum(terms) * c), np.float32)
        for support, sums in self._lines(hits, closings, light_side, c):
            lines[place[support]] += sums
        ends = np.cumsum(terms)
        by_reflection = np.split(lines.T.reshape(m, sum(terms), c, len(columns)), ends[:-1], axis=1)
        emitted: Sequence[np.ndarray | None] = [None] * len(terms)
        if self.emits:
            own = self.light(
                hits,
                light_side,
                [None if block.emitted is None else np.asarray(block.emitted) for block in self._transport.blocks],
                emission=True,
            )
            emitted = np.split(own, ends[:-1], axis=1)
        return [Gathered(columns, *one) for one in zip(by_reflection, emitted, strict=True)]

    def channels_of(self, reflections: Sequence[Reflection]) -> list[int]:
        """Channels of the rows of each of a material's reflections: the same for all, which are gathered at once."""
        most = max(self.channels, *(reflection.channels for reflection in reflections))
        return [most] * len(reflections)

    def light(
        self,
        hits: Hits,
        light_side: Float[Array, "f m k c1"],
        terms: Sequence[np.ndarray | None],
        emission: bool = False,
    ) -> Float[np.ndarray, "m k c"]:
        """Light terms of what is seen: the gathering of rows, applied to light.

        Args:
            hits: from `hits`.
            light_side: of the receivers, over the texels.
            terms: [receivers, k, c] of the vertices in each block's groups; None for black ones.
            emission: add what surfaces emit.
        """
        seen = np.zeros((*light_side.shape[:2], self.channels), np.float32)
        for number, block_hits, slots, weights, closing in self._closings(hits):
            place = hits.texel[block_hits], hits.receiver[block_hits]
            own, radiance = terms[number], self._transport.blocks[number].emission
            if own is not None:
                corners = np.einsum("hv,hvkc->hkc", weights, np.asarray(own)[slots])
                seen[place] += np.sum(corners * np.asarray(closing)[: len(block_hits)], axis=1)
            if emission and radiance is not None:
                front = np.sum(hits.points.normals[block_hits] * hits.points.omega_o[block_hits], axis=1) > 0
                seen[place] += front[:, None] * np.asarray(radiance)
        return np.asarray(_received(light_side, seen))

    def hits(self, receivers: Receivers, group: int) -> Hits:
        """What the receivers of a group see in the texels above their horizons."""
        surfaces, tracer = self._transport.surfaces, self._transport.tracer
        bits = None if self._visibility is None else self._visibility.read("bits", group)
        return trace_hits(surfaces, tracer, receivers.origins[group], receivers.normals[group], self.resolution, bits)

    def _closings(self, hits: Hits):
        """For each block that is hit: its number, which hits, their corners in its groups, weights and view sides."""
        points, transport = hits.points, self._transport
        corners, weights = transport.geometry.corners(points)
        if self._nearest:
            chosen = np.argmax(weights, axis=1)[:, None]
            corners, weights = np.take_along_axis(corners, chosen, axis=1), np.ones((len(corners), 1))
        slots = transport.receivers.slot_of[corners]
        material = transport.receivers.material_of_group[slots[:, 0] // GROUP]
        for number, block in enumerate(transport.blocks):
            groups = block.groups
            block_hits = np.flatnonzero(material == transport.receivers.material_of_group[groups[0]])
            if not len(block_hits):
                continue
            length = _power(len(block_hits), 2, 1024)
            local = to_local(
                frames_of_points(points.normals[block_hits], points.tangents[block_hits]), points.omega_o[block_hits]
            )
            seen = (filled_up(rows, length) for rows in (local, points.uv[block_hits], points.footprint[block_hits]))
            closing = _outgoing(block.reflection, block.weight, *seen)
            yield number, block_hits, slots[block_hits] - groups[0] * GROUP, weights[block_hits], closing

    def _columns(self, closings) -> Int[np.ndarray, " n"]:
        """The coefficients of all groups of vertices that are seen, ascending."""
        held = np.zeros(self._transport.operator.shape[1], bool)
        for number, _, slots, _, _ in closings:
            for group in np.unique(slots // GROUP):
                for part in self._parts[number]:
                    held[part.clusters[group].support] = True
        return np.flatnonzero(held)

    def _lines(self, hits: Hits, closings, light_side: Float[Array, "f m k c1"], channels: int):
        """What is seen of each group of vertices: its coefficients, and a line for each of them."""
        for number, block_hits, slots, weights, closing in closings:
            hit = np.repeat(np.arange(len(block_hits)), slots.shape[1])
            entries = hits.receiver[block_hits][hit], hits.texel[block_hits][hit], hit, weights.reshape(-1)
            for part in self._parts[number]:
                yield from _lines_of(part, entries, slots.reshape(-1), light_side, closing, channels)


def _lines_of(part: _Part, entries, slots: Int[np.ndarray, " e"], light_side, closing, channels: int):
    """`Gather._lines` of some clusters.

    Args:
        part: the clusters.
        entries: of every hit and corner: receiver, texel, hit and weight.
        slots: of the vertices there, among the clusters' groups.
        light_side: of the receivers, over the texels.
        closing: view sides of the hits.
        channels: of the lines.
    """
    group, vertex = np.divmod(slots, GROUP)
    # Entries are sorted by the size of their group, then by group.
    order = np.lexsort((group, part.size[group]))
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    ends, seen = np.append(starts[1:], len(order)), group[order][starts]
    of_a_group = GROUP * light_side.shape[1] * light_side.shape[2] * closing.shape[1] * channels
    most = _power(max(1, _MAX_MATRIX_SIZE // of_a_group), 4)
    for size in np.unique(part.size[seen][part.size[seen] >= 0]):
        for some in _runs(np.flatnonzero(part.size[seen] == size), most):
            chosen = order[starts[some[0]] : ends[some[-1]]]
            length, wide = _power(len(chosen), 4, 1024), _power(len(some), 4)
            place = np.repeat(np.arange(len(some)), ends[some] - starts[some])
            columns = *(values[chosen] for values in entries), place * GROUP + vertex[chosen]
            matrix = _seen(light_side, closing, *(filled_up(x, length) for x in columns), wide, channels)
            clusters = [part.clusters[number] for number in seen[some]]
            lines = np.asarray(_mixed(matrix, *_together(clusters, wide)))
            for cluster, sums in zip(clusters, lines, strict=False):
                yield cluster.support, sums[: len(cluster.support)]


def _together(clusters: list[Cluster], wide: int) -> tuple[Float[np.ndarray, "p q s"], Float[np.ndarray, "p c q r"]]:
    """Shared rows and weights of a few clusters of a size, filled up to it."""
    q, s = _size(clusters[0])
    c, _, r = clusters[0].weights.shape
    basis, weights = np.zeros((wide, q, s), np.float32), np.zeros((wide, c, q, r), np.float32)
    for i, cluster in enumerate(clusters):
        basis[i, : len(cluster.basis), : len(cluster.support)] = cluster.basis
        weights[i, :, : len(cluster.basis)] = cluster.weights
    return basis, weights


def _size(cluster: Cluster) -> tuple[int, int]:
    """What a cluster's shared rows and coefficients are filled up to: few sizes, the same for all scenes."""
    return _power(len(cluster.basis), 2, 4), _power(len(cluster.support), 2, 32)


def _runs(array: np.ndarray, most: int):
    """Runs of at most `most` entries."""
    return (array[start : start + most] for start in range(0, len(array), most))


def _part(operator: Operator, block: Block) -> _Part:
    if isinstance(operator, SparseRows):
        clusters = as_clusters(operator, GROUP * block.reflection.terms)
    else:
        assert isinstance(operator, Clustered)
        clusters = operator.clusters()
    sizes = [_size(cluster) if len(cluster.support) else None for cluster in clusters]
    number = {size: i for i, size in enumerate(sorted({size for size in sizes if size}))}
    return _Part(clusters, np.array([number[size] if size else -1 for size in sizes]))


def _outgoing_shape(block: Block):
    """The shape [1, k, c] of what closes a block's terms; nothing is computed."""
    single = jnp.zeros((1, 3)), jnp.zeros((1, 2)), jnp.zeros(1)
    return jax.eval_shape(outgoing, block.reflection, block.weight, *single).shape


def _power(count: int, base: int, least: int = 1) -> int:
    """The first of the numbers least · base^e that is at least the count."""
    while least < count:
        least *= base
    return least


_outgoing = jax.jit(outgoing)


@jax.jit
def _side_by_side(sides: list[Float[Array, "m _ _ f"]]) -> Float[Array, "f m k c"]:
    """Texels first, terms of all reflections one after the other."""
    channels = max(side.shape[2] for side in sides)
    wide = [jnp.broadcast_to(side, (*side.shape[:2], channels, side.shape[3])) for side in sides]
    return jnp.moveaxis(jnp.concatenate(wide, axis=1), -1, 0)


@jax.jit
def _received(light_side: Float[Array, "f m k c1"], seen: Float[Array, "f m c2"]) -> Float[Array, "m k c"]:
    """Light terms of radiance that is seen in the texels."""
    channels = max(light_side.shape[-1], seen.shape[-1])
    both = jnp.broadcast_to(light_side, (*light_side.shape[:3], channels)), seen
    return jnp.einsum(
        "fmkc,fmc->mkc", both[0], jnp.broadcast_to(both[1], (*seen.shape[:2], channels)), precision="highest"
    )


@functools.partial(jax.jit, static_argnames=("groups", "channels"))
def _seen(
    light_side: Float[Array, "f m k c1"],
    closing: Float[Array, "h l c2"],
    receiver: Int[Array, " e"],
    texel: Int[Array, " e"],
    hit: Int[Array, " e"],
    share: Float[Array, " e"],
    row: Int[Array, " e"],
    groups: int,
    channels: int,
) -> Float[Array, "p v m k l c"]:
    """How much every row of a group sees of every vertex of some groups: a sum over what hits are made of."""
    _, m, k, _ = light_side.shape
    value = light_side[texel, receiver][:, :, None] * (closing[hit] * share[:, None, None])[:, None]
    value = jnp.broadcast_to(value, (*value.shape[:3], channels))
    out = jnp.zeros((groups * GROUP * m, k, closing.shape[1], channels), value.dtype)
    # Filling has no share.
    out = out.at[row * m + receiver].add(value, mode="promise_in_bounds")
    return out.reshape(groups, GROUP, m, k, closing.shape[1], channels)


@jax.jit
def _mixed(
    seen: Float[Array, "p v m k l c"], basis: Float[Array, "p q s"], weights: Float[Array, "p c1 q r"]
) -> Float[Array, "p s w"]:
    """The rows of what is seen, each group's over its own coefficients."""
    p, v, m, k, terms, c = seen.shape
    own = weights.reshape(p, weights.shape[1], -1, v, terms)
    own = jnp.broadcast_to(own, (p, c, *own.shape[2:]))
    mixtures = jnp.einsum("pcqvl,pvmklc->pqmkc", own, seen, precision="highest")
    return jnp.einsum("pqs,pqmkc->psmkc", basis, mixtures, precision="highest").reshape(p, -1, m * k * c)


def remaining(transport: PrecomputedTransport, before: PrecomputedTransport | None, albedo: float) -> float:
    """How much light the bounces that are still missing may add, relative to all there is.

    Light is an even white sky, and what surfaces emit; the larger share counts. Each bounce reflects at most `albedo`
    of the one before, so that after the last step it is step · ρ/(1 − ρ).

    Args:
        transport: with the last bounce.
        before: with one less; None where `transport` is of direct light.
        albedo: ρ < 1, the largest of the scene.
    """
    steps = []
    for now, then in zip(_lit(transport), _lit(before) if before else (0.0, 0.0), strict=True):
        size = float(np.linalg.norm(now))
        steps.append(float(np.linalg.norm(now - then)) / size if size > 0 else 0.0)
    return max(steps) * albedo / (1 - albedo)


def _lit(transport: PrecomputedTransport) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Radiance along the normals of all vertices: under an even white sky, and by the light that surfaces emit."""
    white = np.asarray(transport.basis.encode(as_array(np.ones(transport.operator.shape[1], np.float32))))
    at_normal = [np.asarray(rows, np.float32) for rows in ([[0.0, 0.0, 1.0]], [[0.0, 0.0]], [1.0])]
    reflected, emitted = [], []
    for block in transport.blocks:
        closing = np.asarray(_outgoing(block.reflection, block.weight, *at_normal))
        channels = max(block.operator.shape[2], closing.shape[-1])
        terms = _applied(block.operator, np.repeat(white[:, None], channels, axis=1))
        reflected.append(np.sum(np.asarray(terms).reshape(-1, block.reflection.terms, channels) * closing, axis=1))
        own = np.zeros(3) if block.emission is None else np.asarray(block.emission)
        more = 0.0 if block.emitted is None else np.sum(np.asarray(block.emitted) * closing, axis=1)
        emitted.append(np.broadcast_to(own + more, (len(reflected[-1]), 3)))
    flat = [np.concatenate([part.ravel() for part in parts]) for parts in (reflected, emitted)]
    return flat[0], flat[1]


_applied = jax.jit(lambda operator, light: operator.apply(light))
