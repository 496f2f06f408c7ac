"""The structure of a scene whose matrices are in files of other programs; and such files of any
structure, for other programs.

With the model that they are of, its nodes have places: a load acts at one of them, and where the
scene has contact and no matrix of gaps, the pairs are found: nodes in the same place that nothing
joins. Where the model has solid cells, the crack faces are those facets that belong to one cell and
lie on another one with other nodes. Pairs are then those of :mod:`fenics_crack.fem.build`,

    g_i = 1 / w_i int psi_i (n . u_lower + n . u_upper) ds,      w_i = int psi_i ds,

with psi_i linear, 1 at a corner that exists twice; facets are as flat as their corners, and either
normal points out of its own cell, so it does not matter which face is the lower one.

Without cells pairs are nodes: g = n . (u_a - u_b) for two in the same place. What the stiffness
joins to a node lies on its side of the crack; what it joins to either lies on the front. The
normal n is that of the plane through the pairs around (of a line in a plane model or a shell), and
points from the side of a to that of b.
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
from fenics_crack.basics.errors import InputError, reading
from fenics_crack.basics.ranks import on_each, on_root
from fenics_crack.fem.cracks import (
    FACETS,
    POSITION_TOLERANCE,
    distribute_front_pressures,
    find_unique_rows,
)
from fenics_crack.fem.model_files import Model, read_model
from fenics_crack.model.factor import distributed, local_rows
from fenics_crack.model.matrices import (
    LabelledMatrix,
    matrix_market,
    matrix_market_shape,
    read_matrix,
    whole_rows,
)
from fenics_crack.model.modes import check_damped_modes
from fenics_crack.model.nodes import Nodes, Pairs, place_in_words
from fenics_crack.model.structure import DampingRule, ModalDamping, RayleighDamping, Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import FORCES, Damping, Excitation
from fenics_crack.scene.tables import Structure as Table

MATRIX_LETTERS = {"mass": "M", "stiffness": "K", "damping": "B"}
"""Matrices, and the letter by which a file with several of them calls each."""
ROW_FILES = ("gap", "tangential", *FORCES)
"""Keys of files with a row for each dof."""
SCENE_FILE = "matrices.toml"
"""Scene that reads what is written."""
OUTPUT_FILES = (
    *(f"{n}.mtx" for n in (*MATRIX_LETTERS, *ROW_FILES, "clearance", "areas")),
    SCENE_FILE,
)
"""Files that are written, as far as a structure has them."""
MAX_DENSE_DOFS = 3000
"""Maximum dofs of a matrix of modal damping, which is dense: 4.5 million numbers."""


def read_structure(scene: Scene, rule: DampingRule | None, comm: MPI.Comm) -> Structure:
    """Make the structure of a scene's table ``[structure]`` (collective).

    Every rank reads the files and keeps its rows. ``rule``: the damping, unless it is a file.

    Raises
    ------
    InputError
        A file cannot be read, a shape does not fit, an entry is not finite, a matrix is not
        symmetric, or the mass is not positive definite; no pairs are found.
    """
    table = scene.given("structure")
    try:
        return _made(scene, table, rule, comm)
    except InputError as error:
        if error.key not in table.keys():
            raise
        path, found = getattr(table, error.key), error.value
        value = path if found == path else f"{path} ({found})"
        raise InputError(table.name_of(error.key), value, error.allowed) from None


def _made(scene: Scene, table: Table, rule: DampingRule | None, comm: MPI.Comm) -> Structure:
    read, columns, model = on_each(comm, lambda: _read(table))
    stiffness = read["stiffness"].matrix
    parts: dict[str, Any] = {"gap": None, "damping": rule}
    parts |= {name: one.matrix for name, one in read.items()}
    rows, order = stiffness.shape[0], np.arange(stiffness.shape[0])
    pairs, nodes, labels = Pairs(), None, read["stiffness"].labels
    if model is not None:
        if labels is None:
            allowed = "given with structure.model: the file of each row's node and direction"
            raise InputError("structure.dofs", None, allowed)
        order, dofs, bounds = _by_nodes(model, labels, table)
        for name in read:
            parts[name] = parts[name][order][:, order]
        if scene.contact is not None and table.gap is None:
            turns = bool(np.any(labels[:, 1] > 3))
            parts["gap"], pairs = find_pairs(model, dofs, parts["stiffness"], turns=turns)
        start, stop = _own(bounds, comm)
        for name in read:
            parts[name] = distributed(parts[name][start:stop], comm)
        nodes = _nodes(model, dofs, start, stop, comm)
    parts |= {name: column[order] for name, column in columns.items()}
    n_pairs = 0 if parts["gap"] is None else parts["gap"].shape[1]
    parts["clearance"] = _per_pair("clearance", table.clearance, n_pairs)
    if table.areas is not None:
        pairs = replace(pairs, areas=_per_pair("areas", table.areas, n_pairs))
    if scene.excitation.point is not None:
        assert nodes is not None
        _, at = nodes.nearest(comm, "excitation.point", scene.excitation.point)
        for name in FORCES:
            force = sparse.lil_matrix(parts.get(name, (rows, 1)))
            for dof, value in zip(at, getattr(scene.excitation, name), strict=True):
                if dof >= 0:
                    force[dof, 0] += value
            parts[name] = force
    if scene.highest_order > 1:
        excitation = scene.excitation
        allowed = "left out with [structure], whose files have a column for each order"
        excitation.require(False, (excitation.wave and "wave") or "harmonics", allowed)
    return Structure.from_matrices(**parts, comm=comm).placed(nodes, pairs)


def _read(table: Table) -> tuple[dict[str, LabelledMatrix], dict[str, Any], Model | None]:
    """The matrices of a table, with the rows of its stiffness, the columns with a row for each dof,
    and the model, if there is one."""
    labels, found = None if table.dofs is None else Path(table.dofs), {}
    rows, model = None, None
    for name, letter in MATRIX_LETTERS.items():
        if (path := getattr(table, name)) is not None:
            with reading(name, path, "a matrix of Matrix Market, CalculiX, Abaqus or Nastran"):
                found[name] = read_matrix(Path(path), letter, labels, rows)
            rows = found[name].matrix.shape[0]
    stiffness = found["stiffness"]
    for name, one in found.items() if stiffness.labels is not None else ():
        with reading(name, getattr(table, name), "one of the dofs of the stiffness"):
            found[name] = LabelledMatrix(one.at(stiffness), stiffness.labels)
    if len(empty := np.flatnonzero(found["mass"].matrix.diagonal() <= 0.0)):
        where = f"row {empty[0] + 1}"
        if stiffness.labels is not None and empty[0] < len(stiffness.labels):
            where = "node {}, direction {}".format(*stiffness.labels[empty[0]])
        allowed = "positive definite: rows without mass have to be condensed beforehand"
        raise InputError("mass", f"no mass at {where}", allowed)
    if table.model is not None:
        with reading("model", table.model, "the input file of the matrices' program"):
            model = read_model(Path(table.model))
    given = {name: path for name in ROW_FILES if (path := getattr(table, name)) is not None}
    rows = stiffness.matrix.shape[0]
    return found, {name: whole_rows(name, Path(path), rows) for name, path in given.items()}, model


def _by_nodes(
    model: Model, labels: np.ndarray, table: Table
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows in such an order that those of a node follow each other; then those of each node along
    x, y and z, (n_nodes, 3); and where each node begins, and the last one ends."""
    _, first, node = np.unique(labels[:, 0], return_index=True, return_inverse=True)
    order = np.argsort(first[node], kind="stable")
    labels = labels[order]
    dofs = np.full((len(model.labels), 3), -1)
    at = np.minimum(np.searchsorted(model.labels, labels[:, 0]), len(model.labels) - 1)
    known = model.labels[at] == labels[:, 0]
    moves = known & (labels[:, 1] >= 1) & (labels[:, 1] <= 3)
    missing = labels[~known & (labels[:, 1] >= 1), 0]  # 0: no node, but a coordinate
    if len(missing) or not np.any(moves):
        found = f"no node {missing[0]}" if len(missing) else "no node that moves"
        allowed = f"the model of {table.stiffness}, with all the nodes of its rows"
        raise InputError("model", found, allowed)
    dofs[at[moves], labels[moves, 1] - 1] = np.flatnonzero(moves)
    begins = np.flatnonzero(np.append(True, np.diff(labels[:, 0]) != 0))
    return order, dofs, np.append(begins, len(labels))


