"""Mesh files: gmsh reads them in a process of its own, and they are checked before use.

gmsh runs what it does not know as a script, decides by the name of a file what it is, and runs
``NAME.opt`` beside it. So it is given a copy under a name of its own, alone in a folder, and only
if the file begins as a mesh does.

A mesh of a plate or of a solid comes as nodes, cells and named facets: curves, or surfaces. Nodes
along a crack are doubled here (:mod:`fenics_crack.fem.cracks`), whether gmsh's plugin
"Crack" has done it already or not. Every cell, facet and point is put into gmsh's current model
once. Facets with several names are in a physical group for each combination of these.

A mesh that is certainly not one of a structure is refused, with its place. Cells may be numbered
either way round, group by group. They must not be folded: the Jacobian determinant of a cell has
one sign at all of its nodes, and two cells that share a facet lie on either side of it. No facet of
the boundary but those of crack faces has its middle, or a point halfway to a corner, in or on
another cell than its own: parts do not lie on one another, and where they touch they share their
nodes, or nothing would hold them together.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fenics_crack.basics.errors import InputError, reading
from fenics_crack.basics.gmsh_process import gmsh
from fenics_crack.basics.untrusted_files import beginning_of, copied, run_reader
from fenics_crack.fem.cracks import (
    FACETS,
    LIP_TAGS,
    POSITION_TOLERANCE,
    Cells,
    Cracks,
    NamedParts,
    find_crack_paths,
    find_crack_surfaces,
    find_unique_rows,
    label_parts,
    merge_crack_nodes,
    require,
    rows_in,
    split_cracks,
)

Group = tuple[int, int, str, int, np.ndarray]
"""Dimension, tag and name, and elements of one kind: gmsh's number of it and the nodes."""
RawMesh = tuple[np.ndarray, np.ndarray, list[Group]]
"""Numbers and positions of all nodes, and the groups."""
CRACK_NAME = re.compile(r"crack([ _.-]?\d+)?$", re.IGNORECASE)
"""Names of curves and of surfaces that are cracks."""

_BEGINNING = re.compile(rb"\$MeshFormat[ \t]*\r?\n[ \t]*(2|2\.[0-2]|4|4\.[01])[ \t]+[01][ \t]+8\s")
"""First bytes of a mesh file in gmsh's format 2 or 4, as text or in binary."""
_KINDS = {2: {2: 1, 3: 1, 9: 8, 10: 8, 21: 26, 36: 26}, 3: {4: 2, 11: 9, 5: 3, 12: 10}}
"""gmsh's kinds of cells of a plate and of a solid that DOLFINx reads, and of their facets."""
_POINT = 15
"""gmsh's kind of points."""
_LINEAR = {(2, 3): 2, (2, 4): 3, (3, 4): 4, (3, 8): 5}
"""Kinds of first order, by dimension and corners."""
_GROUPS = {
    2: ("surfaces hold one kind of cells, triangles or quadrilaterals", "curve"),
    3: ("volumes hold one kind of cells, tetrahedra or hexahedra", "surface"),
}
"""Contents of groups of cells, and the name of a group of facets."""
_FACET = {2: "an edge", 3: "a facet"}


def read_mesh_file(path: Path, dimension: int) -> tuple[NamedParts, Cracks]:
    """Read the mesh file of a plate or of a solid into gmsh's current model, as :func:`put`.

    Raises
    ------
    InputError
        The file is not a mesh of one kind of cells, lacks a group, or is damaged; the crack faces
        of a crack cannot be found.
    """
    try:
        return load_mesh(_groups_of(path), dimension)
    except InputError as error:
        if error.key in ("mesh.file", "lips"):
            raise
        raise InputError("mesh.file", f"{path} ({error.value})", error.allowed) from None


