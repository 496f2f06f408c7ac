"""Direct integration in time along the flows of small structures.

:func:`integrate_events` follows the exact flow from one switching instant to the next
(:mod:`fenics_crack.motion.flow`). :func:`integrate_exponential` takes exponential steps of equal
length. The state z = (q, q') has modal displacements and velocities less the steady response to the
load, a closed form. With the contact forces lambda and modal forces P lambda:

    z' = A z - [0, P]^T lambda(t).

A step of length h is exact for a force that is constant over the step, here the mean of the forces
at both ends,

    z_{n+1} = E z_n - Gamma (lambda_n + lambda_{n+1}),        E = exp(A h),

where 2 Gamma is the response to constant unit forces. The matrix Q takes a state to its gaps, and
R_inf is the residual flexibility. The gap at the end of the step is linear in the forces there,

    g_{n+1} = s_free - (R_inf + Q Gamma) lambda_{n+1},

so that 0 <= lambda and (R_inf + I/kappa + Q Gamma) lambda - s_free >= 0, complementary. Here kappa
is the stiffness of the pairs, and s_free the gap at the end of the step with lambda_{n+1} = 0. As
long as the set of closed pairs does not change, lambda_{n+1} is the product of a stored matrix with
s_free. Modes that damping leaves uncoupled advance one by one, so a step costs little more than
2 n_modes n_pairs multiplications (``kernel/march.c``). The scheme is of second order in h, and
exact without contact.

The work of a constant force is known exactly. So a step between equal sets of closed pairs creates
no energy, however long it is. A step in which a pair opens creates 1/2 lambda_n times the opening,
and a step in which a pair closes loses as much. R_inf softens contact; with hardly any R_inf and
long steps a motion can grow, and the integration reports it. (Forces that are linear over a step
would create energy in every step: for crack faces with mass this is the linear-acceleration
method.)

Source: Hochbruck and Ostermann, Acta Numerica 19 (2010) 209 (exponential integrators).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import Struct, kernel, pointer, require_shape
from fenics_crack.model.contact import (
    ActiveSetSolver,
    ContactLaw,
    FrictionContactSolver,
    friction_coefficient_of,
    law_of_rows,
)
from fenics_crack.model.modes import multiply_columns
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import (
    ModalFlow,
    as_doubles,
    check_has_exact_flow,
    exact_flow_or_error,
)
from fenics_crack.numerics.fourier import differentiate, fourier_basis_for, from_complex, to_complex
from fenics_crack.time.march import MarchRequest, PeriodWindow, Scheme, TimeHistory, march

EXPONENTIAL_REMEDY = (
    "take more steps per period (steps_per_period), or keep fewer modes (reduction.modes), which "
    "makes the contact softer"
)
"""Remedy in errors of equal exponential steps."""


def integrate_events(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int = 256,
    **options: Any,
) -> TimeHistory:
    """Integrate exactly, without time steps, from one contact event to the next.

    At an event a contact pair opens, closes, sticks or slips.

    Parameters
    ----------
    structure : Structure
        At most 600 dofs; reduce a larger one first.
    omega : float [rad/s]
        Angular frequency of the load.
    contact : UnilateralPenalty, UnilateralConstraint or CoulombFriction of one of them
        Law of all pairs. UnilateralConstraint: crack faces must have no mass.
    periods : int
        Load periods to integrate.
    steps_per_period : int
        Instants recorded in a period; they do not change the motion.
    **options
        - initial: state at time 0, as a solution or arrays (displacement, velocity); default: rest.
        - settle: stop early below this relative change from period to period; 0: never.
        - record_periods: number of last periods to keep; default: all.
        - dofs: dofs whose displacements are recorded; default: all.
        - progress: show a progress bar.

        :class:`fenics_crack.time.march.MarchRequest` describes them further.

    Returns
    -------
    TimeHistory
        The last periods, sampled at equal steps.

    Raises
    ------
    InputError
        The structure is too large, its crack faces have mass under rigid contact, or an argument
        cannot be used.
    ConvergenceError
        Pairs open and close without end at an instant. Or the highest modes are too fast: a load
        period needs more than 100,000 Taylor series.

    Examples
    --------
    >>> history = fc.integrate_events(structure, 2000.0, contact, periods=2, initial=solution)
    """
    request_arguments = structure, omega, contact, periods, steps_per_period
    request = MarchRequest.from_call(integrate_events, options, *request_arguments)
    return march(request, _EventScheme(request))


def integrate_exponential(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int = 512,
    **options: Any,
) -> TimeHistory:
    """Integrate by exact exponential steps, under the penalty law or without penetration.

        z_{n+1} = E z_n - Gamma (lambda_n + lambda_{n+1}),        E = exp(A h),

    The state z holds modal displacements and velocities less the steady response to the load; A is
    the matrix in z' = A z without contact. lambda are the contact forces, and 2 Gamma is the change
    of z by constant unit forces over a step of length h.

    Parameters
    ----------
    structure : Structure
        At most 600 dofs; reduce a larger one first. Under UnilateralConstraint crack faces must
        have no mass (``reduce_structure(method="massless")``).
    omega : float [rad/s]
        Angular frequency of the load.
    contact : UnilateralPenalty, UnilateralConstraint or CoulombFriction of one of them
        Law of all pairs.
    periods : int
        Load periods to integrate.
    steps_per_period : int
        Steps in one load period; the error falls with their square.
    **options
        - initial: state at time 0, as a solution or arrays (displacement, velocity); default: rest.
        - settle: stop early below this relative change from period to period; 0: never.
        - record_periods: number of last periods to keep; default: all.
        - dofs: dofs whose displacements are recorded; default: all.
        - progress: show a progress bar.

        :class:`fenics_crack.time.march.MarchRequest` describes them further.

    Returns
    -------
    TimeHistory
        The last periods. ``created_energy`` is the remainder of the energy balance, computed by the
        trapezoidal rule. A step in which no pair opens or closes creates none. A step in which a
        pair opens creates half the pair's last force times its opening; large if the residual
        flexibility is small.

    Raises
    ------
    InputError
        The structure is too large, its pairs with mass are rigid, or an argument cannot be used.
    ConvergenceError
        The load is on an undamped resonance, or the contact forces of a step were not found. Or
        contact creates more than twice the energy from the load and the initial state.

    Examples
    --------
    >>> history = fc.integrate_exponential(structure, 2000.0, contact, periods=2)
    """
    request_arguments = structure, omega, contact, periods, steps_per_period
    request = MarchRequest.from_call(integrate_exponential, options, *request_arguments)
    return march(request, _ExponentialScheme(request))


# --- the schemes ----------------------------------------------------------------------------------


def _comparison_weights_of_loaded_dofs(request: MarchRequest) -> np.ndarray:
    """Return a factor for each loaded dof or modal coordinate: (n_loaded,).

    Used to compare the motion at the load from period to period: each displacement is multiplied by
    a factor first. With massless crack faces the coordinates are modal. The factor is then the norm
    of the coordinate's load coefficients over all harmonics. For displacements the factor is 1.
    """
    if not request.structure.has_massless_crack_faces:
        return np.ones(len(request.loaded_dofs))
    return np.asarray(np.linalg.norm(request.structure.force[:, request.loaded_dofs], axis=0))


def _displacement_and_velocity(
    flow: ModalFlow, displacement: np.ndarray, state: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return displacement [m] and velocity [m/s], (n_dofs,) each, as copies.

    With friction a third array (n_pairs,) [m] follows: the tangential gaps at which pairs stick.

    Parameters
    ----------
    flow : ModalFlow
        Flow with the modes.
    displacement : (n_dofs,) [m]
        Displacement, returned unchanged.
    state : (state_size,)
        State of the flow at the same instant: modal displacements, modal velocities, and with
        friction the sticking places.
    """
    _, modal_velocity, sticking_places = np.split(state, [flow.n_modes, 2 * flow.n_modes])
    velocity = flow.modal_model.shapes @ modal_velocity
    optional_sticking_places = (sticking_places.copy(),) if flow.friction_law else ()
    return displacement.copy(), velocity, *optional_sticking_places


