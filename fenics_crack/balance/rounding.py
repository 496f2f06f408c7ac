"""What rounding leaves of the contact force.

A gap rounded to eps |g| makes a contact force rounded to eps k |g|, which moves the gap by
eps k R |g|: no residual can be smaller than that (:mod:`fenics_crack.numerics.rounding`).
"""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.compliance import Compliance
from fenics_crack.errors import InputError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.numerics.rounding import EPSILON, MAX_ROUNDING

__all__ = ["SOFT", "check_stiffness", "stiffness_times_compliance"]

SOFT = 0.05
"""k R up to which contact is so soft that the solution is unique and close to the linear one."""


def stiffness_times_compliance(compliance: Compliance, law: ContactLaw) -> float:
    """Largest k R over the harmonics."""
    largest = np.abs(compliance.matrices).sum(axis=2).max()
    return float(largest * np.max(law.stiffness))


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
