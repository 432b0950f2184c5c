"""Estimates by work in batches: closed forms, laws, the same for the same seed, gradients."""

import functools
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight import (
    Camera,
    Part,
    Prefiltered,
    Scene,
    ashikhmin_shirley,
    environment,
    lambert,
    lobe,
    lobe_sum,
    phong,
    plane,
    prepare,
    sphere,
)
from jaxrelight.basis import latlong
from jaxrelight.brdf.half_sampling import half_vectors
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.sampling import directional_albedo
from jaxrelight.lighting.adaptive import estimate as estimating
from jaxrelight.lighting.adaptive.estimate import RUN, estimate, estimate_listed, list_work
from jaxrelight.lighting.adaptive.sampled_brdf import SampledBrdf, sampled
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lights.environment_mipmap import EnvironmentMipmap, cells, environment_mipmap
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.random_numbers import MAX_POINTS

CAMERA = Camera((0.2, 1.2, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 40.0, 12, 10)
# All maps have one size, and most BRDFs one lobe: what is compiled for one of them serves the others.
ROWS = 64
GLOSSY, MATT = phong(0.2, 0.5, 40), phong(0.5, 0, 1)


@pytest.fixture(autouse=True)
def _small_batches(monkeypatch):
    """For few pixels: most of a large batch would be padding."""
    monkeypatch.setattr(estimating, "_BATCH", 1024)


class View(NamedTuple):
    pixels: SurfacePixels
    real: np.ndarray


def seen_of(part: Part) -> SurfacePixels:
    """The pixels that see it."""
    scene = Scene([part], {"skin": lambert(0.5)}, CAMERA)
    return prepare(scene, Prefiltered(occlusion_resolution=0)).view().parts[0].pixels


@functools.cache
def view() -> View:
    pixels = seen_of(Part(sphere(1, 24), "skin"))
    return View(pixels, np.asarray(pixels.pixel) < CAMERA.width * CAMERA.height)


@functools.cache
def sky(constant: bool = False) -> EnvironmentMipmap:
    return light_of(np.ones((8, 16, 3)) if constant else np.random.default_rng(0).random((8, 16, 3)) ** 4)


def light_of(pixels: np.ndarray) -> EnvironmentMipmap:
    times = ROWS // len(pixels)
    return environment_mipmap(environment(np.kron(pixels, np.ones((times, times, 1))).astype(np.float32)))


def counts(of: int) -> np.ndarray:
    return np.where(view().real, of, 0)


def test_lambert_under_a_constant_sky_is_exact():
    radiance = estimate(sampled(lambert(0.6)), sky(True), view().pixels, counts(RUN))
    np.testing.assert_allclose(np.asarray(radiance)[view().real], 0.6, rtol=1e-5)
    assert not np.asarray(radiance)[~view().real].any()


LOBES = {
    "one": GLOSSY,
    "turned": lobe_sum(0.1, [lobe([-1, -0.3, 0.8], 8, peak=1), lobe([-1, -1, 1], 3, peak=0.2)], turn=0.7),
    "by channel": lobe_sum([0.1, 0.2, 0.3], [lobe(-np.eye(3) + 0.1, [5, 10, 2.5], peak=[0.2, 0.5, 0.3])]),
    "two": lobe_sum([0.1, 0.2, 0.3], [lobe([-1, -1, 1], 40, peak=1), lobe([-0.98, -0.98, 1], 400, peak=3)]),
}


def written_out(brdf: LobeSum) -> LobeSum:
    """The same, as two turned lobes of each channel."""
    lobes = len(brdf.scale)
    more = (0, 2 - lobes), (0, 0)
    C, exponent = np.broadcast_to(brdf.C, (lobes, 3, 3)), np.broadcast_to(brdf.exponent, (lobes, 3))
    padded = [np.pad(of, [*more, (0, 0)][: of.ndim]) for of in (C, exponent, np.asarray(brdf.scale))]
    turn = np.float32(0) if brdf.turn is None else brdf.turn
    return LobeSum(brdf.diffuse, *map(as_array, (*padded, turn)))


@jax.jit
def albedos(brdf, omega_o):
    return jax.vmap(lambda one: directional_albedo(brdf, one, 256, 256))(omega_o)


@pytest.mark.parametrize("name", LOBES)
def test_under_a_white_sky_they_are_the_albedo(name: str):
    """By another quadrature: nothing is lost of what lies below the surface, of turned lobes or of channels."""
    brdf = LOBES[name] if name == "one" else written_out(LOBES[name])
    radiance = np.asarray(estimate(sampled(brdf), sky(True), view().pixels, counts(1024)))[view().real]
    wanted = albedos(brdf, np.asarray(view().pixels.omega_o)[view().real])
    np.testing.assert_allclose(radiance, wanted, rtol=0.01)


@pytest.mark.parametrize("brdf", [GLOSSY, pytest.param(ashikhmin_shirley(0.2, 0.4, 30, 30), marks=pytest.mark.slow)])
def test_filtered_or_not_many_samples_agree(brdf):
    part = sampled(brdf)
    one = np.asarray(estimate(part, sky(), view().pixels, counts(4096), filtered=False))
    other = np.asarray(estimate(part, sky(), view().pixels, counts(4096), 1))
    np.testing.assert_allclose(other, one, atol=0.02 * one.max())
    few = np.asarray(estimate(part, sky(), view().pixels, counts(64)))
    rough = np.asarray(estimate(part, sky(), view().pixels, counts(64), filtered=False))
    assert np.abs(few - one).mean() < np.abs(rough - one).mean()


def test_seeds_and_counts():
    part, pixels = sampled(GLOSSY), view().pixels
    one = np.asarray(estimate(part, sky(), pixels, counts(32), 5))
    np.testing.assert_array_equal(estimate(part, sky(), pixels, counts(32), 5), one)
    assert np.abs(np.asarray(estimate(part, sky(), pixels, counts(32), 6)) - one).max() > 0
    # A pixel's estimate is its own, whatever others get.
    mixed = np.where(view().real, np.arange(len(view().real)) % 4 * RUN, 0)
    radiance = np.asarray(estimate(part, sky(), pixels, mixed, 5))
    np.testing.assert_allclose(radiance[mixed == 2 * RUN], one[mixed == 2 * RUN], rtol=1e-5)
    assert not radiance[mixed == 0].any()
    # More than there are numbers count as those.
    few = np.where(np.arange(len(view().real)) == np.flatnonzero(view().real)[0], 2 * MAX_POINTS, 0)
    assert np.isfinite(estimate(part, sky(), pixels, few)).all()


def test_linear_in_light():
    part = sampled(GLOSSY)
    double = eqx.tree_at(lambda light: light.radiance.values, sky(), 2 * np.asarray(sky().radiance.values))
    one, two = (np.asarray(estimate(part, light, view().pixels, counts(32))) for light in (sky(), double))
    np.testing.assert_allclose(two, 2 * one, rtol=1e-5)


def test_a_sun_of_a_hundred_thousand_is_not_lost():
    """One texel holds nearly all light: 64 samples would meet it in one pixel of twenty."""
    pixels = np.full((ROWS, 2 * ROWS, 3), 0.1, np.float32)
    pixels[12, 40] = 1e5
    # Samples alone: pyramids split suns off.
    light = eqx.tree_at(lambda of: of.radiance, light_of(0 * pixels), cells(pixels))
    part = sampled(MATT)
    towards = latlong.directions(np.array(40.5 / (2 * ROWS)), np.array(12.5 / ROWS))
    cosine = np.asarray(view().pixels.frame)[:, 2] @ towards
    irradiance = np.pi * 0.1 + 1e5 * latlong.solid_angles(ROWS, 2 * ROWS)[12] * cosine
    lit = view().real & (cosine > 0.3)
    for filtered, most in ((True, 0.5), (False, np.inf)):
        radiance = np.asarray(estimate(part, light, view().pixels, counts(64), filtered=filtered))[lit, 0]
        assert np.isfinite(radiance).all()
        off = np.median(np.abs(radiance * (np.pi / 0.5) / irradiance[lit] - 1))
        assert off < most
        assert filtered or off > 0.9


def test_what_is_blocked_is_dark():
    part, pixels = sampled(MATT), view().pixels
    asked = []

    def blocked(place, towards):
        asked.append(len(place))
        assert np.allclose(np.linalg.norm(towards, axis=1), 1, atol=1e-5)
        return towards[:, 1] < 0

    shadowed = np.asarray(estimate(part, sky(True), pixels, counts(RUN), blocked=blocked))
    free = np.asarray(estimate(part, sky(True), pixels, counts(RUN)))
    assert (shadowed <= free + 1e-6).all()
    assert 0 < shadowed.sum() < free.sum()
    assert sum(asked) <= RUN * view().real.sum()
    dark = estimate(part, sky(True), pixels, counts(RUN), blocked=lambda place, _: np.ones(len(place), bool))
    assert not np.asarray(dark).any()


def below(_, towards: np.ndarray) -> np.ndarray:
    """Hides what comes from below the horizon."""
    return towards[:, 1] < 0


@pytest.mark.slow
def test_listed_work_is_what_is_estimated_at_once():
    """With its rays cast before; of pixels that have none, and of more batches than one."""
    part, pixels = sampled(GLOSSY), view().pixels
    mixed = np.where(view().real, np.arange(len(view().real)) % 4 * 64 * RUN, 0)
    for blocked in (None, below):
        wanted = np.asarray(estimate(part, sky(), pixels, mixed, 5, blocked=blocked))
        work = list_work(part, pixels, mixed, 5, blocked)
        assert len(work.place) > 1
        np.testing.assert_allclose(estimate_listed(part, sky(), pixels, work, 5), wanted, rtol=1e-5, atol=1e-6)
    assert not np.asarray(estimate_listed(part, sky(), pixels, list_work(part, pixels, 0 * mixed), 5)).any()


@pytest.mark.slow
def test_listed_work_is_linear_in_light_inside_of_jit():
    """So the gradient along the light is the sum itself; outside of jit, where rays are cast on the way, too."""
    part, pixels = sampled(MATT), view().pixels
    work = list_work(part, pixels, counts(RUN), blocked=below)

    def lit(values) -> EnvironmentMipmap:
        return eqx.tree_at(lambda of: of.radiance.values, sky(), values)

    def listed(values):
        return jnp.sum(estimate_listed(part, lit(values), pixels, work))

    def at_once(values):
        return jnp.sum(estimate(part, lit(values), pixels, counts(RUN), blocked=below))

    values = sky().radiance.values
    for total in (jax.jit(jax.value_and_grad(listed)), jax.value_and_grad(at_once)):
        value, gradient = total(values)
        along = np.sum(np.asarray(gradient) * np.asarray(values))
        np.testing.assert_allclose([value, along], at_once(values), rtol=1e-4)


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
def test_gradients_are_those_of_differences():
    """In the sky's pixels and in a BRDF, while samples stand still."""
    floor = seen_of(Part(plane([4, 4]), "skin"))
    wide = [np.asarray(x) for x in jax.tree.leaves(floor)]
    wide = [x.astype(np.float64 if x.dtype == np.float32 else x.dtype) for x in wide]
    pixels = jax.tree.unflatten(jax.tree.structure(floor), wide)
    number = np.zeros(len(pixels.pixel), int)
    number[:6] = RUN
    base = np.random.default_rng(0).random((8, 16, 3))
    light = environment_mipmap(environment(base))
    base_brdf = phong(0.2, 0.5, 20.0)
    half = half_vectors(base_brdf)

    @jax.jit
    @functools.partial(jax.value_and_grad, argnums=(0, 1, 2, 3))
    def total(sky, diffuse, scale, exponent):
        brdf = LobeSum(diffuse, base_brdf.C, exponent, scale)
        lit = eqx.tree_at(lambda of: of.radiance, light, cells(sky))
        return jnp.sum(estimate(SampledBrdf(brdf, half), lit, pixels, number))

    parameters = (base_brdf.diffuse, base_brdf.scale, base_brdf.exponent)
    given = [np.asarray(x, np.float64) for x in (base, *parameters)]
    _, gradients = total(*given)
    rng = np.random.default_rng(1)
    for k, gradient in enumerate(gradients):
        way = rng.normal(size=given[k].shape)
        one, other = (
            total(*[x + (sign * 1e-4 * way if i == k else 0) for i, x in enumerate(given)])[0] for sign in (1, -1)
        )
        np.testing.assert_allclose(np.sum(gradient * way), (one - other) / 2e-4, rtol=1e-5, atol=1e-7)


def test_cells_are_as_large_as_what_samples_stand_for(monkeypatch):
    """Far larger ones blur, and far smaller ones are noisy."""
    light, part = light_of(np.random.default_rng(2).random((8, 16, 3)) ** 4), sampled(phong(0.0, 0.5, 40))
    wanted = np.asarray(estimate(part, light, view().pixels, counts(MAX_POINTS), 1))
    covered, compiled, off = estimating._COVERED, cast(Any, estimating._added), []
    for share in (1, 8, 1 / 64):
        monkeypatch.setattr(estimating, "_COVERED", covered * share)
        if share != 1:
            compiled.clear_cache()
        radiance = np.asarray(estimate(part, light, view().pixels, counts(64)))
        off.append(np.sqrt(np.mean((radiance - wanted)[view().real] ** 2)))
    compiled.clear_cache()
    assert 1.3 * off[0] < min(off[1:])
