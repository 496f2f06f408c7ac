"""The error made in getting a solution, estimated from the solution itself.

What an approximation leaves out acts on the gaps through the linearised equation. With the Jacobian
J of F(g) = g + R b(g) - g_lin at the solution, compliance R, and a disturbance d of b,

    delta g = -J^-1 R d.

- truncation: the first Newton step of the equations with more harmonics;
- sampling: d is the difference between the contact integrals used and finer or exact ones; by
  collocation this is the aliasing;
- reduction: R lacks delta R, known from a larger basis: R d becomes delta R b - delta g_lin.

All are root mean squares over the period and the pairs, relative to that of B^T u.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import dynamic_compliance
from fenics_crack.balance.condensed import CondensedSystem, ConstraintSystem, respond
from fenics_crack.balance.contact_integrals import (
    ContactIntegrals,
    ExactIntegrals,
    SampledIntegrals,
    default_samples,
)
from fenics_crack.balance.fourier import resized
from fenics_crack.model.contact import UnilateralPenalty
from fenics_crack.model.reduction import ReducedStructure
from fenics_crack.model.structure import Structure
from fenics_crack.table import Described

__all__ = ["LARGE_ERROR", "ErrorReport", "beyond_truncation", "estimate_errors", "mean_square"]

LARGE_ERROR = 0.05
"""Estimated error beyond which a solution is not shown without a warning."""

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


def estimate_errors(
    system: CondensedSystem | ConstraintSystem,
    unknown: np.ndarray,
    structure: Structure,
    displacement: np.ndarray,
    base_omega: float,
    subharmonic: int,
) -> ErrorReport:
    """Estimate the errors of a solution (collective).

    Parameters
    ----------
    system : CondensedSystem or ConstraintSystem
        The equations.
    unknown : (2H+1, n_pairs)
        Their solution.
    structure : Structure
        Whose gaps they are.
    displacement : (2H+1, n_local) [m]
        The solution expanded to the structure.
    base_omega, subharmonic : float, int
        Frequency of the response [rad/s], and the harmonic on which the load sits.
    """
    gap, force = system.gap_and_force(unknown)
    system.linearise(unknown)
    closing = gap.copy()
    closing[0] += structure.clearance
    size = np.sqrt(mean_square(closing))

    def relative(change: np.ndarray) -> float:
        return float(np.sqrt(mean_square(change)) / size) if size > 0.0 else 0.0

    algebraic = relative(system.residual(unknown))
    expanded = relative(structure.closing(displacement) - closing)
    return ErrorReport(
        residual=max(algebraic, expanded),
        truncation=relative(beyond_truncation(system, unknown)),
        sampling=relative(system.gap_change(_missed_by_samples(system.integrals, gap))),
        reduction=relative(_lost_in_reduction(system, structure, force, base_omega, subharmonic)),
        penetration=relative(_penetration(system, gap, force)),
    )


def beyond_truncation(
    system: CondensedSystem | ConstraintSystem, unknown: np.ndarray
) -> np.ndarray:
    """One Newton step in the equations with K > H harmonics: (2K+1, n_pairs).

    K = 4 H, or 2 H where that would be many unknowns. The step is found by elimination: iterative
    solutions of these equations do not converge where many pairs are stiff.
    """
    kept = system.integrals.harmonics
    harmonics = max(4 * kept, kept + 8)
    if (2 * harmonics + 1) * unknown.shape[1] > MANY:
        harmonics = max(2 * kept, kept + 4)
    wide = system.widened(harmonics)
    start = resized(unknown, harmonics)
    residual = wide.residual(start)
    residual[: len(unknown)] = 0.0  # solved; what samples leave is another error
    wide.linearise(start)
    return wide.gap_of_change(wide.solve_jacobian(-residual))


def _missed_by_samples(integrals: ContactIntegrals, gap: np.ndarray) -> np.ndarray:
    """Better coefficients of the contact force less those used."""
    if not isinstance(integrals, SampledIntegrals):
        return np.zeros_like(gap)
    better: ContactIntegrals
    if isinstance(integrals.law, UnilateralPenalty):
        better = ExactIntegrals(integrals.law, integrals.harmonics)
    else:
        samples = max(4 * integrals.samples, default_samples(integrals.harmonics))
        better = SampledIntegrals(integrals.law, integrals.harmonics, samples)
    return better.force(gap) - integrals.force(gap)


def _lost_in_reduction(
    system: CondensedSystem | ConstraintSystem,
    structure: Structure,
    force: np.ndarray,
    base_omega: float,
    subharmonic: int,
) -> np.ndarray:
    """Change of the gap if the compliance were that of the reduced structure's reference."""
    reference = structure.reference if isinstance(structure, ReducedStructure) else None
    if reference is None:
        return np.zeros_like(force)
    harmonics = system.integrals.harmonics
    better = dynamic_compliance(reference, base_omega, harmonics, subharmonic)
    free = better.linear_gap - system.compliance.linear_gap
    return system.gap_change_of_free_gap(
        free - respond(better.matrices - system.compliance.matrices, force)
    )


def _penetration(
    system: CondensedSystem | ConstraintSystem, gap: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Coefficients whose mean square is that of max(g, 0)."""
    integrals = system.integrals
    if isinstance(system, CondensedSystem) and isinstance(integrals, ExactIntegrals):
        # lambda / k = max(g, 0), whose mean square is the mean of g lambda / k.
        inside = force / integrals.law.stiffness
        product = gap[0] * inside[0] + 0.5 * np.sum(gap[1:] * inside[1:], axis=0)
        return np.sqrt(np.maximum(product, 0.0))[None]
    harmonics = len(gap) // 2
    sampled = SampledIntegrals(UnilateralPenalty(1.0), harmonics, max(512, 16 * harmonics))
    inside = np.maximum(sampled.sample(gap), 0.0)
    return np.sqrt(np.mean(inside**2, axis=0, keepdims=True))


def mean_square(coefficients: np.ndarray) -> float:
    """Mean over the period of the sum of squares (Parseval), rows a0, a1, b1, ...."""
    return float(np.sum(coefficients[:1] ** 2) + 0.5 * np.sum(coefficients[1:] ** 2))
