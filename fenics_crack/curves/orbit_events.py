"""Bifurcations of periodic orbits along a path, and step control by Floquet multipliers.

Every point of the path carries its leading multipliers mu and three counts:

    r    real multipliers above 1
    d    real multipliers below -1
    c    complex pairs outside the unit circle

Between two neighbouring points there is a period doubling if d changes, and a Neimark-Sacker
bifurcation if c changes. (Folds are found where the parameter turns back.) Two real multipliers
that meet outside the circle and become a complex pair are no bifurcation. The Illinois method
(:func:`fenics_crack.numerics.path.find_zero_point_and_function_value`) locates a bifurcation by a
change of sign:

    period doubling     product of all 1 + mu
    Neimark-Sacker      |mu_k| - 1 of the k-th pair

If no orbit between the two points has a multiplier within 1e-6 of the circle, the multiplier jumps
across the circle. That is no bifurcation.

Collisions of multipliers
-------------------------
With light damping, |mu| = exp(-a) lies just inside the circle for every multiplier. Along the path
the multipliers rotate. One leaves the circle only if two of them collide, and returns when they
separate again. Both may happen between two points, so collisions are predicted from both ends.

Let the basis be the eigenvectors of the monodromy matrix at the first point. In this basis the
matrix is diag(mu) at the first point and B at the second point; between them it is interpolated
linearly. At the fraction s of the step, two multipliers j and k have

    difference  g (1 - s) - s b,    g = |mu_j - mu_k|,    b = |B_jj - B_kk|
    coupling    s^2 c^2,            c^2 = 4 |B_jk B_kj|

relative to sqrt(|mu_j mu_k|) and to |mu_j mu_k|.

If B_jk B_kj / (B_jj - B_kk)^2 < 0 (opposite Krein signatures), the collision separates them in
ln |mu| by at most

    max over s <= 1 of sqrt(s^2 c^2 - (s (g + b) - g)^2),   at s = g (g + b) / ((g + b)^2 - c^2).

One of them leaves the circle if this exceeds 2 sqrt(a_j a_k). Two multipliers do not collide if
both matrices have them in the same order along the circle. The angles of mu_j / mu_k and B_jj /
B_kk, continued from the first by the shorter way, then have one sign.

References
----------
Seydel, Practical Bifurcation and Stability Analysis, chapters 5 and 7.
Yakubovich and Starzhinskii, Linear Differential Equations with Periodic Coefficients, 1975,
chapter 3.
"""

from __future__ import annotations

import math

import numpy as np

from fenics_crack.kernel import kernel, pointer
from fenics_crack.motion.orbit import MULTIPLIER_TOLERANCE
from fenics_crack.numerics.equations import ROOT_TOLERANCE, System
from fenics_crack.numerics.newton import PathPoint
from fenics_crack.numerics.path import (
    ConsecutivePathPoints,
    Event,
    StepEnds,
    StepRejectionRule,
    find_zero_point_and_function_value,
)

MULTIPLIER_LOG_CHANGE_ALWAYS_ALLOWED = 0.01
"""Maximum change in ln |mu| of a Floquet multiplier mu that every step may make."""

MIN_REJECTABLE_TO_LONGEST_STEP = 0.01
"""Minimum length of a step that may be rejected because multipliers change too much.

Relative to the longest step.
"""

MIN_REJECTABLE_COLLISION_STEP = 0.02
"""Minimum length of a step that may be rejected because of a multiplier collision.

Relative to the longest step. With the default longest step this is 0.1 % of the range.
"""


def leading_multipliers_and_counts(multipliers: np.ndarray) -> np.ndarray:
    """Select each point's largest Floquet multipliers, and count those outside the circle.

    Outside the unit circle means |mu| > 1 + 1e-6 for a multiplier mu. Only the selected multipliers
    are counted.

    Parameters
    ----------
    multipliers : (n_points, n) complex
        All multipliers at each point.

    Returns
    -------
    (n_points, k + 3) complex
        The k = min(n, 8) multipliers with the largest modulus, in descending order, then three
        counts: real ones above 1 (r), real ones below -1 (d), complex pairs outside the circle (c).
    """
    multiplier_moduli = np.abs(multipliers)
    leading_indices = np.argsort(-multiplier_moduli, axis=1, kind="stable")[:, :8]
    point_indices = np.arange(len(leading_indices))[:, None]
    multipliers = multipliers[point_indices, leading_indices]
    is_outside = multiplier_moduli[point_indices, leading_indices] > 1.0 + MULTIPLIER_TOLERANCE
    multipliers_and_counts = np.empty(
        (len(leading_indices), leading_indices.shape[1] + 3), dtype=complex
    )
    multipliers_and_counts[:, :-3] = multipliers
    is_real = multipliers.imag == 0.0
    multipliers_and_counts[:, -3] = (is_outside & is_real & (multipliers.real > 0.0)).sum(axis=1)
    multipliers_and_counts[:, -2] = (is_outside & is_real).sum(axis=1) - multipliers_and_counts[
        :, -3
    ]
    multipliers_and_counts[:, -1] = (is_outside & (multipliers.imag > 0.0)).sum(axis=1)
    return multipliers_and_counts


