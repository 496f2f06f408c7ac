"""Bifurcations of exact orbits: where multipliers cross the unit circle, without truncation.

Harmonic balance locates a bifurcation as well as its wave is resolved: with stiff contact and few
harmonics, to some per cent. Here the branch of exact orbits, F(z / |z_0|, w / w_0) = 0 of
:mod:`shooting`, is followed from there by pseudo-arc-length in both directions, until the test
function of the bifurcation changes its sign:

    period doubling     det(I + M),
    Neimark-Sacker      |mu| - 1 of a complex pair,
    fold                t_w, the tangent's component along the frequency,

with the monodromy matrix M and its eigenvalues mu. The root along the branch is found by Brent's
method.

Source: Kuznetsov, Elements of Applied Bifurcation Theory, chapter 10; Seydel, Practical
Bifurcation and Stability Analysis, chapters 4 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from fenics_crack.balance.arclength import Stepping, follow_path
from fenics_crack.balance.bordered import PathPoint, locate, solve_in_plane, tangent_of
from fenics_crack.balance.linearisation import DenseLinearisation, System
from fenics_crack.balance.orbits import FlowOrbits, OrbitPoint
from fenics_crack.balance.rounding import EPSILON
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError, InputError, check_number
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import PeriodicOrbit, doubling_test
from fenics_crack.stability.shooting import orbits_near

__all__ = ["refine_bifurcation"]

TOLERANCE = 1e-12
"""|z(T) - z| / |z| of the points, where the flow does not enlarge rounding beyond it."""
MAX_ITERATIONS, MIN_DAMPING = 30, 0.01
"""From the solution to the branch."""
ALIKE = 0.5
"""Farthest orbit from the solution's motion from which the branch is followed, relative."""
MAX_STEPS = 400
"""In each direction."""

Test = Callable[[PathPoint], float]


class _Special(Protocol):
    """What is asked of a bifurcation: as :class:`fenics_crack.curves.curve.Bifurcation`."""

    @property
    def kind(self) -> str: ...

    @property
    def solution(self) -> PeriodicSolution: ...


def refine_bifurcation(
    bifurcation: _Special,
    structure: Structure | None = None,
    contact: ContactLaw | None = None,
    *,
    reach: float = 0.05,
    longest_step: float = 0.02,
) -> tuple[float, PeriodicOrbit]:
    """Locate a bifurcation found by harmonic balance on the branch of exact orbits.

    Parameters
    ----------
    bifurcation : Bifurcation
        Of a curve; or anything with ``kind`` and ``solution``.
    structure : Structure, optional
        Default: the solution's; at most 600 dofs.
    contact : UnilateralPenalty, optional
        Default: the solution's.
    reach : float
        How far to look, relative to the frequency of the solution; at most 0.5.
    longest_step : float
        Along the branch, relative to the solution's size and frequency.

    Returns
    -------
    omega : float [rad/s]
        Load frequency of the bifurcation nearest along the branch.
    orbit : PeriodicOrbit
        The orbit there.

    Raises
    ------
    InputError
        The kind is another, or as :func:`fenics_crack.integrate_events`.
    ConvergenceError
        No exact orbit near the solution, or no bifurcation of this kind within reach of it.

    Notes
    -----
    With few harmonics a curve has special points that are not there on exact orbits, or several
    where these have one: several of them may lead to the same point, or to none.
    """
    kind, solution = bifurcation.kind, bifurcation.solution
    if kind not in TESTS:
        raise InputError("kind", kind, "one of " + ", ".join(map(repr, TESTS)))
    check_number("reach", reach, 0.0, above=True)
    if reach > 0.5:
        raise InputError("reach", reach, "at most 0.5")
    check_number("longest_step", longest_step, 0.0, above=True)
    law = solution.contact if contact is None else contact
    assert law is not None
    branch = _Branch(orbits_near(structure or solution.structure, law, solution))
    start = branch.first()
    if start is None or _far(start, branch.start):
        raise ConvergenceError(
            f"refinement: no exact orbit near the solution at {solution.omega:g} rad/s"
        )
    sides = [
        _sought(branch, replace(start, tangent=tangent), TESTS[kind](), reach, longest_step)
        for tangent in (start.tangent, start.tangent.reversed())
    ]
    while sides:
        for side in list(sides):
            try:
                found = next(side)
            except StopIteration:
                sides.remove(side)
                continue
            if found is not None:
                return found.parameter * solution.omega, branch.orbit(found)
    raise ConvergenceError(
        f"refinement: no {kind.replace('_', ' ')} of exact orbits within "
        f"{100.0 * reach:g} % of {solution.omega:g} rad/s"
    )


