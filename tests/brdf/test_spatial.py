"""Maps of lobes: what lies in a texel, and what lies between texels."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.spatial import SpatialLobes

OMEGA = np.asarray([[0.6, 0, 0.8], [-0.48, 0.36, 0.8]], np.float32)


def maps(h=3, w=4, lobes=2, seed=0) -> SpatialLobes:
    rng = np.random.default_rng(seed)
    C = rng.uniform(-1, 1, (h, w, lobes, 3))
    angle = rng.uniform(-1.5, 1.5, (h, w))
    arrays = (
        rng.uniform(0, 0.5, (h, w, 3)),
        C / np.abs(C).max(axis=-1, keepdims=True),
        np.exp(rng.uniform(0, 5, (h, w, lobes))),
        rng.uniform(0, 2, (h, w, lobes, 3)),
        np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=-1),
    )
    return SpatialLobes(*(jnp.asarray(a.astype(np.float32)) for a in arrays))


def host(tree):
    """The same with NumPy's arrays, of which parts are taken without compiling anything."""
    return jax.tree.map(np.asarray, tree)


@functools.partial(jax.jit, static_argnames="minification")
def at(spatial, uv, footprint=0.0, minification="none"):
    """Lobes at texture coordinates, what they reflect, and the weights of the texels around."""
    lobes = spatial.packed(minification)
    brdf = lobes.at(uv, footprint)
    return brdf, brdf.evaluate(*OMEGA), lobes.around(uv, footprint)[1]


def reflected(spatial, uv, footprint=0.0, minification="none") -> np.ndarray:
    return np.asarray(at(spatial, np.asarray(uv, np.float32), np.float32(footprint), minification)[1])


def of_texel(spatial, row: int, column: int) -> np.ndarray:
    """What the lobes of a texel reflect."""
    spatial = host(spatial)
    cosine, sine = spatial.axis[row, column]
    own = LobeSum(
        spatial.diffuse[row, column],
        spatial.C[row, column][:, None],
        spatial.exponent[row, column][:, None],
        spatial.scale[row, column],
        jnp.asarray(np.arctan2(sine, cosine) / 2),
    )
    return np.asarray(own.evaluate(*OMEGA))


def test_at_the_centre_of_a_texel_lie_its_own_parameters():
    spatial = host(maps())
    for row, column in ((0, 0), (1, 3), (2, 1)):
        value = reflected(spatial, [(column + 0.5) / 4, 1 - (row + 0.5) / 3])
        np.testing.assert_allclose(value, of_texel(spatial, row, column), rtol=2e-4)


def test_arrays_lead_with_the_coordinates():
    uv = np.random.default_rng(1).random((5, 2)).astype(np.float32)
    brdfs = maps().at(uv)
    assert brdfs.C.shape == (5, 2, 1, 3)
    one, _, _ = at(maps(), uv[3], np.float32(0))
    np.testing.assert_allclose(np.asarray(brdfs.exponent)[3], one.exponent)


# Of two texels side by side, as arguments that need no conversion.
MIDDLE, ALL = np.asarray([0.5, 0.5], np.float32), np.float32(0)


def test_between_texels_lobes_count_by_the_light_they_reflect():
    """Exponents by their logarithms, and C; which stays of unit length. What a lobe reflects is interpolated itself."""
    spatial = host(maps(1, 2))
    between = host(at(spatial, MIDDLE, ALL)[0])
    share = spatial.scale[0] / (spatial.exponent[0] + 2)[..., None]
    weight = share.mean(axis=-1)
    wanted = np.exp(np.average(np.log(spatial.exponent[0]), axis=0, weights=weight))
    np.testing.assert_allclose(between.exponent[:, 0], wanted, rtol=1e-4)
    np.testing.assert_allclose(between.scale / (between.exponent + 2), share.mean(axis=0), rtol=1e-4)
    C = np.average(spatial.C[0], axis=0, weights=np.repeat(weight[..., None], 3, axis=-1))
    np.testing.assert_allclose(between.C[:, 0], C / np.abs(C).max(axis=-1, keepdims=True), rtol=1e-4)


def test_a_black_lobe_leaves_its_neighbour_as_it_is():
    half = jax.tree.map(np.array, maps(1, 2))
    half.scale[0, 0] = 0
    between, own = (host(at(half, np.asarray([u, 0.5], np.float32), ALL)[0]) for u in (0.5, 0.75))
    np.testing.assert_allclose(between.exponent, own.exponent, rtol=1e-4)
    np.testing.assert_allclose(between.C, own.C, atol=1e-6)
    np.testing.assert_allclose(between.scale, own.scale / 2, rtol=1e-4)


