"""What schemes share that go step by step, with PETSc's matrices."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_crack.model.coupled import solve_complementarity
from fenics_crack.model.damping import RayleighDamping
from fenics_crack.model.factor import Factor
from fenics_crack.model.modes import damped_modes, times
from fenics_crack.time.march import March, Scheme, Window

__all__ = ["LoopedSteps"]


class LoopedSteps(Scheme):
    """State of a structure, and what acts on it (collective)."""

    displacement: np.ndarray
    """(n_local,)"""
    before: np.ndarray
    """Displacement (n_local,) at the instant from which :meth:`advance` has started."""
    gap: np.ndarray
    """(n_pairs,) [m], at the same instant."""
    force: np.ndarray
    """(n_pairs,) [N], at the same instant; with a constraint the mean until the next."""

    def __init__(self, asked: March) -> None:
        self.structure = structure = asked.structure
        self.contact, self.rigid, self.step_size = asked.contact, asked.rigid, asked.step_size
        self.load, self.load_rows = asked.load, asked.load_rows
        self.force = np.zeros(structure.n_pairs)
        # Only few rows of B are not zero.
        self._gap_rows = np.flatnonzero(np.diff(structure.gap.indptr))
        self._gap_block = structure.gap[self._gap_rows].toarray()
        self._columns = asked.recorded_dofs - structure.first_dof
        self._modes, self._damping = damped_modes(structure), structure.damping_matrix
        self._x, self._y = structure.mass.createVecs()

    @abstractmethod
    def advance(self, step: int) -> None:
        """March from an instant, ``step`` of the period, to the next."""

    def record(self, window: Window) -> None:
        """March a period."""
        for step in range(len(window.gap)):
            self.advance(step)
            window.gap[step], window.force[step] = self.gap, self.force
            window.load_motion[step] = self.before[self.load_rows]
            window.motion[step] = self.before[self._columns]

    def _closing(self, motion: np.ndarray) -> np.ndarray:
        """B^T of a motion (n_local,)."""
        return self.structure.sum_over_ranks(motion[self._gap_rows] @ self._gap_block)

    def _measured(self, displacement: np.ndarray) -> np.ndarray:
        """Gap of a displacement (n_local,)."""
        return self._closing(displacement) - self.structure.clearance

    def _applied(self, operator: Callable[[Any, Any], None], rows: np.ndarray) -> np.ndarray:
        """Apply an operator of PETSc's to a vector (n_local,)."""
        self._x.array_w[:] = rows
        operator(self._x, self._y)
        return self._y.array_r.copy()

    def _times(self, matrix: PETSc.Mat, rows: np.ndarray) -> np.ndarray:
        """A matrix times (n_local,)."""
        return self._applied(matrix.mult, rows)

    def _factored(self, matrix: PETSc.Mat) -> Factor:
        """Factor M with parts of K and C, of which a C that was given need not be symmetric."""
        rayleigh = isinstance(self.structure.damping, RayleighDamping)
        return Factor(matrix, symmetric=self._damping is None or rayleigh, definite=True)

    def _damped(self, velocity: np.ndarray) -> np.ndarray:
        """C v."""
        if self._damping is not None:
            return self._times(self._damping, velocity)
        if self._modes is None:
            return np.zeros_like(velocity)
        modal = self.structure.sum_over_ranks(velocity @ self._modes.mass_shapes)
        return self._modes.mass_shapes @ (self._modes.rate * modal)

    def _acceleration(self, velocity: np.ndarray) -> np.ndarray:
        """M^-1 (f - K u - B lambda - C v) at phase zero of the load; forces of a constraint, which
        belong to the next step, are left out."""
        right = -self._times(self.structure.stiffness, self.displacement) - self._damped(velocity)
        right[self.load_rows] += self.load[0]
        if not self.rigid:
            force = self.contact.force(self._measured(self.displacement))
            right[self._gap_rows] -= self._gap_block @ force
        with Factor(self.structure.mass, definite=True) as factor:
            found: np.ndarray = factor.solve(right[None])[0]
        return found

    def _linear_energy(self, velocity: np.ndarray) -> float:
        """(u^T K u + v^T M v) / 2: [J]."""
        structure = self.structure
        parts = (structure.stiffness, self.displacement), (structure.mass, velocity)
        energy = 0.5 * sum(rows @ times(matrix, rows[:, None])[:, 0] for matrix, rows in parts)
        return float(structure.sum_over_ranks(np.array([energy]))[0])

    def _admissible(self, displacement: np.ndarray) -> np.ndarray:
        """Displacement closest in the norm of M without penetration, with a constraint."""
        gap = self._measured(displacement)
        if not self.rigid or not np.any(gap > 0.0):
            return displacement
        with Factor(self.structure.mass, definite=True) as factor:
            push = factor.solve(self.structure.gap.T.toarray())
        return displacement - solve_complementarity(self.structure.apply_bt(push), gap) @ push
