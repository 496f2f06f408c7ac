"""Displacements of a tip at probes: what they tell whatever the load's size and phase are.

Under a steady load the tip is, at a phase theta of the load's period,

    u = A Re sum_k U_k exp(i k (theta - psi)) + c,

with the harmonics U_k of the model and what nobody knows well of a blade in operation: the size A
and the phase psi of the load, and a constant c, of the probes' angles and of the steady forces. For
each value of the unknowns the three are fitted to the displacements; the predictions are the fit,
and the likelihood gets their derivatives by the three as directions in which all displacements may
be moved together. That is a fit of three numbers by the model's own wave, of all its harmonics, in
place of one of a few harmonics beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_crack.identification.measurements import Measurement

__all__ = ["Aligned", "Passages"]

TRIED = 64
"""Phases of the load that are tried."""
STEPS = 4
"""Of Gauss and Newton from the best of them."""
SIZE, PHASE, CONSTANT = 1.0, np.pi / np.sqrt(3.0), 10.0
"""Standard deviations of what is not known: of the load's size over what is found, of its phase
[rad], and of the constant over the largest displacement."""


@dataclass(frozen=True)
class Aligned:
    """Displacements (m, n) of a model, fitted to those measured.

    Attributes
    ----------
    values : (m, n) [m]
        All of them; those that were not measured, too.
    turns : (m, n, K) complex
        Their slopes by the harmonics U_k: values = Re sum_k turns_k U_k + c.
    free : (m, n, 3) [m]
        Their changes by a standard deviation of A, psi and c.
    size : (m,)
        A.
    """

    values: np.ndarray
    turns: np.ndarray
    free: np.ndarray
    size: np.ndarray


class Passages:
    """Displacements of one point under one load.

    Parameters
    ----------
    rows : sequence of int
        Their places among all measurements; first those that were made.
    made : sequence of Measurement
        Those that were made.
    more : sequence of Measurement
        Those that might be.
    """

    def __init__(
        self, rows: Sequence[int], made: Sequence[Measurement], more: Sequence[Measurement]
    ) -> None:
        self.rows = list(rows)
        self._phases = np.array([row.phase for row in (*made, *more)])
        self._count = len(made)
        self._values = np.array([row.value for row in made])
        self._weights = 1.0 / np.array([row.deviation for row in made])

    @classmethod
    def among(cls, made: Sequence[Measurement], more: Sequence[Measurement]) -> list[Passages]:
        """Those of each load and point among some measurements."""
        groups: dict[tuple[float, str], list[int]] = {}
        rows = (*made, *more)
        for place, row in enumerate(rows):
            if row.quantity == "displacement":
                groups.setdefault((row.frequency, row.point), []).append(place)
        found = []
        for places in groups.values():
            mine = [rows[place] for place in places if place < len(made)]
            found.append(cls(places, mine, [rows[place] for place in places[len(mine) :]]))
        return found

    def beyond(self, last: int) -> np.ndarray:
        """Displacements by the parts of the two harmonics above the last, together of size 1 at
        any phase: (n, 4)."""
        angles = np.multiply.outer(self._phases, [last + 1, last + 2])
        return np.hstack([np.cos(angles), np.sin(angles)]) / np.sqrt(2.0)

    def aligned(self, waves: np.ndarray) -> Aligned:
        """The displacements of harmonics U_k: (m, K) [m]."""
        orders = np.arange(1, waves.shape[1] + 1)
        turns = np.exp(1j * np.multiply.outer(self._phases, orders))
        size, shift, constant = np.ones(len(waves)), np.zeros(len(waves)), np.zeros(len(waves))
        if self._count:
            size, shift, constant = self._fitted(waves, turns[: self._count], orders)
        turned = turns * (size[:, None] * np.exp(-1j * np.outer(shift, orders)))[:, None, :]
        parts = turned * waves[:, None, :]
        motion = parts.sum(axis=2).real
        largest = CONSTANT * np.max(np.abs(self._values), initial=0.0)
        free = np.stack(
            [
                SIZE * motion,
                PHASE * (orders * parts).sum(axis=2).imag,
                np.full_like(motion, largest),
            ],
            axis=2,
        )
        return Aligned(motion + constant[:, None], turned, free, size)

    def _fitted(
        self, waves: np.ndarray, turns: np.ndarray, orders: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Least squares of A > 0, psi and c: (m,) each."""
        tried = 2.0 * np.pi * np.arange(TRIED) / TRIED
        shifted = waves[:, None, :] * np.exp(-1j * np.multiply.outer(tried, orders))
        motion = (shifted @ turns.T).real  # (m, tried, n)
        share = self._weights**2 / np.sum(self._weights**2)
        values = self._values - share @ self._values
        about = motion - (motion @ share)[..., None]
        product = about @ (share * values)
        square = np.maximum((about**2) @ share, np.finfo(float).tiny)
        gained = np.where(product > 0.0, product**2 / square, 0.0)
        best = gained.argmax(axis=1)
        each = np.arange(len(waves))
        size, shift = product[each, best] / square[each, best], tried[best]
        constant = share @ self._values - size * (motion[each, best] @ share)
        for _ in range(STEPS):
            parts = waves[:, None, :] * turns * np.exp(-1j * np.outer(shift, orders))[:, None, :]
            motion = parts.sum(axis=2).real
            slope = size[:, None] * (orders * parts).sum(axis=2).imag
            left = self._weights * (self._values - size[:, None] * motion - constant[:, None])
            scale = np.array([1.0, 1.0, np.max(np.abs(self._values)) + np.finfo(float).tiny])
            columns = np.stack([motion * size[:, None], slope, np.ones_like(motion)], axis=2)
            columns = columns * scale * self._weights[:, None]
            square = columns.transpose(0, 2, 1) @ columns + 1e-3 * np.eye(3)
            step = np.linalg.solve(square, columns.transpose(0, 2, 1) @ left[..., None])[..., 0]
            size = size * np.exp(np.clip(step[:, 0], -1.0, 1.0))
            shift = shift + np.clip(step[:, 1], -0.1, 0.1)
            constant = constant + scale[2] * step[:, 2]
        return size, shift, constant
