"""Separable factors: exact where they can be, optimal elsewhere."""

import functools
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf import factors as module
from jaxrelight.brdf import nonnegative
from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored, Symmetric
from jaxrelight.brdf.factors import COSINE, factor
from jaxrelight.brdf.files import load_brdf
from jaxrelight.brdf.lobes import lambert, lobe, lobe_sum
from jaxrelight.brdf.parametrisation import DISC, POLAR
from jaxrelight.brdf.sampling import directional_albedo
from jaxrelight.brdf.separable import separable
from jaxrelight.brdf.singular import largest_singular
from jaxrelight.errors import InputError
from tests.shared_data import shared

SIDE = 8


@functools.cache
def disc(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions through the texel centres inside the unit disc, and which texels those are."""
    centre = (np.arange(side) + 0.5) * 2 / side - 1
    x, y = (grid.ravel() for grid in np.meshgrid(centre, centre))
    inside = x * x + y * y < 1
    z = np.sqrt(np.maximum(0, 1 - x * x - y * y))
    return np.stack([x, y, z], axis=-1)[inside], inside


# Directions and terms that one call takes: with these there is one program for each kind of BRDF or map.
COUNT, TERMS = 64, 8


@jax.jit
def _evaluate(brdf, omega_i, omega_o):
    over_o = jax.vmap(brdf.evaluate, in_axes=(None, 0))
    return jax.vmap(over_o, in_axes=(0, None))(omega_i, omega_o)


@jax.jit
def _look_up(factors, omega):
    return jax.vmap(factors.light_side)(omega), jax.vmap(factors.view_side)(omega)


def _padded(array, multiple: int) -> np.ndarray:
    """Single precision, with zeros behind the last entry."""
    array = np.asarray(array, np.float32)
    return np.pad(array, [(0, -len(array) % multiple)] + [(0, 0)] * (array.ndim - 1))


def evaluate(brdf, omega_i, omega_o) -> np.ndarray:
    """All pairs [i, o, c] of no more than `COUNT` directions."""
    pairs = _evaluate(brdf, _padded(omega_i, COUNT), _padded(omega_o, COUNT))
    return np.asarray(pairs, float)[: len(omega_i), : len(omega_o)]


def sampled(brdf, side: int) -> np.ndarray:
    """The BRDF between all directions of the disc: [i, o, c]."""
    return evaluate(brdf, disc(side)[0], disc(side)[0])


def sides(factors: Factored | Symmetric, omega) -> tuple[np.ndarray, np.ndarray]:
    """Light and view side [direction, k, c] by look-up."""
    omega, count, terms = _padded(omega, COUNT), len(omega), factors.terms
    leaves, structure = jax.tree.flatten(factors)
    leaves = [_padded(leaf, TERMS) for leaf in leaves]
    columns = []
    for k in range(0, terms, TERMS):
        part = jax.tree.unflatten(structure, [leaf[k : k + TERMS] for leaf in leaves])
        rows = [_look_up(part, omega[start : start + COUNT]) for start in range(0, len(omega), COUNT)]
        columns.append([np.concatenate(side) for side in zip(*rows, strict=True)])
    light, view = (np.concatenate(side, axis=1)[:count, :terms] for side in zip(*columns, strict=True))
    return light.astype(float), view.astype(float)


def product(factors: Factored | Symmetric, omega) -> np.ndarray:
    """Σ_k light_side · view_side between all given directions: [i, o, c]."""
    return np.einsum("ikc,okc->ioc", *sides(factors, omega))


# Two lobes in all that is sampled, so that programs are the same.
NO_LOBE = lobe([0, 0, 1], 1, peak=0)


def _phong(diffuse, specular, exponent):
    scale = (exponent + 2) / (2 * np.pi) * np.asarray(specular)
    return lobe_sum(diffuse, [lobe([-1, -1, 1], exponent, specular=scale), NO_LOBE])


GLOSSY = _phong([0.2, 0.1, 0.3], [0.5, 0.4, 0.6], 8)


def test_a_constant_brdf_is_one_texel_and_exact():
    factors = factor(lambert([0.2, 0.5, 0.9]), terms=4, resolution=48)
    assert factors.light_maps.shape == (1, 1, 1, 1)
    assert factors.view_maps.shape == (1, 3, 1, 1)
    assert (factors.terms, factors.channels) == (1, 1)
    omega = np.concatenate([disc(4)[0], [[1, 0, 0], [0, -1, 0]]])
    light, view = sides(factors, omega)
    expected = np.broadcast_to(np.array([0.2, 0.5, 0.9], np.float32) / np.float32(np.pi), (len(omega), 1, 3))
    np.testing.assert_allclose(light * view, expected, rtol=2e-7)


def test_the_error_is_that_of_the_best_approximation():
    """By Eckart and Young: the sum of the squared singular values that are left out."""
    matrix = sampled(GLOSSY, SIDE)
    sigma = np.stack([np.linalg.svd(matrix[..., c], compute_uv=False) for c in range(3)])
    errors = []
    for terms in (1, 2, 4, 9):
        factors = factor(GLOSSY, terms, SIDE, cosine=(0, 0))
        assert factors.terms == terms
        assert factors.channels == 3
        error = np.sum((product(factors, disc(SIDE)[0]) - matrix) ** 2, axis=(0, 1))
        np.testing.assert_allclose(error, np.sum(sigma[:, terms:] ** 2, axis=-1), rtol=1e-3)
        errors.append(error)
    assert (np.diff(errors, axis=0) < 0).all()


def test_all_terms_give_the_sampled_matrix_back():
    omega, _ = disc(SIDE)
    matrix = sampled(GLOSSY, SIDE)
    products = product(factor(GLOSSY, len(omega), SIDE), omega)
    np.testing.assert_allclose(products, matrix, atol=1e-5 * matrix.max())


def test_a_brdf_of_rank_two_needs_two_terms_everywhere():
    """diffuse/π + z_i z_o, also beyond the disc's edge, where maps are continued."""
    brdf = lobe_sum([0.3, 0.6, 0.9], [lobe([0, 0, 1], 1, peak=[1, 2, 3]), NO_LOBE])
    factors = factor(brdf, 2, 32)
    z = np.array([0.95, 0.8, 0.6])
    omega = np.stack([np.sqrt(1 - z * z), 0 * z, z], axis=-1)
    expected = np.array([0.3, 0.6, 0.9]) / np.pi + np.multiply.outer(np.multiply.outer(z, z), [1, 2, 3])
    np.testing.assert_allclose(product(factors, omega), expected, rtol=0.01)
    horizon = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0.6, 0.8, 0], [-0.8, 0.6, 0]])
    at_horizon = product(factors, horizon)
    assert np.isfinite(at_horizon).all()
    # Between the last texel inside and the edge, where z has its root, a bilinear look-up is off by some of a texel.
    np.testing.assert_allclose(at_horizon, np.broadcast_to(np.array([0.3, 0.6, 0.9]) / np.pi, (6, 6, 3)), atol=0.2)


