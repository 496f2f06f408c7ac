"""Steady vibration with contact: linear solution, harmonic balance, and a solution to a tolerance.

The unknowns are the Fourier coefficients of the gaps (:mod:`contact_system`); the equations are
balanced by projection on the same functions, with the contact force integrated exactly or from
samples; or all displacements (``block_system``).
Other forms of the method are kept for comparison in ``benchmarks/laboratory.py``.

**To a tolerance** the solution is an exact orbit. Harmonic balance with few harmonics finds a
motion, and shooting the orbit next to it (:mod:`fenics_crack.motion.search`). Its coefficients
solve

    u_k = A_k^-1 (c_k - B b_k),    b_k those of lambda(g(t)),

for every k: as many of them are kept as the tolerance requires, by the distance of their sum from
the orbit. What a reduction leaves out is the distance to the orbit of its reference, which has
twice the modes; the modes of a large structure are doubled until that is small.
The search is independent of the tolerance, so that a tighter one never gives a worse solution.

Laws and structures without an exact flow, and motions whose orbit is not found, take as many
harmonics as bring the estimated error down.
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
from fenics_crack.balance.block_system import FORMS
from fenics_crack.balance.compliance import DynamicStiffness, ModalCompliance, load_coefficients
from fenics_crack.balance.error_report import NOT_ESTIMATED, ErrorReport, beside
from fenics_crack.balance.more_modes import UNKNOWN, MoreModes, reference_of
from fenics_crack.balance.problem import Problem, check_memory, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.errors import (
    ConvergenceError,
    InputError,
    check_choice,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.basics.progress import begin
from fenics_crack.basics.suggestions import fitting_argument
from fenics_crack.basics.tables import percent, quantity
from fenics_crack.model.contact import ContactLaw, friction_of
from fenics_crack.model.matrices import numbers
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import LIP_STATES
from fenics_crack.model.reduced import ReducedStructure, massless
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.model.wheel import Wheel
from fenics_crack.motion.flow import ContactFlow, exact_flow, flow_of
from fenics_crack.motion.motions import ObservedMotion
from fenics_crack.motion.orbit import (
    INSTANTS_PER_PERIOD,
    MAX_MODES_FOR_MONODROMY,
    OrbitCoefficients,
    PeriodicOrbit,
    is_affordable,
)
from fenics_crack.motion.search import SEGMENTS, OrbitSearch, SearchOptions, search_orbit
from fenics_crack.numerics.fourier import from_complex, to_complex
from fenics_crack.numerics.newton import relative_to_motion


def solve_linear(
    structure: Structure, omega: float, *, harmonics: int | None = None
) -> PeriodicSolution:
    """Steady vibration with crack faces that pass through each other, A u = c (collective).

    Parameters
    ----------
    structure, omega
        As in :class:`fenics_crack.Problem`.
    harmonics : int, optional
        H; all beyond those of the load are zero. Default: 5, or as many as the load has.

    Returns
    -------
    PeriodicSolution
        Without contact force. Its report has what a reduction leaves out.

    Raises
    ------
    InputError
        omega or harmonics cannot be used.
    ConvergenceError
        An undamped structure is at resonance, or one that is not held has a mean load.

    Examples
    --------
    >>> linear = fc.solve_linear(structure, 2000.0)
    """
    check_omega(omega)
    least = least_harmonics(structure, 1)
    harmonics = max(Problem.harmonics, least) if harmonics is None else harmonics
    check_count("harmonics", harmonics, least)
    solution = _without_contact(structure, omega, harmonics)

    @cache
    def estimate() -> ErrorReport:
        reference = reference_of(solution)
        if reference is None:
            return ErrorReport()
        return beside(solution, _without_contact(reference, omega, harmonics))

    return replace(solution, estimate=estimate)


def _without_contact(structure: Structure, omega: float, harmonics: int) -> PeriodicSolution:
    load = to_complex(load_coefficients(structure, harmonics, 1))
    amplitude = np.zeros_like(load)
    for k in range(len(load)):
        if np.any(structure.sum_over_ranks(np.abs(load[k]).sum(keepdims=True))):
            amplitude[k] = _linear_amplitude(structure, k * omega, load[k])
    displacement = from_complex(amplitude)
    gap = structure.gap_of(displacement)
    return PeriodicSolution(structure, omega, None, displacement, gap, np.zeros_like(gap), 1)


def linear_response(
    structure: Structure, dof: int, omega: np.ndarray, *, lips: str = "open"
) -> np.ndarray:
    """Amplitudes of a dof at load frequencies with crack faces that stay open, or that stay bonded.

    Bonded faces have no relative normal motion and slide without friction, as those of
    :func:`fenics_crack.solve_modes`. Mean loads, preload and clearance play no part, nor do
    a load's harmonics above the first: :func:`fenics_crack.solve_linear` takes them all.

    Parameters
    ----------
    structure : Structure
        Small, or reduced.
    dof : int
        Whose displacement.
    omega : (n,) [rad/s]
        Load frequencies.
    lips : "open" or "tied"
        State of the faces of all cracks.

    Returns
    -------
    (n,) array [m]
        Amplitudes; inf at an undamped resonance.

    Raises
    ------
    InputError
        The structure is not small, lips is none of these, or omega cannot be used.

    Examples
    --------
    >>> amplitude = fc.linear_response(structure, tip, np.linspace(1e3, 3e3, 50), lips="tied")
    """
    check_choice("lips", lips, LIP_STATES)
    given = numbers(omega)
    if given.ndim != 1 or not np.all(np.isfinite(given) & (given >= 0.0)):
        raise InputError("omega", omega, "finite numbers >= 0, in an array (n,)")
    load = load_coefficients(structure, 1, 1)
    row = structure.values_at(np.eye(structure.n_dofs), [dof]).T
    found = np.full(len(given), np.inf)
    for place, one in enumerate(given):
        with contextlib.suppress(ConvergenceError):
            at = ModalCompliance(structure, float(one), load)
            force = np.zeros_like(at.linear_gap)
            if lips == "tied" and structure.n_pairs:
                gap = to_complex(at.linear_gap)
                gap[1] = np.linalg.lstsq(at.matrices[1], gap[1], rcond=None)[0]
                force[1:] = from_complex(gap)[1:]
            found[place] = np.hypot(*at.selected_displacement(row, force)[1:, 0])
    return found


def _linear_amplitude(structure: Structure, omega: float, load: np.ndarray) -> np.ndarray:
    """Complex displacement under a load (n_local,)."""
    if not structure.light_lips:
        with DynamicStiffness(structure, omega) as block:
            return block.solve(load[None] if omega > 0.0 else load.real[None])[0]
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
    form: str = "condensed",
    residual_tolerance: float = Solver.residual_tolerance,
    throw: bool = True,
) -> PeriodicSolution:
    """Steady periodic vibration with contact between the crack faces (collective).

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
        H; default: 5, or what ``tolerance`` requests.
    initial : PeriodicSolution, optional
        Where Newton starts; default: the linear solution. May have other harmonics,
        and a subharmonic that divides that of the response.
    tolerance : float, optional
        Choose H, 5 times ``subharmonic`` or more, and for a structure with many dofs the modes of a
        reduction, so that the error (:class:`ErrorReport`) is below this; the solution's status
        says what was chosen, or what limits the error of the best one. Where the exact flow is
        known the coefficients are those of an exact orbit. ``harmonics`` and ``samples`` are then
        left out.
    form : "condensed" or "block"
        Unknowns on the gaps; or all displacements, by PETSc's SNES on the sparse block system
        (``fenics_crack.balance.block_system``), with the same integrals of the contact force: the
        same solutions, and a check of them, in 20 times the time or more. Not with a tolerance,
        friction, or a rigid law of crack faces with mass.
    residual_tolerance : float
        ``|F(x)| / |x|`` of the algebraic equations; with very stiff contact (k R > 1e5) rounding
        alone leaves more, eps k R, which is then accepted and reported.
    throw : bool
        Raise if nothing converged (else ``converged`` is False), or the tolerance is missed.

    Returns
    -------
    PeriodicSolution
        With its estimated errors, ``report``.

    Raises
    ------
    InputError
        An argument cannot be used; or nothing converged with a law whose tangent is not the slope
        of its force.
    ConvergenceError
        No attempt converged, with the residual history; or ``tolerance`` is missed.

    Notes
    -----
    PETSc options with the prefix ``crack_hb_`` reach SNES, for example ``-crack_hb_snes_monitor``;
    of the block form its KSP and PC, too: ``-crack_hb_ksp_type gmres -crack_hb_pc_type bjacobi``.

    Source: the paper, eqs 2 to 15, with the corrections listed in ``docs/theory.md``.

    Examples
    --------
    >>> solution = fc.solve_harmonic_balance(structure, 2000.0, contact, harmonics=20)
    >>> error = solution.report.total
    """
    check_choice("form", form, FORMS)
    check_number("residual_tolerance", residual_tolerance, 0.0, above=True)
    if tolerance is not None:
        check_number("tolerance", tolerance, 0.0, above=True)
        if harmonics is not None:
            raise InputError("tolerance", tolerance, "left out where harmonics are given")
        if samples is not None:
            raise InputError("samples", samples, "left out where a tolerance is given")
        if form == "block":
            raise InputError("tolerance", tolerance, "left out with form = 'block'")
    if harmonics is None:
        check_count("subharmonic", subharmonic, 1)
        few = Problem.harmonics
        harmonics = few if tolerance is None else few * subharmonic
        harmonics = max(harmonics, least_harmonics(structure, subharmonic))
    problem = Problem(structure, omega, contact, harmonics, samples, subharmonic)
    if samples is not None:
        check_count("samples", samples, 4 * harmonics + 1)
    if initial is not None:
        check_initial(problem, initial)
    solver = FORMS[form](problem, residual_tolerance, throw)
    if tolerance is not None:
        return solve_to_tolerance(solver, tolerance, initial)
    check_memory(structure, harmonics)
    return solver.solve(initial)


def check_initial(problem: Problem, initial: PeriodicSolution) -> None:
    """Raise InputError unless a solution can be where a problem's solution is sought from."""
    structure, subharmonic = problem.structure, problem.subharmonic
    fitting_argument("initial", initial, "PeriodicSolution", {"PeriodicSolution"})
    has = initial.structure.n_dofs, initial.structure.n_pairs
    gaps_only = structure.light_lips and has[1] == structure.n_pairs
    if not gaps_only and has != (structure.n_dofs, structure.n_pairs):
        allowed = f"a solution with {structure.n_dofs} dofs and {structure.n_pairs} pairs"
        raise InputError("initial", f"{has[0]} dofs, {has[1]} pairs", allowed)
    if subharmonic % initial.subharmonic:
        allowed = f"of a subharmonic that divides {subharmonic}"
        raise InputError("initial", f"subharmonic {initial.subharmonic}", allowed)


