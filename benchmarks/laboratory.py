"""Another form of harmonic balance, for comparison with those of the package.

*Collocation* (``balance="collocation"``): the equations hold at 2H+1 instants of the period, the
high-dimensional form (Hall, Thomas, Clark, AIAA Journal 40, 2002, 879-886). With E the square
matrix of the functions' values at the instants theta_n = 2 pi n / (2H+1),

    w^2 M D^2 U + w C D U + K U + B lambda(B^T U - g0) = f,      D = E (d/dtheta) E^-1,   U = E u,

and E^-1 times that is A u + B b - c = 0 with b = E^-1 lambda(E g): harmonic balance whose contact
force is sampled only 2H+1 times. It is cheap for any law, but harmonics of the force beyond H are
folded back onto those kept and can create spurious solutions, which a large ``report.sampling``
reveals (Liu, Thomas, Dowell, Attar, Hall, Journal of Computational Physics 215, 2006,
298-320).
"""

from __future__ import annotations

from dataclasses import replace

import fenics_crack as fc
from fenics_crack.balance.block_system import BALANCE_SOLVER_CLASS_BY_FORM
from fenics_crack.balance.harmonic_balance import check_initial
from fenics_crack.basics.errors import check_choice, check_number
from fenics_crack.model.contact import is_rigid

__all__ = ["solve_form"]


def solve_form(
    problem: fc.Problem,
    *,
    form: str = "condensed",
    balance: str = "galerkin",
    initial: fc.PeriodicSolution | None = None,
    residual_tolerance: float = 1e-10,
    throw: bool = True,
) -> fc.PeriodicSolution:
    """Solve a problem by another form of harmonic balance, on one rank.

    Parameters
    ----------
    problem : Problem
        What is solved; without samples for collocation, whose 2H+1 instants follow from H.
    form : "condensed" or "block"
        As in :func:`solve_harmonic_balance`.
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
    check_choice("form", form, BALANCE_SOLVER_CLASS_BY_FORM)
    check_choice("balance", balance, ("galerkin", "collocation"))
    check_number("residual_tolerance", residual_tolerance, 0.0, excludes_bound=True)
    if balance == "collocation":
        if is_rigid(problem.contact):
            raise fc.InputError("balance", balance, "'galerkin' with UnilateralConstraint")
        if problem.samples is not None:
            allowed_text = "left out with balance='collocation', whose 2H+1 instants follow from H"
            raise fc.InputError("samples", problem.samples, allowed_text)
        problem = replace(problem, samples=2 * problem.harmonics + 1)
    if initial is not None:
        check_initial(problem, initial)
    return BALANCE_SOLVER_CLASS_BY_FORM[form](problem, residual_tolerance, throw).solve(initial)
