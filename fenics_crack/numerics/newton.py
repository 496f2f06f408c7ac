"""Newton's method: by PETSc's SNES for single solutions, bordered by a plane along paths.

SNES
----
Single solutions come from SNES, with GMRES if the Jacobian is not formed. PETSc options with the
prefix ``crack_hb_`` reach SNES, and options with ``crack_krylov_`` reach GMRES. If the kernel has
the equations, and no SNES option is given, the kernel takes the same steps.

Bordered by a plane ------------------- A point of a path has a unit tangent (t_x, t_p) in the norm
w |x|^2 + p^2 with w = 1 / |x_0|^2 (:func:`norm_weights_of_unknowns_and_means`). In the plane
orthogonal to the tangent, Newton's method solves

    [ J    F_p ] [dx]     [F]
    [ t_x  t_p ] [dp] = - [0],     by two solutions with J:

    dx = a + dp b,    J a = -F,    J b = -F_p,    dp = - w <t_x, a> / (w <t_x, b> + t_p)

If J is not formed, one solution with the bordered matrix replaces the two; GMRES then needs two
more iterations. At a fixed parameter the plane is p = const. (t_x = 0, t_p = 1), one solution
suffices, and the method is plain Newton. A step is shortened if the residual would grow. That
happens next to first contact, as the Jacobian changes like a square root.

All paths use this loop: response curves, paths to a cold start, resonances, and branches of exact
orbits. It runs in the kernel (``kernel/bordered.c``), for compiled and for Python equations
(:mod:`equations`).

Curves never use SNES. SNES has no border, and at a given parameter an SNES iteration takes ten
times as long as a compiled one (21 unknowns; docs/notebook/algorithms.md).

References
----------
See :mod:`path`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, Protocol, Self

import numpy as np
from petsc4py import PETSc

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import NULL, Struct, kernel, pointer, require_shape
from fenics_crack.numerics.equations import MACHINE_EPSILON, Linearisation, System, equations_of

COMM_SELF = PETSc.COMM_SELF
"""MPI communicator with this rank alone: all ranks solve the same equations."""
GMRES_RESTART: int = kernel.MAX_KRYLOV_VECTORS
"""Maximum number of Krylov vectors in GMRES before a restart."""
OPTIONS_PREFIX = "crack_hb_"
"""Prefix of users' PETSc options for SNES."""
FORCING_TERM = 1e-2
"""Relative residual |A x - r| / |r| of GMRES in shooting and in the first Newton step by SNES. For
later steps SNES chooses the residual, at most this value (Eisenstat and Walker, SIAM Journal on
Scientific Computing 17, 1996, 16)."""


def gmres(
    apply: Callable[[np.ndarray], np.ndarray],
    right_side: np.ndarray,
    tolerance: float,
    max_iterations: int = GMRES_RESTART,
) -> np.ndarray:
    """Solve A x = r by GMRES, up to |A x - r| <= tolerance |r|.

    If ``max_iterations`` do not suffice, the last x is returned without an error.

    Parameters
    ----------
    apply : callable
        Function from an array x to the product A x, both in the shape of r.
    right_side : (...)
        Right-hand side r, equal on all ranks. The solution has the same shape.
    """

    def multiply(_: Any, factor_vector: Any, product_vector: Any) -> None:
        """Write the product with A to ``product_vector``; PETSc calls this function."""
        product_vector.array_w[:] = apply(factor_vector.array_r.reshape(right_side.shape)).ravel()

    operator_matrix = PETSc.Mat().createPython(
        (right_side.size,) * 2, SimpleNamespace(mult=multiply), COMM_SELF
    )
    operator_matrix.setUp()
    solver = PETSc.KSP().create(COMM_SELF)
    solver.setOptionsPrefix("crack_krylov_")
    solver.setOperators(operator_matrix)
    solver.setType("gmres")
    solver.setGMRESRestart(GMRES_RESTART)
    solver.getPC().setType("none")
    solver.setTolerances(rtol=tolerance, atol=0.0, max_it=max_iterations)
    solver.setFromOptions()
    right_side_vector, solution_vector = operator_matrix.createVecs()
    right_side_vector.array_w[:] = right_side.ravel()
    solver.solve(right_side_vector, solution_vector)
    solution_array: np.ndarray = solution_vector.array_r.reshape(right_side.shape).copy()
    for petsc_object in (solver, operator_matrix, right_side_vector, solution_vector):
        petsc_object.destroy()
    return solution_array


