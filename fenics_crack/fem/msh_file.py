"""Read mesh files with gmsh in a separate process, and check them.

gmsh runs an unknown file as a script, chooses the format by the file's name, and runs ``NAME.opt``
beside the file. So gmsh gets a copy with a fixed name, alone in a folder, and only if the file
begins as a mesh does.

A mesh has nodes, cells and named facets: curves of a plate, or surfaces of a solid. Nodes along a
crack are doubled by :mod:`fenics_crack.fem.cracks`, even if gmsh's plugin "Crack" has doubled them
already. Every cell, facet and point is put into gmsh's current model once. Facets with several
names get a physical group for each combination of names.

A mesh that cannot be a structure is refused, and the error names the position. Three conditions are
checked:

- Cells are not folded: all Jacobian determinants at the nodes of a cell have the same sign. Cells
  may be numbered in either direction.
- Two cells with a common facet lie on either side of it.
- Parts do not overlap, and share their nodes where they touch. So no boundary facet, except those
  of crack faces, has its centre in or on another cell. The same holds for the points halfway
  between centre and corners.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fenics_crack.basics.errors import InputError, report_read_errors
from fenics_crack.basics.gmsh_process import gmsh
from fenics_crack.basics.untrusted_files import (
    copy_to_temporary_folder,
    read_first_bytes,
    run_reader_for_arrays,
)
from fenics_crack.fem.cracks import (
    CRACK_FACE_NAMES,
    FACET_CORNERS_BY_CORNER_COUNT,
    RELATIVE_POSITION_TOLERANCE,
    Cells,
    Cracks,
    NamedParts,
    are_rows_in,
    check_mesh,
    find_crack_paths,
    find_crack_surfaces,
    find_unique_rows,
    label_connected_rows,
    merge_crack_nodes,
    split_cracks,
)
from fenics_crack.model.nodes import format_point

Group = tuple[int, int, str, int, np.ndarray]
"""Group of elements: dimension, tag, name, gmsh's kind of elements, and node numbers."""
RawMesh = tuple[np.ndarray, np.ndarray, list[Group]]
"""Mesh as in a file: numbers (n,) and positions (n, 3) [m] of all nodes, and the groups."""
CRACK_NAME_PATTERN = re.compile(r"crack([ _.-]?\d+)?$", re.IGNORECASE)
"""Pattern for group names of cracks: "crack" or with a number, as "crack 1"."""

_MESH_HEADER_PATTERN = re.compile(
    rb"\$MeshFormat[ \t]*\r?\n[ \t]*(2|2\.[0-2]|4|4\.[01])[ \t]+[01][ \t]+8\s"
)
"""First bytes of a mesh file in gmsh's format 2 or 4, text or binary."""
_FACET_KIND_BY_CELL_KIND = {
    2: {2: 1, 3: 1, 9: 8, 10: 8, 21: 26, 36: 26},
    3: {4: 2, 11: 9, 5: 3, 12: 10},
}
"""gmsh's kind of facets, by dimension and gmsh's kind of cells. Other cells cannot be read."""
_POINT_KIND = 15
"""gmsh's kind of a point element."""
_LINEAR_KIND_BY_SHAPE = {(2, 3): 2, (2, 4): 3, (3, 4): 4, (3, 8): 5}
"""gmsh's kind of first-order cells, for each dimension and number of corners."""
_CELL_REQUIREMENT_AND_FACET_WORD_BY_DIMENSION = {
    2: ("surfaces hold one kind of cells, triangles or quadrilaterals", "curve"),
    3: ("volumes hold one kind of cells, tetrahedra or hexahedra", "surface"),
}
"""Texts for errors, by dimension: required contents of cell groups, and word for a facet group."""
_FACET_WORD_BY_DIMENSION = {2: "an edge", 3: "a facet"}
"""Word for a facet in errors, by dimension."""


def read_mesh_into_gmsh(path: Path, dimension: int) -> tuple[NamedParts, Cracks]:
    """Read a mesh file into gmsh's current model.

    ``dimension`` is 2 for a plate, 3 for a solid.

    Returns
    -------
    NamedParts
        gmsh's group tags for named curves or surfaces, and positions of named points. A name with
        several points has no position.
    Cracks
        Cracks sorted from bottom to top.

    Raises
    ------
    InputError
        The file is damaged, has several kinds of cells, or lacks a group. Or a crack's faces cannot
        be found.
    """
    try:
        return load_mesh_into_gmsh(_read_raw_mesh(path), dimension)
    except InputError as error:
        if error.key in ("mesh.file", "lips"):
            raise
        raise InputError("mesh.file", f"{path} ({error.value})", error.allowed) from None


