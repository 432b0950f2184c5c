"""Materials that vary over the surface: linear in their parts, sharp at the view, differentiable, not baked again."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

import jaxrelight as jr
from jaxrelight import Part, Scene
from jaxrelight.basis import cubemap
from jaxrelight.brdf.material import Component, Material, as_material, textured_lambert, textured_phong, white_lambert
from jaxrelight.brdf.packed_texture import PackedTexture
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture, VertexColours, constant
from jaxrelight.geometry import mesh as meshes
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.methods import Transport
from jaxrelight.precomputation.precompute import precompute
from tests.operators.derivatives import derivatives
from tests.shared_data import shared
from tests.transport.stores import block_of, load_transport, number_of, open_transport

LIGHT = np.random.default_rng(6).gamma(0.4, size=(6 * 8**2, 3)).astype(np.float32)
PIXELS = np.random.default_rng(7).random((6, 9, 3)).astype(np.float32)
TEXTURE = Texture(jax.device_put(PIXELS))
METHOD = Transport(
    "vertices",
    receiver_tolerance=0,
    reflection="factors",
    resolution=8,
    terms=2,
    coefficients="all",
    factor_resolution=12,
)


def _scene(paper, gloss=None) -> Scene:
    up = np.eye(4)
    up[1, 3] = 0.3
    block = meshes.transformed(jr.box((0.5, 0.4, 0.6), 2), up)
    parts = [Part(jr.plane((2, 2), 4), "paper"), Part(block, "gloss")]
    camera = jr.Camera((0.5, 1.4, 2.0), (0, 0.1, 0), fov_y=50, width=20, height=16)
    return Scene(parts, {"paper": paper, "gloss": gloss or jr.phong(0.2, 0.4, 6.0)}, camera)


def _open(scene: Scene, folder, receivers: str = "vertices") -> TransportRelighter:
    method = dataclasses.replace(METHOD, receivers=receivers)
    return open_transport(precompute(scene, method, folder).folder)


def _picture(scene: Scene, folder, receivers: str = "vertices") -> np.ndarray:
    relighter = _open(scene, folder, receivers)
    return np.asarray(relighter.shade_terms(relighter.terms(LIGHT), relighter.view()))


@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
def test_a_texture_of_one_colour_is_that_colour(tmp_path, receivers):
    colours = np.array([0.7, 0.6, 0.5]), np.array([0.2, 0.3, 0.1]), np.array([0.5, 0.4, 0.3])

    def flat(colour):
        return Texture(jax.device_put(np.tile(colour.astype(np.float32), (3, 4, 1))))

    plain = _scene(jr.lambert(colours[0]), jr.lambert(colours[1]))
    textured = _scene(textured_lambert(flat(colours[0])), textured_lambert(flat(colours[1])))
    if receivers == "pixels":  # the factors of a sum are not the sum of factors
        plain = _scene(jr.lambert(colours[0]), jr.phong(colours[1], colours[2], 6.0))
        textured = _scene(textured_lambert(flat(colours[0])), textured_phong(flat(colours[1]), flat(colours[2]), 6.0))
    wanted = _picture(plain, tmp_path, receivers)
    assert wanted.max() > 0.1
    np.testing.assert_allclose(_picture(textured, tmp_path, receivers), wanted, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("receivers", ["vertices", pytest.param("pixels", marks=pytest.mark.slow)])
def test_pictures_are_linear_in_the_parts_of_a_mixture(tmp_path, receivers):
    rust, paint = jr.phong([0.3, 0.1, 0.0], 0.2, 3.0), jr.lambert([0.1, 0.2, 0.6])
    mask = Texture(jax.device_put(PIXELS[..., :1]))
    mixed = Material((Component(rust, (mask,)), Component(paint, (constant([0.5, 0.25, 2]), TEXTURE))))

    def alone(part):
        return _picture(_scene(Material((part,)), jr.lambert(0)), tmp_path, receivers)

    wanted = sum(alone(part) for part in mixed.components)
    image = _picture(_scene(mixed, jr.lambert(0)), tmp_path, receivers)
    np.testing.assert_allclose(image, wanted, rtol=1e-5, atol=1e-6)


def test_a_texture_is_stored_apart_from_grey_transport_and_changing_it_bakes_nothing(tmp_path):
    method = dataclasses.replace(METHOD, coefficients=32)

    def layers(kind):
        return {path.name for path in tmp_path.glob(f"{kind}-*")}

    precompute(_scene(textured_lambert(TEXTURE)), method, tmp_path)
    before = {kind: layers(kind) for kind in ("geometry", "visibility", "transport", "factors", "texture")}
    other = textured_lambert(Texture(jax.device_put(PIXELS[::-1])))
    assert precompute(_scene(other), method, tmp_path).rays == 0
    assert {kind: layers(kind) for kind in before if kind != "texture"} == {
        kind: names for kind, names in before.items() if kind != "texture"
    }
    assert len(layers("texture")) == len(before["texture"]) + 1 == 2
    transport = load_transport(tmp_path)
    paper = block_of(transport, "paper")
    assert paper.operator.shape[2] == 1
    assert isinstance(paper.weight[0], PackedTexture)
    np.testing.assert_array_equal(paper.weight[0].texels[: PIXELS[..., 0].size], PIXELS[::-1].reshape(-1, 3))


@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
def test_gradients_of_textures_at_the_view(tmp_path, receivers):
    """The picture is linear in a texture: its derivative along any direction is the picture of that direction."""
    relighter = _open(_scene(textured_lambert(TEXTURE)), tmp_path, receivers)
    terms, view = relighter.terms(LIGHT), relighter.view()
    number, blocks = number_of(relighter.transport, "paper"), relighter.transport.blocks
    aim, along = (np.random.default_rng(seed).random(shape) for seed, shape in ((8, (16, 20, 3)), (9, PIXELS.shape)))
    along = along.astype(np.float32)

    def loss(pixels):
        weights = tuple((Texture(pixels),) if i == number else block.weight for i, block in enumerate(blocks))
        return jnp.sum(aim.astype(np.float32) * relighter.shade_terms(terms, view, weights))

    everything = derivatives(loss)
    value, slope, (gradient,) = everything((PIXELS,), (along,), np.float32(1))
    wanted = everything((PIXELS + along,), (along,), np.float32(1))[0] - value
    assert abs(wanted) > 1
    np.testing.assert_allclose(np.vdot(gradient, along), wanted, rtol=1e-4)
    np.testing.assert_allclose(slope, wanted, rtol=1e-4)


def test_a_textured_material_needs_texture_coordinates(tmp_path):
    scene = _scene(textured_lambert(TEXTURE))
    bare = dataclasses.replace(scene.parts[0].mesh, uv=None)
    with pytest.raises(jr.InputError, match="has no texture coordinates, which its material 'paper' needs"):
        precompute(dataclasses.replace(scene, parts=[Part(bare, "paper")]), METHOD, tmp_path)


def test_a_mesh_without_texture_coordinates_has_the_mean_colour_of_its_material():
    scene = _scene(Material(textured_lambert(TEXTURE).components, Texture(jnp.ones((2, 2, 3)))))
    textured = scene.parts[0]
    bare = Part(dataclasses.replace(textured.mesh, uv=None), "paper", "bare")
    plain = dataclasses.replace(scene, parts=[bare]).with_plain_materials()
    plain.check_materials()
    material = as_material(plain.materials["paper"])
    assert material.normal_map is None
    np.testing.assert_allclose(material.components[0].weight[0].mean, PIXELS.mean(axis=(0, 1)), rtol=1e-5)
    note = "'bare': no texture coordinates, which the material 'paper' needs; its mean colour is taken"
    assert note in plain.notes
    both = dataclasses.replace(scene, parts=[textured, bare]).with_plain_materials()
    assert both.parts[0].material == "paper"
    assert both.materials["paper"] is scene.materials["paper"]
    assert both.parts[1].material == "paper without textures"
    assert note in both.notes


def test_texels_of_their_own_need_texture_coordinates(tmp_path):
    maps = SpatialLobes(*(jnp.ones((2, 2, *shape)) for shape in ((3,), (1, 3), (1,), (1, 3), (2,))))
    scene = _scene(Material((Component(maps),)))
    bare = dataclasses.replace(scene.parts[0].mesh, uv=None)
    bare_scene = dataclasses.replace(scene, parts=[Part(bare, "paper")]).with_plain_materials()
    with pytest.raises(jr.InputError, match="has no texture coordinates, which its material 'paper' needs"):
        precompute(bare_scene, METHOD, tmp_path)


@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
def test_textures_are_placed_and_vertices_have_colours(tmp_path, receivers):
    """On the second set, turned, mirrored, and times a colour: the same as a plain texture on placed coordinates."""
    plain = _scene(textured_lambert(Texture(jnp.asarray(0.5 * PIXELS), wrap=("mirror", "repeat"))))
    flat = plain.parts[0].mesh
    assert flat.uv is not None
    placed = 3 * np.column_stack([flat.uv[:, 1], -flat.uv[:, 0]])
    mesh = dataclasses.replace(flat, uv=np.concatenate([flat.uv, flat.uv], 1), colours=np.full((len(flat.uv), 3), 0.5))
    placement = jnp.asarray([[0.0, 3, 0], [-3, 0, 0]])
    weight = Texture(TEXTURE.pixels, placement=placement, uv_set=1, wrap=("mirror", "repeat")), VertexColours()
    other = _scene(Material((Component(white_lambert(), weight),)))
    parts = [Part(dataclasses.replace(flat, uv=placed), "paper"), plain.parts[1]]
    wanted = _picture(dataclasses.replace(plain, parts=parts), tmp_path / "plain", receivers)
    parts = [Part(mesh, "paper"), plain.parts[1]]
    got = _picture(dataclasses.replace(other, parts=parts), tmp_path / "placed", receivers)
    np.testing.assert_allclose(got, wanted, atol=2e-4 * wanted.max())
    assert wanted.max() > 0.1


def test_vertex_colours_need_a_mesh_that_has_them(tmp_path):
    scene = _scene(Material((Component(white_lambert(), (VertexColours(),)),)))
    with pytest.raises(jr.InputError, match="have no colours, which its material 'paper' needs"):
        precompute(scene, METHOD, tmp_path)


def _brute_force(mesh, pixels, camera, resolution: int, light):
    """Radiance of a textured Lambert mesh, ray by ray and sum by sum in NumPy, and where it is seen."""
    surfaces = join([mesh])
    tracer = Tracer(surfaces)
    rays = camera.directions().reshape(-1, 3)
    origin = np.broadcast_to(surfaces.to_scene(np.array(camera.origin)), rays.shape)
    face, weight = tracer.first_hits(origin, rays)
    directions, angles = cubemap.directions(resolution), cubemap.solid_angles(resolution)
    out = np.zeros((len(rays), 3))
    h, w, _ = pixels.shape
    for i in np.flatnonzero(face >= 0):
        corners = mesh.faces[face[i]]
        normal = weight[i] @ mesh.normals[corners]
        normal /= np.linalg.norm(normal)
        point = weight[i] @ surfaces.vertices[corners] + OFFSET * surfaces.face_normals(face[i : i + 1])[0]
        cosine = directions @ normal
        above = cosine > 0
        free = ~tracer.occluded(np.broadcast_to(point, directions[above].shape), directions[above])
        irradiance = (light[above] * (cosine * angles)[above, None] * free[:, None]).sum(axis=0)
        u, v = weight[i] @ mesh.uv[corners]
        place = [[(1 - v) * h - 0.5], [u * w - 0.5]]
        albedo = [ndimage.map_coordinates(pixels[..., c], place, order=1, mode="grid-wrap")[0] for c in range(3)]
        out[i] = np.array(albedo) * irradiance / np.pi if normal @ -rays[i] > 0 else 0
    return out.reshape(camera.height, camera.width, 3)


def test_spot_with_its_texture_against_brute_force(tmp_path):
    mesh = meshes.normalized(jr.load_mesh(shared("data", "mesh", "spot.obj")), 1.0)
    # Rays of the brute force start on faces.
    mesh = dataclasses.replace(mesh, pure_normals=True)
    pixels = jr.read_image(shared("data", "mesh", "spot_texture.png"))[..., :3]
    # Texels no smaller than pixels, which are what one looks up.
    pixels = pixels.reshape(32, pixels.shape[0] // 32, 32, -1, 3).mean(axis=(1, 3))
    camera = jr.Camera((0.5, 0.7, -2.6), (0, 0.45, 0), fov_y=8, width=12, height=12)
    scene = Scene([Part(mesh, "cow")], {"cow": textured_lambert(Texture(jax.device_put(pixels)))}, camera)
    relighter = _open(scene, tmp_path, "pixels")
    image = np.asarray(relighter.shade_terms(relighter.terms(LIGHT), relighter.view()))
    wanted = _brute_force(mesh, pixels, camera, METHOD.resolution, LIGHT.astype(float))
    assert (wanted.max(axis=-1) > 0).mean() > 0.3
    # A ray in a hundred thousand may fall on the other side of an edge.
    np.testing.assert_allclose(np.linalg.norm(image - wanted) / np.linalg.norm(wanted), 0, atol=1e-3)


# Two-sided surfaces.


@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
@pytest.mark.parametrize("height", [2.0, -2.0])
def test_white_furnace_of_both_sides(tmp_path, receivers, height):
    sheet = dataclasses.replace(jr.plane((2, 2), 4), two_sided=True)
    camera = jr.Camera((0.1, height, 0.3), (0, 0, 0), fov_y=30, width=8, height=8)
    method = dataclasses.replace(METHOD, receivers=receivers, resolution=32)
    scene = Scene([Part(sheet, "white")], {"white": white_lambert()}, camera)
    relighter = open_transport(precompute(scene, method, tmp_path).folder)
    view = relighter.view()
    assert np.asarray(view.surfaces.covered).all()
    image = relighter.shade_terms(relighter.terms(np.ones((6 * 32**2, 3), np.float32)), view)
    np.testing.assert_allclose(image, 1, atol=1e-3)
    assert len(relighter.transport.surfaces.faces) == len(sheet.faces)


@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
def test_the_back_is_the_front_of_the_sheet_turned_over(tmp_path, receivers):
    camera = jr.Camera((0.4, -1.5, 1.3), (0, 0, 0), fov_y=40, width=16, height=12)
    sheet, gloss = jr.plane((2, 2), 6), {"gloss": jr.phong(0.2, 0.5, 8.0)}
    over = meshes.Mesh(sheet.vertices, sheet.faces[:, ::-1], -sheet.normals)
    block = Part(meshes.transformed(jr.box((0.3, 0.3, 0.3), 2), _down()), "gloss")
    sides = dataclasses.replace(sheet, two_sided=True), over, sheet
    both, back, front = (
        _picture(Scene([Part(mesh, "gloss"), block], gloss, camera), tmp_path / str(i), receivers)
        for i, mesh in enumerate(sides)
    )
    np.testing.assert_allclose(both, back, rtol=1e-4, atol=1e-5)
    assert np.abs(both - front).max() > 0.01


def _down() -> np.ndarray:
    matrix = np.eye(4)
    matrix[1, 3] = -0.4
    return matrix
