"""Periodic orbits of the exact flow, by shooting.

Let z be the state at phase zero, T = 2 pi m / omega the period with m load periods, and M the
derivative of the flow over T. An orbit solves

    F(z) = z(T) - z = 0,      dF/dz = M - I.

The eigenvalues of M are the orbit's Floquet multipliers. A Newton step is shortened until the
*natural* test accepts the step: the simplified step from the new state, with the same M, must be
shorter. This test does not depend on the scaling of the state.

M is kept over several steps and updated by Broyden's "good" method, for as long as each step is at
most a tenth of the step before. The first M may come from a nearby motion.

With many modes M is not formed. GMRES takes products with M in the energy norm; a product costs
half of a period's integration. Damping leaves little of fast modes, so some dozen products suffice.

One Newton step for the whole motion assesses a nearby harmonic-balance solution, without an orbit.
The solution has the states Z_i at N equal parts of the period. With M_i the derivative of the flow
over part i, and F_i its end state less Z_{i+1},

    d_{i+1} = M_i d_i + F_i,   periodic;       predicted error = |P^T d| / |P^T Z|.

P^T takes modal displacements to gaps.

References
----------
Deuflhard, Newton Methods for Nonlinear Problems, 2004, sections 2.1 and 3.3.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dgeev

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import Described, format_count, hertz_property
from fenics_crack.kernel import kernel
from fenics_crack.model.structure import Structure
from fenics_crack.motion.energy import EnergyBudget, far_frequency, load_works
from fenics_crack.motion.flow import (
    FEWER_EVENTS_ADVICE,
    Budget,
    BudgetError,
    ContactFlow,
    IntegratedMotion,
    Samples,
    Track,
)
from fenics_crack.motion.gauss_pieces import GaussPieces
from fenics_crack.motion.motions import MotionRecord, ObservedMotion
from fenics_crack.numerics.equations import (
    ROOT_TOLERANCE,
    SPECIAL_POINT_TOLERANCE,
    factorise_transpose,
    solve_by_factors_of_transpose,
)
from fenics_crack.numerics.fourier import fourier_coefficients
from fenics_crack.numerics.newton import FORCING_TERM, change_relative_to_motion, gmres

MAX_PERIODS_IN_NEWTON_SEARCH = 20
"""Maximum number of periods that Newton's method integrates in one search for an orbit."""
MIN_NEWTON_DAMPING = 1e-3
"""Minimum factor of a shortened Newton step; a search that needs a smaller one fails."""
MAX_TAYLOR_PIECES_PER_ORBIT_SEARCH = 20_000
"""Maximum number of Taylor pieces (intervals with a single Taylor series) in a search: about a
second, with many pairs. With up to 120 modes the maximum is larger if 20 periods without events
need more, unless the load is too slow (:func:`is_load_too_slow`)."""
MAX_MODES_FOR_MONODROMY = 120
"""Maximum modes for which Floquet multipliers are computed from the monodromy matrix M."""
MAX_MODES_FOR_NEWTON_MATRIX = 240
"""Maximum modes for which Newton's method for orbits forms M; more modes use GMRES.

With 240 modes of a plate, GMRES takes ten times as long.
"""
MAX_GMRES_PRODUCTS = 60
"""Maximum products with the monodromy matrix in a solution by GMRES."""
SIMPLIFIED_STEP_GMRES_TOLERANCE = 0.25
"""Relative residual of GMRES for a simplified step, needed in the natural test."""
MULTIPLIER_TOLERANCE = 1e-6
"""Accuracy of Floquet multipliers mu. A smaller distance ||mu| - 1| does not tell the stability.
Orbits must also close to this relative accuracy."""
NEUTRAL_MULTIPLIER_TEXT = (
    "the largest Floquet multiplier has modulus 1 within its accuracy, as at a bifurcation or "
    "without damping: change the load frequency a little, or add [damping]"
)
"""Reason for undecided stability if the largest ||mu| - 1| is inconclusive."""
INSTANTS_PER_BLOCK = 2048
"""Number of instants with sines and cosines in memory together, for all harmonics."""
INSTANTS_PER_PERIOD = 512
"""Instants per period in the samples of an orbit."""
OBSERVED_HARMONICS = 40
"""Number of harmonics in an orbit's record. With n instants, harmonic n - k is aliased onto k. In
motions with kinks the relative error is (k / (n - k))^2: for k = 40 at most 0.7 % with 512
instants, 3.4 % with a curve's 256."""


IMinusMSolver = Callable[[np.ndarray, float], np.ndarray]
"""Function from a vector b and a relative residual to (I - M)^-1 b, with the monodromy matrix M. If
M is formed, the solution is exact and the residual has no effect."""


