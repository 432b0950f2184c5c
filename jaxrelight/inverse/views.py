"""The views of several pictures, each traced once."""

from collections.abc import Sequence
from typing import Any

from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.lighting.contract import Relighter


def views_of(relighter: Relighter, views: Sequence[Any] | Camera | None, count: int) -> tuple[Any, ...]:
    """A view for each of several pictures; pictures of one camera share theirs.

    Args:
        relighter: that traces cameras.
        views: cameras, what `relighter.view` gives, or None for the scene's camera: one for all, or one for each.
        count: of the pictures.

    Raises:
        InputError: for another number of views than there are pictures.
    """
    given = list(views) if isinstance(views, list | tuple) else [views] * count
    if len(given) != count:
        raise InputError(f"{len(given)} views were given for {count} pictures; give one for each, or one for all")
    traced: dict[Camera | None, Any] = {}
    for one in given:
        if (one is None or isinstance(one, Camera)) and one not in traced:
            traced[one] = relighter.view(one)
    return tuple(traced[one] if one is None or isinstance(one, Camera) else one for one in given)
