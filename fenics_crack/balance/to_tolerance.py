"""A solution to a tolerance: harmonics, samples and modes are chosen by what each leaves out.

H is raised until the estimated error is small and has been confirmed by a finer solution. Where
harmonic balance does not get there and the flow is known in closed form, the solution is an orbit
of that (:mod:`exact_orbits`), which no harmonics had to find: those are kept of it that the
tolerance asks for. Stiff pairs that chatter need that; the truncated equations of such motions
often have no solution near them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.balance.error_report import UNKNOWN, ErrorReport, mean_square
from fenics_crack.balance.exact_orbits import judged_by_orbits
from fenics_crack.balance.exact_solution import exact_solution
from fenics_crack.balance.fourier import resized
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.balance.solver import Solver
from fenics_crack.errors import MAX_SAMPLES, ConvergenceError
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduced import ReducedStructure, massless
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.stages import begin

__all__ = ["solve_to_tolerance"]

MAX_HARMONICS = 300
"""If more are needed for a tolerance, or more than MAX_SAMPLES, it is out of reach."""
SAFETY, SHARE = 0.6, 0.3
"""Parts of a tolerance that the whole estimate may take, where not all of it is the reduction's of
a structure given, and one of its causes before it is worked on: estimates are known to a factor of
about two."""
DISPROVED = 3.0
"""Change from one solution to a finer one, relative to the error estimated of the first, beyond
which estimates are not believed."""
ENOUGH = 20
"""Harmonics with which the error is known, or an orbit is sought that tells it."""
FIRST_MODES, COVER = 10, 1.5
"""Modes with which a large structure is tried first; H times the frequency relative to that of the
highest mode kept, from which on it is covered."""


def solve_to_tolerance(
    solver: Solver, tolerance: float, initial: PeriodicSolution | None
) -> PeriodicSolution:
    """Raise H, the samples, and the modes of a reduction until the estimated error is small, and
    the change since a coarser solution agrees with what was estimated of that."""
    whole, modes = solver.problem.structure, FIRST_MODES
    reducible = not is_small(whole) and not isinstance(whole, ReducedStructure)
    if reducible:
        solver = _reduced(solver, whole, modes)
    fewest, exact = solver.problem, judged_by_orbits(solver.problem)
    last: PeriodicSolution | None = None
    while True:
        problem = solver.problem
        begin(f"H = {problem.harmonics}, {problem.structure.n_dofs} coordinates")
        if last is None and not exact:
            solution = solver.solve(initial)
        else:
            solution = solver.attempt(last or initial, patient=False)[1]
        solution = replace(solution, report=whole.comm.bcast(solution.report))
        report, finer, obstacle = solution.report, problem, ""
        more_modes = reducible and modes < whole.n_dofs
        only_modes = not more_modes and report.total - report.reduction <= SHARE * tolerance
        part = 1.0 if only_modes else SAFETY
        if not solution.converged:
            obstacle = f"truncation; H = {problem.harmonics} failed"
        elif report.total <= part * tolerance and _confirmed(solution, last, tolerance):
            modes_kept = f", {modes} modes ({problem.structure.n_dofs} coordinates)"
            return _chosen(solution, tolerance, problem.samples, modes_kept if reducible else "")
        else:
            finer, obstacle = _finer(problem, report, tolerance, more_modes)
        unknown = report.truncation >= UNKNOWN and problem.harmonics >= ENOUGH
        lost = bool(obstacle) or unknown
        if exact and lost and (report.reduction <= tolerance or not solution.converged):
            near = solution if solution.converged else last
            found = exact_solution(fewest, near or initial, tolerance)
            if found is not None:
                return _chosen(found, tolerance)
            exact = False
            if last is None and not solution.converged:
                continue  # by every attempt that there is
        best = solution if solution.converged else last
        if best is None:
            return solution
        if obstacle:
            return _give_up(solver, tolerance, best, obstacle)
        last, solver = solution, replace(solver, problem=finer)
        if reducible and report.reduction > SHARE * tolerance and modes < whole.n_dofs:
            modes = min(2 * modes, whole.n_dofs)
            solver = _reduced(solver, whole, modes)


def _chosen(
    solution: PeriodicSolution, tolerance: float, samples: int | None = None, modes: str = ""
) -> PeriodicSolution:
    """A solution that meets a tolerance, with the word that it does."""
    chosen = f"chosen for an error of {tolerance:g}: H = {solution.harmonics}"
    if samples is not None:
        chosen += f", {samples} samples"
    return replace(solution, status=f"{solution.status}; {chosen}{modes}")


def _reduced(solver: Solver, whole: Structure, modes: int) -> Solver:
    reduced = reduce_structure(whole, modes=modes, method="massless")
    return replace(solver, problem=replace(solver.problem, structure=reduced))


def _confirmed(solution: PeriodicSolution, last: PeriodicSolution | None, tolerance: float) -> bool:
    """Whether a solution is as far from a coarser one as the error estimated of that says, or
    hardly differs from it. Where one estimate has failed, the next is not believed either."""
    if last is None:
        return False
    if not max(solution.report.total, last.report.total):  # lips that stay where they are
        return True
    change = solution.gap_coefficients - resized(last.gap_coefficients, solution.harmonics)
    closing = solution.gap_coefficients.copy()
    closing[0] += solution.structure.clearance
    moved = float(np.sqrt(mean_square(change) / max(mean_square(closing), 1e-300)))
    return moved <= max(DISPROVED * last.report.total, tolerance)


def _finer(
    problem: Problem, report: ErrorReport, tolerance: float, more_modes: bool
) -> tuple[Problem, str]:
    """The problem with more samples or harmonics; or what prevents a smaller error.

    Harmonics that do not reach a mode leave its motion out: with fewer than 1.5 w_m / w, w_m the
    highest frequency kept, the truncation falls no faster than these modes are reached.
    """
    harmonics = problem.harmonics
    if report.reduction > tolerance and not more_modes:
        return problem, "that of the reduced structure given"
    if report.sampling > SHARE * tolerance:
        used = problem.samples or problem.subharmonic * default_samples(harmonics)
        if used > MAX_SAMPLES // 4:
            return problem, "sampling"
        return replace(problem, samples=4 * used), ""
    if more_modes and report.truncation <= SHARE * tolerance < report.reduction:
        return problem, ""  # only modes are missing
    if harmonics >= MAX_HARMONICS:
        return problem, f"truncation at H = {harmonics}"
    # The error falls like H^-3 or slower: aim a little past the goal, but not too far.
    wanted = 1.1 * harmonics * (report.truncation / tolerance) ** (1.0 / 3.0)
    if (lips := massless(problem.structure)) is not None and report.truncation > tolerance:
        wanted = max(wanted, COVER * lips.omega[-1] / problem.base_omega)
    harmonics = min(MAX_HARMONICS, max(harmonics + 2, int(np.ceil(min(wanted, 2.5 * harmonics)))))
    samples = problem.samples and max(problem.samples, 8 * harmonics)
    return replace(problem, harmonics=harmonics, samples=samples), ""


def _give_up(
    solver: Solver, tolerance: float, best: PeriodicSolution, obstacle: str
) -> PeriodicSolution:
    """The best solution found, or the error that says how far it is from what was asked for."""
    error = f"{best.report.total:.1e} with H = {best.harmonics}"
    if solver.throw:
        raise ConvergenceError(
            f"harmonic balance at {solver.problem.omega:g} rad/s: the estimated error, {error}, "
            f"stays above {tolerance:g}; what is left is {obstacle}"
        )
    status = f"{best.status}; error {error} above the tolerance: {obstacle}"
    return replace(best, converged=False, status=status)
