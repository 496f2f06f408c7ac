"""Newton's method: by PETSc's SNES for single solutions, bordered by a plane along paths.

**By SNES**, with GMRES of KSP where the matrix is not formed. Single solutions are found this way;
PETSc options with the prefix ``crack_hb_`` reach it, and GMRES with ``crack_krylov_``. One object
serves a system for all attempts at its solution. Where the kernel has the equations, and no such
option is given, the same steps are taken there.

**Bordered by a plane.** A point of a path has a unit tangent (t_x, t_p) in the norm w |x|^2 + p^2,
w = 1 / |x_0|^2 (:func:`norm_at`). In the plane orthogonal to a tangent Newton's method solves

    [ J    F_p ] [dx]     [F]
    [ t_x  t_p ] [dp] = - [0],     by two solutions with J:

    dx = a + dp b,    J a = -F,    J b = -F_p,    dp = - w <t_x, a> / (w <t_x, b> + t_p),

or by one with the bordered matrix where J is not formed (GMRES needs two iterations more for it).
At a fixed parameter the plane is p = const. (t_x = 0, t_p = 1), one solution is enough, and the
method is Newton's own. Where the residual would grow, as where crack faces begin to touch and the
Jacobian changes like a square root, the step is shortened.

All paths are followed with this loop: response curves, paths to a cold start, resonances, and
branches of exact orbits. It is the kernel's
(``kernel/bordered.c``), for compiled equations and for those in Python (:mod:`equations`). Single
solutions go through it where the kernel has their equations, and through PETSc's SNES
where it has not, or where PETSc's options request that. Curves never do: SNES knows
no border, and at given parameters, where none is needed, an iteration by SNES takes ten times as
long as one by the compiled loop (21 unknowns; docs/notebook/earlier_measurements.md).

Sources: those of :mod:`path`.
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
from fenics_crack.kernel import NULL, Struct, kernel, pointer, shaped
from fenics_crack.numerics.equations import MACHINE_EPSILON, Linearisation, System, equations_of

COMM_SELF = PETSc.COMM_SELF
GMRES_RESTART: int = kernel.KRYLOV_MOST
"""Vectors that GMRES keeps."""
OPTIONS_PREFIX = "crack_hb_"
FORCING_TERM = 1e-2
"""Relative residual of GMRES in the first steps; later ones are solved as sharply as pays
(Eisenstat and Walker, SIAM Journal on Scientific Computing 17, 1996, 16)."""


def gmres(
    apply: Callable[[np.ndarray], np.ndarray],
    right: np.ndarray,
    tolerance: float,
    most: int = GMRES_RESTART,
) -> np.ndarray:
    """x with A x = r to |A x - r| <= tolerance |r|, for arrays of one shape, the same on all ranks;
    or the best that ``most`` iterations find."""

    def multiply(_: Any, source: Any, target: Any) -> None:
        target.array_w[:] = apply(source.array_r.reshape(right.shape)).ravel()

    matrix = PETSc.Mat().createPython((right.size,) * 2, SimpleNamespace(mult=multiply), COMM_SELF)
    matrix.setUp()
    solver = PETSc.KSP().create(COMM_SELF)
    solver.setOptionsPrefix("crack_krylov_")
    solver.setOperators(matrix)
    solver.setType("gmres")
    solver.setGMRESRestart(GMRES_RESTART)
    solver.getPC().setType("none")
    solver.setTolerances(rtol=tolerance, atol=0.0, max_it=most)
    solver.setFromOptions()
    source, target = matrix.createVecs()
    source.array_w[:] = right.ravel()
    solver.solve(source, target)
    found: np.ndarray = target.array_r.reshape(right.shape).copy()
    for item in (solver, matrix, source, target):
        item.destroy()
    return found


class SingleSystem(System, Protocol):
    """A system of which single solutions are sought; F in the units of x."""

    shape: tuple[int, ...]
    """Shape of the unknowns."""
    matrix_free: bool
    """True if the system only applies its Jacobian: GMRES solves with it then."""


def can_solve_in_kernel(system: SingleSystem) -> bool:
    """Return True if the kernel has a system, and no option is for SNES."""
    has = getattr(system, "compiled", None) is not None
    return has and not PETSc.Options(OPTIONS_PREFIX).getAll()


class Snes(ABC):
    """PETSc's SNES for one system, for all solutions of it; a context manager, which frees it.

    Full steps, unless PETSc options say otherwise: line searches stall at the kinks of the merit
    function where contact is sampled. Converged where |F| <= tolerance |x|.
    """

    def __init__(self, matrix: Any, history: list[float] | None = None) -> None:
        """``matrix`` is the Jacobian's; ``history`` is where |F| of every iteration goes."""
        self.matrix, self._history = matrix, [] if history is None else history
        self._tolerance = 0.0
        self._failure: ConvergenceError | None = None
        self._unknown, self._target = matrix.createVecs()
        self._snes = PETSc.SNES().create(matrix.comm)
        self._snes.setOptionsPrefix(OPTIONS_PREFIX)
        self._snes.setFunction(self._set_residual, self._target)
        self._snes.setJacobian(lambda snes, unknown, *matrices: self.linearise(unknown), matrix)
        options = PETSc.Options(OPTIONS_PREFIX)
        choose_search = not options.hasName("snes_linesearch_type")
        if choose_search:
            options["snes_linesearch_type"] = "basic"
        self._choose_solver(self._snes.getKSP())
        self._snes.setFromOptions()
        if choose_search:
            options.delValue("snes_linesearch_type")
        self._snes.setConvergenceTest(self._converged)

    @abstractmethod
    def _choose_solver(self, solver: Any) -> None:
        """Set the default solver of the linear systems, a KSP."""

    @abstractmethod
    def evaluate(self, unknown: Any, target: Any) -> None:
        """Set a vector to F at another one."""

    @abstractmethod
    def linearise(self, unknown: Any) -> None:
        """Make the matrix the Jacobian at a vector."""

    def run(self, start: np.ndarray, tolerance: float, most_iterations: int) -> tuple[bool, int]:
        """Return True if steps from this rank's rows of a guess converged, and their number."""
        self._tolerance, self._failure = tolerance, None
        self._unknown.array_w[:] = start.ravel()
        self._snes.setTolerances(max_it=most_iterations)
        try:
            self._snes.solve(None, self._unknown)
        except PETSc.Error:
            if self._failure is None:
                raise
        if self._failure is not None:  # whatever PETSc has made of it
            raise self._failure
        return self._snes.getConvergedReason() > 0, self._snes.getIterationNumber()

    def _converged(self, snes: Any, count: int, norms: tuple[float, float, float]) -> int:
        """Measure the residual relative to the unknowns themselves."""
        self._history.append(norms[2])
        if not np.isfinite(norms[2]):
            return int(PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN)
        if norms[2] <= self._tolerance * self._unknown.norm():
            return int(PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE)
        if count >= snes.getTolerances()[3]:
            return int(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)
        return int(PETSc.SNES.ConvergedReason.ITERATING)

    def _set_residual(self, snes: Any, unknown: Any, target: Any) -> None:
        try:
            self.evaluate(unknown, target)
        except ConvergenceError as error:
            self._failure = error
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for item in (self._snes, self.matrix, self._unknown, self._target):
            item.destroy()


