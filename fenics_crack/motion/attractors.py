"""Attractors: exact motions after many periods."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.motion.flow import Budget, ContactFlow
from fenics_crack.motion.orbit import (
    INSTANTS_PER_PERIOD,
    MAX_SEARCH_PIECES,
    PeriodicOrbit,
    find_orbit,
)
from fenics_crack.motion.search import (
    MAX_RETURN_PERIODS,
    SearchOptions,
    describe_closest_return,
    follow_periods,
)
from fenics_crack.motion.shooting import FlowOrbits
from fenics_crack.numerics.equations import MAX_LOCATION_RESIDUAL

MAX_SETTLED_CHANGE = 1e-3
"""Maximum relative change of a settled motion, from one return to the next."""
MAX_GROWTH_PERIODS = 35
"""Maximum periods over which the growth of a disturbance is measured."""
IRREGULAR_GROWTH = 1e3
"""Minimum disturbance growth in an irregular motion, over the last two thirds of the periods. Next
to a stable orbit the growth is at most the condition number of the multipliers' eigenvectors."""


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
    periods : int
        Number of load periods that were integrated.
    orbits : FlowOrbits
        Flow, load frequency and period, as equations z(T) = z(0).
    last : (flow.size,)
        Last state, in the scaled unknowns x of ``orbits``.
    growth : float
        Growth of a small disturbance in one period of an irregular motion; else nan.
    """

    orbit: PeriodicOrbit | None
    description: str
    periods: int
    orbits: FlowOrbits
    last: np.ndarray
    growth: float = math.nan

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.description})"

    def amplitudes(self, dof: int | None = None) -> np.ndarray:
        """Return half the peak-to-peak displacement in each period: (n,) [m] (collective).

        The n periods belong to the orbit. A motion that does not settle gets 100 further periods.
        Each period is sampled at 512 instants if there are several.

        Parameters
        ----------
        dof : int, optional
            Default: the watched dof.

        Raises
        ------
        ConvergenceError
            The motion cannot be integrated for so long.
        """
        if self.orbit is not None and self.orbit.subharmonic == self.orbits.subharmonic:
            return np.array([self.orbit.amplitude(dof)])
        flow, omega = self.orbits.flow, self.orbits.omega
        period = 2.0 * np.pi * self.orbits.subharmonic / omega
        state, n_periods = self.orbits.state(self.last), 100
        if self.orbit is not None:
            state, n_periods = self.orbit.state, self.orbit.subharmonic // self.orbits.subharmonic
        time = np.arange(n_periods * INSTANTS_PER_PERIOD) * period / INSTANTS_PER_PERIOD
        displacement = flow.advance(
            state, omega, n_periods * period, instants=time
        ).samples.displacement
        watched_displacement = flow.structure.values_at(displacement, [dof]).reshape(
            n_periods, INSTANTS_PER_PERIOD
        )
        return np.asarray(np.ptp(watched_displacement, axis=1) / 2.0)


def find_attractor(
    orbits: FlowOrbits, start: np.ndarray, max_periods: int | None = None
) -> Attractor:
    """Return the exact motion after many periods from a start.

    The motion is integrated until it settles.

    Parameters
    ----------
    orbits : FlowOrbits
        Flow, load frequency and period.
    start : (flow.size,)
        State at phase zero, in the scaled unknowns x of ``orbits``.
    max_periods : int, optional
        Default: a quarter of ``SearchOptions.evaluations``, for any number of modes.
    """
    max_periods = SearchOptions.evaluations // 4 if max_periods is None else max_periods
    max_periods = max(MAX_RETURN_PERIODS + 1, max_periods)
    begin_stage(f"the exact motion over up to {max_periods} periods")
    states, next_states = start[None], follow_periods(orbits, start, max_periods)
    while new_states := list(islice(next_states, len(states) - 1 + MAX_RETURN_PERIODS)):
        states = np.concatenate([states, new_states])
        last_state = states[-1]
        changes = np.linalg.norm(states[-2 : -MAX_RETURN_PERIODS - 2 : -1] - last_state, axis=1)
        size = np.linalg.norm(last_state)
        for lag_index in np.flatnonzero(changes <= MAX_SETTLED_CHANGE * size):
            n_load_periods = int(1 + lag_index) * orbits.subharmonic
            orbit = find_orbit(
                orbits.flow, orbits.omega, orbits.state(last_state), subharmonic=n_load_periods
            )
            if orbit is None:
                continue
            decay = 1.0 - abs(orbit.multipliers[0])
            distance = np.linalg.norm(orbits.unknown(orbit.state) - last_state)
            # A state at the distance d from an orbit with the multiplier mu moves by at least
            # (1 - |mu|) d in a period.
            max_decay = 2.0 * changes[lag_index] + MAX_LOCATION_RESIDUAL * size
            if decay > 0.0 and decay * distance <= max_decay:
                orbit_words = f"an orbit of {n_load_periods} periods of the load"
                description = f"settles to {orbit_words if lag_index else 'a periodic orbit'}"
                return Attractor(
                    orbit, description, (len(states) - 1) * orbits.subharmonic, orbits, last_state
                )
    description = f"does not settle: {describe_closest_return(states, orbits.subharmonic, 'it')}"
    return Attractor(None, description, (len(states) - 1) * orbits.subharmonic, orbits, states[-1])


def find_irregular_motion(
    flow: ContactFlow, omega: float, state: np.ndarray, subharmonic: int = 1
) -> Attractor | None:
    """Return the motion from a state if a small disturbance of it grows.

    The disturbance v_i after i periods is followed from a random v_0: v_{i+1} = M_i v_i, with the
    derivative M_i of the flow over period i. The mean growth in a period is exp(lambda T), with the
    first Lyapunov exponent lambda and the period T.

    Parameters
    ----------
    state : (flow.size,)
        State of the motion at phase zero.

    Returns
    -------
    Attractor or None
        The irregular motion with the growth. None if the disturbance grows less than a
        thousandfold, or if the motion cannot be integrated.

    Notes
    -----
    Source: Benettin et al., Meccanica 15 (1980) 9-20.
    """
    begin_stage("growth of a disturbance of the exact motion")
    period, weights = 2.0 * np.pi * subharmonic / omega, flow.weights(omega / subharmonic)
    change = np.random.default_rng(1).normal(size=flow.size) / weights
    piece_budget, log_growths = MAX_SEARCH_PIECES, [0.0]
    with suppress(ConvergenceError):  # also at the end of its budget
        for _ in range(MAX_GROWTH_PERIODS):
            motion = flow.advance(state, omega, period, budget=Budget(pieces=piece_budget))
            change = motion.track @ (change / np.linalg.norm(weights * change))
            state, piece_budget = motion.state, piece_budget - motion.pieces
            log_growths.append(log_growths[-1] + math.log(np.linalg.norm(weights * change)))
    start_index = len(log_growths) // 3
    log_growth = log_growths[-1] - log_growths[start_index]
    if not log_growth > math.log(IRREGULAR_GROWTH):  # nan neither
        return None
    growth = math.exp(log_growth / (len(log_growths) - 1 - start_index))
    orbits = FlowOrbits(flow, omega, state, subharmonic)
    return Attractor(
        None,
        f"is irregular: a small disturbance grows {float(f'{growth:.2g}'):,g}-fold in a period",
        (len(log_growths) - 1) * subharmonic,
        orbits,
        orbits.start,
        growth,
    )
