"""Rows and clusters as stores keep them: how near they are, how small, and what is refused."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.reflection import of_group
from jaxrelight.files import store
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lights.natural_spectrum import natural_spectrum
from jaxrelight.methods import Transport
from jaxrelight.operators.clustered import Clustered
from jaxrelight.operators.contract import Operator
from jaxrelight.precomputation.load import load
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.transport import bake
from jaxrelight.transport.model import Block, PrecomputedTransport, frames_of
from jaxrelight.transport.rebake import rebake
from tests.transport.scenes import ball_on_floor
from tests.transport.stores import block_of, precomputed, reflections_of

SMALL = Transport("vertices", receiver_tolerance=0, reflection="factors", resolution=8, terms=2, factor_resolution=12)
BASIS = HaarFaces(8)


@pytest.fixture(scope="module")
def scene():
    return ball_on_floor()


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    return tmp_path_factory.mktemp("clusters") / "store"


def opened(scene, folder, **dials) -> PrecomputedTransport:
    return precomputed(scene, dataclasses.replace(SMALL, **dials), folder)


def whole_rows(transport: PrecomputedTransport, block: Block) -> np.ndarray:
    """All coefficients of the rows [g, m k, c, d] of a block's groups, baked from visibility."""
    visibility = transport.stored.visibility
    assert visibility is not None
    frames, rows = frames_of(transport.receivers, block.groups), []
    for i, group in enumerate(block.groups):
        bits, reflection = visibility.read("bits", int(group)), of_group(block.reflection, i)
        rows.append(bake.bake_rows(jax.device_put(bits), frames[i], reflection, bake.directions_for(8), BASIS))
    m, k, c, d = rows[0].shape
    return np.reshape(rows, (-1, m * k, c, d))


def written_out(operator: Operator) -> np.ndarray:
    """The rows of an operator's clusters, [g, r, c, d]."""
    assert isinstance(operator, Clustered)
    _, d, c = operator.shape
    out = np.zeros((len(operator.place), operator.group_rows, c, d), np.float32)
    for group, (support, basis, weights) in enumerate(operator.clusters()):
        out[group][..., support] = np.einsum("cqr,qs->rcs", weights, basis, optimize=True)
    return out


def test_the_error_under_natural_light_stays_within_the_tolerance(scene, folder):
    """The mean over random lights of its spectrum, each group's own; and bytes fall as it grows."""
    spectrum, sizes = natural_spectrum(8), []
    light = np.random.default_rng(0).normal(size=(len(spectrum), 3, 40)) * spectrum[:, None, None]
    lights = light.reshape(len(spectrum), -1).astype(np.float32)
    first = opened(scene, folder, compression_tolerance=0.0)
    matrices = [whole_rows(first, block) for block in first.blocks]
    for tolerance in (0.0, 0.02, 0.2):
        transport = opened(scene, folder, compression_tolerance=tolerance)
        for kept, matrix in zip(transport.operator.operators, matrices, strict=True):
            true = matrix.reshape(len(matrix), -1, len(spectrum))
            off = written_out(kept).reshape(true.shape) - true
            left = np.linalg.norm(off * spectrum, axis=(1, 2)) / np.linalg.norm(true * spectrum, axis=(1, 2))
            assert left.max() <= tolerance + 1e-5
            if tolerance:
                assert left.max() > tolerance / 20
            error, wanted = (x @ lights for x in (off, true))
            assert np.linalg.norm(error) <= 1.3 * tolerance * np.linalg.norm(wanted) + 1e-4
        sizes.append(transport.operator.nbytes)
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 3


def test_the_dropped_energy_is_that_of_the_rows(scene, folder):
    transport = opened(scene, folder, compression_tolerance=0.1)
    for kept, block in zip(transport.operator.operators, transport.blocks, strict=True):
        off = written_out(kept) - whole_rows(transport, block)
        assert block.dropped is not None
        np.testing.assert_allclose(
            block.dropped, np.sum(np.square(off), axis=-1).reshape(block.dropped.shape), rtol=1e-3, atol=1e-8
        )
    assert 0.9 < transport.kept < 1


@pytest.mark.slow
def test_light_is_differentiable_through_clusters(scene, folder):
    relighter = TransportRelighter(opened(scene, folder, compression_tolerance=0.05))
    light = np.random.default_rng(1).normal(size=(6 * 8**2, 3)).astype(np.float32)
    view = relighter.view()

    def brightness(light):
        return jnp.sum(relighter.shade_terms(relighter.terms(light), view))

    gradient = jax.grad(brightness)(light)
    # Linear, so that the gradient times the light is the value.
    np.testing.assert_allclose(jnp.vdot(gradient, light), brightness(light), rtol=1e-4)
    assert np.isfinite(gradient).all()


@pytest.mark.slow
def test_clusters_are_baked_again_as_rows_of_what_they_share(scene, folder):
    transport = opened(scene, folder, compression_tolerance=0.0)
    again = rebake(transport, reflections_of(transport))
    light = np.random.default_rng(2).normal(size=(6 * 8**2, 3)).astype(np.float32)
    for before, after in zip(
        TransportRelighter(transport).terms(light), TransportRelighter(again).terms(light), strict=True
    ):
        np.testing.assert_allclose(after, before, atol=2e-4 * np.abs(before).max())


