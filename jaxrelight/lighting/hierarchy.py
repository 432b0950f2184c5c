"""Which pixels are shaded, and how the others lie between them: coarse to fine on nested lattices (Bagher 2011 §3).

Level L has the pixels whose coordinates are multiples of 2^L, so a shaded pixel of a level is one of all finer levels,
too, and none is shaded twice. From level to level there are three kinds of new pixels: between pixels of a row, of a
column, and of both. What the paper asks of bandwidth and distance in the image, whether pixels are further apart than
half a cycle, is asked here of what the light depends on: the direction in which a pixel mirrors the eye, times
bandwidth, and the place, for shadows. So normal maps, creases and silhouettes need no detection of their own: across
them is far.

Nothing that is shaded is needed to know where to shade. All levels are one list of work.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

LEVELS = 5
# Cycles at which a parent counts e times less.
_REACH = 0.15
# Further away in the image, e times less at this many squared steps; and mirrors that differ by more are none at all.
_IMAGE, _MOST_TURNED = 0.075, 0.5
# Of weights' squares: what is further outside its parents than this would make their noise larger.
_MOST_NOISE = 1.2
# Of all parents together, the least that counts.
_LEAST = 1e-3
# Tolerances of levels: this power of two smaller from one to the next coarser one.
_SHARE = 1.0
# Parents of a new pixel between two of a row, as (down, right) in steps of the finer lattice; and between four. New
# pixels of a kind lie so many of those steps down and right of the coarser lattice's. The nearest parents come first,
# two or four of them.
_ROW = ((0, -1), (0, 1), (-2, -1), (-2, 1), (2, -1), (2, 1), (0, -3), (0, 3))
_FOUR = ((-1, -1), (-1, 1), (1, -1), (1, 1), (-1, 3), (1, 3), (-1, -3), (1, -3), (3, -1), (3, 1), (-3, -1), (-3, 1))
_KINDS = (((0, 1), _ROW, 2), ((1, 0), tuple((x, y) for y, x in _ROW), 2), ((1, 1), _FOUR, 4))


class Features(NamedTuple):
    """What the radiance of pixels depends on.

    Attributes:
        kind: pixels are interpolated among those of the same one; negative for what is not shaded at all.
        mirror: unit world direction in which the eye is mirrored.
        angular: bandwidth by that, in cycles per radian.
        position: in the world.
        spatial: bandwidth by that, in cycles per metre.
        contrast: the error, as it is seen, of being wrong by all there is.
    """

    kind: Int[Array, "h w"]
    mirror: Float[Array, "h w 3"]
    angular: Float[Array, "h w"]
    position: Float[Array, "h w 3"]
    spatial: Float[Array, "h w"]
    contrast: Float[Array, "h w"]


class Hierarchy(eqx.Module):
    """Where to shade, and how the others follow.

    Attributes:
        asked: pixels that show anything.
        error: that each of them is predicted to have by lying between its parents, were those exact; infinite where it
            must be shaded.
        weights: of the parents of each kind of new pixels, from the coarsest level on.
        shaded: which pixels are.
        left: the error of those that are not, with what their parents pass on to them.
    """

    asked: Bool[Array, "h w"]
    error: Float[Array, "h w"]
    weights: tuple[Float[Array, "k y x"], ...]
    shaded: Bool[Array, "h w"]
    left: Float[Array, "h w"]

    def within(self, tolerance) -> "Hierarchy":
        """The same with another tolerance: all of a larger error are shaded."""
        return Hierarchy(
            self.asked, self.error, self.weights, *_within(self.asked, self.error, self.weights, tolerance)
        )

    def filled(self, image: Float[Array, "h w c"]) -> Float[Array, "h w c"]:
        """The image with what lies between shaded pixels; linear in them, and differentiable."""
        return _filled(self.shaded, self.weights, image)

    def spread(self, variance: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """Of each pixel, about the variance that those of shaded pixels leave in it."""
        return _spread(self.shaded, self.weights, variance)

    def influence(self) -> Float[Array, "h w"]:
        """The factor on each shaded pixel's variance in the sum of all pixels'."""
        return _influence(self.shaded, self.weights, self.asked.astype(self.error.dtype))

    def levels(self) -> Int[np.ndarray, "h w"]:
        """The level whose pixels are each one's parents, and 0 of shaded pixels."""
        return np.where(np.asarray(self.shaded), 0, _levels(self.shaded.shape))


