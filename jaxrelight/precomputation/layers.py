"""The layers of a store, each reused where it can be: geometry → visibility → factors, transport."""

import dataclasses
import functools
import pathlib

import numpy as np

from jaxrelight.basis import cubemap
from jaxrelight.brdf.factors import check_terms
from jaxrelight.brdf.material import as_material
from jaxrelight.brdf.separable import Separable
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.methods import Settings
from jaxrelight.precomputation.groups import Report, complete, timed
from jaxrelight.precomputation.load import Placed
from jaxrelight.precomputation.material_rows import MaterialRows
from jaxrelight.precomputation.placing import place
from jaxrelight.scene.scene import Scene
from jaxrelight.transport.bounce import Gather
from jaxrelight.transport.compression import compression, shared
from jaxrelight.transport.visibility import trace_visibility


@dataclasses.dataclass(frozen=True)
class Made:
    """The layers of one set of receivers.

    Attributes:
        folder: the store.
        header: names the layers, as `load` takes it.
        placed: the geometry, for `load`.
        rays: traced in this run.
        notes: what the settings cost that one might not expect, one line each.
    """

    folder: pathlib.Path
    header: dict
    placed: Placed
    rays: int
    notes: tuple[str, ...]


def make_layers(
    scene: Scene,
    settings: Settings,
    folder: str | pathlib.Path | None,
    report: Report,
    seconds: dict[str, float],
    gather: Gather | None = None,
) -> Made:
    """Makes, or completes, all layers of a scene's receivers; see `precompute`.

    Args:
        scene: checked already.
        settings: the dials.
        folder: the store.
        report: as `precompute` takes it.
        seconds: to which those of each stage are added.
        gather: gathers bounced light, which is added to direct light.
    """
    with timed(seconds, "geometry"):
        here = place(scene, settings, folder)
    folder, receivers, tracer = here.folder, here.placed.receivers, here.placed.tracer
    visibility_key = here.receivers_key(settings.resolution, settings.visibility_samples, GROUP)
    directions = cubemap.directions(settings.resolution * settings.samples_per_side)
    with timed(seconds, "visibility"):
        visibility = store.make_layer(
            folder / f"visibility-{visibility_key}",
            {"bits": ((GROUP, len(directions) // 8), np.dtype(np.uint8))},
            len(receivers.filled),
        )
        rays = _trace_groups(visibility, receivers, tracer, directions, report)

    materials, notes = [], []
    stage = f"bounce {settings.bounces}" if gather else "transport"
    with timed(seconds, stage):
        for material in here.materials(grey=settings.receivers == "vertices"):
            for _, record, key in material.parts:
                if settings.coefficients != "all":
                    direct = store.key_of(visibility_key, key, compression(settings).dial)
                    record["transport"] = f"transport-{direct}"
                if gather:
                    bounced = store.key_of(visibility_key, key, shared(settings).dial, gather.key)
                    record["bounced"] = f"bounced-{bounced}"
            rows = MaterialRows(folder, receivers, material.groups, [part[:2] for part in material.parts])
            if settings.coefficients != "all":
                rows.direct(settings, visibility, functools.partial(report, f"transport of {material.name}"))
            if gather:
                told = functools.partial(report, f"{stage} on {material.name}")
                rows.gathered("bounced", shared(settings), gather, told)
            materials += [record for _, record, _ in material.parts]
            notes += material.notes

    if any(here.placed.normal_maps) and settings.receivers == "vertices":
        notes.append(
            "normal maps are sampled at vertices, their detail between them is lost; --receivers pixels has it"
        )
    header = here.header(materials, visibility=visibility.folder.name)
    return Made(folder, header, here.placed, rays, tuple(notes))


def check_terms_of(scene: Scene, name: str, settings: Settings):
    """Refuses a number of factors that cannot be had, before any ray."""
    brdfs = [part.brdf for part in as_material(scene.materials[name]).components]
    factored = any(not brdf.is_constant and not isinstance(brdf, Separable) for brdf in brdfs)
    if factored and settings.receivers == "vertices":
        try:
            check_terms(scene.terms.get(name, settings.terms), settings.factor_resolution)
        except InputError as error:
            raise InputError(f"{scene.name}: material '{name}': {error}") from None


def _trace_groups(layer: store.Layer, receivers: Receivers, tracer: Tracer, directions, report: Report) -> int:
    rays = []

    def trace(group: int):
        arrays = receivers.positions[group], receivers.normals[group], receivers.face_normals[group]
        bits, count = trace_visibility(tracer, *arrays, directions)
        layer.write(group, bits=bits)
        rays.append(count)

    complete([layer], receivers.filled, trace, functools.partial(report, "visibility"))
    return sum(rays)
