"""Mesh solids with plane cracks.

The solids are boxes, sectors of disks, and parts from CAD files. Cracks are surfaces inside the
solid, whose nodes exist once. They are split like the cracks of a mesh file
(:mod:`fenics_crack.fem.msh_file`). Elements have the length ``mesh.size`` or, at a distance d from
a crack front, the smaller length

    h(d) = h_0 + max(r - 1, 1/3) d,    r = grading^(1 / (lip_elements - 1)).

With h_0, ``lip_elements`` elements in a row reach from the front to the mouth, or to the middle of
an ellipse. Each is r times as long as the previous one. :mod:`fenics_crack.fem.solid_mesher` makes
the mesh. A part's file may be untrusted, so a part is meshed in a separate process.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, report_read_errors
from fenics_crack.basics.gmsh_process import gmsh
from fenics_crack.basics.tables import format_quantity
from fenics_crack.basics.untrusted_files import (
    copy_to_temporary_folder,
    read_first_bytes,
    run_reader_for_arrays,
)
from fenics_crack.fem import compat, solid_mesher
from fenics_crack.fem.blocks import (
    RIM_SIDE_NAMES,
    DiskRim,
    check_cell_count,
    meshing_refusal,
    scale_scene_to_mesh_unit,
)
from fenics_crack.fem.compat import ufl
from fenics_crack.fem.cracks import CRACK_FACE_NAMES, Cracks, NamedParts, are_rows_in
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.nodes import format_point
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Crack

MILLIMETRE = 1e-3
"""Unit of length in which parts from CAD files are meshed [m]."""
FILE_MARK_BY_ENDING = {".brep": b"DBRep_DrawableShape"}
"""Text required in a CAD file's first 4096 bytes, by ending. Files with any other ending must be
STEP."""
ALLOWED_MESHING_SECONDS = 600
"""Maximum processor time for meshing a part [s]."""
ALLOWED_MESHING_BYTES = 2**33
"""Maximum address space for meshing a part [byte]."""
MAX_RELATIVE_DISTANCE_FROM_FRONT_MIDDLE = 0.4
"""Maximum distance from a front's middle at which depth and ligament are measured, relative to the
front's length."""
MAX_CELLS = 2e6
"""Maximum number of cells in a part from a CAD file. gmsh makes about 1e4 cells in a second."""


def mesh_solid(scene: Scene) -> tuple[NamedParts, Cracks]:
    """Mesh a scene's solid into gmsh's current model, with split cracks.

    Returns
    -------
    NamedParts
        gmsh's group tags for the named surfaces.
    Cracks
        Crack surfaces in the scene's order.

    Raises
    ------
    InputError
        A part's file or a crack is unusable, gmsh cannot mesh the solid, or a crack's surface
        cannot be split.
    """
    from fenics_crack.fem.msh_file import load_mesh_into_gmsh, unpack_groups  # it splits cracks

    mesh_array_by_name, metres_per_unit = (
        _mesh_box(scene) if scene.geometry.file is None else _mesh_cad_part(scene)
    )
    gmsh.model.remove()
    gmsh.model.add("fenics_crack")
    try:
        named_surfaces_and_points, crack_surfaces = load_mesh_into_gmsh(
            (
                mesh_array_by_name["numbers"],
                metres_per_unit * mesh_array_by_name["positions"],
                unpack_groups(mesh_array_by_name),
            ),
            3,
        )
    except InputError as error:
        raise meshing_refusal(scene, f"{error.value}") from None
    crack_centres = np.array(
        [crack_surface.triangle_corner_points.mean(axis=(0, 1)) for crack_surface in crack_surfaces]  # type: ignore[union-attr]
    )
    drawn_crack_centres = metres_per_unit * mesh_array_by_name["middles"]
    crack_surface_indices = [
        np.linalg.norm(crack_centres - drawn_crack_centre, axis=1).argmin()
        for drawn_crack_centre in drawn_crack_centres
    ]
    return named_surfaces_and_points, tuple(
        crack_surfaces[crack_surface_index] for crack_surface_index in crack_surface_indices
    )  # type: ignore[return-value]


