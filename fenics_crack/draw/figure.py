"""Common parts of all pictures: axes, labels with units, colours, and the end of every ``draw_*``.

Every ``draw_*`` draws onto the ``axes`` it is given and saves nothing. Without them it makes a new
figure, outside pyplot, and saves it if a ``path`` is given. It returns the figure. Lines are drawn
in SI units, whatever prefix their axes show, so that more can be drawn onto the same axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from textwrap import fill, wrap
from typing import Any, TypedDict, Unpack

import numpy as np
from matplotlib import colormaps, rc_context, rc_params_from_file
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import Formatter, FuncFormatter, LogFormatter, LogLocator, NullLocator
from mpi4py import MPI
from PIL import Image

from fenics_crack.basics.atomic_files import write_file_whole
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.suggestions import check_options, fit_argument
from fenics_crack.basics.tables import UNITS_WITHOUT_PREFIX, choose_unit_prefix, heading_with_unit

COLOURS = {"blue": "#0072B2", "orange": "#D55E00", "green": "#009E73", "pink": "#CC79A7"}
COLOURS["grey"] = "#5C5C5C"
"""Okabe and Ito's palette, which colour-blind readers can distinguish, and a grey."""
STYLE = rc_params_from_file(
    Path(__file__).with_name("fenics_crack.mplstyle"), use_default_template=False
)
"""Settings of Matplotlib for new figures, legends and files."""
LETTERS = 42
"""Maximum letters in a line of a label along the height of a panel."""
FIRST = "first in the legend"
"""Marks (``gid``) lines that come first in a legend, before those that explain styles."""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Where(TypedDict, total=False):
    """Target of a picture; every ``draw_*`` takes these keywords, ``ax`` for ``axes`` too."""

    axes: Any
    ax: Any
    path: str | Path | None
    title: str | None
    legend: bool


class ShownFigure(Figure):
    """A figure that notebooks show where it is the value of a cell, whether or not they have loaded
    pyplot, which knows nothing of it and shows no second copy."""

    def _repr_png_(self) -> bytes:
        return png_of(self)


class Picture:
    """The panels of a picture, and its end.

    They are the axes that are given, or ``count`` panels of a new figure, ``columns`` side by side.

    Parameters
    ----------
    count, columns : int
        Number of panels, and of those side by side in a new figure.
    size : (float, float) [in]
        Of a new figure; default: that of the style sheet.
    sharex : bool
        The panels of a new figure have one horizontal axis.
    comm : MPI.Comm
        Its rank 0 saves the figure.
    where
        As of every picture (:class:`Where`).

    Raises
    ------
    InputError
        The number of axes is not that of the panels, there are both axes and a path, the path's
        kind of picture is not known, or a keyword is none of these.
    """

    def __init__(
        self,
        count: int = 1,
        *,
        columns: int = 1,
        size: tuple[float, float] | None = None,
        sharex: bool = False,
        comm: MPI.Comm = MPI.COMM_SELF,
        **where: Unpack[Where],
    ) -> None:
        check_options("pictures (labels and limits: of their axes)", where, Where.__annotations__)
        path, axes = where.get("path"), given_axes(where)
        fit_argument("path", path, "str | Path | None", ())
        self._path, self._title, self._comm = path, where.get("title"), comm
        self.legend = where.get("legend", True)
        if axes is None:
            with rc_context(STYLE):
                figure = ShownFigure(figsize=size)
            FigureCanvasAgg(figure)
            rows = -(-count // columns)
            axes = figure.subplots(rows, columns, squeeze=False, sharex=sharex).ravel()
            for unused in axes[count:]:
                unused.remove()
            axes = axes[:count]
        elif path is not None:
            raise InputError("path", str(path), "left out with axes: save their figure")
        kinds = sorted(FigureCanvasAgg.get_supported_filetypes())
        if path is not None and Path(path).suffix[1:].lower() not in ["", *kinds]:
            raise InputError("path", str(path), f"a file of one of the kinds .{', .'.join(kinds)}")
        self.panels: list[Axes] = list(np.atleast_1d(axes).ravel())
        if len(self.panels) != count:
            raise InputError("axes", f"{len(self.panels)} axes", f"{count}, one for each panel")
        self.figure: Figure = self.panels[0].figure

    def __iter__(self) -> Iterator[Axes]:
        return iter(self.panels)

    def finished(self) -> Figure:
        """The figure with grids and legends, saved as by :meth:`saved`."""
        for panel in self:
            with rc_context(STYLE):
                panel.grid(alpha=STYLE["grid.alpha"])
                if self.legend:
                    _draw_legend(panel)
        return self.saved()

    def saved(self) -> Figure:
        """Set the title, save the figure on rank 0 if it has a path, return it (collective)."""
        if self._title is not None and len(self.panels) > 1:
            self.figure.suptitle(self._title, fontsize="large")
        elif self._title is not None:  # which makes way for axes on the top
            self.panels[0].set_title(self._title, y=None if self.panels[0].child_axes else 1.0)
        if self._path is not None:
            file = Path(self._path)
            begin_stage(file.name)

            def save() -> None:
                if file.suffix == ".png":
                    written = png_of(self.figure)
                else:
                    picture = BytesIO()
                    with rc_context(STYLE):
                        self.figure.savefig(picture, format=file.suffix.removeprefix(".") or None)
                    written = picture.getvalue()
                write_file_whole(file, written)

            on_root(self._comm, save)
        return self.figure


def png_of(figure: Figure) -> bytes:
    """Return a figure as a PNG, without the draft that ``savefig`` draws before."""
    canvas, picture = FigureCanvasAgg(figure), BytesIO()
    canvas.draw()
    drawn_on(canvas).save(picture, "PNG", compress_level=3, dpi=(figure.dpi, figure.dpi))
    return picture.getvalue()


def drawn_on(canvas: FigureCanvasAgg) -> Image.Image:
    """Return the image on a canvas, without its alpha channel."""
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def tenth(vectors: np.ndarray, size: float) -> float:
    """Factor that makes the longest of some vectors (..., d) a tenth of a size; 1 if all are 0."""
    largest = np.linalg.norm(vectors, axis=-1).max()
    return float(0.1 * size / largest) if largest > 0.0 else 1.0


def given_axes(where: Where) -> Any:
    """The axes that are given by either name, or None."""
    axes, ax = where.get("axes"), where.get("ax")
    if axes is not None and ax is not None:
        raise InputError("ax", "axes", "left out with axes: one of the two")
    return axes if ax is None else ax


def distinct_colours(count: int) -> list[str]:
    """Colours for some lines: those of :data:`COLOURS`, of more a sequence from dark to light."""
    if count <= len(COLOURS):
        return list(COLOURS.values())[:count]
    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.0, 0.95, count))]


