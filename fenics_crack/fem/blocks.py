"""Plates with cracks, and the rims below blades of a disk, which are meshed here by gmsh.

**A plate** is cut into blocks at all tips and along all cracks; for one edge crack into four,

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

**The graded sector of a plane disk** has triangles around the tips as long as tetrahedra around
the fronts of solids (:mod:`fenics_crack.fem.solid`) and, with h_0 = ``mesh.size`` / 32 and a slope
of ``mesh.size`` over the blade's width, around the corners between blade and rim: all of it scales
with ``mesh.size``.

gmsh's tolerances are lengths. So all is drawn in a unit by which a scene in mm has the mesh of one
in m (:func:`in_unit`), and then its nodes are scaled.
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
from fenics_crack.basics.threads import machine_memory
from fenics_crack.fem.cracks import CrackPath, Cracks, NamedParts
from fenics_crack.kernel import Struct, kernel
from fenics_crack.model.factor import factor_memory
from fenics_crack.scene.scene import Scene

SMALLEST_CELL = 1e-7
"""Minimum cell size relative to the plate: gmsh and the matrices allow no smaller one."""
MAX_SIZE_PER_DISTANCE = 1.0 / 3.0
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


def _plate_blocks(scene: Scene) -> tuple[list[Interval], list[Interval], list[Slit]]:
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


def check_cell_count(
    scene: Scene, key: str, cells: float, per_cell: int, shortest: str = ""
) -> None:
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


def _length(scene: Scene) -> float:
    """Length of elements away from cracks [m]; of a grid that along the plate."""
    return scene.mesh.size or scene.geometry.sides[1] / scene.mesh.given("rows")


def count_plate_pairs(scene: Scene) -> int:
    """Upper bound of the pairs of a plate with cracks, whose first length may be unknown yet."""
    crack, order = scene.crack, scene.mesh.order
    if crack is not None and crack.length is None:  # the only one
        return ((scene.mesh.lip_elements or 0) + 1) * order
    columns, _, slits = _plate_blocks(scene)
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


# --- the unit of length ---------------------------------------------------------------------------


def scale_to_mesh_unit(scene: Scene, unit: float = 0.0) -> tuple[Scene, float]:
    """Return a scene of the same mesh in the unit of length in which gmsh meshes, and that [m]; by
    default the power of ten by which the longest side is from 0.0316 to 0.316."""
    unit = unit or 10.0 ** (round(math.log10(max(scene.geometry.sides))) + 1)

    def scale_table(table: Any) -> Any:
        lengths = {
            key.name: np.divide(value, unit).tolist()
            for key in fields(table)
            if key.metadata.get("unit") == "m" and (value := getattr(table, key.name)) is not None
        }
        return replace(table, **lengths)

    unit_scene = copy(scene)  # a similar one: what has been checked holds
    for name in ("geometry", "mesh", "crack", "disk", "excitation"):
        vars(unit_scene)[name] = getattr(scene, name) and scale_table(getattr(scene, name))
    vars(unit_scene)["cracks"] = tuple(map(scale_table, scene.cracks))
    return unit_scene, unit


def _scale_nodes(unit: float) -> None:
    """Give the nodes of the current gmsh model in metres."""
    if unit != 1.0:
        numbers, positions, _ = gmsh.model.mesh.getNodes()
        for number, place in zip(numbers, unit * positions.reshape(-1, 3), strict=True):
            gmsh.model.mesh.setNode(number, place, [])


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
        largest = max(first, last, MAX_SIZE_PER_DISTANCE * 0.5 * (stop - start))
        between = min(largest, length(middle, over))
        both = (start, middle, first, between), (middle, stop, between, last)
        return [_between(*half, over) for half in both]

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


# --- a plate --------------------------------------------------------------------------------------


def draw_plate(scene: Scene) -> tuple[NamedParts, Cracks]:
    """Fill the current gmsh model with the mesh of a scene's plate; its named sides, and the faces
    of its cracks."""
    unit_scene, unit = scale_to_mesh_unit(scene)
    groups = _draw_blocks(scene, unit_scene)
    if scene.has_element_lengths:
        rim = Rim(unit_scene)
        of_group = gmsh.model.getEntitiesForPhysicalGroup
        left, right = (of_group(1, *groups[name]).tolist() for name in RIM_SIDES)
        rim.match(0, left, right)
        _mesh_graded(scene, unit_scene, [*_gradings(unit_scene), *rim.gradings()])
        gmsh.model.mesh.setPeriodic(1, right, right, np.eye(4).ravel().tolist())  # no more
    else:
        gmsh.model.mesh.generate(2)
    _scale_nodes(unit)
    return (groups, {}), _lips(scene)


def _lips(scene: Scene) -> tuple[CrackPath, ...]:
    """The faces of the cracks of a plate that is made here, in the order of the scene."""
    width, found = scene.geometry.sides[0], []
    for crack in scene.all_cracks.values():
        left, right = ((x, crack.given("height")) for x in crack.span(width))
        ends = (right, left) if crack.edge == "right" else (left, right)
        found.append(CrackPath(np.array(ends), crack.edge is not None))
    return tuple(found)


def _draw_blocks(scene: Scene, unit_scene: Scene) -> dict[str, tuple[int, ...]]:
    """Draw the plate of a scene, which is in a unit of its size, set how curves and surfaces are
    divided; return the tags of its sides."""
    columns, rows, _ = _plate_blocks(scene)
    cells: float = math.prod(sum(interval.count for interval in side) for side in (columns, rows))
    if scene.disk is not None:
        cells += Rim(scene).area / _length(scene) ** 2
    key = "columns" if scene.mesh.layout == "grid" else "size"
    check_cell_count(scene, key, cells, 2 * scene.mesh.order**2)

    columns, rows, slits = _plate_blocks(unit_scene)
    rim = None if unit_scene.disk is None else Rim(unit_scene)
    xs, ys = ([0.0, *(interval.stop for interval in side)] for side in (columns, rows))
    add_point = gmsh.model.geo.addPoint
    feet = [0.0 if rim is None else rim.foot(x) for x in xs]
    points = {
        (i, j): add_point(x, y if j else feet[i], 0.0)
        for i, x in enumerate(xs)
        for j, y in enumerate(ys)
    }
    last = len(columns)  # and the first one are at edges, where no tip is
    doubled = [
        (i, row)
        for row, along in slits
        for i in range(along.start + (along.start > 0), along.stop + (along.stop == last))
    ]
    over = {(i, j): add_point(xs[i], ys[j], 0.0) for i, j in doubled}
    above = points | over  # of the blocks over a crack

    horizontal, vertical = {}, {}
    faces = {(i, row): columns[i] for row, along in slits for i in along}
    if scene.has_element_lengths:  # on the faces of cracks alone they are counted
        columns, rows = ([replace(part, count=0) for part in side] for side in (columns, rows))
    for i, column in enumerate(columns):
        for j in range(len(ys)):
            horizontal[i, j] = _curve(points[i, j], points[i + 1, j], faces.get((i, j), column))
    for j, row in enumerate(rows):
        for i in range(len(xs)):
            vertical[i, j] = _curve(above[i, j], points[i, j + 1], row)
    upper = {(i, j): _curve(above[i, j], above[i + 1, j], part) for (i, j), part in faces.items()}
    surfaces = []
    for i in range(len(columns)):
        for j in range(len(rows)):
            below = upper.get((i, j), horizontal[i, j])
            loop = [below, vertical[i + 1, j], -horizontal[i, j + 1], -vertical[i, j]]
            surfaces.append(gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(loop)]))
    foot = [horizontal[i, 0] for i in range(len(columns))]
    sides: dict[str, tuple[int, list[int]]] = {"clamp": (1, foot)}
    if rim is not None:
        sides = rim.draw([points[i, 0] for i in range(len(xs))], foot, columns, surfaces)
    _divide(scene, surfaces)

    left, right = ([vertical[i, j] for j in range(len(rows))] for i in (0, len(columns)))
    single, point = [at for at in points if at not in doubled], unit_scene.excitation.point
    loaded = [points[i, j] for i, j in single if (xs[i], ys[j]) == point]
    groups: dict[str, tuple[int, list[int]]] = {
        "plate": (2, surfaces),
        **sides,
        "lower_lip": (1, [horizontal[place] for place in upper]),
        "upper_lip": (1, list(upper.values())),
        "load": (0, loaded),
        "left": (1, left),
        "right": (1, right),
        "top": (1, [horizontal[i, len(rows)] for i in range(len(columns))]),
    }
    curves = {name: tag for name, tag in _name(groups).items() if groups[name][0] == 1}
    if rim is None:
        curves["bottom"] = curves["clamp"]
    return {name: (tag,) for name, tag in curves.items()}


def _name(groups: dict[str, tuple[int, list[int]]]) -> dict[str, int]:
    """Make named groups of entities of a dimension, where there are some; the tag of each."""
    found = {name: tag for tag, (name, (_, own)) in enumerate(groups.items(), 1) if own}
    for name, tag in found.items():
        dimension, own = groups[name]
        gmsh.model.addPhysicalGroup(dimension, own, tag)
        gmsh.model.setPhysicalName(dimension, tag, name)
    return found


def _divide(scene: Scene, surfaces: list[int]) -> None:
    """Set how the surfaces are filled with cells."""
    if scene.has_element_lengths or (scene.mesh.layout, scene.mesh.cells) == ("graded", "triangle"):
        gmsh.option.setNumber("Mesh.Algorithm", 6)  # frontal Delaunay
        surfaces = []
    for surface in surfaces:
        gmsh.model.geo.mesh.setTransfiniteSurface(surface)
        if scene.mesh.cells == "quadrilateral":
            gmsh.model.geo.mesh.setRecombine(2, surface)
    gmsh.model.geo.synchronize()


def _curve(start: int, end: int, division: Interval, center: int | None = None) -> int:
    """A line, or an arc around a center, divided into elements."""
    geo = gmsh.model.geo
    points = (start, end) if center is None else (start, center, end)
    curve: int = (geo.addLine if center is None else geo.addCircleArc)(*points)
    if division.count:  # else elements have lengths by :func:`_mesh_graded`
        nodes, ratio = division.count + 1, division.progression
        gmsh.model.geo.mesh.setTransfiniteCurve(curve, nodes, "Progression", ratio)
    return curve


# --- the rim below a blade of a disk --------------------------------------------------------------

CORNER_SIZE_RATIO = 1.0 / 32.0
"""Length of elements at the corners between blade and rim, relative to ``mesh.size``."""
RIM_SIDES = ("rim_left", "rim_right")
"""Names of the sides of a sector made here: "left" and "right" are those of its blade."""


class Rim:
    """The part of a disk's rim that belongs to one blade, between two circles around the axis.

    Attributes
    ----------
    middle, axis : float [m]
        Place of the blade's middle across, and of the axis along the blade.
    inner, outer : float [m]
        Radii.
    half : float [rad]
        Half of the angle of a sector.
    """

    def __init__(self, scene: Scene) -> None:
        """Take a scene whose sector is made here."""
        self.scene, disk, place = scene, scene.given("disk"), scene.axis[0]
        self.middle, self.axis = float(place[0 if scene.dimension == 2 else 2]), float(place[1])
        self.inner, self.outer = disk.given("inner_radius"), disk.given("outer_radius")
        self.half = math.pi / disk.sectors

    @property
    def area(self) -> float:
        """Of the rim's part [m^2]."""
        return self.half * (self.outer**2 - self.inner**2)

    def foot(self, place: float) -> float:
        """Where the blade meets the rim, at a place across."""
        return self.axis + math.sqrt(self.outer**2 - (place - self.middle) ** 2)

    def at(self, radius: float, angle: float) -> tuple[float, float]:
        """A point, by its angle from the middle of the blade to the right."""
        return self.middle + radius * math.sin(angle), self.axis + radius * math.cos(angle)

    def with_box(self, width: float, height: float, thickness: float) -> list[tuple[int, int]]:
        """The volume of a solid's sector: the rim, as thick as the blade is wide, and the blade."""
        occ = gmsh.model.occ
        corners = [(r, a) for r in (self.inner, self.outer) for a in (-self.half, self.half)]
        places = [self.at(*corner) for corner in corners]
        low, low_end, top, top_end = (occ.addPoint(0.0, along, z) for z, along in places)
        center = occ.addPoint(0.0, self.axis, self.middle)
        curves = [
            occ.addCircleArc(low, center, low_end), occ.addLine(low_end, top_end),
            occ.addCircleArc(top_end, center, top), occ.addLine(top, low),
        ]  # fmt: skip
        face = occ.addPlaneSurface([occ.addCurveLoop(curves)])
        rim = [one for one in occ.extrude([(2, face)], width, 0.0, 0.0) if one[0] == 3]
        depth = 0.5 * (-self.foot(0.0) + self.outer - self.inner)
        blade = [(3, occ.addBox(0.0, -depth, 0.0, width, height + depth, thickness))]
        return list(occ.fuse(rim, blade)[0])

    def gradings(self) -> list[_Grading]:
        """Lengths of elements around the corners between the blade and the rim, where stress is
        infinite: the shorter, and the less growing, the smaller ``mesh.size`` is."""
        (width, _), size = self.scene.geometry.sides, self.scene.mesh.given("size")
        ends = np.array([0.0, width])
        return [_Grading(ends, self.foot(0.0), CORNER_SIZE_RATIO * size, size / width)]

    def name_of(self, middle: tuple[float, float, float]) -> str:
        """The name of a face of a solid's rim, by its center of mass."""
        across, along = middle[2] - self.middle, middle[1] - self.axis
        radius, angle = math.hypot(across, along), math.atan2(across, along)
        if abs(abs(angle) - self.half) < 1e-6:
            return RIM_SIDES[int(angle > 0.0)]
        bent = self.inner * math.sin(self.half) / self.half  # of an arc
        return "clamp" if abs(radius - bent) < 1e-6 * self.outer else "rim"

    def match(self, across: int, left: list[int], right: list[int]) -> None:
        """Let gmsh mesh the right side as its left one, turned in the plane of y and another axis:
        the curves of a plate, or the surfaces of a solid."""
        c, s = math.cos(2.0 * self.half), math.sin(2.0 * self.half)
        turn, place, plane = np.eye(4), np.zeros(3), [1, across]
        turn[np.ix_(plane, plane)] = [[c, -s], [s, c]]
        place[plane] = self.axis, self.middle
        turn[:3, 3] = place - turn[:3, :3] @ place
        gmsh.model.mesh.setPeriodic(1 + across // 2, right, left, turn.ravel().tolist())

    def draw(
        self, feet: list[int], below: list[int], columns: list[Interval], surfaces: list[int]
    ) -> dict[str, tuple[int, list[int]]]:
        """Draw it below the curves of a plate's lower edge, in blocks; its named curves."""
        size, geo = _length(self.scene), gmsh.model.geo
        around = self.half - math.asin((columns[-1].stop - self.middle) / self.outer)
        lengths = self.outer * around, self.outer - self.inner
        counts = [max(1, round(length / size)) if columns[0].count else 0 for length in lengths]
        beside, deep = (Interval(0.0, 1.0, count, 1.0) for count in counts)
        center = geo.addPoint(self.middle, self.axis, 0.0)
        places = [columns[0].start, *(column.stop for column in columns)]
        angles = [math.asin((x - self.middle) / self.outer) for x in places]
        angles = [-self.half, *angles, self.half]
        left, right = (geo.addPoint(*self.at(self.outer, a), 0.0) for a in (-self.half, self.half))
        top = [left, *feet, right]
        low = [geo.addPoint(*self.at(self.inner, angle), 0.0) for angle in angles]
        parts = [beside, *columns, beside]
        radial = [_curve(one, other, deep) for one, other in zip(low, top, strict=True)]
        arcs = zip(pairwise(low), parts, strict=True)
        inside = [_curve(*ends, part, center) for ends, part in arcs]
        outside = [_curve(a, b, beside, center) for a, b in (top[:2], top[-2:])]
        outside[1:1] = below
        for place in range(len(parts)):
            loop = [inside[place], radial[place + 1], -outside[place], -radial[place]]
            surfaces.append(geo.addPlaneSurface([geo.addCurveLoop(loop)]))
        return {"clamp": (1, inside), RIM_SIDES[0]: (1, radial[:1]), RIM_SIDES[1]: (1, radial[-1:])}


# --- graded sectors -----------------------------------------------------------------------------


def _mesh_graded(scene: Scene, unit_scene: Scene, gradings: list[_Grading]) -> None:
    """Fill what is drawn with elements ``mesh.size`` long, and shorter by some gradings.

    Raises
    ------
    InputError
        gmsh cannot.
    """
    size, around = unit_scene.mesh.given("size"), [one.compiled() for one in gradings]

    def length(dimension: int, tag: int, x: float, y: float, *_: float) -> float:
        """Asked for a hundred thousand times a mesh."""
        return min([size, *(kernel.length_at(one.at, x, y) for one in around)])

    for option in ("MeshSizeFromPoints", "MeshSizeExtendFromBoundary", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.model.mesh.setSizeCallback(length)
    try:
        gmsh.model.mesh.generate(2)
    except Exception as error:  # gmsh raises nothing else
        raise meshing_refusal(scene, str(error)) from None
    finally:
        gmsh.model.mesh.removeSizeCallback()


def meshing_refusal(scene: Scene, reason: str) -> InputError:
    """The refusal of what gmsh makes no sound mesh of: of its smallest crack, or else of the
    size of elements."""
    sizes = {
        f"{name}.{key}": value
        for name, crack in scene.all_cracks.items()
        for key in ("depth", "length", "radii")
        if (value := getattr(crack, key)) is not None
    }
    key = min(sizes, key=lambda one: np.min(sizes[one]), default="mesh.size")
    kind = scene.geometry.kind
    allowed = f"such that gmsh can mesh the {kind} ({reason}): not as small beside its other sizes"
    return InputError(key, sizes.get(key, scene.mesh.size), allowed)


@dataclass(frozen=True)
class _Grading:
    """Lengths of elements h = shortest + growth d around points, d from the nearest.

    Attributes
    ----------
    along, height : (n,), () [m]
        x and y of the points.
    shortest : float [m]
        Of an element there.
    growth : float
        With the distance.
    """

    along: np.ndarray
    height: float
    shortest: float
    growth: float

    def compiled(self) -> Struct:
        """As the kernel takes it (``length_at``)."""
        return Struct("grading", count=len(self.along), **vars(self))


def _gradings(scene: Scene) -> list[_Grading]:
    """One for each crack of a plate, around its tips."""
    (width, _), mesh, found = scene.geometry.sides, scene.mesh, []
    for crack in scene.all_cracks.values():
        count = mesh.given("lip_elements")
        first, last = crack.span(width)
        reach = last - first
        if crack.edge is None:
            count, reach = -(-count // 2), 0.5 * reach  # as of :class:`_Half`
        growth = mesh.grading ** (1.0 / max(count - 1, 1))
        shortest = reach / float((growth ** np.arange(count)).sum())
        tips = np.array([end for end in (first, last) if 0.0 < end < width])
        growth_by_distance = max(growth - 1.0, MAX_SIZE_PER_DISTANCE)
        found.append(_Grading(tips, crack.given("height"), shortest, growth_by_distance))
    return found
