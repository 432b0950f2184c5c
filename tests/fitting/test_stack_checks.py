"""Stacks that cannot be what they are meant to be are refused by what to look at."""

import dataclasses

import numpy as np
import pytest

from fitting.normals import estimated_normals
from fitting.sbrdf import fit_sbrdf
from fitting.solve import Verdict
from fitting.stack import Stack, stack_of
from fitting.stack_checks import check_fit, check_lights, check_stack
from jaxrelight.errors import InputError
from tests.fitting.test_normals import _ball, _lights


def _stack(count: int = 24, gloss: float = 0.0, **given) -> Stack:
    """A ball, whose normals are given."""
    normals, mask = _ball(12)
    cosine = np.maximum(normals @ _lights(count).T, 0)
    mirror = 2 * cosine[..., None] * normals[..., None, :] - _lights(count)
    shading = np.moveaxis(0.4 * cosine + gloss * np.maximum(mirror[..., 2], 0) ** 20, -1, 0)
    return stack_of(shading[..., None] * np.ones(3), _lights(count), mask=mask, normals=normals, **given)


@pytest.mark.parametrize("gloss", [0, 0.5])
@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ([[1, 0, 0], [0, -1, 0], [0, 0, 1]], "with y negated in the light directions"),
        ([[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "with x negated"),
        ([[-1, 0, 0], [0, -1, 0], [0, 0, 1]], "with x and y negated"),
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], "with x and y exchanged"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, -1]], r"all light directions have z <= 0"),
    ],
)
def test_axes_that_are_negated_or_exchanged(axes, words, gloss):
    stack = _stack(gloss=gloss)
    check_stack(stack)
    wrong = dataclasses.replace(stack, lights=stack.lights @ np.array(axes, float))
    with pytest.raises(InputError, match=words) as told:
        fit_sbrdf(wrong)
    assert "\n" not in str(told.value)


def test_flat_surfaces_say_nothing_of_axes():
    normals, mask = _ball(12)
    flat = np.broadcast_to([0.0, 0, 1], normals.shape)
    stack = stack_of(
        np.broadcast_to(_lights(9)[:, 2, None, None, None], (9, 12, 12, 3)), _lights(9), normals=flat, mask=mask
    )
    check_stack(stack)
    check_stack(dataclasses.replace(stack, lights=stack.lights * [-1, 1, 1]))


def test_black_and_saturated_images():
    stack = _stack()
    with pytest.raises(InputError, match=r"the surface is black in all images; check the files, 'mask' and 'ambient'"):
        fit_sbrdf(dataclasses.replace(stack, images=0 * stack.images))
    with pytest.raises(InputError, match="no sample of the surface is finite and below saturation"):
        fit_sbrdf(dataclasses.replace(stack, usable=stack.usable & False))


@pytest.mark.parametrize(
    "lights",
    [
        [[0, 0, 1], [0.5, 0, 1]],
        [[0.1 * i - 0.4, 0, 1] for i in range(9)],
        [[0.3 * i, 0.1 * i, 1] for i in range(-3, 3)],
        [[0, 0.6, 0.8]] * 5,
    ],
)
def test_lights_in_a_plane_leave_normals_open(lights):
    images = np.ones((len(lights), 2, 3, 3))
    stack = stack_of(images, np.array(lights, float))
    for refused in (check_lights, estimated_normals, fit_sbrdf):
        with pytest.raises(InputError, match=r"normals cannot be told from \d lights in one plane"):
            refused(stack)
    # Where normals are known they are no matter.
    check_stack(stack_of(images, np.array(lights, float), normals=np.broadcast_to([0.0, 0, 1], (2, 3, 3))))


def test_hardly_any_texel_with_a_fit():
    flags = np.full(100, Verdict.NO_DATA)
    flags[:4] = Verdict.GOOD
    flags[50:] = Verdict.BLACK
    with pytest.raises(InputError, match=r"sky\.npz: 96 of 100 texels have too few samples .* check the axes"):
        check_fit(flags, "sky.npz")
    flags[:6] = Verdict.POOR
    check_fit(flags, "sky.npz")


def test_near_lamps_are_told_by_their_own_directions():
    """Normals of a bumpy plane: taken as far away, its lamps would tilt them by degrees."""
    count, size = 24, 1.0
    x, y = np.meshgrid(*[(np.arange(8) + 0.5) / 8 - 0.5] * 2)
    texels = np.stack([x, -y, 0 * x], axis=-1)
    normals = np.stack([0.2 * np.sin(9 * x), 0.2 * np.cos(7 * y), np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    lamps = _lights(count) * [0.8, 0.8, 0.8]
    apart = lamps[:, None, None] - texels
    distance = np.linalg.norm(apart, axis=-1)
    cosine = np.maximum(np.sum(apart * normals, axis=-1) / distance, 0)
    falloff = np.sum(lamps**2, axis=-1)[:, None, None] / distance**2
    images = (0.5 / np.pi * cosine * falloff)[..., None] * np.ones(3)
    near = stack_of(images, positions=lamps, size=size)
    apart = np.degrees(np.arccos(np.clip(np.sum(estimated_normals(near) * normals, axis=-1), -1, 1)))
    assert apart.max() < 0.3
    far = estimated_normals(stack_of(images, lamps))
    assert np.degrees(np.arccos(np.sum(far * normals, axis=-1))).max() > 3
    check_stack(dataclasses.replace(near, normals=normals))
