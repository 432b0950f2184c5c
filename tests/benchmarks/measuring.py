"""What every benchmark program needs: timers, the machine's own speeds, child processes, and RESULTS.md."""

import concurrent.futures
import dataclasses
import datetime
import functools
import importlib.metadata
import itertools
import json
import os
import pathlib
import platform
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

RESULTS = pathlib.Path(__file__).with_name("RESULTS.md")
ROOT = pathlib.Path(__file__).resolve().parents[2]
THREADS = os.cpu_count() or 1

# A list of calls, each of prepared origins and directions [r, 3], float32 and contiguous.
Calls = Sequence[tuple[Float[np.ndarray, "r 3"], Float[np.ndarray, "r 3"]]]


def shared(*parts: str) -> pathlib.Path:
    """Path below the shared folder: `$JAXRELIGHT_SHARED`, else `../shared` beside the repository.

    Ends the program with one line, and success, where the file is absent.
    """
    path = pathlib.Path(os.environ.get("JAXRELIGHT_SHARED") or ROOT.parent / "shared", *parts)
    if not path.exists():
        print(f"skipped: {'/'.join(parts)} is absent; set JAXRELIGHT_SHARED to the shared data folder")
        sys.exit(0)
    return path


# Time


@dataclasses.dataclass(frozen=True)
class Timing:
    """Seconds of several runs of the same thing, in the order they were taken."""

    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """The middle one."""
        return statistics.median(self.seconds)

    @property
    def least(self) -> float:
        """The shortest one."""
        return min(self.seconds)

    def over(self, other: "Timing") -> float:
        """How many times as long as another that was interleaved with it: the median of the rounds' ratios."""
        return statistics.median(a / b for a, b in zip(self.seconds, other.seconds, strict=True))

    def __str__(self):
        scale, digits = (1e3, 2) if self.median < 0.1 else (1e3, 0) if self.median < 1 else (1, 2)
        unit = "ms" if scale == 1e3 else "s"
        return f"{self.median * scale:.{digits}f} {unit} (min {self.least * scale:.{digits}f})"


def interleaved(sides: Mapping[str, Callable[[], object]], runs: int, warm_ups: int = 2) -> dict[str, Timing]:
    """Times functions in turn, A B A B …, so that a drift of the machine meets all of them alike.

    Results that JAX computes later are waited for.
    """
    import jax

    seconds: dict[str, list[float]] = {name: [] for name in sides}
    for run in range(-warm_ups, runs):
        for name, function in sides.items():
            start = time.perf_counter()
            jax.block_until_ready(function())
            if run >= 0:
                seconds[name].append(time.perf_counter() - start)
    return {name: Timing(tuple(values)) for name, values in seconds.items()}


def in_threads(function: Callable[[int], object], count: int, threads: int = THREADS):
    """Runs function(i) for all i below count, each when a thread is free."""
    if threads == 1:
        for i in range(count):
            function(i)
        return
    for _ in _pool(threads).map(function, range(count)):
        pass


@functools.cache
def _pool(threads: int) -> concurrent.futures.ThreadPoolExecutor:
    """Threads that are there already, so that starting them is not measured."""
    return concurrent.futures.ThreadPoolExecutor(threads)


# The machine


