"""Errors of a solution, estimated from the solution itself.

An approximation acts on the gaps through the linearised equation. With the Jacobian J of F(g) = g +
R b(g) - g_lin at the solution, and a disturbance d of b,

    delta g = -J^-1 R d.

- truncation: d has the truncated harmonics, from equations with more harmonics
- sampling: d is the difference between finer or exact contact integrals and the present ones; with
collocation this is the aliasing
- reduction: R lacks the compliance delta R of truncated modes. A larger basis has a known share of
delta R, so R d becomes (delta R b - delta g_lin) / share

The exact flow gives the truncation error (:mod:`assessment`). Without a flow, it is the change by
Newton's method with more harmonics. Likewise, with a residual flexibility the reduction error is
the change with the modes of the larger basis.

Source: Deuflhard, Newton Methods for Nonlinear Problems, 2004, section 2.1.1 (test of the second
Newton step by the ratio |simplified step| / |step|).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem, PeriodicMotion
from fenics_crack.balance.more_modes import (
    ERROR_IF_UNKNOWN,
    GapAndDisplacementErrors,
    modal_truncation_errors,
    more_modes_structure_of,
    project_motion_on_load,
)
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.tables import Described
from fenics_crack.model.contact import (
    REGULAR_EIGENVALUE_RATIO,
    is_layered,
    is_regular,
    is_rigid,
    with_penalty_as_normal_law,
)
from fenics_crack.model.modal import MAX_DENSE_SIZE, all_modes
from fenics_crack.model.modes import STIFFNESS_SOLUTION_ROUNDING
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.structure import Structure
from fenics_crack.motion.search import SearchOptions
from fenics_crack.numerics.equations import COARSE_TOLERANCE, ROUNDING
from fenics_crack.numerics.fourier import resize_harmonics, sample_period
from fenics_crack.numerics.newton import (
    solve_by_full_or_damped_steps,
    sum_of_squares_with_limited_mean,
)

LARGE_ERROR = 0.05
"""Estimated relative error above which a solution has a warning."""
MIN_HARMONICS_FOR_MODAL_CHANGE = SearchOptions.guess_harmonic_counts[-1]
"""Minimum harmonics of the load to estimate a modal truncation error by harmonic balance.

The error is the difference between two solutions with different numbers of modes. Measured on 14
plates next to a resonance, relative to the difference between exact orbits: 0.3 to 3 times with 40
harmonics; with 20 harmonics it may be a hundredth.
"""
NO_EXACT_ORBIT_TEXT = "a prediction that no exact orbit confirms"
"""Words printed with an error report if no exact orbit was found for the truncation error."""
PART_NAMES_OF_TOTAL_ERROR = ("truncation", "reduction", "sampling", "residual")
"""Names of the errors in the total. If the largest are equal, the first name is reported."""


@dataclass(frozen=True, repr=False)
class ErrorReport(Described):
    """Estimated relative errors of a solution.

    Gap errors are divided by the root mean square of the gap plus clearance. In the divisor a mean
    over time larger than the vibration counts only as much as the vibration. So a large mean
    does not make errors small. An error of 1 is unknown: the equations with more harmonics or modes
    were not solved, or lead to another motion.

    Attributes
    ----------
    residual : float
        Larger of two errors: the residual of the equations, and the mismatch between the gaps and
        the displacements after expansion to all dofs.
    truncation : float
        Error due to the harmonics above H, the highest kept.
    sampling : float
        Error of contact integrals by samples; 0 for exact integrals.
    reduction : float
        Modal truncation error of a reduced structure; 0 otherwise.
    penetration : float
        Penetration that the contact law permits; not an error of the solution for that law.
    displacement : float
        Truncation and reduction error of the displacement at the load, along the vibrating load. It
        is relative to that displacement, and usually much smaller than the errors of the gap.
    confirmed : bool
        False if an exact orbit was searched and none was found. The truncation error is then
        3 p / (1 + 2 p) for a predicted error p.
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
        """Sum of the residual, truncation, sampling and reduction errors.

        The penetration is left out: the given law permits it. So is the displacement error.
        """
        return self.residual + self.truncation + self.sampling + self.reduction

    @property
    def unknown(self) -> bool:
        """True if the total error is at least 1; an error that cannot be estimated is 1."""
        return self.total >= ERROR_IF_UNKNOWN

    @property
    def estimated(self) -> bool:
        """True if errors were requested. If not, the total error is nan."""
        return not math.isnan(self.total)

    @property
    def largest_part(self) -> str:
        """Name of the largest error: "truncation", "reduction", "sampling" or "residual".

        If several are equally large, the first in this order.
        """
        return max(PART_NAMES_OF_TOTAL_ERROR, key=lambda part_name: getattr(self, part_name))

    def to_dict(self) -> dict[str, Any]:
        """Return the errors and their total by name, without ``confirmed``."""
        return {
            error_name: error
            for error_name, error in (asdict(self) | {"total": self.total}).items()
            if error_name != "confirmed"
        }

    def _unit_by_name(self) -> dict[str, str]:
        """Return no units: all errors are relative."""
        return {}

    def _repr_text(self) -> str:
        return ", ".join(
            f"{part_name} {part_error:.2g}"
            + (
                " (unknown)"
                if part_error >= ERROR_IF_UNKNOWN and part_name != "penetration"
                else ""
            )
            for part_name, part_error in self.to_dict().items()
        ) + ("" if self.confirmed else f" ({NO_EXACT_ORBIT_TEXT})")


