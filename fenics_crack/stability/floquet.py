"""Stability of periodic solutions: Floquet multipliers, and a verdict that has been checked.

The multipliers are those of the linear flow along the wave (:mod:`piecewise_flow`); they lie within
the unit circle where the solution is stable, and their product is exp(-T tr c). Three estimates of
the leading one are compared: with the wave of the solution, with that of a wave with more
harmonics, and the root of Hill's determinant next to it (:mod:`hill`).

Better than all of them is an orbit of the flow in time, found by shooting from the solution
(:mod:`shooting`): exact with few pairs that have mass; marched with two lengths of step where pairs
are many, or are seen through a static compliance. With few pairs no other verdict is given: where a
pair grazes, or a stop lies just beyond the truncated wave, the three estimates agree and are wrong.
An orbit judges a solution only if it lies no farther away than three times the estimated error and
10 %. None is called stable of which a pair grazes within that, or from which the exact motion goes
away that begins with the solution.

Sources: those of the modules named.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.bordered import solve_in_plane
from fenics_crack.balance.condensed import CondensedSystem
from fenics_crack.balance.coupled import CoupledPoint
from fenics_crack.balance.error_report import LARGE_ERROR, improved
from fenics_crack.balance.exact_orbits import FEW_PAIRS
from fenics_crack.balance.fourier import resized
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, Stability, solution_of
from fenics_crack.balance.solver import Solver
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.contact import ContactLaw, check_law, is_piecewise_linear, is_rigid
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.stability.hill import hill_root
from fenics_crack.stability.piecewise_flow import PiecewiseFlow
from fenics_crack.stability.shooting import (
    CLOSE,
    FARTHEST,
    ExactOrbits,
    PeriodicOrbit,
    allowed_distance,
    distance,
    leaves,
    moving_below,
    shoot,
)

__all__ = ["Stability", "floquet"]

STEPS = (512, 1024, 2048, 4096)
"""Of marched orbits in a period of the load, until two after each other decide."""
HILL = 1000
"""Rows of Hill's determinant beyond which it is not asked."""
FINER = (1, 2, 4)
"""Times the harmonics, from whose solutions an exact orbit is sought in turn."""
EXACT, MARCHED = 1e-6, 0.02
"""Distance of an orbit from the solution that it judges that may come from the orbit's errors."""
PEAK = np.sqrt(2.0)
"""How many times its root mean square an error is large at an extremum of the gap, as a wave is."""
SURE = 1e-6
"""Distance of a multiplier of a marched orbit from the unit circle that decides, at least."""


def floquet(
    structure: Structure,
    solution: PeriodicSolution,
    contact: ContactLaw | None = None,
    *,
    refine: bool = True,
) -> Stability:
    """Floquet multipliers of a solution, and whether it is stable.

    The multipliers mu are the eigenvalues of the monodromy matrix dz(T)/dz(0), z being displacement
    and velocity and T the period of the response: a small disturbance becomes mu times as large in
    a period. Stable: ``|mu| < 1`` for all.

    Parameters
    ----------
    structure : Structure
        The solution's; at most 600 dofs, else reduce it before solving.
    solution : PeriodicSolution
        The orbit.
    contact : ContactLaw, optional
        Its law; default: the solution's own.
    refine : bool
        Judge by the multipliers of an orbit of the flow in time next to the solution, where that is
        better than those of its harmonics.

    Raises
    ------
    InputError
        The structure is too large, or the law is a constraint of lips with mass.

    Notes
    -----
    Sources: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004,
    chapter 7; Lazarus and Thomas, Comptes Rendus Mecanique 338 (2010) 510-517.
    """
    if contact is None:
        contact = solution.contact
    coupled = solution.static_above is not None
    check_law(structure, contact, rigid=structure.light_lips)
    assert contact is not None
    if not is_small(structure):
        raise InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
    if solution.structure.n_dofs != structure.n_dofs:
        raise InputError("solution", f"{solution.structure.n_dofs} dofs", "of this structure")
    in_time = is_piecewise_linear(contact) or is_rigid(contact)
    many = coupled or structure.n_pairs > FEW_PAIRS
    if refine and in_time and many:
        found = _marched(structure, solution, contact)
        if found is not None and (coupled or found.verdict != "undecided"):
            return found
    if refine and in_time and not many:
        found = _exact(structure, solution, contact)
        if found is not None:
            return found
        judged = _by_harmonics(structure, solution, contact)
        return replace(judged, verdict="undecided")
    judged = _by_harmonics(structure, solution, contact)
    if refine and in_time and solution.report.total > LARGE_ERROR:
        return replace(judged, verdict="undecided")
    return judged


