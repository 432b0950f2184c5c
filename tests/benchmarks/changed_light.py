"""Small changes of light, many lights at once, and light in 16 bits (Wang 2006 §4.3): what is to be gained by each.

Light terms of a changed light are those before and the operator's product with the difference. Of clusters, only the
columns of coefficients that changed need be read, and only the weights of groups that hold one.
"""

import argparse
import contextlib
import functools
import pathlib
import tempfile
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.operators.clustered import Bucket, Clustered
from jaxrelight.operators.quantised import decoded
from tests.benchmarks.measuring import Report, interleaved, shared
from tests.benchmarks.quantised_rows import LIGHTS

SCENE = "bunny_lambert"
# Elevation and turn of the regions that change, in degrees from the map's upper left corner.
AT = 45, 100


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.changed_light", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 8 and few runs; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    arguments = parser.parse_args()
    shared("reference")
    quick = arguments.quick
    resolution, runs = (8, 3) if quick else (64, 31)
    parameters = (
        f"{SCENE} at vertices, resolution {resolution}; clusters of tolerance 0.02, rows of N = 128, float32; "
        f"{runs} interleaved runs, ratios are their medians"
    )
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        report = stack.enter_context(
            Report("changed_light", "Small changes of light, many lights, and light in 16 bits", parameters, not quick)
        )
        ways = {"clusters": "shared", "rows": 128}
        relighters = {way: _relighter(folder / way, kept, resolution) for way, kept in ways.items()}
        changes(report, relighters["clusters"], runs)
        many(report, relighters, (2, 8) if quick else (2, 8, 64), max(runs // 6, 3))
        sixteen_bits(report, relighters, runs)
        report.speed()


def _relighter(folder: pathlib.Path, coefficients, resolution: int) -> TransportRelighter:
    from jaxrelight import Transport, load_scene, prepare

    scene = load_scene(shared("reference", f"{SCENE}.toml"))
    relighter = prepare(
        scene, Transport("vertices", reflection="factors", resolution=resolution, coefficients=coefficients), folder
    )
    assert isinstance(relighter, TransportRelighter)
    return relighter


# Changes of light


class Touched(NamedTuple):
    """Of one bucket, what changed coefficients meet; all filled up to powers of two, so that few shapes compile.

    Attributes:
        group: of every place of a changed coefficient.
        position: in that group's support.
        nth: the group, among those touched.
        difference: of the light there; 0 where it is filling.
        touched: groups that hold a changed coefficient.
        rows: where they are among all groups; past their end where it is filling.
    """

    group: Int[np.ndarray, " e"]
    position: Int[np.ndarray, " e"]
    nth: Int[np.ndarray, " e"]
    difference: Float[np.ndarray, "e 3"]
    touched: Int[np.ndarray, " t"]
    rows: Int[np.ndarray, " t"]


class Index:
    """Finds the places of columns in all supports, on the host, by what the transpose sums over."""

    def __init__(self, operator: Clustered):
        self._holders = [np.asarray(places) for places in operator.holders]
        self._column_place = np.asarray(operator.column_place)
        self._buckets = [(part.support.shape, np.asarray(part.groups)) for part in operator.buckets]
        self._end = sum(b * s for (b, s), _ in self._buckets)
        self._groups = len(operator.place)

    def touched(self, difference: Float[np.ndarray, "d 3"], changed: Bool[np.ndarray, " d"]) -> list[Touched]:
        """What a change of light meets, by bucket."""
        columns = np.flatnonzero(changed)
        row, start, places, of = self._column_place[columns], 0, [np.zeros(0, int)], [np.zeros(0, int)]
        for held in self._holders:
            mine = (row >= start) & (row < start + len(held))
            holders = held[row[mine] - start]
            real = holders < self._end
            places.append(holders[real])
            of.append(np.broadcast_to(columns[mine, None], holders.shape)[real])
            start += len(held)
        place, column = np.concatenate(places), np.concatenate(of)
        out, start = [], 0
        for (b, s), groups in self._buckets:
            mine = (place >= start) & (place < start + b * s)
            group, position = np.divmod(place[mine] - start, s)
            touched, nth = np.unique(group, return_inverse=True)
            e, t = _power(len(group)), _power(len(touched))
            group, position, nth = (_filled(array, e) for array in (group, position, nth))
            rows = _filled(groups[touched], t, self._groups)
            out.append(Touched(group, position, nth, _filled(difference[column[mine]], e), _filled(touched, t), rows))
            start += b * s
        return out


def _power(count: int) -> int:
    return 1 << max(count - 1, 0).bit_length()


def _filled(array: np.ndarray, length: int, fill: int = 0) -> np.ndarray:
    from jaxrelight.numerics.buckets import filled_up

    return filled_up(array, length, fill)


def _updated(operator: Clustered, terms: Float[Array, "r c"], touched: list[Touched]) -> Float[Array, "r c"]:
    """Light terms after a change: sums of changed columns by group, and weights of the groups touched."""
    import jax

    by_group = terms.reshape(-1, operator.group_rows, terms.shape[1])
    for part, met in zip(operator.buckets, touched, strict=True):
        columns = decoded(part.basis)[met.group, :, met.position]
        # places e, shared rows q, channels c
        shared_rows = jax.ops.segment_sum(columns[:, :, None] * met.difference[:, None], met.nth, len(met.touched))
        by_group = by_group.at[met.rows].add(_weighted(part, met.touched, shared_rows), mode="drop")
    return by_group.reshape(terms.shape)


def _weights_alone(
    operator: Clustered, terms: Float[Array, "r c"], shared_rows: list[Float[Array, "b q c"]]
) -> Float[Array, "r c"]:
    """The same where shared rows of all groups are given: what is left if changed columns cost nothing."""
    import jax.numpy as jnp

    by_group = terms.reshape(-1, operator.group_rows, terms.shape[1])
    for part, rows in zip(operator.buckets, shared_rows, strict=True):
        by_group = by_group.at[part.groups].add(_weighted(part, jnp.arange(len(part.groups)), rows), mode="drop")
    return by_group.reshape(terms.shape)


def _weighted(
    part: Bucket, chosen: Int[Array | np.ndarray, " t"], shared_rows: Float[Array, "t q c"]
) -> Float[Array, "t r c"]:
    import jax.numpy as jnp

    return jnp.einsum("tqr,tqc->trc", decoded(part.weights)[chosen, 0], shared_rows, precision="highest")


def changes(report: Report, relighter, runs: int):
    """Time of light terms after a change, from those before or anew."""
    import jax
    import jax.numpy as jnp

    operators = relighter.transport.operator.operators
    before, after = _lights(relighter)
    apply = jax.jit(lambda operators, light: [operator.apply(light) for operator in operators])
    update = jax.jit(lambda *parts: [_updated(*part) for part in zip(*parts, strict=True)])
    weights = jax.jit(lambda *parts: [_weights_alone(*part) for part in zip(*parts, strict=True)])
    terms, indices = apply(operators, jnp.asarray(before)), [Index(operator) for operator in operators]
    given = [[jnp.ones((*part.basis.shape[:2], 3)) for part in operator.buckets] for operator in operators]
    groups = sum(len(part.groups) for operator in operators for part in operator.buckets)
    places = sum(part.support.size for operator in operators for part in operator.buckets)
    table = []
    for name, light in after.items():

        def prepared(light=light):
            difference = light - before
            return [index.touched(difference, np.any(difference, axis=1)) for index in indices]

        met = prepared()
        on_device, vector = jax.device_put(met), jnp.asarray(light)
        sides = {
            "apply": lambda vector=vector: apply(operators, vector),
            "changed": lambda on_device=on_device: update(operators, terms, on_device),
            "weights": lambda: weights(operators, terms, given),
            "host": prepared,
        }
        whole, updated = (np.concatenate(sides[side]()) for side in ("apply", "changed"))
        times = interleaved(sides, runs)
        entries = sum(int(part.difference.any(axis=1).sum()) for of in met for part in of)
        touched = sum(
            int((part.rows < len(operator.place)).sum())
            for operator, of in zip(operators, met, strict=True)
            for part in of
        )
        table.append(
            [
                name,
                f"{(light != before).any(axis=1).sum():,}",
                f"{entries:,}",
                touched,
                f"{_relative(updated, whole):.0e}",
                *(times[side] for side in sides),
                *(f"{times['apply'].over(times[side]):.2f}" for side in ("changed", "weights")),
            ]
        )
    report.text(
        f"**Changed coefficients alone**, clusters, both materials: {groups} groups, which hold {places:,} "
        "coefficients with filling. *Changed*: the product with columns of changed coefficients, added to the terms "
        "before. *Weights alone*: the same where changed columns cost nothing. *On the host*: finding the columns and "
        "their places, which is not in *changed*. *Error* is relative L2 to apply. An option would need 1.3. Coarse "
        "coefficients change with every light and are in nearly all groups, so that all weights are read and all "
        "terms written, which takes most of the time of apply. Rows have no lists of who holds a column: of a "
        "difference, they read as much as of a light."
    )
    heads = ["change", "coefficients", "places", "groups", "error", "apply", "changed", "weights alone", "on the host"]
    report.table([*heads, "apply / changed", "apply / weights alone"], table)


def _lights(relighter) -> tuple[Float[np.ndarray, "d 3"], dict[str, Float[np.ndarray, "d 3"]]]:
    """A light vector and those of changes to it."""
    import jax.numpy as jnp

    from jaxrelight import load_environment
    from jaxrelight.lights.environment import coarsened

    file, scale = LIGHTS["sunset"]
    whole = load_environment(shared("data", "env", file)).pixels
    pixels = np.asarray(coarsened(whole, relighter.method.resolution))
    height, width = pixels.shape[:2]

    def with_region(degrees: float, factor: float, radiance: float):
        top, left = round(AT[0] / 180 * height), round(AT[1] / 360 * width)
        rows, columns = (max(1, round(degrees / turn * size)) for turn, size in ((180, height), (360, width)))
        changed = pixels.copy()
        changed[top : top + rows, left : left + columns] *= factor
        changed[top : top + rows, left : left + columns] += radiance
        return changed

    def vector(of: np.ndarray, degrees: float = 0.0):
        return np.asarray(relighter.light_vector(jnp.asarray(of), degrees, scale))

    return vector(pixels), {
        "a region of 3° switched on": vector(with_region(3, 1, 100)),
        "a window of 10° twice as bright": vector(with_region(10, 2, 0)),
        "all turned by 1°": vector(pixels, 1.0),
    }


# Many lights


def many(report: Report, relighters, counts: Sequence[int], runs: int):
    """Time of products with many lights: at once, as vmap batches them, and one after the other."""
    import jax
    import jax.numpy as jnp

    at_once = jax.jit(lambda operator, lights: operator.apply_many(lights))
    batched = jax.jit(lambda operator, lights: jax.vmap(operator.apply)(lights))
    apply = jax.jit(lambda operator, light: operator.apply(light))
    table = []
    for way, relighter in relighters.items():
        (operator,) = (block.operator for block in relighter.transport.blocks if block.material == "object")
        for n in counts:
            lights = jnp.asarray(np.random.default_rng(0).normal(size=(n, operator.shape[1], 3)), jnp.float32)
            sides = {
                "apply, one by one": lambda lights=lights, operator=operator: [apply(operator, x) for x in lights],
                "vmap": functools.partial(batched, operator, lights),
                "at once": functools.partial(at_once, operator, lights),
            }
            times = interleaved(sides, runs, 1)
            ratios = (f"{times[side].over(times['at once']):.2f}" for side in ("apply, one by one", "vmap"))
            table.append([f"{way}, {n} lights", *times.values(), *ratios])
    report.text(
        "**Many lights of three channels**, the object, grey. Fewer than 8 are batched by vmap where rows are applied: "
        "steps of a few rows cost more than they save. For coloured rows see `clusters`."
    )
    report.table(["what", "one by one", "vmap", "apply_many", "one by one / this", "vmap / this"], table)


# Light in 16 bits


def sixteen_bits(report: Report, relighters, runs: int):
    """Error and time of products that gather codes."""
    import jax
    import jax.numpy as jnp

    from jaxrelight.basis.haar import levels
    from tests.benchmarks.quantised_rows import light_vector

    resolution = relighters["rows"].method.resolution
    lights = {name: light_vector(*light, resolution) for name, light in LIGHTS.items()}
    levels_of = {"a scale per level": levels(resolution), "one scale": np.zeros(6 * resolution**2, int)}
    apply = jax.jit(lambda operators, light: [operator.apply(light) for operator in operators])
    table = []
    for way, relighter in relighters.items():
        operators = relighter.transport.operator.operators

        def terms(light, operators=operators):
            return np.concatenate(apply(operators, jnp.asarray(light)))

        errors = {
            name: [_relative(terms(_rounded(light, level)[1]), terms(light)) for light in lights.values()]
            for name, level in levels_of.items()
        }
        whole = lights["sunset"]
        inputs = {"float32": whole, "codes": _rounded(whole, levels_of["one scale"])[0]}
        sides = {name: functools.partial(apply, operators, jnp.asarray(light)) for name, light in inputs.items()}
        times = interleaved(sides, runs)
        for name, key in (("float32", "float32"), ("16 bits, one scale", "codes")):
            off = ["", ""] if key == "float32" else [_of(errors[which]) for which in levels_of]
            table.append([f"{way}, light in {name}", *off, times[key], f"{times['float32'].over(times[key]):.2f}"])
    report.text(
        "**Light in 16 bits**: the time is that of gathering codes, with one scale for each channel that is a factor "
        "on what comes out. That is the most to gain: scales by level would be gathered too, as many bytes as light "
        "in float32. Errors are relative L2 of the terms, by light: " + ", ".join(lights) + "."
    )
    report.table(["what", "error, a scale per level", "error, one scale", "time", "float32 / this"], table)


def _rounded(
    light: Float[np.ndarray, "d c"], level: Int[np.ndarray, " d"]
) -> tuple[Int[np.ndarray, "d c"], Float[np.ndarray, "d c"]]:
    """Codes of 16 bits, a scale for each level and channel, and what they stand for."""
    from jaxrelight.operators.quantised import quantised

    codes, rounded = np.zeros(light.shape, np.int16), np.zeros_like(light)
    for one in np.unique(level):
        coded = quantised(np.ascontiguousarray(light[level == one].T), 16)
        codes[level == one], rounded[level == one] = np.asarray(coded.codes).T, np.asarray(coded.decoded()).T
    return codes, rounded


def _relative(actual: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(actual - wanted) / np.linalg.norm(wanted))


def _of(errors: list[float]) -> str:
    return ", ".join(f"{100 * error:.3f}" for error in errors) + " %"


if __name__ == "__main__":
    main()
