"""jaxrelight render: a scene into a picture, by way of a store."""

import dataclasses
import pathlib
import time
from typing import Literal

import tyro

from jaxrelight.commands.options import LightOptions, Output, PictureOptions, PrecomputeOptions, ViewOptions


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
    lighting: Literal["transport"] = "transport"
    """How light becomes radiance: by precomputed transport."""
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
        from jaxrelight.images import check_writable
        from jaxrelight.lighting.transport import Relighter
        from jaxrelight.mesh_scene import open_scene
        from jaxrelight.transport.load import load
        from jaxrelight.transport.precompute import precompute

        check_writable(self.output)
        seconds = {}
        with timed(seconds, "load"):
            scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite)
            # Found now rather than after a minute of rays.
            environment = self.light.environment(scene.environment)
            scene = dataclasses.replace(scene, camera=self.view.camera(scene.camera))
            notes(dict.fromkeys((*scene.notes, *environment.notes)))
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
