"""Animate the breathing crack as a GIF.

The plate is drawn magnified and coloured by von Mises stress or displacement. Crack faces are thick
lines, pairs in contact have dots, and an arrow is the load. All fields are gathered first; rank 0
draws.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import write_file_whole
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import choose_factor_and_prefixed_unit
from fenics_crack.draw import vtk
from fenics_crack.draw.figure import CURVE_COLOUR_CODE_BY_NAME, copy_canvas_image, label_axis
from fenics_crack.draw.vtk import PeriodFields
from fenics_crack.scene.tables import Material

CONTACT_BACKGROUND_COLOUR = "#f5d6c1"
"""Background of the curve over time while crack faces touch: light orange."""
UNSHADED_MESH_OPTIONS: dict[str, Any] = {"lighting": False, "reset_camera": False, "render": False}
"""Options of pyvista's ``add_mesh``: no shading, no camera change, no immediate rendering."""
ANIMATED_PART_COLOUR_BY_NAME = {
    "lips": "#000000",
    "contact": CURVE_COLOUR_CODE_BY_NAME["orange"],
    "load": CURVE_COLOUR_CODE_BY_NAME["pink"],
    "rest": "#8a8a8a",
}
"""Colours of an animation: crack faces and moving edges, contact dots, load, rest position."""


def animate_period(
    solution: PeriodicSolution,
    path: str | Path,
    *,
    frames: int = 36,
    magnification: float | None = None,
    material: Material | None = None,
) -> float:
    """Draw one period of a vibration as an animated GIF (collective).

    A curve below the structure shows the opening of a crack over time, at the watched contact pair
    that moves most. The background is tinted while the faces of this crack touch. Without a crack,
    the curve shows the largest displacement. The caption and the file's comment state the
    magnification.

    Parameters
    ----------
    solution : PeriodicSolution
        Result to show.
    path : str or Path
        A .gif file.
    frames : int
        Number of instants in the period.
    magnification : float, optional
        Factor by which drawn displacements are magnified; default: the largest displacement becomes
        a tenth of the structure's size.
    material : Material, optional
        Material of the scene, for colours by von Mises stress; default: colours by displacement.

    Returns
    -------
    float
        Factor by which drawn displacements are magnified.

    Raises
    ------
    InputError
        The file is no .gif, the structure has no mesh, or an argument cannot be used.

    Examples
    --------
    >>> magnification = fc.animate_period(solution, "crack.gif", frames=4)
    """
    if Path(path).suffix.lower() != ".gif":
        raise InputError("path", str(path), "a file name that ends in .gif")
    begin_stage(Path(path).name)
    fields = PeriodFields(solution, frames, magnification, material)
    on_root(fields.mesh.structure.comm, lambda: _write_gif(solution, fields, Path(path)))
    return fields.magnification


# --- the plate ------------------------------------------------------------------------------------


class _ColourScale:
    """Colour scale in equal steps from 0, in a unit with a prefix such as MPa.

    Attributes
    ----------
    unit_factor : float
        Factor from the SI unit to the unit with a prefix.
    label : str
        Name and unit of the field.
    level_borders : (n_colour_steps + 1,)
        Values between which a colour is constant, in the unit with a prefix.
    n_colour_steps : int
        Number of steps.
    has_values_beyond_levels : bool
        True if a value exceeds the last level.
    colour_map : ListedColormap
        One colour for each step.
    """

    def __init__(self, fields: PeriodFields) -> None:
        field_name, unit = fields.colour_field_name_and_unit
        scale_end, largest_field_value = fields.colour_scale_end, fields.colour_values.max()
        self.unit_factor, unit = choose_factor_and_prefixed_unit(scale_end, unit)
        self.label = f"{field_name} [{unit}]"
        self.level_borders = MaxNLocator(16, steps=[1, 2, 2.5, 5, 10]).tick_values(
            0.0, self.unit_factor * scale_end
        )
        self.n_colour_steps = len(self.level_borders) - 1
        self.has_values_beyond_levels = bool(
            self.unit_factor * largest_field_value > self.level_borders[-1]
        )
        self.colour_map = ListedColormap(
            colormaps["viridis"](np.linspace(0.0, 1.0, self.n_colour_steps))
        )


