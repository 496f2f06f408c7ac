"""The flow of a small structure with contact, exact from event to event.

In modal coordinates q, with the residual flexibility R_inf (:mod:`fenics_crack.model.contact`) and
the stiffness kappa of the contact pairs,

    q'' + C q' + Lambda q + P lambda = f(t),      s = P^T q + l(t),
    0 <= lambda,   (R_inf + I/kappa) lambda - s >= 0,   complementary.

C and Lambda are modal damping and squared frequencies, f the modal load, lambda the contact forces.
P has each mode's gaps. s are the slow gaps (gap plus R_inf lambda). l(t) is the gap by the load on
coordinates without mass, less the clearance.

While the set A of closed pairs stays, lambda_A = S s_A with S = ((R_inf + I/kappa)_AA)^-1, and the
motion is linear. A Taylor series gives the motion, closed pairs' forces and open pairs' openings,
piece by piece. An event is an instant at which a force or an opening falls through zero. After an
event another set A is closed (``kernel/flow.c``). Nothing is truncated: the error is rounding
error. Forces are continuous, so the flow's derivative is the product of all intervals' matrix
exponentials.

References
----------
Barrio, Applied Mathematics and Computation 163 (2005) 525 (Taylor series as integrator).
Khan and Barton, Systems & Control Letters 2015 (no end of events).
Monjaraz-Tec, Gross and Krack, Computers & Structures 267 (2022) 106810.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.machine import machine_memory
from fenics_crack.kernel import NULL, Struct, attach_destructor, kernel, pointer, require_shape
from fenics_crack.model.contact import (
    SETS_MEMORY_FRACTION,
    ContactLaw,
    add_pair_for_each_contact_force,
    check_law,
    friction_coefficient_of,
    friction_of,
    is_regular,
    is_unilateral,
    law_of_rows,
    merge_layers_of_pairs,
    spring_compliances,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import fourier_basis_for

FEWER_EVENTS_ADVICE = "use fewer pairs (mesh.patches) or fewer modes (reduction.modes)"
"""Advice in errors for motions with too many events or Taylor pieces."""


@dataclass(frozen=True)
class Budget:
    """Limits on the work of integrating a motion.

    Beyond a limit, the integration raises ConvergenceError.

    Attributes
    ----------
    max_taylor_pieces : int
        Maximum number of Taylor pieces: parts of the motion with one Taylor series each.
    max_event_intervals : int
        Maximum number of intervals between events. At an event, a pair opens, closes, sticks or
        slips.
    """

    max_taylor_pieces: int = 100_000
    max_event_intervals: int = 20_000


class BudgetError(ConvergenceError):
    """A motion needs more Taylor pieces than :class:`Budget` allows.

    A piece is an interval with a single Taylor series.
    """


def exact_flow_or_none(structure: Structure, contact: ContactLaw) -> ContactFlow | None:
    """Return the exact flow of a structure and a contact law, or None.

    The flow integrates a motion to rounding, from contact event to contact event. None is returned
    in three cases:

    - The law is smooth, not piecewise linear.
    - The structure is large. A small one has at most 600 dofs on one rank, or is reduced to modes
      and massless faces.
    - Contact has no springs (rigid contact, or sticking without tangential springs), and crack
      faces have mass. More precisely, the residual flexibility is singular: the gaps' static
      response to contact forces through massless coordinates.
    """
    return (
        ContactFlow(structure, contact)
        if _exact_flow_input_error_or_none(structure, contact) is None
        else None
    )


def exact_flow_or_error(structure: Structure, contact: ContactLaw) -> ContactFlow:
    """Return the exact flow of a structure and a contact law.

    The flow integrates a motion to rounding, from contact event to contact event.

    Raises
    ------
    InputError
        The law is smooth, or the structure is too large. Or contact forces are not unique, as for
        rigid contact between crack faces with mass (:func:`exact_flow_or_none`).
    """
    check_has_exact_flow(structure, contact)
    return ContactFlow(structure, contact)


def check_has_exact_flow(structure: Structure, contact: ContactLaw) -> None:
    """Raise InputError if a structure and a contact law have no exact flow."""
    if input_error := _exact_flow_input_error_or_none(structure, contact):
        raise input_error


def _exact_flow_input_error_or_none(structure: Structure, contact: ContactLaw) -> InputError | None:
    """Return an InputError that says why there is no exact flow; None if there is one.

    A law that does not fit the structure raises an InputError.
    """
    check_law(structure, contact, allows_rigid=True)
    if not is_unilateral(contact):
        return InputError(
            "contact", contact, "UnilateralPenalty, LayeredPenalty or UnilateralConstraint"
        )
    if not is_small(structure):
        return InputError(
            "structure",
            f"{structure.n_dofs} dofs",
            "a reduced structure on one rank, as fc.reduce_structure(structure) returns",
        )
    softness = spring_compliances(contact, structure.n_pairs)
    if np.all(softness):
        return None
    static_flexibility = all_modes(
        add_pair_for_each_contact_force(contact, structure)
    ).static_pair_compliance()
    if not is_regular(static_flexibility + np.diag(softness)):
        allowed_text = (
            "a structure whose crack faces have no mass: "
            "reduce_structure(structure, method='massless')"
        )
        return InputError("structure", repr(structure), allowed_text)
    return None


class ModalFlow:
    """Flow of a small structure: motion from a state under the structure's load.

    A state has ``state_size`` entries: modal displacements q and velocities q', with friction also
    the slider position h of each pair. h is the tangential gap less the tangential spring's
    deformation, constant while a pair sticks. Contact rows are the pairs' normal gaps; with
    friction tangential gaps follow (n_rows = 2 n_pairs, else n_pairs). Under the layered law both
    come twice, as rows of the layer and below it, with a slider each.

    Attributes
    ----------
    structure : Structure
        Small structure (:func:`fenics_crack.model.modal.is_small`).
    contact : ContactLaw
        Law of all its pairs.
    friction_law : CoulombFriction or None
        The contact law if it has friction, else None.
    n_normal_rows : int
        Number of rows that open and close.
    clearance : (n_pairs,) or (2 n_pairs,) [m]
        Clearance of each pair; with friction followed by a zero for each tangential gap.
    modal_model : AllModes
        Modes with mass; ``modal_model.gaps_by_mode`` has a column for each contact row.
    n_modes, state_size : int
        Number of modes, and of entries in a state.
    residual_flexibility : (n_rows, n_rows) [m/N]
        R_inf: gap change by unit contact forces through the massless coordinates; 0 without these.
    contact_spring_compliance : (n_rows,) [m/N]
        1 / kappa, compliance of the contact springs; 0 for rigid contact.
    compliance : (n_rows, n_rows) [m/N]
        R_inf + diag(1 / kappa).
    modal_load : (2K+1, n_modes)
        Load of the modes: mean, then cosine and sine part of each order up to K.
    massless_load_gap_less_clearance : (2K+1, n_rows) [m]
        Gaps by the load on massless coordinates, less the clearance; rows as in ``modal_load``.
    """

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        self.structure, self.contact = structure, contact
        self.friction_law = friction_of(contact)
        structure_with_contact_rows = add_pair_for_each_contact_force(contact, structure)
        self.n_normal_rows = structure_with_contact_rows.n_pairs // (2 if self.friction_law else 1)
        row_clearances = structure_with_contact_rows.clearance[None]
        self.clearance = merge_layers_of_pairs(
            contact, structure.n_pairs, row_clearances, row_clearances
        )[0][0]
        self.modal_model = modal_model = all_modes(structure_with_contact_rows)
        self.n_modes = len(modal_model.squares)
        self.state_size = 2 * self.n_modes + (self.n_normal_rows if self.friction_law else 0)
        self.residual_flexibility = modal_model.static_pair_compliance()
        self.contact_spring_compliance = spring_compliances(contact, structure.n_pairs)
        self.compliance = self.residual_flexibility + np.diag(self.contact_spring_compliance)
        self.modal_load = np.ascontiguousarray(structure.force @ modal_model.shapes)
        self.massless_load_gap_less_clearance = np.zeros(
            (len(self.modal_load), len(self.contact_spring_compliance))
        )
        if modal_model.massless_displacement_by_dof_forces is not None:
            self.massless_load_gap_less_clearance += structure_with_contact_rows.apply_bt(
                structure.force @ modal_model.massless_displacement_by_dof_forces
            )
        self.massless_load_gap_less_clearance[0] -= structure_with_contact_rows.clearance

    def state(
        self,
        displacement: np.ndarray,
        velocity: np.ndarray,
        slider_positions: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the states (..., state_size) of displacements and velocities (..., n_dofs).

        With friction, ``slider_positions`` (..., n_pairs) [m] are the slider positions h:
        tangential gaps less the deformation of the tangential springs. Default: the tangential gaps
        under the mean load without contact forces. Under the layered law they are (..., 2 n_pairs).
        """
        dof_to_mode_matrix, n_pairs = self.modal_model.shapes_inverse.T, self.n_normal_rows
        state_parts = [displacement @ dof_to_mode_matrix, velocity @ dof_to_mode_matrix]
        if self.friction_law:
            if slider_positions is None:
                slider_positions = (
                    state_parts[0] @ self.modal_model.gaps_by_mode[:, n_pairs:]
                    + self.massless_load_gap_less_clearance[0, n_pairs:]
                )
            state_parts.append(slider_positions)
        return np.concatenate(state_parts, axis=-1)

    def displacement(
        self,
        states: np.ndarray,
        force: np.ndarray,
        phase: np.ndarray,
        dofs: np.ndarray | slice = slice(None),
    ) -> np.ndarray:
        """Return the displacement of the structure: (n, n_dofs) [m].

        Parameters
        ----------
        states : (n, state_size)
            States of the flow at n instants.
        force : (n, n_rows) [N]
            Contact forces at these instants: normal ones, with friction then tangential ones. Under
            the layered law each pair has two rows; the total forces of pairs (n, n_pairs) are
            accepted, too.
        phase : (n,) [rad]
            Phases of the load at these instants.
        dofs : array or slice
            Numbers of dofs to return. Default: all.
        """
        return self.combine_displacement(
            states[:, : self.n_modes], force, fourier_basis_for(self.modal_load, phase), dofs
        )

    def combine_displacement(
        self,
        modal_displacement: np.ndarray,
        force: np.ndarray,
        load_basis: np.ndarray,
        dofs: np.ndarray | slice = slice(None),
        rows: np.ndarray | None = None,
    ) -> np.ndarray:
        """Combine modal and static parts of the displacement: (n, n_dofs) [m].

        All parameters may be values at n instants, or n Fourier coefficients.

        Parameters
        ----------
        modal_displacement : (n, n_modes)
            Amplitudes of the modes with mass.
        force : (n, n_rows) or (n, n_pairs) [N]
            Contact forces: normal ones, with friction then tangential ones. Under the layered law
            each pair has two rows with the same effect, so total forces of pairs are accepted, too.
        load_basis : (n, 2K+1)
            Basis functions of the load: 1, cosine and sine of each order.
        dofs : array or slice
            Numbers of dofs to return. Default: all.
        rows : (m, n_dofs), optional
            Factors of the displacement. If given, the result is the product of rows and
            displacement: (n, m).
        """
        modal_model = self.modal_model

        def select_rows(motion_columns: np.ndarray) -> np.ndarray:
            """Return the requested part of k motions (n_dofs, k).

            The result is the product with ``rows`` (m, k) if given, else the entries of ``dofs``.
            """
            return motion_columns[dofs] if rows is None else rows @ motion_columns

        displacement: np.ndarray = modal_displacement @ select_rows(modal_model.shapes).T
        if (
            modal_model.massless_displacement_by_dof_forces is not None
            and modal_model.massless_displacement_by_pair_forces is not None
        ):
            displacement += (
                load_basis
                @ select_rows(
                    (self.structure.force @ modal_model.massless_displacement_by_dof_forces).T
                ).T
            )
            responses = modal_model.massless_displacement_by_pair_forces
            responses_to_pairs, _ = merge_layers_of_pairs(
                self.contact, self.structure.n_pairs, responses, responses
            )
            _, pair_force = merge_layers_of_pairs(
                self.contact, self.structure.n_pairs, force, force
            )
            displacement -= pair_force @ select_rows(responses_to_pairs).T
        return displacement


