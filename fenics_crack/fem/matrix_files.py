"""The structure of a scene whose matrices are in files of other programs.

With the model that they are of, its nodes have places: a load acts at one of them, and where the
scene has contact and no matrix of gaps, the pairs are found (:mod:`fenics_crack.fem.found_pairs`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.errors import InputError, reading
from fenics_crack.exchange.matrices import LabelledMatrix, matrix_market_shape, read_matrix
from fenics_crack.exchange.models import Model, read_model
from fenics_crack.fem.found_pairs import coincident, find_pairs
from fenics_crack.model.damping import DampingRule
from fenics_crack.model.factor import distributed
from fenics_crack.model.matrices import whole_rows
from fenics_crack.model.nodes import Nodes, Pairs
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Structure as Table

__all__ = ["count_pairs", "read_structure"]

MATRICES = {"mass": "M", "stiffness": "K", "damping": "B"}
"""And the letter by which a file with several of them calls each."""
WEDGES = (13, 26)
"""Cells that are not drawn, by VTK's number."""
COLUMNS = ("gap", "force_sin", "force_cos", "force_mean")
"""Keys of files with a row for each dof."""


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
    read = _read(table)
    stiffness = read["stiffness"].matrix
    parts: dict[str, Any] = {"gap": None, "damping": rule}
    parts |= {name: one.matrix for name, one in read.items()}
    rows, order = stiffness.shape[0], np.arange(stiffness.shape[0])
    model, dofs, bounds = None, np.zeros((0, 3), dtype=int), None
    if table.model is not None:
        with reading("model", table.model, "the input file of the matrices' program"):
            model = read_model(Path(table.model))
        order, dofs, bounds = _by_nodes(model, read["stiffness"].labels, table)
    for name in COLUMNS:
        if (path := getattr(table, name)) is not None:
            parts[name] = whole_rows(name, Path(path), rows)[order]
    pairs, nodes = Pairs(), None
    if model is not None:
        assert bounds is not None and read["stiffness"].labels is not None
        for name in read:
            parts[name] = parts[name][order][:, order]
        if scene.contact is not None and table.gap is None:
            turns = bool(np.any(read["stiffness"].labels[:, 1] > 3))
            parts["gap"], pairs = find_pairs(model, dofs, parts["stiffness"], turns=turns)
        start, stop = _own(bounds, comm)
        for name in read:
            parts[name] = distributed(parts[name][start:stop], comm)
        nodes = _nodes(model, dofs, start, stop, comm)
    parts["clearance"] = _clearance(table, 0 if parts["gap"] is None else parts["gap"].shape[1])
    if scene.excitation.point is not None:
        assert nodes is not None
        _, at = nodes.nearest(comm, "excitation.point", scene.excitation.point)
        for name in COLUMNS[1:]:
            force = sparse.lil_matrix(parts.get(name, (rows, 1)))
            for dof, value in zip(at, getattr(scene.excitation, name), strict=True):
                if dof >= 0:
                    force[dof, 0] += value
            parts[name] = force
    made = Structure.from_matrices(**parts, comm=comm)
    return made if nodes is None else made.placed(nodes, pairs)


def _read(table: Table) -> dict[str, LabelledMatrix]:
    """The matrices of a table, with the rows of its stiffness."""
    labels, found = None if table.dofs is None else Path(table.dofs), {}
    rows: int | None = None
    for name, letter in MATRICES.items():
        if (path := getattr(table, name)) is not None:
            with reading(name, path, "a matrix of Matrix Market, CalculiX, Abaqus or Nastran"):
                found[name] = read_matrix(Path(path), letter, labels, rows)
            rows = found[name].matrix.shape[0]
    if (every := found["stiffness"].labels) is not None:
        for name, one in found.items():
            with reading(name, getattr(table, name), "one of the dofs of the stiffness"):
                found[name] = LabelledMatrix(one.at(every), every)
    return found


def _by_nodes(
    model: Model, labels: np.ndarray | None, table: Table
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows in such an order that those of a node follow each other; then those of each node along
    x, y and z, (n_nodes, 3); and where each node begins, and the last one ends."""
    if labels is None:
        allowed = "given with structure.model: the file of each row's node and direction"
        raise InputError("structure.dofs", None, allowed)
    _, first, node = np.unique(labels[:, 0], return_index=True, return_inverse=True)
    order = np.argsort(first[node], kind="stable")
    labels = labels[order]
    dofs = np.full((len(model.labels), 3), -1)
    at = np.minimum(np.searchsorted(model.labels, labels[:, 0]), len(model.labels) - 1)
    moves = (model.labels[at] == labels[:, 0]) & (labels[:, 1] >= 1) & (labels[:, 1] <= 3)
    dofs[at[moves], labels[moves, 1] - 1] = np.flatnonzero(moves)
    if not np.any(moves):
        allowed = f"the model of {table.stiffness}, whose rows are of none of its nodes"
        raise InputError("model", table.model, allowed)
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
    kind = 0 if kind in WEDGES else kind
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


def _clearance(table: Table, pairs: int) -> Any:
    """Of all pairs, or read: of each."""
    if not isinstance(table.clearance, str) or not pairs:
        return 0.0 if isinstance(table.clearance, str) else table.clearance
    return whole_rows("clearance", Path(table.clearance), pairs).toarray().ravel()


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
            return len(coincident(read_model(Path(path)).points))
    except InputError:  # who reads it will say why
        return 0
