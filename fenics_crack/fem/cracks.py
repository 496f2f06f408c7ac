"""Cracks of a mesh: where they run, and how the nodes along them are doubled.

A crack face of a plate is a chain of edges from a mouth to a tip, from tip to tip, or from mouth to
mouth; that of a solid is a surface. A rim of a crack is a front, or a tip of a plate's, where it
lies inside, else a mouth. A node of a front belongs to both faces.

Where cracks are curves or surfaces inside, all of their nodes that are not on a front are doubled;
which of the two a cell has is found by walking from cell to cell around each of them, across facets
that are not of the crack. A facet whose corners are all on fronts stays whole: its nodes exist
once.

The material of a lower face lies below the crack: the normals that point out of it, summed along
the face, point up; or to the right where they are level.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import scipy.sparse as sparse

from fenics_crack.basics.errors import InputError

LIP_TAGS = ("lower_lip", "upper_lip")
"""Names of the two faces of all cracks of a mesh."""
POSITION_TOLERANCE = 1e-6
"""Distance within which two places are one, relative to the size of the mesh or the length of the
crack: text files have six digits and more."""
COINCIDENCE_TOLERANCE = 1e-3
"""Distance of nodes in the same place, relative to the shortest edge."""
FACETS = {
    4: np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]),
    8: np.array(
        [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    ),
}
"""Facets of a cell of a solid by its number of corners, in turn."""


@dataclass(frozen=True)
class CrackPath:
    """A crack face of one crack.

    Attributes
    ----------
    points : (n, 2) [m]
        Its corners, from the mouth to the tip; from the left to the right tip of a crack inside. Of
        a straight one both ends are enough.
    has_mouth : bool
        True if it begins at an edge of the plate.
    """

    points: np.ndarray
    has_mouth: bool

    @property
    def edges(self) -> np.ndarray:
        """Ends of its edges: (n - 1, 2, 2) [m]."""
        return np.stack([self.points[:-1], self.points[1:]], axis=1)

    @property
    def position(self) -> np.ndarray:
        """Distance of each corner from the beginning, along the face [m]."""
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def watched_place(self) -> tuple[str, float]:
        """Name of the watched pair, and its position: at the mouth, or in the middle of a crack
        inside."""
        return ("the mouth", 0.0) if self.has_mouth else ("the middle", 0.5 * self.position[-1])

    def locate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of points (n, 2) from the face, and of the nearest place from its beginning [m]:
        two arrays (n,)."""
        to, share = offsets_from_edges(points, self.edges)
        off, position = np.linalg.norm(to, axis=2), self.position
        places = position[:-1] + share * np.diff(position)
        edge, row = off.argmin(axis=1), np.arange(len(points))
        return off[row, edge], places[row, edge]

    def points_beside(self, point: Sequence[float]) -> tuple[list[float], list[float]] | None:
        """Points below and above one that lies on the crack, and not at its tip; else None."""
        (off,), (place,) = self.locate(np.array([point]))
        length = float(self.position[-1])
        from_tip = length - place if self.has_mouth else min(place, length - place)
        edge = np.searchsorted(self.position[1:-1], place)
        return points_on_both_sides(point, off, from_tip, _normals(self.edges[[edge]])[0], length)


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
    def watched_place(self) -> tuple[str, float]:
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
            off[some] = np.linalg.norm(
                _offsets_from_triangles(points[some], self.triangles), axis=2
            ).min(1)
            farther = 2.0 * self.size  # than any point of it from a front
            to_front = np.linalg.norm(offsets_from_edges(points[some], self.front)[0], axis=2)
            position[some] = to_front.min(axis=1, initial=farther)
        return off, position

    def points_beside(self, point: Sequence[float]) -> tuple[list[float], list[float]] | None:
        """Points below and above one that lies on the crack, and not at its front; else None."""
        at = np.asarray(point, dtype=float)
        (off,), (from_front,) = self.locate(at[None])
        nearest = np.linalg.norm(
            _offsets_from_triangles(at[None], self.triangles)[0], axis=1
        ).argmin()
        normal = _normals(self.triangles[[nearest]])[0]
        return points_on_both_sides(point, off, from_front, normal, self.size)


def _offsets_from_triangles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
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
        away, _ = offsets_from_edges(points, triangles[:, [first, second]])
        nearer = np.linalg.norm(away, axis=2) < size
        best[nearer], size[nearer] = away[nearer], np.linalg.norm(away, axis=2)[nearer]
    return best


