"""Motion in time: the request for a time integration, the loop over its periods, and its record."""

from __future__ import annotations

import math
import time as clock
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields
from functools import cached_property
from inspect import signature
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import (
    RECORDED_PERIODS,
    ConvergenceError,
    InputError,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.basics.progress import begin, reaching
from fenics_crack.basics.ranks import StopRequest, raise_together
from fenics_crack.basics.suggestions import check_options
from fenics_crack.basics.tables import Tabular, counted
from fenics_crack.model.contact import ContactLaw, check_law, coefficient_of, friction_of, is_rigid
from fenics_crack.model.matrices import numbers
from fenics_crack.model.modes import NEGLIGIBLE
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import ObservedMotion, Record
from fenics_crack.numerics.fourier import (
    differentiate,
    evaluate,
    fourier_basis_for,
    fourier_coefficients,
)
from fenics_crack.numerics.newton import motion_size

MEMORY_LIMIT = 2**31
"""Bytes of history on one rank beyond which recording is refused."""

Initial: TypeAlias = PeriodicSolution | tuple[np.ndarray, ...] | None
"""A solution, displacement and velocity, with friction perhaps places, or rest."""


@dataclass(frozen=True)
class March:
    """Request for a time integration: of what, how far, from where, and what is kept; checked
    (collective).

    Attributes
    ----------
    structure : Structure
        Structure that vibrates, under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw
        Law of all pairs.
    periods : int
        Load periods to integrate.
    steps_per_period : int
        Instants in one load period.
    initial : PeriodicSolution, (displacement, velocity), (displacement, velocity, places) or None
        State at time 0: a solution's, arrays (n_local,) [m], [m/s], or rest; with friction also the
        places (n_pairs,) [m] in the tangential gaps where pairs stick, by default those at time 0
        without contact forces.
    settle : float
        Stop early when the relative change over a period is below this, of the gaps and of the
        displacement where the load acts, relative to what moves; ``distance`` of the history
        is what is left.
    record_periods : int, optional
        Keep only the last so many periods.
    dofs : sequence of int, optional
        Record only these displacements. A reduced structure records all.
    progress : bool
        Show a progress bar.

    Raises
    ------
    InputError
        One of them cannot be used, or the history would not fit in memory.
    """

    structure: Structure
    omega: float
    contact: ContactLaw
    periods: int
    steps_per_period: int
    initial: Initial = None
    settle: float = 0.0
    record_periods: int | None = None
    dofs: Sequence[int] | None = None
    progress: bool = False

    def __post_init__(self) -> None:
        check_omega(self.omega)
        check_law(self.structure, self.contact, rigid=True)
        check_count("periods", self.periods, 1)
        check_count("steps_per_period", self.steps_per_period, 1)
        if self.record_periods is not None:
            check_count("record_periods", self.record_periods, 1)
        check_number("settle", self.settle, 0.0)
        most = max(self.structure.comm.allgather(len(self.recorded_dofs)))
        instants = self.kept * self.steps_per_period
        if 8 * instants * (most + 2 * self.n_rows) > MEMORY_LIMIT:
            what, room = f"{instants} instants of {most} dofs", f"{MEMORY_LIMIT // 2**30} GiB"
            allowed = f"fewer, or fewer dofs: {what} do not fit in {room}"
            raise InputError("record_periods", self.record_periods, allowed)
        _ = self.start

    @classmethod
    def of(cls, function: Callable[..., Any], options: Mapping[str, Any], *given: Any) -> March:
        """The request of a function, of what it is given and of options."""
        named = signature(function).parameters.values()
        known = [one.name for one in named if one.kind is one.KEYWORD_ONLY]
        known += [one.name for one in fields(cls) if one.default is not MISSING]
        check_options(function.__name__, options, known)
        return cls(*given, **options)

    @property
    def kept(self) -> int:
        """Periods that are recorded."""
        return min(self.record_periods or self.periods, self.periods)

    @property
    def step_size(self) -> float:
        """From one instant to the next [s]."""
        return 2.0 * np.pi / self.omega / self.steps_per_period

    @cached_property
    def start(self) -> tuple[np.ndarray, ...]:
        """Displacement and velocity (n_local,) at time 0; behind them with friction, where it is
        stated, where pairs stick (n_pairs,) [m]."""
        return initial_state(self.structure, self.contact, self.initial)

    @cached_property
    def recorded_dofs(self) -> np.ndarray:
        """Dofs that this rank records: all of a reduced structure, which carry those requested."""
        first, last = self.structure.first_dof, self.structure.first_dof + self.structure.n_local
        everything, whole = np.arange(first, last), self.structure.whole
        if self.dofs is None:
            return everything
        wanted = whole.check_dofs(self.dofs)
        if whole is not self.structure:
            return everything
        return wanted[(wanted >= first) & (wanted < last)]

    @cached_property
    def load_rows(self) -> np.ndarray:
        """Rows of this rank where the load is not zero."""
        return np.flatnonzero(np.any(self.structure.force, axis=0))

    @cached_property
    def waves(self) -> np.ndarray:
        """1, cos and sin of the multiples of the load's phase at the instants of a period: (N,
        2K+1)."""
        instants = np.arange(self.steps_per_period) / self.steps_per_period
        return fourier_basis_for(self.structure.force, 2.0 * np.pi * instants)

    @cached_property
    def load(self) -> np.ndarray:
        """Load at these instants and rows: (N, rows) [N]."""
        return np.asarray(self.waves @ self.structure.force[:, self.load_rows])

    @property
    def n_rows(self) -> int:
        """Rows of contact: normals of all pairs, with friction behind them tangents."""
        return self.structure.n_pairs * (1 if friction_of(self.contact) is None else 2)

    @property
    def rigid(self) -> bool:
        """True if nothing penetrates."""
        return is_rigid(self.contact)


@dataclass(frozen=True, repr=False)
class TimeHistory(ObservedMotion, Tabular):
    """The last periods of a motion found by direct integration.

    Attributes
    ----------
    time : (n,) [s]
        Equally spaced; the load's phase is omega * time.
    gap : (n, n_pairs) [m]
        g = B^T u - g0; g > 0: penetration.
    settled : float
        Relative change over the last period, of the gaps or of the displacement where the load
        acts, whichever is larger; a small number says that the motion repeats with the load.
        Relative to what moves: means over the period count no more than all else.
    created_energy : float
        Net energy created, relative to the energy put in by the load and the initial state. Central
        differences: by contact that opens and closes between steps; it vanishes like dt^2.
        Exponential steps: what is missing in the energy balance at the end of the last period.
        Negative: lost; with a constraint impacts lose energy whatever the step.
    periods : int
        Load periods integrated; fewer than requested where the motion settled, or Ctrl-C stopped it
        at the end of a period.
    seconds : float
        Wall-clock time of the integration [s].
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
    """(n, n_recorded) [m], the dofs of ``recorded_dofs`` that this rank owns."""
    recorded_dofs: np.ndarray
    final_state: tuple[np.ndarray, ...]
    """Displacement [m] and velocity [m/s] (n_local,) at the end of the last period, with friction
    also the places (n_pairs,) [m] where pairs stick: ``initial`` of a run that goes on, at the same
    frequency or another."""
    contact_force: np.ndarray
    """(n, n_pairs) [N]; with a constraint the mean force from this instant to the next."""
    tangential_gap: np.ndarray | None = None
    """g_t of contact with friction: (n, n_pairs) [m]."""
    tangential_force: np.ndarray | None = None
    """lambda_t, likewise [N]."""
    friction: float | np.ndarray | None = None
    """mu, of all pairs or of each."""

    KIND: ClassVar[str] = "time history"

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every instant: displacement of the watched dof, and of the crack faces
        the opening and the contact force of the pair where each is largest."""
        found = {"time": self.time, "displacement": self.displacement()[:, 0]}
        if self.gap.size:
            found["opening"] = np.maximum(0.0, -self.gap.min(axis=1))
            found["contact_force"] = self.contact_force.max(axis=1)
        return {name: column.tolist() for name, column in found.items()}

    def _title(self) -> str:
        periods = counted(self.periods, "period")
        steps = counted(self.steps_per_period, "step")
        settled = f", settled to {self.settled:.0e}" if np.isfinite(self.settled) else ""
        return f"{periods} of {steps}{settled}, {counted(self.structure.n_pairs, 'pair')}"

    def by_period(self, values: np.ndarray) -> np.ndarray:
        """Fold a record (n, ...) at the load's period: (periods kept, steps_per_period, ...).

        The mean over the first axis is the phase average, the standard deviation its spread.
        """
        periods = len(values) // self.steps_per_period
        return values.reshape(periods, self.steps_per_period, *values.shape[1:])

    @property
    def distance(self) -> float:
        """Distance of the motion from the one that it settles to, relative as ``settled`` is, of
        the gaps or of the displacement watched, if that is recorded, whichever is larger.

        The limit of a motion with two multipliers left follows from its last four periods
        (minimal polynomial extrapolation; Sidi, Vector Extrapolation Methods, chapter 2). nan
        with fewer than three periods kept (collective).
        """
        kept = [one[-RECORDED_PERIODS:] for one in self._watched]
        if len(kept[0]) < 3:
            return math.nan
        sizes = _sizes([one[-1] for one in kept])
        rows = [one.reshape(len(one), -1) / size for one, size in zip(kept, sizes, strict=True)]
        changes = np.diff(np.hstack(rows), axis=0)
        weights = np.append(np.linalg.lstsq(changes[:-1].T, -changes[-1], rcond=None)[0], 1.0)
        left = (np.tensordot(weights, one[:-1] - one[-1], 1) for one in rows)
        whole = abs(float(weights.sum()))
        return max(float(np.linalg.norm(one)) for one in left) / whole if whole > 0.0 else math.inf

    def change(self, periods: int = 1) -> float:
        """Relative change of the motion over the last so many periods, of the gaps or of the
        displacement watched, if that is recorded, whichever is larger: what ``settled`` is of one
        (collective).

        Raises
        ------
        InputError
            No more periods than these are recorded.
        """
        check_count("periods", periods, 1)
        kept = self._watched
        if periods >= len(kept[0]):
            raise InputError("periods", periods, f"fewer than the {len(kept[0])} recorded")
        return _change([one[-1] for one in kept], [one[-1 - periods] for one in kept])

    @property
    def _watched(self) -> list[np.ndarray]:
        """B^T u and the displacement watched, if that is recorded, by period (collective)."""
        parts = [self.gap + self.structure.clearance]
        with suppress(InputError):
            parts.append(self.displacement())
        return [self.by_period(one) for one in parts]

    def displacement(self, dofs: Sequence[int | None] = (None,)) -> np.ndarray:
        """Displacement of recorded dofs, or of the watched one: (n, len(dofs)) [m] (collective).

        Raises
        ------
        InputError
            A dof was not recorded.
        """
        if self.structure.whole is not self.structure:
            return self.structure.values_at(self.recorded, dofs)
        wanted = self.structure.check_dofs(dofs)
        chosen = (self.recorded_dofs[:, None] == wanted).astype(float)
        times = self.structure.sum_over_ranks(chosen.sum(axis=0))  # a dof may be recorded twice
        if not times.all():
            raise InputError("dofs", wanted[times == 0.0].tolist(), "among those recorded")
        return self.structure.sum_over_ranks(self.recorded @ (chosen / times))

    def records(self, rows: np.ndarray) -> Iterator[Record]:
        """The motion, seen through rows (m, n_local): of the products with its displacement, their
        harmonics, as many as the instants of a period allow, of the last period (collective).

        Raises
        ------
        InputError
            A dof that they take was not recorded.
        """
        structure = self.structure
        own, first = np.unique(self.recorded_dofs - structure.first_dof, return_index=True)
        if any(structure.comm.allgather(bool(np.any(np.delete(rows, own, axis=1))))):
            allowed = "None, to record all displacements, of which these are made"
            raise InputError("dofs", "some", allowed)
        motion = structure.sum_over_ranks(self.recorded[:, first] @ rows[:, own].T)
        steps, gap, force = self.steps_per_period, self.gap, self.contact_force
        if self.tangential_gap is not None and self.tangential_force is not None:
            gap = np.hstack([gap, self.tangential_gap])
            force = np.hstack([force, self.tangential_force])
        yield Record(
            2.0 * np.pi * (len(self.time) - 1) / steps / np.ptp(self.time), 1, self.time,
            fourier_coefficients(motion[-steps:], min(10, (steps - 1) // 2)), motion, gap, force,
            structure=structure,
            friction=self.friction,
            steps=steps,
        )  # fmt: skip


class Window(NamedTuple):
    """Room for one period of a time integration, a row for each instant."""

    gap: np.ndarray
    force: np.ndarray
    motion: np.ndarray
    """Displacement of the recorded dofs."""
    load_motion: np.ndarray
    """Displacement where the load acts."""


class Scheme(ABC):
    """Scheme for :func:`march`, which starts at time 0."""

    name: ClassVar[str]
    remedy: ClassVar[str]
    """Remedy where contact creates energy."""
    created_share = 0.0
    """Energy created relative to the energy put in."""
    owned: tuple[Any, ...] = ()
    """PETSc's objects, to be freed after the integration."""

    @abstractmethod
    def fill(self, window: Window, number: int) -> None:
        """Integrate period ``number``, record it, and add up its energy."""

    @abstractmethod
    def state(self) -> tuple[np.ndarray, ...]:
        """Displacement and velocity, with friction also places, after whole periods, from which a
        time integration can go on."""

    def book(self, created: float, put_in: float) -> None:
        """State energies [J]; ConvergenceError where contact has created too much."""
        if put_in > 0.0:
            self.created_share = created / put_in
        if not np.isfinite(created) or created > 2.0 * put_in > 0.0:
            creates = f"{self.created_share:.3g} times the energy put in; {self.remedy}"
            long = f"{self.name}: the steps are too long for this contact, which creates"
            raise ConvergenceError(f"{long} {creates}")


def march(asked: March, scheme: Scheme) -> TimeHistory:
    """Integrate a scheme, period by period, until it settles, and free it (collective)."""
    structure, kept, steps = asked.structure, asked.kept, asked.steps_per_period
    widths = asked.n_rows, asked.n_rows, len(asked.recorded_dofs)
    records: list[np.ndarray] = [np.empty((kept * steps, width)) for width in widths]
    gap, force, motion = records
    load_motion = np.empty((steps, len(asked.load_rows)))
    done = 0
    before: tuple[np.ndarray, np.ndarray] | None = None
    hidden = not asked.progress or structure.comm.rank != 0
    if not hidden:
        begin("")
    from tqdm import tqdm

    started = clock.perf_counter()
    with StopRequest() as stop, reaching(lambda: f"{done} of {asked.periods} periods"):
        for number in tqdm(range(asked.periods), scheme.name, unit="period", disable=hidden):
            place = slice(number % kept * steps, (number % kept + 1) * steps)
            window = Window(gap[place], force[place], motion[place], load_motion)
            scheme.fill(window, number)
            done = number + 1
            moved = np.concatenate(structure.comm.allgather(load_motion), axis=1)
            closing = window.gap[:, : structure.n_pairs] + structure.clearance
            now = closing, moved  # slow modes hardly move the gaps
            settled, before = np.inf if before is None else _change(now, before), now
            if settled < asked.settle or stop.asked(structure.comm):
                break
    seconds = clock.perf_counter() - started

    count = min(done, kept) * steps
    newest = done % kept * steps if done > kept else 0
    gap, force, motion = (np.roll(rows[:count], -newest, axis=0) for rows in records)
    final_state = scheme.state()
    for item in scheme.owned:
        item.destroy()
    pairs, coefficient = structure.n_pairs, coefficient_of(asked.contact)
    known = coefficient is not None
    return TimeHistory(
        time=np.arange(done * steps - count, done * steps) * asked.step_size,
        gap=gap[:, :pairs],
        settled=settled,
        created_energy=scheme.created_share,
        periods=done,
        seconds=seconds,
        steps_per_period=steps,
        structure=structure,
        recorded=motion,
        recorded_dofs=asked.recorded_dofs,
        final_state=final_state,
        contact_force=force[:, :pairs],
        tangential_gap=gap[:, pairs:] if known else None,
        tangential_force=force[:, pairs:] if known else None,
        friction=coefficient,
    )


def _change(now: Sequence[np.ndarray], before: Sequence[np.ndarray]) -> float:
    """The largest relative change of parts of a motion, (N, m) each, from one period to another."""
    parts = zip(now, before, _sizes(now), strict=True)
    return max(float(np.linalg.norm(one - was)) / size for one, was, size in parts)


def _sizes(parts: Sequence[np.ndarray]) -> list[float]:
    """Return the sizes of the moving parts of a motion, (N, m) each over a period: a clearance or a
    steady load may make means as large as they like.

    Infinite, so that no change of it counts, where a part is rounding relative to the largest
    one, as the gaps of rigid crack faces that stay closed.
    """
    sizes = [motion_size(part) for part in parts]
    return [size if size > NEGLIGIBLE * max(sizes) else math.inf for size in sizes]


def initial_state(
    structure: Structure, contact: ContactLaw, initial: Initial
) -> tuple[np.ndarray, ...]:
    """Displacement and velocity (n_local,) at time 0, of a solution or of arrays, or rest; behind
    them with friction, where it is stated, where pairs stick (n_pairs,) [m] (collective)."""
    if initial is None:
        return np.zeros(structure.n_local), np.zeros(structure.n_local)
    initial = getattr(initial, "result", initial)  # of a Run
    rubs = friction_of(contact) is not None
    state: tuple[np.ndarray, ...]
    if isinstance(initial, PeriodicSolution):
        coefficients, omega = initial.displacement_coefficients, initial.base_omega
        both = coefficients, differentiate(coefficients, omega)
        state = tuple(evaluate(wave, omega, np.zeros(1))[0] for wave in both)
        if rubs and friction_of(initial.contact) is not None:
            state = *state, initial.sticking_places(np.zeros(1))[0]
    else:
        try:
            state = tuple(numbers(part) for part in initial)
        except TypeError:
            state = ()
    shapes = (structure.n_local,), (structure.n_local,), (structure.n_pairs,)
    fits = [part.shape == shape for part, shape in zip(state, shapes, strict=False)]
    right = all(fits) and len(state) in ((2, 3) if rubs else (2,))
    allowed = (
        f"a solution of this structure, or finite displacement and velocity of shape {shapes[0]} "
        f"as two arrays, with friction a third of finite places, of shape {shapes[2]}"
    )
    error = InputError("initial", [part.shape for part in state], allowed)
    finite = all(np.all(np.isfinite(part)) for part in state)
    raise_together(structure.comm, None if right and finite else error)
    return state
