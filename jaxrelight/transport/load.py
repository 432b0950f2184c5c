"""From a store to the operator, and to all that is needed to light and to view with it."""

import dataclasses
import functools
import pathlib
import types

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight import store
from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factors import Factored
from jaxrelight.brdf.record import from_record
from jaxrelight.brdf.reflection import FixedView, Reflection, of_group
from jaxrelight.buckets import bucket
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import tangent_frame, to_local
from jaxrelight.geometry.gbuffer import trace_gbuffer
from jaxrelight.geometry.receivers import GROUP, Receivers, pixel_receivers, vertex_receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.environment import Environment
from jaxrelight.operators.sparse_rows import SparseRows, sparse_rows
from jaxrelight.operators.stacked import Stacked
from jaxrelight.operators.streamed import Streamed
from jaxrelight.transport import bake
from jaxrelight.transport.settings import Settings


@dataclasses.dataclass(frozen=True)
class Transport:
    """What a store holds, ready to light and to view with.

    Attributes:
        settings: the dials it was made with.
        surfaces: the geometry, for views.
        tracer: rays against it.
        receivers: the points of the operator's rows.
        names: of the materials that have receivers.
        brdfs: theirs.
        reflections: theirs; arrays that each receiver has for itself lead with groups and receivers.
        operator: from light to light terms; its rows are ordered by material, group, receiver and term. Where it was
            read from a store, the rows of each material are followed by rows of zeros up to one of few numbers.
        basis: of the operator's light.
        kept: share of transport energy that the operator keeps.
        dropped: energy left out of every row by channel, per material; None where nothing is.
        camera: the scene's.
        environment: the layer of the scene's own environment, if it has one.
        rotate_y: of that environment.
        scale: of that environment.
        folder: the store.
        visibility: the layer of visibility bits.
    """

    settings: Settings
    surfaces: Surfaces
    tracer: Tracer
    receivers: Receivers
    names: list[str]
    brdfs: list[Brdf]
    reflections: list[Reflection]
    operator: Stacked
    basis: bake.Basis
    kept: float
    dropped: list[np.ndarray] | None
    camera: Camera
    environment: store.Layer | None
    rotate_y: float
    scale: float
    folder: pathlib.Path
    visibility: store.Layer
    groups: list[Int[np.ndarray, " g"]]


def load(folder: str | pathlib.Path, header: dict | None = None) -> Transport:
    """Opens a store; nothing is written.

    Args:
        folder: the store.
        header: of the scene that is wanted, as `precompute` gives it; by default of the last one precomputed.

    Raises:
        InputError: if it is not complete, damaged, or of another format.
    """
    folder = pathlib.Path(folder)
    header = header or store.read_header(folder)
    try:
        return _load(folder, header)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(
            f"{folder / 'store.json'}: damaged ({type(error).__name__}: {error}); "
            "run precompute again, finished layers will be reused"
        ) from None


