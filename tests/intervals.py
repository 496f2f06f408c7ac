"""When which pairs are closed, for contact that couples the pairs, as the kernel finds it.

Between two events the set A of closed pairs stays, and with it lambda_A = (D_AA)^-1 s_A and the
openings of the others, D lambda - s (:mod:`fenics_crack.model.coupled`). An event is the first root
of one of these: a force that vanishes opens its pair, an opening that vanishes closes it. There the
stiffness S_A = (D_AA)^-1, with zeros outside A, changes by a part of rank one, gain v v^T.

The kernel finds them (``kernel/intervals.c``) on the cells of a grid, 16 and more to the shortest
wave. It carries one set through the period: an event or a cell without one costs some n_pairs^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

import fenics_crack as fc
from fenics_crack.kernel import Struct, kernel, owned, shaped
from fenics_crack.model.coupled import ActiveSets
from fenics_crack.numerics.equations import ROUNDING

__all__ = ["Intervals", "contact_intervals"]

NO_FORCES = -2
"""What the kernel returns then."""


@dataclass(frozen=True)
class Intervals:
    """Sets of closed pairs over a period.

    Attributes
    ----------
    theta : (m,) [rad]
        Where each interval begins, the first at 0; ascending.
    first : (n_pairs,) bool
        Pairs closed in the first interval.
    pair : (m - 1,) int
        Which pair opens or closes at the end of each.
    stiffness : (n_pairs, n_pairs) [N/m]
        S of the first interval.
    vectors, gains : (m - 1, n_pairs) and (m - 1,) [N/m]
        v and gain: how S changes at the end of each.
    """

    theta: np.ndarray
    first: np.ndarray
    pair: np.ndarray
    stiffness: np.ndarray
    vectors: np.ndarray
    gains: np.ndarray

    @cached_property
    def closed(self) -> np.ndarray:
        """Pairs closed in each interval: (m, n_pairs) bool."""
        turned = np.zeros((len(self.theta), len(self.first)), dtype=bool)
        turned[0] = self.first
        turned[np.arange(1, len(self.theta)), self.pair] = True
        return np.logical_xor.accumulate(turned, axis=0)

    def rests(self, highest: int) -> np.ndarray:
        """Means over the period of exp(i m theta) from where each interval begins to the period's
        end: (m, highest + 1)."""
        order = np.arange(highest + 1)
        found = 1.0 - np.exp(1j * np.multiply.outer(self.theta, order))
        found[:, 0] = 2.0 * np.pi - self.theta
        found[:, 1:] /= 1j * order[1:]
        return found / (2.0 * np.pi)


def contact_intervals(gap: np.ndarray, contact: ActiveSets) -> Intervals:
    """The intervals of waves s with coefficients (2H+1, n_pairs).

    Raises ConvergenceError where an instant has no forces.
    """
    columns, pairs = len(gap), len(contact.compliance)
    gap = shaped(gap, 2 * (columns // 2) + 1, pairs)
    count = kernel.interval_cells(columns // 2, pairs)
    first, stiffness = np.empty(pairs, dtype=bool), np.empty((pairs, pairs))
    table = Struct(
        "pivot_table", pairs=pairs, d=contact.compliance, table=np.empty((pairs, pairs)),
        closed=np.empty(pairs, dtype=bool), room=np.empty(4 * pairs),
    )  # fmt: skip
    waves, places = _waves(columns // 2, count, pairs), count + 8 * pairs
    while True:
        theta, pair = np.zeros(places + 1), np.empty(places, dtype=np.intc)
        vectors, gains = np.empty((places, pairs)), np.empty(places)
        known = Struct(
            "breathing", contact=table, cells=count, most=places, columns=columns, gaps=gap,
            waves=waves, allowed=ROUNDING * float(np.abs(gap).sum(axis=0).max(initial=0.0)),
            first=first, stiffness=stiffness, theta=theta[1:], pair=pair, vectors=vectors,
            gain=gains, work=np.empty(kernel.intervals_room(pairs, columns // 2, count)),
        )  # fmt: skip
        found = kernel.intervals(known.at)
        if found >= 0:
            return Intervals(
                theta[: found + 1], first, pair[:found], stiffness, vectors[:found], gains[:found]
            )
        if found == NO_FORCES:
            raise fc.ConvergenceError("contact: no forces were found at an instant of the period")
        places *= 2


@lru_cache(maxsize=16)
def _waves(harmonics: int, count: int, pairs: int) -> Any:
    """What the kernel finds gaps with at equally spaced phases."""
    return owned(kernel.new_waves(harmonics, count, pairs), kernel.free_waves)
