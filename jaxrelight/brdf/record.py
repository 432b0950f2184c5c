"""BRDFs as JSON: what a store keeps of a material."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf.ashikhmin_shirley import AshikhminShirley
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum

_KINDS = {kind.__name__: kind for kind in (LobeSum, AshikhminShirley)}


def to_record(brdf: Brdf) -> dict:
    """The kind of a BRDF and its arrays as nested lists, exact for float32."""
    arrays = {field.name: np.asarray(getattr(brdf, field.name)) for field in dataclasses.fields(brdf)}
    return {
        "kind": type(brdf).__name__,
        "arrays": {name: {"shape": list(a.shape), "values": a.ravel().tolist()} for name, a in arrays.items()},
    }


def from_record(record: dict, dtype=jnp.float32) -> Brdf:
    """The BRDF that `to_record` wrote."""
    arrays = {
        name: jnp.asarray(np.reshape(entry["values"], entry["shape"]), dtype)
        for name, entry in record["arrays"].items()
    }
    return _KINDS[record["kind"]](**arrays)
