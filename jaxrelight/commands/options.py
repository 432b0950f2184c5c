"""Options that several commands share. Nothing heavy is imported here, so that --help stays quick."""

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from jaxrelight.geometry.camera import Camera
    from jaxrelight.lights.environment import Environment
    from jaxrelight.methods import Settings

Output = Annotated[pathlib.Path, tyro.conf.arg(aliases=["-o"], metavar="FILE")]


@dataclasses.dataclass(frozen=True)
class PrecomputeOptions:
    """What is precomputed, and how finely."""

    resolution: int = 64
    """Side of the six faces of the cube map that light is given on; a power of two. Rays and time grow with its
    square; sharper shadows and highlights need more."""
    visibility_samples: int = 1
    """Rays for each texel of the cube map: 1, 4, 9, 16 or 25."""
    terms: int = 4
    """Factors of a glossy material where receivers are vertices. Glossier materials need more; time and bytes grow
    with them. Diffuse materials always have 1."""
    coefficients: int | Literal["shared", "all"] = "shared"
    """How direct light is kept: 'shared' between near receivers, a few rows over a few wavelet coefficients, as many as
    --tolerance asks for; a number of coefficients for each row; or 'all': exact, but slow to relight. Bounced light is
    always shared."""
    factor_resolution: int = 48
    """Side of the maps of a glossy material's factors."""
    tolerance: float | None = None
    """What shared rows may leave out, relative to a group's radiance under natural light, and how much light further
    bounces may add before they are left out, by default 0.02. Under adaptive lighting, the root-mean-square error of
    displayed values, which range from 0 to 1; by default 0.01."""
    bits: Literal[8, 16, 32] = 32
    """Of every number of compressed transport: 8 take a third of the bytes, and add less than what is left out."""
    bounces: int | None = None
    """How often light is reflected at most on its way from the first surface to the last; by default 0, and 3 for
    local lights. Under an environment each takes minutes where many surfaces see each other; relighting costs little
    more."""
    gather_resolution: int = 32
    """Side of the six faces of the cube map that receivers look around with for bounced light."""
    gather: Literal["barycentric", "nearest"] = "barycentric"
    """Where bounced light is read: between the corners of each face that is seen, or at the nearest one."""

    def settings(self, receivers: Literal["vertices", "pixels"]) -> "Settings":
        """As the library takes them."""
        from jaxrelight.methods import Settings

        return Settings(
            receivers,
            self.resolution,
            self.visibility_samples,
            self.terms,
            self.coefficients,
            self.factor_resolution,
            Settings.tolerance if self.tolerance is None else self.tolerance,
            self.bits,
            self.bounces or 0,
            self.gather_resolution,
            self.gather,
        )


@dataclasses.dataclass(frozen=True)
class CloudOptions:
    """Points that stand for all surfaces under local lights, and how light is gathered from them."""

    gather_samples: int = 16384
    """How many points; a power of four. More show smaller shadows in indirect light; time and bytes grow with them."""
    solid_angle: float = 0.1
    """Points that are far for their distance from each other are gathered from together: where the square of their
    extent is less than this times that of their distance."""
    peak: float = 0.01
    """Points that lie in the peak of a glossy BRDF are told apart: where together they would give more than this share
    of all that is reflected; 1 for nowhere, which is faster and blurs sharp reflections."""
    near: Literal["disc", "clamp"] = "disc"
    """Light of near points: 'disc' keeps its energy, 'clamp' is bounded as in the paper, and darker in corners."""
    importance: bool = False
    """Put more points where they light what the camera sees: for scenes of which it sees a small part."""
    photons: int = 0
    """What points get from each other by so many photons that they shoot, the paper's way; 0 gathers it."""
    sky: bool = False
    """A quarter of the points are directions of the sky: another environment then costs what moving a lamp does, and
    its shadows are as coarse as those points; without, it is many distant lights, which all cast sharp ones."""
    seed: int = 0
    """Of where the points lie, of photons, and of samples under adaptive lighting."""

    def settings(self, dials: PrecomputeOptions) -> "Settings":
        """As the library takes them, with those dials that rows from points have, too.

        Raises:
            InputError: for a dial that they have not.
        """
        from jaxrelight.methods import Settings

        named = "coefficients", "tolerance", "bits", "bounces"
        refuse_others(dials, PrecomputeOptions(), "transport", named)
        bounces = 3 if dials.bounces is None else dials.bounces
        tolerance = Settings.tolerance if dials.tolerance is None else dials.tolerance
        kept = {"coefficients": dials.coefficients, "tolerance": tolerance, "bits": dials.bits}
        return Settings("pixels", bounces=bounces, **kept, **vars(self))


@dataclasses.dataclass(frozen=True)
class LocalOptions:
    """The picture under local lights."""

    samples: int | None = None
    """Samples of direct light along each side of a pixel, by default 2. Under adaptive lighting, samples of a pixel, on
    average: a budget in place of --tolerance."""
    layers: bool = False
    """Write direct light, indirect light by its last reflection and each light as layers of the .exr."""


def refuse_others(given, default, lighting: str, known: tuple[str, ...] = ()):
    """Refuses options that another kind of lighting has.

    Raises:
        InputError: for the first that is not as by default.
    """
    from jaxrelight.errors import InputError

    for name, value in vars(given).items():
        if name not in known and value != getattr(default, name):
            raise InputError(f"--{name.replace('_', '-')} is a dial of --lighting {lighting}; leave it out")


@dataclasses.dataclass(frozen=True)
class LightOptions:
    """The light; what is not given is the scene's."""

    env: pathlib.Path | None = None
    """A picture of the whole sphere: .exr, .hdr, .png or .jpg."""
    layout: Literal["auto", "latlong", "strip", "cross"] = "auto"
    """How that picture shows it: as a lat-long map, or as cube faces in a strip or a cross."""
    rotate_y: float | None = None
    """Degrees that it is turned about +y, counter-clockwise seen from above."""
    scale: float | None = None
    """Factor on its radiance."""
    zero_nonfinite: bool = False
    """Set NaN and infinite pixels of the map to 0 instead of refusing it."""

    def environment(self, default: "Environment | None", *, emits: bool = False) -> "Environment":
        """The environment that these options and the scene's own make together; a black one if surfaces emit light."""
        import dataclasses

        import numpy as np

        from jaxrelight.errors import InputError
        from jaxrelight.lights.environment import Environment, load_environment

        if self.env is not None:
            return load_environment(
                self.env,
                self.rotate_y or 0.0,
                1.0 if self.scale is None else self.scale,
                layout=self.layout,
                zero_nonfinite=self.zero_nonfinite,
            )
        if self.layout != "auto":
            raise InputError("--layout says how --env MAP is read; give both, or set 'layout' in the scene")
        if default is None and emits:
            return Environment(np.zeros((2, 4, 3), np.float32))
        if default is None:
            raise InputError("the scene has no environment; name one with --env MAP")
        return dataclasses.replace(
            default,
            rotate_y=default.rotate_y if self.rotate_y is None else self.rotate_y,
            scale=default.scale if self.scale is None else self.scale,
        )


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

    def camera(self, default: "Camera") -> "Camera":
        """The camera that these options and the scene's own make together."""
        given = {name: value for name, value in dataclasses.asdict(self).items() if value is not None}
        return dataclasses.replace(default, **given)


@dataclasses.dataclass(frozen=True)
class PictureOptions:
    """The image file."""

    background: Literal["environment", "none"] = "environment"
    """What is seen where no surface is."""
    exposure: float = 0.0
    """Stops by which a .png is made brighter; .exr and .hdr hold radiance."""