class OrbitPrediction(NamedTuple):
    """Result of one Newton step from a solution's states Z to Z + d, towards an orbit.

    Attributes
    ----------
    relative_gap_error : float
        Predicted error in the gaps, |P^T d| / |P^T Z|; P^T takes modal displacements to gaps. In
        the divisor |P^T Z| the mean over time is limited to the oscillation.
    states : (n, flow.state_size)
        Z + d at the starts of n equal parts of the period.
    contact_track_of_solution : Track
        States of the pairs along the solution, part after part.
    solve_i_minus_m : IMinusMSolver
        Returns (I - M)^-1 b, with the monodromy matrix M along the solution.
    """

    relative_gap_error: float
    states: np.ndarray
    contact_track_of_solution: Track
    solve_i_minus_m: IMinusMSolver

    @property
    def monodromy(self) -> np.ndarray:
        """Return the monodromy matrix along the solution: (flow.state_size, flow.state_size)."""
        return self.contact_track_of_solution.derivative_of_end_state


@keep_old_attribute_names(
    flows="n_periods_integrated_by_newton",
    stuck="always_stuck_pair_indices",
    work="energy_budget",
    events="n_events",
    inverse="i_minus_m_solver",
    sampled="period_samples",
    sliding="friction_number_by_name",
)
@dataclass(frozen=True, repr=False)
class PeriodicOrbit(ObservedMotion, Described):
    """A periodic orbit of the exact flow.

    Attributes
    ----------
    flow : ContactFlow
    omega : float
        Frequency of the load [rad/s].
    subharmonic : int
        Number of load periods in the orbit's period.
    motion : IntegratedMotion
        Motion over the period.
    state : (flow.state_size,)
        State z at phase zero of the load: modal displacements q and velocities q', with friction
        also the pairs' slider positions h.
    n_periods_integrated_by_newton : int
        Number of periods integrated by Newton's method.
    """

    flow: ContactFlow
    omega: float
    subharmonic: int
    motion: IntegratedMotion
    state: np.ndarray
    n_periods_integrated_by_newton: int

    frequency = hertz_property()

    @property
    def period(self) -> float:
        """Return the period [s]."""
        return 2.0 * np.pi * self.subharmonic / self.omega

    @property
    def iterations(self) -> int:
        """Return the number of Newton steps, rejected steps included."""
        return self.n_periods_integrated_by_newton - 1

    @property
    def n_events(self) -> int:
        """Return the number of events in a period: a pair opens, closes, sticks or slips.

        Under the layered law two more events count: a layer is compressed to its depth, or relaxes.
        """
        return self.motion.n_events

    @property
    def monodromy(self) -> np.ndarray:
        """Return the monodromy matrix M = dz(T) / dz(0): (flow.state_size, flow.state_size).

        z is the state, and T the period.
        """
        return self.motion.track.derivative_of_end_state

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Return the Floquet multipliers in descending modulus: (flow.state_size,) complex."""
        return eigenvalues(self.monodromy)

    @cached_property
    def residual(self) -> float:
        """Return the state's relative change in a period, ``|z(T) - z(0)| / |z(0)|``.

        The norm is the energy norm; z is the state and T the period. Without motion, the change is
        absolute.
        """
        state_change = self.motion.state - self.state
        return self.energy_norm(state_change) / (self.energy_norm(self.state) or 1.0)

    def energy_norm(self, state_change: np.ndarray) -> float:
        """Return the energy norm of a state's change (flow.state_size,).

        The square is about twice the kinetic and elastic energy in the change.
        """
        return float(
            np.linalg.norm(self.flow.energy_weights(self.omega / self.subharmonic) * state_change)
        )

    @cached_property
    def i_minus_m_solver(self) -> IMinusMSolver:
        """Return the function from b to (I - M)^-1 b, with the monodromy matrix M.

        Raises LinAlgError if I - M is singular.
        """
        energy_weights = self.flow.energy_weights(self.omega / self.subharmonic)
        return _make_i_minus_m_solver(self.flow, self.motion.track, energy_weights)

    def samples(self, time: np.ndarray) -> Samples:
        """Return the motion at ascending times [s] between 0 and the period."""
        return self.flow.advance(self.state, self.omega, self.period, instants=time).samples

    def _samples_array_at(self, time: np.ndarray, samples_attribute: str) -> np.ndarray:
        """Return an array of :class:`Samples` at any times [s]: (len(time), ...).

        ``samples_attribute`` names the array. Times may have any order, and lie outside the period.
        """
        sample_times, sample_index_of_time = np.unique(
            np.mod(time, self.period), return_inverse=True
        )
        return np.asarray(
            getattr(self.samples(sample_times), samples_attribute)[sample_index_of_time.ravel()]
        )

    @cached_property
    def period_samples(self) -> Samples:
        """Return the motion at 512 equally spaced times of the period."""
        return self.samples(np.arange(INSTANTS_PER_PERIOD) * self.period / INSTANTS_PER_PERIOD)

    @property
    def is_stable(self) -> bool:
        """Return True if all multipliers lie inside the unit circle."""
        return bool(abs(self.multipliers[0]) < 1.0)

    @property
    def gap(self) -> np.ndarray:
        """Return the normal gaps at 512 equally spaced times: (512, n_pairs) [m]."""
        return self.period_samples.gap

    def gap_at(self, time: np.ndarray) -> np.ndarray:
        """Return the normal gaps at times [s]: (len(time), n_pairs) [m]."""
        return self._samples_array_at(time, "gap")

    def tangential_gap_at(self, time: np.ndarray) -> np.ndarray:
        """Return the tangential gaps at times [s]: (len(time), n_pairs) [m].

        Without friction: (len(time), 0).
        """
        return self._samples_array_at(time, "gaps")[:, self.flow.structure.n_pairs :]

    def tangential_force_at(self, time: np.ndarray) -> np.ndarray:
        """Return the friction force at times [s]: (len(time), n_pairs) [N].

        Without friction: (len(time), 0).
        """
        return self._samples_array_at(time, "forces")[:, self.flow.structure.n_pairs :]

    def force_at(self, time: np.ndarray) -> np.ndarray:
        """Return the contact force at times [s]: (len(time), n_pairs) [N]."""
        return self._samples_array_at(time, "force")

    def displacement_at(self, time: np.ndarray) -> np.ndarray:
        """Return the displacement of the structure at times [s]: (len(time), n_dofs) [m]."""
        return self._samples_array_at(time, "displacement")

    @property
    def structure(self) -> Structure:  # type: ignore[override]
        """Return the structure that vibrates."""
        return self.flow.structure

    def yield_motion_records(
        self, rows: np.ndarray, instants: int | None = None
    ) -> Iterator[MotionRecord]:
        """Yield the motion's :class:`MotionRecord` over a period: displacements, gaps and forces.

        At any time, the motion is interpolated by polynomials through Gauss nodes, with a
        polynomial for each piece of the period between events.

        Parameters
        ----------
        rows : (m, n_dofs)
            Factors: each row times the displacement is an observed displacement.
        instants : int, optional
            Number of instants. Default: 512, and the record also has the exact closed, stick and
            slip shares and the friction loss.
        """
        gauss_samples, gauss_pieces = self._gauss_samples_and_pieces(
            len(self.flow.modal_load) // 2 * self.omega
        )
        columns_of_quantities = (
            gauss_samples.row_products(rows),
            gauss_samples.gaps,
            gauss_samples.forces,
        )
        node_values = np.hstack(columns_of_quantities)
        quantity_column_splits = np.cumsum(
            [quantity_columns.shape[1] for quantity_columns in columns_of_quantities]
        )[:2]

        def interpolate_at(period_fractions: np.ndarray) -> Any:
            """Return row products, gaps and forces at positions in the period, 0 to 1."""
            time = self.period * np.mod(period_fractions, 1.0)
            values = gauss_pieces.interpolate(node_values, time)
            return np.split(values, quantity_column_splits, axis=1)

        n_instants = instants or INSTANTS_PER_PERIOD
        exact_numbers = self.energy_budget.shares if self.structure.n_pairs else {}
        period_fractions = np.arange(n_instants) / n_instants
        row_products, gaps_at_instants, contact_forces_at_instants = interpolate_at(
            period_fractions
        )
        if instants is None:
            exact_numbers |= self.friction_number_by_name
            if gaps_at_instants.size:
                exact_numbers["closed_share"] = self.motion.track.closed_share
        yield MotionRecord(
            self.omega, self.subharmonic, self.period * period_fractions,
            fourier_coefficients(row_products, OBSERVED_HARMONICS),
            row_products, gaps_at_instants, contact_forces_at_instants,
            structure=self.structure,
            friction_coefficient=getattr(self.flow.friction_law, "coefficient", None),
            evaluate_at_period_fractions=interpolate_at,
            exact_number_by_name=exact_numbers,
        )  # fmt: skip

    def coefficients(self, harmonics: int) -> RealFourierCoefficients:
        """Return Fourier coefficients of gaps, contact forces and displacements.

        ``harmonics`` is the highest harmonic H of the orbit's period. Gauss quadrature integrates
        the pieces of the period. Within a piece no pair opens, closes, sticks or slips.
        """
        gauss_samples = self._gauss_samples_and_pieces(harmonics * self.omega / self.subharmonic)[0]
        gaps_at_gauss_nodes, contact_forces_at_gauss_nodes, n_modes = (
            gauss_samples.gaps,
            gauss_samples.forces,
            self.flow.n_modes,
        )
        node_values = np.hstack(
            [gaps_at_gauss_nodes, contact_forces_at_gauss_nodes, gauss_samples.states[:, :n_modes]]
        )
        quantity_column_splits = np.cumsum(
            [gaps_at_gauss_nodes.shape[1], contact_forces_at_gauss_nodes.shape[1]]
        )
        stacked_coefficients = self._integrate_coefficients(node_values, harmonics)
        gap_coefficients, force_coefficients, modal_coefficients = np.split(
            stacked_coefficients, quantity_column_splits, axis=1
        )
        load_orders = np.arange(1, len(self.flow.modal_load) + 1) // 2
        load_coefficient_indices = np.arange(len(self.flow.modal_load)) + 2 * load_orders * (
            self.subharmonic - 1
        )
        load_selection_matrix = np.equal.outer(
            np.arange(len(stacked_coefficients)), load_coefficient_indices
        ).astype(float)
        displacement_coefficients = self.flow.combine_displacement(
            modal_coefficients, force_coefficients, load_selection_matrix
        )
        return RealFourierCoefficients(
            gap_coefficients, force_coefficients, displacement_coefficients
        )

    def product_coefficients(self, rows: np.ndarray, harmonics: int) -> np.ndarray:
        """Return Fourier coefficients of rows times the displacement: (2H+1, m).

        ``rows`` (m, n_dofs) are factors of the displacement, and ``harmonics`` is H.
        """
        gauss_samples = self._gauss_samples_and_pieces(harmonics * self.omega / self.subharmonic)[0]
        return self._integrate_coefficients(gauss_samples.row_products(rows), harmonics)

    def _integrate_coefficients(self, node_values: np.ndarray, harmonics: int) -> np.ndarray:
        """Return Fourier coefficients (2H+1, m) from values (n, m) at all Gauss nodes.

        ``harmonics`` is H.
        """
        base_omega = self.omega / self.subharmonic
        gauss_pieces = self._gauss_samples_and_pieces(harmonics * base_omega)[1]
        time_weights = gauss_pieces.node_weights / self.period
        cosine_sine_coefficients = np.zeros((2 * harmonics + 1, node_values.shape[1]))
        basis_buffer = np.empty((len(cosine_sine_coefficients), INSTANTS_PER_BLOCK))
        for slice_start in range(0, len(node_values), INSTANTS_PER_BLOCK):
            sample_slice = slice(slice_start, slice_start + INSTANTS_PER_BLOCK)
            base_phasor = np.exp(1j * base_omega * gauss_pieces.node_times[sample_slice])
            weighted_basis = basis_buffer[:, : len(base_phasor)]
            weighted_phasor = 2.0 * time_weights[sample_slice] * base_phasor
            weighted_basis[0] = time_weights[sample_slice]
            # Products take a tenth of the time of sines and cosines.
            for harmonic_order in range(1, harmonics + 1):
                weighted_basis[2 * harmonic_order - 1], weighted_basis[2 * harmonic_order] = (
                    weighted_phasor.real,
                    weighted_phasor.imag,
                )
                weighted_phasor *= base_phasor
            cosine_sine_coefficients += weighted_basis @ node_values[sample_slice]
        return cosine_sine_coefficients

    def _gauss_samples_and_pieces(self, max_wave_omega: float) -> tuple[Samples, GaussPieces]:
        """Return the motion at Gauss nodes in all pieces of the period, and the pieces.

        The rate of an interval between events is the sum of two rates [rad/s]: ``max_wave_omega``,
        the highest frequency to integrate, and the largest rate of the motion itself. The samples
        for the highest frequency so far are kept.
        """
        if not self._gauss_sample_cache or self._gauss_sample_cache[-1][0] < max_wave_omega:
            track, flow = self.motion.track, self.flow
            interval_has_closed_pair = track.sets.any(axis=1)
            rate_bounds = np.where(
                interval_has_closed_pair, flow.mode_rate_bound, flow.open_mode_rate_bound
            )
            gauss_pieces = GaussPieces(track.lengths, rate_bounds + max_wave_omega)
            self._gauss_sample_cache[:] = [
                (max_wave_omega, self.samples(gauss_pieces.node_times), gauss_pieces)
            ]
        return self._gauss_sample_cache[-1][1:]

    @cached_property
    def _gauss_sample_cache(self) -> list[tuple[float, Samples, GaussPieces]]:
        """Return the cache for samples at Gauss nodes, empty at first.

        Its only entry is (highest frequency [rad/s], samples, pieces).
        """
        return []

    @cached_property
    def energy_budget(self) -> EnergyBudget:
        """Work of load, damping and friction in the period.

        Gauss quadrature is exact to rounding. Rates of displacements and gaps are derivatives of
        polynomials through the values at Gauss nodes.
        """
        flow, structure, n_pairs = self.flow, self.structure, self.structure.n_pairs
        n_harmonics = len(structure.force) // 2 * self.subharmonic
        products = self.product_coefficients(structure.force, n_harmonics)
        samples, pieces = self._gauss_samples_and_pieces(len(structure.force) // 2 * self.omega)
        v = samples.states[:, flow.n_modes : 2 * flow.n_modes]
        friction = np.zeros(0)
        if flow.friction_law:
            friction = pieces.work(samples.forces[:, n_pairs:], samples.gaps[:, n_pairs:])
        return EnergyBudget(
            *load_works(products, self.subharmonic),
            pieces.node_weights @ (v * flow.modal_model.damping_force(v)),
            friction,
            np.sqrt(flow.modal_model.squares.clip(0.0)),
            far_frequency(structure, self.omega),
        )

    @cached_property
    def friction_number_by_name(self) -> dict[str, float]:
        """Return friction loss [J], stick share and slip share of the period.

        Keys are names of :class:`Indicators`. The shares are fractions of the period, as means over
        the pairs. A pair with two sliders, under the layered law, sticks while one of them sticks.
        Without friction the dictionary is empty.
        """
        if not self.flow.friction_law:
            return {}
        track = self.motion.track
        slider_states = track.sets.reshape(len(track.sets), -1, self.structure.n_pairs)
        is_sticking = np.any(slider_states == kernel.STICK, axis=1)
        is_slipping = np.any(slider_states > kernel.STICK, axis=1) & ~is_sticking
        return {
            "friction_loss": float(self.energy_budget.friction.sum()),
            "stick_share": track.mean_time_share_of_pairs(is_sticking),
            "slip_share": track.mean_time_share_of_pairs(is_slipping),
        }

    @property
    def always_stuck_pair_indices(self) -> np.ndarray:
        """Return the indices (k,) of pairs that always stick; none without friction.

        These pairs' slider positions follow from earlier motion, not from the orbit. The
        multipliers do not measure disturbances in such positions.
        """
        pair_states = self.motion.track.sets
        sticks_always = self.flow.friction_law is not None and np.all(
            pair_states == kernel.STICK, axis=0
        )
        return np.flatnonzero(sticks_always)

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers of the orbit by name.

        The numbers are the largest multiplier's modulus, opening and penetration [m] (0 without
        pairs), the relative residual, and the numbers of events and Newton iterations.
        """
        face_indicator_by_name = {"opening": 0.0, "penetration": 0.0} | self.face_indicators
        return {
            "multiplier": float(abs(self.multipliers[0])),
            "opening": face_indicator_by_name["opening"],
            "penetration": face_indicator_by_name["penetration"],
            "events": self.n_events,
            "residual": float(self.residual),
            "iterations": self.iterations,
        }

    def _repr_text(self) -> str:
        multiplier_text = (
            f"largest multiplier {abs(self.multipliers[0]):.6g} of {len(self.multipliers)}"
        )
        return (
            f"{multiplier_text}, {format_count(self.n_events, 'event')}, "
            f"residual {self.residual:.2g}"
        )


