"""From a store to the operator, and to all that is needed to light and to view with it."""

import dataclasses
import functools
import pathlib

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.normal_maps import NormalMaps, at_vertices, see
from jaxrelight.brdf.record import from_record
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.spatial_factors import SpatialFactors
from jaxrelight.brdf.texture import Texture, constant
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.gather.gather_cloud import GatherCloud, cloud_receivers
from jaxrelight.gather.lit_cloud import LitCloud
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.receivers import Receivers, pixel_receivers, vertex_receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.local import Light
from jaxrelight.lights.record import from_records
from jaxrelight.methods import Settings
from jaxrelight.operators.algebra import InBasis, Summed
from jaxrelight.operators.contract import Basis
from jaxrelight.operators.stacked import Stacked
from jaxrelight.transport.compression import compression, of_cloud, shared
from jaxrelight.transport.model import Block, Transport, fixed_view, streamed


@dataclasses.dataclass(frozen=True)
class Placed:
    """The geometry of a scene, ready for rays, and its receivers.

    Attributes:
        surfaces: all meshes.
        normal_maps: theirs.
        tracer: rays against them.
        receivers: the points of the operator's rows.
        seen: what the scene's camera sees, where receivers are its pixels.
    """

    surfaces: Surfaces
    normal_maps: NormalMaps
    tracer: Tracer
    receivers: Receivers
    seen: GBuffer | None


def load(folder: str | pathlib.Path, header: dict | None = None, placed: Placed | None = None) -> Transport:
    """Opens a store; nothing is written.

    Args:
        folder: the store.
        header: of the scene that is wanted, as `precompute` gives it; by default of the last one precomputed.
        placed: its geometry, as `precompute` gives it; by default read from the store.

    Raises:
        InputError: if it is not complete, damaged, or of another format; if a BRDF or a light is of a class of one's
            own that is not known: its module must be imported before, see `jaxrelight.files.class_record`.
    """
    folder = pathlib.Path(folder)
    header = header or store.read_header(folder)
    try:
        return _load(folder, header, placed)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(
            f"{folder / 'store.json'}: damaged ({type(error).__name__}: {error}); "
            "run precompute again, finished layers will be reused"
        ) from None


def _load(folder: pathlib.Path, header: dict, placed: Placed | None) -> Transport:
    store.layers_of(header)  # refuses names of anything else before any is opened
    settings = Settings(**header["settings"])
    camera = Camera(**header["camera"])
    placed = placed or _placed(folder, header, camera, settings)
    surfaces, receivers = placed.surfaces, placed.receivers
    cloud = _read_cloud(folder, header, settings) if settings.gather_samples else None
    visibility = None if cloud else _whole_layer(folder / header["visibility"])
    if visibility and len(receivers.filled) != visibility.groups:
        raise InputError(f"{folder}: geometry and visibility do not belong together; precompute again")
    if {record["number"] for record in header["materials"]} != set(receivers.material_of_group.tolist()):
        raise ValueError("materials and meshes do not belong together")
    blocks, operators, total = [], [], 0.0
    for record in header["materials"]:
        called = f"the store's material '{record['name']}'"
        brdf = from_record(record["brdf"], functools.partial(_read_table, folder), what=called)
        groups = receivers.groups_of(record["number"])
        if record["factors"]:
            read = read_spatial_factors if isinstance(brdf, SpatialLobes) else read_factors
            reflection = read(store.open_layer(folder / record["factors"]))
        else:
            reflection = fixed_view(brdf, receivers, groups)
        dropped, emitted = None, None
        if cloud:
            layer = _layer_of(folder / record["indirect"], groups)
            direct = of_cloud(settings, np.ones(settings.gather_samples)).open(layer)
            operator, dropped = direct.operator, direct.dropped
            total += float(direct.total.sum(dtype=float)) * 3 / dropped.shape[1]
        elif settings.coefficients == "all":
            assert visibility is not None
            operator = streamed(settings, visibility, receivers, groups, reflection)
        else:
            direct = compression(settings).open(_layer_of(folder / record["transport"], groups))
            operator, dropped = direct.operator, direct.dropped
            total += float(direct.total.sum(dtype=float)) * 3 / dropped.shape[1]
        if settings.bounces and not cloud:
            layer = _layer_of(folder / record["bounced"], groups)
            bounced = shared(settings).open(layer)
            if dropped is None:
                operator = Summed((operator, InBasis(bounced.operator, HaarFaces(settings.resolution))))
            else:
                operator = Summed((operator, bounced.operator))
                # What a row leaves out is a sum of two: no longer than both.
                dropped = np.square(np.sqrt(dropped) + np.sqrt(bounced.dropped))
                total += float(bounced.total.sum(dtype=float)) * 3 / bounced.total.shape[1]
            if "emitted" in layer.arrays:
                emitted = layer.read("emitted")
                emitted = emitted.reshape(-1, *emitted.shape[2:])
        operators.append(operator)
        weight = tuple(read_texture(folder, entry) for entry in record["weight"])
        emission = np.asarray(record["emission"], np.float32) if record.get("emission") else None
        blocks.append(Block(record["name"], brdf, weight, reflection, groups, dropped, emission, emitted))
    dropped = [block.dropped for block in blocks if block.dropped is not None]
    left = sum(float(part.sum(dtype=float)) * 3 / part.shape[1] for part in dropped)
    names = {record["number"]: record["name"] for record in header["materials"]}
    environment = header["environment"] or {"pixels": None, "rotate_y": 0.0, "scale": 1.0}
    return Transport(
        settings=settings,
        surfaces=at_vertices(surfaces, placed.normal_maps) if settings.receivers == "vertices" else surfaces,
        normal_maps=() if settings.receivers == "vertices" else placed.normal_maps,
        tracer=placed.tracer,
        seen=placed.seen,
        receivers=receivers,
        blocks=tuple(blocks),
        operator=Stacked(tuple(operators)),
        basis=_basis(settings),
        kept=1 - left / total if total else 1.0,
        camera=camera,
        environment=store.open_layer(folder / environment["pixels"]) if environment["pixels"] else None,
        rotate_y=environment["rotate_y"],
        scale=environment["scale"],
        folder=folder,
        visibility=visibility,
        cloud=cloud,
        lights=_read_lights(folder, header.get("lights")),
        material_of_mesh=tuple(names.get(number) for number in header["material_of_mesh"]),
    )