def load_mesh_into_gmsh(raw_mesh: RawMesh, dimension: int) -> tuple[NamedParts, Cracks]:
    """Check a mesh, split the cracks, and load the mesh into gmsh's current model.

    ``dimension`` is 2 for a plate, 3 for a solid.

    Returns
    -------
    NamedParts
        gmsh's group tags for named curves or surfaces, and positions of named points. A name with
        several points has no position.
    Cracks
        Cracks sorted from bottom to top.

    Raises
    ------
    InputError
        The mesh has several kinds of cells, or lacks a group. Or a crack's faces cannot be found.
        The key in the error is "mesh".
    """
    kind, cells, positions, facets_by_name, point_groups = _select_cells(raw_mesh, dimension)
    mesh_positions = positions[:, :dimension]
    check_cells(kind, cells, mesh_positions)
    crack_names = [name for name in facets_by_name if CRACK_NAME_PATTERN.match(name)]
    if dimension == 3:
        _check_inner_surfaces_are_cracks(cells, facets_by_name, crack_names)
    if crack_names:
        crack_facets = np.concatenate([facets_by_name.pop(name) for name in crack_names])
        nodes_kept_by_merge, merged_node_map = merge_crack_nodes(crack_facets, mesh_positions)
        cells_with_merged_nodes = replace(cells, cell_nodes=merged_node_map[cells.cell_nodes])
        split_cell_nodes, copied_nodes, face_facet_pairs = split_cracks(
            cells_with_merged_nodes,
            merged_node_map[crack_facets],
            mesh_positions[nodes_kept_by_merge],
        )
        facets_by_name = _renumber_facets_after_split(
            facets_by_name, cells, split_cell_nodes, merged_node_map
        )
        for name, crack_face_facets in zip(
            CRACK_FACE_NAMES, face_facet_pairs.swapaxes(0, 1), strict=True
        ):
            facets_by_name[name] = np.concatenate(
                [facets_by_name.get(name, crack_face_facets[:0]), crack_face_facets]
            )
        point_groups = [
            (*group_head, merged_node_map[group_nodes]) for *group_head, group_nodes in point_groups
        ]
        positions = positions[
            np.concatenate([nodes_kept_by_merge, nodes_kept_by_merge[copied_nodes]])
        ]
        cells = replace(cells, cell_nodes=split_cell_nodes)
        mesh_positions = positions[:, :dimension]
    crack_face_facet_corners = [
        facets_by_name[name][:, : cells.facet_corner_columns.shape[1]]
        for name in CRACK_FACE_NAMES
        if name in facets_by_name
    ]
    requirement = (
        "a mesh with both 'lower_lip' and 'upper_lip', or with 'crack', or without a crack"
    )
    check_mesh(len(crack_face_facet_corners) != 1, "one lip", requirement)
    crack_paths_or_surfaces: Cracks = ()
    if crack_face_facet_corners and dimension == 2:
        crack_paths_or_surfaces = find_crack_paths(
            crack_face_facet_corners[0], crack_face_facet_corners[1], mesh_positions
        )
        _check_mouths_are_open(cells, mesh_positions, crack_face_facet_corners)
    elif crack_face_facet_corners:
        crack_paths_or_surfaces = find_crack_surfaces(
            crack_face_facet_corners[0], crack_face_facet_corners[1], mesh_positions
        )
    check_parts_are_clamped(
        cells, mesh_positions, facets_by_name["clamp"], crack_face_facet_corners
    )
    check_parts_do_not_overlap(kind, cells, mesh_positions, crack_face_facet_corners)
    tags_by_name, facet_groups = _tag_name_combinations(facets_by_name)
    cell_and_facet_groups = [
        (dimension, 1, ("plate", "solid")[dimension - 2], kind, cells.cell_nodes)
    ]
    cell_and_facet_groups += [
        (dimension - 1, tag, name, _FACET_KIND_BY_CELL_KIND[dimension][kind], group_nodes)
        for tag, name, group_nodes in facet_groups
    ]
    _fill_gmsh_model(positions, cell_and_facet_groups + point_groups)
    positions_by_point_name = {
        name: np.unique(mesh_positions[group_nodes], axis=0)
        for _, _, name, _, group_nodes in point_groups
    }
    point_by_name = {
        name: tuple(positions[0].tolist())
        for name, positions in positions_by_point_name.items()
        if len(positions) == 1
    }
    return (tags_by_name, point_by_name), crack_paths_or_surfaces


# --- contents of a file ---------------------------------------------------------------------------


def _read_raw_mesh(path: Path) -> RawMesh:
    """Read nodes and groups from a gmsh file, in a separate process.

    Raises
    ------
    InputError
        The file does not exist, gmsh cannot read it, or a node is more than 1e6 m from the
        origin.
    """
    check_file_exists("mesh.file", path)
    with (
        report_read_errors("mesh.file", path, "a mesh file that gmsh can read"),
        copy_to_temporary_folder(path, "mesh.msh") as file_copy,
    ):
        if not _MESH_HEADER_PATTERN.match(read_first_bytes(file_copy, 100)):
            raise ValueError("it does not begin with $MeshFormat and version 2.2 or 4.1")
        contents = run_reader_for_arrays(
            Path(__file__).with_name("solid_mesher.py"), file_copy, 300
        )
        if isinstance(contents, str):
            raise ValueError(contents.replace(str(file_copy), str(path)))
    max_allowed_coordinate = 1e6  # [m]
    if not np.all(np.abs(contents["positions"]) < max_allowed_coordinate):
        requirement = f"a mesh whose nodes are within {max_allowed_coordinate:g} m of the origin"
        raise InputError("mesh.file", str(path), requirement)
    return contents["numbers"], contents["positions"], unpack_groups(contents)


