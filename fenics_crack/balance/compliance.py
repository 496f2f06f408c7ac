"""Dynamic compliance: the response of a structure's gaps to forces on its contact pairs.

A force lambda_k exp(i k w t) on the pairs moves their gaps by -R_k lambda_k. The load alone opens
them by the linear gap:

    R_k = B^T Z_k^-1 B,        g_lin = B^T Z^-1 f - g0,        Z_k = K - (k w)^2 M + i k w C,

with the gaps B^T u - g0 of displacements u and the load f. The gap's harmonics solve
g + R lambda(g) = g_lin exactly, for any structure. Small and reduced structures have closed forms
from all of their modes. Large structures need a sparse factorisation for each harmonic.

With modal damping C is dense and never formed. D = K - omega^2 M, real, symmetric and sparse, is
factored. With mass-normalised modes phi_j of natural frequency omega_j and d_j = omega_j^2 -
omega^2,

    Z^-1 = D^-1 + Phi diag(1/(d_j + 2 i xi_j omega_j omega) - 1/d_j) Phi^T

exactly, with the damping ratios xi_j. Close to a natural frequency the two terms with d_j cancel,
and D is all but singular. The mode is then deflated: the bordered matrix

    [ D           M phi_j ]
    [ phi_j^T M   0       ]

is regular and inverts D on the M-orthogonal complement of phi_j. The mode itself contributes phi_j
phi_j^T / (d_j + 2 i xi_j omega_j omega), without cancellation.

With a damping matrix, given or by Rayleigh, the real form of twice the size, [[D, omega C], [-omega
C, D]], is factored.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from petsc4py import PETSc

from fenics_crack.basics.errors import ConvergenceError, InputError, check_number
from fenics_crack.basics.ranks import collect_garbage
from fenics_crack.kernel import require_shape
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.factor import Factor, matrix_plus_weighted_matrix
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import (
    modes_with_modal_damping,
    project_damping_on_columns,
    solve_modes,
)
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import COARSE_TOLERANCE, MACHINE_EPSILON, residual_rounding
from fenics_crack.numerics.fourier import from_complex, resize_harmonics, stretch_period, to_complex

DEFLATION_BAND = 1e-2
"""Relative distance |1 - (omega/omega_j)^2| below which a mode is solved apart from the others.

