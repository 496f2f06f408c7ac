"""Search for a periodic orbit of the exact flow: guesses, Newton's method, and one budget.

From the motion of nearly every harmonic-balance solution with few harmonics, Newton's method
(:mod:`orbit`) leads to an orbit. If it fails from all guesses, three more starts follow:

1. The state after one Newton step of the whole motion
   (:func:`fenics_crack.motion.orbit.predict_orbit`).
2. The end of a path (homotopy) through folds, with the guess a:

       p (z(T) - a) - (z - a) = 0,    from z = a at p = 0 to an orbit at p = 1.

   At p = 0 there is no other solution. For p <= 1 damping keeps solutions near a.
3. Close returns of the motion from the guess (recurrence search). A motion without an attracting
   orbit is irregular, and passes near orbits that it leaves again.

References
----------
Chow, Mallet-Paret and Yorke, Mathematics of Computation 32 (1978) 887-899.
Auerbach et al., Physical Review Letters 58 (1987) 2387-2389.
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
from fenics_crack.numerics.equations import MAX_LOCATION_RESIDUAL, DenseLinearisation
from fenics_crack.numerics.fourier import differentiate, fourier_basis_over_period
from fenics_crack.numerics.newton import point_on_path, solve_in_plane
from fenics_crack.numerics.path import HOMOTOPY_OPTIONS, Path, Target

SEGMENTS = 32
"""Multiple-shooting segments per period."""
PIECES_PER_PERIOD = 200
"""Taylor pieces that a search's budget counts for one period. A period with fewer pieces counts as
one."""
MAX_RETURN_PERIODS = 8
"""Maximum number of periods after which a motion may return."""


@dataclass(frozen=True)
class SearchOptions:
    """Options for an orbit search. The defaults suit up to 120 modes.

    Attributes
    ----------
    harmonics : tuple of int
        Numbers of harmonics in the harmonic-balance solutions for guesses.
    evaluations : int
        Budget in periods of the flow after Newton's method failed from all guesses. Half of them
        are for the path, a quarter for the motion, and the rest for orbits near its close returns.
        A period has 200 Taylor pieces and 12 modes; other sizes count by their time, proportional
        to pieces and to the square of the modes. The default takes about a second. With friction
        three quarters are allowed, and take one to three seconds.
    """

    harmonics: tuple[int, ...] = (5, 10, 20, 40)
    evaluations: int = 4000

    def piece_budget(self, flow: ContactFlow) -> int:
        """Return the budget in Taylor pieces."""
        n_periods = (0.75 if flow.friction else 1.0) * self.evaluations
        return int(PIECES_PER_PERIOD * n_periods * min(1.0, (24.0 / flow.size) ** 2))

    def period_budget(self, flow: ContactFlow) -> int:
        """Return the maximum number of periods to integrate a motion."""
        return max(self.piece_budget(flow) // (4 * PIECES_PER_PERIOD), 60)


class OrbitSearch(NamedTuple):
    """Result of an orbit search.

    Attributes
    ----------
    orbit : PeriodicOrbit or None
        A stable orbit if the search met one, else the first orbit.
    other_orbits : tuple of PeriodicOrbit
        Further orbits.
    reason : str
        How the orbit was found, or why the attempts failed and how the motion behaves.
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
    """Search for an orbit of the flow from guesses, taken as needed.

    Parameters
    ----------
    guesses : iterable of (n, flow.size)
        States at equal parts of the period, from phase zero on.
    prefer_stable : bool
        Continue after an unstable orbit. A stable orbit then comes first.

    Returns
    -------
    OrbitSearch
    """
    known_orbits, tried_states = list[PeriodicOrbit](), list[np.ndarray]()
    failure_reasons: list[str] = []
    search = partial(
        find_orbit, flow, omega, subharmonic=subharmonic, failure_reasons=failure_reasons
    )
    forms_monodromy = flow.n_modes <= MAX_MODES_FOR_MONODROMY
    for states in guesses:
        tried_states.append(states)
        orbit = search(states[0])
        if orbit is None:
            continue
        if not any(is_same_orbit(orbit, known_orbit) for known_orbit in known_orbits):
            known_orbits.append(orbit)
        if not (prefer_stable and forms_monodromy) or orbit.is_stable:
            break
    if known_orbits:
        if prefer_stable and forms_monodromy:
            known_orbits.sort(key=lambda orbit: not orbit.is_stable)
        return OrbitSearch(
            known_orbits[0], tuple(known_orbits[1:]), "exact orbit by Newton's method"
        )
    for states in tried_states:
        prediction = predict_orbit(flow, omega, states, subharmonic)
        orbit = (
            None if prediction is None else search(prediction.states[0], inverse=prediction.inverse)
        )
        if orbit is not None:
            return OrbitSearch(orbit, (), "exact orbit by a step of the whole motion")
    start = tried_states[-1][0] if tried_states else np.zeros(flow.size)
    options = options or SearchOptions()
    orbits = FlowOrbits(flow, omega, start, subharmonic)
    orbit = find_by_homotopy(orbits, options) if tried_states and forms_monodromy else None
    if orbit is not None:
        return OrbitSearch(orbit, (), "exact orbit along a path from the motion")
    recurrence = _find_by_recurrence(orbits, options)
    if recurrence.orbit:
        return recurrence
    return recurrence._replace(reason="; ".join([*failure_reasons[-1:], recurrence.reason]))


