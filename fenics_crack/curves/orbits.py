"""Periodic orbits of exact flows along one parameter of a curve:

    F(x, p) = scale (z(T; x, v) - z(0)) = 0.

z = (q, q') is the state at phase zero of the load: modal amplitudes and velocities. The period
T = 2 pi m / omega has m load periods. v is a parameter of :mod:`balance_equations`. The unknowns

    x = scale z(0) - x_0 - p x_1

are relative to rest: x_0 and x_0 + x_1 are the rest states under the mean load at the start and at
the end. Steps are thus relative to the motion; otherwise, a large preload could hide a resonance.
dF/dx = M - I, with the monodromy matrix M in the unknowns.

Over the load's frequency, its factor, the damping and the clearance, the kernel has the equations,
and all points of a path share one flow. Over the contact stiffness, the friction and a rotor's
speed, and with friction over the damping, each point has its own flow.

dF/dp is exact, except over the speed. Forces are continuous, so dF/dp is the variation of the
motion. Over damping and stiffness

    dq'' + C dq' + Lambda dq + P_A S P_A^T dq = -C' q' + P_A S D' lambda_A.

C is the modal damping, Lambda has the squares of the natural frequencies, and P_A^T takes modal
amplitudes to the gaps of the closed pairs A. C' and D' are derivatives by p, and S = (D_AA)^-1 with
the compliance D of the pairs. Over the speed the modes change, and dF/dp is a one-sided difference
with one more flow per point. The same holds with friction over damping, stiffness and the
coefficient of friction.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg

from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.curves.balance_equations import EQUATIONS_CLASS_BY_PARAMETER, BalanceEquations
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.orbit_events import (
    MultiplierStepControl,
    NeimarkSacker,
    PeriodDoubling,
    leading_multipliers_and_counts,
)
from fenics_crack.motion.flow import ContactFlow, IntegratedMotion, as_doubles, exact_flow_or_error
from fenics_crack.motion.shooting import OrbitPoint, ShootingEquations
from fenics_crack.numerics.equations import MACHINE_EPSILON, ROUNDING
from fenics_crack.numerics.path import BranchPoint, Fold

FORWARD_PARAMETER_STEP = math.sqrt(MACHINE_EPSILON)
"""Step in the path parameter, 0 to 1, for one-sided differences: 1.5e-8.

