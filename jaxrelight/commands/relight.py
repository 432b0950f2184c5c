"""jaxrelight relight: a picture from a store."""

import contextlib
import dataclasses
import pathlib
import time
from typing import TYPE_CHECKING

import tyro

from jaxrelight.commands.options import LightOptions, LocalOptions, Output, PictureOptions, ViewOptions, refuse_others

if TYPE_CHECKING:
    from jaxrelight.geometry.camera import Camera
    from jaxrelight.lighting.transport import Relighter
    from jaxrelight.lights.environment import Environment
    from jaxrelight.transport.model import Transport


@dataclasses.dataclass(frozen=True)
class Relight:
    """Light a precomputed scene anew: another environment, rotation or camera."""

    store: tyro.conf.Positional[pathlib.Path]
    """What `precompute` made."""
    output: Output
    """The picture: .exr, .hdr or .png."""
    lights: pathlib.Path | None = None
    """A scene file, or one of [[light]] alone, whose lights take the place of the store's; indirect lighting only."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    view: tyro.conf.OmitArgPrefixes[ViewOptions] = ViewOptions()
    picture: tyro.conf.OmitArgPrefixes[PictureOptions] = PictureOptions()
    local: tyro.conf.OmitArgPrefixes[LocalOptions] = LocalOptions()
    json: bool = False
    """Print one JSON object at the end."""

    def run(self):
        """Runs the command."""
        start = time.perf_counter()
        from jaxrelight.commands.summary import summarize
        from jaxrelight.errors import InputError

        seconds = {}
        with timed(seconds, "imports"):
            from jaxrelight.images import check_writable
            from jaxrelight.precomputation.load import load
        check_writable(self.output)
        with timed(seconds, "open"):
            transport = load(self.store)
        if transport.cloud:
            picture = self._indirect(transport, seconds)
        else:
            refuse_others(self.local, LocalOptions(), "indirect")
            if self.lights:
                raise InputError(f"{self.store}: a store for distant light; precompute with --lighting indirect")
            picture = self._distant(transport, seconds)
        seconds |= {**picture.pop("seconds", {}), "total": time.perf_counter() - start}
        store = {"command": "relight", "store": str(self.store)}
        summarize({**store, **picture, **describe(transport), "seconds": seconds}, self.json)

    def _indirect(self, transport: "Transport", seconds: dict) -> dict:
        from jaxrelight.commands.indirect import check_indirect, indirect_picture
        from jaxrelight.commands.progress import notes
        from jaxrelight.errors import InputError
        from jaxrelight.precomputation.load import stored_environment
        from jaxrelight.scene.scene import load_lights

        if self.view.camera(transport.camera) != transport.camera:
            raise InputError(f"{self.store}: precomputed for one camera; render the scene with another instead")
        lights = load_lights(self.lights) if self.lights else transport.lights
        own, asked = stored_environment(transport), self.light != LightOptions()
        environment = self.light.environment(own) if own or asked else None
        check_indirect(lights, environment, transport.emits, self.output, self.local)
        notes(environment.notes if environment else ())
        arguments = lights, environment, self.output, self.picture, self.local, seconds
        return indirect_picture(transport, *arguments)

    def _distant(self, transport: "Transport", seconds: dict) -> dict:
        from jaxrelight.commands.progress import notes
        from jaxrelight.lighting.transport import Relighter
        from jaxrelight.precomputation.load import stored_environment

        with timed(seconds, "environment"):
            environment = self.light.environment(stored_environment(transport), emits=transport.emits)
            notes(environment.notes)
        camera = self.view.camera(transport.camera)
        return light_picture(Relighter(transport), environment, camera, self.output, self.picture)


def light_picture(
    relighter: "Relighter", environment: "Environment", camera: "Camera", output: pathlib.Path, picture: PictureOptions
) -> dict:
    """Lights what was precomputed, writes the picture and says what it took."""
    import jax

    from jaxrelight.images import write_image

    seconds = {}
    with timed(seconds, "view"):
        seen = relighter.view(camera)
    with timed(seconds, "light"):
        terms = jax.block_until_ready(relighter.light(environment))
    with timed(seconds, "shade"):
        image = relighter.image(environment, seen, terms, picture.background == "environment")
    with timed(seconds, "write"):
        write_image(output, image, picture.exposure)
    return {
        "picture": str(output),
        "width": camera.width,
        "height": camera.height,
        "covered": float(seen.covered.mean()),
        "mean_radiance": float(image[seen.covered][:, :3].mean()) if seen.covered.any() else 0.0,
        "seconds": seconds,
    }


def describe(transport: "Transport") -> dict:
    """What a picture was lit with, as a part of a summary."""
    from jaxrelight.commands.summary import versions

    return {
        "operator_bytes": transport.operator.nbytes,
        "kept_energy": transport.kept,
        "settings": dataclasses.asdict(transport.settings),
        "versions": versions(),
    }


@contextlib.contextmanager
def timed(seconds: dict[str, float], stage: str):
    """Writes down the seconds of a block."""
    start = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - start
