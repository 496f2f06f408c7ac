"""Periodic orbits along a parameter other than the load's frequency: another flow at each value."""

from __future__ import annotations

import numpy as np

from fenics_crack.curves.family import Family
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.motion.flow import Budget, ContactFlow, Motion, exact_flow
from fenics_crack.motion.shooting import FlowOrbits, OrbitPoint
from fenics_crack.numerics.equations import DIFFERENCE

__all__ = ["VariedOrbits"]


class VariedOrbits(FlowOrbits):
    """F(x, p) of the exact flows along a family, p its parameter; x in the modes of p = 0."""

    @property
    def compiled(self) -> None:
        """The kernel's loops know one flow."""

    def __init__(
        self, family: Family, displacement: np.ndarray, velocity: np.ndarray, budget: Budget
    ) -> None:
        self._family = family
        first = family.at(family.start)
        flow = exact_flow(first.structure, first.contact)
        state = flow.state(displacement, velocity)
        super().__init__(flow, first.omega, state, first.subharmonic, budget)
        self._there = 0.0, flow, np.eye(flow.size)

    def _at(self, parameter: float) -> tuple[ContactFlow, np.ndarray]:
        """The flow where the parameter has a value, and its states by those of the first."""
        if self._there[0] != parameter:
            try:
                problem = self._family.at(self._family.value(parameter))
            except InputError as error:  # Newton's method has left what the parameter may be
                raise ConvergenceError(str(error)) from None
            flow = exact_flow(problem.structure, problem.contact)
            change = flow.modes.inverse @ self.flow.modes.shapes
            self._there = parameter, flow, np.kron(np.eye(2), change)
        return self._there[1:]

    def _motion(self, unknown: np.ndarray, parameter: float, instants: np.ndarray) -> Motion:
        flow, change = self._at(parameter)
        omega = self._family.omega(self._family.value(parameter))
        period = 2.0 * np.pi * self.subharmonic / omega
        state = change @ self.state(unknown)
        return flow.advance(state, omega, period, instants=instants * period, budget=self.budget)

    def moved(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        motion = self._motion(unknown, parameter, np.zeros(0))
        return self.unknown(np.linalg.solve(self._at(parameter)[1], motion.state))

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        motion = self._motion(unknown, parameter, np.zeros(0))
        change = self._at(parameter)[1]
        residual = self.unknown(np.linalg.solve(change, motion.state)) - unknown

        def monodromy() -> np.ndarray:
            inner = np.linalg.solve(change, motion.track.tangent @ change)
            return np.asarray(self.scale[:, None] * inner / self.scale)

        def by_parameter() -> np.ndarray:
            # Not beyond the ends of the family: there may be no structure.
            low = max(parameter - DIFFERENCE, min(parameter, 0.0))
            high = min(parameter + DIFFERENCE, max(parameter, 1.0))
            change = self.moved(unknown, high) - self.moved(unknown, low)
            return np.asarray(change / (high - low))

        return OrbitPoint(unknown, residual, monodromy, by_parameter, motion.events)
