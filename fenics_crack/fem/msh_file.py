"""Mesh files: gmsh reads them in a process of its own, and they are checked before use.

gmsh runs what it does not know as a script, decides by the name of a file what it is, and runs
``NAME.opt`` beside it. So it is given a copy under a name of its own, alone in a folder, and only
if the file begins as a mesh does.

Every cell, edge and point is put into gmsh's current model once. Edges in several named curves are
in a physical group for each combination of these.

A mesh that is certainly not one of a plane structure is refused, with its place. Cells may be
numbered either way round, surface by surface. They must not be folded: the Jacobian determinant of
a cell has one sign at all of its nodes, two cells that share an edge lie on either side of it, and
the angles at a node are at most 2 pi. Then nothing overlaps in the neighbourhood of any point, and
elsewhere only where boundaries cross or a part lies on another one.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

import numpy as np
import scipy.sparse as sparse

from fenics_crack.errors import InputError
from fenics_crack.fem.lips import (
    SAME,
    Lip,
    cell_edges,
    check_mouths,
    each_once,
    find_lips,
    split_crack,
)
from fenics_crack.mesher import gmsh
from fenics_crack.outside import bytes_of, run_reader

__all__ = [
    "CRACK", "DEGENERATE", "Given", "Names", "cells_of", "check_mesh", "check_there",
    "determinants", "facets_of", "filled", "groups_of", "named_groups", "parts_of", "points_in",
    "read_file", "tags_of",
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


# --- is it a mesh of a plane structure? -----------------------------------------------------------

DEGENERATE = 1e-9
"""Of a determinant relative to its largest value or to the square of the cell's size, and of an
angle relative to 2 pi."""
SAMPLES = 50
"""Cells of a part whose centres must not lie on another part."""


def check_mesh(
    kind: int, cells: np.ndarray, places: np.ndarray, clamp: np.ndarray, lips: np.ndarray
) -> None:
    """Raise InputError where a mesh cannot be one of a structure.

    Parameters
    ----------
    kind : int
        gmsh's number of the kind of cells.
    cells : (n_cells, n) int
        Their nodes in gmsh's order.
    places : (n_nodes, 2) [m]
        Of all nodes.
    clamp : (m,) int
        Nodes that are clamped.
    lips : (n_edges, 2) int
        Corners of the edges of all lips.

    Raises
    ------
    InputError
        Cells are folded or overlap, a part has no clamp, or edges of the boundary other than lips
        lie in one place.
    """
    corners = gmsh.model.mesh.getElementProperties(kind)[5]
    signs = _signs(kind, cells, places)
    cells = cells[:, :corners]
    boundary, owners = _unfolded_boundary(cells, signs, places)
    _check_angles(cells, places)
    n_parts, part = parts_of(cells, places, clamp, lips)
    _check_boundary(boundary, places, lips)
    if n_parts > 1:
        _check_layers(boundary, part[owners], cells, part, places)


def _refusal(found: str, place: np.ndarray, allowed: str) -> InputError:
    return InputError("mesh", f"{found} at ({', '.join(f'{x:g}' for x in place)})", allowed)


def determinants(
    kind: int, cells: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least and largest of the Jacobian determinants at the nodes of each cell, as gmsh numbers a
    kind, and the one of least size: (n_cells,) each [m^d]."""
    _, dimension, _, nodes, local, _ = gmsh.model.mesh.getElementProperties(kind)
    at = np.zeros((nodes, 3))
    at[:, :dimension] = np.reshape(local, (nodes, dimension))
    _, gradients, _ = gmsh.model.mesh.getBasisFunctions(kind, at.ravel(), "GradLagrange")
    gradients = np.reshape(gradients, (nodes, nodes, 3))[:, :, :dimension]
    here = places[cells].swapaxes(1, 2)
    every = np.array([np.linalg.det(here @ gradient) for gradient in gradients])
    return every.min(axis=0), every.max(axis=0), np.abs(every).min(axis=0)