Truncation and rounding error are then about equal.
"""


class OrbitEquations(CurveSystem):
    """Equations of exact periodic orbits along a curve's parameter.

        F(x, p) = scale (z(T) - z(0)) = 0

    z is the state of modal displacements and velocities, T the orbit's period of ``subharmonic``
    load periods, and p the path parameter, 0 to 1. The unknowns x are the scaled state z(0) less
    the rest state. ``balance_class``, the class of harmonic-balance equations along the same
    parameter, varies the problem here.

    Raises
    ------
    InputError
        Structure and law have no exact flow.
    """

    event_classes = (Fold, BranchPoint, PeriodDoubling, NeimarkSacker)

    def __init__(self, problem: Problem, parameter: str, start: float, end: float) -> None:
        self.problem, self.parameter_name, self.start, self.end = problem, parameter, start, end
        self.balance_class = EQUATIONS_CLASS_BY_PARAMETER[parameter]
        self.is_logarithmic = self.balance_class.is_logarithmic
        self.subharmonic = problem.subharmonic
        self._flow_at_start = self._make_flow(start)
        self._last_value_and_flow: tuple[float, ContactFlow] = start, self._flow_at_start
        self.shape = (self._flow_at_start.state_size,)

    def problem_at(self, value: float) -> Problem:
        """Return the problem at a value of the curve's parameter."""
        return self.balance_class.vary_problem(self.problem, value)

    def omega(self, value: float, unknown: np.ndarray | None = None) -> float:
        return self.balance_class.load_frequency(self.problem, value)

    def _make_flow(self, value: float) -> ContactFlow:
        """Make the exact flow of the problem at a parameter value."""
        problem = self.problem_at(value)
        return exact_flow_or_error(problem.structure, problem.contact)

    def flow(self, value: float) -> ContactFlow:
        """Return the exact flow at a parameter value.

        The flows at the curve's start and at the last requested value are kept for later calls.
        """
        if self.parameter_name == "omega" or value == self.start:
            return self._flow_at_start
        if self._last_value_and_flow[0] != value:
            self._last_value_and_flow = value, self._make_flow(value)
        return self._last_value_and_flow[1]

    @cached_property
    def state_factors(self) -> np.ndarray:
        """Scale factors from states z to unknowns x: (n_unknowns,).

        The factors are 1 for modal displacements, and 1 / w for modal velocities. w is the mode's
        frequency, but at least the response's frequency.
        """
        return self._flow_at_start.amplitude_weights(self.omega(self.start) / self.subharmonic)

    @property
    def n_record_entries(self) -> int:
        """Number of entries in the record at a point, a monodromy matrix."""
        return self.n_unknowns**2

    @property
    def max_path_points_per_call(self) -> int:
        # Monodromy matrices with 8192 entries together: matrices after a rejected step are lost,
        # and a few large matrices outweigh the time between calls.
        return 2**13 // self.n_record_entries

    def make_step_control(self, longest_step: float) -> MultiplierStepControl:
        return MultiplierStepControl(longest_step)

    @cached_property
    def _scaled_rest_state_and_change_along_curve(self) -> np.ndarray:
        """Scaled rest state under the mean load, and its change: (2, n_unknowns).

        The first row is the rest state at the curve's start, the second the change to the end.
        """
        start_rest_state, end_rest_state = (
            self._scale_state(self.flow(value).rest_state, value)
            for value in (self.start, self.end)
        )
        return np.array([start_rest_state, end_rest_state - start_rest_state])

    def unscaled_solution(self, unknown: np.ndarray, value: float) -> np.ndarray:
        """Return the state at phase zero for unknowns x at a parameter value.

        The state has modal displacements, then velocities; with friction also the sliders'
        positions.
        """
        state = (unknown + self._scaled_rest_state(value)) / self.state_factors
        if self.parameter_name == "speed":
            state = state @ self._matrix_from_start_modes_to_modes_at(value).T
        return np.asarray(state)

    def unknown(self, state: np.ndarray, value: float) -> np.ndarray:
        """Return the unknowns x, scaled and less the rest state, for a state.

        ``value`` is the curve's parameter.
        """
        return self._scale_state(state, value) - self._scaled_rest_state(value)

    def _scale_state(self, state: np.ndarray, value: float) -> np.ndarray:
        """Return a state times the scale factors; the rest state is not subtracted.

        ``value`` is the curve's parameter. If the parameter is the rotor speed, the state is first
        converted to the modes at the curve's start.
        """
        if self.parameter_name == "speed":
            state = np.linalg.solve(self._matrix_from_start_modes_to_modes_at(value), state)
        return np.asarray(state * self.state_factors)

    def _scaled_rest_state(self, value: float) -> np.ndarray:
        """Return the scaled rest state under the mean load at a parameter value: (n_unknowns,).

        The state is interpolated linearly in the path parameter between start and end of the curve.
        """
        rest_state_at_start, rest_state_change_along_curve = (
            self._scaled_rest_state_and_change_along_curve
        )
        return np.asarray(
            rest_state_at_start + self.parameter(value) * rest_state_change_along_curve
        )

    def _matrix_from_start_modes_to_modes_at(self, value: float) -> np.ndarray:
        """Return the matrix that converts a state to the modes at another rotor speed.

        A state has modal displacements and velocities, and the rotor speed changes the modes. The
        matrix converts a state from the modes at the curve's start to the modes at the speed
        ``value`` [rad/s]. With friction, slider positions stay. The shape is (n_unknowns,
        n_unknowns).
        """
        modal_basis_change = (
            self.flow(value).modal_model.shapes_inverse @ self._flow_at_start.modal_model.shapes
        )
        friction_identity = np.eye(self._flow_at_start.state_size - 2 * self._flow_at_start.n_modes)
        return scipy.linalg.block_diag(modal_basis_change, modal_basis_change, friction_identity)

    def _advance_motion(
        self, unknown: np.ndarray, parameter: float, period_fraction: float = 1.0
    ) -> IntegratedMotion:
        """Integrate the motion from unknowns at phase zero, over a fraction of the period.

        ``parameter`` is the path parameter, 0 to 1.
        """
        value = self.value(parameter)
        omega, start_state = self.omega(value), self.unscaled_solution(unknown, value)
        orbit_period = 2.0 * np.pi * self.subharmonic / omega
        return self.flow(value).advance(start_state, omega, period_fraction * orbit_period)

    def advance_unknown(
        self, unknown: np.ndarray, parameter: float, period_fraction: float = 1.0
    ) -> np.ndarray:
        """Return the unknowns x (n_unknowns,) after a fraction of the period.

        ``unknown`` is the start at phase zero, ``parameter`` the path parameter, 0 to 1.
        """
        state_after_fraction = self._advance_motion(unknown, parameter, period_fraction).state
        return self.unknown(state_after_fraction, self.value(parameter))

    def half_period_repetition_error(self, unknown: np.ndarray, parameter: float) -> float:
        """Return an orbit's change over half its period, relative to its size.

        The change is near 0 if the motion has half the period. ``unknown`` is the scaled state,
        ``parameter`` the path parameter, 0 to 1.
        """
        unknown_change = self.advance_unknown(unknown, parameter, 0.5) - unknown
        return float(np.linalg.norm(unknown_change) / (np.linalg.norm(unknown) or 1.0))

    # --- what paths require -----------------------------------------------------------------------

    @cached_property
    def compiled_equations(self) -> ShootingEquations | None:
        """The same equations in the faster C kernel, or None if the kernel lacks them.

        The kernel has no equations along contact stiffness, rotor speed and friction coefficient.
        With friction, it has no equations along the damping either.
        """
        parameter_is_damping = self.parameter_name == "damping"
        # With friction, the places where pairs stick depend on the damping, too.
        if self.parameter_name in ("stiffness", "speed", "friction") or (
            parameter_is_damping and self._flow_at_start.friction_law
        ):
            return None
        omega_and_change = self.omega(self.start), self.omega(self.end) - self.omega(self.start)
        kernel_flow = start_flow = self._flow_at_start
        kernel_fields: dict[str, Any] = (
            {"rest_states": self._scaled_rest_state_and_change_along_curve}
            if self._scaled_rest_state_and_change_along_curve.any()
            else {}
        )
        if self.parameter_name != "omega":
            end_flow = self.flow(self.end)
            # The kernel changes this flow, so it is not shared.
            kernel_flow = self._make_flow(
                max(self.start, self.end) if parameter_is_damping else self.start
            )
            if parameter_is_damping:
                damping_change = end_flow.modal_model.damping - start_flow.modal_model.damping
                start_damping = start_flow.modal_model.damping
                kernel_fields |= {
                    "damping": as_doubles(start_damping),
                    "n_damping": start_damping.size,
                }
                kernel_fields["damping_rate"] = as_doubles(damping_change)
            else:
                modal_load_change = end_flow.modal_load - start_flow.modal_load
                load_gap_change = (
                    end_flow.massless_load_gap_less_clearance
                    - start_flow.massless_load_gap_less_clearance
                )
                kernel_fields |= {"force": kernel_flow.modal_load, "force_rate": modal_load_change}
                kernel_fields |= {
                    "gap": kernel_flow.massless_load_gap_less_clearance,
                    "gap_rate": load_gap_change,
                }
        return ShootingEquations(
            kernel_flow, self.state_factors, omega_and_change, self.subharmonic, **kernel_fields
        )

    def rounding(self, parameter: float) -> float:
        """Return the rounding error |F| / |x| of the residual F, for unknowns x.

        The error is 1e-12 at any ``parameter``.
        """
        return ROUNDING

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """Evaluate the orbit equations and their derivatives at a point.

        ``unknown`` is the scaled state x, ``parameter`` the path parameter, 0 to 1.

        Raises
        ------
        ConvergenceError
            The motion needs more Taylor pieces or events than the budget allows, or is not finite.
        """
        if self.compiled_equations is not None:
            return self.compiled_equations.linearise(unknown, parameter)
        try:
            motion = self._advance_motion(unknown, parameter)
        except InputError as error:  # Newton's method left the allowed parameters
            raise ConvergenceError(str(error)) from None
        value = self.value(parameter)
        residual = self.unknown(motion.state, value) - unknown

        def monodromy() -> np.ndarray:
            """Return the monodromy matrix in the unknowns: (n_unknowns, n_unknowns)."""
            tangent_matrix = motion.track.derivative_of_end_state
            if self.parameter_name == "speed":
                matrix_from_start_modes = self._matrix_from_start_modes_to_modes_at(value)
                tangent_matrix = np.linalg.solve(
                    matrix_from_start_modes, tangent_matrix @ matrix_from_start_modes
                )
            return np.asarray(self.state_factors[:, None] * tangent_matrix / self.state_factors)

        def by_parameter() -> np.ndarray:
            """Return the residual's derivative by the path parameter: (n_unknowns,)."""
            if self.parameter_name == "speed" or self._flow_at_start.friction_law:
                parameter_step = (
                    FORWARD_PARAMETER_STEP if parameter < 0.5 else -FORWARD_PARAMETER_STEP
                )
                return (
                    self.advance_unknown(unknown, parameter + parameter_step) - unknown - residual
                ) / parameter_step
            start_state = self.unscaled_solution(unknown, value)
            softness_derivative_by_parameter = (
                -self.value_rate(value) / value * motion.track.flow.contact_spring_compliance
            )
            unknown_derivative_by_softness = (
                self.state_factors
                * motion.track.derivative_by_softness(start_state, softness_derivative_by_parameter)
            )
            rest_state_change_along_curve = self._scaled_rest_state_and_change_along_curve[1]
            return np.asarray(
                unknown_derivative_by_softness
                + monodromy() @ rest_state_change_along_curve
                - rest_state_change_along_curve
            )

        n_events, n_taylor_pieces = motion.n_events, motion.n_taylor_pieces
        return OrbitPoint(unknown, residual, monodromy, by_parameter, n_events, n_taylor_pieces)

    def step_control_values(self, records: np.ndarray) -> np.ndarray:
        """Return Floquet multipliers and three counts at each point: (n_points, k + 3) complex.

        ``records`` (n_points, n_unknowns^2) are monodromy matrices. First come the k =
        min(n_unknowns, 8) multipliers with the largest modulus. The counts are the real ones above
        1, the real ones below -1, and the complex pairs outside the unit circle.
        """
        return leading_multipliers_and_counts(
            np.linalg.eigvals(records.reshape(-1, self.n_unknowns, self.n_unknowns))
        )


def system_along(
    is_exact: bool, problem: Problem, parameter: str, start: float, end: float
) -> BalanceEquations | OrbitEquations:
    """Return the equations along a parameter, from ``start`` to ``end``.

    ``is_exact`` chooses exact orbits, else harmonic balance.
    """
    if is_exact:
        return OrbitEquations(problem, parameter, start, end)
    return EQUATIONS_CLASS_BY_PARAMETER[parameter](problem, start, end)