FIRST_MODES = 10
"""Modes of the first attempt for a large structure; at most as many as exact orbits may have."""
MAX_HARMONICS = 500
"""Maximum harmonics solved for, or kept of an orbit, for each period of the load."""


def modes_tried(
    structure: Structure, first: int = FIRST_MODES, most: int = MAX_MODES_FOR_MONODROMY
) -> list[int]:
    """Numbers of modes of a large structure: few, and twice as many each time."""
    most = min(max(first, most), structure.n_dofs)
    doublings = max(0, math.ceil(math.log2(most / first)))
    return [min(first * 2**power, most) for power in range(doublings + 1)]


def solve_to_tolerance(
    solver: Solver,
    tolerance: float,
    initial: PeriodicSolution | None = None,
    *,
    structures: Iterable[Structure] | None = None,
    modes_key: str = "",
) -> PeriodicSolution:
    """The solution with few modes and harmonics that meet a tolerance, no fewer harmonics than the
    problem has; else the best one, or the error that says how far it is from what was
    requested.

    ``structures`` are those with more and more modes, each made when it is needed (collective); by
    itself only a structure of many dofs is reduced. ``modes_key`` is what a scene calls the number
    of modes.
    """
    whole = solver.problem.structure
    if structures is None and (is_small(whole) or isinstance(whole, ReducedStructure)):
        structures = [whole]
    elif structures is None:
        reduced_to = partial(reduce_structure, whole, method="massless")
        structures = (reduced_to(modes=modes) for modes in modes_tried(whole))
    best = None
    for structure in structures:
        solver = replace(solver, problem=replace(solver.problem, structure=structure))
        last = _solved(solver, tolerance, initial)
        last = last.reported(whole.comm.bcast(last.report))
        if best is None or last.report.total < best.report.total:
            best = last
        if not (last.converged and lacks_modes(last, tolerance)):
            break
        initial = last if structure.light_lips else None
    assert best is not None
    return _told(solver, best, tolerance, modes_key)


