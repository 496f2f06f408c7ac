"""Periodic orbits of exact flows along one parameter of a curve:

    F(x, p) = scale (z(T; x, v) - z(0)) = 0,

z = (q, q') the state at phase zero of the load, x = scale z(0) - x_0 - p x_1, T = 2 pi m / omega,
and v one of the parameters of :mod:`waves`. x_0 and x_0 + x_1 are where the mean of the load holds
the structure at the start and at the end: steps are parts of what moves, lest a resonance beside a
large preload is stepped over. dF/dx = M - I with the monodromy matrix M in the unknowns.

Over the load's frequency, its factor, the damping and the clearance the kernel has the equations:
all points of a path share one flow. Over the contact stiffness and a rotor's speed a flow is made
for each point. dF/dp is exact but over the speed: forces are continuous, and it is the motion's own
variation, over damping and stiffness

    dq'' + C dq' + Lambda dq + P_A S P_A^T dq = -C' q' + P_A S D' lambda_A,

' the derivative by p, S = (D_AA)^-1 of the compliance D of the closed pairs A. Over the speed, with
which modes change, it is a forward difference: another flow a point; so it is with friction over
damping, stiffness and the coefficient of friction.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg

from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.orbit_events import (
    MultiplierControl,
    NeimarkSacker,
    PeriodDoubling,
    leading_multipliers,
)
from fenics_crack.curves.waves import WAVES, Waves
from fenics_crack.motion.flow import ContactFlow, Motion, as_doubles, exact_flow
from fenics_crack.motion.shooting import OrbitPoint, ShootingEquations
from fenics_crack.numerics.equations import MACHINE_EPSILON, ROUNDING
from fenics_crack.numerics.path import BranchPoint, Fold

FORWARD_STEP = math.sqrt(MACHINE_EPSILON)
"""Step of p for a forward difference: its truncation error is then as small as its rounding."""


class Orbits(CurveSystem):
    """The equations of periodic orbits along a parameter.

    ``along`` are its equations of harmonic balance. The problem's ``subharmonic`` is m. Raises
    InputError where there is no exact flow.
    """

    events = (Fold, BranchPoint, PeriodDoubling, NeimarkSacker)

    def __init__(self, problem: Problem, parameter: str, start: float, end: float) -> None:
        self.problem, self.name, self.start, self.end = problem, parameter, start, end
        self.along = WAVES[parameter]
        self.logarithmic, self.subharmonic = self.along.logarithmic, problem.subharmonic
        self._first = self._flow_at(start)
        self._last: tuple[float, ContactFlow] = start, self._first
        self.shape = (self._first.size,)

    def at(self, value: float) -> Problem:
        """The problem where the parameter has a value."""
        return self.along.vary(self.problem, value)

    def omega(self, value: float, unknown: np.ndarray | None = None) -> float:
        return self.along.frequency(self.problem, value)

    def _flow_at(self, value: float) -> ContactFlow:
        problem = self.at(value)
        return exact_flow(problem.structure, problem.contact)

    def flow(self, value: float) -> ContactFlow:
        """The flow where the parameter has a value; the last one is kept."""
        if self.name == "omega" or value == self.start:
            return self._first
        if self._last[0] != value:
            self._last = value, self._flow_at(value)
        return self._last[1]

    @cached_property
    def scale(self) -> np.ndarray:
        """dx/dz: 1 of modal displacements, 1 / w of velocities, w the modes' frequencies, at least
        that of the response."""
        return self._first.amplitude_weights(self.omega(self.start) / self.subharmonic)

    @property
    def records(self) -> int:
        """How many numbers M has."""
        return self.size**2

    @property
    def at_once(self) -> int:
        # Monodromy matrices of 8192 numbers together: those behind a rejected step are lost, and
        # of large ones few pay for the time between calls.
        return 2**13 // self.records

    def control(self, longest_step: float) -> MultiplierControl:
        return MultiplierControl(longest_step)

    @cached_property
    def _rest(self) -> np.ndarray:
        """x_0 and x_1."""
        first, last = (self._scaled(self.flow(v).rest_state, v) for v in (self.start, self.end))
        return np.array([first, last - first])

    def state(self, unknown: np.ndarray, value: float) -> np.ndarray:
        """z of x where the parameter has a value."""
        state = (unknown + self._offset(value)) / self.scale
        return np.asarray(state if self.name != "speed" else state @ self._modes(value).T)

    def unknown(self, state: np.ndarray, value: float) -> np.ndarray:
        """x of z where the parameter has a value."""
        return self._scaled(state, value) - self._offset(value)

    def _scaled(self, state: np.ndarray, value: float) -> np.ndarray:
        """x + x_0 + p x_1."""
        if self.name == "speed":
            state = np.linalg.solve(self._modes(value), state)
        return np.asarray(state * self.scale)

    def _offset(self, value: float) -> np.ndarray:
        """x_0 + p x_1."""
        return np.asarray(self._rest[0] + self.parameter(value) * self._rest[1])

    def _modes(self, value: float) -> np.ndarray:
        """States of the first flow to those where the speed has a value."""
        change = self.flow(value).modes.inverse @ self._first.modes.shapes
        places = np.eye(self._first.size - 2 * self._first.n_modes)
        return scipy.linalg.block_diag(change, change, places)

    def _motion(self, unknown: np.ndarray, parameter: float, part: float = 1.0) -> Motion:
        """Over a part of the period."""
        value = self.value(parameter)
        omega, state = self.omega(value), self.state(unknown, value)
        period = 2.0 * np.pi * self.subharmonic / omega
        return self.flow(value).advance(state, omega, part * period)

    def moved(self, unknown: np.ndarray, parameter: float, part: float = 1.0) -> np.ndarray:
        """x after a part of the period."""
        state = self._motion(unknown, parameter, part).state
        return self.unknown(state, self.value(parameter))

    def half_off(self, unknown: np.ndarray, parameter: float) -> float:
        """Change of an orbit over half its period, relative to its size."""
        change = self.moved(unknown, parameter, 0.5) - unknown
        return float(np.linalg.norm(change) / (np.linalg.norm(unknown) or 1.0))

    # --- what paths require -----------------------------------------------------------------------

    @cached_property
    def compiled(self) -> ShootingEquations | None:
        """The same equations in the kernel; None where it does not have them."""
        damped = self.name == "damping"
        # With friction where pairs stick depends on the damping, too.
        if self.name in ("stiffness", "speed", "friction") or (damped and self._first.friction):
            return None
        omega = self.omega(self.start), self.omega(self.end) - self.omega(self.start)
        flow = first = self._first
        along: dict[str, Any] = {"rest_states": self._rest} if self._rest.any() else {}
        if self.name != "omega":
            last = self.flow(self.end)
            # Its own: it changes.
            flow = self._flow_at(max(self.start, self.end) if damped else self.start)
            if damped:
                rate, damping = last.modes.damping - first.modes.damping, first.modes.damping
                along |= {"damping": as_doubles(damping), "damping_rate": as_doubles(rate)}
                along["n_damping"] = damping.size
            else:
                along |= {
                    "force": flow.modal_load,
                    "force_rate": last.modal_load - first.modal_load,
                }
                along |= {"gap": flow.load_gap, "gap_rate": last.load_gap - first.load_gap}
        return ShootingEquations(flow, self.scale, omega, self.subharmonic, **along)

    def rounding(self, parameter: float) -> float:
        """Return the rounding error of |F| / |x|."""
        return ROUNDING

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """The equations at a point.

        Raises
        ------
        ConvergenceError
            The motion takes more than the budget allows, or is not finite.
        """
        if self.compiled is not None:
            return self.compiled.linearise(unknown, parameter)
        try:
            motion = self._motion(unknown, parameter)
        except InputError as error:  # Newton's method has left what the parameter may be
            raise ConvergenceError(str(error)) from None
        value = self.value(parameter)
        residual = self.unknown(motion.state, value) - unknown

        def monodromy() -> np.ndarray:
            tangent = motion.track.tangent
            if self.name == "speed":
                modes = self._modes(value)
                tangent = np.linalg.solve(modes, tangent @ modes)
            return np.asarray(self.scale[:, None] * tangent / self.scale)

        def by_parameter() -> np.ndarray:
            if self.name == "speed" or self._first.friction:
                step = FORWARD_STEP if parameter < 0.5 else -FORWARD_STEP
                return (self.moved(unknown, parameter + step) - unknown - residual) / step
            state = self.state(unknown, value)
            softness = -self.rate(value) / value * motion.track.flow.softness
            change = self.scale * motion.track.derivative_by_softness(state, softness)
            return np.asarray(change + monodromy() @ self._rest[1] - self._rest[1])

        events, pieces = motion.events, motion.pieces
        return OrbitPoint(unknown, residual, monodromy, by_parameter, events, pieces)

    def observe(self, records: np.ndarray) -> np.ndarray:
        """Leading multipliers of points from their M, and r, d and c (:mod:`orbit_events`)."""
        return leading_multipliers(np.linalg.eigvals(records.reshape(-1, self.size, self.size)))


def system_along(
    exact: bool, problem: Problem, parameter: str, start: float, end: float
) -> Waves | Orbits:
    """The equations of exact orbits, or of harmonic balance, along a parameter."""
    if exact:
        return Orbits(problem, parameter, start, end)
    return WAVES[parameter](problem, start, end)