def _normals(facets: np.ndarray) -> np.ndarray:
    """Normals of edges (n, 2, 2) as long as these, or of triangles (n, 3, 3) twice their areas."""
    spans = facets[:, 1:] - facets[:, :1]
    if facets.shape[2] == 2:
        return np.asarray(spans[:, 0] @ [[0.0, -1.0], [1.0, 0.0]])
    return np.asarray(np.cross(spans[:, 0], spans[:, 1]))


Cracks = tuple[CrackPath, ...] | tuple[CrackSurface, ...]
"""Crack faces of a plate, or of a solid."""
NamedParts = tuple[dict[str, tuple[int, ...]], dict[str, tuple[float, ...]]]
"""Named parts of a mesh: tags of the facets of each curve or surface, and positions of the points
[m]."""


def offsets_from_edges(points: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors to points (n, d) from the nearest points of edges (m, 2, d): (n, m, d); and the parts
    of the edges at which these are: (n, m)."""
    span = edges[:, 1] - edges[:, 0]
    to = points[:, None] - edges[:, 0]
    share = np.clip((to * span).sum(axis=2) / (span**2).sum(axis=1), 0.0, 1.0)
    return to - share[..., None] * span, share


def points_on_both_sides(
    point: Sequence[float], off: float, from_front: float, normal: np.ndarray, size: float
) -> tuple[list[float], list[float]] | None:
    """Points below and above one on a crack of some size, by the crack's normal there; None where
    it is off the crack, or at its front."""
    if off > POSITION_TOLERANCE * size or from_front <= POSITION_TOLERANCE * size:
        return None
    across = 1e-3 * size * upward_sign(normal) * normal / np.linalg.norm(normal)
    return np.round(point - across, 9).tolist(), np.round(point + across, 9).tolist()


def distribute_front_pressures(neighbours: sparse.csr_matrix) -> sparse.csr_matrix:
    """S (inside + fronts, inside) of the pressures of a solid: those of a front's nodes go to their
    neighbours on the face, by how much their functions overlap, (fronts, inside)."""
    total = sparse.diags(1.0 / np.asarray(neighbours.sum(axis=1)).ravel())
    return sparse.vstack([sparse.eye(neighbours.shape[1]), total @ neighbours]).tocsr()


def upward_sign(normal: np.ndarray) -> float:
    """1 where a normal points up: along y, or else along x, or else along z; otherwise -1."""
    for axis in (1, 0, 2)[: len(normal)]:
        if abs(normal[axis]) > COINCIDENCE_TOLERANCE * np.abs(normal).max():
            return float(np.sign(normal[axis]))
    return 1.0


def locate_on_cracks(lips: Sequence[Any], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """On which crack points (n, dimension) lie, and their positions on it [m]: two arrays (n,)."""
    off, positions = np.array([lip.locate(points) for lip in lips]).transpose(1, 0, 2)
    crack = off.argmin(axis=0)
    return crack, positions[crack, np.arange(len(points))]


def label_parts(rows: np.ndarray) -> np.ndarray:
    """The part of each row of nodes, (n,) int: rows are of one where they share a node."""
    from scipy.sparse.csgraph import connected_components  # takes a while, for few meshes

    ends, count = (rows[:, :-1].ravel(), rows[:, 1:].ravel()), int(rows.max()) + 1
    links = sparse.coo_matrix((np.ones(len(ends[0]), bool), ends), (count, count))
    part = connected_components(links, directed=False)[1][rows[:, 0]]
    return np.unique(part, return_inverse=True)[1]


def find_unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the first places of different rows of nodes, in any order, and their counts; and the
    index among them of each row (n,)."""
    _, first, which, uses = np.unique(
        np.sort(rows, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    return first, which.ravel(), uses


def rows_in(rows: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return True for each row of nodes, in any order, that is among others: (n,) bool."""
    _, kinds, _ = find_unique_rows(np.concatenate([others, rows]))
    return np.asarray(np.isin(kinds[len(others) :], kinds[: len(others)]))


# --- finding them by their faces ------------------------------------------------------------------


def find_crack_paths(
    lower: np.ndarray, upper: np.ndarray, positions: np.ndarray
) -> tuple[CrackPath, ...]:
    """The faces of all cracks, from bottom to top and from left to right by where they begin.

    Parameters
    ----------
    lower, upper : (n, 2) int
        Edges of the lower and of the upper faces: their nodes.
    positions : (n_nodes, 2) [m]
        Of all nodes.

    Raises
    ------
    InputError
        The two faces are the same curve, or a crack branches or is closed.
    """
    shared = np.intersect1d(lower, upper)
    if len(shared) == len(np.unique(lower)):
        allowed = "different nodes in the same places but for the tips; or one curve named 'crack'"
        raise InputError("lips", "the same nodes for 'lower_lip' and 'upper_lip'", allowed)
    lips = []
    for chain in _chains(lower, shared, positions):
        first, last = (tuple(positions[chain[end]]) for end in (0, -1))
        mouths = chain[0] not in shared, chain[-1] not in shared
        turned = last < first if mouths[0] == mouths[1] else mouths[1]
        points = positions[chain[::-1] if turned else chain]
        lips.append(CrackPath(points, any(mouths)))
    return tuple(sorted(lips, key=lambda lip: tuple(lip.points[0, ::-1])))


def _chains(edges: np.ndarray, tips: np.ndarray, positions: np.ndarray) -> Iterator[np.ndarray]:
    """Yield edges (n, 2) put together to chains of nodes, which end at tips and mouths."""
    from scipy.sparse.csgraph import breadth_first_order

    nodes, uses = np.unique(edges, return_counts=True)
    for node, count in zip(nodes, uses, strict=True):
        if count > 2 and node not in tips:
            place = "({:g}, {:g})".format(*positions[node])
            allowed = "cracks that neither branch nor cross, as one of them does here"
            raise InputError("lips", f"{count} edges of a crack face at {place}", allowed)
    apart = len(positions) + np.arange(edges.size).reshape(edges.shape)  # a tip of each crack
    part = label_parts(np.where(np.isin(edges, tips), apart, edges))
    for number in range(part.max() + 1):
        ends, which = np.unique(edges[part == number].ravel(), return_inverse=True)
        single = np.flatnonzero(np.bincount(which) == 1)
        if not len(single):
            allowed = "cracks with two ends; a closed curve would cut a piece out of the structure"
            raise InputError("lips", "a closed curve", allowed)
        links = np.ones(len(which) // 2), tuple(which.reshape(-1, 2).T)
        graph = sparse.coo_matrix(links, (len(ends),) * 2)
        yield ends[breadth_first_order(graph.tocsr(), single[0], directed=False)[0]]


def find_crack_surfaces(
    lower: np.ndarray, upper: np.ndarray, places: np.ndarray
) -> tuple[CrackSurface, ...]:
    """The cracks of a solid that is split, from bottom to top, by the corners of the facets of both
    crack faces, (m, k) and (m', k) int: these share the nodes of the fronts."""
    edges, uses = np.unique(_edges(lower), axis=0, return_counts=True)
    rim = edges[uses == 1]
    is_front = np.isin(rim, upper).all(axis=1)
    part, found = label_parts(lower), []
    halves = [[0, 1, 2], [0, 2, 3]][: lower.shape[1] - 2]
    for number in range(part.max() + 1):
        facets = lower[part == number]
        own = np.isin(rim, facets).all(axis=1)
        corners = places[np.concatenate([facets[:, half] for half in halves])]
        front = places[rim[own & is_front]]
        found.append(CrackSurface(corners, front, bool(np.any(own & ~is_front))))
    found.sort(key=lambda crack: tuple(crack.triangles.mean(axis=(0, 1))[[1, 0, 2]]))
    return tuple(found)


# --- doubling their nodes -------------------------------------------------------------------------


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
    def sorted_facets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corners of the facets of all cells, sorted, so that equal ones follow each other; the
        cell of each, and the places of its corners in ``nodes``."""
        corners = self.nodes[:, self.facets].reshape(-1, self.facets.shape[1])
        inside = np.argsort(corners, axis=1)
        places = np.take_along_axis(np.tile(self.facets, (len(self.nodes), 1)), inside, axis=1)
        corners = np.take_along_axis(corners, inside, axis=1)
        order = np.lexsort(corners.T[::-1])
        return corners[order], order // len(self.facets), places[order]

    @cached_property
    def is_shared(self) -> np.ndarray:
        """True for each of these facets but the last if it is the next one's cell's, too."""
        facets = self.sorted_facets[0]
        return np.asarray(np.all(facets[1:] == facets[:-1], axis=1))

    @cached_property
    def is_boundary(self) -> np.ndarray:
        """True for each of these facets that belongs to one cell only."""
        both = np.concatenate([[False], self.is_shared, [False]])
        return ~(both[1:] | both[:-1])


def merge_crack_nodes(surface: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nodes (n_kept,) of a mesh that are kept where those in one place along cracks become one,
    and which of them each node (n_nodes,) is.

    gmsh's plugin "Crack" doubles nodes as :func:`split_cracks` does; ``surface`` and ``places`` are
    as there.
    """
    from scipy.spatial import cKDTree  # takes a while, for mesh files alone

    lengths = np.linalg.norm(places[surface[:, 0]] - places[surface[:, 1]], axis=1)
    number = np.arange(len(places))
    around = places[np.unique(surface)]
    for same in cKDTree(places).query_ball_point(
        around, COINCIDENCE_TOLERANCE * float(lengths.min())
    ):
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
    (facets, owner, at), same = cells.sorted_facets, cells.is_shared
    on_crack = np.isin(np.arange(len(places)), corners)
    of_crack = on_crack[facets].all(axis=1)
    of_crack[of_crack] = rows_in(facets[of_crack], corners)
    inside = np.flatnonzero(same & of_crack[:-1])
    require(
        len(inside) == len(surface),
        f"{len(surface) - len(inside)} of the {len(surface)} {part} of cracks not between cells",
        f"inside the structure, with a cell on either side of {part}",
    )
    outer = facets[cells.is_boundary & on_crack[facets].any(axis=1)]
    is_split = on_crack.copy()
    is_split[_fronts(surface[:, :width], outer)] = False
    piece = label_parts(corners)
    closed = np.setdiff1d(piece, piece[is_split[corners].any(axis=1)])
    require(not len(closed), "all nodes of a crack on its front", "meshed more finely")

    # Of each facet both sides: around which nodes' stars they are connected to others.
    label = _stars(cells, same & ~of_crack[:-1], is_split).reshape(-1, cells.n_corners)
    beside = np.concatenate([inside, inside + 1])
    cell, fixed = owner[beside], ~is_split[facets[beside]]
    stars = label[cell[:, None], at[beside]]
    stars[fixed] = label.size + np.arange(fixed.sum())
    chain = label_parts(stars)
    facing = np.unique(np.sort(np.split(chain, 2), axis=0), axis=1)  # two by two
    touching = is_split[cells.nodes[:, : cells.n_corners]]
    require(
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
    first_is_lower = np.array([upward_sign(normal) > 0.0 for normal in outwards[facing[0]]])
    upper = np.where(first_is_lower, facing[1], facing[0])
    is_upper = touching & np.isin(label, stars[np.isin(chain, upper)])
    # A node between corners is doubled with any of them.
    on_crack[surface] = True
    above = on_crack[cells.nodes] & (is_upper @ cells.supports.T)
    twins, new = np.unique(cells.nodes[above]), np.arange(len(places))
    new[twins] = len(places) + np.arange(len(twins))
    lower = surface[is_split[surface[:, :width]].any(axis=1)]
    nodes = np.where(above, new[cells.nodes], cells.nodes)
    return nodes, twins, np.stack([lower, new[lower]], axis=1)


def require(condition: object, found: str, allowed: str) -> None:
    """Raise InputError of a mesh unless a condition holds."""
    if not condition:
        raise InputError("mesh", found, allowed)


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
    require(np.all(uses <= 2), "more than two sides of a crack meeting", allowed)
    rim = parts[uses == 1]
    # Sorted corners of four are not in turn: take every two of them.
    every = [boundary[:, own] for own in combinations(range(width), parts.shape[1])]
    return np.asarray(rim[~rows_in(rim, np.concatenate(every))])


def _stars(cells: Cells, passable: np.ndarray, is_split: np.ndarray) -> np.ndarray:
    """Corners of cells at one node that are connected across facets with it: a number for each
    corner of each cell (n_cells n_corners,)."""
    from scipy.sparse.csgraph import connected_components

    facets, owner, at = cells.sorted_facets
    first = np.flatnonzero(passable & is_split[facets[:-1]].any(axis=1))
    wanted = is_split[facets[first]]
    one, other = (owner[i][:, None] * cells.n_corners + at[i] for i in (first, first + 1))
    size = len(cells.nodes) * cells.n_corners
    links = np.ones(int(wanted.sum()), dtype=np.int8), (one[wanted], other[wanted])
    return np.asarray(connected_components(sparse.coo_matrix(links, (size, size)))[1])
