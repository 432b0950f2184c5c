"""From a store to the operator, and to all that is needed to light and to view with it."""

import dataclasses
import functools
import json
import pathlib
from collections.abc import Collection

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.normal_maps import NormalMaps, at_vertices, see
from jaxrelight.brdf.packed_texture import pack_weight
from jaxrelight.brdf.parametrisation import DISC, POLAR
from jaxrelight.brdf.record import from_record
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.spatial_factors import SpatialFactors
from jaxrelight.brdf.sub_lobes import narrower_lobes
from jaxrelight.brdf.texture import Texture, VertexColours, constant
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.gather.gather_cloud import GatherCloud, cloud_receivers
from jaxrelight.gather.lit_cloud import LitCloud
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.ray_origins import ray_origins
from jaxrelight.geometry.receivers import Receivers, pixel_receivers, vertex_receivers
from jaxrelight.geometry.sensors import Sensors, sensors_of
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.local import Light
from jaxrelight.lights.record import from_records
from jaxrelight.methods import METHODS, Indirect, Transport
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.contract import Basis, InBasis, Operator, Summed
from jaxrelight.transport.compression import Opened, compression, of_cloud, padded_receivers, shared
from jaxrelight.transport.filtered_visibility import FilteredVisibility
from jaxrelight.transport.model import (
    Block,
    FilteredLobes,
    PrecomputedIndirect,
    PrecomputedTransport,
    SceneGeometry,
    StoredScene,
    fixed_view,
    streamed,
)
from jaxrelight.transport.resolution_error import chosen_from


def load(
    folder: str | pathlib.Path, header: dict | None = None, geometry: SceneGeometry | None = None
) -> PrecomputedTransport | PrecomputedIndirect:
    """Opens a store; nothing is written.

    Args:
        folder: the store.
        header: of the scene that is wanted, as `precompute` gives it; by default of the last one precomputed.
        geometry: of the scene, as `precompute` gives it; by default read from the store.

    Raises:
        InputError: if it is not complete, damaged, or of another format; if a BRDF or a light is of a class of one's
            own that is not known: its module must be imported before, see `jaxrelight.files.class_record`.
    """
    folder = pathlib.Path(folder)
    header = header or store.read_header(folder)
    try:
        return _load(folder, header, geometry)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(
            f"{folder / 'store.json'}: damaged ({type(error).__name__}: {error}); "
            "run precompute again, finished layers will be reused"
        ) from None


def _method_of(record: dict) -> Transport | Indirect:
    """The lighting method of a store.

    Raises:
        ValueError: for one without stores, or a dial outside its range.
    """
    try:
        method = METHODS[record["name"]](**record["dials"])
    except InputError as error:
        raise ValueError(error) from None
    if not isinstance(method, Transport | Indirect):
        raise ValueError(f"{method.name} lighting has no store")
    return method


