"""Stacks of images: what is read, what is masked, what is refused."""

import numpy as np
import pytest
from PIL import Image

from fitting.stack import load_stack, stack_of
from jaxrelight.errors import InputError
from jaxrelight.images import write_image
from tests.shared_data import shared

LIGHTS = np.array([[0.0, 0, 2], [0.6, 0, 0.8], [0, -0.6, 0.8]])


def _images(dtype: str = "float32") -> np.ndarray:
    values = np.random.default_rng(0).uniform(0.1, 0.9, (3, 4, 5, 3))
    return (values * (np.iinfo(dtype).max if dtype[0] == "u" else 1)).astype(dtype)


def _saved(tmp_path, **arrays):
    path = tmp_path / "stack.npz"
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
def test_archives_of_every_type(tmp_path, dtype):
    images = _images(dtype)
    intensities = np.array([[1, 2, 4], [1, 1, 1], [0.5, 0.5, 0.5]])
    mask = np.ones((4, 5), bool)
    mask[0] = False
    path = _saved(tmp_path, images=images, light_directions=LIGHTS, light_intensities=intensities, mask=mask)
    stack = load_stack(path)
    top = np.iinfo(dtype).max if dtype[0] == "u" else 1
    np.testing.assert_allclose(stack.images, images / top / intensities[:, None, None], rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(stack.lights, axis=1), 1)
    np.testing.assert_array_equal(stack.views, [[0, 0, 1]] * 3)
    np.testing.assert_array_equal(stack.mask, mask)
    assert stack.normals is None
    assert stack.usable.all()


def test_saturated_and_non_finite_samples_are_unusable(tmp_path):
    images = _images("uint8")
    images[1, 2, 3, 0] = 255
    stack = load_stack(_saved(tmp_path, images=images, light_directions=LIGHTS))
    assert np.argwhere(~stack.usable).tolist() == [[1, 2, 3]]
    images = _images()
    images[0, 1, 1] = np.nan, 1, 1
    images[2, 0, 4] = np.inf
    stack = load_stack(_saved(tmp_path, images=images, light_directions=LIGHTS))
    assert np.argwhere(~stack.usable).tolist() == [[0, 1, 1], [2, 0, 4]]
    assert np.isfinite(stack.images).all()


def test_normals_are_normalized_and_bound_the_mask(tmp_path):
    normals = np.zeros((4, 5, 3))
    normals[1:] = 0, 1.2, 1.6
    normals[2, 2] = np.nan
    stack = load_stack(_saved(tmp_path, images=_images(), light_directions=LIGHTS, normal_gt=normals))
    assert stack.mask.sum() == 14
    assert stack.normals is not None
    np.testing.assert_allclose(stack.normals[stack.mask], [[0, 0.6, 0.8]] * 14)


