"""Free motions: their equations, paths of them, and where a backbone starts (:mod:`backbone`)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from fenics_crack.balance.compliance import DEFLATION_BAND, ModalCompliance
from fenics_crack.balance.contact_integrals import CoupledIntegrals, PairIntegrals, apply_to_pairs
from fenics_crack.balance.contact_system import SOFT
from fenics_crack.balance.problem import halved, rounding_left
from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.model.contact import ContactLaw, gauss
from fenics_crack.model.modal import AllModes, all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import Linearisation, determinant_sign
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_at
from fenics_crack.numerics.path import ARRIVED, STRAIGHT, Ended, Path, PathOptions, Target


class Equilibrium:
    """Equilibrium of a structure without load, held or closed by its pairs alone."""

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        if structure.light_lips:
            allowed = 'reduced with method="free_interface"'
            raise InputError("structure", "crack faces without mass", allowed)
        self.contact = contact
        self.modes: AllModes = all_modes(structure)
        squares = self.modes.squares
        if not squares[0] > 1e-12 * squares[-1]:
            lowest = f"lowest eigenvalue {squares[0]:.3g} 1/s^2"
            raise InputError("structure", lowest, "fixed, so that it cannot move as a rigid body")
        self.frequencies = np.sqrt(squares)
        compliance = ModalCompliance(structure, 0.0, np.zeros((1, structure.n_local)))
        self.rounding = rounding_left(compliance, contact)
        """|F| / |x| that it leaves of motions at least."""
        static, free = compliance.matrices[0].real, compliance.linear_gap
        self.force = CoupledIntegrals(contact, 0, residual=static).forces(free)[0]
        self.gap = free[0] - static @ self.force
        self.modal = -(self.modes.pairs @ self.force) / squares
        held = _work(contact, np.zeros_like(self.gap), self.gap, 0.0 * self.force)
        self.energy = 0.5 * float(squares @ self.modal**2) + held
        self.stiffness = float(np.abs(static).sum(axis=1).max(initial=0.0))
        self.stiffness *= float(np.max(contact.stiffness, initial=0.0))
        """Largest k R, static."""


def _work(law: ContactLaw, gap: np.ndarray, change: np.ndarray, less: np.ndarray) -> float:
    """Integral of lambda - less over the gaps (n_pairs,) from ``gap`` on, of all pairs [J].

    Gauss's rule on both sides of g = 0: exact for piecewise polynomials.
    """
    nodes, weights = gauss(32)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(np.nan_to_num(-gap / change, posinf=0.0, neginf=0.0), 0.0, 1.0)
    total = np.zeros_like(gap)
    for start, length in ((0.0 * share, share), (share, 1.0 - share)):
        at = start + length * nodes[:, None]
        total += length * (weights @ (law.force(gap + at * change) - less))
    return float(total @ change)


def cosine_rows(harmonics: int) -> np.ndarray:
    """Places of a0, a1, a2, ... among the rows a0, a1, b1, ...."""
    return np.maximum(2 * np.arange(harmonics + 1) - 1, 0)


class FreeMotion:
    """F(x, p) = 0 for x = (z_00, ..., z_0n, z_10, ..., z_Hn, w / reference), a system for paths: p
    is ln E, or, where an energy is given, ln of the share of the contact stiffness.

    Row (k, j) is divided by (omega_j^2 + (k reference)^2) a / omega_j, the last one by E: they are
    numbers. Motions with less than a share of the first harmonic are a tongue's: another mode's.
    """

    def __init__(
        self,
        rest: Equilibrium,
        integrals: PairIntegrals,
        reference: float,
        energy: float | None = None,
    ) -> None:
        self.rest, self.integrals, self.reference, self.energy = rest, integrals, reference, energy
        self.harmonics = integrals.harmonics
        self.rows = cosine_rows(integrals.harmonics)
        self.order = (np.arange(integrals.harmonics + 1.0) * reference)[:, None] ** 2
        self.scale = 1.0 / (rest.modes.squares + self.order)
        self.left = self.scale * rest.frequencies
        self.gap_rows = rest.modes.pairs / rest.frequencies[:, None]
        """d (gap / a) / dz: (n_modes, n_pairs)."""

    def linearise(self, unknown: np.ndarray, parameter: float) -> MotionPoint:
        """The equations at (x, p)."""
        if self.energy is None:
            return MotionPoint(self, unknown, math.exp(parameter), 1.0)
        return MotionPoint(self, unknown, self.energy, math.exp(parameter))

    def with_harmonics(self, harmonics: int) -> FreeMotion:
        """The same with other harmonics."""
        integrals = self.integrals.widened(harmonics)
        return FreeMotion(self.rest, integrals, self.reference, self.energy)

    def stiffness(self, unknown: np.ndarray) -> np.ndarray:
        """Scaled omega_j^2 - (k w)^2: (H+1, n_modes)."""
        return (self.rest.modes.squares - self.order * unknown[-1] ** 2) * self.scale

    def near(self, unknown: np.ndarray) -> np.ndarray:
        """Return the entries of x that are too close to resonance to be predicted, nearer than 5 %,
        without the fundamental ones."""
        close = np.abs(self.stiffness(unknown)) < 0.05
        close[1] = False
        return np.append(close.ravel(), False)

    def is_fundamental(self, unknown: np.ndarray) -> bool:
        """Return True if the first harmonic has its share in the square of z without the mean."""
        squares = np.sum(unknown[:-1].reshape(self.scale.shape) ** 2, axis=1)
        share = 0.02 if self.energy is None else 0.25
        return bool(squares[1] >= share * np.sum(squares[1:]))

    def rounding(self, parameter: float) -> float:
        """Return the rounding error of |F| / |x|."""
        return self.rest.rounding


class MotionPoint(Linearisation):
    """The equations of free motions at a point.

    ``share`` multiplies the contact force.

    Attributes
    ----------
    force, tangent : (H+1, n_pairs), (n_pairs, H+1, H+1)
        Coefficients of the contact force less that of the equilibrium, over a, and their derivative
        by those of the gap.
    change : (H+1, n_pairs)
        Coefficients of the gap less that of the equilibrium, over a.
    push : (n_pairs,)
        Contact force at t = 0 less that of the equilibrium, over a.
    work : float
        Work of the contact force from the equilibrium to t = 0, over E.
    """

    def __init__(
        self, motion: FreeMotion, unknown: np.ndarray, energy: float, share: float
    ) -> None:
        rest, rows, scale = motion.rest, motion.rows, math.sqrt(2.0 * energy)
        self._motion, self.unknown = motion, unknown
        self._z = unknown[:-1].reshape(len(rows), -1)
        moved = scale * (self._z @ motion.gap_rows)
        gap = np.zeros((2 * len(rows) - 1, moved.shape[1]))
        gap[rows] = moved
        gap[0] += rest.gap
        found = motion.integrals.linearise(gap)
        self.force = found.force[rows]
        self.force[0] -= rest.force
        self.force *= share / scale
        self.tangent = share * found.tangent[:, rows[:, None], rows]
        first, law = moved.sum(axis=0), rest.contact
        self.push = (share / scale) * (law.force(rest.gap + first) - rest.force)
        self.work = share * _work(law, rest.gap, first, rest.force) / energy
        self.change = moved / scale
        self._stiffness = motion.stiffness(unknown)
        blocks = self._stiffness * self._z + motion.left * (self.force @ rest.modes.pairs.T)
        start = self._z.sum(axis=0)
        self.residual = np.append(blocks, float(start @ start) + self.work - 1.0)

    @cached_property
    def by_parameter(self) -> np.ndarray:
        """dF/dp: over ln E of b(g_e + a c) / a, with da = a / 2, and of the work over E."""
        force, work = self.force, self.work
        if self._motion.energy is None:
            force = 0.5 * (apply_to_pairs(self.tangent, self.change) - force)
            work = float(self.push @ self.change.sum(axis=0)) - work
        return np.append(self._motion.left * (force @ self._motion.rest.modes.pairs.T), work)

    @cached_property
    def _resonant(self) -> np.ndarray:
        """Entries that are kept, (H+1, n_modes) bool; the others are eliminated."""
        return np.abs(self._stiffness) < DEFLATION_BAND

    @cached_property
    def _inverse(self) -> np.ndarray:
        """1 / stiffness of the entries eliminated, 0 of those kept."""
        kept = self._resonant
        return np.where(kept, 0.0, 1.0 / np.where(kept, 1.0, self._stiffness))

    @cached_property
    def _by_frequency(self) -> np.ndarray:
        """Column of J of the frequency, but for its last entry, 0."""
        motion = self._motion
        return -2.0 * self.unknown[-1] * motion.order * motion.scale * self._z

    @cached_property
    def _by_amplitude(self) -> np.ndarray:
        """Row of J of the energy, the same for all harmonics: (n_modes,)."""
        return 2.0 * (self._z.sum(axis=0) + self._motion.gap_rows @ self.push)

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """J reduced to the gaps, the resonant entries and w, factored."""
        motion, tangent, stiffness = self._motion, self.tangent, self._stiffness
        pairs, right, left = motion.rest.modes.pairs, motion.gap_rows, motion.left
        resonant, inverse = self._resonant, self._inverse
        column, row = self._by_frequency, self._by_amplitude
        at, which = np.nonzero(resonant)
        n_rows, n_pairs, kept = len(self._z), pairs.shape[1], len(at)
        gaps = n_rows * n_pairs
        matrix = np.zeros((gaps + kept + 1, gaps + kept + 1))
        # The gaps: 1 + R T, R the compliance without the resonant entries.
        compliance = np.matmul(right.T * (inverse * left)[:, None, :], pairs)
        by_row = tangent.transpose(1, 2, 0)[:, None]
        matrix[:gaps, :gaps] = (compliance[:, :, None, :] * by_row).reshape(gaps, gaps)
        matrix.flat[: gaps * (len(matrix) + 1) : len(matrix) + 1] += 1.0
        place = at[:, None] * n_pairs + np.arange(n_pairs)
        matrix[place, gaps + np.arange(kept)[:, None]] = -right[which]
        matrix[:gaps, -1] = ((inverse * column) @ right).ravel()
        # The resonant entries.
        drive = (left[resonant][:, None] * pairs[which])[:, None, :]
        matrix[gaps:-1, :gaps] = (drive * tangent[:, at].transpose(1, 2, 0)).reshape(kept, gaps)
        matrix[gaps + np.arange(kept), gaps + np.arange(kept)] = stiffness[resonant]
        matrix[gaps:-1, -1] = column[resonant]
        # The energy.
        through = (row * inverse * left) @ pairs
        matrix[-1, :gaps] = -np.einsum("kq,qkl->lq", through, tangent).ravel()
        matrix[-1, gaps:-1] = row[which]
        matrix[-1, -1] = -np.sum(row * inverse * column)
        lu, pivots, _ = dgetrf(matrix)
        return lu, pivots

    def solve(self, right: np.ndarray) -> np.ndarray:
        """J^-1 r."""
        motion, inverse, resonant = self._motion, self._inverse, self._resonant
        blocks = right[:-1].reshape(inverse.shape)
        free = inverse * blocks
        seen = (free @ motion.gap_rows).ravel()
        last = right[-1] - np.sum(self._by_amplitude * free)
        found, _ = dgetrs(*self._factors, np.concatenate([seen, blocks[resonant], [last]]))
        n_pairs = motion.gap_rows.shape[1]
        force = apply_to_pairs(self.tangent, found[: len(seen)].reshape(-1, n_pairs))
        change = blocks - motion.left * (force @ motion.rest.modes.pairs.T)
        change -= self._by_frequency * found[-1]
        change *= inverse
        change[resonant] = found[len(seen) : -1]
        return np.append(change, found[-1])

    @property
    def sign(self) -> float:
        """Sign of det J."""
        flips = np.count_nonzero(self._stiffness[~self._resonant] < 0.0)
        return determinant_sign(self._factors) * (-1.0 if flips % 2 else 1.0)


ELSEWHERE = "the path ended in the motion of another mode"
HELPS = "fewer harmonics have fewer internal resonances, and another energy starts elsewhere"


def solve_motion(family: FreeMotion, guess: np.ndarray, parameter: float) -> PathPoint | None:
    """The motion near a guess at a parameter, or None."""
    tolerance = max(1e-12, family.rounding(parameter))
    return solve_at(family, guess, parameter, tolerance=tolerance, iterations=11)


@dataclass
class MotionPath:
    """The motions that follow one, up to that at a parameter: iterate over it once.

    Steps in the parameter itself pass over tongues; where there is none to a motion of the same
    shape, arc-length leads on. ``crosses_branch`` marks where a tongue
    was passed over. ``ended`` is as of a :class:`Path`, and ``complete`` whether it met the end and
    not another mode's motion. ``left`` is the number of points that it may still have.
    """

    family: FreeMotion
    last: PathPoint
    end: float
    lowest: float
    max_step: float
    left: int
    ended: Ended | None = None

    @property
    def complete(self) -> bool:
        """True if the path has reached the motion of the mode at the end."""
        return self.ended is Ended.MET and self.family.is_fundamental(self.last.unknown)

    def in_words(self, most: int) -> str:
        """Describe how the path has ended, of so many points at most."""
        assert self.ended is not None
        other = self.ended is Ended.MET and not self.complete
        return ELSEWHERE if other else self.ended.in_words(most)

    def __iter__(self) -> Iterator[PathPoint]:
        step = 0.2 * self.max_step
        while self.ended is None:
            before = self.last
            ahead = self._step(before, step)
            if ahead is None:
                yield from self._along()
                step = 0.2 * self.max_step
                continue
            self.last, self.left = ahead, self.left - 1
            step = ahead.parameter - before.parameter
            step = min(self.max_step, (1.7 if ahead.iterations <= 4 else 1.0) * step)
            if ahead.parameter == self.end:
                self.ended = Ended.MET
            elif not self.left:
                self.ended = Ended.MANY
            yield ahead

    def _along(self) -> Iterator[PathPoint]:
        """By arc-length, until steps in the parameter may lead on."""
        family, here = self.family, self.last
        options = PathOptions(
            initial_step=0.2 * self.max_step,
            max_step=self.max_step,
            max_steps=self.left,
            span=(self.lowest, np.inf),
        )
        start = point_on_path(family, here.unknown, here.parameter)
        path = Path(family, start, options, [Target(self.end)])
        for point in path.points():
            self.last, self.left = point, self.left - 1
            yield point
            outside = point.tangent.p > 0.0 and point.parameter > here.parameter
            whole = family.is_fundamental(point.unknown)
            if outside and whole and path.ended is None:
                return
        self.ended = path.ended

    def _step(self, here: PathPoint, step: float) -> PathPoint | None:
        """A motion of the same shape further on, about a step away; None where there is none.

        The sign of det J changes where an odd number of tongues has been passed.
        """
        family, left = self.family, self.end - here.parameter
        at = here.at or family.linearise(here.unknown, here.parameter)
        slope = -at.solve(at.by_parameter)
        near = family.near(here.unknown)
        # What grows on this side of a resonance has the opposite sign on the other one.
        across = np.where(near & (slope * here.unknown > 0.0), -here.unknown, here.unknown)
        slope[near] = 0.0
        steepness = math.sqrt(float(slope @ slope) / float(here.unknown @ here.unknown))
        step = min(step, self.max_step / math.hypot(1.0, steepness), left)
        trials = (
            *((here.unknown, factor, 0.99) for factor in (1.0, 0.5, 0.25)),
            *((across, factor, 0.95) for factor in (0.25, 0.5, 1.0, 2.0, 4.0)),
            *((here.unknown, factor, 0.99) for factor in (0.1, 0.03, 0.01)),
        )
        for base, factor, cosine in trials:
            rise = min(factor * step, left)
            if rise <= min(ARRIVED, 0.5 * left):  # ever shorter up to where no shape is the same
                continue
            parameter = self.end if rise == left else here.parameter + rise
            guess = base + rise * slope
            found = solve_motion(family, guess, parameter)
            if found is None or not family.is_fundamental(found.unknown):
                continue
            if same_shape(found.unknown, guess, cosine):
                assert found.at is not None
                return replace(found, crosses_branch=found.at.sign != at.sign)
        return None


def same_shape(unknown: np.ndarray, other: np.ndarray, cosine: float) -> bool:
    """Return True if two motions have the same shape."""
    one, two = unknown[:-1], other[:-1]
    return bool(one @ two > cosine * np.linalg.norm(one) * np.linalg.norm(two))


def first_motion(family: FreeMotion, mode: int, energy: float) -> tuple[PathPoint, str]:
    """Return the first point of a backbone, from the linear mode, and a note about it."""
    stiff, note = FreeMotion(family.rest, family.integrals, family.reference, energy), ""
    try:
        found = _from_linear_mode(stiff, mode)
    except ConvergenceError:
        begun = _from_fewer_harmonics(stiff, mode)
        if begun is None:
            raise
        found, note = begun
    start = replace(found, parameter=math.log(energy), iterations=0, crosses_branch=False, at=None)
    return start, note


def _from_linear_mode(family: FreeMotion, mode: int) -> PathPoint:
    """From the linear mode without contact to the whole contact stiffness at one energy."""
    rest, count = family.rest, len(family.rest.frequencies)
    unknown = np.zeros((family.harmonics + 1) * count + 1)
    opens = rest.modes.pairs[mode - 1].sum() <= 0.0  # where it is positive
    unknown[count + mode - 1], unknown[-1] = (1.0 if opens else -1.0), 1.0
    soft = min(0.0, math.log(SOFT / max(rest.stiffness, SOFT)))
    first = solve_motion(family, unknown, soft)
    if first is None:
        raise ConvergenceError(f"backbone of mode {mode}: no motion with soft contact")
    if soft == 0.0:
        return first
    path = MotionPath(family, first, 0.0, lowest=soft - 5.0, max_step=1.0, left=400)
    furthest = max((motion.parameter for motion in path), default=soft)
    if path.complete:
        return path.last
    far = f"the path in the contact stiffness came as far as {math.exp(furthest):.2g} of it"
    raise ConvergenceError(
        f"backbone of mode {mode}: {ELSEWHERE if path.ended is Ended.MET else far}; {HELPS}"
    )


def _from_fewer_harmonics(family: FreeMotion, mode: int) -> tuple[PathPoint, str] | None:
    """The motion to which the path with fewer harmonics leads, and with how many; None where none
    of these does."""
    for fewer in halved(family.harmonics, 1)[:-1]:
        with suppress(ConvergenceError):
            begun = _from_linear_mode(family.with_harmonics(fewer), mode).unknown
            found = _with_the_others(family, begun, fewer)
            if found is not None:
                return found, f", from the linear mode with {fewer} of its harmonics"
    return None


def _with_the_others(family: FreeMotion, unknown: np.ndarray, harmonics: int) -> PathPoint | None:
    """A motion with all of its harmonics, from one with fewer, by Newton's method; numbers of
    harmonics with which there is none like it are left out."""
    found = None
    for count in range(harmonics + 1, family.harmonics + 1):
        larger = family.with_harmonics(count)
        guess = np.zeros(larger.scale.size + 1)
        guess[: len(unknown) - 1], guess[-1] = unknown[:-1], unknown[-1]
        found = solve_motion(larger, guess, 0.0)
        if found and not (
            larger.is_fundamental(found.unknown) and same_shape(found.unknown, guess, STRAIGHT)
        ):
            found = None
        unknown = unknown if found is None else found.unknown
    return found
