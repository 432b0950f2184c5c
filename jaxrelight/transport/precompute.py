"""From a scene to a store, by stages that are reused where they can be: geometry → visibility → factors, transport."""

import collections
import concurrent.futures
import dataclasses
import importlib.metadata
import os
import pathlib
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight import store
from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factors import COSINE, Factored, factor
from jaxrelight.brdf.record import to_record
from jaxrelight.brdf.reflection import Reflection, of_group
from jaxrelight.errors import InputError
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.operators.sparse_rows import smallest_index_type
from jaxrelight.scene import Scene
from jaxrelight.transport import bake
from jaxrelight.transport.load import fixed_view, frames_of, read_factors, receivers_of
from jaxrelight.transport.settings import Settings
from jaxrelight.transport.visibility import trace_visibility

# Told the stage, how many groups are done and how many there are.
Report = Callable[[str, int, int], None]


@dataclasses.dataclass(frozen=True)
class Summary:
    """What a precomputation did.

    Attributes:
        folder: the store.
        seconds: by stage; stages that were found done take next to nothing.
        rays: traced in this run.
        receivers: number of vertices or pixels.
        nbytes: on disk, by kind of layer.
    """

    folder: pathlib.Path
    seconds: dict[str, float]
    rays: int
    receivers: int
    nbytes: dict[str, int]


