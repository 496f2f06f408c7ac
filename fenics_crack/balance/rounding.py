"""What rounding leaves of a residual."""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.block import BlockSystem
from fenics_crack.balance.condensed import CondensedSystem
from fenics_crack.model.contact import ContactLaw

__all__ = ["EPSILON", "MOST_ROUNDING", "ROUNDING", "stiffness_times_compliance"]


EPSILON, ROUNDING = float(np.finfo(float).eps), 1e-13


MOST_ROUNDING = 1e-5
"""eps k R_0, of the static compliance, beyond which a stiffness is refused."""


def stiffness_times_compliance(system: CondensedSystem | BlockSystem, law: ContactLaw) -> float:
    """Largest k R over the harmonics."""
    largest = np.abs(system.compliance.matrices).sum(axis=2).max()
    return float(largest * np.max(law.stiffness))
