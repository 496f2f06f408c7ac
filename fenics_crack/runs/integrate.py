"""Motion of a scene in time, as ``fenics-crack integrate`` finds it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import solve_harmonic_balance
from fenics_crack.balance.problem import least_harmonics
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import RECORDED_PERIODS, InputError
from fenics_crack.basics.progress import begin
from fenics_crack.files.store import Stored, read
from fenics_crack.model.contact import ContactLaw, friction_of, is_rigid, is_unilateral
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import multiply
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.structure import Structure
from fenics_crack.runs.load import free_study, run_of, structure_under_static_load
from fenics_crack.runs.run import Run
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Integration
from fenics_crack.study.observer import make_requested_rows
from fenics_crack.study.prepare import Study, prepare
from fenics_crack.study.solve import required_contact_law, with_friction_lines
from fenics_crack.time.march import Initial, TimeHistory, initial_state


def integrate(
    scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD, *, progress: bool = False
) -> Run[TimeHistory]:
    """Integrate a scene's motion in time, as ``fenics-crack integrate`` does (collective).

    By the scheme, the steps, the periods and the initial values of the table ``[integration]``, or
    the defaults: from rest, until the motion settles.

    Parameters
    ----------
    scene : Scene
        Scene that vibrates.
    comm : MPI.Comm
        Ranks that share the structure.
    progress : bool
        Show a bar.

    Returns
    -------
    Run
        Scene, structure, law and ``result``: the motion over the last periods.

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
    table = scene.integration or Integration()
    if comm.size > 1 and scene.reduction is not None and scene.reduction.method == "off":
        raise InputError("reduction.method", "off", "a reduction, or one rank, for this command")
    earlier_file = None if table.initial is None else _read_initial(table.initial, comm)
    omega = scene.excitation.omega
    study = with_friction_lines(prepare(scene, comm), omega)
    structure, law = study.structure, required_contact_law(study)
    method = _choose_method(study, table, law)
    make_requested_rows(study)  # before the integration: it may be refused
    initial: Initial = None
    if table.deflection is not None:
        static_structure = structure_under_static_load(structure, table.deflection)
        min_harmonics = least_harmonics(static_structure, 1)
        initial = solve_harmonic_balance(static_structure, omega, law, harmonics=min_harmonics)
    elif earlier_file is not None:
        state = _state_of(run_of(earlier_file, comm, with_reference=False), structure, table)
        initial = state if friction_of(law) is not None else state[:2]
    if table.free:
        study = free_study(study)
    options: dict[str, Any] = {
        "periods": table.periods,
        "settle": 0.0 if table.free else table.settle,
        "record_periods": None if table.free else min(RECORDED_PERIODS, table.periods),
        "initial": initial,
        "progress": progress,
    }
    march, steps = _march_of(study, method, table.steps_per_period)
    begin(f"integration, {method}")
    history = march(study.structure, omega, law, steps_per_period=steps, **options)
    return Run(**vars(study), result=history)


def _march_of(
    study: Study, method: str, steps: int | None
) -> tuple[Callable[..., TimeHistory], int]:
    """Return the function of a method and its steps per period, given or usual."""
    from fenics_crack.time.central_differences import (
        integrate_central_difference,
        stable_steps_per_period,
    )
    from fenics_crack.time.flows import integrate_events, integrate_exponential

    if method == "events":
        return integrate_events, steps or 256
    if method == "exponential":
        return integrate_exponential, steps or 512
    if steps is None:
        omega = study.scene.excitation.omega
        steps = 2 * stable_steps_per_period(study.structure, omega, required_contact_law(study))
        steps = max(512, steps)
    return integrate_central_difference, steps


def _read_initial(path: str, comm: MPI.Comm) -> Stored:
    """Read the file of an earlier motion, named by ``integration.initial`` (collective)."""
    try:
        motion_file = read(path, comm)
    except InputError as error:
        raise InputError("integration.initial", error.value, error.allowed) from None
    if motion_file.kind not in (PeriodicSolution.KIND, TimeHistory.KIND):
        raise InputError("integration.initial", path, "the file of a solution or an integration")
    return motion_file


def _state_of(
    earlier_run: Run[Any], structure: Structure, table: Integration
) -> tuple[np.ndarray, ...]:
    """Return the state of an earlier motion of the same mesh for a structure (collective).

    It is that of a solution at phase 0 of its load, of a motion in time at its end. Reduced
    structures take it by their modes: q = Phi^T M u.

    Returns
    -------
    displacement, velocity : (n_dofs,) [m], [m/s]
    places : (n_pairs,) [m]
        Only with friction.
    """
    motion, whole_structure = earlier_run.result, structure.whole
    if isinstance(motion, TimeHistory):
        state = motion.final_state
    else:
        state = initial_state(motion.structure, motion.contact, motion)
    local_states = motion.structure.expand(np.array(state[:2]))
    points = [
        np.zeros((mesh.n_local, 1)) if mesh.nodes is None else mesh.nodes.points
        for mesh in (whole_structure, motion.structure.whole)
    ]
    is_same = local_states.shape[1] == whole_structure.n_local and np.array_equal(*points)
    if not all(whole_structure.comm.allgather(is_same)):
        table.require(False, "initial", "a result of the same mesh")
    if isinstance(structure, ReducedStructure):
        momentum = multiply(whole_structure.mass, local_states.T).T
        modal_states = whole_structure.sum_over_ranks(momentum @ structure.basis)
        n_missing = structure.n_dofs - modal_states.shape[1]
        local_states = np.pad(modal_states, ((0, 0), (0, n_missing)))
    return local_states[0], local_states[1], *state[2:]


def _choose_method(study: Study, table: Integration, law: ContactLaw) -> str:
    """Return the integration method, the table's or the default; InputError if unusable."""
    structure, contact, requirement = study.structure, study.scene.contact, ""
    lips = structure.light_lips
    method = table.method or ("exponential" if lips else "central_difference")
    closed_form = method in ("events", "exponential")
    if lips and not closed_form:
        requirement = (
            "'events' or 'exponential' where crack faces have no mass, or reduction.method = "
        )
        requirement += "'free_interface'"
    elif closed_form and not is_small(structure):
        requirement = f"another with {structure.n_dofs} dofs, or reduction.method = 'massless'"
    elif closed_form and is_rigid(law) and not lips:
        requirement = "'central_difference' with contact.law = 'unilateral', or reduction.method = "
        requirement += "'massless'"
    if requirement:
        raise InputError("integration.method", method, requirement)
    if closed_form and not is_unilateral(law):
        requirement = f"'penalty' or 'unilateral' with integration.method = {method!r}"
        raise InputError("contact.law", contact and contact.law, requirement)
    return method
