"""Assemble point loads, edge loads and base motion as nodal forces.

A force F at x does the work F . sum_i N_i(x) u_i, so node i gets N_i(x) F. On an edge E of a plate
with the thickness t, or on a face of a solid with t = 1, a traction T gives it

    f_i = t int_E N_i T ds.

A pressure p is T = -p n, with the outward normal n.

A clamp that moves by U(t), the same everywhere, carries the structure along. With displacements u
relative to the clamp,

    M u'' + C u' + K u + B lambda(g) = f - M R U''.

R is the translation of all nodes, including clamped ones, and M the mass matrix with their rows.
The translation stretches nothing, K R = 0, and closes no gap, B^T R = 0. Damping acts on u.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, check_choice
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem import compat
from fenics_crack.fem.compat import ufl
from fenics_crack.fem.elasticity import thickness_constant
from fenics_crack.fem.plate import Dofs
from fenics_crack.fem.setting import list_mean_cos_and_sin_force_vectors
from fenics_crack.model.nodes import (
    MAX_POINT_TO_NODE_DISTANCE_RATIO,
    ClampReactionData,
    describe_nearest_node,
    find_node_indices_at,
)
from fenics_crack.scene.fields import Vector
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Load


def assemble_loads(scene: Scene, dofs: Dofs, mass: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Assemble all loads of a scene as nodal forces, and choose the watched motion (collective).

    Parameters
    ----------
    scene : Scene
        Scene with loads.
    dofs : Dofs
        The mesh's dofs.
    mass : PETSc.Mat
        Mass matrix with the clamped rows.

    Returns
    -------
    nodal_force_harmonics : (2K+1, n_dofs) [N]
        Mean, then cosine and sine parts up to the loads' highest order K. The columns are all
        owned dofs, clamped dofs included.
    watched_vector : (n_local,) or None
        The product of this vector and the displacement u is reported in results [m]. None: results
        report the dof with the largest load.

    Raises
    ------
    InputError
        A load is off the mesh or acts only on clamped dofs. Or a point load is on a crack, so the
        crack face is not determined.
    """
    nodal_force_harmonics = np.zeros(
        (2 * scene.highest_load_harmonic + 1, len(dofs.structure_dof_numbers))
    )
    watched_vector = None
    excitation = scene.excitation
    point_load_position = (
        excitation.point
        if excitation.point is not None
        else dofs.part_mesh.position_by_point_name.get("load")
    )
    if point_load_position is not None:
        point_load_harmonics = list_mean_cos_and_sin_force_vectors(scene)
        load_force_harmonics, displacement_weights = _assemble_point_load(
            scene, dofs, "excitation", point_load_position, point_load_harmonics
        )
        nodal_force_harmonics += load_force_harmonics
        watched_vector = (
            displacement_weights if scene.has_other_loads or scene.speed > 0.0 else None
        )
    elif (force_key := excitation.first_force_key) or not scene.has_other_loads:
        key_note = f" of excitation.{force_key}" if force_key else " of a force"
        requirement = f"given: the point{key_note} [m], or name a physical point 'load' in the mesh"
        raise InputError("excitation.point", None, requirement)
    for load_number, load in enumerate(scene.loads, 1):
        load_key = f"loads.{load_number}"
        if load.point is not None:
            load_force_harmonics, displacement_weights = _assemble_point_load(
                scene, dofs, load_key, load.point, load.harmonic_components("force")
            )
            watched_vector = displacement_weights if watched_vector is None else watched_vector
        else:
            load_force_harmonics = _assemble_edge_force(scene, dofs, load_key, load)
            if watched_vector is None and np.any(
                gather_rows(dofs.comm, load_force_harmonics.ravel())
            ):
                watched_vector = _make_watch_vector_at_edge_middle(
                    dofs, str(load.edge), load_force_harmonics
                )
        nodal_force_harmonics[: len(load_force_harmonics)] += load_force_harmonics
    if scene.base is not None:
        if watched_vector is None:
            clamp_center = gather_rows(dofs.comm, dofs.points[dofs.nodes_on("clamp")]).mean(axis=0)
            # Watch the node farthest from the clamp.
            owned_nodes = np.arange(dofs.n_nodes_owned_by_rank)
            watched_vector = _make_watch_vector_at_node(
                dofs, owned_nodes, clamp_center, -1, scene.base.dominant_unit_vector
            )
        for row_index, acceleration in enumerate(scene.base.accelerations, 1):
            nodal_force_harmonics[row_index] -= _multiply_mass_by_acceleration(
                mass, np.tile(acceleration, dofs.n_nodes_owned_by_rank)
            )
    if (
        watched_vector is None
        and point_load_position is not None
        and not any(map(any, point_load_harmonics))
    ):
        mean_and_cos_directions = [np.eye(dofs.dimension)[0].tolist()] * 2
        _, watched_vector = _assemble_point_load(
            scene, dofs, "excitation", point_load_position, mean_and_cos_directions
        )
    return nodal_force_harmonics, watched_vector


