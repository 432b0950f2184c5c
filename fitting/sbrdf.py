"""A Lafortune BRDF for every texel of a stack of images (McAllister 2002 §3)."""

import dataclasses
import pathlib
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fitting.normals import estimated_normals
from fitting.residuals import columns, factors
from fitting.samples import prepare
from fitting.solve import Fits, Options, Verdict, fit_lobes
from fitting.stack import Stack
from fitting.stack_checks import check_fit, check_stack
from jaxrelight.brdf.files.sbrdf import SbrdfLevel
from jaxrelight.brdf.lobes import LobeSum, turned
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.files import store
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.numerics import safe

# Texels of a chunk: the unit of progress and of resuming.
CHUNK = 2048
# Samples that say nothing of a texel: lit or seen at a grazing angle, or darker than this share of what Lambert's law
# predicts from the texel's median, so in a shadow that something casts.
MIN_COSINE, SHADOW = 0.08, 0.1
# Texels that the lobes of the whole surface are fitted to, samples that stand for them in a texel's own fit, and the
# share of its weight that these have: chosen by images held out of the DiLiGenT ball.
_POOL, _PRIOR, SHARE = 256, 32, 0.1
# A lobe of which no sample sees as much as this share of the peak is extrapolated, and may be of any height there.
_SEEN = 0.25
# Lobes of the whole surface are a texel's where a sample sees this share of their peak.
_MET = 0.05
# The same of the highest peak that a lobe has for any eye: photographs have one, pictures will have others.
_REACHED = 1e-3
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
        return {str(verdict): int((flags == verdict).sum()) for verdict in Verdict if (flags == verdict).any()}


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
    fitted to many texels together, and stand beside a texel's own samples with a small weight. A texel whose samples
    still do not determine its lobes, or see none of their peaks, is given the common C and exponents, with albedos of
    its own, and the verdict `UNCERTAIN`; it is diffuse where the whole surface shows no lobe either.

    Args:
        stack: images, lights and, where they are known, normals; else they are estimated.
        options: of the fit; with `anisotropic`, a direction of anisotropy is sought for every texel.
        share: weight of the surface's common lobes, over that of a texel's own samples; 0 for each texel by itself,
            whatever comes of it.
        folder: where finished chunks are kept, so that a run that was stopped goes on; nothing is kept without one.
        report: called after every chunk.

    Raises:
        InputError: for stacks that cannot be what they are meant to be: black or saturated images, axes that are
            negated or exchanged, lights that leave normals open, or hardly any texel with enough samples.
    """
    check_stack(stack)
    estimated = stack.normals is None
    normals = estimated_normals(stack) if estimated else np.asarray(stack.normals)
    place = np.flatnonzero(stack.mask)
    images = stack.images.reshape(len(stack.images), -1, 3)
    usable = stack.usable.reshape(len(stack.images), -1)
    flat_normals = normals.reshape(-1, 3)
    common = _common(stack, normals, options) if share > 0 else None
    chunks = -(-len(place) // CHUNK)
    width = 7 * options.lobes + 7
    # Near lamps are lights from positions.
    near = () if stack.positions is None else (stack.positions, np.array(stack.size))
    data = stack.images, stack.usable, stack.lights, *near, stack.views, normals, stack.mask
    key = store.key_of(*data, dataclasses.astuple(options), share, CHUNK)
    layer = None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        layer = store.make_layer(folder / f"texels-{key}", {"texels": ((CHUNK, width), np.dtype(np.float32))}, chunks)
    parameters = np.zeros((chunks, CHUNK, width), np.float32)
    for number in range(chunks):
        if layer is not None and layer.has(number):
            parameters[number] = layer.read("texels", number)
        else:
            chunk_place = place[number * CHUNK : (number + 1) * CHUNK]
            padded = np.pad(chunk_place, (0, CHUNK - len(chunk_place)), mode="edge")
            values = images[:, padded].swapaxes(0, 1), usable[:, padded].T, flat_normals[padded]
            directions = stack.towards_lights(padded), stack.views
            parameters[number] = np.asarray(_fit_texels(*values, *directions, common, share, options))
            if layer is not None:
                layer.write(number, texels=parameters[number])
        report(min(len(place), (number + 1) * CHUNK), len(place))
    level = as_level(parameters.reshape(-1, width)[: len(place)], stack.mask, normals, options)
    check_fit(level.flag[stack.mask], stack.name)
    return SbrdfFit(level, stack.mask, estimated)


@jax.jit
def prepared(
    images: Float[Array, "p n c"],
    usable: Bool[Array, "p n"],
    normals: Float[Array, "p 3"],
    lights: Float[Array, "*#p n 3"],
    views: Float[Array, "n 3"],
) -> tuple[Float[Array, "p n 3"], Float[Array, "p n 3"], Float[Array, "p n c"], Float[Array, "p n"]]:
    """Local directions [p, n, 3], values of f [p, n, 3] and weights [p, n] of some texels.

    Lights are far away, or directions that every texel has for itself.
    """
    frames = jax.vmap(tangent_frame)(normals)
    omega_i = jnp.einsum("pxy,pny->pnx" if lights.ndim == 3 else "pxy,ny->pnx", frames, lights)
    omega_o = jnp.einsum("pxy,ny->pnx", frames, views)
    cosine = omega_i[..., 2]
    seen = usable & (cosine > MIN_COSINE) & (omega_o[..., 2] > MIN_COSINE)
    grey = jnp.mean(images, axis=-1) / jnp.where(seen, cosine, 1)
    median = jnp.nanmedian(jnp.where(seen, grey, jnp.nan), axis=1, keepdims=True)
    seen = seen & (grey >= SHADOW * median)
    values = images / jnp.where(seen, cosine, 1)[..., None]
    return omega_i, omega_o, values, jnp.where(seen, cosine**2, 0)


def _common(stack: Stack, normals: Float[np.ndarray, "h w 3"], options: Options) -> LobeSum:
    """Lobes of many texels together, fitted to what remains when each one's median, its diffuse part, is taken off."""
    place = np.argwhere(stack.mask)
    chosen = tuple(place[np.linspace(0, len(place) - 1, min(_POOL, len(place))).astype(int)].T)
    lights = stack.towards_lights(np.asarray(np.ravel_multi_index(chosen, stack.mask.shape)))
    directions = (jnp.asarray(a, jnp.float32) for a in (normals[chosen], lights, stack.views))
    values = stack.images[:, *chosen].swapaxes(0, 1), stack.usable[:, *chosen].T
    omega_i, omega_o, f, weight = prepared(*values, *directions)
    over = f - _median(f, weight)[:, None]
    together = [a.reshape(1, -1, *a.shape[2:]) for a in (omega_i, omega_o, over, weight)]
    fits = fit_lobes(*together, options=dataclasses.replace(options, anisotropic=False))
    brdf = jax.tree.map(lambda a: a[0], fits.brdf)
    unknown = _undetermined(fits, together[0], together[1], together[3])[0]
    return dataclasses.replace(brdf, diffuse=jnp.zeros(3), scale=jnp.where(unknown, 0, brdf.scale))


