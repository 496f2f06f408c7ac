"""The error of a solution, estimated from the solution itself.

What an approximation leaves out acts on the gaps through the linearised equation. With the Jacobian
J of F(g) = g + R b(g) - g_lin at the solution, and a disturbance d of b,

    delta g = -J^-1 R d.

- truncation: d are the harmonics left out, of equations that have them;
- sampling: d is the difference between the contact integrals used and finer or exact ones; by
  collocation this is the aliasing;
- reduction: R lacks delta R, of which a share is known from a larger basis: R d becomes
  (delta R b - delta g_lin) / share.

Truncation is assessed by the exact flow (:mod:`assessment`); where that is not at
hand it, and reduction where pairs have a residual flexibility, are the change by Newton's method
with more harmonics, or with the modes of the larger basis.

Source of the test of the second step: Deuflhard, Newton Methods for Nonlinear Problems, 2004,
section 2.1.1, with the monitor |simplified step| / |step|.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem, Wave
from fenics_crack.balance.more_modes import (
    UNKNOWN,
    Errors,
    modal_truncation_errors,
    motion_at_load,
    reference_of,
)
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.tables import Described
from fenics_crack.model.contact import REGULAR, as_penalty, is_regular, is_rigid
from fenics_crack.model.modal import SMALL, all_modes
from fenics_crack.model.modes import NEGLIGIBLE
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.search import SearchOptions
from fenics_crack.numerics.equations import COARSE_TOLERANCE, ROUNDING
from fenics_crack.numerics.fourier import resize_harmonics, sample_period
from fenics_crack.numerics.newton import motion_square, solve_robustly

LARGE_ERROR = 0.05
"""Estimated relative error above which a solution has a warning."""
ENOUGH = SearchOptions.harmonics[-1]
"""Harmonics of the load's frequency from which on two solutions show the change due to modes: on 14
plates next to a resonance 0.3 to 3 times that of orbits; with 20 harmonics from a hundredth on."""
NOT_CONFIRMED = "not confirmed by an orbit"
"""Mark of an error whose part by truncation is stated without an orbit."""
ERROR_PARTS = ("truncation", "reduction", "sampling", "residual")
"""Parts of a total error; of equal ones the first is reported."""


@dataclass(frozen=True, repr=False)
class ErrorReport(Described):
    """Estimated errors of the gap, relative to the root mean square of B^T u, to which its means
    contribute no more than all else.

    An estimate of 1 says that the error is not known: the better equations that it is assessed by
    were not solved, or lead to another motion.

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
    displacement : float
        Of the displacement at the load, in the direction of what vibrates of it, likewise relative
        to its own: truncation and reduction. Usually much smaller than those of the gap.
    confirmed : bool
        False where the truncation is three times a predicted one, as no exact orbit was found.
    """

    residual: float = 0.0
    truncation: float = 0.0
    sampling: float = 0.0
    reduction: float = 0.0
    penetration: float = 0.0
    displacement: float = 0.0
    confirmed: bool = True

    @property
    def total(self) -> float:
        """Sum of the errors made in solving the law given (without the penetration)."""
        return self.residual + self.truncation + self.sampling + self.reduction

    @property
    def unknown(self) -> bool:
        """True if the total could not be estimated."""
        return self.total >= UNKNOWN

    @property
    def estimated(self) -> bool:
        """True if the total was requested."""
        return not math.isnan(self.total)

    @property
    def largest_part(self) -> str:
        """Name of the largest part of the total; of those that are as large the first."""
        return max(ERROR_PARTS, key=lambda name: getattr(self, name))

    def to_dict(self) -> dict[str, Any]:
        """All of them by their names, and the total."""
        return {
            name: value
            for name, value in (asdict(self) | {"total": self.total}).items()
            if name != "confirmed"
        }

    def _units(self) -> dict[str, str]:
        return {}  # relative

    def _title(self) -> str:
        return ", ".join(
            f"{name} {value:.2g}"
            + (" (unknown)" if value >= UNKNOWN and name != "penetration" else "")
            for name, value in self.to_dict().items()
        ) + ("" if self.confirmed else f" ({NOT_CONFIRMED})")


def estimate_errors(
    at: ContactPoint, known: Assessment, problem: Problem, *, search: bool, converged: bool
) -> ErrorReport:
    """Estimate the errors of a solution, given as the equations there and by what the exact flow
    says of it; with ``search`` its orbit is looked for (collective). Of equations that are not
    solved it has their residual, and that no error is known."""
    structure, wave = problem.structure, known.wave
    expanded = problem.row_structure.gap_of(wave.displacement_coefficients)

    def relative(change: np.ndarray) -> float:
        return relative_size(change, at, problem.row_structure.clearance)

    residual, penetration = relative(at.residual), relative(_penetration(at, problem))
    if not converged:
        return ErrorReport(residual, UNKNOWN, 0.0, 0.0, penetration, UNKNOWN)
    finer, sampling = at.system.integrals.refine(), 0.0
    if finer is not None:
        sampling = relative(at.gap_by_force(finer.force(at.unknown) - at.force))
    if known.affordable:  # better equations differ by what harmonics and samples leave out
        error, at_load = known.errors(search=search)
    else:
        error, at_load = _beyond_truncation(at, wave)
    truncation = UNKNOWN if error >= UNKNOWN else max(error - sampling, 0.0)
    exactly = known.affordable and search and structure.light_lips
    more, few = known.more_modes if exactly else None, problem.response_harmonics(ENOUGH)
    if exactly and truncation >= UNKNOWN and isinstance(structure, ReducedStructure):
        lost = UNKNOWN, UNKNOWN  # nor is it known what more modes make of a motion that is not
    elif more and (more.orbit or problem.harmonics < few):
        lost = more.errors or (UNKNOWN, UNKNOWN)
    else:
        lost = _lost_in_reduction(at, wave, problem)
        if exactly and any(lost):  # modes above all harmonics are static in both solutions
            lost = max(lost[0], truncation), max(lost[1], at_load)
    return ErrorReport(
        residual=max(residual, relative(expanded - at.gap)),
        truncation=truncation,
        sampling=sampling,
        reduction=lost[0],
        penetration=penetration,
        displacement=min(at_load + lost[1], UNKNOWN),
        confirmed=not (known.affordable and search) or known.orbit is not None,
    )


NOT_ESTIMATED = ErrorReport(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan)
"""Report of a solution whose errors were not requested."""


def beside(found: Wave, better: Wave) -> ErrorReport:
    """The report of a solution without contact force, by the change to that of the reference of
    its structure (collective)."""
    closing = better.gap_coefficients.copy()
    closing[0] += found.structure.clearance
    size = mean_square(better.gap_coefficients - found.gap_coefficients)
    gap = math.sqrt(size / moving_mean_square(closing))
    at_load = _at_load(found, better.structure, better.displacement_coefficients)
    reduction, displacement = modal_truncation_errors(found.structure, (gap, at_load))
    return ErrorReport(reduction=reduction, displacement=displacement)


def _at_load(wave: Wave, structure: Structure, displacement: np.ndarray) -> float:
    """Change of the displacement at the load to that of a structure, relative to its root mean
    square, to which its mean contributes no more than all else (collective)."""
    known = motion_at_load(wave.structure, wave.displacement_coefficients)
    change = mean_square(motion_at_load(structure, displacement) - known)
    return math.sqrt(change / moving_mean_square(known)) if known.any() else 0.0


def relative_size(change: np.ndarray, at: ContactPoint, clearance: np.ndarray) -> float:
    """Root mean square of a change of the gap relative to what moves of B^T u = g + g0; 0 where
    this is rounding, beside what it would be without contact."""
    closing, free = at.gap.copy(), at.system.compliance.linear_gap.copy()
    closing[0] += clearance
    free[0] += clearance
    rounding = NEGLIGIBLE**2 * mean_square(free)
    still = mean_square(closing) <= rounding  # crack faces that the load presses together
    return 0.0 if still else math.sqrt(mean_square(change) / moving_mean_square(closing))


def _beyond_truncation(at: ContactPoint, wave: Wave) -> Errors:
    """Return the change due to K > H harmonics: for laws and structures whose exact flow is not at
    hand. They are four times as many, or as many as leave the equations small, but at least twice.

    Steps are found by elimination: iterative solutions of these equations do not converge where
    many pairs are stiff, unless these have a residual flexibility.
    """
    kept, pairs = at.system.integrals.harmonics, at.unknown.shape[1]
    harmonics = max(2 * kept, kept + 4, min(4 * kept, (SMALL // pairs - 1) // 2))
    wide = at.system.with_harmonics(harmonics)
    return _change(at, wave, wide, resize_harmonics(at.unknown, harmonics), wave.structure)


def _change(
    at: ContactPoint, wave: Wave, better: ContactSystem, start: np.ndarray, structure: Structure
) -> Errors:
    """Return the change from a solution to that of better equations, of a structure, by Newton's
    method from a start; :data:`UNKNOWN` where that does not arrive."""
    first = better.linearise(start)
    size = max(float(np.linalg.norm(start)), 1e-300)
    sharp = max(COARSE_TOLERANCE * float(np.linalg.norm(first.residual)) / size, ROUNDING)
    near = solve_robustly(better, start, 1.0, tolerance=sharp)
    if near is None:
        return UNKNOWN, UNKNOWN
    point, rows = better.linearise(near.unknown), len(at.force)
    gap = relative_size(point.gap - first.gap, at, wave.row_structure.clearance)
    force = at.force + (point.force - first.force)[:rows]
    at_load = _at_load(wave, structure, better.compliance.displacement(force))
    return min(gap, UNKNOWN), min(at_load, UNKNOWN)


def _lost_in_reduction(at: ContactPoint, wave: Wave, problem: Problem) -> Errors:
    """Return the errors due to the modes left out, by the reference of the reduced structure."""
    reference, residual = reference_of(wave), at.system.residual
    if reference is None:
        return 0.0, 0.0
    cutoff = np.inf if residual is None else problem.cutoff
    other, start = replace(problem, structure=reference, static_above=cutoff), at.gap
    if at.system.integrals.has_coupled_pairs:
        assert residual is not None
        if is_rigid(problem.contact) and not is_regular(
            all_modes(other.row_structure).static_part(cutoff)
        ):
            nearly = len(residual) / (REGULAR * np.trace(residual))  # a constraint to rounding
            other = replace(other, contact=as_penalty(problem.contact, float(nearly)))
    system = other.system(other.compliance())
    if system.residual is not None:
        start = start + at.force @ system.residual
    return modal_truncation_errors(problem.structure, _change(at, wave, system, start, reference))


def _penetration(at: ContactPoint, problem: Problem) -> np.ndarray:
    """Coefficients whose mean square is that of max(g, 0)."""
    integrals, count = at.system.integrals, max(512, 8 * len(at.gap))
    if integrals.has_coupled_pairs:  # g has more harmonics than are kept
        inside = (at.force * integrals.springs)[:, : problem.structure.n_pairs]
        return np.sqrt(inside[:1] ** 2 + 0.5 * np.sum(inside[1:] ** 2, axis=0, keepdims=True))
    inside = np.maximum(sample_period(at.gap, count), 0.0)
    return np.sqrt(np.mean(inside**2, axis=0, keepdims=True))


def mean_square(coefficients: np.ndarray) -> float:
    """Mean over the period of the sum of squares (Parseval), rows a0, a1, b1, ...."""
    return float(np.sum(coefficients[:1] ** 2) + 0.5 * np.sum(coefficients[1:] ** 2))


def moving_mean_square(coefficients: np.ndarray) -> float:
    """The same, to which means contribute no more than all else; never zero."""
    moving, means = 0.5 * np.sum(coefficients[1:] ** 2), np.sum(coefficients[0] ** 2)
    return motion_square(float(moving), float(means))
