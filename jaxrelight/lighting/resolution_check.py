"""Whether a resolution that was chosen for one environment is enough for another: on the points that it was chosen by.

What they see is in the store at every resolution, so that no ray is cast.
"""

import numpy as np

from jaxrelight.brdf.material import white_lambert
from jaxrelight.files import store
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.lights.environment import Environment
from jaxrelight.methods import Transport
from jaxrelight.transport.model import PrecomputedTransport
from jaxrelight.transport.resolution_error import (
    PointRows,
    key_of_light,
    light_of,
    points_of,
    radiance,
    resolution_error,
)

# An error that is this many times the tolerance is told: that of other points may differ by a quarter.
_TOLD = 1.5


def resolution_errors(transport: PrecomputedTransport, environment: Environment) -> dict[int, float]:
    """The error of the store's resolution under an environment, and those of finer ones up to the first that is enough.

    Errors are relative to the finest, trimmed as those of pictures. Of a resolution that was given, or is the finest
    itself, nothing is known.

    Raises:
        InputError: if a layer of the store is damaged.
    """
    stored, method = transport.stored, transport.method
    chosen = stored.chosen_resolution
    if chosen is None or not isinstance(method, Transport):
        return {}
    sample = store.open_layer(stored.folder / chosen.sample)
    slots = sample.read("slots", 0)
    points = points_of(transport.receivers, transport.surfaces, slots, stored.camera.origin)
    group, rows = points.slots // GROUP, []
    has_rows = np.zeros(len(group), bool)
    for block in transport.blocks:
        if block.has_direct:
            own = np.flatnonzero(np.isin(group, block.groups))
            has_rows[own] = True
            rows.append(PointRows(own, block.brdf, block.weight))
    rows.append(PointRows(np.flatnonzero(~has_rows), white_lambert(), ()))
    light, errors = light_of(environment, chosen.finest), {}
    reference = radiance(points, rows, sample.read("bits", len(chosen.errors)), light, chosen.finest)
    for number, resolution in enumerate(chosen.errors):
        if resolution < chosen.resolution:
            continue
        bits = sample.read("bits", number)
        coarse = radiance(points, rows, bits, light, resolution, method.samples_per_side)
        errors[resolution] = resolution_error(coarse, reference)[0]
        if errors[resolution] <= chosen.tolerance:
            break
    return errors


def resolution_notes(transport: PrecomputedTransport, environment: Environment | None) -> tuple[str, ...]:
    """A line where an environment is clearly sharper than the one that the resolution was chosen for."""
    chosen = transport.stored.chosen_resolution
    if chosen is None or environment is None or chosen.environment == key_of_light(environment):
        return ()
    errors = resolution_errors(transport, environment)
    error = errors.get(chosen.resolution, 0.0)
    if error <= _TOLD * chosen.tolerance:
        return ()
    last = max(errors)
    enough = last if errors[last] <= chosen.tolerance else chosen.finest
    return (
        f"this environment is sharper than the one that resolution {chosen.resolution} was chosen for: it is "
        f"{error:.1%} off of {chosen.finest} on {chosen.points} points, more than {chosen.tolerance:.1%}; precompute "
        f"with this environment, or with --resolution {enough}",
    )
