"""A BRDF for every texel in transport: pixels bake their own, exactly."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.errors import InputError

SETTINGS = jr.Settings("pixels", resolution=8)
SKY = jr.environment(np.random.default_rng(0).random((8, 16, 3)).astype(np.float32))


def _scene(material) -> jr.Scene:
    camera = jr.Camera((0.2, 1.5, 0.8), (0, 0, 0), fov_y=40, width=16, height=12)
    return jr.Scene([jr.Part(jr.plane((1, 1), 4), "floor")], {"floor": material}, camera, SKY)


def _picture(material, folder):
    made = jr.precompute(_scene(material), SETTINGS, folder)
    relighter = jr.Relighter.open(made.folder)
    return relighter.image(SKY, relighter.view(), background=False)


def _maps(exponents) -> SpatialLobes:
    """Two rows of texels: the far half of the plane and the near one."""
    h = len(exponents)
    C = jnp.broadcast_to(jnp.asarray([-1.0, -1, 1]), (h, 1, 1, 3))
    exponent = jnp.asarray(exponents, jnp.float32).reshape(h, 1, 1)
    axis = jnp.broadcast_to(jnp.asarray([1.0, 0]), (h, 1, 2))
    return SpatialLobes(jnp.full((h, 1, 3), 0.2), C, exponent, jnp.full((h, 1, 1, 3), 0.6), axis)


def test_maps_that_are_the_same_everywhere_are_the_plain_brdf(tmp_path):
    plain = LobeSum(jnp.full(3, 0.2), jnp.asarray([[[-1.0, -1, 1]]]), jnp.full((1, 1), 5.0), jnp.full((1, 3), 0.6))
    found = _picture(Material((Component(_maps([5, 5])),)), tmp_path / "maps")
    np.testing.assert_allclose(found, _picture(plain, tmp_path / "plain"), rtol=1e-4, atol=1e-6)
    assert found[..., 3].any()


def test_every_pixel_has_the_lobes_at_its_own_place(tmp_path):
    """Where u, v lies within half a texel of the map's edge rows, one half of the picture follows each."""
    both = _picture(Material((Component(_maps([2, 2, 2, 2, 40, 40, 40, 40])),)), tmp_path / "both")
    soft, sharp = (_picture(Material((Component(_maps([n])),)), tmp_path / str(n)) for n in (2, 40))
    apart = [np.abs(both - other)[..., :3].sum(axis=(1, 2)) for other in (soft, sharp)]
    top, bottom = 3, 8
    assert apart[0][top] < 1e-3 * apart[1][top] or apart[1][top] < 1e-3 * apart[0][top]
    assert (apart[0][top] < apart[1][top]) != (apart[0][bottom] < apart[1][bottom])


def test_vertices_are_refused_before_any_ray(tmp_path):
    scene = _scene(Material((Component(_maps([5, 9])),)))
    with pytest.raises(InputError, match=r"'floor' has a BRDF for every texel, .* --receivers pixels"):
        jr.precompute(scene, jr.Settings("vertices", resolution=8), tmp_path)