def load_mesh(given: RawMesh, dimension: int) -> tuple[NamedParts, Cracks]:
    """Put a mesh of a plate or of a solid into gmsh's current model; its named facets and points,
    and its crack faces from bottom to top.

    Raises
    ------
    InputError
        As :func:`read_file`, but of the key "mesh".
    """
    kind, cells, positions, facets, points = _one_kind(given, dimension)
    places = positions[:, :dimension]
    check_cells(kind, cells, places)
    cracks = [name for name in facets if CRACK_NAME.match(name)]
    if dimension == 3:
        _check_inside(cells, facets, cracks)
    if cracks:
        surface = np.concatenate([facets.pop(name) for name in cracks])
        kept, number = merge_crack_nodes(surface, places)
        whole = replace(cells, nodes=number[cells.nodes])
        nodes, twins, both = split_cracks(whole, number[surface], places[kept])
        facets = _moved(facets, cells, nodes, number)
        for name, lip in zip(LIP_TAGS, both.swapaxes(0, 1), strict=True):
            facets[name] = np.concatenate([facets.get(name, lip[:0]), lip])
        points = [(*head, number[own]) for *head, own in points]
        positions = positions[np.concatenate([kept, kept[twins]])]
        cells, places = replace(cells, nodes=nodes), positions[:, :dimension]
    sides = [facets[name][:, : cells.facets.shape[1]] for name in LIP_TAGS if name in facets]
    allowed = "one with both 'lower_lip' and 'upper_lip', or with 'crack', or none of them"
    require(len(sides) != 1, "one lip", allowed)
    lips: Cracks = ()
    if sides and dimension == 2:
        lips = find_crack_paths(sides[0], sides[1], places)
        _check_tips(cells, places, sides)
    elif sides:
        lips = find_crack_surfaces(sides[0], sides[1], places)
    check_parts(cells, places, facets["clamp"], sides)
    check_boundary(kind, cells, places, sides)
    tags, sets = _tags_of(facets)
    every = [(dimension, 1, ("plate", "solid")[dimension - 2], kind, cells.nodes)]
    every += [(dimension - 1, tag, name, _KINDS[dimension][kind], own) for tag, name, own in sets]
    _fill_model(positions, every + points)
    single = {name: np.unique(places[own], axis=0) for _, _, name, _, own in points}
    return (tags, {n: tuple(own[0].tolist()) for n, own in single.items() if len(own) == 1}), lips


# --- what a file holds ----------------------------------------------------------------------------


def _groups_of(path: Path) -> RawMesh:
    """Numbers and positions of a file's nodes, and its groups.

    Raises
    ------
    InputError
        There is no such file, gmsh cannot read it, or a node is nowhere.
    """
    check_file_exists("mesh.file", path)
    with reading("mesh.file", path, "readable by gmsh"), copied(path, "mesh.msh") as copy:
        if not _BEGINNING.match(beginning_of(copy, 100)):
            raise ValueError("it does not begin with $MeshFormat and version 2.2 or 4.1")
        found = run_reader(Path(__file__).with_name("msh_reader.py"), copy, 300)
        if isinstance(found, str):
            raise ValueError(found.replace(str(copy), str(path)))
    farthest = 1e6  # [m]
    if not np.all(np.abs(found["positions"]) < farthest):
        allowed = f"a mesh whose nodes are within {farthest:g} m of the origin"
        raise InputError("mesh.file", str(path), allowed)
    return found["numbers"], found["positions"], unpack_groups(found)


def check_file_exists(key: str, path: Path | str) -> None:
    """Raise InputError unless there is a file."""
    if not os.path.isfile(path):
        raise InputError(key, str(path), "an existing gmsh mesh file")


def unpack_groups(found: dict[str, np.ndarray]) -> list[Group]:
    """Groups as :mod:`fenics_crack.fem.msh_reader` returns them."""
    parts = np.split(found["nodes"], np.cumsum(found["heads"][:, 3])[:-1])
    rows = zip(found["heads"].tolist(), found["names"].tolist(), parts, strict=False)
    return [(dimension, tag, name, kind, own) for (dimension, tag, kind, _), name, own in rows]