class SnesSystem(System, Protocol):
    """Equations F(x, p) = 0 to be solved by SNES at a given parameter p.

    F has the units of x: SNES stops by |F| <= tolerance |x|.
    """

    shape: tuple[int, ...]
    """Shape of the unknowns x."""
    is_matrix_free: bool
    """True if the Jacobian J is not formed: GMRES then solves by products with J."""


def can_solve_in_kernel(system: SnesSystem) -> bool:
    """Return True if the compiled kernel can solve a system instead of PETSc's SNES.

    The kernel must have the equations, and no PETSc option may be given for SNES.
    """
    has_kernel_equations = getattr(system, "compiled_equations", None) is not None
    return has_kernel_equations and not PETSc.Options(OPTIONS_PREFIX).getAll()


class Snes(ABC):
    """Newton solver by PETSc's SNES for a system F(x) = 0, for any number of solutions.

    A solution has converged if |F| <= tolerance |x|. As a context manager the object frees the
    PETSc objects. Newton steps are full, unless a PETSc option sets a line search: with sampled
    contact forces line searches stall.
    """

    def __init__(self, matrix: Any, residual_norms: list[float] | None = None) -> None:
        """Create the PETSc solver for a Jacobian matrix.

        ``matrix`` is the PETSc matrix for the Jacobian, freed by this object. After every
        iteration, |F| is appended to ``residual_norms``, if given.
        """
        self.matrix, self._residual_norms = matrix, [] if residual_norms is None else residual_norms
        self._tolerance = 0.0
        self._convergence_error: ConvergenceError | None = None
        self._unknown_vector, self._residual_vector = matrix.createVecs()
        self._snes = PETSc.SNES().create(matrix.comm)
        self._snes.setOptionsPrefix(OPTIONS_PREFIX)
        self._snes.setFunction(self._set_residual, self._residual_vector)
        self._snes.setJacobian(
            lambda snes, unknown, *matrices: self.update_jacobian(unknown), matrix
        )
        petsc_options = PETSc.Options(OPTIONS_PREFIX)
        needs_default_line_search = not petsc_options.hasName("snes_linesearch_type")
        if needs_default_line_search:
            petsc_options["snes_linesearch_type"] = "basic"
        self._set_linear_solver_type(self._snes.getKSP())
        self._snes.setFromOptions()
        if needs_default_line_search:
            petsc_options.delValue("snes_linesearch_type")
        self._snes.setConvergenceTest(self._test_convergence)

    @abstractmethod
    def _set_linear_solver_type(self, linear_solver: Any) -> None:
        """Set defaults for the linear solver of Newton steps, a PETSc KSP.

        PETSc options override the defaults.
        """

    @abstractmethod
    def write_residual(self, unknown_vector: Any, residual_vector: Any) -> None:
        """Evaluate F at the unknowns in a PETSc vector, into ``residual_vector``."""

    @abstractmethod
    def update_jacobian(self, unknown_vector: Any) -> None:
        """Set the PETSc matrix of the Jacobian to J at the unknowns in a PETSc vector."""

    def solve_into_unknown_vector(
        self, start: np.ndarray, tolerance: float, max_iterations: int
    ) -> tuple[bool, int]:
        """Solve F(x) = 0 from a guess and leave the solution in ``_unknown_vector``.

        ``start`` holds this rank's entries of the guess.

        Returns
        -------
        converged : bool
            True if |F| <= ``tolerance`` |x|.
        n_iterations : int
            Newton iterations.
        """
        self._tolerance, self._convergence_error = tolerance, None
        self._unknown_vector.array_w[:] = start.ravel()
        self._snes.setTolerances(max_it=max_iterations)
        try:
            self._snes.solve(None, self._unknown_vector)
        except PETSc.Error:
            if self._convergence_error is None:
                raise
        if self._convergence_error is not None:  # PETSc may have hidden it
            raise self._convergence_error
        return self._snes.getConvergedReason() > 0, self._snes.getIterationNumber()

    def _test_convergence(
        self, snes: Any, n_iterations: int, norms: tuple[float, float, float]
    ) -> int:
        """Return PETSc's code to stop or to go on; SNES calls this method.

        SNES stops if |F| <= tolerance |x|, if |F| is not finite, or after the maximum number of
        iterations. ``norms`` are |x|, the norm of the Newton step, and |F|.
        """
        self._residual_norms.append(norms[2])
        if not np.isfinite(norms[2]):
            return int(PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN)
        if norms[2] <= self._tolerance * self._unknown_vector.norm():
            return int(PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE)
        if n_iterations >= snes.getTolerances()[3]:
            return int(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)
        return int(PETSc.SNES.ConvergedReason.ITERATING)

    def _set_residual(self, snes: Any, unknown_vector: Any, residual_vector: Any) -> None:
        """Write the residual F(x) for SNES; PETSc calls this method.

        ``unknown_vector`` has x, and ``residual_vector`` receives F. A ConvergenceError is stored
        before it is raised, as PETSc may hide errors.
        """
        try:
            self.write_residual(unknown_vector, residual_vector)
        except ConvergenceError as error:
            self._convergence_error = error
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for petsc_object in (self._snes, self.matrix, self._unknown_vector, self._residual_vector):
            petsc_object.destroy()