def _load(folder: pathlib.Path, header: dict) -> Transport:
    settings = Settings(**header["settings"])
    geometry = store.open_layer(folder / header["geometry"])
    surfaces = _read_geometry(geometry)
    visibility = store.open_layer(folder / header["visibility"])
    for layer in (geometry, visibility):
        if layer.missing:
            raise InputError(
                f"{layer.folder}: {len(layer.missing):,} groups are missing; run precompute to complete them"
            )
    tracer, camera = Tracer(surfaces), Camera(**header["camera"])
    receivers = receivers_of(surfaces, tracer, np.array(header["material_of_mesh"]), camera, settings)
    if len(receivers.filled) != visibility.groups:
        raise InputError(f"{folder}: geometry and visibility do not belong together; precompute again")
    directions = bake.directions_for(settings.resolution, settings.samples_per_side)
    numbers = sorted(set(receivers.material_of_group.tolist()))
    brdfs, reflections, operators, dropped, all_groups, total = [], [], [], [], [], 0.0
    for number, record in zip(numbers, header["materials"], strict=True):
        brdf, groups = from_record(record["brdf"]), receivers.groups_of(number)
        reflection = (
            read_factors(store.open_layer(folder / record["factors"]))
            if record["factors"]
            else fixed_view(brdf, receivers, groups)
        )
        if settings.coefficients == "all":
            operators.append(_streamed(visibility, groups, frames_of(receivers, groups), reflection, directions))
        else:
            layer = store.open_layer(folder / record["transport"])
            if layer.missing:
                raise InputError(f"{folder}: {len(layer.missing)} groups are missing; run precompute to complete them")
            arrays = layer.read_all()
            operators.append(_sparse_rows(layer.folder, arrays["indices"], arrays["values"], settings))
            dropped.append(arrays["dropped"].reshape(-1, reflection.channels))
            total += float(arrays["total"].sum(dtype=float)) * 3 / reflection.channels
        brdfs.append(brdf)
        reflections.append(reflection)
        all_groups.append(groups)
    left = sum(float(part.sum(dtype=float)) * 3 / part.shape[1] for part in dropped)
    environment = header["environment"] or {"pixels": None, "rotate_y": 0.0, "scale": 1.0}
    return Transport(
        settings=settings,
        surfaces=surfaces,
        tracer=tracer,
        receivers=receivers,
        names=[record["name"] for record in header["materials"]],
        brdfs=brdfs,
        reflections=reflections,
        operator=Stacked(tuple(operators)),
        basis=cubemap.Texels(settings.resolution) if settings.coefficients == "all" else HaarFaces(settings.resolution),
        kept=1 - left / total if total else 1.0,
        dropped=dropped or None,
        camera=camera,
        environment=store.open_layer(folder / environment["pixels"]) if environment["pixels"] else None,
        rotate_y=environment["rotate_y"],
        scale=environment["scale"],
        folder=folder,
        visibility=visibility,
        groups=all_groups,
    )


def stored_environment(transport: Transport) -> Environment | None:
    """The environment of the scene that the store was made from."""
    if transport.environment is None:
        return None
    return Environment(transport.environment.read("pixels", 0), transport.rotate_y, transport.scale)


def exact(transport: Transport) -> Transport:
    """The same scene with nothing left out: rows over all texels, baked from visibility at every use.

    The reference that the kept coefficients are measured against; factors stay what they are.
    """
    settings = transport.settings
    directions = bake.directions_for(settings.resolution, settings.samples_per_side)
    operators = [
        _streamed(transport.visibility, groups, frames_of(transport.receivers, groups), reflection, directions)
        for groups, reflection in zip(transport.groups, transport.reflections, strict=True)
    ]
    return dataclasses.replace(
        transport,
        settings=dataclasses.replace(settings, coefficients="all"),
        operator=Stacked(tuple(operators)),
        basis=cubemap.Texels(settings.resolution),
        kept=1.0,
        dropped=None,
    )


def _streamed(visibility, groups, frames, reflection, directions) -> Streamed:
    """The exact operator of one material's groups, reading visibility from its layer."""

    def read_bits(group: int) -> np.ndarray:
        return visibility.read("bits", int(groups[group]))

    return Streamed(read_bits, frames, reflection, directions)


def rebake(transport: Transport, reflections: list[Reflection]) -> Transport:
    """The same scene with other reflections, on the same visibility and the same kept coefficients; no ray is traced.

    Pure and differentiable in the reflections' arrays, in both modes. Which coefficients are kept is held fixed: the
    derivative is that of the truncated operator, not of the choice.
    """
    settings = transport.settings
    directions = bake.directions_for(settings.resolution, settings.samples_per_side)
    operators = []
    for old, groups, reflection in zip(transport.operator.operators, transport.groups, reflections, strict=True):
        if isinstance(old, Streamed):
            operators.append(Streamed(old.read_bits, old.frames, reflection, directions))
            continue
        assert isinstance(old, SparseRows)
        n = old.indices.shape[-1]
        frames = frames_of(transport.receivers, groups)
        k, rows = reflection.terms, len(groups) * GROUP * reflection.terms
        kept = old.indices.reshape(-1, n)[:rows].reshape(len(groups), GROUP, k, n)
        values = [
            bake.bake_kept(
                jnp.asarray(transport.visibility.read("bits", int(group))),
                frames[i],
                of_group(reflection, i),
                directions,
                transport.basis,
                kept[i],
            )
            for i, group in enumerate(groups)
        ]
        joined = jnp.concatenate(values).reshape(len(groups), GROUP, k, reflection.channels, n)
        operators.append(_rows_of_groups(kept, joined, old.columns, jnp))
    return dataclasses.replace(transport, reflections=reflections, operator=Stacked(tuple(operators)))


