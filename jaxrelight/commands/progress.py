"""What a long command shows, and what it prints at its end."""

import contextlib
import json
import sys
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def progress(quiet: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """A report function (stage, done, total) that draws bars on standard error while the block runs."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description:>28}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal) as bars:
        tasks = {}

        def report(stage: str, done: int, total: int):
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done)

        yield report


def notes(lines) -> None:
    """What was mended, on standard error."""
    for line in lines:
        print(f"note: {line}", file=sys.stderr)


def summarize(summary: dict, as_json: bool) -> None:
    """Prints a summary: one JSON object, or a line for each entry."""
    if as_json:
        print(json.dumps(summary))
        return
    for name, value in summary.items():
        if isinstance(value, dict):
            value = ", ".join(f"{key} {_short(entry)}" for key, entry in value.items())
        print(f"{name.replace('_', ' '):>16}  {_short(value)}")


def versions() -> dict[str, str]:
    """Of this package and of those that its numbers depend on."""
    import importlib.metadata

    return {name: importlib.metadata.version(name) for name in ("jaxrelight", "jax", "embreex")}


def _short(value) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return str(value)
