"""The cloud of points that stand for all surfaces, with what they reflect and emit."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.gather.gather_cloud import GatherCloud
from jaxrelight.operators.contract import Operator


@dataclasses.dataclass(frozen=True)
class LitCloud:
    """Points that stand for all surfaces, where light comes from that is gathered (Hašan 2006).

    Attributes:
        points: of the cloud.
        albedo: theirs.
        emission: radiance that they emit.
        between: the operator from light of the cloud to what its points get, over π; None where one bounce is all.
        slot_of: the row of `between` that each point has.
    """

    points: GatherCloud
    albedo: Float[np.ndarray, "g c"]
    emission: Float[np.ndarray, "g c"]
    between: Operator | None
    slot_of: Int[np.ndarray, " g"]
