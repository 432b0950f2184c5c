"""The resolution that a scene needs: the least whose rows reflect its light as finer ones do, on some of its receivers.

What stands for all lights is the scene's own environment. Lobes that are filtered have no rows, and ask for none: a
point of which nothing else is reflected counts as if it were white paper.
"""

import dataclasses
import functools
import pathlib
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxrelight.brdf.material import Component, Material, as_material, has_lobes, split_diffuse, white_lambert
from jaxrelight.brdf.packed_texture import pack_weight
from jaxrelight.brdf.record import to_record
from jaxrelight.files import store
from jaxrelight.geometry.occluders import Occluders
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.methods import RESOLUTIONS_BY_NEED, Transport
from jaxrelight.precomputation.groups import Threads
from jaxrelight.precomputation.layer_files import plain, write_factor, write_table
from jaxrelight.precomputation.placing import PlacedScene, place, reflection_of
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.timing import timed
from jaxrelight.transport import adaptive_visibility
from jaxrelight.transport.adaptive_visibility import trace_adaptively
from jaxrelight.transport.resolution_error import (
    POINTS,
    ChosenResolution,
    PointRows,
    Points,
    draw_slots,
    key_of_light,
    light_of,
    points_of,
    radiance,
    resolution_error,
)

# Points whose rays a thread casts together; what one of them sees does not depend on the number of threads.
_RAY_BATCH = 32


class Resolved(NamedTuple):
    """A method whose resolution is a number.

    Attributes:
        method: it.
        chosen: how it came about; None where it was given.
        rays: that were cast for it in this run.
    """

    method: Transport
    chosen: ChosenResolution | None = None
    rays: int = 0


def with_resolution(
    scene: Scene, method: Transport, folder: str | pathlib.Path | None, report: Report, seconds: dict[str, float]
) -> Resolved:
    """The method with the resolution that a scene needs, where it asks for that.

    The rays and the errors are layers of the store: the same scene under the same environment casts none again, and
    neither does it under another one.

    Args:
        scene: checked already.
        method: the dials.
        folder: the store.
        report: as `precompute` takes it.
        seconds: to which those of the choice are added.
    """
    if method.resolution != "auto":
        return Resolved(method)
    *coarser, finest = RESOLUTIONS_BY_NEED
    with timed(seconds, "resolution"):
        here = place(scene, dataclasses.replace(method, resolution=finest), folder, report)
        geometry, camera = here.geometry, scene.camera
        slots = draw_slots(here.receivers, geometry.surfaces, geometry.tracer, camera)
        points = points_of(here.receivers, geometry.surfaces, slots, camera.origin)
        sample, rays = _sample(here, points, method, report)
        layer = _errors(here, points, method, sample)
        trimmed, untrimmed = (layer.read(name, 0).tolist() for name in ("trimmed", "untrimmed"))
        errors = dict(zip(coarser, trimmed, strict=True))
        fits = [n for n, error in errors.items() if error <= method.compression_tolerance and _has_room(method, n)]
        chosen = ChosenResolution(
            resolution=fits[0] if fits else finest,
            finest=finest,
            tolerance=method.compression_tolerance,
            errors=errors,
            untrimmed=dict(zip(coarser, untrimmed, strict=True)),
            points=len(points.slots),
            environment=key_of_light(scene.lights.environment),
            sample=sample.folder.name,
            layer=layer.folder.name,
        )
    return Resolved(dataclasses.replace(method, resolution=chosen.resolution), chosen, rays)


def _has_room(method: Transport, resolution: int) -> bool:
    """Whether rows have as many coefficients as are to be kept."""
    return isinstance(method.coefficients, str) or method.coefficients <= 6 * resolution**2


