"""Scenes: meshes, materials, a camera and an environment, from TOML or from code."""

import dataclasses
from collections.abc import Mapping, Sequence

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factoring import Factoring
from jaxrelight.brdf.lobes import lambert
from jaxrelight.brdf.material import Material, as_material
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.sensors import Sensor, Sensors
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.methods import REFLECTIONS, check_choice
from jaxrelight.scene.parts import Part, missing_sets, with_plain_materials

# The material of sensors that are looked at.
SENSOR_MATERIAL = "(sensor)"


@dataclasses.dataclass(frozen=True)
class Scene:
    """What is lit and seen.

    Attributes:
        parts: the meshes.
        materials: by name; a BRDF is the same over the whole surface.
        camera: the view, unless another is asked for.
        lights: an environment and local lights, unless others are asked for.
        name: what messages call it.
        assumptions: what was approximated, or taken because nothing else was said, one line each.
        factors: how a material becomes factors, by its name, where not as the method says.
        reflections: how vertices reflect a material's lobes, by its name, where not as the method says; see
            `Transport.reflection`.
        sensors: where light may be measured.
        of_sensors: whether their points take the place of the camera's pixels; see `at_sensors`.
    """

    parts: Sequence[Part]
    materials: Mapping[str, Brdf | Material]
    camera: Camera
    lights: Lights = dataclasses.field(default_factory=Lights)
    name: str = "scene"
    factors: Mapping[str, Factoring] = dataclasses.field(default_factory=dict)
    reflections: Mapping[str, str] = dataclasses.field(default_factory=dict)
    assumptions: Sequence[str] = ()
    sensors: Sequence[Sensor] = ()
    of_sensors: bool = False

    def __init__(
        self,
        parts: Sequence[Part],
        materials: Mapping[str, Brdf | Material],
        camera: Camera,
        lights: LightsLike = None,
        name: str = "scene",
        factors: Mapping[str, Factoring] | None = None,
        assumptions: Sequence[str] = (),
        reflections: Mapping[str, str] | None = None,
        sensors: Sequence[Sensor] = (),
        of_sensors: bool = False,
    ):
        """See the attributes; lights are an environment, local lights, or a list of both."""
        for field, value in {
            "parts": tuple(parts),
            "materials": materials,
            "camera": camera,
            "lights": as_lights(lights),
            "name": name,
            "factors": factors or {},
            "reflections": reflections or {},
            "assumptions": assumptions,
            "sensors": tuple(sensors),
            "of_sensors": of_sensors,
        }.items():
            object.__setattr__(self, field, value)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was mended and assumed while the scene was read, one line each."""
        lines = [f"{part.name}: {note}" for part in self.parts for note in part.mesh.notes]
        return (*lines, *self.assumptions, *self.lights.notes)

    def surfaces(self) -> Surfaces:
        """All meshes as one. Directions in maps of BRDFs count from that of growing u, so their meshes' frames do."""
        spatial = {name for name, surface in self.materials.items() if as_material(surface).is_spatial}
        return join(
            [
                dataclasses.replace(part.mesh, uv_tangents=True) if part.material in spatial else part.mesh
                for part in self.parts
            ]
        )

    def at_sensors(self) -> "Scene":
        """The scene where the points of its sensors take the place of its camera's pixels.

        Each is a white, one-sided, diffuse receiver, which no ray hits: its radiance is its irradiance over π. What is
        prepared of this scene is for `measure`.

        Raises:
            InputError: for a scene without sensors, or two of one name, or where a material is called as theirs is.
        """
        if SENSOR_MATERIAL in self.materials:
            raise InputError(f"{self.name}: sensors are of a material '{SENSOR_MATERIAL}'; rename the scene's")
        Sensors(tuple(self.sensors))  # which refuses them
        materials = {**self.materials, SENSOR_MATERIAL: lambert(1.0)}
        return dataclasses.replace(self, materials=materials, of_sensors=True)

    @property
    def eye(self) -> Camera | Sensors:
        """What is looked from: the camera, or the sensors in its place."""
        return Sensors(tuple(self.sensors)) if self.of_sensors else self.camera

    @property
    def material_of_mesh(self) -> tuple[str, ...]:
        """The names of the meshes' materials, in their order; last that of sensors, where those are looked at."""
        names = tuple(part.material for part in self.parts)
        return (*names, SENSOR_MATERIAL) if self.of_sensors else names

    @property
    def emits(self) -> bool:
        """Whether surfaces emit light."""
        return any(as_material(self.materials[part.material]).emission is not None for part in self.parts)

    def with_plain_materials(self) -> "Scene":
        """The scene where parts without the texture coordinates that their material needs have its mean colour.

        The assumptions tell of it. BRDFs that differ between texels stay, which `check_materials` refuses. Scenes that
        come from files are such ones.
        """
        parts, materials, notes = with_plain_materials(self.parts, self.materials)
        if not notes:
            return self
        return dataclasses.replace(self, parts=parts, materials=materials, assumptions=(*self.assumptions, *notes))

    def check_materials(self) -> None:
        """Refuses parts whose material is not given, or cannot be put on them, and factors that it cannot have.

        Raises:
            InputError: for the first of them.
        """
        for name, reflection in self.reflections.items():
            check_choice(f"{self.name}: material '{name}': reflection", reflection, REFLECTIONS)
        for name, asked in self.factors.items():
            if name in self.materials and as_material(self.materials[name]).is_spatial and not asked.is_shared:
                raise InputError(
                    f"{self.name}: material '{name}': the texels of its map share factors of the form 'svd' over the "
                    "disc; remove 'terms_error', 'form' and 'parametrisation', which are for a single BRDF"
                )
        for part in self.parts:
            if part.material not in self.materials:
                raise InputError(f"{self.name}: '{part.name}' is of a material '{part.material}' that is not given")
            material = as_material(self.materials[part.material])
            if missing_sets(material, part.mesh):
                raise InputError(
                    f"{self.name}: '{part.name}' has no texture coordinates, which its material '{part.material}' "
                    "needs; export it with them, or give it another material"
                )
            if material.needs_colours and part.mesh.colours is None:
                raise InputError(
                    f"{self.name}: the vertices of '{part.name}' have no colours, which its material '{part.material}' "
                    "needs; give the mesh some, or give it another material"
                )
