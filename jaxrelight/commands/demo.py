"""jaxrelight demo: a scene and a sky made by code, precomputed and relit."""

import dataclasses
import pathlib
from typing import Annotated, Any

import tyro

from jaxrelight.commands.options import Exposure, Json, Tone
from jaxrelight.commands.summary import summary_of
from jaxrelight.errors import InputError
from jaxrelight.methods import Transport
from jaxrelight.timing import timed

# Degrees by which the demo turns its sky, and eyes from which it looks.
_ROTATIONS = (0.0, 70.0, 200.0)
_EYES = ((0.7, 1.0, 2.7), (-2.1, 1.3, 1.7))


@dataclasses.dataclass(frozen=True)
class Demo:
    """Make a scene and a sky by code, precompute, relight under several rotations and views, say what it measured."""

    output: Annotated[pathlib.Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = pathlib.Path("jaxrelight-demo")
    """Where the pictures and the store go."""
    detail: float = 1.0
    """Factor on the number of quads along each side of every mesh."""
    height: int = 480
    """Rows of each picture."""
    exposure: Exposure = "auto"
    tone: Tone = "linear"
    json: Json = False

    def run(self) -> None:
        """Runs the command."""
        with summary_of("demo", self.json) as (summary, seconds):
            with timed(seconds, "imports"):
                import numpy as np

                from jaxrelight.commands.pictures import describe, prepared, shaded
                from jaxrelight.images import auto_exposure, image_error, write_image
                from jaxrelight.progress import progress
                from jaxrelight.scene.demo_scene import demo_scene

            if not 0.05 <= self.detail <= 8 or not 16 <= self.height <= 4096:
                raise InputError("the demo's detail goes from 0.05 to 8, its height from 16 to 4,096")
            scene = demo_scene(self.detail, self.height)
            method = Transport("vertices", resolution=32, coefficients=256)
            with progress(self.json) as report:
                relighter: Any = prepared(scene, method, self.output / "store", report, summary, seconds)
            sky: Any = scene.lights.environment

            rows = []
            for eye in _EYES:
                view = relighter.view(dataclasses.replace(scene.camera, origin=eye), antialiasing=4)
                turned = [shaded(relighter, sky.with_(rotate_y=degrees), view, {})[1] for degrees in _ROTATIONS]
                rows.append(np.concatenate(turned, axis=1))
            sheet = np.concatenate(rows)
            exposure = auto_exposure(sheet) if self.exposure == "auto" else self.exposure
            write_image(self.output / "relit.png", sheet, exposure, tone=self.tone)
            for degrees, picture in zip(_ROTATIONS, np.split(rows[0], len(_ROTATIONS), axis=1), strict=True):
                write_image(self.output / f"sky_turned_{degrees:.0f}.png", picture, exposure, tone=self.tone)

            # At the size that was asked for: once to compile, then timed.
            shaded(relighter, sky, relighter.view(), {})
            spent: dict[str, float] = {}
            with timed(spent, "change_of_view"):
                view = relighter.view()
            _, kept = shaded(relighter, sky, view, spent)
            error = image_error(kept, shaded(relighter.exact(), sky, view, {})[1])
            spent["change_of_light"], spent["shading"] = spent.pop("light"), spent.pop("shade")
            summary |= {
                "picture": str(self.output / "relit.png"),
                **describe(relighter),
                "milliseconds": {stage: 1e3 * time for stage, time in spent.items()},
                "exposure": exposure,
                "error": {"coefficients": error.untrimmed, "without_worst_5_percent": error.trimmed},
            }
