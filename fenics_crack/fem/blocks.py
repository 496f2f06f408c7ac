"""Mesh cracked plates, and the rims below a disk's blades, with gmsh.

Plates
------
A plate is cut into blocks at all tips and along all cracks. One edge crack gives four blocks:

    mouth side  +-----------+---------------+
                |           |               |      upper blocks
                +===upper===+---ligament----+
                +===lower===+---------------+
                |           tip             |      lower blocks
                +-----------+---------------+
                    clamped (y = 0)

So both crack faces have identical nodes, and quadrilaterals can be graded towards the tip block by
block (:mod:`fenics_crack.fem.grading`). The uniform grid (``mesh.layout = "grid"``) is a special
case.

Sectors of a disk
-----------------
A graded sector of a plane disk has triangles. Around the tips they are as long as tetrahedra around
the fronts of solids (:mod:`fenics_crack.fem.solid`). Around the corners between blade and rim, h_0
= ``mesh.size`` / 32, and the slope is ``mesh.size`` over the blade's width. So all lengths scale
with ``mesh.size``.

Unit of length
--------------
gmsh's tolerances are lengths. So everything is drawn in a unit in which a scene in mm has the same
mesh as one in m (:func:`scale_scene_to_mesh_unit`). The nodes are scaled afterwards.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.gmsh_process import gmsh
from fenics_crack.basics.machine import machine_memory
from fenics_crack.fem import solid_mesher
from fenics_crack.fem.cracks import CrackPath, Cracks, NamedParts
from fenics_crack.fem.grading import (
    ElementInterval,
    PointGrading,
    Slit,
    crack_tip_gradings,
    find_plate_columns_rows_and_slits,
)
from fenics_crack.model.factor import estimate_factor_bytes
from fenics_crack.scene.scene import Scene


def check_cell_count(
    scene: Scene, mesh_key: str, n_cells: float, dofs_per_cell: int, size_note: str = ""
) -> None:
    """Raise InputError if a mesh would have too many cells for gmsh or the memory.

    gmsh is allowed 5e6 cells. The mesh with the matrices must fit into the machine's memory, and so
    must the factored stiffness.

    Parameters
    ----------
    scene : Scene
        Scene to mesh.
    mesh_key : str
        Key in the scene's table ``[mesh]`` to name in the error, as "size".
    n_cells : float
        Estimated number of cells.
    dofs_per_cell : int
        Average number of dofs per cell.
    size_note : str
        Text for the error message, behind "fewer cells". Used to state the shortest element's
        length.
    """
    n_dofs, max_n_cells_for_gmsh = (
        dofs_per_cell * n_cells,
        5e6,
    )  # a mesh file may have any number of cells
    factor_bytes = estimate_factor_bytes(n_dofs, solid=scene.dimension == 3)
    assembled_bytes = 1500.0 * n_dofs  # bytes of mesh and matrices
    needed_bytes, machine_bytes = max(assembled_bytes, factor_bytes), machine_memory()
    refusal_reason = f"{n_cells:.2g} cells are more than {max_n_cells_for_gmsh:.0e}"
    if n_cells <= max_n_cells_for_gmsh:
        memory_text = (
            f"{needed_bytes / 2**30:.0f} GiB, but this machine has {machine_bytes / 2**30:.3g} GiB"
        )
        refusal_reason = f"to solve {n_cells:.2g} cells takes about {memory_text}"
    if n_cells > max_n_cells_for_gmsh or needed_bytes > machine_bytes:
        requirement = f"such that the mesh has fewer cells{size_note}: {refusal_reason}"
        raise InputError(f"mesh.{mesh_key}", getattr(scene.mesh, mesh_key), requirement)


def _element_length_off_cracks(scene: Scene) -> float:
    """Return the element length away from cracks, ``mesh.size`` [m].

    For a grid the result is the plate's height over ``mesh.rows``.
    """
    return scene.mesh.size or scene.geometry.sides[1] / scene.mesh.given("rows")


# --- the unit of length ---------------------------------------------------------------------------


def scale_scene_to_mesh_unit(scene: Scene, metres_per_unit: float = 0.0) -> tuple[Scene, float]:
    """Convert a scene's lengths from metres to gmsh's unit.

    Used because gmsh's tolerances are fixed lengths. ``metres_per_unit`` is the unit [m]. 0 selects
    a power of ten: the longest side then measures 0.0316 to 0.316 units.

    Returns
    -------
    Scene
        Copy with all lengths divided by the unit.
    float
        Unit [m].
    """
    metres_per_unit = metres_per_unit or 10.0 ** (round(math.log10(max(scene.geometry.sides))) + 1)

    def scale_table(table: Any) -> Any:
        """Divide all lengths in a scene's table by the unit."""
        scaled_length_by_name = {
            field.name: np.divide(value, metres_per_unit).tolist()
            for field in fields(table)
            if field.metadata.get("unit") == "m"
            and (value := getattr(table, field.name)) is not None
        }
        return replace(table, **scaled_length_by_name)

    unit_scene = copy(scene)  # similar to the scene, so its checks hold
    for table_name in ("geometry", "mesh", "crack", "disk", "excitation"):
        vars(unit_scene)[table_name] = getattr(scene, table_name) and scale_table(
            getattr(scene, table_name)
        )
    vars(unit_scene)["cracks"] = tuple(map(scale_table, scene.cracks))
    return unit_scene, metres_per_unit


