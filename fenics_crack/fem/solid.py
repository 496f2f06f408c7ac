"""Boxes with cracks, meshed by gmsh.

The cracks are surfaces inside, whose nodes exist once: they are split like those of a mesh file
(:mod:`fenics_crack.fem.msh_file`).

The elements of a box are ``mesh.size`` long and, at a distance d from the front of a crack,

    h(d) = h_0 + max(r - 1, 1/3) d,    r = grading^(1 / (lip_elements - 1)),

h_0 such that ``lip_elements`` elements in a row, each r times as long as the one before, reach from
the front to the mouth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.fem.blocks import GROWTH, check_cells
from fenics_crack.fem.crack_surface import Lips
from fenics_crack.fem.msh_file import Names, named_groups, put
from fenics_crack.fem.msh_reader import groups
from fenics_crack.mesher import gmsh
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Crack

__all__ = ["draw_box"]

FRONT = 60
"""Points on each front from which distances are measured while meshing."""
PER_VOLUME = 5.0
"""Tetrahedra that gmsh makes of a volume h^3 where they are to be h long, of a fine mesh."""


def draw_box(scene: Scene) -> tuple[Names, Lips]:
    """Fill the current gmsh model with the mesh of a scene's box; its named surfaces, and its
    cracks.

    Raises
    ------
    InputError
        gmsh cannot mesh it, or a crack's surface cannot be split.
    """
    _draw(scene)
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    named = named_groups(groups())
    gmsh.model.remove()
    gmsh.model.add("fenics_crack")
    try:
        return put((numbers, positions.reshape(-1, 3), named), 3)
    except InputError as error:
        raise _not_meshed(scene, f"{error.value}") from None


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