def _basis(settings: Settings) -> Basis:
    """That of light."""
    if settings.gather_samples:
        return HaarFaces(round(settings.gather_samples**0.5), 1)
    return cubemap.Texels(settings.resolution) if settings.coefficients == "all" else HaarFaces(settings.resolution)


def _read_cloud(folder: pathlib.Path, header: dict, settings: Settings) -> LitCloud:
    layer, reflected = _whole_layer(folder / header["cloud"]), _whole_layer(folder / header["albedo"])
    points = GatherCloud(*(layer.read(field.name, 0) for field in dataclasses.fields(GatherCloud)))
    between, receivers = None, cloud_receivers(points)
    if header["between"]:
        rows = _layer_of(folder / header["between"], np.arange(len(receivers.filled)))
        between = of_cloud(settings, np.ones(settings.gather_samples)).open(rows).operator
    return LitCloud(points, reflected.read("albedo", 0), reflected.read("emission", 0), between, receivers.slot_of)


def _read_lights(folder: pathlib.Path, entry: dict | None) -> tuple[Light, ...]:
    if not entry:
        return ()
    layer = _whole_layer(folder / entry["layer"])
    return from_records(entry["each"], lambda name: layer.read(name, 0))


def _placed(folder: pathlib.Path, header: dict, camera: Camera, settings: Settings) -> Placed:
    surfaces = _read_geometry(_whole_layer(folder / header["geometry"]))
    tracer = Tracer(surfaces)
    entries = {record["number"]: record["normal_map"] for record in header["materials"]}
    maps = {number: read_texture(folder, entry) for number, entry in entries.items() if entry is not None}
    normal_maps = tuple(maps.get(number) for number in header["material_of_mesh"])
    material_of_mesh = np.array(header["material_of_mesh"])
    receivers, seen = receivers_of(surfaces, tracer, material_of_mesh, normal_maps, camera, settings)
    return Placed(surfaces, normal_maps, tracer, receivers, seen)


def _layer_of(folder: pathlib.Path, groups: Int[np.ndarray, " g"]) -> store.Layer:
    """A layer of some groups' rows."""
    layer = _whole_layer(folder)
    if layer.groups != len(groups):
        raise InputError(f"{folder}: geometry and transport do not belong together; precompute again")
    return layer


def _whole_layer(folder: pathlib.Path) -> store.Layer:
    layer = store.open_layer(folder)
    if layer.missing:
        raise InputError(
            f"{folder}: {len(layer.missing):,} of {layer.groups:,} parts are missing; run precompute to complete them"
        )
    return layer


def stored_environment(transport: Transport) -> Environment | None:
    """The environment of the scene that the store was made from."""
    if transport.environment is None:
        return None
    return Environment(transport.environment.read("pixels", 0), transport.rotate_y, transport.scale)


def _read_geometry(layer: store.Layer) -> Surfaces:
    placement = layer.read("placement", 0)
    return Surfaces(
        *(layer.read(name, 0) for name in ("vertices", "normals", "faces", "uv", "mesh_of_vertex")),
        *(layer.read(name, 0) for name in ("two_sided", "uv_tangents")),
        centre=placement[:3],
        radius=float(placement[3]),
    )


def receivers_of(
    surfaces: Surfaces,
    tracer: Tracer,
    material_of_mesh: np.ndarray,
    normal_maps: NormalMaps,
    camera: Camera,
    settings: Settings,
) -> tuple[Receivers, GBuffer | None]:
    """The receivers that the settings ask for, and what is seen where they are pixels.

    They follow from the geometry, so that no store need hold them.
    """
    if settings.receivers == "vertices":
        return vertex_receivers(at_vertices(surfaces, normal_maps), material_of_mesh), None
    seen = see(surfaces, tracer, camera, normal_maps)
    return pixel_receivers(seen, material_of_mesh), seen


def read_factors(layer: store.Layer) -> Factored:
    """Factors from their layer."""
    return Factored(*jax.device_put((layer.read("light_maps", 0), layer.read("view_maps", 0))))


def read_spatial_factors(layer: store.Layer) -> SpatialFactors:
    """Factors shared by a map of BRDFs from their layer."""
    light, view = jax.device_put((layer.read("light_maps", 0), layer.read("view_maps", 0)))
    return SpatialFactors(light, view, _minified(layer.read("weights", 0)))


def read_texture(folder: pathlib.Path, entry: str | list[float]) -> Texture:
    """A texture from its layer, or a constant one from its values."""
    if isinstance(entry, str):
        return _minified(store.open_layer(folder / entry).read("pixels", 0))
    return constant(entry)


@jax.jit
def _minified(pixels: Float[Array, "h w c"]) -> Texture:
    return Texture(pixels).minified()


def _read_table(folder: pathlib.Path, name: str) -> np.ndarray:
    """A long array of a BRDF, from its layer."""
    return store.open_layer(folder / name).read("values", 0)
