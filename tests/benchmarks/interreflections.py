"""Bounced light: reference images, a closed box, and the study of Figures 6 and 11 of Wang 2006."""

import argparse
import contextlib
import dataclasses
import pathlib
import tempfile
import time
from typing import Any

import numpy as np

from jaxrelight.lighting.prepare import prepare_with_build
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.precomputation.precompute import precompute
from tests.benchmarks.measuring import Report, answer, megabytes, percent, run_child, shared
from tests.benchmarks.pictures import contact_sheet

MODULE = "tests.benchmarks.interreflections"
PICTURE = pathlib.Path(__file__).with_name("interreflections.png")
# Receivers, coefficients, target of the trimmed error against the reference image.
REFERENCES = (
    ("pixels", "all", 0.02),
    ("vertices", 128, 0.05),
    ("vertices", "shared", 0.05),
)
# Of the study, and of trials: a mesh, quads along each side of the floor, and pixels along a side.
STUDY = "dragon_vrip_res4.ply", 40, 192
TRIAL = "spot.obj", 12, 64
GATHER = 8, 16, 24, 32, 64
FINEST = 96
COEFFICIENTS = 16, 64, 256
TOLERANCES = 0.2, 0.1, 0.05, 0.02, 0.01, 0.005


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 8, a small mesh; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument("--only", choices=("box", "references", "cost", "study"), help="one of the tables")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    resolution = 8 if arguments.quick else 64
    if arguments.child:
        _pass_of_the_bunny(arguments.folder, resolution)
        return
    shared("reference")
    parameters = f"resolution {resolution}; look-around 6×32² where nothing else is said; errors by `image_error`"
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write = not (arguments.quick or arguments.only)
        report = stack.enter_context(Report("interreflections", "Interreflections", parameters, write))
        parts = {"box": box, "references": references, "cost": cost, "study": study}
        for name, part in parts.items():
            if arguments.only in (None, name):
                part(report, folder, resolution)
        report.speed()


def box(report: Report, folder: pathlib.Path, resolution: int):
    """A closed box whose walls emit and reflect one half, against its series."""
    import jaxrelight as jr
    from jaxrelight.brdf.material import Component, Material
    from tests.scenes import inside_out

    made = jr.box((1, 1, 1), 8)
    inside = inside_out(made)
    wall = Material((Component(jr.lambert([0.5] * 3)),), emission=np.ones(3, np.float32))
    camera = jr.Camera((0, 0, 0.4), (0.2, 0.1, -1), fov_y=80.0, width=64, height=64)
    scene = jr.Scene([jr.Part(inside, "wall")], {"wall": wall}, camera)
    dark, rows = jr.environment(np.zeros((4, 8, 3), np.float32)), []
    for bounces in (1, 2) if resolution < 64 else (1, 2, 3, 4, 6, 8, 12):
        method = jr.Transport(
            "vertices", reflection="factors", resolution=4, bounces=bounces, compression_tolerance=0.0
        )
        image = jr.prepare(scene, method, folder / "box").picture(dark)[..., :3]
        series = (1 - 0.5 ** (bounces + 1)) / 0.5
        off = np.abs(image / series - 1)
        rows.append([bounces, f"{series:.4f}", percent(off.mean()), percent(off.max()), percent(1 - image.mean() / 2)])
    report.text("**A closed box** of albedo 0.5, lit by what its walls emit, seen from inside; target 1 %.")
    heads = ["bounces", "truncated series", "mean error", "largest", "below E/(1 − ρ)"]
    report.table(heads, rows)