def lacks_modes(found: PeriodicSolution, tolerance: float) -> bool:
    """Return True if a solution misses a tolerance, and its modes leave more than half of that."""
    return found.report.total > tolerance and found.report.reduction > tolerance / 2.0


def solve_beside(
    problem: Problem,
    near: PeriodicSolution | None,
    tolerance: float | None = None,
    *,
    error: bool = True,
) -> PeriodicSolution:
    """The solution of a problem of a small structure, sought from that of another one, with its
    ``error`` or without.

    With a tolerance it is the orbit next to that, with no fewer harmonics than the problem has, and
    as many as bring what harmonics leave out below it.

    Raises
    ------
    InputError
        The contact is so stiff that rounding leaves nothing of its force.
    ConvergenceError
        There is no solution, or not to the tolerance.
    """
    if tolerance is None:
        found = Solver(problem).solve(near)
        return found if error else found.reported(NOT_ESTIMATED)
    solution = _solved(Solver(problem), tolerance, near)
    if not (left := solution.report.truncation) <= tolerance:
        size = f"the estimated truncation error, {left:.1e} with H = {solution.harmonics},"
        missed = f"{size} stays above {tolerance:g}; {solution.status}"
        raise ConvergenceError(f"harmonic balance at {problem.omega:g} rad/s: {missed}")
    return solution


