"""Exact orbits of one structure in many cases: other frequencies, loads, dampings, clearances.

Neighbouring cases have neighbouring orbits. Contact forces are proportional to the gaps: a common
factor of load and clearance multiplies the orbit. Divided by the load's factor, the orbit depends
on

    x = omega, damping, sign of the load, clearance / load.

Distances between cases are measured in x, each entry divided by its range over the cases. The
frequency's range is at most the width of the resonance next to the median frequency. Cases are
taken from the median outwards. Newton's method (:mod:`fenics_crack.motion.orbit`) starts from a
linear fit of the orbits of the nearest earlier cases, then from the nearest orbit. If no stable
orbit is found, the case is solved alone, as :func:`search_orbit_by_harmonic_balance` does.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fenics_crack.balance.harmonic_balance import search_orbit_by_harmonic_balance
from fenics_crack.balance.more_modes import are_crack_faces_still
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.tables import Tabular
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import ContactFlow, exact_flow_or_error
from fenics_crack.motion.motions import dof_selection_rows
from fenics_crack.motion.orbit import (
    MULTIPLIER_TOLERANCE,
    PeriodicOrbit,
    find_orbit,
    is_orbit_search_affordable,
    orbit_from_converged_state,
)
from fenics_crack.numerics.fourier import fourier_coefficients
from fenics_crack.numerics.newton import change_relative_to_motion

N_NEAREST_CASES, N_NEIGHBOURS = 16, 8
"""Number of nearest cases among which neighbours are taken, and maximum number of neighbours.

Neighbours are earlier cases with an orbit. A linear function of the parameters is fitted to them.
"""
MIN_INSTANTS_TO_SAMPLE_ORBIT = 256
"""Minimum number of instants per period at which an orbit's results are evaluated.

