"""Images against the reference renderer's, and compressed transport against streamed."""

import argparse
import contextlib
import dataclasses
import functools
import pathlib
import tempfile
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, megabytes, percent, shared

# Scene, cube-map resolution, target for the streamed image of pixel receivers.
STREAMED = (
    ("bunny_lambert", 64, 0.015),
    ("bunny_phong", 64, 0.04),
    ("bunny_phong", 128, 0.03),
    ("spot_lafortune", 64, 0.015),
    ("spot_lafortune", 128, 0.015),
)
# Scene, what it is lit by, target for N = 128 against streamed.
COMPRESSED = (("bunny_lambert", "sunset", 0.02), ("bunny_phong", "Grace", 0.035))
DIAL = 32, 64, 128, 256, 512


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.reference_images", description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="small pictures, resolution 16; RESULTS.md is left as it is"
    )
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument(
        "--converged",
        type=pathlib.Path,
        help="a folder of SCENE_b0.exr by the reference renderer with many more samples (its own script, --spp 32768): "
        "errors against them stand beside those against the noisier references",
    )
    parser.add_argument("--only", choices=("streamed", "dial", "vertices"), help="one of the tables")
    arguments = parser.parse_args()
    shared("reference")
    coarser = 4 if arguments.quick else 1
    parameters = (
        f"scenes' own cameras and lights, {256 // coarser}×{256 // coarser} pixels, 1 ray a texel; errors by "
        "`jaxrelight.images.image_error`"
    )
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write = not (arguments.quick or arguments.only)
        report = stack.enter_context(Report("reference_images", "Reference images", parameters, write))
        parts = {
            "streamed": functools.partial(streamed, converged=arguments.converged),
            "dial": dial,
            "vertices": vertices,
        }
        for name, part in parts.items():
            if arguments.only in (None, name):
                part(report, folder, coarser)
        report.speed()


def streamed(report: Report, folder: pathlib.Path, coarser: int, converged: pathlib.Path | None):
    """Pixel receivers with all coefficients against the reference images, and against less noisy ones."""
    from jaxrelight import image_error

    rows, noise = [], {}
    for scene, resolution, target in STREAMED:
        made = render(scene, folder, coarser, resolution=resolution // coarser, receivers="pixels", coefficients="all")
        better = _converged(scene, converged, coarser)
        against = ""
        if better is not None:
            against = percent(made.error(better).trimmed)
            noise[scene] = image_error(_reference(scene, coarser), better).trimmed
        errors = _errors(made.error(_reference(scene, coarser)), target)
        rows.append([scene, resolution // coarser, *errors, against, *made.costs])
    report.text("**Pixel receivers, streamed (all coefficients), against `*_b0.exr`.**")
    report.table(["scene", "resolution", *ERRORS, "against more samples", *COSTS], rows)
    for scene, error in noise.items():
        report.text(
            f"The reference image of {scene} is itself {percent(error)} (trimmed) off a picture of the same renderer "
            "with more samples: no picture can be much nearer to it than that."
        )


def _converged(scene: str, folder: pathlib.Path | None, coarser: int) -> np.ndarray | None:
    from jaxrelight import read_image

    path = folder / f"{scene}_b0.exr" if folder else None
    return read_image(path)[::coarser, ::coarser] if path and path.exists() else None


def dial(report: Report, folder: pathlib.Path, coarser: int):
    """What N coefficients cost against all of them."""
    rows = []
    for scene, light, target in COMPRESSED:
        options: dict[str, Any] = {"resolution": 64 // coarser, "receivers": "pixels"}
        whole = render(scene, folder, coarser, coefficients="all", **options)
        for count in DIAL[: 2 if coarser > 1 else None]:
            made = render(scene, folder, coarser, coefficients=count, **options)
            limit = target if count == 128 else None
            errors = _errors(made.error(whole.image), limit)
            against = percent(made.error(_reference(scene, coarser)).trimmed)
            rows.append([f"{scene}, {light}", count, *errors, against, percent(made.kept), *made.costs])
    report.text(
        f"**N coefficients against streamed**, pixel receivers, resolution {64 // coarser}: relit colours of the "
        "surface pixels; the error against the reference image beside them."
    )
    report.table(["scene, light", "N", *ERRORS, "against reference", "energy kept", *COSTS], rows)


def vertices(report: Report, folder: pathlib.Path, coarser: int):
    """Vertex receivers against the reference images: diffuse, and glossy by each way to reflect."""
    options: dict[str, Any] = {"receivers": "vertices", "resolution": 64 // coarser}
    ways = [("bunny_lambert", "–", {"coefficients": 128})]
    ways += [("bunny_phong", way, {"reflection": way}) for way in ("filtered", "traced", "factors")]
    rows = []
    for scene, way, dials in ways:
        made = render(scene, folder, coarser, **options, **dials)
        target = None if way == "factors" else 0.05
        rows.append([scene, way, *_errors(made.error(_reference(scene, coarser)), target), *made.costs])
    report.text(
        f"**Vertex receivers, from any view, against `*_b0.exr`**, resolution {64 // coarser}: bunny_lambert by 128 "
        "coefficients, bunny_phong by filtered light times filtered or traced visibility, and by 4 factors."
    )
    report.table(["scene", "reflection", *ERRORS, *COSTS], rows)


ERRORS = "trimmed", "untrimmed", "mean ratio", "target (trimmed)"
COSTS = "receivers", "rays / M", "visibility / s", "transport / s", "light / s", "store"


def _errors(error, target: float | None) -> list[str]:
    limit = f"≤ {percent(target)}" if target else ""
    return [percent(error.trimmed), percent(error.untrimmed), f"{error.mean_ratio:.4f}", limit]


@dataclasses.dataclass(frozen=True)
class Made:
    """An image, and what it took."""

    image: np.ndarray
    kept: float
    costs: list[str]

    def error(self, reference: np.ndarray):
        """Over the pixels that the reference covers."""
        from jaxrelight import image_error

        return image_error(self.image, reference)


def render(name: str, folder: pathlib.Path, coarser: int, **options) -> Made:
    """Precomputes a scene, or reuses what is there, and lights it with its own environment.

    Scenes of the same geometry share a folder, and so their visibility; a stage that was found done costs nothing.
    """
    import time

    import jax

    from jaxrelight import Transport, load_scene
    from jaxrelight.lighting.prepare import prepare_with_build
    from jaxrelight.lighting.transport import TransportRelighter

    scene = load_scene(shared("reference", f"{name}.toml"))
    width, height = scene.camera.width // coarser, scene.camera.height // coarser
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=width, height=height))
    place = folder / f"{name.split('_')[0]}-{options['receivers']}"
    relighter, done = prepare_with_build(scene, Transport(**options), place)
    assert isinstance(relighter, TransportRelighter)
    assert done is not None
    view = relighter.view()
    start = time.perf_counter()
    lit = jax.block_until_ready(relighter.light(scene.lights))
    light = time.perf_counter() - start
    costs = [
        f"{done.receivers:,}",
        f"{done.rays / 1e6:.0f}" if done.rays else "reused",
        f"{done.seconds['visibility']:.1f}" if done.rays else "reused",
        f"{done.seconds['transport']:.1f}",
        f"{light:.2f}",
        megabytes(sum(done.nbytes.values())),
    ]
    image = relighter.shade(lit, view).rgba(relighter.background(lit, view))
    return Made(image, relighter.transport.kept, costs)


def _reference(name: str, coarser: int) -> np.ndarray:
    from jaxrelight import read_image

    return read_image(shared("reference", f"{name}_b0.exr"))[::coarser, ::coarser]


if __name__ == "__main__":
    main()
