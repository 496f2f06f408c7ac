"""Exact motion of piecewise linear and of rigid contact: recorded along the exact flow."""

from __future__ import annotations

from typing import Any

import numpy as np

from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import exact_flow
from fenics_crack.time.march import March, Scheme, TimeHistory, Window, march

__all__ = ["integrate_events"]


def integrate_events(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int = 256,
    **options: Any,
) -> TimeHistory:
    """March exactly from one switching instant to the next.

    Parameters
    ----------
    structure : Structure
        At most 600 dofs; reduce a larger one first.
    contact : UnilateralPenalty or UnilateralConstraint
        Law of all pairs; the latter where lips have no mass.
    steps_per_period : int
        Instants recorded in a period; they do not change the motion.
    omega, periods, **options
        As in :class:`fenics_crack.time.march.March`.

    Returns
    -------
    TimeHistory
        The last periods, sampled at equal steps.

    Raises
    ------
    InputError
        The structure is too large, its lips have mass under rigid contact, or an argument cannot
        be used.
    ConvergenceError
        Pairs open and close without end.

    Examples
    --------
    >>> history = fc.integrate_events(structure, 2000.0, contact, periods=2, initial=solution)
    """
    asked = March(structure, omega, contact, periods, steps_per_period, **options)
    return march(asked, _ByEvents(asked))


class _ByEvents(Scheme):
    """The exact flow, period by period."""

    name = "events"

    def __init__(self, asked: March) -> None:
        self._asked, self._flow = asked, exact_flow(asked.structure, asked.contact)
        self._period = 2.0 * np.pi / asked.omega
        parts = np.arange(asked.steps_per_period + 1) / asked.steps_per_period
        self._instants = parts * self._period
        # Coordinates without mass are no displacements: compared by the work of the load.
        light, force = asked.structure.light_lips, asked.structure.force[:, asked.load_rows]
        self._load_sizes = np.linalg.norm(force, axis=0) if light else 1.0
        self._state = self._flow.state(*asked.start)

    def fill(self, window: Window, number: int) -> None:
        asked = self._asked
        motion = self._flow.advance(
            self._state, asked.omega, self._period, instants=self._instants
        )  # fmt: skip
        self._state, samples = motion.state, motion.samples
        moved = samples.displacement
        self._motion = moved[-1]
        window.gap[:], window.force[:] = samples.gap[:-1], samples.force[:-1]
        window.motion[:] = moved[:-1, asked.recorded_dofs]
        window.load_motion[:] = moved[:-1, asked.load_rows] * self._load_sizes

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        rate = self._flow.modes.shapes @ self._state[self._flow.size // 2 :]
        return self._motion.copy(), rate
