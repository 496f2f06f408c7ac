"""The phase at the load, and the equations of a solution together with the frequency at which the
displacement there has no part in phase with the load: the phase resonance.

To the condensed equations F(s, v, w) = 0 (:mod:`contact_system`), w the load's frequency and v a
factor of all of the load but its mean, one is added,

    Re P / Im P = 0,        P = f_k^H u_k,

f_k and u_k being the complex coefficients of the harmonic that excites, the load's (of a wheel what
acts on the watched blade) and the displacement's. Re P / Im P is linear in w next to a resonance of
one mode. The Jacobian is bordered by one row and one column.

Contact of pairs that are open or closed is conewise linear: the motion is v times that under the
load itself where the mean load and the clearance are 1 / v of theirs. These are all in the mean of
the linear gap, so v has a part in F / v, of s / v, there alone, and none in P / v.

Other modes beside it, and other harmonics, shift the phase. U(w) being the displacement along the
load, on the response curve through the point,

    d ln U / dw = -2 i / D       of one mode with the half-power width D,

so that the real part beside the imaginary one is the distance to the top of the curve, over the
width: twice of what the others shift.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_system import ContactPoint
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.basics.tables import Described, with_frequency
from fenics_crack.model.structure import Structure
from fenics_crack.model.wheel import Wheel
from fenics_crack.numerics.equations import Linearisation

SEVERAL = 0.1
"""Distance of the phase resonance from the top of the curve over the half-power width, from which
on several modes answer: the amplitude is then 2 % below the top."""


@dataclass(frozen=True)
class Drive:
    """The harmonic of a load that excites.

    Attributes
    ----------
    harmonic : int
        k.
    rows : (2, n_dofs) [N]
        Its cosine and sine parts; of a wheel those on the watched blade.
    """

    harmonic: int
    rows: np.ndarray

    @classmethod
    def of(cls, structure: Structure, harmonic: int) -> Drive:
        """That of a structure."""
        part, whole = slice(2 * harmonic - 1, 2 * harmonic + 1), structure.whole
        if not isinstance(whole, Wheel):
            return cls(harmonic, structure.force[part])
        numbers = np.unique(whole.numbers[whole.first, ~whole.sector.dofs.after])
        dofs = numbers[np.any(whole.force[part, numbers], axis=0)]
        blade = structure.values_at(np.eye(structure.n_dofs), dofs.tolist())
        return cls(harmonic, whole.force[part, dofs] @ blade.T)

    def power(self, at: ContactPoint, force: np.ndarray | None = None) -> complex:
        """P [N m] at a point, or of other contact forces there."""
        found = compliance_of(at).selected_displacement(
            self.rows, at.force if force is None else force
        )
        return self._of(found)

    def power_by_omega(self, at: ContactPoint) -> complex:
        """dP/dw for fixed contact forces."""
        return self._of(compliance_of(at).selected_displacement_by_omega(self.rows, at.force))

    def _of(self, waves: np.ndarray) -> complex:
        """P of the coefficients (2H+1, 2) of both rows' products with a displacement."""
        cosine, sine = waves[2 * self.harmonic - 1], waves[2 * self.harmonic]
        return complex(cosine[0] + sine[1], cosine[1] - sine[0])


def compliance_of(at: ContactPoint) -> ModalCompliance:
    """That of a small structure."""
    assert isinstance(at.system.compliance, ModalCompliance)
    return at.system.compliance


