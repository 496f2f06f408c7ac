"""Attractors: exact motions after many periods, settled to a periodic orbit or irregular."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.motion.flow import Budget, ContactFlow
from fenics_crack.motion.orbit import (
    INSTANTS_PER_PERIOD,
    MAX_TAYLOR_PIECES_PER_ORBIT_SEARCH,
    PeriodicOrbit,
    find_orbit,
)
from fenics_crack.motion.search import (
    MAX_RETURN_PERIODS,
    SearchOptions,
    describe_closest_return,
    yield_states_after_periods,
)
from fenics_crack.motion.shooting import FlowOrbitEquations
from fenics_crack.numerics.equations import SPECIAL_POINT_TOLERANCE

MAX_SETTLED_CHANGE = 1e-3
"""Maximum relative distance of a settled motion's state from an earlier state."""
MAX_GROWTH_PERIODS = 35
"""Maximum number of periods over which the growth of a disturbance is measured."""
IRREGULAR_TOTAL_GROWTH = 1e3
"""Minimum disturbance growth in an irregular motion, over the last two thirds of the periods. Next
to a stable orbit the growth is at most the condition number of the multipliers' eigenvectors."""


@keep_old_attribute_names(
    amplitudes="amplitude_in_each_period",
    last="last_scaled_state",
    orbits="periodic_orbit_equations",
    periods="n_integrated_load_periods",
)
@dataclass(frozen=True, repr=False)
class Attractor:
    """Exact motion after many periods.

    Attributes
    ----------
    orbit : PeriodicOrbit or None
        Stable orbit to which the motion settles, perhaps with a longer period; None if it does not
        settle.
    description : str
        Outcome in words.
    n_integrated_load_periods : int
        Number of load periods that were integrated.
    periodic_orbit_equations : FlowOrbitEquations
        Equations z(T) = z(0) of the state z at phase zero, after the period T. They hold the flow
        and the load frequency.
    last_scaled_state : (flow.state_size,)
        Last state, in the scaled unknowns of ``periodic_orbit_equations``.
    growth : float
        Factor by which a small disturbance grows in a period of an irregular motion; else nan.
    """

    orbit: PeriodicOrbit | None
    description: str
    n_integrated_load_periods: int
    periodic_orbit_equations: FlowOrbitEquations
    last_scaled_state: np.ndarray
    growth: float = math.nan

    def __repr__(self) -> str:
        """Return the class name with the outcome in words."""
        return f"{type(self).__name__}({self.description})"

    def amplitude_in_each_period(self, dof: int | None = None) -> np.ndarray:
        """Return half the peak-to-peak displacement in each period: (n,) [m] (collective).

        A period is the period of ``periodic_orbit_equations``. If the motion settles, n is the
        number of these periods in the orbit's period; otherwise n = 100 further periods are
        integrated. With n > 1, each period is sampled at 512 instants.

        Parameters
        ----------
        dof : int, optional
            Number of a dof. Default: the watched dof.

        Raises
        ------
        ConvergenceError
            The motion cannot be integrated for so long.
        """
        if (
            self.orbit is not None
            and self.orbit.subharmonic == self.periodic_orbit_equations.subharmonic
        ):
            return np.array([self.orbit.amplitude(dof)])
        flow, omega = self.periodic_orbit_equations.flow, self.periodic_orbit_equations.omega
        period = 2.0 * np.pi * self.periodic_orbit_equations.subharmonic / omega
        start_state, n_periods = self.periodic_orbit_equations.state(self.last_scaled_state), 100
        if self.orbit is not None:
            start_state, n_periods = (
                self.orbit.state,
                self.orbit.subharmonic // self.periodic_orbit_equations.subharmonic,
            )
        sample_times = np.arange(n_periods * INSTANTS_PER_PERIOD) * period / INSTANTS_PER_PERIOD
        structure_displacement = flow.advance(
            start_state, omega, n_periods * period, instants=sample_times
        ).samples.displacement
        period_displacements = flow.structure.values_at(structure_displacement, [dof]).reshape(
            n_periods, INSTANTS_PER_PERIOD
        )
        return np.asarray(np.ptp(period_displacements, axis=1) / 2.0)


