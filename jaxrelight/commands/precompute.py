"""jaxrelight precompute: a scene into a store."""

import dataclasses
import pathlib
from typing import Annotated, Literal

import tyro

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.options import Json, Modules, ScenePath, Up, import_modules
from jaxrelight.commands.summary import summary_of
from jaxrelight.timing import timed


@dataclasses.dataclass(frozen=True)
class Precompute:
    """Precompute a scene's transport into a store, to be relit.

    What is done stays done: run it again after a stop and it goes on. A changed material re-bakes without new rays.
    Options are those of the chosen lighting method; --help-all lists its advanced dials, too.
    """

    scene: ScenePath
    output: Annotated[pathlib.Path | None, tyro.conf.arg(aliases=["-o", "--store"], metavar="STORE")] = None
    """The store's folder; by default one in the user's cache folder."""
    lighting: Literal["auto", "transport", "indirect"] = "auto"
    """'transport' is for an environment, and local lights add direct light; 'indirect' is for lights anywhere, whose
    light surfaces pass on. 'auto' is indirect for a scene with local lights alone, and transport otherwise."""
    up: Up = "y"
    zero_nonfinite: bool = False
    """Set NaN and infinite pixels of the environment to 0 instead of refusing it."""
    modules: Modules = ()
    json: Json = False

    def run(self) -> None:
        """Runs the command."""
        with summary_of("precompute", self.json) as (summary, seconds):
            with timed(seconds, "imports"):
                from jaxrelight.commands.pictures import describe, prepared
                from jaxrelight.progress import notes, progress
                from jaxrelight.scene.mesh_scene import open_scene

                import_modules(self.modules)
            method = method_of(self)
            with timed(seconds, "load"):
                scene = open_scene(self.scene, zero_nonfinite=self.zero_nonfinite, up=self.up)
            notes(scene.notes)
            with progress(self.json) as report:
                summary |= describe(prepared(scene, method, self.output, report, summary, seconds))
