"""A BRDF for every texel in transport: pixels bake their own, exactly; vertices share factors."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import jaxrelight as jr
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material, textured_lambert, white_lambert
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture, constant
from jaxrelight.transport import layer_files

SETTINGS = jr.Settings("pixels", resolution=8, tolerance=0.0)
SKY = jr.environment(np.random.default_rng(0).random((8, 16, 3)).astype(np.float32))


def _scene(material) -> jr.Scene:
    camera = jr.Camera((0.2, 1.5, 0.8), (0, 0, 0), fov_y=40, width=16, height=12)
    return jr.Scene([jr.Part(jr.plane((1, 1), 4), "floor")], {"floor": material}, camera, SKY)


def _picture(material, folder):
    made = jr.precompute(_scene(material), SETTINGS, folder)
    relighter = jr.Relighter.open(made.folder)
    return relighter.image(SKY, relighter.view(), background=False)


def _maps(exponents) -> SpatialLobes:
    """Two rows of texels: the far half of the plane and the near one."""
    h = len(exponents)
    C = jnp.broadcast_to(jnp.asarray([-1.0, -1, 1]), (h, 1, 1, 3))
    exponent = jnp.asarray(exponents, jnp.float32).reshape(h, 1, 1)
    axis = jnp.broadcast_to(jnp.asarray([1.0, 0]), (h, 1, 2))
    return SpatialLobes(jnp.full((h, 1, 3), 0.2), C, exponent, jnp.full((h, 1, 1, 3), 0.6), axis)


def test_maps_that_are_the_same_everywhere_are_the_plain_brdf(tmp_path):
    plain = LobeSum(jnp.full(3, 0.2), jnp.asarray([[[-1.0, -1, 1]]]), jnp.full((1, 1), 5.0), jnp.full((1, 3), 0.6))
    found = _picture(Material((Component(_maps([5, 5])),)), tmp_path / "maps")
    np.testing.assert_allclose(found, _picture(plain, tmp_path / "plain"), rtol=1e-4, atol=1e-6)
    assert found[..., 3].any()


def test_every_pixel_has_the_lobes_at_its_own_place(tmp_path):
    """Where u, v lies within half a texel of the map's edge rows, one half of the picture follows each."""
    both = _picture(Material((Component(_maps([2, 2, 2, 2, 40, 40, 40, 40])),)), tmp_path / "both")
    soft, sharp = (_picture(Material((Component(_maps([n])),)), tmp_path / str(n)) for n in (2, 40))
    apart = [np.abs(both - other)[..., :3].sum(axis=(1, 2)) for other in (soft, sharp)]
    top, bottom = 3, 8
    assert apart[0][top] < 1e-3 * apart[1][top] or apart[1][top] < 1e-3 * apart[0][top]
    assert (apart[0][top] < apart[1][top]) != (apart[0][bottom] < apart[1][bottom])


# At vertices, by factors that all texels share.

VERTICES = jr.Settings("vertices", resolution=8, coefficients="all", terms=6, factor_resolution=24)


def _seen_at(material, folder, settings=VERTICES):
    made = jr.precompute(_scene(material), settings, folder)
    relighter = jr.Relighter.open(made.folder)
    return relighter.image(SKY, relighter.view(), background=False)[..., :3], relighter, made


def test_at_vertices_equal_maps_are_the_factored_plain_brdf(tmp_path):
    plain = LobeSum(jnp.full(3, 0.2), jnp.asarray([[[-1.0, -1, 1]]]), jnp.full((1, 1), 5.0), jnp.full((1, 3), 0.6))
    found, relighter, made = _seen_at(Material((Component(_maps([5, 5])),)), tmp_path / "maps")
    white = Material((Component(white_lambert(), (constant([0.2] * 3),)), Component(_without_diffuse(plain))))
    wanted, _, _ = _seen_at(white, tmp_path / "plain")
    np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=1e-5)
    assert [block.reflection.terms for block in relighter.transport.blocks] == [1, 6]
    assert [block.reflection.channels for block in relighter.transport.blocks] == [1, 1]
    (note,) = made.notes
    assert "6 terms leave" in note