def _sample(here: PlacedScene, points: Points, method: Transport, report: Report) -> tuple[store.Layer, int]:
    """The layer of what points see at each resolution, the finest last, and the rays cast in this run."""
    *coarser, finest = RESOLUTIONS_BY_NEED
    sides = *(side * method.samples_per_side for side in coarser), finest
    key = here.receivers_key(POINTS, points.slots, sides, _RAY_BATCH, *adaptive_visibility.DIALS)
    count = len(points.slots)
    layout = {"bits": ((count, -1), np.dtype(np.uint8)), "slots": ((count,), np.dtype(np.int64))}
    layer = store.make_layer(here.folder / f"sample-{key}", layout, len(sides))
    if not layer.missing:
        return layer, 0
    geometry, counts = here.geometry, []
    occluders, tracer = Occluders(geometry.surfaces), geometry.tracer
    origins, normals = (of.reshape(-1, 3)[points.slots] for of in (here.receivers.origins, here.receivers.normals))
    starts = range(0, len(points.slots), _RAY_BATCH)
    batches = [(number, start) for number in layer.missing for start in starts]
    seen = {}

    def trace(batch: int) -> None:
        number, start = batches[batch]
        some = slice(start, start + _RAY_BATCH)
        seen[number, start], count = trace_adaptively(
            tracer, occluders, origins[some], normals[some], sides[number], are_close=False
        )
        counts.append(count)

    for done, _ in enumerate(Threads().run(trace, range(len(batches)))):
        report("resolution", done + 1, len(batches))
    for number in layer.missing:
        bits = np.concatenate([seen[number, start] for start in starts])
        layer.write(number, bits=bits, slots=points.slots.astype(np.int64))
    return layer, sum(counts)


def _errors(here: PlacedScene, points: Points, method: Transport, sample: store.Layer) -> store.Layer:
    """The layer of the error of each resolution."""
    scene = here.scene
    materials = [as_material(scene.materials[name]) for name in here.names]
    records = [[_described(here.folder, one) for one in material.components] for material in materials]
    ways = [method.receivers, method.reflection, dict(scene.reflections), plain(dataclasses.astuple(scene.camera))]
    key = store.key_of(sample.folder.name, key_of_light(scene.lights.environment), here.names, records, *ways)
    path = here.folder / f"resolution-{key}"
    *coarser, finest = RESOLUTIONS_BY_NEED
    numbers = (((len(coarser),), np.dtype(np.float64)) for _ in range(2))
    layer = store.make_layer(path, dict(zip(("trimmed", "untrimmed"), numbers, strict=True)), 1)
    if layer.missing:
        light = light_of(scene.lights.environment, finest)
        seen = sample.read("bits", len(coarser))
        reference: dict[tuple[bool, ...], Float[np.ndarray, "p 3"]] = {}
        errors = []
        for number, resolution in enumerate(coarser):
            at_it = dataclasses.replace(method, resolution=resolution)
            filtered = tuple(_is_filtered(scene, at_it, name) for name in here.names)
            rows = _rows(here, points, materials, filtered, method)
            if filtered not in reference:
                reference[filtered] = radiance(points, rows, seen, light, finest)
            bits = sample.read("bits", number)
            coarse = radiance(points, rows, bits, light, resolution, method.samples_per_side)
            errors.append(resolution_error(coarse, reference[filtered]))
        trimmed, untrimmed = np.array(errors).T
        layer.write(0, trimmed=np.ascontiguousarray(trimmed), untrimmed=np.ascontiguousarray(untrimmed))
    return layer


def _is_filtered(scene: Scene, method: Transport, name: str) -> bool:
    """Whether lobes of a material have no rows."""
    components = as_material(scene.materials[name]).components
    return any(reflection_of(scene, method, name, component.brdf) != "factors" for component in components)


def _rows(
    here: PlacedScene, points: Points, materials: list[Material], filtered: tuple[bool, ...], method: Transport
) -> list[PointRows]:
    """What points have in rows."""
    number_of, rows = here.receivers.material_of_group[points.slots // GROUP], []
    for number, (material, without_lobes) in enumerate(zip(materials, filtered, strict=True)):
        own = np.flatnonzero(number_of == number)
        if without_lobes or method.receivers == "vertices":
            material = split_diffuse(material, lobe_sums=without_lobes)
        in_rows = [one for one in material.components if not (without_lobes and has_lobes(one.brdf))]
        rows += [PointRows(own, one.brdf, pack_weight(one.weight)) for one in in_rows]
        if not in_rows:
            rows.append(PointRows(own, white_lambert(), ()))
    return rows


def _described(folder: pathlib.Path, component: Component) -> list:
    """What tells a component from others."""
    described = to_record(component.brdf, functools.partial(write_table, folder))
    return [described, [write_factor(folder, factor) for factor in component.weight]]
