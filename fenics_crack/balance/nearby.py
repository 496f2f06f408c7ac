"""The exact orbit next to a balanced wave, and the wave's error by one Newton step on the flow."""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.orbits import FlowOrbits, Homotopy, recurrences
from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.flow import ContactFlow
from fenics_crack.motion.orbit import CLOSED, FORMED, PeriodicOrbit, Prediction, find_orbit, predict
from fenics_crack.numerics.bordered import point_on_path, solve_in_plane
from fenics_crack.numerics.fourier import evaluate
from fenics_crack.numerics.path import Path, PathOptions, Target
from fenics_crack.stages import begin

__all__ = ["PARTS", "orbit_next_to", "predicted", "recurring", "wave_states"]

PARTS = 32
"""Of the period, whose starts' states are corrected together."""
SWITCHES, STEP = 100_000, 0.3
"""Openings and closings that a homotopy to an orbit may pass, a second or two; its longest step."""
WANDERING, PASSED, SETTLING = 1000, 100, 60
"""Periods that a motion is followed for, its nearest recurrences from which an orbit is sought, and
the least periods, of large states."""
FEW = 24
"""Numbers of a state up to which all those are tried; beyond, fewer, as each takes longer."""


def wave_states(flow: ContactFlow, displacement: np.ndarray, base_omega: float) -> np.ndarray:
    """States at equal parts of the period of a wave of the displacement, given by its coefficients
    (2H+1, n_dofs) [m]: (32, 2 n_modes)."""
    time = 2.0 * np.pi / base_omega / PARTS * np.arange(PARTS)
    order = base_omega * np.arange(1, len(displacement) // 2 + 1)[:, None]
    rate = np.zeros_like(displacement)
    rate[1::2], rate[2::2] = order * displacement[2::2], -order * displacement[1::2]
    return flow.state(evaluate(displacement, base_omega, time), evaluate(rate, base_omega, time))


def predicted(
    flow: ContactFlow, omega: float, states: np.ndarray, subharmonic: int = 1
) -> Prediction | None:
    """The error of a wave of such states under a load of a frequency; None where the motion cannot
    be followed."""
    try:
        return predict(flow, omega, states, subharmonic=subharmonic)
    except (ConvergenceError, np.linalg.LinAlgError, ValueError):
        return None


def orbit_next_to(
    flow: ContactFlow,
    omega: float,
    start: np.ndarray,
    subharmonic: int = 1,
    *,
    patient: bool = True,
) -> PeriodicOrbit | None:
    """The orbit next to a state: by Newton's method, or else, if ``patient``, where the homotopy
    from the state leads, where M is formed; None where these lead to none.

    Where stiff pairs open and close many times, Newton's method finds an orbit only from very near.
    """
    orbit = find_orbit(flow, omega, start, subharmonic=subharmonic)
    if orbit is not None or not patient or flow.size > FORMED:
        return orbit
    return _by_homotopy(FlowOrbits(flow, omega, start, subharmonic))


def _by_homotopy(orbits: FlowOrbits) -> PeriodicOrbit | None:
    """The orbit to which the path from the start of some leads; None where that takes too long."""
    share = min(1.0, (FEW / orbits.flow.size) ** 2)
    homotopy = Homotopy(orbits, int(share * SWITCHES))
    options = PathOptions(STEP, max_step=STEP, max_steps=SWITCHES, span=(0.0, 2.0), min_cosine=0.5)
    try:
        # M - I may be singular where the motion closes: next to a resonance without damping.
        closed = solve_in_plane(orbits, orbits.start, 1.0, None, tolerance=CLOSED, iterations=1)
        if closed is not None:
            return orbits.orbit(closed)
        start = point_on_path(homotopy, orbits.start, 0.0)
        met = Path(homotopy, start, options, [Target(1.0)]).run()
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
    if met is None:
        return None
    state = orbits.state(met.unknown)
    return find_orbit(orbits.flow, orbits.omega, state, subharmonic=orbits.subharmonic)


def recurring(
    flow: ContactFlow, omega: float, start: np.ndarray, subharmonic: int = 1
) -> PeriodicOrbit | None:
    """An orbit that the motion from a state settles to, or passes on its way; None where none is
    found.

    Where no orbit attracts it the motion wanders, and passes near orbits that it leaves again, at
    times when it nearly repeats itself: from there Newton's method finds one.

    Source: Auerbach et al., Physical Review Letters 58 (1987) 2387-2389.
    """
    orbits = FlowOrbits(flow, omega, start, subharmonic)
    share = min(1.0, (FEW / flow.size) ** 2)
    passed, periods = [orbits.start], max(int(share * WANDERING), SETTLING)
    begin(f"the exact motion over {periods} periods, and orbits that it passes")
    try:
        for _ in range(periods):
            passed.append(orbits.moved(passed[-1], 1.0))
    except ConvergenceError:  # pairs that chatter without end
        pass
    for place in recurrences(passed, int(np.ceil(share * PASSED))):
        orbit = find_orbit(flow, omega, orbits.state(passed[place]), subharmonic=subharmonic)
        if orbit is not None:
            return orbit
    return None
