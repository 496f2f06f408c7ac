"""The mesh of a structure as objects of pyvista: its cells, lines along its edges; a plotter."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pyvista

from fenics_crack.fem.nodal_mesh import NodalMesh

__all__ = ["edge_lines", "moved_grid", "off_screen_plotter"]


def moved_grid(mesh: NodalMesh, displacement: np.ndarray | float = 0.0) -> pyvista.UnstructuredGrid:
    """The cells, moved by nodal vectors (n_nodes, 2) [m]."""
    points = np.pad(mesh.points + displacement, ((0, 0), (0, 1)))
    count, nodes = mesh.cells.shape
    cells = np.column_stack([np.full(count, nodes), mesh.cells]).ravel()
    return pyvista.UnstructuredGrid(cells, np.full(count, mesh.vtk_type), points)


def edge_lines(
    mesh: NodalMesh, edges: np.ndarray, displacement: np.ndarray | float = 0.0, height: float = 0.0
) -> pyvista.PolyData:
    """Some of the edges, moved by nodal vectors and lifted towards the eye [m]."""
    count, nodes = edges.shape
    points = (mesh.points + displacement)[edges.ravel()]
    cells = np.column_stack([np.full(count, nodes), np.arange(edges.size).reshape(count, -1)])
    lifted = np.pad(points, ((0, 0), (0, 1)), constant_values=height)
    return pyvista.PolyData(lifted, lines=cells.ravel())


def off_screen_plotter(**options: Any) -> pyvista.Plotter:
    """A plotter that draws into memory."""
    if not os.environ.get("DISPLAY"):  # spares VTK the search for a screen, and its warning
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    return pyvista.Plotter(off_screen=True, **options)
