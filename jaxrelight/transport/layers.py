"""The layers of a store, each reused where it can be: geometry → visibility → factors, transport."""

import concurrent.futures
import contextlib
import dataclasses
import functools
import importlib.metadata
import os
import pathlib
import random
import time
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import threadpoolctl

from jaxrelight import store
from jaxrelight.basis import cubemap
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factors import COSINE, check_terms, factor
from jaxrelight.brdf.material import as_material, in_grey
from jaxrelight.brdf.record import to_record
from jaxrelight.brdf.reflection import Reflection, of_group
from jaxrelight.brdf.separable import Separable
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.spatial_factors import Left, SpatialFactors, factor_spatial, without_diffuse
from jaxrelight.brdf.texture import Texture
from jaxrelight.errors import InputError
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.environment import Environment
from jaxrelight.scene import Scene
from jaxrelight.transport.bounce import Gather
from jaxrelight.transport.compression import Clusters, Rows, compression
from jaxrelight.transport.load import Placed, fixed_view, frames_of, read_factors, read_spatial_factors, receivers_of
from jaxrelight.transport.settings import Settings
from jaxrelight.transport.visibility import trace_visibility

# Told the stage, how many receivers are done and how many there are.
Report = Callable[[str, int, int], None]


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
    with _timed(seconds, "geometry"):
        surfaces = scene.surfaces()
        names = sorted({part.material for part in scene.parts})
        material_of_mesh = np.array([names.index(part.material) for part in scene.parts])
        shapes = [[part.mesh.vertices, part.mesh.faces, part.mesh.normals] for part in scene.parts]
        geometry_key = store.key_of(shapes, surfaces.two_sided)
        folder = pathlib.Path(folder or store.default_folder(geometry_key))
        # No ray depends on texture coordinates.
        whole_key = store.key_of(geometry_key, surfaces.uv, surfaces.uv_tangents)
        tracer = Tracer(surfaces)
        bumps = [as_material(scene.materials[part.material]).normal_map for part in scene.parts]
        receivers, seen = receivers_of(surfaces, tracer, material_of_mesh, bumps, scene.camera, settings)
        if not receivers.count:
            raise InputError(
                f"{scene.name}: the camera sees no surface; give it another target, or precompute vertices"
            )
        _make_folder(folder)
        geometry = _write_geometry(folder / f"geometry-{whole_key}", surfaces)

    camera_key = dataclasses.astuple(scene.camera) if settings.receivers == "pixels" else None
    footprint = seen.footprint if seen else None
    bumps_key = [whole_key, footprint, *(np.asarray(b.pixels) if b else None for b in bumps)] if any(bumps) else None
    dials = settings.resolution, settings.visibility_samples, GROUP
    visibility_key = store.key_of(geometry_key, material_of_mesh, _plain(camera_key), *dials, bumps_key)
    directions = cubemap.directions(settings.resolution * settings.samples_per_side)
    with _timed(seconds, "visibility"):
        visibility = store.make_layer(
            folder / f"visibility-{visibility_key}",
            {"bits": ((GROUP, len(directions) // 8), np.dtype(np.uint8))},
            len(receivers.filled),
        )
        rays = _trace_groups(visibility, receivers, tracer, directions, report)

    materials, notes = [], []
    stage = f"bounce {settings.bounces}" if gather else "transport"
    with _timed(seconds, stage):
        frames_key = store.key_of(surfaces.tangents) if surfaces.uv_tangents.any() else None
        for number, name in enumerate(names):
            groups = receivers.groups_of(number)
            if not len(groups):
                continue
            terms = scene.terms.get(name, settings.terms)
            material = as_material(scene.materials[name])
            if settings.receivers == "vertices":
                material = in_grey(without_diffuse(material))
            bump = _write_texture(folder, material.normal_map) if material.normal_map else None
            mine: list[tuple[Reflection, dict]] = []
            for component in material.components:
                brdf = component.brdf
                described = to_record(brdf, functools.partial(_write_table, folder))
                reflection, factors, left = _factors(folder, brdf, described, terms, settings)
                if left and reflection:
                    notes.append(
                        f"{name}: the shapes that stand for the lobes of all texels are {left.shapes:.1%} off, and "
                        f"{reflection.terms} terms leave {left.terms:.0%} of them; --terms is the dial"
                    )
                reflection = reflection or fixed_view(brdf, receivers, groups)
                weight = [_write_texture(folder, texture) for texture in component.weight]
                record = {"name": name, "number": number, "brdf": described, "factors": factors, "weight": weight}
                record["normal_map"] = bump
                if material.emission is not None and component is material.components[0]:
                    record["emission"] = material.emission.tolist()
                more = []
                if isinstance(brdf, SpatialLobes) and settings.receivers == "pixels":
                    more.append(store.key_of(surfaces.uv, footprint))
                # The name of the factors tells their number and their resolution.
                key = functools.partial(store.key_of, visibility_key, number, described, factors, frames_key, *more)
                if settings.coefficients != "all":
                    record["transport"] = f"transport-{key(compression(settings).dial)}"
                if gather:
                    record["bounced"] = f"bounced-{key(Clusters(settings).dial, gather.key)}"
                mine.append((reflection, record))
            baked = _Baked(folder, visibility, receivers, groups, mine)
            if settings.coefficients != "all":
                baked.direct(compression(settings), functools.partial(report, f"transport of {name}"))
            if gather:
                baked.bounced(Clusters(settings), gather, functools.partial(report, f"{stage} on {name}"))
            materials += [record for _, record in mine]

    header = {
        "jaxrelight": importlib.metadata.version("jaxrelight"),
        "scene": scene.name,
        "settings": dataclasses.asdict(settings),
        "geometry": geometry.folder.name,
        "visibility": visibility.folder.name,
        "material_of_mesh": material_of_mesh.tolist(),
        "materials": materials,
        "camera": _plain(dataclasses.asdict(scene.camera)),
        "environment": _write_environment(folder, scene.environment),
    }
    if any(bumps) and settings.receivers == "vertices":
        notes.append(
            "normal maps are sampled at vertices, their detail between them is lost; --receivers pixels has it"
        )
    placed = Placed(surfaces, tuple(bumps), tracer, receivers, seen)
    return Made(folder, header, placed, rays, tuple(notes))


class _timed:  # noqa: N801 - reads as a verb
    """Adds the seconds of a block to a table."""

    def __init__(self, seconds: dict[str, float], stage: str):
        self._seconds, self._stage = seconds, stage

    def __enter__(self):
        self._start = time.perf_counter()

    def __exit__(self, *_):
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + time.perf_counter() - self._start


def _plain(value):
    """Numbers as JSON knows them."""
    return jax.tree.map(lambda x: x.item() if isinstance(x, np.generic) else x, value)


def check_terms_of(scene: Scene, name: str, settings: Settings):
    """Refuses a number of factors that cannot be had, before any ray."""
    brdfs = [part.brdf for part in as_material(scene.materials[name]).components]
    factored = any(not brdf.is_constant and not isinstance(brdf, Separable) for brdf in brdfs)
    if factored and settings.receivers == "vertices":
        try:
            check_terms(scene.terms.get(name, settings.terms), settings.factor_resolution)
        except InputError as error:
            raise InputError(f"{scene.name}: material '{name}': {error}") from None


def _make_folder(folder: pathlib.Path):
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be used as a store: {error.strerror}") from None


def _write_once(folder: pathlib.Path, arrays: dict[str, np.ndarray]) -> store.Layer:
    """A layer of a single group, if it is not there yet."""
    layer = store.make_layer(folder, {name: (a.shape, a.dtype) for name, a in arrays.items()}, 1)
    if layer.missing:
        layer.write(0, **arrays)
    return layer


def _write_geometry(folder: pathlib.Path, surfaces: Surfaces) -> store.Layer:
    return _write_once(
        folder,
        {
            "vertices": surfaces.vertices,
            "normals": surfaces.normals,
            "faces": surfaces.faces,
            "uv": surfaces.uv,
            "mesh_of_vertex": surfaces.mesh_of_vertex,
            "two_sided": surfaces.two_sided,
            "uv_tangents": surfaces.uv_tangents,
            "placement": np.array([*surfaces.centre, surfaces.radius]),
        },
    )


def _write_environment(folder: pathlib.Path, environment: Environment | None) -> dict | None:
    """The scene's own light: its layer, and how it is placed."""
    if environment is None:
        return None
    layer = _write_once(folder / f"environment-{store.key_of(environment.pixels)}", {"pixels": environment.pixels})
    return {"pixels": layer.folder.name, "rotate_y": environment.rotate_y, "scale": environment.scale}


def _write_texture(folder: pathlib.Path, texture: Texture) -> str | list[float]:
    """The name of a texture's layer; the values of a constant one."""
    if texture.is_constant:
        return np.asarray(texture.pixels[0, 0]).tolist()
    pixels = np.asarray(texture.pixels)
    return _write_once(folder / f"texture-{store.key_of(pixels)}", {"pixels": pixels}).folder.name


def _write_table(folder: pathlib.Path, values: np.ndarray) -> str:
    """The name of the layer of a BRDF's long array."""
    return _write_once(folder / f"table-{store.key_of(values)}", {"values": values}).folder.name


def _factors(
    folder: pathlib.Path, brdf: Brdf | SpatialLobes, described: dict, terms: int, settings: Settings
) -> tuple[Factored | SpatialFactors | None, str | None, Left | None]:
    """Factors, from their layer if it exists, its name, and what those of a spatial BRDF leave out.

    None for pixels unless the BRDF is constant. What is given as factors is taken as it is, whatever the settings say.
    """
    if settings.receivers == "pixels" and not brdf.is_constant:
        return None, None, None
    dials = () if isinstance(brdf, Separable) else (terms, settings.factor_resolution, *COSINE)
    key = store.key_of(described, *dials)
    path = folder / f"factors-{key}"
    spatial = isinstance(brdf, SpatialLobes)
    with contextlib.suppress(InputError):
        layer = store.open_layer(path)
        if spatial:
            return read_spatial_factors(layer), path.name, Left(*layer.read("left", 0).tolist())
        return read_factors(layer), path.name, None
    # Missing or damaged.
    if spatial:
        made, left = factor_spatial(brdf, terms, settings.factor_resolution)
        arrays = {"light_maps": made.light_maps, "view_maps": made.view_maps, "weights": made.weights.pixels}
        numbers = {"left": np.array(dataclasses.astuple(left))}
        _write_once(path, {name: np.asarray(array) for name, array in (arrays | numbers).items()})
        return made, path.name, left
    factors = brdf.factors if isinstance(brdf, Separable) else factor(brdf, terms, settings.factor_resolution)
    _write_once(path, {"light_maps": np.asarray(factors.light_maps), "view_maps": np.asarray(factors.view_maps)})
    return factors, path.name, None


def _complete(
    layers: Sequence[store.Layer],
    filled: np.ndarray,
    make: Callable[[int], None],
    report: Callable[[int, int], None],
):
    """Runs make(group), which writes it, for all groups that a layer lacks, on all cores; stops at the first error.

    `filled` counts the receivers of each group.
    """

    def tell():
        done = list(set[int].intersection(*(layer.done for layer in layers)))
        report(int(filled[done].sum()), int(filled.sum()))

    missing = sorted({group for layer in layers for group in layer.missing})
    if missing:
        tell()
    # Another process may be at the same layer: in another order, so that they share the work.
    random.Random(os.getpid()).shuffle(missing)

    def make_if_missing(group: int):
        if not all(layer.has(group) for layer in layers):
            make(group)

    # Groups are what runs at once: threads of their linear algebra would only wait for each other.
    threads = os.cpu_count()
    with threadpoolctl.threadpool_limits(1), concurrent.futures.ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(make_if_missing, group) for group in missing]
        try:
            for future in concurrent.futures.as_completed(futures):
                future.result()
                tell()
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

    _complete([layer], receivers.filled, trace, functools.partial(report, "visibility"))
    return sum(rays)


@dataclasses.dataclass(frozen=True)
class _Baked:
    """The rows of the groups of one material.

    Attributes:
        folder: the store.
        visibility: of all receivers.
        receivers: all of them.
        groups: those of the material.
        each: the reflections of its BRDFs, and the records that name their layers.
    """

    folder: pathlib.Path
    visibility: store.Layer
    receivers: Receivers
    groups: np.ndarray
    each: list[tuple[Reflection, dict]]

    def direct(self, kept: Rows | Clusters, report: Callable[[int, int], None]):
        """Completes the layers of direct light."""
        layers = self._layers("transport", [kept.layout(one.terms, one.channels) for one, _ in self.each])

        def make(i: int, frames, lacking: list[int]):
            bits = jnp.asarray(self.visibility.read("bits", int(self.groups[i])))
            for number in lacking:
                reflection = of_group(self.each[number][0], i)
                layers[number].write(i, **kept.compress(bits, frames, reflection))

        self._complete(layers, make, report)

    def bounced(self, kept: Clusters, gather: Gather, report: Callable[[int, int], None]):
        """Completes the layers of bounced light: receivers look around once for all that they reflect."""
        channels, layouts = max(gather.channels, *(one.channels for one, _ in self.each)), []
        for reflection, _ in self.each:
            layouts.append(kept.layout(reflection.terms, channels))
            if gather.emits:
                layouts[-1]["emitted"] = (GROUP, reflection.terms, channels), np.dtype(np.float32)
        layers = self._layers("bounced", layouts)

        def make(i: int, frames, lacking: list[int]):
            mine = [of_group(self.each[number][0], i) for number in lacking]
            found = gather.rows(self.receivers, int(self.groups[i]), frames, mine, channels)
            for number, one in zip(lacking, found, strict=True):
                more = {} if one.emitted is None else {"emitted": one.emitted}
                layers[number].write(i, **kept.compress_rows(one.rows, one.columns), **more)

        self._complete(layers, make, report)

    def _layers(self, kind: str, layouts) -> list[store.Layer]:
        names = [record[kind] for _, record in self.each]
        pairs = zip(names, layouts, strict=True)
        return [store.make_layer(self.folder / name, layout, len(self.groups)) for name, layout in pairs]

    def _complete(self, layers: Sequence[store.Layer], make, report: Callable[[int, int], None]):
        """Runs make(group, frames, numbers of the layers that lack it)."""
        if not any(layer.missing for layer in layers):
            return
        frames = frames_of(self.receivers, self.groups)

        def make_lacking(i: int):
            make(i, frames[i], [number for number, layer in enumerate(layers) if not layer.has(i)])

        _complete(layers, self.receivers.filled[self.groups], make_lacking, report)
