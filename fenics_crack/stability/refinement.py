"""Bifurcations of exact orbits: where multipliers cross the unit circle, without truncation.

Harmonic balance locates a bifurcation as well as its wave is resolved: with stiff contact and few
harmonics, to some per cent. Here the branch of exact orbits is followed from there by shooting,

    F(z, w) = z(2 pi m / w; z, w) - z = 0,          m: periods of the load in the response's,

z the state at phase zero, by pseudo-arc-length in (z / |z_0|, w / w_0) in both directions, until
the test function of the bifurcation changes its sign:

    period doubling     det(I + M), scaled by the product of 1 + |mu_j|,
    Neimark-Sacker      |mu| - 1 of a complex pair,
    fold                t_w, the tangent's component along the frequency,

with the monodromy matrix M = dz(T)/dz, its eigenvalues mu and dF = [M - I, dF/dw]; dF/dw is a
central difference. The root along the branch is found by Brent's method.

Source: Kuznetsov, Elements of Applied Bifurcation Theory, chapter 10; Seydel, Practical
Bifurcation and Stability Analysis, chapters 4 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy.optimize

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError, InputError, check_number
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.stability.floquet import doubling_test
from fenics_crack.stability.shooting import PeriodicOrbit, describe_orbit
from fenics_crack.time.events import EventFlow
from fenics_crack.time.march import initial_state

__all__ = ["refine_bifurcation"]

KINDS = ("fold", "period_doubling", "neimark_sacker")
TOLERANCE, ROUNDING = 1e-12, 1e-9
"""Of |z(T) - z| relative to |z|; and what is accepted where Newton's method gets no further."""
MOST_ITERATIONS = 30
LEAST_COSINE = 0.9
"""Of the angle between neighbouring tangents."""
MOST_STEPS = 400
"""In each direction."""


class _Special(Protocol):
    """What is asked of a bifurcation: as :class:`fenics_crack.curves.continuation.Bifurcation`."""

    @property
    def kind(self) -> str: ...

    @property
    def solution(self) -> PeriodicSolution: ...


@dataclass(frozen=True)
class _Point:
    """A point x = (z / |z_0|, w / w_0) of the branch, and what is known there."""

    x: np.ndarray
    tangent: np.ndarray
    monodromy: np.ndarray
    multipliers: np.ndarray
    residual: float
    iterations: int
    events: int