omega is the frequency, omega_j the mode's natural frequency. The factored matrix would otherwise be
nearly singular.
"""


class FactorisedDynamicStiffness:
    """Factorised dynamic stiffness Z = K - omega^2 M + i omega C.

    M, C and K are mass, damping and stiffness. Free the factors with :meth:`destroy`, or use the
    object as a context manager (collective).

    Parameters
    ----------
    structure : Structure
        Structure with M, C and K.
    omega : float
        Angular frequency [rad/s]; 0 for statics.

    Raises
    ------
    InputError
        omega is negative or not finite, or is the natural frequency of an undamped mode.
    ConvergenceError
        Z is singular. For omega = 0, the structure can move as a rigid body.
    """

    def __init__(self, structure: Structure, omega: float) -> None:
        check_number("omega", omega, 0.0)
        self.structure = structure
        self._undamped_dynamic_stiffness, self._damping_matrix, self._damped_modes = (
            structure.stiffness,
            None,
            None,
        )
        if omega > 0.0:
            self._undamped_dynamic_stiffness = matrix_plus_weighted_matrix(
                structure.stiffness, -(omega**2), structure.mass
            )
            self._damping_matrix, self._damped_modes = (
                structure.damping_matrix,
                modes_with_modal_damping(structure),
            )
        system_matrix, border_columns = self._undamped_dynamic_stiffness, None
        if self._damping_matrix is not None:
            omega_times_damping = self._damping_matrix.copy()
            minus_omega_times_damping = self._damping_matrix.copy()
            omega_times_damping.scale(omega)
            minus_omega_times_damping.scale(-omega)
            system_matrix = PETSc.Mat().createNest(
                [[system_matrix, omega_times_damping], [minus_omega_times_damping, system_matrix]],
                comm=system_matrix.comm,
            )
            system_matrix = system_matrix.convert("aij", PETSc.Mat())
        elif self._damped_modes is not None:
            natural_omegas_squared = self._damped_modes.omega**2
            modal_dynamic_stiffness = natural_omegas_squared - omega**2
            is_near = np.abs(modal_dynamic_stiffness) < DEFLATION_BAND * natural_omegas_squared
            if np.any(
                self._damped_modes.omega[is_near & (self._damped_modes.damping_rates == 0.0)]
                == omega
            ):
                raise InputError(
                    "omega",
                    omega,
                    "another frequency than that of an undamped mode; or add damping",
                )
            undamped_modal_receptance = np.divide(
                1.0,
                modal_dynamic_stiffness,
                out=np.zeros_like(modal_dynamic_stiffness),
                where=~is_near,
            )
            self._damped_minus_factored_modal_receptances = (
                1.0 / (modal_dynamic_stiffness + 1j * omega * self._damped_modes.damping_rates)
                - undamped_modal_receptance
            )
            if is_near.any():
                border_columns = sparse.csr_matrix(self._damped_modes.mass_shapes[:, is_near])
        self._factorisation = Factor(
            system_matrix, symmetric=self._damping_matrix is None, border=border_columns
        )
        if self._factorisation.n_null_pivots:
            self.destroy()
            cause_text = (
                "it can move as a rigid body: clamp it"
                if omega == 0.0
                else "undamped resonance: add damping"
            )
            raise ConvergenceError(
                f"dynamic stiffness at {omega:g} rad/s: the structure is singular ({cause_text})"
            )

    def solve(self, dof_forces: np.ndarray) -> np.ndarray:
        """Return displacements (m, n_local) [m] under forces on the dofs (collective).

        ``dof_forces`` (m, n_local) [N] are real or complex. Each of the m rows is a load case of
        its own.
        """
        n_local = self.structure.n_local
        if self._damping_matrix is not None:
            force_in_real_form = np.concatenate([np.real(dof_forces), -np.imag(dof_forces)], axis=1)
            displacement_rows = self._factorisation.solve(force_in_real_form)
            return displacement_rows[:, :n_local] - 1j * displacement_rows[:, n_local:]
        real_force_rows = (
            np.concatenate([dof_forces.real, dof_forces.imag])
            if np.iscomplexobj(dof_forces)
            else dof_forces
        )
        displacement_rows = self._factorisation.solve(real_force_rows)
        if np.iscomplexobj(dof_forces):
            displacement_rows = (
                displacement_rows[: len(dof_forces)] + 1j * displacement_rows[len(dof_forces) :]
            )
        if self._damped_modes is None:
            return displacement_rows
        modal_forces = self.structure.sum_over_ranks(dof_forces @ self._damped_modes.shapes)
        return (
            displacement_rows
            + (modal_forces * self._damped_minus_factored_modal_receptances)
            @ self._damped_modes.shapes.T
        )

    def pair_compliance_matrix(self) -> np.ndarray:
        """Return the gaps' displacement by unit contact forces: (n_pairs, n_pairs) [m/N].

        The matrix is B^T Z^-1 B, with the dynamic stiffness Z. B takes contact forces to the dofs,
        B^T displacements to the gaps.
        """
        return self.structure.apply_bt(self.solve(self.structure.gap.T.toarray())).T

    def destroy(self) -> None:
        """Free the matrices and factors (collective)."""
        self._factorisation.destroy()
        if self._undamped_dynamic_stiffness is not self.structure.stiffness:
            self._undamped_dynamic_stiffness.destroy()

    def __enter__(self) -> FactorisedDynamicStiffness:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()


def make_compliance_model(
    structure: Structure, base_omega: float, harmonics: int, subharmonic: int = 1
) -> ComplianceModel:
    """Return the gaps' dynamic compliance at multiples 0 to H of a frequency (collective).

    ``base_omega`` [rad/s] is the response's frequency; the load's is ``subharmonic`` times as high.
    H is ``harmonics``. Small structures get a closed form by all modes, others sparse
    factorisations.

    Raises
    ------
    ConvergenceError
        The structure is in an undamped resonance, or can move as a rigid body.
    """
    load_rows = load_coefficients(structure, harmonics, subharmonic)
    if is_small(structure) and not all_modes(structure).is_ill_conditioned:
        return ModalCompliance(structure, base_omega, load_rows)
    return FactoredCompliance(structure, base_omega, load_rows)


def load_coefficients(structure: Structure, harmonics: int, subharmonic: int) -> np.ndarray:
    """Return the load's Fourier coefficients in the response's period: (2H+1, n_local) [N].

    The response's period is ``subharmonic`` load periods; H is ``harmonics``.
    """
    return resize_harmonics(stretch_period(structure.force, subharmonic), harmonics)


class ModalCompliance:
    """Dynamic compliance of the gaps in closed form, from all modes of a small structure.

    The compliance is exact with any damping. Mode j has the impedance omega_j^2 - w^2 + i w c_j at
    the frequency w, with the natural frequency omega_j and the modal damping c_j. If damping
    couples modes, the impedance is a full matrix (n_modes, n_modes). H is the number of harmonics.

    Attributes
    ----------
    gap_shape : tuple of int
        Shape of gap coefficients, (2H+1, n_pairs).
    matrices : (H+1, n_pairs, n_pairs) complex [m/N]
        Symmetric compliance matrix for each harmonic, 0 to H.
    linear_gap : (2H+1, n_pairs) [m]
        Gap under the load without contact forces: B^T u - g0. B^T takes displacements u to gaps,
        and g0 is the clearance.
    reachable_gap_basis : (n_pairs, n) or None
        Orthonormal basis of the gaps that modes can make; None if modes are at least as many as
        pairs.
    gap_without_modes : (2H+1, n_pairs) [m]
        Linear gap without the modes' contribution: static gap by coordinates without mass, less the
        clearance.
    """

    def __init__(self, structure: Structure, base_omega: float, load_rows: np.ndarray) -> None:
        if not is_small(structure):
            raise InputError(
                "structure",
                f"{structure.n_dofs} dofs",
                "a reduced structure, as reduce_structure returns, in a program of one rank",
            )
        self._pair_clearances = structure.clearance
        self._all_modes = all_modes(structure)
        self.reachable_gap_basis = (
            structure.compute_once(_reachable_gap_basis)
            if len(self._all_modes.gaps_by_mode) < structure.n_pairs
            else None
        )
        self._harmonic_orders = np.arange(len(load_rows) // 2 + 1.0)
        self._unscaled_modal_load = to_complex(load_rows @ self._all_modes.shapes)
        self.gap_shape: tuple[int, ...] = len(load_rows), structure.n_pairs
        self._massless_displacement_by_given_load, self._massless_gap_by_given_load = (
            None,
            np.zeros(self.gap_shape),
        )
        if self._all_modes.massless_displacement_by_dof_forces is not None:
            self._massless_displacement_by_given_load = (
                load_rows @ self._all_modes.massless_displacement_by_dof_forces
            )
            self._massless_gap_by_given_load = structure.apply_bt(
                self._massless_displacement_by_given_load
            )
        self._set_parameters(base_omega, 1.0, 1.0, 0.0)

    def _set_parameters(
        self, base_omega: float, load_factor: float, damping_factor: float, added_clearance: float
    ) -> None:
        """Set the parameters of a varied structure, and compute all that follows from them.

        Parameters
        ----------
        base_omega : float [rad/s]
            Frequency of the response.
        load_factor, damping_factor : float
            Factors of the structure's load and damping.
        added_clearance : float [m]
            Clearance added to every pair.
        """
        self._base_omega, self._damping_factor = base_omega, damping_factor
        is_mode_loaded = self._unscaled_modal_load != 0.0
        self._receptance = self._all_modes.modal_receptances(
            base_omega * self._harmonic_orders, damping_factor, is_mode_loaded
        )
        self._modal_load = load_factor * self._unscaled_modal_load
        self._load_factor = load_factor
        self.gap_without_modes = load_factor * self._massless_gap_by_given_load
        self.gap_without_modes[0] -= self._pair_clearances + added_clearance

    @cached_property
    def matrices(self) -> np.ndarray:
        """Compliance for each harmonic: (H+1, n_pairs, n_pairs) complex [m/N]."""
        return self._pair_compliance(self._receptance)

    @cached_property
    def linear_gap(self) -> np.ndarray:
        """Gap under the load without contact forces: (2H+1, n_pairs) [m]."""
        return self._gap_response(self._modal_load) + self.gap_without_modes

    def with_parameters(
        self, base_omega: float, *, load: float = 1.0, damping: float = 1.0, clearance: float = 0.0
    ) -> ModalCompliance:
        """Return the compliance at another frequency, and for a varied structure.

        ``base_omega`` [rad/s] is the response's frequency. ``load`` and ``damping`` are factors of
        the structure's own load and damping. ``clearance`` [m] is added to every pair's own
        clearance.
        """
        varied_model = object.__new__(type(self))  # faster than copy
        vars(varied_model).update(vars(self))
        for outdated_attribute_name in ("matrices", "linear_gap"):
            vars(varied_model).pop(outdated_attribute_name, None)
        varied_model._set_parameters(base_omega, load, damping, clearance)
        return varied_model

    def compliance_of_truncated_harmonics(self, max_harmonic: int) -> np.ndarray:
        """Return the compliance at harmonics above H: (n, n_pairs, n_pairs) complex [m/N].

        The n harmonics are H+1 to ``max_harmonic``.
        """
        harmonic_orders = np.arange(len(self.matrices), max_harmonic + 1)
        is_mode_loaded: np.ndarray = np.zeros(
            (len(harmonic_orders), len(self._all_modes.squares)), dtype=bool
        )
        modal_receptance = self._all_modes.modal_receptances(
            self._base_omega * harmonic_orders, self._damping_factor, is_mode_loaded
        )
        return self._pair_compliance(modal_receptance)

    def _pair_compliance(self, modal_receptance: np.ndarray) -> np.ndarray:
        """Return the gaps' compliance from modal receptances: (n, n_pairs, n_pairs) complex [m/N].

        ``modal_receptance`` is the modal displacement by unit modal forces at n frequencies: (n,
        n_modes) for uncoupled modes, else (n, n_modes, n_modes).
        """
        dynamic_pair_compliance = self._all_modes.compliance_of_pairs(modal_receptance)
        return (
            dynamic_pair_compliance
            if self._all_modes.residual_compliance is None
            else dynamic_pair_compliance + self._all_modes.residual_compliance
        )

    def displacement(self, contact_force: np.ndarray) -> np.ndarray:
        """Return the displacement under load and contact forces: (2H+1, n_local) [m].

        ``contact_force`` has the coefficients (2H+1, n_pairs) [N].
        """
        displacement_of_modes = from_complex(
            -self._negative_modal_displacement_with_load(contact_force) @ self._all_modes.shapes.T
        )
        return (
            displacement_of_modes
            if self._massless_displacement_by_given_load is None
            else displacement_of_modes + self._massless_displacement(contact_force)
        )

    def displacements_at_base_omegas(
        self, base_omegas: np.ndarray, contact_force: np.ndarray
    ) -> np.ndarray:
        """Return displacements under load and contact forces at many frequencies.

        Parameters
        ----------
        base_omegas : (n,) [rad/s]
            Frequencies of the response.
        contact_force : (2H+1, n, n_pairs) [N]
            Coefficients of the contact forces at each frequency.

        Returns
        -------
        (2H+1, n, n_local) [m]
            Coefficients of the displacement.
        """
        modes = self._all_modes
        omega_by_harmonic_and_base = np.multiply.outer(self._harmonic_orders, base_omegas)
        is_mode_loaded = np.repeat(self._unscaled_modal_load != 0.0, len(base_omegas), axis=0)
        modal_receptance = modes.modal_receptances(
            omega_by_harmonic_and_base.ravel(), self._damping_factor, is_mode_loaded
        )
        modal_force = self._modal_load[:, None] - to_complex(contact_force) @ modes.gaps_by_mode.T
        modal_displacement = modes.modal_response(
            modal_receptance.reshape(
                *omega_by_harmonic_and_base.shape, *modal_receptance.shape[1:]
            ),
            modal_force,
        )
        displacement_of_modes = from_complex(modal_displacement @ modes.shapes.T)
        if self._massless_displacement_by_given_load is None:
            return displacement_of_modes
        assert modes.massless_displacement_by_pair_forces is not None
        return (
            displacement_of_modes
            + self._load_factor * self._massless_displacement_by_given_load[:, None]
            - contact_force @ modes.massless_displacement_by_pair_forces.T
        )

    def selected_displacement(
        self, selection_rows: np.ndarray, contact_force: np.ndarray
    ) -> np.ndarray:
        """Return linear combinations of the displacements under load and contact: (2H+1, m).

        Parameters
        ----------
        selection_rows : (m, n_local)
            Factor for each dof. Each row gives a column of the result.
        contact_force : (2H+1, n_pairs) [N]
            Contact force coefficients.
        """
        displacement_of_modes = from_complex(
            -self._negative_modal_displacement_with_load(contact_force)
            @ (selection_rows @ self._all_modes.shapes).T
        )
        return (
            displacement_of_modes
            if self._massless_displacement_by_given_load is None
            else displacement_of_modes
            + self._massless_displacement(contact_force) @ selection_rows.T
        )

    def _massless_displacement(self, contact_force: np.ndarray) -> np.ndarray:
        """Return the displacement by coordinates without mass: (2H+1, n_local) [m].

        These coordinates respond quasi-statically to the load and to ``contact_force`` (2H+1,
        n_pairs) [N].
        """
        assert (
            self._all_modes.massless_displacement_by_pair_forces is not None
            and self._massless_displacement_by_given_load is not None
        )
        return (
            self._load_factor * self._massless_displacement_by_given_load
            - contact_force @ self._all_modes.massless_displacement_by_pair_forces.T
        )

    def modal_fields_for_kernel(
        self,
        omega: tuple[float, float],
        damping: tuple[float, float],
        residual_compliance: np.ndarray | None = None,
    ) -> dict[str, Any] | None:
        """Return the modes as fields of the kernel's C struct ``structure_at_pairs``.

        Used to follow a path along which the response's frequency w and the damping factor d change
        linearly. Mode j has the squared natural frequency s_j, the modal damping c_j, and the gaps
        P_j. At harmonic k its receptance is

            h_kj = 1 / (s_j - (k w)^2 + i k w d c_j).

        R_k is the dynamic compliance, R_inf the residual flexibility. With the matrix diag(h_k) of
        all receptances,

            R_k - R_inf = P^T diag(h_k) P + static_compliance,

        with the static compliance of the coordinates without mass, less R_inf.
        The modal load l_k adds P^T diag(h_k) l_k to the gap without contact.

        Parameters
        ----------
        omega, damping : (float, float)
            w [rad/s] and d: value at the path's start, and change to its end.
        residual_compliance : (n_pairs, n_pairs) [m/N], optional
            R_inf; None: zero.

        Returns
        -------
        dict or None
            None if damping couples modes. Otherwise ``squares``, s (n_modes,) [rad^2/s^2];
            ``modal_damping``, c (n_modes,) [1/s]; ``shapes``, P (n_modes, n_pairs); ``load``, l
            (H+1, n_modes) complex; ``static_compliance`` (n_pairs, n_pairs) or None; ``modes``, the
            number of modes; ``omega`` and ``damping``, w and d at the start; ``omega_rate`` and
            ``damping_rate``, their changes.
        """
        modes = self._all_modes
        if modes.damping.ndim == 2:
            return None
        (n_modes, n_pairs), static_compliance = modes.gaps_by_mode.shape, modes.residual_compliance
        if residual_compliance is not None:
            static_compliance = (
                -residual_compliance
                if static_compliance is None
                else static_compliance - residual_compliance
            )
        return {
            "modes": n_modes,
            "omega": omega[0],
            "omega_rate": omega[1],
            "damping": damping[0],
            "damping_rate": damping[1],
            "squares": require_shape(modes.squares, n_modes),
            "modal_damping": require_shape(modes.damping, n_modes),
            "shapes": require_shape(modes.gaps_by_mode, n_modes, self.gap_shape[1]),
            "load": require_shape(
                self._load_factor * self._unscaled_modal_load,
                len(self._harmonic_orders),
                n_modes,
                kind=complex,
            ),
            "static_compliance": None
            if static_compliance is None
            else require_shape(static_compliance, n_pairs, n_pairs),
        }

    def residual_derivative(self, parameter_name: str, contact_force: np.ndarray) -> np.ndarray:
        """Return the residual's derivative by a parameter at fixed contact forces: (2H+1, n_pairs).

        The residual is R lambda - g_lin, with the compliance R, contact forces lambda and the gap
        g_lin without contact. Mode j has the natural frequency omega_j and the modal damping c. At
        harmonic k the response's frequency w and the damping factor d give the modal impedance

            Z_k = omega_j^2 - (k w)^2 + i k w d c.

        The receptance Y_k = 1 / Z_k has the derivatives

            dY_k/dw = -Y_k (-2 k^2 w + i k d c) Y_k,        dY_k/dd = -Y_k (i k w c) Y_k.

        If damping couples modes, Z_k, Y_k and c are matrices.

        Parameters
        ----------
        parameter_name : "omega", "load", "damping" or "clearance"
            Response's frequency, factor of the load, factor of the damping, or added clearance.
        contact_force : (2H+1, n_pairs) [N]
            Contact force coefficients.
        """
        harmonic_orders = self._harmonic_orders[:, None]
        if parameter_name == "clearance":
            clearance_derivative = np.zeros_like(contact_force)
            clearance_derivative[0] = 1.0
            return clearance_derivative
        if parameter_name == "load":
            return -self._gap_response(self._unscaled_modal_load) - self._massless_gap_by_given_load
        if parameter_name == "damping":
            damping_force_per_omega = 1j * self._all_modes.damping_force(
                self._negative_modal_displacement_with_load(contact_force)
            )
            return -self._gap_response(self._base_omega * harmonic_orders * damping_force_per_omega)
        return from_complex(
            self._negative_modal_displacement_omega_derivative(contact_force)
            @ self._all_modes.gaps_by_mode
        )

    def selected_displacement_omega_derivative(
        self, selection_rows: np.ndarray, contact_force: np.ndarray
    ) -> np.ndarray:
        """Return the frequency derivative of linear combinations of displacements: (2H+1, m).

        The derivative is by the response's frequency [rad/s], at fixed contact forces.

        Parameters
        ----------
        selection_rows : (m, n_local)
            Factor for each dof. Each row gives a column of the result.
        contact_force : (2H+1, n_pairs) [N]
            Contact force coefficients.
        """
        return from_complex(
            -self._negative_modal_displacement_omega_derivative(contact_force)
            @ (selection_rows @ self._all_modes.shapes).T
        )

    def _negative_modal_displacement_omega_derivative(
        self, contact_force: np.ndarray
    ) -> np.ndarray:
        """Return -dq/dw, with modal displacements q and the response's frequency w.

        ``contact_force`` (2H+1, n_pairs) [N], kept fixed, has real Fourier coefficients. The result
        (H+1, n_modes) has complex ones.
        """
        harmonic_orders = self._harmonic_orders[:, None]
        negative_modal_displacement = self._negative_modal_displacement_with_load(contact_force)
        damping_force_per_omega = (
            1j * self._damping_factor * self._all_modes.damping_force(negative_modal_displacement)
        )
        impedance_force_by_omega = harmonic_orders * (
            damping_force_per_omega
            - 2.0 * self._base_omega * harmonic_orders * negative_modal_displacement
        )
        return -self._all_modes.modal_response(self._receptance, impedance_force_by_omega)

    def _gap_response(self, modal_force: np.ndarray) -> np.ndarray:
        """Return gaps (2H+1, n_pairs) [m] under complex modal forces (H+1, n_modes).

        Coordinates without mass, and the clearance, are left out.
        """
        return from_complex(
            self._all_modes.modal_response(self._receptance, modal_force)
            @ self._all_modes.gaps_by_mode
        )

    def _negative_modal_displacement_with_load(self, contact_force: np.ndarray) -> np.ndarray:
        """Return -q, with the modal displacements q under load and contact forces.

        ``contact_force`` (2H+1, n_pairs) [N] has real Fourier coefficients, the result (H+1,
        n_modes) complex ones. The modal force taken is the contact force less the load: hence -q.
        """
        modal_force_less_load = (
            to_complex(contact_force) @ self._all_modes.gaps_by_mode.T - self._modal_load
        )
        return self._all_modes.modal_response(self._receptance, modal_force_less_load)

    def destroy(self) -> None:
        """Do nothing: this model holds no factors."""


class FactoredCompliance:
    """Dynamic compliance of the gaps by a sparse factorisation for each harmonic.

    The compliance is exact. The factored matrices are kept until :meth:`destroy`. H is the number
    of harmonics.

    Attributes
    ----------
    structure : Structure
        Structure whose stiffness, mass and damping are factorised.
    load : (2H+1, n_local) [N]
        Fourier coefficients of the load.
    gap_shape : tuple of int
        Shape of gap coefficients, (2H+1, n_pairs).
    matrices : (H+1, n_pairs, n_pairs) complex [m/N]
        Symmetric compliance matrix for each harmonic, 0 to H.
    linear_gap : (2H+1, n_pairs) [m]
        Gap under the load without contact forces: B^T u - g0. B^T takes displacements u to gaps,
        and g0 is the clearance.
    """

    reachable_gap_basis: np.ndarray | None = None
    """None: modes can make all gaps, as no mode is left out."""

    def __init__(self, structure: Structure, base_omega: float, load_rows: np.ndarray) -> None:
        self.structure, self.load = structure, load_rows
        self._base_omega, harmonic_orders = base_omega, range(len(load_rows) // 2 + 1)
        self._factorised_stiffness_by_harmonic = [
            FactorisedDynamicStiffness(structure, k * base_omega) for k in harmonic_orders
        ]
        compliance_matrices = np.array(
            [
                dynamic_stiffness.pair_compliance_matrix()
                for dynamic_stiffness in self._factorised_stiffness_by_harmonic
            ],
            dtype=complex,
        )
        linear_gap = structure.gap_of(self.displacement_under_force_harmonics(load_rows))
        # Every rank continues independently: its numbers must not differ even by rounding.
        self.matrices, self.linear_gap = structure.comm.bcast((compliance_matrices, linear_gap))
        self.gap_shape = self.linear_gap.shape
        if not (np.all(np.isfinite(self.matrices)) and np.all(np.isfinite(self.linear_gap))):
            self.destroy()
            raise ConvergenceError(
                "dynamic compliance: the structure is singular to rounding; add damping"
            )

    def compliance_of_truncated_harmonics(self, max_harmonic: int) -> np.ndarray:
        """Return the compliance at harmonics above H: (n, n_pairs, n_pairs) complex [m/N].

        The n harmonics are H+1 to ``max_harmonic``. The lowest modes, at least 20, respond
        dynamically; all higher modes respond statically. This approximation is for error estimates.
        """
        natural_omegas, modal_damping_rates, gap_shapes = self.structure.compute_once(
            _omegas_damping_rates_and_gap_shapes
        )
        modal_damping_rates = self.structure.damping_multiplier * modal_damping_rates
        static_compliance_of_other_modes = (
            self.matrices[0].real - (gap_shapes.T / natural_omegas**2) @ gap_shapes
        )
        truncated_harmonic_omegas = (
            self._base_omega * np.arange(len(self.matrices), max_harmonic + 1)[:, None]
        )
        modal_receptance = 1.0 / (
            natural_omegas**2
            - truncated_harmonic_omegas**2
            + 1j * truncated_harmonic_omegas * modal_damping_rates
        )
        return static_compliance_of_other_modes + np.matmul(
            gap_shapes.T * modal_receptance[:, None, :], gap_shapes
        )

    def displacement(self, contact_force: np.ndarray) -> np.ndarray:
        """Return the displacement under load and contact forces: (2H+1, n_local) [m].

        ``contact_force`` has the coefficients (2H+1, n_pairs) [N].
        """
        return self.displacement_under_force_harmonics(
            self.load - self.structure.apply_b(contact_force)
        )

    def displacement_under_force_harmonics(self, dof_force_rows: np.ndarray) -> np.ndarray:
        """Return the displacement under forces on the dofs: (2H+1, n_local) [m].

        ``dof_force_rows`` (2H+1, n_local) [N] and the result have Fourier coefficients as rows.
        """
        complex_displacements = [
            dynamic_stiffness.solve(
                complex_dof_forces.real[None] if k == 0 else complex_dof_forces[None]
            )[0]
            for k, (dynamic_stiffness, complex_dof_forces) in enumerate(
                zip(self._factorised_stiffness_by_harmonic, to_complex(dof_force_rows), strict=True)
            )
        ]
        return from_complex(np.array(complex_displacements, dtype=complex))

    def destroy(self) -> None:
        """Free the factors (collective)."""
        for dynamic_stiffness in self._factorised_stiffness_by_harmonic:
            dynamic_stiffness.destroy()
        collect_garbage(self.structure.comm)


ComplianceModel = ModalCompliance | FactoredCompliance
"""Dynamic compliance of the gaps at the multiples 0 to H of the response's frequency."""


