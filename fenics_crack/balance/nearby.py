"""The exact orbit next to a balanced wave, and the wave's error by one Newton step on the flow."""

from __future__ import annotations

import numpy as np

from fenics_crack.balance.fourier import evaluate
from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.flow import ContactFlow
from fenics_crack.motion.orbit import PeriodicOrbit, Prediction, find_orbit, predict

__all__ = ["orbit_next_to", "predicted", "wave_states"]

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
    flow: ContactFlow, omega: float, displacement: np.ndarray, subharmonic: int = 1
) -> Prediction | None:
    """The error of such a wave under a load of a frequency; None where the motion cannot be
    followed."""
    states = wave_states(flow, displacement, omega / subharmonic)
    try:
        return predict(flow, omega, states, subharmonic=subharmonic)
    except (ConvergenceError, np.linalg.LinAlgError):
        return None


def orbit_next_to(
    flow: ContactFlow, omega: float, displacement: np.ndarray, subharmonic: int = 1
) -> PeriodicOrbit | None:
    """The orbit that Newton's method leads to from such a wave; None where it leads to none."""
    state = wave_states(flow, displacement, omega / subharmonic)[0]
    return find_orbit(flow, omega, state, subharmonic=subharmonic)
