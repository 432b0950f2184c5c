"""From scene to store and back: reuse, resuming, truncation, invariance and gradients of the whole path."""

import contextlib
import dataclasses
import hashlib
import json
import os
import pathlib
import shutil
import subprocess
import sys
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Part, Scene
from jaxrelight.basis import latlong
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factoring import Factoring
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.reflection import FixedView
from jaxrelight.files import store
from jaxrelight.geometry import mesh as meshes
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lights.environment import encode
from jaxrelight.methods import Transport
from jaxrelight.operators.sparse_rows import SparseRows
from jaxrelight.precomputation import layers as stages
from jaxrelight.precomputation.load import load
from jaxrelight.precomputation.material_rows import MaterialRows
from jaxrelight.precomputation.placing import geometry_keys
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.scene.demo_scene import demo_scene
from jaxrelight.transport.model import PrecomputedTransport
from jaxrelight.transport.rebake import exact, rebake
from tests.operators.derivatives import check_derivatives, derivatives
from tests.scenes import ball_over_floor
from tests.transport.stores import load_transport, number_of, open_transport, reflections_of

# One set of shapes for most of the file: compiling is what takes time here.
METHOD = Transport(
    "vertices", receiver_tolerance=0, reflection="factors", resolution=8, terms=2, coefficients=32, factor_resolution=12
)
PIXELS = dataclasses.replace(METHOD, receivers="pixels")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return demo_scene(detail=0.1, size=24)


@pytest.fixture(scope="module")
def made(scene, tmp_path_factory) -> pathlib.Path:
    """The store of the scene, for vertices; not to be written to."""
    folder = tmp_path_factory.mktemp("made") / "store"
    precompute(scene, METHOD, folder)
    return folder


@pytest.fixture(scope="module")
def made_pixels(scene, tmp_path_factory) -> pathlib.Path:
    """The same for pixels."""
    folder = tmp_path_factory.mktemp("made_pixels") / "store"
    precompute(scene, PIXELS, folder)
    return folder


@pytest.fixture
def copy(made, tmp_path) -> pathlib.Path:
    """A copy of that store."""
    shutil.copytree(made, tmp_path / "copy")
    return tmp_path / "copy"


