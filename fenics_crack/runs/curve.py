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

from fenics_crack.balance.harmonic_balance import solve_from_neighbour
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import INTERRUPTED_CURVE_STATUS, InputError
from fenics_crack.basics.tables import format_percent
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors.stated import find_largest_modal_error
from fenics_crack.model.contact import friction_of, is_rigid
from fenics_crack.model.modes import bilinear_frequencies
from fenics_crack.model.reduction import DEFAULT_MODES_OF_LARGE_STRUCTURE
from fenics_crack.model.rotation import run_up_structure
from fenics_crack.runs.run import Run
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import make_requested_rows_and_readers
from fenics_crack.study.prepare import (
    SINGLE_COMPUTATION_FAILURES,
    Study,
    estimate_and_check_solution_memory,
    modal_reduction_or_none,
)
from fenics_crack.study.solve import (
    MAX_MODES_FOR_MANY_SOLUTIONS,
    candidate_mode_counts,
    iterate_studies_with_more_modes,
    prepare_unreduced_if_scene,
    required_contact_law,
    with_fixed_slip_directions,
)


def curve(
    scene: Scene | Study, comm: MPI.Comm = MPI.COMM_WORLD, *, progress: bool = False
) -> Run[ResponseCurve]:
    """Follow the response curve of a scene's table ``[curve]`` (collective).

    ``fenics-crack curve`` does the same. The table's parameter chooses the method: frequency
    (:func:`continue_frequency`), rotor speed or another parameter (:func:`continue_parameter`), or
    the resonance over the load (:func:`follow_resonance`).

    Parameters
    ----------
    scene : Scene or Study
        Scene that vibrates, with a table ``[curve]``; or the result of :func:`load_prepared`.
    comm : MPI.Comm
        Ranks that share the structure.
    progress : bool
        Show a progress bar.

    Returns
    -------
    Run
        Scene, structure, contact law, and as ``result`` the curve. It may have ended early:
        ``result.complete`` says whether it reached the end.

    Raises
    ------
    InputError
        A value of the scene cannot be used, or the table ``[curve]`` is missing.

    Examples
    --------
    >>> keys = {"start": 300.0, "stop": 310.0, "stability": False}
    >>> run = fc.curve(scene.replace({f"curve.{key}": value for key, value in keys.items()}))
    >>> run.result.complete
    """
    studies_with_more_modes = iterate_curve_studies_with_more_modes(scene, comm)
    study = next(studies_with_more_modes)
    _check_curve_is_possible(study)
    make_requested_rows_and_readers(study)  # before the curve: this may raise InputError
    scene = scene.scene if isinstance(scene, Study) else scene
    parameter_name, start_parameter_value, stop_parameter_value = scene.given(
        "curve"
    ).parameter_and_range
    if friction_of(required_contact_law(study)) is not None:
        friction_line_omega_or_none = (
            _lowest_bilinear_omega(study, start_parameter_value, stop_parameter_value)
            if parameter_name == "omega"
            else None
        )
        study = with_fixed_slip_directions(
            study, friction_line_omega_or_none or scene.excitation.omega
        )
    unreduced_study = replace(study, scene=scene, structure=study.structure.whole)
    if parameter_name == "speed" or not candidate_mode_counts(unreduced_study):
        return Run(**vars(study), result=_follow_curve(study, scene, progress))
    if parameter_name == "omega":
        study = _find_study_meeting_tolerance(
            study, studies_with_more_modes, start_parameter_value, stop_parameter_value
        )
    law, tolerance = study.contact, scene.harmonic_balance.given("tolerance")
    for larger_study in chain([study], studies_with_more_modes):
        study = replace(larger_study, contact=law)
        response_curve = _follow_curve(study, scene, progress)
        if response_curve.status == INTERRUPTED_CURVE_STATUS:
            break
        checked_point_indices = sorted(
            {response_curve.top(study.watched[0].dof).index, 0, len(response_curve) - 1}
        )
        mode_error = max(
            find_largest_modal_error(study, response_curve.solution(checked_point_index))
            for checked_point_index in checked_point_indices
        )
        status_text = f"{response_curve.status}; {_describe_mode_choice(study, mode_error)}"
        response_curve = response_curve.with_status(status_text)
        if mode_error <= tolerance:
            break
    return Run(**vars(study), result=response_curve)


