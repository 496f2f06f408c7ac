"""Exact orbits of one structure in many cases: other frequencies, loads, dampings, clearances.

Neighbouring cases have neighbouring orbits. Contact forces grow with the gaps: a common factor of
load and clearance multiplies the orbit. Divided by the load's factor, the orbit depends on

    x = omega, damping, sign of the load, clearance / load,

each scaled by its range, and frequencies by the width of the resonance next to their middle. Cases
are taken from the middle outwards. Newton's method (:mod:`fenics_crack.motion.orbit`) begins on the
plane through the orbits of the nearest earlier cases, and then at the nearest orbit. If no stable
orbit is found, the case is solved like a single one.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fenics_crack.balance.harmonic_balance import initial_orbit
from fenics_crack.balance.more_modes import is_still
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.tables import Tabular
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.matrices import numbers
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import ContactFlow, exact_flow_or_error
from fenics_crack.motion.motions import rows_of
from fenics_crack.motion.orbit import (
    MULTIPLIER_TOLERANCE,
    PeriodicOrbit,
    find_orbit,
    is_affordable,
    orbit_from,
)
from fenics_crack.numerics.fourier import fourier_coefficients
from fenics_crack.numerics.newton import relative_to_motion

N_NEAREST_CASES, N_NEIGHBOURS = 16, 8
"""Nearest cases searched for neighbours, and neighbours that a fitted plane uses."""
MIN_SAMPLES = 256
"""Least instants per period for an orbit's numbers.

