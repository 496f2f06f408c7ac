"""Modes on disk, node by node: independent of how the ranks number the dofs."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fenics_crack.errors import InputError
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.files.store import check_shapes
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import gather_rows

__all__ = ["pack_modes", "unpack_modes"]


def pack_modes(modes: Modes) -> dict[str, Any]:
    """Datasets of the modes; those of a structure without a mesh by its dofs (collective)."""
    whole = modes.structure.whole
    if whole.nodes is None:
        by_dof = gather_rows(whole.comm, modes.structure.expand(modes.shapes.T).T)
        return {"omega": modes.omega, "shapes": by_dof.T}
    mesh = NodalMesh(modes.structure)
    shapes = mesh.field(modes.structure.expand(modes.shapes.T))
    return {"omega": modes.omega, "nodes": _marks(mesh), "shapes": shapes}


def unpack_modes(parts: dict[str, Any], structure: Structure, contact: object = None) -> Modes:
    """Modes from these datasets, on any number of ranks (collective).

    Raises
    ------
    InputError
        The structure has other nodes, or another number of dofs.
    """
    check_shapes(parts, {"omega": (len(parts["shapes"]),)})
    if structure.whole.nodes is None:
        return _of_dofs(parts, structure.whole)
    mesh, whole = NodalMesh(structure), structure.whole
    assert whole.nodes is not None
    marks = _marks(mesh)
    omega, shapes, then = parts["omega"], parts["shapes"], parts["nodes"]
    check_shapes(parts, {"shapes": (len(omega), len(then), 2), "nodes": (-1, 4)})
    distance, place = cKDTree(then).query(marks)
    same = len(then) == len(marks) and len(set(place)) == len(place)
    if not same or distance.max() > 1e-6 * mesh.size:
        raise InputError("structure", f"{len(marks)} nodes", f"that of the file, {len(then)}")
    first = whole.comm.exscan(len(whole.nodes.points)) or 0
    mine = shapes[:, place[first : first + len(whole.nodes.points)]]
    free = whole.nodes.dofs >= 0
    rows = np.zeros((len(omega), whole.n_local))
    rows[:, whole.nodes.dofs[free] - whole.first_dof] = mine[:, free]
    return Modes(omega, rows.T, whole)


def _of_dofs(parts: dict[str, Any], whole: Structure) -> Modes:
    """Modes of a structure without a mesh."""
    shapes = parts["shapes"]
    if "nodes" in parts or shapes.ndim != 2 or shapes.shape[1] != whole.n_dofs:
        raise InputError("structure", f"{whole.n_dofs} dofs", f"that of the file, {shapes.shape}")
    own = slice(whole.first_dof, whole.first_dof + whole.n_local)
    return Modes(parts["omega"], shapes[:, own].T, whole)


def _marks(mesh: NodalMesh) -> np.ndarray:
    """Position of each node and mean midpoint of its cells, which tells the lips apart: (n, 4)."""
    sums, counts = np.zeros((len(mesh.points), 2)), np.zeros((len(mesh.points), 1))
    middles = mesh.points[mesh.cells].mean(axis=1)
    for nodes in mesh.cells.T:
        np.add.at(sums, nodes, middles)
        np.add.at(counts, nodes, 1.0)
    return np.hstack([mesh.points, sums / counts])
