"""Array lengths: few of them, and little of them padding."""

import itertools

import pytest

from jaxrelight.numerics.buckets import bucket, image_bucket


@pytest.mark.parametrize("steps", [1, 2, 8])
@pytest.mark.parametrize("least", [8, 1024])
def test_lengths_hold_what_is_asked_and_little_more(least: int, steps: int):
    counts = [*range(1, 3 * least, max(1, least // 50)), 10**6 + 1, 12345678]
    for count in counts:
        size = bucket(count, least, steps)
        assert count <= size <= max(least, count * (1 + 1 / steps))
        assert bucket(size, least, steps) == size
    assert all(bucket(a, least, steps) <= bucket(b, least, steps) for a, b in itertools.pairwise(counts))


@pytest.mark.parametrize("steps", [2, 8])
def test_lengths_are_few(steps: int):
    assert len({bucket(count, 1024, steps) for count in range(1, 2**17, 7)}) == 1 + 7 * steps


def test_images_come_in_few_sizes_that_lattices_divide():
    sizes = [image_bucket(length) for length in range(1, 2049)]
    assert all(size >= length and size % 32 == 0 for length, size in enumerate(sizes, start=1))
    assert all(size == 64 or size - length < max(32, length / 8) for length, size in enumerate(sizes, start=1))
    assert len(set(sizes)) == 7 + 3 * 8
    assert image_bucket(250) == image_bucket(256) == 256


def test_lengths_next_to_a_step():
    assert [bucket(count, 1024) for count in (0, 1, 1024, 1025, 1152, 1153, 2048, 2049)] == [
        1024, 1024, 1024, 1152, 1152, 1280, 2048, 2304,
    ]  # fmt: skip
