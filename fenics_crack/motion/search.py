"""Search for a periodic orbit: a ladder of starts, and a budget.

The search climbs :data:`ORBIT_STARTS_BY_NAME` until a :class:`StartStrategy` leads to an orbit:

1. Newton's method (:mod:`orbit`) from guesses, the motions of harmonic-balance solutions with few
   harmonics. Nearly all guesses lead to an orbit.
2. The state after one Newton step of the whole motion
   (:func:`fenics_crack.motion.orbit.predict_orbit`).
3. The end of a path (homotopy) through folds, with the guess a:

       p (z(T) - a) - (z - a) = 0,    from z = a at p = 0 to an orbit at p = 1.

   At p = 0 there is no other solution. For p <= 1 damping keeps solutions near a.
4. Close returns of the motion from the guess (recurrence search). A motion without an attracting
   orbit is irregular, and passes near orbits that it leaves again.

References
----------
Chow, Mallet-Paret and Yorke, Mathematics of Computation 32 (1978) 887-899.
Auerbach et al., Physical Review Letters 58 (1987) 2387-2389.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.tables import format_count, format_percent
from fenics_crack.motion.flow import Budget, ContactFlow
from fenics_crack.motion.orbit import (
    INSTANTS_PER_PERIOD,
    MAX_MODES_FOR_MONODROMY,
    MAX_SEARCH_PERIODS,
    IMinusMSolver,
    PeriodicOrbit,
    find_orbit,
    is_same_orbit_in_phase,
    predict_orbit,
)
from fenics_crack.motion.shooting import FlowOrbitEquations, OrbitPoint
from fenics_crack.numerics.equations import MAX_LOCATION_RESIDUAL, DenseLinearisation
from fenics_crack.numerics.fourier import differentiate, fourier_basis_over_period
from fenics_crack.numerics.newton import point_on_path, solve_in_plane
from fenics_crack.numerics.path import HOMOTOPY_OPTIONS, Path, Target

SEGMENTS_PER_PERIOD = 32
"""Multiple-shooting segments per period."""
SEGMENT_START_SLICE = slice(None, None, INSTANTS_PER_PERIOD // SEGMENTS_PER_PERIOD)
"""Samples of an orbit at which its segments begin."""
MIN_PIECES_CHARGED_PER_PERIOD = 200
"""Taylor pieces that a search's budget counts for one period. A period with fewer pieces counts as
one."""
MAX_RETURN_PERIODS = 8
"""Maximum number of periods after which a motion may return."""


class SearchOptions:
    """Guesses and budget of an orbit search, for up to 120 modes.

    Attributes
    ----------
    guess_harmonic_counts : tuple of int
        Numbers of harmonics in the harmonic-balance solutions for guesses.
    period_budget : int
        Budget in periods of the flow after Newton's method failed from all guesses. Half of them
        are for the path, a quarter for the motion, and the rest for orbits near close returns. A
        period has 200 Taylor pieces and 12 modes; other sizes count by time, proportional to pieces
        and to the square of the modes. The budget lasts about a second. With friction three
        quarters are allowed, for one to three seconds.
    """

    guess_harmonic_counts: tuple[int, ...] = (5, 10, 20, 40)
    period_budget: int = 4000

    @classmethod
    def piece_budget(cls, flow: ContactFlow) -> int:
        """Return the search's budget on a flow, in pieces with a Taylor series."""
        n_periods = (0.75 if flow.friction_law else 1.0) * cls.period_budget
        return int(
            MIN_PIECES_CHARGED_PER_PERIOD * n_periods * min(1.0, (24.0 / flow.state_size) ** 2)
        )

    @classmethod
    def max_periods(cls, flow: ContactFlow) -> int:
        """Return the maximum number of periods for integrating a motion."""
        return max(cls.piece_budget(flow) // (4 * MIN_PIECES_CHARGED_PER_PERIOD), 60)


class StartStrategy(NamedTuple):
    """Start for a search, by a name that the progress line prints.

    Attributes
    ----------
    name : str
    generate_candidates : callable
        Returns guesses, or orbits, made on demand.
    """

    name: str
    generate_candidates: Callable[..., Iterable[Any]]


class OrbitSearchResult(NamedTuple):
    """Result of an orbit search.

    Attributes
    ----------
    orbit : PeriodicOrbit or None
        A stable orbit if the search met one, else the first orbit.
    other_orbits : tuple of PeriodicOrbit
        Further orbits.
    outcome_text : str
        How the orbit was found, or why the attempts failed and how the motion behaves.
    """

    orbit: PeriodicOrbit | None
    other_orbits: tuple[PeriodicOrbit, ...]
    outcome_text: str


def search_orbit(
    flow: ContactFlow,
    omega: float,
    state_guesses: Iterable[np.ndarray],
    subharmonic: int = 1,
    *,
    prefer_stable: bool = True,
    start_strategies: Iterable[StartStrategy] = (),
) -> OrbitSearchResult:
    """Search for an orbit of the flow from guesses, taken as needed.

    Parameters
    ----------
    state_guesses : iterable of (n, flow.state_size)
        States at equal parts of the period, from phase zero on.
    prefer_stable : bool
        Continue after an unstable orbit. A stable orbit then comes first.
    start_strategies : iterable of StartStrategy
        Some of :data:`ORBIT_STARTS_BY_NAME`; default: all.

    Returns
    -------
    OrbitSearchResult
    """
    prefer_stable = prefer_stable and flow.n_modes <= MAX_MODES_FOR_MONODROMY
    task = _SearchTask(flow, omega, state_guesses, subharmonic, prefer_stable)
    for start_strategy in start_strategies or ORBIT_STARTS_BY_NAME.values():
        begin_stage(start_strategy.name)
        if orbits_from_start := [*start_strategy.generate_candidates(task)]:
            return OrbitSearchResult(
                orbits_from_start[0], tuple(orbits_from_start[1:]), start_strategy.name
            )
    return OrbitSearchResult(None, (), "; ".join(task.failure_reasons[-2:]))


@dataclass(frozen=True)
class _SearchTask:
    """Arguments and notes for the starts of an orbit search.

    Attributes
    ----------
    tried_states : list of (n, flow.state_size)
        Guesses that led to no orbit.
    failure_reasons : list of str
        Why starts failed.
    """

    flow: ContactFlow
    omega: float
    state_guesses: Iterable[np.ndarray]
    subharmonic: int
    prefer_stable: bool
    tried_states: list[np.ndarray] = field(default_factory=list)
    failure_reasons: list[str] = field(default_factory=list)

    def find_orbit(
        self, state: np.ndarray, solve_i_minus_m: IMinusMSolver | None = None
    ) -> PeriodicOrbit | None:
        """Search for an orbit by Newton's method."""
        return find_orbit(
            self.flow, self.omega, state, subharmonic=self.subharmonic,
            solve_i_minus_m=solve_i_minus_m, failure_reasons=self.failure_reasons,
        )  # fmt: skip

    @property
    def orbit_equations(self) -> FlowOrbitEquations:
        """Return orbit equations next to the last guess, or to rest."""
        start_state = (
            self.tried_states[-1][0] if self.tried_states else np.zeros(self.flow.state_size)
        )
        return FlowOrbitEquations(self.flow, self.omega, start_state, self.subharmonic)


def _find_from_guesses(task: _SearchTask) -> list[PeriodicOrbit]:
    """Find orbits up to the first, or up to the first stable orbit, and sort by stability."""
    found_orbits = list[PeriodicOrbit]()
    for guessed_states in task.state_guesses:
        task.tried_states.append(guessed_states)
        orbit = task.find_orbit(guessed_states[0])
        if orbit is None:
            continue
        if not any(is_same_orbit_in_phase(orbit, known_orbit) for known_orbit in found_orbits):
            found_orbits.append(orbit)
        if not task.prefer_stable or orbit.is_stable:
            break
    return sorted(found_orbits, key=lambda orbit: task.prefer_stable and not orbit.is_stable)


def _find_after_multiple_shooting_step(task: _SearchTask) -> Iterable[PeriodicOrbit]:
    """Find the first orbit after a Newton step for a whole guess."""
    prediction_iterator = (
        predict_orbit(task.flow, task.omega, guessed_states, task.subharmonic)
        for guessed_states in task.tried_states
    )
    orbit_or_none_iterator = (
        task.find_orbit(prediction.states[0], prediction.solve_i_minus_m)
        for prediction in prediction_iterator
        if prediction is not None
    )
    return islice(filter(None, orbit_or_none_iterator), 1)


def series_states_at_period_parts(
    flow: ContactFlow, displacement_coefficients: np.ndarray, base_omega: float
) -> np.ndarray:
    """Return a Fourier series' states at equal parts of the period: (32, flow.state_size).

    Parameters
    ----------
    displacement_coefficients : (2H+1, n_dofs) [m]
        Rows a0, a1, b1, ....
    base_omega : float
        Frequency of the first harmonic [rad/s].
    """
    fourier_basis = fourier_basis_over_period(
        len(displacement_coefficients) // 2, SEGMENTS_PER_PERIOD
    )
    velocity_coefficients = differentiate(displacement_coefficients, base_omega)
    return flow.state(
        fourier_basis @ displacement_coefficients, fourier_basis @ velocity_coefficients
    )


# --- along a path ---------------------------------------------------------------------------------


class _HomotopyPoint(DenseLinearisation):
    """Residual and Jacobian of :class:`Homotopy` at a point (x, p)."""

    def __init__(
        self, orbit_point: OrbitPoint, parameter: float, start_unknown: np.ndarray
    ) -> None:
        self._orbit_point, self._parameter, self.unknown = (
            orbit_point,
            parameter,
            orbit_point.unknown,
        )
        self._end_state_minus_guess = orbit_point.unknown + orbit_point.residual - start_unknown
        self.residual = parameter * self._end_state_minus_guess - (
            orbit_point.unknown - start_unknown
        )

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Return p M - I, with the monodromy matrix M in the unknowns x: (n, n)."""
        monodromy = self._orbit_point.monodromy
        return self._parameter * monodromy - np.eye(len(monodromy))

    @property
    def by_parameter(self) -> np.ndarray:
        return self._end_state_minus_guess


class Homotopy:
    """Equations of a path from a guess a to an orbit.

        p (z(T) - a) - (z - a) = 0

    Unknowns are the state z at phase zero; z(T) is the state after a period. At p = 0 the solution
    is a, at p = 1 an orbit. States are scaled like the unknowns x of
    ``orbit_equations``; a is its ``start_unknown``.

    Attributes
    ----------
    remaining_pieces : int
        Taylor pieces left in the budget.
    """

    def __init__(self, orbit_equations: FlowOrbitEquations, taylor_piece_budget: int) -> None:
        self._orbit_equations, self.shape = orbit_equations, orbit_equations.shape
        self.remaining_pieces = taylor_piece_budget

    def linearise(self, unknown: np.ndarray, parameter: float) -> _HomotopyPoint:
        """Return the equations at a scaled state and a parameter p.

        Raises
        ------
        ConvergenceError
            No pieces are left, or the motion cannot be integrated.
        """
        if self.remaining_pieces <= 0:
            raise ConvergenceError("orbits: the homotopy takes too long")
        orbit_point = self._orbit_equations.linearise(unknown, 1.0)
        self.remaining_pieces -= max(orbit_point.n_taylor_pieces, MIN_PIECES_CHARGED_PER_PERIOD)
        return _HomotopyPoint(orbit_point, parameter, self._orbit_equations.start_unknown)


def _find_along_path(task: _SearchTask) -> Iterator[PeriodicOrbit]:
    """Find the orbit to which a path leads from the last guess."""
    if not task.tried_states or task.flow.n_modes > MAX_MODES_FOR_MONODROMY:
        return
    orbit_equations = task.orbit_equations
    homotopy = Homotopy(orbit_equations, SearchOptions.piece_budget(task.flow) // 2)
    path_options = replace(HOMOTOPY_OPTIONS, max_steps=Budget.allowed_pieces)
    with suppress(ConvergenceError, np.linalg.LinAlgError):
        # The guess may be an orbit with a singular M - I, next to a resonance without damping.
        solution_point = solve_in_plane(
            orbit_equations,
            orbit_equations.start_unknown,
            1.0,
            None,
            tolerance=MAX_LOCATION_RESIDUAL,
            max_iterations=1,
        )
        if solution_point is not None:
            yield orbit_equations.orbit(solution_point)
            return
        start_point = point_on_path(homotopy, orbit_equations.start_unknown, 0.0)
        end_point = Path(
            homotopy, start_point, path_options, [Target(1.0)]
        ).find_terminal_point_or_none()
        if end_point is not None:
            yield from filter(None, [task.find_orbit(orbit_equations.state(end_point.unknown))])


# --- along the motion -----------------------------------------------------------------------------


def _find_along_motion(task: _SearchTask) -> Iterator[PeriodicOrbit]:
    """Find an orbit to which the motion settles, or which the motion passes."""
    orbit_equations = task.orbit_equations
    remaining_pieces = SearchOptions.piece_budget(task.flow) // 4
    state_iterator = yield_states_after_periods(
        orbit_equations, orbit_equations.start_unknown, SearchOptions.max_periods(task.flow)
    )
    states_at_periods = np.array([orbit_equations.start_unknown, *state_iterator])
    task.failure_reasons.append(describe_closest_return(states_at_periods, task.subharmonic))
    distances_after_period = np.linalg.norm(np.diff(states_at_periods, axis=0), axis=1)
    # Start from the last state, then from the close returns, the closest first.
    for state_index in (-1, *np.argsort(distances_after_period, kind="stable").tolist()):
        if remaining_pieces <= 0:
            return
        start_state = orbit_equations.state(states_at_periods[state_index])
        orbit = find_orbit(task.flow, task.omega, start_state, subharmonic=task.subharmonic)
        if orbit is not None:
            yield orbit
            return
        # A failed search takes about half of its maximum.
        remaining_pieces -= (
            MAX_SEARCH_PERIODS
            // 2
            * max(MIN_PIECES_CHARGED_PER_PERIOD, orbit_equations.n_taylor_pieces_in_last_period)
        )


ORBIT_STARTS_BY_NAME = {
    "guesses": StartStrategy("exact orbit by Newton's method", _find_from_guesses),
    "steps": StartStrategy("exact orbit by multiple shooting", _find_after_multiple_shooting_step),
    "path": StartStrategy("exact orbit by a homotopy from the motion", _find_along_path),
    "motion": StartStrategy("exact orbit by following the motion", _find_along_motion),
}
"""Starts for an orbit search, by name, in order."""


def yield_states_after_periods(
    orbit_equations: FlowOrbitEquations, state: np.ndarray, max_periods: int
) -> Iterator[np.ndarray]:
    """Yield a motion's state, in scaled unknowns x, after each period.

    The motion ends after ``max_periods`` periods, at a failure, or at 200 Taylor pieces times
    ``max_periods``.
    """
    remaining_pieces = MIN_PIECES_CHARGED_PER_PERIOD * max_periods
    with suppress(ConvergenceError):  # pairs may chatter without end
        for _ in range(max_periods):
            if remaining_pieces <= 0:
                return
            state = orbit_equations.unknown_after_period(state, 1.0)
            remaining_pieces -= orbit_equations.n_taylor_pieces_in_last_period
            yield state


def describe_closest_return(
    states_at_periods: np.ndarray, subharmonic: int, motion_name: str = "the exact motion"
) -> str:
    """Return words on a motion's closest return to an earlier state.

    Parameters
    ----------
    states_at_periods : (n, flow.state_size)
        States one period apart.
    subharmonic : int
        Load periods between two states.
    motion_name : str
        Subject of the sentence.
    """
    closest_relative_distances = []
    for lag in range(1, min(MAX_RETURN_PERIODS, len(states_at_periods) - 1) + 1):
        state_sizes = np.linalg.norm(states_at_periods[lag:], axis=1)
        distances = np.linalg.norm(states_at_periods[lag:] - states_at_periods[:-lag], axis=1)
        closest_relative_distances.append(
            float(np.min(distances / np.maximum(state_sizes, 1e-300)))
        )
    if not closest_relative_distances:
        return f"{motion_name} cannot be integrated over a period"
    closest_index = int(np.argmin(closest_relative_distances))
    followed_periods_text = format_count((len(states_at_periods) - 1) * subharmonic, "period")
    return_periods_text = format_count((closest_index + 1) * subharmonic, "period")
    closeness_text = format_percent(closest_relative_distances[closest_index])
    return (
        f"followed for {followed_periods_text} of the load, {motion_name} comes back to within"
        f" {closeness_text} of an earlier state at best, after {return_periods_text}"
    )
