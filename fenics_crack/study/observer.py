"""Observation of a study's motions: the numbers that are printed, written and drawn.

Watched points and crack faces are always observed; crack tips and the clamp only if the scene
requests their quantities. Each solution of a curve is evaluated once for all numbers. Stress
intensities and clamp reactions follow from time histories R u: rows R times the displacement u.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import (
    IN_FILES_ONLY,
    OBSERVABLES_BY_NAME,
    REQUIRES_GROWTH_LAW,
    REQUIRES_SOLID,
    Place,
    observable_names,
    read_observables,
)
from fenics_crack.model.nodes import ClampReactionData
from fenics_crack.model.receptance import check_has_matrices
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.motion.motions import ExtraRows, MotionRecord, ObservedMotion
from fenics_crack.scene.result_tables import Growth
from fenics_crack.scene.scene import (
    Scene,
    list_requested_extra_quantities,
    reason_without_stress_intensity,
    refuse_for_reason,
)
from fenics_crack.study.prepare import Study

if TYPE_CHECKING:
    from fenics_crack.fem.interaction_integral import Station, Tip


MIN_FRONT_STATIONS = 3
"""Minimum number of stations along a crack front that show how K varies. With two stations, both
have the mean of K over the front."""
MAX_EXPANDED_VALUES = 20_000_000
"""Maximum number of displacement values expanded at once from reduced to full coordinates (160 MB).
Each expansion factors the structure again."""


def make_requested_rows_and_readers(study: Study) -> list[ExtraRows]:
    """Make rows and readers for requested numbers of crack tips and clamp (collective).

    A requested number is for example K_max. It is computed from time histories R u, with a
    displacement u and rows R. Both the rows and the function that reads the numbers from R u are in
    an :class:`ExtraRows`. The rows are made once for the study's structure.

    Returns
    -------
    list of ExtraRows
        An entry for crack tips and one for the clamp, as requested; empty if the scene requests no
        such numbers.
    """
    requested_places = {
        OBSERVABLES_BY_NAME[requested_quantity_name].place
        for requested_quantity_name in list_requested_extra_quantities(study.scene)
    }
    return [
        make_rows_and_reader(study)
        for place, make_rows_and_reader in _MAKE_ROWS_AND_READER_BY_PLACE.items()
        if place in requested_places
    ]


class ObservedQuantity(NamedTuple):
    """A number read from a motion, with its name and unit.

    Attributes
    ----------
    column_name : str
        Name of the number's column in tables, such as "tip.ux.ratio_2_1" at the point "tip".
    words : str
        Description, with the watched displacement.
    value : float or (n,)
        The number; for a curve with n points, n values.
    unit : str
        Unit of the number.
    name : str
        Name without the point, such as "ratio_2_1".
    """

    column_name: str
    words: str
    value: Any
    unit: str
    name: str


def observe_quantities(study: Study, motion: ObservedMotion) -> list[ObservedQuantity]:
    """Return a motion's numbers for tables and files (collective).

    First come numbers of the watched displacements, then of the crack faces, then requested numbers
    of crack tips and clamp. For a curve, each number is an array over the curve's points.
    """
    watched_dofs = [watched_displacement.dof for watched_displacement in study.watched]
    observed_displacements, requested_value_by_name = motion.observe_dofs(
        watched_dofs, make_requested_rows_and_readers(study)
    )
    observed_quantities = []
    for watched_displacement, (watched_dof_indicators, _) in zip(
        study.watched, observed_displacements, strict=True
    ):
        for quantity_name in observable_names(Place.WATCHED_POINT):
            observable = OBSERVABLES_BY_NAME[quantity_name]
            needs_displacement_words = watched_displacement.name or quantity_name == "amplitude"
            words = observable.words + (
                f", {watched_displacement.words}" if needs_displacement_words else ""
            )
            column_name = watched_displacement.column_name(quantity_name)
            value = getattr(watched_dof_indicators, quantity_name)
            observed_quantities.append(
                ObservedQuantity(column_name, words, value, observable.unit, quantity_name)
            )
    value_by_name = motion.face_indicators | {
        quantity_name: requested_value_by_name[quantity_name]
        for quantity_name in list_requested_extra_quantities(study.scene)
    }
    for quantity_name, value in value_by_name.items():
        observable = OBSERVABLES_BY_NAME[quantity_name]
        observed_quantities.append(
            ObservedQuantity(quantity_name, observable.words, value, observable.unit, quantity_name)
        )
    return observed_quantities


# --- the clamp ------------------------------------------------------------------------------------


class ClampReactions(NamedTuple):
    """Forces and moments of the clamp at n instants.

    The mesh has d dimensions. n_rigid is the number of rigid-body motions: 3 in a plate, 6 in a
    solid.

    Attributes
    ----------
    force : (n, d) [N]
        Components of the force.
    moment : (n, n_rigid - d) [N m]
        Components of the moment: 1 in a plate, 3 in a solid.
    """

    force: np.ndarray
    moment: np.ndarray


def compute_clamp_reactions(record: MotionRecord) -> ClampReactions:
    """Compute the clamp's forces and moments from a motion's record.

    ``record`` has time histories R u of the displacement u, with the rows R from
    :func:`clamp_inertia_rows`.
    """
    whole_structure, load_omega = record.structure.whole, record.omega
    clamp, rayleigh_mass_factor = _clamp_and_rayleigh_mass_factor(whole_structure)
    if record.instants_per_load_period:
        return ClampReactions(
            *clamp.reaction_of_record(
                record.time, record.row_products, load_omega, rayleigh_mass_factor
            )
        )
    subharmonic, base_omega = record.subharmonic, load_omega / record.subharmonic
    phases_of_motion = base_omega * record.time
    forces_and_moments = clamp.reaction_of_waves(
        record.coefficients, base_omega, subharmonic, rayleigh_mass_factor, phases_of_motion
    )
    return ClampReactions(*forces_and_moments)


def _clamp_and_rayleigh_mass_factor(whole_structure: Structure) -> tuple[ClampReactionData, float]:
    """Return a structure's clamp, and the mass factor of Rayleigh damping [1/s].

    The factor is 0 for other damping. A structure without matrices raises InputError.
    """
    check_has_matrices(whole_structure, "forces at its clamp")
    assert whole_structure.clamp is not None  # the scene has been checked
    clamp, damping_rule = whole_structure.clamp, whole_structure.damping
    return clamp, damping_rule.mass if isinstance(damping_rule, RayleighDamping) else 0.0


def clamp_inertia_rows(structure: Structure) -> np.ndarray:
    """Return the rows r^T M for the rigid-body motions r: (n_rigid, n_local) (collective).

    M is the mass matrix. The rows times an acceleration give the inertia force, and so the force on
    the clamp. n_rigid is 3 in a plate, 6 in a solid. The columns are the structure's n_local
    coordinates on this rank. In a reduced structure only the kept modes have inertia, since
    truncated modes respond statically.
    """
    whole_structure = structure.whole
    inertia_rows = _clamp_and_rayleigh_mass_factor(structure.whole)[0].inertia
    if structure is whole_structure:
        return inertia_rows
    # These modes have mass, even if some coordinates have none.
    known_omega_and_shapes = structure.known_omega_and_shapes(is_bonded=False)
    mode_shapes = (
        np.eye(structure.n_dofs) if known_omega_and_shapes is None else known_omega_and_shapes[1]
    )
    inertia_rows_of_shapes = whole_structure.sum_over_ranks(
        structure.expand(mode_shapes.T) @ inertia_rows.T
    ).T
    mass_matrix = structure.mass.getValues(range(structure.n_dofs), range(structure.n_dofs))
    return np.asarray(inertia_rows_of_shapes @ mode_shapes.T @ mass_matrix)


# --- the tips -------------------------------------------------------------------------------------


class CrackTipHistory(NamedTuple):
    """Stress intensity factors over time at a crack tip or front station.

    Attributes
    ----------
    K_I, K_II, K_III : (n,) [Pa m^1/2]
        Values at n instants; K_III is None for a plate.
    duration_in_load_periods : float
        Duration of the record, or period of the motion, in load periods.
    growth_law : Growth or None
        Table ``[growth]`` of the scene: law of fatigue crack growth.
    closed_front_error : float [Pa m^1/2]
        Error of K_I at the front of a solid's crack with zero clearance. There K_I is set to zero
        while the front is closed, and while K_I is negative. The error is the largest abs(K_I) set
        to zero; 0 in a plate.
    """

    K_I: np.ndarray
    K_II: np.ndarray
    duration_in_load_periods: float
    growth_law: Growth | None
    K_III: np.ndarray | None = None
    closed_front_error: float = 0.0

    @property
    def equivalent_range(self) -> float:
        """Range of K_I from 0 with the same growth per load period.

            (sum_i (delta K_i / (1 - R_i)^(1 - gamma))^m / T)^(1 / m) [Pa m^1/2]

        The sum is over the rainflow cycles i of max(K_I, 0). Cycle i has the range delta K_i, and
        the ratio R_i of minimum to maximum. gamma and m are ``ratio_exponent`` and ``exponent`` of
        the growth law. T is ``duration_in_load_periods``. If at least one cycle is above the
        threshold of the growth law, cycles below it are left out.
        """
        assert self.growth_law is not None
        maxima, minima = find_rainflow_maxima_and_minima(np.maximum(self.K_I, 0.0)).T
        cycle_ranges = maxima - minima
        if not cycle_ranges.size:
            return 0.0
        load_ratios = np.minimum(minima / maxima, 1.0 - 1e-9)
        load_ratio_corrected_ranges = cycle_ranges / (1.0 - load_ratios) ** (
            1.0 - self.growth_law.ratio_exponent
        )
        is_growing = cycle_ranges >= min(self.growth_law.threshold, cycle_ranges.max())
        growth_terms_over_largest = (
            np.where(
                is_growing, load_ratio_corrected_ranges / load_ratio_corrected_ranges.max(), 0.0
            )
            ** self.growth_law.exponent
        )
        return float(
            load_ratio_corrected_ranges.max()
            * (growth_terms_over_largest.sum() / self.duration_in_load_periods)
            ** (1.0 / self.growth_law.exponent)
        )

    def value_by_name(self) -> dict[str, float]:
        """Return stress intensity numbers of the tip [Pa m^1/2] by name: "K_max", "delta_K", ....

        The equivalent range is included only with a growth law, and "K_III_max" only in a solid.
        """
        excluded_flags = IN_FILES_ONLY if self.growth_law is not None else REQUIRES_GROWTH_LAW
        value_by_name = read_observables(
            Place.MOST_LOADED_TIP,
            self,
            excluded_flags | (REQUIRES_SOLID if self.K_III is None else IN_FILES_ONLY),
        )
        return {
            name: value
            for name, value in value_by_name.items()
            if not name.endswith(("_leading", "_ratio"))
        }


def compute_crack_tip_histories(
    record: MotionRecord,
    tips: Sequence[Tip | Station],
    force_rows: np.ndarray,
    growth_law: Growth | None,
) -> list[CrackTipHistory]:
    """Compute stress intensity factors at each tip over a motion's record.

    At the front of a solid's crack with zero clearance, K_I is corrected: negative values become
    zero, and K_I is zero while all contact pairs next to the station are closed.

    Parameters
    ----------
    record : Record
        Contact forces, and time histories R u of the displacement u. R are the displacement rows
        from :func:`make_tips_and_intensity_rows`.
    tips : sequence of Tip or Station
        Tips, or stations along fronts, from the same function.
    force_rows : (2 n_tips, n_pairs), or (3 n_tips, n_pairs) in a solid
        Factors of the contact forces, from the same function.
    growth_law : Growth or None
        Law of crack growth, for the equivalent range.
    """
    stress_intensities = (record.row_products + record.forces[:, : record.n_pairs] @ force_rows.T).T
    is_without_clearance = not np.any(record.structure.clearance)
    tip_histories = []
    for tip, (K_I, K_II, *K_III) in zip(
        tips, stress_intensities.reshape(len(tips), -1, stress_intensities.shape[1]), strict=True
    ):
        corrected_K_I, adjacent_pair_indices = K_I, tip.adjacent_pairs
        if is_without_clearance and len(adjacent_pair_indices):
            is_closed = np.all(record.forces[:, adjacent_pair_indices] > 0.0, axis=1)
            corrected_K_I = np.where(is_closed, 0.0, K_I.clip(0.0))
        largest_K_I_set_to_zero = float(np.abs(K_I - corrected_K_I).max())
        tip_histories.append(
            CrackTipHistory(
                corrected_K_I,
                K_II,
                record.periods,
                growth_law,
                K_III[0] if K_III else None,
                largest_K_I_set_to_zero,
            )
        )
    return tip_histories


class EllipseTipHistories(NamedTuple):
    """Stress intensity factors over time along the front of an elliptic crack.

    Attributes
    ----------
    deepest_intensity_history : CrackTipHistory
        History at the deepest station.
    end_intensity_histories : list of CrackTipHistory
        Histories at the ends of the front, at the surface of the body.
    """

    deepest_intensity_history: CrackTipHistory
    end_intensity_histories: list[CrackTipHistory]


def estimate_closed_front_and_mesh_errors(
    study: Study, motion: ObservedMotion, coarser_study: Study, coarser_motion: ObservedMotion
) -> tuple[dict[str, float], dict[str, float]]:
    """Estimate errors of stress intensities at closed fronts and by the mesh (collective).

    Without clearance, a front is closed at a station while all contact pairs next to the station
    are in contact. The computed K_I is then set to zero. It is also set to zero while negative
    (:class:`CrackTipHistory`).

    Parameters
    ----------
    study, motion : Study, ObservedMotion
        Study, and its motion.
    coarser_study, coarser_motion : Study, ObservedMotion
        Study on a coarser mesh, and its motion.

    Returns
    -------
    closed_error_by_name : dict of str to float [Pa m^1/2]
        For each requested number, the largest abs(K_I) set to zero (``closed_front_error``). Empty
        if ``difference_by_name`` is infinite.
    difference_by_name : dict of str to float [Pa m^1/2]
        For each requested number, the difference between both meshes. It is the maximum along all
        fronts, since it may vanish by chance at a single station. Infinite if the coarser mesh
        lacks the numbers, or has fewer than 3 stations on a front.

    Both are empty for a plate, or if the scene requests no numbers of crack fronts.
    """
    requested_quantity_names = set(list_requested_extra_quantities(study.scene))
    quantity_names = sorted(
        requested_quantity_names.intersection(
            observable_names(Place.MOST_LOADED_TIP, Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS)
        )
    )
    if study.scene.dimension == 2 or not quantity_names:
        return {}, {}
    if not requested_quantity_names.intersection(
        list_requested_extra_quantities(coarser_study.scene)
    ):
        return {}, dict.fromkeys(quantity_names, math.inf)
    intensities_by_front, closed_front_error = _collect_intensities_by_front(study, motion)
    coarser_intensities_by_front, _ = _collect_intensities_by_front(coarser_study, coarser_motion)
    n_fewest_stations = min(
        len(relative_positions) for relative_positions, _ in coarser_intensities_by_front.values()
    )
    if n_fewest_stations < MIN_FRONT_STATIONS:
        return {}, dict.fromkeys(quantity_names, math.inf)
    difference_by_name = {}
    for quantity_name in quantity_names:
        station_quantity_name = quantity_name.removesuffix("_deepest").removesuffix("_surface")
        station_quantity_name = station_quantity_name.replace("_leading", "_max")
        mesh_differences_by_front_list = [
            np.interp(
                relative_positions,
                coarser_intensities_by_front[front_name][0],
                coarser_intensities_by_front[front_name][1][station_quantity_name],
            )
            - station_values_by_name[station_quantity_name]
            for front_name, (
                relative_positions,
                station_values_by_name,
            ) in intensities_by_front.items()
        ]
        difference_by_name[quantity_name] = float(
            np.abs(np.hstack(mesh_differences_by_front_list)).max()
        )
    return dict.fromkeys(quantity_names, closed_front_error), difference_by_name


def _collect_intensities_by_front(
    study: Study, motion: ObservedMotion
) -> tuple[dict[str, tuple[np.ndarray, dict[str, np.ndarray]]], float]:
    """Collect stress intensities along each crack front, by the front's name (collective).

    Returns
    -------
    intensities_by_front : dict of str to (relative_positions, values_by_name)
        For each front: relative positions (n,) of its n stations, from 0 to 1; and a dict of
        numbers such as "K_max", each with n values [Pa m^1/2].
    closed_front_error : float [Pa m^1/2]
        Largest abs(K_I) set to zero at closed fronts, over all stations (:class:`CrackTipHistory`).
    """
    stations, displacement_rows, force_rows = make_tips_and_intensity_rows(study)
    [record] = motion.yield_motion_records(displacement_rows)
    tip_histories = compute_crack_tip_histories(record, stations, force_rows, study.scene.growth)
    arc_lengths = np.array([station.arc_length for station in stations])
    values_by_name = tabulate_stress_intensity_values(tip_histories)
    intensities_by_front = {
        front_name: (
            arc_lengths[station_indices] / (arc_lengths[station_indices[-1]] or 1.0),
            {name: values[station_indices] for name, values in values_by_name.items()},
        )
        for front_name, station_indices in station_indices_by_front(
            [station.name for station in stations]
        ).items()
    }
    return intensities_by_front, max(history.closed_front_error for history in tip_histories)


def tabulate_stress_intensity_values(
    tip_histories: Sequence[CrackTipHistory],
) -> dict[str, np.ndarray]:
    """Return stress intensity numbers of all tips: dict of str to (n_tips,) [Pa m^1/2].

    Names are for example "K_max". A tip may also be a station on a crack front.
    """
    value_by_name_of_tips = [tip_history.value_by_name() for tip_history in tip_histories]
    return {
        name: np.array([value_by_name[name] for value_by_name in value_by_name_of_tips])
        for name in value_by_name_of_tips[0]
    }


def station_indices_by_front(station_names: Sequence[str]) -> dict[str, list[int]]:
    """Return the indices of each front's stations, by the front's name.

    ``station_names`` are like "the crack front at 3.2 mm". Names without " at " (crack tips of a
    plate) are listed under "".
    """
    indices_by_front: dict[str, list[int]] = {}
    for station_index, station_name in enumerate(station_names):
        indices_by_front.setdefault(station_name.rpartition(" at ")[0], []).append(station_index)
    return indices_by_front


def leading_crack_tip_index(tip_histories: list[CrackTipHistory]) -> int:
    """Return the index of the tip with the largest range of positive K_I.

    The range is max(max K_I, 0) - max(min K_I, 0).
    """
    return int(
        np.argmax(
            [
                OBSERVABLES_BY_NAME["delta_K_effective"].read_number_at_place(tip_history)
                for tip_history in tip_histories
            ]
        )
    )


def make_tips_and_intensity_rows(
    study: Study,
) -> tuple[list[Tip] | list[Station], np.ndarray, np.ndarray]:
    """Make the rows that give K at crack tips or front stations (collective).

    K = displacement_rows u + force_rows lambda, with displacement u and contact forces lambda. The
    rows are made once for a structure, and hold for copies with other load, damping or clearance.
    In a reduced structure, u includes the static responses to load and contact forces. So K
    converges faster than a sum over modes.

    Returns
    -------
    tips : list of Tip or Station
        Crack tips of a plate, or stations along the crack fronts of a solid.
    displacement_rows : (2 n_tips, n_local), or (3 n_tips, n_local) in a solid
        Factors of the structure's n_local coordinates on this rank. For each tip: the row of K_I,
        then K_II, and in a solid K_III.
    force_rows : (2 n_tips, n_pairs), or (3 n_tips, n_pairs) in a solid
        Factors of the contact forces, in the same order.

    Raises
    ------
    InputError
        Stress intensities cannot be computed for the scene, or no crack has a tip.
    """
    scene = study.scene
    refuse_for_reason(reason_without_stress_intensity(scene), "output.quantities")
    pair_kind = None if scene.contact is None else scene.contact.pairs
    dependencies = scene.geometry, scene.crack, scene.cracks, scene.material, scene.mesh, pair_kind
    return study.structure.compute_once(_TipsAndIntensityRowsMaker(dependencies, scene))


@dataclass(frozen=True)
class _TipsAndIntensityRowsMaker:
    """Function from a structure to tips and rows of K, for :meth:`Structure.compute_once`.

    Two makers are equal if their scenes have the same body, cracks and mesh (``dependencies``); the
    result is then shared.
    """

    dependencies: tuple[object, ...]
    scene: Scene = field(compare=False)

    def __call__(
        self, structure: Structure
    ) -> tuple[list[Tip] | list[Station], np.ndarray, np.ndarray]:
        if structure is structure.whole:
            tips_and_rows: tuple[list[Tip] | list[Station], np.ndarray, np.ndarray]
            if self.scene.dimension == 2:
                from fenics_crack.fem.interaction_integral import tip_functionals  # DOLFINx

                tips_and_rows = tip_functionals(self.scene, structure)
            else:
                from fenics_crack.fem.front_intensities import front_functionals

                tips_and_rows = front_functionals(self.scene, structure)
            if not tips_and_rows[0]:
                raise InputError(
                    "crack", "a crack without a tip", "one with a tip inside the structure"
                )
            return tips_and_rows
        tips, displacement_rows, force_rows = structure.whole.compute_once(self)
        unit_displacements = np.eye(structure.n_dofs)
        n_unit_vectors_per_block = max(1, MAX_EXPANDED_VALUES // structure.whole.n_dofs)
        blocks_of_unit_displacements = [
            unit_displacements[start_index : start_index + n_unit_vectors_per_block]
            for start_index in range(0, len(unit_displacements), n_unit_vectors_per_block)
        ]
        products_with_unit_vectors = np.vstack(
            [
                structure.expand(block_of_unit_displacements) @ displacement_rows.T
                for block_of_unit_displacements in blocks_of_unit_displacements
            ]
        )
        return tips, structure.whole.sum_over_ranks(products_with_unit_vectors).T, force_rows


def find_rainflow_maxima_and_minima(values: np.ndarray) -> np.ndarray:
    """Return each rainflow cycle's maximum and minimum: (k, 2).

    ``values`` (n,) are a period of a signal. Counting starts at the largest value. The range
    between two turning points is a cycle if the next range is at least as large (ASTM E1049, 5.4.5;
    Downing and Socie, International Journal of Fatigue 4, 1982, 31). Constant values give no cycle:
    (0, 2).
    """
    largest_value_index = int(values.argmax())
    periodic_values = np.append(values[largest_value_index:], values[: largest_value_index + 1])
    periodic_values = periodic_values[np.append(True, np.diff(periodic_values) != 0.0)]
    turning_point_indices = 1 + np.flatnonzero(np.diff(np.sign(np.diff(periodic_values))))
    pending_turning_points: list[float] = []
    cycle_maxima_and_minima = []
    for value in periodic_values[[0, *turning_point_indices, -1]].tolist():
        pending_turning_points.append(value)
        while len(pending_turning_points) > 2 and abs(
            pending_turning_points[-1] - pending_turning_points[-2]
        ) >= abs(pending_turning_points[-2] - pending_turning_points[-3]):
            cycle_maxima_and_minima.append(
                (max(pending_turning_points[-3:-1]), min(pending_turning_points[-3:-1]))
            )
            del pending_turning_points[-3:-1]
    return np.array(cycle_maxima_and_minima).reshape(-1, 2)


def _make_tip_intensity_rows_and_reader(study: Study) -> ExtraRows:
    """Make stress intensity rows at crack tips, and a function to read numbers (collective).

    The function returns numbers by name, such as "K_max" [Pa m^1/2], from a motion's record. The
    numbers belong to the tip or station with the largest range of positive K_I, but those that the
    name calls largest: K_II, K_III and their ratio of all tips, and K_max of all stations in a
    solid, which decides on fracture.
    """
    tips, displacement_rows, force_rows = make_tips_and_intensity_rows(study)

    def read_leading_tip_numbers(record: MotionRecord) -> dict[str, float]:
        """Return the stress intensity numbers [Pa m^1/2] of the leading tip, such as "K_max".

        The leading tip has the largest range of positive K_I. The largest K_II and K_III are of all
        tips, in a solid "K_max", too. The ratio is of tips with a tenth of the largest K_I or more.
        """
        tip_histories = compute_crack_tip_histories(record, tips, force_rows, study.scene.growth)
        value_by_name = tip_histories[leading_crack_tip_index(tip_histories)].value_by_name()
        values = tabulate_stress_intensity_values(tip_histories)
        for name in ("K_II_max", "K_III_max"):
            if name in value_by_name:
                value_by_name[name.replace("max", "leading")] = value_by_name[name]
                value_by_name[name] = float(values[name].max())
        K_max = np.maximum(values["K_max"], np.finfo(float).tiny)
        grows = K_max >= 0.1 * K_max.max()
        value_by_name["K_II_ratio"] = float((values["K_II_max"] / K_max)[grows].max())
        if study.scene.dimension == 3:  # under a mean load it may be largest at another station
            value_by_name["K_max"] = float(values["K_max"].max())
        return value_by_name

    return ExtraRows(displacement_rows, read_leading_tip_numbers)


def _make_ellipse_rows_and_reader(study: Study) -> ExtraRows:
    """Make stress intensity rows along an ellipse's front, and a reading function (collective).

    The crack is a half-ellipse at the surface of the body. The function returns numbers by name
    from a motion's record: at the deepest station, and the mean over the front's ends at the
    surface.
    """
    stations, displacement_rows, force_rows = make_tips_and_intensity_rows(study)
    station_positions = np.array([station.point for station in stations])
    crack = study.scene.given("crack")
    station_heights = station_positions[:, 2]
    if crack.point is not None:
        station_heights = -np.abs((station_positions - crack.point) @ crack.frame[1])
    station_height_at_half_depth = 0.5 * (station_heights.min() + station_heights.max())
    surface_station_indices = [
        surface_station_index
        for surface_station_index in (0, len(stations) - 1)
        if station_heights[surface_station_index] > station_height_at_half_depth
    ]

    def read_ellipse_numbers(record: MotionRecord) -> dict[str, float]:
        """Return numbers by name: at the deepest station, and as mean over the front's ends."""
        tip_histories = compute_crack_tip_histories(
            record, stations, force_rows, study.scene.growth
        )
        ellipse_histories = EllipseTipHistories(
            tip_histories[int(station_heights.argmin())],
            [
                tip_histories[surface_station_index]
                for surface_station_index in surface_station_indices
            ],
        )
        return read_observables(Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS, ellipse_histories)

    return ExtraRows(displacement_rows, read_ellipse_numbers)


def _make_clamp_rows_and_reader(study: Study) -> ExtraRows:
    """Make the clamp's rows r^T M, and a function that reads numbers (collective).

    r are the rigid-body motions and M the mass matrix (:func:`clamp_inertia_rows`). The function
    returns numbers by name from a motion's record: the largest force [N] and the largest moment [N
    m] of the clamp.
    """
    inertia_rows = study.structure.compute_once(clamp_inertia_rows)
    return ExtraRows(
        inertia_rows, lambda record: read_observables(Place.CLAMP, compute_clamp_reactions(record))
    )


_MAKE_ROWS_AND_READER_BY_PLACE: dict[Place, Callable[[Study], ExtraRows]] = {
    Place.MOST_LOADED_TIP: _make_tip_intensity_rows_and_reader,
    Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS: _make_ellipse_rows_and_reader,
    Place.CLAMP: _make_clamp_rows_and_reader,
}
"""Functions that make the rows for crack tips, ellipse front or clamp, if requested."""
