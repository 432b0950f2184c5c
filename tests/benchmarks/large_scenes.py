"""Scenes of many materials: two buildings, with materials by name, from file to picture."""

import argparse
import contextlib
import json
import pathlib
import tempfile
import time

from tests.benchmarks.measuring import Report, answer, megabytes, percent, run_child, shared

MODULE = "tests.benchmarks.large_scenes"
LAMBERT = 'type = "lambert"\nalbedo = {}'
GLOSSY = 'type = "phong"\ndiffuse = {}\nspecular = {}\nexponent = {}'
# Materials by the names that parts have in the file; parts that are not named keep what the file says.
SPONZA = {
    "leaf": LAMBERT.format([0.12, 0.25, 0.06]),
    "VasePlant": LAMBERT.format([0.15, 0.3, 0.08]),
    "vase_round": GLOSSY.format([0.35, 0.16, 0.1], [0.2, 0.2, 0.2], 30),
    "bricks": LAMBERT.format([0.5, 0.42, 0.33]),
    "arch": LAMBERT.format([0.55, 0.5, 0.42]),
    "ceiling": LAMBERT.format([0.5, 0.47, 0.42]),
    "column_a": LAMBERT.format([0.6, 0.57, 0.5]),
    "column_c": LAMBERT.format([0.6, 0.57, 0.5]),
    "floor": GLOSSY.format([0.3, 0.28, 0.25], [0.15, 0.15, 0.15], 40),
    "details": LAMBERT.format([0.4, 0.35, 0.3]),
}
WOOD = GLOSSY.format([0.33, 0.18, 0.08], [0.1, 0.1, 0.1], 25)
METAL = 'type = "phong"\ndiffuse = [0.05, 0.05, 0.05]\nspecular = {}\nexponent = {}'
STAIRCASE = {
    **dict.fromkeys(("WoodStairs", "WoodFloor", "WoodChair", "WoodLamp"), WOOD),
    "Wallpaper": LAMBERT.format([0.55, 0.6, 0.5]),
    "Painting1": LAMBERT.format([0.5, 0.3, 0.25]),
    "Painting2": LAMBERT.format([0.25, 0.35, 0.5]),
    "Painting3": LAMBERT.format([0.5, 0.45, 0.2]),
    "ChairSeat": LAMBERT.format([0.45, 0.1, 0.1]),
    "Brass": METAL.format([0.7, 0.55, 0.25], 60),
    "Gold": METAL.format([0.8, 0.6, 0.25], 80),
    "Copper": METAL.format([0.75, 0.45, 0.35], 60),
    "StainlessSteel": METAL.format([0.6, 0.6, 0.6], 60),
    "BrushedAluminium": METAL.format([0.6, 0.6, 0.62], 20),
    "Black": LAMBERT.format([0.03, 0.03, 0.03]),
}
CASES = {
    "sponza": ("sponza_crytek_stripped.obj", SPONZA, [-1050, 260, -40], [0, 420, 20], 70, 60),
    "staircase": ("staircase/staircase_by_material.glb", STAIRCASE, [0.0, 1.9, 4.6], [-1.2, 2.4, -2.0], 60, 0.3),
}


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 4, one scene; RESULTS.md is left as it is")
    parser.add_argument("--pictures", type=pathlib.Path, help="write the pictures here")
    parser.add_argument("--only", choices=CASES, help="one of the scenes")
    parser.add_argument("--child", type=pathlib.Path, help=argparse.SUPPRESS)
    parser.add_argument("--resolution", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(arguments.child, arguments.resolution)
        return
    shared("data", "mesh")
    resolution = 4 if arguments.quick else 32
    parameters = (
        f"vertices as receivers, K = 4, N = 128, resolution {resolution}, under Venice; two-sided, faces split until "
        "no edge is longer than is named; a fresh process for each"
    )
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write = not (arguments.quick or arguments.only)
        report = stack.enter_context(Report("large_scenes", "Scenes of many materials", parameters, write))
        chosen = [arguments.only] if arguments.only else list(CASES)[: 1 if arguments.quick else None]
        edges = {name: 1e9 if arguments.quick else CASES[name][-1] for name in chosen}
        measure(report, folder, resolution, edges, arguments.pictures)
        report.speed()


def measure(report: Report, folder: pathlib.Path, resolution: int, edges: dict[str, float], pictures):
    """Scenes from their files to pictures, with the longest edge of each."""
    columns = []
    for name, edge in edges.items():
        mesh, materials, origin, target, fov_y, _ = CASES[name]
        scene = folder / f"{name}.toml"
        scene.write_text(scene_text(mesh, materials, origin, target, fov_y, edge))
        told = run_child(MODULE, "--child", str(scene), "--resolution", str(resolution))
        columns.append(told)
        if pictures:
            pictures.mkdir(parents=True, exist_ok=True)
            (pictures / f"{name}.png").write_bytes(scene.with_suffix(".png").read_bytes())

    def row(what: str, show):
        return [what, *(show(told) for told in columns)]

    rows = [
        row("materials", lambda t: t["materials"]),
        ["longest edge", *edges.values()],
        row("triangles", lambda t: f"{t['triangles']:,}"),
        row("receivers", lambda t: f"{t['receivers']:,}"),
        row("reading the scene / s", lambda t: f"{t['read']:.1f}"),
        *(row(f"{stage} / s", lambda t, s=stage: f"{t['seconds'][s]:.1f}") for stage in columns[0]["seconds"]),
        row("rays / M", lambda t: f"{t['rays'] / 1e6:.0f}"),
        row("opening, first light, first view / s", lambda t: f"{t['first']:.1f}"),
        row("next light, next view / ms", lambda t: f"{t['light'] * 1e3:.0f}, {t['view'] * 1e3:.0f}"),
        row("store", lambda t: megabytes(sum(t["bytes"].values()))),
        row("operator in memory", lambda t: megabytes(t["operator_bytes"])),
        row("energy kept", lambda t: percent(t["kept"])),
        row("peak memory", lambda t: megabytes(t["peak_memory"])),
    ]
    report.table(["what", *edges], rows)


def scene_text(mesh: str, materials: dict[str, str], origin, target, fov_y, max_edge) -> str:
    """The scene as TOML; JSON writes strings and lists of numbers as TOML does."""
    sky = json.dumps(str(shared("data", "env", "pmndrs_venice.exr").resolve()))
    file = json.dumps(str(shared("data", "mesh", mesh).resolve()))
    named = ", ".join(f"{name} = {json.dumps(name)}" for name in materials)
    lines = [
        f"[camera]\norigin = {origin}\ntarget = {target}\nfov_y = {fov_y}\nwidth = 480\nheight = 360",
        f"[environment]\nfile = {sky}",
        f"[[mesh]]\nfile = {file}\ntwo_sided = true\nmax_edge = {max_edge}\nmaterials = {{ {named} }}",
        *(f"[material.{name}]\n{text}" for name, text in materials.items()),
    ]
    return "\n".join(lines) + "\n"


def child(path: pathlib.Path, resolution: int):
    """One scene in this process; its picture lies beside it."""
    import jax
    import numpy as np

    from jaxrelight import Transport, load_scene, open_store, write_image
    from jaxrelight.precomputation.precompute import precompute

    start = time.perf_counter()
    scene = load_scene(path)
    read = time.perf_counter() - start
    method = Transport(
        "vertices",
        reflection="factors",
        resolution=resolution,
        coefficients=min(128, 6 * resolution**2),
        # Faces are split by the scene.
        receiver_tolerance=0,
    )
    made = precompute(scene, method, path.with_suffix(""))
    start = time.perf_counter()
    relighter = open_store(made.folder)
    lit = relighter.light(scene.lights)
    view = relighter.view()
    picture = relighter.shade(lit, view).rgba(relighter.background(lit, view))
    first = time.perf_counter() - start

    def seconds(function) -> float:
        start = time.perf_counter()
        jax.block_until_ready(function())
        return time.perf_counter() - start

    light = float(np.median([seconds(lambda: relighter.light(scene.lights)) for _ in range(7)]))
    again = float(np.median([seconds(lambda: relighter.shade(lit, relighter.view())) for _ in range(7)]))
    covered = picture[picture[..., 3] > 0][:, :3]
    picture[..., :3] *= 0.6 / max(float(np.quantile(covered.mean(axis=-1), 0.9)), 1e-9)
    write_image(path.with_suffix(".png"), picture)
    answer(
        {
            "materials": len({part.material for part in scene.parts}),
            "triangles": sum(len(part.mesh.faces) for part in scene.parts),
            "receivers": made.receivers,
            "read": read,
            "seconds": made.seconds,
            "rays": made.rays,
            "bytes": made.nbytes,
            "first": first,
            "light": light,
            "view": again,
            "operator_bytes": relighter.transport.operator.nbytes,
            "kept": relighter.transport.kept,
        }
    )


if __name__ == "__main__":
    main()