A coefficient of order 20 is then accurate to a hundredth.
"""
STEP_TOLERANCE = 1e-10
"""Relative length of the last Newton step for an orbit."""
PARAMETERS = "omega", "load", "damping", "clearance"
TEXT_COLUMNS = "status", "reason", "verdict"
NUMBER_COLUMNS = "amplitude", "opening", "closed_share", "multiplier", "truncation"


@dataclass(frozen=True, repr=False)
class ManyOrbits(Tabular):
    """Exact orbits of many cases; unknown entries are nan, or "".

    Attributes
    ----------
    omega, load, damping, clearance : (n,)
        Cases: frequency of the load [rad/s], factors of load and damping, and the clearance [m]
        added to every pair.
    status : (n,) str
        "neighbour": found from neighbours' orbits; "alone": found like a single solution; "lost":
        no orbit was found; "refused": the case cannot exist.
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
        "stable", "unstable", or "undecided" if the multiplier is 1 to rounding.
    truncation : (n,)
        Relative error of the gap due to the harmonics above H.
    states : (n, flow.size)
        States of the orbits at phase zero: modal displacements and velocities, with friction also
        the tangential gaps at which pairs stick.
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
        """Return the problem of a case, by its index, with H harmonics.

        Raises InputError if the case cannot exist.
        """
        omega, load, damping, clearance = (float(getattr(self, name)[case]) for name in PARAMETERS)
        structure = self.structure.varied(load=load, damping=damping, clearance=clearance)
        return Problem(structure, omega, self.contact, self.harmonics)

    def orbit(self, case: int) -> PeriodicOrbit:
        """Return the orbit of a case, by its index.

        Raises
        ------
        ConvergenceError
            No orbit was found.
        """
        if not self.verdict[case]:
            raise ConvergenceError(f"case {case}: {self.reason[case]}")
        problem = self.problem(case)
        flow = ContactFlow(problem.structure, problem.contact)
        return orbit_from(flow, problem.omega, self.states[case], 1)

    def to_dict(self) -> dict[str, Any]:
        """Return the attributes (n,) by name, as lists, without structure and states."""
        return {column.name: getattr(self, column.name).tolist() for column in fields(self)[3:-1]}

    def _title(self) -> str:
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
    """Return exact orbits of a structure in many cases, with verdicts and errors.

    Parameters
    ----------
    structure : Structure
        Small, or reduced.
    omega : float or (n,) [rad/s]
        Load frequencies.
    contact : ContactLaw
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
    arguments = [numbers(argument) for argument in (omega, load, damping, clearance)]
    shapes = {argument.shape for argument in arguments} - {()}
    if len(shapes) != 1 or not all(len(shape) == 1 and shape[0] for shape in shapes):
        shapes_in_words = ", ".join(str(argument.shape) for argument in arguments)
        raise InputError(
            "omega, load, damping, clearance", shapes_in_words, "numbers and arrays (n,)"
        )
    cases = np.array(np.broadcast_arrays(*arguments), dtype=float)
    Problem(structure, 1.0, contact, harmonics)  # raises the errors common to all cases
    n_cases, flow = cases.shape[1], exact_flow_or_error(structure, contact)
    columns: dict[str, Any] = dict(zip(PARAMETERS, cases, strict=True))
    columns |= {name: np.full(n_cases, "", dtype=object) for name in TEXT_COLUMNS}
    columns |= {name: np.full(n_cases, np.nan) for name in NUMBER_COLUMNS}
    columns["states"] = np.full((n_cases, flow.size), np.nan)
    solved_cases = ManyOrbits(structure, contact, harmonics, **columns)
    watched_rows = rows_of(structure, [structure.watched_dof])
    for case, neighbours, offsets in _order_cases(solved_cases, flow):
        try:
            problem = solved_cases.problem(case)
            orbit = _find_orbit_of_case(solved_cases, case, problem, neighbours, offsets)
            for name, number in _orbit_numbers(problem, orbit, watched_rows).items():
                columns[name][case] = number
        except (ConvergenceError, InputError, np.linalg.LinAlgError) as error:
            solved_cases.status[case] = "refused" if isinstance(error, InputError) else "lost"
            solved_cases.reason[case] = str(error)
    return solved_cases


def _order_cases(
    cases: ManyOrbits, flow: ContactFlow
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield cases from the middle outwards, each with its earlier neighbours.

    Cases that cannot exist may stand anywhere in this order.

    Yields
    ------
    case : int
        Index.
    neighbours : (k,) int
        Indices of earlier cases among the nearest 16, the nearest first.
    offsets : (k, d)
        Scaled parameters of the neighbours, less those of the case.
    """
    load_size = np.where(cases.load == 0.0, 1.0, np.abs(cases.load))
    rows = [cases.omega, cases.damping, np.sign(cases.load), cases.clearance / load_size]
    rows.append(np.abs(flow.clearance).max() / load_size)
    x = np.nan_to_num(np.array(rows).T, nan=0.0, posinf=0.0, neginf=0.0)
    scale, centre = np.ptp(x, axis=0), np.median(x, axis=0)
    mode_index = int(np.abs(flow.modal_model.squares - centre[0] ** 2).argmin())
    width = centre[1] * flow.modal_model.damping_force(np.eye(flow.n_modes))[mode_index, mode_index]
    scale[0] = min(scale[0], width) if width > 0.0 else scale[0]
    x = (x - centre) / np.where(scale > 0.0, scale, 1.0)
    order = np.argsort(np.linalg.norm(x, axis=1), kind="stable")
    nearest_cases = cKDTree(x).query(x, min(N_NEAREST_CASES, len(x)))[1].reshape(len(x), -1)
    rank = np.argsort(order)
    for case in order.tolist():
        neighbours = nearest_cases[case][rank[nearest_cases[case]] < rank[case]]
        yield case, neighbours, x[neighbours] - x[case]


