"""Data to fit to, and a way to run commands on them."""

import functools
import pathlib

import numpy as np
import pytest

from fitting import brdf_samples, cli, lafortune, sbrdf, sbrdf_levels
from tests.brdf.files import writers
from tests.commands.running import run
from tests.fitting.synthetic import COARSE


@pytest.fixture
def folder(tmp_path, monkeypatch) -> pathlib.Path:
    """Where commands run: a measured material and a stack of images.

    All fits are of the same few items and samples, so that one program is compiled.
    """
    for module in (brdf_samples, lafortune):
        monkeypatch.setattr(module, "Grid", lambda **_: COARSE)
    monkeypatch.setattr(sbrdf, "CHUNK", 2)
    monkeypatch.setattr(sbrdf_levels, "CHUNK", 2)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "paint.bsdf").write_bytes(writers.rgl(scale=0.5))
    images, lights, normals = bump()
    np.savez(tmp_path / "bump.npz", images=images, light_directions=lights, normals=normals)
    return tmp_path


def bump(count: int = 256, height: int = 3, width: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Images [n, h, w, 3], lights and normals of a bump of one glossy material, seen from +z."""
    lights = np.random.default_rng(0).normal(size=(count, 3))
    lights[:, 2] = np.abs(lights[:, 2]) + 0.5
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    y, x = np.mgrid[:height, :width]
    normals = np.stack([(x - (width - 1) / 2) / 8, (y - (height - 1) / 2) / 8, np.ones((height, width))], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    cosine = np.einsum("hwx,nx->nhw", normals, lights)[..., None]
    mirrored = 2 * cosine * normals - lights[:, None, None]
    reflectance = np.array([0.3, 0.2, 0.1]) / np.pi + 0.5 * np.maximum(mirrored[..., 2:], 0) ** 20
    return (np.maximum(cosine, 0) * reflectance).astype(np.float32), lights, normals


@pytest.fixture(name="run")
def _run():
    """Runs a command of jaxrelight-fit in this process."""
    return functools.partial(run, main=cli.main)
