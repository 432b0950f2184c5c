"""Pictures of fits."""

import numpy as np
import pytest

from fitting import report
from jaxrelight.brdf.lobes import lambert, phong
from jaxrelight.errors import InputError
from jaxrelight.images import read_image


def test_curves_in_the_plane_of_incidence_have_their_peak_at_the_mirror_angle():
    angles = np.linspace(-80, 80, 161)
    values = report.in_plane(phong(0.1, 0.5, 60), 40, angles)
    assert angles[np.argmax(values[:, 0])] == 40
    np.testing.assert_allclose(
        report.in_plane(lambert([0.2, 0.4, 0.6]), 40, angles)[0], np.array([0.2, 0.4, 0.6]) / np.pi
    )


def test_spheres_stand_side_by_side_and_alike_where_the_brdfs_are():
    row = report.spheres([phong(0.1, 0.5, 60), phong(0.1, 0.5, 60), lambert(0.3)], size=32)
    assert row.shape == (32, 3 * 32 + 2 * 8, 3)
    np.testing.assert_array_equal(row[:, :32], row[:, 40:72])
    assert np.abs(row[:, :32] - row[:, 80:]).max() > 0.1
    assert (row[:, 32:40] == 1).all()
    # The light comes from above, on the right.
    assert row[6:14, 18:26].mean() > 2 * row[18:26, 6:14].mean()


def test_a_report_is_three_pictures(tmp_path):
    pytest.importorskip("matplotlib")
    residual = np.linspace(0, 90, 5), np.linspace(0, 90, 4), np.ones((3, 4))
    files = report.write_report(tmp_path / "new", {"data": phong(0.1, 0.5, 9), "fit": lambert(0.3)}, residual)
    assert [file.name for file in files] == ["curves.png", "spheres.png", "residuals.png"]
    for file in files:
        assert read_image(file).std() > 0.05
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made"):
        report.write_report(tmp_path / "file", {"data": lambert(0.3)})


def test_without_matplotlib_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"install jaxrelight\[plots\]"):
        report.check_report(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_heat_map_is_black_off_the_surface(tmp_path):
    pytest.importorskip("matplotlib")
    mask = np.array([[True, False], [True, True]])
    report.heat_map(np.array([[0.0, 1], [1, np.nan]]), mask, 1.0, tmp_path / "map.png")
    picture = read_image(tmp_path / "map.png")
    assert (picture[0, 1] == 0).all()
    assert picture[1, 0].sum() > 1
    assert picture[1, 1].sum() > 1
