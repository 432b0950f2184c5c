"""Laws at their extremes: bases, truncation, furnaces, linear operators, BRDFs and their gradients."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Part, Scene
from jaxrelight.basis import cubemap
from jaxrelight.brdf.alternating import refactored
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.sampling import directional_albedo
from tests.basis.test_haar import faces, forward, inverse, pyramid
from tests.basis.test_truncation import SHAPES, keep_largest, random_rows, written_out
from tests.brdf.test_lobes import EXPONENTS, PAIRS, at, hemisphere
from tests.extremes.scenes import METHODS, ONE, ball, plain
from tests.operators.test_operators import CASES, ask, both, case, random, relative
from tests.scenes import inside_out

quick = pytest.mark.quick


# ---- bases -----------------------------------------------------------------------------------------------------------


@quick
@pytest.mark.parametrize("resolution", [1, 2, 3, 4, 7, 16, 64, 128])
def test_solid_angles_sum_to_the_sphere(holds, resolution):
    angles = cubemap.solid_angles(resolution)
    assert angles.shape == (6 * resolution**2,)
    assert angles.min() > 0
    holds(f"solid angles, {resolution}², double", abs(angles.sum() - 4 * np.pi), 1e-12)
    single = angles.astype(np.float32).sum(dtype=np.float32)
    holds(f"solid angles, {resolution}², single", abs(single / (4 * np.pi) - 1), 1e-6)


@quick
@pytest.mark.parametrize("n", [1, 2, 4, 16, 64])
def test_haar_coefficients_are_those_of_pywavelets(holds, n):
    data = faces(n, 3).astype(np.float32)
    coefficients = forward(data)
    assert coefficients.dtype == np.float32
    expected = np.stack([pyramid(face) for face in data.astype(float)])
    holds(f"Haar, {n}²: PyWavelets", np.abs(coefficients - expected).max() / np.abs(expected).max(), 1e-6)


@quick
@pytest.mark.parametrize("n", [1, 4, 64])
def test_haar_round_trips_keep_values_and_energy(holds, n):
    data = faces(n, 2, 3).astype(np.float32)
    coefficients, largest = forward(data), np.abs(data).max()
    holds(f"Haar, {n}²: round trip", np.abs(inverse(coefficients) - data).max() / largest, 1e-6)
    holds(f"Haar, {n}²: round trip back", np.abs(forward(inverse(data)) - data).max() / largest, 1e-6)
    energy, kept = (np.sum(np.asarray(of, float) ** 2, axis=(-1, -2)) for of in (data, coefficients))
    holds(f"Haar, {n}²: Parseval", np.abs(kept / energy - 1).max(), 1e-6)


# ---- truncation ------------------------------------------------------------------------------------------------------


@quick
@pytest.mark.parametrize(("r", "c", "d", "count"), SHAPES)
def test_squared_error_is_the_dropped_energy(holds, r, c, d, count):
    rows = random_rows(r, c, d)
    kept = keep_largest(rows, count)
    error = np.sum((rows - written_out(kept, d)) ** 2, axis=-1)
    total = np.sum(rows.astype(float) ** 2, axis=-1)
    holds(f"truncation, {count} of {d}: dropped energy", np.abs(kept.dropped / error - 1).max(), 1e-5)
    holds(f"truncation, {count} of {d}: total energy", np.abs(kept.total / total - 1).max(), 1e-5)


@quick
@pytest.mark.parametrize(("r", "c", "d", "count"), SHAPES)
def test_relit_error_is_bounded_under_any_light(holds, r, c, d, count):
    """Random lights, and the worst of each row, which is what was dropped, and reaches the bound."""
    rows = random_rows(r, c, d)
    kept = keep_largest(rows, count)
    left, bound = rows - written_out(kept, d), np.sqrt(np.asarray(kept.dropped, float))
    lights = np.concatenate([np.random.default_rng(1).normal(size=(20, d)), left.reshape(-1, d)])
    share = np.abs(left @ lights.T) / (np.linalg.norm(lights, axis=1) * bound[..., None])
    holds(f"truncation, {count} of {d}: beyond the bound", share.max() - 1, 1e-5)
    worst = share.reshape(r * c, -1)[np.arange(r * c), 20 + np.arange(r * c)]
    np.testing.assert_allclose(worst, 1, rtol=1e-5)


# ---- furnaces --------------------------------------------------------------------------------------------------------


def bowl() -> Scene:
    """A white ball alone."""
    scene = ball(jr.lambert(1.0))
    return dataclasses.replace(scene, parts=scene.parts[1:])


@pytest.mark.parametrize("receivers", ["pixels", "vertices"])
@pytest.mark.parametrize("scene", [lambda: plain(jr.lambert(1.0)), bowl], ids=["plain", "ball"])
def test_white_surfaces_under_constant_light_are_white(holds, scene, receivers, tmp_path):
    """At default dials; and with all coefficients, where only rays between texels are missed."""
    for coefficients, limit in (("shared", 5e-3), ("all", 5e-3)):
        dials = jr.Transport(receivers, coefficients=coefficients)
        image = jr.prepare(scene(), dials, tmp_path / coefficients).picture(ONE, background=False)
        shown = image[image[..., 3] > 0][:, :3]
        holds(f"{receivers}: white under constant light, {coefficients} coefficients", np.abs(shown - 1).max(), limit)


def box() -> Scene:
    """A closed box of albedo 0.5 that emits 0.5 from all of it: what arrives anywhere is 1 in the end."""
    wall = jr.lambert(0.5)
    parts = [Part(inside_out(jr.box((1, 1, 1), 6)), "wall")]
    camera = jr.Camera((0.1, 0.05, 0.2), (-0.5, -0.1, -0.3), fov_y=80, width=12, height=12)
    return Scene(parts, {"wall": jr.Material((jr.Component(wall),), emission=np.full(3, 0.5, np.float32))}, camera)


@pytest.mark.parametrize(
    ("method", "dials"),
    [
        ("pixels", jr.Transport("pixels", resolution=16, bounces=12)),
        ("vertices", jr.Transport("vertices", receiver_tolerance=0, resolution=16, bounces=12)),
        ("indirect", jr.Indirect(gather_samples=4096, bounces=12)),
    ],
)
def test_a_closed_box_ends_at_its_series(holds, method, dials, tmp_path):
    """L = E/(1 − ρ); points of a cloud stand for surfaces, so that some is lost as near to edges as they are apart."""
    image = jr.prepare(box(), dials, tmp_path).picture()[..., :3]
    holds(f"{method}: a closed box of albedo 0.5", abs(image.mean() - 1), 0.025)
    limit = 0.25 if method == "indirect" else 0.025
    holds(f"{method}: a closed box of albedo 0.5, its worst pixel", np.abs(image - 1).max(), limit)


# ---- linear operators ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_operators_are_linear_and_have_their_adjoints(holds, name):
    operator, _ = case(name)
    r, d, _ = operator.shape
    x1, x2, y = random(d, 3), random(d, 3, seed=1), random(r, 3, seed=2)
    answers = [ask(both, operator, x, y) for x in (x1, x2, np.float32(2) * x1 - np.float32(0.5) * x2)]
    one, two, three = (forth.astype(float) for forth, _ in answers)
    holds(f"{name}: linearity", relative(three, 2.0 * one - 0.5 * two), 1e-6)
    back = answers[0][1].astype(float)
    off = abs(float(np.vdot(one, y)) - float(np.vdot(x1, back)))
    holds(f"{name}: adjoint", off / (np.linalg.norm(one) * np.linalg.norm(y)), 1e-6)


# ---- BRDFs -----------------------------------------------------------------------------------------------------------

BRDFS = {
    "Lambert": jr.lambert(0.5),
    "Phong": jr.phong(0.2, 0.7, 100),
    "Lafortune": jr.lobe_sum(0.1, [jr.lobe([-1.2, -0.3, 0.6], 30, peak=2)]),
    "Ashikhmin–Shirley": jr.ashikhmin_shirley(0.3, 0.5, 200.0, 20.0),
}


@quick
@pytest.mark.parametrize("name", BRDFS)
def test_reciprocity(holds, name):
    omega_i, omega_o = hemisphere(200), hemisphere(200, 1)
    one, other = at(BRDFS[name], omega_i, omega_o), at(BRDFS[name], omega_o, omega_i)
    holds(f"{name}: reciprocity", np.abs(one - other).max() / np.abs(one).max(), 1e-6)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_phong_reflects_no_more_than_it_gets(holds, exponent):
    """From the normal to grazing angles."""
    cosine = np.linspace(0.001, 1, 16)
    views = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], axis=1).astype(np.float32)
    # Cells are narrower than the sharpest lobe.
    rings = 64 if exponent < 100 else 1024
    albedos = jax.jit(lambda views: jax.lax.map(lambda view: directional_albedo(brdf, view, rings, 2 * rings), views))
    brdf = jr.phong(0.0, 1.0, exponent)
    albedo = albedos(views)
    holds(f"Phong of exponent {exponent:g}: directional albedo", np.max(albedo), 1.01)


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_values_and_gradients_of_lobes_are_finite(holds, derivative):
    """One lobe for each exponent, at the normal, at grazing angles and where the dot product is 0 or negative."""

    def values(parameters, omega_i, omega_o):
        return LobeSum(*parameters).evaluate(omega_i, omega_o)

    slope = jax.jit(jax.vmap(derivative(values, argnums=(0, 1, 2)), in_axes=(None, 0, 0)))
    for C in ([-0.577, -0.577, 0.577], [0.0, 0.0, 1.0], [1.3, -0.2, 0.7]):
        brdf = jr.lobe_sum(0.5, [jr.lobe(C, n, peak=[1, 2, 3]) for n in EXPONENTS])
        parameters = brdf.diffuse, brdf.C, brdf.exponent, brdf.scale
        assert np.isfinite(at(brdf, PAIRS[:, 0], PAIRS[:, 1])).all()
        slopes = slope(parameters, *PAIRS.astype(np.float32).swapaxes(0, 1))
        largest = max(np.abs(one).max() for one in map(np.asarray, jax.tree.leaves(slopes)))
        holds(f"lobes with C = {C}: largest slope, {derivative.__name__}", largest, 1e8)


def test_gradients_at_equal_singular_values_are_finite(holds):
    """Of factors of Phong, whose singular values come in pairs."""
    brdf = jr.phong(0.2, 0.5, 8.0)
    start = factor(brdf, 3, 12)

    def energy(exponent):
        again = refactored(LobeSum(brdf.diffuse, brdf.C, exponent, brdf.scale), start)
        return jnp.sum(again.light_maps**2) + jnp.sum(again.view_maps**2)

    slope = jax.grad(energy)(jnp.asarray(brdf.exponent))
    holds("equal singular values: largest slope", np.abs(slope).max(), 1e6)


def test_gradients_at_a_light_and_under_a_black_sky_are_finite(holds, tmp_path):
    """At no distance from a lamp, and in texels that are black."""
    at_lamp = jax.grad(lambda place: jnp.sum(jr.point(place, 1.0).at(jnp.zeros((1, 3))).omega_i))(jnp.zeros(3))
    holds("at a lamp: largest slope", np.abs(at_lamp).max(), 1e3)
    relighter = jr.prepare(ball(), METHODS["vertices"], tmp_path)
    view, black = relighter.view(), jr.environment(np.zeros((16, 32, 3), np.float32))
    bright = jax.grad(lambda sky: jnp.mean(relighter.shade(relighter.light(sky), view).radiance))(black)
    holds("a black sky: largest slope", max(np.abs(slope).max() for slope in jax.tree.leaves(bright)), 1e3)


def test_one_bad_pixel_leaves_other_gradients_unchanged(holds, tmp_path):
    """Zeroed and counted, and with no slope that is not finite."""
    pixels = np.random.default_rng(0).uniform(0.2, 1, (16, 32, 3)).astype(np.float32)
    relighter = jr.prepare(ball(), METHODS["vertices"], tmp_path)
    view = relighter.view()

    def slopes(given):
        sky = jr.environment(given, zero_nonfinite=True)
        assert given is pixels or any("1 NaN or infinite" in note for note in sky.notes)
        bright = jax.grad(lambda one: jnp.mean(relighter.shade(relighter.light(one), view).radiance))(sky)
        return np.asarray(bright.pixels)

    bad = pixels.copy()
    bad[3, 5] = np.nan
    one, other = slopes(pixels), slopes(bad)
    others = np.ones((16, 32), bool)
    others[3, 5] = False
    holds("a pixel that is NaN: others' slopes", np.abs(one - other)[others].max() / np.abs(one).max(), 1e-6)
