"""Interface of equations along a parameter v of a curve, which paths follow along p:

    v = v_start + p (v_end - v_start),    or    v_start (v_end / v_start)^p for a logarithmic v.

Harmonic balance (:mod:`balance_equations`), periodic orbits of the exact flow (:mod:`orbits`) and
phase resonances (:mod:`resonance`) implement it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from fenics_crack.balance.problem import MAX_UNKNOWNS_TIMES_POINTS_PER_CALL, Problem
from fenics_crack.numerics.equations import Linearisation
from fenics_crack.numerics.path import BranchPoint, Event, Fold, StepControl


class CurveSystem(ABC):
    """Equations along a parameter v, from ``start`` at p = 0 to ``end`` at p = 1.

    Attributes
    ----------
    parameter_name : str
        Name of v (:attr:`fenics_crack.ResponseCurve.parameter`).
    problem : Problem
        Problem to solve, with a small or reduced structure. The parameter varies its structure or
        law.
    start, end : float
        v at p = 0 and p = 1.
    shape : tuple of int
        Shape of the unknowns.
    is_logarithmic : bool
        True if p is proportional to ln v.
    event_classes : sequence of type of Event
        Kinds of special points to detect.
    """

    parameter_name: str
    problem: Problem
    start: float
    end: float
    shape: tuple[int, ...]
    is_logarithmic: bool = False
    event_classes: ClassVar[Sequence[type[Event]]] = (Fold, BranchPoint)

    def value(self, parameter: float) -> float:
        """Return the curve's parameter v at the path parameter p, 0 to 1."""
        if self.is_logarithmic:
            return float(self.start * (self.end / self.start) ** parameter)
        return self.start + parameter * (self.end - self.start)

    def parameter(self, value: float) -> float:
        """Return the path parameter p, 0 to 1, at the curve's parameter v."""
        if self.is_logarithmic:
            return math.log(value / self.start) / math.log(self.end / self.start)
        return (value - self.start) / (self.end - self.start)

    def value_rate(self, value: float) -> float:
        """Return the derivative dv/dp of the curve's parameter at v."""
        if self.is_logarithmic:
            return value * math.log(self.end / self.start)
        return self.end - self.start

    @abstractmethod
    def omega(self, value: float, unknown: np.ndarray) -> float:
        """Return a solution's load frequency [rad/s]; ``value`` is v."""

    def curve_points_row(self, unknown: np.ndarray, value: float) -> np.ndarray:
        """Convert unknowns to the array that a curve stores; by default the unknowns."""
        return unknown

    @abstractmethod
    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """Evaluate the equations F(x, p) and their derivatives at a point."""

    @abstractmethod
    def rounding(self, parameter: float) -> float:
        """Return the rounding error |F| / |x| of the residual F, for unknowns x."""

    def relative_motion_change_over_half_period(
        self, unknown: np.ndarray, parameter: float
    ) -> float:
        """Return a motion's change over half its period, relative to its size."""
        raise NotImplementedError

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return math.prod(self.shape)

    @property
    def points_per_call(self) -> int:
        """Maximum number of points per kernel call."""
        return MAX_UNKNOWNS_TIMES_POINTS_PER_CALL // self.n_unknowns

    def make_step_control(self, longest_step: float) -> StepControl | None:
        """Make the object that rejects too long steps; None if none is needed."""
        return None
