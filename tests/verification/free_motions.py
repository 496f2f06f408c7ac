"""Free periodic motions of small structures, without load and damping, for verification pages.

A motion at rest at t = 0 is a series of cosines, in modal coordinates

    q_j(t) = sum_k q_kj cos(k w t),        (w_j^2 - (k w)^2) q_kj + phi_j^T B b_k(g) = 0,
    E = 1/2 sum_j w_j^2 q_j(0)^2 + kc/2 sum g(0)^2,

the last sum over closed pairs: found by Newton's method from the linear mode, along the logarithm
of the contact stiffness kc.
"""

import numpy as np

import fenics_crack as fc
from fenics_crack.balance.contact_integrals import integrals_with_uncoupled_pairs
from fenics_crack.model.modal import AllModes, all_modes

SOFT, STEPS = 1e-3, 20
"""Contact stiffness over that of the law from which the path begins, and full Newton steps."""


def free_frequency(
    structure: fc.Structure, law: fc.UnilateralPenalty, energy: float, harmonics: int
) -> float:
    """Frequency [rad/s] of the first mode's motion with an energy [J]; no pair is pressed at
    rest."""
    modes = all_modes(structure)
    motion, omega = np.zeros((harmonics + 1, len(modes.squares))), float(np.sqrt(modes.squares[0]))
    motion[1, 0] = np.sqrt(2.0 * energy) / omega * np.copysign(1.0, -modes.gaps_by_mode[0].sum())
    share, reached_share, rise = SOFT, SOFT, 2.0
    while True:
        newton_result = _newton(
            modes, law.scaled(share), structure.clearance, energy, motion, omega
        )
        if newton_result is not None:
            motion, omega, reached_share = *newton_result, share
            if share == 1.0:
                return omega
            rise = min(2.0 * rise, 10.0)
        else:
            rise **= 0.5
            assert rise > 1.0 + 1e-6, "the motion is lost on the way to the stiffness"
        share = min(1.0, rise * reached_share)


def _newton(
    modes: AllModes,
    law: fc.UnilateralPenalty,
    clearance: np.ndarray,
    energy: float,
    motion: np.ndarray,
    omega: float,
) -> tuple[np.ndarray, float] | None:
    """The motion next to one, and its frequency; None where it is not found, or is another
    mode's."""
    n_orders, count = motion.shape
    integrals, size = integrals_with_uncoupled_pairs(law, n_orders - 1), n_orders * count
    orders, rows = np.arange(n_orders)[:, None], np.maximum(2 * np.arange(n_orders) - 1, 0)
    scale = 1.0 / (modes.squares + (orders * omega) ** 2)
    for _ in range(STEPS):
        gap = np.zeros((2 * n_orders - 1, modes.gaps_by_mode.shape[1]))
        gap[rows] = motion @ modes.gaps_by_mode
        gap[0] -= clearance
        contact = integrals.linearise(gap)
        tangent = contact.tangent[:, rows[:, None], rows]
        start_position, dynamic_stiffness = (
            motion.sum(axis=0),
            modes.squares - (orders * omega) ** 2,
        )
        start_gap, motion_size = (
            start_position @ modes.gaps_by_mode - clearance,
            np.linalg.norm(motion),
        )
        push = law.force(start_gap)
        at_rest = 0.5 * (modes.squares @ start_position**2 + push @ np.maximum(start_gap, 0.0))
        left = (
            scale
            * (dynamic_stiffness * motion + contact.force[rows] @ modes.gaps_by_mode.T)
            / motion_size
        )
        right = np.append(left.ravel(), at_rest / energy - 1.0)
        if np.linalg.norm(right) < 1e-12:
            strain = motion[1:] ** 2 @ modes.squares
            return (motion, omega) if strain[0] > 0.25 * strain.sum() else None
        matrix = np.zeros((len(right), len(right)))
        contact_block = np.einsum(
            "ip,pkl,jp->kilj", modes.gaps_by_mode, tangent, modes.gaps_by_mode
        )
        matrix[:-1, :-1] = contact_block.reshape(size, size) + np.diag(dynamic_stiffness.ravel())
        matrix[:-1, :-1] *= scale.ravel()[:, None]
        matrix[:-1, -1] = (-2.0 * omega**2 * scale * orders**2 * motion).ravel() / motion_size
        matrix[-1, :-1] = (
            np.tile(modes.squares * start_position + modes.gaps_by_mode @ push, n_orders)
            * motion_size
            / energy
        )
        step = np.linalg.solve(matrix, right)
        motion = motion - motion_size * step[:-1].reshape(motion.shape)
        omega *= 1.0 - float(step[-1])
    return None
