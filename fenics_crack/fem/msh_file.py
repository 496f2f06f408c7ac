"""Mesh files: gmsh reads them in a process of its own, and they are checked before use."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.fem.compat import gmsh

__all__ = ["read_file"]

FARTHEST = 1e6
"""Largest coordinate of a node [m]."""
LONGEST_READING = 300
"""Time allowed for reading a file [s]."""
_POINT, _TRIANGLES = 15, (2, 9, 21)
_EDGES = {2: 1, 3: 1, 9: 8, 10: 8, 21: 26, 36: 26}
"""gmsh's kinds of cells that DOLFINx reads, and of their edges, order by order; and of points."""


def read_file(path: Path) -> None:
    """Read a mesh file into gmsh's current model.

    Raises
    ------
    InputError
        The file is not a plane mesh of one kind of cells, or is damaged.
    """

    def require(condition: object, allowed: str) -> None:
        if not condition:
            raise InputError("mesh.file", str(path), allowed)

    require(path.is_file(), "an existing gmsh mesh file")
    found = _read_by_child(path)
    if isinstance(found, str):
        raise InputError("mesh.file", str(path), f"readable by gmsh ({found})")
    numbers, positions, groups = found
    flat = len(positions) > 0 and np.ptp(positions[:, 2]) == 0.0
    require(
        flat and np.all(np.abs(positions) < FARTHEST),
        f"a plane mesh, z the same at every node, within {FARTHEST:g} m of the origin",
    )
    kinds = {kind for dimension, _, _, kind, _ in groups if dimension == 2}
    require(
        len(kinds) == 1 and kinds <= _EDGES.keys(),
        "a mesh whose physical surfaces hold one kind of cells, triangles or quadrilaterals"
        f" (it holds {len(kinds)} kinds)",
    )
    kind = kinds.pop()
    cells = _cells(kind, [nodes for dimension, *_, nodes in groups if dimension == 2])
    require(
        _is_sound(kind, cells) and np.isin(cells, numbers).all(),
        "a mesh whose cells have different corners, and at most two of them an edge",
    )
    expected = {0: _POINT, 1: _EDGES[kind]}
    parts = [group for group in groups if group[0] != 2]
    require(
        all(k == expected.get(d) and np.isin(nodes, cells).all() for d, *_, k, nodes in parts),
        "a mesh whose physical curves and points hold edges and corners of its cells",
    )
    numbers, first = np.unique(numbers, return_index=True)
    used = np.isin(numbers, cells)
    plate = (2, 1, "plate", kind, cells.ravel())
    _fill(numbers[used], positions[first[used]], [plate, *parts])


def _cells(kind: int, nodes: list[np.ndarray]) -> np.ndarray:
    """Cells and their nodes, each cell once: a surface may be in several groups."""
    cells = np.concatenate(nodes).reshape(-1, gmsh.model.mesh.getElementProperties(kind)[3])
    return cells[np.sort(np.unique(np.sort(cells, axis=1), axis=0, return_index=True)[1])]


def _is_sound(kind: int, cells: np.ndarray) -> bool:
    """Whether no cell has a node twice, and no edge belongs to three cells."""
    ordered = np.sort(cells, axis=1)
    if np.any(ordered[:, 1:] == ordered[:, :-1]):
        return False
    corners = cells[:, : 3 if kind in _TRIANGLES else 4]
    edges = np.stack([corners, np.roll(corners, 1, axis=1)], axis=2).reshape(-1, 2)
    return int(np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)[1].max()) <= 2


_Group = tuple[int, int, str, int, np.ndarray]
"""Dimension, tag and name, and elements of one kind: gmsh's number of it and the nodes."""


def _fill(numbers: np.ndarray, positions: np.ndarray, groups: list[_Group]) -> None:
    """Put nodes and the elements of physical groups into the current model."""
    model = gmsh.model
    holder = model.addDiscreteEntity(2)
    model.mesh.addNodes(2, holder, numbers, positions.ravel())
    entities: dict[tuple[int, int], list[int]] = {}
    names = {}
    for dimension, tag, name, kind, nodes in groups:
        entity = model.addDiscreteEntity(dimension)
        model.mesh.addElementsByType(entity, kind, [], nodes)
        entities.setdefault((dimension, tag), []).append(entity)
        names[dimension, tag] = name
    for (dimension, tag), tags in entities.items():
        model.addPhysicalGroup(dimension, tags, tag)
        model.setPhysicalName(dimension, tag, names[dimension, tag])


def _read_by_child(path: Path) -> tuple[np.ndarray, np.ndarray, list[_Group]] | str:
    """Numbers and positions of a file's nodes and its groups, or gmsh's error message."""
    reader = [sys.executable, "-I", str(Path(__file__).with_name("msh_reader.py")), str(path)]
    try:
        done = subprocess.run(reader, capture_output=True, timeout=LONGEST_READING)
    except subprocess.TimeoutExpired:
        return "it does not end"
    found: Any = pickle.loads(done.stdout) if done.returncode == 0 else "it crashes"
    return found  # type: ignore[no-any-return]
