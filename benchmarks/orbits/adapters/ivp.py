"""Time integration by SciPy: solve_ivp with LSODA from rest until the motion repeats itself.

https://docs.scipy.org/doc/scipy/reference/generated/scipy.integrate.solve_ivp.html: LSODA, the
documented "good universal choice"; rtol 1e-8; atol per component below rtol times the motion
(so that "rtol dominates", as documented), its size taken from the motion with open contacts.
Integrated by stretches, each half as long as all before it (multiples of 6 periods); settled where
the last six periods repeat each other after 1, 2 or 3 periods and those at the end of the stretch
before, to 1e-5 of the motion; this difference is the stated error. Penalty and smoothed contact;
pairs without mass by Newton's method at each instant. Settled motions are stable.
"""

from __future__ import annotations

import numpy as np
from problem import Answer, Problem
from scipy.integrate import solve_ivp

PACKAGE = "scipy"
RTOL, SETTLED, LONGEST, INSTANTS = 1e-8, 1e-5, 5000, 256


def solve(problem: Problem) -> Answer:
    """Stretch by stretch from rest."""
    problem.only("penalty", "smoothed")
    n, inverse = len(problem.mass), np.linalg.inv(problem.mass)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        push = problem.contact(gaps(problem, np.array([t]), state[None, :n]))[0][0]
        pull = problem.damping @ state[n:] + problem.stiffness @ state[:n] + problem.pairs @ push
        return np.concatenate([state[n:], inverse @ (problem.force(t) - pull)])

    atol = 1e-2 * RTOL * np.abs(problem.linear(20)).max() * np.repeat([1.0, problem.omega], n)
    state, motion, n_done, change = np.zeros(2 * n), np.inf, 0, np.inf
    while n_done < LONGEST and change > SETTLED:
        start, n_done = n_done * problem.period, n_done + max(12, 6 * round(n_done / 12))
        times = problem.period * (n_done - 6 + np.arange(6 * INSTANTS + 1) / INSTANTS)
        run = solve_ivp(rates, (start, times[-1]), state, "LSODA", times, rtol=RTOL, atol=atol)
        state, previous, motion = run.y[:, -1], motion, run.y[:n, :-1].T
        for periods in (1, 2, 3):
            references = np.roll(motion, periods * INSTANTS, axis=0), previous, motion.mean(axis=0)
            closure, step, size = (np.linalg.norm(motion - reference) for reference in references)
            if (change := float(max(closure, step) / size)) < SETTLED:
                break
    gap = gaps(problem, times[:-1], motion)[-periods * INSTANTS :: periods]
    answer = Answer(gap=gap, converged=change < SETTLED, periods=periods)
    answer.message = f"{n_done} periods, change {change:.1e}; {run.message}"
    answer.error, answer.verdict = (change, "stable") if answer.converged else (None, None)
    return answer


def gaps(problem: Problem, times: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Gaps (times, p) at motions (times, n); of pairs without mass by Newton's method."""
    gap = base = q @ problem.pairs - problem.clearance
    if problem.flexibility is not None:
        angles = problem.omega * np.outer(times, 1 + np.arange(len(lift := problem.lift) // 2))
        gap = base = base + lift[0] + (np.exp(-1j * angles) @ (lift[1::2] + 1j * lift[2::2])).real
        for _ in range(50):
            push, slope = problem.contact(gap)
            tangent = np.eye(gap.shape[1]) + problem.flexibility * slope[:, None, :]
            residual = gap + push @ problem.flexibility.T - base
            if np.abs(residual).max() <= 1e-13 * np.abs(base).max():
                break
            gap = gap - np.linalg.solve(tangent, residual[..., None])[..., 0]
    return gap
