"""Normals from images: of surfaces whose normals are known."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

from fitting.normals import estimated_normals
from fitting.stack import stack_of
from fitting.stack_files import load_stack
from jaxrelight.images import srgb_encode
from tests.images import png_writer
from tests.shared_data import shared


def _apart(one, other) -> np.ndarray:
    """Degrees between unit vectors."""
    return np.degrees(np.arccos(np.clip(np.sum(one * other, axis=-1), -1, 1)))


def _ball(size=24):
    x, y = np.meshgrid(*[(np.arange(size) + 0.5) * 2 / size - 1] * 2)
    mask = x * x + y * y < 0.8
    return np.stack([x, -y, np.sqrt(np.maximum(0, 1 - x * x - y * y))], axis=-1), mask


# As many as the photographs of the real ball: one program is compiled for all.
def _lights(count=96):
    angle = np.arange(count) * 2.4
    slant = 0.9 * np.sqrt((np.arange(count) + 0.5) / count)
    return np.stack([slant * np.cos(angle), slant * np.sin(angle), np.sqrt(1 - slant**2)], axis=-1)


def test_a_lambertian_ball_with_attached_shadows_is_found_exactly():
    normals, mask = _ball()
    shading = np.maximum(normals @ _lights().T, 0)
    images = np.moveaxis(shading, -1, 0)[..., None] * [0.5, 0.2, 0.7]
    estimated = estimated_normals(stack_of(images, _lights(), mask=mask))
    assert _apart(estimated, normals)[mask].max() < 0.2
    np.testing.assert_allclose(np.linalg.norm(estimated, axis=-1), 1, atol=1e-6)


def test_highlights_and_cast_shadows_do_little_harm():
    rng = np.random.default_rng(0)
    normals, mask = _ball()
    shading = np.maximum(normals @ _lights().T, 0)
    mirror = 2 * shading[..., None] * normals[..., None, :] - _lights()
    shading = 0.4 * shading + np.maximum(mirror[..., 2], 0) ** 40
    shading[rng.random(shading.shape) < 0.08] = 0
    estimated = estimated_normals(stack_of(np.moveaxis(shading, -1, 0)[..., None] * np.ones(3), _lights(), mask=mask))
    assert np.median(_apart(estimated, normals)[mask]) < 3


def test_pixels_of_which_nothing_can_be_said_face_the_camera():
    """Black, of one slant, seen three times, or never."""
    normals, mask = _ball()
    images = np.full((96, *mask.shape, 3), np.nan)
    images[:, 12, 12] = 0
    images[:, 12, 13] = 0.5 * _lights()[:, 2:]
    images[:3, 13, 12] = 0.3 * _lights()[:3, 2:]
    estimated = estimated_normals(stack_of(images, _lights(), mask=mask))
    np.testing.assert_allclose(estimated, np.broadcast_to([0, 0, 1], normals.shape), atol=1e-3)


def test_a_real_ball_of_known_normals():
    stack = load_stack(shared("data", "photometric", "diligent_ball.npz"))
    shown = np.flatnonzero(stack.mask)
    some = np.zeros(stack.mask.size, bool)
    some[shown[np.linspace(0, len(shown) - 1, _ball()[1].sum()).astype(int)]] = True
    stack = dataclasses.replace(stack, mask=some.reshape(stack.mask.shape))
    assert np.mean(_apart(estimated_normals(stack), stack.normals)[stack.mask]) == pytest.approx(1.8, abs=0.4)


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_a_real_ball_from_pictures_of_sixteen_bits(tmp_path, encoding):
    """The mean error of normals is that from the archive to 0.01 degrees."""
    path = shared("data", "photometric", "diligent_ball.npz")
    kept, arrays = load_stack(path), np.load(path)
    levels = arrays["images"] / 65535
    levels = np.rint(65535 * (srgb_encode(levels) if encoding == "srgb" else levels)).astype(np.uint16)
    text = f'encoding = "{encoding}"\nmask = "mask.png"\n'
    Image.fromarray(arrays["mask"].astype(np.uint8) * 255).save(tmp_path / "mask.png")
    lights = zip(levels, arrays["light_directions"], arrays["light_intensities"], strict=True)
    for number, (image, light, intensity) in enumerate(lights):
        (tmp_path / f"{number}.png").write_bytes(png_writer.picture(image, filters=(number % 3,)))
        text += f'[[image]]\nfile = "{number}.png"\nlight = {light.tolist()}\nintensity = {intensity.tolist()}\n'
    (tmp_path / "ball.toml").write_text(text)
    listed = load_stack(tmp_path / "ball.toml")
    both = kept.mask & listed.mask
    errors = [np.mean(_apart(estimated_normals(stack), kept.normals)[both]) for stack in (kept, listed)]
    assert errors[1] == pytest.approx(errors[0], abs=0.01)
