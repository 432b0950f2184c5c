"""Work on the groups of a layer: on all cores, with progress, and only what is missing."""

import concurrent.futures
import os
import random
from collections.abc import Callable, Sequence

import numpy as np
import threadpoolctl

from jaxrelight.files import store


def complete(
    layers: Sequence[store.Layer],
    filled: np.ndarray,
    make: Callable[[int], None],
    report: Callable[[int, int], None],
):
    """Runs make(group), which writes it, for all groups that a layer lacks, on all cores; stops at the first error.

    `filled` counts the receivers of each group.
    """

    def tell():
        done = list(set[int].intersection(*(layer.done for layer in layers)))
        report(int(filled[done].sum()), int(filled.sum()))

    missing = sorted({group for layer in layers for group in layer.missing})
    if missing:
        tell()
    # Another process may be at the same layer: in another order, so that they share the work.
    random.Random(os.getpid()).shuffle(missing)

    def make_if_missing(group: int):
        if not all(layer.has(group) for layer in layers):
            make(group)

    # Groups are what runs at once: threads of their linear algebra would only wait for each other.
    threads = os.cpu_count()
    with threadpoolctl.threadpool_limits(1), concurrent.futures.ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(make_if_missing, group) for group in missing]
        try:
            for future in concurrent.futures.as_completed(futures):
                future.result()
                tell()
        finally:
            for future in futures:
                future.cancel()
