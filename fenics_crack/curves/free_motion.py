"""The equations of free motions; see :mod:`backbone`."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.condensed import CondensedSystem, determinant_sign
from fenics_crack.balance.contact_integrals import (
    ContactIntegrals,
    apply_to_pairs,
    contact_integrals,
)
from fenics_crack.balance.rounding import EPSILON, ROUNDING
from fenics_crack.balance.search import Search
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modal import AllModes, all_modes
from fenics_crack.model.structure import Structure

__all__ = ["EnergyMotion", "Equilibrium", "FreeMotion", "StiffnessMotion", "cosine_rows"]


RESONANT = 1e-3
"""|omega_j^2 - (k w)^2| relative to the sum below which an entry is kept, not eliminated."""


NEAR = 0.05
"""Entries relatively that close to resonance are not predicted."""


class Equilibrium:
    """Where a structure rests without load, held or closed by its pairs alone."""

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        self.contact = contact
        self.modes: AllModes = all_modes(structure)
        squares = self.modes.squares
        if not squares[0] > 1e-12 * squares[-1]:
            raise InputError(
                "structure",
                f"lowest eigenvalue {squares[0]:.3g} 1/s^2",
                "fixed, so that it cannot move as a rigid body",
            )
        self.frequencies = np.sqrt(squares)
        compliance = ModalCompliance(structure, 0.0, np.zeros((1, structure.n_local)))
        search = Search(ROUNDING)
        system = CondensedSystem(compliance, contact_integrals(contact, 0))
        found = search.penalty(system, system.linear)
        if not search.converged:
            raise ConvergenceError(f"equilibrium without load: {search.status}", search.history)
        self.gap = found[0]
        self.force = contact.force(self.gap)
        self.modal = -(self.modes.pairs @ self.force) / squares
        held = _work(contact, np.zeros_like(self.gap), self.gap, 0.0 * self.force)
        self.energy = 0.5 * float(squares @ self.modal**2) + held
        static = compliance.matrices[0].real
        self.stiffness = float(np.abs(static).sum(axis=1).max(initial=0.0))
        self.stiffness *= float(np.max(contact.stiffness, initial=0.0))
        """Largest k R, static."""


def _work(law: ContactLaw, gap: np.ndarray, change: np.ndarray, less: np.ndarray) -> float:
    """Integral of lambda - less over the gaps (n_pairs,) from ``gap`` on, of all pairs [J].

    Gauss's rule on both sides of g = 0: exact for piecewise polynomials.
    """
    nodes, weights = _gauss()
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(np.nan_to_num(-gap / change, posinf=0.0, neginf=0.0), 0.0, 1.0)
    total = np.zeros_like(gap)
    for start, length in ((0.0 * share, share), (share, 1.0 - share)):
        at = start + length * nodes[:, None]
        total += length * (weights @ (law.force(gap + at * change) - less))
    return float(total @ change)


@lru_cache(maxsize=1)
def _gauss() -> tuple[np.ndarray, np.ndarray]:
    """Gauss's 32 nodes between 0 and 1, and their weights."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def cosine_rows(harmonics: int) -> np.ndarray:
    """Places of a0, a1, a2, ... among the rows a0, a1, b1, ...."""
    return np.maximum(2 * np.arange(harmonics + 1) - 1, 0)


