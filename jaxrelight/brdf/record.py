"""BRDFs as JSON: what a store keeps of a material. Long arrays are kept elsewhere, under a name."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf.adaptive import Adaptive
from jaxrelight.brdf.ashikhmin_shirley import AshikhminShirley
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.separable import Separable
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.tabulated import Tabulated
from jaxrelight.numerics.arrays import as_array

_KINDS = {kind.__name__: kind for kind in (Adaptive, AshikhminShirley, LobeSum, Separable, SpatialLobes, Tabulated)}
# Numbers of an array that JSON is to hold at most.
_LONGEST = 4096


def to_record(brdf: Brdf | SpatialLobes, keep: Callable[[np.ndarray], str]) -> dict:
    """The kind of a BRDF and its arrays: nested lists, exact for float32, or the name that `keep` gives a long one."""

    def entry(array: np.ndarray) -> dict:
        if array.size > _LONGEST:
            return {"layer": keep(array)}
        return {"shape": list(array.shape), "values": array.ravel().tolist()}

    arrays = {field.name: getattr(brdf, field.name) for field in dataclasses.fields(brdf) if field.name != "coarser"}
    coarser = [to_record(level, keep) for level in getattr(brdf, "coarser", ())]
    entries = {name: entry(np.asarray(array)) for name, array in arrays.items() if array is not None}
    return {"kind": type(brdf).__name__, "arrays": entries} | ({"coarser": coarser} if coarser else {})


def from_record(record: dict, kept: Callable[[str], np.ndarray], dtype=jnp.float32) -> Brdf | SpatialLobes:
    """The BRDF that `to_record` wrote; `kept` finds a long array by its name."""

    def array(entry: dict) -> np.ndarray:
        return kept(entry["layer"]) if "layer" in entry else np.reshape(entry["values"], entry["shape"])

    arrays: dict[str, Any] = {name: as_array(array(entry), dtype) for name, entry in record["arrays"].items()}
    if "coarser" in record:
        arrays["coarser"] = tuple(from_record(level, kept, dtype) for level in record["coarser"])
    return _KINDS[record["kind"]](**arrays)
