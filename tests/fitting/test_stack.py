"""Stacks of images: what is read, what is masked, what is refused."""

import numpy as np
import pytest
from PIL import Image

from fitting.stack import stack_of
from fitting.stack_files import load_stack
from jaxrelight.errors import InputError
from jaxrelight.images import srgb_decode, write_image
from tests.images import png_writer
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
        ({"light_dirs": LIGHTS}, "'light_dirs' is not known; known are ambient, "),
        ({"encoding": "gamma"}, "'encoding' is \"srgb\" or \"linear\", not 'gamma'"),
        ({"saturation": [1.0, 2]}, "'saturation' is one positive number"),
        ({"saturation": -1.0}, "'saturation' is one positive number"),
        ({"ambient": np.zeros((4, 4, 3))}, r"'ambient' has shape \(4, 4, 3\), not \(4, 5, 3\)"),
        ({"light_positions": LIGHTS}, "either directions to lights that are far away or positions"),
        ({"light_directions": None, "light_positions": LIGHTS}, "light positions need 'size'"),
        ({"light_directions": None, "light_positions": -LIGHTS, "size": 1.0}, "must lie before the surface"),
        ({"light_directions": None, "light_positions": LIGHTS, "size": [1, 2, 3]}, "'size' is a positive width"),
        ({"size": 1.0}, "'size' belongs to positions"),
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
        ("[[image]]\nfile = 'a.png'\nlight = [0, 0, 1]\nposition = [0, 0, 1]", "'light', .* or 'position'"),
        ("[[image]]\nfile = 'a.png'\nlights = [0, 0, 1]", "'lights' is not known"),
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


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_archives_may_be_encoded_saturated_and_lit_by_something_else(tmp_path, dtype, encoding):
    images = _images(dtype)
    top = np.iinfo(dtype).max if dtype[0] == "u" else 1
    images[0, 1, 2] = top
    images[1, 0, 0, 1] = 0.95 * top
    ambient = (images[2] * 0.3).astype(dtype)
    arrays = {"images": images, "light_directions": LIGHTS, "encoding": encoding}
    full_scale = [[0, 1, 2]] if dtype[0] == "u" or encoding == "srgb" else []
    stack = load_stack(_saved(tmp_path, **arrays))
    assert np.argwhere(~stack.usable).tolist() == full_scale
    more = {"ambient": ambient, "saturation": 0.94 * top, "intensities": np.full((3, 3), 2)}
    stack = load_stack(_saved(tmp_path, **arrays, **more))
    assert np.argwhere(~stack.usable).tolist() == [[0, 1, 2], [1, 0, 0]]
    decode = srgb_decode if encoding == "srgb" else np.asarray
    wanted = np.maximum(decode(images / top) - decode(ambient / top), 0) / 2
    np.testing.assert_allclose(stack.images, np.where(stack.usable[..., None], wanted, 0), atol=1e-6)


def _write_list(tmp_path, images: np.ndarray, head: str = ""):
    """A list of 16-bit PNGs."""
    entries = []
    for number, (image, light) in enumerate(zip(images, LIGHTS, strict=True)):
        (tmp_path / f"{number}.png").write_bytes(png_writer.picture(image))
        entries.append(f'[[image]]\nfile = "{number}.png"\nlight = {light.tolist()}\n')
    path = tmp_path / "stack.toml"
    path.write_text(head + "".join(entries))
    return path


def test_pictures_of_sixteen_bits_are_as_good_as_an_archive(tmp_path):
    images = _images("uint16")
    images[1, 2, 3, 0] = 65535
    images[2, 0, 0] = 65534
    for encoding in ("linear", "srgb"):
        path = _write_list(tmp_path, images, f'encoding = "{encoding}"\n')
        listed = load_stack(path)
        kept = load_stack(_saved(tmp_path, images=images, light_directions=LIGHTS, encoding=encoding))
        np.testing.assert_array_equal(listed.images, kept.images)
        np.testing.assert_array_equal(listed.usable, kept.usable)
        assert np.argwhere(~listed.usable).tolist() == [[1, 2, 3]]