def files_of(folder: pathlib.Path) -> dict[str, str]:
    """Every file's hash."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def _layers(folder: pathlib.Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.is_dir()}


def _image(folder: pathlib.Path, scene: Scene) -> np.ndarray:
    return open_transport(folder).picture(scene.lights)


def _relative(actual, wanted) -> float:
    return float(np.linalg.norm(np.subtract(actual, wanted)) / np.linalg.norm(wanted))


# What is there is used again.


def test_second_run_traces_nothing_and_changes_no_file(scene, copy):
    before = files_of(copy)
    summary = precompute(scene, METHOD, copy)
    assert summary.rays == 0
    assert files_of(copy) == before


def test_summary_tells_what_was_done(scene, tmp_path):
    reports = []
    summary = precompute(scene, METHOD, tmp_path / "store", lambda *report: reports.append(report))
    vertices = sum(len(part.mesh.vertices) for part in scene.parts)
    assert summary.receivers == vertices
    # Half of the directions are above a receiver, the copies that fill up groups included.
    groups = store.open_layer(next((tmp_path / "store").glob("visibility-*"))).groups
    assert summary.rays == pytest.approx(groups * 128 * 6 * 8**2 / 2, rel=0.1)
    assert set(summary.seconds) == {"geometry", "visibility", "transport", "account"}
    on_disk: dict[str, int] = dict.fromkeys(("geometry", "environment", "visibility", "factors", "transport"), 0)
    for path in summary.folder.glob("*-*/**/*"):
        if path.is_file():
            on_disk[path.relative_to(summary.folder).parts[0].partition("-")[0]] += path.stat().st_size
    assert summary.nbytes == on_disk
    stages_told = {stage for stage, _, _ in reports}
    assert stages_told == {"visibility", *(f"transport of {name}" for name in scene.materials)}
    for stage in stages_told:
        done = [(done, total) for name, done, total in reports if name == stage]
        assert [d for d, _ in done] == sorted(d for d, _ in done)
        assert done[0][0] == 0
        assert done[-1][0] == done[-1][1]


def test_changed_material_bakes_only_its_own(scene, copy, tmp_path):
    before, old = files_of(copy), _layers(copy)
    darker = jr.phong([0.1, 0.1, 0.1], [0.4, 0.4, 0.4], 7.0)
    changed = dataclasses.replace(scene, materials={**scene.materials, "lacquer": darker})
    summary = precompute(changed, METHOD, copy)
    assert summary.rays == 0
    after = files_of(copy)
    assert all(after[name] == before[name] for name in before if name != "store.json")
    new = _layers(copy) - old
    assert sorted(name.partition("-")[0] for name in new) == ["factors", "transport"]
    # What was made is what a fresh store gets.
    fresh = tmp_path / "fresh"
    precompute(changed, METHOD, fresh)
    assert files_of(fresh).items() <= after.items()
    # And back: everything is there.
    precompute(scene, METHOD, copy)
    assert files_of(copy) == {**after, "store.json": before["store.json"]}


def test_changed_material_under_pixels_bakes_only_its_own(scene, made_pixels, tmp_path):
    shutil.copytree(made_pixels, tmp_path / "a")
    old = _layers(tmp_path / "a")
    dull = dataclasses.replace(scene, materials={**scene.materials, "lacquer": jr.phong(0.1, 0.4, 2.0)})
    summary = precompute(dull, PIXELS, tmp_path / "a")
    assert summary.rays == 0
    # The view is fixed: a glossy material needs no factors.
    assert [name.partition("-")[0] for name in _layers(tmp_path / "a") - old] == ["transport"]


@pytest.mark.parametrize("receivers", ["vertices", pytest.param("pixels", marks=pytest.mark.slow)])
def test_equal_materials_of_two_names_have_layers_of_their_own(tmp_path, receivers: str):
    """The picture is that of one material on all meshes, whose receivers are other groups."""
    scene, light = _small_scene(), np.random.default_rng(1).random((6 * METHOD.resolution**2, 3)).astype(np.float32)
    gloss = scene.materials["gloss"]
    method = dataclasses.replace(METHOD, receivers=receivers)
    both = dataclasses.replace(scene, materials={"paper": gloss, "gloss": gloss})
    one = dataclasses.replace(both, parts=[dataclasses.replace(part, material="gloss") for part in scene.parts])
    images = []
    for name, same in (("both", both), ("one", one)):
        precompute(same, method, tmp_path / name)
        relighter = open_transport(tmp_path / name)
        images.append(np.asarray(relighter.shade_terms(relighter.terms(light), relighter.view())))
    assert len(list((tmp_path / "both").glob("transport-*"))) == 2
    np.testing.assert_allclose(images[0], images[1], rtol=1e-5, atol=1e-6)


def test_renamed_material_keeps_its_layers(scene, copy):
    """Keys follow what a material is, not what it is called."""
    old = _layers(copy)
    renamed = dataclasses.replace(
        scene,
        parts=[dataclasses.replace(part, material=f"{part.material}_") for part in scene.parts],
        materials={f"{name}_": brdf for name, brdf in scene.materials.items()},
    )
    assert precompute(renamed, METHOD, copy).rays == 0
    assert _layers(copy) == old


@pytest.mark.parametrize(
    ("change", "traced", "new"),
    [
        ({"coefficients": 16}, False, {"transport"}),
        ({"terms": 3}, False, {"transport", "factors"}),
        ({"factor_resolution": 10}, False, {"transport", "factors"}),
        ({"coefficients": "all"}, False, set()),
        ({"resolution": 4}, True, {"visibility", "transport"}),
        ({"visibility_samples": 4}, True, {"visibility", "transport"}),
        ({"receivers": "pixels"}, True, {"visibility", "transport"}),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_changed_dials_use_other_layers(tmp_path, monkeypatch, change: dict, traced: bool, new: set):
    """A key that left out a dial would give the layer of another."""
    # Which layers are asked for shows without baking them.
    monkeypatch.setattr(MaterialRows, "_complete", lambda *_: None)
    monkeypatch.setattr("jaxrelight.precomputation.precompute._account", lambda *_: None)
    parts = [Part(jr.plane((2, 2), 2), "paper"), Part(jr.sphere(0.4, 2), "gloss")]
    materials = {"paper": jr.lambert(0.5), "gloss": jr.phong(0.1, 0.3, 5)}
    scene = Scene(parts, materials, jr.Camera((0, 1, 3), (0, 0, 0), width=8, height=8))
    method = dataclasses.replace(METHOD, coefficients=8)
    precompute(scene, method, tmp_path)
    old = _layers(tmp_path)
    before = files_of(tmp_path)
    summary = precompute(scene, dataclasses.replace(method, **change), tmp_path)
    assert (summary.rays > 0) == traced
    assert {name.partition("-")[0] for name in _layers(tmp_path) - old} == new
    after = files_of(tmp_path)
    assert all(after[name] == before[name] for name in before if name != "store.json")
    changed = dataclasses.replace(method, **change)
    assert store.read_header(tmp_path)["method"] == {"name": "transport", "dials": dataclasses.asdict(changed)}


def test_other_camera_traces_anew_for_pixels_only(scene, copy, made_pixels, tmp_path):
    other = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, origin=(0.0, 1.1, 2.7)))
    assert precompute(other, METHOD, copy).rays == 0
    shutil.copytree(made_pixels, tmp_path / "pixels")
    assert precompute(other, PIXELS, tmp_path / "pixels").rays > 0


def test_other_geometry_traces_anew(scene, copy):
    def shifted(mesh):
        return dataclasses.replace(mesh, vertices=mesh.vertices + np.array([0, 1e-6, 0]))

    parts = [dataclasses.replace(scene.parts[0], mesh=shifted(scene.parts[0].mesh)), *scene.parts[1:]]
    assert precompute(dataclasses.replace(scene, parts=parts), METHOD, copy).rays > 0


def test_environment_is_not_part_of_the_keys(scene, copy):
    old = _layers(copy)
    sky = jr.environment(np.full((8, 16, 3), 0.25), rotate_y=20, scale=3)
    precompute(dataclasses.replace(scene, lights=sky), METHOD, copy)
    assert _layers(copy) - old == {store.read_header(copy)["environment"]["pixels"]}
    stored = load_transport(copy).stored.lights().environment
    assert stored is not None
    np.testing.assert_array_equal(stored.pixels, sky.pixels)
    assert (stored.rotate_y, stored.scale) == (20, 3)


def test_local_lights_are_not_part_of_the_keys(scene, copy):
    """The store keeps them beside the environment as the scene's own."""
    old, sky = _layers(copy), scene.lights.environment
    lamp = jr.point([0.5, 2.0, 1.0], [3.0, 2.0, 1.0])
    assert precompute(dataclasses.replace(scene, lights=[sky, lamp]), METHOD, copy).rays == 0
    assert _layers(copy) - old == {store.read_header(copy)["lights"]["layer"]}
    stored = open_transport(copy).scene_lights()
    assert stored.environment is not None
    np.testing.assert_array_equal(stored.environment.pixels, sky.pixels)
    assert eqx.tree_equal(stored.local, (lamp,))


