"""SKHiPPR: the structure as a system of first order, its continuation, its verdict.

https://github.com/inm-unistuttgart/SKHiPPR
"""

from __future__ import annotations

import typing
from typing import Any

import numpy as np
import typing_extensions
from problem import Answer, Problem, Unsupported

typing.override = typing_extensions.override  # type: ignore[attr-defined]  # before Python 3.12
from skhippr.cycles.hbm import HBMEquation
from skhippr.equations.EquationSystem import EquationSystem
from skhippr.Fourier import Fourier
from skhippr.odes.AbstractODE import AbstractODE
from skhippr.solvers.continuation import pseudo_arclength_continuator
from skhippr.solvers.newton import NewtonSolver
from skhippr.stability.KoopmanHillProjection import KoopmanHillSubharmonic

REQUIREMENTS = ("numpy<2", "scipy<1.14", "matplotlib", "typing_extensions")
SOURCE = "https://github.com/inm-unistuttgart/SKHiPPR", "0742a3f"
HARMONICS, SAMPLES, FROM, POINTS = 25, 300, 0.9, 200


class Masses(AbstractODE):  # type: ignore[misc]
    """Displacements and velocities."""

    def __init__(self, problem: Problem, omega: float) -> None:
        super().__init__(autonomous=False, n_dof=2 * len(problem.mass))
        self.t, self.x, self.omega = 0.0, np.zeros(self.n_dof), omega
        self.problem, inverse = problem, np.linalg.inv(problem.mass)
        self.inverse, none = inverse, 0.0 * inverse
        self.still = np.block(
            [[none, none + np.eye(len(none))],
             [-inverse @ problem.stiffness, -inverse @ problem.damping]]
        )  # fmt: skip

    def dynamics(self, t: Any = None, x: Any = None) -> np.ndarray:
        """z' for all samples (2n, L) at once."""
        one, n = self.problem, len(self.problem.mass)
        push = one.contact((one.pairs.T @ x[:n]).T - one.clearance)[0].T
        rate = self.still @ x
        rate[n:] += self.inverse @ (one.force(self.omega / one.omega * t) - one.pairs @ push)
        return np.asarray(rate)

    def closed_form_derivative(self, variable: str, t: Any = None, x: Any = None) -> np.ndarray:
        """With respect to x: (2n, 2n, L)."""
        if variable != "x":
            raise NotImplementedError
        one, n = self.problem, len(self.problem.mass)
        slope = one.contact((one.pairs.T @ x[:n]).T - one.clearance)[1].T
        tangent = np.repeat(self.still[:, :, None], x.shape[-1], axis=2)
        tangent[n:, :n] -= np.einsum("ip,pl,jp->ijl", self.inverse @ one.pairs, slope, one.pairs)
        return tangent


class Subharmonic(KoopmanHillSubharmonic):  # type: ignore[misc]
    """With whole numbers as floats: those of Python before 3.12 have no ``is_integer``."""

    def C_time(self, t_over_period: float) -> Any:
        return super().C_time(float(t_over_period))

    def C_subh_time(self, t_over_period: float) -> Any:
        return super().C_subh_time(float(t_over_period))


def solve(problem: Problem) -> Answer:
    """From 0.9 of the frequency."""
    problem.only("penalty", "smoothed")
    if problem.flexibility is not None:
        raise Unsupported("no pairs without mass")
    n, end = len(problem.mass), problem.omega
    fourier = Fourier(N_HBM=HARMONICS, L_DFT=SAMPLES, n_dof=2 * n, real_formulation=True)
    stability = Subharmonic(fourier, tol=1e-4, autonomous=False)

    def system(omega: float, guess: np.ndarray) -> EquationSystem:
        given = Masses(problem, omega), omega, fourier, guess
        balance = HBMEquation(*given, period_k=1, stability_method=stability)
        return EquationSystem([balance], ["X"], equation_determining_stability=balance)

    rows, rates = problem.linear(HARMONICS), np.arange(1, HARMONICS + 1)[:, None] * FROM * end
    order = np.r_[0, 1 : len(rows) : 2, 2 : len(rows) : 2]  # all cosines, then all sines
    moved = np.hstack([rows, 0.0 * rows])
    moved[1::2, n:], moved[2::2, n:] = rates * rows[2::2], -rates * rows[1::2]
    solver, first = NewtonSolver(max_iterations=200), system(FROM * end, moved[order].ravel())
    solver.solve(first)
    last = first.X
    for point in pseudo_arclength_continuator(
        initial_system=first, solver=solver, stepsize=0.1, stepsize_range=(0.001, 0.1),
        continuation_parameter="omega", initial_direction=1, num_steps=POINTS,
    ):  # fmt: skip
        last, reached = point.X, float(np.squeeze(point.omega))
        if reached > end:
            break
    found = system(end, last)
    solver.solve(found)
    rows[order] = found.X.reshape(len(rows), 2 * n)[:, :n]
    verdict = {True: "stable", False: "unstable"}.get(found.stable)
    words = f"swept to {reached / end:.3f} w, {solver.num_iter} iterations"
    return Answer(
        gap=problem.gap(rows), converged=bool(found.solved), verdict=verdict, message=words
    )
