"""Shading where bandwidth asks, with as many samples as noise asks (Bagher 2011): nothing is precomputed for a mesh.

A few samples of each pixel predict how its light varies. From that follow the pixels that are shaded, the samples that
each of them gets, and the weights by which all others lie between them. Components of a material are shaded apart and
multiplied by its textures in every pixel, so textures never ask for shading.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import ndimage

from jaxrelight.brdf.texture import look_up
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.curvature import curvature
from jaxrelight.lighting.adaptive.estimate import Blocked, estimate
from jaxrelight.lighting.adaptive.hierarchy import Features, hierarchy
from jaxrelight.lighting.adaptive.planning import Asked, Plan, planned
from jaxrelight.lighting.adaptive.prediction import Prediction, directions, draw, predict
from jaxrelight.lighting.adaptive.sampled import Sampled, sampled
from jaxrelight.lighting.pixels import padded
from jaxrelight.lighting.prefiltered import Seen, SeenMaterial, SurfacePixels
from jaxrelight.lights.pyramid import LightPyramid
from jaxrelight.numerics.buckets import filled_up, image_bucket

# Samples that predict a pixel: pictures are no better by the paper's 16, and 0.1 dB better by 1,024.
_PROBED = 8
# How noise falls is tried out on so many pixels of each component, with few and with more samples, against many.
_TRIED, _FEW, _MORE, _EXACT = 384, 32, 256, 512
# By what powers of the number of samples error² can fall: random numbers' 1, and somewhat beyond that of even ones.
_FALLS = 0.9, 1.6
# Seeds of both trials; users' are others.
_TRIALS = -1, -2

Report = Callable[[str, int, int], None]
# Components' BRDFs of each material.
Parts = Sequence[Sequence[Sampled]]


class AdaptiveShader:
    """A camera's view, ready to be lit by environments."""

    def __init__(
        self, seen: Seen, camera: Camera, parts: Parts | None = None, report: Report | None = None, factor: int = 1
    ):
        """Finds what draws directions for every BRDF, where it is not given; seconds for one that is no sum of lobes.

        Args:
            seen: what the camera sees.
            camera: that one.
            parts: of another frame of the same materials.
            report: hears of progress.
            factor: samples of the surface along each side of a picture's pixel; the view has as many times its rows
                and columns. Prediction takes no longer for it.
        """
        self.seen, self.factor = seen, factor
        if parts is None:
            brdfs = {id(one.brdf): one.brdf for material in seen.materials for one in material.components}
            made: dict[int, Sampled] = {}
            for done, (key, brdf) in enumerate(brdfs.items()):
                if report:
                    report("materials", done, len(brdfs))
                made[key] = sampled(brdf)
            parts = tuple(tuple(made[id(one.brdf)] for one in material.components) for material in seen.materials)
        self.parts = parts
        self._pixel_angle = jnp.float32(np.sqrt(camera.solid_angles().max()))
        # Pictures of about the same size are worked on in one shape.
        self._shape = tuple(map(image_bucket, seen.covered.shape))
        self._size = math.prod(self._shape)
        self._places = tuple(self._placed(m) for m in seen.materials)
        material = np.full(self._size + 1, -1, np.int32)
        for number, (m, place) in enumerate(zip(seen.materials, self._places, strict=True)):
            material[np.asarray(place)[np.asarray(m.pixels.omega_o)[:, 2] > 0]] = number
        self._material = material[:-1].reshape(self._shape)
        eye = np.asarray(camera.origin)
        self.probes = [self._probe(number, m, eye) for number, m in enumerate(seen.materials)]

    def _placed(self, m: SeenMaterial) -> Int[Array, " p"]:
        """A material's pixels, by number in an image that is filled up; padding has the number past its end."""
        pixel, (rows, columns) = np.asarray(m.pixels.pixel), self.seen.covered.shape
        row, column = np.divmod(pixel, columns)
        return jax.device_put(np.where(row < rows, row * self._shape[1] + column, self._size).astype(np.int32))

    def _probe(self, number: int, m: SeenMaterial, eye) -> "_Probe":
        """Every fourth of the picture's pixels, and those that see another material than all of them around."""
        every = np.zeros_like(self._material, bool)
        every[:: 2 * self.factor, :: 2 * self.factor] = True
        mine = self._material == number
        near = np.asarray(ndimage.maximum_filter(mine & every, 2 * self.factor + 1, mode="constant"), bool)
        place = np.asarray(self._places[number])
        real = np.flatnonzero(place < self._size)
        asked = real[(mine & (every | ~near)).ravel()[place[real]]]
        point = np.searchsorted(np.flatnonzero(self.seen.covered), np.asarray(m.pixels.pixel)[asked])
        bend = curvature(self.seen.gbuffer, self.seen.shadows.radius, point)
        distance = np.linalg.norm(np.asarray(m.positions(self.seen.shadows))[asked] - eye, axis=1)
        rows = jax.tree.map(lambda x: jax.device_put(padded(np.asarray(x), asked)), m.pixels)
        pixels = eqx.tree_at(lambda of: of.pixel, rows, jax.device_put(padded(place, asked, self._size)))
        bend, distance = (jax.device_put(filled_up(x, len(pixels.pixel))) for x in (bend, distance))
        return _Probe(pixels, bend, distance, m.start + asked)

    def predicted(
        self, light: LightPyramid, samples: int = _PROBED, shadows: bool = False
    ) -> tuple[tuple[Prediction, ...], ...]:
        """Of each material's components, at a quarter of the pixels.

        Args:
            light: the environment.
            samples: n_b.
            shadows: whether surfaces hide it, which rays tell.
        """
        spacing = jnp.float32(2 * self.factor)

        def of(part, probe) -> Prediction:
            drawn = draw(part, probe.pixels, samples)
            given = part, light, probe.pixels, probe.curvature, probe.distance, self._pixel_angle, spacing, drawn
            if not shadows:
                return predict(*given)
            towards = np.asarray(directions(part, probe.pixels, drawn))
            far = np.full(towards.shape[:2], np.inf, np.float32)
            many = np.repeat(probe.point, samples)
            far[: len(probe.point)] = self.seen.shadows.distances(
                many, towards[: len(probe.point)].reshape(-1, 3)
            ).reshape(-1, samples)
            return predict(*given, jnp.asarray(far))

        return tuple(
            tuple(of(part, probe) for part in parts) for probe, parts in zip(self.probes, self.parts, strict=True)
        )

    def plan(
        self,
        light: LightPyramid,
        *,
        samples: float | None = None,
        tolerance: float | None = None,
        white: float = 1.0,
        shadows: bool = False,
        predicted: tuple[tuple[Prediction, ...], ...] | None = None,
    ) -> Plan:
        """Where to shade, by a budget or by the error that is allowed.

        Args:
            light: the environment.
            samples: a mean over all of the picture's pixels that show a surface.
            tolerance: root-mean-square error of displayed values, which range from 0 to 1.
            white: the radiance that is displayed as 1.
            shadows: whether surfaces hide the environment.
            predicted: what `predicted` says, where it is known.

        Raises:
            InputError: unless one of both is given, above 0.
        """
        if (samples is None) == (tolerance is None):
            raise InputError("adaptive shading takes either samples, a budget, or tolerance, a quality")
        if not 0 < (samples or tolerance or 0) < np.inf:
            raise InputError("samples and tolerance of adaptive shading must be above 0")
        predicted = predicted or self.predicted(light, shadows=shadows)
        asked = [self._asked(k, predicted, white) for k in range(max(map(len, self.parts), default=0))]
        pixels, (asked, power) = max(int(self.seen.covered.sum()), 1), self._calibrated(light, asked, shadows)
        rows, columns = self.seen.covered.shape
        return planned(asked, power, (rows, columns), pixels, self.factor, samples, tolerance, shadows)

    def shade(
        self,
        plan: Plan,
        light: LightPyramid,
        seed: int = 0,
        parts: Parts | None = None,
        *,
        filtered: bool = True,
        report: Report | None = None,
    ) -> Float[Array, "h w 3"]:
        """Radiance; differentiable in the light and in `parts`, whose samples stand still.

        Args:
            plan: where to shade.
            light: the environment that was planned for, or another.
            seed: of samples.
            parts: BRDFs in the place of the shader's own.
            filtered: see `estimate`.
            report: hears of progress, in samples.
        """
        heard = _Sum(report, plan.samples) if report else None
        found: list[Array | None] = [None] * len(self.seen.materials)
        for k, layer in enumerate(plan.layers):
            numbers, rows = [i for i, of in enumerate(self.parts) if k < len(of)], []
            for number in numbers:
                m, part = self.seen.materials[number], (parts or self.parts)[number][k]
                counts = self._of(number, layer.counts)
                blocked = self._blocked(m, plan.shadows)
                radiance = estimate(part, light, m.pixels, counts, seed, filtered, blocked, heard)
                rows.append((self._places[number], radiance))
            image = layer.between.filled(_scattered(rows, self._shape))
            for number in numbers:
                m = self.seen.materials[number]
                rows = _seen_of(image, self._places[number])
                found[number] = _weighed(m.components[k].weight, m.pixels, rows, found[number])
        return self._shown(found, light, plan.shadows)

    def uniform(
        self, light: LightPyramid, samples: int, seed: int = 0, *, filtered: bool = False, shadows: bool = False
    ) -> Float[Array, "h w 3"]:
        """Radiance by the same number of samples in every pixel, for each component."""
        found = []
        for m, parts in zip(self.seen.materials, self.parts, strict=True):
            counts = np.where(np.asarray(m.pixels.pixel) < self.seen.covered.size, samples, 0)
            radiance = None
            for part, component in zip(parts, m.components, strict=True):
                given = estimate(part, light, m.pixels, counts, seed, filtered, self._blocked(m, shadows))
                radiance = _weighed(component.weight, m.pixels, given, radiance)
            found.append(radiance)
        return self._shown(found, light, shadows)

    def _shown(self, found, light: LightPyramid, shadows: bool) -> Float[Array, "h w 3"]:
        """The picture of what materials' pixels reflect, with sunlight.

        That comes from a few directions, in every pixel: no sample would find them.
        """
        sun = light.turned_sun()
        image = self.seen.image([of for of in found if of is not None])
        return image + self.seen.lit_by([sun], shadows) if len(sun.directions) else image

    def _calibrated(self, light: LightPyramid, asked: Sequence[Asked], shadows: bool) -> tuple[list[Asked], float]:
        """What is asked, with deviations as they are found, and the power by which error² falls.

        Tried out on few pixels: skies, materials and shadows differ in how soon samples meet all there is.
        """
        # Of each layer's materials, error² found and expected, of few samples and of more.
        tried: dict[tuple[int, int], np.ndarray] = {}
        for one in asked:
            for number, (m, parts) in enumerate(zip(self.seen.materials, self.parts, strict=True)):
                if one.number >= len(parts):
                    continue
                deviation, visible = (
                    self._of(number, np.asarray(of)).astype(float) for of in (one.deviation, one.visible)
                )
                real = np.flatnonzero(deviation > 0)
                places = real[np.unique(np.linspace(0, len(real) - 1, 2 * _TRIED).astype(int))] if len(real) else real
                counts = np.zeros(len(deviation), int)
                counts[places[::2]], counts[places[1::2]] = _FEW, _MORE
                many, blocked = np.where(counts > 0, _EXACT, 0), self._blocked(m, shadows)
                part = parts[one.number]
                few, exact = (
                    np.asarray(estimate(part, light, m.pixels, each, seed, blocked=blocked))
                    for each, seed in zip((counts, many), _TRIALS, strict=True)
                )
                apart = np.mean((few - exact) ** 2, axis=1) * visible**2
                sums = [[float(of[counts == n].sum()) for n in (_FEW, _MORE)] for of in (apart, deviation**2)]
                tried[one.number, number] = np.asarray(sums)
        found = np.sum(list(tried.values()), axis=0) if tried else np.zeros((2, 2))
        if found.min() <= 0:
            return list(asked), 1.0
        few, more = found[0] / found[1]
        power = float(np.clip(np.log(few / more) / np.log(_MORE / _FEW), *_FALLS))
        calibrated = []
        for one in asked:
            scale = np.zeros(self._material.shape)
            for (layer, number), sums in tried.items():
                if layer == one.number:
                    # Where trials found nothing, as in all materials together.
                    few, more = np.divide(*(sums if sums.min() > 0 else found))
                    scale[self._material == number] = (few * more) ** 0.25 * (_FEW * _MORE) ** (power / 4)
            deviation = np.asarray(one.deviation)
            calibrated.append(one._replace(deviation=jax.device_put(deviation * scale.astype(deviation.dtype))))
        return calibrated, power

    def _blocked(self, m: SeenMaterial, shadows: bool) -> Blocked | None:
        """Whether rays from a material's pixels meet anything."""
        if not shadows:
            return None
        return lambda place, towards: self.seen.shadows.hidden(m.start + place, towards)

    def _of(self, number: int, image: np.ndarray) -> np.ndarray:
        """What a material's pixels have of an image; 0 for padding."""
        place = np.asarray(self._places[number])
        return np.where(place < self._size, image.ravel()[np.minimum(place, self._size - 1)], 0)

    def _asked(self, k: int, predicted, white: float) -> Asked:
        """What the light of component k is predicted to depend on, the largest around each pixel."""
        rows, kind = [], np.full(self._shape, -1, np.int32)
        for number, (m, probe, parts) in enumerate(zip(self.seen.materials, self.probes, predicted, strict=True)):
            if k < len(parts):
                weights = [one.weight for one in m.components]
                rows.append((probe.pixels.pixel, _depends_on(weights, probe.pixels, parts, k, white)))
                kind[self._material == number] = number
        image = largest_around(_scattered(rows, self._shape), 2 * self.factor + 1)
        angular, spatial, contrast, visible, deviation, bandwidth = image
        features = Features(jax.device_put(kind), self._mirrored, angular, self._position, spatial, contrast)
        inside = self.factor.bit_length() - 1
        return Asked(k, hierarchy(features, inside), visible, deviation, bandwidth)

    @functools.cached_property
    def _mirrored(self) -> Float[Array, "h w 3"]:
        """Where each pixel mirrors the eye."""
        return self._image([_mirrored(m.pixels) for m in self.seen.materials])

    @functools.cached_property
    def _position(self) -> Float[Array, "h w 3"]:
        return self._image([m.positions(self.seen.shadows) for m in self.seen.materials])

    def _image(self, rows) -> Float[Array, "h w c"]:
        return _scattered(list(zip(self._places, rows, strict=True)), self._shape)


