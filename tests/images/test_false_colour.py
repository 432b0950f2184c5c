"""False colours: lighter is more, and what is not shown has no coverage."""

import numpy as np

from jaxrelight.images.false_colour import false_colour


def test_more_is_lighter():
    values = np.linspace(2, 5, 64)[None]
    colours, ends = false_colour(values, np.ones_like(values, bool))
    assert ends == (2, 5)
    assert (np.diff(colours[0, :, :3].sum(axis=1)) > 0).all()
    assert (colours[..., 3] == 1).all()


def test_octaves_reach_ten_down_from_the_largest():
    values = np.array([[0.0, 1e-9, 1.0, 32, 1024, 2048]])
    colours, ends = false_colour(values, np.ones_like(values, bool), octaves=True)
    assert ends == (2, 2048)
    np.testing.assert_array_equal(colours[0, 0], colours[0, 2])
    assert np.isfinite(colours).all()


def test_nothing_and_constants():
    for values, shown in ((np.ones((2, 2)), False), (np.ones((2, 2)), True), (np.zeros((2, 2)), True)):
        for octaves in (False, True):
            colours, _ = false_colour(values, np.full((2, 2), shown), octaves=octaves)
            assert np.isfinite(colours).all()
            assert (colours[..., 3] == shown).all()