def test_texels_beyond_the_edge_are_those_of_the_edge():
    """At the corner texel the product with any direction is the BRDF with the direction at the edge before it."""
    omega, inside = disc(SIDE)
    factors = factor(GLOSSY, len(omega), SIDE)
    edge = (1 - 0.1 / SIDE) * np.array([-1, -1]) / np.sqrt(2)
    corner = np.array([*edge, np.sqrt(1 - edge @ edge)])
    assert not inside[0]
    light = np.asarray(factors.light_maps, float)[:, :, 0, 0]
    view = np.asarray(factors.view_maps, float)[:, :, 0, 0]
    light_sides, view_sides = sides(factors, omega)
    expected = evaluate(GLOSSY, [corner], omega)[0]
    np.testing.assert_allclose(np.einsum("kc,okc->oc", light, view_sides), expected, atol=2e-4)
    np.testing.assert_allclose(np.einsum("ikc,kc->ic", light_sides, view), expected, atol=2e-4)


def test_light_and_view_maps_of_a_reciprocal_brdf_agree_up_to_sign():
    factors = factor(GLOSSY, 4, SIDE)
    light, view = np.asarray(factors.light_maps, float), np.asarray(factors.view_maps, float)
    for k, c in np.ndindex(4, 3):
        size = np.abs(light[k, c]).max()
        difference = min(np.abs(light[k, c] - sign * view[k, c]).max() for sign in (1, -1))
        assert difference < 1e-3 * size
    # The first one is positive by choice of sign.
    assert light[0].min() > 0
    assert view[0].min() > 0


def test_channels_alike_have_maps_alike():
    factors = factor(_phong(0.2, 0.5, 8), 3, SIDE)
    light, view = np.asarray(factors.light_maps), np.asarray(factors.view_maps)
    np.testing.assert_array_equal(light[:, 0], light[:, 1])
    np.testing.assert_array_equal(view[:, 0], view[:, 2])


