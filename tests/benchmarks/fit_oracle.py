"""Best residuals that scipy finds from several starts, kept in fit_oracle.npz for the programs that compare with them.

Minutes of computing; run again only when the samples or the weights change.
"""

import argparse
import concurrent.futures
import itertools
import pathlib

import numpy as np

from fitting.brdf_samples import Grid
from fitting.weights import weights
from tests.benchmarks.measuring import shared
from tests.fitting.merl_surrogate import Surrogates
from tests.fitting.synthetic import scipy_fit, texels

PATH = pathlib.Path(__file__).with_suffix(".npz")
TEXELS = 4096
WEIGHT = "cosine"
MIRROR = 3 * np.pi / 4
STARTS = [[angle, np.log(n)] for angle, n in itertools.product((MIRROR, 0.8 * MIRROR), (3, 30, 300))]


def oracle(name: str) -> np.ndarray:
    """Least weighted sums of squares, relative to that of the samples."""
    with np.load(PATH) as kept:
        return kept[name]


def _of_texel(index: int) -> float:
    data = texels(TEXELS)
    omega_i, omega_o, values = data.omega_i[index], data.omega_o[index], data.values[index]
    true = [np.arctan2(data.C[index, 2], data.C[index, 0]) % (2 * np.pi), np.log(data.exponent[index])]
    # The truth is a start, too: nothing that a fit could find is overlooked near it.
    return scipy_fit(omega_i, omega_o, values, np.ones(len(values)), [true, *STARTS[::2]]) / np.sum(values**2)


def _of_surrogate(index: int) -> float:
    samples = Surrogates(shared("data", "brdf", "merl_nbrdf.npz")).samples(index, Grid())
    weight = weights(WEIGHT, samples)
    size = np.sum(weight[:, None] * samples.values**2)
    return scipy_fit(samples.omega_i, samples.omega_o, samples.values, np.sqrt(weight), STARTS) / size


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.fit_oracle", description=__doc__)
    parser.add_argument("what", nargs="*", default=["texels", "surrogates"], help="texels, surrogates, or both")
    kept = dict(np.load(PATH)) if PATH.exists() else {}
    jobs = {"texels": (_of_texel, TEXELS), "surrogates": (_of_surrogate, 100)}
    with concurrent.futures.ProcessPoolExecutor() as pool:
        for what in parser.parse_args().what:
            function, count = jobs[what]
            kept[what] = np.array(list(pool.map(function, range(count), chunksize=max(1, count // 64))))
            np.savez_compressed(PATH, **kept)
            print(f"{what}: {count}, median relative residual {np.sqrt(np.median(kept[what])):.4f}", flush=True)


if __name__ == "__main__":
    main()
