"""Transport rows against the formula, their relations to each other, and their gradients."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.basis import cubemap
from jaxrelight.basis.cubemap import Texels
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.parametrisation import POLAR
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.transport import bake

N, D = 4, 96


def unit(vectors) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def frames_for(m: int, dtype: Any = np.float32):
    return tangent_frame(jnp.asarray(unit(np.random.default_rng(m).normal(size=(m, 3))), dtype))


def bits_for(m: int, directions: int = D):
    return jnp.asarray(np.random.default_rng(m).integers(0, 256, size=(m, directions // 8), dtype=np.uint8))


def views_for(m: int) -> np.ndarray:
    views = unit(np.random.default_rng(1).normal(size=(m, 3)))
    return views * [1, 1, 0] + np.abs(views) * [0, 0, 1]


GLOSSY = lobe_sum([0.1, 0.2, 0.3], [lobe([-0.9, -0.9, 0.7], 5, specular=0.4), lobe([-1, -1, 1], 2.5, peak=[1, 2, 3])])


def reflection_for(name: str, m: int, dtype: Any = np.float32) -> Any:
    if name == "fixed view":
        brdf = jax.tree.map(lambda x: x.astype(dtype), GLOSSY)
        return FixedView(brdf, jnp.asarray(views_for(m), dtype))
    maps = np.random.default_rng(2).uniform(size=(2, {"maps": 3, "grey maps": 1}[name], 5, 5))
    return Factored(jnp.asarray(maps, dtype), jnp.asarray(maps, dtype))


def rows_by_formula(bits, frames, reflection: Reflection, samples: int = 1) -> np.ndarray:
    """Light side × visibility × cosine × solid angle, summed within texels: [m, k, c, d] in float64."""
    fine = N * samples
    local = np.einsum("mij,dj->mdi", np.asarray(frames, float), cubemap.directions(fine))
    seen = np.unpackbits(np.asarray(bits), axis=-1, bitorder="little")
    weight = seen * np.maximum(local[..., 2], 0) * cubemap.solid_angles(fine)
    own_axes: Any = FixedView
    in_axes = (own_axes(None, 0), 0) if isinstance(reflection, FixedView) else (None, 0)
    light_side = jax.jit(jax.vmap(lambda own, omega: jax.vmap(own.light_side)(omega), in_axes=in_axes))
    sides = np.asarray(light_side(reflection, jnp.asarray(local, frames.dtype)), float)
    m = len(local)
    rows = np.einsum("md,mdkc->mkcd", weight, sides)
    k, c = rows.shape[1:3]
    return rows.reshape(m, k, c, 6, N, samples, N, samples).sum(axis=(5, 7)).reshape(m, k, c, D)


def relative(found, expected) -> float:
    return float(np.linalg.norm(np.asarray(found, float) - expected) / np.linalg.norm(expected))


directions_for = functools.cache(bake.directions_for)


@pytest.mark.parametrize(("name", "m"), [("fixed view", 6), ("maps", 16), ("grey maps", 1)])
def test_rows_are_the_formula(name, m):
    """For numbers of receivers that do and do not fill the blocks they are baked in."""
    bits, frames, reflection = bits_for(m), frames_for(m), reflection_for(name, m)
    rows = bake.bake_rows(bits, frames, reflection, directions_for(N), Texels(N))
    assert rows.shape == (m, reflection.terms, reflection.channels, D)
    assert rows.dtype == np.float32
    assert relative(rows, rows_by_formula(bits, frames, reflection)) < 1e-5


@pytest.mark.parametrize("choice", [{"form": "symmetric"}, {"parametrisation": POLAR}, {"form": "normalised"}])
def test_every_form_of_factors_is_baked_and_viewed_alike(choice):
    """Radiance is the sum over texels of the factored BRDF itself."""
    bits, frames = bits_for(8), frames_for(8)
    terms = 1 if choice.get("form") == "normalised" else 3
    reflection = factor(GLOSSY, terms, 12, **choice)
    light = jnp.asarray(np.random.default_rng(0).uniform(size=(D, 3)), jnp.float32)
    omega_o = jnp.asarray(views_for(8), jnp.float32)
    product = bake.bake_and_apply(bits, frames, reflection, directions_for(N), light)
    radiance = jnp.sum(product * jax.vmap(reflection.view_side)(omega_o), axis=1)
    view = np.asarray(jax.vmap(reflection.view_side)(omega_o), float)
    expected = np.einsum("mkcd,dc,mkc->mc", rows_by_formula(bits, frames, reflection), light, view)
    assert relative(radiance, expected) < 1e-5


def test_rows_in_haar_coefficients_are_the_rows_encoded():
    bits, frames, reflection = bits_for(6), frames_for(6), reflection_for("maps", 6)
    rows = bake.bake_rows(bits, frames, reflection, directions_for(N), HaarFaces(N))
    expected = HaarFaces(N).encode(jnp.asarray(rows_by_formula(bits, frames, reflection), jnp.float32))
    assert relative(rows, np.asarray(expected, float)) < 1e-5


def test_rows_in_float64(x64):
    bits, frames, reflection = bits_for(6), frames_for(6, np.float64), reflection_for("fixed view", 6, np.float64)
    rows = bake.bake_rows(bits, frames, reflection, bake.directions_for(N, dtype=np.float64), Texels(N))
    assert rows.dtype == np.float64
    assert relative(rows, rows_by_formula(bits, frames, reflection)) < 1e-13


@pytest.mark.parametrize("samples", [2, 3])
def test_several_rays_a_texel_are_averaged(samples):
    fine = 6 * (N * samples) ** 2
    bits, frames, reflection = bits_for(4, fine), frames_for(4), reflection_for("maps", 4)
    directions = directions_for(N, samples)
    rows = bake.bake_rows(bits, frames, reflection, directions, Texels(N))
    assert rows.shape[-1] == D
    assert relative(rows, rows_by_formula(bits, frames, reflection, samples)) < 1e-5
    # The sum over texels is that of the fine cube map by itself.
    whole = bake.bake_rows(bits, frames, reflection, directions_for(N * samples), Texels(N * samples))
    assert relative(rows.sum(axis=-1), np.asarray(whole, float).sum(axis=-1)) < 1e-5


def test_directions_are_those_of_the_cube_map():
    directions = bake.directions_for(N, 2)
    np.testing.assert_allclose(directions.vectors, cubemap.directions(2 * N), atol=1e-7)
    np.testing.assert_allclose(jnp.sum(directions.to_texels(directions.solid_angles)), 4 * np.pi, rtol=1e-6)
    centre = directions.to_texels(directions.vectors.T).T
    np.testing.assert_array_equal(cubemap.texel_of(np.asarray(centre), N), np.arange(D))


NORMALS = np.array(
    [[0, 1, 0], [0, -1, 0], [1, 0, 0], [0, 0, -1], [1, 1, 1], [-1, -2, 0.5], [0.01, -1, 0.01], [1, 0, -1]]
)


@pytest.mark.parametrize("through", ["texels", "haar", "fixed view"])
def test_white_furnace(through):
    """Albedo 1 under light 1, nothing in the way: radiance 1 at resolution 64, whatever the normal."""
    n = 64
    directions = directions_for(n)
    frames = tangent_frame(jnp.asarray(unit(NORMALS), jnp.float32))
    bits = jnp.full((len(NORMALS), 6 * n * n // 8), 255, jnp.uint8)
    ones = jnp.ones((6 * n * n, 3))
    if through == "fixed view":
        reflection = FixedView(lambert(1.0), jnp.tile(jnp.asarray([0.0, 0.6, 0.8]), (len(NORMALS), 1)))
    else:
        reflection = factor(lambert(1.0))
    if through == "haar":
        rows = bake.bake_rows(bits, frames, reflection, directions, HaarFaces(n))
        terms = jnp.einsum("mkcd,dx->mkx", rows, HaarFaces(n).encode(ones.T).T)
    else:
        terms = bake.bake_and_apply(bits, frames, reflection, directions, ones)
    up = jnp.asarray([[0.0, 0, 1]] * len(NORMALS))
    own = FixedView(lambert(1.0), up[0]) if through == "fixed view" else reflection
    radiance = jnp.sum(jax.vmap(own.view_side)(up) * terms, axis=1)
    np.testing.assert_allclose(radiance, np.ones((len(NORMALS), 3)), atol=1e-3)


def test_glossy_furnace_gives_the_albedo_for_the_exact_view():
    """Phong seen along the normal reflects diffuse + specular."""
    n = 32
    frames = tangent_frame(jnp.asarray([[0.0, 1, 0], [0, -1, 0]]))
    reflection = FixedView(phong(0.3, 0.5, 10), jnp.asarray([[0.0, 0, 1]] * 2))
    bits = jnp.full((2, 6 * n * n // 8), 255, jnp.uint8)
    radiance = bake.bake_and_apply(bits, frames, reflection, directions_for(n), jnp.ones((6 * n * n, 3)))
    np.testing.assert_allclose(radiance, np.full((2, 1, 3), 0.8), atol=2e-3)


def test_what_is_not_seen_does_not_light():
    frames, reflection = frames_for(4), reflection_for("maps", 4)
    light = jnp.ones((D, 3))
    dark = bake.bake_and_apply(jnp.zeros((4, D // 8), jnp.uint8), frames, reflection, directions_for(N), light)
    np.testing.assert_array_equal(dark, 0)


def test_truncation_to_all_coefficients_is_the_rows():
    bits, frames, reflection = bits_for(6), frames_for(6), reflection_for("maps", 6)
    arguments = bits, frames, reflection, directions_for(N), HaarFaces(N)
    kept, rows = bake.bake_truncated(*arguments, D), bake.bake_rows(*arguments)
    np.testing.assert_array_equal(kept.indices, np.broadcast_to(np.arange(D), kept.indices.shape))
    assert relative(kept.values, np.asarray(rows, float)) < 1e-6
    np.testing.assert_array_equal(kept.dropped, 0)


@pytest.mark.parametrize("name", ["fixed view", "grey maps"])
def test_kept_coefficients_are_those_of_the_rows(name):
    bits, frames, reflection = bits_for(6), frames_for(6), reflection_for(name, 6)
    arguments = bits, frames, reflection, directions_for(N), HaarFaces(N)
    count = 10
    kept, rows = bake.bake_truncated(*arguments, count), np.asarray(bake.bake_rows(*arguments), float)
    k, c = reflection.terms, reflection.channels
    assert kept.indices.shape == (6, k, count)
    assert kept.values.shape == (6, k, c, count)
    expected = np.take_along_axis(rows, np.asarray(kept.indices)[:, :, None], axis=-1)
    assert relative(kept.values, expected) < 1e-6
    energy = np.sum(rows**2, axis=-1)
    np.testing.assert_allclose(kept.total, energy, rtol=1e-5)
    np.testing.assert_allclose(kept.dropped, energy - np.sum(expected**2, axis=-1), rtol=1e-3)
    again = bake.bake_kept(*arguments, kept.indices.astype(jnp.uint16))
    assert relative(again, np.asarray(kept.values, float)) < 1e-6


@pytest.mark.parametrize(("name", "m"), [("fixed view", 16), ("maps", 3), ("grey maps", 3)])
def test_apply_is_rows_times_light_and_transpose_its_adjoint(name, m):
    bits, frames, reflection = bits_for(m), frames_for(m), reflection_for(name, m)
    rng = np.random.default_rng(3)
    light = jnp.asarray(rng.normal(size=(D, 3)), jnp.float32)
    radiance = jnp.asarray(rng.normal(size=(m, reflection.terms, 3)), jnp.float32)
    arguments = bits, frames, reflection, directions_for(N)
    rows = rows_by_formula(bits, frames, reflection)
    rows = np.broadcast_to(rows, (*rows.shape[:2], 3, D))
    forward, back = bake.bake_and_apply(*arguments, light), bake.bake_and_transpose(*arguments, radiance)
    assert relative(forward, np.einsum("mkcd,dc->mkc", rows, light)) < 1e-5
    assert relative(back, np.einsum("mkcd,mkc->dc", rows, radiance)) < 1e-5
    difference = float(np.vdot(np.asarray(forward, float), radiance)) - float(np.vdot(light, np.asarray(back, float)))
    assert abs(difference) < 1e-6 * np.linalg.norm(forward) * np.linalg.norm(radiance)


def test_baking_does_not_retrace_for_another_group():
    """Groups of one shape share one compilation, whatever their values."""
    m = 5
    frames, reflection, directions = frames_for(m), reflection_for("fixed view", m), directions_for(N)
    light = jnp.ones((D, 3))
    baking: Any = bake.bake_and_apply
    baking(bits_for(m), frames, reflection, directions, light)
    compiled = baking._cache_size()
    other = jax.tree.map(lambda x: 0.5 * x, reflection)
    baking(~bits_for(m), -frames, other, bake.directions_for(N), 2 * light)
    assert baking._cache_size() == compiled


@pytest.fixture
def exact(x64):
    """Bits, frames and directions of two receivers in float64."""
    return bits_for(2), frames_for(2, np.float64), bake.directions_for(N, dtype=np.float64)


INDICES = np.array([[[0, 3, 17, 40, 95]], [[1, 2, 30, 64, 80]]])


def random_light():
    return jnp.asarray(np.random.default_rng(4).uniform(size=(D, 3)))


def lobe_parameters() -> dict:
    return {name: getattr(GLOSSY, name).astype(np.float64) for name in ("diffuse", "C", "exponent", "scale")}


@pytest.mark.parametrize("what", ["kept", "apply"])
def test_gradients_in_lobe_parameters(exact, what):
    """In diffuse, C, exponent and scale, each of which has some influence."""
    bits, frames, directions = exact
    views, light = jnp.asarray(views_for(2)), random_light()

    @jax.jit
    def value(parameters):
        reflection = FixedView(LobeSum(**parameters), views)
        if what == "kept":
            return bake.bake_kept(bits, frames, reflection, directions, HaarFaces(N), jnp.asarray(INDICES))
        return bake.bake_and_apply(bits, frames, reflection, directions, light)

    check_grads(value, (lobe_parameters(),), 1, ["fwd", "rev"])
    for slope in jax.jit(jax.jacfwd(value))(lobe_parameters()).values():
        assert np.abs(slope).max() > 1e-3


@pytest.mark.parametrize("what", ["kept", "apply"])
def test_gradients_in_maps_albedo_and_light(exact, what):
    bits, frames, directions = exact
    maps = reflection_for("maps", 2, np.float64).light_maps
    albedo = jnp.asarray([0.2, 0.5, 0.9])

    @jax.jit
    def value(maps, albedo, light):
        factors = Factored(maps, maps)
        diffuse = FixedView(LobeSum(albedo, *(lobe_parameters()[x][:0] for x in ("C", "exponent", "scale"))), views)
        if what == "kept":
            indices = jnp.asarray(INDICES)
            both = jnp.concatenate([indices, indices + 1], axis=1) % D
            of_maps = bake.bake_kept(bits, frames, factors, directions, HaarFaces(N), both)
            return of_maps, bake.bake_kept(bits, frames, diffuse, directions, HaarFaces(N), indices)
        arguments = bits, frames
        return tuple(bake.bake_and_apply(*arguments, side, directions, light) for side in (factors, diffuse))

    views = jnp.asarray(views_for(2))
    light = random_light()
    if what == "kept":
        check_grads(lambda maps, albedo: value(maps, albedo, light), (maps, albedo), 1, ["fwd", "rev"])
    else:
        check_grads(value, (maps, albedo, light), 1, ["fwd", "rev"])


def test_gradient_in_light_is_the_transpose(exact):
    bits, frames, directions = exact
    reflection, light = reflection_for("maps", 2, np.float64), random_light()
    radiance = jnp.asarray(np.random.default_rng(5).normal(size=(2, 2, 3)))
    _, pull = jax.vjp(lambda light: bake.bake_and_apply(bits, frames, reflection, directions, light), light)
    back = bake.bake_and_transpose(bits, frames, reflection, directions, radiance)
    np.testing.assert_allclose(pull(radiance)[0], back, rtol=1e-12, atol=1e-14)


def test_gradients_are_finite_for_tight_lobes_and_grazing_views():
    """Exponents up to 16600 in the peak form, an eye at and below the horizon, no light at all."""
    m = 4
    views = jnp.asarray([[0.0, 0, 1], [1, 0, 1e-7], [1, 0, 0], [0.6, 0, -0.8]])
    directions = directions_for(N)

    @jax.jit
    def total(brdf, light):
        terms = bake.bake_and_apply(bits_for(m), frames_for(m), FixedView(brdf, views), directions, light)
        return jnp.sum(terms**2)

    brdf = lobe_sum(0.0, [lobe([-0.577, -0.577, 0.577], n, peak=1) for n in (0, 0.5, 50, 1e4, 16600)])
    for light in (jnp.zeros((D, 3)), jnp.full((D, 3), 1e5)):
        for slope in jax.tree.leaves(jax.grad(total, argnums=(0, 1))(brdf, light)):
            assert np.isfinite(slope).all()
