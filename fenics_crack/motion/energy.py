"""Energy budget of a steady vibration: where the load's work goes in a period T.

The load f does the work W. Modes lose D_j by damping, and rubbing pairs F_i:

    W = int f^T u' dt = sum_j D_j + sum_i F_i,
    D_j = int q_j' (c q')_j dt,      F_i = int lambda_i g_i' dt

with modal displacements q, c = Phi^T C Phi, friction forces lambda and tangential gaps g. Normal
contact forces lose nothing. The sum is exact but for errors of the integration.

Rigid contact sends energy into modes far above the load. Modes above 5 times the highest frequency
in the load are called *far*. In twenty random plates near a resonance, 20 to 160 modes gave modes
below this frequency the same share of the energy within 0.02 in the median
(``benchmarks/energy.py``). The shares above depend on damping ratios, seldom measured there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import resize_harmonics, to_complex

FAR_FREQUENCY_RATIO = 5.0
"""Natural frequency over the load's highest frequency, above which a mode is far."""


class EnergyBudget(NamedTuple):
    """Work of the load in a period, and the losses.

    Attributes
    ----------
    load, apparent : float [J]
        W, work of the load, and S = pi sum_k k |f_k^H u_k| with complex harmonics of load and
        displacement: the work of a motion with a quarter period's lag.
    damping : (n_modes,) [J]
        D_j, lost by each mode.
    friction : (n_pairs,) or (0,) [J]
        F_i, lost by each pair; empty without friction.
    omega : (n_modes,) [rad/s]
        Natural frequencies of the modes.
    far_omega : float [rad/s]
        Frequency above which modes are far.
    """

    load: float
    apparent: float
    damping: np.ndarray
    friction: np.ndarray
    omega: np.ndarray
    far_omega: float

    @property
    def shares(self) -> dict[str, float]:
        """Shares of W by name: near modes, far modes, friction. Nan if the load does no work.

        The rest to 1 is the share of contact, 0 but for errors of the integration.
        """
        W = self.load if self.load > 0.0 else np.nan
        is_far = self.omega > self.far_omega
        D_near, D_far = self.damping[~is_far].sum(), self.damping[is_far].sum()
        shares = {"near_share": float(D_near / W), "far_share": float(D_far / W)}
        if self.friction.size:
            shares["rub_share"] = float(self.friction.sum() / W)
        return shares

    @property
    def power_factor(self) -> float:
        """W / S: 1 at a resonance, where damping alone limits the motion."""
        return self.load / self.apparent if self.apparent else 0.0

    def moved_share(self, other_budget: EnergyBudget) -> float:
        """Return the share of W that another budget with equal lowest modes gives elsewhere.

        Half the sum of |D_j / W - D'_j / W'| over all modes, and of friction's change.
        """
        n = max(len(self.damping), len(other_budget.damping))
        shares = np.zeros((2, n + 1))
        for row, budget in zip(shares, (self, other_budget), strict=True):
            row[: len(budget.damping)] = budget.damping / budget.load
            row[-1] = budget.friction.sum() / budget.load
        return float(0.5 * np.abs(shares[1] - shares[0]).sum())


def far_frequency(structure: Structure, omega: float) -> float:
    """Return the frequency [rad/s] above which modes are far from the load at ``omega``."""
    rows = np.flatnonzero(structure.sum_over_ranks(np.sum(structure.force**2, axis=1)))
    highest_order = (rows.max(initial=0) + 1) // 2
    return FAR_FREQUENCY_RATIO * max(highest_order, 1) * omega


def series_work(f: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return int f u' dt over a period, for Fourier coefficients (2H+1, n) of both: (n,)."""
    k = np.arange(1, len(u) // 2 + 1)
    return np.asarray(np.pi * k @ (f[1::2] * u[2::2] - f[2::2] * u[1::2]))


def load_works(products: np.ndarray, subharmonic: int) -> tuple[float, float]:
    """Return W and S [J] by Fourier coefficients (2H+1, 2K+1) of u times each row of the load.

    The rows are the load's own coefficients; ``subharmonic`` periods of the load are a period.
    """
    k = np.arange(1, products.shape[1] // 2 + 1)
    orders = subharmonic * k
    n_harmonics = max(len(products) // 2, orders.max(initial=0))
    harmonics = to_complex(resize_harmonics(products, n_harmonics))[orders]
    P = harmonics[k - 1, 2 * k - 1] + 1j * harmonics[k - 1, 2 * k]
    return float(-np.pi * orders @ P.imag), float(np.pi * orders @ np.abs(P))
