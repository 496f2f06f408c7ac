"""The breathing crack in motion: a GIF, or a window with a slider.

The plate is drawn magnified and coloured by von Mises stress or displacement, both lips as thick
lines, with a dot on every pair that is in contact and an arrow for the load. Everything is gathered
first; rank 0 draws.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image
from vtkmodules.vtkInteractionWidgets import vtkSliderRepresentation2D, vtkSliderWidget

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.draw.figure import COLOURS
from fenics_crack.draw.nodal import edge_lines, moved_grid, off_screen_plotter
from fenics_crack.draw.paraview import PeriodFields
from fenics_crack.errors import InputError
from fenics_crack.files.store import make_folder
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Material
from fenics_crack.table import readable

__all__ = ["animate_period", "show_period"]

SECONDS = 3.0
"""Of one period in an animation."""
TINT = "#f5d6c1"
"""Of the stretches of the wave in which the lips touch: thin orange."""
INK = {"lips": "#000000", "contact": COLOURS["orange"], "load": COLOURS["pink"], "rest": "#8a8a8a"}


def animate_period(
    solution: PeriodicSolution,
    path: str | Path,
    *,
    frames: int = 60,
    magnification: float | None = None,
    material: Material | None = None,
) -> float:
    """Draw one period of a vibration as an animated picture (collective).

    Below the plate runs the opening of the crack's mouth, or without a crack the largest
    displacement of the plate.

    Parameters
    ----------
    solution : PeriodicSolution
        What to show.
    path : str or Path
        A .gif file.
    frames, magnification, material
        As of :func:`fenics_crack.draw.paraview.write_period`; without a material the colours show
        the displacement.

    Returns
    -------
    float
        The magnification.

    Raises
    ------
    InputError
        The file is no .gif, the structure has no mesh, or an argument cannot be used.
    """
    if Path(path).suffix.lower() != ".gif":
        raise InputError("path", str(path), "a .gif file")
    fields = PeriodFields.of(solution, frames, magnification, material)
    on_root(fields.mesh.structure.comm, lambda: _write(solution, fields, Path(path)))
    return fields.magnification


def show_period(
    solution: PeriodicSolution,
    *,
    frames: int = 60,
    magnification: float | None = None,
    material: Material | None = None,
) -> None:
    """Show one period of a vibration in a window, with a slider for the time (collective).

    Returns when the window is closed. The arguments are those of :func:`animate_period`.

    Raises
    ------
    InputError
        There is no screen, the structure has no mesh, or an argument cannot be used.
    """
    fields = PeriodFields.of(solution, frames, magnification, material)

    def show() -> None:
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise InputError("screen", None, "there (DISPLAY is set), or use animate_period")
        plotter = pyvista.Plotter(title="fenics_crack", window_size=(900, 900))
        slider = _with_slider(plotter, solution, fields)
        plotter.show()
        del slider

    on_root(fields.mesh.structure.comm, show)


# --- the plate ------------------------------------------------------------------------------------


class _Colours:
    """Colours in steps from 0 to the end of the scale, in a unit that reads well."""

    def __init__(self, fields: PeriodFields) -> None:
        self.name, unit = fields.colour
        self.factor, self.unit = readable(fields.colour_end, unit)
        self.levels = MaxNLocator(16, steps=[1, 2, 2.5, 5, 10]).tick_values(
            0.0, self.factor * fields.colour_end
        )
        self.beyond = bool(self.factor * fields.colour_values.max() > self.levels[-1])
        self.map = ListedColormap(colormaps["viridis"](np.linspace(0.0, 1.0, self.steps)))

    @property
    def steps(self) -> int:
        """Number of colours."""
        return len(self.levels) - 1

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} [{self.unit}]"


class _Plate:
    """The plate in a plotter, to be moved from frame to frame."""

    def __init__(self, plotter: Any, fields: PeriodFields) -> None:
        self.fields, self.plotter = fields, plotter
        self.colours = _Colours(fields)
        mesh = fields.mesh
        self.height = 1e-3 * mesh.size  # of lines above the plate
        self.surface = self._surface(0)
        at_rest = edge_lines(mesh, mesh.boundary, height=self.height)
        plotter.background_color = "white"
        plotter.add_mesh(at_rest, color=INK["rest"], line_width=2, lighting=False)
        plotter.add_mesh(
            self.surface, scalars="shown", cmap=self.colours.map, n_colors=self.colours.steps,
            clim=(self.colours.levels[0], self.colours.levels[-1]), lighting=False,
            show_scalar_bar=False,
        )  # fmt: skip
        self.lines = []
        for edges, width in ((mesh.boundary, 2), (mesh.lips, 5)):
            if len(edges):
                line = edge_lines(mesh, edges, height=self.height)
                self.lines.append((edges, line))
                plotter.add_mesh(line, color=INK["lips"], line_width=width, lighting=False)
        clamped = mesh.boundary[mesh.clamped[mesh.boundary].all(axis=1)]
        if len(clamped):
            held = edge_lines(mesh, clamped, height=self.height)
            plotter.add_mesh(held, color=INK["rest"], line_width=9, lighting=False)
        plotter.view_xy()
        plotter.enable_parallel_projection()

    def move(self, frame: int) -> None:
        """Show another frame."""
        displacement = self.fields.magnification * self.fields.displacement[frame]
        self.surface.copy_from(self._surface(frame))
        for edges, line in self.lines:
            line.copy_from(edge_lines(self.fields.mesh, edges, displacement, self.height))
        closed = np.flatnonzero(self.fields.force[frame] > 0.0)
        self.plotter.remove_actor(("contact", "load"), render=False)
        if len(closed):
            nodes = self.fields.pair_nodes[:, closed]
            middle = nodes.T @ (self.fields.mesh.points + displacement) / nodes.sum(axis=0)[:, None]
            self.plotter.add_points(
                np.pad(middle, ((0, 0), (0, 1)), constant_values=2.0 * self.height),
                color=INK["contact"], point_size=16, render_points_as_spheres=True, lighting=False,
                name="contact", reset_camera=False, render=False,
            )  # fmt: skip
        start, arrow = _load_arrow(self.fields, frame)
        if np.any(arrow):
            head = pyvista.Arrow(
                start=(*start, 2.0 * self.height), direction=(*arrow, 0.0), scale="auto",
                tip_length=0.45, tip_radius=0.16, shaft_radius=0.055,
            )  # fmt: skip
            self.plotter.add_mesh(
                head, color=INK["load"], lighting=False, name="load", reset_camera=False,
                render=False,
            )  # fmt: skip

    def _surface(self, frame: int) -> Any:
        grid = moved_grid(
            self.fields.mesh, self.fields.magnification * self.fields.displacement[frame]
        )
        grid["shown"] = self.colours.factor * self.fields.colour_values[frame]
        return grid.extract_surface(algorithm=None)


def _load_arrow(fields: PeriodFields, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the load acts on the magnified plate and an arrow along it, both (2,) [m].

    The arrow is an eighth of the plate long where the load is largest in the period.
    """
    total = fields.load.sum(axis=1)
    share = np.abs(fields.load).sum(axis=(0, 2))
    largest = np.linalg.norm(total, axis=1).max()
    if largest == 0.0:
        return np.zeros(2), np.zeros(2)
    places = fields.mesh.points + fields.magnification * fields.displacement[frame]
    return share @ places / share.sum(), fields.mesh.size / 8.0 * total[frame] / largest


