"""The transport model: what is known of a precomputed scene, ready to light and to view with."""

import dataclasses
import pathlib
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.normal_maps import NormalMaps
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.brdf.spatial import PackedLobes, SpatialLobes
from jaxrelight.brdf.texture import Weight
from jaxrelight.files import store
from jaxrelight.gather.lit_cloud import LitCloud
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.receivers import Receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.local import Light
from jaxrelight.methods import Settings
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.contract import Basis, Operator
from jaxrelight.operators.stacked import Stacked
from jaxrelight.transport import bake
from jaxrelight.transport.streamed import Streamed


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


def streamed(
    settings: Settings, visibility: store.Layer, receivers: Receivers, groups: np.ndarray, reflection: Reflection
) -> Streamed:
    """The exact operator of one material's groups, reading visibility from its layer."""

    def read_bits(group: int) -> np.ndarray:
        return visibility.read("bits", int(groups[group]))

    directions = bake.directions_for(settings.resolution, settings.samples_per_side)
    return Streamed(read_bits, as_array(frames_of(receivers, groups)), reflection, directions)
