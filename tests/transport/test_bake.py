"""Transport rows against the formula, their relations to each other, and their gradients."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.basis import cubemap
from jaxrelight.basis.cubemap import Texels
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.factored import Factored, Symmetric
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.parametrisation import DISC, POLAR
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.transport import bake
from tests.operators.derivatives import check_derivatives

N, D = 4, 96


def unit(vectors) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def frames_for(m: int, dtype: Any = np.float32) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(m).normal(size=(m, 3, 3)))[0].astype(dtype)


def bits_for(m: int, directions: int = D) -> np.ndarray:
    return np.random.default_rng(m).integers(0, 256, size=(m, directions // 8), dtype=np.uint8)


def views_for(m: int) -> np.ndarray:
    views = unit(np.random.default_rng(1).normal(size=(m, 3)))
    return views * [1, 1, 0] + np.abs(views) * [0, 0, 1]


GLOSSY = lobe_sum([0.1, 0.2, 0.3], [lobe([-0.9, -0.9, 0.7], 5, specular=0.4), lobe([-1, -1, 1], 2.5, peak=[1, 2, 3])])

# For numbers of receivers that do and do not fill the blocks they are baked in.
RECEIVERS = {"fixed view": 6, "maps": 16, "grey maps": 1}


def reflection_for(name: str, m: int, dtype: Any = np.float32) -> Any:
    if name == "fixed view":
        brdf = jax.tree.map(lambda x: np.asarray(x, dtype), GLOSSY)
        return jax.device_put(FixedView(brdf, views_for(m).astype(dtype)))  # pyright: ignore[reportArgumentType]
    maps = np.random.default_rng(2).uniform(size=(2, {"maps": 3, "grey maps": 1}[name], 5, 5)).astype(dtype)
    return Factored(jax.device_put(maps), jax.device_put(maps))


@jax.jit
def _light_sides(reflection: Reflection, local: jax.Array) -> jax.Array:
    if isinstance(reflection, FixedView):
        in_axes = jax.tree.map(lambda own: 0 if own else None, reflection.per_receiver), 0
    else:
        in_axes = None, 0
    return jax.vmap(lambda own, omega: jax.vmap(own.light_side)(omega), in_axes=in_axes)(reflection, local)


def rows_by_formula(bits, frames, reflection: Reflection, samples: int = 1) -> np.ndarray:
    """Light side × visibility × cosine × solid angle, summed within texels: [m, k, c, d] in float64."""
    fine = N * samples
    local = np.einsum("mij,dj->mdi", frames.astype(float), cubemap.directions(fine))
    seen = np.unpackbits(np.asarray(bits), axis=-1, bitorder="little")
    weight = seen * np.maximum(local[..., 2], 0) * cubemap.solid_angles(fine)
    sides = np.asarray(_light_sides(reflection, local.astype(frames.dtype)), float)
    m = len(local)
    rows = np.einsum("md,mdkc->mkcd", weight, sides)
    k, c = rows.shape[1:3]
    return rows.reshape(m, k, c, 6, N, samples, N, samples).sum(axis=(5, 7)).reshape(m, k, c, D)


@functools.cache
def case(name: str) -> tuple[Any, Any, np.ndarray]:
    """Bits, frames, reflection and directions of some receivers; the reflection; and the rows by the formula."""
    m = RECEIVERS[name]
    bits, frames, reflection = bits_for(m), frames_for(m), reflection_for(name, m)
    return (bits, frames, reflection, directions_for(N)), reflection, rows_by_formula(bits, frames, reflection)


def relative(actual, expected) -> float:
    return float(np.linalg.norm(np.asarray(actual, float) - expected) / np.linalg.norm(expected))


directions_for = functools.cache(bake.directions_for)


@pytest.mark.parametrize("name", RECEIVERS)
def test_rows_are_the_formula(name):
    arguments, reflection, wanted = case(name)
    rows = bake.bake_rows(*arguments, Texels(N))
    assert rows.shape == (RECEIVERS[name], reflection.terms, reflection.channels, D)
    assert rows.dtype == np.float32
    assert relative(rows, wanted) < 1e-5


@jax.jit
def _seen(bits, frames, reflection, directions, light, omega_o):
    """Radiance, by baking and viewing; and the view sides."""
    view = jax.vmap(reflection.view_side)(omega_o)
    return jnp.sum(bake.bake_and_apply(bits, frames, reflection, directions, light) * view, axis=1), view


@pytest.mark.parametrize("form", ["maps of both sides", "symmetric", "polar"])
def test_every_form_of_factors_is_baked_and_viewed_alike(form):
    """Radiance is the sum over texels of the factored BRDF itself."""
    bits, frames = bits_for(8), frames_for(8)
    maps, others = np.random.default_rng(6).uniform(size=(2, 3, 3, 12, 12)).astype(np.float32)
    if form == "symmetric":
        reflection = Symmetric(
            jax.device_put(maps), jax.device_put(np.array([[1, 1, 1], [-1, 1, -1], [1, -1, 1]], np.float32))
        )
    else:
        sides = jax.device_put(maps), jax.device_put(others)
        reflection = Factored(*sides, POLAR if form == "polar" else DISC)
    light = np.random.default_rng(0).uniform(size=(D, 3)).astype(np.float32)
    radiance, view = _seen(bits, frames, reflection, directions_for(N), light, views_for(8).astype(np.float32))
    expected = np.einsum("mkcd,dc,mkc->mc", rows_by_formula(bits, frames, reflection), light, np.asarray(view, float))
    assert relative(radiance, expected) < 1e-5


@functools.cache
def coefficients(name: str) -> np.ndarray:
    """The rows of a case in Haar coefficients."""
    arguments, _, _ = case(name)
    return np.asarray(bake.bake_rows(*arguments, HaarFaces(N)))


@pytest.mark.parametrize("name", ["fixed view", "grey maps"])
def test_rows_in_haar_coefficients_are_the_rows_encoded(name):
    wanted = jax.jit(HaarFaces(N).encode)(case(name)[2].astype(np.float32))
    assert relative(coefficients(name), np.asarray(wanted, float)) < 1e-5


def test_rows_in_float64(x64):
    bits, frames, reflection = bits_for(6), frames_for(6, np.float64), reflection_for("fixed view", 6, np.float64)
    rows = bake.bake_rows(bits, frames, reflection, bake.directions_for(N, dtype=np.float64), Texels(N))
    assert rows.dtype == np.float64
    assert relative(rows, rows_by_formula(bits, frames, reflection)) < 1e-13


@pytest.mark.parametrize("samples", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_several_rays_a_texel_are_averaged(samples):
    fine = 6 * (N * samples) ** 2
    bits, frames, reflection = bits_for(4, fine), frames_for(4), reflection_for("maps", 4)
    directions = directions_for(N, samples)
    rows = bake.bake_rows(bits, frames, reflection, directions, Texels(N))
    assert rows.shape[-1] == D
    assert relative(rows, rows_by_formula(bits, frames, reflection, samples)) < 1e-5
    # The sum over texels is that of the fine cube map by itself.
    whole = bake.bake_rows(bits, frames, reflection, directions_for(N * samples), Texels(N * samples))
    assert relative(np.sum(rows, axis=-1), np.asarray(whole, float).sum(axis=-1)) < 1e-5


def test_directions_are_those_of_the_cube_map():
    directions = bake.directions_for(N, 2)
    np.testing.assert_allclose(directions.vectors, cubemap.directions(2 * N), atol=1e-7)
    angles, centre = jax.jit(lambda own: (own.to_texels(own.solid_angles), own.to_texels(own.vectors.T).T))(directions)
    np.testing.assert_allclose(np.sum(angles), 4 * np.pi, rtol=1e-6)
    np.testing.assert_array_equal(cubemap.texel_of(np.asarray(centre), N), np.arange(D))


NORMALS = np.array(
    [[0, 1, 0], [0, -1, 0], [1, 0, 0], [0, 0, -1], [1, 1, 1], [-1, -2, 0.5], [0.01, -1, 0.01], [1, 0, -1]]
)


@functools.partial(jax.jit, static_argnames="through")
def _furnace(through: str, bits, normals, reflection: Reflection, directions: bake.Directions, up):
    """Radiance under light 1, seen from above."""
    frames, n = tangent_frame(normals), round((len(directions.vectors) / 6) ** 0.5)
    ones = jnp.ones((6 * n * n, 3))
    if through == "haar":
        rows = bake.bake_rows(bits, frames, reflection, directions, HaarFaces(n))
        terms = jnp.einsum("mkcd,dx->mkx", rows, HaarFaces(n).encode(ones.T).T)
    else:
        terms = bake.bake_and_apply(bits, frames, reflection, directions, ones)
    view = reflection.view_side(up) if isinstance(reflection, Factored) else np.ones((1, 1))
    return jnp.sum(view[None] * terms, axis=1)


@pytest.mark.parametrize("through", ["texels", "haar", "fixed view"])
def test_white_furnace(through):
    """Albedo 1 under light 1, nothing in the way: radiance 1 at resolution 64, whatever the normal."""
    n, m, up = 64, len(NORMALS), np.array([0, 0, 1], np.float32)
    bits = np.full((m, 6 * n * n // 8), 255, np.uint8)
    if through == "fixed view":
        reflection = FixedView(lambert(1.0), jax.device_put(np.tile(np.array([0, 0.6, 0.8], np.float32), (m, 1))))
    else:
        reflection = factor(lambert(1.0))
    radiance = _furnace(through, bits, unit(NORMALS).astype(np.float32), reflection, directions_for(n), up)
    np.testing.assert_allclose(radiance, np.ones((m, 3)), atol=1e-3)


def test_glossy_furnace_gives_the_albedo_for_the_exact_view():
    """Phong seen along the normal reflects diffuse + specular."""
    n, normals, up = 32, np.array([[0, 1, 0], [0, -1, 0]], np.float32), np.array([0, 0, 1], np.float32)
    reflection = FixedView(phong(0.3, 0.5, 10), jax.device_put(np.tile(up, (2, 1))))
    bits = np.full((2, 6 * n * n // 8), 255, np.uint8)
    radiance = _furnace("texels", bits, normals, reflection, directions_for(n), up)
    np.testing.assert_allclose(radiance, np.full((2, 3), 0.8), atol=2e-3)


def test_what_is_not_seen_does_not_light():
    (bits, *others), _, _ = case("maps")
    np.testing.assert_array_equal(bake.bake_and_apply(0 * bits, *others, np.ones((D, 3), np.float32)), 0)


def test_truncation_to_all_coefficients_is_the_rows():
    name = "fixed view"
    arguments, _, _ = case(name)
    bits, frames, reflection, directions = arguments
    kept = bake.bake_truncated(bits, frames, reflection, directions, HaarFaces(N), D)
    np.testing.assert_array_equal(kept.indices, np.broadcast_to(np.arange(D), kept.indices.shape))
    assert relative(kept.values, coefficients(name).astype(float)) < 1e-6
    np.testing.assert_array_equal(kept.dropped, 0)


@pytest.mark.parametrize("name", ["fixed view", pytest.param("grey maps", marks=pytest.mark.slow)])
def test_kept_coefficients_are_those_of_the_rows(name):
    (arguments, reflection, _), rows, count = case(name), coefficients(name).astype(float), 10
    bits, frames, reflection, directions = arguments
    kept = bake.bake_truncated(bits, frames, reflection, directions, HaarFaces(N), count)
    m, k, c = RECEIVERS[name], reflection.terms, reflection.channels
    assert kept.indices.shape == (m, k, count)
    assert kept.values.shape == (m, k, c, count)
    expected = np.take_along_axis(rows, np.asarray(kept.indices)[:, :, None], axis=-1)
    assert relative(kept.values, expected) < 1e-6
    energy = np.sum(rows**2, axis=-1)
    np.testing.assert_allclose(kept.total, energy, rtol=1e-5)
    np.testing.assert_allclose(kept.dropped, energy - np.sum(expected**2, axis=-1), rtol=1e-3)
    again = bake.bake_kept(*arguments, HaarFaces(N), np.asarray(kept.indices, np.uint16))
    assert relative(again, np.asarray(kept.values, float)) < 1e-6


@pytest.mark.parametrize("name", RECEIVERS)
def test_apply_is_rows_times_light_and_transpose_its_adjoint(name):
    arguments, reflection, rows = case(name)
    rng = np.random.default_rng(3)
    light = rng.normal(size=(D, 3)).astype(np.float32)
    radiance = rng.normal(size=(RECEIVERS[name], reflection.terms, 3)).astype(np.float32)
    rows = np.broadcast_to(rows, (*rows.shape[:2], 3, D))
    forward, back = bake.bake_and_apply(*arguments, light), bake.bake_and_transpose(*arguments, radiance)
    assert relative(forward, np.einsum("mkcd,dc->mkc", rows, light)) < 1e-5
    assert relative(back, np.einsum("mkcd,mkc->dc", rows, radiance)) < 1e-5
    difference = float(np.vdot(np.asarray(forward, float), radiance)) - float(np.vdot(light, np.asarray(back, float)))
    assert abs(difference) < 1e-6 * np.linalg.norm(forward) * np.linalg.norm(radiance)


def test_baking_does_not_retrace_for_another_group():
    """Groups of one shape share one compilation, whatever their values."""
    (bits, frames, reflection, directions), _, _ = case("fixed view")
    light = np.ones((D, 3), np.float32)
    baking: Any = bake.bake_and_apply
    baking(bits, frames, reflection, directions, light)
    compiled = baking._cache_size()
    other = jax.device_put(jax.tree.map(lambda x: np.float32(0.5) * np.asarray(x), reflection))
    baking(~bits, -frames, other, bake.directions_for(N), 2 * light)
    assert baking._cache_size() == compiled


@pytest.fixture
def exact(x64):
    """Bits, frames and directions of two receivers in float64."""
    return bits_for(2), frames_for(2, np.float64), bake.directions_for(N, dtype=np.float64)


INDICES = np.array([[[0, 3, 17, 40, 95]], [[1, 2, 30, 64, 80]]])


def lobe_parameters() -> dict:
    return {name: np.asarray(getattr(GLOSSY, name), float) for name in ("diffuse", "C", "exponent", "scale")}


def test_gradients_in_lobe_parameters(exact):
    """In diffuse, C, exponent and scale, each of which has some influence; of coefficients and of light terms."""
    bits, frames, directions = exact
    views, light = views_for(2), np.random.default_rng(4).uniform(size=(D, 3))

    def value(parameters):
        arguments = bits, frames, FixedView(LobeSum(**parameters), jnp.asarray(views)), directions
        return bake.bake_kept(*arguments, HaarFaces(N), jnp.asarray(INDICES)), bake.bake_and_apply(*arguments, light)

    everything = check_derivatives(value, (lobe_parameters(),))
    for cotangent in ((np.ones((2, 1, 3, 5)), np.zeros((2, 1, 3))), (np.zeros((2, 1, 3, 5)), np.ones((2, 1, 3)))):
        _, _, (slopes,) = everything((lobe_parameters(),), (lobe_parameters(),), cotangent)
        for slope in slopes.values():
            assert np.abs(slope).max() > 1e-3


def test_gradients_in_maps_albedo_and_light(exact):
    """Of coefficients and of light terms, whose gradient in the light is the transpose."""
    bits, frames, directions = exact
    maps, views = np.asarray(reflection_for("maps", 2, np.float64).light_maps), views_for(2)
    albedo, light = np.array([0.2, 0.5, 0.9]), np.random.default_rng(4).uniform(size=(D, 3))
    both = np.concatenate([INDICES, INDICES + 1], axis=1) % D

    def value(maps, albedo, light):
        lobes = (lobe_parameters()[name][:0] for name in ("C", "exponent", "scale"))
        factors, diffuse = Factored(maps, maps), FixedView(LobeSum(albedo, *lobes), jnp.asarray(views))  # pyright: ignore[reportArgumentType]
        return {
            side: (
                bake.bake_kept(bits, frames, reflection, directions, HaarFaces(N), jnp.asarray(indices)),
                bake.bake_and_apply(bits, frames, reflection, directions, light),
            )
            for side, reflection, indices in (("maps", factors, both), ("diffuse", diffuse, INDICES))
        }

    arguments = maps, albedo, light
    everything = check_derivatives(value, arguments)
    radiance = np.random.default_rng(5).normal(size=(2, 2, 3))
    cotangent = {
        "maps": (np.zeros((2, 2, 3, 5)), radiance),
        "diffuse": (np.zeros((2, 1, 3, 5)), np.zeros((2, 1, 3))),
    }
    _, _, gradients = everything(arguments, arguments, cotangent)
    back = bake.bake_and_transpose(bits, frames, reflection_for("maps", 2, np.float64), directions, radiance)
    np.testing.assert_allclose(gradients[2], back, rtol=1e-12, atol=1e-14)


def test_gradients_are_finite_for_tight_lobes_and_grazing_views():
    """Exponents up to 16600 in the peak form, an eye at and below the horizon, no light at all."""
    m = 4
    views = np.array([[0, 0, 1], [1, 0, 1e-7], [1, 0, 0], [0.6, 0, -0.8]], np.float32)
    bits, frames, directions = bits_for(m), frames_for(m), directions_for(N)

    def total(brdf, light):
        return jnp.sum(bake.bake_and_apply(bits, frames, FixedView(brdf, jnp.asarray(views)), directions, light) ** 2)

    slopes = jax.jit(jax.grad(total, argnums=(0, 1)))
    brdf = lobe_sum(0.0, [lobe([-0.577, -0.577, 0.577], n, peak=1) for n in (0, 0.5, 50, 1e4, 16600)])
    for light in (np.zeros((D, 3), np.float32), np.full((D, 3), 1e5, np.float32)):
        for slope in jax.tree.leaves(slopes(brdf, light)):
            assert np.isfinite(slope).all()
