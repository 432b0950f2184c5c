"""What a material asks of its factors, and that it gets it: in a scene, in a store, and in the picture."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.factoring import Factoring
from jaxrelight.brdf.factors import factor_error
from jaxrelight.brdf.lobes import phong
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.parametrisation import DISC, POLAR
from jaxrelight.lighting.prepare import prepare_with_build
from tests.brdf.test_spatial import maps as maps_of_lobes
from tests.scenes import ball_over_floor
from tests.transport.stores import load_transport

GLOSS = phong([0.1, 0.2, 0.1], [0.3, 0.2, 0.4], 8)
CAMERA = jr.Camera((0.4, 1.2, 2.2), (0.1, 0.2, 0), fov_y=50, width=16, height=12)


def _scene(gloss) -> jr.Scene:
    return ball_over_floor(gloss, CAMERA)


@pytest.mark.parametrize("form", ["svd", "symmetric", "nonnegative", "normalised"])
@pytest.mark.parametrize(("parametrisation", "maps"), [("disc", DISC), ("polar", POLAR)])
def test_factors_are_of_the_form_and_the_maps_that_were_asked_for(form, parametrisation, maps):
    asked = Factoring(form=form, parametrisation=parametrisation)
    made = asked.factors(GLOSS, 3, 8)
    assert made.parametrisation == maps
    assert made.terms == (1 if form == "normalised" else 3)
    light, view = np.asarray(made.light_maps), np.asarray(made.view_maps)
    if form in ("nonnegative", "normalised"):
        assert min(light.min(), view.min()) >= 0
    if form == "symmetric":
        np.testing.assert_array_equal(np.abs(light), np.abs(view))


def test_as_few_terms_are_taken_as_leave_the_error():
    asked = Factoring(error=0.2)
    made = asked.factors(GLOSS, 1, 8)
    assert factor_error(GLOSS, made) <= 0.2
    fewer = jax.tree.map(lambda maps: maps[:-1], made)
    assert factor_error(GLOSS, fewer) > 0.2


@pytest.mark.slow
def test_a_store_keeps_what_was_asked_for(tmp_path):
    """The error of its factors is told, and another form is made anew."""
    scene, method = (
        _scene(GLOSS),
        jr.Transport("vertices", receiver_tolerance=0, resolution=4, reflection="factors", factor_resolution=8),
    )
    blocks, notes = {}, {}
    for name, asked in {
        "plain": None,
        "polar": Factoring(parametrisation="polar"),
        "nonnegative": Factoring(form="nonnegative"),
        "error": Factoring(error=0.1),
    }.items():
        one = dataclasses.replace(scene, factors={} if asked is None else {"gloss": asked})
        relighter, made = prepare_with_build(one, method, tmp_path)
        assert made is not None
        blocks[name] = next(block for block in load_transport(tmp_path).blocks if block.reflection.terms > 1)
        notes[name] = " ".join(made.notes)
        if name == "polar":
            light = relighter.light(jr.environment(np.ones((4, 8, 3), np.float32)))
            assert np.isfinite(relighter.shade(light, relighter.view()).radiance).all()
    assert blocks["plain"].reflection.parametrisation == DISC
    assert blocks["polar"].reflection.parametrisation == POLAR
    assert np.asarray(blocks["plain"].reflection.light_maps).min() < 0
    assert np.asarray(blocks["nonnegative"].reflection.light_maps).min() >= 0
    assert blocks["error"].reflection.terms > 4
    assert all("factors leave" in note for note in notes.values())


def test_maps_of_lobes_share_factors_of_one_form_alone():
    scene = dataclasses.replace(
        _scene(Material((Component(maps_of_lobes()),))), factors={"gloss": Factoring(form="symmetric")}
    )
    with pytest.raises(jr.InputError, match="remove 'terms_error', 'form' and 'parametrisation'"):
        scene.check_materials()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"terms": 0}, "'terms' must be at least 1"),
        ({"form": "normalised", "terms": 3}, "a single term, not 3; remove 'terms'"),
        ({"error": 1.5}, "'terms_error' must lie between 0 and 1"),
        ({"form": "eigen"}, "'form' .*'svd'"),
        ({"parametrisation": "square"}, "'parametrisation' .*'disc' or 'polar'"),
    ],
)
def test_what_is_no_form_of_factors_is_refused(wrong_types, wrong, message):
    with pytest.raises(jr.InputError, match=message):
        Factoring(**wrong)
