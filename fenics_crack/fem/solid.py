"""Meshes of solids: boxes with cracks, made by gmsh, and mesh files of any solid.

Both come as nodes, cells and named surfaces; cracks are among these, with nodes that exist once.
They are split here (:mod:`fenics_crack.fem.crack_surface`), and what is left is a gmsh model whose
groups are those of a plate: ``clamp``, ``lower_lip``, ``upper_lip``, and all others that have a
name.

The elements of a box are ``mesh.size`` long and, at a distance d from the front of a crack,

    h(d) = h_0 + max(r - 1, 1/3) d,    r = grading^(1 / (lip_elements - 1)),

h_0 such that ``lip_elements`` elements in a row, each r times as long as the one before, reach from
the front to the mouth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.fem.blocks import GROWTH, check_cells
from fenics_crack.fem.crack_surface import (
    FACETS,
    CrackSurface,
    SolidCells,
    cracks_between,
    split_surface,
)
from fenics_crack.fem.lips import rows_in
from fenics_crack.fem.msh_file import (
    CRACK,
    DEGENERATE,
    Given,
    Names,
    cells_of,
    determinants,
    facets_of,
    filled,
    groups_of,
    named_groups,
    parts_of,
    points_in,
    tags_of,
)  # fmt: skip
from fenics_crack.fem.msh_reader import groups
from fenics_crack.mesher import gmsh
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Crack

__all__ = ["solid_model"]

KINDS = {4: 2, 11: 9, 5: 3, 12: 10}
"""gmsh's kinds of tetrahedra and hexahedra of first and second order, and of their facets."""
SERENDIPITY = {17: "20", 29: "20"}
"""Kinds that are refused, and how many nodes they have."""
FRONT = 60
"""Points on each front from which distances are measured while meshing."""
PER_VOLUME = 5.0
"""Tetrahedra that gmsh makes of a volume h^3 where they are to be h long, of a fine mesh."""


def solid_model(scene: Scene) -> tuple[Names, tuple[CrackSurface, ...]]:
    """Fill the current gmsh model with the mesh of a scene's solid; its named surfaces and points,
    and its cracks.

    Raises
    ------
    InputError
        The mesh file is not one of a solid, or is damaged; a crack's surface cannot be split.
    """
    if scene.mesh.layout == "file":
        path = str(scene.mesh.file)
        try:
            return _filled(groups_of(Path(path)))
        except InputError as error:
            if error.key in ("mesh.file", "lips"):
                raise
            raise InputError("mesh.file", f"{path} ({error.value})", error.allowed) from None
    _draw(scene)
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    named = named_groups(groups())
    gmsh.model.remove()
    gmsh.model.add("fenics_crack")
    try:
        return _filled((numbers, positions.reshape(-1, 3), named))
    except InputError as error:
        raise _not_meshed(scene, f"{error.value}") from None


def _filled(given: Given) -> tuple[Names, tuple[CrackSurface, ...]]:
    """Split the cracks of a mesh and put it into the current model."""
    _, _, named = given
    kinds = {kind for dimension, _, _, kind, _ in named if dimension == 3}
    for kind in kinds & SERENDIPITY.keys():
        allowed = (
            "one of tetrahedra, or of hexahedra with 27 nodes: the load of a unit pressure is "
            "negative at corners of these"
        )
        raise InputError("mesh", f"hexahedra with {SERENDIPITY[kind]} nodes", allowed)
    if len(kinds) != 1 or not kinds <= KINDS.keys():
        allowed = "one whose physical volumes hold one kind of cells, tetrahedra or hexahedra"
        raise InputError("mesh", f"{len(kinds)} kinds of cells", allowed)
    kind = kinds.pop()
    used, nodes, places = cells_of(kind, given)
    if places is None:
        raise InputError("mesh", "cells with nodes that do not exist", "a whole file")
    cells = _cells(kind, nodes)
    for dimension, _, name, own, corners in named:
        if dimension == 2 and name and (own != KINDS[kind] or not np.isin(corners, used).all()):
            allowed = "one whose physical surfaces hold facets of its cells"
            raise InputError("mesh", f"a surface {name!r} of other cells", allowed)
    surfaces = facets_of(named, KINDS[kind], used)
    if "clamp" not in surfaces:
        raise InputError("mesh", "no clamp", "with a physical surface named 'clamp'")
    _check_cells(kind, cells, places)
    _check_inside(cells, surfaces)
    lips: tuple[CrackSurface, ...] = ()
    cracks = [name for name in surfaces if CRACK.match(name)]
    if cracks:
        surface = np.concatenate([surfaces.pop(name) for name in cracks])
        nodes, twins, both, found = split_surface(cells, surface, places)
        places, lips = np.concatenate([places, places[twins]]), tuple(found)
        surfaces = _moved(surfaces, cells, nodes, twins)
        surfaces |= {"lower_lip": both[:, 0], "upper_lip": both[:, 1]}
    sides = [surfaces[name] for name in ("lower_lip", "upper_lip") if name in surfaces]
    if len(sides) == 1:
        allowed = "one with both 'lower_lip' and 'upper_lip', or with 'crack', or none of them"
        raise InputError("mesh", "one lip", allowed)
    if sides and not lips:
        lower, upper = (side[:, : cells.facets.shape[1]] for side in sides)
        lips = tuple(cracks_between(lower, upper, places))
    parts_of(nodes, places, surfaces["clamp"], np.concatenate([*sides, surfaces["clamp"][:0]]))
    tags, sets = tags_of(surfaces)
    facets = [(2, tag, name, KINDS[kind], rows) for tag, name, rows in sets]
    filled(places, [(3, 1, "solid", kind, nodes), *facets])
    return (tags, points_in(given, 3)), lips


