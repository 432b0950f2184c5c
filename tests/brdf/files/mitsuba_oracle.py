"""Writes `mitsuba_oracle.json`: what Mitsuba 3's `measured` plugin makes of some files.

Run as `python -m tests.brdf.files.mitsuba_oracle FILE.bsdf …` by a Python that has mitsuba and numpy.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.brdf.files import writers

MADE = {"isotropic": {"azimuths": 1, "seed": 1}, "half a circle": {"azimuths": 5, "seed": 2}}


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs all over the hemisphere, half of them near the mirror direction."""
    chance = np.random.default_rng(0)
    pair = chance.normal(size=(2, count, 3))
    pair[0, ::2] = pair[1, ::2] * [-1, -1, 1] + 0.3 * chance.normal(size=(len(pair[0, ::2]), 3))
    pair[..., 2] = np.abs(pair[..., 2]) + 0.05
    omega_i, omega_o = (pair / np.linalg.norm(pair, axis=-1, keepdims=True)).round(5)
    return omega_i, omega_o


def main():
    """Evaluates all files at the same pairs."""
    import mitsuba  # pyright: ignore[reportMissingImports]

    mitsuba.set_variant("scalar_rgb")
    omega_i, omega_o = directions(120)

    def values(path: str) -> list[list[float]]:
        plugin = mitsuba.load_dict({"type": "measured", "filename": path})
        rows = []
        for i, o in zip(omega_i, omega_o, strict=True):
            seen = mitsuba.SurfaceInteraction3f()
            seen.wi = mitsuba.Vector3f(*o)
            rows.append([float(f"{x:.6g}") for x in plugin.eval(mitsuba.BSDFContext(), seen, mitsuba.Vector3f(*i))])
        return rows

    by_file = {Path(name).name: values(name) for name in sys.argv[1:]}
    with tempfile.TemporaryDirectory() as folder:
        for name, made in MADE.items():
            path = Path(folder, "made.bsdf")
            path.write_bytes(writers.rgl(**made))
            by_file[name] = values(str(path))
    content = {"omega_i": omega_i.tolist(), "omega_o": omega_o.tolist(), "made": MADE, "values": by_file}
    lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in content.items())
    Path(__file__).with_suffix(".json").write_text("{" + lines + "}\n")


if __name__ == "__main__":
    main()
