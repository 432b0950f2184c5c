"""jaxrelight measure: irradiance and illuminance at the sensors of a scene."""

import csv
import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.options import Json, LightOptions, LinearLighting, Modules, StoreFolder, Up, import_modules
from jaxrelight.commands.summary import summary_of
from jaxrelight.errors import InputError
from jaxrelight.methods import METHODS
from jaxrelight.timing import timed

if TYPE_CHECKING:
    from jaxrelight.lighting.contract import Relighter
    from jaxrelight.lighting.measurement import Measurement
    from jaxrelight.lights.lights import Lights
    from jaxrelight.progress import Report

_COLUMNS = "sensor", "x", "y", "z", "normal_x", "normal_y", "normal_z", "red_w_m2", "green_w_m2", "blue_w_m2", "lux"


@dataclasses.dataclass(frozen=True)
class Measure:
    """Measure the light that arrives at a scene's sensors: W/m² by channel, and lux by 179 lm/W of luminance.

    Of a scene it is precomputed as for `render`, and kept; of a store whose sensors were precomputed, only the light is
    new. Options are those of the chosen lighting method; --help-all lists its advanced dials, too.
    """

    scene: Annotated[tyro.conf.Positional[pathlib.Path], tyro.conf.arg(metavar="SCENE|STORE")]
    """A scene file with [[sensor]], or the store that an earlier `measure` of it made."""
    output: Annotated[pathlib.Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None
    """A .csv file with a row for every point; without it, only the table of sensors is printed."""
    lighting: LinearLighting = "auto"
    """The lighting method, as for `render`. 'auto' is indirect for a scene with local lights alone, and transport
    otherwise; a store has its own."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    lights: pathlib.Path | None = None
    """A scene file, or one of [[light]] alone, whose local lights take the place of the scene's."""
    store: StoreFolder = None
    up: Up = "y"
    modules: Modules = ()
    json: Json = False

    # What `with_dials` tells of the method that cannot measure.
    cannot: ClassVar[str] = "shares samples between pixels, which sensors do not have; measure with another method"

    def run(self) -> None:
        """Runs the command."""
        with summary_of("measure", self.json) as (summary, seconds):
            with timed(seconds, "imports"):
                from jaxrelight.commands.pictures import describe
                from jaxrelight.lighting.measurement import measure
                from jaxrelight.progress import notes, progress

                import_modules(self.modules)
            if self.output is not None:
                _check_output(self.output)
            with progress(self.json) as report:
                prepare = self._opened if self.scene.is_dir() else self._prepared
                relighter, lights = prepare(report, summary, seconds)
            with timed(seconds, "measure"):
                measured = measure(relighter, lights)
            if self.output is not None:
                with timed(seconds, "write"):
                    _write(self.output, measured)
                summary["table"] = str(self.output)
            notes(relighter.notes_on(lights))
            left_out = relighter.method.leaves_out(lights.environment is not None, bool(lights.local))
            notes(f"{relighter.method.name} lighting leaves out {line}" for line in left_out)
            if self.json:
                summary["sensors"] = {
                    name: {"points": sensor.count, **dataclasses.asdict(told)}
                    for (name, told), sensor in zip(measured.summaries().items(), measured.sensors.each, strict=True)
                }
            else:
                print("\n".join(table_of(measured)), flush=True)
            summary |= {"lights": len(lights.local), "leaves_out": list(left_out), **describe(relighter)}

    def _prepared(self, report: "Report", summary: dict, seconds: dict[str, float]) -> tuple["Relighter", "Lights"]:
        """What lights the sensors of a scene, and its lights."""
        from jaxrelight.commands.pictures import prepared, scene_to_prepare
        from jaxrelight.progress import notes
        from jaxrelight.scene.mesh_scene import open_scene

        with timed(seconds, "load"):
            scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite, up=self.up)
            lights = self.light.lights(scene.lights, scene.emits, self.lights)
            scene = scene.at_sensors()
        notes(dict.fromkeys((*scene.notes, *lights.notes)))
        method = method_of(self)
        scene = scene_to_prepare(scene, method, lights)
        return prepared(scene, method, self.store, report, summary, seconds), lights

    def _opened(self, report: "Report", summary: dict, seconds: dict[str, float]) -> tuple["Relighter", "Lights"]:
        """What a store has precomputed of sensors, and its lights or others."""
        from jaxrelight.lighting.prepare import open_store
        from jaxrelight.progress import notes

        method = method_of(self)
        if self.lighting != "auto" or self.store is not None or method != METHODS[method.name]():
            raise InputError(f"{self.scene}: is a store, which has its own lighting method and dials; leave them out")
        with timed(seconds, "open"):
            relighter = open_store(self.scene, sensors=True)
            lights = self.light.lights(relighter.scene_lights(), relighter.transport.emits, self.lights)
        notes(lights.notes)
        summary["store"] = str(self.scene)
        return relighter, lights


def table_of(measured: "Measurement") -> list[str]:
    """Lines that tell each sensor's illuminance in all."""
    rows: list[tuple[str, ...]] = [("sensor", "points", "mean / lux", "min", "max", "min / mean")]
    for (name, told), sensor in zip(measured.summaries().items(), measured.sensors.each, strict=True):
        numbers = (f"{value:,.4g}" for value in (told.mean, told.min, told.max))
        rows.append((name, f"{sensor.count:,}", *numbers, f"{told.uniformity:.2f}"))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(n) for cell, n in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    ]


def _check_output(output: pathlib.Path) -> None:
    """Refuses, before long work, what cannot be written."""
    if output.suffix.lower() != ".csv":
        raise InputError(f"{output}: tables are written as .csv; name such a file")
    if not output.parent.is_dir():
        raise InputError(f"{output}: there is no folder {output.parent}; make it, or name another one")


def _write(output: pathlib.Path, measured: "Measurement") -> None:
    """A row for every point of every sensor."""
    import numpy as np

    sensors = measured.sensors
    names = [sensor.name for sensor in sensors.each for _ in range(sensor.count)]
    numbers = np.column_stack([sensors.positions, sensors.normals, measured.irradiance, measured.illuminance])
    try:
        with output.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(_COLUMNS)
            table.writerows(
                [name, *(f"{value:.9g}" for value in row)] for name, row in zip(names, numbers, strict=True)
            )
    except OSError as error:
        raise InputError(f"{output}: cannot be written: {error.strerror}") from None
