"""A scene in a store: its geometry and receivers, what layers of rows are named by, and the header that joins them."""

import dataclasses
import functools
import importlib.metadata
import pathlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factoring import Factoring
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import as_material, has_lobes, split_diffuse, split_tint
from jaxrelight.brdf.record import to_record
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.sub_lobes import is_narrower_than_texels
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.geometry.receivers import Receivers
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.record import to_records
from jaxrelight.methods import Indirect, Transport
from jaxrelight.precomputation.layer_files import (
    factors_of,
    make_folder,
    plain,
    write_environment,
    write_factor,
    write_geometry,
    write_table,
)
from jaxrelight.precomputation.load import receivers_of
from jaxrelight.precomputation.receiver_refinement import Refined, refined
from jaxrelight.progress import Report
from jaxrelight.scene.scene import SENSOR_MATERIAL, Scene
from jaxrelight.transport.model import SceneGeometry, fixed_view


class Reflected(NamedTuple):
    """One BRDF of a material, as rows are made of it.

    Attributes:
        reflection: of the BRDF; None where it has no rows, as what is filtered has without bounces.
        record: what the header says of it; the names of its layers of rows are to be added.
        key: of what the rows follow from beside the receivers.
    """

    reflection: Reflection | None
    record: dict
    key: str


class PlacedMaterial(NamedTuple):
    """A material that receivers have.

    Attributes:
        name: of it.
        groups: of its receivers.
        parts: its BRDFs.
        notes: what standing for them costs that one might not expect, one line each.
    """

    name: str
    groups: Int[np.ndarray, " g"]
    parts: list[Reflected]
    notes: list[str]

    @property
    def in_rows(self) -> list[tuple[Reflection, dict]]:
        """The reflections that have rows, and the records that name their layers."""
        return [(part.reflection, part.record) for part in self.parts if part.reflection is not None]


@dataclasses.dataclass(frozen=True)
class PlacedScene:
    """A scene in a store.

    Attributes:
        scene: it.
        method: the dials.
        folder: the store.
        geometry: of the scene, with its receivers.
        names: of the materials, ascending.
        material_of_mesh: their numbers.
        layer: of that geometry.
        key: of all that rays depend on.
        finer: how vertices were added to the scene; None where none may be.
    """

    scene: Scene
    method: Transport | Indirect
    folder: pathlib.Path
    geometry: SceneGeometry
    names: list[str]
    material_of_mesh: Int[np.ndarray, " m"]
    layer: store.Layer
    key: str
    finer: Refined | None

    @property
    def receivers(self) -> Receivers:
        """The points of the operators' rows."""
        assert self.geometry.receivers is not None
        return self.geometry.receivers

    def receivers_key(self, *dials: object) -> str:
        """The key of the receivers and of dials."""
        scene, seen, bumps = self.scene, self.geometry.visible, self.geometry.normal_maps
        camera, of_meshes, eye = None, self.material_of_mesh, scene.eye
        if self.method.receivers == "vertices":
            # Rows of vertices are the same where sensors are looked at.
            of_meshes = of_meshes[: len(scene.parts)]
        elif isinstance(eye, Sensors):
            camera = [eye.positions.tolist(), eye.normals.tolist()]
        else:
            camera = plain(dataclasses.astuple(eye))
        bent = None
        if any(bumps):
            maps = (item for one in bumps for item in (one.content() if one else [None]))
            bent = [self._whole_key, seen.footprint if seen else None, *maps]
        return store.key_of(self.key, of_meshes, camera, *dials, bent)

    @property
    def _whole_key(self) -> str:
        """The key of the geometry with its texture coordinates."""
        return self.layer.folder.name.partition("-")[2]

    def materials(self, grey: bool) -> Iterator[PlacedMaterial]:
        """The materials that receivers have, with their lobes in grey parts where that is asked for."""
        surfaces, receivers, seen = self.geometry.surfaces, self.receivers, self.geometry.visible
        frames_key = store.key_of(surfaces.tangents) if surfaces.uv_tangents.any() else None
        for number, name in enumerate(self.names):
            groups = receivers.groups_of(number)
            if not len(groups):
                continue
            material = as_material(self.scene.materials[name])
            ways = [reflection_of(self.scene, self.method, name, component.brdf) for component in material.components]
            way = next((one for one in ways if one != "factors"), "factors")
            filtered = way != "factors"
            if filtered or self.method.receivers == "vertices":
                material = split_diffuse(material, lobe_sums=filtered)
            if grey and not filtered:
                material = split_tint(material, diffuse=self.method.receivers == "pixels")
            bump = write_factor(self.folder, material.normal_map) if material.normal_map else None
            parts, notes = [], []
            asked = self.scene.factors.get(name, Factoring())
            if filtered and self.method.receivers == "pixels":
                notes.append(
                    f"{name}: lobes that are narrower than the cube map's texels reflect filtered light times filtered "
                    "visibility; --resolution has finer ones"
                )
            elif filtered and name in self.scene.factors and not self.method.bounces:
                notes.append(
                    f"{name}: what is said of its factors is not used, since its lobes are filtered; "
                    "reflection 'factors' has them"
                )
            for component in material.components:
                brdf = component.brdf
                described = to_record(brdf, functools.partial(write_table, self.folder))
                of_filtered = filtered and has_lobes(brdf)
                reflection, factors, left = None, None, None
                if not of_filtered or self.method.bounces:
                    try:
                        reflection, factors, left = factors_of(self.folder, brdf, described, asked, self.method)
                    except InputError as error:
                        if str(error).startswith(str(self.folder)):
                            raise  # a file of the store, not the material
                        raise InputError(f"{self.scene.name}: material '{name}': {error}") from None
                if left and reflection and not of_filtered:
                    shapes = f"shapes that stand for all texels are {left.shapes:.1%} off, and " if left.shapes else ""
                    of_what = f"{left.terms:.0%} of {'them' if left.shapes else 'its BRDF'}"
                    notes.append(f"{name}: {shapes}{reflection.terms} factors leave {of_what}; --terms is the dial")
                if reflection is None and (self.method.bounces or not of_filtered):
                    reflection = fixed_view(brdf, receivers, groups)
                weight = [write_factor(self.folder, factor) for factor in component.weight]
                record = {"name": name, "number": number, "brdf": described, "factors": factors, "weight": weight}
                record |= {"normal_map": bump, "reflection": way if of_filtered else "factors"}
                if material.emission is not None and component is material.components[0]:
                    record["emission"] = material.emission.tolist()
                more = [store.key_of(surfaces.uv, seen.footprint)] if isinstance(brdf, SpatialLobes) and seen else []
                # The name of the factors tells their number and their resolution.
                key = store.key_of(number, described, factors, frames_key, *more)
                parts.append(Reflected(reflection, record, key))
            yield PlacedMaterial(name, groups, parts, notes)

    def header(self, materials: list[dict], lights: dict | None = None, **layers: str | None) -> dict:
        """What `load` takes: layers by their kinds, and records of materials."""
        scene = self.scene
        return {
            "jaxrelight": importlib.metadata.version("jaxrelight"),
            "scene": scene.name,
            "method": {"name": self.method.name, "dials": dataclasses.asdict(self.method)},
            "geometry": self.layer.folder.name,
            **({"refinement": self.finer.layer} if self.finer else {}),
            **layers,
            "material_of_mesh": self.material_of_mesh.tolist(),
            "materials": materials,
            "camera": plain(dataclasses.asdict(scene.camera)),
            **({"sensors": dataclasses.asdict(scene.eye)} if scene.of_sensors else {}),
            "environment": write_environment(self.folder, scene.lights.environment),
            "lights": lights,
        }


