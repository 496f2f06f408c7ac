"""Read structures from other programs' matrix files, and write such files.

The model's input file gives positions of nodes, and a load acts at a node. If the scene has contact
but no gap matrix, coincident nodes without connection in the stiffness become pairs.

Models with solid cells
-----------------------
A facet is on a crack face if it belongs to one cell only, and coincides with another such facet
with other nodes. Pairs are those of :mod:`fenics_crack.fem.build`:

    g_i = 1 / w_i int psi_i (n . u_lower + n . u_upper) ds,      w_i = int psi_i ds,

with psi_i linear, and 1 at a corner that exists twice. Facets are as flat as their corners. Each
normal n points out of its own cell, so the lower face need not be known.

Models without cells
--------------------
Pairs are nodes: g = n . (u_a - u_b) for two coincident nodes. A node connected to u_a only, by the
stiffness, lies on the side of a. A node connected to both lies on the front. The normal n belongs
to the plane through the neighbouring pairs, or to a line in a plane model or shell. It points from
the side of a to the side of b.
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
from fenics_crack.fem.cracks import (
    FACET_CORNERS_BY_CORNER_COUNT,
    RELATIVE_POSITION_TOLERANCE,
    find_unique_rows,
    make_matrix_extending_pressures_to_front,
)
from fenics_crack.fem.model_files import Model, read_model
from fenics_crack.model.factor import local_rows, make_matrix_from_local_rows
from fenics_crack.model.matrices import (
    LabelledMatrix,
    format_matrix_market,
    make_whole_csr_matrix,
    read_matrix,
    read_matrix_market_shape,
)
from fenics_crack.model.modes import count_damped_modes
from fenics_crack.model.nodes import Nodes, Pairs, format_point
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping, Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import FORCE_KEYS, Damping, Excitation
from fenics_crack.scene.tables import Structure as StructureTable

NASTRAN_LETTER_BY_MATRIX = {"mass": "M", "stiffness": "K", "damping": "B"}
"""Letter of each matrix in Nastran's files, which hold several matrices."""
ROW_FILE_KEYS = ("gap", "tangential", *FORCE_KEYS)
"""Keys in ``[structure]`` of files with a row for each dof."""
SCENE_FILE_NAME = "matrices.toml"
"""File name of the scene written by :func:`write_matrices`."""
OUTPUT_FILE_NAMES = (
    *(f"{n}.mtx" for n in (*NASTRAN_LETTER_BY_MATRIX, *ROW_FILE_KEYS, "clearance", "areas")),
    SCENE_FILE_NAME,
)
"""Names of all files that :func:`write_matrices` may write."""
MAX_DENSE_DOFS = 3000
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
        value_of_key, problem_text = getattr(table, error.key), error.value
        path_text = (
            value_of_key if problem_text == value_of_key else f"{value_of_key} ({problem_text})"
        )
        raise InputError(table.full_key(error.key), path_text, error.allowed) from None


