"""The command ``check``: mesh a scene without solving, and print key figures."""

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
from fenics_crack.cli.account import describe_undamped_harmonics
from fenics_crack.cli.given import CommandInputs, Console
from fenics_crack.errors.stated import estimate_frequency_mesh_errors
from fenics_crack.errors.verification import Verification
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.structure import Structure
from fenics_crack.scene.keys import missing_table_error
from fenics_crack.scene.result_tables import Curve
from fenics_crack.scene.scene import Scene, list_requested_extra_quantities
from fenics_crack.scene.words import word_for_crack_faces
from fenics_crack.study.key_figures import (
    PreSolutionKeyFigures,
    find_key_figures,
    highest_harmonic_omega,
    is_response_proportional_to_load,
    propose_curve_or_none,
)
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.study.prepare import (
    Study,
    estimate_and_check_solution_memory,
    modal_reduction_or_none,
    prepare,
    release_freed_memory,
)
from fenics_crack.study.resonance import FACTOR_AND_UNIT_BY_CURVE_PARAMETER, find_study_resonance
from fenics_crack.study.sharing import CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST
from fenics_crack.study.solve import candidate_mode_counts


def compute_and_print_key_figures(_: Namespace, inputs: CommandInputs, console: Console) -> None:
    """Run the command ``check``: mesh a scene, and print key figures before any solution.

    Key figures are sizes, natural frequencies, the resonance at the load, contact, and memory;
    remarks follow. Raises InputError if the memory does not suffice.
    """
    scene = inputs.scene
    with console.report_stage("mesh and matrices"):
        study = prepare(scene, console.comm, whole=True)
        if list_requested_extra_quantities(scene):  # raises errors for impossible quantities
            from fenics_crack.study.observer import make_requested_rows_and_readers  # the solver

            make_requested_rows_and_readers(study)
    structure, n_harmonics = study.structure, scene.harmonic_balance.harmonics
    check_memory(structure, n_harmonics)
    is_run_up = scene.curve is not None and scene.curve.parameter_and_range[0] == "speed"
    release_freed_memory()
    memory_bytes = estimate_and_check_solution_memory(scene, structure, is_run_up=is_run_up)
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
        vibration_amplitude_mesh_error = (
            0.0 if scene.structure is not None else mesh_errors.stated("vibration")[0]
        )
        key_figures = replace(
            key_figures,
            load_resonance=replace(
                load_resonance, amplitude_mesh_error=vibration_amplitude_mesh_error
            ),
        )
    values_by_label: dict[str, object] = {
        **({} if structure.nodes is None else _mesh_extents_by_label(key_figures)),
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
        **_curve_values_by_label(scene.curve, propose_curve_or_none(study.scene, key_figures)),
        **_sweep_values_by_label(scene, console),
    }
    damping_remark_text = _describe_harmonics_left_undamped(
        scene, structure, highest_harmonic_omega(scene)
    )
    scene_remarks = remarks_on_scene(study.scene, structure, key_figures)
    rows_with_values = [
        (label, value) for label, value in values_by_label.items() if value is not None
    ]
    console.print_table(Table(("what", "value"), rows_with_values))
    console.print_notes(damping_remark_text)
    console.print_remarks(*scene_remarks)
    for structure_file in CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST:
        structure_file.write_noted_structure(console.comm)


def make_missing_curve_error(scene: Scene, console: Console) -> InputError:
    """Return the error for a scene without the table [curve] (collective).

    The error shows an example: a proposed curve through the resonance nearest to the load. The
    example is empty if no curve can be proposed.
    """
    error = missing_table_error("curve", ", which this command needs")
    error.example = ""
    with console.report_stage("natural frequencies"), suppress(InputError):
        study = prepare(scene, console.comm, whole=True)
        if proposed_curve_table := propose_curve_or_none(study.scene, find_key_figures(study)):
            error.example = proposed_curve_table.as_toml()
    return error