def _largest_force_direction(force_vectors: Sequence[Vector]) -> Vector:
    """Return the unit vector along the largest cosine or sine part of a load.

    If all cosine and sine parts are zero, the mean counts. ``force_vectors`` has the mean, then
    cosine and sine parts of each order. At least one vector must not be zero.
    """
    mean_force_vector, *cos_and_sin_vectors = force_vectors
    largest_force_vector = max(
        cos_and_sin_vectors, key=lambda force_vector: math.hypot(*force_vector)
    )
    if not any(largest_force_vector):
        largest_force_vector = mean_force_vector
    largest_force_magnitude = math.hypot(*largest_force_vector)
    return tuple(component / largest_force_magnitude for component in largest_force_vector)


def nodal_force_fractions(scene: Scene, dofs: Dofs, key: str, point: Vector) -> np.ndarray:
    """Distribute a unit point force over this rank's nodes: (n_nodes,) (collective).

    A node at the point takes the whole force. Otherwise the fractions are the values of the nodes'
    basis functions at the point. If a point on a CAD part lies outside all cells but close to the
    mesh, the nearest node takes the whole force.

    Parameters
    ----------
    scene : Scene
        Scene with the mesh's order.
    dofs : Dofs
        The mesh's dofs.
    key : str
        The point's key in the scene, for errors.
    point : (d,) [m]
        Point at which the force acts.

    Raises
    ------
    InputError
        The point is off the mesh. Or the point is on a crack, so the crack face is not determined.
    """
    if point_pairs_beside_cracks := [
        points_below_and_above_crack
        for crack in dofs.part_mesh.crack_paths_or_surfaces
        if (points_below_and_above_crack := crack.points_beside(point)) is not None
    ]:
        (point_below_crack, point_above_crack), *_ = point_pairs_beside_cracks
        requirement = (
            "a point on one of the two crack faces: {} on the lower face, or {} on the upper face"
        )
        raise InputError(
            key, tuple(point), requirement.format(point_below_crack, point_above_crack)
        )
    all_node_positions = gather_rows(dofs.comm, dofs.points)
    owned_node_numbers = dofs.first_node + np.arange(dofs.n_nodes_owned_by_rank)
    if len(coincident_nodes := find_node_indices_at(all_node_positions, point)):
        return np.where(owned_node_numbers == coincident_nodes[0], 1.0, 0.0)
    local_cell_nodes, basis_values = compat.evaluate_basis(
        dofs.space, scene.mesh.order, np.array(point)
    )
    basis_values = np.where(np.abs(basis_values) < 1e-12, 0.0, basis_values)  # rounding
    has_point_by_rank = dofs.comm.allgather(len(local_cell_nodes) > 0)
    if not any(has_point_by_rank):
        node_distances = np.linalg.norm(all_node_positions - point, axis=1)
        mesh_extent = np.ptp(all_node_positions, axis=0).max()
        if (
            scene.geometry.file is None
            or node_distances.min() > MAX_POINT_TO_NODE_DISTANCE_RATIO * mesh_extent
        ):
            raise InputError(
                key,
                tuple(point),
                f"on the mesh ({describe_nearest_node(all_node_positions, point)})",
            )
        return np.where(owned_node_numbers == int(node_distances.argmin()), 1.0, 0.0)
    if dofs.comm.rank != has_point_by_rank.index(True):
        local_cell_nodes, basis_values = local_cell_nodes[:0], basis_values[:0]

    # The cell may have nodes of other ranks: pass every fraction to the node's owner.
    cell_nodes = dofs.space.dofmap.index_map.local_to_global(local_cell_nodes.astype(np.int32))
    cell_nodes = gather_rows(dofs.comm, np.asarray(cell_nodes, dtype=np.int64))
    fractions_at_cell_nodes = gather_rows(dofs.comm, basis_values)
    is_owned_node = (cell_nodes >= dofs.first_node) & (
        cell_nodes < dofs.first_node + dofs.n_nodes_owned_by_rank
    )
    node_fractions = np.zeros(dofs.n_nodes_owned_by_rank)
    np.add.at(
        node_fractions,
        cell_nodes[is_owned_node] - dofs.first_node,
        fractions_at_cell_nodes[is_owned_node],
    )
    return node_fractions


