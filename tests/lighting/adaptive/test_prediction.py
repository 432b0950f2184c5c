"""What few samples predict: nothing varies under an even sky; steps and what is thin are met; shadows have edges."""

import functools

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxrelight import Camera, Part, Prefiltered, Scene, environment, lambert, phong, prepare, sphere
from jaxrelight.lighting.adaptive.prediction import draw, predict
from jaxrelight.lighting.adaptive.sampled_brdf import sampled
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lights.environment_mipmap import environment_mipmap
from jaxrelight.numerics.arrays import as_array

CAMERA = Camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov_y=32.0, width=32, height=32)
ROWS = 128


@functools.cache
def pixels() -> SurfacePixels:
    scene = Scene([Part(sphere(1, 48), "skin")], {"skin": lambert(0.5)}, CAMERA, name="ball")
    return prepare(scene, Prefiltered(occlusion_resolution=0)).view().parts[0].pixels


@functools.cache
def part(exponent: float):
    return sampled(phong(0.0, 0.5, exponent) if exponent else lambert(0.5))


def sky(columns) -> np.ndarray:
    """The same in every row."""
    return np.ones((ROWS, 1, 1)) * np.asarray(columns, np.float32)[None, :, None] * np.ones(3)


def predicted(columns, exponent: float, spacing: float = 2.0, hidden=None):
    light = environment_mipmap(environment(sky(columns).astype(np.float32)))
    count = len(pixels().pixel)
    angle = np.sqrt(CAMERA.solid_angles().max())
    bend, far, angle, step = (as_array(of, np.float32) for of in (np.ones(count), np.full(count, 3), angle, spacing))
    drawn = draw(part(exponent), pixels(), 16)
    prediction = predict(part(exponent), light, pixels(), bend, far, angle, step, drawn, hidden)
    return jax.tree.map(np.asarray, prediction)


def seen() -> np.ndarray:
    """Pixels that are there and not seen at a grazing angle."""
    return (np.asarray(pixels().pixel) < 32 * 32) & (np.asarray(pixels().omega_o)[:, 2] > 0.5)


def off_edge() -> np.ndarray:
    """How far from the plane x = 0 each pixel mirrors the eye, in radians."""
    frame, omega_o = np.asarray(pixels().frame), np.asarray(pixels().omega_o)
    mirrored = 2 * omega_o[:, 2:] * frame[:, 2] - np.einsum("pxy,px->py", frame, omega_o)
    return np.abs(np.arcsin(np.clip(mirrored[:, 0], -1, 1)))


@pytest.mark.parametrize("exponent", [0.0, 1e4])
def test_nothing_varies_under_an_even_sky(exponent: float):
    prediction = predicted(np.ones(2 * ROWS), exponent)
    assert prediction.angular[seen()].max() < 1e-3
    assert prediction.image[seen()].max() < 1e-3
    # Of a wide lobe half is given back; Phong's, in a narrow one, by the cosine.
    expected = 0.5 * np.asarray(pixels().omega_o)[seen(), 2] if exponent else 0.5
    np.testing.assert_allclose(prediction.radiance[seen()], expected, atol=0.03)


def test_a_step_is_met_where_it_is_mirrored():
    """Between two predicted pixels, too: to each of them it is nearer than half the way to the next."""
    step = np.where(np.arange(2 * ROWS) < ROWS, 0.02, 1)
    angular = predicted(step, 1e4).angular
    turn = 2 * 2 * 3 * np.sqrt(CAMERA.solid_angles().max())
    near, far = seen() & (off_edge() < turn / 2), seen() & (off_edge() > 4 * turn) & (off_edge() < 1.2)
    assert near.sum() > 10
    assert far.sum() > 10
    # So steep that what lies between is half off: 0.225 cycles.
    assert np.median(angular[near]) * turn > 0.225
    assert np.median(angular[far]) < 0.3 * np.median(angular[near])


def test_what_is_thinner_than_from_pixel_to_pixel_is_met():
    line = np.zeros(2 * ROWS)
    line[ROWS] = 1
    dim = seen() & (np.abs(off_edge() - 0.08) < 0.03)
    wide, narrow = (predicted(line, 1e4, spacing).radiance[dim] for spacing in (4.0, 0.01))
    assert (wide > 0).mean() > 0.9
    assert (wide > 0).mean() > (narrow > 0).mean() + 0.3


def test_shadows_have_edges_where_some_is_hidden():
    shape = len(pixels().pixel), 16
    far = np.full(shape, np.inf, np.float32)
    half, all_of_it = far.copy(), np.full(shape, 0.5, np.float32)
    half[:, ::2] = 0.5
    none, some, whole = (predicted(np.ones(2 * ROWS), 0.0, hidden=of) for of in (far, half, all_of_it))
    here = seen()
    assert (some.spatial[here] > 10 * none.spatial[here]).all()
    assert (some.angular[here] > 10 * none.angular[here]).all()
    assert not whole.radiance[here].any()
    assert (whole.variance[here] > 0).all()
    # The nearer what hides, the sharper.
    nearer = predicted(np.ones(2 * ROWS), 0.0, hidden=np.where(np.isinf(half), half, np.float32(0.1)))
    np.testing.assert_allclose(nearer.spatial[here], 5 * some.spatial[here], rtol=1e-3)


def test_maps_of_lobes_add_their_own_bandwidth():
    """A map that alternates once a pixel or more is as fast as pixels are."""
    from jaxrelight.brdf.texture import Texture

    one = part(0.0)
    bandwidths = []
    for varied in (0.0, 0.35):
        mapped = eqx.tree_at(
            lambda of: of.map,
            one,
            Texture(as_array(np.full((8, 8, 1), varied), np.float32)),
            is_leaf=lambda of: of is None,
        )
        light = environment_mipmap(environment(sky(np.ones(2 * ROWS)).astype(np.float32)))
        count = len(pixels().pixel)
        given = eqx.tree_at(lambda of: of.footprint, pixels(), np.full(count, 1e-3, np.float32))
        drawn = draw(mapped, given, 16)
        bend, far, angle, step = (as_array(of, np.float32) for of in (np.ones(count), np.full(count, 3), 0.017, 2))
        foreseen = predict(mapped, light, given, bend, far, angle, step, drawn)
        bandwidths.append(np.asarray(foreseen.spatial))
    assert not bandwidths[0][seen()].any()
    across = np.sqrt(1e-3) * 8 * 0.35 * np.sqrt(np.asarray(pixels().omega_o)[:, 2]) / (3 * 0.017)
    np.testing.assert_allclose(bandwidths[1][seen()], 2 * across[seen()], rtol=1e-3)
