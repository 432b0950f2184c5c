"""The final gather: rows of what each receiver gets of the diffuse light of a cloud (Hašan 2006 §4.3).

Of a receiver x and a point s of the cloud, which stands for an area A and leaves diffuse radiance,

    F(x, s) = f(ω_i, ω_o) V(x, s) c A / (r² + c A/π),    c = max(0, N_x·ω_i) max(0, −N_s·ω_i)

where c A/π keeps the energy of what is near: a disc of that area right above gives no more. Without c there it would be
right for such a disc alone, and half as much again would be lost along the edges of a room. Of a receiver that yet
gets more than the whole hemisphere gives, all is scaled down to that. Points that are far for their distance from each
other are taken together: a node of their tree gets one ray, and its points what that gives each; where they are near,
the parts of what each point stands for are gathered from one by one.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.basis.quadtree import z_curve
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.gather.gather_cloud import PARTS, GatherCloud
from jaxrelight.gather.gathered import Gathered
from jaxrelight.geometry.receivers import Receivers
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import bucket, filled_up

# What is done where receivers are near points: the form above, or no element above 0.1, as in the paper.
Near = Literal["disc", "clamp"]
_CLAMP = 0.1 * np.pi

# Receivers whose rows are made at once, so that they stay in cache.
_RECEIVER_BATCH = 4


class _Level(NamedTuple):
    """The nodes of the tree that stand for 4^h points each, or below the points for their parts.

    Attributes:
        centres: of their bounding boxes, which hold the parts of their points.
        diagonals: of those.
        chosen: number among points and parts of what stands for each: the point nearest to the mean of all.
        areas: mean of those of their points, or of the part.
    """

    centres: Float[np.ndarray, "n 3"]
    diagonals: Float[np.ndarray, " n"]
    chosen: Int[np.ndarray, " n"]
    areas: Float[np.ndarray, " n"]


class Links(NamedTuple):
    """The nodes that a group of receivers gathers from.

    Attributes:
        heights: h, of 4^h points each.
        nodes: numbers among those of their height; of a part, that of its point.
        places: numbers among points, followed by their parts, of what stands for them.
        areas: mean of those of their points, or of the part.
    """

    heights: Int[np.ndarray, " l"]
    nodes: Int[np.ndarray, " l"]
    places: Int[np.ndarray, " l"]
    areas: Float[np.ndarray, " l"]


class Sources(NamedTuple):
    """What stands for the nodes that are gathered from, filled up to a length.

    Attributes:
        positions: in scene space.
        normals: unit normals.
        areas: of each of the points that a node stands for.
        counts: of those.
    """

    positions: Float[np.ndarray, "l 3"]
    normals: Float[np.ndarray, "l 3"]
    areas: Float[np.ndarray, " l"]
    counts: Float[np.ndarray, " l"]


class FinalGather:
    """Gathers rows over the Haar coefficients of a cloud's image.

    Attributes:
        cloud: where light comes from.
        emits: whether what surfaces emit is gathered beside rows: it is light of the cloud, and is not.
        rays: traced so far.
    """

    def __init__(
        self, cloud: GatherCloud, tracer: Tracer, threshold: float = 0.1, near: Near = "disc", peak: float = 0.01
    ):
        """Prepares to gather at receivers in the cloud's scene.

        Args:
            cloud: where light comes from.
            tracer: of the scene.
            threshold: nodes are split where the square of their diagonal is more than this times that of their
                distance.
            near: what is done where receivers are near points.
            peak: nodes are split where they would give any receiver more than this share of what a BRDF that is not
                constant reflects of all of them.
        """
        self.cloud = cloud
        self.emits = False
        self.rays = 0
        self._tracer, self._threshold, self._peak = tracer, threshold, peak
        self._near: Near = near
        self._tree = z_curve(cloud.side)
        self._levels = [_level(cloud, self._tree, 4**h) for h in range(cloud.side.bit_length())]
        self._parts = _parts(cloud, self._tree)
        self._positions = np.concatenate([cloud.positions, cloud.parts.reshape(-1, 3)])
        self._normals = np.concatenate([cloud.face_normals, cloud.part_normals.reshape(-1, 3)])
        # Rays take the ends in single precision.
        self._ends = (self._positions + OFFSET * self._normals).astype(np.float32)

    def links(self, positions: Float[np.ndarray, "m 3"], normals: Float[np.ndarray, "m 3"]) -> Links:
        """As few nodes as are needed for all of the receivers, without those that are behind all of them."""
        active, links = np.zeros(1, np.int64), []
        own = np.sum(positions * normals, axis=1)[:, None]
        squares = np.sum(positions**2, axis=1)[:, None]
        for h, level in reversed(list(enumerate([self._parts, *self._levels], -1))):
            centres, diagonals = level.centres[active], level.diagonals[active]
            above = normals @ centres.T - own > -diagonals / 2
            distance = squares + np.sum(centres**2, axis=1) - 2 * positions @ centres.T
            nearest = np.min(np.where(above, distance, np.finfo(float).max), axis=0)
            split = (diagonals**2 > self._threshold * nearest) & (h >= 0)
            kept = active[above.any(axis=0) & ~split]
            nodes = kept if h >= 0 else kept // PARTS
            links.append(Links(np.full(len(kept), max(h, 0)), nodes, level.chosen[kept], level.areas[kept]))
            active = (4 * active[split][:, None] + np.arange(4)).reshape(-1)
            if not len(active):
                break
        return Links(*(np.concatenate(arrays) for arrays in zip(*links, strict=True)))

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
            channels: of the rows of each; by default its own.
        """
        positions, normals = receivers.positions[group], receivers.normals[group]
        links = self._refined(self.links(positions, normals), positions, frames, reflections)
        points = links.places
        visible = self._visible(receivers.origins[group], normals, points)
        sources = self._sources(links)
        seen = np.zeros((len(positions), len(sources.areas)), bool)
        seen[:, : len(points)] = visible
        columns, wavelets = self._wavelets(links)
        gathered = []
        for reflection, channel in zip(reflections, channels or self.channels_of(reflections), strict=True):
            arguments = as_array(positions, jnp.float32), as_array(frames), reflection
            values = np.asarray(_received(*arguments, sources, as_array(seen), self._near))
            m, k, c, _ = values.shape
            rows = wavelets.T @ values[..., : len(points)].reshape(-1, len(points)).T
            rows = np.ascontiguousarray(rows.T).reshape(m, k, c, len(columns))
            gathered.append(Gathered(columns, np.broadcast_to(rows, (m, k, channel, len(columns))), None))
        return gathered

    def _sources(self, links: Links) -> Sources:
        points, length = links.places, bucket(max(len(links.places), 1), 1024, 2)
        arrays = self._positions[points], self._normals[points], links.areas, 4.0**links.heights
        return Sources(*(filled_up(np.asarray(array), length) for array in arrays))

    def _refined(self, links: Links, positions, frames, reflections: Sequence[Reflection]) -> Links:
        """Nodes split where they lie in a BRDF's peak: where one gives a receiver more than a share of its row."""
        glossy = [one for one in reflections if not one.is_constant]
        if not glossy or self._peak >= 1:
            return links
        placed = as_array(positions, jnp.float32), as_array(frames)
        active, refined = links, []
        totals: list[Array | None] = [None] * len(glossy)
        while len(active.places):
            sources = self._sources(active)
            largest = np.zeros(len(active.places))
            for i, reflection in enumerate(glossy):
                shares, totals[i] = _largest_shares(*placed, reflection, sources, totals[i], self._near)
                largest = np.maximum(largest, np.asarray(shares)[: len(largest)])
            split = (largest > self._peak) & (active.places < len(self._tree))
            refined.append(Links(*(array[~split] for array in active)))
            active = self._children(Links(*(array[split] for array in active)))
        return Links(*(np.concatenate(arrays) for arrays in zip(*refined, strict=True)))

    def _children(self, links: Links) -> Links:
        """The children of nodes that are not parts."""
        children = []
        for h in np.unique(links.heights):
            level = self._levels[h - 1] if h else self._parts
            nodes = (4 * links.nodes[links.heights == h][:, None] + np.arange(4)).reshape(-1)
            of = nodes if h else nodes // PARTS
            children.append(Links(np.full(len(nodes), max(h - 1, 0)), of, level.chosen[nodes], level.areas[nodes]))
        none = Links(*(array[:0] for array in links))
        return Links(*(np.concatenate(arrays) for arrays in zip(none, *children, strict=True)))

    def channels_of(self, reflections: Sequence[Reflection]) -> list[int]:
        """Channels of the rows of each of a material's reflections: its own."""
        return [reflection.channels for reflection in reflections]

    def _visible(self, origins, normals, points: Int[np.ndarray, " l"]) -> Bool[np.ndarray, "m l"]:
        """Whether each receiver and point see each other, and both are in front."""
        turned, ends = self._normals[points].astype(np.float32), self._ends[points]
        origins, normals = origins.astype(np.float32), normals.astype(np.float32)
        across = normals @ ends.T > np.sum(normals * origins, axis=1)[:, None]
        visible = across & (origins @ turned.T >= np.sum(turned * ends, axis=1))
        receiver, point = np.nonzero(visible)
        away = ends[point] - origins[receiver]
        self.rays += len(away)
        # Rays as long as the way, less than what the end is lifted by.
        blocked = self._tracer.blocked(origins[receiver], away, np.full(len(away), 1 - 1e-4, np.float32))
        visible[receiver, point] = ~blocked
        return visible

    def _wavelets(self, links: Links) -> tuple[Int[np.ndarray, " n"], scipy.sparse.csr_matrix]:
        """Haar coefficients of an image that is constant in each node: their numbers, and of each node all of them."""
        side = self.cloud.side
        entries, numbers, values = [], [], []
        top = side.bit_length() - 1
        for h in range(top + 1):
            mine = np.flatnonzero(links.heights == h)
            if not len(mine):
                continue
            node = links.nodes[mine]
            entries.append(mine)
            numbers.append(np.zeros(len(mine), np.int64))
            values.append(np.full(len(mine), 4.0**h / side))
            for a in range(h + 1, top + 1):
                block, digit = node >> 2 * (a - h), (node >> 2 * (a - h - 1)) & 3
                m = side >> a
                y, x = np.divmod(z_curve(m)[block], m)
                right, below = np.where(digit & 1, -1.0, 1.0), np.where(digit & 2, -1.0, 1.0)
                size = 4.0**h / 2**a
                for number, sign in (
                    (y * side + m + x, right),
                    ((m + y) * side + x, below),
                    ((m + y) * side + m + x, right * below),
                ):
                    entries.append(mine)
                    numbers.append(number)
                    values.append(size * sign)
        columns, place = np.unique(np.concatenate([np.zeros(0, np.int64), *numbers]), return_inverse=True)
        shape = len(links.nodes), len(columns)
        given = np.concatenate([np.zeros(0), *values]), (np.concatenate([np.zeros(0, np.int64), *entries]), place)
        return columns, scipy.sparse.csr_matrix(given, shape, dtype=np.float32)