def test_a_list_may_name_ambient_light_and_saturation(tmp_path):
    images = _images("uint16")
    images[0, 0, 0, 2] = 64000
    dark = (images.min(axis=0) * 0.5).astype(np.uint16)
    (tmp_path / "dark.png").write_bytes(png_writer.picture(dark))
    head = 'encoding = "linear"\nsaturation = 0.95\nambient = "dark.png"\n'
    stack = load_stack(_write_list(tmp_path, images, head))
    assert np.argwhere(~stack.usable).tolist() == [[0, 0, 0]]
    wanted = (images.astype(float) - dark) / 65535
    np.testing.assert_allclose(stack.images[1:], wanted[1:], atol=1e-6)
    # Radiance has no full scale, but may be given one.
    for number, image in enumerate(images / np.float32(65535)):
        write_image(tmp_path / f"{number}.exr", image)
    text = (tmp_path / "stack.toml").read_text().replace('.png"\nlight', '.exr"\nlight')
    (tmp_path / "stack.toml").write_text(text)
    of_radiance = load_stack(tmp_path / "stack.toml")
    assert of_radiance.notes == ()
    np.testing.assert_allclose(of_radiance.images, stack.images, atol=1e-6)
    np.testing.assert_array_equal(of_radiance.usable, stack.usable)
    (tmp_path / "stack.toml").write_text(text.replace("saturation = 0.95\n", ""))
    assert load_stack(tmp_path / "stack.toml").usable.all()
    (tmp_path / "stack.toml").write_text(text.replace('"dark.png"', "3"))
    with pytest.raises(InputError, match="'ambient' is the path of an image"):
        load_stack(tmp_path / "stack.toml")


LAMPS = np.array([[0.1, 0.2, 0.5], [-0.3, 0, 0.4], [0, 0.1, 0.2]])


def test_near_lamps_have_directions_and_falloff_of_their_own_at_every_texel(tmp_path):
    images = np.ones((3, 4, 5, 3), np.float32)
    stack = stack_of(images, positions=LAMPS, size=(1.0, 0.8))
    x, y = np.meshgrid((np.arange(5) - 2) / 5, (1.5 - np.arange(4)) / 5)
    texels = np.stack([x, y, np.zeros((4, 5))], axis=-1)
    apart = LAMPS - texels[:, :, None]
    distance = np.linalg.norm(apart, axis=-1)
    np.testing.assert_allclose(stack.towards_lights(stack.mask), (apart / distance[..., None]).reshape(20, 3, 3))
    some = stack.mask & (x > 0)
    np.testing.assert_allclose(stack.towards_lights(some), (apart / distance[..., None])[some])
    np.testing.assert_allclose(stack.of([2]).towards_lights(np.array([7, 3])).shape, (2, 1, 3))
    centre = np.linalg.norm(LAMPS, axis=-1)
    np.testing.assert_allclose(stack.images[..., 0], np.moveaxis((distance / centre) ** 2, -1, 0), rtol=1e-6)
    np.testing.assert_allclose(stack.lights, LAMPS / centre[:, None])
    # By a file: the height follows from the pixels.
    kept = load_stack(_saved(tmp_path, images=images, light_positions=LAMPS, size=1.0))
    np.testing.assert_array_equal(kept.images, stack.images)
    path = _write_list(tmp_path, np.full((3, 4, 5, 3), 65534, np.uint16), "size = 1\n")
    lines = path.read_text()
    for light, lamp in zip(LIGHTS, LAMPS, strict=True):
        lines = lines.replace(f"light = {light.tolist()}", f"position = {lamp.tolist()}")
    path.write_text(lines)
    np.testing.assert_allclose(load_stack(path).images, stack.images, rtol=1e-4)
    # What a picture holds decides, and is told.
    (tmp_path / "1.png").rename(tmp_path / "1.jpg")
    path.write_text(lines.replace("1.png", "1.jpg"))
    assert load_stack(path).notes == (f"{tmp_path / '1.jpg'}: read as PNG, which is what it holds",)
    path.write_text(lines.replace("position", "light", 1))
    with pytest.raises(InputError, match="all images have a 'light', or all have a 'position'"):
        load_stack(path)
    # Far lights are the same from everywhere.
    assert stack_of(images, LIGHTS).towards_lights(stack.mask).shape == (3, 3)
