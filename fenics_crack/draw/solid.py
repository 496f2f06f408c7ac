"""Solids in matplotlib's panels: VTK draws their surface, seen from a corner, into an image.

pyvista is loaded without mypy, which it would load for a plugin of its own where that is installed:
a third of the time that it takes to load.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch

from fenics_crack.draw.figure import COLOURS
from fenics_crack.draw.vtk_parts import lines, look_from_corner, surface, without_screen
from fenics_crack.fem.nodal_mesh import NodalMesh

__all__ = ["draw_parts", "draw_shape", "off_screen_plotter", "outline", "pyvista"]

modules: dict[str, Any] = sys.modules
absent = modules.setdefault("mypy", None) is None
try:
    import pyvista
finally:
    if absent:
        del modules["mypy"]

PIXELS = (900, 1000)
"""Of an image."""
BENT = 25.0
"""Angle between facets at which there is an edge [degrees]."""
ARROW = 0.2
"""Length of the arrow of a load, relative to the size."""


def off_screen_plotter(**options: Any) -> pyvista.Plotter:
    """A plotter that draws into memory."""
    without_screen()
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("ALLOW_PLOTTING", "true")  # pyvista would open a window to know
    return pyvista.Plotter(off_screen=True, **options)


def outline(mesh: NodalMesh) -> np.ndarray:
    """Edges at which the surface of a solid at rest bends: (n, 2) nodes."""
    whole = pyvista.wrap(surface(mesh.points, mesh.boundary_facets))
    whole["node"] = np.arange(len(mesh.points))
    edges = whole.extract_feature_edges(
        feature_angle=BENT, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
    )
    return np.asarray(edges["node"])[edges.lines.reshape(-1, 3)[:, 1:]]


def _drawn(axes: Axes, plotter: Any, points: np.ndarray) -> None:
    """The image of a plotter with a solid, without its white margins, in a panel."""
    look_from_corner(plotter.renderer, points)
    plotter.camera_set = True
    image = plotter.screenshot(None, return_img=True)
    plotter.close()
    ink = np.argwhere((image < 250).any(axis=2))
    (top, left), (bottom, right) = ink.min(axis=0), ink.max(axis=0) + 1
    axes.imshow(image[top:bottom, left:right], interpolation="antialiased")
    axes.axis("off")


def draw_parts(axes: Axes, mesh: NodalMesh, load: np.ndarray) -> None:
    """The mesh with what is clamped, the lips, and the load (3, n_nodes, 3) [N]."""
    plotter = off_screen_plotter(window_size=PIXELS)
    points, facets = mesh.points, mesh.boundary_facets
    clamped = mesh.clamped[facets].all(axis=1)
    is_lip = np.isin(np.arange(len(facets)), mesh.lip_facets)
    shown = surface(points, facets[~clamped & ~is_lip])
    plotter.add_mesh(shown, color="#d8d8d8", opacity=0.35, show_edges=True, edge_color="#9a9a9a")
    plotter.add_mesh(lines(points, outline(mesh)), color="black", line_width=3)
    handles = []
    for rows, colour, label in (
        (facets[clamped], "green", "clamped"),
        (facets[is_lip], "orange", "lips of the crack"),
    ):
        if len(rows):
            plotter.add_mesh(surface(points, rows), color=to_rgb(COLOURS[colour]), lighting=False)
            handles.append(Patch(color=COLOURS[colour], label=label))
    for part in load:
        total, share = part.sum(axis=0), np.abs(part).sum(axis=1)
        if np.linalg.norm(total) > 0.0:
            place = share @ points / share.sum()
            length = ARROW * mesh.size
            start = place - length * total / np.linalg.norm(total)
            arrow = pyvista.Arrow(
                start=start, direction=total, scale=length, shaft_radius=0.03, tip_radius=0.08
            )
            plotter.add_mesh(arrow, color=to_rgb(COLOURS["pink"]), lighting=False)
    if np.any(load):
        handles.append(Patch(color=COLOURS["pink"], label="load"))
    _drawn(axes, plotter, mesh.points)
    if handles:
        axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=3)


def draw_shape(axes: Axes, mesh: NodalMesh, displacement: np.ndarray) -> None:
    """A displacement (n_nodes, 3), as large as it is to be drawn, coloured by its length, and the
    solid at rest."""
    plotter = off_screen_plotter(window_size=PIXELS)
    facets = mesh.boundary_facets
    moved = pyvista.wrap(surface(mesh.points + displacement, facets))
    moved["amplitude"] = np.linalg.norm(displacement, axis=1)
    plotter.add_mesh(moved, scalars="amplitude", cmap="viridis", show_scalar_bar=False)
    edges = outline(mesh)
    plotter.add_mesh(lines(mesh.points + displacement, edges), color="black", line_width=2)
    plotter.add_mesh(lines(mesh.points, edges), color="#8a8a8a", line_width=2)
    _drawn(axes, plotter, mesh.points)
