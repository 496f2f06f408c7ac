"""Nodes and cells of the input files of other programs: CalculiX, Abaqus, Nastran and Ansys, or a
table.

Only what has a place is read: nodes, and the solid elements between them, with nodes in VTK's
order. What makes nodes in another way than by their coordinates is refused by its name.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_crack.model.matrices import numbered_lines, rows_of
from fenics_crack.scene.fields import LARGEST

VTK = {4: 10, 6: 13, 8: 12, 10: 24, 15: 26, 20: 25}
"""VTK's number of solid cells by their nodes: tetrahedra, wedges and hexahedra."""
MAKERS = ("NGEN", "NFILL", "NCOPY", "ELGEN", "ELCOPY", "SYSTEM", "TRANSFORM", "NMAP")
"""Keywords of CalculiX and Abaqus that make nodes and cells, or turn them."""
INCLUDE = re.compile(r"\*\s*INCLUDE\b", re.IGNORECASE).match
"""Include line of CalculiX and Abaqus."""
SOLIDS = {
    5, 45, 46, 62, 64, 65, 72, 73, 92, 95, 98, 185, 186, 187, 190, 191, 215, 216, 217, 220, 221,
    226, 227, 285,
}  # fmt: skip
"""Ansys' solid elements; surfaces, contact, shells and springs are in the same blocks."""
TOPS_LAST = {
    15: [*range(9), 12, 13, 14, 9, 10, 11],
    20: [*range(12), 16, 17, 18, 19, 12, 13, 14, 15],
}
"""VTK's order of Nastran's nodes, whose upright edges come before those at the top."""


@dataclass(frozen=True)
class Model:
    """Nodes and cells.

    Attributes
    ----------
    labels : (n,) int
        Numbers of the nodes, in ascending order.
    points : (n, 3)
        Their positions.
    cells : dict of int to (m, k) int
        By VTK's number of their kind: places of their nodes in ``labels``, in VTK's order.
    """

    labels: np.ndarray
    points: np.ndarray
    cells: dict[int, np.ndarray]


def read_model(path: Path) -> Model:
    """Read nodes and cells: .inp of CalculiX or Abaqus, .bdf, .dat or .nas of Nastran, .cdb of
    Ansys; of another ending rows of node, x, y, z between commas.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, or contradicts itself: with its line.
    """
    nodes: dict[int, tuple[float, ...]] = {}
    cells: dict[int, list[list[int]]] = {}
    try:
        READERS.get(path.suffix.lower(), _table)(path, nodes, cells)
    except RecursionError:
        raise ValueError("its files include each other") from None
    if not nodes:
        raise ValueError("it has no nodes")
    labels = np.array(sorted(nodes), dtype=np.int64)
    points = np.array([nodes[label] for label in labels.tolist()])
    made = {}
    for kind, rows in cells.items():
        wanted = np.array(rows, dtype=np.int64)
        places = np.minimum(np.searchsorted(labels, wanted), len(labels) - 1)
        if np.any(labels[places] != wanted):
            missing = wanted[labels[places] != wanted][0]
            raise ValueError(f"an element has node {missing}, which it does not have")
        made[kind] = places
    return Model(labels, points, made)


def list_included_files(path: Path) -> list[Path]:
    """The files that are read with one: the rows of CalculiX's matrices beside them, and what an
    input file of CalculiX or Abaqus includes."""
    if path.suffix.lower() in (".sti", ".mas"):
        return [path.with_suffix(".dof")]
    found = [path] if path.suffix.lower() == ".inp" else []
    for file in found:  # grows
        with contextlib.suppress(OSError):
            own = [_included(file, line) for _, line in numbered_lines(file, "**") if INCLUDE(line)]
            found += [one for one in own if one not in found]
    return found[1:]


def _included(path: Path, line: str) -> Path:
    """Return the path that a line *INCLUDE, INPUT=... of an input file names."""
    return path.parent / line.partition("=")[2].strip().strip('"')


