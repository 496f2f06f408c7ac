"""Floquet multipliers of waves whose contact stiffness varies smoothly: two ways to them.

The linear flow. Small disturbances z = (q, q') of a wave with gap s(t) follow, in modal
coordinates,

    q'' + C q' + (W^2 + P kappa(t) P^T) q = 0,      kappa = d lambda / ds along s(t).

A step of length h is half a kick, q' -= h/2 P kappa P^T q, a drift of the structure without
contact, which is exact, and half a kick with the stiffness there. The error of the product M_N of N
steps in a period has even powers of h alone, so that that of (4 M_2N - M_N) / 3 is of fourth order.
N is doubled until this hardly changes, or is large.

Hill's determinant, condensed onto the pairs:

    det( I + R(s) kappa ) = 0,       mu = exp(s T),

with the compliance R at s + i k w, k = -H..H, and the harmonics kappa of the contact stiffness;
where pairs are seen through a static compliance, R is that of the modes that move.

Sources: Strang, SIAM Journal on Numerical Analysis 5 (1968) 506; Hairer, Lubich and Wanner,
Geometric Numerical Integration, 2006, section II.4; Lazarus and Thomas, Comptes Rendus Mecanique
338, 2010, 510-517.
"""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.contact_integrals import CoupledIntegrals
from fenics_crack.balance.judgement import FARTHEST
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.coupled import smooth_forces
from fenics_crack.model.flow import transition
from fenics_crack.model.modal import CACHED, AllModes, all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import KNOWN
from fenics_crack.numerics.fourier import resized, sampled, to_complex

__all__ = ["hill_root", "monodromy"]

HILL_STEPS = 2**13
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
    while count < HILL_STEPS and not change <= KNOWN * whole < np.inf:
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


def hill_root(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw, multiplier: complex
) -> complex:
    """The root of Hill's condensed determinant next to a multiplier, as a multiplier; nan if none.

    D(s) = I + R(s) kappa is singular where f(s) vanishes in

        [ D(s)  b ] [x]   [0]
        [ a^T   0 ] [f] = [1],

    with a, b from a step of inverse iteration at the multiplier. Found by SciPy's secants.
    """
    means, modes = _stiffness_means(solution, contact), all_modes(structure)
    if solution.static_above is not None:
        modes = modes.below(solution.static_above)
    if not np.any(means):
        return multiplier  # no contact: the monodromy matrix is that of the linear structure
    omega = solution.base_omega
    start = complex(np.log(complex(multiplier)) / solution.period)

    def matrix(exponent: complex) -> np.ndarray:
        return _hill_matrix(modes, means, exponent, omega)

    try:
        first = matrix(start)
        size = len(first)
        bordered, last = np.zeros((size + 1, size + 1), complex), np.eye(size + 1)[-1]
        random = np.random.default_rng(0).normal(size=size)
        for vector, side in ((bordered[:size, -1], first.T), (bordered[-1, :size], first)):
            found = np.linalg.solve(side, random)
            vector[:] = found.conj() / np.linalg.norm(found)

        def bordering(exponent: complex) -> complex:
            if not abs(exponent - start) < FARTHEST * omega:
                return complex(np.nan)
            bordered[:size, :size] = matrix(exponent)
            return complex(np.linalg.solve(bordered, last)[-1])

        import scipy.optimize  # takes a while, and smooth laws alone are judged here

        with np.errstate(invalid="ignore", divide="ignore"):  # NaN: too far from the start
            root, report = scipy.optimize.newton(
                bordering, start, x1=start + 1e-7 * omega, tol=1e-10 * omega, full_output=True,
                disp=False,
            )  # fmt: skip
    except (np.linalg.LinAlgError, OverflowError):  # the latter of Python's complex numbers
        return complex(np.nan)
    return complex(np.exp(root * solution.period)) if report.converged else complex(np.nan)


def _hill_matrix(modes: AllModes, means: np.ndarray, exponent: complex, omega: float) -> np.ndarray:
    """I + R(s) kappa for rows (harmonic -H..H, pair), from the harmonics of the stiffness: of each
    pair, or between the pairs."""
    harmonics, pairs = means.shape[-1] // 2, len(means)
    order = np.arange(-harmonics, harmonics + 1)
    lag = order[:, None] - order
    coupling = np.where(lag >= 0, means[..., np.abs(lag)].conj(), means[..., np.abs(lag)])
    points = exponent + 1j * order * omega
    if modes.damping.ndim == 1:
        receptance = 1.0 / (modes.squares + points[:, None] ** 2 + points[:, None] * modes.damping)
        compliance = np.einsum("jp,kj,jq->kpq", modes.pairs, receptance, modes.pairs)
    else:
        impedance = points[:, None, None] * modes.damping + np.zeros((1, 1, 1), complex)
        diagonal = np.arange(len(modes.squares))
        impedance[:, diagonal, diagonal] += modes.squares + points[:, None] ** 2
        compliance = modes.pairs.T @ np.linalg.inv(impedance) @ modes.pairs
    if means.ndim == 2:
        product = np.einsum("kpq,qkl->kplq", compliance, coupling)
    else:
        product = np.einsum("kpq,qrkl->kplr", compliance, coupling, optimize=True)
    size = len(order) * pairs
    return np.eye(size) + product.reshape(size, size)


def _stiffness_means(solution: PeriodicSolution, contact: ContactLaw) -> np.ndarray:
    """Means of the contact stiffness times exp(i m theta), m = 0 to 2H: (n_pairs, 2H+1), or between
    coupled pairs (n_pairs, n_pairs, 2H+1)."""
    gap, highest = solution.slow_gap_coefficients, 2 * solution.harmonics
    if solution.residual is not None:
        integrals = CoupledIntegrals(contact, solution.harmonics, residual=solution.residual)
        return np.moveaxis(to_complex(integrals.linearise(gap).means()).conj(), 0, -1)
    samples = max(1024, 8 * highest)
    slopes = contact.tangent(sampled(resized(gap, highest), samples))
    return np.fft.rfft(slopes, axis=0)[: highest + 1].T.conj() / samples
