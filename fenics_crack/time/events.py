"""Exact motion with the penalty law: linear flow from one switching instant to the next.

While the set of closed pairs does not change, the modal coordinates z = (s q, q') of a small
structure obey a linear equation, solved in closed form,

    z(t) = z_p(t) + V exp(L (t - t0)) V^-1 (z0 - z_p(t0)),

z_p the steady response to the load with these pairs closed, V and L eigenvectors and eigenvalues
of the flow. The next instant at which a pair opens or closes is bracketed on a grid that resolves
the fastest mode, with the extremes between its points looked at, and polished by Brent's method.
No step size, no truncation: the error is that of the roots, about 1e-12.

The same flow gives periodic orbits by shooting: z(T) = z(0) by Newton's method with the monodromy
matrix, whose eigenvalues are the exact Floquet multipliers.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.optimize
from tqdm import tqdm

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError, InputError, check_count, check_omega
from fenics_crack.model.contact import ContactLaw, UnilateralPenalty, check_law
from fenics_crack.model.modal import AllModes, all_modes, flow_matrix, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import StopRequest
from fenics_crack.time.march import TimeHistory, initial_state

__all__ = ["EventFlow", "integrate_events"]

MOST_PAIRS = 12
MOST_EVENTS = 100_000
"""In one period of the load; more are a sign that pairs chatter without end."""
BLOCK = 64
MOST_STEPS = 3e5
"""Twelfths of the period of the highest mode in one flow, about half a second of work."""


@dataclass(frozen=True)
class _FreeMotion:
    """What does not depend on the load's frequency with one set of closed pairs."""

    values: np.ndarray
    vectors: np.ndarray
    inverse: np.ndarray
    static: np.ndarray
    step: float
    powers: np.ndarray
    """exp(L j step), j = 0 to BLOCK: (2n, BLOCK + 1)."""


@dataclass(frozen=True)
class _Regime:
    """Everything about the flow with one set of closed pairs."""

    values: np.ndarray
    vectors: np.ndarray
    inverse: np.ndarray
    mean: np.ndarray
    harmonic: np.ndarray
    step: float
    powers: np.ndarray


