"""A periodic solution: Fourier coefficients, and what can be asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import ClassVar

import numpy as np

from fenics_crack.compliance import dynamic_compliance
from fenics_crack.contact import (
    ContactLaw,
    UnilateralConstraint,
    check_law_parts,
    law_parts,
)
from fenics_crack.error_report import ErrorReport
from fenics_crack.errors import InputError
from fenics_crack.fourier import evaluate
from fenics_crack.scene import Scene
from fenics_crack.store import reading, write
from fenics_crack.structure import Structure

__all__ = ["PeriodicSolution", "Stability"]


@dataclass(frozen=True)
class Stability:
    """Floquet multipliers and what follows from them.

    Attributes
    ----------
    multipliers : (2n,) complex
        Largest modulus first.
    verdict : "stable", "unstable" or "undecided"
        Undecided where the largest modulus lies on different sides of 1 with the switching
        instants of the solution, with those of a wave with more harmonics, and by Hill's
        determinant.
    uncertainty : float
        Largest difference between these three; nan where Hill's determinant has no root nearby.
    refined : bool
        Whether these are the multipliers of the exact orbit, found by shooting.
    """

    multipliers: np.ndarray
    verdict: str
    uncertainty: float
    refined: bool = False


@dataclass(frozen=True)
class PeriodicSolution:
    """Steady vibration u(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t), w = omega / subharmonic.

    Attributes
    ----------
    structure : Structure
        What vibrates.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw, UnilateralConstraint or None
        Law between the lips; None for the linear solution with lips that pass through each other.
    displacement_coefficients : (2H+1, n_local) [m]
        Rows a0, a1, b1, ..., aH, bH; the columns of the dofs that this rank owns.
    gap_coefficients : (2H+1, n_pairs) [m]
        Closing of the pairs, g = B^T u - g0, in the same order, on every rank.
    force_coefficients : (2H+1, n_pairs) [N]
        Contact force, likewise.
    subharmonic : int
        The response has this many times the load's period; rows count multiples of
        omega/subharmonic.
    converged : bool
        Whether the residual met the tolerance.
    status : str
        What was tried and how it ended, for people.
    iterations : int
        Newton iterations, all attempts together.
    report : ErrorReport
        Estimated errors, relative to the gap's amplitude.
    stability : Stability or None
        Where it has been judged (:func:`fenics_crack.floquet`).
    """

    structure: Structure
    omega: float
    contact: ContactLaw | UnilateralConstraint | None
    displacement_coefficients: np.ndarray
    gap_coefficients: np.ndarray
    force_coefficients: np.ndarray
    subharmonic: int = 1
    converged: bool = True
    status: str = "linear"
    iterations: int = 0
    report: ErrorReport = ErrorReport(0.0, 0.0, 0.0, 0.0, 0.0)
    stability: Stability | None = None

    KIND: ClassVar[str] = "periodic solution"

    @property
    def harmonics(self) -> int:
        """H, the highest harmonic kept."""
        return (len(self.gap_coefficients) - 1) // 2

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def period(self) -> float:
        """Period of the response [s]."""
        return float(2.0 * np.pi / self.base_omega)

    def gap(self, time: np.ndarray) -> np.ndarray:
        """Closing of the pairs at times [s]: (len(time), n_pairs) [m]; negative: open."""
        return evaluate(self.gap_coefficients, self.base_omega, time)

    def contact_force(self, time: np.ndarray) -> np.ndarray:
        """Contact force lambda(g(t)) at times [s]: (len(time), n_pairs) [N].

        Without a law that gives it from the gap: eps max(0, g + lambda / eps) of the waves.
        """
        gap = self.gap(time)
        if self.contact is None:
            return np.zeros_like(gap)
        if isinstance(self.contact, UnilateralConstraint):
            force = evaluate(self.force_coefficients, self.base_omega, time)
            assert self.contact.weight is not None
            return np.maximum(0.0, self.contact.weight * gap + force)
        return self.contact.force(gap)

    def displacement(self, time: np.ndarray, dofs: Sequence[int]) -> np.ndarray:
        """Displacement of dofs at times [s]: (len(time), len(dofs)) [m] (collective)."""
        return evaluate(self.coefficients_at(dofs), self.base_omega, time)

    def coefficients_at(self, dofs: Sequence[int]) -> np.ndarray:
        """Coefficients of the displacement of dofs: (2H+1, len(dofs)) [m] (collective)."""
        return self.structure.values_at(self.displacement_coefficients, dofs)

    def displacement_field(self, time: np.ndarray) -> np.ndarray:
        """Displacement of the whole structure's dofs on this rank: (len(time), n_local) [m]."""
        rows = self.structure.expand(self.displacement_coefficients)
        return evaluate(rows, self.base_omega, time)

    # --- on disk ----------------------------------------------------------------------------------

    def save(self, path: str | Path, scene: Scene | None = None) -> None:
        """Write the solution to an HDF5 file, with its scene if there is one (collective).

        The file holds gap and contact force, from which the displacement follows: it does not
        depend on the number of ranks.
        """
        parts = {
            "omega": self.omega,
            "gap_coefficients": self.gap_coefficients,
            "force_coefficients": self.force_coefficients,
            "subharmonic": self.subharmonic,
            "converged": self.converged,
            "status": self.status,
            "iterations": self.iterations,
            **{f"error_{name}": value for name, value in asdict(self.report).items()},
            **law_parts(self.contact),
        }
        if isinstance(self.contact, UnilateralConstraint):
            parts["weight"] = self.contact.weight
        if self.stability is not None:
            parts |= asdict(self.stability)
        write(path, self.KIND, parts, scene, self.structure.comm)

    @classmethod
    def load(
        cls,
        path: str | Path,
        structure: Structure,
        contact: ContactLaw | UnilateralConstraint | None,
    ) -> PeriodicSolution:
        """Read a solution written by :meth:`save`; nothing but the displacement is computed again.

        Parameters
        ----------
        path : path
            The file.
        structure, contact : Structure, ContactLaw, UnilateralConstraint or None
            Those with which it was found.

        Raises
        ------
        InputError
            The file is not one of :meth:`save`, or the structure has other pairs.
        """
        with reading(path, cls.KIND) as parts:
            gap, force = parts["gap_coefficients"], parts["force_coefficients"]
            if gap.ndim != 2 or gap.shape != force.shape or not len(gap) % 2:
                raise ValueError("coefficients do not fit")
            check_pairs(structure, gap)
            check_law_parts(parts, contact)
            if isinstance(contact, UnilateralConstraint):
                contact = UnilateralConstraint(float(parts["weight"]))
            omega, subharmonic = float(parts["omega"]), int(parts["subharmonic"])
            stability = None
            if "verdict" in parts:
                stability = Stability(
                    parts["multipliers"],
                    parts["verdict"],
                    float(parts["uncertainty"]),
                    bool(parts["refined"]),
                )
            names = [field.name for field in fields(ErrorReport)]
            report = ErrorReport(*[float(parts[f"error_{name}"]) for name in names])
            converged, status = bool(parts["converged"]), parts["status"]
            iterations = int(parts["iterations"])
        compliance = dynamic_compliance(structure, omega / subharmonic, len(gap) // 2, subharmonic)
        displacement = compliance.displacement(force)
        compliance.destroy()
        if converged:
            check_gap(structure, displacement, gap, max(1e-6, 10.0 * report.residual))
        return cls(
            structure,
            omega,
            contact,
            displacement,
            gap,
            force,
            subharmonic=subharmonic,
            converged=converged,
            status=status,
            iterations=iterations,
            report=report,
            stability=stability,
        )


def check_pairs(structure: Structure, gaps: np.ndarray) -> None:
    """Raise InputError unless a structure has as many pairs as gaps (..., n_pairs)."""
    if gaps.shape[-1] != structure.n_pairs:
        allowed = f"one with {gaps.shape[-1]} pairs"
        raise InputError("structure", f"{structure.n_pairs} pairs", allowed)


def check_gap(
    structure: Structure, displacement: np.ndarray, gap: np.ndarray, tolerance: float
) -> None:
    """Raise InputError unless coefficients of displacement and gap belong together (collective)."""
    closing = structure.closing(displacement)
    size = np.linalg.norm(closing)
    closing[0] -= structure.clearance
    if np.linalg.norm(closing - gap) > tolerance * size:
        raise InputError("structure", "another load, mesh or material", "that of the file")
