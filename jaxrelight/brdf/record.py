"""BRDFs as JSON: what a store keeps of a material. Long arrays are kept elsewhere, under a name.

BRDFs of the package go by short names. Those of a class of one's own go by its module and name, and come back where
that module is imported, or where the class was given to `register`; see `jaxrelight.files.class_record`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jax.typing import DTypeLike

from jaxrelight.brdf.adaptive import Adaptive
from jaxrelight.brdf.ashikhmin_shirley import AshikhminShirley
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.parametrisation import PARAMETRISATIONS, name_of
from jaxrelight.brdf.separable import Separable
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.tabulated import Tabulated
from jaxrelight.files.class_record import find_class, from_fields, import_classes, qualified_name, register, to_fields
from jaxrelight.numerics.arrays import as_array

__all__ = ["from_record", "import_classes", "register", "to_record"]

_KINDS = {kind.__name__: kind for kind in (Adaptive, AshikhminShirley, LobeSum, Separable, SpatialLobes, Tabulated)}
# Numbers of an array that JSON is to hold at most.
_LONGEST = 4096


def to_record(brdf: Brdf | SpatialLobes, keep: Callable[[np.ndarray], str], what: str = "the BRDF") -> dict:
    """The class of a BRDF, its arrays, and what else the fields of a class of one's own hold.

    Args:
        brdf: of any class.
        keep: stores a long array, and gives the name that stands in its place; others are lists of numbers, exact.
        what: what messages call it.

    Raises:
        InputError: if a class of one's own has fields that JSON and arrays cannot hold.
    """

    def entry(array: np.ndarray) -> dict:
        if array.size > _LONGEST:
            return {"layer": keep(array)}
        plain = {"shape": list(array.shape), "values": array.ravel().tolist()}
        return plain if array.dtype == np.float32 else plain | {"dtype": str(array.dtype)}

    kind = type(brdf)
    if _KINDS.get(kind.__name__) is not kind:
        fields, arrays = to_fields(brdf, what)
        entries = {name: entry(array) for name, array in arrays.items()}
        return {"kind": qualified_name(kind), "arrays": entries, "fields": fields}
    others = ("coarser", "parametrisation")
    values = {field.name: getattr(brdf, field.name) for field in dataclasses.fields(brdf) if field.name not in others}
    coarser = [to_record(level, keep) for level in getattr(brdf, "coarser", ())]
    entries = {name: entry(np.asarray(array)) for name, array in values.items() if array is not None}
    record = {"kind": kind.__name__, "arrays": entries} | ({"coarser": coarser} if coarser else {})
    if isinstance(brdf, Separable):
        record["parametrisation"] = name_of(brdf.parametrisation)
    return record


def from_record(
    record: dict, kept: Callable[[str], np.ndarray], dtype: DTypeLike | None = None, what: str = "the BRDF"
) -> Brdf | SpatialLobes:
    """The BRDF that `to_record` wrote.

    Args:
        record: of it.
        kept: a long array by its name.
        dtype: of its floating arrays; by default theirs, as far as JAX is set to it.
        what: what messages call it.

    Raises:
        InputError: if its class is not known, see `jaxrelight.files.class_record`, or has other fields now.
    """

    def array(name: str) -> np.ndarray:
        entry = record["arrays"][name]
        if "layer" in entry:
            values = kept(entry["layer"])
        else:
            values = np.reshape(np.asarray(entry["values"], entry.get("dtype", "float32")), entry["shape"])
        return values if dtype is None or values.dtype.kind != "f" else values.astype(dtype)

    if record["kind"] not in _KINDS:
        cls = find_class(record["kind"], (Brdf, SpatialLobes), what)
        return from_fields(cls, record["fields"], array, what)
    arrays: dict[str, Any] = {name: as_array(array(name)) for name in record["arrays"]}
    if "coarser" in record:
        arrays["coarser"] = tuple(from_record(level, kept, dtype) for level in record["coarser"])
    if "parametrisation" in record:
        arrays["parametrisation"] = PARAMETRISATIONS[record["parametrisation"]]
    return _KINDS[record["kind"]](**arrays)
