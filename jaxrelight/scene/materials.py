"""Materials whose colours are images: from scene files, and from what mesh files say."""

import dataclasses
from collections.abc import Collection

import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf import lobes
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import Component, Material, as_material, white_lambert, white_phong
from jaxrelight.brdf.normal_maps import is_normal_map
from jaxrelight.brdf.texture import Texture, VertexColours, constant, look_up
from jaxrelight.errors import InputError
from jaxrelight.geometry.file_materials import FileMaterial, FilePicture, Microfacets, PictureSource
from jaxrelight.numerics.arrays import as_array

GREY = lobes.lambert(0.5)
# Metalness whose standard deviation over a texture is smaller is the same everywhere.
_SAME_METALNESS = 0.02


def read_texture(picture: PictureSource, *, data: bool = False) -> Texture:
    """An image as linear colours; as the numbers that stand in it where it is `data`: a mask, or normals.

    Raises:
        InputError: if it cannot be read, or has pixels that are negative or not finite.
    """
    return _as_texture(_open(picture, data=data)[0])


def _as_texture(pixels: np.ndarray) -> Texture:
    return Texture(as_array(pixels[..., :3], jnp.float32)).minified()


def _open(picture: PictureSource, *, data: bool = False) -> tuple[np.ndarray, tuple[str, ...]]:
    """Pixels as `read_texture` has them, with alpha where there is any, and what was assumed of the image."""
    from jaxrelight.images import decode_image, open_image

    if isinstance(picture, bytes):
        name, image = "an embedded image", decode_image(picture, "an embedded image", stored=data)
    else:
        name, image = f"{picture}", open_image(picture, stored=data)
    if not (np.isfinite(image.pixels).all() and (image.pixels >= 0).all()):
        raise InputError(f"{name}: a texture needs pixels that are finite and not negative; repair the image")
    return image.pixels, image.notes


def weighted(surface: Brdf | Material, weight: Texture) -> tuple[Component, ...]:
    """The components of a material, all multiplied by a weight."""
    return tuple(Component(part.brdf, (*part.weight, weight)) for part in as_material(surface).components)


def made_light(surface: Brdf | Material) -> float:
    """How much of the light along the normal a material reflects, in the channel where it is most; 0 if not known.

    Known is that of sums of lobes whose weights are constant.
    """
    total = np.zeros(1)
    for part in as_material(surface).components:
        if not isinstance(part.brdf, lobes.LobeSum) or not all(texture.is_constant for texture in part.weight):
            return 0.0
        total = total + np.asarray(look_up(part.weight, jnp.zeros(2)) * part.brdf.normal_albedo)
    return float(total.max())


def from_file(
    described: FileMaterial | None, uv_sets: Collection[int] = (0,), *, coloured: bool = False
) -> tuple[Brdf | Material, list[str]]:
    """What a mesh file describes, as a material, and what was approximated or left out. Grey where it says nothing.

    Colours that add up to more than 1 are scaled down: such a surface would make light. An image that cannot be read,
    or that follows texture coordinates that the mesh does not have, leaves its plain colour.

    Args:
        described: what the file says.
        uv_sets: numbers of the sets of texture coordinates that the mesh has.
        coloured: whether its vertices have colours.
    """
    if described is None:
        return GREY, []
    described, metal, notes = _with_mean_microfacets(described, uv_sets)
    notes = [*described.notes, *notes]

    def read(picture: FilePicture | None, what: str, *, data: bool = False) -> Texture | None:
        if picture is None:
            return None
        if picture.uv_set not in uv_sets:
            of_set = f" of set {picture.uv_set}" if uv_sets else ""
            notes.append(f"the mesh has no texture coordinates{of_set}, which its {what} needs; taken without it")
            return None
        try:
            pixels, assumed = _open(picture.source, data=data)
            notes.extend(assumed)
            return place_texture(_as_texture(pixels), picture)
        except InputError as error:
            notes.append(f"{error} (taken without it)")
            return None

    diffuse, specular = read(described.diffuse_picture, "texture"), read(described.specular_picture, "specular texture")
    bumps = read(described.normal_picture, "normal map", data=True)
    if bumps is None:
        bumps = read(described.bump_picture, "bump map", data=True)
        if bumps is not None and not is_normal_map(np.asarray(bumps.pixels)):
            notes.append("its bump map of heights is left out; give a normal_map")
            bumps = None
    bumps = _scaled_normals(bumps, described.normal_scale)
    total = np.add(described.diffuse, described.specular)
    scale = 1 / max(1.0, float(total.max()))
    if scale < 0.999:
        notes.append(f"diffuse and specular add up to {total.max():.2g}, scaled down to 1")
    colour, shine = scale * np.array(described.diffuse), scale * np.array(described.specular)
    emission = _emission(described, notes)
    if described.unlit:
        # What is emitted is the same all over a part; a texture that is lit shows more than its mean would.
        if diffuse is None and not coloured:
            notes.append("is unlit (KHR_materials_unlit): its colour is taken as radiance that it emits")
            return Material((Component(lobes.lambert(0.0)),), emission=colour.astype(np.float32)), notes
        notes.append("is unlit (KHR_materials_unlit), which its texture cannot be: taken as a diffuse surface")
    glossy, tinted = bool(np.any(shine > 0)), (VertexColours(),) if coloured else ()
    if metal is not None:
        surface: Brdf | Material = _partly_metal(described, metal, diffuse, tinted)
    elif diffuse is None and specular is None and not coloured:
        surface = lobes.phong(colour, shine, described.exponent) if glossy else lobes.lambert(colour)
    else:
        parts = [Component(white_lambert(jnp.float32), (_tinted(diffuse, colour), *tinted))]
        if glossy:
            weight = _tinted(specular, shine), *(tinted if described.tints_specular else ())
            parts.append(Component(white_phong(described.exponent, jnp.float32), weight))
        surface = Material(tuple(parts))
    if bumps is not None or emission is not None:
        surface = Material(as_material(surface).components, bumps, emission)
    return surface, notes


