"""SKHiPPR: the structure as a system of first order, its continuation, its verdict.

https://github.com/inm-unistuttgart/SKHiPPR
"""

from __future__ import annotations

import typing
from typing import Any

import numpy as np
import typing_extensions
from problem import Answer, Problem

if not hasattr(typing, "override"):  # before Python 3.12
    typing.override = typing_extensions.override  # type: ignore[attr-defined]
from skhippr.cycles.hbm import HBMEquation
from skhippr.equations.EquationSystem import EquationSystem
from skhippr.Fourier import Fourier
from skhippr.odes.AbstractODE import AbstractODE
from skhippr.solvers.continuation import pseudo_arclength_continuator as follow
from skhippr.solvers.newton import NewtonSolver
from skhippr.stability.KoopmanHillProjection import KoopmanHillSubharmonic

REQUIREMENTS = ("numpy<2", "scipy<1.14", "matplotlib", "typing_extensions")
SOURCE = "https://github.com/inm-unistuttgart/SKHiPPR", "0742a3f"
HARMONICS, SAMPLES, FROM, POINTS = 25, 300, 0.9, 200


class Masses(AbstractODE):  # type: ignore[misc]
    """Displacements and velocities."""

    def __init__(self, problem: Problem, omega: float) -> None:
        super().__init__(autonomous=False, n_dof=2 * len(problem.mass))
        self.t, self.x, self.omega, self.problem = 0.0, np.zeros(self.n_dof), omega, problem

    def dynamics(self, t: Any = None, x: Any = None) -> np.ndarray:
        return self.problem.rate(self.omega / self.problem.omega * t, x)

    def closed_form_derivative(self, variable: str, t: Any = None, x: Any = None) -> np.ndarray:
        return {"x": self.problem.rate_slope(x)}[variable]


class Subharmonic(KoopmanHillSubharmonic):  # type: ignore[misc]
    """With whole numbers as floats: those of Python before 3.12 have no ``is_integer``."""

    def fundamental_matrix(self, t_over_period: float, hbm: Any) -> Any:
        return super().fundamental_matrix(float(t_over_period), hbm)


def solve(problem: Problem) -> Answer:
    """From 0.9 of the frequency."""
    problem.only("penalty", "smoothed")
    n, end = len(problem.mass), problem.omega
    fourier = Fourier(N_HBM=HARMONICS, L_DFT=SAMPLES, n_dof=2 * n, real_formulation=True)
    stability = Subharmonic(fourier, tol=1e-4, autonomous=False)

    def system(omega: float, guess: np.ndarray) -> EquationSystem:
        balance = HBMEquation(Masses(problem, omega), omega, fourier, guess, 1, stability)
        return EquationSystem([balance], ["X"], equation_determining_stability=balance)

    rows, rates = problem.linear(HARMONICS), np.arange(1, HARMONICS + 1)[:, None] * FROM * end
    order = np.r_[0, 1 : len(rows) : 2, 2 : len(rows) : 2]  # all cosines, then all sines
    states = np.hstack([rows, 0.0 * rows])
    states[1::2, n:], states[2::2, n:] = rates * rows[2::2], -rates * rows[1::2]
    solver, start = NewtonSolver(max_iterations=200), system(FROM * end, states[order].ravel())
    solver.solve(start)
    for point in follow(start, solver, 0.1, (0.001, 0.1), 1, "omega", False, POINTS):
        unknowns, frequency = point.X, float(np.squeeze(point.omega))
        if frequency > end:
            break
    orbit = system(end, unknowns)
    solver.solve(orbit)
    rows[order] = orbit.X.reshape(len(rows), 2 * n)[:, :n]
    text = f"swept to {frequency / end:.3f} w, {solver.num_iter} iterations"
    word = {True: "stable", False: "unstable"}.get(orbit.stable)
    return Answer(gap=problem.gap(rows), converged=bool(orbit.solved), verdict=word, message=text)
