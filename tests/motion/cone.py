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
    modal_rows, static_rows = rows[:, :count], rows[:, count:]
    give = static_rows @ structure.flexibility @ static_rows.T
    load = structure.force[:, :count]
    residual_load = structure.force[:, count:] @ structure.flexibility @ static_rows.T
    squares, rate, dt = structure.omega**2, structure.modal_damping, 2.0 * np.pi / omega / steps
    system = np.zeros((count, 4, 4))  # q, q', force at the start, its slope
    system[:, 0, 1] = system[:, 1, 2] = system[:, 2, 3] = 1.0
    system[:, 1, 0], system[:, 1, 1] = -squares, -rate
    moves = np.array([scipy.linalg.expm(state_matrix * dt) for state_matrix in system])
    end_response, slope = moves[:, :2, 2], moves[:, :2, 3] / dt
    q, force = start, np.zeros(3 * pairs)
    compliance = (modal_rows * slope[:, 0]) @ modal_rows.T + give
    blocks = compliance.reshape(3, pairs, 3, pairs)
    blocks_of_pairs = [blocks[:, i, :, i] for i in range(pairs)]
    place, motions = np.zeros((2, pairs)), []

    def wave(time: float, parts: np.ndarray) -> np.ndarray:
        phase = omega * time * np.arange(1, len(parts) // 2 + 1)
        return parts[0] + np.cos(phase) @ parts[1::2] + np.sin(phase) @ parts[2::2]

    previous_load = wave(0.0, load) - force @ modal_rows
    for step in range(1, steps * periods + 1):
        next_load = wave(step * dt, load)
        free_state = np.einsum("kij,jk->ik", moves[:, :2, :2], q)
        free_state += end_response.T * previous_load + slope.T * (next_load - previous_load)
        gap = modal_rows @ free_state[0] + wave(step * dt, residual_load)
        gap[:pairs] -= structure.clearance
        for _ in range(60):
            change = 0.0
            for i in range(pairs):
                pair_rows = [i, pairs + i, 2 * pairs + i]
                old_force, drag = force[pair_rows], compliance[pair_rows] @ force
                free_gap = gap[pair_rows] - drag + blocks_of_pairs[i] @ old_force
                # Stick, else slip: a fixed point of the cone with the largest diagonal.
                goal = free_gap - np.array([0.0, *place[:, i]])
                new_force = np.linalg.solve(blocks_of_pairs[i], goal)
                if new_force[0] <= 0.0:
                    new_force = np.zeros(3)
                elif np.hypot(*new_force[1:]) > mu * new_force[0]:
                    new_force = old_force.copy()
                    size = np.linalg.norm(blocks_of_pairs[i][1:, 1:], 2)
                    for _ in range(4):
                        new_force[0] = max(
                            (free_gap[0] - blocks_of_pairs[i][0, 1:] @ new_force[1:])
                            / blocks_of_pairs[i][0, 0],
                            0.0,
                        )
                        push = (
                            new_force[1:] + (goal[1:] - blocks_of_pairs[i][1:] @ new_force) / size
                        )
                        push_size = np.hypot(*push)
                        new_force[1:] = push * min(
                            1.0, mu * new_force[0] / push_size if push_size > 0.0 else 1.0
                        )
                force[pair_rows] = new_force
                change = max(change, float(np.abs(new_force - old_force).max()))
            if change <= 1e-8 * max(np.abs(force).max(), 1e-12):
                break
        gap_after = gap - compliance @ force
        place = gap_after[pairs:].reshape(2, pairs)
        q = free_state - slope.T * (force @ modal_rows)
        previous_load = next_load - force @ modal_rows
        if step > steps * (periods - 1):
            static_force = wave(step * dt, structure.force[:, count:]) - force @ static_rows
            motions.append(np.concatenate([q[0], structure.flexibility @ static_force]))
    return np.array(motions)