def _one_kind(
    given: RawMesh, dimension: int
) -> tuple[int, Cells, np.ndarray, dict[str, np.ndarray], list[Group]]:
    """The kind of the cells of a mesh; the cells, each once (it may be in several groups); the
    positions of their nodes; and by their places in these the named facets, a clamp among them,
    and groups of points."""
    numbers, positions, groups = given
    held, side = _GROUPS[dimension]
    if dimension == 2:
        flat = len(positions) > 0 and np.ptp(positions[:, 2]) == 0.0
        require(flat, "no plane mesh", "a plane mesh, z the same at every node")
    kinds = {kind for own, _, _, kind, _ in groups if own == dimension}
    allowed = "one of tetrahedra, or of hexahedra with 27 nodes"
    allowed += ": the load of a unit pressure is negative at corners of these"
    require(kinds.isdisjoint((17, 29)), "hexahedra with 20 nodes", allowed)
    known = len(kinds) == 1 and kinds <= _KINDS[dimension].keys()
    require(known, f"{len(kinds)} kinds of cells", f"one whose physical {held}")
    kind = kinds.pop()
    numbers, first = np.unique(numbers, return_index=True)
    raw = np.concatenate([nodes for own, *_, nodes in groups if own == dimension])
    used, places = np.unique(raw, return_inverse=True)
    require(np.isin(used, numbers).all(), "cells with nodes that do not exist", "a whole file")
    nodes = places.reshape(-1, gmsh.model.mesh.getElementProperties(kind)[3])
    nodes = nodes[np.sort(find_unique_rows(nodes)[0])]
    ordered = np.sort(nodes, axis=1)
    twice = np.any(ordered[:, 1:] == ordered[:, :-1])
    require(not twice, "a cell with a node twice", "one whose cells have different nodes")
    facets, points = _named(groups, {0: _POINT, dimension - 1: _KINDS[dimension][kind]}, used)
    there = f"{side}s named {', '.join(map(repr, facets))}" if facets else f"no {side} has a name"
    allowed = f"one with a physical {side} named 'clamp'"
    require("clamp" in facets, f"no clamp; {there}", allowed)
    at = positions[first][np.searchsorted(numbers, used)]
    return kind, cells_of(kind, nodes), at, facets, points


def _named(
    groups: list[Group], kinds: dict[int, int], used: np.ndarray
) -> tuple[dict[str, np.ndarray], list[Group]]:
    """Named facets and groups of points, by the places of their nodes among those that are used,
    and by the kinds that they have to be of."""
    found: dict[tuple[int, str], list[np.ndarray]] = {}
    for dimension, _, name, kind, nodes in groups:
        if name and dimension in kinds:
            fits = kind == kinds[dimension] and np.isin(nodes, used).all()
            allowed = "one whose named groups hold facets, and corners, of its cells"
            require(fits, f"other elements in the group {name!r}", allowed)
            size = gmsh.model.mesh.getElementProperties(kind)[3]
            rows = np.searchsorted(used, nodes).reshape(-1, size)
            found.setdefault((dimension, name), []).append(rows)
    merged = {key: np.concatenate(rows) for key, rows in found.items()}
    loads = len(merged.get((0, "load"), [0]))
    require(loads == 1, f"{loads} points in the group 'load'", "one with one")
    facets = {name: rows for (dimension, name), rows in merged.items() if dimension}
    points = {name: rows[:, 0] for (dimension, name), rows in merged.items() if not dimension}
    return facets, [(0, n, name, _POINT, own) for n, (name, own) in enumerate(points.items(), 1)]


def cells_of(kind: int, nodes: np.ndarray) -> Cells:
    """Cells with what gmsh says of their kind: a node lies between those corners whose linear
    functions are not zero there."""
    _, dimension, *_, corners = gmsh.model.mesh.getElementProperties(kind)
    between = _functions(_LINEAR[dimension, corners], _places_in(kind)) > 1e-9
    ring = np.arange(corners)
    facets = FACETS[corners] if dimension == 3 else np.column_stack([ring, np.roll(ring, -1)])
    return Cells(nodes, facets, between)


def _moved(
    surfaces: dict[str, np.ndarray], cells: Cells, nodes: np.ndarray, number: np.ndarray
) -> dict[str, np.ndarray]:
    """Facets with the ``nodes`` (n_cells, k) that their cells have once cracks are split, beside a
    crack those of their own side; elsewhere with the ``number`` (n_nodes,) of each node."""
    facets, owner, _ = cells.sorted_facets
    corners = min(facets.shape[1], 3)  # are enough
    weights = (int(cells.nodes.max()) + 1) ** np.arange(corners)[::-1]
    keys, width = facets[:, :corners] @ weights, facets.shape[1]
    moved = np.unique(cells.nodes[nodes != number[cells.nodes]])
    found = {}
    for name, rows in surfaces.items():
        found[name] = number[rows]
        beside = np.flatnonzero(np.isin(rows, moved).any(axis=1))
        wanted = np.sort(rows[beside, :width], axis=1)[:, :corners] @ weights
        cell = owner[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)]
        at = np.argmax(cells.nodes[cell][:, None, :] == rows[beside][:, :, None], axis=2)
        found[name][beside] = np.take_along_axis(nodes[cell], at, axis=1)
    return found


