"""Errors that pictures report: against errors of whole pictures, and as samples tell those of populations."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.images import image_error
from jaxrelight.lighting.picture_error import Pictured, Shared, drawn_pixels, joined, measured_error
from jaxrelight.lighting.reference import FINER, Reference, Sample
from jaxrelight.lighting.transport_means import COEFFICIENTS, LOBES
from tests.scenes import ball_over_floor

CAMERA = jr.Camera((0.4, 1.0, 2.0), (0, 0.2, 0), fov_y=45, width=32, height=24)
PAINT = jr.phong([0.4, 0.2, 0.1], 0.4, 30)


def sky() -> jr.Environment:
    """A few lamps of different sizes in a dim room."""
    pixels = np.full((32, 64, 3), 0.1, np.float32)
    pixels[6:9, 10:14], pixels[12:14, 40:42], pixels[3:4, 55:60] = (6, 5, 4), (20, 20, 30), (9, 3, 3)
    return jr.environment(pixels)


def scene() -> jr.Scene:
    return ball_over_floor(PAINT, CAMERA, sky(), quads=(10, 8), height=0.36)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory):
    return tmp_path_factory.mktemp("error") / "store"


@pytest.fixture(scope="module")
def exact(folder) -> jr.Image:
    """Exact transport of every pixel."""
    relighter = jr.prepare(scene(), jr.Transport("pixels", resolution=16, coefficients="all"), folder)
    return relighter.shade(relighter.light(sky()), relighter.view())


@pytest.mark.slow
def test_exact_transport_is_its_own_reference(exact):
    error = exact.error
    assert error.parts[COEFFICIENTS] < 1e-5
    np.testing.assert_allclose(error.trimmed.value, error.parts[FINER], rtol=1e-3)
    assert 0 < error.parts[FINER] < 0.2


@pytest.mark.parametrize(
    "dials",
    [
        {},
        pytest.param({"reflection": "factors", "factor_resolution": 16}, marks=pytest.mark.slow),
        pytest.param({"reflection": "traced"}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_all_pixels_tell_the_error_of_the_picture(dials, exact, folder):
    """Where the sample is the whole picture, the error is what `image_error` says, each part of it included."""
    relighter = jr.prepare(
        scene(), jr.Transport("vertices", receiver_tolerance=0, resolution=16, coefficients=32, **dials), folder
    )
    view, lit = relighter.view(), relighter.light(sky())
    image = relighter.shade(lit, view)
    error = image.measure(32 * 24)
    wanted = image_error(image.rgba(), exact.rgba())
    without = np.sqrt(error.trimmed.value**2 - error.parts[FINER] ** 2)
    np.testing.assert_allclose(without, wanted.trimmed, rtol=0.03)
    assert error.untrimmed.value > 0.99 * wanted.untrimmed
    means = {"factors and interpolation"} if dials.get("reflection") == "factors" else {LOBES}
    assert set(error.parts) == means | {COEFFICIENTS, "interpolation", FINER}
    assert all(0 < part < 1.2 * error.untrimmed.value for part in error.parts.values())


@pytest.mark.slow
@pytest.mark.parametrize("reflection", ["filtered", "factors"])
def test_what_rows_leave_out_is_told_from_what_lies_between_vertices(reflection, folder):
    """Without coefficients left out there is no such part, and with them it is how far both pictures are apart."""
    dials = {"resolution": 16, "coefficients": 32, "reflection": reflection, "factor_resolution": 16}
    kept = jr.prepare(scene(), jr.Transport("vertices", receiver_tolerance=0, **dials), folder)
    pictures = [one.shade(one.light(sky()), one.view()) for one in (kept, kept.exact())]
    parts = [picture.error.parts for picture in pictures]
    assert parts[1][COEFFICIENTS] < 1e-4 < parts[0][COEFFICIENTS]
    rest = "interpolation" if reflection == "filtered" else "factors and interpolation"
    assert 0.5 * parts[1][rest] < parts[0][rest] < 2 * parts[1][rest]
    apart = image_error(pictures[0].rgba(), pictures[1].rgba()).trimmed
    assert 0.5 * apart < parts[0][COEFFICIENTS] < 2 * apart


def test_what_is_expected_of_a_picture_is_what_its_even_pixels_tell(folder):
    """No picture is shaded; where all pixels are drawn, it is the picture's own error."""
    relighter = jr.prepare(
        scene(), jr.Transport("vertices", receiver_tolerance=0, resolution=16, coefficients=32), folder
    )
    view, lit = relighter.view(), relighter.light(sky())
    expected = relighter.expected_error(lit, view, samples=32 * 24)
    told = relighter.error(relighter.shade(lit, view), lit, view, samples=32 * 24)
    for name in ("trimmed", "untrimmed"):
        expected_one, one = getattr(expected, name), getattr(told, name)
        np.testing.assert_allclose(dataclasses.astuple(expected_one), dataclasses.astuple(one), rtol=1e-5)
    np.testing.assert_allclose(list(expected.parts.values()), list(told.parts.values()), rtol=1e-5)
    assert relighter.expected_error(lit, view, samples=0) is None
    away = relighter.view(dataclasses.replace(CAMERA, target=(0.4, 9, 2.5)))
    assert relighter.expected_error(lit, away) is None


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize("samples", [-1, 2.5, "many"])
def test_a_wrong_number_of_samples_is_refused(folder, samples):
    relighter = jr.prepare(
        scene(), jr.Transport("vertices", receiver_tolerance=0, resolution=16, coefficients=32), folder
    )
    view, lit = relighter.view(), relighter.light(sky())
    with pytest.raises(jr.InputError, match=r"samples are .* must be whole numbers from 0"):
        relighter.expected_error(lit, view, samples=samples)
    with pytest.raises(jr.InputError, match="samples are"):
        relighter.shade(lit, view).measure(samples)


