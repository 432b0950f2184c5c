"""The light that options ask for."""

import numpy as np
import pytest

from jaxrelight.commands.options import LightOptions
from jaxrelight.errors import InputError
from jaxrelight.images import write_image
from jaxrelight.lights.environment import environment
from jaxrelight.lights.lights import Lights
from jaxrelight.lights.local import Point, point


def test_layout_says_how_a_map_is_read(tmp_path):
    pixels = np.random.default_rng(0).uniform(size=(4, 24, 3))
    write_image(tmp_path / "sky.exr", pixels)

    def sky(**options) -> np.ndarray:
        env = LightOptions(env=tmp_path / "sky.exr", **options).lights(Lights(), emits=False).environment
        assert env is not None
        return np.asarray(env.pixels)

    assert sky().shape == (32, 64, 3)
    np.testing.assert_array_equal(sky(layout="latlong"), pixels.astype(np.float32))
    with pytest.raises(InputError, match="4:3 or 3:4"):
        sky(layout="cross")
    with pytest.raises(InputError, match="--layout says how --env MAP is read"):
        LightOptions(layout="strip").lights(Lights(environment(np.ones((2, 4, 3)))), emits=False)


def test_local_lights_are_the_scenes_or_those_of_a_file(tmp_path):
    lamps = point([0, 1, 0], 1.0), point([1, 1, 0], 1.0)
    scene = Lights(environment(np.ones((2, 4, 3))), lamps)
    (tmp_path / "one.toml").write_text('[[light]]\ntype = "point"\nposition = [2, 1, 0]\nintensity = 1\n')
    assert LightOptions().lights(scene, emits=False).local == lamps
    (moved,) = LightOptions().lights(scene, emits=False, local_file=tmp_path / "one.toml").local
    assert isinstance(moved, Point)
    np.testing.assert_array_equal(moved.position, [2, 1, 0])


def test_there_must_be_light_that_options_are_about():
    assert not LightOptions().lights(Lights(), emits=True)
    with pytest.raises(InputError, match="there is no light; name an environment with --env MAP"):
        LightOptions().lights(Lights(), emits=False)
    for options in (LightOptions(rotate_y=10.0), LightOptions(scale=2.0)):
        with pytest.raises(InputError, match="the scene has no environment; name one with --env MAP"):
            options.lights(Lights(None, (point([0, 1, 0], 1.0),)), emits=False)