def _goal(tolerance: float, reduction: float) -> float:
    """Return the error allowed for harmonics and samples: what modes leave, at most half of it."""
    left = tolerance - reduction
    return min(left, tolerance / 2.0) if left > 0.0 else tolerance / 2.0


def _told(
    solver: Solver, found: PeriodicSolution, tolerance: float, modes_key: str
) -> PeriodicSolution:
    """The solution with the word of what it took or what it lacks; or the error that says so."""
    report, structure = found.report, found.structure
    if not found.converged:
        return found
    lips, kept, more, each = massless(structure), "", modes_key or "modes", 1
    if isinstance(structure, ReducedStructure):
        size = f"{structure.n_dofs} coordinates"
        kept = f", {size}"
        if lips is not None:
            kept = f", {lips.n_modes} modes ({size})"
            if isinstance(lips.whole, Wheel):
                more, each = modes_key or "families", lips.whole.sector.count
            more += f" {2 * lips.n_modes // each}, in about twice the time"
    if report.total <= tolerance:
        chosen = f"chosen for an error of {tolerance:g}: H = {found.harmonics}{kept}"
        return replace(found, status=f"{found.status}; {chosen}")
    helps = {
        more: report.reduction,
        "more damping, which needs fewer harmonics": report.truncation + report.sampling,
        "a larger tolerance, as the error is rounding": report.residual,
    }
    size = "unknown" if report.unknown else percent(report.total)
    missed = f"solved; error {size}, {percent(tolerance)} was asked; what helps: "
    missed += f"{max(helps, key=helps.__getitem__)} (H = {found.harmonics}{kept})"
    if solver.throw:
        missed += f"; {found.status}; throw = False returns it"
        raise ConvergenceError(f"harmonic balance at {found.omega:g} rad/s: {missed}")
    return replace(found, status=f"{missed}; {found.status}")


def _solved(solver: Solver, tolerance: float, initial: PeriodicSolution | None) -> PeriodicSolution:
    """The solution of a structure as it is."""
    problem = solver.problem
    flow = flow_of(problem.structure, problem.contact)
    if flow is None or not is_affordable(flow, problem.omega, problem.subharmonic):
        return _by_harmonics(solver, tolerance, _begun(solver, problem).solve(initial))
    balanced, found = _sought(solver, flow, initial)
    if found.orbit is not None:
        kept = solution_of_orbit(problem, found.orbit, tolerance, initial)
        way = f"{found.reason}, from H = {balanced[-1].harmonics}" if balanced else found.reason
        return replace(kept, status=way + _told_of_others(found), others=found.other_orbits)
    if balanced:
        initial = balanced[-1]
        problem = problem.with_harmonics(initial.harmonics)
    near = _by_harmonics(solver, tolerance, _begun(solver, problem).solve(initial))
    tried = ", ".join(str(count * problem.subharmonic) for count in SearchOptions.harmonics)
    status = f"no exact orbit found from H = {tried}; {found.reason}; {near.status}"
    return replace(near, status=status)


# --- by an orbit ----------------------------------------------------------------------------------


def initial_orbit(problem: Problem, initial: PeriodicSolution | None = None) -> OrbitSearch:
    """Search for an exact orbit from harmonic-balance solutions with more and more harmonics, all
    sought from an initial one, whose orbit is the first then.

    Raises
    ------
    InputError
        There is no exact flow.
    """
    flow = exact_flow(problem.structure, problem.contact)
    return _sought(Solver(problem, throw=False), flow, initial)[1]


