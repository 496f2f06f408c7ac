"""Dofs and contact pairs, their places in a mesh, and the clamp.

Dofs are numbered through all ranks, and each rank owns successive ones. A rigid motion r of the
mesh, at unit amplitude, gives a force or a moment R of the clamp:

    r . R = r^T M (u'' + a u') - r^T f

The sections below are nodes, pairs, coordinates (which structures inherit), and the clamp.
"""

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
from fenics_crack.model.matrices import ReadOnlyArrays, floats_or_single_nan
from fenics_crack.numerics.fourier import evaluate_series

AXES = "xyz"
"""Names of the coordinate axes, and of displacement components."""

MAX_POINT_TO_NODE_DISTANCE_RATIO = 0.05
"""Maximum distance of a point from its nearest node, relative to the size of the mesh."""


@dataclass(frozen=True, eq=False)
class Nodes(ReadOnlyArrays):
    """Positions and dofs of the nodes that this rank owns; the arrays are read-only.

    Attributes
    ----------
    points : (m, d) [m]
        Positions: d = 2 in a plane, 3 in space.
    dofs : (m, d) int
        Number of the x, y (and z) displacement in the structure; -1 if it is clamped.
    cells : (n_cells, k) int
        This rank's cells in VTK's node order; nodes are numbered through all ranks.
    vtk_type : int
        VTK's number of the cell type; 0: no cells of one kind.
    dolfinx_mesh_and_dofs : fenics_crack.fem.plate.Dofs or None
        DOLFINx's mesh and the dofs on it, kept for later integrals over the mesh. If the mesh were
        made again, the ranks might have other parts of it. None without DOLFINx's mesh.
    frames : (m, d, d) or None
        Matrix of each node that turns its displacements into the axes x, y (and z). None: they are
        along these axes already.
    """

    points: np.ndarray
    dofs: np.ndarray
    cells: np.ndarray
    vtk_type: int
    dolfinx_mesh_and_dofs: Any = None
    frames: np.ndarray | None = None

    def find_nearest_position_and_dofs(
        self, comm: MPI.Comm, key: str, point: Sequence[float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find the node nearest to ``point`` (d,) [m] (collective).

        Returns
        -------
        (d,) [m]
            Position of the node.
        (d,) int
            Dofs of the node, -1 if clamped.

        Raises
        ------
        InputError
            The point is farther from all nodes than 5 % of the mesh's size. Or the nearest node is
            clamped. Or two nodes coincide there, one on each crack face. The error names the point
            ``key``.
        """
        all_points, all_node_dofs = gather_rows(comm, self.points), gather_rows(comm, self.dofs)
        distances = np.linalg.norm(all_points - point, axis=1)
        mesh_extent = np.ptp(all_points, axis=0).max()
        nearest_index = int(np.argmin(distances))
        point_tuple = tuple(map(float, point))
        nearest_node_text = describe_nearest_node(all_points, point)
        if distances[nearest_index] > MAX_POINT_TO_NODE_DISTANCE_RATIO * mesh_extent:
            raise InputError(key, point_tuple, f"on the mesh ({nearest_node_text})")
        if len(find_node_indices_at(all_points, all_points[nearest_index])) > 1:
            raise InputError(
                key,
                point_tuple,
                f"near a node off the crack faces, where nodes are double ({nearest_node_text})",
            )
        if np.all(all_node_dofs[nearest_index] < 0):
            raise InputError(
                key, point_tuple, f"near a node that is not clamped ({nearest_node_text})"
            )
        return all_points[nearest_index], all_node_dofs[nearest_index]


def find_node_indices_at(points: np.ndarray, point: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the indices of all nodes at a point; empty if there is none.

    Parameters
    ----------
    points : (n, d) [m]
        Positions of the nodes.
    point : (d,) [m]
        Position to search. The tolerance is 1e-6 of the nodes' extent.
    """
    allowed_distance = 1e-6 * np.ptp(points, axis=0).max()
    return np.flatnonzero(np.linalg.norm(points - point, axis=1) <= allowed_distance)


def describe_nearest_node(points: np.ndarray, point: Sequence[float] | np.ndarray) -> str:
    """Return the position of the node nearest to a point, in words.

    Parameters
    ----------
    points : (n, d) [m]
        Positions of the nodes.
    point : (d,) [m]
        Point whose nearest node is named.
    """
    nearest_point = points[np.argmin(np.linalg.norm(points - point, axis=1))]
    return f"the nearest node is at {format_point(nearest_point)}"


def format_point(point: np.ndarray, format_specification: str = ".8g") -> str:
    """Format a point [m] for a message, as "(0.1, 0.1)".

    The digits by default suffice to find a node again by :func:`find_node_indices_at`.
    """
    return (
        f"({', '.join(format(x, format_specification) for x in point.round(12) + 0.0)})"  # no "-0"
    )


@dataclass(frozen=True, eq=False)
class Pairs(ReadOnlyArrays):
    """Positions and other mesh data of the contact pairs; the arrays are read-only.

    Pairs follow each other crack by crack. Fields are None if they are not known, as without a
    mesh.

    Attributes
    ----------
    points : (n_pairs, d) [m] or None
        Positions.
    areas : (n_pairs,) [m^2] or None
        Area of the crack face that belongs to each pair.
    cracks : (n_pairs,) int or None
        Number of the crack, from 0.
    positions : (n_pairs,) [m] or None
        Distance along the crack from its mouth, or from the left tip of a crack inside; in a solid,
        distance from the front.
    places : dict of str to int
        Watched pair of each crack by its name: "the mouth", or with several cracks "the mouth of
        crack 1", "the middle of crack 2".
    nodes : (n, d) [m] or None
        Corners of the facets of a solid's crack faces; those on fronts come last.
    pressure_functions_at_nodes : (n, n_pairs) scipy.sparse.csr_matrix or None
        Value of each pair's pressure function at ``nodes``: the shape of the pressure, 0 to 1, with
        which the pair's contact force acts on the crack faces.
    tangential_gap_matrix : (n_local, 2 n_pairs) scipy.sparse.csr_matrix or None
        Tangential gaps of a solid's pairs, from the dofs of the whole structure: all pairs along
        their first directions, then all along their second ones.
    """

    points: np.ndarray | None = None
    areas: np.ndarray | None = None
    cracks: np.ndarray | None = None
    positions: np.ndarray | None = None
    places: dict[str, int] = field(default_factory=dict)
    nodes: np.ndarray | None = None
    pressure_functions_at_nodes: sparse.csr_matrix | None = None
    tangential_gap_matrix: sparse.csr_matrix | None = None


def body_property(name: str) -> Any:
    """Make a property that reads a field of the structure's :class:`Body`."""
    return property(attrgetter(f"body.{name}"))


class DofsAndContactPairs:
    """Degrees of freedom and contact pairs of a structure; read-only.

    Dofs are numbered through all ranks, and each rank owns ``n_local`` successive ones.

    Attributes
    ----------
    comm : MPI.Comm
        The ranks that share the structure.
    gap : scipy.sparse.csr_matrix
        Matrix B of the normal gaps B^T u with the displacement u: (n_local, n_pairs). Each rank has
        the rows of its own dofs.
    tangential : scipy.sparse.csr_matrix or None
        Matrix B_t of the tangential gaps B_t^T u, with the rows of this rank. None: not known.
    force : (2K+1, n_local) [N]
        Mean of the load, then cosine and sine part of its harmonics 1 to K.
    nodes : Nodes or None
        Positions of the dofs in a mesh.
    pairs : Pairs
        Positions, areas and cracks of the contact pairs in a mesh.
    watched : (n_local,) or None
        Vector whose product with u is the watched displacement [m], which results report if no dof
        is named. None: the dof that carries most of the load is watched.
    """

    body: Any
    load_damping_clearance_changes: Any
    comm: MPI.Comm = body_property("comm")
    mass: Any = body_property("mass")
    gap: sparse.csr_matrix = body_property("gap")
    tangential: sparse.csr_matrix | None = body_property("tangential")
    force: np.ndarray
    nodes: Nodes | None = body_property("nodes")
    pairs: Pairs = body_property("pairs")
    pair_points: np.ndarray | None = body_property("pairs.points")
    """Positions of the contact pairs in a mesh: (n_pairs, d) [m]."""
    pair_areas: np.ndarray | None = body_property("pairs.areas")
    """Area of the crack face that belongs to each pair in a mesh: (n_pairs,) [m^2]."""
    watched: np.ndarray | None = body_property("watched")

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"{name}: a structure cannot be changed; varied() and damped() return a changed one"
        )

    @property
    def _size_description(self) -> str:
        """Say in words how many dofs there are."""
        return f"{self.n_dofs} dofs"

    @property
    def local_nodes_with_cells_or_none(self) -> Nodes | None:
        """Nodes and cells of the mesh to draw; None if the nodes have no cells."""
        return self.nodes if self.nodes is not None and self.nodes.vtk_type else None

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom on all ranks, without clamped ones."""
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
        """Index of each crack's watched pair, by its position in words.

        An example is {"the mouth": 0}. Results report these pairs. Without a mesh, the first pair
        is watched, {"pair 1": 0}. Without pairs, the dict is empty.
        """
        return self.pairs.places or ({"pair 1": 0} if self.n_pairs else {})

    @property
    def first_watched_pair(self) -> int:
        """Index of the pair at the mouth of the first crack.

        If the first crack lies inside the plate, the pair in the middle of the crack. Without a
        mesh, the first pair.
        """
        return next(iter(self.watched_pairs.values()))

    @cached_property
    def watched_dof(self) -> int:
        """Dof of the whole structure for results without a named dof (collective).

        If :meth:`Structure.watching` has chosen a dof, this dof. Otherwise, if the vector
        ``watched`` is known, the dof with its largest entry. Otherwise the dof that carries most of
        the load.
        """
        whole_structure = self.whole
        if self.load_damping_clearance_changes.watched_dof is not None:
            return self.load_damping_clearance_changes.watched_dof
        if whole_structure is not self:
            return int(whole_structure.watched_dof)
        if self.watched is None:
            return self.find_most_loaded_dof()
        return int(np.argmax(gather_rows(self.comm, np.abs(self.watched))))

    def find_most_loaded_dof(self) -> int:
        """Return the dof with the largest entry in any part of the load (collective)."""
        return int(np.argmax(gather_rows(self.comm, np.abs(self.body.force).max(axis=0))))

    def describe_pair(self, pair: int) -> str:
        """Return a contact pair's name in words, for its index ``pair`` from 0.

        A watched pair is named by its place: "at the mouth", "at the middle of crack 2". Any other
        pair is named by its number from 1: "of pair 3".
        """
        place_name_by_pair = {
            pair_index: place_name for place_name, pair_index in self.pairs.places.items()
        }
        return (
            f"at {place_name_by_pair[pair]}"
            if pair in place_name_by_pair
            else f"of pair {pair + 1}"
        )

    @property
    def n_modes(self) -> int:
        """Number of natural modes, which is the number of dofs with mass."""
        return self.n_dofs

    @property
    def whole(self) -> Any:
        """The structure to which dof numbers and nodes refer: itself, unless it is reduced."""
        return self

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Return displacements (m, n_local) of the whole structure; here the argument itself.

        Reduced structures expand their coordinates.
        """
        return displacement

    def function(self, displacement: np.ndarray) -> Any:
        """Return a displacement (n_local,) as DOLFINx's Function (collective).

        The function is zero on the clamp.

        Raises
        ------
        InputError
            The structure has no mesh of DOLFINx.
        """
        mesh_and_dofs = getattr(self.whole.nodes, "dolfinx_mesh_and_dofs", None)
        if mesh_and_dofs is None:
            raise InputError(
                "structure",
                repr(self),
                (
                    "a structure from a mesh of DOLFINx, as fc.build_structure(scene) returns for "
                    "a scene with a mesh, or from forms"
                ),
            )
        return mesh_and_dofs.function(self.expand(displacement[None])[0])

    def apply_bt(self, displacement: np.ndarray) -> np.ndarray:
        """Return the normal gaps B^T u on every rank, clearance not subtracted (collective).

        Parameters
        ----------
        displacement : (m, n_local) [m]
            Displacements u, one in each row.

        Returns
        -------
        (m, n_pairs) [m]
            Gaps; B is the matrix of normal gaps.
        """
        return self.sum_over_ranks((self.gap.T @ displacement.T).T)

    def apply_tangential(self, displacement: np.ndarray) -> np.ndarray | None:
        """Return the tangential gaps B_t^T u on every rank (collective).

        ``displacement`` (m, n_local) [m] has displacements u in its rows. The result is (m,
        n_tangents) [m]; None if the structure has no tangential gap matrix B_t.
        """
        if self.tangential is None:
            return None
        return self.sum_over_ranks((self.tangential.T @ displacement.T).T)

    def apply_b(self, pair_force: np.ndarray) -> np.ndarray:
        """Return the forces on dofs (m, n_local) from contact forces (m, n_pairs) [N].

        The result is B lambda, with the gap matrix B and the contact forces lambda. Contact acts on
        the structure with the opposite sign, as B lambda stands on the left of the equation of
        motion.
        """
        return (self.gap @ pair_force.T).T

    def sum_over_ranks(self, array: np.ndarray) -> np.ndarray:
        """Add up the arrays of all ranks (collective).

        One rank returns its own array, not a copy.
        """
        if self.comm.size == 1:
            return array
        array = np.ascontiguousarray(array)
        total = np.empty_like(array)
        self.comm.Allreduce(array, total)
        return total

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int | None]) -> np.ndarray:
        """Pick the values of dofs from displacements, on every rank (collective).

        Parameters
        ----------
        displacement : (m, n_local)
            Displacements on the dofs of this rank, one in each row.
        dofs : sequence of int or None
            Numbers of dofs through all ranks; None stands for the watched dof. Checked by
            :meth:`as_dof_numbers`, which raises InputError.

        Returns
        -------
        (m, len(dofs))
            Values at these dofs.
        """
        checked_dofs = self.as_dof_numbers(dofs)
        is_local = (checked_dofs >= self.first_dof) & (checked_dofs < self.first_dof + self.n_local)
        dof_values = np.zeros((len(displacement), len(checked_dofs)), dtype=displacement.dtype)
        dof_values[:, is_local] = displacement[:, checked_dofs[is_local] - self.first_dof]
        return self.sum_over_ranks(dof_values)

    def as_dof_numbers(self, dofs: Sequence[int | None]) -> np.ndarray:
        """Return dofs as an array of integers; None stands for the watched dof (collective).

        Raises
        ------
        InputError
            A dof is not a whole number between 0 and n_dofs - 1.
        """
        if isinstance(dofs, list | tuple) and None in dofs:
            dofs = [self.watched_dof if dof is None else dof for dof in dofs]
        dof_numbers = np.atleast_1d(floats_or_single_nan(dofs)).ravel()
        if not np.all(
            (dof_numbers >= 0)
            & (dof_numbers < self.n_dofs)
            & (dof_numbers == np.round(dof_numbers))
        ):
            raise InputError("dofs", dofs, f"whole numbers from 0 to {self.n_dofs - 1}")
        return dof_numbers.astype(int)

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
            raise InputError(
                "point",
                point,
                "left out for a structure from matrices, without positions; give a dof's number",
            )
        n_dimensions, comm = self.nodes.points.shape[1], self.whole.comm
        allowed_components: list[int | str] = [*range(n_dimensions), *AXES[:n_dimensions]]
        if component not in allowed_components:
            requirement = (
                f"{', '.join(map(repr, allowed_components[:-1]))} or {allowed_components[-1]!r}"
            )
            raise InputError("component", component, requirement)
        coordinates = floats_or_single_nan(point)
        if coordinates.shape != (n_dimensions,) or not np.all(np.isfinite(coordinates)):
            dimension_count_word = ("two", "three")[n_dimensions - 2]
            requirement = (
                f"[{', '.join(AXES[:n_dimensions])}], {dimension_count_word} finite numbers"
            )
            raise InputError("point", point, requirement)
        points = gather_rows(comm, self.nodes.points)
        node_indices = find_node_indices_at(points, coordinates)
        if len(node_indices) != 1:
            nearest_node_text = describe_nearest_node(points, coordinates)
            requirement = (
                f"at exactly one node ({len(node_indices)} are there; {nearest_node_text})"
            )
            raise InputError("point", tuple(coordinates), requirement)
        dofs_of_node = gather_rows(comm, self.nodes.dofs)[node_indices[0]]
        dof = int(dofs_of_node[allowed_components.index(component) % n_dimensions])
        if dof < 0:
            requirement = f"at a node that is not clamped in component {component!r}"
            raise InputError("point", tuple(coordinates), requirement)
        return dof

    def dof_name(self, dof: int) -> str:
        """Name a dof: "x displacement at (0.1, 0.1) m" (collective).

        Without positions of nodes, the name has the dof's number.
        """
        if self.nodes is None:
            return f"displacement of dof {dof}"
        comm = self.whole.comm
        node_index, component_index = np.argwhere(gather_rows(comm, self.nodes.dofs) == dof)[0]
        place_text = format_point(gather_rows(comm, self.nodes.points)[node_index], ".4g")
        return f"{AXES[component_index]} displacement at {place_text} m"


