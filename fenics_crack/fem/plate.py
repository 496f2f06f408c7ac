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

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.fem import compat
from fenics_crack.fem.compat import gmsh
from fenics_crack.fem.msh_file import read_file
from fenics_crack.model.memory import machine_memory
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Scene

__all__ = ["PlateMesh", "build_mesh", "write_msh"]

MAX_CELLS = 5_000_000
"""For a plate; a mesh file may have any number of cells."""
ASSEMBLED = 1500.0
"""Bytes of mesh and matrices for each degree of freedom."""
SMALLEST_CELL = 1e-7
"""Relative to the plate: gmsh and the matrices allow no smaller one."""
_GROUPS = {"plate": 1, "clamp": 2, "lower_lip": 3, "upper_lip": 4, "load": 5}


@dataclass(frozen=True)
class PlateMesh:
    """A distributed mesh and where its named parts are.

    Attributes
    ----------
    mesh, facet_tags : dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags
        The plate, and the tags of its facets.
    groups : dict of str to int
        Facet tag of ``clamp``, and with a crack of ``lower_lip`` and ``upper_lip``.
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
    with compat.kept_interrupts():
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
        read_file(Path(str(scene.mesh.file)))
    else:
        _draw(scene)
        gmsh.model.mesh.generate(2)
    gmsh.model.mesh.renumberNodes()
    return _named_groups(str(scene.mesh.file))


# --- the plate ------------------------------------------------------------------------------------


def _draw(scene: Scene) -> None:
    """Draw the plate and set how each curve and surface is divided."""
    crack, width = scene.crack, scene.geometry.width
    assert width is not None
    columns, rows = _divisions(scene)
    cells = math.prod(sum(interval[2] for interval in side) for side in (columns, rows))
    _check_cells(scene, cells)
    mirrored = crack is not None and crack.edge == "right"

    def position(x: float, y: float) -> tuple[float, float]:
        return (width - x, y) if mirrored else (x, y)

    xs, ys = ([0.0, *(interval[1] for interval in side)] for side in (columns, rows))
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
    upper_lip = mouth_above and _curve(mouth_above, points[1, 1], *columns[0][2:])

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
    if upper_lip:
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


def _check_cells(scene: Scene, cells: int) -> None:
    """Raise InputError where there are too many cells for gmsh, or their matrices would not fit."""
    needed, machine = ASSEMBLED * 2 * scene.mesh.order**2 * cells, machine_memory()
    reason = ""
    if cells > MAX_CELLS:
        reason = f"{cells:.2g} are more than {MAX_CELLS:.0e}"
    elif needed > machine:
        reason = (
            f"the matrices of {cells:.2g} need about {needed / 2**30:.0f} GiB of this machine's "
            f"{machine / 2**30:.3g}"
        )
    if reason:
        key = "columns" if scene.mesh.layout == "grid" else "size"
        allowed = f"so that there are fewer cells: {reason}"
        raise InputError(f"mesh.{key}", getattr(scene.mesh, key), allowed)


Division = tuple[int, float]  # number of elements, ratio of the lengths of neighbours
Interval = tuple[float, float, int, float]  # from, to, and its division


def _divisions(scene: Scene) -> tuple[list[Interval], list[Interval]]:
    """Divide the plate left and right of the tip, and below and above the crack; or as a whole."""
    mesh, crack = scene.mesh, scene.crack
    width, height = scene.geometry.width, scene.geometry.height
    assert width and height
    if crack is None:
        cells: Any = mesh.columns, mesh.rows
        if mesh.size is not None:
            cells = [max(1, round(side / mesh.size)) for side in (width, height)]
        return [(0.0, width, cells[0], 1.0)], [(0.0, height, cells[1], 1.0)]
    assert crack.length and crack.height
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


# --- groups ---------------------------------------------------------------------------------------


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
