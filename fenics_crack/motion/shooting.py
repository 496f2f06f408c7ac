"""Periodic orbits of a flow as equations z(T) = z(0).

The unknowns x are the scaled state z at phase zero of the load, less an offset linear in p:

    x = S z(0) - x_0 - p x_1,    S = diag(scale)

The load's frequency is w(p) = w_0 + p w_1, the period T = 2 pi m / w, and m is the number of load
periods in the response's period. An orbit solves

    F(x, p) = S (z(T) - z(0)) = 0,    dF/dx = S M S^-1 - I,

with the monodromy matrix M = dz(T) / dz(0).
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import Struct, attach_destructor, kernel, pointer
from fenics_crack.motion.flow import FEWER_EVENTS_ADVICE, Budget, ContactFlow
from fenics_crack.motion.orbit import PeriodicOrbit, orbit_from_converged_state
from fenics_crack.numerics.equations import DenseLinearisation, Equations
from fenics_crack.numerics.newton import PathPoint


@dataclass(eq=False, repr=False)
class OrbitPoint(DenseLinearisation):
    """Equations F(x, p) = 0 of periodic orbits, evaluated at one point.

    x is the scaled state at phase zero, and p is the parameter. F is the scaled change of the
    state in a period.

    Attributes
    ----------
    unknown, residual : (n,)
        x, and F.
    make_monodromy, make_parameter_derivative : callable
        Compute the monodromy matrix in the unknowns x (n, n), and dF/dp (n,).
    n_events, n_taylor_pieces : int
        Number of events (a pair opens, closes, sticks or slips) in the period, and of Taylor
        pieces (intervals with a single Taylor series).
    """

    unknown: np.ndarray
    residual: np.ndarray
    make_monodromy: Callable[[], np.ndarray]
    make_parameter_derivative: Callable[[], np.ndarray]
    n_events: int
    n_taylor_pieces: int

    @cached_property
    def monodromy(self) -> np.ndarray:
        """Return the monodromy matrix in the scaled unknowns: S M S^-1, (n, n).

        S is the diagonal scale, and M the monodromy matrix of states.
        """
        return self.make_monodromy()

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Return dF/dx, the monodromy matrix in the unknowns x less I: (n, n)."""
        return self.monodromy - np.eye(len(self.monodromy))

    @cached_property
    def by_parameter(self) -> np.ndarray:
        """Return dF/dp, the derivative of the residual by the parameter: (n,)."""
        return self.make_parameter_derivative()

    @property
    def record(self) -> np.ndarray:
        """Return the monodromy matrix (n, n), stored with this point of a path.

        The eigenvalues are Floquet multipliers. A step of the path is rejected if multipliers
        change too much.
        """
        return self.monodromy