def _check_curve_is_possible(study: Study) -> None:
    """Raise InputError if a curve cannot be followed for a study.

    The load must vary in time. Rigid contact needs crack faces without mass (``reduction.method =
    'massless'``).
    """
    structure = study.structure
    if not structure.sum_over_ranks(np.abs(structure.force[1:]).sum()):
        requirement_text = "one that changes in time, such as excitation.force_sin"
        raise InputError("load", "steady", requirement_text)
    if is_rigid(required_contact_law(study)) and not structure.has_massless_crack_faces:
        requirement_text = (
            "'penalty' or 'smoothed' for a curve; or set reduction.method = 'massless'"
        )
        raise InputError("contact.law", "unilateral", requirement_text)


def _follow_curve(study: Study, scene: Scene, progress: bool) -> ResponseCurve:
    """Follow a response curve with the modes of the study (collective).

    Parameters
    ----------
    study : Study
        Gives structure and contact law.
    scene : Scene
        Gives the table ``[curve]``, load frequency, harmonics and tolerance.
    progress : bool
        Show a progress bar.
    """
    from fenics_crack.curves.follow import continue_frequency, continue_parameter
    from fenics_crack.curves.resonance import follow_resonance
    from fenics_crack.curves.verdicts import judge_curve

    structure = study.structure
    law = required_contact_law(study)
    load_omega = scene.excitation.omega
    curve_table, balance_table = scene.given("curve"), scene.harmonic_balance
    parameter_name, start, stop = curve_table.parameter_and_range
    if parameter_name == "resonance":
        problem = Problem(
            structure, load_omega, law, balance_table.harmonics, balance_table.samples
        )
        response_curve = follow_resonance(
            problem, start, stop, tolerance=balance_table.tolerance, progress=progress, throw=False
        )
        return judge_curve(response_curve) if curve_table.stability else response_curve
    curve_options: dict[str, Any] = {
        "stability": curve_table.stability,
        "progress": progress,
        "throw": False,
    }
    if balance_table.tolerance is None:
        curve_options |= {"harmonics": balance_table.harmonics, "samples": balance_table.samples}
    else:
        curve_options["tolerance"] = balance_table.tolerance
    if parameter_name == "omega":
        return continue_frequency(structure, start, stop, law, **curve_options)
    if parameter_name == "speed":
        load_omega *= start / scene.speed  # the structure has the speed of the start
    return continue_parameter(
        structure, load_omega, law, parameter_name, start, stop, **curve_options
    )


def iterate_curve_studies_with_more_modes(
    scene_or_study: Scene | Study, comm: MPI.Comm
) -> Iterator[Study]:
    """Yield a curve's study, each time reduced to more modes (collective).

    A curve over the rotor speed yields a single study, with one reduction basis for all speeds. If
    the scene has a tolerance, the number of modes is chosen so the error due to truncated modes
    meets the tolerance. The error is found at the first resonance on the curve, with the structure
    at the scene's own rotor speed.

    Parameters
    ----------
    scene_or_study : Scene or Study
        Scene with a table ``[curve]``, or its study before reduction.
    comm : MPI.Comm
        Ranks that share the structure.
    """
    scene = scene_or_study.scene if isinstance(scene_or_study, Study) else scene_or_study
    parameter_name, start, stop = scene.given("curve").parameter_and_range
    unreduced_study = prepare_unreduced_if_scene(scene_or_study, comm)
    if parameter_name != "speed":
        yield from iterate_studies_with_more_modes(unreduced_study, MAX_MODES_FOR_MANY_SOLUTIONS)
        return
    if scene.reduction is not None:
        scene.reduction.require(
            scene.reduction.method in (None, "massless"),
            "method",
            "'massless', or left out, for a curve over the rotor speed",
        )
    estimate_and_check_solution_memory(scene, unreduced_study.structure, is_run_up=True)
    if candidate_mode_counts(unreduced_study):
        engine_order = scene.excitation.omega / scene.speed
        candidate_studies = iterate_studies_with_more_modes(
            unreduced_study, MAX_MODES_FOR_MANY_SOLUTIONS
        )
        study = _find_study_meeting_tolerance(
            next(candidate_studies), candidate_studies, engine_order * start, engine_order * stop
        )
        unreduced_study = replace(unreduced_study, scene=study.scene)
    reduction = modal_reduction_or_none(unreduced_study.scene, unreduced_study.structure)
    n_default_modes = min(DEFAULT_MODES_OF_LARGE_STRUCTURE, unreduced_study.structure.n_dofs)
    n_run_up_basis_modes = n_default_modes if reduction is None else reduction.n_modes
    structure = run_up_structure(unreduced_study.structure, start, stop, n_run_up_basis_modes)
    yield replace(unreduced_study, structure=structure.at_speed(start))


