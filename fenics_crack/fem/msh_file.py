"""Mesh files: gmsh reads them in a process of its own, and they are checked before use.

gmsh runs what it does not know as a script, decides by the name of a file what it is, and runs
``NAME.opt`` beside it. So it is given a copy under a name of its own, alone in a folder, and only
if the file begins as a mesh does.

Every cell, edge and point is put into gmsh's current model once. Edges in several named curves are
in a physical group for each combination of these.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.fem.lips import Lip, cell_edges, check_mouths, each_once, find_lips, split_crack
from fenics_crack.fem.mesh_checks import check_mesh
from fenics_crack.mesher import gmsh
from fenics_crack.outside import bytes_of, run_reader

__all__ = [
    "CRACK", "Given", "Group", "Names", "cells_of", "check_there", "facets_of", "filled",
    "groups_of", "named_groups", "points_in", "read_file", "tags_of",
]  # fmt: skip

Point = tuple[float, ...]
Names = tuple[dict[str, tuple[int, ...]], dict[str, Point]]
"""Tags of the facets of each named curve or surface, and positions of the named points [m]."""

FARTHEST_NODE = 1e6
"""Largest coordinate of a node [m]."""
LONGEST_READING = 300
"""Processor time allowed for reading a file [s]."""
_POINT, _TRIANGLES = 15, (2, 9, 21)
_EDGES = {2: 1, 3: 1, 9: 8, 10: 8, 21: 26, 36: 26}
"""gmsh's kinds of cells that DOLFINx reads, and of their edges, order by order; and of points."""
_BEGINNING = re.compile(rb"\$MeshFormat[ \t]*\r?\n[ \t]*(2|2\.[0-2]|4|4\.[01])[ \t]+[01][ \t]+8\s")
"""Of a mesh file in gmsh's format 2 or 4, as text or in binary."""
CRACK = re.compile(r"crack([ _.-]?\d+)?$", re.IGNORECASE)
"""Names of curves along which the nodes exist twice."""


def read_file(path: Path) -> tuple[Names, tuple[Lip, ...]]:
    """Read a mesh file into gmsh's current model; return its named curves and points, and its lips
    from bottom to top.

    Raises
    ------
    InputError
        The file is not a plane mesh of one kind of cells, lacks a group, or is damaged; the lips of
        a crack cannot be found.
    """

    def require(condition: object, allowed: str) -> None:
        if not condition:
            raise InputError("mesh.file", str(path), allowed)

    given = _, positions, groups = groups_of(path)
    flat = len(positions) > 0 and np.ptp(positions[:, 2]) == 0.0
    require(flat, "a plane mesh, z the same at every node")
    kinds = {kind for dimension, _, _, kind, _ in groups if dimension == 2}
    require(
        len(kinds) == 1 and kinds <= _EDGES.keys(),
        "a mesh whose physical surfaces hold one kind of cells, triangles or quadrilaterals"
        f" (it holds {len(kinds)} kinds)",
    )
    kind = kinds.pop()
    used, cells, places = cells_of(kind, given)
    ordered = np.sort(cells, axis=1)
    require(
        places is not None and not np.any(ordered[:, 1:] == ordered[:, :-1]),
        "a mesh whose cells have different nodes",
    )
    assert places is not None
    flat_places = places[:, :2]
    expected = {0: _POINT, 1: _EDGES[kind]}
    parts = [group for group in groups if group[0] != 2]
    require(
        all(k == expected.get(d) and np.isin(nodes, used).all() for d, *_, k, nodes in parts),
        "a mesh whose physical curves and points hold edges and corners of its cells",
    )
    curves = _with_lips(facets_of(parts, _EDGES[kind], used), kind, cells, flat_places)
    require("clamp" in curves, "a mesh with a physical curve named 'clamp'")
    require(
        ("lower_lip" in curves) == ("upper_lip" in curves),
        "a mesh with both 'lower_lip' and 'upper_lip', or none",
    )
    lips = [curves[name][:, :2] for name in ("lower_lip", "upper_lip") if name in curves]
    edges = np.concatenate([*lips, cells[:0, :2]])
    try:
        check_mesh(kind, cells, flat_places, np.unique(curves["clamp"]), edges)
        points = points_in(given, 2)
    except InputError as error:
        raise InputError("mesh.file", f"{path} ({error.value})", error.allowed) from None
    found = find_lips(lips[0], lips[1], flat_places) if lips else []
    tags, sets = tags_of(curves)
    filled(
        places,
        [(2, 1, "plate", kind, cells)]
        + [(1, tag, name, _EDGES[kind], edges) for tag, name, edges in sets]
        + [(0, *group[1:4], np.searchsorted(used, group[4])) for group in parts if group[0] == 0],
    )
    return (tags, points), tuple(found)


