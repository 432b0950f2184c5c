"""From a store to the operator, and to all that is needed to light and to view with it."""

import dataclasses
import functools
import pathlib
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight import store
from jaxrelight.arrays import as_array
from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.record import from_record
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.brdf.spatial import PackedLobes, SpatialLobes
from jaxrelight.brdf.spatial_factors import SpatialFactors
from jaxrelight.brdf.texture import Texture, Weight, constant
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.receivers import Receivers, pixel_receivers, vertex_receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.local import Light
from jaxrelight.lights.record import from_records
from jaxrelight.operators.algebra import InBasis, Summed
from jaxrelight.operators.contract import Basis, Operator
from jaxrelight.operators.stacked import Stacked
from jaxrelight.operators.streamed import Streamed
from jaxrelight.transport import bake
from jaxrelight.transport.compression import compression, of_cloud, shared
from jaxrelight.transport.gather_cloud import GatherCloud, cloud_receivers
from jaxrelight.transport.normal_maps import NormalMaps, at_vertices, see
from jaxrelight.transport.settings import Settings


@dataclasses.dataclass(frozen=True)
class Block:
    """The operator's rows of one BRDF of one material.

    Attributes:
        material: its name.
        brdf: one of those that the material combines.
        weight: the factor on it over the surface.
        reflection: of the BRDF; arrays that each receiver has for itself lead with groups and receivers.
        groups: of the material's receivers.
        dropped: energy left out of every row by channel, of direct and of bounced light; None where nothing is.
        emission: radiance that the material emits; of its first block alone, None for the others.
        emitted: light terms of what other surfaces emit, by way of bounces; None where there is none.
    """

    material: str
    brdf: Brdf | SpatialLobes
    weight: Weight
    reflection: Reflection
    groups: Int[np.ndarray, " g"]
    dropped: Float[np.ndarray, "r c"] | None
    emission: Float[np.ndarray, "3"] | None = None
    emitted: Float[np.ndarray, "v k c"] | None = None


@dataclasses.dataclass(frozen=True)
class LitCloud:
    """Points that stand for all surfaces, where light comes from that is gathered (Hašan 2006).

    Attributes:
        points: of the cloud.
        albedo: theirs.
        emission: radiance that they emit.
        between: the operator from light of the cloud to what its points get, over π; None where one bounce is all.
        slot_of: the row of `between` that each point has.
    """

    points: GatherCloud
    albedo: Float[np.ndarray, "g c"]
    emission: Float[np.ndarray, "g c"]
    between: Operator | None
    slot_of: Int[np.ndarray, " g"]


@dataclasses.dataclass(frozen=True)
class Transport:
    """What a store holds, ready to light and to view with.

    Attributes:
        settings: the dials it was made with.
        surfaces: the geometry, for views; its normals are bent by normal maps where receivers are vertices.
        normal_maps: of each mesh, where receivers are pixels.
        tracer: rays against it.
        receivers: the points of the operator's rows.
        seen: what the scene's camera sees, where receivers are its pixels.
        blocks: what the operator's rows belong to, in their order: a block for each BRDF of each material seen.
        operator: from light to light terms; its rows are ordered by block, group, receiver and term.
        basis: of the operator's light.
        kept: share of transport energy that the operator keeps.
        camera: the scene's.
        environment: the layer of the scene's own environment, if it has one.
        rotate_y: of that environment.
        scale: of that environment.
        folder: the store.
        visibility: the layer of visibility bits; None where light is of a cloud.
        cloud: where light comes from that is not of the sky.
        lights: the scene's own local lights.
        material_of_mesh: names; None where no receiver is of that mesh's material.
    """

    settings: Settings
    surfaces: Surfaces
    normal_maps: NormalMaps
    tracer: Tracer
    receivers: Receivers
    seen: GBuffer | None
    blocks: tuple[Block, ...]
    operator: Stacked
    basis: Basis
    kept: float
    camera: Camera
    environment: store.Layer | None
    rotate_y: float
    scale: float
    folder: pathlib.Path
    visibility: store.Layer | None
    cloud: LitCloud | None = None
    lights: tuple[Light, ...] = ()
    material_of_mesh: tuple[str | None, ...] = ()

    @property
    def each(self) -> list[tuple[Block, Operator]]:
        """Every block and the operator of its rows: where light bounces, the sum of direct and of bounced light."""
        return list(zip(self.blocks, self.operator.operators, strict=True))

    @property
    def emits(self) -> bool:
        """Whether surfaces emit light."""
        return any(block.emission is not None for block in self.blocks)

    @property
    def names(self) -> list[str]:
        """The material of each block."""
        return [block.material for block in self.blocks]

    @property
    def reflections(self) -> list[Reflection]:
        """The reflection of each block."""
        return [block.reflection for block in self.blocks]


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
        InputError: if it is not complete, damaged, or of another format.
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
        brdf = from_record(record["brdf"], functools.partial(_read_table, folder))
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


def streamed(
    settings: Settings, visibility: store.Layer, receivers: Receivers, groups: np.ndarray, reflection: Reflection
) -> Streamed:
    """The exact operator of one material's groups, reading visibility from its layer."""

    def read_bits(group: int) -> np.ndarray:
        return visibility.read("bits", int(groups[group]))

    directions = bake.directions_for(settings.resolution, settings.samples_per_side)
    return Streamed(read_bits, as_array(frames_of(receivers, groups)), reflection, directions)


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


def frames_of(receivers: Receivers, groups: Int[np.ndarray, " g"]) -> Float[np.ndarray, "g m 3 3"]:
    """The tangent frames of some groups."""
    normals = receivers.normals[groups]
    frames = frames_of_points(normals.reshape(-1, 3), receivers.tangents[groups].reshape(-1, 3))
    return frames.reshape(*normals.shape, 3)


def fixed_view(brdf: Brdf | SpatialLobes, receivers: Receivers, groups: Int[np.ndarray, " g"]) -> FixedView:
    """The exact reflection of some groups of pixel receivers; of a spatial BRDF, each has its own."""
    assert receivers.omega_o is not None
    omega_o: Any = to_local(frames_of(receivers, groups), receivers.omega_o[groups])
    if not isinstance(brdf, SpatialLobes):
        return FixedView(brdf, omega_o)
    assert receivers.uv is not None
    assert receivers.footprint is not None
    with jax.ensure_compile_time_eval():
        packed = jax.jit(SpatialLobes.packed)(brdf)
        places = zip(receivers.uv[groups], receivers.footprint[groups], strict=True)
        found = [_at(packed, uv.astype(np.float32), footprint.astype(np.float32)) for uv, footprint in places]
        own = jax.tree.map(lambda *parts: np.stack(parts), *found)
    return FixedView(jax.tree.map(lambda _: None, own), omega_o, own)


@jax.jit
def _at(brdf: PackedLobes, uv: Float[Array, "m 2"], footprint: Float[Array, " m"]) -> Brdf:
    return brdf.at(uv, footprint)


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