def _scale_nodes(metres_per_unit: float) -> None:
    """Convert the node positions in gmsh's current model to metres."""
    if metres_per_unit != 1.0:
        node_numbers, node_positions, _ = gmsh.model.mesh.getNodes()
        for node_number, node_position in zip(
            node_numbers, metres_per_unit * node_positions.reshape(-1, 3), strict=True
        ):
            gmsh.model.mesh.setNode(node_number, node_position, [])


# --- a plate --------------------------------------------------------------------------------------


def mesh_plate(scene: Scene) -> tuple[NamedParts, Cracks]:
    """Mesh a scene's plate into gmsh's current model.

    Returns
    -------
    NamedParts
        gmsh's group tags for the named sides, and no named points.
    Cracks
        Crack paths in the scene's order.
    """
    unit_scene, metres_per_unit = scale_scene_to_mesh_unit(scene)
    facet_tags_by_group = _draw_blocks(scene, unit_scene)
    if scene.has_graded_lengths:
        disk_rim = DiskRim(unit_scene)
        get_group_entities = gmsh.model.getEntitiesForPhysicalGroup
        rim_left_curves, rim_right_curves = (
            get_group_entities(1, *facet_tags_by_group[rim_side_name]).tolist()
            for rim_side_name in RIM_SIDE_NAMES
        )
        disk_rim.set_periodic(0, rim_left_curves, rim_right_curves)
        _mesh_current_model_with_gradings(
            scene, unit_scene, [*crack_tip_gradings(unit_scene), *disk_rim.blade_corner_gradings()]
        )
        # The mesh is made: end the periodicity.
        gmsh.model.mesh.setPeriodic(
            1, rim_right_curves, rim_right_curves, np.eye(4).ravel().tolist()
        )
    else:
        gmsh.model.mesh.generate(2)
    _scale_nodes(metres_per_unit)
    return (facet_tags_by_group, {}), _crack_paths(scene)


def _crack_paths(scene: Scene) -> tuple[CrackPath, ...]:
    """Return a plate's crack paths, in the scene's order.

    A path runs from the mouth to the tip, or from left to right for a crack inside.
    """
    width, crack_paths = scene.geometry.sides[0], []
    for crack in scene.crack_by_name.values():
        left_end, right_end = ((end_x, crack.given("height")) for end_x in crack.span(width))
        path_ends = (right_end, left_end) if crack.edge == "right" else (left_end, right_end)
        crack_paths.append(CrackPath(np.array(path_ends), crack.edge is not None))
    return tuple(crack_paths)


