"""Response curves: solutions followed over a parameter, through resonances, folds and branches.

Pseudo-arc-length continuation (:mod:`growing`) of the condensed equations (:mod:`family`). Only
the small or reduced structure is touched at a point, in closed form: a curve costs the same on any
mesh. Along it folds are located by root finding, branch points by steps that shrink towards them,
by the sign of det J, so only where J is formed
(:data:`fenics_crack.balance.contact_system.MATRIX_FREE`). Verdicts come after it (:mod:`exact`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Unpack

from fenics_crack.balance.harmonic_balance import check_initial, solve_beside
from fenics_crack.balance.problem import ON_PATH, Problem, check_memory
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.curves.family import FAMILIES, Family
from fenics_crack.curves.growing import Growing, Steps
from fenics_crack.curves.harmonic_curve import HarmonicCurve
from fenics_crack.curves.verdicts import judge_curve
from fenics_crack.model.contact import is_rigid
from fenics_crack.motion.flow import exact_flow
from fenics_crack.numerics.fourier import stretched
from fenics_crack.numerics.path import BranchPoint, Fold


class Continuation(Growing):
    """A curve that grows point by point: iterate over it, and take its ``curve`` at any time.

        for point in Continuation(Problem(plate, 1000.0, law), "omega", 1000.0, 3000.0):
            ...

    Parameters
    ----------
    problem : Problem
        Problem solved at the first point. A structure with many dofs is reduced first, to crack
        faces without mass (``reduce_structure(structure, method="massless")``); ``omega`` counts
        where it is not the parameter. Modes that are quasi-static are so for all of the curve:
        those above ``static_above``, by default 2 H times the highest base frequency, with the
        first point's H.
    parameter : str
        "omega": load frequency [rad/s]; "load", "stiffness", "damping": factor of the structure's
        load, of the contact stiffness, of the structure's damping, 1 being as given, and so
        "friction": of its coefficient; "clearance": added to that of every pair [m]; "speed": of
        the rotor [rad/s], which ``omega`` follows.
    start, end : float
        Its values; the end may be below the start.
    initial : PeriodicSolution or Bifurcation, optional
        Where to start. A solution: near the first point. A bifurcation: on the branch that begins
        there; ``start`` and ``end`` bound the parameter on either side (:func:`follow_branch`).
    tolerance : float, optional
        Without ``samples``. Choose H, between the problem's ``harmonics`` and 100, so that the
        estimated truncation error of the first point is below this.
    stability : bool
        Assess ``curve`` each time that it is taken (:func:`judge_curve`).
    longest_step : float
        Longest step, relative to the range of the parameter and to the size of the solution; at
        most 1; default: 0.05.
    most_points : int
        Give up after so many; default: 50,000.
    turning_back : float
        Maximum return of the curve past its start, relative to the range of the parameter, but
        not to a frequency or a damping of zero; a closed curve can only be recognised where it may.
        Default: 0.1.

    Attributes
    ----------
    complete : bool
        True if the end was reached, or the curve closed.
    returned : bool
        True if the curve came back to its start, or went past it, instead of reaching the end.
    status : str
        Reason for the end.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point.
    """

    def __init__(
        self,
        problem: Problem,
        parameter: str,
        start: float,
        end: float,
        *,
        initial: PeriodicSolution | Bifurcation | None = None,
        tolerance: float | None = None,
        stability: bool = False,
        **steps: Unpack[Steps],
    ) -> None:
        if problem.samples is not None:
            check_count("samples", problem.samples, 4 * problem.harmonics + 1)
        if tolerance is not None:
            check_number("tolerance", tolerance, 0.0, above=True)
            if problem.samples is not None:
                raise InputError("samples", problem.samples, "left out where a tolerance is given")
        super().__init__(problem, parameter, start, end, **steps)
        reduced = self._problem.structure is not problem.structure
        problem, self._judged = self._problem, stability
        if stability and is_rigid(problem.contact):
            exact_flow(problem.structure, problem.contact)

        if isinstance(initial, Bifurcation):
            self._family = FAMILIES[parameter](problem, start, end)
            factor = problem.harmonics // initial.problem.harmonics
            unknown = stretched(getattr(initial.point, initial.point.FOUND)[0], factor)
            self._begin_on_branch(initial.kind, initial.value, unknown)
            return
        if initial is not None:
            if reduced:  # its gaps are all that is used
                initial = replace(initial, structure=problem.structure)
            check_initial(problem, initial)
        if tolerance is not None:
            at_start = FAMILIES[parameter].vary(problem, start)
            initial = solve_beside(at_start, initial, tolerance)
            problem = problem.with_harmonics(initial.harmonics)
        check_memory(problem.structure, problem.harmonics)
        self._family = FAMILIES[parameter](problem, start, end)
        found = Solver(self._family.at(start)).solve(initial)
        self._begin(start, found.slow_gap_coefficients, found.iterations)

    _family: Family
    _kind, _events = HarmonicCurve, (Fold, BranchPoint)

    @property
    def curve(self) -> ResponseCurve:
        """All points so far; assessed with ``stability=True``."""
        found = self.followed
        return judge_curve(found) if self._judged else found  # type: ignore[arg-type]

    @property
    def _own(self) -> dict[str, Any]:
        problem = self._family.problem
        return {"samples": problem.samples, "static_above": problem.static_cutoff}

    @property
    def _at_once(self) -> int:
        return ON_PATH // self.size
