"""Lafortune fits of photographs, texel by texel: how well they predict photographs that were held out."""

import argparse
import dataclasses
import time

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared

# Stacks, and which of their images are held out: every n-th.
STACKS = {"diligent_ball": 8, "uw_owl": 6, "uw_cat": 6}


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.fit_sbrdf", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few texels, one lobe; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    parameters = (
        "all texels of the mask; root mean square of predicted − photographed radiance over that of the photographs, "
        "all usable samples, of images held out; target: one lobe on the ball at most 0.7 × Lambert"
    )
    with Report("fit_sbrdf", "Fits of photographs", parameters, not quick) as report:
        rows = [row for name, every in STACKS.items() for row in measure(name, every, quick)]
        report.table(
            ["stack, images held out", "texels", "normals", "lobes", "Lambert", "lobes'", "ratio", "good", "texels/s"],
            rows,
        )
        report.speed()


def measure(name: str, every: int, quick: bool) -> list[list]:
    """A row for each number of lobes."""
    from fitting import Options
    from fitting.prediction import lambert_only, predicted, relative_error
    from fitting.sbrdf import fit_sbrdf
    from fitting.stack_files import load_stack

    stack = load_stack(shared("data", "photometric", f"{name}.npz"))
    if quick:
        few = np.zeros_like(stack.mask)
        few[::8, ::8] = stack.mask[::8, ::8]
        stack = dataclasses.replace(stack, mask=few)
    held = np.arange(len(stack.images)) % every == every - 1
    seen, unseen = stack.of(~held), stack.of(held)
    rows = []
    for lobes in (1,) if quick else (1, 2):
        start = time.perf_counter()
        fit = fit_sbrdf(seen, Options(lobes=lobes))
        seconds = time.perf_counter() - start
        levels = lambert_only(seen, fit.level.normals), fit.level
        lambert, fitted = (relative_error(predicted(level, unseen), unseen) for level in levels)
        texels = int(stack.mask.sum())
        row = [f"{name}, {held.sum()} of {len(held)}", f"{texels:,}", "estimated" if fit.estimated else "given", lobes]
        shares = [
            percent(lambert),
            percent(fitted),
            f"{fitted / lambert:.2f}",
            percent(fit.counts().get("good", 0) / texels),
        ]
        rows.append([*row, *shares, f"{texels / seconds:,.0f}"])
    return rows


if __name__ == "__main__":
    main()
