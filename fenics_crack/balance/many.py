"""Exact orbits of one structure in many cases: at other frequencies, loads, dampings, clearances.

Neighbouring cases have neighbouring orbits. The contact forces grow with the gaps, so that a load
and a clearance that are multiplied alike multiply the orbit: over the load's factor it depends on

    x = omega, damping, sign of the load, clearance / load,

each scaled by its spread, frequencies by the width of the resonance next to their middle. Cases are taken from the middle of them outwards. Newton's method
(:func:`fenics_crack.motion.orbit.find_orbit`) begins where the plane through the orbits of the
nearest cases before leads, then with that of the nearest one; where it finds none, or an unstable
one, the case is sought as a single solution is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fenics_crack.balance.harmonic_balance import initial_orbit, wave_of
from fenics_crack.balance.more_modes import is_still
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.tables import Tabular, hertz_of
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.matrices import numbers
from fenics_crack.model.modal import AllModes
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import ContactFlow, check_exact
from fenics_crack.motion.motions import rows_of
from fenics_crack.motion.orbit import KNOWN, PeriodicOrbit, affordable, find_orbit, orbit_from
from fenics_crack.numerics.fourier import balanced
from fenics_crack.numerics.newton import relative_to_motion

NEAREST, BEFORE = 16, 8
"""Nearest cases among which neighbours are, and as many as a plane goes through."""
SAMPLES = 256
"""Least instants of a period that an orbit's numbers are from: a coefficient of order 20 is off by
less than a hundredth of itself."""
SHORT = 1e-10
"""Relative length of a step behind which an orbit is found."""
VARIED = "omega", "load", "damping", "clearance"


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

    frequency = hertz_of()

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
        problem = self.problem(case)
        if not self.verdict[case]:
            raise ConvergenceError(f"case {case}: {self.reason[case]}")
        flow = ContactFlow(problem.structure, problem.contact)
        return orbit_from(flow, problem.omega, self.states[case], 1)

    def solution(self, case: int) -> PeriodicSolution:
        """The same by its H harmonics."""
        orbit = self.orbit(case)
        return wave_of(self.problem(case), orbit, orbit.coefficients(self.harmonics))

    def to_dict(self) -> dict[str, Any]:
        """Columns of all that is (n,)."""
        names = [one.name for one in fields(self)[3:-1]]
        return {name: getattr(self, name).tolist() for name in names}

    def _title(self) -> str:
        kinds, counts = np.unique(self.status, return_counts=True)
        parts = [f"{n} {kind}" for kind, n in zip(kinds, counts, strict=True)]
        return f"{len(self.omega)} cases: {', '.join(parts)}"


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
    >>> many = fc.solve_many(structure, omega, contact, damping=np.linspace(0.5, 2.0, 1000))
    >>> np.flatnonzero(many.status == "lost")
    """
    given = [numbers(one) for one in (omega, load, damping, clearance)]
    try:
        cases = np.array(np.broadcast_arrays(*given), dtype=float)
    except ValueError:
        cases = np.empty(0)
    if cases.ndim != 2 or not cases.shape[1]:
        shapes = ", ".join(str(one.shape) for one in given)
        raise InputError("omega, load, damping, clearance", shapes, "numbers and arrays (n,)")
    if not structure.n_pairs:
        raise InputError("structure", repr(structure), "one with crack faces")
    check_exact(structure, contact)
    Problem(structure, 1.0, contact, harmonics)
    count, flow = cases.shape[1], ContactFlow(structure, contact)
    columns: dict[str, Any] = dict(zip(VARIED, cases, strict=True))
    columns |= {name: np.full(count, "", dtype=object) for name in ("status", "reason", "verdict")}
    names = "amplitude", "opening", "closed_share", "multiplier", "truncation"
    columns |= {name: np.full(count, np.nan) for name in names}
    columns["states"] = np.full((count, flow.size), np.nan)
    many = ManyOrbits(structure, contact, harmonics, **columns)
    watched = rows_of(structure, [structure.watched_dof])
    for case, before, x in _ordered(many, flow.modes):
        try:
            problem = many.problem(case)
        except InputError as error:
            many.status[case], many.reason[case] = "refused", str(error)
            continue
        try:
            orbit = _sought(many, case, problem, before, x)
            for name, value in _numbers(problem, orbit, watched).items():
                columns[name][case] = value
        except (ConvergenceError, InputError, np.linalg.LinAlgError) as error:
            many.status[case], many.reason[case] = "lost", str(error)
    return many