class RealFourierCoefficients(NamedTuple):
    """Fourier coefficients of an orbit: rows a0, a1, b1, ....

    Attributes
    ----------
    gap : (2H+1, n_columns) [m]
        Gaps of all pairs; with friction tangential gaps follow the normal gaps.
    force : (2H+1, n_columns) [N]
        Contact forces in the same order.
    displacement : (2H+1, n_dofs) [m]
        Displacement at all dofs.
    """

    gap: np.ndarray
    force: np.ndarray
    displacement: np.ndarray


@dataclass(frozen=True, repr=False)
class ApproximateOrbitInEqualParts(PeriodicOrbit):
    """Approximate orbit: exact motions over equal parts of a period.

    The state may jump from part to part. The methods of an exact orbit apply.

    Attributes
    ----------
    part_start_states : (n, flow.state_size)
        States at the starts of the parts.
    """

    part_start_states: np.ndarray

    def samples(self, time: np.ndarray) -> Samples:
        """Return the motion at ascending times [s] between 0 and the period."""
        part_duration = self.period / len(self.part_start_states)
        start_times = part_duration * np.arange(len(self.part_start_states) + 1)
        times_by_part = np.split(time, np.searchsorted(time, start_times[1:-1]))
        part_argument_tuples = zip(
            self.part_start_states, start_times.tolist(), times_by_part, strict=False
        )
        part_samples = [
            self.flow.advance(
                state, self.omega, part_duration, start=start_time, instants=instants
            ).samples
            for state, start_time, instants in part_argument_tuples
        ]
        array_tuples_of_parts = (
            (
                samples_of_part.states,
                samples_of_part.forces_and_openings,
                samples_of_part.pair_states,
            )
            for samples_of_part in part_samples
        )
        return Samples(
            self.flow,
            self.omega,
            time,
            *map(np.concatenate, zip(*array_tuples_of_parts, strict=True)),
        )


