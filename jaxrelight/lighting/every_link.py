"""The reference of indirect lighting: what pixels gather from every point of the cloud and its parts, one by one."""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.brdf.reflection import of_group
from jaxrelight.brdf.texture import PixelWeight, look_up
from jaxrelight.gather.final_gather import FinalGather
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.ray_origins import ray_origins
from jaxrelight.geometry.receivers import pixel_receivers
from jaxrelight.lighting.reference import Reference, Sample
from jaxrelight.lighting.transport_view import TransportView
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.contract import Basis
from jaxrelight.transport.model import PrecomputedIndirect, fixed_view, frames_of

# What gathering from nodes and coefficients in place of all points brings about, as messages call it.
MEANS = "links and coefficients"


class _Rows(NamedTuple):
    """Rows of some pixels over some coefficients of the cloud's light."""

    pixels: Int[np.ndarray, " m"]
    columns: Int[np.ndarray, " n"]
    rows: Float[np.ndarray, "m c n"]


class EveryLink(Reference):
    """Gathers at a few pixels from every part of every point, and keeps all coefficients."""

    name = "gathering from every point"

    def __init__(self, precomputed: PrecomputedIndirect, view: TransportView, count: int, seed: int):
        """Casts the rays, one to each part of each point.

        Args:
            precomputed: of the scene.
            view: of its pixels.
            count: of the sample.
            seed: of the sample.
        """
        self._precomputed, self._view = precomputed, view
        super().__init__(view.surfaces.pixels, count, seed)

    def of(self, pixels: Int[np.ndarray, " s"]) -> Sample:
        """Some pixels, by the light of the cloud."""
        every, basis = self._gathered(pixels), self._precomputed.transport.basis

        def radiance(lit: Any) -> dict[str, Float[np.ndarray, "s 3"]]:
            light, total = np.asarray(encoded(basis, lit.cloud)), np.zeros((len(pixels), 3))
            for own, columns, rows in every:
                total[own] += np.einsum("mcn,nc->mc", rows, light[columns])
            return {MEANS: total}

        return Sample(pixels, self._view.taken(pixels), radiance)

    def _gathered(self, pixels: Int[np.ndarray, " s"]) -> list[_Rows]:
        """Rows of the pixels, by each BRDF of each material."""
        precomputed = self._precomputed
        transport, geometry, method = precomputed.transport, precomputed.stored.geometry, precomputed.method
        seen = geometry.visible
        assert seen is not None
        points = _some(seen, pixels)
        origins = ray_origins(geometry.surfaces, geometry.tracer, points)
        receivers = pixel_receivers(points, origins, _numbers(geometry.material_of_mesh))
        place = np.full(receivers.positions.shape[0] * receivers.positions.shape[1], -1)
        place[receivers.slot_of] = np.arange(len(pixels))
        place = place.reshape(receivers.positions.shape[:2])
        gather = FinalGather(precomputed.points, geometry.tracer, 0.0, method.near, 1.0)
        every: list[_Rows] = []
        for number, name in enumerate(_names(geometry.material_of_mesh)):
            groups = receivers.groups_of(number)
            blocks = [block for block in transport.blocks if block.material == name]
            if not len(groups) or not blocks:
                continue
            frames = frames_of(receivers, groups)
            reflections = [fixed_view(block.brdf, receivers, groups) for block in blocks]
            for i, group in enumerate(groups):
                own = [of_group(reflection, i) for reflection in reflections]
                assert receivers.uv is not None
                assert receivers.footprint is not None
                uv, footprint = (as_array(of[group], np.float32) for of in (receivers.uv, receivers.footprint))
                real = np.flatnonzero(place[group] >= 0)
                for block, gathered in zip(blocks, gather.rows(receivers, int(group), frames[i], own), strict=True):
                    factor = np.asarray(_factors(block.weight, uv, footprint))[real]
                    rows = gathered.rows[real, 0] * factor[:, :, None]
                    every.append(_Rows(place[group][real], gathered.columns, rows.astype(np.float32)))
        return every


@jax.jit
def encoded(basis: Basis, light: Float[Array, "g c"]) -> Float[Array, "g c"]:
    """Coefficients of the light of a cloud's points."""
    return basis.encode(light.T).T


def _names(material_of_mesh: tuple[str | None, ...]) -> list[str]:
    return sorted({name for name in material_of_mesh if name is not None})


def _numbers(material_of_mesh: tuple[str | None, ...]) -> Int[np.ndarray, " m"]:
    """Numbers of the materials by mesh; those that no receiver has come last."""
    names = _names(material_of_mesh)
    return np.array([len(names) if name is None else names.index(name) for name in material_of_mesh])


def _some(seen: GBuffer, pixels: Int[np.ndarray, " s"]) -> GBuffer:
    """The points of some pixels."""
    rows = (np.cumsum(seen.covered.ravel()) - 1)[pixels]
    of_points = {
        field.name: getattr(seen, field.name)[rows]
        for field in dataclasses.fields(GBuffer)
        if field.name not in ("covered", "directions")
    }
    directions = seen.directions.reshape(-1, 3)[pixels]
    return dataclasses.replace(seen, covered=np.ones(len(pixels), bool), directions=directions, **of_points)


@jax.jit
def _factors(weight: PixelWeight, uv: Float[Array, "m u"], footprint: Float[Array, " m"]) -> Float[Array, "m c"]:
    return jax.vmap(look_up, in_axes=(None, 0, 0))(weight, uv, footprint)