class _MovingMesh:
    """Plate or solid in a VTK picture, which moves from frame to frame.

    Attributes
    ----------
    line_height_above_plate : float [m]
        Distance of lines above a plate, so that the surface does not hide the lines.
    surface, moving_edge_lines, contact_dots, load_arrow
        Moving objects, as pyvista's PolyData.
    unit_arrow_points : (n, 3)
        Points of an arrow of unit length along x.
    dot_and_arrow_viewer_shift : (3,) [m]
        Shift of contact dots and load arrow towards the viewer of a plate; 0 in a solid.
    arrow_starts, arrow_vectors : (n_frames, d) [m]
        Start and vector of the load arrow in each frame.
    """

    def __init__(self, plotter: Any, fields: PeriodFields, colour_scale: _ColourScale) -> None:
        self.plotter, self.fields, self.colour_scale = plotter, fields, colour_scale
        mesh = fields.mesh
        self.line_height_above_plate = 1e-3 * mesh.size
        is_solid = mesh.dimension == 3
        boundary_edges = (
            vtk.find_node_pairs_of_sharp_edges(mesh) if is_solid else mesh.boundary_sides
        )
        self._draw_edges(boundary_edges, "rest", 2)
        self.surface = vtk.make_surface(
            mesh.points, mesh.boundary_sides if is_solid else mesh.triangles
        )
        self.surface["shown"] = colour_scale.unit_factor * fields.colour_values[0]
        plotter.add_mesh(
            self.surface, scalars="shown", cmap=colour_scale.colour_map,
            clim=colour_scale.level_borders[[0, -1]], n_colors=colour_scale.n_colour_steps,
            interpolate_before_map=True, show_scalar_bar=False, **UNSHADED_MESH_OPTIONS,
        )  # fmt: skip
        self.moving_edge_lines = [self._draw_edges(boundary_edges, "lips", 2)]
        if not is_solid:  # sharp edges of a solid include the mouth
            self.moving_edge_lines.append(self._draw_edges(mesh.crack_face_sides, "lips", 5))
        self._draw_edges(boundary_edges[mesh.is_clamped[boundary_edges].all(axis=1)], "rest", 9)
        self.contact_dots = vtk.import_pyvista().PolyData(np.zeros((len(fields.pair_areas), 3)))
        if len(fields.pair_areas):
            plotter.add_mesh(
                self.contact_dots,
                color=ANIMATED_PART_COLOUR_BY_NAME["contact"],
                point_size=16,
                render_points_as_spheres=True,
                **UNSHADED_MESH_OPTIONS,
            )
        self.load_arrow = vtk.import_pyvista().Arrow(
            tip_length=0.45, tip_radius=0.16, shaft_radius=0.055
        )
        self.unit_arrow_points = self.load_arrow.points.copy()
        self.dot_and_arrow_viewer_shift = np.array(
            [0.0, 0.0, 0.0 if is_solid else 2.0 * self.line_height_above_plate]
        )
        self.arrow_starts, self.arrow_vectors = _find_arrow_starts_and_vectors(fields)
        if fields.has_load_arrow:
            plotter.add_mesh(
                self.load_arrow, color=ANIMATED_PART_COLOUR_BY_NAME["load"], **UNSHADED_MESH_OPTIONS
            )
        self._move_to_frame(0)

    def _draw_edges(self, edges: np.ndarray, part_name: str, line_width: float) -> Any:
        """Add lines along edges at rest to the picture, and return the lines as PolyData.

        Parameters
        ----------
        edges : (m, k) int
            Indices of k nodes along each edge.
        part_name : str
            Key of ``ANIMATED_PART_COLOUR_BY_NAME``, for the colour.
        line_width : float
            Line width.
        """
        edge_lines = vtk.make_lines(self._lift_above_plate(self.fields.mesh.points), edges)
        if len(edges):
            self.plotter.add_mesh(
                edge_lines,
                color=ANIMATED_PART_COLOUR_BY_NAME[part_name],
                line_width=line_width,
                **UNSHADED_MESH_OPTIONS,
            )
        return edge_lines

    def _lift_above_plate(self, points: np.ndarray) -> np.ndarray:
        """Return a plate's points in space: (n, 3) [m], z is ``line_height_above_plate``.

        Points of a solid (n, 3) are returned unchanged.
        """
        return vtk.pad_to_space(points) + (points.shape[1] == 2) * np.array(
            [0.0, 0.0, self.line_height_above_plate]
        )

    def render_frame_image(self, frame_index: int) -> Image.Image:
        """Return the image of the structure in a frame, in twice the final resolution."""
        self._move_to_frame(frame_index)
        self.plotter.render()
        return Image.fromarray(self.plotter.screenshot(None, return_img=True))

    def _move_to_frame(self, frame_index: int) -> None:
        """Move surface, lines, contact dots and load arrow to their positions in a frame.

        Surface colours change, too. Only closed pairs have dots.
        """
        fields = self.fields
        magnified_points = fields.magnified_points[frame_index]
        self.surface.points = vtk.pad_to_space(magnified_points)
        for edge_lines in self.moving_edge_lines:
            edge_lines.points = self._lift_above_plate(magnified_points)
        self.surface["shown"] = self.colour_scale.unit_factor * fields.colour_values[frame_index]
        pair_average_matrix = (
            fields.nodal_force_per_pair_force / fields.nodal_force_per_pair_force.sum(axis=0)
        ).T
        self.contact_dots.points = (
            vtk.pad_to_space(pair_average_matrix @ magnified_points)
            + self.dot_and_arrow_viewer_shift
        )
        self.contact_dots.verts = np.insert(
            np.argwhere(fields.contact_forces[frame_index] > 0.0), 0, 1, axis=1
        ).ravel()
        arrow_start, load_arrow_vector = (
            vtk.pad_to_space(arrow_starts_or_vectors[frame_index][None])[0]
            for arrow_starts_or_vectors in (self.arrow_starts, self.arrow_vectors)
        )
        _, arrow_length, arrow_basis_vectors = np.linalg.svd(load_arrow_vector[None])
        arrow_basis_vectors[0] *= np.sign(arrow_basis_vectors[0] @ load_arrow_vector)
        self.load_arrow.points = (
            arrow_start
            + self.dot_and_arrow_viewer_shift
            + arrow_length * (self.unit_arrow_points @ arrow_basis_vectors)
        )