def _own(bounds: np.ndarray, comm: MPI.Comm) -> tuple[int, int]:
    """First and last row of this rank: whole nodes, about as many rows on each."""
    wanted = bounds[-1] * np.array([comm.rank, comm.rank + 1]) // comm.size
    start, stop = bounds[np.searchsorted(bounds, wanted)]
    return int(start), int(stop)


def _nodes(model: Model, dofs: np.ndarray, start: int, stop: int, comm: MPI.Comm) -> Nodes:
    """The nodes of this rank: those with its dofs, and on the first one those that are held; with
    cells where these are of one kind that can be drawn, and nodes carry all dofs."""
    every_dof = int(np.count_nonzero(dofs >= 0)) == comm.allreduce(stop - start)
    kind = next(iter(model.cells)) if len(model.cells) == 1 and every_dof else 0
    kind = 0 if kind in (13, 26) else kind  # VTK's wedges are not drawn
    cells = model.cells[kind] if kind else np.zeros((0, 1), dtype=int)
    highest = dofs.max(axis=1)
    used = highest >= 0
    used[cells] = True
    owner = np.array(comm.allgather(stop)).searchsorted(highest, side="right")
    every = np.lexsort((np.arange(len(dofs)), np.where(highest < 0, 0, owner)))
    every = every[used[every]]
    number = np.empty(len(dofs), dtype=int)
    number[every] = np.arange(len(every))
    own = every[np.where(highest[every] < 0, 0, owner[every]) == comm.rank]
    mine = number[cells] if comm.rank == 0 else np.zeros((0, cells.shape[1]), dtype=int)
    return Nodes(model.points[own], dofs[own], mine, kind)