def read_part_triangles_and_owners(
    part_file: str, length_unit_name: str | None
) -> dict[str, np.ndarray]:
    """Read a CAD part and triangulate the faces, for pictures and measurements.

    ``length_unit_name`` is the file's unit of length, "m", "mm" or "inch"; None: mm.

    Returns
    -------
    dict
        "triangles": corners (n, 3, 3) [m]; "owners": gmsh's number of each triangle's face, (n,).

    Raises
    ------
    InputError
        The file cannot be read, or does not hold a single solid.
    """
    array_by_name = _run_mesher(part_file, {"unit": length_unit_name or "mm"})
    return array_by_name | {"triangles": MILLIMETRE * array_by_name["triangles"]}


def describe_faces_cracks_and_fronts(scene: Scene, structure: Structure) -> dict[str, str]:
    """Describe named faces, crack positions and crack fronts, as text by name (collective).

    A face's text has area and centre. A crack's text has the distance from the point given for the
    crack to the solid's surface. A front's text has the length, the crack's largest depth, and the
    shortest distance ahead to the surface. Depth and distance ahead are measured from nodes in the
    middle 80 % of the front. The surface is approximated by plane facets.
    """
    from fenics_crack.fem.fronts import find_fronts  # takes a while, with SciPy's splines

    assert structure.nodes is not None
    part_mesh, comm, text_by_name = (
        structure.nodes.dolfinx_mesh_and_dofs.part_mesh,
        structure.comm,
        {},
    )  # type: ignore[union-attr]
    scalar_space = compat.function_space(part_mesh.mesh, 1, vectors=False)
    for face_name in sorted(set(part_mesh.tags_by_group) - {*CRACK_FACE_NAMES}):
        node_areas = compat.assembled_vector(
            ufl.TestFunction(scalar_space) * part_mesh.measure_on(face_name)
        )
        node_positions = scalar_space.tabulate_dof_coordinates()[: len(node_areas)]
        face_area = comm.allreduce(node_areas.sum())
        face_centre_text = format_point(
            comm.allreduce(node_areas @ node_positions) / face_area, ".4g"
        )
        text_by_name[f"face {face_name}"] = (
            f"{1e6 * face_area:.4g} mm^2 around {face_centre_text} m"
        )
    nodal_mesh = NodalMesh(structure)
    surface_facets = nodal_mesh.boundary_sides[
        ~are_rows_in(nodal_mesh.boundary_sides, nodal_mesh.crack_face_sides)
    ]
    surface_triangles = nodal_mesh.points[surface_facets]
    text_by_name |= {
        f"{crack_key}.point": (
            f"{format_quantity(crack_point_distances_to_surface.min().round(12), 'm')} from the "
            "surface"
        )
        for crack_key, crack in scene.crack_by_name.items()
        for crack_point_distances_to_surface in solid_mesher.point_to_triangle_distances(
            np.reshape(crack.point or (), (-1, 3)), surface_triangles
        )
    }
    is_through = all(
        crack.depth is None and not crack.radii for crack in scene.crack_by_name.values()
    )
    for front in find_fronts(structure):
        front_node_arc_lengths = np.append(
            0.0, np.linalg.norm(np.diff(front.node_positions, axis=0), axis=1).cumsum()
        )
        is_near_front_middle = front.is_closed | (
            np.abs(front_node_arc_lengths / front_node_arc_lengths[-1] - 0.5)
            <= MAX_RELATIVE_DISTANCE_FROM_FRONT_MIDDLE
        )
        front_nodes_near_middle = front.node_positions[is_near_front_middle]
        front_frames_near_middle = front.frame_and_curvature(
            front.node_parameters[is_near_front_middle]
        )[0]
        shortest_ligament = min(
            (
                find_ray_hit_distance(front_node, front_node_frame[0], surface_triangles)
                for front_node, front_node_frame in zip(
                    front_nodes_near_middle, front_frames_near_middle, strict=True
                )
            ),
            default=np.nan,
        )
        are_corners_in_crack_plane = (
            np.abs((surface_triangles - front.node_positions[0]) @ front.node_normals[0])
            < 1e-6 * nodal_mesh.size
        )
        mouth_triangles = surface_triangles[
            np.any(
                are_corners_in_crack_plane & np.isin(surface_facets, nodal_mesh.crack_face_sides),
                axis=1,
            )
        ]
        mouth_distances = solid_mesher.point_to_triangle_distances(
            front_nodes_near_middle, mouth_triangles
        )
        largest_crack_depth = mouth_distances.min(axis=1, initial=np.inf).max(initial=0.0)
        crack_depth_text = (
            f"{format_quantity(largest_crack_depth, 'm')} deep, "
            if 0.0 < largest_crack_depth < np.inf and not is_through
            else ""
        )
        text_by_name[front.name] = (
            f"{format_quantity(float(front_node_arc_lengths[-1]), 'm')} long, {crack_depth_text}"
            f"with at least {format_quantity(shortest_ligament, 'm')} of material straight ahead"
        )
    return text_by_name