def is_orbit_search_affordable(
    flow: ContactFlow,
    omega: float,
    subharmonic: int = 1,
    n_periods: int = MAX_PERIODS_IN_NEWTON_SEARCH + MAX_GMRES_PRODUCTS,
) -> bool:
    """Return True if a search for an orbit does not take too long.

    True in two cases:

    - The flow has up to 120 modes, and the load is not too slow (:func:`is_load_too_slow`).
    - The flow has more modes, crack faces have no mass, and ``n_periods`` periods without events
      need at most 20,000 Taylor pieces, intervals with a single Taylor series.

    With more modes and mass at the crack faces, the result is False: crack faces bounce, and
    Newton's method fails to converge from harmonic-balance solutions.

    Parameters
    ----------
    flow : ContactFlow
    omega : float
        Load frequency [rad/s].
    subharmonic : int
        Number of load periods in the orbit's period.
    n_periods : int
        Number of periods to integrate in the search. Default: the most that a search takes.
    """
    if flow.n_modes <= MAX_MODES_FOR_MONODROMY:
        return not is_load_too_slow(flow, omega, subharmonic)
    pieces_per_period = flow.estimate_taylor_pieces(2.0 * np.pi * subharmonic / omega)
    return (
        flow.structure.has_massless_crack_faces
        and n_periods * pieces_per_period <= MAX_TAYLOR_PIECES_PER_ORBIT_SEARCH
    )


