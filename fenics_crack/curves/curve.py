"""Response curves: solutions along a parameter, and where they bifurcate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.condensed import CondensedSystem
from fenics_crack.balance.family import FAMILIES
from fenics_crack.balance.fourier import evaluate
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.errors import InputError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modal import all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.table import Described, Tabular, counted

__all__ = ["PARAMETERS", "Bifurcation", "ResponseCurve"]

PARAMETERS = {
    "omega": "load frequency [rad/s]",
    "load": "load, as a multiple of the scene's [-]",
    "stiffness": "contact stiffness, as a multiple of the scene's [-]",
    "damping": "damping, as a multiple of the scene's [-]",
    "clearance": "clearance added to the scene's [m]",
}
"""What a curve may be followed in, by its name in :attr:`ResponseCurve.parameter`."""


@dataclass(frozen=True, repr=False)
class Bifurcation(Described):
    """A special point of a curve.

    Attributes
    ----------
    kind : str
        "fold": the curve turns back; "branch_point": another branch crosses; "period_doubling": a
        multiplier leaves the unit circle through -1; "neimark_sacker": a pair of them leaves it
        anywhere else. The last two only with ``stability=True``.
    value : float
        Of the curve's parameter.
    gap_coefficients : (2H+1, n_pairs) [m]
        The solution there.
    solution : PeriodicSolution
        The same, with its displacement and error report.
    """

    kind: str
    value: float
    gap_coefficients: np.ndarray
    solution: PeriodicSolution

    @property
    def omega(self) -> float:
        """Load frequency [rad/s]."""
        return self.solution.omega

    def to_dict(self) -> dict[str, Any]:
        """Kind, value of the curve's parameter, and load frequency."""
        return {"kind": self.kind, "value": float(self.value), "omega": float(self.omega)}

    def _title(self) -> str:
        return f"{self.kind.replace('_', ' ')} at {self.value:.6g}, H = {self.solution.harmonics}"


