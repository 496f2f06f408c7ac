"""Periodic orbits of the exact flow as equations of a path over the frequency, in the kernel.

With the load's frequency omega = p omega_0 and the state z at phase zero, measured by the energy,

    x = w z / |w z_0|,      F(x, p) = w z(T; x, p) / |w z_0| - x = 0,      T = 2 pi m / omega,

z_0 a state nearby, w one for velocities and for displacements the frequencies of the modes, m the
load's periods in the orbit's. dF/dx = M - I and dF/dp are exact (``kernel/shooting.h``).
"""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.compiled import CompiledPaths
from fenics_crack.balance.orbits import OrbitPoint
from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import Struct, doubles, kernel, owned
from fenics_crack.motion.flow import Budget, ContactFlow

__all__ = ["OrbitEquations"]


class OrbitEquations(CompiledPaths):
    """F(x, p) of the orbits of a flow near a state.

    Attributes
    ----------
    flow : ContactFlow
    omega : float
        omega_0 [rad/s].
    scale : (2 n_modes,)
        x / z.
    start : (2 n_modes,)
        x of the state nearby, at p = 1.
    """

    matrix_free = False

    def __init__(
        self,
        flow: ContactFlow,
        omega: float,
        state: np.ndarray,
        *,
        subharmonic: int = 1,
        budget: Budget | None = None,
    ) -> None:
        budget, self.flow, self.omega, self.shape = budget or Budget(), flow, omega, state.shape
        weights = flow.weights(omega / subharmonic)
        self.scale = weights / (float(np.linalg.norm(weights * state)) or 1.0)
        self.start = self.scale * state
        given = Struct(
            "shooting_equations", flow=flow.handle, modes=flow.size // 2,
            pairs=len(flow.softness), omega=omega, turns=2.0 * np.pi * subharmonic,
            scale=self.scale, pieces=budget.pieces, intervals=budget.intervals,
        )  # fmt: skip
        self._point = owned(kernel.new_shooting_point(given.at), kernel.free_shooting_point)
        self._equations = kernel.equations_of_shooting(self._point)

    @property
    def compiled(self) -> OrbitEquations:
        """Itself: the loops are the kernel's."""
        return self

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """The equations at a point.

        Raises
        ------
        ConvergenceError
            The motion takes more than the budget allows, or is not finite.
        """
        self._evaluate(unknown, parameter)
        return self._found(unknown, parameter)

    def by_parameter(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """dF/dp."""
        found = np.empty(self.shape)
        self._evaluate(unknown, parameter)
        self._equations.by_parameter(self._equations, doubles(found))
        return found

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return float(first @ second)

    def _evaluate(self, unknown: np.ndarray, parameter: float) -> None:
        assert unknown.shape == self.shape
        given = doubles(np.ascontiguousarray(unknown, dtype=float))
        outcome = self._equations.evaluate(self._equations, given, parameter)
        self._check(outcome)
        if outcome != kernel.FOUND:
            raise ConvergenceError("orbits: the motion over a period cannot be followed")

    def _found(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        residual, monodromy = np.empty(self.shape), np.empty(2 * self.shape)
        self._equations.residual(self._equations, doubles(residual))
        kernel.tangent_of(self._point, doubles(monodromy))
        events = int(kernel.switches_of(self._point))
        return OrbitPoint(self, (unknown, parameter), residual, lambda: monodromy, events)

    def _check(self, outcome: int) -> None:
        if outcome == kernel.NO_MEMORY:
            raise MemoryError("orbits")