# --- the clamp ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ClampReactionData:
    """Inertia and load of a mesh, for the reaction at the clamp.

    A rigid motion r of the whole mesh stretches nothing and closes no gap. With the displacement u
    relative to the clamp, the mass M, the load f and all nodes, also clamped ones, Newton's law
    gives

        r . R = r^T M (u'' + a u') - r^T f

    R are the forces of the clamp. If r is a translation, r . R is the clamp's force in this
    direction. If r is a rotation about the clamp's centre, r . R is the moment about the centre.
    The mass coefficient a [1/s] of Rayleigh damping is a drag from outside. All other damping acts
    inside and exerts no force on the whole.

    Attributes
    ----------
    center : (d,) [m]
        Middle of the clamped nodes, between their smallest and largest coordinates.
    inertia : (n_rigid, n_local)
        r^T M of the free dofs, a row for each rigid motion r: translations, then rotations. A plate
        has 3 motions, a solid 6.
    load : (2K+1, n_rigid) [N], [N m]
        r^T f for each row of the load: mean, cosine and sine parts.
    """

    center: np.ndarray
    inertia: np.ndarray
    load: np.ndarray

    def with_weights(self, load_weights: float | np.ndarray) -> ClampReactionData:
        """Return the clamp under the present load multiplied by weights.

        Parameters
        ----------
        load_weights : float or (2K+1, 2K+1)
            Factor of the load, or matrix that maps its rows (mean, cosine and sine parts).
        """
        return replace(self, load=np.dot(load_weights, self.load))

    def reaction_of_waves(
        self, waves: np.ndarray, omega: float, subharmonic: int, drag: float, phases: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Return the clamp's forces and moments in a periodic motion, at given phases.

        Parameters
        ----------
        waves : (2H+1, n_rigid)
            Fourier coefficients of r^T M u, up to harmonic H of the motion. r are the n_rigid rigid
            motions, M is the mass matrix and u the displacement.
        omega : float [rad/s]
            Angular frequency of the motion.
        subharmonic : int
            Number of load periods in a period of the motion.
        drag : float [1/s]
            Mass coefficient a of Rayleigh damping.
        phases : (n,) [rad]
            Phases in the motion's period, at which the reaction is returned.

        Returns
        -------
        (n, d) [N]
            Forces of the clamp on the body.
        (n, n_rigid - d) [N m]
            Moments of the clamp on the body.
        """
        harmonic_omegas = omega * np.arange(1, len(waves) // 2 + 1)[:, None]
        wave_cosine_coefficients, wave_sine_coefficients = waves[1::2], waves[2::2]
        inertia_waves = np.zeros_like(waves)
        inertia_waves[1::2] = harmonic_omegas * (
            drag * wave_sine_coefficients - harmonic_omegas * wave_cosine_coefficients
        )
        inertia_waves[2::2] = -harmonic_omegas * (
            drag * wave_cosine_coefficients + harmonic_omegas * wave_sine_coefficients
        )
        reactions_at_phases = evaluate_series(inertia_waves, 1.0, phases) - evaluate_series(
            self.load, subharmonic, phases
        )
        return tuple(np.split(reactions_at_phases, [len(self.center)], axis=1))

    def reaction_of_record(
        self, time: np.ndarray, inertia_record: np.ndarray, omega: float, drag: float
    ) -> tuple[np.ndarray, ...]:
        """Return the clamp's forces and moments in a recorded motion.

        Accelerations are second derivatives of a spline of degree 5 through the record.

        Parameters
        ----------
        time : (n,) [s]
            Instants of the record.
        inertia_record : (n, n_rigid)
            r^T M u at these instants, with the n_rigid rigid motions r, the mass matrix M and the
            displacement u.
        omega : float [rad/s]
            Angular frequency of the load.
        drag : float [1/s]
            Mass coefficient a of Rayleigh damping.

        Returns
        -------
        (n, d) [N]
            Forces of the clamp on the body.
        (n, n_rigid - d) [N m]
            Moments of the clamp on the body.
        """
        from scipy.interpolate import make_interp_spline  # takes a while, rarely used

        # A spline of degree 5 has a second derivative of fourth order.
        inertia_record_spline = make_interp_spline(time, inertia_record, k=5)
        inertia_forces = inertia_record_spline.derivative(2)(
            time
        ) + drag * inertia_record_spline.derivative(1)(time)
        return tuple(
            np.split(
                inertia_forces - evaluate_series(self.load, omega, time), [len(self.center)], axis=1
            )
        )
