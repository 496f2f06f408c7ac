"""mousai: harmonic balance at 2H+1 instants by SciPy's Newton-Krylov method, as in its tutorial.

https://github.com/josephcslater/mousai
"""

from __future__ import annotations

from typing import Any

import numpy as np
from mousai import hb_time
from problem import Answer, Problem, Unsupported, at_instants

PACKAGE, REQUIREMENTS = "mousai", ("mousai==0.3.1", "scipy<1.14")
HARMONICS = 7


def solve(problem: Problem) -> Answer:
    """From the motion with open contacts."""
    problem.only("penalty", "smoothed")
    if problem.flexibility is not None:
        raise Unsupported("no pairs without mass")
    count, inverse = 2 * HARMONICS + 1, np.linalg.inv(problem.mass)

    def acceleration(x: np.ndarray, v: np.ndarray, params: dict[str, Any]) -> np.ndarray:
        push = problem.contact(x @ problem.pairs - problem.clearance)[0]
        force = problem.force(params["cur_time"]) - problem.pairs @ push
        free_acceleration = inverse @ (force - problem.stiffness @ x - problem.damping @ v)
        return np.asarray(free_acceleration)[:, None]

    rows = problem.linear(HARMONICS)
    angles = np.outer(2.0 * np.pi * np.arange(count) / count, np.arange(1, HARMONICS + 1))
    start = rows[0] + np.cos(angles) @ rows[1::2] + np.sin(angles) @ rows[2::2]
    _, x, error, *_ = hb_time(acceleration, start.T, problem.omega, num_harmonics=HARMONICS)
    waves = np.fft.rfft(x, axis=1).T / count
    rows[0] = waves[0].real
    rows[1::2], rows[2::2] = 2.0 * waves[1:].real, -2.0 * waves[1:].imag
    gap = at_instants(rows) @ problem.pairs - problem.clearance
    size = float(np.abs(np.asarray(error)).max())
    return Answer(gap=gap, converged=bool(np.isfinite(size)), message=f"its error {size:.1e}")
