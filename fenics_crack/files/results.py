"""Write and read every kind of result (HDF5): :func:`save` and :func:`load`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.balance.compliance import make_compliance_model
from fenics_crack.balance.error_report import ErrorReport
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.curves.balance_equations import EQUATIONS_CLASS_BY_PARAMETER
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.files.codec import Datasets, pack_dataclass, unpack_dataclass
from fenics_crack.files.store import StoredFile, check_shapes, read_result_file, write_result_file
from fenics_crack.model.contact import (
    ContactLaw,
    UnilateralConstraint,
    add_pair_for_each_contact_force,
    count_normal_rows_per_pair,
    friction_of,
    is_rigid,
    is_unilateral,
    layered_law_of,
    split_pairs_into_layers,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import STIFFNESS_SOLUTION_ROUNDING, Modes
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import resize_harmonics
from fenics_crack.scene.fields import MAX_ALLOWED_MAGNITUDE
from fenics_crack.scene.scene import Scene
from fenics_crack.time.march import TimeHistory

Result = Modes | PeriodicSolution | ResponseCurve | TimeHistory
OptionalLaw = ContactLaw | None
ShapeByName = dict[str, tuple[int, ...]]
ORIGINAL_STRUCTURE_REQUIREMENT = (
    "the structure with which the file was computed; fc.load_run builds it from the file's scene"
)
"""Requirement on a structure that does not fit a result file, for an error message."""


def save(
    result: Result,
    path: str | Path,
    scene: Scene | None = None,
    *,
    watched: Mapping[str, np.ndarray] | None = None,
    errors: str | None = None,
) -> None:
    """Write a result to an HDF5 file, with the scene if given (collective).

    The file can be read on any number of ranks. For a solution, it has gaps and contact forces;
    :func:`load` computes the displacement from them. For modes, it has the mode shapes by mesh
    node.

    Parameters
    ----------
    result : Modes, PeriodicSolution, ResponseCurve or TimeHistory
        Result to write.
    path : path
        The file; an older file is replaced once the new file is complete.
    scene : Scene, optional
        The result's scene.
    watched : mapping of str to array, optional
        Watched dofs' motion [m] by name, for programs that read the file without the structure.
        Fourier coefficients with H harmonics for a solution (2H+1,) or a curve with n points (n,
        2H+1). Displacements at n instants for a time history (n,). ``load`` ignores this.
    errors : str, optional
        The result's estimated errors, as JSON text from ``Verification.to_json``.
        :func:`fenics_crack.load_run` reads it.

    Raises
    ------
    InputError
        The file cannot be written, the modes have no mesh, or a time history is spread over several
        ranks.

    Examples
    --------
    >>> fc.save(solution, "solution.h5", scene)
    """
    if type(result) not in _PACK_UNPACK_FUNCTIONS_BY_CLASS:
        class_names_text = ", ".join(
            storable_class.__name__ for storable_class in _PACK_UNPACK_FUNCTIONS_BY_CLASS
        )
        raise InputError("result", type(result).__name__, f"one of {class_names_text}")
    datasets = _PACK_UNPACK_FUNCTIONS_BY_CLASS[type(result)][0](result) | {"verification": errors}
    if watched:
        watched_quantity = "displacement" if isinstance(result, TimeHistory) else "coefficients"
        datasets |= {
            "watched": [*watched],
            f"watched_{watched_quantity}": np.stack([*watched.values()], axis=-1),
        }
    write_result_file(datasets, path, result.KIND, scene, result.structure.comm)


def load(path: str | Path, structure: Structure, contact: OptionalLaw = None) -> Result:
    """Read a result written by :func:`save`, without solving again (collective).

    To read a file with a scene, and without a structure at hand, use :func:`fenics_crack.load_run`.
    To read a sweep, use ``SweepResult.load``.

    Parameters
    ----------
    path : path
        The file.
    structure, contact : Structure, ContactLaw or None
        Structure and law with which the result was computed. Modes and time histories need no law.
        For a curve, a structure with many dofs is reduced first, to a model without mass at the
        crack faces.

    Returns
    -------
    Modes, PeriodicSolution, ResponseCurve or TimeHistory
        Result that was written.

    Raises
    ------
    InputError
        The file does not come from :func:`save`, or belongs to another structure or law.

    Examples
    --------
    >>> fc.save(solution, "solution.h5")
    >>> again = fc.load("solution.h5", structure, contact)
    """
    return unpack_result(read_result_file(path, structure.comm), structure, contact)


def unpack_result(
    stored_file: StoredFile, structure: Structure, contact: OptionalLaw = None
) -> Result:
    """Return the result from a result file that was read (collective).

    Parameters
    ----------
    stored_file : StoredFile
        The file's contents.
    structure, contact : Structure, ContactLaw or None
        The result's structure and contact law.

    Raises
    ------
    InputError
        The file has no result, or belongs to another structure or law.
    """
    result_type = result_class(stored_file)
    with stored_file.yield_datasets_with_valid_numbers() as datasets:
        if (friction := friction_of(contact)) is not None and "law_direction" in datasets:
            friction_line_field_by_name = {
                name: datasets[f"law_{name}"] for name in ("direction", "turning")
            }
            contact = replace(friction, **friction_line_field_by_name)
        return _PACK_UNPACK_FUNCTIONS_BY_CLASS[result_type][1](datasets, structure, contact)


def result_class(stored_file: StoredFile) -> type[Result]:
    """Return the result's class for a file written by :func:`save`.

    Raises
    ------
    InputError
        The file holds another kind of result, such as a sweep.
    """
    for result_type in _PACK_UNPACK_FUNCTIONS_BY_CLASS:
        if result_type.KIND == stored_file.kind:
            return result_type
    if stored_file.kind == "backbone":
        raise stored_file.refusal(
            "a result that this version reads; follow_resonance takes the place of backbones: "
            "compute it again with it"
        )
    requirement_text = (
        f"a result of one vibration; a {stored_file.kind} is read by load of its class, "
        "as SweepResult.load"
    )
    raise stored_file.refusal(requirement_text)


# --- modes ----------------------------------------------------------------------------------------


def _pack_modes(modes: Modes) -> Datasets:
    """Return modes as datasets by name (collective).

    The datasets are "omega" [rad/s] (n_modes,), "nodes" and "shapes". "nodes" are from
    :func:`_node_positions_and_mean_cell_midpoints`. "shapes" are displacements at the nodes:
    (n_modes, n_nodes, dimension). For a structure without a mesh, "shapes" are (n_modes, n_dofs),
    and "nodes" are missing.
    """
    whole_structure = modes.structure.whole
    if whole_structure.local_nodes_with_cells_or_none is None:
        shapes_by_dof = gather_rows(whole_structure.comm, modes.structure.expand(modes.shapes.T).T)
        return {"omega": modes.omega, "shapes": shapes_by_dof.T}
    nodal_mesh = NodalMesh(modes.structure)
    nodal_shapes = nodal_mesh.nodal_vectors(modes.structure.expand(modes.shapes.T))
    return {
        "omega": modes.omega,
        "nodes": _node_positions_and_mean_cell_midpoints(nodal_mesh),
        "shapes": nodal_shapes,
    }


def _unpack_modes(datasets: Datasets, structure: Structure, contact: OptionalLaw = None) -> Modes:
    """Return modes from their datasets, on any number of ranks (collective).

    ``contact`` is ignored; it is a parameter because curves and solutions need a law.

    Raises
    ------
    InputError
        The structure has other nodes than the file, or another number of dofs.
    """
    omegas, stored_shapes, whole_structure = datasets["omega"], datasets["shapes"], structure.whole
    check_shapes(datasets, {"omega": (len(stored_shapes),)})
    if whole_structure.local_nodes_with_cells_or_none is None:
        if (
            "nodes" in datasets
            or stored_shapes.ndim != 2
            or stored_shapes.shape[1] != whole_structure.n_dofs
        ):
            structure_requirement_text = (
                f"the structure of the file, with {stored_shapes.shape[-1]} dofs"
            )
            raise InputError(
                "structure", f"{whole_structure.n_dofs} dofs", structure_requirement_text
            )
        local_dof_slice = slice(
            whole_structure.first_dof, whole_structure.first_dof + whole_structure.n_local
        )
        return Modes(omegas, stored_shapes[:, local_dof_slice].T, whole_structure)
    nodal_mesh = NodalMesh(structure)
    assert whole_structure.nodes is not None
    from scipy.spatial import cKDTree  # takes a while, and is needed here alone

    node_positions_and_cell_midpoints = _node_positions_and_mean_cell_midpoints(nodal_mesh)
    stored_positions_and_cell_midpoints = datasets["nodes"]
    dimension = nodal_mesh.dimension
    check_shapes(
        datasets,
        {
            "shapes": (len(omegas), len(stored_positions_and_cell_midpoints), dimension),
            "nodes": (-1, 2 * dimension),
        },
    )
    distances_to_nearest_stored_node, nearest_stored_node_indices = cKDTree(
        stored_positions_and_cell_midpoints
    ).query(node_positions_and_cell_midpoints)
    is_one_to_one = len(stored_positions_and_cell_midpoints) == len(
        node_positions_and_cell_midpoints
    ) and len(set(nearest_stored_node_indices)) == len(nearest_stored_node_indices)
    if not is_one_to_one or distances_to_nearest_stored_node.max() > 1e-6 * nodal_mesh.size:
        raise InputError(
            "structure",
            f"{len(node_positions_and_cell_midpoints)} nodes",
            f"the structure of the file, with {len(stored_positions_and_cell_midpoints)} nodes "
            "at the same places",
        )
    first_node = whole_structure.comm.exscan(len(whole_structure.nodes.points)) or 0
    nodal_shapes_of_rank = nodal_mesh.to_nodal_frames(
        stored_shapes[:, nearest_stored_node_indices]
    )[:, first_node : first_node + len(whole_structure.nodes.points)]
    is_free_dof = whole_structure.nodes.dofs >= 0
    mode_shapes_at_local_dofs = np.zeros((len(omegas), whole_structure.n_local))
    mode_shapes_at_local_dofs[
        :, whole_structure.nodes.dofs[is_free_dof] - whole_structure.first_dof
    ] = nodal_shapes_of_rank[:, is_free_dof]
    return Modes(omegas, mode_shapes_at_local_dofs.T, whole_structure)


def _node_positions_and_mean_cell_midpoints(nodal_mesh: NodalMesh) -> np.ndarray:
    """Return coordinates [m] to distinguish a mesh's nodes: (n_nodes, 2 d).

    d is the mesh's dimension. The first d columns are the node's position. The next d columns are
    the mean midpoint of the cells with this node. Two nodes at the same position, on opposite crack
    faces, differ in this midpoint.
    """
    midpoint_sums = np.zeros_like(nodal_mesh.points)
    n_cells_at_node = np.zeros((len(nodal_mesh.points), 1))
    cell_midpoints = nodal_mesh.points[nodal_mesh.cells].mean(axis=1)
    for nth_node_of_each_cell in nodal_mesh.cells.T:
        np.add.at(midpoint_sums, nth_node_of_each_cell, cell_midpoints)
        np.add.at(n_cells_at_node, nth_node_of_each_cell, 1.0)
    return np.hstack([nodal_mesh.points, midpoint_sums / n_cells_at_node])


# --- solutions ------------------------------------------------------------------------------------


def _pack_solution(solution: PeriodicSolution) -> Datasets:
    """Return a solution as datasets by name.

    The datasets hold errors, stability, contact law, and Fourier coefficients for gaps and forces.
    The displacement is left out, as :func:`rebuild_solution` computes it from the forces.
    """
    report_datasets = {
        f"error_{field_name}": report_value
        for field_name, report_value in pack_dataclass(solution.report).items()
    }
    datasets = pack_dataclass(
        solution, *_FIELDS_NOT_STORED, "displacement_coefficients", "stability"
    )
    if is_rigid(solution.contact) and friction_of(solution.contact) is None:
        datasets["weight"] = solution.contact.weight
    if solution.stability is not None:
        datasets |= pack_dataclass(solution.stability)
    return datasets | report_datasets | _law_datasets(solution.contact, solution.structure)


def _unpack_solution(
    datasets: Datasets, structure: Structure, contact: OptionalLaw
) -> PeriodicSolution:
    """Return a solution from datasets after checking shapes and law (collective)."""
    gap_coefficients = datasets["gap_coefficients"]
    coefficient_shape = len(gap_coefficients) | 1, gap_coefficients.shape[-1]
    gap_and_force_dataset_names = "gap_coefficients", "force_coefficients"
    check_shapes(
        datasets,
        dict.fromkeys(
            [
                *gap_and_force_dataset_names,
                *(f"tangential_{name}" for name in gap_and_force_dataset_names),
            ],
            coefficient_shape,
        ),
    )
    check_shapes(datasets, {"multipliers": (max(np.size(datasets.get("multipliers")), 1),)})
    _check_n_pairs(structure.n_pairs, gap_coefficients)
    _check_law(datasets, contact, structure)
    return rebuild_solution(datasets, structure, contact)


def rebuild_solution(
    datasets: Datasets, structure: Structure, contact: OptionalLaw
) -> PeriodicSolution:
    """Rebuild a solution from gap and force Fourier coefficients (collective).

    The displacement is computed from the forces, with the structure's compliance.

    Parameters
    ----------
    datasets : dict
        The solution's fields except the displacement, and :class:`Stability` fields, by name. Error
        report fields have the prefix "error" and an underscore. ``weight`` is for a
        :class:`UnilateralConstraint`; other laws do not use it.
    structure, contact : Structure, ContactLaw or None
        The solution's structure and law.

    Raises
    ------
    InputError
        The structure has more or fewer pairs than the datasets. Or a converged solution's computed
        displacement gives other gaps than the datasets.
    ValueError
        The frequency is negative, or the subharmonic below 1.
    """
    gap_coefficients = datasets["gap_coefficients"]
    force_coefficients = datasets["force_coefficients"]
    _check_n_pairs(structure.n_pairs, gap_coefficients)
    if is_rigid(contact) and friction_of(contact) is None:
        contact = UnilateralConstraint(datasets.get("weight"))
    datasets.setdefault("error_confirmed", True)  # of earlier versions
    report_field_by_name = {
        field.name: datasets[f"error_{field.name}"] for field in fields(ErrorReport)
    }
    omega, subharmonic = datasets["omega"], datasets["subharmonic"]
    if not omega >= 0.0 or subharmonic < 1:
        raise ValueError("its omega is negative, or its subharmonic below 1")
    tangential_force_coefficients = datasets.get("tangential_force_coefficients")
    normal_and_tangential_coefficients = (
        force_coefficients
        if tangential_force_coefficients is None
        else np.hstack([force_coefficients, tangential_force_coefficients])
    )
    structure_with_contact_rows = add_pair_for_each_contact_force(contact, structure)
    compliance_model = make_compliance_model(
        structure_with_contact_rows, omega / subharmonic, len(gap_coefficients) // 2, subharmonic
    )
    _, contact_row_force_coefficients = split_pairs_into_layers(
        contact,
        structure.n_pairs,
        normal_and_tangential_coefficients,
        normal_and_tangential_coefficients,
    )
    computed_displacement_coefficients = compliance_model.displacement(
        contact_row_force_coefficients
    )
    compliance_model.destroy()
    solution = unpack_dataclass(
        PeriodicSolution,
        datasets,
        structure=structure,
        contact=contact,
        displacement_coefficients=computed_displacement_coefficients,
        stability=unpack_dataclass(Stability, datasets) if "multipliers" in datasets else None,
    ).reported(unpack_dataclass(ErrorReport, report_field_by_name))
    if solution.converged:
        _check_gap_coefficients(
            structure,
            computed_displacement_coefficients,
            gap_coefficients,
            max(1e-6, 10.0 * solution.report.residual),
        )
    return solution


def _check_n_pairs(n_pairs: int, pair_gaps: np.ndarray) -> None:
    """Raise InputError unless gaps from a file fit the structure's number of pairs.

    The last axis of ``pair_gaps`` must have ``n_pairs`` entries.
    """
    if pair_gaps.shape[-1] != n_pairs:
        requirement_text = f"the structure of the file, with {pair_gaps.shape[-1]} pairs"
        raise InputError("structure", f"{n_pairs} pairs", requirement_text)


def _check_gap_coefficients(
    structure: Structure,
    displacement_coefficients: np.ndarray,
    gap_coefficients: np.ndarray,
    tolerance: float,
) -> None:
    """Raise InputError unless the displacement gives the gaps in the file (collective).

    Used to detect another structure than in the file. Gaps and displacement are Fourier
    coefficients with H harmonics.

    Parameters
    ----------
    structure : Structure
        Structure to check; it defines the gaps and clearances.
    displacement_coefficients : (2H+1, n_local) [m]
        This structure's displacement, computed from the contact forces in the file.
    gap_coefficients : (2H+1, n_pairs) [m]
        Gaps from the file.
    tolerance : float
        Allowed difference, divided by the gaps' norm without clearance. An allowance for rounding
        errors is added, proportional to the crack faces' displacement.
    """
    recomputed_gap_coefficients = structure.apply_bt(displacement_coefficients)
    displacement_sizes = structure.sum_over_ranks(
        np.abs(displacement_coefficients) @ abs(structure.gap)
    )
    difference_tolerance = tolerance * np.linalg.norm(recomputed_gap_coefficients)
    difference_tolerance += STIFFNESS_SOLUTION_ROUNDING * np.linalg.norm(displacement_sizes)
    recomputed_gap_coefficients[0] -= structure.clearance
    difference_norm = np.linalg.norm(recomputed_gap_coefficients - gap_coefficients)
    if not difference_norm <= difference_tolerance:  # nan neither
        raise InputError(
            "structure", "another load, mesh or material", ORIGINAL_STRUCTURE_REQUIREMENT
        )


# --- curves ---------------------------------------------------------------------------------------


def _pack_curve(curve: ResponseCurve) -> Datasets:
    """Return a curve as datasets by name, with the special points (bifurcations).

    Exact orbits have their Floquet multipliers at special points, too. Harmonic balance points have
    none there.
    """
    special_points = curve.at_bifurcations.part(slice(1, -1))
    datasets = pack_dataclass(curve, *_FIELDS_NOT_STORED, "points")
    datasets["kinds"] = [bifurcation.kind for bifurcation in curve.bifurcations]
    special_point_datasets = {"values": special_points.values, "omega": special_points.omega}
    if curve.exact:
        datasets |= _pack_orbit_displacements_and_velocities(curve) | {
            "couplings": _stack_gap_and_load_rows(curve.structure)
        }
        special_point_datasets |= _pack_orbit_displacements_and_velocities(special_points) | {
            "multipliers": special_points.multipliers
        }
    else:
        datasets |= {"unknowns": curve.points, "undecided": curve.is_undecided}
        special_point_datasets |= {
            str(special_point_index): special_point
            for special_point_index, special_point in enumerate(special_points.points)
        }
    datasets |= {
        f"bifurcation_{name}": special_point_dataset
        for name, special_point_dataset in special_point_datasets.items()
    }
    return datasets | _law_datasets(curve.contact, curve.structure)


def _pack_orbit_displacements_and_velocities(curve: ResponseCurve) -> Datasets:
    """Return exact orbits' displacements and velocities as datasets, by dof.

    A curve holds modal coordinates. A mode's sign is arbitrary, and may differ when the mode is
    computed again. A dof's sign can be found by :func:`_find_dof_signs`.

    Returns
    -------
    dict of str to array
        "states" (n, 2, n_dofs): displacements [m] and velocities [m/s] at the n curve points. With
        friction also "places" (n, n_pairs): tangential gaps [m] at which pairs stick.
    """
    dof_states, sticking_gaps = [], []
    for parameter_value, orbit_state in zip(curve.values.tolist(), curve.points, strict=True):
        mode_shapes = all_modes(curve.problem_at(parameter_value).structure).shapes
        modal_state, sticking_gap = np.split(orbit_state, [2 * mode_shapes.shape[1]])
        dof_states.append(modal_state.reshape(2, -1) @ mode_shapes.T)
        sticking_gaps.append(sticking_gap)
    structure, n_curve_points = curve.structure, len(curve)
    state_datasets = {"states": np.reshape(dof_states, (n_curve_points, 2, structure.n_dofs))}
    if friction_of(curve.contact) is not None:
        n_sliders = structure.n_pairs * count_normal_rows_per_pair(curve.contact)
        state_datasets["places"] = np.reshape(sticking_gaps, (n_curve_points, n_sliders))
    return state_datasets


def _unpack_curve(datasets: Datasets, structure: Structure, contact: OptionalLaw) -> ResponseCurve:
    """Return a curve from datasets after checking law and shapes (collective).

    A structure with many dofs is reduced first, to a model without mass at the crack faces.
    """
    if not is_small(structure):
        structure = reduce_structure(structure, method="massless")
    _check_law(datasets, contact, structure)
    is_exact = "states" in datasets
    count_by_prefix = {"": datasets["values"].size, "bifurcation_": len(datasets["kinds"])}
    lacks_datasets = (
        is_exact and not {"multipliers", "tolerance", "bifurcation_multipliers"} <= datasets.keys()
    )
    if (
        lacks_datasets
        or datasets["parameter"] not in EQUATIONS_CLASS_BY_PARAMETER
        or datasets["subharmonic"] < 1
    ):
        raise ValueError("its parameter, subharmonic or one of its entries is missing or wrong")
    vector_dataset_names = "values", "omega", "iterations", "multipliers", "undecided", "irregular"
    shape_by_name: ShapeByName = {
        f"{prefix}{name}": (count,)
        for prefix, count in count_by_prefix.items()
        for name in vector_dataset_names
    }
    unpack_points = _unpack_exact_points if is_exact else _unpack_balance_points
    curve, special_unknowns = unpack_points(
        datasets, structure, contact, count_by_prefix, shape_by_name
    )
    parameter_values = datasets["bifurcation_values"].tolist()
    special_omegas = datasets.get(
        "bifurcation_omega",
        [curve.problem_at(parameter_value).omega for parameter_value in parameter_values],
    )
    special_multipliers = (
        datasets["bifurcation_multipliers"][:, None] if is_exact else [None] * len(parameter_values)
    )
    special_point_rows = zip(
        datasets["kinds"],
        parameter_values,
        special_omegas,
        special_unknowns,
        special_multipliers,
        strict=True,
    )
    return replace(
        curve,
        bifurcations=tuple(
            curve.bifurcation(*special_point_row) for special_point_row in special_point_rows
        ),
    )


def _unpack_exact_points(
    datasets: Datasets,
    structure: Structure,
    contact: OptionalLaw,
    count_by_prefix: Mapping[str, int],
    shape_by_name: ShapeByName,
) -> tuple[ResponseCurve, Sequence[np.ndarray]]:
    """Rebuild a curve with exact orbits, and the states at special points.

    Special points are bifurcations. A state has all modes' displacements and velocities. With
    friction, it also has the tangential gap at which each pair sticks.

    Parameters
    ----------
    datasets : dict
        The file's datasets by name.
    structure, contact : Structure, ContactLaw or None
        The curve's structure and law.
    count_by_prefix : dict of str to int
        Point count by dataset name prefix. The prefix "" is for the curve's points, "bifurcation"
        with an underscore for special points.
    shape_by_name : dict
        Required shapes by dataset name. The states' shapes are added here; then all are checked.

    Returns
    -------
    curve : ResponseCurve
        Curve with an empty ``bifurcations``, which the caller fills.
    special_states : (m, n_states)
        States at the m special points.

    Raises
    ------
    InputError
        The structure has another load, mesh or material: the first orbit's residual is above 1e-4.
    """
    dof_signs = _find_dof_signs(structure, datasets["couplings"])
    for prefix, count in count_by_prefix.items():
        shape_by_name[f"{prefix}states"] = count, 2, structure.n_dofs
        n_sliders = structure.n_pairs * count_normal_rows_per_pair(contact)
        shape_by_name[f"{prefix}places"] = count, n_sliders
    check_shapes(datasets, shape_by_name)
    known_fields: Datasets = {"structure": structure, "contact": contact, "bifurcations": ()}
    curve = unpack_dataclass(ResponseCurve, datasets, **known_fields, points=datasets["states"])
    modal_states_of_curve_points, special_states = (
        _unpack_states_by_mode(datasets, prefix, curve, dof_signs) for prefix in count_by_prefix
    )
    curve = replace(curve, points=modal_states_of_curve_points)
    if not curve.orbit(0).residual <= 1e-4:  # nan neither
        raise InputError(
            "structure", "another load, mesh or material", ORIGINAL_STRUCTURE_REQUIREMENT
        )
    return curve, special_states


def _unpack_balance_points(
    datasets: Datasets,
    structure: Structure,
    contact: OptionalLaw,
    count_by_prefix: Mapping[str, int],
    shape_by_name: ShapeByName,
) -> tuple[ResponseCurve, Sequence[np.ndarray]]:
    """Rebuild a harmonic balance curve, and the unknowns at special points (collective).

    Special points are bifurcations. Unknowns are the Fourier coefficients [m] that harmonic balance
    solves for, as in :attr:`ResponseCurve.points`.

    Parameters
    ----------
    datasets : dict
        The file's datasets by name.
    structure, contact : Structure, ContactLaw or None
        The curve's structure and law.
    count_by_prefix : dict of str to int
        Point count by dataset name prefix. The prefix "" is for the curve's points, "bifurcation"
        with an underscore for special points.
    shape_by_name : dict
        Required shapes by dataset name. The unknowns' shapes are added here; then all are checked.

    Returns
    -------
    curve : ResponseCurve
        Curve with an empty ``bifurcations``, which the caller fills.
    special_unknowns : list of (2H+1, n_pairs)
        Unknowns at each special point, with the curve's H harmonics.
    """
    special_point_dataset_names = [
        f"bifurcation_{index}" for index in range(len(datasets["kinds"]))
    ]
    unknowns = datasets["unknowns"]
    n_pairs = add_pair_for_each_contact_force(contact, structure).n_pairs
    _check_n_pairs(n_pairs, unknowns)
    shape_by_name["unknowns"] = count_by_prefix[""], unknowns.shape[1] | 1, n_pairs
    shape_by_name |= {
        name: (len(datasets[name]) | 1, n_pairs) for name in special_point_dataset_names
    }
    check_shapes(datasets, shape_by_name)
    special_unknowns = [
        resize_harmonics(datasets[name], unknowns.shape[1] // 2)
        for name in special_point_dataset_names
    ]
    if "undecided" in datasets:  # of earlier versions, whose multiplier decides nothing there
        datasets["multipliers"] = np.where(datasets["undecided"], np.nan, datasets["multipliers"])
    known_fields: Datasets = {"structure": structure, "contact": contact, "bifurcations": ()}
    curve = unpack_dataclass(
        ResponseCurve, datasets, **known_fields, points=unknowns, tolerance=None
    )
    solution = curve.solution(0)
    _check_gap_coefficients(
        solution.structure, solution.displacement_coefficients, solution.gap_coefficients, 1e-4
    )
    return curve, special_unknowns


def _unpack_states_by_mode(
    datasets: Datasets, prefix: str, curve: ResponseCurve, dof_signs: np.ndarray
) -> np.ndarray:
    """Convert exact orbits' states from dofs to modal coordinates.

    Parameters
    ----------
    datasets : dict
        The file's datasets by name.
    prefix : str
        Prefix in dataset names: "" for the curve's points, "bifurcation" with an underscore for
        special points.
    curve : ResponseCurve
        Curve with the structure at each parameter value.
    dof_signs : (n_dofs,)
        1 if the structure's dof has the same direction as in the file, -1 if opposite.

    Returns
    -------
    (n, n_states)
        For each point: modal displacements, then modal velocities. With friction, the tangential
        gaps [m] at which pairs stick follow.
    """
    parameter_values = datasets[f"{prefix}values"]
    dof_states = dof_signs * datasets[f"{prefix}states"]
    sticking_gaps = datasets.get(f"{prefix}places", np.zeros((len(parameter_values), 0)))
    inverse_shape_matrices = (
        all_modes(curve.problem_at(parameter_value).structure).shapes_inverse
        for parameter_value in parameter_values.tolist()
    )
    matrices_states_and_sticking_gaps = zip(
        inverse_shape_matrices, dof_states, sticking_gaps, strict=True
    )
    return np.array(
        [
            np.append((state_of_all_dofs @ inverse_shapes.T).ravel(), sticking_gap)
            for inverse_shapes, state_of_all_dofs, sticking_gap in matrices_states_and_sticking_gaps
        ]
    )


# --- motion in time -------------------------------------------------------------------------------


def _pack_history(history: TimeHistory) -> Datasets:
    """Return a time history as datasets by name; InputError on several ranks."""
    if history.structure.comm.size > 1:
        raise InputError(
            "result", "spread over several ranks", "a time history of a run on one rank"
        )
    datasets = pack_dataclass(history, *_FIELDS_NOT_STORED, "final_state")
    datasets["couplings"] = _stack_gap_and_load_rows(history.structure)
    datasets["final_state"] = history.final_state[:2]
    if history.friction is not None:
        datasets["final_places"] = history.final_state[2]
    return datasets


def _unpack_history(datasets: Datasets, structure: Structure, contact: OptionalLaw) -> TimeHistory:
    """Return a time history from datasets after checking shapes, load and pairs.

    ``contact`` is ignored; it is a parameter because curves and solutions need a law.
    """
    dof_signs = _find_dof_signs(structure, datasets["couplings"])
    n_instants, recorded_dofs = datasets["time"].size, datasets["recorded_dofs"]
    pair_dataset_names = "gap", "contact_force", "tangential_gap", "tangential_force"
    n_sliders_per_pair = max(np.size(datasets.get("final_places")) // max(structure.n_pairs, 1), 1)
    shape_by_name: ShapeByName = {
        "time": (n_instants,),
        **dict.fromkeys(pair_dataset_names, (n_instants, structure.n_pairs)),
        "recorded_dofs": (recorded_dofs.size,),
        "recorded": (n_instants, recorded_dofs.size),
        "final_state": (2, structure.n_local),
        "final_places": (n_sliders_per_pair * structure.n_pairs,),  # two with a layer
    }
    check_shapes(datasets, shape_by_name)
    if datasets["steps_per_period"] < 1 or n_instants % datasets["steps_per_period"]:
        raise ValueError("its instants are not a whole number of periods")
    sticking_gaps = (datasets["final_places"],) if "final_places" in datasets else ()
    final_state = (*(dof_signs * datasets["final_state"]), *sticking_gaps)
    datasets["recorded"] = (
        dof_signs[datasets["recorded_dofs"] - structure.first_dof] * datasets["recorded"]
    )
    return unpack_dataclass(TimeHistory, datasets, structure=structure, final_state=final_state)


# --- dofs and laws --------------------------------------------------------------------------------


def _stack_gap_and_load_rows(structure: Structure) -> np.ndarray:
    """Return rows that identify a structure's dofs: (n_pairs + 2K+1, n_local).

    The first n_pairs rows give each pair's gap from the displacement. The next 2K+1 rows are the
    load's Fourier coefficients [N], with K harmonics.
    """
    return np.vstack([structure.gap.toarray().T, structure.force])


def _find_dof_signs(structure: Structure, stored_rows: np.ndarray) -> np.ndarray:
    """Find the dofs that have the opposite direction in a file.

    A reduced structure's dofs are modes. A mode's sign is arbitrary, and may differ when the mode
    is computed again. To find the signs, gap and load rows are compared.

    Parameters
    ----------
    structure : Structure
        Structure to compare with the file.
    stored_rows : (n_pairs + 2K+1, n_local)
        The file's rows, as from :func:`_stack_gap_and_load_rows`.

    Returns
    -------
    (n_local,)
        1 if a dof has the same direction as in the file, -1 if opposite.

    Raises
    ------
    InputError
        The number of rows or dofs differs. Or rows differ by more than 1e-6 times the maximum in
        the row: the load or the pairs are different.
    """
    gap_and_load_rows = _stack_gap_and_load_rows(structure)
    if stored_rows.shape != gap_and_load_rows.shape:
        sizes_text = f"{structure.n_local} dofs, {structure.n_pairs} pairs"
        n_pairs = len(stored_rows) - len(structure.force)
        requirement_text = (
            f"the structure of the file, with {stored_rows.shape[1]} dofs and {n_pairs} pairs"
        )
        raise InputError("structure", sizes_text, requirement_text)
    dof_signs = np.where((stored_rows * gap_and_load_rows).sum(axis=0) < 0.0, -1.0, 1.0)
    row_maxima = np.abs(stored_rows).max(axis=1, initial=0.0, keepdims=True)
    if np.any(np.abs(stored_rows - gap_and_load_rows * dof_signs) > 1e-6 * row_maxima):
        raise InputError("structure", "other load or pairs", ORIGINAL_STRUCTURE_REQUIREMENT)
    return dof_signs


GAP_VALUES_TO_COMPARE_LAWS = np.concatenate(
    [sign * np.logspace(-12, 1, 27) for sign in (-1.0, 1.0)]
)
"""Gaps for comparing a user's law with a file [m]: 1e-12 to 10, both signs."""


