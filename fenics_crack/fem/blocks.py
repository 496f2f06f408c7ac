"""Plates with cracks in blocks of cells. Those of quadrilaterals are meshed here.

A plate is cut into blocks at all tips and along all cracks; for one edge crack into four,

    mouth side  +-----------+---------------+
                |           |               |      upper blocks
                +===upper===+---ligament----+
                +===lower===+---------------+
                |           tip             |      lower blocks
                +-----------+---------------+
                    clamped (y = 0)

which gives the crack faces identical nodes, lets quadrilaterals be graded towards the tip block by
block and makes the uniform grid of the paper a special case. Blocks are a tensor product: columns
of them between neighbouring tips, rows between neighbouring cracks. Elements grow geometrically
away from tips and from cracks, so the size is linear in the distance. Between two tips, or two
cracks, they grow from both to the middle, where the block is cut once more. A crack inside the
plate is two halves that meet in its middle, each like an edge crack whose mouth is there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.threads import machine_memory
from fenics_crack.fem.cracks import Lip
from fenics_crack.model.factor import factor_memory
from fenics_crack.scene.scene import Scene

SMALLEST_CELL = 1e-7
"""Minimum cell size relative to the plate: gmsh and the matrices allow no smaller one."""
GROWTH = 1.0 / 3.0
"""Maximum size of elements between two crack tips or two cracks over their distance from either."""


@dataclass(frozen=True)
class Interval:
    """Part of a side: from, to, and its division into elements.

    ``progression`` is the ratio of the lengths of neighbouring elements.
    """

    start: float
    stop: float
    count: int
    progression: float

    @property
    def ends(self) -> np.ndarray:
        """Where its elements end: (count,), the last one at ``stop``."""
        lengths = self.progression ** np.arange(self.count)
        shares = np.cumsum(lengths) / lengths.sum()
        shares[-1] = 1.0
        return self.start + (self.stop - self.start) * shares


Slit = tuple[int, range]
"""A crack in the blocks: its row, and the columns along it. Its ends inside the plate are tips."""


class _Half:
    """A crack face from its coarse end to a tip: ``lip_elements`` from a mouth, or half of them
    from the middle of a crack inside, and ``ratio`` of neighbouring ones, towards the tip."""

    def __init__(self, scene: Scene, coarse: float, tip: float) -> None:
        mesh, (width, height) = scene.mesh, scene.geometry.sides
        self.coarse, self.tip, self.count = coarse, tip, mesh.given("lip_elements")
        if coarse not in (0.0, width):
            self.count = -(-self.count // 2)
        self.ratio = mesh.grading ** (-1.0 / max(self.count - 1, 1))
        shares = self.ratio ** np.arange(self.count)
        self.tip_size = float(abs(tip - coarse) * shares[-1] / shares.sum())
        if self.tip_size < SMALLEST_CELL * max(width, height):
            allowed = "smaller, for this crack: the element at its tip is only "
            raise InputError("mesh.grading", mesh.grading, f"{allowed}{self.tip_size:.1g} m")

    def covers(self, start: float, stop: float) -> bool:
        """Return True if the face goes along an interval."""
        return min(self.coarse, self.tip) < 0.5 * (start + stop) < max(self.coarse, self.tip)

    def size(self, place: float) -> float:
        """Length of an element at a place on the face."""
        first = self.tip_size / self.ratio ** (self.count - 1)
        share = (place - self.tip) / (self.coarse - self.tip)
        return self.tip_size + share * (first - self.tip_size)

    def elements(self, start: float, stop: float) -> float:
        """The integral of 1 / size over an interval: its elements."""
        one, other = self.size(start), self.size(stop)
        if abs(one - other) < 1e-9 * one:
            return (stop - start) / one
        return (stop - start) * math.log(one / other) / (one - other)


def plate_blocks(scene: Scene) -> tuple[list[Interval], list[Interval], list[Slit]]:
    """Columns and rows of blocks, and the cracks in them.

    Raises
    ------
    InputError
        Elements at a tip are too small.
    """
    width, height = scene.geometry.sides
    cracks = list(scene.all_cracks.values())
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
        (_nearest(ys, level), range(*(_nearest(xs, end) for end in span)))
        for span, level in zip(spans, levels, strict=True)
    ]
    return columns, rows, slits


def check_cells(scene: Scene, key: str, cells: float, per_cell: int, shortest: str = "") -> None:
    """Raise InputError where there are too many cells for gmsh, or their matrices, of so many
    degrees of freedom per cell, or the factor of one would not fit."""
    dofs, most = per_cell * cells, 5e6  # a mesh file may have any number of cells
    factor = factor_memory(dofs, solid=scene.dimension == 3)
    assembled = 1500.0 * dofs  # bytes of mesh and matrices
    needed, machine = max(assembled, factor), machine_memory()
    reason = f"{cells:.2g} are more than {most:.0e}"
    if cells <= most:
        sizes = f"{needed / 2**30:.0f} GiB of this machine's {machine / 2**30:.3g}"
        reason = f"to solve {cells:.2g} takes about {sizes}"
    if cells > most or needed > machine:
        allowed = f"so that there are fewer cells{shortest}: {reason}"
        raise InputError(f"mesh.{key}", getattr(scene.mesh, key), allowed)


def element_length(scene: Scene) -> float:
    """Length of elements away from cracks [m]; of a grid that along the plate."""
    return scene.mesh.size or scene.geometry.sides[1] / scene.mesh.given("rows")


def lip_pairs(scene: Scene) -> int:
    """Upper bound of the pairs of a plate with cracks, whose first length may be unknown yet."""
    crack, order = scene.crack, scene.mesh.order
    if crack is not None and crack.length is None:  # the only one
        return ((scene.mesh.lip_elements or 0) + 1) * order
    columns, _, slits = plate_blocks(scene)
    return sum(columns[place].count * order for _, along in slits for place in along)


def _equal(extent: float, count: int, cuts: list[float]) -> list[Interval]:
    """A side of equal elements, cut at places on its grid lines."""
    places = {round(cut / extent * count): cut for cut in cuts} | {0: 0.0, count: extent}
    return [
        Interval(places[first], places[last], last - first, 1.0)
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
        return [Interval(0.0, width, cells[0], 1.0)], [Interval(0.0, height, cells[1], 1.0)]
    halves: list[_Half] = []
    fine: list[tuple[float, float]] = []
    for (left, right), level in zip(spans, levels, strict=True):
        mouth = left if left == 0.0 else right if right == width else 0.5 * (left + right)
        own = [_Half(scene, mouth, tip) for tip in (left, right) if tip != mouth]
        fine.append((level, min(half.tip_size for half in own)))
        halves += own
    tips = [(half.tip, half.tip_size) for half in halves]
    return _side(width, tips, halves, size), _side(height, fine, [], size)


def _side(
    extent: float, tips: list[tuple[float, float]], halves: list[_Half], size: float
) -> list[Interval]:
    """A side with elements of given lengths at its tips (or cracks), (place, length) each, along
    its crack faces, and elsewhere."""
    # Places no farther apart are one; cracks and tips are farther from the plate's edges.
    nearest = SMALLEST_CELL * extent

    def tip_sizes(place: float) -> list[float]:
        return [length for tip, length in tips if abs(tip - place) <= nearest]

    def length(place: float, over: list[_Half]) -> float:
        """Length of elements at a place of an interval along which some crack faces go."""
        return min(([half.size(place) for half in over] or [size]) + tip_sizes(place))

    def parts(start: float, stop: float) -> list[Interval]:
        """Intervals between two neighbouring places: one, or two that meet half-way."""
        over = [half for half in halves if half.covers(start, stop)]
        for half in over if len(over) == 1 else ():
            ends = sorted((half.coarse, half.tip))
            if max(abs(ends[0] - start), abs(ends[1] - stop)) <= nearest:
                ratio = half.ratio if half.tip > half.coarse else 1.0 / half.ratio
                return [Interval(start, stop, half.count, ratio)]
        first, last = length(start, over), length(stop, over)
        if not (tip_sizes(start) and tip_sizes(stop)):
            return [_between(start, stop, first, last, over)]
        middle = 0.5 * (start + stop)
        largest = max(first, last, GROWTH * 0.5 * (stop - start))
        between = min(largest, length(middle, over))
        return [
            _between(start, middle, first, between, over),
            _between(middle, stop, between, last, over),
        ]

    places = [0.0]
    cuts = [place for place, _ in tips] + [half.coarse for half in halves]
    for place in sorted([*cuts, extent]):
        if place - places[-1] > nearest:
            places.append(place)
    return [part for ends in pairwise(places) for part in parts(*ends)]


def _between(start: float, stop: float, first: float, last: float, over: list[_Half]) -> Interval:
    """An interval with elements from about ``first`` to about ``last``, enough for all crack
    faces."""
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


# --- a plate of quadrilaterals --------------------------------------------------------------------


@dataclass(frozen=True)
class Quadrilaterals:
    """A plate of quadrilaterals.

    Attributes
    ----------
    points : (n, 2) [m]
        Their corners.
    cells : (m, 4) int
        Corners of each: below, left and right; above, left and right.
    curves : dict of str to (k, 2) int
        Ends of the edges of named sides and crack faces.
    """

    points: np.ndarray
    cells: np.ndarray
    curves: dict[str, np.ndarray]


def mesh_plate(scene: Scene) -> Quadrilaterals:
    """Mesh the plate of a scene whose blocks are of quadrilaterals.

    Raises
    ------
    InputError
        There would be too many cells, or too small ones.
    """
    columns, rows, slits = plate_blocks(scene)
    xs, ys = (np.concatenate([[0.0], *(part.ends for part in side)]) for side in (columns, rows))
    check_cells(
        scene, "columns" if scene.mesh.layout == "grid" else "size",
        float(len(xs) - 1) * (len(ys) - 1), 2 * scene.mesh.order**2,
    )  # fmt: skip
    at, up = (np.cumsum([0, *(part.count for part in side)]) for side in (columns, rows))
    points = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    under = np.arange(len(points)).reshape(len(xs), len(ys))
    over = under.copy()
    """Corner at each place, of the cells below it and of those above it."""
    lower, upper = [], []
    for row, along in slits:
        first, last, level = at[along.start], at[along.stop], up[row]
        inner = slice(first + (first > 0), last + (last == len(xs) - 1))  # without tips
        twins = under[inner, level]
        over[inner, level] = len(points) + np.arange(len(twins))
        points = np.concatenate([points, points[twins]])
        lower.append(_edges(under[first : last + 1, level]))
        upper.append(_edges(over[first : last + 1, level]))
    cells = over[:-1, :-1], over[1:, :-1], under[:-1, 1:], under[1:, 1:]
    curves = {"clamp": _edges(under[:, 0]), "top": _edges(under[:, -1])}
    for name, side in (("left", 0), ("right", -1)):
        curves[name] = np.column_stack([over[side, :-1], under[side, 1:]])
    if slits:
        curves |= {"lower_lip": np.concatenate(lower), "upper_lip": np.concatenate(upper)}
    return Quadrilaterals(points, np.stack(cells, axis=-1).reshape(-1, 4), curves)


def _edges(chain: np.ndarray) -> np.ndarray:
    return np.column_stack([chain[:-1], chain[1:]])


def lips_of(scene: Scene) -> tuple[Lip, ...]:
    """The faces of the cracks of a plate that is made here, in the order of the scene."""
    width, found = scene.geometry.sides[0], []
    for crack in scene.all_cracks.values():
        left, right = ((x, crack.given("height")) for x in crack.span(width))
        ends = (right, left) if crack.edge == "right" else (left, right)
        found.append(Lip(np.array(ends), crack.edge is not None))
    return tuple(found)
