"""Materials as sums of grey parts times tints."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.lobes import LobeSum, lobe, lobe_sum
from jaxrelight.brdf.material import Component, Material, as_material, split_tint
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import constant, look_up

RNG = np.random.default_rng(2)
DIRECTIONS = RNG.normal(size=(2, 40, 3))
DIRECTIONS[..., 2] = np.abs(DIRECTIONS[..., 2])
DIRECTIONS = (DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=-1, keepdims=True)).astype(np.float32)


def _values(material: Material) -> np.ndarray:
    total = 0.0
    for component in material.components:
        assert not isinstance(component.brdf, SpatialLobes)
        value = jax.vmap(component.brdf.evaluate)(*DIRECTIONS)
        total = total + value * look_up(component.weight, jnp.full(2, 0.5))[None]
    return np.broadcast_to(np.asarray(total), (40, 3))


GREY = {
    "phong": jr.phong([0.3, 0.2, 0.1], [0.5, 0.2, 0.1], 20.0),
    "two lobes": lobe_sum(
        [0.1, 0.2, 0.3],
        [lobe([-1, -1, 0.9], 8.0, specular=[0.4, 0.2, 0.1]), lobe([0.5, 0.5, 1], 2.0, specular=[0.2, 0.1, 0.05])],
        turn=0.3,
    ),
    "no diffuse": jr.phong(0.0, [0.5, 0.0, 0.1], 20.0),
    "peak": lobe_sum([0.0, 0.1, 0.0], [lobe([-1, -1, 1], 3.0, peak=[1e20, 3e20, 0.0])]),
}


@pytest.mark.parametrize("name", GREY)
def test_lobes_of_a_tint_become_grey_ones_that_reflect_the_same(name):
    weight = (constant([0.5, 1.0, 2.0]),)
    material = Material((Component(GREY[name], weight),), emission=np.ones(3, np.float32))
    split = split_tint(material)
    assert [component.brdf.channels for component in split.components] == [1] * len(split.components)
    assert len(split.components) == 1 + bool(np.any(np.asarray(GREY[name].diffuse)))
    np.testing.assert_array_equal(split.emission, material.emission)
    np.testing.assert_allclose(_values(split), _values(material), rtol=1e-5)


@pytest.mark.parametrize(
    "brdf",
    [
        jr.lambert([0.3, 0.2, 0.1]),
        lobe_sum([0.1] * 3, [lobe([-1, -1, 1], 8.0, specular=[1, 0, 0]), lobe([1, 1, 1], 2.0, specular=[0, 1, 0])]),
        lobe_sum([0.1] * 3, [lobe([-1, -1, 1], [2.0, 3.0, 4.0], specular=0.2)]),
        jr.phong([0.1] * 3, 0.0, 5.0),
        LobeSum(jnp.ones(1), jnp.ones((1, 1, 3)), jnp.ones((1, 1)), jnp.ones((1, 1))),
    ],
    ids=["no lobe", "two tints", "exponents by channel", "black lobe", "grey already"],
)
def test_others_stay_what_they_are(brdf):
    material = as_material(brdf)
    assert split_tint(material) == material