def test_a_list_of_images(tmp_path):
    """PNG is decoded from sRGB unless it says otherwise, normals and masks are numbers; EXR is radiance."""
    levels = np.full((4, 5, 3), 128, np.uint8)
    Image.fromarray(levels).save(tmp_path / "a.png")
    write_image(tmp_path / "b.exr", np.full((4, 5, 3), 0.25, np.float32))
    white = np.full((4, 5), 255, np.uint8)
    white[0] = 0
    Image.fromarray(white).convert("RGB").save(tmp_path / "mask.png")
    Image.fromarray(np.full((4, 5, 3), [128, 128, 255], np.uint8)).save(tmp_path / "n.png")
    text = (
        '{}mask = "mask.png"\nnormals = "n.png"\n[[image]]\nfile = "a.png"\nlight = [0, 0, 1]\nintensity = [2, 2, 2]\n'
        '[[image]]\nfile = "b.exr"\nlight = [1, 0, 1]\nview = [0, 1, 1]\n'
    )
    path = tmp_path / "stack.toml"
    path.write_text(text.format(""))
    stack = load_stack(path)
    np.testing.assert_allclose(stack.images[0], 0.21586 / 2, rtol=1e-4)
    np.testing.assert_allclose(stack.images[1], 0.25)
    np.testing.assert_allclose(stack.views, [[0, 0, 1], [0, 0.5**0.5, 0.5**0.5]])
    assert stack.mask.sum() == 15
    assert stack.normals is not None
    np.testing.assert_allclose(stack.normals[1, 1], [0, 0, 1], atol=0.01)
    path.write_text(text.format('encoding = "linear"\n'))
    np.testing.assert_allclose(load_stack(path).images[0], 128 / 255 / 2, rtol=1e-4)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"images": None}, "'images' is missing"),
        ({"light_directions": None}, "'light_directions' is missing"),
        ({"images": np.zeros((3, 4, 5))}, "must be n × h × w pixels of three channels"),
        ({"light_directions": LIGHTS[:2]}, r"light directions have shape \(2, 3\), not \(3, 3\)"),
        ({"light_directions": LIGHTS * 0}, "light directions must not be zero"),
        ({"light_directions": LIGHTS * np.nan}, "light directions must be finite"),
        ({"light_intensities": -np.ones((3, 3))}, "must be positive"),
        ({"mask": np.zeros((4, 5))}, "no pixel shows the surface"),
        ({"normals": np.zeros((4, 4, 3))}, "normals have shape"),
        ({"images": np.array(["a"] * 3)}, "does not hold real numbers"),
    ],
)
def test_archives_that_do_not_fit_are_refused(tmp_path, change, word):
    arrays = {"images": _images(), "light_directions": LIGHTS} | change
    with pytest.raises(InputError, match=word) as told:
        load_stack(_saved(tmp_path, **{name: array for name, array in arrays.items() if array is not None}))
    assert "\n" not in str(told.value)


def test_damaged_archives_and_lists_are_refused(tmp_path):
    path = _saved(tmp_path, images=_images(), light_directions=LIGHTS)
    whole = path.read_bytes()
    for length in np.linspace(0, len(whole) - 1, 20).astype(int):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"stack\.npz"):
            load_stack(path)
    lies = tmp_path / "lies.npz"
    header = np.lib.format.magic(1, 0)
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999, 9999, 9999, 3), }".ljust(117) + b"\n"
    import zipfile

    with zipfile.ZipFile(lies, "w") as archive:
        archive.writestr("images.npy", header + len(text).to_bytes(2, "little") + text)
    with pytest.raises(InputError, match="larger than 2 GiB"):
        load_stack(lies)
    listed = tmp_path / "list.toml"
    for text, word in (
        ("image = 3", "lists no"),
        ("x = [", "cannot be read"),
        ("masc = 'a'\n[[image]]\nfile='a.png'\nlight=[0,0,1]", "'masc' is not known"),
        ("[[image]]\nfile = 'absent.png'\nlight = [0, 0, 1]", "no such file"),
        ("[[image]]\nlight = [0, 0, 1]", "needs 'file'"),
        ("encoding = 'gamma'\n[[image]]\nfile='a.png'\nlight=[0,0,1]", "'encoding' is"),
    ):
        listed.write_text(text)
        with pytest.raises(InputError, match=word):
            load_stack(listed)
    with pytest.raises(InputError, match=r"a \.npz file, or a \.toml file"):
        load_stack(tmp_path / "stack.zip")


def test_some_of_the_images():
    stack = stack_of(_images(), LIGHTS)
    part = stack.of([0, 2])
    np.testing.assert_array_equal(part.images, stack.images[[0, 2]])
    np.testing.assert_array_equal(part.lights, stack.lights[[0, 2]])
    assert len(part.views) == len(part.usable) == 2


@pytest.mark.parametrize("name", ["diligent_ball", "uw_cat", "uw_owl"])
def test_real_stacks(name):
    stack = load_stack(shared("data", "photometric", f"{name}.npz"))
    assert stack.mask.sum() > 10_000
    assert stack.usable.mean() > 0.99
    assert (stack.normals is None) == name.startswith("uw")
