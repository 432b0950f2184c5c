"""jaxrelight relight: a picture from a store."""

import dataclasses
import pathlib

import tyro

from jaxrelight.commands.options import (
    ErrorSamples,
    Json,
    LightOptions,
    Modules,
    Output,
    PictureOptions,
    ViewOptions,
    import_modules,
)
from jaxrelight.commands.summary import summary_of
from jaxrelight.errors import InputError
from jaxrelight.timing import timed


@dataclasses.dataclass(frozen=True)
class Relight:
    """Light a precomputed scene anew: another environment, rotation, other local lights, or another camera."""

    store: tyro.conf.Positional[pathlib.Path]
    """What `precompute` made."""
    output: Output
    lights: pathlib.Path | None = None
    """A scene file, or one of [[light]] alone, whose local lights take the place of the store's."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    view: tyro.conf.OmitArgPrefixes[ViewOptions] = ViewOptions()
    picture: tyro.conf.OmitArgPrefixes[PictureOptions] = PictureOptions()
    layers: bool = False
    """Of a store for indirect lighting, write layers of the .exr, as `render` does."""
    error_samples: ErrorSamples = 256
    modules: Modules = ()
    json: Json = False

    def run(self) -> None:
        """Runs the command."""
        with summary_of("relight", self.json) as (summary, seconds):
            with timed(seconds, "imports"):
                from jaxrelight.commands.pictures import check_output, make_picture
                from jaxrelight.lighting.prepare import open_store
                from jaxrelight.progress import notes

                import_modules(self.modules)
            check_output(self.output, self.layers, self.error_samples, self.picture.tone)
            with timed(seconds, "open"):
                relighter = open_store(self.store)
            if self.layers and relighter.method.name != "indirect":
                raise InputError("--layers are for stores of --lighting indirect; leave them out")
            camera = self.view.camera(relighter.camera)
            with timed(seconds, "environment"):
                lights = self.light.lights(relighter.scene_lights(), relighter.transport.emits, self.lights)
            notes(lights.notes)
            summary["store"] = str(self.store)
            summary |= make_picture(self, relighter, lights, camera, seconds)