def estimate_errors(
    point: ContactPoint,
    assessment: Assessment,
    problem: Problem,
    *,
    search: bool,
    has_converged: bool,
) -> ErrorReport:
    """Estimate the errors of a harmonic-balance solution (collective).

    If the equations are not solved, the report has their residual, and the errors are unknown (1).

    Parameters
    ----------
    point : ContactPoint
        Equations linearised at the solution.
    assessment : Assessment
        Prediction and nearest orbit by the exact flow.
    problem : Problem
        Problem that was solved.
    search : bool
        True: search for the nearest exact orbit, whose distance is the error. False: predict it.
    has_converged : bool
        True if the equations are solved.
    """
    structure, wave = problem.structure, assessment.wave
    gap_coefficients_of_displacement = problem.structure_with_pair_per_row.gap_of(
        wave.displacement_coefficients
    )

    def relative_gap_size(change: np.ndarray) -> float:
        """Return the size of a gap change (m, n_rows) [m] relative to the solution's gaps."""
        return relative_rms_of_gap_change(
            change, point, problem.structure_with_pair_per_row.clearance
        )

    relative_residual = relative_gap_size(point.residual)
    relative_rms_penetration = relative_gap_size(_rms_penetration_of_each_pair(point, problem))
    if not has_converged:
        return ErrorReport(
            relative_residual, ERROR_IF_UNKNOWN, 0.0, 0.0, relative_rms_penetration,
            ERROR_IF_UNKNOWN,
        )  # fmt: skip
    finer_integrals, sampling_error = point.system.integrals.exact_or_finer_integrals(), 0.0
    if finer_integrals is not None:
        sampling_error = relative_gap_size(
            point.gap_change_by_force_error(finer_integrals.force(point.unknown) - point.force)
        )
    if assessment.can_search_orbit:  # includes the sampling error
        harmonics_error, harmonics_displacement_error = assessment.gap_and_displacement_errors(
            search=search
        )
    else:
        harmonics_error, harmonics_displacement_error = _truncation_errors(point, wave)
    truncation_error = (
        ERROR_IF_UNKNOWN
        if harmonics_error >= ERROR_IF_UNKNOWN
        else max(harmonics_error - sampling_error, 0.0)
    )
    can_use_orbits = assessment.can_search_orbit and search and structure.has_massless_crack_faces
    more_modes = assessment.more_modes if can_use_orbits else None
    min_harmonics_for_modes = problem.response_harmonics(MIN_HARMONICS_FOR_MODAL_CHANGE)
    if (
        can_use_orbits
        and truncation_error >= ERROR_IF_UNKNOWN
        and isinstance(structure, ReducedStructure)
    ):
        # Without an orbit the effect of more modes is unknown, too.
        modal_errors = ERROR_IF_UNKNOWN, ERROR_IF_UNKNOWN
    elif more_modes and (more_modes.orbit or problem.harmonics < min_harmonics_for_modes):
        modal_errors = more_modes.gap_and_displacement_errors or (
            ERROR_IF_UNKNOWN,
            ERROR_IF_UNKNOWN,
        )
    else:
        modal_errors = _reduction_errors(point, wave, problem)
        if can_use_orbits and any(modal_errors):  # modes above all harmonics are static in both
            modal_errors = (
                max(modal_errors[0], truncation_error),
                max(modal_errors[1], harmonics_displacement_error),
            )
    return ErrorReport(
        residual=max(
            relative_residual, relative_gap_size(gap_coefficients_of_displacement - point.gap)
        ),
        truncation=truncation_error,
        sampling=sampling_error,
        reduction=modal_errors[0],
        penetration=relative_rms_penetration,
        displacement=min(harmonics_displacement_error + modal_errors[1], ERROR_IF_UNKNOWN),
        confirmed=not (assessment.can_search_orbit and search)
        or assessment.nearest_orbit is not None,
    )