def _per_pair(name: str, given: float | str, pairs: int) -> Any:
    """Return one number for all pairs, or read from a file one for each."""
    if not isinstance(given, str):
        return given
    return whole_rows(name, Path(given), pairs).toarray().ravel() if pairs else 0.0


def count_pairs(table: Table) -> int:
    """Number of contact pairs of a scene's table ``[structure]``, at most; 0 if its files are
    unusable."""
    path = table.gap or table.model
    if path is None:
        return 0
    try:
        with reading("structure.gap", path, "a file that can be read"):
            if table.gap is not None:
                return matrix_market_shape(Path(table.gap))[1]
            return len(find_coincident_nodes(read_model(Path(path)).points))
    except InputError:  # who reads it will say why
        return 0


# --- files for other programs ---------------------------------------------------------------------


def write_matrices(structure: Structure, folder: str | Path, scene: Scene | None = None) -> None:
    """Write the matrices of a structure as Matrix Market files, with a scene that reads them
    (collective).

    Files are named as the keys of the table ``[structure]``: ``mass.mtx``. What a structure does
    not have is no file: pairs, tangential gaps, areas. Of one that rotates the stiffness and the
    mean load are those at its speed. Modal damping becomes a matrix for other programs up to
    3,000 dofs; the scene has its ratios and the number of damped modes.

    Parameters
    ----------
    structure : Structure
        Not reduced; its rows may be shared by ranks.
    folder : path
        Earlier files of these names are replaced, and kept in its folder ``before``.
    scene : Scene, optional
        Its frequency, contact, harmonic balance and reduction complete ``matrices.toml``; without
        it ``[excitation]`` and ``[contact]`` have to be added.

    Raises
    ------
    InputError
        The structure is reduced, the scene does not fit it, or a file cannot be written.

    Examples
    --------
    >>> fc.write_matrices(structure, "matrices", scene)
    """
    if structure.whole is not structure:
        allowed = "one that is not reduced: fc.build_structure(scene), or structure.whole"
        raise InputError("structure", repr(structure), allowed)
    comm, force, damping = structure.comm, structure.force, structure.damping_matrix
    rows: dict[str, Any] = {
        "mass": local_rows(structure.mass),
        "stiffness": local_rows(structure.stiffness),
        "damping": None if damping is None else local_rows(damping),
        **dict(zip(FORCES, (force[:1].T, force[1::2].T, force[2::2].T), strict=True)),
    }
    if structure.n_pairs:
        own = slice(None if comm.rank == 0 else 0)  # every rank has all pairs
        rows |= {"gap": structure.gap, "tangential": structure.tangential}
        rows["clearance"] = structure.clearance[own, None]
        areas = structure.pair_areas
        rows["areas"] = None if areas is None else areas[own, None]
    given = {name: sparse.csr_matrix(part) for name, part in rows.items() if part is not None}
    parts = {name: comm.gather(part) for name, part in given.items()}
    text = _scene_of_files(structure, {name: f"{name}.mtx" for name in parts}, scene)

    def work() -> None:
        whole = {name: sparse.vstack(part) for name, part in parts.items()}
        if isinstance(structure.damping, ModalDamping) and structure.n_dofs <= MAX_DENSE_DOFS:
            squares, shapes = eigh(whole["stiffness"].toarray(), whole["mass"].toarray())
            count = check_damped_modes(structure)
            rate = structure.damping.rate(squares[:count])
            damped = whole["mass"] @ shapes[:, :count] * np.sqrt(rate)
            whole["damping"] = sparse.csr_matrix(damped @ damped.T)
        texts = {f"{name}.mtx": matrix_market(matrix) for name, matrix in whole.items()}
        replace_files(OUTPUT_FILES, Path(folder), texts | {SCENE_FILE: text})

    on_root(comm, work)


