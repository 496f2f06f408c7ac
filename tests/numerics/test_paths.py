"""Paths by arc-length: in a plane, through folds and past other branches, and of exact orbits;
PETSc's SNES and the kernel's loops on the same equations; systems whose matrix is not formed."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice, pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import chain, relative

import fenics_crack as fc
from fenics_crack.curves.balance_equations import EQUATIONS_CLASS_BY_PARAMETER
from fenics_crack.motion.flow import exact_flow_or_none
from fenics_crack.motion.orbit import find_orbit
from fenics_crack.motion.shooting import FlowOrbitEquations
from fenics_crack.numerics.equations import DenseLinearisation
from fenics_crack.numerics.newton import (
    PathPoint,
    SystemSnes,
    gmres,
    point_on_path,
    solve_at_parameter,
    solve_in_plane,
)
from fenics_crack.numerics.path import (
    ClosedLoop,
    EndReason,
    Fold,
    Path,
    PathOptions,
    Target,
    ZeroCrossing,
)

Function = Callable[[float, float], float]


class Place(DenseLinearisation):
    """A plane's equations at a point: (f, y - 2); J is diagonal."""

    def __init__(self, plane: Plane, unknown: np.ndarray, p: float) -> None:
        self.plane, self.p = plane, p
        self.unknown = unknown
        self.residual = np.array([plane.f(unknown[0], p), unknown[1] - 2.0])

    @property
    def jacobian(self) -> np.ndarray:
        """J."""
        return np.diag([self.plane.by_x(self.unknown[0], self.p), 1.0])

    @property
    def by_parameter(self) -> np.ndarray:
        """dF/dp."""
        return np.array([self.plane.by_p(self.unknown[0], self.p), 0.0])


class Plane:
    """f(x, p) = 0 in a plane, beside y = 2, which keeps the norm of (x, y) from vanishing."""

    def __init__(self, f: Function, by_x: Function, by_p: Function) -> None:
        self.f, self.by_x, self.by_p = f, by_x, by_p

    def linearise(self, unknown: np.ndarray, parameter: float) -> Place:
        """At a point."""
        return Place(self, unknown, parameter)


def follow(
    plane: Plane, x: float, p: float, end: float, longest: float
) -> tuple[np.ndarray, np.ndarray, list[PathPoint]]:
    """x and p along the path up to p = end; every point lies on the curve."""
    points = []
    path = Path(plane, point_on_path(plane, np.array([x, 2.0]), p), PathOptions(0.05, longest))
    for point in islice(path.points(), 500):
        points.append(point)
        if point.parameter > end:
            break
    xs = np.array([point.unknown[0] for point in points])
    ps = np.array([point.parameter for point in points])
    assert max(abs(plane.f(*pair)) for pair in zip(xs, ps, strict=True)) < 1e-7
    return xs, ps, points


@pytest.mark.parametrize("longest", [0.05, 0.2, 1.0])
def test_path_passes_both_folds_of_a_cubic(longest: float) -> None:
    """x^3 - x = p: p grows to 0.385 at x = -0.577, falls to -0.385 at 0.577, and grows again."""
    plane = Plane(lambda x, p: x**3 - x - p, lambda x, p: 3.0 * x * x - 1.0, lambda x, p: -1.0)
    x, p, _ = follow(plane, -1.5, -1.875, 1.875, longest)
    assert np.all(np.diff(x) > 0.0)
    assert p[-1] > 1.875
    is_growing = np.diff(p) > 0.0
    first_fold, second_fold = np.flatnonzero(is_growing[1:] != is_growing[:-1]) + 1
    fold = 1.0 / np.sqrt(3.0)
    assert is_growing[0] and not is_growing[first_fold] and is_growing[second_fold]
    assert abs(x[first_fold] + fold) < 0.35 and abs(x[second_fold] - fold) < 0.35
    assert p.max() > 0.0 and 0.2 < p[first_fold] <= 2.0 / 3.0 * fold
    assert -2.0 / 3.0 * fold <= p[second_fold] < -0.2


