"""Steady vibration with contact: linear solution and harmonic balance.

The unknowns are the Fourier coefficients of the gaps (``form="condensed"``) or of all displacements
(``form="full"``, the reference); both have the same solutions. See :mod:`condensed`, :mod:`block`.

The equations are balanced by projection on the same functions (``balance="galerkin"``, the
classical form) or hold at 2H+1 instants of the period (``balance="collocation"``, the
high-dimensional form of Hall, Thomas and Clark, AIAA Journal 40, 2002, 879-886). With E the square
matrix of the functions' values at the instants theta_n = 2 pi n / (2H+1),

    w^2 M D^2 U + w C D U + K U + B lambda(B^T U - g0) = f,      D = E (d/dtheta) E^-1,   U = E u,

and E^-1 times that is A u + B b - c = 0 with b = E^-1 lambda(E g): harmonic balance whose contact
force is sampled 2H+1 times, no more. Harmonics of the force beyond H fold back onto those kept, and
can make spurious solutions (Liu, Thomas, Dowell, Attar, Hall, Journal of Computational Physics 215,
2006, 298-320). The incremental form takes the steps of the classical one: :mod:`incremental`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fenics_crack.balance.block import BlockSystem
from fenics_crack.balance.compliance import (
    Compliance,
    FactoredCompliance,
    dynamic_compliance,
    load_coefficients,
)
from fenics_crack.balance.condensed import CondensedSystem, ConstraintSystem, default_weight
from fenics_crack.balance.contact_integrals import contact_integrals, default_samples
from fenics_crack.balance.dynamic_stiffness import DynamicStiffness
from fenics_crack.balance.error_report import estimate_errors, mean_square
from fenics_crack.balance.family import FrequencyFamily
from fenics_crack.balance.fourier import from_complex, resized, stretched, to_complex
from fenics_crack.balance.search import Search
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import (
    MOST_SAMPLES,
    ConvergenceError,
    InputError,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.model.contact import ContactLaw, UnilateralConstraint, check_law
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import ReducedStructure, reduce_structure
from fenics_crack.model.structure import Structure

__all__ = ["check_memory", "solve_harmonic_balance", "solve_linear"]

MOST_HARMONICS = 300
"""Beyond these, or MOST_SAMPLES, the choice by a tolerance gives up."""
MATRICES = 4
"""Dense matrices of the size of the Jacobian that are held at a time."""


def solve_linear(structure: Structure, omega: float, *, harmonics: int = 5) -> PeriodicSolution:
    """Steady vibration with lips that pass through each other, A u = c (eq. 10) (collective).

    Parameters
    ----------
    structure : Structure
        What vibrates under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    harmonics : int
        H; all beyond the first are zero.

    Raises
    ------
    InputError
        omega or harmonics cannot be used.
    ConvergenceError
        The structure has no damping and is met in resonance, or is loose under a mean load.
    """
    check_omega(omega)
    check_count("harmonics", harmonics, 1)
    load = to_complex(load_coefficients(structure, harmonics, 1))
    amplitude = np.zeros_like(load)
    for k in (0, 1):
        if np.any(structure.sum_over_ranks(np.abs(load[k]).sum(keepdims=True))):
            with DynamicStiffness(structure, k * omega) as block:
                amplitude[k] = block.solve(load[k].real[None] if k == 0 else load[k][None])[0]
    displacement = from_complex(amplitude)
    gap = structure.closing(displacement)
    gap[0] -= structure.clearance
    return PeriodicSolution(structure, omega, None, displacement, gap, np.zeros_like(gap))


def solve_harmonic_balance(
    structure: Structure,
    omega: float,
    contact: ContactLaw | UnilateralConstraint,
    *,
    harmonics: int | None = None,
    samples: int | None = None,
    initial: PeriodicSolution | None = None,
    subharmonic: int = 1,
    tolerance: float | None = None,
    form: str = "condensed",
    balance: str = "galerkin",
    residual_tolerance: float = 1e-10,
    throw: bool = True,
) -> PeriodicSolution:
    """Steady periodic vibration with contact between the lips (collective).

    Parameters
    ----------
    structure : Structure
        What vibrates under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw or UnilateralConstraint
        Law of all pairs.
    harmonics : int, optional
        H; default: 5, or what ``tolerance`` asks for.
    samples : int, optional
        Instants per period of the response at which contact is evaluated. Default: exact integrals
        between the switching instants for the penalty law and the constraint; for other laws 1024
        for each period of the load, or 32 H where that is more.
    initial : PeriodicSolution, optional
        Where Newton starts; default: the linear solution. May have other harmonics, and a
        subharmonic that divides m.
    subharmonic : int
        m: look for a response of m times the load's period.
    tolerance : float, optional
        Choose H, the samples of a law that needs them, and for a structure with many dofs the modes
        of a reduction, so that the estimated error (:class:`ErrorReport`) is below this; the
        solution's status says what was chosen.
        ``harmonics`` and ``samples`` are then left out.
    form : "condensed" or "full"
        Unknowns on the gaps, or in all degrees of freedom.
    balance : "galerkin" or "collocation"
        How the equations are balanced: by integrals over the period, or at 2H+1 instants, for
        comparison: cheap for any law, but it aliases, and may have spurious solutions, which betray
        themselves by a large ``report.sampling``. ``samples`` and ``tolerance`` are then left out.
    residual_tolerance : float
        |F(x)| / |x| of the algebraic equations; with very stiff contact (k R > 1e5) rounding alone
        leaves more, eps k R, which is then accepted and reported.
    throw : bool
        Raise if nothing converged; else return the last iterate, ``converged`` being False.

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
    check_omega(omega)
    check_count("subharmonic", subharmonic, 1)
    _check_balance(contact, samples, tolerance, balance)
    if harmonics is None and tolerance is None:
        harmonics = max(5, subharmonic)
    if harmonics is not None:
        check_count("harmonics", harmonics, subharmonic)
        if tolerance is not None:
            raise InputError("tolerance", tolerance, "left out where harmonics are given")
        if samples is not None:
            check_count("samples", samples, 4 * harmonics + 1)
            if samples > MOST_SAMPLES:
                raise InputError("samples", samples, f"at most {MOST_SAMPLES}")
    if tolerance is not None:
        check_number("tolerance", tolerance, 0.0, above=True)
        if samples is not None:
            raise InputError("samples", samples, "left out where a tolerance is given")
    check_number("residual_tolerance", residual_tolerance, 0.0, above=True)
    if not isinstance(form, str) or form not in ("condensed", "full"):
        raise InputError("form", form, "'condensed' or 'full'")
    if balance == "collocation":
        assert harmonics is not None
        samples = 2 * harmonics + 1
    _check_contact(structure, contact, samples, form)
    if harmonics is not None:
        check_memory(structure, harmonics)
    if initial is not None:
        _check_initial(structure, initial, subharmonic)
    problem = _Problem(
        structure, omega, contact, samples, subharmonic, form, residual_tolerance, throw
    )
    if harmonics is not None:
        return problem.solve(harmonics, initial)
    assert tolerance is not None
    return _solve_to_tolerance(problem, tolerance, initial)


