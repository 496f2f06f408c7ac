"""Dofs and contact pairs of a structure, where they are in a mesh, and what its clamp holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import Any, NoReturn

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.model.matrices import ReadOnlyArrays, numbers
from fenics_crack.numerics.fourier import evaluate

AXES = "xyz"


MAX_NODE_DISTANCE_RATIO = 0.05
"""Largest distance of a point from the mesh, whose nearest node is taken, over the mesh's size."""


@dataclass(frozen=True, eq=False)
class Nodes(ReadOnlyArrays):
    """Positions of the nodes that this rank owns, and their dofs; the arrays are read-only.

    Attributes
    ----------
    points : (m, d) [m]
        Positions: d = 2 in a plane, 3 in space.
    dofs : (m, d) int
        Number of the x, y (and z) displacement in the structure; -1 where it is clamped.
    cells : (n_cells, k) int
        This rank's cells in VTK's node order; nodes are numbered through all ranks.
    vtk_type : int
        VTK's number of the cell type; 0: no cells of one kind.
    numbered : fenics_crack.fem.plate.Dofs or None
        DOLFINx's mesh and the dofs on it, for what is integrated over it later: ranks may share a
        mesh that is made again in another way. None where there is none.
    frames : (m, d, d) or None
        Of each node the matrix that turns its displacements into those in space; None: they are.
    """

    points: np.ndarray
    dofs: np.ndarray
    cells: np.ndarray
    vtk_type: int
    mesh_dofs: Any = None
    frames: np.ndarray | None = None

    def find_nearest(
        self, comm: MPI.Comm, key: str, point: Sequence[float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Position of the node nearest to a point, and its dofs (d,), -1 where clamped
        (collective).

        Raises
        ------
        InputError
            The point, called ``key``, is away from the mesh by more than 5 % of its size, or the
            nearest node is clamped or is two nodes, on the crack faces.
        """
        points, dofs = gather_rows(comm, self.points), gather_rows(comm, self.dofs)
        distance, size = np.linalg.norm(points - point, axis=1), np.ptp(points, axis=0).max()
        place = int(np.argmin(distance))
        shown = tuple(map(float, point))
        there = describe_nearest_node(points, point)
        if distance[place] > MAX_NODE_DISTANCE_RATIO * size:
            raise InputError(key, shown, f"on the mesh ({there})")
        if len(find_nodes_at(points, points[place])) > 1:
            raise InputError(key, shown, f"near a node that exists once, not on a face ({there})")
        if np.all(dofs[place] < 0):
            raise InputError(key, shown, f"near a node that is free to move ({there})")
        return points[place], dofs[place]


def find_nodes_at(points: np.ndarray, point: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the indices of nodes, ``points`` (n, d), at a point, to 1e-6 of the mesh's size."""
    near = 1e-6 * np.ptp(points, axis=0).max()
    return np.flatnonzero(np.linalg.norm(points - point, axis=1) <= near)


def describe_nearest_node(points: np.ndarray, point: Sequence[float] | np.ndarray) -> str:
    """Return the place of the node nearest to ``point``, of ``points`` (n, d), in words."""
    nearest = points[np.argmin(np.linalg.norm(points - point, axis=1))]
    return f"the nearest node is at {format_point(nearest)}"


def format_point(point: np.ndarray, digits: str = ".8g") -> str:
    """A point in words, "(0.1, 0.1)"; its digits identify a node for :func:`nodes_at`."""
    return f"({', '.join(format(x, digits) for x in point.round(12) + 0.0)})"  # no -1e-19


@dataclass(frozen=True, eq=False)
class Pairs(ReadOnlyArrays):
    """Places of the contact pairs of a structure, crack by crack; the arrays are read-only.

    Attributes
    ----------
    points : (n_pairs, d) [m] or None
        Positions.
    areas : (n_pairs,) [m^2] or None
        Area of the face that belongs to each pair.
    cracks : (n_pairs,) int or None
        Number of the crack, from 0.
    positions : (n_pairs,) [m] or None
        Distance along the crack from its mouth, or from the left tip of a crack inside; of a solid
        from the front.
    places : dict of str to int
        A pair to watch on each crack, by its name: "the mouth"; of several cracks "the mouth of
        crack 1", "the middle of crack 2".
    nodes : (n, d) [m] or None
        Corners of the facets of a solid's crack faces, those on fronts at the end, ...
    shares : (n, n_pairs) scipy.sparse.csr_matrix or None
        ... and the values there of each pair's pressure function.
    tangents : (n_local, 2 n_pairs) or None
        Rows of the whole structure of tangential gaps along two directions of all pairs, of a
        solid: those along the first ones, then along the second ones.
    """

    points: np.ndarray | None = None
    areas: np.ndarray | None = None
    cracks: np.ndarray | None = None
    positions: np.ndarray | None = None
    places: dict[str, int] = field(default_factory=dict)
    nodes: np.ndarray | None = None
    shares: sparse.csr_matrix | None = None
    tangents: sparse.csr_matrix | None = None


def body_property(name: str) -> Any:
    """A property: the attribute of a structure that its body has by this name."""
    return property(attrgetter(f"body.{name}"))


class Coordinates:
    """Degrees of freedom and contact pairs of a structure: how many, where, and on which rank.

    Dofs are numbered through all ranks, of which each owns successive ones ("n_local"). None of the
    attributes can be set.

    Attributes
    ----------
    comm : MPI.Comm
        The ranks that share the structure.
    gap : scipy.sparse.csr_matrix
        B, the rows owned by this rank: (n_local, n_pairs).
    tangential : scipy.sparse.csr_matrix or None
        B_t, likewise: tangential gaps g_t = B_t^T u, of faces in a plane.
    force : (2K+1, n_local) [N]
        Mean of the load, then cosine and sine part of its harmonics 1 to K.
    nodes : Nodes or None
        Positions of the dofs where there is a mesh.
    pairs : Pairs
        Positions, areas and cracks of the contact pairs where there is a mesh.
    watched : (n_local,) or None
        Factors of a displacement in the watched motion [m]; None: the dof that
        carries most of the load.
    """

    body: Any
    setting: Any
    comm: MPI.Comm = body_property("comm")
    mass: Any = body_property("mass")
    gap: sparse.csr_matrix = body_property("gap")
    tangential: sparse.csr_matrix | None = body_property("tangential")
    force: np.ndarray
    nodes: Nodes | None = body_property("nodes")
    pairs: Pairs = body_property("pairs")
    pair_points: np.ndarray | None = body_property("pairs.points")
    """Positions of the contact pairs where there is a mesh: (n_pairs, d) [m]."""
    pair_areas: np.ndarray | None = body_property("pairs.areas")
    """Area of the face that belongs to each pair, where there is a mesh: (n_pairs,) [m^2]."""
    watched: np.ndarray | None = body_property("watched")

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"{name}: a structure cannot be changed; varied() and damped() make another one"
        )

    @property
    def _size_words(self) -> str:
        return f"{self.n_dofs} dofs"

    @property
    def drawable_nodes(self) -> Nodes | None:
        """The nodes, where they carry every dof and have cells to be drawn."""
        return self.nodes if self.nodes is not None and self.nodes.vtk_type else None

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom, without clamped ones."""
        return int(self.body.mass.size[0])

    @property
    def n_local(self) -> int:
        """Number of degrees of freedom that this rank owns."""
        return int(self.body.mass.local_size[0])

    @property
    def first_dof(self) -> int:
        """Number of the first degree of freedom that this rank owns."""
        return int(self.body.mass.owner_range[0])

    @property
    def n_pairs(self) -> int:
        """Number of contact pairs."""
        return int(self.gap.shape[1])

    @property
    def watched_pairs(self) -> dict[str, int]:
        """A pair of each crack by its place: "the mouth"; without a mesh the first, "pair 1"."""
        return self.pairs.places or ({"pair 1": 0} if self.n_pairs else {})

    @property
    def first_watched_pair(self) -> int:
        """The pair at the mouth of the first crack, or in the middle of one inside the plate."""
        return next(iter(self.watched_pairs.values()))

    @cached_property
    def watched_dof(self) -> int:
        """The dof of the whole structure that results are asked about where none is named: the
        first that the scene watches, else the load's (collective)."""
        whole = self.whole
        if self.setting.watched_dof is not None:
            return self.setting.watched_dof
        if whole is not self:
            return int(whole.watched_dof)
        if self.watched is None:
            return self.find_most_loaded_dof()
        return int(np.argmax(gather_rows(self.comm, np.abs(self.watched))))

    def find_most_loaded_dof(self) -> int:
        """The dof that carries most of the load, of all ranks' (collective)."""
        return int(np.argmax(gather_rows(self.comm, np.abs(self.body.force).max(axis=0))))

    def describe_pair(self, pair: int) -> str:
        """A pair in words: "at the mouth", "at the middle of crack 2", "of pair 3"."""
        names = {number: name for name, number in self.pairs.places.items()}
        return f"at {names[pair]}" if pair in names else f"of pair {pair + 1}"

    @property
    def n_modes(self) -> int:
        """Number of natural modes: of coordinates with mass."""
        return self.n_dofs

    @property
    def whole(self) -> Any:
        """The structure to which dof numbers and nodes refer: itself, unless it is reduced."""
        return self

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Displacements (m, n_local) as those of the whole structure."""
        return displacement

    def function(self, displacement: np.ndarray) -> Any:
        """DOLFINx's Function of a displacement (n_local,), zero where clamped (collective).

        Raises
        ------
        InputError
            The structure is not one of a mesh of DOLFINx.
        """
        dofs = getattr(self.whole.nodes, "mesh_dofs", None)
        if dofs is None:
            raise InputError("structure", repr(self), "made from a mesh of DOLFINx, or from forms")
        return dofs.function(self.expand(displacement[None])[0])

    def apply_bt(self, displacement: np.ndarray) -> np.ndarray:
        """B^T u of displacements (m, n_local): (m, n_pairs) on every rank (collective)."""
        return self.sum_over_ranks((self.gap.T @ displacement.T).T)

    def apply_tangential(self, displacement: np.ndarray) -> np.ndarray | None:
        """B_t^T u, likewise; None without B_t (collective)."""
        if self.tangential is None:
            return None
        return self.sum_over_ranks((self.tangential.T @ displacement.T).T)

    def apply_b(self, pair_force: np.ndarray) -> np.ndarray:
        """B lambda of forces on the pairs (m, n_pairs): (m, n_local)."""
        return (self.gap @ pair_force.T).T

    def sum_over_ranks(self, values: np.ndarray) -> np.ndarray:
        """Add up the arrays of all ranks (collective); the same array on one rank."""
        if self.comm.size == 1:
            return values
        values = np.ascontiguousarray(values)
        total = np.empty_like(values)
        self.comm.Allreduce(values, total)
        return total

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Pick dofs from displacements (m, n_local): (m, len(dofs)) on every rank (collective).

        Raises as :meth:`check_dofs`.
        """
        wanted = self.check_dofs(dofs)
        mine = (wanted >= self.first_dof) & (wanted < self.first_dof + self.n_local)
        picked = np.zeros((len(displacement), len(wanted)), dtype=displacement.dtype)
        picked[:, mine] = displacement[:, wanted[mine] - self.first_dof]
        return self.sum_over_ranks(picked)

    def check_dofs(self, dofs: Sequence[int | None]) -> np.ndarray:
        """Dofs as an array of whole numbers; None stands for the one that is watched (collective).

        Raises
        ------
        InputError
            A dof is not a whole number between 0 and n_dofs - 1.
        """
        if isinstance(dofs, list | tuple) and None in dofs:
            dofs = [self.watched_dof if dof is None else dof for dof in dofs]
        wanted = np.atleast_1d(numbers(dofs)).ravel()
        if not np.all((wanted >= 0) & (wanted < self.n_dofs) & (wanted == np.round(wanted))):
            raise InputError("dofs", dofs, f"whole numbers between 0 and {self.n_dofs - 1}")
        return wanted.astype(int)

    def find_dof(self, point: Sequence[float], component: int | str) -> int:
        """Return the dof of a displacement component at the node at a point (collective).

        Parameters
        ----------
        point : (d,) [m]
            Position of the node, to 1e-6 of the structure's size.
        component : 0, 1, 2, "x", "y" or "z"
            Direction.

        Raises
        ------
        InputError
            There is no node there, or two (on the crack faces), the dof is clamped, or the
            structure was made from matrices and has no positions.
        """
        if self.nodes is None:
            raise InputError("point", point, "given only for a structure made from a mesh")
        d, comm = self.nodes.points.shape[1], self.whole.comm
        known: list[int | str] = [*range(d), *AXES[:d]]
        if component not in known:
            words = ", ".join(map(repr, known[:-1]))
            raise InputError("component", component, f"{words} or {known[-1]!r}")
        target = numbers(point)
        if target.shape != (d,) or not np.all(np.isfinite(target)):
            words = f"[{', '.join(AXES[:d])}], {('two', 'three')[d - 2]} finite numbers"
            raise InputError("point", point, words)
        points = gather_rows(comm, self.nodes.points)
        found = find_nodes_at(points, target)
        if len(found) != 1:
            nodes = f"{len(found)} found there; {describe_nearest_node(points, target)}"
            raise InputError("point", tuple(target), f"at a node that exists once ({nodes})")
        dof = int(gather_rows(comm, self.nodes.dofs)[found[0], known.index(component) % d])
        if dof < 0:
            allowed = f"free in component {component!r}, not clamped"
            raise InputError("point", tuple(target), allowed)
        return dof

    def dof_name(self, dof: int) -> str:
        """A dof in words: "x displacement at (0.1, 0.1) m" (collective)."""
        if self.nodes is None:
            return f"displacement of dof {dof}"
        comm = self.whole.comm
        node, component = np.argwhere(gather_rows(comm, self.nodes.dofs) == dof)[0]
        place = format_point(gather_rows(comm, self.nodes.points)[node], ".4g")
        return f"{AXES[component]} displacement at {place} m"


# --- the clamp ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Clamp:
    """Inertia and load of a mesh under its rigid motions: translations first, then rotations.

    A rigid motion r of the whole mesh stretches nothing, K r = 0, and closes no gap, B^T r = 0. So
    of all nodes, those in the clamp too, with their displacement u relative to it,

        r . R = r^T M (u'' + a u') - r^T f,

    R being the forces of the clamp (Newton's law of all that hangs on it): a translation gives
    their sum, a rotation about the clamp's centre their moment about it. What damps by M, a of
    Rayleigh's damping, is a drag from outside; all other damping, that of modes too, is taken to
    act inside, where it exerts no force on the whole.

    Attributes
    ----------
    center : (d,) [m]
        Middle of the clamped nodes, between their least and largest coordinates.
    inertia : (n_rigid, n_local)
        r^T M of the free dofs; 3 motions of a plate, 6 of a solid.
    load : (2K+1, n_rigid) [N], [N m]
        r^T f of the rows of the load.
    """

    center: np.ndarray
    inertia: np.ndarray
    load: np.ndarray

    def with_weights(self, weights: float | np.ndarray) -> Clamp:
        """The same under a load whose parts are multiplied by a factor, or mapped to others."""
        return replace(self, load=np.dot(weights, self.load))

    def reaction_of_waves(
        self, waves: np.ndarray, omega: float, subharmonic: int, drag: float, phases: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Forces (n, d) [N] and moments (n, n_rigid - d) [N m] at phases (n,) of a periodic motion
        of angular frequency omega.

        ``waves`` (2H+1, n_rigid) are the coefficients of r^T M u; the load has ``subharmonic``
        times the motion's frequency."""
        rate = omega * np.arange(1, len(waves) // 2 + 1)[:, None]
        cosines, sines = waves[1::2], waves[2::2]
        moved = np.zeros_like(waves)
        moved[1::2] = rate * (drag * sines - rate * cosines)
        moved[2::2] = -rate * (drag * cosines + rate * sines)
        forces = evaluate(moved, 1.0, phases) - evaluate(self.load, subharmonic, phases)
        return tuple(np.split(forces, [len(self.center)], axis=1))

    def reaction_of_record(
        self, time: np.ndarray, seen: np.ndarray, omega: float, drag: float
    ) -> tuple[np.ndarray, ...]:
        """Forces (n, d) and moments at the instants (n,) [s] of a record (n, n_rigid) of r^T M u
        under a load of angular frequency omega."""
        from scipy.interpolate import make_interp_spline  # takes a while, rarely used

        # Of degree 5: the second derivative is known to the fourth order.
        record = make_interp_spline(time, seen, k=5)
        moved = record.derivative(2)(time) + drag * record.derivative(1)(time)
        return tuple(np.split(moved - evaluate(self.load, omega, time), [len(self.center)], axis=1))
