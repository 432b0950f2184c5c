"""Materials and textures of glTF files, as what mesh files say about materials."""

import dataclasses
from typing import Any

import numpy as np

from jaxrelight.geometry.file_materials import FileMaterial, FilePicture, Glossiness, Microfacets, Wrap, as_colour
from jaxrelight.geometry.gltf_content import Content

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_NEAREST = {9728, 9984, 9986}
# Kinds of images that extensions of textures bring, and whether they are read.
_SOURCES = {"EXT_texture_webp": True, "EXT_texture_avif": False, "KHR_texture_basisu": False}
_READ = {
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_unlit",
}


def uv_set_of(texture: dict) -> int:
    """Number of the set of texture coordinates that a texture follows."""
    moved = texture.get("extensions", {}).get("KHR_texture_transform", {})
    return int(moved.get("texCoord", texture.get("texCoord", 0)))


def uv_sets_of(material: dict) -> set[int]:
    """Numbers of all sets of texture coordinates that a material follows."""
    pbr, other = material.get("pbrMetallicRoughness", {}), _extension(material, "KHR_materials_pbrSpecularGlossiness")
    every = [pbr.get("baseColorTexture"), other.get("diffuseTexture"), other.get("specularGlossinessTexture")]
    every += [pbr.get("metallicRoughnessTexture"), material.get("normalTexture")]
    return {uv_set_of(texture) for texture in every if texture is not None}


def read_material(content: Content, entry: dict) -> FileMaterial:
    """A material, with notes of what was approximated or left out."""
    material = FileMaterial(two_sided=bool(entry.get("doubleSided", False)))
    notes = material.notes
    shaded = _glossiness if "KHR_materials_pbrSpecularGlossiness" in entry.get("extensions", {}) else _microfacets
    material = shaded(content, entry, notes).applied_to(material)
    normal = entry.get("normalTexture")
    material.normal_picture = read_texture(content, normal, notes)
    material.normal_scale = float((normal or {}).get("scale", 1))
    strength = float(_extension(entry, "KHR_materials_emissive_strength").get("emissiveStrength", 1))
    material.emission = as_colour([max(strength * float(c), 0.0) for c in entry.get("emissiveFactor", [0, 0, 0])])
    if any(material.emission):
        material.emission_picture = read_texture(content, entry.get("emissiveTexture"), notes)
    if "KHR_materials_unlit" in entry.get("extensions", {}):
        material = _unlit(content, entry, material)
    mode = str(entry.get("alphaMode", "OPAQUE"))
    if mode != "OPAQUE":
        what = "its alpha mask (alphaMode MASK)" if mode == "MASK" else "transparency (alphaMode BLEND)"
        notes.append(f"{what} is left out; it is opaque")
    if entry.get("occlusionTexture") is not None:
        notes.append("its occlusion texture is left out: occlusion is computed")
    left_out = sorted(name[:40] for name in map(str, entry.get("extensions", {})) if name not in _READ)
    if left_out:
        notes.append(f"extensions are left out: {', '.join(left_out)}")
    material.notes = list(dict.fromkeys(notes))
    return material


def _extension(entry: dict, name: str) -> dict:
    return entry.get("extensions", {}).get(name, {})


def _share(value: Any) -> float:
    """A number from 0 to 1."""
    return min(max(float(value), 0.0), 1.0)


def _colour(values: Any) -> tuple[float, float, float]:
    return as_colour([_share(c) for c in values[:3]])


def _microfacets(content: Content, entry: dict, notes: list[str]) -> Microfacets:
    pbr = entry.get("pbrMetallicRoughness", {})
    index = float(_extension(entry, "KHR_materials_ior").get("ior", 1.5))
    normal = 1.0 if index == 0 else ((index - 1) / (index + 1)) ** 2
    specular = _extension(entry, "KHR_materials_specular")
    strength = _share(specular.get("specularFactor", 1))
    if any(name in specular for name in ("specularTexture", "specularColorTexture")):
        notes.append("textures of KHR_materials_specular are left out, its factors hold everywhere")
    reflectance = [_share(strength * _share(normal * float(c))) for c in specular.get("specularColorFactor", [1, 1, 1])]
    return Microfacets(
        _colour(pbr.get("baseColorFactor", [1, 1, 1])),
        _share(pbr.get("metallicFactor", 1)),
        _share(pbr.get("roughnessFactor", 1)),
        read_texture(content, pbr.get("baseColorTexture"), notes),
        read_texture(content, pbr.get("metallicRoughnessTexture"), notes),
        as_colour(reflectance),
    )


