"""Area lights: their irradiance in closed form, and from which side they shine."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight import InputError
from jaxrelight.lights.area import area

SQUARE = (0, 2, 0), (2, 0, 0), (0, 0, 2)  # u × v points down


def irradiance(light, place, normal) -> np.ndarray:
    incidents = [part.at(jnp.asarray([place], jnp.float32)) for part in light.parts()]
    each = [one.irradiance[0] * max(0, float(one.omega_i[0] @ jnp.asarray(normal))) for one in incidents]
    return np.sum(each, axis=0)


@pytest.mark.parametrize("height", [0.0, 1.0])
def test_a_square_overhead(height):
    """π L times the form factor of a parallel square (Howell's catalogue, B-3, four times)."""
    x = 1 / (2 - height)
    share = x / np.sqrt(1 + x * x)
    wanted = np.pi * 4 / (2 * np.pi) * 2 * share * np.arctan(share)
    received = irradiance(area(*SQUARE, [1, 2, 3], samples=3), [0, height, 0], [0.0, 1, 0])
    np.testing.assert_allclose(received, wanted * np.array([1, 2, 3]), rtol=1e-5)


def test_it_shines_on_one_side():
    light = area(*SQUARE, 1.0)
    assert (irradiance(light, [0, 3, 0], [0.0, -1, 0]) == 0).all()
    assert (irradiance(area(SQUARE[0], SQUARE[2], SQUARE[1], 1.0), [0, 3, 0], [0.0, -1, 0]) > 0).all()


def test_all_of_its_area_is_in_its_patches():
    parts = area((0, 0, 0), (3, 0, 0), (1, 2, 0), 5.0, samples=3).parts()
    assert len(parts) == 9
    corners = np.stack([part.corners for part in parts])
    edges = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    np.testing.assert_allclose(np.cross(*edges).sum(axis=0), [0, 0, 6], atol=1e-6)
    np.testing.assert_allclose(corners.mean(axis=(0, 1)), 0, atol=1e-6)
    np.testing.assert_allclose([part.radiance for part in parts], 5)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"u": (0, 0, 0)}, "lie along each other, or are 0"),
        ({"u": (1, 1, 0), "v": (2, 2, 0)}, "lie along each other"),
        ({"samples": 0}, "samples along an edge must be from 1 to 64, not 0"),
        ({"samples": 2.5}, "not 2.5"),
        ({"radiance": -1}, "radiance must be"),
    ],
)
def test_what_is_no_surface_is_refused(change, what):
    good = {"centre": (0, 0, 0), "u": (1, 0, 0), "v": (0, 1, 0), "radiance": 1}
    with pytest.raises(InputError, match=what):
        area(**good | change)
