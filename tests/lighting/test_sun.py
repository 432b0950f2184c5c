"""Suns that are integrated by themselves, against rows that leave nothing out."""

import dataclasses

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Scene
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.methods import Transport
from jaxrelight.precomputation.precompute import precompute
from tests.opening import open_transport
from tests.scenes import block_aside

SETTINGS = Transport(
    "vertices",
    receiver_tolerance=0,
    reflection="factors",
    resolution=8,
    terms=2,
    factor_resolution=12,
    coefficients=24,
    gather_resolution=8,
)


def _scene(block: str = "gloss") -> Scene:
    return block_aside(jr.phong([0.2, 0.3, 0.1], [0.4, 0.3, 0.2], 6.0), block, quads=6)


def _sky(sun: float, low: float = 0.0) -> jr.Environment:
    pixels = np.random.default_rng(6).uniform(low, 1.0, (16, 32, 3)).astype(np.float32)
    pixels[4, 11] = [sun, 0.9 * sun, 0.8 * sun]
    return jr.environment(pixels, rotate_y=13.0, scale=0.5)


def _terms(relighter: TransportRelighter, sky: jr.Environment) -> np.ndarray:
    return np.concatenate([np.asarray(part).ravel() for part in relighter.light(sky).terms])


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"receivers": "pixels"},
        {"coefficients": "shared", "bits": 8},
        pytest.param({"visibility_samples": 4}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_a_sun_adds_no_error(tmp_path, change):
    """Nothing of a sun alone is left out; beside a sky, what is left out is of the sky."""
    made = precompute(_scene(), dataclasses.replace(SETTINGS, **change), tmp_path)
    relighter = open_transport(made.folder)
    exact = relighter.exact()
    alone = jr.environment(np.where(_sky(1e5).pixels > 2, _sky(1e5).pixels, 0))
    wanted = _terms(exact, alone)
    assert np.abs(wanted).max() > 1
    np.testing.assert_allclose(_terms(relighter, alone), wanted, atol=1e-5 * np.abs(wanted).max())
    for sun in (1e3, 1e5):
        sky = _sky(sun)
        wanted, terms = _terms(exact, sky), _terms(relighter, sky)
        assert np.linalg.norm(terms - wanted) < 5 / sun * np.linalg.norm(wanted)
        # Compressed, it is much farther off.
        pixels = relighter.light_vector(sky.pixels, sky.rotate_y, sky.scale)
        whole = np.concatenate([np.asarray(part).ravel() for part in relighter.terms(pixels)])
        assert np.linalg.norm(whole - wanted) > 10 * np.linalg.norm(terms - wanted)


@pytest.mark.slow
def test_a_sun_bounces(tmp_path):
    """Bounced light of a sun is that of its coefficients: what the bounce adds is the same with it split off."""
    settings = dataclasses.replace(SETTINGS, coefficients="shared", compression_tolerance=0.0)
    pictures = []
    for bounces in (0, 1):
        made = precompute(_scene("paper"), dataclasses.replace(settings, bounces=bounces), tmp_path)
        relighter = open_transport(made.folder)
        sky = _sky(1e3)
        vector = relighter.light_vector(sky.pixels, sky.rotate_y, sky.scale)
        view = relighter.view()
        pictures += [
            np.asarray(relighter.shade_terms(terms, view))
            for terms in (relighter.light(sky).terms, relighter.terms(vector))
        ]
    split, whole = pictures[2] - pictures[0], pictures[3] - pictures[1]
    assert split.max() > 0.1
    np.testing.assert_allclose(split, whole, atol=1e-4 * np.abs(pictures[3]).max())
