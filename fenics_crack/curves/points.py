"""Points of a curve: one as it comes, and all of them as columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_crack.numerics.fourier import resized

__all__ = ["CurvePoint", "columns"]


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


def columns(points: Sequence[CurvePoint]) -> dict[str, np.ndarray]:
    """What points are in a :class:`ResponseCurve`, all with the most harmonics."""
    counts = [len(point.unknown) // 2 for point in points]
    most = max(counts)
    unknowns = [
        point.unknown if count == most else resized(point.unknown, most)
        for point, count in zip(points, counts, strict=True)
    ]
    return {
        "values": np.array([point.value for point in points]),
        "omega": np.array([point.omega for point in points]),
        "unknowns": np.array(unknowns),
        "harmonics": np.array(counts),
        "iterations": np.array([point.iterations for point in points]),
        "truncation": np.array([point.truncation for point in points]),
    }
