"""The breathing crack in motion: a GIF, or a window with a slider.

The plate is drawn magnified and coloured by von Mises stress or displacement, with the lips as
thick lines, a dot on every pair that is in contact, and an arrow for the load. Everything is
gathered first; rank 0 draws.
"""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch
from matplotlib.ticker import MaxNLocator
from matplotlib.widgets import Slider
from PIL import Image

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.draw.figure import COLOURS
from fenics_crack.draw.period import PeriodFields
from fenics_crack.draw.plot_mesh import outline, triangles_of
from fenics_crack.errors import InputError
from fenics_crack.parallel import on_root
from fenics_crack.scene.tables import Material
from fenics_crack.stages import begin
from fenics_crack.table import readable
from fenics_crack.whole import write_whole

__all__ = ["animate_period", "show_period"]

SECONDS = 3.0
"""Duration of the animation."""
TINT = "#f5d6c1"
"""Background of the wave while the lips touch: light orange."""
PAGE = (6.4, 7.4)
"""Width and height [in], of 100 pixels each."""
PLATE = (0.01, 0.275, 0.83, 0.60)
"""The place of the plate on the page: left, bottom, width, height."""
ARROW = 0.125
"""The longest arrow of the load, relative to the size of the structure."""
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

    Below the plate is the opening of the crack's mouth over time, of several cracks of the one that
    moves most; without a crack the largest displacement. The caption and the comment of the file
    state the magnification.

    Parameters
    ----------
    solution : PeriodicSolution
        What to show.
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
    fields = PeriodFields.of(solution, frames, magnification, material)

    def show() -> None:
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise InputError("screen", None, "there (DISPLAY is set), or use animate_period")
        from matplotlib import pyplot

        try:
            pyplot.switch_backend("TkAgg")
        except ImportError as error:
            raise InputError("screen", None, "used by Tk (python3-tk is installed)") from error
        figure = pyplot.figure("fenics_crack", figsize=PAGE)
        slider = _with_slider(figure, solution, fields)
        pyplot.show(block=True)
        del slider

    on_root(fields.mesh.structure.comm, show)


def _with_slider(figure: Figure, solution: PeriodicSolution, fields: PeriodFields) -> Slider:
    """Put the page and a slider into the figure of a window; return the slider, to be kept."""
    page, count = _Page(figure, solution, fields), len(fields.time)
    place = figure.add_axes((0.15, 0.005, 0.7, 0.02))
    end = float(solution.subharmonic)
    slider = Slider(place, "", 0.0, end, valinit=0.0, color=COLOURS["blue"])
    slider.valtext.set_visible(False)

    def turn(loads: float) -> None:
        page.move(round(loads / end * count) % count)
        figure.canvas.draw_idle()

    slider.on_changed(turn)
    page.move(0)
    return slider