def wave_states(flow: ContactFlow, displacement: np.ndarray, base_omega: float) -> np.ndarray:
    """Return a wave's states at equal parts of the period: (SEGMENTS, flow.size).

    Parameters
    ----------
    displacement : (2H+1, n_dofs) [m]
        Fourier coefficients of the wave.
    base_omega : float
        Frequency of the wave [rad/s].
    """
    basis = fourier_basis_over_period(len(displacement) // 2, SEGMENTS)
    velocity = differentiate(displacement, base_omega)
    return flow.state(basis @ displacement, basis @ velocity)


# --- along a path ---------------------------------------------------------------------------------


class _HomotopyPoint(DenseLinearisation):
    """Homotopy equations at a point."""

    def __init__(self, orbit_point: OrbitPoint, parameter: float, start: np.ndarray) -> None:
        self._orbit_point, self._parameter, self.unknown = (
            orbit_point,
            parameter,
            orbit_point.unknown,
        )
        self._end_offset = orbit_point.unknown + orbit_point.residual - start
        self.residual = parameter * self._end_offset - (orbit_point.unknown - start)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Return p M - I."""
        monodromy = self._orbit_point.monodromy
        return self._parameter * monodromy - np.eye(len(monodromy))

    @property
    def by_parameter(self) -> np.ndarray:
        return self._end_offset


class Homotopy:
    """Homotopy p (z(T) - a) - (z - a) = 0 from a guess a.

    The unknowns are those of ``orbits``, and a is ``orbits.start``.

    Attributes
    ----------
    remaining_pieces : int
        Taylor pieces left in the budget.
    """

    def __init__(self, orbits: FlowOrbits, pieces: int) -> None:
        self._orbits, self.shape, self.remaining_pieces = orbits, orbits.shape, pieces

    def linearise(self, unknown: np.ndarray, parameter: float) -> _HomotopyPoint:
        """Return the equations at a point.

        Raises
        ------
        ConvergenceError
            No pieces are left, or the motion cannot be integrated.
        """
        if self.remaining_pieces <= 0:
            raise ConvergenceError("orbits: the homotopy takes too long")
        orbit_point = self._orbits.linearise(unknown, 1.0)
        self.remaining_pieces -= max(orbit_point.pieces, PIECES_PER_PERIOD)
        return _HomotopyPoint(orbit_point, parameter, self._orbits.start)


def find_by_homotopy(orbits: FlowOrbits, options: SearchOptions) -> PeriodicOrbit | None:
    """Return the orbit at the end of the path from the guess; None without success."""
    begin("an orbit along a path from the motion")
    system = Homotopy(orbits, options.piece_budget(orbits.flow) // 2)
    path_options = replace(HOMOTOPY_OPTIONS, max_steps=Budget.pieces)
    try:
        # The guess may be an orbit with a singular M - I, next to a resonance without damping.
        closed_point = solve_in_plane(
            orbits, orbits.start, 1.0, None, tolerance=MAX_LOCATION_RESIDUAL, iterations=1
        )
        if closed_point is not None:
            return orbits.orbit(closed_point)
        end_point = Path(
            system, point_on_path(system, orbits.start, 0.0), path_options, [Target(1.0)]
        ).run()
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
    if end_point is None:
        return None
    state = orbits.state(end_point.unknown)
    return find_orbit(orbits.flow, orbits.omega, state, subharmonic=orbits.subharmonic)


# --- along the motion -----------------------------------------------------------------------------


def _find_by_recurrence(orbits: FlowOrbits, options: SearchOptions) -> OrbitSearch:
    """Find an orbit along the motion from a start.

    The motion may settle to the orbit, or pass near it.
    """
    flow, omega, subharmonic = orbits.flow, orbits.omega, orbits.subharmonic
    max_periods, remaining_pieces = options.period_budget(flow), options.piece_budget(flow) // 4
    begin(f"the exact motion over up to {max_periods} periods, and orbits that it passes")
    states = np.array([orbits.start, *follow_periods(orbits, orbits.start, max_periods)])
    return_distances = np.linalg.norm(np.diff(states, axis=0), axis=1)
    # Start from the last state, then from the close returns, the closest first.
    for index in (-1, *np.argsort(return_distances, kind="stable").tolist()):
        if remaining_pieces <= 0:
            break
        orbit = find_orbit(flow, omega, orbits.state(states[index]), subharmonic=subharmonic)
        if orbit is not None:
            return OrbitSearch(orbit, (), "exact orbit, by following the motion")
        # A failed search takes about half of its maximum.
        remaining_pieces -= MAX_SEARCH_PERIODS // 2 * max(PIECES_PER_PERIOD, orbits.pieces)
    return OrbitSearch(None, (), describe_closest_return(states, subharmonic))


def follow_periods(orbits: FlowOrbits, state: np.ndarray, periods: int) -> Iterator[np.ndarray]:
    """Yield the state x of a motion after each period.

    The motion ends after ``periods`` periods, at a failure, or at 200 Taylor pieces times
    ``periods``.
    """
    remaining_pieces = PIECES_PER_PERIOD * periods
    with suppress(ConvergenceError):  # pairs may chatter without end
        for _ in range(periods):
            if remaining_pieces <= 0:
                return
            state = orbits.advance_period(state, 1.0)
            remaining_pieces -= orbits.pieces
            yield state


def describe_closest_return(
    states: np.ndarray, subharmonic: int, motion: str = "the exact motion"
) -> str:
    """Describe the closest return of a motion.

    Parameters
    ----------
    states : (n, flow.size)
        States one period apart.
    subharmonic : int
        Load periods between two states.
    motion : str
        Subject of the sentence.
    """
    relative_distances = []
    for lag in range(1, min(MAX_RETURN_PERIODS, len(states) - 1) + 1):
        sizes = np.linalg.norm(states[lag:], axis=1)
        distances = np.linalg.norm(states[lag:] - states[:-lag], axis=1)
        relative_distances.append(float(np.min(distances / np.maximum(sizes, 1e-300))))
    if not relative_distances:
        return f"{motion} cannot be integrated over a period"
    closest_index = int(np.argmin(relative_distances))
    followed_periods = counted((len(states) - 1) * subharmonic, "period")
    return_periods = counted((closest_index + 1) * subharmonic, "period")
    closeness = percent(relative_distances[closest_index])
    return (
        f"followed for {followed_periods} of the load, {motion} comes back to within"
        f" {closeness} of where it was at best, after {return_periods}"
    )
