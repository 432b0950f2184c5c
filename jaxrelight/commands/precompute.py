"""jaxrelight precompute: a scene into a store."""

import dataclasses
import pathlib
import time
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jaxrelight.commands.options import CloudOptions, PrecomputeOptions, refuse_others

if TYPE_CHECKING:
    from jaxrelight.precomputation.precompute import Summary


@dataclasses.dataclass(frozen=True)
class Precompute:
    """Precompute a scene's transport into a store, to be relit from any view.

    What is done stays done: run it again after a stop and it goes on. A changed material re-bakes without new rays.
    """

    scene: tyro.conf.Positional[pathlib.Path]
    """A scene file (.toml), or a mesh alone (.ply, .obj, .stl, .glb, .gltf), which is put on a floor and framed."""
    output: Annotated[pathlib.Path | None, tyro.conf.arg(aliases=["-o", "--store"], metavar="STORE")] = None
    """The store's folder; by default one in the user's cache folder."""
    receivers: Literal["vertices", "pixels"] | None = None
    """'vertices', the default, leave the view free; 'pixels' are exact for the scene's own camera, and all that
    indirect lighting has."""
    lighting: Literal["auto", "transport", "indirect"] = "auto"
    """'transport' is for distant light; 'indirect' for lights anywhere, whose light surfaces pass on. 'auto' is
    indirect for a scene with local lights alone, and else transport."""
    dials: tyro.conf.OmitArgPrefixes[PrecomputeOptions] = PrecomputeOptions()
    cloud: tyro.conf.OmitArgPrefixes[CloudOptions] = CloudOptions()
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
        from jaxrelight.errors import InputError

        seconds = {}
        with timed(seconds, "imports"):
            from jaxrelight.precomputation.load import load
            from jaxrelight.precomputation.precompute import precompute
            from jaxrelight.scene.mesh_scene import open_scene
        with timed(seconds, "load"):
            scene = open_scene(self.scene, zero_nonfinite=self.zero_nonfinite)
        notes(scene.notes)
        lighting = self.lighting
        if lighting == "auto":
            lighting = "indirect" if scene.lights and not scene.environment else "transport"
        if lighting == "indirect":
            if self.receivers == "vertices":
                raise InputError("--receivers vertices is a dial of --lighting transport; leave it out")
            settings = self.cloud.settings(self.dials)
        else:
            refuse_others(self.cloud, CloudOptions(), "indirect")
            settings = self.dials.settings(self.receivers or "vertices")
        with progress(self.json) as report:
            made = precompute(scene, settings, self.output, report)
        notes(made.notes)
        seconds |= made.seconds
        with timed(seconds, "open"):
            transport = load(made.folder, made.header, made.placed)
        seconds["total"] = time.perf_counter() - start
        summary = {
            "command": "precompute",
            "lighting": lighting,
            **as_made(made),
            **describe(transport),
            "seconds": seconds,
        }
        summarize(summary, self.json)


# Stages that trace rays: all of their time under an environment, with gathering where light is local.
_TRACING = "visibility", "between", "pixels"


def as_made(made: "Summary") -> dict:
    """What a precomputation did, as a part of a summary."""
    return {
        "store": str(made.folder),
        "receivers": made.receivers,
        "rays": made.rays,
        "rays_per_second": made.rays / max(sum(made.seconds.get(stage, 0) for stage in _TRACING), 1e-9),
        "bytes": made.nbytes,
    }
