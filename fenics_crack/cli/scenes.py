"""The command ``check``, which solves nothing, and remarks on harmonics without damping."""

from __future__ import annotations

import itertools
import math
from argparse import Namespace
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fenics_crack.balance.problem import check_memory
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    Table,
    format_count,
    format_percent,
    format_range,
)
from fenics_crack.cli.given import CommandInputs, Console
from fenics_crack.errors.stated import estimate_frequency_mesh_errors
from fenics_crack.errors.verification import Verification
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.modes import damped_count_and_max_omega_or_none
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene, list_requested_extra_quantities, missing_table_error
from fenics_crack.scene.words import word_for_crack_faces
from fenics_crack.study.plausibility import (
    FACTOR_AND_UNIT_BY_CURVE_PARAMETER,
    KeyFigures,
    find_key_figures,
    highest_harmonic_omega,
    is_response_proportional_to_load,
    propose_curve_or_none,
    remarks_on_scene,
)
from fenics_crack.study.prepare import (
    Study,
    estimate_and_check_memory,
    modal_reduction_or_none,
    prepare,
    release_freed_memory,
)
from fenics_crack.study.resonance import find_study_resonance
from fenics_crack.study.sharing import STRUCTURE_FILES
from fenics_crack.study.solve import candidate_mode_counts


def compute_and_print_key_figures(_: Namespace, inputs: CommandInputs, console: Console) -> None:
    """Run the command ``check``: mesh a scene, and print key figures.

    Key figures are sizes, natural frequencies, the resonance at the load, contact, and memory;
    remarks follow. Raises InputError if the memory does not suffice.
    """
    scene = inputs.scene
    with console.report_stage("mesh and matrices"):
        study = prepare(scene, console.comm, whole=True)
        if list_requested_extra_quantities(scene):  # which may be refused
            from fenics_crack.study.observer import make_requested_rows_and_readers  # the solver

            make_requested_rows_and_readers(study)
    structure, n_harmonics = study.structure, scene.harmonic_balance.harmonics
    check_memory(structure, n_harmonics)
    is_run_up = scene.curve is not None and scene.curve.parameter_and_range[0] == "speed"
    release_freed_memory()
    memory_bytes = estimate_and_check_memory(scene, structure, is_run_up=is_run_up)
    with console.report_stage("natural frequencies"):
        key_figures = find_key_figures(study)
    with console.report_stage("resonance at the load"):
        load_resonance = find_study_resonance(
            study, key_figures.omega_bilinear, key_figures.squared_omega_slopes
        )
    with console.report_stage("errors due to the mesh"):
        bonded_omega_by_kind = {"tied": key_figures.omega_tied} if structure.n_pairs else {}
        omega_by_kind = {"open": key_figures.omega_open} | bonded_omega_by_kind
        mesh_errors = estimate_frequency_mesh_errors(
            study, omega_by_kind, load_resonance, key_figures.squared_omega_slopes
        )
        vibration_mesh_error = (
            0.0 if scene.structure is not None else mesh_errors.stated("vibration")[0]
        )
        key_figures = replace(
            key_figures, load_resonance=replace(load_resonance, mesh_error=vibration_mesh_error)
        )
    values_by_label: dict[str, object] = {
        **({} if structure.nodes is None else _extents_by_label(key_figures)),
        **_cad_part_texts_by_label(scene, structure),
        "degrees of freedom": structure.n_dofs,
        **_frequencies_by_label(study.scene, key_figures),
        **_mesh_error_texts_by_label(mesh_errors),
        **_resonance_values_by_label(study.scene, key_figures),
        **_rotation_values_by_label(study.scene, key_figures),
        **_crack_and_contact_values_by_label(study, key_figures),
        "harmonics": format_harmonic_count(scene),
        "unknowns of harmonic balance": (2 * n_harmonics + 1) * structure.n_pairs,
        "reduction": _describe_reduction(study),
        "memory, estimated [GiB]": round(memory_bytes / 2**30, 2),
    }
    if scene.curve is not None:
        range_text = f"{scene.curve.start:g} to {scene.curve.stop:g}"
        values_by_label["curve"] = f"{scene.curve.parameter} from {range_text}"
    if (proposed_curve_table := propose_curve_or_none(study.scene, key_figures)) is not None:
        unit = FACTOR_AND_UNIT_BY_CURVE_PARAMETER[proposed_curve_table.parameter][1]
        values_by_label["proposed curve.parameter"] = proposed_curve_table.parameter
        values_by_label[f"proposed curve.start [{unit}]"] = proposed_curve_table.start
        values_by_label[f"proposed curve.stop [{unit}]"] = proposed_curve_table.stop
    if scene.sweep is not None:
        values_by_label["sweep"] = " x ".join(
            f"{len(axis.values)} {axis.key}" for axis in scene.sweep.over
        )
        values_by_label["cases of the sweep"] = scene.sweep.n_cases
        values_by_label["invalid cases"] = on_root(
            console.comm, lambda: _describe_invalid_cases(scene)
        )
    damping_remark_text = _describe_undamped_after_reduction(
        scene, structure, highest_harmonic_omega(scene)
    )
    scene_remarks = remarks_on_scene(study.scene, structure, key_figures)
    for structure_file in STRUCTURE_FILES:
        structure_file.write_noted_structure(console.comm)
    console.print_table(Table(("what", "value"), [*values_by_label.items()]))
    console.print_notes(damping_remark_text)
    console.print_remarks(*scene_remarks)