# --- exact ----------------------------------------------------------------------------------------


class ContactFlow(ModalFlow):
    """Exact flow, without time steps, from one contact event to the next."""

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        super().__init__(structure, contact)
        modal_model, n_pairs = self.modal_model, self.n_normal_rows
        closed_pair_forces_of_modes = np.linalg.solve(self.compliance, modal_model.gaps_by_mode.T)
        closed_stiffness_matrix = (
            np.diag(modal_model.squares) + modal_model.gaps_by_mode @ closed_pair_forces_of_modes
        )
        self.mode_rate_bound = _upper_bound_of_rates(
            float(np.linalg.eigvalsh(closed_stiffness_matrix)[-1]), modal_model.damping
        )
        """Upper bound of all modes' oscillation and decay rates, for any closed pairs [1/s]."""
        self.open_mode_rate_bound = _upper_bound_of_rates(
            float(modal_model.squares.max()), modal_model.damping
        )
        """Upper bound of these rates while all pairs are open [1/s]."""
        friction_coefficients = friction_coefficient_of(law_of_rows(contact, structure.n_pairs))
        if friction_coefficients is not None:
            friction_coefficients = np.broadcast_to(friction_coefficients, n_pairs).astype(float)
        flow_parts_struct = Struct(
            "flow_parts", modes=self.n_modes, pairs=n_pairs, friction=friction_coefficients,
            coupled=modal_model.damping.ndim == 2, squares=as_doubles(modal_model.squares),
            damping=as_doubles(modal_model.damping),
            rows=as_doubles(modal_model.gaps_by_mode.T), compliance=as_doubles(self.compliance),
            force=self.modal_load,
            harmonics=len(self.modal_load) // 2,
            gap=self.massless_load_gap_less_clearance, max_rate=self.mode_rate_bound,
            max_open_rate=self.open_mode_rate_bound,
            max_set_numbers=int(SETS_MEMORY_FRACTION * machine_memory()) // 8,
        )  # fmt: skip
        self.handle = attach_destructor(
            kernel.new_flow(flow_parts_struct.address), kernel.free_flow
        )
        """Flow object in the C kernel, freed together with this one."""
        self._track_buffer_length = 0

    @cached_property
    def critical_friction_coefficient(self) -> float:
        """Return the smallest friction coefficient mu without unique contact forces.

        Used to warn of a larger coefficient: the motion may then have no unique continuation. The
        search tries 400 random combinations of pair states: open, sticking, or slipping in either
        of two directions. The contact rows are the normal gaps of all pairs, then the tangential
        gaps of all pairs. A combination has m unknown forces: normal forces in closed pairs, and
        tangential forces in sticking pairs. The m gaps in the same rows change by a matrix A times
        these forces:

            A = D_m (E_0 + mu E_1).

        D_m has the m rows of ``compliance``, with a column for each contact row. E_0 puts each
        unknown force into its own contact row. E_1 puts 1 or -1 times the normal force into the
        tangential row of each slipping pair. A is singular at mu = -1 / e, for a real negative
        eigenvalue e of (D_m E_0)^-1 D_m E_1. The result is inf if no combination has such an
        eigenvalue.
        """
        n_pairs, critical_coefficients = self.n_normal_rows, [np.inf]
        for trial_pair_states in np.random.default_rng(1).integers(0, 4, (400, n_pairs)):
            trial_closed_pair_indices = np.flatnonzero(trial_pair_states)
            trial_stuck_pair_indices = np.flatnonzero(trial_pair_states == kernel.STICK)
            closed_or_stuck_row_indices = np.concatenate(
                [trial_closed_pair_indices, n_pairs + trial_stuck_pair_indices]
            )
            row_compliance = self.compliance[closed_or_stuck_row_indices]
            slip_friction_matrix = np.zeros(
                (len(closed_or_stuck_row_indices), len(closed_or_stuck_row_indices))
            )
            slip_signs = 1.0 * (trial_pair_states == kernel.SLIP_UP) - (
                trial_pair_states == kernel.SLIP_DOWN
            )
            tangential_compliance_columns = row_compliance[:, n_pairs + trial_closed_pair_indices]
            slip_friction_matrix[:, : len(trial_closed_pair_indices)] = (
                tangential_compliance_columns * slip_signs[trial_closed_pair_indices]
            )
            eigenvalues = np.linalg.eigvals(
                np.linalg.solve(
                    row_compliance[:, closed_or_stuck_row_indices], slip_friction_matrix
                )
            )
            is_real_negative_eigenvalue = (eigenvalues.imag == 0.0) & (eigenvalues.real < 0.0)
            critical_coefficients.extend(-1.0 / eigenvalues.real[is_real_negative_eigenvalue])
        return float(min(critical_coefficients))

    @cached_property
    def rest_state(self) -> np.ndarray:
        """Return the state of rest under the mean load: (state_size,).

        Load, elastic forces and normal contact forces are in equilibrium. Rigid-body displacements,
        velocities and tangential forces are zero.
        """
        modal_model, n_pairs = self.modal_model, self.n_normal_rows
        mode_flexibilities = np.zeros_like(modal_model.squares)
        np.divide(1.0, modal_model.squares, out=mode_flexibilities, where=modal_model.squares > 0.0)
        normal_gaps_of_modes = modal_model.gaps_by_mode[:, :n_pairs]
        normal_compliance = self.compliance[:, :n_pairs]
        modal_displacement_by_force = mode_flexibilities[:, None] * normal_gaps_of_modes
        # With all pairs open:
        modal_displacement = mode_flexibilities * self.modal_load[0]
        normal_gaps_without_contact = (
            modal_displacement @ normal_gaps_of_modes
            + self.massless_load_gap_less_clearance[0, :n_pairs]
        )
        normal_forces = np.zeros(n_pairs)
        if np.any(normal_gaps_without_contact > 0.0):
            from scipy.optimize import nnls  # slow to import

            # D lambda - gap >= 0 and lambda >= 0, complementary, with D = L L^T: the minimum of
            # |L^T lambda - L^-1 gap|.
            cholesky_factor = np.linalg.cholesky(
                normal_compliance[:n_pairs] + normal_gaps_of_modes.T @ modal_displacement_by_force
            )
            normal_forces = nnls(
                cholesky_factor.T, np.linalg.solve(cholesky_factor, normal_gaps_without_contact)
            )[0]
            modal_displacement = modal_displacement - modal_displacement_by_force @ normal_forces
        state_parts = [modal_displacement, np.zeros_like(modal_displacement)]
        if self.friction_law:
            state_parts.append(
                (
                    modal_displacement @ modal_model.gaps_by_mode
                    + self.massless_load_gap_less_clearance[0]
                    - normal_compliance @ normal_forces
                )[n_pairs:]
            )
        return np.concatenate(state_parts)

    def estimate_taylor_pieces(self, duration: float) -> float:
        """Return the number of Taylor pieces in a motion of ``duration`` [s] without events.

        A piece is an interval with a single Taylor series. A piece ends when the fastest mode has
        turned by 10 rad. The mode's rate is an upper bound for any set of closed pairs.
        """
        return float(self.mode_rate_bound * duration / kernel.MAX_PIECE_ANGLE)

    def energy_weights(self, base_omega: float) -> np.ndarray:
        """Return weights e for the energy norm ``|e z|`` of a state z: (state_size,).

        Let w_j [rad/s] be the natural frequency of mode j, and w_0 = ``base_omega`` [rad/s] the
        response's lowest frequency. The displacement of mode j has the weight max(w_j, w_0), and
        the velocity of mode j has 1. With friction, slider positions follow. The weight is the
        square root of the pair's tangential stiffness while no other pair sticks.
        """
        energy_weights = np.ones(self.state_size)
        np.sqrt(
            np.maximum(self.modal_model.squares, base_omega**2), out=energy_weights[: self.n_modes]
        )
        if self.friction_law:  # h deforms a spring as stiff as a single sticking pair
            stick_compliance = np.diag(self.compliance)[self.n_normal_rows :]
            energy_weights[2 * self.n_modes :] = 1.0 / np.sqrt(stick_compliance)
        return energy_weights

    def amplitude_weights(self, base_omega: float) -> np.ndarray:
        """Return weights a for the amplitude norm ``|a z|`` of a state z: (state_size,).

        The norm measures a state by displacement rather than energy. Let w_j [rad/s] be the natural
        frequency of mode j, and w_0 = ``base_omega`` [rad/s] the response's lowest frequency. The
        displacement of mode j has the weight 1, and the velocity of mode j has 1 / max(w_j, w_0).
        With friction, slider positions follow. Their weights are the weights in
        :meth:`energy_weights`, divided by max(w_1, w_0).
        """
        weights = self.energy_weights(base_omega)
        floored_mode_omegas = weights[: self.n_modes]
        stick_position_divisors = np.full(
            self.state_size - 2 * self.n_modes, floored_mode_omegas[0]
        )
        return weights / np.concatenate(
            [floored_mode_omegas, floored_mode_omegas, stick_position_divisors]
        )

    def advance(
        self,
        state: np.ndarray,
        omega: float,
        duration: float,
        *,
        start: float = 0.0,
        instants: np.ndarray | None = None,
        budget: Budget | None = None,
    ) -> IntegratedMotion:
        """Integrate a motion from a state, exact to rounding.

        Parameters
        ----------
        state : (state_size,)
            State at the start.
        omega : float
            Load frequency [rad/s].
        duration, start : float [s]
            Length of the motion, and time at its start: the load's phase is ``omega`` times time.
        instants : (n,) [s], optional
            Ascending times of samples, between start and end. Default: no samples.
        budget : Budget, optional
            Default: 100,000 Taylor pieces and 20,000 intervals between events.

        Raises
        ------
        ConvergenceError
            The motion exceeds its budget or is not finite, or contact forces are not unique.
        """
        end_state = np.array(state, dtype=float).reshape(self.state_size)
        instants = np.zeros(0) if instants is None else as_doubles(instants)
        n_instants = len(instants)
        n_contact_rows = len(self.contact_spring_compliance)
        n_pairs = self.n_normal_rows
        state_samples = np.empty((n_instants, 2 * self.n_modes))
        forces_and_openings = np.empty(
            (n_instants, 2 * n_contact_rows if self.friction_law else n_contact_rows)
        )
        pair_states = np.empty((n_instants, n_pairs), dtype=np.int8)
        motion_struct, copy_track = self._make_motion_struct_and_track_copier(
            budget, omega=omega, time=start, end=start + duration, state=end_state,
            n_instants=n_instants, instants=instants, states=state_samples,
            answers=forces_and_openings, closed=pair_states,
        )  # fmt: skip
        _check_integration_outcome(
            kernel.flow_advance(self.handle, motion_struct.address), motion_struct.address.n_events
        )
        track = Track(self, omega, start, **copy_track(motion_struct.address.n_intervals))
        samples = Samples(self, omega, instants, state_samples, forces_and_openings, pair_states)
        n_events = int(motion_struct.address.n_events)
        n_taylor_pieces = int(motion_struct.address.n_pieces)
        return IntegratedMotion(end_state, n_events, n_taylor_pieces, track, samples)

    def integrate_equal_parts_of_period(
        self, states: np.ndarray, omega: float, period: float
    ) -> tuple[np.ndarray, Track, np.ndarray]:
        """Integrate n motions, each over an equal part of a period.

        Parameters
        ----------
        states : (n, state_size)
            States at the starts of the parts; the first part begins at time zero.
        omega, period : float
            Load frequency [rad/s], and length of the period [s].

        Returns
        -------
        end_states : (n, state_size)
            States at the ends of the parts.
        track : Track
            States of the pairs in all intervals between events, part after part.
        interval_counts : (n,) int
            Number of intervals from the period's start to each part's end.

        Raises
        ------
        ConvergenceError
            The motion exceeds its budget, or is not finite.
        """
        states = as_doubles(states)
        assert states.shape[1] == self.state_size
        end_states, cumulative_interval_counts = (
            np.empty_like(states),
            np.empty(len(states), dtype=np.intc),
        )
        motion_struct, copy_track = self._make_motion_struct_and_track_copier(None, omega=omega)
        outcome = kernel.flow_advance_parts(
            self.handle, motion_struct.address, len(states), period, pointer(states),
            pointer(end_states), pointer(cumulative_interval_counts),
        )  # fmt: skip
        _check_integration_outcome(outcome, motion_struct.address.n_events)
        track = Track(self, omega, 0.0, **copy_track(motion_struct.address.n_intervals))
        return end_states, track, cumulative_interval_counts

    def _make_motion_struct_and_track_copier(
        self, budget: Budget | None, **members: Any
    ) -> tuple[Struct, Callable[[int], dict[str, np.ndarray]]]:
        """Return the kernel's struct ``flow_motion``, and a function to copy the track.

        The kernel writes the states of the pairs between events, the track, into buffers for all
        motions. The copying function saves a track from the next motion. The function takes the
        number of intervals between events, and returns a dictionary of :class:`Track` arrays by
        name. ``budget`` limits the integration (None: the default limits). ``members`` are further
        fields of the struct by name.
        """
        budget = budget or Budget()
        if self._track_buffer_length < budget.max_event_intervals:
            self._track_buffer_length = max_intervals = budget.max_event_intervals
            pair_state_buffer = np.empty((max_intervals, self.n_normal_rows), np.int8)
            self._track_array_by_name = {
                "sets": pair_state_buffer,
                "lengths": np.empty(max_intervals),
            }
            if self.friction_law:
                friction_dtypes_by_name = {"causes": np.intc, "is_first": np.int8, "ratios": float}
                self._track_array_by_name |= {
                    name: np.empty(max_intervals, dtype)
                    for name, dtype in friction_dtypes_by_name.items()
                }
            self._base_struct = Struct("flow_motion", **self._track_array_by_name)
        track_array_by_name = self._track_array_by_name
        limits_by_name = {
            "max_pieces": budget.max_taylor_pieces,
            "max_intervals": budget.max_event_intervals,
        }

        def copy_track(n_intervals: int) -> dict[str, np.ndarray]:
            """Copy the first ``n_intervals`` entries in each of the track's buffers."""
            return {
                name: track_array[:n_intervals].copy()
                for name, track_array in track_array_by_name.items()
            }

        return self._base_struct.with_members(**limits_by_name, **members), copy_track


