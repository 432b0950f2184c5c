"""Numbers of a summary."""

from typing import Any

import numpy as np


def known(values: Any) -> Any:
    """Numbers, and lists of them, as JSON has them; None for those that are not finite."""
    if np.ndim(values):
        return [known(value) for value in values]
    return float(values) if np.isfinite(values) else None


def percent(share: float | np.floating) -> str:
    """A share as people read it."""
    return f"{100 * share:.3g} %" if np.isfinite(share) else "not known"