class Newton(Snes):
    """SNES for a system whose Jacobian solves by itself, or is applied by GMRES; the unknowns are
    the same on every rank."""

    def __init__(self, system: SingleSystem, history: list[float] | None = None) -> None:
        self.system, self._parameter = system, 0.0
        self._at: tuple[np.ndarray, Linearisation] | None = None
        self._tangent: Linearisation
        size = int(np.prod(system.shape))
        matrix = PETSc.Mat().createPython((size, size), self, COMM_SELF)
        matrix.setUp()
        super().__init__(matrix, history)

    def _choose_solver(self, solver: Any) -> None:
        if self.system.matrix_free:
            solver.setType("gmres")
            solver.setGMRESRestart(GMRES_RESTART)
            solver.setTolerances(max_it=GMRES_RESTART)
            solver.getPC().setType("none")
            self._snes.setUseEW(True, version=2, rtol_0=FORCING_TERM, rtol_max=FORCING_TERM)
            self._snes.setMaxLinearSolveFailures(1000)  # an inexact step is better than none
        else:
            solver.setType("preonly")
            solver.getPC().setType("python")
            solver.getPC().setPythonContext(self)

    def solve(
        self, start: np.ndarray, parameter: float, tolerance: float, most_iterations: int
    ) -> tuple[Linearisation, bool, int]:
        """The system at the last iterate, whether that converged, and the number of iterations."""
        self._parameter, self._at = parameter, None
        converged, count = self.run(start, tolerance, most_iterations)
        return self._point(self._unknown), converged, count

    def _point(self, unknown: Any) -> Linearisation:
        """The system at a vector; SNES requests residual and Jacobian at the same one."""
        if self._at is None or not np.array_equal(unknown.array_r, self._at[0]):
            place = unknown.array_r.copy()
            at = self.system.linearise(place.reshape(self.system.shape), self._parameter)
            self._at = place, at
        return self._at[1]

    def evaluate(self, unknown: Any, target: Any) -> None:
        target.array_w[:] = self._point(unknown).residual.ravel()

    def linearise(self, unknown: Any) -> None:
        self._tangent = self._point(unknown)

    def mult(self, matrix: Any, source: Any, target: Any) -> None:
        """Jacobian times a vector, called by PETSc."""
        target.array_w[:] = self._tangent.apply(source.array_r.reshape(self.system.shape)).ravel()

    def apply(self, preconditioner: Any, source: Any, target: Any) -> None:
        """Inverse of the Jacobian times a vector, called by PETSc."""
        target.array_w[:] = self._tangent.solve(source.array_r.reshape(self.system.shape)).ravel()


