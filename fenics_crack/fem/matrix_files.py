"""Read structures from other programs' matrix files, and write such files.

The model's input file gives positions of nodes, and a load acts at a node. If the scene has contact
but no gap matrix, the model has the pairs (:mod:`fenics_crack.fem.model_pairs`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI
from scipy.linalg import eigh

from fenics_crack.basics.atomic_files import replace_files
from fenics_crack.basics.errors import InputError, report_read_errors
from fenics_crack.basics.ranks import call_on_each_rank, on_root
from fenics_crack.fem.model_files import ModelFileMesh, read_nodes_and_cells
from fenics_crack.fem.model_pairs import find_coincident_node_pairs, find_gap_matrix_and_pairs
from fenics_crack.model.factor import local_rows, make_matrix_from_local_rows
from fenics_crack.model.matrices import make_whole_csr_matrix
from fenics_crack.model.matrix_formats import (
    LabelledMatrix,
    format_matrix_market,
    read_matrix,
    read_matrix_market_shape,
)
from fenics_crack.model.modes import count_damped_modes
from fenics_crack.model.nodes import Nodes, Pairs
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping, Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import FORCE_KEYS, Damping, Excitation
from fenics_crack.scene.tables import Structure as StructureTable

NASTRAN_LETTER_BY_MATRIX = {"mass": "M", "stiffness": "K", "damping": "B"}
"""Letter of each matrix in Nastran's files, which hold several matrices."""
KEYS_OF_FILES_WITH_ROW_PER_DOF = ("gap", "tangential", *FORCE_KEYS)
"""Keys in ``[structure]`` of files with a row for each dof."""
SCENE_FILE_NAME = "matrices.toml"
"""File name of the scene written by :func:`write_matrices`."""
OUTPUT_FILE_NAMES = (
    *(
        f"{n}.mtx"
        for n in (*NASTRAN_LETTER_BY_MATRIX, *KEYS_OF_FILES_WITH_ROW_PER_DOF, "clearance", "areas")
    ),
    SCENE_FILE_NAME,
)
"""Names of all files that :func:`write_matrices` may write."""
MAX_DOFS_TO_WRITE_MODAL_DAMPING = 3000
"""Maximum number of dofs for writing modal damping as a matrix. The matrix is dense: 4.5 million
numbers."""


def read_structure(scene: Scene, damping_rule: DampingRule | None, comm: MPI.Comm) -> Structure:
    """Read the structure from the matrix files in a scene's table ``[structure]`` (collective).

    Every rank reads the files and keeps part of the rows. ``damping_rule`` is used unless the table
    names a damping file.

    Raises
    ------
    InputError
        A file cannot be read, a shape does not fit, an entry is not finite, a matrix is not
        symmetric, or the mass is not positive definite. Or a scene with contact has no contact
        pairs.
    """
    table = scene.given("structure")
    try:
        return _make_structure(scene, table, damping_rule, comm)
    except InputError as error:
        if error.key not in table.field_by_key():
            raise
        value_at_error_key, problem_text = getattr(table, error.key), error.value
        path_text = (
            value_at_error_key
            if problem_text == value_at_error_key
            else f"{value_at_error_key} ({problem_text})"
        )
        raise InputError(table.full_key(error.key), path_text, error.allowed) from None


