"""Cracks: curves of a plate's mesh, or surfaces of a solid's, along which nodes are doubled.

A rim of a crack is a front, or a tip of a plate's, where it lies inside, else a mouth. All of its
nodes that are not on a front exist twice afterwards; which of the two a cell has is found by
walking from cell to cell around each of them, across facets that are not of the crack. A facet
whose corners are all on fronts stays whole: its nodes exist once.

The material of a lower face lies below the crack: the normals that point out of it, summed along
the face, point up; or to the right where they are level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy.sparse as sparse

from fenics_crack.basics.errors import InputError
from fenics_crack.fem.lips import (
    COINCIDENT,
    SAME,
    Lip,
    both_sides,
    connected,
    rows_in,
    to_edges,
    upwards,
)

FACETS = {
    4: np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]),
    8: np.array(
        [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    ),
}
"""Facets of a cell of a solid by its number of corners, in turn."""


@dataclass(frozen=True)
class CrackSurface:
    """One crack in a solid.

    Attributes
    ----------
    triangles : (n, 3, 3) [m]
        Corners of its facets; of one with four corners of both halves.
    front : (m, 2, 3) [m]
        Ends of the edges of its front; none where it parts two bodies.
    has_mouth : bool
        True if its rim reaches the surface of the solid.
    """

    triangles: np.ndarray
    front: np.ndarray
    has_mouth: bool

    @property
    def watched(self) -> tuple[str, float]:
        """Name of the watched pair, and its position: the farthest from the front."""
        return "the mouth" if self.has_mouth else "the middle", np.inf

    @property
    def size(self) -> float:
        """Largest extent [m]."""
        return float(np.ptp(self.triangles.reshape(-1, 3), axis=0).max())

    def locate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of points (n, 3) from the surface and from the front [m], equal for all without
        a front: two arrays (n,)."""
        off, position = np.empty(len(points)), np.empty(len(points))
        # Two million distances at a time.
        step = max(1, 2_000_000 // max(len(self.triangles), len(self.front)))
        for first in range(0, len(points), step):
            some = slice(first, first + step)
            off[some] = np.linalg.norm(_to_triangles(points[some], self.triangles), axis=2).min(1)
            farther = 2.0 * self.size  # than any point of it from a front
            to_front = np.linalg.norm(to_edges(points[some], self.front)[0], axis=2)
            position[some] = to_front.min(axis=1, initial=farther)
        return off, position

    def beside(self, point: Sequence[float]) -> tuple[list[float], list[float]] | None:
        """Points below and above one that lies on the crack, and not at its front; else None."""
        at = np.asarray(point, dtype=float)
        (off,), (position,) = self.locate(at[None])
        if off > SAME * self.size or position <= SAME * self.size:
            return None
        nearest = np.linalg.norm(_to_triangles(at[None], self.triangles)[0], axis=1).argmin()
        return both_sides(point, _normals(self.triangles[nearest][None])[0], self.size)


def _to_triangles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Vectors to points (n, 3) from the nearest points of triangles (m, 3, 3): (n, m, 3)."""
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    to = points[:, None] - triangles[:, 0]
    a, b, c = (one**2).sum(1), (one * two).sum(1), (two**2).sum(1)
    d, e = (to * one).sum(2), (to * two).sum(2)
    u, v = (c * d - b * e) / (a * c - b**2), (a * e - b * d) / (a * c - b**2)
    best = to - u[..., None] * one - v[..., None] * two
    outside = (u < 0.0) | (v < 0.0) | (u + v > 1.0)
    size = np.where(outside, np.inf, np.linalg.norm(best, axis=2))
    for first, second in ((0, 1), (1, 2), (2, 0)):
        away, _ = to_edges(points, triangles[:, [first, second]])
        nearer = np.linalg.norm(away, axis=2) < size
        best[nearer], size[nearer] = away[nearer], np.linalg.norm(away, axis=2)[nearer]
    return best


def _normals(facets: np.ndarray) -> np.ndarray:
    """Normals of edges (n, 2, 2) as long as these, or of triangles (n, 3, 3) twice their areas."""
    spans = facets[:, 1:] - facets[:, :1]
    if facets.shape[2] == 2:
        return np.asarray(spans[:, 0] @ [[0.0, -1.0], [1.0, 0.0]])
    return np.asarray(np.cross(spans[:, 0], spans[:, 1]))


Lips = tuple[Lip, ...] | tuple[CrackSurface, ...]
"""Crack faces of a plate, or of a solid."""
Names = tuple[dict[str, tuple[int, ...]], dict[str, tuple[float, ...]]]
"""Named parts of a mesh: tags of the facets of each curve or surface, and positions of the points
[m]."""


@dataclass(frozen=True)
class Cells:
    """Cells of one kind, of a plate or of a solid.

    Attributes
    ----------
    nodes : (n_cells, k) int
        In gmsh's order: the corners first.
    facets : (n_facets, n) int
        Corners of the facets of a cell, by their places in a row of ``nodes``.
    supports : (k, n_corners) bool
        Of each node of a cell the corners between which it lies.
    """

    nodes: np.ndarray
    facets: np.ndarray
    supports: np.ndarray

    @property
    def n_corners(self) -> int:
        """Number of corners of a cell."""
        return int(self.facets.max()) + 1

    @cached_property
    def all_facets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corners of the facets of all cells, sorted, so that equal ones follow each other; the
        cell of each, and the places of its corners in ``nodes``."""
        corners = self.nodes[:, self.facets].reshape(-1, self.facets.shape[1])
        inside = np.argsort(corners, axis=1)
        places = np.take_along_axis(np.tile(self.facets, (len(self.nodes), 1)), inside, axis=1)
        corners = np.take_along_axis(corners, inside, axis=1)
        order = np.lexsort(corners.T[::-1])
        return corners[order], order // len(self.facets), places[order]

    @cached_property
    def shared(self) -> np.ndarray:
        """True for each of these facets but the last if it is the next one's cell's, too."""
        facets = self.all_facets[0]
        return np.asarray(np.all(facets[1:] == facets[:-1], axis=1))

    @cached_property
    def alone(self) -> np.ndarray:
        """True for each of these facets that belongs to one cell only."""
        both = np.concatenate([[False], self.shared, [False]])
        return ~(both[1:] | both[:-1])


def joined(surface: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nodes (n_kept,) of a mesh that are kept where those in one place along cracks become one,
    and which of them each node (n_nodes,) is.

    gmsh's plugin "Crack" doubles nodes as :func:`split_cracks` does; ``surface`` and ``places`` are
    as there.
    """
    from scipy.spatial import cKDTree  # takes a while, for mesh files alone

    lengths = np.linalg.norm(places[surface[:, 0]] - places[surface[:, 1]], axis=1)
    number = np.arange(len(places))
    around = places[np.unique(surface)]
    for same in cKDTree(places).query_ball_point(around, COINCIDENT * float(lengths.min())):
        number[same] = min(same)
    return np.unique(number, return_inverse=True)


def split_cracks(
    cells: Cells, surface: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Double the nodes along cracks.

    Parameters
    ----------
    cells : Cells
        Their nodes are rows of ``places``.
    surface : (m, k) int
        Facets of all cracks: their nodes, the corners first.
    places : (n_nodes, d) [m]
        Of all nodes.

    Returns
    -------
    nodes : (n_cells, k) int
        The cells, those above a crack with nodes of their own, from ``n_nodes`` on.
    twins : (n_new,) int
        The nodes of which the new ones are copies.
    lips : (m', 2, k) int
        Facets of the lower face, and those of the upper one in the same places.

    Raises
    ------
    InputError
        A facet is not between two cells, or cracks branch, cross or have not two sides.
    """
    width, part = cells.facets.shape[1], ("edges", "facets")[places.shape[1] - 2]
    corners, first = np.unique(np.sort(surface[:, :width], axis=1), axis=0, return_index=True)
    surface = surface[first]  # as the facets are
    (facets, owner, at), same = cells.all_facets, cells.shared
    on_crack = np.isin(np.arange(len(places)), corners)
    of_crack = on_crack[facets].all(axis=1)
    of_crack[of_crack] = rows_in(facets[of_crack], corners)
    inside = np.flatnonzero(same & of_crack[:-1])
    _require(
        len(inside) == len(surface),
        f"{len(surface) - len(inside)} of the {len(surface)} {part} of cracks not between cells",
        f"inside the structure, with a cell on either side of {part}",
    )
    outer = facets[cells.alone & on_crack[facets].any(axis=1)]
    is_split = on_crack.copy()
    is_split[_fronts(surface[:, :width], outer)] = False
    piece = connected(corners)
    closed = np.setdiff1d(piece, piece[is_split[corners].any(axis=1)])
    _require(not len(closed), "all nodes of a crack on its front", "meshed more finely")

    # Of each facet both sides: around which nodes' stars they are connected to others.
    label = _stars(cells, same & ~of_crack[:-1], is_split).reshape(-1, cells.n_corners)
    beside = np.concatenate([inside, inside + 1])
    cell, fixed = owner[beside], ~is_split[facets[beside]]
    stars = label[cell[:, None], at[beside]]
    stars[fixed] = label.size + np.arange(fixed.sum())
    chain = connected(stars)
    facing = np.unique(np.sort(np.split(chain, 2), axis=0), axis=1)  # two by two
    touching = is_split[cells.nodes[:, : cells.n_corners]]
    _require(
        facing.size == chain.max() + 1
        and np.all(facing[0] != facing[1])
        and np.all(np.isin(label[touching], stars)),
        "not two sides everywhere along a crack",
        "cracks that neither branch nor cross, and end at their fronts or at the boundary",
    )
    ends = np.tile(places[surface[:, :width]], (2, 1, 1))
    normals = _normals(ends)
    away = places[cells.nodes[cell, : cells.n_corners]].mean(axis=1) - ends.mean(axis=1)
    normals[(away * normals).sum(axis=1) > 0.0] *= -1.0  # out of the material
    outwards = np.zeros((facing.size, places.shape[1]))
    np.add.at(outwards, chain, normals)
    first_is_lower = np.array([upwards(normal) > 0.0 for normal in outwards[facing[0]]])
    upper = np.where(first_is_lower, facing[1], facing[0])
    is_upper = touching & np.isin(label, stars[np.isin(chain, upper)])
    nodes, new = _renumbered(cells, is_upper, surface, len(places))
    lower = surface[is_split[surface[:, :width]].any(axis=1)]
    lips = np.stack([lower, np.where(new[lower] >= 0, new[lower], lower)], axis=1)
    return nodes, np.flatnonzero(new >= 0), lips


def cracks_between(
    lower: np.ndarray, upper: np.ndarray, places: np.ndarray
) -> tuple[CrackSurface, ...]:
    """The cracks of a solid that is split, from bottom to top, by the corners of the facets of both
    crack faces, (m, k) and (m', k) int: these share the nodes of the fronts."""
    edges, uses = np.unique(_edges(lower), axis=0, return_counts=True)
    rim = edges[uses == 1]
    is_front = np.isin(rim, upper).all(axis=1)
    part, found = connected(lower), []
    for number in range(part.max() + 1):
        facets = lower[part == number]
        own = np.isin(rim, facets).all(axis=1)
        corners = places[np.concatenate(_triangles(facets))]
        front = places[rim[own & is_front]]
        found.append(CrackSurface(corners, front, bool(np.any(own & ~is_front))))
    found.sort(key=lambda crack: tuple(crack.triangles.mean(axis=(0, 1))[[1, 0, 2]]))
    return tuple(found)


def _require(condition: object, found: str, allowed: str) -> None:
    if not condition:
        raise InputError("crack", found, allowed)


def _edges(polygons: np.ndarray) -> np.ndarray:
    """Edges of polygons (n, k), their ends sorted: (n k, 2)."""
    ends = np.stack([polygons, np.roll(polygons, -1, axis=1)], axis=2)
    return np.sort(ends.reshape(-1, 2), axis=1)


def _fronts(surface: np.ndarray, boundary: np.ndarray) -> np.ndarray:
    """Edges of the fronts (n, 2), or nodes of the tips (n, 1)."""
    width = surface.shape[1]
    parts = surface.reshape(-1, 1) if width == 2 else _edges(surface)
    parts, uses = np.unique(parts, axis=0, return_counts=True)
    allowed = "cracks that neither branch nor cross"
    _require(np.all(uses <= 2), "more than two sides of a crack meeting", allowed)
    rim = parts[uses == 1]
    # Sorted corners of four are not in turn: take every two of them.
    every = [boundary[:, own] for own in combinations(range(width), parts.shape[1])]
    return np.asarray(rim[~rows_in(rim, np.concatenate(every))])


def _triangles(surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets as triangles: of each the first half, and the other half of those with four
    corners."""
    return surface[:, :3], surface[:, [0, 2, 3]] if surface.shape[1] == 4 else surface[:0, :3]


def _stars(cells: Cells, passable: np.ndarray, is_split: np.ndarray) -> np.ndarray:
    """Corners of cells at one node that are connected across facets with it: a number for each
    corner of each cell (n_cells n_corners,)."""
    from scipy.sparse.csgraph import connected_components

    facets, owner, at = cells.all_facets
    first = np.flatnonzero(passable & is_split[facets[:-1]].any(axis=1))
    wanted = is_split[facets[first]]
    one, other = (owner[i][:, None] * cells.n_corners + at[i] for i in (first, first + 1))
    size = len(cells.nodes) * cells.n_corners
    links = np.ones(int(wanted.sum()), dtype=np.int8), (one[wanted], other[wanted])
    return np.asarray(connected_components(sparse.coo_matrix(links, (size, size)))[1])


def _renumbered(
    cells: Cells, is_upper: np.ndarray, surface: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The cells with new nodes above the cracks, and the new number of each node, -1 where it
    exists once.

    A node between corners is doubled with any of them; ``is_upper`` marks those of each cell.
    """
    on_crack = np.zeros(count, dtype=bool)
    on_crack[surface] = True
    above = on_crack[cells.nodes] & (is_upper @ cells.supports.T)
    new = np.full(count, -1)
    doubled = np.unique(cells.nodes[above])
    new[doubled] = count + np.arange(len(doubled))
    return np.where(above, new[cells.nodes], cells.nodes), new
