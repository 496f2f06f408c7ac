"""How a plate is cut into blocks at its cracks, and each block's sides into elements.

Lines through all tips and along all cracks cut the plate into a tensor product of blocks: columns
of them between neighbouring tips, rows between neighbouring cracks. Elements grow geometrically
away from tips and from cracks, so the size is linear in the distance. Between two tips, or two
cracks, they grow from both to the middle, where the block is cut once more. A crack inside the
plate is two halves that meet in its middle, each like an edge crack whose mouth is there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.model.memory import machine_memory
from fenics_crack.scene.scene import Scene

__all__ = ["SMALLEST_CELL", "Interval", "Slit", "check_cells", "lip_pairs", "plate_blocks"]

SMALLEST_CELL = 1e-7
"""Relative to the plate: gmsh and the matrices allow no smaller one."""
GROWTH = 1.0 / 3.0
"""Size of elements between two tips or two cracks over their distance from either, at most."""
MAX_CELLS = 5_000_000
"""Of what is meshed here; a mesh file may have any number of cells."""
ASSEMBLED = 1500.0
"""Bytes of mesh and matrices for each degree of freedom."""


@dataclass(frozen=True)
class Interval:
    """Part of a side: from, to, and its division into elements.

    ``progression`` is the ratio of the lengths of neighbouring elements.
    """

    start: float
    stop: float
    count: int
    progression: float = 1.0


@dataclass(frozen=True)
class Slit:
    """A crack in the blocks: its row, and the columns' ends at its own ends; which are tips."""

    row: int
    left: int
    right: int
    left_is_tip: bool
    right_is_tip: bool


@dataclass(frozen=True)
class _Half:
    """A lip from its coarse end (the mouth, or the middle of a crack inside) to a tip."""

    coarse: float
    tip: float
    count: int
    ratio: float  # of neighbouring elements, towards the tip
    tip_size: float

    def covers(self, start: float, stop: float) -> bool:
        """Tell whether the lip goes along an interval."""
        return min(self.coarse, self.tip) < 0.5 * (start + stop) < max(self.coarse, self.tip)

    def size(self, place: float) -> float:
        """Length of an element at a place on the lip."""
        first = self.tip_size / self.ratio ** (self.count - 1)
        share = (place - self.tip) / (self.coarse - self.tip)
        return self.tip_size + share * (first - self.tip_size)

    def elements(self, start: float, stop: float) -> float:
        """The integral of 1 / size over an interval: its elements."""
        one, other = self.size(start), self.size(stop)
        if abs(one - other) < 1e-9 * one:
            return (stop - start) / one
        return (stop - start) * math.log(one / other) / (one - other)


def plate_blocks(scene: Scene) -> tuple[list[Interval], list[Interval], list[Slit], bool]:
    """Columns and rows of blocks, the cracks in them, and whether x runs from right to left.

    It does where all cracks begin at the right edge: their meshes mirror those of the left.

    Raises
    ------
    InputError
        Elements at a tip are too small.
    """
    width, height = scene.geometry.sides
    cracks = list(scene.all_cracks.values())
    mirrored = bool(cracks) and all(crack.edge == "right" for crack in cracks)
    if mirrored:
        cracks = [replace(crack, edge="left") for crack in cracks]
    spans = [crack.span(width) for crack in cracks]
    levels = [crack.height or 0.0 for crack in cracks]
    if scene.mesh.layout == "grid":
        ends = [end for span in spans for end in span]
        columns = _equal(width, scene.mesh.given("columns"), ends)
        rows = _equal(height, scene.mesh.given("rows"), levels)
    else:
        columns, rows = _graded_plate(scene, spans, levels)
    xs, ys = (np.array([side[0].start, *(i.stop for i in side)]) for side in (columns, rows))
    slits = [
        Slit(
            row=_nearest(ys, level),
            left=_nearest(xs, span[0]),
            right=_nearest(xs, span[1]),
            left_is_tip=crack.edge != "left",
            right_is_tip=crack.edge != "right",
        )
        for crack, span, level in zip(cracks, spans, levels, strict=True)
    ]
    return columns, rows, slits, mirrored


def check_cells(scene: Scene, key: str, cells: float, per_cell: int) -> None:
    """Raise InputError where there are too many cells for gmsh, or their matrices, of so many
    degrees of freedom per cell, would not fit."""
    needed, machine = ASSEMBLED * per_cell * cells, machine_memory()
    reason = ""
    if cells > MAX_CELLS:
        reason = f"{cells:.2g} are more than {MAX_CELLS:.0e}"
    elif needed > machine:
        reason = (
            f"the matrices of {cells:.2g} need about {needed / 2**30:.0f} GiB of this machine's "
            f"{machine / 2**30:.3g}"
        )
    if reason:
        allowed = f"so that there are fewer cells: {reason}"
        raise InputError(f"mesh.{key}", getattr(scene.mesh, key), allowed)


def lip_pairs(scene: Scene) -> int:
    """Upper bound of the pairs of a plate with cracks, whose first length may be unknown yet."""
    crack, order = scene.crack, scene.mesh.order
    if crack is not None and crack.length is None:  # the only one
        return ((scene.mesh.lip_elements or 0) + 1) * order
    columns, _, slits, _ = plate_blocks(scene)
    counts = [sum(column.count for column in columns[s.left : s.right]) for s in slits]
    return sum(count * order for count in counts)


