"""Numerical settings of identification; its priors are keys of ``[identify]``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """Settings on which results depend less than on any prior."""

    most_measurements: int = 1000
    """Maximum number of measurements: their covariance is factorised at each point of the grid."""

    # Cases of the forward model.
    magnification: float = 2.0
    """Maximum vibration between solved cases, relative to the largest at any of them; cases are
    added where it is exceeded and a steady load or a clearance makes the motion depend on it."""
    interpolated: float = 0.2
    """Maximum share of interpolation in the variance of a measurement (1.12 times its standard
    deviation); cases are added where it is exceeded."""
    most_added: int = 8
    """Maximum number of solved cases, relative to those of ``[identify.unknown]``."""

    # Interpolation.
    left_out: float = 0.3
    """Interpolation error relative to the leave-one-out error, which is that of twice the spacing:
    1/16 for smooth quantities, 3/4 where meshes make them uneven."""
    averaging: float = 1.25
    """Width of the Gaussian weights by which errors at nodes are averaged [node spacings]."""
    neighbours: int = 16
    """Maximum number of nodes over which errors are averaged."""

    # Posterior.
    starts: int = 8
    """Maximum number of starts of least squares."""
    reach: float = 5.0
    """Half width of the refined grid around an optimum [standard deviations]."""
    worse: float = 8.0
    """Optima this far below the maximum of log L are neglected."""
    skipped: float = 300.0
    """Grid points this far below the maximum of log L are not evaluated again."""
    batch: int = 500
    """Points at which the likelihood is evaluated together, to bound memory."""
    least_part: float = 0.03
    """Minimum probability of a separate part of the region that is reported."""
    frequency_deviation: float = 1e-3
    """Relative standard deviation of natural frequencies that are advised."""


OPTIONS = Options()
