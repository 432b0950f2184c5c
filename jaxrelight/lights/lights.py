"""What lights a scene: an environment and local lights together."""

from collections.abc import Sequence

import equinox as eqx

from jaxrelight.errors import InputError
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.local import Light


class Lights(eqx.Module):
    """All light that arrives at a scene. Every lighting method takes it; see `as_lights` for what stands for one.

    Attributes:
        environment: distant light of the whole sphere; None for none.
        local: lights with a place or a direction of their own.
    """

    environment: Environment | None = None
    local: tuple[Light, ...] = ()

    def __add__(self, other: "LightsLike") -> "Lights":
        """Both together.

        Raises:
            InputError: where both have an environment.
        """
        return as_lights([self, as_lights(other)])

    def __bool__(self) -> bool:
        """Whether there is any light."""
        return self.environment is not None or bool(self.local)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was mended in the environment, one line each."""
        return self.environment.notes if self.environment is not None else ()


_AnyLight = Lights | Environment | Light
LightsLike = _AnyLight | Sequence[_AnyLight | Sequence[_AnyLight]] | None


def as_lights(given: LightsLike) -> Lights:
    """An environment, a local light, a sequence of both, or nothing, as `Lights`.

    Raises:
        InputError: for anything else, or for a second environment.
    """
    match given:
        case Lights():
            return given
        case None:
            return Lights()
        case Environment():
            return Lights(given)
        case Light():
            return Lights(None, (given,))
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise InputError(
            f"lights are an Environment, local lights such as point(…), or a list of both, not {type(given).__name__}"
        )
    parts = [as_lights(one) for one in given]
    environments = [part.environment for part in parts if part.environment is not None]
    if len(environments) > 1:
        raise InputError(f"{len(environments)} environments were given; a scene has one at most")
    return Lights(environments[0] if environments else None, tuple(light for part in parts for light in part.local))