def _signs(kind: int, cells: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Direction in which each cell is numbered, 1 or -1, from the determinants at its nodes."""
    least, most, _ = determinants(kind, cells, places)
    largest = np.maximum(-least, most)
    size = np.ptp(places[cells], axis=1).max(axis=1)
    for found, wrong in (
        ("a cell without area", largest <= DEGENERATE * size**2),
        ("a folded cell", np.minimum(-least, most) > DEGENERATE * largest),
    ):
        if np.any(wrong):
            place = places[cells[np.argmax(wrong)]].mean(axis=0)
            raise _refusal(found, place, "one of cells that are convex and have an area")
    return np.where(most > -least, 1, -1)


def _unfolded_boundary(
    cells: np.ndarray, signs: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Edges of one cell only, (n, 2), and their cells, where no two cells lie on one side of their
    common edge."""
    ahead = np.roll(cells, -1, axis=1)
    low, high = np.minimum(cells, ahead).ravel(), np.maximum(cells, ahead).ravel()
    upwards = ((cells < ahead) == (signs[:, None] > 0)).ravel()
    keys = low * len(places) + high
    order = np.argsort(keys, kind="stable")
    shared = keys[order[1:]] == keys[order[:-1]]
    if np.any(third := shared[1:] & shared[:-1]):
        edge = order[np.argmax(third)]
        place = (places[low[edge]] + places[high[edge]]) / 2.0
        raise _refusal("an edge of three cells", place, "one of at most two cells at an edge")
    folded = shared & (upwards[order[1:]] == upwards[order[:-1]])
    if np.any(folded):
        edge = order[np.argmax(folded)]
        place = (places[low[edge]] + places[high[edge]]) / 2.0
        allowed = "one of cells beside each other: these lie on one side of their common edge"
        raise _refusal("cells that overlap", place, allowed)
    alone = np.ones(len(keys), dtype=bool)
    alone[1:] &= ~shared
    alone[:-1] &= ~shared
    own = np.sort(order[alone])
    return np.column_stack([low[own], high[own]]), own // cells.shape[1]


def _check_angles(cells: np.ndarray, places: np.ndarray) -> None:
    """Angles at a node are 2 pi inside the mesh and less on its boundary."""
    here = places[cells]
    ahead, back = np.roll(here, -1, axis=1) - here, np.roll(here, 1, axis=1) - here
    crossed = ahead[..., 0] * back[..., 1] - ahead[..., 1] * back[..., 0]
    angles = np.arctan2(np.abs(crossed), (ahead * back).sum(axis=2))
    sums = np.bincount(cells.ravel(), angles.ravel(), len(places))
    worst = int(np.argmax(sums))
    if sums[worst] > 2.0 * np.pi * (1.0 + DEGENERATE):
        allowed = "one of cells beside each other: these go round their node more than once"
        raise _refusal("cells that overlap", places[worst], allowed)


def parts_of(
    cells: np.ndarray, places: np.ndarray, clamp: np.ndarray, lips: np.ndarray
) -> tuple[int, np.ndarray]:
    """Number of parts of a mesh that share no node, all of them clamped, and the part of each
    cell."""
    from scipy.sparse.csgraph import connected_components  # takes a while, for mesh files alone

    ones = np.ones(cells.size - len(cells), dtype=np.int8)
    ends = cells[:, :-1].ravel(), cells[:, 1:].ravel()
    graph = sparse.coo_matrix((ones, ends), (len(places), len(places)))
    part = connected_components(graph, directed=False)[1]
    own = np.unique(part[cells[:, 0]], return_inverse=True)[1]
    loose = np.flatnonzero(~np.isin(part[cells[:, 0]], part[clamp]))
    if len(loose):
        place = places[cells[loose]].mean(axis=(0, 1))
        held = len(lips) and np.any(np.isin(part[cells[loose, 0]], part[lips[:, 0]]))
        found = "a part held by contact alone" if held else "a part without a clamp"
        side = "an edge" if places.shape[1] == 2 else "a facet"
        allowed = (
            f"one whose parts each have {side} in 'clamp', or share nodes with one that has: "
            "nothing else holds them"
        )
        raise _refusal(found, place, allowed)
    return int(own.max()) + 1, own


def _check_boundary(edges: np.ndarray, places: np.ndarray, lips: np.ndarray) -> None:
    """Edges of the boundary neither cross nor lie in one place, but for those of lips."""
    from scipy.spatial import cKDTree

    size = len(places)
    is_lip = np.isin(edges @ [size, 1], np.sort(lips, axis=1) @ [size, 1])
    ends = places[edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    middles = ends.mean(axis=1)
    found = cKDTree(middles).query_ball_point(middles, lengths * (1.0 + SAME))
    one = np.repeat(np.arange(len(edges)), [len(near) for near in found])
    other = np.concatenate(found).astype(int)
    behind = (lengths[other] < lengths[one]) | ((lengths[other] == lengths[one]) & (other < one))
    wanted = behind & ~(is_lip[one] & is_lip[other])
    one, other = one[wanted], other[wanted]  # the shorter edge
    close = SAME * float(np.ptp(places, axis=0).max())

    from_one, from_other = _beside(ends[one], ends[other]), _beside(ends[other], ends[one])
    across = [np.abs(side).min(axis=1) > close for side in (from_one, from_other)]
    across += [side.prod(axis=1) < 0.0 for side in (from_one, from_other)]
    if np.any(crossed := np.all(across, axis=0)):
        place = middles[other[np.argmax(crossed)]]
        raise _refusal("cells that overlap", place, "one whose boundary does not cross itself")

    span = ends[one, 1] - ends[one, 0]
    share = np.sum((middles[other] - ends[one, 0]) * span, axis=1) / lengths[one] ** 2
    along = np.abs(from_one).max(axis=1) <= close
    inside = np.minimum(share, 1.0 - share) * lengths[one] > close
    if np.any(same := along & inside):
        place = middles[other[np.argmax(same)]]
        allowed = (
            "one whose cells share their nodes (gmsh: Coherence Mesh), but for the lips of named "
            "cracks ('crack', or 'lower_lip' and 'upper_lip'): two edges of its boundary lie there"
        )
        raise _refusal("doubled nodes", place, allowed)


def _beside(edges: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance of both ends of other edges from the lines of edges, left of them positive."""
    span = edges[:, 1] - edges[:, 0]
    to = others - edges[:, :1]
    crossed = span[:, None, 0] * to[..., 1] - span[:, None, 1] * to[..., 0]
    return np.asarray(crossed / np.linalg.norm(span, axis=1)[:, None])


def _check_layers(
    edges: np.ndarray, of_edge: np.ndarray, cells: np.ndarray, part: np.ndarray, places: np.ndarray
) -> None:
    """No part lies on another one: a ray from a cell crosses the others' boundaries evenly."""
    (x_0, y_0), (x_1, y_1) = places[edges].transpose(1, 2, 0)
    for number in range(int(part.max()) + 1):
        own = np.flatnonzero(part == number)
        own = own[np.linspace(0, len(own) - 1, min(SAMPLES, len(own))).astype(int)]
        centres = places[cells[own]].mean(axis=1)
        x, y = centres.T[:, :, None]
        passed = (y_0 <= y) != (y_1 <= y)
        with np.errstate(divide="ignore", invalid="ignore"):
            passed &= x_0 + (y - y_0) / (y_1 - y_0) * (x_1 - x_0) > x
        inside = np.sum(passed & (of_edge != number), axis=1) % 2 == 1
        if np.any(inside):
            allowed = "one whose parts lie beside each other: here one lies on another"
            raise _refusal("cells that overlap", centres[np.argmax(inside)], allowed)
