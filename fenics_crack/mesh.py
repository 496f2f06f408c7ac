"""Meshes of cracked plates, made or read by gmsh and distributed by DOLFINx.

The crack is a slit: its two lips are different curves in the same place that share only the tip,
so that every node on a lip but the tip exists twice. The plate is cut into four blocks at the tip,

    mouth side  +-----------+---------------+
                |           |               |      upper blocks
                +===upper===+---ligament----+
                +===lower===+---------------+
                |           tip             |      lower blocks
                +-----------+---------------+
                    clamped (y = 0)

which gives the lips identical nodes, lets quadrilaterals be graded towards the tip block by block
and makes the uniform grid of the paper a special case. gmsh runs on rank 0 only.
"""

from __future__ import annotations

import faulthandler
import math
import os
import pickle
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
from mpi4py import MPI

from fenics_crack import compat
from fenics_crack.errors import InputError
from fenics_crack.parallel import on_root
from fenics_crack.scene import Scene

__all__ = ["PlateMesh", "build_mesh", "write_msh"]

MOST_CELLS = 5_000_000
"""Of a plate; a mesh file may have any number."""
SMALLEST_CELL = 1e-7
"""Relative to the plate; gmsh and the elements' matrices need it."""
FARTHEST = 1e6
"""A node of a mesh file [m]."""
LONGEST_READING = 300
"""Of a mesh file by gmsh [s]."""
_POINT, _TRIANGLES = 15, (2, 9, 21)
_EDGES = {2: 1, 3: 1, 9: 8, 10: 8, 21: 26, 36: 26}
"""gmsh's kinds of cells that DOLFINx reads, and of their edges, order by order; and of points."""
_GROUPS = {"plate": 1, "clamp": 2, "lower_lip": 3, "upper_lip": 4, "load": 5}


@dataclass(frozen=True)
class PlateMesh:
    """A distributed mesh and where its named parts are.

    Attributes
    ----------
    mesh : dolfinx.mesh.Mesh
        The plate.
    facet_tags : dolfinx.mesh.MeshTags
        Tags of the facets in the groups below.
    groups : dict of str to int
        Facet tag of ``clamp``, ``lower_lip`` and ``upper_lip``; the lips only where there is a
        crack.
    load_point : tuple of float or None
        Position of the physical point ``load`` [m].
    """

    mesh: Any
    facet_tags: Any
    groups: dict[str, int]
    load_point: tuple[float, float] | None

    @property
    def cracked(self) -> bool:
        """Whether there are two lips."""
        return "lower_lip" in self.groups


