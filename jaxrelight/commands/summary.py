"""What a command says at its end, in words or, with --json, as one JSON object on one line of standard output.

Keys stay what they are from version to version; new ones may come. Numbers are in the unit that the key names, without
rounding. A command that fails prints nothing on standard output: one line on standard error says why, with or without
--json, and the exit status is 1 (2 for a wrong command line, 130 when it was interrupted).

All commands that light, and, without seconds, info of a store:

    command          render, precompute, relight, demo, info
    versions         of jaxrelight, jax and embreex
    lighting         transport, indirect, prefiltered or adaptive
    settings         the method's dials, by their names in Python
    seconds          by stage, in the order they came: imports (of libraries), load (the scene and its lights);
                     geometry, visibility, transport, bounce 1 …, or cloud, between, pixels (of a precomputation);
                     open (the store), environment (and local lights); view, light and shade (with what is compiled),
                     write; total

Precomputed lighting, transport and indirect:

    store            folder
    receivers        vertices, or pixels that see a surface
    rays             traced by this run; 0 if all was there
    rays_per_second  of the stages that trace them
    bytes            on disk, by kind of layer
    operator_bytes   in memory
    kept_energy      share of transport energy that the kept coefficients hold, 0 … 1

A picture (render, relight; demo: picture alone):

    picture          file
    width, height    pixels
    covered          share of pixels that see a surface, 0 … 1
    mean_radiance    of those, all channels
    lights           how many local ones
    leaves_out       list: the light that the method does not have; notes on standard error say it, too

Under an environment, adaptive lighting has samples (of a pixel, on average), shaded (share of pixels, 0 … 1),
predicted_error {between_pixels, samples: root mean square of displayed values} and, with --maps, maps {name: its
smallest and largest value}.

demo: milliseconds {change_of_view, change_of_light, shading}; error {coefficients, without_worst_5_percent}: relative
L2 against all coefficients.

info says `kind` first. A store: scene, rows (of the operator), materials {name: terms}, unused_layers (names; may be
deleted), lights, leaves_out and, under transport, largest_error_for_unit_light (of any row, under light of
root-mean-square radiance 1). A scene: scene (file), meshes {number:name: {vertices, faces, material}}, vertices,
materials {name: diffuse or glossy}, camera {width, height, fov_y}, environment {width, height} or null, lights. An
image: image (file), width, height, channels, largest and mean (of the finite pixels; mean by channel), negative_pixels,
not_finite_pixels. A measured BRDF: brdf (file), format, channels, albedo_at_degrees {angle from the normal: share of
the light that is reflected, of the brightest channel}.
"""

import contextlib
import json
import shutil
import sys
import textwrap
import time
from collections.abc import Iterator

_SHARES = {"kept_energy", "albedo_at_degrees", "covered", "error", "residual", "held_out", "by_angle", "refined"}


@contextlib.contextmanager
def summary_of(command: str, as_json: bool) -> Iterator[tuple[dict, dict[str, float]]]:
    """A command's summary and its seconds by stage, which are filled in the block; printed where that ends well."""
    start, entries, seconds = time.perf_counter(), {"command": command}, {}
    yield entries, seconds
    seconds["total"] = time.perf_counter() - start
    summarize({**entries, "seconds": seconds}, as_json)


def summarize(summary: dict, as_json: bool) -> None:
    """Prints a summary: one JSON object, or a line for each entry."""
    if as_json:
        print(json.dumps(summary), flush=True)
        return
    # Lines of a file or a pipe stay whole.
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else sys.maxsize
    for name, value in summary.items():
        if name not in ("command", "kind"):
            line = f"{name.replace('_', ' '):>16}  {_words(name, value)}"
            wrapped = textwrap.wrap(line, width, subsequent_indent=" " * 18, break_on_hyphens=False)
            print("\n".join(wrapped), flush=True)


def _words(name: str, value) -> str:
    """A value as people read it: the name tells its unit."""
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
