"""What rounding leaves of a residual.

A gap rounded to eps |g| makes a contact force rounded to eps k |g|, which moves the gap by
eps k R |g|: no residual can be smaller than that.
"""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.compliance import Compliance
from fenics_crack.errors import InputError
from fenics_crack.model.contact import ContactLaw

__all__ = ["ROUNDING", "SOFT", "check_stiffness", "least_residual", "stiffness_times_compliance"]

EPSILON, ROUNDING = float(np.finfo(float).eps), 1e-13
MAX_ROUNDING = 1e-5
"""eps k R_0, of the static compliance, beyond which a stiffness is refused."""
SOFT = 0.05
"""k R up to which contact is so soft that the solution is unique and close to the linear one."""


def stiffness_times_compliance(compliance: Compliance, law: ContactLaw) -> float:
    """Largest k R over the harmonics."""
    largest = np.abs(compliance.matrices).sum(axis=2).max()
    return float(largest * np.max(law.stiffness))


def least_residual(product: float) -> float:
    """What rounding leaves of |F| / |x| where the largest k R is a ``product``."""
    return max(ROUNDING, min(MAX_ROUNDING, EPSILON * product))


def check_stiffness(compliance: Compliance, law: ContactLaw) -> None:
    """Raise InputError where rounding would leave nothing of the contact force."""
    stiffest = float(np.max(law.stiffness))
    static = float(np.abs(compliance.matrices[0]).sum(axis=1).max())
    if not EPSILON * stiffest * static < MAX_ROUNDING:
        raise InputError(
            "contact stiffness",
            stiffest,
            f"at most {MAX_ROUNDING / (EPSILON * static):.2g} N/m on this structure, beyond "
            "which rounding leaves nothing; UnilateralConstraint is the limit",
        )