@pytest.mark.parametrize("longest", [0.2, 1.0])
@pytest.mark.parametrize("distance", [0.1, 0.01, 0.001])
def test_path_stays_on_its_branch_where_another_comes_near(distance: float, longest: float) -> None:
    """x^2 - p^2 = d^2: at p = 0 the branch turns sharply, the other one lies straight ahead."""
    plane = Plane(
        lambda x, p: x * x - p * p - distance**2, lambda x, p: 2.0 * x, lambda x, p: -2.0 * p
    )
    x, p, points = follow(plane, float(np.hypot(1.0, distance)), -1.0, 1.0, longest)
    assert p[-1] > 1.0 and np.all(np.diff(p) > 0.0)
    assert np.all(x >= 0.99 * distance)
    assert not any(point.crosses_branch for point in points)


@pytest.mark.parametrize("distance", [0.1, 0.01, 0.001])
def test_path_stays_beside_a_parallel_branch(distance: float) -> None:
    """x = sin p and x = sin p + d: never from one to the other, over a whole wave."""

    def off(x: float, p: float) -> float:
        return x - np.sin(p)

    plane = Plane(
        lambda x, p: off(x, p) * (off(x, p) - distance) / distance,
        lambda x, p: (2.0 * off(x, p) - distance) / distance,
        lambda x, p: -np.cos(p) * (2.0 * off(x, p) - distance) / distance,
    )
    x, p, _ = follow(plane, 0.0, 0.0, 6.0, 1.0)
    assert p[-1] > 6.0 and np.all(np.diff(p) > 0.0)
    assert np.abs(x - np.sin(p)).max() < 1e-4 * distance


def test_path_ends_where_there_is_no_more() -> None:
    """x = -p as far as p = 0, where the function ends: so does the path, by itself, close to it."""
    plane = Plane(lambda x, p: x + p if p < 0.0 else np.nan, lambda x, p: 1.0, lambda x, p: 1.0)
    start = point_on_path(plane, np.array([1.0, 2.0]), -1.0)
    path = Path(plane, start, PathOptions(0.05, 1.0, max_steps=500))
    points = list(path.points())
    assert 3 < len(points) < 500 and path.end_reason is EndReason.STEPS_TOO_SHORT
    assert -1e-3 < points[-1].parameter < 0.0


# --- events ---------------------------------------------------------------------------------------


def circle() -> tuple[Plane, PathPoint]:
    """x^2 + p^2 = 1, and (1, 0) on it, from where p grows."""
    plane = Plane(lambda x, p: x * x + p * p - 1.0, lambda x, p: 2.0 * x, lambda x, p: 2.0 * p)
    return plane, point_on_path(plane, np.array([1.0, 2.0]), 0.0)


def test_once_round_a_circle() -> None:
    """Two folds, two zeros of x, and the path has closed where it began."""
    plane, start = circle()
    events = Fold(), ZeroCrossing(lambda point: float(point.unknown[0])), ClosedLoop(start, plane)
    path = Path(plane, start, PathOptions(0.05, max_step=0.3), events)
    located_events = [located_event for stretch in path for located_event in stretch.located_events]
    places = [
        (float(event_point.unknown[0]), event_point.parameter)
        for event, event_point in located_events
        if event is events[0]
    ]
    assert np.allclose(places, [(0.0, 1.0), (0.0, -1.0)], atol=1e-7)
    zeros = [event_point.parameter for event, event_point in located_events if event is events[1]]
    assert np.allclose(zeros, [1.0, -1.0], atol=1e-10)
    assert path.end_reason is EndReason.TERMINAL_EVENT_REACHED and path.terminal_event is events[2]
    assert (
        np.allclose(path.last_point.unknown, start.unknown)
        and path.find_terminal_event_point_or_none() is path.last_point
    )