class ShootingEquations(Equations):
    """Equations F = S (z(T) - z(0)) = 0 of periodic orbits, in the kernel.

    z is the state, T the period, and p the parameter. The unknowns x = S z(0) - x_0 - p x_1 are the
    state at phase zero, scaled by S, less an offset linear in p. dF/dx and dF/dp are exact
    (``kernel/shooting.h``).

    Parameters
    ----------
    flow : ContactFlow
        Flow with the load frequency given by p.
    scale : (flow.state_size,)
        Diagonal of the scale S.
    omega : (float, float)
        Load frequency at p = 0, and its derivative by p [rad/s].
    subharmonic : int
        Load periods in the orbit's period.
    **arrays
        Quantities that depend on p. If given, the kernel changes load or damping of ``flow``.

        - ``force``, ``gap``: load at p = 0 on modes (2K+1, n_modes) and gaps (2K+1, n_rows).
        - ``force_rate``, ``gap_rate``: derivatives of the load by p.
        - ``damping``, ``damping_rate``: damping at p = 0 and its derivative, each with
          ``n_damping`` entries. Make the flow with the largest damping: the Taylor pieces'
          lengths follow from it.
        - ``rest_states``: the offsets x_0 and x_1, (2, flow.state_size), by default 0.
    """

    def __init__(
        self, flow: ContactFlow, scale: np.ndarray, omega: tuple[float, float],
        subharmonic: int, **arrays: Any,
    ) -> None:  # fmt: skip
        self.flow, self.state_factors, self.shape = flow, scale, scale.shape
        self.subharmonic = subharmonic
        self._struct = Struct(
            "shooting_equations", flow=flow.handle, modes=flow.n_modes,
            harmonics=len(flow.modal_load) // 2,
            pairs=flow.n_normal_rows, friction=flow.friction_law is not None,
            base=omega[0], rate=omega[1],
            turns=2.0 * np.pi * subharmonic, scale=scale, max_pieces=Budget.max_taylor_pieces,
            max_intervals=Budget.max_event_intervals, **arrays,
        )  # fmt: skip
        self._kernel_point_pointer = attach_destructor(
            kernel.new_shooting_point(self._struct.address), kernel.free_shooting_point
        )
        self.function_table = kernel.equations_of_shooting(self._kernel_point_pointer)

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """Evaluate F at unknowns x and a parameter p; derivatives follow on request.

        Raises
        ------
        ConvergenceError
            The motion exceeds its budget, or is not finite.
        """
        self._integrate_period_in_kernel(unknown, parameter)
        return self.linearise_evaluated(unknown, parameter)

    def unknown_after_period(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """Return the unknowns x + F after a period from unknowns x, at a parameter p.

        ConvergenceError: the motion exceeds its budget, or is not finite.
        """
        self._integrate_period_in_kernel(unknown, parameter)
        return unknown + self._residual()

    @property
    def n_taylor_pieces_in_last_period(self) -> int:
        """Return the number of Taylor pieces in the period integrated last."""
        return int(kernel.count_pieces(self._kernel_point_pointer))

    def _integrate_period_in_kernel(self, unknown: np.ndarray, parameter: float) -> None:
        """Integrate the motion over a period from unknowns x, at a parameter p.

        The kernel keeps the result. ConvergenceError: the motion exceeds its budget, or is not
        finite.
        """
        assert unknown.shape == self.shape
        unknown_pointer = pointer(np.ascontiguousarray(unknown, dtype=float))
        if not self.has_found_solution(
            self.run_unchecked(self.function_table.evaluate, unknown_pointer, parameter)
        ):
            raise ConvergenceError(
                f"orbits: the motion cannot be integrated over a period: {FEWER_EVENTS_ADVICE}"
            )

    def _residual(self) -> np.ndarray:
        """Return the residual F at the point evaluated last: (n,).

        F is the change of the scaled state in a period.
        """
        residual = np.empty(self.shape)
        self.function_table.residual(self.function_table, pointer(residual))
        return residual

    def linearise_evaluated(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        residual = self._residual()
        n_events = int(kernel.count_events(self._kernel_point_pointer))

        def ensure_evaluated() -> None:
            """Integrate the period again if the kernel has evaluated another point since."""
            if (
                self._weakref_to_last_linearisation is not weak_point_reference
            ):  # there is one for a point
                self._integrate_period_in_kernel(unknown, parameter)
                self._weakref_to_last_linearisation = weak_point_reference

        def monodromy() -> np.ndarray:
            """Return the monodromy matrix in the unknowns x, from the kernel."""
            monodromy_matrix = np.empty(2 * self.shape)
            ensure_evaluated()
            kernel.get_monodromy(self._kernel_point_pointer, pointer(monodromy_matrix))
            return monodromy_matrix

        def by_parameter() -> np.ndarray:
            """Return dF/dp, from the kernel."""
            derivative = np.empty(self.shape)
            ensure_evaluated()
            self.function_table.by_parameter(self.function_table, pointer(derivative))
            return derivative

        point = OrbitPoint(
            unknown,
            residual,
            monodromy,
            by_parameter,
            n_events,
            self.n_taylor_pieces_in_last_period,
        )
        self._weakref_to_last_linearisation = weak_point_reference = weakref.ref(point)
        return point


class FlowOrbitEquations(ShootingEquations):
    """Equations of periodic orbits over the load frequency w = p w_0, with the parameter p.

    The unknowns x are the state z at phase zero times a diagonal scale S. The scale measures states
    by amplitude: displacements have weight 1, velocities have the weight 1 / frequency of the mode.
    S is divided by the size of a nearby state z_0, the parameter ``state``: |S z_0| = 1.

    Attributes
    ----------
    flow : ContactFlow
    omega : float
        Load frequency w_0 at p = 1 [rad/s].
    subharmonic : int
        Load periods in the orbit's period.
    state_factors : (flow.state_size,)
        Diagonal of S.
    start_unknown : (flow.state_size,)
        Unknowns x = S z_0 of the nearby state.
    """

    def __init__(
        self, flow: ContactFlow, omega: float, state: np.ndarray, subharmonic: int = 1
    ) -> None:
        weights = flow.amplitude_weights(omega / subharmonic)
        scale = weights / (float(np.linalg.norm(weights * state)) or 1.0)
        super().__init__(flow, scale, (0.0, omega), subharmonic)
        self.omega, self.start_unknown = omega, scale * state

    def state(self, unknown: np.ndarray) -> np.ndarray:
        """Return the state z = S^-1 x from unknowns x, with the scale S: (flow.state_size,)."""
        return np.asarray(unknown / self.state_factors)

    def unknown(self, state: np.ndarray) -> np.ndarray:
        """Return the unknowns x = S z from a state z, with the scale S: (flow.state_size,)."""
        return np.asarray(self.state_factors * state)

    def orbit(self, point: PathPoint) -> PeriodicOrbit:
        """Return the orbit at a solution: unknowns x, parameter p (load frequency p w_0)."""
        omega, state = point.parameter * self.omega, self.state(point.unknown)
        return orbit_from_converged_state(
            self.flow, omega, state, self.subharmonic, point.iterations
        )