class _EventScheme(Scheme):
    """Integrate by the exact flow between contact events, one load period at a time."""

    name = "events"

    def __init__(self, request: MarchRequest) -> None:
        self._request, self._flow = request, exact_flow_or_error(request.structure, request.contact)
        self._period = 2.0 * np.pi / request.omega
        period_fractions = np.arange(request.steps_per_period + 1) / request.steps_per_period
        self._instants = period_fractions * self._period
        self._state = self._flow.state(*request.start_state)

    def integrate_and_fill_period(self, window: PeriodWindow, period_number: int) -> None:
        request = self._request
        period_motion = self._flow.advance(
            self._state, request.omega, self._period, instants=self._instants
        )
        self._state, sampled_motion = period_motion.state, period_motion.samples
        displacement_samples = sampled_motion.displacement
        self._end_displacement = displacement_samples[-1]
        window.gap[:] = sampled_motion.contact_row_gaps[:-1]
        window.force[:] = sampled_motion.contact_row_forces[:-1]
        window.recorded_displacement[:] = displacement_samples[:-1, request.recorded_dofs]
        window.displacement_at_load[:] = displacement_samples[
            :-1, request.loaded_dofs
        ] * _comparison_weights_of_loaded_dofs(request)

    def final_state_parts(self) -> tuple[np.ndarray, ...]:
        return _displacement_and_velocity(self._flow, self._end_displacement, self._state)