@functools.partial(jax.jit, static_argnames="inside")
def hierarchy(features: Features, inside: int = 0) -> Hierarchy:
    """The coarsest lattice must be shaded, and what has no parents like it; all others have an error.

    Weights are those of a linear function through the parents, by least squares, nearer ones counted more. With q the
    way to a parent in cycles, what is left over of Σ w q counts as its share of a wave's steepest slope, and Σ |w| q²
    as that of its strongest bend.

    Args:
        features: of all pixels.
        inside: as many of the finest levels lie within pixels of the picture, which are means over them: only the
            nearest parents count there.
    """
    h, w = features.kind.shape
    # Planes: sums over an innermost axis of three are slow.
    mirror, position = (_whole(jnp.moveaxis(x, -1, 0)) for x in (features.mirror, features.position))
    place, axes = jnp.concatenate([mirror, position]), _across(mirror)
    kinds = _whole(features.kind, -1)
    # Each level's on its own lattice.
    most = [_whole(jnp.stack([features.angular, features.spatial, features.contrast]))]
    for level in range(LEVELS):
        most.append(_lattice(_most_around(most[-1], _lattice(kinds, level)), 1))
    error = jnp.full(_lattice(kinds, LEVELS).shape, jnp.inf, place.dtype)
    weights = []
    for level in range(LEVELS - 1, -1, -1):
        reach = jnp.stack([_lattice(most[level], 1), most[level + 1]])
        theirs = [_wider(x) for x in (_lattice(place, level + 1), reach)] + [_wider(_lattice(kinds, level + 1), -1)]
        errors = [error]
        for offset, parents, nearest in _KINDS:
            parents = parents[:nearest] if level < inside else parents
            mine, rates = (_lattice(x, level, offset) for x in (place, axes, kinds)), _lattice(most[level], 0, offset)
            own = *mine, rates
            found, wrong = _between(own, theirs, offset, parents)
            errors.append(wrong)
            weights.append(found)
        error = _woven(errors)
    found = features.kind >= 0, error[:h, :w], tuple(weights)
    return Hierarchy(*found, *_within(*found, 0.0))


def _across(mirror):
    """Two unit directions square to each mirror and to each other."""
    x, y, z = mirror
    # Square to the second axis of the world; where that is near, to the first.
    far = jnp.abs(y) < 0.9
    right = jnp.stack([jnp.where(far, -z, 0), jnp.where(far, 0, z), jnp.where(far, x, -y)])
    right = right / jnp.maximum(jnp.sqrt(_sum(right**2)), 1e-9)
    a, b, c = right
    return jnp.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a])


def _most_around(rates, kinds):
    """The largest of each pixel and its kind around: an edge asks for all pixels whose parents span it."""
    for axis in (-2, -1):
        sides = []
        for way in (-1, 1):
            there = jnp.roll(kinds, way, axis) == kinds
            sides.append(jnp.where(there, jnp.roll(rates, way, axis), 0))
        rates = jnp.maximum(rates, jnp.maximum(*sides))
    return rates


def _between(own, theirs, offset, parents):
    """Of new pixels of a kind, the weights of their parents, and the error of what lies between those."""
    place, axes, kind, (angular, spatial, contrast) = own

    def parent(given):
        (y, x), image, far = given
        other, reach, other_kind = (_moved(wider, y, x) for wider in theirs)
        # What lies between both is within reach of one of them.
        other_rates = jnp.where(far, reach[1], reach[0])
        turned, moved = other[:3] - place[:3], other[3:] - place[3:]
        x, y = (angular * _sum(turned * axis) for axis in (axes[:3], axes[3:]))
        most_angular, most_spatial = (
            jnp.maximum(*pair) for pair in ((angular, other_rates[0]), (spatial, other_rates[1]))
        )
        square = _sum(turned**2) * most_angular**2 + _sum(moved**2) * most_spatial**2
        usable = (other_kind == kind) & (_sum(turned**2) < _MOST_TURNED**2)
        near = jnp.where(usable, jnp.exp(-square / _REACH**2 - image), 0)
        return near, x, y, square, other_rates[2]

    image = _IMAGE * np.sum(np.square(parents), axis=1)
    far = np.max(np.abs(parents), axis=1) > 1
    given = _corners(offset, parents), jnp.asarray(image, jnp.float32), jnp.asarray(far)
    near, x, y, square, brought = jax.lax.map(parent, given)
    total, weights, left = _linear(near, x, y)
    wrong = 2 * np.pi * left + 0.25 * (2 * np.pi) ** 2 * _sum(jnp.abs(weights) * square)
    most = jnp.maximum(contrast, _sum(jnp.abs(weights) * brought))
    usable = (total > _LEAST) & (_sum(weights**2) < _MOST_NOISE)
    return weights, jnp.where(usable, most * wrong, jnp.inf)


def _linear(near, x, y):
    """Σ near, weights of the value at the origin of a linear function fitted to parents, and |Σ w (x, y)|."""
    total = _sum(near)
    share = near / jnp.where(total > _LEAST, total, 1)
    mean_x, mean_y = _sum(share * x), _sum(share * y)
    off_x, off_y = x - mean_x, y - mean_y
    xx, xy, yy = (_sum(share * one * other) for one, other in ((off_x,) * 2, (off_x, off_y), (off_y,) * 2))
    # Parents along a line tell nothing across it.
    ridge = 1e-6 + 0.02 * (xx + yy)
    xx, yy = xx + ridge, yy + ridge
    determinant = xx * yy - xy**2
    slope_x, slope_y = (xy * mean_y - yy * mean_x) / determinant, (xy * mean_x - xx * mean_y) / determinant
    weights = share * (1 + slope_x * off_x + slope_y * off_y)
    return total, weights, jnp.hypot(_sum(weights * x), _sum(weights * y))


