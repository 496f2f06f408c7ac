"""Divide a plate's sides into intervals, with short elements at crack tips.

A plate is cut into blocks at all tips and along all cracks (:mod:`fenics_crack.fem.blocks`). Blocks
are a tensor product: columns between neighbouring tips, rows between neighbouring cracks. Elements
grow geometrically away from tips and cracks, so their size is linear in the distance. Between two
tips, or two cracks, they grow from both to the middle, where the block is cut once more. A crack
inside the plate consists of two halves that meet in its middle. Each half is like an edge crack
with its mouth there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Crack

MIN_RELATIVE_CELL_SIZE = 1e-7
"""Minimum cell size, relative to the plate's longer side. Smaller cells fail in gmsh and in the
matrices."""
MAX_ELEMENT_LENGTH_PER_DISTANCE = 1.0 / 3.0
"""Maximum element length between two tips or cracks, relative to the distance from the nearer."""


@dataclass(frozen=True)
class ElementInterval:
    """Part of a plate's side, divided into elements.

    Attributes
    ----------
    start, stop : float
        Ends, in the scene's unit of length.
    n_elements : int
        Number of elements; 0: gmsh chooses the number.
    length_over_previous : float
        Ratio between the lengths of successive elements, from ``start`` to ``stop``.
    """

    start: float
    stop: float
    n_elements: int
    length_over_previous: float


Slit = tuple[int, range]
"""Crack among the blocks: index of the horizontal block line, and range of columns.
"""


class _GradedCrackFace:
    """Element lengths along a crack face, geometrically shorter towards a tip.

    The face of a crack with a mouth has ``mesh.lip_elements`` elements from the mouth to the tip. A
    crack inside the plate has two graded faces, each from the middle to a tip. Each has half of
    ``mesh.lip_elements``, rounded up.

    ``length_over_next_from_tip`` is the length ratio of two neighbouring elements, below 1. The
    numerator is the element nearer to the tip.
    """

    def __init__(self, scene: Scene, mouth_or_middle_position: float, tip_position: float) -> None:
        mesh, (plate_width, plate_height) = scene.mesh, scene.geometry.sides
        self.mouth_or_middle_position = mouth_or_middle_position
        self.tip_position = tip_position
        self.n_elements = mesh.given("lip_elements")
        if mouth_or_middle_position not in (0.0, plate_width):
            self.n_elements = -(-self.n_elements // 2)
        self.length_over_next_from_tip = mesh.grading ** (-1.0 / max(self.n_elements - 1, 1))
        relative_lengths = self.length_over_next_from_tip ** np.arange(self.n_elements)
        self.tip_element_length = float(
            abs(tip_position - mouth_or_middle_position)
            * relative_lengths[-1]
            / relative_lengths.sum()
        )
        if self.tip_element_length < MIN_RELATIVE_CELL_SIZE * max(plate_width, plate_height):
            requirement = "smaller: the element at the tip of this crack would be only"
            raise InputError(
                "mesh.grading", mesh.grading, f"{requirement} {self.tip_element_length:.1g} m long"
            )

    def covers(self, start: float, stop: float) -> bool:
        """Return True if the middle between ``start`` and ``stop`` [m] lies on the crack face."""
        return (
            min(self.mouth_or_middle_position, self.tip_position)
            < 0.5 * (start + stop)
            < max(self.mouth_or_middle_position, self.tip_position)
        )

    def element_length(self, position: float) -> float:
        """Return the element length at a position on the face [m], linear in the position."""
        coarse_length = self.tip_element_length / self.length_over_next_from_tip ** (
            self.n_elements - 1
        )
        fraction_from_tip = (position - self.tip_position) / (
            self.mouth_or_middle_position - self.tip_position
        )
        return self.tip_element_length + fraction_from_tip * (
            coarse_length - self.tip_element_length
        )

    def count_elements(self, start: float, stop: float) -> float:
        """Return how many elements of the graded lengths fit between two positions [m].

        The number is the integral of 1 / element length from ``start`` to ``stop``, not rounded.
        """
        element_length_at_start, element_length_at_stop = (
            self.element_length(start),
            self.element_length(stop),
        )
        if abs(element_length_at_start - element_length_at_stop) < 1e-9 * element_length_at_start:
            return (stop - start) / element_length_at_start
        return (
            (stop - start)
            * math.log(element_length_at_start / element_length_at_stop)
            / (element_length_at_start - element_length_at_stop)
        )


def find_plate_columns_rows_and_slits(
    scene: Scene,
) -> tuple[list[ElementInterval], list[ElementInterval], list[Slit]]:
    """Divide a plate into blocks, and locate the cracks among the blocks.

    Returns
    -------
    columns, rows : list of ElementInterval
        Blocks across the plate and along it.
    slits : list of Slit
        For each crack: index of the block row above the crack, and range of the block columns along
        it.

    Raises
    ------
    InputError
        The element at a tip is shorter than ``MIN_RELATIVE_CELL_SIZE`` times the plate's longer
        side.
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
        columns, rows = _graded_columns_and_rows(scene)
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