class SystemSnes(Snes):
    """SNES for a :class:`SnesSystem`; all ranks hold the same unknowns.

    Newton steps come from the linearisation's ``solve``, or for matrix-free systems from GMRES.
    """

    def __init__(self, system: SnesSystem, residual_norms: list[float] | None = None) -> None:
        self.system, self._parameter = system, 0.0
        self._last_unknown_and_linearisation: tuple[np.ndarray, Linearisation] | None = None
        self._linearisation: Linearisation
        n_unknowns = int(np.prod(system.shape))
        matrix = PETSc.Mat().createPython((n_unknowns, n_unknowns), self, COMM_SELF)
        matrix.setUp()
        super().__init__(matrix, residual_norms)

    def _set_linear_solver_type(self, linear_solver: Any) -> None:
        if self.system.is_matrix_free:
            linear_solver.setType("gmres")
            linear_solver.setGMRESRestart(GMRES_RESTART)
            linear_solver.setTolerances(max_it=GMRES_RESTART)
            linear_solver.getPC().setType("none")
            self._snes.setUseEW(True, version=2, rtol_0=FORCING_TERM, rtol_max=FORCING_TERM)
            self._snes.setMaxLinearSolveFailures(1000)  # better an inexact step than none
        else:
            linear_solver.setType("preonly")
            linear_solver.getPC().setType("python")
            linear_solver.getPC().setPythonContext(self)

    def solve_and_linearise(
        self, start: np.ndarray, parameter: float, tolerance: float, max_iterations: int
    ) -> tuple[Linearisation, bool, int]:
        """Solve F(x, p) = 0 at a parameter p from a guess ``start`` of x.

        Returns
        -------
        linearisation : Linearisation
            F and Jacobian at the last iterate; the unknowns are its ``unknown``.
        has_converged : bool
            True if |F| <= ``tolerance`` |x|.
        n_iterations : int
            Newton iterations.
        """
        self._parameter, self._last_unknown_and_linearisation = parameter, None
        has_converged, n_iterations = self.solve_into_unknown_vector(
            start, tolerance, max_iterations
        )
        return self._linearisation_at(self._unknown_vector), has_converged, n_iterations

    def _linearisation_at(self, unknown_vector: Any) -> Linearisation:
        """Return F and J at the unknowns in a PETSc vector, cached for the last unknowns."""
        if self._last_unknown_and_linearisation is None or not np.array_equal(
            unknown_vector.array_r, self._last_unknown_and_linearisation[0]
        ):
            unknown = unknown_vector.array_r.copy()
            linearisation = self.system.linearise(
                unknown.reshape(self.system.shape), self._parameter
            )
            self._last_unknown_and_linearisation = unknown, linearisation
        return self._last_unknown_and_linearisation[1]

    def write_residual(self, unknown_vector: Any, residual_vector: Any) -> None:
        residual_vector.array_w[:] = self._linearisation_at(unknown_vector).residual.ravel()

    def update_jacobian(self, unknown_vector: Any) -> None:
        self._linearisation = self._linearisation_at(unknown_vector)

    def mult(self, matrix: Any, factor_vector: Any, product_vector: Any) -> None:
        """Write the product J v to ``product_vector``, with v in ``factor_vector``.

        J is the Jacobian at the current unknowns. PETSc calls this method for a matrix that is not
        formed; ``matrix`` is not used.
        """
        product_vector.array_w[:] = self._linearisation.apply(
            factor_vector.array_r.reshape(self.system.shape)
        ).ravel()

    def apply(self, preconditioner: Any, right_side_vector: Any, solution_vector: Any) -> None:
        """Write the solution J^-1 r to ``solution_vector``, with r in ``right_side_vector``.

        J is the Jacobian at the current unknowns. PETSc calls this method as a preconditioner; the
        argument ``preconditioner`` is not used.
        """
        solution_vector.array_w[:] = self._linearisation.solve(
            right_side_vector.array_r.reshape(self.system.shape)
        ).ravel()


