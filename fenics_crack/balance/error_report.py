"""The error of a solution, estimated from the solution itself.

What an approximation leaves out acts on the gaps through the linearised equation. With the Jacobian
J of F(g) = g + R b(g) - g_lin at the solution, and a disturbance d of b,

    delta g = -J^-1 R d.

- truncation: the first Newton step of the equations with more harmonics;
- sampling: d is the difference between the contact integrals used and finer or exact ones; by
  collocation this is the aliasing;
- reduction: R lacks delta R, known from a larger basis: R d becomes delta R b - delta g_lin.

All are root mean squares over the period and the pairs, relative to that of B^T u.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.balance.condensed import CondensedPoint, CondensedSystem, respond
from fenics_crack.balance.contact_integrals import (
    ExactIntegrals,
    SampledIntegrals,
    contact_integrals,
    default_samples,
)
from fenics_crack.balance.coupled import CoupledPoint, CoupledSystem
from fenics_crack.balance.coupled_integrals import CoupledIntegrals
from fenics_crack.balance.fourier import resized
from fenics_crack.balance.problem import Problem, is_regular
from fenics_crack.model.contact import UnilateralPenalty, is_piecewise_linear, is_rigid
from fenics_crack.model.modal import all_modes
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.table import Described

__all__ = [
    "LARGE_ERROR",
    "ErrorReport",
    "beyond_truncation",
    "estimate_errors",
    "mean_square",
    "relative_size",
]

LARGE_ERROR = 0.05
"""Estimated error beyond which a solution is not shown without a warning."""

ROUGH = 1e-2
"""To which equations of an estimate are solved."""
SMALL_STEP, MAX_STEPS = 0.02, 4
"""Of Newton's method for an estimate: a first step, relative to the solution, that is enough, and
how many follow where it is not."""
STIFF = 1e3
"""Stiffness of a penalty that stands for a constraint where the reference has mass at its lips,
relative to the inverse of R_inf."""
MANY = 600
"""Unknowns beyond which the truncation is judged with twice instead of four times the harmonics."""


@dataclass(frozen=True, repr=False)
class ErrorReport(Described):
    """Estimated errors of the gap, relative to the root mean square of B^T u.

    Attributes
    ----------
    residual : float
        Of the algebraic system, and of B^T u - g0 - g after expansion to the structure; the larger.
    truncation : float
        Harmonics above H left out.
    sampling : float
        Contact integrals by samples; 0 for exact ones.
    reduction : float
        Modes left out of a reduced structure; 0 for a whole one.
    penetration : float
        Penetration that the contact law lets happen; not an error of the solution of that law.
    """

    residual: float
    truncation: float
    sampling: float
    reduction: float
    penetration: float

    @property
    def total(self) -> float:
        """Sum of the errors made in solving the law given (without the penetration)."""
        return self.residual + self.truncation + self.sampling + self.reduction

    def to_dict(self) -> dict[str, Any]:
        """All of them by their names, and the total."""
        return {**asdict(self), "total": self.total}

    def _title(self) -> str:
        return ", ".join(f"{name} {value:.2g}" for name, value in self.to_dict().items())


def estimate_errors(at: CondensedPoint, displacement: np.ndarray, problem: Problem) -> ErrorReport:
    """Estimate the errors of a solution, given as the equations there and as the coefficients of
    the structure's displacement (2H+1, n_local) [m] (collective)."""
    structure = problem.structure
    expanded = structure.apply_bt(displacement)
    expanded[0] -= structure.clearance

    def relative(change: np.ndarray) -> float:
        return relative_size(change, at, structure.clearance)

    return ErrorReport(
        residual=max(relative(at.residual), relative(expanded - at.gap)),
        truncation=relative(beyond_truncation(at)),
        sampling=relative(at.gap_by_force(_missed_by_samples(at))),
        reduction=relative(_lost_in_reduction(at, problem)),
        penetration=relative(_penetration(at)),
    )


def relative_size(change: np.ndarray, at: CondensedPoint, clearance: np.ndarray) -> float:
    """Root mean square of a change of the gap relative to that of B^T u = g + g0."""
    closing = at.gap.copy()
    closing[0] += clearance
    size = mean_square(closing)
    return float(np.sqrt(mean_square(change) / size)) if size > 0.0 else 0.0


def beyond_truncation(at: CondensedPoint) -> np.ndarray:
    """Change of the gap by one Newton step with K > H harmonics, 4 H or 2 H: (2K+1, n_pairs).

    The step is found by elimination: iterative solutions of these equations do not converge where
    many pairs are stiff.
    """
    if isinstance(at, CoupledPoint):
        return _beyond_coupled(at)
    rows, harmonics = len(at.unknown), _more_harmonics(at)
    wide = at.system.widened(harmonics).linearise(resized(at.unknown, harmonics))
    missing = -wide.residual
    missing[:rows] = 0.0  # solved; what samples leave is another error
    return wide.gap_of(wide.solve(missing))