def test_look_up_is_bilinear():
    """Exact at texel centres, in the order y, x; the mean half-way between them."""
    side = 4
    maps = np.arange(2.0 * 3 * side * side).reshape(2, 3, side, side)
    factors = Factored(maps, -maps)  # pyright: ignore[reportArgumentType]
    centre = (np.arange(side) + 0.5) * 2 / side - 1
    omega = np.array([[x, y, 0.1] for y in centre for x in centre])
    light, view = sides(factors, omega)
    np.testing.assert_allclose(light, maps.reshape(2, 3, -1).transpose(2, 0, 1), atol=1e-5)
    np.testing.assert_allclose(view, -light, atol=1e-5)
    light, _ = sides(
        factors, [[(centre[1] + centre[2]) / 2, centre[3], 0], [centre[0], (centre[0] + centre[1]) / 2, 0]]
    )
    expected = [(maps[:, :, 3, 1] + maps[:, :, 3, 2]) / 2, (maps[:, :, 0, 0] + maps[:, :, 1, 0]) / 2]
    np.testing.assert_allclose(light, expected, atol=1e-5)


def test_look_up_at_the_horizon_stays_inside_the_map():
    maps = np.arange(1.0, 17).reshape(1, 1, 4, 4) * np.ones((1, 3, 1, 1))
    factors = Factored(maps, maps)  # pyright: ignore[reportArgumentType]
    light, _ = sides(factors, [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [1, 1, 0], [-1, -1, 0]])
    for channel in range(3):
        np.testing.assert_allclose(light[:, 0, channel], [10, 7, 14.5, 2.5, 16, 1], atol=1e-5)


def test_look_up_has_gradients_in_maps_and_direction():
    maps = np.random.default_rng(0).normal(size=(2, 3, 5, 5)).astype(np.float32)

    def total(maps, omega):
        return jnp.sum(Factored(maps, maps).light_side(omega))

    slopes = jax.jit(jax.grad(total, argnums=(0, 1)))
    for omega in ([0.13, -0.44, 0.5], [1.0, 0, 0], [0, 0, 1.0]):
        for slope in map(np.asarray, slopes(maps, np.asarray(omega, np.float32))):
            assert np.isfinite(slope).all()
            assert np.abs(slope).max() > 0


@pytest.mark.parametrize("terms", [0, -1, 10**6])
def test_an_impossible_number_of_terms_is_refused(terms):
    with pytest.raises(InputError, match=f"{terms} terms cannot be had"):
        factor(GLOSSY, terms, SIDE)


ONE = jnp.asarray(np.ones((1, 1, 1, 1), np.float32))


def test_factors_are_shared_by_all_receivers():
    assert jax.tree.leaves(Factored(ONE, ONE).per_receiver) == [False, False]


FORMS = pytest.mark.parametrize("form", ["svd", "symmetric", "normalised"])
PARAMETRISATIONS = pytest.mark.parametrize("parametrisation", [DISC, POLAR], ids=["disc", "polar"])
# Tight in one direction, and with a base that is no constant.
ANISOTROPIC = lobe_sum(
    [0.1, 0.05, 0.2], [lobe([-1, -0.6, 0.7], 5, peak=[3, 2, 1]), lobe([0.1, 0.2, 1], 2, peak=[0.2, 0.7, 0.1])]
)


@FORMS
@PARAMETRISATIONS
@pytest.mark.parametrize("cosine", [(0, 0), (0.5, 0.5)])
def test_a_product_is_recovered_by_one_term(form, parametrisation, cosine):
    """f = 3 (z_i z_o)² is of rank one."""
    brdf = lobe_sum(0, [lobe([0, 0, 1], 2, peak=[3, 2, 1]), NO_LOBE])
    factors = factor(brdf, 1, SIDE, form=form, parametrisation=parametrisation, cosine=cosine)
    omega, inside = parametrisation.directions(SIDE)
    expected = np.multiply.outer(np.multiply.outer(omega[inside, 2] ** 2, omega[inside, 2] ** 2), [3, 2, 1])
    np.testing.assert_allclose(product(factors, omega[inside]), expected, atol=3e-4)


