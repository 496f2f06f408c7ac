"""This package: harmonic balance to a tolerance of 1 %, whose answer is the exact orbit behind."""

from __future__ import annotations

from typing import Any

import numpy as np
from problem import INSTANTS, Answer, Problem, at_instants

import fenics_crack as fc

PACKAGE = "fenics_crack"


def solve(problem: Problem) -> Answer:
    """By default settings."""
    return answered(problem, tolerance=0.01)


def modelled(problem: Problem) -> tuple[fc.Structure, Any]:
    """The package's structure and law."""
    rigid, friction = problem.kind == "rigid", problem.kind == "friction"
    structure = fc.Structure.from_matrices(
        problem.mass, problem.stiffness, gap=problem.pairs, clearance=problem.clearance,
        tangential=problem.tangents if friction else None, damping=problem.damping,
        force_mean=problem.mean, force_cos=problem.cos.T, force_sin=problem.sin.T,
    )  # fmt: skip
    if problem.flexibility is not None:
        load = np.hstack([structure.force, problem.lift])
        structure = fc.MasslessStructure(
            structure, np.diag(problem.stiffness), problem.damping, problem.pairs, load,
            problem.flexibility, reference=None,
        )  # fmt: skip
    law: Any = fc.UnilateralConstraint() if rigid else fc.UnilateralPenalty(problem.normal)
    if problem.kind == "smoothed":
        law = fc.SmoothedPenalty(problem.normal, problem.sharpness)
    if friction:
        law = fc.CoulombFriction(law, problem.coefficient, problem.tangential)
    return structure, law


def answered(problem: Problem, **how: Any) -> Answer:
    """Solution, its stated error, the verdict."""
    structure, law = modelled(problem)
    solution = fc.solve_harmonic_balance(structure, problem.omega, law, throw=False, **how)
    gap, slide = motions(problem, solution)
    error = solution.report.total
    return Answer(
        gap=gap, tangential=slide, converged=solution.converged, message=solution.status,
        error=error if np.isfinite(error) else None,
        verdict=fc.floquet(structure, solution).verdict,
    )  # fmt: skip


def motions(problem: Problem, found: fc.PeriodicSolution) -> tuple[Any, Any]:
    """Gaps and tangential gaps at the instants: of the exact orbit, where there is one."""
    if found.orbit is None:
        parts = found.gap_coefficients, found.tangential_gap_coefficients
        return at_instants(parts[0]), None if parts[1] is None else at_instants(parts[1])
    times, rubs = problem.period * np.arange(INSTANTS) / INSTANTS, problem.kind == "friction"
    return found.orbit.gap_at(times), found.orbit.tangential_gap_at(times) if rubs else None
