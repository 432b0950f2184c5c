"""What long work shows on standard error: how far it is, how long it will take, and notes."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterable, Iterator

# Told the stage, how much of it is done and how much there is.
Report = Callable[[str, int, int], None]
# Seconds between two lines where there is no terminal to draw bars on.
_PAUSE = 10


@contextlib.contextmanager
def progress(quiet: bool = False) -> Iterator[Report]:
    """A report function for the length of the block.

    Draws bars with the time that is left on a terminal, and writes a line now and then to anything else. Somebody who
    interrupts the block is told how far it had come.
    """
    stage, done, total = "nothing", 0, 1
    with _lines(quiet) if quiet or not sys.stderr.isatty() else _bars() as show:

        def report(*state) -> None:
            nonlocal stage, done, total
            stage, done, total = state
            show(stage, done, total)

        try:
            yield report
        except KeyboardInterrupt as stop:
            stop.add_note(f"{_percent(done, total)} of {stage}")
            raise


@contextlib.contextmanager
def _bars():
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    # The last column says what is counted, and is the first to go where the terminal is narrow.
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TaskProgressColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(f"{stage}, {_counted(stage, total)}", total=total)
            bars.update(tasks[stage], completed=done)

        yield show


@contextlib.contextmanager
def _lines(quiet: bool):
    # When each stage began, and how much was done by then.
    began: dict[str, tuple[float, int]] = {}
    last_line = time.monotonic()

    def show(stage: str, done: int, total: int) -> None:
        nonlocal last_line
        now = time.monotonic()
        start, first = began.setdefault(stage, (now, done))
        if not quiet and now - last_line > _PAUSE and first < done < total:
            last_line = now
            left = (now - start) / (done - first) * (total - done)
            print(f"{stage}: {_percent(done, total)} of {_counted(stage, total)}, {left:.0f} s left", file=sys.stderr)

    yield show


def _counted(stage: str, total: int) -> str:
    """Stages count points, but those that are named for what they count."""
    return f"{total:,}" if stage in ("materials", "samples") else f"{total:,} points"


def _percent(done: int, total: int) -> str:
    return f"{100 * done // max(total, 1)} %"


def notes(lines: Iterable[str]) -> None:
    """Writes what was mended, assumed or left out."""
    for line in lines:
        print(f"note: {line}", file=sys.stderr)