@dataclass(frozen=True)
class Track:
    """States of the pairs in the intervals between a motion's events.

    Attributes
    ----------
    flow : ContactFlow
    omega, start : float
        Load frequency [rad/s] and start of the motion [s].
    sets : (n, flow.n_normal_rows) int
        States of the pairs: 0 open, 1 closed; with friction 1 sticking, 2 and 3 slipping. Under the
        layered law states of the layers, then of the contact below them.
    lengths : (n,) [s]
        Durations of the intervals.
    causes, is_first, ratios : (n,) or None
        Events at the intervals' ends; None without friction. ``causes``: index of the force or gap
        function that becomes zero (-1: none). ``is_first``: 1 for the first event at an instant.
        ``ratios``: rate of the pair's tangential gap, divided by this function's rate
        (``kernel/flow.h``).
    """

    flow: ContactFlow
    omega: float
    start: float
    sets: np.ndarray
    lengths: np.ndarray
    causes: np.ndarray | None = None
    is_first: np.ndarray | None = None
    ratios: np.ndarray | None = None

    def mean_time_share_of_pairs(self, is_selected: np.ndarray) -> float:
        """Return the fraction of time with a pair selected, as a mean over all pairs.

        ``is_selected`` (n, n_pairs) is True for selected pairs, for example closed pairs, in each
        of the n intervals between events.
        """
        return float(self.lengths @ is_selected.mean(axis=1) / self.lengths.sum())

    @property
    def closed_share(self) -> float:
        """Return the fraction of time in contact, as a mean over the pairs."""
        return self.mean_time_share_of_pairs(self.sets[:, : self.flow.structure.n_pairs] > 0)

    @cached_property
    def _struct(self) -> Struct:
        """Return the kernel's struct ``flow_track`` with the track's arrays."""
        members_by_name = {
            name: member_value for name, member_value in vars(self).items() if name != "flow"
        }
        return Struct("flow_track", n_intervals=len(self.lengths), **members_by_name)

    @cached_property
    def derivative_of_end_state(self) -> np.ndarray:
        """Return dz(end) / dz(start), the derivative of the state z: (state_size, state_size)."""
        tangent_matrix = np.empty((self.flow.state_size, self.flow.state_size))
        outcome = kernel.flow_tangent(
            self.flow.handle, self._struct.address, pointer(tangent_matrix)
        )
        _check_integration_outcome(outcome, len(self.lengths) - 1)
        return tangent_matrix

    def derivative_by_softness(
        self, start_state: np.ndarray, softness_rate: np.ndarray
    ) -> np.ndarray:
        """Return the end state's derivative by a parameter of the contact springs: (state_size,).

        The parameter changes the springs, but not the state at the start.

        Parameters
        ----------
        start_state : (state_size,)
            State at the start of the track.
        softness_rate : (n_rows,)
            Derivative of each contact spring's compliance 1 / kappa [m/N] by the parameter.
        """
        end_state_derivative = np.empty(self.flow.state_size)
        checked_softness_rate = require_shape(
            softness_rate, *self.flow.contact_spring_compliance.shape
        )
        outcome = kernel.flow_by_structure(
            self.flow.handle, self._struct.address, pointer(as_doubles(start_state)), NULL,
            pointer(checked_softness_rate), pointer(end_state_derivative),
        )  # fmt: skip
        _check_integration_outcome(outcome, len(self.lengths) - 1)
        return end_state_derivative

    def __matmul__(self, start_change: np.ndarray) -> np.ndarray:
        """Return the end state's change for a small change (state_size,) of the start state.

        The change is multiplied by the flow's derivative over the track. This matrix is not formed.
        """
        cumulative_interval_counts = np.array([len(self.lengths)], dtype=np.intc)
        return np.asarray(
            self.carry_changes(
                start_change, np.zeros((1, self.flow.state_size)), cumulative_interval_counts
            )[-1]
        )

    def carry_changes(
        self,
        start_change: np.ndarray,
        state_jumps: np.ndarray,
        cumulative_interval_counts: np.ndarray,
    ) -> np.ndarray:
        """Return how a small change d of the state evolves over n successive parts of the track.

            d_{i+1} = M_i d_i + j_i,    M_i = derivative of the flow over part i

        Used for multiple shooting: a motion in parts has jumps j between the parts.

        Parameters
        ----------
        start_change : (state_size,)
            Change d_0 at the track's start.
        state_jumps : (n, state_size)
            Changes j added at the parts' ends.
        cumulative_interval_counts : (n,) int
            Number of intervals between events from the track's start to each part's end.

        Returns
        -------
        (n + 1, state_size)
            d at the start of each part, and at the end.
        """
        state_changes_at_part_boundaries = np.empty(
            (len(cumulative_interval_counts) + 1, self.flow.state_size)
        )
        state_changes_at_part_boundaries[0] = start_change
        outcome = kernel.flow_carry_changes(
            self.flow.handle, self._struct.address, len(cumulative_interval_counts),
            pointer(cumulative_interval_counts),
            pointer(as_doubles(state_jumps)),
            pointer(state_changes_at_part_boundaries),
        )  # fmt: skip
        _check_integration_outcome(outcome, len(self.lengths) - 1)
        return state_changes_at_part_boundaries


