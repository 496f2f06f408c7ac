"""The exact orbit next to a balanced wave, and the wave's error by one Newton step on the flow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.orbits import FlowOrbits, recurrences
from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.flow import ContactFlow
from fenics_crack.motion.orbit import PeriodicOrbit, Prediction, find_orbit, predict
from fenics_crack.numerics.bordered import point_on_path, solve_in_plane
from fenics_crack.numerics.fourier import evaluate
from fenics_crack.numerics.path import Path, PathOptions, Target
from fenics_crack.stages import begin

__all__ = ["PARTS", "orbit_next_to", "predicted", "recurring", "wave_states"]

CLOSED = 1e-10
"""How closely an orbit repeats itself."""
PARTS = 32
"""Of the period, whose starts' states are corrected together."""
APART = 1e-3 * 2.0 ** np.array([0, 1, -1, 2, -2, 3, -3, 4, 5])
"""Of the frequency, to both sides, where orbits are sought that a path leads from."""
BACK = 100
"""Points of that path."""

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
    except (ConvergenceError, np.linalg.LinAlgError):
        return None


def orbit_next_to(
    flow: ContactFlow, omega: float, start: np.ndarray, subharmonic: int = 1
) -> PeriodicOrbit | None:
    """The orbit next to a state: by steps that shrink the step to follow, or else the residual; or
    by the path of orbits from another frequency, sought from the same state. None where these lead
    to none.

    Where stiff pairs open and close many times, an orbit is found only from very near: at some
    frequencies by chance, and the path goes on from there.
    """
    orbit = find_orbit(flow, omega, start, subharmonic=subharmonic)
    if orbit is not None:
        return orbit
    orbits = FlowOrbits(flow, omega, start, subharmonic)
    try:
        shorter = solve_in_plane(
            orbits, orbits.start, 1.0, None,
            tolerance=CLOSED, iterations=20, least_damping=1e-3, patience=6,
        )  # fmt: skip
    except ConvergenceError:
        shorter = None
    if shorter is not None:
        return orbits.orbit(shorter)
    share = min(1.0, (FEW / flow.size) ** 2)
    for apart in APART[: int(np.ceil(share * len(APART)))]:
        for at in (omega * (1.0 + apart), omega * (1.0 - apart)):
            found = find_orbit(flow, at, start, subharmonic=subharmonic)
            if found is not None and (orbit := _back(found, omega)) is not None:
                return orbit
    return None


def _back(found: PeriodicOrbit, omega: float) -> PeriodicOrbit | None:
    """The first orbit of a frequency on the path from another one; None where it is not met."""
    orbits = FlowOrbits(found.flow, found.omega, found.state, found.subharmonic)
    end = omega / found.omega
    try:
        start = point_on_path(orbits, orbits.start, 1.0)
        if end < 1.0:
            start = replace(start, tangent=start.tangent.reversed())
        options = PathOptions(0.1 * abs(end - 1.0), max_steps=BACK)
        met = Path(orbits, start, options, [Target(end)]).run()
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
    if met is None:
        return None
    return find_orbit(found.flow, omega, orbits.state(met.unknown), subharmonic=found.subharmonic)


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
