"""The four lighting methods: their dials, with ranges and defaults, and what they leave out.

Each dial is documented here alone. Python, the command line, `--json` and the guide read it from these classes. Nothing
heavy is imported, so that `--help` stays quick.
"""

import ast
import dataclasses
import functools
import inspect
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from jaxrelight.errors import InputError


@dataclasses.dataclass(frozen=True)
class Method:
    """A lighting method: a frozen set of dials. `prepare` makes a relighter of a scene and a method.

    Attributes:
        is_stored: whether it precomputes a store that other lights reuse.
        advanced: dials that `--help-all` shows and `--help` does not.
    """

    is_stored: ClassVar[bool]
    advanced: ClassVar[frozenset[str]] = frozenset()

    @property
    def name(self) -> str:
        """What the command line and stores call it."""
        return type(self).__name__.lower()

    def leaves_out(self, environment: bool, local: bool) -> tuple[str, ...]:
        """What its pictures lack under an environment, or local lights, in words; reported with every picture."""
        return ()


# How vertices reflect lobes; see `Transport.reflection`.
REFLECTIONS = ("filtered", "factors", "traced")
BETWEEN_SURFACES = "light that surfaces reflect onto each other"
# What a resolution of "auto" is one of; the last is what the others are compared with.
RESOLUTIONS_BY_NEED: tuple[int, ...] = 16, 32, 64, 128, 256

if TYPE_CHECKING:
    # "auto" is a number before anything is precomputed, which checkers cannot know: all that reads it reads a number.
    Resolution = Any
else:
    Resolution = int | Literal["auto"]


@dataclasses.dataclass(frozen=True)
class Transport(Method):
    """Precomputed transport of distant light with shadows, glossy materials and bounces (Wang 2006).

    An environment is lit from the precomputed operator. Local lights are direct light with shadow rays; what they
    bounce takes `Indirect`.

    Raises:
        InputError: for a dial outside its range.
    """

    is_stored: ClassVar[bool] = True
    advanced: ClassVar[frozenset[str]] = frozenset(
        {
            "visibility_samples",
            "rays",
            "receiver_tolerance",
            "reflection_tolerance",
            "reflection_rays",
            "factor_resolution",
            "split_sun",
        }
        | {"gather_resolution", "gather"}
    )

    receivers: Literal["pixels", "vertices"] = "pixels"
    """Where transport is precomputed: 'pixels' of the scene's camera are exact for that camera; 'vertices' can be
    viewed from anywhere."""
    resolution: Resolution = 64
    """Side of the six faces of the cube map that light is given on; a power of two from 4 to 512. Rays and time grow
    with its square; sharper shadows and highlights need more. 'auto' takes the least of 16, 32, 64, 128 and 256 whose
    error on a sample of receivers, under the scene's environment, is within compression_tolerance."""
    visibility_samples: int = 1
    """Rays for each texel of the cube map: 1, 4, 9, 16 or 25. Transport is averaged over them."""
    rays: Literal["adaptive", "all"] = "adaptive"
    """Which texels have rays of their own: 'adaptive' traces those where visibility changes, in a fraction of the rays;
    'all' leaves none out."""
    receiver_tolerance: float = 0.1
    """By how much light may be off halfway along an edge of a thirty-second of the scene's size, and less on longer
    ones: edges along which it is more are halved. From 0, which leaves meshes as they are, to below 1."""
    reflection: Literal["filtered", "factors", "traced"] = "filtered"
    """How vertices reflect lobes: 'filtered' multiplies each lobe's light by the share of it that is visible, sharp at
    any exponent and from any view; 'traced' takes that share from rays of each view's pixels; 'factors' are rows of
    terms, as other glossy materials and bounces always have them. A scene may give a material its own."""
    reflection_rays: int = 64
    """Rays of a pixel where reflection is traced; from 1 to 4,096."""
    reflection_tolerance: float = 0.01
    """Largest error of a filtered lobe that its width may cause; wider lobes are shaded as 7 or 19 narrower ones."""
    terms: int = 4
    """Factors of a glossy material where receivers are vertices and reflection is not filtered. Glossier materials need
    more; time and bytes grow with them. Diffuse materials always have 1."""
    coefficients: int | Literal["shared", "all"] = "shared"
    """How direct light is kept: 'shared' lets near receivers share as few rows over as few wavelet coefficients as
    compression_tolerance allows; a number keeps as many coefficients of each row, those that count most under natural
    light; 'all' compresses nothing, which is exact and slow to relight. Bounced light is always shared."""
    factor_resolution: int = 48
    """Side of the maps of a glossy material's factors, from 4 to 128."""
    compression_tolerance: float = 0.02
    """Largest error that shared rows may leave in a group's radiance under natural light, relative to its
    root-mean-square; from 0, which leaves nothing out, to below 1. No more bounces are made than leave out as much, and
    a resolution of 'auto' is chosen by it."""
    bits: Literal[8, 16, 32] = 32
    """Bits of every number of compressed transport: 8 take a third of the bytes, and add less error than what is left
    out."""
    bounces: int = 0
    """How often light is reflected at most on its way from the first surface to the last. Each bounce takes minutes
    where many surfaces see each other; relighting costs little more."""
    split_sun: bool = True
    """Integrate the few texels of a sun by themselves, with a shadow ray from every receiver to each. Without it light
    terms are exactly linear in the light, and a compressed sun has the largest error."""
    gather_resolution: int = 32
    """Side of the six faces of the cube map that receivers look around with for bounced light; even, from 4 to 256."""
    gather: Literal["barycentric", "nearest"] = "barycentric"
    """Where bounced light is read: between the corners of each face that is seen, or at the nearest corner."""

    def __post_init__(self) -> None:
        check_choice("receivers", self.receivers, ("pixels", "vertices"))
        check_choice("reflection", self.reflection, REFLECTIONS)
        check_number("reflection tolerance", self.reflection_tolerance, lambda x: 0 < x < 1, "above 0, and below 1")
        for name, low, high in (
            ("terms", 1, math.inf),
            ("reflection_rays", 1, 4096),
            ("factor_resolution", 4, 128),
            ("bounces", 0, math.inf),
            ("gather_resolution", 4, 256),
        ):
            check_whole(name, getattr(self, name), low, high)
        n = self.resolution
        if n == "auto":
            n = max(RESOLUTIONS_BY_NEED)
        elif type(n) is int and 4 <= n <= 512:
            require(n & (n - 1) == 0, f"resolution is {n}; it must be a power of two from 4 to 512")
        else:
            raise InputError(f"resolution is {n!r}; it must be a whole number from 4 to 512, or 'auto'")
        check_choice("visibility samples", self.visibility_samples, (1, 4, 9, 16, 25))
        check_choice("rays", self.rays, ("adaptive", "all"))
        _check_receiver_tolerance(self.receiver_tolerance)
        require(self.gather_resolution % 2 == 0, f"gather resolution is {self.gather_resolution}; it must be even")
        check_choice("gather", self.gather, ("barycentric", "nearest"))
        check_choice("split sun", self.split_sun, (True, False))
        _check_compression(self, ("shared", "all"), 6 * n * n)

    def leaves_out(self, environment: bool, local: bool) -> tuple[str, ...]:
        """Bounces of local lights, and of all light without bounces."""
        if not self.bounces:
            return (BETWEEN_SURFACES,)
        return ("light of local lights that surfaces reflect onto each other",) if local else ()

    @property
    def samples_per_side(self) -> int:
        """Rays along a side of a texel."""
        return math.isqrt(self.visibility_samples)


