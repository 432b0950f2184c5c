"""A BRDF for every texel in transport: pixels bake their own, exactly; vertices share factors."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material, textured_lambert, white_lambert
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture, constant
from jaxrelight.precomputation import layer_files
from jaxrelight.precomputation.precompute import precompute
from tests.transport.stores import open_transport

METHOD = jr.Transport("pixels", resolution=8, coefficients="all")
LIGHT = np.random.default_rng(0).random((6 * 8**2, 3)).astype(np.float32)


def _scene(material) -> jr.Scene:
    camera = jr.Camera((0.2, 1.5, 0.8), (0, 0, 0), fov_y=40, width=16, height=12)
    return jr.Scene([jr.Part(jr.plane((1, 1), 4), "floor")], {"floor": material}, camera)


def _seen_at(material, folder, method):
    """Radiance of the surface under light over texels, where none is seen 0; how it was made."""
    made = precompute(_scene(material), method, folder)
    relighter = open_transport(made.folder)
    return np.asarray(relighter.shade_terms(relighter.terms(LIGHT), relighter.view())), relighter, made


def _picture(material, folder):
    return _seen_at(material, folder, METHOD)[0]


def _maps(exponents) -> SpatialLobes:
    """Two rows of texels: the far half of the plane and the near one."""
    h = len(exponents)
    exponent = np.reshape(exponents, (h, 1, 1))
    return _spatial(_filled(0.2, h, 1, 3), _filled([-1, -1, 1], h, 1, 1, 3), exponent, _filled(0.6, h, 1, 1, 3))


def _filled(value, *shape: int) -> np.ndarray:
    return np.array(np.broadcast_to(np.asarray(value, np.float32), shape))


def _spatial(diffuse, C, exponent, scale) -> SpatialLobes:
    axis = _filled([1, 0], *diffuse.shape[:2], 2)
    return SpatialLobes(*jax.device_put([np.asarray(part, np.float32) for part in (diffuse, C, exponent, scale, axis)]))


def _lobes(diffuse, C, exponent, scale) -> LobeSum:
    return LobeSum(*jax.device_put([np.asarray(part, np.float32) for part in (diffuse, C, exponent, scale)]))


PLAIN = _lobes([0.2] * 3, [[[-1, -1, 1]]], [[5]], [[0.6] * 3])
SHINE = _lobes([0] * 3, [[[-1, -1, 1]]], [[5]], [[0.6] * 3])
PAPER = _lobes([0.2] * 3, np.zeros((0, 1, 3)), np.zeros((0, 1)), np.zeros((0, 3)))
# One number of texels, so that all maps have the same shapes.
SAME, HALVES = [5] * 8, [2, 2, 2, 2, 25, 25, 25, 25]


def test_maps_that_are_the_same_everywhere_are_the_plain_brdf(tmp_path):
    image = _picture(Material((Component(_maps(SAME)),)), tmp_path / "maps")
    np.testing.assert_allclose(image, _picture(PLAIN, tmp_path / "plain"), rtol=1e-4, atol=1e-6)
    assert image.any()


def test_every_pixel_has_the_lobes_at_its_own_place(tmp_path):
    """Where u, v lies within half a texel of the map's edge rows, one half of the picture follows each."""
    both = _picture(Material((Component(_maps(HALVES)),)), tmp_path / "both")
    soft, sharp = (_picture(Material((Component(_maps([n] * 8)),)), tmp_path / str(n)) for n in (2, 25))
    apart = [np.abs(both - other).sum(axis=(1, 2)) for other in (soft, sharp)]
    top, bottom = 3, 8
    assert apart[0][top] < 1e-3 * apart[1][top] or apart[1][top] < 1e-3 * apart[0][top]
    assert (apart[0][top] < apart[1][top]) != (apart[0][bottom] < apart[1][bottom])


# At vertices, by factors that all texels share.

VERTICES = jr.Transport(
    "vertices",
    receiver_tolerance=0,
    reflection="factors",
    resolution=8,
    coefficients="all",
    terms=40,
    factor_resolution=24,
)


