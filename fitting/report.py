"""Pictures that let a person judge a fit: curves in the plane of incidence, spheres, residuals."""

import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.errors import InputError
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.images import write_image
from jaxrelight.numerics.arrays import as_array

# Degrees from the normal, of the light of each curve.
INCIDENCE = 15, 45, 65, 75
_SIZE, _GAP = 192, 8
# The light on a sphere seen from +z: from above on the right, so that both the highlight and grazing angles show.
_LIGHT = np.array([0.45, 0.55, 0.70])


def write_report(
    folder: pathlib.Path,
    brdfs: Mapping[str, Brdf],
    residual: tuple[np.ndarray, np.ndarray, Float[np.ndarray, "d h"]] | None = None,
) -> list[pathlib.Path]:
    """Writes curves.png, spheres.png and, where residuals are given, residuals.png; the files, in that order.

    Args:
        folder: made if it is not there.
        brdfs: the data first, then what was fitted to it, by what pictures call them.
        residual: edges of θ_h and of θ_d in degrees, and the relative residual between them; NaN where no sample is.

    Raises:
        InputError: if matplotlib is not installed, or the folder cannot be made.
    """
    pyplot = _pyplot()
    check_report(folder)
    files = [folder / "curves.png", folder / "spheres.png"]
    curves(pyplot, brdfs, files[0])
    write_image(files[1], spheres(list(brdfs.values())))
    if residual is not None:
        files.append(folder / "residuals.png")
        residuals(pyplot, *residual, files[-1])
    return files


def check_report(folder: pathlib.Path) -> None:
    """Makes the folder of a report, and finds out before long work whether pictures can be drawn.

    Raises:
        InputError: if matplotlib is not installed, or the folder cannot be made.
    """
    _pyplot()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise InputError(f"{folder}: cannot be made ({fault.strerror}); give another folder for the report") from None


def _pyplot():
    try:
        from matplotlib import pyplot, use  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError("a report needs matplotlib; install jaxrelight[plots], or leave --report out") from None
    use("agg")
    return pyplot


@eqx.filter_jit
def _evaluate(brdf: Brdf, omega_i, omega_o):
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)


def in_plane(brdf: Brdf, incidence: float, outgoing: Float[np.ndarray, " o"]) -> Float[np.ndarray, "o c"]:
    """Values in the plane of incidence; positive outgoing angles, in degrees, are on the mirror's side."""
    light, eye = np.radians(incidence), np.radians(outgoing)
    omega_i = np.broadcast_to([-np.sin(light), 0, np.cos(light)], (len(eye), 3))
    omega_o = np.stack([np.sin(eye), 0 * eye, np.cos(eye)], axis=-1)
    return np.asarray(_evaluate(brdf, as_array(omega_i, jnp.float32), as_array(omega_o, jnp.float32)))


def curves(pyplot: Any, brdfs: Mapping[str, Brdf], path: pathlib.Path) -> None:
    """Reflectance against the outgoing angle, a panel for each angle of incidence, logarithmic."""
    outgoing = np.linspace(-89, 89, 357)
    figure, axes = pyplot.subplots(1, len(INCIDENCE), figsize=(4 * len(INCIDENCE), 3.6), sharey=True)
    for incidence, panel in zip(INCIDENCE, axes, strict=True):
        for (name, brdf), style in zip(brdfs.items(), ["-", "--", ":", "-."] * len(brdfs), strict=False):
            values = in_plane(brdf, incidence, outgoing)
            for c, colour in enumerate(("tab:red", "tab:green", "tab:blue")):
                label = name if c == 1 else None
                panel.plot(outgoing, np.maximum(values[:, c], 1e-6), style, color=colour, linewidth=1, label=label)
        panel.axvline(incidence, color="grey", linewidth=0.5)
        panel.set(title=f"light at {incidence}°", xlabel="eye, degrees from the normal", yscale="log")
    axes[0].set_ylabel("BRDF / sr⁻¹")
    axes[0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def spheres(brdfs: Sequence[Brdf], size: int = _SIZE) -> Float[np.ndarray, "h w 3"]:
    """Spheres side by side under one distant light, as linear radiance; the first one's mean is a middle grey."""
    x, y = np.meshgrid(*[(np.arange(size) + 0.5) * 2 / size - 1] * 2)
    seen = x * x + y * y < 1
    normals = np.stack([x, -y, np.sqrt(np.maximum(0, 1 - x * x - y * y))], axis=-1)[seen].astype(np.float32)
    frames = np.asarray(tangent_frame(as_array(normals)))
    omega_o = frames @ np.array([0, 0, 1], np.float32)
    omega_i = frames @ (_LIGHT / np.linalg.norm(_LIGHT)).astype(np.float32)
    lit = (omega_i[:, 2:] > 0) & (omega_o[:, 2:] > 0)
    pictures, exposure = [], 1.0
    for number, brdf in enumerate(brdfs):
        radiance = np.where(lit, np.asarray(_evaluate(brdf, omega_i, omega_o)) * omega_i[:, 2:], 0)
        if not number:
            exposure = 0.25 / max(float(radiance.mean()), 1e-12)
        picture = np.full((size, size + _GAP, 3), 1.0, np.float32)
        picture[:, :size][seen] = radiance * exposure
        pictures.append(picture)
    return np.concatenate(pictures, axis=1)[:, :-_GAP]


def residuals(
    pyplot: Any, half: np.ndarray, difference: np.ndarray, values: Float[np.ndarray, "d h"], path: pathlib.Path
) -> None:
    """Relative residual over the angles between half vector and normal, and between half vector and light."""
    figure, panel = pyplot.subplots(figsize=(5.2, 4))
    mesh = panel.pcolormesh(half, difference, 100 * values, cmap="magma", vmin=0)
    figure.colorbar(mesh, label="residual / % of the data")
    panel.set(xlabel="θ_h / degrees", ylabel="θ_d / degrees")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def heat_map(
    values: Float[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"], largest: float, path: pathlib.Path
) -> None:
    """A picture of numbers 0 … largest over a surface; what is off the mask is black."""
    from matplotlib import colormaps  # pyright: ignore[reportMissingImports]

    shades = colormaps["magma"](np.clip(np.nan_to_num(values / largest, nan=1.0), 0, 1))[..., :3]
    from PIL import Image

    Image.fromarray((255 * np.where(mask[..., None], shades, 0)).astype(np.uint8)).save(path)


def side_by_side(pictures: Sequence[Float[np.ndarray, "h w 3"]], exposure: float, path: pathlib.Path) -> None:
    """Linear pictures beside each other, at one exposure."""
    row = np.concatenate([np.pad(p, ((0, 0), (0, _GAP), (0, 0)), constant_values=1) for p in pictures], axis=1)
    write_image(path, row[:, :-_GAP] * 2**exposure)
