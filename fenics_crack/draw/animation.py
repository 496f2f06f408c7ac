"""The breathing crack in motion: a GIF, or a window with a slider.

The plate is drawn magnified and coloured by von Mises stress or displacement, with the crack faces
as thick lines, a dot on every pair that is in contact, and an arrow for the load. Everything is
gathered first; rank 0 draws.
"""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  what VTK draws with
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkLookupTable, vtkUnsignedCharArray
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkFiltersSources import vtkArrowSource
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.atomic_files import write_whole
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import readable
from fenics_crack.draw import vtk
from fenics_crack.draw.figure import COLOURS, drawn_on, label_axis
from fenics_crack.draw.vtk import PeriodFields
from fenics_crack.scene.tables import Material

SECONDS = 3.0
"""Duration of the animation."""
TINT = "#f5d6c1"
"""Background of the motion while the crack faces touch: light orange."""
PAGE = (640, 740)
"""Width and height [pixels]."""
PLATE = (6, 92, 532, 444)
"""Its place on the page: left, top, width and height [pixels]."""
BESIDE = 10
"""Minimum room around the plate, for its lines and dots [pixels]."""
LABEL_LETTERS = 17
"""Letters in a line of the label beside the motion, for which the page has room."""
OVERSAMPLING = 2
"""Pixels of the plate's drawing for one of the page, each way, which smooths it."""
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


def show_period(
    solution: PeriodicSolution,
    *,
    frames: int = 36,
    magnification: float | None = None,
    material: Material | None = None,
) -> None:
    """Show one period of a vibration in a window with a slider for the time (collective).

    Returns when the window is closed.

    Parameters
    ----------
    solution, frames, magnification, material
        As of :func:`animate_period`.

    Raises
    ------
    InputError
        There is no screen, or as :func:`animate_period`.

    Examples
    --------
    >>> fc.show_period(solution)  # doctest: +SKIP
    """
    fields = PeriodFields(solution, frames, magnification, material)

    def show() -> None:
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise InputError("screen", None, "there (DISPLAY is set), or use animate_period")
        plotter = vtk.pyvista().Plotter(title="fenics_crack", window_size=(900, 900))
        slider = _with_slider(plotter, solution, fields)
        plotter.show()
        del slider

    on_root(fields.mesh.structure.comm, show)


# --- the plate ------------------------------------------------------------------------------------


class _Colours:
    """Colours in steps from 0 to the end of the scale, in a unit with a prefix."""

    def __init__(self, fields: PeriodFields) -> None:
        name, unit = fields.colour
        end, highest = fields.colour_end, fields.colour_values.max()
        self.factor, unit = readable(end, unit)
        self.label = f"{name} [{unit}]"
        ticks = MaxNLocator(16, steps=[1, 2, 2.5, 5, 10])
        self.levels = ticks.tick_values(0.0, self.factor * end)
        self.steps = len(self.levels) - 1
        self.beyond = bool(self.factor * highest > self.levels[-1])
        self.map = ListedColormap(colormaps["viridis"](np.linspace(0.0, 1.0, self.steps)))
        self.table = vtkLookupTable()
        self.table.SetNumberOfTableValues(self.steps)
        for step, colour in enumerate(self.map.colors):
            self.table.SetTableValue(step, *colour)
        self.table.SetRange(self.levels[0], self.levels[-1])