def test_equal_runs_make_equal_files(scene, made, tmp_path):
    precompute(scene, METHOD, tmp_path / "again")
    assert files_of(tmp_path / "again") == files_of(made)


# What cannot be done is told.


def test_camera_that_sees_nothing_has_no_pixels_to_precompute(scene, tmp_path):
    away = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, target=(0.7, 9.0, 9.0)))
    with pytest.raises(InputError, match="demo: the camera sees no surface"):
        precompute(away, PIXELS, tmp_path)


def test_store_that_is_a_file_is_refused(scene, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="cannot be used as a store"):
        precompute(scene, METHOD, tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine"


def test_incomplete_store_is_refused(copy):
    layer = next(copy.glob("transport-*"))
    (layer / "000000").unlink()
    with pytest.raises(InputError, match=r"1 of [0-9]+ parts are missing; run precompute"):
        load(copy)
    (copy / "store.json").unlink()
    with pytest.raises(InputError, match="not a store, or its precomputation was not finished"):
        load(copy)


@pytest.mark.parametrize("kind", ["geometry", "environment", "visibility", "factors", "transport"])
def test_missing_layer_is_refused_and_made_again(scene, made, copy, kind: str):
    for folder in copy.glob(f"{kind}-*"):
        shutil.rmtree(folder)
    with pytest.raises(InputError, match=f"{kind}-[0-9a-f]+: this layer is missing or damaged"):
        load(copy)
    summary = precompute(scene, METHOD, copy)
    assert (summary.rays > 0) == (kind == "visibility")
    assert files_of(copy) == files_of(made)


def _read_all(folder: pathlib.Path):
    """Everything that lighting, or exact lighting, reads of a store."""
    stored = load(folder).stored
    stored.lights()
    assert stored.visibility is not None
    stored.visibility.read_all()


@pytest.mark.parametrize("name", ["store.json", "layout.json", "group"])
def test_flipped_bit_is_found_and_mended(scene, made, copy, name: str):
    """In every kind of file of every kind of layer: told in one line by whoever reads, made anew by precompute."""
    generator = np.random.default_rng(3)
    layers = sorted({path.name.partition("-")[0]: path for path in copy.iterdir() if path.is_dir()}.values())
    assert len(layers) == 5
    victims = {
        "store.json": [copy / "store.json"] * 4,
        "layout.json": [layer / "layout.json" for layer in layers],
        "group": [generator.choice(sorted(layer.glob("0*"))) for layer in layers],
    }[name]
    for victim in victims:
        bad = bytearray(victim.read_bytes())
        bit = int(generator.integers(8 * len(bad)))
        bad[bit // 8] ^= 1 << bit % 8
        victim.write_bytes(bad)
        with pytest.raises(InputError, match=r"precompute again") as caught:
            _read_all(copy)
        assert str(copy) in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
    summary = precompute(scene, METHOD, copy)
    groups = store.open_layer(next(copy.glob("visibility-*"))).groups
    assert (0 < summary.rays < 2 * 128 * 6 * 8**2) == (name == "group")
    assert groups > 2
    assert files_of(copy) == files_of(made)


def test_nothing_is_written_to_open_a_store(made):
    """As from a folder that must not be written to, whoever runs this."""
    code = """
import sys
import jaxrelight as jr
import jax
folder = sys.argv[1]
def refuse(event, arguments):
    writes = event == "open" and arguments[2] & 0o3 or event in ("os.rename", "os.remove", "os.mkdir", "os.rmdir")
    if writes and str(arguments[0]).startswith(folder):
        raise PermissionError(13, f"Permission denied: {event} {arguments}")
sys.addaudithook(refuse)
jr.open_store(folder).picture()
try:
    open(folder + "/x", "w")
except PermissionError:
    print("guarded")
"""
    before = {path: path.stat().st_mtime_ns for path in made.rglob("*")}
    done = subprocess.run(
        [sys.executable, "-c", code, str(made)],
        capture_output=True, text=True, check=False, cwd=pathlib.Path(jr.__file__).parents[1],
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("guarded\n", "")
    assert {path: path.stat().st_mtime_ns for path in made.rglob("*")} == before


def test_disk_that_fills_up_is_told_and_gone_on_from(scene, made, tmp_path):
    """No file may be longer than a limit, as on a full disk; what fits is kept."""
    code = CHILD.replace(
        "import jaxrelight",
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (12_000,) * 2)\nimport jaxrelight",
    ).replace("precompute(", "try:\n    precompute(") + "\n".join(
        ["", "except jr.InputError as error:", "    print(error)"]
    )
    code = code.replace('print("end", flush=True)\n', "")
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "store")],
        capture_output=True, text=True, check=False, cwd=pathlib.Path(jr.__file__).parents[1],
    )  # fmt: skip
    assert done.stderr == ""
    assert "File too large; what is finished is kept, make room and run again" in done.stdout.splitlines()[-1]
    kept = files_of(tmp_path / "store")
    assert kept
    assert kept.items() <= files_of(made).items()
    precompute(scene, METHOD, tmp_path / "store")
    assert files_of(tmp_path / "store") == files_of(made)


