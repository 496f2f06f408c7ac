"""The flow of a small structure with contact, exact from event to event.

In modal coordinates q, with the residual flexibility R_inf (:mod:`fenics_crack.model.contact`) and
the stiffness kappa of the contact pairs,

    q'' + C q' + Lambda q + P lambda = f(t),      s = P^T q + l(t),
    0 <= lambda,   (R_inf + I/kappa) lambda - s >= 0,   complementary.

While the set A of closed pairs stays, lambda_A = S s_A with S = ((R_inf + I/kappa)_AA)^-1, and the
motion is linear. Its Taylor series gives the motion, closed pairs' forces and open pairs' openings,
piece by piece.
An event is an instant at which a force or an opening falls through zero. Behind an event another
set holds (``kernel/flow.c``). Nothing is truncated: the error is rounding error. Forces are
continuous, so the flow's derivative is the product of all sets' exponentials.

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
from fenics_crack.basics.threads import machine_memory
from fenics_crack.kernel import NULL, Struct, attach_destructor, kernel, pointer, require_shape
from fenics_crack.model.contact import (
    SETS_MEMORY_FRACTION,
    ContactLaw,
    add_friction_pairs,
    check_law,
    friction_of,
    is_regular,
    is_unilateral,
    spring_compliances,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import fourier_basis_for


@dataclass(frozen=True)
class Budget:
    """Limits on the work for integrating a motion.

    Attributes
    ----------
    pieces : int
        Maximum pieces of the motion, each with a Taylor series.
    intervals : int
        Maximum intervals between events: pairs open, close, stick or slip.
    """

    pieces: int = 100_000
    intervals: int = 20_000


class BudgetError(ConvergenceError):
    """A motion needs more Taylor pieces than its budget."""


def flow_of(structure: Structure, contact: ContactLaw) -> ContactFlow | None:
    """Return the exact flow of a structure, if there is one.

    None for a smooth law, for a large structure, and for rigid contact with a singular residual
    flexibility.
    """
    return (
        ContactFlow(structure, contact) if _exact_flow_error(structure, contact) is None else None
    )


def exact_flow(structure: Structure, contact: ContactLaw) -> ContactFlow:
    """Return the exact flow of a structure and a contact law.

    Raises
    ------
    InputError
        There is no exact flow.
    """
    check_exact(structure, contact)
    return ContactFlow(structure, contact)


def check_exact(structure: Structure, contact: ContactLaw) -> None:
    """Raise InputError if a structure and a law lack an exact flow."""
    if error := _exact_flow_error(structure, contact):
        raise error


def _exact_flow_error(structure: Structure, contact: ContactLaw) -> InputError | None:
    """Return why a structure and a contact law have no exact flow. None if they have one."""
    check_law(structure, contact, rigid=True)
    if not is_unilateral(contact):
        return InputError("contact", contact, "UnilateralPenalty or UnilateralConstraint")
    if not is_small(structure):
        return InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
    softness = spring_compliances(contact, structure.n_pairs)
    if np.all(softness):
        return None
    static_flexibility = all_modes(add_friction_pairs(contact, structure)).static_pair_compliance()
    if not is_regular(static_flexibility + np.diag(softness)):
        allowed = "one whose faces have no mass: reduce_structure(structure, method='massless')"
        return InputError("structure", repr(structure), allowed)
    return None


class Flow:
    """Flow of a small structure: motion from a state under the structure's load.

    A state has ``size`` entries: modal displacements q and velocities q', with friction also h for
    each pair. h is the tangential gap less the tangential spring's deformation, constant while a
    pair sticks. Contact rows are the pairs' normal gaps; with friction tangential gaps follow
    (n_rows = 2 n_pairs, else n_pairs).

    Attributes
    ----------
    structure : Structure
    contact : ContactLaw
    clearance : (n_rows,) [m]
        g0 of the rows; 0 for tangents.
    modes : AllModes
        Moving modes; their pairs are the contact rows.
    n_modes, size : int
        Number of modes, and of entries in a state.
    residual_flexibility : (n_rows, n_rows) [m/N]
        R_inf.
    softness : (n_rows,) [m/N]
        1 / kappa; 0 for rigid contact.
    compliance : (n_rows, n_rows) [m/N]
        R_inf + I/kappa.
    modal_load : (2K+1, n_modes)
        Load f of the modes: mean, then cosine and sine of each order up to K.
    load_gap : (2K+1, n_rows) [m]
        Gaps l by the load at coordinates without mass, less the clearance.
    """

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        self.structure, self.contact = structure, contact
        self.friction = friction_of(contact)
        contact_structure = add_friction_pairs(contact, structure)
        self.clearance = contact_structure.clearance
        self.modes = modes = all_modes(contact_structure)
        self.n_modes = len(modes.squares)
        self.size = 2 * self.n_modes + (structure.n_pairs if self.friction else 0)
        self.residual_flexibility = modes.static_pair_compliance()
        self.softness = spring_compliances(contact, structure.n_pairs)
        self.compliance = self.residual_flexibility + np.diag(self.softness)
        self.modal_load = np.ascontiguousarray(structure.force @ modes.shapes)
        self.load_gap = np.zeros((len(self.modal_load), len(self.softness)))
        if modes.massless_flexibility is not None:
            self.load_gap += contact_structure.apply_bt(
                structure.force @ modes.massless_flexibility
            )
        self.load_gap[0] -= self.clearance

    def state(
        self, displacement: np.ndarray, velocity: np.ndarray, places: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the states (..., size) of displacements and velocities (..., n_dofs).

        ``places`` (..., n_pairs) [m] are the sticking pairs' gaps h. Default: the tangential gaps
        without contact forces.
        """
        inverse, n_pairs = self.modes.inverse.T, self.structure.n_pairs
        parts = [displacement @ inverse, velocity @ inverse]
        if self.friction:
            if places is None:
                places = parts[0] @ self.modes.pairs[:, n_pairs:] + self.load_gap[0, n_pairs:]
            parts.append(places)
        return np.concatenate(parts, axis=-1)

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
        states : (n, size)
        force : (n, n_rows) [N]
            Contact forces.
        phase : (n,) [rad]
            Phases of the load.
        dofs : array or slice
            Default: all dofs of the structure.
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
        force : (n, n_rows) [N]
            Contact forces.
        load_basis : (n, 2K+1)
            Basis functions of the load: 1, cosine and sine of each order.
        dofs : array or slice
        rows : (m, n_dofs), optional
            Factors; return products of rows with the displacement instead: (n, m).
        """
        modes = self.modes

        def select(motions: np.ndarray) -> np.ndarray:
            """Return the requested rows of motions (n_dofs, k)."""
            return motions[dofs] if rows is None else rows @ motions

        displacement: np.ndarray = modal_displacement @ select(modes.shapes).T
        if modes.massless_flexibility is not None and modes.massless_pair_responses is not None:
            displacement += (
                load_basis @ select((self.structure.force @ modes.massless_flexibility).T).T
            )
            displacement -= force @ select(modes.massless_pair_responses).T
        return displacement


# --- exact ----------------------------------------------------------------------------------------


class ContactFlow(Flow):
    """Exact flow, without time steps, from one contact event to the next."""

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        super().__init__(structure, contact)
        modes, n_pairs = self.modes, structure.n_pairs
        closed_forces = np.linalg.solve(self.compliance, modes.pairs.T)
        stiffness = np.diag(modes.squares) + modes.pairs @ closed_forces
        self.max_rate = _bound_rates(float(np.linalg.eigvalsh(stiffness)[-1]), modes.damping)
        """Upper bound of oscillation and decay rates, for any set of closed pairs [1/s]."""
        self.max_open_rate = _bound_rates(float(modes.squares.max()), modes.damping)
        """Upper bound of these rates while all pairs are open [1/s]."""
        coefficients = None
        if self.friction:
            coefficients = np.broadcast_to(self.friction.coefficient, n_pairs).astype(float)
        parts = Struct(
            "flow_parts", modes=self.n_modes, pairs=n_pairs, friction=coefficients,
            coupled=modes.damping.ndim == 2, squares=as_doubles(modes.squares),
            damping=as_doubles(modes.damping),
            rows=as_doubles(modes.pairs.T), compliance=as_doubles(self.compliance),
            force=self.modal_load,
            harmonics=len(self.modal_load) // 2,
            gap=self.load_gap, max_rate=self.max_rate, max_open_rate=self.max_open_rate,
            max_set_numbers=int(SETS_MEMORY_FRACTION * machine_memory()) // 8,
        )  # fmt: skip
        self.handle = attach_destructor(kernel.new_flow(parts.address), kernel.free_flow)
        """The kernel's flow."""
        self._max_intervals = 0

    @cached_property
    def critical_friction(self) -> float:
        """Return the smallest friction coefficient without unique contact forces.

        The matrix A(mu) from forces to gaps is then singular, on closed pairs' normals and stuck
        pairs' tangents. Roots mu are sought in 400 random states of the pairs; without a root the
        result is infinite. With the rows D_rows of the compliance R_inf + I/kappa,

            A = D_rows (E_0 + mu E_1).

        E_0 places the forces in all rows, and E_1 adds the friction of slipping pairs. So mu = -1
        / (a real negative eigenvalue of (D_rows E_0)^-1 D_rows E_1).
        """
        n_pairs, critical_coefficients = self.structure.n_pairs, [np.inf]
        for states in np.random.default_rng(1).integers(0, 4, (400, n_pairs)):
            closed_pairs = np.flatnonzero(states)
            stuck_pairs = np.flatnonzero(states == kernel.STICK)
            rows = np.concatenate([closed_pairs, n_pairs + stuck_pairs])
            row_compliance = self.compliance[rows]
            friction_matrix = np.zeros((len(rows), len(rows)))
            slip_signs = 1.0 * (states == kernel.SLIP_UP) - (states == kernel.SLIP_DOWN)
            tangent_columns = row_compliance[:, n_pairs + closed_pairs]
            friction_matrix[:, : len(closed_pairs)] = tangent_columns * slip_signs[closed_pairs]
            eigenvalues = np.linalg.eigvals(
                np.linalg.solve(row_compliance[:, rows], friction_matrix)
            )
            is_negative = (eigenvalues.imag == 0.0) & (eigenvalues.real < 0.0)
            critical_coefficients.extend(-1.0 / eigenvalues.real[is_negative])
        return float(min(critical_coefficients))

    @cached_property
    def rest_state(self) -> np.ndarray:
        """Return the state of rest under the mean load: (size,).

        The state has no rigid-body motion, and no tangential forces.
        """
        modes, n_pairs = self.modes, self.structure.n_pairs
        modal_flexibility = np.zeros_like(modes.squares)
        np.divide(1.0, modes.squares, out=modal_flexibility, where=modes.squares > 0.0)
        normals, compliance = modes.pairs[:, :n_pairs], self.compliance[:, :n_pairs]
        displacement_by_force = modal_flexibility[:, None] * normals
        # With all pairs open:
        displacement = modal_flexibility * self.modal_load[0]
        gap, force = displacement @ normals + self.load_gap[0, :n_pairs], np.zeros(n_pairs)
        if np.any(gap > 0.0):
            from scipy.optimize import nnls  # slow to import

            # D lambda - gap >= 0 and lambda >= 0, complementary, with D = L L^T: the minimum of
            # |L^T lambda - L^-1 gap|.
            cholesky_factor = np.linalg.cholesky(
                compliance[:n_pairs] + normals.T @ displacement_by_force
            )
            force = nnls(cholesky_factor.T, np.linalg.solve(cholesky_factor, gap))[0]
            displacement = displacement - displacement_by_force @ force
        parts = [displacement, np.zeros_like(displacement)]
        if self.friction:
            parts.append(
                (displacement @ modes.pairs + self.load_gap[0] - compliance @ force)[n_pairs:]
            )
        return np.concatenate(parts)

    def count_pieces(self, duration: float) -> float:
        """Return the number of Taylor pieces in a motion without events.

        The motion lasts ``duration`` [s].
        """
        return float(self.max_rate * duration / kernel.MAX_PIECE_ANGLE)

    def weights(self, base_omega: float) -> np.ndarray:
        """Return the weights w of a state z for the energy norm |w z|: (size,).

        Velocities have weight 1, and modal displacements the mode's frequency [rad/s], at least
        ``base_omega``.
        """
        weights = np.ones(self.size)
        np.sqrt(np.maximum(self.modes.squares, base_omega**2), out=weights[: self.n_modes])
        if self.friction:  # h deforms a spring as stiff as a single sticking pair
            stick_compliance = np.diag(self.compliance)[self.structure.n_pairs :]
            weights[2 * self.n_modes :] = 1.0 / np.sqrt(stick_compliance)
        return weights

    def amplitude_weights(self, base_omega: float) -> np.ndarray:
        """Return the weights w of a state z for the amplitude norm |w z|: (size,).

        Energy weights are divided by the mode's frequency, at least ``base_omega``, so modal
        displacements have weight 1. For h the divisor is the first mode's.
        """
        weights = self.weights(base_omega)
        rates = weights[: self.n_modes]
        place_rates = np.full(self.size - 2 * self.n_modes, rates[0])
        return weights / np.concatenate([rates, rates, place_rates])

    def advance(
        self,
        state: np.ndarray,
        omega: float,
        duration: float,
        *,
        start: float = 0.0,
        instants: np.ndarray | None = None,
        budget: Budget | None = None,
    ) -> Motion:
        """Integrate a motion from a state.

        Parameters
        ----------
        state : (size,)
        omega : float
            Load frequency [rad/s].
        duration, start : float [s]
            Length of the motion, and time at its start: the load's phase is ``omega`` times time.
        instants : (n,) [s], optional
            Ascending times of samples, between start and end.
        budget : Budget, optional

        Raises
        ------
        ConvergenceError
            The motion exceeds its budget, or is not finite.
        """
        end_state = np.array(state, dtype=float).reshape(self.size)
        instants = np.zeros(0) if instants is None else as_doubles(instants)
        n_instants, n_rows, n_pairs = len(instants), len(self.softness), self.structure.n_pairs
        states = np.empty((n_instants, 2 * self.n_modes))
        answers = np.empty((n_instants, 2 * n_rows if self.friction else n_rows))
        pair_states = np.empty((n_instants, n_pairs), dtype=np.int8)
        motion_struct, copy_track = self._make_motion_struct(
            budget, omega=omega, time=start, end=start + duration, state=end_state,
            n_instants=n_instants, instants=instants, states=states, answers=answers,
            closed=pair_states,
        )  # fmt: skip
        _check_outcome(
            kernel.flow_advance(self.handle, motion_struct.address), motion_struct.address.n_events
        )
        track = Track(self, omega, start, **copy_track(motion_struct.address.n_intervals))
        samples = Samples(self, omega, instants, states, answers, pair_states)
        n_events, n_pieces = (
            int(motion_struct.address.n_events),
            int(motion_struct.address.n_pieces),
        )
        return Motion(end_state, n_events, n_pieces, track, samples)

    def integrate_parts(
        self, states: np.ndarray, omega: float, period: float
    ) -> tuple[np.ndarray, Track, np.ndarray]:
        """Integrate n motions over n equal parts of a period.

        Parameters
        ----------
        states : (n, size)
            States at the starts of the parts; the first part begins at time zero.

        Returns
        -------
        end_states : (n, size)
            States at the ends of the parts.
        track : Track
            States of the pairs in all intervals between events, part after part.
        interval_counts : (n,) int
            Number of intervals up to each part's end.

        Raises
        ------
        ConvergenceError
            The motion exceeds its budget, or is not finite.
        """
        states = as_doubles(states)
        end_states, interval_counts = np.empty_like(states), np.empty(len(states), dtype=np.intc)
        motion_struct, copy_track = self._make_motion_struct(None, omega=omega)
        outcome = kernel.flow_advance_parts(
            self.handle, motion_struct.address, len(states), period, pointer(states),
            pointer(end_states), pointer(interval_counts),
        )  # fmt: skip
        _check_outcome(outcome, motion_struct.address.n_events)
        track = Track(self, omega, 0.0, **copy_track(motion_struct.address.n_intervals))
        return end_states, track, interval_counts

    def _make_motion_struct(
        self, budget: Budget | None, **members: Any
    ) -> tuple[Struct, Callable[[int], dict[str, np.ndarray]]]:
        """Return the C struct ``flow_motion``, and a function to copy the track.

        The function takes the number of intervals between events, and returns a :class:`Track`'s
        arrays by name.
        """
        budget = budget or Budget()
        if self._max_intervals < budget.intervals:
            self._max_intervals = max_intervals = budget.intervals
            sets = np.empty((max_intervals, self.structure.n_pairs), np.int8)
            self._track_arrays = {"sets": sets, "lengths": np.empty(max_intervals)}
            if self.friction:
                friction_kinds = {"causes": np.intc, "is_first": np.int8, "ratios": float}
                self._track_arrays |= {
                    name: np.empty(max_intervals, kind) for name, kind in friction_kinds.items()
                }
            self._base_struct = Struct("flow_motion", **self._track_arrays)
        arrays = self._track_arrays
        limits = {"max_pieces": budget.pieces, "max_intervals": budget.intervals}

        def copy_track(n_intervals: int) -> dict[str, np.ndarray]:
            return {name: array[:n_intervals].copy() for name, array in arrays.items()}

        return self._base_struct.with_members(**limits, **members), copy_track