def _find_arrow_starts_and_vectors(fields: PeriodFields) -> tuple[np.ndarray, np.ndarray]:
    """Return start and vector of the load arrow in each frame: (n_frames, d) [m] each.

    The arrow shows the total load. The start is the mean position of the displaced nodes, weighted
    by the nodes' loads in the period. The longest arrow has an eighth of the structure's size. Both
    arrays are zero if the total load is zero.
    """
    total_loads = fields.nodal_loads.sum(axis=1)
    arrow_start_node_weights = np.abs(fields.nodal_loads).sum(axis=(0, 2))
    largest_total_load = np.linalg.norm(total_loads, axis=1).max()
    if largest_total_load == 0.0:
        return np.zeros_like(total_loads), np.zeros_like(total_loads)
    return (
        arrow_start_node_weights @ fields.magnified_points / arrow_start_node_weights.sum(),
        fields.mesh.size / 8.0 * total_loads / largest_total_load,
    )


# --- the animation --------------------------------------------------------------------------------


def _write_gif(solution: PeriodicSolution, fields: PeriodFields, path: Path) -> None:
    """Draw all frames and write a GIF of about 3 s, repeated without end."""
    colour_scale = _ColourScale(fields)
    frame_layout = _GifFrameLayout(solution, fields, colour_scale)
    plate_image_width, plate_image_height = frame_layout.plate_size
    plotter = vtk.off_screen_plotter(
        (2 * plate_image_width, 2 * plate_image_height)
    )  # smooth after halving
    plotter.render_window.SetMultiSamples(0)  # multisampling is three times slower
    moving_mesh = _MovingMesh(plotter, fields, colour_scale)
    plate_width_fraction = (
        _fit_camera_and_find_width_ratio(plotter, fields) * plate_image_height / plate_image_width
    )
    plotter.window_size = (
        min(2 * plate_image_width, int(2 * (plate_width_fraction * plate_image_width + 20))),
        2 * plate_image_height,
    )
    frame_images = [
        frame_layout.compose_frame_image(frame_index, moving_mesh.render_frame_image(frame_index))
        for frame_index in range(len(fields.time))
    ]
    plotter.close()
    palette_image = _make_palette_image(colour_scale)
    quantized_frame_images = [
        frame_image.quantize(palette=palette_image, dither=Image.Dither.NONE)
        for frame_image in frame_images
    ]
    gif_stream = BytesIO()
    quantized_frame_images[0].save(
        gif_stream,
        "GIF",
        optimize=False,
        save_all=True,
        append_images=quantized_frame_images[1:],
        duration=max(20, 10 * round(300.0 / len(frame_images))),  # in steps of 10 ms, 3 s in all
        loop=0,
        comment=frame_layout.caption_text_without_phase.encode("latin-1"),
    )
    write_file_whole(path, gif_stream.getvalue())


