"""Match the sides of a bladed disk's sector, and assemble the wheel.

A turn by 2 pi / N about the axis, in either direction, maps the left side to the right side, node
by node. Displacements on the right side are in the frame of the next sector. In sectors without a
crack, coincident nodes of both crack faces are bonded.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.disk.cyclic import Sector
from fenics_crack.disk.wheel import Wheel
from fenics_crack.fem.blocks import RIM_SIDE_NAMES
from fenics_crack.fem.cracks import CRACK_FACE_NAMES, RELATIVE_POSITION_TOLERANCE
from fenics_crack.fem.elasticity import assemble_rotation
from fenics_crack.fem.plate import Dofs
from fenics_crack.model.modes import multiply_columns
from fenics_crack.model.nodes import format_point
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene


def assemble_wheel(scene: Scene, dofs: Dofs, structure: Structure, comm: MPI.Comm) -> Wheel:
    """Assemble a bladed disk from a meshed sector (collective).

    ``dofs`` and ``structure`` describe this sector, complete on every rank. With a rotor speed
    the sector gets the centrifugal load and the stiffness at this speed.

    Raises
    ------
    InputError
        The crack reaches a side, the nodes on both crack faces do not match, or the wheel is
        unstable at this speed.
    """
    disk = scene.given("disk")
    sector, rotation_terms = _make_sector(scene, dofs, structure), None
    if scene.speed > 0.0:
        # The load is the same on all sectors.
        with sector.yield_zero_diameter_solver() as zero_diameter_solver:
            rotation_terms = assemble_rotation(
                scene, dofs, structure, zero_diameter_solver.static_response
            )
        static_shape_stiffness, motion_stiffness = rotation_terms.static_and_motion_stiffness(
            scene.speed
        )
        # The static displacement u_s and its stress are computed with bonded cracks. Then the load
        # is replaced by K(W) u_s, with the full stiffness of the displaced shape, and opens cracks.
        load_fourier_coefficients, centrifugal_load = (
            structure.force.copy(),
            scene.speed**2 * rotation_terms.force,
        )
        stiffened_sector = replace(
            sector,
            structure=structure._plain_structure_with_changes(stiffness=static_shape_stiffness),
        )
        with stiffened_sector.yield_zero_diameter_solver() as zero_diameter_solver:
            static_displacement = zero_diameter_solver.static_response(centrifugal_load[:, None])
        load_fourier_coefficients[0] += (
            centrifugal_load
            + (
                multiply_columns(motion_stiffness, static_displacement)
                - multiply_columns(static_shape_stiffness, static_displacement)
            )[:, 0]
        )
        rotating_structure = structure._plain_structure_with_changes(
            stiffness=motion_stiffness, force=load_fourier_coefficients
        )
        sector = replace(sector, structure=rotating_structure)
    return Wheel(
        sector, cracked=[sector_number - 1 for sector_number in disk.cracked],
        mistuning=disk.deviations, order=scene.excitation.order or 0, families=disk.families,
        rotation=rotation_terms, comm=comm,
    )  # fmt: skip


def record_matched_side_nodes(scene: Scene, dofs: Dofs) -> None:
    """Match the nodes on a sector's left and right side.

    ``dofs`` records the node pairs. Either direction of rotation about the axis may map left to
    right. From then on, displacements on the right side are in the frame of the next sector.

    Raises
    ------
    InputError
        The mesh has no sides, the nodes on both sides do not match, or the sector reaches the axis.
    """
    from scipy.spatial.transform import Rotation  # only meshes of sectors need it

    disk, (center, axis_direction) = scene.given("disk"), scene.axis_point_and_direction
    mesh_node_points, mesh_extent = dofs.points, float(np.ptp(dofs.points, axis=0).max())
    side_names = (
        RIM_SIDE_NAMES if RIM_SIDE_NAMES[0] in dofs.part_mesh.tags_by_group else ("left", "right")
    )
    for side_name in side_names:
        if side_name not in dofs.part_mesh.tags_by_group:
            raise InputError(
                "mesh.file",
                scene.mesh.file,
                "the mesh of a sector with the physical groups 'left' and 'right' on the sides; it "
                f"has no {side_name!r}",
            )
    left_nodes, right_nodes = (dofs.nodes_on(side_name) for side_name in side_names)
    mesh_node_points_in_3d = np.pad(mesh_node_points, ((0, 0), (0, 3 - mesh_node_points.shape[1])))
    turn_angles = (2.0 * math.pi / disk.sectors, -2.0 * math.pi / disk.sectors)
    rotation_matrices = [
        Rotation.from_rotvec(turn_angle * axis_direction).as_matrix() for turn_angle in turn_angles
    ]
    matches_by_turn_direction = [
        _find_partners_and_largest_distance(
            (mesh_node_points_in_3d[left_nodes] - center) @ rotation_matrix.T + center,
            mesh_node_points_in_3d[right_nodes],
        )
        for rotation_matrix in rotation_matrices
    ]
    (largest_distance, worst_node_index, right_partner_indices), rotation_matrix = min(
        zip(matches_by_turn_direction, rotation_matrices, strict=True),
        key=lambda match_and_rotation: match_and_rotation[0][0],
    )
    if largest_distance > RELATIVE_POSITION_TOLERANCE * mesh_extent:
        node_position_text = format_point(mesh_node_points[left_nodes[worst_node_index]])
        distance_text = (
            f"is {largest_distance:.2g} m from the nearest right one"
            if math.isfinite(largest_distance)
            else "has no partner"
        )
        requirement_text = (
            f"a sector whose left side, turned about the axis by 360/{disk.sectors} degrees, is "
            f"the right side: the left one has {len(left_nodes)} nodes, the right one "
            f"{len(right_nodes)}; the left node at {node_position_text} m {distance_text}"
        )
        scene_key_in_error = "mesh.file" if side_names[0] == "left" else "disk"
        raise InputError(scene_key_in_error, scene.mesh.file or "a table", requirement_text)
    if len(common_nodes := np.intersect1d(left_nodes, right_nodes)):
        node_position_text = format_point(mesh_node_points[common_nodes[0]])
        raise InputError(
            "mesh.file",
            scene.mesh.file,
            f"a sector that does not reach the axis, as at the node {node_position_text} m",
        )
    dimension = mesh_node_points.shape[1]
    dofs.set_sector_sides(
        np.array([left_nodes, right_nodes[right_partner_indices]]),
        rotation_matrix[:dimension, :dimension],
    )


def _make_sector(scene: Scene, dofs: Dofs, structure: Structure) -> Sector:
    """Make the sector with matched nodes on sides and crack faces.

    Raises
    ------
    InputError
        The crack reaches a side, or the nodes on both crack faces do not match.
    """
    mesh_node_points, sector_side_node_pairs = dofs.points, dofs.sector_side_node_pairs
    node_rotations = dofs.frame_to_space_rotation_by_node
    assert sector_side_node_pairs is not None and node_rotations is not None
    crack_face_nodes = np.zeros((2, 0), dtype=int)
    if dofs.part_mesh.has_cracks:  # tips belong to both faces and need no bond
        lower_crack_face_nodes, upper_crack_face_nodes = (
            dofs.nodes_on(crack_face_name) for crack_face_name in CRACK_FACE_NAMES
        )
        lower_crack_face_nodes, upper_crack_face_nodes = (
            np.setdiff1d(lower_crack_face_nodes, upper_crack_face_nodes),
            np.setdiff1d(upper_crack_face_nodes, lower_crack_face_nodes),
        )
        largest_distance, worst_node_index, upper_partner_indices = (
            _find_partners_and_largest_distance(
                mesh_node_points[lower_crack_face_nodes], mesh_node_points[upper_crack_face_nodes]
            )
        )
        if largest_distance > RELATIVE_POSITION_TOLERANCE * float(
            np.ptp(mesh_node_points, axis=0).max()
        ):
            node_position_text = format_point(
                mesh_node_points[lower_crack_face_nodes[worst_node_index]]
            )
            raise InputError(
                "lips",
                f"{len(lower_crack_face_nodes)} lower and {len(upper_crack_face_nodes)} upper "
                "nodes",
                f"crack faces with the same nodes; these differ at {node_position_text} m",
            )
        crack_face_nodes = np.array(
            [lower_crack_face_nodes, upper_crack_face_nodes[upper_partner_indices]]
        )
    if len(common_nodes := np.intersect1d(crack_face_nodes, sector_side_node_pairs)):
        node_position_text = format_point(mesh_node_points[common_nodes[0]])
        raise InputError(
            "lips",
            "a crack",
            f"one inside the sector; it reaches a side of the sector at {node_position_text} m",
        )
    center = scene.axis_point_and_direction[0][: mesh_node_points.shape[1]]
    rotation_matrix = node_rotations[sector_side_node_pairs[1, 0]]
    return Sector(
        structure,
        scene.given("disk").sectors,
        center,
        rotation_matrix,
        sector_side_node_pairs,
        crack_face_nodes,
        structure.stiffness,
    )


def _find_partners_and_largest_distance(
    points: np.ndarray, candidates: np.ndarray
) -> tuple[float, int, np.ndarray]:
    """Match points (n, d) [m] one to one with candidate points (m, d) [m].

    Returns
    -------
    float
        Largest distance [m] from a point to the point's partner. If two points have the same
        partner, or n is not m, the distance is inf.
    int
        Index of the point with the largest distance.
    (n,) int
        Index of each point's partner, the nearest candidate.
    """
    from scipy.spatial import cKDTree

    distances, partner_indices = cKDTree(candidates).query(points)
    worst_point_index = int(np.argmax(distances))
    is_not_one_to_one = len(candidates) != len(points) or len(np.unique(partner_indices)) != len(
        partner_indices
    )
    return (
        (math.inf if is_not_one_to_one else float(distances[worst_point_index])),
        worst_point_index,
        partner_indices,
    )
