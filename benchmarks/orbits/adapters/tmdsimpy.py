"""tmdsimpy: its continuation over the frequency, then its Newton's method, as in its examples.

https://github.com/tmd-lab/tmdsimpy
"""

from __future__ import annotations

from typing import Any

import numpy as np
from problem import Answer, Problem
from tmdsimpy.continuation import Continuation
from tmdsimpy.nlforces.unilateral_spring import UnilateralSpring
from tmdsimpy.solvers import NonlinearSolver
from tmdsimpy.utils import harmonic
from tmdsimpy.vibration_system import VibrationSystem

REQUIREMENTS = ("numpy<2", "scipy<1.14", "matplotlib")
SOURCE = "https://github.com/tmd-lab/tmdsimpy", "17d5fc3"
HARMONICS, SAMPLES, FROM = 10, 256, 0.9


def solve(problem: Problem) -> Answer:
    """From 0.9 of the frequency."""
    problem.only("penalty")
    face_problem, h = problem.with_faces(), np.arange(HARMONICS + 1)
    system = VibrationSystem(face_problem.mass, face_problem.stiffness, C=face_problem.damping)
    for column, k, gap in zip(
        face_problem.pairs.T, face_problem.normal, face_problem.clearance, strict=True
    ):
        system.add_nl_force(UnilateralSpring(column[None], column[:, None], k, 0.0, gap))
    load, solver = face_problem.load(HARMONICS).ravel(), NonlinearSolver({"verbose": False})
    begin, end, n = FROM * face_problem.omega, face_problem.omega, len(face_problem.mass)

    def residual(unknowns: np.ndarray) -> Any:
        return system.hbm_res(unknowns, load, h, Nt=SAMPLES)

    def at(omega: float, start: np.ndarray) -> Any:
        def only(u: np.ndarray) -> Any:
            return residual(np.append(u, omega))[:2]

        u, _, tangent, state = solver.nsolve(only, start, verbose=False)
        return u, np.linalg.norm(only(u)[0]) / np.linalg.norm(load), tangent, state

    u, _, tangent, _ = at(begin, face_problem.linear(HARMONICS).ravel())
    start = np.append(u, begin)
    sizes = harmonic.harmonic_wise_conditioning(start, n, h, delta=1e-3 * np.abs(u).max())
    sizes[-1] = end
    inverse = 1.0 / np.abs(np.diag(tangent * sizes[:-1])).max()
    config = {
        "DynamicCtoP": True, "TargetNfev": 200, "MaxSteps": 2000, "dsmin": 1e-3, "dsmax": 0.015,
        "verbose": 0, "xtol": 1e-9 * len(start), "corrector": "Ortho",
    }  # fmt: skip
    follow = Continuation(solver, ds0=0.01, CtoP=sizes, RPtoC=inverse, config=config)
    path = follow.continuation(residual, start, begin, end)
    u, left, _, state = at(end, path[-1, :-1])
    rows = u.reshape(2 * HARMONICS + 1, n)
    words = f"sweep to {path[-1, -1] / end:.3f} w, residual {left:.1e} of the load"
    return Answer(gap=face_problem.gap(rows), converged=bool(state["success"]), message=words)
