"""Solid angles that cube-map texels share with lat-long pixels.

Along a meridian every border of a texel or pixel is crossed at a known latitude, and the side faces' columns end at
meridians. So the integral over latitude is exact, and Gauss's rule between neighbouring meridians does the rest. What
that leaves is balanced until each texel and each pixel has its own solid angle.

Sixteen symmetries take the sphere's piece 0 ≤ x ≤ z, y ≥ 0 to all others, and texels to texels and pixels to pixels
where the columns are a multiple of eight. So one piece is computed, with columns split where they must be.
"""

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse import linalg

from jaxrelight.basis import cubemap

_BLOCK = 2**21  # cells between borders that are looked at together


def overlaps(
    height: int, width: int, resolution: int
) -> Iterator[tuple[Int[np.ndarray, " s"], Int[np.ndarray, " s"], Float[np.ndarray, " s"]]]:
    """Sixteen lists of (texel, pixel, shared solid angle in steradians); a pair's shares add up over all of them.

    Texels are in the order of `cubemap.directions`, pixels row by row.
    """
    split = 8 // math.gcd(width, 8)
    columns = width * split
    texel, row, column, shared = _piece(height, columns, resolution)
    direction = cubemap.directions(resolution)[texel]
    for turns in range(4):
        for mirrored in (False, True):
            for flipped in (False, True):
                # Longitude is 2π (1/2 − u), and the piece lies left of u = 1/2.
                at = columns - 1 - column if mirrored else column
                pixel = (height - 1 - row if flipped else row) * width + (
                    at - turns * (columns // 4)
                ) % columns // split
                yield cubemap.texel_of(_moved(direction, turns, mirrored, flipped), resolution), pixel, shared


def _moved(direction: np.ndarray, turns: int, mirrored: bool, flipped: bool) -> np.ndarray:
    """Directions after a mirror in x and one in y, then quarter turns from +z towards +x."""
    x, y, z = np.moveaxis(direction, -1, 0)
    x, y = (-x if mirrored else x), (-y if flipped else y)
    for _ in range(turns):
        x, z = z, -x
    return np.stack([x, y, z], axis=-1)


def _piece(height: int, columns: int, resolution: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Texel, row, column and shared solid angle where 0 ≤ x ≤ z and y ≥ 0."""
    edge = np.linspace(-1, 1, resolution + 1)
    inner = edge[edge > 1e-9]
    meridians = [
        np.linspace(0, np.pi / 4, columns // 8 + 1),
        np.linspace(0, np.pi / 4, min(4 * resolution, max(1024, resolution)) + 1),
        np.arctan(inner),
    ]
    cuts = np.unique(np.concatenate(meridians).clip(0, np.pi / 4).round(14))
    middle, half = (cuts[1:] + cuts[:-1]) / 2, (cuts[1:] - cuts[:-1]) / 2
    longitudes = (middle + half * np.array([[-1], [1]]) / np.sqrt(3)).T.ravel()
    weights = np.repeat(half, 2)

    step = max(_BLOCK // (height // 2 + 2 * resolution), 1)
    blocks = [
        _cells(longitudes[i : i + step], weights[i : i + step], inner, height, columns, resolution)
        for i in range(0, len(longitudes), step)
    ]
    key, shared = _summed(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))
    texel, pixel = key // (height * columns), key % (height * columns)
    return texel, pixel // columns, pixel % columns, _balanced(texel, pixel, shared, height, columns, resolution)


def _cells(
    longitude: Float[np.ndarray, " l"],
    weight: Float[np.ndarray, " l"],
    inner: Float[np.ndarray, " b"],
    height: int,
    columns: int,
    resolution: int,
) -> tuple[Int[np.ndarray, " s"], Float[np.ndarray, " s"]]:
    """Keys (texel, pixel) and shares of the cells between borders along some meridians."""
    sine, cosine = np.sin(longitude)[:, None], np.cos(longitude)[:, None]
    # tan(latitude) of the borders: of the side face's rows, then of the grid on the cap, then of lat-long rows.
    cap = np.concatenate([np.minimum(sine / inner, 1e9), np.minimum(cosine / inner, 1e9)], axis=1)
    rows = np.pi / 2 - np.pi / height * np.arange(height // 2 + 1)
    latitude = np.concatenate(
        [
            np.arctan(inner * cosine),
            np.arctan(np.maximum(cap, cosine)),
            np.broadcast_to(np.append(rows, 0), (len(longitude), len(rows) + 1)),
        ],
        axis=1,
    )
    latitude.sort(axis=1)
    shared = np.diff(np.sin(latitude), axis=1) * weight[:, None]
    some = shared > 1e-15
    which = np.broadcast_to(np.arange(len(longitude))[:, None], some.shape)[some]
    middle = ((latitude[:, 1:] + latitude[:, :-1]) / 2)[some]
    row = np.minimum(((0.5 - middle / np.pi) * height).astype(np.int64), height - 1)
    column = columns // 2 - 1 - (longitude * (columns / (2 * np.pi))).astype(np.int64)[which]
    up = np.tan(middle)
    direction = np.stack([sine[which, 0], up, cosine[which, 0]], axis=-1)
    texel = cubemap.texel_of(direction, resolution)
    return _summed((texel * height + row) * columns + column, shared[some])


def _summed(key: np.ndarray, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each key once, ascending, with the sum of its shares."""
    order = np.argsort(key, kind="stable")
    key = key[order]
    starts = np.flatnonzero(np.diff(key, prepend=-1))
    return key[starts], np.add.reduceat(shared[order], starts)


def _balanced(
    texel: Int[np.ndarray, " s"],
    pixel: Int[np.ndarray, " s"],
    shared: Float[np.ndarray, " s"],
    height: int,
    columns: int,
    resolution: int,
) -> Float[np.ndarray, " s"]:
    """Shares with the least relative changes that give each texel and each pixel its solid angle in this piece.

    A share s of texel i and pixel j becomes s (1 + a_i + b_j). The pixels' equations are solved for b, the rest by
    conjugate gradients: neighbours trade what a texel lacks, so few steps are enough.
    """
    texels, texel = np.unique(texel, return_inverse=True)
    pixels, pixel = np.unique(pixel, return_inverse=True)
    direction = cubemap.directions(resolution)[texels]
    # A texel that several symmetries leave where it is lies in as many pieces.
    pieces = np.zeros(len(texels))
    for turns in range(4):
        for mirrored in (False, True):
            for flipped in (False, True):
                pieces += np.abs(_moved(direction, turns, mirrored, flipped) - direction).max(axis=1) < 1e-9
    texel_area = cubemap.solid_angles(resolution)[texels] / pieces
    edge = np.cos(np.minimum(np.linspace(0, np.pi, height + 1), np.pi / 2))
    pixel_area = ((edge[:-1] - edge[1:]) * (2 * np.pi / columns))[pixels // columns]
    shares = sparse.csr_array((shared, (texel, pixel)))
    texel_sum, pixel_sum = shares.sum(axis=1), shares.sum(axis=0)
    lack = (pixel_area - pixel_sum) / pixel_sum
    system = sparse.diags_array(texel_sum) - shares @ sparse.diags_array(1 / pixel_sum) @ shares.T
    right = texel_area - texel_sum - shares @ lack
    enough = 1e-7 * float(np.linalg.norm(texel_area))
    a, _ = linalg.cg(system, right, rtol=0, atol=enough, maxiter=200, M=sparse.diags_array(1 / texel_sum))
    b = lack - (shares.T @ a) / pixel_sum
    return shared * (1 + a[texel] + b[pixel])
