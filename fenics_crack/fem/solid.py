"""Solids with plane cracks, which are meshed here: boxes, sectors of disks, and parts of CAD files.

Their cracks are surfaces inside, whose nodes exist once: they are split like those of a mesh file
(:mod:`fenics_crack.fem.msh_file`). Elements are ``mesh.size`` long and, at a distance d from the
front of a crack,

    h(d) = h_0 + max(r - 1, 1/3) d,    r = grading^(1 / (lip_elements - 1)),

h_0 such that ``lip_elements`` elements in a row, each r times as long as the one before, reach from
the front to the mouth, or to the middle of an ellipse. :mod:`fenics_crack.fem.solid_mesher` does
it: a part, whose file may be a stranger's, in a process of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, reading
from fenics_crack.basics.gmsh_process import gmsh
from fenics_crack.basics.tables import quantity
from fenics_crack.basics.untrusted_files import beginning_of, run_reader
from fenics_crack.fem import compat, solid_mesher
from fenics_crack.fem.blocks import RIM_SIDES, Rim, check_cells, in_unit, not_meshed
from fenics_crack.fem.compat import ufl
from fenics_crack.fem.cracks import LIP_TAGS, Lips, Names
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.nodes import place_in_words
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Crack

MILLIMETRE = 1e-3
"""Unit of length in which parts are meshed [m]."""
BEGINNINGS = {".brep": b"DBRep_DrawableShape"}
"""Words near the beginning of a file; others are STEP's."""
SECONDS = 600
"""Processor time in which a part is meshed."""
MEMORY = 2**33
"""Address space for that [byte]."""
MOST_CELLS = 2e6
"""Cells of a part: gmsh makes some 1e4 in a second."""


def draw_solid(scene: Scene) -> tuple[Names, Lips]:
    """Fill the current gmsh model with the mesh of a scene's solid; its named surfaces, and its
    cracks in the order of the scene.

    Raises
    ------
    InputError
        The file of a part or a crack cannot be used, gmsh cannot mesh the solid, or a crack's
        surface cannot be split.
    """
    from fenics_crack.fem.msh_file import named_groups, put  # with what takes surfaces apart

    found, unit = _box(scene) if scene.geometry.file is None else _part(scene)
    gmsh.model.remove()
    gmsh.model.add("fenics_crack")
    try:
        names, lips = put((found["numbers"], unit * found["positions"], named_groups(found)), 3)
    except InputError as error:
        raise not_meshed(scene, f"{error.value}") from None
    places = np.array([lip.triangles.mean(axis=(0, 1)) for lip in lips])  # type: ignore[union-attr]
    middles = unit * found["middles"]
    order = [np.linalg.norm(places - middle, axis=1).argmin() for middle in middles]
    return names, tuple(lips[place] for place in order)  # type: ignore[return-value]


def faces_of(scene_file: str, unit: str | None) -> dict[str, np.ndarray]:
    """Triangles (n, 3, 3) [m] of the faces of a part, and the number of each one's face (n,).

    Raises
    ------
    InputError
        It is no file of one solid.
    """
    found = _read(scene_file, {"unit": unit or "mm"})
    return found | {"triangles": MILLIMETRE * found["triangles"]}


def described(structure: Structure) -> dict[str, str]:
    """Return where the named faces of a part are, and how long its fronts and the shortest
    ligaments ahead of them (collective)."""
    from fenics_crack.fem.fronts import find_fronts  # takes a while, with SciPy's splines

    assert structure.nodes is not None
    plate, comm, rows = structure.nodes.numbered.plate, structure.comm, {}  # type: ignore[union-attr]
    space = compat.function_space(plate.mesh, 1, vectors=False)
    for name in sorted(set(plate.groups) - {*LIP_TAGS}):
        weights = compat.assembled_vector(ufl.TestFunction(space) * plate.along(name))
        points = space.tabulate_dof_coordinates()[: len(weights)]
        area = comm.allreduce(weights.sum())
        middle = place_in_words(comm.allreduce(weights @ points) / area, ".4g")
        rows[f"face {name}"] = f"{1e6 * area:.4g} mm^2 around {middle} m"
    mesh = NodalMesh(structure)
    surface = mesh.points[mesh.boundary]
    for front in find_fronts(structure):
        length = np.linalg.norm(np.diff(front.nodes, axis=0), axis=1).sum()
        ahead = zip(front.nodes[1:-1], front.frame(front.at[1:-1])[0][:, 0], strict=True)
        ligament = min((ray_length(*ray, surface) for ray in ahead), default=np.nan)
        words = f"{quantity(float(length), 'm')} long, {quantity(ligament, 'm')} from the surface"
        rows[front.name] = f"{words} straight ahead at least"
    return rows


def ray_length(point: np.ndarray, direction: np.ndarray, triangles: np.ndarray) -> float:
    """Return the distance from a point to the first of triangles (n, 3, 3) along a direction of
    length 1; their whole extent where there is none."""
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    across = np.cross(direction, two)
    scale = (one * across).sum(axis=1)
    scale = np.where(np.abs(scale) < 1e-300, np.inf, scale)
    to = point - triangles[:, 0]
    u, turned = (to * across).sum(axis=1) / scale, np.cross(to, one)
    v, away = turned @ direction / scale, (two * turned).sum(axis=1) / scale
    extent = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    hits = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (away > 1e-6 * extent)
    return float(away[hits].min(initial=extent))


