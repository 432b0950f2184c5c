"""jaxrelight render: a scene into a picture, by way of a store."""

import dataclasses
import pathlib
import time
from typing import TYPE_CHECKING, Literal

import tyro

from jaxrelight.commands.options import (
    CloudOptions,
    LightOptions,
    LocalOptions,
    Output,
    PictureOptions,
    PrecomputeOptions,
    ViewOptions,
    refuse_others,
)

if TYPE_CHECKING:
    from jaxrelight.methods import Settings
    from jaxrelight.scene.scene import Scene
    from jaxrelight.transport.model import Transport


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
    lighting: Literal["auto", "transport", "indirect", "prefiltered", "adaptive"] = "auto"
    """How light becomes radiance. 'transport' is precomputed, with shadows, for distant light. 'indirect' is
    precomputed for this camera and lights anywhere, whose light surfaces pass on. 'prefiltered' is quick, knows lights
    anywhere too, and its environment casts no shadows; materials must be sums of lobes. 'adaptive' samples the
    environment, with shadows and any material, where and as often as a picture of a given quality needs. 'auto' is
    indirect for a scene with local lights alone, and else transport."""
    shadows: bool = True
    """Let local lights cast shadows; under adaptive lighting, the environment, too."""
    antialiasing: Literal[1, 4, 16] = 1
    """Samples of surfaces in a pixel under adaptive lighting; 4 take about twice the time of 1, not four times."""
    maps: pathlib.Path | None = None
    """A folder for pictures of what adaptive lighting planned: bandwidth, levels, samples and predicted error."""
    texels: Literal["parameters", "reflectance"] = "parameters"
    """What is interpolated between texels of an SBRDF under prefiltered lighting: 'reflectance' is right between unlike
    texels, and slower."""
    minification: Literal["levels", "averaged", "none"] = "levels"
    """What prefiltered lighting sees of an SBRDF whose texels are smaller than pixels: the coarser 'levels' that were
    fitted to it, as far as the maps have any; 'averaged' parameters; or single texels."""
    dials: tyro.conf.OmitArgPrefixes[PrecomputeOptions] = PrecomputeOptions()
    cloud: tyro.conf.OmitArgPrefixes[CloudOptions] = CloudOptions()
    local: tyro.conf.OmitArgPrefixes[LocalOptions] = LocalOptions()
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    view: tyro.conf.OmitArgPrefixes[ViewOptions] = ViewOptions()
    picture: tyro.conf.OmitArgPrefixes[PictureOptions] = PictureOptions()
    json: bool = False
    """Print one JSON object at the end."""

    def run(self):
        """Runs the command."""
        start = time.perf_counter()
        from jaxrelight.commands.relight import timed
        from jaxrelight.commands.summary import summarize

        seconds = {}
        with timed(seconds, "imports"):
            from jaxrelight.images import check_writable
            from jaxrelight.scene.mesh_scene import open_scene
        check_writable(self.output)
        with timed(seconds, "load"):
            scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite)
            scene = dataclasses.replace(scene, camera=self.view.camera(scene.camera))
        lighting, asked = self.lighting, self.light.env is not None or scene.environment
        if lighting == "auto":
            lighting = "indirect" if scene.lights and not asked else "transport"
        how = {"transport": self._transport, "indirect": self._indirect, "prefiltered": self._prefiltered}
        how["adaptive"] = self._adaptive
        summary = how[lighting](scene, seconds)
        seconds |= summary.pop("seconds", {})
        seconds["total"] = time.perf_counter() - start
        summarize({"command": "render", "lighting": lighting, **summary, "seconds": seconds}, self.json)

    def _transport(self, scene: "Scene", seconds: dict) -> dict:
        from jaxrelight.commands.progress import notes
        from jaxrelight.commands.relight import describe, light_picture
        from jaxrelight.lighting.transport import Relighter

        self._refuse(prefiltered=True, cloud=True)
        # Found now rather than after a minute of rays.
        scene.check_distant()
        environment = self.light.environment(scene.environment, emits=scene.emits)
        notes(dict.fromkeys((*scene.notes, *environment.notes)))
        made, transport = self._made(scene, self.dials.settings(self.receivers), seconds)
        picture = light_picture(Relighter(transport), environment, scene.camera, self.output, self.picture)
        return {**made, **picture, **describe(transport)}

    def _indirect(self, scene: "Scene", seconds: dict) -> dict:
        from jaxrelight.commands.indirect import check_indirect, indirect_picture
        from jaxrelight.commands.progress import notes
        from jaxrelight.commands.relight import describe
        from jaxrelight.errors import InputError

        self._refuse(prefiltered=True)
        if self.receivers != "pixels":
            raise InputError("--receivers vertices is a dial of --lighting transport; leave it out")
        asked = self.light != LightOptions()
        environment = self.light.environment(scene.environment) if scene.environment or asked else None
        check_indirect(scene.lights, environment, scene.emits, self.output, self.local)
        notes(dict.fromkeys((*scene.notes, *(environment.notes if environment else ()))))
        made, transport = self._made(scene, self.cloud.settings(self.dials), seconds)
        arguments = scene.lights, environment, self.output, self.picture, self.local, seconds
        return {**made, **indirect_picture(transport, *arguments), **describe(transport)}

    def _prefiltered(self, scene: "Scene", seconds: dict) -> dict:
        from jaxrelight.commands.prefiltered import prefiltered_picture
        from jaxrelight.commands.progress import notes

        self._refuse(cloud=True)
        self._refuse_store()
        refuse_others(self.dials, PrecomputeOptions(), "transport")
        notes(dict.fromkeys(scene.notes))
        dials = {"shadows": self.shadows, "texels": self.texels, "minification": self.minification}
        return prefiltered_picture(scene, self.light, self.output, self.picture, **dials, seconds=seconds)

    def _adaptive(self, scene: "Scene", seconds: dict) -> dict:
        from jaxrelight.commands.adaptive import adaptive_picture
        from jaxrelight.commands.progress import progress
        from jaxrelight.errors import InputError

        self._refuse_store()
        refuse_others(self.dials, PrecomputeOptions(), "transport", ("tolerance",))
        refuse_others(self.cloud, CloudOptions(), "indirect", ("seed",))
        refuse_others(self.local, LocalOptions(), "indirect", ("samples",))
        if self.texels != "parameters":
            raise InputError("--texels is a dial of --lighting prefiltered; leave it out")
        with progress(self.json) as report:
            return adaptive_picture(
                scene,
                self.light,
                self.output,
                self.picture,
                samples=self.local.samples,
                tolerance=self.dials.tolerance,
                maps=self.maps,
                antialiasing=self.antialiasing,
                shadows=self.shadows,
                minification=self.minification,
                seed=self.cloud.seed,
                seconds=seconds,
                report=report,
            )

    def _refuse_store(self):
        """Refuses what only a store has."""
        from jaxrelight.errors import InputError

        for name, (given, default) in {"store": (self.store, None), "receivers": (self.receivers, "pixels")}.items():
            if given != default:
                raise InputError(f"--{name} is a dial of --lighting transport; leave it out")

    def _refuse(self, *, prefiltered: bool = False, cloud: bool = False):
        """Refuses dials of other kinds of lighting."""
        from jaxrelight.errors import InputError

        for name, given in {"maps": self.maps is not None, "antialiasing": self.antialiasing != 1}.items():
            if given:
                raise InputError(f"--{name} is a dial of --lighting adaptive; leave it out")
        if cloud:
            refuse_others(self.cloud, CloudOptions(), "indirect")
            refuse_others(self.local, LocalOptions(), "indirect")
        others = {"no-shadows": not self.shadows, "texels": self.texels != "parameters"}
        for option, given in (others | {"minification": self.minification != "levels"}).items():
            if prefiltered and given:
                raise InputError(f"--{option} is a dial of --lighting prefiltered; leave it out")

    def _made(self, scene: "Scene", settings: "Settings", seconds: dict) -> tuple[dict, "Transport"]:
        """Precomputes what is missing, and opens it."""
        from jaxrelight.commands.precompute import as_made
        from jaxrelight.commands.progress import notes, progress
        from jaxrelight.commands.relight import timed
        from jaxrelight.precomputation.load import load
        from jaxrelight.precomputation.precompute import precompute

        with progress(self.json) as report:
            made = precompute(scene, settings, self.store, report)
        notes(made.notes)
        seconds |= made.seconds
        with timed(seconds, "open"):
            # Of this scene, whatever another process has meanwhile made of the store.
            return as_made(made), load(made.folder, made.header, made.placed)