def _load(
    folder: pathlib.Path, header: dict, geometry: SceneGeometry | None
) -> PrecomputedTransport | PrecomputedIndirect:
    store.layers_of(header)  # refuses names of anything else before any is opened
    method = _method_of(header["method"])
    camera = Camera(**header["camera"])
    sensors = sensors_of(header["sensors"]) if "sensors" in header else None
    geometry = geometry or _geometry(folder, header, sensors or camera, method)
    receivers = geometry.receivers
    assert receivers is not None
    visibility = None if isinstance(method, Indirect) else _whole_layer(folder / header["visibility"])
    if visibility and len(receivers.filled) != visibility.groups:
        raise InputError(f"{folder}: geometry and visibility do not belong together; precompute again")
    if {record["number"] for record in header["materials"]} != set(receivers.material_of_group.tolist()):
        raise ValueError("materials and meshes do not belong together")
    codes = _whole_layer(folder / header["filtered"]) if header.get("filtered") else None
    if codes and len(receivers.filled) != codes.groups:
        raise InputError(f"{folder}: geometry and filtered visibility do not belong together; precompute again")
    blocks, energies, lobes = [], [(0.0, 0.0)], []
    for record in header["materials"]:
        brdf = from_record(
            record["brdf"], functools.partial(_read_table, folder), what=f"the store's material '{record['name']}'"
        )
        if "bounced" in record or not is_filtered(record):
            block, energy = _block(folder, record, brdf, method, receivers, visibility)
            blocks.append(block)
            energies.append(energy)
        if is_filtered(record):
            assert isinstance(method, Transport)
            assert isinstance(brdf, LobeSum | SpatialLobes)
            lobes.append(_filtered_lobes(folder, record, brdf, method, receivers, codes))
    left, total = (sum(energy) for energy in zip(*energies, strict=True))
    environment = header["environment"] or {"pixels": None, "rotate_y": 0.0, "scale": 1.0}
    layer, points = environment["pixels"], None
    if isinstance(method, Indirect):
        points = _read_points(_whole_layer(folder / header["cloud"]))
    seen = {record["number"]: record["name"] for record in header["materials"]}
    materials = tuple(seen.get(number) for number in header["material_of_mesh"])
    stored = StoredScene(
        key=store.key_of(str(folder), json.dumps(header, sort_keys=True)),
        folder=folder,
        geometry=_for_views(geometry, method, materials, {part.material for part in lobes}),
        camera=camera,
        sensors=sensors,
        chosen_resolution=chosen_from(header.get("chosen_resolution")),
        visibility=visibility,
        environment=store.open_layer(folder / layer) if layer else None,
        rotate_y=environment["rotate_y"],
        scale=environment["scale"],
        local=_read_lights(folder, header.get("lights")),
        cloud=points,
    )
    kept = 1 - left / total if total else 1.0
    transport = PrecomputedTransport(tuple(blocks), tuple(lobes), _basis(method), method, stored, kept)
    if points is None or not isinstance(method, Indirect):
        return transport
    return PrecomputedIndirect(transport, _read_cloud(folder, header, points, method))


def _for_views(
    geometry: SceneGeometry,
    method: Transport | Indirect,
    materials: tuple[str | None, ...],
    filtered: Collection[str],
) -> SceneGeometry:
    """Where receivers are vertices, normal maps are bent into their normals once for all views.

    But for materials whose lobes are filtered: those see the map in every pixel.
    """
    if method.receivers == "pixels":
        return dataclasses.replace(geometry, material_of_mesh=materials)
    in_pixels = [name in filtered for name in materials]
    maps = [None if in_pixel else one for one, in_pixel in zip(geometry.normal_maps, in_pixels, strict=True)]
    surfaces = at_vertices(geometry.surfaces, maps)
    maps = tuple(one if in_pixel else None for one, in_pixel in zip(geometry.normal_maps, in_pixels, strict=True))
    return dataclasses.replace(geometry, surfaces=surfaces, normal_maps=maps, material_of_mesh=materials)


def is_filtered(record: dict) -> bool:
    """Whether direct light of a BRDF is filtered light times the visible share of its lobes, and not of rows."""
    return record["reflection"] != "factors"