def _glossiness(content: Content, entry: dict, notes: list[str]) -> Glossiness:
    look = _extension(entry, "KHR_materials_pbrSpecularGlossiness")
    return Glossiness(
        _colour(look.get("diffuseFactor", [1, 1, 1])),
        _colour(look.get("specularFactor", [1, 1, 1])),
        _share(look.get("glossinessFactor", 1)),
        read_texture(content, look.get("diffuseTexture"), notes),
        read_texture(content, look.get("specularGlossinessTexture"), notes),
    )


def _unlit(content: Content, entry: dict, material: FileMaterial) -> FileMaterial:
    """A surface that is of its base colour in any light."""
    pbr, notes = entry.get("pbrMetallicRoughness", {}), material.notes
    base = _colour(pbr.get("baseColorFactor", [1, 1, 1]))
    picture = read_texture(content, pbr.get("baseColorTexture"), notes)
    plain = {"specular": (0.0, 0.0, 0.0), "exponent": 0.0, "specular_picture": None, "microfacets": None}
    plain |= {"normal_picture": None, "unlit": True, "diffuse": base, "diffuse_picture": picture}
    return dataclasses.replace(material, **plain)


def read_texture(content: Content, texture: dict | None, notes: list[str]) -> FilePicture | None:
    """The image of a texture and how it lies on surfaces; None for none, or of a kind that is not read."""
    if texture is None:
        return None
    entry = content.entries("textures")[texture["index"]]
    source, unread = entry.get("source"), []
    for name, extension in entry.get("extensions", {}).items():
        if _SOURCES.get(name):
            source = extension["source"]
        else:
            unread.append(str(name)[:40])
    if unread:
        instead = "; its other image is taken" if source is not None else ""
        notes.append(f"a texture of the extension {', '.join(unread)} is left out{instead}")
    if source is None:
        if not unread:
            notes.append("a texture without an image is left out")
        return None
    sampler = content.entries("samplers")[entry["sampler"]] if "sampler" in entry else {}
    across = _WRAPS.get(sampler.get("wrapS", 10497), "repeat")
    upwards = _WRAPS.get(sampler.get("wrapT", 10497), "repeat")
    if sampler.get("magFilter") in _NEAREST:
        notes.append("a texture's texels are interpolated, though the file asks for the nearest one")
    image = content.entries("images")[source]
    if "uri" not in image:
        picture = content.image_bytes(image["bufferView"])
    else:
        uri = str(image["uri"])
        picture = content.read_bytes(uri, "image") if uri[:5].lower() == "data:" else content.path(uri)
    return FilePicture(picture, uv_set_of(texture), _placement(texture), (across, upwards))


def _placement(texture: dict) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
    """The matrix of KHR_texture_transform for v that counts upwards.

    It scales, then turns, then moves (u, v) with v downwards: u' = u cos + v sin, v' = v cos − u sin. The extension's
    own listing turns the other way; its example, the sample models and other programs turn this way.
    """
    moved = _extension(texture, "KHR_texture_transform")
    if not any(name in moved for name in ("offset", "rotation", "scale")):
        return None
    (x, y), (wide, high) = moved.get("offset", [0, 0]), moved.get("scale", [1, 1])
    c, s = np.cos(float(moved.get("rotation", 0))), np.sin(float(moved.get("rotation", 0)))
    down = np.array([[c * wide, s * high, x], [-s * wide, c * high, y], [0, 0, 1]], float)
    if not np.isfinite(down).all():
        raise ValueError("a texture's transform is not finite")
    flip = np.array([[1.0, 0, 0], [0, -1, 1], [0, 0, 1]])
    (a, b, e), (d, f, g), _ = (flip @ down @ flip).tolist()
    return (a, b, e), (d, f, g)
