"""Mesher of solids with plane cracks by gmsh: of a part from a CAD file in a program of its own
(:mod:`fenics_crack.basics.untrusted_files`), of a box in this one.

A crack is what is inside the solid of an ellipse or a rectangle with the half axes a and b in its
own frame, rows e_1, e_2 and the normal. Elements are ``size`` long and, at a distance d from the
front of a crack, ``shortest`` + ``growth`` d. The file of a part is uncracked: the cracks are cut
into its volume, and its outer faces are found again by the triangles of a coarse mesh made before.

Nodes in the middle of curved edges go back to the straight middle near the fronts, where stress
intensities are integrals over straight cells, and where cells would fold at small faces.
"""

import ctypes
import math
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import gmsh
import numpy as np

Tags = list[tuple[int, int]]
Crack = dict[str, Any]
Front = dict[str, Any]
"""As :func:`insert` has them."""

UNIT_LENGTHS = {"m": 1e3, "mm": 1.0, "inch": 25.4}
"""Units of a file without one [mm]."""
CELLS_PER_VOLUME = 5.0
"""Tetrahedra that gmsh makes of a volume h^3 where they are to be h long, of a fine mesh."""
COARSE_TRIANGLES = 25.0
"""Triangles of the coarse mesh along the diagonal of a part."""
STRAIGHT_RADIUS_RATIO = 2.5
"""Distance from a front up to which cells are straight, in elements there."""
MIN_DETERMINANT_RATIO = 0.2
"""Smallest over largest Jacobian determinant below which a curved cell becomes straight."""
MIN_SIZE_RATIO = 0.1
"""Least length of elements by curvature over the size."""
NEAR_RATIO = 0.1
"""Ligament at a front over its elements, and distance of a face's point over the part's size."""
N_CURVE_SAMPLES = 40
"""Points of a curve from which its distances are measured, and triangles that name a face."""


class Refusal(Exception):
    """A key of a scene that cannot be used, and what is allowed."""


def read(path: str, _most: int, given: dict[str, Any]) -> dict[str, Any]:
    """Return the mesh of a part as msh_reader.py does, or its faces where none is asked for.

    ``given`` has lengths in mm, in which a part is meshed: faces, a list of [name, point]; cracks,
    as :func:`insert` takes them; size, unit, per_turn, cells.
    """
    with suppress(AttributeError, ValueError):  # as in basics/gmsh_process.py, for FLTK
        ctypes.c_ubyte.in_dll(gmsh.lib, "_ZN2Fl13options_read_E").value = 1
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask
    try:
        return _meshed(path, given)
    except Refusal as refusal:
        return {"refused": np.array(refusal.args)}


def _meshed(path: str, given: dict[str, Any]) -> dict[str, Any]:
    solid = _imported(path, given["unit"])
    triangles, owners = mesh_faces()
    if "size" not in given:
        return {"triangles": triangles, "owners": owners}
    named = _named(given["faces"], triangles, owners)
    surfaces, fronts = insert_cracks(solid, given["cracks"], triangles)
    size = given["size"]
    bulk, around = estimate_cells(size, fronts)
    if bulk + around > given["cells"]:
        allowed = f"so that there are at most {given['cells']:.0e} cells: about"
        key = "mesh.size" if bulk > around else "mesh.lip_elements"
        raise Refusal(key, f"{allowed} {bulk + around:.2g} would be")
    try:
        generate_mesh(size, fronts, given["per_turn"])
        gmsh.model.mesh.setOrder(2)
    except Exception as error:
        allowed = f"such that gmsh can mesh the part ({error})"
        raise Refusal("mesh.size", allowed) from None
    sides = _sides(surfaces, triangles, owners)
    groups = {name: [s for s, owner in sides.items() if owner in tags] for name, tags in named}
    found = collect_mesh(surfaces, groups)
    found["positions"], found["straight"] = straighten_edges(found, fronts)
    return found


# --- the part -------------------------------------------------------------------------------------


