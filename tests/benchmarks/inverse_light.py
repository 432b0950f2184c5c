"""An environment from another renderer's picture: its fit, another view under it, and steps against Adam and Mitsuba.

What other views should look like, and the gradients of a path tracer, come of Mitsuba 3 (`pip install mitsuba`), which
is none of this project's packages and needs a libLLVM that DRJIT_LIBLLVM_PATH names; without it, they are left out.
"""

import argparse
import dataclasses
import importlib.util
import pathlib
import subprocess
import sys
import tempfile
import time
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxrelight as jr
from jaxrelight.inverse.light_problem import adjoint, applied
from jaxrelight.inverse.light_setup import light_task
from jaxrelight.inverse.light_solver import LightSolver
from jaxrelight.inverse.solve_light import InverseLight, environment
from tests.benchmarks.measuring import Report, percent, shared

SCENES = {"bunny_lambert": "Lambert", "bunny_phong": "Phong 50"}
# Another side of the object than the one that is seen.
OTHER_EYE = (-1.9, 0.7, 1.4)
STEP_SIZES = (0.003, 0.01, 0.03, 0.1, 0.3)
# Adam is given so many times the applications that least squares takes.
MORE = 25


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.inverse_light", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one small case; RESULTS.md is left as it is")
    parser.add_argument("--minutes", type=float, default=5.0, help="of Mitsuba's descent, by each of two step sizes")
    parser.add_argument("--descend", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.descend:
        descend(pathlib.Path(arguments.descend), arguments.minutes)
        return
    quick = arguments.quick
    resolution, unknowns = (16, 4) if quick else (64, 16)
    parameters = f"6×{unknowns}×{unknowns} unknown texels, transport at pixels, 6×{resolution}×{resolution} directions"
    with Report("inverse_light", "Light from pictures", parameters, not quick) as report:
        report.text(
            "Pictures are Mitsuba's, not our own: what our transport misses of them is in every residual. Errors are "
            "relative L2 over the object and the floor, trimmed by the worst 5 % of pixels, and untrimmed. Pixels that "
            "are held out are a tenth, drawn at random. The other view is relit by transport at its own pixels under "
            "the light that was found, and compared with Mitsuba's picture of it under the true light."
        )
        cases = {name: Case(name, resolution, quick=quick) for name in list(SCENES)[: 1 if quick else 2]}
        rows = [row(case, unknowns, quick=quick) for case in cases.values()]
        heads = (
            "scene",
            "held-out pixels",
            "another view",
            "its object alone",
            "told of",
            "applications",
            "seconds",
            "precomputation",
        )
        report.table(heads, rows)
        first = cases["bunny_lambert"]
        against_adam(report, first, unknowns, quick=quick)
        if not quick and has_mitsuba():
            against_mitsuba(report, first, arguments.minutes)


class Case:
    """A reference picture and what lights its scene."""

    def __init__(self, name: str, resolution: int, *, quick: bool):
        self.name = name
        self.file = shared("reference", f"{name}.toml")
        self.picture = jr.read_image(shared("reference", f"{name}_b0.exr"))
        self.scene = jr.load_scene(self.file)
        if quick:
            camera = dataclasses.replace(self.scene.camera, width=64, height=64)
            self.scene = dataclasses.replace(self.scene, camera=camera)
            self.picture = self.picture.reshape(64, 4, 64, 4, 4).mean(axis=(1, 3))
        self.mask = self.picture[..., 3] > 0.999
        start = time.perf_counter()
        self.relighter = prepared(self.scene, resolution)
        self.seconds = time.perf_counter() - start
        self.resolution = resolution

    def solved(self, unknowns, **dials) -> InverseLight:
        """The light of the picture; the first time compiles."""
        given = [self.picture[..., :3]], None
        environment(self.relighter, *given, unknowns=unknowns, masks=[self.mask], max_steps=8, **dials)
        return environment(self.relighter, *given, unknowns=unknowns, masks=[self.mask], **dials)


def prepared(scene: jr.Scene, resolution: int):
    """Transport of direct light at the scene's pixels, in a store that is thrown away."""
    folder = tempfile.mkdtemp()
    return jr.prepare(scene, jr.Transport("pixels", resolution=resolution), pathlib.Path(folder) / "store")


def errors(picture: np.ndarray, truth: np.ndarray) -> str:
    """Relative L2 of pixels [n, 3], trimmed and untrimmed."""
    squares, of_truth = np.sum((picture - truth) ** 2, axis=1), np.sum(truth**2, axis=1)
    kept = squares <= np.quantile(squares, 0.95)
    trimmed = np.sqrt(squares[kept].sum() / of_truth[kept].sum())
    return f"{percent(trimmed)} / {percent(np.sqrt(squares.sum() / of_truth.sum()))}"


def row(case: Case, unknowns: int, *, quick: bool) -> list[str]:
    """What is found of one picture."""
    found = case.solved(unknowns)
    pixels = case.picture[..., :3].reshape(-1, 3)
    held_out = held_out_pixels(case)
    fit = errors(found.pictures[0].reshape(-1, 3)[held_out], pixels[held_out])
    scene = case.scene
    camera = dataclasses.replace(scene.camera, origin=OTHER_EYE)
    other = prepared(dataclasses.replace(scene, camera=camera), case.resolution)
    view = other.view()
    relit = np.asarray(other.shade(other.light(found.environment), view).radiance)
    truth = by_mitsuba(case.file, camera) if has_mitsuba() and not quick else None
    what = "Mitsuba"
    if truth is None:
        truth = np.asarray(other.shade(other.light(scene.lights), view).radiance)
        what = "own transport"
    shown = np.asarray(view.surfaces.covered)
    alone = on_object(other, view)
    return [
        SCENES[case.name],
        fit,
        f"{errors(relit[shown], truth[..., :3][shown])} ({what})",
        errors(relit[alone], truth[..., :3][alone]),
        f"{min(found.certainty.told)} of {found.certainty.grid.size}",
        str(found.applications),
        f"{found.seconds:.1f}",
        f"{case.seconds:.0f} s",
    ]


def on_object(relighter, view) -> np.ndarray:
    """The pixels that show no floor."""
    alone = np.zeros(view.surfaces.covered.size + 1, bool)
    for part in view.surfaces.parts:
        if relighter.materials[part.material].name != "floor":
            alone[np.asarray(part.pixels.pixel)] = True
    return alone[:-1].reshape(view.surfaces.shape)


def held_out_pixels(case: Case) -> np.ndarray:
    """Those that `environment` holds out by default."""
    from jaxrelight.inverse.observations import observe

    pictures, alphas = [case.picture[..., :3]], [np.where(case.mask, 1.0, 0.0)]
    return np.asarray(observe(pictures, alphas, [case.mask], None, None, 0.1, 0).held_out[0].pixels)


def against_adam(report: Report, case: Case, unknowns: int, *, quick: bool):
    """Applications until Adam, on the same operator, misses the pixels by no more than least squares does."""
    task = light_task(
        case.relighter,
        [case.picture[..., :3]],
        None,
        unknowns=unknowns,
        lamps=None,
        exposures="known",
        masks=[case.mask],
        deviations=None,
        saturation=None,
        hold_out=0.1,
        seed=0,
    )
    solver = LightSolver(task, None, 200)
    solution = solver.solve(None, "natural", not_negative=False)
    problem, fitted, b = task.problem, task.fitted, solver.b
    target = float(np.linalg.norm((solver.product(solution.unknowns) - b)[fitted]) / np.linalg.norm(b[fitted]))
    applications = solver.applications - 1
    # Texels are what is usually descended in; applications take wavelets in units of their deviations.
    spread = problem.deviations[:, None]
    grid, mask, b = problem.grid, jnp.asarray(fitted), jnp.asarray(b)
    size = float(jnp.sqrt(jnp.sum(jnp.where(mask, b, 0) ** 2)))

    def to_unknowns(texels):
        return grid.basis.encode(texels.T).T / spread

    def missed(texels):
        return jnp.where(mask, applied(problem, to_unknowns(texels)) - b, 0)

    best = {}
    count = applications * (2 if quick else MORE)
    for step_size in STEP_SIZES[:: 4 if quick else 1]:
        texels = first = second = jnp.zeros((grid.size, 3))
        reached, least = None, np.inf
        for step in range(1, count + 1):
            difference = missed(texels)
            least = min(least, float(jnp.linalg.norm(difference)) / size)
            if least <= target:
                reached = step
                break
            # The gradient by texels: through the transpose of what takes texels to unknowns.
            gradient = grid.texels(adjoint(problem, difference) / spread)
            first, second = 0.9 * first + 0.1 * gradient, 0.999 * second + 0.001 * gradient**2
            update = (first / (1 - 0.9**step)) / (jnp.sqrt(second / (1 - 0.999**step)) + 1e-12)
            texels = texels - step_size * update
        best[step_size] = reached, least
    rows = [
        [f"{size:g}", "–" if reached is None else str(reached), percent(least)]
        for size, (reached, least) in best.items()
    ]
    steps = [reached for reached, _ in best.values() if reached is not None]
    at_least = f"more than {count // applications}"
    ratio = f"{min(steps) / applications:.0f}" if steps else at_least
    report.text(
        f"Least squares ends at a residual of {percent(target)} on the pixels that are fitted, after "
        f"{applications} applications of the map and as many of its adjoint. Adam on the same map, in texels, "
        f"from black, takes {ratio} times as many at the best of these step sizes, stopped after {count:,}:"
    )
    report.table(["Adam's step size", "applications to that residual", "least residual"], rows)


def has_mitsuba() -> bool:
    """Whether Mitsuba is installed."""
    return importlib.util.find_spec("mitsuba") is not None


def scene_text(file: pathlib.Path, camera: jr.Camera) -> str:
    """A reference scene with another eye, its paths absolute."""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if line.startswith("origin"):
            line = f"origin = {list(camera.origin)}"
        lines.append(line.replace('"../', f'"{file.parent.parent}/'))
    return "\n".join(lines)


def by_mitsuba(file: pathlib.Path, camera: jr.Camera, samples: int = 1024) -> np.ndarray | None:
    """Mitsuba's picture from another eye; None where it cannot render."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "scene.toml").write_text(scene_text(file, camera), encoding="utf-8")
        program = shared("reference", "render_reference.py")
        command = [sys.executable, str(program), str(folder / "scene.toml"), str(folder / "out.exr"), "--spp"]
        done = subprocess.run([*command, str(samples)], capture_output=True, text=True, check=False)
        return jr.read_image(folder / "out.exr") if done.returncode == 0 else None


def against_mitsuba(report: Report, case: Case, minutes: float):
    """Gradient descent through Mitsuba on the same picture, 16 × 32 unknown pixels, beside least squares."""
    found = case.solved((16, 32))
    shown = case.mask
    ours = errors(found.pictures[0][shown], case.picture[shown][:, :3])
    module = "tests.benchmarks.inverse_light"
    command = [sys.executable, "-m", module, "--descend", case.name, "--minutes", str(minutes)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        report.text(f"Mitsuba's gradients could not be had: {done.stderr.strip().splitlines()[-1]}")
        return
    rows = [["least squares (precomputation not counted)", f"{found.seconds:.1f}", ours]]
    for line in done.stdout.splitlines():
        rate, seconds, error = line.split("\t")
        rows.append([f"Mitsuba, Adam, step size {rate}", seconds, error])
    report.text(
        "The same picture, 16 × 32 unknown pixels of a lat-long map: least squares, and Adam on Mitsuba 3's gradients "
        f"(its direct integrator, 16 samples a pixel in each step, {minutes:g} minutes for each step size), the best "
        "it came to, judged by 256 samples a pixel:"
    )
    report.table(["solver", "seconds", "residual"], rows)


def descend(name: pathlib.Path, minutes: float):
    """Adam through Mitsuba's gradients: a line for the best of each step size, with seconds and residual."""
    import drjit as dr  # pyright: ignore[reportMissingImports]
    import mitsuba as mi  # pyright: ignore[reportMissingImports]

    program, file = shared("reference", "render_reference.py"), shared("reference", f"{name}.toml")
    reference = _definitions(program)
    render: Any = mi.render
    picture = jr.read_image(shared("reference", f"{name}_b0.exr"))
    shown = picture[..., 3] > 0.999
    truth = mi.TensorXf(picture[..., :3])
    mask = mi.TensorXf(np.repeat(shown[..., None], 3, axis=2).astype(np.float32))
    scene = reference["build"](file, 2)
    integrator = mi.load_dict({"type": "direct", "hide_emitters": False})
    parameters: Any = mi.traverse(scene)
    key = next(one for one, _ in parameters if one.endswith("env.data") or one.endswith(".data"))
    scale = next((one for one, _ in parameters if one.endswith("env.scale")), None)
    mean = float(picture[shown][:, :3].mean())
    for rate in (0.02, 0.1):
        start = np.full((16, 33, 3), mean / (float(np.ravel(parameters[scale])[0]) if scale else 1.0), np.float32)
        parameters[key] = mi.TensorXf(start)
        parameters.update()
        optimiser = mi.ad.Adam(lr=rate * float(start.mean()) * 10)
        optimiser[key] = parameters[key]
        parameters.update(optimiser)
        begun, best, at, step = time.perf_counter(), np.inf, 0.0, 0
        next_look = 5.0
        while time.perf_counter() - begun < 60 * minutes:
            image = render(scene, parameters, integrator=integrator, spp=16, seed=step)
            loss = dr.sum(dr.square((image[..., :3] - truth) * mask))
            dr.backward(loss)
            optimiser.step()
            optimiser[key] = dr.maximum(optimiser[key], 0)
            parameters.update(optimiser)
            step += 1
            if time.perf_counter() - begun > next_look:
                looked = time.perf_counter() - begun
                judged = np.asarray(render(scene, integrator=integrator, spp=256, seed=10**6))[..., :3]
                error = np.linalg.norm((judged - picture[..., :3])[shown]) / np.linalg.norm(picture[shown][:, :3])
                if error < best:
                    best, at, line = error, looked, errors(judged[shown], picture[shown][:, :3])
                # Looking is not counted.
                begun += time.perf_counter() - begun - looked
                next_look = looked * 1.3
        print(f"{rate:g}\t{at:.0f}\t{line}", flush=True)


def _definitions(program: pathlib.Path) -> dict:
    """What a program defines, without its last call."""
    source = program.read_text(encoding="utf-8").rsplit("\nmain()", 1)[0]
    names: dict = {"__name__": "reference"}
    exec(compile(source, str(program), "exec"), names)
    return names


if __name__ == "__main__":
    main()