MAX_ITERATIONS = 8
"""Maximum Newton iterations to correct a predicted point of a path."""
MIN_DAMPING = 0.05
"""Minimum factor by which a Newton step is shortened before the method fails."""
MAX_ITERATIONS_AT_FIXED_PARAMETER = 20
"""Maximum Newton iterations from a guess at a given parameter."""
MAX_STALLED_STEPS = 8
"""Maximum number of successive Newton steps without halving the residual; after more, the method
fails."""
MAX_PARAMETER_CHANGE_IN_STEPS = 3.0
"""Maximum distance between corrected and predicted parameter, in step lengths."""


@dataclass(frozen=True)
class Tangent:
    """Unit tangent (t_x, t_p) of a path of solutions (x, p), in the norm w |x|^2 + p^2.

    Attributes
    ----------
    x, p
        Parts t_x, in the shape of the unknowns, and t_p.
    unknowns_weight : float
        Weight w of the unknowns, 1 / |x|^2 at the point
        (:func:`norm_weights_of_unknowns_and_means`).
    time_mean_weight : float
        Factor in |x|^2 for the squares of unknowns that are means over time.
    """

    x: np.ndarray
    p: float
    unknowns_weight: float
    time_mean_weight: float = 1.0

    def reverse(self) -> Tangent:
        """Return the tangent in the opposite direction, (-t_x, -t_p)."""
        return replace(self, x=-self.x, p=-self.p)

    def inner_product(self, system: System, vector: np.ndarray, other_vector: np.ndarray) -> float:
        """Return w <x, y>, the inner product of two vectors of unknowns in the tangent's norm.

        x is ``vector``, y is ``other_vector``, and w is ``unknowns_weight``. Products of means over
        time are multiplied by ``time_mean_weight``. ``system`` tells the number of means.
        """
        if self.time_mean_weight == 1.0:
            return self.unknowns_weight * float(np.vdot(vector, other_vector))
        flat_vector = vector.ravel()
        other_flat_vector = other_vector.ravel()
        n_means = count_time_means(system)
        oscillation_product = float(flat_vector[n_means:] @ other_flat_vector[n_means:])
        return self.unknowns_weight * (
            oscillation_product
            + self.time_mean_weight * float(flat_vector[:n_means] @ other_flat_vector[:n_means])
        )

    def cosine_to(self, reference_tangent: Tangent, system: System) -> float:
        """Return the cosine of the angle to a unit reference tangent, in the reference's norm.

        This tangent may have any length. If the length is 0 or overflows, the result is 0.
        """
        product = (
            reference_tangent.inner_product(system, self.x, reference_tangent.x)
            + self.p * reference_tangent.p
        )
        own_length_squared = reference_tangent.inner_product(system, self.x, self.x) + self.p**2
        # The slope overflows if the Jacobian is singular to rounding: there is no direction.
        return product / float(np.sqrt(own_length_squared)) if own_length_squared > 0.0 else 0.0


@dataclass(frozen=True)
class PathPoint:
    """Solution (x, p) of F(x, p) = 0 on a path, with the path's tangent."""

    unknown: np.ndarray
    """Unknowns x."""
    parameter: float
    """Parameter p."""
    iterations: int
    """Newton iterations that found the point."""
    tangent: Tangent
    """``tangent.p`` > 0 if the parameter grows along the path; the sign changes at folds."""
    crosses_branch: bool = False
    """True if another branch crosses between the previous point and this point."""
    linearisation: Linearisation | None = field(default=None, repr=False, compare=False)
    """F and Jacobian at the point; None if not kept."""
    chord_length_from_previous: float = float("nan")
    """Distance from the previous point, in the previous point's norm; nan if unknown."""
    record: np.ndarray | None = field(default=None, repr=False, compare=False)
    """:attr:`Linearisation.record` for a step control; None without a step control."""
    step_control_values: np.ndarray | None = field(default=None, repr=False, compare=False)
    """Values computed from ``record`` for a step control; None without a step control."""