class _Sum:
    """Progress of several parts as one."""

    def __init__(self, report: Report, total: int):
        self._report, self._total, self._done = report, total, 0

    def __call__(self, samples: int):
        self._done += samples
        self._report("samples", min(self._done, self._total), self._total)


class _Probe(NamedTuple):
    """Pixels at which is predicted, what that takes, and the points from which they see light, without padding."""

    pixels: SurfacePixels
    curvature: Float[Array, " p"]
    distance: Float[Array, " p"]
    point: Int[np.ndarray, " r"]


def display_slope(value: Float[Array, "*p"]) -> Float[Array, "*p"]:
    """How fast the displayed value, in sRGB and clipped at 1, grows with the linear one.

    Above 1 nothing is seen of it; as the value is predicted roughly, its square is what takes over.
    """
    inside = jnp.clip(value, 0.0031308, 1)
    slope = jnp.where(value <= 0.0031308, 12.92, 1.055 / 2.4 * inside ** (1 / 2.4 - 1))
    return slope / jnp.maximum(value, 1) ** 2


@functools.partial(jax.jit, static_argnames="shape")
def _scattered(rows, shape: tuple[int, int]):
    """The image of what pixels have, whose numbers come with it; 0 elsewhere."""
    found = jnp.zeros((math.prod(shape), rows[0][1].shape[1]), rows[0][1].dtype)
    for place, row in rows:
        found = found.at[place].set(row, mode="drop")
    return found.reshape(*shape, -1)


