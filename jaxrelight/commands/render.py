"""jaxrelight render: a scene into a picture, by way of a store."""

import dataclasses
import pathlib
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
        from jaxrelight.commands.precompute import describe
        from jaxrelight.commands.progress import notes, progress, summarize
        from jaxrelight.commands.relight import relight
        from jaxrelight.images import check_writable
        from jaxrelight.mesh_scene import open_scene
        from jaxrelight.transport.precompute import precompute

        check_writable(self.output)
        scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite)
        # Found now rather than after a minute of rays.
        self.light.environment(scene.environment)
        scene = dataclasses.replace(scene, camera=self.view.camera(scene.camera))
        notes(scene.notes)
        with progress(self.json) as report:
            made = precompute(scene, self.dials.settings(self.receivers), self.store, report)
        notes(made.notes)
        picture = relight(made.folder, self.output, self.light, ViewOptions(), self.picture)
        summarize({**describe(made), **picture, "seconds": {**made.seconds, **picture["seconds"]}}, self.json)
