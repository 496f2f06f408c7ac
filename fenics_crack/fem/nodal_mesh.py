"""The whole mesh of a structure, gathered: for files and pictures."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem.cracks import FACETS, find_unique_rows
from fenics_crack.model.structure import Structure

_TRIANGLES = {
    3: [(0, 1, 2)],
    4: [(0, 1, 2), (0, 2, 3)],
    6: [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    9: [(0, 4, 8), (4, 1, 8), (1, 5, 8), (5, 2, 8), (2, 6, 8), (6, 3, 8), (3, 7, 8), (7, 0, 8)],
}
"""Triangles into which a cell is cut to be coloured, by its number of nodes, in VTK's order."""


class NodalMesh:
    """The whole mesh of a structure on every rank (collective to make).

    Attributes
    ----------
    points : (n_nodes, d) [m]
        Node positions: d = 2 of a plate, 3 of a solid.
    cells : (n_cells, k) int
        Their nodes in VTK's order.
    vtk_type : int
        VTK's number of the cell type.
    size : float [m]
        Largest extent.
    clamped : (n_nodes,) bool
        Where neither component can move.
    """

    def __init__(self, structure: Structure) -> None:
        if structure.nodes is None or structure.meshed is None:
            raise InputError("structure", "made from matrices", "made from a mesh")
        whole = structure.whole
        nodes, comm = structure.nodes, whole.comm
        self.structure = whole
        self.points = gather_rows(comm, nodes.points)
        self.size = float(np.ptp(self.points, axis=0).max())
        self._dofs = gather_rows(comm, nodes.dofs)
        self._frames = None if nodes.frames is None else gather_rows(comm, nodes.frames)
        self.is_clamped = np.all(self._dofs < 0, axis=1)
        self.cells = np.concatenate([c for c in comm.allgather(nodes.cells) if len(c)])
        self.vtk_type = nodes.vtk_type

    def field(self, rows: np.ndarray) -> np.ndarray:
        """Nodal vectors (m, n_nodes, d) of dof values (m, n_local); zero where clamped."""
        whole = np.concatenate(self.structure.comm.allgather(rows), axis=1)
        found = np.where(self._dofs >= 0, whole[:, np.maximum(self._dofs, 0)], 0.0)
        return found if self._frames is None else np.einsum("nij,mnj->mni", self._frames, found)

    def in_frames(self, vectors: np.ndarray) -> np.ndarray:
        """Nodal vectors (m, n_nodes, d) in the frames of the nodes, in which the dofs are."""
        frames = self._frames
        return vectors if frames is None else np.einsum("nji,mnj->mni", frames, vectors)

    @property
    def dimension(self) -> int:
        """2 of a plate, 3 of a solid."""
        return int(self.points.shape[1])

    @property
    def triangles(self) -> np.ndarray:
        """Into which the cells of a plate are cut to be coloured: (n, 3) nodes."""
        return self.cells[:, _TRIANGLES[self.cells.shape[1]]].reshape(-1, 3)

    @cached_property
    def patches(self) -> tuple[np.ndarray, np.ndarray]:
        """Of a solid's pairs: 1 at the two nodes in the middle of each patch; and the functions of
        the pressures at all nodes of the crack faces, linear between corners of facets, which have
        the shares of the pairs, or where these are not known each the nearest pair, and fronts
        none: (n_nodes, n_pairs) each."""
        from scipy.spatial import cKDTree

        points, near, pairs = self.points, 1e-6 * self.size, self.structure.pairs
        corners = np.unique(facets := self.crack_faces)
        here = points[corners]
        distance, pair = cKDTree(self.structure.pair_points).query(here)
        twice = cKDTree(here).query_ball_point(here, near, return_length=True) > 1
        middles, shares = np.zeros((2, len(points), self.structure.n_pairs))
        middles[corners[distance <= near], pair[distance <= near]] = 1.0
        if pairs.nodes is not None and pairs.shares is not None:
            shares[corners] = pairs.shares[cKDTree(pairs.nodes).query(here)[1]].toarray()
        else:
            shares[corners[twice], pair[twice]] = 1.0
        ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2).reshape(-1, 2)
        ends = np.concatenate([ends, facets[:, [0, 2]]]) if facets.shape[1] == 4 else ends
        others = np.setdiff1d(np.arange(len(points)), corners)
        distance, edge = cKDTree(points[ends].mean(axis=1)).query(points[others])
        there = distance <= near
        shares[others[there]] = shares[ends[edge[there]]].mean(axis=1)
        return middles, shares

    @cached_property
    def _sides(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Edges of the cells of a plate, or corners of the facets of a solid's, in turn; how many
        cells have each of them, and one of these."""
        count = self.cells.shape[1]
        corners = 3 if count in (3, 6) else 4
        steps = np.arange(corners)
        turns = np.column_stack([steps, corners + steps, np.roll(steps, -1)])
        turns = turns if count > corners else turns[:, ::2]
        if self.dimension == 3:
            turns = FACETS[4 if count in (4, 10) else 8]
        sides = self.cells[:, turns].reshape(-1, turns.shape[1])
        first, _, uses = find_unique_rows(sides if self.dimension == 3 else sides[:, [0, -1]])
        order = np.argsort(first)
        return sides[first[order]], uses[order], first[order] // len(turns)

    @property
    def edges(self) -> np.ndarray:
        """Edges of the cells of a plate: (n_edges, 2 or 3) nodes, a middle one in between."""
        return self._sides[0]

    @cached_property
    def boundary(self) -> np.ndarray:
        """Edges that belong to one cell only, likewise; of a solid corners of such facets, (n, 3 or
        4), in turn, anticlockwise as they are seen from outside."""
        sides, uses, cells = self._sides
        sides, cells = sides[uses == 1], self.cells[cells[uses == 1]]
        if self.dimension == 3:
            here, corners = self.points[sides], 4 if sides.shape[1] == 3 else 8
            outwards = here.mean(axis=1) - self.points[cells[:, :corners]].mean(axis=1)
            normals = np.cross(here[:, 1] - here[:, 0], here[:, 2] - here[:, 0])
            inwards = (normals * outwards).sum(axis=1) < 0.0
            sides[inwards] = sides[inwards, ::-1]
        return np.asarray(sides)

    @cached_property
    def crack_faces(self) -> np.ndarray:
        """Those of the boundary that coincide with another one: the crack faces."""
        from scipy.spatial import cKDTree  # takes a while, for some pictures

        middle = self.points[self.boundary].mean(axis=1)
        pairs = cKDTree(middle).query_pairs(1e-6 * self.size, output_type="ndarray")
        return np.asarray(self.boundary[np.unique(pairs)])