def precompute(
    scene: Scene,
    settings: Settings = Settings(),
    folder: str | pathlib.Path | None = None,
    report: Report = lambda stage, done, total: None,
) -> Summary:
    """Makes, or completes, the store of a scene.

    Layers that exist are reused: a changed material bakes its own groups again, from stored visibility; only a changed
    mesh, or camera where receivers are pixels, is traced again. A run that was stopped goes on where it was.

    Args:
        scene: what to precompute; its environment is stored as the default light.
        settings: the dials.
        folder: the store; by default one in the user's cache folder, named by the geometry.
        report: called after every group.
    """
    seconds: dict[str, float] = {}
    with _timed(seconds, "geometry"):
        for part in scene.parts:
            if part.material not in scene.materials:
                raise InputError(f"{scene.name}: '{part.name}' is of a material '{part.material}' that is not given")
        surfaces = join([part.mesh for part in scene.parts])
        names = sorted({part.material for part in scene.parts})
        material_of_mesh = np.array([names.index(part.material) for part in scene.parts])
        geometry_key = store.key_of(
            [[part.mesh.vertices, part.mesh.faces, part.mesh.normals] for part in scene.parts], store.FORMAT
        )
        folder = pathlib.Path(folder or store.default_folder(geometry_key))
        _make_folder(folder)
        geometry = _write_geometry(folder / f"geometry-{geometry_key}", surfaces)
        tracer = Tracer(surfaces)
        receivers = receivers_of(surfaces, tracer, material_of_mesh, scene.camera, settings)
        if not receivers.count:
            raise InputError(f"{scene.name}: the camera sees no surface; there is nothing to precompute")

    camera_key = dataclasses.astuple(scene.camera) if settings.receivers == "pixels" else None
    visibility_key = store.key_of(
        geometry_key, material_of_mesh, _plain(camera_key), settings.resolution, settings.visibility_samples, GROUP
    )
    directions = cubemap.directions(settings.resolution * settings.samples_per_side)
    with _timed(seconds, "visibility"):
        visibility = store.Layer(
            folder / f"visibility-{visibility_key}",
            {"bits": ((GROUP, len(directions) // 8), np.dtype(np.uint8))},
            len(receivers.filled),
        )
        rays = _trace_groups(visibility, receivers, tracer, directions, report)

    materials = []
    with _timed(seconds, "transport"):
        frames = frames_of(receivers)
        for number, name in enumerate(names):
            brdf, groups = scene.materials[name], receivers.groups_of(number)
            if not len(groups):
                continue
            terms = scene.terms.get(name, settings.terms)
            reflection, factors = _factors(folder, brdf, terms, settings)
            reflection = reflection or fixed_view(brdf, receivers, groups)
            record = {"name": name, "brdf": to_record(brdf), "factors": factors}
            if settings.coefficients != "all":
                # The name of the factors tells their number and their resolution.
                key = store.key_of(visibility_key, number, record["brdf"], factors, settings.coefficients)
                layer = _transport_layer(folder / f"transport-{key}", reflection, settings, len(groups))
                _bake_groups(layer, visibility, groups, frames[groups], reflection, settings, name, report)
                record["transport"] = layer.folder.name
            materials.append(record)

    environment = None
    if scene.environment is not None:
        from jaxrelight.images import write_image

        write_image(folder / "environment.exr", scene.environment.pixels)
        environment = {"rotate_y": scene.environment.rotate_y, "scale": scene.environment.scale}
    store.write_header(
        folder,
        {
            "jaxrelight": importlib.metadata.version("jaxrelight"),
            "scene": scene.name,
            "settings": dataclasses.asdict(settings),
            "geometry": geometry.folder.name,
            "visibility": visibility.folder.name,
            "material_of_mesh": material_of_mesh.tolist(),
            "materials": materials,
            "camera": _plain(dataclasses.asdict(scene.camera)),
            "environment": environment,
        },
    )
    layers = [geometry.folder, visibility.folder]
    layers += [folder / record[kind] for record in materials for kind in ("factors", "transport") if record.get(kind)]
    nbytes = collections.Counter()
    for layer in set(layers):
        nbytes[layer.name.split("-")[0]] += store.open_layer(layer).nbytes
    return Summary(folder, seconds, rays, receivers.count, dict(nbytes))


class _timed:  # noqa: N801 - reads as a verb
    """Adds the seconds of a block to a table."""

    def __init__(self, seconds: dict[str, float], stage: str):
        self._seconds, self._stage = seconds, stage

    def __enter__(self):
        self._start = time.perf_counter()

    def __exit__(self, *_):
        self._seconds[self._stage] = time.perf_counter() - self._start


def _plain(value):
    """Numbers as JSON knows them."""
    return jax.tree.map(lambda x: x.item() if isinstance(x, np.generic) else x, value)


def _make_folder(folder: pathlib.Path):
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be used as a store: {error.strerror}") from None


def _write_geometry(folder: pathlib.Path, surfaces: Surfaces) -> store.Layer:
    arrays = {
        "vertices": surfaces.vertices,
        "normals": surfaces.normals,
        "faces": surfaces.faces,
        "mesh_of_vertex": surfaces.mesh_of_vertex,
        "placement": np.array([*surfaces.centre, surfaces.radius]),
    }
    layer = store.Layer(folder, {name: (a.shape, a.dtype) for name, a in arrays.items()}, 1)
    if layer.missing:
        layer.write(0, **arrays)
        layer.finish()
    return layer


def _factors(folder: pathlib.Path, brdf: Brdf, terms: int, settings: Settings) -> tuple[Factored | None, str | None]:
    """Factors, from their layer if it exists, and its name; none for pixels unless the BRDF is constant."""
    if settings.receivers == "pixels" and not brdf.is_constant:
        return None, None
    key = store.key_of(to_record(brdf), terms, settings.factor_resolution, *COSINE)
    path = folder / f"factors-{key}"
    if path.exists():
        layer = store.open_layer(path)
        if not layer.missing:
            return read_factors(layer), path.name
    factors = factor(brdf, terms, settings.factor_resolution)
    arrays = {"light_maps": np.asarray(factors.light_maps), "view_maps": np.asarray(factors.view_maps)}
    layer = store.Layer(path, {name: (a.shape, a.dtype) for name, a in arrays.items()}, 1)
    layer.write(0, **arrays)
    layer.finish()
    return factors, path.name


def _transport_layer(folder: pathlib.Path, reflection: Reflection, settings: Settings, groups: int) -> store.Layer:
    k, c, n = reflection.terms, reflection.channels, int(settings.coefficients)
    index = smallest_index_type(6 * settings.resolution**2)
    real = np.dtype(np.float32)
    return store.Layer(
        folder,
        {
            "indices": ((GROUP, k, n), index),
            "values": ((GROUP, k, c, n), real),
            "dropped": ((GROUP, k, c), real),
            "total": ((GROUP, k, c), real),
        },
        groups,
    )


def _in_threads(function, items, done: Callable[[], None]):
    """Runs function(item) for all items on all cores, a few ahead; stops at the first error."""
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        futures = [pool.submit(function, item) for item in items]
        try:
            for future in concurrent.futures.as_completed(futures):
                future.result()
                done()
        finally:
            for future in futures:
                future.cancel()


def _trace_groups(layer: store.Layer, receivers: Receivers, tracer: Tracer, directions, report: Report) -> int:
    rays = []

    def trace(group: int):
        arrays = receivers.positions[group], receivers.normals[group], receivers.face_normals[group]
        bits, count = trace_visibility(tracer, *arrays, directions)
        layer.write(group, bits=bits)
        rays.append(count)

    report("visibility", len(layer.done), layer.groups)
    _in_threads(trace, layer.missing, lambda: report("visibility", len(layer.done), layer.groups))
    layer.finish()
    return sum(rays)


def _bake_groups(layer, visibility, groups, frames, reflection, settings: Settings, name: str, report: Report):
    directions = bake.directions_for(settings.resolution, settings.samples_per_side)
    basis = HaarFaces(settings.resolution)
    index = smallest_index_type(6 * settings.resolution**2)

    def make(i: int):
        bits = jnp.asarray(visibility.read("bits", int(groups[i])))
        kept = bake.bake_truncated(
            bits, frames[i], of_group(reflection, i), directions, basis, int(settings.coefficients)
        )
        layer.write(
            i,
            indices=np.asarray(kept.indices).astype(index),
            values=np.asarray(kept.values),
            dropped=np.asarray(kept.dropped),
            total=np.asarray(kept.total),
        )

    stage = f"transport of {name}"
    report(stage, len(layer.done), layer.groups)
    _in_threads(make, layer.missing, lambda: report(stage, len(layer.done), layer.groups))
    layer.finish()
