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
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

LEVELS = 5
# Cycles at which a parent counts e times less.
_REACH = 0.15
# A parent counts e times less at this many squared steps in the image, and not at all if mirrors differ by more.
_IMAGE, _MAX_TURN = 0.075, 0.5
# This bounds the weights' squares: what is further outside its parents would make their noise larger.
_MAX_NOISE_GAIN = 1.2
# This is the least weight of all parents together that counts.
_MIN_TOTAL_WEIGHT = 1e-3
# A level's tolerance is smaller by this power of two than that of the next finer level.
_SHARE = 1.0
# Lines and columns of a lattice's parents before its first pixel, and after its last one.
_BEFORE, _AFTER = 1, 2
# Three kinds of new pixels, between two of a row, two of a column, and four, lie so many steps of the finer lattice
# down and right of the coarser one's pixels.
_KINDS = ((0, 1), (1, 0), (1, 1))
# Their parents, as (down, right) in those steps. The nearest come first, two or four of them.
_ROW = ((0, -1), (0, 1), (-2, -1), (-2, 1), (2, -1), (2, 1), (0, -3), (0, 3))
_FOUR = ((-1, -1), (-1, 1), (1, -1), (1, 1), (-1, 3), (1, 3), (-1, -3), (1, -3), (3, -1), (3, 1), (-3, -1), (-3, 1))
_COUNTS, _NEAREST = (len(_ROW), len(_ROW), len(_FOUR)), (2, 2, 4)
# [parents, kinds, 2]; kinds of fewer have their first ones again, which count nothing.
_PARENTS = np.stack([np.resize(of, (len(_FOUR), 2)) for of in (_ROW, np.flip(_ROW, 1), _FOUR)], axis=1)
# The parents of the first new pixel of each kind, in a lattice made wider.
_CORNERS = (_BEFORE + (_PARENTS + np.array(_KINDS)) // 2).astype(np.int32)
# Numbers that are known of a parent: its mirror and position, its kind, and twice three rates around it.
_KIND = 6
_COARSE_TO_FINE = range(LEVELS - 1, -1, -1)


class Features(NamedTuple):
    """What the radiance of pixels depends on.

    Attributes:
        kind: pixels are interpolated among those of the same one; negative for what is not shaded at all.
        mirror: unit world direction in which the eye is mirrored.
        angular: bandwidth by that, in cycles per radian.
        position: in world units.
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
        weights: of the parents of new pixels, by kind; of all levels one after the other, from the coarsest on.
        shaded: which pixels are.
        left: the error of those that are not, with what their parents pass on to them.
    """

    asked: Bool[Array, "h w"]
    error: Float[Array, "h w"]
    weights: Float[Array, "p 3 n"]
    shaded: Bool[Array, "h w"]
    left: Float[Array, "h w"]

    def within(self, tolerance: ArrayLike) -> "Hierarchy":
        """The same with another tolerance: all of a larger error are shaded."""
        return Hierarchy(
            self.asked, self.error, self.weights, *_within(self.asked, self.error, self.weights, tolerance)
        )

    def interpolate(self, image: Float[Array, "h w c"]) -> Float[Array, "h w c"]:
        """The image with what lies between shaded pixels; linear in them, and differentiable."""
        return _interpolate(self.shaded, self.weights, image)

    def propagate_variance(self, variance: Float[Array, "h w"], alike: ArrayLike = 0.0) -> Float[Array, "h w"]:
        """About the variance that the variances of shaded pixels leave in each pixel.

        Args:
            variance: of shaded pixels.
            alike: the share of it that neighbours have in common, so that no mean over them makes it smaller.
        """
        return _propagate_variance(self.shaded, self.weights, variance, alike)

    def influence(self, alike: ArrayLike = 0.0) -> Float[Array, "h w"]:
        """The factor on each shaded pixel's variance in the sum of all pixels'; see `propagate_variance`."""
        return _influence(self.shaded, self.weights, self.asked, alike)

    def sources(self, pixels: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
        """The shaded pixels that some pixels are, or lie between. On the host."""
        (h, w), weights = pixels.shape, np.asarray(self.weights)
        shaded, levels, needed = np.asarray(self.shaded), np.asarray(_levels(pixels.shape)), pixels.copy()
        sizes = [math.prod(_new_shape(pixels.shape, level)) for level in _COARSE_TO_FINE]
        for level in reversed(_COARSE_TO_FINE):
            row, column = np.nonzero(needed & ~shaded & (levels == level + 1))
            kind = 2 * (row >> level & 1) + (column >> level & 1) - 1
            line = _new_shape(pixels.shape, level)[1]
            place = sum(sizes[: LEVELS - 1 - level]) + (row >> level + 1) * line + (column >> level + 1)
            parents = np.stack([row, column], axis=-1) + _PARENTS[:, kind] * 2**level
            inside = ((parents >= 0) & (parents < (h, w))).all(axis=-1) & (weights[:, kind, place] != 0)
            needed[tuple(parents[inside].T)] = True
        return needed & shaded

    def levels(self) -> Int[np.ndarray, "h w"]:
        """The level whose pixels are each one's parents, and 0 of shaded pixels."""
        return np.where(np.asarray(self.shaded), 0, np.asarray(_levels(self.shaded.shape)))


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
    error, weights = _errors(features, _parent_rows(features.kind.shape), inside)
    asked = jax.device_put(np.asarray(features.kind) >= 0)
    return Hierarchy(asked, error, weights, *_within(asked, error, weights, 0.0))


def shade_all(asked: Bool[Array, "h w"]) -> Hierarchy:
    """Of which all pixels that are asked for are shaded, whatever the tolerance."""
    pixels = sum(math.prod(_new_shape(asked.shape, level)) for level in _COARSE_TO_FINE)
    host = np.asarray(asked)
    error = jax.device_put(np.where(host, np.inf, 0).astype(np.float32))
    weights, left = (jax.device_put(np.zeros(of, np.float32)) for of in ((len(_PARENTS), 3, pixels), host.shape))
    return Hierarchy(asked, error, weights, asked, left)


@jax.jit
def _errors(features: Features, parent_rows, inside):
    """How far off pixels between parents are, and the parents' weights, for the new pixels of all levels together."""
    h, w = features.kind.shape
    # Components are kept as planes, since sums over an innermost axis of three are slow.
    mirror, position = (_whole(jnp.moveaxis(x, -1, 0)) for x in (features.mirror, features.position))
    kinds = _whole(features.kind, -1)
    same = jnp.concatenate([mirror, position, kinds[None].astype(mirror.dtype)])
    # The rates of each level lie on its own lattice.
    most = [_whole(jnp.stack([features.angular, features.spatial, features.contrast]))]
    for level in range(LEVELS):
        most.append(_lattice(_most_around(most[-1], _lattice(kinds, level)), 1))
    parents, own = [], []
    for level in _COARSE_TO_FINE:
        lattice = jnp.concatenate([_lattice(same, level + 1), _lattice(most[level], 1), most[level + 1]])
        none = jnp.where(jnp.arange(len(lattice)) == _KIND, -1.0, 0)[:, None, None]
        parents.append((_wider(lattice - none) + none).reshape(len(lattice), -1))
        new = _new(jnp.concatenate([_lattice(same, level), most[level]]))
        own.append(new.reshape(*new.shape[:2], -1))
    # Each parent has a row, so that all that is asked of it is read at once. Rows are compiled apart: fused with what
    # follows, every look-up would make them anew.
    parents, own = jax.lax.optimization_barrier((jnp.concatenate(parents, axis=1).T, jnp.concatenate(own, axis=2)))
    weights, errors = _between(own, parents, parent_rows, inside)
    error = jnp.full(_lattice(kinds, LEVELS).shape, jnp.inf, mirror.dtype)
    for level in _COARSE_TO_FINE:
        error = _woven(error, _of_level(errors, level, (h, w)))
    return error[:h, :w], weights


def _new_shape(shape, level: int) -> tuple[int, int]:
    """Rows and columns of a level's new pixels of a kind; the next coarser lattice has as many."""
    h, w = (-(-n // 2**LEVELS) * 2 ** (LEVELS - 1 - level) for n in shape)
    return h, w


@functools.lru_cache(maxsize=4)
def _parent_rows(shape) -> tuple[Array, Array, Array]:
    """For new pixels of a kind of all levels: their lattice's first row of parents, rows of a line, and the level."""
    rows_by_level, start = [], 0
    for level in _COARSE_TO_FINE:
        h, w = _new_shape(shape, level)
        line = w + _BEFORE + _AFTER
        first = start + np.arange(h)[:, None] * line + np.arange(w)
        rows_by_level.append(np.stack([first.reshape(-1), np.full(h * w, line), np.full(h * w, level)]))
        start += (h + _BEFORE + _AFTER) * line
    # The arrays are cached, so they must not be a caller's tracers.
    with jax.ensure_compile_time_eval():
        first, line, level = (jax.device_put(of.astype(np.int32)) for of in np.concatenate(rows_by_level, axis=1))
        return first, line, level


def _of_level(of_all, level: int, shape):
    """A level's part of the numbers of new pixels of all levels, on its lattice."""
    sizes = [math.prod(_new_shape(shape, one)) for one in _COARSE_TO_FINE if one >= level]
    of_level = jax.lax.slice_in_dim(of_all, sum(sizes[:-1]), sum(sizes), axis=-1)
    return of_level.reshape(*of_all.shape[:-1], *_new_shape(shape, level))


def _across(mirror):
    """Two unit directions square to each mirror and to each other."""
    x, y, z = mirror
    # They are square to the second axis of the world, or to the first where the second is near.
    far = jnp.abs(y) < 0.9
    right = jnp.stack([jnp.where(far, -z, 0), jnp.where(far, 0, z), jnp.where(far, x, -y)])
    right = right / jnp.maximum(jnp.sqrt(_sum(right**2)), 1e-9)[None]
    a, b, c = right
    return jnp.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a])


def _most_around(rates, kinds):
    """The largest of each pixel and its kind around: an edge asks for all pixels whose parents span it."""
    for axis in (-2, -1):
        largest, size = rates, rates.shape[axis]
        for start in (0, 2):
            # Pixels outside are of no kind.
            there, theirs = (
                jax.lax.slice_in_dim(_padded(x, 1, 1, fill, (axis,)), start, start + size, axis=x.ndim + axis)
                for x, fill in ((kinds, -2), (rates, 0))
            )
            largest = jnp.maximum(largest, jnp.where(there == kinds, theirs, 0))
        rates = largest
    return rates


def _between(own, parents, parent_rows, inside):
    """The weights of new pixels' parents, and the error of what lies between those.

    Args:
        own: what is known of the pixels, by kind.
        parents: what is known of those that they ask for, a row of each.
        parent_rows: see `_parent_rows`.
        inside: as many of the finest levels ask for the nearest parents alone.
    """
    place, kind, (angular, spatial, contrast) = own[:_KIND], own[_KIND], own[_KIND + 1 :]
    first, line, level = parent_rows
    axes = _across(place[:3])

    def parent(given):
        corner, image, far, near_enough = given
        rows = first[None] + corner[:, :1] * line[None] + corner[:, 1:]
        other = jnp.moveaxis(parents.at[rows].get(mode="promise_in_bounds"), -1, 0)
        # What lies between both is within reach of one of them.
        rates = jnp.where(far[:, None], other[_KIND + 4 :], other[_KIND + 1 : _KIND + 4])
        turned, moved = other[:3] - place[:3], other[3:_KIND] - place[3:]
        x, y = (angular * _sum(turned * axis) for axis in (axes[:3], axes[3:]))
        most_angular, most_spatial = (jnp.maximum(*pair) for pair in ((angular, rates[0]), (spatial, rates[1])))
        square = _sum(turned**2) * most_angular**2 + _sum(moved**2) * most_spatial**2
        usable = (other[_KIND] == kind) & (_sum(turned**2) < _MAX_TURN**2)
        usable &= near_enough[:, None] | (level >= inside)[None]
        near = jnp.where(usable, jnp.exp(-square / _REACH**2 - image[:, None]), 0)
        return near, x, y, square, rates[2]

    number = np.arange(len(_PARENTS))[:, None]
    image = np.where(number < _COUNTS, _IMAGE * np.sum(_PARENTS**2, axis=2), np.inf).astype(np.float32)
    parent_arrays = _CORNERS, image, np.abs(_PARENTS).max(axis=2) > 1, number < _NEAREST
    near, x, y, square, brought = jax.lax.map(parent, parent_arrays)
    total, weights, left = _linear(near, x, y)
    wrong = 2 * np.pi * left + 0.25 * (2 * np.pi) ** 2 * _sum(jnp.abs(weights) * square)
    most = jnp.maximum(contrast, _sum(jnp.abs(weights) * brought))
    usable = (total > _MIN_TOTAL_WEIGHT) & (_sum(weights**2) < _MAX_NOISE_GAIN)
    return weights, jnp.where(usable, most * wrong, jnp.inf)


def _linear(near, x, y):
    """Σ near, weights of the value at the origin of a linear function fitted to parents, and |Σ w (x, y)|."""
    total = _sum(near)
    share = near / jnp.where(total > _MIN_TOTAL_WEIGHT, total, 1)[None]
    mean_x, mean_y = _sum(share * x), _sum(share * y)
    off_x, off_y = x - mean_x[None], y - mean_y[None]
    xx, xy, yy = (_sum(share * one * other) for one, other in ((off_x,) * 2, (off_x, off_y), (off_y,) * 2))
    # Parents along a line tell nothing across it.
    ridge = 1e-6 + 0.02 * (xx + yy)
    xx, yy = xx + ridge, yy + ridge
    determinant = xx * yy - xy**2
    slope_x, slope_y = (xy * mean_y - yy * mean_x) / determinant, (xy * mean_x - xx * mean_y) / determinant
    weights = share * (1 + slope_x[None] * off_x + slope_y[None] * off_y)
    return total, weights, jnp.hypot(_sum(weights * x), _sum(weights * y))


def _sum(rows):
    """Over the first axis, in a tenth of the time that it takes as a reduction."""
    return functools.reduce(jnp.add, (rows[k] for k in range(len(rows))))


def _whole(image, fill=0):
    """The image, wider, so that all of a level's lattices have as many pixels."""
    ends = [(0, -n % 2**LEVELS) for n in image.shape[-2:]]
    return jnp.pad(image, [(0, 0)] * (image.ndim - 2) + ends, constant_values=fill)


def _lattice(image, level: int):
    """A level's pixels."""
    return image[..., :: 1 << level, :: 1 << level]


def _new(lattice):
    """The three kinds of new pixels of a lattice."""
    *more, h, w = lattice.shape
    four = lattice.reshape(*more, h // 2, 2, w // 2, 2)
    return jnp.stack([four[..., :, down, :, right] for down, right in _KINDS], axis=len(more))


def _woven(coarse, new):
    """The next lattice: the coarser one, and between it the three kinds of new pixels."""
    row, column, diagonal = jnp.moveaxis(new, -3, 0)
    upper, lower = (jnp.stack(pair, axis=-1) for pair in ((coarse, row), (column, diagonal)))
    *more, h, w = coarse.shape
    return jnp.stack([upper, lower], axis=-3).reshape(*more, 2 * h, 2 * w)


def _wider(lattice):
    """A lattice with what lies around it, as far as parents do."""
    return _padded(lattice, _BEFORE, _AFTER, 0)


def _padded(lattice, before: int, after: int, fill, axes=(-2, -1)):
    ends = [(before, after) if axis - lattice.ndim in axes else (0, 0) for axis in range(lattice.ndim)]
    return jnp.pad(lattice, ends, constant_values=fill)


def _moved(wider, y, x):
    """What a parent of each new pixel has."""
    start, outside = (jnp.int32(0),) * (wider.ndim - 2), _BEFORE + _AFTER
    shape = (*wider.shape[:-2], wider.shape[-2] - outside, wider.shape[-1] - outside)
    return jax.lax.dynamic_slice(wider, (*start, y, x), shape)


@jax.jit
def _within(asked, error, weights, tolerance):
    """Which pixels are shaded, and the errors of the others, coarse to fine."""
    # What a coarse pixel is off, all those between it and others are, too.
    allowed = tolerance * jnp.exp2(-_SHARE * _levels(error.shape).astype(error.dtype))
    shaded = asked & (error > allowed)
    own = jnp.where(asked & ~shaded, error, 0)
    left = _passed(shaded, jnp.abs(weights), own[..., None], jnp.add)[..., 0]
    return shaded, jnp.where(asked, left, 0)


def _levels(shape) -> Int[Array, "h w"]:
    """The level whose pixels are each one's parents; of the coarsest lattice, which has none, one more."""
    # The number of lowest binary digits that are 0 in both coordinates.
    digits = jax.lax.broadcasted_iota(jnp.int32, shape, 0) | jax.lax.broadcasted_iota(jnp.int32, shape, 1)
    return jnp.minimum(jax.lax.population_count(~digits & (digits - 1)), LEVELS) + 1


@jax.jit
def _interpolate(shaded, weights, image):
    return _passed(shaded, weights, jnp.where(shaded[..., None], image, 0), lambda own, between: between)


def _passed(shaded, weights, image, joined):
    """Coarse to fine: shaded pixels keep their own, others join theirs with what their parents give them.

    Weights of all channels alike have no axis for them; others have it after that of parents.
    """
    h, w = image.shape[:2]
    shaded, image = _whole(shaded), _whole(jnp.moveaxis(image, -1, 0))
    lattice = _lattice(image, LEVELS)
    for level in _COARSE_TO_FINE:
        coarse, own = _wider(lattice), _new(_lattice(image, level))

        def added(total, of_parent, coarse=coarse):
            weight, corners = of_parent
            parent_values = jnp.stack([_moved(coarse, *corner) for corner in corners], axis=1)
            # Weights of all channels alike lack their axis.
            return total + jnp.broadcast_to(weight, parent_values.shape) * parent_values, None

        parents = _of_level(weights, level, (h, w)), _CORNERS
        start = jnp.zeros(own.shape, jnp.result_type(own, weights))
        between, _ = jax.lax.scan(added, start, parents)
        lattice = _woven(lattice, jnp.where(_new(_lattice(shaded, level)), own, joined(own, between)))
    return jnp.moveaxis(lattice[:, :h, :w], 0, -1)


@jax.jit
def _propagate_variance(shaded, weights, variance, alike):
    """Noise of shaded parents is independent; that of parents which lie between the same pixels is alike."""
    weight_powers = jnp.stack([weights**2, jnp.abs(weights)], axis=1)
    own = jnp.where(shaded, variance, 0)
    image = jnp.stack([(1 - alike) * own, alike * own], axis=-1)
    variances = _passed(
        shaded, weight_powers, image, lambda _, between: jnp.stack([jnp.zeros_like(between[0]), sum(between)])
    )
    return jnp.sum(variances, axis=-1)


@jax.jit
def _influence(shaded, weights, asked, alike):
    variances = asked.astype(weights.dtype)
    _, back = jax.vjp(lambda variance: _propagate_variance(shaded, weights, variance, alike), jnp.zeros_like(variances))
    return back(variances)[0]
