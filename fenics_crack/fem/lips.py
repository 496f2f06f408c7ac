"""The faces of cracks in a plate's mesh: where they run, and where they begin.

A crack face is a chain of edges from a mouth to a tip, from tip to tip, or from mouth to mouth. A
tip is a node of both faces.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse

from fenics_crack.basics.errors import InputError

LIP_TAGS = ("lower_lip", "upper_lip")
"""Names of the two faces of all cracks of a mesh."""
SAME = 1e-6
"""Distance within which two places are one, relative to the size of the mesh or the length of the
crack: text files have six digits and more."""
COINCIDENT = 1e-3
"""Distance of nodes in the same place, relative to the shortest edge."""


@dataclass(frozen=True)
class Lip:
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
    def position(self) -> np.ndarray:
        """Distance of each corner from the beginning, along the face [m]."""
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def watched(self) -> tuple[str, float]:
        """Name of the watched pair, and its position: at the mouth, or in the middle of a crack
        inside."""
        return ("the mouth", 0.0) if self.has_mouth else ("the middle", 0.5 * self.position[-1])

    def locate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of points (n, 2) from the face, and of the nearest place from its beginning [m]:
        two arrays (n,)."""
        ends = np.stack([self.points[:-1], self.points[1:]], axis=1)
        to, share = to_edges(points, ends)
        off, position = np.linalg.norm(to, axis=2), self.position
        places = position[:-1] + share * np.diff(position)
        edge, row = off.argmin(axis=1), np.arange(len(points))
        return off[row, edge], places[row, edge]

    def beside(self, point: Sequence[float]) -> tuple[list[float], list[float]] | None:
        """Points below and above one that lies on the crack, and not at its tip; else None."""
        (off,), (place,) = self.locate(np.array([point]))
        length = self.position[-1]
        from_tip = length - place if self.has_mouth else min(place, length - place)
        if off > SAME * length or from_tip <= SAME * length:
            return None
        edge = np.searchsorted(self.position[1:-1], place)
        along = np.diff(self.points, axis=0)[edge]
        return both_sides(point, np.array([-along[1], along[0]]), length)


def to_edges(points: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors to points (n, d) from the nearest points of edges (m, 2, d): (n, m, d); and the parts
    of the edges at which these are: (n, m)."""
    span = edges[:, 1] - edges[:, 0]
    to = points[:, None] - edges[:, 0]
    share = np.clip((to * span).sum(axis=2) / (span**2).sum(axis=1), 0.0, 1.0)
    return to - share[..., None] * span, share


def both_sides(
    point: Sequence[float], normal: np.ndarray, size: float
) -> tuple[list[float], list[float]]:
    """Points below and above one on a crack of some size, by the crack's normal there."""
    across = 1e-3 * size * upwards(normal) * normal / np.linalg.norm(normal)
    return np.round(point - across, 9).tolist(), np.round(point + across, 9).tolist()


def upwards(normal: np.ndarray) -> float:
    """1 where a normal points up: along y, or else along x, or else along z; otherwise -1."""
    for axis in (1, 0, 2)[: len(normal)]:
        if abs(normal[axis]) > COINCIDENT * np.abs(normal).max():
            return float(np.sign(normal[axis]))
    return 1.0


def find_lips(lower: np.ndarray, upper: np.ndarray, positions: np.ndarray) -> tuple[Lip, ...]:
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
    tips = set(shared.tolist())
    lips = []
    for chain in _chains(lower.tolist(), tips, positions):
        first, last = (tuple(positions[chain[end]]) for end in (0, -1))
        mouths = chain[0] not in tips, chain[-1] not in tips
        turned = last < first if mouths[0] == mouths[1] else mouths[1]
        points = positions[chain[::-1] if turned else chain]
        lips.append(Lip(points, any(mouths)))
    return tuple(sorted(lips, key=lambda lip: tuple(lip.points[0, ::-1])))


def _chains(edges: list[tuple[int, int]], tips: set[int], positions: np.ndarray) -> list[list[int]]:
    """Edges put together to chains of nodes, which end at tips and mouths."""
    edges_at = defaultdict(list)
    for number, corners in enumerate(edges):
        for node in corners:
            edges_at[node].append(number)
    ends = {node for node, touching in edges_at.items() if len(touching) == 1} | tips
    for node, touching in edges_at.items():
        if len(touching) > 2 and node not in tips:
            place = "({:g}, {:g})".format(*positions[node])
            allowed = "cracks that neither branch nor cross, as one of them does here"
            raise InputError("lips", f"{len(touching)} edges of a crack face at {place}", allowed)
    unused, chains = set(range(len(edges))), []
    for start in ends:
        for edge in edges_at.get(start, ()):
            chain = [start]
            while edge in unused:
                unused.remove(edge)
                one, other = edges[edge]
                chain.append(other if one == chain[-1] else one)
                if chain[-1] not in ends:
                    edge = next(e for e in edges_at[chain[-1]] if e != edge)
            if len(chain) > 1:
                chains.append(chain)
    if unused:
        allowed = "cracks with two ends; a closed curve would cut a piece out of the structure"
        raise InputError("lips", "a closed curve", allowed)
    return chains


def along(lips: Sequence[Any], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """On which crack points (n, dimension) lie, and their positions on it [m]: two arrays (n,)."""
    off, positions = np.array([lip.locate(points) for lip in lips]).transpose(1, 0, 2)
    crack = off.argmin(axis=0)
    return crack, positions[crack, np.arange(len(points))]


def connected(rows: np.ndarray) -> np.ndarray:
    """The part of each row of nodes, (n,) int: rows are of one where they share a node."""
    from scipy.sparse.csgraph import connected_components  # takes a while, for few meshes

    count, k = rows.shape
    at = np.repeat(np.arange(count), k), rows.ravel()
    touches = sparse.csr_matrix((np.ones(count * k), at))
    return np.asarray(connected_components(touches @ touches.T)[1])


def each_once(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the first places of different rows of nodes, in any order, and their counts; and the
    index among them of each row (n,)."""
    _, first, which, uses = np.unique(
        np.sort(rows, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    return first, which.ravel(), uses


def rows_in(rows: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return True for each row of nodes, in any order, that is among others: (n,) bool."""
    _, kinds, _ = each_once(np.concatenate([others, rows]))
    return np.asarray(np.isin(kinds[len(others) :], kinds[: len(others)]))
