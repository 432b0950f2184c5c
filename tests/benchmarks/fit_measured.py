"""Lafortune fits of measured materials: the error over samples held out, against the number of lobes."""

import argparse
import time

from tests.benchmarks.measuring import Report, percent, shared

LOBES = 1, 2, 3
# By name: whether channels share C and exponents.
KINDS = {"shared": {}, "by channel": {"per_channel": True}}


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.fit_measured", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one file; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    files = sorted(file for file in shared("data", "brdf").iterdir() if file.suffix in (".bsdf", ".brdf"))
    parameters = (
        "a tenth of the samples held out; root mean square of fit − data over that of the data, weighted as the fit is "
        "(cosine, compressed logarithmically), over the samples held out / over all"
    )
    with Report("fit_measured", "Lafortune fits of measured materials", parameters, not quick) as report:
        rows = [measure(file, kind) for file in files[: 1 if quick else None] for kind in KINDS]
        counts = [f"{n} lobe{'s' if n > 1 else ''}" for n in LOBES]
        report.table(["material, C and exponent", *counts, "exponents of the last", "verdict", "seconds"], rows)


def measure(file, kind: str) -> list:
    """A row of the table."""
    from fitting import Options, fit_lafortune
    from jaxrelight.brdf.files import load_brdf

    brdf = load_brdf(file).brdf
    start = time.perf_counter()
    fits = [fit_lafortune(brdf, Options(lobes=n, **KINDS[kind])) for n in LOBES]
    seconds = time.perf_counter() - start
    errors = [f"{percent(fit.held_out)} / {percent(fit.residual)}" for fit in fits]
    exponents = ", ".join(f"{n:.3g}" for n in fits[-1].brdf.exponent.mean(axis=-1))
    return [f"{file.stem}, {kind}", *errors, exponents, fits[-1].verdict.name.lower(), f"{seconds:.0f}"]


if __name__ == "__main__":
    main()
