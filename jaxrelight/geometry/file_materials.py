"""What mesh files say about materials: colours, images and exponents, before anything is made of them."""

import dataclasses
import pathlib
from typing import Literal

# An image file, or the bytes of one.
PictureSource = pathlib.Path | bytes
# What is beyond the edges of an image, to the left and right, and above and below.
Wrap = Literal["repeat", "clamp", "mirror"]


@dataclasses.dataclass(frozen=True)
class FilePicture:
    """An image and how a file puts it on a surface.

    Attributes:
        source: the image.
        uv_set: number of the set of texture coordinates that it follows, counted from 0.
        placement: the rows of the 2×3 matrix that takes (u, v, 1), v upwards, to the place in the image; None where it
            is (u, v) itself..
        wrap: what is beyond the edges, along u and along v.
    """

    source: PictureSource
    uv_set: int = 0
    placement: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclasses.dataclass
class FileMaterial:
    """A material as a file describes it, in terms of diffuse/π + specular·(n + 2)/(2π)·max(0, cos α)ⁿ.

    Attributes:
        diffuse: linear, multiplied by the picture where there is one.
        specular: the same.
        exponent: n.
        diffuse_picture: sRGB colours.
        specular_picture: sRGB colours.
        normal_picture: tangent-space normals as (n + 1)/2.
        bump_picture: the same, or heights, which its colours tell.
        normal_scale: what multiplies x and y of the normals before they are of unit length.
        emission: linear radiance in all directions; may exceed 1.
        emission_picture: sRGB colours that multiply it, or None.
        tints_specular: whether the colours of vertices multiply the specular colour, too, as they do on metals. They
            always multiply the diffuse colour.
        two_sided: whether the back is a surface, too.
        notes: what was approximated or left out.
    """

    diffuse: tuple[float, float, float] = (0.5, 0.5, 0.5)
    specular: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exponent: float = 0.0
    diffuse_picture: FilePicture | None = None
    specular_picture: FilePicture | None = None
    normal_picture: FilePicture | None = None
    bump_picture: FilePicture | None = None
    normal_scale: float = 1.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emission_picture: FilePicture | None = None
    tints_specular: bool = False
    two_sided: bool = False
    notes: list[str] = dataclasses.field(default_factory=list)


def metallic_roughness(
    base: tuple[float, float, float], metallic: float, roughness: float, picture: FilePicture | None
) -> FileMaterial:
    """A Phong material in place of glTF's microfacets.

    Metals reflect their base colour, others 4 %. A lobe as wide as roughness r makes it has the exponent
    n = (1/r⁴ − 1)/2, that of Blinn's for α = r² divided by four, as cos α varies four times as fast as the half
    vector's. Below 1 it is as good as diffuse, and taken as such.
    """
    exponent = (1 / max(roughness, 0.05) ** 4 - 1) / 2
    textured = picture is not None
    if exponent < 1:
        colour = tuple(c * (1 - metallic) + c * metallic + 0.04 * (1 - metallic) * (1 - c) for c in base)
        return FileMaterial(colour, diffuse_picture=picture)  # pyright: ignore[reportArgumentType]
    diffuse = tuple(c * (1 - metallic) * 0.96 for c in base)
    # A textured metal's highlights have its colour; the small share of other surfaces' is white.
    specular = tuple(c * metallic + (0 if textured and metallic > 0.5 else 0.04 * (1 - metallic)) for c in base)
    return FileMaterial(
        diffuse,  # pyright: ignore[reportArgumentType]
        specular,  # pyright: ignore[reportArgumentType]
        exponent,
        diffuse_picture=picture,
        specular_picture=picture if metallic > 0.5 else None,
    )
