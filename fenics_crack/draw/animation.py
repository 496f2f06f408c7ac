"""The breathing crack in motion: a GIF.

The plate is drawn magnified and coloured by von Mises stress or displacement, with the crack faces
as thick lines, a dot on every pair that is in contact, and an arrow for the load. Everything is
gathered first; rank 0 draws.
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
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import write_whole
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import readable
from fenics_crack.draw import vtk
from fenics_crack.draw.figure import COLOURS, copy_canvas_image, label_axis
from fenics_crack.draw.vtk import PeriodFields
from fenics_crack.scene.tables import Material

TINT = "#f5d6c1"
"""Background of the motion while the crack faces touch: light orange."""
FLAT: dict[str, Any] = {"lighting": False, "reset_camera": False, "render": False}
INK = {"lips": "#000000", "contact": COLOURS["orange"], "load": COLOURS["pink"], "rest": "#8a8a8a"}


def animate_period(
    solution: PeriodicSolution,
    path: str | Path,
    *,
    frames: int = 36,
    magnification: float | None = None,
    material: Material | None = None,
) -> float:
    """Draw one period of a vibration as an animated picture (collective).

    Below the plate is the opening of the crack's mouth over time, of several cracks of the one that
    moves most, tinted while that one's crack faces touch; without a crack the largest displacement.
    The caption and the comment of the file state the magnification.

    Parameters
    ----------
    solution : PeriodicSolution
        Result to show.
    path : str or Path
        A .gif file.
    frames, magnification, material
        As of :func:`fenics_crack.write_period`; without a material the colours show displacement.

    Returns
    -------
    float
        The magnification.

    Raises
    ------
    InputError
        The file is no .gif, the structure has no mesh, or an argument cannot be used.

    Examples
    --------
    >>> magnification = fc.animate_period(solution, "crack.gif", frames=4)
    """
    if Path(path).suffix.lower() != ".gif":
        raise InputError("path", str(path), "a .gif file")
    begin(Path(path).name)
    fields = PeriodFields(solution, frames, magnification, material)
    on_root(fields.mesh.structure.comm, lambda: _write(solution, fields, Path(path)))
    return fields.magnification


# --- the plate ------------------------------------------------------------------------------------


class _Colours:
    """Colours in steps from 0 to the end of the scale, in a unit with a prefix."""

    def __init__(self, fields: PeriodFields) -> None:
        name, unit = fields.colour_name_and_unit
        end, highest = fields.colour_scale_end, fields.colour_values.max()
        self.factor, unit = readable(end, unit)
        self.label = f"{name} [{unit}]"
        self.levels = MaxNLocator(16, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, self.factor * end)
        self.steps = len(self.levels) - 1
        self.beyond = bool(self.factor * highest > self.levels[-1])
        self.map = ListedColormap(colormaps["viridis"](np.linspace(0.0, 1.0, self.steps)))


class _Plate:
    """The plate in a picture: what moves from frame to frame are the points of its parts."""

    def __init__(self, plotter: Any, fields: PeriodFields, colours: _Colours) -> None:
        self.plotter, self.fields, self.colours, mesh = plotter, fields, colours, fields.mesh
        self.height = 1e-3 * mesh.size  # of lines above the plate
        solid = mesh.dimension == 3
        boundary = vtk.find_sharp_edges(mesh) if solid else mesh.boundary
        self._line(boundary, "rest", 2)
        self.surface = vtk.make_surface(mesh.points, mesh.boundary if solid else mesh.triangles)
        self.surface["shown"] = colours.factor * fields.colour_values[0]
        plotter.add_mesh(
            self.surface, scalars="shown", cmap=colours.map, clim=colours.levels[[0, -1]],
            n_colors=colours.steps, interpolate_before_map=True, show_scalar_bar=False, **FLAT,
        )  # fmt: skip
        self.lines = [self._line(boundary, "lips", 2)]
        if not solid:  # whose outline has the mouth
            self.lines.append(self._line(mesh.crack_faces, "lips", 5))
        self._line(boundary[mesh.is_clamped[boundary].all(axis=1)], "rest", 9)
        self.dots = vtk.import_pyvista().PolyData(np.zeros((len(fields.pair_areas), 3)))
        if len(fields.pair_areas):
            round_dots = {"point_size": 16, "render_points_as_spheres": True}
            plotter.add_mesh(self.dots, color=INK["contact"], **round_dots, **FLAT)
        self.arrow = vtk.import_pyvista().Arrow(
            tip_length=0.45, tip_radius=0.16, shaft_radius=0.055
        )
        self.unit_arrow = self.arrow.points.copy()
        self.room = np.array([0.0, 0.0, 0.0 if solid else 2.0 * self.height])
        self.starts, self.arrows = _load_arrows(fields)
        if fields.has_one_load:
            plotter.add_mesh(self.arrow, color=INK["load"], **FLAT)
        self._move(0)

    def _line(self, edges: np.ndarray, ink: str, width: float) -> Any:
        """Draw edges, and return them."""
        drawn = vtk.make_lines(self._above(self.fields.mesh.points), edges)
        if len(edges):
            self.plotter.add_mesh(drawn, color=INK[ink], line_width=width, **FLAT)
        return drawn

    def _above(self, points: np.ndarray) -> np.ndarray:
        """Lift points to where lines are drawn: above a plate."""
        return vtk.pad_to_space(points) + (points.shape[1] == 2) * np.array([0.0, 0.0, self.height])

    def image(self, frame: int) -> Image.Image:
        """The picture of a frame."""
        self._move(frame)
        self.plotter.render()
        return Image.fromarray(self.plotter.screenshot(None, return_img=True))

    def _move(self, frame: int) -> None:
        """Put all parts where they are in a frame."""
        fields = self.fields
        moved = fields.magnified_points[frame]
        self.surface.points = vtk.pad_to_space(moved)
        for part in self.lines:
            part.points = self._above(moved)
        self.surface["shown"] = self.colours.factor * fields.colour_values[frame]
        pairs = (fields.nodal_pair_forces / fields.nodal_pair_forces.sum(axis=0)).T
        self.dots.points = vtk.pad_to_space(pairs @ moved) + self.room
        self.dots.verts = np.insert(
            np.argwhere(fields.contact_forces[frame] > 0.0), 0, 1, axis=1
        ).ravel()
        start, arrow = (
            vtk.pad_to_space(part[frame][None])[0] for part in (self.starts, self.arrows)
        )
        _, size, axes = np.linalg.svd(arrow[None])
        axes[0] *= np.sign(axes[0] @ arrow)
        self.arrow.points = start + self.room + size * (self.unit_arrow @ axes)


def _load_arrows(fields: PeriodFields) -> tuple[np.ndarray, np.ndarray]:
    """Return points of the magnified plate with a load and the arrows there, both (n, d) [m].

    The longest arrow is an eighth of the plate.
    """
    total = fields.nodal_loads.sum(axis=1)
    share = np.abs(fields.nodal_loads).sum(axis=(0, 2))
    largest = np.linalg.norm(total, axis=1).max()
    if largest == 0.0:
        return np.zeros_like(total), np.zeros_like(total)
    return share @ fields.magnified_points / share.sum(), fields.mesh.size / 8.0 * total / largest


# --- the animation --------------------------------------------------------------------------------


def _write(solution: PeriodicSolution, fields: PeriodFields, path: Path) -> None:
    """Draw all frames and write the GIF."""
    colours = _Colours(fields)
    page = _Page(solution, fields, colours)
    width, height = page.size
    plotter = vtk.off_screen_plotter((2 * width, 2 * height))  # smooth once it is reduced
    plotter.render_window.SetMultiSamples(0)  # three times slower
    plate = _Plate(plotter, fields, colours)
    share = _look_at_all(plotter, fields) * height / width
    plotter.window_size = min(2 * width, int(2 * (share * width + 20))), 2 * height
    pictures = [page.draw(frame, plate.image(frame)) for frame in range(len(fields.time))]
    plotter.close()
    palette = _palette(colours)
    shown = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = max(20, 10 * round(300.0 / len(shown)))  # [ms], in steps of 10: 3 s in all
    timing = {"duration": duration, "loop": 0, "comment": page.caption.encode("latin-1")}
    animation, every = BytesIO(), {"save_all": True, "append_images": shown[1:]}
    shown[0].save(animation, "GIF", optimize=False, **every, **timing)
    write_whole(path, animation.getvalue())


def _palette(colours: _Colours) -> Image.Image:
    """The colours used, their blends with black and white, and greys."""
    used = [to_rgb(colour) for colour in (*INK.values(), COLOURS["blue"], TINT)]
    used += [tuple(row[:3]) for row in colours.map.colors]
    ink = np.array(used)
    shades = [w * ink + (1.0 - w) * other for w in (0.75, 0.5, 0.25) for other in (0.0, 1.0)]
    greys = np.repeat(np.linspace(0.0, 1.0, 17)[:, None], 3, axis=1)
    entries = np.concatenate([greys, ink, *shades])[:256]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255.0 * entries).astype(np.uint8).tobytes())
    return palette


def _look_at_all(plotter: Any, fields: PeriodFields) -> float:
    """Set the camera so that the plate stays in the picture for the whole period; return the width
    that it takes, relative to the height of the picture."""
    width, height = plotter.window_size
    plotter.camera_set = True
    if fields.mesh.dimension == 3:
        vtk.look_from_corner(plotter.renderer, fields.mesh.points)
        return float(width / height)
    heads = np.add(*_load_arrows(fields)) if fields.has_one_load else np.empty((0, 2))
    points = np.concatenate([fields.mesh.points, *fields.magnified_points, heads])
    low, high = points.min(axis=0), points.max(axis=0)
    size, camera = fields.mesh.size, vtk.set_parallel_camera(plotter.renderer)
    middle, (across, up) = 0.5 * (low + high), high - low
    seen = 1.03 * max(up, across * height / width)
    camera.SetFocalPoint(*middle, 0.0)
    camera.SetPosition(*middle, 10.0 * size)
    camera.SetParallelScale(0.5 * seen)
    camera.SetClippingRange(size, 20.0 * size)
    return float(across / seen)


def _draw_bar(figure: Figure, colours: _Colours) -> None:
    """Draw the colour bar beside the plate."""
    mapped = ScalarMappable(BoundaryNorm(colours.levels, colours.steps), colours.map)
    ends = {"extend": "max" if colours.beyond else "neither", "spacing": "proportional"}
    place = figure.add_axes((0.845, 0.32, 0.03, 0.49))
    bar = figure.colorbar(mapped, cax=place, ticks=colours.levels[::2], **ends)
    bar.set_label(colours.label, fontsize=12)
    bar.ax.tick_params(labelsize=11)


class _Page:
    """The page around the plate: caption, colours, and a wave with a moving dot."""

    def __init__(self, solution: PeriodicSolution, fields: PeriodFields, colours: _Colours) -> None:
        self.loads = fields.time * solution.omega / (2.0 * np.pi)
        self.size, self.corner = (532, 444), (6, 92)  # of the plate, and its place [pixels]
        self.figure = Figure(figsize=(6.4, 7.4), dpi=100, facecolor="white")
        self.canvas = FigureCanvasAgg(self.figure)
        title = "Breathing crack" if fields.has_cracks else "Vibrating structure"
        centred = {"ha": "center", "va": "center"}
        self.figure.text(0.5, 0.968, title, fontsize=16, weight="bold", **centred)
        moves = "load" if fields.has_one_load else "motion"
        load = f"{solution.omega:.5g} rad/s ({solution.omega / (2.0 * np.pi):.4g} Hz)"
        factor = f"{float(f'{fields.magnification:.3g}'):.10g}"
        self.caption = f"{moves} at {load}, displacement × {factor}"
        self.text = self.figure.text(0.06, 0.932, "", va="center", fontsize=12, animated=True)
        _draw_bar(self.figure, colours)
        self._legend(fields)
        self._wave(solution, fields)
        self.canvas.draw()
        self.still = self.canvas.copy_from_bbox(self.figure.bbox)

    def draw(self, frame: int, plate: Image.Image) -> Image.Image:
        """The page of a frame: what moves is drawn over the rest, which is drawn once."""
        self.canvas.restore_region(self.still)
        at = self.loads[frame]
        self.dot.set_data([at], [self.values[frame]])
        self.line.set_xdata([at, at])
        self.text.set_text(f"{self.caption}, phase {360.0 * at:.0f}°")
        for artist in (self.line, self.dot, self.text):
            self.figure.draw_artist(artist)
        page = copy_canvas_image(self.canvas)
        plate = plate.reduce(2)
        left, top = self.corner
        page.paste(plate, (left + (self.size[0] - plate.width) // 2, top))
        return page

    def _legend(self, fields: PeriodFields) -> None:
        lines = (
            ("at rest", True, "rest", 1.5, None),
            ("clamped", fields.mesh.is_clamped.any(), "rest", 6, None),
            ("load", fields.has_one_load, "load", 3, ">"),
            ("crack faces", fields.has_cracks and fields.mesh.dimension == 2, "lips", 3, None),
            ("in contact", len(fields.pair_areas), "contact", 0, "o"),
        )
        keys = [
            Line2D([], [], label=label, color=INK[ink], lw=width, marker=marker, ms=8)
            for label, shown, ink, width, marker in lines
            if shown
        ]
        spaces = {"handletextpad": 0.5, "columnspacing": 1.5, "frameon": False}
        centre = {"loc": "center", "bbox_to_anchor": (0.5, 0.893)}
        self.figure.legend(handles=keys, ncol=5, fontsize=11, **centre, **spaces)

    def _wave(self, solution: PeriodicSolution, fields: PeriodFields) -> None:
        axes = self.figure.add_axes((0.16, 0.085, 0.81, 0.16))
        time = np.linspace(0.0, solution.period, 401)
        loads, closed = time * solution.omega / (2.0 * np.pi), np.zeros(len(time), bool)
        if len(fields.pair_areas):
            gaps, watched = solution.gap(time), solution.structure.watched_pairs.values()
            pair = max(watched, key=lambda number: float(np.ptp(gaps[:, number])))
            quantity, wave = f"opening {solution.structure.describe_pair(pair)}", -gaps[:, pair]
            self.values = -solution.gap(fields.time)[:, pair]
            cracks = solution.structure.pairs.cracks
            assert cracks is not None  # of a mesh
            own = cracks == cracks[pair]
            closed = (solution.contact_force(time)[:, own] > 0.0).any(axis=1)
        else:
            self.values = np.linalg.norm(fields.displacement, axis=2).max(axis=1)
            quantity = "largest displacement"
            wave = np.interp(loads, self.loads, self.values, period=loads[-1])
        axes.axhline(0.0, color=COLOURS["grey"], lw=0.8)
        axes.plot(loads, wave, color=COLOURS["blue"], lw=2)
        moves = {"animated": True}
        self.line = axes.axvline(0.0, color=COLOURS["grey"], lw=1, **moves)
        dot = {"color": "black", "ms": 8, "clip_on": False, **moves}
        (self.dot,) = axes.plot([0.0], [0.0], "o", **dot)
        axes.margins(y=0.12)
        axes.set(xlim=(0.0, loads[-1]), ylim=axes.get_ylim())
        axes.set_xlabel("time / load period", fontsize=12)
        label_axis(axes.yaxis, quantity, "m")
        axes.yaxis.label.set(size=11, text=fill(axes.yaxis.label.get_text(), 17))
        axes.yaxis.set_label_coords(-0.085, 0.5)
        axes.tick_params(labelsize=11)
        whole = axes.get_xaxis_transform()  # which would count as data of the axis before
        axes.fill_between(loads, 0.0, 1.0, where=closed, transform=whole, color=TINT, lw=0)