def _block(
    folder: pathlib.Path,
    record: dict,
    brdf: Brdf | SpatialLobes,
    method: Transport | Indirect,
    receivers: Receivers,
    visibility: store.Layer | None,
) -> tuple[Block, tuple[float, float]]:
    """One BRDF of one material, and of its rows the energy that is left out and the total."""
    groups = receivers.groups_of(record["number"])
    if record["factors"]:
        read = read_spatial_factors if isinstance(brdf, SpatialLobes) else read_factors
        reflection = read(store.open_layer(folder / record["factors"]))
    else:
        reflection = jax.tree.map(as_array, fixed_view(brdf, receivers, groups))
    opened: list[Opened] = []
    emitted = None
    if isinstance(method, Indirect):
        kept = of_cloud(method, np.ones(method.gather_samples))
        opened.append(kept.open(_layer_of(folder / record["indirect"], groups)))
    elif method.coefficients != "all" and not is_filtered(record):
        opened.append(compression(method).open(_layer_of(folder / record["transport"], groups)))
    operators: list[Operator] = [one.operator for one in opened]
    if isinstance(method, Transport):
        if method.coefficients == "all" and not is_filtered(record):
            assert visibility is not None
            operators.append(streamed(method, visibility, receivers, groups, reflection))
        if method.bounces:
            layer = _layer_of(folder / record["bounced"], groups)
            bounced = shared(method).open(layer)
            if method.coefficients == "all":
                operators.append(InBasis(bounced.operator, HaarFaces(method.resolution)))
            else:
                opened.append(bounced)
                operators.append(bounced.operator)
            if "emitted" in layer.arrays:
                emitted = layer.read("emitted")
                emitted = emitted.reshape(-1, *emitted.shape[2:])
    dropped = None
    if opened:
        # What a row leaves out is a sum of two: no longer than both.
        dropped = np.square(sum(np.sqrt(one.dropped) for one in opened))
    weight = pack_weight(tuple(read_factor(folder, entry) for entry in record["weight"]))
    emission = record.get("emission")
    block = Block(
        material=record["name"],
        brdf=brdf,
        weight=weight,
        reflection=reflection,
        operator=operators[0] if len(operators) == 1 else Summed(tuple(operators)),
        first_group=int(groups[0]),
        group_count=len(groups),
        has_direct=not is_filtered(record),
        dropped=None if dropped is None else as_array(dropped, np.float32),
        emission=as_array(emission, np.float32) if emission else None,
        emitted=None if emitted is None else as_array(emitted),
    )
    left = 0.0 if dropped is None else _energy(dropped)
    return block, (left, sum(_energy(one.total) for one in opened))


def _filtered_lobes(
    folder: pathlib.Path,
    record: dict,
    brdf: LobeSum | SpatialLobes,
    method: Transport,
    receivers: Receivers,
    codes: store.Layer | None,
) -> FilteredLobes:
    """Lobes of one material whose direct light is of no rows."""
    groups, emission = receivers.groups_of(record["number"]), record.get("emission")
    visibility = None
    if record["reflection"] == "filtered":
        assert codes is not None
        held = np.concatenate([codes.read("codes", int(group)) for group in groups])
        # Of one of few lengths, so that another mesh of about the same size compiles nothing new.
        more = padded_receivers(len(held)) - len(held)
        visibility = FilteredVisibility(as_array(np.pad(held, ((0, more), (0, 0))), np.int8))
    return FilteredLobes(
        material=record["name"],
        brdf=jax.tree.map(as_array, brdf.packed() if isinstance(brdf, SpatialLobes) else brdf),
        weight=pack_weight(tuple(read_factor(folder, entry) for entry in record["weight"])),
        visibility=visibility,
        narrower=narrower_lobes(brdf, method.reflection_tolerance),
        first_group=int(groups[0]),
        # The first BRDF of a material has its emission.
        emission=as_array(emission, np.float32) if emission and "bounced" not in record else None,
    )


def _energy(of_rows: Float[np.ndarray, "r c"]) -> float:
    """The energy of all rows; rows that are the same in all channels count three times."""
    return float(of_rows.sum(dtype=float)) * 3 / of_rows.shape[1]


def _basis(method: Transport | Indirect) -> Basis:
    """The basis of light."""
    if isinstance(method, Indirect):
        return HaarFaces(round(method.gather_samples**0.5), 1)
    return cubemap.Texels(method.resolution) if method.coefficients == "all" else HaarFaces(method.resolution)


def _read_points(layer: store.Layer) -> GatherCloud:
    return GatherCloud(*(layer.read(field.name, 0) for field in dataclasses.fields(GatherCloud)))


def _read_cloud(folder: pathlib.Path, header: dict, points: GatherCloud, method: Indirect) -> LitCloud:
    reflected = _whole_layer(folder / header["albedo"])
    between, receivers = None, cloud_receivers(points)
    if header["between"]:
        rows = _layer_of(folder / header["between"], np.arange(len(receivers.filled)))
        between = of_cloud(method, np.ones(method.gather_samples)).open(rows).operator
    albedo, emission = (as_array(reflected.read(name, 0)) for name in ("albedo", "emission"))
    slot_of = as_array(receivers.slot_of)
    return LitCloud(albedo, emission, as_array(points.of_sky), between, slot_of)