def test_two_processes_at_once_share_the_work(made, tmp_path):
    """Both end well, with the store that one makes, and not all is done twice."""
    code = CHILD.replace('print("end", flush=True)', 'print("rays", made.rays)').replace(
        "precompute(", "made = precompute("
    )
    both = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path / "store")],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=pathlib.Path(jr.__file__).parents[1],
        )
        for _ in range(2)
    ]  # fmt: skip
    for process in both:
        out, err = process.communicate()
        assert (process.returncode, err) == (0, "")
        assert out.splitlines()[-1].startswith("rays ")
    assert files_of(tmp_path / "store") == files_of(made)


def test_other_scene_in_the_same_store_meanwhile(scene, copy):
    """Whoever precomputed opens what it precomputed, though another process wrote another header."""
    mine = precompute(scene, METHOD, copy)
    precompute(dataclasses.replace(scene, lights=None), dataclasses.replace(METHOD, coefficients="all"), copy)
    assert load_transport(copy).method == dataclasses.replace(METHOD, coefficients="all")
    transport = load_transport(copy, mine.header)
    assert transport.method == METHOD
    assert transport.stored.lights().environment is not None


def test_what_a_store_holds_is_a_pytree_of_arrays(made):
    """All of its numbers can be arguments of a compiled function; what is not compiled for is equal by its key."""
    one, other = load_transport(made), load_transport(made)
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(one))
    assert jax.tree.structure(one) == jax.tree.structure(other)
    light = np.random.default_rng(4).random((6 * METHOD.resolution**2, 3)).astype(np.float32)
    compiled = jax.jit(lambda transport, light: TransportRelighter(transport).terms(light))
    for block_terms, wanted in zip(compiled(one, light), TransportRelighter(other).terms(light), strict=True):
        np.testing.assert_allclose(block_terms, wanted, rtol=1e-5, atol=1e-6)
    with _compiled() as anew:
        compiled(other, light)
    assert anew == []


# What was stopped goes on.


def test_failed_run_keeps_what_is_done(scene, made, tmp_path, monkeypatch):
    traced = []

    def fail(*arguments):
        if len(traced) == 4:
            raise InputError("disk full")
        traced.append(trace(*arguments)[1])
        return trace(*arguments)

    trace = stages.trace_adaptively
    with monkeypatch.context() as patch:
        patch.setattr(stages, "trace_adaptively", fail)
        patch.setattr(os, "cpu_count", lambda: 1)
        with pytest.raises(InputError, match="disk full"):
            precompute(scene, METHOD, tmp_path / "store")
    with pytest.raises(InputError, match="not finished; run precompute"):
        load(tmp_path / "store")
    done = store.open_layer(next((tmp_path / "store").glob("visibility-*"))).done
    assert len(done) == 4
    whole = precompute(scene, METHOD, tmp_path / "whole").rays
    assert precompute(scene, METHOD, tmp_path / "store").rays == whole - sum(traced)
    assert files_of(tmp_path / "store") == files_of(made)


CHILD = """
import pathlib, sys
import jaxrelight as jr
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.scene.demo_scene import demo_scene
dials = {"receiver_tolerance": 0, "reflection": "factors", "resolution": 8, "terms": 2, "coefficients": 32}
method = jr.Transport("vertices", factor_resolution=12, **dials)
def report(*progress):
    print(*progress, flush=True)
precompute(demo_scene(detail=0.1, size=24), method, pathlib.Path(sys.argv[1]), report)
print("end", flush=True)
"""


# What is left out is bounded, and what is kept is right.


