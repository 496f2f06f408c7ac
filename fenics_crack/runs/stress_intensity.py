"""Stress intensity at crack tips and fronts over a motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
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
)
from fenics_crack.time.march import TimeHistory


@dataclass(frozen=True, repr=False)
class StressIntensity(Tabular):
    """K_I and K_II at the tips of a plate's cracks over a motion.

    At stations along the fronts of a solid's cracks there is K_III, too; front follows front.

    Attributes
    ----------
    time : (n,) [s]
        Instants in one period of a solution, or in the record of a motion in time.
    tips : tuple of str
        Names: "the crack tip", "the left crack tip", "the crack tip of crack 2", "the crack front
        at 3.2 mm", from where that front begins.
    positions : (n_tips,) [m]
        Distances along the crack; in a solid along the front, from its beginning.
    points, ahead : (n_tips, d) [m], (n_tips, d)
        Positions of the tips, and directions in which the cracks run straight on.
    one, two : (n, n_tips) [Pa m^1/2]
        K_I is positive if the crack faces part. K_II is positive if the face on the left, looking
        ahead, moves ahead. At a front without clearance K_I is never negative, and exactly zero
        while all contact patches next to the station are closed.
    three : (n, n_tips) [Pa m^1/2] or None
        K_III is positive if the upper face moves along the front, in the direction e_3 = e_1 x e_2
        with e_1 ahead and e_2 from the lower to the upper face. None for a plate.
    closed : (n_tips,) [Pa m^1/2]
        Error of K_I in a solid: largest |K_I| computed while the front is closed, where it is zero
        by contact, and largest negative K_I computed while the front is partly closed.
    """

    time: np.ndarray
    tips: tuple[str, ...]
    positions: np.ndarray
    points: np.ndarray
    ahead: np.ndarray
    one: np.ndarray
    two: np.ndarray
    three: np.ndarray | None
    closed: np.ndarray
    _run: Run[Any] = field(compare=False)
    _tip_histories: list[CrackTipHistory] = field(compare=False)

    @cached_property
    def numbers(self) -> Mapping[str, np.ndarray]:
        """Largest and smallest values and ranges of each tip: (n_tips,) [Pa m^1/2].

        K_max, K_min, delta_K, delta_K_effective, K_II_max, and in a solid K_III_max. The effective
        range is the range while the tip is open, max(K_I, 0) - max(min K_I, 0). A table
        ``[growth]`` adds delta_K_equivalent: the range from 0 that, once a period of the load, lets
        the crack grow as much as all rainflow cycles of K_I.
        """
        value_by_name_of_tips = [tip_history.value_by_name() for tip_history in self._tip_histories]
        return {
            name: np.array([value_by_name[name] for value_by_name in value_by_name_of_tips])
            for name in value_by_name_of_tips[0]
        }

    @property
    def largest(self) -> np.ndarray:
        """Largest K_I of each tip: (n_tips,) [Pa m^1/2]."""
        return self.numbers["K_max"]

    @property
    def smallest(self) -> np.ndarray:
        """Smallest K_I of each tip: (n_tips,) [Pa m^1/2]."""
        return self.numbers["K_min"]

    @property
    def effective(self) -> np.ndarray:
        """Range of K_I of each tip while it is open: (n_tips,) [Pa m^1/2]."""
        return self.numbers["delta_K_effective"]

    @property
    def leading(self) -> int:
        """Index of the tip with the largest effective range."""
        return leading_crack_tip_index(self._tip_histories)

    @property
    def comm(self) -> MPI.Comm:
        """Communicator."""
        return self._run.structure.comm

    @property
    def fronts(self) -> dict[str, list[int]]:
        """Indices of the tips or stations of each front, by the front's name."""
        return station_indices_by_front(self.tips)

    @property
    def turn(self) -> np.ndarray:
        """Angle to the left by which each crack turns at its largest K_I: (n_tips,) [rad].

        In this direction theta the hoop stress is largest: K_I sin(theta) + K_II (3 cos(theta) - 1)
        = 0 (Erdogan, Sih, Journal of Basic Engineering 85, 1963, 519); nan if K_I is never
        positive.
        """
        instant_index_of_largest = self.one.argmax(axis=0)[None]
        K_I = np.take_along_axis(self.one, instant_index_of_largest, axis=0)[0]
        K_II = np.take_along_axis(self.two, instant_index_of_largest, axis=0)[0]
        angles = -2.0 * np.arctan(2.0 * K_II / (K_I + np.sqrt(K_I**2 + 8.0 * K_II**2)))
        return np.where(K_I > 0.0, angles, np.nan)

    @cached_property
    def errors(self) -> Verification | None:
        """Stated errors of the leading tip's numbers; None for motions in time.

        They are computed when first requested (collective).
        """
        scene = self._run.scene.replace({"output.quantities": tuple(self.numbers)})
        return estimate_result_errors(
            replace(self._run, scene=scene, stated=None), self._run.result
        )

    def to_dict(self) -> dict[str, Any]:
        """Return time and the stress intensities of each tip, a row for every instant."""
        values_by_column = {"time": self.time.tolist()}
        values_by_name = {"K_I": self.one, "K_II": self.two} | (
            {} if self.three is None else {"K_III": self.three}
        )
        for tip_index, tip_name in enumerate(self.tips):
            values_by_column |= {
                f"{name}, {tip_name}": values[:, tip_index].tolist()
                for name, values in values_by_name.items()
            }
        return values_by_column

    def _unit_by_name(self) -> Mapping[str, str]:
        return {name: "s" if name == "time" else "Pa m^0.5" for name in self.to_dict()}

    def _repr_text(self) -> str:
        tip_index = self.leading
        number_texts = [
            f"{name} = {values[tip_index]:.4g}" for name, values in self.numbers.items()
        ]
        return f"{', '.join(number_texts)} Pa m^0.5 at {self.tips[tip_index]}"


