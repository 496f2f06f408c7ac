"""Dynamic stiffness Z = K - omega^2 M + i omega C of a structure, inverted.

With modal damping C is dense and never formed. One real symmetric sparse factorisation, of
D = K - omega^2 M, serves: with mass-normalised modes phi_j of natural frequency omega_j,

    Z^-1 = D^-1 + Phi diag(1/(d_j + 2 i xi_j omega_j omega) - 1/d_j) Phi^T

exactly, with d_j = omega_j^2 - omega^2. Close to a natural frequency the two terms with d_j cancel
and D is all but singular. There the mode is deflated: the bordered matrix

    [ D           M phi_j ]
    [ phi_j^T M   0       ]

is regular, inverts D on the M-orthogonal complement of phi_j, and the mode itself contributes
phi_j phi_j^T / (d_j + 2 i xi_j omega_j omega) with nothing cancelled.

With a given damping matrix, or that of Rayleigh damping, the real form of twice the size,
[[D, omega C], [-omega C, D]], is factored.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from petsc4py import PETSc

from fenics_crack.errors import ConvergenceError, InputError, check_number
from fenics_crack.model.factor import Factor, weighted_sum
from fenics_crack.model.modes import damped_modes
from fenics_crack.model.structure import Structure

__all__ = ["DynamicStiffness"]

DEFLATION_BAND = 1e-2
"""A mode is deflated where |1 - (omega/omega_j)^2| is below this."""


class DynamicStiffness:
    """Z(omega) of a structure, factored.

    Free it with :meth:`destroy`, or use it as a context manager (collective).

    Parameters
    ----------
    structure : Structure
        Its M, C and K are taken.
    omega : float
        Angular frequency [rad/s]; 0 for statics.

    Raises
    ------
    InputError
        omega is negative or not finite, or is the natural frequency of an undamped mode.
    ConvergenceError
        Z is singular: for omega = 0, the structure can move as a rigid body.
    """

    def __init__(self, structure: Structure, omega: float) -> None:
        check_number("omega", omega, 0.0)
        self.structure = structure
        self._matrix, self._damping, self._modes = structure.stiffness, None, None
        if omega > 0.0:
            self._matrix = weighted_sum(structure.stiffness, -(omega**2), structure.mass)
            self._damping, self._modes = structure.damping_matrix, damped_modes(structure)
        form, border = self._matrix, None
        if self._damping is not None:
            coupling, negative = self._damping.copy(), self._damping.copy()
            coupling.scale(omega)
            negative.scale(-omega)
            form = PETSc.Mat().createNest([[form, coupling], [negative, form]], comm=form.comm)
            form = form.convert("aij", PETSc.Mat())
        elif self._modes is not None:
            squares = self._modes.omega**2
            stiffness = squares - omega**2
            near = np.abs(stiffness) < DEFLATION_BAND * squares
            if np.any(self._modes.omega[near & (self._modes.rate == 0.0)] == omega):
                raise InputError("omega", omega, "away from the frequency of an undamped mode")
            factored = np.divide(1.0, stiffness, out=np.zeros_like(stiffness), where=~near)
            self._correction = 1.0 / (stiffness + 1j * omega * self._modes.rate) - factored
            if near.any():
                border = sparse.csr_matrix(self._modes.mass_shapes[:, near])
        self._factor = Factor(form, symmetric=self._damping is None, border=border)
        if self._factor.null_pivots:
            self.destroy()
            cause = "it can move as a rigid body" if omega == 0.0 else "an undamped resonance"
            raise ConvergenceError(
                f"dynamic stiffness at {omega:g} rad/s: the structure is singular ({cause})"
            )

    def solve(self, force: np.ndarray) -> np.ndarray:
        """Return Z^-1 f for real or complex forces (m, n_local) (collective)."""
        n_local = self.structure.n_local
        if self._damping is not None:
            stacked = np.concatenate([np.real(force), -np.imag(force)], axis=1)
            found = self._factor.solve(stacked)
            return found[:, :n_local] - 1j * found[:, n_local:]
        rows = np.concatenate([force.real, force.imag]) if np.iscomplexobj(force) else force
        found = self._factor.solve(rows)
        if np.iscomplexobj(force):
            found = found[: len(force)] + 1j * found[len(force) :]
        if self._modes is None:
            return found
        modal = self.structure.sum_over_ranks(force @ self._modes.shapes)
        return found + (modal * self._correction) @ self._modes.shapes.T

    def compliance(self) -> np.ndarray:
        """Return R = B^T Z^-1 B as seen by the contact pairs: (n_pairs, n_pairs) [m/N]."""
        return self.structure.apply_bt(self.solve(self.structure.gap.T.toarray())).T

    def destroy(self) -> None:
        """Free the matrices and factors (collective)."""
        self._factor.destroy()
        if self._matrix is not self.structure.stiffness:
            self._matrix.destroy()

    def __enter__(self) -> DynamicStiffness:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()
