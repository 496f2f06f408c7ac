"""A whole curve in one call: over the frequency, over another parameter, or along a branch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypedDict, Unpack

from tqdm import tqdm

from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.continuation import Continuation
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.curves.exact import judge_curve
from fenics_crack.curves.resume import same_problem
from fenics_crack.errors import (
    ConvergenceError,
    InputError,
    check_count,
    check_omega,
    check_options,
)
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear, is_rigid
from fenics_crack.model.reduced import massless
from fenics_crack.model.structure import Structure

__all__ = ["CurveOptions", "continue_frequency", "continue_parameter", "follow_branch"]


class CurveOptions(TypedDict, total=False):
    """Options of :func:`continue_frequency` and :func:`continue_parameter`.

    harmonics, samples, subharmonic, initial
        As in :func:`solve_harmonic_balance`; ``initial`` is where to start.
    tolerance, stability, longest_step, most_points, turning_back
        As in :class:`Continuation`.
    resume
        Go on from the last point of a curve that did not reach its end. ``start`` is then its own,
        or for a branch ``start`` and ``end`` bound the parameter; harmonics, samples, subharmonic
        and initial are left out.
    """

    harmonics: int | None
    samples: int | None
    subharmonic: int
    initial: PeriodicSolution | None
    tolerance: float | None
    stability: bool
    longest_step: float
    most_points: int
    turning_back: float
    resume: ResponseCurve | None


def continue_frequency(
    structure: Structure,
    omega_start: float,
    omega_end: float,
    contact: ContactLaw,
    *,
    progress: bool = False,
    throw: bool = True,
    **options: Unpack[CurveOptions],
) -> ResponseCurve:
    """Follow the response from one load frequency to another, through resonances and folds.

    Parameters
    ----------
    structure : Structure
        What vibrates. One with many dofs is reduced first, to lips without mass
        (``reduce_structure(structure, method="massless")``).
    omega_start, omega_end : float
        Load frequencies [rad/s]; the end may be below the start.
    contact : ContactLaw
        Law of all pairs; :class:`UnilateralConstraint` where lips have no mass, or where modes
        above the harmonics move every pair by itself.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the end is not reached; else return what was found, ``complete`` being False.
        Ctrl-C always returns what was found.
    **options
        As :class:`CurveOptions` lists them: harmonics, samples, subharmonic, initial, tolerance,
        stability, longest_step, most_points, turning_back, resume.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached; what was found until then is its ``found``.
    """
    check_omega(omega_start, "omega_start")
    growing = _continuation(
        structure, omega_start, contact, ("omega", omega_start, omega_end), options
    )
    return _run(growing, progress, throw)


def continue_parameter(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    parameter: str,
    start: float,
    end: float,
    *,
    progress: bool = False,
    throw: bool = True,
    **options: Unpack[CurveOptions],
) -> ResponseCurve:
    """Follow the response at one load frequency over another parameter.

    Parameters
    ----------
    structure, contact, progress, throw, options
        As in :func:`continue_frequency`.
    omega : float
        Load frequency [rad/s].
    parameter : "load", "stiffness", "damping" or "clearance"
        As in :class:`Continuation`.
    start, end : float
        Its values.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached; what was found until then is its ``found``.
    """
    growing = _continuation(structure, omega, contact, (parameter, start, end), options)
    return _run(growing, progress, throw)


def follow_branch(
    curve: ResponseCurve,
    bifurcation: Bifurcation,
    start: float | None = None,
    end: float | None = None,
    *,
    progress: bool = False,
    throw: bool = True,
    **options: Unpack[CurveOptions],
) -> ResponseCurve:
    """Follow the branch that begins at a period doubling, or crosses at a branch point.

    The doubled branch has twice the period and twice as many harmonics. It is followed in one
    direction, until the parameter leaves the range or the branch joins the old one again; the
    other direction of a doubled branch is the same orbits half a period later.

    Parameters
    ----------
    curve : ResponseCurve
        The old branch.
    bifurcation : Bifurcation
        One of its bifurcations, of kind "period_doubling" or "branch_point".
    start, end : float, optional
        Range of the parameter; default: the curve's own.
    progress, throw, options
        As in :func:`continue_frequency`; harmonics, samples and subharmonic follow from the curve.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No branch was found, or its end was not reached; what was found is its ``found``.
    """
    kinds = ("period_doubling", "branch_point")
    if not isinstance(curve, ResponseCurve):
        raise InputError("curve", type(curve).__name__, "a ResponseCurve")
    if not isinstance(bifurcation, Bifurcation) or bifurcation.kind not in kinds:
        kind = getattr(bifurcation, "kind", type(bifurcation).__name__)
        raise InputError("bifurcation", kind, "a Bifurcation of kind " + " or ".join(kinds))
    check_options(options, CurveOptions.__annotations__)
    for key in ("harmonics", "samples", "subharmonic", "initial", "resume"):
        if key in options:
            raise InputError(key, options.get(key), "left out: it follows from the curve")
    doubled = 2 if bifurcation.kind == "period_doubling" else 1
    start = float(curve.values.min()) if start is None else start
    end = float(curve.values.max()) if end is None else end
    if not min(start, end) < bifurcation.value < max(start, end):
        raise InputError("start, end", (start, end), f"on either side of {bifurcation.value:g}")
    problem = replace(
        curve.problem,
        omega=bifurcation.omega,
        harmonics=doubled * (len(bifurcation.unknown) // 2),
        samples=curve.samples and doubled * curve.samples,
        subharmonic=doubled * curve.subharmonic,
    )
    given: dict[str, Any] = {**options, "initial": bifurcation}
    return _run(Continuation(problem, curve.parameter, start, end, **given), progress, throw)


def _continuation(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    span: tuple[str, float, float],
    options: CurveOptions,
) -> Continuation:
    """The continuation that options ask for, from the start or of an unfinished curve."""
    check_options(options, CurveOptions.__annotations__)
    given: dict[str, Any] = dict(options)
    resume = given.pop("resume", None)
    harmonics, samples = given.pop("harmonics", None), given.pop("samples", None)
    subharmonic = given.pop("subharmonic", 1)
    if resume is None:
        check_count("subharmonic", subharmonic, 1)
        harmonics = max(5, subharmonic) if harmonics is None else harmonics
        problem = Problem(structure, omega, contact, harmonics, samples, subharmonic)
        return Continuation(problem, *span, **given)
    wrong = {"samples": samples, "initial": given.pop("initial", None), "harmonics": harmonics}
    wrong["subharmonic"] = None if subharmonic == 1 else subharmonic
    for key, value in wrong.items():
        if value is not None:
            raise InputError(key, value, "left out where a curve is resumed")
    problem = same_problem(resume, structure, omega, contact)
    return Continuation(problem, *span, initial=resume, **given)


def _is_judged(curve: ResponseCurve) -> bool:
    """Whether a curve with multipliers is judged by exact orbits at once: over the load frequency,
    with pairs that are seen through a static compliance, and a law that these can take."""
    in_time = is_piecewise_linear(curve.contact) or is_rigid(curve.contact)
    coupled = massless(curve.structure) is not None and curve.static_above is not None
    return curve.parameter == "omega" and coupled and in_time


def _run(growing: Continuation, progress: bool, throw: bool) -> ResponseCurve:
    """Follow to the end."""
    hidden = not progress or growing.curve.structure.whole.comm.rank != 0
    bar = tqdm(total=100.0, desc="curve", unit="%", disable=hidden, bar_format="{l_bar}{bar}")
    try:
        for _ in growing:
            if not hidden:
                bar.update(max(0.0, 100.0 * growing.progress() - bar.n))
    except KeyboardInterrupt:
        growing.status, throw = "interrupted", False
    except ConvergenceError as error:
        growing.status = str(error)
    finally:
        bar.close()
    curve = growing.curve
    if curve.multipliers is not None and _is_judged(curve):
        curve = judge_curve(curve)
    if throw and not curve.complete:
        raise ConvergenceError(
            f"curve in {curve.parameter} from {curve.values[0]:g}: {curve.status} at "
            f"{curve.values[-1]:g} after {len(curve)} points; they are the error's .found",
            found=curve,
        )
    return curve