class ExponentialFlow(ModalFlow):
    """Advance a structure's motion by equal exponential steps at one load frequency.

    Attributes
    ----------
    omega : float [rad/s]
        Angular frequency of the load.
    steps_per_period : int
        Number of steps in one load period.
    step_size : float [s]
        Length h of a step.
    state_to_gap_matrix : (n_rows, 2 n_modes)
        Matrix Q from modal displacements and velocities to gaps.
    steady_states : (N, 2 n_modes)
        Modal displacements and velocities of the steady response to the load without contact, at
        the N = ``steps_per_period`` instants of a period.
    linear_gap : (N, n_rows) [m]
        Gaps under the steady response, less the clearance.
    """

    def __init__(
        self, structure: Structure, omega: float, contact: ContactLaw, steps_per_period: int
    ) -> None:
        check_has_exact_flow(structure, contact)
        super().__init__(structure, contact)
        self.omega, self.steps_per_period, self.step_size = (
            omega,
            steps_per_period,
            2.0 * np.pi / omega / steps_per_period,
        )
        modes, (n_modes, n_rows) = self.modal_model, self.modal_model.gaps_by_mode.shape
        transition_by_step, force_response = modes.transition_and_force_response(self.step_size)
        half_of_response_to_unit_force = 0.5 * force_response  # Gamma
        gap_response = modes.gaps_by_mode.T @ half_of_response_to_unit_force[:n_modes]
        self.state_to_gap_matrix = np.hstack([modes.gaps_by_mode.T, np.zeros((n_rows, n_modes))])
        enumerated_loads = enumerate(to_complex(self.modal_load))
        response_harmonics = [
            modes.steady_modal_amplitudes(harmonic_order * omega, load_harmonic)
            for harmonic_order, load_harmonic in enumerated_loads
        ]
        displacement_coefficients = from_complex(np.array(response_harmonics))
        basis_at_instants = fourier_basis_for(
            self.modal_load, 2.0 * np.pi * np.arange(steps_per_period) / steps_per_period
        )
        self.steady_states = basis_at_instants @ np.hstack(
            [displacement_coefficients, differentiate(displacement_coefficients, omega)]
        )
        self.linear_gap = basis_at_instants @ (
            displacement_coefficients @ modes.gaps_by_mode + self.massless_load_gap_less_clearance
        )
        step_compliance = self.compliance + gap_response
        contact_struct_members: dict[str, Any]
        friction_coefficient = friction_coefficient_of(law_of_rows(contact, structure.n_pairs))
        if friction_coefficient is None:
            self._initial_contact_solver = ActiveSetSolver(self.compliance)
            contact_struct_members = {"contact_solver": ActiveSetSolver(step_compliance).handle}
        else:
            self._friction_solver_at_first_instant = FrictionContactSolver(
                self.compliance, friction_coefficient
            )
            self._sticking_tangential_gaps = np.empty(n_rows // 2)
            self._friction_solver = FrictionContactSolver(step_compliance, friction_coefficient)
            contact_struct_members = {
                "friction_solver": self._friction_solver.handle,
                "sticking_places": self._sticking_tangential_gaps,
            }
        self._kernel_struct = Struct(
            "exponential", n_modes=n_modes, n_rows=n_rows, n_instants=steps_per_period,
            has_coupled_modes=modes.damping.ndim == 2, transition=transition_by_step,
            gap_rows=as_doubles(modes.gaps_by_mode.T),
            force_response=as_doubles(half_of_response_to_unit_force.T),
            gap_response=as_doubles(gap_response),
            steady_gap=self.linear_gap, steady_states=self.steady_states,
            work=np.empty(4 * n_modes + 2 * n_rows),
            **contact_struct_members,
        )  # fmt: skip

    def displacement_from_phase_zero(
        self, states: np.ndarray, force: np.ndarray, dofs: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Return the structure's displacement at n successive instants: (n, n_dofs) [m].

        The first instant has the load's phase 0, and instants are a step apart. ``states`` (n, 2
        n_modes) are modal displacements and velocities, ``force`` (n, n_rows) [N] contact forces.
        ``dofs`` are the dofs to return; default: all.
        """
        phases = 2.0 * np.pi * np.arange(len(states)) / self.steps_per_period
        return self.displacement(states, force, phases, dofs)

    def advance(self, state: np.ndarray, periods: int = 1) -> ExponentialMotion:
        """Integrate whole load periods from a state at the load's phase 0.

        ``state`` (state_size,) has modal displacements, modal velocities and, with friction, the
        tangential gaps at which pairs stick.

        Raises
        ------
        ConvergenceError
            The contact forces of a step were not found.
        """
        n_modal_states = 2 * self.n_modes
        n_pairs = self.n_normal_rows
        n_requested_steps = periods * self.steps_per_period
        state, sticking_places = np.split(require_shape(state, self.state_size), [n_modal_states])
        modal_states = np.empty((n_requested_steps + 1, n_modal_states))
        contact_forces = np.empty((n_requested_steps + 1, len(self.contact_spring_compliance)))
        pair_states = np.empty((n_requested_steps + 1, n_pairs), dtype=np.int8)
        modal_states[0] = state
        initial_gap = (
            self.state_to_gap_matrix @ (state - self.steady_states[0]) + self.linear_gap[0]
        )
        if self.friction_law:
            contact_forces[:1], pair_states[:1], new_sticking_places, _ = (
                self._friction_solver_at_first_instant.solve(initial_gap[None], sticking_places)
            )
            self._sticking_tangential_gaps[:] = new_sticking_places[0]
        else:
            contact_forces[:1], pair_states[:1] = self._initial_contact_solver.solve(
                initial_gap[None]
            )
        array_pointers = map(pointer, (modal_states, contact_forces, pair_states))
        n_steps_made = kernel.march_exponential(
            self._kernel_struct.address, n_requested_steps, *array_pointers
        )
        if n_steps_made < n_requested_steps:
            raise ConvergenceError(
                f"exponential: no contact forces were found at step {n_steps_made + 1}; "
                f"{EXPONENTIAL_REMEDY}"
            )
        sticking_places = (
            self._sticking_tangential_gaps.copy() if self.friction_law else sticking_places
        )
        return ExponentialMotion(
            self,
            modal_states,
            contact_forces,
            pair_states > 0,
            np.append(modal_states[-1], sticking_places),
        )


@dataclass(frozen=True)
class ExponentialMotion:
    """States and contact forces at the N + 1 instants of integrated load periods.

    Attributes
    ----------
    flow : ExponentialFlow
        Flow that made the steps; it has the step length.
    states : (N + 1, 2 n_modes)
        Modal displacements and velocities, both ends included.
    contact_forces_at_instants : (N + 1, n_rows) [N]
        Contact forces; with friction the tangential ones are the second half.
    is_closed : (N + 1, flow.n_normal_rows) bool
        True if a row is in contact.
    end_state : (state_size,)
        Modal displacements, modal velocities and sticking places at the end, to continue from.
    """

    flow: ExponentialFlow
    states: np.ndarray
    contact_forces_at_instants: np.ndarray
    is_closed: np.ndarray
    end_state: np.ndarray

    @property
    def gaps(self) -> np.ndarray:
        """Gaps at all instants, g > 0 if crack faces penetrate: (N + 1, n_rows) [m]."""
        flow = self.flow
        instant_indices_in_period = np.arange(len(self.states)) % flow.steps_per_period
        transient_gap = (
            self.states - flow.steady_states[instant_indices_in_period]
        ) @ flow.state_to_gap_matrix.T
        return np.asarray(
            transient_gap
            + flow.linear_gap[instant_indices_in_period]
            - self.contact_forces_at_instants @ flow.residual_flexibility
        )

    @property
    def friction_loss(self) -> float:
        """Energy dissipated by friction over all steps [J]; 0 without friction.

        A step dissipates the mean friction force times the change of the sticking place, summed
        over pairs. A sticking place is the tangential gap less the tangential spring's deformation.
        """
        flow, n_pairs = self.flow, self.flow.n_normal_rows
        if not flow.friction_law:
            return 0.0
        friction_force = self.contact_forces_at_instants[:, n_pairs:]
        sticking_places = (
            self.gaps[:, n_pairs:] - flow.contact_spring_compliance[n_pairs:] * friction_force
        )
        return float(
            np.sum(
                0.5 * (friction_force[1:] + friction_force[:-1]) * np.diff(sticking_places, axis=0)
            )
        )


class _ExponentialScheme(Scheme):
    """Integrate by equal exponential steps, one load period at a time, with energy balance."""

    name = "exponential"
    remedy = EXPONENTIAL_REMEDY

    def __init__(self, request: MarchRequest) -> None:
        self._request, steps_per_period = request, request.steps_per_period
        self._flow = ExponentialFlow(
            request.structure, request.omega, request.contact, steps_per_period
        )
        self._state = self._flow.state(*request.start_state)
        # The load does the work of its mean over a step, the trapezoidal rule.
        self._mean_load_over_step = 0.5 * (
            request.load_samples + np.roll(request.load_samples, -1, axis=0)
        )
        self._energy_input = self._losses_less_energy_input = 0.0

    def integrate_and_fill_period(self, window: PeriodWindow, period_number: int) -> None:
        flow, request = self._flow, self._request
        exponential_motion = flow.advance(self._state)
        states, forces = exponential_motion.states, exponential_motion.contact_forces_at_instants
        window.gap[:], window.force[:] = exponential_motion.gaps[:-1], forces[:-1]
        window.recorded_displacement[:] = flow.displacement_from_phase_zero(
            states[:-1], forces[:-1], request.recorded_dofs
        )
        displacement_at_load = flow.displacement_from_phase_zero(
            states, forces, request.loaded_dofs
        )
        window.displacement_at_load[:] = displacement_at_load[
            :-1
        ] * _comparison_weights_of_loaded_dofs(request)
        if period_number == 0:
            self._energy_input = self._total_energy(exponential_motion, 0)
            self._losses_less_energy_input = -self._energy_input
        modal_velocity = states[:, len(flow.modal_model.squares) :]
        power_lost_to_damping = np.einsum(
            "nj,nj->n", flow.modal_model.damping_force(modal_velocity), modal_velocity
        )
        load_work = float(np.sum(self._mean_load_over_step * np.diff(displacement_at_load, axis=0)))
        self._energy_input += abs(load_work)
        self._losses_less_energy_input += flow.step_size * float(
            np.sum(0.5 * (power_lost_to_damping[1:] + power_lost_to_damping[:-1]))
        )
        self._losses_less_energy_input += exponential_motion.friction_loss - load_work
        self.set_created_energy_ratio(
            self._total_energy(exponential_motion, -1) + self._losses_less_energy_input,
            self._energy_input,
        )
        self._state = exponential_motion.end_state
        self._end_displacement = flow.displacement_from_phase_zero(states[-1:], forces[-1:])[0]

    def _total_energy(self, exponential_motion: ExponentialMotion, instant_index: int) -> float:
        """Return the energy at an instant: kinetic, elastic, and in contact springs [J].

        ``instant_index`` numbers the instants in ``exponential_motion`` from 0; -1 is the last.
        """
        flow = self._flow
        displacement_at_instant = flow.displacement_from_phase_zero(
            exponential_motion.states[[instant_index]],
            exponential_motion.contact_forces_at_instants[[instant_index]],
        )[0]
        doubled_elastic_energy = (
            displacement_at_instant
            @ multiply_columns(flow.structure.stiffness, displacement_at_instant[:, None])[:, 0]
        )
        modal_velocity = exponential_motion.states[instant_index, len(flow.modal_model.squares) :]
        doubled_spring_energy = np.sum(
            flow.contact_spring_compliance
            * exponential_motion.contact_forces_at_instants[instant_index] ** 2
        )
        return 0.5 * float(
            doubled_elastic_energy + modal_velocity @ modal_velocity + doubled_spring_energy
        )

    def final_state_parts(self) -> tuple[np.ndarray, ...]:
        return _displacement_and_velocity(self._flow, self._end_displacement, self._state)