def count_time_means(system: System) -> int:
    """Return the number of leading unknowns that are means over time; default 0."""
    return int(getattr(system, "n_time_means", 0))


def sum_of_squares_with_limited_mean(
    oscillation_norm_squared: float, mean_norm_squared: float
) -> float:
    """Return the squared size of a motion from its oscillation and its means over time.

    With the oscillation's sum of squares o and the means' sum of squares m, the result is o +
    min(m, o). So a large mean does not hide a small oscillation. If o < 1.8e-12 m, the oscillation
    is rounding error, and the result is o + m. The minimum is 1e-300.

    Parameters
    ----------
    oscillation_norm_squared, mean_norm_squared : float
        o and m.
    """
    has_large_means = (
        MACHINE_EPSILON**0.75 * mean_norm_squared < oscillation_norm_squared < mean_norm_squared
    )
    size_squared = (
        2.0 * oscillation_norm_squared
        if has_large_means
        else oscillation_norm_squared + mean_norm_squared
    )
    return max(size_squared, 1e-300)


def root_sum_of_squares_with_limited_mean(motion_samples: np.ndarray) -> float:
    """Return the size of k sampled motions (n_instants, k): the root of a sum of squares.

    The sum is over all instants and motions. The means' part of the sum is limited to the
    oscillations' part (:func:`sum_of_squares_with_limited_mean`).
    """
    time_mean = motion_samples.sum(axis=0) / len(motion_samples)
    oscillation_samples = motion_samples - time_mean
    mean_norm_squared = len(motion_samples) * float(time_mean @ time_mean)
    return math.sqrt(
        sum_of_squares_with_limited_mean(
            float(np.vdot(oscillation_samples, oscillation_samples)), mean_norm_squared
        )
    )


def change_relative_to_motion(change_samples: np.ndarray, motion_samples: np.ndarray) -> float:
    """Return the norm of a change, divided by the size of a motion.

    Both are samples (n_instants, k). In the divisor (:func:`root_sum_of_squares_with_limited_mean`)
    the mean over time is limited to the oscillation: a steady load does not make relative errors
    small. The result is 0 if the motion is zero.
    """
    return (
        float(np.linalg.norm(change_samples))
        / root_sum_of_squares_with_limited_mean(motion_samples)
        if motion_samples.any()
        else 0.0
    )


def norm_weights_of_unknowns_and_means(system: System, unknown: np.ndarray) -> tuple[float, float]:
    """Return the weights of the norm w |x|^2 + p^2 at a solution x.

    In |x| the means over time contribute at most as much as the oscillation. A clearance or a
    steady load may make means large. Steps must be relative to the oscillation all the same, to
    resolve a resonance. A change in a large mean is divided by the mean, not by the oscillation.
    For example, a crack's mean opening grows with a rotor's speed by far more than the oscillation.

    Returns
    -------
    weight : float
        w = 1 / |x|^2.
    time_mean_weight : float
        Factor in |x|^2 for the squares of the means; 1 if the means are not large.
    """
    mean_unknowns = unknown.ravel()[: count_time_means(system)]
    mean_norm_squared = float(mean_unknowns @ mean_unknowns)
    total_norm_squared = float(np.vdot(unknown, unknown))
    # Equations are solved to a fraction of this size: it must exceed the rounding of the means.
    oscillation_norm_squared = max(
        total_norm_squared - mean_norm_squared, MACHINE_EPSILON**0.5 * total_norm_squared
    )
    size_squared = sum_of_squares_with_limited_mean(oscillation_norm_squared, mean_norm_squared)
    time_mean_weight = (
        0.5 * size_squared / mean_norm_squared if 2.0 * mean_norm_squared > size_squared else 1.0
    )
    return 1.0 / size_squared, time_mean_weight


