"""Families of the condensed equations along a parameter, as :mod:`arclength` follows them."""

from __future__ import annotations

import numpy as np

from fenics_crack.arclength import PathPoint
from fenics_crack.compliance import ModalCompliance, load_coefficients
from fenics_crack.condensed import CondensedSystem
from fenics_crack.contact import ContactLaw
from fenics_crack.contact_integrals import contact_integrals
from fenics_crack.structure import Structure

__all__ = ["FrequencyFamily"]


class FrequencyFamily:
    """The condensed equations with the parameter p = (w - w_start) / (w_end - w_start)."""

    def __init__(
        self,
        structure: Structure,
        omega_start: float,
        omega_end: float,
        contact: ContactLaw,
        harmonics: int,
        samples: int | None,
        subharmonic: int,
    ) -> None:
        self._start, self._span = omega_start, omega_end - omega_start
        self._integrals = contact_integrals(contact, harmonics, samples, subharmonic)
        load = load_coefficients(structure, harmonics, subharmonic)
        self._subharmonic = subharmonic
        self._parameter = 0.0
        self._compliance = ModalCompliance(structure, self.base(0.0), load)
        self.system = CondensedSystem(self._compliance, self._integrals)

    def omega(self, parameter: float) -> float:
        """Load frequency [rad/s]."""
        return self._start + parameter * self._span

    def base(self, parameter: float) -> float:
        """Frequency of the response [rad/s]."""
        return self.omega(parameter) / self._subharmonic

    def set_parameter(self, parameter: float) -> None:
        """Set p."""
        if parameter != self._parameter:
            self._compliance = self._compliance.at(self.base(parameter))
            self.system = CondensedSystem(self._compliance, self._integrals)
            self._parameter = parameter

    def residual(self, unknown: np.ndarray) -> np.ndarray:
        """F(g, p)."""
        return self.system.residual(unknown)

    def linearise(self, unknown: np.ndarray) -> None:
        """Evaluate J."""
        self.system.linearise(unknown)

    def solve_jacobian(self, residual: np.ndarray) -> np.ndarray:
        """J^-1 r."""
        return self.system.solve_jacobian(residual)

    def determinant_sign(self) -> float:
        """Sign of det J."""
        return self.system.determinant_sign()

    def parameter_derivative(self, unknown: np.ndarray) -> np.ndarray:
        """dF/dp."""
        force = self.system.gap_and_force(unknown)[1]
        change = self._compliance.frequency_derivative(force)
        return self._span / self._subharmonic * change

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return self.system.inner(first, second)

    def land(self, after: PathPoint, before: PathPoint | None) -> PathPoint | None:
        """The point of the path at p = 1, from points on both sides of it; None if not found."""
        unknown = after.unknown
        if before is not None:
            share = (1.0 - before.parameter) / (after.parameter - before.parameter)
            unknown = before.unknown + share * (after.unknown - before.unknown)
        self.set_parameter(1.0)
        for iterations in range(20):
            residual = self.residual(unknown)
            if self.system.norm(residual) <= 1e-10 * self.system.norm(unknown):
                return PathPoint(unknown, 1.0, iterations, after.tangent)
            self.linearise(unknown)
            unknown = unknown - self.solve_jacobian(residual)
        return None