def _imported(path: str, unit: str) -> Tags:
    """The one solid of a file; raises Refusal."""
    gmsh.model.add("part")
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    try:
        solid = gmsh.model.occ.importShapes(path, highestDimOnly=True)
    except Exception as error:
        raise Refusal("geometry.file", f"readable by gmsh ({error})") from None
    if len(solid) != 1 or solid[0][0] != 3:
        count = sum(dimension == 3 for dimension, _ in solid)
        raise Refusal("geometry.file", f"a file with one solid: it has {count or 'none'}")
    if (factor := UNIT_LENGTHS[unit]) != 1.0:
        gmsh.model.occ.dilate(solid, 0.0, 0.0, 0.0, factor, factor, factor)
    gmsh.model.occ.synchronize()
    return solid


def mesh_faces() -> tuple[np.ndarray, np.ndarray]:
    """Triangles (n, 3, 3) of a coarse mesh of the part's faces, and the faces (n,)."""
    low_high = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
    largest = float(np.linalg.norm(np.ptp(low_high, axis=0))) / COARSE_TRIANGLES
    _set_sizes(Max=largest, FromCurvature=16, Min=0.05 * largest)
    try:
        gmsh.model.mesh.generate(2)
    except Exception as error:
        raise Refusal("geometry.file", f"a part whose faces gmsh can mesh ({error})") from None
    triangles, owners = [], []
    for _, tag in gmsh.model.getEntities(2):
        own = _triangles(tag)
        triangles.append(own)
        owners += [tag] * len(own)
    gmsh.model.mesh.clear()
    return np.concatenate(triangles), np.array(owners)


def _triangles(tag: int) -> np.ndarray:
    """Corners of the triangles of a face, of any order: (n, 3, 3)."""
    kinds, _, nodes = gmsh.model.mesh.getElements(2, tag)
    if not kinds:
        return np.zeros((0, 3, 3))
    width = gmsh.model.mesh.getElementProperties(kinds[0])[3]
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(numbers)
    corners = nodes[0].reshape(-1, width)[:, :3]
    places = order[np.searchsorted(numbers, corners, sorter=order)]
    return positions.reshape(-1, 3)[places]


def distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distances of points (n, 3) from triangles (m, 3, 3): (n, m)."""
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    to = points[:, None] - triangles[:, 0]
    a, b, c = (one**2).sum(1), (one * two).sum(1), (two**2).sum(1)
    d, e, area = (to * one).sum(2), (to * two).sum(2), np.maximum(a * c - b**2, 1e-300)
    u, v = (c * d - b * e) / area, (a * e - b * d) / area
    found = np.linalg.norm(to - u[..., None] * one - v[..., None] * two, axis=2)
    found[(u < 0.0) | (v < 0.0) | (u + v > 1.0)] = np.inf
    for first, second in ((0, 1), (1, 2), (2, 0)):
        span = triangles[:, second] - triangles[:, first]
        to = points[:, None] - triangles[:, first]
        share = np.clip((to * span).sum(2) / np.maximum((span**2).sum(1), 1e-300), 0.0, 1.0)
        found = np.minimum(found, np.linalg.norm(to - share[..., None] * span, axis=2))
    return found


def _named(
    faces: Iterable[tuple[str, list[float]]], triangles: np.ndarray, owners: np.ndarray
) -> Iterable[tuple[str, set[int]]]:
    """Names, and the faces of each: those nearest to its points."""
    size = np.ptp(triangles.reshape(-1, 3), axis=0).max()
    found: dict[str, set[int]] = {}
    for name, point in faces:
        away = distances(np.array([point]), triangles)[0]
        if away.min() > NEAR_RATIO * size:
            raise Refusal("geometry.faces", f"points on faces: one of {name} is"
                          f" {away.min():.3g} mm away from the nearest one")  # fmt: skip
        found.setdefault(name, set()).add(owners[away.argmin()])
    return found.items()


def _sides(surfaces: list[int], triangles: np.ndarray, owners: np.ndarray) -> dict[int, int]:
    """The face of the uncracked part of each surface of the mesh but the cracks."""
    found = {}
    for _, tag in gmsh.model.getEntities(2):
        if tag not in surfaces:
            middles = _triangles(tag).mean(axis=1)
            some = middles[:: max(1, len(middles) // N_CURVE_SAMPLES)]
            nearest = owners[distances(some, triangles).argmin(axis=1)]
            found[tag] = np.bincount(nearest).argmax() if len(nearest) else 0
    return found


# --- cracks ---------------------------------------------------------------------------------------


def insert_cracks(
    solid: Tags, cracks: list[Crack], triangles: np.ndarray
) -> tuple[list[int], list[Front]]:
    """Cut cracks into a solid: the surface of each, and its front. Triangles (n, 3, 3) are those of
    the solid's faces; none where the scene has checked the places.

    A crack has a key of the scene, middle (3,), frame (3, 3), half (2,), None of a half-plane that
    ends at its middle; is_round; reach, its extent behind the front, or None; elements and grading
    along it. A front has curves, points (n, 3) on them, ends (m, 3), shortest and growth.
    """
    occ, faces = gmsh.model.occ, []
    for crack in cracks:
        if crack["half"] is None:
            crack["half"] = [2.0 * np.ptp(triangles.reshape(-1, 3), axis=0).max()] * 2
        parts = occ.intersect(_face(crack), solid, removeObject=True, removeTool=False)[0]
        parts = [part for part in parts if part[0] == 2]
        if len(parts) != 1:
            words = "misses the part" if not parts else f"is in {len(parts)} pieces"
            raise Refusal(f"{crack['key']}.point", f"such that the crack is one surface inside the"
                          f" part: it {words}")  # fmt: skip
        faces += parts
    made, children = occ.fragment(solid, faces) if faces else (solid, [solid])
    occ.synchronize()
    if sum(dimension == 3 for dimension, _ in made) != 1:
        raise Refusal(f"{cracks[-1]['key']}.point", "such that the crack does not cut the part in"
                      " two, and crosses no other crack")  # fmt: skip
    rims = [
        {tag for _, tag in gmsh.model.getBoundary(own, combined=False, oriented=False)}
        for own in children[1:]
    ]
    fronts = [_front(crack, rim) for crack, rim in zip(cracks, rims, strict=True)]
    each = [*zip(cracks, children[1:], rims, fronts, strict=True)]
    for number, (crack, own, rim, front) in reversed([*enumerate(each)]):
        if len(own) != 1 or any(rim & other for other in rims[:number]):
            allowed = "such that the crack crosses and touches no other one"
            raise Refusal(f"{crack['key']}.point", allowed)
        if len(triangles):
            _check_place(crack, own[0][1], front, triangles)
    return [own[0][1] for own in children[1:]], fronts


def _face(crack: Crack) -> Tags:
    """The ellipse or the rectangle of which a crack is a part."""
    occ, (e_1, e_2, normal), (a, b) = gmsh.model.occ, np.array(crack["frame"]), crack["half"]
    if crack["is_round"] and a < b:
        a, b, e_1 = b, a, e_2
    face = [(2, occ.addDisk(0.0, 0.0, 0.0, a, b) if crack["is_round"]
             else occ.addRectangle(-a, -b, 0.0, 2.0 * a, 2.0 * b))]  # fmt: skip
    e_2 = np.cross(normal, e_1)
    level = math.hypot(normal[0], normal[1]) < 1e-12
    turns = (
        math.atan2(e_1[1], e_1[0] * normal[2]) if level else math.atan2(e_2[2], -e_1[2]),
        math.acos(np.clip(normal[2], -1.0, 1.0)),
        0.0 if level else math.atan2(normal[1], normal[0]),
    )
    for axis, turn in zip(((0, 0, 1), (0, 1, 0), (0, 0, 1)), turns, strict=True):
        occ.rotate(face, 0.0, 0.0, 0.0, *axis, turn)
    occ.translate(face, *(crack["middle"] - (crack["reach"] is None) * a * np.array(e_1)))
    return face


def _points(curve: int) -> np.ndarray:
    """Points (n, 3) on a curve, its ends among them."""
    (low,), (high,) = gmsh.model.getParametrizationBounds(1, curve)
    at = np.linspace(low, high, N_CURVE_SAMPLES + 1)
    return np.reshape(gmsh.model.getValue(1, curve, at), (-1, 3))


def _front(crack: Crack, rim: set[int]) -> Front:
    """The front of a crack: of the curves around it those of the ellipse or the rectangle."""
    half, frame, through = crack["half"], np.array(crack["frame"]), crack["reach"] is None
    curves, points, reach = [], [np.zeros((0, 3))], 0.0
    for curve in rim:
        at = _points(curve)
        x, y, _ = ((at - crack["middle"]) @ frame.T).T
        if through:
            level, reach = 1.0 + x / half[0], max(reach, -float(x.min()))
        elif crack["is_round"]:
            level = np.hypot(x / half[0], y / half[1])
        else:
            level = np.maximum(np.abs(x) / half[0], np.abs(y) / half[1])
        if np.abs(level - 1.0).max() < 1e-5:
            curves.append(curve)
            points.append(at)
    reach = reach if through else crack["reach"]
    ratio = crack["grading"] ** (1.0 / max(crack["elements"] - 1, 1))
    ends = np.array([own[k] for own in points[1:] for k in (0, -1)]).reshape(-1, 3)
    near = np.linalg.norm(ends[:, None] - ends, axis=2) < 1e-5 * reach
    return {
        "curves": curves, "points": np.concatenate(points), "ends": ends[near.sum(axis=1) == 1],
        "shortest": float(reach / (ratio ** np.arange(crack["elements"])).sum()),
        "growth": max(ratio - 1.0, 1.0 / 3.0),
        "length": sum(np.linalg.norm(np.diff(own, axis=0), axis=1).sum() for own in points),
    }  # fmt: skip


def _check_place(crack: Crack, surface: int, front: Front, triangles: np.ndarray) -> None:
    """Raise Refusal for a crack in a face, without a front, or with next to no ligament."""
    key, shortest = f"{crack['key']}.point", front["shortest"]
    middle = np.array([gmsh.model.occ.getCenterOfMass(2, surface)])
    if not front["curves"] or distances(middle, triangles).min() < NEAR_RATIO * shortest:
        words = "lies in a face of it" if front["curves"] else "has no front in it"
        raise Refusal(key, f"such that the crack is inside the part: it {words}")
    points, ends = front["points"], front["ends"]
    away = np.linalg.norm(points[:, None] - ends, axis=2).min(axis=1, initial=np.inf)
    inside = points[away > 2.0 * shortest]
    ligament = distances(inside, triangles).min(initial=np.inf)
    if ligament < NEAR_RATIO * shortest:
        raise Refusal(key, "farther from the surface: of its front some is"
                      f" {ligament / shortest:.2g} of an element away")  # fmt: skip


def estimate_cells(size: float, fronts: list[Front]) -> tuple[float, float]:
    """Cells of the current model away from fronts, and in the tubes around them in which they are
    shorter than the size: the lengths times int 2 pi d / h^3 dd."""
    bulk = sum(gmsh.model.occ.getMass(3, tag) for _, tag in gmsh.model.getEntities(3)) / size**3
    around = 0.0
    for front in fronts:
        least = min(front["shortest"], size)
        turns = 0.5 / least - 1.0 / size + 0.5 * least / size**2
        around += front["length"] * 2.0 * math.pi / front["growth"] ** 2 * turns
    return CELLS_PER_VOLUME * bulk, CELLS_PER_VOLUME * around


# --- the mesh -------------------------------------------------------------------------------------


def generate_mesh(size: float, fronts: list[Front], per_turn: int = 0) -> None:
    """Mesh the current model, with so many elements on a full turn of a curved face."""
    fields = gmsh.model.mesh.field
    every = []
    for front in fronts:
        if front["curves"]:
            away, graded = fields.add("Distance"), fields.add("Threshold")
            fields.setNumbers(away, "CurvesList", front["curves"])
            count = min(
                2000, max(N_CURVE_SAMPLES, math.ceil(2.0 * front["length"] / front["shortest"]))
            )
            for name in ("NumPointsPerCurve", "Sampling"):  # until 4.8, and since
                with suppress(Exception):
                    fields.setNumber(away, name, count)
            shortest = min(front["shortest"], size)
            reach = max((size - shortest) / front["growth"], 1e-9 * size)
            values = {"InField": away, "SizeMin": shortest, "SizeMax": size, "DistMax": reach}
            for name, value in values.items():
                fields.setNumber(graded, name, value)
            fields.setNumber(graded, "DistMin", 0.0)
            every.append(graded)
    if every:
        least = fields.add("Min")
        fields.setNumbers(least, "FieldsList", every)
        fields.setAsBackgroundMesh(least)
    # Small faces of a part are not resolved: else some meshes would not end.
    smallest = min([MIN_SIZE_RATIO * size, *(front["shortest"] for front in fronts)])
    _set_sizes(FromPoints=0, ExtendFromBoundary=0, FromCurvature=per_turn, Max=size, Min=smallest)
    try:
        gmsh.model.mesh.generate(3)
    finally:
        _set_sizes(FromCurvature=0, Max=1e22, Min=0)  # for what is meshed next


def _set_sizes(**values: float) -> None:
    """Set gmsh's options of the sizes of elements."""
    for name, value in values.items():
        gmsh.option.setNumber(f"Mesh.MeshSize{name}", value)


