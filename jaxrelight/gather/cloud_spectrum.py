"""How much the light of lamps varies over a cloud, by scale: what its coefficients are worth."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrelight.basis.haar import HaarFaces, levels
from jaxrelight.gather.gather_cloud import GatherCloud
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.numerics.arrays import as_array

_LAMPS = 64
# The cosine of the cutoff of every other lamp, which is a spot.
_CUTOFF = np.cos(np.radians(25.0))
# Scales that no lamp has light of are worth this share of the largest.
_MIN_SPECTRUM = 1e-4


def cloud_spectrum(cloud: GatherCloud, surfaces: Surfaces, tracer: Tracer, seed: int = 0) -> Float[np.ndarray, " d"]:
    """The standard deviation of every Haar coefficient under lamps at random places, the same within a level.

    Lamps hang between a point of the cloud and what is opposite; each counts the same.
    """
    random = np.random.default_rng(seed)
    squares = np.zeros((cloud.side**2,))
    basis, level = HaarFaces(cloud.side, 1), levels(cloud.side, 1)
    chosen = random.choice(np.flatnonzero(~cloud.of_sky), size=_LAMPS)
    from_there, along = cloud.positions[chosen] + OFFSET * cloud.face_normals[chosen], cloud.face_normals[chosen]
    face, weights = tracer.first_hits(from_there, along)
    hit = np.einsum("pk,pkx->px", weights, surfaces.vertices[surfaces.faces[np.maximum(face, 0)]])
    far = np.where(face >= 0, np.linalg.norm(hit - from_there, axis=1), 1.0)
    places = from_there + along * (far * random.uniform(0.1, 0.9, _LAMPS))[:, None]
    ends = cloud.positions + OFFSET * cloud.face_normals
    for number, place in enumerate(places):
        away = ends - place
        square = np.maximum(np.sum(away**2, axis=1), 1e-6)
        light = np.maximum(-np.sum(away * cloud.normals, axis=1), 0) / square**1.5
        if number % 2:
            axis = random.normal(size=3)
            light *= away @ (axis / np.linalg.norm(axis)) > _CUTOFF * np.sqrt(square)
        light[cloud.of_sky] = 0
        lit = np.flatnonzero(light)
        light[lit[tracer.blocked(np.tile(place, (len(lit), 1)), away[lit], np.full(len(lit), 1 - 1e-4))]] = 0
        energy = np.sum(light**2)
        if energy > 0:
            squares += np.asarray(basis.encode(as_array(light / np.sqrt(energy), jnp.float32)), float) ** 2
    of_level = np.bincount(level, squares) / np.bincount(level)
    spectrum = np.sqrt(of_level)[level]
    return np.maximum(spectrum / spectrum.max(), _MIN_SPECTRUM) if spectrum.max() > 0 else np.ones_like(spectrum)
