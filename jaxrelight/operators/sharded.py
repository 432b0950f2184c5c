"""Operators whose rows lie on several devices, of one process or of many."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from jaxrelight.operators.clustered import Bucket, Clustered, count_holders, find_holders
from jaxrelight.operators.contract import Composed, InBasis, Operator, Scaled, Summed
from jaxrelight.operators.sparse_rows import SparseRows
from jaxrelight.operators.stacked import Stacked


class Sharded(Operator):
    """Rows in groups of m, l groups on each of p devices. Made by `sharded`.

    Every device holds an operator of its own, all of one shape, and is given all the light: it makes the radiance of
    its rows with no word from the others. Results are whole on every device. So `apply` ends with a gathering of rows,
    `transpose` with a sum over devices.

    Attributes:
        shards: the devices' operators, each array led by an axis of devices, along which it is split.
        groups: which of the g groups each device's are; g for filling. Split as they are.
        place: of each group among those of all devices; past their end where it is black.
        group_rows: m.
        row_count: r, without filling.
        columns: d, the number of light coefficients.
        channels: c; 1 where rows are the same in all of them (grey).
        mesh: of the devices.
    """

    shards: Operator
    groups: Int[Array, "p l"]
    place: Int[Array, " g"]
    group_rows: int = eqx.field(static=True)
    row_count: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)
    channels: int = eqx.field(static=True)
    mesh: Mesh = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""
        return self.row_count, self.columns, self.channels

    @property
    def nbytes(self) -> int:
        """Bytes of all devices together, with their filling; what all of them hold is counted once."""
        return sum(array.nbytes for array in jax.tree.leaves(self))

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance is whole on every device."""
        return _apply(self, light)

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """Each device takes its rows of the radiance; the light is whole on every one."""
        return _transpose(self, radiance)

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """Rows are whole on every device."""
        return _rows(self, indices)


# What varies between devices is told by the layouts: products are primitives of our own, which JAX knows nothing about.
_on_devices = functools.partial(jax.shard_map, check_vma=False)