def _find_study_meeting_tolerance(
    study: Study, studies_with_more_modes: Iterator[Study], start_omega: float, stop_omega: float
) -> Study:
    """Return the first study with enough modes for the scene's tolerance (collective).

    Each study is solved at the lowest bilinear frequency in the range. If the range has no bilinear
    frequency, the study is solved at ``start_omega``. A study has enough modes if the error due to
    truncated modes meets the tolerance. A study with an unknown error, or without a solution, is
    also returned. If no study meets the tolerance, the last study is returned.

    Parameters
    ----------
    study : Study
        First study.
    studies_with_more_modes : iterator of Study
        Further studies with more modes.
    start_omega, stop_omega : float [rad/s]
        Range for the load frequency.
    """
    balance_table, law = study.scene.harmonic_balance, required_contact_law(study)
    for larger_study in chain([study], studies_with_more_modes):
        study = replace(larger_study, contact=law)
        resonance_omega = _lowest_bilinear_omega(study, start_omega, stop_omega)
        problem = Problem(study.structure, resonance_omega, law, balance_table.harmonics)
        mode_error = 0.0
        with suppress(*SINGLE_COMPUTATION_FAILURES):  # the curve itself will report the failure
            mode_error = find_largest_modal_error(
                study, solve_from_neighbour(problem, None, balance_table.tolerance)
            )
        if mode_error <= balance_table.given("tolerance") or mode_error == math.inf:
            break
    return study


def _lowest_bilinear_omega(study: Study, start_omega: float, stop_omega: float) -> float:
    """Return the lowest bilinear frequency between two load frequencies [rad/s] (collective).

    Without a bilinear frequency in this range, return ``start_omega``.
    """
    lower_bound, upper_bound = sorted((start_omega, stop_omega))
    bilinear_omegas = bilinear_frequencies(study.structure).omega_bilinear
    is_between = (bilinear_omegas > lower_bound) & (bilinear_omegas < upper_bound)
    return float(min(bilinear_omegas[is_between], default=start_omega))


def _describe_mode_choice(study: Study, mode_error: float) -> str:
    """Say in words whether a study has enough modes for the scene's tolerance.

    Parameters
    ----------
    study : Study
        Study, reduced to a number of modes.
    mode_error : float
        Relative error of the solution due to truncated modes; inf if unknown.
    """
    scene = study.scene
    tolerance, n_modes = scene.harmonic_balance.given("tolerance"), scene.given("reduction").modes
    if mode_error <= tolerance:
        return f"chosen for an error of {tolerance:g}: {n_modes} modes"
    error_text = (
        f"the error due to {n_modes} modes is {format_percent(mode_error)}"
        if mode_error < math.inf
        else f"the error due to {n_modes} modes is unknown"
    )
    remedy_text = f"what helps: {scene.modes_key} = {2 * n_modes}"
    return f"{error_text}, but {format_percent(tolerance)} was requested; {remedy_text}"
