"""The estimated error along a whole curve, from estimates at some of its points.

An estimate costs about as much as a point of the curve (:mod:`fenics_crack.balance.error_report`).
It is made at points spread evenly along the curve, then between neighbours on different sides of
the error beyond which a warning is due, so that the ends of the parts with a large error are found.
Elsewhere its logarithm is interpolated.
"""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.curves.curve import ResponseCurve

__all__ = ["displacement_errors"]

SPREAD, BISECTIONS = 40, 3
LEAST = 1e-12
"""Errors below it are taken for it, to have a logarithm."""


def displacement_errors(curve: ResponseCurve) -> np.ndarray:
    """Estimated error of the displacement at the load at every point of a curve: (n,) [-].

    Relative to the root mean square of that displacement, as ``displacement`` of
    :class:`fenics_crack.ErrorReport`.
    """
    known = curve.known_errors
    if not known:
        _estimate(curve, known)
    places = np.array(sorted(known))
    logarithms = np.log([known[place] for place in places])
    return np.asarray(np.exp(np.interp(np.arange(len(curve)), places, logarithms)))


def _estimate(curve: ResponseCurve, known: dict[int, float]) -> None:
    """Add the errors at points of the curve by their numbers."""
    places = np.unique(np.linspace(0, len(curve) - 1, SPREAD).astype(int))
    known.update({int(place): _error(curve, int(place)) for place in places})
    for _ in range(BISECTIONS):
        places = np.array(sorted(known))
        large = np.array([known[place] > LARGE_ERROR for place in places])
        apart = (large[1:] != large[:-1]) & (np.diff(places) > 1)
        for place in (places[:-1][apart] + places[1:][apart]) // 2:
            known[int(place)] = _error(curve, int(place))


def _error(curve: ResponseCurve, index: int) -> float:
    return max(curve.solution(index, search=False).report.displacement, LEAST)
