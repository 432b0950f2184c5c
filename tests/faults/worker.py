"""Loads files one after the other under limits, and says of each what came of it: one line of JSON each.

Run as `python -m tests.faults.worker SECONDS MEBIBYTES`, with a list of paths on standard input. A path is printed
before it is loaded, so whoever reads knows which file a process died of.
"""

import faulthandler
import hashlib
import json
import sys
import warnings
from pathlib import Path

import jax
import numpy as np

from jaxrelight.brdf.files.content import Content
from jaxrelight.brdf.files.cornell import read_pairs
from jaxrelight.brdf.files.load import load_brdf
from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import load_file
from jaxrelight.images import read_image
from jaxrelight.scene.materials import from_file

IMAGES = (".exr", ".hdr", ".png", ".jpg", ".tga", ".webp")


def loaded(path: Path) -> dict:
    """What a file loads as: the arrays' digest and shape, notes, and what is wrong with them."""
    if path.suffix in IMAGES:
        pixels = read_image(path)
        wrong = pixels.dtype != np.float32 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or not pixels.size
        return _told([pixels], (), "not an image" if wrong else "")
    if path.suffix == ".bsdf":
        measured = load_brdf(path)
        return _told_brdf([np.asarray(array) for array in jax.tree.leaves(measured.brdf)], measured.notes)
    if path.suffix == ".brdf":  # without the interpolation, which would take a second for each
        pairs = read_pairs(Content(path))
        return _told_brdf([pairs.omega_i, pairs.omega_o, pairs.values], pairs.notes)
    file = load_file(path)
    mesh, notes = file.mesh, list(file.mesh.notes)
    for part in file.parts:
        _, lines = from_file(part.material, part.uv_sets, coloured=part.mesh.colours is not None)
        notes += lines
    return _told([mesh.vertices, mesh.faces, mesh.normals], notes, _mesh_fault(mesh))


def _told(arrays, notes, wrong: str) -> dict:
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]
    shape = [list(array.shape) for array in arrays]
    return {"outcome": "loaded", "digest": digest, "shape": shape, "notes": list(notes), "wrong": wrong}


def _told_brdf(arrays, notes) -> dict:
    sound = all(np.isfinite(array).all() for array in arrays) and arrays[-1].min() >= 0
    return _told(arrays, notes, "" if sound else "reflectance that is negative or not finite")


def _mesh_fault(mesh) -> str:
    if not len(mesh.faces) or not np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices))):
        return "no faces, or vertices that none uses, or numbers out of range"
    if not np.isfinite(mesh.vertices).all():
        return "vertices that are not finite"
    if not np.allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-9):
        return "normals that are not of unit length"
    return ""


def outcome(path: Path) -> dict:
    """`loaded`, or how the file was refused; any exception but a one-line InputError is wrong."""
    try:
        return loaded(path)
    except InputError as fault:
        message, cause = str(fault), fault.__cause__ or fault.__context__
        wrong = ""
        if not message.startswith(str(path)) or "; " not in message or len(message.splitlines()) != 1:
            wrong = "the message is not one line that names the file and what to do"
        if isinstance(cause, MemoryError):
            wrong = "memory was taken before the file was refused"
        return {"outcome": "refused", "message": message, "wrong": wrong}
    except BaseException as fault:
        return {"outcome": "raised", "wrong": f"{type(fault).__name__}: {fault}"[:300]}


def main():
    """Works through the list."""
    seconds, mebibytes = float(sys.argv[1]), int(sys.argv[2])
    paths = json.load(sys.stdin)
    warnings.simplefilter("error")
    _warm_up()
    _limit_memory(mebibytes)
    for path in paths:
        print(path, flush=True)
        faulthandler.dump_traceback_later(seconds, exit=True)
        result = outcome(Path(path))
        faulthandler.cancel_dump_traceback_later()
        print(json.dumps(result), flush=True)


def _warm_up():
    """Imports what loaders import late, so that the limit is about files alone."""
    import OpenEXR  # noqa: F401
    import PIL.JpegImagePlugin
    import PIL.PngImagePlugin  # noqa: F401
    import trimesh.exchange.obj
    import trimesh.exchange.ply
    import trimesh.exchange.stl  # noqa: F401

    jax.block_until_ready(jax.numpy.asarray(np.zeros((2, 2), np.float32)))


def _limit_memory(mebibytes: int):
    """Bounds the address space to what there is now and so much more, where the system lets it be bounded."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + mebibytes * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError):
        pass


if __name__ == "__main__":
    main()