def _write(solution: PeriodicSolution, fields: PeriodFields, path: Path) -> None:
    """Draw all frames and write the GIF: what moves is drawn over the rest, which is drawn once."""
    figure = Figure(figsize=PAGE, dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    page = _Page(figure, solution, fields)
    for artist in page.moving:
        artist.set_animated(True)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    palette, shown = _palette(page.colours), []
    for frame in range(len(fields.time)):
        canvas.restore_region(still)
        page.move(frame)
        for artist in page.moving:
            figure.draw_artist(artist)
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        shown.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
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


def _load_arrows(fields: PeriodFields) -> tuple[np.ndarray, np.ndarray]:
    """Where the load acts on the magnified plate and arrows along it, both (n, 2) [m]."""
    total = fields.load.sum(axis=1)
    share = np.abs(fields.load).sum(axis=(0, 2))
    largest = np.linalg.norm(total, axis=1).max()
    if largest == 0.0:
        return fields.places[:, 0], np.zeros_like(total)
    return share @ fields.places / share.sum(), ARROW * fields.mesh.size / largest * total


class _Colours:
    """Colours in steps from 0 to the end of the scale, in a unit with a prefix."""

    def __init__(self, fields: PeriodFields) -> None:
        name, unit = fields.colour
        end, highest = fields.colour_end, fields.colour_values.max()
        self.factor, unit = readable(end, unit)
        self.label = f"{name} [{unit}]"
        ticks = MaxNLocator(16, steps=[1, 2, 2.5, 5, 10])
        self.levels = ticks.tick_values(0.0, self.factor * end)
        self.beyond = bool(self.factor * highest > self.levels[-1])
        self.map = ListedColormap(colormaps["viridis"](np.linspace(0.0, 1.0, len(self.levels) - 1)))

    def draw_bar(self, figure: Figure) -> None:
        """Draw the colour bar beside the plate."""
        mapped = ScalarMappable(BoundaryNorm(self.levels, self.map.N), self.map)
        ends = {"extend": "max" if self.beyond else "neither", "spacing": "proportional"}
        place = figure.add_axes((0.845, 0.32, 0.03, 0.49))
        bar = figure.colorbar(mapped, cax=place, ticks=self.levels[::2], **ends)
        bar.set_label(self.label, fontsize=12)
        bar.ax.tick_params(labelsize=11)


class _Page:
    """A page that shows a period: a caption, the plate, its colours, and a wave with a dot."""

    def __init__(self, figure: Figure, solution: PeriodicSolution, fields: PeriodFields) -> None:
        self.figure, self.fields, self.colours = figure, fields, _Colours(fields)
        self.loads = fields.time * solution.omega / (2.0 * np.pi)
        title = "Breathing crack" if len(fields.mesh.lips) else "Vibrating plate"
        centred = {"ha": "center", "va": "center"}
        figure.text(0.5, 0.968, title, fontsize=16, weight="bold", **centred)
        hertz = solution.omega / (2.0 * np.pi)
        self.caption = (
            f"{'load' if np.any(fields.load) else 'motion'} at {solution.omega:.5g} rad/s "
            f"({hertz:.4g} Hz), displacement × {float(f'{fields.magnification:.3g}'):.10g}"
        )
        self.text = figure.text(0.06, 0.932, "", va="center", fontsize=12)
        self.colours.draw_bar(figure)
        self._legend()
        self._plate()
        self._wave(solution)

    @property
    def moving(self) -> list[Artist]:
        """What is drawn anew for each frame, in the order in which it is drawn."""
        plate = [*self.axes.collections, *self.axes.lines, self.arrow]
        return [*plate, self.line, self.dot, self.text]

    def move(self, frame: int) -> None:
        """Show another frame."""
        fields, places, at = self.fields, self.fields.places[frame], self.loads[frame]
        for band in [*self.axes.collections]:
            band.remove()
        look = {"levels": self.colours.levels, "cmap": self.colours.map, "antialiased": False}
        values = self.colours.factor * fields.colour_values[frame]
        self.axes.tricontourf(*places.T, self.triangles, values, extend="max", **look)
        for line, edges in self.edges:
            line.set_data(*outline(places, edges))
        nodes = fields.pair_nodes[:, fields.force[frame] > 0.0]
        self.dots.set_data(*(places.T @ nodes / nodes.sum(axis=0)))
        start, arrow = self.starts[frame], self.arrows[frame]
        share = float(np.linalg.norm(arrow) / (ARROW * fields.mesh.size))
        self.arrow.set_positions(start, start + arrow)
        self.arrow.set(mutation_scale=20.0 * share, lw=3.5 * share, visible=share > 0.0)
        self.dot.set_data([at], [self.values[frame]])
        self.line.set_xdata([at, at])
        self.text.set_text(f"{self.caption}, phase {360.0 * at:.0f}°")

    def _plate(self) -> None:
        """The plate at rest and moved, its marks, and room for the whole period."""
        fields, mesh, axes = self.fields, self.fields.mesh, self.figure.add_axes(PLATE)
        self.axes, self.triangles = axes, triangles_of(mesh)
        clamped = mesh.boundary[mesh.clamped[mesh.boundary].all(axis=1)]
        form: dict[str, Any] = {"solid_capstyle": "round", "zorder": 3}
        for edges, width in ((mesh.boundary, 0.8), (clamped, 4.5)):
            axes.plot(*outline(mesh.points, edges), color=INK["rest"], lw=width, **form)
        self.edges = [
            (axes.plot([], [], color=INK["lips"], lw=width, **form)[0], edges)
            for edges, width in ((mesh.boundary, 1.0), (mesh.lips, 2.0))
        ]
        (self.dots,) = axes.plot([], [], "o", color=INK["contact"], ms=6, zorder=4)
        self.starts, self.arrows = _load_arrows(fields)
        head = {"arrowstyle": "-|>", "shrinkA": 0.0, "shrinkB": 0.0, "zorder": 5}
        self.arrow = FancyArrowPatch((0.0, 0.0), (0.0, 0.0), color=INK["load"], **head)
        axes.add_patch(self.arrow)
        every = np.concatenate([mesh.points, *fields.places, self.starts + self.arrows])
        low, high = every.min(axis=0), every.max(axis=0)
        room = 0.03 * mesh.size
        axes.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
        axes.set_aspect("equal")
        axes.axis("off")

    def _legend(self) -> None:
        fields = self.fields
        lines = (
            ("at rest", True, "rest", 1.5, None),
            ("clamped", fields.mesh.clamped.any(), "rest", 6, None),
            ("load", np.any(fields.load), "load", 3, ">"),
            ("lips", len(fields.mesh.lips), "lips", 3, None),
            ("lips in contact", len(fields.areas), "contact", 0, "o"),
        )
        keys = [
            Line2D([], [], label=label, color=INK[ink], lw=width, marker=marker, ms=8)
            for label, shown, ink, width, marker in lines
            if shown
        ]
        spaces = {"handletextpad": 0.5, "columnspacing": 1.5, "frameon": False}
        centre = {"loc": "center", "bbox_to_anchor": (0.5, 0.893)}
        self.figure.legend(handles=keys, ncol=5, fontsize=11, **centre, **spaces)

    def _wave(self, solution: PeriodicSolution) -> None:
        fields, axes = self.fields, self.figure.add_axes((0.15, 0.085, 0.82, 0.16))
        time = np.linspace(0.0, solution.period, 401)
        loads = time * solution.omega / (2.0 * np.pi)
        if len(fields.areas):
            gaps, watched = solution.gap(time), solution.structure.watched_pairs.values()
            pair = max(watched, key=lambda number: float(np.ptp(gaps[:, number])))
            place = solution.structure.where(pair).replace(" ", "\n", 1)
            quantity, wave = f"opening {place}", -gaps[:, pair]
            self.values = -solution.gap(fields.time)[:, pair]
            closed = (solution.contact_force(time) > 0.0).any(axis=1)
            whole = axes.get_xaxis_transform()
            axes.fill_between(loads, 0.0, 1.0, where=closed, transform=whole, color=TINT, lw=0)
        else:
            self.values = np.linalg.norm(fields.displacement, axis=2).max(axis=1)
            quantity, wave = "largest\ndisplacement", np.append(self.values, self.values[0])
            loads = np.append(self.loads, loads[-1])
        factor, unit = readable(float(np.abs(wave).max()), "m")
        self.values = factor * self.values
        axes.axhline(0.0, color=COLOURS["grey"], lw=0.8)
        axes.plot(loads, factor * wave, color=COLOURS["blue"], lw=2)
        self.line = axes.axvline(0.0, color=COLOURS["grey"], lw=1)
        (self.dot,) = axes.plot([0.0], [0.0], "o", color="black", ms=8, clip_on=False)
        axes.set_xlim(0.0, loads[-1])
        axes.margins(y=0.12)
        axes.set_xlabel("time / load period", fontsize=12)
        axes.set_ylabel(f"{quantity} [{unit}]", fontsize=12)
        axes.yaxis.set_label_coords(-0.09, 0.5)
        axes.tick_params(labelsize=11)
