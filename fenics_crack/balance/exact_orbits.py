"""Periodic orbits of the exact flow, next to a solution or without any.

Next to a harmonic-balance solution such an orbit tells its error where nothing that is balanced
does. Where harmonic balance finds none, one is sought in the motion itself: it settles to an orbit
that attracts it. Where none does it wanders, and passes near orbits that it leaves again, at times
when it nearly repeats itself; from there Newton's method finds one.

Source of recurrences: Auerbach et al., Physical Review Letters 58 (1987) 2387-2389.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fenics_crack.balance.bordered import PathPoint, solve_in_plane
from fenics_crack.balance.compiled import CompiledPaths
from fenics_crack.balance.orbits import INSTANTS, OrbitPoint, Orbits, recurrences
from fenics_crack.balance.problem import Problem
from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import Struct, doubles, kernel, owned, shaped
from fenics_crack.model.contact import is_piecewise_linear
from fenics_crack.model.exact_flow import LONGEST_SEARCH, MAX_EVENTS, EventFlow
from fenics_crack.model.modal import is_small
from fenics_crack.stages import begin

__all__ = ["FEW_PAIRS", "EventOrbits", "exact_next_to", "judged_by_orbits", "next_to", "recurring"]

FEW_PAIRS, CLOSED = 4, 1e-8
"""Up to so many with mass at their lips are judged by exact orbits: many switch too often; and how
closely an orbit next to a solution repeats itself."""
STEPS, SHORTEST, PATIENCE = 15, 0.01, 6
"""Newton steps from a solution to the orbit next to it, how short, and how many of them may
together fail to halve the residual."""
SETTLING = 10
"""Periods that the motion is followed for where no orbit is found next to a solution itself."""
QUICK = 100
"""Unknowns of a structure up to which its error is judged by an exact orbit: that takes 0.25 s with
50, 0.8 s with 84, and 44 s with 336."""
WANDERING = ((500, 60), (1000, 200))
"""Periods that a motion is followed for, and its nearest recurrences that Newton's method starts
from; again with more of both where that finds no orbit."""
FEW_UNKNOWNS = 12
"""Of a structure, up to which all those starts are tried; beyond, fewer, as each takes longer."""
FROM_AFAR = 40
"""Newton steps from a recurrence."""


class EventOrbits(Orbits):
    """F(x, p) of the exact flow, in the kernel too."""

    def __init__(self, flow: EventFlow, state: np.ndarray, subharmonic: int = 1) -> None:
        super().__init__(flow.omega, state)
        self._flow, self._turns = flow, 2.0 * np.pi * subharmonic
        self.compiled = _CompiledOrbits(self, flow.at(self.omega), self._size, self._turns)

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """The equations at (x, p)."""
        return self.compiled.linearise(unknown, parameter)

    def by_parameter(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """dF/dp at fixed x, by central differences."""
        return self.compiled.slope(unknown, parameter)

    def flow_at(self, parameter: float) -> EventFlow:
        """The flow where the frequency has a value."""
        omega = parameter * self.omega
        if omega != self._flow.omega:
            self._flow = self._flow.at(omega)
        return self._flow

    def moved(
        self, unknown: np.ndarray, parameter: float
    ) -> tuple[np.ndarray, Callable[[], np.ndarray], int]:
        period = self._turns / (parameter * self.omega)
        flow = self.flow_at(parameter)
        moved, _, monodromy, events = flow.advance(self._size * unknown, 0.0, period)
        return moved / self._size, monodromy, events

    def state(self, unknown: np.ndarray) -> np.ndarray:
        """z of x: (2n,)."""
        return np.asarray(self._size * unknown)

    def unknown(self, state: np.ndarray) -> np.ndarray:
        """x of z: (2n,)."""
        return np.asarray(state / self._size)

    def sampled(
        self, unknown: np.ndarray, parameter: float, count: int, rows: np.ndarray | None = None,
        later: float = 0.0,
    ) -> np.ndarray:  # fmt: skip
        """``rows @ z``, by default B^T u [m], at equally spaced instants of a period, ``later`` by
        a part of their spacing: (count, n_rows)."""
        flow, period = self.flow_at(parameter), self._turns / (parameter * self.omega)
        instants = (np.arange(count) + later) * period / count
        return flow.advance(self.state(unknown), 0.0, period, instants=instants, rows=rows)[1]

    def gap(
        self, unknown: np.ndarray, parameter: float, count: int = INSTANTS, later: float = 0.0
    ) -> np.ndarray:
        """g there: (count, n_pairs) [m]."""
        moved = self.sampled(unknown, parameter, count, later=later)
        return np.asarray(moved - self._flow.structure.clearance)


class _CompiledOrbits(CompiledPaths):
    """The equations in the kernel, with a flow of their own."""

    def __init__(self, orbits: EventOrbits, flow: EventFlow, size: float, turns: float) -> None:
        self.shape = orbits.start.shape
        self._orbits, self._flow = orbits, flow
        given = Struct(
            "orbit_equations", flow=flow.known.at, omega=orbits.omega, size=size, turns=turns,
            longest=LONGEST_SEARCH, most=MAX_EVENTS,
        )  # fmt: skip
        self._point = owned(kernel.new_orbit_point(given.at), kernel.free_orbit_point)
        self._equations = kernel.equations_of_orbit(self._point)

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """The equations at a point."""
        self._evaluate(unknown, parameter)
        return self._found(unknown, parameter)

    def slope(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """dF/dp."""
        found = np.empty(self.shape)
        self._evaluate(unknown, parameter)
        self._equations.by_parameter(self._equations, doubles(found))
        return found

    def _evaluate(self, unknown: np.ndarray, parameter: float) -> None:
        given, outcome = doubles(shaped(unknown, *self.shape)), kernel.NEW_SET
        while outcome == kernel.NEW_SET:
            outcome = self._equations.evaluate(self._equations, given, parameter)
            self._check(outcome)
        if outcome == kernel.NOT_FOUND:
            self._orbits.moved(unknown, parameter)  # says why
            raise ConvergenceError("events: no motion over the period")

    def _found(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        residual, monodromy = np.empty(self.shape), np.empty(2 * self.shape)
        self._equations.residual(self._equations, doubles(residual))
        kernel.monodromy_of(self._point, doubles(monodromy))
        events = int(kernel.events_of(self._point))
        return OrbitPoint(self._orbits, (unknown, parameter), residual, lambda: monodromy, events)

    def _check(self, outcome: int) -> None:
        if outcome == kernel.NO_MEMORY:
            raise MemoryError("exact orbits")
        if outcome == kernel.NEW_SET:
            self._flow.make(kernel.new_set_of(self._point))


def judged_by_orbits(problem: Problem) -> bool:
    """Whether the flow of a problem is known in closed form, from event to event, and its pairs and
    its unknowns are few."""
    structure = problem.structure
    closed_form = is_small(structure) and is_piecewise_linear(problem.contact)
    few = structure.n_pairs <= FEW_PAIRS and structure.n_dofs <= QUICK
    return closed_form and few and not structure.light_lips


def orbits_from(problem: Problem, displacement: np.ndarray) -> EventOrbits:
    """The orbits of the exact flow of a problem, beginning where a wave of the displacement is at
    phase zero, given by its coefficients (2H+1, n_dofs) [m]."""
    order = np.arange(1, len(displacement) // 2 + 1)
    flow = EventFlow(problem.structure, problem.omega, problem.contact)
    rate = problem.base_omega * order @ displacement[2::2]
    state = flow.state(displacement[0] + displacement[1::2].sum(axis=0), rate)
    return EventOrbits(flow, state, problem.subharmonic)


def next_to(orbits: EventOrbits, settling: Sequence[int] = (0, SETTLING)) -> PathPoint | None:
    """The orbit next to the start, or next to where the motion from there is after some periods;
    None where there is none."""
    try:
        for periods in settling:
            found = solve_in_plane(
                orbits, orbits.followed(periods), 1.0, None,
                tolerance=CLOSED, iterations=STEPS, least_damping=SHORTEST, patience=PATIENCE,
            )  # fmt: skip
            if found is not None:
                return found
    except ConvergenceError:  # pairs that chatter without end
        pass
    return None


def exact_next_to(problem: Problem, displacement: np.ndarray, count: int) -> np.ndarray | None:
    """The gap (count, n_pairs) [m] over a period of the orbit of the exact flow next to a solution
    of a problem that is :func:`judged_by_orbits`, given by the coefficients of its displacement
    (2H+1, n_dofs) [m]; None where there is none."""
    orbits = orbits_from(problem, displacement)
    found = next_to(orbits)
    return None if found is None else orbits.gap(found.unknown, 1.0, count)


def recurring(orbits: EventOrbits) -> PathPoint | None:
    """An orbit that the motion from the start settles to, or passes on its way; None where none is
    found."""
    passed = [orbits.start]
    share = min(1.0, (2.0 * FEW_UNKNOWNS / len(orbits.start)) ** 2)
    for periods, starts in WANDERING:
        begin(f"the exact motion over {periods} periods, and orbits that it passes")
        try:
            for _ in range(periods):
                passed.append(orbits.moved(passed[-1], 1.0)[0])
        except ConvergenceError:  # pairs that chatter without end
            pass
        for place in recurrences(passed, int(np.ceil(share * starts))):
            try:
                found = solve_in_plane(
                    orbits, passed[place], 1.0, None, tolerance=CLOSED,
                    iterations=FROM_AFAR, least_damping=SHORTEST / 3, patience=PATIENCE + 4,
                )  # fmt: skip
            except ConvergenceError:
                continue
            if found is not None:
                return found
    return None
