"""Periodic orbits of the exact flow, by shooting.

With the state z at phase zero, the period T = 2 pi m / omega, m the load's periods in it, and the
flow's derivative M over it, an orbit is where

    F(z) = z(T) - z = 0,      dF/dz = M - I,

and the eigenvalues of M are its Floquet multipliers. A step of Newton's method is shortened until
the *natural* test accepts it: the simplified step from there, with the same M, is shorter. It does
not depend on how the state is measured.

The derivative of one step is kept for the next ones, updated by them (Broyden's "good"
method), as long as they shrink the residual enough; a first one may be that of a motion nearby.

With many modes M is not formed: GMRES takes products with it, in the norm of the energy, each for
the time of half a period followed. Damping leaves little of fast modes: some dozen are enough.

A neighbouring HB solution, with states Z_i at N equal parts of the period, is assessed by one such
step of all of it, which needs no orbit. With F_i the state reached from Z_i less Z_{i+1}, M_i the
derivatives,

    d_{i+1} = M_i d_i + F_i,   periodic;       predicted error = |P^T d| / |P^T Z|.

Source: Deuflhard, Newton Methods for Nonlinear Problems, 2004, sections 2.1 and 3.3.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from scipy.linalg.lapack import dgeev

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.tables import Described, counted, hertz_of
from fenics_crack.kernel import kernel
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import Budget, BudgetError, ContactFlow, Motion, Samples, Track
from fenics_crack.motion.motions import Observed, Record
from fenics_crack.numerics.equations import CLOSE, LOCATED, factored, solve_factored
from fenics_crack.numerics.fourier import balanced, waves_of
from fenics_crack.numerics.newton import FORCING, gmres, relative_to_motion

FLOWS, MIN_NEWTON_STEP = 20, 1e-3
"""Search budget in periods integrated, and shortest damped Newton step."""
PIECES = 20_000
"""Search budget in Taylor pieces: a second, with many pairs; more where M is formed and a period of
a slow load has many by itself."""
FORMED = 120
"""Maximum modes of a flow of which M is formed."""
PRODUCTS, BLUNT = 60, 0.25
"""Maximum products with M in a solution, and the relative residual of a step which is only
compared."""
KNOWN = 1e-6
"""Accuracy of multipliers; ||mu| - 1| below it is inconclusive."""
INSTANTS_AT_A_TIME = 2048
"""Instants whose sines and cosines are held at a time."""
INSTANTS = 512
"""Instants at which the gaps of an orbit are kept."""
HARMONICS = 40
"""Harmonics of its period in what is observed of an orbit. By 256 instants the one of order k is
off by that of order 256 - k, of motions with kinks (k / 216)^2 of it."""


Inverse = Callable[[np.ndarray, float], np.ndarray]
"""b to (I - M)^-1 b, to a relative residual where M is not formed."""


class Prediction(NamedTuple):
    """Result of one step of Newton's method from a harmonic-balance solution.

    Attributes
    ----------
    error : float
        ``|P^T d| / |P^T Z|``.
    states : (n, 2 n_modes)
        Z + d.
    track : Track
        Of all parts, one behind the other.
    inverse : Inverse
        (I - M)^-1, M that of the track.
    """

    error: float
    states: np.ndarray
    track: Track
    inverse: Inverse

    @property
    def monodromy(self) -> np.ndarray:
        """M over the period along the solution: (2 n_modes, 2 n_modes)."""
        return self.track.tangent


@dataclass(frozen=True, repr=False)
class PeriodicOrbit(Observed, Described):
    """A periodic orbit of the exact flow.

    Attributes
    ----------
    flow : ContactFlow
    omega : float
        Of the load [rad/s].
    subharmonic : int
        Its periods in one of the orbit.
    motion : Motion
        Over the period.
    state : (2 n_modes,)
        q, q' at phase zero of the load.
    flows : int
        Periods that were followed to find it.
    """

    flow: ContactFlow
    omega: float
    subharmonic: int
    motion: Motion
    state: np.ndarray
    flows: int

    frequency = hertz_of()

    @property
    def period(self) -> float:
        """[s]."""
        return 2.0 * np.pi * self.subharmonic / self.omega

    @property
    def iterations(self) -> int:
        """Steps of Newton's method, tried ones with them."""
        return self.flows - 1

    @property
    def events(self) -> int:
        """Pairs that open or close in a period."""
        return self.motion.events

    @property
    def monodromy(self) -> np.ndarray:
        """M: (2 n_modes, 2 n_modes)."""
        return self.motion.track.tangent

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Floquet multipliers, largest modulus first: (2 n_modes,) complex."""
        return eigenvalues(self.monodromy)

    @cached_property
    def residual(self) -> float:
        """``|z(T) - z(0)| / |z(0)|`` in the norm of the energy."""
        change = self.motion.state - self.state
        return self.energy_norm(change) / (self.energy_norm(self.state) or 1.0)

    def energy_norm(self, change: np.ndarray) -> float:
        """Norm of a change of the state."""
        return float(np.linalg.norm(self.flow.weights(self.omega / self.subharmonic) * change))

    @cached_property
    def inverse(self) -> Inverse:
        """(I - M)^-1; LinAlgError where it is singular."""
        weights = self.flow.weights(self.omega / self.subharmonic)
        return _inverse(self.flow, self.motion.track, weights)

    def samples(self, time: np.ndarray) -> Samples:
        """The motion at ascending times of the period [s]."""
        return self.flow.advance(self.state, self.omega, self.period, instants=time).samples

    def _at(self, time: np.ndarray, values: str) -> np.ndarray:
        """One of the samples' arrays at any times."""
        phase, place = np.unique(np.mod(time, self.period), return_inverse=True)
        return np.asarray(getattr(self.samples(phase), values)[place.ravel()])

    @cached_property
    def sampled(self) -> Samples:
        """The motion at 512 equally spaced times of the period."""
        return self.samples(np.arange(INSTANTS) * self.period / INSTANTS)

    @property
    def is_stable(self) -> bool:
        """True if all multipliers lie within the unit circle."""
        return bool(abs(self.multipliers[0]) < 1.0)

    @property
    def gap(self) -> np.ndarray:
        """g there: (512, n_pairs) [m]."""
        return self.sampled.gap

    def gap_at(self, time: np.ndarray) -> np.ndarray:
        """g at times [s]: (len(time), n_pairs) [m]."""
        return self._at(time, "gap")

    def tangential_gap_at(self, time: np.ndarray) -> np.ndarray:
        """g_t of contact with friction at times [s]: (len(time), n_pairs) [m]; else (len(time),
        0)."""
        return self._at(time, "gaps")[:, self.flow.structure.n_pairs :]

    def tangential_force_at(self, time: np.ndarray) -> np.ndarray:
        """Friction force at times [s]: likewise [N]."""
        return self._at(time, "forces")[:, self.flow.structure.n_pairs :]

    def force_at(self, time: np.ndarray) -> np.ndarray:
        """Contact force at times [s]: (len(time), n_pairs) [N]."""
        return self._at(time, "force")

    def displacement_at(self, time: np.ndarray) -> np.ndarray:
        """Displacement of the structure's own dofs at times [s]: (len(time), n_dofs) [m]."""
        return self._at(time, "displacement")

    @property
    def structure(self) -> Structure:  # type: ignore[override]
        """The structure that vibrates."""
        return self.flow.structure

    def records(self, rows: np.ndarray, instants: int | None = None) -> Iterator[Record]:
        """The motion, on each part of the period by the polynomials through Gauss's nodes; at as
        many instants as are given all numbers are from these."""
        samples, length = self._at_nodes(len(self.flow.force) // 2 * self.omega)
        nodes, weights, _ = gauss_nodes()
        seen = samples.products(rows), samples.gaps, samples.forces
        values, along = np.hstack(seen), np.arange(len(nodes))
        ends, signs = np.cumsum(length), (-1.0) ** np.arange(len(nodes))
        barycentric = signs * np.sqrt((1.0 - nodes**2) * weights)
        splits = np.cumsum([part.shape[1] for part in seen])[:2]

        def at(parts: np.ndarray) -> Any:
            time = self.period * np.mod(parts, 1.0)
            piece = np.minimum(np.searchsorted(ends, time), len(ends) - 1)
            away = (1.0 + 2.0 * (time - ends[piece]) / length[piece])[:, None] - nodes
            share = barycentric / np.where(away == 0.0, sys.float_info.min, away)
            share /= share.sum(axis=1, keepdims=True)
            columns, starts = (
                len(nodes) * piece[:, None] + along,
                len(nodes) * np.arange(len(time) + 1),
            )
            shares = sparse.csr_matrix(
                (share.ravel(), columns.ravel(), starts), (len(time), len(values))
            )
            return np.split(shares @ values, splits, axis=1)

        count, exact = instants or INSTANTS, {}
        parts = np.arange(count) / count
        motion, gap, force = at(parts)
        if instants is None:
            track, exact = self.motion.track, dict(self.sliding)
            exact |= {"closed_share": track.share(track.sets > 0)} if gap.size else {}
        yield Record(
            self.omega, self.subharmonic, self.period * parts, balanced(motion, HARMONICS),
            motion, gap, force,
            structure=self.structure,
            friction=getattr(self.flow.friction, "coefficient", None),
            at=at,
            exact=exact,
        )  # fmt: skip

    def coefficients(self, harmonics: int) -> OrbitCoefficients:
        """Fourier coefficients, by Gauss's rule on each part of the period in which no pair opens
        or closes."""
        samples = self._at_nodes(harmonics * self.omega / self.subharmonic)[0]
        gaps, forces, count = samples.gaps, samples.forces, self.flow.count
        values = np.hstack([gaps, forces, samples.states[:, :count]])
        splits = np.cumsum([gaps.shape[1], forces.shape[1]])
        gap, force, modal = np.split(self._coefficients(values, harmonics), splits, axis=1)
        orders = np.arange(1, len(self.flow.force) + 1) // 2
        rows = np.arange(len(self.flow.force)) + 2 * orders * (self.subharmonic - 1)
        load = np.equal.outer(np.arange(2 * harmonics + 1), rows).astype(float)
        return OrbitCoefficients(gap, force, self.flow.displaced(modal, force, load))

    def waves(self, rows: np.ndarray, harmonics: int) -> np.ndarray:
        """Fourier coefficients of the displacement's products with rows (m, n_dofs): (2H+1, m)."""
        samples = self._at_nodes(harmonics * self.omega / self.subharmonic)[0]
        return self._coefficients(samples.products(rows), harmonics)

    def _coefficients(self, values: np.ndarray, harmonics: int) -> np.ndarray:
        """Fourier coefficients (2H+1, m) of values (n, m) at the nodes for so many harmonics."""
        base = self.omega / self.subharmonic
        samples, length = self._at_nodes(harmonics * base)
        share = (0.5 * length[:, None] * gauss_nodes()[1]).ravel() / self.period
        found = np.zeros((2 * harmonics + 1, values.shape[1]))
        kept = np.empty((len(found), INSTANTS_AT_A_TIME))
        for start in range(0, len(values), INSTANTS_AT_A_TIME):
            some = slice(start, start + INSTANTS_AT_A_TIME)
            first = np.exp(1j * base * samples.time[some])
            means, wave = kept[:, : len(first)], 2.0 * share[some] * first
            means[0] = share[some]
            for order in range(1, harmonics + 1):  # a tenth of the time of their sines and cosines
                means[2 * order - 1], means[2 * order] = wave.real, wave.imag
                wave *= first
            found += means @ values[some]
        return found

    def _at_nodes(self, omega: float) -> tuple[Samples, np.ndarray]:
        """The motion at Gauss's nodes on each part of the period in which no pair opens, closes,
        sticks or slips, and waves of up to a frequency [rad/s] turn little, and the parts' lengths
        [s]; the finest that was asked for is kept."""
        if not self._finest or self._finest[-1][0] < omega:
            track, flow = self.motion.track, self.flow
            touching = track.sets.any(axis=1)
            rates = np.where(touching, flow.fastest, flow.fastest_apart)
            turn = track.lengths * (rates + omega)
            parts = np.maximum(np.ceil(turn / kernel.FLOW_REACH), 1).astype(int)
            length = np.repeat(track.lengths / parts, parts)
            start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
            time = start[:, None] + 0.5 * length[:, None] * (1.0 + gauss_nodes()[0])
            self._finest[:] = [(omega, self.samples(time.ravel()), length)]
        return self._finest[-1][1:]

    @cached_property
    def _finest(self) -> list[tuple[float, Samples, np.ndarray]]:
        """A highest frequency [rad/s], the motion at nodes for it, and the parts' lengths."""
        return []

    @cached_property
    def work(self) -> Work:
        """Work of the load, the damping and friction in the period, exact: on each part of it by
        Gauss's rule, with the derivatives of the polynomials through his nodes."""
        flow = self.flow
        samples, length = self._at_nodes(len(flow.force) // 2 * self.omega)
        _, weights, turn = gauss_nodes()

        def over(force: np.ndarray, moved: np.ndarray) -> np.ndarray:
            """int F x' dt of columns at the nodes."""
            force, moved = (one.reshape(len(length), len(weights), -1) for one in (force, moved))
            return np.asarray(np.einsum("k,pkc,pkc->c", weights, force, turn @ moved))

        load = waves_of(flow.force, self.omega * samples.time)
        rates = samples.states[:, flow.count :]
        share = (0.5 * length[:, None] * weights).ravel()
        damping = float(share @ np.sum(rates * flow.modes.damped(rates), axis=1))
        count = flow.structure.n_pairs
        friction = np.zeros(count)
        if flow.friction:
            friction = over(samples.forces[:, count:], samples.gaps[:, count:])
        return Work(
            float(over(load, samples.products(flow.structure.force)).sum()), damping, friction
        )

    @cached_property
    def sliding(self) -> dict[str, float]:
        """With friction the loss in the period [J], and the shares of it in which pairs stick and
        slip, means over the pairs, by the names of :class:`Indicators`; else nothing."""
        if not self.flow.friction:
            return {}
        track = self.motion.track
        return {
            "friction_loss": float(self.work.friction.sum()),
            "stick_share": track.share(track.sets == kernel.STICK),
            "slip_share": track.share(track.sets > kernel.STICK),
        }

    @property
    def stuck(self) -> np.ndarray:
        """Numbers (k,) of the pairs that stick all the time: their places are what their history
        has left, and they take no part in the multipliers. None without friction."""
        sets = self.motion.track.sets
        every = self.flow.friction is not None and np.all(sets == kernel.STICK, axis=0)
        return np.flatnonzero(every)

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Largest multiplier, extremes of the gap [m] of all pairs, and how it was found."""
        faces = {"opening": 0.0, "penetration": 0.0} | self.faces
        return {
            "multiplier": float(abs(self.multipliers[0])),
            "opening": faces["opening"],
            "penetration": faces["penetration"],
            "events": self.events,
            "residual": float(self.residual),
            "iterations": self.iterations,
        }

    def _title(self) -> str:
        largest = f"largest multiplier {abs(self.multipliers[0]):.6g} of {len(self.multipliers)}"
        return f"{largest}, {counted(self.events, 'event')}, residual {self.residual:.2g}"


class Work(NamedTuple):
    """Work in a period.

    Attributes
    ----------
    load, damping : float [J]
        Done by the load, and lost by damping.
    friction : (n_pairs,) [J]
        Lost by the friction of each pair, int lambda_t g_t' dt; the load's is the sum of all.
    """

    load: float
    damping: float
    friction: np.ndarray


@lru_cache
def gauss_nodes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes between -1 and 1 and weights of Gauss's rule on a part of a period, and the matrix that
    makes derivatives there of values there."""
    nodes, weights = np.polynomial.legendre.leggauss(2 * kernel.FLOW_REACH)
    values = np.polynomial.legendre.legvander(nodes, len(nodes) - 1)
    slopes = np.polynomial.legendre.legder(np.eye(len(nodes)))
    turned = np.polynomial.legendre.legval(nodes, slopes).T
    return nodes, weights, np.linalg.solve(values.T, turned.T).T


class OrbitCoefficients(NamedTuple):
    """Fourier coefficients of an orbit in the paper's order, rows a0, a1, b1, ....

    Attributes
    ----------
    gap : (2H+1, n_rows) [m]
        Of all rows: with friction tangential gaps, too.
    force : (2H+1, n_rows) [N]
    displacement : (2H+1, n_dofs) [m]
    """

    gap: np.ndarray
    force: np.ndarray
    displacement: np.ndarray


@dataclass(frozen=True, repr=False)
class MotionInArcs(PeriodicOrbit):
    """A motion in equal parts of its period that need not meet, observed like an orbit.

    Attributes
    ----------
    starts : (n, 2 n_modes)
        States at the starts of the parts.
    """

    starts: np.ndarray

    def samples(self, time: np.ndarray) -> Samples:
        """Return the motion at ascending times of the period [s]."""
        places = self.period / len(self.starts) * np.arange(len(self.starts) + 1)
        instants = np.split(time, np.searchsorted(time, places[1:-1]))
        parts = [
            self.flow.advance(
                state, self.omega, places[1], start=start, instants=part_times
            ).samples
            for state, start, part_times in zip(
                self.starts, places.tolist(), instants, strict=False
            )
        ]
        arrays = ((part.states, part.answers, part.contact) for part in parts)
        return Samples(self.flow, self.omega, time, *map(np.concatenate, zip(*arrays, strict=True)))


def affordable(
    flow: ContactFlow, omega: float, subharmonic: int = 1, periods: int = FLOWS + PRODUCTS
) -> bool:
    """Return True if a search does not take long at a frequency: M is formed, and the load not too
    slow.

    The same where so many periods have no more pieces, but for events, than it may take. Large
    states of crack faces with mass, which bounce, are not tried: from their harmonic-balance
    solutions Newton's method leads to no orbit.
    """
    if flow.count <= FORMED:
        return not too_slow(flow, omega, subharmonic)
    pieces = flow.pieces(2.0 * np.pi * subharmonic / omega)
    return flow.structure.light_lips and periods * pieces <= PIECES


def too_slow(flow: ContactFlow, omega: float, subharmonic: int = 1) -> bool:
    """Return True if two periods of a small state exceed the budget, without events."""
    pieces = flow.pieces(2.0 * np.pi * subharmonic / omega)
    return flow.count <= FORMED and 2.0 * pieces > Budget.pieces


def predicted(
    flow: ContactFlow, omega: float, states: np.ndarray, subharmonic: int = 1
) -> Prediction | None:
    """One step of Newton's method for a solution, of states at equal parts of its period (n,
    2 n_modes); None where the motion cannot be followed."""
    weights = flow.weights(omega / subharmonic)
    try:
        moved, track, ends = flow.steps(states, omega, 2.0 * np.pi * subharmonic / omega)
        excess = moved - np.concatenate([states[1:], states[:1]])
        change = track.carried(np.zeros(flow.size), excess, ends)[-1]
        inverse = _inverse(flow, track, weights)
        changes = track.carried(inverse(change, FORCING), excess, ends)[:-1]
    except (ConvergenceError, np.linalg.LinAlgError, ValueError):
        return None
    count = flow.count
    gap, moved = states[:, :count] @ flow.modes.pairs, changes[:, :count] @ flow.modes.pairs
    return Prediction(relative_to_motion(moved, gap), states + changes, track, inverse)


def predicted_motion(
    flow: ContactFlow, omega: float, step: Prediction, subharmonic: int
) -> MotionInArcs | None:
    """Return the motion that a prediction leads to; None where it cannot be followed."""
    with suppress(ConvergenceError):
        ends, track, _ = flow.steps(step.states, omega, 2.0 * np.pi * subharmonic / omega)
        return MotionInArcs(
            flow, omega, subharmonic, flow.advance(ends[-1], omega, 0.0)._replace(track=track),
            step.states[0], 1, step.states,
        )  # fmt: skip
    return None


def _inverse(flow: ContactFlow, track: Track, weights: np.ndarray) -> Inverse:
    """b to (I - M)^-1 b, exactly, or of large states to a relative residual in the norm of the
    energy."""
    if flow.count <= FORMED:
        factors = factored(np.eye(flow.size) - track.tangent)
        if not (np.isfinite(factors[0]).all() and np.diag(factors[0]).all()):
            raise np.linalg.LinAlgError("I - M is singular")
        return lambda right, sharp: solve_factored(factors, right)

    def apply(change: np.ndarray) -> np.ndarray:
        return change - weights * (track @ (change / weights))

    return lambda right, sharp: gmres(apply, weights * right, sharp, PRODUCTS) / weights


def find_orbit(
    flow: ContactFlow,
    omega: float,
    state: np.ndarray,
    *,
    subharmonic: int = 1,
    inverse: Inverse | None = None,
    located: float = LOCATED,
    ended: list[str] | None = None,
) -> PeriodicOrbit | None:
    """The orbit that Newton's method leads to from a state at phase zero, closed to 1e-6: behind a
    relative step of ``located``, of large states CLOSE.

    None where it leads to none, or takes more than the budget allows: pieces of all motions
    together, and intervals of each. It may begin with the inverse of a motion nearby. ``ended``
    gets the reason, in words, of a search that its budget of pieces ends.
    """
    search = _Search(flow, omega, subharmonic, state)
    try:
        if not search.leads_to_orbit(inverse, located):
            return None
    except (ConvergenceError, np.linalg.LinAlgError, ValueError) as error:
        if ended is not None and isinstance(error, BudgetError):
            words = f"the search for an exact orbit ended at its budget of {search.budget:,} pieces"
            ended.append(f"{words}; use fewer pairs (mesh.patches) or modes")
        return None
    found = PeriodicOrbit(flow, omega, subharmonic, search.motion, search.state, search.flows)
    # Where M is huge a step may be short and the motion does not close.
    return found if found.residual <= KNOWN else None


class _Search:
    """Newton's method for z(T) = z(0): where it is, and the motion from there.

    Attributes
    ----------
    flows : int
        Periods followed.
    budget : int
        Taylor pieces that they may have.
    """

    def __init__(
        self, flow: ContactFlow, omega: float, subharmonic: int, state: np.ndarray
    ) -> None:
        self._flow, self._omega = flow, omega
        self._period = 2.0 * np.pi * subharmonic / omega
        most = PIECES
        if flow.count <= FORMED and not too_slow(flow, omega, subharmonic):
            most = max(most, math.ceil(FLOWS * flow.pieces(self._period)))
        self.budget = self._left = most
        self._weights = flow.weights(omega / subharmonic)
        self.state, self.flows = state, 0

    def size(self, change: np.ndarray) -> float:
        """In the norm of the energy."""
        weighted = self._weights * change
        return math.sqrt(weighted @ weighted)

    def leads_to_orbit(self, inverse: Inverse | None, located: float) -> bool:
        """Return True if the search ends with an orbit."""
        formed = self._flow.count <= FORMED
        closed, shortest = (located, MIN_NEWTON_STEP) if formed else (CLOSE, 0.1)
        self.motion = self._follow(self.state)
        share, own = 1.0, False  # whether the derivative is that of the motion here
        steps: list[np.ndarray] = []  # with one derivative
        if formed and inverse is not None:
            steps = [inverse(self.motion.state - self.state, FORCING)]
        while self.flows < FLOWS:
            if inverse is None or not steps:
                inverse, own = _inverse(self._flow, self.motion.track, self._weights), True
                steps = [inverse(self.motion.state - self.state, FORCING)]
            step = steps[-1]
            trial = self.state + share * step
            moved = self._follow(trial)
            simplified = inverse(moved.state - trial, BLUNT)
            for one, behind in pairwise(steps):
                simplified = simplified + self._part(simplified, one) * behind
            before, after = self.size(step), self.size(simplified)
            bent = self.size(simplified - (1.0 - share) * step) + sys.float_info.min
            goal = closed * self.size(trial)
            if not after <= (1.0 - 0.25 * share) * before:
                if before <= KNOWN * self.size(trial):  # what is left of steps is rounding
                    return True
                if not own:
                    steps = []
                    continue
                share = min(0.5 * share, 0.5 * share**2 * before / bent)
                if share < shortest:
                    return False
                continue
            self.state, self.motion, own = trial, moved, False
            if after <= goal:
                return True
            if formed and share == 1.0 and after <= 0.1 * before:  # once more with this derivative
                steps.append(simplified / (1.0 - self._part(simplified, step)))
                continue
            steps = []
            share = min(1.0, 0.5 * share**2 * before / bent)
        return False

    def _part(self, change: np.ndarray, step: np.ndarray) -> float:
        """Return the fraction of a step in a change, by the energy."""
        weighted = self._weights**2 * step
        return float(change @ weighted / (step @ weighted))

    def _follow(self, state: np.ndarray) -> Motion:
        self.flows += 1
        left = Budget(pieces=self._left)
        found = self._flow.advance(state, self._omega, self._period, budget=left)
        self._left -= found.pieces
        return found


def orbit_from(
    flow: ContactFlow, omega: float, state: np.ndarray, subharmonic: int, iterations: int = 0
) -> PeriodicOrbit:
    """The orbit of a state at phase zero (2 n_modes,), which is followed over its period."""
    motion = flow.advance(state, omega, 2.0 * np.pi * subharmonic / omega)
    return PeriodicOrbit(flow, omega, subharmonic, motion, state, iterations + 1)


def equal(one: PeriodicOrbit, other: PeriodicOrbit) -> bool:
    """Return True if two orbits of a flow are the same to 1e-6, in the norm of the energy."""
    return one.energy_norm(one.state - other.state) <= KNOWN * one.energy_norm(one.state)


def eigenvalues(matrix: np.ndarray) -> np.ndarray:
    """All of a monodromy matrix, largest modulus first; straight from LAPACK, for small matrices a
    tenth of NumPy's time."""
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("the monodromy matrix is not finite")
    real, imaginary, _, _, info = dgeev(matrix, compute_vl=0, compute_vr=0)
    if info:
        raise np.linalg.LinAlgError("eigenvalues of the monodromy matrix do not converge")
    found: np.ndarray = real + 1j * imaginary
    return found[np.argsort(-np.abs(found), kind="stable")]