def check_file_exists(key: str, path: Path | str) -> None:
    """Raise InputError for ``key`` unless a regular file exists."""
    if not os.path.isfile(path):
        raise InputError(key, str(path), "an existing gmsh mesh file")


def unpack_groups(contents: dict[str, np.ndarray]) -> list[Group]:
    """Convert a mesh's arrays to a list of groups.

    ``contents`` has the arrays "heads", "names" and "nodes" of
    :func:`~fenics_crack.fem.solid_mesher.collect_nodes_and_groups`. A result is (dimension, tag,
    name, gmsh's kind of elements, node numbers). If gmsh's group has several kinds of elements or
    several entities, there is a result for each.
    """
    group_nodes = np.split(contents["nodes"], np.cumsum(contents["heads"][:, 3])[:-1])
    heads_names_and_nodes = zip(
        contents["heads"].tolist(), contents["names"].tolist(), group_nodes, strict=False
    )
    return [
        (dimension, tag, name, kind, nodes)
        for (dimension, tag, kind, _), name, nodes in heads_names_and_nodes
    ]


def _select_cells(
    raw_mesh: RawMesh, dimension: int
) -> tuple[int, Cells, np.ndarray, dict[str, np.ndarray], list[Group]]:
    """Select a mesh's cells, named facets and named points, and number the nodes from 0.

    Nodes without cells are dropped. A cell in several groups is kept once. ``dimension`` is 2 for a
    plate, 3 for a solid.

    Returns
    -------
    kind : int
        gmsh's number for the cell type.
    cells : Cells
        The cells.
    positions : (n_nodes, 3) [m]
        Node positions.
    facets_by_name : dict of str to (m, k) int
        Nodes of the facets with each name, "clamp" included.
    point_groups : list of Group
        Groups of named points.

    Raises
    ------
    InputError
        Cells are of several kinds, or no facets are named "clamp".
    """
    node_numbers, positions, groups = raw_mesh
    cells_requirement, facet_group_word = _CELL_REQUIREMENT_AND_FACET_WORD_BY_DIMENSION[dimension]
    if dimension == 2:
        is_flat = len(positions) > 0 and np.ptp(positions[:, 2]) == 0.0
        check_mesh(is_flat, "no plane mesh", "a plane mesh, with the same z at every node")
    cell_kinds = {kind for group_dimension, _, _, kind, _ in groups if group_dimension == dimension}
    requirement = (
        "a mesh of tetrahedra, or of hexahedra with 27 nodes: with 20 nodes,"
        " a unit pressure would give negative forces at the corners"
    )
    check_mesh(cell_kinds.isdisjoint((17, 29)), "hexahedra with 20 nodes", requirement)
    is_one_cell_kind = (
        len(cell_kinds) == 1 and cell_kinds <= _FACET_KIND_BY_CELL_KIND[dimension].keys()
    )
    check_mesh(
        is_one_cell_kind,
        f"{len(cell_kinds)} kinds of cells",
        f"a mesh whose physical {cells_requirement}",
    )
    kind = cell_kinds.pop()
    node_numbers, file_index_of_node_number = np.unique(node_numbers, return_index=True)
    cell_node_numbers = np.concatenate(
        [nodes for group_dimension, *_, nodes in groups if group_dimension == dimension]
    )
    used_numbers, cell_node_index = np.unique(cell_node_numbers, return_inverse=True)
    check_mesh(
        np.isin(used_numbers, node_numbers).all(),
        "cells with nodes that do not exist",
        "a mesh file that is not damaged; save it again",
    )
    nodes = cell_node_index.reshape(-1, gmsh.model.mesh.getElementProperties(kind)[3])
    nodes = nodes[np.sort(find_unique_rows(nodes)[0])]
    nodes_sorted_within_cells = np.sort(nodes, axis=1)
    has_repeated_node = np.any(
        nodes_sorted_within_cells[:, 1:] == nodes_sorted_within_cells[:, :-1]
    )
    check_mesh(
        not has_repeated_node,
        "a cell with a node twice",
        "a mesh with different nodes in each cell",
    )
    facets_by_name, point_groups = _select_named_groups(
        groups,
        {0: _POINT_KIND, dimension - 1: _FACET_KIND_BY_CELL_KIND[dimension][kind]},
        used_numbers,
    )
    facet_names_text = (
        f"{facet_group_word}s named {', '.join(map(repr, facets_by_name))}"
        if facets_by_name
        else f"no {facet_group_word} has a name"
    )
    requirement = f"a mesh with a physical {facet_group_word} named 'clamp'"
    check_mesh("clamp" in facets_by_name, f"no clamp; {facet_names_text}", requirement)
    used_positions = positions[file_index_of_node_number][
        np.searchsorted(node_numbers, used_numbers)
    ]
    return kind, make_cells_of_kind(kind, nodes), used_positions, facets_by_name, point_groups