def _mesh_extents_by_label(key_figures: PreSolutionKeyFigures) -> dict[str, object]:
    """Return the side lengths of the mesh as a line to print.

    The dict has a single entry. In three dimensions the label is "width x height x thickness [m]",
    and the value "0.02 x 0.1 x 0.004".
    """
    side_names = ("width", "height", "thickness")[: len(key_figures.mesh_extents)]
    return {
        " x ".join(side_names) + " [m]": " x ".join(
            f"{extent:g}" for extent in key_figures.mesh_extents
        )
    }


def _cad_part_texts_by_label(scene: Scene, structure: Structure) -> dict[str, str]:
    """Return texts about a CAD part's faces and crack fronts, by printed label.

    The dict is empty for scenes without a CAD part.
    """
    if scene.geometry is None or scene.geometry.file is None:
        return {}
    from fenics_crack.fem.solid import describe_faces_cracks_and_fronts  # DOLFINx

    return describe_faces_cracks_and_fronts(scene, structure)


def _frequencies_by_label(scene: Scene, key_figures: PreSolutionKeyFigures) -> dict[str, object]:
    """Return natural frequencies and the load's frequency by printed label.

    Frequencies are in Hz and rad/s. Further values are the load frequency divided by the first
    natural frequency, with the crack open and bonded.
    """
    faces_text, load_omega = word_for_crack_faces(scene), scene.excitation.omega
    has_crack_faces = key_figures.n_elements_along_face is not None
    frequencies_by_condition = {"": key_figures.omega_open}
    if has_crack_faces:
        frequencies_by_condition = {
            f", {faces_text} open": key_figures.omega_open,
            f", {faces_text} bonded": key_figures.omega_tied,
        }
    values_by_label: dict[str, object] = {}
    if has_crack_faces and scene.structure is None and scene.dimension == 2:
        values_by_label["modes"] = (
            "in the plate's plane: no out-of-plane bending (flap), no torsion"
        )
    ratios_by_label: dict[str, object] = {}
    for condition_text, frequencies in frequencies_by_condition.items():
        if not np.isfinite(frequencies).any():
            continue
        first_natural_omega, *next_natural_omegas = frequencies[np.isfinite(frequencies)].tolist()
        values_by_label |= {
            f"first natural frequency{condition_text} [Hz]": first_natural_omega / RAD_PER_TURN,
            f"first natural frequency{condition_text} [rad/s]": first_natural_omega,
            f"next natural frequencies{condition_text} [Hz]": ", ".join(
                f"{next_natural_omega / RAD_PER_TURN:.6g}"
                for next_natural_omega in next_natural_omegas
            ),
        }
        ratios_by_label[f"load frequency / first natural frequency{condition_text}"] = (
            load_omega / first_natural_omega if first_natural_omega > 0.0 else None
        )
    load_frequencies_by_label = {
        "load frequency [Hz]": load_omega / RAD_PER_TURN,
        "load frequency [rad/s]": load_omega,
    }
    return values_by_label | load_frequencies_by_label | ratios_by_label


def _mesh_error_texts_by_label(mesh_errors: Verification) -> dict[str, str | None]:
    """Return errors due to the mesh as texts, by printed label.

    Errors are of the first natural frequencies, and of the resonance at the load. The resonance's
    error is None if no resonance is known. If the errors are unknown, the only text has the reason.
    For given matrices, without a mesh, the dict is empty.
    """
    if mesh_errors.scene.structure is not None:
        return {}
    if mesh_errors.unknown:
        unknown_text = f"unknown: {mesh_errors.unknown['mesh']}"
        return {"error of natural frequencies due to the mesh": unknown_text}
    error_text_by_name = {
        name: format_percent(mesh_errors.stated(name)[0]) for name in mesh_errors.values
    }
    return {
        "error of first natural frequencies due to the mesh": " and ".join(
            error_text for name, error_text in error_text_by_name.items() if name.endswith("_1")
        ),
        "error of the resonance at the load due to the mesh": error_text_by_name.get("resonance"),
    }


