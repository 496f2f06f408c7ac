"""Points of a curve: one as it comes, and all of them as columns."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fenics_crack.numerics.fourier import resized

__all__ = ["CurvePoint", "Points"]


@dataclass(frozen=True)
class CurvePoint:
    """A point of a curve as it comes.

    Attributes
    ----------
    value, omega : float
        Of the parameter, and load frequency [rad/s].
    unknown : (2H+1, n_pairs) [m]
        Gap coefficients, or the slow gap's (``ResponseCurve.unknowns``).
    iterations : int
        Newton iterations.
    truncation : float
        Estimated error of the harmonics left out, or nan where it was not estimated.
    bifurcations : tuple of (str, float)
        Kinds and parameters of the special points since the point before.
    """

    value: float
    omega: float
    unknown: np.ndarray
    iterations: int
    truncation: float = math.nan
    bifurcations: tuple[tuple[str, float], ...] = ()


class Points:
    """All points of a curve so far, as columns.

    Attributes
    ----------
    values, omega, iterations, truncation : lists
        As those of :class:`CurvePoint`.
    """

    def __init__(self) -> None:
        self.values: list[float] = []
        self.omega: list[float] = []
        self.iterations: list[int] = []
        self.truncation: list[float] = []
        self._unknowns: list[np.ndarray] = []  # each of some points: (n, 2H+1, n_pairs)

    def __len__(self) -> int:
        return len(self.values)

    def append(self, point: CurvePoint) -> None:
        """One more."""
        self.extend([point.value], [point.omega], point.unknown[None], [point.iterations])
        self.truncation[-1] = point.truncation

    def extend(
        self,
        values: Iterable[float],
        omega: Iterable[float],
        unknowns: np.ndarray,
        iterations: Iterable[int],
    ) -> None:
        """More, with unknowns (n, 2H+1, n_pairs)."""
        self.values += values
        self.omega += omega
        self.iterations += iterations
        self.truncation += [math.nan] * len(unknowns)
        self._unknowns.append(unknowns)

    @property
    def last(self) -> CurvePoint:
        """The last one."""
        return CurvePoint(
            self.values[-1], self.omega[-1], self._unknowns[-1][-1], self.iterations[-1],
            self.truncation[-1],
        )  # fmt: skip

    def columns(self) -> dict[str, np.ndarray]:
        """What they are in a :class:`ResponseCurve`, all with the most harmonics."""
        counts = [block.shape[1] // 2 for block in self._unknowns]
        most = max(counts)
        unknowns = [
            block if count == most else np.array([resized(one, most) for one in block])
            for block, count in zip(self._unknowns, counts, strict=True)
        ]
        return {
            "values": np.array(self.values),
            "omega": np.array(self.omega),
            "unknowns": np.concatenate(unknowns),
            "harmonics": np.repeat(counts, [len(block) for block in self._unknowns]),
            "iterations": np.array(self.iterations),
            "truncation": np.array(self.truncation),
        }