def _with_slider(plotter: Any, solution: PeriodicSolution, fields: PeriodFields) -> Any:
    """Put the plate, its colours and the slider into a window; return the slider, to be kept.

    VTK writes no number here: the regular expressions with which its newer versions read a format
    end the program where DOLFINx was loaded first, as each brings its own part of libstdc++.
    """
    plate = _Plate(plotter, fields)
    figure = Figure(facecolor="white")
    _draw_bar(figure, (0.1, 0.05, 0.2, 0.87), plate.colours)
    chart = pyvista.ChartMPL(figure, size=(0.14, 0.6), loc=(0.85, 0.25))
    chart.border_color = "white"
    plotter.add_chart(chart)
    count, caption = len(fields.time), _caption(solution, fields)

    def turn(loads: float) -> None:
        frame = round(loads / solution.subharmonic * count) % count
        plate.move(frame)
        at = solution.subharmonic * frame / count
        plotter.add_text(
            f"{caption}\ntime {at:.3f} load periods", font_size=11, color="black", name="caption",
            render=False,
        )  # fmt: skip

    slider = vtkSliderRepresentation2D()
    slider.SetMinimumValue(0.0)
    slider.SetMaximumValue(float(solution.subharmonic))
    slider.SetValue(0.0)
    slider.SetTitleText("time / load period")
    slider.GetTitleProperty().SetColor(0.0, 0.0, 0.0)
    slider.GetTitleProperty().ShadowOff()
    slider.GetTubeProperty().SetColor(to_rgb(INK["rest"]))
    slider.GetCapProperty().SetColor(to_rgb(INK["rest"]))
    slider.GetSliderProperty().SetColor(to_rgb(COLOURS["blue"]))
    slider.GetSelectedProperty().SetColor(to_rgb(COLOURS["orange"]))
    slider.SetTubeWidth(0.005)
    slider.SetSliderWidth(0.03)
    slider.SetSliderLength(0.02)
    slider.ShowSliderLabelOff()
    for place, x in ((slider.GetPoint1Coordinate(), 0.1), (slider.GetPoint2Coordinate(), 0.8)):
        place.SetCoordinateSystemToNormalizedViewport()
        place.SetValue(x, 0.09)
    widget = vtkSliderWidget()
    widget.SetInteractor(plotter.iren.interactor)
    widget.SetRepresentation(slider)
    widget.SetAnimationModeToJump()
    widget.AddObserver("InteractionEvent", lambda *_: turn(slider.GetValue()))
    widget.SetEnabled(True)
    turn(0.0)
    _look_at_all(plotter, fields, room=1.35)
    return widget


