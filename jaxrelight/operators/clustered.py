"""The clustered operator: rows of near receivers as mixtures of a few (Sloan et al. 2003; Liu et al. 2004)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Operator


class Clustered(Operator):
    """Groups of m rows, each the product of weights and q shared rows, over coefficients that the group shares.

    Where a row of n coefficients of its own gathers n numbers of light, a group of m gathers s, once: what follows is
    two dense products, of q·s and of m·q for every channel. `cluster` makes one group.

    Attributes:
        support: numbers of the group's s coefficients, ascending.
        basis: the q shared rows over them, of all channels.
        weights: of every row and channel; of 1 channel where the rows are the same in all of them (grey).
        columns: d, the number of light coefficients.
    """

    support: Int[Array, "g s"]
    basis: Float[Array, "g q s"]
    weights: Float[Array, "g m c q"]
    columns: int = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""
        g, m, c, _ = self.weights.shape
        return g * m, self.columns, c

    @property
    def nbytes(self) -> int:
        """Bytes of supports, shared rows and weights."""
        return self.support.nbytes + self.basis.nbytes + self.weights.nbytes

    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance of every row: per group one gather of light and two small products."""
        channels = light.shape[1]

        def group(part):
            support, basis, weights = part
            found = light.at[support.astype(jnp.int32)].get(mode="promise_in_bounds")
            shared = jnp.matmul(basis, found, precision="highest")  # [q, c]
            every = jnp.broadcast_to(weights, (len(weights), channels, weights.shape[-1]))
            return jnp.einsum("mcq,qc->mc", every, shared, precision="highest")

        return jax.lax.map(group, (self.support, self.basis, self.weights)).reshape(-1, channels)

    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The adjoint: the two products the other way round, and one scatter for each group."""
        g, m, _, q = self.weights.shape
        channels = radiance.shape[1]
        every = jnp.broadcast_to(self.weights, (g, m, channels, q))
        shared = jnp.einsum("gmcq,gmc->gqc", every, radiance.reshape(g, m, channels), precision="highest")
        found = jnp.einsum("gqs,gqc->gsc", self.basis, shared, precision="highest")
        out = jnp.zeros((self.columns, channels), found.dtype)
        return out.at[self.support.astype(jnp.int32)].add(found, mode="promise_in_bounds")

    def rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """The chosen rows, zero off their group's coefficients."""
        m = self.weights.shape[1]

        def row(index):
            group = index // m
            values = jnp.matmul(self.weights[group, index % m], self.basis[group], precision="highest")
            empty = jnp.zeros((values.shape[0], self.columns), values.dtype)
            return empty.at[:, self.support[group].astype(jnp.int32)].set(values)

        return jax.vmap(row)(jnp.asarray(indices))


def cluster(
    rows: Float[np.ndarray, "m c d"], coefficients: int, shared: int
) -> tuple[Int[np.ndarray, " s"], Float[np.ndarray, "q s"], Float[np.ndarray, "m c q"]]:
    """One group: support, basis and weights of least squared error on the coefficients of largest total energy.

    Args:
        rows: of the group, written out.
        coefficients: s, at most d.
        shared: q, at most s and m·c.
    """
    m, c, _ = rows.shape
    energy = np.sum(rows.astype(float) ** 2, axis=(0, 1))
    support = np.sort(np.argpartition(energy, -coefficients)[-coefficients:])
    u, sigma, vt = scipy.linalg.svd(rows[:, :, support].reshape(m * c, -1), full_matrices=False)
    root = np.sqrt(sigma[:shared])
    return support, root[:, None] * vt[:shared], (u[:, :shared] * root).reshape(m, c, -1)
