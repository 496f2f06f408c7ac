"""What rounding leaves of a residual."""

from __future__ import annotations

import numpy as np

__all__ = ["EPSILON", "MAX_ROUNDING", "ROUNDING", "least_residual"]

EPSILON, ROUNDING = float(np.finfo(float).eps), 1e-13
MAX_ROUNDING = 1e-5
"""|F| / |x| that rounding may leave at most; equations that ask for more are refused."""


def least_residual(slope: float) -> float:
    """What rounding leaves of |F| / |x| where F changes by at most so much times |x|."""
    return max(ROUNDING, min(MAX_ROUNDING, EPSILON * slope))