@pytest.mark.parametrize("receivers", ["vertices", pytest.param("pixels", marks=pytest.mark.slow)])
def test_all_coefficients_kept_is_all_of_them(tmp_path, receivers: str):
    scene, count = _small_scene(), 6 * METHOD.resolution**2
    method = dataclasses.replace(METHOD, receivers=receivers, coefficients=count)
    precompute(scene, method, tmp_path)
    kept = load_transport(tmp_path)
    precompute(scene, dataclasses.replace(method, coefficients="all"), tmp_path)
    streamed = load_transport(tmp_path)
    assert kept.kept == pytest.approx(1, abs=1e-12)
    assert all(block.dropped is None for block in streamed.blocks)
    light = np.random.default_rng(0).gamma(0.3, size=(count, 3)).astype(np.float32)
    encoded = _encode(light.T).T
    terms = [TransportRelighter(t).terms(x) for t, x in ((kept, encoded), (streamed, light), (exact(kept), light))]
    for part, wanted, baked in zip(*terms, strict=True):
        assert _relative(part, wanted) < 1e-5
        np.testing.assert_array_equal(wanted, baked)
    # Nor does baking again change what is streamed.
    again = TransportRelighter(rebake(streamed, reflections_of(streamed))).terms(light)
    for part, wanted in zip(again, terms[1], strict=True):
        np.testing.assert_array_equal(part, wanted)


@jax.jit
def _coefficients(texels):
    return HaarFaces(METHOD.resolution).encode(texels)


@jax.jit
def _texels(coefficients):
    return HaarFaces(METHOD.resolution).decode(coefficients)


def _encode(texels) -> np.ndarray:
    """Light over texels [3, d] in coefficients."""
    return np.asarray(_coefficients(np.asarray(texels, np.float32)))


def test_error_never_exceeds_what_was_dropped(small):
    """|Tx − T'x| ≤ ‖x‖·√dropped for every row, and equal for the light that is the dropped row itself."""
    transport = small.transport
    untruncated = exact(transport)
    generator = np.random.default_rng(2)
    count, d, _ = transport.operator.shape
    dropped = [block.dropped for block in transport.blocks if block.dropped is not None]
    bound = np.sqrt(np.concatenate([np.broadcast_to(part, (len(part), 3)) for part in dropped]))
    assert bound.shape == (count, 3)

    def error(light):
        light = light.astype(np.float32)
        kept = TransportRelighter(transport).terms(light)
        whole = TransportRelighter(untruncated).terms(np.asarray(_texels(light.T)).T)
        receivers = [128 * len(block.groups) for block in transport.blocks]
        parts = [(np.asarray(a), np.asarray(b), count) for a, b, count in zip(kept, whole, receivers, strict=True)]
        return np.abs(np.concatenate([(a - b)[:count].reshape(-1, 3) for a, b, count in parts]))

    spike = np.zeros((d, 3))
    spike[generator.integers(d)] = 1e5
    soft = generator.gamma(0.5, size=(3, d))
    lights = [_encode(soft).T, generator.normal(size=(d, 3)) ** 3, spike, _encode(spike.T).T]
    for light in lights:
        assert (error(light) <= np.linalg.norm(light, axis=0) * (bound + 1e-6)).all()

    starts = transport.operator.starts[:-1]
    for kept, whole, start in zip(transport.operator.operators, untruncated.operator.operators, starts, strict=True):
        row = generator.integers(kept.shape[0])
        whole, kept = (np.broadcast_to(each.rows(jax.device_put(np.array([row])))[0], (3, d)) for each in (whole, kept))
        left = _encode(whole) - kept
        worst, number = error(left.T), start + row
        assert (worst <= np.linalg.norm(left, axis=-1) * (bound + 1e-6)).all()
        np.testing.assert_allclose(worst[number], np.linalg.norm(left, axis=-1) * bound[number], rtol=1e-3, atol=1e-6)


def test_kept_energy_is_that_of_the_rows(small, tmp_path):
    transport = small.transport
    precompute(_small_scene(), dataclasses.replace(transport.method, coefficients=6 * METHOD.resolution**2), tmp_path)

    def energy(operators):
        return sum(float(np.square(part.values, dtype=float).sum()) * 3 / part.shape[2] for part in operators)

    whole = energy(load_transport(tmp_path).operator.operators)
    assert transport.kept == pytest.approx(energy(transport.operator.operators) / whole, abs=1e-6)
    assert 0.9 < transport.kept < 0.9999
    for part, block in zip(load_transport(tmp_path).operator.operators, transport.blocks, strict=True):
        assert block.dropped is not None
        assert block.dropped.shape == part.shape[::2]


def _sparse(transport: PrecomputedTransport) -> list[tuple[np.ndarray, list[np.ndarray]]]:
    """Of every block's rows which coefficients they keep, and their values, channel by channel."""
    blocks = []
    for operator in transport.operator.operators:
        assert isinstance(operator, SparseRows)
        blocks.append((np.asarray(operator.indices), [np.asarray(values) for values in operator.values]))
    return blocks


def test_rebake_gives_what_is_stored(small):
    transport = small.transport
    again = rebake(transport, reflections_of(transport))
    for (indices, values), (old_indices, old_values) in zip(_sparse(again), _sparse(transport), strict=True):
        np.testing.assert_array_equal(indices, old_indices)
        for channel, wanted in zip(values, old_values, strict=True):
            np.testing.assert_allclose(channel, wanted, rtol=1e-6, atol=1e-7 * float(np.abs(wanted).max()))


