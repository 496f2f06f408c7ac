"""Read nodes and cells from other programs' input files, or from a table.

The programs are CalculiX, Abaqus, Nastran and Ansys. Only nodes and solid elements are read, with
nodes in VTK's order. Keywords that make nodes without stating their coordinates are refused by
name.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_crack.model.matrix_formats import (
    cut_fields,
    parse_real,
    read_number_rows,
    yield_numbered_lines,
)
from fenics_crack.scene.fields import MAX_ALLOWED_MAGNITUDE

VTK_TYPE_BY_NODE_COUNT = {4: 10, 6: 13, 8: 12, 10: 24, 15: 26, 20: 25}
"""VTK's cell type of tetrahedra, wedges and hexahedra, by number of nodes."""
KEYWORDS_GENERATING_NODES_OR_CELLS = (
    "NGEN",
    "NFILL",
    "NCOPY",
    "ELGEN",
    "ELCOPY",
    "SYSTEM",
    "TRANSFORM",
    "NMAP",
)
"""Keywords of CalculiX and Abaqus that generate or rotate nodes or cells. A file with any such
keyword is refused."""
match_include = re.compile(r"\*\s*INCLUDE\b", re.IGNORECASE).match
"""Match a line ``*INCLUDE`` of CalculiX or Abaqus."""
ANSYS_SOLID_TYPE_NUMBERS = {
    5, 45, 46, 62, 64, 65, 72, 73, 92, 95, 98, 185, 186, 187, 190, 191, 215, 216, 217, 220, 221,
    226, 227, 285,
}  # fmt: skip
"""Numbers of Ansys' solid element types. All other types in a block are skipped: surfaces, contact,
shells and springs."""
NASTRAN_NODE_PERMUTATIONS = {
    15: [*range(9), 12, 13, 14, 9, 10, 11],
    20: [*range(12), 16, 17, 18, 19, 12, 13, 14, 15],
}
"""Position in Nastran's node list of each node in VTK's order, by number of nodes. Nastran lists
vertical edges before upper edges."""


@dataclass(frozen=True)
class ModelFileMesh:
    """Nodes and solid cells from another program's input file.

    Attributes
    ----------
    labels : (n,) int
        Node numbers in the file, in ascending order.
    points : (n, 3) [m]
        Node positions.
    cells_by_vtk_type : dict of int to (m, k) int
        Nodes of the cells as indices in ``labels``, in VTK's order, by VTK's cell type.
    """

    labels: np.ndarray
    points: np.ndarray
    cells_by_vtk_type: dict[int, np.ndarray]


def read_nodes_and_cells(path: Path) -> ModelFileMesh:
    """Read nodes and solid cells from another program's input file.

    The ending tells the format: .inp (CalculiX, Abaqus), .bdf, .dat or .nas (Nastran), .cdb
    (Ansys). Any other file is a table with rows "node, x, y, z".

    Raises
    ------
    OSError, ValueError
        The file cannot be read or has no nodes, or a line contradicts an earlier one. The message
        names the line.
    """
    nodes: dict[int, tuple[float, ...]] = {}
    cells: dict[int, list[list[int]]] = {}
    try:
        READERS_BY_ENDING.get(path.suffix.lower(), _read_node_table)(path, nodes, cells)
    except RecursionError:
        raise ValueError("its files include each other without end") from None
    if not nodes:
        raise ValueError("it has no nodes")
    sorted_node_labels = np.array(sorted(nodes), dtype=np.int64)
    points = np.array([nodes[label] for label in sorted_node_labels.tolist()])
    cells_by_type = {}
    for vtk_type, node_label_lists_of_cells in cells.items():
        node_labels_of_cells = np.array(node_label_lists_of_cells, dtype=np.int64)
        cell_nodes = np.minimum(
            np.searchsorted(sorted_node_labels, node_labels_of_cells), len(sorted_node_labels) - 1
        )
        if np.any(sorted_node_labels[cell_nodes] != node_labels_of_cells):
            missing_label = node_labels_of_cells[
                sorted_node_labels[cell_nodes] != node_labels_of_cells
            ][0]
            raise ValueError(f"an element has node {missing_label}, which the file does not define")
        cells_by_type[vtk_type] = cell_nodes
    return ModelFileMesh(sorted_node_labels, points, cells_by_type)


