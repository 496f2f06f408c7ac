"""Numerical settings of identification; priors are keys of ``[identify]``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """Numerical settings of an identification.

    The results depend less on these settings than on any prior in ``[identify]``.
    """

    max_measurements: int = 1000
    """Maximum number of measurements, since each grid point factorises their covariance."""

    # Cases of the forward model.
    max_unsolved_to_solved_vibration: float = 2.0
    """Maximum vibration between solved cracks, over the largest at any solved crack.

    Above the ratio more cracks are solved, unless the motion is proportional to the load
    (:func:`has_load_independent_motion_shape`).
    """
    allowed_interpolation_share: float = 0.2
    """Maximum part of a measurement's variance that interpolation between cases may cause.

    Above this part more cases are solved. A part of 0.2 raises the standard deviation 1.12 times.
    """
    max_solved_to_requested_case_ratio: int = 8
    """Maximum number of solved cases over the number of cases in ``[identify.unknown]``."""

    # Interpolation.
    error_per_leave_one_out_error: float = 0.3
    """Interpolation error over the error with a solved value left out.

    Without the value the spacing is doubled: the ratio is 1/16 for smooth quantities, and 3/4 if
    meshes make quantities uneven.
    """
    error_averaging_width_in_nodes: float = 1.25
    """Width of the Gaussian weights in averages of errors over grid nodes [node spacings]."""
    max_nodes_in_error_average: int = 16
    """Maximum number of grid nodes in an average of interpolation errors."""

    # Posterior.
    max_least_squares_starts: int = 8
    """Maximum number of start points for least squares."""
    refined_half_width_in_deviations: float = 5.0
    """Half width of the refined grid around an optimum [standard deviations]."""
    max_log_drop_of_kept_optima: float = 8.0
    """Maximum distance of log L below the best optimum; lower optima are neglected."""
    max_log_drop_below_best_to_evaluate: float = 300.0
    """Maximum distance of log L below the best optimum for points on the refined grid.

    Lower points keep values that are interpolated on the first grid.
    """
    points_per_batch: int = 500
    """Number of grid points in one evaluation of the likelihood, to limit the memory."""
    min_part_probability: float = 0.03
    """Minimum probability of a separate part of the credible region in reports.

    A larger probability that the grid does not resolve causes a warning.
    """
    relative_frequency_deviation_in_advice: float = 1e-3
    """Relative standard deviation of natural frequencies in advice on measurements."""


IDENTIFICATION_VALUES = Options()
"""Settings of every identification."""
