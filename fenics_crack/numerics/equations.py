"""Interface of equations F(x, p) = 0 for Newton's method and path following.

A :class:`System` has unknowns x and a parameter p. At a point (x, p) its :class:`Linearisation`
offers

    F(x, p)       residual
    J^-1 r        solutions with the Jacobian J = dF/dx
    dF/dp         derivative by the parameter
    sign det J    orientation

and computes each on first request. All four belong to the point, in whatever order a caller
requests them.

Newton's method and path following run in the compiled kernel. The kernel calls the equations
through a table of C functions (``kernel/equations.h``). Compiled equations have a table; for a
system in Python, the functions in the table call back into Python.
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

MACHINE_EPSILON = float(np.finfo(float).eps)
"""Relative rounding error of floating-point numbers."""
SMALLEST_NORMAL = float(np.finfo(float).tiny)
"""Smallest positive number with full relative accuracy."""
ROUNDING: float = kernel.ROUNDING
"""Smallest rounding error assumed for a relative residual |F| / |x|: 1e-12."""
CENTRAL_DIFFERENCE_STEP = float(np.cbrt(MACHINE_EPSILON))
"""Relative step for derivatives by central differences, 6e-6. Truncation and rounding error are
then about equal."""
SPECIAL_POINT_TOLERANCE = 1e-11
"""Maximum relative residual |F| / |x| at a special point of a path. Also the maximum relative last
Newton step to an exact orbit."""
ROOT_TOLERANCE = math.sqrt(MACHINE_EPSILON)
"""Absolute value below which a dimensionless function counts as zero: 1.5e-8. Also the maximum
relative Newton step to an orbit without a formed monodromy matrix."""
COARSE_TOLERANCE = CENTRAL_DIFFERENCE_STEP
"""Maximum relative residual |F| / |x| of an approximate solution, used as a guess or for an error
estimate: 6e-6. Equations with a larger rounding error are refused."""


def residual_rounding(residual_slope: float) -> float:
    """Return the rounding error of a relative residual |F| / |x|.

    The result is machine epsilon times ``residual_slope``, the largest |dF| / |dx|. The minimum is
    ``ROUNDING`` (1e-12), the maximum ``COARSE_TOLERANCE`` (6e-6).
    """
    return max(ROUNDING, min(COARSE_TOLERANCE, MACHINE_EPSILON * residual_slope))


class Linearisation(ABC):
    """Residual F and Jacobian J = dF/dx of a system at unknowns x and parameter p."""

    unknown: np.ndarray
    """Unknowns x, in the system's shape."""
    residual: np.ndarray
    """Residual F(x, p), in the shape and units of x."""

    @abstractmethod
    def solve(self, right_side: np.ndarray) -> np.ndarray:
        """Solve with the Jacobian J: return J^-1 r, with ``right_side`` r in the shape of x."""

    def apply(self, change: np.ndarray) -> np.ndarray:
        """Return J dx, the Jacobian times a change dx of the unknowns, in the shape of x.

        Only systems without a formed J implement the product, for GMRES.
        """
        raise NotImplementedError

    @property
    @abstractmethod
    def by_parameter(self) -> np.ndarray:
        """Return the derivative dF/dp by the parameter, in the shape of x."""

    @property
    def record(self) -> np.ndarray:
        """Return the numbers stored with this point of a path: (n_record_entries,).

        Used to reject steps as too long (:class:`fenics_crack.numerics.path.StepRejectionRule`).
        The system's method ``step_control_values`` computes the rule's input from the records of
        several points. Only systems for paths with this rule implement the property.
        """
        raise NotImplementedError

    @property
    @abstractmethod
    def sign(self) -> float:
        """Return the sign of det J, +1 or -1. The sign changes at a fold of a path."""


class System(Protocol):
    """Equations F(x, p) = 0 with all unknowns in one array.

    The unknowns are the same on every MPI rank. A system may have further attributes:

    - ``compiled_equations``: the same equations for the kernel, an :class:`Equations`, or None.
    - ``angle_weights``: factor for each unknown in inner products for angles between tangents.
    - ``n_time_means``: number of leading unknowns that are means over time.
    - ``n_record_entries``: number of entries in :attr:`Linearisation.record`, an array of numbers
      stored at each point of a path.
    - ``step_control_values(records)``: values (n, ...) to recognise steps as too long, computed
      from the records (n, n_record_entries) of n points.
    - ``rounding(p)``: rounding error of |F| / |x| at the parameter p.
    """

    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """Evaluate residual F and Jacobian J = dF/dx at unknowns x and a parameter p."""