@dataclass(frozen=True)
class _Problem:
    """Everything about a solution but its harmonics and its start."""

    structure: Structure
    omega: float
    contact: ContactLaw | UnilateralConstraint
    samples: int | None
    subharmonic: int
    form: str
    residual_tolerance: float
    throw: bool

    def solve(self, harmonics: int, initial: PeriodicSolution | None) -> PeriodicSolution:
        """Solve with a number of harmonics; raise if nothing converged, if that is wanted."""
        search, solution = self.try_to_solve(harmonics, initial)
        if self.throw and not search.converged:
            raise ConvergenceError(
                f"harmonic balance at {self.omega:g} rad/s, H = {harmonics}: {search.status}; "
                "try other harmonics, a softer contact, or a solution nearby as initial",
                search.history,
            )
        return solution

    def try_to_solve(
        self, harmonics: int, initial: PeriodicSolution | None
    ) -> tuple[Search, PeriodicSolution]:
        """Solve with a number of harmonics; the search tells whether it converged."""
        search = Search(self.residual_tolerance)
        with self._compliance(harmonics) as compliance:
            return search, self._search(search, compliance, harmonics, initial)

    @contextmanager
    def _compliance(self, harmonics: int) -> Iterator[Compliance]:
        base = self.omega / self.subharmonic
        if self.form == "full":
            load = load_coefficients(self.structure, harmonics, self.subharmonic)
            compliance: Compliance = FactoredCompliance(self.structure, base, load)
        else:
            compliance = dynamic_compliance(self.structure, base, harmonics, self.subharmonic)
        try:
            yield compliance
        finally:
            compliance.destroy()

    def _family_from(self, harmonics: int, factor: float) -> FrequencyFamily:
        assert not isinstance(self.contact, UnilateralConstraint)
        return FrequencyFamily(
            self.structure,
            self.omega,
            self.contact,
            factor * self.omega,
            self.omega,
            harmonics,
            self.samples,
            self.subharmonic,
        )

    def _start(self, initial: PeriodicSolution, name: str, harmonics: int) -> np.ndarray:
        """Coefficients of a solution with this many harmonics of this response."""
        factor = self.subharmonic // initial.subharmonic
        return resized(stretched(getattr(initial, name), factor), harmonics)

    def _search(
        self,
        search: Search,
        compliance: Compliance,
        harmonics: int,
        initial: PeriodicSolution | None,
    ) -> PeriodicSolution:
        contact = self.contact
        condensed: CondensedSystem | ConstraintSystem
        unknown: np.ndarray
        if isinstance(contact, UnilateralConstraint):
            weight = contact.weight or default_weight(compliance)
            condensed = ConstraintSystem(compliance, harmonics, weight)
            start = None
            if initial is not None:
                force = self._start(initial, "force_coefficients", harmonics)
                start = condensed.from_force(force)
            unknown = search.constraint(condensed, start)
            contact = replace(contact, weight=weight)
        else:
            integrals = contact_integrals(contact, harmonics, self.samples, self.subharmonic)
            condensed = CondensedSystem(compliance, integrals)
            if isinstance(compliance, FactoredCompliance) and self.form == "full":
                block = BlockSystem(compliance, integrals)
                start = block.linear
                if initial is not None:
                    force = self._start(initial, "force_coefficients", harmonics)
                    start = compliance.displacement(force)
                amplitude = search.penalty(block, start)
                unknown = block.gap(amplitude)
            else:
                start = condensed.linear
                if initial is not None:
                    start = self._start(initial, "gap_coefficients", harmonics)
                paths = self._family_from if is_small(self.structure) else None
                unknown = search.penalty(condensed, start, paths and partial(paths, harmonics))
        gap, force = condensed.gap_and_force(unknown)
        displacement = compliance.displacement(force)
        return PeriodicSolution(
            self.structure,
            self.omega,
            contact,
            displacement,
            gap,
            force,
            subharmonic=self.subharmonic,
            converged=search.converged,
            status=search.status,
            iterations=search.iterations,
            report=estimate_errors(
                condensed,
                unknown,
                self.structure,
                displacement,
                self.omega / self.subharmonic,
                self.subharmonic,
            ),
        )


