"""A problem of harmonic balance: all that a solution depends on but its start."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.balance.compliance import Compliance, dynamic_compliance, load_coefficients
from fenics_crack.balance.contact_integrals import ContactIntegrals, contact_integrals
from fenics_crack.errors import MAX_SAMPLES, InputError, check_count, check_omega
from fenics_crack.model.contact import ContactLaw, check_law, is_rigid
from fenics_crack.model.structure import Structure

__all__ = ["Problem"]


@dataclass(frozen=True)
class Problem:
    """A structure under its load, the law of its pairs, and how its motion is balanced.

    Attributes
    ----------
    structure : Structure
        What vibrates under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw
        Law of all pairs; :class:`UnilateralConstraint` too.
    harmonics : int
        H, the highest multiple of ``omega / subharmonic`` kept.
    samples : int, optional
        Instants per period of the response at which the contact force is evaluated. Default: none,
        but exact integrals, where the law is piecewise linear; else 1024 for each period of the
        load, or 32 H where that is more.
    subharmonic : int
        The response has this many times the load's period.

    Raises
    ------
    InputError
        A value cannot be used.
    """

    structure: Structure
    omega: float
    contact: ContactLaw
    harmonics: int = 5
    samples: int | None = None
    subharmonic: int = 1

    def __post_init__(self) -> None:
        check_omega(self.omega)
        check_count("subharmonic", self.subharmonic, 1)
        check_count("harmonics", self.harmonics, self.subharmonic)
        check_law(self.structure, self.contact, rigid=True)
        if self.structure.n_pairs == 0:
            raise InputError(
                "structure", "0 pairs", "one with contact pairs; else use solve_linear"
            )
        if self.samples is not None:
            if is_rigid(self.contact):
                raise InputError("samples", self.samples, "left out with UnilateralConstraint")
            check_count("samples", self.samples, 2 * self.harmonics + 1)
            if self.samples > MAX_SAMPLES:
                raise InputError("samples", self.samples, f"at most {MAX_SAMPLES}")

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def load(self) -> np.ndarray:
        """c: coefficients of the load, (2H+1, n_local) [N]."""
        return load_coefficients(self.structure, self.harmonics, self.subharmonic)

    def integrals(self) -> ContactIntegrals:
        """How the contact force is integrated."""
        return contact_integrals(self.contact, self.harmonics, self.samples, self.subharmonic)

    def compliance(self) -> Compliance:
        """Compliance at the multiples of the base frequency, to be destroyed (collective)."""
        return dynamic_compliance(self.structure, self.base_omega, self.harmonics, self.subharmonic)

    def with_harmonics(self, harmonics: int) -> Problem:
        """The same with other harmonics."""
        return replace(self, harmonics=harmonics)