def _more_harmonics(at: CondensedPoint) -> int:
    """With how many harmonics the truncation is judged."""
    kept = at.system.integrals.harmonics
    harmonics = max(4 * kept, kept + 8)
    if (2 * harmonics + 1) * at.unknown.shape[1] > MANY:
        harmonics = max(2 * kept, kept + 4)
    return harmonics


def _beyond_coupled(at: CoupledPoint) -> np.ndarray:
    """The same for pairs that are coupled."""
    harmonics = _more_harmonics(at)
    return _change_of_gap(at, at.system.widened(harmonics), resized(at.unknown, harmonics))


def _change_of_gap(at: CoupledPoint, system: CoupledSystem, start: np.ndarray) -> np.ndarray:
    """The gap by better equations less that of a point, by Newton's method from its neighbourhood:
    one step where that is small, else some, as far as they come closer."""
    rows, known = len(start), at.gap.copy()
    point = system.linearise(start)
    first = point.solve(-point.residual, ROUGH)
    change = point.gap_of(first) + point.gap
    change[: len(known)] -= known
    size = system.inner(start, start)
    if system.inner(first, first) < SMALL_STEP**2 * size:
        return change
    best = float(np.sqrt(system.inner(point.residual, point.residual)))
    moved = first
    for _ in range(MAX_STEPS):
        point = system.linearise(point.unknown + moved)
        left = float(np.sqrt(system.inner(point.residual, point.residual)))
        if not left < 2.0 * best:
            break
        best = min(best, left)
        change = point.gap.copy()
        change[: min(rows, len(known))] -= known
        if left < ROUGH * np.sqrt(system.inner(first, first)):
            break
        moved = point.solve(-point.residual, ROUGH)
    return change


def _missed_by_samples(at: CondensedPoint) -> np.ndarray:
    """Better coefficients of the contact force less those used."""
    integrals, gap = at.system.integrals, at.gap
    if isinstance(integrals, CoupledIntegrals):
        if integrals.samples is None and integrals.piecewise:
            return np.zeros_like(gap)
        finer = (
            None
            if integrals.piecewise
            else 4 * (integrals.samples or default_samples(integrals.harmonics))
        )
        return replace(integrals, samples=finer).linearise(at.unknown).force - at.force
    if not isinstance(integrals, SampledIntegrals):
        return np.zeros_like(gap)
    law, harmonics, samples = integrals.law, integrals.harmonics, None
    if not is_piecewise_linear(law):
        samples = max(4 * integrals.samples, default_samples(harmonics))
    return contact_integrals(law, harmonics, samples).force(gap) - integrals.force(gap)


def _lost_in_reduction(at: CondensedPoint, problem: Problem) -> np.ndarray:
    """Change of the gap if the compliance were that of the reduced structure's reference."""
    structure = problem.structure
    reference = structure.reference if isinstance(structure, ReducedStructure) else None
    if reference is None:
        return np.zeros_like(at.gap)
    if isinstance(at, CoupledPoint):
        other = replace(problem, structure=reference, static_above=problem.cutoff)
        residual = at.system.residual
        if is_rigid(problem.contact) and not is_regular(
            all_modes(reference).static_part(problem.cutoff)
        ):
            nearly = STIFF * len(residual) / np.trace(residual)
            other = replace(other, contact=UnilateralPenalty(float(nearly)))
        compliance = other.compliance()
        system = other.system(compliance)
        assert isinstance(system, CoupledSystem)
        return _change_of_gap(at, system, at.gap + at.force @ system.residual)
    better, used = replace(problem, structure=reference).compliance(), at.system.compliance
    free = better.linear_gap - used.linear_gap
    return at.gap_by_linear_gap(free - respond(better.matrices - used.matrices, at.force))


def _penetration(at: CondensedPoint) -> np.ndarray:
    """Coefficients whose mean square is that of max(g, 0)."""
    integrals, gap = at.system.integrals, at.gap
    if isinstance(integrals, CoupledIntegrals):
        inside = at.force / np.asarray(integrals.law.stiffness)  # but of a smoothed law
        return np.sqrt(inside[:1] ** 2 + 0.5 * np.sum(inside[1:] ** 2, axis=0, keepdims=True))
    if isinstance(at.system, CondensedSystem) and isinstance(integrals, ExactIntegrals):
        # lambda / k = max(g, 0), whose mean square is the mean of g lambda / k.
        inside = at.force / integrals.law.stiffness
        product = gap[0] * inside[0] + 0.5 * np.sum(gap[1:] * inside[1:], axis=0)
        return np.sqrt(np.maximum(product, 0.0))[None]
    harmonics = len(gap) // 2
    sampled = SampledIntegrals(UnilateralPenalty(1.0), harmonics, max(512, 16 * harmonics))
    inside = np.maximum(sampled.sample(gap), 0.0)
    return np.sqrt(np.mean(inside**2, axis=0, keepdims=True))


def mean_square(coefficients: np.ndarray) -> float:
    """Mean over the period of the sum of squares (Parseval), rows a0, a1, b1, ...."""
    return float(np.sum(coefficients[:1] ** 2) + 0.5 * np.sum(coefficients[1:] ** 2))
