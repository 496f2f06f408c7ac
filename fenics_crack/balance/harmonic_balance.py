"""Steady vibration with contact: linear solution, harmonic balance, and solution to a tolerance.

The unknowns are the Fourier coefficients of the gaps (:mod:`contact_system`). The equations are
balanced by projection on the same functions, with the contact force integrated exactly or from
samples. A second form has all displacements as unknowns (``block_system``). Other forms are kept
for comparison in ``benchmarks/laboratory.py``.

**To a tolerance** the solution is an exact orbit. Harmonic balance with few harmonics finds a
motion, and shooting finds the orbit next to it (:mod:`fenics_crack.motion.search`). The orbit's
coefficients solve

    u_k = A_k^-1 (c_k - B b_k),    with b_k the coefficients of lambda(g(t)),

for every harmonic k. As many harmonics are kept as the tolerance requires: the truncation error is
the distance between the Fourier series and the orbit. The modal truncation error is the distance to
the orbit with more modes, on the reduction's reference. The modes of a large structure are doubled
until this error is small. The search for the orbit does not depend on the tolerance, so that a
tighter tolerance never gives a worse solution.

If there is no exact flow, or no orbit is found, harmonics are added until the estimated error is
small enough.
"""

from __future__ import annotations

import contextlib
import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.block_system import BALANCE_SOLVER_CLASS_BY_FORM
from fenics_crack.balance.compliance import (
    FactorisedDynamicStiffness,
    ModalCompliance,
    load_coefficients,
)
from fenics_crack.balance.error_report import UNESTIMATED_REPORT, ErrorReport, report_by_more_modes
from fenics_crack.balance.more_modes import (
    ERROR_IF_UNKNOWN,
    MoreModesComparison,
    more_modes_structure_of,
)
from fenics_crack.balance.problem import Problem, check_memory, least_harmonics
from fenics_crack.balance.solution import HarmonicBalanceSolver, PeriodicSolution
from fenics_crack.basics.errors import (
    ConvergenceError,
    InputError,
    check_choice,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.suggestions import check_argument_class_or_unwrap_run
from fenics_crack.basics.tables import format_percent, format_quantity
from fenics_crack.model.contact import ContactLaw, friction_of
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import LIP_STATES
from fenics_crack.model.reduced import ReducedStructure, as_massless_structure_or_none
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import ContactFlow, exact_flow_or_error, exact_flow_or_none
from fenics_crack.motion.motions import ObservedMotion
from fenics_crack.motion.orbit import (
    MAX_MODES_FOR_MONODROMY,
    PeriodicOrbit,
    RealFourierCoefficients,
    is_orbit_search_affordable,
)
from fenics_crack.motion.search import (
    SLICE_OF_SAMPLES_AT_SEGMENT_STARTS,
    OrbitSearchResult,
    SearchOptions,
    search_orbit,
)
from fenics_crack.numerics.fourier import from_complex, to_complex
from fenics_crack.numerics.newton import change_relative_to_motion


def solve_linear(
    structure: Structure, omega: float, *, harmonics: int | None = None
) -> PeriodicSolution:
    """Return the steady vibration if crack faces pass through each other (collective).

    The displacement's coefficients u solve A u = c, with the dynamic stiffness A and the load's
    coefficients c.

    Parameters
    ----------
    structure : Structure
        Structure under its load.
    omega : float [rad/s]
        Angular frequency of the load.
    harmonics : int, optional
        Number of harmonics H; harmonics above those of the load are zero. Default: 5, or as many
        as the load has.

    Returns
    -------
    PeriodicSolution
        Without contact force. Its report has the modal truncation error of a reduced structure.

    Raises
    ------
    InputError
        omega or harmonics cannot be used.
    ConvergenceError
        An undamped structure is at resonance, or a structure that is not held has a mean load.

    Examples
    --------
    >>> linear = fc.solve_linear(structure, 2000.0)
    """
    check_omega(omega)
    min_harmonics = least_harmonics(structure, 1)
    harmonics = max(Problem.harmonics, min_harmonics) if harmonics is None else harmonics
    check_count("harmonics", harmonics, min_harmonics)
    solution = _linear_periodic_solution(structure, omega, harmonics)

    @cache
    def estimate() -> ErrorReport:
        """Return the error report: modal truncation, from the linear solution with more modes."""
        more_modes_structure = more_modes_structure_of(solution)
        if more_modes_structure is None:
            return ErrorReport()
        return report_by_more_modes(
            solution, _linear_periodic_solution(more_modes_structure, omega, harmonics)
        )

    return replace(solution, estimate=estimate)


def _linear_periodic_solution(
    structure: Structure, omega: float, harmonics: int
) -> PeriodicSolution:
    """Return the linear solution, without contact forces, with H = ``harmonics`` (collective).

    The solution has no estimated errors.
    """
    load_by_harmonic = to_complex(load_coefficients(structure, harmonics, 1))
    displacement_by_harmonic = np.zeros_like(load_by_harmonic)
    for k in range(len(load_by_harmonic)):
        if np.any(structure.sum_over_ranks(np.abs(load_by_harmonic[k]).sum(keepdims=True))):
            displacement_by_harmonic[k] = _complex_linear_displacement(
                structure, k * omega, load_by_harmonic[k]
            )
    displacement_rows = from_complex(displacement_by_harmonic)
    gap = structure.gap_of(displacement_rows)
    return PeriodicSolution(structure, omega, None, displacement_rows, gap, np.zeros_like(gap), 1)


def linear_response(
    structure: Structure, dof: int, omega: np.ndarray, *, lips: str = "open"
) -> np.ndarray:
    """Return amplitudes of a dof with all crack faces open, or all bonded.

    Bonded faces have no relative normal motion and slide without friction, as in
    :func:`fenics_crack.solve_modes`. Mean loads, preload, clearance and the load's harmonics above
    the first play no part; :func:`fenics_crack.solve_linear` takes them all.

    Parameters
    ----------
    structure : Structure
        Small, or reduced.
    dof : int
        Number of the dof.
    omega : (n,) [rad/s]
        Load frequencies.
    lips : "open" or "tied"
        Open or bonded faces, for all cracks.

    Returns
    -------
    (n,) array [m]
        Amplitudes; inf at an undamped resonance.

    Raises
    ------
    InputError
        The structure is not small, lips is neither word, or omega cannot be used.

    Examples
    --------
    >>> amplitude = fc.linear_response(structure, tip, np.linspace(1e3, 3e3, 50), lips="tied")
    """
    check_choice("lips", lips, LIP_STATES)
    load_omegas = floats_or_single_nan(omega)
    if load_omegas.ndim != 1 or not np.all(np.isfinite(load_omegas) & (load_omegas >= 0.0)):
        raise InputError("omega", omega, "an array (n,) of finite numbers >= 0 [rad/s]")
    load_rows = load_coefficients(structure, 1, 1)
    dof_selection_row = structure.values_at(np.eye(structure.n_dofs), [dof]).T
    amplitudes = np.full(len(load_omegas), np.inf)
    for omega_index, load_omega in enumerate(load_omegas):
        with contextlib.suppress(ConvergenceError):
            compliance_model = ModalCompliance(structure, float(load_omega), load_rows)
            bonding_force = np.zeros_like(compliance_model.linear_gap)
            if lips == "tied" and structure.n_pairs:
                complex_linear_gap = to_complex(compliance_model.linear_gap)[1]
                complex_bonding_force = np.linalg.lstsq(
                    compliance_model.matrices[1], complex_linear_gap, rcond=None
                )[0]
                bonding_force[1:] = complex_bonding_force.real, -complex_bonding_force.imag
            amplitudes[omega_index] = np.hypot(
                *compliance_model.selected_displacement(dof_selection_row, bonding_force)[1:, 0]
            )
    return amplitudes


def _complex_linear_displacement(
    structure: Structure, omega: float, complex_load: np.ndarray
) -> np.ndarray:
    """Return the complex displacement amplitude without contact: (n_local,) [m].

    ``complex_load`` (n_local,) [N] is the complex amplitude of a harmonic load with the frequency
    ``omega`` [rad/s].
    """
    if not structure.has_massless_crack_faces:
        with FactorisedDynamicStiffness(structure, omega) as dynamic_stiffness:
            return dynamic_stiffness.solve(
                complex_load[None] if omega > 0.0 else complex_load.real[None]
            )[0]
    modes = all_modes(structure)
    modal_receptance = modes.modal_receptances(np.array([omega]))[0]
    modal_displacement = modes.modal_response(modal_receptance, complex_load @ modes.shapes)
    return (
        modal_displacement @ modes.shapes.T
        + complex_load @ modes.massless_displacement_by_dof_forces
    )


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
    form: str = "condensed",
    residual_tolerance: float = HarmonicBalanceSolver.residual_tolerance,
    throw: bool = True,
) -> PeriodicSolution:
    """Return the steady periodic vibration with contact between crack faces (collective).

    The displacement u(t) solves the equation of motion M u'' + C u' + K u + B lambda(g) = f(t). M,
    C and K are mass, damping and stiffness, and f is the load. B takes contact forces lambda to the
    dofs. The gaps are g = B^T u - g0, with clearances g0. The equation is projected on the mean and
    the first H harmonics: A u + B b(g) = c. A is the dynamic stiffness; b are coefficients of the
    contact force, c of the load.

    Parameters
    ----------
    structure : Structure
        Structure that vibrates under its own load.
    omega : float [rad/s]
        Angular frequency of the load.
    contact : ContactLaw
        Law for all pairs.
    harmonics : int, optional
        Number of harmonics H. Default: as many as ``tolerance`` requires; without ``tolerance`` 5,
        or the load's number if larger.
    samples : int, optional
        Instants per period of the response at which the contact force is evaluated, at least
        4 H + 1. Default: exact integrals if the law permits (:class:`fenics_crack.Problem`).
    initial : PeriodicSolution, optional
        Solution at which Newton's method starts; default: the linear solution. The number of
        harmonics may differ. The solution's subharmonic must divide ``subharmonic``.
    subharmonic : int
        The response has this many times the load's period.
    tolerance : float, optional
        Maximum relative error (:class:`ErrorReport`). H is then chosen, at least 5 times
        ``subharmonic``, so ``harmonics`` and ``samples`` must not be given. A structure with many
        dofs is reduced, and the number of modes is chosen, too. If the exact flow is known, the
        coefficients belong to an exact orbit. The status says what was chosen, or what limits the
        error of the best solution.
    form : "condensed" or "block"
        "condensed": the unknowns are the gaps. "block": the unknowns are all displacements, found
        by PETSc's SNES on a sparse block system (``fenics_crack.balance.block_system``). Both have
        the same integrals of the contact force and the same solutions. The block form is a check,
        and takes 20 times the time or more. Refused with a tolerance, with friction, and for a
        rigid law of crack faces with mass.
    residual_tolerance : float
        Maximum ``|F(x)| / |x|`` of the algebraic equations F(x) = 0. With very stiff contact,
        rounding leaves a larger residual: eps k R, with machine epsilon eps, contact stiffness k
        and compliance R. From k R = 1e5 on, this residual is accepted and reported.
    throw : bool
        True: raise ConvergenceError if no attempt converged, or the tolerance is missed. False:
        return the last iterate, with ``converged`` False, or the best solution.

    Returns
    -------
    PeriodicSolution
        With its estimated errors, ``report``.

    Raises
    ------
    InputError
        An argument cannot be used. Or no attempt converged, and the law's tangent is not the slope
        of its force.
    ConvergenceError
        No attempt converged, with the residual history; or ``tolerance`` is missed.

    Notes
    -----
    PETSc options with the prefix ``crack_hb_`` reach SNES, for example ``-crack_hb_snes_monitor``.
    In the block form they also reach KSP and PC, for example
    ``-crack_hb_ksp_type gmres -crack_hb_pc_type bjacobi``.

    Source: the paper, eqs 2 to 15, with the corrections listed in ``docs/the_paper.md``.

    Examples
    --------
    >>> solution = fc.solve_harmonic_balance(structure, 2000.0, contact, harmonics=20)
    >>> error = solution.report.total
    """
    check_choice("form", form, BALANCE_SOLVER_CLASS_BY_FORM)
    check_number("residual_tolerance", residual_tolerance, 0.0, excludes_bound=True)
    if tolerance is not None:
        check_number("tolerance", tolerance, 0.0, excludes_bound=True)
        if harmonics is not None:
            raise InputError("tolerance", tolerance, "left out with harmonics; give one of the two")
        if samples is not None:
            raise InputError("samples", samples, "left out with a tolerance; give one of the two")
        if form == "block":
            raise InputError("tolerance", tolerance, "left out with form = 'block'; give harmonics")
    if harmonics is None:
        check_count("subharmonic", subharmonic, 1)
        default_harmonics = Problem.harmonics
        harmonics = default_harmonics if tolerance is None else default_harmonics * subharmonic
        harmonics = max(harmonics, least_harmonics(structure, subharmonic))
    problem = Problem(structure, omega, contact, harmonics, samples, subharmonic)
    if samples is not None:
        check_count("samples", samples, 4 * harmonics + 1)
    if initial is not None:
        check_initial(problem, initial)
    solver = BALANCE_SOLVER_CLASS_BY_FORM[form](problem, residual_tolerance, throw)
    if tolerance is not None:
        return solve_to_tolerance(solver, tolerance, initial)
    check_memory(structure, harmonics)
    return solver.solve(initial)


