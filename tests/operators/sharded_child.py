"""What an operator on several devices has to do, in a process that is given them.

    python -m tests.operators.sharded_child DEVICES
    python -m tests.operators.sharded_child DEVICES ADDRESS PROCESSES PROCESS

The first makes that many devices; the second makes them in each of several processes, which meet at an address.
"""

import functools
import os
import sys
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from jaxrelight.operators.clustered import Cluster, Clustered, clustered, quantised_clusters
from jaxrelight.operators.contract import Operator
from jaxrelight.operators.quantised import quantised
from jaxrelight.operators.sharded import Sharded, sharded
from jaxrelight.operators.sparse_rows import SparseRows, sparse_rows
from jaxrelight.operators.stacked import Stacked

D = 384  # texels of a 6×8² cube map


def random(*shape: int, seed: int = 0) -> jax.Array:
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), np.float32)


def rows(r: int, c: int, bits: int | None = None) -> SparseRows:
    rng = np.random.default_rng(r)
    indices = np.sort(rng.random((r, D)).argsort(axis=-1)[:, :20], axis=-1)
    values = rng.normal(size=(r, c, 20)).astype(np.float32)
    return sparse_rows(indices, quantised(values, bits) if bits else values, D)


def clusters(c: int, bits: int | None = None) -> Clustered:
    """Of two sizes, that are in buckets of their own; some groups are black, also at both ends."""
    rng = np.random.default_rng(c)
    sizes = [(0, 0), *[(40, 3), (300, 90), (1, 1)] * 7, (0, 0), (64, 4), (300, 96), (0, 0)]
    found = [
        Cluster(
            np.sort(rng.permutation(D)[:s]),
            rng.normal(size=(q, s)).astype(np.float32),
            rng.normal(size=(c, q, 8)).astype(np.float32),
        )
        for s, q in sizes
    ]
    operator = clustered(found, D)
    assert len(operator.buckets) == 2
    return quantised_clusters(operator, bits) if bits else operator


CASES: dict[str, Callable[[], Operator]] = {
    "rows": functools.partial(rows, 4099, 3),
    "rows in 8 bits, grey": functools.partial(rows, 1001, 1, 8),
    "fewer rows than devices": functools.partial(rows, 3, 3),
    "clusters": functools.partial(clusters, 3),
    "clusters in 8 bits": functools.partial(clusters, 3, 8),
    "clusters, grey": functools.partial(clusters, 1),
    "stacked": lambda: Stacked((rows(101, 3), clusters(1, 8))),
}


def near(found, wanted, tolerance: float = 2e-6) -> None:
    found, wanted = np.asarray(found, float), np.asarray(wanted, float)
    assert found.shape == wanted.shape, (found.shape, wanted.shape)
    difference = np.linalg.norm(found - wanted) / np.linalg.norm(wanted)
    assert difference < tolerance, difference


@jax.jit
def tangent(operator: Operator, light, change):
    return jax.jvp(operator.apply, (light,), (change,))[1]


@jax.jit
def pulled(operator: Operator, light, radiance):
    """The gradient with respect to light and to the operator's own numbers, of which some are made on one device."""
    numbers, rest = eqx.partition(operator, eqx.is_inexact_array)
    _, pull = jax.vjp(lambda numbers, light: eqx.combine(numbers, rest).apply(light), numbers, light)
    numbers_back, light_back = pull(radiance)
    # The product of the numbers and their gradient does not depend on where they lie.
    inner = sum(jnp.vdot(x, y) for x, y in zip(*map(jax.tree.leaves, (numbers, numbers_back)), strict=True))
    return light_back, inner


@jax.jit
def over_lights(operator: Operator, lights):
    return jax.vmap(operator.apply)(lights)


@jax.jit
def over_radiances(operator: Operator, radiances):
    return jax.vmap(operator.transpose)(radiances)


def check(whole: Operator, mesh: Mesh) -> None:
    """Everything that is asked of an operator, against the same on one device."""
    split = sharded(whole, mesh)
    assert split.shape == whole.shape
    r, d, _ = whole.shape
    light, radiance = random(d, 3), random(r, 3, seed=1)
    forth, back = split.apply(light), split.transpose(radiance)
    near(forth, whole.apply(light))
    near(back, whole.transpose(radiance))
    product = np.vdot(np.asarray(forth, float), radiance) - np.vdot(np.asarray(light, float), back)
    assert abs(product) < 1e-6 * np.linalg.norm(forth) * np.linalg.norm(radiance), product
    chosen = jnp.asarray([r - 1, 0, r // 2, r // 2, 1])
    near(split.rows(chosen), whole.rows(chosen))
    near(tangent(split, random(d, 3, seed=2), light), forth)
    pulled_light, inner = pulled(split, light, radiance)
    near(pulled_light, back)
    near(inner, pulled(whole, light, radiance)[1], 1e-4)
    near(over_lights(split, random(2, d, 3)), np.stack([whole.apply(x) for x in random(2, d, 3)]))
    near(over_radiances(split, random(2, r, 3)), np.stack([whole.transpose(x) for x in random(2, r, 3)]))
    # Many lights at once.
    if whole.shape[2] == 1:
        near(split.apply(random(d, 20)), whole.apply(random(d, 20)))


def largest_share(whole: Operator, mesh: Mesh) -> float:
    """Of the bytes of an operator, those on the device that has most."""
    split = sharded(whole, mesh)
    assert isinstance(split, Sharded)
    shares = dict.fromkeys(mesh.devices.flat, 0)
    for array in jax.tree.leaves(split):
        for shard in array.addressable_shards:
            shares[shard.device] += shard.data.nbytes
    assert split.nbytes <= sum(shares.values()) < 1.5 * whole.nbytes
    return max(shares.values()) / whole.nbytes


def main(devices: str, address: str | None = None, processes: str = "1", process: str = "0") -> None:
    os.environ["XLA_FLAGS"] = f"--xla_force_host_platform_device_count={devices}"
    if address is not None:
        jax.config.update("jax_cpu_collectives_implementation", "gloo")
        jax.distributed.initialize(address, int(processes), int(process), initialization_timeout=30)
    assert jax.device_count() == int(devices) * int(processes)
    mesh = Mesh(np.array(jax.devices()), ("groups",))
    for name, make in CASES.items():
        check(make(), mesh)
        print(name, flush=True)
    if address is None:
        for name in ("rows", "rows in 8 bits, grey", "clusters", "clusters in 8 bits"):
            share = largest_share(CASES[name](), mesh)
            assert share < 1.2 / mesh.size, (name, share)


if __name__ == "__main__":
    main(*sys.argv[1:])
