"""Going on with a curve that has not reached its end, from a file for instance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fenics_crack.balance.family import Family
from fenics_crack.balance.problem import Problem
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.bordered import PathPoint, Tangent, point_on_path
from fenics_crack.numerics.fourier import resized

__all__ = ["check_resumed", "chord", "directions", "same_problem"]

UNFINISHED = "a ResponseCurve that is not complete"


def same_problem(
    curve: ResponseCurve, structure: Structure, omega: float, contact: ContactLaw
) -> Problem:
    """The problem of a curve to be resumed, with its structure and law given anew."""
    if not isinstance(curve, ResponseCurve):
        raise InputError("resume", type(curve).__name__, UNFINISHED)
    return replace(curve.problem, structure=structure, omega=omega, contact=contact)


def check_resumed(curve: ResponseCurve, family: Family) -> None:
    """Raise InputError unless a curve is not complete and a family goes on where it ends."""
    if curve.complete:
        raise InputError("resume", type(curve).__name__, UNFINISHED)
    span = family.start, family.end
    pairs = family.problem.structure.n_pairs
    if curve.structure.n_pairs != pairs or curve.parameter != family.name:
        raise InputError("resume", f"curve in {curve.parameter}", "a curve of this problem")
    first, last = float(curve.values[0]), float(curve.values[-1])
    if curve.branch:
        if not min(span) < last < max(span):
            raise InputError("start, end", span, f"on either side of {last:g}")
    elif not math.isclose(span[0], first, rel_tol=1e-9):
        raise InputError("start", span[0], f"where the resumed curve starts, {first:g}")
    unknown, parameter = curve.unknown(-1), family.parameter(last)
    residual = float(np.linalg.norm(family.linearise(unknown, parameter).residual))
    if not residual <= max(1e-6, family.rounding(parameter)) * np.linalg.norm(unknown):
        raise InputError("resume", "a curve of another problem", "of this structure and law")


def directions(family: Family, curve: ResponseCurve) -> tuple[Tangent | None, PathPoint | None]:
    """Where a curve goes on from its last point, and its first point as :mod:`path` has it.

    The latter only where both have the same harmonics.
    """
    if len(curve) < 2:
        return None, None
    towards, origin = chord(family, curve, -2, -1), None
    if len(curve.unknown(0)) == len(curve.unknown(-1)):
        away = chord(family, curve, 0, 1)
        parameter = family.parameter(float(curve.values[0]))
        origin = point_on_path(family, curve.unknown(0), parameter, away)
    return towards, origin


def chord(family: Family, curve: ResponseCurve, first: int, second: int) -> Tangent:
    """From one point of a curve to another."""
    after = curve.unknown(second)
    before = resized(curve.unknown(first), len(after) // 2)
    rise = family.parameter(float(curve.values[second])) - family.parameter(
        float(curve.values[first])
    )
    return Tangent(after - before, rise, 1.0 / max(float(np.vdot(after, after)), 1e-300))