def _resonance_values_by_label(
    scene: Scene, key_figures: PreSolutionKeyFigures
) -> dict[str, object]:
    """Return the resonance at the load by printed label, or the reason if unknown.

    Under an engine order the resonance is a rotor speed. Without crack faces, the dict is empty.
    """
    load_resonance, engine_order = key_figures.load_resonance, scene.excitation.order
    if key_figures.n_elements_along_face is None:
        return {}
    label = "resonance at the load"
    if scene.contact is not None and scene.contact.friction:
        label += ", without friction"
    if not math.isfinite(load_resonance.value):
        return {label: load_resonance.amplitude_and_errors_text}
    if engine_order is None or scene.disk is not None:
        values_by_label: dict[str, object] = {
            f"{label} [Hz]": load_resonance.value / RAD_PER_TURN,
            f"{label} [rad/s]": load_resonance.value,
        }
    else:
        label = f"rotor speed at which order {engine_order} meets the {label}"
        values_by_label = {
            f"{label} [rad/s]": load_resonance.value,
            f"{label} [rpm]": load_resonance.value / RAD_PER_S_PER_RPM,
        }
    is_vibration_proportional_to_load = is_response_proportional_to_load(scene) and not (
        key_figures.n_pairs_closed_by_mean_load
        or key_figures.opening_under_mean_load
        or load_resonance.unknown
    )
    values_by_label["vibration at this resonance"] = load_resonance.amplitude_and_errors_text + (
        "; proportional to the load" if is_vibration_proportional_to_load else ""
    )
    return values_by_label


def _rotation_values_by_label(
    scene: Scene, key_figures: PreSolutionKeyFigures
) -> dict[str, object]:
    """Return values for a rotating structure by printed label; empty without rotation.

    The values are the rotor speed, and the crack opening due to centrifugal forces and mean load.
    Without crack faces, the opening is None.
    """
    if scene.speed == 0.0:
        return {}
    has_crack_faces = key_figures.n_elements_along_face is not None
    return {
        "rotor speed [rad/s]": scene.speed,
        "rotor speed [rpm]": scene.speed / RAD_PER_S_PER_RPM,
        "crack opening by rotation and mean load [m]": (
            key_figures.opening_under_mean_load if has_crack_faces else None
        ),
    }


def _crack_and_contact_values_by_label(
    study: Study, key_figures: PreSolutionKeyFigures
) -> dict[str, object]:
    """Return crack lengths, contact law and static stiffness by printed label.

    Stiffnesses [N/m] are for each contact pair. A rigid law has the contact stiffness None. Lengths
    and openings are in [m]. Without a contact law, only lengths and the number of pairs are
    returned.
    """
    cracks_by_name = study.scene.crack_by_name
    contact_law, contact_table = study.contact, study.scene.contact
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
    is_rigid_law, stiffness_ratio = is_rigid(contact_law), key_figures.contact_stiffness_ratio
    faces_text = word_for_crack_faces(study.scene)
    return values_by_label | {
        "contact law": contact_table.law,
        "depth of the contact layer [m]": contact_table.layer_depth,
        "contact layer, share of the stiffness": contact_table.layer_share,
        "coefficient of friction": contact_table.friction or None,
        "contact stiffness, softest pair [N/m]": (
            None if is_rigid_law else float(np.min(contact_law.stiffness))
        ),
        "contact stiffness, stiffest pair [N/m]": (
            None if is_rigid_law else float(np.max(contact_law.stiffness))
        ),
        f"static stiffness of the {faces_text}, each pair [N/m]": format_range(
            key_figures.face_stiffness_at_pairs, ".3g"
        ),
        "contact stiffness / static stiffness": (
            None if stiffness_ratio is None else format_range(stiffness_ratio, ".3g")
        ),
        "static opening under the mean load [m]": key_figures.opening_under_mean_load,
        f"static motion of the {faces_text} under the load's amplitude [m]": (
            key_figures.largest_static_gap_motion
        ),
    }


