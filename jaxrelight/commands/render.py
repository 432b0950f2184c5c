"""jaxrelight render: a scene into a picture."""

import dataclasses
import pathlib
import time
from typing import Literal

import tyro

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.options import LightOptions, Output, PictureOptions, ScenePath, ViewOptions
from jaxrelight.timing import timed


@dataclasses.dataclass(frozen=True)
class Render:
    """Light a scene and write a picture.

    Options are those of the chosen lighting method; --help-all lists its advanced dials, too.
    """

    scene: ScenePath
    """A scene file (.toml), or a mesh alone (.ply, .obj, .stl, .glb, .gltf), which is put on a floor and framed."""
    output: Output
    """The picture: .exr, .hdr or .png."""
    lighting: Literal["auto", "transport", "indirect", "prefiltered", "adaptive"] = "auto"
    """The lighting method. 'transport' is precomputed for an environment, with shadows and glossy materials. 'indirect'
    is precomputed for this camera and lights anywhere, whose light surfaces pass on. 'prefiltered' is quick, and its
    environment casts no shadows; materials must be sums of lobes. 'adaptive' samples the environment, with shadows and
    any material, as often as a picture of a given quality needs. 'auto' is indirect for a scene with local lights
    alone, and transport otherwise."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    view: tyro.conf.OmitArgPrefixes[ViewOptions] = ViewOptions()
    picture: tyro.conf.OmitArgPrefixes[PictureOptions] = PictureOptions()
    json: bool = False
    """Print one JSON object at the end."""

    def run(self) -> None:
        """Runs the command."""
        start = time.perf_counter()
        from jaxrelight.commands.progress import notes, progress
        from jaxrelight.commands.summary import summarize

        seconds: dict[str, float] = {}
        with timed(seconds, "imports"):
            from jaxrelight.commands.pictures import check_output, describe, describe_build, make_picture
            from jaxrelight.lighting.prepare import prepare_with_build
            from jaxrelight.scene.mesh_scene import open_scene
        exposure = {"exposure": self.picture.exposure} if isinstance(self, AdaptiveRender) else {}
        method = method_of(self, **exposure)
        layers = isinstance(self, IndirectRender) and self.layers
        maps = self.maps if isinstance(self, AdaptiveRender) else None
        check_output(self.output, layers)
        with timed(seconds, "load"):
            scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite)
            scene = dataclasses.replace(scene, camera=self.view.camera(scene.camera))
        lights = self.light.lights(scene.lights, scene.emits)
        if maps is not None:
            _make_maps_folder(maps, lights.environment is not None)
        notes(dict.fromkeys((*scene.notes, *lights.notes)))
        store = self.store if isinstance(self, StoredRender) else None
        with progress(self.json) as report:
            relighter, build = prepare_with_build(scene, method, store, report)
            if build is not None:
                notes(build.notes)
                seconds |= build.seconds
            options = {"layers": layers, "maps": maps, "report": report}
            summary = make_picture(relighter, lights, scene.camera, self.output, self.picture, seconds, **options)
        seconds["total"] = time.perf_counter() - start
        named = {"command": "render", "lighting": method.name, **(describe_build(build) if build else {})}
        summarize({**named, **summary, **describe(relighter), "seconds": seconds}, self.json)


def _make_maps_folder(maps: pathlib.Path, has_environment: bool) -> None:
    """Found now rather than after the work."""
    from jaxrelight.errors import InputError

    if not has_environment:
        raise InputError("--maps shows how an environment is sampled, and there is none; leave it out, or give --env")
    try:
        maps.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--maps {maps}: {error.strerror}") from None


@dataclasses.dataclass(frozen=True)
class StoredRender(Render):
    """`render` by a method with a store."""

    store: pathlib.Path | None = None
    """The store's folder; by default one in the user's cache folder."""


@dataclasses.dataclass(frozen=True)
class IndirectRender(StoredRender):
    """`render --lighting indirect`."""

    layers: bool = False
    """Write direct light, indirect light by its last reflection and each light as layers of the .exr."""


@dataclasses.dataclass(frozen=True)
class AdaptiveRender(Render):
    """`render --lighting adaptive`."""

    maps: pathlib.Path | None = None
    """A folder for pictures of what was planned: bandwidth, levels, samples and predicted error."""


RENDERS = {"transport": StoredRender, "indirect": IndirectRender, "prefiltered": Render, "adaptive": AdaptiveRender}
