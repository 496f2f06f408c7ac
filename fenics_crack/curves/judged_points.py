"""Verdicts along a curve over any parameter, point by point, as a solution is judged.

At each of its points the structure and the law are ordinary ones, and :func:`floquet` judges the
solution by an orbit of the flow in time next to it. Between two points a bifurcation lies where

    r = number of real mu > 1,    d = number of real mu < -1,    c = pairs with |mu| > 1

of these orbits changes by an odd number: r at a fold (or a branch point), d at a period doubling, c
at a Neimark-Sacker point. So the orbits confirm a bifurcation of the truncated equations where the
count of its kind differs between the nearest points on either side that are decided; its place is
interpolated between four of them, at the zero of det(I - M), of det(I + M), or of |mu| - 1.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.stability.floquet import floquet

__all__ = ["judge_points"]

FARTHEST = 3
"""Points from a bifurcation within which the orbits must change."""
KINDS = ("fold", "period_doubling", "neimark_sacker")


def judge_points(curve: ResponseCurve, places: list[int]) -> ResponseCurve:
    """The same curve with the verdicts of :func:`floquet` at its points; its bifurcations stay
    those of the truncated equations, each with the place of the orbits' one that confirms it.

    Parameters
    ----------
    curve : ResponseCurve
        Over any parameter.
    places : list of int
        The points nearest to its bifurcations.
    """
    multipliers = np.full(len(curve), np.nan + 0j)
    undecided, tests = np.ones(len(curve), dtype=bool), np.full((len(curve), 3), np.nan)
    counts = np.zeros((len(curve), 3), dtype=int)
    for index in range(len(curve)):
        solution = curve.solution(index)
        found = floquet(solution.structure, solution)
        value = complex(found.multipliers[0])
        multipliers[index] = complex(value.real, abs(value.imag))
        undecided[index] = found.verdict == "undecided"
        counts[index], tests[index] = _outside(found.multipliers)
    special = [
        replace(one, exact=_crossing(curve, one, place, ~undecided, counts, tests))
        for one, place in zip(curve.bifurcations, places, strict=True)
    ]
    return replace(curve, bifurcations=tuple(special), multipliers=multipliers, undecided=undecided)


def _outside(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """r, d and c of multipliers; and what vanishes where they change: det(I - M), det(I + M), and
    |mu| - 1 of the farthest pair."""
    real, pairs = values.real[values.imag == 0.0], np.abs(values[values.imag > 0.0])
    counts = [int(np.sum(part > 1.0)) for part in (real, -real, pairs)]
    farthest = float(pairs.max()) - 1.0 if len(pairs) else np.nan
    tests = [np.prod(1.0 - values).real, np.prod(1.0 + values).real, farthest]
    return np.array(counts), np.array(tests)


def _crossing(
    curve: ResponseCurve,
    one: Bifurcation,
    place: int,
    decided: np.ndarray,
    counts: np.ndarray,
    tests: np.ndarray,
) -> float:
    """The parameter where the orbits have a bifurcation; nan where they do not."""
    if one.kind not in KINDS:
        return float("nan")
    kind = KINDS.index(one.kind)
    near = np.arange(max(0, place - FARTHEST), min(len(curve), place + FARTHEST + 1))
    near = near[decided[near]]
    ends = [
        (abs(first + last - 2 * place), first, last)
        for first, last in pairwise(near)
        if (counts[last, kind] - counts[first, kind]) % 2
    ]
    if not ends:
        return float("nan")
    _, first, last = min(ends)
    # The parameter over what vanishes: a parabola at a fold.
    chosen = [*near[near <= first][-2:], *near[near >= last][:2]]
    while len(chosen) > 2 and not _rises(tests[chosen, kind]):
        chosen = chosen[1:-1] if len(chosen) > 3 else [first, last]
    if not _rises(tests[chosen, kind]):
        return float(0.5 * (curve.values[first] + curve.values[last]))
    return float(BarycentricInterpolator(tests[chosen, kind], curve.values[chosen])(0.0))


def _rises(tests: np.ndarray) -> bool:
    """Whether values are known, and go one way from one sign to the other."""
    steps = np.diff(tests)
    one_way = bool(np.all(steps > 0.0) or np.all(steps < 0.0))
    return one_way and bool(tests[0] * tests[-1] < 0.0)
