"""The layers of a store, each reused where it can be: geometry → visibility → factors, transport."""

import dataclasses
import functools
import pathlib

import numpy as np

from jaxrelight.basis import cubemap
from jaxrelight.basis.cube_grid import point_count
from jaxrelight.brdf.factoring import Factoring
from jaxrelight.brdf.material import as_material
from jaxrelight.brdf.separable import Separable
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.geometry.occluders import Occluders
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.methods import Transport
from jaxrelight.precomputation.account import DirectRows
from jaxrelight.precomputation.groups import complete
from jaxrelight.precomputation.layer_files import write_lights
from jaxrelight.precomputation.load import is_filtered
from jaxrelight.precomputation.material_rows import MaterialRows
from jaxrelight.precomputation.placing import place
from jaxrelight.precomputation.receiver_refinement import Refined
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.timing import timed
from jaxrelight.transport import adaptive_visibility, bake
from jaxrelight.transport.adaptive_visibility import trace_adaptively
from jaxrelight.transport.bounce import Gather
from jaxrelight.transport.compression import compression, shared
from jaxrelight.transport.filtered_visibility import CELLS, MAX_ANGLE, visibility_distances
from jaxrelight.transport.hits import NO_RAYS, GatherRays
from jaxrelight.transport.model import SceneGeometry, frames_of
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
        gather_rays: of this run, along which bounced light was gathered.
        rows: of direct light.
        finer: how vertices were added to the scene; None where none may be.
    """

    folder: pathlib.Path
    header: dict
    geometry: SceneGeometry
    rays: int
    notes: tuple[str, ...]
    gather_rays: GatherRays = NO_RAYS
    rows: tuple[DirectRows, ...] = ()
    finer: Refined | None = None


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
        here = place(scene, method, folder, report)
    folder, receivers = here.folder, here.receivers
    of_rays = adaptive_visibility.DIALS if method.rays == "adaptive" else ()
    visibility_key = here.receivers_key(
        method.resolution, method.visibility_samples, GROUP, "counted, on smooth surfaces", *of_rays
    )
    texels = method.resolution * method.samples_per_side
    with timed(seconds, "visibility"):
        visibility = store.make_layer(
            folder / f"visibility-{visibility_key}",
            {"bits": ((GROUP, 6 * texels**2 // 8), np.dtype(np.uint8)), "rays": ((1,), np.dtype(np.int64))},
            len(receivers.filled),
        )
        rays = _trace_groups(visibility, receivers, here.geometry, texels, method.rays, report)

    materials, notes, every = [], [], []
    if gather:
        gather = gather.with_visibility(visibility)
    stage = f"bounce {method.bounces}" if gather else "transport"
    with timed(seconds, stage):
        for material in here.materials(grey=method.receivers == "vertices"):
            direct = [(reflection, record) for reflection, record in material.in_rows if not is_filtered(record)]
            for part in material.parts:
                if method.coefficients != "all" and not is_filtered(part.record):
                    key = store.key_of(visibility_key, part.key, compression(method).dial)
                    part.record["transport"] = f"transport-{key}"
                if gather:
                    key = store.key_of(visibility_key, part.key, shared(method).dial, gather.key)
                    part.record["bounced"] = f"bounced-{key}"
            if method.coefficients != "all" and direct:
                rows = MaterialRows(folder, receivers, material.groups, direct)
                rows.direct(method, visibility, functools.partial(report, f"transport of {material.name}"))
            if gather:
                rows = MaterialRows(folder, receivers, material.groups, material.in_rows)
                gather_report = functools.partial(report, f"{stage} on {material.name}")
                rows.gathered("bounced", shared(method), gather, gather_report)
            for reflection, record in direct:
                layer = store.open_layer(folder / record["transport"]) if "transport" in record else None
                every.append(DirectRows(material.name, material.groups, reflection, layer))
            materials += [part.record for part in material.parts]
            notes += material.notes

    filtered = None
    if any(record["reflection"] == "filtered" for record in materials):
        with timed(seconds, "filtered visibility"):
            filtered = _filter_visibility(visibility, visibility_key, receivers, method, folder, report).folder.name
    if any(here.geometry.normal_maps) and method.receivers == "vertices":
        notes.append(
            "normal maps are sampled at vertices, but for filtered lobes; their detail between vertices is lost; "
            "--receivers pixels has it"
        )
    lights = write_lights(folder, scene.lights.local)
    header = here.header(materials, lights, visibility=visibility.folder.name, filtered=filtered)
    gather_rays = gather.rays if gather else NO_RAYS
    return BuiltLayers(
        folder=folder,
        header=header,
        geometry=here.geometry,
        rays=rays,
        notes=tuple(notes),
        gather_rays=gather_rays,
        rows=tuple(every),
        finer=here.finer,
    )


def check_terms_of(scene: Scene, name: str, method: Transport) -> None:
    """Refuses a number of factors that cannot be had, before any ray."""
    brdfs = [part.brdf for part in as_material(scene.materials[name]).components]
    factored = any(not brdf.is_constant and not isinstance(brdf, Separable) for brdf in brdfs)
    if factored and method.receivers == "vertices":
        try:
            scene.factors.get(name, Factoring()).check(method.terms, method.factor_resolution)
        except InputError as error:
            raise InputError(f"{scene.name}: material '{name}': {error}") from None


def _trace_groups(
    layer: store.Layer, receivers: Receivers, geometry: SceneGeometry, texels: int, mode: str, report: Report
) -> int:
    counts, tracer, directions = [], geometry.tracer, cubemap.directions(texels)
    occluders = Occluders(geometry.surfaces) if mode == "adaptive" and layer.missing else None

    def trace(group: int) -> None:
        rays = receivers.origins[group], receivers.normals[group]
        if occluders is None:
            bits, count = trace_visibility(tracer, *rays, directions)
        else:
            bits, count = trace_adaptively(tracer, occluders, *rays, texels)
        layer.write(group, bits=bits, rays=np.array([count]))
        counts.append(count)

    complete([layer], receivers.filled, trace, functools.partial(report, "visibility"))
    return sum(counts)


def _filter_visibility(
    visibility: store.Layer, key: str, receivers: Receivers, method: Transport, folder: pathlib.Path, report: Report
) -> store.Layer:
    """Completes the layer of filtered visibility, from the visibility of all receivers; no ray."""
    layer = store.make_layer(
        folder / f"filtered-{store.key_of(key, CELLS, MAX_ANGLE)}",
        {"codes": ((GROUP, point_count(CELLS)), np.dtype(np.int8))},
        len(receivers.filled),
    )
    if layer.missing:
        directions = bake.directions_for(method.resolution, method.samples_per_side)

        def filter_group(group: int) -> None:
            frames = frames_of(receivers, np.array([group]))[0]
            codes = visibility_distances(visibility.read("bits", group), frames.astype(np.float32), directions)
            layer.write(group, codes=np.asarray(codes))

        complete([layer], receivers.filled, filter_group, functools.partial(report, "filtered visibility"))
    return layer