def make_missing_curve_error(scene: Scene, console: Console) -> InputError:
    """Make the error of a scene without the table [curve] (collective).

    The error's example is a proposed curve through the resonance nearest to the load; empty if no
    curve can be proposed.
    """
    error = missing_table_error("curve", ", which this command needs")
    error.example = ""
    with console.report_stage("natural frequencies"), suppress(InputError):
        study = prepare(scene, console.comm, whole=True)
        if proposed_curve_table := propose_curve_or_none(study.scene, find_key_figures(study)):
            error.example = proposed_curve_table.as_toml()
    return error


def _extents_by_label(key_figures: KeyFigures) -> dict[str, object]:
    """Return the mesh's side lengths [m] in a text, by label: "width x height [m]"."""
    side_names = ("width", "height", "thickness")[: len(key_figures.mesh_extents)]
    return {
        " x ".join(side_names) + " [m]": " x ".join(
            f"{extent:g}" for extent in key_figures.mesh_extents
        )
    }


def _cad_part_texts_by_label(scene: Scene, structure: Structure) -> dict[str, str]:
    """Return texts about a CAD part's faces and crack fronts, by label.

    Empty for scenes without a CAD part.
    """
    if scene.geometry is None or scene.geometry.file is None:
        return {}
    from fenics_crack.fem.solid import part_text_by_name  # DOLFINx

    return part_text_by_name(scene, structure)


def _frequencies_by_label(scene: Scene, key_figures: KeyFigures) -> dict[str, object]:
    """Return natural frequencies and the load's frequency by printed label.

    Frequencies are in Hz and rad/s; the load's also over the first natural frequency, with the
    crack open and bonded.
    """
    faces_text = word_for_crack_faces(scene)
    frequencies_by_condition = {
        f", {faces_text} open": key_figures.omega_open,
        f", {faces_text} bonded": key_figures.omega_tied,
    }
    if key_figures.n_face_elements is None:
        frequencies_by_condition = {"": key_figures.omega_open}
    frequencies_by_condition = {
        condition_text: frequencies[np.isfinite(frequencies)]
        for condition_text, frequencies in frequencies_by_condition.items()
    }
    frequencies_by_condition = {
        condition_text: frequencies
        for condition_text, frequencies in frequencies_by_condition.items()
        if len(frequencies)
    }
    values_by_label: dict[str, object] = {}
    if key_figures.n_face_elements is not None and scene.structure is None and scene.dimension == 2:
        values_by_label["modes"] = (
            "in the plate's plane: no out-of-plane bending (flap), no torsion"
        )
    for condition_text, frequencies in frequencies_by_condition.items():
        values_by_label[f"first natural frequency{condition_text} [Hz]"] = (
            float(frequencies[0]) / RAD_PER_TURN
        )
        values_by_label[f"first natural frequency{condition_text} [rad/s]"] = float(frequencies[0])
        values_by_label[f"next natural frequencies{condition_text} [Hz]"] = ", ".join(
            f"{frequency / RAD_PER_TURN:.6g}" for frequency in frequencies[1:]
        )
    load_omega = scene.excitation.omega
    values_by_label["load frequency [Hz]"] = load_omega / RAD_PER_TURN
    values_by_label["load frequency [rad/s]"] = load_omega
    for condition_text, frequencies in frequencies_by_condition.items():
        if frequencies[0] > 0.0:
            values_by_label[f"load frequency / first natural frequency{condition_text}"] = (
                load_omega / float(frequencies[0])
            )
    return values_by_label


