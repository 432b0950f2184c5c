"""jaxrelight render: a scene into a picture."""

import dataclasses
import pathlib
from typing import Literal

import tyro

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.options import (
    ErrorSamples,
    Json,
    LightOptions,
    Modules,
    Output,
    PictureOptions,
    ScenePath,
    Up,
    ViewOptions,
    import_modules,
    make_folder,
)
from jaxrelight.commands.summary import summary_of
from jaxrelight.errors import InputError
from jaxrelight.methods import Transport
from jaxrelight.timing import timed


@dataclasses.dataclass(frozen=True)
class Render:
    """Light a scene and write a picture.

    Options are those of the chosen lighting method; --help-all lists its advanced dials, too.
    """

    scene: ScenePath
    output: Output
    lighting: Literal["auto", "transport", "indirect", "prefiltered", "adaptive"] = "auto"
    """The lighting method. 'transport' is precomputed for an environment, with shadows and glossy materials; local
    lights add direct light. 'indirect' is precomputed for this camera and lights anywhere, whose light surfaces pass
    on. 'prefiltered' is quick, and its environment casts soft shadows; materials must be sums of lobes. 'adaptive'
    samples the environment, with shadows and any material, as often as a picture of a given quality needs. 'auto' is
    indirect for a scene with local lights alone, and transport otherwise."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    view: tyro.conf.OmitArgPrefixes[ViewOptions] = ViewOptions()
    picture: tyro.conf.OmitArgPrefixes[PictureOptions] = PictureOptions()
    store: pathlib.Path | None = None
    """The store's folder; by default one in the user's cache folder. Prefiltered lighting reads from one of transport
    what hides the environment, instead of casting rays for it."""
    up: Up = "y"
    layers: bool = False
    """Write direct light, indirect light by its last reflection and each light as layers of the .exr."""
    maps: pathlib.Path | None = None
    """A folder for pictures of what was planned: bandwidth, levels, samples and predicted error."""
    error_samples: ErrorSamples = 256
    modules: Modules = ()
    json: Json = False

    def run(self) -> None:
        """Runs the command."""
        with summary_of("render", self.json) as (summary, seconds):
            with timed(seconds, "imports"):
                from jaxrelight.commands.pictures import check_output, make_picture, prepared, scene_to_prepare
                from jaxrelight.progress import notes, progress
                from jaxrelight.scene.mesh_scene import open_scene

                import_modules(self.modules)
            method = method_of(self, exposure=self.picture.exposure)
            check_output(self.output, self.layers, self.error_samples, self.picture.tone)
            with timed(seconds, "load"):
                scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite, up=self.up)
                scene = dataclasses.replace(scene, camera=self.view.camera(scene.camera))
                lights = self.light.lights(scene.lights, scene.emits)
            if self.maps is not None:
                _make_maps_folder(self.maps, lights.environment is not None)
            notes(dict.fromkeys((*scene.notes, *lights.notes)))
            if isinstance(method, Transport) and method.receivers == "pixels" and self.view.changes:
                notes(
                    [
                        "receivers are the pixels of this camera, and each other camera is precomputed anew; with "
                        "--receivers vertices, one store shows all of them at no cost"
                    ]
                )
            with progress(self.json) as report:
                scene = scene_to_prepare(scene, method, lights)
                relighter = prepared(scene, method, self.store, report, summary, seconds)
                summary |= make_picture(self, relighter, lights, scene.camera, seconds, report)


def _make_maps_folder(maps: pathlib.Path, has_environment: bool) -> None:
    """Found now rather than after the work."""
    if not has_environment:
        raise InputError("--maps shows how an environment is sampled, and there is none; leave it out, or give --env")
    make_folder("--maps", maps)