def _make_palette_image(colour_scale: _ColourScale) -> Image.Image:
    """Return a palette image with at most 256 colours, for all frames of the GIF.

    The colours are greys, the drawn colours, and blends of these with black and white.
    """
    part_colours = [*ANIMATED_PART_COLOUR_BY_NAME.values(), CURVE_COLOUR_CODE_BY_NAME["blue"]]
    colour_array = to_rgba_array(
        [*part_colours, CONTACT_BACKGROUND_COLOUR, *colour_scale.colour_map.colors]
    )[:, :3]
    black_and_white_blends = [
        colour_weight * colour_array + (1.0 - colour_weight) * blend_grey_level
        for colour_weight in (0.75, 0.5, 0.25)
        for blend_grey_level in (0.0, 1.0)
    ]
    greys = np.repeat(np.linspace(0.0, 1.0, 17)[:, None], 3, axis=1)
    palette_colours = np.concatenate([greys, colour_array, *black_and_white_blends])[:256]
    palette_image = Image.new("P", (1, 1))
    palette_image.putpalette(np.round(255.0 * palette_colours).astype(np.uint8).tobytes())
    return palette_image


def _fit_camera_and_find_width_ratio(plotter: Any, fields: PeriodFields) -> float:
    """Fit the camera to the structure's motion in the whole period.

    A plate is seen from the front, so that all points drawn in the period are visible. A solid is
    seen from a corner.

    Returns
    -------
    float
        Width needed for the structure, divided by the picture's height. For a solid the width is
        the whole picture's.
    """
    width, height = plotter.window_size
    plotter.camera_set = True
    if fields.mesh.dimension == 3:
        vtk.look_from_corner(plotter.renderer, fields.mesh.points)
        return float(width / height)
    arrow_heads = (
        np.add(*_find_arrow_starts_and_vectors(fields))
        if fields.has_load_arrow
        else np.empty((0, 2))
    )
    drawn_points = np.concatenate([fields.mesh.points, *fields.magnified_points, arrow_heads])
    lower_corner, upper_corner = drawn_points.min(axis=0), drawn_points.max(axis=0)
    mesh_size, camera = fields.mesh.size, vtk.set_parallel_camera(plotter.renderer)
    view_center = 0.5 * (lower_corner + upper_corner)
    plate_width, plate_height = upper_corner - lower_corner
    view_height = 1.03 * max(plate_height, plate_width * height / width)
    camera.SetFocalPoint(*view_center, 0.0)
    camera.SetPosition(*view_center, 10.0 * mesh_size)
    camera.SetParallelScale(0.5 * view_height)
    camera.SetClippingRange(mesh_size, 20.0 * mesh_size)
    return float(plate_width / view_height)


