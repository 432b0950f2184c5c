"""Photons: light that points send out by the cosine, and where it lands on its way (Hašan 2006 §4.1, §4.3)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import OFFSET, Tracer

# Rays that are traced at once.
_RAY_CHUNK = 2**18

# The albedo of points by face, barycentric weights, and whether it is the back.
AlbedoAt = Callable[[np.ndarray, np.ndarray, np.ndarray], Float[np.ndarray, "p 3"]]


class Photons(NamedTuple):
    """What landed, on the side of a surface that reflects.

    Attributes:
        positions: in scene space.
        normals: of the faces, on the side that was hit.
        power: that arrives, of a photon that set out with 1.
        origins: numbers of the points that they set out from.
    """

    positions: Float[np.ndarray, "p 3"]
    normals: Float[np.ndarray, "p 3"]
    power: Float[np.ndarray, "p 3"]
    origins: Int[np.ndarray, " p"]


def shoot(
    surfaces: Surfaces,
    tracer: Tracer,
    positions: Float[np.ndarray, "g 3"],
    face_normals: Float[np.ndarray, "g 3"],
    albedo: AlbedoAt,
    each: int,
    length: int | None,
    seed: int = 0,
) -> Photons:
    """Sends `each` photons from every point, deposits and reflects them diffusely wherever they land.

    Args:
        surfaces: of the scene.
        tracer: of the scene.
        positions: points that the photons start from, in scene space.
        face_normals: normals of the faces there.
        albedo: of surface points.
        each: number of photons from each point.
        length: how often each lands at most; None for Russian roulette by albedo, which has no limit.
        seed: of directions and of the roulette.
    """
    random = np.random.default_rng(seed)
    landings = []
    for start in range(0, len(positions) * each, _RAY_CHUNK):
        origin = np.arange(start, min(start + _RAY_CHUNK, len(positions) * each)) // each
        where, normal, power = positions[origin], face_normals[origin], np.ones((len(origin), 3))
        landed = 0
        while len(origin) and (length is None or landed < length):
            face, weights = tracer.first_hits(where + OFFSET * normal, _by_cosine(normal, random))
            # What came from behind a one-sided surface is lost; `away` says from where.
            hit = face >= 0
            face, weights, origin, power, before = face[hit], weights[hit], origin[hit], power[hit], where[hit]
            corners = surfaces.vertices[surfaces.faces[face]]
            where, normal = np.einsum("pk,pkx->px", weights, corners), surfaces.face_normals(face)
            behind = np.sum(normal * (before - where), axis=1) < 0
            kept = ~behind | surfaces.two_sided[surfaces.mesh_of_vertex[surfaces.faces[face, 0]]]
            normal = np.where(behind[:, None], -normal, normal)
            arrays = where, normal, power, origin, face, weights, behind
            where, normal, power, origin, face, weights, behind = (array[kept] for array in arrays)
            landings.append(Photons(where, normal, power, origin))
            reflected, landed = albedo(face, weights, behind), landed + 1
            if length is None:
                goes_on = random.random(len(face)) < (chance := np.minimum(reflected.max(axis=1), 0.95))
                arrays = where, normal, power, origin, reflected / np.where(chance > 0, chance, 1)[:, None]
                where, normal, power, origin, reflected = (array[goes_on] for array in arrays)
            power = power * reflected
    none = Photons(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64))
    return Photons(*(np.concatenate(arrays) for arrays in zip(none, *landings, strict=True)))


def _by_cosine(normals: Float[np.ndarray, "p 3"], random: np.random.Generator) -> Float[np.ndarray, "p 3"]:
    """Directions about normals: a point of the unit sphere around the normal's end."""
    z, turn = random.uniform(-1, 1, len(normals)), random.uniform(0, 2 * np.pi, len(normals))
    ring = np.sqrt(1 - z * z)
    return normals + np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1) * (1 - 1e-6)
