"""What may be unknown of a lamp, as numbers that a solver changes freely: all bounds are in how they are made.

Brightness is softplus of an unknown, angles of a cone and places in a box are sigmoids, and an axis is turned by its
two slopes against where it was. All unknowns are of order one.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.lights.area import Area
from jaxrelight.lights.local import Directional, Light, Point, Spot
from jaxrelight.lights.projector import Projector
from jaxrelight.lights.shaped import Shaped
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array

# What may be free, in the order in which unknowns stand: "cone" is both angles.
FREE = ("intensity", "colour", "position", "aim", "cutoff", "beam")
# Degrees between which cutoffs lie, and shares of the cutoff between which beams do.
CUTOFFS, BEAMS = (1.0, 89.0), (0.02, 0.98)
# Unknowns of a start keep this share of a range from its ends, where slopes vanish.
_FROM_ENDS = 0.02
# The least brightness that a solver starts from, of what is typical: below that, slopes vanish.
_MIN_BRIGHTNESS = 0.01


@dataclasses.dataclass(frozen=True)
class LampFields:
    """The names of a light's fields: its power, and where it has them, its place, its aim and a cone."""

    power: str
    position: str | None = None
    target: str | None = None
    direction: str | None = None
    has_cone: bool = False

    @property
    def can_be_free(self) -> tuple[str, ...]:
        """What of it can be unknown."""
        aims = self.target is not None or self.direction is not None
        able = {"position": self.position is not None, "aim": aims, "cutoff": self.has_cone, "beam": self.has_cone}
        return tuple(name for name in FREE if able.get(name, True))


FIELDS: dict[type, LampFields] = {
    Point: LampFields("intensity", "position"),
    Spot: LampFields("intensity", "position", "target", has_cone=True),
    Shaped: LampFields("intensity", "position", "target"),
    Projector: LampFields("image", "position", "target"),
    Area: LampFields("radiance", "centre"),
    Directional: LampFields("irradiance", direction="direction"),
}


class Placement(NamedTuple):
    """What lamps have that may be unknown; positions count from the scene's centre. A single one has no leading axis.

    Attributes:
        brightness: factor on their colour: one number, or one for each channel where colours are free.
        position: in metres; zeros of lamps without one.
        axis: unit direction along which they shine; zeros of lamps without one.
        cutoff: of their cone, in degrees; zeros of lamps without one.
        beam: share of the cutoff up to which all light is.
    """

    brightness: Float[Array, "*n b"]
    position: Float[Array, "*n 3"]
    axis: Float[Array, "*n 3"]
    cutoff: Float[Array, "*n"]
    beam: Float[Array, "*n"]


class LampKind(eqx.Module):
    """Lamps of one class of which the same is free; arrays lead with their number n.

    Attributes:
        lamps: as they were given, their positions from the scene's centre, and their brightest channel 1.
        box: ends between which positions lie, from the scene's centre; None for anywhere.
        reach: metres that an unknown of order one moves a lamp by, where there is no box.
        typical: brightness of order one.
        free: names of `FREE`.
        numbers: of the lamps among all.
    """

    lamps: Light
    box: Float[Array, "n 2 3"] | None
    reach: Float[Array, ""]
    typical: Float[Array, ""]
    free: tuple[str, ...] = eqx.field(static=True)
    numbers: tuple[int, ...] = eqx.field(static=True)

    @property
    def fields(self) -> LampFields:
        """Of its class."""
        return FIELDS[type(self.lamps)]

    @property
    def unknown_names(self) -> tuple[tuple[str, str], ...]:
        """Names and units of each lamp's unknowns, in their order."""
        unit = {"irradiance": "W/m²", "radiance": "W/(m² sr)"}.get(self.fields.power, "W/sr")
        names = {
            "intensity": [(self.fields.power, unit)],
            "colour": [(f"{self.fields.power} {name}", unit) for name in ("red", "green", "blue")],
            "position": [(axis, "m") for axis in "xyz"],
            "aim": [("aim across", "°"), ("aim along", "°")],
            "cutoff": [("cutoff", "°")],
            "beam": [("beam", "°")],
        }
        return tuple(one for name in self.free for one in names[name])


