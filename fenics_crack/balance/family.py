"""Families of the condensed equations along one parameter, as :mod:`arclength` follows them.

    F(g, v) = g - g_lin(v) + R(v) b(g, v) = 0,        v = v_start + p (v_end - v_start)

with the parameter v a load frequency, a factor of the load, of the damping or of the contact
stiffness, or a clearance. Only the small or reduced structure is touched, in closed form.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance, load_coefficients
from fenics_crack.balance.condensed import CondensedSystem
from fenics_crack.balance.contact_integrals import contact_integrals
from fenics_crack.errors import InputError, check_number, check_omega
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure

__all__ = ["FAMILIES", "Family", "FrequencyFamily"]

Problem = tuple[Structure, ContactLaw]


class Family(ABC):
    """The condensed equations along a parameter.

    Parameters
    ----------
    structure : Structure
        Small or reduced.
    omega : float [rad/s]
        Load frequency, where it is not the parameter.
    contact : ContactLaw
        Law of all pairs.
    start, end : float
        The parameter's values at p = 0 and 1.
    harmonics, samples, subharmonic
        As in :func:`solve_harmonic_balance`.

    Attributes
    ----------
    system : CondensedSystem
        The equations at the parameter set last.
    """

    name: str

    def __init__(
        self,
        structure: Structure,
        omega: float,
        contact: ContactLaw,
        start: float,
        end: float,
        harmonics: int,
        samples: int | None,
        subharmonic: int,
    ) -> None:
        self.structure, self.contact = structure, contact
        self.start, self.end = start, end
        self.harmonics, self.samples, self.subharmonic = harmonics, samples, subharmonic
        self._omega = omega
        self._parameter = 0.0
        load = load_coefficients(structure, harmonics, subharmonic)
        compliance = ModalCompliance(structure, omega / subharmonic, load)
        integrals = contact_integrals(contact, harmonics, samples, subharmonic)
        self.system = CondensedSystem(compliance, integrals)
        self._compliance = compliance
        self.set_value(start)

    @classmethod
    def check(cls, structure: Structure, key: str, value: float) -> None:
        """Raise InputError unless the parameter can have a value."""
        check_number(key, value, 0.0, above=True)

    def with_harmonics(self, harmonics: int) -> Family:
        """The same family with other harmonics."""
        return type(self)(
            self.structure,
            self._omega,
            self.contact,
            self.start,
            self.end,
            harmonics,
            self.samples,
            self.subharmonic,
        )

    def value(self, parameter: float) -> float:
        """v of p."""
        return self.start + parameter * (self.end - self.start)

    def parameter(self, value: float) -> float:
        """p of v."""
        return (value - self.start) / (self.end - self.start)

    def omega(self, value: float) -> float:
        """Load frequency [rad/s] where the parameter has a value."""
        return self._omega

    @classmethod
    @abstractmethod
    def vary(cls, structure: Structure, contact: ContactLaw, value: float) -> Problem:
        """Structure and law where the parameter has a value."""

    def compliance(self, value: float) -> ModalCompliance:
        """Dynamic compliance where the parameter has a value."""
        return self._compliance

    @abstractmethod
    def set_value(self, value: float) -> None:
        """Make :attr:`system` that of a value."""

    @abstractmethod
    def _derivative(self, unknown: np.ndarray) -> np.ndarray:
        """dF / dv."""

    # --- what arclength asks for ------------------------------------------------------------------

    def set_parameter(self, parameter: float) -> None:
        """Set p."""
        if parameter != self._parameter:
            self.set_value(self.value(parameter))
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
        return (self.end - self.start) * self._derivative(unknown)

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return self.system.inner(first, second)


class _ComplianceFamily(Family):
    """The parameter changes the dynamic compliance or the linear gap."""

    def set_value(self, value: float) -> None:
        """Another compliance."""
        self._current = self.compliance(value)
        self.system = CondensedSystem(self._current, self.system.integrals)

    def _force(self, unknown: np.ndarray) -> np.ndarray:
        return self.system.gap_and_force(unknown)[1]


class FrequencyFamily(_ComplianceFamily):
    """v: load frequency [rad/s]."""

    name = "omega"

    @classmethod
    def check(cls, structure: Structure, key: str, value: float) -> None:
        """Raise InputError unless it is a frequency."""
        check_omega(value, key)

    def omega(self, value: float) -> float:
        """The value itself."""
        return value

    @classmethod
    def vary(cls, structure: Structure, contact: ContactLaw, value: float) -> Problem:
        """At another frequency."""
        return structure, contact

    def compliance(self, value: float) -> ModalCompliance:
        """At another frequency."""
        return self._compliance.at(value / self.subharmonic)

    def _derivative(self, unknown: np.ndarray) -> np.ndarray:
        return self._current.frequency_derivative(self._force(unknown)) / self.subharmonic


class _VariedFamily(_ComplianceFamily):
    """The parameter is one of those of :meth:`Structure.varied`, by its name."""

    @classmethod
    def vary(cls, structure: Structure, contact: ContactLaw, value: float) -> Problem:
        """Another structure."""
        return structure.varied(**{cls.name: value}), contact

    def compliance(self, value: float) -> ModalCompliance:
        """Of the varied structure."""
        return self._compliance.at(self._omega / self.subharmonic, **{self.name: value})


class LoadFamily(_VariedFamily):
    """v: factor of the load."""

    name = "load"

    @classmethod
    def check(cls, structure: Structure, key: str, value: float) -> None:
        """Raise InputError unless it is a number; a negative one reverses the load."""
        check_number(key, value)

    def _derivative(self, unknown: np.ndarray) -> np.ndarray:
        return self._current.load_derivative()


class DampingFamily(_VariedFamily):
    """v: factor of the damping."""

    name = "damping"

    @classmethod
    def check(cls, structure: Structure, key: str, value: float) -> None:
        """Raise InputError unless it is a number >= 0 and there is damping to change."""
        check_number(key, value, 0.0)
        if structure.damping is None:
            raise InputError("parameter", "damping", "another one: the structure has no damping")

    def _derivative(self, unknown: np.ndarray) -> np.ndarray:
        return self._current.damping_derivative(self._force(unknown))


class ClearanceFamily(_VariedFamily):
    """v: clearance [m] added to that of every pair."""

    name = "clearance"

    @classmethod
    def check(cls, structure: Structure, key: str, value: float) -> None:
        """Raise InputError unless it is a number."""
        check_number(key, value)

    def _derivative(self, unknown: np.ndarray) -> np.ndarray:
        change = np.zeros_like(unknown)
        change[0] = 1.0
        return change


class StiffnessFamily(Family):
    """v: factor of the contact stiffness; p is proportional to ln v."""

    name = "stiffness"

    def value(self, parameter: float) -> float:
        """v of p."""
        return float(self.start * (self.end / self.start) ** parameter)

    def parameter(self, value: float) -> float:
        """p of v."""
        return float(np.log(value / self.start) / np.log(self.end / self.start))

    @classmethod
    def vary(cls, structure: Structure, contact: ContactLaw, value: float) -> Problem:
        """With another law."""
        return structure, contact.scaled(value)

    def set_value(self, value: float) -> None:
        """Another law."""
        self.system.with_law(self.contact.scaled(value))

    def parameter_derivative(self, unknown: np.ndarray) -> np.ndarray:
        """dF/dp = ln(v_end / v_start) R b."""
        return float(np.log(self.end / self.start)) * self._derivative(unknown)

    def _derivative(self, unknown: np.ndarray) -> np.ndarray:
        return self.system.stiffness_derivative(unknown)


FAMILIES: dict[str, type[Family]] = {
    family.name: family
    for family in (FrequencyFamily, LoadFamily, StiffnessFamily, DampingFamily, ClearanceFamily)
}