MAX_ITERATIONS = 8
"""Maximum iterations of one correction."""
MIN_DAMPING = 0.05
"""Minimum damping factor of a Newton step."""
MAX_FULL_STEPS, MAX_STALLED_STEPS = 20, 8
"""Budget of full steps from a guess at a given parameter: their number, and those that may together
fail to halve the residual."""
MAX_PARAMETER_REACH = 3.0
"""Maximum distance of the parameter from its prediction, in steps."""


@dataclass(frozen=True)
class Tangent:
    """Unit tangent (t_x, t_p) in the norm weight |x|^2 + p^2, where the squares of means count by
    ``of_means``."""

    x: np.ndarray
    p: float
    weight: float
    of_means: float = 1.0

    def reverse(self) -> Tangent:
        """The opposite direction."""
        return replace(self, x=-self.x, p=-self.p)

    def product(self, system: System, first: np.ndarray, second: np.ndarray) -> float:
        """<x, y> in its norm."""
        if self.of_means == 1.0:
            return self.weight * float(np.vdot(first, second))
        x, y, means = first.ravel(), second.ravel(), means_of(system)
        others = float(x[means:] @ y[means:])
        return self.weight * (others + self.of_means * float(x[:means] @ y[:means]))

    def cosine_to(self, other: Tangent, system: System) -> float:
        """Cosine of the angle to another tangent, in that one's norm."""
        product = other.product(system, self.x, other.x) + self.p * other.p
        length = other.product(system, self.x, self.x) + self.p**2
        # No direction where the Jacobian is singular to rounding: the slope has overflowed.
        return product / float(np.sqrt(length)) if length > 0.0 else 0.0