def test_directions_of_anisotropy_meet_the_shorter_way():
    """85° and −85°, which differ by 10°, meet at 90° and not at 0°."""
    spatial = maps(1, 2)
    angle = np.radians([85, -85])
    axis = np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=-1)[None].astype(np.float32)
    brdf, _, _ = at(dataclasses.replace(spatial, axis=axis), MIDDLE, ALL)
    assert brdf.turn is not None
    np.testing.assert_allclose(abs(np.degrees(np.asarray(brdf.turn))), 90, atol=1e-3)


def test_gradients_are_finite_also_where_texels_cancel():
    spatial = host(maps(1, 2))
    opposite = np.stack([spatial.C[:, 0], -spatial.C[:, 0]], axis=1)
    axis = np.asarray([[[1.0, 0], [-1, 0]]], np.float32)

    def total(C, axis, exponent):
        whole = SpatialLobes(spatial.diffuse, C, exponent, spatial.scale, axis)
        return jnp.sum(whole.at(MIDDLE).evaluate(*OMEGA))

    for slope in jax.jit(jax.grad(total, argnums=(0, 1, 2)))(opposite, axis, spatial.exponent * 0):
        assert np.isfinite(np.asarray(slope)).all()


def test_a_material_of_maps_needs_texture_coordinates():
    material = Material((Component(maps()),))
    assert material.is_spatial
    assert material.needs_uv


def test_levels_of_equal_texels_are_averaged_parameters():
    flat = jax.tree.map(lambda x: np.tile(np.asarray(x), (4, 4, *[1] * (x.ndim - 2))), maps(1, 1, seed=3))
    spatial = dataclasses.replace(flat, coarser=tuple(jax.tree.map(lambda x, n=n: x[:n, :n], flat) for n in (2, 1)))
    wanted = of_texel(flat, 0, 0)
    for minification in ("levels", "averaged", "none"):
        np.testing.assert_allclose(reflected(spatial, [0.4, 0.7], 0.3, minification), wanted, rtol=1e-4)


def test_levels_are_seen_of_far_texels():
    far, middle, near = maps(1, 1, seed=5), maps(2, 2, seed=7), maps(4, 4, seed=6)
    spatial = dataclasses.replace(near, coarser=(middle, far))
    # The centres of a texel of either level: of (1, 2) of 4×4, and of (0, 1) of 2×2.
    finer, coarser = np.asarray([[0.625, 0.625], [0.75, 0.75]], np.float32)

    def seen(minification, footprint, uv=finer):
        _, value, weights = at(spatial, uv, np.float32(footprint), minification)
        np.testing.assert_allclose(np.sum(weights), 1, rtol=1e-6)
        assert len(weights) == (4 if minification == "none" else 8)
        return np.asarray(value)

    np.testing.assert_allclose(seen("levels", 1.0), of_texel(far, 0, 0), rtol=1e-4)
    np.testing.assert_allclose(seen("levels", 0.25, coarser), of_texel(middle, 0, 1), rtol=1e-4)
    np.testing.assert_allclose(seen("levels", 1 / 16), of_texel(near, 1, 2), rtol=1e-4)
    np.testing.assert_allclose(seen("none", 1.0), of_texel(near, 1, 2), rtol=1e-4)
    np.testing.assert_allclose(seen("averaged", 1.0), reflected(near, finer, 1.0, "averaged"), rtol=1e-6)
    assert np.abs(seen("averaged", 1.0) - seen("levels", 1.0)).max() > 0.01


@jax.jit
def _slopes_of_exponents(spatial, uv):
    return jax.grad(lambda spatial: jnp.sum(spatial.packed("none").at(uv).exponent))(spatial)


def test_black_texels_have_no_steep_slopes():
    """Nothing is known of a black lobe's exponent, and less of what it would be were it a little brighter."""
    spatial = maps()
    uv = np.asarray([[0.4, 0.4], [0.1, 0.6], [0.5, 0.5]], np.float32)
    for scale in (
        np.zeros(spatial.scale.shape, np.float32),
        np.asarray(spatial.scale) * (np.arange(4) > 1)[:, None, None],
    ):
        slopes = _slopes_of_exponents(dataclasses.replace(spatial, scale=scale), uv)
        black = scale == 0
        assert not np.asarray(slopes.scale)[black].any()
        assert np.abs(np.asarray(slopes.exponent)).max() < 100