def _make_structure(
    scene: Scene, table: StructureTable, damping_rule: DampingRule | None, comm: MPI.Comm
) -> Structure:
    """Make a structure from the files named in ``table`` (collective)."""
    labelled_matrix_by_name, gaps_and_forces_by_name, model = call_on_each_rank(
        comm, lambda: _read_matrices_columns_and_model(table)
    )
    stiffness_matrix = labelled_matrix_by_name["stiffness"].matrix
    structure_fields: dict[str, Any] = {"gap": None, "damping": damping_rule}
    structure_fields |= {
        name: labelled_matrix.matrix for name, labelled_matrix in labelled_matrix_by_name.items()
    }
    n_dofs, row_order = stiffness_matrix.shape[0], np.arange(stiffness_matrix.shape[0])
    pairs, own_nodes, row_labels = Pairs(), None, labelled_matrix_by_name["stiffness"].labels
    if model is not None:
        if row_labels is None:
            requirement = "given: the file with node and direction of each row, for structure.model"
            raise InputError("structure.dofs", None, requirement)
        row_order, node_dofs, node_starts = _order_rows_by_nodes(model, row_labels, table)
        for name in labelled_matrix_by_name:
            structure_fields[name] = structure_fields[name][row_order][:, row_order]
        if scene.contact is not None and table.gap is None:
            has_rotations = bool(np.any(row_labels[:, 1] > 3))
            structure_fields["gap"], pairs = find_gap_matrix_and_pairs(
                model, node_dofs, structure_fields["stiffness"], has_rotations=has_rotations
            )
        first_row, end_row = _own_row_range(node_starts, comm)
        for name in labelled_matrix_by_name:
            structure_fields[name] = make_matrix_from_local_rows(
                structure_fields[name][first_row:end_row], comm
            )
        own_nodes = _own_nodes(model, node_dofs, first_row, end_row, comm)
    structure_fields |= {
        name: gap_or_force[row_order] for name, gap_or_force in gaps_and_forces_by_name.items()
    }
    n_pairs = 0 if structure_fields["gap"] is None else structure_fields["gap"].shape[1]
    structure_fields["clearance"] = _read_number_or_pair_values(
        "clearance", table.clearance, n_pairs
    )
    if table.areas is not None:
        pairs = replace(pairs, areas=_read_number_or_pair_values("areas", table.areas, n_pairs))
    if scene.excitation.point is not None:
        assert own_nodes is not None
        _, point_dofs = own_nodes.find_nearest_position_and_dofs(
            comm, "excitation.point", scene.excitation.point
        )
        for name in FORCE_KEYS:
            force_column = sparse.lil_matrix(structure_fields.get(name, (n_dofs, 1)))
            for dof, force_component in zip(
                point_dofs, getattr(scene.excitation, name), strict=True
            ):
                if dof >= 0:
                    force_column[dof, 0] += force_component
            structure_fields[name] = force_column
    if scene.highest_order > 1:
        excitation_table = scene.excitation
        requirement = "left out with [structure]; its force files can have a column for each order"
        excitation_table.require(
            False, (excitation_table.wave and "wave") or "harmonics", requirement
        )
    return Structure.from_matrices(**structure_fields, comm=comm).with_places(own_nodes, pairs)