def _level(cloud: GatherCloud, tree: Int[np.ndarray, " g"], size: int) -> _Level:
    members = tree.reshape(-1, size)
    points = cloud.positions[members]
    inside = np.concatenate([points, cloud.parts[members].reshape(len(members), -1, 3)], axis=1)
    low, high = inside.min(axis=1), inside.max(axis=1)
    away = np.sum((points - points.mean(axis=1, keepdims=True)) ** 2, axis=2)
    chosen = np.take_along_axis(members, np.argmin(away, axis=1)[:, None], axis=1)[:, 0]
    return _Level((low + high) / 2, np.linalg.norm(high - low, axis=1), chosen, cloud.areas[members].mean(axis=1))


def _parts(cloud: GatherCloud, tree: Int[np.ndarray, " g"]) -> _Level:
    """The parts of the points, in the order of the tree."""
    chosen = len(tree) + (PARTS * tree[:, None] + np.arange(PARTS)).reshape(-1)
    centres, areas = cloud.parts[tree].reshape(-1, 3), cloud.part_areas[tree].reshape(-1)
    # Half as wide as a square of their area is long: they are split no further, and hardly ever behind by that.
    return _Level(centres, np.sqrt(areas), chosen, areas)


@eqx.filter_jit
def _received(
    positions: Float[Array, "m 3"],
    frames: Float[Array, "m 3 3"],
    reflection: Reflection,
    sources: "Sources",
    visible: Bool[Array, "m l"],
    near: Near,
) -> Float[Array, "m k c l"]:
    """The kernel F of every receiver and source."""
    own, shared = eqx.partition(reflection, reflection.per_receiver)

    def row(receiver):
        position, frame, own, visible = receiver
        own_reflection = eqx.combine(own, shared)
        away = sources.positions - position[None]
        omega_i = safe.normalize(away)
        local = jnp.matmul(frame, omega_i.T, precision="highest")
        square = jnp.sum(away**2, axis=1)
        cosines = jnp.maximum(local[2], 0) * jnp.maximum(-jnp.sum(omega_i * sources.normals, axis=1), 0)
        areas = cosines * sources.areas
        if near == "disc":
            share = jnp.where(visible, areas / jnp.maximum(square + areas / np.pi, 1e-20), 0)
            share /= jnp.maximum(jnp.sum(share * sources.counts) / np.pi, 1)
        else:
            share = jnp.where(visible, jnp.minimum(areas / jnp.maximum(square, 1e-20), _CLAMP), 0)
        return jax.vmap(own_reflection.light_side, in_axes=1, out_axes=2)(local) * share[None, None]

    return jax.lax.map(row, (positions, frames, own, visible), batch_size=_RECEIVER_BATCH)


@eqx.filter_jit
def _largest_shares(
    positions, frames, reflection: Reflection, sources: Sources, totals: Float[Array, "m k c 1"] | None, near: Near
) -> tuple[Float[Array, " l"], Float[Array, "m k c 1"]]:
    """The largest share of a row that each source has, as if all were visible; and the sums of the rows."""
    seen = jnp.ones((len(positions), len(sources.areas)), bool)
    values = _received(positions, frames, reflection, sources, seen, near) * sources.counts[None, None, None]
    totals = jnp.sum(values, axis=3, keepdims=True) if totals is None else totals
    return jnp.max(values / jnp.maximum(totals, 1e-30), axis=(0, 1, 2)), totals