def is_load_too_slow(flow: ContactFlow, omega: float, subharmonic: int = 1) -> bool:
    """Return True if two periods need more than 100,000 Taylor pieces.

    A piece is an interval with a single Taylor series. Events are not counted. With more than 120
    modes the result is False.
    """
    pieces_per_period = flow.estimate_taylor_pieces(2.0 * np.pi * subharmonic / omega)
    return (
        flow.n_modes <= MAX_MODES_FOR_MONODROMY
        and 2.0 * pieces_per_period > Budget.max_taylor_pieces
    )


def predict_orbit_by_newton_step(
    flow: ContactFlow, omega: float, states: np.ndarray, subharmonic: int = 1
) -> OrbitPrediction | None:
    """Take a Newton step towards an orbit, for n instants together.

    Used to estimate the error of a harmonic-balance solution without a search for the orbit.

    Parameters
    ----------
    flow : ContactFlow
    omega : float
        Load frequency [rad/s].
    states : (n, flow.state_size)
        States of a solution at the starts of n equal parts of the period.
    subharmonic : int
        Number of load periods in the period.

    Returns
    -------
    OrbitPrediction or None
        None if the motion cannot be integrated, or if the equations are singular.
    """
    energy_weights = flow.energy_weights(omega / subharmonic)
    try:
        period = 2.0 * np.pi * subharmonic / omega
        part_end_states, contact_track_of_solution, cumulative_interval_counts = (
            flow.integrate_equal_parts_of_period(states, omega, period)
        )
        state_jumps_between_parts = part_end_states - np.concatenate([states[1:], states[:1]])
        period_end_change = contact_track_of_solution.carry_changes(
            np.zeros(flow.state_size), state_jumps_between_parts, cumulative_interval_counts
        )[-1]
        solve_i_minus_m = _make_i_minus_m_solver(flow, contact_track_of_solution, energy_weights)
        state_changes = contact_track_of_solution.carry_changes(
            solve_i_minus_m(period_end_change, FORCING_TERM),
            state_jumps_between_parts,
            cumulative_interval_counts,
        )[:-1]
    except (ConvergenceError, np.linalg.LinAlgError, ValueError):
        return None
    part_start_gaps = states[:, : flow.n_modes] @ flow.modal_model.gaps_by_mode
    part_start_gap_changes = state_changes[:, : flow.n_modes] @ flow.modal_model.gaps_by_mode
    return OrbitPrediction(
        change_relative_to_motion(part_start_gap_changes, part_start_gaps),
        states + state_changes,
        contact_track_of_solution,
        solve_i_minus_m,
    )


