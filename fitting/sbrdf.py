"""A Lafortune BRDF for every texel of a stack of images (McAllister 2002 §3)."""

import dataclasses
import pathlib
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting.normals import estimated_normals
from fitting.solve import Fits, Options, Verdict, fit_lobes
from fitting.stack import Stack
from jaxrelight import safe, store
from jaxrelight.brdf.files.sbrdf import SbrdfLevel
from jaxrelight.brdf.lobes import LobeSum, turned
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.geometry.frame import tangent_frame

# Texels of a chunk: the unit of progress and of resuming.
CHUNK = 2048
# Samples that say nothing of a texel: lit or seen at a grazing angle, or darker than this share of what Lambert's law
# predicts from the texel's median, so in a shadow that something casts.
LEAST_COSINE, SHADOW = 0.08, 0.1
# Texels that the lobes of the whole surface are fitted to, samples that stand for them in a texel's own fit, and the
# share of its weight that these have: chosen by images held out of the DiLiGenT ball.
_POOL, _PRIOR, SHARE = 256, 32, 0.1
# Directions of anisotropy that are tried: a quarter of the circle, since C's x and y may change places.
_ANGLES = 6

# Told how many texels are done and how many there are.
Report = Callable[[int, int], None]


@dataclasses.dataclass(frozen=True, eq=False)
class SbrdfFit:
    """What was fitted.

    Attributes:
        level: the maps.
        mask: texels that show the surface.
        estimated: whether the normals come from the images themselves.
    """

    level: SbrdfLevel
    mask: np.ndarray
    estimated: bool

    def counts(self) -> dict[str, int]:
        """Texels by verdict."""
        flags = self.level.flag[self.mask]
        return {verdict.name.lower(): int((flags == verdict).sum()) for verdict in Verdict if (flags == verdict).any()}


