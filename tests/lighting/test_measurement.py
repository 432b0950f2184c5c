"""What sensors measure, against closed forms, by every method that tells it."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Camera, InputError, Part, Scene, Sensor
from tests.scenes import raised, room

CAMERA = Camera((0, 1, 3), (0, 0, 0), width=8, height=8)
POINTS = np.array([[0, 0, 0], [0.5, 0, 0.3], [-0.2, 0.4, 0.1]])
FLOOR = Part(jr.plane((2, 2), 2), "paper")
OPEN = Scene([FLOOR], {"paper": jr.lambert(0.5)}, CAMERA, sensors=[Sensor("points", POINTS)])
# A board above the first two points.
COVERED = dataclasses.replace(OPEN, parts=[FLOOR, Part(raised(jr.box((1.4, 0.05, 1.0), 1), 0.2), "paper")])
LAMP, AT = jr.point((0.2, 1.0, 0.1), [3.0, 2.0, 1.0]), np.array([0.2, 1.0, 0.1])
SKY = jr.environment(np.full((8, 16, 3), 2.0, np.float32))
METHODS: dict[str, Any] = {
    "transport": jr.Transport(resolution=16),
    "indirect": jr.Indirect(gather_samples=64),
    "prefiltered": jr.Prefiltered(occlusion_resolution=8, receiver_tolerance=0),
}


@pytest.fixture(scope="module")
def at(tmp_path_factory):
    """What measures a scene by a method; stores are kept for the file's tests."""
    stores, prepared = tmp_path_factory.mktemp("stores"), {}

    def get(scene: Scene, name: str) -> jr.Relighter:
        key = id(scene), name
        if key not in prepared:
            store = None if name == "prefiltered" else stores / str(len(prepared))
            prepared[key] = jr.prepare(scene.at_sensors(), METHODS[name], store)
        return prepared[key]

    return get


@pytest.mark.parametrize("name", ["transport", "indirect", "prefiltered"])
def test_a_point_light_over_a_plane_gives_intensity_times_cosine_over_the_square_of_the_distance(at, name):
    measured = jr.measure(at(OPEN, name), LAMP)
    towards = AT - POINTS
    factor = towards[:, 1] / np.linalg.norm(towards, axis=1) ** 3
    np.testing.assert_allclose(measured.irradiance, factor[:, None] * [[3.0, 2.0, 1.0]], rtol=1e-4)
    lux = 179 * (0.2126 * 3 + 0.7152 * 2 + 0.0722)
    np.testing.assert_allclose(measured.illuminance, lux * factor, rtol=1e-4)