@pytest.mark.parametrize("form", ["svd", "symmetric"])
@PARAMETRISATIONS
@pytest.mark.parametrize("cosine", [(0, 0), (0.5, 0.5)])
def test_the_weighted_error_is_the_least_there_is(form, parametrisation, cosine):
    """Against NumPy's singular values of the weighted matrix, for every K."""
    omega, inside = parametrisation.directions(SIDE)
    omega, weight = omega[inside], np.sqrt(parametrisation.measure(SIDE)[inside])
    weights = [weight * omega[:, 2] ** power for power in cosine]
    exact = evaluate(ANISOTROPIC, omega, omega)
    matrix = exact * np.multiply.outer(*weights)[..., None]
    sigma = np.stack([np.linalg.svd(matrix[..., c], compute_uv=False) for c in range(3)])
    errors = []
    for terms in (1, 3, 8):
        products = product(
            factor(ANISOTROPIC, terms, SIDE, form=form, parametrisation=parametrisation, cosine=cosine), omega
        )
        error = np.sum((products - exact) ** 2 * np.multiply.outer(*weights)[..., None] ** 2, axis=(0, 1))
        np.testing.assert_allclose(error, np.sum(sigma[:, terms:] ** 2, axis=-1), rtol=5e-3)
        errors.append(error)
    assert (np.diff(errors, axis=0) < 0).all()


def test_by_default_some_of_the_cosine_is_folded_in_and_light_and_view_are_alike():
    assert COSINE[0] == COSINE[1]
    given = factor(ANISOTROPIC, 3, SIDE, cosine=COSINE)
    np.testing.assert_array_equal(given.light_maps, factor(ANISOTROPIC, 3, SIDE).light_maps)
    plain = np.asarray(factor(ANISOTROPIC, 3, SIDE, cosine=(0, 0)).light_maps)
    assert np.abs(np.asarray(given.light_maps) - plain).max() > 0.1


def _made_paint():
    """As measured ones are, it is large at grazing angles."""
    return ashikhmin_shirley(0.02, 0.2, 60, 60)


def _measured_paint():
    return load_brdf(shared("data", "brdf", "rgl_cc_ibiza_sunset_rgb.bsdf")).brdf


@pytest.mark.parametrize(
    ("paint", "side"), [(_made_paint, 16), pytest.param(_measured_paint, 24, marks=pytest.mark.slow)]
)
def test_by_default_a_paint_keeps_its_light(paint, side):
    """It is largest at grazing angles, which took all terms if they counted as much as they are large."""
    brdf, omega_o = paint(), np.asarray([0.48, 0, 0.8773], np.float32)
    approximations = (separable(factor(brdf, 4, side, cosine=(0.25, 0.25))), separable(factor(brdf, 4, side)))
    whole, plain, few = (np.asarray(directional_albedo(one, omega_o))[0] for one in (brdf, *approximations))
    assert plain < 0.01 * whole
    assert 0.7 * whole < few < 1.3 * whole


def test_folding_the_cosine_in_lowers_the_error_that_it_weighs():
    omega, _ = disc(SIDE)
    exact, cosine = sampled(ANISOTROPIC, SIDE), omega[:, 2]

    def errors(powers):
        apart = product(factor(ANISOTROPIC, 2, SIDE, cosine=powers), omega) - exact
        return np.array([np.linalg.norm(apart), np.linalg.norm(apart * cosine[:, None, None])])

    plain, folded = errors((0, 0)), errors((1, 0))
    assert plain[0] < folded[0]
    assert folded[1] < plain[1]


