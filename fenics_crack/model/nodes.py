"""Where the dofs of a meshed structure are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.model.matrices import numbers, read_only
from fenics_crack.parallel import gather_rows

__all__ = ["Nodes"]

COMPONENTS: dict[int | str, int] = {0: 0, 1: 1, "x": 0, "y": 1}


@dataclass(frozen=True, eq=False)
class Nodes:
    """Positions of the nodes that this rank owns, and their dofs; the arrays are read-only.

    Attributes
    ----------
    points : (m, 2) [m]
        Positions.
    dofs : (m, 2) int
        Number of the x and the y displacement in the structure; -1 where it is clamped.
    cells : (n_cells, k) int
        This rank's cells in VTK's node order; nodes are numbered through all ranks.
    vtk_type : int
        VTK's number of the cell type.
    """

    points: np.ndarray
    dofs: np.ndarray
    cells: np.ndarray
    vtk_type: int

    def __post_init__(self) -> None:
        for name in ("points", "dofs", "cells"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def find_dof(self, comm: MPI.Comm, point: Sequence[float], component: int | str) -> int:
        """As :meth:`Structure.find_dof` (collective)."""
        if component not in list(COMPONENTS):
            raise InputError("component", component, "0, 1, 'x' or 'y'")
        target = numbers(point)
        if target.shape != (2,) or not np.all(np.isfinite(target)):
            raise InputError("point", point, "[x, y], two finite numbers")
        points = gather_rows(comm, self.points)
        distance = np.linalg.norm(points - target, axis=1)
        found = np.flatnonzero(distance <= 1e-6 * np.ptp(points, axis=0).max())
        if len(found) != 1:
            x, y = points[np.argmin(distance)]
            nodes = f"{len(found)} found there; the nearest node is at ({x:g}, {y:g})"
            raise InputError("point", tuple(target), f"at a node that exists once ({nodes})")
        dof = int(gather_rows(comm, self.dofs)[found[0], COMPONENTS[component]])
        if dof < 0:
            allowed = f"free in component {component!r}, not clamped"
            raise InputError("point", tuple(target), allowed)
        return dof

    def dof_name(self, comm: MPI.Comm, dof: int) -> str:
        """As :meth:`Structure.dof_name` (collective)."""
        node, component = np.argwhere(gather_rows(comm, self.dofs) == dof)[0]
        x, y = np.round(gather_rows(comm, self.points)[node], 12) + 0.0  # no -1e-19
        return f"{'xy'[component]} displacement at ({x:.4g}, {y:.4g}) m"
