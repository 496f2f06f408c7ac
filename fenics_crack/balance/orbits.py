"""Periodic orbits of a flow as a system of equations: z(T) = z(0).

In x = z / |z_0| and p = w / w_0, z_0 and w_0 those of a motion nearby, an orbit solves

    F(x, p) = z(T; x, p) / |z_0| - x = 0,        T = 2 pi m / w,

z the state at phase zero, m the periods of the load in the response's; dF/dx = M - I with the
monodromy matrix M, dF/dp by central differences.

Next to a harmonic-balance solution such an orbit tells its error where nothing that is balanced
does: :func:`exact_next_to`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dgeev

from fenics_crack.balance.bordered import solve_in_plane
from fenics_crack.balance.linearisation import DenseLinearisation
from fenics_crack.balance.problem import Problem
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import is_piecewise_linear
from fenics_crack.model.exact_flow import EventFlow
from fenics_crack.model.flow import ExponentialFlow, Steps
from fenics_crack.model.modal import is_small

__all__ = [
    "FEW_PAIRS",
    "INSTANTS",
    "EventOrbits",
    "MarchedOrbits",
    "OrbitPoint",
    "Orbits",
    "eigenvalues",
    "exact_next_to",
    "judged_by_orbits",
]

DIFFERENCE = 1e-6
"""Of p, for dF/dp."""
INSTANTS = 512
"""At which the gaps of an orbit are kept."""
FEW_PAIRS, CLOSED = 4, 1e-8
"""Up to so many with mass at their lips are judged by exact orbits: many switch too often; and how
closely an orbit next to a solution repeats itself."""
SETTLING = 10
"""Periods that the motion is followed for where no orbit is found next to a solution itself."""
QUICK = 100
"""Unknowns of a structure up to which its error is judged by an exact orbit: that takes 0.25 s with
50, 0.8 s with 84, and 44 s with 336."""


class OrbitPoint(DenseLinearisation):
    """The equations of exact orbits at a state and a frequency.

    Attributes
    ----------
    events : int
        Switching instants in the period.
    """

    def __init__(
        self,
        system: Orbits,
        at: tuple[np.ndarray, float],
        residual: np.ndarray,
        monodromy: Callable[[], np.ndarray],
        events: int,
    ) -> None:
        self._system, self._parameter, self._monodromy, self.events = (
            system, at[1], monodromy, events,
        )  # fmt: skip
        super().__init__(at[0], residual)

    @cached_property
    def monodromy(self) -> np.ndarray:
        """M = dz(T)/dz: (2n, 2n)."""
        return self._monodromy()

    def assemble(self) -> np.ndarray:
        """M - I."""
        return self.monodromy - np.eye(len(self.monodromy))

    def differentiate(self) -> np.ndarray:
        """dF/dp."""
        return self._system.by_parameter(self.unknown, self._parameter)

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Floquet multipliers, largest modulus first: (2n,) complex."""
        values = eigenvalues(self.monodromy)
        return values[np.argsort(-np.abs(values), kind="stable")]


