"""Files and processes at the extremes: whatever is cut, mutated, lying, damaged, full or killed; see `tests.faults`."""

import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.scene.demo_scene import demo_scene
from tests.faults import campaign, full_disks, stores
from tests.faults.sources import formats
from tests.geometry import test_mesh as meshes
from tests.precomputation.test_precompute import CHILD, METHOD, files_of

FORMATS = formats()


def test_broken_meshes_end_as_documented(holds):
    """Loaded with a counted repair, or refused in one line."""
    wrong = []
    for name in sorted(meshes.BROKEN):
        try:
            meshes.test_broken_files_end_as_documented(name)
        except AssertionError:
            wrong.append(name)
    holds(f"{len(meshes.BROKEN)} broken meshes: otherwise than documented", len(wrong), 0)


@pytest.mark.parametrize("suffix", FORMATS)
def test_files_end_as_promised(holds, suffix, tmp_path):
    """Cut at 20 places, mutated 200 times, and lying about their size: a typed error, or the right data."""
    verdicts = campaign.run(list(campaign.cases(suffix, FORMATS[suffix], seed=3)), tmp_path)
    for kind in ("cut", "mutated", "lying"):
        wrong = [f"{one.case.name}: {one.end}; {one.wrong}" for one in verdicts if one.case.kind == kind and one.wrong]
        holds(f"{suffix} {kind}: otherwise than promised", len(wrong), 0)


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> stores.Sound:
    return stores.prepare(tmp_path_factory.mktemp("sound"))


@pytest.mark.parametrize("file", stores.FILES)
def test_flipped_bits_of_a_store_are_found(holds, sound, file):
    flips = [damage for damage in stores.damages_to(file, sound) if "flip" in damage.name]
    assert flips
    holds(f"{file}, flipped: not found", len(stores.wrong(flips, sound)), 0)


@pytest.mark.skipif(bool(full_disks.hindrance()), reason=full_disks.hindrance() or "none")
@pytest.mark.parametrize("share", full_disks.SHARES)
def test_full_disks_lose_nothing(holds, sound, share):
    wrong = full_disks.wrong_with_store(share, sound)
    holds(f"a disk that holds {share:g} of a store: otherwise than promised", len(wrong), 0)


def test_a_run_killed_at_20_moments_and_resumed_is_the_same(holds, tmp_path):
    """A store is killed again and again, a few reports after its start and a moment later, until it is whole.

    Then it is what an undisturbed run makes, and the next one is begun.
    """
    scene = demo_scene(detail=0.1, size=24)
    precompute(scene, METHOD, tmp_path / "made")
    made = files_of(tmp_path / "made")
    generator, reached, number, wrong = np.random.default_rng(5), set(), 0, 0

    def finished(folder: pathlib.Path) -> dict[str, str]:
        # What was being written when a process was killed is swept later.
        return {name: file for name, file in files_of(folder).items() if "/." not in name}

    for _ in range(20):
        folder = tmp_path / str(number)
        child = subprocess.Popen(
            [sys.executable, "-c", CHILD, str(folder)],
            stdout=subprocess.PIPE,
            text=True,
            cwd=pathlib.Path(jr.__file__).parents[1],
        )
        assert child.stdout is not None
        with child.stdout:
            for _ in range(int(generator.integers(1, 8))):
                reached.add(line := child.stdout.readline().rstrip("0123456789 \n"))
                if line == "end":
                    number += 1
                    break
            time.sleep(generator.uniform(0, 0.005))
            child.send_signal(signal.SIGKILL)
            child.stdout.read()
        assert child.wait() in (-signal.SIGKILL, 0)
        wrong += not finished(folder).items() <= made.items()
        wrong += line == "end" and finished(folder) != made
    assert reached >= {"visibility", "transport of stone", "end"}
    precompute(scene, METHOD, folder)
    wrong += finished(folder) != made
    holds("a run killed 20 times and resumed: other files", wrong, 0)
