"""From a scene to a store: layers of direct light, then as many passes of bounced light as are asked for."""

import collections
import contextlib
import dataclasses
import pathlib
from collections.abc import Sequence

from jaxrelight.brdf.albedo import largest_albedo
from jaxrelight.brdf.material import as_material
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.methods import Indirect, Transport
from jaxrelight.precomputation.account import Account, account_from, account_of
from jaxrelight.precomputation.chosen_resolution import with_resolution
from jaxrelight.precomputation.cloud_layers import make_indirect
from jaxrelight.precomputation.layers import BuiltLayers, check_terms_of, make_layers
from jaxrelight.precomputation.load import load
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.timing import timed
from jaxrelight.transport.bounce import Gather, remaining
from jaxrelight.transport.hits import NO_RAYS, GatherRays
from jaxrelight.transport.model import PrecomputedTransport, SceneGeometry


@dataclasses.dataclass(frozen=True)
class StoreBuild:
    """What a precomputation did.

    Attributes:
        folder: the store.
        seconds: by stage; stages that were found done take next to nothing.
        rays: traced in this run, but for those that bounces of transport are gathered along.
        receivers: number of vertices or pixels.
        nbytes: on disk, by kind of layer.
        header: what the store's header says of this scene; another process may write another one meanwhile.
        geometry: of the scene, for `load`.
        notes: what the dials cost that one might not expect, one line each.
        gather_rays: those of all bounces of this run.
        account: what was left out, what that saved and what it costs; None for light of a cloud.
    """

    folder: pathlib.Path
    seconds: dict[str, float]
    rays: int
    receivers: int
    nbytes: dict[str, int]
    header: dict
    geometry: SceneGeometry
    notes: tuple[str, ...] = ()
    gather_rays: GatherRays = NO_RAYS
    account: Account | None = None


def precompute(
    scene: Scene,
    method: Transport | Indirect,
    folder: str | pathlib.Path | None = None,
    report: Report = lambda stage, done, total: None,
) -> StoreBuild:
    """Makes, or completes, the store of a scene.

    Layers that exist are reused: a changed material bakes its own groups again, from stored visibility; only a changed
    mesh, or camera where receivers are pixels, is traced again. A run that was stopped goes on where it was.

    With bounces, every pass gathers from the rows of direct light and of the bounces before (Wang 2006 §3.2), which are
    of vertices, whatever the receivers of the last pass are. What it gathers is kept in clusters, beside direct light.

    A resolution of "auto" becomes a number first, see `chosen_resolution`; the header has both.

    Args:
        scene: what to precompute; its environment is stored as the default light.
        method: the dials.
        folder: the store; by default one in the user's cache folder, named by the geometry.
        report: called when a stage that has something to do starts, and after every group.

    Raises:
        InputError: for a scene that transport cannot be precomputed of; with bounces, where a material reflects all
            light or more.
    """
    check_scene(scene, method)
    if isinstance(method, Indirect):
        return _finished(make_indirect(scene, method, folder, report, seconds := {}), seconds, [])
    albedo = _largest_albedo(scene) if method.bounces else 0.0
    seconds: dict[str, float] = {}
    method, chosen, rays = with_resolution(scene, method, folder, report, seconds)
    passes, left = [], 1.0
    gather, transport = None, None
    # Bounces are of rows, which filtered lobes have none of.
    in_factors = dataclasses.replace(scene, reflections={})
    while len(passes) < method.bounces and left > method.compression_tolerance:
        passes.append(make_layers(in_factors, _of_pass(method, len(passes)), folder, report, seconds, gather))
        before = transport
        transport = _transport_of(passes[-1].folder, passes[-1].header, passes[-1].geometry)
        left = remaining(transport, before, albedo)
        key = store.key_of(passes[-1].header["geometry"], passes[-1].header["materials"])
        gather = Gather(transport, key, method.gather_resolution, method.gather == "nearest", method.rays)
    bounces = len(passes)
    built = make_layers(scene, dataclasses.replace(method, bounces=bounces), folder, report, seconds, gather)
    notes = [str(chosen)] if chosen else []
    if bounces < method.bounces:
        notes.append(
            f"{bounces} of {method.bounces} bounces were made: the others would add {left:.1%} of light at most"
        )
    if chosen:
        built = dataclasses.replace(
            built, header={**built.header, "chosen_resolution": chosen.to_record()}, rays=built.rays + rays
        )
    with timed(seconds, "account"):
        account = _account(built, method)
    return _finished(built, seconds, passes, notes, account)


