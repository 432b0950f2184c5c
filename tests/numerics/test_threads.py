"""Rows in parts: each once, in order, whatever the number of cores."""

import os
import threading

import pytest

from jaxrelight.numerics.threads import in_parts


@pytest.mark.parametrize("cores", [None, 1, 2, 7])
@pytest.mark.parametrize("count", [0, 1, 9, 100])
def test_every_row_is_in_one_part(monkeypatch, cores: int | None, count: int):
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    parts = in_parts(lambda rows: list(range(count))[rows], count, 5)
    assert [row for part in parts for row in part] == list(range(count))
    assert len(parts) == max(1, count // 5)


def test_parts_are_made_at_once(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    meet = threading.Barrier(3, timeout=60)
    assert in_parts(lambda rows: meet.wait() is not None and rows.start, 30, 10) == [0, 10, 20]


def test_errors_come_through(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)

    def fails(rows: slice):
        raise ValueError(f"rows from {rows.start}")

    with pytest.raises(ValueError, match="rows from 0"):
        in_parts(fails, 8, 1)