def references(report: Report, folder: pathlib.Path, resolution: int):
    """`bunny_lambert` with one and two bounces against the reference renderer."""
    import jaxrelight as jr

    scene, step, rows = jr.load_scene(shared("reference", "bunny_lambert.toml")), 1, []
    dials: dict[str, Any] = {"resolution": resolution}
    if resolution < 64:
        scene, step = _smaller("bunny_lambert", *TRIAL), 4
        dials["gather_resolution"] = 4
    for receivers, coefficients, target in REFERENCES:
        for bounces in (0, 1) if resolution < 64 else (0, 1, 2):
            method = jr.Transport(receivers, coefficients=coefficients, bounces=bounces, **dials)
            image, made, _ = _lit(scene, method, folder / "bunny")
            reference = jr.read_image(shared("reference", f"bunny_lambert_b{bounces}.exr"))
            error = jr.image_error(image, reference[::step, ::step])
            kept = coefficients if isinstance(coefficients, str) else f"N = {coefficients}"
            passes = sum(seconds for stage, seconds in made.seconds.items() if stage.startswith("bounce"))
            row = [f"{receivers}, {kept}", made.header["method"]["dials"]["bounces"]]
            numbers = [percent(error.trimmed), percent(error.untrimmed), f"{error.mean_ratio:.4f}", percent(target)]
            rows.append([*row, *numbers, f"{passes:.0f}", megabytes(_held(made))])
    report.text("**`bunny_lambert` against the reference images** with as many bounces.")
    heads = [
        "receivers",
        "bounces",
        "trimmed",
        "untrimmed",
        "mean ratio",
        "target (trimmed)",
        "bounces / s",
        "direct and bounced",
    ]
    report.table(heads, rows)


def cost(report: Report, folder: pathlib.Path, resolution: int):
    """One pass of the bunny with K = 4, in a process of its own."""
    with tempfile.TemporaryDirectory() as fresh:
        quick = ["--quick"] if resolution < 64 else []
        made = run_child(MODULE, "--child", "--folder", fresh, *quick)
    report.text(
        "**One bounce of `bunny_phong`**, K = 4, vertices, clusters, a fresh store. The paper's took 25–32 minutes "
        "more than direct light (bunny, 1 and 4 terms, P4 2.4 GHz). Targets: 10 minutes, 3221 MB (3 GiB)."
    )
    seconds = [f"{made['seconds'][stage]:.0f}" for stage in ("visibility", "transport", "bounce 1")]
    sizes = [megabytes(made[key]) for key in ("peak_memory", "bytes")]
    heads = ["receivers", "visibility / s", "direct / s", "bounce / s", "peak memory", "rows of both passes"]
    report.table(heads, [[f"{made['receivers']:,}", *seconds, *sizes]])


def _pass_of_the_bunny(folder: pathlib.Path, resolution: int):
    import jaxrelight as jr

    scene = jr.load_scene(shared("reference", "bunny_phong.toml"))
    dials: dict[str, Any] = {}
    if resolution < 64:
        scene, dials = _smaller("bunny_phong", *TRIAL), {"gather_resolution": 4}
    made = precompute(
        scene, jr.Transport("vertices", reflection="factors", resolution=resolution, bounces=1, **dials), folder
    )
    answer({"seconds": made.seconds, "receivers": made.receivers, "bytes": _held(made)})


def _held(made) -> int:
    """Bytes of the rows of all passes."""
    return sum(made.nbytes.get(layers, 0) for layers in ("transport", "bounced"))


