"""What mesh files say about materials, as materials: textures in their places, vertex colours, emission."""

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Material, as_material
from jaxrelight.brdf.texture import Texture, VertexColours, look_up
from jaxrelight.geometry.file_materials import FileMaterial, FilePicture
from jaxrelight.geometry.mesh import load_parts
from jaxrelight.scene.materials import from_file
from tests.geometry.gltf_writer import Gltf
from tests.shared_data import shared

TRIANGLE, UV = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0], [1, 0], [0, 1]]
# Red, green over blue, yellow.
CORNERS = np.array([[[200, 50, 50], [50, 200, 50]], [[50, 50, 200], [200, 200, 50]]], np.uint8)


def _encoded(pixels: np.ndarray, kind: str = "PNG") -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **({"lossless": True} if kind == "WEBP" else {}))
    return file.getvalue()


def _linear(bytes_: Any) -> np.ndarray:
    x = np.asarray(bytes_, float) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def _material(
    folder, material: dict, *pictures: bytes, attributes=None, sampler=None, webp=False
) -> tuple[Material, list[str]]:
    """The material of a triangle in a glTF file with textures of pictures, and its notes."""
    gltf = Gltf()
    gltf.json["images"] = [{"bufferView": gltf.view(data)} for data in pictures]
    textures: list[dict] = [{"source": number} for number in range(len(pictures))]
    if webp:
        textures = [{"extensions": {"EXT_texture_webp": {"source": 0}}}]
    if sampler:
        gltf.json["samplers"] = [sampler]
        textures[0]["sampler"] = 0
    gltf.json["textures"] = textures
    gltf.json["materials"] = [material]
    attributes = {"TEXCOORD_0": UV} if attributes is None else attributes
    accessors = {name: gltf.accessor(rows) for name, rows in attributes.items()}
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE, attributes=accessors, material=0)}]
    (folder / "it.glb").write_bytes(gltf.glb())
    (part,) = load_parts(folder / "it.glb")
    surface, notes = from_file(part.material, part.uv_sets, coloured=part.mesh.colours is not None)
    return as_material(surface), notes


def _rough(**more) -> dict:
    return {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1, **more}}


def _texture(material: Material, component: int = 0) -> Texture:
    texture = material.components[component].weight[0]
    assert isinstance(texture, Texture)
    return texture


def _emitted(material: Material) -> np.ndarray:
    assert material.emission is not None
    return np.asarray(material.emission)


def _down(texture: Texture, u: float, v: float) -> np.ndarray:
    """What a texture shows at (u, v) as a glTF file counts v."""
    return np.asarray(texture.look_up(np.array([u, 1 - v], np.float32)))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("transform", "u", "v", "wanted"),
    [
        ({"offset": [0.5, 0]}, 0.25, 0.25, CORNERS[0, 1]),
        ({"scale": [0.5, 0.5], "offset": [0, 0.5]}, 0.5, 0.5, CORNERS[1, 0]),
        # The example of the extension: the lower left quarter, turned clockwise by 90°; u' = v/2, v' = 1 − u/2.
        ({"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}, 0.5, 0.5, CORNERS[1, 0]),
        ({"rotation": np.pi / 2}, 0.25, 0.75, CORNERS[1, 1]),  # u' = v, v' = −u, which repeats
        ({"rotation": np.pi / 2, "scale": [1, 2]}, 0.25, 0.125, CORNERS[1, 0]),  # scaled before it is turned: u' = 2 v
        ({"offset": [0, 1], "scale": [1, -1]}, 0.25, 0.25, CORNERS[1, 0]),
    ],
)
def test_texture_transforms(tmp_path, transform, u, v, wanted):
    look = _rough(baseColorTexture={"index": 0, "extensions": {"KHR_texture_transform": transform}})
    material, notes = _material(tmp_path, look, _encoded(CORNERS))
    factor = 0.04 + 0.96 * 1  # as rough as can be: gloss is diffuse, and of the textured colour
    np.testing.assert_allclose(_down(_texture(material), u, v), factor * _linear(wanted), atol=1e-5)
    assert notes == []


def test_a_transform_may_name_another_set(tmp_path):
    info = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 2, "offset": [0.5, 0]}}}
    attributes = {f"TEXCOORD_{i}": UV for i in range(3)}
    material, _ = _material(tmp_path, _rough(baseColorTexture=info), _encoded(CORNERS), attributes=attributes)
    assert _texture(material).uv_set == 2
    assert material.uv_sets == {2}