@pytest.mark.slow
def test_at_vertices_equal_maps_are_the_factored_plain_brdf(tmp_path):
    image, _, _ = _seen_at(Material((Component(_maps(SAME)),)), tmp_path / "maps", VERTICES)
    white = Material((Component(white_lambert(), (constant([0.2] * 3),)), Component(SHINE)))
    wanted, _, _ = _seen_at(white, tmp_path / "plain", VERTICES)
    np.testing.assert_allclose(image, wanted, rtol=2e-3, atol=1e-5)


def test_at_vertices_each_half_has_its_own_lobes(tmp_path):
    """Many terms: what pixels bake exactly, but for what maps of 24² texels leave."""
    material = Material((Component(_maps([2, 2, 2, 2, 12, 12, 12, 12])),))
    image, relighter, made = _seen_at(material, tmp_path / "vertices", VERTICES)
    assert [block.reflection.terms for block in relighter.transport.blocks] == [1, 40]
    assert [block.reflection.channels for block in relighter.transport.blocks] == [1, 1]
    (note,) = made.notes
    assert "40 factors leave" in note
    wanted = _picture(material, tmp_path / "pixels")
    halves = np.linalg.norm(wanted[3] - wanted[8])
    assert halves > 0.05 * np.linalg.norm(wanted[3])
    for rows in (slice(0, 5), slice(7, None)):
        assert np.linalg.norm(image[rows] - wanted[rows]) < 0.03 * np.linalg.norm(wanted[rows])


def test_maps_that_only_are_diffuse_bake_one_term(tmp_path):
    maps = _maps(SAME)
    black = Material((Component(dataclasses.replace(maps, scale=jax.device_put(0 * np.asarray(maps.scale)))),))
    image, relighter, _ = _seen_at(black, tmp_path / "black", VERTICES)
    assert len(relighter.transport.blocks) == 1
    wanted, _, _ = _seen_at(PAPER, tmp_path / "lambert", VERTICES)
    np.testing.assert_allclose(image, wanted, rtol=1e-4, atol=1e-6)


def test_shared_factors_are_found_in_the_store_again_and_again_when_damaged(tmp_path, monkeypatch):
    material = Material((Component(_maps([5, 5, 5, 5, 9, 9, 9, 9])),))
    first, _, made = _seen_at(material, tmp_path, VERTICES)
    monkeypatch.setattr(layer_files, "factor_spatial", None)
    again, _, same = _seen_at(material, tmp_path, VERTICES)
    np.testing.assert_array_equal(again, first)
    assert same.notes == made.notes
    monkeypatch.undo()
    (layer,) = (folder for folder in tmp_path.glob("factors-*") if _shared(folder))
    for file in layer.iterdir():
        file.write_bytes(file.read_bytes()[:-3])
    mended, _, _ = _seen_at(material, tmp_path, VERTICES)
    np.testing.assert_allclose(mended, first, rtol=1e-5)


def _shared(folder) -> bool:
    return "weights" in folder.joinpath("layout.json").read_text()


def test_pixels_bake_the_level_that_they_are_as_large_as(tmp_path):
    """Texels of a black map are far smaller than pixels, and its coarser levels are not black."""
    sides = [2**n for n in range(9, -1, -1)]

    def level(side: int, albedo: float) -> SpatialLobes:
        none = np.zeros((side, side, 0, 3)), np.zeros((side, side, 0)), np.zeros((side, side, 0, 3))
        return _spatial(_filled(albedo, side, side, 3), *none)

    maps = dataclasses.replace(level(sides[0], 0.0), coarser=tuple(level(side, 0.2) for side in sides[1:]))
    image = _picture(Material((Component(maps),)), tmp_path / "maps")
    wanted = _picture(PAPER, tmp_path / "plain")
    np.testing.assert_allclose(image, wanted, rtol=1e-4, atol=1e-6)


def test_stripes_finer_than_pixels_are_their_mean(tmp_path):
    stripes = _filled((np.arange(512) % 2)[None, :, None], 512, 512, 3)
    image = _picture(textured_lambert(Texture(jax.device_put(stripes))), tmp_path / "stripes")
    np.testing.assert_allclose(image, _picture(textured_lambert(constant([0.5] * 3)), tmp_path / "grey"), rtol=1e-3)
