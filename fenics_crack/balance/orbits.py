"""Periodic orbits of a flow as a system of equations: z(T) = z(0).

In x = z / |z_0| and p = w / w_0, z_0 and w_0 those of a motion nearby, an orbit solves

    F(x, p) = z(T; x, p) / |z_0| - x = 0,        T = 2 pi m / w,

z the state at phase zero, m the periods of the load in the response's; dF/dx = M - I with the
monodromy matrix M.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from fenics_crack.balance.bordered import PathPoint
from fenics_crack.balance.linearisation import DenseLinearisation
from fenics_crack.model.flow import ExponentialFlow, Steps
from fenics_crack.motion.flow import ContactFlow, Motion
from fenics_crack.motion.orbit import INSTANTS, PeriodicOrbit, eigenvalues

__all__ = ["FlowOrbits", "MarchedOrbits", "OrbitPoint", "Orbits", "recurrences"]

DIFFERENCE = 1e-6
"""Of p, for dF/dp."""


class OrbitPoint(DenseLinearisation):
    """The equations of periodic orbits at a state and a frequency.

    Attributes
    ----------
    events : int
        Switching instants in the period.
    """

    def __init__(
        self,
        unknown: np.ndarray,
        residual: np.ndarray,
        monodromy: Callable[[], np.ndarray],
        by_parameter: Callable[[], np.ndarray],
        events: int,
    ) -> None:
        self._monodromy, self._slope, self.events = monodromy, by_parameter, events
        super().__init__(unknown, residual)

    @cached_property
    def monodromy(self) -> np.ndarray:
        """M = dz(T)/dz: (2n, 2n)."""
        return self._monodromy()

    def assemble(self) -> np.ndarray:
        """M - I."""
        return self.monodromy - np.eye(len(self.monodromy))

    def differentiate(self) -> np.ndarray:
        """dF/dp."""
        return self._slope()

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

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return float(first @ second)

    def followed(self, periods: int) -> np.ndarray:
        """The start after some periods of the response, nearer to what attracts it: (2n,)."""
        state = self.start
        for _ in range(periods):
            state = self.moved(state, 1.0)
        return state

    @abstractmethod
    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """The equations at (x, p)."""

    @abstractmethod
    def moved(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """x after a period."""


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

    def moved(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        return np.asarray(self.steps(unknown, parameter).states[-1] / self._size)

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        steps = self.steps(unknown, parameter)
        residual = steps.states[-1] / self._size - unknown

        def by_parameter() -> np.ndarray:
            h = DIFFERENCE
            after, before = self.moved(unknown, parameter + h), self.moved(unknown, parameter - h)
            return np.asarray((after - before) / (2.0 * h))

        return OrbitPoint(unknown, residual, steps.monodromy, by_parameter, steps.switches)


class FlowOrbits(Orbits):
    """F(x, p) of the exact flow, x = W z / |W z_0| with the modes' frequencies W before their
    displacements, p = w / w_0.

    Attributes
    ----------
    flow : ContactFlow
    subharmonic : int
        Periods of the load in one of the orbit.
    """

    def __init__(
        self, flow: ContactFlow, omega: float, state: np.ndarray, subharmonic: int = 1
    ) -> None:
        self.flow, self.subharmonic = flow, subharmonic
        slowest = (omega / subharmonic) ** 2
        frequencies = np.sqrt(np.maximum(flow.modes.squares, slowest))
        self._weights = np.concatenate([frequencies, np.ones_like(frequencies)])
        super().__init__(omega, self._weights * state)

    def state(self, unknown: np.ndarray) -> np.ndarray:
        """z of x: (2n,)."""
        return np.asarray(self._size * unknown / self._weights)

    def unknown(self, state: np.ndarray) -> np.ndarray:
        """x of z: (2n,)."""
        return np.asarray(self._weights * state / self._size)

    def unknown_of(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """x of another motion at phase zero, (n_dofs,) each."""
        return self.unknown(self.flow.state(displacement, velocity))

    def _motion(self, unknown: np.ndarray, parameter: float, instants: np.ndarray) -> Motion:
        """Over a period, sampled at parts of it."""
        omega = parameter * self.omega
        period = 2.0 * np.pi * self.subharmonic / omega
        return self.flow.advance(self.state(unknown), omega, period, instants=instants * period)

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        motion = self._motion(unknown, parameter, np.ones(1))
        residual = self.unknown(motion.state) - unknown

        def monodromy() -> np.ndarray:
            return self._weights[:, None] * motion.track.tangent / self._weights

        def by_parameter() -> np.ndarray:
            duration = motion.track.times[-1]
            rate = self.flow.rate(motion.state, motion.samples.force[0])
            moved = motion.track.by_omega() - duration / motion.track.omega * rate
            return self.unknown(self.omega * moved)

        return OrbitPoint(unknown, residual, monodromy, by_parameter, motion.events)

    def moved(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        return self.unknown(self._motion(unknown, parameter, np.zeros(0)).state)

    def gap(
        self, unknown: np.ndarray, parameter: float, count: int = INSTANTS, later: float = 0.0
    ) -> np.ndarray:
        """g at equally spaced instants of a period, ``later`` by a part of their spacing:
        (count, n_pairs) [m]."""
        instants = (np.arange(count) + later) / count
        return self._motion(unknown, parameter, instants).samples.gap

    def orbit(self, found: PathPoint) -> PeriodicOrbit:
        """The orbit of a solution of the equations."""
        motion = self._motion(found.unknown, found.parameter, np.zeros(0))
        size = float(np.linalg.norm(found.unknown))
        off = float(np.linalg.norm(self.unknown(motion.state) - found.unknown))
        return PeriodicOrbit(
            self.flow, found.parameter * self.omega, self.subharmonic, motion,
            self.state(found.unknown), off / size if size > 0.0 else 0.0, found.iterations + 1,
        )  # fmt: skip

    def displacement(self, unknown: np.ndarray, count: int) -> np.ndarray:
        """Displacement of the structure's own dofs there, at p = 1: (count, n_dofs) [m]."""
        return self._motion(unknown, 1.0, np.arange(count) / count).samples.displacement
