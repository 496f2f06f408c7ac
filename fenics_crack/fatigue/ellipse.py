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

from fenics_crack.scene.tables import Growth as Law

GrowthEnd = Literal["reached", "arrested", "broken", "side"]
N_PATH_ROWS = 200
"""Number of rows in the path of the crack shape."""
THRESHOLD_RAMP_FRACTION = 0.01
"""Range above the threshold at which the rate is full, relative to the threshold.

The rate rises linearly from zero. The fraction is below the errors of K. With a jump instead, a
shape that grows along the threshold, as deep cracks in bending do, needs endless steps.
"""
DEEPEST_COLUMN_FORMAT, SURFACE_COLUMN_FORMAT = "delta_K_{}_deepest", "delta_K_{}_surface"
EQUIVALENT_RANGE_COLUMNS = tuple(
    name.format("equivalent") for name in (DEEPEST_COLUMN_FORMAT, SURFACE_COLUMN_FORMAT)
)
EFFECTIVE_RANGE_COLUMNS = tuple(
    name.format("effective") for name in (DEEPEST_COLUMN_FORMAT, SURFACE_COLUMN_FORMAT)
)


@dataclass(frozen=True)
class EllipseTable:
    """Columns on a grid of depths and lengths, and their splines.

    Attributes
    ----------
    depths : (k,) [m]
        Depths a in ascending order.
    lengths : (l,) [m]
        Lengths of the crack along the face in ascending order: c, or 2 c.
    column_by_name : dict of str to (k, l)
        Values at all sizes. Names of stress intensities begin with "K" or "delta_K".
    """

    depths: np.ndarray
    lengths: np.ndarray
    column_by_name: Mapping[str, np.ndarray]

    @cached_property
    def _spline_by_column(self) -> dict[str, Any]:
        """Fit a spline over ln a and ln c to each column, by name."""
        from scipy.interpolate import RectBivariateSpline  # takes a while, and is needed here alone

        log_axes = np.log(self.depths), np.log(self.lengths)
        depth_degree, length_degree = (min(3, len(log_axis) - 1) for log_axis in log_axes)
        column_divisors = np.sqrt(self.depths)[:, None], 1.0
        return {
            column_name: RectBivariateSpline(
                *log_axes,
                column / column_divisors[not _is_stress_intensity(column_name)],
                kx=depth_degree,
                ky=length_degree,
            )
            for column_name, column in self.column_by_name.items()
        }

    def interpolate_column(
        self, column_name: str, depth: np.ndarray, length: np.ndarray
    ) -> np.ndarray:
        """Interpolate a column at depths and lengths (n,) within the grid.

        Ranges are at least zero.
        """
        column_values = self._spline_by_column[column_name].ev(np.log(depth), np.log(length))
        column_values = (
            column_values.clip(0.0) if column_name.startswith("delta_K") else column_values
        )
        return np.asarray(
            column_values * np.sqrt(depth) if _is_stress_intensity(column_name) else column_values
        )

    def with_every_second_size(self) -> EllipseTable:
        """Return the table with every second depth and length."""
        coarse_column_by_name = {
            column_name: column[::2, ::2] for column_name, column in self.column_by_name.items()
        }
        return EllipseTable(self.depths[::2], self.lengths[::2], coarse_column_by_name)


def _is_stress_intensity(column_name: str) -> bool:
    """Return True for a stress intensity, which scales with the root of the depth."""
    return column_name.startswith(("K", "delta_K"))


class EllipsePath(NamedTuple):
    """Sizes of a growing crack over the cycles.

    Attributes
    ----------
    depth, length : (n,) [m]
        Depth, and length along the face.
    cycles : (n,)
        Cycles until each size.
    growth_per_cycle : (n, 2) [m]
        Growth of depth and length in a cycle.
    end_reason : str
        Why growth ends: "reached", "arrested", "broken" or "side".
    """

    depth: np.ndarray
    length: np.ndarray
    cycles: np.ndarray
    growth_per_cycle: np.ndarray
    end_reason: GrowthEnd


def compute_growth_per_cycle(
    table: EllipseTable, law: Law, n_surface_ends: int, depth: np.ndarray, length: np.ndarray
) -> np.ndarray:
    """Return the growth of depths and lengths (n,) in a cycle: (n, 2) [m].

    The crack has one or two ends on the face, ``n_surface_ends``.
    """
    growth_rates = []
    for equivalent_column, effective_column in zip(
        EQUIVALENT_RANGE_COLUMNS, EFFECTIVE_RANGE_COLUMNS, strict=True
    ):
        growth_rate = (
            law.rate
            * (table.interpolate_column(equivalent_column, depth, length) / 1e6) ** law.exponent
        )
        if law.threshold > 0.0:
            threshold_excess = (
                table.interpolate_column(effective_column, depth, length) / law.threshold - 1.0
            )
            growth_rate = growth_rate * np.clip(
                threshold_excess / THRESHOLD_RAMP_FRACTION, 0.0, 1.0
            )
        growth_rates.append(growth_rate)
    return np.stack([growth_rates[0], n_surface_ends * growth_rates[1]], axis=-1)


def integrate_ellipse_growth(table: EllipseTable, law: Law, n_surface_ends: int) -> EllipsePath:
    """Integrate the growth from the first size of a table to its end.

    The variable s is the sum of the growth in depth a and length l. Then da/ds and dl/ds are
    bounded, and dN/ds = 1 / (da/dN + dl/dN). A depth that stops growing causes no difficulty.
    """
    from scipy.integrate import solve_ivp

    toughness = law.toughness or np.inf

    def growth_rates(state: np.ndarray) -> np.ndarray:
        return compute_growth_per_cycle(table, law, n_surface_ends, *state[:2, None])[0]

    def state_slope(_s: float, state: np.ndarray) -> np.ndarray:
        growth_per_cycle = growth_rates(state)
        total_growth = growth_per_cycle.sum()
        return (
            np.append(growth_per_cycle, 1.0) / total_growth if total_growth > 0.0 else np.zeros(3)
        )

    event_function_by_reason = {
        "reached": lambda _s, state: state[0] - table.depths[-1],
        "side": lambda _s, state: state[1] - table.lengths[-1],
        "broken": lambda _s, state: (
            float(table.interpolate_column("K_max", *state[:2, None])[0]) / toughness - 1.0
        ),
        "arrested": lambda _s, state: -1.0 if growth_rates(state).any() else 0.0,
    }
    for event_function in event_function_by_reason.values():
        event_function.terminal = True  # type: ignore[attr-defined]
    start_state = np.array([table.depths[0], table.lengths[0], 0.0])
    max_growth_sum = np.ptp(table.depths) + np.ptp(table.lengths)
    ode_solution = solve_ivp(
        state_slope, (0.0, max_growth_sum), start_state, "LSODA", rtol=1e-8, atol=1e-12,
        max_step=max_growth_sum / N_PATH_ROWS,
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
    if float(table.interpolate_column("K_max", *start_state[:2, None])[0]) >= toughness:
        end_reason, last_growth_sum = "broken", 0.0
    else:
        last_growth_sum = ode_solution.t[-1] if growth_rates(start_state).any() else 0.0
    depth, length, cycles = ode_solution.sol(
        np.linspace(0.0, last_growth_sum, N_PATH_ROWS if last_growth_sum else 1)
    )
    growth_per_cycle = compute_growth_per_cycle(table, law, n_surface_ends, depth, length)
    return EllipsePath(depth, length, cycles, growth_per_cycle, end_reason)
