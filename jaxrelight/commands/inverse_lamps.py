"""jaxrelight inverse lamps: lamps that meet targets of illuminance, or a painted picture."""

import csv
import dataclasses
import math
import pathlib
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.options import (
    Json,
    LightOptions,
    LinearLighting,
    Modules,
    ReportFolder,
    ScenePath,
    StoreFolder,
    Up,
    check_toml,
    import_modules,
    make_folder,
)
from jaxrelight.commands.summary import summary_of
from jaxrelight.errors import InputError
from jaxrelight.timing import timed

if TYPE_CHECKING:
    from jaxrelight.inverse.solve_lamps import InverseLamps
    from jaxrelight.lighting.contract import Relighter


@dataclasses.dataclass(frozen=True)
class InverseLampsCommand:
    """Solve for lamps such that sensors meet targets of illuminance, or the picture a painted one.

    What is free of which [[light]], and the targets, stand in a file of their own; see the guide. Shadow boundaries are
    held fixed in each step, and cast anew after it.
    """

    scene: ScenePath
    targets: Annotated[tyro.conf.Positional[pathlib.Path], tyro.conf.arg(metavar="TARGETS")]
    """A .toml file of [[target]] by sensors, or of a picture, and of [[lamp]]: what is free."""
    output: Annotated[pathlib.Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None
    """A .toml file for the lamps found, as [[light]] that --lights of other commands read."""
    lighting: LinearLighting = "auto"
    """The lighting method, as for `render` and `measure`."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    store: StoreFolder = None
    report: ReportFolder = None
    """A folder for tables of targets and unknowns, and of a picture its target, what was found and the difference."""
    up: Up = "y"
    modules: Modules = ()
    json: Json = False

    # What `with_dials` tells of the method that cannot measure.
    cannot: ClassVar[str] = "plans samples for one light; solve with another method"

    def run(self) -> None:
        """Runs the command."""
        with summary_of("inverse lamps", self.json) as (summary, seconds):
            with timed(seconds, "imports"):
                from jaxrelight.commands.pictures import describe, prepared
                from jaxrelight.inverse.lamp_files import read_lamp_task
                from jaxrelight.inverse.solve_lamps import lamps
                from jaxrelight.progress import notes, progress
                from jaxrelight.scene.light_text import check_writable_lights, lights_text
                from jaxrelight.scene.mesh_scene import open_scene

                import_modules(self.modules)
            with timed(seconds, "load"):
                task = read_lamp_task(self.targets)
                scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite, up=self.up)
                lights = self.light.lights(scene.lights, scene.emits)
                scene = scene.at_sensors() if task.is_of_sensors else scene
            check_toml(self.output, "lamps")
            make_folder("--report", self.report)
            if self.output is not None:
                check_writable_lights(lights.local)
            notes(dict.fromkeys((*scene.notes, *lights.notes)))
            with progress(self.json) as report:
                relighter = prepared(scene, method_of(self), self.store, report, summary, seconds)
                with timed(seconds, "solve"):
                    found = lamps(
                        relighter,
                        task.targets,
                        free=("intensity",) if task.free is None else task.free,
                        lights=lights,
                        box=task.boxes or None,
                        weight=task.weight,
                        report=report,
                        **task.options,
                    )
            if self.output is not None:
                _write(self.output, lights_text(found.lamps))
                summary["lamps"] = str(self.output)
            if self.report is not None:
                with timed(seconds, "report"):
                    write_report(self.report, found, relighter, task.targets)
                summary["report"] = str(self.report)
            if not self.json:
                print("\n".join(tables_of(found)), flush=True)
            else:
                summary |= told(found)
            summary |= {"residual": found.residual, "starts": list(found.starts)}
            summary |= {"undetermined": list(found.undetermined), "held_fixed": list(found.held_fixed)}
            summary |= describe(relighter)


def told(found: "InverseLamps") -> dict[str, Any]:
    """Targets and unknowns for programs: a deviation that is infinite is null."""
    unknowns = [
        {
            "name": one.name,
            "value": one.value,
            "deviation": one.deviation if math.isfinite(one.deviation) else None,
            "unit": one.unit,
            "determined": one.is_determined,
        }
        for one in found.unknowns
    ]
    return {"targets": [fit._asdict() for fit in found.targets], "unknowns": unknowns}


def tables_of(found: "InverseLamps") -> list[str]:
    """Lines that tell targets and unknowns."""
    targets = [("target", "asked", "found", "off")]
    targets += [(fit.what, f"{fit.target:.4g}", f"{fit.found:.4g}", f"{fit.error:+.2%}") for fit in found.targets]
    unknowns = [("unknown", "found", "±", "")]
    for one in found.unknowns:
        spread = f"{one.deviation:.2g}" if one.is_determined else "not determined"
        unknowns.append((one.name, f"{one.value:.4g}", spread, one.unit))
    return [*_aligned(targets), "", *_aligned(unknowns), ""]


def write_report(folder: pathlib.Path, found: "InverseLamps", relighter: "Relighter", targets: Any) -> None:
    """Tables of targets and unknowns, and of a picture its target, what was found and the difference."""
    _write_table(folder / "targets.csv", ("target", "asked", "found", "relative_error"), found.targets)
    rows = [(one.name, one.value, one.deviation, one.unit, one.is_determined) for one in found.unknowns]
    _write_table(folder / "unknowns.csv", ("unknown", "found", "deviation", "unit", "determined"), rows)
    if relighter.sensors is not None:
        return
    import numpy as np

    from jaxrelight.images.false_colour import false_colour
    from jaxrelight.images.files import write_image
    from jaxrelight.images.tone import auto_exposure

    image = relighter.shade(relighter.light(found.lights), relighter.view())
    target, pixels = np.asarray(targets, np.float32)[..., :3], np.asarray(image.radiance)
    stops = auto_exposure(target)
    write_image(folder / "target.png", target, stops)
    write_image(folder / "found.png", pixels, stops)
    colours, _ = false_colour(np.abs(pixels - target).mean(axis=2), np.asarray(image.alpha) > 0, octaves=False)
    write_image(folder / "difference.png", colours)


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip() for row in rows]


def _write_table(path: pathlib.Path, heads: tuple[str, ...], rows: Any) -> None:
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(heads)
            table.writerows(rows)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def _write(path: pathlib.Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