def _select_named_groups(
    groups: list[Group], kind_by_dimension: dict[int, int], used_numbers: np.ndarray
) -> tuple[dict[str, np.ndarray], list[Group]]:
    """Select a mesh file's named facets and points, with nodes numbered from 0.

    InputError if a named group has other elements than the cells' facets or corners.

    Parameters
    ----------
    groups : list of Group
        All groups of the file.
    kind_by_dimension : dict of int to int
        Allowed kind of elements (gmsh's number) in named groups, by dimension of the group.
    used_numbers : (n_nodes,) int
        Numbers in the file of all nodes with cells, in ascending order.

    Returns
    -------
    facets_by_name : dict of str to (m, k) int
        Nodes of the facets with each name, "clamp" included.
    point_groups : list of Group
        Groups of named points.
    """
    row_lists_by_group: dict[tuple[int, str], list[np.ndarray]] = {}
    for dimension, _, name, kind, nodes in groups:
        if name and dimension in kind_by_dimension:
            has_allowed_elements = (
                kind == kind_by_dimension[dimension] and np.isin(nodes, used_numbers).all()
            )
            requirement = (
                "a mesh whose named groups have only cells, their facets and corners; remove the "
                "name of this group in gmsh"
            )
            check_mesh(has_allowed_elements, f"other elements in the group {name!r}", requirement)
            n_nodes_per_element = gmsh.model.mesh.getElementProperties(kind)[3]
            rows = np.searchsorted(used_numbers, nodes).reshape(-1, n_nodes_per_element)
            row_lists_by_group.setdefault((dimension, name), []).append(rows)
    rows_by_group = {
        dimension_and_name: np.concatenate(rows)
        for dimension_and_name, rows in row_lists_by_group.items()
    }
    n_load_points = len(rows_by_group.get((0, "load"), [0]))
    check_mesh(n_load_points == 1, f"{n_load_points} points in the group 'load'", "a mesh with one")
    facets_by_name = {name: rows for (dimension, name), rows in rows_by_group.items() if dimension}
    point_nodes_by_name = {
        name: rows[:, 0] for (dimension, name), rows in rows_by_group.items() if not dimension
    }
    return facets_by_name, [
        (0, tag, name, _POINT_KIND, nodes)
        for tag, (name, nodes) in enumerate(point_nodes_by_name.items(), 1)
    ]


def make_cells_of_kind(kind: int, nodes: np.ndarray) -> Cells:
    """Make :class:`Cells` from nodes (n_cells, k) and gmsh's number for the kind of cells."""
    _, dimension, *_, n_corners = gmsh.model.mesh.getElementProperties(kind)
    is_corner_function_nonzero_at_node = (
        _evaluate_basis_functions(
            _LINEAR_KIND_BY_SHAPE[dimension, n_corners], _reference_node_positions(kind)
        )
        > 1e-9
    )
    corner_indices = np.arange(n_corners)
    facets = (
        FACET_CORNERS_BY_CORNER_COUNT[n_corners]
        if dimension == 3
        else np.column_stack([corner_indices, np.roll(corner_indices, -1)])
    )
    return Cells(nodes, facets, is_corner_function_nonzero_at_node)


def _renumber_facets_after_split(
    facets_by_name: dict[str, np.ndarray],
    cells: Cells,
    split_cell_nodes: np.ndarray,
    node_map: np.ndarray,
) -> dict[str, np.ndarray]:
    """Give named facets the new node numbers after nodes were doubled along cracks.

    A facet with a doubled node gets the nodes of its cell, and so stays on the same side of the
    crack.

    Parameters
    ----------
    facets_by_name : dict of str to (m, k) int
        Facets with the nodes before the split.
    cells : Cells
        Cells before the split.
    split_cell_nodes : (n_cells, k) int
        Nodes of the cells after the split.
    node_map : (n_nodes,) int
        New number of each old node, for facets without a doubled node.

    Returns
    -------
    dict of str to (m, k) int
        Facets with the nodes after the split.
    """
    sorted_facets, owner, _ = cells.sorted_facets_and_owners
    n_key_corners = min(sorted_facets.shape[1], 3)  # three corners identify a facet
    key_weights = (int(cells.cell_nodes.max()) + 1) ** np.arange(n_key_corners)[::-1]
    facet_keys, n_corners = sorted_facets[:, :n_key_corners] @ key_weights, sorted_facets.shape[1]
    changed_nodes = np.unique(cells.cell_nodes[split_cell_nodes != node_map[cells.cell_nodes]])
    new_facets_by_name = {}
    for name, facet_nodes in facets_by_name.items():
        new_facets_by_name[name] = node_map[facet_nodes]
        split_rows = np.flatnonzero(np.isin(facet_nodes, changed_nodes).any(axis=1))
        split_facet_keys = (
            np.sort(facet_nodes[split_rows, :n_corners], axis=1)[:, :n_key_corners] @ key_weights
        )
        owner_cells = owner[
            np.minimum(np.searchsorted(facet_keys, split_facet_keys), len(facet_keys) - 1)
        ]
        cell_node_columns = np.argmax(
            cells.cell_nodes[owner_cells][:, None, :] == facet_nodes[split_rows][:, :, None], axis=2
        )
        new_facets_by_name[name][split_rows] = np.take_along_axis(
            split_cell_nodes[owner_cells], cell_node_columns, axis=1
        )
    return new_facets_by_name


