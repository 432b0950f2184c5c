"""Sensors of scene files: points and grids, and what is refused."""

import numpy as np
import pytest

from jaxrelight import InputError, load_scene
from tests.scene.scene_files import SMALL, write_scene

POINTS = '[[sensor]]\nname = "door"\npoints = [[0, 1, 2], [0, 1.5, 2]]\nnormal = [0, 0, -3]\n'
GRID = '[[sensor]]\nname = "desk"\norigin = [0, 1, 0]\nu = [2, 0, 0]\nv = [0, 0, 1]\ncolumns = 2\nrows = 1\n'


def test_sensors_are_points_or_the_centres_of_a_grid(tmp_path):
    door, desk = load_scene(write_scene(tmp_path, SMALL + POINTS + GRID)).sensors
    assert (door.name, door.normal) == ("door", (0, 0, -1))
    np.testing.assert_array_equal(door.points, [[0, 1, 2], [0, 1.5, 2]])
    assert (desk.name, desk.normal) == ("desk", (0, 1, 0))
    np.testing.assert_array_equal(desk.points, [[0.5, 1, 0.5], [1.5, 1, 0.5]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (POINTS.replace("points", "place"), "give either 'points' or a grid"),
        (POINTS + "origin = [0, 0, 0]\n", "give either 'points' or a grid"),
        (POINTS.replace("[[0, 1, 2], [0, 1.5, 2]]", "[]"), "'points' must be a list"),
        (POINTS.replace("1.5, ", ""), "'points' must be 2 × 3 numbers"),
        (POINTS.replace("-3", "0"), "zero vector"),
        (POINTS.replace('name = "door"', 'name = ""'), "has no name"),
        (POINTS + "columns = 2\n", "'columns' is not known"),
        (POINTS + POINTS, "number 2: there is a sensor 'door' already"),
        (GRID.replace("rows = 1", "rows = 0"), "rows must be a whole number from 1"),
        (GRID.replace("rows = 1\n", ""), "'rows' is missing"),
    ],
)
def test_bad_sensors_are_refused_by_their_place_in_the_file(tmp_path, text, said):
    with pytest.raises(InputError, match=said) as refusal:
        load_scene(write_scene(tmp_path, SMALL + text))
    assert "[[sensor]] number" in str(refusal.value)
