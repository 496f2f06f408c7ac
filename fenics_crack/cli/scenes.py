"""The command before anything is solved, ``check``, and the commands' remarks on damping."""

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
from fenics_crack.basics.tables import RPM, TURN, Table, counted, percent, ranging
from fenics_crack.cli.given import Console, Inputs
from fenics_crack.errors.stated import errors_of_natural
from fenics_crack.errors.verification import Verification
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.modes import damped_range
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene, asked_quantities
from fenics_crack.scene.words import faces_in_words
from fenics_crack.study.plausibility import (
    CURVE_UNIT_BY_PARAMETER,
    KeyFigures,
    find_key_figures,
    highest_harmonic_omega,
    propose_curve,
    remarks_on_scene,
    scales_with_load,
)
from fenics_crack.study.prepare import (
    Study,
    estimate_checked_memory,
    prepare,
    reduction_of,
    release_freed_memory,
)
from fenics_crack.study.resonance import find_study_resonance
from fenics_crack.study.sharing import STRUCTURE_FILES
from fenics_crack.study.solve import candidate_mode_counts


def check(_: Namespace, inputs: Inputs, console: Console) -> None:
    """Mesh and assemble a scene; print what it has, its first frequencies, and what is unusual."""
    scene = inputs.scene
    with console.stage("mesh and matrices"):
        study = prepare(scene, console.comm, whole=True)
        if asked_quantities(scene):  # which may be refused
            from fenics_crack.study.observer import make_requested_rows  # the solver

            make_requested_rows(study)
    whole, harmonics = study.structure, scene.harmonic_balance.harmonics
    check_memory(whole, harmonics)
    run_up = scene.curve is not None and scene.curve.followed[0] == "speed"
    release_freed_memory()
    memory = estimate_checked_memory(scene, whole, is_run_up=run_up)
    with console.stage("natural frequencies"):
        figures = find_key_figures(study)
    with console.stage("resonance at the load"):
        at_load = find_study_resonance(study, figures.omega_bilinear, figures.speed_slopes)
    with console.stage("errors due to the mesh"):
        tied = {"tied": figures.omega_tied} if whole.n_pairs else {}
        frequencies = {"open": figures.omega_open} | tied
        by_mesh = errors_of_natural(study, frequencies, at_load, figures.speed_slopes)
        mesh_error = 0.0 if scene.structure is not None else by_mesh.stated("vibration")[0]
        figures = replace(figures, load_resonance=replace(at_load, mesh_error=mesh_error))
    rows: dict[str, object] = {
        **({} if whole.nodes is None else _extents(figures)),
        **_part(scene, whole),
        "degrees of freedom": whole.n_dofs,
        **_frequencies(study.scene, figures),
        **_known_by_mesh(by_mesh),
        **_resonance(study.scene, figures),
        **_rotation(study.scene, figures),
        **_contact(study, figures),
        "harmonics": harmonics_in_words(scene),
        "unknowns of harmonic balance": (2 * harmonics + 1) * whole.n_pairs,
        "reduction": _reduction(study),
        "memory, estimated [GiB]": round(memory / 2**30, 2),
    }
    if scene.curve is not None:
        span = f"{scene.curve.start:g} to {scene.curve.stop:g}"
        rows["curve"] = f"{scene.curve.parameter} from {span}"
    if (curve := propose_curve(study.scene, figures)) is not None:
        rows["proposed curve.parameter"], unit = (
            curve.parameter,
            CURVE_UNIT_BY_PARAMETER[curve.parameter][1],
        )
        rows[f"proposed curve.start [{unit}]"] = curve.start
        rows[f"proposed curve.stop [{unit}]"] = curve.stop
    if scene.sweep is not None:
        rows["sweep"] = " x ".join(f"{len(axis.values)} {axis.key}" for axis in scene.sweep.over)
        rows["cases of the sweep"] = scene.sweep.n_cases
        rows["invalid cases"] = on_root(console.comm, lambda: _impossible(scene))
    remark = _remark_on_whole(scene, whole, highest_harmonic_omega(scene))
    remarks = remarks_on_scene(study.scene, whole, figures)
    for structure_file in STRUCTURE_FILES:
        structure_file.write_structure(console.comm)
    console.table(Table(("what", "value"), [*rows.items()]))
    console.note(remark)
    console.remark(*remarks)


