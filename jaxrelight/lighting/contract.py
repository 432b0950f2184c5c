"""What all lighting methods have in common: view, light, trace, shade, and the picture that comes of it."""

import abc
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, Literal, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import Material, as_material
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.lighting.antialiasing import averaged
from jaxrelight.lighting.picture_error import Pictured, PictureError, joined, measured_error
from jaxrelight.lighting.reference import ERROR_SAMPLES, Reference, Sample, kept_reference
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.methods import Method, check_whole
from jaxrelight.numerics.arrays import is_traced
from jaxrelight.progress import Report

# What every method holds where materials change, in words.
VISIBILITY = "what surfaces hide"


class Image(eqx.Module):
    """A picture of what a camera sees, without what lies behind it.

    Attributes:
        radiance: linear Rec.709 radiance of surfaces, times alpha.
        alpha: the share of each pixel that shows a surface, 0 … 1.
        layers: pictures that add up to the radiance, by name; empty where a method has none.
        measured: what was measured or predicted about the picture, by name: numbers, or maps of the picture's size.
    """

    radiance: Float[Array, "h w 3"]
    alpha: Float[Array, "h w"]
    layers: dict[str, Float[Array, "h w 3"]] = eqx.field(default_factory=dict)
    measured: dict[str, Any] = eqx.field(default_factory=dict)

    @property
    def error(self) -> PictureError | None:
        """How far the picture is from its method's exact reference, on a sample of its pixels; see `Relighter.error`.

        Raises:
            InputError: for a picture that went through a compiled function, or that is traced.
        """
        return self.measure(ERROR_SAMPLES)

    def measure(self, samples: int) -> PictureError | None:
        """`error` on so many pixels. Measured when it is asked for, which casts a view's rays once.

        Args:
            samples: pixels that are compared; 0 for none.

        Raises:
            InputError: for a picture that went through a compiled function, or that is traced.
        """
        measure = self.__dict__.get("_measure")
        if measure is None:
            raise InputError("a picture of a compiled function does not measure itself; ask relighter.error for it")
        return measure(samples)

    def measured_by(self, measure: Callable[[int], PictureError | None]) -> "Image":
        """The picture, with what measures its error: kept beside the pytree, of which no program depends on it."""
        object.__setattr__(self, "_measure", functools.cache(measure))
        return self

    @property
    def negative_share(self) -> float:
        """The share of what shows a surface whose radiance is negative in a channel, by more than rounding.

        Factors and coefficients that are left out may leave some; a hundredth of the mean radiance is not counted.
        """
        shown = np.asarray(self.alpha) > 0
        radiance = np.asarray(self.radiance)[shown]
        return float(np.mean(radiance.min(axis=1) < -0.01 * np.abs(radiance).mean())) if shown.any() else 0.0

    def rgba(self, background: Float[Array, "h w 3"] | None = None) -> Float[np.ndarray, "h w 4"]:
        """The picture as an array of the host, with what lies behind it where that is given.

        Args:
            background: radiance of what lies behind, times 1 − alpha; see `Relighter.background`.
        """
        radiance = np.asarray(self.radiance)
        if background is not None:
            radiance = radiance + np.asarray(background)
        return np.concatenate([radiance, np.asarray(self.alpha)[..., None]], axis=-1)


ViewT = TypeVar("ViewT")
LitT = TypeVar("LitT")
TracedT = TypeVar("TracedT")


