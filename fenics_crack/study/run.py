"""Computations of each command from a scene, and its results read from files; and numbers of a
motion over time: stress intensity at crack tips, crack growth, and forces and moments of the
clamp."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import solve_beside, solve_harmonic_balance
from fenics_crack.balance.problem import Problem, least_harmonics
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import INTERRUPTED, RECORDED_PERIODS, InputError
from fenics_crack.basics.observables import Place, read_at
from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import Tabular, counted, percent, quantity
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.peak import Peak
from fenics_crack.curves.stability import from_rest
from fenics_crack.files.results import Result, save, type_of, unpack
from fenics_crack.files.store import Stored, read
from fenics_crack.model.contact import ContactLaw, friction_of, is_rigid, is_unilateral
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import Modes, bilinear_frequencies, multiply, solve_modes
from fenics_crack.model.nodes import AXES
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.reduction import DEFAULT_LARGE_MODES
from fenics_crack.model.rotation import run_up_structure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.attractors import MAX_SETTLED_CHANGE
from fenics_crack.motion.motions import ObservedMotion
from fenics_crack.scene.scene import Scene, check_known, without_clamp, without_tips
from fenics_crack.scene.tables import Integration
from fenics_crack.study.conclusion import Answer, said_of
from fenics_crack.study.observer import (
    AtTip,
    at_tips,
    held,
    inertia_rows,
    leading,
    rows_requested,
    stations_of_fronts,
    tip_rows,
)
from fenics_crack.study.prepare import REFUSALS, Study, check_memory_of, prepare, reduction_of
from fenics_crack.study.solve import (
    MOST_OF_MANY,
    modes_chosen,
    solve_prepared,
    with_lines,
    with_more_modes,
)
from fenics_crack.study.vary import error_by_modes, errors_of
from fenics_crack.study.verification import Verification, verification_of
from fenics_crack.time.march import Initial, TimeHistory, initial_state

Found = TypeVar("Found", bound=Result, covariant=True)


@dataclass(frozen=True, repr=False)
class Run(Answer, Generic[Found]):
    """A study with its result, whose attributes are also its own: ``run.peak()``.

    Attributes
    ----------
    scene, structure, contact, watched
        As :class:`Study` has them.
    result : Modes, PeriodicSolution, ResponseCurve or TimeHistory
        Result of the computation.
    stated : Verification or None
        Its :attr:`errors`, where they were computed with it.
    """

    result: Found
    stated: Verification | None = None

    @cached_property
    def errors(self) -> Verification | None:
        """Contributions of modes, harmonics and the mesh to the error of each number, by one other
        run for each; of a curve those of its largest response. Computed when first requested, and
        None of motions in time (collective)."""
        return self.stated or errors_of(self, self.result)

    def __str__(self) -> str:
        return f"{self.result!r}: {said_of(self).closing()}"

    def __repr__(self) -> str:
        return f"Run({self.result!r}, {self.scene!r})"

    def _repr_html_(self) -> str:
        return self.result.table().html(str(self))

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__()} - {"peak"} | {*dir(self.result)})

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or "result" not in vars(self):  # while it is being copied
            raise AttributeError(f"'Run' object has no attribute {name!r}")
        return getattr(self.result, name)

    def peak(self, dof: int | None = None) -> Peak:
        """The largest response of a curve, as :meth:`ResponseCurve.peak` has it, with the
        :attr:`errors` that are stated of the watched dof's (collective)."""
        if not isinstance(self.result, ResponseCurve):
            raise AttributeError("'Run' object has no attribute 'peak'")
        found, stated = self.result.peak(dof), self.errors
        if stated is None or not stated.parts or dof not in (None, self.watched_dof):
            return found
        names = self.watched[0].column("amplitude"), stated.resonance
        of_amplitude, of_omega = (stated.stated(name)[0] for name in names)
        of_omega = math.nan if found.at_end else of_omega
        return replace(found, error=of_amplitude, omega_error=of_omega, without=stated.without)

    def motion(self) -> dict[str, np.ndarray]:
        """Motion of what is watched [m], by its words: coefficients of a solution (2H+1,), along a
        curve (n, 2H+1), displacements in time (n,); of modes none (collective)."""
        found, dofs = self.result, [watched.dof for watched in self.watched]
        columns: list[np.ndarray] = []
        if isinstance(found, TimeHistory):
            columns = list(found.displacement(dofs).T)
        elif isinstance(found, ObservedMotion):
            columns = [seen.coefficients for seen in found.observe(dofs)[0]]
        return dict(zip((watched.words for watched in self.watched), columns, strict=False))

    def save(self, path: str | Path) -> None:
        """Write the result with its scene, its errors if they are stated, and what is watched of
        it, for :func:`load_run` and for programs without the structure
        (:func:`fenics_crack.save`; collective).

        Raises
        ------
        InputError
            The file cannot be written.
        """
        found, motion = self.result, self.motion()
        errors = None if self.stated is None else self.stated.text()
        if self.structure.comm.size > 1 and isinstance(found, PeriodicSolution | Modes):
            save(found, path, self.scene, watched=motion, errors=errors)  # it is spread over ranks
        else:
            comm = self.structure.whole.comm
            on_root(comm, lambda: save(found, path, self.scene, watched=motion, errors=errors))


