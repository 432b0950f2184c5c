"""How bright lamps are to begin with: outputs are linear in it, so non-negative least squares tell it."""

import dataclasses
import math

import numpy as np
import scipy.optimize

from jaxrelight.inverse.lamp_problem import LampProblem, lamp_outputs, traced_bits
from jaxrelight.inverse.lamp_targets import PictureTarget
from jaxrelight.numerics.arrays import as_array

# How much brightnesses of the start are held together, so that none is dark from where no slope leads on.
_TOGETHER = 0.03


def with_typical_brightness(problem: LampProblem) -> LampProblem:
    """The problem where brightness of order one is what lamps that are all alike need to reach the targets."""
    bits = traced_bits(problem.response, problem.kinds, problem.starts)
    problem = dataclasses.replace(problem, bits=bits)
    columns, wanted, left = linear_targets(problem)
    kinds, at = [], 0
    every = columns.sum(axis=1)
    alike = float(every @ wanted) / max(float(every @ every), 1e-30)
    for kind, start in zip(problem.kinds, problem.starts, strict=True):
        count = start.brightness.size
        own = columns[:, at : at + count].sum(axis=1)
        at += count
        scale = float(own @ left) / max(float(own @ own), 1e-30) if own.any() else 0.0
        known = float(np.asarray(start.brightness).mean())
        typical = alike if alike > 0 else scale if scale > 0 else known
        typical = typical if np.isfinite(typical) and typical > 0 else max(known, 1e-6)
        kinds.append(dataclasses.replace(kind, typical=as_array(typical, np.float32)))
    return dataclasses.replace(problem, kinds=tuple(kinds))


def with_bright_lamps(problem: LampProblem) -> LampProblem:
    """The problem at brightnesses of non-negative least squares, where those are free."""
    columns, wanted, _ = linear_targets(problem)
    if not len(wanted):
        return problem
    free, typical = [], []
    for kind, start in zip(problem.kinds, problem.starts, strict=True):
        is_free = "intensity" in kind.free or "colour" in kind.free
        free.append(np.full(start.brightness.size, is_free))
        typical.append(np.full(start.brightness.size, float(kind.typical)))
    is_free, scale = np.concatenate(free), np.concatenate(typical)
    if not is_free.any():
        return problem
    now = np.concatenate([np.asarray(start.brightness, float).ravel() for start in problem.starts])
    left = wanted - columns[:, ~is_free] @ now[~is_free]
    scaled = columns[:, is_free] * scale[is_free]
    together = _TOGETHER * np.linalg.norm(scaled) / math.sqrt(len(scaled.T)) * np.eye(len(scaled.T))
    # QR first: a picture has many rows.
    stacked, aims = np.concatenate([scaled, together]), np.concatenate([left, together.sum(axis=1)])
    q, r = np.linalg.qr(stacked)
    solution, _ = scipy.optimize.nnls(r, q.T @ aims)
    now[is_free] = solution * scale[is_free]
    starts, at = [], 0
    for start in problem.starts:
        shape = start.brightness.shape
        own = now[at : at + start.brightness.size].reshape(shape)
        at += start.brightness.size
        starts.append(start._replace(brightness=as_array(own, np.float32)))
    return dataclasses.replace(problem, starts=tuple(starts))


def linear_targets(problem: LampProblem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the targets that are linear, over the brightnesses of all lamps; what they are to be; and less others."""
    outputs = [np.asarray(own, float) for own in lamp_outputs(problem)]
    columns = np.concatenate([np.moveaxis(own, 1, 0).reshape(own.shape[1], -1) for own in outputs], axis=1)
    others = np.asarray(problem.others, float)
    if isinstance(problem.targets, PictureTarget):
        weight, wanted = problem.targets.linear()
        return weight[:, None] * columns, wanted - weight * others, wanted - weight * others
    rows, wanted = problem.targets.linear()
    return rows @ columns, wanted - rows @ others, wanted - rows @ others