@dataclass(frozen=True)
class Track:
    """States of the pairs in the intervals between a motion's events.

    Attributes
    ----------
    flow : ContactFlow
    omega, start : float
        Load frequency [rad/s] and start of the motion [s].
    sets : (n, n_pairs) int
        States of the pairs: 0 open, 1 closed; with friction 1 sticking, 2 and 3 slipping.
    lengths : (n,) [s]
        Durations of the intervals.
    causes, is_first, ratios : (n,)
        With friction, the ends of intervals. ``causes``: index of the force or gap function at zero
        (-1: none); ``is_first``: 1 for the first zero at an instant; ``ratios``: ratio of rates
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

    def share(self, is_selected: np.ndarray) -> float:
        """Return the fraction of time in which pairs are in selected states.

        ``is_selected`` is (n, n_pairs) bool. The result is the mean over the pairs.
        """
        return float(self.lengths @ is_selected.mean(axis=1) / self.lengths.sum())

    @cached_property
    def _struct(self) -> Struct:
        members = {name: member for name, member in vars(self).items() if name != "flow"}
        return Struct("flow_track", n_intervals=len(self.lengths), **members)

    @cached_property
    def tangent(self) -> np.ndarray:
        """Return dz(end) / dz(start), the derivative of the state z: (size, size)."""
        matrix = np.empty((self.flow.size, self.flow.size))
        outcome = kernel.flow_tangent(self.flow.handle, self._struct.address, pointer(matrix))
        _check_outcome(outcome, len(self.lengths) - 1)
        return matrix

    def derivative_by_softness(self, start: np.ndarray, softness_rate: np.ndarray) -> np.ndarray:
        """Return the derivative of the end state by a structural parameter: (size,).

        The state at the start does not change with the parameter.

        Parameters
        ----------
        start : (size,)
            State at the start.
        softness_rate : (n_rows,)
            Derivative of 1 / kappa of each contact row by the parameter.
        """
        derivative = np.empty(self.flow.size)
        rates = require_shape(softness_rate, *self.flow.softness.shape)
        outcome = kernel.flow_by_structure(
            self.flow.handle, self._struct.address, pointer(as_doubles(start)), NULL,
            pointer(rates), pointer(derivative),
        )  # fmt: skip
        _check_outcome(outcome, len(self.lengths) - 1)
        return derivative

    def __matmul__(self, change: np.ndarray) -> np.ndarray:
        """Return the end state's change for a change (size,) of the start state."""
        interval_counts = np.array([len(self.lengths)], dtype=np.intc)
        return np.asarray(
            self.carry_changes(change, np.zeros((1, self.flow.size)), interval_counts)[-1]
        )

    def carry_changes(
        self, start: np.ndarray, excess: np.ndarray, interval_counts: np.ndarray
    ) -> np.ndarray:
        """Carry a change d of the state through consecutive parts of the track.

            d_{i+1} = M_i d_i + excess_i,    M_i = derivative of the flow over part i

        Parameters
        ----------
        start : (size,)
            d_0.
        excess : (n, size)
            Change added at each part's end.
        interval_counts : (n,) int
            Number of intervals up to each part's end.

        Returns
        -------
        (n + 1, size)
            d at the start of each part, and at the end.
        """
        changes = np.empty((len(interval_counts) + 1, self.flow.size))
        changes[0] = start
        outcome = kernel.flow_carry_changes(
            self.flow.handle, self._struct.address, len(interval_counts), pointer(interval_counts),
            pointer(as_doubles(excess)),
            pointer(changes),
        )  # fmt: skip
        _check_outcome(outcome, len(self.lengths) - 1)
        return changes