def _cells(kind: int, nodes: np.ndarray) -> SolidCells:
    """Cells with what gmsh says of their kind."""
    _, _, _, count, local, corners = gmsh.model.mesh.getElementProperties(kind)
    at = np.reshape(local, (count, 3))
    supports: list[tuple[int, ...]] = [(corner,) for corner in range(corners)]
    for node in range(corners, count):
        # The corners of the smallest face, edge or cell in whose middle it is.
        low, high = at[:corners].min(axis=0), at[:corners].max(axis=0)
        if corners == 4:
            shares = np.append(1.0 - at[node].sum(), at[node])[[0, 1, 2, 3]]
            supports.append(tuple(np.flatnonzero(shares > 1e-9).tolist()))
        else:
            at_side = np.isclose(at[node], low) | np.isclose(at[node], high)
            same = np.isclose(at[:corners], at[node])[:, at_side].all(axis=1)
            supports.append(tuple(np.flatnonzero(same).tolist()))
    return SolidCells(nodes, FACETS[corners], tuple(supports))


def _moved(
    surfaces: dict[str, np.ndarray], cells: SolidCells, nodes: np.ndarray, twins: np.ndarray
) -> dict[str, np.ndarray]:
    """Facets with the nodes that their cells have once cracks are split: beside a mouth those above
    the crack have new ones."""
    facets, owner, _ = cells.all_facets
    weights = (int(cells.nodes.max()) + 1) ** np.arange(3)[::-1]
    keys, width = facets[:, :3] @ weights, cells.facets.shape[1]  # three corners are enough
    found = {}
    for name, rows in surfaces.items():
        rows = rows.copy()
        beside = np.flatnonzero(np.isin(rows, twins).any(axis=1))
        wanted = np.sort(rows[beside, :width], axis=1)[:, :3] @ weights
        cell = owner[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)]
        at = np.argmax(cells.nodes[cell][:, None, :] == rows[beside][:, :, None], axis=2)
        rows[beside] = np.take_along_axis(nodes[cell], at, axis=1)
        found[name] = rows
    return found


def _check_cells(kind: int, cells: SolidCells, places: np.ndarray) -> None:
    """Raise InputError where a cell is folded or has no volume, or two lie on one side of the facet
    that they share."""
    least, most, smallest = determinants(kind, cells.nodes, places)
    here = places[cells.nodes]
    size = np.ptp(here, axis=1).max(axis=1)
    wrong = (smallest <= DEGENERATE * size**3) | (least * most < 0.0)
    if np.any(wrong):
        x, y, z = here[np.argmax(wrong)].mean(axis=0)
        found = f"a folded cell, or one of no volume, at ({x:g}, {y:g}, {z:g})"
        raise InputError("mesh", found, "one of cells that are convex and have a volume")
    facets, owner, _ = cells.all_facets
    first, second, third = places[facets[:, :3]].swapaxes(0, 1)
    normal = np.cross(second - first, third - first)
    side = np.sign(np.sum((here[owner, : cells.n_corners].mean(axis=1) - first) * normal, axis=1))
    same = np.all(facets[1:] == facets[:-1], axis=1)
    folded = same & (side[1:] == side[:-1])
    folded[1:] |= same[1:] & same[:-1]
    if np.any(folded):
        x, y, z = places[facets[np.argmax(folded)]].mean(axis=0)
        allowed = "one of cells beside each other: these lie on one side of their common facet"
        raise InputError("mesh", f"cells that overlap at ({x:g}, {y:g}, {z:g})", allowed)


