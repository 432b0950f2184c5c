"""No file, cut, mutated or lying, crashes, hangs, takes memory or loads as what it is not."""

import os
import sys
from pathlib import Path

import pytest

from tests.faults import campaign
from tests.faults.campaign import Case, Verdict
from tests.faults.sources import formats

FORMATS = formats()


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory) -> list[Verdict]:
    files = [case for suffix, kind in FORMATS.items() for case in campaign.cases(suffix, kind)]
    return campaign.run(files, tmp_path_factory.mktemp("faults"))


def _wrong(verdicts) -> list[str]:
    return [f"{v.case.suffix} {v.case.name}: {v.end}; {v.wrong}" for v in verdicts if v.wrong]


@pytest.mark.parametrize("kind", ["sound", "cut", "mutated", "lying"])
@pytest.mark.parametrize("suffix", FORMATS)
def test_every_file_ends_as_promised(verdicts, suffix, kind):
    chosen = [v for v in verdicts if (v.case.suffix, v.case.kind) == (suffix, kind)]
    files = FORMATS[suffix].files
    expected = {"sound": len(files), "cut": 20 * len(files), "mutated": 200, "lying": len(FORMATS[suffix].lies)}
    assert len(chosen) == expected[kind]
    assert not _wrong(chosen)
    if kind == "mutated":  # neither are all refused, nor does all damage pass
        assert sum(v.end == "refused" for v in chosen) >= 20
        assert suffix == ".png" or any(v.end == "other data" for v in chosen)  # whose checksums find everything


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_many_more_mutations(tmp_path, seed):
    files = [case for suffix, kind in FORMATS.items() for case in campaign.cases(suffix, kind, 200, 2000, seed)]
    assert not _wrong(campaign.run(files, tmp_path))


# ---- the campaign itself ---------------------------------------------------------------------------------------------

WORKER = """
import json, os, sys, time, faulthandler
for path in json.load(sys.stdin):
    print(path, flush=True)
    word = open(path).read()
    if word == "crash":
        os.abort()
    if word == "hang":
        faulthandler.dump_traceback_later(0.1, exit=True)
        time.sleep(60)
    print(json.dumps({"outcome": word, "digest": word, "shape": [[1, 1, 3]], "notes": [], "wrong": ""}), flush=True)
"""


def _ends(tmp_path, words, kind="mutated"):
    files = [Case(".hdr", kind, str(i), word.encode()) for i, word in enumerate(words)]
    return [v.end for v in campaign.run(files, tmp_path, [sys.executable, "-c", WORKER])]


def test_a_crash_and_a_hang_are_seen_and_cost_one_file(tmp_path):
    assert _ends(tmp_path, ["refused", "crash", "refused", "hang", "crash", "refused"]) == [
        "refused", "crashed", "refused", "hung", "crashed", "refused",
    ]  # fmt: skip


def _judged(case: Case, **outcome) -> str:
    sound = {"outcome": "loaded", "digest": "a", "shape": [[2, 3, 3]], "notes": [], "wrong": ""}
    return campaign._judged(case, sound | outcome, sound).wrong


def test_what_is_wrong_is_called_so():
    assert not _judged(Case(".hdr", "cut", "", b""))
    assert "a part was loaded" in _judged(Case(".hdr", "cut", "", b""), digest="b")
    assert not _judged(Case(".obj", "cut", "", b""), digest="b", notes=["the file may be cut short"])
    assert not _judged(Case(".obj", "cut", "", b"", at_line_end=True), digest="b")
    assert not _judged(Case(".hdr", "mutated", "", b""), digest="b")
    assert "no header says so" in _judged(Case(".hdr", "mutated", "", b""), digest="b", shape=[[1, 3, 3]])
    assert "believed" in _judged(Case(".hdr", "lying", "", b""))
    assert "sound file was refused" in _judged(Case(".hdr", "sound", "", b""), outcome="refused", message="why")
    assert _judged(Case(".hdr", "mutated", "", b""), outcome="raised", wrong="KeyError") == "KeyError"


@pytest.fixture(scope="module")
def odd(tmp_path_factory) -> dict[str, dict]:
    """What comes, in one process, of a picture of 48 MB and of a pipe of every format."""
    folder = tmp_path_factory.mktemp("odd")
    large = folder / "large.hdr"
    large.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2000 +X 2000\n" + bytes((9, 8, 7, 120)) * 2000**2)
    pipes = [str(folder / f"pipe{suffix}") for suffix in FORMATS] if hasattr(os, "mkfifo") else []
    for path in pipes:
        os.mkfifo(path)
    outcomes = campaign._loaded([str(large), *pipes], campaign.WORKER)
    assert list(outcomes) == [str(large), *pipes]
    return outcomes


def test_the_worker_limits_memory_and_judges_messages(odd, monkeypatch):
    """A picture larger than the limit is refused for its size, which the campaign calls wrong."""
    pytest.importorskip("resource")
    from tests.faults import worker

    path = next(iter(odd))
    outcome = campaign._loaded([path], (*campaign.WORKER[:-1], "32"))[path]
    assert "larger than the free memory" in outcome["message"]
    assert outcome["wrong"] == "memory was taken before the file was refused"
    assert odd[path]["outcome"] == "loaded"

    def raises(fault):
        def load(_):
            raise fault

        monkeypatch.setattr(worker, "loaded", load)
        return worker.outcome(Path("a.ply"))

    assert raises(KeyError("x")) == {"outcome": "raised", "wrong": "KeyError: 'x'"}
    assert raises(worker.InputError("a.ply: bad; mend it"))["wrong"] == ""
    assert "one line" in raises(worker.InputError("bad"))["wrong"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_pipes_are_refused_instead_of_waited_for(odd):
    pipes = [outcome for path, outcome in odd.items() if "pipe" in Path(path).name]
    assert len(pipes) == len(FORMATS)
    assert all("not a regular file" in outcome["message"] for outcome in pipes)
