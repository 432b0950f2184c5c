"""Maps of lobes: what lies in a texel, and what lies between texels."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.spatial import SpatialLobes

OMEGA = jnp.asarray([0.6, 0, 0.8]), jnp.asarray([-0.48, 0.36, 0.8])


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
    return SpatialLobes(*(jnp.asarray(a, jnp.float32) for a in arrays))


def test_at_the_centre_of_a_texel_lie_its_own_parameters():
    spatial = maps()
    for row, column in ((0, 0), (1, 3), (2, 1)):
        uv = jnp.asarray([(column + 0.5) / 4, 1 - (row + 0.5) / 3])
        axis = spatial.axis[row, column]
        own = LobeSum(
            spatial.diffuse[row, column],
            spatial.C[row, column][:, None],
            spatial.exponent[row, column][:, None],
            spatial.scale[row, column],
            jnp.arctan2(axis[1], axis[0]) / 2,
        )
        np.testing.assert_allclose(spatial.at(uv).evaluate(*OMEGA), own.evaluate(*OMEGA), rtol=2e-4)


def test_arrays_lead_with_the_coordinates():
    uv = jnp.asarray(np.random.default_rng(1).random((5, 2)), jnp.float32)
    found = maps().at(uv)
    assert found.C.shape == (5, 2, 1, 3)
    one = maps().at(uv[3])
    np.testing.assert_allclose(found.exponent[3], one.exponent)


def test_between_texels_lobes_count_by_the_light_they_reflect():
    """Exponents by their logarithms, and C; which stays of unit length. What a lobe reflects is interpolated itself."""
    spatial, middle = maps(1, 2), jnp.asarray([0.5, 0.5])
    between = spatial.at(middle)
    share = np.asarray(spatial.scale[0] / (spatial.exponent[0] + 2)[..., None])
    weight = share.mean(axis=-1)
    wanted = np.exp(np.average(np.log(spatial.exponent[0]), axis=0, weights=weight))
    np.testing.assert_allclose(between.exponent[:, 0], wanted, rtol=1e-4)
    np.testing.assert_allclose(between.scale / (between.exponent + 2), share.mean(axis=0), rtol=1e-4)
    C = np.average(np.asarray(spatial.C[0]), axis=0, weights=np.repeat(weight[..., None], 3, axis=-1))
    np.testing.assert_allclose(between.C[:, 0], C / np.abs(C).max(axis=-1, keepdims=True), rtol=1e-4)


def test_a_black_lobe_leaves_its_neighbour_as_it_is():
    spatial = maps(1, 2)
    half = dataclasses.replace(spatial, scale=spatial.scale.at[0, 0].set(0))
    between, own = half.at(jnp.asarray([0.5, 0.5])), half.at(jnp.asarray([0.75, 0.5]))
    np.testing.assert_allclose(between.exponent, own.exponent, rtol=1e-4)
    np.testing.assert_allclose(between.C, own.C, atol=1e-6)
    np.testing.assert_allclose(between.scale, own.scale / 2, rtol=1e-4)


def test_directions_of_anisotropy_meet_the_shorter_way():
    """85° and −85°, which differ by 10°, meet at 90° and not at 0°."""
    spatial = maps(1, 2)
    angle = np.radians([85, -85])
    axis = jnp.asarray(np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=-1)[None], jnp.float32)
    turn = SpatialLobes(spatial.diffuse, spatial.C, spatial.exponent, spatial.scale, axis).at(jnp.asarray([0.5, 0.5]))
    assert turn.turn is not None
    np.testing.assert_allclose(abs(np.degrees(turn.turn)), 90, atol=1e-3)


def test_gradients_are_finite_also_where_texels_cancel():
    spatial = maps(1, 2)
    opposite = jnp.stack([spatial.C[:, 0], -spatial.C[:, 0]], axis=1)
    axis = jnp.asarray([[[1.0, 0], [-1, 0]]])

    def total(C, axis, exponent):
        whole = SpatialLobes(spatial.diffuse, C, exponent, spatial.scale, axis)
        return jnp.sum(whole.at(jnp.asarray([0.5, 0.5])).evaluate(*OMEGA))

    for slope in jax.grad(total, argnums=(0, 1, 2))(opposite, axis, spatial.exponent * 0):
        assert np.isfinite(slope).all()


def test_a_material_of_maps_needs_texture_coordinates():
    material = Material((Component(maps()),))
    assert material.is_spatial
    assert material.needs_uv


def test_levels_of_equal_texels_are_averaged_parameters():
    whole = maps(4, 4, seed=3)
    flat = jax.tree.map(lambda x: jnp.broadcast_to(x[:1, :1], x.shape), whole)
    coarser = tuple(jax.tree.map(lambda x, n=n: x[:n, :n], flat) for n in (2, 1))
    spatial = SpatialLobes(flat.diffuse, flat.C, flat.exponent, flat.scale, flat.axis, coarser=coarser)
    uv = jnp.asarray([0.4, 0.7])
    wanted = spatial.packed("none").at(uv).evaluate(*OMEGA)
    for minification in ("levels", "averaged", "none"):
        found = spatial.packed(minification).at(uv, jnp.asarray(0.3)).evaluate(*OMEGA)
        np.testing.assert_allclose(found, wanted, rtol=1e-4)


def test_levels_are_seen_of_far_texels():
    far, near = maps(1, 1, seed=5), maps(2, 2, seed=6)
    spatial = SpatialLobes(near.diffuse, near.C, near.exponent, near.scale, near.axis, coarser=(far,))
    uv = jnp.asarray([0.25, 0.75])

    def seen(minification, footprint):
        lobes = spatial.packed(minification)
        _, weights = lobes.around(uv, jnp.asarray(footprint))
        np.testing.assert_allclose(weights.sum(), 1, rtol=1e-6)
        assert len(weights) == (4 if minification == "none" else 8)
        return np.asarray(lobes.at(uv, jnp.asarray(footprint)).evaluate(*OMEGA))

    np.testing.assert_allclose(seen("levels", 1.0), far.at(uv).evaluate(*OMEGA), rtol=1e-4)
    np.testing.assert_allclose(seen("levels", 0.25), near.at(uv).evaluate(*OMEGA), rtol=1e-4)
    np.testing.assert_allclose(seen("none", 1.0), near.at(uv).evaluate(*OMEGA), rtol=1e-4)
    np.testing.assert_allclose(seen("averaged", 1.0), near.packed("averaged").at(uv, 1.0).evaluate(*OMEGA), rtol=1e-6)
    assert np.abs(seen("averaged", 1.0) - seen("levels", 1.0)).max() > 0.01
