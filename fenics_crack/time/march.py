"""Motion in time: the march that all schemes share, its record, and what they need."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from petsc4py import PETSc
from tqdm import tqdm

from fenics_crack.balance.fourier import evaluate
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import InputError, check_count, check_number
from fenics_crack.model.modes import by_columns
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import StopRequest, raise_together
from fenics_crack.time.complementarity import solve_complementarity

__all__ = [
    "Recorder",
    "Scheme",
    "TimeHistory",
    "check_march",
    "dofs_to_record",
    "gap_block",
    "initial_state",
    "inverse_of",
    "linear_energy",
    "load_waves",
    "march",
    "moved_apart",
    "solve_columns",
]

MEMORY_LIMIT = 2**31
"""Bytes of history on one rank beyond which recording is refused."""


@dataclass(frozen=True)
class TimeHistory:
    """Motion found by direct integration, the last periods of it.

    Attributes
    ----------
    time : (n,) [s]
        Equally spaced; the load's phase is omega * time.
    gap : (n, n_pairs) [m]
        Closing of the pairs.
    settled : float
        Relative change of the gaps (without pairs: of the load's displacement) over the last
        period; a small number says that the motion repeats with the load.
    created_energy : float
        Net energy created, relative to the energy put in by the load and the initial state. Central
        differences: by contact that opens and closes between steps; it vanishes like dt^2. The
        implicit scheme: what is missing in the energy balance at the end of the last period.
        Negative: lost; with a constraint impacts lose energy whatever the step.
    periods : int
        Load periods integrated; fewer than asked for where the motion settled, or Ctrl-C stopped it
        at the end of a period.
    seconds : float
        Wall-clock time of the marching [s].
    steps_per_period : int
        Instants in one load period.
    """

    time: np.ndarray
    gap: np.ndarray
    settled: float
    created_energy: float
    periods: int
    seconds: float
    steps_per_period: int
    structure: Structure
    recorded: np.ndarray
    """(n, n_recorded) [m], the dofs of :attr:`recorded_dofs` that this rank owns."""
    recorded_dofs: np.ndarray
    final_state: tuple[np.ndarray, np.ndarray]
    """Displacement [m] and velocity [m/s] (n_local,) at the end of the last period: ``initial`` of
    a run that goes on, at the same frequency or another."""
    contact_force: np.ndarray
    """(n, n_pairs) [N]; with a constraint the mean force from this instant to the next."""

    KIND: ClassVar[str] = "time history"

    def by_period(self, values: np.ndarray) -> np.ndarray:
        """Fold a record (n, ...) at the load's period: (periods kept, steps_per_period, ...).

        The mean over the first axis is the phase-averaged wave, the standard deviation its spread.
        """
        return values.reshape(-1, self.steps_per_period, *values.shape[1:])

    def displacement(self, dofs: Sequence[int]) -> np.ndarray:
        """Displacement of recorded dofs: (n, len(dofs)) [m] (collective).

        Raises
        ------
        InputError
            A dof was not recorded.
        """
        if self.structure.whole is not self.structure:
            return self.structure.values_at(self.recorded, dofs)
        wanted = self.structure.check_dofs(dofs)
        place = {int(dof): column for column, dof in enumerate(self.recorded_dofs)}
        found = np.zeros((len(self.time), len(wanted)))
        known = np.zeros(len(wanted))
        for column, dof in enumerate(wanted):
            if int(dof) in place:
                found[:, column] = self.recorded[:, place[int(dof)]]
                known[column] = 1.0
        known = self.structure.sum_over_ranks(known)
        if not np.all(known):
            raise InputError("dofs", [int(d) for d in wanted[known == 0.0]], "among those recorded")
        return self.structure.sum_over_ranks(found)


class Scheme(Protocol):
    """What :func:`march` needs of a scheme."""

    load_rows: np.ndarray
    """Rows of this rank where the load is not zero."""
    before: np.ndarray
    """Displacement (n_local,) at the instant from which :meth:`advance` has started."""
    gap: np.ndarray
    """(n_pairs,), at the same instant."""
    force: np.ndarray
    """(n_pairs,), at the same instant."""

    def advance(self, step: int) -> None:
        """March from an instant of the period to the next."""

    def close_period(self, gap: np.ndarray, force: np.ndarray, load_motion: np.ndarray) -> None:
        """Book a period from its gaps, contact forces, and the motion of the loaded dofs."""

    @property
    def created_share(self) -> float:
        """Energy created relative to the energy put in."""

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and velocity."""

    def free(self) -> None:
        """Free PETSc's objects (collective)."""


def check_march(
    periods: object, steps_per_period: object, record_periods: object, settle: object
) -> None:
    """Raise InputError unless these arguments can be used."""
    check_count("periods", periods, 1)
    check_count("steps_per_period", steps_per_period, 1)
    if record_periods is not None:
        check_count("record_periods", record_periods, 1)
    check_number("settle", settle, 0.0)


class Recorder:
    """Room for the last periods of a motion (collective).

    Raises
    ------
    InputError
        The history would not fit in memory.
    """

    def __init__(
        self,
        structure: Structure,
        dofs: np.ndarray,
        periods: int,
        record_periods: int | None,
        steps_per_period: int,
    ) -> None:
        self.structure, self.dofs = structure, dofs
        self.periods, self.steps_per_period = periods, steps_per_period
        self.kept = periods if record_periods is None else min(record_periods, periods)
        slots = self.kept * steps_per_period
        most = max(structure.comm.allgather(len(dofs)))
        if 8 * slots * (most + 2 * structure.n_pairs) > MEMORY_LIMIT:
            raise InputError(
                "record_periods",
                record_periods,
                f"fewer, or fewer dofs: {slots} instants of {most} dofs do not fit in "
                f"{MEMORY_LIMIT // 2**30} GiB",
            )
        self.recorded = np.empty((slots, len(dofs)))
        self.gaps = np.empty((slots, structure.n_pairs))
        self.forces = np.empty((slots, structure.n_pairs))


def march(
    recorder: Recorder, scheme: Scheme, omega: float, settle: float, name: str, *, hidden: bool
) -> TimeHistory:
    """March a scheme that has started, until it settles, and free it (collective)."""
    structure, kept = recorder.structure, recorder.kept
    steps_per_period = recorder.steps_per_period
    load_now = np.empty((steps_per_period, len(scheme.load_rows)))
    columns = recorder.dofs - structure.first_dof
    settled, done, before = np.inf, 0, None
    started = clock.perf_counter()
    hidden = hidden or structure.comm.rank != 0
    with StopRequest() as stop:
        for period in tqdm(range(recorder.periods), name, unit="period", disable=hidden):
            slot = (period % kept) * steps_per_period
            gap_now = recorder.gaps[slot : slot + steps_per_period]
            force_now = recorder.forces[slot : slot + steps_per_period]
            for step in range(steps_per_period):
                scheme.advance(step)
                gap_now[step], force_now[step] = scheme.gap, scheme.force
                load_now[step] = scheme.before[scheme.load_rows]
                recorder.recorded[slot + step] = scheme.before[columns]
            done = period + 1
            scheme.close_period(gap_now, force_now, load_now)
            now = gap_now if structure.n_pairs else _whole(structure, load_now)
            if before is not None:
                size = np.linalg.norm(now)
                settled = float(np.linalg.norm(now - before) / size) if size > 0.0 else 0.0
            before = now.copy()
            if settled < settle or stop.asked(structure.comm):
                break
    seconds = clock.perf_counter() - started

    count = min(done, kept) * steps_per_period
    newest = (done % kept) * steps_per_period if done > kept else 0
    steps = np.arange(done * steps_per_period - count, done * steps_per_period)
    final_state = scheme.state()
    scheme.free()
    gap, force, recorded = (
        np.roll(rows[:count], -newest, axis=0)
        for rows in (recorder.gaps, recorder.forces, recorder.recorded)
    )
    return TimeHistory(
        time=steps * (2.0 * np.pi / omega / steps_per_period),
        gap=gap,
        settled=settled,
        created_energy=scheme.created_share,
        periods=done,
        seconds=seconds,
        steps_per_period=steps_per_period,
        structure=structure,
        recorded=recorded,
        recorded_dofs=recorder.dofs,
        final_state=final_state,
        contact_force=force,
    )


def gap_block(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Rows of this rank where B is not zero, and B there: (rows,), (rows, n_pairs)."""
    rows = np.flatnonzero(np.diff(structure.gap.indptr))
    return rows, structure.gap[rows].toarray()


def load_waves(structure: Structure, steps_per_period: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of this rank where the load is not zero, and the load there: (N, rows) [N]."""
    rows = np.flatnonzero(np.any(structure.force, axis=0))
    phase = 2.0 * np.pi * np.arange(steps_per_period) / steps_per_period
    waves = np.column_stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
    return rows, waves @ structure.force[:, rows]


def linear_energy(structure: Structure, displacement: np.ndarray, velocity: np.ndarray) -> float:
    """(u^T K u + v^T M v) / 2 of arrays (n_local,): [J] (collective)."""
    energy = 0.0
    for matrix, motion in ((structure.stiffness, displacement), (structure.mass, velocity)):
        source, target = matrix.createVecs()
        source.array_w[:] = motion
        matrix.mult(source, target)
        energy += 0.5 * source.dot(target)
        source.destroy()
        target.destroy()
    return energy


def solve_columns(inverse: Any, matrix: Any, columns: np.ndarray) -> np.ndarray:
    """X with A X = columns (n_local, m), A factored, of the layout of a matrix (collective)."""
    return by_columns(inverse.apply, matrix, columns)


def moved_apart(structure: Structure, displacement: np.ndarray) -> np.ndarray:
    """The displacement (n_local,) closest in the norm of M without penetration (collective)."""
    gap = structure.closing(displacement[None])[0] - structure.clearance
    if not np.any(gap > 0.0):
        return displacement
    inverse = inverse_of(structure.mass, symmetric=True)
    push = solve_columns(inverse, structure.mass, structure.gap.toarray())
    inverse.destroy()
    return displacement - push @ solve_complementarity(structure.closing(push.T).T, gap)


def inverse_of(matrix: Any, *, symmetric: bool) -> Any:
    """Factorisation with little overhead a solution: PETSc's own on one rank, MUMPS on several."""
    solver = PETSc.PC().create(matrix.comm)
    solver.setOperators(matrix)
    if matrix.comm.size > 1:
        solver.setType("cholesky" if symmetric else "lu")
        solver.setFactorSolverType("mumps")
    else:  # its triangular solves are the quickest for LU ordered by nested dissection
        solver.setType("lu")
        solver.setFactorOrdering("nd")
    solver.setUp()
    return solver


def _whole(structure: Structure, columns: np.ndarray) -> np.ndarray:
    """Columns of all ranks side by side (collective)."""
    return np.concatenate(structure.comm.allgather(columns), axis=1)


def initial_state(
    structure: Structure, initial: PeriodicSolution | tuple[np.ndarray, np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity (n_local,) at time 0: a solution's, two arrays, or rest."""
    if initial is None:
        return np.zeros(structure.n_local), np.zeros(structure.n_local)
    shape = (structure.n_local,)
    state: tuple[np.ndarray, ...]
    if isinstance(initial, PeriodicSolution):
        coefficients, omega = initial.displacement_coefficients, initial.base_omega
        rate = np.zeros_like(coefficients)
        order = omega * np.arange(1, initial.harmonics + 1)[:, None]
        rate[1::2], rate[2::2] = order * coefficients[2::2], -order * coefficients[1::2]
        zero = np.zeros(1)
        state = (evaluate(coefficients, omega, zero)[0], evaluate(rate, omega, zero)[0])
    else:
        try:
            state = tuple(np.asarray(part, dtype=float) for part in initial)
        except (TypeError, ValueError):
            state = ()
    right = len(state) == 2 and all(
        part.shape == shape and np.all(np.isfinite(part)) for part in state
    )
    error = InputError(
        "initial",
        [part.shape for part in state],
        f"a solution of this structure, or finite displacement and velocity of shape {shape}",
    )
    raise_together(structure.comm, None if right else error)
    return state[0], state[1]


def dofs_to_record(structure: Structure, dofs: Sequence[int] | None, key: str) -> np.ndarray:
    """Dofs of this rank to record; all coordinates of a reduced structure, which carry all dofs."""
    first, last = structure.first_dof, structure.first_dof + structure.n_local
    whole = structure.whole
    try:
        wanted = np.arange(first, last) if dofs is None else whole.check_dofs(dofs)
    except InputError as error:
        raise InputError(key, error.value, error.allowed) from None
    if whole is not structure:
        return np.arange(first, last)
    return wanted[(wanted >= first) & (wanted < last)]