def _without_diffuse(brdf: LobeSum) -> LobeSum:
    return LobeSum(jnp.zeros(3), brdf.C, brdf.exponent, brdf.scale)


def test_at_vertices_each_half_has_its_own_lobes(tmp_path):
    """Many terms: what pixels bake exactly, but for what maps of 24² texels leave."""
    material = Material((Component(_maps([2, 2, 2, 2, 12, 12, 12, 12])),))
    settings = jr.Settings("vertices", resolution=8, coefficients="all", terms=40, factor_resolution=24)
    found, _, _ = _seen_at(material, tmp_path / "vertices", settings)
    wanted, _, _ = _seen_at(material, tmp_path / "pixels", jr.Settings("pixels", resolution=8, coefficients="all"))
    halves = np.linalg.norm(wanted[3] - wanted[8])
    assert halves > 0.05 * np.linalg.norm(wanted[3])
    for rows in (slice(0, 5), slice(7, None)):
        assert np.linalg.norm(found[rows] - wanted[rows]) < 0.03 * np.linalg.norm(wanted[rows])


def test_maps_that_only_are_diffuse_bake_one_term(tmp_path):
    maps = _maps([5, 5])
    black = Material((Component(dataclasses.replace(maps, scale=maps.scale * 0)),))
    found, relighter, _ = _seen_at(black, tmp_path / "black")
    assert len(relighter.transport.blocks) == 1
    wanted, _, _ = _seen_at(LobeSum(jnp.full(3, 0.2), *_none()), tmp_path / "lambert")
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-6)


def _none():
    return jnp.zeros((0, 1, 3)), jnp.zeros((0, 1)), jnp.zeros((0, 3))


def test_shared_factors_are_found_in_the_store_again_and_again_when_damaged(tmp_path, monkeypatch):
    material = Material((Component(_maps([5, 9])),))
    first, _, made = _seen_at(material, tmp_path)
    monkeypatch.setattr(layer_files, "factor_spatial", None)
    again, _, same = _seen_at(material, tmp_path)
    np.testing.assert_array_equal(again, first)
    assert same.notes == made.notes
    monkeypatch.undo()
    (layer,) = (folder for folder in tmp_path.glob("factors-*") if _shared(folder))
    for file in layer.iterdir():
        file.write_bytes(file.read_bytes()[:-3])
    mended, _, _ = _seen_at(material, tmp_path)
    np.testing.assert_allclose(mended, first, rtol=1e-5)


def _shared(folder) -> bool:
    return "weights" in folder.joinpath("layout.json").read_text()


def test_pixels_bake_the_level_that_they_are_as_large_as(tmp_path):
    """Texels of a black map are far smaller than pixels, and its coarser levels are not black."""
    sides = [2**n for n in range(9, -1, -1)]

    def level(side: int, albedo: float) -> SpatialLobes:
        none = jnp.zeros((side, side, 0, 3)), jnp.zeros((side, side, 0)), jnp.zeros((side, side, 0, 3))
        return SpatialLobes(jnp.full((side, side, 3), albedo), *none, jnp.ones((side, side, 2)))

    maps = dataclasses.replace(level(sides[0], 0.0), coarser=tuple(level(side, 0.2) for side in sides[1:]))
    found = _picture(Material((Component(maps),)), tmp_path / "maps")
    wanted = _picture(LobeSum(jnp.full(3, 0.2), *_none()), tmp_path / "plain")
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-6)


def test_stripes_finer_than_pixels_are_their_mean(tmp_path):
    stripes = jnp.broadcast_to((jnp.arange(512) % 2 * 1.0)[None, :, None], (512, 512, 3))
    found = _picture(textured_lambert(Texture(stripes)), tmp_path / "stripes")
    np.testing.assert_allclose(found, _picture(textured_lambert(constant([0.5] * 3)), tmp_path / "grey"), rtol=1e-3)