def collect_mesh(surfaces: list[int], sides: dict[str, list[int]]) -> dict[str, Any]:
    """The mesh as msh_reader.py has it, of the surfaces of cracks and the entities of named faces;
    and the middles of the cracks, (n, 3)."""
    numbers, positions, _ = gmsh.model.mesh.getNodes()
    heads, names, nodes = [], [], []
    groups = [(3, "solid", [tag for _, tag in gmsh.model.getEntities(3)])]
    groups += [(2, name, entities) for name, entities in sides.items()]
    groups += [(2, f"crack {number}", [tag]) for number, tag in enumerate(surfaces, 1)]
    for tag, (dimension, name, entities) in enumerate(groups, 1):
        for entity in entities:
            kinds, _, own = gmsh.model.mesh.getElements(dimension, entity)
            heads += [(dimension, tag, k, len(o)) for k, o in zip(kinds, own, strict=True)]
            names += [name] * len(kinds)
            nodes += own
    return {
        "numbers": numbers, "positions": positions.reshape(-1, 3),
        "heads": np.array(heads, dtype=np.int64).reshape(-1, 4),
        "names": np.array(names, dtype=str), "nodes": np.concatenate(nodes),
        "middles": np.reshape([gmsh.model.occ.getCenterOfMass(2, s) for s in surfaces], (-1, 3)),
    }  # fmt: skip


