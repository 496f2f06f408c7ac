"""Growth of a crack shaped as half or a quarter of an ellipse, in depth and along the face.

Let delta K_a be the range of K_I at the deepest point, and delta K_c the range at the ends, on the
solid's face. The depth a and the half axis c along the face grow in a cycle by

    da/dN = C delta K_a^m,      dc/dN = C delta K_c^m.

The front stays an ellipse (Newman, Raju, NASA TM-83200, 1981). Ranges are known on a grid of
depths and lengths. Between them, K / a^(1/2) is a spline over ln a and ln c. The spline has no
logarithm of K, since in bending K falls to zero at the deepest point.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from fenics_crack.scene.result_tables import Growth as Law

GrowthEnd = Literal["reached", "arrested", "broken", "side"]
N_PATH_ROWS = 200
"""Number of sizes in an :class:`EllipseSizePath`; a crack without growth has one."""
THRESHOLD_RAMP_FRACTION = 0.01
"""Relative excess over the threshold at which growth has its full rate.

With the effective range delta K of K_I, the rate rises linearly from 0 at growth.threshold to the
growth law at 1.01 times the threshold. The fraction is below the errors of K. With a jump instead,
a shape that grows along the threshold, as deep cracks in bending do, needs endless steps.
"""
DEEPEST_COLUMN_NAME_FORMAT, SURFACE_COLUMN_NAME_FORMAT = "delta_K_{}_deepest", "delta_K_{}_surface"
EQUIVALENT_RANGE_COLUMN_NAMES = tuple(
    name.format("equivalent") for name in (DEEPEST_COLUMN_NAME_FORMAT, SURFACE_COLUMN_NAME_FORMAT)
)
EFFECTIVE_RANGE_COLUMN_NAMES = tuple(
    name.format("effective") for name in (DEEPEST_COLUMN_NAME_FORMAT, SURFACE_COLUMN_NAME_FORMAT)
)


@dataclass(frozen=True)
class EllipseTable:
    """Solutions at a grid of crack depths and lengths, with splines between them.

    Attributes
    ----------
    depths : (k,) [m]
        Depths a in ascending order.
    lengths : (l,) [m]
        Lengths of the crack along the face in ascending order: 2 c for a half-ellipse, c for a
        quarter at an edge.
    column_by_name : dict of str to (k, l)
        Frequencies, response and stress intensities of all shapes, by name of the sweep's column.
        Names of stress intensities and their ranges begin with "K" or "delta_K".
    """

    depths: np.ndarray
    lengths: np.ndarray
    column_by_name: Mapping[str, np.ndarray]

    @cached_property
    def _spline_by_column(self) -> dict[str, Any]:
        """Fit a spline over ln(depth) and ln(length) to each column.

        Keys are column names. Stress intensities are divided by sqrt(depth) before the fit. The
        degree is 3, or k - 1 for an axis with k < 4 sizes.
        """
        from scipy.interpolate import RectBivariateSpline  # takes a while, and is needed here alone

        log_depths_and_lengths = np.log(self.depths), np.log(self.lengths)
        depth_degree, length_degree = (
            min(3, len(log_sizes) - 1) for log_sizes in log_depths_and_lengths
        )
        stress_and_other_divisors = np.sqrt(self.depths)[:, None], 1.0
        return {
            column_name: RectBivariateSpline(
                *log_depths_and_lengths,
                column / stress_and_other_divisors[not _is_stress_intensity_column(column_name)],
                kx=depth_degree,
                ky=length_degree,
            )
            for column_name, column in self.column_by_name.items()
        }

    def interpolate_column(
        self, column_name: str, depths: np.ndarray, lengths: np.ndarray
    ) -> np.ndarray:
        """Interpolate a column at depths and lengths (n,) [m] inside the grid.

        Return (n,) in the unit of the column. Negative interpolated ranges ("delta_K...") become 0.
        """
        column_values = self._spline_by_column[column_name].ev(np.log(depths), np.log(lengths))
        column_values = (
            column_values.clip(0.0) if column_name.startswith("delta_K") else column_values
        )
        return np.asarray(
            column_values * np.sqrt(depths)
            if _is_stress_intensity_column(column_name)
            else column_values
        )

    def with_every_second_size(self) -> EllipseTable:
        """Return a coarser table with every second depth and length.

        The change of the life with this table shows the interpolation error.
        """
        coarse_column_by_name = {
            column_name: column[::2, ::2] for column_name, column in self.column_by_name.items()
        }
        return EllipseTable(self.depths[::2], self.lengths[::2], coarse_column_by_name)


def _is_stress_intensity_column(column_name: str) -> bool:
    """Return True if a column has stress intensities, or their ranges.

    Stress intensities scale with sqrt(depth), and are interpolated after division by this root.
    """
    return column_name.startswith(("K", "delta_K"))


class EllipseSizePath(NamedTuple):
    """Depth and length of a growing half-ellipse over the load cycles.

    Attributes
    ----------
    depth, length_along_face : (n,) [m]
        Depth, and length along the face.
    cycles : (n,)
        Load cycles from the beginning until each size.
    growth_per_cycle : (n, 2) [m]
        Growth of depth and length in a load cycle.
    end_reason : str
        Why growth ends: "reached" (depth growth.until), "arrested" (no growth in either direction),
        "broken" (K_max reaches the toughness), or "side" (the largest length in the table).
    """

    depth: np.ndarray
    length_along_face: np.ndarray
    cycles: np.ndarray
    growth_per_cycle: np.ndarray
    end_reason: GrowthEnd


def compute_growth_per_cycle(
    ellipse_table: EllipseTable,
    law: Law,
    n_surface_ends: int,
    depths: np.ndarray,
    lengths: np.ndarray,
) -> np.ndarray:
    """Return the growth of depth and length in a load cycle: (n, 2) [m].

    Let delta K_a be the range of K_I at the deepest point, and delta K_c at the ends on the face
    [MPa m^0.5]: from 0, with the same growth in a load period. Then

        da/dN = C delta K_a^m,      dl/dN = n_surface_ends C delta K_c^m.

    Below ``growth.threshold`` for the range while the tip is open, the growth is 0
    (:data:`THRESHOLD_RAMP_FRACTION`).

    Parameters
    ----------
    ellipse_table : EllipseTable
        Ranges of K_I over the shapes.
    law : Growth
        Table ``[growth]`` with C, m and the threshold.
    n_surface_ends : int
        Number of crack ends on the face: 2, or 1 for a quarter-ellipse at an edge.
    depths, lengths : (n,) [m]
        Shapes inside the table.
    """
    growth_rates = []
    for equivalent_column_name, effective_column_name in zip(
        EQUIVALENT_RANGE_COLUMN_NAMES, EFFECTIVE_RANGE_COLUMN_NAMES, strict=True
    ):
        growth_rate = (
            law.rate
            * (ellipse_table.interpolate_column(equivalent_column_name, depths, lengths) / 1e6)
            ** law.exponent
        )
        if law.threshold > 0.0:
            relative_threshold_excess = (
                ellipse_table.interpolate_column(effective_column_name, depths, lengths)
                / law.threshold
                - 1.0
            )
            growth_rate = growth_rate * np.clip(
                relative_threshold_excess / THRESHOLD_RAMP_FRACTION, 0.0, 1.0
            )
        growth_rates.append(growth_rate)
    return np.stack([growth_rates[0], n_surface_ends * growth_rates[1]], axis=-1)


def integrate_ellipse_growth(
    ellipse_table: EllipseTable, law: Law, n_surface_ends: int
) -> EllipseSizePath:
    """Integrate the growth of a half-ellipse from a table's first shape.

    Growth ends as :attr:`EllipseSizePath.end_reason` describes. ``n_surface_ends`` is as in
    :func:`compute_growth_per_cycle`. The integration variable s is the sum of the growth in depth a
    and length l. Then da/ds and dl/ds are bounded, and dN/ds = 1 / (da/dN + dl/dN). A depth that
    stops growing causes no difficulty.
    """
    from scipy.integrate import solve_ivp

    toughness = law.toughness or np.inf

    def compute_growth_rates(depth_length_cycles: np.ndarray) -> np.ndarray:
        return compute_growth_per_cycle(
            ellipse_table, law, n_surface_ends, *depth_length_cycles[:2, None]
        )[0]

    def compute_state_slope(_s: float, depth_length_cycles: np.ndarray) -> np.ndarray:
        growth_per_cycle = compute_growth_rates(depth_length_cycles)
        total_growth_per_cycle = growth_per_cycle.sum()
        return (
            np.append(growth_per_cycle, 1.0) / total_growth_per_cycle
            if total_growth_per_cycle > 0.0
            else np.zeros(3)
        )

    event_function_by_reason = {
        "reached": lambda _s, depth_length_cycles: (
            depth_length_cycles[0] - ellipse_table.depths[-1]
        ),
        "side": lambda _s, depth_length_cycles: depth_length_cycles[1] - ellipse_table.lengths[-1],
        "broken": lambda _s, depth_length_cycles: (
            float(ellipse_table.interpolate_column("K_max", *depth_length_cycles[:2, None])[0])
            / toughness
            - 1.0
        ),
        "arrested": lambda _s, depth_length_cycles: (
            -1.0 if compute_growth_rates(depth_length_cycles).any() else 0.0
        ),
    }
    for event_function in event_function_by_reason.values():
        event_function.terminal = True  # type: ignore[attr-defined]
    start_depth_length_cycles = np.array([ellipse_table.depths[0], ellipse_table.lengths[0], 0.0])
    growth_sum_bound = np.ptp(ellipse_table.depths) + np.ptp(ellipse_table.lengths)
    ode_solution = solve_ivp(
        compute_state_slope, (0.0, growth_sum_bound), start_depth_length_cycles, "LSODA",
        rtol=1e-8, atol=1e-12, max_step=growth_sum_bound / N_PATH_ROWS,
        events=list(event_function_by_reason.values()), dense_output=True,
    )  # fmt: skip
    met_reasons = [
        reason
        for reason, event_growth_sums in zip(
            event_function_by_reason, ode_solution.t_events, strict=True
        )
        if len(event_growth_sums)
    ]
    end_reason: GrowthEnd = met_reasons[0] if met_reasons else "arrested"  # type: ignore[assignment]
    if (
        float(ellipse_table.interpolate_column("K_max", *start_depth_length_cycles[:2, None])[0])
        >= toughness
    ):
        end_reason, last_growth_sum = "broken", 0.0
    else:
        last_growth_sum = (
            ode_solution.t[-1] if compute_growth_rates(start_depth_length_cycles).any() else 0.0
        )
    depths, lengths, cycles = ode_solution.sol(
        np.linspace(0.0, last_growth_sum, N_PATH_ROWS if last_growth_sum else 1)
    )
    growth_per_cycle = compute_growth_per_cycle(ellipse_table, law, n_surface_ends, depths, lengths)
    return EllipseSizePath(depths, lengths, cycles, growth_per_cycle, end_reason)