class Relighter(eqx.Module, Generic[ViewT, LitT, TracedT]):
    """A scene that is prepared for one lighting method; made by `prepare` or `open_store`. A pytree.

        view = relighter.view(camera)             # once a view, on the host: camera rays
        lit = relighter.light(lights)             # once a light
        traced = relighter.trace(lit, view)       # once for both, on the host: shadow rays, plans of samples
        image = relighter.shade(lit, view, traced)

    `light` and `shade` are differentiable, with visibility and plans of samples held fixed. Views, lights and what is
    traced are pytrees, too: all of them can be arguments of a jitted function.
    """

    # The dials; the materials of what is seen; the scene's camera; and its sensors, where they take the camera's place,
    # else None.
    method: eqx.AbstractVar[Method]
    materials: eqx.AbstractVar[tuple[SurfaceMaterial, ...]]
    camera: eqx.AbstractVar[Camera]
    sensors: eqx.AbstractVar[Sensors | None]

    @abc.abstractmethod
    def scene_lights(self) -> Lights:
        """The scene's own lights."""

    @abc.abstractmethod
    def view(self, camera: Camera | None = None, antialiasing: int = 1) -> ViewT:
        """What a camera sees; by default the scene's. Traces its rays on the host.

        Where a scene was prepared at its sensors, it is a row of their points.

        Args:
            camera: any; by default the scene's.
            antialiasing: samples of surfaces in a pixel, of which a picture shows the mean: 1, 4 or 16. Where receivers
                are pixels, samples take the precomputed radiance of the pixel that they are most like, and have local
                lights and coverage of their own.

        Raises:
            InputError: for another camera than the scene's where the method has bound that one, or another number of
                samples.
        """

    @abc.abstractmethod
    def light(self, lights: LightsLike) -> LitT:
        """What a change of light costs. Linear in radiance and differentiable.

        Args:
            lights: `Lights`, an environment, local lights, or a sequence of both.

        Raises:
            InputError: for lights that the method does not have.
        """

    @abc.abstractmethod
    def trace(self, lit: LitT, view: ViewT, *, report: Report | None = None) -> TracedT:
        """What depends on light and view together and takes rays or plans: done on the host, and held fixed.

        Args:
            lit: from `light`.
            view: from `view`.
            report: called with the progress of long work.
        """

    @abc.abstractmethod
    def shade(self, lit: LitT, view: ViewT, traced: TracedT | None = None, *, report: Report | None = None) -> Image:
        """The picture. Pure, and differentiable in light and materials.

        Args:
            lit: from `light`.
            view: from `view`.
            traced: from `trace` of both; where it is left out, it is traced here.
            report: called with the progress of long work.
        """

    @abc.abstractmethod
    def with_materials(
        self, materials: Mapping[str, Brdf | Material], *, bounces: Literal["held", "followed"] | None = None
    ) -> Self:
        """The same prepared scene with other materials: no ray is cast, and nothing is precomputed.

        Differentiable in all parameters and textures, which may be traced. What stays as it was prepared is told by
        `held`; normal maps are of the geometry, and those of the given materials are not read. Where the prepared
        scene is traced itself, it is one that came out of this function, with materials of the same kinds, before.

            brighter = relighter.with_materials({"paint": jr.phong(0.4, 0.3, 50)})
            image = brighter.shade(brighter.relit(lit), view, traced)

        Args:
            materials: by the names of the scene's; the others stay.
            bounces: whether the light that surfaces reflect onto each other is "held" as it was with the materials that
                were prepared, or "followed"; by default it is followed where the method can: see `held`.

        Raises:
            InputError: for a name that no surface has, for materials that the prepared scene cannot have, or bounces
                that cannot be followed.
        """

    @property
    @abc.abstractmethod
    def held(self) -> tuple[str, ...]:
        """What stays as it was prepared where materials change, in words."""

    def relit(self, lit: LitT) -> LitT:
        """The light of a relighter of the same scene with other materials, as `light` of this one gives it.

        What does not depend on materials is taken over, so that this costs less than `light`; differentiable in them.

        Args:
            lit: from `light` of the relighter that `with_materials` was called on, or of one that came out of it.
        """
        return lit

    def _materials_of(self, materials: Mapping[str, Brdf | Material], names: Sequence[str]) -> dict[str, Material]:
        """Materials by their names, of which each is one of those that are prepared.

        Raises:
            InputError: for a name that is none of them.
        """
        for name in materials:
            if name not in names:
                raise InputError(f"no surface has a material '{name}'; there are {', '.join(sorted(names))}")
        return {name: as_material(of) for name, of in materials.items()}

    @abc.abstractmethod
    def background(self, lit: LitT, view: ViewT) -> Float[Array, "h w 3"]:
        """Radiance of the environment behind the surfaces, times 1 − alpha; zeros where there is none."""

    def _measuring(self, image: Image, lit: LitT, view: ViewT) -> Image:
        """The picture, which measures its error when it is asked for it."""
        if is_traced(image.radiance):
            return image
        # Without the layers, and without a cycle.
        bare = Image(image.radiance, image.alpha)
        return image.measured_by(lambda samples: self.error(bare, lit, view, samples=samples))

    def samples_of(self, view: ViewT) -> ViewT:
        """The view whose pixels are those that are shaded; another one where they are samples of a picture's pixels."""
        return view

    @abc.abstractmethod
    def reference(self, view: ViewT, samples: int, seed: int) -> Reference:
        """What pictures of a view are measured against. Casts rays on the host.

        Args:
            view: from `view`.
            samples: pixels of the view, or all where there are no more.
            seed: of their choice.
        """

    @abc.abstractmethod
    def pictured(self, radiance: Float[np.ndarray, "s 3"], lit: LitT, sample: Sample) -> Pictured:
        """What a picture has of the radiance that a reference tells, by the same means, and what it has beside.

        Args:
            radiance: of the picture, at the sample's pixels.
            lit: from `light`.
            sample: of the reference.
        """

    def not_measured(self, lit: LitT) -> tuple[str, ...]:
        """What a reference does not tell, in words."""
        return ()

    def notes_on(self, lights: LightsLike) -> tuple[str, ...]:
        """What lights ask for that was not prepared for them, a line each. Measured when it is asked for."""
        return ()

    def error(
        self, image: Image, lit: LitT, view: ViewT, *, samples: int = ERROR_SAMPLES, seed: int = 0
    ) -> PictureError | None:
        """How far a picture is from the method's exact reference, on a sample of its own pixels.

        A view's rays are cast once and kept; afterwards each light costs a product. Where pixels are means of samples
        that are shaded one by one, it is that of the samples, which are shaded again.

        Args:
            image: the picture.
            lit: its light.
            view: its view.
            samples: pixels that are compared; 0 for none.
            seed: of their choice.

        Returns:
            The error; None for no samples, or where no surface is seen.

        Raises:
            InputError: for what is traced, or samples that are no whole number from 0.
        """
        _check_measurable((image, lit, view), samples)
        if not samples or not np.asarray(image.alpha).any():
            return None
        shaded = self.samples_of(view)
        if shaded is not view:
            view, image = shaded, self.shade(lit, shaded)
        reference = self._kept_reference(view, samples, seed)
        radiance = np.asarray(image.radiance).reshape(-1, 3)
        chosen, weights = reference.samples(radiance)
        return self._measured(lit, reference, chosen, weights, [radiance[sample.pixels] for sample in chosen])

    def expected_error(
        self, lit: LitT, view: ViewT, *, samples: int = ERROR_SAMPLES, seed: int = 0
    ) -> PictureError | None:
        """How far off a picture will be. Only a few hundred of its pixels are shaded, drawn evenly.

        The trimmed error is close to what the picture reports; the untrimmed one misses what a few bright pixels bring,
        which are drawn from the picture. A view's rays are cast once and serve its pictures, too.

        Args:
            lit: the light.
            view: the view.
            samples: as for `error`.
            seed: as for `error`.

        Returns:
            The error; None for no samples, or where no surface is seen.

        Raises:
            InputError: as `error`; and for adaptive lighting, whose plan tells it.
        """
        _check_measurable((lit, view), samples)
        if not samples:
            return None
        reference = self._kept_reference(self.samples_of(view), samples, seed)
        even, of_all = reference.even, np.full(len(reference.even.pixels), reference.evenly)
        if not len(of_all):
            return None
        return self._measured(lit, reference, [even], [of_all], [self.sampled(lit, even)])

    def sampled(self, lit: LitT, sample: Sample) -> Float[np.ndarray, "s 3"]:
        """What a picture will have at the pixels of a sample."""
        return np.asarray(self.shade(lit, sample.view).radiance)[0]

    def _kept_reference(self, view: ViewT, samples: int, seed: int) -> Reference:
        leaves = jax.tree.leaves(self)
        key = samples, seed, tuple(map(id, leaves))
        return kept_reference(view, key, leaves, lambda: self.reference(view, samples, seed))

    def _measured(
        self,
        lit: LitT,
        reference: Reference,
        chosen: Sequence[Sample],
        weights: Sequence[Float[np.ndarray, " _"]],
        radiance: Sequence[Float[np.ndarray, "_ 3"]],
    ) -> PictureError:
        """The error that some samples tell, the first of them the even one."""
        lengths = [len(sample.pixels) for sample in chosen]
        exact_of = [sample.radiance(lit) for sample in chosen]
        every = [self.pictured(own, lit, sample) for own, sample in zip(radiance, chosen, strict=True)]
        pictured = Pictured(
            joined([one.by_means for one in every], lengths), np.concatenate([one.alike for one in every])
        )
        even = exact_of[0]
        return measured_error(
            np.concatenate(radiance),
            np.concatenate(weights),
            pictured,
            joined(exact_of, lengths),
            reference.further(lit, even),
            reference.divided(lit, even),
            reference.name,
            self.not_measured(lit),
        )

    def picture(
        self,
        lights: LightsLike = None,
        camera: Camera | None = None,
        *,
        antialiasing: int = 1,
        background: bool = True,
    ) -> Float[np.ndarray, "h w 4"]:
        """A finished picture, RGBA: light, view, trace and shade in one call.

        Args:
            lights: by default the scene's own.
            camera: by default the scene's own.
            antialiasing: see `view`.
            background: show the environment where no surface is.
        """
        lit = self.light(self.scene_lights() if lights is None else as_lights(lights))
        view = self.view(camera, antialiasing)
        image = self.shade(lit, view)
        return image.rgba(self.background(lit, view) if background else None)