def fit_sbrdf(
    stack: Stack,
    options: Options = Options(),
    share: float = SHARE,
    folder: pathlib.Path | None = None,
    report: Report = lambda done, total: None,
) -> SbrdfFit:
    """Fits every texel of the mask by itself, in chunks.

    A sample is the image's value, that is f · cosθ_i under a light of irradiance 1, and is fitted as that: the weight
    of f is cos²θ_i. Samples in attached and cast shadow, at grazing angles, saturated or not finite take no part.
    Texels whose fit is not good are flagged by their `Verdict`.

    Few lights meet a narrow highlight, and a texel that none of them meets could be given any. So lobes are first
    fitted to many texels together, and stand beside a texel's own samples with a small weight: they decide where
    those say nothing.

    Args:
        stack: images, lights and, where they are known, normals; else they are estimated.
        options: of the fit; with `anisotropic`, a direction of anisotropy is sought for every texel.
        share: weight of the surface's common lobes, over that of a texel's own samples; 0 for each texel by itself.
        folder: where finished chunks are kept, so that a run that was stopped goes on; nothing is kept without one.
        report: called after every chunk.
    """
    estimated = stack.normals is None
    normals = estimated_normals(stack) if estimated else np.asarray(stack.normals)
    place = np.flatnonzero(stack.mask)
    images = stack.images.reshape(len(stack.images), -1, 3)
    usable = stack.usable.reshape(len(stack.images), -1)
    flat_normals = normals.reshape(-1, 3)
    common = _common(stack, normals, options) if share > 0 else None
    chunks = -(-len(place) // CHUNK)
    width = 7 * options.lobes + 7
    key = store.key_of(
        stack.images, stack.usable, stack.lights, stack.views, normals, stack.mask, dataclasses.astuple(options)
    )
    layer = None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        layer = store.make_layer(folder / f"texels-{key}", {"texels": ((CHUNK, width), np.dtype(np.float32))}, chunks)
    found = np.zeros((chunks, CHUNK, width), np.float32)
    for number in range(chunks):
        if layer is not None and layer.has(number):
            found[number] = layer.read("texels", number)
        else:
            mine = place[number * CHUNK : (number + 1) * CHUNK]
            padded = np.pad(mine, (0, CHUNK - len(mine)), mode="edge")
            values = images[:, padded].swapaxes(0, 1), usable[:, padded].T, flat_normals[padded]
            found[number] = np.asarray(_fit_texels(*values, stack.lights, stack.views, common, share, options))
            if layer is not None:
                layer.write(number, texels=found[number])
        report(min(len(place), (number + 1) * CHUNK), len(place))
    return SbrdfFit(
        _as_level(found.reshape(-1, width)[: len(place)], stack.mask, normals, options), stack.mask, estimated
    )


def _samples(images, usable, normals, lights, views):
    """Local directions [p, n, 3], values of f [p, n, 3] and weights [p, n]."""
    frames = jax.vmap(tangent_frame)(normals)
    omega_i, omega_o = (jnp.einsum("pxy,ny->pnx", frames, side) for side in (lights, views))
    cosine = omega_i[..., 2]
    seen = usable & (cosine > LEAST_COSINE) & (omega_o[..., 2] > LEAST_COSINE)
    grey = jnp.mean(images, axis=-1) / jnp.where(seen, cosine, 1)
    median = jnp.nanmedian(jnp.where(seen, grey, jnp.nan), axis=1, keepdims=True)
    seen = seen & (grey >= SHADOW * median)
    values = images / jnp.where(seen, cosine, 1)[..., None]
    return omega_i, omega_o, values, jnp.where(seen, cosine**2, 0)


@jax.jit
def _prepared(images, usable, normals, lights, views):
    return _samples(jnp.asarray(images), usable, normals, lights, views)


def _common(stack: Stack, normals: Float[np.ndarray, "h w 3"], options: Options) -> LobeSum:
    """Lobes of many texels together, of what remains when each one's median, its diffuse part, is taken off."""
    place = np.argwhere(stack.mask)
    chosen = tuple(place[np.linspace(0, len(place) - 1, min(_POOL, len(place))).astype(int)].T)
    directions = (jnp.asarray(a, jnp.float32) for a in (normals[chosen], stack.lights, stack.views))
    values = stack.images[:, *chosen].swapaxes(0, 1), stack.usable[:, *chosen].T
    omega_i, omega_o, f, weight = _prepared(*values, *directions)
    over = f - _median(f, weight)[:, None]
    together = [a.reshape(1, -1, *a.shape[2:]) for a in (omega_i, omega_o, over, weight)]
    found = fit_lobes(*together, options=dataclasses.replace(options, anisotropic=False))
    return dataclasses.replace(jax.tree.map(lambda a: a[0], found.brdf), diffuse=jnp.zeros(3))


def _median(f: Float[Array, "p n 3"], weight: Float[Array, "p n"]) -> Float[Array, "p 3"]:
    """Of the samples with weight; 0 where there are none."""
    return jnp.nan_to_num(jnp.nanmedian(jnp.where(weight[..., None] > 0, f, jnp.nan), axis=1))


@jax.jit
def _with_common(omega_i, omega_o, values, weight, common: LobeSum, share):
    """Samples of texels, followed by ones of their medians and the common lobes, around the eye's mirror direction."""
    eye = safe.normalize(jnp.mean(omega_o, axis=1))
    index = np.arange(_PRIOR)
    away = np.radians(60 ** ((index + 0.5) / _PRIOR))
    around = 2 * np.pi * index * 0.6180339887498949
    pattern = np.stack([np.sin(away) * np.cos(around), np.sin(away) * np.sin(around), np.cos(away)], axis=-1)
    frames = jax.vmap(tangent_frame)(eye * jnp.asarray([-1, -1, 1.0]))
    lights = jnp.einsum("pxy,nx->pny", frames, jnp.asarray(pattern, eye.dtype))
    eyes = jnp.broadcast_to(eye[:, None], lights.shape)
    lobes = jax.vmap(jax.vmap(common.evaluate))(lights, eyes)
    prior = jnp.where(lights[..., 2] > LEAST_COSINE, lights[..., 2] ** 2, 0)
    total = jnp.sum(prior, axis=1, keepdims=True)
    prior = prior * share * jnp.sum(weight, axis=1, keepdims=True) / jnp.where(total > 0, total, 1)
    pairs = (omega_i, lights), (omega_o, eyes), (values, _median(values, weight)[:, None] + lobes), (weight, prior)
    return tuple(jnp.concatenate(pair, axis=1) for pair in pairs)


def _fit_texels(
    images, usable, normals, lights, views, common: LobeSum | None, share: float, options: Options
) -> Float[Array, "p width"]:
    """All that is known of some texels, in the order of `_as_level`."""
    directions = (jnp.asarray(a, jnp.float32) for a in (normals, lights, views))
    omega_i, omega_o, values, weight = _prepared(images, usable, *directions)
    if common is not None:
        omega_i, omega_o, values, weight = _with_common(omega_i, omega_o, values, weight, common, share)

    def turned_by(angle: Float[Array, " p"]) -> Fits:
        sides = (turned(omega, -angle[:, None]) for omega in (omega_i, omega_o))
        return fit_lobes(*sides, values, weight, options=options)

    angle = jnp.zeros(len(values))
    if options.anisotropic:
        steps = np.arange(_ANGLES) * (np.pi / 2 / _ANGLES)
        tried = np.stack([np.asarray(turned_by(jnp.full(len(values), step)).residual) for step in steps], axis=1)
        angle = jnp.asarray(_lowest(steps, tried), jnp.float32)
    fits = turned_by(angle)
    brdf = fits.brdf  # arrays lead with texels; C [p, l, 1, 3]
    parts = [
        brdf.diffuse,
        brdf.C[:, :, 0].reshape(len(values), -1),
        brdf.exponent[:, :, 0],
        brdf.scale.reshape(len(values), -1),
        jnp.stack([jnp.cos(2 * angle), jnp.sin(2 * angle), fits.verdict.astype(jnp.float32), fits.residual], axis=1),
    ]
    return jnp.concatenate(parts, axis=1)


def _lowest(angles: Float[np.ndarray, " a"], residuals: Float[np.ndarray, "p a"]) -> Float[np.ndarray, " p"]:
    """The angle where a parabola through the lowest residual and its neighbours, around the circle, is lowest."""
    count, step = len(angles), angles[1] - angles[0]
    squares = np.nan_to_num(residuals**2, nan=np.inf)
    best = np.argmin(squares, axis=1)
    rows = np.arange(len(squares))
    left, here, right = (squares[rows, (best + shift) % count] for shift in (-1, 0, 1))
    bend = left - 2 * here + right
    curved = np.isfinite(bend) & (bend > 0)
    shift = np.where(curved, (left - right) / (2 * np.where(curved, bend, 1)), 0)
    return angles[best] + step * np.clip(shift, -0.5, 0.5)


def _as_level(texels: np.ndarray, mask: np.ndarray, normals: np.ndarray, options: Options) -> SbrdfLevel:
    lobes = options.lobes
    whole = np.zeros((*mask.shape, texels.shape[1]), np.float32)
    # Off the surface: black, and of a lobe that can be interpolated.
    whole[..., 3 : 3 + 3 * lobes] = np.tile([-1, -1, 1], lobes)
    whole[..., 3 + 3 * lobes : 3 + 4 * lobes] = 1
    whole[..., -4:] = 1, 0, Verdict.NO_DATA, np.nan
    whole[mask] = texels
    diffuse, C, exponent, scale, axis, flag, residual = np.split(
        whole, np.cumsum([3, 3 * lobes, lobes, 3 * lobes, 2, 1]), axis=-1
    )
    shape = mask.shape
    maps = diffuse, C.reshape(*shape, lobes, 3), exponent, scale.reshape(*shape, lobes, 3), axis
    return SbrdfLevel(SpatialLobes(*map(jnp.asarray, maps)), normals, flag[..., 0].astype(int), residual[..., 0])


def predicted(level: SbrdfLevel, stack: Stack) -> Float[np.ndarray, "n h w 3"]:
    """The images of a stack as the fit has them: f · cosθ_i, 0 where the light or the eye is below the surface."""
    mask = stack.mask
    lobes = jax.tree.map(lambda a: a[mask], level.lobes)
    # Texels as rows of one column each, so that they are not interpolated.
    alone = jax.tree.map(lambda a: a[:, None, None], lobes)
    normals = jnp.asarray(level.normals[mask], jnp.float32)
    images = np.zeros((*stack.usable.shape, 3), np.float32)
    for image, light, view in zip(images, stack.lights, stack.views, strict=True):
        sides = jnp.asarray(light, jnp.float32), jnp.asarray(view, jnp.float32)
        image[mask] = np.asarray(_radiance(alone, normals, *sides))
    return images


@jax.jit
def _radiance(alone: SpatialLobes, normals, light, view):
    def one(texel, normal):
        frame = tangent_frame(normal)
        omega_i, omega_o = frame @ light, frame @ view
        value = texel.at(jnp.full(2, 0.5)).evaluate(omega_i, omega_o) * omega_i[2]
        return jnp.where((omega_i[2] > 0) & (omega_o[2] > 0), value, 0)

    return jax.vmap(one)(alone, normals)


def relative_error(images: np.ndarray, stack: Stack) -> float:
    """Root mean square of images − stack over that of the stack, over the usable samples of the mask."""
    counted = stack.usable & stack.mask
    apart, whole = images[counted] - stack.images[counted], stack.images[counted]
    return float(np.sqrt(np.sum(apart.astype(float) ** 2) / np.sum(whole.astype(float) ** 2)))


def lambert_only(stack: Stack, normals: Float[np.ndarray, "h w 3"]) -> SbrdfLevel:
    """Albedos of least squared error, what any lobe must do better than."""
    mask = stack.mask
    values = stack.images[:, mask].swapaxes(0, 1), stack.usable[:, mask].T
    directions = (jnp.asarray(a, jnp.float32) for a in (normals[mask], stack.lights, stack.views))
    _, _, f, weight = _prepared(*values, *directions)
    total = jnp.sum(weight, axis=1, keepdims=True)
    albedo = np.zeros((*mask.shape, 3), np.float32)
    albedo[mask] = np.asarray(jnp.pi * jnp.sum(weight[..., None] * f, axis=1) / jnp.where(total > 0, total, 1))
    none = np.zeros((*mask.shape, 0, 3), np.float32)
    axis = np.broadcast_to(np.float32([1, 0]), (*mask.shape, 2))
    maps = albedo, none, none[..., 0], none, axis
    return SbrdfLevel(
        SpatialLobes(*map(jnp.asarray, maps)),
        normals,
        np.zeros(mask.shape, int),
        np.full(mask.shape, np.nan, np.float32),
    )


def coarser(level: SbrdfLevel, mask: np.ndarray, options: Options, pairs: int = 256) -> tuple[SbrdfLevel, np.ndarray]:
    """The next level of detail: lobes refitted to the mean BRDF of every 2×2 texels, and its mask.

    Parameters do not average: two highlights beside each other are one broad one only if the functions are averaged
    (McAllister 2002 §7). Every texel's BRDF is taken in its own frame; texels off the mask do not count.
    """
    h, w = mask.shape
    rows, columns = -(-h // 2), -(-w // 2)
    pad = [(0, 2 * rows - h), (0, 2 * columns - w)]

    def children(array):
        array = np.pad(np.asarray(array), pad + [(0, 0)] * (array.ndim - 2), mode="edge")
        return (
            array.reshape(rows, 2, columns, 2, *array.shape[2:])
            .swapaxes(1, 2)
            .reshape(rows, columns, 4, *array.shape[2:])
        )

    counted = children(mask) & np.pad(np.ones(mask.shape, bool), pad).reshape(rows, 2, columns, 2).swapaxes(
        1, 2
    ).reshape(rows, columns, 4)
    new_mask = counted.any(axis=2)
    omega_i, omega_o = spread_pairs(pairs)
    lobes = jax.tree.map(lambda a: jnp.asarray(children(a)[new_mask]), level.lobes)
    mean = _mean_values(lobes, jnp.asarray(counted[new_mask]), omega_i, omega_o)
    weight = jnp.broadcast_to((omega_i[:, 2] * omega_o[:, 2]) ** 2, mean.shape[:2])
    fits = fit_lobes(
        jnp.broadcast_to(omega_i, (*mean.shape[:2], 3)),
        jnp.broadcast_to(omega_o, (*mean.shape[:2], 3)),
        mean,
        weight,
        options,
    )
    brdf, n = fits.brdf, len(mean)
    angle = jnp.zeros(n)
    parts = [
        brdf.diffuse,
        brdf.C[:, :, 0].reshape(n, -1),
        brdf.exponent[:, :, 0],
        brdf.scale.reshape(n, -1),
        jnp.stack([jnp.cos(angle), jnp.sin(angle), fits.verdict.astype(jnp.float32), fits.residual], axis=1),
    ]
    normals = np.where(counted[..., None], children(level.normals), 0).sum(axis=2)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1), [0, 0, 1])
    return _as_level(np.asarray(jnp.concatenate(parts, axis=1)), new_mask, normals, options), new_mask


