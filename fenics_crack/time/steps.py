"""What step-by-step schemes share: data, the loop over a period, linear algebra."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from petsc4py import PETSc

from fenics_crack.errors import ConvergenceError
from fenics_crack.model.complementarity import solve_complementarity
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.modes import by_columns, damped_modes, times
from fenics_crack.model.reduced import check_mass
from fenics_crack.time.march import March, Scheme, Window

__all__ = ["StepScheme", "inverse_of", "solve_once"]


class StepScheme(Scheme):
    """A scheme that marches step by step."""

    remedy: ClassVar[str]
    """What to do where contact creates energy."""
    before: np.ndarray
    """Displacement (n_local,) at the instant from which :meth:`advance` has started."""
    gap: np.ndarray
    """(n_pairs,) [m], at the same instant."""
    force: np.ndarray
    """(n_pairs,) [N], at the same instant; with a constraint the mean until the next."""

    def __init__(self, asked: March) -> None:
        self.structure = structure = asked.structure
        check_mass(structure, "integrate_exponential takes others")
        self.contact, self.rigid = asked.contact, is_rigid(asked.contact)
        self.step_size = asked.step_size
        self.force = np.zeros(structure.n_pairs)
        # Only few rows of B and of the load are not zero.
        self._gap_rows = np.flatnonzero(np.diff(structure.gap.indptr))
        self._gap_block = structure.gap[self._gap_rows].toarray()
        self.load_rows = asked.load_rows
        phase = 2.0 * np.pi * np.arange(asked.steps_per_period) / asked.steps_per_period
        waves = np.column_stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
        self.load = waves @ structure.force[:, self.load_rows]
        """(N, rows) [N]"""
        self._columns = asked.recorded_dofs - structure.first_dof
        self._modes, self._damping = damped_modes(structure), structure.damping_matrix
        self._put_in = self._created = 0.0

    @abstractmethod
    def advance(self, step: int) -> None:
        """March from an instant, ``step`` of the period, to the next."""

    @abstractmethod
    def _book(self, window: Window) -> None:
        """Add the energies put in and created in a period."""

    def fill(self, window: Window, number: int) -> None:
        """Raises ConvergenceError where contact has created too much energy."""
        gap, force = window.gap, window.force
        motion, load_motion = window.motion, window.load_motion
        for step in range(len(gap)):
            self.advance(step)
            gap[step], force[step] = self.gap, self.force
            load_motion[step] = self.before[self.load_rows]
            motion[step] = self.before[self._columns]
        self._book(window)
        if self._put_in > 0.0:
            self.created_share = self._created / self._put_in
        if not np.isfinite(self._created) or self._created > 2.0 * self._put_in > 0.0:
            raise ConvergenceError(
                f"{self.name}: the steps are too long for this contact, which creates "
                f"{self.created_share:.3g} times the energy put in; {self.remedy}"
            )

    def _total(self, part: float) -> float:
        """Sum over the ranks."""
        return float(self.structure.sum_over_ranks(np.array([part]))[0])

    def _closing(self, motion: np.ndarray) -> np.ndarray:
        """B^T of a motion (n_local,)."""
        return self.structure.sum_over_ranks(motion[self._gap_rows] @ self._gap_block)

    def _measured(self, displacement: np.ndarray) -> np.ndarray:
        """Gap of a displacement (n_local,)."""
        return self._closing(displacement) - self.structure.clearance

    def _linear_energy(self, displacement: np.ndarray, velocity: np.ndarray) -> float:
        """(u^T K u + v^T M v) / 2 of arrays (n_local,): [J] (collective)."""
        parts = (self.structure.stiffness, displacement), (self.structure.mass, velocity)
        return self._total(0.5 * sum(x @ times(matrix, x[:, None])[:, 0] for matrix, x in parts))

    def _admissible(self, displacement: np.ndarray) -> np.ndarray:
        """With a constraint, the displacement closest in the norm of M without penetration."""
        gap = self._measured(displacement)
        if not self.rigid or not np.any(gap > 0.0):
            return displacement
        push = solve_once(self.structure.mass, self.structure.gap.toarray())
        return displacement - push @ solve_complementarity(self.structure.apply_bt(push.T).T, gap)


def solve_once(matrix: Any, columns: np.ndarray) -> np.ndarray:
    """X with A X = columns (n_local, m), A symmetric (collective)."""
    inverse = inverse_of(matrix, symmetric=True)
    found = by_columns(inverse.apply, matrix, columns)
    inverse.destroy()
    return found


def inverse_of(matrix: Any, *, symmetric: bool) -> Any:
    """Factorisation with little overhead per solve: PETSc's own on one rank, MUMPS on several."""
    solver = PETSc.PC().create(matrix.comm)
    solver.setOperators(matrix)
    if matrix.comm.size > 1:
        solver.setType("cholesky" if symmetric else "lu")
        solver.setFactorSolverType("mumps")
    else:  # its triangular solves are the quickest for LU ordered by nested dissection
        solver.setType("lu")
        solver.setFactorOrdering("nd")
    solver.setUp()
    return solver
