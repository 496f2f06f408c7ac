"""Draw the mesh with its named parts, mode shapes, and a part's numbered faces.

VTK draws the surface of a solid, seen from a corner, into an image.
"""

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
    CURVE_COLOUR_CODE_BY_NAME,
    Picture,
    PictureOptions,
    label_axis,
    magnification_to_tenth,
)
from fenics_crack.fem.cracks import are_rows_in
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure


def draw_mesh(structure: Structure, **picture_options: Unpack[PictureOptions]) -> Figure:
    """Draw the mesh of a structure at rest with its named parts (collective).

    The named parts are clamped edges, crack faces, contact pairs, and the load. Arrows show the
    load's mean, and the cosine and sine part of the first harmonic. Each has a separate arrow
    scale. Among all higher load harmonics, only the largest cosine or sine part has arrows. In a
    solid each load part has a single arrow, and contact pairs are not drawn.

    Parameters
    ----------
    structure : Structure
        Whole or reduced structure from a mesh.
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
    nodal_load_fourier_parts = mesh.nodal_vectors(mesh.structure.force)
    if mesh.dimension == 3:
        picture = Picture(size=(5.5, 6.5), **picture_options)
        _draw_solid(picture, mesh, nodal_load_fourier_parts)
        return picture.draw_legends_and_save()
    width_to_height_ratio = float(
        np.clip(np.divide(*np.maximum(np.ptp(mesh.points, axis=0), 1e-300)), 0.4, 2.5)
    )
    [panel] = picture = Picture(
        size=(
            min(7.0, 3.6 + 2.0 * width_to_height_ratio),
            min(6.8, 1.6 + 3.6 / width_to_height_ratio),
        ),
        **picture_options,
    )
    clamped_edges = mesh.boundary_sides[mesh.is_clamped[mesh.boundary_sides].all(axis=1)]
    for edges, colour, line_width, label in (
        (mesh.edges, "#9a9a9a", 0.4, ""),
        (mesh.boundary_sides, "black", 1.2, ""),
        (clamped_edges, CURVE_COLOUR_CODE_BY_NAME["green"], 5.0, "clamped"),
        (mesh.crack_face_sides, CURVE_COLOUR_CODE_BY_NAME["orange"], 2.2, "crack faces"),
    ):
        if len(edges):
            panel.add_collection(
                LineCollection(
                    mesh.points[edges], colors=colour, linewidths=line_width, label=label
                )
            )
    pair_points = mesh.structure.pair_points
    if pair_points is not None and len(pair_points):
        panel.plot(
            *pair_points.T,
            "o",
            label=f"contact pairs ({len(pair_points)})",
            color=CURVE_COLOUR_CODE_BY_NAME["blue"],
            ms=3.0,
            zorder=3,
        )
    # Dozens of arrows at one node would hide each other.
    if len(nodal_load_fourier_parts) > len(LOAD_PART_ARROW_LABELS):
        largest_further_load_part_index = 3 + int(
            np.argmax(np.linalg.norm(nodal_load_fourier_parts[3:], axis=(1, 2)))
        )
        nodal_load_fourier_parts = nodal_load_fourier_parts[
            [0, 1, 2, largest_further_load_part_index]
        ]
    nonzero_load_part_indices = np.flatnonzero(nodal_load_fourier_parts.any(axis=(1, 2)))
    has_several_load_parts = len(nonzero_load_part_indices) > 1
    for load_part_index in nonzero_load_part_indices:
        legend_label = (
            f"load, {LOAD_PART_ARROW_LABELS[load_part_index]}" if has_several_load_parts else "load"
        )
        colour = (
            LOAD_PART_ARROW_COLOURS[load_part_index]
            if has_several_load_parts
            else CURVE_COLOUR_CODE_BY_NAME["pink"]
        )
        _draw_load_arrows(
            panel, mesh, nodal_load_fourier_parts[load_part_index], legend_label, colour
        )
    panel.autoscale_view()
    panel.margins(0.06)
    panel.set_aspect("equal")
    label_axis(panel.xaxis, "x", "m")
    label_axis(panel.yaxis, "y", "m")
    panel.set_axisbelow(True)
    return picture.draw_legends_and_save()


LOAD_PART_ARROW_LABELS = ("mean", "cosine part", "sine part", "largest further harmonic")
"""Legend entries of the load's arrows: the rows of the load that are drawn."""
LOAD_PART_ARROW_COLOURS = (
    CURVE_COLOUR_CODE_BY_NAME["grey"],
    CURVE_COLOUR_CODE_BY_NAME["blue"],
    CURVE_COLOUR_CODE_BY_NAME["pink"],
    "black",
)
"""Colours of the load's arrows, by part, if several parts of the load act."""


