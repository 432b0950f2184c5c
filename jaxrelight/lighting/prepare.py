"""From a scene and a lighting method to a relighter, and from a store to one."""

import pathlib

from jaxrelight.brdf.material import as_material
from jaxrelight.errors import InputError
from jaxrelight.files import store as stores
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lighting.adaptive.relighter import AdaptiveRelighter, sampled_materials
from jaxrelight.lighting.contract import Relighter, Report
from jaxrelight.lighting.indirect import IndirectRelighter
from jaxrelight.lighting.prefiltered import PrefilteredRelighter
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial, surface_material
from jaxrelight.methods import Adaptive, Indirect, Method, Prefiltered, Transport
from jaxrelight.precomputation.load import load
from jaxrelight.precomputation.precompute import StoreBuild, precompute
from jaxrelight.precomputation.receiver_refinement import with_needed_vertices
from jaxrelight.precomputation.vertex_occlusion import (
    sensor_occlusion,
    stored_occlusion,
    vertex_occlusion,
    with_stored_vertices,
)
from jaxrelight.scene.scene import Scene
from jaxrelight.timing import timed
from jaxrelight.transport.model import PrecomputedIndirect, SceneGeometry


def prepare(
    scene: Scene,
    method: Method | None = None,
    store: str | pathlib.Path | None = None,
    report: Report | None = None,
) -> Relighter:
    """Does what can be done before the light is known, and gives what lights the scene.

    `Transport` and `Indirect` precompute into a store, or complete it; what is done there is reused. `Prefiltered`
    takes what hides the environment from a store of transport, where one is given, and traces it otherwise. `Adaptive`
    has no store.

    Args:
        scene: what to light. Pixel receivers and `Indirect` bind its camera.
        method: the lighting method and its dials; by default `default_method(scene)`.
        store: the store's folder; by default one in the user's cache folder, named by the geometry, or none for
            `Prefiltered`.
        report: called with the progress: a stage, how much of it is done and how much there is.

    Raises:
        InputError: for a scene that the method cannot light.
    """
    return prepare_with_build(scene, method, store, report)[0]


def prepare_with_build(
    scene: Scene,
    method: Method | None = None,
    store: str | pathlib.Path | None = None,
    report: Report | None = None,
) -> tuple[Relighter, StoreBuild | None]:
    """`prepare`, and what a precomputation did; None for a method without a store.

    Raises:
        InputError: as `prepare` does.
    """
    method = default_method(scene) if method is None else method
    match method:
        case Transport() | Indirect():
            build = precompute(scene, method, store, report or (lambda stage, done, total: None))
            with timed(build.seconds, "open"):
                # The store is opened for this scene, whatever another process has meanwhile made of it.
                relighter = _relighter_of(load(build.folder, build.header, build.geometry))
            return relighter, build
        case Prefiltered():
            return _prepare_prefiltered(scene, method, store, report), None
        case Adaptive():
            if scene.of_sensors:
                raise InputError(
                    "Adaptive shares samples between neighbouring pixels, which sensors do not have; measure by "
                    "Transport, Indirect or Prefiltered"
                )
            if store is not None:
                raise InputError("Adaptive precomputes nothing, so it has no store; leave it out")
            return _prepare_adaptive(scene, method, report), None
    raise InputError(f"a lighting method is Transport, Indirect, Prefiltered or Adaptive, not {type(method).__name__}")


def open_store(folder: str | pathlib.Path, *, sensors: bool = False) -> TransportRelighter | IndirectRelighter:
    """A relighter from a store; nothing is written.

    Args:
        folder: the store.
        sensors: open what was precomputed last of a scene at its sensors, see `Scene.at_sensors`, and not of a camera.

    Raises:
        InputError: if it is not complete, damaged, or of another format.
    """
    header = stores.read_header(pathlib.Path(folder), stores.SENSOR_HEADER) if sensors else None
    return _relighter_of(load(folder, header))


def default_method(scene: Scene) -> Method:
    """`Indirect` for a scene with local lights alone, and `Transport` otherwise."""
    return Indirect() if scene.lights.local and scene.lights.environment is None else Transport()


def _relighter_of(precomputed) -> TransportRelighter | IndirectRelighter:
    if isinstance(precomputed, PrecomputedIndirect):
        return IndirectRelighter(precomputed)
    return TransportRelighter(precomputed)


def _prepare_prefiltered(
    scene: Scene, method: Prefiltered, store: str | pathlib.Path | None, report: Report | None
) -> PrefilteredRelighter:
    if method.occlusion_resolution and not isinstance(scene.eye, Sensors):
        if store is not None:
            scene = with_stored_vertices(scene, store)
        elif method.receiver_tolerance:
            scene = with_needed_vertices(scene, method.receiver_tolerance, method.occlusion_resolution, report)
    materials, geometry, occlusion = _materials(scene, method.minification), _geometry(scene), None
    if isinstance(scene.eye, Sensors):
        if store is not None:
            raise InputError("a store has no visibility of sensors; leave it out, and rays are cast from them now")
        if method.occlusion_resolution:
            occlusion = sensor_occlusion(
                scene.eye, geometry.surfaces, geometry.tracer, method.occlusion_resolution, report
            )
    elif store is not None:
        if not method.occlusion_resolution:
            raise InputError("an occlusion resolution of 0 reads no visibility of a store; leave one of them out")
        occlusion = stored_occlusion(store, scene, geometry.surfaces)
    elif method.occlusion_resolution:
        occlusion = vertex_occlusion(geometry.surfaces, geometry.tracer, method.occlusion_resolution, report)
    return PrefilteredRelighter(
        materials=materials,
        own_lights=scene.lights,
        method=method,
        camera=scene.camera,
        geometry=geometry,
        occlusion=occlusion,
        sensors=scene.eye if isinstance(scene.eye, Sensors) else None,
    )


def _prepare_adaptive(scene: Scene, method: Adaptive, report: Report | None) -> AdaptiveRelighter:
    materials = sampled_materials(_materials(scene, method.minification), report)
    return AdaptiveRelighter(  # pyright: ignore[reportCallIssue]  # its materials are a property
        sampled_materials=materials,
        own_lights=scene.lights,
        method=method,
        camera=scene.camera,
        geometry=_geometry(scene),
    )


def _materials(scene: Scene, minification) -> tuple[SurfaceMaterial, ...]:
    scene.check_materials()
    names = sorted(set(scene.material_of_mesh))
    return tuple(surface_material(name, as_material(scene.materials[name]), minification) for name in names)


def _geometry(scene: Scene) -> SceneGeometry:
    surfaces = scene.surfaces()
    maps = tuple(as_material(scene.materials[name]).normal_map for name in scene.material_of_mesh)
    return SceneGeometry(surfaces, Tracer(surfaces), maps, scene.material_of_mesh)