def _draw_blocks(scene: Scene, unit_scene: Scene) -> dict[str, tuple[int, ...]]:
    """Draw a plate's blocks in gmsh, and set the number of elements on all block sides.

    ``scene`` has lengths in metres, ``unit_scene`` the same lengths in gmsh's unit.

    Returns
    -------
    dict of str to (int,)
        gmsh's group tag for each named side of the plate, crack face or rim side.
    """
    _check_plate_cell_count(scene)
    column_intervals, row_intervals, slits = find_plate_columns_rows_and_slits(unit_scene)
    rim = None if unit_scene.disk is None else DiskRim(unit_scene)
    xs, ys = (
        [0.0, *(interval.stop for interval in intervals)]
        for intervals in (column_intervals, row_intervals)
    )
    add_point = gmsh.model.geo.addPoint
    foot_heights = [0.0 if rim is None else rim.foot_height(x) for x in xs]
    corners = {
        (column_index, row_index): add_point(x, y if row_index else foot_heights[column_index], 0.0)
        for column_index, x in enumerate(xs)
        for row_index, y in enumerate(ys)
    }
    doubled_corner_indices = _find_doubled_corner_indices(slits, len(column_intervals))
    upper_corner_by_ij = {
        (column_index, row_index): add_point(xs[column_index], ys[row_index], 0.0)
        for column_index, row_index in doubled_corner_indices
    }
    bottom_corner_by_ij = corners | upper_corner_by_ij  # corners of blocks above a crack

    horizontal_curves, vertical_curves = {}, {}
    upper_face_interval_by_ij = {
        (column_index, row): column_intervals[column_index]
        for row, crack_columns in slits
        for column_index in crack_columns
    }
    if scene.has_graded_lengths:  # only crack faces have a number of elements
        column_intervals, row_intervals = (
            [replace(interval, n_elements=0) for interval in intervals]
            for intervals in (column_intervals, row_intervals)
        )
    for column_index, column_interval in enumerate(column_intervals):
        for row_index in range(len(ys)):
            horizontal_curves[column_index, row_index] = _add_curve(
                corners[column_index, row_index],
                corners[column_index + 1, row_index],
                upper_face_interval_by_ij.get((column_index, row_index), column_interval),
            )
    for row_index, row_interval in enumerate(row_intervals):
        for column_index in range(len(xs)):
            vertical_curves[column_index, row_index] = _add_curve(
                bottom_corner_by_ij[column_index, row_index],
                corners[column_index, row_index + 1],
                row_interval,
            )
    upper_crack_face_curves = {
        (column_index, row_index): _add_curve(
            bottom_corner_by_ij[column_index, row_index],
            bottom_corner_by_ij[column_index + 1, row_index],
            interval,
        )
        for (column_index, row_index), interval in upper_face_interval_by_ij.items()
    }
    surfaces = _add_surfaces(
        len(column_intervals),
        len(row_intervals),
        horizontal_curves,
        vertical_curves,
        upper_crack_face_curves,
    )
    foot_curves = [
        horizontal_curves[column_index, 0] for column_index in range(len(column_intervals))
    ]
    sides: dict[str, tuple[int, list[int]]] = {"clamp": (1, foot_curves)}
    if rim is not None:
        sides = rim.draw(
            [corners[column_index, 0] for column_index in range(len(xs))],
            foot_curves,
            column_intervals,
            surfaces,
        )
    _set_cell_kind(scene, surfaces)

    left_curves, right_curves = (
        [vertical_curves[column_index, row_index] for row_index in range(len(row_intervals))]
        for column_index in (0, len(column_intervals))
    )
    single_corner_indices = [
        corner_column_and_row
        for corner_column_and_row in corners
        if corner_column_and_row not in doubled_corner_indices
    ]
    load_position = unit_scene.excitation.point
    load_point_tags = [
        corners[column_index, row_index]
        for column_index, row_index in single_corner_indices
        if (xs[column_index], ys[row_index]) == load_position
    ]
    groups: dict[str, tuple[int, list[int]]] = {
        "plate": (2, surfaces),
        **sides,
        "lower_lip": (
            1,
            [horizontal_curves[block_indices] for block_indices in upper_crack_face_curves],
        ),
        "upper_lip": (1, list(upper_crack_face_curves.values())),
        "load": (0, load_point_tags),
        "left": (1, left_curves),
        "right": (1, right_curves),
        "top": (
            1,
            [
                horizontal_curves[column_index, len(row_intervals)]
                for column_index in range(len(column_intervals))
            ],
        ),
    }
    group_tag_by_side_name = {
        name: group_tag
        for name, group_tag in _add_groups_and_find_tags(groups).items()
        if groups[name][0] == 1
    }
    if rim is None:
        group_tag_by_side_name["bottom"] = group_tag_by_side_name["clamp"]
    return {name: (group_tag,) for name, group_tag in group_tag_by_side_name.items()}