@dataclasses.dataclass(frozen=True)
class Indirect(Method):
    """Direct light and many bounces of lights at any place, for the scene's camera (Hašan 2006).

    A cloud of points stands for all surfaces. What its points reflect is gathered by pixels, and by each other.

    Raises:
        InputError: for a dial outside its range.
    """

    is_stored: ClassVar[bool] = True
    advanced: ClassVar[frozenset[str]] = frozenset(
        {"sky_samples", "coefficients", "bits", "solid_angle", "peak", "near", "importance", "photons"}
    )
    receivers: ClassVar[Literal["pixels"]] = "pixels"

    gather_samples: int = 16384
    """How many points stand for all surfaces; a power of four from 64. More show smaller shadows in indirect light;
    time and bytes grow with them."""
    bounces: int = 3
    """How often light is reflected at most on its way to the surface that is seen; 1 or more."""
    sky: bool = False
    """A quarter of the points are directions of the sky: another environment then costs what moving a lamp does, and
    its shadows are as coarse as those points. Otherwise an environment is many distant lights, which all cast sharp
    shadows."""
    sky_samples: int = 256
    """How many distant lights an environment is; more are smoother, and take longer. Unused with sky."""
    coefficients: int | Literal["shared"] = "shared"
    """How gathered light is kept: as compression_tolerance asks for, or a number of coefficients in each row."""
    compression_tolerance: float = 0.02
    """Largest error that shared rows may leave in a group's radiance, relative to its root-mean-square; from 0, which
    leaves nothing out, to below 1."""
    bits: Literal[8, 16, 32] = 32
    """Bits of every number of compressed rows."""
    solid_angle: float = 0.1
    """Points that are far for their distance from each other are gathered from together: where the square of their
    extent is less than this times that of their distance; from 0 to 10."""
    peak: float = 0.01
    """Points that lie in the peak of a glossy BRDF are told apart where together they would give more than this share
    of all that is reflected; above 0, up to 1 for nowhere, which is faster and blurs sharp reflections."""
    near: Literal["disc", "clamp"] = "disc"
    """Light of near points: 'disc' keeps its energy; 'clamp' is bounded as in the paper, and darker in corners."""
    importance: bool = False
    """Put more points where they light what the camera sees: for scenes of which it sees a small part."""
    photons: int = 0
    """Where it is not 0, what points get from each other is carried by that many photons that they shoot, the paper's
    way; 0 gathers it. Albedos of all but the last surface are in it then. Up to 10,000,000."""
    seed: int = 0
    """Seed of the places of points, and of photons; a whole number from 0."""

    def __post_init__(self) -> None:
        samples = self.gather_samples
        require(
            type(samples) is int and samples >= 64 and samples & (samples - 1) == 0 and samples.bit_length() % 2 == 1,
            f"gather samples are {samples!r}; they must be a power of four: 4,096, 16,384, 65,536, …",
        )
        for name, low, high in (
            ("bounces", 1, math.inf),
            ("sky_samples", 1, math.inf),
            ("photons", 0, 10**7),
            ("seed", 0, math.inf),
        ):
            check_whole(name, getattr(self, name), low, high)
        check_choice("sky", self.sky, (True, False))
        require(not (self.photons and self.sky), "photons do not come from the sky; leave them, or the sky, out")
        check_number("solid angle", self.solid_angle, lambda x: 0 <= x < 10, "at least 0, and below 10")
        check_number("peak", self.peak, lambda x: 0 < x <= 1, "above 0, up to 1, which splits nothing")
        check_choice("near", self.near, ("disc", "clamp"))
        check_choice("importance", self.importance, (True, False))
        require(
            self.coefficients != "all", "coefficients are 'all'; under Indirect, a compression tolerance of 0 keeps all"
        )
        _check_compression(self, ("shared",), samples)

    def leaves_out(self, environment: bool, local: bool) -> tuple[str, ...]:
        """What is not diffusely reflected on its way, and what lies between the lights that an environment is."""
        left = "caustics", "what glossy surfaces show of each other: only diffusely reflected light is passed on"
        return (*left, "what sharp lobes show of the environment, which is distant lights") if environment else left