def find_ray_hit_distance(point: np.ndarray, direction: np.ndarray, triangles: np.ndarray) -> float:
    """Return the distance from a point to the first triangle along a ray [m].

    Without a hit, the result is the largest extent of all triangles along x, y or z.

    Parameters
    ----------
    point : (3,) [m]
        Start of the ray. Triangles at this point do not count.
    direction : (3,)
        Unit vector along the ray.
    triangles : (n, 3, 3) [m]
        Corners of the triangles.
    """
    side_1, side_2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    direction_cross_side_2 = np.cross(direction, side_2)
    determinants = (side_1 * direction_cross_side_2).sum(axis=1)
    determinants = np.where(np.abs(determinants) < 1e-300, np.inf, determinants)
    offsets_from_triangles = point - triangles[:, 0]
    u = (offsets_from_triangles * direction_cross_side_2).sum(axis=1) / determinants
    offset_cross_side_1 = np.cross(offsets_from_triangles, side_1)
    v = offset_cross_side_1 @ direction / determinants
    hit_distances = (side_2 * offset_cross_side_1).sum(axis=1) / determinants
    longest_box_side = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    is_hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (hit_distances > 1e-6 * longest_box_side)
    return float(hit_distances[is_hit].min(initial=longest_box_side))


def find_section_ahead(scene: Scene) -> float:
    """Return how thick a part is straight ahead of the first crack, from its point [m].

    The section is measured on the file's triangles, along the crack's depth.
    """
    crack = _make_mesher_cracks(scene, 1.0)[0]
    geometry, depth_direction = scene.geometry, np.array(crack["frame"][1])
    triangles = read_part_triangles_and_owners(str(geometry.file), geometry.unit)["triangles"]
    return min(
        find_ray_hit_distance(np.array(crack["middle"]), direction, triangles)
        for direction in (depth_direction, -depth_direction)
    )