def _read_lights(folder: pathlib.Path, entry: dict | None) -> tuple[Light, ...]:
    if not entry:
        return ()
    layer = _whole_layer(folder / entry["layer"])
    return from_records(entry["each"], lambda name: layer.read(name, 0))


def _geometry(folder: pathlib.Path, header: dict, eye: Camera | Sensors, method: Transport | Indirect) -> SceneGeometry:
    surfaces = _read_geometry(_whole_layer(folder / header["geometry"]))
    tracer = Tracer(surfaces)
    entries = {record["number"]: record["normal_map"] for record in header["materials"]}
    maps = {number: read_texture(folder, entry) for number, entry in entries.items() if entry is not None}
    normal_maps = tuple(maps.get(number) for number in header["material_of_mesh"])
    material_of_mesh = np.array(header["material_of_mesh"])
    receivers, visible = receivers_of(surfaces, tracer, material_of_mesh, normal_maps, eye, method)
    return SceneGeometry(surfaces, tracer, normal_maps, (), receivers, visible)


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


def _read_geometry(layer: store.Layer) -> Surfaces:
    placement = layer.read("placement", 0)
    return Surfaces(
        *(layer.read(name, 0) for name in ("vertices", "normals", "faces", "uv", "mesh_of_vertex")),
        *(layer.read(name, 0) for name in ("two_sided", "uv_tangents", "pure_normals")),
        centre=placement[:3],
        radius=float(placement[3]),
    )


def receivers_of(
    surfaces: Surfaces,
    tracer: Tracer,
    material_of_mesh: np.ndarray,
    normal_maps: NormalMaps,
    eye: Camera | Sensors,
    method: Transport | Indirect,
) -> tuple[Receivers, GBuffer | None]:
    """The receivers that the method asks for, and what is seen where they are pixels.

    They follow from the geometry, so that no store need hold them.
    """
    if method.receivers == "vertices":
        bent = at_vertices(surfaces, normal_maps)
        if any(normal_maps):
            # Bent normals are those of no smooth surface.
            pure = surfaces.pure_normals | np.array([one is not None for one in normal_maps])
            bent = dataclasses.replace(bent, pure_normals=pure)
        return vertex_receivers(bent, material_of_mesh, tracer), None
    seen = see(surfaces, tracer, eye, normal_maps)
    return pixel_receivers(seen, ray_origins(surfaces, tracer, seen), material_of_mesh), seen


def read_factors(layer: store.Layer) -> Factored:
    """Factors from their layer."""
    light, view = jax.device_put((layer.read("light_maps", 0), layer.read("view_maps", 0)))
    return Factored(light, view, POLAR if layer.read("is_polar", 0) else DISC)


def read_spatial_factors(layer: store.Layer) -> SpatialFactors:
    """Factors shared by a map of BRDFs from their layer."""
    light, view = jax.device_put((layer.read("light_maps", 0), layer.read("view_maps", 0)))
    return SpatialFactors(light, view, _minified(layer.read("weights", 0)))


def read_factor(folder: pathlib.Path, entry: str | list[float] | dict) -> Texture | VertexColours:
    """What `write_factor` wrote."""
    if isinstance(entry, dict):
        return VertexColours() if "colours" in entry else read_texture(folder, entry)
    return read_texture(folder, entry)


def read_texture(folder: pathlib.Path, entry: str | list[float] | dict) -> Texture:
    """A texture from its layer, or a constant one from its values."""
    if isinstance(entry, dict):
        placement = None if entry["placement"] is None else as_array(entry["placement"], np.float32)
        image = read_texture(folder, entry["image"])
        across, upwards = entry["wrap"]
        return dataclasses.replace(image, placement=placement, uv_set=entry["uv_set"], wrap=(across, upwards))
    if isinstance(entry, str):
        return _minified(store.open_layer(folder / entry).read("pixels", 0))
    return constant(entry)


def _minified(pixels: Float[np.ndarray, "h w c"]) -> Texture:
    return Texture(as_array(pixels)).minified()


def _read_table(folder: pathlib.Path, name: str) -> np.ndarray:
    """A long array of a BRDF, from its layer."""
    return store.open_layer(folder / name).read("values", 0)