class _Plate:
    """The plate in a renderer: what moves from frame to frame are the points of its parts."""

    def __init__(self, renderer: vtkRenderer, fields: PeriodFields) -> None:
        self.fields, mesh = fields, fields.mesh
        self.colours, self.height = _Colours(fields), 1e-3 * mesh.size  # of lines above the plate
        solid = mesh.dimension == 3
        boundary = vtk.outline(mesh) if solid else mesh.boundary

        def line(edges: np.ndarray, ink: str, width: float) -> vtkPolyData:
            drawn = vtk.lines(self._above(mesh.points), edges)
            if len(edges):
                _part(renderer, drawn, ink).SetLineWidth(width)
            return drawn

        line(boundary, "rest", 2)
        self.surface = vtk.surface(mesh.points, mesh.boundary_facets if solid else mesh.triangles)
        _part(renderer, self.surface, self.colours.table)
        self.lines = [line(boundary, "lips", 2)]
        if not solid:  # whose outline has the mouth
            self.lines.append(line(mesh.lips, "lips", 5))
        line(boundary[mesh.clamped[boundary].all(axis=1)], "rest", 9)
        self.dots = vtkPolyData()
        if len(fields.areas):
            look = _part(renderer, self.dots, "contact")
            look.SetPointSize(16)
            look.RenderPointsAsSpheresOn()
        self.arrow, self.unit_arrow = _unit_arrow()
        self.room = np.zeros(3) if solid else np.array([0.0, 0.0, 2.0 * self.height])
        self.starts, self.arrows = _load_arrows(fields)
        if np.any(fields.load):
            _part(renderer, self.arrow, "load")
        self.move(0)

    def _above(self, points: np.ndarray) -> np.ndarray:
        """Lift points to where lines are drawn: above a plate."""
        return vtk.in_space(points) + (points.shape[1] == 2) * np.array([0.0, 0.0, self.height])

    def move(self, frame: int) -> None:
        """Show another frame."""
        fields = self.fields
        moved = fields.moved[frame]
        vtk.place(self.surface, moved)
        for part in self.lines:
            vtk.place(part, self._above(moved))
        colours = self.colours.factor * fields.colour_values[frame]
        vtk.add_values(self.surface.GetPointData(), "shown", colours)
        pairs = (fields.pair_nodes / fields.pair_nodes.sum(axis=0)).T
        vtk.place(self.dots, vtk.in_space(pairs @ moved) + self.room)
        self.dots.SetVerts(vtk.cells_of(np.argwhere(fields.force[frame] > 0.0)))
        start, arrow = (vtk.in_space(part[frame][None])[0] for part in (self.starts, self.arrows))
        _, size, axes = np.linalg.svd(arrow[None])
        axes[0] *= np.sign(axes[0] @ arrow)
        vtk.place(self.arrow, start + self.room + size * (self.unit_arrow @ axes))


def _unit_arrow() -> tuple[vtkPolyData, np.ndarray]:
    """An arrow along x, of length 1, and its points."""
    source = vtkArrowSource()
    source.SetTipLength(0.45)
    source.SetTipRadius(0.16)
    source.SetTipResolution(20)
    source.SetShaftRadius(0.055)
    source.SetShaftResolution(20)
    source.Update()
    arrow = source.GetOutput()
    return arrow, vtk_to_numpy(arrow.GetPoints().GetData()).copy()


def _part(renderer: vtkRenderer, data: vtkPolyData, ink: str | vtkLookupTable) -> Any:
    """Add what is drawn in one ink, or by its values "shown" in colours; return how it looks."""
    mapper, actor = vtkPolyDataMapper(), vtkActor()
    mapper.SetInputData(data)
    actor.SetMapper(mapper)
    renderer.AddActor(actor)
    look = actor.GetProperty()
    look.LightingOff()
    mapper.SetScalarVisibility(not isinstance(ink, str))
    if isinstance(ink, str):
        look.SetColor(to_rgb(INK[ink]))
    else:
        mapper.SetScalarModeToUsePointFieldData()
        mapper.SelectColorArray("shown")
        mapper.SetLookupTable(ink)
        mapper.UseLookupTableScalarRangeOn()
        mapper.InterpolateScalarsBeforeMappingOn()
    return look


def _load_arrows(fields: PeriodFields) -> tuple[np.ndarray, np.ndarray]:
    """Return points of the magnified plate with a load and the arrows there, both (n, d) [m].

    The longest arrow is an eighth of the plate.
    """
    total = fields.load.sum(axis=1)
    share = np.abs(fields.load).sum(axis=(0, 2))
    largest = np.linalg.norm(total, axis=1).max()
    if largest == 0.0:
        return np.zeros_like(total), np.zeros_like(total)
    return share @ fields.moved / share.sum(), fields.mesh.size / 8.0 * total / largest