def changes_of_multiplier_counts(multipliers_and_counts: np.ndarray) -> np.ndarray:
    """Return changes in the counts of multipliers outside the unit circle, point by point.

    Two real multipliers that become a complex pair, or the reverse, change no count.

    Parameters
    ----------
    multipliers_and_counts : (n_points, k + 3) complex
        At each point k Floquet multipliers, then three counts of multipliers outside the circle:
        real above 1, real below -1, complex pairs.

    Returns
    -------
    (n_points - 1, 3)
        Change of the three counts from each point to the next.
    """
    count_changes = np.diff(multipliers_and_counts[:, -3:].real, axis=0)
    step_indices = np.flatnonzero(count_changes[:, 2])
    if not len(step_indices):
        return count_changes
    real_count_changes, complex_pair_count_changes = (
        count_changes[step_indices, :2],
        count_changes[step_indices, 2],
    )
    is_merger = (np.abs(real_count_changes).max(axis=1) == 2.0) & (
        real_count_changes.sum(axis=1) == -2.0 * complex_pair_count_changes
    )
    count_changes[step_indices[is_merger]] = 0.0
    return count_changes


def step_collision_severities(monodromy_matrices: np.ndarray) -> np.ndarray:
    """Return how close collisions bring Floquet multipliers to leaving the unit circle.

    If two multipliers mu_j and mu_k collide between two points, their ln |mu| separate. One leaves
    the circle if they separate by more than 2 sqrt(ln |mu_j| ln |mu_k|). The separation is
    predicted from the monodromy matrices at both points.

    Parameters
    ----------
    monodromy_matrices : (n_points, n, n)
        Matrices at the points, in order along the path.

    Returns
    -------
    (n_points - 1,)
        Largest separation between each point and the next, relative to that limit: above 1, a
        multiplier leaves the circle. inf if multipliers are not found.
    """
    n_points, n_states = monodromy_matrices.shape[:2]
    multiplier_collision_severities = np.empty(n_points - 1)
    contiguous_matrices = np.ascontiguousarray(monodromy_matrices)
    kernel.collision_severities(
        n_points,
        n_states,
        pointer(contiguous_matrices),
        MULTIPLIER_TOLERANCE,
        pointer(multiplier_collision_severities),
    )
    return multiplier_collision_severities


class MultiplierStepControl(StepRejectionRule):
    """Reject steps over which the Floquet multipliers mu change too much.

    A step above 0.01 ``longest_step`` is rejected if

    - a leading ln |mu| changes by more than half its distance to 0, and more than 0.01, or
    - linear extrapolation of the sorted ln |mu| has an error above the same limit.

    A step above 0.02 ``longest_step`` is rejected if two multipliers collide with a severity above
    1 (:func:`step_collision_severities`): one would leave the unit circle. Any step is rejected if
    two counts of multipliers outside the unit circle change, or if a count changes by more than 1.
    """

    def __init__(self, longest_step: float) -> None:
        self._min_rejectable_step = MIN_REJECTABLE_TO_LONGEST_STEP * longest_step
        self._min_rejectable_collision_step = MIN_REJECTABLE_COLLISION_STEP * longest_step

    def mark_rejected_steps(
        self, segment: ConsecutivePathPoints, first_index: int = 0
    ) -> np.ndarray:
        multiplier_log_moduli = np.log(
            np.maximum(np.abs(segment.step_control_values[:, :-3]), MULTIPLIER_TOLERANCE)
        )
        log_changes = np.diff(multiplier_log_moduli, axis=0)
        step_lengths = segment.chord_lengths[1:]
        allowed_log_change = np.maximum(
            0.5 * np.abs(multiplier_log_moduli[:-1]), MULTIPLIER_LOG_CHANGE_ALWAYS_ALLOWED
        )
        is_coarse = np.any(np.abs(log_changes) > allowed_log_change, axis=1)
        if len(log_changes) > 1:
            ratio_to_previous_step_length = (step_lengths[1:] / step_lengths[:-1])[:, None]
            prediction_error = np.abs(
                log_changes[1:] - ratio_to_previous_step_length * log_changes[:-1]
            )
            is_coarse[1:] |= np.any(prediction_error > allowed_log_change[1:], axis=1)
        n_states = math.isqrt(segment.records.shape[1])
        monodromy_matrices = segment.records[first_index:].reshape(-1, n_states, n_states)
        has_collision = step_collision_severities(monodromy_matrices) > 1.0
        is_coarse, step_lengths = is_coarse[first_index:], step_lengths[first_index:]
        is_coarse &= step_lengths > self._min_rejectable_step
        is_coarse |= has_collision & (step_lengths > self._min_rejectable_collision_step)
        has_several_events = (
            np.abs(changes_of_multiplier_counts(segment.step_control_values[first_index:])).sum(
                axis=1
            )
            > 1
        )
        return np.asarray(is_coarse | has_several_events)