def list_included_files(path: Path) -> list[Path]:
    """List further files that a matrix or model file needs; empty if none.

    CalculiX's matrices (.sti, .mas) need the file .dof with the rows' nodes. Input files (.inp) of
    CalculiX or Abaqus may include other files.
    """
    if path.suffix.lower() in (".sti", ".mas"):
        return [path.with_suffix(".dof")]
    file_paths = [path] if path.suffix.lower() == ".inp" else []
    for file_path in file_paths:  # the list grows
        with contextlib.suppress(OSError):
            included_paths = [
                _included_path(file_path, line)
                for _, line in yield_numbered_lines(file_path, "**")
                if match_include(line)
            ]
            file_paths += [
                included_path for included_path in included_paths if included_path not in file_paths
            ]
    return file_paths[1:]


def _included_path(path: Path, line: str) -> Path:
    """Return the path in a line ``*INCLUDE, INPUT=...`` of the input file ``path``."""
    return path.parent / line.partition("=")[2].strip().strip('"')


NodePositions = dict[int, tuple[float, ...]]
"""Position of each node, by node number."""
CellLabels = dict[int, list[list[int]]]
"""Node numbers of each cell, by VTK's cell type."""


def _add_node(
    nodes: NodePositions, line_number: int, label: int, position: tuple[float, ...]
) -> None:
    """Add the position of a node to a dict, and check the position.

    Parameters
    ----------
    nodes : NodePositions
        Positions by node number; gets the new entry.
    line_number : int
        Line in the file, for errors.
    label : int
        Node number.
    position : tuple of float
        Coordinates x, y, z.

    Raises
    ------
    ValueError
        A coordinate is no number or beyond ``MAX_ALLOWED_MAGNITUDE``. Or the node already has
        another position.
    """
    if not all(abs(coordinate) <= MAX_ALLOWED_MAGNITUDE for coordinate in position):
        raise ValueError(
            f"line {line_number}: a coordinate of node {label} is not a number of at most "
            f"{MAX_ALLOWED_MAGNITUDE:g}"
        )
    if nodes.setdefault(label, position) != position:
        raise ValueError(f"line {line_number}: node {label} has two different positions")


def _read_node_table(path: Path, nodes: NodePositions, cells: CellLabels) -> None:
    """Read nodes from a table with rows "node, x, y, z".

    The positions are added to ``nodes``, by node number. ``cells`` stays unchanged; all readers of
    model files have this parameter.
    """
    for row_number, (label, *coordinates) in enumerate(
        read_number_rows(path, 4, "#", ",").tolist(), 1
    ):
        if label % 1 != 0:
            raise ValueError(f"row {row_number}: {label:g} is not a node number")
        _add_node(nodes, row_number, int(label), tuple(coordinates))


# --- CalculiX and Abaqus --------------------------------------------------------------------------


