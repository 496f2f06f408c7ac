"""Time integration of contact with Coulomb's cone: an independent reference for friction along a
line. Exponential steps of the modes, projected Gauss-Seidel for the forces within a step."""

from __future__ import annotations

import numpy as np
import scipy.linalg

import fenics_crack as fc


def march_cone(
    structure: fc.MasslessStructure,
    omega: float,
    mu: float,
    start: np.ndarray,
    steps: int,
    periods: int,
) -> np.ndarray:
    """Coordinates over the last period, (steps, n_dofs), from modal ones and rates (2, n_modes).

    The gaps s - D lambda of a quasi-static compliance D, three rows a pair, close by their normal
    forces; slips are taken from step to step.
    """
    count, pairs = structure.n_modes, structure.n_pairs
    rows = np.vstack([structure.gap.toarray().T, structure.tangential.toarray().T])
    modal, static = rows[:, :count], rows[:, count:]
    give = static @ structure.flexibility @ static.T
    load = structure.force[:, :count]
    held = structure.force[:, count:] @ structure.flexibility @ static.T
    squares, rate, dt = structure.omega**2, structure.rate, 2.0 * np.pi / omega / steps
    system = np.zeros((count, 4, 4))  # q, q', force at the start, its slope
    system[:, 0, 1] = system[:, 1, 2] = system[:, 2, 3] = 1.0
    system[:, 1, 0], system[:, 1, 1] = -squares, -rate
    moves = np.array([scipy.linalg.expm(one * dt) for one in system])
    at, slope = moves[:, :2, 2], moves[:, :2, 3] / dt
    q, force = start, np.zeros(3 * pairs)
    compliance = (modal * slope[:, 0]) @ modal.T + give
    blocks = compliance.reshape(3, pairs, 3, pairs)
    own = [blocks[:, i, :, i] for i in range(pairs)]
    place, kept = np.zeros((2, pairs)), []

    def wave(time: float, parts: np.ndarray) -> np.ndarray:
        phase = omega * time * np.arange(1, len(parts) // 2 + 1)
        return parts[0] + np.cos(phase) @ parts[1::2] + np.sin(phase) @ parts[2::2]

    before = wave(0.0, load) - force @ modal
    for step in range(1, steps * periods + 1):
        outer = wave(step * dt, load)
        free = np.einsum("kij,jk->ik", moves[:, :2, :2], q)
        free += at.T * before + slope.T * (outer - before)
        gap = modal @ free[0] + wave(step * dt, held)
        gap[:pairs] -= structure.clearance
        for _ in range(60):
            change = 0.0
            for i in range(pairs):
                mine = [i, pairs + i, 2 * pairs + i]
                old, drag = force[mine], compliance[mine] @ force
                left = gap[mine] - drag + own[i] @ old
                # Stick, else slip: a fixed point of the cone with the largest diagonal.
                goal = left - np.array([0.0, *place[:, i]])
                new = np.linalg.solve(own[i], goal)
                if new[0] <= 0.0:
                    new = np.zeros(3)
                elif np.hypot(*new[1:]) > mu * new[0]:
                    new = old.copy()
                    size = np.linalg.norm(own[i][1:, 1:], 2)
                    for _ in range(4):
                        new[0] = max((left[0] - own[i][0, 1:] @ new[1:]) / own[i][0, 0], 0.0)
                        push = new[1:] + (goal[1:] - own[i][1:] @ new) / size
                        long = np.hypot(*push)
                        new[1:] = push * min(1.0, mu * new[0] / long if long > 0.0 else 1.0)
                force[mine] = new
                change = max(change, float(np.abs(new - old).max()))
            if change <= 1e-8 * max(np.abs(force).max(), 1e-12):
                break
        now = gap - compliance @ force
        place = now[pairs:].reshape(2, pairs)
        q = free - slope.T * (force @ modal)
        before = outer - force @ modal
        if step > steps * (periods - 1):
            pushed = structure.force[:, count:]
            static_force = wave(step * dt, pushed) - force @ static
            kept.append(np.concatenate([q[0], structure.flexibility @ static_force]))
    return np.array(kept)
