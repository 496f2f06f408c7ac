"""Time integration: its checked request, the loop over load periods, and the recorded history."""

from __future__ import annotations

import math
import time as clock
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields
from functools import cached_property
from inspect import signature
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import (
    N_RECORDED_PERIODS_OF_INTEGRATION,
    ConvergenceError,
    InputError,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.basics.progress import add_progress_text, begin_stage
from fenics_crack.basics.ranks import StopRequest, raise_first_error
from fenics_crack.basics.suggestions import check_options, keep_old_attribute_names
from fenics_crack.basics.tables import Tabular, format_count
from fenics_crack.model.contact import (
    ContactLaw,
    check_law,
    count_normal_rows_per_pair,
    count_rows_per_pair,
    friction_coefficient_of,
    friction_of,
    is_rigid,
    law_of_rows,
    merge_layers_of_pairs,
)
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.model.modes import STIFFNESS_SOLUTION_ROUNDING
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import MotionRecord, ObservedMotion
from fenics_crack.numerics.fourier import (
    differentiate,
    evaluate_series,
    fourier_basis_for,
    fourier_coefficients,
)
from fenics_crack.numerics.newton import root_sum_of_squares_with_limited_mean

ALLOWED_RECORD_BYTES = 2**31
"""Maximum size of a recorded history on one rank [bytes]: 2 GiB. Larger requests are refused."""

Initial: TypeAlias = PeriodicSolution | tuple[np.ndarray, ...] | None
"""Initial state of a time integration: a periodic solution, arrays or None for rest. The arrays are
displacement [m], velocity [m/s] and, with friction optional, tangential gaps [m] at which pairs
stick."""


@dataclass(frozen=True)
class MarchRequest:
    """Checked parameters of a time integration (collective).

    Attributes
    ----------
    structure : Structure
        Structure that vibrates, under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw
        Law of all pairs.
    periods : int
        Load periods to integrate.
    steps_per_period : int
        Instants in one load period.
    initial : PeriodicSolution, (displacement, velocity), (displacement, velocity, places) or None
        State at time 0: a solution's, arrays (n_local,) [m], [m/s], or None for rest. With friction
        ``places`` (n_pairs,) [m] are the tangential gaps at which pairs stick. Default: the
        tangential gaps at time 0 without contact forces.
    settle : float
        Stop early if the motion's relative change from one period to the next falls below this
        limit. 0: never. The change is the larger of two: in the gaps, and in the displacement at
        the load. Each is divided by the size of its oscillation.
        ``TimeHistory.distance_to_steady_motion`` estimates the remaining distance.
    record_periods : int, optional
        Number of last periods to keep. Default: all.
    dofs : sequence of int, optional
        Dofs whose displacements are recorded. Default: all. A reduced structure records all.
    progress : bool
        Show a progress bar.

    Raises
    ------
    InputError
        A parameter cannot be used, or the history would not fit in memory.
    """

    structure: Structure
    omega: float
    contact: ContactLaw
    periods: int
    steps_per_period: int
    initial: Initial = None
    settle: float = 0.0
    record_periods: int | None = None
    dofs: Sequence[int] | None = None
    progress: bool = False

    def __post_init__(self) -> None:
        check_omega(self.omega)
        check_law(self.structure, self.contact, allows_rigid=True)
        check_count("periods", self.periods, 1)
        check_count("steps_per_period", self.steps_per_period, 1)
        if self.record_periods is not None:
            check_count("record_periods", self.record_periods, 1)
        check_number("settle", self.settle, 0.0)
        max_dofs_per_rank = max(self.structure.comm.allgather(len(self.recorded_dofs)))
        n_instants = self.n_kept_periods * self.steps_per_period
        if 8 * n_instants * (max_dofs_per_rank + 2 * self.n_gap_rows) > ALLOWED_RECORD_BYTES:
            contents_text = f"{n_instants} instants of {max_dofs_per_rank} dofs"
            limit_text = f"{ALLOWED_RECORD_BYTES // 2**30} GiB"
            allowed = f"smaller, or record fewer dofs: {contents_text} do not fit in {limit_text}"
            raise InputError("record_periods", self.n_kept_periods, allowed)
        _ = self.start_state

    @classmethod
    def from_call(
        cls, function: Callable[..., Any], options: Mapping[str, Any], *arguments: Any
    ) -> MarchRequest:
        """Return the checked parameters in a call to a public integration function.

        ``arguments`` are the values for this class's first fields, in order. ``options`` are the
        further keywords given to ``function``. An unknown keyword is an InputError with the allowed
        names.
        """
        signature_parameters = signature(function).parameters.values()
        option_names = [
            signature_parameter.name
            for signature_parameter in signature_parameters
            if signature_parameter.kind is signature_parameter.KEYWORD_ONLY
        ]
        option_names += [field.name for field in fields(cls) if field.default is not MISSING]
        check_options(function.__name__, options, option_names)
        return cls(*arguments, **options)

    @property
    def n_kept_periods(self) -> int:
        """Number of last load periods to record: ``record_periods``, at most ``periods``."""
        return min(self.record_periods or self.periods, self.periods)

    @property
    def step_size(self) -> float:
        """Step size dt between two instants [s]."""
        return 2.0 * np.pi / self.omega / self.steps_per_period

    @cached_property
    def start_state(self) -> tuple[np.ndarray, ...]:
        """Displacement [m] and velocity [m/s] at time 0, (n_local,) each.

        With friction a third array (n_pairs,) [m] may follow: the tangential gaps at which pairs
        stick. Without the third array, pairs stick at the initial tangential gaps.
        """
        return make_initial_state_parts(self.structure, self.contact, self.initial)

    @cached_property
    def recorded_dofs(self) -> np.ndarray:
        """Global numbers of the dofs recorded by this rank: (n_recorded,) int.

        Coordinates of a reduced structure are all recorded.
        """
        first_dof = self.structure.first_dof
        end_dof = first_dof + self.structure.n_local
        dofs_of_this_rank, whole_structure = np.arange(first_dof, end_dof), self.structure.whole
        if self.dofs is None:
            return dofs_of_this_rank
        requested_dofs = whole_structure.as_dof_numbers(self.dofs)
        if whole_structure is not self.structure:
            return dofs_of_this_rank
        return requested_dofs[(requested_dofs >= first_dof) & (requested_dofs < end_dof)]

    @cached_property
    def loaded_dofs(self) -> np.ndarray:
        """Local indices of this rank's dofs with a load: (n_loaded,)."""
        return np.flatnonzero(np.any(self.structure.force, axis=0))

    @cached_property
    def load_basis(self) -> np.ndarray:
        """Fourier basis 1, cos(j phi), sin(j phi) of the load's K harmonics: (N, 2K+1).

        phi is the load's phase at the N = ``steps_per_period`` instants of a period.
        """
        period_fractions = np.arange(self.steps_per_period) / self.steps_per_period
        return fourier_basis_for(self.structure.force, 2.0 * np.pi * period_fractions)

    @cached_property
    def load_samples(self) -> np.ndarray:
        """Load on the loaded dofs at the N = ``steps_per_period`` instants: (N, n_loaded) [N]."""
        return np.asarray(self.load_basis @ self.structure.force[:, self.loaded_dofs])

    @property
    def n_gap_rows(self) -> int:
        """Number of scalar gaps, equal to the number of scalar contact forces.

        A pair has a normal gap, with friction also a tangential gap. Under the layered law a pair
        has two normal gaps: to the layer, and to the contact below the layer.
        """
        return self.structure.n_pairs * count_rows_per_pair(self.contact)

    @cached_property
    def row_law(self) -> ContactLaw:
        """Contact law for all gaps, with an entry for each of the ``n_gap_rows`` gaps.

        Under the layered law each pair has two gaps. The result is then a penalty law with a
        stiffness for each of the two. Otherwise the result is ``contact``.
        """
        return law_of_rows(self.contact, self.structure.n_pairs)

    @property
    def is_rigid(self) -> bool:
        """True if the contact law is rigid (UnilateralConstraint), False for a penalty law."""
        return is_rigid(self.contact)


@keep_old_attribute_names(distance="distance_to_steady_motion")
@dataclass(frozen=True, repr=False)
class TimeHistory(ObservedMotion, Tabular):
    """Result of a direct time integration: the last load periods of the motion.

    Attributes
    ----------
    time : (n,) [s]
        Equally spaced; the load's phase is omega * time.
    gap : (n, n_pairs) [m]
        Normal gap of each pair; positive if the crack faces penetrate.
    settled : float
        Relative change from the last period but one to the last: the larger of the changes in the
        gaps and in the displacement at the load. A small number means: the motion repeats with the
        load. Each change is divided by the root sum of squares over the period. In this divisor the
        mean over time is limited to the oscillation. Infinite after a single period.
    created_energy : float
        Net energy created by the scheme, relative to the energy from the load and the initial
        state. Negative: lost energy. Central differences create energy if contact changes between
        steps; the error vanishes like dt^2. For exponential steps it is the remainder of the energy
        balance. Under UnilateralConstraint impacts lose energy at any step size.
    periods : int
        Load periods integrated. They are fewer than requested if the motion settled, or if Ctrl-C
        stopped it.
    seconds : float
        Wall-clock time of the integration [s].
    steps_per_period : int
        Instants in one load period.
    """

    time: np.ndarray
    gap: np.ndarray
    settled: float
    created_energy: float
    periods: int
    seconds: float
    steps_per_period: int
    structure: Structure
    recorded: np.ndarray
    """Displacements of this rank's ``recorded_dofs``: (n, n_recorded) [m]."""
    recorded_dofs: np.ndarray
    final_state: tuple[np.ndarray, ...]
    """Displacement [m] and velocity [m/s] (n_local,) at the end of the last period. With friction
    the tangential gaps (n_pairs,) [m] at which pairs stick follow; under the layered law (2
    n_pairs,), for the layers and then for the contact below them. Given as ``initial``, the tuple
    continues the motion, at this frequency or another."""
    contact_force: np.ndarray
    """Contact force of each pair: (n, n_pairs) [N]. Central differences under UnilateralConstraint
    give the mean force from an instant to the next."""
    tangential_gap: np.ndarray | None = None
    """Tangential gap of each pair: (n, n_pairs) [m]; None without friction."""
    tangential_force: np.ndarray | None = None
    """Friction force of each pair: (n, n_pairs) [N]; None without friction."""
    friction: float | np.ndarray | None = None
    """Friction coefficient, a number for all pairs or (n_pairs,); None without friction."""

    KIND: ClassVar[str] = "time history"

    def to_dict(self) -> dict[str, Any]:
        """Return the history as table columns with a row for each instant.

        Columns: time [s], displacement of the watched dof [m], largest opening of the crack faces
        [m] and largest contact force of a pair [N]. Without pairs the last two are missing.
        """
        columns_by_name = {"time": self.time, "displacement": self.displacement()[:, 0]}
        if self.gap.size:
            columns_by_name["opening"] = np.maximum(0.0, -self.gap.min(axis=1))
            columns_by_name["contact_force"] = self.contact_force.max(axis=1)
        return {name: column.tolist() for name, column in columns_by_name.items()}

    def _repr_text(self) -> str:
        periods_text = format_count(self.periods, "period")
        steps_text = format_count(self.steps_per_period, "step")
        settled_text = f", settled to {self.settled:.0e}" if np.isfinite(self.settled) else ""
        return (
            f"{periods_text} of {steps_text}{settled_text}, "
            f"{format_count(self.structure.n_pairs, 'pair')}"
        )

    def by_period(self, values: np.ndarray) -> np.ndarray:
        """Split samples (n, ...) into load periods: (n_periods, steps_per_period, ...).

        n must be a multiple of ``steps_per_period``. The mean over the first axis is the average at
        each phase of the load.
        """
        n_periods = len(values) // self.steps_per_period
        return values.reshape(n_periods, self.steps_per_period, *values.shape[1:])

    @property
    def distance_to_steady_motion(self) -> float:
        """Estimate how far the last period is from the steady motion (collective).

        Distances in the gaps and, if recorded, in the watched displacement are divided by the size
        of the oscillation. The larger distance is returned; nan if fewer than three periods are
        kept.

        The steady motion is extrapolated from the last four periods (minimal polynomial
        extrapolation; Sidi, Vector Extrapolation Methods, chapter 2). The estimate is exact if the
        rest of the transient is two decaying Floquet modes.
        """
        last_periods_of_watched_arrays = [
            watched_array[-N_RECORDED_PERIODS_OF_INTEGRATION:]
            for watched_array in self._watched_arrays_by_period
        ]
        n_periods = len(last_periods_of_watched_arrays[0])
        if n_periods < 3:
            return math.nan
        moving_part_sizes = _moving_part_sizes(
            [watched_array[-1] for watched_array in last_periods_of_watched_arrays]
        )
        scaled_arrays = [
            watched_array.reshape(n_periods, -1) / moving_part_size
            for watched_array, moving_part_size in zip(
                last_periods_of_watched_arrays, moving_part_sizes, strict=True
            )
        ]
        scaled_changes = np.diff(np.hstack(scaled_arrays), axis=0)
        extrapolation_weights = np.append(
            np.linalg.lstsq(scaled_changes[:-1].T, -scaled_changes[-1], rcond=None)[0], 1.0
        )
        weighted_period_differences = [
            np.tensordot(extrapolation_weights, scaled_array[:-1] - scaled_array[-1], 1)
            for scaled_array in scaled_arrays
        ]
        largest_difference_norm = max(
            float(np.linalg.norm(weighted_period_difference))
            for weighted_period_difference in weighted_period_differences
        )
        weight_sum = abs(float(extrapolation_weights.sum()))
        return largest_difference_norm / weight_sum if weight_sum > 0.0 else math.inf

    def change(self, periods: int = 1) -> float:
        """Return the relative change between the last load period and an earlier one (collective).

        The earlier one is ``periods`` load periods before. Changes in the gaps and, if recorded, in
        the watched displacement are relative to the oscillation; the larger change is returned.

        Raises
        ------
        InputError
            ``periods`` is not smaller than the number of recorded periods.
        """
        check_count("periods", periods, 1)
        watched_period_arrays = self._watched_arrays_by_period
        if periods >= len(watched_period_arrays[0]):
            raise InputError(
                "periods",
                periods,
                f"less than the {len(watched_period_arrays[0])} recorded periods; record more by "
                "record_periods",
            )
        newest_arrays = [watched_array[-1] for watched_array in watched_period_arrays]
        return _largest_relative_change(
            newest_arrays, [watched_array[-1 - periods] for watched_array in watched_period_arrays]
        )

    @property
    def _watched_arrays_by_period(self) -> list[np.ndarray]:
        """Return the watched motion by load periods: gaps, and displacement (collective).

        Used to compare periods. The clearance is added to the gaps, so gaps are 0 without
        displacement. The watched displacement is left out if it was not recorded. Each array is
        (n_periods, steps_per_period, n_columns) [m].
        """
        watched_arrays = [self.gap + self.structure.clearance]
        with suppress(InputError):
            watched_arrays.append(self.displacement())
        return [self.by_period(watched_array) for watched_array in watched_arrays]

    def displacement(self, dofs: Sequence[int | None] = (None,)) -> np.ndarray:
        """Return recorded displacements at all instants: (n, len(dofs)) [m] (collective).

        ``dofs`` are global dof numbers; None stands for the watched dof.

        Raises
        ------
        InputError
            A dof was not recorded.
        """
        if self.structure.whole is not self.structure:
            return self.structure.values_at(self.recorded, dofs)
        dof_numbers = self.structure.as_dof_numbers(dofs)
        selection_matrix = (self.recorded_dofs[:, None] == dof_numbers).astype(float)
        recording_rank_counts = self.structure.sum_over_ranks(
            selection_matrix.sum(axis=0)
        )  # a dof may be recorded twice
        if not recording_rank_counts.all():
            raise InputError(
                "dofs",
                dof_numbers[recording_rank_counts == 0.0].tolist(),
                "among the recorded dofs; name them in dofs when integrating",
            )
        return self.structure.sum_over_ranks(
            self.recorded @ (selection_matrix / recording_rank_counts)
        )

    def yield_motion_records(self, rows: np.ndarray) -> Iterator[MotionRecord]:
        """Yield a single :class:`MotionRecord`: displacements, gaps and forces (collective).

        An observed displacement is a row in ``rows`` (m, n_local) times the displacement
        (n_local,). The record covers all kept load periods. Fourier coefficients are for the last
        period, up to harmonic 10, or (steps_per_period - 1) // 2 if less.

        Raises
        ------
        InputError
            The rows need a dof that was not recorded.
        """
        structure = self.structure
        recorded_local_dofs, column_of_each_recorded_dof = np.unique(
            self.recorded_dofs - structure.first_dof, return_index=True
        )
        if any(
            structure.comm.allgather(bool(np.any(np.delete(rows, recorded_local_dofs, axis=1))))
        ):
            allowed_text = "None, to record all displacements; integrate again"
            raise InputError("dofs", "some", allowed_text)
        row_products = structure.sum_over_ranks(
            self.recorded[:, column_of_each_recorded_dof] @ rows[:, recorded_local_dofs].T
        )
        steps_per_period, row_gaps, row_forces = (
            self.steps_per_period,
            self.gap,
            self.contact_force,
        )
        if self.tangential_gap is not None and self.tangential_force is not None:
            row_gaps = np.hstack([row_gaps, self.tangential_gap])
            row_forces = np.hstack([row_forces, self.tangential_force])
        yield MotionRecord(
            2.0 * np.pi * (len(self.time) - 1) / steps_per_period / np.ptp(self.time), 1, self.time,
            fourier_coefficients(
                row_products[-steps_per_period:], min(10, (steps_per_period - 1) // 2)
            ),
            row_products, row_gaps, row_forces,
            structure=structure,
            friction_coefficient=self.friction,
            instants_per_load_period=steps_per_period,
        )  # fmt: skip


class PeriodWindow(NamedTuple):
    """Arrays for a single load period, filled by :meth:`Scheme.integrate_and_fill_period`.

    Rows are the N instants. ``gap`` [m] and contact ``force`` [N] are (N, n_rows), with a column
    for each contact force: normal forces, with friction then tangential forces. Under the layered
    law each pair has two normal forces
    (:func:`fenics_crack.model.contact.add_pair_for_each_contact_force`).
    """

    gap: np.ndarray
    force: np.ndarray
    recorded_displacement: np.ndarray
    """Displacement of the recorded dofs: (N, n_recorded) [m]."""
    displacement_at_load: np.ndarray
    """Displacement of the loaded dofs: (N, n_loaded) [m]; modal coordinates are times the load."""


class Scheme(ABC):
    """Interface of a time integration method, called by :func:`march` period by period."""

    name: ClassVar[str]
    """Name in the progress bar and in messages."""
    remedy: ClassVar[str]
    """Advice to the user if contact creates energy, for the error message."""
    created_energy_ratio = 0.0
    """Energy created by the scheme, relative to the energy from load and initial state."""
    petsc_objects: tuple[Any, ...] = ()
    """PETSc objects that are freed after the integration."""

    @abstractmethod
    def integrate_and_fill_period(self, window: PeriodWindow, period_number: int) -> None:
        """Integrate the next load period, fill the window, and update the energy balance.

        ``period_number`` counts from 0. Each call continues from the state at the last call's end.
        """

    @abstractmethod
    def final_state_parts(self) -> tuple[np.ndarray, ...]:
        """Return the displacement [m] and velocity [m/s] at the end, (n_local,) each.

        With friction a third array follows: the tangential gaps (n_pairs,) [m] at which pairs
        stick.
        """

    def set_created_energy_ratio(self, created_energy: float, energy_input: float) -> None:
        """Set ``created_energy_ratio`` to ``created_energy`` divided by ``energy_input``.

        Unless ``energy_input`` is positive, the ratio is not changed. Both energies [J] are summed
        since time 0. ``created_energy`` comes from errors of the scheme, and ``energy_input`` from
        the load and the initial state. ConvergenceError if ``created_energy`` is not finite, or
        exceeds twice a positive ``energy_input``.
        """
        if energy_input > 0.0:
            self.created_energy_ratio = created_energy / energy_input
        if not np.isfinite(created_energy) or created_energy > 2.0 * energy_input > 0.0:
            amount_text = f"{self.created_energy_ratio:.3g} times the energy that the load puts in"
            too_long_steps_text = (
                f"{self.name}: the steps are too long for this contact, which creates"
            )
            raise ConvergenceError(f"{too_long_steps_text} {amount_text}; {self.remedy}")


def march(request: MarchRequest, scheme: Scheme) -> TimeHistory:
    """Integrate load periods by a scheme and return the history (collective).

    The loop ends after the requested periods, if the relative change is below ``settle``, or at
    Ctrl-C. The scheme's PETSc objects are freed.
    """
    structure, n_kept_periods = request.structure, request.n_kept_periods
    steps_per_period = request.steps_per_period
    column_counts = request.n_gap_rows, request.n_gap_rows, len(request.recorded_dofs)
    kept_history_arrays: list[np.ndarray] = [
        np.empty((n_kept_periods * steps_per_period, n_columns)) for n_columns in column_counts
    ]
    gap, contact_force, recorded_displacement_history = kept_history_arrays
    displacement_at_load = np.empty((steps_per_period, len(request.loaded_dofs)))
    n_integrated_periods, relative_change = 0, np.inf
    previous_period_arrays: tuple[np.ndarray, np.ndarray] | None = None
    is_hidden = not request.progress or structure.comm.rank != 0
    if not is_hidden:
        begin_stage("")
    from tqdm import tqdm

    start_seconds = clock.perf_counter()
    with (
        StopRequest() as stop_request,
        add_progress_text(lambda: f"{n_integrated_periods} of {request.periods} periods"),
    ):
        for period_index in tqdm(
            range(request.periods), scheme.name, unit="period", disable=is_hidden
        ):
            period_rows = slice(
                period_index % n_kept_periods * steps_per_period,
                (period_index % n_kept_periods + 1) * steps_per_period,
            )
            period_window = PeriodWindow(
                gap[period_rows],
                contact_force[period_rows],
                recorded_displacement_history[period_rows],
                displacement_at_load,
            )
            scheme.integrate_and_fill_period(period_window, period_index)
            n_integrated_periods = period_index + 1
            gathered_displacement_at_load = np.concatenate(
                structure.comm.allgather(displacement_at_load), axis=1
            )
            gap_motion = period_window.gap[:, : structure.n_pairs] + structure.clearance
            # Slow modes hardly move the gaps.
            newest_period_arrays = gap_motion, gathered_displacement_at_load
            if previous_period_arrays is not None:
                relative_change = _largest_relative_change(
                    newest_period_arrays, previous_period_arrays
                )
            previous_period_arrays = newest_period_arrays
            if relative_change < request.settle or stop_request.is_requested(structure.comm):
                break
    elapsed_seconds = clock.perf_counter() - start_seconds
    n_kept_rows = min(n_integrated_periods, n_kept_periods) * steps_per_period
    oldest_row = (
        n_integrated_periods % n_kept_periods * steps_per_period
        if n_integrated_periods > n_kept_periods
        else 0
    )
    gap, contact_force, recorded_displacement_history = (
        np.roll(kept_history_array[:n_kept_rows], -oldest_row, axis=0)
        for kept_history_array in kept_history_arrays
    )
    gap, contact_force = merge_layers_of_pairs(
        request.contact, structure.n_pairs, gap, contact_force
    )
    final_state = scheme.final_state_parts()
    for petsc_object in scheme.petsc_objects:
        petsc_object.destroy()
    n_pairs, friction_coefficient = structure.n_pairs, friction_coefficient_of(request.contact)
    return TimeHistory(
        time=np.arange(
            n_integrated_periods * steps_per_period - n_kept_rows,
            n_integrated_periods * steps_per_period,
        )
        * request.step_size,
        gap=gap[:, :n_pairs],
        settled=relative_change,
        created_energy=scheme.created_energy_ratio,
        periods=n_integrated_periods,
        seconds=elapsed_seconds,
        steps_per_period=steps_per_period,
        structure=structure,
        recorded=recorded_displacement_history,
        recorded_dofs=request.recorded_dofs,
        final_state=final_state,
        contact_force=contact_force[:, :n_pairs],
        tangential_gap=None if friction_coefficient is None else gap[:, n_pairs:],
        tangential_force=None if friction_coefficient is None else contact_force[:, n_pairs:],
        friction=friction_coefficient,
    )


def _largest_relative_change(newest: Sequence[np.ndarray], previous: Sequence[np.ndarray]) -> float:
    """Return the largest relative change of several arrays between two periods.

    ``newest`` and ``previous`` hold the same quantities as samples (N, m), in the last period and
    in a period before. For each array, the norm of the difference is divided by the array's size in
    ``newest`` (:func:`_moving_part_sizes`).
    """
    compared_parts_and_sizes = zip(newest, previous, _moving_part_sizes(newest), strict=True)
    return max(
        float(np.linalg.norm(newest_part - previous_part)) / size
        for newest_part, previous_part, size in compared_parts_and_sizes
    )


def _moving_part_sizes(period_arrays: Sequence[np.ndarray]) -> list[float]:
    """Return the size of each array (N, m) of samples over a period.

    Used to make changes from period to period relative. The size is the root sum of squares. In
    this sum the mean over time is limited to the oscillation: a steady load must not hide changes.
    An array with a size below 1e-12 times the largest size gets inf: the changes do not count. An
    example: gaps between rigid crack faces in permanent contact.
    """
    motion_sizes = [
        root_sum_of_squares_with_limited_mean(period_array) for period_array in period_arrays
    ]
    return [
        size if size > STIFFNESS_SOLUTION_ROUNDING * max(motion_sizes) else math.inf
        for size in motion_sizes
    ]


def make_initial_state_parts(
    structure: Structure, contact: ContactLaw, initial: Initial
) -> tuple[np.ndarray, ...]:
    """Return displacement [m] and velocity [m/s] at time 0, (n_local,) each (collective).

    With friction a third array (n_pairs,) [m] may follow: the tangential gaps at which pairs stick.
    Under the layered law it has (2 n_pairs,) entries. ``initial`` is a harmonic-balance solution, a
    Run with a solution, a tuple of the arrays in this order, or None for rest. The third array
    follows if ``initial`` has sticking places.

    Raises
    ------
    InputError
        The arrays do not fit the structure, or a number is not finite.
    """
    if initial is None:
        return np.zeros(structure.n_local), np.zeros(structure.n_local)
    initial = getattr(initial, "result", initial)  # of a Run
    has_friction = friction_of(contact) is not None
    state_parts: tuple[np.ndarray, ...]
    if isinstance(initial, PeriodicSolution):
        displacement_coefficients, omega = initial.displacement_coefficients, initial.base_omega
        state_coefficients = (
            displacement_coefficients,
            differentiate(displacement_coefficients, omega),
        )
        state_parts = tuple(
            evaluate_series(state_part_coefficients, omega, np.zeros(1))[0]
            for state_part_coefficients in state_coefficients
        )
        if has_friction and friction_of(initial.contact) is not None:
            state_parts = *state_parts, initial.slider_positions(np.zeros(1))[0]
    else:
        try:
            state_parts = tuple(floats_or_single_nan(state_part) for state_part in initial)
        except TypeError:
            state_parts = ()
    n_sliders = structure.n_pairs * count_normal_rows_per_pair(contact)
    expected_shapes = (structure.n_local,), (structure.n_local,), (n_sliders,)
    shape_match_flags = [
        state_part.shape == expected_shape
        for state_part, expected_shape in zip(state_parts, expected_shapes, strict=False)
    ]
    has_right_shapes = all(shape_match_flags) and len(state_parts) in (
        (2, 3) if has_friction else (2,)
    )
    allowed_text = (
        "a solution of this structure, or finite arrays (displacement, velocity) of shape "
        f"{expected_shapes[0]}; with friction, sticking places {expected_shapes[2]} may follow"
    )
    input_error = InputError(
        "initial", [state_part.shape for state_part in state_parts], allowed_text
    )
    has_only_finite_values = all(np.all(np.isfinite(state_part)) for state_part in state_parts)
    raise_first_error(
        structure.comm, None if has_right_shapes and has_only_finite_values else input_error
    )
    return state_parts