def check_initial(problem: Problem, initial: PeriodicSolution) -> None:
    """Raise InputError unless a solution can start the search for a problem's solution.

    The structure of ``initial`` must have as many dofs and pairs as the structure of ``problem``.
    If crack faces have no mass, the number of dofs may differ. The subharmonic of ``initial`` must
    divide the subharmonic of ``problem``.
    """
    structure, subharmonic = problem.structure, problem.subharmonic
    check_argument_class_or_unwrap_run("initial", initial, "PeriodicSolution", {"PeriodicSolution"})
    initial_dofs_and_pairs = initial.structure.n_dofs, initial.structure.n_pairs
    needs_gaps_only = (
        structure.has_massless_crack_faces and initial_dofs_and_pairs[1] == structure.n_pairs
    )
    if not needs_gaps_only and initial_dofs_and_pairs != (structure.n_dofs, structure.n_pairs):
        requirement = (
            f"a solution with {structure.n_dofs} dofs and {structure.n_pairs} pairs, "
            "as the structure has"
        )
        raise InputError(
            "initial",
            f"{initial_dofs_and_pairs[0]} dofs, {initial_dofs_and_pairs[1]} pairs",
            requirement,
        )
    if subharmonic % initial.subharmonic:
        requirement = f"a solution whose subharmonic divides {subharmonic}"
        raise InputError("initial", f"subharmonic {initial.subharmonic}", requirement)


