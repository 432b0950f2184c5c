"""What an operator on several devices has to do, in a process that is given them.

    python -m tests.operators.sharded_child DEVICES
    python -m tests.operators.sharded_child DEVICES ADDRESS PROCESSES PROCESS

The first makes that many devices; the second makes them in each of several processes, which meet at an address.
"""

import functools
import os
import sys
from collections.abc import Callable
from typing import Any

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


def random(*shape: int, seed: int = 0) -> Any:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def rows(r: int, c: int, bits: int | None = None) -> SparseRows:
    rng = np.random.default_rng(r)
    indices = np.sort(rng.random((r, D)).argsort(axis=-1)[:, :20], axis=-1)
    values = rng.normal(size=(r, c, 20)).astype(np.float32)
    return sparse_rows(indices, quantised(values, bits) if bits else values, D)


def clusters(c: int, bits: int | None = None) -> Clustered:
    """Of two sizes, that are in buckets of their own; some groups are black, the last among them."""
    rng = np.random.default_rng(c)
    sizes = [*[(40, 3), (300, 14), (1, 1)] * 7, (0, 0), (64, 4), (300, 16), (0, 0)]
    groups = [
        Cluster(
            np.sort(rng.permutation(D)[:s]),
            rng.normal(size=(q, s)).astype(np.float32),
            rng.normal(size=(c, q, 8)).astype(np.float32),
        )
        for s, q in sizes
    ]
    operator = clustered(groups, D)
    assert len(operator.buckets) == 2
    return quantised_clusters(operator, bits) if bits else operator


CASES: dict[str, Callable[[], Operator]] = {
    "rows": functools.partial(rows, 4099, 3),
    "rows in 8 bits, grey": functools.partial(rows, 1001, 1, 8),
    "fewer rows than devices": functools.partial(rows, 3, 3),
    "clusters": functools.partial(clusters, 3),
    "clusters in 8 bits, grey": functools.partial(clusters, 1, 8),
    "stacked": lambda: Stacked((rows(101, 1, 8), rows(7, 3))),
}

# Those for several processes; the first joins results outside of any program that the caller compiles.
MULTIPROCESS_CASES = "stacked", "clusters in 8 bits, grey"


@jax.jit
def answers(operator: Operator) -> dict[str, jax.Array]:
    """What an operator says to everything that it can be asked."""
    r, d, c = operator.shape
    light, radiance, change = random(d, 3), random(r, 3, seed=1), random(d, 3, seed=2)
    numbers, rest = eqx.partition(operator, eqx.is_inexact_array)
    forth, pull = jax.vjp(lambda numbers, light: eqx.combine(numbers, rest).apply(light), numbers, light)
    numbers_back, light_back = pull(radiance)
    # How gradients lie depends on the number of devices; their product with the numbers does not.
    inner = sum(jnp.vdot(x, y) for x, y in zip(*map(jax.tree.leaves, (numbers, numbers_back)), strict=True))
    results = {
        "apply": forth,
        "transpose": operator.transpose(radiance),
        "rows": operator.rows(jnp.asarray([r - 1, 0, r // 2, r // 2, 1])),
        "jvp": jax.jvp(operator.apply, (light,), (change,))[1],
        "vjp in light": light_back,
        "vjp in values": jnp.asarray(inner),
        "vmap of apply": jax.vmap(operator.apply)(random(2, d, 3, seed=3)),
        "vmap of transpose": jax.vmap(operator.transpose)(random(2, r, 3, seed=4)),
    }
    return results | ({"many lights": operator.apply(random(d, 20))} if c == 1 else {})


def expected(operator: Operator) -> dict[str, np.ndarray]:
    """The same by an operator's matrix, on the host."""
    r, d, c = operator.shape
    rows = np.asarray(_written_out(operator), float)
    matrix = np.broadcast_to(rows, (r, 3, d))
    light, radiance, change = random(d, 3), random(r, 3, seed=1), random(d, 3, seed=2)

    def apply(light):
        return np.einsum("rcd,dc->rc", matrix, light)

    def transpose(radiance):
        return np.einsum("rcd,rc->dc", matrix, radiance)

    # Rows are linear in the numbers of each of their factors.
    parts = operator.operators if isinstance(operator, Stacked) else (operator,)
    factors = np.repeat([2 if isinstance(part, Clustered) else 1 for part in parts], [part.shape[0] for part in parts])
    results = {
        "apply": apply(light),
        "transpose": transpose(radiance),
        "rows": rows[[r - 1, 0, r // 2, r // 2, 1]],
        "jvp": apply(change),
        "vjp in light": transpose(radiance),
        "vjp in values": np.sum(factors[:, None] * radiance * apply(light)),
        "vmap of apply": np.stack([apply(light) for light in random(2, d, 3, seed=3)]),
        "vmap of transpose": np.stack([transpose(radiance) for radiance in random(2, r, 3, seed=4)]),
    }
    return results | ({"many lights": rows[:, 0] @ random(d, 20)} if c == 1 else {})


_written_out = jax.jit(lambda operator: operator.to_matrix())


def near(actual, wanted, tolerance: float, of: str) -> None:
    actual, wanted = np.asarray(actual, float), np.asarray(wanted, float)
    assert actual.shape == wanted.shape, (of, actual.shape, wanted.shape)
    error = np.linalg.norm(actual - wanted) / np.linalg.norm(wanted)
    assert error < tolerance, (of, error)


def check(whole: Operator, mesh: Mesh) -> None:
    """An operator on several devices against what it says on one."""
    split = sharded(whole, mesh)
    assert split.shape == whole.shape
    actual, wanted = answers(split), expected(whole)
    for of, value in wanted.items():
        near(actual[of], value, 1e-4 if of == "vjp in values" else 2e-6, of)
    r, d, _ = whole.shape
    light, radiance = random(d, 3), random(r, 3, seed=1)
    # What is not compiled by the caller, and that each is the other's adjoint.
    forth, back = np.asarray(split.apply(light), float), np.asarray(split.transpose(radiance), float)
    near(forth, wanted["apply"], 2e-6, "apply, not compiled")
    near(back, wanted["transpose"], 2e-6, "transpose, not compiled")
    difference = float(np.vdot(forth, radiance)) - float(np.vdot(light, back))
    assert abs(difference) < 1e-6 * np.linalg.norm(forth) * np.linalg.norm(radiance), difference


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


def main(devices: str, names: str, address: str | None = None, processes: str = "1", process: str = "0") -> None:
    # Nearly all of the time is compilation.
    quick = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
    os.environ["XLA_FLAGS"] = f"--xla_force_host_platform_device_count={devices} {quick}"
    if address is not None:
        jax.config.update("jax_cpu_collectives_implementation", "gloo")
        jax.distributed.initialize(address, int(processes), int(process), initialization_timeout=60)
    assert jax.device_count() == int(devices) * int(processes)
    mesh = Mesh(np.array(jax.devices()), ("groups",))
    for name in names.split(";"):
        whole = CASES[name]()
        check(whole, mesh)
        if address is None and name not in ("fewer rows than devices", "stacked"):
            share = largest_share(whole, mesh)
            assert share < 1.2 / mesh.size, share
        print(name, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