def _check_plate_cell_count(scene: Scene) -> None:
    """Raise InputError if a plate would have too many cells (:func:`check_cell_count`)."""
    columns, rows, _ = find_plate_columns_rows_and_slits(scene)
    n_cells: float = math.prod(
        sum(interval.n_elements for interval in intervals) for intervals in (columns, rows)
    )
    if scene.disk is not None:
        n_cells += DiskRim(scene).area / _element_length_off_cracks(scene) ** 2
    mesh_key = "columns" if scene.mesh.layout == "grid" else "size"
    check_cell_count(scene, mesh_key, n_cells, 2 * scene.mesh.order**2)


def _find_doubled_corner_indices(slits: list[Slit], n_columns: int) -> list[tuple[int, int]]:
    """Return the block corners on cracks, except at tips, as (column, row) of the corner.

    At these corners each crack face has a separate point. An end of a crack at the plate's edge is
    a mouth, not a tip.

    Parameters
    ----------
    slits : list of (row, columns)
        For each crack: index of the block row above the crack, and range of the block columns along
        the crack.
    n_columns : int
        Number of block columns in the plate.
    """
    return [
        (i, row)
        for row, crack_columns in slits
        for i in range(
            crack_columns.start + (crack_columns.start > 0),
            crack_columns.stop + (crack_columns.stop == n_columns),
        )
    ]


Curves = dict[tuple[int, int], int]
"""gmsh's tags of block sides, by column and row of the block."""


def _add_surfaces(
    n_columns: int,
    n_rows: int,
    horizontal_by_ij: Curves,
    vertical_by_ij: Curves,
    upper_by_ij: Curves,
) -> list[int]:
    """Add the surface of each block to gmsh, and return gmsh's tags, column by column.

    Parameters
    ----------
    n_columns, n_rows : int
        Number of blocks across and along the plate.
    horizontal_by_ij, vertical_by_ij : Curves
        gmsh's tags for the blocks' lower sides and left sides, by (column, row). The plate's upper
        and right sides are included, with the index after the last block.
    upper_by_ij : Curves
        gmsh's tags for the upper crack faces, by (column, row) of the block above. Used as
        lower sides of the blocks above cracks.
    """
    surfaces = []
    for i in range(n_columns):
        for j in range(n_rows):
            lower_curve = upper_by_ij.get((i, j), horizontal_by_ij[i, j])
            loop_curves = [
                lower_curve,
                vertical_by_ij[i + 1, j],
                -horizontal_by_ij[i, j + 1],
                -vertical_by_ij[i, j],
            ]
            surfaces.append(
                gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(loop_curves)])
            )
    return surfaces