def _check_mouths_are_open(
    cells: Cells, positions: np.ndarray, face_edges: Sequence[np.ndarray]
) -> None:
    """Raise InputError if both crack faces share a node at the plate's edge.

    A crack that reaches the edge must have a mouth there: two coincident nodes, one for each face.

    Parameters
    ----------
    cells : Cells
        The plate's cells.
    positions : (n_nodes, d) [m]
        Node positions.
    face_edges : two arrays (n, 2) int
        Nodes of element edges on the lower and on the upper crack face.
    """
    boundary_edges = cells.sorted_facets_and_owners[0][cells.is_boundary_facet]
    boundary_edges = boundary_edges[~are_rows_in(boundary_edges, np.concatenate(face_edges))]
    closed_mouth_nodes = np.intersect1d(np.intersect1d(*face_edges), boundary_edges)
    if len(closed_mouth_nodes):
        requirement = "open, with a node of each face at this point; or name one curve 'crack'"
        problem = f"a mouth at {format_point(positions[closed_mouth_nodes[0]], 'g')} that is closed"
        raise InputError("lips", problem, f"{requirement}: it is split into both faces")


def _tag_name_combinations(
    edges_by_name: dict[str, np.ndarray],
) -> tuple[dict[str, tuple[int, ...]], list[tuple[int, str, np.ndarray]]]:
    """Sort named facets into groups without common facets, with a tag for each group.

    A DOLFINx facet has only a single tag, but a facet may have several names. So there is a group
    for each combination of names.

    Parameters
    ----------
    edges_by_name : dict of str to (m, k) int
        Nodes of the edges on each named curve, or of the facets on each named surface.

    Returns
    -------
    tags_by_name : dict of str to tuple of int
        For each name, the tags of all combinations that include the name.
    tagged_edges : list of (int, str, (m, k) int)
        For each combination: tag, the names joined by "and", and nodes of the edges or facets.
    """
    all_edges = np.concatenate(list(edges_by_name.values()))
    edge_curve_index = np.repeat(
        np.arange(len(edges_by_name)), [len(curve_edges) for curve_edges in edges_by_name.values()]
    )
    first_index_of_unique_edge, unique_edge_index_of_edge, _ = find_unique_rows(all_edges)
    is_on_curve = np.zeros((len(first_index_of_unique_edge), len(edges_by_name)), dtype=bool)
    is_on_curve[unique_edge_index_of_edge, edge_curve_index] = True
    combinations, combination_index = np.unique(is_on_curve, axis=0, return_inverse=True)
    tagged_edges, curve_names = [], np.array(list(edges_by_name))
    for index, is_name_in_combination in enumerate(combinations):
        combination_edges = all_edges[
            np.sort(first_index_of_unique_edge[combination_index.ravel() == index])
        ]
        tagged_edges.append(
            (index + 1, " and ".join(curve_names[is_name_in_combination]), combination_edges)
        )
    combination_tags_of_curves = [
        tuple((np.flatnonzero(is_combination_on_curve) + 1).tolist())
        for is_combination_on_curve in combinations.T
    ]
    return dict(zip(edges_by_name, combination_tags_of_curves, strict=True)), tagged_edges


def _fill_gmsh_model(positions: np.ndarray, groups: list[Group]) -> None:
    """Add nodes, elements and named physical groups to gmsh's current model.

    ``positions`` (n_nodes, 3) [m] are the nodes. Each of ``groups`` is (dimension, tag, name,
    gmsh's kind of elements, nodes), with nodes as indices in ``positions``. The first group must
    hold the cells.
    """
    model, dimension = gmsh.model, groups[0][0]
    node_entity = model.addDiscreteEntity(dimension)
    model.mesh.addNodes(dimension, node_entity, 1 + np.arange(len(positions)), positions.ravel())
    for dimension, tag, name, kind, element_nodes in groups:
        entity = model.addDiscreteEntity(dimension)
        model.mesh.addElementsByType(entity, kind, [], element_nodes.ravel() + 1)
        model.addPhysicalGroup(dimension, [entity], tag)
        model.setPhysicalName(dimension, tag, name)


# --- checks of a mesh -----------------------------------------------------------------------------

MIN_RELATIVE_DETERMINANT = 1e-9
"""Minimum Jacobian determinant in a cell, relative to the cell's maximum or to size^d. Smaller ones
count as zero."""


