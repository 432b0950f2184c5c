"""Writes gradients.md from the registry of derivatives; `--check` tells whether it is up to date."""

import pathlib
import sys
from collections.abc import Iterator

from fitting import gradients as of_fitting
from jaxrelight.gradients.entry import FOLLOWS, Entry, Exempt
from jaxrelight.gradients.registry import entries

PAGE = pathlib.Path(__file__).with_name("gradients.md")
START = """# Derivatives

What every public function that takes or returns arrays can be differentiated in. This page is made from the registry in
`jaxrelight/gradients` (`python notebooks/guide/write_gradients.py`); for each row of the first table a test compares
derivatives with differences in double precision, in forward and in reverse mode, and of second order where it says so.
It checks, too, that `jax.jit` and `jax.vmap` change no result, that a second call compiles nothing, that results have
the type of what is given, and that a NaN in one item of a batch leaves values and gradients of the others as they were.

Derivatives are exact, and without noise, of what is computed. What is held fixed has none: a shadow's edge does not
move with the lamp, and the derivative is that of the light within it. At a kink one of the slopes beside it is chosen,
never their mean where the function is smooth there: at texels' centres and at the ends of a range it is the slope
inside.

Names are in `jaxrelight`, or in `fitting` where they say so. Functions with commas between them are forms of the first,
or parts that it is made of.

| function | differentiable in | orders | held fixed | at kinks and ends |
|---|---|---|---|---|
"""
MIDDLE = """
## Without derivatives

By the reason why not, and by module.
"""


def _names(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name.removeprefix('jaxrelight.')}`" for name in names)


def _row(entry: Entry) -> str:
    ends = [text for text in (entry.kinks, entry.ends) if text]
    ends += [f"type: {entry.dtypes}"] if entry.dtypes != FOLLOWS else []
    ends += [f"NaN: {entry.nan}"] if entry.nan else []
    cells = _names(entry.names), entry.differentiable_in, str(entry.orders), entry.fixed, "; ".join(ends)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _exempt(all_of_them: list[Exempt]) -> Iterator[str]:
    by_reason: dict[str, list[str]] = {}
    for entry in all_of_them:
        by_reason.setdefault(entry.why, []).extend(entry.names)
    for why, names in by_reason.items():
        yield f"\n**{why[0].upper()}{why[1:]}**\n"
        by_module: dict[str, list[str]] = {}
        for name in names:
            *module, last = name.removeprefix("jaxrelight.").split(".")
            owner = module.pop() if module[-1][0].isupper() else None
            by_module.setdefault(".".join(module), []).append(f"{owner}.{last}" if owner else last)
        for module, own in by_module.items():
            yield f"- `{module}`: {', '.join(f'`{name}`' for name in own)}"


def page() -> str:
    """The whole page."""
    every = (*entries(), *of_fitting.ENTRIES)
    rows = [_row(entry) for entry in every if isinstance(entry, Entry)]
    exempt = list(_exempt([entry for entry in every if isinstance(entry, Exempt)]))
    return START + "\n".join(rows) + "\n" + MIDDLE + "\n".join(exempt) + "\n"


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit(PAGE.read_text(encoding="utf-8") != page())
    PAGE.write_text(page(), encoding="utf-8")