@PARAMETRISATIONS
def test_the_symmetric_form_is_reciprocal_between_any_directions(parametrisation):
    vectors = np.random.default_rng(0).normal(size=(40, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    omega = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    factors = factor(ANISOTROPIC, 3, SIDE, form="symmetric", parametrisation=parametrisation)
    assert isinstance(factors, Symmetric)
    assert (factors.terms, factors.channels) == (3, 3)
    products = product(factors, omega)
    np.testing.assert_allclose(products, products.transpose(1, 0, 2), rtol=1e-6, atol=1e-7 * np.abs(products).max())
    assert set(np.unique(factors.signs)) == {-1, 1}


def test_the_symmetric_form_is_the_singular_one():
    """Also at directions beyond the outermost texels."""
    omega = np.array([[0, 0, 1], [0.6, 0, 0.8], [-0.36, 0.48, 0.8], [1, 0, 0], [0.7, -0.7, 0.14]])
    one, other = (product(factor(ANISOTROPIC, 4, SIDE, form=form), omega) for form in ("symmetric", "svd"))
    np.testing.assert_allclose(one, other, atol=1e-3 * np.abs(one).max())


class _OneWay(Brdf):
    """Not reciprocal: it depends on the light alone."""

    scale: jax.Array

    def evaluate(self, omega_i, omega_o):
        return self.scale * omega_i[2]

    @property
    def channels(self) -> int:
        return 3

    @property
    def is_constant(self) -> bool:
        return False


ONES = jnp.asarray(np.ones(3, np.float32))


def test_the_symmetric_form_refuses_what_is_not_symmetric():
    """On the polar map, which has no texels off the hemisphere."""
    with pytest.raises(InputError, match="needs a reciprocal BRDF"):
        factor(_OneWay(ONES), 1, SIDE, form="symmetric", parametrisation=POLAR)
    with pytest.raises(InputError, match="same power of the cosine"):
        factor(GLOSSY, 1, SIDE, form="symmetric", cosine=(1, 0))
    omega, _ = POLAR.directions(SIDE)
    products = product(factor(_OneWay(ONES), 1, SIDE, parametrisation=POLAR), omega)
    np.testing.assert_allclose(products[:, 0, 0], omega[:, 2], rtol=1e-5)


@PARAMETRISATIONS
def test_the_normalised_form_is_never_negative_and_keeps_the_reflectance(parametrisation):
    """Its light map is the mean of f over views weighted by their cosine: the reflectance from ω_i, over π."""
    factors = factor(ANISOTROPIC, 1, SIDE, form="normalised", parametrisation=parametrisation, cosine=(0, 0))
    assert isinstance(factors, Factored)
    assert np.asarray(factors.light_maps).min() >= 0
    assert np.asarray(factors.view_maps).min() >= 0
    omega, inside = parametrisation.directions(SIDE)
    omega, weight = omega[inside], parametrisation.measure(SIDE)[inside]
    exact = evaluate(ANISOTROPIC, omega, omega)
    mean = np.einsum("ioc,o->ic", exact, weight / weight.sum())
    np.testing.assert_allclose(sides(factors, omega)[0][:, 0], mean, rtol=1e-4)
    product_mean = np.einsum("ioc,o->ic", product(factors, omega), weight / weight.sum())
    np.testing.assert_allclose(product_mean, mean, rtol=1e-4)
    with pytest.raises(InputError, match="has one term, not 2"):
        factor(ANISOTROPIC, 2, SIDE, form="normalised")


@FORMS
def test_a_constant_is_exact_in_every_form(form):
    brdf = lambert([0.2, 0.5, 0.0])
    products = product(factor(brdf, 1, form=form), disc(4)[0])
    np.testing.assert_allclose(products, np.broadcast_to(np.array([0.2, 0.5, 0]) / np.pi, products.shape), rtol=1e-6)


@pytest.mark.usefixtures("wrong_types")
def test_an_unknown_form_and_a_matrix_too_large_are_refused():
    with pytest.raises(InputError, match="form of factors is 'cur'; known are svd, symmetric, normalised, nonnegative"):
        factor(GLOSSY, 1, SIDE, form="cur")  # pyright: ignore
    with pytest.raises(InputError, match=r"resolution 256 need 9\.9 GiB; ask for at most 128"):
        factor(GLOSSY, 1, 256)


def test_blocks_and_single_precision_change_nothing_but_rounding(monkeypatch):
    omega = disc(SIDE)[0]
    whole = product(factor(ANISOTROPIC, 3, SIDE), omega)
    monkeypatch.setattr(module, "_ROWS", 7)
    monkeypatch.setattr(module, "_DOUBLE", 0)
    np.testing.assert_allclose(product(factor(ANISOTROPIC, 3, SIDE), omega), whole, atol=1e-4 * whole.max())


class _Counted(Brdf):
    """Counts how often it is traced."""

    scale: jax.Array
    traces: ClassVar[list[int]] = []

    def evaluate(self, omega_i, omega_o):
        self.traces.append(1)
        return self.scale * omega_i[2] * omega_o[2]

    @property
    def channels(self) -> int:
        return 3

    @property
    def is_constant(self) -> bool:
        return False


def test_another_brdf_of_the_same_kind_is_not_compiled_again():
    factor(_Counted(jnp.asarray([1.0, 2, 3])), 2, SIDE, parametrisation=POLAR)
    traces = len(_Counted.traces)
    assert traces
    factor(_Counted(jnp.asarray([3.0, 3, 1])), 2, SIDE, parametrisation=POLAR)
    assert len(_Counted.traces) == traces


def test_peaks_at_the_horizon_do_not_spoil_what_lies_before_it():
    """All terms, interpolated, against a BRDF without bound at grazing angles, weighted as in pictures."""
    rng = np.random.default_rng(0)
    z, azimuth = rng.random((2, 2000)), 2 * np.pi * rng.random((2, 2000))
    omega = np.stack([np.sqrt(1 - z**2) * np.cos(azimuth), np.sqrt(1 - z**2) * np.sin(azimuth), z], axis=-1)
    brdf = ashikhmin_shirley(0.5, 0.75, 2, 4)
    factors = factor(brdf, 208, 16)
    light, view = (sides(factors, one)[i] for i, one in enumerate(omega))
    exact = np.asarray(jax.jit(jax.vmap(brdf.evaluate))(*omega.astype(np.float32)), float)
    weight = (z[0] ** 2 * z[1])[:, None]
    error = np.sum(weight * (np.sum(light * view, axis=1) - exact) ** 2) / np.sum(weight * exact**2)
    assert np.sqrt(error) < 0.3


# ---- non-negative ----------------------------------------------------------------------------------------------------


@PARAMETRISATIONS
def test_the_non_negative_form_is_never_negative_and_nearly_as_near(parametrisation):
    omega, inside = parametrisation.directions(SIDE)
    omega = omega[inside]
    exact = evaluate(ANISOTROPIC, omega, omega)

    def error(form, terms):
        factors = factor(ANISOTROPIC, terms, SIDE, form=form, parametrisation=parametrisation, cosine=(0.5, 0.5))
        weight = np.sqrt(parametrisation.measure(SIDE)[inside] * omega[:, 2])
        apart = (product(factors, omega) - exact) * np.multiply.outer(weight, weight)[..., None]
        return np.linalg.norm(apart), factors

    errors = []
    for terms in (1, 2, 4, 8):
        best, _ = error("svd", terms)
        residual, factors = error("nonnegative", terms)
        assert isinstance(factors, Factored)
        assert np.asarray(factors.light_maps).min() >= 0
        assert np.asarray(factors.view_maps).min() >= 0
        assert best * (1 - 1e-4) <= residual < 1.6 * best
        errors.append(residual)
    # The first singular vectors of a non-negative matrix are non-negative.
    assert errors[0] == pytest.approx(error("svd", 1)[0], rel=1e-3)
    assert (np.diff(errors) < 0).all()


def test_the_non_negative_form_finds_a_matrix_that_is_one():
    """Against a product of known non-negative matrices of rank 3."""
    rng = np.random.default_rng(0)
    g, h = rng.random((2, 40, 3)) ** 4
    matrix = g @ h.T
    found_g, found_h = nonnegative.nonnegative_factors(matrix, *largest_singular(matrix, 3))
    assert np.linalg.norm(found_g @ found_h.T - matrix) < 0.01 * np.linalg.norm(matrix)
    np.testing.assert_allclose(np.linalg.norm(found_g, axis=0), np.linalg.norm(found_h, axis=0))


def test_the_non_negative_form_of_nothing_and_of_what_is_negative():
    black = factor(lobe_sum(0, [NO_LOBE, NO_LOBE]), 2, SIDE, form="nonnegative")
    assert not np.asarray(black.light_maps).any()
    with pytest.raises(InputError, match="nowhere negative"):
        factor(_OneWay(-ONES), 1, SIDE, form="nonnegative", parametrisation=POLAR)


# ---- by error --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["svd", "symmetric", "nonnegative"])
def test_as_few_terms_as_an_error_needs(form):
    omega, _ = disc(SIDE)
    exact = sampled(GLOSSY, SIDE)

    def error(factors):
        return np.max(np.linalg.norm(product(factors, omega) - exact, axis=(0, 1)) / np.linalg.norm(exact, axis=(0, 1)))

    truncated = factor(GLOSSY, 20, SIDE, form=form, cosine=(0, 0), error=0.2)
    assert 1 < truncated.terms < 20
    assert error(truncated) <= 0.2001
    assert error(factor(GLOSSY, truncated.terms - 1, SIDE, form=form, cosine=(0, 0))) > 0.1999


def test_an_error_that_is_not_reached_is_told():
    with pytest.raises(InputError, match=r"2 terms leave an error of \d+ %, more than 0.1 %; allow more"):
        factor(GLOSSY, 2, SIDE, error=0.001)
    with pytest.raises(InputError, match="must lie between 0 and 1, not 5"):
        factor(GLOSSY, 2, SIDE, error=5)
    assert factor(lambert(0.5), 2, SIDE, error=0.001).terms == 1