def build_mesh(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> PlateMesh:
    """Mesh the scene's plate, or read its mesh file (collective).

    Raises
    ------
    InputError
        The mesh file cannot be read, is not a plane mesh of one kind of cells, or lacks a group.
    """
    with _gmsh_on_root(comm):
        groups, load_point = on_root(comm, lambda: _model(scene))
        mesh, _, facet_tags = compat.model_to_mesh(gmsh.model, comm)
    return PlateMesh(mesh, facet_tags, groups, load_point)


def write_msh(scene: Scene, path: str | Path) -> None:
    """Write the scene's mesh, with its named groups, to a gmsh file (format 4.1)."""
    with _gmsh_on_root(MPI.COMM_SELF):
        _model(scene)
        gmsh.write(str(path))


@contextmanager
def _gmsh_on_root(comm: MPI.Comm) -> Iterator[None]:
    if comm.rank != 0:
        yield
        return
    started = not compat.gmsh_is_running()
    if started:
        gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask, nobody may be there
    gmsh.model.add("fenics_crack")
    try:
        yield
    finally:
        gmsh.model.remove()
        if started:
            gmsh.finalize()


def _model(scene: Scene) -> tuple[dict[str, int], tuple[float, float] | None]:
    """Fill the current gmsh model with a mesh; return its facet groups and the load point."""
    if scene.mesh.layout == "file":
        _read(Path(str(scene.mesh.file)))
    else:
        _draw(scene)
        gmsh.model.mesh.generate(2)
    gmsh.model.mesh.renumberNodes()
    return _named_groups(str(scene.mesh.file))


# --- the plate ------------------------------------------------------------------------------------


def _draw(scene: Scene) -> None:
    """Draw the plate and say how each curve and surface is to be divided."""
    width, height = scene.geometry.width, scene.geometry.height
    assert width is not None and height is not None
    crack = scene.crack
    if crack is None:
        columns = [(0.0, width, *_division(scene, width, scene.mesh.columns))]
        rows = [(0.0, height, *_division(scene, height, scene.mesh.rows))]
    else:
        columns, rows = _crack_divisions(scene)
    cells = math.prod(sum(interval[2] for interval in side) for side in (columns, rows))
    if cells > MOST_CELLS:
        key = "columns" if scene.mesh.layout == "grid" else "size"
        allowed = f"so that there are fewer cells: {cells:.2g} are more than {MOST_CELLS:.0e}"
        raise InputError(f"mesh.{key}", getattr(scene.mesh, key), allowed)
    mirrored = crack is not None and crack.edge == "right"

    def position(x: float, y: float) -> tuple[float, float]:
        return (width - x, y) if mirrored else (x, y)

    xs = [columns[0][0], *(column[1] for column in columns)]
    ys = [rows[0][0], *(row[1] for row in rows)]
    add_point = gmsh.model.geo.addPoint
    points = {
        (i, j): add_point(*position(x, y), 0.0) for i, x in enumerate(xs) for j, y in enumerate(ys)
    }
    mouth_above = None if crack is None else add_point(*position(xs[0], ys[1]), 0.0)

    horizontal, vertical = {}, {}
    for i, (_, _, count, progression) in enumerate(columns):
        for j in range(len(ys)):
            horizontal[i, j] = _curve(points[i, j], points[i + 1, j], count, progression)
    for j, (_, _, count, progression) in enumerate(rows):
        for i in range(len(xs)):
            start = mouth_above if (i, j) == (0, 1) and mouth_above else points[i, j]
            vertical[i, j] = _curve(start, points[i, j + 1], count, progression)
    upper_lip = None
    if mouth_above is not None:
        upper_lip = _curve(mouth_above, points[1, 1], *columns[0][2:])

    surfaces = []
    for i in range(len(columns)):
        for j in range(len(rows)):
            below = upper_lip if (i, j) == (0, 1) and upper_lip else horizontal[i, j]
            loop = [below, vertical[i + 1, j], -horizontal[i, j + 1], -vertical[i, j]]
            surfaces.append(gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(loop)]))
    if scene.mesh.layout == "grid" or scene.mesh.cells == "quadrilateral":
        for surface in surfaces:
            gmsh.model.geo.mesh.setTransfiniteSurface(surface)
            if scene.mesh.cells == "quadrilateral":
                gmsh.model.geo.mesh.setRecombine(2, surface)
    else:
        gmsh.option.setNumber("Mesh.Algorithm", 6)  # frontal Delaunay
    gmsh.model.geo.synchronize()

    groups: dict[str, tuple[int, list[int]]] = {
        "plate": (2, surfaces),
        "clamp": (1, [horizontal[i, 0] for i in range(len(columns))]),
    }
    if upper_lip is not None:
        groups |= {"lower_lip": (1, [horizontal[0, 1]]), "upper_lip": (1, [upper_lip])}
    at_load = [
        tag
        for (i, j), tag in points.items()
        if position(xs[i], ys[j]) == scene.excitation.point and not (upper_lip and (i, j) == (0, 1))
    ]
    if at_load:
        groups["load"] = (0, at_load)
    for name, (dimension, tags) in groups.items():
        gmsh.model.addPhysicalGroup(dimension, tags, _GROUPS[name])
        gmsh.model.setPhysicalName(dimension, _GROUPS[name], name)


Division = tuple[int, float]  # number of elements, ratio of the lengths of neighbours
Interval = tuple[float, float, int, float]  # from, to, and its division


def _division(scene: Scene, length: float, cells: int | None) -> Division:
    """Equal elements: as many as the grid has, or as the size asks for."""
    if cells is not None:
        return cells, 1.0
    assert scene.mesh.size is not None
    return max(1, round(length / scene.mesh.size)), 1.0