def copy_rate(threads: int, runs: int = 7) -> float:
    """Bytes read and written per second by copies of 256 MB, the best of several."""
    source = np.ones((threads, 2**26 // threads), np.float32)
    target = np.zeros_like(source)
    best = min(
        _seconds(lambda: in_threads(lambda i: np.copyto(target[i], source[i]), threads, threads)) for _ in range(runs)
    )
    return 2 * source.nbytes / best


def fire(scene, calls: Calls, threads: int = THREADS):
    """Bare embree calls, each thread its own share of them."""

    def share(thread: int):
        for origins, directions in calls[thread::threads]:
            scene.run(origins, directions, query="OCCLUDED")

    in_threads(share, threads, threads)


@dataclasses.dataclass(frozen=True)
class Rays:
    """Visibility rays of some groups of receivers, prepared for bare calls.

    Attributes:
        scene: embree's.
        origins: lifted off the surface, float32.
        directions: those above the shading normal.
        receiver_ends: where each receiver's rays end.
    """

    scene: object
    origins: Float[np.ndarray, "r 3"]
    directions: Float[np.ndarray, "r 3"]
    receiver_ends: np.ndarray

    @property
    def count(self) -> int:
        """Number of rays."""
        return len(self.origins)

    def by_receiver(self) -> Calls:
        """One call for each receiver: about half the texels of a cube map."""
        return self._split([0, *self.receiver_ends])

    def by_receivers(self, together: int) -> Calls:
        """One call for several receivers."""
        return self._split([0, *self.receiver_ends[together - 1 : -1 : together], self.receiver_ends[-1]])

    def by_thread(self, threads: int = THREADS) -> Calls:
        """One call for each thread."""
        return self._split(np.linspace(0, self.count, threads + 1).astype(int))

    def _split(self, cuts) -> Calls:
        return [(self.origins[a:b], self.directions[a:b]) for a, b in itertools.pairwise(cuts)]

    def rate(self, runs: int = 3) -> float:
        """Rays per second of bare calls on all cores: the best of several runs, with small and with large calls."""
        ways = self.by_receiver(), self.by_receivers(32), self.by_thread()
        fire(self.scene, ways[0])
        every = (_seconds(lambda calls=calls: fire(self.scene, calls)) for _ in range(runs) for calls in ways)
        return self.count / min(every)


def prepare_rays(tracer, points: Sequence[np.ndarray], resolution: int) -> Rays:
    """The rays that the visibility stage traces at a cube-map resolution.

    Receivers are given by origins of rays and normals, each [m, 3].
    """
    from jaxrelight.basis import cubemap

    origins, normals = points
    vectors = cubemap.directions(resolution).astype(np.float32)
    lifted = np.asarray(origins, np.float32)
    by_axis = np.ascontiguousarray(vectors.T)  # as the stage has them, so that the same few are rounded to 0
    above = [np.flatnonzero(normal @ by_axis > 0) for normal in np.asarray(normals, np.float32)]
    counts = np.array([len(rays) for rays in above])
    return Rays(tracer._scene, np.repeat(lifted, counts, axis=0), vectors[np.concatenate(above)], np.cumsum(counts))


@functools.cache
def scene_rays(path: pathlib.Path, resolution: int = 64, receivers: int = 256, seed: int = 0) -> Rays:
    """Rays of a random sample of a scene's vertices."""
    import jaxrelight
    from jaxrelight.geometry.receivers import vertex_receivers
    from jaxrelight.geometry.surfaces import join
    from jaxrelight.geometry.tracer import Tracer

    surfaces = join([part.mesh for part in jaxrelight.load_scene(path).parts])
    every = vertex_receivers(surfaces, np.zeros(int(surfaces.mesh_of_vertex.max()) + 1, int))
    chosen = np.sort(np.random.default_rng(seed).choice(every.slot_of, receivers, replace=False))
    points = [values.reshape(-1, 3)[chosen] for values in (every.origins, every.normals)]
    return prepare_rays(Tracer(surfaces), points, resolution)


def machine_speed(rays: Rays | None = None) -> str:
    """One line that stands beside times: memory bandwidth and bare embree rate, measured now."""
    rays = rays or scene_rays(shared("reference", "bunny_lambert.toml"))
    copies = f"{copy_rate(1) / 1e9:.1f} GB/s with 1 thread, {copy_rate(THREADS) / 1e9:.1f} with {THREADS}"
    return f"memory copy (read + written) {copies}; bare embree {rays.rate() / 1e6:.2f} Mrays/s with {THREADS} threads"


def machine_name() -> str:
    """Processor, cores, date and versions."""
    info = pathlib.Path("/proc/cpuinfo")
    match = re.search(r"model name\s*:\s*(.+)", info.read_text()) if info.exists() else None
    packages = "jaxrelight", "jax", "numpy", "scipy", "PyWavelets", "embreex", "zstandard"
    versions = ", ".join(f"{name} {_version(name)}" for name in packages)
    today = datetime.datetime.now(datetime.UTC).date()
    cpu = match[1].strip() if match else platform.processor() or platform.machine()
    return f"{today}, {cpu}, {THREADS} cores, Python {platform.python_version()}, {versions}"


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def _seconds(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


# Child processes


def peak_memory() -> int:
    """Largest resident bytes of this process so far.

    From /proc where it exists: `getrusage` also counts what the parent held when it started the child.
    """
    status = pathlib.Path("/proc/self/status")
    match = re.search(r"VmHWM:\s*(\d+) kB", status.read_text()) if status.exists() else None
    if match:
        return int(match[1]) * 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def resident_memory() -> int:
    """Bytes that this process holds now, from /proc."""
    match = re.search(r"VmRSS:\s*(\d+) kB", pathlib.Path("/proc/self/status").read_text())
    assert match
    return int(match[1]) * 1024


def run_child(module: str, *arguments: str, variables: Mapping[str, str] | None = None) -> dict:
    """What a fresh process that runs `python -m module arguments` returns with `answer`.

    Args:
        module: run as a program.
        arguments: its own.
        variables: of its environment, beside those of this process.

    Raises:
        RuntimeError: if it fails.
    """
    command = [sys.executable, "-m", module, *arguments]
    env = os.environ | dict(variables or {})
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False, env=env)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command[1:])} ended with {done.returncode}")
    return json.loads(done.stdout.splitlines()[-1])