def _check_tips(cells: Cells, places: np.ndarray, lips: Sequence[np.ndarray]) -> None:
    """Raise InputError if a tip lies on the edge of the plate: a mouth whose node exists once."""
    edges = cells.sorted_facets[0][cells.is_boundary]
    edges = edges[~rows_in(edges, np.concatenate(lips))]
    closed = np.intersect1d(np.intersect1d(*lips), edges)
    if len(closed):
        place = "({:g}, {:g})".format(*places[closed[0]])
        allowed = "open there, with a node of each face; or of one curve named 'crack'"
        found = f"a mouth at {place} that is closed"
        raise InputError("lips", found, f"{allowed}, which is split")


def _tags_of(
    curves: dict[str, np.ndarray],
) -> tuple[dict[str, tuple[int, ...]], list[tuple[int, str, np.ndarray]]]:
    """Tags of each curve; and tag, name and edges of each combination of curves."""
    edges = np.concatenate(list(curves.values()))
    owner = np.repeat(np.arange(len(curves)), [len(own) for own in curves.values()])
    first, which, _ = find_unique_rows(edges)
    member = np.zeros((len(first), len(curves)), dtype=bool)
    member[which, owner] = True
    kinds, of_kind = np.unique(member, axis=0, return_inverse=True)
    sets, names = [], np.array(list(curves))
    for number, kind in enumerate(kinds):
        own = edges[np.sort(first[of_kind.ravel() == number])]
        sets.append((number + 1, " and ".join(names[kind]), own))
    tags = [tuple((np.flatnonzero(column) + 1).tolist()) for column in kinds.T]
    return dict(zip(curves, tags, strict=True)), sets


def _fill_model(positions: np.ndarray, groups: list[Group]) -> None:
    """Put nodes and the elements of physical groups, those of the cells first, by the places of
    their nodes, into the current model."""
    model, dimension = gmsh.model, groups[0][0]
    holder = model.addDiscreteEntity(dimension)
    model.mesh.addNodes(dimension, holder, 1 + np.arange(len(positions)), positions.ravel())
    for dimension, tag, name, kind, nodes in groups:
        entity = model.addDiscreteEntity(dimension)
        model.mesh.addElementsByType(entity, kind, [], nodes.ravel() + 1)
        model.addPhysicalGroup(dimension, [entity], tag)
        model.setPhysicalName(dimension, tag, name)


# --- is it a mesh of a structure? -----------------------------------------------------------------

MIN_RELATIVE_DETERMINANT = 1e-9
"""Minimum determinant relative to its largest value or to the square of the cell's size."""


def _refusal(found: str, place: np.ndarray, allowed: str) -> InputError:
    return InputError("mesh", f"{found} at ({', '.join(f'{x:g}' for x in place)})", allowed)