def plate_pair_upper_bound(scene: Scene) -> int:
    """Return an upper bound for the number of contact pairs in a plate.

    If the crack's length is still unknown, the bound follows from ``mesh.lip_elements``, the number
    of elements along the crack.
    """
    crack, element_order = scene.crack, scene.mesh.order
    if crack is not None and crack.length is None:  # then it is the only crack
        return ((scene.mesh.lip_elements or 0) + 1) * element_order
    columns, _, slits = find_plate_columns_rows_and_slits(scene)
    return sum(
        columns[column_index].n_elements * element_order
        for _, crack_columns in slits
        for column_index in crack_columns
    )


def _intervals_with_equal_elements(
    side_length: float, n_elements: int, cut_positions: list[float]
) -> list[ElementInterval]:
    """Divide a plate's side into equal elements, and group the elements into intervals.

    Parameters
    ----------
    side_length : float [m]
        Length of the side.
    n_elements : int
        Elements on the whole side.
    cut_positions : list of float [m]
        Positions at which an interval ends and the next one begins. Each lies between two elements.

    Returns
    -------
    list of ElementInterval
        Intervals from 0 to the side's length.
    """
    position_by_grid_line = {
        round(cut_position / side_length * n_elements): cut_position
        for cut_position in cut_positions
    } | {0: 0.0, n_elements: side_length}
    return [
        ElementInterval(
            position_by_grid_line[first_grid_line],
            position_by_grid_line[last_grid_line],
            last_grid_line - first_grid_line,
            1.0,
        )
        for first_grid_line, last_grid_line in pairwise(sorted(position_by_grid_line))
    ]


def _index_of_nearest_position(positions: np.ndarray, position: float) -> int:
    """Return the index in ``positions`` of the value nearest to ``position``."""
    return int(np.argmin(np.abs(positions - position)))


def _graded_crack_faces(scene: Scene, crack: Crack) -> list[_GradedCrackFace]:
    """Return the graded parts of a crack's face, one for each tip.

    A crack inside the plate has two parts, from its middle to either tip.
    """
    width = scene.geometry.sides[0]
    crack_left_end, crack_right_end = crack.span(width)
    mouth_or_middle_position = 0.5 * (crack_left_end + crack_right_end)
    if crack_left_end == 0.0:
        mouth_or_middle_position = crack_left_end
    elif crack_right_end == width:
        mouth_or_middle_position = crack_right_end
    return [
        _GradedCrackFace(scene, mouth_or_middle_position, tip_position)
        for tip_position in (crack_left_end, crack_right_end)
        if tip_position != mouth_or_middle_position
    ]


def _graded_columns_and_rows(scene: Scene) -> tuple[list[ElementInterval], list[ElementInterval]]:
    """Divide a plate into block columns and rows with short elements at tips and cracks.

    Columns are divided at tips, rows at cracks. Without cracks the plate is a single block with
    elements of length ``mesh.size``.
    """
    (width, height), element_size = scene.geometry.sides, scene.mesh.given("size")
    if not scene.crack_by_name:
        columns, rows = (
            [ElementInterval(0.0, side_length, max(1, round(side_length / element_size)), 1.0)]
            for side_length in (width, height)
        )
        return columns, rows
    graded_faces: list[_GradedCrackFace] = []
    crack_heights_and_element_lengths: list[tuple[float, float]] = []
    for crack in scene.crack_by_name.values():
        for face in _graded_crack_faces(scene, crack):
            graded_faces.append(face)
            crack_heights_and_element_lengths.append((crack.height or 0.0, face.tip_element_length))
    tips_and_element_lengths = [
        (face.tip_position, face.tip_element_length) for face in graded_faces
    ]
    return _intervals_with_graded_elements(
        width, tips_and_element_lengths, graded_faces, element_size
    ), _intervals_with_graded_elements(height, crack_heights_and_element_lengths, [], element_size)