def _equal(extent: float, count: int, cuts: list[float]) -> list[Interval]:
    """A side of equal elements, cut at places on its grid lines."""
    places = {round(cut / extent * count): cut for cut in cuts} | {0: 0.0, count: extent}
    return [
        Interval(places[first], places[last], last - first)
        for first, last in pairwise(sorted(places))
    ]


def _nearest(places: np.ndarray, place: float) -> int:
    return int(np.argmin(np.abs(places - place)))


# --- graded sides ---------------------------------------------------------------------------------


def _graded_plate(
    scene: Scene, spans: list[tuple[float, float]], levels: list[float]
) -> tuple[list[Interval], list[Interval]]:
    """Columns and rows that are graded towards tips and cracks."""
    (width, height), size = scene.geometry.sides, scene.mesh.given("size")
    if not spans:
        cells = [max(1, round(side / size)) for side in (width, height)]
        return [Interval(0.0, width, cells[0])], [Interval(0.0, height, cells[1])]
    halves: list[_Half] = []
    fine: list[tuple[float, float]] = []
    for (left, right), level in zip(spans, levels, strict=True):
        if left == 0.0:
            own = [_half(scene, left, right)]
        elif right == width:
            own = [_half(scene, right, left)]
        else:
            middle = 0.5 * (left + right)
            own = [_half(scene, middle, left), _half(scene, middle, right)]
        fine.append((level, min(half.tip_size for half in own)))
        halves += own
    tips = [(half.tip, half.tip_size) for half in halves]
    return (_Side(width, tips, halves, size).intervals(), _Side(height, fine, [], size).intervals())


def _half(scene: Scene, coarse: float, tip: float) -> _Half:
    """A lip of ``lip_elements`` from a mouth, or of half of them from the middle of a crack."""
    mesh, (width, height) = scene.mesh, scene.geometry.sides
    count = mesh.given("lip_elements")
    if coarse not in (0.0, width):
        count = -(-count // 2)
    ratio = mesh.grading ** (-1.0 / max(count - 1, 1))
    shares = ratio ** np.arange(count)
    tip_size = float(abs(tip - coarse) * shares[-1] / shares.sum())
    if tip_size < SMALLEST_CELL * max(width, height):
        allowed = f"smaller, for this crack: the element at its tip is only {tip_size:.1g} m"
        raise InputError("mesh.grading", mesh.grading, allowed)
    return _Half(coarse, tip, count, ratio, tip_size)


@dataclass(frozen=True)
class _Side:
    """A side with elements of given lengths at its tips (or cracks), and along its lips."""

    extent: float
    tips: list[tuple[float, float]]  # place, length of an element there
    halves: list[_Half]
    size: float  # elsewhere

    @property
    def nearest(self) -> float:
        """Places no farther apart are one; cracks and tips are farther from the plate's edges."""
        return SMALLEST_CELL * self.extent

    def intervals(self) -> list[Interval]:
        places = [0.0]
        cuts = [place for place, _ in self.tips] + [half.coarse for half in self.halves]
        for place in sorted([*cuts, self.extent]):
            if place - places[-1] > self.nearest:
                places.append(place)
        return [part for ends in pairwise(places) for part in self._parts(*ends)]

    def _parts(self, start: float, stop: float) -> list[Interval]:
        """Intervals between two neighbouring places: one, or two that meet half-way."""
        over = [half for half in self.halves if half.covers(start, stop)]
        for half in over if len(over) == 1 else ():
            ends = sorted((half.coarse, half.tip))
            if max(abs(ends[0] - start), abs(ends[1] - stop)) <= self.nearest:
                ratio = half.ratio if half.tip > half.coarse else 1.0 / half.ratio
                return [Interval(start, stop, half.count, ratio)]
        first, last = self._size(start, over), self._size(stop, over)
        if not (self._tip_sizes(start) and self._tip_sizes(stop)):
            return [_between(start, stop, first, last, over)]
        middle = 0.5 * (start + stop)
        largest = max(first, last, GROWTH * 0.5 * (stop - start))
        between = min(largest, self._size(middle, over))
        return [
            _between(start, middle, first, between, over),
            _between(middle, stop, between, last, over),
        ]

    def _tip_sizes(self, place: float) -> list[float]:
        return [size for tip, size in self.tips if abs(tip - place) <= self.nearest]

    def _size(self, place: float, over: list[_Half]) -> float:
        """Length of elements at a place of an interval along which some lips go."""
        asked = [half.size(place) for half in over] or [self.size]
        return min(asked + self._tip_sizes(place))


def _between(start: float, stop: float, first: float, last: float, over: list[_Half]) -> Interval:
    """An interval with elements from about ``first`` to about ``last``, enough for all lips."""
    small, large = sorted((first, last))
    count, growth = _graded(stop - start, small, large)
    enough = max((math.ceil(half.elements(start, stop) - 0.01) for half in over), default=0)
    if enough > count:
        count, growth = enough, (large / small) ** (1.0 / max(enough - 1, 1))
    return Interval(start, stop, count, growth if first <= last else 1.0 / growth)


def _graded(length: float, first: float, last: float) -> tuple[int, float]:
    """Elements growing geometrically from about ``first`` to about ``last``, or to half of a short
    ``length``, along it."""
    if first >= last:
        return math.ceil(length / last), 1.0
    last = min(last, 0.5 * length)
    if first >= last:
        return (1 if length <= first else 2), 1.0
    growth = (length - first) / (length - last)
    count = max(1, round(1.0 + math.log(last / first) / math.log(growth)))
    return count, (last / first) ** (1.0 / max(count - 1, 1))