Nodes = dict[int, tuple[float, ...]]
Cells = dict[int, list[list[int]]]


def _put(nodes: Nodes, number: int, label: int, place: tuple[float, ...]) -> None:
    if not all(abs(x) <= LARGEST for x in place):
        raise ValueError(f"line {number}: a coordinate of node {label} is no number to {LARGEST:g}")
    if nodes.setdefault(label, place) != place:
        raise ValueError(f"line {number}: two places of node {label}")


def _table(path: Path, nodes: Nodes, cells: Cells) -> None:
    for number, (label, *place) in enumerate(rows_of(path, 4, "#", ",").tolist(), 1):
        if label % 1 != 0:
            raise ValueError(f"row {number}: {label:g} is no number of a node")
        _put(nodes, number, int(label), tuple(place))


# --- CalculiX and Abaqus --------------------------------------------------------------------------


def _of_abaqus(path: Path, nodes: Nodes, cells: Cells) -> None:
    keyword, count, row = "", 0, list[int]()
    for number, line in numbered_lines(path, "**"):
        try:
            if line.startswith("*"):
                keyword, *options = (word.strip().upper() for word in line[1:].split(","))
                parts = (option.partition("=") for option in options)
                given = {name.strip(): value.strip() for name, _, value in parts}
                elsewhere = keyword in ("NODE", "ELEMENT") and "INPUT" in given
                turned = keyword == "NODE" and given.get("SYSTEM", "R") != "R"
                if keyword in MAKERS or elsewhere or turned:
                    raise NotImplementedError
                if keyword == "INCLUDE":
                    _of_abaqus(_included(path, line), nodes, cells)
                kind = given.get("TYPE", "").strip() if keyword == "ELEMENT" else ""
                match, row = re.match(r"C3D(\d+)", kind), []
                count = int(match[1]) if match is not None else 0
            elif keyword == "INSTANCE" and any(map(float, line.strip().rstrip(",").split(","))):
                raise NotImplementedError  # moved or turned
            elif keyword == "NODE":
                label, *place = line.strip().rstrip(",").split(",")
                spatial = (*map(float, place), 0.0, 0.0)[:3]  # zeros may be left out
                _put(nodes, number, int(label), spatial)
            elif keyword == "ELEMENT" and count in VTK:
                row += map(int, line.strip().rstrip(",").split(","))
                if len(row) > count:
                    cells.setdefault(VTK[count], []).append(row[1:])
                    row = []
        except NotImplementedError:
            allowed = "nodes and elements must be written out where they are, with their numbers"
            raise ValueError(f"{path.name}, line {number}: *{keyword}: {allowed}") from None
        except ValueError as error:
            reason = str(error) if "line" in str(error) else f"{line[:80]!r} of *{keyword}"
            raise ValueError(f"{path.name}, line {number}: {reason}") from None


# --- Nastran --------------------------------------------------------------------------------------


def _of_nastran(path: Path, nodes: Nodes, cells: Cells) -> None:
    for number, card in _cards(path):
        name, *fields = card
        try:
            if name == "GRID":
                if fields[1] not in ("", "0") or (fields[5:6] or [""])[0] not in ("", "0"):
                    raise ValueError
                place = tuple(_number(field) for field in (*fields[2:5], "", "")[:3])
                _put(nodes, number, int(fields[0]), place)
            elif name.startswith("INCLUDE") or (
                name == "GRDSET" and any(field.strip("0") for field in fields[1:6:4])
            ):
                raise NotImplementedError
            elif name in ("CTETRA", "CPENTA", "CHEXA"):
                own = [int(field) for field in fields[2:] if field]
                order = TOPS_LAST.get(len(own), range(len(own)))
                cells.setdefault(VTK[len(own)], []).append([own[place] for place in order])
        except (ValueError, KeyError, IndexError):
            allowed = "a GRID in the basic coordinate system" if name == "GRID" else "a solid"
            raise ValueError(f"line {number}: {card} is not {allowed}") from None
        except NotImplementedError:
            allowed = "nodes and elements must be in this file, in the basic coordinate system"
            raise ValueError(f"line {number}: {name}: {allowed}") from None


