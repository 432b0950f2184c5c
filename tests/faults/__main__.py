"""The whole campaign over files, meshes, scenes, stores and disks; prints counts, ends with 1 if any went wrong."""

import argparse
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults import campaign, full_disks, scenes, stores
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
    # As in tests: no compiled program is read or written, and a warning is a fault.
    os.environ["JAXRELIGHT_COMPILATION_CACHE"] = "off"
    warnings.simplefilter("error")
    for part in (_scenes, _stores, _full_disks):
        with tempfile.TemporaryDirectory() as folder:
            ends = list(part(Path(folder)))
        failed = [f"WRONG: {name}: {fault}" for name, fault in ends if fault]
        print("\n".join(["", *failed, f"{len(ends)} {part.__doc__}, {len(failed)} that did not end as promised"]))
        missed += len(failed)
    return 1 if wrong or missed else 0


def _scenes(folder: Path) -> Iterator[tuple[str, str]]:
    """broken scenes and wrong commands"""
    scenes.prepare(folder)
    yield "the sound scene", scenes.wrong_with_sound(folder)
    (folder / "out.exr").unlink()
    shutil.rmtree(folder / "made")
    yield from ((name, scenes.wrong_with(fault, folder)) for name, fault in scenes.FAULTS.items())
    yield from ((line, scenes.wrong_with_command(line, folder)) for line in scenes.WRONG)


def _stores(folder: Path) -> Iterator[tuple[str, str]]:
    """damaged stores"""
    for name, options, files in (
        ("kept", (), stores.FILES),
        ("exact", stores.EXACT, stores.EXACT_FILES),
        ("bounced", stores.BOUNCED, stores.BOUNCED_FILES),
        ("indirect", stores.INDIRECT, stores.INDIRECT_FILES),
    ):
        (folder / name).mkdir()
        sound = stores.prepare(folder / name, *options)
        damages = [damage for file in files for damage in stores.damages_to(file, sound)]
        for damage in (*damages, *(() if options else stores.WHOLE)):
            yield f"{name}: {damage.name}", stores.wrong_with(damage, sound)


def _full_disks(folder: Path) -> Iterator[tuple[str, str]]:
    """full disks"""
    if full_disks.hindrance():
        print(f"\nskipped: {full_disks.hindrance()}")
        return
    sound = stores.prepare(folder)
    yield from ((f"{share:.0%} of a store", full_disks.wrong_with_store(share, sound)) for share in full_disks.SHARES)
    yield from ((name, full_disks.wrong_with_picture(name, sound)) for name in full_disks.PICTURES)


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
