"""Stability of periodic solutions: Floquet multipliers of the flow between switching instants.

Between two switching instants the structure is linear. In its modal coordinates, with z = (q, q'),

    z' = A z,   A = [ 0               I  ]
                    [ -(W^2 + b k b^T) -c ],     b, k: pairs closed there,

and since the contact force is continuous where a pair opens or closes, small disturbances of a
period are multiplied by the monodromy matrix, the product of matrix exponentials

    M = exp(A_m tau_m) ... exp(A_1 tau_1).

Its eigenvalues, the multipliers, lie within the unit circle where the solution is stable; their
product is exp(-T tr c). As a check Hill's determinant is solved for the leading one, condensed
onto the pairs:

    det( I + R(s) kappa ) = 0,       mu = exp(s T),

with the compliance R at s + i k w, k = -H..H, and the harmonics kappa of the contact stiffness.

Sources: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004,
chapter 7; Lazarus and Thomas, Comptes Rendus Mecanique 338, 2010, 510-517.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from fenics_crack.balance.condensed import CondensedSystem
from fenics_crack.balance.contact_integrals import SampledIntegrals, closed_means
from fenics_crack.balance.error_report import beyond_truncation
from fenics_crack.balance.fourier import evaluate, resized, to_complex
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.balance.switching import switching_instants
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.contact import ContactLaw, check_law, is_piecewise_linear
from fenics_crack.model.modal import AllModes, all_modes, flow_matrix, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.stability.eigenbasis import Eigenbasis, UndampedModes, eigenbasis, undamped_modes
from fenics_crack.stability.shooting import shoot

__all__ = ["LeadingMultiplier", "PiecewiseFlow", "Stability", "doubling_test", "floquet"]

SMOOTH_INTERVALS = 512
"""In a period, for laws that are not linear in contact."""
LONGEST_PERIOD = 1e12
"""Times the highest natural frequency, beyond which rounding leaves nothing of the motion."""
FEW_PAIRS = 4
"""Up to so many, shooting takes seconds at most; many pairs switch too often."""
MAX_KEPT = 256
"""Changes of basis, and undamped modes with pairs closed, that are kept."""
BLOCK, FULL = 8, 40
"""Columns of a subspace in which the leading multiplier is sought; up to so many multipliers, all
are computed at once."""
SQUARINGS = (4, 7, 9, 11)
"""Of M, after which it is sought."""
MAX_SECANTS = 12
FARTHEST = 0.05
"""From a multiplier's exponent to the root of Hill's determinant, relative to the frequency."""


def floquet(
    structure: Structure,
    solution: PeriodicSolution,
    contact: ContactLaw | None = None,
    *,
    refine: bool = True,
) -> Stability:
    """Floquet multipliers of a solution.

    Parameters
    ----------
    structure : Structure
        The solution's; at most 600 dofs, else reduce it before solving.
    solution : PeriodicSolution
        The orbit.
    contact : ContactLaw, optional
        Its law; default: the solution's own.
    refine : bool
        Where harmonics leave the verdict open, the law is the penalty and there are at most four
        pairs, refine the orbit by shooting on the exact flow (:func:`shoot`) and judge by its
        multipliers.

    Raises
    ------
    InputError
        The structure is too large, or contact is not given by a law of the gap.
    """
    if contact is None:
        contact = solution.contact  # type: ignore[assignment]
    check_law(structure, contact)
    assert contact is not None
    if not is_small(structure):
        raise InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
    if solution.structure.n_dofs != structure.n_dofs:
        raise InputError("solution", f"{solution.structure.n_dofs} dofs", "of this structure")
    flow = PiecewiseFlow(structure, contact)
    multipliers = flow.multipliers(solution.gap_coefficients, solution.base_omega)
    largest = float(np.abs(multipliers[0]))
    wider = flow.multipliers(_wider(structure, solution, contact), solution.base_omega)
    hill = _hill(structure, solution, contact, multipliers[0])
    known = np.abs(np.array([largest, wider[0], hill]))
    verdict = "undecided"
    if np.all(known < 1.0 - 1e-9):
        verdict = "stable"
    elif np.all(known > 1.0 + 1e-9):
        verdict = "unstable"
    elif refine and is_piecewise_linear(contact) and structure.n_pairs <= FEW_PAIRS:
        return _refined(structure, solution, contact) or Stability(multipliers, verdict, np.nan)
    return Stability(multipliers, verdict, float(np.abs(known - largest).max()))


def _refined(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw
) -> Stability | None:
    """Judge by the exact orbit next to a solution; None where there is none."""
    try:
        orbit = shoot(structure, solution, contact)
    except ConvergenceError:
        return None
    gap = solution.gap(np.arange(len(orbit.gap)) * solution.period / len(orbit.gap))
    distance = np.linalg.norm(orbit.gap - gap) / np.linalg.norm(orbit.gap)
    if distance > min(0.25, max(0.05, 5.0 * solution.report.truncation)):
        return None  # another orbit
    largest = abs(orbit.multipliers[0])
    verdict = "undecided"
    if abs(largest - 1.0) > 1e-7:
        verdict = "stable" if largest < 1.0 else "unstable"
    return Stability(orbit.multipliers, verdict, 1e-7, refined=True)


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
    """

    def __init__(self, structure: Structure, contact: ContactLaw) -> None:
        self._modes: AllModes = all_modes(structure)
        self._contact = contact
        self._pairs = structure.n_pairs
        self._scale = float(np.sqrt(np.abs(self._modes.squares).max())) or 1.0
        self._undamped: dict[bytes, UndampedModes] = {}
        self._bases: dict[bytes, Eigenbasis | None] = {}
        self._changes: dict[tuple[bytes, bytes], np.ndarray] = {}

    def varied(self, structure: Structure, contact: ContactLaw) -> PiecewiseFlow:
        """The flow of a varied structure or law; it shares the undamped modes that stay."""
        other = PiecewiseFlow(structure, contact)
        one, two = self._modes, other._modes
        if np.array_equal(one.squares, two.squares) and np.array_equal(one.pairs, two.pairs):
            other._undamped = self._undamped
        return other

    def multipliers(self, gap: np.ndarray, base_omega: float) -> np.ndarray:
        """Eigenvalues of the monodromy matrix, largest modulus first: (2n,) complex; or nan.

        ``gap`` are the coefficients of the orbit, (2H+1, n_pairs) [m]; ``base_omega`` [rad/s] is
        its frequency.
        """
        product: np.ndarray = np.full((2 * len(self._modes.squares),) * 2, np.nan)
        if self._scale * 2.0 * np.pi / base_omega < LONGEST_PERIOD:
            product = self._product(gap, base_omega)[0]
        if not np.all(np.isfinite(product)):
            return product[0] + 0j * np.nan
        found = np.linalg.eigvals(product)
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
            found = np.linalg.eigvals(product)
            value = complex(found[np.argmax(np.abs(found))])
        doubling = float(np.sign(doubling_test(product)))
        return LeadingMultiplier(complex(value.real, abs(value.imag)), doubling)

    def doubling(self, gap: np.ndarray, base_omega: float) -> float:
        """det(I + M): it changes its sign where a multiplier passes through -1."""
        return doubling_test(self._product(gap, base_omega)[0])

    def growth(self, gap: np.ndarray, base_omega: float) -> float:
        """Modulus of the leading multiplier less one, to locate where it vanishes."""
        product = self._product(gap, base_omega)[0]
        value = _leading(product, proven=False) if len(product) > FULL else None
        return float(np.abs(np.linalg.eigvals(product) if value is None else value).max()) - 1.0

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
        product: np.ndarray = np.eye(2 * len(self._modes.squares))
        if any(basis is None for basis in bases):
            for (stiffness, duration), basis in zip(intervals, bases, strict=True):
                if basis is None:
                    matrix = flow_matrix(self._modes, stiffness, self._scale)
                    product = scipy.linalg.expm(duration * matrix) @ product
                else:
                    product = basis.vectors @ basis.advance(duration, basis.inverse @ product)
            return product, None
        for place, (basis, (_, duration)) in enumerate(zip(bases, intervals, strict=True)):
            assert basis is not None
            if place > 0:
                product = self._change(keys[place - 1], keys[place]) @ product
            product = basis.advance(duration, product)
        if keys[-1] != keys[0]:
            product = self._change(keys[-1], keys[0]) @ product
        return product, bases[0]

    def _intervals(self, gap: np.ndarray, base_omega: float) -> list[tuple[np.ndarray, float]]:
        """Contact stiffness of the pairs, and for how long, in order."""
        period = 2.0 * np.pi / base_omega
        if not is_piecewise_linear(self._contact):
            time = (np.arange(SMOOTH_INTERVALS) + 0.5) * period / SMOOTH_INTERVALS
            slopes = self._contact.tangent(evaluate(gap, base_omega, time))
            return [(slope, period / SMOOTH_INTERVALS) for slope in slopes]
        switching = switching_instants(to_complex(gap))
        stiffness = np.broadcast_to(np.asarray(self._contact.stiffness, float), (self._pairs,))
        order = np.argsort(switching.theta, kind="stable")
        closed = switching.closed_at_start.copy()
        intervals, reached = [], 0.0
        for index in order:
            theta = switching.theta[index]
            intervals.append((closed * stiffness, (theta - reached) / base_omega))
            closed = closed.copy()
            closed[switching.pair[index]] = switching.closing[index] > 0.0
            reached = theta
        intervals.append((closed * stiffness, (2.0 * np.pi - reached) / base_omega))
        return intervals

    def _basis(self, stiffness: np.ndarray) -> Eigenbasis | None:
        """Basis of the flow with contact springs; None where there is no good one."""
        if not is_piecewise_linear(self._contact):
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