def test_each_texture_has_a_set_of_its_own(tmp_path):
    look = _rough(baseColorTexture={"index": 0, "texCoord": 1}) | {"normalTexture": {"index": 0, "scale": 0.5}}
    attributes = {"TEXCOORD_0": UV, "TEXCOORD_1": UV}
    material, notes = _material(tmp_path, look, _encoded(CORNERS), attributes=attributes)
    assert _texture(material).uv_set == 1
    assert material.normal_map is not None
    assert material.normal_map.uv_set == 0
    scaled = np.array([0.5, 0.5, 0]) + np.array([0.5, 0.5, 1]) * (CORNERS / 255 - np.array([0.5, 0.5, 0]))
    np.testing.assert_allclose(material.normal_map.pixels, scaled, atol=1e-6)
    assert notes == []


@pytest.mark.parametrize(
    ("wrap", "u", "wanted"),
    [
        (33071, 1.9, CORNERS[0, 1]),
        (33071, -0.9, CORNERS[0, 0]),
        (33648, 1.25, CORNERS[0, 1]),
        (10497, 1.25, CORNERS[0, 0]),
    ],
)
def test_wrap_modes(tmp_path, wrap, u, wanted):
    look = _rough(baseColorTexture={"index": 0})
    material, _ = _material(tmp_path, look, _encoded(CORNERS), sampler={"wrapS": wrap, "wrapT": 33071})
    np.testing.assert_allclose(_down(_texture(material), u, -0.5), _linear(wanted), atol=1e-5)


def test_webp_and_other_kinds_of_images(tmp_path):
    look = _rough(baseColorTexture={"index": 0})
    material, notes = _material(tmp_path, look, _encoded(CORNERS, "WEBP"), webp=True)
    np.testing.assert_allclose(_texture(material).pixels, _linear(CORNERS), atol=1e-6)
    assert notes == []
    _, notes = _material(tmp_path, look, b"RIFF1234WEBPnothing", webp=True)
    assert any("cannot be" in note or "WebP" in note for note in notes)
    assert all("\n" not in note for note in notes)


def test_images_of_kinds_that_are_not_read(tmp_path):
    gltf = Gltf()
    gltf.json["images"] = [{"bufferView": gltf.view(_encoded(CORNERS))}, {"uri": "it.ktx2"}]
    basis = {"KHR_texture_basisu": {"source": 1}}
    gltf.json["textures"] = [{"extensions": basis}, {"extensions": {"EXT_texture_avif": {"source": 1}}, "source": 0}]
    gltf.json["materials"] = [_rough(baseColorTexture={"index": number}) for number in (0, 1)]
    nodes = [gltf.mesh(TRIANGLE, uv=UV, material=number) for number in (0, 1)]
    gltf.json["nodes"] = [{"mesh": number, "translation": [0, 0, number]} for number in nodes]
    gltf.json["extensionsUsed"] = ["KHR_texture_basisu", "EXT_texture_avif"]
    (tmp_path / "it.glb").write_bytes(gltf.glb())
    without, instead = (part.material for part in load_parts(tmp_path / "it.glb"))
    assert without is not None
    assert instead is not None
    assert without.notes == ["a texture of the extension KHR_texture_basisu is left out"]
    assert instead.notes == ["a texture of the extension EXT_texture_avif is left out; its other image is taken"]
    assert without.diffuse_picture is None
    assert instead.diffuse_picture is not None


