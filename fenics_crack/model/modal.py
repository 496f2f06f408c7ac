"""All modes of a small structure, computed once.

With the mass-normalised shapes Phi, u = Phi q and forces lambda on the pairs,

    q'' + Phi^T C Phi q' + Lambda q + Phi^T B lambda = Phi^T f,        Lambda = diag(omega_j^2)

In steady motion of angular frequency w the response to Phi^T f is H Phi^T f, with the receptance

    H = (Lambda - w^2 + i w Phi^T C Phi)^-1

The truncated part of a massless structure adds its residual flexibility R_inf.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import kernel
from fenics_crack.model.factor import local_rows
from fenics_crack.model.modes import (
    STIFFNESS_SOLUTION_ROUNDING,
    ZERO_TOLERANCE,
    modes_with_modal_damping,
    project_damping_on_modes,
    solve_modes,
)
from fenics_crack.model.reduced import QuasiStaticReduction
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import MACHINE_EPSILON

MAX_DENSE_SIZE = 600
"""Maximum dofs of a structure that is decomposed into all of its modes.

Also the maximum number of unknowns of equations with more harmonics, for an error estimate. Dense
matrices of this size take a part of a second.
"""
N_MODAL_COORDINATES_IN_CPU_CACHE = 2**16
"""Number of modal coordinates that are computed together: they fit in a cache."""


def is_small(structure: Structure) -> bool:
    """Return True if a structure can be decomposed into all of its modes.

    Small structures have at most 600 dofs on one rank, or are reduced to modes and massless crack
    faces.
    """
    has_few_dofs = structure.comm.size == 1 and structure.n_dofs <= MAX_DENSE_SIZE
    return has_few_dofs or structure.has_massless_crack_faces


@dataclass(frozen=True)
class AllModes:
    """All modes of a small structure, with contact pairs and damping in modal coordinates.

    Attributes
    ----------
    squares : (n,) [rad^2/s^2]
        Squares omega_j^2 of the natural frequencies, ascending.
    shapes : (n_dofs, n)
        Mode shapes Phi, mass-normalised.
    damping : (n,) or (n, n) [1/s]
        Phi^T C Phi with the damping matrix C; only the diagonal (n,) if all other entries are zero.
    gaps_by_mode : (n, n_pairs)
        Phi^T B, with the gap matrix B: change of each pair's gap by a unit amplitude of each mode.
    is_unconstrained : bool
        True if the structure can move as a rigid body.
    residual_compliance : (n_pairs, n_pairs) [m/N] or None
        R_inf, the compliance of the massless coordinates. None if every coordinate has mass.
    """

    squares: np.ndarray
    shapes: np.ndarray
    damping: np.ndarray
    gaps_by_mode: np.ndarray
    is_unconstrained: bool
    residual_compliance: np.ndarray | None = None
    massless_displacement_by_pair_forces: np.ndarray | None = None
    """(n_dofs, n_pairs): displacement of the massless coordinates by unit forces on pairs."""
    massless_displacement_by_dof_forces: np.ndarray | None = None
    """(n_dofs, n_dofs): displacement of the massless coordinates by forces on dofs."""
    inverse_shapes: np.ndarray | None = None
    """Phi^T M, the inverse of Phi, if it is at hand: (n, n_dofs)."""

    @property
    def is_ill_conditioned(self) -> bool:
        """True if the lowest mode may be inaccurate, because the highest modes are very stiff.

        The condition is omega^2 of the lowest mode below 1e-12 times omega^2 of the highest mode. A
        structure with a free rigid-body motion always gives False.
        """
        return not self.is_unconstrained and bool(
            self.squares[0] < STIFFNESS_SOLUTION_ROUNDING * self.squares[-1]
        )

    def modal_receptances(
        self, omega: np.ndarray, damping_factor: float = 1.0, is_loaded: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the receptance H, the modal response to unit modal forces.

        With the diagonal matrix Lambda of the squared natural frequencies omega_j^2, the damping C,
        the mode shapes Phi, and the damping factor d,

            H = (Lambda - omega^2 + i omega d Phi^T C Phi)^-1

        Parameters
        ----------
        omega : (m,) [rad/s]
            Frequencies.
        damping_factor : float
            Factor of the damping.
        is_loaded : (m, n) bool, optional
            True for modes that the load drives. Default: all modes. At the resonance of an undamped
            mode, the denominator omega_j^2 - omega^2 is zero. For a mode with False, the
            denominator is then replaced by 1.5e-8 (omega_j^2 + omega^2), since contact keeps the
            motion finite.

        Returns
        -------
        (m, n) or (m, n, n)
            Diagonal of H at each frequency. If damping couples modes, the whole matrix H.

        Raises
        ------
        ConvergenceError
            H is infinite at a frequency: an undamped resonance, or a rigid-body motion at frequency
            0.
        """
        omega_squared = (omega * omega)[:, None]
        dynamic_stiffness = self.squares - omega_squared
        is_singular_at_omega = self.is_unconstrained & (omega == 0.0)
        if self.damping.ndim == 1:
            impedance = dynamic_stiffness + (1j * damping_factor * omega)[:, None] * self.damping
            impedance_scale = np.abs(self.squares) + omega_squared
            if is_loaded is not None:
                min_impedance = math.sqrt(MACHINE_EPSILON) * impedance_scale
                is_near_resonance = (
                    (np.abs(impedance) <= min_impedance) & ~is_loaded & (omega_squared > 0.0)
                )
                impedance = np.where(is_near_resonance, min_impedance, impedance)
            is_singular_at_omega |= (
                np.abs(impedance) <= kernel.SINGULARITY_TOLERANCE * impedance_scale
            ).any(axis=1)
        else:
            impedance = 1j * damping_factor * omega[:, None, None] * self.damping
            diagonal_indices = np.arange(len(self.squares))
            impedance[:, diagonal_indices, diagonal_indices] += dynamic_stiffness
            # Only an undamped mode can make the impedance singular.
            is_undamped_mode = np.abs(self.damping).sum(axis=1) == 0.0
            is_singular_at_omega |= np.any(dynamic_stiffness[:, is_undamped_mode] == 0.0, axis=1)
            if not is_singular_at_omega.any():
                try:
                    return np.linalg.inv(impedance)
                except np.linalg.LinAlgError:  # to rounding
                    is_singular_at_omega[np.argmax(np.linalg.cond(impedance))] = True
        if is_singular_at_omega.any():
            singular_omega = omega[np.argmax(is_singular_at_omega)]
            cause_text = (
                "it can move as a rigid body: clamp it"
                if singular_omega == 0.0
                else "undamped resonance: add damping"
            )
            raise ConvergenceError(
                f"dynamic compliance at {singular_omega:g} rad/s: the structure is singular "
                f"({cause_text})"
            )
        return 1.0 / impedance

    def static_pair_compliance(self, min_frequency: float = np.inf) -> np.ndarray:
        """Return the quasi-static compliance of the contact pairs.

        The compliance consists of the residual flexibility R_inf and of modes above a frequency.

        Parameters
        ----------
        min_frequency : float [rad/s]
            Frequency above which modes respond without inertia. Default: infinite, no mode.

        Returns
        -------
        (n_pairs, n_pairs) [m/N]
            Gap change by unit forces on the pairs.
        """
        is_fast_mode = self._is_fast_mode(min_frequency)
        fast_pair_compliance = (
            self.gaps_by_mode[is_fast_mode].T / self.squares[is_fast_mode]
        ) @ self.gaps_by_mode[is_fast_mode]
        return (
            fast_pair_compliance
            if self.residual_compliance is None
            else fast_pair_compliance + self.residual_compliance
        )

    def _is_fast_mode(self, min_frequency: float) -> np.ndarray:
        """Return True for modes above a frequency [rad/s]: (n,) bool.

        The lowest mode gets False at any frequency.
        """
        return np.asarray(self.squares > max(min_frequency**2, float(self.squares[0])))

    def static_displacement_by_pair_forces(self, min_frequency: float) -> np.ndarray:
        """Return the displacement of fast modes and massless coordinates by unit pair forces.

        Modes above a frequency are called fast, and respond without inertia.

        Parameters
        ----------
        min_frequency : float [rad/s]
            Frequency above which modes are fast. The lowest mode is never fast.

        Returns
        -------
        (n_dofs, n_pairs) [m/N]
            Displacement by a unit force on each pair.
        """
        is_fast_mode = self._is_fast_mode(min_frequency)
        displacement_by_pair_forces: np.ndarray = (
            self.shapes[:, is_fast_mode] / self.squares[is_fast_mode]
        ) @ self.gaps_by_mode[is_fast_mode]
        return (
            displacement_by_pair_forces
            if self.massless_displacement_by_pair_forces is None
            else displacement_by_pair_forces + self.massless_displacement_by_pair_forces
        )

    def with_fast_modes_quasi_static(self, min_frequency: float | None) -> AllModes:
        """Return a copy in which modes above a frequency [rad/s] respond without inertia.

        These modes have no damping, either. They are added to the residual compliance. The lowest
        mode always keeps inertia. The object itself is returned if ``min_frequency`` is None, or if
        no mode is above the frequency.
        """
        if min_frequency is None:
            return self
        is_slow_mode = ~self._is_fast_mode(min_frequency)
        if np.all(is_slow_mode):
            return self
        fast_squares, fast_static_shapes = (
            self.squares[~is_slow_mode],
            self.shapes[:, ~is_slow_mode],
        )
        massless_displacement_by_dof_forces = (
            fast_static_shapes / fast_squares
        ) @ fast_static_shapes.T
        if self.massless_displacement_by_dof_forces is not None:
            massless_displacement_by_dof_forces = (
                massless_displacement_by_dof_forces + self.massless_displacement_by_dof_forces
            )
        slow_damping_rates = (
            self.damping[is_slow_mode]
            if self.damping.ndim == 1
            else self.damping[np.ix_(is_slow_mode, is_slow_mode)]
        )
        return AllModes(
            self.squares[is_slow_mode],
            self.shapes[:, is_slow_mode],
            slow_damping_rates,
            self.gaps_by_mode[is_slow_mode],
            self.is_unconstrained,
            self.static_pair_compliance(min_frequency),
            self.static_displacement_by_pair_forces(min_frequency),
            massless_displacement_by_dof_forces,
            self.shapes_inverse[is_slow_mode],
        )

    @cached_property
    def shapes_inverse(self) -> np.ndarray:
        """Inverse of the mode shapes, from displacements to modal coordinates: (n, n_dofs).

        With massless coordinates, this is Phi^T M, with the mode shapes Phi and the mass M.
        """
        if self.inverse_shapes is not None:
            return self.inverse_shapes
        return np.linalg.inv(self.shapes)

    def damping_force(self, modal_velocities: np.ndarray) -> np.ndarray:
        """Return the modal damping forces Phi^T C Phi q' from modal velocities q' (..., n).

        Phi are the mode shapes and C is the damping matrix. The result has the shape of q'.
        """
        return (
            modal_velocities * self.damping
            if self.damping.ndim == 1
            else modal_velocities @ self.damping.T
        )

    def modal_response(self, receptance: np.ndarray, modal_force: np.ndarray) -> np.ndarray:
        """Return the modal displacements H f by modal forces f.

        Parameters
        ----------
        receptance : (..., n) or (..., n, n)
            H, as :meth:`modal_receptances` returns it.
        modal_force : (..., n)
            f.

        Returns
        -------
        (..., n)
            H f.
        """
        if self.damping.ndim == 1:
            return receptance * modal_force
        return np.matmul(receptance, modal_force[..., None])[..., 0]

    def compliance_of_pairs(self, receptance: np.ndarray) -> np.ndarray:
        """Return the compliance B^T Phi H Phi^T B of the pairs: (..., n_pairs, n_pairs) [m/N].

        ``receptance`` is H as :meth:`modal_receptances` returns it; Phi are the mode shapes and B
        is the gap matrix. An entry is the gap change of one pair by a unit force on another.
        """
        if self.damping.ndim == 1:
            return np.matmul(self.gaps_by_mode.T * receptance[..., None, :], self.gaps_by_mode)
        return self.gaps_by_mode.T @ receptance @ self.gaps_by_mode

    def transition_and_force_response(self, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrices for a time step of all modes under constant pair forces.

        The state z = (q, q') has modal displacements and velocities. The equation of free motion,
        z' = A z, defines the matrix A.

        Parameters
        ----------
        h : float [s]
            Length of the step.

        Returns
        -------
        (2n, 2n) or (4, n)
            E = exp(A h): state after the step by the state before. If damping does not couple
            modes, only the diagonals of the blocks: q by q, q by q', q' by q, q' by q'.
        (2n, n_pairs)
            State after the step by a unit force on each pair, from rest.
        """
        n_modes, n_pairs = self.gaps_by_mode.shape
        if self.damping.ndim == 1:
            # Mode by mode: exp of h [A, b; 0, 0], scaled to balance q and q'.
            velocity_scale = np.maximum(np.sqrt(np.abs(self.squares)), 1.0 / h)
            state_matrix = np.zeros((n_modes, 3, 3))
            state_matrix[:, 0, 1] = velocity_scale
            state_matrix[:, 1, 0], state_matrix[:, 1, 1] = (
                -self.squares / velocity_scale,
                -self.damping,
            )
            state_matrix[:, 1, 2] = 1.0
            matrix_exponential = scipy.linalg.expm(h * state_matrix)
            transition_blocks = (
                matrix_exponential[:, 0, 0],
                matrix_exponential[:, 0, 1] / velocity_scale,
                matrix_exponential[:, 1, 0] * velocity_scale,
                matrix_exponential[:, 1, 1],
            )
            displacement_by_forces = (matrix_exponential[:, 0, 2] / velocity_scale)[
                :, None
            ] * self.gaps_by_mode
            velocity_by_forces = matrix_exponential[:, 1, 2][:, None] * self.gaps_by_mode
            return np.array(transition_blocks), np.vstack(
                [displacement_by_forces, velocity_by_forces]
            )
        state_matrix = np.zeros((2 * n_modes + n_pairs,) * 2)
        state_matrix[:n_modes, n_modes : 2 * n_modes] = np.eye(n_modes)
        state_matrix[n_modes : 2 * n_modes, :n_modes] = -np.diag(self.squares)
        state_matrix[n_modes : 2 * n_modes, n_modes : 2 * n_modes] = -self.damping
        state_matrix[n_modes : 2 * n_modes, 2 * n_modes :] = self.gaps_by_mode
        matrix_exponential = scipy.linalg.expm(h * state_matrix)[: 2 * n_modes]
        return np.ascontiguousarray(matrix_exponential[:, : 2 * n_modes]), matrix_exponential[
            :, 2 * n_modes :
        ]

    def steady_modal_amplitudes(self, omega: float, force: np.ndarray) -> np.ndarray:
        """Return the complex amplitudes of the modes under a harmonic load: (n,).

        ``omega`` [rad/s] is the frequency, and ``force`` (n,) has the complex modal forces. Modes
        without load are at rest.

        Raises
        ------
        ConvergenceError
            The load is on an undamped resonance, or moves the structure as a rigid body.
        """
        if self.damping.ndim == 2:
            impedance = np.diag(self.squares - omega**2) + 1j * omega * self.damping
            amplitudes = np.linalg.lstsq(impedance, force, rcond=None)[0]
            is_singular = np.abs(impedance @ amplitudes - force).max() > 1e-9 * np.abs(force).max()
        else:
            impedance = self.squares - omega**2 + 1j * omega * self.damping
            squared_omega_magnitudes = np.abs(self.squares)
            is_resonant_mode = np.abs(impedance) <= 1e-15 * (squared_omega_magnitudes + omega**2)
            if omega == 0.0 and self.is_unconstrained:
                is_resonant_mode |= squared_omega_magnitudes <= 1e-12 * squared_omega_magnitudes[-1]
            is_singular = bool(np.any(force[is_resonant_mode]))
            amplitudes = np.divide(
                force, impedance, out=np.zeros_like(force), where=~is_resonant_mode
            )
        if is_singular:
            raise ConvergenceError(
                f"exponential: at {omega:g} rad/s the load is on an undamped resonance, or moves "
                "the structure as a rigid body; add damping, or clamp the structure"
            )
        return amplitudes


def all_modes(structure: Structure) -> AllModes:
    """Return all modes of a small structure (:func:`is_small`), with its damping.

    The modes are computed once for a structure and all varied copies.
    """
    modes, damping_factor = structure.compute_once(_compute_all_modes), structure.damping_multiplier
    return (
        modes if damping_factor == 1.0 else replace(modes, damping=damping_factor * modes.damping)
    )


def _compute_all_modes(structure: Structure) -> AllModes:
    """Compute all modes of a small structure."""
    if isinstance(structure, QuasiStaticReduction):
        return _quasi_static_reduction_modes(structure)
    modally_damped_modes = modes_with_modal_damping(structure)
    if modally_damped_modes is not None and len(modally_damped_modes.omega) == structure.n_dofs:
        squares, mode_shapes = modally_damped_modes.omega**2, modally_damped_modes.shapes
        damping = modally_damped_modes.damping_rates
    else:
        stiffness_and_mass = (
            local_rows(petsc_matrix).toarray()
            for petsc_matrix in (structure.stiffness, structure.mass)
        )
        squares, mode_shapes = scipy.linalg.eigh(*stiffness_and_mass)
        damping = project_damping_on_modes(structure, mode_shapes, squares)
    # A small square may be LAPACK's rounding of the largest; one mode of K itself decides.
    is_lowest_doubtful = squares[0] <= ZERO_TOLERANCE * squares[-1]
    is_unconstrained = bool(is_lowest_doubtful and solve_modes(structure, 1).omega[0] == 0.0)
    return AllModes(
        squares, mode_shapes, damping, (structure.gap.T @ mode_shapes).T, is_unconstrained
    )


def _quasi_static_reduction_modes(structure: QuasiStaticReduction) -> AllModes:
    """Return all modes of a structure that is reduced to modes and massless coordinates.

    The massless coordinates respond statically: their flexibility is in the result, too.
    """
    gap, modal_shapes, squares = structure.gap.toarray(), structure.shapes, structure.omega**2
    truncated_flexibility_root = structure.truncated_flexibility_root
    pair_compliance_root = (
        gap.T @ truncated_flexibility_root
    )  # exact even if L L^T is mostly rounding
    return AllModes(
        squares,
        modal_shapes,
        structure.modal_damping,
        modal_shapes.T @ gap,
        bool(np.any(squares == 0.0)),
        pair_compliance_root @ pair_compliance_root.T,
        truncated_flexibility_root @ pair_compliance_root.T,
        structure.residual_flexibility,
        (structure.mass.getDiagonal().array_r[:, None] * modal_shapes).T,
    )
