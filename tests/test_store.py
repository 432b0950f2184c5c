"""The store: names by content, layers that resume, and damage that is found."""

import json
import pathlib
import shutil
import subprocess
import sys
import threading

import numpy as np
import pytest

from jaxrelight import InputError, store

GROUPS = 6
ARRAYS = {"values": ((4, 3), np.dtype(np.float32)), "bits": ((5,), np.dtype(np.uint8))}


def _part(group: int) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(group)
    return {
        "values": generator.normal(size=(4, 3)).astype(np.float32),
        "bits": generator.integers(1, 255, 5).astype(np.uint8),
    }


def _layer(folder: pathlib.Path, write=()) -> store.Layer:
    layer = store.Layer(folder, ARRAYS, GROUPS)
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
    code = "import numpy as np; from jaxrelight import store; print(store.key_of({'b': np.arange(3), 'a': ['x', 1.5]}))"
    found = {
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={"PYTHONHASHSEED": seed},
            cwd=pathlib.Path(__file__).parents[1],
        ).stdout.strip()
        for seed in ("1", "2")
    }  # fmt: skip
    assert found == {store.key_of({"a": ["x", 1.5], "b": np.arange(3)})}
    assert all(len(key) == 16 and int(key, 16) >= 0 for key in found)


def test_layer_gives_back_what_was_written(tmp_path):
    _layer(tmp_path / "a", range(GROUPS)).finish()
    layer = store.open_layer(tmp_path / "a")
    assert layer.missing == []
    for group in range(GROUPS):
        for name, expected in _part(group).items():
            found = layer.read(name, group)
            assert found.dtype == expected.dtype
            np.testing.assert_array_equal(found, expected)
    together = layer.read("values")
    np.testing.assert_array_equal(together, np.stack([_part(group)["values"] for group in range(GROUPS)]))
    assert layer.nbytes == sum(map(len, _contents(tmp_path / "a").values()))


def test_layer_resumes(tmp_path):
    first = _layer(tmp_path / "a", [4, 0])
    assert first.missing == [1, 2, 3, 5]
    first.finish()
    again = _layer(tmp_path / "a", [1])
    assert again.done == {0, 1, 4}
    assert store.open_layer(tmp_path / "a").missing == [2, 3, 5]
    np.testing.assert_array_equal(again.read("values", 4), _part(4)["values"])


def test_zeros_are_written_and_read(tmp_path):
    """Zarr keeps no file for a chunk of zeros: only the journal tells it from a missing one."""
    layer = _layer(tmp_path / "a")
    layer.write(2, values=np.zeros((4, 3), np.float32), bits=np.zeros(5, np.uint8))
    again = store.open_layer(tmp_path / "a")
    assert again.done == {2}
    assert not again.read("values", 2).any()


def test_chunk_without_a_journal_line_is_missing(tmp_path):
    layer = _layer(tmp_path / "a", range(GROUPS))
    (layer.folder / "done").write_text("0\n3\n")
    assert store.open_layer(tmp_path / "a").missing == [1, 2, 4, 5]


@pytest.mark.parametrize("ending", ["1", "4", "12"])
def test_unfinished_journal_line_is_ignored(tmp_path, ending: str):
    """A killed run may have written the first digits of a number."""
    layer = _layer(tmp_path / "a", [0, 2])
    with (layer.folder / "done").open("a") as journal:
        journal.write(ending)
    assert store.open_layer(tmp_path / "a").done == {0, 2}


def test_groups_that_cannot_be_are_ignored(tmp_path):
    layer = _layer(tmp_path / "a", [0])
    with (layer.folder / "done").open("a") as journal:
        journal.write(f"{GROUPS}\nx\n\n-1\n")
    assert store.open_layer(tmp_path / "a").done == {0}


def test_partial_files_are_swept(tmp_path):
    layer = _layer(tmp_path / "a", [0])
    partial = layer.folder / "values" / "c" / "x.partial"
    partial.write_bytes(b"cut")
    _layer(tmp_path / "a")
    assert not partial.exists()