def reflection_of(scene: Scene, method: Transport | Indirect, name: str, brdf: Brdf | SpatialLobes) -> str:
    """How one BRDF of a material is reflected; pixels have exact rows, but of lobes narrower than texels.

    Args:
        scene: that the material is of.
        method: the dials.
        name: of the material.
        brdf: one of its BRDFs.
    """
    if not isinstance(method, Transport) or not has_lobes(brdf):
        return "factors"
    if method.receivers == "vertices":
        return scene.reflections.get(name, method.reflection)
    assert isinstance(brdf, LobeSum | SpatialLobes)
    return "filtered" if is_narrower_than_texels(brdf, method.resolution) else "factors"


def place(
    scene: Scene, method: Transport | Indirect, folder: str | pathlib.Path | None, report: Report | None = None
) -> PlacedScene:
    """Puts a scene's geometry into a store, and finds its receivers: vertices are added where light asks for them.

    Raises:
        InputError: if the camera sees nothing where receivers are pixels, if the folder cannot be made, or if a store
            cannot hold the fields of a BRDF or a light of a class of one's own.
    """
    _check_classes(scene, method)
    surfaces = scene.surfaces()
    # The sensors' material comes last, so that the others have the same numbers with them and without.
    names = sorted(set(scene.material_of_mesh), key=lambda name: (name == SENSOR_MATERIAL, name))
    material_of_mesh = np.array([names.index(name) for name in scene.material_of_mesh])
    key, whole_key = geometry_keys(scene, surfaces)
    folder, finer = pathlib.Path(folder or store.default_folder(key)), None
    if isinstance(method, Transport) and method.receivers == "vertices" and method.receiver_tolerance:
        make_folder(folder)
        finer = refined(scene, method.receiver_tolerance, folder, key, report)
        scene = finer.scene
        surfaces = scene.surfaces()
        key, whole_key = geometry_keys(scene, surfaces)
    tracer = Tracer(surfaces)
    bumps = [as_material(scene.materials[name]).normal_map for name in scene.material_of_mesh]
    receivers, seen = receivers_of(surfaces, tracer, material_of_mesh, bumps, scene.eye, method)
    if not receivers.count:
        raise InputError(f"{scene.name}: the camera sees no surface; give it another target, or precompute vertices")
    make_folder(folder)
    layer = write_geometry(folder / f"geometry-{whole_key}", surfaces)
    geometry = SceneGeometry(surfaces, tracer, tuple(bumps), (), receivers, seen)
    return PlacedScene(scene, method, folder, geometry, names, material_of_mesh, layer, key, finer)


def geometry_keys(scene: Scene, surfaces: Surfaces) -> tuple[str, str]:
    """The key of all that rays depend on, and that of the geometry with its texture coordinates, which none does."""
    shapes = [[part.mesh.vertices, part.mesh.faces, part.mesh.normals] for part in scene.parts]
    key = store.key_of(shapes, surfaces.two_sided, surfaces.pure_normals)
    return key, store.key_of(key, surfaces.uv, surfaces.uv_tangents)


def _check_classes(scene: Scene, method: Transport | Indirect) -> None:
    """Finds out before long work whether a store can hold the scene's BRDFs, and the lights that it keeps."""
    for name in sorted({part.material for part in scene.parts}):
        for component in as_material(scene.materials[name]).components:
            to_record(component.brdf, lambda array: "", f"{scene.name}: material '{name}'")
    to_records(scene.lights.local, f"{scene.name}:")