def predict_motion(
    flow: ContactFlow, omega: float, prediction: OrbitPrediction, subharmonic: int
) -> ApproximateOrbitInEqualParts | None:
    """Integrate the motion from a prediction's states; None if integration fails.

    Each state starts a motion over a part of the period, so the state jumps between the parts.
    """
    with suppress(ConvergenceError):
        period = 2.0 * np.pi * subharmonic / omega
        part_end_states, track, _ = flow.integrate_equal_parts_of_period(
            prediction.states, omega, period
        )
        motion = flow.advance(part_end_states[-1], omega, 0.0)._replace(track=track)
        return ApproximateOrbitInEqualParts(
            flow, omega, subharmonic, motion, prediction.states[0], 1, prediction.states
        )
    return None


def _make_i_minus_m_solver(
    flow: ContactFlow, track: Track, energy_weights: np.ndarray
) -> IMinusMSolver:
    """Return a function from b and a tolerance to the solution y of (I - M) y = b.

    M is the monodromy matrix along ``track``, the pairs' states over a period. With up to 240 modes
    I - M is factored here, and the tolerance is not used; LinAlgError if I - M is singular. With
    more modes GMRES solves to the relative tolerance in the norm |w b|, with w = ``energy_weights``
    (flow.state_size,).
    """
    if flow.n_modes <= MAX_MODES_FOR_NEWTON_MATRIX:
        i_minus_m_factors = factorise_transpose(
            np.eye(flow.state_size) - track.derivative_of_end_state
        )
        if not (np.isfinite(i_minus_m_factors[0]).all() and np.diag(i_minus_m_factors[0]).all()):
            raise np.linalg.LinAlgError("I - M is singular, as at a bifurcation or without damping")
        return lambda right_side, tolerance: solve_by_factors_of_transpose(
            i_minus_m_factors, right_side
        )

    def weighted_i_minus_m_product(weighted_change: np.ndarray) -> np.ndarray:
        """Return w (I - M) d from w d, with a state change d and energy weights w."""
        return weighted_change - energy_weights * (track @ (weighted_change / energy_weights))

    return lambda right_side, tolerance: (
        gmres(
            weighted_i_minus_m_product, energy_weights * right_side, tolerance, MAX_GMRES_PRODUCTS
        )
        / energy_weights
    )