def _curve_values_by_label(
    curve_table: Curve | None, proposed_curve_table: Curve | None
) -> dict[str, object]:
    """Return the scene's curve and a proposed curve by printed label.

    ``curve_table`` is the scene's table [curve], or None. ``proposed_curve_table`` is a table
    proposed by the program, or None. The values are parameter, start and stop.
    """
    values_by_label: dict[str, object] = {}
    if curve_table is not None:
        range_text = f"{curve_table.start:g} to {curve_table.stop:g}"
        values_by_label["curve"] = f"{curve_table.parameter} from {range_text}"
    if proposed_curve_table is not None:
        unit = FACTOR_AND_UNIT_BY_CURVE_PARAMETER[proposed_curve_table.parameter][1]
        values_by_label |= {
            "proposed curve.parameter": proposed_curve_table.parameter,
            f"proposed curve.start [{unit}]": proposed_curve_table.start,
            f"proposed curve.stop [{unit}]": proposed_curve_table.stop,
        }
    return values_by_label


def _sweep_values_by_label(scene: Scene, console: Console) -> dict[str, object]:
    """Return values about the scene's sweep by printed label (collective).

    The values are the axes, the number of cases, and a text about invalid cases. The dict is empty
    without a sweep.
    """
    if scene.sweep is None:
        return {}
    return {
        "sweep": " x ".join(f"{len(axis.values)} {axis.key}" for axis in scene.sweep.over),
        "cases of the sweep": scene.sweep.n_cases,
        "invalid cases": on_root(console.comm, lambda: _describe_invalid_cases(scene)),
    }


def format_harmonic_count(scene: Scene) -> int | str:
    """Return the scene's number of harmonics, to print.

    If the scene has a tolerance, the number may grow. The text is then "20 or more, until the error
    is below ...".
    """
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
    mode_counts_to_try = candidate_mode_counts(study)
    if scene_reduction is None:
        return "none"
    modes_text = format_count(scene_reduction.n_modes, "mode")
    if mode_counts_to_try:
        modes_text = (
            f"{format_count(mode_counts_to_try[0], 'mode')} or more, until the error is below "
            f"{scene.harmonic_balance.tolerance:g}"
        )
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
        case_scene_or_refusal_reason
        for case_scene_or_refusal_reason in map(sweep_plan.scene_or_reason_at, checked_case_indices)
        if isinstance(case_scene_or_refusal_reason, str)
    ]
    scope_text = (
        f" of the first {len(checked_case_indices)}"
        if np.prod(sweep_plan.shape) > len(checked_case_indices)
        else ""
    )
    return f"{len(reason_texts)}{scope_text}" + (f": {reason_texts[0]}" if reason_texts else "")


def _describe_harmonics_left_undamped(
    scene: Scene, structure: Structure, highest_omega: float
) -> str:
    """Return a remark if the highest harmonic lies above all modes with damping (collective).

    Unlike :func:`describe_undamped_harmonics`, this counts modes damped after the reduction. The
    massless reduction gives all further modes the last damping ratio in the scene. If this ratio is
    above zero, all modes are damped, and the text is empty.

    Parameters
    ----------
    scene : Scene
        Scene with damping and reduction.
    structure : Structure
        Structure before the reduction.
    highest_omega : float [rad/s]
        Frequency of the highest harmonic.
    """
    scene_reduction = modal_reduction_or_none(scene, structure)
    scene_damping_ratios = None if scene.damping is None else scene.damping.ratio
    if (
        scene_reduction is not None
        and scene_reduction.method == "massless"
        and scene_damping_ratios is not None
        and np.ravel(scene_damping_ratios)[-1] > 0.0  # the last ratio damps all further modes
    ):
        return ""
    return describe_undamped_harmonics(structure, highest_omega)
