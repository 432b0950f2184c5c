"""What mesh files say about materials: colours, images and exponents, before anything is made of them."""

import dataclasses
import pathlib
from collections.abc import Sequence
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


@dataclasses.dataclass(frozen=True)
class Microfacets:
    """glTF's metals and dielectrics, in whose place there is a Phong material.

    Metals reflect their base colour, others about 4 %. A lobe as wide as roughness r makes it has the exponent
    n = (1/r⁴ − 1)/2, that of Blinn's for α = r² divided by four, as cos α varies four times as fast as the half
    vector's. Below 1 it is as good as diffuse, and taken as such.

    Attributes:
        base: linear colour.
        metallic: 0 … 1.
        roughness: 0 … 1.
        base_picture: multiplies the colour.
        picture: whose green multiplies the roughness and blue the metalness.
        reflectance: of dielectrics, seen along the normal.
    """

    base: tuple[float, float, float]
    metallic: float
    roughness: float
    base_picture: FilePicture | None = None
    picture: FilePicture | None = None
    reflectance: tuple[float, float, float] = (0.04, 0.04, 0.04)

    def with_means(self, means: Sequence[float]) -> tuple["Microfacets", str]:
        """The same where the picture counts by the means of its channels, and a note that tells so."""
        mean = dataclasses.replace(self, metallic=self.metallic * means[2], roughness=self.roughness * means[1])
        numbers = f"{mean.metallic:.2f} and {mean.roughness:.2f}"
        return mean, f"its texture of metalness and roughness counts by its means, {numbers} everywhere"

    def applied_to(self, material: "FileMaterial") -> "FileMaterial":
        """A material with these colours and this exponent, and all else as it is."""
        metallic, exponent = self.metallic, exponent_of(self.roughness)
        textured = self.base_picture is not None
        if exponent < 1:
            pairs = zip(self.base, self.reflectance, strict=True)
            colour = [c * (1 - metallic) + c * metallic + f * (1 - metallic) * (1 - c) for c, f in pairs]
            diffuse, specular = colour, [0.0] * 3
        else:
            diffuse = [c * (1 - metallic) * (1 - max(self.reflectance)) for c in self.base]
            # A textured metal's highlights have its colour; the small share of other surfaces' is white.
            white = 0 if textured and metallic > 0.5 else 1 - metallic
            specular = [c * metallic + white * f for c, f in zip(self.base, self.reflectance, strict=True)]
        return dataclasses.replace(
            material,
            diffuse=as_colour(diffuse),
            specular=as_colour(specular),
            exponent=exponent if exponent >= 1 else 0.0,
            diffuse_picture=self.base_picture,
            specular_picture=self.base_picture if metallic > 0.5 and exponent >= 1 else None,
            tints_specular=metallic > 0.5,
            microfacets=self,
        )


@dataclasses.dataclass(frozen=True)
class Glossiness:
    """KHR_materials_pbrSpecularGlossiness, in whose place there is a Phong material as `Microfacets` has it.

    Attributes:
        diffuse: linear, of which there is as much as the specular colour leaves.
        specular: linear, reflected along the normal.
        glossiness: 1 − roughness.
        diffuse_picture: multiplies the diffuse colour.
        picture: multiplies the specular colour, and its alpha the glossiness.
    """

    diffuse: tuple[float, float, float]
    specular: tuple[float, float, float]
    glossiness: float
    diffuse_picture: FilePicture | None = None
    picture: FilePicture | None = None

    def with_means(self, means: Sequence[float]) -> tuple["Glossiness", str]:
        """The same where the alpha of the picture counts by its mean, and a note that tells so."""
        mean = dataclasses.replace(self, glossiness=self.glossiness * means[3])
        return mean, f"its texture of glossiness counts by its mean, {mean.glossiness:.2f} everywhere"

    def applied_to(self, material: "FileMaterial") -> "FileMaterial":
        """A material with these colours and this exponent, and all else as it is."""
        exponent = exponent_of(1 - self.glossiness)
        diffuse = [c * (1 - max(self.specular)) for c in self.diffuse]
        wide = exponent < 1 and self.picture is None and self.diffuse_picture is None
        if wide:
            diffuse = [d + s for d, s in zip(diffuse, self.specular, strict=True)]
        return dataclasses.replace(
            material,
            diffuse=as_colour(diffuse),
            specular=(0.0, 0.0, 0.0) if wide else self.specular,
            exponent=0.0 if wide else exponent,
            diffuse_picture=self.diffuse_picture,
            specular_picture=self.picture,
            microfacets=self,
        )


def exponent_of(roughness: float) -> float:
    """The exponent of a Phong lobe as wide as a roughness makes it, see `Microfacets`."""
    return (1 / max(roughness, 0.05) ** 4 - 1) / 2


def as_colour(numbers: Sequence[float]) -> tuple[float, float, float]:
    """Three numbers."""
    red, green, blue = numbers
    return red, green, blue


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
        microfacets: what its colours and exponent stand for, if anything. Where that has a texture of roughness, they
            are made anew from the means of the texture when it is read.
        unlit: whether it is of its diffuse colour in any light.
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
    microfacets: Microfacets | Glossiness | None = None
    unlit: bool = False
    notes: list[str] = dataclasses.field(default_factory=list)
