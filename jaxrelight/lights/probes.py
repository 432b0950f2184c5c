"""The whole sphere in a disc: angular light probes (Debevec 1998), and photographs of a mirror ball.

With x to the right and y up in the picture, from -1 to 1, and r the distance from its centre:

    probe           angles from -z go with r, from 0 in the centre to 180° at the rim: the camera looks along -z
    mirror_ball     a far camera on +z sees itself in the centre, and at r what lies 2·arcsin(r) from +z

What is right of the centre lies towards +x, and what is above it towards +y.
"""

import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.basis import cubemap

MAPPINGS = ("probe", "mirror_ball")

# A disc is surrounded by what is darker than this share of the mean within.
_BLACK = 0.01
_MIN_SIDE = 8
# Sides of the grid in each pixel, and how many points the grids have at most, about.
_SUBPIXELS, _MAX_POINTS = 8, 2**23
_SWEEPS = 4


def is_disc(pixels: Float[np.ndarray, "h w c"]) -> Bool[np.ndarray, ""] | bool:
    """Whether a picture is square, and black outside the largest circle in it."""
    side = len(pixels)
    if pixels.shape[1] != side or side < _MIN_SIDE:
        return False
    radius = _radius(side)
    outside, inside = pixels[radius > 1 + 2 / side], pixels[radius < 1]
    return bool(inside.mean() > 0 and outside.max() <= _BLACK * inside.mean())


def to_cube(pixels: Float[np.ndarray, "n n c"], mapping: str) -> Float[np.ndarray, "6 m m c"]:
    """The faces of the cube map that a disc shows.

    Points of a fine grid in every pixel carry its radiance to texels, each with its solid angle. Solid angles are
    scaled until pixels and texels both have about their own: constant light stays so, and a hot pixel keeps its energy.

    Args:
        pixels: a square picture; what lies outside its largest circle has no meaning.
        mapping: one of `MAPPINGS`.
    """
    side = len(pixels)
    # Texels are as fine as pixels are in the centre, and twice as fine in small pictures, so that little is spread.
    resolution = max(4, -(-side // 4), min(-(-side // 2), 64))
    grid = max(2, min(_SUBPIXELS, int(np.sqrt(_MAX_POINTS) / side)))
    centre = (np.arange(side * grid) + 0.5) * (2 / (side * grid)) - 1
    x, y = (axis.ravel() for axis in np.meshgrid(centre, -centre))
    row, column = np.divmod(np.arange(x.size), side * grid)
    pixel = row // grid * side + column // grid
    # Pixels with their centres beyond the rim are black in part.
    within = (np.hypot(x, y) < 1) & (_radius(side) < 1).ravel()[pixel]
    x, y, pixel = x[within], y[within], pixel[within]
    direction, weight = _directions(x, y, mapping)
    texel = cubemap.texel_of(direction, resolution)
    own = np.bincount(pixel, weight, side * side)
    own *= 4 * np.pi / own.sum()
    area = np.asarray(cubemap.solid_angles(resolution))
    for _ in range(_SWEEPS):
        weight = weight * _over(own, np.bincount(pixel, weight, own.size))[pixel]
        weight = weight * _over(area, np.bincount(texel, weight, area.size))[texel]
    flat = pixels.reshape(side * side, -1).astype(float)
    total = np.bincount(texel, weight, area.size)
    faces = np.stack([_over(np.bincount(texel, weight * c[pixel], area.size), total) for c in flat.T], axis=-1)
    # Texels that no point met are looked up.
    empty = total == 0
    if empty.any():
        faces[empty] = flat[_pixels_at(cubemap.directions(resolution)[empty], mapping, side)]
    return faces.reshape(6, resolution, resolution, -1).astype(pixels.dtype)


def _radius(side: int) -> Float[np.ndarray, "n n"]:
    """Distance of the pixels' centres from that of the picture."""
    centre = (np.arange(side) + 0.5) * (2 / side) - 1
    return np.hypot(centre[:, None], centre[None])


def _directions(x: np.ndarray, y: np.ndarray, mapping: str) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Unit vectors at places of the disc, and solid angle for its area."""
    radius = np.hypot(x, y)
    angle = np.pi * radius if mapping == "probe" else 2 * np.arcsin(radius)
    # sin(angle) over radius, which the centre has, too.
    sine = np.pi * np.sinc(radius) if mapping == "probe" else 2 * np.sqrt(1 - radius**2)
    z = np.cos(angle) * (-1 if mapping == "probe" else 1)
    # dω = sin(angle) d(angle) dφ over r dr dφ: even for a mirror ball.
    density = np.pi * sine if mapping == "probe" else np.full_like(radius, 4.0)
    return np.stack([x * sine, y * sine, z], axis=-1), density


def _pixels_at(direction: Float[np.ndarray, "p 3"], mapping: str, side: int) -> np.ndarray:
    """The pixel that shows each direction, counted by rows."""
    x, y, z = direction.T
    across = np.hypot(x, y)
    angle = np.arctan2(across, -z if mapping == "probe" else z)
    radius = angle / np.pi if mapping == "probe" else np.sin(angle / 2)
    scale = radius / np.where(across > 0, across, 1)
    scale = scale * np.minimum(1, (1 - 1.5 / side) / np.maximum(radius, 1e-9))  # within the rim
    column, row = (np.clip(((v + 1) / 2 * side).astype(int), 0, side - 1) for v in (x * scale, -y * scale))
    return row * side + column


def _over(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The quotient, 0 where it has none."""
    return one / np.where(other > 0, other, 1) * (other > 0)