def _scene_of_files(structure: Structure, files: dict[str, str], scene: Scene | None) -> str:
    """The text of a scene that reads files and is solved as another one; without one it lacks
    [excitation] and [contact]."""
    tables: dict[str, Any] = {}
    rule = structure.damping or RayleighDamping()
    if isinstance(rule, DampingRule):
        tables["damping"] = Damping(**{k: v for k, v in vars(rule).items() if v is not None})
        files = {name: file for name, file in files.items() if name != "damping"}
    tables["structure"] = Table(**files)
    if scene is None:
        return "\n".join(table.as_toml() for table in tables.values())
    contact = scene.contact and replace(scene.contact, pairs="all")
    key = "omega" if scene.excitation.frequency is None else "frequency"
    return Scene(
        **tables,
        excitation=Excitation(**{key: getattr(scene.excitation, key)}),
        contact=contact if structure.n_pairs else None,
        harmonic_balance=replace(scene.harmonic_balance),  # what is derived, too
        reduction=scene.reduction,
    ).as_toml()


# --- contact pairs of a model ---------------------------------------------------------------------

FACETS_BY_SHAPE = {
    4: [FACETS[4]], 8: [FACETS[8]],
    6: [np.array([[0, 1, 2], [3, 4, 5]]), np.array([[0, 1, 4, 3], [1, 2, 5, 4], [2, 0, 3, 5]])],
}  # fmt: skip
"""Facets of a cell by the number of its corners, triangles and quadrilaterals apart."""
N_CORNERS = {10: 4, 24: 4, 13: 6, 26: 6, 12: 8, 25: 8}
"""Number of corners of a cell, by VTK's number of its kind."""
EDGES = {
    4: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    6: [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    8: [*((i, (i + 1) % 4) for i in range(4)), *((4 + i, 4 + (i + 1) % 4) for i in range(4)),
        *((i, 4 + i) for i in range(4))],
}  # fmt: skip
"""Edges between the corners of a cell, in the order of the nodes in their middles (VTK's)."""


def find_coincident_nodes(points: np.ndarray) -> np.ndarray:
    """Nodes in the same place, two by two: (n, 2)."""
    from scipy.spatial import cKDTree  # takes a while, for models from elsewhere alone

    near = POSITION_TOLERANCE * float(np.ptp(points, axis=0).max())
    found = cKDTree(points).query_pairs(near, output_type="ndarray")
    return np.asarray(found[np.lexsort(found.T[::-1])])


class _Lips:
    """Nodes of a model that exist twice and are not joined, and what surrounds them.

    ``points`` (n, 3) of all nodes, and their ``dofs`` (n, 3), of so many ``rows``; ``first`` and
    ``second``: the two nodes of each pair; ``split``: the pair of each node, -1 where it has none;
    ``place``: a number for each place; ``joined``: which nodes the stiffness joins; ``torn``: nodes
    of a place where one of two has no dofs, held or tied by equations.
    """

    def __init__(self, model: Model, dofs: np.ndarray, stiffness: sparse.csr_matrix) -> None:
        n, pairs = len(dofs), find_coincident_nodes(model.points)
        self.points, self.dofs, self.rows = model.points, dofs, stiffness.shape[0]
        node = np.full(self.rows, n)
        node[dofs[dofs >= 0]] = np.nonzero(dofs >= 0)[0]
        entries = stiffness.tocoo()
        at = node[entries.row].astype(np.int64), node[entries.col]
        links = np.ones(len(entries.data), bool), at
        self.joined = sparse.csr_matrix(links, (n + 1, n + 1))[:n, :n]
        free = np.any(dofs >= 0, axis=1)
        both = free[pairs].all(axis=1) & ~np.isin(n * pairs[:, 0] + pairs[:, 1], n * at[0] + at[1])
        self.place = np.arange(n)
        self.place[pairs[:, 1]] = pairs[:, 0]
        self.torn = np.zeros(n, dtype=bool)
        self.torn[pairs[free[pairs[:, 0]] != free[pairs[:, 1]]]] = True
        self.first, self.second = pairs[both].T
        nodes, uses = np.unique(np.append(self.first, self.second), return_counts=True)
        if np.any(uses > 1):
            most = nodes[np.argmax(uses)]
            where = f"{place_in_words(model.points[most], 'g')}, one of them {model.labels[most]}"
            allowed = "one with two nodes at each place of a crack: cracks neither branch nor cross"
            raise InputError("model", f"more than two nodes at {where}", allowed)
        if not len(self.first):
            found = f"{len(pairs)} nodes in the same place as another, all of them joined or held"
            raise InputError("model", found, "one with two nodes at each place of a crack's faces")
        self.split = np.full(n, -1)
        self.split[self.first] = self.split[self.second] = np.arange(len(self.first))


def find_pairs(
    model: Model, dofs: np.ndarray, stiffness: sparse.csr_matrix, *, turns: bool
) -> tuple[sparse.csr_matrix, Pairs]:
    """Pairs of a model, crack by crack, from the front to the mouth: B and where they are.

    Parameters
    ----------
    model : Model
        With (n,) nodes.
    dofs : (n, 3) int
        Rows of the stiffness along x, y, z; -1 where there is none.
    stiffness : (n_dofs, n_dofs)
        Says which nodes are joined.
    turns : bool
        True if nodes turn, as those of shells, whose cracks are lines.

    Raises
    ------
    InputError
        There are no two nodes in the same place, or three; or they do not tell a crack's sides.
    """
    lips = _Lips(model, dofs, stiffness)
    facets = _lip_facets(model, lips)
    if facets:
        gap, areas, chosen, fronts = _of_patches(lips, facets)
    else:
        flat = not turns and np.all(np.any(dofs >= 0, axis=0))
        gap, fronts = _of_nodes(lips, 2 if flat else 1)
        areas, chosen = None, np.arange(len(lips.first))
    points = model.points[lips.first[chosen]]
    cracks = _cracks(lips, chosen)
    positions = np.zeros(len(chosen))
    if len(fronts):
        from scipy.spatial import cKDTree

        positions = cKDTree(model.points[fronts]).query(points)[0]
    order = np.lexsort((positions, cracks))
    cracks, positions = cracks[order], positions[order]
    last = np.flatnonzero(np.append(np.diff(cracks), 1))
    names = [f"the mouth of crack {n + 1}" if len(last) > 1 else "the mouth" for n in cracks[last]]
    pairs = Pairs(
        points[order], None if areas is None else areas[order], cracks, positions,
        dict(zip(names, last.tolist(), strict=True)),
    )  # fmt: skip
    return gap[:, order], pairs


def _cracks(lips: _Lips, chosen: np.ndarray) -> np.ndarray:
    """The crack of each pair, from bottom to top: pairs whose nodes are joined are of one."""
    from scipy.sparse.csgraph import connected_components

    one, other = lips.first[chosen], lips.second[chosen]  # either may be the lower one
    straight = lips.joined[one][:, one].multiply(lips.joined[other][:, other])
    links = straight + lips.joined[one][:, other].multiply(lips.joined[other][:, one])
    count, found = connected_components(links)
    centres = [lips.points[one[found == crack]].mean(axis=0)[[1, 0, 2]] for crack in range(count)]
    rank = np.empty(count, dtype=int)
    rank[sorted(range(count), key=lambda crack: tuple(centres[crack]))] = np.arange(count)
    return np.asarray(rank[found])


# --- of facets ------------------------------------------------------------------------------------

Facets = tuple[np.ndarray, np.ndarray]
"""Nodes of facets, corners and then those in the middle of edges (-1: none), (m, 2 k); and the
middles of their cells, (m, 3)."""


def _lip_facets(model: Model, lips: _Lips) -> list[Facets]:
    """Facets of one cell alone that lie on another one, triangles and quadrilaterals apart."""
    facets = []
    for corners in (3, 4):
        parts = [
            _facets(model.points, cells, N_CORNERS[kind], own)
            for kind, cells in model.cells.items()
            for own in FACETS_BY_SHAPE[N_CORNERS[kind]]
            if own.shape[1] == corners
        ]
        if not parts:
            continue
        nodes, middles = (np.concatenate(both) for both in zip(*parts, strict=True))
        alone = _uses(nodes[:, :corners]) == 1
        twice = alone.copy()
        twice[alone] = _uses(lips.place[nodes[alone, :corners]]) == 2
        twice &= np.any(lips.split[nodes[:, :corners]] >= 0, axis=1)
        twice &= ~np.any(lips.torn[nodes] & (nodes >= 0), axis=1)
        if np.any(twice):
            facets.append((nodes[twice], middles[twice]))
    return facets


def _facets(points: np.ndarray, cells: np.ndarray, corners: int, facets: np.ndarray) -> Facets:
    """Return the facets of all cells of a kind."""
    k = facets.shape[1]
    middle = {frozenset(edge): corners + i for i, edge in enumerate(EDGES[corners])}
    ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2)
    own = np.array([[middle[frozenset(edge)] for edge in facet] for facet in ends.tolist()])
    nodes = np.full((len(cells), len(facets), 2 * k), -1)
    nodes[..., :k] = cells[:, facets]
    if cells.shape[1] > corners:
        nodes[..., k:] = cells[:, own]
    centres = np.repeat(points[cells[:, :corners]].mean(axis=1), len(facets), axis=0)
    return nodes.reshape(-1, 2 * k), centres