class Orbits(ABC):
    """F(x, p) of the orbits of a flow.

    Attributes
    ----------
    omega : float
        w_0, of the load [rad/s].
    start : (2n,)
        x of the motion nearby, at p = 1.
    """

    matrix_free = False

    def __init__(self, omega: float, state: np.ndarray) -> None:
        self.omega = omega
        self._size = float(np.linalg.norm(state)) or 1.0
        self.start = state / self._size

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """The equations at (x, p)."""
        moved, monodromy, events = self.moved(unknown, parameter)
        return OrbitPoint(self, (unknown, parameter), moved - unknown, monodromy, events)

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return float(first @ second)

    def followed(self, periods: int) -> np.ndarray:
        """The start after some periods of the response, nearer to what attracts it: (2n,)."""
        state = self.start
        for _ in range(periods):
            state = self.moved(state, 1.0)[0]
        return state

    @abstractmethod
    def moved(
        self, unknown: np.ndarray, parameter: float
    ) -> tuple[np.ndarray, Callable[[], np.ndarray], int]:
        """z(T) / |z_0|; what computes M; switching instants."""

    def by_parameter(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """dF/dp at fixed x, by central differences."""
        after, before = (self.moved(unknown, parameter + h)[0] for h in (DIFFERENCE, -DIFFERENCE))
        return (after - before) / (2.0 * DIFFERENCE)


def eigenvalues(matrix: np.ndarray) -> np.ndarray:
    """All of a monodromy matrix; straight from LAPACK, for small matrices a tenth of NumPy's
    time."""
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("the monodromy matrix is not finite")
    real, imaginary, _, _, info = dgeev(matrix, compute_vl=0, compute_vr=0)
    if info:
        raise np.linalg.LinAlgError("eigenvalues of the monodromy matrix do not converge")
    found: np.ndarray = real + 1j * imaginary
    return found


class MarchedOrbits(Orbits):
    """Of the flow by exponential steps."""

    def __init__(self, flow: ExponentialFlow, state: np.ndarray, subharmonic: int = 1) -> None:
        super().__init__(flow.omega, state)
        self._flow, self._periods = flow, subharmonic

    def flow_at(self, parameter: float) -> ExponentialFlow:
        """The flow where the frequency has a value."""
        omega = parameter * self.omega
        if omega != self._flow.omega:
            self._flow = self._flow.at(omega)
        return self._flow

    def steps(self, unknown: np.ndarray, parameter: float) -> Steps:
        """A period from a state."""
        return self.flow_at(parameter).advance(self._size * unknown, self._periods)

    def moved(
        self, unknown: np.ndarray, parameter: float
    ) -> tuple[np.ndarray, Callable[[], np.ndarray], int]:
        steps = self.steps(unknown, parameter)
        return steps.states[-1] / self._size, steps.monodromy, steps.switches

    def by_parameter(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        here, moved = self.flow_at(parameter), []
        for other in (parameter + DIFFERENCE, parameter - DIFFERENCE):
            flow = here.at(other * self.omega)
            moved.append(flow.advance(self._size * unknown, self._periods).states[-1])
        return np.asarray((moved[0] - moved[1]) / (2.0 * DIFFERENCE * self._size))


class EventOrbits(Orbits):
    """Of the exact flow."""

    def __init__(self, flow: EventFlow, state: np.ndarray, subharmonic: int = 1) -> None:
        super().__init__(flow.omega, state)
        self._flow, self._turns = flow, 2.0 * np.pi * subharmonic

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

    def gap(self, unknown: np.ndarray, parameter: float, count: int = INSTANTS) -> np.ndarray:
        """Over a period, at equally spaced instants: (count, n_pairs) [m]."""
        flow, period = self.flow_at(parameter), self._turns / (parameter * self.omega)
        instants = np.arange(count) * period / count
        gap = flow.advance(self._size * unknown, 0.0, period, instants=instants)[1]
        return np.asarray(gap - flow.structure.clearance)


def judged_by_orbits(problem: Problem) -> bool:
    """Whether the flow of a problem is known in closed form, from event to event, and its pairs and
    its unknowns are few."""
    structure = problem.structure
    closed_form = is_small(structure) and is_piecewise_linear(problem.contact)
    few = structure.n_pairs <= FEW_PAIRS and structure.n_dofs <= QUICK
    return closed_form and few and not structure.light_lips


def exact_next_to(problem: Problem, displacement: np.ndarray, count: int) -> np.ndarray | None:
    """The gap (count, n_pairs) [m] over a period of the orbit of the exact flow next to a solution
    of a problem that is :func:`judged_by_orbits`, given by the coefficients of its displacement
    (2H+1, n_dofs) [m]; None where there is none."""
    order = np.arange(1, problem.harmonics + 1)
    flow = EventFlow(problem.structure, problem.omega, problem.contact)
    rate = problem.base_omega * order @ displacement[2::2]
    state = flow.state(displacement[0] + displacement[1::2].sum(axis=0), rate)
    orbits = EventOrbits(flow, state, problem.subharmonic)
    try:
        for periods in (0, SETTLING):
            found = solve_in_plane(
                orbits, orbits.followed(periods), 1.0, None,
                tolerance=CLOSED, iterations=15, least_damping=0.01, patience=6,
            )  # fmt: skip
            if found is not None:
                return orbits.gap(found.unknown, 1.0, count)
    except ConvergenceError:  # pairs that chatter without end
        pass
    return None