def _find_orbit_of_case(
    cases: ManyOrbits, case: int, problem: Problem, neighbours: np.ndarray, offsets: np.ndarray
) -> PeriodicOrbit:
    """Return the orbit of a case, and set its ``status`` and ``reason``.

    Newton's method begins near the orbits of ``neighbours``, cases whose scaled parameters differ
    by ``offsets`` (:func:`_order_cases`). Raises ConvergenceError if no orbit is found.
    """
    flow = ContactFlow(problem.structure, problem.contact)
    if not is_affordable(flow, problem.omega):
        raise ConvergenceError("a load too slow, or too many modes, for exact orbits")
    is_usable = (cases.verdict[neighbours] != "") & (cases.load[neighbours] != 0.0)
    neighbours, offsets = neighbours[is_usable][:N_NEIGHBOURS], offsets[is_usable][:N_NEIGHBOURS]
    states = cases.states[neighbours] * np.abs(cases.load[case] / cases.load[neighbours])[:, None]
    guesses = list(states[:1])
    if len(states) > np.any(offsets, axis=0).sum() + 1:
        weights = 1.0 / np.maximum(np.linalg.norm(offsets, axis=1), STEP_TOLERANCE)[:, None]
        rows = weights * np.column_stack([np.ones(len(offsets)), offsets])
        guesses.insert(0, np.linalg.lstsq(rows, weights * states, rcond=None)[0][0])
    orbits = (
        find_orbit(flow, problem.omega, state, step_tolerance=STEP_TOLERANCE) for state in guesses
    )
    orbit, cases.status[case] = next(filter(None, orbits), None), "neighbour"
    # Without damping the largest modulus is 1.
    if orbit is not None and abs(orbit.multipliers[0]) <= 1.0 + MULTIPLIER_TOLERANCE:
        return orbit
    search = initial_orbit(problem)
    if orbit is None or (search.orbit is not None and search.orbit.is_stable):
        orbit, cases.status[case], cases.reason[case] = search.orbit, "alone", search.outcome_text
    if orbit is None:
        raise ConvergenceError(search.outcome_text)
    return orbit


def _orbit_numbers(
    problem: Problem, orbit: PeriodicOrbit, watched_rows: np.ndarray
) -> dict[str, Any]:
    """Return an orbit's entries of the arrays of :class:`ManyOrbits`, by name.

    ``watched_rows`` (1, n_dofs) select the watched dof.
    """
    n_instants, track = max(MIN_SAMPLES, 4 * problem.harmonics + 4), orbit.motion.track
    samples = orbit.samples(np.arange(n_instants) * orbit.period / n_instants)
    motion = samples.displacement, samples.gaps, samples.forces
    wave = problem.wave_of(*(fourier_coefficients(rows, problem.harmonics) for rows in motion))
    gap_error = motion[1] - wave.over_period(n_instants)[1]
    displacement = motion[0] @ watched_rows.T
    truncation = (
        0.0
        if is_still(samples)
        else relative_to_motion(gap_error, motion[1] + wave.structure_with_row_pairs.clearance)
    )
    multiplier = abs(orbit.multipliers[0])
    verdict = "stable" if multiplier < 1.0 else "unstable"
    return {
        "amplitude": 0.5
        * (_interpolated_maximum(displacement) + _interpolated_maximum(-displacement)),
        "opening": max(0.0, _interpolated_maximum(-samples.gap)),
        "closed_share": track.mean_time_share(track.sets > 0),
        "multiplier": multiplier,
        "truncation": truncation,
        "states": orbit.state,
        "verdict": "undecided" if abs(multiplier - 1.0) <= MULTIPLIER_TOLERANCE else verdict,
    }


def _interpolated_maximum(values: np.ndarray) -> float:
    """Return the largest of all values over a period, by interpolation.

    Rows of ``values`` (n, m) are equally spaced instants. A parabola goes through the largest value
    and its two neighbours in the column.
    """
    row, column = np.unravel_index(values.argmax(), values.shape)
    previous, peak, subsequent = values[np.arange(row - 1, row + 2) % len(values), column]
    curvature = max(2.0 * peak - previous - subsequent, sys.float_info.min)
    return float(peak + (subsequent - previous) ** 2 / (8.0 * curvature))