def _read_abaqus(path: Path, nodes: NodePositions, cells: CellLabels) -> None:
    """Read nodes and solid cells from an input file (.inp) of CalculiX or Abaqus.

    Node positions are added to ``nodes``, by node number. The cells' node numbers are added to
    ``cells``, by VTK's cell type. Included files are read, too. Elements other than C3D solids are
    skipped.

    Raises
    ------
    ValueError
        Nodes are generated by a keyword, given in another coordinate system, or moved with an
        instance.
    """
    keyword, n_nodes_per_element, element_and_node_labels = "", 0, list[int]()
    for line_number, line in yield_numbered_lines(path, "**"):
        try:
            if line.startswith("*"):
                keyword, *options = (
                    field_text.strip().upper() for field_text in line[1:].split(",")
                )
                parameters = {
                    name.strip(): value.strip()
                    for name, _, value in (option.partition("=") for option in options)
                }
                is_in_other_file = keyword in ("NODE", "ELEMENT") and "INPUT" in parameters
                is_in_other_system = keyword == "NODE" and parameters.get("SYSTEM", "R") != "R"
                if (
                    keyword in KEYWORDS_GENERATING_NODES_OR_CELLS
                    or is_in_other_file
                    or is_in_other_system
                ):
                    raise NotImplementedError
                if keyword == "INCLUDE":
                    _read_abaqus(_included_path(path, line), nodes, cells)
                element_type = parameters.get("TYPE", "").strip() if keyword == "ELEMENT" else ""
                type_match, element_and_node_labels = re.match(r"C3D(\d+)", element_type), []
                n_nodes_per_element = int(type_match[1]) if type_match is not None else 0
            elif keyword == "INSTANCE" and any(map(float, line.strip().rstrip(",").split(","))):
                raise NotImplementedError  # the instance is moved or rotated
            elif keyword == "NODE":
                label_text, *coordinate_texts = line.strip().rstrip(",").split(",")
                position = (*map(float, coordinate_texts), 0.0, 0.0)[:3]  # zeros may be left out
                _add_node(nodes, line_number, int(label_text), position)
            elif keyword == "ELEMENT" and n_nodes_per_element in VTK_TYPE_BY_NODE_COUNT:
                element_and_node_labels += map(int, line.strip().rstrip(",").split(","))
                if len(element_and_node_labels) > n_nodes_per_element:
                    cells.setdefault(VTK_TYPE_BY_NODE_COUNT[n_nodes_per_element], []).append(
                        element_and_node_labels[1:]
                    )
                    element_and_node_labels = []
        except NotImplementedError:
            requirement = "write out all nodes and elements with their numbers and final positions"
            raise ValueError(
                f"{path.name}, line {line_number}: *{keyword} is not read; {requirement}"
            ) from None
        except ValueError as error:
            reason = (
                str(error) if "line" in str(error) else f"{line[:80]!r} is not data of *{keyword}"
            )
            raise ValueError(f"{path.name}, line {line_number}: {reason}") from None


# --- Nastran --------------------------------------------------------------------------------------


def _read_nastran(path: Path, nodes: NodePositions, cells: CellLabels) -> None:
    """Read nodes and solid cells from a file with Nastran's bulk data.

    Node positions are added to ``nodes``, by node number. The cells' node numbers are added to
    ``cells``, by VTK's cell type. Entries other than GRID, CTETRA, CPENTA and CHEXA are skipped.

    Raises
    ------
    ValueError
        The file has an INCLUDE, or another coordinate system than the basic one.
    """
    for line_number, card in _yield_nastran_cards(path):
        name, *fields = card
        try:
            if name == "GRID":
                if fields[1] not in ("", "0") or (fields[5:6] or [""])[0] not in ("", "0"):
                    raise ValueError
                position = tuple(parse_real(field or "0") for field in (*fields[2:5], "", "")[:3])
                _add_node(nodes, line_number, int(fields[0]), position)
            elif name.startswith("INCLUDE") or (
                name == "GRDSET" and any(field.strip("0") for field in fields[1:6:4])
            ):
                raise NotImplementedError
            elif name in ("CTETRA", "CPENTA", "CHEXA"):
                node_labels = [int(field) for field in fields[2:] if field]
                node_order = NASTRAN_NODE_PERMUTATIONS.get(
                    len(node_labels), range(len(node_labels))
                )
                cells.setdefault(VTK_TYPE_BY_NODE_COUNT[len(node_labels)], []).append(
                    [node_labels[node_index] for node_index in node_order]
                )
        except (ValueError, KeyError, IndexError):
            requirement = (
                "a GRID in the basic coordinate system" if name == "GRID" else "a whole solid"
            )
            raise ValueError(f"line {line_number}: {card} is not {requirement}") from None
        except NotImplementedError:
            requirement = "nodes and elements must be in this file, in the basic coordinate system"
            raise ValueError(f"line {line_number}: {name}: {requirement}") from None


