"""Writes dials.md from the classes of the lighting methods; `--check` tells whether it is up to date."""

import dataclasses
import inspect
import pathlib
import sys

from jaxrelight.methods import METHODS, documentation

PAGE = pathlib.Path(__file__).with_name("dials.md")
START = """# Dials

Each lighting method is a frozen dataclass in `jaxrelight/methods.py`, from which this page is made
(`python notebooks/guide/write_dials.py`). On the command line a dial is an option of the same name, with hyphens:
`--compression-tolerance 0.05`. Those marked with * are shown by `--help-all`, and accepted without it.
"""


def page() -> str:
    """The whole page."""
    parts = [START]
    for method in METHODS.values():
        summary = (inspect.getdoc(method) or "").partition("\n\nRaises:")[0]
        parts.append(f"## {method.__name__}\n\n{summary}\n\n| dial | default | what |\n|---|---|---|")
        texts = documentation(method)
        for field in dataclasses.fields(method):
            mark = " *" if field.name in method.advanced else ""
            text = texts[field.name].replace("|", "\\|")
            parts.append(f"| `{field.name}`{mark} | `{field.default!r}` | {text} |")
        parts.append("")
    return "\n".join(parts).rstrip() + "\n"


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit(PAGE.read_text(encoding="utf-8") != page())
    PAGE.write_text(page(), encoding="utf-8")
