"""Modes on disk, node by node, so that a file does not depend on how ranks number the dofs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fenics_crack.errors import InputError
from fenics_crack.modes import Modes
from fenics_crack.output import NodalMesh
from fenics_crack.scene import Scene
from fenics_crack.store import reading, write
from fenics_crack.structure import Structure

__all__ = ["load_modes", "save_modes"]


def save_modes(
    modes: Modes, path: str | Path, structure: Structure, scene: Scene | None = None
) -> None:
    """Write the modes of a meshed structure to an HDF5 file (collective).

    Raises
    ------
    InputError
        The structure was made from matrices and knows no nodes.
    """
    mesh = NodalMesh(structure)
    shapes = mesh.field(structure.expand(modes.shapes.T))
    parts = {"omega": modes.omega, "nodes": _marks(mesh), "shapes": shapes}
    write(path, Modes.KIND, parts, scene, structure.comm)


def load_modes(path: str | Path, structure: Structure) -> Modes:
    """Read modes written by :func:`save_modes`, of the same mesh on any number of ranks.

    Raises
    ------
    InputError
        The file is another, or its nodes are not those of the structure.
    """
    mesh, whole = NodalMesh(structure), structure.whole
    assert whole.nodes is not None
    marks = _marks(mesh)
    with reading(path, Modes.KIND) as parts:
        omega, shapes, then = parts["omega"], parts["shapes"], parts["nodes"]
        distance, place = cKDTree(then).query(marks)
        same = then.shape == marks.shape and len(set(place)) == len(place)
        if not same or distance.max() > 1e-6 * mesh.size:
            raise InputError("structure", f"{len(marks)} nodes", f"that of {path}, {len(then)}")
    first = whole.comm.exscan(len(whole.nodes.points)) or 0
    mine = shapes[:, place[first : first + len(whole.nodes.points)]]
    free = whole.nodes.dofs >= 0
    rows = np.zeros((len(omega), whole.n_local))
    rows[:, whole.nodes.dofs[free] - whole.first_dof] = mine[:, free]
    return Modes(omega, rows.T)


def _marks(mesh: NodalMesh) -> np.ndarray:
    """Where a node is, and the middle of its cells, which tells the two lips apart: (n, 4)."""
    sums, counts = np.zeros((len(mesh.points), 2)), np.zeros((len(mesh.points), 1))
    middles = mesh.points[mesh.cells].mean(axis=1)
    for nodes in mesh.cells.T:
        np.add.at(sums, nodes, middles)
        np.add.at(counts, nodes, 1.0)
    return np.hstack([mesh.points, sums / counts])
