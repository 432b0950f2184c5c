"""Golub–Kahan bidiagonalisation: what a linear map does, seen from one right side, through the map and its adjoint.

After k steps A V = U B with V and U orthonormal, B lower bidiagonal and b = β U e₁. So least squares over the span of V
are those of B, a k × k problem for any strength of regularisation; the singular values of B are close to the largest of
A. See Golub and Kahan 1965; Paige and Saunders 1982 (LSQR); Simon and Zha 2000 for orthogonality on one side.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Map = Callable[[np.ndarray], np.ndarray]
# Numbers below this share of the largest singular value are rounding of single precision.
_NOTHING = 1e-6


@dataclasses.dataclass
class Bidiagonal:
    """The steps so far, of c problems side by side.

    Attributes:
        V: k orthonormal unknowns, [m, c] each.
        diagonal: α of B, [k, c].
        below: β under the diagonal, [k, c].
        right_side: β of b, [c].
        next_vector: where the next step goes, [m, c]; 0 where nothing is left.
        next_alpha: α of it, [c].
        left: the last column of U, [n, c].
        joint: whether the c columns are one problem.
    """

    V: list[Float[np.ndarray, "m c"]]
    diagonal: Float[np.ndarray, "k c"]
    below: Float[np.ndarray, "k c"]
    right_side: Float[np.ndarray, " c"]
    next_vector: Float[np.ndarray, "m c"]
    next_alpha: Float[np.ndarray, " c"]
    left: Float[np.ndarray, "n c"]
    joint: bool

    @property
    def steps(self) -> int:
        """How many, k."""
        return len(self.diagonal)

    @property
    def is_done(self) -> bool:
        """Whether nothing is left that the map would show."""
        largest = self.diagonal.max(axis=0, initial=0) if self.steps else self.next_alpha
        return bool((self.next_alpha <= _NOTHING * np.maximum(largest, np.finfo(float).tiny)).all())

    def matrix(self, channel: int) -> Float[np.ndarray, "k1 k"]:
        """B of one problem."""
        k = self.steps
        matrix = np.zeros((k + 1, k))
        matrix[np.arange(k), np.arange(k)] = self.diagonal[:, channel]
        matrix[np.arange(1, k + 1), np.arange(k)] = self.below[:, channel]
        return matrix

    def gradient(self) -> Float[np.ndarray, "m c"]:
        """Aᵀb, which is a multiple of the first vector."""
        first = self.V[0] if self.steps else self.next_vector
        alpha = self.diagonal[0] if self.steps else self.next_alpha
        return first * (alpha * self.right_side)[None]

    def mixed(self, weights: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "m c"]:
        """Σ_k V_k y_k."""
        total = np.zeros(self.next_vector.shape)
        for v, weight in zip(self.V, weights, strict=True):
            total += v * weight[None]
        return total


def begin(b: Float[np.ndarray, "n c"], adjoint: Map, *, joint: bool = False) -> Bidiagonal:
    """Before the first step.

    Args:
        b: right sides of c problems that the map does not mix.
        adjoint: Aᵀ.
        joint: whether the c columns are one problem, which the map may mix.
    """
    beta = _norm(b, joint)
    u = _divided(b, beta)
    v = np.asarray(adjoint(u), np.float64)
    alpha = _norm(v, joint)
    nothing = np.zeros((0, v.shape[1]))
    return Bidiagonal([], nothing, nothing, beta, _divided(v, alpha), alpha, u, joint)


def step(state: Bidiagonal, image: Float[np.ndarray, "n c"], adjoint: Map) -> Bidiagonal:
    """One step further: one product with the map, which the caller has made, and one with its adjoint.

    Args:
        state: so far.
        image: A times `state.next_vector`.
        adjoint: Aᵀ.
    """
    v, alpha = state.next_vector, state.next_alpha
    u = np.asarray(image, np.float64) - alpha[None] * state.left
    beta = _norm(u, state.joint)
    u = _divided(u, beta)
    V = [*state.V, v.astype(np.float32)]
    following = np.asarray(adjoint(u), np.float64) - beta[None] * v
    # Twice: what the first time leaves is of the order of rounding.
    for _ in range(2):
        _take_away(V, following, state.joint)
    next_alpha = _norm(following, state.joint)
    largest = np.maximum(state.diagonal.max(axis=0, initial=0), alpha)
    is_left = next_alpha > _NOTHING * largest
    return Bidiagonal(
        V,
        np.concatenate([state.diagonal, alpha[None]]),
        np.concatenate([state.below, beta[None]]),
        state.right_side,
        _divided(following, np.where(is_left, next_alpha, 0)),
        np.where(is_left, next_alpha, 0),
        u,
        state.joint,
    )


def _norm(x: np.ndarray, joint: bool) -> Float[np.ndarray, " c"]:
    squares = np.einsum("ic,ic->c", x, x)
    return np.sqrt(np.full_like(squares, squares.sum()) if joint else squares)


def _divided(x: np.ndarray, by: np.ndarray) -> np.ndarray:
    return x * np.where(by > 0, 1 / np.where(by > 0, by, 1), 0)[None]


def _take_away(V: list[np.ndarray], x: np.ndarray, joint: bool) -> None:
    """Makes x orthogonal to all of V, in place."""
    for v in V:
        shares = np.einsum("mc,mc->c", v, x)
        x -= v * (np.full_like(shares, shares.sum()) if joint else shares)[None]
