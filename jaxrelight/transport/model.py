"""The transport model: what is known of a precomputed scene, ready to light and to view with."""

import dataclasses
import functools
import pathlib
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.normal_maps import NormalMaps
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.brdf.spatial import PackedLobes, SpatialLobes
from jaxrelight.brdf.texture import PixelWeight
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.gather.gather_cloud import GatherCloud
from jaxrelight.gather.lit_cloud import LitCloud
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.enclosed_vertices import enclosed_vertices, weights_in_the_open
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.receivers import Receivers, lifted_vertices
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.lights import Lights
from jaxrelight.lights.local import Light
from jaxrelight.methods import Indirect, Transport
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.operators.contract import Basis, Operator, parts_of
from jaxrelight.operators.sharded import sharded
from jaxrelight.operators.stacked import Stacked
from jaxrelight.transport import bake
from jaxrelight.transport.filtered_visibility import FilteredVisibility
from jaxrelight.transport.resolution_error import ChosenResolution
from jaxrelight.transport.streamed import Streamed


class ByKey:
    """Objects of the host that are equal where their keys are: static parts of pytrees, compiled for once.

    Attributes:
        key: follows from all that the object holds.
    """

    key: str

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self.key == other.key  # pyright: ignore[reportAttributeAccessIssue]

    def __hash__(self) -> int:
        return hash(self.key)