def _law_datasets(contact: OptionalLaw, structure: Structure) -> Datasets:
    """Return datasets that identify a contact law: class name and parameters.

    A law written by a user has no known parameters. Instead, "law_force" has the law's forces [N]
    at the gaps :data:`GAP_VALUES_TO_COMPARE_LAWS`, summed over the pairs.
    """
    attribute_names = (
        "stiffness", "sharpness", "layer_depth", "layer_share", "coefficient",
        "tangential_stiffness", "direction", "turning",
    )  # fmt: skip
    datasets = {
        f"law_{attribute_name}": attribute_value
        for attribute_name in attribute_names
        for law in (layered_law_of(contact), contact)
        if (attribute_value := getattr(law, attribute_name, None)) is not None
    }
    if contact is not None and "law_sharpness" not in datasets and not is_unilateral(contact):
        with np.errstate(all="ignore"):  # gaps far from the structure's
            force_summed_over_pairs = contact.force(
                np.outer(GAP_VALUES_TO_COMPARE_LAWS, np.ones(structure.n_pairs))
            ).sum(axis=1)
        datasets["law_force"] = np.nan_to_num(
            force_summed_over_pairs, posinf=MAX_ALLOWED_MAGNITUDE
        ).clip(-MAX_ALLOWED_MAGNITUDE, MAX_ALLOWED_MAGNITUDE)
    return {"law": type(contact).__name__, **datasets}