A Fourier coefficient of order 20 then has a relative error of a hundredth.
"""
STEP_TOLERANCE = 1e-10
"""Maximum relative length of the last Newton step for an orbit."""
PARAMETER_NAMES = "omega", "load", "damping", "clearance"
"""Columns of :class:`ManyOrbits` with the parameters of the cases."""
TEXT_COLUMNS = "status", "reason", "verdict"
"""Columns of :class:`ManyOrbits` with results in words."""
NUMBER_COLUMNS = "amplitude", "opening", "closed_share", "multiplier", "truncation"
"""Columns of :class:`ManyOrbits` with a number for each case."""


@dataclass(frozen=True, repr=False)
class ManyOrbits(Tabular):
    """Result of :func:`solve_many`: exact orbits of many cases.

    Unknown numbers are nan, and unknown words "".

    Attributes
    ----------
    structure, contact : Structure, ContactLaw
        Structure before the changes of each case, and law of all cases.
    harmonics : int
        Number of harmonics H for ``truncation``.
    omega, load, damping, clearance : (n,)
        Cases: frequency of the load [rad/s], factors of load and damping, and the clearance [m]
        added to every pair.
    status : (n,) str
        "neighbour": found from the orbits of neighbouring cases. "alone": found without them.
        "lost": no orbit was found. "refused": a parameter cannot be used.
    reason : (n,) str
        Explanation for cases found alone, lost or refused.
    amplitude : (n,) [m]
        Half the peak-to-peak displacement of the watched dof.
    opening : (n,) [m]
        Largest opening of any pair.
    closed_share : (n,)
        Fraction of the period in which a pair is closed, mean over the pairs.
    multiplier : (n,)
        Largest modulus of the Floquet multipliers.
    verdict : (n,) str
        "stable", "unstable", or "undecided" if the multiplier differs from 1 by
        at most 1e-6.
    truncation : (n,)
        Relative error of the gap due to the harmonics above H.
    states : (n, flow.state_size)
        States of the orbits at phase zero: modal displacements and velocities, with friction also
        the friction sliders' positions.
    """

    structure: Structure = field(compare=False)
    contact: ContactLaw = field(compare=False)
    harmonics: int
    omega: np.ndarray
    load: np.ndarray
    damping: np.ndarray
    clearance: np.ndarray
    status: np.ndarray
    reason: np.ndarray
    amplitude: np.ndarray
    opening: np.ndarray
    closed_share: np.ndarray
    multiplier: np.ndarray
    verdict: np.ndarray
    truncation: np.ndarray
    states: np.ndarray

    def problem(self, case: int) -> Problem:
        """Return the problem with H harmonics for a case, given by its index.

        Raises InputError if a parameter of the case cannot be used.
        """
        omega, load_factor, damping_factor, added_clearance = (
            float(getattr(self, parameter_name)[case]) for parameter_name in PARAMETER_NAMES
        )
        structure = self.structure.varied(
            load=load_factor, damping=damping_factor, clearance=added_clearance
        )
        return Problem(structure, omega, self.contact, self.harmonics)

    def orbit(self, case: int) -> PeriodicOrbit:
        """Return the exact orbit for a case, given by its index.

        Raises
        ------
        ConvergenceError
            No orbit was found.
        """
        if not self.verdict[case]:
            raise ConvergenceError(f"case {case}: {self.reason[case]}")
        problem = self.problem(case)
        flow = ContactFlow(problem.structure, problem.contact)
        return orbit_from_converged_state(flow, problem.omega, self.states[case], 1)

    def to_dict(self) -> dict[str, Any]:
        """Return the columns by name, as lists.

        Columns: omega, load, damping, clearance, status, reason, amplitude, opening, closed_share,
        multiplier, verdict, truncation.
        """
        return {
            column_field.name: getattr(self, column_field.name).tolist()
            for column_field in fields(self)[3:-1]
        }

    def _repr_text(self) -> str:
        return f"{len(self.omega)} cases, {np.sum(self.verdict == '')} without an orbit"


def solve_many(
    structure: Structure,
    omega: float | np.ndarray,
    contact: ContactLaw,
    *,
    load: float | np.ndarray = 1.0,
    damping: float | np.ndarray = 1.0,
    clearance: float | np.ndarray = 0.0,
    harmonics: int = 20,
) -> ManyOrbits:
    """Return exact orbits of a structure in many cases, with stability and errors.

    Parameters
    ----------
    structure : Structure
        Small, or reduced.
    omega : float or (n,) [rad/s]
        Load frequencies.
    contact : ContactLaw
        Penalty law or constraint, with or without friction, for all pairs.
    load, damping : float or (n,)
        Factors of the structure's load and damping.
    clearance : float or (n,) [m]
        Clearance added to every pair.
    harmonics : int
        H: the error ``truncation`` is due to harmonics above it.

    Returns
    -------
    ManyOrbits
        A case without a solution has a ``status`` and a ``reason``; it stops no other case.

    Raises
    ------
    InputError
        The arrays do not fit together, or there is no exact flow.

    Examples
    --------
    >>> many = fc.solve_many(structure, 2000.0, contact, damping=np.linspace(0.5, 2.0, 20))
    >>> lost = np.flatnonzero(many.status == "lost")
    """
    argument_arrays = [
        floats_or_single_nan(argument) for argument in (omega, load, damping, clearance)
    ]
    argument_shapes = {argument.shape for argument in argument_arrays} - {()}
    if len(argument_shapes) != 1 or not all(
        len(argument_shape) == 1 and argument_shape[0] for argument_shape in argument_shapes
    ):
        shapes_in_words = ", ".join(str(argument.shape) for argument in argument_arrays)
        raise InputError(
            "omega, load, damping, clearance",
            shapes_in_words,
            "numbers or arrays of one length (n,), at least one array",
        )
    case_parameters = np.array(np.broadcast_arrays(*argument_arrays), dtype=float)
    Problem(structure, 1.0, contact, harmonics)  # raises the errors common to all cases
    n_cases, flow = case_parameters.shape[1], exact_flow_or_error(structure, contact)
    columns_by_name: dict[str, Any] = dict(zip(PARAMETER_NAMES, case_parameters, strict=True))
    columns_by_name |= {
        column_name: np.full(n_cases, "", dtype=object) for column_name in TEXT_COLUMNS
    }
    columns_by_name |= {column_name: np.full(n_cases, np.nan) for column_name in NUMBER_COLUMNS}
    columns_by_name["states"] = np.full((n_cases, flow.state_size), np.nan)
    orbit_table = ManyOrbits(structure, contact, harmonics, **columns_by_name)
    watched_dof_row = dof_selection_rows(structure, [structure.watched_dof])
    for case_index, neighbour_indices, scaled_parameter_offsets in _yield_cases_with_neighbours(
        orbit_table, flow
    ):
        try:
            problem = orbit_table.problem(case_index)
            orbit = _find_orbit_of_case(
                orbit_table, case_index, problem, neighbour_indices, scaled_parameter_offsets
            )
            for column_name, column_entry in _table_entries_of_orbit(
                problem, orbit, watched_dof_row
            ).items():
                columns_by_name[column_name][case_index] = column_entry
        except (ConvergenceError, InputError, np.linalg.LinAlgError) as error:
            orbit_table.status[case_index] = "refused" if isinstance(error, InputError) else "lost"
            orbit_table.reason[case_index] = str(error)
    return orbit_table


def _yield_cases_with_neighbours(
    orbit_table: ManyOrbits, flow: ContactFlow
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield cases from the median of all parameters outwards, each with earlier neighbours.

    A case whose parameters cannot be used comes at an arbitrary position.

    Yields
    ------
    case : int
        Index of the case.
    neighbour_indices : (k,) int
        Indices of earlier cases among the nearest 16, the nearest first.
    offsets : (k, 5)
        Scaled parameters of the neighbours, less those of the case. Columns: frequency, damping,
        sign of the load, added clearance / load, the structure's own clearance / load.
    """
    load_magnitudes = np.where(orbit_table.load == 0.0, 1.0, np.abs(orbit_table.load))
    parameter_rows = [
        orbit_table.omega,
        orbit_table.damping,
        np.sign(orbit_table.load),
        orbit_table.clearance / load_magnitudes,
    ]
    parameter_rows.append(np.abs(flow.clearance).max() / load_magnitudes)
    scaled_parameters = np.nan_to_num(np.array(parameter_rows).T, nan=0.0, posinf=0.0, neginf=0.0)
    scaled_parameters = scaled_parameters.clip(-1e100, 1e100)  # whose squares are finite
    parameter_ranges = np.ptp(scaled_parameters, axis=0)
    median_parameters = np.median(scaled_parameters, axis=0)
    mode_index_nearest_to_median_omega = int(
        np.abs(flow.modal_model.squares - median_parameters[0] ** 2).argmin()
    )
    resonance_width = (
        median_parameters[1]
        * flow.modal_model.damping_force(np.eye(flow.n_modes))[
            mode_index_nearest_to_median_omega, mode_index_nearest_to_median_omega
        ]
    )
    parameter_ranges[0] = (
        min(parameter_ranges[0], resonance_width) if resonance_width > 0.0 else parameter_ranges[0]
    )
    scaled_parameters = (scaled_parameters - median_parameters) / np.where(
        parameter_ranges > 0.0, parameter_ranges, 1.0
    )
    case_order = np.argsort(np.linalg.norm(scaled_parameters, axis=1), kind="stable")
    nearest_case_indices = (
        cKDTree(scaled_parameters)
        .query(scaled_parameters, min(N_NEAREST_CASES, len(scaled_parameters)))[1]
        .reshape(len(scaled_parameters), -1)
    )
    order_position = np.argsort(case_order)
    for case_index in case_order.tolist():
        neighbour_indices = nearest_case_indices[case_index][
            order_position[nearest_case_indices[case_index]] < order_position[case_index]
        ]
        yield (
            case_index,
            neighbour_indices,
            scaled_parameters[neighbour_indices] - scaled_parameters[case_index],
        )