class DenseLinearisation(Linearisation):
    """Linearisation with a dense Jacobian, factorised by LAPACK on first use.

    Derived classes form the Jacobian. An instance must not refer to itself, or Python would not
    free the matrices with the last reference.
    """

    @property
    @abstractmethod
    def jacobian(self) -> np.ndarray:
        """Return the Jacobian J = dF/dx: (n, n), for residual and unknowns flattened row by row."""

    def matrix_to_factorise(self) -> np.ndarray:
        """Return the matrix to factorise: J, or a smaller matrix with the same determinant."""
        return self.jacobian

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the LU factors (n, n) and pivots (n,) of :meth:`matrix_to_factorise`.

        :func:`factorise_transpose` computes both on first request.
        """
        return factorise_transpose(self.matrix_to_factorise())

    def solve(self, right_side: np.ndarray) -> np.ndarray:
        return solve_by_factors_of_transpose(self._factors, right_side)

    @property
    def sign(self) -> float:
        lu_matrix, pivots = self._factors
        n_swaps = np.count_nonzero(pivots != np.arange(len(pivots)))
        n_negative = np.count_nonzero(np.diag(lu_matrix) < 0.0)
        return -1.0 if (n_swaps + n_negative) % 2 else 1.0


def factorise_transpose(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factorise a matrix A by LAPACK, as the LU factors of A^T.

    The transpose is in Fortran order, so LAPACK needs no transposed copy.

    Returns
    -------
    factors : (n, n)
        L and U of A^T.
    pivots : (n,) int
        Entry i: index, from 0, of the row swapped with row i.
    """
    lu_matrix, pivots, _ = dgetrf(matrix.T)
    return lu_matrix, pivots


def solve_by_factors_of_transpose(
    factors: tuple[np.ndarray, np.ndarray], right_side: np.ndarray
) -> np.ndarray:
    """Solve A x = r with the factors from :func:`factorise_transpose`; x has the shape of r."""
    return np.reshape(dgetrs(*factors, right_side.ravel(), trans=1)[0], right_side.shape)


# --- equations for the kernel --------------------------------------------------------------------