def tangent_of(
    system: System,
    unknown: np.ndarray,
    linearisation: Linearisation,
    direction: Tangent | None = None,
) -> Tangent:
    """Return the unit tangent of the path at a solution x.

    ``unknown`` is x, and ``linearisation`` has the derivatives at x. A path has two directions: the
    tangent has a positive cosine to ``direction``. If ``direction`` is None, the parameter p grows
    along the tangent.
    """
    unknowns_derivative_by_parameter = -linearisation.solve(linearisation.by_parameter)
    slope_tangent = Tangent(
        unknowns_derivative_by_parameter, 1.0, *norm_weights_of_unknowns_and_means(system, unknown)
    )
    length = float(
        np.sqrt(
            slope_tangent.inner_product(
                system, unknowns_derivative_by_parameter, unknowns_derivative_by_parameter
            )
            + 1.0
        )
    )
    tangent = replace(slope_tangent, x=unknowns_derivative_by_parameter / length, p=1.0 / length)
    points_back = direction is not None and tangent.cosine_to(direction, system) < 0.0
    return tangent.reverse() if points_back else tangent


def point_on_path(
    system: System, unknown: np.ndarray, parameter: float, direction: Tangent | None = None
) -> PathPoint:
    """Make a point of a path from a solution (x, p), with the path's tangent.

    ``unknown`` is x, and ``parameter`` is p. A path has two directions: the tangent has a positive
    cosine to ``direction``. If ``direction`` is None, p grows along the tangent.
    """
    linearisation = system.linearise(unknown, parameter)
    return PathPoint(unknown, parameter, 0, tangent_of(system, unknown, linearisation, direction))


def solve_in_plane(
    system: System,
    unknown: np.ndarray,
    parameter: float,
    plane: Tangent | None,
    *,
    tolerance: float,
    max_iterations: int = MAX_ITERATIONS,
    max_parameter_change: float = np.inf,
    min_damping: float | None = MIN_DAMPING,
    max_stalled_steps: int = 0,
) -> PathPoint | None:
    """Solve F(x, p) = 0 by Newton's method in a plane, or at a given p.

    Parameters
    ----------
    unknown, parameter
        Guess of x and p. The plane passes through the guess.
    plane : Tangent or None
        Normal of the plane, the tangent of a path. None: p stays as given.
    tolerance : float
        Maximum |F| / |x| of the solution. With a plane, |x| is taken at the point of its tangent.
    max_iterations : int
        Maximum number of Newton steps.
    max_parameter_change : float
        Maximum distance of p from the guess.
    min_damping : float or None
        Steps are shortened if the residual would grow, by a factor down to this. None: full steps.
    max_stalled_steps : int
        Give up if so many successive steps, at most 30, do not halve |F| / |x|; 0: no limit.

    Returns
    -------
    PathPoint or None
        Solution; ``tangent`` is the normal of the plane. None if the method fails.
    """
    equations = equations_of(system, unknown.shape)
    tangent = plane or Tangent(np.zeros_like(unknown), 1.0, 0.0)
    solution, parameter_out = np.array(unknown, float, order="C"), np.array([parameter], float)
    n_iterations_out, plane_pointer = np.zeros(1, np.intc), NULL
    if plane is not None:
        normal = require_shape(plane.x, *equations.shape)
        norm_struct = Struct(
            "norm", weight=plane.unknowns_weight, time_mean_weight=plane.time_mean_weight
        )
        plane_pointer = Struct("plane", normal=normal, slope=plane.p, metric=norm_struct).address
    min_kernel_damping = -1.0 if min_damping is None else min_damping
    correction_options = correction_struct(
        tolerance, max_parameter_change, max_iterations, min_kernel_damping, max_stalled_steps
    )
    outcome = equations.run_unchecked(
        kernel.solve_in_plane, plane_pointer, correction_options.address,
        pointer(require_shape(solution, *equations.shape)),
        pointer(parameter_out), pointer(n_iterations_out),
    )  # fmt: skip
    if not equations.has_found_solution(outcome):
        return None
    parameter = float(parameter_out[0])
    return PathPoint(
        solution, parameter, int(n_iterations_out[0]), tangent,
        linearisation=equations.linearise_evaluated(solution, parameter),
    )  # fmt: skip


