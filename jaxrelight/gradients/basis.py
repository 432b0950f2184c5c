"""Entries of `jaxrelight.basis`."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import numpy as np

from jaxrelight.basis import cube_grid, haar, latlong, truncation, zonal
from jaxrelight.gradients.entry import HOST, Entries, Entry, Example, Exempt, Singular, named
from jaxrelight.gradients.examples import OMEGA_I, at_point, numbers, scalar

_UP, _X = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])


def _columns():
    return Example(latlong.interpolate, (numbers(4, 8, 3), scalar(0.3), scalar(0.4)))


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.basis.cube_grid", "bilinear"),
        differentiable_in="direction (the weights; the corners are numbers)",
        example=lambda: Example(lambda direction: cube_grid.bilinear(direction, 3), (OMEGA_I,)),
        kinks="between cells the slope of the cell ahead, at the cube's edges that of the first of equal components",
        ends="not the zero vector",
    ),
    Entry(
        named("jaxrelight.basis.haar", "forward"),
        differentiable_in="faces; linear",
        example=lambda: Example(haar.forward, (numbers(2, 4, 4),), lambda faces, y: haar.inverse(y)),
        orders=2,
    ),
    Entry(
        named("jaxrelight.basis.haar", "inverse"),
        differentiable_in="coefficients; linear",
        example=lambda: Example(haar.inverse, (numbers(2, 4, 4),), lambda coefficients, y: haar.forward(y)),
        orders=2,
    ),
    Entry(
        named("jaxrelight.basis.latlong", "finite_coordinates"),
        differentiable_in="direction",
        example=lambda: Example(latlong.finite_coordinates, (OMEGA_I,)),
        orders=2,
        kinks="0 at both poles, where the longitude is undefined",
        singular=lambda: (
            Singular("the pole", (_UP,), (_X,), "zero"),
            Singular("the lower pole", (-_UP,), (_X,), "zero"),
        ),
    ),
    Entry(
        named("jaxrelight.basis.latlong", "rotate"),
        differentiable_in="pixels, degrees",
        example=lambda: Example(latlong.rotate, (numbers(4, 8, 3), scalar(13.0))),
        kinks="in the angle, at whole pixels: the slope ahead",
        singular=lambda: (
            at_point("no rotation", (numbers(4, 8, 3), scalar(0)), 1, scalar(1), "ahead"),
            at_point("a whole pixel", (numbers(4, 8, 3), scalar(45)), 1, scalar(1), "ahead"),
        ),
    ),
    Entry(
        named("jaxrelight.basis.latlong", "resized"),
        differentiable_in="pixels of JAX; linear",
        example=lambda: Example(lambda pixels: latlong.resized(pixels, 3, 4), (numbers(4, 8, 3),)),
        orders=2,
    ),
    Entry(
        named("jaxrelight.basis.latlong", "look_up"),
        differentiable_in="pixels; linear, and constant in u and v",
        example=lambda: Example(
            lambda pixels: latlong.look_up(pixels, np.array([0.1, 0.6]), np.array([0.3, 0.9])), (numbers(4, 8, 3),)
        ),
        orders=2,
        fixed="the cell",
    ),
    Entry(
        named("jaxrelight.basis.latlong", "interpolate"),
        differentiable_in="pixels, u, v",
        example=_columns,
        kinks="at the centres of cells: the slope ahead",
        singular=lambda: tuple(
            at_point(where, (numbers(4, 8, 3), scalar(0.3), scalar(v)), 2, scalar(1), "ahead")
            for where, v in (
                ("the centre of a row", 0.375),
                ("the centre of the top row", 0.125),
                ("the centre of the bottom row", 0.875),
            )
        ),
    ),
    Entry(
        named("jaxrelight.basis.latlong", "AreaResampling.apply"),
        differentiable_in="pixels; linear",
        example=lambda: Example(
            lambda pixels: latlong.area_resampling(4, 8, 2, pixels.dtype).apply(pixels), (numbers(4, 8, 3),)
        ),
        orders=2,
    ),
    Entry(
        named("jaxrelight.basis.truncation", "keep_largest"),
        differentiable_in="rows",
        example=lambda: Example(lambda rows: truncation.keep_largest(rows, 3), (numbers(2, 3, 8),)),
        orders=2,
        fixed="which coefficients are kept",
        nan="a NaN counts as largest, or not, as sorting has it; what is dropped tells",
    ),
    Entry(
        named("jaxrelight.basis.truncation", "gather"),
        differentiable_in="rows; linear",
        example=lambda: Example(lambda rows: truncation.gather(rows, np.array([[0, 3], [5, 6]])), (numbers(2, 3, 8),)),
        orders=2,
        fixed="the indices",
    ),
    Entry(
        named("jaxrelight.basis.zonal", "filtered_maps"),
        differentiable_in="pixels; linear",
        example=lambda: Example(lambda pixels: zonal.filtered_maps(pixels, [0.0, 8.0], [4, 24]), (numbers(8, 16, 1),)),
        orders=1,
    ),
    Entry(
        named("jaxrelight.basis.zonal", "zonal_means"),
        differentiable_in="pixels; linear",
        example=lambda: Example(lambda pixels: zonal.zonal_means(pixels, 3.0), (numbers(4, 8, 1),)),
        orders=2,
    ),
    Exempt(
        (
            *named("jaxrelight.basis.cube_grid", "directions"),
            *named("jaxrelight.basis.cubemap", "face_plane directions solid_angles texel_of"),
            *named("jaxrelight.basis.haar", "levels"),
            *named("jaxrelight.basis.latlong", "directions coordinates solid_angles from_cube area_resampling"),
            *named("jaxrelight.basis.latlong", "cube_to_latlong"),
            *named("jaxrelight.basis.local_frequency", "local_frequency mirrored around_sphere"),
            *named("jaxrelight.basis.overlaps", "overlaps"),
            *named("jaxrelight.basis.quadtree", "flattened z_curve"),
            *named("jaxrelight.basis.zonal", "lobe_bands"),
        ),
        HOST,
    ),
)
