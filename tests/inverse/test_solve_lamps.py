"""Lamps that meet targets: hidden ones are found again, gradients reach what searching finds, and what is left open."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Camera, InputError, Part, Scene, Sensor
from jaxrelight.inverse.lamp_targets import LuxTarget
from jaxrelight.inverse.solve_lamps import lamps
from tests.compilations import compilations
from tests.scenes import raised, room

CAMERA = Camera((0, 0, 0.4), (0, 0, -1), fov_y=80, width=12, height=12)
PLACES = [[-0.3, -0.45, -0.3], [0.3, -0.45, -0.3], [0, -0.45, 0.3], [-0.2, -0.1, 0.1], [0.3, -0.2, 0.2]]
SENSORS = [Sensor(f"s{number}", [place]) for number, place in enumerate(PLACES)]
ROOM = dataclasses.replace(room(jr.lambert(0.5), CAMERA), sensors=SENSORS)
AT, INTENSITY = [0.1, 0.3, -0.1], 2.0
HIDDEN = jr.point(AT, INTENSITY)
METHODS: dict[str, Any] = {"transport": jr.Transport(resolution=4), "indirect": jr.Indirect(gather_samples=256)}


@pytest.fixture(scope="module")
def at_sensors(tmp_path_factory):
    """The room at its sensors, by each method."""
    made = {}

    def get(name: str) -> jr.Relighter:
        if name not in made:
            made[name] = jr.prepare(ROOM.at_sensors(), METHODS[name], tmp_path_factory.mktemp(name))
        return made[name]

    return get


def targets_of(relighter: jr.Relighter, lights: Any = HIDDEN) -> dict[str, LuxTarget]:
    """What lights give at every sensor."""
    measured = jr.measure(relighter, lights)
    return {one.name: LuxTarget(values=np.asarray(measured.of(one.name)).tolist()) for one in measured.sensors.each}


@pytest.mark.parametrize("name", ["transport", pytest.param("indirect", marks=pytest.mark.slow)])
def test_the_intensity_of_a_hidden_lamp_is_found_exactly(at_sensors, name):
    relighter = at_sensors(name)
    found = lamps(relighter, targets_of(relighter), free=["intensity"], lights=jr.point(AT, 0.3))
    np.testing.assert_allclose(found.lamps[0].intensity, np.full(3, INTENSITY), rtol=1e-4)  # pyright: ignore[reportAttributeAccessIssue]
    assert found.largest_error < 1e-4
    # Five targets that are known to 1 % tell it to 1 % / √5.
    (unknown,) = found.unknowns
    assert (unknown.name, unknown.is_determined) == ("lamp 1: intensity", True)
    assert unknown.deviation == pytest.approx(0.01 / np.sqrt(5) * INTENSITY, rel=1e-3)
    assert found.undetermined == ()
    assert "shadow boundaries" in found.held_fixed[0]
    # Other targets and lamps compile nothing more: no step and no start does.
    others = targets_of(relighter, jr.point([0.0, 0.2, 0.1], 3.0))
    with compilations() as programs:
        lamps(relighter, others, free=["intensity"], lights=jr.point([0.0, 0.2, 0.1], 0.5))
    assert not programs


@pytest.mark.slow
@pytest.mark.parametrize("name", ["transport", "indirect"])
def test_the_place_of_a_lamp_follows_from_five_sensors(at_sensors, name):
    relighter = at_sensors(name)
    begun = jr.point([-0.2, 0.2, 0.2], 1.0)
    found = lamps(relighter, targets_of(relighter), free=["intensity", "position"], lights=begun)
    (lamp,) = found.lamps
    np.testing.assert_allclose(lamp.position, AT, atol=1e-3)  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose(lamp.intensity, np.full(3, INTENSITY), rtol=1e-2)  # pyright: ignore[reportAttributeAccessIssue]
    assert found.residual < 1e-4
    assert min(found.starts) == found.residual
    assert len(found.starts) == 4
    assert all(np.isfinite(one.deviation) for one in found.unknowns)


@pytest.mark.slow
def test_lamps_are_the_same_for_the_same_seed_and_stay_in_their_boxes(at_sensors):
    relighter = at_sensors("transport")
    box = [[-0.4, -0.4, -0.4], [0.05, 0.2, 0.4]]
    asked: dict[str, Any] = {
        "free": ["intensity", "position"],
        "lights": jr.point([-0.2, 0.1, 0.2], 1.0),
        "box": box,
        "starts": 2,
    }
    first, second = (lamps(relighter, targets_of(relighter), **asked) for _ in range(2))
    (one,), (other,) = first.lamps, second.lamps
    np.testing.assert_array_equal(one.position, other.position)  # pyright: ignore[reportAttributeAccessIssue]
    assert (np.asarray(box[0]) <= one.position).all()  # pyright: ignore[reportAttributeAccessIssue]
    assert (one.position <= np.asarray(box[1]) + 1e-6).all()  # pyright: ignore[reportAttributeAccessIssue]
    # The hidden lamp is not in it.
    assert first.residual > 1e-3


@pytest.mark.slow
def test_lux_leaves_colours_open_and_names_them(at_sensors):
    relighter = at_sensors("transport")
    found = lamps(relighter, targets_of(relighter), free=["colour"], lights=jr.point(AT, [0.5, 1.0, 2.0]))
    assert found.undetermined == ("lamp 1: intensity red", "lamp 1: intensity green", "lamp 1: intensity blue")
    assert all(np.isinf(one.deviation) for one in found.unknowns)
    assert found.largest_error < 1e-3


@pytest.mark.slow
def test_an_unknown_that_no_sensor_sees_is_named(at_sensors):
    relighter = at_sensors("transport")
    aside = jr.spot([0.4, 0.4, 0.4], [0.4, 0.5, 0.4], 1.0, 20.0)
    both = [jr.point(AT, 1.0), aside]
    found = lamps(relighter, targets_of(relighter), free={0: ["intensity"], 1: ["intensity", "cutoff"]}, lights=both)
    assert found.undetermined == ("lamp 2: intensity", "lamp 2: cutoff")
    np.testing.assert_allclose(found.lamps[0].intensity, np.full(3, INTENSITY), rtol=1e-3)  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.slow
def test_lamps_that_are_not_free_stay_and_their_light_counts(at_sensors):
    relighter = at_sensors("transport")
    other = jr.point([-0.2, 0.2, 0.2], [0.4, 0.5, 0.6])
    found = lamps(
        relighter, targets_of(relighter, [HIDDEN, other]), free={0: ["intensity"]}, lights=[jr.point(AT, 1.0), other]
    )
    assert found.lamps[1] is other
    np.testing.assert_allclose(found.lamps[0].intensity, np.full(3, INTENSITY), rtol=1e-4)  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.slow
def test_means_and_bounds_are_kept(at_sensors):
    relighter = at_sensors("transport")
    two = [jr.point([-0.3, 0.4, 0.0], 1.0), jr.point([0.3, 0.4, 0.0], 1.0)]
    asked = {"s0": LuxTarget(mean=300), "s1": LuxTarget(min=250, max=320), "s2": LuxTarget(max=400)}
    found = lamps(relighter, asked, free=["intensity"], lights=two)
    told = {fit.what: fit for fit in found.targets}
    assert set(told) == {"s0: mean", "s1: min", "s1: max", "s2: max"}
    assert told["s0: mean"].found == pytest.approx(300, rel=1e-2)
    assert found.largest_error < 0.02


@pytest.mark.slow
def test_uniformity_is_reached_by_moving_a_lamp(tmp_path):
    desk = jr.sensor_grid("desk", (-0.3, -0.4, -0.3), (0.6, 0, 0), (0, 0, 0.6), 4, 4)
    scene = dataclasses.replace(ROOM, sensors=[desk])
    relighter = jr.prepare(scene.at_sensors(), METHODS["transport"], tmp_path)
    begun, box = jr.point([0.3, 0.0, 0.3], 1.0), [[-0.4, -0.3, -0.4], [0.4, 0.45, 0.4]]
    asked = {"desk": LuxTarget(mean=200, uniformity=0.7)}
    assert jr.measure(relighter, begun).summaries()["desk"].uniformity < 0.4
    found = lamps(relighter, asked, free=["intensity", "position"], lights=begun, box=box)
    told = jr.measure(relighter, found.lights).summaries()["desk"]
    assert told.mean == pytest.approx(200, rel=0.01)
    assert told.uniformity > 0.69


# A floor under a spot, seen from above, and a block that throws a shadow on it.
FLOOR = [Part(jr.plane((2, 2), 2), "paper"), Part(raised(jr.box((0.2, 0.2, 0.2), 1), 0.1), "paper")]
ABOVE = Camera((0, 2.5, 0.01), (0, 0, 0), fov_y=40, width=16, height=16)
SEEN = Scene(FLOOR, {"paper": jr.lambert(0.5)}, ABOVE)
PLACE = [0.3, 1.5, 0.4]


@pytest.mark.slow
def test_the_aim_of_a_spot_reaches_what_searching_a_grid_finds():
    relighter = jr.prepare(SEEN, jr.Prefiltered(receiver_tolerance=0))
    view = relighter.view()

    def pictured(x: float, z: float) -> np.ndarray:
        lit = relighter.light(jr.spot(PLACE, [x, 0, z], 2.0, 30.0, 5.0))
        return np.asarray(relighter.shade(lit, view).radiance)

    painted = pictured(-0.23, 0.17)
    begun = jr.spot(PLACE, [0.3, 0, -0.2], 2.0, 30.0, 5.0)
    found = lamps(relighter, painted, free=["aim"], lights=begun, starts=1)
    (lamp,) = found.lamps
    # Where its axis meets the floor.
    along = np.asarray(lamp.target) - PLACE  # pyright: ignore[reportAttributeAccessIssue]
    meets = PLACE + along * (PLACE[1] / -along[1])
    grid = [(x, z) for x in np.linspace(-0.5, 0.5, 11) for z in np.linspace(-0.5, 0.5, 11)]
    errors = [np.linalg.norm(pictured(x, z) - painted) for x, z in grid]
    best = grid[int(np.argmin(errors))]
    # Nearer than the grid's step, and better than the best of it.
    np.testing.assert_allclose(meets[[0, 2]], best, atol=0.1)
    np.testing.assert_allclose(meets[[0, 2]], [-0.23, 0.17], atol=1e-3)
    assert found.targets[0].error < 0.01 * min(errors) / np.linalg.norm(painted)
    assert {one.what for one in found.unknowns} == {"aim across", "aim along"}


@pytest.mark.slow
def test_colour_and_cone_of_a_spot_follow_from_a_picture(tmp_path):
    relighter = jr.prepare(SEEN, jr.Indirect(gather_samples=256, bounces=2), tmp_path)
    hidden = jr.spot(PLACE, [-0.1, 0, 0.1], [2.0, 1.0, 0.5], 35.0, 20.0)
    painted = np.asarray(relighter.shade(relighter.light(hidden), relighter.view()).radiance)
    begun = jr.spot(PLACE, [-0.1, 0, 0.1], 1.0, 25.0, 10.0)
    found = lamps(relighter, painted, free=["colour", "cone"], lights=begun, starts=3)
    (lamp,) = found.lamps
    np.testing.assert_allclose(lamp.intensity, [2.0, 1.0, 0.5], rtol=0.01)  # pyright: ignore[reportAttributeAccessIssue]
    assert float(lamp.cutoff) == pytest.approx(35.0, abs=0.2)  # pyright: ignore[reportAttributeAccessIssue]
    assert float(lamp.beam) == pytest.approx(20.0, abs=0.5)  # pyright: ignore[reportAttributeAccessIssue]
    assert found.targets[0].error < 0.01


@pytest.mark.parametrize(
    ("targets", "options", "said"),
    [
        ({}, {}, "no sensor has a target"),
        ({"door": LuxTarget(mean=1.0)}, {}, "there is no sensor 'door' for a target; there are s0, s1"),
        ({"s0": LuxTarget(values=[1.0, 2.0])}, {}, "the target of 's0': values must be 1 numbers"),
        ({"s0": LuxTarget(values=[0.0])}, {}, "above 0"),
        (np.ones((12, 12, 3)), {}, "prepared at sensors; its targets are a dict of LuxTarget"),
        ({"s0": LuxTarget(mean=1.0)}, {"free": ["colours"]}, "'colours' cannot be free; known are"),
        ({"s0": LuxTarget(mean=1.0)}, {"free": ["aim"]}, "lamp 1 is a point, which has no aim to be free"),
        ({"s0": LuxTarget(mean=1.0)}, {"free": []}, "nothing of any lamp is free"),
        ({"s0": LuxTarget(mean=1.0)}, {"free": {3: ["intensity"]}}, "free: there is no lamp of number 3"),
        ({"s0": LuxTarget(mean=1.0)}, {"lights": []}, "there is no lamp to solve for"),
        ({"s0": LuxTarget(mean=1.0)}, {"lights": jr.even_sky(1.0)}, "of which nothing can be free"),
        ({"s0": LuxTarget(mean=1.0)}, {"free": ["position"], "box": [[0, 0, 0], [-1, 1, 1]]}, "the box of lamp 1"),
        ({"s0": LuxTarget(mean=1.0)}, {"noise": 0.0}, "noise is the share"),
        ({"s0": LuxTarget(mean=1.0)}, {"starts": 0}, "starts"),
        ({"s0": LuxTarget(mean=1.0)}, {"weight": np.ones((12, 12))}, "weights are of a picture's pixels"),
    ],
)
def test_bad_targets_and_lamps_are_refused_in_one_line(at_sensors, wrong_types, targets, options, said):
    with pytest.raises(InputError, match=said) as refusal:
        lamps(at_sensors("transport"), targets, **{"lights": HIDDEN, **options})  # pyright: ignore[reportArgumentType]
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({}, "asks for nothing"),
        ({"mean": 0.0}, "mean must be a number of lux above 0"),
        ({"min": float("nan")}, "min must be"),
        ({"uniformity": 1.5}, "uniformity must lie between 0 and 1"),
        ({"min": 5.0, "max": 4.0}, "min of 5 lux is above its max of 4 lux"),
        ({"mean": 5.0, "max": 4.0}, "mean of 5 lux is above its max"),
    ],
)
def test_bad_targets_of_lux_are_refused(asked, said):
    with pytest.raises(InputError, match=said):
        LuxTarget(**asked)


@pytest.mark.parametrize(
    ("picture", "weight", "said"),
    [
        (np.ones((8, 8, 3)), None, "it must be 16 × 16 × 3"),
        (np.zeros((16, 16, 3)), None, "is black where it counts"),
        (np.full((16, 16, 3), np.nan), None, "not finite; mask them"),
        (np.ones((16, 16, 3)), -np.ones((16, 16)), "none negative"),
        ({"s0": LuxTarget(mean=1.0)}, None, "prepared for a camera"),
    ],
)
def test_bad_pictures_are_refused(wrong_types, picture, weight, said):
    with pytest.raises(InputError, match=said):
        lamps(
            jr.prepare(SEEN, jr.Prefiltered(receiver_tolerance=0)), picture, lights=jr.point(PLACE, 1.0), weight=weight
        )
