"""The linear flow along waves whose contact stiffness varies smoothly: small disturbances.

Small disturbances z = (q, q') of a wave with gap s(t) follow, in modal coordinates,

    q'' + C q' + (W^2 + P kappa(t) P^T) q = 0,      kappa = d lambda / ds along s(t).

A step of length h is half a kick, q' -= h/2 P kappa P^T q, a drift of the structure without
contact, which is exact, and half a kick with the stiffness there. The error of the product M_N of N
steps in a period has even powers of h alone, so that that of (4 M_2N - M_N) / 3 is of fourth order.
N is doubled until this hardly changes, or is large.

Sources: Strang, SIAM Journal on Numerical Analysis 5 (1968) 506; Hairer, Lubich and Wanner,
Geometric Numerical Integration, 2006, section II.4.
"""

from __future__ import annotations

import numpy as np

from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.coupled import smooth_forces
from fenics_crack.model.flow import transition
from fenics_crack.model.modal import CACHED, AllModes, all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import KNOWN
from fenics_crack.numerics.fourier import sampled

__all__ = ["monodromy"]

MOST_STEPS = 2**13
"""In a period."""


def monodromy(
    structure: Structure,
    contact: ContactLaw,
    gap: np.ndarray,
    base_omega: float,
    static_above: float | None = None,
) -> np.ndarray:
    """M over one period of a wave, from phase zero: (2 n_modes, 2 n_modes); of a small structure.

    ``gap`` are the coefficients of the wave, (2H+1, n_pairs) [m], of the slow gap where pairs are
    seen through what modes beyond ``static_above`` [rad/s] answer; ``base_omega`` [rad/s] is its
    frequency.

    Raises
    ------
    ConvergenceError
        It is not found.
    """
    modes = all_modes(structure)
    if static_above is not None:
        modes = modes.below(static_above)
    size = np.repeat([np.sqrt(np.abs(modes.squares).max()) or 1.0, 1.0], len(modes.squares))
    count = 1 << (4 * len(gap)).bit_length()
    coarse = found = _product(modes, contact, gap, base_omega, count)
    change = whole = np.inf
    while count < MOST_STEPS and not change <= KNOWN * whole < np.inf:
        count *= 2
        fine = _product(modes, contact, gap, base_omega, count)
        before, found, coarse = found, fine + (fine - coarse) / 3.0, fine
        change, whole = (
            float(np.linalg.norm(size[:, None] * one / size)) for one in (found - before, found)
        )
    if not np.all(np.isfinite(found)):
        raise ConvergenceError("linear flow: its steps cannot follow the disturbances of the wave")
    return found


def _product(
    modes: AllModes, contact: ContactLaw, gap: np.ndarray, base_omega: float, count: int
) -> np.ndarray:
    """M of so many steps, a power of two: of stretches of the period at once, then of these one
    after the other."""
    h, n, values = 2.0 * np.pi / base_omega / count, len(modes.squares), sampled(gap, count)
    if modes.residual is None:
        kicks = h * contact.tangent(values)[:, :, None]
    else:
        kicks = h * smooth_forces(contact, modes.residual, values)[1]
    stretches = 1
    while stretches**2 < count and stretches * (2 * n) ** 2 < CACHED:
        stretches *= 2
    along = kicks.reshape(stretches, count // stretches, *kicks.shape[1:])
    moved = transition(modes, h)[0]
    state = np.tile(np.eye(2 * n), (stretches, 1, 1))
    with np.errstate(over="ignore", invalid="ignore"):  # of too few steps
        for kick in along.swapaxes(0, 1):
            state[:, n:] -= _kicked(modes, kick, state[:, :n])
            state = _drifted(modes, moved, state)
        product = state[0]
        for one in state[1:]:
            product = one @ product
        half = np.zeros_like(product)
        half[n:, :n] = 0.5 * _kicked(modes, kicks[0], np.eye(n))
        product = product + product @ half
        return product - half @ product


def _kicked(modes: AllModes, kick: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """h P kappa P^T q."""
    seen = modes.pairs.T @ moved
    return np.asarray(modes.pairs @ (kick * seen if modes.residual is None else kick @ seen))


def _drifted(modes: AllModes, moved: np.ndarray, state: np.ndarray) -> np.ndarray:
    """E z of the structure without contact, E as :func:`transition` gives it."""
    if modes.damping.ndim == 2:
        return np.asarray(moved @ state)
    n, e = moved.shape[1], moved[:, :, None]
    q, rate = state[:, :n], state[:, n:]
    return np.concatenate([e[0] * q + e[1] * rate, e[2] * q + e[3] * rate], axis=1)