def upright(label: str) -> str:
    """A long label that is read upwards, in lines that a panel has room for."""
    return label if "\n" in label else fill(label, LETTERS)


def label_axis(axis: Axis, quantity: str, unit: str) -> None:
    """Label an axis after all is drawn, and show its SI values in a unit with a prefix."""
    factor, prefixed = 1.0, unit
    if unit not in UNITS_WITHOUT_PREFIX:
        factor, prefixed = choose_unit_prefix(float(np.abs(axis.get_data_interval()).max()), unit)
    label = heading_with_unit(quantity, prefixed).replace("m^0.5", "√m")
    axis.set_label_text(upright(label) if axis.axis_name == "y" else label)
    low, high = axis.get_view_interval()
    if axis.get_scale() != "log":
        axis.set_major_formatter(FuncFormatter(lambda x, _: _plain(round(factor * x, 12))))
    elif (decades := np.log10(high / low)) > 5.0:
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda x, _: _power(factor * x)))
    else:  # few decades: labels within them, too, or a few small ticks, of which each takes time
        if decades > 2.0:
            axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_major_formatter(_Decades(factor))
        axis.set_minor_formatter(_Decades(factor, minor_thresholds=(2.0, 0.8)))


def label_count(axis: Axis, things: str) -> None:
    """Label a linear axis of numbers of things, after all is drawn: "10⁶ load cycles"."""
    factor, _ = choose_unit_prefix(float(axis.get_data_interval()[1]), "")
    axis.set_label_text(things if factor == 1.0 else f"{_power(1.0 / factor)} {things}")
    axis.set_major_formatter(FuncFormatter(lambda x, _: _plain(round(factor * x, 12))))


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
    return "10" + str(round(np.log10(value))).translate(SUPERSCRIPTS)


def _draw_legend(axes: Axes) -> None:
    """Give a panel its legend.

    It stands below the panel where the figure has a constrained layout, which grows by the rows of
    a long one, in lines as wide as the figure; else where it hides least.
    """
    handles, labels = axes.get_legend_handles_labels()
    first = [isinstance(handle, Artist) and handle.get_gid() == FIRST for handle in handles]
    order = sorted(range(len(handles)), key=lambda place: not first[place])  # containers: no gid
    named = {labels[place]: handles[place] for place in order}
    if named and axes.figure.get_layout_engine() is not None:
        alone = len(axes.figure.axes) == 1
        room = 0.9 * axes.figure.bbox.width if alone else axes.get_window_extent().width
        letters = 17.0 * room / axes.figure.dpi
        wide = max(int(letters) - 8, LETTERS)
        lines = [[p for line in label.splitlines() for p in wrap(line, wide)] for label in named]
        named = dict(zip(map("\n".join, lines), named.values(), strict=True))
        longest = max(len(line) for label in lines for line in label)
        columns = max(1, min(len(named), int(letters / (longest + 8))))
        high, before = -(-len(named) // columns), axes.get_legend()
        tops = range(0, len(lines), high)
        rows = max(2, *(sum(map(len, lines[top : top + high])) for top in tops))
        more = rows - (2 if before is None else int(before.get_gid()))  # a figure has room for 2
        if alone:
            axes.figure.set_figheight(axes.figure.get_figheight() + 0.17 * more)
        labelled = axes.xaxis.get_major_ticks()[0].label1.get_visible()
        below = {"bbox_to_anchor": (0.5, 0.0), "borderaxespad": 4.2 if labelled else 0.8}  # [em]
        where = {"loc": "upper center", "ncol": columns, "frameon": False, **below}
        axes.legend(list(named.values()), list(named), **where).set_gid(str(rows))
    elif named:
        axes.legend(list(named.values()), list(named), loc="best")