@dataclass(frozen=True)
class Samples:
    """A motion at instants.

    Attributes
    ----------
    time : (n,) [s]
    states : (n, 2 n_modes)
        q and q'.
    pair_states : (n, n_pairs) int
        States of the pairs as in :class:`Track`.
    """

    flow: ContactFlow
    omega: float
    time: np.ndarray
    states: np.ndarray
    answers: np.ndarray
    """(n, n_pairs): closed pairs' forces [N], open pairs' openings [m]. With friction (n, 4
    n_pairs): forces on all rows, then gaps less the deformation of the contact springs."""
    pair_states: np.ndarray

    @property
    def is_closed(self) -> np.ndarray:
        """Return True for closed pairs: (n, n_pairs) bool."""
        return self.pair_states > 0

    @cached_property
    def forces(self) -> np.ndarray:
        """Return normal contact forces, with friction then friction forces: (n, n_rows) [N]."""
        if self.flow.friction:
            return self.answers[:, : len(self.flow.softness)]
        return np.where(self.is_closed, np.maximum(self.answers, 0.0), 0.0)

    @cached_property
    def gaps(self) -> np.ndarray:
        """Return normal gaps, with friction then tangential gaps: (n, n_rows) [m]."""
        spring_gaps = self.forces * self.flow.softness
        if self.flow.friction:
            return self.answers[:, len(self.flow.softness) :] + spring_gaps
        return np.where(self.is_closed, spring_gaps, -self.answers)

    @property
    def places(self) -> np.ndarray:
        """Return tangential gaps h of sticking pairs: (n, n_pairs) [m].

        If a pair does not stick, h follows the motion. Without friction: (n, 0).
        """
        return self.answers[:, len(self.flow.softness) + self.flow.structure.n_pairs :]

    @property
    def whole_states(self) -> np.ndarray:
        """Return the flow's states q, q' and, with friction, sliding places h: (n, size)."""
        return np.hstack([self.states, self.places])

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

    def products(self, rows: np.ndarray) -> np.ndarray:
        """Return products of rows (m, n_dofs) with the displacement: (n, m)."""
        flow, modal_displacement = self.flow, self.states[:, : self.flow.n_modes]
        load_basis = fourier_basis_for(flow.modal_load, self.omega * self.time)
        return flow.combine_displacement(modal_displacement, self.forces, load_basis, rows=rows)