def _draw_load_arrows(
    axes: Axes, mesh: NodalMesh, nodal_forces: np.ndarray, label: str, colour: str
) -> None:
    """Draw nodal forces (n_nodes, 2) [N] as arrows that begin at their nodes.

    ``label`` is the legend entry. The longest arrow has a tenth of the mesh's size. At most 40
    loaded nodes have arrows; the nodes are chosen at equal steps of the node number.
    """
    force_sizes = np.linalg.norm(nodal_forces, axis=1)
    arrow_nodes = np.flatnonzero(force_sizes > 1e-9 * force_sizes.max())
    arrow_nodes = arrow_nodes[:: -(-len(arrow_nodes) // 40)]
    arrow_vectors = magnification_to_tenth(nodal_forces, mesh.size) * nodal_forces[arrow_nodes]
    axes.quiver(
        *mesh.points[arrow_nodes].T,
        *arrow_vectors.T,
        units="inches",
        width=0.03,
        zorder=4,
        color=colour,
        angles="xy",
        scale_units="xy",
        scale=1.0,
    )
    axes.update_datalim(mesh.points[arrow_nodes] + arrow_vectors)
    axes.plot([], [], color=colour, marker=">", label=label)


def draw_modes(
    modes: Modes,
    *,
    numbers: Sequence[int] | None = None,
    columns: int = 3,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw mode shapes over the structure at rest, coloured by displacement (collective).

    Parameters
    ----------
    modes : Modes
        Modes of a structure with a mesh.
    numbers : sequence of int, optional
        Mode numbers, from 1; default: all.
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
    available_mode_numbers = range(1, len(modes.omega) + 1)
    numbers = list(available_mode_numbers if numbers is None else numbers)
    if not numbers or any(mode_number not in available_mode_numbers for mode_number in numbers):
        raise InputError(
            "numbers", numbers, f"one or more mode numbers from 1 to {available_mode_numbers[-1]}"
        )
    check_count("columns", columns, 1)
    columns = min(columns, len(numbers))
    mesh = NodalMesh(modes.structure)
    mesh_width_with_margin, mesh_height_with_margin = (
        np.ptp(mesh.points, axis=0)[:2] + 0.2 * mesh.size
    )  # a tenth each way
    row_height = 0.4 + 2.4 * float(
        np.clip(mesh_height_with_margin / mesh_width_with_margin, 0.3, 1.0)
    )
    picture = Picture(
        len(numbers),
        n_columns=columns,
        size=(2.7 * columns, row_height * -(-len(numbers) // columns)),
        comm=mesh.structure.comm,
        **picture_options,
    )
    all_mode_shapes = mesh.nodal_vectors(modes.structure.expand(modes.shapes.T))
    for panel, mode_number in zip(picture, numbers, strict=True):
        mode_shape = all_mode_shapes[mode_number - 1]
        displacement = magnification_to_tenth(mode_shape, mesh.size) * mode_shape
        draw_displaced_mesh(panel, mesh, displacement, np.linalg.norm(mode_shape, axis=1))
        panel.set_title(
            f"mode {mode_number}: {modes.omega[mode_number - 1] / (2.0 * np.pi):.1f} Hz"
        )
    return picture.save_with_title()


def draw_displaced_mesh(
    axes: Axes,
    mesh: NodalMesh,
    displacement: np.ndarray,
    values: np.ndarray,
    *,
    is_wheel: bool = False,
) -> Any:
    """Draw a displaced mesh, coloured by nodal values.

    Black lines are the displaced boundary of a plate, or the displaced sharp edges of a solid. Grey
    lines show the boundary or the sharp edges at rest. In a plate, thin grey lines show the
    displaced edges of all cells. With ``is_wheel``, no grey lines are drawn.

    Parameters
    ----------
    axes : Axes
        Panel to draw on.
    mesh : NodalMesh
        Mesh at rest.
    displacement : (n_nodes, d) [m]
        Displacement, already magnified for drawing.
    values : (n_nodes,)
        Nodal values for the colours.
    is_wheel : bool
        True for a bladed disk, whose many blades need fewer lines.

    Returns
    -------
    ScalarMappable
        Colour map and scale, for a colour bar.
    """
    displaced_points = mesh.points + displacement
    if mesh.dimension == 2:
        mappable = axes.tripcolor(
            *displaced_points.T, mesh.triangles, values, shading="gouraud", cmap="viridis"
        )
        thin_line_layers = [
            (mesh.edges, displaced_points, "#777777", 0.3),
            (mesh.boundary_sides, mesh.points, CURVE_COLOUR_CODE_BY_NAME["grey"], 0.6),
        ]
        boundary_line_layer = (
            mesh.boundary_sides,
            displaced_points,
            "black",
            0.7 if is_wheel else 1.2,
        )
        edge_layers = (
            [boundary_line_layer] if is_wheel else [*thin_line_layers, boundary_line_layer]
        )
        for edge_nodes, layer_points, colour, line_width in edge_layers:
            axes.add_collection(
                LineCollection(layer_points[edge_nodes], colors=colour, linewidths=line_width)
            )
        axes.autoscale_view()
        axes.set_aspect("equal")
    else:
        from fenics_crack.draw import vtk

        plotter = vtk.off_screen_plotter()
        surface = vtk.make_surface(displaced_points, mesh.boundary_sides)
        surface["amplitude"] = values
        plotter.add_mesh(surface, scalars="amplitude", cmap="viridis", show_scalar_bar=False)
        sharp_edges = vtk.find_node_pairs_of_sharp_edges(mesh)
        plotter.add_mesh(vtk.make_lines(displaced_points, sharp_edges), color="black", line_width=2)
        if not is_wheel:
            plotter.add_mesh(
                vtk.make_lines(mesh.points, sharp_edges), color="#8a8a8a", line_width=2
            )
        axes.imshow(vtk.render_cropped_image(plotter, mesh.points), interpolation="antialiased")
        mappable = ScalarMappable(Normalize(0.0, float(values.max())), "viridis")
    axes.axis("off")
    return mappable


def draw_numbered_faces(
    triangles: np.ndarray, triangle_faces: np.ndarray, face_tags: Sequence[int],
    number_positions: np.ndarray, **picture_options: Unpack[PictureOptions],
) -> Figure:  # fmt: skip
    """Draw the numbered faces of a CAD part from two sides.

    Parameters
    ----------
    triangles : (m, 3, 3) [m]
        Three corners of each triangle on the faces.
    triangle_faces : (m,) int
        Gmsh tag of each triangle's face.
    face_tags : sequence of int
        Gmsh tags of the drawn faces; the first face has the number 1.
    number_positions : (n, 3) [m]
        Position of each face's number, in the order of ``face_tags``; further rows are ignored.
    """
    from fenics_crack.draw import vtk

    picture = Picture(2, n_columns=2, size=(11.0, 6.5), **picture_options)
    face_number_strings = [str(face_number) for face_number in range(1, len(face_tags) + 1)]
    for panel, view_axis_signs, view_title in zip(
        picture, ([1.0, 1.0, 1.0], [-1.0, 1.0, -1.0]), ("from a corner", "from the other side"),
        strict=True,
    ):  # fmt: skip
        plotter, turned_corners = (
            vtk.off_screen_plotter(),
            view_axis_signs * triangles.reshape(-1, 3),
        )
        corner_rows = np.arange(len(turned_corners)).reshape(-1, 3)
        for face_tag, colour in zip(
            face_tags, cycle(CURVE_COLOUR_CODE_BY_NAME.values()), strict=False
        ):
            plotter.add_mesh(
                vtk.make_surface(turned_corners, corner_rows[triangle_faces == face_tag]),
                color=to_rgb(colour),
            )
        plotter.add_point_labels(
            view_axis_signs * number_positions[: len(face_tags)],
            face_number_strings,
            font_size=24,
            show_points=False,
            shape=None,
        )
        panel.imshow(vtk.render_cropped_image(plotter, turned_corners), interpolation="antialiased")
        panel.axis("off")
        panel.set_title(view_title)
    return picture.draw_legends_and_save()


# --- of solids ------------------------------------------------------------------------------------


def _draw_solid(picture: Picture, mesh: NodalMesh, nodal_load_fourier_parts: np.ndarray) -> None:
    """Draw a solid with clamped facets, crack faces and load.

    Parameters
    ----------
    picture : Picture
        Picture to draw on.
    mesh : NodalMesh
        Mesh of the solid.
    nodal_load_fourier_parts : (2K+1, n_nodes, 3) [N]
        Nodal forces: mean, then cosine and sine parts for harmonics 1 to K. Each has an arrow in
        the direction of the total force; all arrows are equally long.
    """
    from fenics_crack.draw import vtk

    plotter = vtk.off_screen_plotter()
    points, facets = mesh.points, mesh.boundary_sides
    is_clamped_facet = mesh.is_clamped[facets].all(axis=1)
    is_crack_face = are_rows_in(facets, mesh.crack_face_sides)
    free_surface = vtk.make_surface(points, facets[~is_clamped_facet & ~is_crack_face])
    plotter.add_mesh(
        free_surface, color="#d8d8d8", opacity=0.35, show_edges=True, edge_color="#9a9a9a"
    )
    plotter.add_mesh(
        vtk.make_lines(points, vtk.find_node_pairs_of_sharp_edges(mesh)),
        color="black",
        line_width=3,
    )
    legend_patches = []
    for part_facets, colour, label in (
        (facets[is_clamped_facet], "green", "clamped"),
        (facets[is_crack_face], "orange", "crack faces"),
    ):
        if len(part_facets):
            clamped_or_crack_surface = vtk.make_surface(points, part_facets)
            plotter.add_mesh(
                clamped_or_crack_surface,
                color=to_rgb(CURVE_COLOUR_CODE_BY_NAME[colour]),
                lighting=False,
            )
            legend_patches.append(Patch(color=CURVE_COLOUR_CODE_BY_NAME[colour], label=label))
    for nodal_forces in nodal_load_fourier_parts:
        total_force, force_sizes = nodal_forces.sum(axis=0), np.abs(nodal_forces).sum(axis=1)
        if np.linalg.norm(total_force) > 0.0:
            arrow_head_point = force_sizes @ points / force_sizes.sum()
            arrow_length = 0.2 * mesh.size
            arrow_start = arrow_head_point - arrow_length * total_force / np.linalg.norm(
                total_force
            )
            arrow = vtk.import_pyvista().Arrow(
                start=arrow_start,
                direction=total_force,
                scale=arrow_length,
                shaft_radius=0.03,
                tip_radius=0.08,
            )
            plotter.add_mesh(arrow, color=to_rgb(CURVE_COLOUR_CODE_BY_NAME["pink"]), lighting=False)
    if np.any(nodal_load_fourier_parts):
        legend_patches.append(Patch(color=CURVE_COLOUR_CODE_BY_NAME["pink"], label="load"))
    [axes] = picture
    axes.imshow(vtk.render_cropped_image(plotter, points), interpolation="antialiased")
    axes.axis("off")
    if legend_patches and picture.has_legend:
        axes.legend(handles=legend_patches, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=3)
