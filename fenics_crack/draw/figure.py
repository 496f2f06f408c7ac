"""Make figures, label axes with units, draw legends and save files for every ``draw_*``.

Every ``draw_*`` draws onto given ``axes`` and saves nothing. Without ``axes`` it makes a new figure
outside pyplot, and saves the figure if a ``path`` is given. It returns the figure. Lines are drawn
in SI units, whatever prefix their axes show. Further lines can follow on the same axes.
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
from fenics_crack.basics.suggestions import check_argument_class_or_unwrap_run, check_options
from fenics_crack.basics.tables import (
    UNITS_WITHOUT_PREFIX,
    choose_factor_and_prefixed_unit,
    heading_with_unit,
)

CURVE_COLOUR_CODE_BY_NAME = {
    "blue": "#0072B2",
    "orange": "#D55E00",
    "green": "#009E73",
    "pink": "#CC79A7",
}
CURVE_COLOUR_CODE_BY_NAME["grey"] = "#5C5C5C"
"""Colours by name: Okabe and Ito's palette for colour-blind readers, and a grey."""
FIGURE_STYLE = rc_params_from_file(
    Path(__file__).with_name("fenics_crack.mplstyle"), use_default_template=False
)
"""Matplotlib's settings (rcParams) for new figures, legends and files."""
MAX_LETTERS_PER_LABEL_LINE = 42
"""Maximum number of letters in a line of a vertical axis's label, or of a narrow legend."""
FIRST_IN_LEGEND_GID = "first in the legend"
"""Matplotlib's ``gid`` for lines whose entries come first in a legend."""
SUPERSCRIPT_TRANSLATION = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class PictureOptions(TypedDict, total=False):
    """Keywords of every ``draw_*`` function.

    ``axes`` or ``ax``: axes to draw on, by default axes in a new figure; only one of both may be
    given. ``path``: file for a new figure. ``title``: title above the picture. ``legend``: False
    for a picture without a legend.
    """

    axes: Any
    ax: Any
    path: str | Path | None
    title: str | None
    legend: bool


class NotebookFigure(Figure):
    """Figure that notebooks show as the value of a cell.

    Pyplot need not be loaded, and does not know the figure. If pyplot knew the figure, notebooks
    would show a second copy.
    """

    def _repr_png_(self) -> bytes:
        return render_png(self)