EDGES = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)])
"""Edges of a tetrahedron in whose middle its nodes 4 to 9 are, in gmsh's order."""


def straighten_edges(found: dict[str, Any], fronts: list[Front]) -> tuple[np.ndarray, int]:
    """Return positions with straight edges in cells at fronts and where cells would fold, and the
    number of cells that change."""
    positions, numbers = found["positions"].copy(), found["numbers"]
    order = np.argsort(numbers)
    first = found["nodes"][: found["heads"][found["heads"][:, 0] == 3, 3].sum()]
    cells = order[np.searchsorted(numbers, first, sorter=order)].reshape(-1, 10)
    kind = gmsh.model.mesh.getElementType("tetrahedron", 2)
    local = gmsh.model.mesh.getElementProperties(kind)[4]
    slopes = np.reshape(gmsh.model.mesh.getBasisFunctions(kind, local, "GradLagrange")[1],
                        (10, 10, 3))  # fmt: skip

    def folded() -> np.ndarray:
        determinants = np.linalg.det(np.einsum("cnx,pnr->cpxr", positions[cells], slopes))
        return np.asarray(
            determinants.min(axis=1) < MIN_DETERMINANT_RATIO * determinants.max(axis=1)
        )

    wanted, straight = folded(), np.zeros(len(cells), dtype=bool)
    for front in fronts:
        steps = front["points"]
        for point in steps:
            near = np.linalg.norm(positions[cells[:, :4]] - point, axis=2).min(axis=1)
            wanted |= (
                near < STRAIGHT_RADIUS_RATIO * front["shortest"] + front["length"] / N_CURVE_SAMPLES
            )
    middles = positions[cells[:, EDGES]].mean(axis=2)
    bent = np.abs(positions[cells[:, 4:]] - middles).max(axis=(1, 2)) > 1e-9 * np.ptp(positions)
    while np.any(wanted & ~straight):
        straight |= wanted
        positions[cells[wanted, 4:]] = positions[cells[wanted][:, EDGES]].mean(axis=2)
        wanted = folded()
    return positions, int((straight & bent).sum())