def find_reaches_from_crack_middle(scene: Scene) -> tuple[float, float]:
    """Measure how far the solid reaches from the first crack's middle, in the crack's plane.

    Returns
    -------
    float [m]
        Largest distance behind the middle, measured along the crack's direction e_1.
    float [m]
        Largest distance ahead of the middle, measured along e_1. Both are >= 0.
    """
    crack, geometry = _make_mesher_cracks(scene, 1.0)[0], scene.geometry
    solid_surface_triangles = (
        np.array(
            [
                *combinations(
                    product(*((0.0, box_side_length) for box_side_length in geometry.sides)), 3
                )
            ]
        )
        if geometry.file is None
        else read_part_triangles_and_owners(str(geometry.file), geometry.unit)["triangles"]
    )
    corner_x, _, corner_heights_above_crack = np.moveaxis(
        (solid_surface_triangles - crack["middle"]) @ np.transpose(crack["frame"]), -1, 0
    )
    x_difference_along_triangle_side, height_difference_along_side = (
        np.roll(corner_coordinates, -1, axis=1) - corner_coordinates
        for corner_coordinates in (corner_x, corner_heights_above_crack)
    )
    does_side_cross_crack_plane = (
        corner_heights_above_crack * (corner_heights_above_crack + height_difference_along_side)
        <= 0.0
    ) & (height_difference_along_side != 0.0)
    x_of_crack_plane_crossings = (
        corner_x
        - corner_heights_above_crack
        * x_difference_along_triangle_side
        / np.where(does_side_cross_crack_plane, height_difference_along_side, 1.0)
    )[does_side_cross_crack_plane]
    return -float(x_of_crack_plane_crossings.min(initial=0.0)), float(
        x_of_crack_plane_crossings.max(initial=0.0)
    )


def _mesh_cad_part(scene: Scene) -> tuple[dict[str, np.ndarray], float]:
    """Mesh a scene's CAD part in a separate process.

    Returns
    -------
    dict
        Arrays of :func:`fenics_crack.fem.solid_mesher.collect_mesh`.
    float
        Unit of length in the arrays [m].
    """
    scene_in_mesh_units, metres_per_unit = scale_scene_to_mesh_unit(scene, MILLIMETRE)
    geometry, mesh = scene.geometry, scene_in_mesh_units.mesh
    keys_and_face_points = [
        (face.key, face_point) for face in geometry.faces for face_point in face.values
    ]
    mesher_request = {
        "unit": geometry.unit or "mm", "size": mesh.size, "per_turn": mesh.per_turn,
        "faces": [
            (face_key, np.divide(point_on_face, metres_per_unit).tolist()) for face_key,
            point_on_face in keys_and_face_points
        ],
        "cracks": _make_mesher_cracks(scene_in_mesh_units, metres_per_unit), "cells": MAX_CELLS,
    }  # fmt: skip
    return _run_mesher(str(geometry.file), mesher_request, scene), metres_per_unit


def _run_mesher(
    path: str, mesher_request: dict[str, Any], scene: Scene | None = None
) -> dict[str, np.ndarray]:
    """Run ``solid_mesher.py`` on a copy of a CAD file, alone in a folder, in a separate process.

    Parameters
    ----------
    path : str
        CAD file.
    mesher_request : dict
        Argument ``request`` of :func:`fenics_crack.fem.solid_mesher.read`.
    scene : Scene, optional
        Scene with the file. If the mesher refuses a key's value, the error shows the value in the
        scene. Default: the error shows the path.

    Returns
    -------
    dict
        Arrays that :func:`fenics_crack.fem.solid_mesher.read` returns.

    Raises
    ------
    InputError
        The file is unusable, a key's value is refused, or the mesher takes more than 600 s or 8
        GiB.
    """
    file_ending = Path(path).suffix.lower()
    with (
        report_read_errors(
            "geometry.file", path, "a CAD file with a part that gmsh can read and mesh"
        ),
        copy_to_temporary_folder(path, f"part{file_ending}") as file_copy,
    ):
        if FILE_MARK_BY_ENDING.get(file_ending, b"ISO-10303-21") not in read_first_bytes(
            file_copy, 4096
        ):
            raise ValueError("it does not begin as a STEP or BREP file")
        array_by_name = run_reader_for_arrays(
            Path(solid_mesher.__file__),
            file_copy,
            ALLOWED_MESHING_SECONDS,
            ALLOWED_MESHING_BYTES,
            request=mesher_request,
        )
        if isinstance(array_by_name, str):
            raise ValueError(array_by_name.replace(str(file_copy), path))
    if "refused" in array_by_name:
        refused_key, requirement = map(str, array_by_name["refused"])
        raise InputError(
            refused_key,
            path if scene is None else _value_for_message(scene, refused_key),
            requirement.replace(str(file_copy), path),
        )
    return array_by_name