def _mesh_error_texts_by_label(mesh_errors: Verification) -> dict[str, str]:
    """Return the errors of frequencies due to the mesh as texts, by label.

    Empty for matrices; a text with the reason if the errors are unknown.
    """
    if mesh_errors.scene.structure is not None:
        return {}
    if mesh_errors.unknown:
        unknown_text = f"unknown: {mesh_errors.unknown['mesh']}"
        return {"error of natural frequencies due to the mesh": unknown_text}
    error_texts = [
        format_percent(mesh_errors.stated(name)[0])
        for name in mesh_errors.values
        if name.endswith("_1")
    ]
    values_by_label = {
        "error of first natural frequencies due to the mesh": " and ".join(error_texts)
    }
    if "resonance" in mesh_errors.values:
        resonance_error_text = format_percent(mesh_errors.stated("resonance")[0])
        values_by_label["error of the resonance at the load due to the mesh"] = resonance_error_text
    return values_by_label


def _resonance_values_by_label(scene: Scene, key_figures: KeyFigures) -> dict[str, object]:
    """Return the resonance at the load by printed label, or the reason if unknown.

    Under an engine order the resonance is a rotor speed. Without crack faces, the dict is empty.
    """
    load_resonance, engine_order = key_figures.load_resonance, scene.excitation.order
    if key_figures.n_face_elements is None:
        return {}
    label = "resonance at the load"
    if scene.contact is not None and scene.contact.friction:
        label += ", without friction"
    values_by_label: dict[str, object] = {}
    if math.isfinite(load_resonance.value) and (engine_order is None or scene.disk is not None):
        values_by_label[f"{label} [Hz]"] = load_resonance.value / RAD_PER_TURN
        values_by_label[f"{label} [rad/s]"] = load_resonance.value
    elif math.isfinite(load_resonance.value):
        label = f"rotor speed at which order {engine_order} meets the {label}"
        values_by_label[f"{label} [rad/s]"] = load_resonance.value
        values_by_label[f"{label} [rpm]"] = load_resonance.value / RAD_PER_S_PER_RPM
    is_not_proportional = (
        key_figures.n_closed_pairs
        or key_figures.opening_under_mean_load
        or not is_response_proportional_to_load(scene)
    )
    values_by_label["vibration at this resonance" if values_by_label else label] = (
        load_resonance.in_words
    )
    if not (is_not_proportional or load_resonance.unknown):
        values_by_label["vibration at this resonance"] = (
            f"{load_resonance.in_words}; proportional to the load"
        )
    return values_by_label


def _rotation_values_by_label(scene: Scene, key_figures: KeyFigures) -> dict[str, object]:
    """Return the values for a rotating structure as {label: value}; empty without rotation.

    The values are the rotor speed, and the crack opening due to centrifugal forces and mean load.
    """
    if scene.speed == 0.0:
        return {}
    values_by_label: dict[str, object] = {
        "rotor speed [rad/s]": scene.speed,
        "rotor speed [rpm]": scene.speed / RAD_PER_S_PER_RPM,
    }
    if key_figures.n_face_elements is not None:
        values_by_label["crack opening by rotation and mean load [m]"] = (
            key_figures.opening_under_mean_load
        )
    return values_by_label


def _crack_and_contact_values_by_label(study: Study, key_figures: KeyFigures) -> dict[str, object]:
    """Return crack lengths, contact law and static stiffness by printed label.

    Stiffnesses are [N/m] for each contact pair, lengths and openings [m]. Without contact, lengths
    and the number of pairs alone.
    """
    cracks_by_name = study.scene.crack_by_name
    contact_law = study.contact
    contact_table = study.scene.contact
    values_by_label: dict[str, object] = {}
    for crack_name, crack in cracks_by_name.items():
        if crack.length is not None:
            label = "crack length" if len(cracks_by_name) == 1 else f"{crack_name}, length"
            values_by_label[f"{label} [m]"] = crack.length
            if (plate_width := study.scene.geometry.width) is not None:
                values_by_label[f"{label} / width"] = crack.length / plate_width
    values_by_label["contact pairs"] = study.structure.n_pairs
    if contact_law is None or contact_table is None:
        return values_by_label
    values_by_label["contact law"] = contact_table.law
    if contact_table.layer_depth is not None:
        values_by_label["depth of the contact layer [m]"] = contact_table.layer_depth
        values_by_label["contact layer, share of the stiffness"] = contact_table.layer_share
    if contact_table.friction:
        values_by_label["coefficient of friction"] = contact_table.friction
    if not is_rigid(contact_law):
        pair_stiffness = np.broadcast_to(contact_law.stiffness, study.structure.n_pairs)
        values_by_label["contact stiffness, softest pair [N/m]"] = float(pair_stiffness.min())
        values_by_label["contact stiffness, stiffest pair [N/m]"] = float(pair_stiffness.max())
    faces_text = word_for_crack_faces(study.scene)
    static_stiffness_text = format_range(key_figures.face_stiffness, ".3g")
    values_by_label[f"static stiffness of the {faces_text}, each pair [N/m]"] = (
        static_stiffness_text
    )
    if key_figures.contact_stiffness_ratio is not None:
        values_by_label["contact stiffness / static stiffness"] = format_range(
            key_figures.contact_stiffness_ratio, ".3g"
        )
    values_by_label["static opening under the mean load [m]"] = key_figures.opening_under_mean_load
    values_by_label[f"static motion of the {faces_text} under the load's amplitude [m]"] = (
        key_figures.largest_static_gap_motion
    )
    return values_by_label