def _check_none(
    is_wrong: np.ndarray, problem: str, positions: np.ndarray, requirement: str
) -> None:
    """Raise InputError for the key "mesh" if any of n cells, facets or points is wrong.

    Parameters
    ----------
    is_wrong : (n,) bool
        True for a wrong cell, facet or point.
    problem : str
        Text of the error for the fault. The centre of the first wrong cell is added.
    positions : (n, k, d) [m]
        Positions of the k nodes of each cell, facet or point.
    requirement : str
        Text of the error for what is allowed.
    """
    if np.any(is_wrong):
        centre = positions[np.argmax(is_wrong)].mean(axis=0)
        raise InputError("mesh", f"{problem} at {format_point(centre, 'g')}", requirement)


def check_cells(kind: int, cells: Cells, positions: np.ndarray) -> None:
    """Raise InputError if cells are folded, without volume, or overlap at a facet.

    At most two cells may meet at a facet, on opposite sides.

    Parameters
    ----------
    kind : int
        gmsh's number for the cell type.
    cells : Cells
        The cells.
    positions : (n_nodes, d) [m]
        Node positions.
    """
    dimension, facet_word = positions.shape[1], _FACET_WORD_BY_DIMENSION[positions.shape[1]]
    cell_positions, reference_nodes = positions[cells.cell_nodes], _reference_node_positions(kind)
    gradients = _evaluate_basis_functions(kind, reference_nodes, "GradLagrange").reshape(
        len(reference_nodes), len(reference_nodes), 3
    )[..., :dimension]
    # Jacobian determinants at the nodes of each cell [m^d].
    determinants = np.array(
        [
            np.linalg.det(cell_positions.swapaxes(1, 2) @ basis_gradients_at_node)
            for basis_gradients_at_node in gradients
        ]
    )
    min_determinants = determinants.min(axis=0)
    max_determinants = determinants.max(axis=0)
    min_abs_determinants = np.abs(determinants).min(axis=0)
    cube_volumes = np.ptp(cell_positions, axis=1).max(axis=1) ** dimension
    max_abs_determinants = np.maximum(-min_determinants, max_determinants)
    extent_word = ("area", "volume")[dimension - 2]
    # In a plane a corner may have 180 degrees.
    is_flat = (
        max_abs_determinants if dimension == 2 else min_abs_determinants
    ) <= MIN_RELATIVE_DETERMINANT * cube_volumes
    is_folded = (
        np.minimum(-min_determinants, max_determinants)
        > MIN_RELATIVE_DETERMINANT * max_abs_determinants
    )
    requirement = f"a mesh of convex cells with {extent_word}"
    if cells.cell_nodes.shape[1] > cells.n_corners:
        requirement += "; in gmsh, set Mesh.HighOrderOptimize = 1, or use cells of order 1"
    _check_none(is_flat, f"a cell without {extent_word}", cell_positions, requirement)
    _check_none(is_folded, "a folded cell", cell_positions, requirement)
    sorted_facets, owner, _ = cells.sorted_facets_and_owners
    facet_corner_positions = positions[sorted_facets]
    cell_centres = cell_positions[:, : cells.n_corners].mean(axis=1)
    vectors_from_first_facet_corner = (
        np.append(facet_corner_positions[:, 1:dimension], cell_centres[owner, None], axis=1)
        - facet_corner_positions[:, :1]
    )
    side_signs, is_shared = (
        np.sign(np.linalg.det(vectors_from_first_facet_corner)),
        cells.is_facet_equal_to_next,
    )
    _check_none(
        is_shared[1:] & is_shared[:-1],
        f"{facet_word} of three cells",
        facet_corner_positions,
        f"a mesh with at most two cells at {facet_word}",
    )
    _check_none(
        is_shared & (side_signs[1:] == side_signs[:-1]),
        "cells that overlap",
        facet_corner_positions,
        f"a mesh whose cells do not overlap; these lie on the same side of {facet_word} of both",
    )


def _check_inner_surfaces_are_cracks(
    cells: Cells, facets_by_name: dict[str, np.ndarray], crack_names: list[str]
) -> None:
    """Raise InputError if a named surface inside the solid is neither crack nor clamp.

    A user may have meant the surface as a crack, but it would not separate the material.

    Parameters
    ----------
    cells : Cells
        The mesh's cells.
    facets_by_name : dict of str to (m, k) int
        Nodes of the facets on each named surface.
    crack_names : list of str
        Names of the surfaces that are cracks.
    """
    sorted_facets, _, _ = cells.sorted_facets_and_owners
    shared_facets = sorted_facets[1:][cells.is_facet_equal_to_next]
    n_corners = sorted_facets.shape[1]
    corners_by_name = {
        name: np.sort(facet_rows[:, :n_corners], axis=1)
        for name, facet_rows in facets_by_name.items()
    }
    crack_facets = np.concatenate(
        [sorted_facets[:0], *(corners_by_name[name] for name in crack_names)]
    )
    for name, facet_rows in corners_by_name.items():
        is_inner_facet = are_rows_in(facet_rows, shared_facets) & ~are_rows_in(
            facet_rows, crack_facets
        )
        if name != "clamp" and np.any(is_inner_facet):
            requirement = (
                "a mesh whose inner surfaces are cracks, named 'crack' or 'crack 1', 'crack 2'"
            )
            raise InputError("mesh", f"a surface {name!r} inside the solid", requirement)