def _with_slider(plotter: Any, solution: PeriodicSolution, fields: PeriodFields) -> Any:
    """Put the plate, its colours and the slider into a window; return the slider, to be kept.

    VTK must format no number here: newer versions parse the format by a regular expression, which
    crashes if DOLFINx was loaded first, because each brings its own part of libstdc++.
    """
    from vtkmodules.vtkInteractionWidgets import vtkSliderRepresentation2D, vtkSliderWidget

    plate = _Plate(plotter.renderer, fields)
    figure = Figure(facecolor="white")
    _draw_bar(figure, (0.1, 0.05, 0.2, 0.87), plate.colours)
    chart = vtk.pyvista().ChartMPL(figure, size=(0.14, 0.6), loc=(0.85, 0.25))
    chart.border_color = "white"
    plotter.add_chart(chart)
    count, caption = len(fields.time), _caption(solution, fields)

    def turn(loads: float) -> None:
        frame = round(loads / solution.subharmonic * count) % count
        plate.move(frame)
        at = solution.subharmonic * frame / count
        text = f"{caption}\ntime {at:.3f} load periods"
        plotter.add_text(text, font_size=11, color="black", name="caption", render=False)

    slider = vtkSliderRepresentation2D()  # pyvista's own shows a label, a number
    slider.ShowSliderLabelOff()
    slider.SetMaximumValue(float(solution.subharmonic))
    slider.SetTitleText("time / load period")
    slider.SetTubeWidth(0.005)
    slider.SetSliderWidth(0.03)
    parts = slider.GetTitleProperty(), slider.GetTubeProperty(), slider.GetSliderProperty()
    for part, ink in zip(parts, ("lips", "rest", "contact"), strict=True):
        part.SetColor(to_rgb(INK[ink]))
    for end, x in ((slider.GetPoint1Coordinate(), 0.1), (slider.GetPoint2Coordinate(), 0.8)):
        end.SetCoordinateSystemToNormalizedViewport()
        end.SetValue(x, 0.09)
    widget = vtkSliderWidget()
    widget.SetInteractor(plotter.iren.interactor)
    widget.SetRepresentation(slider)
    widget.SetAnimationModeToJump()
    widget.AddObserver("InteractionEvent", lambda *_: turn(slider.GetValue()))
    widget.SetEnabled(True)
    turn(0.0)
    _look_at_all(plotter.renderer, fields, room=1.35)
    plotter.camera_set = True
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
    """Draw all frames and write the GIF."""
    vtk.without_screen()
    window, renderer = vtkRenderWindow(), vtkRenderer()
    window.SetOffScreenRendering(True)
    window.SwapBuffersOff()
    window.SetMultiSamples(0)  # the page shrinks what it draws, which smooths it
    window.SetSize(OVERSAMPLING * PLATE[2], OVERSAMPLING * PLATE[3])
    window.AddRenderer(renderer)
    plate = _Plate(renderer, fields)
    across = _look_at_all(renderer, fields)
    aside = max(0, int(0.5 * (PLATE[2] - across * PLATE[3])) - BESIDE)  # where nothing is drawn
    window.SetSize(OVERSAMPLING * (PLATE[2] - 2 * aside), OVERSAMPLING * PLATE[3])
    page = _Page(solution, fields, plate.colours)
    pictures = []
    for frame in range(len(fields.time)):
        plate.move(frame)
        window.Render()
        pictures.append(page.draw(frame, _image_of(window)))
    window.Finalize()
    palette = _palette(plate.colours)
    shown = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = max(20, 10 * round(100.0 * SECONDS / len(shown)))  # [ms], in steps of 10
    timing = {"duration": duration, "loop": 0, "comment": page.caption.encode("latin-1")}
    animation = BytesIO()
    shown[0].save(
        animation, "GIF", save_all=True, append_images=shown[1:], optimize=False, **timing
    )
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


def _image_of(window: vtkRenderWindow) -> Image.Image:
    """Return the image shown by a window."""
    (width, height), pixels = window.GetSize(), vtkUnsignedCharArray()
    window.GetPixelData(0, 0, width - 1, height - 1, 0, pixels, 0)
    from_below = ("raw", "RGB", 0, -1)
    return Image.frombytes("RGB", (width, height), bytes(pixels), *from_below)