def _make_structure(
    scene: Scene, table: StructureTable, damping_rule: DampingRule | None, comm: MPI.Comm
) -> Structure:
    """Make a structure from the matrix files named in a scene's table (collective).

    Parameters
    ----------
    scene : Scene
        Scene with excitation and contact.
    table : StructureTable
        Table ``[structure]`` with the file names.
    damping_rule : DampingRule or None
        Modal or Rayleigh damping, used unless the table names a damping file.
    comm : MPI.Comm
        Ranks that share the matrix rows.

    Returns
    -------
    Structure
        Structure with contact pairs; with nodes if the table names a model file.
    """
    labelled_matrix_by_name, gaps_and_forces_by_name, model = call_on_each_rank(
        comm, lambda: _read_matrices_columns_and_model(table)
    )
    stiffness_matrix = labelled_matrix_by_name["stiffness"].matrix
    structure_fields: dict[str, Any] = {"gap": None, "damping": damping_rule}
    structure_fields |= {
        name: labelled_matrix.matrix for name, labelled_matrix in labelled_matrix_by_name.items()
    }
    n_dofs, row_order = stiffness_matrix.shape[0], np.arange(stiffness_matrix.shape[0])
    pairs, nodes_with_positions_and_dofs, row_labels = (
        Pairs(),
        None,
        labelled_matrix_by_name["stiffness"].labels,
    )
    if model is not None:
        if row_labels is None:
            requirement = "given: the file with node and direction of each row, for structure.model"
            raise InputError("structure.dofs", None, requirement)
        row_order, node_dofs, node_starts = _find_row_order_and_node_dofs(model, row_labels, table)
        for name in labelled_matrix_by_name:
            structure_fields[name] = structure_fields[name][row_order][:, row_order]
        if scene.contact is not None and table.gap is None:
            has_rotations = bool(np.any(row_labels[:, 1] > 3))
            structure_fields["gap"], pairs = find_gap_matrix_and_pairs(
                model, node_dofs, structure_fields["stiffness"], has_rotations=has_rotations
            )
        first_row_of_rank, first_row_of_next_rank = _own_row_range(node_starts, comm)
        for name in labelled_matrix_by_name:
            structure_fields[name] = make_matrix_from_local_rows(
                structure_fields[name][first_row_of_rank:first_row_of_next_rank], comm
            )
        nodes_with_positions_and_dofs = _own_nodes(
            model, node_dofs, first_row_of_rank, first_row_of_next_rank, comm
        )
    structure_fields |= {
        name: gap_or_force_matrix[row_order]
        for name, gap_or_force_matrix in gaps_and_forces_by_name.items()
    }
    n_pairs = 0 if structure_fields["gap"] is None else structure_fields["gap"].shape[1]
    structure_fields["clearance"] = _read_number_or_pair_values(
        "clearance", table.clearance, n_pairs
    )
    if table.areas is not None:
        pairs = replace(pairs, areas=_read_number_or_pair_values("areas", table.areas, n_pairs))
    if scene.excitation.point is not None:
        assert nodes_with_positions_and_dofs is not None
        _, dofs_of_excited_node = nodes_with_positions_and_dofs.find_nearest_position_and_dofs(
            comm, "excitation.point", scene.excitation.point
        )
        for name in FORCE_KEYS:
            force_column = sparse.lil_matrix(structure_fields.get(name, (n_dofs, 1)))
            for dof, point_force_along_axis in zip(
                dofs_of_excited_node, getattr(scene.excitation, name), strict=True
            ):
                if dof >= 0:
                    force_column[dof, 0] += point_force_along_axis
            structure_fields[name] = force_column
    if scene.highest_load_harmonic > 1:
        excitation_table = scene.excitation
        requirement = "left out with [structure]; its force files can have a column for each order"
        excitation_table.require(
            False, (excitation_table.wave and "wave") or "harmonics", requirement
        )
    return Structure.from_matrices(**structure_fields, comm=comm).with_places(
        nodes_with_positions_and_dofs, pairs
    )


def _read_matrices_columns_and_model(
    table: StructureTable,
) -> tuple[dict[str, LabelledMatrix], dict[str, Any], ModelFileMesh | None]:
    """Read the files named in a table ``[structure]``.

    Returns
    -------
    matrices : dict of str to LabelledMatrix
        Mass, stiffness and, if given, damping, with rows in the stiffness's order.
    columns : dict of str to (n_dofs, m)
        Gap matrix, tangential gaps and forces, if given, by key.
    model : Model or None
        Nodes and cells of the model's input file; None without the key ``model``.
    """
    label_file, labelled_matrix_by_name = None if table.dofs is None else Path(table.dofs), {}
    n_rows, model = None, None
    for name, letter in NASTRAN_LETTER_BY_MATRIX.items():
        if (path := getattr(table, name)) is not None:
            with report_read_errors(
                name, path, "a matrix file of Matrix Market, CalculiX, Abaqus or Nastran"
            ):
                labelled_matrix_by_name[name] = read_matrix(Path(path), letter, label_file, n_rows)
            n_rows = labelled_matrix_by_name[name].matrix.shape[0]
    labelled_stiffness = labelled_matrix_by_name["stiffness"]
    for name, labelled_matrix in labelled_matrix_by_name.items():
        with report_read_errors(
            name, getattr(table, name), "a matrix with the same dofs as structure.stiffness"
        ):
            labelled_matrix_by_name[name] = LabelledMatrix(
                labelled_matrix.with_rows_of(labelled_stiffness), labelled_stiffness.labels
            )
    if len(
        massless_rows := np.flatnonzero(labelled_matrix_by_name["mass"].matrix.diagonal() <= 0.0)
    ):
        massless_row_text = f"row {massless_rows[0] + 1}"
        if labelled_stiffness.labels is not None and massless_rows[0] < len(
            labelled_stiffness.labels
        ):
            massless_row_text = "node {}, direction {}".format(
                *labelled_stiffness.labels[massless_rows[0]]
            )
        requirement = "positive definite; give each row a mass > 0, or condense rows without mass"
        raise InputError("mass", f"no mass at {massless_row_text}", requirement)
    if table.model is not None:
        with report_read_errors(
            "model", table.model, "the input file of the program that wrote the matrices"
        ):
            model = read_nodes_and_cells(Path(table.model))
    path_by_name = {
        name: path
        for name in KEYS_OF_FILES_WITH_ROW_PER_DOF
        if (path := getattr(table, name)) is not None
    }
    n_rows = labelled_stiffness.matrix.shape[0]
    return (
        labelled_matrix_by_name,
        {
            name: make_whole_csr_matrix(name, Path(path), n_rows)
            for name, path in path_by_name.items()
        },
        model,
    )