@dataclass(frozen=True, repr=False)
class ResponseCurve(Tabular):
    """Solutions along a curve, in the order in which it was followed.

    Attributes
    ----------
    structure : Structure
        Whose solutions they are: small or reduced; as given, not as the parameter varies it.
    contact : ContactLaw
        Law of all pairs, likewise.
    parameter : str
        "omega", "load", "stiffness", "damping" or "clearance".
    values : (n,)
        Of the parameter: load frequencies [rad/s], factors, or clearances added [m].
    omega : (n,) [rad/s]
        Load frequencies.
    gap_coefficients : (n, 2H+1, n_pairs) [m]
        Closing of the pairs; zeros above a point's own harmonics.
    harmonics : (n,) int
        H of each point.
    iterations : (n,) int
        Newton iterations of each point.
    truncation : (n,)
        Estimated error of the harmonics left out, where it was estimated; else nan.
    bifurcations : tuple of Bifurcation
        Special points, in order along the curve.
    complete : bool
        Whether the curve reached the end that was asked for, or closed.
    status : str
        How it ended.
    samples, subharmonic : int or None, int
        As given when it was followed.
    multipliers : (n,) complex or None
        Floquet multiplier of largest modulus at each point, of a pair the one with positive
        imaginary part; with ``stability=True``.
    branch : bool
        Whether :func:`follow_branch` has followed it.
    """

    structure: Structure
    contact: ContactLaw
    parameter: str
    values: np.ndarray
    omega: np.ndarray
    gap_coefficients: np.ndarray
    harmonics: np.ndarray
    iterations: np.ndarray
    truncation: np.ndarray
    bifurcations: tuple[Bifurcation, ...]
    complete: bool
    status: str
    samples: int | None
    subharmonic: int
    multipliers: np.ndarray | None = None
    branch: bool = False

    KIND: ClassVar[str] = "response curve"

    def __len__(self) -> int:
        return len(self.values)

    @property
    def stable(self) -> np.ndarray:
        """Whether the largest multiplier lies within the unit circle: (n,) bool.

        Raises
        ------
        InputError
            The curve was followed without ``stability=True``.
        """
        if self.multipliers is None:
            raise InputError("stability", False, "True when the curve is followed")
        return np.abs(self.multipliers) < 1.0

    @property
    def problem(self) -> Problem:
        """What was solved at the first point, with the harmonics of the last one."""
        return Problem(
            self.structure,
            float(self.omega[0]),
            self.contact,
            int(self.harmonics[-1]),
            self.samples,
            self.subharmonic,
        )

    def gap(self, index: int) -> np.ndarray:
        """Gap coefficients of a point with its own harmonics: (2H+1, n_pairs) [m]."""
        return self.gap_coefficients[index, : 2 * self.harmonics[index] + 1]

    def solution(self, index: int) -> PeriodicSolution:
        """The solution at a point, with its displacement and error report."""
        return self._expanded(float(self.values[index]), self.gap(index))

    @property
    def solutions(self) -> list[PeriodicSolution]:
        """The solutions at all points."""
        return [self.solution(index) for index in range(len(self))]

    def coefficients_at(self, dof: int) -> np.ndarray:
        """Coefficients of the displacement of a dof at every point: (n, 2H+1) [m]."""
        rows = self.structure.values_at(all_modes(self.structure).shapes.T, [dof]).T
        found = np.zeros(self.gap_coefficients.shape[:2])
        for count in np.unique(self.harmonics):
            problem = self.problem.with_harmonics(int(count))
            family = FAMILIES[self.parameter](
                problem, float(self.values[0]), float(self.values[-1])
            )
            for index in np.flatnonzero(self.harmonics == count):
                system = family.system(float(self.values[index]))
                assert isinstance(system.compliance, ModalCompliance)
                force = system.integrals.force(self.gap(index))
                seen = system.compliance.seen_through(rows, force)
                found[index, : len(seen)] = seen[:, 0]
        return found

    def amplitude(self, dof: int) -> np.ndarray:
        """Half the peak-to-peak displacement of a dof at every point: (n,) [m], of 256 instants."""
        time = 2.0 * np.pi * np.arange(256) / 256
        wave = evaluate(self.coefficients_at(dof).T, 1.0, time)
        return np.asarray(np.ptp(wave, axis=0) / 2.0)

    def expand_bifurcations(
        self, special: list[tuple[str, float, np.ndarray]]
    ) -> tuple[Bifurcation, ...]:
        """Bifurcations of this curve from their kinds, parameters and gaps."""
        return tuple(
            Bifurcation(kind, value, gap, self._expanded(value, gap))
            for kind, value, gap in special
        )

    def _expanded(self, value: float, gap: np.ndarray) -> PeriodicSolution:
        """The solution that belongs to a gap where the parameter has a value."""
        problem = FAMILIES[self.parameter].vary(self.problem.with_harmonics(len(gap) // 2), value)
        compliance = problem.compliance()
        at = CondensedSystem(compliance, problem.integrals()).linearise(gap)
        found = solution_of(problem, at, status="point of a curve")
        compliance.destroy()
        return found

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every point; multipliers where the curve has them."""
        found = {
            self.parameter: self.values.tolist(),
            "omega": self.omega.tolist(),
            "harmonics": self.harmonics.tolist(),
            "iterations": self.iterations.tolist(),
            "truncation": self.truncation.tolist(),
        }
        if self.multipliers is not None:
            found["multiplier"] = np.abs(self.multipliers).tolist()
            found["stable"] = self.stable.tolist()
        return found

    def _title(self) -> str:
        parts = [
            f"{self.parameter} {self.values[0]:.6g} to {self.values[-1]:.6g}",
            counted(len(self), "point"),
            f"H = {self.harmonics.max()}",
            counted(len(self.bifurcations), "bifurcation"),
        ]
        if self.multipliers is not None:
            parts.append(f"{np.mean(self.stable):.0%} stable")
        return ", ".join([*parts, "complete" if self.complete else "NOT COMPLETE"])
