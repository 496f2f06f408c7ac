"""What all pictures share: colours, units that read well, a figure, and a place to draw unseen."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from fenics_crack.files.store import make_folder

__all__ = ["COLOURS", "finish", "new_figure", "off_screen_plotter", "readable", "save"]

COLOURS = {
    "blue": "#0072B2",
    "orange": "#D55E00",
    "green": "#009E73",
    "pink": "#CC79A7",
    "grey": "#5C5C5C",
}
"""Okabe and Ito's palette, told apart by colour-blind readers."""

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def readable(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit with which numbers up to a largest one read well: (1e6, "µm")."""
    exponent = 3 * int(np.floor(np.log10(largest) / 3.0)) if largest > 0.0 else 0
    prefix = _PREFIXES.get(exponent)
    return 10.0 ** (-exponent), f"10^{exponent} {unit}" if prefix is None else prefix + unit


def new_figure(
    rows: int = 1, columns: int = 1, *, size: tuple[float, float] = (7.0, 4.2), **options: Any
) -> tuple[Figure, Any]:
    """A figure and its axes, one or an array; for matplotlib's `subplots` the options."""
    figure = Figure(figsize=size, dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **options)


def finish(figure: Figure, axes: Axes, title: str, path: str | Path) -> None:
    """Give a figure of one axes its title, grid and legend, and save it."""
    axes.set_title(title)
    axes.grid(alpha=0.3)
    if axes.get_yscale() == "log":  # numbers within a decade, too, where there are few decades
        axes.yaxis.set_major_formatter(_Plain())
        axes.yaxis.set_minor_formatter(_Plain(minor_thresholds=(2.0, 0.8)))
    axes.legend(loc="best", fontsize=8, framealpha=0.9)
    save(figure, path)


class _Plain(LogFormatter):
    """Numbers as they are written: 0.1, 1, 10."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The label, or none."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def save(figure: Figure, path: str | Path) -> None:
    """Save a figure; make its folder."""
    make_folder(path)
    figure.savefig(str(path))


def off_screen_plotter(**options: Any) -> Any:
    """A plotter of pyvista that draws into memory."""
    if not os.environ.get("DISPLAY"):  # spares VTK the search for a screen, and its warning
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    return pyvista.Plotter(off_screen=True, **options)