def _find_row_order_and_node_dofs(
    model: ModelFileMesh, row_labels: np.ndarray, table: StructureTable
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find a new order of the matrices' rows, in which rows of a node are neighbours.

    Parameters
    ----------
    model : ModelFileMesh
        Nodes from the model file.
    row_labels : (n_dofs, 2) int
        For each row, node number in the file and direction: 1 to 3 for displacements, 4 to 6 for
        rotations.
    table : StructureTable
        Table ``[structure]``, for errors.

    Returns
    -------
    row_order : (n_dofs,) int
        Old index of each row in the new order.
    node_dofs : (n_nodes, 3) int
        New row of each model node along x, y and z; -1 without such a row.
    node_starts : (n + 1,) int
        First new row of each of the n nodes with rows, then the number of rows.
    """
    _, first_rows, unique_label_index_of_row = np.unique(
        row_labels[:, 0], return_index=True, return_inverse=True
    )
    row_order = np.argsort(first_rows[unique_label_index_of_row], kind="stable")
    row_labels = row_labels[row_order]
    node_dofs = np.full((len(model.labels), 3), -1)
    model_node_of_row = np.minimum(
        np.searchsorted(model.labels, row_labels[:, 0]), len(model.labels) - 1
    )
    is_row_of_model_node = model.labels[model_node_of_row] == row_labels[:, 0]
    is_translation = is_row_of_model_node & (row_labels[:, 1] >= 1) & (row_labels[:, 1] <= 3)
    # Label 0 is no node, but a coordinate.
    row_labels_missing_in_model = row_labels[~is_row_of_model_node & (row_labels[:, 1] >= 1), 0]
    if len(row_labels_missing_in_model) or not np.any(is_translation):
        problem_text = (
            f"node {row_labels_missing_in_model[0]} is missing"
            if len(row_labels_missing_in_model)
            else "no row is a displacement"
        )
        requirement = f"the model of {table.stiffness}, with the nodes of all its rows"
        raise InputError("model", problem_text, requirement)
    node_dofs[model_node_of_row[is_translation], row_labels[is_translation, 1] - 1] = (
        np.flatnonzero(is_translation)
    )
    node_starts = np.flatnonzero(np.append(True, np.diff(row_labels[:, 0]) != 0))
    return row_order, node_dofs, np.append(node_starts, len(row_labels))


def _own_row_range(node_starts: np.ndarray, comm: MPI.Comm) -> tuple[int, int]:
    """Return the first row of this rank, and the first row of the next rank.

    All rows of a node are on one rank, and all ranks have about equally many rows. ``node_starts``
    (n + 1,) has the first row of each node, then the number of rows.
    """
    balanced_start_and_stop = node_starts[-1] * np.array([comm.rank, comm.rank + 1]) // comm.size
    start, stop = node_starts[np.searchsorted(node_starts, balanced_start_and_stop)]
    return int(start), int(stop)


def _own_nodes(
    model: ModelFileMesh, node_dofs: np.ndarray, start: int, stop: int, comm: MPI.Comm
) -> Nodes:
    """Return the nodes whose matrix rows this rank has, and the cells for drawing.

    Rank 0 also gets all cells, and the nodes in cells without rows. Cells are left out unless three
    conditions hold: all have the same kind, none is a wedge, and each matrix row is a node's
    translation.

    Parameters
    ----------
    model : ModelFileMesh
        Nodes and cells from the model file.
    node_dofs : (n_nodes, 3) int
        Matrix row of each model node along x, y and z; -1 without a row.
    start, stop : int
        This rank's rows: ``start`` to ``stop`` - 1.
    comm : MPI.Comm
        Ranks that share the rows.

    Returns
    -------
    Nodes
        Positions and rows of this rank's nodes. Cells refer to node numbers counted over all ranks.
    """
    are_all_rows_translations = int(np.count_nonzero(node_dofs >= 0)) == comm.allreduce(
        stop - start
    )
    vtk_type = (
        next(iter(model.cells_by_vtk_type))
        if len(model.cells_by_vtk_type) == 1 and are_all_rows_translations
        else 0
    )
    vtk_type = 0 if vtk_type in (13, 26) else vtk_type  # VTK's wedges are not drawn
    cells = model.cells_by_vtk_type[vtk_type] if vtk_type else np.zeros((0, 1), dtype=int)
    highest_row_of_each_node = node_dofs.max(axis=1)
    has_row_or_cell = highest_row_of_each_node >= 0
    has_row_or_cell[cells] = True
    owner_rank = np.array(comm.allgather(stop)).searchsorted(highest_row_of_each_node, side="right")
    node_order = np.lexsort(
        (np.arange(len(node_dofs)), np.where(highest_row_of_each_node < 0, 0, owner_rank))
    )
    node_order = node_order[has_row_or_cell[node_order]]
    new_numbers = np.empty(len(node_dofs), dtype=int)
    new_numbers[node_order] = np.arange(len(node_order))
    own_nodes = node_order[
        np.where(highest_row_of_each_node[node_order] < 0, 0, owner_rank[node_order]) == comm.rank
    ]
    cells_in_numbering_of_all_ranks = (
        new_numbers[cells] if comm.rank == 0 else np.zeros((0, cells.shape[1]), dtype=int)
    )
    return Nodes(
        model.points[own_nodes], node_dofs[own_nodes], cells_in_numbering_of_all_ranks, vtk_type
    )


def _read_number_or_pair_values(name: str, number_or_path: float | str, n_pairs: int) -> Any:
    """Return a setting of the contact pairs: a number, or a value per pair from a file.

    Parameters
    ----------
    name : str
        Key of the setting, for errors: "clearance" or "areas".
    number_or_path : float or str
        The number, or the path of a file with a value per pair.
    n_pairs : int
        Number of contact pairs. With 0 the file is not read.

    Returns
    -------
    float or (n_pairs,)
        The given number, or the values from the file. 0 for a file without pairs.
    """
    if not isinstance(number_or_path, str):
        return number_or_path
    return (
        make_whole_csr_matrix(name, Path(number_or_path), n_pairs).toarray().ravel()
        if n_pairs
        else 0.0
    )


def table_pair_upper_bound(table: StructureTable) -> int:
    """Return an upper bound for the number of contact pairs in a table ``[structure]``.

    The bound is the gap file's number of columns. Without a gap file, the coincident node pairs in
    the model file are counted. Without both files, or if the file cannot be read, the result is 0.
    """
    path = table.gap or table.model
    if path is None:
        return 0
    try:
        with report_read_errors("structure.gap", path, "a file that can be read"):
            if table.gap is not None:
                return read_matrix_market_shape(Path(table.gap))[1]
            return len(find_coincident_node_pairs(read_nodes_and_cells(Path(path)).points))
    except InputError:  # the reader reports the reason
        return 0


# --- files for other programs ---------------------------------------------------------------------


def write_matrices(structure: Structure, folder: str | Path, scene: Scene | None = None) -> None:
    """Write a structure's matrices as Matrix Market files, with a scene (collective).

    The scene ``matrices.toml`` reads the files again. Files are named like the keys of
    ``[structure]``, as ``mass.mtx``; data that the structure lacks has no file. A rotating
    structure has the stiffness and mean load at the current speed. Up to 3,000 dofs, modal damping
    is also written as a matrix, for other programs; the scene states the damping ratios.

    Parameters
    ----------
    structure : Structure
        Structure that is not reduced; ranks may share the rows.
    folder : path
        Folder for the files. Earlier files with these names move to the subfolder ``before``.
    scene : Scene, optional
        Source of frequency, contact, harmonic balance and reduction for ``matrices.toml``. Without
        a scene, the user has to add ``[excitation]`` and ``[contact]``.

    Raises
    ------
    InputError
        The structure is reduced, the scene does not fit it, or a file cannot be written.

    Examples
    --------
    >>> fc.write_matrices(structure, "matrices", scene)
    """
    if structure.whole is not structure:
        requirement = (
            "a structure that is not reduced, as structure.whole or fc.build_structure(scene)"
        )
        raise InputError("structure", repr(structure), requirement)
    comm, forces, damping_matrix = structure.comm, structure.force, structure.damping_matrix
    local_matrix_by_name: dict[str, Any] = {
        "mass": local_rows(structure.mass),
        "stiffness": local_rows(structure.stiffness),
        "damping": None if damping_matrix is None else local_rows(damping_matrix),
        **dict(zip(FORCE_KEYS, (forces[:1].T, forces[1::2].T, forces[2::2].T), strict=True)),
    }
    if structure.n_pairs:
        pair_slice = slice(None if comm.rank == 0 else 0)  # every rank has all pairs: write once
        local_matrix_by_name |= {"gap": structure.gap, "tangential": structure.tangential}
        local_matrix_by_name["clearance"] = structure.clearance[pair_slice, None]
        areas = structure.pair_areas
        local_matrix_by_name["areas"] = None if areas is None else areas[pair_slice, None]
    local_csr_matrix_by_name = {
        name: sparse.csr_matrix(local_matrix)
        for name, local_matrix in local_matrix_by_name.items()
        if local_matrix is not None
    }
    gathered_parts_by_name = {
        name: comm.gather(local_matrix) for name, local_matrix in local_csr_matrix_by_name.items()
    }
    scene_text = _scene_text(
        structure, {name: f"{name}.mtx" for name in gathered_parts_by_name}, scene
    )

    def write_files() -> None:
        """Write the gathered matrices and the scene; called on rank 0."""
        full_matrix_by_name = {
            name: sparse.vstack(matrix_parts_of_ranks)
            for name, matrix_parts_of_ranks in gathered_parts_by_name.items()
        }
        if (
            isinstance(structure.damping, ModalDamping)
            and structure.n_dofs <= MAX_DOFS_TO_WRITE_MODAL_DAMPING
        ):
            squared_omegas, mode_shapes = eigh(
                full_matrix_by_name["stiffness"].toarray(), full_matrix_by_name["mass"].toarray()
            )
            n_damped = count_damped_modes(structure)
            modal_damping = structure.damping.rate(squared_omegas[:n_damped])
            damping_factor_matrix = (
                full_matrix_by_name["mass"] @ mode_shapes[:, :n_damped] * np.sqrt(modal_damping)
            )
            full_matrix_by_name["damping"] = sparse.csr_matrix(
                damping_factor_matrix @ damping_factor_matrix.T
            )
        text_by_file = {
            f"{name}.mtx": format_matrix_market(matrix)
            for name, matrix in full_matrix_by_name.items()
        }
        replace_files(OUTPUT_FILE_NAMES, Path(folder), text_by_file | {SCENE_FILE_NAME: scene_text})

    on_root(comm, write_files)


def _scene_text(structure: Structure, file_by_name: dict[str, str], scene: Scene | None) -> str:
    """Return the TOML text of a scene that reads the written files.

    ``file_by_name`` has file names by the key in ``[structure]``. Excitation frequency, contact,
    harmonic balance and reduction are copied from ``scene``; without a scene they are left out.
    """
    table_by_name: dict[str, Any] = {}
    damping_rule = structure.damping or RayleighDamping()
    if isinstance(damping_rule, DampingRule):
        table_by_name["damping"] = Damping(
            **{
                damping_field_name: damping_field_value
                for damping_field_name, damping_field_value in vars(damping_rule).items()
                if damping_field_value is not None
            }
        )
        file_by_name = {
            matrix_name: file_name
            for matrix_name, file_name in file_by_name.items()
            if matrix_name != "damping"
        }
    table_by_name["structure"] = StructureTable(**file_by_name)
    if scene is None:
        return "\n".join(scene_table.as_toml() for scene_table in table_by_name.values())
    contact_table = scene.contact and replace(scene.contact, pairs="all")
    frequency_key = "omega" if scene.excitation.frequency is None else "frequency"
    return Scene(
        **table_by_name,
        excitation=Excitation(**{frequency_key: getattr(scene.excitation, frequency_key)}),
        contact=contact_table if structure.n_pairs else None,
        harmonic_balance=replace(scene.harmonic_balance),  # with derived values
        reduction=scene.reduction,
    ).as_toml()
