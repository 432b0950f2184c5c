"""Materials from pictures: exact where pictures are linear, found from wrong starts, named where nothing tells them."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
from jaxrelight.brdf.material import textured_lambert
from jaxrelight.brdf.texture import Texture
from jaxrelight.inverse.material_unknowns import Unknown, unknowns_of
from jaxrelight.inverse.solve_materials import InverseMaterials, materials
from tests.scenes import ball_over_floor

CAMERA = jr.Camera((0.4, 1.0, 2.0), (0, 0.3, 0), fov_y=45, width=16, height=12)
ABOVE = jr.Camera((0.2, 2.4, 0.3), (0, 0.0, 0), fov_y=45, width=24, height=18)
SKY = jr.environment((0.3 + np.random.default_rng(0).random((16, 32, 3))).astype(np.float32))
LIGHTS = jr.Lights(SKY, (jr.point([1, 2, 1], [3.0, 2, 1]),))
START = {"gloss": jr.phong(0.3, 0.2, 5.0), "paper": jr.lambert(0.5)}
TRUE = {"gloss": jr.phong([0.2, 0.1, 0.05], [0.5, 0.4, 0.3], 20.0), "paper": jr.lambert([0.7, 0.6, 0.4])}
LAFORTUNE = jr.lobe_sum([0.2, 0.15, 0.1], [jr.lobe([-1.0, -1.0, 0.9], 18, peak=[0.9, 0.7, 0.5])])
METHOD = jr.Transport(resolution=8, coefficients=64)


def scene(given=START, camera=CAMERA, lights=LIGHTS) -> jr.Scene:
    return ball_over_floor(given["gloss"], camera, lights, paper=given["paper"], quads=(4, 6))


def picture(relighter: jr.Relighter, given, lights=LIGHTS, view=None) -> np.ndarray:
    changed = relighter.with_materials(given)
    return np.asarray(changed.shade(changed.light(lights), view or relighter.view()).radiance)


def lobes_of(found: InverseMaterials, name: str) -> jr.LobeSum:
    brdf = found.materials[name]
    assert isinstance(brdf, jr.LobeSum)
    return brdf


@pytest.fixture(scope="module")
def relighter(tmp_path_factory) -> jr.Relighter:
    return jr.prepare(scene(), METHOD, tmp_path_factory.mktemp("materials"))


@pytest.fixture(scope="module")
def solved(relighter) -> InverseMaterials:
    return materials(relighter, [picture(relighter, TRUE)], lights=LIGHTS, unknowns=START)


@pytest.mark.slow
def test_an_exponent_is_found_from_a_wrong_start(solved):
    assert solved.converged
    assert solved.undetermined == ()
    assert solved.residual < 1e-6
    assert solved.held_out is not None
    assert solved.held_out < 1e-6
    gloss, paper = lobes_of(solved, "gloss"), lobes_of(solved, "paper")
    np.testing.assert_allclose(gloss.exponent, 20, rtol=1e-4)
    np.testing.assert_allclose(gloss.scale, TRUE["gloss"].scale, rtol=1e-4)
    np.testing.assert_allclose(paper.diffuse, [0.7, 0.6, 0.4], rtol=1e-5)
    np.testing.assert_allclose(solved.estimates["gloss.specular"].value, [[0.5, 0.4, 0.3]], rtol=1e-4)
    assert "what surfaces hide" in solved.held


@pytest.mark.slow
def test_an_albedo_is_exact_at_once(relighter):
    """The picture is linear in it, whatever else there is; saturated channels and masked pixels are not looked at."""
    image = picture(relighter, {"paper": jr.lambert([0.7, 0.0, 0.4])})
    mask = np.ones(image.shape[:2], bool)
    mask[:3] = False
    spoilt = np.where(mask[..., None], image, 1e3)
    top = float(np.quantile(image, 0.97))
    given = {"lights": LIGHTS, "unknowns": {"paper": jr.lambert(0.5)}, "masks": [mask], "saturation": top}
    found = materials(relighter, [np.minimum(spoilt, top)], **given)
    assert found.saturated > 0
    assert found.steps <= 2
    assert found.pixels < 3 * mask.sum()
    np.testing.assert_allclose(lobes_of(found, "paper").diffuse, [0.7, 0, 0.4], atol=2e-6)


@pytest.mark.slow
def test_what_no_picture_tells_is_named(relighter):
    """A material that is masked out everywhere, and the strength of lights where all colours are sought."""
    image = picture(relighter, TRUE)
    on_gloss = np.zeros(image.shape[:2], bool)
    part = next(p for p in relighter.view().surfaces.parts if relighter.materials[p.material].name == "gloss")
    pixel = np.asarray(part.pixels.pixel)
    on_gloss.ravel()[pixel[pixel < on_gloss.size]] = True
    found = materials(relighter, [image], lights=LIGHTS, unknowns=START, masks=[~on_gloss], light_scale=True)
    assert found.undetermined == ("gloss.diffuse", "gloss.exponent", "gloss.specular")
    assert found.light_scale is None
    assert any("only as products" in note for note in found.notes)
    assert not found.estimates["gloss.exponent"].determined.any()
    assert np.isinf(found.estimates["gloss.exponent"].high).all()
    # What is not told is what was started from.
    np.testing.assert_allclose(lobes_of(found, "gloss").exponent, 5.0, rtol=1e-5)
    np.testing.assert_allclose(lobes_of(found, "paper").diffuse, [0.7, 0.6, 0.4], rtol=1e-4)


@pytest.mark.slow
def test_a_known_material_tells_how_strong_lights_are(relighter):
    prepared = relighter.with_materials({"gloss": TRUE["gloss"]})
    image = 1.7 * picture(relighter, TRUE)
    found = materials(prepared, [image], lights=LIGHTS, unknowns={"paper": START["paper"]}, light_scale=True)
    assert found.notes == ()
    assert found.light_scale is not None
    assert found.light_scale.determined
    assert float(found.light_scale.value) == pytest.approx(1.7, rel=1e-4)
    np.testing.assert_allclose(lobes_of(found, "paper").diffuse, [0.7, 0.6, 0.4], rtol=1e-4)


@pytest.mark.slow
def test_intervals_follow_the_noise(relighter):
    """Twice the noise is twice as wide, whether deviations are given or told by the residual."""
    image = picture(relighter, TRUE)
    widths = []
    for noise in (0.005, 0.01):
        sigma = noise * image + 1e-4
        noisy = image + sigma * np.random.default_rng(0).normal(size=image.shape)
        found = materials(relighter, [noisy], lights=LIGHTS, unknowns=START, deviations=[sigma])
        widths.append(found.estimates["gloss.exponent"].width.item())
        assert found.estimates["gloss.exponent"].low < 20 < found.estimates["gloss.exponent"].high
    assert widths[1] == pytest.approx(2 * widths[0], rel=0.2)


def test_coordinates_and_materials_are_each_others_inverse():
    """Of every kind of parameter."""
    free = ("diffuse", "specular", "exponent", "C")
    unknowns = unknowns_of({"gloss": Unknown(LAFORTUNE, free), "paper": jr.lambert([0.5, 0.2, 0.1])})
    made = unknowns.materials(unknowns.start())
    for name, start in (("gloss", LAFORTUNE), ("paper", jr.lambert([0.5, 0.2, 0.1]))):
        brdf = made[name].components[0].brdf
        for one, other in zip(jax.tree.leaves(brdf), jax.tree.leaves(start), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


@pytest.mark.usefixtures("wrong_types")
def test_bad_unknowns_are_one_line_each(relighter):
    image, sought = picture(relighter, START), {"paper": jr.lambert(0.5)}

    def solve(unknowns=sought, pictures=(image,), **given):
        return materials(relighter, list(pictures), lights=LIGHTS, unknowns=unknowns, **given)

    wrong = {
        "no material is unknown": lambda: solve({}),
        "no surface has a material 'wood'": lambda: solve({"wood": jr.lambert(0.5)}),
        "'exponent' is no parameter of this material; free are some of albedo": lambda: Unknown(
            jr.lambert(0.5), ("exponent",)
        ),
        "starts from one sum of lobes": lambda: solve({"paper": jr.ashikhmin_shirley(0.1, 0.2, 9.0, 9.0)}),
        "at least one free parameter": lambda: Unknown(jr.lambert(0.5), ()),
        "'exponent' cannot be a texture": lambda: Unknown(START["gloss"], textures={"exponent": (2, 2)}),
        "starts from an entry that is 0": lambda: solve(
            {"gloss": Unknown(jr.lobe_sum(0.1, [jr.lobe([0, -1, 1], 9, peak=1)]), ("C",))}
        ),
        "picture 1 has the shape": lambda: solve(pictures=[image[:4]]),
        "not finite; leave them out by a mask": lambda: solve(pictures=[np.full_like(image, np.nan)]),
        "no pixel of the pictures is left": lambda: solve(masks=[np.zeros(image.shape[:2], bool)]),
        "there are no pictures": lambda: solve(pictures=[]),
        "2 views were given for 1 pictures": lambda: solve(views=[CAMERA, CAMERA]),
        "2 lights were given for 1 pictures": lambda: materials(
            relighter, [image], lights=[LIGHTS, LIGHTS], unknowns=sought
        ),
        "standard deviations of picture 1 must be above 0": lambda: solve(deviations=[0.0]),
        "held out is 1": lambda: solve(hold_out=1.0),
        "smoothness is -1": lambda: solve(smoothness=-1.0),
    }
    for message, call in wrong.items():
        with pytest.raises(InputError, match=message) as caught:
            call()
        assert len(str(caught.value).splitlines()) == 1


@pytest.mark.slow
def test_a_texture_under_a_shadow(tmp_path):
    """Every texel that is seen; those under the ball are counted."""
    v, u = np.mgrid[:8, :8] / 8
    true = np.stack([0.5 + 0.3 * np.sin(6.28 * u), 0.4 + 0.2 * np.cos(6.28 * v), 0.3 + 0 * u], axis=-1)
    flat = textured_lambert(Texture(jax.device_put(np.full((8, 8, 3), 0.5, np.float32))))
    given = {"gloss": jr.lambert(0.5), "paper": flat}
    relighter = jr.prepare(scene(given, ABOVE), jr.Transport(resolution=8, coefficients=64), tmp_path)
    textured = textured_lambert(Texture(jax.device_put(true.astype(np.float32))).minified())
    image = picture(relighter, {"paper": textured})
    unknown = Unknown(jr.lambert(0.5), textures={"albedo": (8, 8)})
    found = materials(relighter, [image], lights=LIGHTS, unknowns={"paper": unknown}, smoothness=1e-6)
    estimate = found.estimates["paper.albedo"]
    seen = estimate.determined.all(axis=-1)
    assert seen.sum() > 40
    assert found.residual < 1e-3
    error = np.linalg.norm((estimate.value - true)[seen]) / np.linalg.norm(true[seen])
    assert error < 0.01
    missing = 64 - seen.sum()
    assert found.undetermined == (() if not missing else (f"paper.albedo: {missing} of 64 texels",))


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        jr.Transport("vertices", receiver_tolerance=0, resolution=8, coefficients=64),
        jr.Transport(
            "vertices", receiver_tolerance=0, resolution=8, reflection="factors", factor_resolution=16, terms=6
        ),
        jr.Indirect(gather_samples=256, bounces=2, sky_samples=8),
        jr.Prefiltered(map_rows=32, receiver_tolerance=0),
    ],
    ids=["filtered", "factors", "indirect", "prefiltered"],
)
def test_the_same_by_other_methods(method, tmp_path):
    relighter = jr.prepare(scene(), method, tmp_path if method.is_stored else None)
    found = materials(relighter, [picture(relighter, TRUE)], lights=LIGHTS, unknowns=START)
    assert found.residual < 1e-4
    np.testing.assert_allclose(lobes_of(found, "gloss").exponent, 20, rtol=0.01)
    np.testing.assert_allclose(lobes_of(found, "paper").diffuse, [0.7, 0.6, 0.4], rtol=1e-3)


@pytest.mark.slow
def test_eight_numbers_of_a_lafortune_lobe(tmp_path):
    """From one noisy picture: within three deviations of the truth, each told to a few percent."""
    given = {"gloss": LAFORTUNE, "paper": jr.lambert(0.5)}
    camera = dataclasses.replace(CAMERA, width=32, height=24)
    relighter = jr.prepare(scene(given, camera), METHOD, tmp_path)
    image = picture(relighter, given)
    sigma = 0.01 * image + 1e-4
    noisy = image + sigma * np.random.default_rng(3).normal(size=image.shape)
    start = jr.lobe_sum(0.3, [jr.lobe([-1, -1, 0.7], 6, peak=0.4)])
    unknown = Unknown(start, ("diffuse", "specular", "exponent", "C"))
    found = materials(relighter, [noisy], lights=LIGHTS, unknowns={"gloss": unknown}, deviations=[sigma])
    wanted = {"diffuse": [0.2, 0.15, 0.1], "exponent": [[18.0]], "C": [[[0.9]]]}
    wanted["specular"] = np.array([[0.9, 0.7, 0.5]]) * 2 * np.pi / 20
    assert sum(np.size(values) for values in wanted.values()) == 8
    for name, values in wanted.items():
        estimate = found.estimates[f"gloss.{name}"]
        assert (np.abs(estimate.value - values) < 3.5 * estimate.deviation).all()
        assert (estimate.width < 0.2).all()
    assert found.undetermined == ()