def _account(built: BuiltLayers, method: Transport) -> Account:
    """What was left out: as the store tells it of the same layers, or measured."""
    with contextlib.suppress(InputError, KeyError, TypeError):
        known = store.read_header(built.folder, _header_name(built.header))["account"]
        if known["of"] == _account_key(built):
            return account_from(known["numbers"])
    geometry, visibility = built.geometry, store.open_layer(built.folder / built.header["visibility"])
    assert geometry.receivers is not None
    return account_of(method, geometry.tracer, geometry.receivers, visibility, built.rows, built.finer)


def _account_key(built: BuiltLayers) -> str:
    """Of the layers that it tells of."""
    rows = [one.layer.folder.name for one in built.rows if one.layer is not None]
    return store.key_of(built.header["visibility"], rows)


def check_scene(scene: Scene, method: Transport | Indirect) -> None:
    """Refuses, before long work, materials that cannot be put on a scene, factors that cannot be had, and dials.

    Raises:
        InputError: for the first of them.
    """
    scene.check_materials()
    if scene.of_sensors and method.receivers == "vertices":
        raise InputError("sensors are receivers of their own, not vertices; leave receivers at 'pixels'")
    if isinstance(method, Transport):
        # Bounces pass through vertices, whatever the receivers are.
        checked = _of_pass(method, 0) if method.bounces else method
        for part in scene.parts:
            check_terms_of(scene, part.material, checked)


def _finished(
    built: BuiltLayers,
    seconds: dict[str, float],
    passes: Sequence[BuiltLayers],
    notes: Sequence[str] = (),
    account: Account | None = None,
) -> StoreBuild:
    """Writes the store's header."""
    header = {**built.header, "passes": [_layers(one) for one in passes]}
    if account is not None:
        header["account"] = {"of": _account_key(built), "numbers": account.to_record()}
    store.write_header(built.folder, header, _header_name(header))
    nbytes = collections.Counter()
    for name in set(store.layers_of(header)):
        nbytes[name.split("-")[0]] += store.bytes_on_disk(built.folder / name)
    rays = built.rays + sum(one.rays for one in passes)
    assert built.geometry.receivers is not None
    count = built.geometry.receivers.count
    return StoreBuild(
        folder=built.folder,
        seconds=seconds,
        rays=rays,
        receivers=count,
        nbytes=dict(nbytes),
        header=header,
        geometry=built.geometry,
        notes=(*built.notes, *notes),
        gather_rays=GatherRays.total([built.gather_rays, *(one.gather_rays for one in passes)]),
        account=account,
    )


def _header_name(header: dict) -> str:
    return store.SENSOR_HEADER if "sensors" in header else store.HEADER


def _transport_of(folder: pathlib.Path, header: dict, geometry: SceneGeometry) -> PrecomputedTransport:
    transport = load(folder, header, geometry)
    assert isinstance(transport, PrecomputedTransport)
    return transport


def _of_pass(method: Transport, bounces: int) -> Transport:
    """The dials of the light that the next pass is gathered from."""
    coefficients = "shared" if method.coefficients == "all" else method.coefficients
    return dataclasses.replace(
        method, coefficients=coefficients, receivers="vertices", bounces=bounces, reflection="factors"
    )


def _layers(built: BuiltLayers) -> list[str]:
    """The layers that a pass has of its own."""
    own = [
        name for name in store.layers_of(built.header) if name.partition("-")[0] in ("factors", "transport", "bounced")
    ]
    return sorted({built.header["visibility"], *own})


def _largest_albedo(scene: Scene) -> float:
    """The largest albedo of the scene's materials, each the mean over its textures.

    Raises:
        InputError: if one reflects all light, or more, so that bounces would not end.
    """
    largest = 0.0
    for name in sorted({part.material for part in scene.parts}):
        albedo = largest_albedo(as_material(scene.materials[name]))
        # The margin is for the error of the albedo's quadrature.
        if albedo >= 1 - 1e-4:
            raise InputError(
                f"{scene.name}: material '{name}' reflects {albedo:.3f} of the light that it gets; bounced light needs "
                "less than 1 of every material: make it darker, or leave --bounces out"
            )
        largest = max(largest, albedo)
    return largest