class EventFlow:
    """The exact flow of a small structure under its own load.

    States are (2n,) arrays (s q, q') of modal coordinates, s = :attr:`scale`.
    """

    def __init__(self, structure: Structure, omega: float, contact: ContactLaw) -> None:
        if not isinstance(contact, UnilateralPenalty):
            raise InputError("contact", contact, "a UnilateralPenalty, linear in contact")
        check_omega(omega)
        check_law(structure, contact)
        if not is_small(structure):
            raise InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
        if structure.n_pairs > MOST_PAIRS:
            raise InputError(
                "structure",
                f"{structure.n_pairs} pairs",
                f"one with at most {MOST_PAIRS}: n pairs have 2^n regimes, each taken apart into "
                "its modes; integrate_implicit takes many",
            )
        self.structure, self.omega = structure, omega
        self._modes: AllModes = all_modes(structure)
        self.scale = float(np.sqrt(np.abs(self._modes.squares).max())) or 1.0
        self._stiffness = np.broadcast_to(
            np.asarray(contact.stiffness, dtype=float), (structure.n_pairs,)
        )
        self._regimes: dict[bytes, _Regime] = {}
        self._free: dict[bytes, _FreeMotion] = {}
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
        monodromy: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, int]:
        """Flow from ``start`` for ``duration``.

        Returns the state; ``rows @ z`` at ``instants`` (ascending, within the flow); the monodromy
        matrix times the one given; and the number of events.
        """
        end = start + duration
        instants = np.zeros(0) if instants is None else instants
        rows = self.gap_rows if rows is None else rows
        output = np.empty((len(instants), len(rows)))
        closed = self._closed_at(state)
        now, events, pair = start, 0, -1
        while True:
            regime = self._regime(closed)
            if not (end - now) / regime.step < MOST_STEPS:
                raise ConvergenceError("events: the highest modes are too fast for that long")
            weights = regime.inverse @ (state - self._steady(regime, now))
            pair, length = self._next_event(regime, closed, weights, now, end - now, pair)
            chosen = (instants >= now) & ((instants < now + length) | (pair < 0))
            if np.any(chosen):
                times = instants[chosen]
                free = np.exp(np.outer(times - now, regime.values)) * weights
                steady = regime.mean + (np.exp(1j * self.omega * times)[:, None]
                                        * regime.harmonic).real  # fmt: skip
                output[chosen] = (free @ (rows @ regime.vectors).T).real + steady @ rows.T
            growth = np.exp(regime.values * length)
            state = self._steady(regime, now + length) + (regime.vectors @ (growth * weights)).real
            if monodromy is not None:
                monodromy = ((regime.vectors * growth) @ (regime.inverse @ monodromy)).real
            now += length
            if pair < 0:
                return state, output, monodromy, events
            closed = closed.copy()
            closed[pair] = ~closed[pair]
            events += 1
            if events > MOST_EVENTS:
                raise ConvergenceError("events: the pairs open and close without end")

    def _closed_at(self, state: np.ndarray) -> np.ndarray:
        """Pairs in penetration, or about to be."""
        gap = self.gap_rows @ state - self.structure.clearance
        count = len(state) // 2
        rate = self._modes.pairs.T @ state[count:]
        rounding = 1e-14 * np.abs(self.gap_rows).max(initial=0.0) * np.abs(state).max()
        touching = np.abs(gap) <= rounding
        return np.where(touching, rate > 0.0, gap > 0.0)

    def _regime(self, closed: np.ndarray) -> _Regime:
        key = closed.tobytes()
        if key not in self._regimes:
            modes, scale = self._modes, self.scale
            count = len(modes.squares)
            matrix = flow_matrix(modes, closed * self._stiffness, scale)
            if key not in self._free:
                self._free[key] = self._free_motion(matrix, closed)
            free = self._free[key]
            _, cosine, sine = self.structure.force @ modes.shapes
            response: np.ndarray = np.zeros(count, dtype=complex)
            if np.any(cosine) or np.any(sine):
                stiffness, damping = -scale * matrix[count:, :count], -matrix[count:, count:]
                impedance = stiffness - self.omega**2 * np.eye(count) + 1j * self.omega * damping
                response = np.linalg.solve(impedance, cosine - 1j * sine)
            self._regimes[key] = _Regime(
                free.values,
                free.vectors,
                free.inverse,
                np.concatenate([scale * free.static, np.zeros(count)]),
                np.concatenate([scale * response, 1j * self.omega * response]),
                free.step,
                free.powers,
            )
        return self._regimes[key]

    def _free_motion(self, matrix: np.ndarray, closed: np.ndarray) -> _FreeMotion:
        modes, count = self._modes, len(matrix) // 2
        values, vectors = np.linalg.eig(matrix)
        mean = self.structure.force[0] @ modes.shapes
        mean = mean + modes.pairs @ (closed * self._stiffness * self.structure.clearance)
        static = np.linalg.lstsq(-self.scale * matrix[count:, :count], mean, rcond=None)[0]
        fastest = np.abs(values.imag).max() or np.abs(values).max()
        step = 2.0 * np.pi / fastest / 12.0
        try:
            inverse = np.linalg.inv(vectors)
        except np.linalg.LinAlgError:
            raise ConvergenceError("events: a mode with exactly critical damping") from None
        return _FreeMotion(
            values,
            vectors.astype(complex),
            inverse.astype(complex),
            static,
            step,
            np.exp(np.outer(values, step * np.arange(BLOCK + 1))),
        )

    def _steady(self, regime: _Regime, time: float) -> np.ndarray:
        return regime.mean + (np.exp(1j * self.omega * time) * regime.harmonic).real

    def _next_event(
        self,
        regime: _Regime,
        closed: np.ndarray,
        weights: np.ndarray,
        start: float,
        duration: float,
        switched: int,
    ) -> tuple[int, float]:
        """The first pair that changes its state, and when; -1 and the duration if none does.

        ``switched`` is the pair that has changed its state at ``start``, or -1.
        """
        side = np.where(closed, -1.0, 1.0)  # a pair leaves its state where side * gap > 0
        free = (self.gap_rows @ regime.vectors) * weights
        rates = free * regime.values
        offset = self.gap_rows @ regime.mean - self.structure.clearance
        forced = self.gap_rows @ regime.harmonic
        rounding = 1e-14 * (np.abs(free).sum(axis=1) + np.abs(forced) + np.abs(offset))

        def gap(pair: int, t: float) -> float:
            wave = np.exp(regime.values * t) @ free[pair]
            steady = forced[pair] * np.exp(1j * self.omega * (start + t))
            return float(side[pair] * (wave.real + steady.real + offset[pair]))

        def slope(pair: int, t: float) -> float:
            wave = np.exp(regime.values * t) @ rates[pair]
            steady = 1j * self.omega * forced[pair] * np.exp(1j * self.omega * (start + t))
            return float(side[pair] * (wave.real + steady.real))

        grid = regime.step * np.arange(BLOCK + 1)
        reached = 0.0
        carried: np.ndarray = np.ones(len(weights), dtype=complex)
        while reached < duration:
            times = reached + grid
            turn = np.exp(1j * self.omega * (start + times))
            values = ((free * carried) @ regime.powers).real + (forced[:, None] * turn).real
            values = side[:, None] * (values + offset[:, None])
            slopes = ((rates * carried) @ regime.powers).real
            slopes = side[:, None] * (slopes + (1j * self.omega * forced[:, None] * turn).real)
            if reached == 0.0:  # all are in their states: what is outside is rounding
                values[:, 0] = np.minimum(values[:, 0], 0.0)
                if switched >= 0:
                    values[switched, 0] = -0.0
            first: tuple[float, int] | None = None
            crosses = (values[:, :-1] <= 0.0) & (values[:, 1:] > 0.0)
            # Both ends inside, but a summit between them may reach out.
            summit = (slopes[:, :-1] > 0.0) & (slopes[:, 1:] < 0.0) & ~crosses
            reach = values[:, :-1] + regime.step * slopes[:, :-1]
            for pair, cell in zip(*np.nonzero(crosses | (summit & (reach > 0.0))), strict=True):
                low, high = times[cell], times[cell + 1]
                if first is not None and low >= first[0]:
                    continue
                own_gap, own_slope = partial(gap, pair), partial(slope, pair)
                if not crosses[pair, cell]:
                    if not own_slope(low) > 0.0 > own_slope(high):
                        continue  # but for rounding
                    high = scipy.optimize.brentq(own_slope, low, high)
                    if own_gap(high) <= rounding[pair]:
                        continue
                if pair == switched and low == 0.0:
                    root = _return(own_gap, own_slope, high)
                else:
                    root = _root(own_gap, low, high)
                if root is not None and (first is None or root < first[0]):
                    first = (root, int(pair))
            if first is not None:
                return (first[1], first[0]) if first[0] < duration else (-1, duration)
            reached += BLOCK * regime.step
            carried = np.exp(regime.values * reached)
        return -1, duration


