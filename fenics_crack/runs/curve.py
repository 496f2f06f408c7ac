"""Response curve of a scene, as ``fenics-crack curve`` follows it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import solve_beside
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import INTERRUPTED, InputError
from fenics_crack.basics.tables import percent
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors.stated import error_by_modes
from fenics_crack.model.contact import friction_of, is_rigid
from fenics_crack.model.modes import bilinear_frequencies
from fenics_crack.model.reduction import DEFAULT_LARGE_MODES
from fenics_crack.model.rotation import run_up_structure
from fenics_crack.runs.run import Run
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import make_requested_rows
from fenics_crack.study.prepare import (
    REFUSAL_EXCEPTIONS,
    Study,
    estimate_checked_memory,
    reduction_of,
)
from fenics_crack.study.solve import (
    MAX_MODES_FOR_MANY_SOLUTIONS,
    candidate_mode_counts,
    prepare_unreduced_study,
    reduce_with_more_modes,
    required_contact_law,
    with_friction_lines,
)


def curve(
    scene: Scene | Study, comm: MPI.Comm = MPI.COMM_WORLD, *, progress: bool = False
) -> Run[ResponseCurve]:
    """Follow the response curve of a scene's table ``[curve]``, as ``fenics-crack curve`` does.

    Over the frequency (:func:`continue_frequency`), the speed of a rotor or another parameter
    (:func:`continue_parameter`), or at resonance over the load (:func:`follow_resonance`);
    collective.

    Parameters
    ----------
    scene : Scene or Study
        Scene that vibrates, with its curve; or what :func:`load_prepared` returns.
    comm : MPI.Comm
        Ranks that share the structure.
    progress : bool
        Show a bar.

    Returns
    -------
    Run
        Scene, structure, law and ``result``: the curve, which may have ended early.

    Raises
    ------
    InputError
        A value of the scene cannot be used, or there is no such table.

    Examples
    --------
    >>> keys = {"start": 300.0, "stop": 310.0, "stability": False}
    >>> run = fc.curve(scene.replace({f"curve.{key}": value for key, value in keys.items()}))
    >>> run.result.complete
    """
    studies = studies_of_curve(scene, comm)
    study = next(studies)
    _check_curve(study)
    make_requested_rows(study)  # before the curve: it may be refused
    scene = scene.scene if isinstance(scene, Study) else scene
    parameter, start, stop = scene.given("curve").followed
    if friction_of(required_contact_law(study)) is not None:
        omega = _first_resonance(study, start, stop) if parameter == "omega" else None
        study = with_friction_lines(study, omega or scene.excitation.omega)
    unreduced_study = replace(study, scene=scene, structure=study.structure.whole)
    if parameter == "speed" or not candidate_mode_counts(unreduced_study):
        return Run(**vars(study), result=_follow(study, scene, progress))
    if parameter == "omega":
        study = _first_with_enough_modes(study, studies, start, stop)
    law, tolerance = study.contact, scene.harmonic_balance.given("tolerance")
    for larger_study in chain([study], studies):
        study = replace(larger_study, contact=law)
        response = _follow(study, scene, progress)
        if response.status == INTERRUPTED:
            break
        indices = sorted({response.top(study.watched[0].dof).index, 0, len(response) - 1})
        error = max(error_by_modes(study, response.solution(index)) for index in indices)
        status = f"{response.status}; {_modes_in_words(study, error)}"
        response = replace(response, status=status)
        if error <= tolerance:
            break
    return Run(**vars(study), result=response)


def _check_curve(study: Study) -> None:
    """Raise InputError if no load vibrates, or the law suits no curve."""
    structure = study.structure
    if not structure.sum_over_ranks(np.abs(structure.force[1:]).sum()):
        requirement = "one that changes in time, for a curve: nothing vibrates"
        raise InputError("load", "steady", requirement)
    if is_rigid(required_contact_law(study)) and not structure.light_lips:
        requirement = (
            "'penalty' or 'smoothed', or used with reduction.method = 'massless', for a curve"
        )
        raise InputError("contact.law", "unilateral", requirement)


def _follow(study: Study, scene: Scene, progress: bool) -> ResponseCurve:
    """Follow the curve of a study with given modes (collective)."""
    from fenics_crack.curves.follow import continue_frequency, continue_parameter
    from fenics_crack.curves.resonance import follow_resonance
    from fenics_crack.curves.verdicts import judge_curve

    structure, law, omega = study.structure, required_contact_law(study), scene.excitation.omega
    table, balance = scene.given("curve"), scene.harmonic_balance
    parameter, start, stop = table.followed
    if parameter == "resonance":
        problem = Problem(structure, omega, law, balance.harmonics, balance.samples)
        response = follow_resonance(
            problem, start, stop, tolerance=balance.tolerance, progress=progress, throw=False
        )
        return judge_curve(response) if table.stability else response
    options: dict[str, Any] = {"stability": table.stability, "progress": progress, "throw": False}
    if balance.tolerance is None:
        options |= {"harmonics": balance.harmonics, "samples": balance.samples}
    else:
        options["tolerance"] = balance.tolerance
    if parameter == "omega":
        return continue_frequency(structure, start, stop, law, **options)
    if parameter == "speed":
        omega *= start / scene.speed  # the structure is that of the start
    return continue_parameter(structure, omega, law, parameter, start, stop, **options)


def studies_of_curve(source: Scene | Study, comm: MPI.Comm) -> Iterator[Study]:
    """Yield a scene prepared for its curve, with more and more modes.

    A run-up has a basis for all speeds, and as many modes as a resonance at the scene's own speed
    takes.
    """
    scene = source.scene if isinstance(source, Study) else source
    parameter, start, stop = scene.given("curve").followed
    unreduced_study = prepare_unreduced_study(source, comm)
    if parameter != "speed":
        yield from reduce_with_more_modes(unreduced_study, MAX_MODES_FOR_MANY_SOLUTIONS)
        return
    if scene.reduction is not None:
        requirement = "'massless', or left out, for a run-up: it has one basis for all speeds"
        scene.reduction.require(scene.reduction.method in (None, "massless"), "method", requirement)
    estimate_checked_memory(scene, unreduced_study.structure, is_run_up=True)
    if candidate_mode_counts(unreduced_study):
        order = scene.excitation.omega / scene.speed
        studies = reduce_with_more_modes(unreduced_study, MAX_MODES_FOR_MANY_SOLUTIONS)
        study = _first_with_enough_modes(next(studies), studies, order * start, order * stop)
        unreduced_study = replace(unreduced_study, scene=study.scene)
    reduction = reduction_of(unreduced_study.scene, unreduced_study.structure)
    default_modes = min(DEFAULT_LARGE_MODES, unreduced_study.structure.n_dofs)
    n_modes = default_modes if reduction is None else reduction.n_modes
    structure = run_up_structure(unreduced_study.structure, start, stop, n_modes)
    yield replace(unreduced_study, structure=structure.at_speed(start))


def _first_with_enough_modes(
    study: Study, studies: Iterator[Study], start: float, stop: float
) -> Study:
    """Return the first of some studies with enough modes (collective).

    Their error is that of a solution next to the first resonance of a curve over the frequency, or
    at its start.
    """
    balance, law = study.scene.harmonic_balance, required_contact_law(study)
    for larger_study in chain([study], studies):
        study = replace(larger_study, contact=law)
        omega = _first_resonance(study, start, stop)
        problem = Problem(study.structure, omega, law, balance.harmonics)
        error = 0.0
        with suppress(*REFUSAL_EXCEPTIONS):  # the curve itself will tell
            error = error_by_modes(study, solve_beside(problem, None, balance.tolerance))
        if error <= balance.given("tolerance") or error == math.inf:
            break
    return study


def _first_resonance(study: Study, start: float, stop: float) -> float:
    """Return the lowest bilinear frequency of a range, or its start [rad/s] (collective)."""
    lower_bound, upper_bound = sorted((start, stop))
    frequencies = bilinear_frequencies(study.structure).omega_bilinear
    is_between = (frequencies > lower_bound) & (frequencies < upper_bound)
    return float(min(frequencies[is_between], default=start))


def _modes_in_words(study: Study, error: float) -> str:
    """Say whether the modes of a curve meet its tolerance, with their error."""
    scene = study.scene
    tolerance, modes = scene.harmonic_balance.given("tolerance"), scene.given("reduction").modes
    if error <= tolerance:
        return f"chosen for an error of {tolerance:g}: {modes} modes"
    size = f"error by {modes} modes {percent(error)}" if error < math.inf else "error unknown"
    return f"{size}, {percent(tolerance)} was asked; what helps: {scene.modes_key} {2 * modes}"
