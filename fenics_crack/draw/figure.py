"""What all pictures share: axes, labels with units, colours, and the end of every ``draw_*``.

Every ``draw_*`` draws onto the ``axes`` it is given and saves nothing. Without them it makes a new
figure, outside pyplot, and saves it if a ``path`` is given. It returns the figure. Lines are drawn
in SI units, whatever prefix their axes show, so that more can be drawn onto the same axes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import Formatter, FuncFormatter, LogFormatter
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.files.store import make_folder
from fenics_crack.parallel import on_root
from fenics_crack.table import readable

__all__ = ["COLOURS", "figure_of", "finish", "label_axis", "make_axes"]

COLOURS = {"blue": "#0072B2", "orange": "#D55E00", "green": "#009E73", "pink": "#CC79A7"}
COLOURS["grey"] = "#5C5C5C"
"""Okabe and Ito's palette, which colour-blind readers can tell apart, and a grey."""
MANY = 1e5
"""Ratio of the ends of a logarithmic axis beyond which its labels are powers of ten."""


def make_axes(
    axes: Any,
    path: str | Path | None,
    count: int = 1,
    *,
    columns: int = 1,
    size: tuple[float, float] = (7.0, 4.2),
    **options: Any,
) -> list[Axes]:
    """The axes that were given, or ``count`` panels of a new figure, ``columns`` side by side.

    ``size`` [in] and ``options`` (of ``Figure.subplots``) are of a new figure. Raises InputError
    if the number of axes is not that of the panels, or if there are both axes and a path.
    """
    if axes is None:
        figure = Figure(figsize=size, dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        made = figure.subplots(-(-count // columns), columns, squeeze=False, **options).ravel()
        for unused in made[count:]:
            unused.remove()
        return list(made[:count])
    if path is not None:
        raise InputError("path", str(path), "left out with axes: save their figure")
    given = list(np.atleast_1d(axes).ravel())
    if len(given) != count:
        raise InputError("axes", f"{len(given)} axes", f"{count}, one for each panel")
    return given


def label_axis(axis: Axis, quantity: str, unit: str) -> None:
    """Label an axis after all is drawn, and show its SI values in a unit with a prefix."""
    factor, prefixed = readable(float(np.abs(axis.get_data_interval()).max()), unit)
    axis.set_label_text(f"{quantity} [{prefixed}]")
    low, high = axis.get_view_interval()
    if axis.get_scale() != "log":
        axis.set_major_formatter(FuncFormatter(lambda x, _: _plain(round(factor * x, 12))))
    elif high > MANY * low:
        axis.set_major_formatter(FuncFormatter(lambda x, _: _power(factor * x)))
    else:  # few decades: labels within them, too
        axis.set_major_formatter(_Decades(factor))
        axis.set_minor_formatter(_Decades(factor, minor_thresholds=(2.0, 0.8)))


class _Decades(LogFormatter):
    """Plain numbers, 0.1, 1, 10, times a factor."""

    def __init__(self, factor: float, **options: Any) -> None:
        super().__init__(**options)
        self.factor = factor

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The label, or none."""
        return _plain(self.factor * x) if super().__call__(x, pos) else ""


def _plain(value: float) -> str:
    return str(Formatter.fix_minus(f"{value + 0.0:.10g}"))


def _power(value: float) -> str:
    return f"$\\mathdefault{{10^{{{round(np.log10(value))}}}}}$"


def finish(axes: Axes, path: str | Path | None, title: str | None) -> Figure:
    """Give a panel its grid and legend, and finish its figure.

    The legend stands below the panel where the figure has a constrained layout, else where it hides
    least.
    """
    axes.grid(alpha=0.3)
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    where: dict[str, Any] = {"loc": "best", "framealpha": 0.9}
    if named and axes.figure.get_layout_engine() is not None:
        letters = 17.0 * axes.get_window_extent().width / axes.figure.dpi
        columns = max(1, min(len(named), int(letters / (max(map(len, named)) + 8))))
        below = {"bbox_to_anchor": (0.5, 0.0), "borderaxespad": 4.2}
        where = {"loc": "upper center", "ncol": columns, "frameon": False, **below}
    if named:
        axes.legend(list(named.values()), list(named), fontsize=8, **where)
    return figure_of(axes, path, title)


def figure_of(
    axes: Axes, path: str | Path | None, title: str | None, comm: MPI.Comm = MPI.COMM_SELF
) -> Figure:
    """Set the title of a panel; save its figure on rank 0 and return it (collective)."""
    if title is not None:
        axes.set_title(title)

    def save() -> None:
        if path is not None:
            make_folder(path)
            axes.figure.savefig(str(path))

    on_root(comm, save)
    return axes.figure