def place_texture(texture: Texture, picture: FilePicture) -> Texture:
    """A texture as a file puts it on a surface."""
    placement = None if picture.placement is None else as_array(picture.placement, jnp.float32)
    return dataclasses.replace(texture, placement=placement, uv_set=picture.uv_set, wrap=picture.wrap)


def _with_mean_microfacets(
    described: FileMaterial, uv_sets: Collection[int]
) -> tuple[FileMaterial, Texture | None, list[str]]:
    """A material whose texture of roughness, if it has one, counts by its means.

    With it comes metalness as a texture, where it differs over the surface and a texture can be put there.
    """
    asked = described.microfacets
    if asked is None or asked.picture is None:
        return described, None, []
    try:
        pixels, notes = _open(asked.picture.source, data=True)
    except InputError as error:
        return described, None, [f"{error} (its roughness is the same everywhere)"]
    means = np.ones(4)
    means[: pixels.shape[-1]] = pixels.mean(axis=(0, 1))
    mean, note = asked.with_means(means.tolist())
    described = mean.applied_to(described)
    if not isinstance(asked, Microfacets) or not described.exponent or asked.picture.uv_set not in uv_sets:
        return described, None, [*notes, note]
    metalness = np.clip(asked.metallic * pixels[..., 2:3], 0, 1)
    if metalness.std() < _SAME_METALNESS:
        return described, None, [*notes, note]
    metal = place_texture(Texture(as_array(metalness, jnp.float32)).minified(), asked.picture)
    roughness = asked.roughness * means[1]
    return described, metal, [*notes, f"its texture of roughness counts by its mean, {roughness:.2f} everywhere"]


def _partly_metal(
    described: FileMaterial, metal: Texture, base: Texture | None, tinted: tuple[VertexColours, ...]
) -> Material:
    """A surface of metal and of other parts: what is no metal is diffuse, with a little white gloss."""
    look = described.microfacets
    assert isinstance(look, Microfacets)
    colour, other = np.array(look.base), _with_pixels(metal, 1 - np.asarray(metal.pixels))
    white, shine = white_lambert(jnp.float32), white_phong(described.exponent, jnp.float32)
    gloss = np.array(look.reflectance)
    return Material(
        (
            Component(white, (_tinted(base, colour * (1 - gloss.max())), other, *tinted)),
            Component(shine, (_tinted(base, colour), metal, *tinted)),
            Component(shine, (constant(gloss, jnp.float32), other)),
        )
    )


def _emission(described: FileMaterial, notes: list[str]) -> np.ndarray | None:
    """Radiance that is the same all over the surface; None for none."""
    radiance = np.asarray(described.emission, np.float32)
    if described.emission_picture is not None and radiance.any():
        try:
            mean = read_texture(described.emission_picture.source).mean
        except InputError as error:
            notes.append(f"{error} (emission is taken without it)")
        else:
            radiance = (radiance * mean).astype(np.float32)
            notes.append("its emission varies by a texture; the mean is taken everywhere")
    return radiance if radiance.any() else None


def _scaled_normals(bumps: Texture | None, scale: float) -> Texture | None:
    """A normal map whose x and y are multiplied before normals are of unit length."""
    if bumps is None or scale == 1:
        return bumps
    middle = np.array([0.5, 0.5, 0.0], np.float32)
    return _with_pixels(bumps, (np.asarray(bumps.pixels) - middle) * np.array([scale, scale, 1.0]) + middle)


def _tinted(image: Texture | None, colour: np.ndarray) -> Texture:
    """An image times a colour; the colour alone without one."""
    if image is None:
        return constant(colour, jnp.float32)
    return image if np.all(colour == 1) else _with_pixels(image, np.asarray(image.pixels) * colour)


def _with_pixels(texture: Texture, pixels: np.ndarray) -> Texture:
    """Another image in the place of a texture."""
    return dataclasses.replace(texture, pixels=as_array(pixels, jnp.float32), coarser=None).minified()
