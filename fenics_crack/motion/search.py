"""Search for a periodic orbit: a ladder of starts, and a budget.

The search climbs :data:`ORBIT_START_STRATEGY_BY_NAME` until a :class:`StartStrategy` leads to an
orbit:

1. Newton's method (:mod:`orbit`) from guesses, the motions of harmonic-balance solutions with few
   harmonics. Nearly all guesses lead to an orbit.
2. Newton's method from the state after one Newton step for 32 instants together
   (:func:`fenics_crack.motion.orbit.predict_orbit_by_newton_step`).
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
from fenics_crack.motion.flow import FEWER_EVENTS_ADVICE, Budget, ContactFlow
from fenics_crack.motion.orbit import (
    INSTANTS_PER_PERIOD,
    MAX_MODES_FOR_MONODROMY,
    MAX_PERIODS_IN_NEWTON_SEARCH,
    IMinusMSolver,
    PeriodicOrbit,
    find_orbit,
    is_same_orbit_in_phase,
    predict_orbit_by_newton_step,
)
from fenics_crack.motion.shooting import FlowOrbitEquations, OrbitPoint
from fenics_crack.numerics.equations import SPECIAL_POINT_TOLERANCE, DenseLinearisation
from fenics_crack.numerics.fourier import differentiate, fourier_basis_over_period
from fenics_crack.numerics.newton import point_on_path, solve_in_plane
from fenics_crack.numerics.path import HOMOTOPY_OPTIONS, Path, Target

SEGMENTS_PER_PERIOD = 32
"""Number of equal parts of the period in multiple shooting."""
SLICE_OF_SAMPLES_AT_SEGMENT_STARTS = slice(None, None, INSTANTS_PER_PERIOD // SEGMENTS_PER_PERIOD)
"""Every 16th sample among an orbit's 512: the starts of 32 equal parts of the period."""
MIN_PIECES_CHARGED_PER_PERIOD = 200
"""Minimum number of Taylor pieces that a search's budget counts for a period."""
MAX_RETURN_PERIODS = 8
"""A motion's state is compared with the states up to this number of periods before."""


