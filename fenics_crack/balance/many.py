"""Exact orbits of one structure in many cases: at other frequencies, loads, dampings, clearances.

Neighbouring cases have neighbouring orbits. The contact forces grow with the gaps, so that a load
and a clearance that are multiplied alike multiply the orbit: over the load's factor it depends on

    x = omega, damping, sign of the load, clearance / load,

each scaled by its spread, frequencies by the width of the resonance next to their middle. Cases are
taken from the middle of them outwards. Newton's method (:mod:`fenics_crack.motion.orbit`) begins
where the plane through the orbits of the nearest cases before leads, then with that of the nearest
one; where it finds none, or an unstable one, the case is sought as a single solution is.
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
from fenics_crack.motion.flow import ContactFlow, exact_flow
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

NEAREST, BEFORE = 16, 8
"""Nearest cases among which neighbours are, and as many as a plane goes through."""
SAMPLES = 256
"""Least instants of a period that an orbit's numbers are from: a coefficient of order 20 is off by
less than a hundredth of itself."""
SHORT = 1e-10
"""Relative length of a step behind which an orbit is found."""
VARIED = "omega", "load", "damping", "clearance"
WORDS = "status", "reason", "verdict"
NUMBERS = "amplitude", "opening", "closed_share", "multiplier", "truncation"


@dataclass(frozen=True, repr=False)
class ManyOrbits(Tabular):
    """Exact orbits of many cases; what is not known of one is nan, or "".

    Attributes
    ----------
    omega, load, damping, clearance : (n,)
        Cases: frequency of the load [rad/s], factors of the load and of the damping, clearance [m]
        added to that of every pair.
    status : (n,) str
        "neighbour", "alone": found from neighbours' orbits, or as a single solution is; "lost": no
        orbit was found; "refused": the case cannot be.
    reason : (n,) str
        In words, of cases found alone, lost or refused.
    amplitude : (n,) [m]
        Half the peak-to-peak displacement of the watched dof.
    opening : (n,) [m]
        Largest of any pair.
    closed_share : (n,)
        Part of the period in which a pair is closed, mean over the pairs.
    multiplier : (n,)
        Largest modulus of the Floquet multipliers.
    verdict : (n,) str
        "stable", "unstable", or "undecided" where that is 1 to rounding.
    truncation : (n,)
        Relative error of the gap due to the harmonics above H.
    states : (n, 2 n_modes)
        States of the orbits at phase zero.
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
        """The problem of a case, with H harmonics; InputError where it cannot be."""
        omega, load, damping, clearance = (float(getattr(self, name)[case]) for name in VARIED)
        varied = self.structure.varied(load=load, damping=damping, clearance=clearance)
        return Problem(varied, omega, self.contact, self.harmonics)

    def orbit(self, case: int) -> PeriodicOrbit:
        """The orbit of a case.

        Raises
        ------
        ConvergenceError
            None was found.
        """
        if not self.verdict[case]:
            raise ConvergenceError(f"case {case}: {self.reason[case]}")
        problem = self.problem(case)
        flow = ContactFlow(problem.structure, problem.contact)
        return orbit_from(flow, problem.omega, self.states[case], 1)

    def to_dict(self) -> dict[str, Any]:
        """Columns of all that is (n,)."""
        return {one.name: getattr(self, one.name).tolist() for one in fields(self)[3:-1]}

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
    """Exact orbits of a structure in many cases, each with its verdict and its error by harmonics.

    Parameters
    ----------
    structure : Structure
        Small, or reduced.
    omega : float or (n,) [rad/s]
        Load frequencies.
    contact : ContactLaw
    load, damping : float or (n,)
        Factors of the structure's.
    clearance : float or (n,) [m]
        Added to that of every pair.
    harmonics : int
        H, whose error is stated.

    Returns
    -------
    ManyOrbits
        A case that cannot be solved has its ``status`` and ``reason``; it stops no other.

    Raises
    ------
    InputError
        The arrays do not fit together, or there is no exact flow.

    Examples
    --------
    >>> many = fc.solve_many(structure, 2000.0, contact, damping=np.linspace(0.5, 2.0, 20))
    >>> lost = np.flatnonzero(many.status == "lost")
    """
    given = [numbers(one) for one in (omega, load, damping, clearance)]
    shapes = {one.shape for one in given} - {()}
    if len(shapes) != 1 or not all(len(shape) == 1 and shape[0] for shape in shapes):
        words = ", ".join(str(one.shape) for one in given)
        raise InputError("omega, load, damping, clearance", words, "numbers and arrays (n,)")
    cases = np.array(np.broadcast_arrays(*given), dtype=float)
    Problem(structure, 1.0, contact, harmonics)  # raises what concerns all
    count, flow = cases.shape[1], exact_flow(structure, contact)
    columns: dict[str, Any] = dict(zip(VARIED, cases, strict=True))
    columns |= {name: np.full(count, "", dtype=object) for name in WORDS}
    columns |= {name: np.full(count, np.nan) for name in NUMBERS}
    columns["states"] = np.full((count, flow.size), np.nan)
    many = ManyOrbits(structure, contact, harmonics, **columns)
    watched = rows_of(structure, [structure.watched_dof])
    for case, before, x in _ordered(many, flow):
        try:
            problem = many.problem(case)
            orbit = _sought(many, case, problem, before, x)
            for name, value in _numbers(problem, orbit, watched).items():
                columns[name][case] = value
        except (ConvergenceError, InputError, np.linalg.LinAlgError) as error:
            many.status[case] = "refused" if isinstance(error, InputError) else "lost"
            many.reason[case] = str(error)
    return many