class FreeMotion:
    """F(x) = 0 for x = (z_00, ..., z_0n, z_10, ..., z_Hn, w / reference), at an energy.

    Row (k, j) is divided by (omega_j^2 + (k reference)^2) a / omega_j, the last one by E: they are
    numbers. ``share`` multiplies the contact force. Motions with less than ``least_fundamental`` of
    the first harmonic are a tongue's: another mode's.
    """

    least_fundamental: float

    def __init__(self, rest: Equilibrium, integrals: ContactIntegrals, reference: float) -> None:
        self.rest, self.reference = rest, reference
        self.energy, self.share = 1.0, 1.0
        self.rounding = max(ROUNDING, EPSILON * rest.stiffness)
        self.harmonics = integrals.harmonics
        self._integrals = integrals
        self._rows = cosine_rows(integrals.harmonics)
        self._squares = rest.modes.squares
        self._order = (np.arange(integrals.harmonics + 1.0) * reference)[:, None] ** 2
        self._scale = 1.0 / (self._squares + self._order)
        self._left = self._scale * rest.frequencies
        self.gap_rows = rest.modes.pairs / rest.frequencies[:, None]
        """d (gap / a) / dz: (n_modes, n_pairs)."""
        self._at: np.ndarray | None = None

    @property
    def amplitude(self) -> float:
        """a."""
        return math.sqrt(2.0 * self.energy)

    def _evaluate(self, unknown: np.ndarray) -> None:
        """Contact force, its tangent and the work that went into it, where not known yet."""
        if self._at is not None and np.array_equal(unknown, self._at):
            return
        rest, rows, scale = self.rest, self._rows, self.amplitude
        z = unknown[:-1].reshape(len(rows), -1)
        moved = scale * (z @ self.gap_rows)
        gap = np.zeros((2 * len(rows) - 1, moved.shape[1]))
        gap[rows] = moved
        gap[0] += rest.gap
        force, tangent = self._integrals.linearise(gap)
        self._force = force[rows]
        self._force[0] -= rest.force
        self._force *= self.share / scale
        self._tangent = self.share * tangent[:, rows[:, None], rows]
        first = moved.sum(axis=0)
        law = rest.contact
        self._push = (self.share / scale) * (law.force(rest.gap + first) - rest.force)
        self._work = self.share * _work(law, rest.gap, first, rest.force) / self.energy
        self._change = moved / scale
        self._at = unknown.copy()

    def _stiffness(self, unknown: np.ndarray) -> np.ndarray:
        """Scaled omega_j^2 - (k w)^2: (H+1, n_modes)."""
        return (self._squares - self._order * unknown[-1] ** 2) * self._scale

    def _join(self, blocks: np.ndarray, last: float) -> np.ndarray:
        return np.append(blocks.ravel(), last)

    def residual(self, unknown: np.ndarray) -> np.ndarray:
        """F(x)."""
        self._evaluate(unknown)
        z = unknown[:-1].reshape(self._scale.shape)
        blocks = self._stiffness(unknown) * z
        blocks += self._left * (self._force @ self.rest.modes.pairs.T)
        first = z.sum(axis=0)
        return self._join(blocks, float(first @ first) + self._work - 1.0)

    def linearise(self, unknown: np.ndarray) -> None:
        """Evaluate J, reduced to the gaps, the resonant entries and w."""
        self._evaluate(unknown)
        pairs, right, tangent = self.rest.modes.pairs, self.gap_rows, self._tangent
        z = unknown[:-1].reshape(self._scale.shape)
        stiffness = self._stiffness(unknown)
        resonant = np.abs(stiffness) < RESONANT
        inverse = np.where(resonant, 0.0, 1.0 / np.where(resonant, 1.0, stiffness))
        at, which = np.nonzero(resonant)
        column = -2.0 * unknown[-1] * self._order * self._scale * z
        row = 2.0 * (z.sum(axis=0) + right @ self._push)
        n_rows, n_pairs, kept = len(z), pairs.shape[1], len(at)
        gaps = n_rows * n_pairs
        matrix = np.zeros((gaps + kept + 1, gaps + kept + 1))
        # The gaps: 1 + R T, R the compliance without the resonant entries.
        compliance = np.matmul(right.T * (inverse * self._left)[:, None, :], pairs)
        by_row = tangent.transpose(1, 2, 0)[:, None]
        matrix[:gaps, :gaps] = (compliance[:, :, None, :] * by_row).reshape(gaps, gaps)
        matrix.flat[: gaps * (len(matrix) + 1) : len(matrix) + 1] += 1.0
        place = at[:, None] * n_pairs + np.arange(n_pairs)
        matrix[place, gaps + np.arange(kept)[:, None]] = -right[which]
        matrix[:gaps, -1] = ((inverse * column) @ right).ravel()
        # The resonant entries.
        drive = (self._left[resonant][:, None] * pairs[which])[:, None, :]
        matrix[gaps:-1, :gaps] = (drive * tangent[:, at].transpose(1, 2, 0)).reshape(kept, gaps)
        matrix[gaps + np.arange(kept), gaps + np.arange(kept)] = stiffness[resonant]
        matrix[gaps:-1, -1] = column[resonant]
        # The energy.
        through = (row * inverse * self._left) @ pairs
        matrix[-1, :gaps] = -np.einsum("kq,qkl->lq", through, tangent).ravel()
        matrix[-1, gaps:-1] = row[which]
        matrix[-1, -1] = -np.sum(row * inverse * column)
        lu, pivots, _ = dgetrf(matrix)
        self._factors = lu, pivots
        self._parts = inverse, resonant, column, row
        flips = np.count_nonzero(stiffness[~resonant] < 0.0)
        self._sign = determinant_sign(self._factors) * (-1.0 if flips % 2 else 1.0)

    def solve_jacobian(self, residual: np.ndarray) -> np.ndarray:
        """J^-1 r."""
        inverse, resonant, column, row = self._parts
        blocks = residual[:-1].reshape(inverse.shape)
        free = inverse * blocks
        seen = (free @ self.gap_rows).ravel()
        last = residual[-1] - np.sum(row * free)
        found, _ = dgetrs(*self._factors, np.concatenate([seen, blocks[resonant], [last]]))
        n_pairs = self.gap_rows.shape[1]
        force = apply_to_pairs(self._tangent, found[: len(seen)].reshape(-1, n_pairs))
        change = blocks - self._left * (force @ self.rest.modes.pairs.T) - column * found[-1]
        change *= inverse
        change[resonant] = found[len(seen) : -1]
        return self._join(change, found[-1])

    def determinant_sign(self) -> float:
        """Sign of det J where :meth:`linearise` was called last."""
        return self._sign

    def near(self, unknown: np.ndarray) -> np.ndarray:
        """Which entries of x are close to resonance, the fundamental ones left out."""
        close = np.abs(self._stiffness(unknown)) < NEAR
        close[1] = False
        return np.append(close.ravel(), False)

    def fundamental(self, unknown: np.ndarray) -> float:
        """Share of the first harmonic in the square of z, the mean left out."""
        z = unknown[:-1].reshape(self._scale.shape)
        return float(np.sum(z[1] ** 2) / max(np.sum(z[1:] ** 2), 1e-300))

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return float(first @ second)

    def newton(self, unknown: np.ndarray) -> tuple[np.ndarray | None, int]:
        """Solution near an unknown by full steps, or None, and their number."""
        for iterations in range(12):
            residual = self.residual(unknown)
            size = np.linalg.norm(residual) / np.linalg.norm(unknown)
            if size <= max(1e-12, self.rounding):
                return unknown, iterations
            if not np.isfinite(size):
                break
            self.linearise(unknown)
            unknown = unknown - self.solve_jacobian(residual)
        return None, iterations