MAX_MODES_CHANGE_TO_TOLERANCE = 3.0
"""Maximum predicted gap change over the tolerance, to search an orbit with more modes.

The orbit with more modes gives the exact modal truncation error. While the tolerance chooses the
modes, a larger prediction is enough to go on to more modes, without a search from this prediction.
For the solution that is returned the search has no such limit.
"""
FIRST_MODE_COUNT = 10
"""Number of modes in the first attempt to meet a tolerance, for a large structure."""
MAX_HARMONICS = 500
"""Maximum number of harmonics of a solution. The series of an exact orbit may have as many for each
load period in the response's period."""


def mode_counts_to_try(
    structure: Structure,
    first_modes: int = FIRST_MODE_COUNT,
    max_modes: int = MAX_MODES_FOR_MONODROMY,
) -> list[int]:
    """Return the numbers of modes to try one after the other.

    The numbers begin with ``first_modes`` and double up to ``max_modes``, or up to the number of
    the structure's dofs if that is smaller.
    """
    max_modes = min(max(first_modes, max_modes), structure.n_dofs)
    n_doublings = max(0, math.ceil(math.log2(max_modes / first_modes)))
    return [
        min(first_modes * 2**n_doublings_so_far, max_modes)
        for n_doublings_so_far in range(n_doublings + 1)
    ]


def solve_to_tolerance(
    solver: HarmonicBalanceSolver,
    tolerance: float,
    initial: PeriodicSolution | None = None,
    *,
    structures: Iterable[Structure] | None = None,
    modes_key: str = "",
) -> PeriodicSolution:
    """Return a solution with few modes and harmonics that meet a tolerance (collective).

    A solution by an exact orbit has no fewer harmonics than the problem. If the tolerance is
    missed, ConvergenceError says by how much; with ``solver.throw`` False the best solution is
    returned.

    Parameters
    ----------
    solver : Solver
        Solver for the problem.
    tolerance : float
        Maximum total error (:attr:`ErrorReport.total`).
    initial : PeriodicSolution, optional
        Start of the search.
    structures : iterable of Structure, optional
        Reductions with more and more modes, each made on demand. Default: a large structure is
        reduced to 10, 20, ... modes; a small or reduced structure is solved as it is.
    modes_key : str
        Name of the input file's entry for the number of modes, for messages. "": messages say
        "modes", or "families" for a bladed disk.
    """
    whole_structure = solver.problem.structure
    if structures is None and (
        is_small(whole_structure) or isinstance(whole_structure, ReducedStructure)
    ):
        structures = [whole_structure]
    elif structures is None:
        reduce_to = partial(reduce_structure, whole_structure, method="massless")
        structures = (reduce_to(modes=modes) for modes in mode_counts_to_try(whole_structure))
    best_solution = None
    for structure in structures:
        solver = replace(solver, problem=replace(solver.problem, structure=structure))
        solution = _solve_with_present_modes(solver, tolerance, initial)
        more_modes = solution.orbit and solution.assessment.more_modes
        is_modal_error_linearised = bool(more_modes and more_modes.is_predicted_change_too_large)
        report, is_modal_error_linearised = whole_structure.comm.bcast(
            (solution.report, is_modal_error_linearised)
        )
        solution = solution.reported(report)
        if not is_modal_error_linearised:
            best_solution = _solution_with_smaller_error(best_solution, solution)
        if not (solution.converged and lacks_modes(solution, tolerance)):
            break
        initial = solution if structure.has_massless_crack_faces else None
    if (
        is_modal_error_linearised and solution.orbit is not None
    ):  # the last solution has the most modes
        problem = replace(solver.problem, harmonics=solution.harmonics)
        status, other_orbits = solution.status, solution.others
        solution = orbit_solution_to_tolerance(
            problem, solution.orbit, tolerance, balances_more_modes=True
        )
        solution = solution.reported(whole_structure.comm.bcast(solution.report))
        solution = replace(solution, status=status, others=other_orbits)
        best_solution = _solution_with_smaller_error(best_solution, solution)
    assert best_solution is not None
    return _with_tolerance_status(solver, best_solution, tolerance, modes_key)


