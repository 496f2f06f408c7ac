"""Whole curves in one call: over the frequency, over another parameter, or along a branch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from fenics_crack.balance.problem import (
    MAX_UNKNOWNS_TIMES_POINTS_PER_CALL,
    Problem,
    least_harmonics,
)
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import (
    INTERRUPTED_CURVE_STATUS,
    ConvergenceError,
    InputError,
    check_count,
    check_omega,
)
from fenics_crack.basics.progress import add_progress_text, begin_stage
from fenics_crack.basics.suggestions import check_options
from fenics_crack.curves.continuation import (
    Continuation,
    ContinuationLimitsKeywords,
    GrowingCurve,
    can_follow_orbits,
)
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import PeriodicOrbit

MAX_OTHER_CURVE_SEARCHES = 4
"""Maximum number of searches for another curve that leads to the start.

The first search begins at the end of the range, the others between the end and the start.
"""
PROGRESS_BAR_FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
"""Format of a curve's progress bar for tqdm.

The remaining time is left out: the progress does not predict it.
"""


class CurveOptions(ContinuationLimitsKeywords, total=False):
    """Options of :func:`.continue_frequency` and :func:`.continue_parameter`.

    harmonics
        Harmonics H; default: 5, or as many as the load has.
    samples
        Instants per period for the contact force; default: exact integrals if the law permits.
    subharmonic
        Load periods in the response's period.
    initial
        Solution near the curve's start; default: the linear solution.
    tolerance
        Replaces ``harmonics`` and ``samples``: follow exact orbits, and keep their solutions to
        this relative error. Two cases use harmonic balance instead: there is no exact flow, as for
        smooth laws; or orbits would take too long, with more than 120 modes or a very slow load.
        The truncation error at the first point then sets the harmonics.
    stability
        Assess the curve's stability; exact orbits always have their stability.
    longest_step
        Longest step, relative to the parameter range and to the solution's size; default: 0.05.
    most_points
        Maximum number of points.
    max_turn_back_fraction
        How far the curve may turn back past its start, relative to the parameter range.
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

    The first solution may lie on a closed loop, or on a curve that turns back past its start.
    Another curve is then searched from the end of the range, or from between; ``status`` says so.
    The first curve is returned if this search fails or would take long, or if ``initial`` is given.

    Parameters
    ----------
    structure : Structure
        Structure that vibrates. One with many dofs is first reduced to a model whose crack faces
        have no mass (``reduce_structure(structure, method="massless")``).
    omega_start, omega_end : float
        Load frequencies [rad/s]; the end may be below the start.
    contact : ContactLaw
        Law for all pairs. :class:`UnilateralConstraint` requires crack faces without mass. With
        mass, modes above the highest harmonic suffice if they let every pair move on its own.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the end is not reached; otherwise return the points so far, with ``complete``
        False. Ctrl-C always returns the points so far.
    **options
        Keywords of :class:`.CurveOptions`: harmonics, samples, subharmonic, initial, tolerance,
        stability, longest_step, most_points, max_turn_back_fraction.

    Returns
    -------
    ResponseCurve
        Curve from the start on. ``complete`` is True if the curve reached the end. ``exact`` is
        True with a ``tolerance``, if exact orbits could be followed.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached; the points so far are in the error's ``found``.

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
    """Follow the response over a parameter other than the load frequency.

    The load frequency is constant; with "speed" it follows the rotor, as in a run-up.

    Parameters
    ----------
    structure : Structure
        Structure that vibrates. One with many dofs is first reduced to a model whose crack faces
        have no mass.
    omega : float
        Load frequency [rad/s].
    contact : ContactLaw
        Law for all pairs.
    parameter : "load", "stiffness", "damping", "clearance", "friction" or "speed"
        Factor of the load, the contact stiffness, the structure's damping or the coefficient of
        friction; clearance added to every pair [m]; or rotor speed [rad/s]. "speed" requires a
        structure of :func:`fenics_crack.run_up_structure`. The load frequency then keeps its ratio
        to the speed, the engine order: ``omega`` divided by the structure's own speed.
    start, end : float
        Values of the parameter.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the end is not reached; otherwise return the points so far.
    **options
        Keywords of :class:`.CurveOptions`: harmonics, samples, subharmonic, initial, tolerance,
        stability, longest_step, most_points, max_turn_back_fraction.

    Returns
    -------
    ResponseCurve
        Curve from the start on. ``complete`` is True if the curve reached the end. ``exact`` is
        True with a ``tolerance``, if exact orbits could be followed.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached; the points so far are in the error's ``found``.

    Examples
    --------
    >>> curve = fc.continue_parameter(
    ...     structure, 2000.0, contact, "load", 1.0, 2.0, harmonics=5)
    """
    check_options("continue_parameter", options, CurveOptions.__annotations__)
    remaining_options: dict[str, Any] = dict(options)
    problem_keys = ("harmonics", "samples", "subharmonic", "initial")
    harmonics, samples, subharmonic, initial = (
        remaining_options.pop(key, None) for key in problem_keys
    )
    error_tolerance = remaining_options.get("tolerance")
    if error_tolerance is not None and harmonics is not None:
        raise InputError(
            "tolerance", error_tolerance, "left out with harmonics; give one of the two"
        )
    if error_tolerance is not None and not is_small(structure):
        structure = reduce_structure(structure, method="massless")
    subharmonic = 1 if subharmonic is None else subharmonic
    check_count("subharmonic", subharmonic, 1)
    if harmonics is None:
        harmonics = max(Problem.harmonics, least_harmonics(structure, subharmonic))
    problem = Problem(structure, omega, contact, harmonics, samples, subharmonic)
    is_exact = (
        error_tolerance is not None
        and samples is None
        and can_follow_orbits(problem, parameter, start, end)
    )

    def make_curve(
        curve_start: float, curve_end: float, first_guess: Any = initial
    ) -> GrowingCurve:
        """Make a curve between two parameter values, with its first point."""
        ends, guess = (curve_start, curve_end), first_guess
        return Continuation(
            problem, parameter, *ends, exact=is_exact, initial=guess, **remaining_options
        )

    def follow_other_curve(returned_curve: GrowingCurve | None = None) -> GrowingCurve | None:
        """Follow another curve from start to end; None with ``initial``, or if none is found.

        ``returned_curve`` is the first curve, if it returned to its start.
        """
        return (
            _find_other_curve(make_curve, start, end, returned_curve) if initial is None else None
        )

    try:
        growing_curve = make_curve(start, end)
    except ConvergenceError:
        alternative_growing_curve = None if error_tolerance is None else follow_other_curve()
        if alternative_growing_curve is None:
            raise
        growing_curve = alternative_growing_curve
    return run_to_end(growing_curve, progress, throw, follow_other_curve)