def _read_geometry(layer: store.Layer) -> Surfaces:
    placement = layer.read("placement", 0)
    return Surfaces(
        *(layer.read(name, 0) for name in ("vertices", "normals", "faces", "mesh_of_vertex")),
        centre=placement[:3],
        radius=float(placement[3]),
    )


def receivers_of(
    surfaces: Surfaces, tracer: Tracer, material_of_mesh: np.ndarray, camera: Camera, settings: Settings
) -> Receivers:
    """The receivers that the settings ask for: they follow from the geometry, so that no store need hold them."""
    if settings.receivers == "vertices":
        return vertex_receivers(surfaces, material_of_mesh)
    return pixel_receivers(trace_gbuffer(surfaces, tracer, camera), material_of_mesh)


def frames_of(receivers: Receivers, groups: Int[np.ndarray, " g"]) -> Float[np.ndarray, "g m 3 3"]:
    """The tangent frames of the shading normals of some groups."""
    return _by_group(tangent_frame, receivers.normals[groups])


def fixed_view(brdf: Brdf, receivers: Receivers, groups: Int[np.ndarray, " g"]) -> FixedView:
    """The exact reflection of some groups of pixel receivers."""
    assert receivers.omega_o is not None
    omega_o = _by_group(to_local, receivers.normals[groups], receivers.omega_o[groups])
    return FixedView(brdf, omega_o)  # pyright: ignore[reportArgumentType]


def _by_group(function, *arrays: Float[np.ndarray, "g m ..."]) -> Float[np.ndarray, "g m ..."]:
    """A function of the arrays of one group, for many: compiled once, however many there are."""
    compiled = _compiled(function)
    return np.stack([compiled(*(part.astype(np.float32) for part in group)) for group in zip(*arrays, strict=True)])


_compiled = functools.cache(jax.jit)


def read_factors(layer: store.Layer) -> Factored:
    """Factors from their layer."""
    return Factored(jnp.asarray(layer.read("light_maps", 0)), jnp.asarray(layer.read("view_maps", 0)))


def padded_receivers(count: int) -> int:
    """To how many receivers, of zero transport, the operator of a material is filled up."""
    return bucket(count, 8 * GROUP)


def _sparse_rows(folder: pathlib.Path, indices: np.ndarray, values: np.ndarray, settings: Settings) -> SparseRows:
    """The operator of one material's groups, from its layer's arrays."""
    if indices.max() >= 6 * settings.resolution**2:
        raise InputError(f"{folder}: indices are out of range; delete this folder and run precompute again")
    return _rows_of_groups(indices, values, 6 * settings.resolution**2, np)


def _rows_of_groups(
    indices: Int[np.ndarray | Array, "g m k n"],
    values: Float[np.ndarray | Array, "g m k c n"],
    columns: int,
    lib: types.ModuleType,
) -> SparseRows:
    """The operator of some groups, filled up with receivers of zero transport; `lib` is numpy, or jax.numpy."""
    g, m, k, c, n = values.shape
    more = (0, (padded_receivers(g * m) - g * m) * k), (0, 0)
    indices = lib.pad(indices.reshape(-1, n), more)
    return sparse_rows(jnp.asarray(indices), jnp.asarray(lib.pad(values.reshape(-1, c, n), (*more, (0, 0)))), columns)
