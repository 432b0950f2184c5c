"""What coefficients that are left out can cost, known before any light is applied: never exceeded, and reached."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.lighting.transport import TransportRelighter
from tests.scenes import ball_over_floor

CAMERA = jr.Camera((0.4, 1.0, 2.0), (0, 0.2, 0), fov_y=45, width=16, height=12)
PAINT = jr.phong([0.4, 0.2, 0.1], 0.4, 8)
RESOLUTION = 8


def prepared(folder, receivers: str, **dials: Any) -> TransportRelighter:
    method = jr.Transport(receivers, RESOLUTION, reflection="factors", factor_resolution=8, split_sun=False, **dials)  # pyright: ignore[reportArgumentType]
    relighter = jr.prepare(ball_over_floor(PAINT, CAMERA, quads=(4, 4)), method, folder)
    assert isinstance(relighter, TransportRelighter)
    return relighter


def lights() -> list[jr.Environment]:
    """Even, noisy, and a single bright pixel."""
    rng = np.random.default_rng(0)
    one = np.zeros((16, 32, 3), np.float32)
    one[5, 11] = 1e4
    return [jr.environment(of.astype(np.float32)) for of in (np.ones((16, 32, 3)), rng.gamma(0.2, size=one.shape), one)]


@pytest.mark.parametrize(
    ("receivers", "dials"),
    [
        pytest.param("vertices", {"coefficients": 24}, marks=pytest.mark.slow),
        pytest.param("pixels", {"coefficients": "shared", "bits": 8}, marks=pytest.mark.slow),
        ("pixels", {"coefficients": 24}),
        pytest.param("vertices", {"coefficients": "shared", "bits": 8}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_no_pixel_is_further_off(tmp_path, receivers, dials):
    relighter = prepared(tmp_path, receivers, **dials)
    exact, view = relighter.exact(), relighter.view()
    for light in lights():
        kept, wanted = (np.asarray(of.shade(of.light(light), view).radiance) for of in (relighter, exact))
        bound = np.asarray(relighter.error_bound(light, view))
        assert bound.shape == kept.shape
        assert (np.abs(kept - wanted) <= bound * (1 + 1e-4) + 1e-5 * np.abs(wanted).max()).all()
        assert bound.max() > 0
    np.testing.assert_allclose(
        relighter.error_bound(lights()[1].with_(scale=2.0), view),
        2 * relighter.error_bound(lights()[1], view),
        rtol=1e-5,
    )


@pytest.mark.slow
def test_the_worst_light_reaches_it(tmp_path):
    """Of one pixel, the light that is as what its row leaves out."""
    relighter = prepared(tmp_path, "pixels", coefficients=24)
    exact, view = relighter.exact(), relighter.view()
    pixel = int(view.surfaces.pixels[40])
    row, column = divmod(pixel, CAMERA.width)
    d = relighter.transport.basis.size

    def off(texels):
        """The pixel's error in the second channel."""
        lit = [(of, of.terms(of.transport.basis.encode(texels.T).T)) for of in (relighter, exact)]
        kept, wanted = (of.shade_terms(terms, view)[row, column, 1] for of, terms in lit)
        return wanted - kept

    worst = jax.grad(off)(jnp.zeros((d, 3)))
    length = float(jnp.linalg.norm(worst[:, 1]))
    # The same bound for every light of that length.
    even = jr.environment(np.ones((16, 32, 3), np.float32))
    size = float(jnp.linalg.norm(relighter.light_vector(even.pixels)[:, 1]))
    bound = float(relighter.error_bound(even, view)[row, column, 1]) / size
    assert 0.98 * bound < length < 1.001 * bound


def test_nothing_left_out_bounds_nothing(tmp_path):
    relighter = prepared(tmp_path, "pixels", coefficients="all")
    assert not np.asarray(relighter.error_bound(lights()[0], relighter.view())).any()
