"""Stress intensity along fronts of cracks in solids, as a linear functional of the displacement.

The front is a curve c(t): an ellipse where its nodes lie on one, else a cubic spline over their
distance along it. Seen from a point of it xi is ahead, y across the crack and s along the front, in
a frame e_1, e_2, e_3, with kappa its curvature (positive where the crack is convex), g = 1 + kappa
xi. With the plane fields a = a_i(xi, y) e_i of unit K_I, K_II (plane strain) or K_III, of gradient

    a_i,1 = d_xi a_i,   a_i,2 = d_y a_i,   a_1,3 = -kappa a_3 / g,   a_3,3 = kappa a_1 / g,

their stress S = C sym grad a, and the extension Q = q(r / R) h(s) e_1 of the front, the interaction
integral (Nakamura, Parks, International Journal of Solids and Structures 25, 1989, 1411; on curved
fronts Gosz, Moran, Engineering Fracture Mechanics 69, 2002, 299) is

    I = int [sigma(u)_ij a_i,k Q_k,j + S_ij u_i,k Q_k,j - sigma(u) : grad a div Q] dV
        + int [(div S)_i u_i,1 + rho u''_i a_i,1] Q_1 dV
        - int [(S m)_i u_i,1 - S : grad u m_1] Q_1 dA
        + (2 / pi)^1/2 2 (1 - nu^2) / E int p Q_1 r^-1/2 dA,

with the outward normal m of the surface and of the crack faces, on which the contact presses with
p; and K_I = E / (2 (1 - nu^2)) I / int h ds, so K_II, and K_III = mu I / int h ds.

Inertia and all other forces inside act as forces at nodes: with w the values of Q_1 a_,1 there,
what they do is -w . (K u + B lambda), so that I is linear in the displacement and the contact
forces.

K_I at a front that is closed is zero: triangles at the front are mapped to the curve for that, and
the pressure is the one of the contact's patches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree
from scipy.special import roots_jacobi

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.basics.tables import quantity
from fenics_crack.fem.cracks import POSITION_TOLERANCE, CrackSurface, upward_sign
from fenics_crack.model.nodes import Nodes
from fenics_crack.model.receptance import check_matrices
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene

ELEMENTS = 2.0
"""Radius of the domain, in elements of the front: less is noise, more has less of the place."""
OVER_CURVATURE = 0.6
"""Largest radius of the domain over the front's radius of curvature: at 1 normals meet."""
ROOM = 0.8
"""Largest radius over the distance to the clamp or another crack."""
LONGEST = 1.25
"""Largest length of an element over the radius: K is off by up to 20 % there, as that of the
coarser mesh of a stated error may be."""
INNER = 0.2
"""Fraction of the radius up to which q is 1."""
GAUSS, AWAY = 6, 5
"""Points along each direction of a cell at the front, where 4 are noise of 1 to 3 %, and of others,
where 5 change K by 0.1 %, and 4 by 0.3 %."""
WIDTH = 3
"""Least edges of the front between two stations: a hat has four nodes or more."""
STATIONS = 12
"""Most intervals between stations of a front; twice as many of a closed one."""
CORNER = np.pi / 4.0
"""Angle between two edges of a front at which it is not smooth [rad]."""
AT_ONCE = 100_000
"""Points of a quadrature that are in memory at a time."""