def _assemble_point_load(
    scene: Scene, dofs: Dofs, key: str, point: Vector, force_vectors: Sequence[Vector]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Assemble the nodal forces of a point load (collective).

    ``force_vectors`` [N] are mean, cosine and sine parts; ``key`` names the load in errors.

    Returns
    -------
    nodal_force_harmonics : (n_parts, n_dofs) [N]
        Nodal forces of each part, on all owned dofs.
    displacement_weights : (n_local,) or None
        Vector whose product with the displacement u is the displacement at the point along the load
        [m]. None if the load is zero.
    """
    node_fractions = nodal_force_fractions(scene, dofs, f"{key}.point", point)
    nodal_force_harmonics = np.array(
        [_distribute_vector(dofs, node_fractions, force_vector) for force_vector in force_vectors]
    )
    displacement_weights = (
        dofs.restrict_to_free(
            _distribute_vector(dofs, node_fractions, _largest_force_direction(force_vectors))
        )
        if any(map(any, force_vectors))
        else None
    )
    return _checked_force_on_free_dofs(
        dofs, f"{key}.point", tuple(point), nodal_force_harmonics
    ), displacement_weights


def _checked_force_on_free_dofs(
    dofs: Dofs, key: str, place: object, nodal_force_harmonics: np.ndarray
) -> np.ndarray:
    """Return a load's nodal forces unchanged, or raise InputError if all are clamped (collective).

    The error is raised if the load is not zero, but all forces act on clamped dofs.

    Parameters
    ----------
    dofs : Dofs
        The mesh's dofs.
    key : str
        The load's key in the scene, for the error.
    place : object
        The load's point or edge, for the error.
    nodal_force_harmonics : (2K+1, n_dofs) [N]
        Forces on all owned dofs: mean, then cosine and sine parts up to the order K.
    """
    has_force, has_free_force = (
        np.any(gather_rows(dofs.comm, nodal_forces.ravel()))
        for nodal_forces in (nodal_force_harmonics, nodal_force_harmonics[:, dofs.free_dofs])
    )
    if has_force and not has_free_force:
        raise InputError(
            key, place, "a place that is not clamped, as forces on clamped nodes move nothing"
        )
    return nodal_force_harmonics


def _distribute_vector(dofs: Dofs, node_fractions: np.ndarray, vector: Vector) -> np.ndarray:
    """Multiply a force vector by a fraction for each node: (n_dofs,).

    ``vector`` has a component for each axis; an empty vector counts as zero. ``node_fractions``
    (n_nodes,) may have any values, such as the edge area of each node. The result has all
    components of the first node, then of the second node.
    """
    return np.asarray(np.outer(node_fractions, vector or np.zeros(dofs.dimension)).ravel())


# --- loads on edges -------------------------------------------------------------------------------


def _assemble_edge_force(scene: Scene, dofs: Dofs, key: str, load: Load) -> np.ndarray:
    """Assemble a load's traction and pressure on an edge or surface (collective).

    ``key`` names the load in errors, as "loads.1". Returns the nodal forces (2K+1, n_dofs) [N]:
    mean, then cosine and sine parts of the orders 1 to K.
    """
    edge_name = load.given("edge")
    check_choice(f"{key}.edge", edge_name, sorted(set(dofs.part_mesh.tags_by_group) - {"clamp"}))
    edge_measure = dofs.part_mesh.measure_on(edge_name)
    test_function, thickness = ufl.TestFunction(dofs.space), thickness_constant(scene, dofs.space)
    x_direction = ufl.as_vector(np.eye(dofs.dimension)[0].tolist())
    test_function_integrals = compat.assembled_vector(
        thickness * ufl.inner(x_direction, test_function) * edge_measure
    )
    edge_area = gather_rows(dofs.comm, test_function_integrals).sum()
    if not edge_area > 0.0:
        raise InputError(
            f"{key}.edge", load.edge, "an edge on the boundary of the plate; this one lies inside"
        )
    nodal_edge_areas = test_function_integrals.reshape(-1, dofs.dimension)[:, 0]
    nodal_force_harmonics = np.array(
        [
            _distribute_vector(dofs, nodal_edge_areas, load_harmonic)
            for load_harmonic in load.harmonic_components("traction")
        ]
    )
    facet_normal = ufl.FacetNormal(dofs.space.mesh)
    unit_pressure_force = -compat.assembled_vector(
        thickness * ufl.inner(facet_normal, test_function) * edge_measure
    )
    nodal_force_harmonics += np.array(
        [
            sum(load_harmonic) * unit_pressure_force
            for load_harmonic in load.harmonic_components("pressure")
        ]
    )
    return _checked_force_on_free_dofs(dofs, f"{key}.edge", load.edge, nodal_force_harmonics)


def _make_watch_vector_at_edge_middle(
    dofs: Dofs, edge: str, nodal_force_harmonics: np.ndarray
) -> np.ndarray:
    """Return the vector to watch the displacement at an edge's middle: (n_local,).

    Results report the product with the displacement u. The product is the displacement of the
    edge's node nearest to the middle. The direction is the axis along which the load is largest.

    Parameters
    ----------
    dofs : Dofs
        The mesh's dofs.
    edge : str
        The edge's name.
    nodal_force_harmonics : (2K+1, n_dofs) [N]
        Load on the edge: mean, then cosine and sine parts up to the order K.
    """
    free_nodal_forces = np.where(
        dofs.structure_dof_numbers < 0, 0.0, nodal_force_harmonics
    ).reshape(len(nodal_force_harmonics), -1, dofs.dimension)
    force_sum_by_axis = np.abs(dofs.comm.allgather(free_nodal_forces.sum(axis=1))).sum(axis=(0, 1))
    direction = tuple(np.eye(dofs.dimension)[int(np.argmax(force_sum_by_axis))].tolist())
    edge_nodes = dofs.nodes_on(edge)
    edge_points = gather_rows(dofs.comm, dofs.points[edge_nodes])
    return _make_watch_vector_at_node(
        dofs, edge_nodes, (edge_points.min(axis=0) + edge_points.max(axis=0)) / 2.0, 0, direction
    )


# --- the clamp ------------------------------------------------------------------------------------


def make_clamp_for_reactions(
    dofs: Dofs, mass: Any, nodal_force_harmonics: np.ndarray
) -> ClampReactionData:
    """Return the data to compute reaction forces and moments at the clamp (collective).

    Moments are about the middle of the clamp's bounding box.

    Parameters
    ----------
    dofs : Dofs
        The mesh's dofs.
    mass : PETSc.Mat
        Mass matrix, with the rows of clamped dofs.
    nodal_force_harmonics : (2K+1, n_dofs) [N]
        Load on all dofs, clamped dofs included: mean, then cosine and sine parts up to the order K.
    """
    clamped_points = gather_rows(dofs.comm, dofs.points[dofs.nodes_on("clamp")])
    clamp_center = (
        np.round(0.5 * (clamped_points.min(axis=0) + clamped_points.max(axis=0)), 12) + 0.0
    )
    rigid_motion_rows = rigid_motion_displacements(dofs.points - clamp_center)
    inertia_rows = dofs.restrict_to_free(
        np.array(
            [
                _multiply_mass_by_acceleration(mass, rigid_motion_displacement)
                for rigid_motion_displacement in rigid_motion_rows
            ]
        )
    )
    return ClampReactionData(
        clamp_center, inertia_rows, dofs.comm.allreduce(nodal_force_harmonics @ rigid_motion_rows.T)
    )


def rigid_motion_displacements(points: np.ndarray) -> np.ndarray:
    """Return the displacements of points (n, d) in rigid motions: (n_rigid, n d).

    The motions are unit translations along the axes, then rotations e x r about the origin: three
    motions for d = 2, six for d = 3.
    """
    dimension = points.shape[1]
    spatial_points = np.pad(points, ((0, 0), (0, 3 - dimension)))
    rotation_axes = np.eye(3)[2:] if dimension == 2 else np.eye(3)
    motions = [np.tile(axis_direction, (len(points), 1)) for axis_direction in np.eye(dimension)]
    motions += [
        np.cross(axis_direction, spatial_points)[:, :dimension] for axis_direction in rotation_axes
    ]
    return np.array([motion.ravel() for motion in motions])


def _multiply_mass_by_acceleration(mass: Any, acceleration: np.ndarray) -> np.ndarray:
    """Return the mass matrix M times an acceleration (n_dofs,) [m/s^2]: (n_dofs,) [N]."""
    petsc_acceleration, petsc_force = mass.createVecs()
    petsc_acceleration.array[:] = acceleration
    mass.mult(petsc_acceleration, petsc_force)
    mass_times_acceleration = np.array(petsc_force.array_r)
    petsc_acceleration.destroy()
    petsc_force.destroy()
    return mass_times_acceleration


def _make_watch_vector_at_node(
    dofs: Dofs, nodes: np.ndarray, position: np.ndarray, distance_rank: int, direction: Vector
) -> np.ndarray:
    """Return the vector to watch a node's displacement in a direction: (n_local,).

    Results report the product with the displacement u, the node's displacement along ``direction``.
    The node is chosen by the distance from a position.

    Parameters
    ----------
    dofs : Dofs
        The mesh's dofs.
    nodes : (n,) int
        This rank's nodes from which to choose. The nodes of all ranks are sorted together.
    position : (d,) [m]
        Position from which distances are measured.
    distance_rank : int
        Index of the node among all nodes, sorted by distance: 0 for the nearest, -1 for the
        farthest. Equal distances are sorted by coordinates.
    direction : (d,)
        Unit vector.
    """
    all_points = gather_rows(dofs.comm, dofs.points[nodes])
    node_distances = np.linalg.norm(all_points - position, axis=1)
    distance_order = np.lexsort(
        [*all_points.T, np.round(node_distances / max(node_distances.max(), 1e-300), 9)]
    )
    nodes_at_selected_point = nodes[
        np.all(dofs.points[nodes] == all_points[distance_order[distance_rank]], axis=1)
    ]
    watched_vector = np.zeros((dofs.n_nodes_owned_by_rank, dofs.dimension))
    watched_vector[nodes_at_selected_point[:1]] = direction
    return dofs.restrict_to_free(watched_vector.ravel())
