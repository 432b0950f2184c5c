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
from jaxrelight.methods import Transport
from jaxrelight.precomputation.groups import complete
from jaxrelight.precomputation.layer_files import write_lights
from jaxrelight.precomputation.material_rows import MaterialRows
from jaxrelight.precomputation.placing import place
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.timing import timed
from jaxrelight.transport.bounce import Gather
from jaxrelight.transport.compression import compression, shared
from jaxrelight.transport.model import SceneGeometry
from jaxrelight.transport.visibility import trace_visibility


@dataclasses.dataclass(frozen=True)
class BuiltLayers:
    """The layers of one set of receivers.

    Attributes:
        folder: the store.
        header: names the layers, as `load` takes it.
        geometry: of the scene, for `load`.
        rays: traced in this run.
        notes: what the method cost that one might not expect, one line each.
    """

    folder: pathlib.Path
    header: dict
    geometry: SceneGeometry
    rays: int
    notes: tuple[str, ...]


def make_layers(
    scene: Scene,
    method: Transport,
    folder: str | pathlib.Path | None,
    report: Report,
    seconds: dict[str, float],
    gather: Gather | None = None,
) -> BuiltLayers:
    """Makes, or completes, all layers of a scene's receivers; see `precompute`.

    Args:
        scene: checked already.
        method: the dials.
        folder: the store.
        report: as `precompute` takes it.
        seconds: to which those of each stage are added.
        gather: gathers bounced light, which is added to direct light.
    """
    with timed(seconds, "geometry"):
        here = place(scene, method, folder)
    folder, receivers, tracer = here.folder, here.receivers, here.geometry.tracer
    visibility_key = here.receivers_key(method.resolution, method.visibility_samples, GROUP)
    directions = cubemap.directions(method.resolution * method.samples_per_side)
    with timed(seconds, "visibility"):
        visibility = store.make_layer(
            folder / f"visibility-{visibility_key}",
            {"bits": ((GROUP, len(directions) // 8), np.dtype(np.uint8))},
            len(receivers.filled),
        )
        rays = _trace_groups(visibility, receivers, tracer, directions, report)

    materials, notes = [], []
    stage = f"bounce {method.bounces}" if gather else "transport"
    with timed(seconds, stage):
        for material in here.materials(grey=method.receivers == "vertices"):
            for _, record, key in material.parts:
                if method.coefficients != "all":
                    direct = store.key_of(visibility_key, key, compression(method).dial)
                    record["transport"] = f"transport-{direct}"
                if gather:
                    bounced = store.key_of(visibility_key, key, shared(method).dial, gather.key)
                    record["bounced"] = f"bounced-{bounced}"
            rows = MaterialRows(folder, receivers, material.groups, [part[:2] for part in material.parts])
            if method.coefficients != "all":
                rows.direct(method, visibility, functools.partial(report, f"transport of {material.name}"))
            if gather:
                gather_report = functools.partial(report, f"{stage} on {material.name}")
                rows.gathered("bounced", shared(method), gather, gather_report)
            materials += [record for _, record, _ in material.parts]
            notes += material.notes

    if any(here.geometry.normal_maps) and method.receivers == "vertices":
        notes.append(
            "normal maps are sampled at vertices, their detail between them is lost; --receivers pixels has it"
        )
    header = here.header(materials, write_lights(folder, scene.lights.local), visibility=visibility.folder.name)
    return BuiltLayers(folder, header, here.geometry, rays, tuple(notes))


def check_terms_of(scene: Scene, name: str, method: Transport) -> None:
    """Refuses a number of factors that cannot be had, before any ray."""
    brdfs = [part.brdf for part in as_material(scene.materials[name]).components]
    factored = any(not brdf.is_constant and not isinstance(brdf, Separable) for brdf in brdfs)
    if factored and method.receivers == "vertices":
        try:
            check_terms(scene.terms.get(name, method.terms), method.factor_resolution)
        except InputError as error:
            raise InputError(f"{scene.name}: material '{name}': {error}") from None


def _trace_groups(layer: store.Layer, receivers: Receivers, tracer: Tracer, directions, report: Report) -> int:
    rays = []

    def trace(group: int) -> None:
        arrays = receivers.positions[group], receivers.normals[group], receivers.face_normals[group]
        bits, count = trace_visibility(tracer, *arrays, directions)
        layer.write(group, bits=bits)
        rays.append(count)

    complete([layer], receivers.filled, trace, functools.partial(report, "visibility"))
    return sum(rays)