@dataclass(eq=False)
class PhasePoint(Linearisation):
    """The equations at a point: unknowns s over ``size`` v, and w over that of the problem.

    Attributes
    ----------
    problem : Problem
        What is balanced where v is 1, next to w.
    at : ContactPoint
        F of s / v where v is 1.
    omega : float [rad/s]
        w.
    inverse, change : float
        1 / v, and its derivative by the parameter.
    over_frequency, power_over_frequency : (2H+1, n_pairs), complex
        ds/dw and dP/dw over v, along the response curve through the point.
    """

    problem: Problem
    drive: Drive
    at: ContactPoint
    omega: float
    size: float
    inverse: float = 1.0
    change: float = 0.0

    def __post_init__(self) -> None:
        self.unknown = np.append(self.at.unknown / self.size, self.omega / self.problem.omega)
        self.power = self.drive.power(self.at)

    @cached_property
    def residual(self) -> np.ndarray:  # type: ignore[override]
        moved = self.at.residual.copy()
        moved[0] += (1.0 - self.inverse) * self.at.system.linear[0]
        return np.append(moved / self.size, self.power.real / self.power.imag)

    @cached_property
    def by_parameter(self) -> np.ndarray:  # type: ignore[override]
        found = np.zeros_like(self.unknown)
        found[: len(self.at.gap[0])] = -self.change * self.at.system.linear[0] / self.size
        return found

    def _lag(self, change: complex) -> float:
        """Change of Re P / Im P with P."""
        power = self.power
        return (change.real - power.real / power.imag * change.imag) / power.imag

    def _power_by(self, change: np.ndarray) -> complex:
        """Change of P with s."""
        return self.drive.power(self.at, self.at.force + self.at.forces.apply(change)) - self.power

    @cached_property
    def over_frequency(self) -> np.ndarray:
        return -self.at.solve(compliance_of(self.at).derivative("omega", self.at.force))

    @cached_property
    def power_over_frequency(self) -> complex:
        return self.drive.power_by_omega(self.at) + self._power_by(self.over_frequency)

    def solve(self, right: np.ndarray) -> np.ndarray:
        change = self.size * self.at.solve(right[:-1].reshape(self.at.unknown.shape))
        left = right[-1] - self._lag(self._power_by(change))
        rise = left / self._lag(self.power_over_frequency)
        slow = (change + rise * self.over_frequency) / self.size
        return np.append(slow, rise / self.problem.omega)

    @property
    def sign(self) -> float:
        return self.at.sign * float(np.sign(self._lag(self.power_over_frequency)))

    @property
    def width(self) -> float:
        """D, the half-power width of one mode that would answer like this [rad/s]."""
        return -2.0 / (self.power_over_frequency / self.power).imag

    @property
    def apart(self) -> float:
        """Distance from here to the top of the response curve, over the width, as two modes would
        have it."""
        return 0.25 * self.width * (self.power_over_frequency / self.power).real

    @cached_property
    def solution(self) -> PeriodicSolution:
        """The motion, without a search for its exact orbit."""
        problem = replace(self.problem, omega=self.omega)
        return solution_of(problem, self.at, status="phase resonance", search=False)


@dataclass(frozen=True, repr=False)
class Resonance(Described):
    """The phase resonance of a structure under its load.

    Attributes
    ----------
    value : float
        Load frequency, or speed of the rotor [rad/s].
    omega : float
        Load frequency [rad/s].
    harmonic : int
        Harmonic of the load that excites.
    width : float
        Half-power width in the unit of ``value``.
    apart : float
        Distance to the top of the response curve over the width, as far as the point shows it.
    solution : PeriodicSolution
        The motion there.
    error : float
        Estimated truncation error of the amplitude, relative to it; inf where it is not known,
        nan without a tolerance.
    """

    value: float
    omega: float
    harmonic: int
    width: float
    apart: float
    solution: PeriodicSolution
    error: float = math.nan

    @property
    def several(self) -> bool:
        """True if several modes shift the phase by more than a tenth of the width: the curve shows
        where the largest response is."""
        return not abs(self.apart) <= SEVERAL

    def to_dict(self) -> dict[str, Any]:
        """Frequencies, the width, the distance to the top, the error and the amplitude."""
        names = "value", "omega", "harmonic", "width", "apart", "several", "error"
        found = {name: getattr(self, name) for name in names}
        return with_frequency(found | {"amplitude": self.solution.amplitude()})
