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
block. The uniform grid of the paper is a special case. Blocks are a tensor product: columns between
neighbouring tips, rows between neighbouring cracks. Elements grow geometrically away from tips and
cracks, so their size is linear in the distance. Between two tips, or two cracks, they grow from
both to the middle, where the block is cut once more. A crack inside the plate consists of two
halves that meet in its middle. Each half is like an edge crack with its mouth there.

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
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.gmsh_process import gmsh
from fenics_crack.basics.machine import machine_memory
from fenics_crack.fem.cracks import CrackPath, Cracks, NamedParts
from fenics_crack.kernel import Struct, kernel
from fenics_crack.model.factor import estimate_factor_bytes
from fenics_crack.scene.scene import Scene

MIN_RELATIVE_CELL_SIZE = 1e-7
"""Minimum cell size, relative to the plate's longer side. Smaller cells fail in gmsh and in the
matrices."""
MAX_ELEMENT_LENGTH_PER_DISTANCE = 1.0 / 3.0
"""Maximum element length between two tips or cracks, relative to the distance from the nearer."""


@dataclass(frozen=True)
class ElementInterval:
    """Part of a plate's side from ``start`` to ``stop``, in the scene's unit of length.

    ``length_over_previous`` is the ratio of neighbouring element lengths, above 1 for growing ones.
    ``n_elements`` 0 leaves the number to gmsh.
    """

    start: float
    stop: float
    n_elements: int
    length_over_previous: float


Slit = tuple[int, range]
"""Crack among the blocks: index of the horizontal line, and range of block columns along the crack.
"""


