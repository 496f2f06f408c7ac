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


def answered(problem: Problem, **how: Any) -> Answer:
    """Solution, its stated error, the verdict."""
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
    found = fc.solve_harmonic_balance(structure, problem.omega, law, throw=False, **how)
    times = problem.period * np.arange(INSTANTS) / INSTANTS
    parts, orbit = (found.gap_coefficients, found.tangential_gap_coefficients), found.orbit
    gap, slide = (None if part is None else at_instants(part) for part in parts)
    if orbit is not None:
        gap, slide = orbit.gap_at(times), orbit.tangential_gap_at(times) if friction else None
    error = found.report.total
    return Answer(
        gap=gap, tangential=slide, converged=found.converged, message=found.status,
        error=error if np.isfinite(error) else None, verdict=fc.floquet(structure, found).verdict,
    )  # fmt: skip