def groups_of(path: Path) -> Given:
    """Numbers and positions of a file's nodes, and its groups.

    Raises
    ------
    InputError
        There is no such file, gmsh cannot read it, or a node is nowhere.
    """
    check_there("mesh.file", path)
    found = _read_by_child(path)
    if isinstance(found, str):
        raise InputError("mesh.file", str(path), f"readable by gmsh ({found})")
    if not np.all(np.abs(found[1]) < FARTHEST_NODE):
        allowed = f"a mesh whose nodes are within {FARTHEST_NODE:g} m of the origin"
        raise InputError("mesh.file", str(path), allowed)
    return found


def check_there(key: str, path: Path | str) -> None:
    """Raise InputError unless there is a file."""
    if not os.path.isfile(path):
        raise InputError(key, str(path), "an existing gmsh mesh file")


def points_in(given: Given, size: int) -> dict[str, Point]:
    """Positions of the named points, of so many numbers."""
    numbers, positions, groups = given
    points: dict[str, Point] = {}
    for dimension, _, name, _, nodes in groups:
        if dimension != 0 or not name:
            continue
        if name == "load" and len(nodes) != 1:
            raise InputError("mesh", f"{len(nodes)} points in the group 'load'", "one with one")
        places = np.unique(positions[np.isin(numbers, nodes), :size], axis=0)
        if len(places) == 1:
            points[name] = tuple(places[0].tolist())
    return points


def _with_lips(
    curves: dict[str, np.ndarray], kind: int, cells: np.ndarray, places: np.ndarray
) -> dict[str, np.ndarray]:
    """The curves, those named ``crack`` replaced by the lips that are found along them."""
    cracks = [edges for name, edges in curves.items() if CRACK.match(name)]
    curves = {name: edges for name, edges in curves.items() if not CRACK.match(name)}
    if not cracks and not {"lower_lip", "upper_lip"} <= curves.keys():
        return curves
    corners = 3 if kind in _TRIANGLES else 4
    order = next(iter(curves.values())).shape[1] - 1 if curves else cracks[0].shape[1] - 1
    edges, owners, uses = cell_edges(cells, corners, order)
    edges, owners = edges[uses == 1], owners[uses == 1]
    if cracks:
        centres = places[cells[owners, :corners]].mean(axis=1)
        lips = split_crack(np.concatenate(cracks)[:, :2], edges, centres, places)
        for name, lip in zip(("lower_lip", "upper_lip"), lips, strict=True):
            curves[name] = np.concatenate([curves.get(name, lip[:0]), lip])
    check_mouths(curves["lower_lip"], curves["upper_lip"], edges, places)
    return curves


def tags_of(
    curves: dict[str, np.ndarray],
) -> tuple[dict[str, tuple[int, ...]], list[tuple[int, str, np.ndarray]]]:
    """Tags of each curve; and tag, name and edges of each combination of curves."""
    edges = np.concatenate(list(curves.values()))
    owner = np.repeat(np.arange(len(curves)), [len(own) for own in curves.values()])
    first, which, _ = each_once(edges)
    member = np.zeros((len(first), len(curves)), dtype=bool)
    member[which, owner] = True
    kinds, of_kind = np.unique(member, axis=0, return_inverse=True)
    sets, names = [], np.array(list(curves))
    for number, kind in enumerate(kinds):
        own = edges[np.sort(first[of_kind.ravel() == number])]
        sets.append((number + 1, " and ".join(names[kind]), own))
    groups = {
        name: tuple(int(tag) for tag in np.flatnonzero(column) + 1)
        for name, column in zip(names.tolist(), kinds.T, strict=True)
    }
    return groups, sets


