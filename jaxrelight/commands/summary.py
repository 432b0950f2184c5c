"""What a command says at its end, in words or as JSON; `notebooks/guide/json.md` documents every key."""

import contextlib
import json
import shutil
import sys
import textwrap
import time
from collections.abc import Iterator, Mapping
from types import MappingProxyType

_SHARES = {
    "kept_energy",
    "albedo_at_degrees",
    "covered",
    "negative",
    "clipped",
    "error",
    "residual",
    "held_out",
    "by_angle",
    "refined",
}


@contextlib.contextmanager
def summary_of(command: str, as_json: bool) -> Iterator[tuple[dict, dict[str, float]]]:
    """A command's summary and its seconds by stage, which are filled in the block; printed where that ends well."""
    start, entries, seconds = time.perf_counter(), {"command": command}, {}
    yield entries, seconds
    seconds["total"] = time.perf_counter() - start
    summarize({**entries, "seconds": seconds}, as_json)


def summarize(summary: dict, as_json: bool, meanings: Mapping[str, str] = MappingProxyType({})) -> None:
    """Prints a summary: one JSON object, or a line for each entry, followed by what it means where that is given."""
    if as_json:
        print(json.dumps(summary), flush=True)
        return
    # Lines of a file or a pipe stay whole.
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else sys.maxsize
    for name, value in summary.items():
        if name not in ("command", "kind"):
            line = f"{name.replace('_', ' '):>16}  {_words(name, value)}"
            line += f"  ({meanings[name]})" if name in meanings else ""
            wrapped = textwrap.wrap(line, width, subsequent_indent=" " * 18, break_on_hyphens=False)
            print("\n".join(wrapped), flush=True)


def _words(name: str, value) -> str:
    """A value as people read it: the name tells its unit."""
    if isinstance(value, dict) and "line" in value:
        return value["line"]
    if isinstance(value, dict):
        # Names that the scene or the disk gives stay as they are.
        given = name in ("meshes", "materials", "bytes")
        entries = (f"{key if given else key.replace('_', ' ')} {_words(name, entry)}" for key, entry in value.items())
        return ", ".join(entries) or "none"
    if isinstance(value, list):
        return ", ".join(_words(name, entry) for entry in value) or "none"
    if value is None:
        return "none"
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "yes" if value else "no"
    if name == "exposure":
        return f"{value:+.2f} stops"
    if name == "seconds":
        return f"{value:.2f} s" if value < 10 else f"{value:.0f} s"
    if name == "milliseconds":
        return f"{value:.3g} ms"
    if name.endswith("bytes"):
        return f"{value / 1e6:,.1f} MB" if value >= 1e5 else f"{value / 1e3:,.1f} kB"
    if name in _SHARES:
        return f"{100 * value:.4g} %"
    if name.startswith("rays") and value >= 1e6:
        return f"{value / 1e6:,.1f} million"
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
