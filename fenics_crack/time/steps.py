"""What step-by-step schemes share: their account of energy, and how a period is marched.

Small structures on one rank, under the penalty law or without penetration, are marched in their
modal coordinates by the kernel (``kernel/march.c``): where damping leaves the modes uncoupled a
step costs a few operations for each mode. Large ones, ranks that share one, and other laws go step
by step, with PETSc's matrices.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import Struct
from fenics_crack.model.contact import is_rigid, is_unilateral
from fenics_crack.model.coupled import solve_complementarity
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import by_columns, damped_modes, times
from fenics_crack.time.march import March, Scheme, Window

__all__ = ["LoopedSteps", "ModalSteps", "StepScheme", "inverse_of", "modal_steps", "solve_once"]

BLOCK = 2**17
"""Numbers of modal coordinates that are kept at a time."""


def modal_steps(asked: March) -> bool:
    """Whether a march is the kernel's (:class:`ModalSteps`)."""
    known = is_unilateral(asked.contact)
    return known and is_small(asked.structure)


class StepScheme(Scheme):
    """A scheme that marches step by step, and keeps account of the energy."""

    def __init__(self, asked: March) -> None:
        self.structure = structure = asked.structure
        self.contact, self.rigid = asked.contact, is_rigid(asked.contact)
        self.step_size = asked.step_size
        self.load_rows = asked.load_rows
        phase = 2.0 * np.pi * np.arange(asked.steps_per_period) / asked.steps_per_period
        self.waves = np.column_stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
        self.load = self.waves @ structure.force[:, self.load_rows]
        """(N, rows) [N]"""
        self._put_in = self._created = 0.0

    @abstractmethod
    def _march(self, window: Window) -> None:
        """March a period and record it."""

    @abstractmethod
    def _book(self, window: Window) -> None:
        """Add the energies put in and created in a period."""

    def fill(self, window: Window, number: int) -> None:
        """Raises ConvergenceError where contact has created too much energy."""
        self._march(window)
        self._book(window)
        self.balance(self._created, self._put_in)

    def _total(self, part: float) -> float:
        """Sum over the ranks."""
        return float(self.structure.sum_over_ranks(np.array([part]))[0])


class ModalSteps(StepScheme):
    """Of a small structure in modal coordinates, by the kernel.

    What acts on the modes is "by mode": an array (n,) where the damping leaves them uncoupled, and
    a matrix (n, n) where it couples them.
    """

    def __init__(self, asked: March) -> None:
        super().__init__(asked)
        structure, contact = self.structure, asked.contact
        self.modes = modes = all_modes(structure)
        count, pairs = modes.pairs.shape
        self.diagonal = modes.damping.ndim == 1
        self.clearance = np.broadcast_to(np.asarray(structure.clearance, float), pairs).copy()
        self.springs = None
        if not self.rigid:
            self.springs = np.broadcast_to(np.asarray(contact.stiffness, float), pairs).copy()
        self.pushed = structure.force @ modes.shapes
        """Modal load: (3, n)"""
        self.body = Struct(
            "vibration", modes=count, pairs=pairs, coupled=not self.diagonal,
            squares=np.ascontiguousarray(modes.squares), rows=np.ascontiguousarray(modes.pairs.T),
            clearance=self.clearance, springs=self.springs, load=np.ascontiguousarray(self.pushed),
            waves=np.vstack([self.waves, self.waves[:1]]), room=np.empty(6 * count + 8 * pairs),
        )  # fmt: skip
        self._recorded = modes.shapes[asked.recorded_dofs]
        self._loaded = modes.shapes[asked.load_rows]
        self.shape, self.velocity = (modes.inverse @ part for part in asked.start)
        if self.rigid:  # moved apart by the least change in the norm of M
            gap = self.measured()
            if np.any(gap > 0.0):
                self.shape -= modes.pairs @ solve_complementarity(modes.pairs.T @ modes.pairs, gap)

    @abstractmethod
    def _steps(self, first: int, gap: np.ndarray, force: np.ndarray, shape: np.ndarray) -> int:
        """March from instant ``first`` of the period, a step for each row; the steps made."""

    def _march(self, window: Window) -> None:
        steps, count = len(window.gap), len(self.modes.squares)
        some = max(1, BLOCK // count)
        shape = np.empty((min(some, steps), count))
        for first in range(0, steps, some):
            place = slice(first, min(first + some, steps))
            here = shape[: place.stop - first]
            made = self._steps(first, window.gap[place], window.force[place], here)
            if made < len(here):
                raise ConvergenceError(f"contact: no forces of step {first + made} were found")
            window.motion[place] = here @ self._recorded.T
            window.load_motion[place] = here @ self._loaded.T

    def measured(self) -> np.ndarray:
        """Gap at the end of the march."""
        found: np.ndarray = self.shape @ self.modes.pairs - self.clearance
        return found

    def acceleration(self, velocity: np.ndarray) -> np.ndarray:
        """f - w^2 q - P lambda - c v at phase zero of the load; forces of a constraint, which
        belong to the next step, are left out."""
        modes = self.modes
        found: np.ndarray = self.pushed[0] + self.pushed[1] - modes.squares * self.shape
        if not self.rigid:
            found -= modes.pairs @ self.contact.force(self.measured())
        return found - modes.damped(velocity)

    def by_mode(self, matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """A product by mode: (n, m)."""
        return matrix[:, None] * columns if self.diagonal else matrix @ columns

    def linear_energy(self) -> float:
        """(q^T w^2 q + v^T v) / 2 [J]."""
        squares = self.modes.squares
        return 0.5 * float(squares @ self.shape**2 + self.velocity @ self.velocity)

    def load_motion(self) -> np.ndarray:
        """Displacement where the load acts at the end of the march."""
        found: np.ndarray = self._loaded @ self.shape
        return found

    def motion(self, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement at the end of the march, and a velocity, (n_dofs,) each."""
        return self.modes.shapes @ self.shape, self.modes.shapes @ velocity


class LoopedSteps(StepScheme):
    """One after the other, with PETSc's matrices (collective)."""

    before: np.ndarray
    """Displacement (n_local,) at the instant from which :meth:`advance` has started."""
    gap: np.ndarray
    """(n_pairs,) [m], at the same instant."""
    force: np.ndarray
    """(n_pairs,) [N], at the same instant; with a constraint the mean until the next."""

    def __init__(self, asked: March) -> None:
        super().__init__(asked)
        structure = self.structure
        self.force = np.zeros(structure.n_pairs)
        # Only few rows of B are not zero.
        self._gap_rows = np.flatnonzero(np.diff(structure.gap.indptr))
        self._gap_block = structure.gap[self._gap_rows].toarray()
        self._columns = asked.recorded_dofs - structure.first_dof
        self._modes, self._damping = damped_modes(structure), structure.damping_matrix

    @abstractmethod
    def advance(self, step: int) -> None:
        """March from an instant, ``step`` of the period, to the next."""

    def _march(self, window: Window) -> None:
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