def _solve_to_tolerance(
    problem: _Problem, tolerance: float, initial: PeriodicSolution | None
) -> PeriodicSolution:
    """Raise H, the samples, and the modes of a reduction until the estimated error is small.

    The estimate of the truncation, a Newton step, is far too large where contact is stiff. The
    change of the solution from H to q H bounds it as well: where the error falls like 1/H or
    faster, the error of the latter is at most change / (q - 1). The smaller of the two counts.
    """
    whole, harmonics, modes = problem.structure, max(3, 2 * problem.subharmonic), 10
    reducible = not is_small(whole) and not isinstance(whole, ReducedStructure)
    if reducible:
        problem = replace(problem, structure=reduce_structure(whole, modes=modes))
    last: PeriodicSolution | None = None
    while True:
        if last is None:
            solution = problem.solve(harmonics, initial)
        else:
            solution = problem.try_to_solve(harmonics, initial)[1]
        if not solution.converged:
            if last is None:
                return solution
            return _give_up(problem, tolerance, last, f"truncation; H = {harmonics} failed")
        report = solution.report
        if last is not None and harmonics > last.harmonics:
            change = solution.gap_coefficients - resized(last.gap_coefficients, harmonics)
            closing = solution.gap_coefficients.copy()
            closing[0] += whole.clearance
            size = np.sqrt(mean_square(closing))
            bound = np.sqrt(mean_square(change)) / (size * (harmonics / last.harmonics - 1.0))
            report = replace(report, truncation=min(report.truncation, float(bound)))
        report = whole.comm.bcast(report)
        solution = replace(solution, report=report)
        if report.total <= tolerance:
            chosen = f"chosen for an error of {tolerance:g}: H = {harmonics}"
            if problem.samples is not None:
                chosen += f", {problem.samples} samples"
            if reducible:
                chosen += f", {modes} modes ({problem.structure.n_dofs} coordinates)"
            return replace(solution, status=f"{solution.status}; {chosen}")
        initial = last = solution
        obstacle = ""
        if report.reduction > 0.3 * tolerance and reducible and modes < whole.n_dofs:
            modes = min(2 * modes, whole.n_dofs)
            problem = replace(problem, structure=reduce_structure(whole, modes=modes))
            last = None
        elif report.reduction > tolerance:
            obstacle = "that of the reduced structure given"
        elif report.sampling > 0.3 * tolerance:
            used = problem.samples or problem.subharmonic * default_samples(harmonics)
            problem = replace(problem, samples=4 * used)
            obstacle = "sampling" if used > MOST_SAMPLES else ""
        elif harmonics < MOST_HARMONICS:
            # The error falls like H^-3 or slower: aim a little past the goal, but not too far.
            wanted = harmonics * min(2.5, 1.1 * (report.truncation / tolerance) ** (1.0 / 3.0))
            harmonics = min(MOST_HARMONICS, max(harmonics + 2, int(np.ceil(wanted))))
            if problem.samples is not None:
                problem = replace(problem, samples=max(problem.samples, 8 * harmonics))
        else:
            obstacle = f"truncation at H = {harmonics}"
        if obstacle:
            return _give_up(problem, tolerance, solution, obstacle)


