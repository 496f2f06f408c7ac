"""The exact flow under the penalty law: linear motion from one switching instant to the next.

While the set of closed pairs does not change, the motion is known in closed form (:mod:`regime`).
There is no step size and no truncation: the error is that of the switching instants.

The same flow gives periodic orbits by shooting: z(T) = z(0) by Newton's method with the monodromy
matrix, whose eigenvalues are the exact Floquet multipliers.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial

import numpy as np

from fenics_crack.errors import ConvergenceError, InputError, check_omega
from fenics_crack.kernel import Struct, doubles, ints, kernel, table
from fenics_crack.model.contact import ContactLaw, check_law, is_piecewise_linear
from fenics_crack.model.modal import AllModes, all_modes, is_small
from fenics_crack.model.reduced import INSTEAD, check_mass
from fenics_crack.model.regime import FreeMotion, Regime
from fenics_crack.model.structure import Structure

__all__ = ["KEPT", "LONGEST_SEARCH", "MAX_EVENTS", "MAX_PAIRS", "EventFlow"]

MAX_PAIRS = 12
MAX_EVENTS = 100_000
"""In one flow; more are a sign that pairs chatter without end."""
LONGEST_SEARCH = 3e5
"""Twelfths of the period of the highest mode in one flow."""
FEW = 4
"""Pairs up to which the weights of one set of closed pairs are turned into those of the next by one
matrix, which is kept for every two sets."""
KEPT = 256
"""Intervals between events that are kept at a time."""


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
        self._free: dict[int, FreeMotion] = {}
        count = len(self._modes.squares)
        self.gap_rows = np.hstack(
            [self._modes.pairs.T / self.scale, np.zeros((structure.n_pairs, count))]
        )
        self._prepare()

    def _prepare(self) -> None:
        """What depends on the load's frequency: regimes, by the bits of their closed pairs."""
        pairs, size = self.gap_rows.shape
        self._regimes: dict[int, Regime] = {}
        self.known = Struct(
            "exact_flow", pairs=pairs, size=size, omega=self.omega, known=table("regime", 2**pairs),
            rows=np.ascontiguousarray(self.gap_rows[:, : size // 2]),
            clearance=np.array(self.structure.clearance, dtype=float),
            room=np.empty(8 * size + 6 * pairs),
        )  # fmt: skip

    def at(self, omega: float) -> EventFlow:
        """The same with another load frequency [rad/s]; the free motion is not computed again."""
        check_omega(omega)
        other = copy(self)
        other.omega = omega
        other._prepare()
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
        instants = np.zeros(0) if instants is None else np.array(instants, dtype=float)
        state = np.array(state, dtype=float).reshape(self.gap_rows.shape[1])
        gaps = np.diff(instants)
        equal = len(gaps) > 1 and float(np.ptp(gaps)) <= 1e-9 * float(gaps[0])
        weights, sets = np.empty((len(instants), len(state))), np.empty(len(instants), np.intc)
        passed, lengths = np.empty(KEPT, np.intc), np.empty(KEPT)
        motion = Struct(
            "motion", now=start, end=start + duration, state=state,
            closed=kernel.closed_at(self.known.at, doubles(state)), switched=-1, most=KEPT,
            passed_sets=passed, lengths=lengths, count=len(instants), instants=instants,
            spacing=float(np.mean(gaps)) if equal else 0.0, weights=weights, sets=sets,
        ).at  # fmt: skip
        before: list[tuple[np.ndarray, np.ndarray]] = []
        while (code := kernel.follow_exactly(self.known.at, motion, LONGEST_SEARCH)) != kernel.DONE:
            if code == kernel.FAST:
                raise ConvergenceError("events: the highest modes are too fast for that long")
            if code == kernel.UNKNOWN:
                self.make(motion.closed)
                continue
            if motion.events > MAX_EVENTS:
                raise ConvergenceError("events: the pairs open and close without end")
            before.append((passed.copy(), lengths.copy()))
            motion.passed = 0
        before.append((passed[: motion.passed], lengths[: motion.passed]))
        output = self._output(rows, instants, weights, sets)
        return state, output, partial(self._monodromy, before), motion.events

    def _output(
        self, rows: np.ndarray | None, instants: np.ndarray, weights: np.ndarray, sets: np.ndarray
    ) -> np.ndarray:
        """``rows @ z`` from weights at instants in regimes."""
        rows = self.gap_rows if rows is None else rows
        output = np.empty((len(instants), len(rows)))
        turn = self.omega * instants
        waves = np.column_stack([np.ones_like(turn), np.cos(turn), np.sin(turn)])
        for closed in np.unique(sets):
            here = sets == closed
            regime = self._regimes[int(closed)]
            output[here] = regime.sampled(rows, weights[here], waves[here])
        return output

    def _monodromy(self, passed: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """dz(T)/dz of regimes passed, and how long each lasts."""
        size = self.gap_rows.shape[1]
        product, work = np.eye(size), np.empty(size * (size + 2))
        for sets, lengths in passed:
            kernel.derivative_of(
                self.known.at, len(sets), ints(sets), doubles(lengths), doubles(product),
                doubles(work),
            )  # fmt: skip
        return product

    def make(self, closed: int) -> None:
        """The regime of a set of closed pairs, by its bits."""
        if not 0 <= closed < 2 ** len(self._stiffness):
            raise ValueError(f"a set {closed} of {len(self._stiffness)} pairs")
        own = self.structure, self._modes
        if closed not in self._free:
            springs = (closed >> np.arange(len(self._stiffness)) & 1) * self._stiffness
            self._free[closed] = FreeMotion(*own, springs, self.scale)
        made = Regime(self._free[closed], *own, self.scale)
        kernel.respond_to_load(self.known.at, made.known.at)
        if not np.isfinite(made.steady).all():
            raise ConvergenceError("events: the load meets an undamped resonance")
        self._regimes[closed] = made
        for pair in range(len(self._stiffness) if len(self._stiffness) <= FEW else 0):
            if (other := self._regimes.get(closed ^ 1 << pair)) is not None:
                made.change_into(other, pair)
                other.change_into(made, pair)
        self.known.at.known[closed] = made.known.at
