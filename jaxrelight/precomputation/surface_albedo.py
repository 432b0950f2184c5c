"""The albedo of any point of a scene's surfaces, as diffuse light between them needs it."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.brdf.albedo import mean_albedo
from jaxrelight.brdf.material import Material, as_material
from jaxrelight.brdf.texture import look_up
from jaxrelight.files import store
from jaxrelight.gather.gather_cloud import GatherCloud
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import bucket, filled_up
from jaxrelight.scene.scene import Scene
from jaxrelight.transport.model import SceneGeometry


class SurfaceAlbedo:
    """The share of light that each point reflects, averaged over directions, by channel.

    Attributes:
        means: of each mesh, those of its material's components, and their weights.
        emission: radiance of each mesh's material.
    """

    def __init__(self, scene: Scene, surfaces: Surfaces):
        materials = {part.material: as_material(scene.materials[part.material]) for part in scene.parts}
        means = {
            name: [(mean_albedo(component.brdf), component.weight) for component in material.components]
            for name, material in materials.items()
        }
        self._surfaces = surfaces
        self.means = [means[part.material] for part in scene.parts]
        emission = [materials[part.material].emission for part in scene.parts]
        self.emission = np.stack([np.zeros(3) if radiance is None else radiance for radiance in emission])

    @property
    def key(self) -> str:
        """The key of the albedos, and of where the textures lie that tell them."""
        every = [pair for one in self.means for pair in one]
        where = [] if all(w.is_constant for _, ws in every for w in ws) else [self._surfaces.uv]
        return store.key_of(*([mean, *(item for w in ws for item in w.content())] for mean, ws in every), *where)

    def __call__(
        self,
        faces: Int[np.ndarray, " p"],
        barycentric: Float[np.ndarray, "p 3"],
        back: Bool[np.ndarray, " p"],
        areas: Float[np.ndarray, " p"] | None = None,
    ) -> Float[np.ndarray, "p 3"]:
        """The albedos of points on faces, which stand for areas in scene space; both sides of a mesh are alike."""
        surfaces = self._surfaces
        corners = surfaces.faces[faces]
        mesh = surfaces.mesh_of_vertex[corners[:, 0]]
        albedos = np.zeros((len(faces), 3))
        for number in np.unique(mesh):
            of_mesh = np.flatnonzero(mesh == number)
            for albedo, weight in self.means[number]:
                if all(factor.is_constant for factor in weight):
                    albedos[of_mesh] += albedo * np.prod([factor.mean for factor in weight], axis=0)
                    continue
                uv = np.einsum("pk,pkx->px", barycentric[of_mesh], surfaces.uv[corners[of_mesh]])
                covers = (
                    np.zeros(len(of_mesh)) if areas is None else areas[of_mesh] * surfaces.uv_densities(faces[of_mesh])
                )
                length = bucket(len(of_mesh), 1024)
                looked_up = _look_up(weight, filled_up(uv, length), filled_up(covers, length))
                albedos[of_mesh] += albedo * np.asarray(looked_up)[: len(of_mesh)]
        return albedos


def albedo_at_points(
    geometry: SceneGeometry,
    points: GatherCloud,
    materials: Mapping[str, Material],
    albedo: Float[Array, "g c"],
    emission: Float[Array, "g c"],
) -> tuple[Float[Array, "g c"], Float[Array, "g c"]]:
    """Albedo and emission of a cloud's points with other materials, which may be traced; differentiable in them.

    Args:
        geometry: of the scene.
        points: the cloud.
        materials: by name, those that changed.
        albedo: of the points before.
        emission: of the points before.
    """
    surfaces = geometry.surfaces
    corners = surfaces.faces[np.maximum(points.faces, 0)]
    names = np.array([name or "" for name in geometry.material_of_mesh])[surfaces.mesh_of_vertex[corners[:, 0]]]
    for name, material in materials.items():
        mine = np.flatnonzero((names == name) & ~points.of_sky)
        if not len(mine):
            continue
        uv = np.einsum("pk,pkx->px", points.barycentric[mine], surfaces.uv[corners[mine]])
        covers = points.areas[mine] * surfaces.uv_densities(points.faces[mine])
        place = as_array(uv, albedo.dtype), as_array(covers, albedo.dtype)
        own = jnp.zeros((len(mine), albedo.shape[1]), albedo.dtype)
        for component in material.components:
            own = own + as_array(mean_albedo(component.brdf), albedo.dtype)[None] * _look_up(component.weight, *place)
        albedo = albedo.at[mine].set(own.astype(albedo.dtype))
        radiance = as_array(np.zeros(1) if material.emission is None else material.emission, emission.dtype)
        emission = emission.at[mine].set(jnp.broadcast_to(radiance[None], (len(mine), emission.shape[1])))
    return albedo, emission


@jax.jit
def _look_up(weight, uv, footprint):
    return jax.vmap(lambda one, area: look_up(weight, jnp.asarray(one), area))(uv, footprint)
