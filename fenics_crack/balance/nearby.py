"""The exact orbit next to a balanced wave, and the wave's error by one Newton step on the flow."""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.bordered import solve_in_plane
from fenics_crack.balance.fourier import evaluate
from fenics_crack.balance.orbits import FlowOrbits
from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.flow import ContactFlow
from fenics_crack.motion.orbit import PeriodicOrbit, Prediction, find_orbit, predict

__all__ = ["orbit_next_to", "predicted", "wave_states"]

CLOSED = 1e-10
"""How closely an orbit repeats itself."""
PARTS = 32
"""Of the period, whose starts' states are corrected together."""


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
    """The orbit next to a state: by steps that shrink the step to follow, or else the residual.
    None where these lead to none."""
    orbit = find_orbit(flow, omega, start, subharmonic=subharmonic)
    if orbit is not None:
        return orbit
    orbits = FlowOrbits(flow, omega, start, subharmonic)
    try:
        found = solve_in_plane(
            orbits, orbits.start, 1.0, None,
            tolerance=CLOSED, iterations=20, least_damping=1e-3, patience=6,
        )  # fmt: skip
    except ConvergenceError:
        return None
    return None if found is None else orbits.orbit(found)
