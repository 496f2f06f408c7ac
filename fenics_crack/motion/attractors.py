"""Attractors: the motions of the exact flow in the long run."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.progress import begin
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
from fenics_crack.numerics.equations import LOCATION_TOLERANCE

MAX_SETTLED_CHANGE = 1e-3
"""Maximum relative change of a motion that has settled."""
MAX_GROWTH_PERIODS = 35
"""Maximum periods over which the growth of a disturbance is measured."""
IRREGULAR_GROWTH = 1e3
"""Growth of a disturbance over the last two thirds of them from which on a motion is irregular.
Next to a stable orbit it is at most the condition number of the multipliers' eigenvectors."""


@dataclass(frozen=True, repr=False)
class Attractor:
    """Motion of the exact flow in the long run.

    Attributes
    ----------
    orbit : PeriodicOrbit or None
        The stable orbit to which it settles, perhaps one of several periods; None where it has not.
    description : str
        Outcome in words.
    periods : int
        Of the load, that it was followed for.
    orbits : FlowOrbits
        Of its flow and period.
    last : (2 n_modes,)
        The state x to which it was followed.
    growth : float
        Factor by which a small disturbance of an irregular motion grows in a period; else nan.
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
        """Half the peak-to-peak displacement of a dof, or of the watched one, in each period of the
        orbit, or in 100 more where the motion does not settle: (n,) [m] (collective). Of several
        periods they are of 512 instants each.

        Raises
        ------
        ConvergenceError
            It cannot be followed that long.
        """
        if self.orbit is not None and self.orbit.subharmonic == self.orbits.subharmonic:
            return np.array([self.orbit.amplitude(dof)])
        flow, omega = self.orbits.flow, self.orbits.omega
        period = 2.0 * np.pi * self.orbits.subharmonic / omega
        state, count = self.orbits.state(self.last), 100
        if self.orbit is not None:
            state, count = self.orbit.state, self.orbit.subharmonic // self.orbits.subharmonic
        time = np.arange(count * INSTANTS_PER_PERIOD) * period / INSTANTS_PER_PERIOD
        found = flow.advance(state, omega, count * period, instants=time).samples.displacement
        values = flow.structure.values_at(found, [dof]).reshape(count, INSTANTS_PER_PERIOD)
        return np.asarray(np.ptp(values, axis=1) / 2.0)


def find_attractor(orbits: FlowOrbits, start: np.ndarray, most: int | None = None) -> Attractor:
    """Return the exact motion from a state x after many periods: it is integrated until it has
    settled, or for ``most``, by default a quarter of a search's budget, for any modes."""
    most = max(MAX_RETURN_PERIODS + 1, SearchOptions.evaluations // 4 if most is None else most)
    begin(f"the exact motion over up to {most} periods")
    passed, ahead = start[None], follow_periods(orbits, start, most)
    while more := list(islice(ahead, len(passed) - 1 + MAX_RETURN_PERIODS)):
        passed = np.concatenate([passed, more])
        last = passed[-1]
        changes = np.linalg.norm(passed[-2 : -MAX_RETURN_PERIODS - 2 : -1] - last, axis=1)
        size = np.linalg.norm(last)
        for several in np.flatnonzero(changes <= MAX_SETTLED_CHANGE * size):
            turns = int(1 + several) * orbits.subharmonic
            orbit = find_orbit(orbits.flow, orbits.omega, orbits.state(last), subharmonic=turns)
            if orbit is None:
                continue
            decays = 1.0 - abs(orbit.multipliers[0])
            off = np.linalg.norm(orbits.unknown(orbit.state) - last)
            # What decays by |mu| a period and is off by d changes by no less than (1 - |mu|) d.
            if decays > 0.0 and decays * off <= 2.0 * changes[several] + LOCATION_TOLERANCE * size:
                after = f"an orbit of {turns} periods of the load"
                does = f"settles to {after if several else 'a periodic orbit'}"
                return Attractor(orbit, does, (len(passed) - 1) * orbits.subharmonic, orbits, last)
    does = f"does not settle: {describe_closest_return(passed, orbits.subharmonic, 'it')}"
    return Attractor(None, does, (len(passed) - 1) * orbits.subharmonic, orbits, passed[-1])


def find_irregular_motion(
    flow: ContactFlow, omega: float, state: np.ndarray, subharmonic: int = 1
) -> Attractor | None:
    """Follow a motion and a small disturbance of it, which grows if the motion is irregular.

    With the derivatives M_i of the flow over the periods, v_{i+1} = M_i v_i is followed from a
    random v_0. Its mean growth in a period is exp(lambda T), lambda the first Lyapunov exponent.

    Parameters
    ----------
    state : (2 n_modes,)
        Of the motion at phase zero.

    Returns
    -------
    Attractor or None
        With its growth; None where the disturbance does not grow a thousandfold, or the motion
        cannot be followed.

    Notes
    -----
    Source: Benettin et al., Meccanica 15 (1980) 9-20.
    """
    begin("growth of a disturbance of the exact motion")
    period, weights = 2.0 * np.pi * subharmonic / omega, flow.weights(omega / subharmonic)
    change = np.random.default_rng(1).normal(size=flow.size) / weights
    piece_budget, logs = MAX_SEARCH_PIECES, [0.0]
    with suppress(ConvergenceError):  # also at the end of its budget
        for _ in range(MAX_GROWTH_PERIODS):
            motion = flow.advance(state, omega, period, budget=Budget(pieces=piece_budget))
            change = motion.track @ (change / np.linalg.norm(weights * change))
            state, piece_budget = motion.state, piece_budget - motion.pieces
            logs.append(logs[-1] + math.log(np.linalg.norm(weights * change)))
    start_index = len(logs) // 3
    log_growth = logs[-1] - logs[start_index]
    if not log_growth > math.log(IRREGULAR_GROWTH):  # nan neither
        return None
    growth = math.exp(log_growth / (len(logs) - 1 - start_index))
    orbits = FlowOrbits(flow, omega, state, subharmonic)
    return Attractor(
        None,
        f"is irregular: a small disturbance grows {float(f'{growth:.2g}'):,g}-fold in a period",
        (len(logs) - 1) * subharmonic,
        orbits,
        orbits.start,
        growth,
    )
