"""The campaign's own judge: motion and orbits, exact within each set of closed pairs.

Of the package it takes data alone: the matrices, the pairs, the load. With mass-normalised modes,
P = Phi^T B, R_inf what answers forces on the pairs at once, kappa the contact's stiffness and
l(t) = B^T G f - g0, the motion while a set A of pairs is closed is

    q'' + C q' + (Lambda + P_A S_A P_A^T) q = Phi^T f(t) - P_A S_A l_A(t),
    s = P^T q + l(t),      lambda_A = S_A s_A,      S_A = (R_inf + diag 1/kappa)_AA^-1,

in z = (sigma q, q') a steady part, known from one linear system, and sum_j v_j exp(mu_j t) with the
eigenvectors of that set's own flow matrix (LAPACK). R_inf = 0 with finite kappa is pairs with mass.
A set lasts until a contact force changes its sign or an open pair closes: looked for on samples, 25
in a period of the fastest motion of the set, and between them where a slope changes its sign; found
by Brent's method. What is closed then follows from the complementarity problem a moment later,

    0 <= lambda,      (R_inf + diag 1/kappa) lambda - s >= 0,      complementary,

the least squares problem with bounds of its Cholesky factor (Lawson and Hanson). Forces do not
jump, so the tangent of the flow is the product of exponentials. An orbit, z(T) = z(0), is found by
Newton's method with steps that are halved until the simplified next one is shorter.

Smooth laws of pairs with mass are followed by SciPy's integrator of order 8 (DOP853), the
variational equation beside the motion (:class:`SmoothFlow`). Of a whole structure the lowest modes
move and the others answer at once; of rigid pairs with mass a penalty stands for the stop: both are
as near to the truth as their errors are to be judged (:func:`campaign_cases.draw`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
import scipy.optimize
from scipy.integrate import solve_ivp

import fenics_crack as fc

__all__ = ["NoOrbit", "Orbit", "ReferenceFlow", "SmoothFlow", "System", "predicted"]

FINE = 0.25
"""Between samples, over the largest eigenvalue of a set."""
BLOCK = 64
"""Samples that are taken at a time."""
MOMENT = 1e-7
"""Of a sample's length, after which the new set is asked for."""
MOST_EVENTS, MOST_SETS = 20_000, 2_000
"""In one flow; kept."""
FLOWS, SHORTEST, CLOSED, SURE = 60, 1 / 256, 1e-10, 1e-8
"""Of one search for an orbit: flows, shortest step, and what may be left before the last step."""
INSTANTS = 512
"""Of the gap over a period."""
BASIS = 1e-7
"""By how much V V^-1 may differ from I."""
WHOLE, MOVING = 600, 100
"""Dofs of a structure from which on not all modes move; the lowest ones that do then."""
FINELY = 1e-11
"""How motions under smooth laws are integrated, relative to their size."""


class NoOrbit(Exception):
    """No orbit, or no motion that can be followed."""


# --- data -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class System:
    """A structure in its modes, with mass at its lips or without.

    Attributes
    ----------
    squares, damping, pairs, force : (m,), (m, m), (m, p), (3, m)
        Lambda, Phi^T C Phi, P, and the load on the modes: mean, cosine, sine.
    residual, springs, lift : (p, p), (p,), (3, p)
        R_inf, 1/kappa, and l(t) with the clearance in its mean.
    rows : (m, n_dofs)
        Phi^T M: modal coordinates of displacements.
    """

    squares: np.ndarray
    damping: np.ndarray
    pairs: np.ndarray
    force: np.ndarray
    residual: np.ndarray
    springs: np.ndarray
    lift: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, structure: fc.Structure, law: Any) -> System:
        """The data of a structure and of a law that is rigid or linear while closed."""
        gap = structure.gap.toarray()
        springs = np.broadcast_to(1.0 / np.asarray(law.stiffness, float), gap.shape[1])
        if isinstance(structure, fc.MasslessStructure):
            count = structure.n_modes
            static = structure.flexibility @ gap[count:]
            rate = structure.damping_multiplier * structure.modal_damping
            squares, damping = structure.omega**2, np.diag(rate) if rate.ndim == 1 else rate
            rows, force = np.eye(count, structure.n_dofs), structure.force[:, :count]
            pairs, residual = gap[:count], gap[count:].T @ static
            lift = structure.force[:, count:] @ static
        else:
            mass, stiffness = dense(structure.mass), dense(structure.stiffness)
            squares, shapes = scipy.linalg.eigh(stiffness, mass)
            rows, pairs, force = (mass @ shapes).T, shapes.T @ gap, structure.force @ shapes
            damping = _modal_damping(structure.damping, squares, shapes)
            moving_modes = slice(MOVING if len(squares) > WHOLE else None)
            still_modes = slice(len(squares[moving_modes]), None)
            static = pairs[still_modes] / squares[still_modes, None]
            residual, lift = pairs[still_modes].T @ static, force[:, still_modes] @ static
            squares, damping = squares[moving_modes], damping[moving_modes, moving_modes]
            rows, pairs, force = rows[moving_modes], pairs[moving_modes], force[:, moving_modes]
        lift[0] -= structure.clearance
        if np.any(np.diag(residual) + springs <= 0.0):
            raise NoOrbit("rigid contact of a pair with mass")
        return cls(squares, damping, pairs, force, residual, springs, lift, rows)


