"""Groups of a pass: each that is missing is made once, whatever runs them, and the first error ends it."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from jaxrelight.precomputation.groups import Executor, Threads, complete

FILLED = np.array([4, 1, 3, 2])


class Held:
    """What `complete` asks of a layer, in memory."""

    def __init__(self, *done: int):
        self.done = set(done)

    @property
    def missing(self) -> set[int]:
        return set(range(len(FILLED))) - self.done

    def has(self, group: int) -> bool:
        return group in self.done


class OneByOne:
    """An executor of somebody else."""

    def run(self, make: Callable[[int], None], groups: Sequence[int]) -> Iterator[int]:
        for group in groups:
            make(group)
            yield group


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize("executor", [None, Threads(), OneByOne()])
def test_what_is_missing_is_made_once(executor: Executor | None):
    layers: Any = Held(1), Held(1, 3)
    made, reported = [], []

    def make(group: int) -> None:
        made.append(group)
        for layer in layers:
            layer.done.add(group)

    complete(layers, FILLED, make, lambda done, total: reported.append((done, total)), executor)
    assert sorted(made) == [0, 2, 3]
    assert reported[0] == (1, 10)
    assert reported[-1] == (10, 10)
    complete(layers, FILLED, make, lambda done, total: reported.append((done, total)), executor)
    assert len(made) == 3


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize("executor", [Threads(), OneByOne()])
def test_the_first_error_is_raised(executor: Executor):
    layers: Any = (Held(),)

    def make(group: int) -> None:
        raise OSError(f"no space left for group {group}")

    with pytest.raises(OSError, match="no space left"):
        complete(layers, FILLED, make, lambda done, total: None, executor)