def _value_for_message(scene: Scene, key: str) -> object:
    """Return a scene's value for an error message.

    ``key`` is "table.field", as "mesh.size". The value of a field "faces" is a list of tables; in
    the result each table is replaced by its key.
    """
    table_name, _, field_name = key.rpartition(".")
    value = getattr(scene.crack_by_name.get(table_name) or getattr(scene, table_name), field_name)
    return [face_table.key for face_table in value] if field_name == "faces" else value


def _make_mesher_cracks(scene: Scene, metres_per_unit: float) -> list[dict[str, Any]]:
    """Convert a scene's cracks to dicts for :func:`fenics_crack.fem.solid_mesher.insert_cracks`.

    The scene's lengths must be in the mesh's unit already. ``metres_per_unit`` is the mesh's unit
    [m], and becomes the entry "unit" of each dict.
    """
    mesher_cracks = []
    for crack_key, crack in scene.crack_by_name.items():
        if crack.point is None:
            geometry_fields = _make_box_crack_geometry(crack, scene.geometry.sides)
        else:
            ellipse_half_axes = crack.half_axes if crack.front != "through" else None
            offset_from_point_to_crack_middle = (
                (crack.length or 0.0) * crack.frame[0] * (ellipse_half_axes is None)
            )
            geometry_fields = {
                "middle": (crack.point + offset_from_point_to_crack_middle).tolist(),
                "frame": crack.frame.tolist(),
                "half": ellipse_half_axes, "is_round": ellipse_half_axes is not None,
                "reach": ellipse_half_axes and min(ellipse_half_axes),
            }  # fmt: skip
        given_crack_size_keys = (
            size_key
            for size_key in ("radii", "depth", "length")
            if getattr(crack, size_key) is not None
        )
        mesher_cracks.append({
            "key": crack_key, "shape": next(given_crack_size_keys, "point"),
            "unit": metres_per_unit,
            **geometry_fields,
            "elements": scene.mesh.given("lip_elements"), "grading": scene.mesh.grading,
        })  # fmt: skip
    return mesher_cracks


def _make_box_crack_geometry(crack: Crack, box_sides: Sequence[float]) -> dict[str, Any]:
    """Return position and shape of a crack in a box, in the plane y = ``crack.height``.

    The crack is an ellipse or a rectangle with its centre on the face z = thickness. ``box_sides``
    are the box's width, height and thickness, in the mesh's unit.

    Returns
    -------
    dict
        Keys "middle", "half", "frame", "is_round" and "reach", as described in
        :func:`fenics_crack.fem.solid_mesher.insert_cracks`.
    """
    width, _, thickness = box_sides
    left_end, right_end = crack.span(width)
    center_x, x_half_axis = 0.5 * (left_end + right_end), 0.5 * (right_end - left_end)
    if crack.edge is not None:
        center_x, x_half_axis = (0.0 if crack.edge == "left" else width), right_end - left_end
    depth = crack.depth or 2.0 * thickness
    return {
        "middle": [center_x, crack.given("height"), thickness], "half": [x_half_axis, depth],
        "frame": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        "is_round": crack.front == "elliptical",
        "reach": min(x_half_axis, crack.depth or x_half_axis),
    }  # fmt: skip


