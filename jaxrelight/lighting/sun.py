"""Light terms of the few texels of a sun: one shadow ray for each and every receiver, and the reflection as it is."""

import concurrent.futures
import os
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.basis import cubemap
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.lighting.shadows import remembered_by
from jaxrelight.methods import Transport
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.transport.compression import padded_receivers
from jaxrelight.transport.model import Block, PrecomputedTransport

# Receivers whose terms are made at a time.
_RECEIVER_BATCH = 1024


def sun_terms(
    transport: PrecomputedTransport,
    texels: Int[Array, " n"],
    radiance: Float[Array, "n c"],
    blocks: Sequence[Block] | None = None,
) -> tuple[Float[Array, "_ _ c"], ...]:
    """Light terms of every block under some texels alone, as uncompressed rows have them (Wang 2006 eq. 3).

    What bounces is not among them. Differentiable in the radiance and in reflections; shadow rays are cast on the host,
    or by a callback where arrays are traced.

    Args:
        transport: whose receivers are lit.
        texels: numbers of texels of its cube map.
        radiance: theirs; 0 for texels that no sun is in.
        blocks: some of the transport's; by default all.
    """
    assert isinstance(transport.method, Transport)
    s, n = transport.method.samples_per_side, transport.method.resolution
    samples = np.arange(6 * (n * s) ** 2).reshape(6, n, s, n, s).swapaxes(2, 3).reshape(-1, s * s)
    vectors, energy, shares = _arriving(
        texels,
        radiance,
        as_array(cubemap.directions(n * s)[samples], radiance.dtype),
        as_array(cubemap.solid_angles(n * s)[samples], radiance.dtype),
    )
    known = jax.lax.stop_gradient((vectors, shares))
    terms, visible, first = [], None, -1
    for block in transport.blocks if blocks is None else blocks:
        if not block.has_direct:
            shape = padded_receivers(block.group_count * GROUP), block.reflection.terms, radiance.shape[-1]
            terms.append(jnp.zeros(shape, radiance.dtype))
            continue
        if block.first_group != first:
            # Blocks of one material share its receivers.
            visible, first = _visibility(transport, block, *known), block.first_group
        terms.append(_of_block(transport, block, visible, vectors, energy))
    return tuple(terms)


@jax.jit
def _arriving(texels, radiance, directions, solid_angles):
    """Directions of the rays to some texels, what arrives along each, and whether anything does."""
    vectors, share = directions[texels].reshape(-1, 3), solid_angles[texels].reshape(-1, 1)
    energy = jnp.repeat(radiance, directions.shape[1], axis=0) * share
    return vectors, energy, jnp.any(energy > 0, axis=1)


def _visibility(transport: PrecomputedTransport, block: Block, vectors, lit) -> Bool[Array, "v f"]:
    def traced(vectors, lit):
        directions, lit = np.asarray(vectors), np.asarray(lit)
        visible = np.zeros((block.group_count * GROUP, len(lit)), bool)
        visible[:, lit] = _visible(transport, block, directions[lit])
        return visible

    if not is_traced((vectors, lit)):
        return as_array(traced(vectors, lit))
    shape = jax.ShapeDtypeStruct((block.group_count * GROUP, len(lit)), np.bool_)
    return jax.pure_callback(traced, shape, vectors, lit, vmap_method="sequential")


def _visible(transport: PrecomputedTransport, block: Block, directions: Float[np.ndarray, "f 3"]):
    """What is above a receiver's shading normal, and not occluded; directions that come again cost no rays."""
    receivers, groups, remembered = transport.receivers, block.groups, remembered_by(transport.tracer)
    count = block.group_count * GROUP
    own = f"{transport.stored.key} {block.first_group} ".encode()
    directions = np.ascontiguousarray(directions, np.float32)
    keys = [own + direction.tobytes() for direction in directions]
    columns = {key: bits for key in keys if (bits := remembered.get(key)) is not None}
    missing = [number for number, key in enumerate(keys) if key not in columns]
    if missing:
        origins, normals = receivers.origins[groups].reshape(-1, 3), receivers.normals[groups].reshape(-1, 3)
        origins = np.asarray(origins, np.float32)

        def towards(number):
            visible = normals @ directions[number] > 0
            rays = np.broadcast_to(directions[number], (int(visible.sum()), 3))
            visible[visible] = ~transport.tracer.occluded(origins[visible], rays)
            return np.packbits(visible)

        with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            for number, bits in zip(missing, pool.map(towards, missing), strict=True):
                columns[keys[number]] = bits
                remembered.put(keys[number], bits)
    packed = np.stack([columns[key] for key in keys]) if keys else np.zeros((0, count // 8), np.uint8)
    return np.unpackbits(packed, axis=1, count=count).astype(bool).T


def _of_block(transport: PrecomputedTransport, block: Block, visible, vectors, energy) -> Float[Array, "v k c"]:
    count = block.group_count * GROUP
    more = padded_receivers(count) - count

    def filled(array):
        flat = array.reshape(count, *np.shape(array)[2:])
        numbers = jnp if isinstance(array, jax.Array) else np
        return numbers.pad(flat, ((0, more), *[(0, 0)] * (flat.ndim - 1)), mode="edge")

    own, shared = eqx.partition(block.reflection, block.reflection.per_receiver)
    mine = slice(block.first_group, block.first_group + block.group_count)
    normals, tangents = (filled(axis[mine]) for axis in transport.receivers.single_precision_axes)
    return _terms(normals, tangents, _filled_rows(visible, more), jax.tree.map(filled, own), shared, vectors, energy)


def _filled_rows(visible: Bool[Array, "v f"], more: int) -> Bool[Array, "w f"]:
    """Visibility followed by rows of nothing."""
    if is_traced(visible):
        return jnp.pad(visible, ((0, more), (0, 0)))
    return as_array(np.pad(np.asarray(visible), ((0, more), (0, 0))))


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
    if shared.is_constant:
        cosines = jnp.maximum(jnp.matmul(normals, vectors.T, precision="highest"), 0)
        arriving = jnp.matmul(cosines * visible, energy, precision="highest")
        return shared.light_side(vectors[0])[None] * arriving[:, None]

    def receiver(arguments):
        normal, tangent, visible, own = arguments
        local = jnp.matmul(tangent_frame(normal, tangent), vectors.T, precision="highest")
        light_side = jax.vmap(eqx.combine(own, shared).light_side, in_axes=1)(local)
        arriving = (jnp.maximum(local[2], 0) * visible)[:, None] * energy
        return jnp.sum(light_side * arriving[:, None], axis=0)

    return jax.lax.map(receiver, (normals, tangents, visible, own), batch_size=_RECEIVER_BATCH)