def checked_free(number: int, lamp: Light, asked: Sequence[str]) -> tuple[str, ...]:
    """What is free of a lamp, in the order of `FREE`.

    Raises:
        InputError: for a class of lamps, or a name, that is not known, or what the lamp does not have.
    """
    if type(lamp) not in FIELDS:
        known = ", ".join(kind.__name__.lower() for kind in FIELDS)
        raise InputError(
            f"lamp {number + 1} is a {type(lamp).__name__}, of which nothing can be free; known are {known}"
        )
    names = [one for name in asked for one in (("cutoff", "beam") if name == "cone" else (name,))]
    able = FIELDS[type(lamp)].can_be_free
    for name in names:
        if name not in FREE:
            raise InputError(f"lamp {number + 1}: '{name}' cannot be free; known are {', '.join(FREE)} and cone")
        if name not in able:
            raise InputError(f"lamp {number + 1} is a {type(lamp).__name__.lower()}, which has no {name} to be free")
    if "colour" in names:
        # Each channel has a brightness of its own.
        names = [name for name in names if name != "intensity"]
    return tuple(name for name in FREE if name in names)


def centred(lamp: Light, centre: Float[np.ndarray, "3"], sign: float = -1.0) -> Light:
    """A lamp whose places count from a centre, or with sign 1 one of those in the world again."""
    moved = {
        field.name: np.asarray(getattr(lamp, field.name), float) + sign * centre
        for field in dataclasses.fields(lamp)
        if field.metadata.get("is_place")
    }
    return dataclasses.replace(lamp, **moved)


def brightened(lamp: Light, factor: Float[np.ndarray, "3"]) -> Light:
    """A lamp whose light is so many times as strong, by channel.

    Raises:
        InputError: for a light that is none of the kinds of lamps.
    """
    if type(lamp) not in FIELDS:
        known = ", ".join(sorted(kind.__name__.lower() for kind in FIELDS))
        raise InputError(f"the strength of a light of type {type(lamp).__name__} cannot be unknown; lamps are {known}")
    name = FIELDS[type(lamp)].power
    power = np.asarray(getattr(lamp, name))
    return dataclasses.replace(lamp, **{name: as_array((power * factor).astype(power.dtype))})


def split_brightness(lamp: Light, free: Sequence[str]) -> tuple[Light, Float[np.ndarray, " b"]]:
    """A lamp whose brightest channel is 1, white where its colour is free or it is black; and its brightness."""
    name = FIELDS[type(lamp)].power
    power = np.asarray(getattr(lamp, name), float)
    if "colour" in free:
        brightness = power.reshape(-1, 3).max(axis=0)
        relative = power / np.where(brightness > 0, brightness, 1)
        relative = np.where(brightness > 0, relative, 1.0)
    else:
        brightness = power.max(keepdims=True).reshape(1)
        relative = power / brightness[0] if brightness[0] > 0 else np.ones_like(power)
    dtype = np.asarray(getattr(lamp, name)).dtype
    return dataclasses.replace(lamp, **{name: as_array(relative, dtype)}), brightness


def placement_of(lamp: Light, brightness: Float[np.ndarray, " b"]) -> Placement:
    """Where a centred lamp stands, and what of it may change; of the host."""
    fields = FIELDS[type(lamp)]
    none = np.zeros(3)
    position = none if fields.position is None else np.asarray(getattr(lamp, fields.position), float)
    axis = none
    if fields.target is not None:
        axis = np.asarray(getattr(lamp, fields.target), float) - position
    elif fields.direction is not None:
        axis = np.asarray(getattr(lamp, fields.direction), float)
    length = np.linalg.norm(axis)
    cutoff = float(getattr(lamp, "cutoff", 0.0)) if fields.has_cone else 0.0
    beam = float(getattr(lamp, "beam", 0.0)) / cutoff if cutoff else 0.0
    values: Any = brightness, position, axis / (length if length > 0 else 1), np.asarray(cutoff), np.asarray(beam)
    return Placement(*values)


def lamp_at(lamp: Any, free: tuple[str, ...], placement: Placement) -> Light:
    """A lamp as a placement has it; what is not free stays as it is, so a lamp that moves keeps its target.

    Args:
        lamp: one of a kind's.
        free: of it.
        placement: of this one.
    """
    fields = FIELDS[type(lamp)]
    power = getattr(lamp, fields.power)
    factor = jnp.expand_dims(placement.brightness, tuple(range(power.ndim - 1)))
    changed: dict[str, Any] = {fields.power: (power * factor).astype(power.dtype)}
    at = fields.position or ""
    if "position" in free:
        changed[at] = placement.position.astype(power.dtype)
    if "aim" in free:
        if fields.target is not None:
            position = jnp.asarray(getattr(lamp, at), power.dtype)
            distance = safe.norm(jnp.asarray(getattr(lamp, fields.target), power.dtype) - position)
            changed[fields.target] = changed.get(at, position) + distance * placement.axis
        else:
            changed[fields.direction or ""] = placement.axis
    cutoff = placement.cutoff.astype(power.dtype)
    if "cutoff" in free:
        changed["cutoff"] = cutoff
    if "beam" in free or "cutoff" in free:
        changed["beam"] = (placement.beam * cutoff).astype(power.dtype)
    return dataclasses.replace(lamp, **changed)