@dataclass(frozen=True)
class Samples:
    """A motion at n instants.

    Attributes
    ----------
    flow : ContactFlow
    omega : float
        Load frequency [rad/s].
    time : (n,) [s]
        Instants; the phase of the load is ``omega`` times time.
    states : (n, 2 n_modes)
        Modal displacements q and velocities q'.
    pair_states : (n, flow.n_normal_rows) int
        States of the pairs: 0 open, 1 closed; with friction 1 sticking, 2 and 3 slipping. Under the
        layered law states of the layers, then of the contact below them.
    """

    flow: ContactFlow
    omega: float
    time: np.ndarray
    states: np.ndarray
    forces_and_openings: np.ndarray
    """(n, n_rows): closed rows' forces [N], open rows' openings [m]. With friction (n, 2
    n_rows): forces on all rows, then gaps less the deformation of the contact springs."""
    pair_states: np.ndarray

    @property
    def is_closed(self) -> np.ndarray:
        """Return True for pairs in contact, at each instant: (n, flow.n_normal_rows) bool.

        Under the layered law a pair has two columns: for the layer, and for the contact below the
        layer.
        """
        return self.pair_states > 0

    @cached_property
    def contact_row_forces(self) -> np.ndarray:
        """Return the contact forces at each instant: (n, n_rows) [N].

        Normal forces come first; with friction tangential forces follow. Under the layered law a
        pair has two normal forces: in the layer, and below the layer.
        """
        if self.flow.friction_law:
            return self.forces_and_openings[:, : len(self.flow.contact_spring_compliance)]
        return np.where(self.is_closed, np.maximum(self.forces_and_openings, 0.0), 0.0)

    @cached_property
    def contact_row_gaps(self) -> np.ndarray:
        """Return the gaps at each instant, positive for penetration: (n, n_rows) [m].

        Normal gaps come first; with friction tangential gaps follow. Under the layered law a pair
        has two normal gaps: to the layer, and to the contact below the layer.
        """
        spring_deformations = self.contact_row_forces * self.flow.contact_spring_compliance
        if self.flow.friction_law:
            return (
                self.forces_and_openings[:, len(self.flow.contact_spring_compliance) :]
                + spring_deformations
            )
        return np.where(self.is_closed, spring_deformations, -self.forces_and_openings)

    @cached_property
    def _gaps_and_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Return gaps [m] and contact forces [N] of the pairs: (n, n_pairs) each.

        With friction, tangential columns follow: (n, 2 n_pairs).
        """
        flow = self.flow
        return merge_layers_of_pairs(
            flow.contact, flow.structure.n_pairs, self.contact_row_gaps, self.contact_row_forces
        )

    @property
    def forces(self) -> np.ndarray:
        """Return contact forces of the pairs: (n, n_pairs) [N].

        With friction, friction forces follow the normal forces: (n, 2 n_pairs).
        """
        return self._gaps_and_forces[1]

    @property
    def gaps(self) -> np.ndarray:
        """Return gaps of the pairs, positive for penetration: (n, n_pairs) [m].

        With friction, tangential gaps follow the normal ones: (n, 2 n_pairs).
        """
        return self._gaps_and_forces[0]

    @property
    def slider_positions(self) -> np.ndarray:
        """Return the slider positions h of friction: (n, n_pairs) [m].

        h is the tangential gap less the tangential spring's deformation, and is constant while the
        pair sticks. Under the layered law: (n, 2 n_pairs). Without friction: (n, 0).
        """
        return self.forces_and_openings[
            :, len(self.flow.contact_spring_compliance) + self.flow.n_normal_rows :
        ]

    @property
    def whole_states(self) -> np.ndarray:
        """Return the flow's states at the instants: (n, state_size).

        Modal displacements and velocities, and with friction the slider positions of all pairs.
        """
        return np.hstack([self.states, self.slider_positions])

    @property
    def force(self) -> np.ndarray:
        """Return the normal contact forces: (n, n_pairs) [N]."""
        return self.forces[:, : self.flow.structure.n_pairs]

    @property
    def gap(self) -> np.ndarray:
        """Return the normal gaps, positive for penetration: (n, n_pairs) [m]."""
        return self.gaps[:, : self.flow.structure.n_pairs]

    @property
    def displacement(self) -> np.ndarray:
        """Return the displacement of the structure: (n, n_dofs) [m]."""
        return self.flow.displacement(self.states, self.forces, self.omega * self.time)

    def row_products(self, rows: np.ndarray) -> np.ndarray:
        """Return products of rows (m, n_dofs) with the displacement: (n, m)."""
        flow, modal_displacement = self.flow, self.states[:, : self.flow.n_modes]
        load_basis = fourier_basis_for(flow.modal_load, self.omega * self.time)
        return flow.combine_displacement(modal_displacement, self.forces, load_basis, rows=rows)


class IntegratedMotion(NamedTuple):
    """Result of integrating a motion.

    Attributes
    ----------
    state : (state_size,)
        State at the end.
    n_events, n_taylor_pieces : int
        Number of events (a pair opens, closes, sticks or slips), and of Taylor pieces.
    track : Track
        States of the pairs between events.
    samples : Samples
        Motion at the requested instants.
    """

    state: np.ndarray
    n_events: int
    n_taylor_pieces: int
    track: Track
    samples: Samples


def _upper_bound_of_rates(max_square: float, damping: np.ndarray) -> float:
    """Return an upper bound of the modes' oscillation and decay rates [1/s].

    Used for the length of Taylor pieces. The rates are the moduli |s| of the roots of s^2 + c s + k
    = 0, with damping c and stiffness k of a mode.

    Parameters
    ----------
    max_square : float [1/s^2]
        Largest k.
    damping : (n, n) or (n,) [1/s]
        Damping matrix, or the diagonal of one. c may be any of its Rayleigh quotients.
    """
    max_damping_rate = float(np.linalg.norm(damping, 2 if damping.ndim == 2 else np.inf))
    if damping.ndim == 2 and not np.allclose(damping, damping.T):  # c is complex
        return 0.5 * (
            max_damping_rate + float(np.sqrt(max_damping_rate**2 + 4.0 * max(max_square, 0.0)))
        )
    return max(float(np.sqrt(max(max_square, 0.0))), max_damping_rate)


def _check_integration_outcome(outcome: int, n_events: int) -> None:
    """Raise an error if the code ``outcome`` says that the kernel's integration failed.

    BudgetError: too many Taylor pieces. ConvergenceError: too many intervals, no finite motion, or
    no unique contact forces. MemoryError: no memory. ``n_events`` is the number of events before
    the failure, for the message.
    """
    if outcome == kernel.FLOW_DONE:
        return
    if outcome == kernel.FLOW_NO_MEMORY:
        raise MemoryError("exact flow")
    reason_by_outcome = {
        kernel.FLOW_TOO_MANY_PIECES: (
            "the highest modes are too fast for so long a motion: keep fewer modes "
            "(reduction.modes), or integrate a shorter time"
        ),
        kernel.FLOW_TOO_MANY_INTERVALS: (
            f"the contact pairs open and close without end: {FEWER_EVENTS_ADVICE}"
        ),
        kernel.FLOW_FAILED: (
            "the motion is not finite, or its contact forces are not unique: check the "
            "units of the load, or lower contact.friction"
        ),
    }
    error_class = BudgetError if outcome == kernel.FLOW_TOO_MANY_PIECES else ConvergenceError
    raise error_class(f"exact flow: {reason_by_outcome[outcome]} (after {n_events} events)")


def as_doubles(array: np.ndarray) -> np.ndarray:
    """Return an array as the kernel reads it: contiguous, of doubles."""
    return np.ascontiguousarray(array, dtype=float)
