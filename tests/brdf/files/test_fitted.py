"""Files of fitted materials: written and read to the last bit, and whatever else may be in them."""

import tomllib
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.files.fitted import read_fitted, write_factors, write_lobes
from jaxrelight.brdf.lobes import lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.parametrisation import DISC, POLAR
from jaxrelight.brdf.separable import Separable, separable
from jaxrelight.errors import InputError
from jaxrelight.files import whole_file

LOBES = {
    "lambert": lambert([0.1, 1 / 3, 0.7]),
    "shared": lobe_sum(
        0.1, [lobe([-1, -1, 0.9], 16600 / 3, peak=[1e5 / 7, 1e-30, 2]), lobe([0.2, 0.3, -1], 0, peak=1)]
    ),
    "per channel": lobe_sum(
        [0.1, 0.2, 0.3],
        [lobe(np.array([[-0.9, -1, 0.7], [-1, -1, 0.5], [0.3, 0.2, 1]]), [5, 10, 2.5], peak=[1e-30, 2, 3])],
    ),
}


@pytest.mark.parametrize("name", LOBES)
def test_lobes_come_back_to_the_last_bit(tmp_path, name):
    write_lobes(tmp_path / "a.toml", LOBES[name], ["residual 3 %", "of a\nfile\u0085\x00", ""])
    assert eqx.tree_equal(read_fitted(tmp_path / "a.toml"), LOBES[name])
    text = (tmp_path / "a.toml").read_text()
    assert text.startswith("# residual 3 %\n# of a?file??\n#\n\ntype = ")


def test_the_file_of_lobes_can_be_copied_into_a_scene(tmp_path):
    write_lobes(tmp_path / "a.toml", phong(0.2, 0.4, 12))
    table = tomllib.loads((tmp_path / "a.toml").read_text())
    assert table["type"] == "lafortune"
    assert table["lobes"][0] == {"C": [-1, -1, 1], "exponent": 12, "peak": pytest.approx([0.8912677] * 3)}


@pytest.mark.parametrize("form", ["svd", "symmetric", "nonnegative", "constant", "polar"])
def test_factors_come_back_to_the_last_bit(tmp_path, form):
    brdf = lambert([0.1, 0.2, 0.3]) if form == "constant" else phong(0.1, 0.3, 4)
    maps = POLAR if form == "polar" else DISC
    made = separable(factor(brdf, 3, 8, form="svd" if form in ("constant", "polar") else form, parametrisation=maps))
    write_factors(tmp_path / "a.npz", made)
    assert eqx.tree_equal(read_fitted(tmp_path / "a.npz"), made)


def test_what_is_not_finite_is_not_written(tmp_path):
    with pytest.raises(InputError, match="not finite and cannot be written"):
        write_lobes(tmp_path / "a.toml", lambert(np.nan))
    with pytest.raises(InputError, match="not finite and cannot be written"):
        write_factors(tmp_path / "a.npz", Separable(jnp.ones((1, 1, 2, 2)), jnp.full((1, 3, 2, 2), np.inf)))
    with pytest.raises(InputError, match="direction of anisotropy"):
        write_lobes(tmp_path / "a.toml", lobe_sum(0.1, [lobe([-1, -0.5, 1], 3, peak=1)], turn=0.3))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "write", "material"),
    [
        ("a.toml", write_lobes, LOBES["shared"]),
        ("a.npz", write_factors, Separable(jnp.ones((2, 3, 4, 4)), jnp.ones((2, 3, 4, 4)))),
    ],
    ids=["lobes", "factors"],
)
def test_a_failed_write_leaves_the_earlier_file(tmp_path, monkeypatch, name, write, material):
    write(tmp_path / name, material)
    earlier = (tmp_path / name).read_bytes()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(whole_file.os, "replace", full_disk)
    with pytest.raises(InputError, match="No space left on device"):
        write(tmp_path / name, material)
    assert (tmp_path / name).read_bytes() == earlier
    assert [path.name for path in tmp_path.iterdir()] == [name]


