"""Light terms of the few texels of a sun: one shadow ray for each and every receiver, and the reflection as it is."""

import concurrent.futures
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.basis import cubemap
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.geometry.tracer import OFFSET
from jaxrelight.lights.sun import MOST
from jaxrelight.transport.compression import padded_receivers
from jaxrelight.transport.model import Block, Transport

# Receivers whose terms are made at a time.
_TOGETHER = 1024


def sun_terms(
    transport: Transport, texels: Int[np.ndarray, " n"], radiance: Float[np.ndarray, "n c"]
) -> tuple[Float[Array, "v k c"], ...]:
    """Light terms of every block under some texels alone, as uncompressed rows have them (Wang 2006 eq. 3).

    What bounces is not among them.

    Args:
        transport: whose receivers are lit.
        texels: numbers of texels of its cube map.
        radiance: theirs.
    """
    lit = np.flatnonzero(radiance.any(axis=1))
    s, n = transport.settings.samples_per_side, transport.settings.resolution
    traced = np.arange(6 * (n * s) ** 2).reshape(6, n, s, n, s).swapaxes(2, 3).reshape(-1, s * s)[texels[lit]].ravel()
    directions = cubemap.directions(n * s)[traced]
    irradiance = np.repeat(radiance[lit], s * s, axis=0) * cubemap.solid_angles(n * s)[traced, None]
    # One length for all suns; directions that fill up are lit by nothing.
    length = MOST * s * s
    vectors = np.pad(directions, ((0, length - len(traced)), (0, 0))).astype(np.float32)
    vectors[len(traced) :, 2] = 1
    energy = np.pad(irradiance, ((0, length - len(traced)), (0, 0))).astype(np.float32)
    found, visible = [], {}
    for block in transport.blocks:
        first = int(block.groups[0])
        if first not in visible:
            # Blocks of one material share its receivers.
            visible = {first: np.pad(_visible(transport, block, directions), ((0, 0), (0, length - len(traced))))}
        found.append(_of_block(transport, block, visible[first], vectors, energy))
    return tuple(found)


def _visible(transport: Transport, block: Block, directions: Float[np.ndarray, "f 3"]) -> Bool[np.ndarray, "v f"]:
    """What is above a receiver's shading normal, and not occluded."""
    receivers, groups = transport.receivers, block.groups
    arrays = receivers.positions[groups], receivers.face_normals[groups], receivers.normals[groups]
    positions, face_normals, normals = (array.reshape(-1, 3) for array in arrays)
    origins = np.asarray(positions + OFFSET * face_normals, np.float32)

    def towards(direction):
        seen = normals @ direction > 0
        rays = np.broadcast_to(direction.astype(np.float32), (int(seen.sum()), 3))
        seen[seen] = ~transport.tracer.occluded(origins[seen], rays)
        return seen

    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.stack(list(pool.map(towards, directions)), axis=1)


def _of_block(transport: Transport, block: Block, visible, vectors, energy) -> Float[Array, "v k c"]:
    count = len(block.groups) * GROUP
    more = padded_receivers(count) - count

    def filled(array):
        flat = np.asarray(array).reshape(count, *np.shape(array)[2:])
        return np.pad(flat, ((0, more), *[(0, 0)] * (flat.ndim - 1)), mode="edge")

    own, shared = eqx.partition(block.reflection, block.reflection.per_receiver)
    axes = [filled(axis[block.groups]) for axis in (transport.receivers.normals, transport.receivers.tangents)]
    normals, tangents = (axis.astype(np.float32) for axis in axes)
    seen = np.pad(visible, ((0, more), (0, 0)))
    return _terms(normals, tangents, seen, jax.tree.map(filled, own), shared, vectors, energy)


@jax.jit
def _terms(
    normals: Float[Array, "v 3"],
    tangents: Float[Array, "v 3"],
    visible: Bool[Array, "v f"],
    own: Reflection,
    shared: Reflection,
    vectors: Float[Array, "f 3"],
    energy: Float[Array, "f c"],
) -> Float[Array, "v k c"]:
    def receiver(arguments):
        normal, tangent, visible, own = arguments
        local = jnp.matmul(tangent_frame(normal, tangent), vectors.T, precision="highest")
        light_side = jax.vmap(eqx.combine(own, shared).light_side, in_axes=1)(local)
        arriving = (jnp.maximum(local[2], 0) * visible)[:, None] * energy
        return jnp.sum(light_side * arriving[:, None], axis=0)

    return jax.lax.map(receiver, (normals, tangents, visible, own), batch_size=_TOGETHER)
