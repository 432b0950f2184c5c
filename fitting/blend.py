"""Blends of BRDFs, and one SBRDF composed of several (McAllister 2002 §7 and Figure 5d).

Parameters of lobes are no vectors: half of two lobes' parameters is a third lobe, which may be like neither. So
functions are averaged, over samples of their domain, and lobes are fitted to the mean.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fitting.brdf_samples import BrdfSamples, Grid, sample
from fitting.lafortune import LafortuneFit, fit_lafortune
from fitting.sbrdf import as_level
from fitting.sbrdf_levels import mean_normals, refitted
from fitting.solve import Options
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.files.sbrdf import SbrdfLevel
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.errors import InputError


def blended(
    first: Brdf,
    second: Brdf,
    share: float,
    options: Options = Options(),
    weight: str = "log-cosine",
    grid: Grid = Grid(),
) -> LafortuneFit:
    """Lobes fitted to (1 − share) · first + share · second.

    Args:
        first: any BRDF.
        second: another, of as many channels.
        share: of the second, 0 … 1.
        options: number and kind of lobes, and how they are sought.
        weight: a name that `weights` knows.
        grid: where both are sampled; anisotropic ones need rotations.

    Raises:
        InputError: for a share or a weight that is none, or if the channels differ.
    """
    if not 0 <= share <= 1:
        raise InputError(f"the share of a blend must be from 0 to 1, not {share}")
    if first.channels != second.channels:
        raise InputError(f"BRDFs of {first.channels} and of {second.channels} channels cannot be blended")
    first_samples, second_samples = (sample(brdf, grid) for brdf in (first, second))
    mean = (1 - share) * first_samples.values + share * second_samples.values
    return fit_lafortune(BrdfSamples(first_samples.omega_i, first_samples.omega_o, mean), options, weight)


def uniform(brdf: LobeSum, shape: tuple[int, int]) -> SbrdfLevel:
    """A BRDF as the SBRDF that is the same in all of (rows, columns) texels.

    Raises:
        InputError: if its lobes differ by channel, which SBRDFs have no place for.
    """
    if brdf.C.shape[1] != 1:
        raise InputError("an SBRDF's lobes are shared by the channels; fit this material without --per-channel")
    angle = 0.0 if brdf.turn is None else brdf.turn
    axis = jnp.stack([jnp.cos(2 * jnp.asarray(angle)), jnp.sin(2 * jnp.asarray(angle))])
    maps = brdf.diffuse, brdf.C[:, 0], brdf.exponent[:, 0], brdf.scale, axis
    lobes = SpatialLobes(*(jnp.broadcast_to(part, (*shape, *part.shape)) for part in maps))
    normals = np.broadcast_to(np.array([0.0, 0, 1]), (*shape, 3))
    return SbrdfLevel(lobes, normals, np.zeros(shape, int), np.zeros(shape, np.float32))


def painted(level: SbrdfLevel, angle: Float[np.ndarray, "h w"]) -> SbrdfLevel:
    """An SBRDF whose directions of anisotropy are painted.

    Args:
        level: what to turn.
        angle: in radians from the direction of growing u, counter-clockwise, of every texel; π makes no difference.

    Raises:
        InputError: if there is not a finite angle for every texel.
    """
    if np.shape(angle) != level.lobes.shape or not np.isfinite(angle).all():
        raise InputError(f"the map of angles must hold finite numbers for {level.lobes.shape} texels")
    axis = jnp.asarray(np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=-1), level.lobes.axis.dtype)
    return dataclasses.replace(level, lobes=dataclasses.replace(level.lobes, axis=axis))


def composed(
    layers: Sequence[tuple[SbrdfLevel, Float[np.ndarray, "h w"]]], options: Options | None = None
) -> SbrdfLevel:
    """One SBRDF of several, each where its mask says.

    Where a single mask is not 0, that layer's texel is copied; where several are, lobes are refitted to the mean of
    the functions, weighted by the masks. Where all are 0 there is no surface.

    Args:
        layers: SBRDFs of the same size, and a mask for each, 0 or more.
        options: of the refits; by default with as many lobes as the layer of most.

    Raises:
        InputError: if sizes differ, a mask is negative or not finite, no mask shows anything, or there are to be fewer
            lobes than a layer has.
    """
    masks = _masks(layers)
    most = max(level.lobes.lobes for level, _ in layers)
    options = options or Options(lobes=max(most, 1))
    if options.lobes < most:
        raise InputError(f"a layer has {most} lobes, more than the {options.lobes} asked for; ask for as many")
    padded = [_with_lobes(level.lobes, options.lobes) for level, _ in layers]
    texels = jax.tree.map(lambda *maps: np.stack([np.asarray(m) for m in maps], axis=2), *padded)
    normals = mean_normals(np.stack([level.normals for level, _ in layers], axis=2), masks)
    count = (masks > 0).sum(axis=2)
    mixed = count > 1
    if mixed.any():
        parameters = refitted(jax.tree.map(lambda a: a[mixed], texels), masks[mixed], options)
    else:
        parameters = np.zeros((0, 7 * options.lobes + 7), np.float32)
    blended = as_level(parameters, mixed, normals, options)
    single, owner = count == 1, masks.argmax(axis=2)[..., None]

    def chosen(maps, otherwise):
        """The owner's texels where there is a single one. Maps [h, w, q, …]."""
        index = owner.reshape(*owner.shape, *[1] * (maps.ndim - 3))
        of_owner = np.take_along_axis(maps, index, axis=2)[:, :, 0]
        return np.where(single.reshape(*single.shape, *[1] * (of_owner.ndim - 2)), of_owner, np.asarray(otherwise))

    flags, residuals = (
        np.stack([getattr(level, name) for level, _ in layers], axis=2) for name in ("flag", "residual")
    )
    return SbrdfLevel(
        jax.tree.map(lambda maps, other: jnp.asarray(chosen(maps, other)), texels, blended.lobes),
        normals,
        chosen(flags, blended.flag),
        chosen(residuals, blended.residual),
    )


def _masks(layers) -> Float[np.ndarray, "h w q"]:
    if not layers:
        raise InputError("an SBRDF is composed of at least one layer")
    shape = layers[0][0].lobes.shape
    for number, (level, mask) in enumerate(layers, 1):
        if level.lobes.shape != shape or np.shape(mask) != shape:
            raise InputError(
                f"layer {number}: has {level.lobes.shape} texels and a mask of {np.shape(mask)}; "
                f"all must have {shape}, as the first layer"
            )
        if not (np.isfinite(mask).all() and np.min(mask) >= 0):
            raise InputError(f"layer {number}: its mask must be finite and not negative")
    masks = np.stack([np.asarray(mask, float) for _, mask in layers], axis=2)
    if not masks.any():
        raise InputError("all masks are 0: no texel would show anything")
    return masks


def _with_lobes(texels: SpatialLobes, count: int) -> SpatialLobes:
    """Texels of as many lobes as `count`; those that are added are black, and can be interpolated."""
    added = count - texels.lobes
    h, w = texels.shape
    C = jnp.broadcast_to(jnp.asarray([-1.0, -1.0, 1.0], texels.C.dtype), (h, w, added, 3))
    ones = jnp.ones((h, w, added), texels.exponent.dtype)
    black = jnp.zeros((h, w, added, texels.diffuse.shape[-1]), texels.scale.dtype)
    return SpatialLobes(
        texels.diffuse,
        jnp.concatenate([texels.C, C], axis=2),
        jnp.concatenate([texels.exponent, ones], axis=2),
        jnp.concatenate([texels.scale, black], axis=2),
        texels.axis,
    )
