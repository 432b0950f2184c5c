"""jaxrelight demo: a scene and a sky made by code, precomputed and relit."""

import dataclasses
import pathlib
from typing import Annotated

import tyro

from jaxrelight.timing import timed

# Degrees by which the demo turns its sky, and eyes from which it looks.
_ROTATIONS = (0.0, 70.0, 200.0)
_EYES = ((0.7, 1.0, 2.7), (-2.1, 1.3, 1.7))


@dataclasses.dataclass(frozen=True)
class Demo:
    """Make a scene and a sky by code, precompute, relight under several rotations and views, say what it measured."""

    output: Annotated[pathlib.Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = pathlib.Path("jaxrelight-demo")
    """Where the pictures and the store go."""
    detail: float = 1.0
    """Factor on the number of quads along each side of every mesh."""
    height: int = 480
    """Rows of each picture."""
    json: bool = False
    """Print one JSON object at the end."""

    def run(self):
        """Runs the command."""
        import time

        from jaxrelight.commands.pictures import describe, describe_build
        from jaxrelight.commands.progress import progress
        from jaxrelight.commands.summary import summarize
        from jaxrelight.errors import InputError

        imports: dict[str, float] = {}
        with timed(imports, "imports"):
            import jax
            import numpy as np

            from jaxrelight.images import image_error, write_image
            from jaxrelight.lighting.prepare import prepare_with_build
            from jaxrelight.lighting.transport import TransportRelighter
            from jaxrelight.methods import Transport
            from jaxrelight.scene.demo_scene import demo_scene

        if not 0.05 <= self.detail <= 8 or not 16 <= self.height <= 4096:
            raise InputError("the demo's detail goes from 0.05 to 8, its height from 16 to 4,096")
        start = time.perf_counter()
        scene = demo_scene(self.detail, self.height)
        sky = scene.lights.environment
        assert sky is not None
        method = Transport("vertices", resolution=32, terms=8, coefficients=256)
        with progress(self.json) as report:
            relighter, build = prepare_with_build(scene, method, self.output / "store", report)
        assert isinstance(relighter, TransportRelighter)
        assert build is not None

        # Twice as many pixels along each side, averaged afterwards: smooth edges.
        cameras = [
            dataclasses.replace(scene.camera, origin=eye, width=2 * scene.camera.width, height=2 * scene.camera.height)
            for eye in _EYES
        ]
        spent: dict[str, list[float]] = {"change_of_light": [], "shading": []}

        def relit(relighter, environment, view):
            """The picture, timed by its parts."""
            began = time.perf_counter()
            lit = jax.block_until_ready(relighter.light(environment))
            middle = time.perf_counter()
            image = jax.block_until_ready(relighter.shade(lit, view))
            spent["change_of_light"].append(middle - began)
            spent["shading"].append(time.perf_counter() - middle)
            return image.rgba(relighter.background(lit, view))

        rows = []
        for camera in cameras:
            view = relighter.view(camera)
            pictures = [relit(relighter, sky.with_(rotate_y=degrees), view) for degrees in _ROTATIONS]
            smooth = [p.reshape(camera.height // 2, 2, camera.width // 2, 2, 4).mean(axis=(1, 3)) for p in pictures]
            rows.append(np.concatenate(smooth, axis=1))
        write_image(self.output / "relit.png", np.concatenate(rows), exposure=-0.3)
        for i, picture in enumerate(np.split(rows[0], len(_ROTATIONS), axis=1)):
            write_image(self.output / f"sky_turned_{_ROTATIONS[i]:.0f}.png", picture, exposure=-0.3)

        # At the size that was asked for: once to compile, then timed.
        relit(relighter, sky, relighter.view())
        began = time.perf_counter()
        view = relighter.view()
        viewed = time.perf_counter() - began
        kept = relit(relighter, sky, view)
        milliseconds = {"change_of_view": 1e3 * viewed, **{name: 1e3 * times[-1] for name, times in spent.items()}}
        error = image_error(kept, relit(relighter.exact(), sky, view))
        summarize(
            {
                "command": "demo",
                **describe_build(build),
                "picture": str(self.output / "relit.png"),
                **describe(relighter),
                "milliseconds": milliseconds,
                "error": {"coefficients": error.untrimmed, "without_worst_5_percent": error.trimmed},
                "seconds": {**imports, **build.seconds, "total": time.perf_counter() - start},
            },
            self.json,
        )
