"""Materials whose colours are images: from scene files, and from what mesh files say."""

import pathlib
import tempfile

import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf import lobes
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import Component, Material, as_material, textured_lambert, textured_phong
from jaxrelight.brdf.texture import Texture, constant, look_up
from jaxrelight.errors import InputError
from jaxrelight.geometry.file_materials import FileMaterial, PictureSource
from jaxrelight.numerics.arrays import as_array

GREY = lobes.lambert(0.5)


def read_texture(picture: PictureSource, *, data: bool = False) -> Texture:
    """An image as linear colours; as the numbers that stand in it where it is `data`: a mask, or normals.

    Raises:
        InputError: if it cannot be read, or has pixels that are negative or not finite.
    """
    from jaxrelight.images import read_image
    from jaxrelight.images.tone import srgb_encode

    if isinstance(picture, bytes):
        suffix = ".png" if picture[:4] == b"\x89PNG" else ".jpg"
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / f"embedded{suffix}"
            path.write_bytes(picture)
            return read_texture(path, data=data)
    pixels = read_image(picture)[..., :3]
    if not (np.isfinite(pixels).all() and (pixels >= 0).all()):
        raise InputError(f"{picture}: a texture needs pixels that are finite and not negative; repair the image")
    if data and picture.suffix.lower() in (".png", ".jpg", ".jpeg"):
        pixels = srgb_encode(pixels)
    return Texture(as_array(pixels, jnp.float32)).minified()


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


def from_file(described: FileMaterial | None) -> tuple[Brdf | Material, list[str]]:
    """What a mesh file describes, as a material, and what was approximated or left out. Grey where it says nothing.

    Colours that add up to more than 1 are scaled down: such a surface would make light. An image that cannot be read
    leaves its plain colour.
    """
    if described is None:
        return GREY, []
    notes = list(described.notes)
    pictures: list[Texture | None] = []
    for picture, data in (
        (described.diffuse_picture, False),
        (described.specular_picture, False),
        (described.normal_picture, True),
    ):
        try:
            pictures.append(None if picture is None else read_texture(picture.source, data=data))
        except InputError as error:
            notes.append(f"{error} (taken without it)")
            pictures.append(None)
    diffuse, specular, bumps = pictures
    total = np.add(described.diffuse, described.specular)
    scale = 1 / max(1.0, float(total.max()))
    if scale < 0.999:
        notes.append(f"diffuse and specular add up to {total.max():.2g}, scaled down to 1")
    colour, shine = scale * np.array(described.diffuse), scale * np.array(described.specular)
    glossy = bool(np.any(shine > 0))
    if diffuse is None and specular is None:
        surface: Brdf | Material = lobes.phong(colour, shine, described.exponent) if glossy else lobes.lambert(colour)
    else:
        albedo = _tinted(diffuse, colour)
        surface = textured_lambert(albedo)
        if glossy:
            surface = textured_phong(albedo, _tinted(specular, shine), described.exponent)
    if bumps is not None:
        surface = Material(as_material(surface).components, bumps)
    return surface, notes


def _tinted(image: Texture | None, colour: np.ndarray) -> Texture:
    """An image times a colour; the colour alone without one."""
    return constant(colour) if image is None else Texture(image.pixels * as_array(colour, jnp.float32)).minified()
