"""How a picture shows the whole sphere: as a lat-long map, as the six faces of a cube, or in a disc.

Faces are +x −x +y −y +z −z, oriented as OpenGL looks them up, so a face seen from inside the cube is its own mirror
image. Crosses are unfolded around +z, so that faces that touch also touch in the picture:

    strip   +x −x +y −y +z −z, from left to right or from top to bottom

    cross      +y                        +y
            −x +z +x −z      or       −x +z +x
               −y                        −y
                                         −z, turned by 180°

OpenEXR's own cube maps are strips from top to bottom whose faces are mirrored: to the right on +x −x +y −y +z −z go
+z −z +x +x −x +x, and downwards −y −y −z +z −y −y (OpenEXR's ImfEnvmap.h).

Light probes and mirror balls are discs in black squares; see `lights.probes`.
"""

import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.lights import probes

LAYOUTS = ("auto", "latlong", "strip", "cross", "openexr_cube", "probe", "mirror_ball")

# Row and column of every face, in the order of the faces.
_ACROSS = ((1, 2), (1, 0), (0, 1), (2, 1), (1, 1), (1, 3))
_DOWN = ((1, 2), (1, 0), (0, 1), (2, 1), (1, 1), (3, 1))
_CELLS = {
    ("strip", 1, 6): tuple((0, i) for i in range(6)),
    ("strip", 6, 1): tuple((i, 0) for i in range(6)),
    ("cross", 3, 4): _ACROSS,
    ("cross", 4, 3): _DOWN,
}


def faces_of(
    pixels: Float[np.ndarray, "h w c"], layout: str, name: str
) -> tuple[Float[np.ndarray, "6 n n c"] | None, str]:
    """The six faces that a picture shows, or None where it is a lat-long map, and what had to be guessed.

    "auto" takes pictures of 6:1 and 1:6 for strips, those of 4:3 and 3:4 for crosses if what no face covers is of one
    colour, squares with black corners around a disc for angular light probes, and all others for lat-long maps.

    Args:
        pixels: the picture.
        layout: one of `LAYOUTS`.
        name: what messages call it.

    Raises:
        InputError: the layout is unknown, or the picture's sides do not fit it.
    """
    height, width = pixels.shape[:2]
    if layout not in LAYOUTS:
        raise InputError(f"{name}: layout {layout!r} is not known; use one of {', '.join(LAYOUTS)}")
    if layout == "latlong":
        return None, ""
    if layout in probes.MAPPINGS:
        if height != width:
            raise InputError(f"{name} is {width} × {height} pixels, but a {layout} is 1:1; name its layout")
        return probes.to_cube(pixels, layout), ""
    if layout == "openexr_cube":
        if height != 6 * width:
            raise InputError(f"{name} is {width} × {height} pixels, but a cube map of OpenEXR is 1:6; name its layout")
        return _mirrored(pixels.reshape(6, width, width, -1)), ""
    for (kind, rows, columns), cells in _CELLS.items():
        size = height // rows
        if layout not in ("auto", kind) or size < 1 or (height, width) != (rows * size, columns * size):
            continue
        # rows, columns, then row and column within a cell
        grid = pixels.reshape(rows, size, columns, size, -1).swapaxes(1, 2)
        if layout == "auto" and not _covers(grid, cells):
            continue
        faces = np.stack([grid[cell] for cell in cells])
        if cells is _DOWN:
            faces[5] = faces[5, ::-1, ::-1]
        note = f"{name}: read as the {size}² faces of a cube in a {kind}; layout = 'latlong' reads it otherwise"
        return faces, note if layout == "auto" else ""
    if layout == "auto" and probes.is_disc(pixels):
        note = f"{name}: a disc in a black square, read as an angular light probe; layout = 'mirror_ball' or 'latlong' "
        return probes.to_cube(pixels, "probe"), f"{note}reads it otherwise"
    if layout == "auto":
        note = (
            f"{name}: {width} × {height} pixels are not 2:1, but are taken to show the whole sphere as a lat-long map"
        )
        if width == height:
            note += "; its corners are not black, as those of a layout = 'probe' or 'mirror_ball' are"
        return None, "" if width == 2 * height else note
    wanted = " or ".join(f"{columns}:{rows}" for kind, rows, columns in _CELLS if kind == layout)
    raise InputError(f"{name} is {width} × {height} pixels, but a {layout} of cube faces is {wanted}; name its layout")


def _mirrored(faces: Float[np.ndarray, "6 n n c"]) -> Float[np.ndarray, "6 n n c"]:
    """Faces of OpenEXR's cube maps as those of OpenGL's: mirrored, left to right, or top to bottom those of ±y."""
    turned = faces[:, :, ::-1].copy()
    turned[2:4] = faces[2:4, ::-1]
    return turned


def _covers(grid: np.ndarray, cells: tuple[tuple[int, int], ...]) -> bool:
    """Whether all that lies outside the cells is of one colour."""
    outside = [grid[row, column] for row, column in np.ndindex(*grid.shape[:2]) if (row, column) not in cells]
    return not outside or bool((np.stack(outside) == outside[0][0, 0]).all())