def _intervals_with_graded_elements(
    extent: float,
    tip_positions_and_element_lengths: list[tuple[float, float]],
    faces: list[_GradedCrackFace],
    size: float,
) -> list[ElementInterval]:
    """Divide a plate's side into intervals with short elements at tips or cracks.

    Used for the plate's width, with the tips on it, and for its height, with the cracks on it.

    Parameters
    ----------
    extent : float [m]
        Length of the side.
    tip_positions_and_element_lengths : list of (position, length) [m]
        Position of each tip or crack on the side, and the element length there.
    faces : list of _GradedCrackFace
        Crack faces along the side; empty for the height.
    size : float [m]
        Element length far from tips and cracks.

    Returns
    -------
    list of ElementInterval
        Intervals from 0 to ``extent``.
    """
    # Closer positions are equal; cracks and tips are farther from the plate's edges.
    tolerance = MIN_RELATIVE_CELL_SIZE * extent

    def lengths_at_tip(cut_position: float) -> list[float]:
        """Return the element lengths [m] prescribed at a position; empty off tips and cracks."""
        return [
            tip_length
            for tip, tip_length in tip_positions_and_element_lengths
            if abs(tip - cut_position) <= tolerance
        ]

    def element_length(cut_position: float, faces_along: list[_GradedCrackFace]) -> float:
        """Return the element length [m] at a position.

        The crack faces ``faces_along`` or a tip require the shortest length. Without faces the
        length is at most ``size``.
        """
        return min(
            ([face.element_length(cut_position) for face in faces_along] or [size])
            + lengths_at_tip(cut_position)
        )

    def make_intervals(start: float, stop: float) -> list[ElementInterval]:
        """Divide the side between two neighbouring cuts [m] into one or two intervals.

        Between two tips, or two cracks, elements grow from both to the middle: two intervals.
        """
        faces_along = [face for face in faces if face.covers(start, stop)]
        for face in faces_along if len(faces_along) == 1 else ():
            ends = sorted((face.mouth_or_middle_position, face.tip_position))
            if max(abs(ends[0] - start), abs(ends[1] - stop)) <= tolerance:
                length_ratio = (
                    face.length_over_next_from_tip
                    if face.tip_position > face.mouth_or_middle_position
                    else 1.0 / face.length_over_next_from_tip
                )
                return [ElementInterval(start, stop, face.n_elements, length_ratio)]
        start_length = element_length(start, faces_along)
        stop_length = element_length(stop, faces_along)
        if not (lengths_at_tip(start) and lengths_at_tip(stop)):
            return [
                _make_graded_element_interval(start, stop, start_length, stop_length, faces_along)
            ]
        middle = 0.5 * (start + stop)
        max_length = max(
            start_length, stop_length, MAX_ELEMENT_LENGTH_PER_DISTANCE * 0.5 * (stop - start)
        )
        middle_length = min(max_length, element_length(middle, faces_along))
        segments = (
            (start, middle, start_length, middle_length),
            (middle, stop, middle_length, stop_length),
        )
        return [_make_graded_element_interval(*segment, faces_along) for segment in segments]

    interval_bounds = [0.0]
    cuts = [cut_position for cut_position, _ in tip_positions_and_element_lengths] + [
        face.mouth_or_middle_position for face in faces
    ]
    for cut_position in sorted([*cuts, extent]):
        if cut_position - interval_bounds[-1] > tolerance:
            interval_bounds.append(cut_position)
    return [interval for ends in pairwise(interval_bounds) for interval in make_intervals(*ends)]


def _make_graded_element_interval(
    start: float,
    stop: float,
    start_length: float,
    stop_length: float,
    faces: list[_GradedCrackFace],
) -> ElementInterval:
    """Return the interval from ``start`` to ``stop`` [m] with geometrically graded elements.

    Element lengths change from about ``start_length`` to about ``stop_length`` [m]. If crack faces
    ``faces`` lie along the interval, the elements are at least as many as on any of these faces.
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
    """Return the number and the length ratio of elements that grow along an interval.

    Each element's length is the ratio times the previous length. The elements grow from about
    ``min_length`` to about ``max_length``; no element is longer than half the interval. All lengths
    have the same unit.
    """
    if min_length >= max_length:
        return math.ceil(interval_length / max_length), 1.0
    max_length = min(max_length, 0.5 * interval_length)
    if min_length >= max_length:
        return (1 if interval_length <= min_length else 2), 1.0
    growth_ratio = (interval_length - min_length) / (interval_length - max_length)
    n_elements = max(1, round(1.0 + math.log(max_length / min_length) / math.log(growth_ratio)))
    return n_elements, (max_length / min_length) ** (1.0 / max(n_elements - 1, 1))


@dataclass(frozen=True)
class PointGrading:
    """Element length h = min_length + length_per_distance d around a point.

    d is the distance from the point. Lengths are in gmsh's unit.

    Attributes
    ----------
    point : (float, float)
        Coordinates x, y.
    min_length : float
        Element length at the point.
    length_per_distance : float
        Increase of the element length per distance.
    """

    point: tuple[float, float]
    min_length: float
    length_per_distance: float


def crack_tip_gradings(scene: Scene) -> list[PointGrading]:
    """Return a grading of element lengths around each crack tip in a plate.

    A grading states the element length as a function of the distance from the tip.
    """
    return [
        PointGrading(
            (face.tip_position, crack.given("height")),
            face.tip_element_length,
            max(1.0 / face.length_over_next_from_tip - 1.0, MAX_ELEMENT_LENGTH_PER_DISTANCE),
        )
        for crack in scene.crack_by_name.values()
        for face in _graded_crack_faces(scene, crack)
    ]
