"""Plausibility of a scene: remarks on unusual values.

Remarks follow from tables of rules: a key, a number, and the range in which the number is usual. A
remark forbids nothing; most often a unit or a number is mistyped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.ranks import gather_rows
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    choose_frequency_factor_name_unit,
    format_in_unit,
)
from fenics_crack.fem.cracks import RELATIVE_POSITION_TOLERANCE
from fenics_crack.fem.setting import fit_load_wave_harmonics_and_residual
from fenics_crack.model.modes import solve_modes
from fenics_crack.model.nodes import format_point
from fenics_crack.model.rotation import relative_coriolis_shifts
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene, list_dropped_quantities
from fenics_crack.scene.words import word_for_crack_faces
from fenics_crack.study.key_figures import (
    N_KEY_FIGURE_MODES,
    PreSolutionKeyFigures,
    mesh_extents,
    propose_curve_or_none,
)
from fenics_crack.study.prepare import modal_reduction_or_none
from fenics_crack.study.resonance import (
    FACTOR_AND_UNIT_BY_CURVE_PARAMETER,
    curve_parameter_at_crossing,
)

MAX_SMALL_ROTATION = 0.1
"""Maximum rotation [rad], displacement over length, for small displacements. Linear theory neglects
terms of about its square, 1 %."""


MAX_PLAUSIBLE_LENGTH = 20.0
"""Maximum plausible side of a plate, radius or extent [m]; larger values get a remark."""
MAX_PLAUSIBLE_TIP_SPEED = 1000.0
"""Maximum plausible speed of a blade tip [m/s]; the longest blades have 700."""
FAST_TIP_REMARK_TEMPLATE = "the blade tip moves at {:.3g} m/s; the fastest blades reach 700 m/s"
MAX_PLAUSIBLE_DAMPING = 0.05
"""Maximum plausible ratio of critical damping; larger values get a remark."""
MIN_REPORTED_CORIOLIS_CHANGE = 0.01
"""Minimum relative change of a frequency by the Coriolis force that gets a remark. Errors of usual
meshes are as large."""
CORIOLIS_REMARK_TEMPLATE = (
    "the Coriolis force, left out, would change one of the first natural frequencies by {:.2%}"
)
SCENE_KEY_PREFIXES_OF_KEY_FIGURES = (
    "material.",
    "geometry.",
    "rotation.",
    "mesh.file",
    "structure.model",
)
"""Beginnings of scene keys on which the key figures depend. After a remark on such a key, no
remarks are based on the figures."""


@dataclass(frozen=True)
class Remark:
    """Remark on an unusual value: ``key = value: text``."""

    key: str
    value: object
    text: str

    def __str__(self) -> str:
        value = f"{self.value:g}" if isinstance(self.value, float) else str(self.value)
        return f"{self.key} = {value}: {self.text}"


class RemarkRule(NamedTuple):
    """Rule for remarks on a scene: a number's plausible range.

    Attributes
    ----------
    keys_text : str
        Scene keys, separated by blanks, such as "excitation.force_sin excitation.force_cos". The
        remark names the first key with a value other than 0. A key of "crack" stands for every
        crack.
    lower_limit, upper_limit : float
        Plausible range; a number outside gets a remark.
    remark_template : str
        Text of the remark, with fields for the number and further values. {kind} is the kind of
        body, {faces} the word for crack faces.
    compared_number_function : callable, optional
        Function that returns the number, given the key's value and the scene. Some rules also give
        it the structure or the key figures. It may return a tuple: the number, and further values
        for the text. It returns None if the rule does not apply. Default: the key's largest value.
    factor_by_mistyped_unit : mapping of str to float
        For each unit in which the value may be given by mistake, the factor to the key's unit.
    """

    keys_text: str
    lower_limit: float
    upper_limit: float
    remark_template: str
    compared_number_function: Callable[..., Any] = lambda value, *_: float(np.max(value))
    factor_by_mistyped_unit: Mapping[str, float] = MappingProxyType({})


def remarks_on_scene(
    scene: Scene,
    structure: Structure | None = None,
    key_figures: PreSolutionKeyFigures | None = None,
) -> list[Remark]:
    """Return remarks on unusual values in a scene (collective).

    Parameters
    ----------
    scene : Scene
        Scene to check.
    structure : Structure, optional
        Unreduced structure, for further remarks.
    key_figures : PreSolutionKeyFigures, optional
        Natural frequencies, static responses and amplitudes, for further remarks.
    """
    remarks = [*_iterate_remarks(SCENE_REMARK_RULES, scene)]
    if structure is not None:
        remarks += _iterate_remarks(STRUCTURE_REMARK_RULES, scene, structure)
    if key_figures is not None and not any(
        remark.key.startswith(SCENE_KEY_PREFIXES_OF_KEY_FIGURES) for remark in remarks
    ):
        remarks += _iterate_remarks(KEY_FIGURE_REMARK_RULES, scene, key_figures)
    if structure is not None:
        remarks += _iterate_remarks(METHOD_REMARK_RULES, scene, structure)
    return remarks


def _iterate_remarks(
    rules: Iterable[RemarkRule], scene: Scene, *rule_arguments: object
) -> Iterator[Remark]:
    """Yield the remarks of several rules on a scene.

    If a value is plausible in another unit of ``factor_by_mistyped_unit``, the remark proposes the
    first such unit.

    Parameters
    ----------
    rules : iterable of RemarkRule
        Rules to apply.
    scene : Scene
        Scene to check.
    rule_arguments
        Passed to the functions of the rules after the scene: the structure, or the key figures.
    """
    geometry_table = scene.geometry
    body_kind = "structure" if geometry_table is None else geometry_table.kind
    for rule in rules:
        for key, value in _list_first_given_key_and_value(scene, rule.keys_text):
            number_and_values = rule.compared_number_function(value, scene, *rule_arguments)
            checked_number, *further_values = (
                number_and_values if isinstance(number_and_values, tuple) else (number_and_values,)
            )
            if checked_number is None or rule.lower_limit <= checked_number <= rule.upper_limit:
                continue
            remark_text = rule.remark_template.format(
                checked_number, *further_values, kind=body_kind, faces=word_for_crack_faces(scene)
            )
            mistyped_unit_question_texts = (
                f"; is it in {mistyped_unit}? then give {unit_factor * float(np.max(value)):g}"  # type: ignore[call-overload]
                for mistyped_unit, unit_factor in rule.factor_by_mistyped_unit.items()
                if rule.lower_limit <= unit_factor * checked_number <= rule.upper_limit
            )
            remark_text += next(mistyped_unit_question_texts, "")
            yield Remark(key, list(value) if isinstance(value, tuple) else value, remark_text)


def _list_first_given_key_and_value(scene: Scene, keys: str) -> list[tuple[str, object]]:
    """Return the first key with a nonzero value, and the value.

    If all values are zero, the first given key is returned.

    Parameters
    ----------
    scene : Scene
        Source of the values.
    keys : str
        Keys such as "geometry.width", separated by blanks.

    Returns
    -------
    list of (key, value)
        The key and its value. For a key of the table "crack", an entry for each crack that has it.
        Empty if no key is given.
    """
    keys_and_values_by_key: list[list[tuple[str, object]]] = []
    for dotted_key in keys.split():
        table_name, field_name = dotted_key.split(".")
        table_by_name = (
            scene.crack_by_name
            if table_name == "crack"
            else {table_name: getattr(scene, table_name)}
        )
        value_by_key = {
            f"{path}.{field_name}": getattr(table, field_name, None)
            for path, table in table_by_name.items()
        }
        keys_and_values_by_key.append(
            [(path, value) for path, value in value_by_key.items() if value is not None]
        )
    given_keys_and_values = [
        keys_and_values for keys_and_values in keys_and_values_by_key if keys_and_values
    ]
    nonzero_keys_and_values = [
        keys_and_values
        for keys_and_values in given_keys_and_values
        if any(np.any(np.asarray(value, dtype=object) != 0) for _, value in keys_and_values)
    ]
    return (nonzero_keys_and_values or given_keys_and_values or [[]])[0]


# --- numbers of rules -----------------------------------------------------------------------------


def _side_length_if_longest(side_length: float, scene: Scene) -> float | None:
    """Return a plate's side length [m] if no side is longer, else None.

    Used to remark on the longest side alone.
    """
    geometry_table = scene.geometry
    return (
        side_length
        if side_length == max(geometry_table.width or 0.0, geometry_table.height or 0.0)
        else None
    )


def _length_over_side(length: float, side: float | None) -> float | None:
    """Return a crack's length or depth divided by a side of the body.

    None if ``side`` is None, as the scene does not give it.
    """
    return None if side is None else length / side


def _shorter_side(scene: Scene) -> float:
    """Return the shorter side of a plate [m]; inf without sides."""
    sides = scene.geometry.width, scene.geometry.height
    return min((side for side in sides if side is not None), default=math.inf)


def _thickness_over_shorter_side(thickness: float, scene: Scene) -> float | None:
    """Return a thickness divided by the shorter side in the plane.

    None for a plate 1 m thick, the usual thickness of plane problems, and for a disk of plates.
    """
    is_thickness_irrelevant = scene.geometry.kind == "plate" and (
        thickness == 1.0 or scene.disk is not None
    )
    return None if is_thickness_irrelevant else thickness / _shorter_side(scene)


def _relative_distance_and_node_text(
    load_point: object, scene: Scene, structure: Structure
) -> tuple[float, str] | None:
    """Return distance and position of the node nearest to the load's point (collective).

    Returns
    -------
    (float, str) or None
        Distance divided by the mesh's longest extent, and the node's position as text. None

        - if the load acts inside a cell, between nodes;
        - if the structure has no nodes;
        - if the scene has neither a part file (``geometry.file``) nor given matrices.
    """
    if structure.nodes is None or (scene.structure is None and scene.geometry.file is None):
        return None
    if scene.structure is None:
        from fenics_crack.fem.loads import nodal_force_fractions  # DOLFINx

        force_fractions = nodal_force_fractions(
            scene,
            structure.nodes.dolfinx_mesh_and_dofs,
            "excitation.point",
            load_point,  # type: ignore[arg-type]
        )
        if structure.comm.allreduce(np.count_nonzero(force_fractions)) > 1:  # nodes of a cell
            return None
    points = gather_rows(structure.comm, structure.nodes.points)
    node_distances_from_load_point = np.linalg.norm(points - load_point, axis=1)
    nearest_index = int(np.argmin(node_distances_from_load_point))
    longest_mesh_extent, nearest_point = np.ptp(points, axis=0).max(), points[nearest_index]
    return node_distances_from_load_point[nearest_index] / longest_mesh_extent, format_point(
        nearest_point
    )


def _blade_tip_speed(speed_value: float, scene: Scene, structure: Structure) -> float | None:
    """Return the speed of the node farthest from the rotor's axis [m/s] (collective).

    None without rotation or nodes, or for a hub radius above 20 m. Also None if ``speed_value`` is
    not the value that sets the rotor's speed: ``rotation.rpm``, or without it ``rotation.speed``.
    """
    rotation_table = scene.rotation
    if (
        rotation_table is None
        or structure.nodes is None
        or speed_value != (rotation_table.rpm or rotation_table.speed)
        or (rotation_table.hub_radius or 0.0) > MAX_PLAUSIBLE_LENGTH
    ):
        return None
    axis_point, axis_direction = (
        axis_point_or_direction[: structure.nodes.points.shape[1]]
        for axis_point_or_direction in scene.axis_point_and_direction
    )
    node_offsets_from_axis_point = gather_rows(structure.comm, structure.nodes.points) - axis_point
    node_offsets_normal_to_axis = node_offsets_from_axis_point - np.outer(
        node_offsets_from_axis_point @ axis_direction, axis_direction
    )
    return scene.speed * float(np.linalg.norm(node_offsets_normal_to_axis, axis=1).max())


def _clamp_height_ratio_and_height(
    _: float, scene: Scene, structure: Structure
) -> tuple[float, float] | None:
    """Return the height y at which a mesh from a file is clamped (collective).

    y is the coordinate of the clamped node farthest from y = 0.

    Returns
    -------
    (float, float) or None
        |y| divided by the mesh's longest extent, and y [m]. None if the mesh is not from a file.
    """
    nodes = structure.nodes
    if scene.mesh is None or scene.mesh.layout != "file" or nodes is None:
        return None
    points, node_dofs = (
        gather_rows(structure.comm, local_points_or_dofs)
        for local_points_or_dofs in (nodes.points, nodes.dofs)
    )
    clamp_heights = points[np.all(node_dofs < 0, axis=1), 1]
    farthest_clamp_node_height = (
        float(clamp_heights[np.abs(clamp_heights).argmax()]) if len(clamp_heights) else 0.0
    )
    return abs(farthest_clamp_node_height) / float(
        np.ptp(points, axis=0).max()
    ), farthest_clamp_node_height


def _clamp_bending_ratio_and_stress(
    _: object, scene: Scene, structure: Structure
) -> tuple[float, float] | None:
    """Return the bending stress in a solid's clamp by an eccentric axis (collective).

    The centrifugal force bends a blade if the rotor axis passes beside the clamp's centre. The
    clamp counts as a rectangle.

    Returns
    -------
    (float, float) or None
        Bending stress divided by the direct stress of the centrifugal force; and the bending stress
        [MPa]. None for plates and disks, and without rotation or clamp.
    """
    nodes, rotor_rotation, clamp = structure.nodes, structure.rotation, structure.clamp
    if (
        nodes is None
        or rotor_rotation is None
        or clamp is None
        or scene.dimension == 2
        or scene.disk
    ):
        return None
    is_clamped, (axis_point, axis_direction) = (
        np.all(nodes.dofs < 0, axis=1),
        scene.axis_point_and_direction,
    )
    clamp_side_lengths = np.ptp(gather_rows(structure.comm, nodes.points[is_clamped]), axis=0)
    clamp_normal_axis_index = int(clamp_side_lengths.argmin())
    free_dofs = nodes.dofs[~is_clamped] - structure.first_dof
    clamp_offset_from_axis = (np.eye(3) - np.outer(axis_direction, axis_direction)) @ (
        clamp.center - axis_point
    )
    in_plane_clamp_offset_from_axis = np.where(
        np.arange(3) == clamp_normal_axis_index, 0.0, clamp_offset_from_axis
    )
    force_and_moment_on_rank = [
        rotor_rotation.force[free_dofs].sum(axis=0),
        (clamp.inertia[3:, free_dofs] @ in_plane_clamp_offset_from_axis).sum(axis=1),
    ]
    centrifugal_clamp_force, centrifugal_clamp_moment = (
        rotor_rotation.speed** 2 * structure.sum_over_ranks(np.stack(force_and_moment_on_rank))
    )
    first_clamp_side_length, second_clamp_side_length = np.delete(
        clamp_side_lengths, clamp_normal_axis_index
    )
    bending_stress_times_area = 6.0 * (
        np.abs(np.delete(centrifugal_clamp_moment, clamp_normal_axis_index))
        @ [1.0 / second_clamp_side_length, 1.0 / first_clamp_side_length]
    )
    return bending_stress_times_area / float(
        np.linalg.norm(centrifugal_clamp_force)
    ), 1e-6 * bending_stress_times_area / (first_clamp_side_length * second_clamp_side_length)


def _largest_coriolis_change(_: float, scene: Scene, structure: Structure) -> float | None:
    """Return the largest relative frequency change by the Coriolis force in a solid.

    The lowest 4 modes are examined. None for plates and disks, and without rotation.
    """
    if scene.rotation is None or structure.rotation is None or scene.dimension == 2 or scene.disk:
        return None
    angular_velocity = structure.rotation.speed * scene.axis_point_and_direction[1]
    modes = solve_modes(structure, min(N_KEY_FIGURE_MODES, structure.n_modes))
    return float(np.abs(relative_coriolis_shifts(modes, angular_velocity)).max())


def describe_coriolis(relative_changes: np.ndarray) -> str:
    """Describe the Coriolis force's effect in words; "" if at most 1 %.

    ``relative_changes`` (m,) are those of the m lowest natural frequencies. The largest absolute
    value counts.
    """
    largest_change = np.abs(relative_changes).max()
    return (
        ""
        if largest_change <= MIN_REPORTED_CORIOLIS_CHANGE
        else CORIOLIS_REMARK_TEMPLATE.format(largest_change)
    )


def _count_rigid_pairs_with_mass(_: str, scene: Scene, structure: Structure) -> float | None:
    """Return the number of contact pairs, if contact is rigid and crack faces have mass.

    None if the contact law is not rigid, or if the crack faces have no mass.
    """
    reduction, contact_table = modal_reduction_or_none(scene, structure), scene.contact
    has_massless_faces = reduction is not None and reduction.method == "massless"
    return (
        None
        if has_massless_faces or contact_table is None or contact_table.law != "unilateral"
        else structure.n_pairs
    )


def _compare_frequency_in_other_unit(
    other_unit_factor: float, _: float, scene: Scene, key_figures: PreSolutionKeyFigures
) -> tuple[float, ...] | None:
    """Return three numbers if the load frequency seems to be in another unit, else None.

    The unit is doubtful if both conditions hold:

    - The load frequency is not within 10 % of a natural frequency.
    - ``other_unit_factor`` times the load frequency is within 10 % of the first natural frequency,
      with open or bonded crack.

    The second argument is the value of the key; it is not used.

    Returns
    -------
    frequency_ratio : float
        Load frequency divided by the first natural frequency with open crack.
    first_frequency_hz, first_omega : float [Hz], [rad/s]
        This natural frequency in both units.
    """
    first_omega, omega = float(key_figures.omega_open[0]), scene.excitation.omega
    natural_omegas = np.concatenate([key_figures.omega_open, key_figures.omega_tied])
    first_omegas = natural_omegas[[0, len(key_figures.omega_open)]]
    is_other_unit = not _is_near_natural_frequency(
        omega, natural_omegas
    ) and _is_near_natural_frequency(other_unit_factor * omega, first_omegas)
    return (
        (omega / first_omega, first_omega / RAD_PER_TURN, first_omega)
        if is_other_unit and first_omega > 0.0
        else None
    )


def _is_near_natural_frequency(omega: float, natural_omegas: np.ndarray) -> bool:
    """Return True if ``omega`` is within 10 % of any natural frequency (both [rad/s])."""
    return bool(np.any(np.abs(natural_omegas - omega) < 0.1 * natural_omegas))


def _missed_first_omega_and_text(
    _: float, scene: Scene, key_figures: PreSolutionKeyFigures
) -> tuple[float, str] | None:
    """Return the first natural frequency if a curve meets no resonance.

    Resonances are expected between the open and the bonded frequency of each of the first modes. A
    curve meets a resonance if its load frequency, or 1/2, 2 or 3 times its load frequency, lies
    there. The first argument is the value of the key; it is not used.

    Returns
    -------
    (float, str) or None
        Frequency [rad/s] with open crack, and a text with the curve's end and a proposed range.
        None if the curve meets a resonance or ends above the modes computed. Also None if its
        parameter is neither frequency nor rotor speed.
    """
    curve_table = scene.curve
    if curve_table is None or curve_table.parameter not in FACTOR_AND_UNIT_BY_CURVE_PARAMETER:
        return None
    find_crossing_parameters = np.vectorize(
        partial(
            curve_parameter_at_crossing,
            scene,
            curve_table.parameter,
            slope=key_figures.squared_omega_slopes[0],
        )
    )
    curve_start, curve_end = sorted(curve_table.parameter_and_range[1:])
    open_and_bonded_omegas = key_figures.omega_open, key_figures.omega_tied
    for harmonic in (0.5, 1.0, 2.0, 3.0):
        curve_values_at_open_omegas, curve_values_at_bonded_omegas = (
            find_crossing_parameters(omega, harmonic=harmonic) for omega in open_and_bonded_omegas
        )
        if np.any(
            (curve_start <= curve_values_at_bonded_omegas)
            & (curve_end >= curve_values_at_open_omegas)
        ):
            return None
    # Modes above the last one are not computed.
    if curve_end >= find_crossing_parameters(key_figures.omega_tied[-1], harmonic=1.0):
        return None
    proposed_curve_table = propose_curve_or_none(scene, key_figures)
    unit = FACTOR_AND_UNIT_BY_CURVE_PARAMETER[curve_table.parameter][1]
    first_omega_range = key_figures.omega_open[0], key_figures.omega_tied[0]
    first_omega_range_text = format_in_unit(
        choose_frequency_factor_name_unit(True), *first_omega_range
    )
    end_and_range_text = (
        f"{curve_table.stop:g} {unit}: the first resonance is between {first_omega_range_text}"
    )
    if proposed_curve_table is not None:
        end_and_range_text += (
            f"; give curve.start = {proposed_curve_table.start:g} and "
            f"curve.stop = {proposed_curve_table.stop:g}"
        )
    return float(first_omega_range[0]), end_and_range_text


def _peak_rotation_and_displacement(
    _: object, scene: Scene, key_figures: PreSolutionKeyFigures
) -> tuple[float, float] | None:
    """Return the largest rotation [rad] and displacement [m] under the excitation's force.

    The crack is open. The maximum is over the load frequencies that the scene asks for. None if the
    scene has other loads, or no damping.
    """
    has_other_loads_or_no_damping = scene.has_other_loads or key_figures.damping_ratios.min() == 0.0
    return (
        None
        if has_other_loads_or_no_damping
        else (key_figures.peak_open_rotation_about_clamp, key_figures.peak_open_crack_displacement)
    )


def _n_face_elements_if_remark_helps(
    _: object, scene: Scene, key_figures: PreSolutionKeyFigures
) -> int | None:
    """Return the smallest number of elements along a crack face, or None.

    A remark on the number would not help in two cases, which give None. In a grid without
    ``mesh.patches`` the numbers of columns and rows set the element length. With
    ``contact.pairs = "mouth"`` contact acts at the crack's mouth alone.
    """
    has_mouth_contact_only = scene.contact is not None and scene.contact.pairs == "mouth"
    is_grid_without_patches = scene.mesh.layout == "grid" and scene.mesh.patches is None
    return (
        None
        if has_mouth_contact_only or is_grid_without_patches
        else key_figures.n_elements_along_face
    )


def _linear_gap_motion_and_verb(
    _: object, scene: Scene, key_figures: PreSolutionKeyFigures
) -> tuple[float, str] | None:
    """Return the gaps' largest motion if no contact pair opens and closes.

    The response is then linear, as a remark says. The first argument is the value of the key; it is
    not used.

    Returns
    -------
    (float, str) or None
        Motion [m], and the verb for the remark "the crack never ...": "opens" or "closes". None if
        a pair opens and closes. Also None without contact, and for given matrices.
    """
    if scene.contact is None or scene.structure is not None or key_figures.breathes:
        return None
    return (
        key_figures.peak_open_crack_gap_motion,
        "opens" if key_figures.n_pairs_closed_by_mean_load else "closes",
    )


# --- tables of remarks ----------------------------------------------------------------------------

METRES_BY_MISTAKEN_UNIT = MappingProxyType({"mm": 1e-3})
LARGE_ROTOR_REMARK = "in m, this is larger than any rotor"
USUAL_METAL_DAMPING_REMARK = "metals have 0.0001 to 0.01 of critical damping"
FORCE_AMPLITUDE_KEYS_TEXT = "excitation.force_sin excitation.force_cos"
CONTACT_STIFFNESS_KEYS_TEXT = "contact.stiffness contact.stiffness_per_area"
FREQUENCY_UNIT_REMARK_TEMPLATE = (
    "{:.2g} times the first natural frequency, {:.4g} Hz = {:.4g} rad/s; is it in "
)
SCENE_REMARK_RULES = (
    RemarkRule(
        "material.young",
        1e7,
        1.5e12,
        "in Pa, steel has 2.1e11, and most solids have 1e7 to 1.5e12",
        factor_by_mistyped_unit={"GPa": 1e9, "MPa": 1e6},
    ),
    RemarkRule(
        "material.density",
        50.0,
        25000.0,
        "in kg/m^3, steel has 7850, and most solids have 50 to 25000",
        factor_by_mistyped_unit={"g/cm^3": 1e3, "t/mm^3": 1e12, "kg/mm^3": 1e9},
    ),
    RemarkRule("material.poisson", 0.0, 0.49, "most solids have 0 to 0.49, steel 0.3"),
    *(
        RemarkRule(
            f"geometry.{side}",
            0.0,
            MAX_PLAUSIBLE_LENGTH,
            "lengths are in m: the longest side of the {kind} is {:g} m",
            _side_length_if_longest,
            METRES_BY_MISTAKEN_UNIT,
        )
        for side in ("width", "height")
    ),
    RemarkRule(
        "geometry.thickness",
        0.0,
        1.0,
        "thicker than the {kind} is wide or high",
        _thickness_over_shorter_side,
        METRES_BY_MISTAKEN_UNIT,
    ),
    RemarkRule(
        "crack.length",
        0.01,
        0.9,
        "{:.3g} of the {kind}'s width; 0.01 to 0.9 are usual",
        lambda length, scene: _length_over_side(length, scene.geometry.width),
    ),
    RemarkRule(
        "crack.depth",
        0.01,
        0.9,
        "{:.3g} of the {kind}'s thickness; 0.01 to 0.9 are usual",
        lambda depth, scene: _length_over_side(depth, scene.geometry.thickness),
    ),
    RemarkRule(
        "mesh.size",
        0.0,
        1.0,
        "elements are longer than the {kind}'s shorter side",
        lambda size, scene: size / _shorter_side(scene),
        METRES_BY_MISTAKEN_UNIT,
    ),
    RemarkRule(
        "rotation.hub_radius",
        0.0,
        MAX_PLAUSIBLE_LENGTH,
        LARGE_ROTOR_REMARK,
        factor_by_mistyped_unit=METRES_BY_MISTAKEN_UNIT,
    ),
    RemarkRule(
        "tip_timing.tip_radius",
        0.0,
        MAX_PLAUSIBLE_LENGTH,
        LARGE_ROTOR_REMARK,
        factor_by_mistyped_unit=METRES_BY_MISTAKEN_UNIT,
    ),
    RemarkRule(
        "tip_timing.probes",
        RAD_PER_TURN,
        math.inf,
        "all probes lie within {:.3g} degrees; are they in rad? then give degrees",
        lambda angles, _: np.ptp(angles) or None,
    ),
    RemarkRule(
        "damping.ratio damping.ratios",
        1e-6,
        MAX_PLAUSIBLE_DAMPING,
        USUAL_METAL_DAMPING_REMARK,
        factor_by_mistyped_unit={"%": 1e-2},
    ),
    RemarkRule("contact.friction", 0.0, 2.0, "dry metals have coefficients of 0.1 to 1"),
    RemarkRule(
        "growth.rate",
        1e-20,
        1e-9,
        "in m per cycle at 1 MPa m^0.5, steels have 5e-12 to 1.4e-10",
        factor_by_mistyped_unit={"mm per cycle": 1e-3},
    ),
    RemarkRule(
        "excitation.wave",
        0.0,
        0.0,
        "{1} harmonics leave out {0:.2%} of the time-varying load (root mean square); "
        "raise excitation.wave_harmonics",
        lambda _, scene: (
            fit_load_wave_harmonics_and_residual(scene.excitation, scene.dimension)[1],
            scene.excitation.wave_harmonics,
        ),
    ),
    RemarkRule(
        FORCE_AMPLITUDE_KEYS_TEXT,
        1.0,
        1.0,
        "no force acts: excitation.force_sin, force_cos and force_mean are zero; give one of them",
        lambda _, scene: scene.has_other_loads or bool(scene.excitation.first_force_key),
    ),
    RemarkRule(
        "output.quantities",
        0.0,
        0.0,
        "left out without a crack: {1}",
        lambda _, scene: (len(e := list_dropped_quantities(scene)), ", ".join(e)),
    ),
)
STRUCTURE_REMARK_RULES = (
    RemarkRule(
        "structure.model mesh.file",
        0.0,
        MAX_PLAUSIBLE_LENGTH,
        "the structure measures {1:.3g} m x {0:.3g} m; is the mesh in mm? lengths are in m",
        lambda _, __, structure: (max(e := mesh_extents(structure)), min(e)),
    ),
    RemarkRule(
        "excitation.point",
        0.0,
        RELATIVE_POSITION_TOLERANCE,
        "no node is at this point: the force acts on the nearest node, at {1}",
        _relative_distance_and_node_text,
    ),
    RemarkRule(
        "rotation.speed",
        0.0,
        MAX_PLAUSIBLE_TIP_SPEED,
        FAST_TIP_REMARK_TEMPLATE,
        _blade_tip_speed,
        {"rpm": RAD_PER_S_PER_RPM},
    ),
    RemarkRule(
        "rotation.rpm", 0.0, MAX_PLAUSIBLE_TIP_SPEED, FAST_TIP_REMARK_TEMPLATE, _blade_tip_speed
    ),
    RemarkRule(
        "rotation.hub_radius",
        0.0,
        0.01,
        "the hub radius is measured to a clamp at y = 0; the mesh has its clamp at "
        "y = {1:.4g} m: move the mesh, or give rotation.axis and rotation.center",
        _clamp_height_ratio_and_height,
    ),
    RemarkRule(
        "rotation.hub_radius rotation.center",
        0.0,
        0.2,
        "the rotor axis is not below the middle of the clamp: the centrifugal force bends the "
        "blade, by about {1:.3g} MPa at the clamp, {0:.2g} times its tensile stress there",
        _clamp_bending_ratio_and_stress,
    ),
)
KEY_FIGURE_REMARK_RULES = (
    RemarkRule(
        "excitation.omega",
        1.0,
        0.0,
        FREQUENCY_UNIT_REMARK_TEMPLATE + "Hz? then use excitation.frequency",
        partial(_compare_frequency_in_other_unit, RAD_PER_TURN),
    ),
    RemarkRule(
        "excitation.frequency",
        1.0,
        0.0,
        FREQUENCY_UNIT_REMARK_TEMPLATE + "rad/s? then use excitation.omega",
        partial(_compare_frequency_in_other_unit, 1.0 / RAD_PER_TURN),
    ),
    RemarkRule(
        "curve.start",
        1.0,
        0.0,
        "the curve has no resonance between this start and {1}",
        _missed_first_omega_and_text,
    ),
    RemarkRule(
        FORCE_AMPLITUDE_KEYS_TEXT,
        0.0,
        MAX_SMALL_ROTATION,
        "with an open crack this force moves the {kind} by {1:.2g} m, or {0:.2g} "
        "rad about the clamp: beyond small displacements; is the force in N?",
        _peak_rotation_and_displacement,
    ),
    RemarkRule(
        "mesh.patches mesh.lip_elements mesh.file",
        4,
        math.inf,
        "elements or patches are longer than a quarter of the crack; use 4 to 20 along each face",
        _n_face_elements_if_remark_helps,
    ),
    RemarkRule(
        CONTACT_STIFFNESS_KEYS_TEXT,
        1.0,
        math.inf,
        "at most {:.2g} times the {faces}' static stiffness, so that they penetrate each other; "
        "100 to 10000 times is usual; or use contact.law = 'unilateral'",
        lambda _, __, figures: np.max(figures.contact_stiffness_ratio),
    ),
    RemarkRule(
        CONTACT_STIFFNESS_KEYS_TEXT,
        0.0,
        1e6,
        "at least {:.2g} times the {faces}' static stiffness: numerically "
        "rigid, and hard to solve; use contact.law = 'unilateral' for rigid contact",
        lambda _, __, figures: np.min(figures.contact_stiffness_ratio),
    ),
    RemarkRule(
        "contact.sharpness",
        10.0,
        math.inf,
        "the law is rounded over {1:.2g} m, and the {faces} "
        "move by {2:.2g} m: contact acts on open {faces}; raise contact.sharpness",
        lambda k, _, figures: (
            k * figures.peak_open_crack_gap_motion,
            1.0 / k,
            figures.peak_open_crack_gap_motion,
        ),
    ),
    RemarkRule(
        "crack.clearance excitation.force_mean rotation.rpm rotation.speed",
        0.0,
        0.0,
        "the crack never {1}: the load moves open crack faces by {0:.2g} m at most; the response "
        "is linear",
        _linear_gap_motion_and_verb,
    ),
    RemarkRule(
        "damping.mass damping.stiffness",
        0.0,
        MAX_PLAUSIBLE_DAMPING,
        "the damping ratio at the first natural frequency is {:.3g}; " + USUAL_METAL_DAMPING_REMARK,
        lambda _, __, figures: float(figures.damping_ratios[0]),
    ),
    RemarkRule(
        "harmonic_balance.harmonics",
        0,
        0,
        "the harmonics reach the frequencies of {1} modes, but {2} modes are kept: raise {3}",
        lambda _, scene, figures: (
            max(figures.n_modes_below_highest_harmonic - figures.n_kept_modes, 0),
            figures.n_modes_below_highest_harmonic,
            figures.n_kept_modes,
            scene.modes_key,
        ),
    ),
)
METHOD_REMARK_RULES = (
    RemarkRule(
        "rotation.rpm rotation.speed",
        0.0,
        MIN_REPORTED_CORIOLIS_CHANGE,
        CORIOLIS_REMARK_TEMPLATE,
        _largest_coriolis_change,
    ),
    RemarkRule(
        "contact.law",
        0.0,
        0.0,
        "rigid contact of crack faces with mass: solve gives no verdict on stability, "
        "and curve is refused; use 'penalty', 'smoothed', or reduction.method = 'massless'",
        _count_rigid_pairs_with_mass,
    ),
)
