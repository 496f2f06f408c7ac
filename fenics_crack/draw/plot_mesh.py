"""Pictures of the mesh: with its named parts, and moved by mode shapes; of a solid VTK draws the
surface, seen from a corner, into an image."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.draw.figure import (
    COLOURS,
    Picture,
    PictureOptions,
    label_axis,
    magnification_to_tenth,
)
from fenics_crack.fem.cracks import rows_in
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure


def draw_mesh(structure: Structure, **picture_options: Unpack[PictureOptions]) -> Figure:
    """Draw the mesh of a structure at rest with its named parts (collective).

    They are what is clamped, the crack faces, the pairs of their nodes where contact is
    watched, and the load: arrows along its mean, cosines and sines, each in a scale of its own; of
    further harmonics along the largest.

    Parameters
    ----------
    structure : Structure
        Whole or reduced, from a mesh.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The structure has no mesh.

    Examples
    --------
    >>> figure = fc.draw_mesh(structure, path="mesh.png")
    """
    mesh = NodalMesh(structure)
    load = mesh.nodal_vectors(mesh.structure.force)
    if mesh.dimension == 3:
        picture = Picture(size=(5.5, 6.5), **picture_options)
        _solid(picture, mesh, load)
        return picture.finish()
    ratio = float(np.clip(np.divide(*np.maximum(np.ptp(mesh.points, axis=0), 1e-300)), 0.4, 2.5))
    size = (min(7.0, 3.6 + 2.0 * ratio), min(6.8, 1.6 + 3.6 / ratio))
    [panel] = picture = Picture(size=size, **picture_options)
    clamped = mesh.boundary[mesh.is_clamped[mesh.boundary].all(axis=1)]
    for edges, colour, width, label in (
        (mesh.edges, "#9a9a9a", 0.4, ""),
        (mesh.boundary, "black", 1.2, ""),
        (clamped, COLOURS["green"], 5.0, "clamped"),
        (mesh.crack_faces, COLOURS["orange"], 2.2, "crack faces"),
    ):
        if len(edges):
            look = {"colors": colour, "linewidths": width, "label": label}
            panel.add_collection(LineCollection(mesh.points[edges], **look))
    pairs = mesh.structure.pair_points
    if pairs is not None and len(pairs):
        look = {"color": COLOURS["blue"], "ms": 3.0, "zorder": 3}
        panel.plot(*pairs.T, "o", label=f"contact pairs ({len(pairs)})", **look)
    if len(load) > len(LOAD_PARTS):  # dozens of arrows at one node would hide each other
        largest = 3 + int(np.argmax(np.linalg.norm(load[3:], axis=(1, 2))))
        load = load[[0, 1, 2, largest]]
    acting = [part for part, there in enumerate(load.any(axis=(1, 2))) if there]
    for part in acting:
        several = len(acting) > 1
        words = f"load, {LOAD_PARTS[part]}" if several else "load"
        colour = PART_COLOURS[part] if several else COLOURS["pink"]
        _arrows(panel, mesh, load[part], words, colour)
    panel.autoscale_view()
    panel.margins(0.06)
    panel.set_aspect("equal")
    label_axis(panel.xaxis, "x", "m")
    label_axis(panel.yaxis, "y", "m")
    panel.set_axisbelow(True)
    return picture.finish()


LOAD_PARTS = ("mean", "cosine part", "sine part", "largest further harmonic")
PART_COLOURS = (COLOURS["grey"], COLOURS["blue"], COLOURS["pink"], "black")


def _arrows(axes: Axes, mesh: NodalMesh, load: np.ndarray, label: str, colour: str) -> None:
    """Draw nodal forces (n_nodes, 2) as arrows that begin at their nodes, the largest as long."""
    sizes = np.linalg.norm(load, axis=1)
    loaded = np.flatnonzero(sizes > 1e-9 * sizes.max())
    loaded = loaded[:: -(-len(loaded) // 40)]  # at most 40 arrows
    arrows = magnification_to_tenth(load, mesh.size) * load[loaded]
    look = {"color": colour, "angles": "xy", "scale_units": "xy", "scale": 1.0}
    axes.quiver(*mesh.points[loaded].T, *arrows.T, units="inches", width=0.03, zorder=4, **look)
    axes.update_datalim(mesh.points[loaded] + arrows)
    axes.plot([], [], color=colour, marker=">", label=label)


def draw_modes(
    modes: Modes,
    *,
    numbers: Sequence[int] | None = None,
    columns: int = 3,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw mode shapes over the structure at rest, coloured by their displacement (collective).

    Parameters
    ----------
    modes : Modes
        Of a structure with a mesh.
    numbers : sequence of int, optional
        Numbers of the modes, from 1; default: all.
    columns : int
        Panels side by side in a new figure.
    **picture_options
        ``axes``, one for each mode, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The structure has no mesh, there is no such mode or no column, or the number of axes is
        wrong.

    Examples
    --------
    >>> figure = fc.draw_modes(fc.solve_modes(structure, 2), path="modes.png")
    """
    every = range(1, len(modes.omega) + 1)
    numbers = list(every if numbers is None else numbers)
    if not numbers or any(number not in every for number in numbers):
        raise InputError("numbers", numbers, f"one or more of 1 to {every[-1]}")
    check_count("columns", columns, 1)
    columns = min(columns, len(numbers))
    mesh = NodalMesh(modes.structure)
    across, up = np.ptp(mesh.points, axis=0)[:2] + 0.2 * mesh.size  # they move by a tenth
    row = 0.4 + 2.4 * float(np.clip(up / across, 0.3, 1.0))
    size = (2.7 * columns, row * -(-len(numbers) // columns))
    picture = Picture(
        len(numbers), n_columns=columns, size=size, comm=mesh.structure.comm, **picture_options
    )
    shapes = mesh.nodal_vectors(modes.structure.expand(modes.shapes.T))
    for panel, number in zip(picture, numbers, strict=True):
        shape = shapes[number - 1]
        draw_moved(
            panel,
            mesh,
            magnification_to_tenth(shape, mesh.size) * shape,
            np.linalg.norm(shape, axis=1),
        )
        panel.set_title(f"mode {number}: {modes.omega[number - 1] / (2.0 * np.pi):.1f} Hz")
    return picture.save_with_title()


def draw_moved(
    axes: Axes,
    mesh: NodalMesh,
    displacement: np.ndarray,
    values: np.ndarray,
    *,
    of_wheel: bool = False,
) -> Any:
    """Draw a mesh moved by a displacement (n_nodes, d), as large as it is to be drawn, coloured by
    values (n_nodes,), with its edges and, but of a wheel, at rest; what the scale of the colours
    is of."""
    moved = mesh.points + displacement
    if mesh.dimension == 2:
        drawn = axes.tripcolor(*moved.T, mesh.triangles, values, shading="gouraud", cmap="viridis")
        edges = [(mesh.boundary, moved, "black", 0.7 if of_wheel else 1.2)]
        if not of_wheel:
            edges.insert(0, (mesh.boundary, mesh.points, COLOURS["grey"], 0.6))
            edges.insert(0, (mesh.edges, moved, "#777777", 0.3))
        for ends, points, colour, width in edges:
            axes.add_collection(LineCollection(points[ends], colors=colour, linewidths=width))
        axes.autoscale_view()
        axes.set_aspect("equal")
    else:
        from fenics_crack.draw import vtk

        plotter = vtk.off_screen_plotter()
        surface = vtk.make_surface(moved, mesh.boundary)
        surface["amplitude"] = values
        plotter.add_mesh(surface, scalars="amplitude", cmap="viridis", show_scalar_bar=False)
        outline = vtk.find_sharp_edges(mesh)
        plotter.add_mesh(vtk.make_lines(moved, outline), color="black", line_width=2)
        if not of_wheel:
            plotter.add_mesh(vtk.make_lines(mesh.points, outline), color="#8a8a8a", line_width=2)
        axes.imshow(vtk.render_cropped_image(plotter, mesh.points), interpolation="antialiased")
        drawn = ScalarMappable(Normalize(0.0, float(values.max())), "viridis")
    axes.axis("off")
    return drawn


def draw_faces(
    triangles: np.ndarray, owners: np.ndarray, faces: Sequence[int], places: np.ndarray,
    **picture_options: Unpack[PictureOptions],
) -> Figure:  # fmt: skip
    """Draw faces of a part with their numbers, from 1, at places (n, 3) of each.

    Triangles (m, 3, 3) have the face of each in ``owners`` (m,).
    """
    from fenics_crack.draw import vtk

    picture = Picture(2, n_columns=2, size=(11.0, 6.5), **picture_options)
    numbers = [str(number) for number in range(1, len(faces) + 1)]
    look = {"font_size": 24, "show_points": False, "shape": None}
    for panel, turn, words in zip(
        picture, ([1.0, 1.0, 1.0], [-1.0, 1.0, -1.0]), ("from a corner", "from the other side"),
        strict=True,
    ):  # fmt: skip
        plotter, corners = vtk.off_screen_plotter(), turn * triangles.reshape(-1, 3)
        rows = np.arange(len(corners)).reshape(-1, 3)
        for face, colour in zip(faces, cycle(COLOURS.values()), strict=False):
            plotter.add_mesh(vtk.make_surface(corners, rows[owners == face]), color=to_rgb(colour))
        plotter.add_point_labels(turn * places[: len(faces)], numbers, **look)
        panel.imshow(vtk.render_cropped_image(plotter, corners), interpolation="antialiased")
        panel.axis("off")
        panel.set_title(words)
    return picture.finish()


# --- of solids ------------------------------------------------------------------------------------


def _solid(picture: Picture, mesh: NodalMesh, load: np.ndarray) -> None:
    """The mesh with what is clamped, the crack faces, and the load (2K+1, n_nodes, 3) [N]."""
    from fenics_crack.draw import vtk

    plotter = vtk.off_screen_plotter()
    points, facets = mesh.points, mesh.boundary
    clamped = mesh.is_clamped[facets].all(axis=1)
    is_lip = rows_in(facets, mesh.crack_faces)
    shown = vtk.make_surface(points, facets[~clamped & ~is_lip])
    plotter.add_mesh(shown, color="#d8d8d8", opacity=0.35, show_edges=True, edge_color="#9a9a9a")
    plotter.add_mesh(
        vtk.make_lines(points, vtk.find_sharp_edges(mesh)), color="black", line_width=3
    )
    handles = []
    for rows, colour, label in (
        (facets[clamped], "green", "clamped"),
        (facets[is_lip], "orange", "crack faces"),
    ):
        if len(rows):
            faces = vtk.make_surface(points, rows)
            plotter.add_mesh(faces, color=to_rgb(COLOURS[colour]), lighting=False)
            handles.append(Patch(color=COLOURS[colour], label=label))
    for part in load:
        total, share = part.sum(axis=0), np.abs(part).sum(axis=1)
        if np.linalg.norm(total) > 0.0:
            place = share @ points / share.sum()
            length, thick = 0.2 * mesh.size, {"shaft_radius": 0.03, "tip_radius": 0.08}
            start = place - length * total / np.linalg.norm(total)
            arrow = vtk.import_pyvista().Arrow(start=start, direction=total, scale=length, **thick)
            plotter.add_mesh(arrow, color=to_rgb(COLOURS["pink"]), lighting=False)
    if np.any(load):
        handles.append(Patch(color=COLOURS["pink"], label="load"))
    [axes] = picture
    axes.imshow(vtk.render_cropped_image(plotter, points), interpolation="antialiased")
    axes.axis("off")
    if handles and picture.has_legend:
        axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=3)