def _read_matrices_columns_and_model(
    table: StructureTable,
) -> tuple[dict[str, LabelledMatrix], dict[str, Any], Model | None]:
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
    for name, labelled_matrix in (
        labelled_matrix_by_name.items() if labelled_stiffness.labels is not None else ()
    ):
        with report_read_errors(
            name, getattr(table, name), "a matrix with the same dofs as structure.stiffness"
        ):
            labelled_matrix_by_name[name] = LabelledMatrix(
                labelled_matrix.with_rows_of(labelled_stiffness), labelled_stiffness.labels
            )
    if len(
        massless_rows := np.flatnonzero(labelled_matrix_by_name["mass"].matrix.diagonal() <= 0.0)
    ):
        place_text = f"row {massless_rows[0] + 1}"
        if labelled_stiffness.labels is not None and massless_rows[0] < len(
            labelled_stiffness.labels
        ):
            place_text = "node {}, direction {}".format(
                *labelled_stiffness.labels[massless_rows[0]]
            )
        requirement = "positive definite; give each row a mass > 0, or condense rows without mass"
        raise InputError("mass", f"no mass at {place_text}", requirement)
    if table.model is not None:
        with report_read_errors(
            "model", table.model, "the input file of the program that wrote the matrices"
        ):
            model = read_model(Path(table.model))
    path_by_name = {
        name: path for name in ROW_FILE_KEYS if (path := getattr(table, name)) is not None
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


def _order_rows_by_nodes(
    model: Model, row_labels: np.ndarray, table: StructureTable
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Order the matrices' rows so that rows of a node are neighbours.

    ``row_labels`` (n_dofs, 2) are the node's number and the direction (1 to 6) of each row.

    Returns
    -------
    row_order : (n_dofs,) int
        Old index of each row in the new order.
    node_dofs : (n_nodes, 3) int
        New row of each model node along x, y and z; -1 without such a row.
    node_starts : (n + 1,) int
        First new row of each node with rows, and the number of rows.
    """
    _, first_rows, node_index_of_row = np.unique(
        row_labels[:, 0], return_index=True, return_inverse=True
    )
    row_order = np.argsort(first_rows[node_index_of_row], kind="stable")
    row_labels = row_labels[row_order]
    node_dofs = np.full((len(model.labels), 3), -1)
    model_node_of_row = np.minimum(
        np.searchsorted(model.labels, row_labels[:, 0]), len(model.labels) - 1
    )
    is_known = model.labels[model_node_of_row] == row_labels[:, 0]
    is_translation = is_known & (row_labels[:, 1] >= 1) & (row_labels[:, 1] <= 3)
    # Label 0 is no node, but a coordinate.
    missing_nodes = row_labels[~is_known & (row_labels[:, 1] >= 1), 0]
    if len(missing_nodes) or not np.any(is_translation):
        problem_text = (
            f"node {missing_nodes[0]} is missing"
            if len(missing_nodes)
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
    """Return start and stop of this rank's rows, ordered by nodes.

    Nodes are not divided; all ranks have about equally many rows. ``node_starts`` (n + 1,) comes
    from :func:`_order_rows_by_nodes`.
    """
    target_rows = node_starts[-1] * np.array([comm.rank, comm.rank + 1]) // comm.size
    start, stop = node_starts[np.searchsorted(node_starts, target_rows)]
    return int(start), int(stop)


def _own_nodes(model: Model, node_dofs: np.ndarray, start: int, stop: int, comm: MPI.Comm) -> Nodes:
    """Return the nodes of this rank's rows ``start`` to ``stop``, with cells for drawing.

    Rank 0 also has nodes without dofs, and all cells. Cells are kept if all are of a single kind
    except wedges, and every row is a translation of a model node.
    """
    nodes_have_all_dofs = int(np.count_nonzero(node_dofs >= 0)) == comm.allreduce(stop - start)
    vtk_type = (
        next(iter(model.cells_by_vtk_type))
        if len(model.cells_by_vtk_type) == 1 and nodes_have_all_dofs
        else 0
    )
    vtk_type = 0 if vtk_type in (13, 26) else vtk_type  # VTK's wedges are not drawn
    cells = model.cells_by_vtk_type[vtk_type] if vtk_type else np.zeros((0, 1), dtype=int)
    highest_rows = node_dofs.max(axis=1)
    is_used = highest_rows >= 0
    is_used[cells] = True
    owner_rank = np.array(comm.allgather(stop)).searchsorted(highest_rows, side="right")
    node_order = np.lexsort((np.arange(len(node_dofs)), np.where(highest_rows < 0, 0, owner_rank)))
    node_order = node_order[is_used[node_order]]
    new_numbers = np.empty(len(node_dofs), dtype=int)
    new_numbers[node_order] = np.arange(len(node_order))
    own_nodes = node_order[
        np.where(highest_rows[node_order] < 0, 0, owner_rank[node_order]) == comm.rank
    ]
    renumbered_cells = (
        new_numbers[cells] if comm.rank == 0 else np.zeros((0, cells.shape[1]), dtype=int)
    )
    return Nodes(model.points[own_nodes], node_dofs[own_nodes], renumbered_cells, vtk_type)


def _read_number_or_pair_values(name: str, number_or_path: float | str, n_pairs: int) -> Any:
    """Return a setting that is a number, or read a value per pair (n_pairs,) from a file.

    ``name`` is the key for errors. Without pairs a file is not read, and the result is 0.
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

    The bound is the gap file's number of columns, else the model's number of coincident nodes. The
    result is 0 if the table has neither, or the file cannot be read.
    """
    path = table.gap or table.model
    if path is None:
        return 0
    try:
        with report_read_errors("structure.gap", path, "a file that can be read"):
            if table.gap is not None:
                return read_matrix_market_shape(Path(table.gap))[1]
            return len(find_coincident_node_pairs(read_model(Path(path)).points))
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
            name: sparse.vstack(local_matrix)
            for name, local_matrix in gathered_parts_by_name.items()
        }
        if isinstance(structure.damping, ModalDamping) and structure.n_dofs <= MAX_DENSE_DOFS:
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
                field_name: value
                for field_name, value in vars(damping_rule).items()
                if value is not None
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


# --- contact pairs of a model ---------------------------------------------------------------------

FACETS_BY_CORNER_COUNT = {
    4: [FACET_CORNERS_BY_CORNER_COUNT[4]], 8: [FACET_CORNERS_BY_CORNER_COUNT[8]],
    6: [np.array([[0, 1, 2], [3, 4, 5]]), np.array([[0, 1, 4, 3], [1, 2, 5, 4], [2, 0, 3, 5]])],
}  # fmt: skip
"""Corners of a cell's facets, by the cell's number of corners: triangles, then quadrilaterals."""
N_CORNERS_BY_VTK_TYPE = {10: 4, 24: 4, 13: 6, 26: 6, 12: 8, 25: 8}
"""Number of corners of a cell, by VTK's cell type."""
CELL_EDGES_BY_CORNER_COUNT = {
    4: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    6: [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    8: [*((i, (i + 1) % 4) for i in range(4)), *((4 + i, 4 + (i + 1) % 4) for i in range(4)),
        *((i, 4 + i) for i in range(4))],
}  # fmt: skip
"""Edges between a cell's corners, in VTK's order of middle nodes."""


def find_coincident_node_pairs(points: np.ndarray) -> np.ndarray:
    """Return pairs of nodes at the same position, as indices: (n, 2) int.

    The tolerance is 1e-6 of the model's largest extent.
    """
    from scipy.spatial import cKDTree  # slow to import, and only foreign models need it

    tolerance = RELATIVE_POSITION_TOLERANCE * float(np.ptp(points, axis=0).max())
    node_pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    return np.asarray(node_pairs[np.lexsort(node_pairs.T[::-1])])


class _TwinNodes:
    """Pairs of coincident nodes of a model that the stiffness does not connect.

    Attributes
    ----------
    points : (n_nodes, 3) [m]
        Positions of all nodes.
    dofs : (n_nodes, 3) int
        Row of each node along x, y, z in the matrices; -1 without a row.
    n_dofs : int
        Number of rows of the matrices.
    first_nodes, second_nodes : (n_pairs,) int
        Both nodes of each pair.
    pair_index : (n_nodes,) int
        Index of each node's pair; -1 for all other nodes.
    place_numbers : (n_nodes,) int
        Number of each node's position, equal for coincident nodes.
    connectivity : (n_nodes, n_nodes) bool
        True if the stiffness connects two nodes.
    is_in_half_held_pair : (n_nodes,) bool
        True for two coincident nodes of which a single one has dofs. The other node is clamped, or
        tied by equations.
    """

    def __init__(self, model: Model, dofs: np.ndarray, stiffness: sparse.csr_matrix) -> None:
        n_model_nodes, node_pairs = len(dofs), find_coincident_node_pairs(model.points)
        self.points, self.dofs, self.n_dofs = model.points, dofs, stiffness.shape[0]
        node_of_row = np.full(self.n_dofs, n_model_nodes)
        node_of_row[dofs[dofs >= 0]] = np.nonzero(dofs >= 0)[0]
        stiffness_coo = stiffness.tocoo()
        node_links = node_of_row[stiffness_coo.row].astype(np.int64), node_of_row[stiffness_coo.col]
        link_values_and_indices = np.ones(len(stiffness_coo.data), bool), node_links
        self.connectivity = sparse.csr_matrix(
            link_values_and_indices, (n_model_nodes + 1, n_model_nodes + 1)
        )[:n_model_nodes, :n_model_nodes]
        is_free_node = np.any(dofs >= 0, axis=1)
        is_contact_pair = is_free_node[node_pairs].all(axis=1) & ~np.isin(
            n_model_nodes * node_pairs[:, 0] + node_pairs[:, 1],
            n_model_nodes * node_links[0] + node_links[1],
        )
        self.place_numbers = np.arange(n_model_nodes)
        self.place_numbers[node_pairs[:, 1]] = node_pairs[:, 0]
        self.is_in_half_held_pair = np.zeros(n_model_nodes, dtype=bool)
        self.is_in_half_held_pair[
            node_pairs[is_free_node[node_pairs[:, 0]] != is_free_node[node_pairs[:, 1]]]
        ] = True
        self.first_nodes, self.second_nodes = node_pairs[is_contact_pair].T
        unique_paired_nodes, n_pairs_of_node = np.unique(
            np.append(self.first_nodes, self.second_nodes), return_counts=True
        )
        if np.any(n_pairs_of_node > 1):
            worst_node = unique_paired_nodes[np.argmax(n_pairs_of_node)]
            place_text = format_point(model.points[worst_node], "g")
            place_text += f", one of them is node {model.labels[worst_node]}"
            requirement = (
                "a model with two nodes at each place of a crack, as cracks neither branch"
                " nor cross"
            )
            raise InputError("model", f"more than two nodes at {place_text}", requirement)
        if not len(self.first_nodes):
            problem_text = (
                f"{len(node_pairs)} pairs of nodes at the same place, all connected or clamped"
            )
            raise InputError(
                "model",
                problem_text,
                "a model with two nodes at each place of a crack, free and not connected",
            )
        self.pair_index = np.full(n_model_nodes, -1)
        self.pair_index[self.first_nodes] = self.pair_index[self.second_nodes] = np.arange(
            len(self.first_nodes)
        )


def find_gap_matrix_and_pairs(
    model: Model, dofs: np.ndarray, stiffness: sparse.csr_matrix, *, has_rotations: bool
) -> tuple[sparse.csr_matrix, Pairs]:
    """Find a model's contact pairs, crack by crack, from front to mouth.

    Parameters
    ----------
    model : Model
        Model with n nodes.
    dofs : (n, 3) int
        Row of each node along x, y, z in the stiffness; -1 without a row.
    stiffness : (n_dofs, n_dofs)
        Stiffness; an entry connects two nodes.
    has_rotations : bool
        True if nodes have rotations, as in shells. Crack faces are then lines, not surfaces.

    Returns
    -------
    gap : (n_dofs, n_pairs)
        Matrix B from the displacement u to the gaps B^T u.
    pairs : Pairs
        Positions, areas (None without cells) and crack of each pair.

    Raises
    ------
    InputError
        There are no coincident nodes, three nodes coincide, or both nodes of a pair lie on the same
        side.
    """
    twins = _TwinNodes(model, dofs, stiffness)
    facets = _crack_face_facets(model, twins)
    if facets:
        gap, areas, twin_pair_index, front_nodes = _assemble_patch_gap_matrix(twins, facets)
    else:
        has_surface_cracks = not has_rotations and np.all(np.any(dofs >= 0, axis=0))
        gap, front_nodes = _assemble_normal_gap_matrix(twins, 2 if has_surface_cracks else 1)
        areas, twin_pair_index = None, np.arange(len(twins.first_nodes))
    points = model.points[twins.first_nodes[twin_pair_index]]
    crack_of_pair = _find_crack_of_each_pair(twins, twin_pair_index)
    front_distances = np.zeros(len(twin_pair_index))
    if len(front_nodes):
        from scipy.spatial import cKDTree

        front_distances = cKDTree(model.points[front_nodes]).query(points)[0]
    pair_order = np.lexsort((front_distances, crack_of_pair))
    crack_of_pair, front_distances = crack_of_pair[pair_order], front_distances[pair_order]
    mouth_pairs = np.flatnonzero(np.append(np.diff(crack_of_pair), 1))
    mouth_names = [
        f"the mouth of crack {crack_number + 1}" if len(mouth_pairs) > 1 else "the mouth"
        for crack_number in crack_of_pair[mouth_pairs]
    ]
    contact_pairs = Pairs(
        points[pair_order], None if areas is None else areas[pair_order], crack_of_pair,
        front_distances,
        dict(zip(mouth_names, mouth_pairs.tolist(), strict=True)),
    )  # fmt: skip
    return gap[:, pair_order], contact_pairs


def _find_crack_of_each_pair(twins: _TwinNodes, twin_pair_index: np.ndarray) -> np.ndarray:
    """Return the crack number of each pair: (n_pairs,) int.

    Pairs whose nodes the stiffness connects, on both faces, are on the same crack. Cracks are
    numbered from 0, from bottom to top. ``twin_pair_index`` selects pairs of ``twins``.
    """
    from scipy.sparse.csgraph import connected_components

    # A first node may be on either face.
    first_node_of_pair = twins.first_nodes[twin_pair_index]
    second_node_of_pair = twins.second_nodes[twin_pair_index]
    links_in_same_order = twins.connectivity[first_node_of_pair][:, first_node_of_pair].multiply(
        twins.connectivity[second_node_of_pair][:, second_node_of_pair]
    )
    pair_links = links_in_same_order + twins.connectivity[first_node_of_pair][
        :, second_node_of_pair
    ].multiply(twins.connectivity[second_node_of_pair][:, first_node_of_pair])
    n_cracks, unsorted_crack_of_pair = connected_components(pair_links)
    crack_centres = [
        twins.points[first_node_of_pair[unsorted_crack_of_pair == unsorted_crack]].mean(axis=0)[
            [1, 0, 2]
        ]
        for unsorted_crack in range(n_cracks)
    ]
    sorted_crack_number = np.empty(n_cracks, dtype=int)
    sorted_crack_number[
        sorted(range(n_cracks), key=lambda unsorted_crack: tuple(crack_centres[unsorted_crack]))
    ] = np.arange(n_cracks)
    return np.asarray(sorted_crack_number[unsorted_crack_of_pair])


# --- of facets ------------------------------------------------------------------------------------

Facets = tuple[np.ndarray, np.ndarray]
"""Facets of cells: nodes (m, 2 k), and centres of the facets' cells (m, 3) [m].

The nodes are k corners, then the middle nodes of k edges, or -1 for cells of order 1.
"""


def _crack_face_facets(model: Model, twins: _TwinNodes) -> list[Facets]:
    """Return the facets on crack faces: triangles, then quadrilaterals; empty without any.

    A facet is on a crack face if a single cell has it, exactly two such facets coincide, and a
    corner is in a pair. Facets with half-held pairs are left out.
    """
    facet_sets = []
    for n_facet_corners in (3, 4):
        facets_and_centres_of_kinds = [
            _cell_facets_and_cell_centres(
                model.points, cells, N_CORNERS_BY_VTK_TYPE[vtk_type], local_facets
            )
            for vtk_type, cells in model.cells_by_vtk_type.items()
            for local_facets in FACETS_BY_CORNER_COUNT[N_CORNERS_BY_VTK_TYPE[vtk_type]]
            if local_facets.shape[1] == n_facet_corners
        ]
        if not facets_and_centres_of_kinds:
            continue
        facet_nodes, cell_centres = (
            np.concatenate(same_field_arrays)
            for same_field_arrays in zip(*facets_and_centres_of_kinds, strict=True)
        )
        is_boundary = _row_multiplicities(facet_nodes[:, :n_facet_corners]) == 1
        is_on_crack = is_boundary.copy()
        is_on_crack[is_boundary] = (
            _row_multiplicities(twins.place_numbers[facet_nodes[is_boundary, :n_facet_corners]])
            == 2
        )
        is_on_crack &= np.any(twins.pair_index[facet_nodes[:, :n_facet_corners]] >= 0, axis=1)
        is_on_crack &= ~np.any(twins.is_in_half_held_pair[facet_nodes] & (facet_nodes >= 0), axis=1)
        if np.any(is_on_crack):
            facet_sets.append((facet_nodes[is_on_crack], cell_centres[is_on_crack]))
    return facet_sets


def _cell_facets_and_cell_centres(
    points: np.ndarray, cells: np.ndarray, n_corners: int, local_facets: np.ndarray
) -> Facets:
    """Return the facets of all cells of the same kind, with the cells' centres.

    ``cells`` (n, k) are nodes, ``n_corners`` corners first. ``local_facets`` (m, n_facet_corners)
    are the columns of each facet's corners in ``cells``.
    """
    n_facet_corners = local_facets.shape[1]
    middle_column_by_edge = {
        frozenset(edge): n_corners + edge_index
        for edge_index, edge in enumerate(CELL_EDGES_BY_CORNER_COUNT[n_corners])
    }
    edge_ends = np.stack([local_facets, np.roll(local_facets, -1, axis=1)], axis=2)
    facet_middle_columns = np.array(
        [[middle_column_by_edge[frozenset(edge)] for edge in facet] for facet in edge_ends.tolist()]
    )
    facet_nodes = np.full((len(cells), len(local_facets), 2 * n_facet_corners), -1)
    facet_nodes[..., :n_facet_corners] = cells[:, local_facets]
    if cells.shape[1] > n_corners:
        facet_nodes[..., n_facet_corners:] = cells[:, facet_middle_columns]
    cell_centres_of_facets = np.repeat(
        points[cells[:, :n_corners]].mean(axis=1), len(local_facets), axis=0
    )
    return facet_nodes.reshape(-1, 2 * n_facet_corners), cell_centres_of_facets


def _row_multiplicities(rows: np.ndarray) -> np.ndarray:
    """Return how often each row of nodes occurs among all rows: (n,) int.

    The order of nodes in a row does not matter.
    """
    _, index_of_unique_row, counts = find_unique_rows(rows)
    return np.asarray(counts[index_of_unique_row])


def _facet_basis(n_corners: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate the basis functions of a facet with k corners at Gauss points.

    k = ``n_corners`` is 3 or 4. The Gauss rule has 3 x 3 points.

    Returns
    -------
    weighted_functions : (2, k, n_points)
        Linear functions of the corners, then quadratic functions of the edge middles, both times
        the Gauss weights.
    linear : (k, n_points)
        Linear functions of the corners.
    slopes : (2, k, n_points)
        Derivatives of the linear functions by the facet's two coordinates.
    """
    gauss_points, gauss_weights = (
        0.5 * coordinates for coordinates in np.polynomial.legendre.leggauss(3)
    )
    r, s = (
        coordinates.ravel() for coordinates in np.meshgrid(gauss_points + 0.5, gauss_points + 0.5)
    )
    point_weights = np.outer(gauss_weights, gauss_weights).ravel()
    if n_corners == 3:
        s, point_weights = s * (1.0 - r), point_weights * (1.0 - r)
        linear_functions = np.array([1.0 - r - s, r, s])
        linear_function_slopes = np.broadcast_to(
            [[[-1.0], [1.0], [0.0]], [[-1.0], [0.0], [1.0]]], (2, 3, len(r))
        )
        edge_functions = 4.0 * linear_functions * np.roll(linear_functions, -1, axis=0)
    else:
        linear_functions = np.array([(1 - r) * (1 - s), r * (1 - s), r * s, (1 - r) * s])
        linear_function_slopes = np.array([[s - 1, 1 - s, s, -s], [r - 1, -r, r, 1 - r]])
        edge_end_functions = linear_functions, np.roll(linear_functions, -1, axis=0)
        edge_functions = (
            4.0
            * edge_end_functions[0]
            * edge_end_functions[1]
            / (edge_end_functions[0] + edge_end_functions[1])
        )
    return (
        point_weights * np.stack([linear_functions, edge_functions]),
        linear_functions,
        linear_function_slopes,
    )


def _assemble_patch_gap_matrix(
    twins: _TwinNodes, facets: list[Facets]
) -> tuple[sparse.csr_matrix, np.ndarray, np.ndarray, np.ndarray]:
    """Assemble normal gaps from the facets of crack faces, averaged over patches.

    Each pair of corner nodes has a patch: the facets with a nonzero linear pressure function.

    Returns
    -------
    gap : (n_dofs, n)
        Matrix B from the displacement u to the gaps B^T u.
    areas : (n,) [m^2]
        Areas of the patches.
    twin_pair_index : (n,) int
        Index in ``twins`` of the pair at each patch's centre.
    front_nodes : (m,) int
        Corner nodes on the crack fronts.
    """
    n_pairs = len(twins.first_nodes)
    corner_nodes = [nodes[:, : nodes.shape[1] // 2] for nodes, _ in facets]
    all_face_nodes = np.unique(np.concatenate([nodes.ravel() for nodes in corner_nodes]))
    front_nodes = all_face_nodes[twins.pair_index[all_face_nodes] < 0]
    patch_index = twins.pair_index.copy()
    # Patches of front nodes go to their neighbours.
    patch_index[front_nodes] = n_pairs + np.arange(len(front_nodes))
    gap_triplets: list[tuple[np.ndarray, ...]] = []
    overlap_triplets: list[tuple[np.ndarray, ...]] = []
    areas = np.zeros(n_pairs + len(front_nodes))
    for nodes, cell_centres in facets:
        n_corners = nodes.shape[1] // 2
        (linear, edge_functions), pressure_basis, slopes = _facet_basis(n_corners)
        corner_points = twins.points[nodes[:, :n_corners]]
        position_slope_1, position_slope_2 = np.einsum("akq,fkx->afqx", slopes, corner_points)
        area_normals = np.cross(position_slope_1, position_slope_2)
        is_inward = (
            np.einsum("fqx,fx->f", area_normals, corner_points.mean(axis=1) - cell_centres) < 0.0
        )
        area_normals[is_inward] *= -1.0
        surface_jacobians = np.linalg.norm(area_normals, axis=2)
        corner_patches = patch_index[nodes[:, :n_corners]]
        np.add.at(areas, corner_patches, 0.5 * np.einsum("kq,fq->fk", linear, surface_jacobians))
        integrals = np.einsum("iq,jq,fq->fij", pressure_basis, linear, surface_jacobians)
        row_patches, column_patches = np.broadcast_arrays(
            corner_patches[:, :, None], corner_patches[:, None]
        )
        overlap_triplets.append((integrals.ravel(), row_patches.ravel(), column_patches.ravel()))
        # A quadratic corner function is the linear one less half of its two edge functions.
        half_edge_functions = 0.5 * (edge_functions + np.roll(edge_functions, 1, axis=0))
        is_quadratic = np.all(nodes[:, n_corners:] >= 0, axis=1)[:, None, None]
        corner_integrals = np.einsum("iq,jq,fqx->fijx", pressure_basis, linear, area_normals)
        corner_integrals -= (
            np.einsum("iq,jq,fqx->fijx", pressure_basis, half_edge_functions, area_normals)
            * is_quadratic[..., None]
        )
        edge_integrals = (
            np.einsum("iq,jq,fqx->fijx", pressure_basis, edge_functions, area_normals)
            * is_quadratic[..., None]
        )
        # Axes: facet, pressure, node, direction.
        integrals = np.concatenate([corner_integrals, edge_integrals], axis=2)
        rows = np.broadcast_to(twins.dofs[nodes][:, None], integrals.shape)
        patch_columns = np.broadcast_to(corner_patches[:, :, None, None], integrals.shape)
        is_kept_entry = (rows >= 0) & (integrals != 0.0)
        gap_triplets.append(
            (integrals[is_kept_entry], rows[is_kept_entry], patch_columns[is_kept_entry])
        )
    integrals, rows, patch_columns = map(np.concatenate, zip(*gap_triplets, strict=True))
    gap = sparse.csr_matrix((integrals, (rows, patch_columns)), (twins.n_dofs, len(areas)))
    integrals, rows, patch_columns = map(np.concatenate, zip(*overlap_triplets, strict=True))
    overlap_matrix = sparse.csr_matrix((integrals, (rows, patch_columns)), (len(areas), len(areas)))
    front_shares = make_matrix_extending_pressures_to_front(overlap_matrix[n_pairs:, :n_pairs])
    areas = front_shares.T @ areas
    twin_pair_index = np.flatnonzero(areas)
    gap = (gap @ front_shares)[:, twin_pair_index] @ sparse.diags(1.0 / areas[twin_pair_index])
    return gap.tocsr(), areas[twin_pair_index], twin_pair_index, front_nodes


# --- of nodes -------------------------------------------------------------------------------------


def _assemble_normal_gap_matrix(
    twins: _TwinNodes, crack_dimension: int
) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Assemble normal gaps between coincident nodes, for a model without cells.

    ``crack_dimension`` is 2 if crack faces are surfaces, 1 if they are lines.

    Returns
    -------
    gap : (n_dofs, n_pairs)
        Matrix B from the displacement u to the gaps B^T u.
    front_nodes : (m,) int
        Nodes connected to both nodes of a pair: the crack fronts.
    """
    model_points = twins.points
    gap_matrix = sparse.lil_matrix((twins.n_dofs, len(twins.first_nodes)))
    front_nodes: list[np.ndarray] = []
    model_extent = float(np.ptp(model_points, axis=0).max())
    for pair_column, (a, b) in enumerate(zip(twins.first_nodes, twins.second_nodes, strict=True)):
        linked_nodes_of_both = [twins.connectivity[pair_node].indices for pair_node in (a, b)]
        front_nodes.append(np.intersect1d(*linked_nodes_of_both))
        nearby_crack_nodes = np.unique(np.concatenate(linked_nodes_of_both))
        nearby_crack_nodes = np.append(
            nearby_crack_nodes[twins.pair_index[nearby_crack_nodes] >= 0], front_nodes[-1]
        )
        if len(np.unique(twins.place_numbers[nearby_crack_nodes])) <= crack_dimension:
            nearby_crack_nodes = twins.first_nodes
        centred_points = model_points[nearby_crack_nodes] - model_points[nearby_crack_nodes].mean(
            axis=0
        )
        tangents = np.linalg.svd(centred_points, full_matrices=False)[2][:crack_dimension]
        pair_normal = model_points[linked_nodes_of_both[1]].mean(axis=0) - model_points[
            linked_nodes_of_both[0]
        ].mean(axis=0)
        pair_normal -= tangents.T @ (tangents @ pair_normal)
        if np.linalg.norm(pair_normal) <= RELATIVE_POSITION_TOLERANCE * model_extent:
            place_text = format_point(model_points[a], "g")
            requirement = (
                "a crack with material on both sides; or give a model file that has the elements"
            )
            raise InputError(
                "model", f"two nodes at {place_text} that lie on the same side", requirement
            )
        pair_normal /= np.linalg.norm(pair_normal)
        for pair_node, face_sign in ((a, 1.0), (b, -1.0)):
            for dof, normal_component in zip(
                twins.dofs[pair_node], face_sign * pair_normal, strict=True
            ):
                if dof >= 0 and abs(normal_component) > RELATIVE_POSITION_TOLERANCE:
                    gap_matrix[dof, pair_column] = normal_component
    return gap_matrix.tocsr(), np.unique(np.concatenate(front_nodes))