def test_errors_are_not_measured_inside_of_compiled_functions(folder):
    relighter = jr.prepare(
        scene(), jr.Transport("vertices", receiver_tolerance=0, resolution=16, coefficients=32), folder
    )
    view, lit = relighter.view(), relighter.light(sky())
    image = relighter.shade(lit, view)
    for ask in (lambda im: relighter.error(im, lit, view), lambda im: relighter.expected_error((lit, im), view)):
        with pytest.raises(jr.InputError, match="outside of jit"):
            jax.jit(ask)(image)


@pytest.mark.slow
def test_plans_tell_what_is_expected_of_adaptive_lighting():
    relighter = jr.prepare(scene(), jr.Adaptive(samples=16))
    lit, view = relighter.light(sky()), relighter.view()
    with pytest.raises(jr.InputError, match="see plan"):
        relighter.expected_error(lit, view)


@pytest.mark.slow
def test_bounces_are_named_and_not_counted(folder):
    plain, bounced = (
        jr.prepare(
            scene(),
            jr.Transport("vertices", receiver_tolerance=0, resolution=8, bounces=bounces, factor_resolution=8),
            folder,
        )
        for bounces in (0, 1)
    )
    errors = [one.shade(one.light(sky()), one.view()).measure(800) for one in (plain, bounced)]
    assert errors[0].missing == ()
    assert errors[1].missing == ("what bounces bring",)
    assert "not measured: what bounces bring" in str(errors[1])
    # The same direct light is compared, and bounces make the whole brighter.
    for means in (COEFFICIENTS, "interpolation", LOBES):
        assert 0.7 * errors[0].parts[means] < errors[1].parts[means] < 1.05 * errors[0].parts[means]


@pytest.mark.slow
def test_some_pixels_of_a_view_show_what_they_do_in_it(folder):
    relighter = jr.prepare(
        scene(), jr.Transport("vertices", receiver_tolerance=0, resolution=16, reflection="traced"), folder
    )
    view, lit = relighter.view(), relighter.light([sky(), jr.point([1, 2, 1], 3.0)])
    image = np.asarray(relighter.shade(lit, view).radiance).reshape(-1, 3)
    chosen = view.surfaces.pixels[3::7]
    taken = view.taken(chosen)
    assert taken.shape == (1, len(chosen))
    np.testing.assert_allclose(relighter.shade(lit, taken).radiance[0], image[chosen], rtol=1e-4, atol=1e-6)