def _ordered(many: ManyOrbits, modes: AllModes) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Cases from the middle outwards, with those before among the nearest ones, the nearest first,
    and how far these are: (k, d)."""
    with np.errstate(all="ignore"):
        size = np.abs(many.load)
        held = np.abs(many.structure.clearance).max()
        x = np.array(
            [many.omega, many.damping, np.sign(many.load), many.clearance / size, held / size]
        )
    fine = np.isfinite(x).all(axis=0)
    for case in np.flatnonzero(~fine):
        yield int(case), np.zeros(0, dtype=int), np.zeros((0, 0))
    cases, x = np.flatnonzero(fine), x[:, fine].T
    if not len(cases):
        return
    spread, middle = np.ptp(x, axis=0), np.median(x, axis=0)
    nearest = int(np.abs(modes.squares - middle[0] ** 2).argmin())
    damping = np.diag(modes.damping) if modes.damping.ndim == 2 else modes.damping
    if (width := damping[nearest] * middle[1]) > 0.0:
        spread[0] = min(spread[0], width)
    x = (x - middle)[:, spread > 0.0] / spread[spread > 0.0]
    if not x.size:
        x = np.zeros((len(cases), 1))
    order = np.argsort(np.linalg.norm(x, axis=1), kind="stable")
    near = cKDTree(x).query(x, min(NEAREST, len(x)))[1].reshape(len(x), -1)
    rank = np.empty(len(x), dtype=int)
    rank[order] = np.arange(len(x))
    for one in order:
        before = near[one][rank[near[one]] < rank[one]]
        yield int(cases[one]), cases[before], x[before] - x[one]


def _sought(
    many: ManyOrbits, case: int, problem: Problem, before: np.ndarray, x: np.ndarray
) -> PeriodicOrbit:
    """The orbit of a case."""
    flow = ContactFlow(problem.structure, problem.contact)
    if not affordable(flow, problem.omega):
        raise ConvergenceError(
            "the load is too slow, or there are too many modes, for exact orbits"
        )
    size = np.abs(many.load)
    known = many.verdict[before] != ""
    before, x = before[known][:BEFORE], x[known][:BEFORE]
    states = many.states[before] / size[before][:, None] * size[case]
    guesses = list(states[:1])
    if len(states) > x.shape[1] + 1:
        weights = 1.0 / np.maximum(np.linalg.norm(x, axis=1), 1e-9)[:, None]
        rows = weights * np.column_stack([np.ones(len(x)), x])
        guesses.insert(0, np.linalg.lstsq(rows, weights * states, rcond=None)[0][0])
    found = (find_orbit(flow, problem.omega, state, located=SHORT) for state in guesses)
    orbit = next(filter(None, found), None)
    if orbit is not None and orbit.is_stable:
        many.status[case] = "neighbour"
        return orbit
    search = initial_orbit(problem)
    if orbit is None or (search.orbit is not None and search.orbit.is_stable):
        orbit, many.status[case], many.reason[case] = search.orbit, "alone", search.reason
    else:
        many.status[case] = "neighbour"
    if orbit is None:
        raise ConvergenceError(search.reason)
    return orbit


def _numbers(problem: Problem, orbit: PeriodicOrbit, watched: np.ndarray) -> dict[str, Any]:
    """What is said of an orbit."""
    count, track = max(SAMPLES, 4 * problem.harmonics + 4), orbit.motion.track
    samples = orbit.samples(np.arange(count) * orbit.period / count)
    gaps, displacement = samples.gaps, samples.displacement
    parts = (balanced(one, problem.harmonics) for one in (displacement, gaps, samples.forces))
    wave, error = problem.wave_of(*parts), 0.0
    if not is_still(samples):
        change = gaps - wave.over_period(count)[1]
        error = relative_to_motion(change, gaps + wave.seen.clearance)
    moved, multiplier = (displacement @ watched.T)[:, 0], abs(orbit.multipliers[0])
    verdict = "stable" if multiplier < 1.0 else "unstable"
    return {
        "amplitude": 0.5 * (_top(moved) + _top(-moved)),
        "opening": max(0.0, *(_top(-gap) for gap in samples.gap.T)),
        "closed_share": track.share(track.sets > 0),
        "multiplier": multiplier,
        "truncation": error,
        "states": orbit.state,
        "verdict": "undecided" if abs(multiplier - 1.0) <= KNOWN else verdict,
    }


def _top(values: np.ndarray) -> float:
    """Largest value over a period of equal parts, by the parabola through it and its neighbours."""
    place = int(values.argmax())
    before, top, after = values[place - 1], values[place], values[(place + 1) % len(values)]
    bend = 2.0 * top - before - after
    return float(top + (after - before) ** 2 / (8.0 * bend)) if bend > 0.0 else float(top)
