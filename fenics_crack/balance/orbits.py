"""Periodic orbits of a flow as a system of equations: z(T) = z(0).

In x = z / |z_0| and p = w / w_0, z_0 and w_0 those of a motion nearby, an orbit solves

    F(x, p) = z(T; x, p) / |z_0| - x = 0,        T = 2 pi m / w,

z the state at phase zero, m the periods of the load in the response's; dF/dx = M - I with the
monodromy matrix M, dF/dp by central differences.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from fenics_crack.balance.linearisation import DenseLinearisation
from fenics_crack.model.flow import ExponentialFlow, Steps
from fenics_crack.motion.orbit import eigenvalues

__all__ = ["INSTANTS", "MarchedOrbits", "OrbitPoint", "Orbits", "recurrences"]

DIFFERENCE = 1e-6
"""Of p, for dF/dp."""
INSTANTS = 512
"""At which the gaps of an orbit are kept."""


class _Sloped(Protocol):
    def by_parameter(self, unknown: np.ndarray, parameter: float) -> np.ndarray: ...


class OrbitPoint(DenseLinearisation):
    """The equations of exact orbits at a state and a frequency.

    Attributes
    ----------
    events : int
        Switching instants in the period.
    """

    def __init__(
        self,
        system: _Sloped,
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


def recurrences(passed: Sequence[np.ndarray] | np.ndarray, count: int) -> list[int]:
    """Where orbits are sought in a motion, of states (n, ...) a period apart: the last of them, and
    those from which the motion came nearest to where it had been, the nearest first."""
    apart = np.linalg.norm(np.diff(passed, axis=0), axis=1)
    return [-1, *map(int, np.argsort(apart, kind="stable")[:count])]


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
