"""Array lengths: few of them, and little of them padding."""

import itertools

import pytest

from jaxrelight.buckets import bucket


@pytest.mark.parametrize("least", [8, 1024])
def test_lengths_hold_what_is_asked_and_little_more(least: int):
    counts = [*range(1, 3 * least, max(1, least // 50)), 10**6 + 1, 12345678]
    for count in counts:
        size = bucket(count, least)
        assert count <= size <= max(least, count * 9 / 8)
        assert bucket(size, least) == size
    assert all(bucket(a, least) <= bucket(b, least) for a, b in itertools.pairwise(counts))


def test_lengths_are_few():
    assert len({bucket(count, 1024) for count in range(1, 2**17, 7)}) == 1 + 7 * 8


def test_lengths_next_to_a_step():
    assert [bucket(count, 1024) for count in (0, 1, 1024, 1025, 1152, 1153, 2048, 2049)] == [
        1024, 1024, 1024, 1152, 1152, 1280, 2048, 2304,
    ]  # fmt: skip
