"""How far factors are from their BRDF, by terms and map resolution (Wang 2006 Figure 5), and which form is best."""

import argparse
import functools
import json
import pathlib
import time

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared

TERMS = tuple(range(1, 17))
SHOWN = 1, 2, 4, 8, 16
SPHERES = 1, 2, 4, 8
# A map is fine enough where finer ones change the error by no more than this share of it.
SETTLED = 0.02
# The paper's map.
SIDE = 48


def main():
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.factor_error",
        description=__doc__,
        epilog="RESULTS.md is written only without options other than --pictures.",
    )
    parser.add_argument("--quick", action="store_true", help="few pairs of directions, small maps")
    parser.add_argument("--pairs", type=int, default=100_000, help="pairs of directions")
    parser.add_argument("--seed", type=int, default=0, help="of the directions")
    parser.add_argument("--resolutions", type=int, nargs="+", default=[16, 24, 32, 48, 64, 96, 128])
    parser.add_argument("--pictures", type=pathlib.Path, help="folder for plots and spheres; needs matplotlib")
    arguments = parser.parse_args()
    materials = brdfs(shared("data", "published", "lafortune_published.json"))
    defaults = vars(parser.parse_args([]))
    write = all(value == defaults[name] for name, value in vars(arguments).items() if name != "pictures")
    if arguments.quick:
        arguments.pairs, arguments.resolutions = 2_000, [8, 12, 16]
    pairs = Pairs(arguments.pairs, arguments.seed)
    parameters = (
        f"{arguments.pairs:,} pairs of directions, each uniform over the hemisphere, seed {arguments.seed}; root of "
        "the mean of cosθ_i · (f̂ − f)², over that of cosθ_i · f², as in Figure 5; behind the stroke with "
        "cos²θ_i cosθ_o instead: the error of pictures of a sphere without shadow under single distant lights"
    )
    with Report("factor_error", "Factors against their BRDFs", parameters, write) as report:
        errors = {
            name: by_resolution(report, name, brdf, pairs, arguments.resolutions) for name, brdf in materials.items()
        }
        conclude(report, errors, arguments.resolutions)
        side = max(side for side in arguments.resolutions if side <= SIDE)
        by_form(report, materials, pairs, side)
        if arguments.pictures:
            arguments.pictures.mkdir(parents=True, exist_ok=True)
            plot(errors, arguments.resolutions, arguments.pictures / "errors.png")
            maps(materials, side, arguments.pictures / "light_maps.png")
            spheres(materials, side, arguments.pictures / "spheres.png")


def published(name: str, path: pathlib.Path):
    """A material of the published Lafortune fits, whose lobes differ by channel."""
    from jaxrelight import lobe, lobe_sum

    material = json.loads(path.read_text())["materials"][name]
    made = [
        lobe(np.stack([one["Cxy"], one["Cxy"], one["Cz"]], axis=-1), one["n"], specular=1) for one in material["lobes"]
    ]
    return lobe_sum(material["diffuse"], made)


def brdfs(path: pathlib.Path) -> dict:
    """The four BRDFs of §5."""
    from jaxrelight import ashikhmin_shirley, phong

    return {
        "Ashikhmin–Shirley": ashikhmin_shirley(0.5, 0.75, 10, 100),
        "clay": published("clay", path),
        "dark skin": published("skin", path),
        "Phong 50": phong([0.4, 0.1, 0.1], 0.4, 50),
    }


class Pairs:
    """Random pairs of directions, and the errors between two functions of them."""

    def __init__(self, count: int, seed: int):
        rng = np.random.default_rng(seed)
        cosine, azimuth = rng.random((2, count)), 2 * np.pi * rng.random((2, count))
        sine = np.sqrt(1 - cosine**2)
        omega = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1).astype(np.float32)
        self.omega_i, self.omega_o = omega
        self.figure = omega[0, :, 2]
        self.picture = omega[0, :, 2] ** 2 * omega[1, :, 2]
        self.weights = self.figure, self.picture

    def exact(self, brdf) -> np.ndarray:
        """Values [p, c]."""
        return np.asarray(_evaluate(brdf, self.omega_i, self.omega_o), float)

    def first_terms(self, factors) -> np.ndarray:
        """Σ of the first k products, for every k: [k, p, c]. Singular vectors come in order."""
        light, view = _sides(factors, self.omega_i, self.omega_o)
        return np.cumsum(np.moveaxis(np.asarray(light, float) * np.asarray(view, float), 1, 0), axis=0)

    @staticmethod
    def error(values: np.ndarray, exact: np.ndarray, weight: np.ndarray) -> float:
        """Relative RMS over pairs and channels; `values` may lead with an axis of its own."""
        square = weight[:, None] * np.stack([(values - exact) ** 2, exact**2])
        return float(np.sqrt(square[0].sum() / square[1].sum()))

    def interpolated(self, brdf, side: int) -> np.ndarray:
        """All terms there are: the sampled BRDF, interpolated on both sides between four texels [p, c]."""
        from jaxrelight.brdf.parametrisation import DISC

        texels = DISC.directions(side)[0].astype(np.float32)
        (at_i, weights_i), (at_o, weights_o) = (_corners(omega, side) for omega in (self.omega_i, self.omega_o))
        total = np.zeros(())
        for a in range(4):
            for b in range(4):
                weight = np.asarray(weights_i[:, a] * weights_o[:, b], float)
                total = total + weight[:, None] * np.asarray(_evaluate(brdf, texels[at_i[:, a]], texels[at_o[:, b]]))
        return total


