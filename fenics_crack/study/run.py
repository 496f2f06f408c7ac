"""What each command computes from a scene, and its result read back from a file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.harmonic_balance import solve_harmonic_balance, solve_linear
from fenics_crack.curves.follow import continue_frequency, continue_parameter
from fenics_crack.errors import InputError
from fenics_crack.fem.assembly import build_structure
from fenics_crack.files.results import Result, load
from fenics_crack.files.store import kind_of, read_scene
from fenics_crack.model.contact import (
    ContactLaw,
    SmoothedPenalty,
    UnilateralConstraint,
    UnilateralPenalty,
)
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import Modes, solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import gather_rows
from fenics_crack.scene.scene import Integration, Scene
from fenics_crack.stability.floquet import floquet
from fenics_crack.study.prepare import law_of, prepare, reduction_of, with_crack_length
from fenics_crack.time.central_differences import (
    integrate_central_difference,
    stable_steps_per_period,
)
from fenics_crack.time.events import MOST_PAIRS, integrate_events
from fenics_crack.time.implicit import integrate_implicit

__all__ = [
    "Run",
    "find_modes",
    "follow_curve",
    "integrate",
    "load_run",
    "solve",
]

FEW_DOFS = 100
"""Beyond these the stability of an orbit with the smoothed law takes minutes."""
RECORDED_PERIODS = 4
"""Kept of a motion in time."""


@dataclass(frozen=True)
class Run:
    """What was found, with all that is needed to go on with it.

    Attributes
    ----------
    scene : Scene
        What was computed; a crack length found from ``crack.first_omega`` stands in it.
    structure : Structure
        As it was solved: reduced as the scene says.
    contact : ContactLaw, UnilateralConstraint or None
        Law of all pairs; None without a crack.
    result : Modes, PeriodicSolution, ResponseCurve or TimeHistory
        What was found.
    """

    scene: Scene
    structure: Structure
    contact: ContactLaw | UnilateralConstraint | None
    result: Result

    @property
    def watched_dof(self) -> int:
        """The dof of the whole structure that carries most of the load (collective)."""
        whole = self.structure.whole
        shares = gather_rows(whole.comm, np.abs(whole.force).max(axis=0))
        return int(np.argmax(shares))

    @property
    def watched_name(self) -> str:
        """Its name, for people (collective)."""
        return self.structure.dof_name(self.watched_dof)


def _needed_law(scene: Scene, structure: Structure) -> ContactLaw | UnilateralConstraint:
    law = law_of(scene, structure)
    if law is None:
        raise InputError("crack", None, "given for this command: a table")
    return law


# --- the commands ---------------------------------------------------------------------------------


def find_modes(scene: Scene, count: int, comm: MPI.Comm = MPI.COMM_WORLD) -> Run:
    """Lowest modes with the crack open (collective)."""
    scene = with_crack_length(scene, comm)
    structure = build_structure(scene, comm)
    return Run(scene, structure, law_of(scene, structure), solve_modes(structure, count))


def solve(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Run:
    """Steady vibration at ``excitation.omega``, with its stability where that can be judged.

    Collective. The solution may not have converged.
    """
    scene = with_crack_length(scene, comm)
    structure = prepare(scene, comm)
    law, table, omega = law_of(scene, structure), scene.harmonic_balance, scene.excitation.omega
    if law is None:
        linear = solve_linear(structure, omega, harmonics=table.harmonics)
        return Run(_settled(scene, structure), structure, None, linear)
    solution = solve_harmonic_balance(
        structure, omega, law, harmonics=table.harmonics, samples=table.samples, throw=False
    )
    judged = solution.converged and is_small(structure)
    if isinstance(law, SmoothedPenalty):
        judged &= structure.n_dofs <= FEW_DOFS
    if judged and not isinstance(law, UnilateralConstraint):
        solution = replace(solution, stability=floquet(structure, solution))
    return Run(_settled(scene, structure), structure, law, solution)


def follow_curve(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD, *, progress: bool = False) -> Run:
    """Response curve of the table ``[curve]`` (collective); it may end early."""
    table, balance = scene.curve, scene.harmonic_balance
    if table is None:
        raise InputError("curve", None, "given for this command: a table with start and stop")
    scene = with_crack_length(scene, comm)
    structure = prepare(scene, comm)
    law = _needed_law(scene, structure)
    if isinstance(law, UnilateralConstraint):
        raise InputError("contact.law", "constraint", "'penalty' or 'smoothed' for a curve")
    options: dict[str, Any] = {
        "harmonics": balance.harmonics,
        "samples": balance.samples,
        "stability": table.stability,
        "progress": progress,
        "throw": False,
    }
    if table.parameter == "omega":
        curve = continue_frequency(structure, table.start, table.stop, law, **options)
    else:
        omega = scene.excitation.omega
        curve = continue_parameter(
            structure, omega, law, table.parameter, table.start, table.stop, **options
        )
    return Run(_settled(scene, structure), structure, law, curve)


def integrate(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD, *, progress: bool = False) -> Run:
    """Motion in time from rest by the table ``[integration]`` (collective)."""
    table = scene.integration or Integration()
    if comm.size > 1 and scene.reduction is not None and scene.reduction.method == "off":
        raise InputError("reduction.method", "off", "a reduction, or one rank, for this command")
    scene = with_crack_length(scene, comm)
    structure = prepare(scene, comm)
    if table.method == "events" and structure.n_pairs > MOST_PAIRS:
        allowed = f"another with {structure.n_pairs} contact pairs: it takes {MOST_PAIRS} at most"
        raise InputError("integration.method", "events", allowed)
    law, omega = _needed_law(scene, structure), scene.excitation.omega
    options: dict[str, Any] = {
        "periods": table.periods,
        "settle": table.settle,
        "record_periods": min(RECORDED_PERIODS, table.periods),
        "progress": progress,
    }
    steps = table.steps_per_period
    if table.method == "events":
        if not isinstance(law, UnilateralPenalty):
            name = scene.contact and scene.contact.law
            raise InputError("contact.law", name, "'penalty' with integration.method = 'events'")
        history = integrate_events(structure, omega, law, steps_per_period=steps or 256, **options)
    elif table.method == "implicit":
        history = integrate_implicit(
            structure, omega, law, steps_per_period=steps or 512, **options
        )
    else:
        steps = steps or 2 * stable_steps_per_period(structure, omega, law)
        history = integrate_central_difference(
            structure, omega, law, steps_per_period=steps, **options
        )
    return Run(_settled(scene, structure), structure, law, history)


def _settled(scene: Scene, structure: Structure) -> Scene:
    """The scene with the reduction that was chosen, so that it is the same on any ranks."""
    table = reduction_of(scene, structure.whole)
    return (
        scene
        if table is None
        else scene.replace({"reduction": None}).replace(
            {f"reduction.{name}": value for name, value in asdict(table).items()}
        )
    )


def load_run(path: str | Path, comm: MPI.Comm = MPI.COMM_WORLD) -> Run:
    """Read the result of a command (collective); a sweep has its own ``SweepResult.load``.

    The structure is built anew from the scene in the file; what was found is only read.

    Raises
    ------
    InputError
        The file is not a result with a scene, or is a sweep.
    """
    kind, scene = kind_of(path), read_scene(path)
    if scene is None:
        raise InputError("path", str(path), f"a {kind} saved with its scene")
    whole = kind == Modes.KIND
    structure = build_structure(scene, comm) if whole else prepare(scene, comm)
    law = law_of(scene, structure)
    return Run(scene, structure, law, load(path, structure, law))
