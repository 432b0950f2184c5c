"""The light that options ask for."""

import numpy as np
import pytest

from jaxrelight.commands.options import LightOptions
from jaxrelight.errors import InputError
from jaxrelight.images import write_image
from jaxrelight.lights.environment import environment


def test_layout_says_how_a_map_is_read(tmp_path):
    pixels = np.random.default_rng(0).uniform(size=(4, 24, 3))
    write_image(tmp_path / "sky.exr", pixels)
    assert LightOptions(env=tmp_path / "sky.exr").environment(None).pixels.shape == (32, 64, 3)
    flat = LightOptions(env=tmp_path / "sky.exr", layout="latlong").environment(None)
    np.testing.assert_array_equal(flat.pixels, pixels.astype(np.float32))
    with pytest.raises(InputError, match="4:3 or 3:4"):
        LightOptions(env=tmp_path / "sky.exr", layout="cross").environment(None)
    with pytest.raises(InputError, match="--layout says how --env MAP is read"):
        LightOptions(layout="strip").environment(environment(np.ones((2, 4, 3))))
