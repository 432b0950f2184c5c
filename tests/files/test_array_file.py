"""Arrays in a file: back as they were, or a word about what is wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxrelight.files.array_file import check_arrays, decode_arrays, encode_arrays

ARRAYS = {
    "values": np.linspace(-1, 1, 24, dtype=np.float32).reshape(2, 3, 4),
    "bits": np.arange(5, dtype=np.uint8),
    "empty": np.zeros((0, 3)),
    "number": np.array(3.5),
}


@given(
    hnp.arrays(st.sampled_from(["f4", "f8", "u1", "u2", "i8", "?", ">f4"]), hnp.array_shapes(min_dims=0, min_side=0))
)
def test_round_trip_keeps_every_bit(array):
    content = encode_arrays("x", {"a": array, "b": array.T})
    decoded = decode_arrays("x", content)
    for name, wanted in (("a", array), ("b", array.T)):
        assert (decoded[name].dtype, decoded[name].shape) == (wanted.dtype, wanted.shape)
        assert decoded[name].tobytes() == wanted.tobytes()
    assert content == encode_arrays("x", {"a": array, "b": array.T})


def test_some_of_the_arrays():
    content = encode_arrays("x", ARRAYS)
    assert list(decode_arrays("x", content, ["number", "bits"])) == ["bits", "number"]
    assert decode_arrays("x", content, []) == {}


@pytest.mark.parametrize("written", [["number", "bits"], ["number", "bits", "whole", "more"]])
def test_arrays_that_were_not_written_are_noticed(written):
    content = encode_arrays("x", {name: np.zeros(2) for name in ("number", "bits", "whole")})
    assert list(decode_arrays("x", content, ["bits"], ["bits", "number", "whole"])) == ["bits"]
    with pytest.raises(ValueError, match="other arrays"):
        decode_arrays("x", content, ["bits"], written)


def test_every_flipped_bit_is_noticed():
    content = bytearray(encode_arrays("layer/3", ARRAYS))
    for bit in range(8 * len(content)):
        content[bit // 8] ^= 1 << bit % 8
        with pytest.raises(ValueError, match="checksum"):
            check_arrays("layer/3", bytes(content))
        content[bit // 8] ^= 1 << bit % 8
    check_arrays("layer/3", bytes(content))


def test_every_cut_and_every_surplus_is_noticed():
    content = encode_arrays("x", ARRAYS)
    for length in range(len(content)):
        with pytest.raises(ValueError, match="checksum"):
            decode_arrays("x", content[:length])
    with pytest.raises(ValueError, match="checksum"):
        decode_arrays("x", content + b"\0")


def test_another_files_content_is_noticed():
    with pytest.raises(ValueError, match="it holds 'layer/4'"):
        decode_arrays("layer/3", encode_arrays("layer/4", ARRAYS))