def answer(values: Mapping):
    """Hands values, and the peak memory so far, to the parent of this process."""
    print(json.dumps({**values, "peak_memory": peak_memory()}))


# Reports


class Report:
    """One program's section of RESULTS.md, printed while it is made.

    Use as a context manager: the section is written at the end, and only if nothing failed. A program that writes
    several sections tells them apart by `part`.
    """

    def __init__(self, name: str, title: str, parameters: str, write: bool = True, part: str = ""):
        self._name, self._write, self._lines = name + part, write, []
        self.text(f"## {title}")
        self.text(f"`python -m tests.benchmarks.{name}` · {parameters}")
        self.text(machine_name())

    def text(self, line: str):
        """A paragraph."""
        self._add(line)

    def table(self, heads: Sequence[str], rows: Sequence[Sequence[object]]):
        """A table; the first column is text, the others are set to the right."""
        cells = [[str(cell) for cell in row] for row in (heads, *rows)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(heads))]
        lines = [
            "| " + " | ".join(c.rjust(w) if i else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
            + " |"
            for row in cells
        ]  # fmt: skip
        rule = "|" + "|".join("-" * (w + 1) + (":" if i else "-") for i, w in enumerate(widths)) + "|"
        self._add("\n".join([lines[0], rule, *lines[1:]]))

    def speed(self, rays: Rays | None = None):
        """The machine's speeds, now."""
        self.text(f"The machine at this moment: {machine_speed(rays)}.")

    def _add(self, block: str):
        print(block, end="\n\n", flush=True)
        self._lines.append(block)

    def __enter__(self) -> "Report":
        return self

    def __exit__(self, kind, *_):
        if kind is None and self._write:
            write_section(self._name, "\n\n".join(self._lines))


def write_section(name: str, text: str, path: pathlib.Path = RESULTS):
    """Replaces the section between `<!-- name -->` and `<!-- /name -->`, or adds it at the end."""
    old = path.read_text(encoding="utf-8") if path.exists() else "# Results of the benchmark programs\n"
    section = f"<!-- {name} -->\n\n{text}\n\n<!-- /{name} -->"
    pattern = re.compile(rf"<!-- {name} -->.*?<!-- /{name} -->", re.DOTALL)
    new = pattern.sub(lambda _: section, old) if pattern.search(old) else f"{old.rstrip()}\n\n{section}\n"
    partial = path.with_suffix(".partial")
    partial.write_text(new, encoding="utf-8")
    partial.replace(path)


def percent(share: float) -> str:
    """A share in percent, two digits behind the point."""
    return f"{100 * share:.2f} %"


def megabytes(count: float) -> str:
    """Bytes in millions."""
    return f"{count / 1e6:.1f} MB"


def blocks(count: int, size: int) -> Iterator[slice]:
    """Slices of a given size, the last one shorter."""
    return (slice(start, min(start + size, count)) for start in range(0, count, size))
