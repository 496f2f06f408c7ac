"""Exact motion with the penalty law: recorded from one switching instant to the next."""

from __future__ import annotations

from typing import Any

import numpy as np

from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.exact_flow import EventFlow
from fenics_crack.model.reduced import INSTEAD, check_mass
from fenics_crack.model.structure import Structure
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
    """March exactly from one switching instant to the next, under the penalty law.

    Parameters
    ----------
    structure : Structure
        At most 600 dofs; reduce a larger one first.
    contact : UnilateralPenalty
        Law of all pairs.
    steps_per_period : int
        Instants recorded in a period; they do not change the motion.
    omega, periods, **options
        As in :class:`fenics_crack.time.march.March`.

    Raises
    ------
    InputError
        The structure is too large, has too many pairs or no mass at its lips, or an argument
        cannot be used.
    ConvergenceError
        Pairs open and close without end.
    """
    check_mass(structure, INSTEAD)
    asked = March(structure, omega, contact, periods, steps_per_period, **options)
    return march(asked, _ByEvents(asked))


class _ByEvents(Scheme):
    """The exact flow, period by period."""

    name = "events"

    def __init__(self, asked: March) -> None:
        self._flow = flow = EventFlow(asked.structure, asked.omega, asked.contact)
        self._contact, self._period = asked.contact, 2.0 * np.pi / asked.omega
        motion = flow.displacement_rows()
        blocks = flow.gap_rows, motion[asked.recorded_dofs], motion[asked.load_rows]
        self._rows = np.vstack(blocks)
        self._ends = np.cumsum([len(block) for block in blocks])[:-1]
        self._phases = np.arange(asked.steps_per_period) / asked.steps_per_period
        self._state = flow.state(*asked.start)

    def fill(self, window: Window, number: int) -> None:
        instants = (number + self._phases) * self._period
        self._state, record, _, _ = self._flow.advance(
            self._state, number * self._period, self._period, instants=instants, rows=self._rows
        )
        gap, window.motion[:], window.load_motion[:] = np.split(record, self._ends, axis=1)
        window.gap[:] = gap - self._flow.structure.clearance
        window.force[:] = self._contact.force(window.gap)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        return self._flow.motion(self._state)
