"""The keys of summaries, down to numbers and texts; `*` stands for names that the scene gives."""

import dataclasses

from jaxrelight.methods import METHODS
from jaxrelight.precomputation.account import Account

DIALS_OF = {name: {field.name for field in dataclasses.fields(kind)} for name, kind in METHODS.items()}
_NAMED = "terms", "channels", "materials", "meshes", "filtered_lobes", "parts", "sensors", "report"


def _of_group(name: str, *keys: str) -> set[str]:
    return {f"{name}.{key}" for key in keys}


def _lit(lighting: str) -> set[str]:
    versions = _of_group("versions", "jaxrelight", "jax", "embreex")
    return {"command", "lighting"} | versions | _of_group("settings", *DIALS_OF[lighting])


STORE = {"store", "receivers", "operator_bytes", "kept_energy"}
BUILD = STORE | {"rays", "rays_per_second"} | _of_group("seconds", "imports", "load", "geometry", "open", "total")
TRANSPORT = BUILD | _of_group("seconds", "visibility", "transport")
LEFT_OUT = _of_group("left_out", *(field.name for field in dataclasses.fields(Account)), "line")
LEFT_OUT = {f"{key}.*" if key in ("left_out.terms", "left_out.channels") else key for key in LEFT_OUT}
TRANSPORT |= LEFT_OUT | {"seconds.account"}
TRANSPORT |= _of_group("bytes", "geometry", "environment", "visibility", "factors", "transport")
INDIRECT = BUILD | _of_group("seconds", "cloud", "between", "pixels")
INDIRECT |= _of_group("bytes", "geometry", "cloud", "albedo", "between", "indirect", "factors", "lights")
PICTURE = {"picture", "width", "height", "antialiasing", "covered", "mean_radiance", "negative", "exposure", "clipped"}
PICTURE |= {"lights", "leaves_out"}
PICTURE |= _of_group("seconds", "view", "light", "shade", "write", "error")
PICTURE |= _of_group("error", "line", "parts.*", "reference", "not_measured", "samples")
PICTURE |= {f"error.{name}.{key}" for name in ("trimmed", "untrimmed") for key in ("value", "low", "high")}
NOW = PICTURE | _of_group("seconds", "imports", "load", "prepare", "total")
RELIT = STORE - {"receivers"} | PICTURE | _of_group("seconds", "imports", "open", "environment", "total")
PLAN = {"samples", "shaded"} | _of_group("predicted_error", "between_pixels", "samples")
SHOWN = _of_group("milliseconds", "change_of_view", "change_of_light", "shading")
SHOWN |= _of_group("error", "coefficients", "without_worst_5_percent") | {"picture", "exposure"}
IMAGE = {"command", "kind", "image", "width", "height", "channels", "largest", "mean", "negative_pixels"}

KEYS = {
    "precompute": _lit("transport") | TRANSPORT,
    "transport": _lit("transport") | TRANSPORT | PICTURE,
    "indirect": _lit("indirect") | INDIRECT | PICTURE,
    "prefiltered": _lit("prefiltered") | NOW,
    "adaptive": _lit("adaptive") | NOW | PLAN | _of_group("maps", "bandwidth", "level", "samples", "error"),
    "relight": _lit("transport") | RELIT,
    "measure": _lit("indirect") | INDIRECT | {"table", "lights", "leaves_out"}
    | _of_group("seconds", "measure", "write") | _of_group("sensors.*", "points", "mean", "min", "max", "uniformity"),
    "inverse lamps": _lit("transport") | (TRANSPORT - {"bytes.environment"}) | {"lamps", "targets", "unknowns"}
    | {"report", "bytes.lights", "residual", "starts", "undetermined", "held_fixed"}
    | _of_group("seconds", "solve", "report"),
    "inverse light": _lit("transport") | (TRANSPORT - {"bytes.transport"}) | {"environment", "told", "unknowns"}
    | {"residual", "held_out", "singular_values", "strength", "applications", "exposures", "lamp_factors"}
    | {"saturated", "report.*"} | _of_group("seconds", "solve", "report"),
    "inverse materials": _lit("prefiltered") | {"output", "report", "residual", "held_out", "pixels", "saturated"}
    | {"undetermined", "light_scale", "held_fixed", "steps", "converged"}
    | _of_group("materials.*", "value", "deviation", "low", "high", "determined")
    | _of_group("seconds", "imports", "load", "prepare", "solve", "report", "total"),
    "demo": _lit("transport") | TRANSPORT - {"seconds.load"} | SHOWN,
    "store": _lit("transport")
    | STORE
    | LEFT_OUT
    | {"kind", "scene", "rows", "materials.*", "filtered_lobes.*", "bytes.*", "unused_layers"}
    | {"lights", "leaves_out", "largest_error_for_unit_light"},
    "scene": {"command", "kind", "scene", "vertices", "materials.*", "lights", "file_bounds"}
    | _of_group("meshes.*", "vertices", "faces", "material")
    | _of_group("bounds", "low", "high") | _of_group("camera", "origin", "target", "width", "height", "fov_y")
    | _of_group("framing_camera", "origin", "target", "fov_y", "inside") | _of_group("lamp", "position", "intensity")
    | _of_group("environment", "width", "height"),
    "image": IMAGE | {"not_finite_pixels"},
}  # fmt: skip


def keys_of(value, named: bool = False) -> set[str]:
    """Those of a summary."""
    if not isinstance(value, dict):
        return {""}
    return {
        f"{'*' if named else key}.{rest}".rstrip(".")
        for key, entry in value.items()
        for rest in keys_of(entry, key in _NAMED or (key == "bytes" and value.get("kind") == "store"))
    }
