"""Sensors: their points, and what is refused."""

import numpy as np
import pytest

from jaxrelight import InputError, Sensor, sensor_grid
from jaxrelight.geometry.gbuffer import sensor_gbuffer
from jaxrelight.geometry.primitives import plane
from jaxrelight.geometry.ray_origins import ray_origins
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import Tracer


def test_points_of_a_grid_are_the_centres_of_its_cells():
    grid = sensor_grid("desk", (1, 2, 3), (4, 0, 0), (0, 0, 2), columns=4, rows=2)
    expected = [[1.5 + column, 2, 3.5 + row] for row in range(2) for column in range(4)]
    np.testing.assert_allclose(grid.points, expected, rtol=1e-12)


def test_sensors_are_one_row_in_their_order():
    both = Sensors((Sensor("a", [[0, 0, 0], [1, 0, 0]], (0, 0, -2)), Sensor("b", [[0, 5, 0]])))
    assert (both.width, both.height) == (3, 1)
    assert both.slices == {"a": slice(0, 2), "b": slice(2, 3)}
    np.testing.assert_array_equal(both.normals, [[0, 0, -1], [0, 0, -1], [0, 1, 0]])


def test_equal_sensors_are_equal_whatever_they_were_made_from():
    assert Sensor("a", [[0, 1, 2]], [0, 2, 0]) == Sensor("a", np.array([[0.0, 1, 2]]), np.array([0, 0.5, 0]))


def test_rays_of_a_sensor_start_above_the_surface_that_it_lies_on():
    surfaces = join([plane((2, 2), 2)])
    points = sensor_gbuffer(surfaces, Sensors((Sensor("a", [[0.3, 0, 0.1], [0.2, 0.4, 0]]),)))
    origins = ray_origins(surfaces, Tracer(surfaces), points)
    assert (origins[:, 1] > points.positions[:, 1]).all()
    np.testing.assert_allclose(origins, surfaces.to_scene([[0.3, 0, 0.1], [0.2, 0.4, 0]]), atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((["", [[0, 0, 0]]]), "has no name"),
        ((["a", []]), "at least one [x, y, z]"),
        ((["a", [[0, 0]]]), "at least one [x, y, z]"),
        ((["a", [[0, 0, np.nan]]]), "points must be finite"),
        ((["a", [[0, 0, 0]], (0, 0, 0)]), "the zero vector"),
    ],
)
def test_bad_sensors_are_refused(wrong_types, arguments, said):
    with pytest.raises(InputError, match=said.replace("[", r"\[")):
        Sensor(*arguments)


@pytest.mark.parametrize("cells", [(0, 2), (2, True), (2, 1.5), (2**20, 2**20)])
def test_grids_of_no_cells_or_too_many_are_refused(wrong_types, cells):
    with pytest.raises(InputError, match=r"whole number from 1|at most"):
        sensor_grid("a", (0, 0, 0), (1, 0, 0), (0, 0, 1), *cells)


def test_a_scene_needs_a_sensor_and_names_that_differ():
    with pytest.raises(InputError, match="no sensor"):
        Sensors(())
    with pytest.raises(InputError, match="two sensors are called 'a'"):
        Sensors((Sensor("a", [[0, 0, 0]]), Sensor("a", [[1, 0, 0]])))
