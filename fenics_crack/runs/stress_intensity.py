"""Stress intensity at crack tips and fronts over a motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import Tabular
from fenics_crack.errors.stated import estimate_result_errors
from fenics_crack.errors.verification import Verification
from fenics_crack.runs.run import Run, check_run_has_motion
from fenics_crack.scene.scene import reason_without_stress_intensity, refuse_for_reason
from fenics_crack.study.observer import (
    CrackTipHistory,
    compute_crack_tip_histories,
    leading_crack_tip_index,
    make_tips_and_intensity_rows,
    station_indices_by_front,
    tabulate_stress_intensity_values,
)
from fenics_crack.time.march import TimeHistory


@keep_old_attribute_names(
    ahead="growth_directions", one="K_I", two="K_II", three="K_III", closed="closed_front_errors",
    leading="leading_tip_index", fronts="station_indices_by_front", turn="crack_kink_angles",
    positions="distances_along_crack",
)  # fmt: skip
@keep_old_attribute_names(
    largest="max_K_I_by_tip",
    smallest="min_K_I_by_tip",
    tips="tip_names",
    turning_angles="crack_kink_angles",
)
@dataclass(frozen=True, repr=False)
class StressIntensity(Tabular):
    """Stress intensity factors at crack tips or front stations over a motion.

    A plate has K_I and K_II at its crack tips. A solid has K_I, K_II and K_III at stations along
    its crack fronts, one front after the other. Tips below stand for tips or stations.

    Attributes
    ----------
    time : (n,) [s]
        Instants in one period of a solution, or in the record of a motion in time.
    tip_names : tuple of str
        Names: "the crack tip", "the left crack tip", "the crack tip of crack 2". A station is named
        by its distance from the front's beginning: "the crack front at 3.2 mm".
    distances_along_crack : (n_tips,) [m]
        Distances along the crack; in a solid along the front, from its beginning.
    points, growth_directions : (n_tips, d) [m], (n_tips, d)
        Positions of the tips, and unit vectors in which the cracks run straight on.
    K_I, K_II : (n, n_tips) [Pa m^1/2]
        K_I is positive if the crack faces part. K_II is positive if the left face, seen in the
        growth direction, moves ahead. At a front with zero clearance K_I is never negative, and
        exactly zero while all contact patches next to the station are closed.
    K_III : (n, n_tips) [Pa m^1/2] or None
        K_III, positive if the upper face moves along the front, in the direction e_3 = e_1 x e_2.
        e_1 points ahead, and e_2 from the lower to the upper face. None for a plate.
    closed_front_errors : (n_tips,) [Pa m^1/2]
        Error of K_I in a solid with zero clearance: the largest abs(K_I) replaced by zero. K_I is
        replaced by zero while all contact pairs next to the station are closed, and while the
        computed K_I is negative.
    """

    time: np.ndarray
    tip_names: tuple[str, ...]
    distances_along_crack: np.ndarray
    points: np.ndarray
    growth_directions: np.ndarray
    K_I: np.ndarray
    K_II: np.ndarray
    K_III: np.ndarray | None
    closed_front_errors: np.ndarray
    _run: Run[Any] = field(compare=False)
    _tip_histories: list[CrackTipHistory] = field(compare=False)

    @cached_property
    def numbers(self) -> Mapping[str, np.ndarray]:
        """Extremes and ranges over time at each tip, by name: (n_tips,) [Pa m^1/2].

        K_max and K_min are the largest and smallest K_I, and delta_K = K_max - K_min.
        delta_K_effective is the range of positive K_I: max(K_max, 0) - max(K_min, 0). K_II_max, and
        K_III_max in a solid, are largest absolute values.

        With a table ``[growth]``, delta_K_equivalent is added. Crack growth by one cycle of K_I
        from 0 to delta_K_equivalent equals growth by all rainflow cycles in a load period.
        """
        return tabulate_stress_intensity_values(self._tip_histories)

    @property
    def max_K_I_by_tip(self) -> np.ndarray:
        """Largest K_I at each tip over time: (n_tips,) [Pa m^1/2]."""
        return self.numbers["K_max"]

    @property
    def min_K_I_by_tip(self) -> np.ndarray:
        """Smallest K_I at each tip over time: (n_tips,) [Pa m^1/2]."""
        return self.numbers["K_min"]

    @property
    def effective(self) -> np.ndarray:
        """Range of positive K_I at each tip: (n_tips,) [Pa m^1/2].

        The range is max(K_max, 0) - max(K_min, 0), since only the open tip counts.
        """
        return self.numbers["delta_K_effective"]

    @property
    def leading_tip_index(self) -> int:
        """Index of the tip or station with the largest :attr:`effective` range."""
        return leading_crack_tip_index(self._tip_histories)

    @property
    def comm(self) -> MPI.Comm:
        """MPI communicator of the ranks that share the structure."""
        return self._run.structure.comm

    @property
    def station_indices_by_front(self) -> dict[str, list[int]]:
        """Indices of the stations along each crack front, by the front's name.

        A plate has no fronts: all tips are listed under the name "".
        """
        return station_indices_by_front(self.tip_names)

    @property
    def crack_kink_angles(self) -> np.ndarray:
        """Angle by which cracks turn left at largest K_I: (n_tips,) [rad].

        The crack turns by the angle theta with the largest hoop stress: K_I sin(theta) + K_II (3
        cos(theta) - 1) = 0 (Erdogan, Sih, Journal of Basic Engineering 85, 1963, 519). The angle is
        nan if K_I is never positive.
        """
        instant_index_of_largest = self.K_I.argmax(axis=0)[None]
        K_I_at_its_maximum = np.take_along_axis(self.K_I, instant_index_of_largest, axis=0)[0]
        K_II_at_maximum_K_I = np.take_along_axis(self.K_II, instant_index_of_largest, axis=0)[0]
        angles = -2.0 * np.arctan(
            2.0
            * K_II_at_maximum_K_I
            / (K_I_at_its_maximum + np.sqrt(K_I_at_its_maximum**2 + 8.0 * K_II_at_maximum_K_I**2))
        )
        return np.where(K_I_at_its_maximum > 0.0, angles, np.nan)

    @cached_property
    def errors(self) -> Verification | None:
        """Estimated errors of the :attr:`numbers` at the leading tip (collective).

        The errors are computed at first use. None for motions in time, and for solutions that have
        not converged or have no estimated errors.
        """
        scene = self._run.scene.replace({"output.quantities": tuple(self.numbers)})
        return estimate_result_errors(
            replace(self._run, scene=scene, stated=None), self._run.result
        )

    def to_dict(self) -> dict[str, Any]:
        """Return columns by name, with a row for every instant.

        Columns are "time" [s], "K_I, the crack tip" [Pa m^1/2], and so on for each tip.
        """
        values_by_column = {"time": self.time.tolist()}
        values_by_name = {"K_I": self.K_I, "K_II": self.K_II} | (
            {} if self.K_III is None else {"K_III": self.K_III}
        )
        for tip_index, tip_name in enumerate(self.tip_names):
            values_by_column |= {
                f"{name}, {tip_name}": values[:, tip_index].tolist()
                for name, values in values_by_name.items()
            }
        return values_by_column

    def _unit_by_name(self) -> Mapping[str, str]:
        return {name: "s" if name == "time" else "Pa m^0.5" for name in self.to_dict()}

    def _repr_text(self) -> str:
        tip_index = self.leading_tip_index
        number_texts = [
            f"{name} = {values[tip_index]:.4g}" for name, values in self.numbers.items()
        ]
        return f"{', '.join(number_texts)} Pa m^0.5 at {self.tip_names[tip_index]}"


def stress_intensity(run: Run[PeriodicSolution] | Run[TimeHistory]) -> StressIntensity:
    r"""Find stress intensity factors at crack tips or fronts over a motion (collective).

    K_I and K_II at each instant follow from the displacement by the interaction integral. Its
    domain surrounds the tip or front, with inertia inside and contact on the crack faces. A front
    has K_III, too. At a station, K is the mean over a neighbourhood along the front. K at the
    surface is extrapolated linearly from the next two stations (docs/solids.md).

    The error of K_I due to the mesh is of first order in the element size. The attribute
    ``closed_front_errors`` states the error at fronts closed by contact. In a reduced structure the
    static response K_static to the load f and the contact forces lambda is exact. Mode r adds K_r
    times the amplitude q_r less the static amplitude:

    .. math:: K = K_{\mathrm{static}}(f, \lambda) + \sum_r K_r (q_r - q_{r,\mathrm{static}})

    Here K_r is mode r's stress intensity at unit amplitude.

    Parameters
    ----------
    run : Run
        Result of :func:`fenics_crack.solve` or :func:`fenics_crack.integrate`, for a plate or a
        solid with a crack.

    Returns
    -------
    StressIntensity
        Stress intensities over a period of a solution (1024 instants or more), or over the record
        of a motion in time.

    Raises
    ------
    InputError
        The run is of another kind, or of matrices or a disk. Or it has friction, a preload by its
        clearance, or no crack. Or the elements at a crack tip or front are too long.

    Examples
    --------
    >>> found = fc.stress_intensity(fc.solve(scene))
    >>> found.largest, found.effective, found.crack_kink_angles
    """
    check_run_has_motion(run)
    refuse_for_reason(reason_without_stress_intensity(run.scene), "run", repr(run))
    tips, K_rows_of_displacement, K_rows_of_contact_forces = make_tips_and_intensity_rows(run)
    [record] = run.result.yield_motion_records(K_rows_of_displacement)
    tip_histories = compute_crack_tip_histories(
        record, tips, K_rows_of_contact_forces, run.scene.growth
    )
    K_III_columns = [
        tip_history.K_III for tip_history in tip_histories if tip_history.K_III is not None
    ]
    return StressIntensity(
        record.time,
        tuple(tip.name for tip in tips),
        np.array([tip.arc_length for tip in tips]),
        np.array([tip.point for tip in tips]),
        np.array([tip.growth_direction for tip in tips]),
        np.column_stack([tip_history.K_I for tip_history in tip_histories]),
        np.column_stack([tip_history.K_II for tip_history in tip_histories]),
        np.column_stack(K_III_columns) if K_III_columns else None,
        np.array([tip_history.closed_front_error for tip_history in tip_histories]),
        run,
        tip_histories,
    )
