"""Other forms of harmonic balance, to be compared with the one that is used.

*Full* (``form="full"``): the unknowns are all displacements, see :mod:`block`; the same solutions
as the condensed form, at a far higher cost.

*Collocation* (``balance="collocation"``): the equations hold at 2H+1 instants of the period, the
high-dimensional form (Hall, Thomas, Clark, AIAA Journal 40, 2002, 879-886). With E the square
matrix of the functions' values at the instants theta_n = 2 pi n / (2H+1),

    w^2 M D^2 U + w C D U + K U + B lambda(B^T U - g0) = f,      D = E (d/dtheta) E^-1,   U = E u,

and E^-1 times that is A u + B b - c = 0 with b = E^-1 lambda(E g): harmonic balance whose contact
force is sampled 2H+1 times, no more. It is cheap for any law, but harmonics of the force beyond H
fold back onto those kept and can make spurious solutions, which betray themselves by a large
``report.sampling`` (Liu, Thomas, Dowell, Attar, Hall, Journal of Computational Physics 215, 2006,
298-320).
"""

from __future__ import annotations

from dataclasses import replace

from fenics_crack.balance.harmonic_balance import check_initial
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.balance.solver import Solver
from fenics_crack.errors import InputError, check_number
from fenics_crack.model.contact import is_rigid

__all__ = ["solve_form"]


def solve_form(
    problem: Problem,
    *,
    form: str = "condensed",
    balance: str = "galerkin",
    initial: PeriodicSolution | None = None,
    residual_tolerance: float = 1e-10,
    throw: bool = True,
) -> PeriodicSolution:
    """Solve a problem by another form of harmonic balance (collective).

    Parameters
    ----------
    problem : Problem
        What is solved; without samples for collocation, whose 2H+1 instants follow from H.
    form : "condensed" or "full"
        Unknowns on the gaps, or in all degrees of freedom.
    balance : "galerkin" or "collocation"
        By integrals over the period, or at 2H+1 instants.
    initial, residual_tolerance, throw
        As in :func:`solve_harmonic_balance`.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        Nothing converged.
    """
    if not isinstance(form, str) or form not in ("condensed", "full"):
        raise InputError("form", form, "'condensed' or 'full'")
    if not isinstance(balance, str) or balance not in ("galerkin", "collocation"):
        raise InputError("balance", balance, "'galerkin' or 'collocation'")
    check_number("residual_tolerance", residual_tolerance, 0.0, above=True)
    if form == "full" and is_rigid(problem.contact):
        raise InputError("form", form, "'condensed' with UnilateralConstraint")
    if balance == "collocation":
        if is_rigid(problem.contact):
            raise InputError("balance", balance, "'galerkin' with UnilateralConstraint")
        if problem.samples is not None:
            allowed = "left out with balance='collocation', whose 2H+1 instants follow from H"
            raise InputError("samples", problem.samples, allowed)
        problem = replace(problem, samples=2 * problem.harmonics + 1)
    if initial is not None:
        check_initial(problem, initial)
    return Solver(problem, residual_tolerance, throw, full=form == "full").solve(initial)