def _caption(solution: PeriodicSolution, fields: PeriodFields) -> str:
    hertz = solution.omega / (2.0 * np.pi)
    moves = "load" if np.any(fields.load) else "motion"
    return (
        f"{moves} at {solution.omega:.5g} rad/s ({hertz:.4g} Hz), "
        f"displacement × {float(f'{fields.magnification:.3g}'):.10g}"
    )


# --- the animation --------------------------------------------------------------------------------


def _write(solution: PeriodicSolution, fields: PeriodFields, path: Path) -> None:
    """Draw every frame and write the GIF."""
    plotter = off_screen_plotter(window_size=(1200, 1040))
    plate = _Plate(plotter, fields)
    _look_at_all(plotter, fields)
    page = _Page(solution, fields, plate.colours)
    pictures = []
    for frame in range(len(fields.time)):
        plate.move(frame)
        plotter.render()
        pictures.append(page.draw(frame, plotter.screenshot(None, return_img=True)))
    plotter.close()
    palette = _palette(plate.colours)
    shown = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    make_folder(path)
    shown[0].save(
        path,
        save_all=True,
        append_images=shown[1:],
        loop=0,
        duration=max(20, 10 * round(100.0 * SECONDS / len(shown))),  # [ms], in hundredths of 1 s
        optimize=False,
    )


def _palette(colours: _Colours) -> Image.Image:
    """The colours used, and what smoothed edges make of them with black, white and each other."""
    used = [to_rgb(colour) for colour in (*INK.values(), COLOURS["blue"], TINT)]
    used += [tuple(row[:3]) for row in colours.map.colors]
    ink = np.array(used)
    shades = [
        weight * ink + (1.0 - weight) * other
        for weight in (0.75, 0.5, 0.25)
        for other in (0.0, 1.0)
    ]
    greys = np.repeat(np.linspace(0.0, 1.0, 17)[:, None], 3, axis=1)
    entries = np.concatenate([greys, ink, *shades])[:256]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255.0 * entries).astype(np.uint8).tobytes())
    return palette


def _look_at_all(plotter: Any, fields: PeriodFields, room: float = 1.03) -> None:
    """Set the camera so that the plate stays in the picture for the whole period, with room."""
    moved = fields.mesh.points + fields.magnification * fields.displacement
    every = [fields.mesh.points, *moved]
    if np.any(fields.load):
        frames = range(len(fields.time))
        every.append(np.array([np.sum(_load_arrow(fields, frame), axis=0) for frame in frames]))
    low, high = np.min(np.concatenate(every), axis=0), np.max(np.concatenate(every), axis=0)
    width, height = plotter.window_size
    half = 0.5 * max(high[1] - low[1], (high[0] - low[0]) * height / width)
    middle = 0.5 * (low + high)
    plotter.camera.focal_point = (*middle, 0.0)
    plotter.camera.position = (*middle, 10.0 * fields.mesh.size)
    plotter.camera.parallel_scale = room * half
    plotter.camera.clipping_range = (1.0 * fields.mesh.size, 20.0 * fields.mesh.size)


def _draw_bar(figure: Figure, place: tuple[float, float, float, float], colours: _Colours) -> None:
    """Draw the colours' bar at a place in a figure."""
    norm = BoundaryNorm(colours.levels, colours.steps)
    bar = figure.colorbar(
        ScalarMappable(norm, colours.map), cax=figure.add_axes(place), ticks=colours.levels[::2],
        extend="max" if colours.beyond else "neither", spacing="proportional",
    )  # fmt: skip
    bar.set_label(colours.label, fontsize=12)
    bar.ax.tick_params(labelsize=11)