def check_cells(kind: int, cells: Cells, places: np.ndarray) -> None:
    """Raise InputError where a cell, of gmsh's number of the kind, is folded or of no size, or two
    lie on one side of the facet that they share; ``places`` (n_nodes, d) [m] are those of all
    nodes."""
    dimension, part = places.shape[1], _FACET[places.shape[1]]
    here, at = places[cells.nodes], _places_in(kind)
    gradients = _functions(kind, at, "GradLagrange").reshape(len(at), len(at), 3)[..., :dimension]
    # Jacobian determinants at the nodes of each cell [m^d].
    every = np.array([np.linalg.det(here.swapaxes(1, 2) @ gradient) for gradient in gradients])
    least, most, smallest = every.min(axis=0), every.max(axis=0), np.abs(every).min(axis=0)
    size, largest = np.ptp(here, axis=1).max(axis=1) ** dimension, np.maximum(-least, most)
    extent = ("area", "volume")[dimension - 2]
    # In a plane a corner may have 180 degrees.
    flat = (largest if dimension == 2 else smallest) <= MIN_RELATIVE_DETERMINANT * size
    folded = np.minimum(-least, most) > MIN_RELATIVE_DETERMINANT * largest
    for found, wrong in ((f"a cell without {extent}", flat), ("a folded cell", folded)):
        if np.any(wrong):
            allowed = f"one of cells that are convex and have {extent}"
            if cells.nodes.shape[1] > cells.n_corners:
                allowed += "; gmsh: Mesh.HighOrderOptimize = 1, or cells of first order"
            raise _refusal(found, here[np.argmax(wrong)].mean(axis=0), allowed)
    facets, owner, _ = cells.sorted_facets
    corners, middles = places[facets], here[:, : cells.n_corners].mean(axis=1)
    spans = np.append(corners[:, 1:dimension], middles[owner, None], axis=1) - corners[:, :1]
    side, shared = np.sign(np.linalg.det(spans)), cells.is_shared
    beside = f"one of cells beside each other: these lie on one side of {part} of both"
    for found, wrong, allowed in (
        (f"{part} of three cells", shared[1:] & shared[:-1], f"one of at most two cells at {part}"),
        ("cells that overlap", shared & (side[1:] == side[:-1]), beside),
    ):
        if np.any(wrong):
            raise _refusal(found, corners[np.argmax(wrong)].mean(axis=0), allowed)


def _check_inside(cells: Cells, surfaces: dict[str, np.ndarray], cracks: list[str]) -> None:
    """Raise InputError where a surface lies inside and is no crack by its name, nor the clamp:
    nothing would part there."""
    facets, _, _ = cells.sorted_facets
    shared, width = facets[1:][cells.is_shared], facets.shape[1]
    corners = {name: np.sort(rows[:, :width], axis=1) for name, rows in surfaces.items()}
    known = np.concatenate([facets[:0], *(corners[name] for name in cracks)])
    for name, rows in corners.items():
        inside = rows_in(rows, shared) & ~rows_in(rows, known)
        if name != "clamp" and np.any(inside):
            allowed = "one whose surfaces inside are cracks, named 'crack' or 'crack 1', 'crack 2'"
            raise InputError("mesh", f"a surface {name!r} inside the solid", allowed)


def check_parts(
    cells: Cells, places: np.ndarray, clamp: np.ndarray, lips: Sequence[np.ndarray]
) -> None:
    """Raise InputError where a part, which shares no node with others, has no clamp.

    Parameters
    ----------
    cells : Cells
        With cracks split.
    places : (n_nodes, d) [m]
        Of all nodes.
    clamp : (m,) or (m, k) int
        Nodes that are clamped.
    lips : sequence of (n, d) int
        Corners of the facets of crack faces.
    """
    part = label_parts(cells.nodes)

    def has(nodes: np.ndarray) -> np.ndarray:
        """True for cells of a part that has one of some nodes: (n_cells,)."""
        return np.isin(part, part[np.isin(cells.nodes, nodes).any(axis=1)])

    loose = ~has(clamp)
    if np.any(loose):
        held = any(np.any(has(own) & loose) for own in lips)
        found = "a part held by contact alone" if held else "a part without a clamp"
        allowed = f"one whose parts each have {_FACET[places.shape[1]]} in 'clamp', or share nodes"
        allowed += " with one that has: nothing else holds them"
        raise _refusal(found, places[cells.nodes[loose]].mean(axis=(0, 1)), allowed)


