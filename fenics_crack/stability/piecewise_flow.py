"""The linear flow along a periodic wave of the gaps, and its Floquet multipliers.

Between two switching instants the structure is linear. In its modal coordinates, with z = (q, q'),

    z' = A z,   A = [ 0               I  ]
                    [ -(W^2 + b k b^T) -c ],     b, k: pairs closed there,

and since the contact force is continuous where a pair opens or closes, small disturbances of a
period are multiplied by the monodromy matrix, the product of matrix exponentials

    M = exp(A_m tau_m) ... exp(A_1 tau_1).

Source: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004,
chapter 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg

from fenics_crack.balance.active_sets import contact_intervals
from fenics_crack.balance.coupled_integrals import CoupledIntegrals
from fenics_crack.balance.fourier import evaluate, to_complex
from fenics_crack.balance.switching import switching_instants
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear, is_rigid
from fenics_crack.model.coupled import ActiveSets, smooth_forces, unique_sets
from fenics_crack.model.modal import AllModes, all_modes, flow_matrix
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import eigenvalues
from fenics_crack.stability.eigenbasis import (
    Eigenbasis,
    UndampedModes,
    advance_all,
    eigenbasis,
    undamped_modes,
)

__all__ = ["LeadingMultiplier", "PiecewiseFlow", "doubling_test"]

SMOOTH_INTERVALS = 512
"""In a period, for laws that are not linear in contact."""
LONGEST_PERIOD = 1e12
"""Times the highest natural frequency, beyond which rounding leaves nothing of the motion."""
TOGETHER = 1_000_000
"""Numbers of the flows over intervals that are made at once."""
MAX_KEPT = 256
"""Changes of basis, and undamped modes with pairs closed, that are kept."""
BLOCK, FULL = 8, 40
"""Columns of a subspace in which the leading multiplier is sought; up to so many multipliers, all
are computed at once."""
SQUARINGS = (4, 7, 9, 11)
"""Of M, after which it is sought."""


@dataclass(frozen=True)
class LeadingMultiplier:
    """What a curve needs of the monodromy matrix M at each of its points.

    Attributes
    ----------
    value : complex
        The multiplier of largest modulus; of a pair the one with positive imaginary part.
    doubling : float
        Sign of det(I + M): it changes where a multiplier passes through -1.
    """

    value: complex
    doubling: float

    @property
    def stable(self) -> bool:
        """Whether it lies within the unit circle."""
        return abs(self.value) < 1.0


class PiecewiseFlow:
    """The linear flows between switching instants of one structure and one contact law.

    While a set of pairs is closed, the flow is made of decaying rotations in a real basis
    (:mod:`eigenbasis`). So the product over a period needs, at every switching instant, one real
    matrix V_next^-1 V, which is computed once for a curve: a point costs one product of real
    matrices for each switching instant, and the eigenvalues of M: all of them
    (:meth:`multipliers`), or the leading one for a fraction of that (:meth:`leading`).

    Where pairs are seen through a static compliance (:class:`fenics_crack.Problem`), closed pairs
    are tied by the springs S_A between them (:mod:`fenics_crack.model.coupled`), and the wave is
    that of the slow gap.

    Parameters
    ----------
    structure : Structure
        Small or reduced.
    contact : ContactLaw
        Its law.
    static_above : float, optional
        Frequency [rad/s] above which modes answer at once; as a solution or a curve has it.
    """

    def __init__(
        self, structure: Structure, contact: ContactLaw, static_above: float | None = None
    ) -> None:
        modes = all_modes(structure)
        self._modes: AllModes = modes if static_above is None else modes.below(static_above)
        self._sets: ActiveSets | None = None
        if static_above is not None and (is_piecewise_linear(contact) or is_rigid(contact)):
            residual = modes.static_part(static_above)
            self._sets = CoupledIntegrals(contact, residual, 0).contact
        self._smooth = None
        if static_above is not None and self._sets is None:
            self._smooth = CoupledIntegrals(contact, modes.static_part(static_above), 0)
        self._above = static_above
        self._contact = contact
        self._pairs = structure.n_pairs
        self._stiffness = np.asarray(contact.stiffness, dtype=float)
        self._unit = np.eye(2 * len(self._modes.squares))
        self._scale = float(np.sqrt(np.abs(self._modes.squares).max())) or 1.0
        self._undamped: dict[bytes, UndampedModes] = {}
        self._bases: dict[bytes, Eigenbasis | None] = {}
        self._changes: dict[tuple[bytes, bytes], np.ndarray] = {}

    def varied(self, structure: Structure, contact: ContactLaw) -> PiecewiseFlow:
        """The flow of a varied structure or law; it shares the undamped modes that stay."""
        other = PiecewiseFlow(structure, contact, self._above)
        one, two = self._modes, other._modes
        if np.array_equal(one.squares, two.squares) and np.array_equal(one.pairs, two.pairs):
            other._undamped = self._undamped
        return other

    def multipliers(self, gap: np.ndarray, base_omega: float) -> np.ndarray:
        """Eigenvalues of the monodromy matrix, largest modulus first: (2n,) complex; or nan.

        ``gap`` are the coefficients of the orbit, (2H+1, n_pairs) [m], of the slow gap where pairs
        are coupled; ``base_omega`` [rad/s] is its frequency.
        """
        product: np.ndarray = np.full((2 * len(self._modes.squares),) * 2, np.nan)
        if self._scale * 2.0 * np.pi / base_omega < LONGEST_PERIOD:
            product = self._product(gap, base_omega)[0]
        if not np.all(np.isfinite(product)):
            return product[0] + 0j * np.nan
        found = eigenvalues(product)
        return found[np.argsort(-np.abs(found), kind="stable")]

    def leading(self, gap: np.ndarray, base_omega: float) -> LeadingMultiplier:
        """The leading multiplier, to 1e-8, at a fraction of the cost of all of them.

        Arguments as of :meth:`multipliers`. The matrices M^2, M^4, ... turn a few columns towards
        the leading eigenvectors. In their span M has the leading multiplier mu where

            |M v - mu v| < 1e-10 |mu v|;

        mu is taken where it lies outside the unit circle, or |M^m| < 1 proves that all lie within.
        Where that is not reached all are computed.

        Source: Saad, Numerical Methods for Large Eigenvalue Problems, chapter 5 (subspace
        iteration).
        """
        product = self._product(gap, base_omega)[0]
        value = _leading(product) if len(product) > FULL else None
        if value is None:
            found = eigenvalues(product)
            value = complex(found[np.argmax(np.abs(found))])
            through = np.count_nonzero((found.imag == 0.0) & (found.real < -1.0))
            doubling = -1.0 if through % 2 else 1.0  # of det(I + M)
        else:
            doubling = float(np.sign(doubling_test(product)))
        return LeadingMultiplier(complex(value.real, abs(value.imag)), doubling)

    def doubling(self, gap: np.ndarray, base_omega: float) -> float:
        """det(I + M): it changes its sign where a multiplier passes through -1."""
        return doubling_test(self._product(gap, base_omega)[0])

    def growth(self, gap: np.ndarray, base_omega: float) -> float:
        """Modulus of the leading multiplier less one, to locate where it vanishes."""
        product = self._product(gap, base_omega)[0]
        value = _leading(product, proven=False) if len(product) > FULL else None
        return float(np.abs(eigenvalues(product) if value is None else value).max()) - 1.0

    def monodromy(self, gap: np.ndarray, base_omega: float) -> np.ndarray:
        """M over one period of the gap (2H+1, n_pairs), from phase zero: (2n, 2n).

        In coordinates (s q, q'), s a frequency that balances the two.
        """
        product, first = self._product(gap, base_omega)
        return product if first is None else first.vectors @ product @ first.inverse

    def _product(self, gap: np.ndarray, base_omega: float) -> tuple[np.ndarray, Eigenbasis | None]:
        """M in the basis that holds at phase zero, and this basis; None: in (s q, q')."""
        intervals = self._intervals(gap, base_omega)
        keys = [stiffness.tobytes() for stiffness, _ in intervals]
        bases = [self._basis(stiffness) for stiffness, _ in intervals]
        product: np.ndarray = self._unit
        if any(basis is None for basis in bases):
            for (stiffness, duration), basis in zip(intervals, bases, strict=True):
                if basis is None:
                    matrix = flow_matrix(self._modes, stiffness, self._scale)
                    product = scipy.linalg.expm(duration * matrix) @ product
                else:
                    product = basis.vectors @ basis.advance(duration, basis.inverse @ product)
            return product, None
        kept = [basis for basis in bases if basis is not None]
        durations = np.array([duration for _, duration in intervals])
        entries = [(key, key) for key in keys[:1]] + list(pairwise(keys))
        some = max(1, TOGETHER // product.size)
        for begin in range(0, len(kept), some):
            part = slice(begin, begin + some)
            changes = np.array([self._change(*two) for two in entries[part]])
            for flow in advance_all(kept[part], durations[part], changes):
                product = flow @ product
        return self._change(keys[-1], keys[0]) @ product, bases[0]

    def _intervals(self, gap: np.ndarray, base_omega: float) -> list[tuple[np.ndarray, float]]:
        """Springs on the pairs, (n_pairs,) or between them, and for how long, in order."""
        period = 2.0 * np.pi / base_omega
        if self._sets is not None:
            found = contact_intervals(gap, self._sets)
            lengths = np.diff(np.append(found.theta, 2.0 * np.pi)) / base_omega
            lasting = lengths > 0.0
            sets, which = unique_sets(found.closed[lasting])
            springs = self._sets.stack(sets)
            return [
                (springs[one], length) for one, length in zip(which, lengths[lasting], strict=True)
            ]
        if not is_piecewise_linear(self._contact):
            time = (np.arange(SMOOTH_INTERVALS) + 0.5) * period / SMOOTH_INTERVALS
            values = evaluate(gap, base_omega, time)
            if self._smooth is None:
                slopes = self._contact.tangent(values)
            else:
                slopes = smooth_forces(self._contact, self._smooth.contact.compliance, values)[1]
            return [(slope, period / SMOOTH_INTERVALS) for slope in slopes]
        switching = switching_instants(to_complex(gap))
        order = np.argsort(switching.theta, kind="stable")
        turned = np.zeros((len(order) + 1, self._pairs), dtype=bool)
        turned[0] = switching.closed_at_start
        turned[np.arange(1, len(turned)), switching.pair[order]] = True
        springs = np.logical_xor.accumulate(turned, axis=0) * self._stiffness
        ends = np.concatenate([[0.0], switching.theta[order], [2.0 * np.pi]])
        return list(zip(springs, (np.diff(ends) / base_omega).tolist(), strict=True))

    def _basis(self, stiffness: np.ndarray) -> Eigenbasis | None:
        """Basis of the flow with contact springs; None where there is no good one."""
        if self._sets is None and not is_piecewise_linear(self._contact):
            return None  # another one in each interval
        key = stiffness.tobytes()
        if key not in self._bases:
            if key not in self._undamped:
                _make_room(self._undamped)
                self._undamped[key] = undamped_modes(self._modes, stiffness)
            self._bases[key] = eigenbasis(self._modes, stiffness, self._scale, self._undamped[key])
        return self._bases[key]

    def _change(self, before: bytes, after: bytes) -> np.ndarray:
        """V_after^-1 V_before."""
        if before == after:
            return self._unit
        key = (before, after)
        if key not in self._changes:
            _make_room(self._changes)
            one, other = self._bases[before], self._bases[after]
            assert one is not None and other is not None
            self._changes[key] = other.inverse @ one.vectors
        return self._changes[key]


def _make_room(kept: dict) -> None:
    """Forget what is kept where it has become much."""
    if len(kept) >= MAX_KEPT:
        kept.clear()


def _leading(matrix: np.ndarray, *, proven: bool = True) -> complex | None:
    """The eigenvalue of largest modulus by powers of a matrix; None where they do not tell.

    ``proven``: none inside the unit circle unless all are.
    """
    columns = np.random.default_rng(0).normal(size=(len(matrix), BLOCK))
    power, logarithm = matrix, 0.0  # matrix^m = exp(logarithm) power
    for squaring in range(1, SQUARINGS[-1] + 1):
        power = power @ power
        size = float(np.linalg.norm(power))
        if not 0.0 < size < np.inf:
            return None
        power /= size
        logarithm = 2.0 * logarithm + float(np.log(size))
        if squaring not in SQUARINGS:
            continue
        columns = np.linalg.qr(power @ columns)[0]
        image = matrix @ columns
        values, vectors = np.linalg.eig(columns.T @ image)
        place = np.argmax(np.abs(values))
        value, vector = complex(values[place]), vectors[:, place]
        error = np.linalg.norm(image @ vector - value * (columns @ vector))
        if error < 1e-10 * abs(value) and (not proven or abs(value) > 1.0 or logarithm < 0.0):
            return value
    return None


def doubling_test(monodromy: np.ndarray) -> float:
    """det(I + M): changes its sign where a multiplier passes through -1."""
    sign, logarithm = np.linalg.slogdet(np.eye(len(monodromy)) + monodromy)
    return float(sign * np.exp(min(logarithm, 500.0)))