@dataclasses.dataclass(frozen=True)
class Prefiltered(Method):
    """Environments filtered for lobes, and local lights with shadow rays (McAllister 2002). Nothing is precomputed.

    Raises:
        InputError: for a dial outside its range.
    """

    is_stored: ClassVar[bool] = False
    advanced: ClassVar[frozenset[str]] = frozenset({"horizon", "map_rows", "receiver_tolerance"})

    shadows: bool = True
    """Let local lights cast shadows."""
    occlusion_resolution: int = 8
    """Side of the six faces of the cube map along whose texels every vertex looks for what hides the environment: soft
    shadows after seconds; a power of two up to 64, or 0 for none."""
    receiver_tolerance: float = 0.2
    """By how much light may be off halfway along edges before they are halved, as under Transport, so that shadows fall
    on large faces; from 0, which leaves meshes as they are, to below 1. A store has its own vertices."""
    texels: Literal["parameters", "reflectance"] = "parameters"
    """What is interpolated between the texels of an SBRDF: its 'parameters'; or the 'reflectance' of the four texels
    around, which is right between unlike texels and takes three to five times as long."""
    minification: Literal["levels", "averaged", "none"] = "levels"
    """What is seen of an SBRDF whose texels are smaller than pixels: the coarser 'levels' that were fitted to it, as
    far as its maps have any; 'averaged' parameters; or single texels ('none')."""
    horizon: Literal["cut", "outside"] = "cut"
    """How the cosine and the horizon come in: 'cut' lets them move and sharpen each lobe; 'outside' multiplies by the
    cosine of the lobe's peak (eq. 11), which counts light from below the surface."""
    map_rows: int = 512
    """Rows of the finest filtered map; a power of two from 32. Sharper reflections need more."""

    def __post_init__(self) -> None:
        check_choice("shadows", self.shadows, (True, False))
        check_choice("texels", self.texels, ("parameters", "reflectance"))
        check_choice("minification", self.minification, ("levels", "averaged", "none"))
        check_choice("horizon", self.horizon, ("cut", "outside"))
        check_choice("occlusion resolution", self.occlusion_resolution, (0, 4, 8, 16, 32, 64))
        _check_receiver_tolerance(self.receiver_tolerance)
        check_whole("map_rows", self.map_rows, 32, 4096)
        require(self.map_rows & (self.map_rows - 1) == 0, f"map rows are {self.map_rows}; they must be a power of two")

    def leaves_out(self, environment: bool, local: bool) -> tuple[str, ...]:
        """Shadows of the environment where no ray looks for them, and all bounces."""
        without_shadows = environment and not self.occlusion_resolution
        return (*(["shadows of the environment"] if without_shadows else []), BETWEEN_SURFACES)