def find_orbit(
    flow: ContactFlow,
    omega: float,
    state: np.ndarray,
    *,
    subharmonic: int = 1,
    solve_i_minus_m: IMinusMSolver | None = None,
    step_tolerance: float = SPECIAL_POINT_TOLERANCE,
    failure_reasons: list[str] | None = None,
) -> PeriodicOrbit | None:
    """Search for an orbit from a state by Newton's method.

    The search fails after 20 integrated periods, or if its budget of Taylor pieces is spent. A
    piece is an interval with a single Taylor series; the budget for all motions together is 20,000,
    or more for a slow load. An orbit's state must return after a period, with a relative error up
    to 1e-6.

    Parameters
    ----------
    flow : ContactFlow
    omega : float
        Load frequency [rad/s].
    state : (flow.state_size,)
        Guess at phase zero.
    subharmonic : int
        Number of load periods in the orbit's period.
    solve_i_minus_m : IMinusMSolver, optional
        Returns (I - M)^-1 b for the first steps, with the monodromy matrix M of a nearby motion.
    step_tolerance : float
        Maximum relative Newton step at the orbit. With more than 240 modes: 1.5e-8 in any case.
    failure_reasons : list of str, optional
        The reason is appended if the budget of pieces ends the search.

    Returns
    -------
    PeriodicOrbit or None
        None if the search fails.
    """
    newton_search = _NewtonOrbitSearch(flow, omega, subharmonic, state)
    try:
        if not newton_search.leads_to_orbit(solve_i_minus_m, step_tolerance):
            return None
    except (ConvergenceError, np.linalg.LinAlgError, ValueError) as error:
        if failure_reasons is not None and isinstance(error, BudgetError):
            budget_text = (
                f"its limit of {newton_search.max_taylor_pieces_in_search:,} Taylor series"
            )
            failure_reasons.append(
                f"the search for an exact orbit ended at {budget_text}; {FEWER_EVENTS_ADVICE}"
            )
        return None
    orbit = PeriodicOrbit(
        flow,
        omega,
        subharmonic,
        newton_search.motion,
        newton_search.state,
        newton_search.n_integrated_periods,
    )
    # If M is huge, a step may be short although the motion does not close.
    return orbit if orbit.residual <= MULTIPLIER_TOLERANCE else None