class SearchOptions:
    """Guesses and budget for an orbit search in a structure with up to 120 modes.

    Attributes
    ----------
    guess_harmonic_counts : tuple of int
        Numbers of harmonics in the harmonic-balance solutions for guesses.
    period_budget : int
        Work allowed after Newton's method has failed from all guesses. The unit is a period with up
        to 12 modes and up to 200 Taylor pieces (intervals with a single Taylor series). More pieces
        count in proportion, more modes by the square of their number. Half of the work is for the
        homotopy path. A quarter is for integrating the motion from the last guess. The last quarter
        is for Newton's method, started from the motion's last state, then from the states that
        change least in a period (close returns). All this work takes about a second. With friction
        only three quarters of ``period_budget`` are allowed, and take one to three seconds.
    """

    guess_harmonic_counts: tuple[int, ...] = (5, 10, 20, 40)
    period_budget: int = 4000

    @classmethod
    def piece_budget(cls, flow: ContactFlow) -> int:
        """Return the number of Taylor pieces that an orbit search may compute.

        A piece is an interval with a single Taylor series. For a state with up to 24 entries (12
        modes without friction) the number is 800,000, with friction 600,000. For n > 24 entries it
        is multiplied by (24 / n)^2.
        """
        n_periods = (0.75 if flow.friction_law else 1.0) * cls.period_budget
        return int(
            MIN_PIECES_CHARGED_PER_PERIOD * n_periods * min(1.0, (24.0 / flow.state_size) ** 2)
        )

    @classmethod
    def max_periods(cls, flow: ContactFlow) -> int:
        """Return the maximum number of periods for integrating a motion, at least 60.

        The periods take a quarter of the search's budget.
        """
        return max(cls.piece_budget(flow) // (4 * MIN_PIECES_CHARGED_PER_PERIOD), 60)


class StartStrategy(NamedTuple):
    """A way to find starting points for a search.

    Attributes
    ----------
    name : str
        Text for the progress line.
    generate_candidates : callable
        In an orbit search: function from a :class:`_SearchTask` to the orbits that it finds. In
        harmonic balance: function without arguments to yield guesses for Newton's method.
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
        Further orbits that the successful start found.
    outcome_text : str
        Name of the start that led to the orbit; without orbit, why the last two attempts failed.
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
    """Search for an orbit of the flow from guesses, made on demand.

    Parameters
    ----------
    flow : ContactFlow
    omega : float
        Load frequency [rad/s].
    state_guesses : iterable of (n, flow.state_size)
        Guesses, each with states at n equal parts of the period, from phase zero on.
    subharmonic : int
        Number of load periods in the orbit's period.
    prefer_stable : bool
        Continue after an unstable orbit. A stable orbit then comes first. No effect with more than
        120 modes.
    start_strategies : iterable of StartStrategy
        Starts to try in order, from :data:`ORBIT_START_STRATEGY_BY_NAME`. Default: all.

    Returns
    -------
    OrbitSearchResult
        Without an orbit if all starts fail.
    """
    prefer_stable = prefer_stable and flow.n_modes <= MAX_MODES_FOR_MONODROMY
    orbit_search_task = _SearchTask(flow, omega, state_guesses, subharmonic, prefer_stable)
    for start_strategy in start_strategies or ORBIT_START_STRATEGY_BY_NAME.values():
        begin_stage(start_strategy.name)
        if orbits_from_strategy := [*start_strategy.generate_candidates(orbit_search_task)]:
            return OrbitSearchResult(
                orbits_from_strategy[0], tuple(orbits_from_strategy[1:]), start_strategy.name
            )
    return OrbitSearchResult(None, (), "; ".join(orbit_search_task.failure_reasons[-2:]))


@dataclass(frozen=True)
class _SearchTask:
    """Arguments of :func:`search_orbit`, with the record of failed starts.

    Attributes
    ----------
    flow : ContactFlow
    omega : float
        Load frequency [rad/s].
    state_guesses : iterable of (n, flow.state_size)
        Guesses, each with states at n equal parts of the period.
    subharmonic : int
        Number of load periods in the orbit's period.
    prefer_stable : bool
        True: continue after an unstable orbit.
    tried_states : list of (n, flow.state_size)
        Guesses tried so far. If no orbit was found, further starts use the same guesses.
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
        """Search for an orbit by Newton's method from a state (flow.state_size,) at phase zero.

        The result is None if the search fails. For the first steps ``solve_i_minus_m`` may return
        (I - M)^-1 b, with the monodromy matrix M of a nearby motion. None: M is computed.
        """
        return find_orbit(
            self.flow, self.omega, state, subharmonic=self.subharmonic,
            solve_i_minus_m=solve_i_minus_m, failure_reasons=self.failure_reasons,
        )  # fmt: skip

    @property
    def orbit_equations(self) -> FlowOrbitEquations:
        """Return the equations z(T) = z(0) of an orbit: the state z returns after the period T.

        The start is the last tried guess's state at phase zero. Without guesses the start is the
        zero state.
        """
        start_state = (
            self.tried_states[-1][0] if self.tried_states else np.zeros(self.flow.state_size)
        )
        return FlowOrbitEquations(self.flow, self.omega, start_state, self.subharmonic)


def _find_orbits_from_guesses(search_task: _SearchTask) -> list[PeriodicOrbit]:
    """Find orbits by Newton's method from the guesses, up to the first stable orbit.

    If ``search_task.prefer_stable`` is False, the search ends at the first orbit. In the result, a
    stable orbit comes first. All tried guesses are added to ``search_task.tried_states``.
    """
    found_orbits = list[PeriodicOrbit]()
    for guessed_states in search_task.state_guesses:
        search_task.tried_states.append(guessed_states)
        orbit = search_task.find_orbit(guessed_states[0])
        if orbit is None:
            continue
        if not any(is_same_orbit_in_phase(orbit, known_orbit) for known_orbit in found_orbits):
            found_orbits.append(orbit)
        if not search_task.prefer_stable or orbit.is_stable:
            break
    return sorted(found_orbits, key=lambda orbit: search_task.prefer_stable and not orbit.is_stable)


def _find_orbit_after_multiple_shooting_step(search_task: _SearchTask) -> Iterable[PeriodicOrbit]:
    """Find an orbit by Newton's method after a multiple-shooting step.

    The step corrects the states at 32 instants of a guess together. Guesses that led to no orbit
    before are tried in order. The result has the first orbit, or is empty.
    """
    prediction_iterator = (
        predict_orbit_by_newton_step(
            search_task.flow, search_task.omega, guessed_states, search_task.subharmonic
        )
        for guessed_states in search_task.tried_states
    )
    orbit_or_none_iterator = (
        search_task.find_orbit(prediction.states[0], prediction.solve_i_minus_m)
        for prediction in prediction_iterator
        if prediction is not None
    )
    return islice(filter(None, orbit_or_none_iterator), 1)


def series_states_at_period_parts(
    flow: ContactFlow, displacement_coefficients: np.ndarray, base_omega: float
) -> np.ndarray:
    """Return a Fourier series' states at 32 instants of the period: (32, flow.state_size).

    Parameters
    ----------
    flow : ContactFlow
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
    """Residual and Jacobian of :class:`GuessToOrbitHomotopy` at unknowns x and a parameter p.

    ``start_unknown`` is the guess, in the unknowns x.
    """

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
        """Return the derivative of the residual by the unknowns: p M - I, (n, n).

        p is the parameter, and M the monodromy matrix in the unknowns.
        """
        monodromy = self._orbit_point.monodromy
        return self._parameter * monodromy - np.eye(len(monodromy))

    @property
    def by_parameter(self) -> np.ndarray:
        """Return the derivative of the residual by the parameter p: z(T) - a, (n,).

        z(T) is the state after a period, and a the guess, both in the unknowns.
        """
        return self._end_state_minus_guess


class GuessToOrbitHomotopy:
    """Equations of a path from a guess a to an orbit.

        p (z(T) - a) - (z - a) = 0

    The unknowns are the state z at phase zero, scaled as in ``orbit_equations``; z(T) is the state
    after a period. a is the attribute ``start_unknown`` of ``orbit_equations``. At p = 0 the
    solution is a, at p = 1 an orbit. The constructor's ``taylor_piece_budget`` is the number of
    Taylor pieces that the path may take.

    Attributes
    ----------
    taylor_piece_budget_left : int
        Taylor pieces left for the path; a period counts for at least 200.
    """

    def __init__(self, orbit_equations: FlowOrbitEquations, taylor_piece_budget: int) -> None:
        self._orbit_equations, self.shape = orbit_equations, orbit_equations.shape
        self.taylor_piece_budget_left = taylor_piece_budget

    def linearise(self, unknown: np.ndarray, parameter: float) -> _HomotopyPoint:
        """Return the equations at a scaled state and a parameter p.

        Raises
        ------
        ConvergenceError
            No pieces are left, or the motion cannot be integrated.
        """
        if self.taylor_piece_budget_left <= 0:
            raise ConvergenceError("orbits: the homotopy takes too long")
        orbit_point = self._orbit_equations.linearise(unknown, 1.0)
        self.taylor_piece_budget_left -= max(
            orbit_point.n_taylor_pieces, MIN_PIECES_CHARGED_PER_PERIOD
        )
        return _HomotopyPoint(orbit_point, parameter, self._orbit_equations.start_unknown)


def _find_orbit_along_path(search_task: _SearchTask) -> Iterator[PeriodicOrbit]:
    """Follow the path of :class:`GuessToOrbitHomotopy` from the last guess to an orbit.

    Nothing is yielded without a guess, with more than 120 modes, or if the path does not arrive.
    """
    if not search_task.tried_states or search_task.flow.n_modes > MAX_MODES_FOR_MONODROMY:
        return
    orbit_equations = search_task.orbit_equations
    homotopy = GuessToOrbitHomotopy(
        orbit_equations, SearchOptions.piece_budget(search_task.flow) // 2
    )
    path_options = replace(HOMOTOPY_OPTIONS, max_steps=Budget.max_taylor_pieces)
    with suppress(ConvergenceError, np.linalg.LinAlgError):
        # The guess may be an orbit with a singular M - I, next to a resonance without damping.
        guess_orbit_point = solve_in_plane(
            orbit_equations,
            orbit_equations.start_unknown,
            1.0,
            None,
            tolerance=SPECIAL_POINT_TOLERANCE,
            max_iterations=1,
        )
        if guess_orbit_point is not None:
            yield orbit_equations.orbit(guess_orbit_point)
            return
        start_point = point_on_path(homotopy, orbit_equations.start_unknown, 0.0)
        end_point = Path(
            homotopy, start_point, path_options, [Target(1.0)]
        ).find_terminal_event_point_or_none()
        if end_point is not None:
            yield from filter(
                None, [search_task.find_orbit(orbit_equations.state(end_point.unknown))]
            )


# --- along the motion -----------------------------------------------------------------------------


def _find_orbit_along_motion(search_task: _SearchTask) -> Iterator[PeriodicOrbit]:
    """Follow the motion from the last guess, and yield an orbit near the motion.

    Newton's method starts from the motion's last state, then from the states that a period changes
    least. All these starts together may take a quarter of the search's budget. Nothing is yielded
    if they fail.
    """
    orbit_equations = search_task.orbit_equations
    remaining_taylor_pieces = SearchOptions.piece_budget(search_task.flow) // 4
    state_iterator = yield_states_after_periods(
        orbit_equations, orbit_equations.start_unknown, SearchOptions.max_periods(search_task.flow)
    )
    states_at_periods = np.array([orbit_equations.start_unknown, *state_iterator])
    search_task.failure_reasons.append(
        describe_closest_return(states_at_periods, search_task.subharmonic)
    )
    distances_after_period = np.linalg.norm(np.diff(states_at_periods, axis=0), axis=1)
    # Start from the last state, then from the close returns, the closest first.
    for state_index in (-1, *np.argsort(distances_after_period, kind="stable").tolist()):
        if remaining_taylor_pieces <= 0:
            return
        start_state = orbit_equations.state(states_at_periods[state_index])
        orbit = find_orbit(
            search_task.flow, search_task.omega, start_state, subharmonic=search_task.subharmonic
        )
        if orbit is not None:
            yield orbit
            return
        # A failed search takes about half of its maximum.
        remaining_taylor_pieces -= (
            MAX_PERIODS_IN_NEWTON_SEARCH
            // 2
            * max(MIN_PIECES_CHARGED_PER_PERIOD, orbit_equations.n_taylor_pieces_in_last_period)
        )


ORBIT_START_STRATEGY_BY_NAME = {
    "guesses": StartStrategy("exact orbit by Newton's method", _find_orbits_from_guesses),
    "steps": StartStrategy(
        "exact orbit by multiple shooting", _find_orbit_after_multiple_shooting_step
    ),
    "path": StartStrategy("exact orbit by continuation", _find_orbit_along_path),
    "motion": StartStrategy(
        "exact orbit by integrating the motion over many periods", _find_orbit_along_motion
    ),
}
"""Starts for an orbit search, by name, in order."""


def yield_states_after_periods(
    orbit_equations: FlowOrbitEquations, scaled_state: np.ndarray, max_periods: int
) -> Iterator[np.ndarray]:
    """Yield a motion's state, in the scaled unknowns of ``orbit_equations``, after each period.

    The motion starts at ``scaled_state``, and ends after ``max_periods`` periods, after 200
    ``max_periods`` Taylor pieces, or if integration fails. A piece is an interval with a single
    Taylor series.
    """
    remaining_taylor_pieces = MIN_PIECES_CHARGED_PER_PERIOD * max_periods
    with suppress(ConvergenceError):  # pairs may chatter without end
        for _ in range(max_periods):
            if remaining_taylor_pieces <= 0:
                return
            scaled_state = orbit_equations.unknown_after_period(scaled_state, 1.0)
            remaining_taylor_pieces -= orbit_equations.n_taylor_pieces_in_last_period
            yield scaled_state


def describe_closest_return(
    states_at_periods: np.ndarray, subharmonic: int, motion_name: str = "the exact motion"
) -> str:
    """Describe in words a motion's closest return to a state 1 to 8 periods before.

    Parameters
    ----------
    states_at_periods : (n, flow.state_size)
        States one period apart.
    subharmonic : int
        Load periods between two states.
    motion_name : str
        Subject of the sentence, such as "it".
    """
    closest_relative_distance_of_lags = []
    for n_lag_periods in range(1, min(MAX_RETURN_PERIODS, len(states_at_periods) - 1) + 1):
        state_sizes = np.linalg.norm(states_at_periods[n_lag_periods:], axis=1)
        return_distances = np.linalg.norm(
            states_at_periods[n_lag_periods:] - states_at_periods[:-n_lag_periods], axis=1
        )
        closest_relative_distance_of_lags.append(
            float(np.min(return_distances / np.maximum(state_sizes, 1e-300)))
        )
    if not closest_relative_distance_of_lags:
        return f"{motion_name} cannot be integrated over a period: {FEWER_EVENTS_ADVICE}"
    closest_lag_index = int(np.argmin(closest_relative_distance_of_lags))
    followed_periods_text = format_count((len(states_at_periods) - 1) * subharmonic, "period")
    return_periods_text = format_count((closest_lag_index + 1) * subharmonic, "period")
    closeness_text = format_percent(closest_relative_distance_of_lags[closest_lag_index])
    return (
        f"after {followed_periods_text} of the load {motion_name} is not periodic: it comes back to"
        f" within {closeness_text} of an earlier state at best, after {return_periods_text}"
    )