class Equations(ABC):
    """Equations F(x, p) = 0 as a table of C functions, for the kernel's loops.

    Attributes
    ----------
    shape : tuple of int
        Shape of the unknowns.
    function_table : pointer to the C struct ``equations``
        Functions for F, solutions with J, dF/dp and the sign of det J.
    follows_many_points : bool
        True if the kernel may follow many points of a path in one call.
    """

    shape: tuple[int, ...]
    function_table: Any
    follows_many_points = True
    _weakref_to_last_linearisation: ReferenceType[Any] | None = None
    """Weak reference to the linearisation at the kernel's last point; None if unknown."""

    @property
    def compiled_equations(self) -> Equations | None:
        """Return this object.

        A :class:`System` has an attribute with this name for the equations in the kernel. This
        object already has this form.
        """
        return self

    @abstractmethod
    def linearise_evaluated(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """Return F and J at the point (x, p) that the kernel evaluated last.

        ``unknown`` x and ``parameter`` p must be this point. The kernel's results are used, so
        nothing is evaluated again.
        """

    def run_unchecked(self, loop: Any, *arguments: Any) -> int:
        """Call a C function on the equations, and return its outcome code.

        ``loop`` is the C function, called with ``function_table`` and then ``arguments``. The
        outcome code tells success or the kind of failure. The code is not checked here: pass the
        code to :meth:`has_found_solution`.
        """
        self._weakref_to_last_linearisation = None
        return int(loop(self.function_table, *arguments))

    def has_found_solution(self, outcome: int) -> bool:
        """Return True if the outcome code from :meth:`run_unchecked` is ``kernel.FOUND``.

        Raises
        ------
        MemoryError
            The kernel has no memory.
        ConvergenceError
            The structure's matrix is singular, as at an undamped resonance.
        """
        if outcome == kernel.NO_MEMORY:
            raise MemoryError("equations of a path")
        if outcome == kernel.SINGULAR_STRUCTURE:
            raise ConvergenceError(
                "path: the structure is singular at an undamped resonance; add damping"
            )
        return outcome == kernel.FOUND


def equations_of(system: System, shape: tuple[int, ...]) -> Equations:
    """Return a system's compiled equations, else equations that call the Python system.

    ``shape`` is the shape of the unknowns.
    """
    compiled_equations: Equations | None = getattr(system, "compiled_equations", None)
    return _PythonEquations(system, shape) if compiled_equations is None else compiled_equations


class _PythonEquations(Equations):
    """Equations of a Python system, for the kernel: the C functions call back into Python.

    A Python exception is kept during the C loop and raised by :meth:`has_found_solution`.
    """

    follows_many_points = False

    def __init__(self, system: System, shape: tuple[int, ...]) -> None:
        self.shape, self._callback_state = shape, _PythonCallbackState(system, shape)
        self._callback_state_handle = ffi.new_handle(self._callback_state)
        n_unknowns = int(np.prod(shape))
        angle_weights = getattr(system, "angle_weights", None)
        if angle_weights is not None:
            angle_weights = np.ascontiguousarray(np.broadcast_to(angle_weights, shape), dtype=float)
        self._struct = Struct(
            "equations", unknowns=n_unknowns, means=getattr(system, "n_time_means", 0),
            context=self._callback_state_handle, angle_weights=angle_weights,
            n_record_entries=getattr(system, "n_record_entries", 0), record=kernel.python_record,
            evaluate=kernel.python_evaluate, residual=kernel.python_residual,
            solve=kernel.python_solve, by_parameter=kernel.python_by_parameter,
            sign=kernel.python_sign,
        )  # fmt: skip
        self.function_table = self._struct.address

    def linearise_evaluated(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        return self._callback_state.linearisation

    def has_found_solution(self, outcome: int) -> bool:
        failure, self._callback_state.failure = self._callback_state.failure, None
        if failure is not None:
            raise failure
        return super().has_found_solution(outcome)


class _PythonCallbackState:
    """Data for callbacks to a Python system: current linearisation, and exception if any."""

    linearisation: Linearisation
    failure: BaseException | None = None

    def __init__(self, system: System, shape: tuple[int, ...]) -> None:
        self.system, self._shape, self._n_bytes = system, shape, 8 * int(np.prod(shape))

    def as_array(self, buffer: Any) -> np.ndarray:
        """Return the memory of a C pointer as an array in the unknowns' shape, without a copy."""
        return np.frombuffer(ffi.buffer(buffer, self._n_bytes)).reshape(self._shape)


def _python_callback(failure_value: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator to make a Python function a C callback of the kernel.

    The function ``_solve``, for example, becomes the callback ``python_solve``. The first argument
    is the :class:`_PythonCallbackState` of the system. An exception must not pass through C: the
    callback stores the exception in this state, and returns ``failure_value``. Until the exception
    is raised, later callbacks return failure values, too.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        """Register a function of (state, ...) as C callback, and return the callback."""

        @wraps(function)
        def call(table: Any, *arguments: Any) -> Any:
            """Call the function with the table's state; store an exception in the state."""
            state: _PythonCallbackState = ffi.from_handle(table.context)
            try:
                return failure_value if state.failure else function(state, *arguments)
            except BaseException as error:  # KeyboardInterrupt, too: no exception passes through C
                state.failure = error
                return failure_value

        ffi.def_extern(name=f"python{function.__name__}")(call)
        return call

    return decorate


@_python_callback(kernel.FAILED)
def _evaluate(state: _PythonCallbackState, unknown: Any, parameter: float) -> int:
    """Linearise the system at unknowns x and a parameter p; return ``kernel.FOUND``.

    The linearisation is stored in ``state``, for the callbacks after this one. ``unknown`` is the C
    pointer to x.
    """
    state.linearisation = state.system.linearise(state.as_array(unknown).copy(), parameter)
    return int(kernel.FOUND)


@_python_callback(None)
def _residual(state: _PythonCallbackState, residual_out: Any) -> None:
    """Write the residual F at the current point to ``residual_out``."""
    state.as_array(residual_out)[...] = state.linearisation.residual


@_python_callback(None)
def _solve(state: _PythonCallbackState, vector: Any) -> None:
    """Replace r in ``vector`` by J^-1 r, with the Jacobian J at the current point."""
    solution = state.as_array(vector)
    solution[...] = state.linearisation.solve(solution.copy())


@_python_callback(None)
def _by_parameter(state: _PythonCallbackState, derivative_out: Any) -> None:
    """Write dF/dp at the current point to ``derivative_out``."""
    state.as_array(derivative_out)[...] = state.linearisation.by_parameter


@_python_callback(None)
def _record(state: _PythonCallbackState, record_out: Any) -> None:
    """Write the current point's :attr:`Linearisation.record` to ``record_out``."""
    step_control_record = state.linearisation.record.ravel()
    np.frombuffer(ffi.buffer(record_out, step_control_record.nbytes))[:] = step_control_record


@_python_callback(np.nan)
def _sign(state: _PythonCallbackState) -> float:
    """Return the sign of det J at the current point."""
    return state.linearisation.sign
