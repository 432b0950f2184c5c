"""The cloud of points that stand for all surfaces, with what they reflect and emit."""

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.operators.contract import Operator


class LitCloud(eqx.Module):
    """Points that stand for all surfaces, where light comes from that is gathered (Hašan 2006).

    Attributes:
        albedo: theirs, by channel.
        emission: radiance that they emit.
        of_sky: which of them are directions of the sky.
        between: the operator from light of the cloud to what its points get, over π; None where one bounce is all.
        slot_of: the row of `between` that each point has.
    """

    albedo: Float[Array, "g c"]
    emission: Float[Array, "g c"]
    of_sky: Bool[Array, " g"]
    between: Operator | None
    slot_of: Int[Array, " g"]
