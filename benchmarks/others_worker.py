"""Run by the Python of SKHiPPR and tmdsimpy, or of mousai, for ``condensed_speed.py`` and
``work_precision.py``: JSON in, JSON out.

One cold solution of M u'' + C u' + K u + k max(u, 0) = f cos(w t), the contact on some dofs, from
the linear solution with open contacts; the solution itself, from one near it; then points of its
curve by arc length from a solution that is given. What is built before is not timed, nor is the
curve's first point; JAX compiles before.
"""

from __future__ import annotations

import contextlib
import json
import resource
import sys
import time
import typing
from collections.abc import Callable
from typing import Any

import numpy as np

Job = dict[str, Any]
Found = dict[str, Any]


def linear(job: Job, omega: float) -> np.ndarray:
    """Coefficients of the linear solution: (2H+1, n), rows a0, a1, b1, ..."""
    M, K, C, load = (job[name] for name in ("mass", "stiffness", "damping", "load"))
    amplitude = np.linalg.solve(K - omega**2 * M + 1j * omega * C, load)
    coefficients = np.zeros((2 * job["harmonics"] + 1, len(M)))
    coefficients[1], coefficients[2] = amplitude.real, -amplitude.imag
    return coefficients


# --- tmdsimpy -------------------------------------------------------------------------------------


def tmdsimpy(job: Job) -> Found:
    """Its own unilateral spring, Newton's method with JAX's factorisation, its continuation."""
    from tmdsimpy import Continuation, VibrationSystem  # type: ignore[import-not-found]
    from tmdsimpy.jax import NonlinearSolverOMP  # type: ignore[import-not-found]
    from tmdsimpy.nlforces.unilateral_spring import UnilateralSpring  # type: ignore[import-not-found]

    H, n, samples = job["harmonics"], len(job["mass"]), job["samples"]
    system = VibrationSystem(job["mass"], job["stiffness"], job["damping"])
    Q = np.eye(n)[job["stopped"]]
    system.add_nl_force(UnilateralSpring(Q, Q.T, np.full(len(Q), job["stop"])))
    h = np.arange(H + 1)
    load = np.zeros((2 * H + 1, n))
    load[1] = job["load"]
    load = load.ravel()
    settings = {"verbose": False, "max_steps": 20}
    solver = NonlinearSolverOMP(settings)
    patient = NonlinearSolverOMP(settings | {"max_steps": job["iterations"]})

    def residual(Uw: np.ndarray) -> Any:
        return system.hbm_res(Uw, load, h, Nt=samples)

    def solve(with_solver: Any, start: np.ndarray) -> Any:
        def at_omega(U: np.ndarray) -> Any:
            return residual(np.append(U, job["at"]))[:2]

        return with_solver.nsolve(at_omega, start.ravel(), xtol=job["xtol"])

    U = solve(solver, job["near"])[0]  # compiles
    seconds, (_, _, _, status) = timed(lambda: solve(patient, linear(job, job["at"])))
    first = np.append(job["initial"].ravel(), job["start"])
    marks: list[float] = []
    follow = Continuation(
        solver,
        ds0=job["step"],
        CtoP=np.append(np.ones(len(U)), job["start"]),
        config={
            "dsmax": job["step"],
            "MaxSteps": job["points"] + 1,
            "verbose": -1,
            "xtol": job["xtol"],
            "callback": lambda *_: marks.append(time.process_time()),
        },
    )
    curve = follow.continuation(residual, first, job["start"], job["end"])
    coefficients = np.asarray(U).reshape(2 * H + 1, n)
    return found(
        coefficients, seconds, status["nfev"], status["success"], marks[: len(curve)], curve[:, -1]
    )


# --- SKHiPPR --------------------------------------------------------------------------------------


