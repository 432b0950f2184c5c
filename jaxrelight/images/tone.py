"""From linear radiance to what a screen shows: exposure, tone curve, clamp, sRGB (IEC 61966-2-1)."""

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from jaxrelight.errors import InputError

Exposure = float | Literal["auto"]
Tone = Literal["linear", "filmic", "agx"]
TONES: tuple[Tone, ...] = get_args(Tone)

# Automatic exposure shows this percentile of the brightest channel at this linear level, which sRGB encodes as 0.91.
AUTO_PERCENTILE, AUTO_LEVEL = 95.0, 0.8
# Exposures at which single precision holds both radiance and its factor.
_MAX_STOPS = 100.0

# Hable, "Uncharted 2: HDR Lighting" (GDC 2010): shoulder, linear and toe parameters A … F, the white point, and the
# factor on radiance that the talk's shader has.
_A, _B, _C, _D, _E, _F, _WHITE, _BIAS = 0.15, 0.50, 0.10, 0.20, 0.02, 0.30, 11.2, 2.0

# Sobotka's AgX as fitted by Wrensch, "Minimal AgX implementation" (2023): the matrix into its working space, the range
# in stops, and the polynomial of its contrast curve, the highest power first.
_AGX_INSET = np.array(
    [
        [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
        [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
        [0.0423756549057051, 0.0784336000000000, 0.879142973793104],
    ]
)
_AGX_RANGE = -12.47393, 4.026069
_AGX_CURVE = 15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232


def srgb_encode(linear: ArrayLike) -> np.ndarray:
    """Encode linear values in [0, 1] with the sRGB transfer curve; outside that range the curve is continued."""
    linear = np.asarray(linear)
    curved = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curved)


def srgb_decode(encoded: ArrayLike) -> np.ndarray:
    """Invert `srgb_encode`."""
    encoded = np.asarray(encoded)
    curved = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, curved)


def auto_exposure(pixels: ArrayLike) -> float:
    """The exposure at which the 95th percentile of the brightest channel is shown at 0.8, a little below white.

    Pixels that show a surface count: those whose fourth channel is above 0, or all where there is no such pixel. Black
    ones, and those that are not finite, are left out; an image without any others gets 0. The brightest channel, rather
    than luminance, keeps coloured light from being clipped.

    Args:
        pixels: linear Rec.709 `[..., 3 or 4]`.

    Returns:
        Stops, from −100 to 100.
    """
    pixels = np.asarray(pixels)
    levels = pixels[..., :3].max(axis=-1)[shown_pixels(pixels)].astype(float)
    lit = levels[np.isfinite(levels) & (levels > 0)]
    if not len(lit):
        return 0.0
    level = np.percentile(lit, AUTO_PERCENTILE)
    return float(np.clip(np.log2(AUTO_LEVEL) - np.log2(level), -_MAX_STOPS, _MAX_STOPS))


def shown_pixels(pixels: np.ndarray) -> np.ndarray:
    """Which pixels `[..., 4]` show a surface, by alpha; all where none does, or where there is no alpha."""
    shown = pixels[..., 3] > 0 if pixels.shape[-1] == 4 else np.zeros(0, bool)
    return shown if shown.any() else np.ones(pixels.shape[:-1], bool)


def displayed(pixels: ArrayLike, exposure: Exposure = 0.0, tone: Tone = "linear") -> np.ndarray:
    """What a screen shows of radiance, as sRGB values in [0, 1]: exposure, tone curve, clamp, encoding.

    Args:
        pixels: linear Rec.709 `[..., 3 or 4]`; a fourth channel counts for automatic exposure alone.
        exposure: stops, of which 1 doubles the brightness, or "auto"; see `auto_exposure`.
        tone: "linear" clamps at 1; "filmic" is Hable's curve of each channel, which is 1 at radiance 5.6; "agx"
            desaturates bright colours on their way to white, at radiance 16.

    Returns:
        float32 `[..., 3]`. NaN becomes 0.

    Raises:
        InputError: for an exposure that is not finite, or another tone.
    """
    pixels = np.asarray(pixels)
    stops = auto_exposure(pixels) if isinstance(exposure, str) and exposure == "auto" else exposure
    if isinstance(stops, str) or not np.isfinite(stops):
        raise InputError(f"exposure {stops} is not a finite number of stops, nor 'auto'")
    if tone not in TONES:
        raise InputError(f"tone {tone!r} is not known; known are {', '.join(TONES)}")
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = pixels[..., :3].astype(np.float32) * np.exp2(np.float32(stops))
    if tone == "agx":
        return _agx(scaled)
    return srgb_encode(to_unit(_filmic(scaled) if tone == "filmic" else scaled))


def tone_map(pixels: ArrayLike, exposure: Exposure = 0.0, tone: Tone = "linear") -> np.ndarray:
    """Turn radiance into 8-bit sRGB; see `displayed`.

    Args:
        pixels: Linear radiance `[h, w, 3 or 4]`; a fourth channel counts for automatic exposure alone.
        exposure: Stops, or "auto".
        tone: The curve between radiance and what is shown.

    Returns:
        uint8 `[h, w, 3]`. NaN becomes 0, infinity 255.

    Raises:
        InputError: The shape is not that of an image, `exposure` is not finite or `tone` is unknown.
    """
    pixels = np.asarray(pixels)
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise InputError(f"an image to tone-map has shape [h, w, 3 or 4], not {list(pixels.shape)}")
    return to_bytes(displayed(pixels, exposure, tone))


def to_unit(values: np.ndarray) -> np.ndarray:
    """Clamp to [0, 1], NaN to 0."""
    return np.clip(np.nan_to_num(values, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)


def to_bytes(unit: np.ndarray) -> np.ndarray:
    """Round values in [0, 1] to the nearest of 0…255."""
    return (unit * 255 + 0.5).astype(np.uint8)


def _filmic(linear: np.ndarray) -> np.ndarray:
    """Hable's curve of each channel, relative to its value at the white point."""

    def curve(x):
        return (x * (_A * x + _C * _B) + _D * _E) / (x * (_A * x + _B) + _D * _F) - _E / _F

    # Beyond the white point all is white, and squares would overflow.
    bounded = np.clip(np.nan_to_num(linear, nan=0.0, posinf=_WHITE), 0, _WHITE / _BIAS)
    return curve(_BIAS * bounded) / curve(_WHITE)


def _agx(linear: np.ndarray) -> np.ndarray:
    """Display values of AgX; its rows are normalised, so that grey stays grey exactly."""
    inset = _AGX_INSET / _AGX_INSET.sum(axis=1, keepdims=True)
    low, high = _AGX_RANGE
    bounded = np.clip(np.nan_to_num(linear, nan=0.0), 0, 1e9).astype(float)
    stops = np.clip(np.log2(np.maximum(bounded @ inset.T, 2.0**low)), low, high)
    curved = np.polyval(_AGX_CURVE, (stops - low) / (high - low))
    # The curve ends a little below 0 and 1.
    black, white = np.polyval(_AGX_CURVE, 0.0), np.polyval(_AGX_CURVE, 1.0)
    return to_unit((curved - black) / (white - black) @ np.linalg.inv(inset).T).astype(np.float32)
