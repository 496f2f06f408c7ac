"""Exact motion with the penalty law: linear flow from one switching instant to the next.

While the set of closed pairs does not change, the motion is known in closed form
(:mod:`fenics_crack.time.regime`). There is no step size and no truncation: the error is that of the
switching instants.

The same flow gives periodic orbits by shooting: z(T) = z(0) by Newton's method with the monodromy
matrix, whose eigenvalues are the exact Floquet multipliers.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial
from typing import Any

import numpy as np

from fenics_crack.errors import ConvergenceError, InputError, check_omega
from fenics_crack.model.contact import ContactLaw, check_law, is_piecewise_linear
from fenics_crack.model.modal import AllModes, all_modes, is_small
from fenics_crack.model.reduced import INSTEAD, check_mass
from fenics_crack.model.structure import Structure
from fenics_crack.time.march import March, Scheme, TimeHistory, Window, march
from fenics_crack.time.regime import FreeMotion, Gaps, Regime, next_event

__all__ = ["MAX_PAIRS", "EventFlow", "integrate_events"]

MAX_PAIRS = 12
MAX_EVENTS = 100_000
"""In one flow; more are a sign that pairs chatter without end."""
MAX_STEPS = 3e5
"""Twelfths of the period of the highest mode in one flow, about half a second of work."""


class EventFlow:
    """The exact flow of a small structure under its own load.

    States are (2n,) arrays (s q, q') of modal coordinates, s = :attr:`scale`.
    """

    def __init__(self, structure: Structure, omega: float, contact: ContactLaw) -> None:
        if not is_piecewise_linear(contact):
            raise InputError("contact", contact, "a UnilateralPenalty, linear in contact")
        check_omega(omega)
        check_law(structure, contact)
        check_mass(structure, INSTEAD)
        if not is_small(structure):
            raise InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
        if structure.n_pairs > MAX_PAIRS:
            raise InputError(
                "structure",
                f"{structure.n_pairs} pairs",
                f"one with at most {MAX_PAIRS}: n pairs have 2^n regimes, each taken apart into "
                "its modes; integrate_implicit takes many",
            )
        self.structure, self.omega = structure, omega
        self._modes: AllModes = all_modes(structure)
        self.scale = float(np.sqrt(np.abs(self._modes.squares).max())) or 1.0
        self._stiffness = np.broadcast_to(contact.stiffness, structure.n_pairs).astype(float)
        self._regimes: dict[bytes, Regime] = {}
        self._free: dict[bytes, FreeMotion] = {}
        count = len(self._modes.squares)
        self.gap_rows = np.hstack(
            [self._modes.pairs.T / self.scale, np.zeros((structure.n_pairs, count))]
        )

    def at(self, omega: float) -> EventFlow:
        """The same with another load frequency [rad/s]; the free motion is not computed again."""
        check_omega(omega)
        other = copy(self)
        other.omega, other._regimes = omega, {}
        return other

    def state(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """State of a displacement and a velocity (n_dofs,)."""
        inverse = np.linalg.inv(self._modes.shapes)
        return np.concatenate([self.scale * (inverse @ displacement), inverse @ velocity])

    def motion(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and velocity (n_dofs,) of a state."""
        modal, rate = np.split(state, 2)
        return self._modes.shapes @ modal / self.scale, self._modes.shapes @ rate

    def displacement_rows(self) -> np.ndarray:
        """Displacement of all dofs as a matrix on states: (n_dofs, 2n)."""
        return np.hstack([self._modes.shapes / self.scale, np.zeros_like(self._modes.shapes)])

    def advance(
        self,
        state: np.ndarray,
        start: float,
        duration: float,
        *,
        instants: np.ndarray | None = None,
        rows: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, Callable[[], np.ndarray], int]:
        """Flow from ``start`` for ``duration``: the state; ``rows @ z`` at ``instants`` (ascending,
        within the flow); what computes the monodromy matrix; and the number of events."""
        end = start + duration
        instants = np.zeros(0) if instants is None else instants
        rows = self.gap_rows if rows is None else rows
        output = np.empty((len(instants), len(rows)))
        closed = self._closed_at(state)
        now, pair, passed = start, -1, list[tuple[FreeMotion, float]]()
        while True:
            regime = self._regime(closed)
            free = regime.free
            if not (end - now) / free.step < MAX_STEPS:
                raise ConvergenceError("events: the highest modes are too fast for that long")
            weights = regime.weights(state, now)
            gaps = Gaps(regime, self.gap_rows, self.structure.clearance, closed, weights, now)
            pair, length = next_event(gaps, end - now, pair)
            chosen = (instants >= now) & ((instants < now + length) | (pair < 0))
            if np.any(chosen):
                output[chosen] = regime.sampled(rows, weights, now, instants[chosen])
            growth = np.exp(free.values * length)
            now += length
            state = regime.steady(now) + (free.vectors @ (growth * weights)).real
            passed.append((free, length))
            if pair < 0:
                return state, output, partial(_monodromy, passed), len(passed) - 1
            closed = closed.copy()
            closed[pair] = ~closed[pair]
            if len(passed) > MAX_EVENTS:
                raise ConvergenceError("events: the pairs open and close without end")

    def _closed_at(self, state: np.ndarray) -> np.ndarray:
        """Pairs in penetration, or about to be."""
        gap = self.gap_rows @ state - self.structure.clearance
        rate = self._modes.pairs.T @ state[len(state) // 2 :]
        rounding = 1e-14 * np.abs(self.gap_rows).max(initial=0.0) * np.abs(state).max()
        return np.where(np.abs(gap) <= rounding, rate > 0.0, gap > 0.0)

    def _regime(self, closed: np.ndarray) -> Regime:
        key = closed.tobytes()
        if key not in self._regimes:
            own = self.structure, self._modes
            if key not in self._free:
                self._free[key] = FreeMotion(*own, closed * self._stiffness, self.scale)
            self._regimes[key] = Regime(self._free[key], *own, self.omega, self.scale)
        return self._regimes[key]


def _monodromy(passed: list[tuple[FreeMotion, float]]) -> np.ndarray:
    """dz(T)/dz of free motions and how long each lasts, in the modes of each in turn."""
    (last, length), turns = passed[0], dict[tuple[int, int], np.ndarray]()
    product = np.exp(last.values * length)[:, None] * last.inverse
    for free, length in passed[1:]:
        key = id(last), id(free)
        if key not in turns:
            turns[key] = free.inverse @ last.vectors
        product = np.exp(free.values * length)[:, None] * (turns[key] @ product)
        last = free
    found: np.ndarray = (last.vectors @ product).real
    return found


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