def _wider(structure: Structure, solution: PeriodicSolution, contact: ContactLaw) -> np.ndarray:
    """The gap improved by a Newton step with more harmonics."""
    problem = Problem(
        structure, solution.omega, contact, solution.harmonics, subharmonic=solution.subharmonic
    )
    compliance, gap = problem.compliance(), solution.gap_coefficients
    change = beyond_truncation(CondensedSystem(compliance, problem.integrals()).linearise(gap))
    compliance.destroy()
    return resized(gap, len(change) // 2) + change


def _hill(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw, multiplier: complex
) -> complex:
    """The root of Hill's condensed determinant next to a multiplier, as a multiplier; nan if none.

    D(s) = I + R(s) kappa is singular where f(s) vanishes in

        [ D(s)  b ] [x]   [0]
        [ a^T   0 ] [f] = [1],

    with a, b from a step of inverse iteration at the multiplier. Found by SciPy's secants.
    """
    means = _stiffness_means(solution.gap_coefficients, contact, 2 * solution.harmonics)
    if not np.any(means):
        return multiplier  # no contact: the monodromy matrix is that of the linear structure
    omega = solution.base_omega
    start = complex(np.log(complex(multiplier)) / solution.period)

    def matrix(exponent: complex) -> np.ndarray:
        return _hill_matrix(all_modes(structure), means, exponent, omega)

    try:
        first = matrix(start)
        size = len(first)
        bordered, last = np.zeros((size + 1, size + 1), complex), np.eye(size + 1)[-1]
        random = np.random.default_rng(0).normal(size=size)
        for vector, side in ((bordered[:size, -1], first.T), (bordered[-1, :size], first)):
            found = np.linalg.solve(side, random)
            vector[:] = found.conj() / np.linalg.norm(found)

        def bordering(exponent: complex) -> complex:
            if not abs(exponent - start) < FARTHEST * omega:
                return complex(np.nan)
            bordered[:size, :size] = matrix(exponent)
            return complex(np.linalg.solve(bordered, last)[-1])

        with np.errstate(invalid="ignore", divide="ignore"):  # NaN: too far from the start
            root, report = scipy.optimize.newton(
                bordering, start, x1=start + 1e-7 * omega, tol=1e-10 * omega, maxiter=MAX_SECANTS,
                full_output=True, disp=False,
            )  # fmt: skip
    except np.linalg.LinAlgError:
        return complex(np.nan)
    return complex(np.exp(root * solution.period)) if report.converged else complex(np.nan)


def _hill_matrix(modes: AllModes, means: np.ndarray, exponent: complex, omega: float) -> np.ndarray:
    """I + R(s) kappa for rows (harmonic -H..H, pair), from the harmonics of the stiffness."""
    harmonics, pairs = means.shape[1] // 2, len(means)
    order = np.arange(-harmonics, harmonics + 1)
    lag = order[:, None] - order
    coupling = np.where(lag[None] >= 0, means[:, np.abs(lag)].conj(), means[:, np.abs(lag)])
    points = exponent + 1j * order * omega
    if modes.damping.ndim == 1:
        receptance = 1.0 / (modes.squares + points[:, None] ** 2 + points[:, None] * modes.damping)
        compliance = np.einsum("jp,kj,jq->kpq", modes.pairs, receptance, modes.pairs)
    else:
        impedance = points[:, None, None] * modes.damping + np.zeros((1, 1, 1), complex)
        diagonal = np.arange(len(modes.squares))
        impedance[:, diagonal, diagonal] += modes.squares + points[:, None] ** 2
        compliance = modes.pairs.T @ np.linalg.inv(impedance) @ modes.pairs
    product = np.einsum("kpq,qkl->kplq", compliance, coupling)
    size = len(order) * pairs
    return np.eye(size) + product.reshape(size, size)


def _stiffness_means(gap: np.ndarray, contact: ContactLaw, highest: int) -> np.ndarray:
    """Means of the contact stiffness times exp(i m theta): (n_pairs, highest + 1)."""
    if is_piecewise_linear(contact):
        stiffness = np.broadcast_to(np.asarray(contact.stiffness, float), gap.shape[1:])
        means = closed_means(switching_instants(to_complex(gap)), highest)
        return stiffness[:, None] * means
    samples = max(1024, 8 * highest)
    sampled = SampledIntegrals(contact, highest, samples)
    slopes = contact.tangent(sampled.sample(resized(gap, highest)))
    return np.fft.rfft(slopes, axis=0)[: highest + 1].T.conj() / samples
