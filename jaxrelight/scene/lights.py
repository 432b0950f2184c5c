"""The lights of a scene file."""

import pathlib

import numpy as np

from jaxrelight.errors import InputError
from jaxrelight.files.toml_table import Table
from jaxrelight.lights.area import area
from jaxrelight.lights.environment import load_environment
from jaxrelight.lights.local import Light, directional, point, spot
from jaxrelight.lights.projector import projector
from jaxrelight.lights.shaped import shaped
from jaxrelight.lights.sky import even_sky, sky_of
from jaxrelight.scene.materials import read_texture


def read_light(table: Table, folder: pathlib.Path) -> Light:
    """One [[light]]; files are relative to the folder.

    Raises:
        InputError: for a kind that is not known, and whatever its numbers may not be, by name.
    """
    kind = table.text("type")
    try:
        if kind not in _READERS:
            raise InputError(f"type '{kind}' is not known; known are {', '.join(_READERS)}")
        light = _READERS[kind](table, folder)
    except InputError as error:
        raise table.within(error) from None
    table.finish()
    return light


def _point(table: Table, _) -> Light:
    return point(table.array("position", (3,)), table.not_negative("intensity"))


def _spot(table: Table, _) -> Light:
    cutoff = table.number("cutoff")
    aim = table.array("position", (3,)), table.array("target", (3,))
    return spot(*aim, table.not_negative("intensity"), cutoff, table.number("beam", 0.75 * cutoff))


def _directional(table: Table, _) -> Light:
    return directional(table.array("direction", (3,)), table.not_negative("irradiance"))


def _projector(table: Table, folder: pathlib.Path) -> Light:
    aim = table.array("position", (3,)), table.array("target", (3,))
    image = np.asarray(read_texture(folder / table.text("image")).pixels) * table.not_negative("intensity")
    return projector(*aim, image, table.number("fov_y"), table.array("up", (3,), (0.0, 1.0, 0.0)))


def _shaped(table: Table, _) -> Light:
    aim = table.array("position", (3,)), table.array("target", (3,))
    inner = table.numbers("inner", [(), (2,)])
    return shaped(
        *aim,
        table.not_negative("intensity"),
        inner,
        table.numbers("outer", [(), (2,)], inner),
        up=table.array("up", (3,), (0.0, 1.0, 0.0)),
        roundness=table.number("roundness", 1.0),
        near=table.array("near", (2,), (0.0, 0.0)),
        far=table.array("far", (2,)) if table.has("far") else (np.inf, np.inf),
        falloff=table.number("falloff", 2.0),
        reference=table.number("reference", 1.0),
    )


def _area(table: Table, _) -> Light:
    places = table.array("centre", (3,)), table.array("u", (3,)), table.array("v", (3,))
    return area(*places, table.not_negative("radiance"), table.whole("samples", 4))


def _sky(table: Table, folder: pathlib.Path) -> Light:
    if not table.has("file"):
        return even_sky(table.not_negative("radiance"), table.whole("samples", 64))
    turn, scale = table.number("rotate_y", 0.0), table.number("scale", 1.0)
    return sky_of(load_environment(folder / table.text("file"), turn, scale), table.whole("samples", 256))


_READERS = {
    "point": _point,
    "spot": _spot,
    "directional": _directional,
    "projector": _projector,
    "shaped": _shaped,
    "area": _area,
    "sky": _sky,
}
