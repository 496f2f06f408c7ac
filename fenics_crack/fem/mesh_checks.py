"""Is a mesh one of a plane structure? What is certainly not is refused, with its place.

Cells may be numbered either way round, surface by surface. They must not be folded: the Jacobian
determinant of a cell has one sign at all of its nodes, two cells that share an edge lie on either
side of it, and the angles at a node are at most 2 pi. Then nothing overlaps in the neighbourhood
of any point, and elsewhere only where boundaries cross or a part lies on another one.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse

from fenics_crack.errors import InputError
from fenics_crack.fem.lips import SAME
from fenics_crack.mesher import gmsh

__all__ = ["DEGENERATE", "check_mesh", "determinants", "parts_of"]

DEGENERATE = 1e-9
"""Of a determinant relative to its largest value or to the square of the cell's size, and of an
angle relative to 2 pi."""
SAMPLES = 50
"""Cells of a part whose centres must not lie on another part."""


def check_mesh(
    kind: int, cells: np.ndarray, places: np.ndarray, clamp: np.ndarray, lips: np.ndarray
) -> None:
    """Raise InputError where a mesh cannot be one of a structure.

    Parameters
    ----------
    kind : int
        gmsh's number of the kind of cells.
    cells : (n_cells, n) int
        Their nodes in gmsh's order.
    places : (n_nodes, 2) [m]
        Of all nodes.
    clamp : (m,) int
        Nodes that are clamped.
    lips : (n_edges, 2) int
        Corners of the edges of all lips.

    Raises
    ------
    InputError
        Cells are folded or overlap, a part has no clamp, or edges of the boundary other than lips
        lie in one place.
    """
    corners = gmsh.model.mesh.getElementProperties(kind)[5]
    signs = _signs(kind, cells, places)
    cells = cells[:, :corners]
    boundary, owners = _unfolded_boundary(cells, signs, places)
    _check_angles(cells, places)
    n_parts, part = parts_of(cells, places, clamp, lips)
    _check_boundary(boundary, places, lips)
    if n_parts > 1:
        _check_layers(boundary, part[owners], cells, part, places)


def _refusal(found: str, place: np.ndarray, allowed: str) -> InputError:
    return InputError("mesh", f"{found} at ({', '.join(f'{x:g}' for x in place)})", allowed)


def determinants(
    kind: int, cells: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least and largest of the Jacobian determinants at the nodes of each cell, as gmsh numbers a
    kind, and the one of least size: (n_cells,) each [m^d]."""
    _, dimension, _, nodes, local, _ = gmsh.model.mesh.getElementProperties(kind)
    at = np.zeros((nodes, 3))
    at[:, :dimension] = np.reshape(local, (nodes, dimension))
    _, gradients, _ = gmsh.model.mesh.getBasisFunctions(kind, at.ravel(), "GradLagrange")
    gradients = np.reshape(gradients, (nodes, nodes, 3))[:, :, :dimension]
    here = places[cells].swapaxes(1, 2)
    every = np.array([np.linalg.det(here @ gradient) for gradient in gradients])
    return every.min(axis=0), every.max(axis=0), np.abs(every).min(axis=0)