def _solution_with_smaller_error(
    solution: PeriodicSolution | None, other_solution: PeriodicSolution
) -> PeriodicSolution:
    """Return the solution with the smaller total error.

    If ``solution`` is None, return ``other_solution``.
    """
    if solution is None or other_solution.report.total < solution.report.total:
        return other_solution
    return solution


def lacks_modes(solution: PeriodicSolution, tolerance: float) -> bool:
    """Return True if a solution misses a tolerance for lack of modes.

    The total error is above the tolerance, and the modal truncation error above half of it.
    """
    return solution.report.total > tolerance and solution.report.reduction > tolerance / 2.0


def solve_from_neighbour(
    problem: Problem,
    neighbour: PeriodicSolution | None,
    tolerance: float | None = None,
    *,
    with_errors: bool = True,
) -> PeriodicSolution:
    """Return a small structure's solution, searched from a neighbouring solution.

    With a tolerance, an exact orbit is searched first. The solution keeps as many of the orbit's
    harmonics as bring the truncation error below the tolerance. If no orbit is found, harmonics are
    added to the harmonic-balance solution.

    Parameters
    ----------
    problem : Problem
        Problem to solve, with a small structure.
    neighbour : PeriodicSolution or None
        Start of the search; None: the linear solution.
    tolerance : float, optional
        Maximum truncation error; None: the problem's harmonics are kept.
    with_errors : bool
        False: without a tolerance, errors are not estimated.

    Raises
    ------
    InputError
        The contact is so stiff that rounding hides the contact force.
    ConvergenceError
        No solution is found, or the truncation error stays above the tolerance.
    """
    if tolerance is None:
        balanced_solution = HarmonicBalanceSolver(problem).solve(neighbour)
        return balanced_solution if with_errors else balanced_solution.reported(UNESTIMATED_REPORT)
    solution = _solve_with_present_modes(HarmonicBalanceSolver(problem), tolerance, neighbour)
    if not (truncation_error := solution.report.truncation) <= tolerance:
        error_text = (
            f"the estimated truncation error, {truncation_error:.1e} with H = {solution.harmonics},"
        )
        message = (
            f"{error_text} stays above {tolerance:g}: use a larger tolerance, or more damping; "
            f"{solution.status}"
        )
        raise ConvergenceError(f"harmonic balance at {problem.omega:g} rad/s: {message}")
    return solution


def _allowed_harmonics_error(tolerance: float, reduction_error: float) -> float:
    """Return the error allowed for truncated harmonics and samples.

    The allowed error is ``tolerance`` less the modal truncation error ``reduction_error``, at most
    half the tolerance. If the modal truncation error exceeds the tolerance, the allowed error is
    half the tolerance.
    """
    remaining_error = tolerance - reduction_error
    return min(remaining_error, tolerance / 2.0) if remaining_error > 0.0 else tolerance / 2.0


def _with_tolerance_status(
    solver: HarmonicBalanceSolver, solution: PeriodicSolution, tolerance: float, modes_key: str
) -> PeriodicSolution:
    """Return a solution whose status says if the tolerance is met.

    If it is missed, the status names a remedy. If ``solver.throw`` is True, ConvergenceError is
    then raised with this text. A solution that did not converge is returned unchanged.
    ``modes_key`` is the name of the number of modes in messages; "": "modes", or "families" for a
    bladed disk.
    """
    report, structure = solution.report, solution.structure
    if not solution.converged:
        return solution
    massless_structure = as_massless_structure_or_none(structure)
    kept_modes_text = ""
    modes_remedy_text = modes_key or "modes"
    n_sectors = 1
    if isinstance(structure, ReducedStructure):
        size_text = f"{structure.n_dofs} coordinates"
        kept_modes_text = f", {size_text}"
        if massless_structure is not None:
            kept_modes_text = f", {massless_structure.n_modes} modes ({size_text})"
            n_sectors = massless_structure.whole.n_sectors
            modes_remedy_text = modes_key or ("families" if n_sectors > 1 else "modes")
            modes_remedy_text += (
                f" = {2 * massless_structure.n_modes // n_sectors}, in about twice the time"
            )
    if report.total <= tolerance:
        choice_text = (
            f"chosen for an error of {tolerance:g}: H = {solution.harmonics}{kept_modes_text}"
        )
        return replace(solution, status=f"{solution.status}; {choice_text}")
    error_by_remedy = {
        modes_remedy_text: report.reduction,
        "more damping, which needs fewer harmonics": report.truncation + report.sampling,
        "a larger tolerance, as rounding causes the error": report.residual,
    }
    size_text = "unknown" if report.unknown else format_percent(report.total)
    message = (
        f"solved; error {size_text}, but {format_percent(tolerance)} was requested; what helps: "
    )
    message += (
        f"{max(error_by_remedy, key=error_by_remedy.__getitem__)} "
        f"(H = {solution.harmonics}{kept_modes_text})"
    )
    if solver.throw:
        message += f"; {solution.status}; throw = False returns this solution"
        raise ConvergenceError(f"harmonic balance at {solution.omega:g} rad/s: {message}")
    return replace(solution, status=f"{message}; {solution.status}")