def test_a_sample_has_one_pixel_of_each_run():
    pixels = np.arange(100, 1100)
    chosen = drawn_pixels(pixels, 50)
    assert len(set(chosen)) == 50
    np.testing.assert_array_equal((chosen - 100) // 20, np.arange(50))
    np.testing.assert_array_equal(drawn_pixels(pixels, 2000), pixels)
    assert len(set(drawn_pixels(pixels, 700))) == 700
    assert (drawn_pixels(pixels, 50, seed=1) != chosen).any()


class Nothing(Reference):
    """Of which pixels alone are asked for."""

    name = "nothing"

    def of(self, pixels):
        return Sample(pixels, None, lambda lit: {})


def test_samples_stand_for_all_pixels_however_they_are_drawn():
    """Weighted counts, sums and energies are those of the picture, of which a few pixels have nearly all."""
    rng, shown = np.random.default_rng(0), np.arange(50, 4050)
    radiance = np.zeros((5000, 3))
    radiance[shown] = rng.lognormal(0, 2, (4000, 1))
    told = []
    for seed in range(40):
        samples, weights = Nothing(shown, 256, seed).samples(radiance)
        assert [len(samples[0].pixels), int(weights[1].sum() > 0)] == [192, 1]
        own = np.concatenate([radiance[sample.pixels, 0] for sample in samples])
        every = np.concatenate(weights)
        told.append([every.sum(), every @ own, every @ own**2])
    wanted = [4000, radiance[:, 0].sum(), (radiance[:, 0] ** 2).sum()]
    np.testing.assert_allclose(np.mean(told, axis=0), wanted, rtol=0.03)
    # Of a black picture, pixels are drawn evenly.
    (even,), (alike,) = Nothing(shown, 250, 0).samples(0 * radiance)
    assert len(even.pixels) == 250 - 62
    np.testing.assert_allclose([alike.sum(), np.ptp(alike)], [4000, 0], atol=1e-9)
    # Nearly the same energy in every draw: pixels are drawn by it.
    assert np.std(told, axis=0)[2] < 0.1 * wanted[2]


def test_samples_that_see_nothing_lit_have_rows_of_nothing():
    both = joined([{}, {"a": np.ones((2, 3))}], [3, 2])
    np.testing.assert_array_equal(both["a"], np.repeat([0.0, 1], [3, 2])[:, None] * np.ones(3))


def test_intervals_hold_the_error_of_the_whole():
    """Of populations whose errors vary as those of pictures do: few are far off."""
    rng, inside = np.random.default_rng(0), {"trimmed": 0, "untrimmed": 0}
    for _ in range(100):
        size = 6000
        wanted = rng.lognormal(0, 0.7, (size, 3))
        apart = 0.02 * wanted * rng.lognormal(0, 1, (size, 1)) * rng.choice([-1, 1], (size, 1))
        whole = image_error((wanted + apart)[None], wanted[None])
        some = rng.choice(size, 256, replace=False)
        exact = {"lamps": wanted[some]}
        pictured = Pictured({"lamps": (wanted + apart)[some]}, np.zeros((256, 3)))
        error = measured_error((wanted + apart)[some], np.ones(256), pictured, exact, {}, {}, "all pixels")
        for name in inside:
            interval = getattr(error, name)
            inside[name] += interval.low <= getattr(whole, name) <= interval.high
    assert inside["trimmed"] >= 90
    assert inside["untrimmed"] >= 80


def test_what_both_have_in_common_is_added_by_squares():
    wanted = np.ones((64, 3))
    pictured = Pictured({"a": 1.03 * wanted}, np.zeros_like(wanted))
    error = measured_error(
        1.03 * wanted,
        np.ones(64),
        pictured,
        {"a": wanted},
        {"b": Shared(0.04, 0.04)},
        {"a": {"d": 6.0, "e": 8.0}},
        "truth",
        ("c",),
    )
    np.testing.assert_allclose([error.trimmed.value, error.untrimmed.value], 0.05, rtol=1e-6)
    # Of what d and e bring about together, each has its share.
    assert str(error) == "5 % ± 0 from truth: b 4, e 2.4, d 1.8; not measured: c"


@pytest.mark.slow
def test_nothing_seen_and_nothing_lit_have_no_error(folder):
    relighter = jr.prepare(scene(), jr.Transport("vertices", receiver_tolerance=0, resolution=8), folder)
    away = relighter.view(dataclasses.replace(CAMERA, target=(0.4, 9, 2.5)))
    lit = relighter.light(sky())
    assert relighter.shade(lit, away).error is None
    black = relighter.light(jr.environment(np.zeros((2, 4, 3), np.float32)))
    assert relighter.shade(black, relighter.view()).error.untrimmed.value == 0


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(jr.Transport("pixels", resolution=8), id="pixels", marks=pytest.mark.slow),
        pytest.param(jr.Prefiltered(map_rows=64, receiver_tolerance=0), id="prefiltered", marks=pytest.mark.slow),
    ],
)
def test_lobes_narrower_than_texels_are_measured_as_lobes(method, tmp_path):
    """Sums over texels would meet them by chance, and report an error of any size."""
    sharp = jr.phong([0.3, 0.2, 0.1], 0.5, 1e4)
    smooth = jr.environment(np.asarray(sky().pixels)[..., :1] * 0 + np.linspace(0.5, 1, 32)[:, None, None] * np.ones(3))
    of = dataclasses.replace(scene(), materials={**scene().materials, "gloss": sharp}, lights=smooth)
    relighter = jr.prepare(of, method, tmp_path if isinstance(method, jr.Transport) else None)
    error = relighter.shade(relighter.light(smooth), relighter.view()).error
    assert error.trimmed.value < 0.05