@pytest.mark.parametrize("name", ["my tex.png", "50%.png", "straße.png", "sub\\it.png"])
def test_percent_encoded_names(tmp_path, name):
    (tmp_path / "sub").mkdir()
    path = tmp_path / name.replace("\\", "/")
    path.write_bytes(_encoded(CORNERS))
    gltf = Gltf()
    encoded = {"my tex.png": "my%20tex.png", "straße.png": "stra%C3%9Fe.png"}.get(name, name)
    gltf.json |= {"images": [{"uri": encoded}], "textures": [{"source": 0}]}
    gltf.json["materials"] = [_rough(baseColorTexture={"index": 0})]
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE, uv=UV, material=0)}]
    (tmp_path / "it.glb").write_bytes(gltf.glb())
    (part,) = load_parts(tmp_path / "it.glb")
    surface, notes = from_file(part.material, part.uv_sets)
    np.testing.assert_allclose(_texture(as_material(surface)).pixels, _linear(CORNERS), atol=1e-6)
    assert notes == []


def test_vertex_colours_multiply_the_base_colour(tmp_path):
    look = _rough(baseColorFactor=[0.5, 1, 1, 1])
    material, notes = _material(tmp_path, look, attributes={"COLOR_0": [[0.5, 0.25, 0.1]] * 3})
    (component,) = material.components
    assert isinstance(component.weight[1], VertexColours)
    assert material.needs_colours
    assert not material.needs_uv
    np.testing.assert_allclose(component.weight[0].mean, [0.52, 1, 1], atol=1e-6)
    assert notes == []
    metal = {"pbrMetallicRoughness": {"roughnessFactor": 0.3}}
    material, _ = _material(tmp_path, metal, attributes={"COLOR_0": [[0.5, 0.25, 0.1]] * 3})
    assert all(isinstance(component.weight[-1], VertexColours) for component in material.components)
    gloss = {"pbrMetallicRoughness": {"roughnessFactor": 0.3, "metallicFactor": 0}}
    material, _ = _material(tmp_path, gloss, attributes={"COLOR_0": [[0.5, 0.25, 0.1]] * 3})
    assert len(material.components[1].weight) == 1  # the gloss of dielectrics is white


def test_emission(tmp_path):
    strength = {"extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 3}}}
    material, notes = _material(tmp_path, _rough() | {"emissiveFactor": [1, 0.5, 0]} | strength)
    np.testing.assert_allclose(_emitted(material), [3, 1.5, 0])
    assert notes == []
    look = _rough() | {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}}
    material, notes = _material(tmp_path, look, _encoded(CORNERS))
    np.testing.assert_allclose(_emitted(material), _linear(CORNERS).mean(axis=(0, 1)), rtol=1e-5)
    assert notes == ["its emission varies by a texture; the mean is taken everywhere"]
    material, notes = _material(tmp_path, _rough() | {"emissiveTexture": {"index": 0}}, _encoded(CORNERS))
    assert material.emission is None