def dense(matrix: Any) -> np.ndarray:
    """A PETSc matrix on one rank."""
    return np.asarray(matrix.getValues(range(matrix.size[0]), range(matrix.size[1])))


def _modal_damping(rule: Any, squares: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Phi^T C Phi."""
    if rule is None:
        return np.zeros((len(squares),) * 2)
    if isinstance(rule, fc.RayleighDamping):
        return np.diag(rule.mass + rule.stiffness * squares)
    if isinstance(rule, fc.ModalDamping):
        ratio, count = np.asarray(rule.ratio), rule.modes or len(squares)
        rate = np.zeros(len(squares))
        rate[:count] = 2.0 * ratio * np.sqrt(np.maximum(squares[:count], 0.0))
        return np.diag(rate)
    return shapes.T @ dense(rule) @ shapes


# --- one set of closed pairs ----------------------------------------------------------------------


class ClosedSet:
    """Motion while a set of pairs is closed, and what each pair says of it: v_j, in metres, is the
    gap of an open pair, and less the force of a closed one times its compliance; v <= 0 while the
    set is right."""

    def __init__(self, system: System, closed: np.ndarray, scale: float) -> None:
        self.system, self.scale, self.closed = system, scale, closed
        count, pairs = system.pairs.shape
        self.forces = np.zeros((pairs, pairs))
        compliance = system.residual + np.diag(system.springs)
        closed_block = np.ix_(closed, closed)
        self.forces[closed_block] = np.linalg.inv(compliance[closed_block])
        self.gaps = np.eye(pairs) - system.residual @ self.forces
        signs = -np.diag(compliance)[:, None] * self.forces
        self.signs = np.where(closed[:, None], signs, self.gaps)
        self.stiffness = np.diag(system.squares)
        self.stiffness += system.pairs @ self.forces @ system.pairs.T
        matrix = np.zeros((2 * count, 2 * count))
        matrix[:count, count:] = scale * np.eye(count)
        matrix[count:, :count] = -self.stiffness / scale
        matrix[count:, count:] = -system.damping
        values, vectors = np.linalg.eig(matrix)
        inverse = np.linalg.inv(vectors)
        if np.abs(vectors @ inverse - np.eye(2 * count)).max() > BASIS:
            raise NoOrbit("a set without a basis of eigenvectors")
        half = values.imag >= 0.0  # the others are their conjugates
        self.values, self.inverse = values[half], inverse[half]
        self.vectors = vectors[:, half] * np.where(self.values.imag > 0.0, 2.0, 1.0)
        self.rows = self.signs @ system.pairs.T / scale @ self.vectors[:count]
        self.step = FINE / max(float(np.abs(values).max()), 1e-300)
        self._steady: dict[float, np.ndarray] = {}

    @cached_property
    def powers(self) -> np.ndarray:
        """exp(mu h k) of a block of samples: (BLOCK + 1, n)."""
        return np.exp(np.outer(self.step * np.arange(BLOCK + 1), self.values))

    def steady(self, omega: float) -> np.ndarray:
        """z of the steady motion, mean, cosine and sine: (3, 2m)."""
        if omega not in self._steady:
            system = self.system
            drive = system.force - system.lift @ self.forces @ system.pairs.T
            mean, wave = np.zeros(len(self.stiffness)), np.zeros(len(self.stiffness), complex)
            if np.any(drive[0]):
                mean = np.linalg.solve(self.stiffness, drive[0])
            if np.any(drive[1:]):
                impedance = self.stiffness - omega**2 * np.eye(len(mean))
                impedance = impedance + 1j * omega * system.damping
                wave = np.linalg.solve(impedance, drive[1] - 1j * drive[2])
            shape = self.scale * np.array([mean, wave.real, -wave.imag])
            rate = omega * np.array([0.0 * mean, -wave.imag, -wave.real])
            self._steady[omega] = np.hstack([shape, rate])
        return self._steady[omega]

    def exponential(self, duration: float, columns: np.ndarray) -> np.ndarray:
        """exp(A t) times columns (2m, ...)."""
        turned_columns = (np.exp(self.values * duration) * (self.inverse @ columns).T).T
        found: np.ndarray = (self.vectors @ turned_columns).real
        return found


@dataclass
class Piece:
    """A motion z(t0 + t) in one set, from a state at t0."""

    of: ClosedSet
    omega: float
    start: float
    state: np.ndarray
    length: float = 0.0

    def __post_init__(self) -> None:
        steady = self.of.steady(self.omega)
        self.amplitude = self.of.inverse @ (self.state - _wave(self.omega, self.start) @ steady)
        count = len(self.state) // 2
        pairs = self.of.system.pairs
        slow = steady[:, :count] / self.of.scale @ pairs + self.of.system.lift
        self.offset = slow @ self.of.signs.T  # (3, p)
        self.moving = self.of.rows * self.amplitude  # (p, n)

    def state_at(self, times: np.ndarray) -> np.ndarray:
        """z at times after the start: (len(times), 2m)."""
        turned_amplitudes = np.exp(np.multiply.outer(times, self.of.values)) * self.amplitude
        free_motion = (turned_amplitudes @ self.of.vectors.T).real
        return free_motion + _wave(self.omega, self.start + times) @ self.of.steady(self.omega)

    def slow_gap(self, times: np.ndarray) -> np.ndarray:
        """s at times after the start: (len(times), p)."""
        system = self.of.system
        modal_motion = self.state_at(times)[:, : len(system.squares)] / self.of.scale
        return modal_motion @ system.pairs + _wave(self.omega, self.start + times) @ system.lift

    def sign(self, pair: int, time: float, derivative: bool = False) -> float:
        """v of a pair after the start, or its slope."""
        values = self.of.values
        turned_modes = self.moving[pair] * np.exp(values * time)
        angle = self.omega * (self.start + time)
        mean, cosine, sine = self.offset[:, pair]
        if derivative:
            wave = self.omega * (sine * np.cos(angle) - cosine * np.sin(angle))
            return float((turned_modes @ values).real + wave)
        return float(turned_modes.sum().real + mean + cosine * np.cos(angle) + sine * np.sin(angle))

    def first_event(self, duration: float) -> tuple[float, int] | None:
        """When and of which pair v becomes positive; None: not before the end."""
        step, begin = self.of.step, MOMENT * self.of.step
        while begin < duration:
            times = begin + step * np.arange(BLOCK + 1)
            moving_parts = self.moving * np.exp(self.of.values * begin)
            values = (moving_parts @ self.of.powers.T).real + self._forced(times)
            slopes = ((moving_parts * self.of.values) @ self.of.powers.T).real + self._forced(
                times, True
            )
            values[:, 0] = np.minimum(values[:, 0], 0.0)  # it holds at first, but for rounding
            # A top between two samples is below the tangents of both.
            start_samples, end_samples = values[:, :-1], values[:, 1:]
            top = np.minimum(
                start_samples + step * slopes[:, :-1], end_samples - step * slopes[:, 1:]
            )
            humps = (slopes[:, :-1] > 0.0) & (slopes[:, 1:] < 0.0) & (top > 0.0)
            suspect = (end_samples > 0.0) | humps
            for k in np.flatnonzero(suspect.any(axis=0)):
                pairs, first_pair, end = np.flatnonzero(suspect[:, k]), None, float(times[k + 1])
                early = start_samples[pairs, k] / np.maximum(
                    end_samples[pairs, k] - start_samples[pairs, k], 1e-300
                )
                for pair in pairs[np.argsort(-early)]:  # the others only before what is found
                    root = self._root(int(pair), times[k], end)
                    if root is not None and (first_pair is None or root < end):
                        first_pair, end = int(pair), root
                if first_pair is not None:
                    return (end, first_pair) if end < duration else None
                if times[k + 1] > duration:
                    return None
            begin = float(times[-1])
        return None

    def _forced(self, times: np.ndarray, derivative: bool = False) -> np.ndarray:
        mean, cosine, sine = self.offset[:, :, None]
        angle = self.omega * (self.start + times)
        if derivative:
            forced_motion = self.omega * (sine * np.cos(angle) - cosine * np.sin(angle))
        else:
            forced_motion = mean + cosine * np.cos(angle) + sine * np.sin(angle)
        return np.asarray(forced_motion)

    def _root(self, pair: int, low: float, high: float) -> float | None:
        """The first time at which v of a pair leaves 0 upwards; None where its top stays below."""

        def value(time: float) -> float:
            return self.sign(pair, time)

        def slope(time: float) -> float:
            return self.sign(pair, time, True)

        if value(low) >= 0.0:
            return low if value(high) > 0.0 or slope(low) > 0.0 else None
        if value(high) <= 0.0:
            if not slope(low) > 0.0 > slope(high):
                return None
            high = _brent(slope, low, high)
            if value(high) <= 0.0:
                return None
        return _brent(value, low, high)


def _wave(omega: float, times: Any) -> np.ndarray:
    angle = omega * np.asarray(times, dtype=float)
    return np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=-1)


def _brent(function: Callable[[float], float], low: float, high: float) -> float:
    """A root between two times, to rounding."""
    try:
        return float(scipy.optimize.brentq(function, low, high, xtol=1e-15 * high, maxiter=500))
    except RuntimeError as error:
        raise NoOrbit("an instant that is not found") from error


# --- the flow -------------------------------------------------------------------------------------


@dataclass
class Passage:
    """A motion followed: its last state, its pieces, and its gaps at instants."""

    state: np.ndarray
    pieces: list[Piece] = field(default_factory=list)
    gap: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def tangent(self) -> np.ndarray:
        """d z(T) / d z(0)."""
        product = np.eye(len(self.state))
        for piece in self.pieces:
            product = piece.of.exponential(piece.length, product)
        return product


@dataclass(frozen=True)
class Orbit:
    """A periodic orbit.

    Attributes
    ----------
    state : (2m,)
        At phase zero.
    monodromy, multipliers : (2m, 2m), (2m,)
        Multipliers with the largest modulus first.
    gap : (512, p) [m]
        Over one period.
    events : int
    """

    state: np.ndarray
    monodromy: np.ndarray
    gap: np.ndarray
    events: int

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Eigenvalues of the monodromy matrix."""
        eigenvalues = np.linalg.eigvals(self.monodromy)
        return eigenvalues[np.argsort(-np.abs(eigenvalues))]


class ReferenceFlow:
    """The flow of a structure under a law; sets are kept, for all frequencies of the load."""

    def __init__(self, structure: fc.Structure, law: Any) -> None:
        self.system = System.of(structure, law)
        self.scale = float(np.sqrt(np.abs(self.system.squares).max()))
        compliance = self.system.residual + np.diag(self.system.springs)
        self._size = np.sqrt(np.diag(compliance))
        scaled_compliance = compliance / np.outer(self._size, self._size)
        self._factor = (
            np.linalg.cholesky(scaled_compliance) if len(scaled_compliance) else scaled_compliance
        )
        self._sets: dict[bytes, ClosedSet] = {}

    def state(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """z of displacements and velocities of all dofs."""
        rows = self.system.rows
        return np.concatenate([self.scale * (rows @ displacement), rows @ velocity])

    def states_of(self, found: fc.PeriodicSolution, phases: np.ndarray) -> np.ndarray:
        """z of a solution at shares of its period: (len(phases), 2m)."""
        rows = found.displacement_coefficients @ self.system.rows.T
        k = np.arange(1, found.harmonics + 1)
        angle = 2.0 * np.pi * np.multiply.outer(phases, k)
        shape = rows[0] + np.cos(angle) @ rows[1::2] + np.sin(angle) @ rows[2::2]
        turn = k * found.base_omega
        rate = -(turn * np.sin(angle)) @ rows[1::2] + (turn * np.cos(angle)) @ rows[2::2]
        return np.hstack([self.scale * shape, rate])

    def closed_set(self, closed: np.ndarray) -> ClosedSet:
        key = closed.tobytes()
        if key not in self._sets:
            if len(self._sets) >= MOST_SETS:
                self._sets.clear()
            self._sets[key] = ClosedSet(self.system, closed.copy(), self.scale)
        return self._sets[key]

    def contact(self, slow: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
        """The set of closed pairs at gaps s: a guess if it is right, else by least squares."""
        if guess is not None and np.all(self.closed_set(guess).signs @ slow <= 0.0):
            return guess
        scaled_gap = slow / self._size
        size = float(np.abs(scaled_gap).max(initial=0.0))
        if size == 0.0:
            return np.zeros(len(slow), dtype=bool)
        right_side = scipy.linalg.solve_triangular(self._factor, scaled_gap / size, lower=True)
        max_iterations = 200 + 9 * len(slow)
        is_closed: np.ndarray = (
            scipy.optimize.nnls(self._factor.T, right_side, maxiter=max_iterations)[0] > 0.0
        )
        return is_closed

    def advance(
        self, state: np.ndarray, omega: float, start: float, duration: float, instants: int = 0
    ) -> Passage:
        """Follow a state from ``start`` for ``duration``; gaps at equally spaced instants."""
        done_time, times = 0.0, duration * np.arange(instants) / max(instants, 1)
        passage = Passage(np.array(state, dtype=float))
        gap = np.empty((instants, len(self.system.springs)))
        count = len(self.system.squares)
        slow = passage.state[:count] / self.scale @ self.system.pairs
        slow = slow + _wave(omega, start) @ self.system.lift
        rate = passage.state[count:] @ self.system.pairs
        rate = rate + omega * (_wave(omega, start + 0.5 * np.pi / omega) @ self.system.lift)
        rate = rate - omega * self.system.lift[0]
        closed_pairs = self.contact(slow + MOMENT * FINE / self.scale * rate)
        while done_time < duration:
            if len(passage.pieces) > MOST_EVENTS:
                raise NoOrbit("events without end")
            piece = Piece(self.closed_set(closed_pairs), omega, start + done_time, passage.state)
            remaining_time = duration - done_time
            event = piece.first_event(remaining_time)
            piece.length = remaining_time if event is None else event[0]
            is_inside = (times >= done_time) & (
                (times < done_time + piece.length) | (event is None)
            )
            gap[is_inside] = piece.slow_gap(times[is_inside] - done_time) @ piece.of.gaps.T
            passage.state = piece.state_at(np.array([piece.length]))[0]
            passage.pieces.append(piece)
            done_time += piece.length
            if event is None:
                break
            guess = closed_pairs.copy()
            guess[event[1]] ^= True
            later = np.array([piece.length + MOMENT * piece.of.step])
            closed_pairs = self.contact(piece.slow_gap(later)[0], guess)
        passage.gap = gap
        return passage

    def settled(self, state: np.ndarray, omega: float, period: float, periods: int) -> np.ndarray:
        """Where the motion is after some periods."""
        for _ in range(periods):
            state = self.advance(state, omega, 0.0, period).state
        return state

    def orbit(self, state: np.ndarray, omega: float, period: float) -> Orbit:
        """The orbit to which Newton's method leads from a state at phase zero: with steps measured
        by the simplified next one, and if that leads nowhere by what is left."""
        try:
            return self._newton(state, omega, period, natural=True)
        except NoOrbit:
            return self._newton(state, omega, period, natural=False)

    def _newton(self, state: np.ndarray, omega: float, period: float, natural: bool) -> Orbit:
        flows, state = 0, np.array(state, dtype=float)
        passage = self.advance(state, omega, 0.0, period)
        while flows < FLOWS:
            state_change, monodromy = passage.state - state, passage.tangent()
            lead = scipy.linalg.lu_factor(np.eye(len(state)) - monodromy)
            newton = scipy.linalg.lu_solve(lead, state_change)
            size = max(float(np.linalg.norm(state)), float(np.linalg.norm(passage.state)), 1e-300)
            if (
                np.linalg.norm(state_change) <= CLOSED * size
                and np.linalg.norm(newton) <= SURE * size
            ):
                state = state + newton
                gap = self.advance(state, omega, 0.0, period, INSTANTS).gap
                return Orbit(state, monodromy, gap, len(passage.pieces) - 1)
            earlier_norm, share, flows = (
                np.linalg.norm(newton if natural else state_change),
                1.0,
                flows + 1,
            )
            while True:
                trial = state + share * newton
                trial_passage = self.advance(trial, omega, 0.0, period)
                residual = trial_passage.state - trial
                residual = scipy.linalg.lu_solve(lead, residual) if natural else residual
                if np.linalg.norm(residual) <= (1.0 - 0.25 * share) * earlier_norm:
                    break
                share, flows = 0.5 * share, flows + 1
                if share < SHORTEST or flows >= FLOWS:
                    raise NoOrbit("Newton's method does not get to an orbit")
            state, passage = trial, trial_passage
        raise NoOrbit("no orbit within the flows allowed")


@dataclass
class SmoothPassage(Passage):
    """The same by an integrator, which is asked once more for the tangent."""

    again: Callable[[], np.ndarray] = field(default=lambda: np.zeros((0, 0)))

    def tangent(self) -> np.ndarray:
        """d z(T) / d z(0)."""
        return self.again()


class SmoothFlow(ReferenceFlow):
    """The flow under a law whose force follows smoothly from the gap, of pairs with mass."""

    def __init__(self, structure: fc.Structure, law: Any) -> None:
        super().__init__(structure, law)
        self.law = law

    def advance(
        self, state: np.ndarray, omega: float, start: float, duration: float, instants: int = 0
    ) -> Passage:
        """Follow a state from ``start`` for ``duration``; gaps at equally spaced instants."""
        times = start + duration * np.append(np.arange(instants) / max(instants, 1), 1.0)
        motion = self._integrated(state[:, None], omega, start, times)[:, :, 0]
        slow = motion[:-1, : len(state) // 2] / self.scale @ self.system.pairs
        gap = slow + _wave(omega, times[:-1]) @ self.system.lift

        def tangent() -> np.ndarray:
            columns = np.column_stack([state, np.eye(len(state))])
            return self._integrated(columns, omega, start, times[-1:])[-1, :, 1:]

        return SmoothPassage(motion[-1], gap=gap, again=tangent)

    def _integrated(
        self, columns: np.ndarray, omega: float, start: float, times: np.ndarray
    ) -> np.ndarray:
        """A state, the first column, and disturbances of it, at times: (n, 2m, columns)."""
        system, scale, count = self.system, self.scale, len(columns) // 2

        def rate(time: float, packed: np.ndarray) -> np.ndarray:
            wave, state_columns = _wave(omega, time), packed.reshape(columns.shape)
            shape, speed = state_columns[:count] / scale, state_columns[count:]
            answer = system.pairs.T @ shape
            gap = answer[:, 0] + wave @ system.lift
            answer *= self.law.tangent(gap)[:, None]
            answer[:, 0] = self.law.force(gap)
            push = -system.squares[:, None] * shape - system.damping @ speed
            push -= system.pairs @ answer
            push[:, 0] += wave @ system.force
            return np.concatenate([scale * speed, push]).ravel()

        size = float(np.linalg.norm(columns[:, 0])) or 1.0
        run = solve_ivp(
            rate, (start, times[-1]), columns.ravel(), "DOP853", t_eval=times, rtol=FINELY,
            atol=FINELY * size,
        )  # fmt: skip
        if not run.success:
            raise NoOrbit("a motion that is not integrated")
        states: np.ndarray = run.y.T.reshape(len(times), *columns.shape)
        return states


def size_of_motion(motion: np.ndarray) -> float:
    """Norm of a motion at equal times (n, k), to which its means contribute no more than what is
    left of it without them."""
    mean = motion.mean(axis=0)
    moving_size, mean_size = float(np.linalg.norm(motion - mean)), float(np.linalg.norm(mean))
    mean_size *= float(np.sqrt(len(motion)))
    return max(float(np.hypot(moving_size, min(moving_size, mean_size))), 1e-300)


def predicted(flow: ReferenceFlow, found: fc.PeriodicSolution, nodes: int = 32) -> float:
    """How far one Newton step of the whole wave moves a solution, relative to B^T Phi q.

    From states Z_i of the solution at equally spaced nodes, with F_i = flow(Z_i) - Z_{i+1} and the
    tangents M_i between them, the periodic solution of d_{i+1} = M_i d_i + F_i.
    """
    states = flow.states_of(found, np.arange(nodes) / nodes)
    length, size = found.period / nodes, states.shape[1]
    defects, tangents = [], []
    for i in range(nodes):
        passage = flow.advance(states[i], found.omega, i * length, length)
        defects.append(passage.state - states[(i + 1) % nodes])
        tangents.append(passage.tangent())
    product, defect_sum = np.eye(size), np.zeros(size)
    for tangent, defect in zip(tangents, defects, strict=True):
        product, defect_sum = tangent @ product, tangent @ defect_sum + defect
    state_corrections = [np.linalg.solve(np.eye(size) - product, defect_sum)]
    for tangent, defect in zip(tangents[:-1], defects[:-1], strict=True):
        state_corrections.append(tangent @ state_corrections[-1] + defect)
    half, pairs = size // 2, flow.system.pairs
    change, whole = np.array(state_corrections)[:, :half] @ pairs, states[:, :half] @ pairs
    return float(np.linalg.norm(change)) / size_of_motion(whole)
