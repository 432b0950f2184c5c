"""What all lighting methods have in common: view, light, trace, shade, and the picture that comes of it."""

import abc
import functools
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxrelight.geometry.camera import Camera
from jaxrelight.lighting.antialiasing import averaged
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.methods import Method
from jaxrelight.progress import Report


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

    # The dials, and the scene's camera.
    method: eqx.AbstractVar[Method]
    camera: eqx.AbstractVar[Camera]

    @abc.abstractmethod
    def scene_lights(self) -> Lights:
        """The scene's own lights."""

    @abc.abstractmethod
    def view(self, camera: Camera | None = None) -> ViewT:
        """What a camera sees; by default the scene's. Traces its rays on the host.

        Raises:
            InputError: for another camera than the scene's where the method has bound that one.
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
    def background(self, lit: LitT, view: ViewT) -> Float[Array, "h w 3"]:
        """Radiance of the environment behind the surfaces, times 1 − alpha; zeros where there is none."""

    def picture(
        self, lights: LightsLike = None, camera: Camera | None = None, *, background: bool = True
    ) -> Float[np.ndarray, "h w 4"]:
        """A finished picture, RGBA: light, view, trace and shade in one call.

        Args:
            lights: by default the scene's own.
            camera: by default the scene's own.
            background: show the environment where no surface is.
        """
        lit, view = self.light(self.scene_lights() if lights is None else as_lights(lights)), self.view(camera)
        image = self.shade(lit, view)
        return image.rgba(self.background(lit, view) if background else None)


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


@jax.jit
def behind(background: Float[Array, "h w 3"], covered: Array) -> Float[Array, "h w 3"]:
    """A background where no surface is seen."""
    return jnp.where(covered[..., None], 0, background)
