"""Work on the groups of a layer: by an executor, with progress, and only what is missing."""

import concurrent.futures
import os
import random
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import threadpoolctl
from jaxtyping import Int

from jaxrelight.files import store


@runtime_checkable
class Executor(Protocol):
    """What runs the groups of a pass, in any order and any number at once: threads here, other machines elsewhere.

    Groups do not depend on each other, and `make` writes its result into the store, so that an executor has nothing to
    send back.
    """

    def run(self, make: Callable[[int], None], groups: Sequence[int]) -> Iterator[int]:
        """Calls make(group) for each group; gives the number of each that is done, and raises its first error."""
        ...


class Threads:
    """All cores of this machine, a thread each."""

    def run(self, make: Callable[[int], None], groups: Sequence[int]) -> Iterator[int]:
        """Runs the groups as `Executor.run` does; after an error no other group is begun."""
        # Groups are what runs at once: threads of their linear algebra would only wait for each other.
        with threadpoolctl.threadpool_limits(1), concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            groups_by_future = {pool.submit(make, group): group for group in groups}
            try:
                for future in concurrent.futures.as_completed(groups_by_future):
                    future.result()
                    yield groups_by_future[future]
            finally:
                for future in groups_by_future:
                    future.cancel()


def complete(
    layers: Sequence[store.Layer],
    filled: Int[np.ndarray, " g"],
    make: Callable[[int], None],
    report: Callable[[int, int], None],
    executor: Executor | None = None,
) -> None:
    """Runs make(group), which writes it, for all groups that a layer lacks; stops at the first error.

    Args:
        layers: which a group is written to.
        filled: receivers of each group.
        make: makes and writes one.
        report: called with the receivers that are done, and with all.
        executor: what runs the groups; all cores of this machine by default.
    """

    def report_done() -> None:
        done = list(set[int].intersection(*(layer.done for layer in layers)))
        report(int(filled[done].sum()), int(filled.sum()))

    missing = sorted({group for layer in layers for group in layer.missing})
    if missing:
        report_done()
    # Another process may be at the same layer: in another order, so that they share the work.
    random.Random(os.getpid()).shuffle(missing)

    def make_if_missing(group: int) -> None:
        if not all(layer.has(group) for layer in layers):
            make(group)

    for _ in (executor or Threads()).run(make_if_missing, missing):
        report_done()
