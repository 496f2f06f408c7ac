"""Modes and steady vibration of a scene, as ``fenics-crack modes`` and ``solve`` find them."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.tables import format_count
from fenics_crack.curves.stability import attractor_from_rest
from fenics_crack.model.modes import Modes, solve_modes
from fenics_crack.motion.attractors import MAX_SETTLED_CHANGE
from fenics_crack.runs.run import Run
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import Study, prepare
from fenics_crack.study.solve import prepare_unreduced_if_scene, solve_study

N_DEFAULT_MODES = 6
"""Default number of modes that the command ``modes`` finds."""


def modes(scene: Scene, count: int | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> Run[Modes]:
    """Find the lowest modes of a scene with its crack open (collective).

    ``fenics-crack modes`` does the same.

    Parameters
    ----------
    scene : Scene
        Scene that vibrates.
    count : int, optional
        Number of modes. Default: 6, or all if the structure has fewer.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    Run
        Scene, structure, contact law, and as ``result`` the modes.

    Raises
    ------
    InputError
        A value of the scene cannot be used.

    Examples
    --------
    >>> fc.modes(scene, 3).result.omega
    """
    study = prepare(scene, comm, whole=True)
    n_modes = min(N_DEFAULT_MODES, study.structure.n_modes) if count is None else count
    return Run(**vars(study), result=solve_modes(study.structure, n_modes))


def solve(scene: Scene | Study, comm: MPI.Comm = MPI.COMM_WORLD) -> Run[PeriodicSolution]:
    """Solve a scene for its steady vibration, as ``fenics-crack solve`` does (collective).

    Harmonic balance finds the solution at the load frequency (:func:`solve_harmonic_balance`). If
    the scene gives a tolerance but no number of modes, this number is chosen.

    Stability (:func:`floquet`) is added to a converged solution with contact if all modes can be
    computed. Three kinds of solutions get no stability:

    - smooth contact laws in a structure with more than 100 dofs,
    - rigid contact between crack faces with mass,
    - any solution with ``harmonic_balance.error = false``.

    Parameters
    ----------
    scene : Scene or Study
        Scene with its load, contact and harmonic balance; or the result of :func:`load_prepared`.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    Run
        Scene, structure, contact law, and as ``result`` the solution. ``result.converged`` says
        whether the solution has converged.

    Raises
    ------
    InputError
        A value of the scene cannot be used.

    Examples
    --------
    >>> run = fc.solve(scene)
    >>> run.result.report.total, run.result.stability.verdict, run.motion()
    """
    solved_study = solve_study(prepare_unreduced_if_scene(scene, comm))
    return _with_outcome_of_start_from_rest(Run(**vars(solved_study)))


def _with_outcome_of_start_from_rest(run: Run[PeriodicSolution]) -> Run[PeriodicSolution]:
    """Integrate the motion from rest and add its outcome to a solution (collective).

    The motion is integrated in two cases:

    - the verdict on stability is undecided;
    - no contact pair opens and closes in the solution. Larger motions with pairs that open and
      close may then exist, and Floquet multipliers do not show them.

    The outcome in words is stored in ``stability.from_rest``. The amplitude [m] at the watched dof
    is stored in ``stability.rest_amplitude`` (nan if the motion has not settled).

    The run is returned unchanged if stability was not examined, or if nothing vibrates. The run is
    also returned unchanged if the verdict is decided and the motion from rest has the solution's
    amplitude, to 0.1 %.
    """
    solution, watched_dof = run.result, run.watched_dof
    stability = solution.stability
    if stability is None or solution.is_still:
        return run
    is_stability_decided = stability.verdict != "undecided"
    if is_stability_decided and solution.breathes:
        return run
    begin_stage("the motion from rest")
    motion_from_rest = None
    with suppress(KeyboardInterrupt):  # the solution stays as it is
        motion_from_rest = attractor_from_rest(solution)
    if motion_from_rest is None or not motion_from_rest.n_integrated_load_periods:
        return run
    amplitude_from_rest = math.nan
    outcome_text = (
        "has not settled after "
        f"{format_count(motion_from_rest.n_integrated_load_periods, 'period')} of the load "
        "(integrate shows its course)"
    )
    if motion_from_rest.orbit is not None:
        outcome_text = motion_from_rest.description
        amplitude_from_rest = motion_from_rest.orbit.amplitude(watched_dof)
        solution_amplitude = solution.amplitude(watched_dof)
        if (
            is_stability_decided
            and abs(amplitude_from_rest - solution_amplitude)
            <= MAX_SETTLED_CHANGE * solution_amplitude
        ):
            return run  # the same motion
    stability = replace(stability, from_rest=outcome_text, rest_amplitude=amplitude_from_rest)
    return replace(run, result=replace(solution, stability=stability))