def test_rebake_with_another_material_keeps_the_sets(small):
    transport = small.transport
    number = number_of(transport, "gloss")
    # Rows are linear in the light maps, or in the albedo and the lobes' scale.
    linear = [".light_maps", ".brdf.diffuse", ".brdf.scale"]
    reflections = reflections_of(transport)
    reflections[number] = jax.tree_util.tree_map_with_path(
        lambda path, x: jax.device_put(np.asarray(x) * np.float32(2 if jax.tree_util.keystr(path) in linear else 1)),
        reflections[number],
    )
    pairs = zip(_sparse(rebake(transport, reflections)), _sparse(transport), strict=True)
    for i, ((indices, values), (old_indices, old_values)) in enumerate(pairs):
        np.testing.assert_array_equal(indices, old_indices)
        factor = 2 if i == number else 1
        np.testing.assert_allclose(values[0], factor * old_values[0], rtol=1e-5, atol=1e-6)


# The picture does not depend on how it is asked for.


@pytest.mark.slow
def test_vertices_and_pixels_agree_on_a_fine_mesh(tmp_path):
    """A diffuse plane with a soft shadow: what is interpolated between vertices is what pixels see."""
    parts = [Part(jr.plane((2, 2), 48), "paper")]
    up = np.eye(4)
    up[1, 3] = 0.6
    parts.append(Part(meshes.transformed(jr.sphere(0.3, 6), up), "ball"))
    camera = jr.Camera((0, 2.5, 2), (0, 0, 0), fov_y=30, width=24, height=24)
    scene = Scene(parts, {"paper": jr.lambert([0.7, 0.6, 0.5]), "ball": jr.lambert(0.5)}, camera)
    generator = np.random.default_rng(4)
    sky = jr.environment(0.5 + generator.random((4, 8, 3)))
    images = {}
    for receivers in ("vertices", "pixels"):
        method = Transport(receivers, resolution=16, coefficients="all", visibility_samples=4)
        precompute(scene, method, tmp_path / receivers)
        relighter = open_transport(tmp_path / receivers)
        images[receivers] = relighter.picture(sky, background=False)
    paper = images["vertices"][..., 3] == 1
    # The ball is 6 quads wide and stands in the middle of the image.
    paper &= np.abs(images["vertices"][..., 0] / np.maximum(images["vertices"][..., 1], 1e-9) - 7 / 6) < 0.5
    assert paper.sum() > 300
    error = jr.image_error(images["vertices"], images["pixels"])
    # Measured 0.8 %: shadow edges on a cube map of 16.
    assert error.trimmed < 0.012
    assert error.mean_ratio == pytest.approx(1, abs=0.005)


@pytest.mark.parametrize(
    ("scale", "shift"),
    [(1.0, (-1e6, 3e5, 1e6)), (1e-3, (0, 0, 0)), (1e6, (0, 0, 0))],
    ids=["far away", "millimetres", "megametres"],
)
@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
def test_place_and_size_of_the_world_do_not_matter(request, scene, tmp_path, scale: float, shift, receivers: str):
    plain = request.getfixturevalue("made" if receivers == "vertices" else "made_pixels")
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = shift

    def moved(point):
        return tuple(np.multiply(point, scale) + shift)

    camera = dataclasses.replace(scene.camera, origin=moved(scene.camera.origin), target=moved(scene.camera.target))
    parts = [dataclasses.replace(part, mesh=meshes.transformed(part.mesh, matrix)) for part in scene.parts]
    other = dataclasses.replace(scene, camera=camera, parts=parts)
    method = dataclasses.replace(METHOD, receivers=receivers)
    # Factors are copied: they know nothing of the world.
    for factors in plain.glob("factors-*"):
        shutil.copytree(factors, tmp_path / factors.name)
    assert precompute(other, method, tmp_path).rays > 0
    assert _relative(_image(tmp_path, other), _image(plain, scene)) < 1e-4


# Gradients of the whole path.


def _small_scene() -> Scene:
    gloss = jr.lobe_sum(
        [0.2, 0.3, 0.1],
        [jr.lobe([-1, -1, 0.9], 4.0, specular=[0.5, 0.4, 0.3]), jr.lobe([0.8, 0.7, 0.9], 3.0, specular=0.2)],
    )
    camera = jr.Camera((0.3, 1.2, 2.2), (0, 0.3, 0), fov_y=50, width=8, height=6)
    sky = jr.environment(np.random.default_rng(1).gamma(0.5, size=(4, 8, 3)))
    return ball_over_floor(gloss, camera, sky, quads=(3, 3))


@pytest.fixture(scope="module", params=["vertices", pytest.param("pixels", marks=pytest.mark.slow)])
def small(request, tmp_path_factory) -> TransportRelighter:
    folder = tmp_path_factory.mktemp("small")
    precompute(_small_scene(), dataclasses.replace(METHOD, receivers=request.param), folder)
    return open_transport(folder)


@pytest.fixture(scope="module")
def sky() -> np.ndarray:
    environment = _small_scene().lights.environment
    assert environment is not None
    return np.asarray(environment.pixels, np.float64)


