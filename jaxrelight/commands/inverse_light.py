"""jaxrelight inverse light: the environment of a known scene, from pictures of it."""

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.options import (
    Json,
    LinearLighting,
    Modules,
    ReportFolder,
    StoreFolder,
    Up,
    import_modules,
    make_folder,
)
from jaxrelight.commands.summary import summary_of
from jaxrelight.errors import InputError
from jaxrelight.timing import timed

if TYPE_CHECKING:
    from jaxrelight.inverse.solve_light import InverseLight
    from jaxrelight.lighting.contract import Relighter
    from jaxrelight.progress import Report


@dataclasses.dataclass(frozen=True)
class InverseLightCommand:
    """Solve pictures of a known scene for the environment that lights it, and say what they tell of it.

    Pictures are linear radiance, as .exr or .hdr files; where one has coverage, pixels count that show a surface.
    """

    scene: Annotated[tyro.conf.Positional[pathlib.Path], tyro.conf.arg(metavar="SCENE|STORE")]
    """A scene file, or a store of one."""
    pictures: Annotated[tyro.conf.Positional[tuple[pathlib.Path, ...]], tyro.conf.arg(metavar="PICTURE")]
    """Pictures of the scene, of its camera's size."""
    output: Annotated[pathlib.Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None
    """An .exr or .hdr file for the environment, which --env of other commands reads."""
    cameras: Annotated[tuple[pathlib.Path, ...], tyro.conf.arg(metavar="SCENE")] = ()
    """Scene files whose [camera] took the pictures, one for each; by default the scene's camera took all."""
    unknowns: int = 16
    """Texels along an edge of the unknown cube map, or rows of the map with --latlong: a power of two."""
    latlong: bool = False
    """Seek a lat-long map instead of a cube map."""
    prior: Literal["natural", "sparse"] = "natural"
    """What light is like: as in photographed environments, or few wavelets of it."""
    any_sign: bool = False
    """Let radiance be negative where pictures ask for that."""
    lamps: bool = False
    """Seek the strengths of the scene's local lights, too."""
    exposures: Literal["known", "exposure", "white-balance"] = "known"
    """Whether a factor on each picture but the first, or one on each of its channels, is unknown."""
    saturation: float | None = None
    """What pictures show at most: pixels there count as at least as bright."""
    mask: pathlib.Path | None = None
    """A picture that is white where pixels count."""
    hold_out: float = 0.1
    """The share of pixels that is not fitted, which chooses how smooth the light is and tells the error."""
    lighting: LinearLighting = "auto"
    """The lighting method, as for `render`."""
    store: StoreFolder = None
    report: ReportFolder = None
    """A folder for pictures of the fit, of the light, and of what is told of it."""
    up: Up = "y"
    modules: Modules = ()
    json: Json = False

    # What `with_dials` tells of the method that cannot measure.
    cannot: ClassVar[str] = "draws its samples by one light; solve with another method"

    def run(self) -> None:
        """Runs the command."""
        with summary_of("inverse light", self.json) as (summary, seconds):
            with timed(seconds, "imports"):
                from jaxrelight.commands.pictures import describe
                from jaxrelight.images import check_writable, write_image
                from jaxrelight.inverse.light_report import write_light_report
                from jaxrelight.inverse.solve_light import environment
                from jaxrelight.progress import notes, progress

                import_modules(self.modules)
            if self.output is not None:
                if self.output.suffix.lower() not in (".exr", ".hdr"):
                    raise InputError(f"{self.output}: radiance is written as .exr or .hdr; name such a file")
                check_writable(self.output)
            make_folder("--report", self.report)
            with timed(seconds, "load"):
                pictures, masks = self._read()
            with progress(self.json) as report:
                relighter, scene_lamps = self._relighter(report, summary, seconds)
                with timed(seconds, "solve"):
                    found = environment(
                        relighter,
                        pictures,
                        self._views(relighter, len(pictures)),
                        unknowns=(self.unknowns, 2 * self.unknowns) if self.latlong else self.unknowns,
                        prior=self.prior,
                        not_negative=not self.any_sign,
                        lamps=scene_lamps,
                        exposures="white balance" if self.exposures == "white-balance" else self.exposures,
                        masks=masks,
                        saturation=self.saturation,
                        hold_out=self.hold_out,
                        report=report,
                    )
            notes(found.notes)
            if self.output is not None:
                write_image(self.output, found.environment.pixels)
                summary["environment"] = str(self.output)
            if self.report is not None:
                with timed(seconds, "report"):
                    summary["report"] = {"folder": str(self.report), **write_light_report(self.report, found, pictures)}
            summary |= told(found)
            if not self.json:
                print("\n".join(lines_of(found)), flush=True)
            summary |= describe(relighter)

    def _read(self) -> tuple[list[Any], list[Any]]:
        """Pictures, and which of their pixels count."""
        import numpy as np

        from jaxrelight.images import read_image

        if not self.pictures:
            raise InputError("there is no PICTURE to solve for light; name at least one")
        own = None if self.mask is None else np.asarray(read_image(self.mask))[..., :3].mean(axis=2) > 0.5
        pictures, masks = [], []
        for path in self.pictures:
            image = np.asarray(read_image(path), np.float32)
            mask = image[..., 3] > 0.999 if image.shape[-1] == 4 else np.ones(image.shape[:2], bool)
            if own is not None:
                if own.shape != mask.shape:
                    raise InputError(f"{self.mask}: is {own.shape}, and {path} {mask.shape}; give a mask of its size")
                mask = mask & own
            pictures.append(image[..., :3])
            masks.append(mask)
        return pictures, masks

    def _relighter(self, report: "Report", summary: dict, seconds: dict[str, float]) -> tuple["Relighter", Any]:
        """What lights the scene, and the lamps whose strength is sought."""
        from jaxrelight.commands.pictures import prepared
        from jaxrelight.lighting.prepare import open_store
        from jaxrelight.progress import notes
        from jaxrelight.scene.mesh_scene import open_scene

        if self.scene.is_dir():
            with timed(seconds, "open"):
                relighter = open_store(self.scene)
            lights, summary["store"] = relighter.scene_lights(), str(self.scene)
        else:
            scene = open_scene(self.scene, up=self.up)
            notes(scene.notes)
            relighter = prepared(scene, method_of(self), self.store, report, summary, seconds)
            lights = scene.lights
        if lights.local and not self.lamps:
            raise InputError("the scene has local lights; seek their strengths with --lamps, or take them out of it")
        return relighter, lights.local

    def _views(self, relighter: "Relighter", count: int) -> Any:
        """The cameras of the pictures."""
        from jaxrelight.scene.scene_file import load_camera

        if not self.cameras:
            return None
        if len(self.cameras) != count:
            raise InputError(f"{len(self.cameras)} cameras were named for {count} pictures; name one for each")
        return [load_camera(path) for path in self.cameras]


def told(found: "InverseLight") -> dict[str, Any]:
    """What a summary says of found light."""
    return {
        "residual": found.residual,
        "held_out": found.held_out,
        "told": list(found.certainty.told),
        "unknowns": found.certainty.grid.size,
        "singular_values": found.singular_values.max(axis=1).tolist(),
        "strength": found.strength,
        "applications": found.applications,
        "exposures": found.exposures.tolist(),
        "lamp_factors": found.lamp_factors.tolist(),
        "saturated": found.saturated,
    }


def lines_of(found: "InverseLight") -> list[str]:
    """Lines that tell how well light fits and what is told of it."""
    size, least = found.certainty.grid.size, min(found.certainty.told)
    held_out = "" if found.held_out is None else f", {found.held_out:.2%} on pixels that were held out"
    lines = [
        f"the light misses the pictures by {found.residual:.2%}{held_out}",
        f"the pictures tell {least:,} of {size:,} numbers of the environment; the others are as natural light has them",
    ]
    lines += [f"lamp {n}: times {', '.join(f'{of:.4g}' for of in f)}" for n, f in enumerate(found.lamp_factors, 1)]
    if (found.exposures != 1).any():
        lines += [f"picture {n}: times {', '.join(f'{of:.4g}' for of in e)}" for n, e in enumerate(found.exposures, 1)]
    return lines