def _draw_colour_bar(figure: Figure, colour_scale: _ColourScale) -> None:
    """Draw the colour bar beside the structure; an arrow at the end shows values beyond."""
    mappable = ScalarMappable(
        BoundaryNorm(colour_scale.level_borders, colour_scale.n_colour_steps),
        colour_scale.colour_map,
    )
    bar_axes = figure.add_axes((0.845, 0.32, 0.03, 0.49))
    colour_bar = figure.colorbar(
        mappable,
        cax=bar_axes,
        ticks=colour_scale.level_borders[::2],
        extend="max" if colour_scale.has_values_beyond_levels else "neither",
        spacing="proportional",
    )
    colour_bar.set_label(colour_scale.label, fontsize=12)
    colour_bar.ax.tick_params(labelsize=11)


class _GifFrameLayout:
    """Page of an animation: caption, legend, colour bar, and a curve with a moving dot.

    Attributes
    ----------
    frame_times_in_load_periods, frame_values : (n_frames,)
        Position of the dot in each frame: time in load periods, and opening or displacement [m].
    plate_size, plate_corner : (int, int)
        Width and height of the structure's image, and left and top edge of this image [pixels].
    caption_text_without_phase : str
        Caption with frequency and magnification, without the frame's phase.
    caption_artist, time_line, wave_dot
        Matplotlib's artists that change from frame to frame.
    background_pixels
        Pixels of everything that does not change.
    """

    def __init__(
        self, solution: PeriodicSolution, fields: PeriodFields, colour_scale: _ColourScale
    ) -> None:
        self.frame_times_in_load_periods = fields.time * solution.omega / (2.0 * np.pi)
        self.plate_size, self.plate_corner = (532, 444), (6, 92)
        self.figure = Figure(figsize=(6.4, 7.4), dpi=100, facecolor="white")
        self.agg_canvas = FigureCanvasAgg(self.figure)
        title = "Breathing crack" if fields.has_cracks else "Vibrating structure"
        self.figure.text(0.5, 0.968, title, fontsize=16, weight="bold", ha="center", va="center")
        load_or_motion_word = "load" if fields.has_load_arrow else "motion"
        frequency_text = f"{solution.omega:.5g} rad/s ({solution.omega / (2.0 * np.pi):.4g} Hz)"
        magnification_text = f"{float(f'{fields.magnification:.3g}'):.10g}"
        self.caption_text_without_phase = (
            f"{load_or_motion_word} at {frequency_text}, displacement × {magnification_text}"
        )
        self.caption_artist = self.figure.text(
            0.06, 0.932, "", va="center", fontsize=12, animated=True
        )
        _draw_colour_bar(self.figure, colour_scale)
        self._draw_legend_of_parts(fields)
        self._draw_displacement_curve(solution, fields)
        self.agg_canvas.draw()
        self.background_pixels = self.agg_canvas.copy_from_bbox(self.figure.bbox)

    def compose_frame_image(self, frame_index: int, plate_image: Image.Image) -> Image.Image:
        """Return the image for a frame: page and structure.

        Parameters
        ----------
        frame_index : int
            Index of the frame, from 0.
        plate_image : Image
            Structure's image from ``_MovingMesh.render_frame_image``, which is pasted in half its
            size.
        """
        self.agg_canvas.restore_region(self.background_pixels)
        frame_time_in_load_periods = self.frame_times_in_load_periods[frame_index]
        self.wave_dot.set_data([frame_time_in_load_periods], [self.frame_values[frame_index]])
        self.time_line.set_xdata([frame_time_in_load_periods, frame_time_in_load_periods])
        self.caption_artist.set_text(
            f"{self.caption_text_without_phase}, phase {360.0 * frame_time_in_load_periods:.0f}°"
        )
        for artist in (self.time_line, self.wave_dot, self.caption_artist):
            self.figure.draw_artist(artist)
        page_image = copy_canvas_image(self.agg_canvas)
        plate_image = plate_image.reduce(2)
        plate_left_pixel, plate_top_pixel = self.plate_corner
        page_image.paste(
            plate_image,
            (plate_left_pixel + (self.plate_size[0] - plate_image.width) // 2, plate_top_pixel),
        )
        return page_image

    def _draw_legend_of_parts(self, fields: PeriodFields) -> None:
        """Draw the legend, with entries for what the structure has: clamp, load, crack faces."""
        legend_rows = (
            ("at rest", True, "rest", 1.5, None),
            ("clamped", fields.mesh.is_clamped.any(), "rest", 6, None),
            ("load", fields.has_load_arrow, "load", 3, ">"),
            ("crack faces", fields.has_cracks and fields.mesh.dimension == 2, "lips", 3, None),
            ("in contact", len(fields.pair_areas), "contact", 0, "o"),
        )
        legend_lines = [
            Line2D(
                [],
                [],
                label=label,
                color=ANIMATED_PART_COLOUR_BY_NAME[part_name],
                lw=line_width,
                marker=marker,
                ms=8,
            )
            for label, is_shown, part_name, line_width, marker in legend_rows
            if is_shown
        ]
        self.figure.legend(
            handles=legend_lines,
            ncol=5,
            fontsize=11,
            loc="center",
            bbox_to_anchor=(0.5, 0.893),
            handletextpad=0.5,
            columnspacing=1.5,
            frameon=False,
        )

    def _draw_displacement_curve(self, solution: PeriodicSolution, fields: PeriodFields) -> None:
        """Draw the opening over a period; without a crack, draw the largest displacement.

        Set ``frame_values``, too, and make the moving dot and the vertical time line.
        """
        axes = self.figure.add_axes((0.16, 0.085, 0.81, 0.16))
        time = np.linspace(0.0, solution.period, 401)
        times_in_load_periods, is_closed = (
            time * solution.omega / (2.0 * np.pi),
            np.zeros(len(time), bool),
        )
        if len(fields.pair_areas):
            gaps, watched_pair_indices = (
                solution.gap(time),
                solution.structure.watched_pairs.values(),
            )
            pair_index = max(watched_pair_indices, key=lambda pair: float(np.ptp(gaps[:, pair])))
            quantity = f"opening {solution.structure.describe_pair(pair_index)}"
            curve_values = -gaps[:, pair_index]
            self.frame_values = -solution.gap(fields.time)[:, pair_index]
            pair_crack_indices = solution.structure.pairs.cracks
            assert pair_crack_indices is not None  # a mesh has them
            is_same_crack = pair_crack_indices == pair_crack_indices[pair_index]
            is_closed = (solution.contact_force(time)[:, is_same_crack] > 0.0).any(axis=1)
        else:
            self.frame_values = np.linalg.norm(fields.displacement, axis=2).max(axis=1)
            quantity = "largest displacement"
            curve_values = np.interp(
                times_in_load_periods,
                self.frame_times_in_load_periods,
                self.frame_values,
                period=times_in_load_periods[-1],
            )
        axes.axhline(0.0, color=CURVE_COLOUR_CODE_BY_NAME["grey"], lw=0.8)
        axes.plot(
            times_in_load_periods, curve_values, color=CURVE_COLOUR_CODE_BY_NAME["blue"], lw=2
        )
        self.time_line = axes.axvline(
            0.0, color=CURVE_COLOUR_CODE_BY_NAME["grey"], lw=1, animated=True
        )
        (self.wave_dot,) = axes.plot(
            [0.0], [0.0], "o", color="black", ms=8, clip_on=False, animated=True
        )
        axes.margins(y=0.12)
        axes.set(xlim=(0.0, times_in_load_periods[-1]), ylim=axes.get_ylim())
        axes.set_xlabel("time / load period", fontsize=12)
        label_axis(axes.yaxis, quantity, "m")
        axes.yaxis.label.set(size=11, text=fill(axes.yaxis.label.get_text(), 17))
        axes.yaxis.set_label_coords(-0.085, 0.5)
        axes.tick_params(labelsize=11)
        # Draw the bands after label_axis, which would count them as data of the axis.
        axes.fill_between(
            times_in_load_periods,
            0.0,
            1.0,
            where=is_closed,
            transform=axes.get_xaxis_transform(),
            color=CONTACT_BACKGROUND_COLOUR,
            lw=0,
        )