UNESTIMATED_REPORT = ErrorReport(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan)
"""Report of a solution whose errors were not requested: all are nan."""


def report_by_more_modes(
    solution: PeriodicMotion, more_modes_solution: PeriodicMotion
) -> ErrorReport:
    """Return the error report of the linear solution ``solution`` (collective).

    ``more_modes_solution`` is the linear solution for the reduced structure's reference, a
    reduction with more modes. The difference between both gives the modal truncation error.
    """
    gap_plus_clearance = more_modes_solution.gap_coefficients.copy()
    gap_plus_clearance[0] += solution.structure.clearance
    gap_change_mean_square = mean_square(
        more_modes_solution.gap_coefficients - solution.gap_coefficients
    )
    gap_error = math.sqrt(
        gap_change_mean_square / mean_square_with_limited_mean(gap_plus_clearance)
    )
    displacement_at_load_error = _relative_change_at_load(
        solution, more_modes_solution.structure, more_modes_solution.displacement_coefficients
    )
    reduction_error, displacement_error = modal_truncation_errors(
        solution.structure, (gap_error, displacement_at_load_error)
    )
    return ErrorReport(reduction=reduction_error, displacement=displacement_error)


def _relative_change_at_load(
    wave: PeriodicMotion, structure: Structure, displacement: np.ndarray
) -> float:
    """Return the relative change of the displacement at the load between two motions (collective).

    Parameters
    ----------
    wave : PeriodicMotion
        First motion.
    structure : Structure
        Structure of the second motion.
    displacement : (2H+1, n_local) [m]
        Displacement coefficients of the second motion.

    Returns
    -------
    float
        Root mean square of the change, divided by the root mean square of the first motion. Both
        are projected on the load (:func:`project_motion_on_load`). In the divisor the mean over
        time is limited to the vibration. 0 if the first motion is zero.
    """
    motion_coefficients = project_motion_on_load(wave.structure, wave.displacement_coefficients)
    change_mean_square = mean_square(
        project_motion_on_load(structure, displacement) - motion_coefficients
    )
    return (
        math.sqrt(change_mean_square / mean_square_with_limited_mean(motion_coefficients))
        if motion_coefficients.any()
        else 0.0
    )


def relative_rms_of_gap_change(
    gap_change: np.ndarray, point: ContactPoint, clearance: np.ndarray
) -> float:
    """Return the root mean square of a gap change, divided by that of gap plus clearance.

    In the divisor a mean over time larger than the vibration counts only as much as the
    vibration.

    Parameters
    ----------
    gap_change : (m, n_rows) [m]
        Fourier coefficients of the change, with any number of harmonics.
    point : ContactPoint
        Equations at the solution.
    clearance : (n_rows,) [m]
        Clearance of each pair; with friction, zeros for tangential gaps follow.

    Returns
    -------
    float
        Relative change; 0 if the load presses the crack faces together, so that gaps move only by
        rounding.
    """
    gap_plus_clearance = point.gap.copy()
    linear_gap = point.system.compliance_model.linear_gap.copy()
    gap_plus_clearance[0] += clearance
    linear_gap[0] += clearance
    negligible_mean_square = STIFFNESS_SOLUTION_ROUNDING**2 * mean_square(linear_gap)
    is_still = (
        mean_square(gap_plus_clearance) <= negligible_mean_square
    )  # the load presses the crack faces together
    return (
        0.0
        if is_still
        else math.sqrt(mean_square(gap_change) / mean_square_with_limited_mean(gap_plus_clearance))
    )


