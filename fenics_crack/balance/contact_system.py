"""Harmonic balance condensed onto the contact pairs, whose gaps are the only unknowns.

    F(s) = s - g_lin + (R_k - R_inf) b_k(lambda(s)) = 0,       J = I + (R - R_inf) T,

g_lin is the gap without contact forces. R is the compliance (:mod:`compliance`), block diagonal in
the harmonics. R_inf is the static compliance in series with contact. b are the coefficients of the
contact forces lambda(s), and T is the derivative db/ds. s is the slow gap, and the gap is g = s -
R_inf lambda(s). Contact forces are computed in four ways:

pair by pair   R_inf = 0, s = g: the penalty law of uncoupled pairs (:mod:`contact_integrals`)
coupled        R_inf couples the pairs. R_k - R_inf falls like k^-2, so that s is smooth. Only s is
               truncated, and g keeps its kinks. The penalty law and the constraint are one law,
               with a stiffness or without
projected      no penetration, for pairs with mass. R_inf = I / eps for the coefficients, with a
               weight eps: s = g + lambda / eps, lambda = eps max(s, 0) pair by pair (dynamic
               Lagrangian). Truncated solutions depend a little on eps, less with more harmonics
sampled        any other law, by alternating between frequency and time (AFT)

With fewer modes than coupled pairs, R_k - R_inf = U R'_k U^T. U is an orthonormal basis of the gaps
that modes can make, and steps are found in the coordinates of U:

    J^-1 r = r - U (I + R' U^T T U)^-1 R' U^T T r,       det J = det(I + R' U^T T U).

With many coupled unknowns J is not formed, and GMRES takes products J v. With exact integrals the
kernel follows paths (``kernel/contact.h``, ``compliance.h``, ``krylov.h``). Along the path
parameter p the contact stiffness grows like e^(growth p), g_lin grows linearly, and the softness (a
compliance in series with every pair) falls. Or the base frequency and the modal damping change, and
R and g_lin follow.

Sources: Nacivet, Pierre, Thouverez, Jezequel, Journal of Sound and Vibration 265 (2003) 201-219
(projected); Monjaraz-Tec, Gross and Krack, arXiv 2111.07693 and 2207.00795 (coupled, in time),
2603.26446 (in frequency).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import ref

import numpy as np

from fenics_crack.balance.compliance import ComplianceModel, resized_compliance_model
from fenics_crack.balance.contact_integrals import ContactIntegrals, multiply_compliance_and_force
from fenics_crack.balance.friction_integrals import (
    ContactAndFrictionForces,
    FrictionIntegrals,
    integrals_with_coupled_pairs,
)
from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import hertz_property
from fenics_crack.kernel import Struct, attach_destructor, kernel, pointer, require_shape
from fenics_crack.model.contact import (
    ContactLaw,
    add_pair_for_each_contact_force,
    count_rows_per_pair,
    friction_of,
    is_rigid,
    law_of_rows,
    merge_layers_of_pairs,
    split_pairs_into_layers,
    spring_compliances,
)
from fenics_crack.model.modal import all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import (
    DenseLinearisation,
    Equations,
    Linearisation,
    solve_by_factors_of_transpose,
)
from fenics_crack.numerics.fourier import (
    evaluate_series,
    fourier_basis_for,
    fourier_basis_over_period,
    resize_harmonics,
    stretch_period,
)
from fenics_crack.numerics.newton import gmres

MAX_UNKNOWNS_WITH_JACOBIAN = 350
"""Unknowns per step above which coupled pairs have no dense Jacobian.

Above, GMRES takes products with the Jacobian. Measured with H = 8 to 40 and 18 pairs: both ways
take equally long at 300 to 350 unknowns.
"""

DYNAMIC_TO_SOFT_PAIR_COMPLIANCE = 0.05
"""Dynamic compliance of the gaps, over the series compliance of softest contact.

A path to the contact law starts at this ratio. The solution there is unique and close to the
linear one.
"""

ResidualDerivativeFunction = Callable[["ContactPoint"], np.ndarray]
"""Callable from a point to dF/dp, the residual's derivative by a path parameter p."""


def default_projection_weight(compliance_model: ComplianceModel) -> float:
    """Return the default stiffness of a rigid contact between crack faces with mass [N/m].

    This stiffness is the weight eps in the law lambda = eps max(0, g + lambda / eps) (dynamic
    Lagrangian), with the contact force lambda and the gap g. It is 1 over the largest row sum
    of the static compliance matrix. Raises InputError if the pairs cannot move.
    """
    max_row_sum = float(np.abs(compliance_model.matrices[0]).sum(axis=1).max())
    if not max_row_sum > 0.0:
        raise InputError(
            "structure",
            "static compliance 0",
            "a structure whose contact pairs can move: do not clamp all nodes of the crack faces",
        )
    return 1.0 / max_row_sum


