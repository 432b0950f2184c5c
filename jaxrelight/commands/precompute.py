"""jaxrelight precompute: a scene into a store."""

import dataclasses
import pathlib
import time
from typing import Annotated, Literal

import tyro

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.options import ScenePath
from jaxrelight.timing import timed


@dataclasses.dataclass(frozen=True)
class Precompute:
    """Precompute a scene's transport into a store, to be relit.

    What is done stays done: run it again after a stop and it goes on. A changed material re-bakes without new rays.
    Options are those of the chosen lighting method; --help-all lists its advanced dials, too.
    """

    scene: ScenePath
    """A scene file (.toml), or a mesh alone (.ply, .obj, .stl, .glb, .gltf), which is put on a floor and framed."""
    output: Annotated[pathlib.Path | None, tyro.conf.arg(aliases=["-o", "--store"], metavar="STORE")] = None
    """The store's folder; by default one in the user's cache folder."""
    lighting: Literal["auto", "transport", "indirect"] = "auto"
    """'transport' is for an environment; 'indirect' for lights anywhere, whose light surfaces pass on. 'auto' is
    indirect for a scene with local lights alone, and transport otherwise."""
    zero_nonfinite: bool = False
    """Set NaN and infinite pixels of the environment to 0 instead of refusing it."""
    json: bool = False
    """Print one JSON object at the end."""

    def run(self) -> None:
        """Runs the command."""
        start = time.perf_counter()
        from jaxrelight.commands.progress import notes, progress
        from jaxrelight.commands.summary import summarize

        seconds: dict[str, float] = {}
        with timed(seconds, "imports"):
            from jaxrelight.commands.pictures import describe, describe_build
            from jaxrelight.lighting.prepare import prepare_with_build
            from jaxrelight.scene.mesh_scene import open_scene
        method = method_of(self)
        with timed(seconds, "load"):
            scene = open_scene(self.scene, zero_nonfinite=self.zero_nonfinite)
        notes(scene.notes)
        with progress(self.json) as report:
            relighter, build = prepare_with_build(scene, method, self.output, report)
        assert build is not None
        notes(build.notes)
        seconds |= {**build.seconds, "total": time.perf_counter() - start}
        named = {"command": "precompute", "lighting": method.name}
        summarize({**named, **describe_build(build), **describe(relighter), "seconds": seconds}, self.json)
