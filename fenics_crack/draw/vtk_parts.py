"""What VTK draws and writes, from arrays: points, cells, values; and the camera that looks at them.

pyvista does the same and more, but loads in 0.2 s: it is left to the pictures of solids, to the
window, and to values at points.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkUnstructuredGrid

from fenics_crack.fem.nodal_mesh import NodalMesh

__all__ = [
    "add_values",
    "cells_of",
    "grid_of",
    "image_of",
    "in_space",
    "lines",
    "look_from_corner",
    "off_screen_plotter",
    "outline",
    "place",
    "pyvista",
    "seen_parallel",
    "surface",
    "without_screen",
]

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