def test_rows_keep_the_coefficients_that_count_under_natural_light(scene, folder):
    """Not the largest: those whose squares, times the light's, leave out the least."""
    transport, spectrum = opened(scene, folder, coefficients=8), natural_spectrum(8)
    block = block_of(transport, "floor")
    rows = np.concatenate(whole_rows(transport, block))
    kept = np.asarray(block.operator.rows(jnp.arange(len(rows))))
    left, least = (
        np.sum(np.square((rows - of) * spectrum), axis=(1, 2)) for of in (kept, _largest(rows * spectrum) / spectrum)
    )
    np.testing.assert_allclose(left, least, rtol=1e-3, atol=1e-9)
    assert left.sum() < 0.95 * np.sum(np.square((rows - _largest(rows)) * spectrum))


def _largest(rows: np.ndarray) -> np.ndarray:
    """Rows of the eight coefficients whose squares, summed over channels, are largest."""
    order = np.argsort(-np.sum(np.square(rows), axis=1), axis=-1)[:, None, :8]
    cut = np.zeros_like(rows)
    np.put_along_axis(cut, np.broadcast_to(order, (*rows.shape[:2], 8)), np.take_along_axis(rows, order, 2), axis=2)
    return cut


def test_indices_out_of_range_are_refused(scene, tmp_path):
    made = precompute(scene, SMALL, tmp_path / "store")
    name = made.header["materials"][0]["transport"]
    layer = store.open_layer(made.folder / name)
    arrays = next(layer.read_groups())
    layer.write(0, **{**arrays, "support": arrays["support"] + np.uint16(6 * 8**2)})
    with pytest.raises(InputError, match="indices are out of range"):
        load(made.folder)


def test_groups_that_no_light_reaches_hold_nothing(tmp_path):
    """A floor under a lid: whatever lies between them is black."""
    lid = jr.plane((2, 2), 12)
    lid = dataclasses.replace(lid, vertices=lid.vertices + np.array([0, 1e-3, 0]))
    floor = dataclasses.replace(jr.plane((1, 1), 11))
    grey = jr.lambert([0.5] * 3)
    camera = jr.Camera((0, 1, 3), (0, 0, 0), width=8, height=8)
    parts = [jr.Part(floor, "floor"), jr.Part(lid, "lid")]
    dark = jr.Scene(parts, {"floor": grey, "lid": grey}, camera)
    transport = opened(dark, tmp_path / "store")
    black = block_of(transport, "floor").operator
    lit = block_of(transport, "lid").operator
    assert isinstance(black, Clustered)
    assert not black.buckets
    # Where each column is held, and nothing else.
    assert black.nbytes <= 4 * (6 * 8**2 + 8) < lit.nbytes
    np.testing.assert_array_equal(black.apply(jax.device_put(np.ones((6 * 8**2, 3), np.float32))), 0)


@pytest.mark.parametrize("coefficients", [pytest.param(64, marks=pytest.mark.slow), "shared"])
def test_codes_are_near_and_small(scene, folder, coefficients):
    """In 16 bits the light is the same to 1e-3, in 8 to 2e-2; files, operators and the dropped energy tell it."""
    dials = {"coefficients": coefficients, "compression_tolerance": 0.02}
    light = np.random.default_rng(3).normal(size=(6 * 8**2, 3)) * natural_spectrum(8)[:, None]

    def lit(transport):
        """By the formula: what is compiled for each operator is tested of operators."""
        each = transport.operator.operators
        rows = [np.asarray(one.to_matrix()) if coefficients != "shared" else written_out(one) for one in each]
        return [one.reshape(-1, one.shape[-2], len(light))[:, 0] @ light for one in rows]

    whole = opened(scene, folder, **dials)
    wanted = lit(whole)
    before = whole
    for bits, most in ((16, 1e-3), (8, 2e-2)):
        coded = opened(scene, folder, bits=bits, **dials)
        for one, other in zip(lit(coded), wanted, strict=True):
            assert 0 < np.linalg.norm(one - other) < most * np.linalg.norm(other)
        assert coded.operator.nbytes < before.operator.nbytes
        assert coded.kept < before.kept
        before = coded


@pytest.mark.slow
def test_bounces_are_gathered_from_codes(scene, folder):
    dials = {"compression_tolerance": 0.02, "bounces": 1, "gather_resolution": 8}
    light = np.random.default_rng(4).normal(size=(6 * 8**2, 3)) * natural_spectrum(8)[:, None]
    light = light.astype(np.float32)
    wanted, coded = (TransportRelighter(opened(scene, folder, bits=bits, **dials)).terms(light) for bits in (32, 8))
    for one, other in zip(coded, wanted, strict=True):
        assert np.linalg.norm(one - other) < 2e-2 * np.linalg.norm(other)
