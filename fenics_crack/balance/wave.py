"""A periodic motion by its Fourier coefficients, and what follows from them at any time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_crack.balance.coupled_integrals import CoupledIntegrals
from fenics_crack.model.contact import ContactLaw, force_in_time
from fenics_crack.model.modal import all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import evaluate

__all__ = ["Wave"]


@dataclass(frozen=True, repr=False)
class Wave:
    """u(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t), w = omega / subharmonic.

    Its attributes are those of :class:`fenics_crack.PeriodicSolution`.
    """

    structure: Structure
    omega: float
    contact: ContactLaw | None
    displacement_coefficients: np.ndarray
    gap_coefficients: np.ndarray
    force_coefficients: np.ndarray
    subharmonic: int = 1
    static_above: float | None = None

    @property
    def harmonics(self) -> int:
        """H, the highest harmonic kept."""
        return (len(self.gap_coefficients) - 1) // 2

    @property
    def base_omega(self) -> float:
        """Angular frequency of the response [rad/s]."""
        return self.omega / self.subharmonic

    @property
    def period(self) -> float:
        """Period of the response [s]."""
        return float(2.0 * np.pi / self.base_omega)

    @cached_property
    def residual(self) -> np.ndarray | None:
        """R_inf, the compliance of what answers contact forces at once: (n_pairs, n_pairs) [m/N];
        None where nothing does."""
        if self.static_above is None:
            return None
        return all_modes(self.structure).static_part(self.static_above)

    @cached_property
    def _forces(self) -> CoupledIntegrals:
        """lambda(s) where something answers at once."""
        assert self.contact is not None
        return CoupledIntegrals(self.contact, self.harmonics, residual=self.residual)

    @property
    def slow_gap_coefficients(self) -> np.ndarray:
        """Of s = g + R_inf lambda, the gap without what answers at once: (2H+1, n_pairs) [m]."""
        if self.residual is None:
            return self.gap_coefficients
        return self.gap_coefficients + self.force_coefficients @ self.residual

    def gap(self, time: np.ndarray) -> np.ndarray:
        """g at times [s]: (len(time), n_pairs) [m]. Where some of it answers contact forces at
        once, s(t) - R_inf lambda(s(t)), with its kinks."""
        slow = evaluate(self.slow_gap_coefficients, self.base_omega, time)
        if self.residual is None:
            return slow
        return slow - self.contact_force(time) @ self.residual

    def contact_force(self, time: np.ndarray) -> np.ndarray:
        """Contact force at times [s]: (len(time), n_pairs) [N], lambda(g(t)) or lambda(s(t)); of a
        constraint of pairs that nothing couples, eps max(0, g + lambda / eps) of the waves."""
        gap = evaluate(self.slow_gap_coefficients, self.base_omega, time)
        if self.contact is None:
            return np.zeros_like(gap)
        if self.residual is not None:
            return self._forces.forces(gap)
        force = evaluate(self.force_coefficients, self.base_omega, time)
        return force_in_time(self.contact, gap, force)

    def coordinates(self, time: np.ndarray) -> np.ndarray:
        """Displacement of the structure's own dofs on this rank: (len(time), n_local) [m]."""
        found = evaluate(self.displacement_coefficients, self.base_omega, time)
        if self.static_above is not None:
            # What answers at once follows the forces as they are, with their kinks.
            waves = evaluate(self.force_coefficients, self.base_omega, time)
            moved = all_modes(self.structure).moved_at_once(self.static_above)
            found -= (self.contact_force(time) - waves) @ moved.T
        return found