def _find_other_curve(
    make_curve: Callable[..., GrowingCurve],
    start: float,
    end: float,
    first_curve: GrowingCurve | None,
) -> GrowingCurve | None:
    """Follow another curve from the start to the end; None if the searches fail.

    A search follows a curve from the end of the range, or from between, to the start. The solution
    at the start then begins the other curve. This helps if the first curve returned to its start,
    as a closed loop of the truncated equations does. It also helps if there is no first solution.

    Parameters
    ----------
    make_curve : callable
        Makes a curve from a start value, an end value and a first guess.
    start, end : float
        Parameter values.
    first_curve : GrowingCurve or None
        Curve that returned to its start. All searches together may take as many points as this
        curve has, or 120,000 divided by the number of unknowns if that is more. None: no first
        solution was found; a single search is made.
    """
    n_spent_points, n_points_of_first_curve = (
        0,
        0 if first_curve is None else len(first_curve.points),
    )
    # If there is no orbit at the start, each search takes long.
    n_allowed_searches = MAX_OTHER_CURVE_SEARCHES if first_curve is not None else 1
    search_values = np.linspace(end, start, MAX_OTHER_CURVE_SEARCHES, endpoint=False)[
        :n_allowed_searches
    ]
    for search_value in search_values.tolist():
        start_solution: PeriodicSolution | PeriodicOrbit | None = None
        for stage_start_value, stage_end_value in ((search_value, start), (start, end)):
            try:
                growing_curve = make_curve(stage_start_value, stage_end_value, start_solution)
                max_unknowns_times_points = (
                    2 * MAX_OTHER_CURVE_SEARCHES * MAX_UNKNOWNS_TIMES_POINTS_PER_CALL
                )
                n_allowed_points = max(
                    n_points_of_first_curve,
                    max_unknowns_times_points // growing_curve.system.n_unknowns,
                )
                n_remaining_points = max(1, n_allowed_points - n_spent_points)
                growing_curve.most_points = min(n_remaining_points, growing_curve.most_points)
                growing_curve.run()
            except ConvergenceError:
                break
            n_spent_points += len(growing_curve.points)
            if not growing_curve.complete or growing_curve.has_returned:
                break
            curve = growing_curve.unjudged_curve
            start_solution = curve.orbit(-1) if curve.exact else curve.solution(-1)
        else:
            growing_curve.status += (
                ", from a solution at the start that a search from the end found"
            )
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
    """Follow the branch that begins or crosses at a bifurcation of a curve.

    At a period doubling, the branch has twice the period, and with harmonic balance twice the
    harmonics. At a branch point, it has the same period. The branch is followed in one direction
    until the parameter leaves the range, or to a junction with its parent. The other direction of a
    doubled branch has the same orbits half a period later.

    Parameters
    ----------
    curve : ResponseCurve
        Parent branch.
    bifurcation : Bifurcation
        One of its bifurcations, of kind "period_doubling" or "branch_point".
    start, end : float, optional
        Range of the parameter; default: the curve's own.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the branch's end is not reached; otherwise return the points so far.
    **options
        Keywords stability, longest_step, most_points and max_turn_back_fraction of
        :class:`.CurveOptions`. Harmonics, samples, subharmonic and tolerance follow from the curve.

    Returns
    -------
    ResponseCurve
        Branch with twice the period after a period doubling, otherwise with the same period.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No branch was found, or its end was not reached; its points are in the error's ``found``.

    Examples
    --------
    >>> branch = fc.follow_branch(doubling, doubling.bifurcations[0])
    """
    branching_kinds = ("period_doubling", "branch_point")
    if bifurcation.kind not in branching_kinds:
        requirement = "one of curve.bifurcations of kind " + " or ".join(branching_kinds)
        raise InputError("bifurcation", bifurcation.kind, requirement)
    check_options("follow_branch", options, CurveOptions.__annotations__)
    for key in ("harmonics", "samples", "subharmonic", "initial", "tolerance"):
        if key in options:
            raise InputError(key, options.get(key), "left out; the value of the curve is used")
    start = float(curve.values.min()) if start is None else start
    end = float(curve.values.max()) if end is None else end
    if not min(start, end) < bifurcation.value < max(start, end):
        raise InputError(
            "start, end",
            (start, end),
            f"on either side of the bifurcation at {bifurcation.value:g}",
        )
    period_factor = 2 if bifurcation.kind == "period_doubling" else 1
    branch_problem = replace(
        curve.problem,
        harmonics=period_factor * curve.problem.harmonics,
        samples=curve.problem.samples and period_factor * curve.problem.samples,
        subharmonic=period_factor * curve.subharmonic,
    )
    growing_curve = Continuation(
        branch_problem, curve.parameter, start, end,
        exact=curve.exact, initial=bifurcation, branch_of=curve, **options,  # type: ignore[misc]
    )  # fmt: skip
    return run_to_end(growing_curve, progress, throw)