def _add_groups_and_find_tags(entities_by_name: dict[str, tuple[int, list[int]]]) -> dict[str, int]:
    """Make gmsh's physical groups, and return each group's tag by name.

    A physical group is a named set of gmsh's points, curves or surfaces. ``entities_by_name`` has,
    for each name, the dimension (0, 1 or 2) and the tags of the group's members. A name without
    members gets no group and no tag.
    """
    tag_by_name = {
        name: group_tag
        for group_tag, (name, (_, entities)) in enumerate(entities_by_name.items(), 1)
        if entities
    }
    for name, group_tag in tag_by_name.items():
        dimension, entities = entities_by_name[name]
        gmsh.model.addPhysicalGroup(dimension, entities, group_tag)
        gmsh.model.setPhysicalName(dimension, group_tag, name)
    return tag_by_name


def _set_cell_kind(scene: Scene, surface_tags: list[int]) -> None:
    """Choose triangles or quadrilaterals for gmsh's surfaces ``surface_tags``.

    The scene's ``mesh.cells`` and ``mesh.layout`` decide. The cells of a grid, and all
    quadrilaterals, lie in regular rows. Triangles with graded lengths have no rows.
    """
    if scene.has_graded_lengths or (scene.mesh.layout, scene.mesh.cells) == ("graded", "triangle"):
        gmsh.option.setNumber("Mesh.Algorithm", 6)  # frontal Delaunay
        surface_tags = []
    for surface_tag in surface_tags:
        gmsh.model.geo.mesh.setTransfiniteSurface(surface_tag)
        if scene.mesh.cells == "quadrilateral":
            gmsh.model.geo.mesh.setRecombine(2, surface_tag)
    gmsh.model.geo.synchronize()


def _add_curve(
    start_tag: int, end_tag: int, interval: ElementInterval, center: int | None = None
) -> int:
    """Add a line or an arc between two points to gmsh, and divide it into elements.

    Parameters
    ----------
    start_tag, end_tag : int
        gmsh's tags for the end points.
    interval : ElementInterval
        Number of elements, and length ratio of successive elements. With 0 elements the curve stays
        undivided.
    center : int or None
        gmsh's tag for the arc's center; None for a line.

    Returns
    -------
    int
        gmsh's tag for the curve.
    """
    geo = gmsh.model.geo
    point_tags = (start_tag, end_tag) if center is None else (start_tag, center, end_tag)
    curve_tag: int = (geo.addLine if center is None else geo.addCircleArc)(*point_tags)
    if (
        interval.n_elements
    ):  # else elements have lengths by :func:`_mesh_current_model_with_gradings`
        n_nodes_on_curve, length_ratio = interval.n_elements + 1, interval.length_over_previous
        gmsh.model.geo.mesh.setTransfiniteCurve(
            curve_tag, n_nodes_on_curve, "Progression", length_ratio
        )
    return curve_tag


# --- the rim below a blade of a disk --------------------------------------------------------------

BLADE_CORNER_ELEMENT_TO_MESH_SIZE = 1.0 / 32.0
"""Element length at the corners between blade and rim, relative to ``mesh.size``."""
RIM_SIDE_NAMES = ("rim_left", "rim_right")
"""Names of a disk sector's sides. "left" and "right" are the sides of the blade."""


