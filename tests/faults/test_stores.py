"""Every damaged store and every full disk ends in one line or the right picture, and loses nothing that is sound."""

import pytest

from tests.faults import full_disks, stores


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> stores.Sound:
    return stores.prepare(tmp_path_factory.mktemp("stores"))


@pytest.fixture(scope="module")
def exact(tmp_path_factory) -> stores.Sound:
    """A store that is lit from its visibility."""
    return stores.prepare(tmp_path_factory.mktemp("exact"), *stores.EXACT)


# Layouts are read by the same lines in all kinds of layers, and so are their groups.
_QUICK = "store.json", "transport/last group"


@pytest.mark.parametrize(
    "file",
    [pytest.param(file, marks=[pytest.mark.slow] * (file not in _QUICK)) for file in stores.FILES],
)
def test_damaged_file(sound, file: str):
    damages = list(stores.damages_to(file, sound))
    assert len(damages) >= 12
    assert not stores.wrong(damages, sound)


@pytest.mark.slow
@pytest.mark.parametrize("file", stores.EXACT_FILES)
def test_damaged_visibility_that_is_lit_from(exact, file: str):
    assert not stores.wrong(stores.damages_to(file, exact), exact)


@pytest.mark.slow
def test_damaged_store_of_filtered_visibility(tmp_path):
    filtered = stores.prepare(tmp_path, *stores.FILTERED)
    for file in stores.FILTERED_FILES:
        assert not stores.wrong(stores.damages_to(file, filtered), filtered)


@pytest.mark.slow
def test_damaged_store_of_what_bounces(tmp_path):
    """Clusters in codes, and light that surfaces emit."""
    bounced = stores.prepare(tmp_path, *stores.BOUNCED)
    for file in stores.BOUNCED_FILES:
        assert not stores.wrong(stores.damages_to(file, bounced), bounced)


@pytest.mark.slow
def test_damaged_store_of_local_lights(tmp_path):
    """Points, what they reflect, what they and pixels get of it, and the lights."""
    indirect = stores.prepare(tmp_path, *stores.INDIRECT)
    for file in stores.INDIRECT_FILES:
        assert not stores.wrong(stores.damages_to(file, indirect), indirect)


@pytest.mark.slow
def test_damage_to_the_whole(sound):
    assert not stores.wrong(stores.WHOLE, sound)


def test_what_is_wrong_is_called_so(sound):
    """What is promised otherwise than it comes, and damage that nobody could notice."""
    nothing = stores.Damage("nothing", lambda copy, other: None)
    assert stores.wrong_with(nothing, sound).startswith("relight: ended with 0")
    harm = next(iter(stores.damages_to("transport/last group", sound))).harm
    assert stores.wrong_with(stores.Damage("x", harm, relit=True), sound).startswith("relight: ended with 1")
    assert stores.wrong_with(stores.Damage("x", harm, told=True), sound).startswith("info: ended with 1")
    assert stores.wrong_with(stores.Damage("x", harm, mended=False), sound).startswith("precompute: ended with 0")


needs_disks = pytest.mark.skipif(bool(full_disks.hindrance()), reason=full_disks.hindrance() or "none")


@needs_disks
@pytest.mark.parametrize("share", full_disks.SHARES)
def test_disk_that_holds_a_share_of_a_store(sound, share: float):
    assert not full_disks.wrong_with_store(share, sound)


@needs_disks
@pytest.mark.parametrize("name", full_disks.PICTURES)
def test_disk_without_room_for_a_picture(sound, name: str):
    assert not full_disks.wrong_with_picture(name, sound)