@pytest.fixture(scope="module")
def lit(small: TransportRelighter):
    """Environment pixels, rotation and scale → light vector and picture, and the derivatives of both."""
    view = small.view()

    def light_and_picture(pixels, rotate_y, scale):
        light = small.light_vector(pixels, rotate_y, scale)
        return light, small.shade_terms(small.terms(light), view)

    return derivatives(light_and_picture)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_gradient_of_the_picture_in_the_light(small: TransportRelighter, sky):
    """Environment pixels → light vector → terms → picture, with rotation and scale."""
    view = small.view()
    resampling = latlong.area_resampling(4, 8, METHOD.resolution)

    def picture(pixels, rotate_y, scale):
        light = encode(pixels, rotate_y, scale, resampling, small.transport.basis)
        return small.shade_terms(small.terms(light), view)

    arguments = sky, np.array(10.0), np.array(1.5)
    everything = check_derivatives(picture, arguments)
    # The picture is linear in pixels and scale, so it is its own derivative.
    value, along, _ = everything(arguments, (0 * sky, np.array(0.0), np.array(1.5)), np.zeros((*view.shape, 3)))
    assert value.dtype == np.float64
    np.testing.assert_allclose(along, value, rtol=1e-6, atol=1e-9)


def _single(tree):
    return jax.tree.map(np.float32, tree)


@pytest.mark.parametrize("of", ["light vector", "picture"])
def test_gradients_in_the_light_in_float32(small: TransportRelighter, lit, sky, of):
    """As it is used: linear in pixels and scale, and in the rotation within a pixel's 45°."""
    generator, pixels = np.random.default_rng(0), _single(sky)
    shapes = (6 * METHOD.resolution**2, 3), (*small.view().shape, 3)
    weights = [_single(generator.normal(size=shape)) for shape in shapes]
    number = ["light vector", "picture"].index(of)
    cotangent = tuple(part * np.float32(i == number) for i, part in enumerate(weights))

    def value(*point) -> float:
        return float(np.vdot(weights[number], lit(_single(point), _single(point), cotangent)[0][number]))

    def slopes(point, direction) -> list[float]:
        """In a direction, and as the gradients' product with it."""
        _, along, gradients = lit(_single(point), _single(direction), cotangent)
        products = [np.vdot(gradient, step) for gradient, step in zip(gradients, direction, strict=True)]
        return [float(np.vdot(weights[number], along[number])), float(sum(products))]

    for low, high in (((10.0, 1.5), (30.0, 1.5)), ((10.0, 1.5), (10.0, 3.5))):
        step, middle = np.subtract(high, low), np.add(high, low) / 2
        wanted = value(pixels, *high) - value(pixels, *low)
        for slope in slopes((pixels, *middle), (0 * pixels, *step)):
            assert slope == pytest.approx(wanted, rel=1e-3)
    other = generator.normal(size=pixels.shape)
    for slope in slopes((pixels, 10.0, 1.5), (other, 0.0, 0.0)):
        assert slope == pytest.approx(value(other, 10.0, 1.5), rel=1e-3)


def test_gradients_are_finite_at_the_extremes(small: TransportRelighter, lit):
    """A black map, and one bright texel: of the sum of squares of the picture."""
    light = np.zeros((6 * METHOD.resolution**2, 3), np.float32)
    black = np.zeros((*small.view().shape, 3), np.float32)
    spike = np.zeros((4, 8, 3), np.float32)
    spike[1, 3] = 1e5
    for pixels in (np.zeros((4, 8, 3), np.float32), spike):
        point = _single((pixels, 0.0, 1.0))
        (_, picture), _, _ = lit(point, point, (light, black))
        _, _, gradients = lit(point, point, (light, 2 * np.asarray(picture)))
        assert np.isfinite(np.sum(np.square(picture)))
        assert all(np.isfinite(gradient).all() for gradient in gradients)


@pytest.mark.usefixtures("x64")
def test_gradient_of_the_picture_in_the_materials(small: TransportRelighter):
    """Lobe parameters where the view is fixed, factor maps where it is free, by baking again.

    Radiance of a diffuse surface is proportional to its albedo: its derivative is the picture itself.
    """
    view, transport = small.view(), small.transport
    light = np.random.default_rng(6).gamma(0.5, size=(6 * METHOD.resolution**2, 3))
    gloss, number = (number_of(transport, name) for name in ("gloss", "paper"))
    old, paper = (transport.blocks[i].reflection for i in (gloss, number))
    assert isinstance(paper, Factored)
    parameters: Any = old.brdf if isinstance(old, FixedView) else old
    assert isinstance(parameters, LobeSum | Factored)
    parameters = jax.tree.map(lambda x: np.asarray(x, float), parameters)

    def picture(parameters, albedo):
        reflections = reflections_of(transport)
        reflections[gloss] = FixedView(parameters, old.omega_o) if isinstance(old, FixedView) else parameters
        reflections[number] = Factored(paper.light_maps, albedo * paper.view_maps)
        changed = TransportRelighter(rebake(transport, reflections))
        return changed.shade_terms(changed.terms(jnp.asarray(light)), view)

    arguments = parameters, np.array(1.0)
    everything = check_derivatives(picture, arguments)
    still, nothing = jax.tree.map(np.zeros_like, parameters), np.zeros((*view.shape, 3))
    value, along, _ = everything(arguments, (parameters, np.array(0.0)), nothing)
    assert value.dtype == np.float64
    assert float(np.abs(along).max()) > 0.01
    _, along, _ = everything(arguments, (still, np.array(1.0)), nothing)
    names = [material.name for material in small.materials]
    (part,) = (part for part in view.surfaces.parts if names[part.material] == "paper")
    on_paper = np.zeros(view.shape, bool)
    # Padding names a pixel beyond the last.
    pixel = np.asarray(part.pixels.pixel)
    on_paper.ravel()[pixel[pixel < on_paper.size]] = 1
    assert on_paper.sum() > 5
    np.testing.assert_allclose(np.asarray(along)[on_paper], np.asarray(value)[on_paper], rtol=1e-6, atol=1e-9)
    assert not np.asarray(along)[~on_paper].any()