@dataclasses.dataclass(frozen=True)
class Adaptive(Method):
    """Samples of the environment where, and as often as, predicted bandwidth and noise ask (Bagher 2011).

    Nothing is precomputed for a mesh.

    Raises:
        InputError: for a dial outside its range, or for samples and a tolerance together.
    """

    is_stored: ClassVar[bool] = False

    tolerance: float | None = None
    """Root-mean-square error of displayed values, which range from 0 to 1, that is planned for; by default 0.01, where
    samples are not given."""
    samples: float | None = None
    """Samples of a pixel, on average: a budget in place of the tolerance."""
    shadows: bool = True
    """Let the environment and local lights cast shadows."""
    minification: Literal["levels", "averaged", "none"] = "levels"
    """What is seen of an SBRDF whose texels are smaller than pixels, as under Prefiltered."""
    exposure: float | Literal["auto"] = "auto"
    """Stops by which the picture will be made brighter before it is displayed; the error is one of displayed values.
    'auto' estimates from a few hundred pixels what `auto_exposure` will choose of the picture."""
    seed: int = 0
    """Seed of the samples; a whole number from 0."""

    def __post_init__(self) -> None:
        require(
            self.samples is None or self.tolerance is None,
            "samples are a budget and tolerance is a quality; give one of both",
        )
        for name in ("samples", "tolerance"):
            if getattr(self, name) is not None:
                check_number(name, getattr(self, name), lambda x: 0 < x < math.inf, "above 0, and finite")
        check_choice("shadows", self.shadows, (True, False))
        check_choice("minification", self.minification, ("levels", "averaged", "none"))
        if self.exposure != "auto":
            check_number("exposure", self.exposure, math.isfinite, "finite, or 'auto'")
        check_whole("seed", self.seed, 0, math.inf)

    def leaves_out(self, environment: bool, local: bool) -> tuple[str, ...]:
        """All bounces."""
        return (BETWEEN_SURFACES,)


METHODS: dict[str, type[Method]] = {
    kind.__name__.lower(): kind for kind in (Transport, Indirect, Prefiltered, Adaptive)
}


@functools.cache
def documentation(kind: type) -> dict[str, str]:
    """What each field of a dataclass is for: the texts under the fields of its class, on one line each."""
    (body,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(body, ast.ClassDef)
    texts = {}
    for field, text in zip(body.body, body.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
            assert isinstance(field.target, ast.Name)
            texts[field.target.id] = " ".join(str(text.value.value).split())
    return texts


def require(holds: bool, message: str) -> None:
    """Raises an `InputError` unless something holds."""
    if not holds:
        raise InputError(message)


def check_choice(name: str, value: object, choices: tuple) -> None:
    """Refuses a value that is none of the choices, or of another type."""
    *others, last = (repr(choice) for choice in choices)
    is_one = any(type(value) is type(choice) and value == choice for choice in choices)
    require(is_one, f"{_told(name, value)} {', '.join(others)} or {last}")


def _check_receiver_tolerance(value: object) -> None:
    check_number("receiver tolerance", value, lambda x: 0 <= x < 1, "from 0 to below 1")


def check_number(name: str, value: object, is_within: Callable[[float], bool], limits: str) -> None:
    """Refuses what is no number, or lies outside its limits."""
    is_good = isinstance(value, int | float) and not isinstance(value, bool) and is_within(value)
    require(is_good, f"{_told(name, value)} {limits}")


def check_whole(dial: str, value: object, low: float, high: float) -> None:
    """Refuses what is no whole number within a range."""
    name = dial.replace("_", " ")
    kind = "whole numbers" if name.endswith("s") else "a whole number"
    limits = f"from {low:,}" + (f" to {high:,}" if high < math.inf else "")
    require(type(value) is int and low <= value <= high, f"{_told(name, value)} {kind} {limits}")


def _told(name: str, value: object) -> str:
    """The beginning of what is said of a dial that must be something else."""
    return f"{name} {'are' if name.endswith('s') else 'is'} {value!r}; {'they' if name.endswith('s') else 'it'} must be"


def _check_compression(method: "Transport | Indirect", words: tuple[str, ...], most: int):
    """The dials that compressed rows have under both methods."""
    tolerance, limits = method.compression_tolerance, "at least 0, which leaves nothing out, and below 1"
    check_number("compression tolerance", tolerance, lambda x: 0 <= x < 1, limits)
    check_choice("bits", method.bits, (8, 16, 32))
    count = method.coefficients
    choices = " or ".join(f"'{word}'" for word in words)
    require(
        count in words or (type(count) is int and 1 <= count <= most),
        f"coefficients are {count!r}; from 1 to {most:,} can be kept in a row, or they are {choices}",
    )