def _find_orbit_of_case(
    orbit_table: ManyOrbits,
    case_index: int,
    problem: Problem,
    neighbour_indices: np.ndarray,
    scaled_parameter_offsets: np.ndarray,
) -> PeriodicOrbit:
    """Return the orbit for a case, and set its ``status`` and ``reason`` in the table.

    Newton's method begins near the orbits of the neighbours, cases with the indices
    ``neighbour_indices`` (k,). ``scaled_parameter_offsets`` (k, 5) are the neighbours' scaled
    parameters less the case's (:func:`_yield_cases_with_neighbours`). Raises ConvergenceError if no
    orbit is found.
    """
    flow = ContactFlow(problem.structure, problem.contact)
    if not is_orbit_search_affordable(flow, problem.omega):
        raise ConvergenceError(
            "an exact orbit takes too long: motions in contact are as fast as "
            f"{flow.mode_rate_bound:.2g} rad/s; raise omega, keep fewer modes, or, where crack "
            "faces have mass, make the contact softer"
        )
    is_usable_neighbour = (orbit_table.verdict[neighbour_indices] != "") & (
        orbit_table.load[neighbour_indices] != 0.0
    )
    neighbour_indices = neighbour_indices[is_usable_neighbour][:N_NEIGHBOURS]
    scaled_parameter_offsets = scaled_parameter_offsets[is_usable_neighbour][:N_NEIGHBOURS]
    neighbour_states = (
        orbit_table.states[neighbour_indices]
        * np.abs(orbit_table.load[case_index] / orbit_table.load[neighbour_indices])[:, None]
    )
    state_guesses = list(neighbour_states[:1])
    if len(neighbour_states) > np.any(scaled_parameter_offsets, axis=0).sum() + 1:
        regression_weights = (
            1.0
            / np.maximum(np.linalg.norm(scaled_parameter_offsets, axis=1), STEP_TOLERANCE)[:, None]
        )
        weighted_regression_matrix = regression_weights * np.column_stack(
            [np.ones(len(scaled_parameter_offsets)), scaled_parameter_offsets]
        )
        state_guesses.insert(
            0,
            np.linalg.lstsq(
                weighted_regression_matrix, regression_weights * neighbour_states, rcond=None
            )[0][0],
        )
    orbit_or_none_iterator = (
        find_orbit(flow, problem.omega, state, step_tolerance=STEP_TOLERANCE)
        for state in state_guesses
    )
    orbit, orbit_table.status[case_index] = (
        next(filter(None, orbit_or_none_iterator), None),
        "neighbour",
    )
    # Without damping the largest modulus is 1.
    if orbit is not None and abs(orbit.multipliers[0]) <= 1.0 + MULTIPLIER_TOLERANCE:
        return orbit
    orbit_search = search_orbit_by_harmonic_balance(problem)
    if orbit is None or (orbit_search.orbit is not None and orbit_search.orbit.is_stable):
        orbit, orbit_table.status[case_index], orbit_table.reason[case_index] = (
            orbit_search.orbit,
            "alone",
            orbit_search.outcome_text,
        )
    if orbit is None:
        raise ConvergenceError(orbit_search.outcome_text)
    return orbit


