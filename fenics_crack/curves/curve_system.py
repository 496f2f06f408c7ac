"""Interface of the equations that a curve follows along a parameter v, and paths along p:

    v = v_start + p (v_end - v_start), or v_start (v_end / v_start)^p where v is logarithmic.

There are two of the parameters of a curve: harmonic balance (:mod:`waves`) and periodic orbits of
the exact flow (:mod:`orbits`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from fenics_crack.balance.problem import MAX_UNKNOWNS_PER_CALL, Problem
from fenics_crack.numerics.equations import Linearisation
from fenics_crack.numerics.path import BranchPoint, Event, Fold, StepControl


class CurveSystem(ABC):
    """Equations along a parameter from its value ``start`` at p = 0 to ``end`` at p = 1.

    Attributes
    ----------
    name : str
        The parameter (:attr:`fenics_crack.ResponseCurve.parameter`).
    problem : Problem
        What they solve; its structure, small or reduced, and its law are varied by the parameter.
    shape : tuple of int
        Of the unknowns.
    logarithmic : bool
        True if p is proportional to ln v.
    events : sequence of type of Event
        Special points of its curves.
    """

    name: str
    problem: Problem
    start: float
    end: float
    shape: tuple[int, ...]
    logarithmic: bool = False
    events: ClassVar[Sequence[type[Event]]] = (Fold, BranchPoint)

    def value(self, parameter: float) -> float:
        """v of p."""
        if self.logarithmic:
            return float(self.start * (self.end / self.start) ** parameter)
        return self.start + parameter * (self.end - self.start)

    def parameter(self, value: float) -> float:
        """p of v."""
        if self.logarithmic:
            return math.log(value / self.start) / math.log(self.end / self.start)
        return (value - self.start) / (self.end - self.start)

    def rate(self, value: float) -> float:
        """dv/dp."""
        if self.logarithmic:
            return value * math.log(self.end / self.start)
        return self.end - self.start

    @abstractmethod
    def omega(self, value: float, unknown: np.ndarray) -> float:
        """Load frequency of a solution [rad/s]."""

    def state(self, unknown: np.ndarray, value: float) -> np.ndarray:
        """What a curve keeps of a solution."""
        return unknown

    @abstractmethod
    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """The equations at a point."""

    @abstractmethod
    def rounding(self, parameter: float) -> float:
        """Return the rounding error of |F| / |x| near a point of a curve."""

    def half_off(self, unknown: np.ndarray, parameter: float) -> float:
        """Change of a motion over half its period, relative to its size."""
        raise NotImplementedError

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return math.prod(self.shape)

    @property
    def at_once(self) -> int:
        """Points that are followed in one call of the kernel."""
        return MAX_UNKNOWNS_PER_CALL // self.size

    def control(self, longest_step: float) -> StepControl | None:
        """What may shorten steps."""
        return None