# What is compiled once stays compiled.


@contextlib.contextmanager
def _compiled():
    """Counts what JAX traces and compiles meanwhile, in a list that grows."""
    events = []

    def listen(event: str, *_, **__):
        if event.startswith("/jax/core/compile/"):
            events.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield events
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def test_nothing_is_traced_again_for_other_light_or_view(scene, made):
    relighter = open_transport(made)
    sky, picture = scene.lights.environment, relighter.picture

    first = picture(sky, scene.camera)
    noise = jr.environment(np.random.default_rng(0).random(sky.pixels.shape))
    turned = sky.with_(rotate_y=37.5, scale=0.5)
    aside = dataclasses.replace(scene.camera, origin=(-0.9, 1.2, 2.5), fov_y=50.0)
    with _compiled() as events:
        pictures = [picture(noise, scene.camera), picture(turned, scene.camera), picture(sky, aside)]
        assert events == []
        assert all(_relative(other, first) > 0.01 for other in pictures)
        assert np.sum(relighter.view(aside).surfaces.covered) != np.sum(relighter.view().surfaces.covered)
        picture(sky, dataclasses.replace(scene.camera, width=30))
        assert events, "the count does not show a new shape"


def test_baking_is_compiled_once_for_materials_of_a_kind(scene, made, tmp_path):
    """Materials are arguments of the programs that bake them: a changed one compiles nothing."""
    changed = {**scene.materials, "stone": jr.lambert(0.9), "floor": jr.lambert([0.1, 0.2, 0.3])}
    shutil.copytree(made, tmp_path / "store")
    precompute(dataclasses.replace(scene, materials={**changed, "stone": jr.lambert(0.8)}), METHOD, tmp_path / "a")
    with _compiled() as events:
        summary = precompute(dataclasses.replace(scene, materials=changed), METHOD, tmp_path / "store")
    assert summary.rays == 0
    assert events == []


def test_a_material_may_have_its_own_number_of_terms(tmp_path):
    scene = dataclasses.replace(_small_scene(), factors={"paper": Factoring(5), "gloss": Factoring(2)})
    precompute(scene, dataclasses.replace(METHOD, terms=3), tmp_path)
    terms = {block.material: block.reflection.terms for block in load_transport(tmp_path).blocks}
    assert terms == {"paper": 1, "gloss": 2}


@pytest.mark.parametrize(
    "change",
    [
        {"camera": None},
        {"materials": []},
        {"method": {"name": "transport", "dials": {"unknown": 1}}},
        {"method": {"name": "adaptive", "dials": {}}},
        {"method": {"name": "unknown", "dials": {}}},
        {"materials": [{"name": "x", "brdf": {"kind": "unknown", "arrays": {}}, "factors": None}] * 2},
    ],
)
def test_a_damaged_header_is_one_line(copy, change):
    header = json.loads((copy / "store.json").read_text())
    (copy / "store.json").write_text(json.dumps({**header, **change}))
    with pytest.raises(jr.InputError, match="precompute") as caught:
        load(str(copy))
    assert "\n" not in str(caught.value)


def test_the_scenes_own_camera_is_the_stores(scene, made_pixels):
    assert precompute(scene, PIXELS, str(made_pixels)).rays == 0
    relighter = open_transport(str(made_pixels))
    assert np.asarray(relighter.view(scene.camera).surfaces.covered).any()


def test_a_part_of_an_unknown_material_is_refused(tmp_path):
    scene = dataclasses.replace(_small_scene(), materials={})
    with pytest.raises(jr.InputError, match=r"paper|gloss"):
        precompute(scene, METHOD, tmp_path)


def test_rays_of_pure_shading_normals_are_others():
    mesh = jr.sphere(0.5, 4)
    keys = set()
    for pure in (False, True):
        part = jr.Part(dataclasses.replace(mesh, pure_normals=pure), "grey")
        scene = jr.Scene([part], {"grey": jr.lambert(0.5)}, jr.Camera((0, 0, 3), (0, 0, 0)))
        keys.add(geometry_keys(scene, scene.surfaces()))
    assert len({rays for rays, _ in keys}) == 2