# Compiled even where the caller compiles nothing: JAX runs a program on the devices of many processes, not its steps.
@jax.jit
def _apply(operator: Sharded, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
    split, replicated = _layouts(operator.mesh)

    @functools.partial(_on_devices, mesh=operator.mesh, in_specs=(split.spec, replicated.spec), out_specs=split.spec)
    def own(shards, light):
        return _own(shards).apply(light)

    c = light.shape[1]
    by_group = jax.lax.with_sharding_constraint(own(operator.shards, light), replicated).reshape(
        -1, operator.group_rows, c
    )
    black = jnp.zeros((1, *by_group.shape[1:]), by_group.dtype)
    placed = jnp.concatenate([by_group, black]).at[operator.place].get(mode="promise_in_bounds")
    return placed.reshape(-1, c)[: operator.row_count]


@jax.jit
def _transpose(operator: Sharded, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
    split, replicated = _layouts(operator.mesh)
    m, c = operator.group_rows, radiance.shape[1]

    @functools.partial(
        _on_devices, mesh=operator.mesh, in_specs=(split.spec, split.spec, replicated.spec), out_specs=replicated.spec
    )
    def summed(shards, groups, by_group):
        group_radiance = by_group.at[groups[0]].get(mode="promise_in_bounds").reshape(-1, c)
        return jax.lax.psum(_own(shards).transpose(group_radiance), operator.mesh.axis_names)

    # One group more, of zeros, for filling.
    filled = jnp.pad(radiance, ((0, (len(operator.place) + 1) * m - operator.row_count), (0, 0)))
    return summed(operator.shards, operator.groups, filled.reshape(-1, m, c))


@jax.jit
def _rows(operator: Sharded, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
    split, replicated = _layouts(operator.mesh)
    (axis,), m, held = operator.mesh.axis_names, operator.group_rows, operator.groups.shape[1]

    @functools.partial(
        _on_devices,
        mesh=operator.mesh,
        in_specs=(split.spec, replicated.spec, replicated.spec),
        out_specs=replicated.spec,
    )
    def summed(shards, place, row):
        place = place - jax.lax.axis_index(axis) * held
        held_here = (place >= 0) & (place < held)
        rows = _own(shards).rows(jnp.where(held_here, place * m + row, 0))
        return jax.lax.psum(jnp.where(held_here[:, None, None], rows, 0), axis)

    return summed(operator.shards, operator.place[indices // m], indices % m)


def _layouts(mesh: Mesh) -> tuple[NamedSharding, NamedSharding]:
    """Split along the first axis, and whole on every device."""
    return NamedSharding(mesh, PartitionSpec(*mesh.axis_names)), NamedSharding(mesh, PartitionSpec())


def _own(shards: Operator) -> Operator:
    """A device's operator, of what it sees of all of them."""
    return jax.tree.map(lambda x: x[0], shards)


def sharded(operator: Operator, mesh: Mesh) -> Operator:
    """The same operator with its rows spread over the devices of a mesh, about as many on each.

    Arrays that it is used with should be on no device in particular, as they are unless put there, or on those of the
    mesh. Where the mesh is of several processes, all of them call this with the same operator, and call its methods
    with the same arguments.

    Args:
        operator: `SparseRows` or `Clustered`; or `Stacked`, `Summed`, `Composed`, `Scaled` or `InBasis` of such, of
            which every part is spread by itself.
        mesh: of one axis, of any name.

    Raises:
        ValueError: for a mesh of more axes, or another operator.
    """
    if len(mesh.axis_names) != 1:
        raise ValueError(f"rows are split along one axis of devices; the mesh has {len(mesh.axis_names)}")
    if isinstance(operator, Stacked | Summed):
        return type(operator)(tuple(sharded(part, mesh) for part in operator.operators))
    if isinstance(operator, InBasis):
        return InBasis(sharded(operator.operator, mesh), operator.basis)
    if isinstance(operator, Composed):
        return Composed(sharded(operator.outer, mesh), sharded(operator.inner, mesh))
    if isinstance(operator, Scaled):
        return Scaled(sharded(operator.operator, mesh), operator.factor)
    # Operators leave it to the compiler where arrays lie between their steps.
    mesh = Mesh(mesh.devices, mesh.axis_names)
    if isinstance(operator, SparseRows):
        return _placed(*_split_rows(operator, mesh.size), operator, mesh)
    if isinstance(operator, Clustered):
        return _placed(*_split_clusters(operator, mesh.size), operator, mesh)
    raise ValueError(f"{type(operator).__name__} cannot be spread over devices; SparseRows and Clustered can")


def _placed(
    shards: Operator, groups: Int[np.ndarray, "p l"], g: int, m: int, operator: SparseRows | Clustered, mesh: Mesh
) -> Sharded:
    """Everything on its devices; see `Sharded` for the names."""
    place = np.full(g + 1, groups.size, np.int32)
    place[groups.reshape(-1)] = np.arange(groups.size)

    def put(x: np.ndarray, layout: NamedSharding) -> Array:
        # Each process puts what its devices hold.
        return jax.make_array_from_callback(x.shape, layout, lambda index: x[index])

    split, replicated = _layouts(mesh)
    shards = jax.tree.map(lambda x: put(x, split), shards)
    return Sharded(shards, put(groups, split), put(place[:g], replicated), m, *operator.shape, mesh)


def _split_rows(operator: SparseRows, devices: int) -> tuple[SparseRows, Int[np.ndarray, "p 1"], int, int]:
    """Rows in as many groups as there are devices: the shards, their groups, and how many groups of how many rows."""
    b, m, _ = operator.indices.shape
    blocks = -(-b // devices)
    size = -(-b * m // (devices * blocks))

    def split(x: Array) -> np.ndarray:
        rows = np.asarray(x).reshape(b * m, -1)
        rows = np.pad(rows, ((0, devices * blocks * size - b * m), (0, 0)))
        return rows.reshape(devices, blocks, size, -1)

    indices, values = jax.tree.map(split, (operator.indices, operator.values))
    shards = SparseRows(indices, values, blocks * size, operator.columns)
    return shards, np.arange(devices, dtype=np.int32)[:, None], devices, blocks * size


def _split_clusters(operator: Clustered, devices: int) -> tuple[Clustered, Int[np.ndarray, "p l"], int, int]:
    """Each bucket's groups dealt to the devices: the shards, their groups, and how many groups of how many rows."""
    g, columns = len(operator.place), operator.columns
    buckets, groups, held, start = [], [], [], 0
    for part in operator.buckets:
        b = -(-len(part.groups) // devices)

        def dealt(x, filling: int = 0, b: int = b) -> np.ndarray:
            x = np.asarray(x)
            padding = [(0, devices * b - len(x))] + [(0, 0)] * (x.ndim - 1)
            return np.pad(x, padding, constant_values=filling).reshape(devices, b, *x.shape[1:])

        own: Any = np.broadcast_to(np.arange(start, start + b, dtype=np.int32), (devices, b))
        support, basis, weights = jax.tree.map(dealt, (part.support, part.basis, part.weights))
        buckets.append(Bucket(own, support, basis, weights))
        groups.append(dealt(part.groups, filling=g))
        # Supports are ascending, then padded with zeros; padding belongs to no column.
        real = (support > 0) | (np.arange(support.shape[-1]) == 0)
        held.append(np.where(real, support, columns).reshape(devices, -1))
        start += b
    if not buckets:
        groups, start = [np.full((devices, 1), g, np.int32)], 1
    held = np.concatenate([np.zeros((devices, 0), int), *held], axis=1)
    # The arrays have one shape on all devices.
    most = np.max([count_holders(own, columns) for own in held], axis=0)
    per_device = [find_holders(own, columns, most) for own in held]
    holders, column_place = jax.tree.map(lambda *own: np.stack(own), *per_device)
    place: Any = np.broadcast_to(np.arange(start, dtype=np.int32), (devices, start))
    m = operator.group_rows
    shards = Clustered(tuple(buckets), place, holders, column_place, m, operator.channels, columns)
    return shards, np.concatenate(groups, axis=1), g, m
