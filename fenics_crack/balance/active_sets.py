"""When which pairs are closed, for contact that couples the pairs: found cell by cell, in order.

Between two events the set A of closed pairs stays, and with it lambda_A = (D_AA)^-1 s_A and the
openings of the others, D lambda - s (:mod:`fenics_crack.model.coupled`). An event is the first root
of one of these: a force that vanishes opens its pair, an opening that vanishes closes it.

The kernel finds them (``kernel/intervals.c``) on the cells of a grid, 16 and more to the shortest
wave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_crack.balance.fourier import from_complex, sampled
from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import doubles, kernel, signs
from fenics_crack.model.coupled import ROUNDING, ActiveSets, unique_sets

__all__ = ["Intervals", "contact_intervals"]

CELLS, CELLS_OF_PAIR = 16, 4
"""At least so many to the shortest wave, and in the period to every pair: few events in a cell. Of
1,500 random waves of 2 to 39 pairs, 4 and 128 cells to a pair give the same events."""
NO_FORCES = -2
"""What the kernel returns then."""


@dataclass(frozen=True)
class Intervals:
    """Sets of closed pairs over a period.

    Attributes
    ----------
    theta : (m,) [rad]
        Where each interval begins, the first at 0; ascending.
    which : (m,)
        The row of ``sets`` in each interval.
    sets : (n_sets, n_pairs) bool
        Different sets of closed pairs.
    """

    theta: np.ndarray
    which: np.ndarray
    sets: np.ndarray

    def rests(self, highest: int) -> np.ndarray:
        """Means over the period of exp(i m theta) from where each interval begins to the period's
        end: (m, highest + 1)."""
        order = np.arange(highest + 1)
        found = 1.0 - np.exp(1j * np.multiply.outer(self.theta, order))
        found[:, 0] = 2.0 * np.pi - self.theta
        found[:, 1:] /= 1j * order[1:]
        return found / (2.0 * np.pi)


def contact_intervals(harmonics: np.ndarray, contact: ActiveSets) -> Intervals:
    """The intervals of waves s with complex harmonics (H+1, n_pairs).

    Raises ConvergenceError where an instant has no forces.
    """
    pairs = harmonics.shape[1]
    most = max(CELLS * len(harmonics), CELLS_OF_PAIR * pairs)
    count = 1 << (most - 1).bit_length()
    order = np.arange(len(harmonics))[:, None]
    waves = np.ascontiguousarray(harmonics, dtype=complex)
    values, rates = (
        np.ascontiguousarray(sampled(from_complex(wave), count))
        for wave in (waves, 1j * order * waves * (2.0 * np.pi / count))
    )
    room = np.empty(kernel.intervals_room(pairs))
    places = count + 8 * pairs
    while True:
        theta, closed = np.empty(places), np.empty((places, pairs), dtype=bool)
        found = kernel.intervals(
            contact.handle, pairs, len(waves) - 1, count, doubles(waves), doubles(values),
            doubles(rates), ROUNDING, places, doubles(theta), signs(closed), doubles(room),
        )  # fmt: skip
        if found >= 0:
            sets, which = unique_sets(closed[:found])
            return Intervals(theta[:found], which, sets)
        if found == NO_FORCES:
            raise ConvergenceError("contact: no forces were found at an instant of the period")
        places *= 2
