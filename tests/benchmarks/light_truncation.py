"""Few coefficients of the light: the error, and the flicker while the light turns (Wang 2006 §4.3, §5.2.2; Ng 2003)."""

import argparse
import contextlib
import pathlib
import tempfile

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared

SCENE = "bunny_lambert"
GROUPS, STEPS, SEED = 8, 60, 0
SHARES = 1.0, 0.1, 0.01


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.light_truncation", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 8 and few steps; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the store here and reuse it")
    parser.add_argument("--plots", type=pathlib.Path, help="write the radiance of one receiver over the turn here")
    arguments = parser.parse_args()
    shared("reference")
    resolution, steps = (8, 12) if arguments.quick else (64, STEPS)
    parameters = (
        f"{SCENE}, {GROUPS} groups of 128 vertices drawn with seed {SEED}, resolution {resolution}, N = 128; {steps} "
        "steps of 1°; the light's coefficients of largest energy over the channels are kept, anew in every step"
    )
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        report = stack.enter_context(
            Report("light_truncation", "Few coefficients of the light", parameters, not arguments.quick)
        )
        measure(report, folder, resolution, steps, arguments.plots)


def measure(report: Report, folder: pathlib.Path, resolution: int, steps: int, plots: pathlib.Path | None):
    """Frames of every light with every share of its coefficients, with exact and with truncated rows."""
    import jax.numpy as jnp

    from jaxrelight import Transport, load_environment, load_scene, prepare
    from jaxrelight.lighting.transport import TransportRelighter
    from jaxrelight.lights.environment import coarsened

    scene = load_scene(shared("reference", f"{SCENE}.toml"))
    relighter = prepare(
        scene, Transport("vertices", reflection="factors", resolution=resolution, coefficients=128), folder / SCENE
    )
    assert isinstance(relighter, TransportRelighter)
    exact, kept = rows(relighter.transport)
    lights = {
        "sunset": load_environment(shared("data", "env", "blender_sunset.exr")),
        "Grace": load_environment(shared("data", "env", "grace_latlong.exr"), scale=10),
        "city": load_environment(shared("data", "env", "blender_city.exr")),
    }
    report.text(
        "Radiance y of receivers over the frames of a turn. **Error** is ‖y − exact‖/‖exact‖. **Change** is the RMS of "
        "y's difference between neighbouring frames, over the RMS of y: what a still pixel shows of the turning light. "
        "**Flicker** is the same of y − exact: the part of the change that is not there."
    )
    table = []
    for name, light in lights.items():
        pixels = jnp.asarray(coarsened(light.pixels, resolution))
        vectors = [np.asarray(relighter.light_vector(pixels, float(step), light.scale)) for step in range(steps + 1)]
        truth = np.stack([exact @ vector for vector in vectors])
        table.append([name, "exact", "", *_figures(truth, truth)])
        curves = {"exact": truth}
        for share in SHARES:
            few = [largest(vector, share) for vector in vectors]
            held = float(np.mean([np.sum(f**2) / np.sum(v**2) for f, v in zip(few, vectors, strict=True)]))
            for which, matrix in (("all of a row", exact), ("128 of a row", kept)):
                frames = np.stack([matrix @ vector for vector in few])
                table.append([name, f"{share:.0%} of the light, {which}", percent(held), *_figures(frames, truth)])
                curves[f"{share:.0%}, {which}"] = frames
        if plots:
            plot(plots / f"turning-{name}.png", name, curves)
    report.table(["light", "coefficients", "light's energy", "error", "change", "flicker"], table)


def rows(transport) -> tuple[np.ndarray, np.ndarray]:
    """Dense rows [r, d] of some receivers: with all coefficients, and with those that are kept. Grey transport."""
    from jaxrelight.transport import bake
    from jaxrelight.transport.model import frames_of

    directions = bake.directions_for(transport.method.resolution)
    generator = np.random.default_rng(SEED)
    whole, kept = [], []
    for block, operator in zip(transport.blocks, transport.operator.operators, strict=True):
        per_group = 128 * block.reflection.terms
        for i in generator.choice(len(block.groups), GROUPS // len(transport.blocks), replace=False):
            group = int(block.groups[i])
            bits = transport.stored.visibility.read("bits", group)
            frames = frames_of(transport.receivers, block.groups[[i]])[0]
            whole.append(bake.bake_rows(bits, frames, block.reflection, directions, transport.basis)[:, 0, 0])
            kept.append(operator.rows(np.arange(i * per_group, (i + 1) * per_group))[:, 0])
    return np.concatenate(whole), np.concatenate(kept)


def largest(vector: np.ndarray, share: float) -> np.ndarray:
    """The light with only its coefficients of largest energy."""
    count = max(1, round(share * len(vector)))
    chosen = np.argsort(-np.sum(vector**2, axis=1), kind="stable")[:count]
    out = np.zeros_like(vector)
    out[chosen] = vector[chosen]
    return out


def _figures(frames: np.ndarray, truth: np.ndarray) -> list[str]:
    def rms(x):
        return float(np.sqrt(np.mean(np.asarray(x, float) ** 2)))

    level, wrong = rms(truth), frames - truth
    return [percent(rms(x) / level) for x in (wrong, np.diff(frames, axis=0), np.diff(wrong, axis=0))]


def plot(path: pathlib.Path, name: str, curves):
    """Green radiance of the receiver whose flicker is the median, over the angle."""
    from matplotlib import pyplot as plt  # pyright: ignore[reportMissingImports]

    truth, worst = curves["exact"], curves[f"{SHARES[-1]:.0%}, all of a row"]
    flicker = np.diff(worst - truth, axis=0)[..., 1].std(axis=0)
    receiver = int(np.argsort(flicker)[len(flicker) // 2])
    figure, axes = plt.subplots(figsize=(8, 4))
    for label, frames in curves.items():
        axes.plot(frames[:, receiver, 1], label=label, color="black" if label == "exact" else None, lw=1)
    axes.set(xlabel="rotation of the light / degrees", ylabel="radiance", title=f"One receiver under {name}")
    axes.legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)


if __name__ == "__main__":
    main()
