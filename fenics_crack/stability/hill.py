"""Hill's determinant, condensed onto the pairs: a second way to a Floquet multiplier.

    det( I + R(s) kappa ) = 0,       mu = exp(s T),

with the compliance R at s + i k w, k = -H..H, and the harmonics kappa of the contact stiffness;
where pairs are seen through a static compliance, R is that of the modes that move.

Source: Lazarus and Thomas, Comptes Rendus Mecanique 338, 2010, 510-517.
"""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.contact_integrals import SampledIntegrals
from fenics_crack.balance.coupled_integrals import CoupledIntegrals
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modal import AllModes, all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import resized, to_complex

__all__ = ["hill_root"]

MAX_SECANTS = 12
FARTHEST = 0.05
"""From a multiplier's exponent to the root of Hill's determinant, relative to the frequency."""


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
                bordering, start, x1=start + 1e-7 * omega, tol=1e-10 * omega, maxiter=MAX_SECANTS,
                full_output=True, disp=False,
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
    sampled = SampledIntegrals(contact, highest, samples)
    slopes = contact.tangent(sampled.sample(resized(gap, highest)))
    return np.fft.rfft(slopes, axis=0)[: highest + 1].T.conj() / samples