class _GradedFace:
    """Element lengths along a crack face, geometrically shorter towards a tip.

    From the mouth to the tip there are ``mesh.lip_elements`` elements. A crack inside has two such
    faces from the middle to a tip, with half as many elements each. ``length_over_next_from_tip``
    is an element's length over the length of the next element away from the tip.
    """

    def __init__(self, scene: Scene, coarse_end_position: float, tip_position: float) -> None:
        mesh, (plate_width, plate_height) = scene.mesh, scene.geometry.sides
        self.coarse_end_position = coarse_end_position
        self.tip_position = tip_position
        self.n_elements = mesh.given("lip_elements")
        if coarse_end_position not in (0.0, plate_width):
            self.n_elements = -(-self.n_elements // 2)
        self.length_over_next_from_tip = mesh.grading ** (-1.0 / max(self.n_elements - 1, 1))
        relative_lengths = self.length_over_next_from_tip ** np.arange(self.n_elements)
        self.tip_element_length = float(
            abs(tip_position - coarse_end_position) * relative_lengths[-1] / relative_lengths.sum()
        )
        if self.tip_element_length < MIN_RELATIVE_CELL_SIZE * max(plate_width, plate_height):
            requirement = "smaller: the element at the tip of this crack would be only"
            raise InputError(
                "mesh.grading", mesh.grading, f"{requirement} {self.tip_element_length:.1g} m long"
            )

    def covers(self, start: float, stop: float) -> bool:
        """Return True if the middle of an interval of positions [m] lies on the face."""
        return (
            min(self.coarse_end_position, self.tip_position)
            < 0.5 * (start + stop)
            < max(self.coarse_end_position, self.tip_position)
        )

    def element_length(self, position: float) -> float:
        """Return the element length at a position on the face [m], linear in the position."""
        coarse_length = self.tip_element_length / self.length_over_next_from_tip ** (
            self.n_elements - 1
        )
        fraction_from_tip = (position - self.tip_position) / (
            self.coarse_end_position - self.tip_position
        )
        return self.tip_element_length + fraction_from_tip * (
            coarse_length - self.tip_element_length
        )

    def count_elements(self, start: float, stop: float) -> float:
        """Integrate 1 / element length over an interval: number of elements, not rounded."""
        start_length, stop_length = self.element_length(start), self.element_length(stop)
        if abs(start_length - stop_length) < 1e-9 * start_length:
            return (stop - start) / start_length
        return (stop - start) * math.log(start_length / stop_length) / (start_length - stop_length)


def _find_plate_columns_rows_and_slits(
    scene: Scene,
) -> tuple[list[ElementInterval], list[ElementInterval], list[Slit]]:
    """Divide a plate into blocks, and locate the cracks among the blocks.

    Returns
    -------
    columns, rows : list of ElementInterval
        Blocks across the plate and along it.
    slits : list of Slit
        Line and columns of each crack.

    Raises
    ------
    InputError
        The element at a tip is shorter than ``MIN_RELATIVE_CELL_SIZE`` of the plate.
    """
    width, height = scene.geometry.sides
    cracks = list(scene.crack_by_name.values())
    crack_spans = [crack.span(width) for crack in cracks]
    crack_heights = [crack.height or 0.0 for crack in cracks]
    if scene.mesh.layout == "grid":
        crack_end_positions = [crack_end for crack_span in crack_spans for crack_end in crack_span]
        columns = _intervals_with_equal_elements(
            width, scene.mesh.given("columns"), crack_end_positions
        )
        rows = _intervals_with_equal_elements(height, scene.mesh.given("rows"), crack_heights)
    else:
        columns, rows = _graded_columns_and_rows(scene, crack_spans, crack_heights)
    column_positions, row_positions = (
        np.array([intervals[0].start, *(interval.stop for interval in intervals)])
        for intervals in (columns, rows)
    )
    slits = [
        (
            _index_of_nearest_position(row_positions, crack_height),
            range(
                *(
                    _index_of_nearest_position(column_positions, crack_end)
                    for crack_end in crack_span
                )
            ),
        )
        for crack_span, crack_height in zip(crack_spans, crack_heights, strict=True)
    ]
    return columns, rows, slits


def check_cell_count(
    scene: Scene, mesh_key: str, n_cells: float, dofs_per_cell: int, size_note: str = ""
) -> None:
    """Raise InputError if a mesh would have too many cells for gmsh or the memory.

    The limits are 5e6 cells, and the machine's memory for matrices and a factor. The error names
    the key ``mesh.key``; ``size_note`` adds text to the message, as the shortest element.
    """
    n_dofs, allowed_cells = dofs_per_cell * n_cells, 5e6  # a mesh file may have any number of cells
    factor_bytes = estimate_factor_bytes(n_dofs, solid=scene.dimension == 3)
    assembled_bytes = 1500.0 * n_dofs  # bytes of mesh and matrices
    needed_bytes, machine_bytes = max(assembled_bytes, factor_bytes), machine_memory()
    refusal_reason = f"{n_cells:.2g} cells are more than {allowed_cells:.0e}"
    if n_cells <= allowed_cells:
        memory_text = (
            f"{needed_bytes / 2**30:.0f} GiB, but this machine has {machine_bytes / 2**30:.3g} GiB"
        )
        refusal_reason = f"to solve {n_cells:.2g} cells takes about {memory_text}"
    if n_cells > allowed_cells or needed_bytes > machine_bytes:
        requirement = f"such that the mesh has fewer cells{size_note}: {refusal_reason}"
        raise InputError(f"mesh.{mesh_key}", getattr(scene.mesh, mesh_key), requirement)


def _element_length_off_cracks(scene: Scene) -> float:
    """Return the element length away from cracks, ``mesh.size`` [m].

    For a grid the result is the plate's height over ``mesh.rows``.
    """
    return scene.mesh.size or scene.geometry.sides[1] / scene.mesh.given("rows")


def plate_pair_upper_bound(scene: Scene) -> int:
    """Return an upper bound for the number of contact pairs in a plate.

    If the crack's length is still unknown, the bound comes from ``mesh.lip_elements``.
    """
    crack, element_order = scene.crack, scene.mesh.order
    if crack is not None and crack.length is None:  # then it is the only crack
        return ((scene.mesh.lip_elements or 0) + 1) * element_order
    columns, _, slits = _find_plate_columns_rows_and_slits(scene)
    return sum(
        columns[column_index].n_elements * element_order
        for _, crack_columns in slits
        for column_index in crack_columns
    )


def _intervals_with_equal_elements(
    side_length: float, n_elements: int, cut_positions: list[float]
) -> list[ElementInterval]:
    """Divide a side into equal elements, and cut it into intervals at given positions.

    ``side_length`` and ``cut_positions`` are in metres; the positions lie on grid lines.
    """
    position_by_grid_line = {
        round(cut_position / side_length * n_elements): cut_position
        for cut_position in cut_positions
    } | {0: 0.0, n_elements: side_length}
    return [
        ElementInterval(
            position_by_grid_line[first_line],
            position_by_grid_line[last_line],
            last_line - first_line,
            1.0,
        )
        for first_line, last_line in pairwise(sorted(position_by_grid_line))
    ]


def _index_of_nearest_position(positions: np.ndarray, position: float) -> int:
    """Return the index in ``positions`` of the value nearest to ``position``."""
    return int(np.argmin(np.abs(positions - position)))


# --- the unit of length ---------------------------------------------------------------------------


def scale_scene_to_mesh_unit(scene: Scene, metres_per_unit: float = 0.0) -> tuple[Scene, float]:
    """Convert a scene's lengths to the unit for gmsh.

    By default the unit is the power of ten [m] in which the longest side is 0.0316 to 0.316.

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


# --- graded sides ---------------------------------------------------------------------------------


def _graded_columns_and_rows(
    scene: Scene, crack_spans: list[tuple[float, float]], crack_heights: list[float]
) -> tuple[list[ElementInterval], list[ElementInterval]]:
    """Divide a plate into block columns and rows with short elements at tips and cracks.

    ``crack_spans`` are the left and right ends of each crack, ``crack_heights`` their heights [m].
    """
    (width, height), element_size = scene.geometry.sides, scene.mesh.given("size")
    if not crack_spans:
        element_counts = [
            max(1, round(side_length / element_size)) for side_length in (width, height)
        ]
        return [ElementInterval(0.0, width, element_counts[0], 1.0)], [
            ElementInterval(0.0, height, element_counts[1], 1.0)
        ]
    all_graded_faces: list[_GradedFace] = []
    crack_levels_and_element_lengths: list[tuple[float, float]] = []
    for (left_end, right_end), crack_height in zip(crack_spans, crack_heights, strict=True):
        coarse_end_position = (
            left_end
            if left_end == 0.0
            else right_end
            if right_end == width
            else 0.5 * (left_end + right_end)
        )
        graded_faces = [
            _GradedFace(scene, coarse_end_position, tip_position)
            for tip_position in (left_end, right_end)
            if tip_position != coarse_end_position
        ]
        crack_levels_and_element_lengths.append(
            (crack_height, min(face.tip_element_length for face in graded_faces))
        )
        all_graded_faces += graded_faces
    tip_positions_and_element_lengths = [
        (face.tip_position, face.tip_element_length) for face in all_graded_faces
    ]
    return _intervals_with_graded_elements(
        width, tip_positions_and_element_lengths, all_graded_faces, element_size
    ), _intervals_with_graded_elements(height, crack_levels_and_element_lengths, [], element_size)


def _intervals_with_graded_elements(
    extent: float,
    tip_positions_and_element_lengths: list[tuple[float, float]],
    faces: list[_GradedFace],
    size: float,
) -> list[ElementInterval]:
    """Divide a side into intervals with element lengths graded between given positions.

    Parameters
    ----------
    extent : float [m]
        Length of the side.
    tip_positions_and_element_lengths : list of (position, length) [m]
        Tips on the side, or heights of cracks, with the element length there.
    faces : list of _GradedFace
        Crack faces along the side.
    size : float [m]
        Element length elsewhere.
    """
    # Closer positions are equal; cracks and tips are farther from the plate's edges.
    tolerance = MIN_RELATIVE_CELL_SIZE * extent

    def lengths_at_tip(position: float) -> list[float]:
        """Return the element lengths prescribed at a position; empty off tips and cracks."""
        return [
            tip_length
            for tip, tip_length in tip_positions_and_element_lengths
            if abs(tip - position) <= tolerance
        ]

    def element_length(position: float, faces_along: list[_GradedFace]) -> float:
        """Return the shortest element length at a position, from crack faces, tips or size."""
        return min(
            ([face.element_length(position) for face in faces_along] or [size])
            + lengths_at_tip(position)
        )

    def make_intervals(start: float, stop: float) -> list[ElementInterval]:
        """Divide between two positions; from tip to tip, into two intervals up to the middle."""
        faces_along = [face for face in faces if face.covers(start, stop)]
        for face in faces_along if len(faces_along) == 1 else ():
            ends = sorted((face.coarse_end_position, face.tip_position))
            if max(abs(ends[0] - start), abs(ends[1] - stop)) <= tolerance:
                length_ratio = (
                    face.length_over_next_from_tip
                    if face.tip_position > face.coarse_end_position
                    else 1.0 / face.length_over_next_from_tip
                )
                return [ElementInterval(start, stop, face.n_elements, length_ratio)]
        start_length = element_length(start, faces_along)
        stop_length = element_length(stop, faces_along)
        if not (lengths_at_tip(start) and lengths_at_tip(stop)):
            return [_graded_interval(start, stop, start_length, stop_length, faces_along)]
        middle = 0.5 * (start + stop)
        max_length = max(
            start_length, stop_length, MAX_ELEMENT_LENGTH_PER_DISTANCE * 0.5 * (stop - start)
        )
        middle_length = min(max_length, element_length(middle, faces_along))
        segments = (
            (start, middle, start_length, middle_length),
            (middle, stop, middle_length, stop_length),
        )
        return [_graded_interval(*segment, faces_along) for segment in segments]

    interval_bounds = [0.0]
    cuts = [position for position, _ in tip_positions_and_element_lengths] + [
        face.coarse_end_position for face in faces
    ]
    for position in sorted([*cuts, extent]):
        if position - interval_bounds[-1] > tolerance:
            interval_bounds.append(position)
    return [interval for ends in pairwise(interval_bounds) for interval in make_intervals(*ends)]


def _graded_interval(
    start: float, stop: float, start_length: float, stop_length: float, faces: list[_GradedFace]
) -> ElementInterval:
    """Return an interval with geometrically graded elements.

    Element lengths are about ``start_length`` at ``start`` and ``stop_length`` at ``stop`` [m]. The
    number is at least the number required by each crack face.
    """
    min_length, max_length = sorted((start_length, stop_length))
    n_elements, growth_ratio = _graded_count_and_ratio(stop - start, min_length, max_length)
    n_required_elements = max(
        (math.ceil(face.count_elements(start, stop) - 0.01) for face in faces), default=0
    )
    if n_required_elements > n_elements:
        n_elements = n_required_elements
        growth_ratio = (max_length / min_length) ** (1.0 / max(n_required_elements - 1, 1))
    return ElementInterval(
        start, stop, n_elements, growth_ratio if start_length <= stop_length else 1.0 / growth_ratio
    )


def _graded_count_and_ratio(
    interval_length: float, min_length: float, max_length: float
) -> tuple[int, float]:
    """Return number and length ratio of geometrically growing elements on an interval.

    The elements grow from about ``min_length`` to about ``max_length``, at most half the
    interval.
    """
    if min_length >= max_length:
        return math.ceil(interval_length / max_length), 1.0
    max_length = min(max_length, 0.5 * interval_length)
    if min_length >= max_length:
        return (1 if interval_length <= min_length else 2), 1.0
    growth_ratio = (interval_length - min_length) / (interval_length - max_length)
    n_elements = max(1, round(1.0 + math.log(max_length / min_length) / math.log(growth_ratio)))
    return n_elements, (max_length / min_length) ** (1.0 / max(n_elements - 1, 1))


# --- a plate --------------------------------------------------------------------------------------


def mesh_plate(scene: Scene) -> tuple[NamedParts, Cracks]:
    """Mesh a scene's plate into gmsh's current model.

    Returns
    -------
    NamedParts
        gmsh's group tags of the named sides, and no named points.
    Cracks
        Crack paths in the order of the scene.
    """
    unit_scene, metres_per_unit = scale_scene_to_mesh_unit(scene)
    facet_tags_by_group = _draw_blocks(scene, unit_scene)
    if scene.has_graded_lengths:
        disk_rim = DiskRim(unit_scene)
        get_group_entities = gmsh.model.getEntitiesForPhysicalGroup
        left_curves, right_curves = (
            get_group_entities(1, *facet_tags_by_group[side_name]).tolist()
            for side_name in RIM_SIDE_NAMES
        )
        disk_rim.set_periodic(0, left_curves, right_curves)
        _mesh_current_model_with_gradings(
            scene, unit_scene, [*_crack_gradings(unit_scene), *disk_rim.gradings()]
        )
        # The mesh is made: end the periodicity.
        gmsh.model.mesh.setPeriodic(1, right_curves, right_curves, np.eye(4).ravel().tolist())
    else:
        gmsh.model.mesh.generate(2)
    _scale_nodes(metres_per_unit)
    return (facet_tags_by_group, {}), _crack_paths(scene)


def _crack_paths(scene: Scene) -> tuple[CrackPath, ...]:
    """Return a plate's crack paths, in the scene's order, from mouth to tip or left to right."""
    width, crack_paths = scene.geometry.sides[0], []
    for crack in scene.crack_by_name.values():
        left_end, right_end = ((end_x, crack.given("height")) for end_x in crack.span(width))
        path_ends = (right_end, left_end) if crack.edge == "right" else (left_end, right_end)
        crack_paths.append(CrackPath(np.array(path_ends), crack.edge is not None))
    return tuple(crack_paths)


def _draw_blocks(scene: Scene, unit_scene: Scene) -> dict[str, tuple[int, ...]]:
    """Draw a plate's blocks in gmsh, and set the elements on curves and surfaces.

    ``unit_scene`` is the scene in gmsh's unit of length. Returns gmsh's group tag for each side's
    name.
    """
    _check_plate_cells(scene)
    columns, rows, slits = _find_plate_columns_rows_and_slits(unit_scene)
    rim = None if unit_scene.disk is None else DiskRim(unit_scene)
    xs, ys = ([0.0, *(interval.stop for interval in intervals)] for intervals in (columns, rows))
    add_point = gmsh.model.geo.addPoint
    foot_heights = [0.0 if rim is None else rim.foot_height(x) for x in xs]
    corners = {
        (i, j): add_point(x, y if j else foot_heights[i], 0.0)
        for i, x in enumerate(xs)
        for j, y in enumerate(ys)
    }
    doubled_ij = _find_doubled_corner_indices(slits, len(columns))
    upper_corner_by_ij = {(i, j): add_point(xs[i], ys[j], 0.0) for i, j in doubled_ij}
    bottom_corner_by_ij = corners | upper_corner_by_ij  # corners of blocks above a crack

    horizontal_curves, vertical_curves = {}, {}
    column_by_upper_ij = {
        (i, row): columns[i] for row, crack_columns in slits for i in crack_columns
    }
    if scene.has_graded_lengths:  # only crack faces have a number of elements
        columns, rows = (
            [replace(interval, n_elements=0) for interval in intervals]
            for intervals in (columns, rows)
        )
    for i, column in enumerate(columns):
        for j in range(len(ys)):
            horizontal_curves[i, j] = _add_curve(
                corners[i, j], corners[i + 1, j], column_by_upper_ij.get((i, j), column)
            )
    for j, row_interval in enumerate(rows):
        for i in range(len(xs)):
            vertical_curves[i, j] = _add_curve(
                bottom_corner_by_ij[i, j], corners[i, j + 1], row_interval
            )
    upper_curves = {
        (i, j): _add_curve(bottom_corner_by_ij[i, j], bottom_corner_by_ij[i + 1, j], interval)
        for (i, j), interval in column_by_upper_ij.items()
    }
    surfaces = _add_surfaces(
        len(columns), len(rows), horizontal_curves, vertical_curves, upper_curves
    )
    foot_curves = [horizontal_curves[i, 0] for i in range(len(columns))]
    sides: dict[str, tuple[int, list[int]]] = {"clamp": (1, foot_curves)}
    if rim is not None:
        sides = rim.draw([corners[i, 0] for i in range(len(xs))], foot_curves, columns, surfaces)
    _set_cell_kind(scene, surfaces)

    left_curves, right_curves = (
        [vertical_curves[i, j] for j in range(len(rows))] for i in (0, len(columns))
    )
    single_ij = [ij for ij in corners if ij not in doubled_ij]
    load_position = unit_scene.excitation.point
    load_point_tags = [corners[i, j] for i, j in single_ij if (xs[i], ys[j]) == load_position]
    groups: dict[str, tuple[int, list[int]]] = {
        "plate": (2, surfaces),
        **sides,
        "lower_lip": (1, [horizontal_curves[block_indices] for block_indices in upper_curves]),
        "upper_lip": (1, list(upper_curves.values())),
        "load": (0, load_point_tags),
        "left": (1, left_curves),
        "right": (1, right_curves),
        "top": (1, [horizontal_curves[i, len(rows)] for i in range(len(columns))]),
    }
    tag_by_side = {name: group_tag for name, group_tag in _add_groups_and_find_tags(groups).items()
                   if groups[name][0] == 1}  # fmt: skip
    if rim is None:
        tag_by_side["bottom"] = tag_by_side["clamp"]
    return {name: (group_tag,) for name, group_tag in tag_by_side.items()}


def _check_plate_cells(scene: Scene) -> None:
    """Raise InputError if a plate would have too many cells (:func:`check_cell_count`)."""
    columns, rows, _ = _find_plate_columns_rows_and_slits(scene)
    n_cells: float = math.prod(
        sum(interval.n_elements for interval in intervals) for intervals in (columns, rows)
    )
    if scene.disk is not None:
        n_cells += DiskRim(scene).area / _element_length_off_cracks(scene) ** 2
    mesh_key = "columns" if scene.mesh.layout == "grid" else "size"
    check_cell_count(scene, mesh_key, n_cells, 2 * scene.mesh.order**2)


def _find_doubled_corner_indices(slits: list[Slit], n_columns: int) -> list[tuple[int, int]]:
    """Return the block corners on cracks except at tips, as (column, row).

    At such a corner each crack face has a separate point. An end of a crack at the plate's edge is
    a mouth, not a tip.
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
    """Add the surface of each block to gmsh, and return the tags, column by column.

    The lower side of a block above a crack is a curve from ``upper_by_ij``, the upper crack face;
    of all other blocks, from ``horizontal_by_ij``.
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

    ``entities_by_name`` has (dimension, tags of entities) by name. Names without entities get no
    group.
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
    """Set gmsh's cells on the surfaces: structured blocks, quadrilaterals or free triangles."""
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
    """Add a line, or an arc around ``center``, with the interval's elements; return the tag."""
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

BLADE_CORNER_LENGTH_TO_MESH_SIZE = 1.0 / 32.0
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
        """Draw a solid sector, rim and blade in a single volume; return gmsh's (dimension, tag).

        The arguments are the blade's sides. The rim is as thick as the blade is wide.
        """
        occ = gmsh.model.occ
        polar_corners = [
            (corner_radius, corner_angle)
            for corner_radius in (self.inner_radius, self.outer_radius)
            for corner_angle in (-self.half_angle, self.half_angle)
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

    def gradings(self) -> list[_Grading]:
        """Return the grading of element lengths around the corners between blade and rim.

        The stress is infinite at the corners. The length is ``mesh.size`` / 32 there, and grows by
        ``mesh.size`` over the blade's width, per distance.
        """
        (blade_width, _), element_size = self.scene.geometry.sides, self.scene.mesh.given("size")
        corner_x_positions = np.array([0.0, blade_width])
        return [
            _Grading(
                corner_x_positions,
                self.foot_height(0.0),
                BLADE_CORNER_LENGTH_TO_MESH_SIZE * element_size,
                element_size / blade_width,
            )
        ]

    def name_of(self, face_center: tuple[float, float, float]) -> str:
        """Name a face on a solid's rim: "rim_left", "rim_right", "clamp" or "rim".

        ``face_center`` is the face's center of mass. The clamp is the inner circle.
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
        c, s = math.cos(2.0 * self.half_angle), math.sin(2.0 * self.half_angle)
        transformation_matrix, axis_point, plane_axes = np.eye(4), np.zeros(3), [1, across_axis]
        transformation_matrix[np.ix_(plane_axes, plane_axes)] = [[c, -s], [s, c]]
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
        """Draw the rim in blocks below a plate's foot, and append the tags to ``surfaces``.

        ``foot_points``, ``foot_curves`` and ``foot_columns`` are gmsh's points and curves and the
        block columns along the foot, from left to right.

        Returns
        -------
        dict
            Dimension and gmsh's tags of the curves, by side: "clamp", "rim_left", "rim_right".
        """
        element_size, geo = _element_length_off_cracks(self.scene), gmsh.model.geo
        rim_angle_beside_blade = self.half_angle - math.asin(
            (foot_columns[-1].stop - self.blade_middle_position) / self.outer_radius
        )
        arc_and_radial_lengths = (
            self.outer_radius * rim_angle_beside_blade,
            self.outer_radius - self.inner_radius,
        )
        element_counts = [
            max(1, round(arc_or_radial_length / element_size)) if foot_columns[0].n_elements else 0
            for arc_or_radial_length in arc_and_radial_lengths
        ]
        interval_beside_blade, radial_interval = (
            ElementInterval(0.0, 1.0, n_elements, 1.0) for n_elements in element_counts
        )
        center = geo.addPoint(self.blade_middle_position, self.axis_y_position, 0.0)
        x_positions = [
            foot_columns[0].start,
            *(column_interval.stop for column_interval in foot_columns),
        ]
        point_angles = [
            math.asin((x_position - self.blade_middle_position) / self.outer_radius)
            for x_position in x_positions
        ]
        point_angles = [-self.half_angle, *point_angles, self.half_angle]
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
            _add_curve(start, end, interval_beside_blade, center)
            for start, end in (outer_points[:2], outer_points[-2:])
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
    scene: Scene, unit_scene: Scene, gradings: list[_Grading]
) -> None:
    """Mesh gmsh's current model with elements of ``mesh.size``, shorter near graded points.

    The element length at a point is the minimum of ``mesh.size`` and all gradings.

    Raises
    ------
    InputError
        gmsh cannot mesh the geometry; the error names the key to change.
    """
    element_size = unit_scene.mesh.given("size")
    kernel_structs = [grading.as_kernel_struct() for grading in gradings]

    def element_length(dimension: int, tag: int, x: float, y: float, *_: float) -> float:
        """Return the element length at a point, for gmsh.

        gmsh calls the function 1e5 times for a mesh.
        """
        return min(
            [
                element_size,
                *(kernel.element_length_at(struct.address, x, y) for struct in kernel_structs),
            ]
        )

    for option in ("MeshSizeFromPoints", "MeshSizeExtendFromBoundary", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.model.mesh.setSizeCallback(element_length)
    try:
        gmsh.model.mesh.generate(2)
    except Exception as error:  # gmsh raises nothing else
        raise meshing_refusal(scene, str(error)) from None
    finally:
        gmsh.model.mesh.removeSizeCallback()


def meshing_refusal(scene: Scene, reason_text: str) -> InputError:
    """Return the InputError for a geometry that gmsh cannot mesh.

    ``reason_text`` is the reason. The error names the key of the smallest crack dimension or,
    without cracks, ``mesh.size``.
    """
    crack_size_by_key = {
        f"{crack_key}.{size_key}": crack_size
        for crack_key, crack in scene.crack_by_name.items()
        for size_key in ("depth", "length", "radii")
        if (crack_size := getattr(crack, size_key)) is not None
    }
    smallest_size_key = min(
        crack_size_by_key,
        key=lambda size_key: np.min(crack_size_by_key[size_key]),
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


@dataclass(frozen=True)
class _Grading:
    """Element length h = min_length + length_per_distance d around points.

    d is the distance from the nearest point. Lengths are in gmsh's unit.

    Attributes
    ----------
    x_positions, y_position : (n,), ()
        Coordinates x of the points, and the common y.
    min_length : float
        Element length at the points.
    length_per_distance : float
        Increase of the element length per distance d.
    """

    x_positions: np.ndarray
    y_position: float
    min_length: float
    length_per_distance: float

    def as_kernel_struct(self) -> Struct:
        """Return the kernel's struct ``grading``, for the C function ``element_length_at``."""
        return Struct("grading", count=len(self.x_positions), **vars(self))


def _crack_gradings(scene: Scene) -> list[_Grading]:
    """Return a grading of element lengths around the tips for each crack in a plate."""
    (width, _), mesh, gradings = scene.geometry.sides, scene.mesh, []
    for crack in scene.crack_by_name.values():
        n_elements = mesh.given("lip_elements")
        left_end, right_end = crack.span(width)
        face_length = right_end - left_end
        if crack.edge is None:
            n_elements, face_length = -(-n_elements // 2), 0.5 * face_length  # as in _GradedFace
        length_over_previous = mesh.grading ** (1.0 / max(n_elements - 1, 1))
        tip_element_length = face_length / float(
            (length_over_previous ** np.arange(n_elements)).sum()
        )
        tip_positions = np.array(
            [tip_position for tip_position in (left_end, right_end) if 0.0 < tip_position < width]
        )
        length_per_distance = max(length_over_previous - 1.0, MAX_ELEMENT_LENGTH_PER_DISTANCE)
        gradings.append(
            _Grading(tip_positions, crack.given("height"), tip_element_length, length_per_distance)
        )
    return gradings
