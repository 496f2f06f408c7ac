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
from fenics_crack.numerics.path import BranchPoint, Event, Fold, StepRejectionRule


class CurveSystem(ABC):
    """Interface of equations F(x, p) = 0 along a curve's parameter v.

    The path parameter p runs from 0, with v = ``start``, to 1, with v = ``end``.

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
        Shape of the unknowns x.
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
        """Return the curve's parameter, such as a load frequency, at a path parameter.

        The path parameter runs from 0 at the curve's start to 1 at its end.
        """
        if self.is_logarithmic:
            return float(self.start * (self.end / self.start) ** parameter)
        return self.start + parameter * (self.end - self.start)

    def parameter(self, value: float) -> float:
        """Return the path parameter, 0 to 1, at a value of the curve's parameter."""
        if self.is_logarithmic:
            return math.log(value / self.start) / math.log(self.end / self.start)
        return (value - self.start) / (self.end - self.start)

    def value_rate(self, value: float) -> float:
        """Return the derivative of the curve's parameter by the path parameter.

        ``value`` is the curve's parameter; the path parameter runs from 0 to 1.
        """
        if self.is_logarithmic:
            return value * math.log(self.end / self.start)
        return self.end - self.start

    @abstractmethod
    def omega(self, value: float, unknown: np.ndarray) -> float:
        """Return a solution's load frequency [rad/s] at a value of the curve's parameter."""

    def unscaled_solution(self, unknown: np.ndarray, value: float) -> np.ndarray:
        """Convert the unknowns x of a solution to a row for :attr:`ResponseCurve.points`.

        ``unknown`` is x, and ``value`` is the curve's parameter. By default the row is x itself.
        """
        return unknown

    @abstractmethod
    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """Evaluate the residual F(x, p) and its derivatives at unknowns x.

        ``parameter`` is the path parameter p, 0 to 1.
        """

    @abstractmethod
    def rounding(self, parameter: float) -> float:
        """Return the rounding error |F| / |x| of the residual F, for unknowns x.

        ``parameter`` is the path parameter, 0 to 1.
        """

    def half_period_repetition_error(self, unknown: np.ndarray, parameter: float) -> float:
        """Return a motion's change over half its period, relative to its size.

        The change is near 0 if the motion has half the period. ``unknown`` is a solution,
        ``parameter`` the path parameter, 0 to 1.
        """
        raise NotImplementedError

    @property
    def n_unknowns(self) -> int:
        """Number of scalar unknowns."""
        return math.prod(self.shape)

    @property
    def max_path_points_per_call(self) -> int:
        """Maximum number of path points that one kernel call computes.

        Ctrl-C has no effect before the call ends.
        """
        return MAX_UNKNOWNS_TIMES_POINTS_PER_CALL // self.n_unknowns

    def make_step_control(self, longest_step: float) -> StepRejectionRule | None:
        """Make the object that rejects steps over which a solution changes too much.

        ``longest_step`` is relative to the parameter range. None: no step is rejected.
        """
        return None
