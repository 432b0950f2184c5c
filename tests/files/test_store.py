"""The store: names by content, layers that resume, and damage that is found."""

import errno
import json
import os
import pathlib
import shutil
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from jaxrelight import InputError
from jaxrelight.files import store

GROUPS = 6
ARRAYS = {"values": ((4, 3), np.dtype(np.float32)), "bits": ((5,), np.dtype(np.uint8))}


def _part(group: int) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(group)
    return {
        "values": generator.normal(size=(4, 3)).astype(np.float32),
        "bits": generator.integers(1, 255, 5).astype(np.uint8),
    }


def _layer(folder: pathlib.Path, write=()) -> store.Layer:
    layer = store.make_layer(folder, ARRAYS, GROUPS)
    for group in write:
        layer.write(group, **_part(group))
    return layer


def _contents(folder: pathlib.Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _refused(function, *arguments) -> str:
    with pytest.raises(InputError) as caught:
        function(*arguments)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


ARRAY = np.arange(6, dtype=np.float32)


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param([ARRAY.reshape(2, 3), "plane", 4, 0.5, {"a": 1, "b": 2}, None], id="shape"),
        pytest.param([ARRAY.astype(np.float64), "plane", 4, 0.5, {"a": 1, "b": 2}, None], id="float type"),
        pytest.param([ARRAY.view(np.int32), "plane", 4, 0.5, {"a": 1, "b": 2}, None], id="type of the same bytes"),
        pytest.param([ARRAY[::-1], "plane", 4, 0.5, {"a": 1, "b": 2}, None], id="order in an array"),
        pytest.param([np.nextafter(ARRAY, 9), "plane", 4, 0.5, {"a": 1, "b": 2}, None], id="last bits"),
        pytest.param([ARRAY.tolist(), "plane", 4, 0.5, {"a": 1, "b": 2}, None], id="list for array"),
        pytest.param([ARRAY, "plans", 4, 0.5, {"a": 1, "b": 2}, None], id="text"),
        pytest.param([ARRAY, "plane", 5, 0.5, {"a": 1, "b": 2}, None], id="whole number"),
        pytest.param([ARRAY, "plane", 4.0, 0.5, {"a": 1, "b": 2}, None], id="number type"),
        pytest.param([ARRAY, "plane", "4", 0.5, {"a": 1, "b": 2}, None], id="text for number"),
        pytest.param([ARRAY, "plane", 4, 0.5 + 1e-16, {"a": 1, "b": 2}, None], id="last bit of a number"),
        pytest.param([ARRAY, "plane", 4, 0.5, {"a": 1, "b": 3}, None], id="value in a table"),
        pytest.param([ARRAY, "plane", 4, 0.5, {"a": 1, "c": 2}, None], id="key of a table"),
        pytest.param([ARRAY, "plane", 4, 0.5, {"a": 1}, None], id="less in a table"),
        pytest.param([ARRAY, "plane", 4, 0.5, {"a": 1, "b": 2}, False], id="false for none"),
        pytest.param([ARRAY, "plane", 4, 0.5, {"a": 1, "b": 2}], id="one less"),
        pytest.param(["plane", ARRAY, 4, 0.5, {"a": 1, "b": 2}, None], id="order"),
        pytest.param([ARRAY, ["plane", 4], 0.5, {"a": 1, "b": 2}, None], id="nesting"),
    ],
)
def test_key_differs(changed):
    assert store.key_of(ARRAY, "plane", 4, 0.5, {"a": 1, "b": 2}, None) != store.key_of(*changed)


def test_key_is_the_same_for_the_same():
    assert store.key_of({"a": 1, "b": [2]}) == store.key_of({"b": [2], "a": 1})
    assert store.key_of((1, (2.5,))) == store.key_of([1, [2.5]])
    strided = np.arange(12.0).reshape(3, 4)[:, ::2]
    assert store.key_of(strided) == store.key_of(strided.copy())


def test_key_is_the_same_in_another_process():
    """No hash that Python seeds anew may enter it."""
    code = "import numpy as np; from jaxrelight.files import store; "
    code += "print(store.key_of({'b': np.arange(3), 'a': ['x', 1.5]}))"
    keys = {
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={"PYTHONHASHSEED": seed},
            cwd=pathlib.Path(__file__).parents[2],
        ).stdout.strip()
        for seed in ("1", "2")
    }  # fmt: skip
    assert keys == {store.key_of({"a": ["x", 1.5], "b": np.arange(3)})}
    assert all(len(key) == 16 and int(key, 16) >= 0 for key in keys)


