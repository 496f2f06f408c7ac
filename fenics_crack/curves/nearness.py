"""Whether exact orbits lie near enough to the points of a curve to judge them.

An orbit may be as far from its point as three times the point's estimated error, and no farther
than a tenth: an unknown estimate says nothing. It is made at some of the points in question, and
between two of these where the distance is not clearly on one side of what both allow.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from fenics_crack.curves.curve import ResponseCurve

__all__ = ["NO_DOUBT", "near_points"]

NO_DOUBT = 0.01
"""Distance of an orbit from its point at which the point's estimated error is not asked for."""
FARTHEST, BELIEVED = 0.1, 3.0
"""Distance from which on an orbit judges no point; and in parts of the estimated error."""
EVERY = 8
"""Points from one estimate to the next at most."""
CLEAR = 2.0
"""How much less or more than both of these allow a distance is clearly near or far."""


def near_points(
    curve: ResponseCurve, places: np.ndarray, orbit_gap: Callable[[int], np.ndarray]
) -> np.ndarray:
    """Of some points of a curve, ascending, which ones their orbits are near to: (n,) bool.

    ``orbit_gap``: gaps [m] of the orbit next to a point over the period, equally spaced, as many
    instants as :meth:`ResponseCurve.gaps_in_time` has or a multiple.
    """
    waves, clearance = curve.gaps_in_time(places), curve.structure.clearance
    off = np.zeros(len(places))
    for number, place in enumerate(map(int, places)):
        gap = orbit_gap(place)
        gap = gap[:: len(gap) // len(waves[number])]
        size = float(np.linalg.norm(gap + clearance))
        off[number] = np.linalg.norm(gap - waves[number]) / size if size > 0.0 else 0.0

    @cache
    def allowed(number: int) -> float:
        report = curve.solution(int(places[number]), search=False).report
        return max(NO_DOUBT, BELIEVED * (report.total - report.reduction))

    near = off <= NO_DOUBT
    asked = np.flatnonzero(~near & (off <= FARTHEST))
    for part in np.split(asked, np.flatnonzero(np.diff(places[asked]) > EVERY) + 1):
        spread = np.unique([*part[::EVERY], *part[-1:]])
        for number in part:
            after = int(np.searchsorted(spread, number))
            sides = [allowed(int(spread[side])) for side in {max(after - 1, 0), after}]
            least, most = min(sides) / CLEAR, CLEAR * max(sides)
            if least <= off[number] <= most:
                least = allowed(int(number))
            near[number] = off[number] <= least
    return near
