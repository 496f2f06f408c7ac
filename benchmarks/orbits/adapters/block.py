"""This package: harmonic balance with H = 20 on all displacements, by PETSc's SNES."""

from orbit import PACKAGE, answered
from problem import Answer, Problem, Unsupported

__all__ = ["PACKAGE", "solve"]


def solve(problem: Problem) -> Answer:
    """From the motion with open contacts."""
    problem.only("penalty", "smoothed")
    if problem.flexibility is not None:
        raise Unsupported("no pairs without mass")
    return answered(problem, harmonics=20, form="block")
