"""Options that several commands share. Nothing heavy is imported here, so that --help stays quick."""

import dataclasses
import pathlib
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxrelight.errors import InputError

if TYPE_CHECKING:
    from jaxrelight.geometry.camera import Camera
    from jaxrelight.lights.lights import Lights

_SCENE = "A scene file (.toml), or a mesh alone (.ply, .obj, .stl, .glb, .gltf), which is put on a floor and framed."
_UP = "The upward axis of mesh files, where the scene does not say: 'z' for those of CAD programs and of Blender."
Up = Annotated[Literal["y", "z"], tyro.conf.arg(help=_UP)]
_ANTIALIASING = (
    "Samples of surfaces in a pixel, which smooth edges. Where receivers are pixels, as by default, samples have "
    "coverage and local lights of their own, and precomputed light of their pixels."
)
Antialiasing = Annotated[Literal[1, 4, 16], tyro.conf.arg(help=_ANTIALIASING)]
_MODULES = "A Python module that is imported first, with BRDFs or lights of your own; may be given again."
ScenePath = Annotated[tyro.conf.Positional[pathlib.Path], tyro.conf.arg(help=_SCENE)]
Output = Annotated[pathlib.Path, tyro.conf.arg(aliases=["-o"], metavar="FILE", help="The picture: .exr, .hdr or .png.")]
Modules = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(name="import", metavar="MODULE", help=_MODULES)
]
_ERROR_SAMPLES = "Pixels at which the picture is compared with the exact reference of its lighting method; 0 for none."
ErrorSamples = Annotated[int, tyro.conf.arg(help=_ERROR_SAMPLES)]
_STORE = "The store's folder; by default one in the user's cache folder."
StoreFolder = Annotated[pathlib.Path | None, tyro.conf.arg(help=_STORE)]
# Those that light sensors and inverse problems; adaptive lighting plans its samples for one light and one picture.
LinearLighting = Literal["auto", "transport", "indirect", "prefiltered"]
ReportFolder = Annotated[pathlib.Path | None, tyro.conf.arg(metavar="DIR")]
Json = Annotated[bool, tyro.conf.arg(help="Print one JSON object at the end.")]


def import_modules(names: Sequence[str]) -> None:
    """Imports modules from the current folder or the path, with classes of BRDFs and lights that a store may name.

    Raises:
        InputError: for one that cannot be imported.
    """
    if names:
        from jaxrelight.files.class_record import import_classes

        sys.path.insert(0, "")  # the current folder
        for name in names:
            import_classes(name)


def make_folder(option: str, folder: pathlib.Path | None) -> None:
    """Makes the folder that an option names, before long work; nothing where it names none.

    Raises:
        InputError: where it cannot be made.
    """
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{option} {folder}: {error.strerror}") from None


def check_toml(output: pathlib.Path | None, what: str) -> None:
    """Refuses, before long work, a file that cannot be written as TOML; nothing where there is none.

    Raises:
        InputError: for another kind of file, or a folder that there is not.
    """
    if output is None:
        return
    if output.suffix.lower() != ".toml":
        raise InputError(f"{output}: {what} are written as .toml; name such a file")
    if not output.parent.is_dir():
        raise InputError(f"{output}: there is no folder {output.parent}; make it, or name another one")


@dataclasses.dataclass(frozen=True)
class LightOptions:
    """The environment; what is not given is the scene's."""

    env: pathlib.Path | None = None
    """A picture of the whole sphere: .exr, .hdr, .png, .jpg, .webp or .tga."""
    layout: Literal["auto", "latlong", "strip", "cross", "openexr_cube", "probe", "mirror_ball"] = "auto"
    """How that picture shows it: as a lat-long map, as cube faces, or as a disc, probe or mirror ball."""
    rotate_y: float | None = None
    """Degrees that it is turned about +y, counter-clockwise seen from above."""
    scale: float | None = None
    """Factor on its radiance."""
    zero_nonfinite: bool = False
    """Set NaN and infinite pixels of the map to 0 instead of refusing it."""

    def lights(self, default: "Lights", emits: bool, local_file: pathlib.Path | None = None) -> "Lights":
        """The light that these options and the scene's own make together.

        Args:
            default: the scene's.
            emits: whether surfaces emit light.
            local_file: whose local lights take the place of the scene's.

        Raises:
            InputError: where there is no light, or options need an environment that is not there.
        """
        from jaxrelight.lights.environment import load_environment
        from jaxrelight.lights.lights import Lights
        from jaxrelight.scene.scene_file import load_lights

        environment = default.environment
        if self.env is not None:
            turn, scale = self.rotate_y or 0.0, 1.0 if self.scale is None else self.scale
            environment = load_environment(
                self.env, turn, scale, layout=self.layout, zero_nonfinite=self.zero_nonfinite
            )
        elif self.layout != "auto":
            raise InputError("--layout says how --env MAP is read; give both, or set 'layout' in the scene")
        elif environment is not None:
            environment = environment.with_(self.rotate_y, self.scale)
        elif self.rotate_y is not None or self.scale is not None:
            raise InputError("the scene has no environment; name one with --env MAP")
        lights = Lights(environment, load_lights(local_file) if local_file else default.local)
        if not lights and not emits:
            raise InputError("there is no light; name an environment with --env MAP, or give the scene a [[light]]")
        return lights


@dataclasses.dataclass(frozen=True)
class ViewOptions:
    """The camera; what is not given is the scene's."""

    origin: tuple[float, float, float] | None = None
    """Where the eye is."""
    target: tuple[float, float, float] | None = None
    """What the image centre shows."""
    fov_y: float | None = None
    """Vertical field of view in degrees."""
    width: int | None = None
    """Pixels in a row."""
    height: int | None = None
    """Rows."""
    antialiasing: Antialiasing = 4

    def camera(self, default: "Camera") -> "Camera":
        """The camera that these options and the scene's own make together."""
        return dataclasses.replace(default, **self.changes)

    @property
    def changes(self) -> dict[str, Any]:
        """What is given of the camera."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: value for name, value in values.items() if value is not None and name != "antialiasing"}


_EXPOSURE = (
    "Stops by which a .png is made brighter; .exr and .hdr hold radiance. 'auto' shows the 95th percentile of the "
    "brightest channel of surfaces at 0.8 of white. Adaptive lighting plans its samples for displayed values, so "
    "there a number steers the samples of every picture."
)
_TONE = "From radiance to what a .png shows: 'linear' clips at white; 'filmic' (Hable) and 'agx' (Sobotka) roll off."
Exposure = Annotated[float | Literal["auto"], tyro.conf.arg(help=_EXPOSURE)]
Tone = Annotated[Literal["linear", "filmic", "agx"], tyro.conf.arg(help=_TONE)]


@dataclasses.dataclass(frozen=True)
class PictureOptions:
    """The image file."""

    background: Literal["environment", "none"] = "environment"
    """What is seen where no surface is."""
    exposure: Exposure = "auto"
    tone: Tone = "linear"