def test_folder_without_layout_is_made_anew(tmp_path):
    """A run killed while it made the layer leaves no layout."""
    layer = _layer(tmp_path / "a", range(GROUPS))
    (layer.folder / "layout.json").unlink()
    again = _layer(tmp_path / "a")
    assert again.missing == list(range(GROUPS))
    assert not again.read("values").any()


def test_finished_layer_does_not_depend_on_the_order(tmp_path):
    for name, order in (("a", range(GROUPS)), ("b", [3, 5, 0, 1, 4, 2])):
        _layer(tmp_path / name, order).finish()
    assert _contents(tmp_path / "a") == _contents(tmp_path / "b")
    assert (tmp_path / "a" / "done").read_text() == "all\n"


def test_unfinished_layer_is_not_called_finished(tmp_path):
    layer = _layer(tmp_path / "a", range(GROUPS - 1))
    layer.finish()
    assert store.open_layer(tmp_path / "a").missing == [GROUPS - 1]


def test_threads_may_write(tmp_path):
    layer = store.Layer(tmp_path / "a", ARRAYS, 24)
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


def test_flipped_bit_is_found_in_every_chunk(tmp_path):
    _layer(tmp_path / "a", range(GROUPS)).finish()
    chunks = sorted(path for path in (tmp_path / "a").rglob("c/*/**/*") if path.is_file())
    assert len(chunks) == GROUPS * len(ARRAYS)
    generator = np.random.default_rng(0)
    for chunk in chunks:
        name, group = chunk.relative_to(tmp_path / "a").parts[0], int(chunk.relative_to(tmp_path / "a").parts[2])
        good = chunk.read_bytes()
        for bit in generator.choice(8 * len(good), 4, replace=False):
            bad = bytearray(good)
            bad[bit // 8] ^= 1 << bit % 8
            chunk.write_bytes(bad)
            layer = store.open_layer(tmp_path / "a")
            for part in (group, slice(None)):
                message = _refused(layer.read, name, part)
                assert str(tmp_path / "a") in message
                assert f"'{name}' is damaged" in message
        chunk.write_bytes(good)
    store.open_layer(tmp_path / "a").read("values")


@pytest.mark.parametrize("length", [0, 3, 10])
def test_cut_chunk_is_found(tmp_path, length: int):
    layer = _layer(tmp_path / "a", range(GROUPS))
    chunk = next(path for path in (tmp_path / "a" / "values" / "c" / "2").rglob("*") if path.is_file())
    chunk.write_bytes(chunk.read_bytes()[:length])
    assert "'values' is damaged" in _refused(layer.read, "values", 2)


@pytest.mark.parametrize("victim", ["layout.json", "zarr.json", "values/zarr.json"])
@pytest.mark.parametrize("left", ["nothing", "half", "no text", "no file"])
def test_damaged_description_is_refused(tmp_path, victim: str, left: str):
    _layer(tmp_path / "a", range(GROUPS)).finish()
    path = tmp_path / "a" / victim
    content = path.read_bytes()
    if left == "no file":
        path.unlink()
    else:
        path.write_bytes({"nothing": b"", "half": content[: len(content) // 2], "no text": b"\xff\xfe\x00"}[left])
    message = _refused(store.open_layer, tmp_path / "a")
    assert "damaged" in message
    assert "run" in message


def test_layer_that_is_not_there_is_refused(tmp_path):
    assert "missing or damaged" in _refused(store.open_layer, tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_full_disk_is_told_and_what_is_done_is_kept(tmp_path, monkeypatch):
    layer = _layer(tmp_path / "a", [0, 1])

    class Full:
        def __setitem__(self, group, values):
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setitem(layer._arrays, "values", Full())
        message = _refused(lambda: layer.write(2, **_part(2)))
    assert "No space left on device; what is finished is kept" in message
    again = store.open_layer(tmp_path / "a")
    assert again.done == {0, 1}
    np.testing.assert_array_equal(again.read("values", 1), _part(1)["values"])


def test_header_round_trip(tmp_path):
    store.write_header(tmp_path, {"scene": "büste", "settings": {"terms": 4}, "environment": None})
    assert store.read_header(tmp_path) == {
        "format": store.FORMAT,
        "scene": "büste",
        "settings": {"terms": 4},
        "environment": None,
    }
    assert [path.name for path in tmp_path.iterdir()] == ["store.json"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "not a store, or its precomputation was not finished; run precompute"),
        (b"", "damaged; run precompute again"),
        (b'{"format": 1, "sce', "damaged; run precompute again"),
        (b"\xff\xfe\x00", "damaged; run precompute again"),
        (b"[1]", "format None is not format 2"),
        (b"{}", "format None is not format 2"),
        (b'{"format": 0}', "format 0 is not format 2"),
        (b'{"format": 1}', "format 1 is not format 2"),
    ],
)
def test_bad_header_is_refused(tmp_path, content, message: str):
    if content is not None:
        (tmp_path / "store.json").write_bytes(content)
    found = _refused(store.read_header, tmp_path)
    assert message in found
    assert str(tmp_path) in found


def test_header_is_replaced_whole(tmp_path, monkeypatch):
    """A write that fails half-way leaves the old header."""
    store.write_header(tmp_path, {"scene": "old"})

    def fail(self, text, encoding):
        self.write_bytes(text.encode(encoding)[:5])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pathlib.Path, "write_text", fail)
        with pytest.raises(OSError, match="No space"):
            store.write_header(tmp_path, {"scene": "new"})
    assert store.read_header(tmp_path)["scene"] == "old"


def test_default_folder_is_in_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = store.default_folder("0123456789abcdef")
    assert folder.name == "0123456789abcdef"
    assert "jaxrelight" in folder.parts
    if sys.platform == "linux":
        assert folder == tmp_path / "jaxrelight" / "0123456789abcdef"


def test_layout_describes_the_arrays(tmp_path):
    """A store explains itself: no pickle, no code needed to read it."""
    layer = _layer(tmp_path / "a", range(GROUPS))
    layout = json.loads((layer.folder / "layout.json").read_text())
    assert layout == {"groups": GROUPS, "arrays": {"values": [[4, 3], "float32"], "bits": [[5], "uint8"]}}


def test_layer_can_be_moved(tmp_path):
    _layer(tmp_path / "a", range(GROUPS)).finish()
    shutil.move(tmp_path / "a", tmp_path / "b")
    np.testing.assert_array_equal(store.open_layer(tmp_path / "b").read("values", 3), _part(3)["values"])


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


def _filled(folder, groups=3):
    layer = store.Layer(folder, {"x": ((2,), np.dtype(np.float32))}, groups)
    for group in range(groups):
        layer.write(group, x=np.full(2, group, np.float32))
    return layer


def test_a_line_cut_short_is_not_gone_on_with(tmp_path):
    layer = store.Layer(tmp_path / "x", {"x": ((2,), np.dtype(np.float32))}, 20)
    layer.write(0, x=np.ones(2, np.float32))
    with (tmp_path / "x" / "done").open("a") as journal:
        journal.write("1")
    layer = store.open_layer(tmp_path / "x")
    layer.write(5, x=np.ones(2, np.float32))
    assert store.open_layer(tmp_path / "x").done == {0, 5}


@pytest.mark.parametrize("group", [0, 2])
def test_a_chunk_that_is_gone_is_noticed(tmp_path, group):
    # The first group holds nothing but zeros, which are written all the same.
    _filled(tmp_path / "x").finish()
    (tmp_path / "x" / "x" / "c" / str(group) / "0").unlink()
    with pytest.raises(InputError, match="1 groups are lost"):
        store.open_layer(tmp_path / "x")


@pytest.mark.parametrize("text", ["", "{", "{}", '{"shape": [1]}'])
def test_damaged_array_metadata_is_one_line(tmp_path, text):
    _filled(tmp_path / "x").finish()
    (tmp_path / "x" / "x" / "zarr.json").write_text(text)
    with pytest.raises(InputError, match="delete this folder") as caught:
        store.Layer(tmp_path / "x", {"x": ((2,), np.dtype(np.float32))}, 3)
    assert "\n" not in str(caught.value)
