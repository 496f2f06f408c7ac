"""A solution from an orbit of the exact flow, with the harmonics that a tolerance asks for.

Its coefficients are those of the exact motion, which solves

    u_k = A_k^-1 (c_k - B b_k),    b_k those of lambda(g(t)),

for every k, while a solution of the truncated equations has b_k of its truncated gap. So what is
left out is known: the sum of the squares of the harmonics above (Parseval).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.bordered import PathPoint
from fenics_crack.balance.condensed import respond
from fenics_crack.balance.error_report import ErrorReport, lost_in_reduction, mean_square
from fenics_crack.balance.exact_orbits import next_to, orbits_from, recurring
from fenics_crack.balance.fourier import balanced, sampled, stretched
from fenics_crack.balance.orbits import FlowOrbits, OrbitPoint
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution

__all__ = ["exact_solution"]

MOST, OVERSAMPLED, INTERLEAVED = 2000, 8, 8
"""Harmonics of the load's frequency that are looked at, instants for each of them, and how many
times as many for the contact force, which has kinks where the gap has none."""
SHARE, MORE = 0.8, 1.5
"""Of a tolerance, that the harmonics left out may take; how many times as many are kept next where
those do not lead back to the orbit."""
PRESSED = 0.05
"""Error of the contact force of the gap kept, of its root mean square: short impacts are lost in a
gap that is good to a tolerance."""
JUDGED = 40
"""Harmonics with which the error of a reduction is estimated at most."""
SAME = 1e-5
"""Distance of two states of one orbit."""


def exact_solution(
    problem: Problem, near: PeriodicSolution | None, tolerance: float
) -> PeriodicSolution | None:
    """The orbit of the exact flow next to a solution, or one that the motion from there leads to;
    None where none is found, or it needs more harmonics than are looked at.

    ``tolerance`` is for the whole estimate (:attr:`ErrorReport.total`); the problem's own harmonics
    are the fewest that are kept. For problems that are :func:`judged_by_orbits`.
    """
    still = np.zeros((2 * problem.harmonics + 1, problem.structure.n_pairs))
    starts = [problem.compliance().displacement(still)]
    if near is not None:
        longer = problem.subharmonic // near.subharmonic
        starts.insert(0, stretched(near.displacement_coefficients, longer))
    for begun in starts:
        orbits, way = orbits_from(problem, begun), "next to a solution"
        orbit = None if near is None else next_to(orbits)
        if orbit is None:
            orbit, way = recurring(orbits), "by following the motion"
        if orbit is not None:
            found = _kept(problem, _Waves(problem, orbits, orbit), tolerance)
            if found is not None:
                status = f"exact orbit, found {way}"
                return replace(found, status=status, iterations=orbit.iterations)
    return None


def _kept(problem: Problem, waves: _Waves, tolerance: float) -> PeriodicSolution | None:
    """The fewest harmonics that meet a tolerance, of which the gap still presses as the orbit's
    does, and from which Newton's method finds the orbit again, as whoever judges the solution will;
    where no number is enough for that, the fewest that press. None where there are none."""
    best = None
    fewest = int(np.argmax(waves.tail < SHARE * tolerance)) - 1
    if fewest < 0:
        return None
    harmonics = max(problem.harmonics, fewest)
    reduction = _reduction(problem.with_harmonics(min(harmonics, JUDGED)), waves)
    while reduction < tolerance and harmonics + 1 < len(waves.tail):
        kept = problem.with_harmonics(harmonics)
        found = waves.kept(kept, reduction)
        if found.report.total <= tolerance and waves.force_error(harmonics) < PRESSED:
            best = best or found
            if _leads_back(found, waves.state):
                return found
        harmonics = int(MORE * harmonics) + 1
    return best


def _leads_back(solution: PeriodicSolution, state: np.ndarray) -> bool:
    """Whether who judges a solution finds the orbit again."""
    judged = solution.judged
    if judged.orbit is None or not judged.accepted:
        return False
    off = np.linalg.norm(judged.orbit.state - state)
    return bool(off <= SAME * np.linalg.norm(state))


class _Waves:
    """An orbit's motion, and its harmonics as far as they are looked at.

    Attributes
    ----------
    displacement : (2K+1, n_dofs) [m]
    gap, force : (2K+1, n_pairs) [m], [N]
    state : (2n,)
        At phase zero.
    size : float
        Mean square of B^T u.
    penetration, closed : float
        Root mean square of max(g, 0), relative to that of B^T u; |z(T) - z(0)| / |z(0)|.
    tail, at_load : (K+1,)
        Of all harmonics from one on, relative to B^T u; of the displacement at the load, likewise.
    """

    def __init__(self, problem: Problem, orbits: FlowOrbits, orbit: PathPoint) -> None:
        structure, most = problem.structure, MOST * problem.subharmonic
        unknown, count = orbit.unknown, OVERSAMPLED * most
        moved = orbits.displacement(unknown, count)
        inside = np.empty((count, INTERLEAVED, structure.n_pairs))
        for place in range(INTERLEAVED):
            inside[:, place] = orbits.gap(unknown, 1.0, count, place / INTERLEAVED)
        inside = np.maximum(inside.reshape(-1, structure.n_pairs), 0.0)
        self._law, self._pressed = problem.contact, problem.contact.force(inside[::INTERLEAVED])
        self.displacement = balanced(moved, most)
        self.gap = structure.apply_bt(self.displacement)
        squares = _squares(self.gap)
        self.gap[0] -= structure.clearance
        self.force = balanced(problem.contact.force(inside), most)
        self.size = float(squares.sum())
        self.penetration = float(np.sqrt(np.sum(inside**2) / len(inside) / self.size))
        self.tail = np.sqrt(_from_on(squares) / self.size)
        known = _squares(self.displacement @ structure.force.T)
        self.at_load = np.sqrt(_from_on(known) / max(known.sum(), 1e-300))
        assert isinstance(orbit.at, OrbitPoint)
        self.state = orbits.state(unknown)
        self.closed = float(np.linalg.norm(orbit.at.residual) / np.linalg.norm(unknown))

    def force_error(self, harmonics: int) -> float:
        """Of lambda(g) of the gap with so many harmonics, relative to the force's own size."""
        force = self._law.force(sampled(self.gap[: 2 * harmonics + 1], len(self._pressed)))
        off, size = np.linalg.norm(force - self._pressed), np.linalg.norm(self._pressed)
        return float(off / size) if size > 0.0 else 0.0

    def kept(self, problem: Problem, reduction: float) -> PeriodicSolution:
        """The solution with the harmonics of a problem."""
        rows, above = slice(2 * problem.harmonics + 1), problem.harmonics + 1
        displacement, gap, force = self.displacement[rows], self.gap[rows], self.force[rows]
        compliance = problem.compliance()
        missed = gap - compliance.linear_gap + respond(compliance.matrices, force)
        report = ErrorReport(
            residual=max(self.closed, float(np.sqrt(mean_square(missed) / self.size))),
            truncation=float(self.tail[above]),
            sampling=0.0,
            reduction=reduction,
            penetration=self.penetration,
            displacement=float(self.at_load[above]),
        )
        return PeriodicSolution(
            problem.structure, problem.omega, problem.contact, displacement, gap, force,
            problem.subharmonic, report=report,
        )  # fmt: skip


def _squares(coefficients: np.ndarray) -> np.ndarray:
    """What each harmonic has of the mean square: (K+1,)."""
    square = np.sum(coefficients**2, axis=1)
    return np.concatenate([square[:1], 0.5 * (square[1::2] + square[2::2])])


def _from_on(squares: np.ndarray) -> np.ndarray:
    """Sums of each and all that follow."""
    return np.cumsum(squares[::-1])[::-1]


def _reduction(problem: Problem, waves: _Waves) -> float:
    """What the modes left out of a reduced structure change."""
    rows = slice(2 * problem.harmonics + 1)
    slow = waves.gap[rows]
    if problem.residual is not None:
        slow = slow + waves.force[rows] @ problem.residual
    at = problem.system(problem.compliance()).linearise(slow)
    return lost_in_reduction(at, problem).relative_to(at, problem.structure.clearance)