class Picture:
    """Target of a drawing: panels, their figure, and the options for title and file.

    The panels are the given axes, or axes in a new figure.

    Parameters
    ----------
    n_panels : int
        Number of panels.
    n_columns : int
        Panels side by side in a new figure.
    size : (float, float) [in]
        Width and height of a new figure; default: the style sheet's.
    sharex : bool
        Whether panels in a new figure share their horizontal axis.
    comm : MPI.Comm
        Communicator whose rank 0 saves the figure.
    picture_options
        Keywords in :class:`PictureOptions`.

    Raises
    ------
    InputError
        There are more or fewer axes than ``n_panels``, there are both axes and a path, the path's
        suffix is unknown, or a keyword is not in :class:`PictureOptions`.
    """

    def __init__(
        self,
        n_panels: int = 1,
        *,
        n_columns: int = 1,
        size: tuple[float, float] | None = None,
        sharex: bool = False,
        comm: MPI.Comm = MPI.COMM_SELF,
        **picture_options: Unpack[PictureOptions],
    ) -> None:
        check_options(
            "pictures (labels and limits: of their axes)",
            picture_options,
            PictureOptions.__annotations__,
        )
        path, axes = picture_options.get("path"), read_axes_option(picture_options)
        check_argument_class_or_unwrap_run("path", path, "str | Path | None", ())
        self._path, self._title, self._comm = path, picture_options.get("title"), comm
        self.has_legend = picture_options.get("legend", True)
        if axes is None:
            with rc_context(FIGURE_STYLE):
                figure = NotebookFigure(figsize=size)
            FigureCanvasAgg(figure)
            n_rows = -(-n_panels // n_columns)
            axes = figure.subplots(n_rows, n_columns, squeeze=False, sharex=sharex).ravel()
            for unused_panel in axes[n_panels:]:
                unused_panel.remove()
            axes = axes[:n_panels]
        elif path is not None:
            raise InputError(
                "path", str(path), "left out with axes; save the returned figure by savefig(path)"
            )
        supported_file_types = sorted(FigureCanvasAgg.get_supported_filetypes())
        if path is not None and Path(path).suffix[1:].lower() not in ["", *supported_file_types]:
            raise InputError(
                "path", str(path), f"a file name that ends in .{', .'.join(supported_file_types)}"
            )
        self.panels: list[Axes] = list(np.atleast_1d(axes).ravel())
        if len(self.panels) != n_panels:
            raise InputError(
                "axes", f"{len(self.panels)} axes", f"{n_panels} axes, one for each panel"
            )
        self.figure: Figure = self.panels[0].figure

    def __iter__(self) -> Iterator[Axes]:
        return iter(self.panels)

    def draw_legends_and_save(self) -> Figure:
        """Draw grids and legends, set the title, save the figure (collective).

        The figure is saved only if the options have a path. Return the figure.
        """
        for panel in self:
            with rc_context(FIGURE_STYLE):
                panel.grid(alpha=FIGURE_STYLE["grid.alpha"])
                if self.has_legend:
                    _draw_legend(panel)
        return self.save_with_title()

    def save_with_title(self) -> Figure:
        """Set the title, save the figure and return it (collective).

        The figure is saved only if the options have a path.
        """
        if self._title is not None and len(self.panels) > 1:
            self.figure.suptitle(self._title, fontsize="large")
        elif self._title is not None:  # makes way for axes on the top
            self.panels[0].set_title(self._title, y=None if self.panels[0].child_axes else 1.0)
        if self._path is not None:
            picture_path = Path(self._path)
            begin_stage(picture_path.name)

            def write_file() -> None:
                if picture_path.suffix == ".png":
                    picture_bytes = render_png(self.figure)
                else:
                    picture_stream = BytesIO()
                    with rc_context(FIGURE_STYLE):
                        self.figure.savefig(
                            picture_stream, format=picture_path.suffix.removeprefix(".") or None
                        )
                    picture_bytes = picture_stream.getvalue()
                write_file_whole(picture_path, picture_bytes)

            on_root(self._comm, write_file)
        return self.figure


def render_png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file.

    The figure is drawn once; Matplotlib's ``savefig`` would draw twice.
    """
    canvas, png_stream = FigureCanvasAgg(figure), BytesIO()
    canvas.draw()
    copy_canvas_image(canvas).save(
        png_stream, "PNG", compress_level=3, dpi=(figure.dpi, figure.dpi)
    )
    return png_stream.getvalue()


def copy_canvas_image(canvas: FigureCanvasAgg) -> Image.Image:
    """Return a copy of the image on a canvas, without transparency."""
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def magnification_to_tenth(vectors: np.ndarray, size: float) -> float:
    """Return the factor that makes the longest vector a tenth of ``size``.

    ``vectors`` are (..., d), in any unit. The factor is 1 if all vectors are zero.
    """
    largest_norm = np.linalg.norm(vectors, axis=-1).max()
    return float(0.1 * size / largest_norm) if largest_norm > 0.0 else 1.0


def read_axes_option(picture_options: PictureOptions) -> Any:
    """Return the option ``axes`` or ``ax``; None if neither is given.

    Raises InputError if both are given.
    """
    axes, ax = picture_options.get("axes"), picture_options.get("ax")
    if axes is not None and ax is not None:
        raise InputError("ax", ax, "left out with axes; give one of the two")
    return axes if ax is None else ax


def distinct_colours(n_colours: int) -> list[str]:
    """Return a list with ``n_colours`` different colours for lines.

    Up to five colours are taken from :data:`CURVE_COLOUR_CODE_BY_NAME`. If more are needed, all are
    taken from a scale from dark to light.
    """
    if n_colours <= len(CURVE_COLOUR_CODE_BY_NAME):
        return list(CURVE_COLOUR_CODE_BY_NAME.values())[:n_colours]
    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.0, 0.95, n_colours))]


def wrap_upright_label(label: str) -> str:
    """Break the label of a vertical axis into lines of at most 42 letters.

    A label with line breaks stays unchanged.
    """
    return label if "\n" in label else fill(label, MAX_LETTERS_PER_LABEL_LINE)


def label_axis(axis: Axis, quantity: str, unit: str) -> None:
    """Label an axis, and show its SI values in the unit with a suitable prefix.

    Call this after all lines are drawn, since the largest value chooses the prefix. A logarithmic
    axis over more than five decades has powers of ten as tick labels, otherwise plain numbers.
    """
    unit_factor, prefixed_unit = 1.0, unit
    if unit not in UNITS_WITHOUT_PREFIX:
        unit_factor, prefixed_unit = choose_factor_and_prefixed_unit(
            float(np.abs(axis.get_data_interval()).max()), unit
        )
    label = heading_with_unit(quantity, prefixed_unit).replace("m^0.5", "√m")
    axis.set_label_text(wrap_upright_label(label) if axis.axis_name == "y" else label)
    view_minimum, view_maximum = axis.get_view_interval()
    if axis.get_scale() != "log":
        axis.set_major_formatter(
            FuncFormatter(lambda value, _: _format_number(round(unit_factor * value, 12)))
        )
    elif (n_decades := np.log10(view_maximum / view_minimum)) > 5.0:
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(
            FuncFormatter(lambda value, _: _format_power_of_ten(unit_factor * value))
        )
    else:  # over few decades, minor ticks have labels, too; each tick takes time to draw
        if n_decades > 2.0:
            axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_major_formatter(_ScaledLogFormatter(unit_factor))
        axis.set_minor_formatter(_ScaledLogFormatter(unit_factor, minor_thresholds=(2.0, 0.8)))


def label_count_axis(axis: Axis, plural_noun: str) -> None:
    """Label a linear axis of counts with a power of ten: "10⁶ load cycles".

    Call this after all lines are drawn, since the largest count chooses the power.
    """
    count_scale_factor, _ = choose_factor_and_prefixed_unit(float(axis.get_data_interval()[1]), "")
    axis.set_label_text(
        plural_noun
        if count_scale_factor == 1.0
        else f"{_format_power_of_ten(1.0 / count_scale_factor)} {plural_noun}"
    )
    axis.set_major_formatter(
        FuncFormatter(lambda value, _: _format_number(round(count_scale_factor * value, 12)))
    )


class _ScaledLogFormatter(LogFormatter):
    """Formatter of logarithmic axes: plain numbers, 0.1, 1, 10, in a unit with a prefix.

    ``unit_factor`` converts from the SI unit.
    """

    def __init__(self, unit_factor: float, **options: Any) -> None:
        super().__init__(**options)
        self.unit_factor = unit_factor

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the label of a tick; empty for a tick without a label.

        ``x`` is the tick's value in SI units, ``pos`` the tick's index on the axis.
        """
        return _format_number(self.unit_factor * x) if super().__call__(x, pos) else ""


def _format_number(value: float) -> str:
    return str(Formatter.fix_minus(f"{value + 0.0:.10g}"))


def _format_power_of_ten(value: float) -> str:
    return "10" + str(round(np.log10(value))).translate(SUPERSCRIPT_TRANSLATION)


def _draw_legend(axes: Axes) -> None:
    """Draw the legend of a panel, if any line has a label.

    If the figure has no layout engine, matplotlib chooses the place. With a layout engine, the
    legend stands below the panel, in columns. The legend's width is at most 0.9 times the figure's
    width; with several panels, at most the panel's width. A figure with a single panel becomes
    higher if the legend has more than two rows.
    """
    handles, labels = axes.get_legend_handles_labels()
    labelled_handles = sorted(
        zip(labels, handles, strict=True),
        key=lambda labelled_handle: (
            not isinstance(labelled_handle[1], Artist)
            or labelled_handle[1].get_gid() != FIRST_IN_LEGEND_GID
        ),
    )
    handles_by_label = dict(labelled_handles)
    if handles_by_label and axes.figure.get_layout_engine() is not None:
        is_only_panel = len(axes.figure.axes) == 1
        available_width = (
            0.9 * axes.figure.bbox.width if is_only_panel else axes.get_window_extent().width
        )
        n_letters_across = 17.0 * available_width / axes.figure.dpi
        allowed_letters_per_line = max(int(n_letters_across) - 8, MAX_LETTERS_PER_LABEL_LINE)
        label_lines = [
            [
                wrapped_line
                for line in label.splitlines()
                for wrapped_line in wrap(line, allowed_letters_per_line)
            ]
            for label in handles_by_label
        ]
        handles_by_label = dict(
            zip(map("\n".join, label_lines), handles_by_label.values(), strict=True)
        )
        n_letters_of_longest_line = max(len(line) for label in label_lines for line in label)
        n_columns = max(
            1, min(len(handles_by_label), int(n_letters_across / (n_letters_of_longest_line + 8)))
        )
        n_labels_per_column = -(-len(handles_by_label) // n_columns)
        previous_legend = axes.get_legend()
        first_label_indices_of_columns = range(0, len(label_lines), n_labels_per_column)
        n_text_rows = max(
            2,
            *(
                sum(
                    map(
                        len,
                        label_lines[first_label_index : first_label_index + n_labels_per_column],
                    )
                )
                for first_label_index in first_label_indices_of_columns
            ),
        )
        # A figure has room for two rows.
        n_extra_rows = n_text_rows - (
            2 if previous_legend is None else int(previous_legend.get_gid())
        )
        if is_only_panel:
            axes.figure.set_figheight(axes.figure.get_figheight() + 0.17 * n_extra_rows)
        has_tick_labels = axes.xaxis.get_major_ticks()[0].label1.get_visible()
        axes.legend(
            list(handles_by_label.values()),
            list(handles_by_label),
            loc="upper center",
            ncol=n_columns,
            frameon=False,
            bbox_to_anchor=(0.5, 0.0),
            borderaxespad=4.2 if has_tick_labels else 0.8,  # [em]
        ).set_gid(str(n_text_rows))
    elif handles_by_label:
        axes.legend(list(handles_by_label.values()), list(handles_by_label), loc="best")