def stress_intensity(run: Run[PeriodicSolution] | Run[TimeHistory]) -> StressIntensity:
    r"""Find stress intensities at the tips of a plate's cracks over a motion (collective).

    K_I and K_II follow at each instant from the displacement, by the interaction integral over a
    domain around the tip or front, with inertia inside and contact on the crack faces. A front has
    K_III, too. Each station has the mean over its neighbourhood; stations at the surface are
    extrapolated linearly from the two next to them (docs/solids.md). The error of K_I due to the
    mesh is of first order in the element size. The error at a closed front is stated (``closed``).
    In a reduced structure the static part of the modes is not summed but solved for. With the
    amplitudes q_r of the modes,

    .. math:: K = K_{\mathrm{static}}(f, \lambda) + \sum_r K_r (q_r - q_{r,\mathrm{static}}).

    Parameters
    ----------
    run : Run
        Result of :func:`fenics_crack.solve` or :func:`fenics_crack.integrate`, of a plate or a
        solid with a crack.

    Returns
    -------
    StressIntensity
        Stress intensities over a period of a solution (1024 instants or more), or over the record
        of a motion in time.

    Raises
    ------
    InputError
        The run is of another kind, of matrices or a disk; it has friction, a preload by its
        clearance, or no crack; or the elements at a crack tip or front are too long.

    Examples
    --------
    >>> found = fc.stress_intensity(fc.solve(scene))
    >>> found.largest, found.effective, found.turn
    """
    check_run_has_motion(run)
    refuse_for_reason(reason_without_stress_intensity(run.scene), "run", repr(run))
    tips, displacement_rows, force_rows = make_tips_and_intensity_rows(run)
    [record] = run.result.yield_records_of_row_products(displacement_rows)
    tip_histories = compute_crack_tip_histories(record, tips, force_rows, run.scene.growth)
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