def _by_harmonics(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw
) -> Stability:
    """The three estimates of the leading multiplier, and whether they agree."""
    problem = Problem(
        structure, solution.omega, contact, solution.harmonics, subharmonic=solution.subharmonic,
        static_above=solution.static_above,
    )  # fmt: skip
    above = None
    if solution.static_above is not None:
        above = moving_below(structure, solution.static_above)
    flow, omega = PiecewiseFlow(structure, contact, above), solution.base_omega
    compliance = problem.compliance()
    at = problem.system(compliance).linearise(solution.slow_gap_coefficients)
    better = improved(at)
    if isinstance(at, CoupledPoint):
        # The waves as they are where only the modes below a limit move.
        assert above is not None
        residual = all_modes(structure).static_part(above)
        wide = at.system.widened(len(better) // 2).linearise(better)
        waves = [point.gap + point.force @ residual for point in (at, wide)]
    else:
        waves = [at.unknown, better]
    compliance.destroy()
    multipliers, other = (flow.multipliers(wave, omega) for wave in waves)
    largest = float(np.abs(multipliers[0]))
    estimates = [multipliers[0], other[0]]
    if (2 * solution.harmonics + 1) * structure.n_pairs <= HILL:
        estimates.append(hill_root(structure, solution, contact, multipliers[0]))
    known = np.abs(np.array(estimates))
    verdict = "undecided"
    if np.all(known < 1.0 - 1e-9):
        verdict = "stable"
    elif np.all(known > 1.0 + 1e-9):
        verdict = "unstable"
    elif is_piecewise_linear(contact) and structure.n_pairs <= FEW_PAIRS:
        return Stability(multipliers, verdict, np.nan)
    uncertainty = float(np.abs(known - largest).max())
    if solution.static_above is not None and not uncertainty < abs(largest - 1.0):
        verdict = "undecided"
    return Stability(multipliers, verdict, uncertainty)


def _exact(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw
) -> Stability | None:
    """Judge by the exact orbit next to a solution; None where there is none.

    Where shooting does not find it from the solution, it begins with finer ones.
    """
    near: PeriodicSolution | None = solution
    farther: Stability | None = None
    for factor in FINER:
        if factor > 1:
            near = _finer(structure, solution, contact, factor)
        if near is None:
            break
        try:
            orbit = shoot(structure, near, contact)
        except ConvergenceError:
            continue
        off = distance(orbit, solution)
        found = Stability(orbit.multipliers, _verdict(orbit, 1e-7), 1e-7, True, off)
        if off <= min(allowed_distance(solution, EXACT), FARTHEST):
            error = PEAK * allowed_distance(solution, off)
            if found.verdict == "stable" and (
                _grazes(orbit, structure, contact, error)
                or (off > CLOSE and _leaves(structure, contact, solution, orbit))
            ):
                return replace(found, verdict="undecided")
            return found
        if farther is None or off < farther.distance:
            farther = replace(found, verdict="undecided")
    return farther


def _grazes(orbit: PeriodicOrbit, structure: Structure, contact: ContactLaw, error: float) -> bool:
    """Whether a pair comes to touch or to open, or just does not, within an error of the gap
    relative to B^T u: multipliers jump there, and an orbit as near as that may have others.

    What is compared are the extremes of the gap that a pair would have if the static compliance R_0
    alone answered its force, g + R_0 lambda(g), so that stiff contact counts by its force.
    """
    gap = orbit.gap
    size = float(np.sqrt(np.mean(np.sum((gap + structure.clearance) ** 2, axis=1))))
    modes = all_modes(structure)
    held = modes.squares > 0.0
    static = np.sum(modes.pairs[held] ** 2 / modes.squares[held, None], axis=0)
    before, after = np.roll(gap, 1, axis=0), np.roll(gap, -1, axis=0)
    turns = (gap - before) * (after - gap) <= 0.0
    bend = after - 2.0 * gap + before
    peak = gap - np.divide(
        (after - before) ** 2, 8.0 * bend, out=np.zeros_like(gap), where=turns & (bend != 0.0)
    )
    return bool(np.any(turns & (np.abs(peak + static * contact.force(peak)) <= error * size)))


def _leaves(
    structure: Structure, contact: ContactLaw, solution: PeriodicSolution, orbit: PeriodicOrbit
) -> bool:
    """Whether the exact motion that begins with a solution leaves the stable orbit next to it,
    which attracts only what is nearer."""
    orbits = ExactOrbits(structure, contact, solution)
    return leaves(orbits, orbits.start, orbits.unknown(orbit.state))


def _finer(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw, factor: int
) -> PeriodicSolution | None:
    """The solution with more harmonics; None where it is not found at once, or they are many."""
    harmonics = factor * solution.harmonics
    if (2 * harmonics + 1) * structure.n_pairs > HILL:
        return None
    problem = Problem(
        structure, solution.omega, contact, harmonics, subharmonic=solution.subharmonic
    )
    if problem.residual is not None:
        return None
    solver = Solver(problem, throw=False)
    with solver.compliance() as compliance:
        system = CondensedSystem(compliance, problem.integrals())
        start = resized(solution.gap_coefficients, harmonics)
        found = solve_in_plane(
            system, start, 0.0, None, tolerance=1e-9, iterations=20, least_damping=0.05
        )  # fmt: skip
        if found is None:
            return None
        return solution_of(problem, system.linearise(found.unknown), status="finer")


def _marched(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw
) -> Stability | None:
    """Judge by the marched orbit next to a solution, with the difference between two lengths of
    step as its uncertainty; by shorter ones where that does not decide; None where there is none.
    """
    found: Stability | None = None
    coarse: PeriodicOrbit | None = None
    for steps in STEPS:
        try:
            orbit = shoot(structure, solution, contact, steps_per_period=steps, tolerance=1e-8)
        except ConvergenceError:
            return found
        off = distance(orbit, solution)
        if off > min(allowed_distance(solution, MARCHED), FARTHEST):
            return found
        if coarse is not None:
            change = abs(abs(orbit.multipliers[0]) - abs(coarse.multipliers[0]))
            unsure = max(SURE, float(change))
            found = Stability(orbit.multipliers, _verdict(orbit, unsure), unsure, True, off)
            if found.verdict != "undecided":
                return found
        coarse = orbit
    return found


def _verdict(orbit: PeriodicOrbit, unsure: float) -> str:
    """What the leading multiplier says if it is known so well."""
    largest = abs(orbit.multipliers[0])
    if abs(largest - 1.0) <= unsure:
        return "undecided"
    return "stable" if largest < 1.0 else "unstable"
