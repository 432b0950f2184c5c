"""Makes the faulty files, has them loaded in other processes, and judges what came of them."""

import collections
import json
import random
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.faults.sources import Format

SECONDS, MEBIBYTES = 20, 256  # for one file; the sound ones need milliseconds, and less than 1 MiB
ROOT = Path(__file__).resolve().parents[2]
WORKER = (sys.executable, "-m", "tests.faults.worker", str(SECONDS), str(MEBIBYTES))


@dataclass
class Case:
    """One faulty file.

    Attributes:
        suffix: its format.
        kind: "sound", "cut", "mutated" or "lying".
        name: what was done to which file.
        data: the content.
        source: name of the sound file it was made from.
        at_line_end: whether it was cut where a line ends.
    """

    suffix: str
    kind: str
    name: str
    data: bytes
    source: str = ""
    at_line_end: bool = False


@dataclass
class Verdict:
    """What came of a case: a word for the table, and what is wrong, if anything."""

    case: Case
    end: str
    wrong: str = ""


def cases(suffix: str, kind: Format, cuts: int = 20, mutations: int = 200, seed: int = 0) -> Iterator[Case]:
    """Sound, cut, mutated and lying files of a format; the same ones for the same seed."""
    for name, data in kind.files.items():
        yield Case(suffix, "sound", name, data, name)
        # The last places are where least is missing: an end of line, a digit.
        for length in [*np.linspace(0, len(data) - 1, cuts - 2).astype(int), len(data) - 2, len(data) - 3]:
            line_end = kind.by_lines and data[length - 1 : length] == b"\n"
            yield Case(suffix, "cut", f"{name} cut at {length} of {len(data)}", data[:length], name, line_end)
    names = list(kind.files)
    for number in range(mutations):
        name = names[number % len(names)]
        chance = random.Random(f"{suffix} {seed} {number}")
        yield Case(suffix, "mutated", f"{name}, mutation {number}", mutated(kind.files[name], chance), name)
    for name, data in kind.lies.items():
        yield Case(suffix, "lying", name, data)


