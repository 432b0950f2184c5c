"""Sensors by the command: tables, stores that are measured again, and what is refused."""

import csv

import numpy as np
import pytest

from tests.commands.running import refusal_of, run, summary_of
from tests.commands.summary_keys import KEYS, keys_of
from tests.commands.test_indirect import CAMERA, FEW, LAMP, MATERIALS, MESHES

SENSORS = (
    '[[sensor]]\nname = "floor"\npoints = [[0, 0, 0.5]]\n'
    '[[sensor]]\nname = "desk"\norigin = [-0.5, 0.2, 0]\nu = [1, 0, 0]\nv = [0, 0, 0.5]\ncolumns = 3\nrows = 2\n'
)


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.toml").write_text(CAMERA + MATERIALS + MESHES + LAMP + SENSORS)
    (tmp_path / "twice.toml").write_text(LAMP.replace("[2, 1, 1]", "[4, 2, 2]"))
    (tmp_path / "plain.toml").write_text(CAMERA + MATERIALS + MESHES + LAMP)


def rows_of(file: str) -> list[dict[str, str]]:
    with open(file, encoding="utf-8") as opened:
        return list(csv.DictReader(opened))


def test_a_scene_is_measured_into_a_table_and_its_store_again_under_other_lights():
    told = summary_of(run("measure", "lamp.toml", "-o", "lux.csv", "--store", "made", *FEW, "--json"))
    assert keys_of(told) == KEYS["measure"]
    rows = rows_of("lux.csv")
    assert [row["sensor"] for row in rows] == ["floor"] + 6 * ["desk"]
    lux = np.array([float(row["lux"]) for row in rows])
    weighed = [
        0.2126 * float(r["red_w_m2"]) + 0.7152 * float(r["green_w_m2"]) + 0.0722 * float(r["blue_w_m2"]) for r in rows
    ]
    np.testing.assert_allclose(lux, 179 * np.array(weighed), rtol=1e-5)
    assert told["sensors"]["desk"]["mean"] == pytest.approx(lux[1:].mean(), rel=1e-5)
    assert told["sensors"]["desk"]["points"] == 6
    assert (float(rows[0]["z"]), float(rows[0]["normal_y"])) == (0.5, 1)

    status, out, err = run("measure", "made", "--lights", "twice.toml", "-o", "twice.csv")
    assert status == 0, err
    assert [line.split()[0] for line in out.splitlines()[:3]] == ["sensor", "floor", "desk"]
    np.testing.assert_allclose([float(row["lux"]) for row in rows_of("twice.csv")], 2 * lux, rtol=1e-4)


@pytest.mark.parametrize(
    ("arguments", "said", "status"),
    [
        ("plain.toml", "the scene has no sensor; add a [[sensor]]", 1),
        ("lamp.toml -o lux.txt", "tables are written as .csv", 1),
        ("lamp.toml -o none/lux.csv", "there is no folder none", 1),
        ("none.toml", "no such file", 1),
        ("lamp.toml --lighting adaptive", "sensors do not have; measure with another method", 2),
        ("lamp.toml --lighting transport --receivers vertices", "leave receivers at 'pixels'", 1),
    ],
)
def test_what_cannot_be_measured_is_refused_in_one_line(arguments, said, status):
    assert said.lower() in refusal_of(run("measure", *arguments.split()), status=status).lower()


def test_stores_keep_their_method_and_need_sensors():
    assert run("precompute", "plain.toml", "-o", "seen", *FEW)[0] == 0
    assert "no sensors were precomputed there" in refusal_of(run("measure", "seen"))
    assert "has its own lighting method" in refusal_of(run("measure", "seen", "--lighting", "transport"))