# Filtering a sky compiles for ten seconds.
UNDER_A_SKY = ["transport", pytest.param("prefiltered", marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", UNDER_A_SKY)
def test_an_even_sky_over_an_open_plane_gives_pi_times_its_radiance(at, name):
    np.testing.assert_allclose(jr.measure(at(OPEN, name), SKY).irradiance, np.full((3, 3), 2 * np.pi), rtol=2e-3)


@pytest.mark.parametrize("name", ["transport", "indirect", "prefiltered"])
def test_a_lamp_that_is_hidden_gives_nothing_but_what_surfaces_pass_on(at, name):
    direct = jr.measure(at(COVERED, name), LAMP).irradiance
    if name == "indirect":
        relighter: Any = at(COVERED, name)
        lit, view = relighter.light(LAMP, bounces=0), relighter.view()
        direct = np.pi * relighter.shade(lit, view).radiance[0]
    np.testing.assert_array_equal(direct[:2], np.zeros((2, 3)))
    assert (np.asarray(direct[2]) > 0).all()


@pytest.mark.parametrize("name", UNDER_A_SKY)
def test_a_board_hides_much_of_the_sky(at, name):
    irradiance = jr.measure(at(COVERED, name), SKY).irradiance
    assert (np.asarray(irradiance[:1]) < 0.4 * 2 * np.pi).all()
    np.testing.assert_allclose(irradiance[2], np.full(3, 2 * np.pi), rtol=0.02)


@pytest.mark.slow
def test_a_small_area_light_is_as_lambert_says(at):
    lamp = jr.area((0, 3.0, 0), (0.1, 0, 0), (0, 0, 0.1), 50.0, samples=1)
    far = jr.measure(at(OPEN, "transport"), lamp).irradiance
    towards = np.array([0, 3.0, 0]) - POINTS
    # Both cosines are the height over the distance.
    expected = 50.0 * 0.01 * towards[:, 1] ** 2 / np.linalg.norm(towards, axis=1) ** 4
    np.testing.assert_allclose(far, np.broadcast_to(expected[:, None], (3, 3)), rtol=2e-3)


def test_a_sensor_looks_to_one_side(at):
    below = dataclasses.replace(OPEN, sensors=[Sensor("down", POINTS[2:], (0, -1, 0))])
    assert not np.asarray(jr.measure(at(below, "prefiltered"), LAMP).irradiance).any()


@pytest.mark.slow
def test_light_in_a_closed_box_is_a_geometric_series(tmp_path):
    # Of every bounce each wall gets the same in the mean: sensors on all six, and one in the middle, tell it.
    box = room(jr.lambert(0.5), CAMERA, quads=2)
    side = (np.arange(4) + 0.5) / 4 - 0.5
    grid = np.array([[a, b] for a in side for b in side])
    walls = []
    for axis in range(3):
        for end in (-0.5, 0.5):
            points = np.insert(grid, axis, end, axis=1)
            walls.append(Sensor(f"{axis}{end}", points, tuple(np.eye(3)[axis] * -np.sign(end))))
    scene = dataclasses.replace(box, sensors=walls)
    bounces = 8
    relighter: Any = jr.prepare(scene.at_sensors(), jr.Indirect(gather_samples=4096, bounces=bounces), tmp_path)
    lamp, view = jr.point((0, 0, 0), 1.0), relighter.view()
    whole = np.asarray(jr.measure(relighter, lamp).illuminance).mean()
    direct = np.pi * np.asarray(relighter.shade(relighter.light(lamp, 0), view).radiance)[0, :, 1].mean() * 179
    # 16 points of each wall tell its mean irradiance, 4π / 6, but for what a grid leaves out.
    assert direct == pytest.approx(179 * 4 * np.pi / 6, rel=0.02)
    assert whole == pytest.approx(direct * (1 - 0.5 ** (bounces + 1)) / 0.5, rel=0.025)


@pytest.mark.slow
def test_emitting_surfaces_are_measured(tmp_path):
    glowing = jr.Material((jr.Component(jr.lambert(0.0)),), emission=np.full(3, 2.0, np.float32))
    scene = room(glowing, CAMERA)
    scene = dataclasses.replace(scene, sensors=[Sensor("middle", [[0.1, 0, 0.2]], (1, 0, 0))])
    relighter = jr.prepare(scene.at_sensors(), jr.Indirect(gather_samples=1024, bounces=1), tmp_path)
    np.testing.assert_allclose(jr.measure(relighter).irradiance, np.full((1, 3), 2 * np.pi), rtol=0.03)


def test_measurements_are_linear_and_differentiable_in_light(at):
    relighter = at(OPEN, "transport")
    view = relighter.view()
    traced = relighter.trace(relighter.light(LAMP), view)

    def lux(intensity):
        image = relighter.shade(relighter.light(jr.point(AT, intensity)), view, traced)
        return jr.Measurement(np.pi * image.radiance[0], relighter.sensors).of("points").sum()

    value, slope = jax.value_and_grad(lux)(np.float32(2.0))
    assert slope == pytest.approx(float(value) / 2, rel=1e-5)


def test_summaries_tell_mean_ends_and_uniformity(at):
    measured = jr.measure(at(OPEN, "transport"), LAMP)
    lux, told = np.asarray(measured.of("points")), measured.summaries()["points"]
    assert (told.mean, told.min, told.max) == pytest.approx((lux.mean(), lux.min(), lux.max()))
    assert told.uniformity == pytest.approx(lux.min() / lux.mean())
    with pytest.raises(InputError, match="no sensor 'desk'; there are points"):
        measured.of("desk")


def test_sensors_of_a_store_lie_beside_what_its_camera_sees(tmp_path):
    method = METHODS["transport"]
    seen = jr.prepare(OPEN, method, tmp_path)
    measured = jr.measure(jr.prepare(OPEN.at_sensors(), method, tmp_path), LAMP)
    again = jr.measure(jr.open_store(tmp_path, sensors=True), LAMP)
    np.testing.assert_array_equal(measured.irradiance, again.irradiance)
    assert jr.open_store(tmp_path).camera == seen.camera
    assert again.sensors.each == tuple(OPEN.sensors)


def test_what_cannot_be_measured_is_refused(at, tmp_path):
    with pytest.raises(InputError, match="prepared for a camera"):
        jr.measure(jr.prepare(OPEN, METHODS["prefiltered"]), LAMP)
    with pytest.raises(InputError, match="has no sensor"):
        dataclasses.replace(OPEN, sensors=()).at_sensors()
    with pytest.raises(InputError, match="neighbouring pixels"):
        jr.prepare(OPEN.at_sensors(), jr.Adaptive())
    with pytest.raises(InputError, match="leave receivers at 'pixels'"):
        jr.prepare(OPEN.at_sensors(), jr.Transport(receivers="vertices", receiver_tolerance=0), tmp_path)
    with pytest.raises(InputError, match="no visibility of sensors"):
        jr.prepare(OPEN.at_sensors(), METHODS["prefiltered"], tmp_path)
    with pytest.raises(InputError, match="leave antialiasing at 1"):
        at(OPEN, "prefiltered").view(antialiasing=4)
    jr.prepare(OPEN, METHODS["transport"], tmp_path)
    with pytest.raises(InputError, match="no sensors were precomputed"):
        jr.open_store(tmp_path, sensors=True)
