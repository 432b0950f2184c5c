"""The tests do check signatures and ranks: a call that breaks one is an error, but where a test asks for none."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

import jaxrelight as jr
from jaxrelight.basis import latlong
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.operators.dense import Dense


def test_shapes_types_and_names_of_axes_are_checked():
    operator = Dense(jnp.ones((2, 3, 4)))
    with pytest.raises(TypeCheckError, match="light"):
        operator.apply(jnp.ones(4))
    with pytest.raises(TypeCheckError, match="solid_angles"):
        latlong.solid_angles("8", 16)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeCheckError, match="normal"):
        tangent_frame(np.ones((5, 2), np.float32))
    with pytest.raises(TypeCheckError, match="Dense"):
        Dense(jnp.ones((2, 3)))


@pytest.mark.usefixtures("wrong_types")
def test_functions_refuse_for_themselves_where_signatures_are_not_checked():
    with pytest.raises(ValueError, match="light"):
        Dense(jnp.ones((2, 3, 4))).apply(jnp.ones(4))
    with pytest.raises(jr.InputError, match="sphere"):
        jr.sphere(None)  # pyright: ignore[reportArgumentType]


def test_ranks_do_not_broadcast_silently():
    with pytest.raises(ValueError, match="rank_promotion"):
        _ = jnp.ones((2, 3)) + jnp.ones(3)