class Motion(NamedTuple):
    """A motion that has been integrated.

    Attributes
    ----------
    state : (size,)
        State at the end.
    events, pieces : int
        Number of events (a pair opens, closes, sticks or slips), and of Taylor pieces.
    track : Track
    samples : Samples
    """

    state: np.ndarray
    events: int
    pieces: int
    track: Track
    samples: Samples


def _bound_rates(max_square: float, damping: np.ndarray) -> float:
    """Return an upper bound of oscillation and decay rates [1/s].

    Roots s of s^2 + c s + k = 0 have no larger |s| for all k <= ``max_square`` [1/s^2] and all
    Rayleigh quotients c of the damping [1/s].
    """
    max_damping = float(np.linalg.norm(damping, 2 if damping.ndim == 2 else np.inf))
    if damping.ndim == 2 and not np.allclose(damping, damping.T):  # c is complex
        return 0.5 * (max_damping + float(np.sqrt(max_damping**2 + 4.0 * max(max_square, 0.0))))
    return max(float(np.sqrt(max(max_square, 0.0))), max_damping)


def _check_outcome(outcome: int, events: int) -> None:
    """Raise the error for a failure code of the kernel's integration.

    ``events`` is the number of events before the failure, for the message.
    """
    if outcome == kernel.FLOW_DONE:
        return
    if outcome == kernel.FLOW_NO_MEMORY:
        raise MemoryError("exact flow")
    reasons = {
        kernel.FLOW_TOO_MANY_PIECES: "the highest modes are too fast for that long",
        kernel.FLOW_TOO_MANY_INTERVALS: "the pairs open and close without end",
        kernel.FLOW_FAILED: "the motion is not finite, or its contact forces have not one solution",
    }
    error = BudgetError if outcome == kernel.FLOW_TOO_MANY_PIECES else ConvergenceError
    raise error(f"events: {reasons[outcome]} (after {events} events)")


def as_doubles(array: np.ndarray) -> np.ndarray:
    """Return an array as the kernel reads it: contiguous, of doubles."""
    return np.ascontiguousarray(array, dtype=float)
