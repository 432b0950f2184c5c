"""Rows in parts, on all of a machine's cores."""

import concurrent.futures
import itertools
import os
from collections.abc import Callable
from typing import TypeVar

_Part = TypeVar("_Part")


def in_parts(function: Callable[[slice], _Part], count: int, size: int) -> list[_Part]:
    """What a function makes of rows, part after part; the parts are made on as many threads as there are cores.

    Small parts are faster than one for each core: what is made for them stays in caches.

    Args:
        function: of some of the rows; NumPy and ray queries let others run meanwhile.
        count: of rows.
        size: of a part, at least.
    """
    parts = max(1, count // max(size, 1))
    ends = [count * k // parts for k in range(parts + 1)]
    slices = [slice(*pair) for pair in itertools.pairwise(ends)]
    threads = min(os.cpu_count() or 1, parts)
    if threads == 1:
        return [function(rows) for rows in slices]
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, slices))
