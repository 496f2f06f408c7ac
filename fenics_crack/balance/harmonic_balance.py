"""Steady vibration with contact: linear solution and harmonic balance.

The unknowns are the Fourier coefficients of the gaps (:mod:`contact_system`); the equations are
balanced by projection on the same functions, with the contact force integrated exactly or from
samples.
Other forms of the method are kept for comparison in ``benchmarks/laboratory.py``.
"""

from __future__ import annotations

import contextlib

import numpy as np

from fenics_crack.balance.compliance import DynamicStiffness, ModalCompliance, load_coefficients
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.balance.to_tolerance import solve_to_tolerance
from fenics_crack.errors import ConvergenceError, InputError, check_count, check_number, check_omega
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.memory import check_memory
from fenics_crack.model.modal import all_modes
from fenics_crack.model.modes import LIPS
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import from_complex, to_complex

__all__ = ["check_initial", "linear_response", "solve_harmonic_balance", "solve_linear"]


def solve_linear(structure: Structure, omega: float, *, harmonics: int = 5) -> PeriodicSolution:
    """Steady vibration with lips that pass through each other, A u = c (collective).

    Parameters
    ----------
    structure, omega
        As in :class:`fenics_crack.Problem`.
    harmonics : int
        H; all beyond the first are zero.

    Returns
    -------
    PeriodicSolution
        Without contact force.

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


def linear_response(
    structure: Structure, dof: int, omega: np.ndarray, *, lips: str = "open"
) -> np.ndarray:
    """Amplitudes of a dof at load frequencies with lips that stay open, or that stay tied.

    Tied lips have no relative normal motion and slide without friction, as those of
    :func:`fenics_crack.solve_modes`. Mean loads, preload and clearance play no part.

    Parameters
    ----------
    structure : Structure
        Small, or reduced.
    dof : int
        Whose displacement.
    omega : (n,) [rad/s]
        Load frequencies.
    lips : "open" or "tied"
        What the lips of all cracks do.

    Returns
    -------
    (n,) array [m]
        Amplitudes; inf at an undamped resonance.

    Raises
    ------
    InputError
        The structure is not small, or lips is none of these.

    Examples
    --------
    >>> amplitude = fc.linear_response(structure, tip, np.linspace(1e3, 3e3, 50), lips="tied")
    """
    if lips not in LIPS:
        raise InputError("lips", lips, "one of " + ", ".join(map(repr, LIPS)))
    load = load_coefficients(structure, 1, 1)
    row = structure.values_at(np.eye(structure.n_dofs), [dof]).T
    found = np.full(len(omega), np.inf)
    for place, one in enumerate(omega):
        with contextlib.suppress(ConvergenceError):
            at = ModalCompliance(structure, float(one), load)
            force = np.zeros_like(at.linear_gap)
            if lips == "tied" and structure.n_pairs:
                gap = to_complex(at.linear_gap)
                gap[1] = np.linalg.lstsq(at.matrices[1], gap[1], rcond=None)[0]
                force[1:] = from_complex(gap)[1:]
            found[place] = np.hypot(*at.seen_through(row, force)[1:, 0])
    return found


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
    residual_tolerance: float = Solver.residual_tolerance,
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
        Where Newton starts; default: the linear solution, or a marched motion where pairs are seen
        through a static compliance. May have other harmonics, and a subharmonic that divides that
        of the response.
    tolerance : float, optional
        Choose H, and for a structure with many dofs the modes of a reduction, so that the error
        (:class:`ErrorReport`) is below this; the solution's status says what was chosen, or what
        limits the error of the best one. Where the exact flow is known the coefficients are those
        of an exact orbit. ``harmonics`` and ``samples`` are then left out.
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
        An argument cannot be used.
    ConvergenceError
        No attempt converged, with the residual history; or ``tolerance`` is missed.

    Notes
    -----
    PETSc options with the prefix ``crack_hb_`` reach SNES, for example ``-crack_hb_snes_monitor``.

    Source: the paper, eqs 2 to 15, with the corrections listed in ``docs/theory.md``.

    Examples
    --------
    >>> solution = fc.solve_harmonic_balance(structure, 2000.0, contact, harmonics=20)
    >>> error = solution.report.total
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
        harmonics = max(5, subharmonic)
    problem = Problem(structure, omega, contact, harmonics, samples, subharmonic)
    if samples is not None:
        check_count("samples", samples, 4 * harmonics + 1)
    if initial is not None:
        check_initial(problem, initial)
    solver = Solver(problem, residual_tolerance, throw)
    if tolerance is not None:
        return solve_to_tolerance(solver, tolerance, initial)
    check_memory(structure, harmonics)
    return solver.solve(initial)


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