def _crack_divisions(scene: Scene) -> tuple[list[Interval], list[Interval]]:
    """Divide the plate left and right of the tip, below and above the crack."""
    mesh, crack = scene.mesh, scene.crack
    width, height = scene.geometry.width, scene.geometry.height
    assert crack and crack.length and crack.height and width and height
    length, level = crack.length, crack.height
    if mesh.layout == "grid":
        assert mesh.columns and mesh.rows
        cut = round(length / width * mesh.columns), round(level / height * mesh.rows)
        lip, ligament = (cut[0], 1.0), (mesh.columns - cut[0], 1.0)
        below, above = (cut[1], 1.0), (mesh.rows - cut[1], 1.0)
    else:
        assert mesh.size and mesh.lip_elements
        ratio = mesh.grading ** (-1.0 / max(mesh.lip_elements - 1, 1))
        shares = ratio ** np.arange(mesh.lip_elements)
        tip_size = length * shares[-1] / shares.sum()
        if tip_size < SMALLEST_CELL * max(width, height):
            allowed = f"smaller, for this crack: the element at its tip is only {tip_size:.1g} m"
            raise InputError("mesh.grading", mesh.grading, allowed)
        lip = mesh.lip_elements, ratio
        ligament = _graded(width - length, tip_size, mesh.size)
        count, growth = _graded(level, tip_size, mesh.size)
        below, above = (count, 1.0 / growth), _graded(height - level, tip_size, mesh.size)
    return (
        [(0.0, length, *lip), (length, width, *ligament)],
        [(0.0, level, *below), (level, height, *above)],
    )


def _graded(length: float, first: float, last: float) -> Division:
    """Elements growing geometrically from about ``first`` to about ``last`` along ``length``."""
    if first >= last:
        return math.ceil(length / last), 1.0
    if length <= 2.0 * last:
        return (1 if length <= first else 2), 1.0
    growth = (length - first) / (length - last)
    count = max(1, round(1.0 + math.log(last / first) / math.log(growth)))
    return count, (last / first) ** (1.0 / max(count - 1, 1))


def _curve(start: int, end: int, elements: int, progression: float) -> int:
    curve: int = gmsh.model.geo.addLine(start, end)
    gmsh.model.geo.mesh.setTransfiniteCurve(curve, elements + 1, "Progression", progression)
    return curve


# --- a mesh file ----------------------------------------------------------------------------------


def _read(path: Path) -> None:
    """Fill the current model with what a mesh file holds, if it is one of ours."""
    if not path.is_file():
        raise InputError("mesh.file", str(path), "an existing gmsh mesh file")
    found = _read_by_child(path)
    if isinstance(found, str):
        raise InputError("mesh.file", str(path), f"readable by gmsh ({found})")
    numbers, positions, groups = found
    flat = len(positions) > 0 and np.ptp(positions[:, 2]) == 0.0
    if not flat or not np.all(np.abs(positions) < FARTHEST):
        allowed = f"a plane mesh, z the same at every node, within {FARTHEST:g} m of the origin"
        raise InputError("mesh.file", str(path), allowed)
    kinds = {kind for dimension, _, _, kind, _ in groups if dimension == 2}
    if len(kinds) != 1 or not kinds <= set(_EDGES):
        raise InputError(
            "mesh.file",
            str(path),
            "a mesh whose physical surfaces hold one kind of cells, triangles or quadrilaterals"
            f" (it holds {len(kinds)} kinds)",
        )
    kind = kinds.pop()
    cells = _cells(kind, [nodes for dimension, *_, nodes in groups if dimension == 2])
    if not _is_sound(kind, cells) or not np.isin(cells, numbers).all():
        allowed = "a mesh whose cells have different corners, and at most two of them an edge"
        raise InputError("mesh.file", str(path), allowed)
    expected = {0: _POINT, 1: _EDGES[kind]}
    parts = [group for group in groups if group[0] != 2]
    if not all(k == expected.get(d) and np.isin(nodes, cells).all() for d, *_, k, nodes in parts):
        allowed = "a mesh whose physical curves and points hold edges and corners of its cells"
        raise InputError("mesh.file", str(path), allowed)
    numbers, first = np.unique(numbers, return_index=True)
    used = np.isin(numbers, cells)
    plate = (2, 1, "plate", kind, cells.ravel())
    _fill(numbers[used], positions[first[used]], [plate, *parts])


