"""Search for a periodic orbit of the exact flow: guesses, Newton's method, and one budget.

Newton's method (:mod:`orbit`) leads to an orbit from the motion of nearly every harmonic-balance
solution with few harmonics. Where it leads to none from all of some guesses, it is tried from where
one step of the whole motion leads (:func:`fenics_crack.motion.orbit.predicted`); then along a path,

    p (z(T) - a) - (z - a) = 0,    from z = a at p = 0 to an orbit at p = 1,

through folds: damping lets no solution for p <= 1 go far, and at p = 0 there is no other. Then from
close returns of the motion that begins with the guess (recurrence search): a motion that no orbit
attracts is irregular, and passes near orbits that it leaves again.

Sources: Chow, Mallet-Paret and Yorke, Mathematics of Computation 32 (1978) 887-899; Auerbach et
al., Physical Review Letters 58 (1987) 2387-2389.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.progress import begin
from fenics_crack.basics.tables import counted, percent
from fenics_crack.motion.flow import Budget, ContactFlow
from fenics_crack.motion.orbit import (
    MAX_MODES_FOR_MONODROMY,
    MAX_SEARCH_PERIODS,
    PeriodicOrbit,
    find_orbit,
    is_same_orbit,
    predict_orbit,
)
from fenics_crack.motion.shooting import FlowOrbits, OrbitPoint
from fenics_crack.numerics.equations import LOCATION_TOLERANCE, DenseLinearisation
from fenics_crack.numerics.fourier import differentiate, fourier_basis_over_period
from fenics_crack.numerics.newton import point_on_path, solve_in_plane
from fenics_crack.numerics.path import HOMOTOPY_OPTIONS, Path, Target

SEGMENTS = 32
"""Multiple-shooting segments per period."""
PIECES_PER_PERIOD = 200
"""Taylor pieces in a period that counts as one; with fewer it counts as one, too."""
MAX_RETURN_PERIODS = 8
"""Longest return period that is sought, in periods."""


@dataclass(frozen=True)
class SearchOptions:
    """Options of a search for an orbit; the defaults suit up to 120 modes.

    Attributes
    ----------
    harmonics : tuple of int
        Of the load's frequency, of the harmonic-balance solutions that are its guesses.
    evaluations : int
        Periods of the flow that may be followed where Newton's method leads to no orbit from them:
        half of them along the path, a quarter of the motion, the rest from where that nearly
        repeats itself. They are of 200 pieces of the Taylor series and 12 modes; others count by
        the time they take, like pieces and the square of the modes. About a second; with friction
        three quarters of them, one to three seconds.
    """

    harmonics: tuple[int, ...] = (5, 10, 20, 40)
    evaluations: int = 4000

    def pieces(self, flow: ContactFlow) -> int:
        """Pieces of the Taylor series for them."""
        count = (0.75 if flow.friction else 1.0) * self.evaluations
        return int(PIECES_PER_PERIOD * count * min(1.0, (24.0 / flow.size) ** 2))

    def periods(self, flow: ContactFlow) -> int:
        """Return the maximum number of periods that the motion is integrated for."""
        return max(self.pieces(flow) // (4 * PIECES_PER_PERIOD), 60)


class OrbitSearch(NamedTuple):
    """Result of a search.

    Attributes
    ----------
    orbit : PeriodicOrbit or None
        A stable one if one was met, else the first.
    others : tuple of PeriodicOrbit
        Other orbits that were met.
    reason : str
        Way in which it was found, or the attempts and the outcome of the motion.
    """

    orbit: PeriodicOrbit | None
    other_orbits: tuple[PeriodicOrbit, ...]
    reason: str


def search_orbit(
    flow: ContactFlow,
    omega: float,
    guesses: Iterable[np.ndarray],
    subharmonic: int = 1,
    options: SearchOptions | None = None,
    *,
    prefer_stable: bool = True,
) -> OrbitSearch:
    """Search for an orbit of the flow from guesses, taken as they are needed.

    Parameters
    ----------
    guesses : iterable of (n, 2 n_modes)
        States at equal parts of the period, from phase zero on.
    any_other : bool
        Look on where the first orbit is unstable; the stable one comes first then.

    Returns
    -------
    OrbitSearch
    """
    met, tried, ended = list[PeriodicOrbit](), list[np.ndarray](), list[str]()
    search = partial(find_orbit, flow, omega, subharmonic=subharmonic, ended=ended)
    for states in guesses:
        tried.append(states)
        orbit = search(states[0])
        if orbit is not None and not any(is_same_orbit(orbit, other) for other in met):
            met.append(orbit)
        if orbit is not None and (
            not prefer_stable or flow.n_modes > MAX_MODES_FOR_MONODROMY or orbit.is_stable
        ):
            break
    if met:
        if prefer_stable and flow.n_modes <= MAX_MODES_FOR_MONODROMY:
            met.sort(key=lambda one: not one.is_stable)
        return OrbitSearch(met[0], tuple(met[1:]), "exact orbit by Newton's method")
    for states in tried:
        step = predict_orbit(flow, omega, states, subharmonic)
        orbit = None if step is None else search(step.states[0], inverse=step.inverse)
        if orbit is not None:
            return OrbitSearch(orbit, (), "exact orbit by a step of the whole motion")
    start = tried[-1][0] if tried else np.zeros(flow.size)
    options = options or SearchOptions()
    orbits = FlowOrbits(flow, omega, start, subharmonic)
    if (
        tried
        and flow.n_modes <= MAX_MODES_FOR_MONODROMY
        and (orbit := find_by_homotopy(orbits, options)) is not None
    ):
        return OrbitSearch(orbit, (), "exact orbit along a path from the motion")
    last = _find_by_recurrence(orbits, options)
    return last if last.orbit else last._replace(reason="; ".join([*ended[-1:], last.reason]))


def wave_states(flow: ContactFlow, displacement: np.ndarray, base_omega: float) -> np.ndarray:
    """States at equal parts of the period of a wave of the displacement, given by its coefficients
    (2H+1, n_dofs) [m]: (32, 2 n_modes)."""
    values = fourier_basis_over_period(len(displacement) // 2, SEGMENTS)
    rate = differentiate(displacement, base_omega)
    return flow.state(values @ displacement, values @ rate)


# --- along a path ---------------------------------------------------------------------------------


class _HomotopyPoint(DenseLinearisation):
    """The homotopy's equations at a point."""

    def __init__(self, at: OrbitPoint, parameter: float, start: np.ndarray) -> None:
        self._at, self._parameter, self.unknown = at, parameter, at.unknown
        self._moved = at.unknown + at.residual - start
        self.residual = parameter * self._moved - (at.unknown - start)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """p M - I."""
        monodromy = self._at.monodromy
        return self._parameter * monodromy - np.eye(len(monodromy))

    @property
    def by_parameter(self) -> np.ndarray:
        return self._moved