def _check_inside(cells: SolidCells, surfaces: dict[str, np.ndarray]) -> None:
    """Raise InputError where a surface lies inside and is no crack by its name, nor the clamp:
    nothing would part there."""
    facets, _, _ = cells.all_facets
    shared = facets[1:][np.all(facets[1:] == facets[:-1], axis=1)]
    width = facets.shape[1]
    corners = {name: np.sort(rows[:, :width], axis=1) for name, rows in surfaces.items()}
    cracks = [rows for name, rows in corners.items() if CRACK.match(name)]
    known = np.concatenate([facets[:0], *cracks])
    for name, rows in corners.items():
        inside = rows_in(rows, shared) & ~rows_in(rows, known)
        if name != "clamp" and np.all(inside):
            allowed = "one whose surfaces inside are cracks, named 'crack' or 'crack 1', 'crack 2'"
            raise InputError("mesh", f"a surface {name!r} inside the solid", allowed)


# --- a box ----------------------------------------------------------------------------------------


def _draw(scene: Scene) -> None:
    """Mesh the box of a scene, with its cracks as surfaces inside, and name its faces."""
    gradings = _gradings(scene)
    _check_size(scene, gradings)
    width, height, thickness = scene.geometry.sides
    occ = gmsh.model.occ
    box = [(3, occ.addBox(0.0, 0.0, 0.0, width, height, thickness))]
    cracks = list(scene.all_cracks.values())
    faces = []
    for crack in cracks:
        face = _face(crack, width, thickness)
        faces += occ.intersect(face, box, removeObject=True, removeTool=False)[0]
    if faces:
        occ.fragment(box, faces)
    occ.synchronize()
    named: dict[str, list[int]] = {"clamp": [], "crack": []}
    sides = [
        ("left", 0, 0.0), ("right", 0, width), ("clamp", 1, 0.0), ("top", 1, height),
        ("back", 2, 0.0), ("front", 2, thickness),
    ]  # fmt: skip
    near = 1e-6 * max(width, height, thickness)
    for _, tag in gmsh.model.getEntities(2):
        middle = occ.getCenterOfMass(2, tag)
        at = [name for name, axis, place in sides if abs(middle[axis] - place) < near]
        named.setdefault(at[0] if at else "crack", []).append(tag)
    for number, (name, tags) in enumerate(named.items(), 2):
        if tags:
            gmsh.model.addPhysicalGroup(2, tags, number)
            gmsh.model.setPhysicalName(2, number, name)
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], 1)
    gmsh.model.setPhysicalName(3, 1, "solid")
    size = scene.mesh.given("size")

    def length(dimension: int, tag: int, x: float, y: float, z: float, *_: float) -> float:
        """Asked for a hundred thousand times a mesh."""
        return min([size, *(one.at(x, y, z) for one in gradings)])

    for option in ("MeshSizeFromPoints", "MeshSizeExtendFromBoundary", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.model.mesh.setSizeCallback(length)
    try:
        gmsh.model.mesh.generate(3)
    except Exception as error:  # gmsh raises nothing else
        raise _not_meshed(scene, str(error)) from None
    finally:
        gmsh.model.mesh.removeSizeCallback()


def _not_meshed(scene: Scene, reason: str) -> InputError:
    """The refusal of a box that gmsh makes no sound mesh of: of its smallest crack, or else of the
    size of elements."""
    sizes = {
        f"{name}.{key}": value
        for name, crack in scene.all_cracks.items()
        for key in ("depth", "length")
        if (value := getattr(crack, key)) is not None
    }
    key = min(sizes, key=lambda one: sizes[one], default="mesh.size")
    allowed = f"such that gmsh can mesh the solid ({reason}): not as small beside its other sizes"
    return InputError(key, sizes.get(key, scene.mesh.size), allowed)


def _ellipse(crack: Crack, width: float) -> tuple[float, float]:
    """Middle and half of the extent along x of the whole ellipse or rectangle of which a crack is
    a part."""
    first, last = crack.span(width)
    if crack.edge is None:
        return 0.5 * (first + last), 0.5 * (last - first)
    return (0.0 if crack.edge == "left" else width), last - first


def _face(crack: Crack, width: float, thickness: float) -> list[tuple[int, int]]:
    """A surface in a crack's plane whose part inside the box is the crack."""
    occ, middle, half = gmsh.model.occ, *_ellipse(crack, width)
    depth = crack.depth or 2.0 * thickness
    if crack.front == "elliptical":
        turned = depth > half
        face = [(2, occ.addDisk(0.0, 0.0, 0.0, max(half, depth), min(half, depth)))]
        if turned:
            occ.rotate(face, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.5 * math.pi)
    else:
        face = [(2, occ.addRectangle(-half, -depth, 0.0, 2.0 * half, 2.0 * depth))]
    occ.rotate(face, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi)
    occ.translate(face, middle, crack.given("height"), thickness)
    return face


@dataclass(frozen=True)
class _Grading:
    """Lengths of elements h = shortest + growth d around a crack, d from its front.

    Attributes
    ----------
    along, through, height : (n,), (n,), () [m]
        x, z and y of points on the front.
    shortest : float [m]
        Of an element at the front.
    growth : float
        With the distance.
    """

    along: np.ndarray
    through: np.ndarray
    height: float
    shortest: float
    growth: float

    def at(self, x: float, y: float, z: float) -> float:
        """At a place [m]."""
        squares = (self.along - x) ** 2 + (self.height - y) ** 2 + (self.through - z) ** 2
        return self.shortest + self.growth * math.sqrt(squares.min())

    def cells(self, size: float) -> float:
        """How many are around the front, in the tube in which they are shorter than a size: its
        length times int 2 pi d / h^3 dd."""
        ends = np.diff(self.along), np.diff(self.through)
        steps = np.hypot(*ends)
        length = steps[steps < 2.0 * np.median(steps)].sum()  # the sides of a rectangle are apart
        least = min(self.shortest, size)
        turns = 0.5 / least - 1.0 / size + 0.5 * least / size**2
        return PER_VOLUME * length * 2.0 * math.pi / self.growth**2 * turns


def _gradings(scene: Scene) -> list[_Grading]:
    """One for each crack."""
    width, _, thickness = scene.geometry.sides
    mesh, found = scene.mesh, []
    for crack in scene.all_cracks.values():
        count = mesh.given("lip_elements")
        middle, half = _ellipse(crack, width)
        reach = min(half, crack.depth or half)
        growth = mesh.grading ** (1.0 / max(count - 1, 1))
        shortest = reach / float((growth ** np.arange(count)).sum())
        front = _front(crack, middle, half, thickness)
        found.append(_Grading(*front, crack.given("height"), shortest, max(growth - 1.0, GROWTH)))
    return found


def _check_size(scene: Scene, gradings: list[_Grading]) -> None:
    """Raise InputError where gmsh would make too many cells, before it does."""
    size = scene.mesh.given("size")
    bulk = PER_VOLUME * math.prod(scene.geometry.sides) / size**3
    fronts = sum(one.cells(size) for one in gradings)
    key = "size" if bulk >= fronts else "lip_elements"
    check_cells(scene, key, bulk + fronts, scene.mesh.order**3 // 2)


def _front(
    crack: Crack, middle: float, half: float, thickness: float
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates x and z along the front of a crack, and of what goes on outside: (n,) each."""
    share = np.linspace(0.0, 1.0, FRONT)
    if crack.front == "elliptical":
        turn, depth = np.pi * share, crack.given("depth")
        x, z = middle + half * np.cos(turn), thickness - depth * np.sin(turn)
    else:
        depth = crack.depth or thickness
        ends = [middle + sign * half * np.ones(FRONT) for sign in (-1.0, 1.0)]
        x, z = np.concatenate(ends), np.tile(thickness - depth * share, 2)
        if crack.depth is not None:
            x = np.append(x, middle + half * (2.0 * share - 1.0))
            z = np.append(z, np.full(FRONT, thickness - depth))
    return x, z