def _check_law(datasets: Datasets, contact: OptionalLaw, structure: Structure) -> None:
    """Raise InputError unless a file's contact law equals the given law.

    Class name and parameters are compared. For a law written by a user, forces are compared at the
    gaps :data:`GAP_VALUES_TO_COMPARE_LAWS`. Parameters and forces may differ by 1e-9, relative.

    Parameters
    ----------
    datasets : dict
        The file's datasets by name.
    contact : ContactLaw or None
        The given law.
    structure : Structure
        Structure with the number of pairs.
    """
    law_datasets = _law_datasets(contact, structure)
    dataset_names = {"law", "law_stiffness", "law_sharpness", "law_layer_depth", "law_force"}
    dataset_names |= law_datasets.keys()
    stored_datasets = {
        dataset_name: datasets[dataset_name]
        for dataset_name in dataset_names
        if dataset_name in datasets
    }
    given_law_forces = law_datasets.pop("law_force", None)
    stored_law_forces = stored_datasets.pop("law_force", None)
    has_same_names = (
        law_datasets.keys() == stored_datasets.keys()
        and law_datasets["law"] == stored_datasets["law"]
    )
    if not has_same_names or not all(
        np.allclose(law_datasets[dataset_name], stored_datasets[dataset_name], rtol=1e-9, atol=0.0)
        for dataset_name in law_datasets
        if dataset_name != "law"
    ):
        raise InputError("contact", law_datasets, f"the law of the file, {stored_datasets}")
    if stored_law_forces is not None and not np.allclose(
        given_law_forces, stored_law_forces, rtol=1e-9, atol=0.0
    ):
        raise InputError(
            "contact", contact, "the law of the file: at the same gaps this law gives other forces"
        )


_FIELDS_NOT_STORED = ("structure", "contact", "bifurcations", "others", "assessment", "estimate")
"""Result fields that files lack, or hold as other datasets."""
PackFunction = Callable[[Any], Datasets]
UnpackFunction = Callable[[Datasets, Structure, OptionalLaw], Result]
_PACK_UNPACK_FUNCTIONS_BY_CLASS: dict[type[Result], tuple[PackFunction, UnpackFunction]] = {
    Modes: (_pack_modes, _unpack_modes),
    PeriodicSolution: (_pack_solution, _unpack_solution),
    ResponseCurve: (_pack_curve, _unpack_curve),
    TimeHistory: (_pack_history, _unpack_history),
}
"""Functions to convert a result to datasets and back, by class; files lack the structure."""