@dataclass(frozen=True)
class PathPoint:
    """A point of a path, and the iterations that it took."""

    unknown: np.ndarray
    parameter: float
    iterations: int
    tangent: Tangent
    """``tangent.p`` > 0 where the parameter grows along the path; the sign changes at folds."""
    crosses_branch: bool = False
    """True if another branch has been crossed since the point before."""
    linearisation: Linearisation | None = field(default=None, repr=False, compare=False)
    length: float = float("nan")
    """Length of the chord from the point before in that one's norm, where it is known."""
    record: np.ndarray | None = field(default=None, repr=False, compare=False)
    observed: np.ndarray | None = field(default=None, repr=False, compare=False)
    """What a step control uses: the linearisation's record, and values that follow from it."""


def means_of(system: System) -> int:
    """Return the number of a system's unknowns, the first ones, that are means over time."""
    return int(getattr(system, "means", 0))


def motion_square(moving: float, means: float) -> float:
    """The square of a size, given that of the means over time and that of all else: means
    contribute no more than all else, unless that is rounding, as where nothing vibrates."""
    whole = moving + means
    return max(2.0 * moving if MACHINE_EPSILON**0.75 * means < moving < means else whole, 1e-300)


def motion_size(motion: np.ndarray) -> float:
    """The size of a motion in time (n, k), over all of that, likewise."""
    mean = motion.sum(axis=0) / len(motion)
    moving = motion - mean
    means = len(motion) * float(mean @ mean)
    return math.sqrt(motion_square(float(np.vdot(moving, moving)), means))


def relative_to_motion(change: np.ndarray, whole: np.ndarray) -> float:
    """Size of a change of a motion in time (n, k) relative to that of the whole, to which its means
    contribute no more than all else: a steady load does not make errors small."""
    return float(np.linalg.norm(change)) / motion_size(whole) if whole.any() else 0.0


def norm_at(system: System, unknown: np.ndarray) -> tuple[float, float]:
    """Return the weights of the norm at a solution: 1 / |x|^2, and that of squares of means.

    To its size the means contribute no more than all else: a clearance or a steady load may make
    them as large as they like, and steps by which a resonance is seen are parts of what moves.
    Where they are larger, they change by parts of themselves: what holds a crack open grows with a
    rotor's speed by many times what moves."""
    mean = unknown.ravel()[: means_of(system)]
    means = float(mean @ mean)
    whole = float(np.vdot(unknown, unknown))
    # Equations are solved to a part of this size, which rounding of the means must not be.
    square = motion_square(max(whole - means, MACHINE_EPSILON**0.5 * whole), means)
    return 1.0 / square, 0.5 * square / means if 2.0 * means > square else 1.0


def tangent_of(
    system: System, unknown: np.ndarray, at: Linearisation, towards: Tangent | None = None
) -> Tangent:
    """Tangent at a solution, towards growing p or in a direction that is known roughly."""
    slope = -at.solve(at.by_parameter)
    across = Tangent(slope, 1.0, *norm_at(system, unknown))
    length = float(np.sqrt(across.product(system, slope, slope) + 1.0))
    found = replace(across, x=slope / length, p=1.0 / length)
    back = towards is not None and found.cosine_to(towards, system) < 0.0
    return found.reverse() if back else found


def point_on_path(
    system: System, unknown: np.ndarray, parameter: float, towards: Tangent | None = None
) -> PathPoint:
    """A solution with its tangent (:func:`tangent_of`)."""
    at = system.linearise(unknown, parameter)
    return PathPoint(unknown, parameter, 0, tangent_of(system, unknown, at, towards))