GOOD = 'type = "lafortune"\ndiffuse = 0.1\n[[lobes]]\nC = [-1, -1, 1]\nexponent = 5\npeak = 0.5\n'


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("diffuse = 0.1", "", "'diffuse' is missing"),
        ("diffuse = 0.1", "difuse = 0.1", "'difuse' is not known; did you mean 'diffuse'?"),
        ("diffuse = 0.1", "diffuse = [0.1, 0.2]", "'diffuse' must be a number or 3 numbers"),
        ("diffuse = 0.1", "diffuse = nan", "'diffuse' must be finite"),
        ("diffuse = 0.1", "diffuse = -0.1", "'diffuse' must not be negative"),
        ("exponent = 5", "exponent = inf", "[[lobes]] number 1: 'exponent' must be finite"),
        ("exponent = 5", "exponent = -5", "'exponent' must not be negative"),
        ("peak = 0.5", "", "exactly one of 'specular' and 'peak'"),
        ("peak = 0.5", "peek = 0.5", "'peek' is not known; did you mean 'peak'?"),
        ("[[lobes]]", "[lobes]", "'lobes' must be written as [[lobes]]"),
        ("[[lobes]]", "[[lobe]]", "'lobe' is not known; did you mean 'lobes'?"),
        ('"lafortune"', '"phong"', "'type' must be \"lafortune\", not 'phong'"),
        ('type = "lafortune"', "", "'type' is missing"),
        ("diffuse = 0.1", "diffuse = ", "not a TOML file"),
    ],
)
def test_faults_of_lobes_are_told_in_one_line(tmp_path, old, new, what):
    assert old in GOOD
    (tmp_path / "a.toml").write_text(GOOD.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_fitted(tmp_path / "a.toml")
    assert what in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "a.toml"))
    assert len(str(caught.value).splitlines()) == 1


def test_lobes_cut_short_are_refused_unless_none_is_missing(tmp_path):
    """The text may end after the diffuse part, or within the last lobe's numbers, and still be a material."""
    path = tmp_path / "a.toml"
    write_lobes(path, LOBES["per channel"])
    whole = path.read_text()
    for end in range(whole.index("[[lobes]]") + 4, whole.index("peak"), 3):
        path.write_text(whole[:end])
        with pytest.raises(InputError, match=r"^\S*a\.toml: .*"):
            read_fitted(path)


ONES = np.ones((2, 3, 4, 4), np.float32)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"light_maps": None}, "'light_maps' is missing; it has view_maps"),
        ({"view_maps": ONES[0]}, "'light_maps' of shape"),
        ({"view_maps": ONES[:, :1]}, "'view_maps' of shape (2, 1, 4, 4)"),
        ({"light_maps": ONES[:, :2]}, "'light_maps' of shape (2, 2, 4, 4)"),
        ({"light_maps": ONES[:1]}, "'light_maps' of shape (1, 3, 4, 4)"),
        ({"light_maps": ONES[..., :3]}, "'light_maps' of shape (2, 3, 4, 3)"),
        ({"light_maps": ONES[:0]}, "'light_maps' of shape (0, 3, 4, 4)"),
        ({"is_polar": 1.0}, "'is_polar' is neither true nor false"),
        ({"light_maps": ONES * np.nan}, "'light_maps' has numbers that are not finite"),
        ({"view_maps": ONES.astype(float) * 1e300}, "'view_maps' has numbers that are not finite"),
    ],
)
def test_faults_of_factors_are_told_in_one_line(tmp_path, change, what):
    arrays: dict[str, Any] = {"light_maps": ONES, "view_maps": ONES.astype(float)} | {
        name: None if array is None else np.asarray(array, float) for name, array in change.items()
    }
    np.savez(tmp_path / "a.npz", **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(InputError) as caught:
        read_fitted(tmp_path / "a.npz")
    assert what in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"is a \.toml file of lobes or a \.npz file of factors"):
        read_fitted(tmp_path / "a.binary")
    with pytest.raises(InputError, match="cannot be read as a fitted material: No such file"):
        read_fitted(tmp_path / "none.toml")