@jax.jit
def _mean_values(lobes: SpatialLobes, counted, omega_i, omega_o) -> Float[Array, "p s 3"]:
    def of_texel(texel):
        alone = jax.tree.map(lambda a: a[None, None], texel)
        brdf = alone.at(jnp.full(2, 0.5))
        return jax.vmap(brdf.evaluate)(omega_i, omega_o)

    def mean(block):
        texels, share = block
        return jnp.einsum("q,qsc->sc", share / jnp.sum(share), jax.vmap(of_texel)(texels))

    return jax.lax.map(mean, (lobes, counted.astype(jnp.float32)), batch_size=64)


def spread_pairs(count: int) -> tuple[Float[Array, "s 3"], Float[Array, "s 3"]]:
    """Pairs of directions above the surface, the same ones every time.

    Eyes lie over the hemisphere, lights near each eye's mirror direction and far from it: lobes of every width are met.
    """
    index = np.arange(count)
    eye_z = 0.15 + 0.85 * (index + 0.5) / count
    azimuth = 2 * np.pi * ((index * 0.7548776662) % 1)
    sine = np.sqrt(1 - eye_z**2)
    omega_o = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), eye_z], axis=-1)
    mirror = omega_o * [-1, -1, 1]
    # Angles from the mirror direction in geometric progression, 1° … 90°.
    away = np.radians(90 ** ((index * 0.5698402909) % 1))
    around = 2 * np.pi * ((index * 0.4301597090) % 1)
    first = np.cross(mirror, [1.0, 0, 0])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(mirror, first)
    tangent = np.cos(around)[:, None] * first + np.sin(around)[:, None] * second
    omega_i = np.cos(away)[:, None] * mirror + np.sin(away)[:, None] * tangent
    omega_i[:, 2] = np.abs(omega_i[:, 2])
    return jnp.asarray(omega_i, jnp.float32), jnp.asarray(omega_o, jnp.float32)