def _uses(rows: np.ndarray) -> np.ndarray:
    """Count each row, in any order, among all rows."""
    _, which, uses = find_unique_rows(rows)
    return np.asarray(uses[which])


def _facet_basis(corners: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At points of a facet, with their weights: the linear basis, that of the nodes in the middle
    of its edges, and the derivatives of the former; by Gauss' rule, exact for degree 5."""
    at, weights = (0.5 * x for x in np.polynomial.legendre.leggauss(3))
    r, s = (x.ravel() for x in np.meshgrid(at + 0.5, at + 0.5))
    share = np.outer(weights, weights).ravel()
    if corners == 3:
        s, share = s * (1.0 - r), share * (1.0 - r)
        linear = np.array([1.0 - r - s, r, s])
        slopes = np.broadcast_to([[[-1.0], [1.0], [0.0]], [[-1.0], [0.0], [1.0]]], (2, 3, len(r)))
        between = 4.0 * linear * np.roll(linear, -1, axis=0)
    else:
        linear = np.array([(1 - r) * (1 - s), r * (1 - s), r * s, (1 - r) * s])
        slopes = np.array([[s - 1, 1 - s, s, -s], [r - 1, -r, r, 1 - r]])
        ends = linear, np.roll(linear, -1, axis=0)
        between = 4.0 * ends[0] * ends[1] / (ends[0] + ends[1])
    return share * np.stack([linear, between]), linear, slopes


def _of_patches(
    lips: _Lips, facets: list[Facets]
) -> tuple[sparse.csr_matrix, np.ndarray, np.ndarray, np.ndarray]:
    """B, the areas, the pairs of nodes at which patches are, and the nodes of the fronts."""
    n_pairs, corners = len(lips.first), [nodes[:, : nodes.shape[1] // 2] for nodes, _ in facets]
    there = np.unique(np.concatenate([nodes.ravel() for nodes in corners]))
    fronts, split = there[lips.split[there] < 0], lips.split.copy()
    split[fronts] = n_pairs + np.arange(len(fronts))  # whose patches go to their neighbours
    entries: list[tuple[np.ndarray, ...]] = []
    overlaps: list[tuple[np.ndarray, ...]] = []
    areas = np.zeros(n_pairs + len(fronts))
    for nodes, middles in facets:
        k = nodes.shape[1] // 2
        (linear, between), psi, slopes = _facet_basis(k)
        here = lips.points[nodes[:, :k]]
        one, two = np.einsum("akq,fkx->afqx", slopes, here)
        normal = np.cross(one, two)
        inwards = np.einsum("fqx,fx->f", normal, here.mean(axis=1) - middles) < 0.0
        normal[inwards] *= -1.0
        size = np.linalg.norm(normal, axis=2)
        pair = split[nodes[:, :k]]
        np.add.at(areas, pair, 0.5 * np.einsum("kq,fq->fk", linear, size))
        values = np.einsum("iq,jq,fq->fij", psi, linear, size)
        both = np.broadcast_arrays(pair[:, :, None], pair[:, None])
        overlaps.append((values.ravel(), both[0].ravel(), both[1].ravel()))
        # Quadratic: the linear function less half of those in the middle of its two edges.
        halves = 0.5 * (between + np.roll(between, 1, axis=0))
        quadratic = np.all(nodes[:, k:] >= 0, axis=1)[:, None, None]
        moved = np.einsum("iq,jq,fqx->fijx", psi, linear, normal)
        moved -= np.einsum("iq,jq,fqx->fijx", psi, halves, normal) * quadratic[..., None]
        edges = np.einsum("iq,jq,fqx->fijx", psi, between, normal) * quadratic[..., None]
        values = np.concatenate([moved, edges], axis=2)  # (facet, pressure, node, axis)
        rows = np.broadcast_to(lips.dofs[nodes][:, None], values.shape)
        columns = np.broadcast_to(pair[:, :, None, None], values.shape)
        kept = (rows >= 0) & (values != 0.0)
        entries.append((values[kept], rows[kept], columns[kept]))
    values, rows, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
    made = sparse.csr_matrix((values, (rows, columns)), (lips.rows, len(areas)))
    values, rows, columns = (np.concatenate(part) for part in zip(*overlaps, strict=True))
    every = sparse.csr_matrix((values, (rows, columns)), (len(areas), len(areas)))
    shares = distribute_front_pressures(every[n_pairs:, :n_pairs])
    areas = shares.T @ areas
    chosen = np.flatnonzero(areas)
    made = (made @ shares)[:, chosen] @ sparse.diags(1.0 / areas[chosen])
    return made.tocsr(), areas[chosen], chosen, fronts


# --- of nodes -------------------------------------------------------------------------------------


def _of_nodes(lips: _Lips, tangents: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """B, and the nodes of the fronts; the crack faces have so many directions along them."""
    points, gap = lips.points, sparse.lil_matrix((lips.rows, len(lips.first)))
    fronts: list[np.ndarray] = []
    size = float(np.ptp(points, axis=0).max())
    for column, (a, b) in enumerate(zip(lips.first, lips.second, strict=True)):
        beside = [lips.joined[node].indices for node in (a, b)]
        fronts.append(np.intersect1d(*beside))
        around = np.unique(np.concatenate(beside))
        around = np.append(around[lips.split[around] >= 0], fronts[-1])
        if len(np.unique(lips.place[around])) <= tangents:
            around = lips.first
        spread = points[around] - points[around].mean(axis=0)
        along = np.linalg.svd(spread, full_matrices=False)[2][:tangents]
        up = points[beside[1]].mean(axis=0) - points[beside[0]].mean(axis=0)
        up -= along.T @ (along @ up)
        if np.linalg.norm(up) <= POSITION_TOLERANCE * size:
            where = place_in_words(points[a], "g")
            allowed = "a crack with a side below and one above, or a model with its elements"
            raise InputError("model", f"two nodes at {where} that lie on the same side", allowed)
        up /= np.linalg.norm(up)
        for node, sign in ((a, 1.0), (b, -1.0)):
            for dof, value in zip(lips.dofs[node], sign * up, strict=True):
                if dof >= 0 and abs(value) > POSITION_TOLERANCE:
                    gap[dof, column] = value
    return gap.tocsr(), np.unique(np.concatenate(fronts))