class DiskRim:
    """Rim of a disk sector below the blade, between two circles.

    Attributes
    ----------
    blade_middle_position : float [m]
        Coordinate of the blade's middle across the blade: x of a plate, z of a solid.
    axis_y_position : float [m]
        Coordinate y of the rotor's axis, y along the blade.
    inner_radius, outer_radius : float [m]
        Radii of the circles.
    half_angle : float [rad]
        Half of a sector's angle.
    """

    def __init__(self, scene: Scene) -> None:
        """Take the rim's dimensions from a scene with a disk."""
        self.scene, disk, axis_point = scene, scene.given("disk"), scene.axis_point_and_direction[0]
        self.blade_middle_position, self.axis_y_position = (
            float(axis_point[0 if scene.dimension == 2 else 2]),
            float(axis_point[1]),
        )
        self.inner_radius, self.outer_radius = (
            disk.given("inner_radius"),
            disk.given("outer_radius"),
        )
        self.half_angle = math.pi / disk.sectors

    @property
    def area(self) -> float:
        """Return the area of the sector's rim [m^2]."""
        return self.half_angle * (self.outer_radius**2 - self.inner_radius**2)

    def foot_height(self, position: float) -> float:
        """Return the coordinate y of the blade's foot on the outer circle [m].

        ``position`` [m] is the coordinate across the blade.
        """
        return self.axis_y_position + math.sqrt(
            self.outer_radius**2 - (position - self.blade_middle_position) ** 2
        )

    def point_at(self, radius: float, angle: float) -> tuple[float, float]:
        """Convert a radius [m] and an angle [rad] to a point (across the blade, y) [m].

        The angle is measured from the blade's middle to the right.
        """
        return (
            self.blade_middle_position + radius * math.sin(angle),
            self.axis_y_position + radius * math.cos(angle),
        )

    def draw_with_blade(
        self, width: float, height: float, thickness: float
    ) -> list[tuple[int, int]]:
        """Draw a sector of a solid disk, rim and blade in a single volume.

        ``width``, ``height`` and ``thickness`` are the blade's sides in gmsh's unit of length. The
        rim is as thick as the blade is wide. Returns a list with gmsh's (dimension, tag) of the
        volume.
        """
        occ = gmsh.model.occ
        polar_corners = [
            (rim_corner_radius, rim_corner_angle)
            for rim_corner_radius in (self.inner_radius, self.outer_radius)
            for rim_corner_angle in (-self.half_angle, self.half_angle)
        ]
        rim_corner_positions = [self.point_at(*polar_corner) for polar_corner in polar_corners]
        left_inner_point, right_inner_point, left_outer_point, right_outer_point = (
            occ.addPoint(0.0, y, z) for z, y in rim_corner_positions
        )
        center = occ.addPoint(0.0, self.axis_y_position, self.blade_middle_position)
        rim_curves = [
            occ.addCircleArc(left_inner_point, center, right_inner_point),
            occ.addLine(right_inner_point, right_outer_point),
            occ.addCircleArc(right_outer_point, center, left_outer_point),
            occ.addLine(left_outer_point, left_inner_point),
        ]  # fmt: skip
        rim_section = occ.addPlaneSurface([occ.addCurveLoop(rim_curves)])
        rim_dim_tags = [
            dim_tag
            for dim_tag in occ.extrude([(2, rim_section)], width, 0.0, 0.0)
            if dim_tag[0] == 3
        ]
        blade_depth = 0.5 * (-self.foot_height(0.0) + self.outer_radius - self.inner_radius)
        blade_dim_tags = [
            (3, occ.addBox(0.0, -blade_depth, 0.0, width, height + blade_depth, thickness))
        ]
        return list(occ.fuse(rim_dim_tags, blade_dim_tags)[0])

    def blade_corner_gradings(self) -> list[PointGrading]:
        """Return the element length around the two corners between blade and rim.

        The stress is infinite at the corners, so the elements are short. At the distance d
        from a corner the length is ``mesh.size`` (1/32 + d / blade width).
        """
        blade_width, element_size = self.scene.geometry.sides[0], self.scene.mesh.given("size")
        return [
            PointGrading(
                (blade_corner_x_position, self.foot_height(0.0)),
                BLADE_CORNER_ELEMENT_TO_MESH_SIZE * element_size,
                element_size / blade_width,
            )
            for blade_corner_x_position in (0.0, blade_width)
        ]

    def name_of(self, face_center: tuple[float, float, float]) -> str:
        """Return the name for a face on a solid's rim: "rim_left", "rim_right", "clamp" or "rim".

        ``face_center`` (x, y, z) is the face's center of mass. "rim_left" and "rim_right" are the
        sector's sides, "clamp" is the inner circle, and "rim" any other face.
        """
        offset_across_blade = face_center[2] - self.blade_middle_position
        offset_along_blade = face_center[1] - self.axis_y_position
        face_radius = math.hypot(offset_across_blade, offset_along_blade)
        face_angle = math.atan2(offset_across_blade, offset_along_blade)
        if abs(abs(face_angle) - self.half_angle) < 1e-6:
            return RIM_SIDE_NAMES[int(face_angle > 0.0)]
        # The center of mass of the inner arc.
        arc_centroid_radius = self.inner_radius * math.sin(self.half_angle) / self.half_angle
        return (
            "clamp" if abs(face_radius - arc_centroid_radius) < 1e-6 * self.outer_radius else "rim"
        )

    def set_periodic(self, across_axis: int, left_tags: list[int], right_tags: list[int]) -> None:
        """Make gmsh mesh the sector's right side as a rotated copy of the left side.

        The rotation by the sector's angle is in the plane of y and ``across_axis``: 0 (x) for a
        plate, 2 (z) for a solid. The tags belong to a plate's curves or a solid's surfaces.
        """
        cos_sector_angle, sin_sector_angle = (
            math.cos(2.0 * self.half_angle),
            math.sin(2.0 * self.half_angle),
        )
        transformation_matrix, axis_point, plane_axes = np.eye(4), np.zeros(3), [1, across_axis]
        transformation_matrix[np.ix_(plane_axes, plane_axes)] = [
            [cos_sector_angle, -sin_sector_angle],
            [sin_sector_angle, cos_sector_angle],
        ]
        axis_point[plane_axes] = self.axis_y_position, self.blade_middle_position
        transformation_matrix[:3, 3] = axis_point - transformation_matrix[:3, :3] @ axis_point
        gmsh.model.mesh.setPeriodic(
            1 + across_axis // 2, right_tags, left_tags, transformation_matrix.ravel().tolist()
        )

    def draw(
        self,
        foot_points: list[int],
        foot_curves: list[int],
        foot_columns: list[ElementInterval],
        surfaces: list[int],
    ) -> dict[str, tuple[int, list[int]]]:
        """Draw the rim of a plane disk's sector, in blocks from the inner to the outer circle.

        The blade's foot is the part of the outer circle below the blade.

        Parameters
        ----------
        foot_points, foot_curves : list of int
            gmsh's tags for the points and curves along the foot, from left to right.
        foot_columns : list of ElementInterval
            Block columns of the blade, from left to right.
        surfaces : list of int
            gmsh's tags for surfaces. The tags of the rim's blocks are appended.

        Returns
        -------
        dict
            Dimension and gmsh's tags for the curves, by side: "clamp", "rim_left", "rim_right".
        """
        element_size, geo = _element_length_off_cracks(self.scene), gmsh.model.geo
        arc_angle_beside_blade = self.half_angle - math.asin(
            (foot_columns[-1].stop - self.blade_middle_position) / self.outer_radius
        )
        arc_and_radial_lengths = (
            self.outer_radius * arc_angle_beside_blade,
            self.outer_radius - self.inner_radius,
        )
        has_element_counts = foot_columns[0].n_elements > 0
        interval_beside_blade, radial_interval = (
            ElementInterval(
                0.0, 1.0, has_element_counts * max(1, round(length / element_size)), 1.0
            )
            for length in arc_and_radial_lengths
        )
        center = geo.addPoint(self.blade_middle_position, self.axis_y_position, 0.0)
        foot_point_xs = [foot_columns[0].start, *(column.stop for column in foot_columns)]
        foot_angles = [
            math.asin((foot_point_x - self.blade_middle_position) / self.outer_radius)
            for foot_point_x in foot_point_xs
        ]
        point_angles = [-self.half_angle, *foot_angles, self.half_angle]
        left_corner, right_corner = (
            geo.addPoint(*self.point_at(self.outer_radius, point_angle), 0.0)
            for point_angle in (-self.half_angle, self.half_angle)
        )
        outer_points = [left_corner, *foot_points, right_corner]
        inner_points = [
            geo.addPoint(*self.point_at(self.inner_radius, point_angle), 0.0)
            for point_angle in point_angles
        ]
        arc_intervals = [interval_beside_blade, *foot_columns, interval_beside_blade]
        radial_curves = [
            _add_curve(inner_point, outer_point, radial_interval)
            for inner_point, outer_point in zip(inner_points, outer_points, strict=True)
        ]
        arc_ends_and_intervals = zip(pairwise(inner_points), arc_intervals, strict=True)
        inner_curves = [
            _add_curve(*arc_end_points, interval, center)
            for arc_end_points, interval in arc_ends_and_intervals
        ]
        outer_curves = [
            _add_curve(start_point_tag, end_point_tag, interval_beside_blade, center)
            for start_point_tag, end_point_tag in (outer_points[:2], outer_points[-2:])
        ]
        outer_curves[1:1] = foot_curves
        for column_index in range(len(arc_intervals)):
            loop_curves = [
                inner_curves[column_index],
                radial_curves[column_index + 1],
                -outer_curves[column_index],
                -radial_curves[column_index],
            ]
            surfaces.append(geo.addPlaneSurface([geo.addCurveLoop(loop_curves)]))
        return {
            "clamp": (1, inner_curves),
            RIM_SIDE_NAMES[0]: (1, radial_curves[:1]),
            RIM_SIDE_NAMES[1]: (1, radial_curves[-1:]),
        }


