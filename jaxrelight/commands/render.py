"""jaxrelight render: a scene into a picture, by way of a store."""

import dataclasses
import pathlib
import time
from typing import TYPE_CHECKING, Literal

import tyro

from jaxrelight.commands.options import LightOptions, Output, PictureOptions, PrecomputeOptions, ViewOptions

if TYPE_CHECKING:
    from jaxrelight.scene import Scene


@dataclasses.dataclass(frozen=True)
class Render:
    """Light a scene file: precompute what is missing, then make a picture."""

    scene: tyro.conf.Positional[pathlib.Path]
    """A scene file (.toml), or a mesh alone (.ply, .obj, .stl, .glb, .gltf), which is put on a floor and framed."""
    output: Output
    """The picture: .exr, .hdr or .png."""
    receivers: Literal["vertices", "pixels"] = "pixels"
    """'pixels' are exact for this camera; 'vertices' can be viewed from anywhere afterwards."""
    store: pathlib.Path | None = None
    """The store's folder; by default one in the user's cache folder."""
    lighting: Literal["transport", "prefiltered"] = "transport"
    """How light becomes radiance. 'transport' is precomputed, with shadows, for distant light. 'prefiltered' is quick,
    knows local lights too, and its environment casts no shadows; materials must be sums of lobes."""
    shadows: bool = True
    """Let local lights cast shadows."""
    texels: Literal["parameters", "reflectance"] = "parameters"
    """What is interpolated between texels of an SBRDF under prefiltered lighting: 'reflectance' is right between unlike
    texels, and slower."""
    minification: Literal["levels", "averaged", "none"] = "levels"
    """What prefiltered lighting sees of an SBRDF whose texels are smaller than pixels: the coarser 'levels' that were
    fitted to it, as far as the maps have any; 'averaged' parameters; or single texels."""
    dials: tyro.conf.OmitArgPrefixes[PrecomputeOptions] = PrecomputeOptions()
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    view: tyro.conf.OmitArgPrefixes[ViewOptions] = ViewOptions()
    picture: tyro.conf.OmitArgPrefixes[PictureOptions] = PictureOptions()
    json: bool = False
    """Print one JSON object at the end."""

    def run(self):
        """Runs the command."""
        start = time.perf_counter()
        from jaxrelight.commands.precompute import as_made
        from jaxrelight.commands.progress import notes, progress
        from jaxrelight.commands.relight import describe, light_picture, timed
        from jaxrelight.commands.summary import summarize
        from jaxrelight.errors import InputError
        from jaxrelight.images import check_writable
        from jaxrelight.lighting.transport import Relighter
        from jaxrelight.mesh_scene import open_scene
        from jaxrelight.transport.load import load
        from jaxrelight.transport.precompute import precompute

        check_writable(self.output)
        if self.lighting == "transport":
            others = {"no-shadows": not self.shadows, "texels": self.texels != "parameters"}
            for option, given in (others | {"minification": self.minification != "levels"}).items():
                if given:
                    raise InputError(f"--{option} is a dial of --lighting prefiltered; leave it out")
        seconds = {}
        with timed(seconds, "load"):
            scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite)
            scene = dataclasses.replace(scene, camera=self.view.camera(scene.camera))
            if self.lighting == "transport":
                # Found now rather than after a minute of rays.
                scene.check_distant()
                environment = self.light.environment(scene.environment, emits=scene.emits)
                notes(dict.fromkeys((*scene.notes, *environment.notes)))
        if self.lighting == "prefiltered":
            self._prefiltered(scene, seconds, start)
            return
        with progress(self.json) as report:
            made = precompute(scene, self.dials.settings(self.receivers), self.store, report)
        notes(made.notes)
        seconds |= made.seconds
        with timed(seconds, "open"):
            # Of this scene, whatever another process has meanwhile made of the store.
            transport = load(made.folder, made.header, made.placed)
        picture = light_picture(Relighter(transport), environment, scene.camera, self.output, self.picture)
        seconds |= {**picture.pop("seconds"), "total": time.perf_counter() - start}
        summary = {"command": "render", **as_made(made), **picture, **describe(transport), "seconds": seconds}
        summarize(summary, self.json)

    def _prefiltered(self, scene: "Scene", seconds: dict, start: float):
        from jaxrelight.commands.prefiltered import prefiltered_picture
        from jaxrelight.commands.progress import notes
        from jaxrelight.commands.summary import summarize
        from jaxrelight.errors import InputError

        others = {"store": (self.store, None), "receivers": (self.receivers, "pixels")}
        others |= {name: (given, getattr(PrecomputeOptions(), name)) for name, given in vars(self.dials).items()}
        for name, (given, default) in others.items():
            if given != default:
                raise InputError(f"--{name.replace('_', '-')} is a dial of --lighting transport; leave it out")
        notes(dict.fromkeys(scene.notes))
        dials = {"shadows": self.shadows, "texels": self.texels, "minification": self.minification}
        picture = prefiltered_picture(scene, self.light, self.output, self.picture, **dials, seconds=seconds)
        seconds["total"] = time.perf_counter() - start
        summarize({"command": "render", "lighting": "prefiltered", **picture, "seconds": seconds}, self.json)
