"""Contact equations whose paths are followed by the compiled kernel.

    F(s, p) = s - g_lin(p) + (R(p) - R_inf) b(lambda(s), p) = 0

of :mod:`contact_system`, with exact integrals of the contact forces. Along p the contact stiffness
grows like e^(growth p), g_lin linearly, a softness in series with the pairs falls, or the base
frequency and the damping of modes change, R and g_lin following from them
(``kernel/compliance.h``, ``contact.h``). The loops are those of :mod:`bordered` and
:mod:`arclength` (``kernel/path.c``): the same steps from the same numbers, many points in one call.
From 100 unknowns on points of pairs that nothing couples share LU factors there
(``kernel/broyden.h``), and are those of the loops to about 1e-6 of a step; those of coupled ones
are found by products with J (``kernel/krylov.h``).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np

from fenics_crack.balance.arclength import BRANCHING_STEP, Stepping
from fenics_crack.balance.bordered import (
    MAX_BETWEEN,
    MAX_ITERATIONS,
    MIN_DAMPING,
    REACH,
    PathPoint,
    Tangent,
)
from fenics_crack.balance.linearisation import Linearisation
from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import NULL, Struct, doubles, ints, kernel, owned, shaped

__all__ = ["SHARP", "CompiledEquations", "CompiledPaths", "ModalPart", "Stretch"]


SHARP = 1e-9
"""Relative residual of a solution with J where J is not formed."""


@dataclass(frozen=True)
class ModalPart:
    """Modes that answer along a path: R_k = P^T h_k P + at_once and what the load adds to g_lin,
    P^T h_k l_k, with h_kj = 1 / (s_j - (k w)^2 + i k w d c_j)."""

    squares: np.ndarray
    """s: (n_modes,) [rad^2/s^2]."""
    rates: np.ndarray
    """c: (n_modes,) [1/s]."""
    shapes: np.ndarray
    """P: (n_modes, n_pairs)."""
    load: np.ndarray
    """l: (H+1, n_modes), complex."""
    omega: tuple[float, float]
    """w at p = 0, and dw/dp [rad/s]."""
    damping: tuple[float, float]
    """d at p = 0, and dd/dp."""
    at_once: np.ndarray | None = None
    """What is added to each R_k: (n_pairs, n_pairs)."""


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
        """As :func:`fenics_crack.balance.bordered.solve_in_plane`."""
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
        """As :func:`fenics_crack.balance.bordered.find_between`."""
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


def seen_structure(
    linear: np.ndarray, compliance: np.ndarray | ModalPart, linear_rate: np.ndarray | None = None
) -> Struct:
    """What the kernel's equations share: g_lin and R along a parameter, of the arguments of
    :class:`CompiledEquations`."""
    rows, pairs = linear.shape
    rate = np.zeros_like(linear) if linear_rate is None else linear_rate
    known: dict[str, Any] = {"harmonics": rows // 2, "pairs": pairs}
    if isinstance(compliance, ModalPart):
        modes, of_each = len(compliance.squares), rows // 2 + 1
        known["modes"] = modes
        known["omega"], known["omega_rate"] = compliance.omega
        known["damping"], known["damping_rate"] = compliance.damping
        known["squares"] = shaped(compliance.squares, modes)
        known["rates"] = shaped(compliance.rates, modes)
        known["shapes"] = shaped(compliance.shapes, modes, pairs)
        known["load"] = shaped(compliance.load, of_each, modes, kind=complex)
        at_once = compliance.at_once
        known["at_once"] = None if at_once is None else shaped(at_once, pairs, pairs)
    else:
        of_each = rows // 2 + 1
        known["compliance"] = shaped(compliance, of_each, pairs, pairs, kind=complex)
    return Struct(
        "seen_structure", linear=shaped(linear, rows, pairs),
        linear_rate=shaped(rate, rows, pairs), **known,
    )  # fmt: skip


class CompiledEquations(CompiledPaths):
    """F(s, p) = 0 of contact pairs.

    Parameters
    ----------
    residual : (n_pairs, n_pairs) [m/N] or None
        R_inf.
    springs : (n_pairs,) [m/N]
        1 / k at p = 0.
    linear : (2H+1, n_pairs) [m]
        g_lin at p = 0, without the part of modes.
    compliance : (H+1, n_pairs, n_pairs) complex or ModalPart
        R_k - R_inf, or what it follows from.
    coupled : bool
        Whether R_inf has more than a diagonal.
    basis : (n_pairs, n), optional
        U where modes are fewer than coupled pairs.
    formed : bool
        Whether J is formed; else solutions take products with it, and its sign is nan.
    linear_rate : (2H+1, n_pairs) [m], optional
        d g_lin / dp, without the part of modes.
    growth : float
        d ln k / dp.
    softness : float [m/N]
        That in series with each pair is ``softness`` |1 - p|^3.
    """

    def __init__(
        self,
        residual: np.ndarray | None,
        springs: np.ndarray,
        linear: np.ndarray,
        compliance: np.ndarray | ModalPart,
        *,
        coupled: bool = False,
        basis: np.ndarray | None = None,
        formed: bool = True,
        linear_rate: np.ndarray | None = None,
        growth: float = 0.0,
        softness: float = 0.0,
    ) -> None:
        self.shape = linear.shape
        pairs = self.shape[1]
        gaps = pairs if basis is None else basis.shape[1]
        at_once = np.zeros((pairs, pairs)) if residual is None else residual
        self._given = Struct(
            "contact_pairs", seen=seen_structure(linear, compliance, linear_rate), growth=growth,
            softness=softness, coupled=coupled, residual=shaped(at_once, pairs, pairs),
            springs=shaped(springs, pairs), seen_gaps=gaps, formed=formed,
            basis=None if basis is None else shaped(basis, pairs, gaps),
        )  # fmt: skip
        self._point = owned(kernel.new_contact_point(self._given.at), kernel.free_contact_point)
        self._equations = kernel.equations_of_contact(self._point)

    def linearise(self, unknown: np.ndarray, parameter: float) -> CompiledPoint:
        """The equations at a point."""
        return CompiledPoint(self, shaped(unknown, *self.shape), parameter)

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return float(np.vdot(first, second))

    def evaluated(self, at: CompiledPoint) -> Any:
        """The kernel's equations, evaluated at a point."""
        if self._last is not at:
            self._last = None
            outcome = self._equations.evaluate(self._equations, doubles(at.unknown), at.parameter)
            self._check(outcome)
            self._last = at
        return self._equations

    def _found(self, unknown: np.ndarray, parameter: float) -> CompiledPoint:
        self._last = found = CompiledPoint(self, unknown, parameter)
        return found

    def largest_compliance(self, parameter: float) -> float:
        """Largest sum of abs(R_k - R_inf) over a row of it at a parameter [m/N]."""
        self._last = None
        found = float(kernel.largest_moving(self._point, parameter))
        if not math.isfinite(found):
            self._check(kernel.SINGULAR_STRUCTURE)
        return found

    def _check(self, outcome: int) -> None:
        """Raise ConvergenceError where the structure is singular, MemoryError without memory."""
        if outcome == kernel.NO_MEMORY:
            raise MemoryError("contact equations")
        if outcome == kernel.SINGULAR_STRUCTURE:
            raise ConvergenceError("path: the structure is singular (an undamped resonance)")


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


class CompiledPoint(Linearisation):
    """:class:`CompiledEquations` at a point; evaluated again where the kernel has left it."""

    def __init__(self, system: CompiledEquations, unknown: np.ndarray, parameter: float) -> None:
        self.system, self.unknown, self.parameter = system, unknown, parameter

    @property
    def residual(self) -> np.ndarray:
        found = np.empty_like(self.unknown)
        at = self.system.evaluated(self)
        at.residual(at, doubles(found))
        return found

    def solve(self, right: np.ndarray) -> np.ndarray:
        found = np.array(right, dtype=float, order="C")
        if found.size != self.unknown.size:
            raise ValueError(f"{found.size} numbers instead of {self.unknown.size}")
        at = self.system.evaluated(self)
        at.sharp = SHARP
        at.solve(at, doubles(found))
        return found

    @property
    def by_parameter(self) -> np.ndarray:
        found = np.empty_like(self.unknown)
        at = self.system.evaluated(self)
        at.by_parameter(at, doubles(found))
        return found

    @property
    def sign(self) -> float:
        at = self.system.evaluated(self)
        return float(at.sign(at))
