"""Change of an exact motion due to the modes that a reduction truncates.

The reference of a reduced structure is a reduction with more modes
(:mod:`fenics_crack.model.reduction`). Newton's method searches the reference's orbit, starting from
the reduced structure's orbit. If crack faces have no mass, added modes start with their static
displacements q under load f and contact forces lambda: Lambda q = f - P lambda. With an orbit, the
change by the added modes is exact. Without an orbit, one Newton step for all instants together
gives the change linearly. The reference removes only a share of the truncation error. From numbers
y of the reduced structure and y_ref of the reference, the error is

    e = |y - y_ref| / share.

Truncated modes respond quasi-statically, without damping. With Rayleigh damping a M + b K they
would dissipate b times the integral of c'^T S c' per period, with the coordinates c without mass
and their stiffness S. The reference gets a share of this loss as additional modal damping.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from fenics_crack.balance.contact_system import PeriodicMotion
from fenics_crack.model.modes import STIFFNESS_SOLUTION_ROUNDING, multiply_columns
from fenics_crack.model.reduced import ReducedStructure, as_massless_structure_or_none
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.motion.flow import ContactFlow, Samples
from fenics_crack.motion.orbit import (
    MAX_MODES_FOR_MONODROMY,
    MULTIPLIER_TOLERANCE,
    ApproximateOrbitInEqualParts,
    IMinusMSolver,
    PeriodicOrbit,
    find_orbit,
    predict_motion,
    predict_orbit_by_newton_step,
)
from fenics_crack.motion.search import SLICE_OF_SAMPLES_AT_SEGMENT_STARTS
from fenics_crack.numerics.equations import ROOT_TOLERANCE
from fenics_crack.numerics.fourier import fourier_basis_for
from fenics_crack.numerics.newton import change_relative_to_motion

ERROR_IF_UNKNOWN = 1.0
"""Relative error that stands for an unknown error; no error is stated above it."""

GapAndDisplacementErrors = tuple[float, float]
"""Relative errors of the gap and of the displacement at the load, each at most 1."""


def more_modes_structure_of(wave: PeriodicMotion) -> ReducedStructure | None:
    """Return the reference of a solution's reduced structure: the reduction with more modes.

    None: the structure is not reduced, or has no reference. The reference's damping is increased
    by the loss that truncated modes lack (:func:`_neglected_to_kept_dissipation_ratio`).
    """
    reduced_structure = wave.structure
    if not isinstance(reduced_structure, ReducedStructure) or reduced_structure.reference is None:
        return None
    relative_damping_increase = (
        reduced_structure.error_share_removed_by_reference
        * _neglected_to_kept_dissipation_ratio(wave)
    )
    return (
        reduced_structure.reference.varied(damping=1.0 + relative_damping_increase)
        if relative_damping_increase
        else reduced_structure.reference
    )


def _neglected_to_kept_dissipation_ratio(wave: PeriodicMotion) -> float:
    """Return the energy loss missing in truncated modes, divided by the loss in kept modes.

    Both are losses of the motion ``wave`` in a period. Truncated modes respond quasi-statically,
    without loss, although Rayleigh damping would cause a loss. The ratio increases the reference's
    damping. It is 0 without Rayleigh damping, and for a structure with mass in all coordinates.
    """
    massless_structure = as_massless_structure_or_none(wave.structure)
    if massless_structure is None or not isinstance(
        massless_structure.unvaried_structure.damping, RayleighDamping
    ):
        return 0.0
    harmonic_orders = np.repeat(np.arange(1.0, wave.harmonics + 1), 2)[:, None]
    modal_rate_coefficients, static_rate_coefficients = np.split(
        harmonic_orders * wave.displacement_coefficients[1:], [massless_structure.n_modes], axis=1
    )
    neglected_energy = massless_structure.unvaried_structure.damping.stiffness * np.sum(
        static_rate_coefficients
        @ massless_structure.truncated_static_compliance
        * static_rate_coefficients
    )
    return float(
        neglected_energy
        / max(
            np.sum(modal_rate_coefficients**2 @ massless_structure.modal_damping),
            STIFFNESS_SOLUTION_ROUNDING * neglected_energy,
            1e-300,
        )
    )


def modal_truncation_errors(
    structure: Structure, gap_and_displacement_changes: GapAndDisplacementErrors
) -> GapAndDisplacementErrors:
    """Return modal truncation errors from the changes between a structure and its reference.

    The reference is a reduction with more modes. It removes only a fraction of the truncation
    error, :attr:`ReducedStructure.error_share_removed_by_reference`; for other structures the
    fraction is 1. Each change, of gap and of displacement, is divided by this fraction and limited
    to 1.
    """
    error_share_removed_by_reference = (
        structure.error_share_removed_by_reference
        if isinstance(structure, ReducedStructure)
        else 1.0
    )
    return min(
        gap_and_displacement_changes[0] / error_share_removed_by_reference, ERROR_IF_UNKNOWN
    ), min(gap_and_displacement_changes[1] / error_share_removed_by_reference, ERROR_IF_UNKNOWN)


@dataclass(frozen=True)
class MoreModesComparison:
    """Change of a solution's exact orbit if the structure has more modes.

    The orbit with more modes is searched on first request.
    """

    flow: ContactFlow
    """Exact flow of the structure with more modes."""
    wave_with_fewer_modes: PeriodicMotion
    """Motion of the harmonic-balance solution, with fewer modes."""
    orbit_with_fewer_modes: PeriodicOrbit
    """Exact orbit nearest to the solution, with the modes of the solution's structure."""
    i_minus_m_solver: IMinusMSolver | None = None
    """Solver for (I - M) x = r with a neighbouring orbit's monodromy matrix M.

    The first Newton steps to the orbit with more modes use this solver. None: M is computed.
    """
    max_predicted_change_for_search: float = math.inf
    """Maximum predicted relative gap change from which an orbit is searched.

    With up to 120 modes, Newton's method is first tried from the orbit with fewer modes, without
    this limit.
    """
    known_orbit_with_more_modes: PeriodicOrbit | None = None
    """Orbit with more modes, if it is known from another search."""

    @property
    def nearest_orbit_states_with_static_new_modes(self) -> np.ndarray:
        """Nearest orbit's states, extended to the larger number of modes: (32, flow.state_size).

        The states are those at the starts of 32 equal parts of the period. If crack faces have no
        mass, added modes respond statically to the load and the contact forces. Otherwise the
        orbit's motion is projected on the modes of the larger reduction.
        """
        orbit_samples, flow = self.orbit_with_fewer_modes.period_samples, self.flow
        n_orbit_modes = self.orbit_with_fewer_modes.flow.n_modes
        modal_coordinates, modal_velocities, sticking_places = np.split(
            orbit_samples.whole_states, [n_orbit_modes, 2 * n_orbit_modes], axis=1
        )
        if as_massless_structure_or_none(self.wave_with_fewer_modes.structure) is None:
            return self._projected_states(modal_coordinates, modal_velocities, sticking_places)[
                SLICE_OF_SAMPLES_AT_SEGMENT_STARTS
            ]
        n_kept = modal_coordinates.shape[1]
        modal_loads = (
            fourier_basis_for(
                flow.modal_load, self.wave_with_fewer_modes.omega * orbit_samples.time
            )
            @ flow.modal_load[:, n_kept:]
        )
        modal_loads = (
            modal_loads
            - orbit_samples.contact_row_forces @ flow.modal_model.gaps_by_mode[n_kept:].T
        )
        static_coordinates = modal_loads / flow.modal_model.squares[n_kept:]
        static_rates = (
            np.roll(static_coordinates, -1, axis=0) - np.roll(static_coordinates, 1, axis=0)
        ) / (2.0 * orbit_samples.time[1])
        state_columns = [
            modal_coordinates,
            static_coordinates,
            modal_velocities,
            static_rates,
            sticking_places,
        ]
        return np.hstack(state_columns)[SLICE_OF_SAMPLES_AT_SEGMENT_STARTS]

    def _projected_states(
        self,
        modal_coordinates: np.ndarray,
        modal_velocities: np.ndarray,
        sticking_places: np.ndarray,
    ) -> np.ndarray:
        """Return states with more modes by projection: (n, flow.state_size).

        For reduced structures whose crack faces have mass. ``modal_coordinates`` and
        ``modal_velocities`` (n, n_modes) are those of the orbit with fewer modes.
        ``sticking_places`` (n, n_pairs) are the friction sliders' positions.
        """
        reduced_structure, more_modes_structure = (
            self.wave_with_fewer_modes.structure,
            self.flow.structure,
        )
        assert isinstance(reduced_structure, ReducedStructure) and isinstance(
            more_modes_structure, ReducedStructure
        )
        whole_structure = reduced_structure.whole
        mass_times_basis = multiply_columns(whole_structure.mass, reduced_structure.basis)
        basis_change = (
            whole_structure.sum_over_ranks(more_modes_structure.basis.T @ mass_times_basis)
            @ self.orbit_with_fewer_modes.flow.modal_model.shapes
        )
        return self.flow.state(
            modal_coordinates @ basis_change.T, modal_velocities @ basis_change.T, sticking_places
        )

    @property
    def orbit(self) -> PeriodicOrbit | None:
        """Exact orbit with more modes; None if not found or not searched.

        The relative length of its last Newton step is at most 1.5e-8.
        """
        return (
            None
            if isinstance(self.orbit_or_corrected_motion, ApproximateOrbitInEqualParts)
            else self.orbit_or_corrected_motion
        )

    @cached_property
    def orbit_or_corrected_motion(self) -> PeriodicOrbit | None:
        """Orbit with more modes; without such an orbit, the motion after one Newton step.

        The step corrects the states at 32 instants of the period together. None: the motion with
        more modes cannot be integrated.
        """
        if self.known_orbit_with_more_modes is not None:
            return self.known_orbit_with_more_modes
        flow, load_omega, n_load_periods = (
            self.flow,
            self.wave_with_fewer_modes.omega,
            self.wave_with_fewer_modes.subharmonic,
        )
        period_states, start_i_minus_m_solver = (
            self.nearest_orbit_states_with_static_new_modes,
            self.i_minus_m_solver,
        )
        search_from_state = partial(
            find_orbit, flow, load_omega, subharmonic=n_load_periods, step_tolerance=ROOT_TOLERANCE
        )
        orbit = None
        if flow.n_modes <= MAX_MODES_FOR_MONODROMY:
            orbit = search_from_state(period_states[0], solve_i_minus_m=start_i_minus_m_solver) or (
                search_from_state(period_states[0]) if start_i_minus_m_solver else None
            )
        if orbit is None and (
            prediction := predict_orbit_by_newton_step(
                flow, load_omega, period_states, n_load_periods
            )
        ):
            if prediction.relative_gap_error <= self.max_predicted_change_for_search:
                orbit = search_from_state(
                    prediction.states[0], solve_i_minus_m=prediction.solve_i_minus_m
                )
            return orbit or predict_motion(flow, load_omega, prediction, n_load_periods)
        return orbit

    @property
    def orbit_i_minus_m_solver(self) -> IMinusMSolver | None:
        """Solver for (I - M) x = r with the orbit's monodromy matrix M.

        The search for a neighbouring orbit with more modes starts with this solver. None without an
        orbit, or if I - M is singular.
        """
        with suppress(np.linalg.LinAlgError):
            return self.orbit.i_minus_m_solver if self.orbit else None
        return None

    @property
    def gap_and_displacement_errors(self) -> GapAndDisplacementErrors | None:
        """Modal truncation errors of the gap and of the displacement at the load.

        None: unknown. The gap's error is 0 if gaps move only by rounding.
        """
        if self.orbit_or_corrected_motion is None:
            return None
        orbit_samples = self.orbit_with_fewer_modes.period_samples
        samples_with_more_modes = self.orbit_or_corrected_motion.period_samples
        gap_error = change_relative_to_motion(
            samples_with_more_modes.gaps - orbit_samples.gaps,
            orbit_samples.gaps + self.orbit_with_fewer_modes.flow.clearance,
        )
        orbit_motion_along_load, more_modes_motion_along_load = (
            project_motion_on_load(motion_samples.flow.structure, motion_samples.displacement)
            for motion_samples in (orbit_samples, samples_with_more_modes)
        )
        displacement_at_load_error = change_relative_to_motion(
            more_modes_motion_along_load - orbit_motion_along_load, orbit_motion_along_load
        )
        return modal_truncation_errors(
            self.wave_with_fewer_modes.structure,
            (
                0.0 if are_crack_faces_still(orbit_samples) else gap_error,
                displacement_at_load_error,
            ),
        )

    @property
    def is_predicted_change_too_large(self) -> bool:
        """True if the orbit with more modes is unknown and its predicted change is too large.

        The gap's predicted error then exceeds ``max_predicted_change_for_search``.
        """
        errors = self.gap_and_displacement_errors
        return (
            self.orbit is None
            and errors is not None
            and errors[0] > self.max_predicted_change_for_search
        )

    def describe_contradiction(self, verdict: str) -> str:
        """Return a text if more modes change the orbit's stability, else "".

        ``verdict`` is the solution's stability. Returns "" also if a stability is unknown.
        Multipliers with more than 120 modes are not computed: that would take longer than the
        orbit.
        """
        if verdict not in ("stable", "unstable") or self.orbit is None:
            return ""
        if self.flow.n_modes > MAX_MODES_FOR_MONODROMY:
            return ""
        modulus = float(abs(self.orbit.multipliers[0]))
        orbit_stability_verdict = "stable" if modulus < 1.0 else "unstable"
        if orbit_stability_verdict == verdict or abs(modulus - 1.0) <= MULTIPLIER_TOLERANCE:
            return ""
        n_modes = len(self.flow.modal_model.squares)
        return (
            f"with {n_modes} modes the orbit is {orbit_stability_verdict} (largest multiplier "
            f"{modulus:.6g})"
        )