class PeriodDoubling(Event):
    """Event at which a real Floquet multiplier crosses -1.

    The product of all 1 + mu, with the multipliers mu, changes its sign.
    """

    kind = "period_doubling"

    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        return np.asarray(changes_of_multiplier_counts(segment.step_control_values)[:, 1] != 0.0)

    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        point = find_zero_point_and_function_value(
            system,
            ends,
            lambda candidate: period_doubling_test_value(multipliers_of(candidate)),
            rtol,
        )[0]
        return point if np.abs(1.0 + multipliers_of(point)).min() <= MULTIPLIER_TOLERANCE else None


class NeimarkSacker(Event):
    """Event at which a complex pair of Floquet multipliers crosses the unit circle.

    |mu_k| - 1 changes its sign for the k-th pair mu_k, in descending order of |mu|.
    """

    kind = "neimark_sacker"

    def mark_steps_with_event(self, segment: ConsecutivePathPoints) -> np.ndarray:
        return np.asarray(changes_of_multiplier_counts(segment.step_control_values)[:, 2] != 0.0)

    def locate(self, system: System, ends: StepEnds, rtol: float) -> PathPoint | None:
        assert ends[0].step_control_values is not None and ends[1].step_control_values is not None
        multiplier_pair_index = (
            int(max(ends[0].step_control_values[-1].real, ends[1].step_control_values[-1].real)) - 1
        )
        end_excesses = [
            complex_pair_modulus_excess(multipliers_of(end), multiplier_pair_index) for end in ends
        ]
        # A pair within the tolerance of the circle may have been outside all along.
        target_modulus_excess = (
            0.0 if end_excesses[0] * end_excesses[1] < 0.0 else MULTIPLIER_TOLERANCE
        )

        def crossing_function(point: PathPoint) -> float:
            """Return |mu| - 1 of the pair mu at a point; its zero is the bifurcation.

            If both ends lie on the same side of the circle, the tolerance 1e-6 is subtracted.
            Numbers within rounding are returned as 0.
            """
            excess_over_crossing = (
                complex_pair_modulus_excess(multipliers_of(point), multiplier_pair_index)
                - target_modulus_excess
            )
            return excess_over_crossing if abs(excess_over_crossing) > ROOT_TOLERANCE else 0.0

        zero_point, excess_at_located_point = find_zero_point_and_function_value(
            system, ends, crossing_function, rtol
        )
        return zero_point if abs(excess_at_located_point) <= MULTIPLIER_TOLERANCE else None


def multipliers_of(point: PathPoint) -> np.ndarray:
    """Return the leading Floquet multipliers at a path point: (k,) complex, k at most 8."""
    assert point.step_control_values is not None
    return point.step_control_values[:-3]


def period_doubling_test_value(multipliers: np.ndarray) -> float:
    """Return a number that changes its sign at a period doubling.

    The number is the product of 1 + mu over all Floquet multipliers mu (n,); for complex mu, of |1
    + mu|. Factors above 1 in modulus are scaled to 1. The result is 0 if a factor is at most
    1.5e-8.
    """
    one_plus_multipliers = np.where(
        multipliers.imag == 0.0, 1.0 + multipliers.real, np.abs(1.0 + multipliers)
    )
    scaled_product = float(
        np.prod(one_plus_multipliers / np.maximum(1.0, np.abs(one_plus_multipliers)))
    )
    return scaled_product if np.abs(one_plus_multipliers).min() > ROOT_TOLERANCE else 0.0


def complex_pair_modulus_excess(multipliers: np.ndarray, multiplier_pair_index: int) -> float:
    """Return |mu| - 1 for one complex pair of Floquet multipliers mu.

    Pairs are numbered by ``multiplier_pair_index`` from 0 on in descending order of |mu|. If there
    are fewer pairs, return -1.
    """
    pair_moduli = np.sort(np.abs(multipliers[multipliers.imag > 0.0]))[::-1]
    return (
        float(pair_moduli[multiplier_pair_index] - 1.0)
        if len(pair_moduli) > multiplier_pair_index
        else -1.0
    )
