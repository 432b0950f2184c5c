"""Entries of `jaxrelight.lights`."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import functools

import numpy as np

from jaxrelight.basis import latlong
from jaxrelight.gradients.entry import CHOICE, CONTRACT, FILES, HOST, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import ALONG_X, OMEGA_I, ZERO, at_point, numbers, scalar
from jaxrelight.lights import area, environment, environment_mipmap, local, prefiltered, shaped, sky, sun
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.prefiltered import PrefilteredMaps
from jaxrelight.lights.projector import Projector, projector

_PLACES = np.array([[0.3, -0.2, 0.1], [-0.4, 0.5, 0.2]])
_LAMP, _AIM = np.array([0.2, 2.0, -0.3]), np.array([0.1, 0.0, 0.2])
_TYPES = "of the arrays given, see `point`; positions that are known stay in double precision on the host"
_UNIT = np.array([0.6, 0.0, 0.8])
_POLE = np.array([0.0, 1.0, 0.0])


def _at(light, positions):
    """What arrives, where it is finite: directional light has no distance."""
    incident = light.at(positions)
    return incident.omega_i, incident.irradiance


@functools.cache
def _maps() -> PrefilteredMaps:
    return prefiltered.prefilter(numbers(8, 16, 3).astype(np.float32), 32, between=(0.0, 3.0))


def _environment(pixels, rotate_y, scale) -> Environment:
    return Environment(pixels, rotate_y, scale)


def _shaped(**changes) -> shaped.Shaped:
    settings = {"roundness": 0.6, "near": (0.5, 1.0), "far": (3.0, 5.0), "falloff": 1.7, "up": (0.0, 0.1, 1.0)}
    return shaped.shaped(_LAMP, _AIM, [1.0, 2.0, 3.0], (6.0, 9.0), (40.0, 50.0), **settings | changes)


def _projector() -> Projector:
    return projector(_LAMP, _AIM, numbers(4, 5, 3), 60.0, (0.0, 0.1, 1.0))


def _dark_sky():
    """With a sun, in two texels of 96."""
    texels = numbers(6 * 4**2, 3)
    texels[[5, 6]] = [[400, 300, 200], [90, 80, 100]]
    return texels


def _with_sun():
    pixels = numbers(32, 64, 3)
    pixels[6, 9] = [4000, 3000, 2000]
    return pixels


def _split(texels):
    split = sun.split_sun(texels)
    return split.rest, split.radiance, split.sun


def _sky(made):
    return made.directions, made.irradiance, [part.at(_PLACES).irradiance for part in made.parts()]


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.lights.local", "Point.at from_point"),
        differentiable_in="light, positions",
        example=lambda: Example(_at, (local.point(_LAMP, [1.0, 2.0, 3.0]), _PLACES)),
        orders=2,
        kinks="0 at the light itself",
        ends="nearer than 1e-6 the distance counts as that",
        singular=lambda: (at_point("at the light", (local.point(ZERO, 1.0), ZERO[None]), 1, ALONG_X[None], "finite"),),
    ),
    Entry(
        named("jaxrelight.lights.local", "Spot.at"),
        differentiable_in="light, positions",
        example=lambda: Example(_at, (local.spot(_LAMP, _AIM, [1.0, 2.0, 3.0], 40.0, 5.0), _PLACES)),
        kinks="at both edges of the soft part the slope inside; none where beam = cutoff",
        singular=lambda: (
            at_point("on the axis", (local.spot(_LAMP, _AIM, 1.0, 40.0, 5.0), _AIM[None]), 1, ALONG_X[None]),
        ),
    ),
    Entry(
        named("jaxrelight.lights.local", "Directional.at"),
        differentiable_in="light, positions",
        example=lambda: Example(_at, (local.directional(_AIM - _LAMP, [1.0, 2.0, 3.0]), _PLACES)),
        orders=2,
        nan="the place does not matter",
    ),
    Entry(
        named("jaxrelight.lights.local", "Displaced.at"),
        differentiable_in="light, positions",
        example=lambda: Example(
            lambda light, origin, positions: _at(local.Displaced(light, origin), positions),
            (local.point(_LAMP, [1.0, 2.0, 3.0]), numbers(3), _PLACES),
        ),
        orders=2,
    ),
    Entry(
        named("jaxrelight.lights.local", "frame_towards"),
        differentiable_in="place, target, up",
        example=lambda: Example(local.frame_towards, (_LAMP, _AIM, ALONG_X)),
        orders=2,
        ends="`up` not along the way to the target",
    ),
    Entry(
        named("jaxrelight.lights.local", "point spot directional power"),
        differentiable_in="all numbers, traced or not",
        example=lambda: Example(
            lambda position, target, intensity, cutoff: (
                local.point(position, intensity),
                local.spot(position, target, intensity, cutoff),
                local.directional(target - position, intensity),
            ),
            (_LAMP, _AIM, numbers(3), scalar(40.0)),
        ),
        orders=2,
        dtypes=_TYPES,
    ),
    Entry(
        named("jaxrelight.lights.local", "Punctual.relative_to Directional.relative_to"),
        differentiable_in="light",
        example=lambda: Example(
            lambda light: light.relative_to(np.array([0.5, 0.25, 0.125])),
            (local.spot(_LAMP, _AIM, [1.0, 2.0, 3.0], 40.0, 5.0),),
        ),
        orders=2,
        dtypes=_TYPES,
    ),
    Entry(
        named("jaxrelight.lights.area", "Patch.at area Area.parts"),
        differentiable_in="light, positions",
        example=lambda: Example(
            lambda centre, u, v, radiance, positions: [
                _at(part, positions) for part in area.area(centre, u, v, radiance, 2).parts()
            ],
            (_LAMP, np.array([0.4, 0.1, 0.0]), np.array([0.0, 0.1, 0.5]), numbers(3), _PLACES),
        ),
        kinks="none where a point begins to see a patch; near and far formulas are joined smoothly",
        ends="edges that turn; points in front",
    ),
    Entry(
        named("jaxrelight.lights.projector", "Projector.at projector"),
        differentiable_in="light, positions",
        example=lambda: Example(_at, (_projector(), _PLACES * 0.3)),
        kinks="between pixels the slope of those ahead; none at the image's edges, which are held fixed",
        ends="points in front",
    ),
    Entry(
        named("jaxrelight.lights.shaped", "Shaped.at shaped"),
        differentiable_in="light, positions",
        example=lambda: Example(_at, (_shaped(), _PLACES)),
        kinks="none at hard edges; on the diagonal of a rectangle (roundness 0) the mean of both slopes",
        ends="0 < inner ≤ outer < 90 degrees; roundness 0 … 1",
        singular=lambda: (
            at_point("roundness 0", (_shaped(roundness=0.0), _PLACES), 1, np.array([ALONG_X, ALONG_X])),
            at_point("on the axis", (_shaped(), _AIM[None]), 1, ALONG_X[None]),
        ),
    ),
    Entry(
        named("jaxrelight.lights.environment", "texels_of encode Environment.with_ with_coarse_pixels coarsened"),
        differentiable_in="pixels, rotate_y, scale; linear in pixels and in scale",
        example=lambda: Example(
            lambda pixels, turn, scale: environment.texels_of(_environment(pixels, turn, scale), 2),
            (numbers(8, 16, 3), scalar(13.0), scalar(1.5)),
        ),
        kinks="in the angle, at whole pixels of the map: the slope ahead",
    ),
    Entry(
        named("jaxrelight.lights.environment_mipmap", "Cells.look_up cells"),
        differentiable_in="pixels, u, v",
        example=lambda: Example(
            lambda pixels, u, v: environment_mipmap.cells(pixels).look_up(u, v, np.full((), 0.5, pixels.dtype)),
            (numbers(8, 16, 3), scalar(0.31), scalar(0.42)),
        ),
        fixed="the level, which goes by the solid angle in steps",
        kinks="between cells the slope of those ahead",
    ),
    Entry(
        named("jaxrelight.lights.environment_mipmap", "environment_mipmap EnvironmentMipmap.radiance_at"),
        differentiable_in="environment, omega",
        example=lambda: Example(
            lambda pixels, turn, scale, omega: environment_mipmap.environment_mipmap(
                _environment(pixels, turn, scale)
            ).radiance_at(omega, np.full((), 0.5, pixels.dtype)),
            (numbers(8, 16, 3), scalar(13.0), scalar(1.5), OMEGA_I),
        ),
        fixed="what is taken as the sun, and the level",
        kinks="between cells the slope of those ahead",
        nan="a NaN is looked for as a sun is; pixels that are known are refused",
    ),
    Entry(
        named("jaxrelight.lights.prefiltered", "PrefilteredMaps.look_up PrefilteredMaps.at_level PrefilteredMaps.map"),
        differentiable_in="maps, direction, exponent, rotate_y",
        example=lambda: Example(
            lambda maps, direction, n, turn: maps.look_up(direction, n, turn),
            (_maps(), OMEGA_I, scalar(1.3), scalar(7.0)),
        ),
        kinks="between texels and maps the slope of those ahead; at the least and the largest exponent that inside",
        ends="exponents held within those of the maps",
        singular=lambda: (
            at_point("exponent 0", (_maps(), OMEGA_I, scalar(0), scalar(7.0)), 2, scalar(1), "ahead"),
            at_point("a pole", (_maps(), _POLE, scalar(1.3), scalar(7.0)), 1, ALONG_X, "finite"),
        ),
    ),
    Entry(
        named("jaxrelight.lights.prefiltered", "prefilter maps_of"),
        differentiable_in="pixels; linear",
        example=lambda: Example(
            lambda pixels: prefiltered.prefilter(pixels, 32, between=(0.0, 3.0)), (numbers(8, 16, 3),)
        ),
        ends="known pixels that are not finite are refused",
    ),
    Entry(
        named("jaxrelight.lights.sky", "sky_of even_sky Sky.parts"),
        differentiable_in="environment, radiance; linear in the pixels",
        example=lambda: Example(
            lambda pixels, turn, scale: _sky(sky.sky_of(_environment(pixels, turn, scale), 4)),
            (numbers(8, 16, 3), scalar(13.0), scalar(1.5)),
            along=(numbers(8, 16, 3), scalar(1), scalar(1)),
        ),
        fixed="which pixels each direction stands for, and so the directions but for their turn",
    ),
    Entry(
        named("jaxrelight.lights.sky", "turned"),
        differentiable_in="directions, degrees",
        example=lambda: Example(sky.turned, (_PLACES, scalar(13.0))),
        orders=2,
    ),
    Entry(
        named("jaxrelight.lights.sky", "mean_radiance"),
        differentiable_in="pixels, rotate_y, scale",
        example=lambda: Example(
            lambda pixels, turn, scale: sky.mean_radiance(
                pixels, turn, scale, sky.nearest_directions(latlong.directions(numbers(5), numbers(5)), 8, 16), 5
            ),
            (numbers(8, 16, 3), scalar(13.0), scalar(1.5)),
        ),
        fixed="which direction each part of a pixel belongs to",
        kinks="in the angle, at whole pixels: the slope ahead",
    ),
    Entry(
        named("jaxrelight.lights.sun", "split_sun Split.sun"),
        differentiable_in="texels; linear",
        example=lambda: Example(_split, (_dark_sky(),), along=(_dark_sky(),)),
        fixed="what is taken off, as a share, and from where",
    ),
    Entry(
        named("jaxrelight.lights.sun", "without_sun"),
        differentiable_in="pixels; linear",
        example=lambda: Example(sun.without_sun, (_with_sun(),), along=(_with_sun(),)),
        fixed="what is taken off, as a share, and from where",
    ),
    Exempt(named("jaxrelight.lights.local", "Light.parts Punctual.parts Punctual.at"), CONTRACT),
    Exempt(
        named("jaxrelight.lights.environment_mipmap", "EnvironmentMipmap.detail_at light_bandwidth"),
        "predicts noise, which chooses how many samples are taken, not what these are",
    ),
    Exempt(
        (
            *named("jaxrelight.lights.environment", "check_pixels"),
            *named("jaxrelight.lights.lights", "as_lights"),
            *named("jaxrelight.lights.local", "check_target vector place"),
            *named("jaxrelight.lights.projector", "check_frame"),
            *named("jaxrelight.lights.probes", "is_disc"),
        ),
        CHOICE,
    ),
    Exempt(
        (
            *named("jaxrelight.lights.environment", "environment"),
            *named("jaxrelight.lights.layouts", "faces_of"),
            *named("jaxrelight.lights.natural_spectrum", "natural_spectrum spectrum_of_levels"),
            *named("jaxrelight.lights.sky_panel", "sky_panel"),
            *named("jaxrelight.lights.probes", "to_cube"),
            *named("jaxrelight.lights.sky", "nearest_directions"),
        ),
        HOST,
    ),
    Exempt(
        (
            *named("jaxrelight.lights.environment", "load_environment"),
            *named("jaxrelight.lights.record", "to_records from_records"),
        ),
        FILES,
    ),
)
