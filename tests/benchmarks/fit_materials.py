"""Lafortune fits of whole materials: against scipy on surrogates of MERL, and of published fits with noise."""

import argparse
import json
import time

import jax
import jax.numpy as jnp
import numpy as np

from fitting.brdf_samples import BrdfSamples, Grid, sample
from fitting.lafortune import fit_lafortune
from fitting.solve import Options, Verdict, fit_lobes
from fitting.weights import weights
from jaxrelight.brdf.lobes import lobe, lobe_sum
from tests.benchmarks.fit_oracle import WEIGHT, oracle
from tests.benchmarks.measuring import Report, percent, shared
from tests.fitting.merl_surrogate import Surrogates

PUBLISHED = "clay", "skin", "felt", "primer", "bluepaint", "brushedmetal"
NOISE, SEED = 0.01, 0


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.fit_materials", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="ten surrogates; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    grid = Grid()
    parameters = f"{len(grid.directions()[0])} pairs of directions, one table for all"
    with Report("fit_materials", "Lafortune fits of materials", parameters, write=not quick) as report:
        _published(report)
        _surrogates(report, grid, 10 if quick else 100)


def _published(report: Report):
    report.text(f"Published three-lobe fits, sampled, {percent(NOISE)} noise on every value, fitted anew by channel.")
    materials = json.loads(shared("data", "published", "lafortune_published.json").read_text())["materials"]
    rows = []
    for name in PUBLISHED:
        lobes = [
            lobe(np.stack([one["Cxy"], one["Cxy"], one["Cz"]], axis=-1), one["n"], specular=1)
            for one in materials[name]["lobes"]
        ]
        exact = sample(lobe_sum(materials[name]["diffuse"], lobes))
        noise = NOISE * exact.values * np.random.default_rng(SEED).normal(size=exact.values.shape)
        noisy = BrdfSamples(exact.omega_i, exact.omega_o, exact.values + noise)
        level = float(np.linalg.norm(noise) / np.linalg.norm(noisy.values))
        fits = [fit_lafortune(noisy, Options(lobes=n, per_channel=True), "plain") for n in (1, 2, 3)]
        residuals = [percent(fit.residual) for fit in fits]
        rows.append([name, percent(level), *residuals, percent(fits[2].held_out), fits[2].verdict.name])
    report.table(["material", "noise", "1 lobe", "2 lobes", "3 lobes", "3, held out", "verdict"], rows)


def _surrogates(report: Report, grid: Grid, count: int):
    report.text(
        "Neural surrogates of the MERL materials (not measurements), one lobe shared by channels, weight "
        f"`{WEIGHT}`: relative residual of this fit, the best of six starts of scipy's `least_squares`, and the "
        "parameters that Ngan et al. published in 2005, their channels rescaled by 1, 1.15 and 1.66."
    )
    surrogates = Surrogates(shared("data", "brdf", "merl_nbrdf.npz"))
    ngan = json.loads(shared("data", "published", "ngan2005_lafortune.json").read_text())["materials"]
    every = [surrogates.samples(index, grid) for index in range(count)]
    weight = np.stack([weights(WEIGHT, samples) for samples in every])
    values = jnp.asarray(np.stack([samples.values for samples in every]), jnp.float32)
    start = time.perf_counter()
    fits = jax.block_until_ready(fit_lobes(every[0].omega_i, every[0].omega_o, values, weight))
    seconds = time.perf_counter() - start
    residuals, best = np.asarray(fits.residual, float), np.sqrt(oracle("surrogates")[:count])
    ratios = (residuals / best) ** 2
    rows = [
        [
            surrogates.names[index],
            percent(residuals[index]),
            percent(best[index]),
            f"{ratios[index]:.4f}",
            _published_residual(ngan.get(surrogates.names[index]), every[index]),
            Verdict(int(fits.verdict[index])).name,
        ]
        for index in range(count)
    ]
    report.text(
        f"Loss at most 1.01 times scipy's: {percent(float(np.mean(ratios <= 1.01)))} of {count} (target 98 %); largest "
        f"ratio {ratios.max():.4f}, median {np.median(ratios):.4f}. All in {seconds:.1f} s, compiling included."
    )
    heads = ["surrogate", "fit", "scipy", "loss ratio", "Ngan 2005", "verdict"]
    report.table(heads, rows)


def _published_residual(fit: dict | None, samples: BrdfSamples) -> str:
    if fit is None:
        return ""
    n, longest = fit["exponent"], max(abs(fit["Cxy"]), abs(fit["Cz"]))
    x, y, z = (samples.omega_i * samples.omega_o).T
    dot = np.maximum(fit["Cxy"] * (x + y) + fit["Cz"] * z, 0) / longest
    values = np.array(fit["diffuse_albedo"]) / np.pi + np.outer(dot**n, fit["lobe_albedo"]) * (n + 2) / (2 * np.pi)
    values *= [1, 1.15, 1.66]
    weight = weights(WEIGHT, samples)[:, None]
    error = np.sum(weight * (values - samples.values) ** 2) / np.sum(weight * samples.values**2)
    return percent(np.sqrt(error))


if __name__ == "__main__":
    main()