def _table_entries_of_orbit(
    problem: Problem, orbit: PeriodicOrbit, watched_dof_row: np.ndarray
) -> dict[str, Any]:
    """Return an orbit's table entries, by the column names of :class:`ManyOrbits`.

    ``watched_dof_row`` (1, n_dofs) selects the watched dof.
    """
    n_instants = max(MIN_INSTANTS_TO_SAMPLE_ORBIT, 4 * problem.harmonics + 4)
    contact_track = orbit.motion.track
    orbit_samples = orbit.samples(np.arange(n_instants) * orbit.period / n_instants)
    displacement_gap_force_samples = (
        orbit_samples.displacement,
        orbit_samples.gaps,
        orbit_samples.forces,
    )
    wave = problem.wave_of(
        *(
            fourier_coefficients(quantity_samples, problem.harmonics)
            for quantity_samples in displacement_gap_force_samples
        )
    )
    gap_error_samples = (
        displacement_gap_force_samples[1] - wave.basis_gaps_and_forces_over_period(n_instants)[1]
    )
    watched_displacement_samples = displacement_gap_force_samples[0] @ watched_dof_row.T
    truncation_error = (
        0.0
        if are_crack_faces_still(orbit_samples)
        else change_relative_to_motion(
            gap_error_samples, displacement_gap_force_samples[1] + orbit.flow.clearance
        )
    )
    largest_multiplier_modulus = abs(orbit.multipliers[0])
    stability_verdict = "stable" if largest_multiplier_modulus < 1.0 else "unstable"
    return {
        "amplitude": 0.5
        * (
            _interpolated_overall_maximum(watched_displacement_samples)
            + _interpolated_overall_maximum(-watched_displacement_samples)
        ),
        "opening": max(0.0, _interpolated_overall_maximum(-orbit_samples.gap)),
        "closed_share": contact_track.closed_share,
        "multiplier": largest_multiplier_modulus,
        "truncation": truncation_error,
        "states": orbit.state,
        "verdict": "undecided"
        if abs(largest_multiplier_modulus - 1.0) <= MULTIPLIER_TOLERANCE
        else stability_verdict,
    }


def _interpolated_overall_maximum(period_samples: np.ndarray) -> float:
    """Return the largest value of m functions over a period, by interpolation.

    ``period_samples`` (n, m) are values at n equally spaced instants. The result is the maximum of
    the parabola through the largest sample and its neighbours before and after.
    """
    row_index, column_index = np.unravel_index(period_samples.argmax(), period_samples.shape)
    sample_before, largest_sample, sample_after = period_samples[
        np.arange(row_index - 1, row_index + 2) % len(period_samples), column_index
    ]
    curvature = max(2.0 * largest_sample - sample_before - sample_after, sys.float_info.min)
    return float(largest_sample + (sample_after - sample_before) ** 2 / (8.0 * curvature))
