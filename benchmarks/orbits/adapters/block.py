"""This package: harmonic balance with H = 20 on all displacements, by PETSc's SNES."""

from orbit import PACKAGE, answered
from problem import Answer, Problem, Unsupported

__all__ = ["PACKAGE", "solve"]


def solve(problem: Problem) -> Answer:
    """From the motion with open contacts."""
    problem.only("penalty", "smoothed", "rigid")
    if problem.kind == "rigid" and problem.flexibility is None:
        raise Unsupported("no rigid contact of pairs with mass")
    return answered(problem, harmonics=20, form="block")
