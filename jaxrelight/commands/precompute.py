"""jaxrelight precompute: a scene into a store."""

import dataclasses
import pathlib
import time
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jaxrelight.commands.options import PrecomputeOptions

if TYPE_CHECKING:
    from jaxrelight.transport.precompute import Summary


@dataclasses.dataclass(frozen=True)
class Precompute:
    """Precompute a scene's transport into a store, to be relit from any view.

    What is done stays done: run it again after a stop and it goes on. A changed material re-bakes without new rays.
    """

    scene: tyro.conf.Positional[pathlib.Path]
    """A scene file (.toml), or a mesh alone (.ply, .obj, .stl, .glb, .gltf), which is put on a floor and framed."""
    output: Annotated[pathlib.Path | None, tyro.conf.arg(aliases=["-o", "--store"], metavar="STORE")] = None
    """The store's folder; by default one in the user's cache folder."""
    receivers: Literal["vertices", "pixels"] = "vertices"
    """'vertices' leave the view free; 'pixels' are exact for the scene's own camera."""
    dials: tyro.conf.OmitArgPrefixes[PrecomputeOptions] = PrecomputeOptions()
    zero_nonfinite: bool = False
    """Set NaN and infinite pixels of the environment to 0 instead of refusing it."""
    json: bool = False
    """Print one JSON object at the end."""

    def run(self):
        """Runs the command."""
        start = time.perf_counter()
        from jaxrelight.commands.progress import notes, progress
        from jaxrelight.commands.relight import describe, timed
        from jaxrelight.commands.summary import summarize
        from jaxrelight.mesh_scene import open_scene
        from jaxrelight.transport.load import load
        from jaxrelight.transport.precompute import precompute

        seconds = {}
        with timed(seconds, "load"):
            scene = open_scene(self.scene, zero_nonfinite=self.zero_nonfinite)
        notes(scene.notes)
        with progress(self.json) as report:
            made = precompute(scene, self.dials.settings(self.receivers), self.output, report)
        notes(made.notes)
        seconds |= made.seconds
        with timed(seconds, "open"):
            transport = load(made.folder, made.header, made.placed)
        seconds["total"] = time.perf_counter() - start
        summary = {"command": "precompute", **as_made(made), **describe(transport), "seconds": seconds}
        summarize(summary, self.json)


def as_made(made: "Summary") -> dict:
    """What a precomputation did, as a part of a summary."""
    return {
        "store": str(made.folder),
        "receivers": made.receivers,
        "rays": made.rays,
        "rays_per_second": made.rays / max(made.seconds["visibility"], 1e-9),
        "bytes": made.nbytes,
    }
