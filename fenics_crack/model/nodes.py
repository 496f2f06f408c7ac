"""Where the dofs and the contact pairs of a meshed structure are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.model.matrices import numbers, read_only
from fenics_crack.parallel import gather_rows

__all__ = ["Nodes", "Pairs"]

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

    def nearest(
        self, comm: MPI.Comm, key: str, point: Sequence[float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Position of the node nearest to a point, and its dofs (2,), -1 where clamped
        (collective).

        Raises
        ------
        InputError
            The point, called ``key``, is away from the mesh by more than 5 % of its size, or the
            nearest node is clamped or is two nodes, on the lips.
        """
        points, dofs = gather_rows(comm, self.points), gather_rows(comm, self.dofs)
        distance, size = np.linalg.norm(points - point, axis=1), np.ptp(points, axis=0).max()
        place = int(np.argmin(distance))
        (x, y), shown = points[place].round(12) + 0.0, tuple(map(float, point))
        there = f"the nearest node is at ({x:g}, {y:g})"
        if distance[place] > 0.05 * size:
            raise InputError(key, shown, f"on the mesh ({there})")
        if np.count_nonzero(np.linalg.norm(points - points[place], axis=1) <= 1e-6 * size) > 1:
            raise InputError(key, shown, f"near a node that exists once, not on the lips ({there})")
        if np.all(dofs[place] < 0):
            raise InputError(key, shown, f"near a node that is free to move ({there})")
        return points[place], dofs[place]

    def dof_name(self, comm: MPI.Comm, dof: int) -> str:
        """As :meth:`Structure.dof_name` (collective)."""
        node, component = np.argwhere(gather_rows(comm, self.dofs) == dof)[0]
        x, y = np.round(gather_rows(comm, self.points)[node], 12) + 0.0  # no -1e-19
        return f"{'xy'[component]} displacement at ({x:.4g}, {y:.4g}) m"


@dataclass(frozen=True, eq=False)
class Pairs:
    """Where the contact pairs of a structure are, crack by crack; the arrays are read-only.

    Attributes
    ----------
    points : (n_pairs, 2) [m] or None
        Positions.
    areas : (n_pairs,) [m^2] or None
        Area of the lip that belongs to each pair.
    cracks : (n_pairs,) int or None
        Number of the crack, from 0.
    positions : (n_pairs,) [m] or None
        Distance along the crack from its mouth, or from the left tip of a crack inside.
    places : dict of str to int
        A pair to watch on each crack, by its name: "the mouth"; of several cracks "the mouth of
        crack 1", "the middle of crack 2".
    """

    points: np.ndarray | None = None
    areas: np.ndarray | None = None
    cracks: np.ndarray | None = None
    positions: np.ndarray | None = None
    places: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("points", "areas", "cracks", "positions"):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, read_only(given))