def test_unlit_is_emitted_where_it_is_one_colour(tmp_path):
    look = {"pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.6, 1]}, "extensions": {"KHR_materials_unlit": {}}}
    material, notes = _material(tmp_path, look)
    np.testing.assert_allclose(_emitted(material), [0.2, 0.4, 0.6], rtol=1e-6)
    assert "unlit" in notes[0]
    look["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    material, notes = _material(tmp_path, look, _encoded(CORNERS))
    assert material.emission is None
    np.testing.assert_allclose(_texture(material).pixels, _linear(CORNERS) * [0.2, 0.4, 0.6], rtol=1e-5)
    assert "taken as a diffuse surface" in notes[0]


def _glossy(**look) -> dict:
    return {"extensions": {"KHR_materials_pbrSpecularGlossiness": look}}


def test_specular_and_glossiness(tmp_path):
    """The diffuse colour is what the specular one leaves; as rough a lobe as metals of 1 − glossiness have."""
    look = _glossy(diffuseFactor=[0.5, 0.1, 0.1, 1], specularFactor=[0.2, 0.1, 0], glossinessFactor=0.8)
    material, notes = _material(tmp_path, look)
    (component,) = material.components
    lobes = component.brdf
    assert isinstance(lobes, LobeSum)
    np.testing.assert_allclose(lobes.diffuse, 0.8 * np.array([0.5, 0.1, 0.1]), rtol=1e-6)
    np.testing.assert_allclose(lobes.exponent, (1 / 0.2**4 - 1) / 2, rtol=1e-5)
    assert notes == []
    pixels = np.concatenate([CORNERS, np.full((2, 2, 1), 128, np.uint8)], axis=2)
    textures = {"diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 1}}
    look = _glossy(specularFactor=[0.5] * 3, **textures)
    material, notes = _material(tmp_path, look, _encoded(CORNERS), _encoded(pixels))
    _, specular = material.components
    np.testing.assert_allclose(_texture(material).pixels, 0.5 * _linear(CORNERS), rtol=1e-5)
    np.testing.assert_allclose(_texture(material, 1).pixels, 0.5 * _linear(CORNERS), rtol=1e-5)
    assert isinstance(specular.brdf, LobeSum)
    np.testing.assert_allclose(specular.brdf.exponent, (1 / (127 / 255) ** 4 - 1) / 2, rtol=1e-4)
    assert notes == ["its texture of glossiness counts by its mean, 0.50 everywhere"]


def test_textures_of_roughness_count_by_their_means(tmp_path):
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[..., 1], pixels[..., 2] = 102, 128  # 0.4 rough, and half a metal
    look = {"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}, "metallicFactor": 0.5}}
    material, notes = _material(tmp_path, look, _encoded(pixels))
    lobes = material.components[0].brdf
    assert isinstance(lobes, LobeSum)
    np.testing.assert_allclose(lobes.exponent, (1 / 0.4**4 - 1) / 2, rtol=1e-4)
    np.testing.assert_allclose(lobes.diffuse, [(1 - 64 / 255) * 0.96] * 3, rtol=1e-5)
    assert notes == ["its texture of metalness and roughness counts by its means, 0.25 and 0.40 everywhere"]


def test_metalness_that_differs_is_a_texture(tmp_path):
    """Left half metal: there the base colour shines; the right half is diffuse, with four hundredths of gloss."""
    pixels = np.full((2, 2, 3), 102, np.uint8)
    pixels[:, 0, 2], pixels[:, 1, 2] = 255, 0
    info = {"index": 0, "texCoord": 1}
    look = {"pbrMetallicRoughness": {"metallicRoughnessTexture": info, "baseColorTexture": {"index": 1}}}
    attributes = {"TEXCOORD_0": UV, "TEXCOORD_1": UV}
    material, notes = _material(tmp_path, look, _encoded(pixels), _encoded(CORNERS), attributes=attributes)
    assert notes == ["its texture of roughness counts by its mean, 0.40 everywhere"]
    assert material.uv_sets == {0, 1}
    for u, metal, colour in ((0.25, 1, CORNERS[0, 0]), (0.75, 0, CORNERS[0, 1])):
        at = np.array([u, 0.75, u, 0.75, 1], np.float32)
        diffuse, shine, gloss = (look_up(component.weight, at) for component in material.components)  # pyright: ignore
        np.testing.assert_allclose(diffuse, 0.96 * (1 - metal) * _linear(colour), atol=1e-5)
        np.testing.assert_allclose(shine, metal * _linear(colour), atol=1e-5)
        np.testing.assert_allclose(gloss, [0.04 * (1 - metal)] * 3, atol=1e-6)
    del look["pbrMetallicRoughness"]["baseColorTexture"]
    material, notes = _material(tmp_path, look, _encoded(pixels), attributes={"TEXCOORD_0": UV})
    assert not material.needs_uv
    assert "0.50 and 0.40 everywhere" in notes[0]


def test_indices_of_refraction_and_specular_colours(tmp_path):
    extensions = {"KHR_materials_ior": {"ior": 2}, "KHR_materials_specular": {"specularColorFactor": [1, 0.5, 0]}}
    look = {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.3, "baseColorFactor": [0, 0, 0, 1]}}
    material, notes = _material(tmp_path, look | {"extensions": extensions})
    lobes = material.components[0].brdf
    assert isinstance(lobes, LobeSum)
    np.testing.assert_allclose(lobes.normal_albedo / lobes.normal_albedo[0], [1, 0.5, 0], atol=1e-6)
    assert notes == []


def test_what_materials_leave_out_is_told(tmp_path):
    look = _rough() | {"alphaMode": "MASK", "extensions": {"KHR_materials_clearcoat": {}}}
    _, notes = _material(tmp_path, look | {"occlusionTexture": {"index": 0}}, _encoded(CORNERS))
    assert notes == [
        "its alpha mask (alphaMode MASK) is left out; it is opaque",
        "its occlusion texture is left out: occlusion is computed",
        "extensions are left out: KHR_materials_clearcoat",
    ]


def test_textures_without_coordinates_leave_the_plain_colour(tmp_path):
    look = _rough(baseColorFactor=[0.5, 0.5, 0.5, 1], baseColorTexture={"index": 0}) | {"normalTexture": {"index": 0}}
    material, notes = _material(tmp_path, look, _encoded(CORNERS), attributes={})
    assert not material.needs_uv
    lobes = material.components[0].brdf
    assert isinstance(lobes, LobeSum)
    np.testing.assert_allclose(lobes.diffuse, [0.52] * 3, rtol=1e-6)
    assert notes == [
        "the mesh has no texture coordinates, which its texture needs; taken without it",
        "the mesh has no texture coordinates, which its normal map needs; taken without it",
    ]
    look = _rough(baseColorTexture={"index": 0, "texCoord": 1})
    material, notes = _material(tmp_path, look, _encoded(CORNERS))
    assert notes == ["the mesh has no texture coordinates of set 1, which its texture needs; taken without it"]


@pytest.mark.parametrize("case", ["g02_textransform", "g03_gltfpack", "v3_clamp"])
def test_reported_files(case):
    (part,) = load_parts(shared("data", "reported", case, "q.gltf"))
    surface, notes = from_file(part.material, part.uv_sets)
    assert notes == []
    assert part.mesh.uv is not None
    texture, (x, y) = _texture(as_material(surface)), part.mesh.vertices[:, :2].T
    seen = {}
    for name, at in {"left": (-0.6, 0.6), "right": (0.6, 0.6), "below": (-0.6, -0.6)}.items():
        # Coordinates are affine in x and y there.
        plane = np.linalg.lstsq(np.column_stack([x, y, np.ones_like(x)]), part.mesh.uv, rcond=None)[0]
        seen[name] = np.asarray(texture.look_up(np.array([*at, 1.0]) @ plane)).argmax()  # pyright: ignore
    wanted = {"g02_textransform": (1, 1, 1), "g03_gltfpack": (0, 1, 2), "v3_clamp": (0, 2, 0)}[case]
    assert (seen["left"], seen["right"], seen["below"]) == wanted


@pytest.mark.parametrize(
    ("colour", "is_map"),
    [
        ((191, 166, 231), True),
        ((128, 128, 255), True),
        ((90, 90, 90), False),
        ((201, 201, 201), False),
        ((128, 128, 200), False),
    ],
)
def test_bump_maps_are_normal_maps_where_their_colours_are_normals(colour, is_map: bool):
    pixels = np.tile(np.array(colour, np.uint8), (4, 4, 1))
    material, notes = from_file(FileMaterial(bump_picture=FilePicture(_encoded(pixels)), normal_scale=0.5))
    bumps = as_material(material).normal_map
    assert (bumps is not None) == is_map
    assert notes == ([] if is_map else ["its bump map of heights is left out; give a normal_map"])
    if bumps is not None:
        wanted = pixels[0, 0] / 255 * [0.5, 0.5, 1] + [0.25, 0.25, 0]
        np.testing.assert_allclose(np.asarray(bumps.pixels)[0, 0], wanted, atol=1e-6)
