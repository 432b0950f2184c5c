"""What a measured BRDF says of itself, whatever its format."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.files import BrdfFile, load_brdf
from jaxrelight.brdf.lobes import lambert, phong
from jaxrelight.brdf.sampling import directional_albedo
from tests.brdf.files import writers
from tests.shared_data import shared

WRITTEN = {
    "RGL": writers.rgl,
    "Cornell": lambda: writers.cornell(*writers.cornell_pairs()),
    "MERL": lambda: writers.merl(np.full((90, 90, 180, 3), 0.1)),
}


@pytest.mark.parametrize("kind", WRITTEN)
def test_the_content_says_what_a_file_is(tmp_path, kind):
    path = tmp_path / "unnamed"
    path.write_bytes(WRITTEN[kind]())
    assert load_brdf(path).kind == kind


def test_albedos_are_the_integrals_over_the_light():
    for brdf in (lambert([0.3, 0.5, 0.2]), phong([0.1] * 3, [0.2, 0.3, 0.1], 8)):
        for degrees, albedo in BrdfFile(brdf, "RGL", ()).albedos().items():
            angle = np.radians(degrees)
            omega_o = jnp.asarray([np.sin(angle), 0, np.cos(angle)], jnp.float32)
            assert albedo == pytest.approx(float(directional_albedo(brdf, omega_o).max()), rel=1e-3)


@pytest.mark.parametrize(("albedo", "lines"), [(1.0, 0), (1.1, 1)])
def test_making_light_is_told(albedo, lines):
    told = BrdfFile(lambert([0.5, albedo, 0.5]), "RGL", ()).energy_notes()
    assert len(told) == lines
    assert all(line.startswith("as measured, 1.1 times the light") for line in told)


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("rgl_cc_ibiza_sunset_rgb", 1),
        ("rgl_paper_white_rgb", 1),
        ("rgl_vch_golden_yellow_rgb", 1),
        ("rgl_satin_rosaline_rgb", 1.12),  # the file reflects this much at 80 degrees
    ],
)
def test_measured_surfaces_reflect_no_more_than_comes_or_it_is_told(name, most):
    measured = load_brdf(shared("data", "brdf", f"{name}.bsdf"))
    assert 0 < max(measured.albedos().values()) <= most
    assert bool(measured.energy_notes()) == (most > 1)
