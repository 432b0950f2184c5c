"""jaxrelight relight: a picture from a store."""

import dataclasses
import pathlib
import time

import tyro

from jaxrelight.commands.options import LightOptions, Output, PictureOptions, ViewOptions
from jaxrelight.timing import timed


@dataclasses.dataclass(frozen=True)
class Relight:
    """Light a precomputed scene anew: another environment, rotation, other local lights, or another camera."""

    store: tyro.conf.Positional[pathlib.Path]
    """What `precompute` made."""
    output: Output
    """The picture: .exr, .hdr or .png."""
    lights: pathlib.Path | None = None
    """A scene file, or one of [[light]] alone, whose local lights take the place of the store's."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    view: tyro.conf.OmitArgPrefixes[ViewOptions] = ViewOptions()
    picture: tyro.conf.OmitArgPrefixes[PictureOptions] = PictureOptions()
    direct_samples: int | None = None
    """Of a store for indirect lighting, samples of direct light along each side of a pixel; by default the store's."""
    layers: bool = False
    """Of a store for indirect lighting, write layers of the .exr, as `render` does."""
    json: bool = False
    """Print one JSON object at the end."""

    def run(self) -> None:
        """Runs the command."""
        start = time.perf_counter()
        from jaxrelight.commands.progress import notes
        from jaxrelight.commands.summary import summarize
        from jaxrelight.errors import InputError

        seconds: dict[str, float] = {}
        with timed(seconds, "imports"):
            from jaxrelight.commands.pictures import check_output, describe, make_picture
            from jaxrelight.lighting.prepare import open_store
        check_output(self.output, self.layers)
        with timed(seconds, "open"):
            relighter = open_store(self.store)
        options = {}
        if self.layers or self.direct_samples is not None:
            if relighter.method.name != "indirect":
                raise InputError("--layers and --direct-samples are for stores of --lighting indirect; leave them out")
            if self.direct_samples is not None:
                dataclasses.replace(relighter.method, direct_samples=self.direct_samples)  # refuses what is none
                options["direct_samples"] = self.direct_samples
        camera = self.view.camera(relighter.camera)
        with timed(seconds, "environment"):
            lights = self.light.lights(relighter.scene_lights(), relighter.transport.emits, self.lights)
        notes(lights.notes)
        summary = make_picture(
            relighter, lights, camera, self.output, self.picture, seconds, layers=self.layers, **options
        )
        seconds["total"] = time.perf_counter() - start
        named = {"command": "relight", "store": str(self.store)}
        summarize({**named, **summary, **describe(relighter), "seconds": seconds}, self.json)