def resized_compliance_model(compliance_model: ComplianceModel, harmonics: int) -> ComplianceModel:
    """Return a compliance model with another number of harmonics, ``harmonics``.

    Used for coarser solutions and, with added harmonics, for error estimates. A
    :class:`FactoredCompliance` has no factored matrices for added harmonics. The lowest modes (at
    least 20) then respond dynamically, and higher modes statically. The new model's method
    ``displacement`` still takes contact forces with the old number of harmonics.
    """
    new_model = copy(compliance_model)
    resized_matrices = compliance_model.matrices[: harmonics + 1]
    if len(resized_matrices) <= harmonics:
        resized_matrices = np.concatenate(
            [resized_matrices, compliance_model.compliance_of_truncated_harmonics(harmonics)]
        )
    new_model.matrices = resized_matrices
    new_model.linear_gap = resize_harmonics(compliance_model.linear_gap, harmonics)
    new_model.gap_shape = new_model.linear_gap.shape
    return new_model


def _reachable_gap_basis(structure: Structure) -> np.ndarray:
    """Return an orthonormal basis of the gaps that modes can make: (n_pairs, n)."""
    return scipy.linalg.orth(all_modes(structure).gaps_by_mode.T)


def _omegas_damping_rates_and_gap_shapes(
    structure: Structure,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the lowest modes with damping, at least 20 if the structure has as many dofs.

    Modes with a computed frequency of 0 are left out: rigid-body modes, or modes so slow that
    rounding hides the frequency.

    Returns
    -------
    omega : (n,) [rad/s]
        Natural frequencies.
    rate : (n,) [1/s]
        Modal damping.
    shapes : (n, n_pairs)
        Gaps of the mass-normalised modes.
    """
    modes_of_damping, n_modes = modes_with_modal_damping(structure), min(20, structure.n_dofs)
    known_or_solved_modes = (
        modes_of_damping
        if modes_of_damping and len(modes_of_damping.omega) >= n_modes
        else solve_modes(structure, n_modes)
    )
    modal_damping_rates = np.diag(
        project_damping_on_columns(structure, known_or_solved_modes.shapes)
    )
    is_elastic = known_or_solved_modes.omega > 0.0  # the lowest may be lost in rounding
    return (
        known_or_solved_modes.omega[is_elastic],
        modal_damping_rates[is_elastic],
        structure.apply_bt(known_or_solved_modes.shapes.T)[is_elastic],
    )


def relative_residual_rounding(compliance_model: ComplianceModel, law: ContactLaw) -> float:
    """Return the rounding error of the harmonic-balance equations with uncoupled pairs.

    The relative residual is |F| / |x|, with the unknowns x and the residual F. The rounding error
    is machine epsilon times the largest product of the law's stiffness and the compliance. Raises
    InputError if rounding leaves nothing of the contact force.
    """
    max_contact_stiffness = float(np.max(law.stiffness))
    row_sums = np.abs(compliance_model.matrices).sum(axis=2)
    max_allowed_stiffness = COARSE_TOLERANCE / (
        MACHINE_EPSILON * float(row_sums[0].max(initial=1e-300))
    )
    if not max_contact_stiffness < max_allowed_stiffness:
        requirement = (
            f"at most {max_allowed_stiffness:.2g} N/m on this structure, else rounding hides "
        )
        requirement += "the contact force; for rigid contact use UnilateralConstraint"
        raise InputError("contact stiffness", max_contact_stiffness, requirement)
    return residual_rounding(max_contact_stiffness * float(row_sums.max(initial=0.0)))