class Homotopy:
    """p (z(T) - a) - (z - a) = 0 in the unknowns x of some orbits, a their start.

    Attributes
    ----------
    left : int
        Pieces that motions may still have.
    """

    def __init__(self, orbits: FlowOrbits, pieces: int) -> None:
        self._orbits, self.shape, self.remaining_pieces = orbits, orbits.shape, pieces

    def linearise(self, unknown: np.ndarray, parameter: float) -> _HomotopyPoint:
        """The equations at a point; raises as :meth:`FlowOrbits.linearise`, and where no pieces
        are left."""
        if self.remaining_pieces <= 0:
            raise ConvergenceError("orbits: the homotopy takes too long")
        at = self._orbits.linearise(unknown, 1.0)
        self.remaining_pieces -= max(at.pieces, PIECES_PER_PERIOD)
        return _HomotopyPoint(at, parameter, self._orbits.start)


def find_by_homotopy(orbits: FlowOrbits, options: SearchOptions) -> PeriodicOrbit | None:
    """The orbit to which the path from the start of some leads; None where that takes too long."""
    begin("an orbit along a path from the motion")
    system = Homotopy(orbits, options.pieces(orbits.flow) // 2)
    steps = replace(HOMOTOPY_OPTIONS, max_steps=Budget.pieces)
    try:
        # M - I may be singular where the motion closes: next to a resonance without damping.
        closed = solve_in_plane(
            orbits, orbits.start, 1.0, None, tolerance=LOCATION_TOLERANCE, iterations=1
        )
        if closed is not None:
            return orbits.orbit(closed)
        end = Path(system, point_on_path(system, orbits.start, 0.0), steps, [Target(1.0)]).run()
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
    if end is None:
        return None
    state = orbits.state(end.unknown)
    return find_orbit(orbits.flow, orbits.omega, state, subharmonic=orbits.subharmonic)


# --- along the motion -----------------------------------------------------------------------------


def _find_by_recurrence(orbits: FlowOrbits, options: SearchOptions) -> OrbitSearch:
    """An orbit that the motion from the start settles to, or passes on its way."""
    flow, omega, subharmonic = orbits.flow, orbits.omega, orbits.subharmonic
    periods, left = options.periods(flow), options.pieces(flow) // 4
    begin(f"the exact motion over up to {periods} periods, and orbits that it passes")
    passed = np.array([orbits.start, *follow_periods(orbits, orbits.start, periods)])
    apart = np.linalg.norm(np.diff(passed, axis=0), axis=1)
    # From the last state, then from close returns, the closest first.
    for place in (-1, *np.argsort(apart, kind="stable").tolist()):
        if left <= 0:
            break
        orbit = find_orbit(flow, omega, orbits.state(passed[place]), subharmonic=subharmonic)
        if orbit is not None:
            return OrbitSearch(orbit, (), "exact orbit, by following the motion")
        left -= (
            MAX_SEARCH_PERIODS // 2 * max(PIECES_PER_PERIOD, orbits.pieces)
        )  # of a search that fails, about
    return OrbitSearch(None, (), describe_closest_return(passed, subharmonic))


def follow_periods(orbits: FlowOrbits, state: np.ndarray, periods: int) -> Iterator[np.ndarray]:
    """States x a period apart of the motion from a state, after the first period and later ones; as
    far as it can be followed, and in no more than 200 pieces for each of so many periods."""
    left = PIECES_PER_PERIOD * periods
    with suppress(ConvergenceError):  # pairs that chatter without end
        for _ in range(periods):
            if left <= 0:
                return
            state = orbits.advance_period(state, 1.0)
            left -= orbits.pieces
            yield state


def describe_closest_return(
    passed: np.ndarray, subharmonic: int, motion: str = "the exact motion"
) -> str:
    """Describe the closest return of a motion, of states so many periods of the load apart (n, 2
    n_modes)."""
    found = []
    for later in range(1, min(MAX_RETURN_PERIODS, len(passed) - 1) + 1):
        sizes = np.linalg.norm(passed[later:], axis=1)
        apart = np.linalg.norm(passed[later:] - passed[:-later], axis=1)
        found.append(float(np.min(apart / np.maximum(sizes, 1e-300))))
    if not found:
        return f"{motion} cannot be integrated over a period"
    nearest = int(np.argmin(found))
    most, after = (one * subharmonic for one in (len(passed) - 1, nearest + 1))
    best = f"{percent(found[nearest])} of where it was at best, after {counted(after, 'period')}"
    said = f"followed for {counted(most, 'period')} of the load, {motion} comes back"
    return f"{said} to within {best}"