@functools.cache
def _jitted():
    import equinox as eqx
    import jax

    from jaxrelight.brdf.parametrisation import DISC

    def evaluate(brdf, omega_i, omega_o):
        return jax.vmap(brdf.evaluate)(omega_i, omega_o)

    def sides(factors, omega_i, omega_o):
        return jax.vmap(factors.light_side)(omega_i), jax.vmap(factors.view_side)(omega_o)

    def corners(omega, side):
        return jax.vmap(lambda one: DISC.corners(one, side))(omega)

    return eqx.filter_jit(evaluate), eqx.filter_jit(sides), eqx.filter_jit(corners)


def _evaluate(*arguments):
    return _jitted()[0](*arguments)


def _sides(*arguments):
    return _jitted()[1](*arguments)


def _corners(*arguments):
    texels, weights = _jitted()[2](*arguments)
    return np.asarray(texels), np.asarray(weights)


def by_resolution(report: Report, name: str, brdf, pairs: Pairs, sides: list[int]) -> np.ndarray:
    """Errors [weight, side, K, …, all terms] of the paper's form, as a table."""
    from jaxrelight import factor

    exact = pairs.exact(brdf)
    errors, rows = [], []
    for side in sides:
        start = time.perf_counter()
        factors = factor(brdf, max(TERMS), side, cosine=(0.0, 0.0))
        seconds = time.perf_counter() - start
        approximations = [*pairs.first_terms(factors), pairs.interpolated(brdf, side)]
        errors.append([[pairs.error(one, exact, weight) for one in approximations] for weight in pairs.weights])
        cells = [_both(errors[-1][0][k], errors[-1][1][k]) for k in (*(k - 1 for k in SHOWN), -1)]
        rows.append([f"{side}²", *cells, f"{seconds:.1f} s"])
    square = np.sort(pairs.figure * np.sum(exact**2, axis=-1))
    largest = square[-len(square) // 1000 :].sum() / square.sum()
    report.text(
        f"**{name}**, disc, singular values, the cosine left out. A thousandth of the pairs carries "
        f"{percent(largest)} of the mean of cosθ_i · f²."
    )
    report.table(["map", *(f"K = {k}" for k in SHOWN), "all terms", "factored in"], rows)
    return np.moveaxis(np.array(errors), 1, 0)


def conclude(report: Report, errors: dict[str, np.ndarray], sides: list[int]):
    """Where the error settles."""
    rows = []
    columns = {"K = 4": 3, "K = 16": 15, "all terms": -1}
    at = sides.index(SIDE) if SIDE in sides else -1
    for name, both in errors.items():
        settled = {}
        for column in columns.values():
            for i, table in enumerate(both):
                change = table[:, column] / table[-1, column] - 1
                # The first side from which on all are within the share; the finest is so by definition.
                late = np.flatnonzero(np.abs(change) > SETTLED)
                settled[column, i] = f"{sides[late[-1] + 1 if len(late) else 0]}²", percent(change[at])
        first, second = (
            [f"{settled[column, 0][i]} / {settled[column, 1][i]}" for column in columns.values()] for i in (0, 1)
        )
        rows.append([name, *first, *second])
    report.text(
        f"**Where the error settles**: the map from which on it stays within {100 * SETTLED:.0f} % of itself at "
        f"{sides[-1]}², and by how much of itself it is larger at {sides[at]}²."
    )
    report.table(["BRDF", *columns, *(f"{sides[at]}² at {name}" for name in columns)], rows)


def by_form(report: Report, materials: dict, pairs: Pairs, side: int):
    """All forms at equal K."""
    from jaxrelight import factor
    from jaxrelight.brdf.parametrisation import POLAR

    forms = {
        "disc": {"cosine": (0.0, 0.0)},
        "disc, symmetric": {"form": "symmetric", "cosine": (0.0, 0.0)},
        "disc, cosine folded in (1, 0)": {"cosine": (1.0, 0.0)},
        "disc, cosine (½, ½)": {"cosine": (0.5, 0.5)},
        "disc, cosine (0, ½)": {"cosine": (0.0, 0.5)},
        "disc, cosine (¼, ¼)": {"cosine": (0.25, 0.25)},
        "polar": {"parametrisation": POLAR, "cosine": (0.0, 0.0)},
        "polar, cosine (½, ½)": {"parametrisation": POLAR, "cosine": (0.5, 0.5)},
        "disc, normalised": {"form": "normalised", "cosine": (0.0, 0.0)},
        "polar, normalised": {"form": "normalised", "parametrisation": POLAR, "cosine": (0.0, 0.0)},
    }
    report.text(f"**Forms at {side}².** The same errors.")
    for name, brdf in materials.items():
        exact, rows = pairs.exact(brdf), []
        for form, options in forms.items():
            terms = 1 if options.get("form") == "normalised" else max(TERMS)
            sums = pairs.first_terms(factor(brdf, terms, side, **options))
            cells = [
                " / ".join(percent(pairs.error(sums[k - 1], exact, weight)) for weight in (pairs.figure, pairs.picture))
                if k <= terms
                else "–"
                for k in SHOWN
            ]
            rows.append([form, *cells])
        report.table([name, *(f"K = {k}" for k in SHOWN)], rows)


def _both(figure: float, picture: float) -> str:
    return f"{percent(figure)} / {percent(picture)}"


def _pyplot():
    from matplotlib import pyplot, use  # pyright: ignore[reportMissingImports]

    use("agg")
    return pyplot


def plot(errors: dict[str, np.ndarray], sides: list[int], path: pathlib.Path):
    """The curves of Figure 5, and below them those of pictures."""
    pyplot = _pyplot()
    figure, axes = pyplot.subplots(2, len(errors), figsize=(15, 7))
    weights = "weight cosθ_i", "weight cos²θ_i cosθ_o"
    for (name, both), column in zip(errors.items(), axes.T, strict=True):
        for table, panel, weight in zip(both, column, weights, strict=True):
            for side, row in zip(sides, table, strict=True):
                panel.plot(TERMS, 100 * row[:-1], "o-", markersize=3, label=f"{side}²")
            panel.set(title=f"{name}, {weight}", xlabel="terms K", ylabel="relative error / %", ylim=(0, None))
    axes.flat[0].legend(title="map")
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def maps(materials: dict, side: int, path: pathlib.Path):
    """The first eight light maps in absolute values, as in Figure 5."""
    from jaxrelight import factor

    pyplot = _pyplot()
    figure, axes = pyplot.subplots(len(materials), 8, figsize=(12, 6.4))
    for (name, brdf), row in zip(materials.items(), axes, strict=True):
        texels = np.abs(np.asarray(factor(brdf, 8, side).light_maps))
        for k, panel in enumerate(row):
            # Each map by itself; the brightest texels, at the edge, may be many times brighter than all others.
            panel.imshow(np.clip(np.moveaxis(texels[k], 0, -1) / np.quantile(texels[k], 0.99), 0, 1), origin="lower")
            panel.set(xticks=[], yticks=[], title=f"{name}, k = {k + 1}" if not k else f"{k + 1}")
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def spheres(materials: dict, side: int, path: pathlib.Path, size: int = 160):
    """Spheres under one distant light, with few terms and exact."""
    import jax.numpy as jnp

    from jaxrelight import factor, tone_map
    from jaxrelight.geometry.frame import tangent_frame

    pyplot = _pyplot()
    x, y = np.meshgrid(*[(np.arange(size) + 0.5) * 2 / size - 1] * 2)
    seen = x * x + y * y < 1
    normal = np.stack([x, -y, np.sqrt(np.maximum(0, 1 - x * x - y * y))], axis=-1)[seen].astype(np.float32)
    frame = np.asarray(tangent_frame(jnp.asarray(normal)))
    omega_o = frame @ np.array([0, 0, 1], np.float32)
    omega_i = frame @ (np.array([0.5, 0.6, 0.62], np.float32) / np.float32(0.9975))
    cosine = np.maximum(omega_i[:, 2:], 0)
    figure, axes = pyplot.subplots(len(materials), len(SPHERES) + 1, figsize=(10, 8.2))
    for (name, brdf), row in zip(materials.items(), axes, strict=True):
        light, view = (np.asarray(s) for s in _sides(factor(brdf, max(SPHERES), side), omega_i, omega_o))
        shown = {f"K = {k}": (light * view)[:, :k].sum(axis=1) for k in SPHERES}
        shown[f"{name}, exact"] = np.asarray(_evaluate(brdf, omega_i, omega_o))
        for panel, (title, values) in zip(row, shown.items(), strict=True):
            image = np.ones((size, size, 3), np.float32)
            image[seen] = 2.5 * values * cosine
            panel.imshow(tone_map(image))
            panel.set_title(title, fontsize=9)
            panel.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
