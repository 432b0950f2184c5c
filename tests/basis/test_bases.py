"""What every basis and every linear map of images offers: shapes that do not fit are refused, precision is kept."""

import jax
import numpy as np
import pytest

from jaxrelight.basis import latlong, zonal
from jaxrelight.basis.cubemap import Texels
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.operators.contract import Basis

BASES = [(Texels(4), 96), (HaarFaces(4), 96), (HaarFaces(8, 1), 64)]


@pytest.mark.parametrize(("basis", "size"), BASES)
def test_size_is_the_number_of_texels(basis, size):
    assert isinstance(basis, Basis)
    assert basis.size == size
    for transform in (basis.encode, basis.decode):
        assert jax.eval_shape(transform, jax.ShapeDtypeStruct((2, 3, size), np.float32)).shape == (2, 3, size)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(("basis", "size"), BASES)
@pytest.mark.parametrize("shape", [(3, 100), (96, 3), ()])
def test_other_numbers_are_refused(basis, size, shape):
    for transform, name in ((basis.encode, "texels"), (basis.decode, "coefficients")):
        with pytest.raises(ValueError, match=f"^{name} of shape .* do not end in the {size} of the basis$"):
            transform(np.zeros(shape, np.float32))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_results_have_the_precision_of_what_is_given(x64, dtype):
    """Nothing is compiled."""
    texels, pixels = jax.ShapeDtypeStruct((3, 96), dtype), jax.ShapeDtypeStruct((8, 16, 3), dtype)
    resampling = latlong.area_resampling(8, 16, 4)

    def everything(texels, pixels):
        of_texels = [transform(texels) for basis, _ in BASES[:2] for transform in (basis.encode, basis.decode)]
        turned = latlong.rotate(pixels, np.float32(20))
        u, v = latlong.finite_coordinates(pixels)
        resampled = resampling.apply(pixels), latlong.resized(pixels, 4, 8), latlong.look_up(pixels, u, v)
        return *of_texels, turned, u, v, *resampled, zonal.zonal_means(pixels, 2.0)

    assert {array.dtype for array in jax.eval_shape(everything, texels, pixels)} == {np.dtype(dtype)}
