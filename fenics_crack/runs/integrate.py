"""Motion of a scene in time, as ``fenics-crack integrate`` finds it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import solve_harmonic_balance
from fenics_crack.balance.problem import least_harmonics
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import N_RECORDED_PERIODS_OF_INTEGRATION, InputError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.files.store import StoredFile, read_result_file
from fenics_crack.model.contact import ContactLaw, friction_of, is_rigid, is_unilateral
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import multiply_columns
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.structure import Structure
from fenics_crack.runs.load import (
    make_run_from_file,
    structure_under_static_load,
    study_under_mean_load_alone,
)
from fenics_crack.runs.run import Run
from fenics_crack.scene.result_tables import Integration
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import make_requested_rows_and_readers
from fenics_crack.study.prepare import Study, prepare
from fenics_crack.study.solve import required_contact_law, with_fixed_slip_directions
from fenics_crack.time.march import Initial, TimeHistory, make_initial_state_parts


def integrate(
    scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD, *, progress: bool = False
) -> Run[TimeHistory]:
    """Integrate a scene's motion in time, as ``fenics-crack integrate`` does (collective).

    The table ``[integration]`` gives scheme, time steps, number of periods and initial values. By
    default the motion starts from rest and is followed until it settles.

    Parameters
    ----------
    scene : Scene
        Scene that vibrates.
    comm : MPI.Comm
        Ranks that share the structure.
    progress : bool
        Show a progress bar.

    Returns
    -------
    Run
        Scene, structure, contact law, and as ``result`` the motion over at most the last 4 load
        periods. A free decay is recorded as a whole.

    Raises
    ------
    InputError
        A value of the scene cannot be used.
    ConvergenceError
        The motion grows without bound.

    Examples
    --------
    >>> fc.integrate(scene.replace({"integration.periods": 5})).result.settled
    """
    integration_table = scene.integration or Integration()
    if comm.size > 1 and scene.reduction is not None and scene.reduction.method == "off":
        raise InputError(
            "reduction.method", "off", "'massless' or 'free_interface'; or integrate on one rank"
        )
    earlier_motion_file = (
        None
        if integration_table.initial is None
        else _open_initial_motion_file(integration_table.initial, comm)
    )
    omega = scene.excitation.omega
    study = with_fixed_slip_directions(prepare(scene, comm), omega)
    structure, law = study.structure, required_contact_law(study)
    method_name = _choose_method(study, integration_table, law)
    make_requested_rows_and_readers(study)  # before the integration: this may raise InputError
    initial_motion_or_state: Initial = None
    if integration_table.deflection is not None:
        structure_for_static_deflection = structure_under_static_load(
            structure, integration_table.deflection
        )
        min_harmonics = least_harmonics(structure_for_static_deflection, 1)
        initial_motion_or_state = solve_harmonic_balance(
            structure_for_static_deflection, omega, law, harmonics=min_harmonics
        )
    elif earlier_motion_file is not None:
        start_state = _start_state_from_run(
            make_run_from_file(earlier_motion_file, comm, with_reference=False),
            structure,
            integration_table,
        )
        initial_motion_or_state = start_state if friction_of(law) is not None else start_state[:2]
    if integration_table.free:
        study = study_under_mean_load_alone(study)
    march_function, steps_per_period = _march_function_and_steps(
        study, method_name, integration_table.steps_per_period
    )
    begin_stage(f"integration, {method_name}")
    history = march_function(
        study.structure,
        omega,
        law,
        steps_per_period=steps_per_period,
        periods=integration_table.periods,
        settle=0.0 if integration_table.free else integration_table.settle,
        record_periods=None
        if integration_table.free
        else min(N_RECORDED_PERIODS_OF_INTEGRATION, integration_table.periods),
        initial=initial_motion_or_state,
        progress=progress,
    )
    return Run(**vars(study), result=history)


def _march_function_and_steps(
    study: Study, method_name: str, steps_per_period: int | None
) -> tuple[Callable[..., TimeHistory], int]:
    """Return an integration method's function, and its time steps per load period.

    Parameters
    ----------
    study : Study
        Study with the structure.
    method_name : str
        "events", "exponential" or "central_difference".
    steps_per_period : int or None
        Number of time steps per load period. If None, "events" takes 256 and "exponential" 512.
        "central_difference" takes twice the steps needed for numerical stability, at least 512.
    """
    from fenics_crack.time.central_differences import (
        integrate_central_difference,
        stable_steps_per_period,
    )
    from fenics_crack.time.flows import integrate_events, integrate_exponential

    if method_name == "events":
        return integrate_events, steps_per_period or 256
    if method_name == "exponential":
        return integrate_exponential, steps_per_period or 512
    if steps_per_period is None:
        stable_steps = stable_steps_per_period(
            study.structure, study.scene.excitation.omega, required_contact_law(study)
        )
        steps_per_period = max(512, 2 * stable_steps)
    return integrate_central_difference, steps_per_period


def _open_initial_motion_file(path: str, comm: MPI.Comm) -> StoredFile:
    """Read the result file that ``integration.initial`` names (collective).

    Raises InputError unless the file holds a periodic solution or a motion in time.
    """
    try:
        motion_file = read_result_file(path, comm)
    except InputError as error:
        raise InputError("integration.initial", error.value, error.allowed) from None
    if motion_file.kind not in (PeriodicSolution.KIND, TimeHistory.KIND):
        raise InputError("integration.initial", path, "the file of a result of solve or integrate")
    return motion_file


def _start_state_from_run(
    earlier_run: Run[Any], structure: Structure, integration_table: Integration
) -> tuple[np.ndarray, ...]:
    """Return an initial state to continue an earlier motion (collective).

    A periodic solution gives the state at the load's phase 0; a motion in time gives the final
    state. For a reduced structure, the displacement u is converted to modal amplitudes q = Phi^T M
    u, with the modes Phi and the mass M. Coordinates without mass are zero. InputError if the
    earlier motion has another mesh.

    Parameters
    ----------
    earlier_run : Run
        Run with the earlier motion.
    structure : Structure
        Structure to integrate.
    integration_table : Integration
        Table ``[integration]``, named in the error.

    Returns
    -------
    displacement, velocity : (n_local,) [m], [m/s]
        In the coordinates of ``structure``: without reduction the n_local dofs on this rank.
    places : (n_pairs,) [m]
        Slider positions: tangential gaps at which the tangential springs are relaxed. Returned only
        if the earlier motion has friction.
    """
    earlier_motion, whole_structure = earlier_run.result, structure.whole
    if isinstance(earlier_motion, TimeHistory):
        final_state = earlier_motion.final_state
    else:
        final_state = make_initial_state_parts(
            earlier_motion.structure, earlier_motion.contact, earlier_motion
        )
    local_states = earlier_motion.structure.expand(np.array(final_state[:2]))
    points_of_meshes = [
        np.zeros((compared_structure.n_local, 1))
        if compared_structure.nodes is None
        else compared_structure.nodes.points
        for compared_structure in (whole_structure, earlier_motion.structure.whole)
    ]
    has_same_mesh = local_states.shape[1] == whole_structure.n_local and np.array_equal(
        *points_of_meshes
    )
    if not all(whole_structure.comm.allgather(has_same_mesh)):
        integration_table.require(
            False, "initial", "a result on the mesh of this scene; compute it again"
        )
    if isinstance(structure, ReducedStructure):
        mass_times_states = multiply_columns(whole_structure.mass, local_states.T).T
        modal_states = whole_structure.sum_over_ranks(mass_times_states @ structure.basis)
        n_coordinates_besides_modes = structure.n_dofs - modal_states.shape[1]
        local_states = np.pad(modal_states, ((0, 0), (0, n_coordinates_besides_modes)))
    return local_states[0], local_states[1], *final_state[2:]


def _choose_method(study: Study, integration_table: Integration, law: ContactLaw) -> str:
    """Return the integration method: "events", "exponential" or "central_difference".

    ``integration.method`` decides. If not given, the method is "exponential" for crack faces
    without mass, else "central_difference". InputError if structure or contact law do not suit the
    method.
    """
    structure, contact_table, requirement_text = study.structure, study.scene.contact, ""
    has_massless_faces = structure.has_massless_crack_faces
    method_name = integration_table.method or (
        "exponential" if has_massless_faces else "central_difference"
    )
    is_closed_form = method_name in ("events", "exponential")
    if has_massless_faces and not is_closed_form:
        requirement_text = (
            "'events' or 'exponential' for crack faces without mass; or set reduction.method = "
            "'free_interface'"
        )
    elif is_closed_form and not is_small(structure):
        requirement_text = (
            f"'central_difference' with {structure.n_dofs} dofs; "
            "or set reduction.method = 'massless'"
        )
    elif is_closed_form and is_rigid(law) and not has_massless_faces:
        requirement_text = (
            "'central_difference' with contact.law = 'unilateral'; "
            "or set reduction.method = 'massless'"
        )
    if requirement_text:
        raise InputError("integration.method", method_name, requirement_text)
    if is_closed_form and not is_unilateral(law):
        requirement_text = f"'penalty' or 'unilateral' with integration.method = {method_name!r}"
        raise InputError("contact.law", contact_table and contact_table.law, requirement_text)
    return method_name