@jax.jit
def _seen_of(image, place):
    """What pixels have of an image; 0 for padding."""
    return image.reshape(-1, image.shape[-1]).at[place].get(mode="fill", fill_value=0)


@functools.partial(jax.jit, static_argnames="k")
def _depends_on(weights, pixels: SurfacePixels, predicted: tuple[Prediction, ...], k: int, white):
    """Of each pixel what `Features` and `Asked` tell of component k, by what is predicted of all of them."""
    shares = [jnp.mean(_looked_up(weight, pixels), axis=1) for weight in weights]
    total = sum(share * one.radiance for share, one in zip(shares, predicted, strict=True))
    visible = shares[k] * display_slope(total / white) / white
    one = predicted[k]
    # Filtered look-ups take off the more the larger it is: of what is left, the root goes by it.
    deviation = visible * (white**2 * one.variance) ** 0.25
    return jnp.stack([one.angular, one.spatial, visible * one.contrast, visible, deviation, one.image], axis=1)


@jax.jit
def _mirrored(pixels):
    # Written out: products of small matrices are slow.
    x, y, z = (pixels.omega_o[:, k, None] * pixels.frame[:, k] for k in range(3))
    return z - x - y


@jax.jit
def _weighed(weight, pixels: SurfacePixels, radiance, others):
    """Radiance of pixels by a component's weight, added to that of other components, or None."""
    found = radiance * _looked_up(weight, pixels)
    return found if others is None else others + found


def _looked_up(weight, pixels: SurfacePixels):
    return jax.vmap(look_up, in_axes=(None, 0, 0))(weight, pixels.uv, pixels.footprint)


@functools.partial(jax.jit, static_argnames="window")
def largest_around(image, window: int):
    """The largest around each pixel, by channel, which then come first."""
    whole, reach, steps = window // 2, 0, []
    while reach < whole:
        # Of three pixels so far apart, each the largest around.
        steps.append(min(2 * reach + 1, whole - reach))
        reach += steps[-1]
    for axis in (0, 1):
        image = jnp.pad(image, [(whole * (k == axis),) * 2 for k in range(3)], constant_values=-jnp.inf)
        for step in steps:
            three, apart = ([value if k == axis else 1 for k in range(3)] for value in (3, step))
            image = jax.lax.reduce_window(
                image, -jnp.inf, jax.lax.max, three, (1, 1, 1), "VALID", window_dilation=apart
            )
    return tuple(jnp.moveaxis(image, -1, 0))