def _solve_with_present_modes(
    solver: HarmonicBalanceSolver, tolerance: float, initial: PeriodicSolution | None
) -> PeriodicSolution:
    """Return a solution to a tolerance with the structure's present modes.

    If there is an exact flow and an orbit is found, the solution is this orbit's Fourier series.
    Otherwise harmonics are added to the harmonic-balance solution. ``tolerance`` limits the total
    error, and ``initial`` is the start of the search; None: the linear solution.
    """
    problem = solver.problem
    flow = exact_flow_or_none(problem.structure, problem.contact)
    if flow is None or not is_orbit_search_affordable(flow, problem.omega, problem.subharmonic):
        return _solve_with_growing_harmonics(
            solver, tolerance, _solver_for_other_problem(solver, problem).solve(initial)
        )
    solutions, search = _search_orbit_from_solutions(solver, flow, initial)
    if search.orbit is not None:
        orbit_solution = orbit_solution_to_tolerance(
            problem,
            search.orbit,
            tolerance,
            initial,
            MAX_MODES_CHANGE_TO_TOLERANCE * tolerance,
            balances_more_modes=True,
        )
        origin_text = (
            f"{search.outcome_text}, begun from harmonic balance with H = {solutions[-1].harmonics}"
            if solutions
            else search.outcome_text
        )
        return replace(
            orbit_solution,
            status=origin_text + _describe_other_orbits(search),
            others=search.other_orbits,
        )
    if solutions:
        initial = solutions[-1]
        problem = problem.with_harmonics(initial.harmonics)
    solution = _solve_with_growing_harmonics(
        solver, tolerance, _solver_for_other_problem(solver, problem).solve(initial)
    )
    harmonics_text = ", ".join(
        str(n_harmonics_per_load_period * problem.subharmonic)
        for n_harmonics_per_load_period in SearchOptions.guess_harmonic_counts
    )
    status = (
        f"no exact orbit was found from H = {harmonics_text}; {search.outcome_text}; harmonic "
        f"balance alone gives the solution; {solution.status}"
    )
    return replace(solution, status=status)


# --- by an orbit ----------------------------------------------------------------------------------


def search_orbit_by_harmonic_balance(
    problem: Problem, initial: PeriodicSolution | None = None, *, prefer_stable: bool = True
) -> OrbitSearchResult:
    """Search for an exact orbit from harmonic-balance solutions with 5 to 40 harmonics.

    Each solution is searched from ``initial``. If ``initial`` has an orbit, this orbit is tried
    first. Without ``initial``, and with ``prefer_stable``, the search goes on after an unstable
    orbit.

    Raises
    ------
    InputError
        There is no exact flow.
    """
    flow = exact_flow_or_error(problem.structure, problem.contact)
    solver = HarmonicBalanceSolver(problem, throw=False)
    return _search_orbit_from_solutions(solver, flow, initial, prefer_stable=prefer_stable)[1]


def _search_orbit_from_solutions(
    solver: HarmonicBalanceSolver,
    flow: ContactFlow,
    initial: PeriodicSolution | None,
    *,
    prefer_stable: bool = True,
) -> tuple[list[PeriodicSolution], OrbitSearchResult]:
    """Search for an orbit from harmonic-balance solutions with 5 to 40 harmonics, ascending.

    Parameters
    ----------
    solver : Solver
        Solver for the problem, used with other numbers of harmonics.
    flow : ContactFlow
        Exact flow, in which the orbit is searched.
    initial : PeriodicSolution or None
        Start of each harmonic-balance solution. Its orbit, if any, is tried first.
    prefer_stable : bool
        True: without ``initial``, the search goes on after an unstable orbit.

    Returns
    -------
    solutions : list of PeriodicSolution
        Converged solutions that were computed.
    search_result : OrbitSearchResult
        Orbit, or None, and the outcome in words.
    """
    problem, solutions = solver.problem, list[PeriodicSolution]()

    def state_guesses() -> Iterator[np.ndarray]:
        """Yield states at 32 instants: of the initial orbit, then of harmonic-balance solutions."""
        if initial is not None and initial.orbit is not None:
            orbit = initial.orbit
            if initial.structure is problem.structure and orbit.subharmonic == problem.subharmonic:
                yield orbit.period_samples.whole_states[SLICE_OF_SAMPLES_AT_SEGMENT_STARTS]
            elif (
                flow.n_modes > orbit.flow.n_modes
                and initial.structure.has_massless_crack_faces
                and bool(flow.friction_law) == bool(orbit.flow.friction_law)
            ):  # states with friction have slider positions, too
                yield _states_with_more_modes(flow, initial.assessment, orbit)
        for n_harmonics_per_load_period in SearchOptions.guess_harmonic_counts:
            start_problem = problem.with_harmonics(
                problem.response_harmonics(n_harmonics_per_load_period)
            )
            solution = _solver_for_other_problem(solver, start_problem).search_and_solution(
                initial, with_whole_budget=False
            )[1]
            if solution.converged:
                solutions.append(solution)
                yield solution.assessment.states_at_period_parts

    search = search_orbit(
        flow,
        problem.omega,
        state_guesses(),
        problem.subharmonic,
        prefer_stable=prefer_stable and initial is None,
    )
    return solutions, search


