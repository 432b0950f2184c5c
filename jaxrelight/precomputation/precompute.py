"""From a scene to a store: layers of direct light, then as many passes of bounced light as are asked for."""

import collections
import dataclasses
import pathlib
from collections.abc import Sequence

from jaxrelight.brdf.albedo import largest_albedo
from jaxrelight.brdf.material import as_material
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.methods import Settings
from jaxrelight.precomputation.cloud_layers import make_indirect
from jaxrelight.precomputation.layers import Made, Report, check_terms_of, make_layers
from jaxrelight.precomputation.load import Placed, load
from jaxrelight.scene.scene import Scene
from jaxrelight.transport.bounce import Gather, remaining


@dataclasses.dataclass(frozen=True)
class Summary:
    """What a precomputation did.

    Attributes:
        folder: the store.
        seconds: by stage; stages that were found done take next to nothing.
        rays: traced in this run, but for those that bounced light is gathered along.
        receivers: number of vertices or pixels.
        nbytes: on disk, by kind of layer.
        header: what the store's header says of this scene; another process may write another one meanwhile.
        placed: the geometry, for `load`.
        notes: what the settings cost that one might not expect, one line each.
    """

    folder: pathlib.Path
    seconds: dict[str, float]
    rays: int
    receivers: int
    nbytes: dict[str, int]
    header: dict
    placed: Placed
    notes: tuple[str, ...] = ()


def precompute(
    scene: Scene,
    settings: Settings = Settings(),
    folder: str | pathlib.Path | None = None,
    report: Report = lambda stage, done, total: None,
) -> Summary:
    """Makes, or completes, the store of a scene.

    Layers that exist are reused: a changed material bakes its own groups again, from stored visibility; only a changed
    mesh, or camera where receivers are pixels, is traced again. A run that was stopped goes on where it was.

    With bounces, every pass gathers from the rows of direct light and of the bounces before (Wang 2006 §3.2), which are
    of vertices, whatever the receivers of the last pass are. What it gathers is kept in clusters, beside direct light.

    Args:
        scene: what to precompute; its environment is stored as the default light.
        settings: the dials.
        folder: the store; by default one in the user's cache folder, named by the geometry.
        report: called when a stage that has something to do starts, and after every group.

    Raises:
        InputError: for a scene that transport cannot be precomputed of; with bounces, where a material reflects all
            light or more.
    """
    if not settings.gather_samples:
        scene.check_distant()
    scene.check_materials()
    if settings.gather_samples:
        return _finished(make_indirect(scene, settings, folder, report, seconds := {}), seconds, [])
    # Bounces pass through vertices, whatever the receivers are.
    checked = _of_pass(settings, 0) if settings.bounces else settings
    for part in scene.parts:
        check_terms_of(scene, part.material, checked)
    albedo = _largest_albedo(scene) if settings.bounces else 0.0
    seconds: dict[str, float] = {}
    passes, left = [], 1.0
    gather, transport = None, None
    while len(passes) < settings.bounces and left > settings.tolerance:
        passes.append(make_layers(scene, _of_pass(settings, len(passes)), folder, report, seconds, gather))
        before, transport = transport, load(passes[-1].folder, passes[-1].header, passes[-1].placed)
        left = remaining(transport, before, albedo)
        key = store.key_of(passes[-1].header["geometry"], passes[-1].header["materials"])
        gather = Gather(transport, key, settings.gather_resolution, settings.gather == "nearest")
    bounces = len(passes)
    made = make_layers(scene, dataclasses.replace(settings, bounces=bounces), folder, report, seconds, gather)
    notes = []
    if bounces < settings.bounces:
        notes.append(
            f"{bounces} of {settings.bounces} bounces were made: the others would add {left:.1%} of light at most"
        )
    return _finished(made, seconds, passes, notes)


def _finished(made: Made, seconds: dict[str, float], passes: Sequence[Made], notes: Sequence[str] = ()) -> Summary:
    """Writes the store's header."""
    header = {**made.header, "passes": [_layers(one) for one in passes]}
    store.write_header(made.folder, header)
    nbytes = collections.Counter()
    for name in set(store.layers_of(header)):
        nbytes[name.split("-")[0]] += store.bytes_on_disk(made.folder / name)
    rays = made.rays + sum(one.rays for one in passes)
    count = made.placed.receivers.count
    return Summary(made.folder, seconds, rays, count, dict(nbytes), header, made.placed, (*made.notes, *notes))


def _of_pass(settings: Settings, bounces: int) -> Settings:
    """Those of the light that the next pass is gathered from."""
    compressed = settings
    if settings.coefficients == "all":
        compressed = dataclasses.replace(settings, coefficients="shared")
    return dataclasses.replace(compressed, receivers="vertices", bounces=bounces)


def _layers(made: Made) -> list[str]:
    """The layers that a pass has of its own."""
    own = [
        name for name in store.layers_of(made.header) if name.partition("-")[0] in ("factors", "transport", "bounced")
    ]
    return sorted({made.header["visibility"], *own})


def _largest_albedo(scene: Scene) -> float:
    """Of the scene's materials, each the mean over its textures.

    Raises:
        InputError: if one reflects all light, or more, so that bounces would not end.
    """
    found = 0.0
    for name in sorted({part.material for part in scene.parts}):
        albedo = largest_albedo(as_material(scene.materials[name]))
        # Of the quadrature that it is found by.
        if albedo >= 1 - 1e-4:
            raise InputError(
                f"{scene.name}: material '{name}' reflects {albedo:.3f} of the light that it gets; bounced light needs "
                "less than 1 of every material: make it darker, or leave --bounces out"
            )
        found = max(found, albedo)
    return found
