"""The dials of precomputation."""

import dataclasses
from typing import Literal

from jaxrelight.errors import InputError


@dataclasses.dataclass(frozen=True)
class Settings:
    """What is precomputed, and how finely.

    Attributes:
        receivers: "vertices" leave the view free; "pixels" are exact for the scene's camera alone.
        resolution: side of the six faces of the cube map that light is given on; a power of two.
        visibility_samples: rays a texel; a square number. Transport is averaged over them.
        terms: factors of a BRDF that depends on direction, for vertices; a diffuse one always has 1.
        coefficients: how direct light is kept: "shared": near receivers share as few rows over as few wavelet
            coefficients as `tolerance` allows; a number: so many in each row (Wang 2006 §4.1); "all": nothing is
            compressed, rows are baked from the stored visibility at every change of light. Bounced light is shared.
        factor_resolution: side of the maps of BRDF factors.
        tolerance: largest error that may be left in the radiance of a group under natural light, relative to its
            root-mean-square.
        bits: of every number of compressed rows: 32 (floating point), or codes of 16 or 8 (Wang 2006 §4.1.2).
        bounces: how often light is reflected on its way, at most, after it has reached the first surface. No more are
            made than leave out `tolerance` of all light.
        gather_resolution: side of the six faces of the cube map that receivers look around with for bounced light.
        gather: of what they see, take the rows of a face's three corners by their "barycentric" weights, or those of
            the "nearest" one.
        gather_samples: where it is not 0, light is not of the sky but of local lights: that many points stand for all
            surfaces, and what they reflect is gathered by pixels (Hašan 2006). A power of four.
        solid_angle: of those points, far ones are gathered from together where the square of their extent is less than
            this times that of their distance.
        peak: of glossy BRDFs, points are told apart as well where together they would give more than this share of all
            that a receiver reflects; 1 for nowhere.
        near: of points that are near, "disc" keeps the energy; "clamp" is the paper's bound.
        importance: put more points where they light what the camera sees.
        photons: where it is not 0, what points get from each other is not gathered link by link, but by that many
            photons that they shoot, which land up to `bounces` − 1 times: the paper's way; albedos of all but the last
            surface are in it.
        sky: a quarter of the points are directions of the sky, so that an environment lights as lamps do.
        seed: of the points' places, and of photons.
    """

    receivers: Literal["vertices", "pixels"] = "vertices"
    resolution: int = 64
    visibility_samples: int = 1
    terms: int = 4
    coefficients: int | Literal["shared", "all"] = "shared"
    factor_resolution: int = 48
    tolerance: float = 0.02
    bits: Literal[8, 16, 32] = 32
    bounces: int = 0
    gather_resolution: int = 32
    gather: Literal["barycentric", "nearest"] = "barycentric"
    gather_samples: int = 0
    solid_angle: float = 0.1
    peak: float = 0.01
    near: Literal["disc", "clamp"] = "disc"
    importance: bool = False
    photons: int = 0
    sky: bool = False
    seed: int = 0

    def __post_init__(self):
        def require(good: bool, message: str):
            if not good:
                raise InputError(message)

        for name in ("resolution", "visibility_samples", "terms", "factor_resolution", "bounces", "gather_resolution"):
            value = getattr(self, name)
            whole = isinstance(value, int) and not isinstance(value, bool)
            require(whole, f"{name.replace('_', ' ')} is {value!r}; it must be a whole number")
        n, rays = self.resolution, self.visibility_samples
        require(
            self.receivers in ("vertices", "pixels"), f"receivers are 'vertices' or 'pixels', not '{self.receivers}'"
        )
        require(4 <= n <= 512 and n & (n - 1) == 0, f"resolution is {n}; it must be a power of two from 4 to 512")
        require(rays in (1, 4, 9, 16, 25), f"visibility samples are {rays}; they must be 1, 4, 9, 16 or 25")
        require(self.terms >= 1, f"terms are {self.terms}; at least 1 is needed")
        side = self.factor_resolution
        require(4 <= side <= 128, f"factor resolution is {side}; it must be from 4 to 128")
        real = isinstance(self.tolerance, (int, float)) and not isinstance(self.tolerance, bool)
        require(
            real and 0 <= self.tolerance < 1,
            f"tolerance is {self.tolerance!r}; it must be at least 0, which leaves nothing out, and below 1",
        )
        require(self.bits in (8, 16, 32), f"bits are {self.bits}; they must be 8, 16 or 32")
        require(self.bounces >= 0, f"bounces are {self.bounces}; they must be 0 or more")
        side = self.gather_resolution
        require(4 <= side <= 256 and side % 2 == 0, f"gather resolution is {side}; it must be even, from 4 to 256")
        require(self.gather in ("barycentric", "nearest"), f"gather is 'barycentric' or 'nearest', not '{self.gather}'")
        samples = self.gather_samples
        if samples:
            require(
                isinstance(samples, int)
                and samples >= 64
                and samples & (samples - 1) == 0
                and samples.bit_length() % 2 == 1,
                f"gather samples are {samples:,}; they must be a power of four: 4,096, 16,384, 65,536, …",
            )
            require(
                self.receivers == "pixels", "light of local lights is gathered by pixels: receivers must be 'pixels'"
            )
            require(self.coefficients != "all", "coefficients are 'all'; with gather samples, tolerance 0 keeps all")
            seed = self.seed
            require(type(seed) is int and seed >= 0, f"seed is {seed!r}; it must be a whole number, 0 or more")
            photons = self.photons
            require(
                type(photons) is int and 0 <= photons <= 10**7,
                f"photons are {photons!r}; they must be a whole number up to 10,000,000, or 0 to gather without",
            )
            require(not (photons and self.sky), "photons do not come from the sky; leave them, or the sky, out")
            require(0 <= self.solid_angle < 10, f"solid angle is {self.solid_angle}; it must be from 0 to 10")
            require(0 < self.peak <= 1, f"peak is {self.peak}; it must be above 0, up to 1, which splits nothing")
            require(self.near in ("disc", "clamp"), f"near is 'disc' or 'clamp', not '{self.near}'")
            require(self.bounces >= 1, "bounces are 0; of local lights, indirect light has one or more")
        if self.coefficients not in ("shared", "all"):
            limit = samples or 6 * n * n
            require(
                type(self.coefficients) is int and 1 <= self.coefficients <= limit,
                f"coefficients are {self.coefficients}; from 1 to {limit:,} can be kept at resolution {n}, or they are "
                "'shared' or 'all'",
            )

    @property
    def samples_per_side(self) -> int:
        """Rays along a side of a texel."""
        return round(self.visibility_samples**0.5)