def skhippr(job: Job) -> Found:
    """The structure as a system of first order, its Newton's method and continuation."""
    if not hasattr(typing, "override"):  # before Python 3.12
        from typing_extensions import override

        typing.override = override  # type: ignore[attr-defined]
    from skhippr.cycles.hbm import HBMEquation  # type: ignore[import-not-found]
    from skhippr.equations.EquationSystem import EquationSystem  # type: ignore[import-not-found]
    from skhippr.Fourier import Fourier  # type: ignore[import-not-found]
    from skhippr.odes.AbstractODE import AbstractODE  # type: ignore[import-not-found]
    from skhippr.solvers.continuation import pseudo_arclength_continuator  # type: ignore[import-not-found]
    from skhippr.solvers.newton import NewtonSolver  # type: ignore[import-not-found]

    H, n, stopped, k = job["harmonics"], len(job["mass"]), job["stopped"], job["stop"]
    inverse = np.linalg.inv(job["mass"])
    A = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-inverse @ job["stiffness"], -inverse @ job["damping"]]]
    )
    load = inverse @ job["load"]
    push = k * inverse[:, stopped]

    class Masses(AbstractODE):  # type: ignore[misc]
        """Displacements and velocities."""

        def __init__(self, omega: float) -> None:
            super().__init__(autonomous=False, n_dof=2 * n)
            self.t, self.x, self.omega = 0.0, np.zeros(2 * n), omega

        def dynamics(self, t: Any = None, x: Any = None) -> np.ndarray:
            """A x, less the contact forces, plus the load; for all samples (2n, L) at once."""
            rate = A @ x
            rate[n:] += np.multiply.outer(load, np.cos(self.omega * t))
            rate[n:] -= push @ np.maximum(x[stopped], 0.0)
            return np.asarray(rate)

        def closed_form_derivative(self, variable: str, t: Any = None, x: Any = None) -> np.ndarray:
            """With respect to x: (2n, 2n, L)."""
            if variable != "x":
                raise NotImplementedError
            tangent = np.repeat(A[:, :, None], x.shape[-1], axis=2)
            tangent[n:, stopped] -= push[:, :, None] * (x[stopped] > 0.0)
            return tangent

    order = np.r_[0, 1 : 2 * H : 2, 2 : 2 * H + 1 : 2]  # all cosines, then all sines
    fourier = Fourier(N_HBM=H, L_DFT=job["samples"], n_dof=2 * n, real_formulation=True)

    def equations(omega: float, guess: np.ndarray) -> EquationSystem:
        states = np.zeros((2 * H + 1, 2 * n))
        states[:, :n] = guess
        rates = omega * np.arange(1, H + 1)[:, None]
        states[1::2, n:], states[2::2, n:] = rates * guess[2::2], -rates * guess[1::2]
        equation = HBMEquation(Masses(omega), omega, fourier, states[order].ravel())
        return EquationSystem([equation], ["X"])

    patient = NewtonSolver(max_iterations=job["iterations"])
    cold = equations(job["at"], linear(job, job["at"]))
    seconds, _ = timed(lambda: patient.solve(cold))
    solver = NewtonSolver()
    system = equations(job["at"], job["near"])
    solver.solve(system)
    coefficients = np.empty((2 * H + 1, n))
    coefficients[order] = system.X.reshape(2 * H + 1, 2 * n)[:, :n]
    marks, omegas = [], []
    for point in pseudo_arclength_continuator(
        equations(job["start"], job["initial"]),
        solver,
        stepsize=job["step"],
        stepsize_range=(1e-4, job["step"]),
        initial_direction=1 if job["end"] > job["start"] else -1,
        continuation_parameter="omega",
        num_steps=job["points"],
    ):
        marks.append(time.process_time())
        omegas.append(point.omega)
    return found(coefficients, seconds, patient.num_iter, cold.solved, marks, np.array(omegas))


# --- mousai ---------------------------------------------------------------------------------------


def mousai(job: Job) -> Found:
    """Its harmonic balance at 2H+1 instants, by SciPy's Newton-Krylov method."""
    from mousai import hb_time  # type: ignore[import-not-found]

    H, stopped = job["harmonics"], job["stopped"]
    inverse = np.linalg.inv(job["mass"])
    K, C, load, k = (job[name] for name in ("stiffness", "damping", "load", "stop"))

    def acceleration(x: np.ndarray, v: np.ndarray, params: dict[str, Any]) -> np.ndarray:
        force = load * np.cos(params["omega"] * params["cur_time"]) - K @ x - C @ v
        force[stopped] -= k * np.maximum(x[stopped], 0.0)
        return np.asarray(inverse @ force)[:, None]

    rows = linear(job, job["at"])
    angles = np.outer(np.arange(1, H + 1), 2.0 * np.pi * np.arange(2 * H + 1) / (2 * H + 1))
    start = rows[0][:, None] + rows[1::2].T @ np.cos(angles) + rows[2::2].T @ np.sin(angles)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    seconds, (_, x, error, *_) = timed(
        lambda: hb_time(
            acceleration,
            start,
            job["at"],
            num_harmonics=H,
            f_tol=1e-8 * float(np.abs(inverse @ load).max()),
        )
    )
    waves = np.fft.rfft(x, axis=1).T / x.shape[1]
    coefficients = np.empty((2 * H + 1, len(x)))
    coefficients[0] = waves[0].real
    coefficients[1::2], coefficients[2::2] = 2.0 * waves[1 : H + 1].real, -2.0 * waves[1:].imag
    return {
        "coefficients": coefficients.tolist(),
        "cold": seconds,
        "converged": bool(np.all(np.isfinite(error))),
        "mib": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak) / 1024.0,
    }


# --- shared ---------------------------------------------------------------------------------------


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time [s] and result."""
    started = time.process_time()
    result = function()
    return time.process_time() - started, result


def found(
    coefficients: np.ndarray,
    cold: float,
    iterations: int,
    converged: bool,
    marks: list[float],
    omegas: np.ndarray,
) -> Found:
    """The answer; of the curve the times [s] between its points."""
    return {
        "coefficients": coefficients.tolist(),
        "cold": cold,
        "iterations": iterations,
        "converged": bool(converged),
        "points": np.diff(marks).tolist(),
        "omega": np.ravel(omegas).astype(float).tolist(),
    }


def main() -> None:
    """Do the job on standard input."""
    job = json.load(sys.stdin)
    for name in {"mass", "stiffness", "damping", "load", "near", "initial"} & set(job):
        job[name] = np.array(job[name])
    programs = {"tmdsimpy": tmdsimpy, "SKHiPPR": skhippr, "mousai": mousai}
    with contextlib.redirect_stdout(sys.stderr):
        answer = programs[job["program"]](job)
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
