"""Observed motions: each kind yields a :class:`MotionRecord` for all numbers.

Motions are harmonic-balance solutions, exact orbits, time histories, and curves. Each has one
method, ``yield_motion_records``. It multiplies the displacement by given rows, and adds
the gaps and contact forces at the crack faces, over a period. A curve has a record for each point.

Crack indicators change with the crack. A watched displacement is

    u(t) = a0 + sum_k a_k cos(k w t / m) + b_k sin(k w t / m)

with the load frequency w and m load periods in the period. The amplitude at j times the load
frequency is

    U_j = sqrt(a_k^2 + b_k^2),      k = j m.

A linear structure has U_1 alone. Crack faces that open and close once in a period act as a
stiffness that depends on the sign of the gap. They cause even harmonics and a mean (U_2 / U_1 and
a0 / U_1), and U_1/2 at a period doubling. Without clearance these ratios do not depend on the
load's size (review: Dimarogonas, Engineering Fracture Mechanics 55, 1996, 831).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.errors import N_RECORDED_PERIODS_OF_INTEGRATION
from fenics_crack.basics.observables import (
    IN_FILES_ONLY,
    REQUIRES_FRICTION,
    Observables,
    Place,
    observable_names,
    read_observables,
)
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import Tabular, hertz_property
from fenics_crack.model.modes import STIFFNESS_SOLUTION_ROUNDING
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.extremes import RecordFunction, find_maximum_values

SLIP_FORCE_RATIO = 1.0 - 1e-6
"""Minimum friction force of a slipping pair, over the limit mu times the normal force. The ratio is
below 1, as orbits are accurate to 1e-6."""


@dataclass(frozen=True, repr=False)
class Indicators(Observables, Tabular):
    """Indicators of a breathing crack, at a point and crack faces.

    The method ``indicators`` of a solution, an orbit or a time history returns them as numbers. For
    a curve each attribute is an array (n,) over the points.

    Attributes
    ----------
    omega : [rad/s]
        Frequency of the load.
    amplitude : [m]
        Half the peak-to-peak displacement, of all harmonics together.
    mean : [m]
        a0, including the displacement by a mean load.
    harmonic_1, harmonic_2, harmonic_3 : [m]
        U_1, U_2, U_3: amplitudes at once, twice and three times the load's frequency.
    ratio_2_1, ratio_3_1 : [-]
        U_2 / U_1 and U_3 / U_1; nan if the solution has fewer harmonics, or no U_1.
    ratio_half_1 : [-]
        U_1/2 / U_1, at half the load's frequency; nan unless the solution has an even multiple of
        the load's period.
    ratio_largest, largest_order : [-]
        U_k / U_1 and order k of the largest harmonic above the load's; nan without such a harmonic.
        The order is also nan if all higher harmonics are rounding errors.
    mean_shift : [-]
        a0 / U_1, positive in the direction of the dof.
    opening, penetration : [m]
        Maximum over all pairs and times; nan without pairs.
    contact_force : [N]
        Maximum over all pairs and times; nan without pairs. A finer mesh has smaller forces.
    crack_force : [N]
        Maximum over time of the sum over a crack's pairs, independent of the mesh; nan without
        pairs. For given matrices the sum is over all pairs.
    closed_share : [-]
        Fraction of the period in which a pair carries a contact force, mean over the pairs; nan
        without pairs.
    friction_loss : [J]
        Work of friction in a period of the response, sum over all pairs; nan without friction.
    stick_share, slip_share : [-]
        Fraction of the period in which a closed pair sticks or slips, mean over all pairs; nan
        without friction.
    near_share, far_share, rub_share : [-]
        Shares of the load's work in a period that near modes, far modes and friction lose
        (:mod:`fenics_crack.motion.energy`); nan without pairs, for motions in time, and for large
        structures that are not reduced.
    """

    frequency = hertz_property()

    def to_dict(self) -> dict[str, Any]:
        """Return the indicators by name: numbers, or columns along a curve.

        Friction indicators that are nan everywhere are left out.
        """
        columns_by_name = {
            indicator_field.name: np.asarray(getattr(self, indicator_field.name))
            for indicator_field in fields(self)
        }
        return {
            name: column_values.tolist()
            for name, column_values in columns_by_name.items()
            if name not in observable_names(required_flags=REQUIRES_FRICTION)
            or not np.all(np.isnan(column_values))
        }

    def _repr_text(self) -> str:
        if np.ndim(self.omega):
            return f"{len(self.omega)} points"
        return f"amplitude = {self.amplitude:.4g} m, ratio_2_1 = {self.ratio_2_1:.3g}"


# --- observed quantities --------------------------------------------------------------------------


@dataclass(frozen=True)
class MotionRecord:
    """A motion over its period, or over several load periods, at n instants.

    A record has m observed displacements, and the crack faces' gaps and contact forces. Each
    observed displacement is the product of a row of factors with all dofs.

    Attributes
    ----------
    omega : float
        Frequency of the load [rad/s].
    subharmonic : int
        Number of load periods in the motion's period.
    time : (n,) [s]
        Equally spaced instants.
    coefficients : (2H+1, m)
        Observed displacements' Fourier coefficients a0, a1, b1, ... over the (last) period.
    row_products : (n, m)
        Observed displacements at the n instants. For a row that selects a dof: the dof's
        displacement [m].
    gaps, forces : (n, n_rows) [m], [N]
        Gaps and contact forces of all pairs; with friction tangential rows follow the normal rows.
    structure : Structure
        Structure that vibrates; on a curve, with the parameter of the point.
    friction_coefficient : float or (n_pairs,), optional
        mu; None without friction.
    evaluate_at_period_fractions : callable, optional
        Function from positions in the period, 0 to 1, to products, gaps and forces. Extremes are
        then exact to rounding. None: extremes are the largest values at the instants.
    instants_per_load_period : int
        Instants in a load period, for a record of several periods; 0 for a periodic motion.
    exact_number_by_name : dict of str to float
        Crack face numbers by names in :class:`Indicators`, more accurate than from the instants.
    """

    omega: float
    subharmonic: int
    time: np.ndarray
    coefficients: np.ndarray
    row_products: np.ndarray
    gaps: np.ndarray
    forces: np.ndarray
    structure: Structure
    friction_coefficient: float | np.ndarray | None = None
    evaluate_at_period_fractions: RecordFunction | None = None
    instants_per_load_period: int = 0
    exact_number_by_name: Mapping[str, float] = field(default_factory=dict)

    @property
    def periods(self) -> float:
        """Return the number of load periods in the record.

        A periodic motion is recorded over its own period, with ``subharmonic`` load periods.
        """
        return (
            (len(self.time) - 1) / self.instants_per_load_period
            if self.instants_per_load_period
            else self.subharmonic
        )

    @property
    def n_pairs(self) -> int:
        """Return the number of contact pairs in the record.

        The number is 0 if ``gaps`` has no columns. Gaps are left out if the crack faces' indicators
        are known from an earlier record of the same motion.
        """
        return self.gaps.shape[1] // (1 if self.friction_coefficient is None else 2)

    def last_periods(self, periods: int) -> MotionRecord:
        """Return a copy of this record with only the last ``periods`` load periods.

        If the record is for a periodic motion, return the record itself.
        """
        if not self.instants_per_load_period:
            return self
        last_instants_slice = slice(-periods * self.instants_per_load_period, None)
        array_names = "time", "row_products", "gaps", "forces"
        return replace(
            self,
            **{
                array_name: getattr(self, array_name)[last_instants_slice]
                for array_name in array_names
            },
        )

    def select_rows(self, rows: slice) -> MotionRecord:
        """Return a copy of this record with some of the m observed displacements.

        ``rows`` selects the displacements by index. Gaps and contact forces stay.
        """
        evaluate_all = self.evaluate_at_period_fractions
        evaluate = evaluate_all and (
            lambda period_fractions: (
                (products_gaps_and_forces := evaluate_all(period_fractions))[0][:, rows],
                *products_gaps_and_forces[1:],
            )
        )
        return replace(
            self,
            coefficients=self.coefficients[:, rows],
            row_products=self.row_products[:, rows],
            evaluate_at_period_fractions=evaluate,
        )

    @cached_property
    def is_pair_in_crack(self) -> np.ndarray:
        """Return True for the pairs of each crack: (n_pairs, n_cracks) bool.

        Without a mesh, all pairs belong to a single crack.
        """
        crack_number_of_pair_or_none = self.structure.pairs.cracks
        crack_of_pair = (
            np.zeros(self.n_pairs, dtype=int)
            if crack_number_of_pair_or_none is None
            else crack_number_of_pair_or_none
        )
        return crack_of_pair[:, None] == np.unique(crack_of_pair)

    @cached_property
    def row_and_face_maxima(self) -> np.ndarray:
        """Return the maxima over time in the record: (2 m,) or (2 m + 4,).

        First the maxima of the m observed displacements, then of their negatives. With contact
        pairs four maxima follow: opening, penetration [m], contact force of a pair and of a crack
        [N].
        """
        n_pairs = self.n_pairs
        evaluate = self.evaluate_at_period_fractions
        is_pair_in_crack = self.is_pair_in_crack

        def stack_columns(
            row_products: np.ndarray, gaps: np.ndarray, forces: np.ndarray
        ) -> np.ndarray:
            """Return the functions of time whose maxima are searched, as columns.

            There are 2 m columns, or 2 m + 4 with contact pairs, in the order of
            :meth:`row_and_face_maxima`. ``row_products`` (k, m), ``gaps`` and ``forces`` (k,
            n_rows) are values at k instants.
            """
            stacked_columns = [row_products, -row_products]
            if n_pairs:
                gaps, forces = gaps[:, :n_pairs], forces[:, :n_pairs]
                stacked_columns += [
                    -gaps.min(1),
                    gaps.max(1),
                    forces.max(1),
                    (forces @ is_pair_in_crack).max(1),
                ]
            return np.column_stack(stacked_columns)

        sampled_columns = stack_columns(self.row_products, self.gaps, self.forces)
        return find_maximum_values(
            sampled_columns,
            evaluate and (lambda period_fractions: stack_columns(*evaluate(period_fractions))),
        )


class DisplacementHarmonics:
    """Harmonics of an observed displacement.

    U_j is the amplitude at j times the load's frequency.

    Parameters
    ----------
    coefficients : (2H+1,) [m]
        Fourier coefficients a0, a1, b1, ... over the motion's period.
    subharmonic : int
        Number of load periods in the motion's period.

    Attributes
    ----------
    mean, amplitude_at_load_frequency : float [m]
        a0, and U_1 (nan if 0).
    largest_order, ratio_largest : float
        Order k of the largest harmonic above the load's, and U_k / U_1. Both are nan without such a
        harmonic; the order also if U_k is below 1e-12 of the largest coefficient.
    """

    def __init__(self, coefficients: np.ndarray, subharmonic: int) -> None:
        self.coefficients, self._subharmonic = coefficients, subharmonic
        self._amplitude_by_order = np.hypot(coefficients[1::2], coefficients[2::2])
        amplitude_at_load_frequency = self.amplitude_at_load_multiple(1)
        self.mean = float(coefficients[0])
        self.amplitude_at_load_frequency = (
            amplitude_at_load_frequency if amplitude_at_load_frequency > 0.0 else math.nan
        )
        self.largest_order = self.ratio_largest = math.nan
        higher_amplitudes = self._amplitude_by_order[2 * subharmonic - 1 :: subharmonic]
        if len(higher_amplitudes):
            largest_index = int(higher_amplitudes.argmax())
            self.ratio_largest = (
                float(higher_amplitudes[largest_index]) / self.amplitude_at_load_frequency
            )
            if (
                higher_amplitudes[largest_index]
                > STIFFNESS_SOLUTION_ROUNDING * np.abs(coefficients).max()
            ):
                self.largest_order = 2.0 + largest_index

    def amplitude_at_load_multiple(self, multiple: float) -> float:
        """Return the amplitude U_j [m] at j = ``multiple`` times the load's frequency.

        nan if the motion has no such harmonic, or too few harmonics.
        """
        order = multiple * self._subharmonic
        has_harmonic = order == int(order) and order <= len(self._amplitude_by_order)
        return float(self._amplitude_by_order[int(order) - 1]) if has_harmonic else math.nan

    def ratio(self, multiple: float) -> float:
        """Return the ratio U_j / U_1, with j = ``multiple``.

        U_1 is the amplitude at the load's frequency, U_j at j times this frequency. The result is
        nan if the motion lacks U_j or U_1.
        """
        return self.amplitude_at_load_multiple(multiple) / self.amplitude_at_load_frequency


class PointDisplacement(DisplacementHarmonics):
    """An observed displacement in a :class:`MotionRecord`: row number ``row``.

    Attributes
    ----------
    displacement : (n,) [m]
        Values at the record's instants.
    amplitude : float [m]
        Half the peak-to-peak displacement.
    """

    def __init__(self, record: MotionRecord, row: int) -> None:
        super().__init__(record.coefficients[:, row], record.subharmonic)
        self.displacement, n_record_rows = record.row_products[:, row], record.row_products.shape[1]
        self.amplitude = 0.5 * float(
            record.row_and_face_maxima[row] + record.row_and_face_maxima[n_record_rows + row]
        )


class CrackFaceGapsAndForces:
    """The crack faces in a motion, sampled in a :class:`MotionRecord`.

    Attributes
    ----------
    gap, force : (n, n_pairs) [m], [N]
        Normal gaps and contact forces.
    overall_gap_and_force_maxima : (4,)
        Largest opening and penetration [m], largest contact force of a pair and of a crack [N].
    is_slipping_at_instants, is_sticking_at_instants : (n, n_pairs) bool
        With friction: True if a pair slips or sticks.
    losses : (n_pairs,) [J]
        With friction: energy lost by each pair.

    The attributes with friction are for a periodic motion's whole period. In a record with several
    load periods they are for the last load period.
    """

    def __init__(self, record: MotionRecord) -> None:
        n_pairs, last_period_record = record.n_pairs, record.last_periods(1)
        self.gap, self.force = record.gaps[:, :n_pairs], record.forces[:, :n_pairs]
        self.overall_gap_and_force_maxima = record.row_and_face_maxima[-4:]
        if record.friction_coefficient is not None:
            normal_force, friction_force = np.hsplit(last_period_record.forces, 2)
            self.is_slipping_at_instants = is_slipping(
                record.friction_coefficient, normal_force, friction_force
            )
            self.is_sticking_at_instants = (normal_force > 0.0) & ~self.is_slipping_at_instants
            self.losses = friction_losses(last_period_record.gaps[:, n_pairs:], friction_force)


def is_slipping(
    friction_coefficient: Any, normal_force: np.ndarray, friction_force: np.ndarray
) -> np.ndarray:
    """Return True for slipping pairs: (n, n_pairs) bool.

    A closed pair slips if the friction force reaches mu times the normal force. The force may
    be smaller by a relative 1e-6.

    Parameters
    ----------
    friction_coefficient : float or (n_pairs,)
        mu.
    normal_force, friction_force : (n, n_pairs) [N]
    """
    return np.asarray(
        (normal_force > 0.0)
        & (np.abs(friction_force) >= SLIP_FORCE_RATIO * friction_coefficient * normal_force)
    )


def friction_losses(tangential_gap: np.ndarray, friction_force: np.ndarray) -> np.ndarray:
    """Return the energy lost by friction at each pair in a period: (n_pairs,) [J].

    The trapezoidal rule integrates friction force times the rate of the tangential gap.

    Parameters
    ----------
    tangential_gap, friction_force : (n, n_pairs) [m], [N]
        Values at equal parts of the period.
    """
    gap_change = np.roll(tangential_gap, -1, axis=0) - tangential_gap
    return np.asarray(
        0.5 * np.sum((np.roll(friction_force, -1, axis=0) + friction_force) * gap_change, axis=0)
    )


def dof_selection_rows(structure: Structure, dofs: Sequence[int | None]) -> np.ndarray:
    """Return rows (m, n_local) of factors to select the displacements at dofs (collective).

    A row times the structure's coordinates (dofs, or the coordinates of a reduction), summed over
    ranks, is the displacement at a dof. ``dofs`` are m numbers in the whole structure; None stands
    for the watched dof.
    """
    if not dofs:
        return np.zeros((0, structure.n_local))
    if structure.whole is not structure:
        return structure.values_at(np.eye(structure.n_dofs), dofs).T
    rank_local_dofs = structure.as_dof_numbers(dofs) - structure.first_dof
    return np.asarray(rank_local_dofs[:, None] == np.arange(structure.n_local), dtype=float)


# --- what observes --------------------------------------------------------------------------------


class ExtraRows(NamedTuple):
    """Further displacements to observe, to compute stress intensities or clamp forces.

    Attributes
    ----------
    rows : (m, n_local)
        Factors: each row times the displacement u is an observed displacement.
    read_numbers : callable
        Function from a :class:`MotionRecord` of the m observed displacements to a dict of numbers.
        An example of a number is a stress intensity.
    """

    rows: np.ndarray
    read_numbers: Callable[[MotionRecord], dict[str, float]]


class IndicatorsAndCoefficients(NamedTuple):
    """Result of observing a displacement.

    Attributes
    ----------
    indicators : Indicators
        Crack indicators from this displacement.
    real_fourier_coefficients : (2H+1,) [m], or (n, 2H+1) along a curve
        Coefficients a0, a1, b1, ....
    """

    indicators: Indicators
    real_fourier_coefficients: np.ndarray


@keep_old_attribute_names(
    faces="face_indicators",
    measure="indicators_of_dofs",
    observe="observe_dofs",
    records="yield_motion_records",
)
class ObservedMotion:
    """Base of all motions: solutions, orbits, time histories and curves.

    Numbers like crack indicators come from a :class:`MotionRecord`. A record has observed
    displacements, gaps and contact forces at instants. A subclass defines
    :meth:`yield_motion_records` to make the record.
    """

    structure: Structure

    def yield_motion_records(self, rows: np.ndarray) -> Iterator[MotionRecord]:
        """Yield the motion's :class:`MotionRecord`, or one for each curve point (collective).

        Parameters
        ----------
        rows : (m, n_local)
            Factors: each row times the displacement is an observed displacement.
        """
        raise NotImplementedError

    def indicators(self, dof: int | None = None) -> Indicators:
        """Return the crack indicators at a dof (collective). Default: the watched dof."""
        return self.indicators_of_dofs([dof])[0]

    def amplitude(self, dof: int | None = None) -> Any:
        """Return half the peak-to-peak displacement of a dof [m] (collective).

        Default: the watched dof.
        """
        return self.indicators(dof).amplitude

    def indicators_of_dofs(self, dofs: Sequence[int | None]) -> list[Indicators]:
        """Return the crack indicators at several dofs, in the same order (collective).

        The motion is evaluated once for all dofs together; dofs observed before need no evaluation.
        None stands for the watched dof.
        """
        return [
            indicators_and_coefficients.indicators
            for indicators_and_coefficients in self.observe_dofs(dofs)[0]
        ]

    @property
    def face_indicators(self) -> dict[str, Any]:
        """Return the crack faces' indicators by name (collective).

        They are openings, contact forces, friction loss, and fractions of the period in which pairs
        are closed, stick or slip. Names as in :class:`Indicators`. For a curve, arrays (n,) over
        the points. Numbers that are nan everywhere are left out.
        """
        if not self._face_indicators_of_records:
            self.observe_rows(np.zeros((0, self.structure.n_local)))
        value_or_array_by_indicator_name = self._join_curve_point_values_by_name(
            self._face_indicators_of_records
        )
        return {
            name: value
            for name, value in value_or_array_by_indicator_name.items()
            if not np.all(np.isnan(value))
        }

    def observe_dofs(
        self, dofs: Sequence[int | None], places: Sequence[ExtraRows] = ()
    ) -> tuple[list[IndicatorsAndCoefficients], dict[str, Any]]:
        """Observe displacements at dofs, and further numbers from extra rows (collective).

        The motion is evaluated once, for all extra rows and all dofs that were not observed before.

        Parameters
        ----------
        dofs : sequence of int or None
            Numbers of dofs; None stands for the watched dof.
        places : sequence of ExtraRows
            Rows of factors for the displacement, with functions that compute numbers from the
            observed products.

        Returns
        -------
        displacements : list of IndicatorsAndCoefficients
            One for each dof.
        numbers : dict
            Numbers from all ``places`` by name; on a curve, arrays (n,) over the points.
        """
        structure = self.structure
        wanted_dofs = [structure.watched_dof if dof is None else dof for dof in dofs]
        new_dofs = [
            dof
            for dof in dict.fromkeys(wanted_dofs)
            if dof not in self._indicators_and_coefficients_by_dof
        ]
        extra_row_value_by_name: dict[str, Any] = {}
        if new_dofs or places:
            new_indicators_and_coefficients, extra_row_value_by_name = self.observe_rows(
                dof_selection_rows(structure, new_dofs), places
            )
            self._indicators_and_coefficients_by_dof.update(
                zip(new_dofs, new_indicators_and_coefficients, strict=True)
            )
        return [
            self._indicators_and_coefficients_by_dof[dof] for dof in wanted_dofs
        ], extra_row_value_by_name

    def observe_rows(
        self, rows: np.ndarray, places: Sequence[ExtraRows] = ()
    ) -> tuple[list[IndicatorsAndCoefficients], dict[str, Any]]:
        """Observe products of rows with the displacement in one pass (collective).

        Parameters
        ----------
        rows : (m, n_local)
            Factors of the displacement.
        places : sequence of ExtraRows
            Further rows, with functions that compute numbers from the observed products.

        Returns
        -------
        displacements : list of IndicatorsAndCoefficients
            One for each row.
        numbers : dict
            Numbers from all ``places`` by name; on a curve, arrays (n,) over the points.
        """
        row_ends = np.cumsum([len(rows), *(len(extra_rows.rows) for extra_rows in places)]).tolist()
        all_rows = np.vstack([rows, *(extra_rows.rows for extra_rows in places)])
        number_dicts_of_records = []
        coefficient_arrays_of_records = []
        extra_row_value_dicts = list[dict[str, float]]()
        for record_index, record_of_all_rows in enumerate(self.yield_motion_records(all_rows)):
            dof_record = record_of_all_rows.last_periods(N_RECORDED_PERIODS_OF_INTEGRATION)
            dof_record = dof_record.select_rows(slice(len(rows))) if places else dof_record
            if record_index < len(self._face_indicators_of_records):
                dof_record = replace(dof_record, gaps=dof_record.gaps[:, :0])
            else:
                self._face_indicators_of_records.append(_crack_face_indicator_by_name(dof_record))
            indicator_shared_by_rows_by_name = {
                "omega": dof_record.omega
            } | self._face_indicators_of_records[record_index]
            point_displacement_iterator = (
                PointDisplacement(dof_record, row) for row in range(len(rows))
            )
            number_dicts_of_records.append(
                [
                    indicator_shared_by_rows_by_name
                    | read_observables(Place.WATCHED_POINT, point_displacement)
                    for point_displacement in point_displacement_iterator
                ]
            )
            coefficient_arrays_of_records.append(dof_record.coefficients.T)
            extra_row_value_dicts.append({})
            for extra_rows, row_bounds in zip(places, pairwise(row_ends), strict=True):
                extra_row_value_dicts[-1] |= extra_rows.read_numbers(
                    record_of_all_rows.select_rows(slice(*row_bounds))
                )
        indicators_and_coefficients_of_rows = [
            IndicatorsAndCoefficients(
                Indicators(**self._join_curve_point_values_by_name(number_dicts_of_row)),
                self._join_curve_point_values(list(coefficient_arrays_of_row)),
            )
            for number_dicts_of_row, coefficient_arrays_of_row in zip(
                zip(*number_dicts_of_records, strict=True),
                zip(*coefficient_arrays_of_records, strict=True),
                strict=True,
            )
        ]
        return indicators_and_coefficients_of_rows, self._join_curve_point_values_by_name(
            extra_row_value_dicts
        )

    def _join_curve_point_values_by_name(
        self, dicts_of_numbers_by_name: Sequence[Mapping[str, float]]
    ) -> dict[str, Any]:
        """Return each named number over all records: a float, on a curve an array (n,).

        ``dicts_of_numbers_by_name`` has a dictionary for each record, all with the same names.
        """
        return {
            name: self._join_curve_point_values(
                [number_by_name[name] for number_by_name in dicts_of_numbers_by_name]
            )
            for name in dicts_of_numbers_by_name[0]
        }

    def _join_curve_point_values(self, values: list[Any]) -> Any:
        """Return the only entry of ``values``, a list with an entry for each record.

        Most motions have a single record. A curve has a record for each point, and overrides this
        method to return an array over the points.
        """
        [only_record_value] = values
        return only_record_value

    @cached_property
    def _indicators_and_coefficients_by_dof(self) -> dict[int, IndicatorsAndCoefficients]:
        """Return the displacements observed so far, by dof."""
        return {}

    @cached_property
    def _face_indicators_of_records(self) -> list[dict[str, float]]:
        """Return the crack faces' numbers by name, one dictionary for each record.

        The list is empty before the first observation.
        """
        return []


def _crack_face_indicator_by_name(record: MotionRecord) -> dict[str, float]:
    """Return the crack faces' indicators in a record by name.

    All are nan without contact pairs, and friction indicators without friction.
    """
    number_by_name = dict.fromkeys(observable_names(Place.CRACK_FACES), math.nan)
    if record.n_pairs:
        excluded_observables_flag = (
            REQUIRES_FRICTION if record.friction_coefficient is None else IN_FILES_ONLY
        )
        number_by_name |= read_observables(
            Place.CRACK_FACES, CrackFaceGapsAndForces(record), excluded_observables_flag
        )
    return number_by_name | dict(record.exact_number_by_name)
