"""Direct-to-indirect transfer end to end: energy, linearity, gradients, reuse, and what is refused."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Part, Scene
from jaxrelight.brdf.material import Component, Material
from jaxrelight.gather.gather_cloud import gather_cloud
from jaxrelight.lighting.indirect import IndirectRelighter
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lights.lights import LightsLike
from jaxrelight.lights.local import directional, point, spot
from jaxrelight.methods import Indirect, Transport
from jaxrelight.precomputation import cloud_layers as indirect
from jaxrelight.precomputation.precompute import precompute
from tests import scenes
from tests.gather.test_final_gather import kernel_at_parts
from tests.scenes import inside_out

SMALL = Indirect(gather_samples=256, bounces=3, compression_tolerance=0.0)
CAMERA = jr.Camera((0, 0.05, 0.4), (0.1, -0.1, -1), fov_y=70.0, width=12, height=10)
LAMP = point([0.1, 0.2, 0.05], [1.0, 0.8, 0.6])


def inside(resolution: int = 6) -> jr.Mesh:
    return inside_out(jr.box((1, 1, 1), resolution))


def room(albedo, emission=None, more: tuple[Part, ...] = (), **materials) -> Scene:
    wall = Material((Component(jr.lambert(albedo)),), emission=emission)
    return scenes.room(wall, CAMERA, 6, more, **materials)


def ball(material: str) -> Part:
    made = jr.sphere(0.2, 4)
    return Part(dataclasses.replace(made, vertices=np.add(made.vertices, [0.1, -0.25, -0.2])), material)


def opened(scene: Scene, folder, **dials) -> IndirectRelighter:
    relighter = jr.prepare(scene, dataclasses.replace(SMALL, **dials), folder)
    assert isinstance(relighter, IndirectRelighter)
    return relighter


def reflected(relighter: IndirectRelighter, lights: LightsLike, bounces: int | None = None) -> np.ndarray:
    """Radiance of the pixels by light that was reflected on its way to them."""
    return np.asarray(relighter.final_gather(relighter.light(lights, bounces).cloud, relighter.view()))


def picture(relighter: IndirectRelighter, lights: LightsLike, bounces: int | None = None) -> np.ndarray:
    """All of the light."""
    return np.asarray(relighter.shade(relighter.light(lights, bounces), relighter.view()).radiance)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("indirect") / "store"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return room([0.7, 0.6, 0.5], None, (ball("gloss"),), gloss=jr.phong(0.2, 0.5, 20.0))


@pytest.fixture(scope="module")
def relighter(scene, folder) -> IndirectRelighter:
    return opened(scene, folder)


@pytest.mark.slow
def test_a_closed_room_that_emits_is_its_series(tmp_path):
    """E (1 + ρ + … + ρ^B) from all directions."""
    relighter = opened(room([0.5, 0.4, 0.8], np.ones(3, np.float32)), tmp_path, gather_samples=4096)
    for bounces in (1, 2, 3):
        radiance = reflected(relighter, [], bounces)
        rho = np.array([0.5, 0.4, 0.8])
        wanted = (1 - rho ** (bounces + 1)) / (1 - rho)
        np.testing.assert_allclose(radiance.mean(axis=(0, 1)), wanted, rtol=0.02)
        assert np.abs(radiance / wanted - 1).max() < 0.25


def test_light_is_linear(relighter):
    lamps = LAMP, spot([-0.2, 0.3, 0], [0, -0.5, 0], 2.0, 40.0), directional([0.1, -1, 0.2], 0.5)
    each = [reflected(relighter, [lamp]) for lamp in lamps]
    together = reflected(relighter, lamps)
    np.testing.assert_allclose(together, sum(each), rtol=1e-4, atol=1e-6)
    assert all(one.max() > 0.01 for one in each[:2])
    # Nothing from outside of a closed room.
    np.testing.assert_array_equal(each[2], 0)


def test_more_bounces_are_brighter_by_less(relighter):
    none, *some = (reflected(relighter, [LAMP], bounces).sum() for bounces in range(4))
    assert none == 0
    steps = np.diff([0, *some])
    assert (steps > 0).all()
    assert (steps[1:] < 0.8 * steps[:-1]).all()


def test_what_is_gathered_is_what_the_cloud_reflects(relighter):
    """One bounce, pixel by pixel, as a sum over the points, for the diffuse walls."""
    geometry, cloud = relighter.transport.geometry, relighter.precomputed.points
    seen = geometry.visible
    assert seen is not None
    light = relighter.direct_light_at_cloud([LAMP])
    image = np.asarray(relighter.final_gather(light, relighter.view())).reshape(-1, 3)[seen.covered.reshape(-1)]
    for pixel in np.flatnonzero(seen.mesh == 0)[::7]:
        share = kernel_at_parts(cloud, geometry.tracer, seen.positions[pixel], seen.face_normals[pixel])
        np.testing.assert_allclose(image[pixel], np.array([0.7, 0.6, 0.5]) * (share @ light), rtol=0.15, atol=2e-3)


def test_codes_and_coefficients_are_near(scene, folder, relighter):
    wanted = reflected(relighter, [LAMP])
    for dials, most in (({"compression_tolerance": 0.02, "bits": 8}, 0.05), ({"coefficients": 100}, 0.1)):
        radiance = reflected(opened(scene, folder, **dials), [LAMP])
        assert 0 < np.linalg.norm(radiance - wanted) < most * np.linalg.norm(wanted)


@pytest.mark.slow
def test_gradients_in_lights_and_albedo(relighter):
    """Along a random direction, shadows held fixed, against differences."""
    random = np.random.default_rng(0)
    weights = random.uniform(size=(10, 12, 3)).astype(np.float32)
    lamp, view = spot([0.1, 0.2, 0.05], [-0.3, -0.5, 0.1], [1.0, 0.8, 0.6], 70.0, 30.0), relighter.view()

    @jax.jit
    @jax.value_and_grad
    def bright(given):
        lamp, albedo = given
        light = relighter.add_bounces(relighter.direct_light_at_cloud([lamp], albedo, shadows=False), 3, albedo)
        # What diffuse surfaces gather of the cloud its points have gathered of each other.
        return jnp.sum(weights * relighter.final_gather(light, view, "glossy"))

    given = jax.tree.map(np.asarray, (lamp, relighter.precomputed.cloud.albedo))
    _, gradient = bright(given)
    along = jax.tree.map(lambda leaf: random.normal(size=leaf.shape).astype(np.float32), given)
    step = np.float32(1e-3)
    ends = [float(bright(jax.tree.map(lambda x, a, by=by: x + by * a, given, along))[0]) for by in (step, -step)]
    slope = sum(np.sum(one * a) for one, a in zip(jax.tree.leaves(gradient), jax.tree.leaves(along), strict=True))
    assert slope == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-2)
    assert all(np.isfinite(one).all() for one in jax.tree.leaves(gradient))


def test_pictures_have_direct_light_of_several_samples(relighter):
    image = relighter.picture([LAMP])
    assert image.shape == (10, 12, 4)
    np.testing.assert_array_equal(image[..., 3], 1)
    direct = picture(relighter, [LAMP], 0)
    indirect = reflected(relighter, [LAMP])
    # Along edges pixels are means of samples that see this and that.
    off = np.abs(image[..., :3] - direct - indirect)
    assert np.median(off) < 1e-6
    assert off.mean() < 0.05 * indirect.mean()
    assert np.mean(image[..., :3] >= direct - 1e-6) == 1


def test_what_is_there_is_used_again(scene, folder, relighter):
    """Other materials gather nothing anew: what is grey is theirs, too."""
    times = {path: path.stat().st_mtime_ns for path in folder.rglob("0*")}
    made = precompute(scene, SMALL, folder)
    assert made.rays == 0
    other = room([0.1, 0.2, 0.3], None, (ball("gloss"),), gloss=jr.phong(0.2, 0.5, 20.0))
    made = precompute(other, SMALL, folder)
    assert made.rays == 0
    assert all(path.stat().st_mtime_ns == time for path, time in times.items())
    darker = reflected(opened(other, folder), [LAMP]).sum()
    assert darker < 0.5 * reflected(relighter, [LAMP]).sum()


def test_points_are_read_from_the_store_and_made_again_when_damaged(scene, folder, monkeypatch):
    made, times = [], []
    monkeypatch.setattr(
        indirect, "gather_cloud", lambda *given, **dials: made.append(1) or gather_cloud(*given, **dials)
    )
    header = precompute(scene, SMALL, folder).header
    assert not made
    (file,) = (folder / header["cloud"]).glob("0*")
    whole = file.read_bytes()
    for damaged in (whole[:-9], None):
        file.write_bytes(damaged) if damaged else file.unlink()
        assert precompute(scene, SMALL, folder).header == header
        assert file.read_bytes() == whole
        times.append(len(made))
    assert times == [1, 2]


def test_a_store_is_opened_as_what_it_was_made_for(tmp_path, scene, folder, relighter):
    again = jr.open_store(folder)
    assert isinstance(again, IndirectRelighter)
    np.testing.assert_array_equal(reflected(again, LAMP), reflected(relighter, LAMP))
    wall = Scene([Part(jr.plane((1, 1), 2), "wall")], {"wall": jr.lambert(0.5)}, jr.Camera((0, 1, 0.1), (0, 0, 0)))
    precompute(wall, Transport("vertices", receiver_tolerance=0, resolution=4), tmp_path)
    assert isinstance(jr.open_store(tmp_path), TransportRelighter)


def test_more_bounces_than_precomputed_are_refused(scene, folder):
    relighter = opened(scene, folder, bounces=1)
    reflected(relighter, [LAMP])
    with pytest.raises(InputError, match="precomputed for one bounce"):
        reflected(relighter, [LAMP], 2)


def test_only_glossy_surfaces_tell_points_apart(tmp_path):
    """Of diffuse ones, neither rays nor stores depend on how finely peaks are split."""
    made = [
        precompute(room([0.7, 0.6, 0.5]), dataclasses.replace(SMALL, bounces=1, peak=peak), tmp_path / str(peak))
        for peak in (1.0, 1e-3)
    ]
    assert made[0].rays == made[1].rays
    names = [{one.name for one in each.folder.iterdir() if one.name.startswith("indirect")} for each in made]
    assert names[0] == names[1]


def test_a_lost_group_of_one_part_of_a_material_comes_back_as_it_was(scene, folder, relighter):
    """What is gathered of a glossy material's diffuse part depends on the other, which is not lost."""
    for record in precompute(scene, SMALL, folder).header["materials"]:
        lost = max((folder / record["indirect"]).glob("0*"))
        content = lost.read_bytes()
        lost.unlink()
        precompute(scene, SMALL, folder)
        assert lost.read_bytes() == content
