"""Equations whose paths are followed by the compiled kernel.

The loops are those of :mod:`bordered` and :mod:`path` (``kernel/path.c``): the same steps from the
same numbers, many points in one call. What the equations are the kernel is told by a table of
functions (``kernel/equations.h``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, overload

import numpy as np

from fenics_crack.kernel import NULL, Struct, doubles, ints, kernel, shaped
from fenics_crack.numerics.bordered import (
    MAX_BETWEEN,
    MAX_ITERATIONS,
    MIN_DAMPING,
    REACH,
    PathPoint,
    Tangent,
)
from fenics_crack.numerics.linearisation import Linearisation
from fenics_crack.numerics.path import BRANCHING_STEP, Stepping

__all__ = ["CompiledPaths", "Stretch"]


class CompiledPaths(ABC):
    """The loops of the kernel, for equations of any kind."""

    shape: tuple[int, ...]
    """Of the unknowns."""
    _equations: Any
    """The kernel's."""
    _last: Linearisation | None = None
    """Where they have been evaluated."""

    @abstractmethod
    def _found(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """The equations at a point that has been found, where they have just been evaluated."""

    @abstractmethod
    def _check(self, outcome: int) -> None:
        """Raise what an outcome means that is neither FOUND nor NOT_FOUND, or do what it asks
        for."""

    def solve_in_plane(
        self,
        unknown: np.ndarray,
        parameter: float,
        plane: Tangent | None,
        *,
        tolerance: float,
        iterations: int,
        reach: float,
        least_damping: float | None,
        patience: int | None = None,
    ) -> PathPoint | None:
        """As :func:`fenics_crack.numerics.bordered.solve_in_plane`."""
        found, place, taken = np.empty(self.shape), np.empty(1), np.zeros(1, np.intc)
        flat = plane or Tangent(np.zeros(self.shape), 1.0, 0.0)
        across = doubles(shaped(flat.x, *self.shape))
        self._last = None
        found[...], place[0] = unknown, parameter
        outcome = kernel.solve_in_plane(
            self._equations, doubles(found), doubles(place), plane is not None, across, flat.p,
            flat.weight, tolerance, iterations, reach,
            -1.0 if least_damping is None else least_damping, patience or 0, ints(taken),
        )  # fmt: skip
        self._check(outcome)
        if outcome == kernel.NOT_FOUND:
            return None
        at = self._found(found, float(place[0]))
        return PathPoint(found, float(place[0]), int(taken[0]), flat, at=at)

    def follow(
        self, known: list[PathPoint], orientation: float, step: float, stepping: Stepping
    ) -> tuple[Stretch, float, float]:
        """Points of a path behind the last one or two that are known, the sign of its determinant
        and the next step. There are none where steps would be too short, and fewer than there might
        be where the parameter leaves its span."""
        begun, found = len(known), Stretch(self.shape, len(known) + stepping.chunk)
        path = found.struct(known, step=step, orientation=orientation)
        how = Struct(
            "stepping", longest=stepping.longest, shortest=stepping.shortest,
            tolerance=stepping.tolerance, rounding=stepping.rounding,
            least_cosine=stepping.least_cosine, branching_step=BRANCHING_STEP, reach=REACH,
            iterations=MAX_ITERATIONS, least_damping=MIN_DAMPING, lowest=min(stepping.span),
            highest=max(stepping.span),
        )  # fmt: skip
        self._last = None
        points = path.at
        outcome = kernel.follow(self._equations, how.at, points)
        if points.known == begun:
            self._check(outcome)
        return found[begun : points.known], points.orientation, points.step

    def find_between(
        self, ends: tuple[PathPoint, PathPoint], target: float | None, tolerance: float, near: float
    ) -> PathPoint | None:
        """As :func:`fenics_crack.numerics.bordered.find_between`."""
        found = Stretch(self.shape, 3)
        how = Struct(
            "stepping", shortest=near, tolerance=tolerance, reach=REACH,
            iterations=MAX_ITERATIONS, least_damping=MIN_DAMPING,
        )  # fmt: skip
        wanted = NULL if target is None else doubles(np.array([target]))
        self._last = None
        path = found.struct(ends)
        outcome = kernel.find_between(self._equations, how.at, MAX_BETWEEN, wanted, path.at)
        self._check(outcome)
        return None if outcome == kernel.NOT_FOUND else found[path.at.known]


class Stretch(Sequence[PathPoint]):
    """Points of a path in the kernel's arrays, one after the other; each is made where it is asked
    for.

    Attributes
    ----------
    unknowns : (n, 2H+1, n_pairs) [m]
    parameters, slopes, lengths : (n,)
        p, its tangent's t_p, and the chord from the point before.
    iterations : (n,) int
    crossings : (n,) int
        1 where another branch has been crossed since the point before.
    """

    def __init__(self, shape: tuple[int, ...], room: int) -> None:
        self.unknowns, self._tangents = np.zeros((room, *shape)), np.zeros((room, *shape))
        self.parameters, self.slopes, self._weights, self.lengths = np.zeros((4, room))
        self.iterations, self.crossings = np.zeros(room, np.intc), np.zeros(room, np.int8)

    def struct(self, known: Sequence[PathPoint], **numbers: float) -> Struct:
        """The kernel's path, which begins with what is known."""
        for place, point in enumerate(known):
            self.unknowns[place], self._tangents[place] = point.unknown, point.tangent.x
            self.parameters[place], self.slopes[place] = point.parameter, point.tangent.p
            self._weights[place], self.iterations[place] = point.tangent.weight, point.iterations
        return Struct(
            "path", room=len(self), known=len(known), unknowns=self.unknowns,
            parameters=self.parameters, tangents=self._tangents, slopes=self.slopes,
            weights=self._weights, lengths=self.lengths, iterations=self.iterations,
            crossings=self.crossings, **numbers,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.parameters)

    def ways_to(self, point: PathPoint) -> np.ndarray:
        """Distances from each point to another one along its tangent: (n,)."""
        back = (point.unknown - self.unknowns).reshape(len(self), -1)
        along = np.einsum("ij,ij->i", back, self._tangents.reshape(len(self), -1))
        found: np.ndarray = self._weights * along
        return found + (point.parameter - self.parameters) * self.slopes

    @overload
    def __getitem__(self, place: int) -> PathPoint: ...
    @overload
    def __getitem__(self, place: slice) -> Stretch: ...
    def __getitem__(self, place: int | slice) -> PathPoint | Stretch:
        if isinstance(place, slice):
            part = object.__new__(Stretch)
            vars(part).update({name: array[place] for name, array in vars(self).items()})
            return part
        tangent = Tangent(
            self._tangents[place], float(self.slopes[place]), float(self._weights[place])
        )
        return PathPoint(
            self.unknowns[place], float(self.parameters[place]), int(self.iterations[place]),
            tangent, bool(self.crossings[place]), length=float(self.lengths[place]),
        )  # fmt: skip