def study(report: Report, folder: pathlib.Path, resolution: int):
    """Error and energy of bounced light over the look-around, the bounces and what is kept of each pass."""
    import jaxrelight as jr
    from jaxrelight.operators.clustered import Clustered
    from jaxrelight.operators.contract import parts_of

    quick, resolution = resolution < 64, min(resolution, 16)
    few, most, side, finest_side, least = (1, 1, 4, 12, 0.1) if quick else (None, 3, 32, FINEST, 0.002)
    scene = _smaller("bunny_phong", *(TRIAL if quick else STUDY))
    store = folder / "study"

    def bounced(bounces: int = 1, **dials) -> tuple[np.ndarray, float, str]:
        """Bounced light alone, what the last bounce took, and how many coefficients and shared rows a group has."""
        # Light that bounces is applied alone, that of a sun as all else.
        dials = {"gather_resolution": side, **dials}
        method = jr.Transport(
            "vertices", resolution, reflection="factors", bounces=bounces, split_sun=not bounces, **dials
        )
        image, made, relighter = _lit(scene, method, store)
        if bounces:
            transport = relighter.transport
            alone = (dataclasses.replace(block, operator=parts_of(block.operator)[1]) for block in transport.blocks)
            other = TransportRelighter(dataclasses.replace(transport, blocks=tuple(alone)))
            image = other.picture(scene.lights, background=False)
        sizes = [0, 0]
        for operator in relighter.transport.operator.operators if bounces else ():
            bounced_rows = parts_of(operator)[1]
            assert isinstance(bounced_rows, Clustered)
            for part in bounced_rows.buckets:
                sizes[0] += part.basis.shape[0] * part.basis.shape[2]
                sizes[1] += part.basis.shape[0] * part.basis.shape[1]
        groups = sum(len(block.groups) for block in relighter.transport.blocks)
        shown = ", ".join(f"{size / groups:.0f}" for size in sizes)
        return image, made.seconds.get(f"bounce {bounces}", 0.0), shown

    none, *_ = bounced(0, compression_tolerance=least)
    finest, *_ = bounced(1, gather_resolution=finest_side, compression_tolerance=least)
    light = float(np.linalg.norm(finest[..., :3]))
    pictures = {}

    def row(image: np.ndarray, seconds: float) -> list[str]:
        off = float(np.linalg.norm((image - finest)[..., :3]))
        energy = image[..., :3].sum() / finest[..., :3].sum()
        return [percent(off / light), percent(energy), f"{seconds:.0f}"]

    rows = []
    for look in GATHER[:few]:
        for gather in ("barycentric", "nearest"):
            start = time.perf_counter()
            image, *_ = bounced(1, gather_resolution=look, compression_tolerance=least, gather=gather)
            rows.append([f"6×{look}²", gather, *row(image, time.perf_counter() - start)])
            if gather == "nearest":
                pictures[f"bounced light, 6×{look}², nearest"] = image[..., :3] * 3
    report.text(
        f"**What receivers look around with** (Figure 11). {scene.name}, of the bunny's Phong 50, on its floor; "
        f"resolution {resolution}, vertices, one bounce. Error of a picture of bounced light alone, "
        f"relative to that of 6×{finest_side}² at tolerance {least}, and its energy. Seconds include lighting."
    )
    heads = ["look-around", "read at", "error of bounced light", "energy", "seconds"]
    report.table(heads, rows)

    rows = []
    for tolerance in TOLERANCES[:few]:
        image, seconds, sizes = bounced(1, compression_tolerance=tolerance)
        rows.append([f"clusters, tolerance {tolerance}", sizes, *row(image, seconds)])
    for count in COEFFICIENTS[:few]:
        image, seconds, sizes = bounced(1, coefficients=count)
        rows.append([f"direct light in rows, N = {count}", sizes, *row(image, seconds)])
    report.text(
        f"**What is kept of each pass**, at 6×{side}²: error of bounced light alone, through that of the direct light "
        "that it is gathered from. Bounced light of rows is in clusters of tolerance 0.02."
    )
    report.table(["kept", "coefficients, shared rows a group", "error", "energy", "seconds"], rows)

    rows, last, first = [], np.zeros_like(none), None
    pictures["direct light"] = none[..., :3]
    for bounces in range(1, most + 1):
        image, seconds, sizes = bounced(bounces, compression_tolerance=least)
        added = (image - last)[..., :3].sum() / none[..., :3].sum()
        first = first or added
        rows.append([bounces, percent(added), f"{added / first:.3f}", sizes, f"{seconds:.0f}"])
        pictures[f"{bounces} bounce{'s' if bounces > 1 else ''}"] = (none + image)[..., :3]
        last = image
    report.text(f"**Bounces** (Figure 6): what each adds to the energy of direct light. Pictures: `{PICTURE.name}`.")
    report.table(["bounce", "added", "of the first", "coefficients, shared rows a group", "seconds"], rows)
    if not quick:
        contact_sheet(PICTURE, pictures, 3, 0.0)


def _smaller(name: str, mesh: str, floor: int, size: int):
    """A scene of the bunny with another mesh, a floor of fewer faces, and fewer pixels."""
    import jaxrelight as jr

    text = shared("reference", f"{name}.toml").read_text()
    text = text.replace("bunny_mitsuba.ply", mesh).replace("resolution = 176", f"resolution = {floor}")
    text = text.replace("../data", str(shared("data").resolve()))
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, f"{pathlib.Path(mesh).stem}.toml")
        path.write_text(text)
        scene = jr.load_scene(path)
    return dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=size, height=size))


def _lit(scene, method, folder: pathlib.Path):
    """The picture that the scene's own light makes, without background."""
    relighter, made = prepare_with_build(scene, method, folder)
    assert isinstance(relighter, TransportRelighter)
    assert made is not None
    return relighter.picture(background=False), made, relighter


if __name__ == "__main__":
    main()
