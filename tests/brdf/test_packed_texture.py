"""Packed textures: the same numbers as textures, by one program for images of many sizes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.packed_texture import PackedTexture, pack, pack_weight
from jaxrelight.brdf.texture import Texture, VertexColours, constant, look_up
from jaxrelight.numerics.arrays import as_array
from tests.compilations import compilations

RANDOM = np.random.default_rng(3)
UV = RANDOM.uniform(-2, 3, (60, 5)).astype(np.float32)
FOOTPRINTS = np.resize(np.array([0, 0.001, 0.01, 0.1, 0.7, 3, np.inf], np.float32), 60)
PLACEMENT = as_array(np.array([[1.5, 0.2, 0.1], [-0.3, 0.8, 0.4]], np.float32))


def _image(h: int, w: int) -> np.ndarray:
    return RANDOM.random((h, w, 3)).astype(np.float32)


@jax.jit
def _look_up(weight, uv, covered):
    return jax.vmap(look_up, in_axes=(None, 0, 0))(weight, uv, covered)


@pytest.mark.parametrize("size", [(5, 7), (1, 9), (2, 1), (64, 33)])
@pytest.mark.parametrize("levels", [True, False])
@pytest.mark.parametrize(
    "layout",
    [{}, {"wrap": ("clamp", "mirror")}, {"placement": PLACEMENT}, {"uv_set": 1, "placement": PLACEMENT}],
)
def test_the_same_numbers_as_the_texture(size, levels, layout):
    texture = Texture(as_array(_image(*size)), **layout)
    texture = texture.minified() if levels else texture
    wanted = _look_up((texture, constant(0.5)), UV, FOOTPRINTS)
    np.testing.assert_allclose(_look_up((pack(texture), constant(0.5)), UV, FOOTPRINTS), wanted, atol=2e-6)


def test_one_program_serves_images_of_many_sizes():
    packed = [(pack(Texture(as_array(_image(40 + i, 50 - i))).minified()),) for i in range(8)]
    assert {one.texels.shape for (one,) in packed if isinstance(one, PackedTexture)} == {(4096, 3)}
    _look_up(packed[0], UV, FOOTPRINTS)
    with compilations() as programs:
        for one in packed[1:]:
            _look_up(one, UV, FOOTPRINTS)
    assert programs == []


def test_what_is_constant_or_traced_stays_as_it_is():
    texture, plain, colours = Texture(as_array(_image(4, 4))), constant([0.1, 0.2, 0.3]), VertexColours()
    packed, same, also = pack_weight((texture, plain, colours))
    assert isinstance(packed, PackedTexture)
    assert same is plain
    assert also is colours

    def total(pixels):
        weight = pack_weight((Texture(pixels),))
        assert isinstance(weight[0], Texture)
        return jnp.sum(jax.vmap(look_up, in_axes=(None, 0))(weight, UV[:, :2]))

    assert np.asarray(jax.jit(jax.grad(total))(texture.pixels)).min() >= 0
