"""What stands for the lights of a scene, and what does not."""

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Lights
from jaxrelight.lights.lights import as_lights

SKY = jr.environment(np.ones((2, 4, 3)))
LAMP, SUN = jr.point([0, 1, 0], 2.0), jr.directional([0, -1, 0], 1.0)
ACCEPTED = {
    "nothing": (None, None, ()),
    "an empty list": ([], None, ()),
    "an environment": (SKY, SKY, ()),
    "a light": (LAMP, None, (LAMP,)),
    "lights": (Lights(SKY, (LAMP,)), SKY, (LAMP,)),
    "a list": ([LAMP, SKY, SUN], SKY, (LAMP, SUN)),
    "a tuple of lights and lists": ((Lights(None, (SUN,)), [LAMP, SKY]), SKY, (SUN, LAMP)),
    "a whole sky of directions": (jr.even_sky(1.0, 4), None, None),
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_what_is_accepted(name):
    given, environment, local = ACCEPTED[name]
    lights = as_lights(given)
    assert isinstance(lights, Lights)
    assert lights.environment is environment
    local = (given,) if local is None else local
    assert len(lights.local) == len(local)
    assert all(one is other for one, other in zip(lights.local, local, strict=True))
    assert bool(lights) == (environment is not None or bool(local))


def test_lights_add_up_and_are_pytrees():
    both = Lights(None, (LAMP,)) + SKY + [SUN]
    assert (both.environment, both.local) == (SKY, (LAMP, SUN))
    assert len(jax.tree.leaves(both)) == len(jax.tree.leaves((SKY, LAMP, SUN)))
    clamped = jr.environment(np.full((2, 4, 3), -1.0))
    assert as_lights([clamped, LAMP]).notes == clamped.notes != ()
    assert Lights(None, (LAMP,)).notes == ()


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize("given", [[SKY, SKY], (Lights(SKY), [LAMP, SKY])])
def test_two_environments_are_refused(given):
    with pytest.raises(InputError, match="2 environments were given; a scene has one at most") as caught:
        as_lights(given)
    assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(InputError, match="2 environments"):
        _ = Lights(SKY) + SKY


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("given", "kind"),
    [(3.0, "float"), ("sky.exr", "str"), (np.ones((2, 4, 3)), "ndarray"), ({"sky": SKY}, "dict"), ([LAMP, 1], "int")],
)
def test_another_type_is_one_line(given, kind):
    with pytest.raises(InputError, match=f"or a list of both, not {kind}$") as caught:
        as_lights(given)
    assert len(str(caught.value).splitlines()) == 1
