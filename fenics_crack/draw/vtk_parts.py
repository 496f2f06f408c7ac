"""What VTK draws and writes, from arrays: points, cells, values; and the camera that looks at them.

pyvista does the same and more, but loads in 0.2 s: it is left to the pictures of solids, to the
window, and to values at points.

Stresses at the nodes of a mesh, and at points of it, follow from the gradient of the displacement
in the cells at each node, averaged; the lips have nodes of their own, so nothing is averaged across
the crack.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import (
    vtkCellArray,
    vtkDataObject,
    vtkPolyData,
    vtkUnstructuredGrid,
)
from vtkmodules.vtkFiltersGeneral import vtkGradientFilter

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import InputError
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.matrices import numbers
from fenics_crack.scene.tables import Material
from fenics_crack.time.march import TimeHistory

__all__ = [
    "add_values", "cells_of", "image_of", "in_space", "lines", "look_from_corner",
    "off_screen_plotter", "outline", "place", "pyvista", "seen_parallel", "surface",
    "without_screen",
]  # fmt: skip

VIEW = (-1.3, 0.55, 1.6)
"""Where the camera stands, seen from the middle: y goes up, z where a solid is thinnest."""
PIXELS = (900, 1000)
"""Of an image."""
BENT = 25.0
"""Angle between facets at which there is an edge [degrees]."""


def in_space(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, d) as VTK has them: (n, 3)."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


def grid_of(points: np.ndarray, cells: np.ndarray, vtk_type: int) -> vtkUnstructuredGrid:
    """Points (n, d) and cells of one type."""
    grid = vtkUnstructuredGrid()
    place(grid, points)
    grid.SetCells(vtk_type, cells_of(cells))
    return grid


def surface(points: np.ndarray, facets: np.ndarray) -> vtkPolyData:
    """Some facets."""
    data = vtkPolyData()
    place(data, points)
    data.SetPolys(cells_of(facets))
    return data


def lines(points: np.ndarray, edges: np.ndarray) -> vtkPolyData:
    """Some edges."""
    data = vtkPolyData()
    place(data, points)
    data.SetLines(cells_of(edges))
    return data


def cells_of(nodes: np.ndarray) -> vtkCellArray:
    """Cells with the same number of nodes each: (n, k)."""
    cells = vtkCellArray()
    cells.SetData(nodes.shape[1], numpy_to_vtkIdTypeArray(nodes.ravel().astype(np.int64), deep=1))
    return cells


def place(data: vtkPolyData | vtkUnstructuredGrid, points: np.ndarray) -> None:
    """Put the points (n, d) of a data set where they are now."""
    positions = vtkPoints()
    positions.SetData(numpy_to_vtk(in_space(points), deep=1))
    data.SetPoints(positions)


def add_values(fields: Any, name: str, values: np.ndarray) -> Any:
    """Add an array to the point data or the field data of a data set, or put it in the place of the
    one with this name; return it."""
    array = numpy_to_vtk(np.ascontiguousarray(values), deep=1)
    array.SetName(name)
    fields.AddArray(array)
    return array


def without_screen() -> None:
    """Spare VTK the search for a screen where there is none, and its warning."""
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


def seen_parallel(renderer: Any) -> Any:
    """The camera of a renderer, which draws on white and makes nothing smaller that is far."""
    renderer.SetBackground(1.0, 1.0, 1.0)
    camera = renderer.GetActiveCamera()
    camera.ParallelProjectionOn()
    return camera


def look_from_corner(renderer: Any, points: np.ndarray) -> None:
    """Set the camera so that all of a solid is seen, y up, and what moves across it."""
    camera = seen_parallel(renderer)
    flat = points[:, [0, 2]] - points[:, [0, 2]].mean(axis=0)
    x, z = np.linalg.eigh(flat.T @ flat)[1][:, 0]  # where it is thinnest
    x, z = (x, z) if z > 0.0 else (-x, -z)
    camera.SetFocalPoint(0.0, 0.0, 0.0)
    camera.SetPosition(VIEW[0] * z + VIEW[2] * x, VIEW[1], VIEW[2] * z - VIEW[0] * x)
    camera.SetViewUp(0.0, 1.0, 0.0)
    renderer.ResetCamera()


# --- by pyvista -----------------------------------------------------------------------------------


def pyvista() -> Any:
    """The package, loaded without mypy, which it would load for a plugin of its own where that is
    installed: a third of the time that it takes to load."""
    modules: dict[str, Any] = sys.modules
    absent = modules.setdefault("mypy", None) is None
    try:
        import pyvista
    finally:
        if absent:
            del modules["mypy"]
    return pyvista


def off_screen_plotter(window_size: tuple[int, int] = PIXELS) -> Any:
    """A plotter that draws into memory."""
    without_screen()
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("ALLOW_PLOTTING", "true")  # pyvista would open a window to know
    return pyvista().Plotter(off_screen=True, window_size=window_size)


def outline(mesh: NodalMesh) -> np.ndarray:
    """Edges at which the surface of a solid at rest bends: (n, 2) nodes."""
    whole = pyvista().wrap(surface(mesh.points, mesh.boundary_facets))
    whole["node"] = np.arange(len(mesh.points))
    edges = whole.extract_feature_edges(
        feature_angle=BENT, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
    )
    return np.asarray(edges["node"])[edges.lines.reshape(-1, 3)[:, 1:]]


def image_of(plotter: Any, points: np.ndarray) -> np.ndarray:
    """What a plotter with a solid shows, without its white margins; it is closed."""
    look_from_corner(plotter.renderer, points)
    plotter.camera_set = True
    image = plotter.screenshot(None, return_img=True)
    plotter.close()
    ink = np.argwhere((image < 250).any(axis=2))
    (top, left), (bottom, right) = ink.min(axis=0), ink.max(axis=0) + 1
    return np.asarray(image[top:bottom, left:right])


if TYPE_CHECKING:
    from fenics_crack.study.run import Run

__all__ = ["COMPONENTS", "moved_grid", "nodal_stress", "stress_at", "von_mises"]

COMPONENTS = {2: ("xx", "yy", "xy"), 3: ("xx", "yy", "zz", "xy", "yz", "xz")}
"""Stresses in a plane and in space."""
STRESS_INSTANTS = 128
"""Of a period, at which stresses are found."""


def moved_grid(mesh: NodalMesh, displacement: np.ndarray | float = 0.0) -> vtkUnstructuredGrid:
    """The cells, moved by nodal vectors (n_nodes, d) [m]."""
    return grid_of(mesh.points + displacement, mesh.cells, mesh.vtk_type)


__all__ = ["COMPONENTS", "moved_grid", "nodal_stress", "stress_at", "von_mises"]


def nodal_stress(mesh: NodalMesh, displacement: np.ndarray, material: Material) -> np.ndarray:
    """Plane stresses xx, yy, xy of nodal displacements (..., n_nodes, 2) [m]: (..., n_nodes, 3)
    [Pa]; of a solid xx, yy, zz, xy, yz, xz: (..., n_nodes, 6)."""
    columns = np.moveaxis(displacement, -2, 0)
    flat = columns.reshape(len(columns), -1)
    slopes = [(part @ flat).reshape(columns.shape) for part in _slopes(mesh)]
    slope = np.moveaxis(np.stack(slopes, axis=-1), 0, -3)
    nu = material.poisson
    share = nu / (1.0 - nu) if mesh.dimension == 2 else nu / (1.0 - 2.0 * nu)
    strain = 0.5 * (slope + np.swapaxes(slope, -1, -2))
    volume = np.trace(strain, axis1=-2, axis2=-1)[..., None, None] * np.eye(mesh.dimension)
    full = material.young / (1.0 + nu) * (strain + share * volume)
    places = (map("xyz".index, name) for name in COMPONENTS[mesh.dimension])
    return np.stack([full[..., i, j] for i, j in places], axis=-1)


def _slopes(mesh: NodalMesh) -> list[csr_matrix]:
    """d/dx, d/dy (and d/dz) at the nodes of a nodal field, each the mean of the cells there, as
    matrices (n_nodes, n_nodes) [1/m].

    VTK differentiates the shape functions N at the nodes of its unit cell, and in a cell that x(X)
    maps it to, dN/dx = dN/dX (dx/dX)^-1. (In the cells themselves it looks for the nodes first,
    which fails in slim tetrahedra of ten nodes.)
    """
    of_cell = mesh.cells.shape[1]
    places = np.reshape(moved_grid(mesh).GetCell(0).GetParametricCoords(), (of_cell, 3))
    unit, slopes = grid_of(places, np.arange(of_cell)[None], mesh.vtk_type), vtkGradientFilter()
    add_values(unit.GetPointData(), "shape", np.eye(of_cell))
    slopes.SetInputData(unit)
    slopes.SetInputScalars(vtkDataObject.FIELD_ASSOCIATION_POINTS, "shape")
    slopes.SetResultArrayName("gradient")
    slopes.Update()
    found = vtk_to_numpy(slopes.GetOutput().GetPointData().GetArray("gradient"))
    shape = found.reshape(of_cell, of_cell, 3)[..., : mesh.dimension]  # node, function, axis
    mapped = np.einsum("cbx,nbX->cnxX", mesh.points[mesh.cells], shape)
    slope = np.einsum("nbX,cnXx->xcnb", shape, np.linalg.inv(mapped))
    slope /= np.bincount(mesh.cells.ravel())[mesh.cells][..., None]
    rows, functions = np.repeat(mesh.cells, of_cell), np.tile(mesh.cells, of_cell).ravel()
    size = 2 * (len(mesh.points),)
    return [csr_matrix((part.ravel(), (rows, functions)), size) for part in slope]


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Von Mises stress of stresses as :func:`nodal_stress` has them: (...) [Pa]."""
    if stress.shape[-1] == 3:  # none across the plane
        stress = np.insert(stress, (2, 3, 3), 0.0, axis=-1)
    xx, yy, zz, xy, yz, xz = np.moveaxis(stress, -1, 0)
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.asarray(np.sqrt(0.5 * normal + 3.0 * (xy**2 + yz**2 + xz**2)))


