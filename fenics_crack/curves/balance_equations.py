"""Condensed equations of harmonic balance along one parameter of a curve:

    F(g, v) = g - g_lin(v) + R(v) b(g, v) = 0.

The unknowns g are the Fourier coefficients of the gaps (of the slow gaps with a residual
flexibility). g_lin are those without contact, b those of the contact forces, and R is the
compliance between forces and gaps at each harmonic.

The parameter v is a load frequency, a factor for load, damping, contact stiffness or friction, a
clearance, or a rotor speed that the load frequency follows. The equations take the small or reduced
structure alone, in closed form.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from functools import cached_property

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_integrals import ContactIntegrals, multiply_compliance_and_force
from fenics_crack.balance.contact_system import (
    CompiledEquations,
    ContactPoint,
    ContactSystem,
    residual_friction_scale_derivative,
)
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import InputError, check_number, check_omega
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.model.contact import friction_of
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import CENTRAL_DIFFERENCE_STEP, residual_rounding
from fenics_crack.numerics.fourier import stretch_period


class BalanceEquations(CurveSystem):
    """Harmonic-balance equations along a curve's parameter, with gaps as unknowns.

        F(g, v) = g - g_lin(v) + R(v) b(g, v) = 0

    The unknowns g (2H+1, n_pairs) [m] are the gaps' Fourier coefficients. With a residual
    flexibility they belong to slow gaps: gap plus residual flexibility times contact force. g_lin
    are the gaps without contact, R the compliance, b the contact forces' coefficients, and v the
    parameter. The structure is small or reduced.

    Attributes
    ----------
    has_varying_integrals : bool
        True if the integrals of contact forces over a period change along the parameter, by the law
        or by the residual flexibility.
    angle_weights : (2H+1, 1) or None
        Weights of the unknowns in angles between tangents; None: all 1.
    """

    has_varying_integrals = False

    def __init__(self, problem: Problem, start: float, end: float) -> None:
        if problem.static_above is None:
            problem = problem.with_common_cutoff(self._common_cutoff(problem, start, end))
        if problem.has_projected_constraint:
            contact_requirement = (
                "UnilateralPenalty; or reduce_structure(structure, method='massless')"
            )
            raise InputError("contact", problem.contact, contact_requirement)
        self.problem, self.start, self.end = problem, start, end
        self._unvaried_compliance_model = ModalCompliance(
            problem.structure_with_pair_per_row, problem.base_omega, problem.load
        )
        self._last_value_and_system: tuple[float, ContactSystem] | None = None
        start_system = self.system(start)
        self.shape, self.is_matrix_free = start_system.shape, start_system.is_matrix_free
        self.angle_weights: np.ndarray | None = None
        """Weights of the unknowns in angles between tangents: (2H+1, 1), or None for 1.

        Without a dense Jacobian, harmonic k has the weight 1 / k^2. Where the phase of the motion
        turns, the phase of harmonic k turns k times as far, and a tangent's high harmonics are not
        small.
        """
        if self.is_matrix_free:
            harmonic_order = (np.arange(self.shape[0]) + 1) // 2
            self.angle_weights = 1.0 / np.maximum(harmonic_order, 1)[:, None] ** 2.0

    @classmethod
    def check_value(cls, structure: Structure, key: str, value: float) -> None:
        """Raise InputError unless ``value`` is allowed for the curve's parameter.

        ``key`` is the name of the value in the error message. Here the value must be above 0.
        Subclasses may have another rule, also with ``structure``.
        """
        check_number(key, value, 0.0, excludes_bound=True)

    def _common_cutoff(self, problem: Problem, start: float, end: float) -> float:
        """Return the frequency above which modes are quasi-static on the whole curve [rad/s].

        A quasi-static mode follows the load without inertia. The problem has a cutoff frequency for
        quasi-static modes at each parameter value. The result is the larger cutoff of ``start`` and
        ``end``.
        """
        return max(self.vary_problem(problem, value).quasi_static_above for value in (start, end))

    @cached_property
    def _contact_integrals(self) -> ContactIntegrals:
        """Integrals of the contact force over a period, under the problem's law."""
        return self.problem.integrals()

    @cached_property
    def max_force_slope(self) -> float:
        """Largest slope of contact forces over slow gaps [N/m].

        The slow gap is the gap plus residual flexibility times contact force. Without a residual
        flexibility it is the gap. The slope is the larger of two: under the law at the curve's
        start, and under the law at the end.
        """
        laws = (self.problem_at(value).contact for value in (self.start, self.end))
        return max(self.system(self.start).max_series_contact_stiffness(law) for law in laws)

    @classmethod
    @abstractmethod
    def vary_problem(cls, problem: Problem, value: float) -> Problem:
        """Return a problem with another value of the curve's parameter."""

    @classmethod
    def load_frequency(cls, problem: Problem, value: float) -> float:
        """Return the load frequency [rad/s] at a parameter value.

        ``problem`` is the problem at another value. The frequency is the problem's, or follows the
        parameter.
        """
        return problem.omega

    def problem_at(self, value: float) -> Problem:
        """Return the problem at a value of the curve's parameter."""
        return self.vary_problem(self.problem, value)

    def _make_system(self, value: float) -> ContactSystem:
        """Make the harmonic-balance equations at a value of the curve's parameter.

        Each call makes new equations. :meth:`system` keeps the last equations.
        """
        if self.has_varying_integrals:
            return self.problem_at(value).system(self.compliance_model_at(value))
        return ContactSystem(self.compliance_model_at(value), self._contact_integrals)

    def _residual_derivative_by_value(self, value: float, point: ContactPoint) -> np.ndarray:
        """Return the residual's derivative by the curve's parameter: (2H+1, n_pairs).

        ``point`` has the linearised equations at ``value``.
        """
        assert isinstance(point.system.compliance_model, ModalCompliance)
        return point.system.compliance_model.residual_derivative(self.parameter_name, point.force)

    def system(self, value: float) -> ContactSystem:
        """Return the harmonic-balance equations at a parameter value.

        The equations at the last value are kept.
        """
        if self._last_value_and_system is None or self._last_value_and_system[0] != value:
            self._last_value_and_system = value, self._make_system(value)
        return self._last_value_and_system[1]

    def compliance_model_at(self, value: float) -> ModalCompliance:
        """Return the dynamic compliance, from contact forces to gaps, at a parameter value."""
        return self._unvaried_compliance_model

    def omega(self, value: float, unknown: np.ndarray) -> float:
        return self.load_frequency(self.problem, value)

    def unknown(self, state: np.ndarray, value: float) -> np.ndarray:
        """Return the unknowns (2H+1, n_pairs) [m] for the coefficients of a solution.

        ``state`` is a row of :attr:`ResponseCurve.points`, usually of this curve: the row is then
        returned unchanged. On a branch with twice the period the row may belong to the parent
        curve. The motion is then repeated to fill the longer period.
        """
        return stretch_period(state, max(1, self.shape[0] // 2 // max(1, len(state) // 2)))

    # --- what paths require -----------------------------------------------------------------------

    @cached_property
    def compiled_equations(self) -> CompiledEquations | None:
        """Same equations in the C kernel; None without exact contact integrals.

        Also None if the kernel does not know the curve's parameter, or if damping couples modes.
        """
        system = self.system(self.start)
        return self._compile_equations(system) if system.integrals.is_exact else None

    def _compile_equations(self, start_system: ContactSystem) -> CompiledEquations | None:
        """Make the kernel's equations from the equations at the curve's start.

        None: the kernel does not know this parameter.
        """
        return None

    def linearise(self, unknown: np.ndarray, parameter: float) -> ContactPoint:
        value = self.value(parameter)
        value_rate = self.value_rate(value)
        return self.system(value).linearise_with_derivative(
            unknown, lambda point: value_rate * self._residual_derivative_by_value(value, point)
        )

    @property
    def n_time_means(self) -> int:
        """Number of unknowns that are means over time.

        These unknowns come first: a mean for each pair's normal gap, with friction also for each
        tangential gap.
        """
        return int(self.shape[1])

    def rounding(self, parameter: float) -> float:
        """Return the rounding error |F| / |x| of the residual F, for unknowns x.

        The error follows (:func:`residual_rounding`) from :attr:`max_force_slope` times the largest
        row sum of the compliance without the residual flexibility. ``parameter`` is the path
        parameter, 0 to 1.
        """
        if self.compiled_equations is not None:
            max_compliance_row_sum = self.compiled_equations.max_dynamic_row_sum(parameter)
        else:
            dynamic_less_static_compliance = self.system(
                self.value(parameter)
            ).dynamic_less_static_compliance
            max_compliance_row_sum = float(np.abs(dynamic_less_static_compliance).sum(axis=2).max())
        return residual_rounding(4.0 * max_compliance_row_sum * self.max_force_slope)

    def half_period_repetition_error(self, unknown: np.ndarray, parameter: float) -> float:
        """Return a motion's change over half its period, relative to its size.

        The change is twice the norm of the odd harmonics, and is 0 if the motion repeats after half
        a period. ``unknown`` has the gaps' Fourier coefficients (2H+1, n_pairs). ``parameter`` is
        not used here.
        """
        is_odd = (np.arange(self.shape[0]) + 1) // 2 % 2 == 1
        return float(2.0 * np.linalg.norm(unknown[is_odd]) / (np.linalg.norm(unknown) or 1.0))

    def _compile_with_modes(
        self,
        start_system: ContactSystem,
        base_omega_and_change: tuple[float, float],
        damping_factor_and_change: tuple[float, float],
    ) -> CompiledEquations | None:
        """Make the kernel's equations along a frequency or a damping factor.

        Each tuple has the value at the curve's start and the change to its end.
        ``base_omega_and_change`` [rad/s] is the response's frequency. None is returned if damping
        couples modes.
        """
        modal_fields = self._unvaried_compliance_model.modal_fields_for_kernel(
            base_omega_and_change, damping_factor_and_change, self.problem.residual_compliance
        )
        return (
            None
            if modal_fields is None
            else start_system.compile(
                self._unvaried_compliance_model.gap_without_modes, modal_fields
            )
        )


class BalanceAlongFrequency(BalanceEquations):
    """Harmonic-balance equations along the load frequency [rad/s]."""

    parameter_name = "omega"

    @classmethod
    def check_value(cls, structure: Structure, key: str, value: float) -> None:
        check_omega(value, key)

    @classmethod
    def vary_problem(cls, problem: Problem, value: float) -> Problem:
        return replace(problem, omega=value)

    def compliance_model_at(self, value: float) -> ModalCompliance:
        return self._unvaried_compliance_model.with_parameters(value / self.problem.subharmonic)

    @classmethod
    def load_frequency(cls, problem: Problem, value: float) -> float:
        return value

    def _residual_derivative_by_value(self, value: float, point: ContactPoint) -> np.ndarray:
        return super()._residual_derivative_by_value(value, point) / self.problem.subharmonic

    def _compile_equations(self, start_system: ContactSystem) -> CompiledEquations | None:
        base_omega = self.start / self.problem.subharmonic
        base_omega_change = (self.end - self.start) / self.problem.subharmonic
        return self._compile_with_modes(start_system, (base_omega, base_omega_change), (1.0, 0.0))


class _BalanceOfVariedStructure(BalanceEquations):
    """Harmonic-balance equations along a load factor, a damping factor or an added clearance.

    Each is a keyword of :meth:`Structure.varied`; subclasses name the keyword.
    """

    @classmethod
    def check_value(cls, structure: Structure, key: str, value: float) -> None:
        check_number(key, value)

    @classmethod
    def vary_problem(cls, problem: Problem, value: float) -> Problem:
        return replace(problem, structure=problem.structure.varied(**{cls.parameter_name: value}))

    def compliance_model_at(self, value: float) -> ModalCompliance:
        return self._unvaried_compliance_model.with_parameters(
            self.problem.base_omega, **{self.parameter_name: value}
        )

    def _compile_equations(self, start_system: ContactSystem) -> CompiledEquations | None:
        """Make the kernel's equations along a load factor or a clearance.

        The gap without contact is linear in both parameters.
        """
        residual_derivative = self._unvaried_compliance_model.residual_derivative(
            self.parameter_name, np.zeros(start_system.shape)
        )
        linear_gap_rate = -(self.end - self.start) * residual_derivative
        return start_system.compile(
            start_system.linear_gap,
            start_system.dynamic_less_static_compliance,
            linear_gap_rate=linear_gap_rate,
        )


class BalanceAlongLoadFactor(_BalanceOfVariedStructure):
    """Harmonic-balance equations along a factor for the load; a negative factor reverses it."""

    parameter_name = "load"

    @classmethod
    def check_value(cls, structure: Structure, key: str, value: float) -> None:
        super().check_value(structure, key, value)
        if structure.whole.rotation is not None:
            other_parameter_requirement = (
                "another parameter, as the mean load includes the centrifugal force of rotation"
            )
            raise InputError("parameter", "load", other_parameter_requirement)


class BalanceAlongDampingFactor(_BalanceOfVariedStructure):
    """Harmonic-balance equations along a factor for the structure's damping."""

    parameter_name = "damping"

    @classmethod
    def check_value(cls, structure: Structure, key: str, value: float) -> None:
        check_number(key, value, 0.0)
        if structure.damping is None:
            raise InputError(
                "parameter", "damping", "another parameter: the structure has no damping"
            )

    def _compile_equations(self, start_system: ContactSystem) -> CompiledEquations | None:
        damping_factor_and_change = (self.start, self.end - self.start)
        return self._compile_with_modes(
            start_system, (self.problem.base_omega, 0.0), damping_factor_and_change
        )


class BalanceAlongClearance(_BalanceOfVariedStructure):
    """Harmonic-balance equations along a clearance [m] added to every pair."""

    parameter_name = "clearance"


class BalanceAlongStiffnessFactor(BalanceEquations):
    """Harmonic-balance equations along a factor for the contact stiffness.

    Steps are logarithmic: the path parameter is proportional to the factor's logarithm.
    """

    parameter_name, is_logarithmic, has_varying_integrals = "stiffness", True, True

    @classmethod
    def vary_problem(cls, problem: Problem, value: float) -> Problem:
        return replace(problem, contact=problem.contact.scaled(value))

    def _residual_derivative_by_value(self, value: float, point: ContactPoint) -> np.ndarray:
        return (
            multiply_compliance_and_force(
                point.system.dynamic_less_static_compliance,
                point.forces_with_derivatives.log_stiffness_derivative(),
            )
            / value
        )

    def _compile_equations(self, start_system: ContactSystem) -> CompiledEquations:
        return start_system.compile(
            start_system.linear_gap,
            start_system.dynamic_less_static_compliance,
            log_stiffness_rate=self.value_rate(1.0),
        )


class BalanceAlongFrictionFactor(BalanceEquations):
    """Harmonic-balance equations along a factor for the coefficient of friction."""

    parameter_name, has_varying_integrals = "friction", True

    @classmethod
    def vary_problem(cls, problem: Problem, value: float) -> Problem:
        unvaried_friction_law = friction_of(problem.contact)
        if unvaried_friction_law is None:
            raise InputError("parameter", "friction", "another parameter: this law has no friction")
        friction_coefficient = np.multiply(value, unvaried_friction_law.coefficient)
        return replace(
            problem, contact=replace(unvaried_friction_law, coefficient=friction_coefficient)
        )

    def _residual_derivative_by_value(self, value: float, point: ContactPoint) -> np.ndarray:
        return residual_friction_scale_derivative(point) / value


class BalanceAlongSpeed(BalanceEquations):
    """Harmonic-balance equations along a rotor speed [rad/s].

    The load frequency keeps its ratio to the speed. The modes change with the speed. The residual's
    derivative by the speed is a central difference. The speed also changes the quasi-static part of
    the compliance, and with it the sets of closed pairs.
    """

    parameter_name, has_varying_integrals = "speed", True

    @classmethod
    def check_value(cls, structure: Structure, key: str, value: float) -> None:
        super().check_value(structure, key, value)
        require_run_up_structure(structure)

    @classmethod
    def vary_problem(cls, problem: Problem, value: float) -> Problem:
        structure = require_run_up_structure(problem.structure).at_speed(value)
        return replace(problem, structure=structure, omega=cls.load_frequency(problem, value))

    @classmethod
    def load_frequency(cls, problem: Problem, value: float) -> float:
        return problem.omega * value / require_run_up_structure(problem.structure).speed

    def _common_cutoff(self, problem: Problem, start: float, end: float) -> float:
        """Return the frequency above which modes are quasi-static on the whole curve [rad/s].

        A mode whose frequency crosses the cutoff would become quasi-static on the way. So the
        cutoff lies between two successive modes. At start, middle and end of the curve, one mode
        stays below the cutoff and the other above. If there are no such modes, the result is the
        larger of the cutoffs at start and end.
        """
        cutoff_lower_bound = super()._common_cutoff(problem, start, end)
        run_up_structure = require_run_up_structure(problem.structure)
        speeds = start, 0.5 * (start + end), end
        natural_frequencies = np.array([run_up_structure.at_speed(speed).omega for speed in speeds])
        lower_mode_max_over_speeds = natural_frequencies.max(axis=0)[:-1]
        upper_mode_min_over_speeds = natural_frequencies.min(axis=0)[1:]
        can_hold_cutoff = (upper_mode_min_over_speeds > cutoff_lower_bound) & (
            upper_mode_min_over_speeds > lower_mode_max_over_speeds * (1.0 + 1e-6)
        )
        possible_cutoffs = np.sqrt(lower_mode_max_over_speeds * upper_mode_min_over_speeds)[
            can_hold_cutoff
        ]
        return float(max([cutoff_lower_bound, *possible_cutoffs[:1]]))

    def compliance_model_at(self, value: float) -> ModalCompliance:
        problem = self.problem_at(value)
        return ModalCompliance(
            problem.structure_with_pair_per_row, problem.base_omega, problem.load
        )

    def _residual_derivative_by_value(self, value: float, point: ContactPoint) -> np.ndarray:
        speed_step = CENTRAL_DIFFERENCE_STEP * value
        residuals_at_both_speeds = (
            self._make_system(speed).linearise(point.unknown).residual
            for speed in (value - speed_step, value + speed_step)
        )
        residual_at_lower_speed, residual_at_upper_speed = residuals_at_both_speeds
        return np.asarray((residual_at_upper_speed - residual_at_lower_speed) / (2.0 * speed_step))


def require_run_up_structure(structure: Structure) -> RunUpStructure:
    """Return the structure if it has modes at every speed, else raise InputError.

    Such a structure comes from :func:`fenics_crack.run_up_structure`.
    """
    if not isinstance(structure, RunUpStructure):
        run_up_structure_requirement = (
            "a structure as fc.run_up_structure(structure, start, stop, modes) returns"
        )
        raise InputError("structure", repr(structure), run_up_structure_requirement)
    return structure


class BalanceAlongVibratingLoadFactor(BalanceEquations):
    """Harmonic-balance equations at a phase resonance, along a factor for the vibrating load.

    The mean load is not multiplied. The load frequency follows the resonance
    (:class:`ResonanceSystem`); these equations hold at a constant frequency.
    """

    parameter_name = "resonance"

    @classmethod
    def vary_problem(cls, problem: Problem, value: float) -> Problem:
        load_weight_matrix = value * np.eye(len(problem.structure.force))
        load_weight_matrix[0, 0] = 1.0
        return replace(problem, structure=problem.structure.varied(load=load_weight_matrix))


EQUATIONS_CLASS_BY_PARAMETER: dict[str, type[BalanceEquations]] = {
    equations_class.parameter_name: equations_class
    for equations_class in (
        BalanceAlongFrequency,
        BalanceAlongLoadFactor,
        BalanceAlongStiffnessFactor,
        BalanceAlongDampingFactor,
        BalanceAlongClearance,
        BalanceAlongFrictionFactor,
        BalanceAlongSpeed,
        BalanceAlongVibratingLoadFactor,
    )
}
"""Class of the harmonic-balance equations for each name in :attr:`ResponseCurve.parameter`."""