def _cells(kind: int, nodes: list[np.ndarray]) -> np.ndarray:
    """Cells and their nodes, each cell once: a surface may be in several groups."""
    cells = np.concatenate(nodes).reshape(-1, gmsh.model.mesh.getElementProperties(kind)[3])
    return cells[np.sort(np.unique(np.sort(cells, axis=1), axis=0, return_index=True)[1])]


def _is_sound(kind: int, cells: np.ndarray) -> bool:
    """Whether no cell has a node twice, and no edge belongs to three cells."""
    ordered = np.sort(cells, axis=1)
    if np.any(ordered[:, 1:] == ordered[:, :-1]):
        return False
    corners = cells[:, : 3 if kind in _TRIANGLES else 4]
    edges = np.stack([corners, np.roll(corners, 1, axis=1)], axis=2).reshape(-1, 2)
    return int(np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)[1].max()) <= 2


_Group = tuple[int, int, str, int, np.ndarray]
"""Dimension, tag and name, and elements of one kind: gmsh's number of it and the nodes."""


def _fill(numbers: np.ndarray, positions: np.ndarray, groups: list[_Group]) -> None:
    """Put nodes and the elements of physical groups into the current model."""
    model = gmsh.model
    holder = model.addDiscreteEntity(2)
    model.mesh.addNodes(2, holder, numbers, positions.ravel())
    entities: dict[tuple[int, int], list[int]] = {}
    names = {}
    for dimension, tag, name, kind, nodes in groups:
        entity = model.addDiscreteEntity(dimension)
        model.mesh.addElementsByType(entity, kind, [], nodes)
        entities.setdefault((dimension, tag), []).append(entity)
        names[dimension, tag] = name
    for (dimension, tag), tags in entities.items():
        model.addPhysicalGroup(dimension, tags, tag)
        model.setPhysicalName(dimension, tag, names[dimension, tag])


def _read_by_child(path: Path) -> tuple[np.ndarray, np.ndarray, list[_Group]] | str:
    """Numbers and positions of a file's nodes and its groups, or what gmsh says against it.

    A child process reads it: a damaged file may crash gmsh, or spoil the memory it works in.
    """
    out, into = os.pipe()
    child = os.fork()
    if child:
        os.close(into)
        with os.fdopen(out, "rb") as pipe:
            answer = pipe.read()
        crashed = os.waitpid(child, 0)[1] != 0
        return "it crashes or does not end" if crashed else pickle.loads(answer)
    try:
        faulthandler.disable()
        for number in (signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGABRT):
            signal.signal(number, signal.SIG_DFL)  # PETSc's would end all ranks
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(LONGEST_READING)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        found: Any = None
        try:
            gmsh.merge(str(path))
            numbers, positions, _ = gmsh.model.mesh.getNodes()
            found = numbers, positions.reshape(-1, 3), list(_groups())
        except Exception as error:  # gmsh raises nothing more specific
            found = str(error) or "no reason given"
        with os.fdopen(into, "wb") as pipe:
            pipe.write(pickle.dumps(found))
        os._exit(0)
    finally:
        os._exit(1)


def _groups() -> Iterator[_Group]:
    """The physical groups of the current model."""
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            kinds, _, nodes = gmsh.model.mesh.getElements(dimension, entity)
            for kind, own in zip(kinds, nodes, strict=True):
                yield dimension, tag, name, int(kind), own


def _named_groups(file: str) -> tuple[dict[str, int], tuple[float, float] | None]:
    """Facet tags by name, and the position of the physical point ``load``."""
    groups: dict[str, int] = {}
    load_point = None
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag)
        if dimension == 1 and name in _GROUPS:
            groups[name] = tag
        elif dimension == 0 and name == "load":
            entities = gmsh.model.getEntitiesForPhysicalGroup(0, tag)
            nodes = [n for entity in entities for n in gmsh.model.mesh.getElements(0, entity)[2][0]]
            if len(nodes) != 1:
                raise InputError("mesh.file", file, "a mesh with one point in the group 'load'")
            x, y, _ = gmsh.model.mesh.getNode(nodes[0])[0]
            load_point = (float(x), float(y))
    if "clamp" not in groups:
        raise InputError("mesh.file", file, "a mesh with a physical curve named 'clamp'")
    if ("lower_lip" in groups) != ("upper_lip" in groups):
        raise InputError("mesh.file", file, "a mesh with both 'lower_lip' and 'upper_lip', or none")
    return groups, load_point