def _check_measurable(parts: Any, samples: int) -> None:
    if is_traced(parts):
        raise InputError("the error of a picture is measured on numbers that are known; ask for it outside of jit")
    check_whole("samples", samples, 0, math.inf)


@functools.partial(jax.jit, static_argnames="factor")
def image_of(parts: Sequence[Float[Array, "fh fw 3"] | None], covered: Bool[Array, "fh fw"], factor: int = 1) -> Image:
    """The picture of what adds up to its radiance, black without anything: one program, whatever there is.

    Args:
        parts: radiance of surfaces; None for nothing.
        covered: which samples show a surface.
        factor: samples along each side of a pixel.
    """
    radiance = sum((part for part in parts if part is not None), jnp.zeros((*covered.shape, 3), jnp.float32))
    alpha = covered.astype(radiance.dtype)[..., None]
    if factor > 1:
        radiance, alpha = averaged(radiance, factor), averaged(alpha, factor)
    return Image(radiance, alpha[..., 0])


@functools.partial(jax.jit, static_argnames="factor")
def behind(background: Float[Array, "fh fw 3"], covered: Array, factor: int = 1) -> Float[Array, "h w 3"]:
    """A background where samples show no surface: the mean over each pixel's, so many along each side."""
    shown = jnp.where(covered[..., None], 0, background)
    return averaged(shown, factor) if factor > 1 else shown


def kept_beside(view: Any, name: str, make: Callable[[], Any]) -> Any:
    """What a view keeps beside the pytree, made where it is not there yet."""
    kept = view.__dict__.get(name)
    if kept is None:
        kept = make()
        object.__setattr__(view, name, kept)
    return kept
