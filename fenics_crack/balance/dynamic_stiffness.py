"""Dynamic stiffness Z = K - omega^2 M + i omega C of a structure, applied and inverted.

With modal damping C is dense and never formed. One real symmetric sparse factorisation, of
D = K - omega^2 M, serves: with mass-normalised modes phi_j of natural frequency omega_j,

    Z^-1 = D^-1 + Phi diag(1/(d_j + 2 i xi_j omega_j omega) - 1/d_j) Phi^T

exactly, with d_j = omega_j^2 - omega^2. Close to a natural frequency the two terms with d_j cancel
and D is all but singular. There the mode is deflated: the bordered matrix

    [ D           M phi_j ]
    [ phi_j^T M   0       ]

is regular, inverts D on the M-orthogonal complement of phi_j, and the mode itself contributes
phi_j phi_j^T / (d_j + 2 i xi_j omega_j omega) with nothing cancelled.

With a given damping matrix the real form of twice the size, [[D, omega C], [-omega C, D]], is
factored.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.factor import Factor, weighted_sum
from fenics_crack.model.modes import damped_modes
from fenics_crack.model.structure import Structure

__all__ = ["DynamicStiffness"]

DEFLATION_BAND = 1e-2
"""A mode is deflated where |1 - (omega/omega_j)^2| is below this."""


class DynamicStiffness:
    """Z(omega) of a structure; works on complex amplitudes (m, n_local), one case a row.

    Parameters
    ----------
    structure : Structure
        Where M, C and K come from.
    omega : float
        Angular frequency [rad/s]; 0 for statics.

    Raises
    ------
    InputError
        omega is negative or not finite, or meets the natural frequency of an undamped mode.
    ConvergenceError
        Z is singular: for omega = 0, the structure can move as a rigid body.

    Notes
    -----
    Free with :meth:`destroy` or use as a context manager (collective). The factorisation is made
    when it is first needed.
    """

    def __init__(self, structure: Structure, omega: float) -> None:
        if not (np.isfinite(omega) and omega >= 0.0):
            raise InputError("omega", omega, "a finite number >= 0")
        self.structure = structure
        self.omega = omega
        self._modes = damped_modes(structure) if omega > 0.0 else None
        self._matrix = structure.stiffness
        if omega > 0.0:
            self._matrix = weighted_sum(structure.stiffness, -(omega**2), structure.mass)
        self._full_damping: Any = structure.damping_matrix if omega > 0.0 else None
        self._near: np.ndarray = np.zeros(0, dtype=int)
        if self._modes is not None:
            squares = self._modes.omega**2
            self._near = np.flatnonzero(np.abs(squares - omega**2) < DEFLATION_BAND * squares)
            undamped = self._near[self._modes.rate[self._near] == 0.0]
            if np.any(self._modes.omega[undamped] == omega):
                raise InputError("omega", omega, "away from the frequency of an undamped mode")
        self._factor: Factor | None = None
        self._work = self._matrix.createVecs()

    # --- application ------------------------------------------------------------------------------

    def apply(self, amplitude: np.ndarray) -> np.ndarray:
        """Return Z u for amplitudes (m, n_local) (collective)."""
        product = self._multiply(self._matrix, amplitude)
        if self._full_damping is not None:
            product = product + 1j * self.omega * self._multiply(self._full_damping, amplitude)
        elif self._modes is not None:
            mass_shapes = self._modes.mass_shapes
            modal = self.structure.sum_over_ranks(amplitude @ mass_shapes)
            product = product + 1j * self.omega * (modal * self._modes.rate) @ mass_shapes.T
        return product

    def _multiply(self, matrix: Any, rows: np.ndarray) -> np.ndarray:
        source, target = self._work
        product = np.empty_like(rows)
        parts = [(rows.real, product.real)]
        if np.iscomplexobj(rows):
            parts.append((rows.imag, product.imag))
        for given, found in parts:
            for vector, result in zip(given, found, strict=True):
                source.array_w[:] = vector
                matrix.mult(source, target)
                result[:] = target.array_r
        return product

    # --- inversion --------------------------------------------------------------------------------

    def solve(self, force: np.ndarray) -> np.ndarray:
        """Return Z^-1 f for forces (m, n_local) (collective)."""
        if self._factor is None:
            self._factor = self._factorise()
        count = len(force)
        if self._full_damping is not None:
            stacked = np.concatenate([np.real(force), -np.imag(force)], axis=1)
            found = self._factor.solve(stacked)
            n_local = self.structure.n_local
            return found[:, :n_local] - 1j * found[:, n_local:]
        rows = np.concatenate([force.real, force.imag]) if np.iscomplexobj(force) else force
        border = self._border_rows
        if border:
            rows = np.concatenate([rows, np.zeros((len(rows), border))], axis=1)
        found = self._factor.solve(rows)[:, : self.structure.n_local]
        solution = found[:count] + 1j * found[count:] if np.iscomplexobj(force) else found
        if self._modes is None:
            return solution
        shapes = self._modes.shapes
        modal = self.structure.sum_over_ranks(force @ shapes)
        return solution + (modal * self._modal_correction()) @ shapes.T

    def compliance(self) -> np.ndarray:
        """Return R = B^T Z^-1 B as seen by the contact pairs: (n_pairs, n_pairs) [m/N]."""
        return self.structure.closing(self.solve(self.structure.gap.T.toarray())).T

    def _modal_correction(self) -> np.ndarray:
        assert self._modes is not None
        stiffness = self._modes.omega**2 - self.omega**2
        damped = 1.0 / (stiffness + 1j * self.omega * self._modes.rate)
        factored = np.ones_like(stiffness, dtype=bool)
        factored[self._near] = False
        undamped = np.divide(1.0, stiffness, out=np.zeros_like(stiffness), where=factored)
        return damped - undamped

    @property
    def _border_rows(self) -> int:
        """Rows of the border that this rank holds: all on the last rank."""
        comm = self.structure.comm
        return len(self._near) if comm.rank == comm.size - 1 else 0

    def _factorise(self) -> Factor:
        if self._full_damping is not None:
            factor = Factor(self._real_form(), symmetric=False)
        elif len(self._near):
            factor = Factor(self._bordered(), symmetric=True)
        else:
            factor = Factor(self._matrix, symmetric=True)
        if factor.null_pivots:
            factor.destroy()
            cause = "it can move as a rigid body" if self.omega == 0.0 else "an undamped resonance"
            raise ConvergenceError(
                f"dynamic stiffness at {self.omega:g} rad/s: the structure is singular ({cause})"
            )
        return factor

    def _real_form(self) -> Any:
        coupling = self._full_damping.copy()
        coupling.scale(self.omega)
        negative = coupling.copy()
        negative.scale(-1.0)
        nested = PETSc.Mat().createNest(
            [[self._matrix, coupling], [negative, self._matrix]], comm=self._matrix.comm
        )
        return nested.convert("aij", PETSc.Mat())

    def _bordered(self) -> Any:
        assert self._modes is not None
        structure, border = self.structure, self._border_rows
        columns = self._modes.mass_shapes[:, self._near]
        count = len(self._near)
        sizes = ((structure.n_local, structure.n_dofs), (border, count))
        right = PETSc.Mat().createAIJ(
            sizes,
            csr=(
                np.arange(structure.n_local + 1, dtype=PETSc.IntType) * count,
                np.tile(np.arange(count, dtype=PETSc.IntType), structure.n_local),
                columns.ravel(),
            ),
            comm=self._matrix.comm,
        )
        below = right.transpose(PETSc.Mat())
        zero = PETSc.Mat().createAIJ(
            ((border, count), (border, count)),
            csr=(
                np.arange(border + 1, dtype=PETSc.IntType),
                np.arange(border, dtype=PETSc.IntType),
                np.zeros(border),
            ),
            comm=self._matrix.comm,
        )
        nested = PETSc.Mat().createNest(
            [[self._matrix, right], [below, zero]], comm=self._matrix.comm
        )
        return nested.convert("aij", PETSc.Mat())

    def destroy(self) -> None:
        """Free the matrices and factors (collective)."""
        if self._factor is not None:
            self._factor.destroy()
            self._factor = None
        for vector in self._work:
            vector.destroy()
        if self._matrix is not self.structure.stiffness:
            self._matrix.destroy()

    def __enter__(self) -> DynamicStiffness:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()