@jax.jit
def _undetermined(fits: Fits, omega_i, omega_o, weight) -> Bool[Array, " p"]:
    """Whether samples leave a lobe open: by their Jacobian, or because none of them is near its peak."""
    along = fits.brdf.C[:, :, 0][:, None] * omega_o[:, :, None]  # [p, n, l, 3]
    length = safe.norm(along)
    cosine = jnp.einsum("pnla,pna->pnl", along, omega_i) / jnp.where(length > 0, length, 1)
    nearest = jnp.max(jnp.where(weight[..., None] > 0, cosine, 0), axis=1)
    seen = safe.power(nearest, fits.brdf.exponent[:, :, 0])
    active = jnp.any(fits.brdf.scale > 0, axis=-1)
    seen = jnp.where(reached(fits.brdf, omega_i, omega_o, weight), seen, 0)
    open_ends = (fits.verdict == Verdict.UNCERTAIN) | (fits.verdict == Verdict.AT_BOUND)
    return open_ends | jnp.any(active & (seen < _SEEN), axis=1)


@jax.jit
def reached(
    brdf: LobeSum, omega_i: Float[Array, "#p n 3"], omega_o: Float[Array, "#p n 3"], weight: Float[Array, "#p n"]
) -> Bool[Array, "p l"]:
    """Whether some sample sees a thousandth of what each lobe reflects at most.

    The others are extrapolated without bound: of |C|ⁿ that small, samples are met by any peak.
    """
    dot = jnp.sum(brdf.C[:, None, :, 0] * (omega_i * omega_o)[:, :, None], axis=-1)
    most = jnp.max(jnp.where(weight[..., None] > 0, dot, 0), axis=1)
    return safe.power(most, brdf.exponent[:, :, 0]) >= _REACHED