def _states_with_more_modes(
    flow: ContactFlow, assessment: Assessment, orbit: PeriodicOrbit
) -> np.ndarray:
    """Return an orbit's states on a flow with more modes: (32, flow.state_size).

    The states belong to 32 equal parts of the period. If the assessment already has an orbit with
    as many modes as ``flow``, its states are returned; otherwise new modes are added to ``orbit``.
    """
    more_modes = assessment.more_modes
    if more_modes and more_modes.orbit and more_modes.flow.n_modes == flow.n_modes:
        return more_modes.orbit.period_samples.whole_states[SLICE_OF_SAMPLES_AT_SEGMENT_STARTS]
    return MoreModesComparison(
        flow, assessment.wave, orbit
    ).nearest_orbit_states_with_static_new_modes


def _solver_for_other_problem(
    solver: HarmonicBalanceSolver, problem: Problem
) -> HarmonicBalanceSolver:
    """Return a copy of a solver with the same settings, for another problem.

    Usually ``problem`` has another number of harmonics. The numbers of harmonics and coordinates
    are reported as progress.
    """
    begin_stage(f"H = {problem.harmonics}, {problem.structure.n_dofs} coordinates")
    return replace(solver, problem=problem)


def _describe_other_orbits(search: OrbitSearchResult) -> str:
    """Return a text on the stability and amplitude of other orbits that a search found, or ""."""
    descriptions = [
        f"{'stable' if orbit.is_stable else 'unstable'}, "
        f"amplitude {format_quantity(orbit.amplitude(), 'm')}"
        for orbit in search.other_orbits
    ]
    return f"; other orbits at this frequency: {'; '.join(descriptions)}" if descriptions else ""


def orbit_solution_to_tolerance(
    problem: Problem,
    orbit: PeriodicOrbit,
    tolerance: float,
    initial: PeriodicSolution | None = None,
    max_predicted_change_for_search: float = math.inf,
    *,
    balances_more_modes: bool = False,
) -> PeriodicSolution:
    """Return an orbit's Fourier series with the fewest harmonics that meet a tolerance.

    The series has no fewer harmonics than the problem. Its errors are due to the truncated
    harmonics and modes.

    Parameters
    ----------
    problem : Problem
        Problem of the orbit, with the minimum number of harmonics.
    orbit : PeriodicOrbit
        Exact orbit.
    tolerance : float
        Maximum relative error of the gaps.
    initial : PeriodicSolution, optional
        Neighbouring solution. With the same structure, its solver for I - M makes the search with
        more modes faster; M is the monodromy matrix.
    max_predicted_change_for_search : float
        Largest relative gap change by more modes up to which Newton's method searches the orbit
        with more modes. A linear prediction gives the change.
    balances_more_modes : bool
        True: if Newton's method fails, search the orbit with more modes by harmonic balance. The
        search takes about as long as a solution, so points of a curve have False.
    """
    max_harmonics = MAX_HARMONICS * problem.subharmonic
    coefficients = orbit.coefficients(
        problem.response_harmonics(SearchOptions.guess_harmonic_counts[-1])
    )
    more_modes: MoreModesComparison | None = None

    def solution_with_harmonics(harmonics: int) -> PeriodicSolution:
        nonlocal coefficients
        if 2 * harmonics + 1 > len(coefficients.gap):
            coefficients = orbit.coefficients(harmonics)
        return truncated_orbit_solution(
            problem.with_harmonics(harmonics), orbit, coefficients, more_modes
        )

    more_modes = solution_with_harmonics(
        problem.response_harmonics(SearchOptions.guess_harmonic_counts[0])
    ).assessment.more_modes
    if more_modes:
        more_modes = replace(
            more_modes, max_predicted_change_for_search=max_predicted_change_for_search
        )
    if more_modes and initial and initial.structure is problem.structure:
        more_modes_of_initial_solution = initial.assessment.more_modes
        more_modes = replace(
            more_modes,
            i_minus_m_solver=more_modes_of_initial_solution.orbit_i_minus_m_solver
            if more_modes_of_initial_solution
            else None,
        )
    if balances_more_modes:
        more_modes = _more_modes_with_balanced_orbit(problem, solution_with_harmonics, more_modes)
    modal_gap_error, modal_displacement_error = _modal_truncation_errors(
        problem, solution_with_harmonics, more_modes, balances_more_modes
    )
    allowed_harmonics_error = _allowed_harmonics_error(tolerance, modal_gap_error)
    n_insufficient_harmonics, solution = 0, solution_with_harmonics(problem.harmonics)
    while (
        not solution.assessment.relative_orbit_distance <= allowed_harmonics_error
        and solution.harmonics < max_harmonics
    ):
        n_insufficient_harmonics = solution.harmonics
        solution = solution_with_harmonics(min(2 * solution.harmonics, max_harmonics))
    if n_insufficient_harmonics:
        harmonics = bisect_left(
            range(solution.harmonics),
            True,
            n_insufficient_harmonics + 1,
            key=lambda count: (
                solution_with_harmonics(count).assessment.relative_orbit_distance
                <= allowed_harmonics_error
            ),
        )
        solution = solution_with_harmonics(harmonics)
    gap_samples = orbit.gap
    gap_and_displacement_errors = solution.assessment.gap_and_displacement_errors()
    gap_plus_clearance_samples = gap_samples + problem.structure.clearance
    report = ErrorReport(
        residual=orbit.residual,
        truncation=gap_and_displacement_errors[0],
        reduction=modal_gap_error,
        penetration=change_relative_to_motion(
            np.maximum(gap_samples, 0.0), gap_plus_clearance_samples
        ),
        displacement=min(
            gap_and_displacement_errors[1] + modal_displacement_error, ERROR_IF_UNKNOWN
        ),
    )
    return replace(solution.reported(report), iterations=orbit.iterations)