def format_harmonic_count(scene: Scene) -> int | str:
    """Return the number of harmonics; with a tolerance, "20 or more, until ..."."""
    balance_table = scene.harmonic_balance
    if balance_table.tolerance is None:
        return balance_table.harmonics
    return (
        f"{balance_table.harmonics} or more, until the error is below {balance_table.tolerance:g}"
    )


def _describe_reduction(study: Study) -> str:
    """Describe the reduction of a study in words: method and modes, or "none"."""
    scene = study.scene
    scene_reduction = modal_reduction_or_none(scene, study.structure)
    mode_counts = candidate_mode_counts(study)
    if scene_reduction is None:
        return "none"
    modes_text = format_count(scene_reduction.n_modes, "mode")
    if mode_counts:
        modes_text = f"{format_count(mode_counts[0], 'mode')} or more, until the error is below "
        modes_text += f"{scene.harmonic_balance.tolerance:g}"
    if scene_reduction.method == "massless":
        return f"massless, {modes_text}, {word_for_crack_faces(scene)} without mass"
    return f"{scene_reduction.method}, {modes_text}"


def _describe_invalid_cases(scene: Scene) -> str:
    """Return how many cases of a sweep are refused, and the reason for the first.

    Only the first 10,000 cases are checked, without a mesh.
    """
    from fenics_crack.sweep.plan import Plan  # gmsh

    sweep_plan = Plan(scene)
    checked_case_indices = [
        *itertools.islice(np.ndindex(*sweep_plan.shape), 10_000)
    ]  # others while they are run
    reason_texts = [
        case_or_reason
        for case_or_reason in map(sweep_plan.scene_or_reason_at, checked_case_indices)
        if isinstance(case_or_reason, str)
    ]
    scope_text = (
        f" of the first {len(checked_case_indices)}"
        if np.prod(sweep_plan.shape) > len(checked_case_indices)
        else ""
    )
    return f"{len(reason_texts)}{scope_text}" + (f": {reason_texts[0]}" if reason_texts else "")


# --- harmonics without damping --------------------------------------------------------------------


def describe_undamped_harmonics(structure: Structure, highest_omega: float) -> str:
    """Remark that harmonics lie above all damped modes (collective).

    ``highest_omega`` [rad/s] is the frequency of the highest harmonic. The text is empty if modes
    up to this frequency are damped, or without contact: only contact excites harmonics.
    """
    damped_modes_and_highest_omega = (
        damped_count_and_max_omega_or_none(structure) if structure.n_pairs else None
    )
    if damped_modes_and_highest_omega is None or highest_omega <= damped_modes_and_highest_omega[1]:
        return ""
    n_damped_modes, highest_damped_omega = damped_modes_and_highest_omega
    if n_damped_modes == 0:
        return (
            f"harmonics reach H w = {highest_omega:g} rad/s, but no mode is damped; set [damping]"
        )
    modes_text = "the damped mode" if n_damped_modes == 1 else f"the {n_damped_modes} damped modes"
    return (
        f"harmonics reach H w = {highest_omega:g} rad/s, beyond {modes_text} "
        f"({highest_damped_omega:g} rad/s); higher modes are not damped: raise damping.modes"
    )


def _describe_undamped_after_reduction(
    scene: Scene, structure: Structure, highest_omega: float
) -> str:
    """Remark that harmonics lie above all damped modes, after the scene's reduction (collective).

    A massless reduction damps all further modes by the last damping ratio of the scene: if this is
    above zero, the text is empty. Otherwise see :func:`describe_undamped_harmonics`.
    """
    scene_reduction = modal_reduction_or_none(scene, structure)
    damping_ratio = None if scene.damping is None else scene.damping.ratio
    if (
        scene_reduction is not None
        and scene_reduction.method == "massless"
        and damping_ratio is not None
    ):
        if np.ravel(damping_ratio)[-1] > 0.0:  # that of all further modes that are kept
            return ""
    return describe_undamped_harmonics(structure, highest_omega)
