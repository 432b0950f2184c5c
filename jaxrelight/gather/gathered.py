"""What one group of receivers gathers."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Gathered(NamedTuple):
    """Bounced light of one group of m receivers, by one reflection.

    Attributes:
        columns: numbers of the coefficients that any row may hold, ascending.
        rows: over them; elsewhere they are 0.
        emitted: light terms of what surfaces emit; None where none does.
    """

    columns: Int[np.ndarray, " n"]
    rows: Float[np.ndarray, "m k c n"]
    emitted: Float[np.ndarray, "m k c"] | None
