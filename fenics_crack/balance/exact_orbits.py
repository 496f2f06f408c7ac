"""Which problems the judged curves and their doubled branches go by exact orbits for."""

from __future__ import annotations

from fenics_crack.balance.problem import Problem
from fenics_crack.model.contact import is_piecewise_linear
from fenics_crack.model.modal import is_small

__all__ = ["FEW_PAIRS", "judged_by_orbits"]

FEW_PAIRS = 4
"""Up to so many with mass at their lips are judged by exact orbits: many switch too often."""
QUICK = 100
"""Unknowns of a structure up to which a solution is sought among its orbits."""


def judged_by_orbits(problem: Problem) -> bool:
    """Whether the flow of a problem is known in closed form, from event to event, and its pairs and
    its unknowns are few."""
    structure = problem.structure
    closed_form = is_small(structure) and is_piecewise_linear(problem.contact)
    few = structure.n_pairs <= FEW_PAIRS and structure.n_dofs <= QUICK
    return closed_form and few and not structure.light_lips