def mutated(data: bytes, chance: random.Random) -> bytes:
    """The bytes with one to three faults of the kinds that disks, transfers and programs make."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 3)):
        # Headers are where a change does most.
        at = chance.randrange(min(400, len(changed)) if chance.random() < 0.5 else len(changed))
        length = chance.choice((1, 2, 4, 16, 64))
        block = changed[at : at + length]
        match chance.randrange(9):
            case 0:
                changed[at] ^= 1 << chance.randrange(8)
            case 1:
                changed[at : at + length] = chance.randbytes(len(block))
            case 2:
                changed[at : at + length] = bytes(len(block))
            case 3:
                del changed[at : at + length]
            case 4:
                changed[at:at] = block
            case 5:
                other = chance.randrange(len(changed))
                changed[at : at + length] = changed[other : other + len(block)]
            case 6:
                value = chance.choice((0, 1, -1, 255, 2**15, 2**24, 2**31 - 1, -(2**31)))
                changed[at : at + 4] = struct.pack(chance.choice("<>") + "i", value)
            case 7:
                word = (
                    b"-",
                    b"9",
                    b"0",
                    b" ",
                    b"\n",
                    b"nan",
                    b"1e999",
                    b"99999999999",
                    b"/",
                    b"\xff",
                    b"#",
                    b'"',
                    b"{",
                )
                changed[at : at + chance.randrange(2)] = chance.choice(word)
            case 8:
                del changed[at:]
                changed += chance.randbytes(length)
        if not changed:
            return b""
    return bytes(changed)


def run(all_cases: Sequence[Case], folder: Path, worker: Sequence[str] = WORKER) -> list[Verdict]:
    """Loads every case in a process that is started again whenever a file kills it, and judges the outcomes."""
    paths = []
    for number, case in enumerate(all_cases):
        paths.append(str(folder / f"{number:05d}{case.suffix}"))
        Path(paths[-1]).write_bytes(case.data)
    outcomes: dict[str, dict] = {}
    while waiting := [path for path in paths if path not in outcomes]:
        outcomes |= _loaded(waiting, worker)
    sound = {
        (case.suffix, case.name): outcomes[path]
        for case, path in zip(all_cases, paths, strict=True)
        if case.kind == "sound"
    }
    return [
        _judged(case, outcomes[path], sound.get((case.suffix, case.source), {}))
        for case, path in zip(all_cases, paths, strict=True)
    ]


def _loaded(paths: Sequence[str], worker: Sequence[str]) -> dict[str, dict]:
    """Outcomes up to the first file that ends the process, that one included."""
    done = subprocess.run(worker, input=json.dumps(paths), capture_output=True, text=True, cwd=ROOT, check=False)
    lines = done.stdout.splitlines()
    outcomes = {path: json.loads(line) for path, line in zip(lines[0::2], lines[1::2], strict=False)}
    if len(lines) % 2:
        hung = "Timeout" in done.stderr
        wrong = f"no end within {SECONDS} s" if hung else f"the process ended with {done.returncode}"
        outcomes[lines[-1]] = {"outcome": "hung" if hung else "crashed", "wrong": wrong}
    elif done.returncode or not outcomes:
        raise RuntimeError(f"the worker failed by itself: {done.stderr[-2000:]}")
    elif done.stderr:
        outcomes[paths[len(outcomes) - 1]] |= {"wrong": f"printed {done.stderr[-300:]!r} in this batch"}
    return outcomes


def _judged(case: Case, outcome: dict, sound: dict) -> Verdict:
    end, wrong = outcome["outcome"], outcome["wrong"]
    if end != "loaded" or wrong:
        if case.kind == "sound":
            wrong = wrong or f"a sound file was refused: {outcome.get('message')}"
        return Verdict(case, end, wrong)
    if case.kind == "sound":
        return Verdict(case, "loaded")
    if case.kind == "lying" and any(word in note for note in outcome["notes"] for word in ("ignored", "dropped")):
        return Verdict(case, "loaded, reported")
    if case.kind == "lying":
        return Verdict(case, "loaded", f"a header that lies was believed: {outcome['shape']}")
    if outcome["digest"] == sound["digest"]:
        return Verdict(case, "the same")
    if case.kind == "cut":
        if any("may be cut short" in note for note in outcome["notes"]):
            return Verdict(case, "loaded, reported")
        return Verdict(case, "loaded", "" if case.at_line_end else "a part was loaded as the whole")
    if len(outcome["shape"]) == 1 and outcome["shape"] != sound["shape"]:
        height, width, _ = outcome["shape"][0]
        wrong = f"{outcome['shape']} instead of {sound['shape']}, and no header says so"
        return Verdict(case, "another size", "" if _states(case, height, width) else wrong)
    return Verdict(case, "other data")


def _states(case: Case, height: int, width: int) -> bool:
    """Whether a header without a checksum states a size: then the file is a sound one of another picture."""
    if case.suffix == ".exr":
        at = case.data.rfind(b"displayWindow\0box2i\0") + 24
        left, top, right, bottom = struct.unpack_from("<4i", case.data, at)
        return (height, width) == (bottom - top + 1, right - left + 1)
    if case.suffix == ".jpg":
        at = case.data.index(b"\xff\xc0") + 5
        return (height, width) == struct.unpack_from(">2H", case.data, at)
    if case.suffix == ".webp":  # of a single frame, after its start code
        at = case.data.index(b"\x9d\x01\x2a") + 3
        # The upper two bits of each are for scaling.
        return (width, height) == tuple(size & 0x3FFF for size in struct.unpack_from("<2H", case.data, at))
    return False


def table(verdicts: Sequence[Verdict]) -> str:
    """Counts by format and kind of fault."""
    counts: dict[tuple[str, str], collections.Counter] = {}
    for verdict in verdicts:
        counts.setdefault((verdict.case.suffix, verdict.case.kind), collections.Counter())[verdict.end] += 1
    return "\n".join(
        f"{suffix:5} {kind:8} {sum(ends.values()):5}: " + ", ".join(f"{n} {end}" for end, n in ends.most_common())
        for (suffix, kind), ends in counts.items()
    )
