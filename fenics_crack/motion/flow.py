"""The flow of a small structure with contact, exact from event to event.

In modal coordinates, with R_inf the residual flexibility (:mod:`fenics_crack.model.contact`) and
kappa the stiffness of the pairs,

    q'' + C q' + Lambda q + P lambda = f(t),      s = P^T q + l(t),
    0 <= lambda,   (R_inf + I/kappa) lambda - s >= 0,   complementary.

While the set A of closed pairs stays, lambda_A = S s_A, S = ((R_inf + I/kappa)_AA)^-1,
and the motion is linear. Its Taylor series gives the motion, the forces of the closed pairs and the
openings of the others, and where one of these falls through zero: an event, behind which another
set holds (``kernel/flow.c``). Nothing is truncated: the error is that of rounding. The forces are
continuous, so that the flow's derivative is the product of the exponentials of the sets passed.

Sources: Barrio, Applied Mathematics and Computation 163 (2005) 525 (Taylor series as integrator);
Khan and Barton, Systems & Control Letters 2015 (no end of events); Monjaraz-Tec, Gross and Krack,
Computers & Structures 267 (2022) 106810.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.threads import machine_memory
from fenics_crack.kernel import NULL, Struct, kernel, owned, pointer, shaped
from fenics_crack.model.contact import (
    KEPT,
    ContactLaw,
    check_law,
    friction_of,
    is_regular,
    is_unilateral,
    seen_by,
    springs_of,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import waves_of


@dataclass(frozen=True)
class Budget:
    """Budget of the integration of one motion.

    Attributes
    ----------
    pieces : int
        Of the Taylor series.
    intervals : int
        Between events.
    """

    pieces: int = 100_000
    intervals: int = 20_000


class BudgetError(ConvergenceError):
    """A motion has more pieces of the Taylor series than its budget."""


def flow_of(structure: Structure, contact: ContactLaw) -> ContactFlow | None:
    """The exact flow of a structure and a law; None where there is none: for a smooth law, a large
    structure, and rigid contact where the residual flexibility is singular."""
    return ContactFlow(structure, contact) if _refused(structure, contact) is None else None


def exact_flow(structure: Structure, contact: ContactLaw) -> ContactFlow:
    """The exact flow, where it must be there.

    Raises
    ------
    InputError
        There is none.
    """
    check_exact(structure, contact)
    return ContactFlow(structure, contact)


def check_exact(structure: Structure, contact: ContactLaw) -> None:
    """Raise InputError where a structure and a law have no flow."""
    if refused := _refused(structure, contact):
        raise refused


def _refused(structure: Structure, contact: ContactLaw) -> InputError | None:
    """Why a structure and a law have no flow; None where they have one."""
    check_law(structure, contact, rigid=True)
    if not is_unilateral(contact):
        return InputError("contact", contact, "UnilateralPenalty or UnilateralConstraint")
    if not is_small(structure):
        return InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
    softness = springs_of(contact, structure.n_pairs)
    if np.all(softness):
        return None
    static = all_modes(seen_by(contact, structure)).static_part()
    if not is_regular(static + np.diag(softness)):
        allowed = "one whose faces have no mass: reduce_structure(structure, method='massless')"
        return InputError("structure", repr(structure), allowed)
    return None


class Flow:
    """The flow of a small structure under its own load.

    States are (2 n_modes,) arrays (q, q') of modal coordinates, with friction (2 n_modes +
    n_pairs,): behind them where the pairs stick, or are. Contact rows are the pairs' normals, with
    friction behind them their tangents.

    Attributes
    ----------
    structure : Structure
    contact : ContactLaw
    clearance : (n_rows,) [m]
        g0 of the rows; of tangents zero.
    modes : AllModes
        Modes that move, and the rows as their pairs.
    count, size : int
        Number of modes, and numbers of a state.
    residual : (n_pairs, n_pairs) [m/N]
        R_inf.
    softness : (n_pairs,) [m/N]
        1 / kappa, zero where contact is rigid.
    compliance : (n_pairs, n_pairs) [m/N]
        R_inf + I/kappa.
    force : (2K+1, n_modes)
        f: mean, and cosine and sine of each order.
    gap : (2K+1, n_pairs) [m]
        l, likewise.
    """

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        self.structure, self.contact = structure, contact
        self.friction = friction_of(contact)
        seen = seen_by(contact, structure)
        self.clearance = seen.clearance
        self.modes = modes = all_modes(seen)
        self.count = len(modes.squares)
        self.size = 2 * self.count + (structure.n_pairs if self.friction else 0)
        self.residual = modes.static_part()
        self.softness = springs_of(contact, structure.n_pairs)
        self.compliance = self.residual + np.diag(self.softness)
        self.force = np.ascontiguousarray(structure.force @ modes.shapes)
        self.gap = np.zeros((len(self.force), len(self.softness)))
        if modes.static_loads is not None:
            self.gap += seen.apply_bt(structure.force @ modes.static_loads)
        self.gap[0] -= self.clearance

    def state(
        self, displacement: np.ndarray, velocity: np.ndarray, places: np.ndarray | None = None
    ) -> np.ndarray:
        """State of a displacement and a velocity (..., n_dofs); with friction of pairs that stick
        in places, by default where these leave them without contact forces."""
        inverse, count = self.modes.inverse.T, self.structure.n_pairs
        parts = [displacement @ inverse, velocity @ inverse]
        if self.friction:
            if places is None:
                places = parts[0] @ self.modes.pairs[:, count:] + self.gap[0, count:]
            parts.append(places)
        return np.concatenate(parts, axis=-1)

    def displacement(
        self,
        states: np.ndarray,
        force: np.ndarray,
        phase: np.ndarray,
        dofs: np.ndarray | slice = slice(None),
    ) -> np.ndarray:
        """Displacement of the structure's own dofs, or of some, in states and under contact forces
        at phases of the load: (n, n_dofs) [m]."""
        return self.displaced(states[:, : self.count], force, waves_of(self.force, phase), dofs)

    def displaced(
        self,
        modal: np.ndarray,
        force: np.ndarray,
        waves: np.ndarray,
        dofs: np.ndarray | slice = slice(None),
        rows: np.ndarray | None = None,
    ) -> np.ndarray:
        """The same of modal displacements, contact forces and the load's waves (n, 2K+1), or of
        the coefficients of all three; its products with rows (m, n_dofs), if they are given."""
        modes = self.modes

        def seen(motions: np.ndarray) -> np.ndarray:
            return motions[dofs] if rows is None else rows @ motions

        found: np.ndarray = modal @ seen(modes.shapes).T
        if modes.static_loads is not None and modes.static_pairs is not None:
            found += waves @ seen((self.structure.force @ modes.static_loads).T).T
            found -= force @ seen(modes.static_pairs).T
        return found


# --- exact ----------------------------------------------------------------------------------------


class ContactFlow(Flow):
    """The exact flow, at any frequency of the load."""

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        super().__init__(structure, contact)
        modes, pairs = self.modes, structure.n_pairs
        closed = np.linalg.solve(self.compliance, modes.pairs.T)
        stiffness = np.diag(modes.squares) + modes.pairs @ closed
        self.fastest = _fastest(float(np.linalg.eigvalsh(stiffness)[-1]), modes.damping)
        """Bound of the rates at which any set of closed pairs turns or decays [1/s]."""
        self.fastest_apart = _fastest(float(modes.squares.max()), modes.damping)
        """The same of the set without any."""
        coefficient = None
        if self.friction:
            coefficient = np.broadcast_to(self.friction.coefficient, pairs).astype(float)
        parts = Struct(
            "flow_parts", modes=self.count, pairs=pairs, friction=coefficient,
            coupled=modes.damping.ndim == 2, squares=doubles(modes.squares),
            damping=doubles(modes.damping),
            rows=doubles(modes.pairs.T), compliance=doubles(self.compliance), force=self.force,
            harmonics=len(self.force) // 2,
            gap=self.gap, fastest=self.fastest, apart=self.fastest_apart,
            most=int(KEPT * machine_memory()) // 8,
        )  # fmt: skip
        self.handle = owned(kernel.new_flow(parts.at), kernel.free_flow)
        """The kernel's own object."""
        self._intervals = 0

    @cached_property
    def critical_friction(self) -> float:
        """Least coefficient of friction with which contact has not one answer, det A(mu) = 0, found
        in 400 states of the pairs drawn at random; infinite without one.

        Rows of A are those of closed pairs' normals and stuck pairs' tangents, A = D_rows (E_0 +
        mu E_1): mu = -1 / a real negative eigenvalue of (D_rows E_0)^-1 D_rows E_1.
        """
        count, found = self.structure.n_pairs, [np.inf]
        for states in np.random.default_rng(1).integers(0, 4, (400, count)):
            closed, stuck = np.flatnonzero(states), np.flatnonzero(states == kernel.STICK)
            rows = np.concatenate([closed, count + stuck])
            part = self.compliance[rows]
            by_friction = np.zeros((len(rows), len(rows)))
            signs = 1.0 * (states == kernel.SLIP_UP) - (states == kernel.SLIP_DOWN)
            by_friction[:, : len(closed)] = part[:, count + closed] * signs[closed]
            values = np.linalg.eigvals(np.linalg.solve(part[:, rows], by_friction))
            real = values.real[(values.imag == 0.0) & (values.real < 0.0)]
            found.extend(-1.0 / real)
        return float(min(found))

    @cached_property
    def rest(self) -> np.ndarray:
        """State of rest under the load's mean alone, without its rigid-body part and, with
        friction, tangential forces: (size,)."""
        modes, count = self.modes, self.structure.n_pairs
        soft = np.zeros_like(modes.squares)
        np.divide(1.0, modes.squares, out=soft, where=modes.squares > 0.0)
        pairs, compliance = modes.pairs[:, :count], self.compliance[:, :count]
        moved, held = soft[:, None] * pairs, soft * self.force[0]
        gap, force = held @ pairs + self.gap[0, :count], np.zeros(count)  # while all are open
        if np.any(gap > 0.0):
            from scipy.optimize import nnls  # takes a while

            # D lambda - gap and lambda are >= 0, one of both 0: min |L^T lambda - L^-1 gap|.
            root = np.linalg.cholesky(compliance[:count] + pairs.T @ moved)
            force = nnls(root.T, np.linalg.solve(root, gap))[0]
            held = held - moved @ force
        parts = [held, np.zeros_like(held)]
        if self.friction:
            parts.append((held @ modes.pairs + self.gap[0] - compliance @ force)[count:])
        return np.concatenate(parts)

    def pieces(self, duration: float) -> float:
        """Return the number of Taylor pieces of a motion so long [s] without events."""
        return float(self.fastest * duration / kernel.FLOW_REACH)

    def weights(self, base_omega: float) -> np.ndarray:
        """Return the weights that make the norm of a state that of its energy, (2 n_modes,); modes
        slower than a frequency [rad/s] count as if they had it."""
        found = np.ones(self.size)
        np.sqrt(np.maximum(self.modes.squares, base_omega**2), out=found[: self.count])
        if self.friction:  # of springs as stiff as a pair that sticks alone
            own = np.diag(self.compliance)[self.structure.n_pairs :]
            found[2 * self.count :] = 1.0 / np.sqrt(own)
        return found

    def amplitude_weights(self, base_omega: float) -> np.ndarray:
        """Return the same weights over the modes' rates: 1 of displacements, (size,)."""
        weights = self.weights(base_omega)
        rates = weights[: self.count]
        places = np.full(self.size - 2 * self.count, rates[0])
        return weights / np.concatenate([rates, rates, places])

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
        end_state = np.array(state, dtype=float).reshape(self.size)
        instants = np.zeros(0) if instants is None else doubles(instants)
        count, rows, pairs = len(instants), len(self.softness), self.structure.n_pairs
        states = np.empty((count, 2 * self.count))
        answers = np.empty((count, 2 * rows if self.friction else rows))
        closed = np.empty((count, pairs), dtype=np.int8)
        given, record = self._motion(
            budget, omega=omega, now=start, end=start + duration, state=end_state,
            count=count, instants=instants, states=states, answers=answers, closed=closed,
        )  # fmt: skip
        _check(kernel.flow_advance(self.handle, given.at), given.at.events)
        track = Track(self, omega, start, **record(given.at.passed))
        samples = Samples(self, omega, instants, states, answers, closed)
        return Motion(end_state, int(given.at.events), int(given.at.pieces), track, samples)

    def steps(
        self, states: np.ndarray, omega: float, period: float
    ) -> tuple[np.ndarray, Track, np.ndarray]:
        """The motion over equal parts of a period from time zero, from states (n, 2 n_modes) at
        their starts: the states at their ends, the track of all parts, and how many of its
        intervals have been passed at their ends, (n,).

        Raises as :meth:`advance`.
        """
        states = doubles(states)
        moved, ends = np.empty_like(states), np.empty(len(states), dtype=np.intc)
        given, record = self._motion(None, omega=omega)
        outcome = kernel.flow_wave(
            self.handle, given.at, len(states), period, pointer(states), pointer(moved),
            pointer(ends),
        )  # fmt: skip
        _check(outcome, given.at.events)
        return moved, Track(self, omega, 0.0, **record(given.at.passed)), ends

    def _motion(
        self, budget: Budget | None, **members: Any
    ) -> tuple[Struct, Callable[[int], dict[str, np.ndarray]]]:
        """Return the kernel's motion, and what copies the arrays of its track."""
        budget = budget or Budget()
        if self._intervals < budget.intervals:
            self._intervals = most = budget.intervals
            sets = np.empty((most, self.structure.n_pairs), np.int8)
            self._record = {"sets": sets, "lengths": np.empty(most)}
            if self.friction:
                ends = {"causes": np.intc, "firsts": np.int8, "ratios": float}
                self._record |= {name: np.empty(most, kind) for name, kind in ends.items()}
            self._empty = Struct("flow_motion", **self._record)
        arrays = self._record
        given = self._empty.but(most_pieces=budget.pieces, most=budget.intervals, **members)
        return given, lambda passed: {name: one[:passed].copy() for name, one in arrays.items()}