def check_boundary(kind: int, cells: Cells, places: np.ndarray, lips: Sequence[np.ndarray]) -> None:
    """Raise InputError where the middle of a facet of the boundary, other than crack faces, or a
    point halfway from there to a corner, lies in or on another cell than its own: parts overlap, or
    touch and nothing joins them. Cells three times as long as wide may cross between these points.

    Parameters
    ----------
    kind : int
        gmsh's number of the kind of the cells.
    cells : Cells
        With cracks split.
    places : (n_nodes, d) [m]
        Of all nodes.
    lips : sequence of (n, d) int
        Corners of the facets of crack faces.
    """
    from scipy.spatial import cKDTree

    facets, owner, at = (rows[cells.is_boundary] for rows in cells.sorted_facets)
    other = ~rows_in(facets, np.concatenate([*lips, facets[:0]]))
    owner, at = owner[other], at[other]
    corners = _places_in(kind)[at]
    middle = corners.mean(axis=1, keepdims=True)
    within = np.concatenate([middle, 0.5 * (middle + corners)], axis=1)
    owner = np.repeat(owner, within.shape[1])
    shares = _functions(kind, within.reshape(-1, 3))
    points = np.einsum("in,inx->ix", shares, places[cells.nodes[owner]])

    here = places[cells.nodes]
    centres = here.mean(axis=1)
    reach = np.linalg.norm(here - centres[:, None], axis=2).max(axis=1)
    near = cKDTree(points).query_ball_point(centres, reach)
    cell = np.repeat(np.arange(len(near)), [len(own) for own in near])
    point = np.concatenate(near).astype(int)
    apart = owner[point] != cell
    cell, point = cell[apart], point[apart]
    if np.any(covered := _in_cells(kind, cells.n_corners, here[cell], points[point])):
        allowed = "one whose cells share their nodes where they touch (gmsh: BooleanFragments, or"
        allowed += " Coherence Mesh), but for the faces of named cracks"
        allowed += " ('crack', or 'lower_lip' and 'upper_lip')"
        found = "cells that overlap, or touch without a node of both,"
        raise _refusal(found, points[point[covered][0]], allowed)


def _in_cells(kind: int, n_corners: int, cells: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return True for points (n, d) in or on cells, given by their nodes (n, n_nodes, d)."""
    dimension = points.shape[1]
    linear = _functions(_LINEAR[dimension, n_corners], _places_in(kind))
    bent = cells - np.einsum("nc,icx->inx", linear, cells[:, :n_corners])
    low, high = cells.min(axis=1), cells.max(axis=1)
    size = (high - low).max(axis=1)
    # Lebesgue's constant of cells of order 2 is at most 1.63^2.
    room = (POSITION_TOLERANCE * size + 3.0 * np.abs(bent).max(axis=(1, 2)))[:, None]
    found = np.all((points > low - room) & (points < high + room), axis=1)
    if not np.any(found):
        return found
    cells, points, size = cells[found], points[found], size[found]
    at = np.tile(_places_in(kind)[:n_corners].mean(axis=0), (len(points), 1))
    going = np.arange(len(at))  # in straight cells the first step ends there
    for _ in range(8):
        off = points[going] - np.einsum("in,inx->ix", _functions(kind, at[going]), cells[going])
        far = np.abs(off).max(axis=1) > MIN_RELATIVE_DETERMINANT * size[going]
        going, off = going[far], off[far]
        if not len(going):
            break
        gradients = _functions(kind, at[going], "GradLagrange").reshape(len(going), -1, 3)
        slopes = np.einsum("inx,inr->ixr", cells[going], gradients[..., :dimension])
        at[going, :dimension] += np.einsum("irx,ix->ir", np.linalg.pinv(slopes), off)
        at[going] = np.clip(at[going], -2.0, 2.0)
    off = points - np.einsum("in,inx->ix", _functions(kind, at), cells)
    within = _functions(_LINEAR[dimension, n_corners], at).min(axis=1) >= -POSITION_TOLERANCE
    found[found] = within & (np.abs(off).max(axis=1) <= POSITION_TOLERANCE * size)
    return found


def _places_in(kind: int) -> np.ndarray:
    """Return the places of the nodes in a cell of gmsh's number of the kind: (n_nodes, 3)."""
    _, dimension, _, count, local, _ = gmsh.model.mesh.getElementProperties(kind)
    at = np.zeros((count, 3))
    at[:, :dimension] = np.reshape(local, (count, dimension))
    return at


def _functions(kind: int, at: np.ndarray, name: str = "Lagrange") -> np.ndarray:
    """Basis functions of cells, or their gradients, as gmsh names and numbers them, at places in
    cells (n, 3): (n, n_functions)."""
    return np.reshape(gmsh.model.mesh.getBasisFunctions(kind, at.ravel(), name)[1], (len(at), -1))
