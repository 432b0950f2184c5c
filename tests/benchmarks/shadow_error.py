"""Shadows against the number of wavelet coefficients kept in a row (Wang 2006 §5.2.2, Figure 10)."""

import argparse
import contextlib
import dataclasses
import pathlib
import tempfile

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared
from tests.benchmarks.pictures import contact_sheet

SCENE = "bunny_lambert"
COUNTS = 16, 32, 64, 96, 128, 256, 512, 1024
SUN_RADIUS = 3.0  # degrees


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.shadow_error", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 16, few pixels; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument("--pictures", type=pathlib.Path, help="write a sheet of pictures for each light here")
    arguments = parser.parse_args()
    shared("reference")
    resolution, size = (16, 96) if arguments.quick else (64, 256)
    parameters = (
        f"{SCENE}, pixels as receivers, resolution {resolution}; relative L2, trimmed (untrimmed), against all "
        "coefficients, over the pixels of the floor that lie in shadow: those with less than 95 % of the floor's light"
    )
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        report = stack.enter_context(
            Report("shadow_error", "Shadows and kept coefficients", parameters, not arguments.quick)
        )
        measure(report, folder, resolution, size, arguments.pictures)


def measure(report: Report, folder: pathlib.Path, resolution: int, size: int, pictures: pathlib.Path | None):
    """Every light with every number of coefficients."""
    from jaxrelight import Transport, image_error, load_environment, load_scene, prepare
    from jaxrelight.lighting.transport import TransportRelighter

    scene = load_scene(shared("reference", f"{SCENE}.toml"))
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=size, height=size))
    lights = {
        f"a sun of {2 * SUN_RADIUS:.0f}°": sun(),
        "Grace": load_environment(shared("data", "env", "grace_latlong.exr"), scale=10),
        "sunset": load_environment(shared("data", "env", "blender_sunset.exr")),
    }
    method = Transport("pixels", resolution=resolution, coefficients=max(COUNTS))
    most = prepare(scene, method, folder / SCENE)
    assert isinstance(most, TransportRelighter)
    view, whole = most.view(), most.exact()
    relighters = {count: TransportRelighter(with_fewer(most.transport, count)) for count in COUNTS}
    covered = np.asarray(view.surfaces.covered)
    floor = np.zeros(covered.size, bool)
    (part,) = (part for part in view.surfaces.parts if most.materials[part.material].name == "floor")
    pixels = np.asarray(part.pixels.pixel)
    floor[pixels[pixels < floor.size]] = True
    floor = floor.reshape(view.shape)

    def picture(relighter: TransportRelighter, light) -> np.ndarray:
        lit = relighter.light(light)
        return relighter.shade(lit, view).rgba(relighter.background(lit, view))

    columns = {}
    for name, light in lights.items():
        truth = picture(whole, light)
        level = truth[..., :3].sum(axis=-1)
        shadow = floor & (level < 0.95 * np.quantile(level[floor], 0.95))
        reference = np.concatenate([truth[..., :3], shadow[..., None]], axis=-1)
        shown, column = {}, []
        for count, relighter in relighters.items():
            image = picture(relighter, light)
            error = image_error(image, reference)
            column.append(f"{percent(error.trimmed)} ({percent(error.untrimmed)})")
            shown[f"{count} ({percent(count / (6 * resolution**2))})"] = image
        columns[f"{name} ({shadow.sum():,} pixels)"] = column
        if pictures:
            exposure = float(-np.log2(np.quantile(level[covered], 0.95) / 3) - 0.3)
            title = "".join(letter if letter.isalnum() else "-" for letter in name).strip("-")
            contact_sheet(pictures / f"shadows-{title}.png", {**shown, "all": truth}, 3, exposure)
    rows = [
        [count, percent(count / (6 * resolution**2)), percent(relighters[count].transport.kept), *cells]
        for count, *cells in zip(COUNTS, *columns.values(), strict=True)
    ]
    report.table(["N", "of all", "energy kept", *columns], rows)


def sun():
    """A sky of 0.3 with a round sun of 100 at 40° above the horizon: sharp shadows."""
    from jaxrelight import environment
    from jaxrelight.basis import latlong

    height = 512
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    elevation, turn = np.radians(40), np.radians(-50)
    centre = [np.cos(elevation) * np.sin(turn), np.sin(elevation), np.cos(elevation) * np.cos(turn)]
    inside = latlong.directions(u, v) @ np.array(centre) > np.cos(np.radians(SUN_RADIUS))
    return environment(np.where(inside, 100.0, 0.3)[..., None].repeat(3, axis=-1))


def with_fewer(transport, count: int):
    """The transport with the `count` largest of each row's kept coefficients: what baking with that number keeps."""
    from jaxrelight.operators.sparse_rows import sparse_rows

    blocks = []
    for block in transport.blocks:
        operator = block.operator
        n = operator.indices.shape[-1]
        indices = np.asarray(operator.indices).reshape(-1, n)[: operator.row_count]
        values = np.stack([np.asarray(v).reshape(-1, n)[: operator.row_count] for v in operator.values], axis=1)
        energy = np.sum(values**2, axis=1)
        chosen = np.sort(np.argsort(-energy, axis=-1, kind="stable")[:, :count], axis=-1)
        left = np.take_along_axis(values, chosen[:, None], axis=-1)
        dropped = block.dropped + np.sum(values**2, axis=-1) - np.sum(left**2, axis=-1)
        fewer = sparse_rows(np.take_along_axis(indices, chosen, axis=-1), left, operator.columns)
        blocks.append(dataclasses.replace(block, operator=fewer, dropped=dropped))
    total = sum(_energy(block) for block in transport.blocks)
    lost = sum(float(block.dropped.sum(dtype=float)) * 3 / block.dropped.shape[1] for block in blocks)
    return dataclasses.replace(transport, blocks=tuple(blocks), kept=1 - lost / total)


def _energy(block) -> float:
    """Energy of whole rows: what is kept and what is not, of three channels."""
    values = block.operator.values
    kept = sum(float(np.sum(np.asarray(v, float) ** 2)) for v in values) / len(values)
    return 3 * (kept + float(block.dropped.sum(dtype=float)) / block.dropped.shape[1])


if __name__ == "__main__":
    main()
