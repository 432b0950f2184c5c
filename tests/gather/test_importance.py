"""Importance: what lights the picture is worth more than what does not."""

import numpy as np

import jaxrelight as jr
from jaxrelight.gather.importance import Importance
from jaxrelight.geometry.gbuffer import trace_gbuffer
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import Tracer
from tests.gather.test_photons import of
from tests.scenes import inside_out, moved


def test_what_the_picture_is_lit_by_is_worth_more():
    """Of two closed rooms, the one that the camera is in; in it, the floor below the wall that is seen."""
    room = inside_out(jr.box((1, 1, 1), 4))
    surfaces = join([room, moved(room, (3, 0, 0))])
    tracer = Tracer(surfaces)
    seen = trace_gbuffer(surfaces, tracer, jr.Camera((0, 0, 0), (0, 0, -1), fov_y=50.0, width=16, height=16))
    worth = Importance(surfaces, tracer, seen, of(0.5), 2**14)
    places = surfaces.to_scene([[0, -0.5, -0.3], [0, -0.5, 0.45], [3, -0.5, 0]])
    near, far, other = worth(places, np.tile([0.0, 1, 0], (3, 1)), np.ones(3))
    assert near > far > 4 * other > 0
    assert np.isclose(worth(places, np.tile([0.0, 1, 0], (3, 1)), np.ones(3)).max(), near)


def test_where_nothing_lands_all_is_worth_the_same():
    surfaces = join([jr.plane((1, 1), 2)])
    tracer = Tracer(surfaces)
    seen = trace_gbuffer(surfaces, tracer, jr.Camera((0, 1, 0.1), (0, 0, 0), width=4, height=4))
    worth = Importance(surfaces, tracer, seen, of(0.5), 100)
    np.testing.assert_array_equal(worth(np.zeros((2, 3)), np.tile([0.0, 1, 0], (2, 1)), np.ones(2)), 1)
