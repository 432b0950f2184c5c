"""Light probes and mirror balls: each direction where it belongs, with its solid angle."""

import numpy as np
import pytest

from jaxrelight.basis import cubemap
from jaxrelight.errors import InputError
from jaxrelight.lights import probes
from jaxrelight.lights.environment import environment, load_environment
from tests.images import exr_writer
from tests.images.exr_writer import Part
from tests.lights.test_layouts import faces, smooth
from tests.shared_data import shared


def _picture(mapping: str, side: int, radiance=smooth) -> np.ndarray:
    """A disc of a radiance that depends on the direction; black around it."""
    centre = (np.arange(side) + 0.5) * (2 / side) - 1
    x, y = np.meshgrid(centre, -centre)
    radius = np.hypot(x, y)
    within = np.minimum(radius, 1)
    if mapping == "probe":  # Debevec: (0, 0, -1) turned by π r, towards the place in the picture
        z, sine = -np.cos(np.pi * within), np.sin(np.pi * within)
    else:  # the mirror direction of (0, 0, 1) about the ball's normal
        normal = np.sqrt(1 - within**2)
        z, sine = 2 * normal**2 - 1, 2 * normal * within
    scale = sine / np.where(radius > 0, radius, 1)
    direction = np.stack([x * scale, y * scale, z], axis=-1)
    return np.where(radius[..., None] <= 1, radiance(direction), 0).astype(np.float32)


@pytest.mark.parametrize("mapping", probes.MAPPINGS)
@pytest.mark.parametrize("side", [33, 64, 150])
def test_texels_hold_what_the_disc_shows_in_their_direction(mapping, side):
    cube = probes.to_cube(_picture(mapping, side), mapping).reshape(-1, 3)
    resolution = int(np.sqrt(len(cube) / 6))
    direction = cubemap.directions(resolution)
    # A mirror ball squeezes what is behind it into its rim.
    known = direction[:, 2] > -0.9 if mapping == "mirror_ball" else np.ones(len(cube), bool)
    error = np.abs(cube - smooth(direction))[known]
    assert error.max() < 20 / side
    assert error.mean() < 2.5 / side
    light, wanted = (cubemap.solid_angles(resolution) @ of for of in (cube, smooth(direction)))
    np.testing.assert_allclose(light, wanted, rtol=0.01)


@pytest.mark.parametrize("mapping", probes.MAPPINGS)
@pytest.mark.parametrize("side", [8, 9, 64])
def test_constant_light_stays_constant_and_a_hot_pixel_keeps_its_energy(mapping, side):
    assert np.ptp(probes.to_cube(np.full((side, side, 1), 0.7), mapping)) < 1e-12
    hot, row, column = np.zeros((side, side, 1)), side // 3, side // 2 + 1
    hot[row, column] = 1e5
    cube = probes.to_cube(hot, mapping)
    part = (np.arange(32) + 0.5) / 32
    x, y = np.meshgrid((column + part) * 2 / side - 1, 1 - (row + part) * 2 / side)
    radius = np.hypot(x, y)
    density = np.pi * np.sin(np.pi * radius) / radius if mapping == "probe" else np.full_like(radius, 4)
    energy = np.sum(cubemap.solid_angles(cube.shape[1]) * cube.reshape(-1))
    np.testing.assert_allclose(energy, 1e5 * density.mean() * (2 / side) ** 2, rtol=0.05)


def test_discs_in_black_squares_are_probes_and_lit_squares_are_lat_long():
    picture = _picture("probe", 32)
    made = environment(picture, name="sky.hdr")
    assert made.notes == (
        "sky.hdr: a disc in a black square, read as an angular light probe; "
        "layout = 'mirror_ball' or 'latlong' reads it otherwise",
    )
    named = environment(picture, layout="probe")
    np.testing.assert_array_equal(made.pixels, named.pixels)
    assert named.notes == ()
    np.testing.assert_array_equal(environment(picture, layout="latlong").pixels, picture)
    for lit in (picture + np.float32(1), np.ones((16, 16, 3), np.float32), np.zeros((16, 16, 3), np.float32)):
        square = environment(lit, name="sky.hdr")
        np.testing.assert_array_equal(square.pixels, lit)
        assert "taken to show the whole sphere as a lat-long map; its corners are not black" in square.notes[0]


@pytest.mark.parametrize("layout", probes.MAPPINGS)
def test_discs_are_square(layout):
    with pytest.raises(InputError, match=rf"sky\.exr is 8 × 4 pixels, but a {layout} is 1:1"):
        environment(np.ones((4, 8, 3)), layout=layout, name="sky.exr")


def test_cube_maps_of_openexr(tmp_path):
    """Faces whose rows and columns go along the axes that OpenEXR's ImfEnvmap.h names."""
    n = 5
    a = (np.arange(n) + 0.5) * (2 / n) - 1
    right, down = np.meshgrid(a, a)
    one = np.ones_like(right)
    points = [
        (one, -down, right),
        (-one, -down, -right),
        (right, one, -down),
        (right, -one, down),
        (-right, -down, one),
        (right, -down, -one),
    ]
    direction = np.stack([np.stack(point, axis=-1) for point in points])
    picture = smooth(direction / np.linalg.norm(direction, axis=-1, keepdims=True)).reshape(6 * n, n, 3)
    wanted = environment(np.concatenate(faces(n), axis=0), layout="strip").pixels
    np.testing.assert_allclose(environment(picture, layout="openexr_cube").pixels, wanted, atol=1e-6)
    path = tmp_path / "sky.exr"
    attributes = {"envmap": ("envmap", b"\1")}
    path.write_bytes(exr_writer.picture(Part(exr_writer.planes(picture, "RGB"), attributes=attributes)))
    made = load_environment(path)
    np.testing.assert_allclose(made.pixels, wanted, atol=1e-6)
    assert made.notes == ()
    assert load_environment(path, layout="strip").notes == ()
    path.write_bytes(exr_writer.picture(Part(exr_writer.planes(picture[:12], "RGB"), attributes=attributes)))
    with pytest.raises(InputError, match=r"sky\.exr is 5 × 12 pixels, but a cube map of OpenEXR is 1:6"):
        load_environment(path)
    attributes = {"envmap": ("envmap", b"\0")}
    path.write_bytes(exr_writer.picture(Part(exr_writer.planes(picture, "RGB"), attributes=attributes)))
    made = load_environment(path)
    np.testing.assert_array_equal(made.pixels, picture)
    assert made.notes == ()


def test_reported_environments():
    made = load_environment(shared("data", "reported", "a3_probe", "probe.exr"))
    height, width = made.pixels.shape[:2]
    polar = (np.arange(height) + 0.5) * np.pi / height
    weight = np.maximum(np.cos(polar), 0) * np.sin(polar) * (np.pi / height) * (2 * np.pi / width)
    light = np.sum(np.asarray(made.pixels)[..., 0].astype(float) * weight[:, None])
    assert 0.5 * light / np.pi == pytest.approx(1 / 3, abs=0.003)
    sky = load_environment(shared("data", "reported", "x1_polyhaven", "sky.hdr"))
    assert sky.notes[0].startswith("sky.hdr: its PRIMARIES")
    cube = np.asarray(load_environment(shared("data", "reported", "k1_envcube", "cube.exr")).pixels).max(axis=-1)
    row, column = np.unravel_index(np.argmax(cube), cube.shape)
    # The brightest spot of the file is where its faces +x, +y and +z meet.
    assert row < cube.shape[0] / 2
    assert cube.shape[1] / 4 < column < cube.shape[1] / 2