def _sum(rows):
    """Over the first axis, in a tenth of the time that it takes as a reduction."""
    return functools.reduce(jnp.add, (rows[k] for k in range(len(rows))))


def _whole(image, fill=0):
    """The image, wider, so that all of a level's lattices have as many pixels."""
    ends = [(0, -n % 2**LEVELS) for n in image.shape[-2:]]
    return jnp.pad(image, [(0, 0)] * (image.ndim - 2) + ends, constant_values=fill)


def _lattice(image, level: int, kind=None):
    """A level's pixels, or its new ones of a kind."""
    step = 1 << level
    if kind is None:
        return image[..., ::step, ::step]
    return image[..., kind[0] * step :: 2 * step, kind[1] * step :: 2 * step]


def _woven(kinds):
    """The next lattice: the coarser one, and between it the three kinds of new pixels."""
    coarse, row, column, both = kinds
    upper, lower = (jnp.stack(pair, axis=-1) for pair in ((coarse, row), (column, both)))
    *more, h, w = coarse.shape
    return jnp.stack([upper, lower], axis=-3).reshape(*more, 2 * h, 2 * w)


def _wider(coarse, fill=0):
    """A lattice with what lies around it, as far as parents do."""
    return jnp.pad(coarse, [(0, 0)] * (coarse.ndim - 2) + [(1, 2), (1, 2)], constant_values=fill)


def _corners(offset, parents) -> Int[np.ndarray, "k 2"]:
    """Where the first pixel's parents lie in a lattice made wider."""
    return 1 + (np.asarray(parents, np.int32) + np.asarray(offset, np.int32)) // 2


def _moved(wider, y, x):
    """Of each new pixel, what a parent has."""
    start = (0,) * (wider.ndim - 2)
    shape = (*wider.shape[:-2], wider.shape[-2] - 3, wider.shape[-1] - 3)
    return jax.lax.dynamic_slice(wider, (*start, y, x), shape)


@jax.jit
def _within(asked, error, weights, tolerance):
    """Which pixels are shaded, and the errors of the others, coarse to fine."""
    # What a coarse pixel is off, all those between it and others are, too.
    allowed = tolerance * jnp.exp2(-_SHARE * jnp.asarray(_levels(error.shape), error.dtype))
    shaded = asked & (error > allowed)
    own = jnp.where(asked & ~shaded, error, 0)
    sizes = tuple(jnp.abs(w) for w in weights)
    left = _passed(shaded, sizes, own[..., None], jnp.add)[..., 0]
    return shaded, jnp.where(asked, left, 0)


def _levels(shape) -> Int[np.ndarray, "h w"]:
    """The level whose pixels are each one's parents; of the coarsest lattice, which has none, one more."""
    found = np.full(shape, LEVELS + 1, np.int32)
    for level in range(LEVELS, 0, -1):
        step = 2 ** (level - 1)
        for down, right in ((0, 1), (1, 0), (1, 1)):
            found[down * step :: 2 * step, right * step :: 2 * step] = level
    return found


@jax.jit
def _filled(shaded, weights, image):
    return _passed(shaded, weights, jnp.where(shaded[..., None], image, 0), lambda own, between: between)


def _passed(shaded, weights, image, joined):
    """Coarse to fine: shaded pixels keep their own, others join theirs with what their parents give them."""
    h, w = image.shape[:2]
    shaded, image = _whole(shaded), _whole(jnp.moveaxis(image, -1, 0))
    found, weights = _lattice(image, LEVELS), iter(weights)
    for level in range(LEVELS - 1, -1, -1):
        coarse, new = _wider(found), [found]
        for offset, parents, _ in _KINDS:

            def added(total, given, coarse=coarse):
                weight, (y, x) = given
                return total + weight * _moved(coarse, y, x), None

            own, theirs = _lattice(image, level, offset), next(weights)
            given = theirs, _corners(offset, parents[: len(theirs)])
            between, _ = jax.lax.scan(added, jnp.zeros_like(own), given)
            new.append(jnp.where(_lattice(shaded, level, offset), own, joined(own, between)))
        found = _woven(new)
    return jnp.moveaxis(found[:, :h, :w], 0, -1)


@jax.jit
def _spread(shaded, weights, variance):
    """Noise of shaded parents is independent; that of parents which lie between the same pixels is alike."""
    both = tuple(jnp.stack([w * w, jnp.abs(w)], axis=1) for w in weights)
    own = jnp.where(shaded, variance, 0)
    image = jnp.stack([own, jnp.zeros_like(own)], axis=-1)
    found = _passed(shaded, both, image, lambda _, between: jnp.stack([jnp.zeros_like(between[0]), sum(between)]))
    return jnp.sum(found, axis=-1)


@jax.jit
def _influence(shaded, weights, asked):
    _, back = jax.vjp(lambda variance: _spread(shaded, weights, variance), jnp.zeros_like(asked))
    return back(asked)[0]
