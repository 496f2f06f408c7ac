"""Damping that follows from mass and stiffness: modal, and Rayleigh's.

Both are diagonal in the natural modes, K phi_j = omega_j^2 M phi_j with phi_i^T M phi_j = delta_ij:

    phi_i^T C phi_j = 2 xi_j omega_j delta_ij.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.errors import InputError, check_count, check_number, check_two_ratios
from fenics_crack.model.factor import weighted_sum
from fenics_crack.model.matrices import numbers

__all__ = ["DampingRule", "ModalDamping", "RayleighDamping"]


@dataclass(frozen=True)
class ModalDamping:
    """Damping C = M Phi diag(2 xi_j omega_j) Phi^T M over mass-normalised modes; never formed.

    Attributes
    ----------
    ratio : float or tuple of float
        xi_j, of critical damping: one for all modes, or one per mode.
    modes : int or None
        How many of the lowest modes are damped; None: all.

    Raises
    ------
    InputError
        A ratio is negative or not finite, or ``modes`` is no whole number >= 1.
    """

    ratio: float | Sequence[float]
    modes: int | None = None

    def __post_init__(self) -> None:
        ratio = numbers(self.ratio)
        if ratio.ndim > 1 or not ratio.size or not np.all(np.isfinite(ratio)) or ratio.min() < 0.0:
            raise InputError("damping ratio", self.ratio, "finite and >= 0, one or one per mode")
        if self.modes is not None:
            check_count("damping modes", self.modes, 1)
        object.__setattr__(self, "ratio", tuple(ratio.tolist()) if ratio.ndim else float(ratio))

    def scaled(self, factor: float) -> ModalDamping:
        """The same with every ratio multiplied by a factor."""
        ratio: Any = (factor * np.asarray(self.ratio)).tolist()
        return replace(self, ratio=ratio)

    def of_kept(self, count: int) -> ModalDamping:
        """Damping of so many kept modes: those beyond the damped ones by the last ratio."""
        if isinstance(self.ratio, float):
            return ModalDamping(self.ratio)
        ratio = list(self.ratio)[:count]
        return ModalDamping(tuple(ratio + ratio[-1:] * (count - len(ratio))))

    def rate(self, squares: np.ndarray) -> np.ndarray:
        """2 xi omega [1/s] of the damped modes, with omega^2 (n,) [rad^2/s^2]."""
        return np.asarray(2.0 * np.asarray(self.ratio) * np.sqrt(np.maximum(squares, 0.0)))

    def __str__(self) -> str:
        percent = 100.0 * np.asarray(self.ratio)
        low, high = f"{percent.min():.3g}", f"{percent.max():.3g}"
        modes = "" if self.modes is None else f" of {self.modes} modes"
        return f"modal damping {low if low == high else f'{low} to {high}'} %{modes}"


@dataclass(frozen=True)
class RayleighDamping:
    """Damping C = a M + b K, which damps every mode by the ratio

        xi(omega) = a / (2 omega) + b omega / 2.

    Attributes
    ----------
    mass : float
        a [1/s]: damps the low modes.
    stiffness : float
        b [s]: damps the high modes.

    Raises
    ------
    InputError
        A coefficient is negative or not finite.
    """

    mass: float = 0.0
    stiffness: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mass", "stiffness"):
            check_number(f"damping {name}", getattr(self, name), 0.0)
            object.__setattr__(self, name, float(getattr(self, name)))

    @classmethod
    def from_ratios(cls, ratios: Sequence[float], omegas: Sequence[float]) -> RayleighDamping:
        """The damping with given ratios at two frequencies.

        With w_1 < w_2 and s = w_1 (xi_2 - xi_1) / (w_2 - w_1),

            a = 2 w_1 w_2 (xi_1 - s) / (w_1 + w_2),      b = 2 (xi_2 + s) / (w_1 + w_2).

        Between both frequencies the ratio is at most the larger of the two.

        Parameters
        ----------
        ratios : (2,)
            xi_1 and xi_2, of critical damping.
        omegas : (2,) [rad/s]
            The frequencies at which they hold.

        Raises
        ------
        InputError
            The ratios are not two numbers >= 0, the frequencies not two different ones > 0, or a
            coefficient would be negative.

        Notes
        -----
        Source: Clough and Penzien, Dynamics of Structures, 2nd edition, McGraw-Hill, New York 1993.
        """
        xi, omega = numbers(ratios), numbers(omegas)
        if xi.shape != (2,) or not np.all(np.isfinite(xi)) or xi.min() < 0.0:
            raise InputError("damping ratios", ratios, "two finite numbers >= 0")
        known = omega.shape == (2,) and np.all(np.isfinite(omega))
        if not known or omega.min() <= 0.0 or omega[0] == omega[1]:
            raise InputError("damping omegas", omegas, "two different finite numbers > 0")
        ratio, place = [float(x) for x in xi], [float(w) for w in omega]
        check_two_ratios("damping ratios", ratio, place)
        (low, at_low), (high, at_high) = sorted(zip(place, ratio, strict=True))
        slope = low / (high - low) * (at_high - at_low)
        mean = 0.5 * (low + high)
        mass, stiffness = low / mean * high * (at_low - slope), (at_high + slope) / mean
        return cls(max(mass, 0.0), max(stiffness, 0.0))  # not below 0 by rounding

    def scaled(self, factor: float) -> RayleighDamping:
        """The same with both coefficients multiplied by a factor."""
        return RayleighDamping(factor * self.mass, factor * self.stiffness)

    def of_kept(self, count: int) -> RayleighDamping:
        """Damping of so many kept modes: its own."""
        return self

    def rate(self, squares: np.ndarray) -> np.ndarray:
        """2 xi omega = a + b omega^2 [1/s] of modes with omega^2 (n,) [rad^2/s^2]."""
        return self.mass + self.stiffness * squares

    def matrix(self, mass: Any, stiffness: Any) -> Any:
        """C of PETSc's M and K, as sparse as both (collective)."""
        part = mass.copy()
        part.scale(self.mass)
        total = weighted_sum(part, self.stiffness, stiffness)
        part.destroy()
        return total

    def __str__(self) -> str:
        return f"Rayleigh damping {self.mass:.3g}/s M + {self.stiffness:.3g} s K"


DampingRule = ModalDamping | RayleighDamping
"""Damping that follows from mass and stiffness."""
