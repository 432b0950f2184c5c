"""Coarser levels of an SBRDF (McAllister 2002 §7)."""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from fitting.sbrdf import as_level, packed, reached
from fitting.solve import Options, fit_lobes
from jaxrelight.brdf.files.sbrdf import SbrdfLevel
from jaxrelight.brdf.pairs import spread_pairs
from jaxrelight.brdf.spatial import SpatialLobes

# Texels that are refitted together.
CHUNK = 512


def coarser(level: SbrdfLevel, mask: np.ndarray, options: Options, pairs: int = 256) -> tuple[SbrdfLevel, np.ndarray]:
    """The next level of detail: lobes refitted to the mean BRDF of every 2×2 texels, and its mask.

    Parameters do not average: two highlights beside each other are one broad one only if the functions are averaged
    (McAllister 2002 §7). Every texel's BRDF is taken in its own frame; texels off the mask do not count. There are as
    many lobes as before, whatever the options say.
    """
    h, w = mask.shape
    rows, columns = -(-h // 2), -(-w // 2)
    pad = [(0, 2 * rows - h), (0, 2 * columns - w)]

    def children(array, mode: Literal["edge", "constant"] = "edge") -> np.ndarray:
        array = np.pad(np.asarray(array), [*pad, *[(0, 0)] * (array.ndim - 2)], mode=mode)
        by_row = array.reshape(rows, 2, columns, 2, *array.shape[2:])
        return by_row.swapaxes(1, 2).reshape(rows, columns, 4, *array.shape[2:])

    counted = children(mask, "constant")
    new_mask = np.asarray(counted.any(axis=2))
    texels = jax.tree.map(lambda a: children(a)[new_mask], level.lobes)
    options = dataclasses.replace(options, lobes=level.lobes.lobes)
    parameters = refitted(texels, counted[new_mask], options, pairs)
    normals = mean_normals(children(level.normals), counted)
    return as_level(parameters, new_mask, normals, options), new_mask


def refitted(
    texels: SpatialLobes, shares: Real[np.ndarray, "p q"] | Bool[np.ndarray, "p q"], options: Options, pairs: int = 256
) -> Float[np.ndarray, "p width"]:
    """Lobes of least squared error to Σ_q share_q f_q / Σ_q share_q of every p, as `as_level` takes them.

    They are anisotropic where texels are, about the mean of their directions. Equal texels stay what they are.

    Args:
        texels: whose arrays lead with the axes p and q.
        shares: of each; no row may be 0.
        options: of the fit.
        pairs: of directions that the functions are compared in.
    """
    texels = jax.tree.map(np.asarray, texels)
    parameters, alike = _common(texels, shares)
    texels, shares = jax.tree.map(lambda a: a[~alike], texels), shares[~alike]
    omega_i, omega_o = spread_pairs(pairs)
    weight = (omega_i[:, 2] * omega_o[:, 2]) ** 2
    options = dataclasses.replace(options, anisotropic=bool(np.any(texels.C[..., 0] != texels.C[..., 1])))

    def chunk(start: int) -> np.ndarray:
        """The rows of a chunk; chunks are of one size, so that one program does for every level."""
        index = np.minimum(np.arange(start, start + CHUNK), len(shares) - 1)
        chunk_texels = jax.tree.map(lambda a: jnp.asarray(a[index]), texels)
        share = jnp.asarray(shares[index], jnp.float32)
        axis = _mean_axis(chunk_texels, share)
        mean = _mean_values(chunk_texels, axis, share, omega_i, omega_o)
        fits = fit_lobes(omega_i, omega_o, mean, weight, options=options)
        known = reached(fits.brdf, *(a[None] for a in (omega_i, omega_o, weight)))
        bounded = jnp.where(known[..., None], fits.brdf.scale, 0)
        fits = dataclasses.replace(fits, brdf=dataclasses.replace(fits.brdf, scale=bounded))
        return np.asarray(packed(fits, jnp.arctan2(axis[:, 1], axis[:, 0]) / 2))

    rows = [chunk(start) for start in range(0, len(shares), CHUNK)]
    if rows:
        parameters[~alike] = np.concatenate(rows)[: len(shares)]
    return parameters


def _common(texels: SpatialLobes, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first texel of every p, as `as_level` takes it, and whether all that have a share equal it."""
    p, first = np.arange(len(shares)), np.argmax(shares > 0, axis=1)
    alike = np.ones(len(shares), bool)
    for leaf in jax.tree.leaves(texels):
        same = (leaf == leaf[p, first][:, None]).reshape(*shares.shape, -1).all(axis=-1)
        alike &= (same | (shares == 0)).all(axis=1)
    parts = [leaf[p, first].reshape(len(p), -1) for leaf in jax.tree.leaves(texels)]
    return np.concatenate([*parts, np.zeros((len(p), 2))], axis=1, dtype=np.float32), alike


def mean_normals(
    normals: Float[np.ndarray, "*p q 3"], shares: Real[np.ndarray, "*p q"] | Bool[np.ndarray, "*p q"]
) -> Float[np.ndarray, "*p 3"]:
    """Unit vectors along the weighted means; where these are 0, the surface's own."""
    total = np.where(shares[..., None] > 0, shares[..., None] * normals, 0).sum(axis=-2)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1), [0, 0, 1])


@jax.jit
def _mean_axis(lobes: SpatialLobes, shares: Float[Array, "p q"]) -> Float[Array, "p 2"]:
    """(cos 2φ, sin 2φ) of the direction that all texels have in common; (1, 0) where they have none.

    Each counts by how bright and how anisotropic its lobes are; Cx² − Cy² changes sign as φ turns by a right angle.
    """
    stretch = jnp.sum(jnp.mean(lobes.scale, axis=-1) * (lobes.C[..., 0] ** 2 - lobes.C[..., 1] ** 2), axis=-1)
    total = jnp.sum((shares * stretch)[..., None] * lobes.axis, axis=1)
    length = jnp.linalg.norm(total, axis=-1, keepdims=True)
    return jnp.where(length > 0, total / jnp.where(length > 0, length, 1), jnp.asarray([1.0, 0]))


@jax.jit
def _mean_values(lobes: SpatialLobes, axis, shares, omega_i, omega_o) -> Float[Array, "p s 3"]:
    """Means of the BRDFs of q texels in p frames that are turned to the axes."""

    def of_texel(texel, axis):
        cosine, sine = jnp.sum(texel.axis * axis), texel.axis[1] * axis[0] - texel.axis[0] * axis[1]
        relative = dataclasses.replace(texel, axis=jnp.stack([cosine, sine]))
        brdf = jax.tree.map(lambda a: a[None, None], relative).at(jnp.full(2, 0.5))
        return jax.vmap(brdf.evaluate)(omega_i, omega_o)

    def mean(block):
        texels, axis, share = block
        return jnp.einsum("q,qsc->sc", share / jnp.sum(share), jax.vmap(of_texel, in_axes=(0, None))(texels, axis))

    return jax.lax.map(mean, (lobes, axis, shares), batch_size=64)