def stress_at(
    run: Run[PeriodicSolution] | Run[TimeHistory], points: Sequence[Any] | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find stresses at some points over time (collective).

    Those of the nodes, where the cells' own are averaged, but not across a crack; between the nodes
    as displacements are. At the tip of a crack and under a force at a point they grow without bound
    as the mesh is refined: there :func:`stress_intensity` is the number to ask for.

    Parameters
    ----------
    run : Run
        What :func:`solve` or :func:`integrate` returns, of a mesh.
    points : (m, d) [m]
        Where; of a line its points, ``np.linspace(start, stop, 50)``.

    Returns
    -------
    time : (n,) [s]
        128 instants of a period, or those of the record.
    stress : (n, m, 3) [Pa]
        xx, yy, xy; of a solid xx, yy, zz, xy, yz, xz: (n, m, 6).

    Raises
    ------
    InputError
        The structure has no mesh, or a point is not on it.

    Examples
    --------
    >>> time, stress = fc.stress_at(fc.solve(scene), [[0.1, 0.02], [0.1, 0.04]])
    """
    from fenics_crack.study.run import check_motion  # loads DOLFINx

    check_motion(run)
    found, structure = run.result, run.structure
    mesh, places = NodalMesh(structure), numbers(points)
    if places.ndim != 2 or places.shape[1] != mesh.dimension or not np.all(np.isfinite(places)):
        raise InputError("points", points, f"rows of {mesh.dimension} finite numbers [m]")
    if isinstance(found, TimeHistory):
        time = found.time
        if len(found.recorded_dofs) < structure.n_local:
            raise InputError("dofs", "some", "None, to record all displacements")
        moved = structure.expand(found.recorded)
    else:
        time = np.arange(STRESS_INSTANTS) * found.period / STRESS_INSTANTS
        moved = found.displacement_field(time)
    nodal = nodal_stress(mesh, mesh.field(moved), run.scene.material)
    grid, columns = pyvista().wrap(moved_grid(mesh)), np.moveaxis(nodal, -2, 0)
    grid["stress"] = columns.reshape(len(columns), -1)
    seen = pyvista().PolyData(in_space(places)).sample(grid)
    off = np.flatnonzero(np.asarray(seen["vtkValidPointMask"]) == 0)
    if len(off):
        raise InputError("points", places[off[0]].tolist(), "on the mesh")
    stress = np.asarray(seen["stress"]).reshape(len(places), len(time), -1)
    return time, np.moveaxis(stress, 0, 1)