def _far(found: PathPoint, motion: np.ndarray) -> bool:
    """Whether an orbit is another one than a solution's motion."""
    return bool(np.linalg.norm(found.unknown - motion) > ALIKE * np.linalg.norm(motion))


class _NoFlow(DenseLinearisation):
    """Where pairs chatter: no number is known."""

    def assemble(self) -> np.ndarray:
        """Not a number."""
        return np.full(2 * self.unknown.shape, np.nan)

    def differentiate(self) -> np.ndarray:
        """Not a number."""
        return np.full_like(self.unknown, np.nan)


class _Branch:
    """Orbits as a branch; where pairs chatter there is none."""

    tolerance = TOLERANCE

    def __init__(self, orbits: FlowOrbits) -> None:
        self._orbits, self.start, self.compiled = orbits, orbits.start, orbits.compiled
        self.inner = orbits.inner

    def orbit(self, found: PathPoint) -> PeriodicOrbit:
        """The orbit of a point."""
        return self._orbits.orbit(found)

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint | _NoFlow:
        """The equations at (x, p); without a residual where there is no flow over the period."""
        try:
            return self._orbits.linearise(unknown, parameter)
        except ConvergenceError:
            return _NoFlow(unknown, np.full_like(unknown, np.nan))

    def first(self) -> PathPoint | None:
        """The point next to the solution, across the branch."""
        at = self.linearise(self.start, 1.0)
        if isinstance(at, OrbitPoint):
            self.tolerance = max(TOLERANCE, 100.0 * EPSILON * float(np.linalg.norm(at.monodromy)))
        found = solve_in_plane(
            self,
            self.start,
            1.0,
            tangent_of(self, self.start, at),
            tolerance=self.tolerance,
            iterations=MAX_ITERATIONS,
            reach=0.5,
            least_damping=MIN_DAMPING,
        )
        if found is None:
            return None
        assert found.at is not None
        return replace(found, tangent=tangent_of(self, found.unknown, found.at))


def _sought(
    branch: _Branch, start: PathPoint, test: Test, reach: float, longest: float
) -> Iterator[PathPoint | None]:
    """Follow the branch; yield None after each step, and the point where the test vanishes."""
    stepping = Stepping(
        0.1 * longest, longest, 1e-7 * longest, MAX_STEPS, branch.tolerance, least_cosine=0.9,
        rounding=branch.tolerance,
    )  # fmt: skip
    before, value = start, test(start)
    for point in follow_path(branch, start.unknown, start.parameter, stepping, start.tangent):
        point = evaluated(branch, point)
        now = test(point)
        if np.isnan(now):
            return
        if value * now <= 0.0:
            found = locate(branch, before, point, test, branch.tolerance)
            if found is before or found is point:
                raise ConvergenceError("refinement: lost between two exact orbits")
            yield found
            return
        if abs(point.parameter - 1.0) > reach:
            return
        before, value = point, now
        yield None


def evaluated(system: System, point: PathPoint) -> PathPoint:
    """A point with the equations there, which those of the kernel's paths do without."""
    return (
        point if point.at else replace(point, at=system.linearise(point.unknown, point.parameter))
    )


def _turning(point: PathPoint) -> float:
    """Changes its sign where the branch turns back in frequency."""
    return point.tangent.p


def _doubling(point: PathPoint) -> float:
    """det(I + M)."""
    return doubling_test(_orbit(point).monodromy)


class _PairTest:
    """|mu| - 1 of a complex multiplier: of the first point's nearest one to the unit circle.

    At each other point it is the one nearest to that of the point before.
    """

    def __init__(self) -> None:
        self._followed: complex | None = None

    def __call__(self, point: PathPoint) -> float:
        values = _orbit(point).multipliers
        pairs = values[values.imag > 1e-6 * np.abs(values)]
        if not len(pairs):
            return np.nan
        far = np.abs(pairs) - 1.0 if self._followed is None else pairs - self._followed
        self._followed = complex(pairs[np.argmin(np.abs(far))])
        return abs(self._followed) - 1.0


def _orbit(point: PathPoint) -> OrbitPoint:
    assert isinstance(point.at, OrbitPoint)
    return point.at


TESTS: dict[str, Callable[[], Test]] = {
    "fold": lambda: _turning,
    "period_doubling": lambda: _doubling,
    "neimark_sacker": _PairTest,
}
"""By the kind of a bifurcation, what makes its test function."""
