"""A BRDF from a file of any of the formats."""

import dataclasses
import math
import pathlib

import jax
import numpy as np

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.files.content import Content
from jaxrelight.brdf.files.cornell import is_cornell, read_cornell
from jaxrelight.brdf.files.merl import SHAPE, read_merl
from jaxrelight.brdf.files.rgl import MAGIC, read_rgl
from jaxrelight.brdf.sampling import directional_albedo
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import float_dtype

# Where albedos are looked at: beyond it measurements are rare, and those there are extrapolate.
_DEGREES = 0, 30, 60, 80


@dataclasses.dataclass(frozen=True)
class BrdfFile:
    """What a file holds.

    Attributes:
        brdf: in linear Rec.709.
        kind: "MERL", "RGL" or "Cornell".
        notes: what was mended or approximated, one line each.
    """

    brdf: Brdf
    kind: str
    notes: tuple[str, ...]

    def albedos(self) -> dict[int, float]:
        """Share of the light that is reflected, by its angle from the normal in degrees; of the brightest channel."""
        albedos = _albedos(self.brdf, as_array([_at(degrees) for degrees in _DEGREES], float_dtype(self.brdf)))
        return dict(zip(_DEGREES, np.max(albedos, axis=-1).tolist(), strict=True))

    def energy_notes(self) -> list[str]:
        """A line if more is reflected than comes, which measurements at grazing angles may say."""
        degrees, most = max(self.albedos().items(), key=lambda item: item[1])
        return [f"as measured, {most:.3g} times the light is reflected at {degrees}° from the normal"] * (most > 1.01)


def load_brdf(path: str | pathlib.Path) -> BrdfFile:
    """Reads a measured BRDF; what it is follows from its content, whatever its name.

    MERL's .binary and Cornell's .brdf become `Tabulated`, RGL's .bsdf becomes `Adaptive`.

    Raises:
        InputError: if the file cannot be read, is of another format, cut short, too long, contradicts itself or holds
            numbers that are not finite.
    """
    content = Content(path)
    if not content.data:
        raise content.fault("is empty")
    if content.data.startswith(MAGIC):
        kind, (brdf, notes) = "RGL", read_rgl(content)
    elif is_cornell(content):
        kind, (brdf, notes) = "Cornell", read_cornell(content)
    elif _is_merl(content):
        kind, (brdf, notes) = "MERL", read_merl(content)
    else:
        raise content.fault("is no BRDF file", "use a MERL .binary, RGL .bsdf or Cornell .brdf file")
    return BrdfFile(brdf, kind, tuple(notes))


def _at(degrees: float) -> tuple[float, float, float]:
    return math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))


@jax.jit
def _albedos(brdf: Brdf, omega_o):
    return jax.lax.map(lambda omega: directional_albedo(brdf, omega, 128, 256), omega_o)


def _is_merl(content: Content) -> bool:
    """Three small positive dimensions; the reader says if they are the wrong ones."""
    if content.path.suffix.lower() == ".binary":
        return len(content.data) >= 12
    return len(content.data) >= 12 and tuple(content.array("<i4", (3,), 0).tolist()) == SHAPE
