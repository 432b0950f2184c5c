"""Archives from anywhere."""

import contextlib
import io
import zipfile

import numpy as np
import pytest

from jaxrelight.errors import InputError
from jaxrelight.files.npz import read_npz


def test_arrays_come_back_with_their_types(tmp_path):
    arrays = {"a": np.arange(6, dtype=np.uint16).reshape(2, 3), "b": np.float32(2.5), "c": np.zeros((0, 3))}
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    restored = read_npz(tmp_path / "a.npz", "arrays", "abc")
    assert restored.keys() == arrays.keys()
    for name, array in arrays.items():
        assert restored[name].dtype == np.asarray(array).dtype
        np.testing.assert_array_equal(restored[name], array)


def test_every_cut_and_every_flipped_bit_is_told(tmp_path):
    """Or does no harm: some bytes of an archive say nothing of its content."""
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(20.0))
    whole = path.read_bytes()
    for end in range(0, len(whole), 7):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError, match="damaged, cut short or no"):
            read_npz(path, "arrays", "a")
    for place in range(0, len(whole), 3):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 16]) + whole[place + 1 :])
        restored = {}
        with contextlib.suppress(InputError):
            restored = read_npz(path, "arrays", "a")
        np.testing.assert_array_equal(restored.get("a", np.arange(20.0)), np.arange(20.0))


def _with_header(path, shape: str, descr: str = "<f8"):
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", content)


def test_a_size_that_is_a_lie_takes_no_memory(tmp_path):
    path = tmp_path / "a.npz"
    _with_header(path, "(1000000, 1000000)")
    with pytest.raises(InputError, match="is larger than 1 GiB"):
        read_npz(path, "arrays", "a")


def test_what_is_no_number_or_no_file_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    _with_header(path, "(1,)", "<U5")
    with pytest.raises(InputError, match="'a' does not hold real numbers"):
        read_npz(path, "arrays", "a")
    np.savez(path, a=np.array([{}], object))
    with pytest.raises(InputError, match="'a' does not hold real numbers"):
        read_npz(path, "arrays", "a")
    with pytest.raises(InputError, match="cannot be read as arrays: No such file"):
        read_npz(tmp_path / "none.npz", "arrays", "a")
    with pytest.raises(InputError, match="not a regular file"):
        read_npz(tmp_path, "arrays", "a")
    plain = io.BytesIO()
    np.save(plain, np.arange(3))
    path.write_bytes(plain.getvalue())
    with pytest.raises(InputError, match="cut short or no"):
        read_npz(path, "arrays", "a")


def test_what_is_not_wanted_is_not_looked_at(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.ones(2), note=np.array("text"), object=np.array([{}], object))
    assert read_npz(tmp_path / "a.npz", "arrays", ("a", "b")).keys() == {"a"}