def test_layer_gives_back_what_was_written(tmp_path):
    _layer(tmp_path / "a", range(GROUPS))
    layer = store.open_layer(tmp_path / "a")
    assert layer.missing == []
    for group in range(GROUPS):
        for name, expected in _part(group).items():
            array = layer.read(name, group)
            assert array.dtype == expected.dtype
            np.testing.assert_array_equal(array, expected)
    for name, together in layer.read_all().items():
        np.testing.assert_array_equal(together, np.stack([_part(group)[name] for group in range(GROUPS)]))
        np.testing.assert_array_equal(together, layer.read(name))
    assert layer.nbytes == sum(map(len, _contents(tmp_path / "a").values()))


def test_layer_resumes(tmp_path):
    first = _layer(tmp_path / "a", [4, 0])
    assert first.missing == [1, 2, 3, 5]
    again = _layer(tmp_path / "a", [1])
    assert again.done == {0, 1, 4}
    assert store.open_layer(tmp_path / "a").missing == [2, 3, 5]
    np.testing.assert_array_equal(again.read("values", 4), _part(4)["values"])


def test_files_do_not_depend_on_the_order(tmp_path):
    for name, order in (("1", range(GROUPS)), ("2", [3, 5, 0, 1, 4, 2])):
        (tmp_path / name).mkdir()
        _layer(tmp_path / name / "a", order)
    assert _contents(tmp_path / "1") == _contents(tmp_path / "2")
    assert len(_contents(tmp_path / "1")) == GROUPS + 1


def test_only_what_belongs_to_the_layer_is_written(tmp_path):
    layer = _layer(tmp_path / "a")
    part = _part(0)
    for wrong in ({"values": part["values"]}, {**part, "bits": part["bits"][:4]}, {**part, "bits": part["bits"] + 0.5}):
        with pytest.raises(AssertionError):
            layer.write(0, **wrong)
    assert layer.missing == list(range(GROUPS))