def solve_in_plane(
    system: System,
    unknown: np.ndarray,
    parameter: float,
    plane: Tangent | None,
    *,
    tolerance: float,
    iterations: int = MAX_ITERATIONS,
    reach: float = np.inf,
    least_damping: float | None = MIN_DAMPING,
    stall: int = 0,
) -> PathPoint | None:
    """Newton's method in the plane across a tangent, or at a given parameter; None where it fails.

    ``tolerance`` is |F| / |x| of the solution, |x| that of the tangent's point; ``reach``: how far
    from the guess the parameter may go; ``least_damping``: how much a step may be shortened where
    the residual would grow, None for full steps whatever it does; ``stall``: steps, at most 30,
    that may together fail to halve |F| / |x|, 0 for any number.
    """
    equations = equations_of(system, unknown.shape)
    flat = plane or Tangent(np.zeros_like(unknown), 1.0, 0.0)
    found, place = np.array(unknown, float, order="C"), np.array([parameter], float)
    taken, border = np.zeros(1, np.intc), NULL
    if plane is not None:
        across = shaped(plane.x, *equations.shape)
        size = Struct("norm", weight=plane.weight, of_means=plane.of_means)
        border = Struct("plane", across=across, slope=plane.p, size=size).at
    shortest = -1.0 if least_damping is None else least_damping
    how = correction_struct(tolerance, reach, iterations, shortest, stall)
    outcome = equations.run(
        kernel.solve_in_plane, border, how.at, pointer(shaped(found, *equations.shape)),
        pointer(place), pointer(taken),
    )  # fmt: skip
    if not equations.check(outcome):
        return None
    parameter = float(place[0])
    return PathPoint(
        found,
        parameter,
        int(taken[0]),
        flat,
        linearisation=equations.linearise_evaluated(found, parameter),
    )


@lru_cache
def correction_struct(
    tolerance: float,
    reach: float,
    iterations: int = MAX_ITERATIONS,
    least_damping: float = MIN_DAMPING,
    stall: int = 0,
) -> Struct:
    """The kernel's own, as :func:`solve_in_plane` has it; ``reach`` along a path in steps."""
    return Struct(
        "correction", tolerance=tolerance, reach=reach, iterations=iterations,
        least_damping=least_damping, stall=stall,
    )  # fmt: skip


def predict_and_correct(
    system: System, start: PathPoint, step: float, tolerance: float, *, reach: float | None = None
) -> PathPoint | None:
    """The point of a path at a distance from another one; None where it is not found.

    The prediction goes along the tangent. The parameter may then change by ``reach``, by default 3
    steps.
    """
    ahead = start.tangent
    unknown, parameter = start.unknown + step * ahead.x, start.parameter + step * ahead.p
    reach = reach or MAX_PARAMETER_REACH * step
    return solve_in_plane(system, unknown, parameter, ahead, tolerance=tolerance, reach=reach)


def step_along(
    system: System, start: PathPoint, step: float, tolerance: float = 1e-8
) -> PathPoint | None:
    """The same with the tangent there, which keeps its direction."""
    found = predict_and_correct(system, start, step, tolerance)
    if found is None or found.linearisation is None:
        return None
    return replace(
        found, tangent=tangent_of(system, found.unknown, found.linearisation, start.tangent)
    )


def solve_at(
    system: System,
    unknown: np.ndarray,
    parameter: float,
    *,
    tolerance: float,
    iterations: int = MAX_FULL_STEPS,
    least_damping: float | None = None,
) -> PathPoint | None:
    """Newton steps from a guess at a given parameter, full ones unless they may be shortened; None
    where they do not converge."""
    return solve_in_plane(
        system, unknown, parameter, None,
        tolerance=tolerance, iterations=iterations, least_damping=least_damping,
        stall=MAX_STALLED_STEPS,
    )  # fmt: skip


def solve_robustly(
    system: System, unknown: np.ndarray, parameter: float, *, tolerance: float, full: bool = True
) -> PathPoint | None:
    """A solution at a parameter by full steps from a guess, or else by steps that are shortened
    where the residual would grow; by these alone unless ``full``."""
    found = solve_at(system, unknown, parameter, tolerance=tolerance) if full else None
    return found or solve_at(system, unknown, parameter, tolerance=tolerance, least_damping=0.01)


def chord_length(system: System, before: PathPoint, after: PathPoint) -> float:
    """Length of the chord between two points in the norm of the first one."""
    change = after.unknown - before.unknown
    square = before.tangent.product(system, change, change)
    return float(np.sqrt(square + (after.parameter - before.parameter) ** 2))