def are_crack_faces_still(samples: Samples) -> bool:
    """Return True if the load presses the crack faces together: gaps move only by rounding.

    ``samples`` has states and gaps over a period. Gaps plus clearance are then at most 1e-12 times
    the gaps due to the modes with mass alone.
    """
    gaps_by_modes_with_mass = (
        samples.states[:, : samples.flow.n_modes] @ samples.flow.modal_model.gaps_by_mode
    )
    gap_plus_clearance = samples.gaps + samples.flow.clearance
    return bool(
        np.linalg.norm(gap_plus_clearance)
        <= STIFFNESS_SOLUTION_ROUNDING * np.linalg.norm(gaps_by_modes_with_mass)
    )


def project_motion_on_load(structure: Structure, motion: np.ndarray) -> np.ndarray:
    """Return the products of a displacement with the load: (n, n_loads) [J] (collective).

    ``motion`` (n, n_local) [m] is a displacement at n instants, or n Fourier coefficients. The
    loads are the load's cosine and sine coefficients, without zero rows. If all are zero, the mean
    load is taken.
    """
    is_load_coefficient_row_nonzero = (
        structure.sum_over_ranks(np.sum(structure.force**2, axis=1)) > 0.0
    )
    is_load_coefficient_row_nonzero[0] &= not is_load_coefficient_row_nonzero[1:].any()
    return structure.sum_over_ranks(motion @ structure.force[is_load_coefficient_row_nonzero].T)