def without_curve(scene: Scene, console: Console) -> InputError:
    """Return the error of a scene without a curve, with one through the resonance nearest to its
    load (collective)."""
    error = InputError("curve", None, "given for this command: a table")
    error.example = ""
    with console.stage("natural frequencies"), suppress(InputError):
        study = prepare(scene, console.comm, whole=True)
        if curve := propose_curve(study.scene, find_key_figures(study)):
            error.example = curve.as_toml()
    return error


def _extents(figures: KeyFigures) -> dict[str, object]:
    """The sizes of the mesh."""
    names = ("width", "height", "thickness")[: len(figures.extents)]
    return {" x ".join(names) + " [m]": " x ".join(f"{extent:g}" for extent in figures.extents)}


def _part(scene: Scene, whole: Structure) -> dict[str, str]:
    """Faces and crack fronts of a part from a CAD file."""
    if scene.geometry is None or scene.geometry.file is None:
        return {}
    from fenics_crack.fem.solid import describe_part  # DOLFINx

    return describe_part(scene, whole)


def _frequencies(scene: Scene, figures: KeyFigures) -> dict[str, object]:
    """The first natural frequencies, and the load's frequency over the first."""
    faces = faces_in_words(scene)
    lips = {f", {faces} open": figures.omega_open, f", {faces} bonded": figures.omega_tied}
    if figures.n_face_elements is None:
        lips = {"": figures.omega_open}
    lips = {words: natural[np.isfinite(natural)] for words, natural in lips.items()}
    lips = {words: natural for words, natural in lips.items() if len(natural)}
    rows: dict[str, object] = {}
    if figures.n_face_elements is not None and scene.structure is None and scene.dimension == 2:
        rows["modes"] = "in the plate's plane: no bending across it (flap), no torsion"
    for words, natural in lips.items():
        rows[f"first natural frequency{words} [Hz]"] = float(natural[0]) / TURN
        rows[f"first natural frequency{words} [rad/s]"] = float(natural[0])
        rows[f"the next{words} [Hz]"] = ", ".join(f"{value / TURN:.6g}" for value in natural[1:])
    omega = scene.excitation.omega
    rows["load's frequency [Hz]"] = omega / TURN
    rows["load's frequency [rad/s]"] = omega
    for words, natural in lips.items():
        if natural[0] > 0.0:
            rows[f"load's frequency / the first{words}"] = omega / float(natural[0])
    return rows


def _known_by_mesh(found: Verification) -> dict[str, str]:
    """The errors of these frequencies due to the mesh as a row; of matrices none."""
    if found.scene.structure is not None:
        return {}
    if found.unknown:
        return {"error of natural frequencies due to the mesh": f"unknown: {found.unknown['mesh']}"}
    ends = [percent(found.stated(name)[0]) for name in found.values if name.endswith("_1")]
    rows = {"error of first natural frequencies due to the mesh": " and ".join(ends)}
    if "resonance" in found.values:
        error = percent(found.stated("resonance")[0])
        rows["error of the resonance at the load due to the mesh"] = error
    return rows


def _resonance(scene: Scene, figures: KeyFigures) -> dict[str, object]:
    """The resonance at the scene's own load, or why it is not known."""
    found, order = figures.load_resonance, scene.excitation.order
    if figures.n_face_elements is None:
        return {}
    words = "resonance at the load"
    if scene.contact is not None and scene.contact.friction:
        words += ", without friction"
    rows: dict[str, object] = {}
    if math.isfinite(found.value) and (order is None or scene.disk is not None):
        rows[f"{words} [Hz]"], rows[f"{words} [rad/s]"] = found.value / TURN, found.value
    elif math.isfinite(found.value):
        words = f"order {order} meets the {words}, rotor speed"
        rows[f"{words} [rad/s]"], rows[f"{words} [rpm]"] = found.value, found.value / RPM
    held = figures.n_closed_pairs or figures.mean_opening or not scales_with_load(scene)
    rows["vibration there" if rows else words] = found.in_words
    if not (held or found.unknown):
        rows["vibration there"] = f"{found.in_words}; proportional to the load"
    return rows


def _rotation(scene: Scene, figures: KeyFigures) -> dict[str, object]:
    """The rotor's speed, and how far it opens the crack."""
    if scene.speed == 0.0:
        return {}
    rows: dict[str, object] = {
        "rotor speed [rad/s]": scene.speed,
        "rotor speed [rpm]": scene.speed / RPM,
    }
    if figures.n_face_elements is not None:
        rows["crack opened by rotation and mean load [m]"] = figures.mean_opening
    return rows