class _Page:
    """The page around the plate: caption, colours, and a wave with a moving dot."""

    def __init__(self, solution: PeriodicSolution, fields: PeriodFields, colours: _Colours) -> None:
        self.loads = fields.time * solution.omega / (2.0 * np.pi)
        self.figure = Figure(figsize=(6.4, 7.4), dpi=100, facecolor="white")
        self.canvas = FigureCanvasAgg(self.figure)
        self.figure.text(
            0.5, 0.968, "Breathing crack" if len(fields.mesh.lips) else "Vibrating plate",
            ha="center", va="center", fontsize=16, weight="bold",
        )  # fmt: skip
        self.caption = _caption(solution, fields)
        self.text = self.figure.text(0.06, 0.932, "", va="center", fontsize=12)
        self.plate = self.figure.add_axes((0.01, 0.275, 0.83, 0.60))
        self.plate.axis("off")
        self.image: Any = None
        _draw_bar(self.figure, (0.845, 0.32, 0.03, 0.49), colours)
        self._legend(fields)
        self._wave(solution, fields)

    def draw(self, frame: int, plate: np.ndarray) -> Image.Image:
        """The page of a frame."""
        if self.image is None:
            self.image = self.plate.imshow(plate, interpolation="antialiased")
        self.image.set_data(plate)
        at = self.loads[frame]
        self.dot.set_data([at], [self.values[frame]])
        self.line.set_xdata([at, at])
        self.text.set_text(f"{self.caption}, phase {360.0 * at:.0f}°")
        self.canvas.draw()
        return Image.fromarray(np.asarray(self.canvas.buffer_rgba())[..., :3].copy())

    def _legend(self, fields: PeriodFields) -> None:
        keys = [Line2D([], [], color=INK["rest"], lw=1.5, label="at rest")]
        if fields.mesh.clamped.any():
            keys.append(Line2D([], [], color=INK["rest"], lw=6, label="clamped"))
        if np.any(fields.load):
            keys.append(Line2D([], [], color=INK["load"], marker=">", ms=8, lw=3, label="load"))
        if len(fields.mesh.lips):
            keys.append(Line2D([], [], color=INK["lips"], lw=3, label="lips"))
        if len(fields.areas):
            keys.append(
                Line2D([], [], color=INK["contact"], marker="o", lw=0, label="lips in contact")
            )
        self.figure.legend(
            handles=keys, loc="center", bbox_to_anchor=(0.5, 0.893), ncol=5, fontsize=11,
            frameon=False, handletextpad=0.5, columnspacing=1.5,
        )  # fmt: skip

    def _wave(self, solution: PeriodicSolution, fields: PeriodFields) -> None:
        axes = self.figure.add_axes((0.15, 0.085, 0.82, 0.16))
        time = np.linspace(0.0, solution.period, 401)
        loads = time * solution.omega / (2.0 * np.pi)
        if len(fields.areas):
            quantity, wave = "opening at\nthe mouth", -solution.gap(time)[:, 0]
            self.values = -solution.gap(fields.time)[:, 0]
            closed = (solution.contact_force(time) > 0.0).any(axis=1)
            axes.fill_between(
                loads, 0.0, 1.0, where=closed, transform=axes.get_xaxis_transform(),
                color=TINT, lw=0,
            )  # fmt: skip
        else:
            self.values = np.linalg.norm(fields.displacement, axis=2).max(axis=1)
            quantity, wave = "largest\ndisplacement", np.append(self.values, self.values[0])
            loads = np.append(self.loads, loads[-1])
        factor, unit = readable(float(np.abs(wave).max()), "m")
        self.values = factor * self.values
        axes.axhline(0.0, color=COLOURS["grey"], lw=0.8)
        axes.plot(loads, factor * wave, color=COLOURS["blue"], lw=2)
        self.line = axes.axvline(0.0, color=COLOURS["grey"], lw=1)
        (self.dot,) = axes.plot([0.0], [0.0], "o", color="black", ms=8, clip_on=False, zorder=5)
        axes.set_xlim(0.0, loads[-1])
        axes.margins(y=0.12)
        axes.set_xlabel("time / load period", fontsize=12)
        axes.set_ylabel(f"{quantity} [{unit}]", fontsize=12)
        axes.yaxis.set_label_coords(-0.09, 0.5)
        axes.tick_params(labelsize=11)