def _ordered(many: ManyOrbits, flow: ContactFlow) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Cases from the middle outwards, with those before among the nearest ones, the nearest first,
    and how far these are: (k, d). It does not matter where those that cannot be are."""
    size = np.where(many.load == 0.0, 1.0, np.abs(many.load))
    rows = [many.omega, many.damping, np.sign(many.load), many.clearance / size]
    rows.append(np.abs(flow.clearance).max() / size)
    x = np.nan_to_num(np.array(rows).T, nan=0.0, posinf=0.0, neginf=0.0)
    spread, middle = np.ptp(x, axis=0), np.median(x, axis=0)
    nearest = int(np.abs(flow.modes.squares - middle[0] ** 2).argmin())
    width = middle[1] * flow.modes.damped(np.eye(flow.n_modes))[nearest, nearest]
    spread[0] = min(spread[0], width) if width > 0.0 else spread[0]
    x = (x - middle) / np.where(spread > 0.0, spread, 1.0)
    order = np.argsort(np.linalg.norm(x, axis=1), kind="stable")
    near = cKDTree(x).query(x, min(NEAREST, len(x)))[1].reshape(len(x), -1)
    rank = np.argsort(order)
    for case in order.tolist():
        before = near[case][rank[near[case]] < rank[case]]
        yield case, before, x[before] - x[case]


def _sought(
    many: ManyOrbits, case: int, problem: Problem, before: np.ndarray, x: np.ndarray
) -> PeriodicOrbit:
    """The orbit of a case."""
    flow = ContactFlow(problem.structure, problem.contact)
    if not is_affordable(flow, problem.omega):
        raise ConvergenceError("a load too slow, or too many modes, for exact orbits")
    known = (many.verdict[before] != "") & (many.load[before] != 0.0)
    before, x = before[known][:BEFORE], x[known][:BEFORE]
    states = many.states[before] * np.abs(many.load[case] / many.load[before])[:, None]
    guesses = list(states[:1])
    if len(states) > np.any(x, axis=0).sum() + 1:
        weights = 1.0 / np.maximum(np.linalg.norm(x, axis=1), SHORT)[:, None]
        rows = weights * np.column_stack([np.ones(len(x)), x])
        guesses.insert(0, np.linalg.lstsq(rows, weights * states, rcond=None)[0][0])
    found = (find_orbit(flow, problem.omega, state, step_tolerance=SHORT) for state in guesses)
    orbit, many.status[case] = next(filter(None, found), None), "neighbour"
    if (
        orbit is not None and abs(orbit.multipliers[0]) <= 1.0 + MULTIPLIER_TOLERANCE
    ):  # 1 without damping
        return orbit
    search = initial_orbit(problem)
    if orbit is None or (search.orbit is not None and search.orbit.is_stable):
        orbit, many.status[case], many.reason[case] = search.orbit, "alone", search.reason
    if orbit is None:
        raise ConvergenceError(search.reason)
    return orbit


def _numbers(problem: Problem, orbit: PeriodicOrbit, watched: np.ndarray) -> dict[str, Any]:
    """What is said of an orbit."""
    count, track = max(SAMPLES, 4 * problem.harmonics + 4), orbit.motion.track
    samples = orbit.samples(np.arange(count) * orbit.period / count)
    motion = samples.displacement, samples.gaps, samples.forces
    wave = problem.wave_of(*(fourier_coefficients(one, problem.harmonics) for one in motion))
    change, moved = motion[1] - wave.over_period(count)[1], motion[0] @ watched.T
    off = (
        0.0
        if is_still(samples)
        else relative_to_motion(change, motion[1] + wave.row_structure.clearance)
    )
    multiplier = abs(orbit.multipliers[0])
    verdict = "stable" if multiplier < 1.0 else "unstable"
    return {
        "amplitude": 0.5 * (_top(moved) + _top(-moved)),
        "opening": max(0.0, _top(-samples.gap)),
        "closed_share": track.share(track.sets > 0),
        "multiplier": multiplier,
        "truncation": off,
        "states": orbit.state,
        "verdict": "undecided" if abs(multiplier - 1.0) <= MULTIPLIER_TOLERANCE else verdict,
    }


def _top(values: np.ndarray) -> float:
    """Largest value of columns over a period of equal parts, by the parabola through it and its
    neighbours."""
    place, column = np.unravel_index(values.argmax(), values.shape)
    before, top, after = values[np.arange(place - 1, place + 2) % len(values), column]
    bend = max(2.0 * top - before - after, sys.float_info.min)
    return float(top + (after - before) ** 2 / (8.0 * bend))