def cells_of(kind: int, given: Given) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Numbers of the nodes of the cells of a kind, in ascending order; the cells, each once (it may
    be in several groups), by the places of their nodes in that order; and the positions of these,
    None where one does not exist."""
    numbers, positions, groups = given
    _, dimension, _, size, *_ = gmsh.model.mesh.getElementProperties(kind)
    numbers, first = np.unique(numbers, return_index=True)
    raw = np.concatenate([nodes for own, *_, nodes in groups if own == dimension])
    used, places = np.unique(raw, return_inverse=True)
    cells = places.reshape(-1, size)
    cells = cells[np.sort(each_once(cells)[0])]
    there = bool(np.isin(used, numbers).all())
    return used, cells, positions[first][np.searchsorted(numbers, used)] if there else None


def facets_of(groups: list[Group], kind: int, used: np.ndarray) -> dict[str, np.ndarray]:
    """Facets of a kind in each named curve or surface, by the places of their nodes among those
    that are used."""
    _, dimension, _, size, *_ = gmsh.model.mesh.getElementProperties(kind)
    found: dict[str, np.ndarray] = {}
    for own, _, name, _, nodes in groups:
        if own == dimension and name:
            rows = np.searchsorted(used, nodes).reshape(-1, size)
            found[name] = np.concatenate([found.get(name, rows[:0]), rows])
    return found


Group = tuple[int, int, str, int, np.ndarray]
"""Dimension, tag and name, and elements of one kind: gmsh's number of it and the nodes."""
Given = tuple[np.ndarray, np.ndarray, list[Group]]
"""Numbers and positions of all nodes, and the groups."""


def filled(positions: np.ndarray, groups: list[Group]) -> None:
    """Put nodes and the elements of physical groups, by the places of their nodes, into the current
    model."""
    model = gmsh.model
    dimension = max(group[0] for group in groups)
    holder = model.addDiscreteEntity(dimension)
    model.mesh.addNodes(dimension, holder, 1 + np.arange(len(positions)), positions.ravel())
    entities: dict[tuple[int, int], list[int]] = {}
    names = {}
    for dimension, tag, name, kind, nodes in groups:
        entity = model.addDiscreteEntity(dimension)
        model.mesh.addElementsByType(entity, kind, [], nodes.ravel() + 1)
        entities.setdefault((dimension, tag), []).append(entity)
        names[dimension, tag] = name
    for (dimension, tag), tags in entities.items():
        model.addPhysicalGroup(dimension, tags, tag)
        model.setPhysicalName(dimension, tag, names[dimension, tag])


def _read_by_child(path: Path) -> Given | str:
    """Numbers and positions of a file's nodes and its groups, or why it cannot be read."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mesh.msh"
        try:
            bytes_of(path)
            shutil.copyfile(path, copy)
            with copy.open("rb") as file:
                if not _BEGINNING.match(file.read(100)):
                    return "it does not begin with $MeshFormat and version 2.2 or 4.1"
        except OSError as error:
            return error.strerror or str(error)
        found = run_reader(Path(__file__).with_name("msh_reader.py"), copy, LONGEST_READING)
    if isinstance(found, str):
        return found.replace(str(copy), str(path))
    return found["numbers"], found["positions"], named_groups(found)


def named_groups(found: dict[str, np.ndarray]) -> list[Group]:
    """Groups as :mod:`fenics_crack.fem.msh_reader` tells them."""
    parts = np.split(found["nodes"], np.cumsum(found["heads"][:, 3])[:-1])
    return [
        (dimension, tag, name, kind, nodes)
        for (dimension, tag, kind, _), name, nodes in zip(
            found["heads"].tolist(), found["names"].tolist(), parts, strict=False
        )
    ]