def _look_at_all(renderer: vtkRenderer, fields: PeriodFields, room: float = 1.03) -> float:
    """Set the camera so that the plate stays in the picture for the whole period; return the width
    that it takes, relative to the height of the picture."""
    width, height = renderer.GetVTKWindow().GetSize()
    if fields.mesh.dimension == 3:
        vtk.look_from_corner(renderer, fields.mesh.points)
        return float(width / height)
    heads = np.add(*_load_arrows(fields)) if np.any(fields.load) else np.empty((0, 2))
    points = np.concatenate([fields.mesh.points, *fields.moved, heads])
    low, high = points.min(axis=0), points.max(axis=0)
    size, camera = fields.mesh.size, vtk.seen_parallel(renderer)
    middle, (across, up) = 0.5 * (low + high), high - low
    seen = room * max(up, across * height / width)
    camera.SetFocalPoint(*middle, 0.0)
    camera.SetPosition(*middle, 10.0 * size)
    camera.SetParallelScale(0.5 * seen)
    camera.SetClippingRange(size, 20.0 * size)
    return float(across / seen)


def _draw_bar(figure: Figure, place: tuple[float, float, float, float], colours: _Colours) -> None:
    """Draw the colour bar at a place in a figure."""
    mapped = ScalarMappable(BoundaryNorm(colours.levels, colours.steps), colours.map)
    ends = {"extend": "max" if colours.beyond else "neither", "spacing": "proportional"}
    bar = figure.colorbar(mapped, cax=figure.add_axes(place), ticks=colours.levels[::2], **ends)
    bar.set_label(colours.label, fontsize=12)
    bar.ax.tick_params(labelsize=11)


class _Page:
    """The page around the plate: caption, colours, and a wave with a moving dot."""

    def __init__(self, solution: PeriodicSolution, fields: PeriodFields, colours: _Colours) -> None:
        self.loads = fields.time * solution.omega / (2.0 * np.pi)
        self.figure = Figure(figsize=np.divide(PAGE, 100), dpi=100, facecolor="white")
        self.canvas = FigureCanvasAgg(self.figure)
        title = "Breathing crack" if fields.cracked else "Vibrating structure"
        centred = {"ha": "center", "va": "center"}
        self.figure.text(0.5, 0.968, title, fontsize=16, weight="bold", **centred)
        self.caption = _caption(solution, fields)
        self.text = self.figure.text(0.06, 0.932, "", va="center", fontsize=12, animated=True)
        _draw_bar(self.figure, (0.845, 0.32, 0.03, 0.49), colours)
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
        page = drawn_on(self.canvas)
        plate = plate.reduce(OVERSAMPLING)
        page.paste(plate, (PLATE[0] + (PLATE[2] - plate.width) // 2, PLATE[1]))
        return page

    def _legend(self, fields: PeriodFields) -> None:
        lines = (
            ("at rest", True, "rest", 1.5, None),
            ("clamped", fields.mesh.clamped.any(), "rest", 6, None),
            ("load", np.any(fields.load), "load", 3, ">"),
            ("crack faces", fields.cracked and fields.mesh.dimension == 2, "lips", 3, None),
            ("crack faces in contact", len(fields.areas), "contact", 0, "o"),
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
        if len(fields.areas):
            gaps, watched = solution.gap(time), solution.structure.watched_pairs.values()
            pair = max(watched, key=lambda number: float(np.ptp(gaps[:, number])))
            quantity, wave = f"opening {solution.structure.where(pair)}", -gaps[:, pair]
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
        axes.yaxis.label.set(size=11, text=fill(axes.yaxis.label.get_text(), LABEL_LETTERS))
        axes.yaxis.set_label_coords(-0.085, 0.5)
        axes.tick_params(labelsize=11)
        whole = axes.get_xaxis_transform()  # which would count as data of the axis before
        axes.fill_between(loads, 0.0, 1.0, where=closed, transform=whole, color=TINT, lw=0)