class ContactSystem:
    """Harmonic-balance equations with the slow gap as unknown, equal on every rank.

        F(s) = s - g_lin + (R_k - R_inf) b(lambda(s)) = 0

    The slow gap s = g + R_inf lambda is the gap g without its quasi-static response to the contact
    forces lambda. Its coefficients are (2H+1, n_rows), with a column for each pair; with friction,
    tangential columns follow. g_lin is the gap without contact forces, R_k the dynamic compliance
    at harmonic k, R_inf the residual flexibility, b the forces' coefficients.

    The path parameter p leads from soft contact to the law itself, at p = 1.

    Parameters
    ----------
    compliance_model : ComplianceModel
        Dynamic compliance R_k of the gaps, and g_lin.
    integrals : ContactIntegrals
        Object to compute b from s.
    start_softness : float
        Compliance in series with every pair at p = 0, in units of
        ``integrals.mean_pair_compliance``. It falls like |1 - p|^3.
    """

    def __init__(
        self,
        compliance_model: ComplianceModel,
        integrals: ContactIntegrals,
        start_softness: float = 0.0,
    ) -> None:
        self.compliance_model, self.integrals, self._start_softness = (
            compliance_model,
            integrals,
            start_softness,
        )
        self.shape = compliance_model.gap_shape
        self.size = int(np.prod(self.shape))
        self.residual_compliance = integrals.residual_compliance
        """Residual flexibility R_inf [m/N] in series with contact; None: zero."""
        n_rows, n_pairs = self.shape
        self.reachable_gap_basis = (
            compliance_model.reachable_gap_basis if integrals.has_coupled_pairs else None
        )
        """Orthonormal basis (n_rows, n) of the gaps that modes can make.

        None: modes can make all gaps, or pairs are uncoupled.
        """
        n_step_unknowns = n_rows * (
            n_pairs if self.reachable_gap_basis is None else self.reachable_gap_basis.shape[1]
        )
        self.is_matrix_free = (
            integrals.has_coupled_pairs and n_step_unknowns > MAX_UNKNOWNS_WITH_JACOBIAN
        )
        self.n_cost_unknowns = min(n_step_unknowns, MAX_UNKNOWNS_WITH_JACOBIAN)
        """Number of unknowns for an estimate of a Newton step's time, at most 350."""

    @cached_property
    def linear_gap(self) -> np.ndarray:
        """Gap without contact forces: (2H+1, n_rows) [m]."""
        return self.compliance_model.linear_gap

    @cached_property
    def dynamic_less_static_compliance(self) -> np.ndarray:
        """Dynamic compliance less residual flexibility: (H+1, n_rows, n_rows) complex [m/N]."""
        compliance_matrices = self.compliance_model.matrices
        return (
            compliance_matrices
            if self.residual_compliance is None
            else compliance_matrices - self.residual_compliance
        )

    @cached_property
    def compiled_equations(self) -> CompiledEquations | None:
        """Same equations in the C kernel; None without exact contact integrals."""
        if not self.integrals.is_exact:
            return None
        series_compliance = self._start_softness * self.integrals.mean_pair_compliance
        return self.compile(
            self.linear_gap,
            self.dynamic_less_static_compliance,
            start_series_compliance=series_compliance,
        )

    def compile(
        self,
        linear_gap: np.ndarray,
        compliance_or_modes: np.ndarray | Mapping[str, Any],
        **path_rates: Any,
    ) -> CompiledEquations:
        """Return these pairs' equations in the C kernel, along a path parameter p from 0 to 1.

        Parameters
        ----------
        linear_gap : (2H+1, n_pairs) [m]
            Gap without contact forces; if modes are given, without the modes' contribution.
        compliance_or_modes : (H+1, n_pairs, n_pairs) complex [m/N], or mapping
            Dynamic compliance less residual flexibility, or its modes
            (:meth:`ModalCompliance.modal_fields_for_kernel`).
        **path_rates
            Keywords of :class:`CompiledEquations` for changes along the path. ``linear_gap_rate``
            (2H+1, n_pairs) [m]: derivative of the gap by p. ``log_stiffness_rate``: derivative of
            ln(contact stiffness) by p. ``start_series_compliance`` [m/N]: compliance in series with
            each pair at p = 0.
        """
        return CompiledEquations(
            self.residual_compliance, self._gap_spring_compliances(self.integrals.law),
            linear_gap, compliance_or_modes,
            has_coupled_pairs=self.integrals.has_coupled_pairs,
            reachable_gap_basis=self.reachable_gap_basis,
            forms_jacobian=not self.is_matrix_free, **path_rates,
        )  # fmt: skip

    def _gap_spring_compliances(self, law: ContactLaw) -> np.ndarray:
        """Return the compliance of each gap's contact spring: (n_rows,) [m/N].

        The compliance is 1 over the contact stiffness, and 0 for a rigid law. With friction, normal
        gaps come first, then tangential ones.
        """
        return spring_compliances(law, self.shape[1] // count_rows_per_pair(law))

    @cached_property
    def dynamic_less_static_compliance_in_basis(self) -> np.ndarray:
        """Dynamic compliance less residual flexibility, in a basis U of gaps.

        U^T (R_k - R_inf) U: (H+1, n, n) complex [m/N]. The n columns of U, ``reachable_gap_basis``,
        are the gaps that modes can make.
        """
        assert self.reachable_gap_basis is not None
        return (
            self.reachable_gap_basis.T
            @ self.dynamic_less_static_compliance
            @ self.reachable_gap_basis
        )

    def gap_without_static_part(
        self, gap: np.ndarray, force: np.ndarray, n_periods: int = 1
    ) -> np.ndarray:
        """Return the slow gap: gap plus residual flexibility times contact force.

        Parameters
        ----------
        gap, force : (2K+1, n_rows) [m], [N]
            Coefficients of gap and contact force, with any number of harmonics K. n_rows is the
            number of pairs, with friction twice as many.
        n_periods : int
            Periods of ``gap`` that fit into one period of the response.

        Returns
        -------
        (2H+1, n_rows) [m]
            Coefficients with the system's harmonics.
        """
        gap, force = (
            resize_harmonics(
                stretch_period(gap_or_force_coefficients, n_periods), self.integrals.harmonics
            )
            for gap_or_force_coefficients in (gap, force)
        )
        return gap if self.residual_compliance is None else gap + force @ self.residual_compliance

    def gap(self, unknown: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the gap: slow gap less residual flexibility times contact force.

        ``unknown`` [m] is the slow gap. Gap, slow gap and ``force`` [N] are (n, n_rows), for n
        Fourier coefficients or instants. n_rows is the number of pairs, with friction twice as
        many.
        """
        return (
            unknown
            if self.residual_compliance is None
            else unknown - force @ self.residual_compliance
        )

    def linearise(self, unknown: np.ndarray, parameter: float = 1.0) -> ContactPoint:
        """Return the equations, linearised at a slow gap.

        ``unknown`` (2H+1, n_rows) [m] is the slow gap: gap plus residual flexibility times contact
        force. ``parameter`` is the path parameter. At 1 the law itself acts; below 1, an added
        compliance in series softens the contact.
        """
        parameter_distance_to_law = 1.0 - parameter
        softness_derivative_by_parameter = (
            -3.0 * self._start_softness * parameter_distance_to_law * abs(parameter_distance_to_law)
        )
        return ContactPoint(
            self,
            unknown,
            self.integrals.with_series_softness(
                self._start_softness * abs(parameter_distance_to_law) ** 3
            ),
            lambda point: multiply_compliance_and_force(
                self.dynamic_less_static_compliance,
                softness_derivative_by_parameter
                * point.forces_with_derivatives.series_softness_derivative(),
            ),
        )

    def linearise_with_derivative(
        self,
        unknown: np.ndarray,
        residual_derivative_by_parameter_function: ResidualDerivativeFunction,
    ) -> ContactPoint:
        """Return the equations, linearised at a slow gap, for any path parameter.

        Parameters
        ----------
        unknown : (2H+1, n_rows) [m]
            Slow gap: gap plus residual flexibility times contact force.
        residual_derivative_by_parameter_function : callable
            Takes the linearised equations; returns the residual's derivative (2H+1, n_rows) by the
            path parameter.
        """
        return ContactPoint(
            self, unknown, self.integrals, residual_derivative_by_parameter_function
        )

    def max_series_contact_stiffness(self, law: ContactLaw) -> float:
        """Return the largest slope of contact forces over slow gaps, for a law [N/m].

        The slope is the inverse of the smallest eigenvalue of R_inf + I/k, with the residual
        flexibility R_inf and the contact stiffness k. The slow gap is gap + R_inf lambda, with the
        contact forces lambda.
        """
        contact_spring_compliances = self._gap_spring_compliances(law)
        min_series_compliance = float(contact_spring_compliances.min())
        if self.residual_compliance is not None:
            min_series_compliance = max(
                min_series_compliance,
                float(
                    np.linalg.eigvalsh(
                        self.residual_compliance + np.diag(contact_spring_compliances)
                    )[0]
                ),
            )
        return 1.0 / max(min_series_compliance, 1e-300)

    def system_along_friction_factor(self) -> SystemAlongFrictionFactor:
        """Return these equations with a factor for the friction coefficient as path parameter.

        The factor is 0 without friction, and 1 for the law.
        """
        return SystemAlongFrictionFactor(self.compliance_model, self.integrals)

    def system_along_softness(self) -> ContactSystem:
        """Return these equations along a path from very soft contact to the law.

        The path parameter is 0 for soft contact, and 1 for the law. At 0 the compliance in series
        with every pair is 20 times the dynamic compliance (largest row sum, without residual
        flexibility).
        """
        max_row_sum = float(np.abs(self.dynamic_less_static_compliance).sum(axis=2).max())
        start_softness = max_row_sum / (
            DYNAMIC_TO_SOFT_PAIR_COMPLIANCE * self.integrals.mean_pair_compliance
        )
        return ContactSystem(self.compliance_model, self.integrals, start_softness)

    def with_harmonics(self, harmonics: int) -> ContactSystem:
        """Return these equations with another number of harmonics.

        A large structure has no factored matrices for harmonics above the present H. For these
        harmonics the lowest modes (at least 20) respond dynamically, and higher modes statically.
        This is enough for an error estimate.
        """
        compliance_model = resized_compliance_model(self.compliance_model, harmonics)
        return ContactSystem(compliance_model, self.integrals.with_harmonics(harmonics))


class SystemAlongFrictionFactor(ContactSystem):
    """Harmonic-balance equations along a path of growing friction.

    The path parameter is a factor for the friction coefficient: 0 without friction, 1 for the law.
    """

    def linearise(self, unknown: np.ndarray, parameter: float = 1.0) -> ContactPoint:
        """Return the equations, linearised with a factor for the friction coefficient.

        ``unknown`` (2H+1, n_rows) [m] is the slow gap: gap plus residual flexibility times contact
        force. ``parameter`` is the factor; below 0 it counts as 0.
        """
        assert isinstance(self.integrals, FrictionIntegrals)
        integrals = replace(self.integrals, friction_coefficient_factor=max(parameter, 0.0))
        return ContactPoint(self, unknown, integrals, residual_friction_scale_derivative)


class ContactPoint(DenseLinearisation):
    """Harmonic-balance equations of a :class:`ContactSystem`, linearised at a slow gap.

    ``unknown`` (2H+1, n_rows) [m] has the slow gap's coefficients: gap plus residual flexibility
    times contact force. n_rows is the number of pairs, with friction twice as many.
    """

    def __init__(
        self,
        system: ContactSystem,
        unknown: np.ndarray,
        integrals: ContactIntegrals,
        residual_derivative_by_parameter_function: ResidualDerivativeFunction,
    ) -> None:
        self.system = system
        self.unknown = unknown
        self._residual_derivative_by_parameter_function = residual_derivative_by_parameter_function
        self.forces_with_derivatives = integrals.linearise(unknown)
        self.force = self.forces_with_derivatives.force
        """Coefficients of the contact force: (2H+1, n_rows) [N]."""
        self.gap = system.gap(unknown, self.force)
        """Coefficients of the gap: (2H+1, n_rows) [m]."""

    @cached_property
    def residual(self) -> np.ndarray:  # type: ignore[override]
        """Residual of the equations: (2H+1, n_rows) [m].

        The residual is s - g_lin + (R - R_inf) b. s is the slow gap, and g_lin the gap without
        contact. R is the dynamic compliance, R_inf the residual flexibility, and b the contact
        forces' coefficients.
        """
        system = self.system
        return (
            self.unknown
            - system.linear_gap
            + multiply_compliance_and_force(system.dynamic_less_static_compliance, self.force)
        )

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Dense Jacobian I + (R - R_inf) T: ((2H+1) n_rows, (2H+1) n_rows).

        R is the dynamic compliance, and R_inf the residual flexibility. T is the forces' derivative
        by the slow gap: gap plus residual flexibility times contact force.
        """
        return self.forces_with_derivatives.identity_plus_compliance_tangent(
            self.system.dynamic_less_static_compliance
        )

    def matrix_to_factorise(self) -> np.ndarray:
        system = self.system
        if system.reachable_gap_basis is not None:
            return self.forces_with_derivatives.identity_plus_compliance_tangent(
                system.dynamic_less_static_compliance_in_basis, system.reachable_gap_basis
            )
        return self.jacobian

    def apply(self, change: np.ndarray) -> np.ndarray:
        return change + multiply_compliance_and_force(
            self.system.dynamic_less_static_compliance,
            self.forces_with_derivatives.force_change(change),
        )

    def solve(self, right_side: np.ndarray) -> np.ndarray:
        system = self.system
        if system.is_matrix_free:
            return gmres(self.apply, right_side, kernel.SOLUTION_TOLERANCE)
        factors = self._factors
        if system.reachable_gap_basis is not None:
            response_in_basis = (
                multiply_compliance_and_force(
                    system.dynamic_less_static_compliance,
                    self.forces_with_derivatives.force_change(right_side),
                )
                @ system.reachable_gap_basis
            )
            return (
                right_side
                - solve_by_factors_of_transpose(factors, response_in_basis)
                @ system.reachable_gap_basis.T
            )
        return solve_by_factors_of_transpose(factors, right_side)

    @property
    def sign(self) -> float:
        """Sign of the Jacobian's determinant; nan if the Jacobian is not formed."""
        return np.nan if self.system.is_matrix_free else super().sign

    @cached_property
    def by_parameter(self) -> np.ndarray:
        return self._residual_derivative_by_parameter_function(self)

    def gap_change(self, slow_gap_change: np.ndarray) -> np.ndarray:
        """Return the gap's linearised change for a change of the slow gap.

        Both are (2H+1, n_rows) [m]. Slow gap: gap plus residual flexibility times contact force.
        """
        return self.system.gap(
            slow_gap_change, self.forces_with_derivatives.force_change(slow_gap_change)
        )

    def gap_change_by_force_error(self, force_change: np.ndarray) -> np.ndarray:
        """Return the gap's linearised change for a given error of the contact force.

        ``force_change`` (2H+1, n_rows) [N] is added to the force that the law gives. The linearised
        equations are solved again. So the result (2H+1, n_rows) [m] includes the change of the
        law's own force.
        """
        unknown_response_to_force_change = self.solve(
            -multiply_compliance_and_force(self.system.dynamic_less_static_compliance, force_change)
        )
        return self.system.gap(self.gap_change(unknown_response_to_force_change), force_change)


# --- the motion -----------------------------------------------------------------------------------


@keep_old_attribute_names(
    at_phase="basis_gaps_and_forces_at_phases",
    coordinates="displacement_of_local_dofs",
    force_rows="row_force_coefficients",
    gap_rows="row_gap_coefficients",
    over_period="basis_gaps_and_forces_over_period",
    slow_gap_coefficients="gap_series_without_static_part",
    sticking_places="slider_positions",
    structure_with_row_pairs="structure_with_pair_per_row",
)
@dataclass(frozen=True, repr=False)
class PeriodicMotion:
    """Periodic motion by Fourier coefficients of displacement, gaps and contact forces.

        u(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t),    w = omega / subharmonic

    u are displacements of dofs, and w is the response's frequency. Coefficients have the rows a0,
    a1, b1, ..., aH, bH. A positive gap is penetration.

    Attributes
    ----------
    structure : Structure
        Vibrating structure.
    omega : float [rad/s]
        Angular frequency of the load.
    contact : ContactLaw or None
        Law between the crack faces; None for a linear motion.
    displacement_coefficients : (2H+1, n_local) [m]
        Displacement of this rank's dofs.
    gap_coefficients, force_coefficients : (2H+1, n_pairs) [m], [N]
        Normal gaps and normal contact forces.
    subharmonic : int
        The response has this many times the load's period.
    static_above : float or None
        Frequency [rad/s] above which modes respond quasi-statically; None: no mode does.
    tangential_gap_coefficients, tangential_force_coefficients : (2H+1, n_pairs) or None
        Tangential gaps [m] and friction forces [N]; None without friction.
    """

    frequency = hertz_property()
    structure: Structure
    omega: float
    contact: ContactLaw | None
    displacement_coefficients: np.ndarray
    gap_coefficients: np.ndarray
    force_coefficients: np.ndarray
    subharmonic: int
    static_above: float | None = None
    tangential_gap_coefficients: np.ndarray | None = None
    tangential_force_coefficients: np.ndarray | None = None

    @property
    def harmonics(self) -> int:
        """Number of harmonics H of the response's frequency."""
        return (len(self.gap_coefficients) - 1) // 2

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def period(self) -> float:
        """Period of the response [s]."""
        return float(2.0 * np.pi / self.base_omega)

    @cached_property
    def residual_compliance(self) -> np.ndarray | None:
        """Residual flexibility: (n_rows, n_rows) [m/N], or None if ``static_above`` is None.

        The flexibility is the quasi-static response of gaps to contact forces. The rows are the
        pairs' normal gaps. With friction, tangential gaps follow. Under the layered law, both come
        twice.
        """
        if self.static_above is None:
            return None
        return all_modes(self.structure_with_pair_per_row).static_pair_compliance(self.static_above)

    @cached_property
    def structure_with_pair_per_row(self) -> Structure:
        """Structure with a contact pair for each scalar contact force.

        With friction, each tangential gap is an additional pair. Under the layered law every pair
        comes twice, in both directions. Under other laws the result is the structure itself.
        """
        return add_pair_for_each_contact_force(self.contact, self.structure)

    @property
    def row_gap_coefficients(self) -> np.ndarray:
        """Coefficients of normal gaps, then of tangential ones: (2H+1, n_columns) [m]."""
        return _join_columns(self.gap_coefficients, self.tangential_gap_coefficients)

    @property
    def row_force_coefficients(self) -> np.ndarray:
        """Coefficients of normal forces, then of friction forces: (2H+1, n_columns) [N]."""
        return _join_columns(self.force_coefficients, self.tangential_force_coefficients)

    @cached_property
    def _integrals(self) -> ContactIntegrals:
        """Object to compute contact forces from slow gaps.

        A slow gap is the gap plus residual flexibility times contact force.
        Only for coupled pairs or friction.
        """
        assert self.contact is not None
        residual_compliance_or_none = self.residual_compliance
        n_contact_rows = self.structure_with_pair_per_row.n_pairs
        residual_compliance = (
            np.zeros((n_contact_rows, n_contact_rows))
            if residual_compliance_or_none is None
            else residual_compliance_or_none
        )
        law_of_all_rows = law_of_rows(self.contact, self.structure.n_pairs)
        return integrals_with_coupled_pairs(law_of_all_rows, self.harmonics, residual_compliance)

    @cached_property
    def gap_series_without_static_part(self) -> np.ndarray:
        """Coefficients of the slow gaps: (2H+1, n_rows) [m].

        Slow gap: gap plus residual flexibility times contact force, that is, without the
        quasi-static response. Without a residual flexibility, it is the gap.
        """
        gap_coefficients_of_rows, force_coefficients_of_rows = split_pairs_into_layers(
            self.contact,
            self.structure.n_pairs,
            self.row_gap_coefficients,
            self.row_force_coefficients,
        )
        if self.residual_compliance is None:
            return gap_coefficients_of_rows
        return gap_coefficients_of_rows + force_coefficients_of_rows @ self.residual_compliance

    def basis_gaps_and_forces_at_phases(
        self, phase: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return Fourier basis, gaps and contact forces at phases of the response.

        ``phase`` is (n,) [rad].

        Returns
        -------
        basis : (n, 2H+1)
            1, cos, sin, ..., the factors of coefficients.
        gap, force : (n, n_columns) [m], [N]
            Normal columns; with friction, tangential ones follow.
        """
        return self._gaps_and_forces_with_basis_at(
            fourier_basis_for(self.gap_coefficients, phase), phase
        )

    def basis_gaps_and_forces_over_period(
        self, n_instants: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return Fourier basis, gaps and contact forces at equally spaced instants of a period.

        Returns
        -------
        basis : (n_instants, 2H+1)
            1, cos, sin, ..., the factors of coefficients.
        gap, force : (n_instants, n_columns) [m], [N]
            Normal columns; with friction, tangential ones follow.
        """
        phases = 2.0 * np.pi / n_instants * np.arange(n_instants)
        return self._gaps_and_forces_with_basis_at(
            fourier_basis_over_period(self.harmonics, n_instants), phases
        )

    def _gaps_and_forces_with_basis_at(
        self, basis_at_phases: np.ndarray, phases: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the given basis, gaps [m] and contact forces [N].

        ``basis_at_phases`` (n, 2H+1) has a row for each response phase in ``phases`` (n,) [rad].
        Gaps and forces are (n, n_columns): normal columns; with friction, tangential ones follow.
        """
        contact_law = self.contact
        gap_without_static_part = basis_at_phases @ self.gap_series_without_static_part
        if contact_law is None:
            return basis_at_phases, gap_without_static_part, np.zeros_like(gap_without_static_part)
        if friction_of(contact_law) is not None:
            assert isinstance(self._integrals, FrictionIntegrals)
            force_at_phases = self._integrals.forces_and_places_at(
                self.gap_series_without_static_part, phases
            )[0]
        elif self.residual_compliance is not None:
            force_at_phases = self._integrals.forces_at_gap_samples(gap_without_static_part)
        elif not is_rigid(contact_law):
            law_of_all_rows = law_of_rows(contact_law, self.structure.n_pairs)
            force_at_phases = law_of_all_rows.force(gap_without_static_part)
        else:
            assert contact_law.weight is not None
            force_at_phases = np.maximum(
                0.0,
                contact_law.weight * gap_without_static_part
                + basis_at_phases @ self.force_coefficients,
            )
        gap_at_phases = gap_without_static_part
        if self.residual_compliance is not None:
            gap_at_phases = gap_without_static_part - force_at_phases @ self.residual_compliance
        return basis_at_phases, *merge_layers_of_pairs(
            contact_law, self.structure.n_pairs, gap_at_phases, force_at_phases
        )

    def gaps_and_forces(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return gaps [m] and contact forces [N] at times [s]: (len(time), n_columns) each.

        Columns are normal; with friction, tangential ones follow.
        """
        _, gap, force = self.basis_gaps_and_forces_at_phases(self.base_omega * np.atleast_1d(time))
        return gap, force

    def gap(self, time: np.ndarray) -> np.ndarray:
        """Return the normal gaps at times [s]: (len(time), n_pairs) [m].

        With a residual flexibility, the gap has kinks in time: its quasi-static part follows the
        contact force, and only the rest is a truncated series.
        """
        if self.residual_compliance is None:
            return evaluate_series(self.gap_coefficients, self.base_omega, time)
        return self.gaps_and_forces(time)[0][:, : self.structure.n_pairs]

    def contact_force(self, time: np.ndarray) -> np.ndarray:
        """Return the normal contact force at times [s]: (len(time), n_pairs) [N].

        The law gives the force from the gap at each time. With a residual flexibility R, the law
        and R give the force lambda from the slow gap g + R lambda. Under a rigid law of uncoupled
        pairs the force is eps max(0, g + lambda / eps). There g and lambda are the truncated series
        of gap and force, and eps is the law's ``weight``.
        """
        return self.gaps_and_forces(time)[1][:, : self.structure.n_pairs]

    def tangential_gap(self, time: np.ndarray) -> np.ndarray:
        """Return the tangential gaps at times [s]: (len(time), n_pairs) [m].

        InputError without friction.
        """
        self._require_friction_law()
        return self.gaps_and_forces(time)[0][:, self.structure.n_pairs :]

    def tangential_force(self, time: np.ndarray) -> np.ndarray:
        """Return the friction forces at times [s]: (len(time), n_pairs) [N].

        InputError without friction.
        """
        self._require_friction_law()
        return self.gaps_and_forces(time)[1][:, self.structure.n_pairs :]

    def slider_positions(self, time: np.ndarray) -> np.ndarray:
        """Return the friction sliders' positions at times [s]: (len(time), n_pairs) [m].

        A position is the tangential gap less the deformation of the tangential contact spring. A
        pair that sticks keeps its position. Under the layered law the positions are (len(time), 2
        n_pairs): of all sliders of layers, then of all sliders below them. InputError without
        friction.
        """
        self._require_friction_law()
        assert isinstance(self._integrals, FrictionIntegrals)
        return self._integrals.forces_and_places_at(
            self.gap_series_without_static_part, self.base_omega * time
        )[1]

    def _require_friction_law(self) -> None:
        """Raise InputError if the contact law has no friction."""
        if friction_of(self.contact) is None:
            raise InputError("contact", self.contact, "a law with friction, CoulombFriction")

    def displacement_of_local_dofs(self, time: np.ndarray) -> np.ndarray:
        """Return the displacement of this rank's dofs at times [s]: (len(time), n_local) [m].

        With quasi-static modes the displacement has kinks in time: the quasi-static response
        follows the contact forces, and only the rest is a truncated series.
        """
        basis_at_times, _, force_at_times = self.basis_gaps_and_forces_at_phases(
            self.base_omega * np.atleast_1d(time)
        )
        displacement_at_times = basis_at_times @ self.displacement_coefficients
        if self.static_above is not None:
            # The quasi-static part follows the forces in time, with their kinks.
            displacement_at_times -= (
                force_at_times - basis_at_times @ self.row_force_coefficients
            ) @ self._static_displacement_per_force.T
        return displacement_at_times

    @property
    def _static_displacement_per_force(self) -> np.ndarray:
        """Quasi-static displacement by unit contact forces: (n_local, n_columns) [m/N].

        Columns are normal forces; with friction, friction forces follow. The motion must have
        quasi-static modes, that is, ``static_above``.
        """
        assert self.static_above is not None
        responses = all_modes(self.structure_with_pair_per_row).static_displacement_by_pair_forces(
            self.static_above
        )
        return merge_layers_of_pairs(self.contact, self.structure.n_pairs, responses, responses)[0]


def _join_columns(normal_columns: np.ndarray, tangential_columns: np.ndarray | None) -> np.ndarray:
    """Return normal and tangential columns in one array, side by side.

    Parameters
    ----------
    normal_columns : (n, n_pairs)
        Normal gaps or forces at n instants, or n Fourier coefficients.
    tangential_columns : (n, n_pairs) or None
        Tangential gaps or forces; None: the normal columns are returned alone.
    """
    return (
        normal_columns
        if tangential_columns is None
        else np.hstack([normal_columns, tangential_columns])
    )


# --- in the kernel --------------------------------------------------------------------------------


class CompiledEquations(Equations):
    """Harmonic-balance equations F(s, p) = 0 in the C kernel, for the slow gap s.

    Slow gap: gap plus residual flexibility times contact force. p is a path parameter, 0 to 1,
    along which compliance, gap without contact or contact stiffness change.

    Parameters
    ----------
    residual_compliance : (n_pairs, n_pairs) [m/N] or None
        Residual flexibility in series with contact; None: zero.
    pair_spring_compliances : (n_pairs,) [m/N]
        Compliance 1/k of each pair's contact spring.
    linear_gap : (2H+1, n_pairs) [m]
        Gap without contact at p = 0; if modes are given, without the modes' contribution.
    compliance_or_modes : (H+1, n_pairs, n_pairs) complex [m/N], or mapping
        Dynamic compliance less residual flexibility at p = 0, or its modes
        (:meth:`ModalCompliance.modal_fields_for_kernel`).
    has_coupled_pairs : bool
        True if the residual flexibility couples pairs.
    reachable_gap_basis : (n_pairs, n) or None
        Orthonormal basis of the gaps that modes can make, if modes are fewer than coupled pairs.
    forms_jacobian : bool
        False: linear systems are solved with products of the Jacobian alone, and its sign is nan.
    linear_gap_rate : (2H+1, n_pairs) [m], optional
        Change of the gap without contact per unit of p.
    log_stiffness_rate : float
        Change of ln k per unit of p.
    start_series_compliance : float [m/N]
        Compliance in series with each pair at p = 0; it falls like |1 - p|^3.
    """

    def __init__(
        self,
        residual_compliance: np.ndarray | None,
        pair_spring_compliances: np.ndarray,
        linear_gap: np.ndarray,
        compliance_or_modes: np.ndarray | Mapping[str, Any],
        *,
        has_coupled_pairs: bool = False,
        reachable_gap_basis: np.ndarray | None = None,
        forms_jacobian: bool = True,
        linear_gap_rate: np.ndarray | None = None,
        log_stiffness_rate: float = 0.0,
        start_series_compliance: float = 0.0,
    ) -> None:
        self.shape = linear_gap.shape
        harmonics, n_pairs = self.shape[0] // 2, self.shape[1]
        if isinstance(compliance_or_modes, np.ndarray):
            dynamic_compliance_matrices = require_shape(
                compliance_or_modes, harmonics + 1, n_pairs, n_pairs, kind=complex
            )
            compliance_or_modes = {"compliance": dynamic_compliance_matrices}
        n_basis_gaps = n_pairs if reachable_gap_basis is None else reachable_gap_basis.shape[1]
        residual_compliance_or_zeros = (
            np.zeros((n_pairs, n_pairs)) if residual_compliance is None else residual_compliance
        )
        linear_gap_rate_or_zeros = (
            np.zeros_like(linear_gap) if linear_gap_rate is None else linear_gap_rate
        )
        structure_struct = Struct(
            "structure_at_pairs", harmonics=harmonics, pairs=n_pairs,
            linear=require_shape(linear_gap, *self.shape),
            linear_rate=require_shape(linear_gap_rate_or_zeros, *self.shape), **compliance_or_modes,
        )  # fmt: skip
        self._kernel_struct = Struct(
            "contact_pairs", structure=structure_struct, n_basis_gaps=n_basis_gaps,
            growth=log_stiffness_rate, softness=start_series_compliance,
            residual_compliance=require_shape(residual_compliance_or_zeros, n_pairs, n_pairs),
            spring_compliances=require_shape(pair_spring_compliances, n_pairs),
            has_coupled_pairs=has_coupled_pairs,
            forms_jacobian=forms_jacobian,
            basis=None if reachable_gap_basis is None
            else require_shape(reachable_gap_basis, n_pairs, n_basis_gaps),
        )  # fmt: skip
        self._point_handle = attach_destructor(
            kernel.new_contact_point(self._kernel_struct.address), kernel.free_contact_point
        )
        self.function_table = kernel.equations_of_contact(self._point_handle)

    def linearise(self, unknown: np.ndarray, parameter: float) -> CompiledPoint:
        """Return the equations, linearised at a slow gap.

        ``unknown`` (2H+1, n_pairs) [m] is the slow gap: gap plus residual flexibility times contact
        force. ``parameter`` is the path parameter, 0 to 1. The kernel evaluates the point on first
        use.
        """
        return CompiledPoint(self, require_shape(unknown, *self.shape), parameter)

    def function_table_at(self, point: CompiledPoint) -> Any:
        """Return a pointer to the kernel's C functions for the equations at a point.

        The equations are evaluated at ``point`` first, unless the kernel still holds this point.
        Raises ConvergenceError if no contact forces were found at an instant.
        """
        if (
            self._weakref_to_last_linearisation is None
            or self._weakref_to_last_linearisation() is not point
        ):
            if not self.has_found_solution(
                self.run_unchecked(
                    self.function_table.evaluate, pointer(point.unknown), point.parameter
                )
            ):
                raise ConvergenceError(
                    "contact: no forces solve the law at an instant; use a smaller stiffness"
                )
            self._weakref_to_last_linearisation = ref(point)
        return self.function_table

    def linearise_evaluated(self, unknown: np.ndarray, parameter: float) -> CompiledPoint:
        point = CompiledPoint(self, unknown, parameter)
        self._weakref_to_last_linearisation = ref(point)
        return point

    def max_dynamic_row_sum(self, parameter: float) -> float:
        """Return the largest row sum of dynamic compliance less residual flexibility [m/N].

        Absolute values are summed in each row. The largest sum over all harmonics is returned.
        ``parameter`` is the path parameter, 0 to 1.
        """
        self._weakref_to_last_linearisation = None
        max_row_sum = float(kernel.largest_dynamic_row_sum(self._point_handle, parameter))
        if not math.isfinite(max_row_sum):
            self.has_found_solution(kernel.SINGULAR_STRUCTURE)
        return max_row_sum


class CompiledPoint(Linearisation):
    """Harmonic-balance equations in the C kernel, linearised at a point.

    The kernel holds a single point at a time. If another point was evaluated since, the kernel
    evaluates this point again.
    """

    def __init__(self, system: CompiledEquations, unknown: np.ndarray, parameter: float) -> None:
        self.system, self.unknown, self.parameter = system, unknown, parameter

    @property
    def residual(self) -> np.ndarray:
        """Residual F(s, p): (2H+1, n_pairs) [m]."""
        residual_coefficients = np.empty_like(self.unknown)
        function_table = self.system.function_table_at(self)
        function_table.residual(function_table, pointer(residual_coefficients))
        return residual_coefficients

    def solve(self, right_side: np.ndarray) -> np.ndarray:
        solution_vector = np.array(right_side, dtype=float, order="C")
        if solution_vector.size != self.unknown.size:
            raise ValueError(f"{solution_vector.size} numbers instead of {self.unknown.size}")
        function_table = self.system.function_table_at(self)
        function_table.solve_tolerance = kernel.SOLUTION_TOLERANCE
        function_table.solve(function_table, pointer(solution_vector))
        return solution_vector

    @property
    def by_parameter(self) -> np.ndarray:
        residual_derivative = np.empty_like(self.unknown)
        function_table = self.system.function_table_at(self)
        function_table.by_parameter(function_table, pointer(residual_derivative))
        return residual_derivative

    @property
    def sign(self) -> float:
        function_table = self.system.function_table_at(self)
        return float(function_table.sign(function_table))


def residual_friction_scale_derivative(point: ContactPoint) -> np.ndarray:
    """Return the residual's derivative by a factor for the friction coefficient.

    ``point`` has the equations, linearised at a slow gap under a friction law. The result is
    (2H+1, n_rows) [m], with normal, then tangential gaps as columns.
    """
    assert isinstance(point.forces_with_derivatives, ContactAndFrictionForces)
    return multiply_compliance_and_force(
        point.system.dynamic_less_static_compliance,
        point.forces_with_derivatives.friction_scale_derivative(),
    )
