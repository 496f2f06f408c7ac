"""The exact flow of a small structure with contact, by Taylor series from event to event.

In modal coordinates, with R_inf what answers at once (:mod:`fenics_crack.model.contact`) and kappa
the stiffness of the pairs,

    q'' + C q' + Lambda q + P lambda = f(t),      s = P^T q + l(t),
    0 <= lambda,   (R_inf + I/kappa) lambda - s >= 0,   complementary.

While the set A of closed pairs stays, lambda_A = S s_A, S = ((R_inf + I/kappa)_AA)^-1, and the
motion is linear. Its Taylor series gives the motion, the forces of the closed pairs and the
openings of the others, and where one of these falls through zero: an event, behind which another
set holds (``kernel/flow.c``). Nothing is truncated: the error is that of rounding. The forces are
continuous, so that the flow's derivative is the product of the exponentials of the sets passed.

Sources: Barrio, Applied Mathematics and Computation 163 (2005) 525 (Taylor series as integrator);
Khan and Barton, Systems & Control Letters 2015 (no end of events).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.kernel import Struct, doubles, ints, kernel, owned
from fenics_crack.model.contact import (
    KEPT,
    ContactLaw,
    check_law,
    is_regular,
    is_rigid,
    is_unilateral,
)
from fenics_crack.model.modal import AllModes, all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import waves

__all__ = ["Budget", "ContactFlow", "Motion", "Samples", "exact_flow", "flow_of"]


@dataclass(frozen=True)
class Budget:
    """What one motion may take before it is given up.

    Attributes
    ----------
    pieces : int
        Of the Taylor series.
    intervals : int
        Between events.
    """

    pieces: int = 100_000
    intervals: int = 20_000


def flow_of(structure: Structure, contact: ContactLaw) -> ContactFlow | None:
    """The exact flow of a structure and a law; None where there is none: for a smooth law, a large
    structure, and rigid contact where what answers at once does not separate the pairs."""
    check_law(structure, contact, rigid=True)
    if not is_unilateral(contact) or not is_small(structure):
        return None
    modes, pairs = all_modes(structure), structure.n_pairs
    residual = np.zeros((pairs, pairs)) if modes.residual is None else modes.residual
    if is_rigid(contact) and not is_regular(residual):
        return None
    return ContactFlow(structure, contact, modes, residual)


def exact_flow(structure: Structure, contact: ContactLaw) -> ContactFlow:
    """The exact flow, where it must be there.

    Raises
    ------
    InputError
        There is none.
    """
    flow = flow_of(structure, contact)
    if flow is not None:
        return flow
    if not is_unilateral(contact):
        raise InputError("contact", contact, "UnilateralPenalty or UnilateralConstraint")
    if not is_small(structure):
        raise InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
    allowed = "one whose lips have no mass: reduce_structure(structure, method='massless')"
    raise InputError("structure", repr(structure), allowed)


class ContactFlow:
    """The exact flow of a small structure under its own load, at any frequency of it.

    States are (2 n_modes,) arrays (q, q') of modal coordinates.

    Attributes
    ----------
    structure : Structure
    contact : ContactLaw
    modes : AllModes
    residual : (n_pairs, n_pairs) [m/N]
        R_inf.
    softness : (n_pairs,) [m/N]
        1 / kappa, zero where contact is rigid.
    """

    def __init__(
        self, structure: Structure, contact: ContactLaw, modes: AllModes, residual: np.ndarray
    ) -> None:
        self.structure, self.contact, self.modes, self.residual = (
            structure, contact, modes, residual,
        )  # fmt: skip
        count, pairs = modes.pairs.shape
        self.softness = np.ones(pairs) / np.asarray(contact.stiffness, dtype=float)
        compliance = residual + np.diag(self.softness)
        stiffness = np.diag(modes.squares) + modes.pairs @ np.linalg.solve(
            compliance, modes.pairs.T
        )
        self.fastest = _fastest(float(np.linalg.eigvalsh(stiffness)[-1]), modes.damping)
        """No set of closed pairs turns or decays faster [1/s]."""
        self.force = np.ascontiguousarray(structure.force @ modes.shapes)
        """f: mean, cosine and sine, (3, n_modes)."""
        self.gap = np.zeros((3, pairs))
        """l, likewise: (3, n_pairs) [m]."""
        if modes.static_loads is not None:
            self.gap += structure.apply_bt(structure.force @ modes.static_loads)
        self.gap[0] -= structure.clearance
        parts = Struct(
            "flow_parts", modes=count, pairs=pairs, coupled=modes.damping.ndim == 2,
            squares=_doubles(modes.squares), damping=_doubles(modes.damping),
            rows=_doubles(modes.pairs.T), compliance=_doubles(compliance), force=self.force,
            gap=self.gap, fastest=self.fastest, most=KEPT // 8,
        )  # fmt: skip
        self.handle = owned(kernel.new_flow(parts.at), kernel.free_flow)
        """The kernel's own object."""
        self._sets, self._lengths = np.empty((0, pairs), dtype=bool), np.empty(0)

    @property
    def size(self) -> int:
        """Numbers of a state."""
        return 2 * len(self.modes.squares)

    def pieces(self, duration: float) -> float:
        """Of the Taylor series of a motion so long [s] without events."""
        return float(self.fastest * duration / kernel.FLOW_REACH)

    def state(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """State of a displacement and a velocity (..., n_dofs)."""
        inverse = self.modes.inverse.T
        return np.concatenate([displacement @ inverse, velocity @ inverse], axis=-1)

    def weights(self, base_omega: float) -> np.ndarray:
        """What makes the norm of a state that of its energy, (2 n_modes,); modes slower than a
        frequency [rad/s] count as if they had it."""
        rates = np.sqrt(np.maximum(self.modes.squares, base_omega**2))
        return np.concatenate([rates, np.ones_like(rates)])

    def advance(
        self,
        state: np.ndarray,
        omega: float,
        duration: float,
        *,
        start: float = 0.0,
        instants: np.ndarray | None = None,
        budget: Budget | None = None,
    ) -> Motion:
        """The motion from a state at the time ``start`` under the load of a frequency, sampled at
        ``instants`` (ascending, within it).

        Raises
        ------
        ConvergenceError
            It takes more than the budget allows, or is not finite.
        """
        pairs = len(self.softness)
        end_state = np.array(state, dtype=float).reshape(self.size)
        instants = np.zeros(0) if instants is None else _doubles(instants)
        states, answers = np.empty((len(instants), self.size)), np.empty((len(instants), pairs))
        closed = np.empty((len(instants), pairs), dtype=bool)
        given, sets, lengths = self._motion(
            budget, omega=omega, now=start, end=start + duration, state=end_state,
            count=len(instants), instants=instants, states=states, answers=answers, closed=closed,
        )  # fmt: skip
        _check(kernel.flow_advance(self.handle, given.at), given.at.events)
        passed = given.at.passed
        track = Track(self, omega, start, sets[:passed].copy(), lengths[:passed].copy())
        samples = Samples(self, omega, instants, states, answers, closed)
        return Motion(end_state, int(given.at.events), int(given.at.pieces), track, samples)

    def steps(
        self, states: np.ndarray, omega: float, period: float, budget: Budget | None = None
    ) -> tuple[np.ndarray, Track, np.ndarray]:
        """The motion over equal parts of a period from time zero, from states (n, 2 n_modes) at
        their starts: the states at their ends, the track of all parts, and how many of its
        intervals have been passed at their ends, (n,).

        Raises as :meth:`advance`.
        """
        states = _doubles(states)
        moved, ends = np.empty_like(states), np.empty(len(states), dtype=np.intc)
        given, sets, lengths = self._motion(budget, omega=omega)
        outcome = kernel.flow_wave(
            self.handle, given.at, len(states), period, doubles(states), doubles(moved), ints(ends)
        )
        _check(outcome, given.at.events)
        passed = given.at.passed
        return moved, Track(self, omega, 0.0, sets[:passed].copy(), lengths[:passed].copy()), ends

    def _motion(
        self, budget: Budget | None, **members: Any
    ) -> tuple[Struct, np.ndarray, np.ndarray]:
        """What the kernel moves, and its room for a track."""
        budget = budget or Budget()
        if len(self._lengths) < budget.intervals:
            self._sets = np.empty((budget.intervals, len(self.softness)), dtype=bool)
            self._lengths = np.empty(budget.intervals)
        given = Struct(
            "flow_motion", most_pieces=budget.pieces, most=budget.intervals, sets=self._sets,
            lengths=self._lengths, **members,
        )  # fmt: skip
        return given, self._sets, self._lengths


@dataclass(frozen=True)
class Track:
    """Sets of closed pairs that a motion passed, and for how long.

    Attributes
    ----------
    flow : ContactFlow
    omega, start : float
        Of the load [rad/s]; when it begins [s].
    sets : (n, n_pairs) bool
    lengths : (n,) [s]
    """

    flow: ContactFlow
    omega: float
    start: float
    sets: np.ndarray
    lengths: np.ndarray

    @cached_property
    def _known(self) -> Struct:
        return Struct(
            "flow_track", omega=self.omega, start=self.start, intervals=len(self.lengths),
            sets=self.sets, lengths=self.lengths,
        )  # fmt: skip

    @cached_property
    def tangent(self) -> np.ndarray:
        """dz(end) / dz(start): (2 n_modes, 2 n_modes)."""
        found = np.empty((self.flow.size, self.flow.size))
        outcome = kernel.flow_tangent(self.flow.handle, self._known.at, doubles(found))
        _check(outcome, len(self.lengths) - 1)
        return found

    def __matmul__(self, change: np.ndarray) -> np.ndarray:
        """dz(end) of a change dz(start), without the matrix: (2 n_modes,)."""
        end = np.array([len(self.lengths)], dtype=np.intc)
        found: np.ndarray = self.carried(change, np.zeros((1, self.flow.size)), end)[-1]
        return found

    def carried(self, start: np.ndarray, excess: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Changes d of the state at the starts of parts of the track and at its end, (n + 1,
        2 n_modes), d_{i+1} = M_i d_i + excess_i, from d_0; ``ends``: intervals passed at the ends
        of the parts."""
        changes = np.empty((len(ends) + 1, self.flow.size))
        changes[0] = start
        outcome = kernel.flow_carry(
            self.flow.handle, self._known.at, len(ends), ints(ends), doubles(_doubles(excess)),
            doubles(changes),
        )  # fmt: skip
        _check(outcome, len(self.lengths) - 1)
        return changes


@dataclass(frozen=True)
class Samples:
    """A motion at instants.

    Attributes
    ----------
    time : (n,) [s]
    states : (n, 2 n_modes)
    closed : (n, n_pairs) bool
    """

    flow: ContactFlow
    omega: float
    time: np.ndarray
    states: np.ndarray
    answers: np.ndarray
    """(n, n_pairs): forces [N] of closed pairs, openings [m] of the others."""
    closed: np.ndarray

    @property
    def force(self) -> np.ndarray:
        """Contact force: (n, n_pairs) [N]."""
        return np.where(self.closed, np.maximum(self.answers, 0.0), 0.0)

    @property
    def gap(self) -> np.ndarray:
        """g, positive where a pair penetrates: (n, n_pairs) [m]."""
        return np.where(self.closed, self.force * self.flow.softness, -self.answers)

    @property
    def displacement(self) -> np.ndarray:
        """Displacement of the structure's own dofs: (n, n_dofs) [m]."""
        modes, structure = self.flow.modes, self.flow.structure
        found: np.ndarray = self.states[:, : len(modes.squares)] @ modes.shapes.T
        if modes.static_loads is not None and modes.static_pairs is not None:
            found += waves(self.omega * self.time) @ (structure.force @ modes.static_loads)
            found -= self.force @ modes.static_pairs.T
        return found


@dataclass(frozen=True)
class Motion:
    """A motion that has been followed.

    Attributes
    ----------
    state : (2 n_modes,)
        At its end.
    events, pieces : int
        Pairs that opened or closed; pieces of the Taylor series.
    track : Track
    samples : Samples
    """

    state: np.ndarray
    events: int
    pieces: int
    track: Track
    samples: Samples


def _fastest(square: float, damping: np.ndarray) -> float:
    """At least the size of each root s of s^2 + c s + k = 0 where k <= square and c is a Rayleigh
    quotient of the damping [1/s]."""
    drag = float(np.linalg.norm(damping, 2 if damping.ndim == 2 else np.inf))
    if damping.ndim == 2 and not np.allclose(damping, damping.T):  # c is complex
        return 0.5 * (drag + float(np.sqrt(drag**2 + 4.0 * max(square, 0.0))))
    return max(float(np.sqrt(max(square, 0.0))), drag)


def _check(outcome: int, events: int) -> None:
    if outcome == kernel.FLOW_DONE:
        return
    if outcome == kernel.FLOW_MEMORY:
        raise MemoryError("exact flow")
    words = {
        kernel.FLOW_PIECES: "the highest modes are too fast for that long",
        kernel.FLOW_INTERVALS: "the pairs open and close without end",
        kernel.FLOW_LOST: "the motion is not finite",
    }
    raise ConvergenceError(f"events: {words[outcome]} (after {events} events)")


def _doubles(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=float)
