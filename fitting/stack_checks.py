"""Stacks of photographs that cannot be what they are meant to be, refused by what to look at."""

import itertools

import numpy as np
from jaxtyping import Float

from fitting.solve import Verdict
from fitting.stack import Stack
from jaxrelight.errors import InputError

# The smallest singular value of light directions over the largest, below which they lie in one plane.
_MIN_SPREAD = 0.01
# Axes are wrong where Lambert's law is this much nearer to the photographs with others.
_MUCH_NEARER = 0.5
_TEXELS = 2000
# Fewer texels with a fit than this share are hardly any.
_MIN_FITTED = 0.05


def check_lights(stack: Stack) -> None:
    """Refuses lights that leave normals open.

    Raises:
        InputError: there are fewer than three directions to lights, or they all lie in one plane.
    """
    spread = np.linalg.svd(stack.lights, compute_uv=False)
    if len(spread) < 3 or spread[2] < _MIN_SPREAD * spread[0]:
        raise InputError(
            f"{stack.name}: normals cannot be told from {len(stack.lights)} lights in one plane with the surface; give "
            "'normals', or photographs under lights from all sides"
        )


def check_stack(stack: Stack) -> None:
    """Refuses stacks that nothing can be fitted to, before that is tried.

    Raises:
        InputError: all samples are saturated or black, lights are behind the surface, or photographs fit given normals
            much better with axes that are negated or exchanged.
    """
    shown = stack.usable & stack.mask
    if not shown.any():
        raise InputError(
            f"{stack.name}: no sample of the surface is finite and below saturation; check exposures and 'saturation'"
        )
    if not stack.images[shown].any():
        raise InputError(f"{stack.name}: the surface is black in all images; check the files, 'mask' and 'ambient'")
    if (stack.lights[:, 2] <= 0).all():
        raise InputError(
            f"{stack.name}: all light directions have z <= 0, behind the surface; z points to the camera, and "
            "directions from the surface to the light: negate them"
        )
    if stack.normals is not None and (better := _better_axes(stack, np.asarray(stack.normals))):
        raise InputError(
            f"{stack.name}: the images fit its normals much better with {better}; check that x points to the right, y "
            "up and z to the camera in both"
        )


def check_fit(flags: np.ndarray, name: str) -> None:
    """Refuses a fit of which hardly any texel has come to anything.

    Args:
        flags: verdicts of the texels of the mask.
        name: what messages call the stack.

    Raises:
        InputError: fewer than a twentieth of the texels have a verdict other than NO_DATA and BLACK.
    """
    nothing = (flags == Verdict.NO_DATA) | (flags == Verdict.BLACK)
    if nothing.mean() > 1 - _MIN_FITTED:
        raise InputError(
            f"{name}: {nothing.sum():,} of {nothing.size:,} texels have too few samples that are lit, seen and below "
            "saturation; check the axes of the light directions and normals (x right, y up, z to the camera) and the "
            "exposures, or give more images"
        )


def _better_axes(stack: Stack, normals: Float[np.ndarray, "h w 3"]) -> str:
    """What to do to the light directions, where that brings shading much nearer to the images; else nothing."""
    place = np.argwhere(stack.mask)
    chosen = tuple(place[np.linspace(0, len(place) - 1, min(_TEXELS, len(place))).astype(int)].T)
    lights = stack.towards_lights(np.asarray(np.ravel_multi_index(chosen, stack.mask.shape)))
    usable = stack.usable[:, *chosen].T
    grey = np.where(usable, stack.images[:, *chosen].mean(axis=-1).T, 0).astype(float)
    misfits = {}
    for order in ((0, 1, 2), (1, 0, 2)):
        for signs in itertools.product((1, -1), repeat=3):
            towards = lights[..., order] * np.array(signs)
            cosine = np.maximum(np.einsum("pnx,px->pn", np.broadcast_to(towards, (*grey.shape, 3)), normals[chosen]), 0)
            cosine = np.where(usable, cosine, 0)
            square = np.sum(cosine**2, axis=1)
            albedo = np.sum(cosine * grey, axis=1) / np.where(square > 0, square, 1)
            misfits[order, signs] = np.abs(grey - albedo[:, None] * cosine).sum()
    as_given, best = misfits[(0, 1, 2), (1, 1, 1)], min(misfits, key=lambda key: misfits[key])
    if misfits[best] >= _MUCH_NEARER * as_given:
        return ""
    order, signs = best
    negated = [axis for axis, sign in zip("xyz", signs, strict=True) if sign < 0]
    changes = ["x and y exchanged"] * (order[0] == 1) + [f"{' and '.join(negated)} negated"] * bool(negated)
    return f"{', and '.join(changes)} in the light directions"
