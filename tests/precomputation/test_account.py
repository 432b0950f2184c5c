"""What is left out is told with what it costs, and nothing is where nothing is left out."""

import dataclasses
import json

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.files import store
from jaxrelight.precomputation import precompute as module
from jaxrelight.precomputation.account import Account, account_from
from jaxrelight.precomputation.precompute import precompute
from tests.transport.scenes import ball_on_floor

METHOD = jr.Transport("vertices", resolution=8, receiver_tolerance=0)


def account(folder, **dials) -> Account:
    made = precompute(ball_on_floor(), dataclasses.replace(METHOD, **dials), folder).account
    assert made is not None
    return made


def test_rays_and_rows_are_told_and_measured_once(tmp_path, monkeypatch):
    told = account(tmp_path)
    assert told.samples == min(told.receivers, 512)
    assert 0 < told.rays <= told.all_rays == told.receivers * 3 * 8**2
    assert told.rays_error < 0.01
    # Shared rows leave out as much as their tolerance allows; what fills groups up counts there, and here it does not.
    assert 0.2 * METHOD.compression_tolerance < told.rows_error < 1.5 * METHOD.compression_tolerance
    assert told.row_bytes < told.all_row_bytes == 4 * 6 * 8**2 * told.receivers * 1
    assert told.terms == dict.fromkeys(told.channels, 1)
    assert f"of rows for {told.rows_error:.1%} of radiance" in told.line
    # What is known of the same layers is not measured again, and stays what it was.
    monkeypatch.setattr(module, "account_of", None)
    assert account(tmp_path) == dataclasses.replace(told, seconds_saved=None)
    assert account_from(store.read_header(tmp_path)["account"]["numbers"]) == account(tmp_path)
    json.dumps(dataclasses.asdict(told))


def test_looser_tolerances_cost_more(tmp_path):
    errors = [account(tmp_path, compression_tolerance=tolerance).rows_error for tolerance in (0.0, 0.02, 0.1)]
    assert errors[0] < 1e-5
    assert np.all(np.diff(errors) > 0)
    assert account(tmp_path, coefficients=6 * 8**2).rows_error < 1e-5
    assert account(tmp_path, coefficients=16).rows_error > 0.02


def test_nothing_is_left_out_of_all(tmp_path):
    told = account(tmp_path, rays="all", coefficients="all")
    assert (told.rays, told.rays_error, told.rows_error, told.added_receivers) == (told.all_rays, 0, 0, 0)
    assert told.line.startswith("nothing")


def test_rays_that_are_wrong_are_told(tmp_path, monkeypatch):
    """The sample is done in full, whatever the store holds."""
    build = precompute(ball_on_floor(), METHOD, tmp_path)
    layer = store.open_layer(build.folder / build.header["visibility"])
    for group in range(layer.groups):
        layer.write(group, bits=layer.read("bits", group) & 0x0F, rays=layer.read("rays", group))
    (tmp_path / "store.json").unlink()
    assert account(tmp_path).rays_error == pytest.approx(0.5, abs=0.2)