def run_to_end(
    growing_curve: GrowingCurve,
    progress: bool,
    throw: bool,
    find_other_curve: Callable[[GrowingCurve], GrowingCurve | None] | None = None,
) -> ResponseCurve:
    """Follow a curve to its end, and return it with its stability.

    If the curve returns to its start, another curve is followed instead.

    Parameters
    ----------
    growing_curve : GrowingCurve
        Curve with a first point.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise ConvergenceError if the end is not reached; the points so far are in its ``found``.
    find_other_curve : callable, optional
        Takes the curve that returned; returns another curve, followed from the start to its end, or
        None.

    Returns
    -------
    ResponseCurve
        Curve, with its stability if requested for ``growing_curve``. After Ctrl-C: the points so
        far, without stability.
    """
    try:
        try:
            _run_with_progress(growing_curve, progress)
            if find_other_curve is not None and growing_curve.has_returned:
                alternative_growing_curve = find_other_curve(growing_curve)
                if alternative_growing_curve is None and not growing_curve.complete:
                    growing_curve.status += " (from the end no other curve was found)"
                growing_curve = alternative_growing_curve or growing_curve
        except ConvergenceError as error:
            growing_curve.status = str(error)
        curve = growing_curve.curve
    except KeyboardInterrupt:  # may also interrupt the verdicts
        throw, growing_curve.status = False, INTERRUPTED_CURVE_STATUS
        curve = growing_curve.unjudged_curve
    if throw and not curve.complete:
        curve_words = f"curve in {curve.parameter} from {curve.values[0]:g}"
        end_words = f"ended at {curve.values[-1]:g} after {len(curve)} points: {curve.status}"
        raise ConvergenceError(
            f"{curve_words} {end_words}; the error's attribute found has this curve", found=curve
        )
    return curve


def _run_with_progress(growing_curve: GrowingCurve, progress: bool) -> None:
    """Follow a curve to its end with a progress bar, or with progress messages.

    The bar appears on rank 0 if ``progress`` is True.
    """
    if not progress or growing_curve.system.problem.structure.whole.comm.rank != 0:
        begin_stage("curve")
        with add_progress_text(growing_curve.describe_progress):
            growing_curve.run()
        return
    begin_stage("")
    from tqdm import tqdm

    with tqdm(total=100, desc="curve", unit="%", bar_format=PROGRESS_BAR_FORMAT) as bar:
        for _ in growing_curve:
            bar.set_postfix_str(growing_curve.describe_parameter_and_point_count(), refresh=False)
            bar.update(max(0, int(100.0 * growing_curve.progress_fraction()) - bar.n))
