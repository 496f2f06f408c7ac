"""What the clamp of a mesh holds, from the matrices and loads of all of its dofs."""

from __future__ import annotations

from typing import Any

import numpy as np

from fenics_crack.fem.loads import inertia
from fenics_crack.fem.numbering import Dofs
from fenics_crack.model.clamp import Clamp
from fenics_crack.parallel import gather_rows

__all__ = ["clamp_of"]


def clamp_of(dofs: Dofs, mass: Any, force: np.ndarray) -> Clamp:
    """The clamp of a mesh, from the mass matrix and the load (3, n_dofs) with the clamped rows
    (collective)."""
    nodes = dofs.nodes_on("clamp")
    held = gather_rows(dofs.comm, dofs.points[nodes[nodes < dofs.n_nodes]])
    center = np.round(0.5 * (held.min(axis=0) + held.max(axis=0)), 12) + 0.0
    rigid = _rigid_motions(dofs.points - center)
    rows = np.array([inertia(mass, motion)[dofs.free] for motion in rigid])
    return Clamp(center, rows, dofs.comm.allreduce(force @ rigid.T))


def _rigid_motions(points: np.ndarray) -> np.ndarray:
    """Translations, and rotations about the origin by e x r, of points (n, d): (n_rigid, n d)."""
    dimension = points.shape[1]
    placed = np.zeros((len(points), 3))
    placed[:, :dimension] = points
    axes = np.eye(3)[2:] if dimension == 2 else np.eye(3)
    moved = [np.tile(axis, (len(points), 1)) for axis in np.eye(dimension)]
    moved += [np.cross(axis, placed)[:, :dimension] for axis in axes]
    return np.array([motion.ravel() for motion in moved])
