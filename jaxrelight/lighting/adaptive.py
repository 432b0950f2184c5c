"""Shading where bandwidth asks, with as many samples as noise asks (Bagher 2011): nothing is precomputed for a mesh.

A few samples of each pixel predict how its light varies. From that follow the pixels that are shaded, the samples that
each of them gets, and the weights by which all others lie between them. Components of a material are shaded apart and
multiplied by its textures in every pixel, so textures never ask for shading.
"""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import ndimage

from jaxrelight.brdf.texture import look_up
from jaxrelight.buckets import filled_up
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.curvature import curvature
from jaxrelight.lighting.estimate import Blocked, estimate
from jaxrelight.lighting.hierarchy import Features, hierarchy
from jaxrelight.lighting.pixels import padded
from jaxrelight.lighting.planning import Asked, Plan, planned
from jaxrelight.lighting.prediction import Prediction, directions, draw, predict
from jaxrelight.lighting.prefiltered import Seen, SeenMaterial, SurfacePixels
from jaxrelight.lighting.sampled import Sampled, sampled
from jaxrelight.lights.pyramid import LightPyramid

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
        self._material = np.full(seen.covered.size + 1, -1, np.int32)
        for number, m in enumerate(seen.materials):
            facing = np.asarray(m.pixels.omega_o[:, 2]) > 0
            self._material[np.minimum(m.pixels.pixel, seen.covered.size)[facing]] = number
        self._material = self._material[:-1].reshape(seen.covered.shape)
        eye = np.asarray(camera.origin)
        self.probes = [self._probe(number, m, eye) for number, m in enumerate(seen.materials)]

    def _probe(self, number: int, m: SeenMaterial, eye) -> "_Probe":
        """Every fourth of the picture's pixels, and those that see another material than all of them around."""
        every = np.zeros_like(self._material, bool)
        every[:: 2 * self.factor, :: 2 * self.factor] = True
        mine = self._material == number
        near = np.asarray(ndimage.maximum_filter(mine & every, 2 * self.factor + 1, mode="constant"), bool)
        pixel = np.asarray(m.pixels.pixel)
        real = np.flatnonzero(pixel < mine.size)
        asked = real[(mine & (every | ~near)).ravel()[pixel[real]]]
        point = np.searchsorted(np.flatnonzero(self.seen.covered), pixel[asked])
        bend = curvature(self.seen.gbuffer, self.seen.shadows.radius, point)
        distance = np.linalg.norm(np.asarray(m.positions(self.seen.shadows))[asked] - eye, axis=1)
        rows = jax.tree.map(lambda x: jnp.asarray(padded(np.asarray(x), asked)), m.pixels)
        pixels = eqx.tree_at(lambda of: of.pixel, rows, jnp.asarray(padded(pixel, asked, mine.size)))
        bend, distance = (jnp.asarray(filled_up(x, len(pixels.pixel))) for x in (bend, distance))
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
        found = [jnp.zeros((len(m.pixels.pixel), 3)) for m in self.seen.materials]
        for k, layer in enumerate(plan.layers):
            numbers = [i for i, of in enumerate(self.parts) if k < len(of)]
            image = jnp.zeros((self.seen.covered.size, 3))
            for number in numbers:
                m, part = self.seen.materials[number], (parts or self.parts)[number][k]
                counts = self._of(m, layer.counts)
                blocked = self._blocked(m, plan.shadows)
                radiance = estimate(part, light, m.pixels, counts, seed, filtered, blocked, heard)
                image = image.at[m.pixels.pixel].add(radiance, mode="drop")
            image = layer.between.filled(image.reshape(*self.seen.covered.shape, 3)).reshape(-1, 3)
            for number in numbers:
                m = self.seen.materials[number]
                weight = _weight(m.components[k].weight, m.pixels)
                found[number] += weight * image.at[m.pixels.pixel].get(mode="fill", fill_value=0)
        return self.seen.image(found) + self._sunlight(light, plan.shadows)

    def uniform(
        self, light: LightPyramid, samples: int, seed: int = 0, *, filtered: bool = False, shadows: bool = False
    ) -> Float[Array, "h w 3"]:
        """Radiance by the same number of samples in every pixel, for each component."""
        found = []
        for m, parts in zip(self.seen.materials, self.parts, strict=True):
            counts = np.where(np.asarray(m.pixels.pixel) < self.seen.covered.size, samples, 0)
            radiance = jnp.zeros((len(m.pixels.pixel), 3))
            for part, component in zip(parts, m.components, strict=True):
                given = estimate(part, light, m.pixels, counts, seed, filtered, self._blocked(m, shadows))
                radiance += given * _weight(component.weight, m.pixels)
            found.append(radiance)
        return self.seen.image(found) + self._sunlight(light, shadows)

    def _sunlight(self, light: LightPyramid, shadows: bool) -> Float[Array, "h w 3"]:
        """A few directions, in every pixel: no sample would find them."""
        return self.seen.lit_by([light.turned_sun()], shadows)

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
                deviation, visible = (self._of(m, np.asarray(of)).astype(float) for of in (one.deviation, one.visible))
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
            calibrated.append(one._replace(deviation=one.deviation * jnp.asarray(scale, one.deviation.dtype)))
        return calibrated, power

    def _blocked(self, m: SeenMaterial, shadows: bool) -> Blocked | None:
        """Whether rays from a material's pixels meet anything."""
        if not shadows:
            return None
        return lambda place, towards: self.seen.shadows.hidden(m.start + place, towards)

    def _of(self, m: SeenMaterial, image: np.ndarray) -> np.ndarray:
        """What a material's pixels have of an image; 0 for padding."""
        pixel = np.asarray(m.pixels.pixel)
        return np.where(pixel < image.size, image.ravel()[np.minimum(pixel, image.size - 1)], 0)

    def _asked(self, k: int, predicted, white: float) -> Asked:
        """What the light of component k is predicted to depend on, the largest around each pixel."""
        found = []
        for m, probe, parts in zip(self.seen.materials, self.probes, predicted, strict=True):
            if k >= len(parts):
                continue
            weights = [jnp.mean(_weight(one.weight, probe.pixels), axis=1) for one in m.components]
            total = sum(w * one.radiance for w, one in zip(weights, parts, strict=True))
            visible = weights[k] * display_slope(jnp.asarray(total) / white) / white
            one = parts[k]
            rows = (
                one.angular,
                one.spatial,
                visible * one.contrast,
                visible,
                # Filtered look-ups take off the more the larger it is: of what is left, the root goes by it.
                visible * (white**2 * one.variance) ** 0.25,
                one.image,
            )
            found.append((probe.pixels.pixel, jnp.stack(rows, axis=1)))
        image = _scattered(found, self.seen.covered.size).reshape(*self.seen.covered.shape, -1)
        angular, spatial, contrast, visible, deviation, bandwidth = jnp.moveaxis(
            largest_around(image, 2 * self.factor + 1), -1, 0
        )
        kind = np.full(self._material.shape, -1, np.int32)
        for number, parts in enumerate(self.parts):
            if k < len(parts):
                kind = np.where(self._material == number, number, kind)
        features = Features(jnp.asarray(kind), self._mirrored, angular, self._position, spatial, contrast)
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
        found = [(m.pixels.pixel, of) for m, of in zip(self.seen.materials, rows, strict=True)]
        return _scattered(found, self.seen.covered.size).reshape(*self.seen.covered.shape, -1)


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


@functools.partial(jax.jit, static_argnames="size")
def _scattered(rows, size: int):
    """The flat image of what pixels have; 0 elsewhere."""
    found = jnp.zeros((size, rows[0][1].shape[1]), rows[0][1].dtype)
    for pixel, row in rows:
        found = found.at[pixel].set(row, mode="drop")
    return found


@jax.jit
def _mirrored(pixels):
    # Written out: products of small matrices are slow.
    x, y, z = (pixels.omega_o[:, k, None] * pixels.frame[:, k] for k in range(3))
    return z - x - y


@eqx.filter_jit
def _weight(weight, pixels):
    return jax.vmap(look_up, in_axes=(None, 0, 0))(weight, pixels.uv, pixels.footprint)


@functools.partial(jax.jit, static_argnames="window")
def largest_around(image, window: int):
    """The largest around each pixel."""
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
    return image
