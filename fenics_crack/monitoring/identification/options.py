"""Numerical settings of identification; priors are keys of ``[identify]``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """Numerical settings: results depend on them less than on any prior."""

    max_measurements: int = 1000
    """Maximum number of measurements: each grid point factorises their covariance."""

    # Cases of the forward model.
    allowed_vibration_ratio: float = 2.0
    """Allowed vibration between solved cases, relative to the largest at any case.

    Above it cases are added if a steady load or a clearance makes the motion depend on it.
    """
    allowed_interpolation_share: float = 0.2
    """Allowed share of interpolation in a measurement's variance (1.12 times its deviation).

    Above it cases are added.
    """
    max_solved_case_ratio: int = 8
    """Maximum number of solved cases over the number in ``[identify.unknown]``."""

    # Interpolation.
    error_per_leave_one_out_error: float = 0.3
    """Interpolation error relative to the leave-one-out error, at twice the spacing.

    The ratio is 1/16 for smooth quantities, and 3/4 if meshes make them uneven.
    """
    error_averaging_width_in_nodes: float = 1.25
    """Width of the Gaussian weights that average errors at nodes [node spacings]."""
    max_averaged_nodes: int = 16
    """Maximum number of nodes in an average of errors."""

    # Posterior.
    max_least_squares_starts: int = 8
    """Maximum number of starts of least squares."""
    refined_half_width_in_deviations: float = 5.0
    """Half width [standard deviations] for the refined grid around an optimum."""
    allowed_optimum_log_drop: float = 8.0
    """Optima further below the maximum of log L are neglected."""
    allowed_grid_log_drop: float = 300.0
    """Grid points further below the maximum of log L are not evaluated again."""
    points_per_batch: int = 500
    """Number of points per evaluation of the likelihood, to bound memory."""
    min_part_probability: float = 0.03
    """Minimum probability of a separate part of the region in reports."""
    advised_frequency_deviation: float = 1e-3
    """Relative standard deviation of natural frequencies in advice."""


OPTIONS = Options()
"""The settings of all identifications."""