@pytest.mark.parametrize("end", [0.7, -0.4])
def test_target(end: float) -> None:
    """Met at its own value: below the start by way of the first fold, and back."""
    plane, start = circle()
    path = Path(plane, start, PathOptions(0.05, max_step=0.3), [Target(end)])
    points = list(path.points())
    assert path.end_reason is EndReason.TERMINAL_EVENT_REACHED and points[-1].parameter == end
    side = 1.0 if end > 0.0 else -1.0
    assert points[-1].unknown[0] == pytest.approx(side * np.sqrt(1.0 - end**2), abs=1e-10)


def test_path_ends_where_it_leaves_its_range_and_after_its_steps() -> None:
    """Points outside are not yielded."""
    plane, start = circle()
    path = Path(plane, start, PathOptions(0.05, max_step=0.3, parameter_range=(-0.5, 2.0)))
    assert min(point.parameter for point in path.points()) > -0.5
    assert (
        path.end_reason is EndReason.RANGE_LEFT and path.find_terminal_event_point_or_none() is None
    )
    path = Path(plane, start, PathOptions(0.05, 1.0, max_steps=7))
    assert len(list(path.points())) == 7 and path.end_reason is EndReason.TOO_MANY_POINTS


def test_target_is_sought_by_shorter_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is not found between two points: as long as they are not too short, then the path
    ends before it."""
    plane, start = circle()
    locate, step_sizes = Target.locate, list[float]()

    def fails(
        self: Target, system: Plane, ends: tuple[PathPoint, PathPoint], rtol: float
    ) -> object:
        step_sizes.append(ends[1].parameter - ends[0].parameter)
        return locate(self, system, ends, rtol) if len(step_sizes) > n_failures else None

    monkeypatch.setattr(Target, "locate", fails)
    for n_failures in (2, 99):
        step_sizes.clear()
        path = Path(plane, start, PathOptions(0.1, max_step=0.3), [Target(0.7)])
        end_point = path.find_terminal_event_point_or_none()
        assert all(next_size < size for size, next_size in pairwise(step_sizes))
        if n_failures == 2:
            assert end_point is not None and end_point.parameter == 0.7 and len(step_sizes) == 3
        else:
            assert (
                path.end_reason is EndReason.EVENT_NOT_LOCATED and path.last_point.parameter < 0.7
            )
            assert step_sizes[-1] < 1e-5 and len(step_sizes) < 20


def test_what_equations_raise_ends_a_path() -> None:
    """In Python, called back by the kernel: their own error, whatever it is."""

    def fails(x: float, p: float) -> float:
        if p > 0.5:
            raise KeyboardInterrupt
        return x - p

    plane = Plane(fails, lambda x, p: 1.0, lambda x, p: -1.0)
    start = point_on_path(plane, np.array([0.0, 2.0]), 0.0)
    path, n_points = Path(plane, start, PathOptions(0.1, 1.0)), 0
    with pytest.raises(KeyboardInterrupt):
        for _ in path.points():
            n_points += 1
    assert n_points > 1 and path.last_point.parameter <= 0.5


# --- exact orbits ---------------------------------------------------------------------------------


RIGID = fc.UnilateralConstraint()


@pytest.mark.parametrize("light", [False, True])
def test_equations_of_a_path(light: bool) -> None:
    """Residual, both derivatives, and a path in the kernel whose points are orbits."""
    structure, contact = chain(pairs=3, seed=2), fc.UnilateralPenalty(20.0)
    if light:
        structure, contact = fc.reduce_structure(structure, modes=6, method="massless"), RIGID
    flow = exact_flow_or_none(structure, contact)
    settled_state = flow.advance(np.zeros(flow.state_size), 0.6, 30 * 2.0 * np.pi / 0.6).state
    system, step = FlowOrbitEquations(flow, 0.6, settled_state), 1e-6
    x = 1.05 * system.start_unknown
    linearisation = system.linearise(x, 1.02)
    end_state = flow.advance(x / system.state_factors, 0.612, 2.0 * np.pi / 0.612).state
    assert relative(linearisation.residual, system.state_factors * end_state - x) < 1e-12
    ends = [system.linearise(x, 1.02 + h).residual for h in (step, -step)]
    assert relative(linearisation.by_parameter, (ends[0] - ends[1]) / (2.0 * step)) < 1e-6
    change = np.random.default_rng(0).normal(size=flow.state_size)
    ends = [system.linearise(x + h * change, 1.02).residual for h in (step, -step)]
    assert relative(linearisation.jacobian @ change, (ends[0] - ends[1]) / (2.0 * step)) < 1e-6
    solution = solve_in_plane(system, system.start_unknown, 1.0, None, tolerance=1e-11)
    options = PathOptions(0.01, max_step=0.05, max_steps=6, parameter_range=(0.9, 1.1))
    points = list(Path(system, point_on_path(system, solution.unknown, 1.0), options).points())
    assert len(points) > 4
    for point in points:
        orbit = find_orbit(flow, point.parameter * 0.6, point.unknown / system.state_factors)
        assert relative(point.unknown, system.state_factors * orbit.state) < 1e-6


class Narrow:
    """x = f(p), once around a narrow circle at p = 0; the sign of det J is not told."""

    width, size = 0.003, 0.3

    def linearise(self, unknown: np.ndarray, parameter: float) -> SimpleNamespace:
        """J = I."""
        wave = 1.0 / (1.0 + 1j * parameter / self.width)
        rate = -1j * wave**2 / self.width
        value = np.array([1.0 + self.size * wave.real, self.size * wave.imag, parameter])
        slope = np.array([self.size * rate.real, self.size * rate.imag, 1.0])
        return SimpleNamespace(
            residual=unknown - value, by_parameter=-slope, solve=np.copy, sign=np.nan
        )  # fmt: skip


@pytest.mark.parametrize("number", range(12))
def test_without_a_sign_no_way_back(number: int) -> None:
    """A step may land on the far side of a narrow resonance, where the path seems to come back."""
    begin, system = -1.0 - 0.013 * number, Narrow()
    start_unknown = -system.linearise(np.zeros(3), begin).residual
    parameter = begin
    start = point_on_path(system, start_unknown, begin)  # type: ignore[arg-type]
    options = PathOptions(0.1, max_step=0.1, min_cosine=0.85, max_steps=200)
    for point in Path(system, start, options).points():  # type: ignore[arg-type]
        assert point.parameter > parameter
        parameter = point.parameter
    assert parameter > 1.0


def test_rounding_does_not_grow_with_the_stiffness() -> None:
    """The slope is bounded by the inverse of R_inf: a stiffer law is solved as sharply."""
    structure = fc.reduce_structure(chain("modal", pairs=3), modes=6, method="massless")
    first_omega = structure.omega[0]
    roundings = []
    for law in (fc.UnilateralPenalty(0.1), fc.UnilateralPenalty(1e20), fc.UnilateralConstraint()):
        problem = fc.Problem(structure.varied(damping=1e-4), first_omega, law, 5)  # in resonance
        family = EQUATIONS_CLASS_BY_PARAMETER["omega"](
            problem, 0.99 * first_omega, 1.01 * first_omega
        )
        roundings.append(family.rounding(0.5))
    assert (
        roundings[1:] == pytest.approx(roundings[2] * np.ones(2))
        and roundings[0] < roundings[2] < 1e-7
    )


# --- full steps -----------------------------------------------------------------------------------

PENALTY = fc.UnilateralPenalty(np.array([3.0, 8.0, 20.0]))


def equations(kind: str) -> Any:
    """A system whose path begins next to the linear solution."""
    structure = chain("modal", pairs=3)
    if kind == "coupled":
        structure = fc.reduce_structure(structure, modes=6, method="massless")
        rigid = fc.Problem(structure, 0.6, fc.UnilateralConstraint(), 8)
        system: Any = rigid.system(rigid.compliance_model())
        return system.system_along_softness()
    law = fc.SmoothedPenalty(5.0, 20.0) if kind == "smooth" else PENALTY
    problem = fc.Problem(structure, 0.6, law, 6, samples=128 if kind == "sampled" else None)
    return problem.system(problem.compliance_model()).system_along_softness()


@pytest.mark.parametrize("kind", ["exact", "sampled", "smooth", "coupled"])
def test_snes_finds_the_end_of_a_path(kind: str) -> None:
    """Full steps of SNES from near the path's end, and that end, in the kernel and called back."""
    system = equations(kind)
    start_solution = solve_at_parameter(system, system.linear_gap, 0.0, tolerance=1e-12)
    start = point_on_path(system, start_solution.unknown, 0.0)
    end_point = Path(
        system, start, PathOptions(0.1, max_step=0.5), [Target(1.0)]
    ).find_terminal_event_point_or_none()
    assert end_point is not None and end_point.parameter == 1.0
    disturbed_unknown = end_point.unknown * (
        1.0 + 1e-3 * np.random.default_rng(0).normal(size=end_point.unknown.shape)
    )
    with SystemSnes(system) as newton:
        point, is_converged, count = newton.solve_and_linearise(disturbed_unknown, 1.0, 1e-12, 20)
    assert is_converged and 0 < count < 10
    assert relative(point.unknown, end_point.unknown) < 1e-10


