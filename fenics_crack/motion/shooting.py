"""Periodic orbits of a flow as a system of equations: z(T) = z(0).

In x = z / |z_0| and p = w / w_0, z_0 and w_0 those of a motion nearby, an orbit solves

    F(x, p) = z(T; x, p) / |z_0| - x = 0,        T = 2 pi m / w,

z the state at phase zero, m the periods of the load in the response's; dF/dx = M - I with the
monodromy matrix M.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import Struct, kernel, owned, pointer
from fenics_crack.motion.flow import Budget, ContactFlow
from fenics_crack.motion.orbit import PeriodicOrbit, orbit_from
from fenics_crack.numerics.equations import DenseLinearisation, Equations
from fenics_crack.numerics.newton import PathPoint


@dataclass(eq=False, repr=False)
class OrbitPoint(DenseLinearisation):
    """The equations of periodic orbits at a state and a frequency.

    Attributes
    ----------
    form, derive : callable
        Return M, and dF/dp.
    events, pieces : int
        Switching instants in the period, and pieces of the Taylor series.
    """

    unknown: np.ndarray
    residual: np.ndarray
    form: Callable[[], np.ndarray]
    derive: Callable[[], np.ndarray]
    events: int
    pieces: int

    @cached_property
    def monodromy(self) -> np.ndarray:
        """M = dz(T)/dz: (2n, 2n)."""
        return self.form()

    @cached_property
    def jacobian(self) -> np.ndarray:
        """M - I."""
        return self.monodromy - np.eye(len(self.monodromy))

    @cached_property
    def by_parameter(self) -> np.ndarray:
        return self.derive()

    @property
    def record(self) -> np.ndarray:
        return self.monodromy


class ShootingEquations(Equations):
    """F(x, p) of an exact flow in the kernel (``kernel/shooting.h``), x = scale z - x_0 - p x_1;
    dF/dx = M - I and dF/dp are exact.

    Parameters
    ----------
    flow : ContactFlow
    scale : (2 n_modes,)
        dx/dz.
    omega : (float, float)
        Of the load at p = 0, and its rate [rad/s].
    subharmonic : int
        The load's periods in one of the orbit.
    **along
        The kernel's arrays of what follows p: ``force``, ``gap`` and their rates ``force_by``,
        ``gap_by`` where the load does, (2K+1, n_modes) and (2K+1, n_pairs), of the flow at p = 0;
        ``damping`` at p = 0 and its rate ``damping_by``, of so many ``rates``, the flow being the
        one with the largest; ``rest``: x_0 and x_1, (2, 2 n_modes), by default 0. A flow whose load
        or damping follows p is changed.
    """

    def __init__(
        self, flow: ContactFlow, scale: np.ndarray, omega: tuple[float, float],
        subharmonic: int, **along: Any,
    ) -> None:  # fmt: skip
        self.flow, self.scale, self.shape = flow, scale, scale.shape
        self.subharmonic = subharmonic
        self._given = Struct(
            "shooting_equations", flow=flow.handle, modes=flow.count,
            harmonics=len(flow.force) // 2,
            pairs=flow.structure.n_pairs, friction=flow.friction is not None,
            base=omega[0], rate=omega[1],
            turns=2.0 * np.pi * subharmonic, scale=scale, pieces=Budget.pieces,
            intervals=Budget.intervals, **along,
        )  # fmt: skip
        self._point = owned(kernel.new_shooting_point(self._given.at), kernel.free_shooting_point)
        self.table = kernel.equations_of_shooting(self._point)

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """The equations at a point.

        Raises
        ------
        ConvergenceError
            The motion takes more than the budget allows, or is not finite.
        """
        self._evaluate(unknown, parameter)
        return self.found(unknown, parameter)

    def moved(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """x after a period."""
        self._evaluate(unknown, parameter)
        return unknown + self._residual()

    @property
    def pieces(self) -> int:
        """Number of Taylor pieces of the motion last integrated."""
        return int(kernel.pieces_of(self._point))

    def _evaluate(self, unknown: np.ndarray, parameter: float) -> None:
        assert unknown.shape == self.shape
        given = pointer(np.ascontiguousarray(unknown, dtype=float))
        if not self.check(self.run(self.table.evaluate, given, parameter)):
            raise ConvergenceError("orbits: the motion over a period cannot be followed")

    def _residual(self) -> np.ndarray:
        """F where it was evaluated last."""
        residual = np.empty(self.shape)
        self.table.residual(self.table, pointer(residual))
        return residual

    def found(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        residual = self._residual()
        events = int(kernel.switches_of(self._point))

        def return_there() -> None:
            if self._last is not known:  # there is one for a point
                self._evaluate(unknown, parameter)
                self._last = known

        def monodromy() -> np.ndarray:
            found = np.empty(2 * self.shape)
            return_there()
            kernel.tangent_of(self._point, pointer(found))
            return found

        def by_parameter() -> np.ndarray:
            slope = np.empty(self.shape)
            return_there()
            self.table.by_parameter(self.table, pointer(slope))
            return slope

        found = OrbitPoint(unknown, residual, monodromy, by_parameter, events, self.pieces)
        self._last = known = weakref.ref(found)
        return found


class FlowOrbits(ShootingEquations):
    """F(x, p) of the exact flow, in the kernel, x = w z / |w z_0| with 1 / w the modes' frequencies
    where z are velocities: by the amplitude. dF/dx = M - I and dF/dp are exact
    (``kernel/shooting.h``).

    Attributes
    ----------
    flow : ContactFlow
    omega : float
        omega_0, of the load [rad/s].
    subharmonic : int
        Its periods in one of the orbit.
    scale : (2 n_modes,)
        x / z.
    start : (2 n_modes,)
        x of the state nearby, at p = 1.
    """

    def __init__(
        self, flow: ContactFlow, omega: float, state: np.ndarray, subharmonic: int = 1
    ) -> None:
        weights = flow.amplitude_weights(omega / subharmonic)
        scale = weights / (float(np.linalg.norm(weights * state)) or 1.0)
        super().__init__(flow, scale, (0.0, omega), subharmonic)
        self.omega, self.start = omega, scale * state

    def state(self, unknown: np.ndarray) -> np.ndarray:
        """z of x: (2n,)."""
        return np.asarray(unknown / self.scale)

    def unknown(self, state: np.ndarray) -> np.ndarray:
        """x of z: (2n,)."""
        return np.asarray(self.scale * state)

    def orbit(self, found: PathPoint) -> PeriodicOrbit:
        """The orbit of a solution of the equations."""
        omega, state = found.parameter * self.omega, self.state(found.unknown)
        return orbit_from(self.flow, omega, state, self.subharmonic, found.iterations)
