"""The whole campaign over files and broken meshes; prints counts, and ends with 1 if anything went wrong."""

import argparse
import sys
import tempfile
from pathlib import Path

import pytest

from tests.faults import campaign
from tests.faults.sources import formats
from tests.geometry.test_mesh import BROKEN, REFUSED, test_broken_files_end_as_documented


def main() -> int:
    """Parses the command line, runs, prints."""
    parser = argparse.ArgumentParser("python -m tests.faults", description=__doc__)
    parser.add_argument("--cuts", type=int, default=20, help="places at which every file is cut")
    parser.add_argument("--mutations", type=int, default=200, help="mutated files of each format")
    parser.add_argument("--seed", type=int, default=0, help="another one mutates otherwise")
    asked = parser.parse_args()

    files = [
        case
        for suffix, kind in formats().items()
        for case in campaign.cases(suffix, kind, asked.cuts, asked.mutations, asked.seed)
    ]
    with tempfile.TemporaryDirectory() as folder:
        verdicts = campaign.run(files, Path(folder))
    wrong = [f"{v.case.suffix} {v.case.name}: {v.end}; {v.wrong}" for v in verdicts if v.wrong]
    print(f"files, each loaded within {campaign.SECONDS} s and {campaign.MEBIBYTES} MiB\n{campaign.table(verdicts)}")
    print(f"{len(verdicts):,} files, {len(wrong)} that did not end as promised\n\nbroken meshes")
    broken = broken_meshes()
    print("\n".join(f"{name}: {line}" for name, line in [*broken, *(("WRONG", line) for line in wrong)]))
    missed = sum(line.startswith("NOT") for _, line in broken)
    print(f"{len(broken)} broken meshes, {missed} that did not end as promised")
    return 1 if wrong or missed else 0


def broken_meshes() -> list[tuple[str, str]]:
    """Each broken mesh and how it ends: as promised, or not."""
    lines = []
    for name, (ending, details) in sorted(BROKEN.items()):
        promised = f"refused: {details}" if ending == REFUSED else "; ".join([f"{ending:,} faces", *details])
        try:
            test_broken_files_end_as_documented(name)
        except pytest.skip.Exception as reason:
            return [("skipped", str(reason))]
        except (AssertionError, pytest.fail.Exception) as fault:
            promised = f"NOT {promised} ({str(fault).splitlines()[0]})"
        lines.append((name, promised))
    return lines


if __name__ == "__main__":
    sys.exit(main())