def _sought(
    solver: Solver, flow: ContactFlow, initial: PeriodicSolution | None
) -> tuple[list[PeriodicSolution], OrbitSearch]:
    """The same, and these solutions."""
    problem, balanced = solver.problem, list[PeriodicSolution]()

    def guesses() -> Iterator[np.ndarray]:
        if initial is not None and initial.orbit is not None:
            known = initial.orbit
            if initial.structure is problem.structure and known.subharmonic == problem.subharmonic:
                yield known.sampled.whole_states[:: INSTANTS_PER_PERIOD // SEGMENTS]
        for count in SearchOptions.harmonics:
            few = problem.with_harmonics(problem.response_harmonics(count))
            near = _begun(solver, few).attempt(initial, wholly=False)[1]
            if near.converged:
                balanced.append(near)
                yield near.assessment.states

    orbit = search_orbit(
        flow, problem.omega, guesses(), problem.subharmonic, prefer_stable=initial is None
    )
    return balanced, orbit


def _begun(solver: Solver, problem: Problem) -> Solver:
    begin(f"H = {problem.harmonics}, {problem.structure.n_dofs} coordinates")
    return replace(solver, problem=problem)


def _told_of_others(found: OrbitSearch) -> str:
    """Describe the other orbits that were found."""
    words = []
    for other in found.other_orbits:
        size = quantity(other.amplitude(), "m")
        words.append(f"{'stable' if other.is_stable else 'unstable'}, amplitude {size}")
    return f"; other orbits at this frequency: {'; '.join(words)}" if words else ""


def solution_of_orbit(
    problem: Problem,
    orbit: PeriodicOrbit,
    tolerance: float,
    initial: PeriodicSolution | None = None,
) -> PeriodicSolution:
    """The solution with the fewest harmonics of an orbit that meet a tolerance, no fewer than a
    problem has; its errors are those of the coefficients left out, and of the modes. One nearby
    makes it faster."""
    most = MAX_HARMONICS * problem.subharmonic
    known = orbit.coefficients(problem.response_harmonics(SearchOptions.harmonics[-1]))
    more: MoreModes | None = None

    def wave_with(harmonics: int) -> PeriodicSolution:
        nonlocal known
        if 2 * harmonics + 1 > len(known.gap):
            known = orbit.coefficients(harmonics)
        return wave_of(problem.with_harmonics(harmonics), orbit, known, more)

    more = wave_with(problem.response_harmonics(SearchOptions.harmonics[0])).assessment.more_modes
    if more and initial and initial.structure is problem.structure:
        other = initial.assessment.more_modes
        more = replace(more, inverse=other.hint if other else None)
    reduction, at_load = _lost(problem, wave_with, more)
    goal = _goal(tolerance, reduction)
    fewer, found = 0, wave_with(problem.harmonics)
    while not found.assessment.distance <= goal and found.harmonics < most:
        fewer, found = found.harmonics, wave_with(min(2 * found.harmonics, most))
    if fewer:
        counts, near = range(found.harmonics), lambda n: wave_with(n).assessment.distance <= goal
        found = wave_with(bisect_left(counts, True, fewer + 1, key=near))
    gap, known_errors = orbit.gap, found.assessment.errors()
    closing = gap + problem.structure.clearance
    report = ErrorReport(
        residual=orbit.residual,
        truncation=known_errors[0],
        reduction=reduction,
        penetration=relative_to_motion(np.maximum(gap, 0.0), closing),
        displacement=min(known_errors[1] + at_load, UNKNOWN),
    )
    return replace(found.reported(report), iterations=orbit.iterations)


def wave_of(
    problem: Problem, orbit: PeriodicOrbit, known: OrbitCoefficients, more: MoreModes | None = None
) -> PeriodicSolution:
    """An orbit's motion with the harmonics of a problem."""
    rows = slice(2 * problem.harmonics + 1)
    wave = problem.wave_of(known.displacement[rows], known.gap[rows], known.force[rows])
    return PeriodicSolution(**vars(wave), assessment=Assessment(wave, orbit, more=more))


def _lost(
    problem: Problem, wave_with: Callable[[int], PeriodicSolution], more: MoreModes | None
) -> tuple[float, float]:
    """Return the modal truncation error of the gap, and of the displacement at the load, of an
    orbit, known by its motion with more modes, or by its waves with some harmonics."""
    structure = problem.structure
    if not isinstance(structure, ReducedStructure) or structure.reference is None:
        return 0.0, 0.0
    if more is None or more.orbit is None:
        many = problem.response_harmonics(SearchOptions.harmonics[-1])
        balance = Solver(problem.with_harmonics(many))
        solution = balance.attempt(wave_with(many), wholly=False)[1]
        if solution.converged:
            return solution.report.reduction, solution.report.displacement
    return (more and more.errors) or (UNKNOWN, UNKNOWN)


# --- by harmonics ---------------------------------------------------------------------------------


def _by_harmonics(solver: Solver, tolerance: float, found: PeriodicSolution) -> PeriodicSolution:
    """The best solution, with as many harmonics as bring the estimated error of one down."""
    best = found
    while found.converged and not _enough(found, tolerance):
        harmonics = min(2 * found.harmonics, MAX_HARMONICS)
        finer = _begun(solver, solver.problem.with_harmonics(harmonics))
        found = finer.attempt(found, wholly=False)[1]
        if found.converged and found.report.total < best.report.total:
            best = found
    return best


def _enough(found: PeriodicSolution, tolerance: float) -> bool:
    """Return True if no more harmonics are needed, or allowed; samples go with them."""
    left = found.report.truncation + found.report.sampling
    unknown = left >= UNKNOWN and found.harmonics >= SearchOptions.harmonics[-1] * found.subharmonic
    enough = left <= _goal(tolerance, found.report.reduction)
    return enough or unknown or found.harmonics >= MAX_HARMONICS


# --- friction on solids ---------------------------------------------------------------------------


def slide_along_lines(structure: Structure, omega: float, contact: ContactLaw) -> ContactLaw:
    """Return a law with the lines along which a solid's pairs slide without friction (collective).

    Friction acts along one line for each pair, that along which it slides the most in the vibration
    without friction: with the sum over a period of

        A_i = sum lambda_n,i dg_i dg_i^T,      dg_i: change of its two tangential gaps,

    its first eigenvector. Where sliding turns, ``turning``, the root of the ratio of the sums of
    the pairs' second and first eigenvalues, is the share that friction across the lines would have.

    Parameters
    ----------
    structure : Structure
        Small, with two tangential gaps for each pair (:meth:`Structure.with_tangents`).
    omega : float [rad/s]
        Frequency of the load.
    contact : ContactLaw
        With friction; a law without, or with lines, or for a plate, is returned as it is.

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
    friction, tangents = friction_of(contact), structure.tangential
    if friction is None or friction.direction is not None or tangents is None:
        return contact
    if tangents.shape[1] == structure.n_pairs:
        return contact
    free = motion_without_friction(structure, omega, friction.law)
    direction, turning = sliding_of(free)
    return replace(friction, direction=direction, turning=turning)


def motion_without_friction(
    structure: Structure, omega: float, law: ContactLaw, subharmonic: int = 1
) -> PeriodicOrbit | PeriodicSolution:
    """The exact orbit without friction, or else the solution next to which none is found
    (collective)."""
    problem = Problem(structure, omega, law, subharmonic=subharmonic)
    few = problem.with_harmonics(problem.response_harmonics(problem.harmonics))
    found = Solver(few).solve()
    known = found.assessment
    return known.orbit if known.accepted and known.orbit is not None else found


def sliding_of(
    motion: ObservedMotion, direction: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Lines (n_pairs,) [rad] along which pairs slide in a motion of a structure with two tangential
    gaps a pair, or given ones, and the turning of sliding about them (collective)."""
    tangents = motion.structure.tangential
    assert tangents is not None
    [record] = motion.records(tangents.T.toarray())
    pairs = motion.structure.n_pairs
    slide, force = record.motion.reshape(len(record.motion), 2, pairs), record.force[:, :pairs]
    moved = np.roll(slide, -1, axis=0) - slide
    weight = np.maximum(0.5 * (np.roll(force, -1, axis=0) + force), 0.0)
    work = np.einsum("tip,tjp,tp->pij", moved, moved, weight)
    if direction is None:
        first = np.linalg.eigh(work)[1][:, :, 1]
        direction = np.arctan2(first[:, 1], first[:, 0])
    line = np.array([np.cos(direction), np.sin(direction)])
    along = float(np.einsum("ip,jp,pij->", line, line, work))
    across = max(float(np.trace(work, axis1=1, axis2=2).sum()) - along, 0.0)
    return direction, math.sqrt(across / along) if along > 0.0 else 0.0