def _root(gap: Callable[[float], float], low: float, high: float) -> float:
    """Root of a gap that is inside at ``low`` and outside at ``high``."""
    if gap(low) >= 0.0:
        return low
    if gap(high) <= 0.0:  # but for rounding
        return high
    return float(scipy.optimize.brentq(gap, low, high, xtol=1e-18, rtol=1e-14))


def _return(
    gap: Callable[[float], float], slope: Callable[[float], float], high: float
) -> float | None:
    """When a pair that has switched at time 0 switches back before ``high``; None if it does not.

    It goes in first and comes out again, so the extreme lies between.
    """
    if slope(0.0) >= 0.0 or slope(high) <= 0.0:
        return None
    deepest = float(scipy.optimize.brentq(slope, 0.0, high))
    return _root(gap, deepest, high) if gap(deepest) < 0.0 < gap(high) else None


def integrate_events(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int = 256,
    initial: PeriodicSolution | tuple[np.ndarray, np.ndarray] | None = None,
    settle: float = 0.0,
    record_periods: int | None = None,
    progress: bool = False,
) -> TimeHistory:
    """March exactly from one switching instant to the next, under the penalty law.

    Parameters
    ----------
    structure : Structure
        At most 600 dofs; reduce a larger one first.
    omega : float
        Angular frequency of the load [rad/s].
    contact : UnilateralPenalty
        Law of all pairs.
    periods : int
        Load periods.
    steps_per_period : int
        Instants recorded in a period; they do not change the motion.
    initial : PeriodicSolution, (displacement, velocity) or None
        State at time 0; None: rest.
    settle : float
        Stop when the relative change of the gaps over a period is below this.
    record_periods : int, optional
        Keep only the last so many periods; default: all.
    progress : bool
        Show a progress bar.

    Raises
    ------
    InputError
        The structure is too large or has too many pairs, the law is another, or an argument cannot
        be used.
    ConvergenceError
        Pairs open and close without end.
    """
    for key, value in (("periods", periods), ("steps_per_period", steps_per_period)):
        check_count(key, value, 1)
    flow = EventFlow(structure, omega, contact)
    state = flow.state(*initial_state(structure, initial))
    period = 2.0 * np.pi / omega
    kept = periods if record_periods is None else min(record_periods, periods)
    rows = np.vstack([flow.gap_rows, flow.displacement_rows()])
    records: list[np.ndarray] = []
    settled, done = np.inf, 0
    started = clock.perf_counter()
    with StopRequest() as stop:
        for index in tqdm(range(periods), "events", unit="period", disable=not progress):
            instants = (index + np.arange(steps_per_period) / steps_per_period) * period
            state, record, _, _ = flow.advance(
                state, index * period, period, instants=instants, rows=rows
            )
            record[:, : structure.n_pairs] -= structure.clearance
            done = index + 1
            if records:
                now = record[:, : structure.n_pairs]
                size = np.linalg.norm(now)
                change = np.linalg.norm(now - records[-1][:, : structure.n_pairs])
                settled = float(change / size) if size > 0.0 else 0.0
            records = [*records[-kept + 1 :], record] if kept > 1 else [record]
            if settled < settle or stop.asked(structure.comm):
                break
    seconds = clock.perf_counter() - started
    whole = np.concatenate(records[-kept:])
    steps = np.arange(done * steps_per_period - len(whole), done * steps_per_period)
    return TimeHistory(
        time=steps * (period / steps_per_period),
        gap=whole[:, : structure.n_pairs],
        settled=settled,
        created_energy=0.0,
        periods=done,
        seconds=seconds,
        steps_per_period=steps_per_period,
        structure=structure,
        recorded=whole[:, structure.n_pairs :],
        recorded_dofs=np.arange(structure.n_dofs),
        final_state=flow.motion(state),
        contact_force=contact.force(whole[:, : structure.n_pairs]),
    )
