"""Motion while no pair opens or closes: linear, in closed form.

The modal coordinates z = (s q, q') of a small structure obey, with one set of closed pairs,

    z(t) = z_p(t) + V exp(L (t - t0)) V^-1 (z0 - z_p(t0)),

z_p the steady response to the load with these pairs closed. V is the real basis of the flow's
eigenvectors: real and imaginary parts of those that turn, in which exp(L t) are decaying rotations.
The next instant at which a pair opens or closes is bracketed on a grid that resolves the fastest
mode, which also shows extremes between its points, and polished by Newton's method in the bracket
(``kernel/events.c``). The error is that of the roots, about 1e-12.
"""

from __future__ import annotations

import numpy as np

from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import Struct, doubles, table
from fenics_crack.model.modal import AllModes, flow_matrix
from fenics_crack.model.structure import Structure

__all__ = ["FreeMotion", "Regime"]


class FreeMotion:
    """What does not depend on the load's frequency with a set of closed pairs (n_pairs,): the flow
    z' = A z (``matrix``), its basis V (``vectors``), and the response q to the mean load
    (``static``)."""

    def __init__(
        self, structure: Structure, modes: AllModes, stiffness: np.ndarray, scale: float
    ) -> None:
        count = len(modes.squares)
        self.matrix = flow_matrix(modes, stiffness, scale)
        values, vectors = np.linalg.eig(self.matrix)
        mean = structure.force[0] @ modes.shapes + modes.pairs @ (stiffness * structure.clearance)
        self.static = np.linalg.lstsq(-scale * self.matrix[count:, :count], mean, rcond=None)[0]
        turning, still = np.flatnonzero(values.imag > 0.0), np.flatnonzero(values.imag == 0.0)
        turned = vectors[:, turning]
        self.vectors = np.ascontiguousarray(
            np.hstack([turned.real, turned.imag, vectors[:, still].real])
        )
        try:
            self.inverse = np.linalg.inv(self.vectors)
        except np.linalg.LinAlgError:
            raise ConvergenceError("events: a mode with exactly critical damping") from None
        self.turn = values[turning].imag.copy()
        decay = values[turning].real
        self.decay = np.concatenate([decay, decay, values[still].real])
        fastest = np.abs(values.imag).max() or np.abs(values).max()
        self.step = 2.0 * np.pi / fastest / 12.0
        """A twelfth of the period of the fastest mode [s]."""
        # Signed gaps, their slopes and curvatures, from the weights.
        self.side = np.where(stiffness > 0.0, -1.0, 1.0)
        rows = self.side[:, None] * (modes.pairs.T / scale) @ self.vectors[:count]
        slopes = self._slopes(rows)
        self.gaps = np.array([rows, slopes, self._slopes(slopes)])
        """(3, n_pairs, 2n)"""
        self.into: dict[int, np.ndarray] = {}
        """V_s^-1 V by the pair in which the set s differs: (2n, 2n), where it is known."""

    def _slopes(self, rows: np.ndarray) -> np.ndarray:
        """Rows times L."""
        turning = len(self.turn)
        found = rows * self.decay
        found[:, :turning] -= rows[:, turning : 2 * turning] * self.turn
        found[:, turning : 2 * turning] += rows[:, :turning] * self.turn
        return found


class Regime:
    """The flow with one set of closed pairs under the load: z_p = mean + c cos(wt) + s sin(wt),
    where the kernel makes c and s for a frequency."""

    def __init__(
        self, free: FreeMotion, structure: Structure, modes: AllModes, scale: float
    ) -> None:
        self._free = free
        count = len(modes.squares)
        mean = np.concatenate([scale * free.static, np.zeros(count)])
        load = np.vstack([np.zeros((count, 2)), (structure.force[1:] @ modes.shapes).T])
        self.steady = np.zeros((3, 2 * count))
        """mean, c, s: (3, 2n)"""
        self.steady[0] = mean
        forced = np.zeros((structure.n_pairs, 3))
        forced[:, 0] = free.side * (modes.pairs.T @ mean[:count] / scale - structure.clearance)
        self.known = Struct(
            "regime", size=2 * count, turning=len(free.turn), decay=free.decay, turn=free.turn,
            vectors=free.vectors, inverse=free.inverse, steady=self.steady, free=free.gaps,
            load=np.ascontiguousarray((free.inverse @ load).T), forced=forced, step=free.step,
            omega=np.nan, into=table("double", structure.n_pairs),
        )  # fmt: skip

    def change_into(self, other: Regime, pair: int) -> None:
        """Keep what turns weights into those of another regime, which differs in one pair."""
        known = self._free.into
        if pair not in known:
            known[pair] = other._free.inverse @ self._free.vectors
        self.known.at.into[pair] = doubles(known[pair])

    def sampled(self, rows: np.ndarray, weights: np.ndarray, waves: np.ndarray) -> np.ndarray:
        """``rows @ z`` from weights (m, 2n) and waves 1, cos, sin of the load (m, 3)."""
        found: np.ndarray = weights @ (rows @ self._free.vectors).T
        return found + waves @ (self.steady @ rows.T)