def _signs(kind: int, cells: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Direction in which each cell is numbered, 1 or -1, from the determinants at its nodes."""
    least, most, _ = determinants(kind, cells, places)
    largest = np.maximum(-least, most)
    size = np.ptp(places[cells], axis=1).max(axis=1)
    for found, wrong in (
        ("a cell without area", largest <= DEGENERATE * size**2),
        ("a folded cell", np.minimum(-least, most) > DEGENERATE * largest),
    ):
        if np.any(wrong):
            place = places[cells[np.argmax(wrong)]].mean(axis=0)
            raise _refusal(found, place, "one of cells that are convex and have an area")
    return np.where(most > -least, 1, -1)


def _unfolded_boundary(
    cells: np.ndarray, signs: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Edges of one cell only, (n, 2), and their cells, where no two cells lie on one side of their
    common edge."""
    ahead = np.roll(cells, -1, axis=1)
    low, high = np.minimum(cells, ahead).ravel(), np.maximum(cells, ahead).ravel()
    upwards = ((cells < ahead) == (signs[:, None] > 0)).ravel()
    keys = low * len(places) + high
    order = np.argsort(keys, kind="stable")
    shared = keys[order[1:]] == keys[order[:-1]]
    if np.any(third := shared[1:] & shared[:-1]):
        edge = order[np.argmax(third)]
        place = (places[low[edge]] + places[high[edge]]) / 2.0
        raise _refusal("an edge of three cells", place, "one of at most two cells at an edge")
    folded = shared & (upwards[order[1:]] == upwards[order[:-1]])
    if np.any(folded):
        edge = order[np.argmax(folded)]
        place = (places[low[edge]] + places[high[edge]]) / 2.0
        allowed = "one of cells beside each other: these lie on one side of their common edge"
        raise _refusal("cells that overlap", place, allowed)
    alone = np.ones(len(keys), dtype=bool)
    alone[1:] &= ~shared
    alone[:-1] &= ~shared
    own = np.sort(order[alone])
    return np.column_stack([low[own], high[own]]), own // cells.shape[1]


def _check_angles(cells: np.ndarray, places: np.ndarray) -> None:
    """Angles at a node are 2 pi inside the mesh and less on its boundary."""
    here = places[cells]
    ahead, back = np.roll(here, -1, axis=1) - here, np.roll(here, 1, axis=1) - here
    crossed = ahead[..., 0] * back[..., 1] - ahead[..., 1] * back[..., 0]
    angles = np.arctan2(np.abs(crossed), (ahead * back).sum(axis=2))
    sums = np.bincount(cells.ravel(), angles.ravel(), len(places))
    worst = int(np.argmax(sums))
    if sums[worst] > 2.0 * np.pi * (1.0 + DEGENERATE):
        allowed = "one of cells beside each other: these go round their node more than once"
        raise _refusal("cells that overlap", places[worst], allowed)


def parts_of(
    cells: np.ndarray, places: np.ndarray, clamp: np.ndarray, lips: np.ndarray
) -> tuple[int, np.ndarray]:
    """Number of parts of a mesh that share no node, all of them clamped, and the part of each
    cell."""
    from scipy.sparse.csgraph import connected_components  # takes a while, for mesh files alone

    ones = np.ones(cells.size - len(cells), dtype=np.int8)
    ends = cells[:, :-1].ravel(), cells[:, 1:].ravel()
    graph = sparse.coo_matrix((ones, ends), (len(places), len(places)))
    part = connected_components(graph, directed=False)[1]
    own = np.unique(part[cells[:, 0]], return_inverse=True)[1]
    loose = np.flatnonzero(~np.isin(part[cells[:, 0]], part[clamp]))
    if len(loose):
        place = places[cells[loose]].mean(axis=(0, 1))
        held = len(lips) and np.any(np.isin(part[cells[loose, 0]], part[lips[:, 0]]))
        found = "a part held by contact alone" if held else "a part without a clamp"
        side = "an edge" if places.shape[1] == 2 else "a facet"
        allowed = (
            f"one whose parts each have {side} in 'clamp', or share nodes with one that has: "
            "nothing else holds them"
        )
        raise _refusal(found, place, allowed)
    return int(own.max()) + 1, own


def _check_boundary(edges: np.ndarray, places: np.ndarray, lips: np.ndarray) -> None:
    """Edges of the boundary neither cross nor lie in one place, but for those of lips."""
    from scipy.spatial import cKDTree

    size = len(places)
    is_lip = np.isin(edges @ [size, 1], np.sort(lips, axis=1) @ [size, 1])
    ends = places[edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    middles = ends.mean(axis=1)
    found = cKDTree(middles).query_ball_point(middles, lengths * (1.0 + SAME))
    one = np.repeat(np.arange(len(edges)), [len(near) for near in found])
    other = np.concatenate(found).astype(int)
    behind = (lengths[other] < lengths[one]) | ((lengths[other] == lengths[one]) & (other < one))
    wanted = behind & ~(is_lip[one] & is_lip[other])
    one, other = one[wanted], other[wanted]  # the shorter edge
    close = SAME * float(np.ptp(places, axis=0).max())

    from_one, from_other = _beside(ends[one], ends[other]), _beside(ends[other], ends[one])
    across = [np.abs(side).min(axis=1) > close for side in (from_one, from_other)]
    across += [side.prod(axis=1) < 0.0 for side in (from_one, from_other)]
    if np.any(crossed := np.all(across, axis=0)):
        place = middles[other[np.argmax(crossed)]]
        raise _refusal("cells that overlap", place, "one whose boundary does not cross itself")

    span = ends[one, 1] - ends[one, 0]
    share = np.sum((middles[other] - ends[one, 0]) * span, axis=1) / lengths[one] ** 2
    along = np.abs(from_one).max(axis=1) <= close
    inside = np.minimum(share, 1.0 - share) * lengths[one] > close
    if np.any(same := along & inside):
        place = middles[other[np.argmax(same)]]
        allowed = (
            "one whose cells share their nodes (gmsh: Coherence Mesh), but for the lips of named "
            "cracks ('crack', or 'lower_lip' and 'upper_lip'): two edges of its boundary lie there"
        )
        raise _refusal("doubled nodes", place, allowed)


def _beside(edges: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance of both ends of other edges from the lines of edges, left of them positive."""
    span = edges[:, 1] - edges[:, 0]
    to = others - edges[:, :1]
    crossed = span[:, None, 0] * to[..., 1] - span[:, None, 1] * to[..., 0]
    return np.asarray(crossed / np.linalg.norm(span, axis=1)[:, None])


def _check_layers(
    edges: np.ndarray, of_edge: np.ndarray, cells: np.ndarray, part: np.ndarray, places: np.ndarray
) -> None:
    """No part lies on another one: a ray from a cell crosses the others' boundaries evenly."""
    (x_0, y_0), (x_1, y_1) = places[edges].transpose(1, 2, 0)
    for number in range(int(part.max()) + 1):
        own = np.flatnonzero(part == number)
        own = own[np.linspace(0, len(own) - 1, min(SAMPLES, len(own))).astype(int)]
        centres = places[cells[own]].mean(axis=1)
        x, y = centres.T[:, :, None]
        passed = (y_0 <= y) != (y_1 <= y)
        with np.errstate(divide="ignore", invalid="ignore"):
            passed &= x_0 + (y - y_0) / (y_1 - y_0) * (x_1 - x_0) > x
        inside = np.sum(passed & (of_edge != number), axis=1) % 2 == 1
        if np.any(inside):
            allowed = "one whose parts lie beside each other: here one lies on another"
            raise _refusal("cells that overlap", centres[np.argmax(inside)], allowed)
