"""Verdicts of the points of a harmonic-balance curve: by their nearest exact orbits, or by
the flow linearised along them.

Each point is assessed as a single solution is (:mod:`fenics_crack.balance.assessment`); its folds
and branch points are those of its own equations. Where none of its first, middle and last point has
an orbit of its own, none is sought at the others: the curve costs what its harmonic balance costs.

With laws without an exact flow it is the linearised flow. Period doublings and Neimark-Sacker
points are bifurcations of exact orbits (:mod:`orbit_events`); harmonic balance has none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.assessment import MAX_ERROR
from fenics_crack.basics.errors import check_kind
from fenics_crack.basics.progress import begin
from fenics_crack.curves.curve import leading
from fenics_crack.curves.harmonic_curve import HarmonicCurve
from fenics_crack.curves.stability import floquet, stability_of
from fenics_crack.model.contact import is_unilateral


def judge_curve(curve: HarmonicCurve) -> HarmonicCurve:
    """Assess the points of a curve over any parameter by their nearest exact orbits.

    Laws that are not linear in contact have no exact orbits: their points are assessed as
    :func:`floquet` does.

    Parameters
    ----------
    curve : HarmonicCurve
        Followed with or without ``stability=True``.

    Returns
    -------
    HarmonicCurve
        The same points, with the multipliers of their orbits; "undecided" (and nan) where the
        predicted error is above 0.1, or no orbit is nearer than that and three times what is
        predicted.

    Raises
    ------
    InputError
        As :func:`fenics_crack.shoot`.

    Examples
    --------
    >>> judged = fc.judge_curve(curve)
    >>> verdicts = judged.verdicts
    """
    check_kind("curve", curve, HarmonicCurve)
    if not is_unilateral(curve.contact):
        begin("stability of each point")
        solutions = (curve.solution(place, search=False) for place in range(len(curve)))
        found = [floquet(one.structure, one) for one in solutions]
        return replace(
            curve,
            multipliers=np.array([leading(one.multipliers) for one in found]),
            undecided=np.array([one.verdict == "undecided" for one in found]),
        )
    begin("stability by exact orbits")
    multipliers = np.full(len(curve), np.nan + 0j)
    first = {0, len(curve) // 2, len(curve) - 1}
    if any([_decides(curve, place, multipliers) for place in first]):
        for place in {*range(len(curve))} - first:
            _decides(curve, place, multipliers)
    return replace(curve, multipliers=multipliers, undecided=np.isnan(multipliers))


def _decides(curve: HarmonicCurve, place: int, multipliers: np.ndarray) -> bool:
    """Assess a point, whose leading multiplier is set; True if that is decided."""
    known = curve.assessment(place)
    if not known.predicted_error <= MAX_ERROR:  # no orbit would be its own
        return False
    found = stability_of(known)
    if found.verdict == "undecided":
        return False
    multipliers[place] = leading(found.multipliers)
    return True
