"""Layers of what pixels gather from a cloud, and what its points gather from each other (Hašan 2006 §4)."""

import dataclasses
import functools
import pathlib

import numpy as np

from jaxrelight.brdf.material import white_lambert
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.files import store
from jaxrelight.gather.cloud_spectrum import cloud_spectrum
from jaxrelight.gather.final_gather import FinalGather
from jaxrelight.gather.gather_cloud import PARTS, PIECES, GatherCloud, cloud_receivers, gather_cloud
from jaxrelight.gather.importance import Importance
from jaxrelight.gather.photon_gather import PhotonGather
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.methods import Indirect
from jaxrelight.numerics.arrays import as_array
from jaxrelight.precomputation.layer_files import made_once, write_lights, write_once
from jaxrelight.precomputation.layers import BuiltLayers
from jaxrelight.precomputation.material_rows import MaterialRows
from jaxrelight.precomputation.placing import place
from jaxrelight.precomputation.surface_albedo import SurfaceAlbedo
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.timing import timed
from jaxrelight.transport.compression import of_cloud


def make_indirect(
    scene: Scene, method: Indirect, folder: str | pathlib.Path | None, report: Report, seconds: dict[str, float]
) -> BuiltLayers:
    """Makes, or completes, all layers of a scene's pixels and its cloud; see `precompute`.

    Args:
        scene: checked already.
        method: the dials.
        folder: the store.
        report: as `precompute` takes it.
        seconds: to which those of each stage are added.
    """
    with timed(seconds, "geometry"):
        here = place(scene, method, folder)
    folder, geometry, surfaces, tracer = here.folder, here.geometry, here.geometry.surfaces, here.geometry.tracer
    with timed(seconds, "cloud"):
        albedo = SurfaceAlbedo(scene, surfaces)
        worth_key = here.receivers_key(albedo.key) if method.importance else None
        made_by = method.gather_samples, method.seed, worth_key, method.sky, PIECES, PARTS, "spectrum"
        cloud_key = store.key_of(here.key, *made_by)

        def make_cloud() -> dict[str, np.ndarray]:
            assert geometry.visible is not None
            worth = Importance(surfaces, tracer, geometry.visible, albedo, seed=method.seed) if worth_key else None
            points = gather_cloud(surfaces, method.gather_samples, worth, method.seed, sky=method.sky)
            spectrum = cloud_spectrum(points, surfaces, tracer, method.seed)
            return {**{field.name: getattr(points, field.name) for field in fields}, "spectrum": spectrum}

        fields = dataclasses.fields(GatherCloud)
        arrays = made_once(folder / f"cloud-{cloud_key}", make_cloud)
        cloud = GatherCloud(*(arrays[field.name] for field in fields))
        reflected, emitted = np.zeros((2, len(cloud.faces), 3), np.float32)
        solid = np.flatnonzero(~cloud.of_sky)
        reflected[solid] = albedo(*(of[solid] for of in (cloud.faces, cloud.barycentric, cloud.back, cloud.areas)))
        emitted[solid] = albedo.emission[surfaces.mesh_of_vertex[surfaces.faces[cloud.faces[solid], 0]]]
        albedo_key = store.key_of(cloud_key, reflected, emitted)
        write_once(folder / f"albedo-{albedo_key}", {"albedo": reflected, "emission": emitted})
        kept = of_cloud(method, arrays["spectrum"])

    gather = FinalGather(cloud, tracer, method.solid_angle, method.near, method.peak)
    dials = kept.dial, method.solid_angle, method.near, GROUP
    between, between_gather = None, gather
    if method.bounces > 1 or method.sky:
        way = dials
        with timed(seconds, "between"):
            if method.photons:
                photons_per_point = max(1, round(method.photons / method.gather_samples))
                way = kept.dial, photons_per_point, method.bounces, method.seed, albedo.key, GROUP
                between_gather = PhotonGather(
                    cloud, surfaces, tracer, albedo, photons_per_point, method.bounces - 1, method.seed
                )
            between = f"between-{store.key_of(cloud_key, *way)}"
            points = cloud_receivers(cloud)
            up = as_array(np.broadcast_to([0.0, 0, 1], (*points.positions.shape[:2], 3)), np.float32)
            reflections: list[tuple[Reflection, dict]] = [(FixedView(white_lambert(), up), {"between": between})]
            rows = MaterialRows(folder, points, np.arange(len(points.filled)), reflections)
            rows.gathered("between", kept, between_gather, functools.partial(report, "light between surfaces"))

    materials, pixels_key = [], here.receivers_key(cloud_key, *dials)
    with timed(seconds, "pixels"):
        for material in here.materials(grey=True):
            # In their peaks points are told apart, for all parts of the material.
            glossy = [part.key for part in material.parts if part.reflection and not part.reflection.is_constant]
            told_apart = [method.peak, *glossy] if glossy else []
            for _, record, key in material.parts:
                record["indirect"] = f"indirect-{store.key_of(pixels_key, key, *told_apart)}"
            rows = MaterialRows(folder, here.receivers, material.groups, material.in_rows)
            rows.gathered("indirect", kept, gather, functools.partial(report, f"pixels of {material.name}"))
            materials += [record for _, record, _ in material.parts]

    layers = {"cloud": f"cloud-{cloud_key}", "albedo": f"albedo-{albedo_key}", "between": between}
    header = here.header(materials, write_lights(folder, scene.lights.local), **layers)
    rays = gather.rays + (between_gather.rays if between_gather is not gather else 0)
    return BuiltLayers(folder, header, geometry, rays, ())