@dataclass(frozen=True)
class Track:
    """Sets of closed pairs that a motion passed, and for how long.

    Attributes
    ----------
    flow : ContactFlow
    omega, start : float
        Of the load [rad/s]; when it begins [s].
    sets : (n, n_pairs) int
        States of the pairs: 0 open, 1 closed, with friction 1 stuck, 2 and 3 slipping.
    lengths : (n,) [s]
    causes, firsts, ratios : (n,)
        Of friction, how intervals end (``kernel/flow.h``).
    """

    flow: ContactFlow
    omega: float
    start: float
    sets: np.ndarray
    lengths: np.ndarray
    causes: np.ndarray | None = None
    firsts: np.ndarray | None = None
    ratios: np.ndarray | None = None

    def share(self, which: np.ndarray) -> float:
        """Part of the motion in which a pair is in some states, (n, n_pairs) bool; mean over the
        pairs, of which there are some."""
        return float(self.lengths @ which.mean(axis=1) / self.lengths.sum())

    @cached_property
    def _known(self) -> Struct:
        members = {name: value for name, value in vars(self).items() if name != "flow"}
        return Struct("flow_track", intervals=len(self.lengths), **members)

    @cached_property
    def tangent(self) -> np.ndarray:
        """dz(end) / dz(start): (2 n_modes, 2 n_modes)."""
        found = np.empty((self.flow.size, self.flow.size))
        outcome = kernel.flow_tangent(self.flow.handle, self._known.at, pointer(found))
        _check(outcome, len(self.lengths) - 1)
        return found

    def by_structure(self, start: np.ndarray, softness: np.ndarray) -> np.ndarray:
        """dz(end) by a parameter, from dz(start) = 0, of the motion from a state, given the
        derivative of the softness by it, (n_pairs,)."""
        found, rates = np.empty(self.flow.size), shaped(softness, *self.flow.softness.shape)
        outcome = kernel.flow_by_structure(
            self.flow.handle, self._known.at, pointer(doubles(start)), NULL, pointer(rates),
            pointer(found),
        )  # fmt: skip
        _check(outcome, len(self.lengths) - 1)
        return found

    def __matmul__(self, change: np.ndarray) -> np.ndarray:
        """dz(end) of a change dz(start), without the matrix: (2 n_modes,)."""
        end = np.array([len(self.lengths)], dtype=np.intc)
        return np.asarray(self.carried(change, np.zeros((1, self.flow.size)), end)[-1])

    def carried(self, start: np.ndarray, excess: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Changes d of the state at the starts of parts of the track and at its end, (n + 1,
        2 n_modes), d_{i+1} = M_i d_i + excess_i, from d_0; ``ends``: intervals passed at the ends
        of the parts."""
        changes = np.empty((len(ends) + 1, self.flow.size))
        changes[0] = start
        outcome = kernel.flow_carry(
            self.flow.handle, self._known.at, len(ends), pointer(ends), pointer(doubles(excess)),
            pointer(changes),
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
        q and q'.
    contact : (n, n_pairs) int
        States of the pairs, as in :class:`Track`.
    """

    flow: ContactFlow
    omega: float
    time: np.ndarray
    states: np.ndarray
    answers: np.ndarray
    """(n, n_pairs): forces [N] of closed pairs, openings [m] of the others; with friction (n, 4
    n_pairs): the forces on all rows, and the gaps without those of springs."""
    contact: np.ndarray

    @property
    def closed(self) -> np.ndarray:
        """Closed pairs: (n, n_pairs) bool."""
        return self.contact > 0

    @cached_property
    def forces(self) -> np.ndarray:
        """Contact forces on all rows: (n, n_rows) [N]."""
        if self.flow.friction:
            return self.answers[:, : len(self.flow.softness)]
        return np.where(self.closed, np.maximum(self.answers, 0.0), 0.0)

    @cached_property
    def gaps(self) -> np.ndarray:
        """Gaps of all rows: (n, n_rows) [m]."""
        moved = self.forces * self.flow.softness
        if self.flow.friction:
            return self.answers[:, len(self.flow.softness) :] + moved
        return np.where(self.closed, moved, -self.answers)

    @property
    def places(self) -> np.ndarray:
        """With friction h, where pairs stick or would: (n, n_pairs) [m]; else (n, 0)."""
        return self.answers[:, len(self.flow.softness) + self.flow.structure.n_pairs :]

    @property
    def whole_states(self) -> np.ndarray:
        """States of the flow: (n, size)."""
        return np.hstack([self.states, self.places])

    @property
    def force(self) -> np.ndarray:
        """Normal contact force: (n, n_pairs) [N]."""
        return self.forces[:, : self.flow.structure.n_pairs]

    @property
    def gap(self) -> np.ndarray:
        """g, positive where a pair penetrates: (n, n_pairs) [m]."""
        return self.gaps[:, : self.flow.structure.n_pairs]

    @property
    def displacement(self) -> np.ndarray:
        """Displacement of the structure's own dofs: (n, n_dofs) [m]."""
        return self.flow.displacement(self.states, self.forces, self.omega * self.time)

    def products(self, rows: np.ndarray) -> np.ndarray:
        """Return products of rows (m, n_dofs) with the displacement: (n, m)."""
        flow, modal = self.flow, self.states[:, : self.flow.count]
        waves = waves_of(flow.force, self.omega * self.time)
        return flow.displaced(modal, self.forces, waves, rows=rows)


class Motion(NamedTuple):
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
        kernel.FLOW_LOST: "the motion is not finite, or its contact forces have not one solution",
    }
    error = BudgetError if outcome == kernel.FLOW_PIECES else ConvergenceError
    raise error(f"events: {words[outcome]} (after {events} events)")


def doubles(array: np.ndarray) -> np.ndarray:
    """An array as the kernel reads it."""
    return np.ascontiguousarray(array, dtype=float)
