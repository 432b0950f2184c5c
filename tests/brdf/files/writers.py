"""Files of measured reflectance, written by code."""

import struct

import numpy as np

_TYPES = {"uint8": 1, "float32": 10}


def tensor_file(fields: dict[str, np.ndarray]) -> bytes:
    """A container of named arrays, each at a multiple of eight bytes."""
    header = 18 + sum(13 + len(name) + 8 * array.ndim for name, array in fields.items())
    entries, body = b"", b"\0" * (-header % 8)
    for name, array in fields.items():
        kind = _TYPES[str(array.dtype)]
        entries += struct.pack("<H", len(name)) + name.encode()
        entries += struct.pack(f"<HBQ{array.ndim}Q", array.ndim, kind, header + len(body), *array.shape)
        body += array.tobytes() + b"\0" * (-array.nbytes % 8)
    return b"tensor_file\0" + struct.pack("<2BI", 1, 0, len(fields)) + entries + body


def rgl_fields(azimuths: int = 1, seed: int = 0, size: int = 6) -> dict[str, np.ndarray]:
    """Fields of a material of random numbers; of several azimuths over a half of the circle where asked."""
    chance = np.random.default_rng(seed)
    phi = np.linspace(-np.pi, 0, azimuths) if azimuths > 1 else np.zeros(1)
    theta = np.array([0.0, 0.5, 1.0, 1.5])
    many = azimuths, len(theta)
    fields = {
        "phi_i": phi,
        "theta_i": theta,
        # An isotropic surface shows as much of itself from all azimuths.
        "sigma": np.repeat(chance.uniform(0.5, 1, (1, 9)), 2, 0) if azimuths == 1 else chance.uniform(0.5, 1, (5, 9)),
        "ndf": chance.uniform(0.2, 2, (3, 8)),
        "vndf": chance.uniform(0.1, 1, (*many, size + 2, size + 1)),
        "luminance": chance.uniform(0.1, 1, (*many, size, size)),
        "rgb": chance.uniform(0.1, 1, (*many, 3, size, size)),
    }
    described = {"description": np.frombuffer(b"made by code", np.uint8), "jacobian": np.ones(1, np.uint8)}
    return {name: array.astype(np.float32) for name, array in fields.items()} | described


def rgl(azimuths: int = 1, seed: int = 0, size: int = 6, scale: float = 1) -> bytes:
    """A whole file of `rgl_fields`, its reflectance scaled; without, it reflects more light than it gets."""
    fields = rgl_fields(azimuths, seed, size)
    return tensor_file({**fields, "rgb": fields["rgb"] * np.float32(scale)})


def merl(values: np.ndarray, dimensions: tuple[int, int, int] = (90, 90, 180)) -> bytes:
    """A table [h, d, p, 3] of reflectance."""
    scaled = np.asarray(values, float) / (np.array([1.0, 1.15, 1.66]) / 1500)
    return np.array(dimensions, "<i4").tobytes() + np.moveaxis(scaled, -1, 0).astype("<f8").tobytes()


def cornell(angles: np.ndarray, spectra: np.ndarray, wavelengths: np.ndarray, end: str = "\n") -> bytes:
    """Angles [n, 4] and spectra [n, w]."""
    lines = ["# made by code", "", "# num wls", str(len(wavelengths)), "", "# wls"]
    lines += [" ".join(f"{w:g}" for w in wavelengths), "", "# theta i, phi i, theta s, phi_s, values", ""]
    lines += [" ".join(f"{x:.6f}" for x in row) for row in np.concatenate([angles, spectra], axis=1)]
    return (end.join(lines) + end).encode()


def cornell_pairs(count: int = 60, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(angles, spectra, wavelengths) of pairs anywhere above the surface: a soft lobe over a reddish base."""
    chance = np.random.default_rng(seed)
    angles = np.stack(
        [chance.uniform(low, high, count) for low, high in ((0.05, 1.4), (0, 0), (0.05, 1.4), (-3, 3))], 1
    )
    wavelengths = np.arange(400.0, 701, 20)
    base = 0.05 + 0.2 * (wavelengths > 580)
    i, o = (
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
        for t, p in (angles[:, :2].T, angles[:, 2:].T)
    )
    lobe = np.maximum(np.sum(i * [-1, -1, 1] * o, axis=1), 0) ** 3
    return angles, base + 0.3 * lobe[:, None], wavelengths
