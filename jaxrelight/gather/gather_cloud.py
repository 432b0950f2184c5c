"""Points on all surfaces of a scene, which stand for them where light is gathered (Hašan 2006 §4.1)."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.basis.quadtree import flattened, z_curve
from jaxrelight.errors import InputError
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import OFFSET

# Where directions of the sky are, in scene space, whose coordinates are at most 1.
FAR = 1000.0

_GOLDEN = (np.sqrt(5) - 1) / 2

# Parts of what each point stands for, told apart where light is gathered nearby.
PARTS = 4

# Faces are halved while they have longer edges, and a larger area, than these in units of how far points are apart:
# else what points stand for is less compact, and three times as many of them have to be looked at.
PIECES = 0.5, 1 / 16

# Values so near each other, relative to the largest, are even: symmetric scenes have many of them, and which one
# rounding leaves larger depends on where in the world a scene is.
_EVEN = 2.0**-20

# How much points of some positions, normals and areas are worth.
Worth = Callable[[np.ndarray, np.ndarray, np.ndarray], Float[np.ndarray, " p"]]


@dataclasses.dataclass(frozen=True)
class GatherCloud:
    """A power of four of surface points in scene space, in the order of `quadtree.flattened`: an image, row by row.

    Attributes:
        positions: on the surface.
        normals: unit shading normals, on the side that the point stands for.
        face_normals: unit normals of the faces on that side.
        areas: of surface, in scene space, that each point stands for.
        faces: that the points lie on; −1 for directions of the sky.
        barycentric: weights of their corners.
        back: whether they stand for the back of a two-sided mesh.
        parts: positions of points in the equal parts of what each stands for.
        part_normals: unit normals of their faces on that side.
        part_areas: of surface that each part stands for.
    """

    positions: Float[np.ndarray, "g 3"]
    normals: Float[np.ndarray, "g 3"]
    face_normals: Float[np.ndarray, "g 3"]
    areas: Float[np.ndarray, " g"]
    faces: Int[np.ndarray, " g"]
    barycentric: Float[np.ndarray, "g 3"]
    back: Bool[np.ndarray, " g"]
    parts: Float[np.ndarray, "g p 3"]
    part_normals: Float[np.ndarray, "g p 3"]
    part_areas: Float[np.ndarray, "g p"]

    @property
    def side(self) -> int:
        """Side of the image, in points."""
        return round(len(self.positions) ** 0.5)

    @property
    def of_sky(self) -> Bool[np.ndarray, " g"]:
        """Which of them are directions of the sky; none, or the last quarter of the tree."""
        return self.faces < 0


def gather_cloud(
    surfaces: Surfaces,
    count: int,
    importance: Worth | None = None,
    seed: int = 0,
    balance: float = 30.0,
    sky: bool = False,
) -> GatherCloud:
    """Points with a density of the importance, the same everywhere without.

    Triangles are halved until they are small beside what a point stands for, and each is worth what a random point of
    it is. They are put in an order of which every run is compact, by splits into halves of equal weight across
    the longest side. Along it the total of area times importance is cut into `count` equal pieces, and each gets a
    point, and one more in each of its parts: the budget of every half is its weight, but for one point.

    Args:
        surfaces: of the scene.
        count: of points; a power of four.
        importance: of places in scene space, above 0.
        seed: of where in its piece each point lies.
        balance: see `flattened`.
        sky: a quarter of the points are directions of an environment instead (the paper's future work, §6).

    Raises:
        InputError: for a count that is no power of four from 64 on.
    """
    if count < 64 or count & (count - 1) or count.bit_length() % 2 == 0:
        raise InputError(f"gather samples are {count:,}; they must be a power of four: 4,096, 16,384, 65,536, …")
    random = np.random.default_rng(seed)
    count = count - count // 4 if sky else count
    face, corners, back = _pieces(surfaces, count)
    sign = np.where(back, -1.0, 1.0)[:, None]
    ends = np.einsum("pkc,pcx->pkx", corners, surfaces.vertices[surfaces.faces[face]])
    weight = area = np.linalg.norm(np.cross(ends[:, 1] - ends[:, 0], ends[:, 2] - ends[:, 0]), axis=1) / 2
    if importance is not None:
        inside = np.einsum("pk,pkx->px", _in_triangles(*random.random((2, len(face)))), ends)
        weight = area * importance(inside, sign * surfaces.face_normals(face), area)
    # Backs are surfaces apart, however near their fronts are.
    order = _compact(ends.mean(axis=1) + np.where(back[:, None], [4.0, 0, 0], 0), weight, count)
    sums = np.cumsum(weight[order])

    def drawn(parts: int) -> list[np.ndarray]:
        """Positions, face normals, areas, shading normals, faces, weights and sides of points in equal pieces."""
        n = parts * count
        places = (np.arange(n) + random.random(n)) * (sums[-1] / n)
        which = np.minimum(np.searchsorted(sums, places, side="right"), len(order) - 1)
        piece = order[which]
        along = np.clip((sums[which] - places) / np.maximum(weight[piece], 1e-300), 0, 1)
        across = (np.arange(n) * _GOLDEN + random.random()) % 1
        barycentric = np.einsum("pk,pkc->pc", _in_triangles(along, across), corners[piece])
        mine = surfaces.faces[face[piece]]
        positions = np.einsum("pk,pkx->px", barycentric, surfaces.vertices[mine])
        face_normals = surfaces.face_normals(face[piece])
        normals = np.einsum("pk,pkx->px", barycentric, surfaces.normals[mine])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = sign[piece] * np.where(length > 1e-9, normals / np.maximum(length, 1e-9), face_normals)
        areas = sums[-1] / n * area[piece] / weight[piece]
        return [positions, sign[piece] * face_normals, areas, normals, face[piece], barycentric, back[piece]]

    positions, face_normals, areas, normals, *rest = drawn(1)
    parts = [array.reshape(count, PARTS, *array.shape[1:]) for array in drawn(PARTS)[:3]]
    arrays = positions, normals, face_normals, areas, *rest, *parts
    if not sky:
        laid_out = flattened(positions, normals, balance)
        return GatherCloud(*(array[laid_out] for array in arrays))
    # Thirds along the order, which are compact, and the sky, a quarter of the image each.
    quarters = [tuple(array[third] for array in arrays) for third in np.arange(count).reshape(3, -1)]
    quarters.append(_sky_points(count // 3))
    images = []
    for quarter in quarters:
        laid_out = flattened(quarter[0], quarter[1], balance)
        images.append(tuple(array[laid_out] for array in quarter))
    place = np.empty(4 * len(images[0][0]), np.int64)
    place[z_curve(round(len(place) ** 0.5))] = np.concatenate(
        [n * len(images[0][0]) + z_curve(round(len(images[0][0]) ** 0.5)) for n in range(4)]
    )
    return GatherCloud(*(np.concatenate(of_all)[place] for of_all in zip(*images, strict=True)))


def _sky_points(count: int) -> tuple[np.ndarray, ...]:
    """Directions of equal solid angles as points far away, that face the scene; the arrays of a cloud."""
    number = np.arange(count)
    # A spiral of equal steps in height, which is equal areas.
    y, turn = 1 - (2 * number + 1) / count, 2 * np.pi * _GOLDEN * number
    ring = np.sqrt(1 - y * y)
    towards = np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], axis=1)
    # Four around each, in the plane across it.
    aside = np.cross(towards, np.where(np.abs(y)[:, None] < 0.9, [[0.0, 1, 0]], [[1.0, 0, 0]]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    across, step = np.cross(towards, aside), np.sqrt(np.pi / count) / 2
    around = [towards + step * (a * aside + b * across) for a in (-1, 1) for b in (-1, 1)]
    parts = np.stack([one / np.linalg.norm(one, axis=1, keepdims=True) for one in around], axis=1)
    areas = np.full(count, 4 * np.pi * FAR**2 / count)
    none, weights = np.full(count, -1), np.zeros((count, 3))
    whole = FAR * towards, -towards, -towards, areas, none, weights, np.zeros(count, bool)
    return *whole, FAR * parts, -parts, np.broadcast_to(areas[:, None] / PARTS, (count, PARTS))


def cloud_receivers(cloud: GatherCloud) -> Receivers:
    """The points themselves as receivers, in their order in groups of the tree: those of a group are alike.

    Directions of the sky are none, and have the slot of another.
    """
    order = z_curve(cloud.side)
    order = order[~cloud.of_sky[order]]
    slot_of = np.zeros(len(cloud.positions), np.int64)
    slot_of[order] = np.arange(len(order))
    groups = -(-len(order) // GROUP)
    # The cloud may be smaller than a group, which is filled up with its first point.
    member = np.pad(order, (0, groups * GROUP - len(order)), constant_values=order[0]).reshape(groups, GROUP)
    filled = np.full(groups, min(GROUP, len(order)))
    normals, face_normals = cloud.normals[member], cloud.face_normals[member]
    origins = cloud.positions[member] + OFFSET * face_normals
    none = np.zeros_like(normals)
    of_material = np.zeros(groups, np.int64)
    return Receivers(
        cloud.positions[member], normals, face_normals, origins, none, None, None, None, of_material, filled, slot_of
    )


def _pieces(
    surfaces: Surfaces, count: int
) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, "p 3 3"], Bool[np.ndarray, " p"]]:
    """Faces on both of their sides where they have two, halved across their longest edges until they are small.

    Returns:
        The face of every piece, the barycentric weights of its corners, and whether it is the back.
    """
    two_sided = surfaces.two_sided[surfaces.mesh_of_vertex[surfaces.faces[:, 0]]]
    face = np.concatenate([np.arange(len(surfaces.faces)), np.flatnonzero(two_sided)])
    back = np.arange(len(face)) >= len(surfaces.faces)
    corners = np.broadcast_to(np.eye(3), (len(face), 3, 3))
    ends = surfaces.vertices[surfaces.faces[face]]
    area = np.linalg.norm(np.cross(ends[:, 1] - ends[:, 0], ends[:, 2] - ends[:, 0]), axis=1) / 2
    (longest, largest), square, pieces = PIECES, area.sum() / count, []
    while len(face):
        ends = np.einsum("pkc,pcx->pkx", corners, surfaces.vertices[surfaces.faces[face]])
        # These are the lengths of the edges that face the corners.
        length = np.linalg.norm(np.roll(ends, -1, axis=1) - np.roll(ends, 1, axis=1), axis=2)
        area = np.linalg.norm(np.cross(ends[:, 1] - ends[:, 0], ends[:, 2] - ends[:, 0]), axis=1) / 2
        split = (length.max(axis=1) > longest * np.sqrt(square)) & (area > largest * square)
        pieces.append((face[~split], corners[~split], back[~split]))
        tip = _first_largest(length[split])
        a, b, c = (corners[split, (tip + k) % 3] for k in range(3))
        halves = np.stack([a, b, (b + c) / 2], axis=1), np.stack([a, (b + c) / 2, c], axis=1)
        face, corners, back = np.tile(face[split], 2), np.concatenate(halves), np.tile(back[split], 2)
    return tuple(np.concatenate(arrays) for arrays in zip(*pieces, strict=True))  # pyright: ignore[reportReturnType]


def _in_triangles(u: Float[np.ndarray, " p"], v: Float[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
    """Barycentric weights of points that are spread over triangles as (u, v) are over squares."""
    root = np.sqrt(u)
    return np.stack([1 - root, root * (1 - v), root * v], axis=1)


def _compact(points: Float[np.ndarray, "p 3"], weights: Float[np.ndarray, " p"], pieces: int) -> Int[np.ndarray, " p"]:
    """An order in which runs of a `pieces`-th of the weight are compact."""
    order, of_set = np.arange(len(points)), np.zeros(len(points), np.int64)
    for _ in range(pieces.bit_length() - 1):
        starts = np.flatnonzero(np.diff(of_set, prepend=-1))
        number = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(order))))
        mine = points[order]
        low = np.minimum.reduceat(mine, starts)
        extent = np.maximum.reduceat(mine, starts) - low
        longest = _first_largest(extent)
        along = (mine - low[number])[np.arange(len(mine)), longest[number]]
        length = extent[np.arange(len(extent)), longest][number]
        # Those that are even along it keep their order.
        order = order[np.lexsort((np.rint(along / np.where(length > 0, length * _EVEN, 1)), number))]
        sums = np.cumsum(weights[order])
        # Of the set, up to the middle of each triangle.
        before = np.where(starts > 0, sums[starts - 1], 0)[number]
        total = np.add.reduceat(weights[order], starts)[number]
        of_set = 2 * number + (sums - before - weights[order] / 2 > total * (0.5 + _EVEN))
    return order


def _first_largest(values: Float[np.ndarray, "p n"]) -> Int[np.ndarray, " p"]:
    """The number of the first of each row's largest values that are even."""
    return np.argmax(values >= values.max(axis=1, keepdims=True) * (1 - _EVEN), axis=1)