@lru_cache
def correction_struct(
    tolerance: float,
    max_parameter_change: float,
    max_iterations: int = MAX_ITERATIONS,
    min_damping: float = MIN_DAMPING,
    max_stalled_steps: int = 0,
) -> Struct:
    """Return options of Newton's method as the kernel's struct ``correction``.

    Parameters
    ----------
    tolerance : float
        Maximum |F| / |x| of the solution.
    max_parameter_change : float
        Maximum distance of p from the guess. For ``kernel.follow_path``, a multiple of the step
        length.
    max_iterations : int
        Maximum number of Newton steps.
    min_damping : float
        Minimum factor of a shortened step; negative: full steps.
    max_stalled_steps : int
        Give up if so many successive steps do not halve |F| / |x|; 0: no limit.
    """
    return Struct(
        "correction", tolerance=tolerance, max_parameter_change=max_parameter_change,
        max_iterations=max_iterations, min_damping=min_damping,
        max_stalled_steps=max_stalled_steps,
    )  # fmt: skip


def predict_and_correct(
    system: System,
    start_point: PathPoint,
    step_length: float,
    tolerance: float,
    *,
    max_parameter_change: float | None = None,
) -> PathPoint | None:
    """Return the point of a path after a step from a start; None if Newton's method fails.

    The prediction lies at the distance ``step_length`` on the start's tangent. Newton's method
    corrects the prediction in the plane orthogonal to this tangent, until |F| / |x| <=
    ``tolerance``. The returned point has the start's tangent. ``max_parameter_change`` limits the
    distance between corrected and predicted parameter; default: 3 ``step_length``.
    """
    tangent = start_point.tangent
    predicted_unknown = start_point.unknown + step_length * tangent.x
    predicted_parameter = start_point.parameter + step_length * tangent.p
    max_parameter_change = max_parameter_change or MAX_PARAMETER_CHANGE_IN_STEPS * step_length
    return solve_in_plane(
        system,
        predicted_unknown,
        predicted_parameter,
        tangent,
        tolerance=tolerance,
        max_parameter_change=max_parameter_change,
    )


def try_step(
    system: System, start_point: PathPoint, step_length: float, tolerance: float = 1e-8
) -> PathPoint | None:
    """Return the point of a path after a step from a start, with the tangent there.

    ``step_length`` is measured along the start's tangent. At the new point |F| / |x| <=
    ``tolerance``. The new tangent has a positive cosine to the start's. The result is None if
    Newton's method fails.
    """
    corrected_point = predict_and_correct(system, start_point, step_length, tolerance)
    if corrected_point is None or corrected_point.linearisation is None:
        return None
    return replace(
        corrected_point,
        tangent=tangent_of(
            system, corrected_point.unknown, corrected_point.linearisation, start_point.tangent
        ),
    )


def solve_at_parameter(
    system: System,
    unknown: np.ndarray,
    parameter: float,
    *,
    tolerance: float,
    max_iterations: int = MAX_ITERATIONS_AT_FIXED_PARAMETER,
    min_damping: float | None = None,
) -> PathPoint | None:
    """Solve F(x, p) = 0 at given p from a guess of x; None if Newton's method fails.

    ``unknown`` is the guess, ``parameter`` is p, and ``tolerance`` is the maximum |F| / |x|. Newton
    steps are full. If ``min_damping`` is given, steps that increase the residual are shortened by a
    factor down to this value.
    """
    return solve_in_plane(
        system, unknown, parameter, None,
        tolerance=tolerance, max_iterations=max_iterations, min_damping=min_damping,
        max_stalled_steps=MAX_STALLED_STEPS,
    )  # fmt: skip


def solve_by_full_or_damped_steps(
    system: System,
    unknown: np.ndarray,
    parameter: float,
    *,
    tolerance: float,
    try_full_steps: bool = True,
) -> PathPoint | None:
    """Solve F(x, p) = 0 at given p by full Newton steps; None if all attempts fail.

    If full steps fail, or if ``try_full_steps`` is False, damped steps are tried. Their damping
    factors are at least 0.01. ``unknown`` is the guess of x, and ``tolerance`` the maximum |F| /
    |x|.
    """
    point = (
        solve_at_parameter(system, unknown, parameter, tolerance=tolerance)
        if try_full_steps
        else None
    )
    return point or solve_at_parameter(
        system, unknown, parameter, tolerance=tolerance, min_damping=0.01
    )


def chord_length(system: System, start: PathPoint, end: PathPoint) -> float:
    """Return the distance between two points (x, p) of a path.

    The distance is the root of w |dx|^2 + dp^2, with the differences dx and dp between the points.
    The weight w belongs to the tangent of ``start``.
    """
    change = end.unknown - start.unknown
    length_squared = start.tangent.inner_product(system, change, change)
    return float(np.sqrt(length_squared + (end.parameter - start.parameter) ** 2))