def truncated_orbit_solution(
    problem: Problem,
    orbit: PeriodicOrbit,
    coefficients: RealFourierCoefficients,
    more_modes: MoreModesComparison | None = None,
) -> PeriodicSolution:
    """Return a solution whose coefficients are an orbit's Fourier series, truncated.

    Parameters
    ----------
    problem : Problem
        Problem of the orbit, with the number of harmonics H to keep.
    orbit : PeriodicOrbit
        Exact orbit.
    coefficients : RealFourierCoefficients
        Coefficients of the orbit's displacement, gap and force, with at least H harmonics.
    more_modes : MoreModesComparison, optional
        The orbit's motion with more modes, if known.
    """
    row_slice = slice(2 * problem.harmonics + 1)
    wave = problem.wave_of(
        coefficients.displacement[row_slice],
        coefficients.gap[row_slice],
        coefficients.force[row_slice],
    )
    return PeriodicSolution(**vars(wave), assessment=Assessment(wave, orbit, more_modes=more_modes))


def _more_modes_with_balanced_orbit(
    problem: Problem,
    solution_with_harmonics: Callable[[int], PeriodicSolution],
    more_modes: MoreModesComparison | None,
) -> MoreModesComparison | None:
    """Search the orbit with more modes by harmonic balance, if Newton's method failed.

    Harmonic balance with more modes and 40 harmonics of the load frequency starts from the orbit's
    series. ``solution_with_harmonics`` returns this series with a given number of harmonics. If the
    solution has a close exact orbit (:attr:`Assessment.close_orbit`), ``more_modes``
    is returned with this orbit.

    ``more_modes`` is returned unchanged in five cases:

    - It is None: no flow with more modes is known.
    - The orbit with more modes is known.
    - Its predicted change is too large (:attr:`MoreModesComparison.is_predicted_change_too_large`).
    - Crack faces have mass.
    - Harmonic balance fails, or no exact orbit is close to its solution.
    """
    if (
        more_modes is None
        or not problem.structure.has_massless_crack_faces
        or more_modes.orbit is not None
        or more_modes.is_predicted_change_too_large
    ):
        return more_modes
    n_harmonics = problem.response_harmonics(SearchOptions.guess_harmonic_counts[-1])
    more_modes_problem = replace(problem, structure=more_modes.flow.structure)
    more_modes_solution = HarmonicBalanceSolver(
        more_modes_problem.with_harmonics(n_harmonics)
    ).search_and_solution(solution_with_harmonics(n_harmonics))[1]
    if more_modes_solution.converged and (
        more_modes_orbit := more_modes_solution.assessment.close_orbit
    ):
        return replace(more_modes, known_orbit_with_more_modes=more_modes_orbit)
    return more_modes  # which keeps what Newton's method found out


def _modal_truncation_errors(
    problem: Problem,
    solution_with_harmonics: Callable[[int], PeriodicSolution],
    more_modes: MoreModesComparison | None,
    balances_more_modes: bool,
) -> tuple[float, float]:
    """Return the modal truncation errors of an orbit.

    If the orbit with more modes is known, the errors follow from it. If it is not known, and its
    predicted change is too large for a search, they follow from one Newton step. In all other cases
    harmonic balance with 40 harmonics of the load frequency computes them; if this fails, or is not
    allowed, they follow from one Newton step.

    Parameters
    ----------
    problem : Problem
        Problem of the orbit.
    solution_with_harmonics : callable
        Returns the orbit's series as a solution with a given number of harmonics.
    more_modes : MoreModesComparison or None
        The orbit's motion with more modes, if known.
    balances_more_modes : bool
        Allow harmonic balance. It is always allowed if ``more_modes`` is None.

    Returns
    -------
    gap, displacement : float
        Relative errors of gaps, and of the displacement at the load; 0 for a structure without
        reference, 1 if unknown.
    """
    reduced_structure = problem.structure
    if not isinstance(reduced_structure, ReducedStructure) or reduced_structure.reference is None:
        return 0.0, 0.0
    if more_modes is None or (
        balances_more_modes
        and more_modes.orbit is None
        and not more_modes.is_predicted_change_too_large
    ):
        n_harmonics = problem.response_harmonics(SearchOptions.guess_harmonic_counts[-1])
        solver_with_many_harmonics = HarmonicBalanceSolver(problem.with_harmonics(n_harmonics))
        balanced_solution = solver_with_many_harmonics.search_and_solution(
            solution_with_harmonics(n_harmonics), with_whole_budget=False, more_modes=more_modes
        )[1]
        if balanced_solution.converged:
            return balanced_solution.report.reduction, balanced_solution.report.displacement
    return (more_modes and more_modes.gap_and_displacement_errors) or (
        ERROR_IF_UNKNOWN,
        ERROR_IF_UNKNOWN,
    )


# --- by harmonics ---------------------------------------------------------------------------------


def _solve_with_growing_harmonics(
    solver: HarmonicBalanceSolver, tolerance: float, solution: PeriodicSolution
) -> PeriodicSolution:
    """Double the harmonics until the error is small, and return the best solution.

    The best solution has the smallest total error. The doubling ends if
    :func:`_needs_or_allows_no_more_harmonics` is True, or if Newton's method does not converge.

    Parameters
    ----------
    solver : Solver
        Solver for the problem.
    tolerance : float
        Maximum total error.
    solution : PeriodicSolution
        Solution with the first number of harmonics.
    """
    best_solution = solution
    while solution.converged and not _needs_or_allows_no_more_harmonics(solution, tolerance):
        harmonics = min(2 * solution.harmonics, MAX_HARMONICS)
        finer_solver = _solver_for_other_problem(solver, solver.problem.with_harmonics(harmonics))
        solution = finer_solver.search_and_solution(solution, with_whole_budget=False)[1]
        if solution.converged and solution.report.total < best_solution.report.total:
            best_solution = solution
    return best_solution


