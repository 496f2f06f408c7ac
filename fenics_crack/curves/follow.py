"""A whole curve in one call: over the frequency, over another parameter, or along a branch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from fenics_crack.balance.problem import MAX_UNKNOWNS_PER_CALL, Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import (
    INTERRUPTED,
    ConvergenceError,
    InputError,
    check_count,
    check_omega,
)
from fenics_crack.basics.progress import begin, reaching
from fenics_crack.basics.suggestions import check_options
from fenics_crack.curves.continuation import Continuation, GrowingCurve, StepOptions, has_orbits
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import PeriodicOrbit

MAX_CURVE_SEARCHES = 4
"""Places, from the end on, from which another curve is sought that leads to the start."""
PROGRESS_BAR_FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
"""Progress bar of a curve; its remaining time does not follow from its progress."""


class CurveOptions(StepOptions, total=False):
    """Options of :func:`.continue_frequency` and :func:`.continue_parameter`.

    harmonics, samples, subharmonic, initial
        As in :func:`.solve_harmonic_balance`; ``initial`` is where to start.
    tolerance
        In place of ``harmonics`` and ``samples``: follow exact orbits, whose solutions are kept
        to this error. Where their flow is not known, as for smooth laws, or they
        would take too long, with more than 120 modes or under a very slow load: harmonic balance
        with as many harmonics as the truncation error of the first point requires.
    stability, longest_step, most_points, turning_back
        As in :class:`.Continuation`; exact orbits always have their stability.
    """

    harmonics: int | None
    samples: int | None
    subharmonic: int
    initial: PeriodicSolution | None
    tolerance: float | None
    stability: bool


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

    Where the first solution found lies on a closed loop, or on a curve that turns back past its
    start, another one is looked for by following the curve from its end, or from between, which its
    status says; what came back is the result only where that fails too, or would take long, or
    where ``initial`` is given.

    Parameters
    ----------
    structure : Structure
        Structure that vibrates. One with many dofs is reduced first, to crack faces without mass
        (``reduce_structure(structure, method="massless")``).
    omega_start, omega_end : float
        Load frequencies [rad/s]; the end may be below the start.
    contact : ContactLaw
        Law of all pairs; :class:`UnilateralConstraint` where crack faces have no mass, or where
        modes above the harmonics move every pair by itself.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the end is not reached; else return what was found, ``complete`` being False.
        Ctrl-C always returns what was found.
    **options
        As :class:`.CurveOptions` lists them: harmonics, samples, subharmonic, initial, tolerance,
        stability, longest_step, most_points, turning_back.

    Returns
    -------
    ResponseCurve
        From the start on; ``complete`` if it reached the end; ``exact`` with a ``tolerance``.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached; what was found until then is its ``found``.

    Examples
    --------
    >>> curve = fc.continue_frequency(structure, 1900.0, 2100.0, contact, harmonics=5)
    """
    check_options("continue_frequency", options, CurveOptions.__annotations__)
    check_omega(omega_start, "omega_start")
    return continue_parameter(
        structure, omega_start, contact, "omega", omega_start, omega_end,
        progress=progress, throw=throw, **options,
    )  # fmt: skip


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
    """Follow the response at one load frequency over another parameter; or in a run-up.

    Parameters
    ----------
    structure, contact, progress, throw, **options
        As in :func:`continue_frequency`.
    omega : float
        Load frequency [rad/s].
    parameter : "load", "stiffness", "damping", "clearance", "friction" or "speed"
        As in :class:`Continuation`. With "speed" the structure is one of
        :func:`fenics_crack.run_up_structure`; the load's frequency stays in the ratio to the speed
        that ``omega`` has to the structure's own: that is the engine order.
    start, end : float
        Its values.

    Returns
    -------
    ResponseCurve
        From the start on; ``complete`` if it reached the end; ``exact`` with a ``tolerance``.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached; what was found until then is its ``found``.

    Examples
    --------
    >>> curve = fc.continue_parameter(
    ...     structure, 2000.0, contact, "load", 1.0, 2.0, harmonics=5)
    """
    check_options("continue_parameter", options, CurveOptions.__annotations__)
    curve_options: dict[str, Any] = dict(options)
    keys = ("harmonics", "samples", "subharmonic", "initial")
    harmonics, samples, subharmonic, initial = (curve_options.pop(key, None) for key in keys)
    tolerance = curve_options.get("tolerance")
    if tolerance is not None and harmonics is not None:
        raise InputError("tolerance", tolerance, "left out where harmonics are given")
    if tolerance is not None and not is_small(structure):
        structure = reduce_structure(structure, method="massless")
    subharmonic = 1 if subharmonic is None else subharmonic
    check_count("subharmonic", subharmonic, 1)
    if harmonics is None:
        harmonics = max(Problem.harmonics, least_harmonics(structure, subharmonic))
    problem = Problem(structure, omega, contact, harmonics, samples, subharmonic)
    is_exact = (
        tolerance is not None and samples is None and has_orbits(problem, parameter, start, end)
    )

    def grow(curve_start: float, curve_end: float, first_guess: Any = initial) -> GrowingCurve:
        ends, guess = (curve_start, curve_end), first_guess
        return Continuation(
            problem, parameter, *ends, exact=is_exact, initial=guess, **curve_options
        )

    def follow_other_curve(returned_curve: GrowingCurve | None = None) -> GrowingCurve | None:
        return _find_other_curve(grow, start, end, returned_curve) if initial is None else None

    try:
        growing_curve = grow(start, end)
    except ConvergenceError:
        other_curve = None if tolerance is None else follow_other_curve()
        if other_curve is None:
            raise
        growing_curve = other_curve
    return run_to_end(growing_curve, progress, throw, follow_other_curve)


