"""Interface of systems of equations F(x, p) = 0 for Newton's method and path following.

A system is linearised at a point, and the answer is a value: residual, solutions with the Jacobian,
derivative by the parameter and orientation belong to that point and to no other, in whatever order
they are requested, and each is computed when it is first requested. What
rounding leaves of a residual is known too.

The loops are the kernel's, which knows equations by a table of functions (``kernel/equations.h``).
Compiled ones bring theirs; for a system in Python the table holds functions that call it back.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property, wraps
from typing import Any, Protocol
from weakref import ReferenceType

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import Struct, ffi, kernel

EPSILON, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)
"""Relative rounding, and the smallest number that has it."""
ROUNDING: float = kernel.ROUNDING
"""Rounding of solutions, relative to the largest."""
CENTRAL_STEP = float(np.cbrt(EPSILON))
"""Step of a parameter, for a derivative by central differences: their truncation error is then as
small as their rounding."""
LOCATED, CLOSE = 1e-11, math.sqrt(EPSILON)
"""Maximum |F| / |x| of a special point between two points of a path, and relative length of a step
behind which an orbit is found; and of orbits that many are sought, or that are found by
products."""
NEARLY_SOLVED = CENTRAL_STEP
"""Maximum |F| / |x| of a solution with which another one begins, or by which it is assessed; and
the largest rounding: equations that require more are refused."""


def least_residual(slope: float) -> float:
    """Return the rounding error of |F| / |x| where F changes by at most so much times |x|."""
    return max(ROUNDING, min(NEARLY_SOLVED, EPSILON * slope))


class Linearisation(ABC):
    """A system at a point (x, p)."""

    unknown: np.ndarray
    """x."""
    residual: np.ndarray
    """F(x, p), of the shape and in the units of x."""

    @abstractmethod
    def solve(self, right: np.ndarray) -> np.ndarray:
        """J^-1 r, with J = dF/dx."""

    def apply(self, change: np.ndarray) -> np.ndarray:
        """J dx, for systems that SNES solves."""
        raise NotImplementedError

    @property
    @abstractmethod
    def by_parameter(self) -> np.ndarray:
        """dF/dp."""

    @property
    def record(self) -> np.ndarray:
        """Record of the point that paths may keep."""
        raise NotImplementedError

    @property
    @abstractmethod
    def sign(self) -> float:
        """Sign of det J, +1 or -1, which changes at the folds of a path."""


class System(Protocol):
    """F(x, p) = 0 for unknowns in arrays of one shape, the same on every rank.

    It may have more: ``compiled``, its kernel's equations; ``counts``, by how much each unknown
    counts in turns; ``means``, how many of the unknowns, the first, are means over
    time; and ``records``, how many numbers paths may keep of each point, the ``record`` of its
    linearisation, with ``observe(records)``, what a step control sees of them: (n, ...) of
    (n, records).
    """

    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """The system at a point."""


class DenseLinearisation(Linearisation):
    """A point whose Jacobian is a dense matrix, factored by LAPACK when it is first needed.

    Derived classes make its parts; none holds a reference to itself, so that matrices are freed at
    once.
    """

    @property
    @abstractmethod
    def jacobian(self) -> np.ndarray:
        """J, (n, n) for the n entries of the residual in their order."""

    def condense(self) -> np.ndarray:
        """Make the matrix that is factored: J, or a smaller one with the same determinant."""
        return self.jacobian

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        return factored(self.condense())

    def solve(self, right: np.ndarray) -> np.ndarray:
        return solve_factored(self._factors, right)

    @property
    def sign(self) -> float:
        matrix, pivots = self._factors
        swaps = np.count_nonzero(pivots != np.arange(len(pivots)))
        negative = np.count_nonzero(np.diag(matrix) < 0.0)
        return -1.0 if (swaps + negative) % 2 else 1.0


def factored(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LU factors of A^T: the transpose is in Fortran's order, which LAPACK takes without a
    transposing copy."""
    factors, pivots, _ = dgetrf(matrix.T)
    return factors, pivots


def solve_factored(factors: tuple[np.ndarray, np.ndarray], right: np.ndarray) -> np.ndarray:
    """A^-1 r from the LU factors of A^T, for a right-hand side of any shape."""
    return np.reshape(dgetrs(*factors, right.ravel(), trans=1)[0], right.shape)