def _needs_or_allows_no_more_harmonics(solution: PeriodicSolution, tolerance: float) -> bool:
    """Return True if no more harmonics are needed, or allowed.

    True in three cases:

    - The sum of truncation and sampling error is at most :func:`_allowed_harmonics_error`.
    - The error is still unknown with 40 harmonics of the load frequency.
    - The solution has 500 harmonics.

    With sampled contact forces, more harmonics also mean more samples.
    """
    truncation_and_sampling = solution.report.truncation + solution.report.sampling
    is_error_unknown = (
        truncation_and_sampling >= ERROR_IF_UNKNOWN
        and solution.harmonics >= SearchOptions.guess_harmonic_counts[-1] * solution.subharmonic
    )
    meets_goal = truncation_and_sampling <= _allowed_harmonics_error(
        tolerance, solution.report.reduction
    )
    return meets_goal or is_error_unknown or solution.harmonics >= MAX_HARMONICS


# --- friction on solids ---------------------------------------------------------------------------


def slide_along_lines(structure: Structure, omega: float, contact: ContactLaw) -> ContactLaw:
    """Return a friction law with the lines along which a solid's pairs slide (collective).

    Friction acts along one line for each pair, the main direction of sliding in the vibration
    without friction. This direction is the first eigenvector of the sum over a period

        A_i = sum lambda_n,i dg_i dg_i^T,

    with the normal force lambda_n,i of pair i, and the change dg_i of its two tangential gaps. The
    direction of sliding may turn. ``turning`` measures sliding across the lines relative to sliding
    along the lines: the root of (sum over pairs of second eigenvalues) / (sum of first ones).

    Parameters
    ----------
    structure : Structure
        Small, with two tangential gaps for each pair (:meth:`Structure.with_tangents`).
    omega : float [rad/s]
        Frequency of the load.
    contact : ContactLaw
        With friction. A law without friction, with lines, or for a plate is returned unchanged.

    Returns
    -------
    ContactLaw
        With ``direction`` and ``turning``.

    Raises
    ------
    ConvergenceError
        The vibration without friction is not found.

    Examples
    --------
    >>> rubbing = fc.slide_along_lines(structure, 2e3, fc.CoulombFriction(contact, 0.3))
    """
    return law_along_lines(structure, contact, partial(motion_without_friction, structure, omega))


def law_along_lines(
    structure: Structure,
    contact: ContactLaw,
    find_frictionless_motion: Callable[[ContactLaw], ObservedMotion],
) -> ContactLaw:
    """Return a friction law with the lines along which a solid's pairs slide (collective).

    ``find_frictionless_motion`` takes the law without friction, and returns the motion under it.
    The lines follow from this motion (:func:`slide_along_lines`). A law without friction, with
    lines, or for a plate is returned unchanged.
    """
    friction_law, tangential_gap_matrix = friction_of(contact), structure.tangential
    if friction_law is None or friction_law.direction is not None or tangential_gap_matrix is None:
        return contact
    if tangential_gap_matrix.shape[1] == structure.n_pairs:
        return contact
    line_angles, turning_ratio = find_line_angles_and_turning(
        find_frictionless_motion(friction_law.law)
    )
    return replace(friction_law, direction=line_angles, turning=turning_ratio)


def motion_without_friction(
    structure: Structure, omega: float, law: ContactLaw, subharmonic: int = 1
) -> PeriodicOrbit | PeriodicSolution:
    """Return the motion under a law without friction (collective).

    The motion is the exact orbit. If no orbit is close enough to the harmonic-balance solution
    (:attr:`Assessment.is_accepted`), the motion is this solution.
    """
    problem = Problem(structure, omega, law, subharmonic=subharmonic)
    problem_with_response_harmonics = problem.with_harmonics(
        problem.response_harmonics(problem.harmonics)
    )
    solution = HarmonicBalanceSolver(problem_with_response_harmonics).solve()
    assessment = solution.assessment
    return (
        assessment.nearest_orbit
        if assessment.is_accepted and assessment.nearest_orbit is not None
        else solution
    )


def find_line_angles_and_turning(
    motion: ObservedMotion, line_angles: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Return the lines along which pairs slide, and how much sliding turns (collective).

    Parameters
    ----------
    motion : ObservedMotion
        Motion of a structure with two tangential gaps per pair.
    line_angles : (n_pairs,) [rad], optional
        Given lines, by their angle to the first tangent; default: the main directions of sliding.

    Returns
    -------
    line_angles : (n_pairs,) [rad]
        Angle between each pair's line and the first tangent.
    turning : float
        Sliding across the lines relative to sliding along the lines: root of the ratio between the
        sums n^T A n and t^T A t over the pairs. A is the matrix in :func:`slide_along_lines`, t the
        unit vector along the line, n across. 0 if nothing slides.
    """
    tangential_gap_matrix = motion.structure.tangential
    assert tangential_gap_matrix is not None
    [motion_record] = motion.yield_motion_records(tangential_gap_matrix.T.toarray())
    n_pairs = motion.structure.n_pairs
    slip = motion_record.row_products.reshape(len(motion_record.row_products), 2, n_pairs)
    normal_force = motion_record.forces[:, :n_pairs]
    slip_change = np.roll(slip, -1, axis=0) - slip
    mean_normal_force = np.maximum(0.5 * (np.roll(normal_force, -1, axis=0) + normal_force), 0.0)
    sliding_work_matrix_by_pair = np.einsum(
        "tip,tjp,tp->pij", slip_change, slip_change, mean_normal_force
    )
    if line_angles is None:
        main_axes = np.linalg.eigh(sliding_work_matrix_by_pair)[1][:, :, 1]
        line_angles = np.arctan2(main_axes[:, 1], main_axes[:, 0])
    line_vectors = np.array([np.cos(line_angles), np.sin(line_angles)])
    total_work_along = float(
        np.einsum("ip,jp,pij->", line_vectors, line_vectors, sliding_work_matrix_by_pair)
    )
    total_work_across = max(
        float(np.trace(sliding_work_matrix_by_pair, axis1=1, axis2=2).sum()) - total_work_along, 0.0
    )
    return line_angles, math.sqrt(
        total_work_across / total_work_along
    ) if total_work_along > 0.0 else 0.0