def _find_other_curve(
    grow: Callable[..., GrowingCurve], start: float, end: float, first_curve: GrowingCurve | None
) -> GrowingCurve | None:
    """Follow another curve from the start, in as many points as one before has or is soon to have.

    Its solution at the start is met by following one from the end, or from between. It is needed
    where the first solution lies on a curve that comes back to the start, such as a closed loop of
    the truncated equations, or where there is none.
    """
    n_spent_points, n_first_points = 0, 0 if first_curve is None else len(first_curve.points)
    # If there is no orbit at the start, each search takes long.
    n_searches = MAX_CURVE_SEARCHES if first_curve is not None else 1
    search_values = np.linspace(end, start, MAX_CURVE_SEARCHES, endpoint=False)[:n_searches]
    for search_value in search_values.tolist():
        start_solution: PeriodicSolution | PeriodicOrbit | None = None
        for stage_start, stage_end in ((search_value, start), (start, end)):
            try:
                growing_curve = grow(stage_start, stage_end, start_solution)
                max_unknowns = 2 * MAX_CURVE_SEARCHES * MAX_UNKNOWNS_PER_CALL
                max_points = max(n_first_points, max_unknowns // growing_curve.system.size)
                n_left_points = max(1, max_points - n_spent_points)
                growing_curve.most_points = min(n_left_points, growing_curve.most_points)
                growing_curve.run()
            except ConvergenceError:
                break
            n_spent_points += len(growing_curve.points)
            if not growing_curve.complete or growing_curve.returned:
                break
            curve = growing_curve.unjudged_curve
            start_solution = curve.orbit(-1) if curve.exact else curve.solution(-1)
        else:
            growing_curve.status += ", not by the first solution found at its start"
            return growing_curve
    return None


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

    The doubled branch has twice the period, and of harmonic balance twice as many harmonics. It is
    followed in one direction, until the parameter leaves the range or the branch joins the old one
    again; the other direction of a doubled branch is the same orbits half a period later.

    Parameters
    ----------
    curve : ResponseCurve
        The old branch.
    bifurcation : Bifurcation
        One of its bifurcations, of kind "period_doubling" or "branch_point".
    start, end : float, optional
        Range of the parameter; default: the curve's own.
    progress, throw, **options
        As in :func:`continue_frequency`; harmonics, samples, subharmonic and tolerance follow from
        the curve.

    Returns
    -------
    ResponseCurve
        Of twice the period from a period doubling, else of the same.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No branch was found, or its end was not reached; what was found is its ``found``.

    Examples
    --------
    >>> branch = fc.follow_branch(doubling, doubling.bifurcations[0])
    """
    kinds = ("period_doubling", "branch_point")
    if bifurcation.kind not in kinds:
        requirement = "a Bifurcation of kind " + " or ".join(kinds)
        raise InputError("bifurcation", bifurcation.kind, requirement)
    check_options("follow_branch", options, CurveOptions.__annotations__)
    for key in ("harmonics", "samples", "subharmonic", "initial", "tolerance"):
        if key in options:
            raise InputError(key, options.get(key), "left out: it follows from the curve")
    start = float(curve.values.min()) if start is None else start
    end = float(curve.values.max()) if end is None else end
    if not min(start, end) < bifurcation.value < max(start, end):
        raise InputError("start, end", (start, end), f"on either side of {bifurcation.value:g}")
    period_factor = 2 if bifurcation.kind == "period_doubling" else 1
    problem = replace(
        curve.problem,
        harmonics=period_factor * curve.problem.harmonics,
        samples=curve.problem.samples and period_factor * curve.problem.samples,
        subharmonic=period_factor * curve.subharmonic,
    )
    growing_curve = Continuation(
        problem, curve.parameter, start, end,
        exact=curve.exact, initial=bifurcation, branch_of=curve, **options,  # type: ignore[misc]
    )  # fmt: skip
    return run_to_end(growing_curve, progress, throw)


def run_to_end(
    growing_curve: GrowingCurve,
    progress: bool,
    throw: bool,
    find_other_curve: Callable[[GrowingCurve], GrowingCurve | None] | None = None,
) -> ResponseCurve:
    """Follow to the end, where the curve comes back to its start from another solution there; the
    curve, assessed if requested, but not after Ctrl-C."""
    try:
        try:
            _run_with_progress(growing_curve, progress)
            if find_other_curve is not None and growing_curve.returned:
                other_curve = find_other_curve(growing_curve)
                if other_curve is None and not growing_curve.complete:
                    growing_curve.status += " (no other curve was met from its end on)"
                growing_curve = other_curve or growing_curve
        except ConvergenceError as error:
            growing_curve.status = str(error)
        curve = growing_curve.curve
    except KeyboardInterrupt:  # which ends the verdicts, too
        throw, growing_curve.status = False, INTERRUPTED
        curve = growing_curve.unjudged_curve
    if throw and not curve.complete:
        curve_words = f"curve in {curve.parameter} from {curve.values[0]:g}"
        end_words = f"{curve.status} at {curve.values[-1]:g} after {len(curve)} points"
        raise ConvergenceError(
            f"{curve_words}: {end_words}; they are the error's .found", found=curve
        )
    return curve


def _run_with_progress(growing_curve: GrowingCurve, progress: bool) -> None:
    """Follow to the end with a bar, or signs of life."""
    if not progress or growing_curve.system.problem.structure.whole.comm.rank != 0:
        begin("curve")
        with reaching(growing_curve.describe_progress):
            growing_curve.run()
        return
    begin("")
    from tqdm import tqdm

    with tqdm(total=100, desc="curve", unit="%", bar_format=PROGRESS_BAR_FORMAT) as bar:
        for _ in growing_curve:
            bar.set_postfix_str(growing_curve.describe_values(), refresh=False)
            bar.update(max(0, int(100.0 * growing_curve.progress()) - bar.n))