def check_parts_are_clamped(
    cells: Cells,
    positions: np.ndarray,
    clamped_nodes: np.ndarray,
    face_facets: Sequence[np.ndarray],
) -> None:
    """Raise InputError if a part of the mesh has no clamped node.

    A part is a set of cells connected by common nodes. Contact alone cannot hold a part.

    Parameters
    ----------
    cells : Cells
        Cells after the split at cracks.
    positions : (n_nodes, d) [m]
        Node positions.
    clamped_nodes : (m,) or (m, k) int
        Nodes on facets named "clamp".
    face_facets : sequence of (n, d) int
        Corners of the facets on each crack face. Used to say in the error whether contact holds the
        part.
    """
    part_labels = label_connected_rows(cells.cell_nodes)

    def is_in_part_with(nodes: np.ndarray) -> np.ndarray:
        """Return True for all cells in parts with any of the nodes: (n_cells,) bool."""
        return np.isin(part_labels, part_labels[np.isin(cells.cell_nodes, nodes).any(axis=1)])

    is_loose_cell = ~is_in_part_with(clamped_nodes)
    if np.any(is_loose_cell):
        is_held_by_contact = any(
            np.any(is_in_part_with(crack_face_nodes) & is_loose_cell)
            for crack_face_nodes in face_facets
        )
        problem = "a part held by contact alone" if is_held_by_contact else "a part without a clamp"
        requirement = (
            f"a mesh whose parts have {_FACET_WORD_BY_DIMENSION[positions.shape[1]]} in 'clamp',"
            " or share nodes"
        )
        requirement += " with such a part; contact alone does not hold a part"
        centre = positions[cells.cell_nodes[is_loose_cell]].mean(axis=(0, 1))
        raise InputError("mesh", f"{problem} at {format_point(centre, 'g')}", requirement)


def check_parts_do_not_overlap(
    kind: int, cells: Cells, positions: np.ndarray, face_facets: Sequence[np.ndarray]
) -> None:
    """Raise InputError if parts of a mesh overlap, or touch without common nodes.

    Sample points lie on each boundary facet, at the centre and halfway to each corner. A sample
    point must not lie in or on another cell. Facets of crack faces are exempt. A long, thin cell
    may pass between sample points undetected, from three times as long as wide.

    Parameters
    ----------
    kind : int
        gmsh's number for the cell type.
    cells : Cells
        Cells after the split at cracks.
    positions : (n_nodes, d) [m]
        Node positions.
    face_facets : sequence of (n, d) int
        Corners of facets on crack faces.
    """
    from scipy.spatial import cKDTree

    boundary_facets, owner, corner_indices_in_cell = (
        rows[cells.is_boundary_facet] for rows in cells.sorted_facets_and_owners
    )
    is_not_on_crack_face = ~are_rows_in(
        boundary_facets, np.concatenate([*face_facets, boundary_facets[:0]])
    )
    owner, corner_indices_in_cell = (
        owner[is_not_on_crack_face],
        corner_indices_in_cell[is_not_on_crack_face],
    )
    reference_facet_corners = _reference_node_positions(kind)[corner_indices_in_cell]
    reference_facet_centre = reference_facet_corners.mean(axis=1, keepdims=True)
    reference_points = np.concatenate(
        [reference_facet_centre, 0.5 * (reference_facet_centre + reference_facet_corners)], axis=1
    )
    owner = np.repeat(owner, reference_points.shape[1])
    basis_values = _evaluate_basis_functions(kind, reference_points.reshape(-1, 3))
    points = np.einsum("in,inx->ix", basis_values, positions[cells.cell_nodes[owner]])

    cell_positions = positions[cells.cell_nodes]
    cell_centres = cell_positions.mean(axis=1)
    cell_radii = np.linalg.norm(cell_positions - cell_centres[:, None], axis=2).max(axis=1)
    near_point_lists = cKDTree(points).query_ball_point(cell_centres, cell_radii)
    near_cell_index = np.repeat(
        np.arange(len(near_point_lists)),
        [len(near_point_list) for near_point_list in near_point_lists],
    )
    near_point_index = np.concatenate(near_point_lists).astype(int)
    is_not_owner_cell = owner[near_point_index] != near_cell_index
    near_cell_index = near_cell_index[is_not_owner_cell]
    near_point_index = near_point_index[is_not_owner_cell]
    near_points = points[near_point_index]
    _check_none(
        _are_in_cells(kind, cells.n_corners, cell_positions[near_cell_index], near_points),
        "cells that overlap, or touch without a node of both,",
        near_points[:, None],
        "a mesh whose cells share nodes where they touch (gmsh: BooleanFragments or"
        " Coherence Mesh), except at the faces of named cracks"
        " ('crack', or 'lower_lip' and 'upper_lip')",
    )