def _give_up(
    problem: _Problem, tolerance: float, best: PeriodicSolution, obstacle: str
) -> PeriodicSolution:
    """The best solution found, or the error that says how far it is from what was asked for."""
    error = f"{best.report.total:.1e} with H = {best.harmonics}"
    if problem.throw:
        raise ConvergenceError(
            f"harmonic balance at {problem.omega:g} rad/s: the estimated error, {error}, stays "
            f"above {tolerance:g}; what is left is {obstacle}"
        )
    status = f"{best.status}; error {error} above the tolerance: {obstacle}"
    return replace(best, converged=False, status=status)


# --- input ----------------------------------------------------------------------------------------


def _check_contact(
    structure: Structure,
    contact: ContactLaw | UnilateralConstraint,
    samples: int | None,
    form: str,
) -> None:
    if structure.n_pairs == 0:
        raise InputError("structure", "0 pairs", "one with contact pairs; else use solve_linear")
    if isinstance(contact, UnilateralConstraint):
        if samples is not None:
            raise InputError("samples", samples, "left out with UnilateralConstraint")
        if form == "full":
            raise InputError("form", form, "'condensed' with UnilateralConstraint")
        return
    check_law(structure, contact)


def check_memory(structure: Structure, harmonics: int) -> None:
    """Raise InputError where the dense Jacobian of the condensed equations would not fit."""
    pairs = structure.n_pairs
    unknowns = (2 * harmonics + 1) * pairs
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if MATRICES * 8 * unknowns**2 > 0.8 * memory:
        fits = int(np.sqrt(0.8 * memory / (8 * MATRICES)) / (2 * pairs) - 0.5)
        raise InputError(
            "harmonics",
            harmonics,
            f"at most {fits} with {pairs} pairs: {unknowns} unknowns need "
            f"{MATRICES * 8 * unknowns**2 / 2**30:.0f} GiB of this machine's {memory / 2**30:.0f}",
        )


def _check_balance(
    contact: ContactLaw | UnilateralConstraint,
    samples: int | None,
    tolerance: float | None,
    balance: str,
) -> None:
    if not isinstance(balance, str) or balance not in ("galerkin", "collocation"):
        raise InputError("balance", balance, "'galerkin' or 'collocation'")
    if balance == "galerkin":
        return
    if isinstance(contact, UnilateralConstraint):
        raise InputError("balance", balance, "'galerkin' with UnilateralConstraint")
    for key, value in (("samples", samples), ("tolerance", tolerance)):
        if value is not None:
            allowed = "left out with balance='collocation', whose 2H+1 instants follow from H"
            raise InputError(key, value, allowed)


def _check_initial(structure: Structure, initial: PeriodicSolution, subharmonic: int) -> None:
    if not isinstance(initial, PeriodicSolution):
        raise InputError("initial", type(initial).__name__, "a PeriodicSolution")
    has = initial.structure.n_dofs, initial.structure.n_pairs
    if has != (structure.n_dofs, structure.n_pairs):
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