def test_threads_may_write(tmp_path):
    layer = store.make_layer(tmp_path / "a", ARRAYS, 24)
    threads = [
        threading.Thread(target=lambda start=start: [layer.write(g, **_part(g)) for g in range(start, 24, 4)])
        for start in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    again = store.open_layer(tmp_path / "a")
    assert again.missing == []
    for group in range(24):
        np.testing.assert_array_equal(again.read("values", group), _part(group)["values"])


def test_two_processes_see_each_others_work(tmp_path):
    one, other = _layer(tmp_path / "a"), _layer(tmp_path / "a")
    one.write(3, **_part(3))
    assert [other.has(2), other.has(3)] == [False, True]
    assert other.missing == [0, 1, 2, 4, 5]
    # Written twice, as happens where both began at once.
    other.write(3, **_part(3))
    np.testing.assert_array_equal(one.read("values", 3), _part(3)["values"])


# Damage: noticed by whoever reads, mended by whoever makes.


def _damaged(path: pathlib.Path, how: str) -> None:
    content = bytearray(path.read_bytes())
    if how == "no file":
        path.unlink()
        return
    if how == "flipped":
        content[len(content) // 2] ^= 16
    path.write_bytes({"flipped": content, "empty": b"", "half": content[: len(content) // 2], "zeros": bytes(99)}[how])


HOW = "no file", "flipped", "empty", "half", "zeros"


@pytest.mark.parametrize("how", HOW)
def test_damaged_group_is_noticed_and_made_anew(tmp_path, how: str):
    _layer(tmp_path / "a", range(GROUPS))
    before = _contents(tmp_path)
    _damaged(tmp_path / "a" / "000002", how)
    layer = store.open_layer(tmp_path / "a")
    for group in (2, None):
        message = _refused(layer.read, "values", group)
        assert str(tmp_path / "a" / "000002") in message
        assert "run precompute again: it makes" in message
    np.testing.assert_array_equal(layer.read("values", 1), _part(1)["values"])
    again = _layer(tmp_path / "a")
    assert again.missing == [2]
    again.write(2, **_part(2))
    assert _contents(tmp_path) == before


@pytest.mark.parametrize("how", HOW)
def test_check_finds_damage_that_nobody_reads(tmp_path, how: str):
    _layer(tmp_path / "a", range(GROUPS))
    store.open_layer(tmp_path / "a").check()
    _damaged(tmp_path / "a" / "000004", how)
    assert str(tmp_path / "a" / "000004") in _refused(store.open_layer(tmp_path / "a").check)


def test_names_that_lead_out_of_a_store_are_none():
    kinds = "geometry", "visibility", "environment", "factors", "transport", "table"
    names = {kind: f"{kind}-{'0a' * 8}" for kind in kinds}
    texture = f"texture-{'1b' * 8}"

    def header(**changed):
        known = {**names, **changed}
        material = {"factors": known["factors"], "transport": known["transport"]}
        material |= {"normal_map": known.get("normal_map"), "weight": [texture, [0.5]]}
        material |= {"brdf": {"arrays": {"long": {"layer": known["table"]}, "short": {"shape": [], "values": [1]}}}}
        layers = {kind: known[kind] for kind in ("geometry", "visibility")}
        return {**layers, "environment": {"pixels": known["environment"]}, "materials": [material]}

    assert set(store.layers_of(header())) == {*names.values(), texture}
    for kind in (*names, "normal_map"):
        for wrong in ("/", "..", f"../{names.get(kind, texture)}", "", texture.upper(), "visible-" + "0" * 16):
            with pytest.raises(ValueError, match="is no name of a layer of"):
                store.layers_of(header(**{kind: wrong}))


def test_swapped_groups_are_noticed(tmp_path):
    _layer(tmp_path / "a", range(GROUPS))
    one, other = tmp_path / "a" / "000001", tmp_path / "a" / "000004"
    one.rename(tmp_path / "x")
    other.rename(one)
    (tmp_path / "x").rename(other)
    assert "damaged, it holds 'a/4'" in _refused(store.open_layer(tmp_path / "a").read, "bits", 1)
    assert _layer(tmp_path / "a").missing == [1, 4]


def test_group_of_another_layer_is_noticed(tmp_path):
    for name in "ab":
        _layer(tmp_path / name, range(GROUPS))
    shutil.copy(tmp_path / "a" / "000001", tmp_path / "b" / "000001")
    assert "it holds 'a/1'" in _refused(store.open_layer(tmp_path / "b").read, "bits", 1)


def test_layout_of_more_or_fewer_arrays_is_noticed(tmp_path):
    _layer(tmp_path / "a", range(GROUPS))
    for number, arrays in enumerate([{"bits": ARRAYS["bits"]}, {**ARRAYS, "more": ARRAYS["bits"]}]):
        store.make_layer(tmp_path / str(number), arrays, GROUPS)
        shutil.copy(tmp_path / str(number) / "layout.json", tmp_path / "a" / "layout.json")
        assert "other arrays than the layer" in _refused(store.open_layer(tmp_path / "a").read, "bits", 1)
        assert _layer(tmp_path / "a").missing == []


def test_flipped_bit_is_noticed_wherever_it_is(tmp_path):
    _layer(tmp_path / "a", range(GROUPS))
    files = sorted(path for path in (tmp_path / "a").iterdir())
    assert len(files) == GROUPS + 1
    generator = np.random.default_rng(0)
    for path in files:
        good = path.read_bytes()
        for bit in generator.choice(8 * len(good), 40, replace=False):
            bad = bytearray(good)
            bad[bit // 8] ^= 1 << bit % 8
            path.write_bytes(bad)
            message = _refused(lambda: store.open_layer(tmp_path / "a").read_all())
            assert "run precompute again" in message
        path.write_bytes(good)
    store.open_layer(tmp_path / "a").read_all()


@pytest.mark.parametrize("how", HOW)
def test_damaged_layout_is_noticed_and_made_anew(tmp_path, how: str):
    _layer(tmp_path / "a", range(GROUPS))
    before = _contents(tmp_path)
    _damaged(tmp_path / "a" / "layout.json", how)
    assert "missing or damaged; run precompute again" in _refused(store.open_layer, tmp_path / "a")
    assert _layer(tmp_path / "a").missing == []
    assert _contents(tmp_path) == before


def test_layer_that_is_not_there_is_refused(tmp_path):
    assert "missing or damaged" in _refused(store.open_layer, tmp_path / "a")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("old", [True, False])
def test_what_a_killed_process_left_is_swept(tmp_path, old: bool):
    """But not what another process is writing at this moment."""
    _layer(tmp_path / "a", [0])
    partial = tmp_path / "a" / ".000001.0123"
    partial.write_bytes(b"cut")
    if old:
        long_ago = time.time() - 1000
        os.utime(partial, (long_ago, long_ago))
    assert _layer(tmp_path / "a").done == {0}
    assert partial.exists() != old


def test_full_disk_is_told_and_what_is_done_is_kept(tmp_path, monkeypatch):
    layer = _layer(tmp_path / "a", [0, 1])
    before = _contents(tmp_path)

    def fail(self, content):
        with self.open("wb") as file:
            file.write(content[: len(content) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pathlib.Path, "write_bytes", fail)
        message = _refused(lambda: layer.write(2, **_part(2)))
    assert "No space left on device; what is finished is kept, make room and run again" in message
    assert _contents(tmp_path) == before
    assert store.open_layer(tmp_path / "a").done == layer.done == {0, 1}


def test_header_round_trip(tmp_path):
    store.write_header(
        tmp_path, {"scene": "büste", "method": {"name": "transport", "dials": {"terms": 4}}, "environment": None}
    )
    assert store.read_header(tmp_path) == {
        "format": store.FORMAT,
        "scene": "büste",
        "method": {"name": "transport", "dials": {"terms": 4}},
        "environment": None,
    }
    assert [path.name for path in tmp_path.iterdir()] == ["store.json"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "not a store, or its precomputation was not finished; run precompute"),
        (b"", "damaged; run precompute again"),
        (b'{"format": 7, "sce', "damaged; run precompute again"),
        (b'{"format": 7, "scene": "x"}', "damaged; run precompute again"),
        (b"\xff\xfe\x00", "damaged; run precompute again"),
        (b"[1]", "damaged; run precompute again"),
        (b"{}", "format None is not format 7"),
        (b'{"format": 6}', "format 6 is not format 7"),
        (b'{"format": 8}', "format 8 is not format 7"),
    ],
)
def test_bad_header_is_refused(tmp_path, content, message: str):
    if content is not None:
        (tmp_path / "store.json").write_bytes(content)
    refusal = _refused(store.read_header, tmp_path)
    assert message in refusal
    assert str(tmp_path) in refusal


def test_header_is_replaced_whole(tmp_path, monkeypatch):
    """A write that fails half-way leaves the old header."""
    store.write_header(tmp_path, {"scene": "old"})

    def fail(self, content):
        with self.open("wb") as file:
            file.write(content[:5])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pathlib.Path, "write_bytes", fail)
        assert "No space" in _refused(store.write_header, tmp_path, {"scene": "new"})
    assert store.read_header(tmp_path)["scene"] == "old"


def test_every_flipped_bit_of_the_header_is_noticed(tmp_path):
    store.write_header(
        tmp_path,
        {"scene": "x", "method": {"name": "transport", "dials": {"terms": 4, "scale": 0.5}}, "environment": None},
    )
    path = tmp_path / "store.json"
    good = path.read_bytes()
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        path.write_bytes(bad)
        assert "precompute again" in _refused(store.read_header, tmp_path)
    path.write_bytes(good)
    assert store.read_header(tmp_path)["scene"] == "x"


def test_default_folder_is_in_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = store.default_folder("0123456789abcdef")
    assert folder.name == "0123456789abcdef"
    assert "jaxrelight" in folder.parts
    if sys.platform == "linux":
        assert folder == tmp_path / "jaxrelight" / "0123456789abcdef"


def test_layout_describes_the_arrays(tmp_path):
    """A store explains itself: no pickle, no code needed to read it."""
    layout = json.loads((_layer(tmp_path / "a").folder / "layout.json").read_text())
    assert layout.pop("sha256")
    arrays = {"values": [[4, 3], "float32"], "bits": [[5], "uint8"]}
    assert layout == {"format": store.FORMAT, "groups": GROUPS, "arrays": arrays}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((1, 23), (12, 3)),
        (([0.3, 10.5],), ([0.31, 0.5],)),
        ((np.zeros((1, 11)),), (np.zeros((11, 1)),)),
        (({"a": 1},), (["a", 1],)),
    ],
)
def test_keys_do_not_run_into_each_other(one, other):
    assert store.key_of(*one) != store.key_of(*other)