def _mesh_box(scene: Scene) -> tuple[dict[str, np.ndarray], float]:
    """Mesh a box or a disk's sector in this process.

    Returns
    -------
    dict
        Arrays of :func:`fenics_crack.fem.solid_mesher.collect_mesh`.
    float
        Unit of length in the arrays [m].

    Raises
    ------
    InputError
        A crack is unusable, there would be too many cells, or gmsh fails.
    """
    scene_in_mesh_units, metres_per_unit = scale_scene_to_mesh_unit(scene)
    width, height, thickness = box_size = scene_in_mesh_units.geometry.sides
    occ, disk_rim_or_none = (
        gmsh.model.occ,
        None if scene.disk is None else DiskRim(scene_in_mesh_units),
    )
    solid_dim_tags = (
        [(3, occ.addBox(0.0, 0.0, 0.0, *box_size))]
        if disk_rim_or_none is None
        else disk_rim_or_none.draw_with_blade(*box_size)
    )
    occ.synchronize()
    coarse_face_triangles = np.zeros((0, 3, 3))
    if any(crack.point is not None for crack in scene.crack_by_name.values()):
        coarse_face_triangles, _ = solid_mesher.triangulate_faces_coarsely()
    try:
        crack_surface_tags, fronts = solid_mesher.insert_cracks(
            solid_dim_tags,
            _make_mesher_cracks(scene_in_mesh_units, metres_per_unit),
            coarse_face_triangles,
        )
    except solid_mesher.Refusal as refusal:
        refused_key, requirement = refusal.args
        if (value_in_message := _value_for_message(scene, refused_key)) is None:
            raise meshing_refusal(scene, requirement) from None
        raise InputError(refused_key, value_in_message, requirement) from None
    _check_cell_number(scene, metres_per_unit, fronts)
    box_side_planes = [
        ("left", 0, 0.0), ("right", 0, width), ("clamp", 1, 0.0), ("top", 1, height),
        ("back", 2, 0.0), ("front", 2, thickness),
    ]  # fmt: skip
    surface_tags_by_name: dict[str, list[int]] = {"clamp": []}
    for _, surface_tag in gmsh.model.getEntities(2):
        face_center = occ.getCenterOfMass(2, surface_tag)
        if disk_rim_or_none is not None and face_center[1] < 0.0:
            surface_name = disk_rim_or_none.name_of(face_center)
        else:
            surface_name = min(
                box_side_planes, key=lambda plane: abs(face_center[plane[1]] - plane[2])
            )[0]
        if surface_tag not in crack_surface_tags:
            surface_tags_by_name.setdefault(surface_name, []).append(surface_tag)
    if disk_rim_or_none is not None:
        disk_rim_or_none.set_periodic(
            2, *(surface_tags_by_name[surface_name] for surface_name in RIM_SIDE_NAMES)
        )
    try:
        solid_mesher.generate_mesh(scene_in_mesh_units.mesh.given("size"), fronts)
    except Exception as error:  # gmsh raises nothing else
        raise meshing_refusal(scene, str(error)) from None
    return solid_mesher.collect_mesh(crack_surface_tags, surface_tags_by_name), metres_per_unit


def _check_cell_number(scene: Scene, metres_per_unit: float, fronts: list[dict[str, Any]]) -> None:
    """Raise InputError if gmsh would make too many cells (:func:`check_cell_count`).

    ``metres_per_unit`` [m] is the mesh's unit of length. ``fronts`` come from
    :func:`fenics_crack.fem.solid_mesher.insert_cracks`, in this unit.
    """
    n_bulk_cells, n_front_cells = solid_mesher.estimate_bulk_and_front_cells(
        scene.mesh.given("size") / metres_per_unit, fronts
    )
    size_key, size_note = "size", ""
    if n_front_cells > n_bulk_cells:
        shortest_element_length = metres_per_unit * min(front["shortest"] for front in fronts)
        size_key, size_note = (
            "lip_elements",
            f", at a crack's front {shortest_element_length:.2g} m long",
        )
    check_cell_count(
        scene, size_key, n_bulk_cells + n_front_cells, scene.mesh.order**3 // 2, size_note
    )
