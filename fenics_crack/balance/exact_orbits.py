"""Periodic orbits of the exact flow as a system of equations, next to a solution or without any.

Where harmonic balance finds none, one is sought in the motion itself: it settles to an orbit that
attracts it. Where none does it wanders, and passes near orbits that it leaves again, at times when
it nearly repeats itself; from there Newton's method finds one.

Source of recurrences: Auerbach et al., Physical Review Letters 58 (1987) 2387-2389.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_crack.balance.bordered import PathPoint, solve_in_plane
from fenics_crack.balance.nearby import wave_states
from fenics_crack.balance.orbits import FlowOrbits, recurrences
from fenics_crack.balance.problem import Problem
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import is_piecewise_linear
from fenics_crack.model.modal import is_small
from fenics_crack.motion.flow import flow_of
from fenics_crack.stages import begin

__all__ = ["FEW_PAIRS", "exact_next_to", "judged_by_orbits", "next_to", "recurring"]

FEW_PAIRS, CLOSED = 4, 1e-8
"""Up to so many with mass at their lips are judged by exact orbits: many switch too often; and how
closely an orbit next to a solution repeats itself."""
STEPS, SHORTEST, PATIENCE = 15, 0.01, 6
"""Newton steps from a solution to the orbit next to it, how short, and how many of them may
together fail to halve the residual."""
SETTLING = 10
"""Periods that the motion is followed for where no orbit is found next to a solution itself."""
QUICK = 100
"""Unknowns of a structure up to which a solution is sought among its orbits."""
WANDERING = ((500, 60), (1000, 200))
"""Periods that a motion is followed for, and its nearest recurrences that Newton's method starts
from; again with more of both where that finds no orbit."""
FEW_UNKNOWNS = 12
"""Of a structure, up to which all those starts are tried; beyond, fewer, as each takes longer."""
FROM_AFAR = 40
"""Newton steps from a recurrence."""


def judged_by_orbits(problem: Problem) -> bool:
    """Whether the flow of a problem is known in closed form, from event to event, and its pairs and
    its unknowns are few."""
    structure = problem.structure
    closed_form = is_small(structure) and is_piecewise_linear(problem.contact)
    few = structure.n_pairs <= FEW_PAIRS and structure.n_dofs <= QUICK
    return closed_form and few and not structure.light_lips


def orbits_from(problem: Problem, displacement: np.ndarray) -> FlowOrbits:
    """The orbits of the exact flow of a problem, beginning where a wave of the displacement is at
    phase zero, given by its coefficients (2H+1, n_dofs) [m]."""
    flow = flow_of(problem.structure, problem.contact)
    assert flow is not None
    state = wave_states(flow, displacement, problem.base_omega)[0]
    return FlowOrbits(flow, problem.omega, state, problem.subharmonic)


def next_to(orbits: FlowOrbits, settling: Sequence[int] = (0, SETTLING)) -> PathPoint | None:
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


def recurring(orbits: FlowOrbits) -> PathPoint | None:
    """An orbit that the motion from the start settles to, or passes on its way; None where none is
    found."""
    passed = [orbits.start]
    share = min(1.0, (2.0 * FEW_UNKNOWNS / len(orbits.start)) ** 2)
    for periods, starts in WANDERING:
        begin(f"the exact motion over {periods} periods, and orbits that it passes")
        try:
            for _ in range(periods):
                passed.append(orbits.moved(passed[-1], 1.0))
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
