"""Compiled programs kept from one process to the next: JAX's persistent compilation cache, in the user's cache folder.

The command line keeps them unless told otherwise; the library does when it is asked to:

    import jaxrelight as jr
    jr.keep_compilations()

The environment variable JAXRELIGHT_COMPILATION_CACHE names another folder, or is `off`. A user's own choice of
`jax_compilation_cache_dir` or JAX_COMPILATION_CACHE_DIR stands. The folder may be deleted at any time. Compiled
programs are code that is run: nobody else should be able to write there.
"""

import hashlib
import os
import pathlib
import platform
import sys
import tempfile
import warnings

VARIABLE = "JAXRELIGHT_COMPILATION_CACHE"


def keep_compilations(folder: str | os.PathLike | None = None) -> pathlib.Path | None:
    """Has JAX look for compiled programs in a folder, and keep new ones there, from the next compilation on.

    Best called before JAX compiles anything: JAX opens a cache once. A folder that cannot be used, or files
    in it that were cut, cost time and nothing else. JAX keeps no checksum of its programs, so other damage may show.

    Args:
        folder: by default that of JAXRELIGHT_COMPILATION_CACHE, else one in the user's cache folder for this kind of
            processor.

    Returns:
        The folder that is used; None where compilations are not kept: JAXRELIGHT_COMPILATION_CACHE is `off`, or the
        folder cannot be written to.
    """
    chosen = _own_choice()
    if chosen:
        return pathlib.Path(chosen)
    wanted = folder or os.environ.get(VARIABLE) or _default_folder()
    if str(wanted).lower() == "off":
        return None
    path = pathlib.Path(wanted).expanduser().absolute()
    if not _writable(path):
        return None
    # Most of our programs compile in less than the second that is JAX's default for keeping one.
    _configure({"jax_compilation_cache_dir": str(path), "jax_persistent_cache_min_compile_time_secs": 0.0})
    # What is damaged is compiled again; there is nothing for a user to mend.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    return path


def _own_choice() -> str | None:
    """The cache that the user told JAX to use."""
    if "jax" in sys.modules:
        return sys.modules["jax"].config.jax_compilation_cache_dir
    return os.environ.get("JAX_COMPILATION_CACHE_DIR")


def _configure(options: dict):
    if "jax" in sys.modules:
        for name, value in options.items():
            sys.modules["jax"].config.update(name, value)
    else:
        # JAX reads them when it is imported, which is left to whoever needs it.
        os.environ.update({name.upper(): str(value) for name, value in options.items()})


def _default_folder() -> pathlib.Path:
    """A folder for each kind of processor: programs hold its instructions, and machines may share a home folder."""
    import platformdirs

    info = pathlib.Path("/proc/cpuinfo")
    lines = info.read_text(errors="replace").splitlines() if info.exists() else []
    kind = [line for line in lines if line.startswith(("flags", "Features"))][:1] or [platform.processor()]
    name = hashlib.sha256("".join([platform.machine(), *kind]).encode()).hexdigest()[:16]
    return platformdirs.user_cache_path("jaxrelight", appauthor=False) / "compiled" / name


def _writable(path: pathlib.Path) -> bool:
    try:
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryFile(dir=path):
            return True
    except OSError:
        return False