def _number(field: str) -> float:
    """A real, in which the E of the exponent may be left out: "1.5-3"."""
    return float(re.sub(r"(?<=[\d.])([+-]\d+)$", r"E\1", field.upper().replace("D", "E")) or 0.0)


def _cards(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Entries of bulk data with the number of their first line: names, and fields of 8 or 16
    characters or between commas, those of continuations too."""
    first, card = 0, list[str]()
    for number, line in numbered_lines(path, "$"):
        line = line.expandtabs(8)
        if "," in line:
            name, *fields = line.split(",")
            fields = fields[:8]
        else:
            width = 16 if "*" in line[:8] else 8
            name, body = line[:8], line[8:72].ljust(64)
            fields = [body[at : at + width] for at in range(0, 64, width)]
        own = [field.strip() for field in fields]
        if name.strip() and name.strip()[0] not in "+*":
            if card:
                yield first, card
            first, card = number, [name.strip(" *").upper()]
        if card:
            card += own
    if card:
        yield first, card


# --- Ansys ----------------------------------------------------------------------------------------


def _of_ansys(path: Path, nodes: Nodes, cells: Cells) -> None:
    """Blocks NBLOCK and EBLOCK, as CDWRITE writes them: rows of so many fields of so many
    characters, as the line below their names says."""
    block, count, row = "", 0, list[int]()
    whole, real, n_whole = 0, 0, 0
    types, solid, others = dict[int, int](), True, set[int]()
    for number, line in numbered_lines(path, "!"):
        word = line.strip().upper()
        try:
            if word.startswith("ET,") and not block:
                _, own_type, name = word.split(",")[:3]
                types[int(own_type)] = int(name.strip().lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZ"))
            if word.startswith(("NBLOCK", "EBLOCK")):
                if word.startswith("EBLOCK") and "SOLID" not in word:
                    raise ValueError
                block, row = word[:6], []
            elif block and line.lstrip().startswith("("):
                sizes = [int(size) for size in re.findall(r"\d+", line)]
                n_whole, whole, real = sizes[0], sizes[1], sizes[3] if len(sizes) > 3 else 0
            elif word.startswith(("N,", "-1")):
                if row:
                    raise ValueError  # of a cell that goes on
                block = ""
            elif block == "NBLOCK":
                fields = [line[at : at + real] for at in range(n_whole * whole, len(line), real)]
                place = [float(field) for field in fields if field.strip()]
                if any(place[3:]):
                    raise ValueError  # turned
                _put(nodes, number, int(line[:whole]), (*place, 0.0, 0.0, 0.0)[:3])
            elif block == "EBLOCK":
                own = [int(line[at : at + whole]) for at in range(0, len(line), whole)]
                if not row:
                    solid = own[1] not in types or types[own[1]] in SOLIDS
                    others |= set() if solid else {types[own[1]]}
                    count, own = own[8], own[11:]
                row += own
                if len(row) >= count:
                    if solid and len(set(row)) < count:
                        raise ValueError  # a brick with nodes in the same place
                    if solid:
                        cells.setdefault(VTK[count], []).append(row[:count])
                    row = []
        except (ValueError, KeyError, IndexError) as error:
            allowed = "a node without angles, or a whole tetrahedron or brick, of CDWRITE's blocks"
            reason = str(error) if "line" in str(error) else f"line {number}: not {allowed}"
            raise ValueError(reason) from None
    if others and not cells:
        kinds = ", ".join(map(str, sorted(others)))
        raise ValueError(f"none of its elements, of types {kinds}, is a solid that is known")


READERS: dict[str, Callable[[Path, Nodes, Cells], None]] = {
    ".inp": _of_abaqus, ".bdf": _of_nastran, ".dat": _of_nastran, ".nas": _of_nastran,
    ".cdb": _of_ansys,
}  # fmt: skip