def unknowns_of(kind: LampKind, placement: Placement) -> Float[Array, "n p"]:
    """The unknowns of all lamps of a kind at a placement; those at the ends of ranges a little inside."""

    def one(box: Float[Array, "2 3"] | None, placed: Placement) -> Float[Array, " p"]:
        parts: list[Array] = []
        for name in kind.free:
            if name in ("intensity", "colour"):
                relative = jnp.maximum(placed.brightness / kind.typical, _MIN_BRIGHTNESS)
                # The inverse of softplus, also where its exponential overflows.
                parts.append(relative + jnp.log(-jnp.expm1(-relative)))
            elif name == "position":
                parts.append(jnp.zeros(3) if box is None else _within(placed.position, box[0], box[1]))
            elif name == "aim":
                parts.append(jnp.zeros(2))
            elif name == "cutoff":
                parts.append(_within(placed.cutoff, *CUTOFFS)[None])
            else:
                parts.append(_within(placed.beam, *BEAMS)[None])
        return jnp.concatenate(parts)

    return jax.vmap(one, in_axes=(None if kind.box is None else 0, 0))(kind.box, placement)


def placed(
    kind: LampKind, box: Float[Array, "2 3"] | None, start: Placement, unknowns: Float[Array, " p"]
) -> Placement:
    """Where unknowns put one lamp of a kind, from a placement about which its axis and its free position count."""
    found, at = start, 0
    for name in kind.free:
        if name in ("intensity", "colour"):
            count = 1 if name == "intensity" else 3
            found = found._replace(brightness=kind.typical * jax.nn.softplus(unknowns[at : at + count]))
        elif name == "position":
            count, moves = 3, unknowns[at : at + 3]
            place = start.position + kind.reach * moves if box is None else _between(moves, box[0], box[1])
            found = found._replace(position=place)
        elif name == "aim":
            count = 2
            across, along = across_axis(start.axis)
            turned = start.axis + unknowns[at] * across + unknowns[at + 1] * along
            found = found._replace(axis=safe.normalize(turned))
        elif name == "cutoff":
            count, found = 1, found._replace(cutoff=_between(unknowns[at], *CUTOFFS))
        else:
            count, found = 1, found._replace(beam=_between(unknowns[at], *BEAMS))
        at += count
    return found


def shown_unknowns(kind: LampKind, start: Placement, found: Placement, centre: Float[Array, "3"]) -> Float[Array, " p"]:
    """The unknowns of one lamp in the units that its kind names; aims in degrees off the axis that it starts from."""
    parts: list[Array] = []
    for name in kind.free:
        if name in ("intensity", "colour"):
            parts.append(found.brightness)
        elif name == "position":
            parts.append(found.position + centre)
        elif name == "aim":
            sides = jnp.stack(across_axis(start.axis))
            parts.append(jnp.degrees(jnp.matmul(sides, found.axis, precision="highest")))
        elif name == "cutoff":
            parts.append(found.cutoff[None])
        else:
            parts.append((found.beam * found.cutoff)[None])
    return jnp.concatenate(parts)


def across_axis(axis: Float[Array, "3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Two unit directions across an axis and each other."""
    aside = jnp.where(jnp.abs(axis[1]) < 0.9, jnp.asarray([0.0, 1, 0]), jnp.asarray([1.0, 0, 0]))
    across = safe.normalize(jnp.cross(axis, aside))
    return across, jnp.cross(axis, across)


def _between(unknown: Array, low: Any, high: Any) -> Array:
    return low + (high - low) * jax.nn.sigmoid(unknown)


def _within(value: Array, low: Any, high: Any) -> Array:
    """The unknown of which `_between` makes a value, or one a little inside."""
    span = jnp.where(high > low, high - low, 1)
    share = jnp.clip((value - low) / span, _FROM_ENDS, 1 - _FROM_ENDS)
    return jnp.log(share / (1 - share))