def _truncation_errors(point: ContactPoint, wave: PeriodicMotion) -> GapAndDisplacementErrors:
    """Return the truncation errors of a solution, by solving again with more harmonics.

    Used for solutions without an exact flow. Four times as many harmonics are taken. If the
    Jacobian would then be too large to factor, fewer are taken, but at least twice as many.

    Parameters
    ----------
    point : ContactPoint
        Equations at the solution.
    wave : PeriodicMotion
        Motion of the solution.

    Returns
    -------
    gap, displacement : float
        Relative changes of the gaps, and of the displacement at the load.
    """
    kept_harmonics, n_pairs = point.system.integrals.harmonics, point.unknown.shape[1]
    more_harmonics = max(
        2 * kept_harmonics,
        kept_harmonics + 4,
        min(4 * kept_harmonics, (MAX_DENSE_SIZE // n_pairs - 1) // 2),
    )
    larger_system = point.system.with_harmonics(more_harmonics)
    return _relative_changes_by_better_system(
        point, wave, larger_system, resize_harmonics(point.unknown, more_harmonics), wave.structure
    )


def _relative_changes_by_better_system(
    base_point: ContactPoint,
    wave: PeriodicMotion,
    better_system: ContactSystem,
    start_gap_without_static_part: np.ndarray,
    structure: Structure,
) -> GapAndDisplacementErrors:
    """Return the relative changes of a solution by more harmonics or modes.

    Parameters
    ----------
    base_point : ContactPoint
        Equations of the present solution.
    wave : PeriodicMotion
        Motion of the present solution.
    better_system : ContactSystem
        Equations with more harmonics or modes.
    start_gap_without_static_part : (2K+1, n_rows) [m]
        Gap coefficients at which Newton's method starts; with a residual flexibility, coefficients
        of gap plus residual flexibility times contact force.
    structure : Structure
        Structure of ``better_system``.

    Returns
    -------
    gap, displacement : float
        Relative changes of the gaps, and of the displacement at the load; 1 (unknown) if Newton's
        method fails.
    """
    start_point = better_system.linearise(start_gap_without_static_part)
    start_gap_norm = max(float(np.linalg.norm(start_gap_without_static_part)), 1e-300)
    tolerance = max(
        COARSE_TOLERANCE * float(np.linalg.norm(start_point.residual)) / start_gap_norm, ROUNDING
    )
    end_path_point = solve_by_full_or_damped_steps(
        better_system, start_gap_without_static_part, 1.0, tolerance=tolerance
    )
    if end_path_point is None:
        return ERROR_IF_UNKNOWN, ERROR_IF_UNKNOWN
    converged_better_point = better_system.linearise(end_path_point.unknown)
    n_base_fourier_coefficients = len(base_point.force)
    gap_error = relative_rms_of_gap_change(
        converged_better_point.gap - start_point.gap,
        base_point,
        wave.structure_with_pair_per_row.clearance,
    )
    better_force = (
        base_point.force
        + (converged_better_point.force - start_point.force)[:n_base_fourier_coefficients]
    )
    displacement_at_load_error = _relative_change_at_load(
        wave, structure, better_system.compliance_model.displacement(better_force)
    )
    return min(gap_error, ERROR_IF_UNKNOWN), min(displacement_at_load_error, ERROR_IF_UNKNOWN)


def _reduction_errors(
    point: ContactPoint, wave: PeriodicMotion, problem: Problem
) -> GapAndDisplacementErrors:
    """Return the modal truncation errors of gaps and of displacement at the load.

    The reference of a reduced structure is a reduction with more modes. The equations of the
    solution, ``point`` with the motion ``wave``, are solved again for the reference. This changes
    gaps and displacement by a known fraction of the truncation error,
    :attr:`ReducedStructure.error_share_removed_by_reference`. So each error is the relative change,
    divided by the fraction. Both errors are 0 without a reference.
    """
    more_modes_structure = more_modes_structure_of(wave)
    residual_compliance = point.system.residual_compliance
    if more_modes_structure is None:
        return 0.0, 0.0
    cutoff = np.inf if residual_compliance is None else problem.quasi_static_above
    more_modes_problem = replace(problem, structure=more_modes_structure, static_above=cutoff)
    start_gap_without_static_part = point.gap
    if point.system.integrals.has_coupled_pairs:
        assert residual_compliance is not None
        if is_rigid(problem.contact) and not is_regular(
            all_modes(more_modes_problem.structure_with_pair_per_row).static_pair_compliance(cutoff)
        ):
            # With this stiffness the penalty is numerically a constraint.
            rigid_penalty_stiffness = len(residual_compliance) / (
                REGULAR_EIGENVALUE_RATIO * np.trace(residual_compliance)
            )
            more_modes_problem = replace(
                more_modes_problem,
                contact=with_penalty_as_normal_law(problem.contact, float(rigid_penalty_stiffness)),
            )
    more_modes_system = more_modes_problem.system(more_modes_problem.compliance_model())
    if more_modes_system.residual_compliance is not None:
        start_gap_without_static_part = (
            start_gap_without_static_part + point.force @ more_modes_system.residual_compliance
        )
    return modal_truncation_errors(
        problem.structure,
        _relative_changes_by_better_system(
            point, wave, more_modes_system, start_gap_without_static_part, more_modes_structure
        ),
    )


def _rms_penetration_of_each_pair(point: ContactPoint, problem: Problem) -> np.ndarray:
    """Return the root mean square penetration of each pair over the period: (1, n_pairs) [m].

    Penetration is the positive gap. Under the layered law each pair comes twice.
    """
    integrals, n_instants = point.system.integrals, max(512, 8 * len(point.gap))
    if integrals.has_coupled_pairs:  # g has more than H harmonics
        penetration_series_or_samples = (point.force * integrals.spring_compliance)[
            :, : problem.structure.n_pairs
        ]
        rms_penetration = np.sqrt(
            penetration_series_or_samples[:1] ** 2
            + 0.5 * np.sum(penetration_series_or_samples[1:] ** 2, axis=0, keepdims=True)
        )
    else:
        penetration_series_or_samples = np.maximum(sample_period(point.gap, n_instants), 0.0)
        rms_penetration = np.sqrt(np.mean(penetration_series_or_samples**2, axis=0, keepdims=True))
    if is_layered(problem.contact):  # both rows of a pair count alike
        return np.tile(rms_penetration[:, : problem.structure.n_pairs], 2)
    return rms_penetration


def mean_square(coefficients: np.ndarray) -> float:
    """Return the mean square over a period, summed over n quantities (Parseval).

    ``coefficients`` (2H+1, n) have the mean, then cosine and sine of each harmonic.
    """
    return float(np.sum(coefficients[:1] ** 2) + 0.5 * np.sum(coefficients[1:] ** 2))


def mean_square_with_limited_mean(coefficients: np.ndarray) -> float:
    """Return the mean square of n quantities over a period, as a divisor of relative errors.

    A large mean would make relative errors small, so the mean is limited. Let v be the vibration's
    mean square, and m the squared mean over time, both summed over the quantities. If v is rounding
    error, the result is v + m; otherwise it is v + min(m, v). The result is at least 1e-300.

    ``coefficients`` (2H+1, n) have the mean, then cosine and sine of each harmonic.
    """
    vibration_mean_square = 0.5 * np.sum(coefficients[1:] ** 2)
    squared_means_sum = np.sum(coefficients[0] ** 2)
    return sum_of_squares_with_limited_mean(float(vibration_mean_square), float(squared_means_sum))