def _part(scene: Scene) -> tuple[dict[str, np.ndarray], float]:
    """The mesh of a part and its unit [m]; raises InputError."""
    unit_scene, unit = in_unit(scene, MILLIMETRE)
    geometry, mesh = scene.geometry, unit_scene.mesh
    points = [(face.key, point) for face in geometry.faces for point in face.values]
    asked = {
        "unit": geometry.unit or "mm", "size": mesh.size, "per_turn": mesh.per_turn,
        "faces": [(name, np.divide(point, unit).tolist()) for name, point in points],
        "cracks": _cracks(unit_scene), "cells": MOST_CELLS,
    }  # fmt: skip
    return _read(str(geometry.file), asked, scene), unit


def _read(path: str, asked: dict[str, Any], scene: Scene | None = None) -> dict[str, np.ndarray]:
    """What the mesher makes of a file in a process of its own."""
    with reading("geometry.file", path, "a part that gmsh reads and meshes"):
        start = BEGINNINGS.get(Path(path).suffix.lower(), b"ISO-10303-21")
        if start not in beginning_of(path, 4096):
            raise ValueError("it does not begin as such a file")
        found = run_reader(Path(solid_mesher.__file__), Path(path), SECONDS, MEMORY, asked)
        if isinstance(found, str):
            raise ValueError(found)
    if "refused" in found:
        key, allowed = map(str, found["refused"])
        raise InputError(key, path if scene is None else _value(scene, key), allowed)
    return found


def _value(scene: Scene, key: str) -> object:
    """The value of a key; of the faces of a part their names."""
    table, _, name = key.rpartition(".")
    value = getattr(scene.all_cracks.get(table) or getattr(scene, table), name)
    return [face.key for face in value] if name == "faces" else value


def _cracks(scene: Scene) -> list[dict[str, Any]]:
    """The cracks of a solid as :func:`fenics_crack.fem.solid_mesher.insert` takes them."""
    found = []
    for key, crack in scene.all_cracks.items():
        if crack.point is None:
            made = _of_box(crack, scene.geometry.sides)
        else:
            round_axes = crack.half_axes if crack.front != "through" else None
            shift = (crack.length or 0.0) * crack.frame[0] * (round_axes is None)
            made = {
                "middle": (crack.point + shift).tolist(), "frame": crack.frame.tolist(),
                "half": round_axes, "is_round": round_axes is not None,
                "reach": round_axes and min(round_axes),
            }  # fmt: skip
        elements, grading = scene.mesh.given("lip_elements"), scene.mesh.grading
        found.append({"key": key, **made, "elements": elements, "grading": grading})
    return found


def _of_box(crack: Crack, sides: Sequence[float]) -> dict[str, Any]:
    """The crack of a box in a plane y = height: its ellipse or rectangle, by the face z =
    thickness."""
    width, _, thickness = sides
    first, last = crack.span(width)
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    if crack.edge is not None:
        middle, half = (0.0 if crack.edge == "left" else width), last - first
    depth = crack.depth or 2.0 * thickness
    return {
        "middle": [middle, crack.given("height"), thickness], "half": [half, depth],
        "frame": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        "is_round": crack.front == "elliptical", "reach": min(half, crack.depth or half),
    }  # fmt: skip


def _box(scene: Scene) -> tuple[dict[str, np.ndarray], float]:
    """The mesh of a box, or of a sector of a disk, in a unit of its size, and that [m]."""
    unit_scene, unit = in_unit(scene)
    width, height, thickness = size = unit_scene.geometry.sides
    occ, rim = gmsh.model.occ, None if scene.disk is None else Rim(unit_scene)
    solid = [(3, occ.addBox(0.0, 0.0, 0.0, *size))] if rim is None else rim.with_box(*size)
    occ.synchronize()
    triangles = np.zeros((0, 3, 3))
    if any(crack.point is not None for crack in scene.all_cracks.values()):
        triangles, _ = solid_mesher.coarse()
    try:
        surfaces, fronts = solid_mesher.insert(solid, _cracks(unit_scene), triangles)
    except solid_mesher.Refusal as refusal:
        key, allowed = refusal.args
        if (value := _value(scene, key)) is None:
            raise not_meshed(scene, allowed) from None
        raise InputError(key, value, allowed) from None
    _check_size(scene, unit, fronts)
    sides = [
        ("left", 0, 0.0), ("right", 0, width), ("clamp", 1, 0.0), ("top", 1, height),
        ("back", 2, 0.0), ("front", 2, thickness),
    ]  # fmt: skip
    groups: dict[str, list[int]] = {"clamp": []}
    for _, tag in gmsh.model.getEntities(2):
        middle = occ.getCenterOfMass(2, tag)
        if rim is not None and middle[1] < 0.0:
            name = rim.name_of(middle)
        else:
            name = min(sides, key=lambda side: abs(middle[side[1]] - side[2]))[0]
        if tag not in surfaces:
            groups.setdefault(name, []).append(tag)
    if rim is not None:
        rim.match(2, *(groups[name] for name in RIM_SIDES))
    try:
        solid_mesher.generate(unit_scene.mesh.given("size"), fronts)
    except Exception as error:  # gmsh raises nothing else
        raise not_meshed(scene, str(error)) from None
    return solid_mesher.collected(surfaces, groups), unit


def _check_size(scene: Scene, unit: float, fronts: list[dict[str, Any]]) -> None:
    """Raise InputError where gmsh would make too many cells, before it does."""
    bulk, around = solid_mesher.n_cells(scene.mesh.given("size") / unit, fronts)
    key, shortest = "size", ""
    if around > bulk:
        least = unit * min(front["shortest"] for front in fronts)
        key, shortest = "lip_elements", f", at a crack's front {least:.2g} m long"
    check_cells(scene, key, bulk + around, scene.mesh.order**3 // 2, shortest)