def find_attractor(
    orbit_equations: FlowOrbitEquations, start_unknown: np.ndarray, max_periods: int | None = None
) -> Attractor:
    """Integrate a motion until it settles to a stable periodic orbit.

    A motion settles if two conditions hold. The state agrees to 1e-3, relative, with the state 1 to
    8 periods before. And Newton's method finds a stable orbit near this state.

    Parameters
    ----------
    orbit_equations : FlowOrbitEquations
        Flow, load frequency and period.
    start_unknown : (flow.state_size,)
        State at phase zero, in the scaled unknowns of ``orbit_equations``.
    max_periods : int, optional
        Maximum number of periods, at least 9. Default: 1000, a quarter of
        ``SearchOptions.period_budget``.

    Returns
    -------
    Attractor
        Without an orbit if the motion does not settle.
    """
    max_periods = SearchOptions.period_budget // 4 if max_periods is None else max_periods
    max_periods = max(MAX_RETURN_PERIODS + 1, max_periods)
    begin_stage(f"the exact motion over up to {max_periods} periods")
    states_at_periods = start_unknown[None]
    state_iterator = yield_states_after_periods(orbit_equations, start_unknown, max_periods)
    while new_states := list(
        islice(state_iterator, len(states_at_periods) - 1 + MAX_RETURN_PERIODS)
    ):
        states_at_periods = np.concatenate([states_at_periods, new_states])
        last_state = states_at_periods[-1]
        lag_distances = np.linalg.norm(
            states_at_periods[-2 : -MAX_RETURN_PERIODS - 2 : -1] - last_state, axis=1
        )
        state_size = np.linalg.norm(last_state)
        for lag_index in np.flatnonzero(lag_distances <= MAX_SETTLED_CHANGE * state_size):
            n_orbit_load_periods = int(1 + lag_index) * orbit_equations.subharmonic
            orbit = find_orbit(
                orbit_equations.flow,
                orbit_equations.omega,
                orbit_equations.state(last_state),
                subharmonic=n_orbit_load_periods,
            )
            if orbit is None:
                continue
            relative_decay_per_period = 1.0 - abs(orbit.multipliers[0])
            distance_to_orbit = np.linalg.norm(orbit_equations.unknown(orbit.state) - last_state)
            # A state at the distance d from an orbit with the multiplier mu moves by at least
            # (1 - |mu|) d in a period.
            allowed_movement = 2.0 * lag_distances[lag_index] + SPECIAL_POINT_TOLERANCE * state_size
            if (
                relative_decay_per_period > 0.0
                and relative_decay_per_period * distance_to_orbit <= allowed_movement
            ):
                orbit_text = f"an orbit of {n_orbit_load_periods} periods of the load"
                outcome_text = f"settles to {orbit_text if lag_index else 'a periodic orbit'}"
                return Attractor(
                    orbit,
                    outcome_text,
                    (len(states_at_periods) - 1) * orbit_equations.subharmonic,
                    orbit_equations,
                    last_state,
                )
    outcome_text = "does not settle: " + describe_closest_return(
        states_at_periods, orbit_equations.subharmonic, "the motion"
    )
    return Attractor(
        None,
        outcome_text,
        (len(states_at_periods) - 1) * orbit_equations.subharmonic,
        orbit_equations,
        states_at_periods[-1],
    )


def find_irregular_motion(
    flow: ContactFlow, omega: float, state: np.ndarray, subharmonic: int = 1
) -> Attractor | None:
    """Return the motion from a state if a small disturbance grows, else None.

    The disturbance v_i after i periods is followed from a random v_0: v_{i+1} = M_i v_i, with the
    derivative M_i of the flow over period i. The mean growth in a period is exp(lambda T), with the
    first Lyapunov exponent lambda and the period T. Up to 35 periods are integrated, with at most
    20,000 Taylor pieces (intervals with a single Taylor series).

    Parameters
    ----------
    flow : ContactFlow
    omega : float
        Load frequency [rad/s].
    state : (flow.state_size,)
        State of the motion at phase zero.
    subharmonic : int
        Number of load periods in a period T.

    Returns
    -------
    Attractor or None
        The irregular motion with its growth. None if the disturbance grows less than a thousandfold
        over the last two thirds of the integrated periods.

    Notes
    -----
    Source: Benettin et al., Meccanica 15 (1980) 9-20.
    """
    begin_stage("growth of a disturbance of the exact motion")
    period, energy_weights = (
        2.0 * np.pi * subharmonic / omega,
        flow.energy_weights(omega / subharmonic),
    )
    state_change = np.random.default_rng(1).normal(size=flow.state_size) / energy_weights
    remaining_taylor_pieces, cumulative_log_growths = MAX_TAYLOR_PIECES_PER_ORBIT_SEARCH, [0.0]
    with suppress(ConvergenceError):  # also at the end of its budget
        for _ in range(MAX_GROWTH_PERIODS):
            period_motion = flow.advance(
                state, omega, period, budget=Budget(max_taylor_pieces=remaining_taylor_pieces)
            )
            state_change = period_motion.track @ (
                state_change / np.linalg.norm(energy_weights * state_change)
            )
            state, remaining_taylor_pieces = (
                period_motion.state,
                remaining_taylor_pieces - period_motion.n_taylor_pieces,
            )
            cumulative_log_growths.append(
                cumulative_log_growths[-1] + math.log(np.linalg.norm(energy_weights * state_change))
            )
    transient_end_index = len(cumulative_log_growths) // 3
    total_log_growth = cumulative_log_growths[-1] - cumulative_log_growths[transient_end_index]
    if not total_log_growth > math.log(IRREGULAR_TOTAL_GROWTH):  # nan neither
        return None
    growth_factor_per_period = math.exp(
        total_log_growth / (len(cumulative_log_growths) - 1 - transient_end_index)
    )
    orbit_equations = FlowOrbitEquations(flow, omega, state, subharmonic)
    return Attractor(
        None,
        "is irregular: a small disturbance grows"
        f" {float(f'{growth_factor_per_period:.2g}'):,g}-fold in a period",
        (len(cumulative_log_growths) - 1) * subharmonic,
        orbit_equations,
        orbit_equations.start_unknown,
        growth_factor_per_period,
    )