def check_motion(run: object) -> None:
    """Raise InputError unless it is the run of a solution or of a time integration."""
    if not (isinstance(run, Run) and isinstance(run.result, PeriodicSolution | TimeHistory)):
        allowed = "what fc.solve(scene) or fc.integrate(scene) returns"
        raise InputError("run", type(getattr(run, "result", run)).__name__, allowed)


# --- the commands ---------------------------------------------------------------------------------


def modes(scene: Scene, count: int | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> Run[Modes]:
    """Find the lowest modes of a scene with its crack open, as ``fenics-crack modes`` (collective).

    Parameters
    ----------
    scene : Scene
        Scene that vibrates.
    count : int, optional
        Number of modes. Default: 6, or all of fewer.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    Run
        Scene, structure, law and ``result``: the modes.

    Raises
    ------
    InputError
        A value of the scene cannot be used.

    Examples
    --------
    >>> fc.modes(scene, 3).result.omega
    """
    study = prepare(scene, comm, whole=True)
    wanted = min(6, study.structure.n_modes) if count is None else count
    return Run(**vars(study), result=solve_modes(study.structure, wanted))


def solve(scene: Scene | Study, comm: MPI.Comm = MPI.COMM_WORLD) -> Run[PeriodicSolution]:
    """Solve a scene for its steady vibration, as ``fenics-crack solve`` does (collective).

    Harmonic balance at the load's frequency (:func:`solve_harmonic_balance`), with its stability
    (:func:`floquet`) if that is quick. With a tolerance the modes of the reduction are chosen, too,
    if the scene does not give any.

    Parameters
    ----------
    scene : Scene or Study
        Scene with its load, contact and harmonic balance; or what :func:`load_prepared` returns.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    Run
        Scene, structure, law and ``result``: the solution, which may not have converged.

    Raises
    ------
    InputError
        A value of the scene cannot be used.

    Examples
    --------
    >>> run = fc.solve(scene)
    >>> run.result.report.total, run.result.stability.verdict, run.motion()
    """
    solved = solve_prepared(_whole(scene, comm))
    return _with_motion_from_rest(Run(**vars(solved)))


def _with_motion_from_rest(run: Run[PeriodicSolution]) -> Run[PeriodicSolution]:
    """A run with what the motion from rest does where the verdict is undecided or no pair opens and
    closes: the multipliers of such a solution know nothing of the contact that another motion meets
    (collective)."""
    found = run.result
    judged, dof = found.stability, run.watched_dof
    if judged is None or found.still or (judged.verdict != "undecided" and found.breathes):
        return run
    begin("the motion from rest")
    motion = None
    with suppress(KeyboardInterrupt):  # the solution stays what it is
        motion = from_rest(found)
    if motion is None or not motion.periods:
        return run
    amplitude = math.nan
    outcome = f"has not settled after {counted(motion.periods, 'period')} of the load"
    if motion.orbit is not None:
        outcome, amplitude = motion.description, motion.orbit.amplitude(dof)
        own = found.amplitude(dof)
        if judged.verdict != "undecided" and abs(amplitude - own) <= MAX_SETTLED_CHANGE * own:
            return run  # the same motion
    seen = replace(judged, from_rest=outcome, rest_amplitude=amplitude)
    return replace(run, result=replace(found, stability=seen))


def _whole(scene: Scene | Study, comm: MPI.Comm) -> Study:
    """A scene prepared, but not reduced, unless it is (collective)."""
    return scene if isinstance(scene, Study) else prepare(scene, comm, whole=True)


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
    from fenics_crack.curves.follow import continue_frequency, continue_parameter
    from fenics_crack.curves.resonance import follow_resonance
    from fenics_crack.curves.verdicts import judge_curve

    studies = _studies_of_curve(scene, comm)
    scene = scene.scene if isinstance(scene, Study) else scene
    table, balance = scene.given("curve"), scene.harmonic_balance
    parameter, start, stop = table.followed
    study = next(studies)
    if not study.structure.sum_over_ranks(np.abs(study.structure.force[1:]).sum()):
        allowed = "one that changes in time, for a curve: nothing vibrates"
        raise InputError("load", "steady", allowed)
    law = _needed_law(study)
    if is_rigid(law) and not study.structure.light_lips:
        allowed = "'penalty' or 'smoothed', or used with reduction.method = 'massless', for a curve"
        raise InputError("contact.law", "unilateral", allowed)
    rows_requested(study)  # before the curve: it may be refused
    if friction_of(law) is not None:
        omega = _first_resonance(study, start, stop) if parameter == "omega" else None
        study = with_lines(study, omega or scene.excitation.omega)
        law = _needed_law(study)
    options: dict[str, Any] = {"stability": table.stability, "progress": progress, "throw": False}
    if balance.tolerance is None:
        options |= {"harmonics": balance.harmonics, "samples": balance.samples}
    else:
        options["tolerance"] = balance.tolerance

    def follow(study: Study) -> ResponseCurve:
        structure, omega = study.structure, scene.excitation.omega
        if parameter == "resonance":
            problem = Problem(structure, omega, law, balance.harmonics, balance.samples)
            found = follow_resonance(
                problem, start, stop, tolerance=balance.tolerance, progress=progress, throw=False
            )
            return judge_curve(found) if table.stability else found
        if parameter == "omega":
            return continue_frequency(structure, start, stop, law, **options)
        if parameter == "speed":
            omega *= start / scene.speed  # the structure is that of the start
        return continue_parameter(structure, omega, law, parameter, start, stop, **options)

    whole = replace(study, scene=scene, structure=study.structure.whole)
    if parameter == "speed" or not modes_chosen(whole):
        return Run(**vars(study), result=follow(study))
    if parameter == "omega":
        study = _enough_before(study, studies, start, stop)
    for more in chain([study], studies):
        study = replace(more, contact=law)
        found = follow(study)
        if found.status == INTERRUPTED:
            break
        places = sorted({found.top(study.watched[0].dof).index, 0, len(found) - 1})
        error = max(error_by_modes(study, found.solution(place)) for place in places)
        vars(found)["status"] += f"; {_modes_in_words(study, error)}"  # what is observed is kept
        if error <= balance.given("tolerance"):
            break
    return Run(**vars(study), result=found)


def _studies_of_curve(given: Scene | Study, comm: MPI.Comm) -> Iterator[Study]:
    """A scene prepared for its curve, with more and more modes: of a run-up with a basis for all
    speeds, and as many as a resonance at the scene's own takes."""
    scene = given.scene if isinstance(given, Study) else given
    parameter, start, stop = scene.given("curve").followed
    whole = _whole(given, comm)
    if parameter != "speed":
        yield from with_more_modes(whole, MOST_OF_MANY)
        return
    if scene.reduction is not None:
        allowed = "'massless', or left out, for a run-up: it has one basis for all speeds"
        scene.reduction.require(scene.reduction.method in (None, "massless"), "method", allowed)
    check_memory_of(scene, whole.structure, run_up=True)
    if modes_chosen(whole):
        few, order = with_more_modes(whole, MOST_OF_MANY), scene.excitation.omega / scene.speed
        chosen = _enough_before(next(few), few, order * start, order * stop)
        whole = replace(whole, scene=chosen.scene)
    kept = reduction_of(whole.scene, whole.structure)
    modes = min(DEFAULT_LARGE_MODES, whole.structure.n_dofs) if kept is None else kept.modes
    structure = run_up_structure(whole.structure, start, stop, modes)
    yield replace(whole, structure=structure.at_speed(start))


def _enough_before(study: Study, studies: Iterator[Study], start: float, stop: float) -> Study:
    """The first of some studies with enough modes, as far as a solution next to the first resonance
    of a curve over the frequency tells, or without one at its start (collective)."""
    balance, law = study.scene.harmonic_balance, _needed_law(study)
    for more in chain([study], studies):
        study = replace(more, contact=law)
        omega = _first_resonance(study, start, stop)
        problem = Problem(study.structure, omega, law, balance.harmonics)
        error = 0.0
        with suppress(*REFUSALS):  # the curve itself will tell
            error = error_by_modes(study, solve_beside(problem, None, balance.tolerance))
        if error <= balance.given("tolerance") or error == math.inf:
            break
    return study


def _first_resonance(study: Study, start: float, stop: float) -> float:
    """The lowest bilinear frequency of a range, or its start [rad/s] (collective)."""
    low, high = sorted((start, stop))
    natural = bilinear_frequencies(study.structure).omega_bilinear
    return float(min(natural[(natural > low) & (natural < high)], default=start))


def _modes_in_words(study: Study, error: float) -> str:
    """That the modes of a curve meet its tolerance, or by how much they miss it."""
    scene = study.scene
    tolerance, modes = scene.harmonic_balance.given("tolerance"), scene.given("reduction").modes
    if error <= tolerance:
        return f"chosen for an error of {tolerance:g}: {modes} modes"
    size = f"error by {modes} modes {percent(error)}" if error < math.inf else "error unknown"
    return f"{size}, {percent(tolerance)} was asked; what helps: {scene.modes_key} {2 * modes}"


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
    earlier = None if table.initial is None else _read_initial(table.initial, comm)
    omega = scene.excitation.omega
    study = with_lines(prepare(scene, comm), omega)
    structure, law = study.structure, _needed_law(study)
    method = _method(study, table, law)
    rows_requested(study)  # before the integration: it may be refused
    start: Initial = None
    if table.deflection is not None:
        static = _held(structure, table.deflection)
        least = least_harmonics(static, 1)
        start = solve_harmonic_balance(static, omega, law, harmonics=least)
    elif earlier is not None:
        state = _state_of(run_of(earlier, comm, judged=False), structure, table)
        start = state if friction_of(law) is not None else state[:2]
    if table.free:
        study = _freed(study)
        structure = study.structure
    options: dict[str, Any] = {
        "periods": table.periods,
        "settle": 0.0 if table.free else table.settle,
        "record_periods": None if table.free else min(RECORDED_PERIODS, table.periods),
        "initial": start,
        "progress": progress,
    }
    from fenics_crack.time.central_differences import (
        integrate_central_difference,
        stable_steps_per_period,
    )
    from fenics_crack.time.flows import integrate_events, integrate_exponential

    marches: dict[str, tuple[Callable[..., TimeHistory], int]] = {  # and usual steps per period
        "events": (integrate_events, 256),
        "exponential": (integrate_exponential, 512),
        "central_difference": (integrate_central_difference, 512),
    }
    march, usual = marches[method]
    steps = table.steps_per_period or usual
    if method == "central_difference" and table.steps_per_period is None:
        steps = max(usual, 2 * stable_steps_per_period(structure, omega, law))
    begin(f"integration, {method}")
    history = march(structure, omega, law, steps_per_period=steps, **options)
    return Run(**vars(study), result=history)


def _read_initial(path: str, comm: MPI.Comm) -> Stored:
    """The file of an earlier motion, named by ``integration.initial`` (collective)."""
    try:
        stored = read(path, comm)
    except InputError as error:
        raise InputError("integration.initial", error.value, error.allowed) from None
    if stored.kind not in (PeriodicSolution.KIND, TimeHistory.KIND):
        raise InputError("integration.initial", path, "the file of a solution or an integration")
    return stored


def _state_of(
    earlier: Run[Any], structure: Structure, table: Integration
) -> tuple[np.ndarray, ...]:
    """Displacement and velocity, with friction also places, of a structure where an earlier motion
    of the same mesh was: a solution at phase 0 of its load, a motion in time at its end
    (collective).

    Reduced structures take it by their modes: q = Phi^T M u.
    """
    found, whole = earlier.result, structure.whole
    if isinstance(found, TimeHistory):
        state = found.final_state
    else:
        state = initial_state(found.structure, found.contact, found)
    moved = found.structure.expand(np.array(state[:2]))
    both = ((one.nodes, one.n_local) for one in (whole, found.structure.whole))
    marks = [np.zeros((n, 1)) if nodes is None else nodes.points for nodes, n in both]
    same = moved.shape[1] == whole.n_local and np.array_equal(*marks)
    if not all(whole.comm.allgather(same)):
        table.require(False, "initial", "a result of the same mesh")
    if isinstance(structure, ReducedStructure):
        modal = whole.sum_over_ranks(multiply(whole.mass, moved.T).T @ structure.basis)
        moved = np.pad(modal, ((0, 0), (0, structure.n_dofs - modal.shape[1])))
    return moved[0], moved[1], *state[2:]


def _freed(study: Study) -> Study:
    """A study whose mean load acts alone."""
    structure = _held(study.structure, 0.0)
    return replace(study, structure=structure.watching(study.watched[0].dof))


def _held(structure: Structure, share: float) -> Structure:
    """A structure under its mean load, and a share of the load's first harmonic, that stay."""
    weights = np.zeros((len(structure.force),) * 2)
    weights[0, :3] = 1.0, share, share
    return structure.varied(load=weights)


def _method(study: Study, table: Integration, law: ContactLaw) -> str:
    """Return the integration method, the table's or the default; InputError if unusable."""
    structure, contact, allowed = study.structure, study.scene.contact, ""
    lips = structure.light_lips
    method = table.method or ("exponential" if lips else "central_difference")
    closed_form = method in ("events", "exponential")
    if lips and not closed_form:
        allowed = "'events' or 'exponential' where crack faces have no mass, or reduction.method = "
        allowed += "'free_interface'"
    elif closed_form and not is_small(structure):
        allowed = f"another with {structure.n_dofs} dofs, or reduction.method = 'massless'"
    elif closed_form and is_rigid(law) and not lips:
        allowed = "'central_difference' with contact.law = 'unilateral', or reduction.method = "
        allowed += "'massless'"
    if allowed:
        raise InputError("integration.method", method, allowed)
    if closed_form and not is_unilateral(law):
        allowed = f"'penalty' or 'unilateral' with integration.method = {method!r}"
        raise InputError("contact.law", contact and contact.law, allowed)
    return method


def _needed_law(study: Study) -> ContactLaw:
    if study.contact is None:
        if study.scene.structure is not None:
            allowed = "given for this command: the path of a Matrix Market file"
            raise InputError("structure.gap", None, allowed)
        # The crack of a file is no table.
        missing = "contact" if study.scene.mesh.layout == "file" else "crack"
        raise InputError(missing, None, "given for this command: a table")
    return study.contact


def load_run(path: str | Path, comm: MPI.Comm = MPI.COMM_WORLD) -> Run[Result]:
    """Read the result of a command with its scene, structure and law (collective).

    The structure is built anew from the scene in the file; the result is only read. Files of the
    mesh or of matrices that the scene names are opened if they are still those of the result, by
    their SHA-256. With a structure at hand, :func:`fenics_crack.load` reads the same files; sweeps
    are read by ``SweepResult.load``.

    Parameters
    ----------
    path : path
        The file.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    Run
        Scene, structure, law and result.

    Raises
    ------
    InputError
        The file is not a result with a scene, is a sweep, damaged or of an older version; or a file
        that its scene names has changed.

    Examples
    --------
    >>> fc.solve(scene).save("solution.h5")
    >>> run = fc.load_run("solution.h5")
    """
    return run_of(read(path, comm), comm)


def run_of(stored: Stored, comm: MPI.Comm = MPI.COMM_WORLD, *, judged: bool = True) -> Run[Result]:
    """The run of a file that has been read, with the reference of a reduction unless that is not
    needed; raises as :func:`load_run` (collective)."""
    kind, scene = type_of(stored), stored.scene()
    if scene is None:
        raise InputError("path", str(stored.path), f"a {kind.KIND} saved with its scene")
    on_root(comm, lambda: stored.check_files(scene))
    if issubclass(kind, ResponseCurve) and scene.curve is not None:
        study = next(_studies_of_curve(scene, comm))
    else:
        study = prepare(scene, comm, whole=kind is Modes, judged=judged)
    if kind is TimeHistory and scene.integration is not None and scene.integration.free:
        study = _freed(study)
    try:
        result = unpack(stored, study.structure, study.contact)
    except InputError as error:
        if error.key == "path":
            raise
        found = f"{error.key} {error.allowed}"
        allowed = f"a result of this version's structure ({found}); compute it again"
        raise InputError("path", str(stored.path), allowed) from None
    if friction_of(known := getattr(result, "contact", None)) is not None:
        study = replace(study, contact=known)  # along the lines of the file
    return Run(**vars(study), result=result, stated=verification_of(stored))


def read_run(stored: Stored) -> Run[Result]:
    """The run of a file that one rank has read. The errors of a solution are in the file: it needs
    no reference."""
    return run_of(stored, MPI.COMM_SELF, judged=stored.kind != PeriodicSolution.KIND)


# --- over time ------------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class StressIntensity(Tabular):
    """K_I and K_II at the tips of a plate's cracks over a motion; K_III, too, at stations along the
    fronts of a solid's, in turn.

    Attributes
    ----------
    time : (n,) [s]
        Over one period of a solution, or the record of a motion in time.
    tips : tuple of str
        Names: "the crack tip", "the left crack tip", "the crack tip of crack 2", "the crack front
        at 3.2 mm", from where that front begins.
    positions : (n_tips,) [m]
        Distances along the crack; of a solid along the front, from where it begins.
    points, ahead : (n_tips, d) [m], (n_tips, d)
        Where they are, and where the cracks run straight on.
    one, two : (n, n_tips) [Pa m^1/2]
        K_I, positive where the crack faces part, and K_II, positive where the face on the left of
        who looks ahead moves ahead. At a front without clearance K_I is exactly zero while all
        patches of the contact that touch it near a station are closed, and never negative.
    three : (n, n_tips) [Pa m^1/2] or None
        K_III, positive where the upper face moves along the front, in the direction e_3 = e_1 x e_2
        with e_1 ahead and e_2 from the lower to the upper face; of a plate None.
    closed : (n_tips,) [Pa m^1/2]
        Largest size of K_I of a solid as it is computed where it is zero by contact, while the
        front is closed, or below zero while it is closed in part: its error.
    """

    time: np.ndarray
    tips: tuple[str, ...]
    positions: np.ndarray
    points: np.ndarray
    ahead: np.ndarray
    one: np.ndarray
    two: np.ndarray
    three: np.ndarray | None
    closed: np.ndarray
    _run: Run[Any] = field(compare=False)
    _seen: list[AtTip] = field(compare=False)

    @cached_property
    def numbers(self) -> Mapping[str, np.ndarray]:
        """Each tip's K_max, K_min, delta_K, delta_K_effective, K_II_max, and of a solid K_III_max:
        (n_tips,) [Pa m^1/2].

        The effective range is that while the tip is open, max(K_I, 0) - max(min K_I, 0). With a
        table ``[growth]`` delta_K_equivalent, too: the range from 0 that, once a period of the
        load, makes the crack grow as much as all cycles of K_I do, counted by rain flow.
        """
        numbers = [tip.numbers() for tip in self._seen]
        return {name: np.array([one[name] for one in numbers]) for name in numbers[0]}

    @property
    def largest(self) -> np.ndarray:
        """Largest K_I of each tip: (n_tips,) [Pa m^1/2]."""
        return self.numbers["K_max"]

    @property
    def smallest(self) -> np.ndarray:
        """Smallest K_I of each tip: (n_tips,) [Pa m^1/2]."""
        return self.numbers["K_min"]

    @property
    def effective(self) -> np.ndarray:
        """Range of K_I of each tip while it is open: (n_tips,) [Pa m^1/2]."""
        return self.numbers["delta_K_effective"]

    @property
    def leading(self) -> int:
        """The tip whose effective range is the largest."""
        return leading(self._seen)

    @property
    def comm(self) -> MPI.Comm:
        """Communicator."""
        return self._run.structure.comm

    @property
    def fronts(self) -> dict[str, list[int]]:
        """The tips, of a solid the stations, of each front by its name."""
        return stations_of_fronts(self.tips)

    @property
    def turn(self) -> np.ndarray:
        """Angle by which each crack would turn at its largest K_I, to the left, where the hoop
        stress is largest: (n_tips,) [rad].

        K_I sin(theta) + K_II (3 cos(theta) - 1) = 0 (Erdogan, Sih, Journal of Basic Engineering 85,
        1963, 519); nan where K_I is never positive.
        """
        place = self.one.argmax(axis=0)[None]
        one = np.take_along_axis(self.one, place, axis=0)[0]
        two = np.take_along_axis(self.two, place, axis=0)[0]
        found = -2.0 * np.arctan(2.0 * two / (one + np.sqrt(one**2 + 8.0 * two**2)))
        return np.where(one > 0.0, found, np.nan)

    @cached_property
    def errors(self) -> Verification | None:
        """Contributions of modes, harmonics and the mesh to the error of the leading crack tip's
        numbers, by one other run for each; None of motions in time. Computed when first requested
        (collective)."""
        scene = self._run.scene.replace({"output.quantities": tuple(self.numbers)})
        return errors_of(replace(self._run, scene=scene, stated=None), self._run.result)

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every instant: K_I and K_II of each tip."""
        found = {"time": self.time.tolist()}
        kinds = {"K_I": self.one, "K_II": self.two} | (
            {} if self.three is None else {"K_III": self.three}
        )
        for number, tip in enumerate(self.tips):
            found |= {f"{name}, {tip}": rows[:, number].tolist() for name, rows in kinds.items()}
        return found

    def _units(self) -> Mapping[str, str]:
        return {name: "s" if name == "time" else "Pa m^0.5" for name in self.to_dict()}

    def _title(self) -> str:
        tip = self.leading
        parts = [f"{name} = {values[tip]:.4g}" for name, values in self.numbers.items()]
        return f"{', '.join(parts)} Pa m^0.5 at {self.tips[tip]}"


def stress_intensity(run: Run[PeriodicSolution] | Run[TimeHistory]) -> StressIntensity:
    r"""Find stress intensities at the tips of a plate's cracks over a motion (collective).

    K_I and K_II of the displacement at each instant, by the interaction integral over a domain
    around the tip or front, with the inertia in it and the contact on the crack faces. Along a
    front K_III comes to them; each station has the mean over its neighbourhood, and those at the
    surface are on the line through the two next to it (docs/solids.md). The error of K_I of a mesh
    is of first order in its size; that of a closed front is stated (``closed``). Where a structure
    is reduced the modes' statics are not summed up but solved for: with q_r the amplitudes of the
    modes,

    .. math:: K = K_{\mathrm{static}}(f, \lambda) + \sum_r K_r (q_r - q_{r,\mathrm{static}}).

    Parameters
    ----------
    run : Run
        Result of :func:`fenics_crack.solve` or :func:`fenics_crack.integrate`, of a plate or a
        solid with a crack.

    Returns
    -------
    StressIntensity
        Over a period of a solution (1024 instants or more), or the record of a motion in time.

    Raises
    ------
    InputError
        It is neither of them, of matrices, a disk, with friction or a preload by its clearance, or
        without a crack; or the elements at a crack tip or front are too long.

    Examples
    --------
    >>> found = fc.stress_intensity(fc.solve(scene))
    >>> found.largest, found.effective, found.turn
    """
    check_motion(run)
    check_known(without_tips(run.scene), "run", repr(run))
    tips, rows, of_forces = tip_rows(run)
    [record] = run.result.records(rows)
    seen = at_tips(record, tips, of_forces, run.scene.growth)
    three = [one.three for one in seen if one.three is not None]
    return StressIntensity(
        record.time,
        tuple(tip.name for tip in tips),
        np.array([tip.arc_length for tip in tips]),
        np.array([tip.point for tip in tips]),
        np.array([tip.growth_direction for tip in tips]),
        np.column_stack([one.one for one in seen]),
        np.column_stack([one.two for one in seen]),
        np.column_stack(three) if three else None,
        np.array([one.closed for one in seen]),
        run,
        seen,
    )


@dataclass(frozen=True, repr=False)
class Reaction(Tabular):
    """Forces and moments of the clamp on a plate or a solid over a motion.

    Attributes
    ----------
    time : (n,) [s]
        Over one period of a solution, or the record of a motion in time.
    center : (d,) [m]
        Of the clamp: the moments are about it.
    force : (n, d) [N]
        Of the clamp on what it holds; of a plate through its whole thickness.
    moment : (n, 1) or (n, 3) [N m]
        Likewise: about z of a plate; about x, y and z of a solid.
    """

    time: np.ndarray
    center: np.ndarray
    force: np.ndarray
    moment: np.ndarray

    @property
    def numbers(self) -> Mapping[str, float]:
        """Largest size of the force [N], ``reaction_force``, and of the moment [N m],
        ``reaction_moment``."""
        return read_at(Place.CLAMP, self)

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every instant."""
        found = {"time": self.time.tolist()}
        axes, about = AXES[: self.force.shape[1]], AXES[-self.moment.shape[1] :]
        names = [f"force_{axis}" for axis in axes] + [f"moment_{axis}" for axis in about]
        columns = np.hstack([self.force, self.moment]).T.tolist()
        return found | dict(zip(names, columns, strict=True))

    def _units(self) -> Mapping[str, str]:
        units = {"time": "s", "force": "N", "moment": "N m"}
        return {name: units[name.partition("_")[0]] for name in self.to_dict()}

    def _title(self) -> str:
        force, moment = self.numbers.values()
        place = ", ".join(f"{x:.4g}" for x in self.center)
        return f"up to {quantity(force, 'N')} and {quantity(moment, 'N m')} about ({place}) m"


def reaction(run: Run[PeriodicSolution] | Run[TimeHistory]) -> Reaction:
    r"""Find the forces and moments of the clamp over a motion (collective).

    By Newton's law of all that the clamp holds: with r the translations, and the rotations about
    its centre,

    .. math:: r \cdot R = r^T M (\ddot u + \alpha \dot u) - r^T f,

    :math:`\alpha` that of Rayleigh's damping, a drag from outside; all other damping acts inside,
    and adds no force. Contact forces on both faces cancel, and add none either. What modes leave
    out has no inertia, but its share of the load is in it.

    Parameters
    ----------
    run : Run
        Result of :func:`fenics_crack.solve` or :func:`fenics_crack.integrate`, of a mesh at
        rest.

    Returns
    -------
    Reaction
        Over a period of a solution (1024 instants or more), or the record of a motion in time,
        whose acceleration is that of a spline.

    Raises
    ------
    InputError
        It is neither of them, or of matrices, which have no clamp, or of a structure that rotates.

    Examples
    --------
    >>> held = fc.reaction(fc.solve(scene))
    >>> held.force.mean(axis=0), held.numbers["reaction_moment"]
    """
    check_motion(run)
    check_known(without_clamp(run.scene), "run", repr(run))
    structure = run.result.structure
    [record] = run.result.records(structure.compute_once(inertia_rows))
    return Reaction(record.time, structure.whole.clamp.center, *held(record))
