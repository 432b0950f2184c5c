"""What sensors measure: irradiance and illuminance at their points."""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lights.lights import LightsLike, as_lights
from jaxrelight.numerics.arrays import is_traced

# Of linear Rec.709 radiance, which luminance is made of.
LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)
# Lumens for each watt of luminance so weighted, as Radiance and its pictures have it: for white light of equal energy.
LUMENS_PER_WATT = 179.0


@dataclasses.dataclass(frozen=True)
class SensorSummary:
    """What one sensor measures in all.

    Attributes:
        mean: of the illuminance at its points, in lux.
        min: the least of it.
        max: the largest.
        uniformity: min over mean; 0 where it is dark.
    """

    mean: float
    min: float
    max: float
    uniformity: float


class Measurement(eqx.Module):
    """Light that arrives at all points of a scene's sensors; a pytree, differentiable like pictures.

    Attributes:
        irradiance: in W/m² per channel, at each point, sensor after sensor.
        sensors: the sensors.
    """

    irradiance: Float[Array, "n 3"]
    sensors: Sensors = eqx.field(static=True)

    @property
    def illuminance(self) -> Float[Array, " n"]:
        """In lux at each point: 179 lm/W · (0.2126 R + 0.7152 G + 0.0722 B)."""
        return illuminance_of(self.irradiance)

    def of(self, name: str) -> Float[Array, " n"]:
        """The illuminance at the points of one sensor.

        Raises:
            InputError: where none is called so.
        """
        if name not in self.sensors.slices:
            raise InputError(f"there is no sensor '{name}'; there are {', '.join(self.sensors.slices)}")
        return self.illuminance[self.sensors.slices[name]]

    def summaries(self) -> Mapping[str, SensorSummary]:
        """What each sensor measures in all, by its name. On the host.

        Raises:
            InputError: for what is traced.
        """
        if is_traced(self.irradiance):
            raise InputError("summaries are of numbers that are known; ask for them outside of jit")
        lux = np.asarray(self.illuminance, float)
        return {name: _summary(lux[rows]) for name, rows in self.sensors.slices.items()}


def measure(relighter: Relighter, lights: LightsLike = None) -> Measurement:
    """What the sensors of a scene measure, by light, view, trace and shade of any method.

        relighter = prepare(scene.at_sensors(), Indirect())
        measure(relighter, lights).illuminance

    Args:
        relighter: prepared of a scene at its sensors; see `Scene.at_sensors`.
        lights: by default the scene's own.

    Raises:
        InputError: for what was prepared for a camera.
    """
    sensors = sensors_of_relighter(relighter)
    lit = relighter.light(relighter.scene_lights() if lights is None else as_lights(lights))
    image = relighter.shade(lit, relighter.view())
    return Measurement(irradiance_of(image.radiance), sensors)


def sensors_of_relighter(relighter: Relighter) -> Sensors:
    """The sensors that a relighter measures at.

    Raises:
        InputError: for what was prepared for a camera.
    """
    if relighter.sensors is None:
        raise InputError("this was prepared for a camera; prepare(scene.at_sensors(), …) is for sensors")
    return relighter.sensors


@jax.jit
def irradiance_of(radiance: Float[Array, "1 n 3"]) -> Float[Array, "n 3"]:
    """Irradiance of sensors in W/m², from the radiance of the white receivers that stand for them: π times that."""
    return jnp.pi * radiance[0]


@jax.jit
def illuminance_of(irradiance: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Illuminance in lux of irradiance by Rec.709 channels."""
    weights = LUMENS_PER_WATT * jnp.asarray(LUMINANCE_WEIGHTS, irradiance.dtype)
    return jnp.matmul(irradiance, weights, precision="highest")


def _summary(lux: Float[np.ndarray, " n"]) -> SensorSummary:
    mean, least = float(lux.mean()), float(lux.min())
    return SensorSummary(mean, least, float(lux.max()), least / mean if mean > 0 else 0.0)
