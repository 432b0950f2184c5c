"""jaxrelight relight: a picture from a store."""

import dataclasses
import pathlib
import time

import tyro

from jaxrelight.commands.options import LightOptions, Output, PictureOptions, ViewOptions


@dataclasses.dataclass(frozen=True)
class Relight:
    """Light a precomputed scene anew: another environment, rotation or camera."""

    store: tyro.conf.Positional[pathlib.Path]
    """What `precompute` made."""
    output: Output
    """The picture: .exr, .hdr or .png."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    view: tyro.conf.OmitArgPrefixes[ViewOptions] = ViewOptions()
    picture: tyro.conf.OmitArgPrefixes[PictureOptions] = PictureOptions()
    json: bool = False
    """Print one JSON object at the end."""

    def run(self):
        """Runs the command."""
        from jaxrelight.commands.progress import summarize

        picture = relight(self.store, self.output, self.light, self.view, self.picture)
        summarize(picture, self.json)


def relight(
    folder: pathlib.Path, output: pathlib.Path, light: LightOptions, view: ViewOptions, picture: PictureOptions
) -> dict:
    """Opens a store, lights it, writes the picture and says what it took."""
    import jax

    from jaxrelight.commands.progress import notes, versions
    from jaxrelight.images import check_writable, write_image
    from jaxrelight.lighting.transport import Relighter
    from jaxrelight.transport.load import stored_environment

    check_writable(output)
    seconds, start = {}, time.perf_counter()

    def lap(stage: str):
        nonlocal start
        seconds[stage], start = time.perf_counter() - start, time.perf_counter()

    relighter = Relighter.open(folder)
    lap("open")
    environment = light.environment(stored_environment(relighter.transport))
    notes(environment.notes)
    lap("environment")
    camera = view.camera(relighter.transport.camera)
    seen = relighter.view(camera)
    lap("view")
    terms = jax.block_until_ready(relighter.light(environment))
    lap("light_first")
    terms = jax.block_until_ready(relighter.light(environment))
    lap("light")
    image = relighter.image(environment, seen, terms, picture.background == "environment")
    lap("shade")
    write_image(output, image, picture.exposure)
    lap("write")
    return {
        "picture": str(output),
        "size": f"{camera.width} × {camera.height}",
        "covered": float(seen.covered.mean()),
        "mean_radiance": float(image[seen.covered][:, :3].mean()) if seen.covered.any() else 0.0,
        "seconds": seconds,
        "operator_bytes": relighter.transport.operator.nbytes,
        "kept_energy": relighter.transport.kept,
        "settings": dataclasses.asdict(relighter.transport.settings),
        "versions": versions(),
    }