class StiffnessMotion(FreeMotion):
    """Free motions of one energy; the parameter is ln of the share of the contact stiffness."""

    least_fundamental = 0.25

    def set_parameter(self, parameter: float) -> None:
        """Set ln share."""
        if math.exp(parameter) != self.share:
            self.share, self._at = math.exp(parameter), None

    def parameter_derivative(self, unknown: np.ndarray) -> np.ndarray:
        """dF / d ln share."""
        self._evaluate(unknown)
        return self._join(self._left * (self._force @ self.rest.modes.pairs.T), self._work)


class EnergyMotion(FreeMotion):
    """Free motions; the parameter is ln E."""

    least_fundamental = 0.02

    def set_parameter(self, parameter: float) -> None:
        """Set ln E."""
        if math.exp(parameter) != self.energy:
            self.energy, self._at = math.exp(parameter), None

    def parameter_derivative(self, unknown: np.ndarray) -> np.ndarray:
        """dF / d ln E: of b(g_e + a c) / a, with da = a / 2, and of the work over E."""
        self._evaluate(unknown)
        change = 0.5 * (apply_to_pairs(self._tangent, self._change) - self._force)
        blocks = self._left * (change @ self.rest.modes.pairs.T)
        return self._join(blocks, float(self._push @ self._change.sum(axis=0)) - self._work)