# --- linear systems whose matrix is not formed ----------------------------------------------------


def system(size: int = 40, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A matrix that is not symmetric, and a right-hand side of two columns' shape."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(size) + rng.normal(size=(size, size)) / np.sqrt(size)
    return matrix, rng.normal(size=(size // 2, 2))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-7, 1e-12])
def test_solution_to_a_tolerance(tolerance: float) -> None:
    """That of LAPACK, and a residual below what is allowed."""
    matrix, right = system()
    solution = gmres(lambda v: (matrix @ v.ravel()).reshape(v.shape), right, tolerance)
    assert solution.shape == right.shape
    left = matrix @ solution.ravel() - right.ravel()
    assert np.linalg.norm(left) <= 1.001 * tolerance * np.linalg.norm(right)
    exact = np.linalg.solve(matrix, right.ravel())
    assert relative(solution.ravel(), exact) < np.linalg.cond(matrix) * tolerance


def test_too_few_iterations_give_the_best() -> None:
    """The least residual in the Krylov space: that of a least-squares problem, and no applications
    beyond."""
    matrix, rhs = system()
    applied_vectors = []

    def apply(vector: np.ndarray) -> np.ndarray:
        applied_vectors.append(vector)
        return (matrix @ vector.ravel()).reshape(vector.shape)

    lefts = []
    for max_iterations in (1, 5, 15):
        del applied_vectors[:]
        solution = gmres(apply, rhs, 1e-14, max_iterations)
        assert len(applied_vectors) <= max_iterations + 1
        space = [rhs.ravel()]
        while len(space) < max_iterations:
            space.append(matrix @ space[-1])
        basis = np.linalg.qr(np.array(space).T)[0]
        least_squares_solution = basis @ np.linalg.lstsq(matrix @ basis, rhs.ravel(), rcond=None)[0]
        assert relative(solution.ravel(), least_squares_solution) < 1e-6
        lefts.append(np.linalg.norm(matrix @ solution.ravel() - rhs.ravel()))
    assert lefts[0] > lefts[1] > lefts[2] > 1e-6


def test_nothing_is_solved_by_nothing() -> None:
    """A right-hand side of zeros."""
    matrix, rhs = system()
    solution = gmres(lambda v: (matrix @ v.ravel()).reshape(v.shape), 0.0 * rhs, 1e-9)
    assert np.array_equal(solution, np.zeros_like(rhs))