# --- as the kernel takes them ---------------------------------------------------------------------


class Equations(ABC):
    """A system with its table.

    Attributes
    ----------
    shape : tuple of int
        Of the unknowns.
    table : the kernel's equations
    many : bool
        True if one call follows many points of a path.
    """

    shape: tuple[int, ...]
    table: Any
    many = True
    _last: ReferenceType[Any] | None = None
    """Last point of evaluation; a weak reference, so that both are freed at once."""

    @property
    def compiled(self) -> Equations | None:
        """Itself: the loops are the kernel's."""
        return self

    @abstractmethod
    def found(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """The system at a point that a loop has found, where it has just been evaluated."""

    def run(self, loop: Any, *given: Any) -> int:
        """Run a loop of the kernel and return its outcome."""
        self._last = None
        return int(loop(self.table, *given))

    def check(self, outcome: int) -> bool:
        """Return True if something was found; raise the error that an outcome means otherwise."""
        if outcome == kernel.NO_MEMORY:
            raise MemoryError("equations of a path")
        if outcome == kernel.SINGULAR_STRUCTURE:
            raise ConvergenceError("path: the structure is singular (an undamped resonance)")
        return outcome == kernel.FOUND


def equations_of(system: System, shape: tuple[int, ...]) -> Equations:
    """The kernel's equations of a system, its own ``compiled`` where it has them."""
    found: Equations | None = getattr(system, "compiled", None)
    return _Interpreted(system, shape) if found is None else found


class _Interpreted(Equations):
    """A system in Python."""

    many = False

    def __init__(self, system: System, shape: tuple[int, ...]) -> None:
        self.shape, self._state = shape, _State(system, shape)
        self._handle = ffi.new_handle(self._state)
        size = int(np.prod(shape))
        counts = getattr(system, "counts", None)
        if counts is not None:
            counts = np.ascontiguousarray(np.broadcast_to(counts, shape), dtype=float)
        self._struct = Struct(
            "equations", unknowns=size, means=getattr(system, "means", 0), context=self._handle,
            counts=counts, records=getattr(system, "records", 0), record=kernel.python_record,
            evaluate=kernel.python_evaluate, residual=kernel.python_residual,
            solve=kernel.python_solve, by_parameter=kernel.python_by_parameter,
            sign=kernel.python_sign,
        )  # fmt: skip
        self.table = self._struct.at

    def found(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        return self._state.at

    def check(self, outcome: int) -> bool:
        failure, self._state.failure = self._state.failure, None
        if failure is not None:
            raise failure
        return super().check(outcome)


class _State:
    """A system in Python where the kernel has evaluated it, and what it raised."""

    at: Linearisation
    failure: BaseException | None = None

    def __init__(self, system: System, shape: tuple[int, ...]) -> None:
        self.system, self._shape, self._bytes = system, shape, 8 * int(np.prod(shape))

    def array(self, numbers: Any) -> np.ndarray:
        """The kernel's numbers."""
        return np.frombuffer(ffi.buffer(numbers, self._bytes)).reshape(self._shape)


def _called_back(failed: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """For functions of the table: what they raise is kept until the loop has ended."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(table: Any, *given: Any) -> Any:
            state: _State = ffi.from_handle(table.context)
            try:
                return failed if state.failure else function(state, *given)
            except BaseException as error:  # KeyboardInterrupt too: C passes none on
                state.failure = error
                return failed

        ffi.def_extern(name=f"python{function.__name__}")(call)
        return call

    return decorate


@_called_back(kernel.FAILED)
def _evaluate(state: _State, unknown: Any, parameter: float) -> int:
    state.at = state.system.linearise(state.array(unknown).copy(), parameter)
    return int(kernel.FOUND)


@_called_back(None)
def _residual(state: _State, found: Any) -> None:
    state.array(found)[...] = state.at.residual


@_called_back(None)
def _solve(state: _State, right: Any) -> None:
    both = state.array(right)
    both[...] = state.at.solve(both.copy())


@_called_back(None)
def _by_parameter(state: _State, found: Any) -> None:
    state.array(found)[...] = state.at.by_parameter


@_called_back(None)
def _record(state: _State, found: Any) -> None:
    record = state.at.record.ravel()
    np.frombuffer(ffi.buffer(found, record.nbytes))[:] = record


@_called_back(np.nan)
def _sign(state: _State) -> float:
    return state.at.sign
