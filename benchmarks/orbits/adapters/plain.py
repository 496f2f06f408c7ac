"""A plain harmonic balance in SciPy: the worked example of an adapter.

H = 20 harmonics, the contact force at 12 H instants of the period (alternating between time and
frequency), Newton's method with the exact tangent from the motion with open contacts; where that
fails from softer contacts. Penalty and smoothed contact, one or many pairs, mass at the pairs or
none. It states how far twice the harmonics move the answer, and no verdict.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
from problem import Answer, Problem

PACKAGE = "scipy"
HARMONICS, INSTANTS, STEPS, TOLERANCE = 20, 12, 50, 1e-9
SOFTER = np.geomspace(1e-3, 1.0, 20)


def solve(problem: Problem) -> Answer:
    """By H harmonics, and by twice as many for the error."""
    problem.only("penalty", "smoothed")
    problem = problem.with_faces()
    rows, is_converged, residual_norm = balanced(problem, HARMONICS, problem.linear(HARMONICS))
    if not is_converged:
        rows = problem.linear(HARMONICS)
        for share in SOFTER:
            softer = replace(problem, normal=share * problem.normal)
            rows, is_converged, residual_norm = balanced(softer, HARMONICS, rows)
    answer = Answer(
        gap=problem.gap(rows),
        converged=is_converged,
        message=f"residual {residual_norm:.1e} of the load",
    )
    if is_converged:
        start = np.vstack([rows, np.zeros((2 * HARMONICS, rows.shape[1]))])
        finer_rows, has_converged_finer, _ = balanced(problem, 2 * HARMONICS, start)
        if has_converged_finer:
            gap_change = np.linalg.norm(problem.gap(finer_rows) - answer.gap)
            answer.error = float(gap_change / np.linalg.norm(answer.gap - answer.gap.mean(axis=0)))
    return answer


def balanced(problem: Problem, harmonics: int, start: np.ndarray) -> tuple[np.ndarray, bool, float]:
    """Rows of the motion (2H+1, n), whether they converged, and the residual over the load."""
    count, n, n_instants = 2 * harmonics + 1, len(problem.mass), INSTANTS * harmonics
    angles = np.outer(2.0 * np.pi * np.arange(n_instants) / n_instants, np.arange(1, harmonics + 1))
    waves = np.ones((n_instants, count))  # values at the instants of the rows
    waves[:, 1::2], waves[:, 2::2] = np.cos(angles), np.sin(angles)
    project = 2.0 / n_instants * waves.T
    project[0] *= 0.5
    dynamic = np.zeros((count * n, count * n))
    dynamic[:n, :n] = problem.stiffness
    for order in range(1, harmonics + 1):
        w = order * problem.omega
        row_slice = slice((2 * order - 1) * n, (2 * order + 1) * n)
        stiffness_block, damping_block = (
            problem.stiffness - w**2 * problem.mass,
            w * problem.damping,
        )
        dynamic[row_slice, row_slice] = np.block(
            [[stiffness_block, damping_block], [-damping_block, stiffness_block]]
        )
    load, pairs = problem.load(harmonics), problem.pairs

    def residual(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        push, slope = problem.contact(waves @ rows @ pairs - problem.clearance)
        balance_error = dynamic @ rows.ravel() + (project @ push @ pairs.T).ravel() - load.ravel()
        return balance_error, slope

    rows, size = start.copy(), float(np.linalg.norm(load))
    residual_rows, slope = residual(rows)
    for _ in range(STEPS):
        if np.linalg.norm(residual_rows) < TOLERANCE * size:
            break
        tangent = dynamic.copy().reshape(count, n, count, n)
        for pair, column in enumerate(pairs.T):
            slope_block = project @ (slope[:, pair, None] * waves)
            tangent += np.einsum("hk,i,j->hikj", slope_block, column, column)
        step = scipy.linalg.solve(tangent.reshape(count * n, count * n), residual_rows).reshape(
            rows.shape
        )
        share = 1.0
        while share > 1e-3:  # shorter steps where the residual grows
            trial, trial_slope = residual(rows - share * step)
            if np.linalg.norm(trial) < np.linalg.norm(residual_rows):
                break
            share *= 0.5
        rows = rows - share * step
        residual_rows, slope = trial, trial_slope
    return (
        rows,
        bool(np.linalg.norm(residual_rows) < TOLERANCE * size),
        float(np.linalg.norm(residual_rows) / size),
    )