def _yield_nastran_cards(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the entries (cards) in a file with Nastran's bulk data.

    Fields have 8 or 16 characters, or stand between commas. Fields of continuation lines are
    appended.

    Yields
    ------
    int
        Line number at which the entry begins, from 1.
    list of str
        Name in upper case, then the fields.
    """
    first_line_number, card = 0, list[str]()
    for line_number, line in yield_numbered_lines(path, "$"):
        line = line.expandtabs(8)
        if "," in line:
            name, *fields = (field.strip() for field in line.split(",")[:9])
        else:
            name = line[:8].strip()
            fields = cut_fields(line, 16 if "*" in name else 8, 8, 72)
        if name and name[0] not in "+*":
            if card:
                yield first_line_number, card
            first_line_number, card = line_number, [name.strip(" *").upper()]
        if card:
            card += fields
    if card:
        yield first_line_number, card


# --- Ansys ----------------------------------------------------------------------------------------


def _read_ansys(path: Path, nodes: NodePositions, cells: CellLabels) -> None:
    """Read nodes and solid cells from a file written by Ansys' CDWRITE.

    Node positions are added to ``nodes``, by node number. The cells' node numbers are added to
    ``cells``, by VTK's cell type. Nodes are in the block NBLOCK, cells in the block EBLOCK. Element
    types except ``ANSYS_SOLID_TYPE_NUMBERS`` are skipped.

    Raises
    ------
    ValueError
        A node has rotation angles, or a brick is degenerate.
    """
    block, n_nodes_per_element, node_labels = "", 0, list[int]()
    integer_width, real_width, n_integers = 0, 0, 0
    type_number_by_index, is_solid, other_type_numbers = dict[int, int](), True, set[int]()
    for line_number, line in yield_numbered_lines(path, "!"):
        keyword = line.strip().upper()
        try:
            if keyword.startswith("ET,") and not block:
                _, type_index_text, type_name = keyword.split(",")[:3]
                type_number_by_index[int(type_index_text)] = int(
                    type_name.strip().lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZ")
                )
            if keyword.startswith(("NBLOCK", "EBLOCK")):
                if keyword.startswith("EBLOCK") and "SOLID" not in keyword:
                    raise ValueError
                block, node_labels = keyword[:6], []
            elif block and line.lstrip().startswith("("):
                n_integers, integer_width, *real_format_numbers = map(int, re.findall(r"\d+", line))
                real_width = real_format_numbers[1] if len(real_format_numbers) > 1 else 0
            elif keyword.startswith(("N,", "-1")):
                if node_labels:
                    raise ValueError  # the last cell is incomplete
                block = ""
            elif block == "NBLOCK":
                fields = cut_fields(line, real_width, n_integers * integer_width)
                coordinates = [parse_real(field) for field in fields if field]
                if any(coordinates[3:]):
                    raise ValueError  # the node has angles
                _add_node(
                    nodes, line_number, int(line[:integer_width]), (*coordinates, 0.0, 0.0, 0.0)[:3]
                )
            elif block == "EBLOCK":
                integers = [int(field) for field in cut_fields(line, integer_width)]
                if not node_labels:
                    is_solid = (
                        integers[1] not in type_number_by_index
                        or type_number_by_index[integers[1]] in ANSYS_SOLID_TYPE_NUMBERS
                    )
                    other_type_numbers |= set() if is_solid else {type_number_by_index[integers[1]]}
                    n_nodes_per_element, integers = integers[8], integers[11:]
                node_labels += integers
                if len(node_labels) >= n_nodes_per_element:
                    if is_solid and len(set(node_labels)) < n_nodes_per_element:
                        raise ValueError  # a brick with nodes in the same place
                    if is_solid:
                        cells.setdefault(VTK_TYPE_BY_NODE_COUNT[n_nodes_per_element], []).append(
                            node_labels[:n_nodes_per_element]
                        )
                    node_labels = []
        except (ValueError, KeyError, IndexError) as error:
            requirement = "a node without rotation angles, or a whole tetrahedron or brick"
            reason = (
                str(error)
                if "line" in str(error)
                else f"line {line_number}: this is not {requirement}"
            )
            raise ValueError(reason) from None
    if other_type_numbers and not cells:
        types_text = ", ".join(map(str, sorted(other_type_numbers)))
        raise ValueError(
            f"none of its elements (types {types_text}) is a solid element that is read; use "
            "tetrahedra or bricks"
        )


READERS_BY_ENDING: dict[str, Callable[[Path, NodePositions, CellLabels], None]] = {
    ".inp": _read_abaqus, ".bdf": _read_nastran, ".dat": _read_nastran, ".nas": _read_nastran,
    ".cdb": _read_ansys,
}  # fmt: skip
"""Function to read an input file into nodes and cells, by the ending of the file name."""
