"""Steady vibration with contact: linear solution and harmonic balance.

The unknowns are the Fourier coefficients of the gaps (:mod:`condensed`); the equations are balanced
by projection on the same functions, with the contact force integrated exactly or from samples.
Other forms of the method are kept for comparison in ``benchmarks/laboratory.py``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.compliance import load_coefficients
from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.balance.dynamic_stiffness import DynamicStiffness
from fenics_crack.balance.error_report import ErrorReport, mean_square
from fenics_crack.balance.fourier import from_complex, resized, to_complex
from fenics_crack.balance.memory import check_memory
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.balance.solver import Solver
from fenics_crack.errors import (
    MAX_SAMPLES,
    ConvergenceError,
    InputError,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.reduced import ReducedStructure, massless
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.stages import begin

__all__ = ["check_initial", "solve_harmonic_balance", "solve_linear"]

MAX_HARMONICS = 300
"""If more are needed for a tolerance, or more than MAX_SAMPLES, it is out of reach."""
SAFETY, SHARE = 0.6, 0.3
"""Parts of a tolerance that the whole estimate may take, and one of its causes before it is worked
on: estimates are known to a factor of about two."""
DISPROVED = 3.0
"""Change from one solution to a finer one, relative to the error estimated of the first, beyond
which estimates are not believed."""
FIRST_MODES, COVER = 10, 1.5
"""Modes with which a large structure is tried first; H times the frequency relative to that of the
highest mode kept, from which on it is covered."""


def solve_linear(structure: Structure, omega: float, *, harmonics: int = 5) -> PeriodicSolution:
    """Steady vibration with lips that pass through each other, A u = c (collective).

    Parameters
    ----------
    structure, omega
        As in :class:`fenics_crack.Problem`.
    harmonics : int
        H; all beyond the first are zero.

    Raises
    ------
    InputError
        omega or harmonics cannot be used.
    ConvergenceError
        An undamped structure is at resonance, or one that is not held has a mean load.
    """
    check_omega(omega)
    check_count("harmonics", harmonics, 1)
    load = to_complex(load_coefficients(structure, harmonics, 1))
    amplitude = np.zeros_like(load)
    for k in (0, 1):
        if np.any(structure.sum_over_ranks(np.abs(load[k]).sum(keepdims=True))):
            amplitude[k] = _linear_amplitude(structure, k * omega, load[k])
    displacement = from_complex(amplitude)
    gap = structure.apply_bt(displacement)
    gap[0] -= structure.clearance
    return PeriodicSolution(structure, omega, None, displacement, gap, np.zeros_like(gap))


def _linear_amplitude(structure: Structure, omega: float, load: np.ndarray) -> np.ndarray:
    """Complex displacement under a load (n_local,)."""
    if not structure.light_lips:
        with DynamicStiffness(structure, omega) as block:
            found: np.ndarray = block.solve(load[None] if omega > 0.0 else load.real[None])[0]
            return found
    modes = all_modes(structure)
    receptance = modes.receptance(np.array([omega]))[0]
    moved = modes.respond(receptance, load @ modes.shapes)
    return moved @ modes.shapes.T + load @ modes.static_loads


def solve_harmonic_balance(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    harmonics: int | None = None,
    samples: int | None = None,
    initial: PeriodicSolution | None = None,
    subharmonic: int = 1,
    tolerance: float | None = None,
    residual_tolerance: float = 1e-10,
    throw: bool = True,
) -> PeriodicSolution:
    """Steady periodic vibration with contact between the lips (collective).

    The coefficients of u(t) solve A u + B b(g) = c, the equation of motion M u'' + C u' + K u +
    B lambda(g) = f(t), g = B^T u - g0, projected on the mean and the first H harmonics: b are the
    coefficients of the contact force, c those of the load.

    Parameters
    ----------
    structure, omega, contact, subharmonic
        As in :class:`fenics_crack.Problem`.
    samples : int, optional
        As in :class:`fenics_crack.Problem`; at least 4 H + 1.
    harmonics : int, optional
        H; default: 5, or what ``tolerance`` asks for.
    initial : PeriodicSolution, optional
        Where Newton starts; default: the linear solution, or a marched orbit where pairs are seen
        through a static compliance. May have other harmonics, and a subharmonic that divides that
        of the response.
    tolerance : float, optional
        Choose H, the samples of a law that needs them, and for a structure with many dofs the modes
        of a reduction, so that the estimated error (:class:`ErrorReport`) is below this; the
        solution's status says what was chosen. ``harmonics`` and ``samples`` are then left out.
    residual_tolerance : float
        ``|F(x)| / |x|`` of the algebraic equations; with very stiff contact (k R > 1e5) rounding
        alone leaves more, eps k R, which is then accepted and reported.
    throw : bool
        Raise if nothing converged; else return the last iterate, ``converged`` being False.

    Returns
    -------
    PeriodicSolution
        With its estimated errors, ``report``.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No attempt met the tolerance; carries the residual history.

    Notes
    -----
    PETSc options with the prefix ``crack_hb_`` reach SNES, for example ``-crack_hb_snes_monitor``.

    Source: the paper, eqs 2 to 15, with the corrections listed in ``docs/theory.md``.
    """
    check_number("residual_tolerance", residual_tolerance, 0.0, above=True)
    if tolerance is not None:
        check_number("tolerance", tolerance, 0.0, above=True)
        if harmonics is not None:
            raise InputError("tolerance", tolerance, "left out where harmonics are given")
        if samples is not None:
            raise InputError("samples", samples, "left out where a tolerance is given")
    if harmonics is None:
        check_count("subharmonic", subharmonic, 1)
        harmonics = max(5, subharmonic) if tolerance is None else max(3, 2 * subharmonic)
    problem = Problem(structure, omega, contact, harmonics, samples, subharmonic)
    if samples is not None:
        check_count("samples", samples, 4 * harmonics + 1)
    if initial is not None:
        check_initial(problem, initial)
    solver = Solver(problem, residual_tolerance, throw)
    if tolerance is not None:
        return _solve_to_tolerance(solver, tolerance, initial)
    check_memory(structure, harmonics)
    return solver.solve(initial)


def _solve_to_tolerance(
    solver: Solver, tolerance: float, initial: PeriodicSolution | None
) -> PeriodicSolution:
    """Raise H, the samples, and the modes of a reduction until the estimated error is small, and
    the change since a coarser solution agrees with what was estimated of that."""
    whole, modes = solver.problem.structure, FIRST_MODES
    reducible = not is_small(whole) and not isinstance(whole, ReducedStructure)
    if reducible:
        solver = _reduced(solver, whole, modes)
    last: PeriodicSolution | None = None
    while True:
        problem = solver.problem
        begin(f"H = {problem.harmonics}, {problem.structure.n_dofs} coordinates")
        again = last is not None
        solution = solver.attempt(last, patient=False)[1] if again else solver.solve(initial)
        if not solution.converged:
            if last is None:
                return solution
            obstacle = f"truncation; H = {problem.harmonics} failed"
            return _give_up(solver, tolerance, last, obstacle)
        report = whole.comm.bcast(solution.report)
        solution = replace(solution, report=report)
        if report.total <= SAFETY * tolerance and _confirmed(solution, last, tolerance):
            chosen = f"chosen for an error of {tolerance:g}: H = {problem.harmonics}"
            if problem.samples is not None:
                chosen += f", {problem.samples} samples"
            if reducible:
                chosen += f", {modes} modes ({problem.structure.n_dofs} coordinates)"
            return replace(solution, status=f"{solution.status}; {chosen}")
        last = solution
        finer, obstacle = _finer(problem, report, tolerance, reducible and modes < whole.n_dofs)
        if obstacle:
            return _give_up(solver, tolerance, solution, obstacle)
        solver = replace(solver, problem=finer)
        if reducible and report.reduction > SHARE * tolerance and modes < whole.n_dofs:
            modes = min(2 * modes, whole.n_dofs)
            solver = _reduced(solver, whole, modes)


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


def check_initial(problem: Problem, initial: PeriodicSolution) -> None:
    """Raise InputError unless a solution can be where a problem's solution is sought from."""
    structure, subharmonic = problem.structure, problem.subharmonic
    if not isinstance(initial, PeriodicSolution):
        raise InputError("initial", type(initial).__name__, "a PeriodicSolution")
    has = initial.structure.n_dofs, initial.structure.n_pairs
    gaps_only = structure.light_lips and has[1] == structure.n_pairs
    if not gaps_only and has != (structure.n_dofs, structure.n_pairs):
        raise InputError(
            "initial",
            f"{has[0]} dofs, {has[1]} pairs",
            f"a solution with {structure.n_dofs} dofs and {structure.n_pairs} pairs",
        )
    if subharmonic % initial.subharmonic:
        raise InputError(
            "initial",
            f"subharmonic {initial.subharmonic}",
            f"of a subharmonic that divides {subharmonic}",
        )