def refine_bifurcation(
    bifurcation: _Special,
    structure: Structure | None = None,
    contact: ContactLaw | None = None,
    *,
    reach: float = 0.2,
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

    Notes
    -----
    With few harmonics a curve has special points that are not there on exact orbits, or several
    where these have one: several of them may lead to the same point, or to none.

    Raises
    ------
    InputError
        The kind is another, or as :func:`fenics_crack.time.events.integrate_events`.
    ConvergenceError
        No exact orbit near the solution, or no bifurcation of this kind within reach of it.
    """
    kind, solution = bifurcation.kind, bifurcation.solution
    if kind not in KINDS:
        raise InputError("kind", kind, "one of " + ", ".join(map(repr, KINDS)))
    check_number("reach", reach, 0.0, above=True)
    if reach > 0.5:
        raise InputError("reach", reach, "at most 0.5")
    check_number("longest_step", longest_step, 0.0, above=True)
    law = solution.contact if contact is None else contact
    branch = _ExactBranch(structure or solution.structure, law, solution)  # type: ignore[arg-type]
    start = branch.first()
    if start is None:
        raise ConvergenceError(
            f"refinement: no exact orbit near the solution at {solution.omega:g} rad/s"
        )
    test = {"fold": _turning, "period_doubling": _doubling}.get(kind)
    sides = [
        _march(branch, start, sign * start.tangent, test or _PairTest(start), reach, longest_step)
        for sign in (1.0, -1.0)
    ]
    while sides:
        for side in list(sides):
            try:
                found = next(side)
            except StopIteration:
                sides.remove(side)
                continue
            if found is not None:
                return float(found.x[-1] * branch.omega), branch.orbit(found)
    raise ConvergenceError(
        f"refinement: no {kind.replace('_', ' ')} of exact orbits within "
        f"{100.0 * reach:g} % of {solution.omega:g} rad/s"
    )


class _ExactBranch:
    """The equations of exact orbits in x = (z / |z_0|, w / w_0), and Newton's method for them."""

    def __init__(
        self, structure: Structure, contact: ContactLaw, solution: PeriodicSolution
    ) -> None:
        self.omega = solution.omega
        self._turns = 2.0 * np.pi * solution.subharmonic
        self._flow = EventFlow(structure, self.omega, contact)
        state = self._flow.state(*initial_state(structure, solution))
        self._size = float(np.linalg.norm(state)) or 1.0
        self._start = np.append(state / self._size, 1.0)

    def first(self) -> _Point | None:
        """The point next to the solution, orthogonal to the branch."""
        try:
            _, monodromy, _ = self._mismatch(self._start)
            normal = np.linalg.svd(self._slopes(self._start, monodromy))[2][-1]
        except (ConvergenceError, np.linalg.LinAlgError):
            return None
        return self._correct(self._start, normal)

    def along(self, point: _Point, step: float) -> _Point | None:
        """The point at a distance along the tangent of another one."""
        return self._correct(point.x + step * point.tangent, point.tangent)

    def orbit(self, point: _Point) -> PeriodicOrbit:
        """The orbit of a point."""
        omega = float(point.x[-1] * self.omega)
        return describe_orbit(
            self._flow.at(omega),
            self._size * point.x[:-1],
            self._turns / omega,
            point.monodromy,
            point.residual,
            point.iterations,
            point.events,
        )

    def _mismatch(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """F, M and the number of switching instants."""
        moved, monodromy, events = self._moved(x, np.eye(len(x) - 1))
        assert monodromy is not None
        return moved - x[:-1], monodromy, events

    def _moved(
        self, x: np.ndarray, monodromy: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray | None, int]:
        omega = float(x[-1] * self.omega)
        if omega != self._flow.omega:
            self._flow = self._flow.at(omega)
        moved, _, monodromy, events = self._flow.advance(
            self._size * x[:-1], 0.0, self._turns / omega, monodromy=monodromy
        )
        return moved / self._size, monodromy, events

    def _slopes(self, x: np.ndarray, monodromy: np.ndarray) -> np.ndarray:
        """dF/dx: (2n, 2n + 1)."""
        shift = np.zeros(len(x))
        shift[-1] = 1e-6
        by_frequency = (self._moved(x + shift)[0] - self._moved(x - shift)[0]) / 2e-6
        return np.hstack([monodromy - np.eye(len(monodromy)), by_frequency[:, None]])

    def _correct(self, guess: np.ndarray, normal: np.ndarray) -> _Point | None:
        """The point in the plane through a guess; None where it is not found."""
        try:
            return self._newton(guess, normal)
        except (ConvergenceError, np.linalg.LinAlgError):  # pairs chatter, or a singular point
            return None

    def _newton(self, guess: np.ndarray, normal: np.ndarray) -> _Point | None:
        """Newton's method in this plane, damped."""
        x = guess
        residual, monodromy, events = self._mismatch(x)
        before = float(np.linalg.norm(residual))
        for iteration in range(MOST_ITERATIONS):
            if not before < 10.0:
                return None
            matrix = np.vstack([self._slopes(x, monodromy), normal])
            size = float(np.linalg.norm(x[:-1]))
            if before <= TOLERANCE * size:
                return self._point(x, matrix, monodromy, before / size, iteration, events)
            change = np.linalg.solve(matrix, np.append(residual, normal @ (x - guess)))
            damping = 1.0
            while True:
                trial = x - damping * change
                if 0.5 < trial[-1] < 2.0:
                    residual, found, count = self._mismatch(trial)
                    now = float(np.linalg.norm(residual))
                    if now < before:
                        break
                damping *= 0.5
                if damping < 0.01:
                    if before > ROUNDING * size:
                        return None
                    return self._point(x, matrix, monodromy, before / size, iteration, events)
            x, before, monodromy, events = trial, now, found, count
        return None

    def _point(
        self,
        x: np.ndarray,
        matrix: np.ndarray,
        monodromy: np.ndarray,
        residual: float,
        iterations: int,
        events: int,
    ) -> _Point:
        last = np.zeros(len(x))
        last[-1] = 1.0
        tangent = np.linalg.solve(matrix, last)
        multipliers = np.linalg.eigvals(monodromy)
        return _Point(
            x, tangent / np.linalg.norm(tangent), monodromy, multipliers, residual, iterations,
            events,
        )  # fmt: skip


def _turning(point: _Point) -> float:
    """Changes its sign where the branch turns back in frequency."""
    return float(point.tangent[-1])


def _doubling(point: _Point) -> float:
    """det(I + M), scaled."""
    return doubling_test(point.multipliers)


class _PairTest:
    """|mu| - 1 of the complex multiplier nearest to the one at the point before."""

    def __init__(self, start: _Point) -> None:
        pairs = _pairs(start)
        nearest = np.argmin(np.abs(np.abs(pairs) - 1.0)) if len(pairs) else 0
        self._followed = pairs[nearest] if len(pairs) else np.nan

    def __call__(self, point: _Point) -> float:
        pairs = _pairs(point)
        if not len(pairs) or np.isnan(self._followed):
            return np.nan
        self._followed = pairs[np.argmin(np.abs(pairs - self._followed))]
        return float(np.abs(self._followed) - 1.0)


def _pairs(point: _Point) -> np.ndarray:
    """Multipliers above the real axis."""
    values = point.multipliers
    return values[values.imag > 1e-6 * np.abs(values)]


def _march(
    branch: _ExactBranch,
    start: _Point,
    direction: np.ndarray,
    test: Callable[[_Point], float],
    reach: float,
    longest_step: float,
) -> Iterator[_Point | None]:
    """Follow the branch; yield None after each step, and the point where the test vanishes."""
    here = replace(start, tangent=direction)
    value, step = test(here), 0.1 * longest_step
    for _ in range(MOST_STEPS):
        found = branch.along(here, step)
        while found is None or found.tangent @ here.tangent < LEAST_COSINE:
            step *= 0.5
            if step < 1e-7 * longest_step:
                return
            found = branch.along(here, step)
        now = test(found)
        if np.isnan(now):
            return
        if value * now <= 0.0:
            yield _locate(branch, here, step, found, test)
            return
        if abs(found.x[-1] - 1.0) > reach:
            return
        here, value = found, now
        yield None
        if found.iterations <= 4:
            step = min(longest_step, 1.5 * step)


def _locate(
    branch: _ExactBranch,
    before: _Point,
    step: float,
    after: _Point,
    test: Callable[[_Point], float],
) -> _Point:
    """Point between two others where a test function vanishes, by the method of Brent."""
    met = {0.0: before, step: after}

    def value(length: float) -> float:
        if length not in met:
            found = branch.along(before, length)
            if found is None:
                raise ConvergenceError("refinement: lost between two exact orbits")
            met[length] = found
        return test(met[length])

    root = scipy.optimize.brentq(value, 0.0, step, xtol=1e-13, rtol=1e-13)
    value(root)
    return met[root]