def _are_in_cells(
    kind: int, n_corners: int, cell_positions: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Return True for each i if point i lies in or on cell i: (n,) bool.

    The tolerance is 1e-6 of the cell's size.

    Parameters
    ----------
    kind : int
        gmsh's number for the cell type.
    n_corners : int
        Number of corners per cell.
    cell_positions : (n, n_nodes, d) [m]
        Node positions of each cell.
    points : (n, d) [m]
        A point for each cell.
    """
    dimension = points.shape[1]
    linear_functions_at_nodes = _evaluate_basis_functions(
        _LINEAR_KIND_BY_SHAPE[dimension, n_corners], _reference_node_positions(kind)
    )
    curvature_offsets = cell_positions - np.einsum(
        "nc,icx->inx", linear_functions_at_nodes, cell_positions[:, :n_corners]
    )
    bounding_box_minima, bounding_box_maxima = (
        cell_positions.min(axis=1),
        cell_positions.max(axis=1),
    )
    cell_sizes = (bounding_box_maxima - bounding_box_minima).max(axis=1)
    # Lebesgue's constant of cells of order 2 is at most 1.63^2.
    bounding_box_margin = (
        RELATIVE_POSITION_TOLERANCE * cell_sizes + 3.0 * np.abs(curvature_offsets).max(axis=(1, 2))
    )[:, None]
    is_inside = np.all(
        (points > bounding_box_minima - bounding_box_margin)
        & (points < bounding_box_maxima + bounding_box_margin),
        axis=1,
    )
    if not np.any(is_inside):
        return is_inside
    cell_positions = cell_positions[is_inside]
    points = points[is_inside]
    cell_sizes = cell_sizes[is_inside]
    reference_points = np.tile(
        _reference_node_positions(kind)[:n_corners].mean(axis=0), (len(points), 1)
    )
    # Newton's method: exact in one step for straight cells.
    unconverged_point_indices = np.arange(len(reference_points))
    for _ in range(8):
        residuals = points[unconverged_point_indices] - np.einsum(
            "in,inx->ix",
            _evaluate_basis_functions(kind, reference_points[unconverged_point_indices]),
            cell_positions[unconverged_point_indices],
        )
        is_unconverged = (
            np.abs(residuals).max(axis=1)
            > MIN_RELATIVE_DETERMINANT * cell_sizes[unconverged_point_indices]
        )
        unconverged_point_indices, residuals = (
            unconverged_point_indices[is_unconverged],
            residuals[is_unconverged],
        )
        if not len(unconverged_point_indices):
            break
        gradients = _evaluate_basis_functions(
            kind, reference_points[unconverged_point_indices], "GradLagrange"
        ).reshape(len(unconverged_point_indices), -1, 3)
        jacobians = np.einsum(
            "inx,inr->ixr", cell_positions[unconverged_point_indices], gradients[..., :dimension]
        )
        reference_points[unconverged_point_indices, :dimension] += np.einsum(
            "irx,ix->ir", np.linalg.pinv(jacobians), residuals
        )
        reference_points[unconverged_point_indices] = np.clip(
            reference_points[unconverged_point_indices], -2.0, 2.0
        )
    residuals = points - np.einsum(
        "in,inx->ix", _evaluate_basis_functions(kind, reference_points), cell_positions
    )
    is_in_reference_cell = (
        _evaluate_basis_functions(
            _LINEAR_KIND_BY_SHAPE[dimension, n_corners], reference_points
        ).min(axis=1)
        >= -RELATIVE_POSITION_TOLERANCE
    )
    is_inside[is_inside] = is_in_reference_cell & (
        np.abs(residuals).max(axis=1) <= RELATIVE_POSITION_TOLERANCE * cell_sizes
    )
    return is_inside


def _reference_node_positions(kind: int) -> np.ndarray:
    """Return the nodes of gmsh's reference cell: (n_nodes, 3), without unit.

    The reference cell is the cell of unit size on which gmsh defines basis functions. ``kind`` is
    gmsh's number for the cell type. In a plate the third coordinate is 0.
    """
    _, dimension, _, n_nodes_per_cell, coordinates, _ = gmsh.model.mesh.getElementProperties(kind)
    positions = np.zeros((n_nodes_per_cell, 3))
    positions[:, :dimension] = np.reshape(coordinates, (n_nodes_per_cell, dimension))
    return positions


def _evaluate_basis_functions(
    kind: int, reference_points: np.ndarray, function_name: str = "Lagrange"
) -> np.ndarray:
    """Evaluate a cell's basis functions at points of gmsh's reference cell.

    Parameters
    ----------
    kind : int
        gmsh's number for the cell type.
    reference_points : (n, 3)
        Points in the coordinates of the reference cell.
    function_name : str
        "Lagrange" for values, "GradLagrange" for gradients.

    Returns
    -------
    (n, n_functions) or (n, 3 n_functions)
        Values, or gradients with three columns per function.
    """
    return np.reshape(
        gmsh.model.mesh.getBasisFunctions(kind, reference_points.ravel(), function_name)[1],
        (len(reference_points), -1),
    )