class _NewtonOrbitSearch:
    """Newton's method for states with z(T) = z(0) after a period T.

    Attributes
    ----------
    state : (flow.state_size,)
        Current state at phase zero.
    motion : IntegratedMotion
        Motion over a period from this state.
    n_integrated_periods : int
        Number of periods integrated so far.
    max_taylor_pieces_in_search : int
        Maximum Taylor pieces in all periods together.
    """

    def __init__(
        self, flow: ContactFlow, omega: float, subharmonic: int, state: np.ndarray
    ) -> None:
        self._flow, self._omega = flow, omega
        self._period = 2.0 * np.pi * subharmonic / omega
        max_taylor_pieces_in_search = MAX_TAYLOR_PIECES_PER_ORBIT_SEARCH
        if flow.n_modes <= MAX_MODES_FOR_MONODROMY and not is_load_too_slow(
            flow, omega, subharmonic
        ):
            max_taylor_pieces_in_search = max(
                max_taylor_pieces_in_search,
                math.ceil(MAX_PERIODS_IN_NEWTON_SEARCH * flow.estimate_taylor_pieces(self._period)),
            )
        self.max_taylor_pieces_in_search = self._remaining_pieces = max_taylor_pieces_in_search
        self._weights = flow.energy_weights(omega / subharmonic)
        self.state, self.n_integrated_periods = state, 0

    def energy_norm(self, state_change: np.ndarray) -> float:
        """Return the energy norm of a state's change (flow.state_size,)."""
        weighted_change = self._weights * state_change
        return math.sqrt(weighted_change @ weighted_change)

    def leads_to_orbit(self, solve_i_minus_m: IMinusMSolver | None, step_tolerance: float) -> bool:
        """Take Newton steps and return True if an orbit is reached.

        Each Newton step is multiplied by a damping factor d, at most 1. The simplified step is the
        next Newton step, computed with the same monodromy matrix M. The damped step is accepted if
        |simplified step| <= (1 - d / 4) |step|. Otherwise an old M is computed anew, or d is
        reduced. The next d follows from |simplified step - (1 - d) step|, 0 for a linear flow.

        Parameters
        ----------
        solve_i_minus_m : IMinusMSolver or None
            Returns (I - M)^-1 b for the first steps, with M of a nearby motion. None: M is
            computed.
        step_tolerance : float
            Maximum |simplified step| / |state| at the orbit. With more than 240 modes, 1.5e-8 is
            taken instead.
        """
        forms_monodromy = self._flow.n_modes <= MAX_MODES_FOR_NEWTON_MATRIX
        min_damping_factor = MIN_NEWTON_DAMPING if forms_monodromy else 0.1
        step_tolerance = step_tolerance if forms_monodromy else ROOT_TOLERANCE
        self.motion = self._integrate_period(self.state)
        damping_factor, is_m_current = 1.0, False  # is_m_current: M is that of self.motion
        newton_steps_with_same_m: list[np.ndarray] = []
        if forms_monodromy and solve_i_minus_m is not None:
            newton_steps_with_same_m = [
                solve_i_minus_m(self.motion.state - self.state, FORCING_TERM)
            ]
        while self.n_integrated_periods < MAX_PERIODS_IN_NEWTON_SEARCH:
            if solve_i_minus_m is None or not newton_steps_with_same_m:
                solve_i_minus_m = _make_i_minus_m_solver(
                    self._flow, self.motion.track, self._weights
                )
                is_m_current = True
                newton_steps_with_same_m = [
                    solve_i_minus_m(self.motion.state - self.state, FORCING_TERM)
                ]
            newton_step = newton_steps_with_same_m[-1]
            trial_state = self.state + damping_factor * newton_step
            trial_period_motion = self._integrate_period(trial_state)
            simplified_step = solve_i_minus_m(
                trial_period_motion.state - trial_state, SIMPLIFIED_STEP_GMRES_TOLERANCE
            )
            for broyden_step, next_broyden_step in pairwise(newton_steps_with_same_m):
                broyden_update_factor = self._fraction_along(simplified_step, broyden_step)
                simplified_step = simplified_step + broyden_update_factor * next_broyden_step
            step_size = self.energy_norm(newton_step)
            simplified_size = self.energy_norm(simplified_step)
            nonlinear_part_size = (
                self.energy_norm(simplified_step - (1.0 - damping_factor) * newton_step)
                + sys.float_info.min
            )
            trial_state_norm = self.energy_norm(trial_state)
            if not simplified_size <= (1.0 - 0.25 * damping_factor) * step_size:
                if (
                    step_size <= MULTIPLIER_TOLERANCE * trial_state_norm
                ):  # steps are rounding errors
                    return True
                if not is_m_current:
                    newton_steps_with_same_m = []
                    continue
                damping_factor = min(
                    0.5 * damping_factor, 0.5 * damping_factor**2 * step_size / nonlinear_part_size
                )
                if damping_factor < min_damping_factor:
                    return False
                continue
            self.state, self.motion, is_m_current = trial_state, trial_period_motion, False
            if simplified_size <= step_tolerance * trial_state_norm:
                return True
            # After a good step M serves once more.
            if forms_monodromy and damping_factor == 1.0 and simplified_size <= 0.1 * step_size:
                newton_steps_with_same_m.append(
                    simplified_step / (1.0 - self._fraction_along(simplified_step, newton_step))
                )
                continue
            newton_steps_with_same_m = []
            damping_factor = min(1.0, 0.5 * damping_factor**2 * step_size / nonlinear_part_size)
        return False

    def _fraction_along(self, change: np.ndarray, step: np.ndarray) -> float:
        """Return the part of a state change along a step, as a multiple c of the step.

        c ``step`` is the projection of ``change`` on ``step`` in the energy norm,
        (flow.state_size,) each.
        """
        step_times_squared_weights = self._weights**2 * step
        return float(change @ step_times_squared_weights / (step @ step_times_squared_weights))

    def _integrate_period(self, state: np.ndarray) -> IntegratedMotion:
        """Integrate a period from a state, with the remaining Taylor pieces as budget."""
        self.n_integrated_periods += 1
        budget = Budget(max_taylor_pieces=self._remaining_pieces)
        motion = self._flow.advance(state, self._omega, self._period, budget=budget)
        self._remaining_pieces -= motion.n_taylor_pieces
        return motion


def orbit_from_converged_state(
    flow: ContactFlow, omega: float, state: np.ndarray, subharmonic: int, iterations: int = 0
) -> PeriodicOrbit:
    """Return the orbit through a state (flow.state_size,) at phase zero, without a search.

    The state must belong to an orbit. ``iterations`` is the number of Newton steps to the state.
    """
    motion = flow.advance(state, omega, 2.0 * np.pi * subharmonic / omega)
    return PeriodicOrbit(flow, omega, subharmonic, motion, state, iterations + 1)


def is_same_orbit_in_phase(orbit: PeriodicOrbit, other_orbit: PeriodicOrbit) -> bool:
    """Return True if two orbits' states agree in the energy norm, to a relative 1e-6.

    An orbit with the same motion, but shifted in time, counts as another orbit.
    """
    energy_distance = orbit.energy_norm(orbit.state - other_orbit.state)
    return energy_distance <= MULTIPLIER_TOLERANCE * orbit.energy_norm(orbit.state)


def eigenvalues(matrix: np.ndarray) -> np.ndarray:
    """Return the eigenvalues of a monodromy matrix (n, n), descending in modulus: (n,) complex.

    LAPACK is called directly: for small matrices that takes a tenth of NumPy's time. LinAlgError:
    the matrix is not finite, or LAPACK does not converge.
    """
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("the monodromy matrix is not finite")
    real_parts, imaginary_parts, _, _, info = dgeev(matrix, compute_vl=0, compute_vr=0)
    if info:
        raise np.linalg.LinAlgError("eigenvalues of the monodromy matrix do not converge")
    multipliers: np.ndarray = real_parts + 1j * imaginary_parts
    return multipliers[np.argsort(-np.abs(multipliers), kind="stable")]
