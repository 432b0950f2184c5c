"""SBRDF maps as OpenEXR files."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxrelight.brdf.files.sbrdf import SbrdfLevel, read_sbrdf, spatial, write_sbrdf
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.errors import InputError
from jaxrelight.images.exr import read_channels, write_channels
from tests.brdf.test_spatial import maps


def level(h=3, w=5, lobes=2, seed=0) -> SbrdfLevel:
    normals = np.random.default_rng(seed).normal([0, 0, 4], 1, (h, w, 3))
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    residual = np.full((h, w), 0.1, np.float32)
    residual[0, 0] = np.nan
    return SbrdfLevel(maps(h, w, lobes, seed), normals, np.arange(h * w).reshape(h, w) % 7, residual)


@pytest.mark.parametrize("lobes", [0, 1, 3])
def test_what_is_written_comes_back(tmp_path, lobes):
    sizes = (3, 5), (2, 3), (1, 2), (1, 1)
    written = [level(h, w, lobes, seed) for seed, (h, w) in enumerate(sizes)]
    write_sbrdf(tmp_path / "a.exr", written)
    levels = read_sbrdf(tmp_path / "a.exr")
    assert len(levels) == 4
    for one, other in zip(written, levels, strict=True):
        jax.tree.map(np.testing.assert_array_equal, other.lobes, one.lobes)
        np.testing.assert_array_equal(other.normals.astype(np.float32), one.normals)
        np.testing.assert_array_equal(other.flag, one.flag)
        np.testing.assert_array_equal(other.residual, one.residual)
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


@pytest.mark.parametrize("lobes", [0, 2])
@pytest.mark.parametrize("storage", ["half", "8bit"])
def test_compact_storage_comes_back_nearly(tmp_path, storage, lobes):
    written = level(3, 5, lobes)
    write_sbrdf(tmp_path / "a.exr", [written], storage)
    (restored,) = read_sbrdf(tmp_path / "a.exr")
    np.testing.assert_allclose(restored.lobes.exponent, written.lobes.exponent, rtol=0.04)
    np.testing.assert_allclose(restored.lobes.diffuse, written.lobes.diffuse, atol=5e-3)
    np.testing.assert_allclose(restored.normals, written.normals, atol=1e-3)
    np.testing.assert_array_equal(restored.flag, written.flag)
    np.testing.assert_array_equal(np.isnan(restored.residual), np.isnan(written.residual))
    write_sbrdf(tmp_path / "float.exr", [written])
    assert (tmp_path / "a.exr").stat().st_size < (tmp_path / "float.exr").stat().st_size


@pytest.mark.parametrize(("size", "lobes"), [((2, 2), 2), ((3, 5), 2), ((2, 3), 1)])
def test_levels_that_do_not_follow_each_other_are_refused(tmp_path, size, lobes):
    write_sbrdf(tmp_path / "a.exr", [level(3, 5), level(size[0], size[1], lobes)])
    with pytest.raises(InputError, match=r"level 1 is of \(\d, \d\) texels and \d lobes; it must be half as wide"):
        read_sbrdf(tmp_path / "a.exr")


def test_all_levels_belong_to_the_material():
    levels = [level(3, 5), level(2, 3, seed=1)]
    (component,) = spatial(levels).components
    assert isinstance(component.brdf, SpatialLobes)
    jax.tree.map(np.testing.assert_array_equal, component.brdf.coarser, (levels[1].lobes,))


def test_channels_are_named_as_documented(tmp_path):
    write_sbrdf(tmp_path / "a.exr", [level(lobes=1)])
    (part,) = read_channels(tmp_path / "a.exr", 2**20)
    named = {"diffuse": "RGB", "lobe0.C": "XYZ", "lobe0.scale": "RGB", "normal": "XYZ"}
    wanted = [f"{name}.{letter}" for name, letters in named.items() for letter in letters]
    assert sorted(part) == sorted([*wanted, "lobe0.exponent", "axis.cos2", "axis.sin2", "flag", "residual"])


def test_bent_normals_become_a_normal_map():
    bent = level()
    bumps = spatial([bent]).normal_map
    assert bumps is not None
    np.testing.assert_allclose(np.asarray(bumps.pixels) * 2 - 1, bent.normals, atol=1e-6)
    straight = dataclasses.replace(bent, normals=np.broadcast_to([0.0, 0, 1], bent.normals.shape))
    assert spatial([straight]).normal_map is None


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"flag": None}, "lacks the channel 'flag'"),
        ({"lobe0.C.Y": None}, r"lacks the channel 'lobe0\.C\.Y'"),
        ({"lobe1.exponent": None}, r"lacks the channel 'lobe1\.exponent'"),
        ({"diffuse.G": np.nan}, "values of 'diffuse' that are not finite"),
        ({"lobe0.exponent": -1}, "values of 'exponent'"),
        ({"lobe0.C.X": 1.5}, "a C beyond 1"),
        ({"lobe1.scale.B": np.inf}, "values of 'scale'"),
        ({"normal.Z": np.nan}, "values of 'normal'"),
    ],
)
def test_maps_that_are_none_are_refused_in_one_line(tmp_path, change, word):
    write_sbrdf(tmp_path / "a.exr", [level()])
    (part,) = read_channels(tmp_path / "a.exr", 2**20)
    changed = {
        name: plane if name not in change else np.full_like(plane, change[name])
        for name, plane in part.items()
        if not (name in change and change[name] is None)
    }
    write_channels(tmp_path / "b.exr", [("level0", changed)])
    with pytest.raises(InputError, match=word) as told:
        read_sbrdf(tmp_path / "b.exr")
    assert "\n" not in str(told.value)


def test_files_that_are_none_are_refused(tmp_path):
    path = tmp_path / "a.exr"
    with pytest.raises(InputError, match="no such file"):
        read_sbrdf(path)
    write_sbrdf(path, [level(16, 16)])
    whole = path.read_bytes()
    for length in np.linspace(0, len(whole) - 2, 20).astype(int):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"a\.exr"):
            read_sbrdf(path)
    with pytest.raises(InputError, match=r"are written as \.exr"):
        write_sbrdf(tmp_path / "a.png", [level()])
    with pytest.raises(InputError, match="does not exist"):
        write_sbrdf(tmp_path / "absent" / "a.exr", [level()])


def test_a_lobe_is_shared_by_the_channels():
    assert isinstance(spatial([level()]).components[0].brdf, SpatialLobes)


@pytest.mark.parametrize("value", [256, 0.5, -1, np.nan])
def test_codes_that_are_no_bytes_are_refused(tmp_path, value):
    write_sbrdf(tmp_path / "a.exr", [level()], "8bit")
    (part,) = read_channels(tmp_path / "a.exr", 2**20)
    part["lobe1.code.D"][0, 2] = value
    write_channels(tmp_path / "b.exr", [("level0", part)])
    with pytest.raises(InputError, match=r"level 0: the channel 'lobe1\.code\.D' holds other numbers than bytes"):
        read_sbrdf(tmp_path / "b.exr")