@dataclass(frozen=True)
class Front:
    """A smooth part of the front of a crack.

    Attributes
    ----------
    name : str
        "the crack front"; of several "the crack front 2".
    crack : int
        Number of the crack, from 0.
    nodes : (n, 3) [m]
        Corners of elements on it, in turn; of a closed one the first is also the last.
    across : (n, 3)
        Normals of the crack there, from the lower to the upper face.
    at : (n,)
        Parameter t of the nodes: the angle of an ellipse [rad], or the distance along it [m].
    curve : callable
        c(t) and its derivatives of an order, (..., 3).
    closed : bool
        True if it has no ends.
    at_surface : tuple of bool
        True of an end at the surface of the solid: at others it has a corner.
    limit : float [m]
        Largest radius of the domain.
    """

    name: str
    crack: int
    nodes: np.ndarray
    normals: np.ndarray
    parameters: np.ndarray
    curve: Callable[[np.ndarray, int], np.ndarray]
    is_closed: bool
    at_surface: tuple[bool, bool]
    max_radius: float

    @cached_property
    def peak_parameters(self) -> np.ndarray:
        """Parameters of the hats' peaks, that of a closed front's first one at the end, too. One is
        in the middle, where a half-ellipse is deepest."""
        count = max(1, min(STATIONS * (1 + self.is_closed), (len(self.nodes) - 1) // WIDTH))
        count -= count % 2 if count > 1 and not self.is_closed else 0
        return np.linspace(
            self.parameters[0], self.parameters[-1], max(count, 3 if self.is_closed else 1) + 1
        )

    @property
    def station_parameters(self) -> np.ndarray:
        """Parameters of the stations."""
        return self.peak_parameters[:-1] if self.is_closed else self.peak_parameters

    @property
    def corner_stations(self) -> list[int]:
        """Stations at corners, where nothing is known."""
        count = len(self.station_parameters)
        ends = zip(self.at_surface, (0, count - 1), strict=True)
        return [] if self.is_closed else [place for surface, place in ends if not surface]

    def hats(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Hats and their derivatives by t: (..., n_stations) each."""
        step = self.peak_parameters[1] - self.peak_parameters[0]
        off = (t[..., None] - self.station_parameters) / step
        if self.is_closed:
            off -= len(self.station_parameters) * np.round(off / len(self.station_parameters))
        hat = np.maximum(0.0, 1.0 - np.abs(off))
        return hat, np.where(hat > 0.0, -np.sign(off) / step, 0.0)

    def lengths(self) -> np.ndarray:
        """int h ds of each hat: (n_stations,) [m]."""
        x, w = np.polynomial.legendre.leggauss(8)
        half = 0.5 * (self.peak_parameters[1] - self.peak_parameters[0])
        t = (self.peak_parameters[:-1, None] + half * (1.0 + x)).ravel()
        speed = np.linalg.norm(self.curve(t, 1), axis=1) * np.tile(
            half * w, len(self.peak_parameters) - 1
        )
        return np.asarray(speed @ self.hats(t)[0])

    def frame(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The frame (..., 3, 3), its rows e_1, e_2, e_3; ds/dt, kappa and d kappa / ds."""
        one, two, three = (self.curve(t, order) for order in (1, 2, 3))
        speed = np.linalg.norm(one, axis=-1)
        along = one / speed[..., None]
        across = np.stack([np.interp(t, self.parameters, row) for row in self.normals.T], axis=-1)
        across -= (across * along).sum(-1, keepdims=True) * along
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        ahead = np.cross(across, along)
        bend = -(two * ahead).sum(-1) / speed**2
        slope = -(three * ahead).sum(-1) / speed**3
        slope -= 3.0 * bend * (one * two).sum(-1) / speed**3
        return np.stack([ahead, across, along], axis=-2), speed, bend, slope

    @cached_property
    def straight_radius(self) -> float:
        """R [m] where the front is straight."""
        longest = np.linalg.norm(np.diff(self.nodes, axis=0), axis=1).max()
        return float(min(ELEMENTS * longest, self.max_radius))

    def is_limited_by_curvature(self, bend: np.ndarray) -> np.ndarray:
        """True where R follows the curvature."""
        return np.asarray(np.abs(bend) * self.straight_radius > OVER_CURVATURE)

    def radius(self, bend: np.ndarray) -> np.ndarray:
        """R [m] by the curvature."""
        limited = self.is_limited_by_curvature(bend)
        return np.where(
            limited, OVER_CURVATURE / np.where(limited, np.abs(bend), 1.0), self.straight_radius
        )

    @cached_property
    def _samples(self) -> tuple[np.ndarray, cKDTree]:
        t = np.interp(
            np.linspace(0, len(self.parameters) - 1, 8 * len(self.parameters)),
            range(len(self.parameters)),
            self.parameters,
        )
        return t, cKDTree(self.curve(t, 0))

    def project(self, points: np.ndarray) -> np.ndarray:
        """Parameters of the nearest points of the curve to some (..., 3)."""
        samples, tree = self._samples
        t = samples[tree.query(points)[1]]
        for _ in range(3):  # of Newton's steps
            place, one, two = (self.curve(t, order) for order in range(3))
            to = points - place
            t = t + (to * one).sum(-1) / ((one * one).sum(-1) - (to * two).sum(-1))
            if not self.is_closed:
                t = np.clip(t, self.parameters[0], self.parameters[-1])
        if self.is_closed:
            t = self.parameters[0] + np.mod(
                t - self.parameters[0], self.parameters[-1] - self.parameters[0]
            )
        return np.asarray(t)


@dataclass(frozen=True)
class Station:
    """A place on a crack front at which stress intensities are known.

    Attributes
    ----------
    name : str
        "the crack front at 3.2 mm".
    crack : int
        Number of the crack, from 0.
    point, ahead : (3,) [m], (3,)
        Where it is, and the direction in which the crack would grow straight on.
    position : float [m]
        Its distance along the front.
    touching : (k,) int
        Contact pairs whose patches touch the front within its hat: while all of them are closed, so
        is the crack there.
    """

    name: str
    crack: int
    point: np.ndarray
    growth_direction: np.ndarray
    position: float
    touching_pairs: np.ndarray


# --- where they are -------------------------------------------------------------------------------


def find_fronts(structure: Structure) -> list[Front]:
    """The fronts of all cracks of a solid (collective).

    Raises
    ------
    InputError
        A front is too short for its elements.
    """
    nodes = structure.nodes
    assert nodes is not None
    lips: tuple[CrackSurface, ...] = nodes.numbered.plate.cracks
    held = gather_rows(structure.comm, nodes.points[np.all(nodes.dofs < 0, axis=1)])
    found = []
    for crack, lip in enumerate(lips):
        others = [other.triangles.reshape(-1, 3) for other in lips if other is not lip]
        away = cKDTree(np.concatenate([held, *others]))
        for chain, normals, closed, ends in _chains(lip):
            limit = ROOM * away.query(chain)[0].min()
            found.append((crack, chain, normals, *_curve(chain, closed), closed, ends, limit))
    return [
        Front("the crack front" + (f" {number + 1}" if len(found) > 1 else ""), *one)
        for number, one in enumerate(found)
    ]


def _chains(lip: CrackSurface) -> Iterator[tuple[np.ndarray, np.ndarray, bool, tuple[bool, bool]]]:
    """Yield the smooth parts of a crack's front: nodes, normals, whether it is closed, and which
    ends are at the surface."""
    corners = lip.triangles.reshape(-1, 3)
    unit = POSITION_TOLERANCE * lip.size
    tree = cKDTree(corners)
    edges = np.sort(tree.query(lip.front.reshape(-1, 3))[1].reshape(-1, 2), axis=1)
    links: dict[int, list[int]] = {}
    first_of = np.array([min(tree.query_ball_point(x, unit)) for x in corners[edges.ravel()]])
    for a, b in first_of.reshape(-1, 2):
        links.setdefault(int(a), []).append(int(b))
        links.setdefault(int(b), []).append(int(a))
    spans = lip.triangles[:, 1:] - lip.triangles[:, :1]
    normal = np.cross(spans[:, 0], spans[:, 1])
    turned = np.array([upward_sign(row) for row in normal])
    normal *= turned[:, None]
    middles = lip.triangles.mean(axis=1)
    while links:
        start = min((k for k, ends in links.items() if len(ends) == 1), default=min(links))
        chain, closed = [start], len(links[start]) == 2
        while links.get(chain[-1]):
            after = links[chain[-1]].pop()
            links[after].remove(chain[-1])
            chain.append(after)
        for node in chain:
            links.pop(node, None)
        at = corners[chain]
        across, inward = np.empty_like(at), np.empty_like(at)
        for row, place in enumerate(at):
            touching = np.unique(np.array(tree.query_ball_point(place, unit)) // 3)
            across[row] = normal[touching].sum(axis=0)
            inward[row] = middles[touching].mean(axis=0) - place
        across /= np.linalg.norm(across, axis=1)[:, None]
        steps = np.diff(at, axis=0)
        ahead = np.cross(across[:-1] + across[1:], steps)
        if (ahead * (inward[:-1] + inward[1:])).sum() > 0.0:
            at, across, steps = at[::-1], across[::-1], -steps[::-1]
        steps /= np.linalg.norm(steps, axis=1)[:, None]
        before = np.roll(steps, 1, axis=0)
        sharp = np.flatnonzero((before * steps).sum(axis=1) < np.cos(CORNER)).tolist()
        if closed and sharp:
            turn = sharp[0]
            at, across = (np.concatenate([x[turn:-1], x[: turn + 1]]) for x in (at, across))
            sharp = [place - turn for place in sharp]
        for a, b in pairwise(sorted({0, *sharp, len(steps)})):
            ends = (a == 0 and not closed, b == len(steps) and not closed)
            yield at[a : b + 1], across[a : b + 1], closed and not sharp, ends


def _curve(
    nodes: np.ndarray, closed: bool
) -> tuple[np.ndarray, Callable[[np.ndarray, int], np.ndarray]]:
    """Parameters of nodes (n, 3) in turn, and the curve through them: the ellipse on which they
    lie, to POSITION_TOLERANCE of its size, or else a spline."""
    middle = nodes.mean(axis=0)
    _, sizes, axes = np.linalg.svd(nodes - middle, full_matrices=False)
    x, y = ((nodes - middle) @ axes[:2].T / sizes[0]).T
    if (
        len(nodes) > 5
        and sizes[1] > POSITION_TOLERANCE * sizes[0]
        and sizes[2] <= POSITION_TOLERANCE * sizes[0]
    ):
        conic = np.column_stack([x * x, 2.0 * x * y, y * y, -2.0 * x, -2.0 * y])
        a, b, c, d, e = np.linalg.lstsq(conic, np.ones(len(x)), rcond=None)[0]
        form = np.array([[a, b], [b, c]])
        if np.linalg.det(form) > 0.0:
            center = np.linalg.solve(form, [d, e])
            weights, turn = np.linalg.eigh(form / (1.0 + center @ form @ center))
            at = (np.column_stack([x, y]) - center) @ turn * np.sqrt(np.abs(weights))
            if np.all(weights > 0.0) and np.abs(np.linalg.norm(at, axis=1) - 1.0).max() < 1e-5:
                t = np.unwrap(np.arctan2(at[:, 1], at[:, 0]))
                sign = np.sign(t[-1] - t[0])
                half = sizes[0] * (turn / np.sqrt(weights)) @ np.diag([1.0, sign])
                return sign * t, partial(
                    _ellipse, middle + sizes[0] * center @ axes[:2], half.T @ axes[:2]
                )
    steps = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    t = np.append(0.0, np.cumsum(steps))
    if len(nodes) == 2:
        nodes, t_of = (
            np.array([nodes[0], nodes.mean(axis=0), nodes[1]]),
            np.array([0, 0.5, 1]) * t[-1],
        )
    else:
        t_of = t
    spline = CubicSpline(t_of, nodes, bc_type="periodic" if closed else "not-a-knot")

    return t, lambda t, order: np.asarray(spline(t, order))


def _ellipse(center: np.ndarray, halves: np.ndarray, t: np.ndarray, order: int) -> np.ndarray:
    """Derivative of an order of center + halves[0] cos t + halves[1] sin t: (..., 3)."""
    angle = np.asarray(t)[..., None] + 0.5 * np.pi * order
    moved = np.cos(angle) * halves[0] + np.sin(angle) * halves[1]
    return np.asarray(moved + center if order == 0 else moved)


# --- rows -----------------------------------------------------------------------------------------


def front_functionals(
    scene: Scene, structure: Structure
) -> tuple[list[Station], np.ndarray, np.ndarray]:
    """The stations of all fronts, and what a displacement and the contact forces are multiplied by
    for K_I, K_II and K_III of one station after the other (collective).

    Parameters
    ----------
    scene : Scene
        A solid with a crack.
    structure : Structure
        Made from it, whole.

    Returns
    -------
    stations : list of Station
    of_displacement : (3 n_stations, n_local) [Pa m^1/2 / m]
    of_forces : (3 n_stations, n_pairs) [Pa m^1/2 / N]

    Raises
    ------
    InputError
        Cells are no tetrahedra of second order; or the elements at a front are longer than what is
        integrated over.
    """
    check_matrices(structure, "stress intensities")
    nodes, comm = structure.nodes, structure.comm
    assert nodes is not None
    if scene.mesh.order != 2 or comm.allreduce(nodes.cells.shape[1]) != 10 * comm.size:
        raise InputError("mesh", "other cells", "tetrahedra of order 2, for stress intensities")
    points, cells = gather_rows(comm, nodes.points), gather_rows(comm, nodes.cells)
    stations: list[Station] = []
    rows: list[np.ndarray] = []
    pressed: list[np.ndarray] = []
    for front in find_fronts(structure):
        _check_resolved(front)
        rule = _Domain(scene, front, points, cells)
        row, field = (_own_part(nodes, rule.nodes, x) for x in rule.rows(comm))
        forces = np.zeros((len(row), structure.n_pairs))
        if structure.pairs.nodes is not None:
            forces -= rule.scale[:, None] * structure.apply_bt(field)
            forces[: len(front.station_parameters)] += _of_pressures(structure, front)
        stated = [
            place
            for place in range(len(front.station_parameters))
            if place not in front.corner_stations
        ]
        for parts, values in ((rows, row), (pressed, forces)):
            parts.append(_by_station(front, values)[stated].reshape(3 * len(stated), -1))
        stations += [_stations(structure, front)[place] for place in stated]
    return stations, np.concatenate(rows), np.concatenate(pressed)


def _own_part(nodes: Nodes, numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
    """This rank's free dofs (n, n_local) of values (m, n, 3) at nodes by their numbers, 0 at
    others."""
    places = numbers - nodes.numbered.first_node
    own = (places >= 0) & (places < nodes.numbered.n_nodes)
    found = np.zeros((values.shape[1], nodes.numbered.n_nodes, 3))
    found[:, places[own]] = values[own].swapaxes(0, 1)
    return np.asarray(nodes.numbered.free_part(found.reshape(len(found), -1)))


def _stations(structure: Structure, front: Front) -> list[Station]:
    pairs, hats = structure.pairs, front.hats(front.parameters)[0] > 0.0
    touching = [np.zeros(0, dtype=int)] * len(front.station_parameters)
    if pairs.nodes is not None and pairs.shares is not None:
        on = cKDTree(pairs.nodes).query(front.nodes)[1]
        touching = [np.unique(pairs.shares[on[hat]].nonzero()[1]) for hat in hats.T]
    fine = np.linspace(front.parameters[0], front.parameters[-1], 50 * len(front.peak_parameters))
    along = np.append(0.0, np.linalg.norm(np.diff(front.curve(fine, 0), axis=0), axis=1).cumsum())
    positions = np.interp(front.station_parameters, fine, along)
    points, ahead = (
        front.curve(front.station_parameters, 0),
        front.frame(front.station_parameters)[0][:, 0],
    )
    return [
        Station(f"{front.name} at {quantity(float(s), 'm')}", front.crack, x, e, float(s), own)
        for x, e, s, own in zip(points, ahead, positions, touching, strict=True)
    ]


def _check_resolved(front: Front) -> None:
    """Raise InputError where the domain is smaller than an element by more than LONGEST."""
    lengths = np.linalg.norm(np.diff(front.nodes, axis=0), axis=1)
    radius = front.radius(front.frame(0.5 * (front.parameters[1:] + front.parameters[:-1]))[2])
    worst = (lengths / radius).argmax()
    if lengths[worst] > LONGEST * radius[worst]:
        most = LONGEST * radius[worst]
        place = ", ".join(f"{x:.4g}" for x in front.nodes[worst])
        allowed = f"no longer than {most:.3g} m along the front in ({place}) m"
        raise InputError("mesh", f"elements of {lengths[worst]:.3g} m", allowed)


def _by_station(front: Front, rows: np.ndarray) -> np.ndarray:
    """Rows (3 n_stations, m) of hats by stations, (n_stations, 3, m): those at the ends of a front
    are on the line through the last two, which are of the places of their hats' middles."""
    rows = rows.reshape(3, len(front.station_parameters), -1).swapaxes(0, 1)
    if not front.is_closed and len(front.station_parameters) > 2:
        first, last = (1.5 * rows[end] - 0.5 * rows[beside] for end, beside in ((0, 1), (-1, -2)))
        rows = np.concatenate([first[None], rows[1:-1], last[None]])
    return rows


def _weight(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """q and its derivative by r / R."""
    x = np.clip((share - INNER) / (1.0 - INNER), 0.0, 1.0)
    slope = -30.0 * x**2 * (1.0 - x) ** 2 / (1.0 - INNER)
    return 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2), slope


def _collapsed(dimension: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric coordinates (count^d, d + 1) and weights, of sum 1, of Gauss's points in a
    simplex that is collapsed at its first corner."""
    left, weights = np.ones(1), np.ones(1)
    coordinates: list[np.ndarray] = []
    for power in range(dimension - 1, -1, -1):
        x, w = roots_jacobi(count, power, 0)
        x, w = 0.5 * (1.0 + x), w / w.sum()
        coordinates = [np.repeat(row, count) for row in coordinates]
        coordinates.append((left[:, None] * x).ravel())
        left, weights = (left[:, None] * (1.0 - x)).ravel(), (weights[:, None] * w).ravel()
    return np.column_stack([*coordinates, left]), weights


def _chunks(cells: np.ndarray, points: int) -> list[np.ndarray]:
    """Cells with so many points each, AT_ONCE or fewer at a time."""
    return np.array_split(cells, 1 + len(cells) * points // AT_ONCE)


EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Edges of a tetrahedron on which its other nodes are, in VTK's order."""


class _Domain:
    """The integral around a front over the cells that are near."""

    def __init__(self, scene: Scene, front: Front, points: np.ndarray, cells: np.ndarray) -> None:
        self.front = front
        young, self.nu = scene.material.young, scene.material.poisson
        self.mu = 0.5 * young / (1.0 + self.nu)
        self.lame = young * self.nu / (1.0 + self.nu) / (1.0 - 2.0 * self.nu)
        plane = 0.5 * young / (1.0 - self.nu**2)
        of_mode = np.repeat([plane, plane, self.mu], len(front.station_parameters))
        self.scale = of_mode / np.tile(front.lengths(), 3)
        away = front._samples[1].query(points)[0][cells]
        # Of others no more than rounded edges is inside, where q is 1e-5.
        kept = away.min(axis=1) < front.straight_radius
        self.nodes, numbers = np.unique(cells[kept], return_inverse=True)
        self.points, self.cells = points[self.nodes], numbers.reshape(-1, cells.shape[1])
        corners = self.points[self.cells[:, :4]]
        # From the nearest to the front on; those as near by place: rounding and numbers differ on
        # other ranks, and the rule of an edge on the front takes its ends in turn.
        places = np.dstack([corners, away[kept, :4]]).transpose(2, 0, 1)
        self.order = order = np.lexsort(
            np.round(places / (POSITION_TOLERANCE * front.straight_radius)), axis=-1
        )
        self.corners = np.take_along_axis(corners, order[..., None], axis=1)
        number = np.take_along_axis(self.cells[:, :4], order, axis=1)
        facets = [np.sort(np.delete(number, k, axis=1), axis=1) for k in range(4)]
        keys = np.ravel_multi_index(np.concatenate(facets).T, (len(self.points),) * 3)
        _, first, uses = np.unique(keys, return_index=True, return_counts=True)
        self.outside = np.isin(keys, keys[first[uses == 1]]).reshape(4, -1).T
        spans = self.corners[:, 1:] - self.corners[:, :1]
        self.volume = np.abs(np.linalg.det(spans)) / 6.0
        inverse = np.linalg.inv(spans).swapaxes(1, 2)  # rows: gradients of the coordinates 1 to 3
        self.gradients = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        middles = self.corners.mean(axis=1)
        t = front.project(middles)
        self.side = np.sign(((middles - front.curve(t, 0)) * front.frame(t)[0][:, 1]).sum(-1))

    def _basis(self, some: np.ndarray) -> np.ndarray:
        """D of grad N_a = sum_b D_ab lambda_b of cells: (n, 10, 4, 3), in the nodes' own order."""
        back = self.order[some].argsort(axis=1)
        slopes = np.take_along_axis(self.gradients[some], back[..., None], axis=1)
        found = np.zeros((len(some), 10, 4, 3))
        for a in range(4):
            found[:, a] = -slopes[:, a, None]
            found[:, a, a] += 4.0 * slopes[:, a]
        for number, (a, b) in enumerate(EDGES):
            found[:, 4 + number, a] = 4.0 * slopes[:, b]
            found[:, 4 + number, b] = 4.0 * slopes[:, a]
        return np.take_along_axis(found, self.order[some][:, None, :, None], axis=2)

    def rows(self, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
        """The rows at nodes, of which each rank integrates a share, and w: (n, 3 n_stations, 3)
        (collective)."""
        count = 3 * len(self.front.station_parameters)
        found, fields = np.zeros((2, len(self.points), count, 3))
        for some in _chunks(np.arange(len(self.cells)), 10):
            fields[self.cells[some]] = self._nodal(some)
        at_front = (
            cKDTree(self.front.nodes).query(self.corners[:, 0])[0]
            < POSITION_TOLERANCE * self.front.straight_radius
        )
        groups = (np.flatnonzero(at_front), GAUSS), (np.flatnonzero(~at_front), AWAY)
        for some, points in (
            (chunk, number)
            for its, number in groups
            for chunk in _chunks(its[comm.rank :: comm.size], number**3)
        ):
            (rule, weights), (flat, planar) = (_collapsed(n, points) for n in (3, 2))
            parts = self._moments(some, rule, self.volume[some, None] * weights, None)
            for k in range(4):
                out = self.outside[some, k]
                if np.any(out):
                    on = np.insert(flat, k, 0.0, axis=1)
                    slope = self.gradients[some[out], k]
                    area = 3.0 * self.volume[some[out]] * np.linalg.norm(slope, axis=1)
                    normal = -slope / np.linalg.norm(slope, axis=1)[:, None]
                    parts[out] += self._moments(some[out], on, area[:, None] * planar, normal)
            basis = self._basis(some).reshape(len(some), 10, 12)
            at = fields[self.cells[some]].reshape(len(some), 10, -1).swapaxes(1, 2)
            moved = self._stress((at @ basis).reshape(len(some), -1, 3, 4, 3).swapaxes(2, 3))
            mass = self.volume[some, None, None, None, None] / 20.0
            parts -= mass * (moved + moved.sum(axis=2, keepdims=True))
            parts = parts.swapaxes(2, 3).reshape(len(some), -1, 12)
            each = basis @ parts.swapaxes(1, 2)
            np.add.at(found, self.cells[some], each.reshape(len(some), 10, count, 3))
        return self.scale[:, None] * comm.allreduce(found), fields

    def _stress(self, gradient: np.ndarray) -> np.ndarray:
        """C sym of gradients (..., 3, 3)."""
        found = self.mu * (gradient + gradient.swapaxes(-1, -2))
        spread = self.lame * np.trace(gradient, axis1=-2, axis2=-1)
        for k in range(3):
            found[..., k, k] += spread
        return found

    def _around(self, places: np.ndarray, some: np.ndarray) -> tuple[np.ndarray, ...]:
        """Frames, xi, y, r, hats and their derivatives by s, kappa, its derivative, R of places of
        cells: (n, m, ...)."""
        front = self.front
        t = front.project(places)
        frame, speed, bend, slope = front.frame(t)
        to = places - front.curve(t, 0)
        xi, y = ((to * frame[..., k, :]).sum(-1) for k in range(2))
        radius = front.radius(bend)
        r = np.hypot(xi, y)
        y = np.where(np.abs(y) < 1e-6 * r, 1e-12 * r * self.side[some][:, None], y)
        hat, by_t = front.hats(t)
        return frame, xi, y, r, hat, by_t / speed[..., None], bend, slope, radius

    def _nodal(self, some: np.ndarray) -> np.ndarray:
        """Return w of cells, 0 on the front and on its edges, which lie behind the curve and have
        no side: (n, 10, 3 n_stations, 3)."""
        places = self.points[self.cells[some]]
        frame, xi, y, r, hat, _, _, _, radius = self._around(places, some)
        at_front = r < 1e-6 * radius
        at_front[:, 4:] = at_front[:, np.array(EDGES)].all(axis=2)
        r = np.where(at_front, radius, r)
        q = np.where(at_front, 0.0, _weight(r / radius)[0])
        fields = []
        for mode in range(3):
            _, ahead, _ = self._plane(mode, xi, y, r)
            moved = np.einsum("icp,cpij->cpj", ahead, frame) * q[..., None]
            fields.append(hat[..., None] * moved[..., None, :])
        return np.concatenate(fields, axis=2)

    def _plane(self, mode: int, xi: np.ndarray, y: np.ndarray, r: np.ndarray) -> Any:
        """The field of unit K of a mode and its derivatives by xi and y: (3, ...) each."""
        half = 0.5 * np.arctan2(y, xi)
        c, s, cosine, sine = np.cos(half), np.sin(half), xi / r, y / r
        kappa, none = 3.0 - 4.0 * self.nu, np.zeros_like(r)
        if mode == 0:
            f = np.array([c * (kappa - cosine), s * (kappa - cosine), none])
            by = np.array([
                -0.5 * s * (kappa - cosine) + c * sine, 0.5 * c * (kappa - cosine) + s * sine, none
            ])  # fmt: skip
        elif mode == 1:
            f = np.array([s * (kappa + 2.0 + cosine), -c * (kappa - 2.0 + cosine), none])
            by = np.array([
                0.5 * c * (kappa + 2.0 + cosine) - s * sine,
                0.5 * s * (kappa - 2.0 + cosine) + c * sine, none,
            ])  # fmt: skip
        else:
            f, by = np.array([none, none, 4.0 * s]), np.array([none, none, 2.0 * c])
        scale = 0.5 / self.mu / np.sqrt(2.0 * np.pi)
        root = np.sqrt(r)
        return (
            scale * root * f,
            scale / root * (0.5 * cosine * f - sine * by),
            scale / root * (0.5 * sine * f + cosine * by),
        )

    def _moments(
        self, some: np.ndarray, rule: np.ndarray, weights: np.ndarray, normal: np.ndarray | None
    ) -> np.ndarray:
        """Integrals of lambda_b T, T being what grad u is multiplied by in the domain, or on its
        surface with an outward normal: (n, 3 n_stations, 4, 3, 3)."""
        places = rule @ self.corners[some]
        frame, xi, y, r, hat, by_s, bend, slope, radius = self._around(places, some)
        if normal is not None:  # A chord of a concave front has crack faces ahead of the curve.
            xi = np.where(np.abs(y) < 1e-9 * r, -r, xi)
        q, fall = _weight(r / radius)
        fall /= radius
        g = 1.0 + bend * xi
        k = bend / g
        limited = self.front.is_limited_by_curvature(bend)
        shrink = np.where(limited, -slope / np.where(limited, bend, 1.0), 0.0)
        ahead = np.stack([fall * xi / r, fall * y / r, -fall * r * shrink / g], axis=-1)
        spread = weights[..., None] * rule
        found = []
        for mode in range(3):
            a, one, two = self._plane(mode, xi, y, r)
            gradient = np.zeros((*r.shape, 3, 3))
            gradient[..., 0], gradient[..., 1] = np.moveaxis(one, 0, -1), np.moveaxis(two, 0, -1)
            gradient[..., 0, 2], gradient[..., 2, 2] = -k * a[2], k * a[0]
            stress = self._stress(gradient)
            if normal is not None:
                m = np.einsum("cpij,cj->cpi", frame, normal)
                whole = q[..., None, None] * m[..., 0, None, None] * stress
                whole[..., 0] -= q[..., None] * (stress @ m[..., None])[..., 0]
                parts = [(hat, whole)]
            else:
                parts = self._inside(
                    a, one, two, gradient, stress, (q, ahead, g, k, slope, hat, by_s)
                )
            total: Any = 0.0
            for shape, tensor in parts:
                turned = frame.swapaxes(-1, -2) @ tensor @ frame
                values = spread[..., None] * turned.reshape(*r.shape, 1, 9)
                values = values.reshape(*r.shape, 36)
                total = total + shape.swapaxes(-1, -2) @ values
            found.append(total.reshape(len(some), -1, 4, 3, 3))
        return np.concatenate(found, axis=1)

    def _inside(
        self, a: np.ndarray, one: np.ndarray, two: np.ndarray, gradient: np.ndarray,
        stress: np.ndarray, around: tuple[np.ndarray, ...],
    ) -> list[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
        """T of the volume as hats times one tensor, and their derivatives times another."""
        q, ahead, g, k, slope, hat, by_s = around
        qk = (q * k)[..., None]
        whole = gradient[..., :, :1] * ahead[..., None, :]
        whole[..., 2] += gradient[..., 2] * qk
        whole = self._stress(whole) - (ahead[..., :1] + qk)[..., None] * stress
        whole[..., 0] += (stress @ ahead[..., None])[..., 0]
        whole[..., 2] += stress[..., 2] * qk
        bent = np.zeros_like(gradient)
        bent[..., 0, 2], bent[..., 2, 2] = -a[2] / g**2, a[0] / g**2
        force = (slope / g)[..., None] * self._stress(bent)[..., 2]
        force[..., 0] += k * (stress[..., 0, 0] - stress[..., 2, 2])
        force[..., 0] += self.lame * k * (one[0] - k * a[0])
        force[..., 1] += k * stress[..., 1, 0] + self.lame * k * two[0]
        force[..., 2] += 2.0 * k * stress[..., 2, 0] - self.mu * k * (one[2] - k * a[2])
        whole[..., 0] += q[..., None] * force
        along = np.zeros_like(gradient)
        along[..., 2] = gradient[..., 0] * (q / g)[..., None]
        along = self._stress(along)
        along[..., 0] += stress[..., 2] * (q / g)[..., None]
        return [(hat, whole), (by_s, along)]


def _of_pressures(structure: Structure, front: Front) -> np.ndarray:
    """Factors of the contact forces in K_I, (n_stations, n_pairs), by their pressures."""
    pairs = structure.pairs
    assert pairs.nodes is not None and pairs.shares is not None and pairs.areas is not None
    lip: CrackSurface = structure.nodes.numbered.plate.cracks[front.crack]  # type: ignore[union-attr]
    tree, own = cKDTree(pairs.nodes), cKDTree(front.nodes)
    far, at = own.query(lip.triangles)
    reach = np.linalg.norm(lip.triangles - lip.triangles.mean(axis=1)[:, None], axis=2).max(axis=1)
    near = far.min(axis=1) < front.straight_radius + 2.0 * reach
    found = np.zeros((len(front.station_parameters), len(pairs.nodes)))
    rule, planar = _collapsed(2, GAUSS)
    x, w = np.polynomial.legendre.leggauss(2 * GAUSS)
    x, w = 0.5 * (1.0 + x), 0.5 * w
    z, tau = (row.ravel() for row in np.meshgrid(x, x, indexing="ij"))
    product, v = 2.0 * z * np.outer(w, w).ravel(), z**2
    mapped = np.column_stack([v, (1.0 - v) * (1.0 - tau), (1.0 - v) * tau])
    for corners, away, place in zip(lip.triangles[near], far[near], at[near], strict=True):
        order = away.argsort()
        on = away < POSITION_TOLERANCE * lip.size
        if on.sum() == 2:
            order = np.append(np.flatnonzero(~on), np.flatnonzero(on))
            low, high = front.parameters[place[order[1:]]]
            if front.is_closed and abs(high - low) > 0.5 * (
                front.parameters[-1] - front.parameters[0]
            ):
                turn = front.parameters[-1] - front.parameters[0]
                low, high = low + turn * (low < high), high + turn * (high < low)
            t = low + tau * (high - low)
            to = corners[order[0]] - front.curve(t, 0)
            points = front.curve(t, 0) + v[:, None] * to
            spin = np.cross(to, (1.0 - v)[:, None] * front.curve(t, 1) * (high - low))
            area, shapes = product * np.linalg.norm(spin, axis=1), mapped
        else:
            points, shapes = rule @ corners[order], rule
            spans = corners[1:] - corners[0]
            area = 0.5 * np.linalg.norm(np.cross(*spans)) * planar
        t = front.project(points)
        r = np.linalg.norm(points - front.curve(t, 0), axis=1)
        radius = front.radius(front.frame(t)[2])
        kernel = _weight(r / radius)[0] / np.sqrt(r) * area
        numbers = tree.query(corners[order])[1]
        found[:, numbers] += front.hats(t)[0].T @ (kernel[:, None] * shapes)
    found *= np.sqrt(2.0 / np.pi) / front.lengths()[:, None]
    return np.asarray((pairs.shares.T @ found.T).T / pairs.areas)
