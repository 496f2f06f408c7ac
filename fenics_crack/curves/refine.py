"""Many more points on a curve in frequency, all at once.

Between the points that were followed one by one, others are interpolated by a cubic spline over the
distance along the curve, and corrected by Newton's method across it,

    [ J      F_w ] [dg]     [F]
    [ t_g    t_w ] [dw] = - [0],

for hundreds of points in the same calls of NumPy and LAPACK: a point costs a small part of one that
is followed. The spline's error falls like the fourth power of the distance, so that one or two
iterations do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_crack.balance.compliance import load_coefficients
from fenics_crack.balance.condensed import respond_to_columns
from fenics_crack.balance.contact_integrals import contact_integrals
from fenics_crack.balance.fourier import from_complex, to_complex
from fenics_crack.balance.rounding import EPSILON
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError, check_count
from fenics_crack.model.contact import UnilateralPenalty
from fenics_crack.model.modal import AllModes, all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.stability.floquet import PiecewiseFlow

__all__ = ["refine_curve"]

TOLERANCE = 1e-9
MOST_ITERATIONS, MOST_BETWEEN = 6, 1000
MOST_NUMBERS = 4_000_000
"""In the Jacobians of the points that are treated together."""


def refine_curve(curve: ResponseCurve, between: int) -> ResponseCurve:
    """Return a curve in frequency with more points between each two.

    Parameters
    ----------
    curve : ResponseCurve
        In the parameter "omega", with at least four points.
    between : int
        Points to put between each two. Those for which Newton's method does not converge at once
        are left out.

    Raises
    ------
    InputError
        The curve is in another parameter, is too short, or its law differs from pair to pair and is
        not the penalty law.
    """
    check_count("between", between, 1)
    if between > MOST_BETWEEN:
        raise InputError("between", between, f"at most {MOST_BETWEEN}")
    if curve.parameter != "omega":
        raise InputError("curve", f"in {curve.parameter!r}", "in 'omega'")
    if len(curve) < 4:
        raise InputError("curve", f"{len(curve)} points", "at least 4")
    law = curve.contact
    if np.ndim(law.stiffness) and not isinstance(law, UnilateralPenalty):
        raise InputError("contact", law, "the penalty law, or one that is the same for all pairs")
    span = float(np.ptp(curve.omega)) or 1.0
    flat = curve.gap_coefficients.reshape(len(curve), -1)
    size = float(np.linalg.norm(flat, axis=1).mean()) or 1.0
    place = np.hstack([flat / size, curve.omega[:, None] / span])
    # Equal neighbours would have no distance.
    distance = np.maximum(np.linalg.norm(np.diff(place, axis=0), axis=1), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(distance)])
    spline = CubicSpline(along, place)
    share = np.arange(1, between + 1) / (between + 1)
    wanted = (along[:-1, None] + share * distance[:, None]).ravel()
    counts = np.repeat(np.maximum(curve.harmonics[:-1], curve.harmonics[1:]), between)

    pairs = curve.gap_coefficients.shape[2]
    gaps = np.zeros((len(wanted), *curve.gap_coefficients.shape[1:]))
    omegas, iterations = np.full(len(wanted), np.nan), np.zeros(len(wanted), dtype=int)
    for count in np.unique(counts):
        rows = 2 * int(count) + 1
        chunk = max(1, MOST_NUMBERS // (rows * pairs) ** 2)
        family = _FrequencyBatch(curve, int(count))
        chosen = np.flatnonzero(counts == count)
        for some in np.array_split(chosen, -(-len(chosen) // chunk)):
            start, slope = spline(wanted[some]), spline(wanted[some], 1)
            gap = size * start[:, :-1].reshape(len(some), -1, pairs)[:, :rows]
            omega = span * start[:, -1]
            across = slope[:, :-1].reshape(len(some), -1, pairs)[:, :rows], slope[:, -1]
            found = family.correct(gap, omega, across, size, span)
            gaps[some, :rows], omegas[some], iterations[some] = found
    return _merged(curve, along, wanted, gaps, omegas, counts, iterations)


class _FrequencyBatch:
    """The condensed equations at many frequencies at once."""

    def __init__(self, curve: ResponseCurve, harmonics: int) -> None:
        structure: Structure = curve.structure
        self._modes: AllModes = all_modes(structure)
        self._clearance = structure.clearance
        self._harmonics, self._subharmonic = harmonics, curve.subharmonic
        load = load_coefficients(structure, harmonics, curve.subharmonic)
        self._load = to_complex(load @ self._modes.shapes)
        self._law = curve.contact
        self._samples = curve.samples
        self._tolerance = TOLERANCE

    def correct(
        self,
        gap: np.ndarray,
        omega: np.ndarray,
        across: tuple[np.ndarray, np.ndarray],
        size: float,
        span: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Newton's method for gaps (n, 2H+1, n_pairs); omega is nan where it does not converge."""
        points, unknowns = len(gap), gap[0].size
        count = np.full(points, MOST_ITERATIONS)
        converged = np.zeros(points, dtype=bool)
        left = np.arange(points)
        for iteration in range(MOST_ITERATIONS + 1):
            residual, jacobian, derivative = self._linearise(gap[left], omega[left])
            size_now = np.linalg.norm(gap[left].reshape(len(left), -1), axis=1)
            small = np.linalg.norm(residual, axis=1) <= self._tolerance * size_now
            count[left[small]], converged[left[small]] = iteration, True
            left = left[~small]
            if not len(left) or iteration == MOST_ITERATIONS:
                break
            matrix = np.empty((len(left), unknowns + 1, unknowns + 1))
            matrix[:, :-1, :-1], matrix[:, :-1, -1] = jacobian[~small], span * derivative[~small]
            matrix[:, -1, :-1] = across[0][left].reshape(len(left), -1) / size
            matrix[:, -1, -1] = across[1][left]
            right = np.zeros((len(left), unknowns + 1))
            right[:, :-1] = -residual[~small]
            change = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
            gap[left] += change[:, :-1].reshape(len(left), *gap.shape[1:])
            omega[left] += span * change[:, -1]
        omega[~converged] = np.nan
        return gap, omega, count

    def _linearise(
        self, gap: np.ndarray, omega: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """F (n, m), J (n, m, m) and dF/d omega (n, m), m = (2H+1) n_pairs."""
        points, rows, pairs = gap.shape
        modes, order = self._modes, np.arange(self._harmonics + 1.0)
        base = omega / self._subharmonic
        receptance = modes.receptance(np.multiply.outer(base, order).ravel())
        receptance = receptance.reshape(points, self._harmonics + 1, *receptance.shape[1:])
        force, tangent = self._contact(gap)
        drive = _complex(force) @ modes.pairs.T - self._load
        if receptance.ndim == 3:
            matrices = np.matmul(modes.pairs.T * receptance[:, :, None, :], modes.pairs)
            moved = receptance * drive
            damped = modes.damping * moved
        else:
            matrices = modes.pairs.T @ receptance @ modes.pairs
            moved = np.matmul(receptance, drive[..., None])[..., 0]
            damped = moved @ modes.damping.T
        rate = order[:, None] * (1j * damped - 2.0 * (base[:, None, None] * order[:, None]) * moved)
        if receptance.ndim == 3:
            rate = receptance * rate
        else:
            rate = np.matmul(receptance, rate[..., None])[..., 0]
        residual = gap + _real(moved @ modes.pairs)
        residual[:, 0] += self._clearance
        derivative = -_real(rate @ modes.pairs) / self._subharmonic
        # As in search: a gap rounded to eps |g| makes a force rounded to eps k |g|.
        rounding = np.abs(matrices).sum(axis=-1).max() * np.max(self._law.stiffness)
        self._tolerance = max(TOLERANCE, min(1e-5, 4.0 * EPSILON * float(rounding)))
        jacobian = respond_to_columns(matrices, tangent)
        jacobian[:, np.arange(rows * pairs), np.arange(rows * pairs)] += 1.0
        return residual.reshape(points, -1), jacobian, derivative.reshape(points, -1)

    def _contact(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force (n, 2H+1, n_pairs) and tangent (n, n_pairs, 2H+1, 2H+1): as of n n_pairs pairs."""
        points, rows, pairs = gap.shape
        law = self._law
        if isinstance(law, UnilateralPenalty):
            law = UnilateralPenalty(np.tile(np.broadcast_to(law.stiffness, (pairs,)), points))
        integrals = contact_integrals(law, self._harmonics, self._samples, self._subharmonic)
        columns = gap.transpose(1, 0, 2).reshape(rows, points * pairs)
        force, tangent = integrals.linearise(columns)
        force = force.reshape(rows, points, pairs).transpose(1, 0, 2)
        return force, tangent.reshape(points, pairs, rows, rows)


def _complex(rows: np.ndarray) -> np.ndarray:
    """Rows (n, 2H+1, m) as complex harmonics (n, H+1, m)."""
    return to_complex(rows.transpose(1, 0, 2)).transpose(1, 0, 2)


def _real(harmonics: np.ndarray) -> np.ndarray:
    """Complex harmonics (n, H+1, m) as rows (n, 2H+1, m)."""
    return from_complex(harmonics.transpose(1, 0, 2)).transpose(1, 0, 2)


def _merged(
    curve: ResponseCurve,
    along: np.ndarray,
    wanted: np.ndarray,
    gaps: np.ndarray,
    omegas: np.ndarray,
    counts: np.ndarray,
    iterations: np.ndarray,
) -> ResponseCurve:
    """The old and the new points in order."""
    good = np.isfinite(omegas)
    order = np.argsort(np.concatenate([along, wanted[good]]), kind="stable")
    omega = np.concatenate([curve.omega, omegas[good]])[order]
    multipliers = curve.multipliers
    if multipliers is not None:
        flow = PiecewiseFlow(curve.structure, curve.contact)
        more = [
            flow.leading(gap[: 2 * count + 1], at / curve.subharmonic).value
            for gap, count, at in zip(gaps[good], counts[good], omegas[good], strict=True)
        ]
        multipliers = np.concatenate([multipliers, np.array(more)])[order]
    unknown = np.full(good.sum(), np.nan)
    return replace(
        curve,
        values=omega,
        omega=omega,
        gap_coefficients=np.concatenate([curve.gap_coefficients, gaps[good]])[order],
        harmonics=np.concatenate([curve.harmonics, counts[good]])[order],
        iterations=np.concatenate([curve.iterations, iterations[good]])[order],
        truncation=np.concatenate([curve.truncation, unknown])[order],
        multipliers=multipliers,
    )