@dataclasses.dataclass(frozen=True, eq=False)
class SceneGeometry(ByKey):
    """The geometry of a scene, ready for rays, with its receivers where a method has any.

    Attributes:
        surfaces: all meshes.
        tracer: rays against them.
        normal_maps: of each mesh; empty where they are bent into the normals of vertices already.
        material_of_mesh: the name of each mesh's material, and last that of sensors where they are looked at; None
            where no receiver is of that material.
        receivers: the points of the operator's rows; None for a method without.
        visible: what the scene's camera sees, or the points of sensors, where receivers are its pixels.
    """

    surfaces: Surfaces
    tracer: Tracer
    normal_maps: NormalMaps
    material_of_mesh: tuple[str | None, ...]
    receivers: Receivers | None = None
    visible: GBuffer | None = None

    @functools.cached_property
    def enclosed(self) -> Bool[np.ndarray, " r"]:
        """Which vertices, and after them which backs of vertices (see `Surfaces.back`), lie inside closed surfaces."""
        receivers = self.receivers
        if receivers is None or self.visible is not None:
            lifted = lifted_vertices(self.surfaces)
        else:
            every = receivers.origins, receivers.face_normals
            lifted = (of.reshape(-1, 3)[receivers.slot_of] for of in every)
        return enclosed_vertices(self.surfaces, self.tracer, *lifted)

    def corners(self, points: GBuffer) -> tuple[Int[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]:
        """The vertices, or backs of vertices, that surface points lie between, and their weights."""
        corners = np.where(points.back[:, None], self.surfaces.back[points.corners], points.corners)
        return corners, weights_in_the_open(points.barycentric, corners, self.enclosed)

    @functools.cached_property
    def key(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The key of the geometry and its materials' names."""
        surfaces = self.surfaces
        maps = (item for one in self.normal_maps for item in (one.content() if one else [None]))
        arrays = surfaces.normals, surfaces.uv, surfaces.mesh_of_vertex
        of_meshes = surfaces.two_sided, surfaces.uv_tangents, surfaces.pure_normals
        placement = [*surfaces.centre.tolist(), surfaces.radius]
        return store.key_of(self.tracer.key, *arrays, *of_meshes, placement, list(self.material_of_mesh), *maps)


@dataclasses.dataclass(frozen=True, eq=False)
class StoredScene(ByKey):
    """What a relighter needs of a store beside its operators, on the host.

    Attributes:
        key: of the store's header.
        folder: the store.
        geometry: of the scene, with its receivers.
        camera: the scene's.
        visibility: the layer of visibility bits; None where light is of a cloud.
        environment: the layer of the scene's own environment, if it has one.
        rotate_y: of that environment, in degrees.
        scale: of that environment.
        local: the scene's own local lights.
        cloud: the points where light comes from that is not of the sky; None for distant light.
        sensors: whose points are the receivers in place of the camera's pixels; None where those are.
        chosen_resolution: how the resolution was chosen; None where it was given.
    """

    key: str
    folder: pathlib.Path
    geometry: SceneGeometry
    camera: Camera
    visibility: store.Layer | None
    environment: store.Layer | None
    rotate_y: float
    scale: float
    local: tuple[Light, ...]
    cloud: GatherCloud | None = None
    sensors: Sensors | None = None
    chosen_resolution: ChosenResolution | None = None

    def lights(self) -> Lights:
        """The scene's own lights, the environment read from its layer."""
        if self.environment is None:
            return Lights(None, self.local)
        return Lights(Environment(self.environment.read("pixels", 0), self.rotate_y, self.scale), self.local)


class Block(eqx.Module):
    """The operator of one BRDF of one material.

    Attributes:
        material: its name.
        brdf: one of those that the material combines.
        weight: the factor on it over the surface.
        reflection: of the BRDF; arrays that each receiver has for itself lead with groups and receivers.
        operator: from light to light terms, its rows ordered by group, receiver and term; where light bounces, the sum
            of direct and of bounced light.
        first_group: the first of the material's groups of receivers.
        group_count: how many groups follow it, with itself.
        has_direct: whether direct light is in the operator, and is the first of its sum; else it is of filtered lobes.
        dropped: energy left out of every row by channel, of direct and of bounced light; None where nothing is.
        emission: radiance that the material emits; of its first block alone, None for the others.
        emitted: light terms of what other surfaces emit, by way of bounces; None where there is none.
        remade: whether its rows are of another material than those of the store, so that its light terms are, too.
    """

    material: str = eqx.field(static=True)
    brdf: Brdf | SpatialLobes
    weight: PixelWeight
    reflection: Reflection
    operator: Operator
    first_group: int = eqx.field(static=True)
    group_count: int = eqx.field(static=True)
    has_direct: bool = eqx.field(static=True)
    dropped: Float[Array, "r c"] | None
    emission: Float[Array, "3"] | None = None
    emitted: Float[Array, "v k c"] | None = None
    remade: bool = eqx.field(static=True, default=False)

    @property
    def groups(self) -> Int[np.ndarray, " g"]:
        """The groups of the material's receivers."""
        return np.arange(self.first_group, self.first_group + self.group_count)

    @property
    def bounced(self) -> tuple[Operator, ...]:
        """The operators of bounced light."""
        return parts_of(self.operator)[1 if self.has_direct else 0 :]


class FilteredLobes(eqx.Module):
    """Lobes of a material whose direct light is filtered light times filtered visibility, in no operator.

    Attributes:
        material: its name.
        brdf: the lobes, without a diffuse part.
        weight: the factor on them over the surface.
        visibility: of the material's receivers; None where each view traces its own.
        narrower: how many narrower lobes each is shaded as, see `brdf.sub_lobes`.
        first_group: the first of the material's groups of receivers.
        emission: radiance that the material emits, where none of its blocks has it.
    """

    material: str = eqx.field(static=True)
    brdf: LobeSum | PackedLobes
    weight: PixelWeight
    visibility: FilteredVisibility | None
    narrower: int = eqx.field(static=True)
    first_group: int = eqx.field(static=True)
    emission: Float[Array, "3"] | None = None


class PrecomputedTransport(eqx.Module):
    """What a store holds, ready to light and to view with.

    Attributes:
        blocks: a block for each BRDF of each material that receivers have, but for filtered lobes without bounces.
        lobes: filtered lobes.
        basis: of the operators' light.
        method: the dials it was made with.
        stored: the rest of the store, on the host.
        kept: share of transport energy that the operators keep.
    """

    blocks: tuple[Block, ...]
    lobes: tuple[FilteredLobes, ...]
    basis: Basis
    method: Transport | Indirect = eqx.field(static=True)
    stored: StoredScene = eqx.field(static=True)
    kept: float = eqx.field(static=True)

    @property
    def operator(self) -> Stacked:
        """From light to the light terms of all blocks, of which there is one at least."""
        return Stacked(tuple(block.operator for block in self.blocks))

    @property
    def nbytes(self) -> int:
        """Bytes that are held: of all rows, and of filtered visibility, which the lobes of a material share."""
        visibility = {lobes.material: lobes.visibility.nbytes for lobes in self.lobes if lobes.visibility is not None}
        return sum(block.operator.nbytes for block in self.blocks) + sum(visibility.values())

    @property
    def row_count(self) -> int:
        """Rows of all operators; 0 where all light is of filtered lobes."""
        return sum(block.operator.shape[0] for block in self.blocks)

    @property
    def geometry(self) -> SceneGeometry:
        """The geometry of the scene."""
        return self.stored.geometry

    @property
    def surfaces(self) -> Surfaces:
        """All meshes."""
        return self.geometry.surfaces

    @property
    def tracer(self) -> Tracer:
        """Rays against the surfaces."""
        return self.geometry.tracer

    @property
    def receivers(self) -> Receivers:
        """The points of the operators' rows."""
        assert self.geometry.receivers is not None
        return self.geometry.receivers

    @property
    def emits(self) -> bool:
        """Whether surfaces emit light."""
        return any(part.emission is not None for part in (*self.blocks, *self.lobes))

    def sharded(self, mesh: Mesh) -> "PrecomputedTransport":
        """The same with the rows of its operators spread over the devices of a mesh; see `operators.sharded`.

        Raises:
            InputError: for a mesh of more axes than one, or operators that are baked from a store as they are used.
        """
        try:
            operators = [sharded(block.operator, mesh) for block in self.blocks]
        except ValueError as error:
            raise InputError(f"this transport cannot be spread over devices: {error}") from None
        blocks = zip(self.blocks, operators, strict=True)
        return dataclasses.replace(
            self, blocks=tuple(dataclasses.replace(block, operator=operator) for block, operator in blocks)
        )


class PrecomputedIndirect(eqx.Module):
    """What a store for local lights holds: transport from the light of a cloud to pixels, and the cloud.

    Attributes:
        transport: from light of the cloud to the light terms of pixels.
        cloud: the points that stand for all surfaces.
    """

    transport: PrecomputedTransport
    cloud: LitCloud

    @property
    def points(self) -> GatherCloud:
        """The places of the cloud's points, on the host."""
        assert self.transport.stored.cloud is not None
        return self.transport.stored.cloud

    @property
    def method(self) -> Indirect:
        """The dials it was made with."""
        assert isinstance(self.transport.method, Indirect)
        return self.transport.method

    @property
    def stored(self) -> StoredScene:
        """The rest of the store, on the host."""
        return self.transport.stored


def frames_of(receivers: Receivers, groups: Int[np.ndarray, " g"]) -> Float[np.ndarray, "g m 3 3"]:
    """The tangent frames of some groups."""
    normals = receivers.normals[groups]
    frames = frames_of_points(normals.reshape(-1, 3), receivers.tangents[groups].reshape(-1, 3))
    return frames.reshape(*normals.shape, 3)


def fixed_view(brdf: Brdf | SpatialLobes, receivers: Receivers, groups: Int[np.ndarray, " g"]) -> FixedView:
    """The exact reflection of some groups of pixel receivers; of a spatial BRDF, each has its own.

    Differentiable in the BRDF, which may be traced.
    """
    assert receivers.omega_o is not None
    omega_o: Any = to_local(frames_of(receivers, groups), receivers.omega_o[groups])
    if not isinstance(brdf, SpatialLobes):
        return FixedView(brdf, omega_o)
    assert receivers.uv is not None
    assert receivers.footprint is not None
    if is_traced(brdf):
        uv, footprint = (as_array(of[groups], np.float32) for of in (receivers.uv, receivers.footprint))
        own = brdf.packed().at(uv, footprint)
        return FixedView(jax.tree.map(lambda _: None, own), as_array(omega_o), own)
    with jax.ensure_compile_time_eval():
        packed = jax.jit(SpatialLobes.packed)(brdf)
        places = zip(receivers.uv[groups], receivers.footprint[groups], strict=True)
        lobes = [_at(packed, uv.astype(np.float32), footprint.astype(np.float32)) for uv, footprint in places]
        own = jax.tree.map(lambda *parts: np.stack(parts), *lobes)
    return FixedView(jax.tree.map(lambda _: None, own), omega_o, own)


@jax.jit
def _at(brdf: PackedLobes, uv: Float[Array, "m u"], footprint: Float[Array, " m"]) -> Brdf:
    return brdf.at(uv, footprint)


class StoredBits(ByKey):
    """Reads the visibility bits of some groups from their layer."""

    def __init__(self, visibility: store.Layer, groups: Int[np.ndarray, " g"]):
        self._visibility, self._groups = visibility, groups
        self.key = store.key_of(str(visibility.folder), groups)

    def __call__(self, group: int) -> UInt8[np.ndarray, "m b"]:
        """The bits of a group by its number among them."""
        return self._visibility.read("bits", int(self._groups[group]))


def streamed(
    method: Transport, visibility: store.Layer, receivers: Receivers, groups: np.ndarray, reflection: Reflection
) -> Streamed:
    """The exact operator of one material's groups, reading visibility from its layer."""
    directions = bake.directions_for(method.resolution, method.samples_per_side)
    return Streamed(StoredBits(visibility, groups), as_array(frames_of(receivers, groups)), reflection, directions)
