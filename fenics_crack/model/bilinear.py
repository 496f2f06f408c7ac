"""Frequencies between which a breathing crack resonates.

Half a period with lips open and half a period with lips tied, each half as long as the natural
vibration of that state, make a period pi / w_o + pi / w_t, and so the bilinear frequency

    w_b = 2 w_o w_t / (w_o + w_t)

(Shaw and Holmes, Journal of Sound and Vibration 90, 1983, 129, for one degree of freedom). It is
exact for a bilinear oscillator without clearance, and near where one mode carries the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fenics_crack.errors import FEW_MODES
from fenics_crack.model.modes import n_tied_modes, solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.table import Tabular, counted

__all__ = ["KINDS", "BilinearFrequencies", "bilinear_frequencies", "tied_frequencies"]

KINDS = ("open", "tied", "bilinear")
"""Of natural frequencies."""


@dataclass(frozen=True, repr=False)
class BilinearFrequencies(Tabular):
    """Natural frequencies with lips open and with lips tied, mode by mode in ascending order.

    Attributes
    ----------
    omega_open, omega_tied : (n,), or (..., n) [rad/s]
        Of the modes with the same number, or at several speeds; tied ones are infinite where there
        are no more.
    """

    omega_open: np.ndarray
    omega_tied: np.ndarray

    KIND: ClassVar[str] = "set of bilinear frequencies"

    @property
    def omega_bilinear(self) -> np.ndarray:
        """2 w_o w_t / (w_o + w_t): (..., n) [rad/s]."""
        with np.errstate(divide="ignore"):
            return np.asarray(2.0 / (1.0 / self.omega_open + 1.0 / self.omega_tied))

    def nearest(self, omega: Any) -> dict[str, np.ndarray]:
        """Describe load frequencies (...) by the mode whose bilinear frequency is nearest.

        ``mode``, its number; ``omega_open``, ``omega_tied`` and ``omega_bilinear`` of it [rad/s];
        ``over_open``, ``over_tied`` and ``over_bilinear``, the load frequency over these: one less
        is the frequency shift. Of shape (...), that of the speeds if there are several.
        """
        omega, bilinear = np.asarray(omega, dtype=float), self.omega_bilinear
        place = np.abs(omega[..., None] - bilinear).argmin(axis=-1)
        count = bilinear.shape[-1]
        found: dict[str, np.ndarray] = {"mode": place + 1}
        for name in KINDS:
            natural = np.broadcast_to(getattr(self, f"omega_{name}"), (*place.shape, count))
            natural = np.take_along_axis(natural, place[..., None], -1)[..., 0]
            found[f"omega_{name}"] = natural
            with np.errstate(divide="ignore", invalid="ignore"):
                found[f"over_{name}"] = omega / natural
        return found

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every mode."""
        return {
            "mode": list(range(1, len(self.omega_open) + 1)),
            "omega_open": self.omega_open.tolist(),
            "omega_tied": self.omega_tied.tolist(),
            "omega_bilinear": self.omega_bilinear.tolist(),
        }

    def _title(self) -> str:
        first = f"first {self.omega_open[0]:.6g} open, {self.omega_tied[0]:.6g} rad/s tied"
        return f"{counted(len(self.omega_open), 'mode')}, {first}"


def bilinear_frequencies(structure: Structure) -> BilinearFrequencies:
    """The lowest natural frequencies, up to 6, with lips open and with lips tied (collective).

    Tied lips slide (:func:`fenics_crack.solve_modes`); a contact law of little stiffness lets them
    part, and resonances then lie lower. They are computed once for a structure and its varied
    copies.

    Parameters
    ----------
    structure : Structure
        Whole or reduced.

    Returns
    -------
    BilinearFrequencies
        Mode by mode, in ascending order [rad/s].

    Raises
    ------
    InputError, ConvergenceError
        As :func:`fenics_crack.solve_modes`.

    Examples
    --------
    >>> natural = fc.bilinear_frequencies(structure)
    >>> resonance = natural.omega_bilinear[0]
    """
    return structure.once(_bilinear_frequencies)


def _bilinear_frequencies(structure: Structure) -> BilinearFrequencies:
    count = min(FEW_MODES, structure.n_modes)
    return BilinearFrequencies(
        solve_modes(structure, count).omega, tied_frequencies(structure, count)
    )


def tied_frequencies(structure: Structure, count: int) -> np.ndarray:
    """The lowest natural frequencies with lips tied, infinite where there are no more: (count,)
    [rad/s] (collective)."""
    found = np.full(count, np.inf)
    if most := min(count, n_tied_modes(structure)):
        found[:most] = solve_modes(structure, most, lips="tied").omega
    return found
