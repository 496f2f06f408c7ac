"""This package: harmonic balance with H = 20 by itself, condensed to the gaps."""

from orbit import PACKAGE, answered
from problem import Answer, Problem

__all__ = ["PACKAGE", "solve"]


def solve(problem: Problem) -> Answer:
    """From the motion with open contacts."""
    return answered(problem, harmonics=20)