# --- graded sectors -----------------------------------------------------------------------------


def _mesh_current_model_with_gradings(
    scene: Scene, unit_scene: Scene, gradings: list[PointGrading]
) -> None:
    """Mesh gmsh's current model with elements of ``mesh.size``, shorter near given points.

    The element length at a position is the smallest of ``mesh.size`` and the lengths of all
    ``gradings``. A grading states an element length as a function of the distance from a point.
    ``scene`` is in metres, for errors; ``unit_scene`` and the gradings are in gmsh's unit.

    Raises
    ------
    InputError
        gmsh cannot mesh the geometry; the error names the key to change.
    """
    element_size = unit_scene.mesh.given("size")
    point_tags = [tag for _, tag in gmsh.model.getEntities(0)]
    points = np.array([gmsh.model.getValue(0, tag, [])[:2] for tag in point_tags])
    length_fields = []
    for point_grading in gradings:
        graded_point_tag = point_tags[np.linalg.norm(points - point_grading.point, axis=1).argmin()]
        size_min_length_and_slope = (
            element_size,
            point_grading.min_length,
            point_grading.length_per_distance,
        )
        length_fields.append(
            solid_mesher.add_graded_field(
                "PointsList", [graded_point_tag], *size_min_length_and_slope
            )[1]
        )
    solid_mesher.use_smallest_length(length_fields)
    solid_mesher.set_size_options(FromPoints=0, ExtendFromBoundary=0, FromCurvature=0)
    try:
        gmsh.model.mesh.generate(2)
    except Exception as error:  # gmsh raises nothing else
        raise meshing_refusal(scene, str(error)) from None


def meshing_refusal(scene: Scene, reason_text: str) -> InputError:
    """Return the InputError for a geometry that gmsh cannot mesh.

    ``reason_text`` is the reason. The error names the key of the smallest crack dimension or,
    without cracks, ``mesh.size``.
    """
    crack_size_by_key = {
        f"{crack_key}.{crack_size_key}": crack_size
        for crack_key, crack in scene.crack_by_name.items()
        for crack_size_key in ("depth", "length", "radii")
        if (crack_size := getattr(crack, crack_size_key)) is not None
    }
    smallest_size_key = min(
        crack_size_by_key,
        key=lambda crack_size_key: np.min(crack_size_by_key[crack_size_key]),
        default="mesh.size",
    )
    geometry_kind = scene.geometry.kind
    requirement = (
        f"such that gmsh can mesh the {geometry_kind} ({reason_text}); choose it closer to"
        f" the other sizes of the {geometry_kind}"
    )
    return InputError(
        smallest_size_key, crack_size_by_key.get(smallest_size_key, scene.mesh.size), requirement
    )
