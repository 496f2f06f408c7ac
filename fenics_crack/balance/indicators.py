"""Indicators of a breathing crack: numbers of a steady vibration that change with the crack.

Of a watched displacement u(t) = a0 + sum_k a_k cos(k w t / m) + b_k sin(k w t / m), with the load
at w and m times its period, the amplitude at j times the load's frequency is

    U_j = sqrt(a_k^2 + b_k^2),      k = j m,

and a linear structure has U_1 alone. Lips that open and close once in a period act as a stiffness
that depends on the sign of the gap: they make even harmonics and a mean, U_2 / U_1 and a0 / U_1,
and at a period doubling U_1/2; all of these are independent of the size of the load as long as
there is no clearance (Dimarogonas, Engineering Fracture Mechanics 55, 1996, 831, reviews them).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fenics_crack.scene.quantities import QUANTITIES
from fenics_crack.table import Tabular

__all__ = ["Indicators", "contact_extremes", "indicators_of"]


@dataclass(frozen=True, repr=False)
class Indicators(Tabular):
    """What a point and the lips show of a breathing crack.

    Made by ``indicators`` of a solution, where each attribute is a number, or of a curve, where
    each is an array with a value for every point (n,).

    Attributes
    ----------
    omega : [rad/s]
        Frequency of the load.
    amplitude : [m]
        Half the peak-to-peak displacement, of all harmonics together.
    mean : [m]
        a0, with the displacement by a mean load.
    harmonic_1, harmonic_2, harmonic_3 : [m]
        U_1, U_2, U_3: amplitudes at once, twice and three times the load's frequency.
    ratio_2_1, ratio_3_1 : [-]
        U_2 / U_1 and U_3 / U_1; nan where the solution has not so many harmonics, or no U_1.
    ratio_half_1 : [-]
        U_1/2 / U_1, at half the load's frequency; nan unless the solution has an even multiple of
        the load's period.
    ratio_largest, largest_order : [-]
        U_k / U_1 of the largest harmonic above the load's, and its order k; nan without one.
    mean_shift : [-]
        a0 / U_1, positive in the direction of the dof.
    opening, penetration : [m]
        The largest of any pair at any time; nan without pairs, as are the next three.
    contact_force : [N]
        The largest of any pair at any time: the finer the mesh, the smaller.
    crack_force : [N]
        The largest of a crack at any time, the sum over its pairs, which a finer mesh does not
        change; of matrices that of all pairs.
    closed_share : [-]
        Part of the period in which a pair carries a contact force, mean over the pairs.
    """

    omega: Any
    amplitude: Any
    mean: Any
    harmonic_1: Any
    harmonic_2: Any
    harmonic_3: Any
    ratio_2_1: Any
    ratio_3_1: Any
    ratio_half_1: Any
    ratio_largest: Any
    largest_order: Any
    mean_shift: Any
    opening: Any
    penetration: Any
    contact_force: Any
    crack_force: Any
    closed_share: Any

    def to_dict(self) -> dict[str, Any]:
        """Numbers by name, or along a curve columns."""
        return {item.name: np.asarray(getattr(self, item.name)).tolist() for item in fields(self)}

    def _units(self) -> Mapping[str, str]:
        return {name: unit for name, (_, unit) in QUANTITIES.items()} | {"omega": "rad/s"}

    def _title(self) -> str:
        if np.ndim(self.omega):
            return f"{len(self.omega)} points"
        return f"amplitude = {self.amplitude:.4g} m, ratio_2_1 = {self.ratio_2_1:.3g}"


def indicators_of(
    omega: Any,
    coefficients: np.ndarray,
    amplitude: Any,
    contact: Mapping[str, Any],
    subharmonic: int = 1,
) -> Indicators:
    """Indicators from load frequencies (...), coefficients of a displacement (..., 2H+1), half its
    peak-to-peak values (...) and what :func:`contact_extremes` has found of the lips (...)."""
    harmonics = (coefficients.shape[-1] - 1) // 2

    def at(multiple: float) -> Any:
        """U_j, nan where it is not among the harmonics."""
        order = multiple * subharmonic
        if order != int(order) or order > harmonics:
            return np.full(coefficients.shape[:-1], np.nan)[()]
        row = 2 * int(order)
        return np.hypot(coefficients[..., row - 1], coefficients[..., row])

    first, second, third, mean = at(1), at(2), at(3), coefficients[..., 0]
    unknown = np.full(coefficients.shape[:-1], np.nan)[()]
    largest = order = unknown
    if harmonics >= 2 * subharmonic:
        above = np.stack([at(k) for k in range(2, harmonics // subharmonic + 1)], axis=-1)
        largest, order = above.max(axis=-1), 2.0 + above.argmax(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        known = np.where(first > 0.0, first, np.nan)
        ratios = [part / known for part in (second, third, at(0.5), largest)]
        shift = mean / known
    lips = {name: contact.get(name, unknown) for name in CONTACT}
    seen = mean, first, second, third, *ratios, order, shift
    return Indicators(omega, amplitude, *seen, **lips)


CONTACT = ("opening", "penetration", "contact_force", "crack_force", "closed_share")


def contact_extremes(
    gap: np.ndarray, force: np.ndarray, cracks: np.ndarray | None = None
) -> dict[str, float]:
    """Opening [m], penetration [m] and force [N], the largest of any pair; the largest force of a
    crack, and the share of the time closed, mean over the pairs: of gaps and forces over time
    (n, n_pairs), with the crack of each pair, by default one of all. Empty without pairs."""
    if not gap.shape[1]:
        return {}
    cracks = np.zeros(gap.shape[1], dtype=int) if cracks is None else cracks
    of_cracks = [force[:, cracks == crack].sum(axis=1) for crack in np.unique(cracks)]
    return {
        "opening": max(0.0, -float(gap.min())),
        "penetration": max(0.0, float(gap.max())),
        "contact_force": float(force.max()),
        "crack_force": float(np.max(of_cracks)),
        "closed_share": float(np.mean(force > 0.0)),
    }