def _contact(study: Study, figures: KeyFigures) -> dict[str, object]:
    """The cracks, their pairs and their law."""
    cracks, law, contact = study.scene.all_cracks, study.contact, study.scene.contact
    rows: dict[str, object] = {}
    for name, crack in cracks.items():
        if crack.length is not None:
            words = "crack length" if len(cracks) == 1 else f"{name}, length"
            rows[f"{words} [m]"] = crack.length
            if (width := study.scene.geometry.width) is not None:
                rows[f"{words} / width"] = crack.length / width
    rows["contact pairs"] = study.structure.n_pairs
    if law is None or contact is None:
        return rows
    rows["contact law"] = contact.law
    if contact.friction:
        rows["coefficient of friction"] = contact.friction
    if not is_rigid(law):
        stiffness = np.broadcast_to(law.stiffness, study.structure.n_pairs)
        rows["softest pair [N/m]"] = float(stiffness.min())
        rows["stiffest pair [N/m]"] = float(stiffness.max())
    faces = faces_in_words(study.scene)
    static = ranging(figures.face_stiffness, ".3g")
    rows[f"static stiffness of the {faces}, each pair [N/m]"] = static
    if figures.stiffness_ratio is not None:
        rows["contact stiffness / static stiffness"] = ranging(figures.stiffness_ratio, ".3g")
    rows["static opening, mean load [m]"] = figures.mean_opening
    rows[f"static motion of the {faces}, amplitude of the load [m]"] = figures.static_gap_motion
    return rows


def harmonics_in_words(scene: Scene) -> int | str:
    """H, or how it is chosen."""
    table = scene.harmonic_balance
    if table.tolerance is None:
        return table.harmonics
    return f"{table.harmonics} or more, for an error of {table.tolerance:g}"


def _reduction(study: Study) -> str:
    """Describe the reduction by which the structure is solved."""
    scene = study.scene
    reduction, few = reduction_of(scene, study.structure), candidate_mode_counts(study)
    if reduction is None:
        return "none"
    modes = counted(reduction.n_modes, "mode")
    if few:
        modes = f"{counted(few[0], 'mode')} or more, for an error of "
        modes += f"{scene.harmonic_balance.tolerance:g}"
    if reduction.method == "massless":
        return f"massless, {modes}, {faces_in_words(scene)} without mass"
    return f"{reduction.method}, {modes}"


def _impossible(scene: Scene) -> str:
    """Return the number of cases that are not valid scenes, with the first one's reason."""
    from fenics_crack.sweep.plan import Plan  # gmsh

    plan = Plan(scene)
    places = [*itertools.islice(np.ndindex(*plan.shape), 10_000)]  # others while they are run
    reasons = [case for case in map(plan.case, places) if isinstance(case, str)]
    more = f" of the first {len(places)}" if np.prod(plan.shape) > len(places) else ""
    return f"{len(reasons)}{more}" + (f": {reasons[0]}" if reasons else "")


# --- harmonics that nothing damps -----------------------------------------------------------------


def remark_on(structure: Structure, highest: float) -> str:
    """Return a remark on harmonics up to a frequency [rad/s]; empty where all of them are damped,
    and without contact, which excites them (collective)."""
    damped = damped_range(structure) if structure.n_pairs else None
    if damped is None or highest <= damped[1]:
        return ""
    count, end = damped
    if count == 0:
        return f"harmonics up to H w = {highest:g} rad/s: nothing damps what they excite"
    modes = "the damped mode" if count == 1 else f"the {count} damped modes"
    beyond = f"harmonics up to H w = {highest:g} rad/s reach beyond {modes} ({end:g} rad/s)"
    return f"{beyond}: nothing damps what they excite there"


def _remark_on_whole(scene: Scene, whole: Structure, highest: float) -> str:
    """The same of a structure that the scene reduces before it is solved (collective)."""
    table = reduction_of(scene, whole)
    ratio = None if scene.damping is None else scene.damping.ratio
    if table is not None and table.method == "massless" and ratio is not None:
        if np.ravel(ratio)[-1] > 0.0:  # that of all further modes that are kept
            return ""
    return remark_on(whole, highest)