@jax.jit
def _with_lobes_of(common: LobeSum, fits: Fits, unknown, omega_i, omega_o, values, weight) -> Fits:
    """Some texels' lobes replaced by the common ones, with the albedos that are best for each."""

    def one(omega_i, omega_o, values, weight):
        samples = prepare(omega_i, omega_o, values, weight)
        G = columns(common.C[:, 0], common.exponent[:, 0], samples.products)
        # Lobes that the surface does not show are none here either, nor those that these samples hardly meet.
        met = jnp.max(jnp.where(weight > 0, G[1:], 0), axis=1) >= _MET
        G = G * jnp.append(True, met & jnp.any(common.scale > 0, axis=-1))[:, None] * samples.root_weight[None]
        own = samples.values * samples.root_weight[None]
        albedos = factors(G, own)
        energy = jnp.sum(own**2)
        residual = jnp.sqrt(jnp.sum((albedos @ G - own) ** 2) / jnp.where(energy > 0, energy, 1))
        brdf = LobeSum(albedos[:, 0] * samples.scale, common.C, common.exponent, albedos[:, 1:].T * samples.scale)
        return brdf, residual

    brdf, residual = jax.vmap(one)(omega_i, omega_o, values, weight)
    verdict = jnp.full_like(fits.verdict, int(Verdict.UNCERTAIN))
    new = dataclasses.replace(fits, brdf=brdf, residual=residual, verdict=verdict)
    # Nothing is known of texels without data, and they stay so.
    unknown = unknown & (fits.verdict != Verdict.NO_DATA)

    def chosen(a, b):
        return jnp.where(unknown.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    return jax.tree.map(chosen, new, fits)


def _median(f: Float[Array, "p n 3"], weight: Float[Array, "p n"]) -> Float[Array, "p 3"]:
    """The median of the samples with weight; 0 where there are none."""
    return jnp.nan_to_num(jnp.nanmedian(jnp.where(weight[..., None] > 0, f, jnp.nan), axis=1))


@jax.jit
def _with_common(omega_i, omega_o, values, weight, common: LobeSum, share):
    """Samples of texels, followed by ones of their medians and the common lobes, around the eye's mirror direction."""
    eye = safe.normalize(jnp.mean(omega_o, axis=1))
    index = np.arange(_PRIOR)
    away = np.radians(60 ** ((index + 0.5) / _PRIOR))
    around = 2 * np.pi * index * 0.6180339887498949
    pattern = np.stack([np.sin(away) * np.cos(around), np.sin(away) * np.sin(around), np.cos(away)], axis=-1)
    frames = jax.vmap(tangent_frame)(eye * jnp.asarray([[-1, -1, 1.0]]))
    lights = jnp.einsum("pxy,nx->pny", frames, jnp.asarray(pattern, eye.dtype))
    eyes = jnp.broadcast_to(eye[:, None], lights.shape)
    lobes = jax.vmap(jax.vmap(common.evaluate))(lights, eyes)
    prior = jnp.where(lights[..., 2] > MIN_COSINE, lights[..., 2] ** 2, 0)
    total = jnp.sum(prior, axis=1, keepdims=True)
    prior = prior * share * jnp.sum(weight, axis=1, keepdims=True) / jnp.where(total > 0, total, 1)
    pairs = (omega_i, lights), (omega_o, eyes), (values, _median(values, weight)[:, None] + lobes), (weight, prior)
    return tuple(jnp.concatenate(pair, axis=1) for pair in pairs)


def _fit_texels(
    images, usable, normals, lights, views, common: LobeSum | None, share: float, options: Options
) -> Float[Array, "p width"]:
    """The fits of some texels, as `packed`."""
    directions = (jnp.asarray(a, jnp.float32) for a in (normals, lights, views))
    omega_i, omega_o, values, weight = prepared(images, usable, *directions)
    if common is not None:
        omega_i, omega_o, values, weight = _with_common(omega_i, omega_o, values, weight, common, share)

    def turned_by(angle: Float[Array, " p"]) -> tuple[Array, Array]:
        return turned(omega_i, -angle[:, None]), turned(omega_o, -angle[:, None])

    def fitted(angle: Float[Array, " p"]) -> Fits:
        return fit_lobes(*turned_by(angle), values, weight, options=options)

    angle = jnp.zeros(len(values))
    if options.anisotropic:
        steps = np.arange(_ANGLES) * (np.pi / 2 / _ANGLES)
        tried = np.stack([np.asarray(fitted(jnp.full(len(values), step)).residual) for step in steps], axis=1)
        angle = jnp.asarray(_lowest(steps, tried), jnp.float32)
    fits = fitted(angle)
    if common is not None:
        directions = turned_by(angle)
        fits = _with_lobes_of(common, fits, _undetermined(fits, *directions, weight), *directions, values, weight)
    return packed(fits, angle)


def packed(fits: Fits, angle: Float[Array, " p"]) -> Float[Array, "p width"]:
    """All that is known of some texels, in the order of `as_level`."""
    brdf, count = fits.brdf, len(angle)  # arrays lead with texels; C [p, l, 1, 3]
    parts = [
        brdf.diffuse,
        brdf.C[:, :, 0].reshape(count, -1),
        brdf.exponent[:, :, 0],
        brdf.scale.reshape(count, -1),
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


def as_level(texels: np.ndarray, mask: np.ndarray, normals: np.ndarray, options: Options) -> SbrdfLevel:
    """Maps from what `packed` gave for the texels of a mask, row by row."""
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
