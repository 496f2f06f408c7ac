"""Draw motions: waves, contact laws, contact maps, responses, spectra, orbits, friction loops.

Further pictures are maps over two swept quantities, and stress intensities at crack tips.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice, product
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import choose_factor_and_prefixed_unit, format_quantity
from fenics_crack.draw.figure import (
    CURVE_COLOUR_CODE_BY_NAME,
    FIGURE_STYLE,
    Picture,
    PictureOptions,
    distinct_colours,
    label_axis,
    read_axes_option,
    wrap_upright_label,
)
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.contact import ContactLaw, friction_coefficient_of, is_rigid
from fenics_crack.model.nodes import AXES, Pairs
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import friction_losses, is_slipping
from fenics_crack.numerics.equations import CENTRAL_DIFFERENCE_STEP
from fenics_crack.numerics.fourier import to_complex

if TYPE_CHECKING:  # which loads DOLFINx
    from fenics_crack.runs.stress_intensity import StressIntensity

UNSTABLE_OR_INACCURATE_LABEL = f"not stable, or estimated error above {100 * LARGE_ERROR:g} %"
"""Legend entry of doubtful points of a curve or cells of a map, with the limit of 5 %."""
DOUBTFUL_HATCH_COLOUR = "#ffffff"
"""Colour of the lines that hatch doubtful cells of a map: white."""
NO_VALUE_COLOUR, OPEN_CRACK_COLOUR = "#b5b5b5", "#e8e8e8"
"""Greys of a map's cells without a value, and of times and places where a crack is open."""


@dataclass(frozen=True)
class Wave:
    """Curve of a displacement over time, for :func:`draw_waves`.

    Attributes
    ----------
    label : str
        Legend entry.
    colour : str
        "blue", "orange", "green", "pink", "grey", or any colour known to matplotlib.
    style : str
        Matplotlib's line style.
    time, values : (n,) [s], (n,) [m]
        Instants and displacements.
    spread : (n,) [m] or None
        Half-width of a band around the curve, for example the standard deviation of a mean wave.
    width : float [points]
        Line width; a wide line stays visible below a thin line.
    """

    label: str
    time: np.ndarray
    values: np.ndarray
    colour: str = "blue"
    style: str = "-"
    spread: np.ndarray | None = None
    width: float = 1.6


def draw_waves(
    waves: Sequence[Wave],
    *,
    quantity: str,
    period: float | None = None,
    zero: str | None = None,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw displacements over time.

    Parameters
    ----------
    waves : sequence of Wave
        Curves to draw.
    quantity : str
        Label of the vertical axis, without the unit.
    period : float [s], optional
        Load period; the time axis then shows time over this period, otherwise seconds.
    zero : str, optional
        Legend entry of a horizontal line at zero, for example "crack faces touch"; default: no
        line.
    **picture_options
        ``axes`` or ``ax``: axes to draw on, by default those of a new figure; ``path``: file for
        the new figure; ``title`` of the picture; ``legend=False``: no legend.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Examples
    --------
    >>> time = np.linspace(0.0, solution.period, 200)
    >>> wave = fc.Wave("tip", time, solution.displacement(time, [tip])[:, 0])
    >>> figure = fc.draw_waves([wave], quantity="displacement", path="waves.png")
    """
    if not isinstance(quantity, str):
        raise InputError("quantity", quantity, "a text, such as 'displacement'")
    [panel] = picture = Picture(**picture_options)
    for wave in waves:
        time = wave.time / period if period else wave.time
        colour = CURVE_COLOUR_CODE_BY_NAME.get(wave.colour, wave.colour)
        panel.plot(time, wave.values, wave.style, color=colour, label=wave.label, lw=wave.width)
        if wave.spread is not None:
            lower_edge, upper_edge = wave.values - wave.spread, wave.values + wave.spread
            panel.fill_between(time, lower_edge, upper_edge, color=colour, alpha=0.2, lw=0)
    if zero is not None:
        panel.axhline(0.0, color=CURVE_COLOUR_CODE_BY_NAME["grey"], lw=0.8, label=zero)
    if period:
        panel.set_xlabel("time / load period")
    else:
        label_axis(panel.xaxis, "time", "s")
    label_axis(panel.yaxis, quantity, "m")
    return picture.draw_legends_and_save()


def draw_laws(
    laws: Mapping[str, ContactLaw], closing: np.ndarray, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw contact forces [N] over the gap [m] for several contact laws.

    Parameters
    ----------
    laws : mapping of str to ContactLaw
        Laws by the labels of their lines.
    closing : (n,) [m]
        Gaps of the pair, > 0 in penetration.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Examples
    --------
    >>> closing = np.linspace(-1e-6, 1e-6, 101)
    >>> figure = fc.draw_laws({"penalty": contact}, closing, path="laws.png")
    """
    [panel] = picture = Picture(**picture_options)
    colours_and_line_styles = zip(
        distinct_colours(len(laws)), cycle(("-", "--", ":", "-.", "-")), strict=False
    )
    for (label, law), (colour, style) in zip(laws.items(), colours_and_line_styles, strict=True):
        contact_force = law.force(closing[:, None])[:, 0]
        panel.plot(closing, contact_force, style, color=colour, label=label, lw=1.8)
    label_axis(panel.xaxis, "closing g (penetration where g > 0)", "m")
    label_axis(panel.yaxis, "contact force", "N")
    return picture.draw_legends_and_save()


def draw_contact_map(
    solution: PeriodicSolution, *, instants: int = 400, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw contact along the crack and over the period.

    If contact is rigid, or has a stiffness per area, colours show the contact pressure. Otherwise
    colours show the force of each pair. Open pairs are grey. Several cracks stand one above the
    other, with a line between them.

    In a solid, each crack has two panels instead. The first shows the largest pressure or force in
    the period. The second shows the fraction of the period in which the pair is closed.

    Parameters
    ----------
    solution : PeriodicSolution
        Solution with two or more contact pairs.
    instants : int
        Number of instants in the period.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The structure has fewer than two pairs, or no mesh.

    Examples
    --------
    >>> figure = fc.draw_contact_map(solution, path="contact.png")
    """
    structure, law = solution.structure, solution.contact
    pair_points = structure.pair_points
    if pair_points is None or len(pair_points) < 2:
        raise InputError(
            "pairs", structure.n_pairs, "two or more contact pairs of a structure from a mesh"
        )
    time = np.linspace(0.0, solution.period, instants + 1)
    contact_values, label, unit = solution.contact_force(time), "contact force of a pair", "N"
    has_pressure = law is not None and (is_rigid(law) or np.ndim(law.stiffness) > 0)
    if structure.pair_areas is not None and has_pressure:
        contact_values = contact_values / structure.pair_areas
        label, unit = "contact pressure", "Pa"
    unit_factor, unit = choose_factor_and_prefixed_unit(float(contact_values.max()), unit)
    if pair_points.shape[1] == 3:
        values_by_label = {f"largest {label} [{unit}]": unit_factor * contact_values.max(axis=0)}
        values_by_label["share of the period closed"] = (contact_values[:-1] > 0.0).mean(axis=0)
        return _draw_crack_surfaces(structure, values_by_label, picture_options)
    pair_distances, crack_borders = _stack_crack_distances_and_borders(structure.pairs)
    times_in_load_periods = time * solution.omega / (2.0 * np.pi)
    [panel] = picture = Picture(**picture_options)
    contact_cells = np.ma.masked_less_equal(unit_factor * contact_values.T, 0.0)
    label = f"{label} [{unit}] (grey: open)"
    _draw_coloured_cells(
        panel, times_in_load_periods, pair_distances, contact_cells, label, OPEN_CRACK_COLOUR
    )
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("time / load period")
    for crack_border in crack_borders:
        panel.axhline(crack_border, color="black", lw=1.5)
    distance_text = "from the crack's left tip"
    if crack_borders:
        distance_text = f"along cracks 1 to {len(crack_borders) + 1}, one above the other"
    elif next(iter(structure.watched_pairs)) == "the mouth":
        distance_text = "from the crack's mouth"
    label_axis(panel.yaxis, f"distance {distance_text}", "m")
    return picture.save_with_title()


def _draw_crack_surfaces(
    structure: Structure, values_by_label: Mapping[str, np.ndarray], picture_options: PictureOptions
) -> Figure:
    """Draw values at a solid's contact pairs on each crack surface.

    Each crack has a row of panels, a panel for each label.

    Parameters
    ----------
    structure : Structure
        Structure with the contact pairs.
    values_by_label : mapping of str to (n_pairs,)
        Values at the contact pairs. The label is written at the colour bar.
    picture_options : PictureOptions
        Keywords of every ``draw_*`` function.
    """
    from scipy.spatial import cKDTree

    mesh, pairs = NodalMesh(structure.whole), structure.pairs
    facets = mesh.crack_face_sides
    triangles = facets if facets.shape[1] == 3 else facets[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    pair_tree = cKDTree(pairs.points)
    pair_crack_indices = (
        np.zeros(len(pair_tree.data), dtype=int) if pairs.cracks is None else pairs.cracks
    )
    triangle_crack_indices = pair_crack_indices[
        pair_tree.query(mesh.points[triangles].mean(axis=1))[1]
    ]
    distinct_crack_indices = np.unique(pair_crack_indices)
    picture = Picture(
        2 * len(distinct_crack_indices),
        n_columns=2,
        size=(9.0, 3.4 * len(distinct_crack_indices)),
        **picture_options,
    )
    for panel, (crack_index, label) in zip(
        picture, product(distinct_crack_indices, values_by_label), strict=True
    ):
        nodes, corner_rows_in_nodes = np.unique(
            triangles[triangle_crack_indices == crack_index], return_inverse=True
        )
        nodal_values = mesh.pair_centres_and_pressures_at_nodes[1][nodes] @ values_by_label[label]
        _draw_crack_surface(
            panel, mesh.points[nodes], corner_rows_in_nodes.reshape(-1, 3), nodal_values, label
        )
        if len(distinct_crack_indices) > 1:
            panel.set_title(f"crack {crack_index + 1}", fontsize="medium")
    return picture.save_with_title()


def _draw_crack_surface(
    axes: Axes, points: np.ndarray, triangles: np.ndarray, values: np.ndarray, label: str
) -> None:
    """Draw nodal values on a solid's crack surface.

    The view is along the coordinate axis in which the surface extends least.

    Parameters
    ----------
    points : (n, 3) [m]
        Nodes of the crack.
    triangles : (m, 3) int
        Three nodes of each triangle, as positions in ``points``.
    values : (n,)
        Values at the nodes, >= 0; the colour scale begins at 0.
    label : str
        Label of the colour bar.
    """
    normal_axis_index = int(np.argmin(np.ptp(points, axis=0)))
    horizontal_axis_index, vertical_axis_index = (
        coordinate_axis_index
        for coordinate_axis_index in range(3)
        if coordinate_axis_index != normal_axis_index
    )
    unit_factor, unit = choose_factor_and_prefixed_unit(
        float(np.abs(points[:, [horizontal_axis_index, vertical_axis_index]]).max()), "m"
    )
    plane_points = unit_factor * points[:, [horizontal_axis_index, vertical_axis_index]].T
    colour_mesh = axes.tripcolor(
        *plane_points,
        triangles,
        values,
        shading="gouraud",
        cmap="viridis",
        vmin=0.0,
        vmax=values.max() or 1.0,
    )
    axes.triplot(*plane_points, triangles, color="black", lw=0.2)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{AXES[horizontal_axis_index]} [{unit}]")
    axes.set_ylabel(f"{AXES[vertical_axis_index]} [{unit}]")
    axes.figure.colorbar(colour_mesh, ax=axes, orientation="horizontal", pad=0.25).set_label(label)


def _stack_crack_distances_and_borders(pairs: Pairs) -> tuple[np.ndarray, list[float]]:
    """Place the contact pairs of all cracks on a single axis, crack after crack.

    Returns
    -------
    distances : (n_pairs,) [m]
        Distance along the crack, plus the lengths of the cracks before and a space after each.
    crack_borders : list of float [m]
        Middles of the spaces between cracks; empty for a single crack.
    """
    assert pairs.cracks is not None and pairs.positions is not None
    distances = pairs.positions.copy()
    crack_spacing, crack_borders = 0.05 * float(distances.max()) or 1.0, []
    for first_pair in np.flatnonzero(np.diff(pairs.cracks)) + 1:
        distances[first_pair:] += distances[first_pair - 1] + crack_spacing
        crack_borders.append(0.5 * (distances[first_pair - 1] + distances[first_pair]))
    return distances, crack_borders


def draw_response(
    values: np.ndarray,
    curves: Mapping[str, np.ndarray],
    *,
    quantity: str,
    over: str = "load frequency [rad/s]",
    doubtful: Mapping[str, np.ndarray] | None = None,
    unit: str = "m",
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw amplitudes [m] or other quantities over the load frequency or another parameter.

    The vertical scale is logarithmic under two conditions: all values are positive, and the values
    are lengths or span a decade or more. A curve has dots if there are at most 60 values. A curve
    is interrupted at nan. Rings mark doubtful values. Repeated calls on the same axes choose new
    colours.

    Parameters
    ----------
    values : (n,)
        Values on the horizontal axis: load frequencies [rad/s], or the quantity named by ``over``.
    curves : mapping of str to (n,) arrays
        Quantities to draw; the key is the line's legend entry.
    quantity : str
        Label of the vertical axis, without the unit.
    over : str
        Label of the horizontal axis, with its unit.
    doubtful : mapping of str to (n,) bool, optional
        For each key in ``curves``, True for values to mark with a ring. Doubtful values are not
        stable, or have an estimated error above 5 %.
    unit : str
        SI unit of the curves; the axis shows the unit with a prefix, such as mm.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        There is no curve.

    Examples
    --------
    >>> curves = {"tip": curve.amplitude(tip)}
    >>> figure = fc.draw_response(curve.omega, curves, quantity="displacement", path="response.png")
    """
    if not curves:
        raise InputError("curves", curves, "a dict of at least one curve, {label: values}")
    [panel] = picture = Picture(**picture_options)
    values = np.asarray(values)
    curves = {label: np.asarray(y, float) for label, y in curves.items()}
    finite_values = np.concatenate(
        [curve_values[np.isfinite(curve_values)] for curve_values in curves.values()]
    )
    smallest_finite_value, largest_finite_value = (
        finite_values.min(initial=np.inf),
        finite_values.max(initial=-np.inf),
    )
    if 0.0 < smallest_finite_value < np.inf and (
        unit == "m" or 10.0 * smallest_finite_value <= largest_finite_value
    ):
        panel.set_yscale("log")
    n_present_lines = sum(line.get_linestyle() != "None" for line in panel.lines)
    line_styles_and_colours = islice(
        cycle(product((".-", ".--", ".:"), CURVE_COLOUR_CODE_BY_NAME.values())),
        n_present_lines,
        None,
    )
    dot_size = 4.0 if len(values) <= 60 else 0.0  # more dots would touch
    for (label, curve_values), (style, colour) in zip(
        curves.items(), line_styles_and_colours, strict=False
    ):
        panel.plot(values, curve_values, style, color=colour, label=label, lw=1.4, ms=dot_size)
    is_doubtful_by_label = {
        label: np.asarray(is_doubtful, bool) for label, is_doubtful in (doubtful or {}).items()
    }
    doubtful_points = [
        (values[is_doubtful], curves[label][is_doubtful])
        for label, is_doubtful in is_doubtful_by_label.items()
    ]
    if any(len(x) for x, _ in doubtful_points):
        x, y = np.concatenate(doubtful_points, axis=1)
        panel.plot(
            x,
            y,
            "o",
            color=CURVE_COLOUR_CODE_BY_NAME["grey"],
            mfc="none",
            ms=dot_size + 4.0,
            label=UNSTABLE_OR_INACCURATE_LABEL,
        )
    panel.set_xlabel(over)
    label_axis(panel.yaxis, quantity, unit)
    return picture.draw_legends_and_save()


def draw_map(
    x: np.ndarray,
    y: np.ndarray,
    values: np.ndarray,
    *,
    x_label: str,
    y_label: str,
    value_label: str,
    doubtful: np.ndarray | None = None,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw values as colours over two swept quantities.

    The colour scale is logarithmic if all values are positive and the largest is at least 30 times
    the smallest.

    Parameters
    ----------
    x, y : (n,), (m,)
        Two or more ascending values of each swept quantity.
    values : (m, n)
        Values to draw. nan marks a combination (x, y) without a converged solution; its cell is
        grey, with a cross.
    x_label, y_label, value_label : str
        Labels with units.
    doubtful : (m, n) bool, optional
        True for hatched cells: not stable, or estimated error above 5 %.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The shapes do not fit, a quantity does not rise, or there is no finite value.

    Examples
    --------
    >>> x, y = np.linspace(0.0, 1.0, 3), np.linspace(0.0, 1.0, 2)
    >>> figure = fc.draw_map(
    ...     x, y, np.outer(1.0 + y, x), x_label="x [m]", y_label="y [m]", value_label="z [m]")
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    for axis_name, coordinates in (("x", x), ("y", y)):
        if coordinates.ndim != 1 or len(coordinates) < 2 or not np.all(np.diff(coordinates) > 0.0):
            raise InputError(axis_name, coordinates, "two or more increasing numbers")
    cell_values = np.ma.masked_invalid(np.asarray(values, dtype=float))
    if cell_values.shape != (len(y), len(x)):
        raise InputError(
            "values", cell_values.shape, f"an array of shape (len(y), len(x)) = {len(y), len(x)}"
        )
    if not cell_values.count():
        raise InputError("values", "nan", "an array with at least one finite number")
    smallest_cell_value, largest_cell_value = float(cell_values.min()), float(cell_values.max())
    colour_norm = (
        LogNorm if 0.0 < 30.0 * smallest_cell_value <= largest_cell_value else Normalize
    )(smallest_cell_value, largest_cell_value)
    is_doubtful = (
        np.zeros(cell_values.shape, bool) if doubtful is None else np.asarray(doubtful, bool)
    )
    if is_doubtful.shape != cell_values.shape:
        raise InputError(
            "doubtful", is_doubtful.shape, f"an array of the shape of values, {cell_values.shape}"
        )
    [panel] = picture = Picture(**picture_options)
    _draw_coloured_cells(panel, x, y, cell_values, value_label, NO_VALUE_COLOUR, norm=colour_norm)
    is_missing = np.ma.getmaskarray(cell_values)
    panel.plot(
        *(
            cell_centre_coordinates.ravel()[is_missing.ravel()]
            for cell_centre_coordinates in np.meshgrid(x, y)
        ),
        "x",
        color="white",
        ms=5,
    )
    legend_patches = (
        [Patch(facecolor=NO_VALUE_COLOUR, label="not converged")] if is_missing.any() else []
    )
    if np.any(is_doubtful & ~is_missing):
        doubtful_hatch_options = {
            "edgecolor": DOUBTFUL_HATCH_COLOUR,
            "hatch": "/////",
            "linewidth": 0.0,
        }
        doubtful_values = np.ma.masked_where(~is_doubtful, cell_values)
        panel.pcolor(x, y, doubtful_values, shading="nearest").set(
            facecolor="none", **doubtful_hatch_options
        )
        legend_patches.append(
            Patch(label=UNSTABLE_OR_INACCURATE_LABEL, facecolor="#3b528b", **doubtful_hatch_options)
        )
    panel.set(xlabel=x_label, ylabel=y_label)
    if legend_patches and picture.has_legend:
        with rc_context(FIGURE_STYLE):
            panel.legend(
                handles=legend_patches,
                ncol=2,
                handlelength=3.0,
                frameon=False,
                loc="upper center",
                bbox_to_anchor=(0.5, 0.0),
                borderaxespad=4.2,
            )
    return picture.save_with_title()


def _draw_coloured_cells(
    axes: Axes,
    x: np.ndarray,
    y: np.ndarray,
    values: Any,
    label: str,
    masked_colour: str,
    **mesh_options: Any,
) -> None:
    """Draw a masked array (len(y), len(x)) as coloured cells, with a colour bar.

    Masked cells have ``masked_colour``. ``label`` is the colour bar's label; ``mesh_options`` go to
    matplotlib's ``pcolormesh``.
    """
    axes.set_facecolor(masked_colour)
    cell_mesh = axes.pcolormesh(x, y, values, cmap="viridis", shading="nearest", **mesh_options)
    axes.figure.colorbar(cell_mesh, ax=axes, label=wrap_upright_label(label)).minorticks_off()


# --- harmonics, orbits, tips ----------------------------------------------------------------------


def draw_spectrum(
    solution: PeriodicSolution, dof: int | None = None, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw the amplitudes of the harmonics over their orders (collective).

    The upper panel shows the gap of the contact pair that moves most, and the displacement of a
    dof. The lower panel shows the contact force, summed over the pairs. Order 0 is the mean, and
    order 1 the load frequency. A subharmonic response also has fractional orders. If the last
    amplitudes are small, the solution has enough harmonics.

    Parameters
    ----------
    solution : PeriodicSolution
        Result to draw.
    dof : int, optional
        Dof whose displacement is drawn; default: no displacement.
    **picture_options
        ``axes`` (one, or two with the force), ``path``, ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        There is neither a pair nor a dof, or the number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_spectrum(solution, tip, path="spectrum.png")
    """
    displacement_coefficients_by_label = {}
    if solution.structure.n_pairs:
        instants = np.linspace(0.0, solution.period, 257)
        pair_index = int(np.argmax(np.ptp(solution.gap(instants), axis=0)))
        displacement_coefficients_by_label[
            f"gap {solution.structure.describe_pair(pair_index)}"
        ] = solution.gap_coefficients[:, pair_index]
    if dof is not None:
        dof_coefficients = solution.coefficients_at([dof])[:, 0]
        displacement_coefficients_by_label[solution.structure.dof_name(dof)] = dof_coefficients
    if not displacement_coefficients_by_label:
        raise InputError("dof", None, "given: a dof's number, as there is no contact pair")
    force_coefficients = solution.force_coefficients.sum(axis=1)
    axes = read_axes_option(picture_options)
    n_panels = 1 + bool(np.any(force_coefficients)) if axes is None else min(2, np.size(axes))
    picture = Picture(
        n_panels,
        size=(7.0, 2.4 + 2.2 * n_panels),
        sharex=True,
        comm=solution.structure.comm,
        **picture_options,
    )
    panel_contents = (
        (displacement_coefficients_by_label, "displacement", "m"),
        ({"contact force, all pairs": force_coefficients}, "contact force", "N"),
    )
    for panel, panel_content in zip(picture, panel_contents, strict=False):
        _draw_stems(panel, solution.subharmonic, *panel_content)
    picture.panels[-1].set_xlabel("order of the harmonic, in load frequencies (0: mean)")
    return picture.draw_legends_and_save()


def _draw_stems(
    axes: Axes,
    n_load_periods: int,
    coefficients_by_label: Mapping[str, np.ndarray],
    quantity: str,
    unit: str,
) -> None:
    """Draw Fourier amplitudes over the order, as vertical lines (stems) side by side.

    The scale is logarithmic; amplitudes below 1e-9 of the largest are left out as rounding. More
    than 150 harmonics are drawn as points without stems.

    Parameters
    ----------
    axes : Axes
        Panel to draw on.
    n_load_periods : int
        Number of load periods in the motion's period. Harmonic k then has the order k /
        ``n_load_periods``.
    coefficients_by_label : mapping of str to (2H+1,)
        For each legend entry: the mean, then cosine and sine coefficients for harmonics 1 to H.
    quantity, unit : str
        Quantity and SI unit of all coefficients, for the vertical axis.
    """
    amplitudes_by_label = {
        label: np.abs(to_complex(column)) for label, column in coefficients_by_label.items()
    }
    amplitudes = np.array([*amplitudes_by_label.values()])
    largest_amplitude, max_harmonic = float(amplitudes.max()) or 1.0, amplitudes.shape[1] - 1
    is_significant = amplitudes > 1e-9 * largest_amplitude  # others are rounding
    smallest_amplitude = np.min(amplitudes, where=is_significant, initial=0.1 * largest_amplitude)
    axis_bottom = 10.0 ** np.floor(np.log10(0.5 * smallest_amplitude))
    marker_size = 4.5 if max_harmonic < 25 else 3.0 if max_harmonic <= 150 else 1.5
    series_styles = zip(
        amplitudes_by_label.items(), distinct_colours(len(amplitudes_by_label)), "os", strict=False
    )
    for series_index, ((label, series_amplitudes), colour, marker) in enumerate(series_styles):
        kept_harmonics = np.flatnonzero(series_amplitudes >= axis_bottom)
        stem_positions = (
            kept_harmonics + 0.25 * (series_index - 0.5 * (len(amplitudes_by_label) - 1))
        ) / n_load_periods
        if marker_size > 1.5:
            axes.vlines(
                stem_positions, axis_bottom, series_amplitudes[kept_harmonics], color=colour, lw=1.2
            )
        axes.plot(
            stem_positions,
            series_amplitudes[kept_harmonics],
            marker,
            color=colour,
            ms=marker_size,
            label=label,
        )
    axes.set_xlim(-0.5, max_harmonic / n_load_periods + 0.5)
    axes.set_yscale("log")
    axes.set_ylim(axis_bottom, largest_amplitude * (largest_amplitude / axis_bottom) ** 0.08)
    axes.xaxis.get_major_locator().set_params(integer=True)
    label_axis(axes.yaxis, f"amplitude of the\n{quantity}", unit)


def draw_orbits(
    solution: PeriodicSolution,
    dof: int | None = None,
    *,
    instants: int = 2000,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw the motion in the phase plane, velocity over displacement (collective).

    One panel shows the gap at the first crack's mouth, or in the middle of an internal crack.
    Another panel shows the displacement of a dof. The gap's orbit is thick while the drawn contact
    pair is closed. The dof's orbit is thick while any pair is closed. A dot marks the beginning of
    each load period; the motion runs clockwise.

    Parameters
    ----------
    solution : PeriodicSolution
        Result to draw.
    dof : int, optional
        Dof whose displacement is drawn; default: no displacement.
    instants : int
        Number of drawn points in a period.
    **picture_options
        ``axes``, one or two, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        There is neither a pair nor a dof, or the number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_orbits(solution, tip, path="orbits.png")
    """
    times = np.linspace(0.0, solution.period, instants + 1)
    is_closed = solution.contact_force(times) > 0.0
    arguments_of_each_orbit: list[tuple[DisplacementFunction, np.ndarray, str, str]] = []
    if solution.structure.n_pairs:
        pair_index = solution.structure.first_watched_pair
        arguments_of_each_orbit.append(
            (
                lambda t: solution.gap(t)[:, pair_index],
                is_closed[:, pair_index],
                f"closing {solution.structure.describe_pair(pair_index)}",
                "crack faces touch there",
            )
        )
    if dof is not None:
        arguments_of_each_orbit.append(
            (
                partial(solution.displacement, dofs=[dof]),
                np.any(is_closed, axis=1),
                solution.structure.dof_name(dof),
                "crack faces touch somewhere",
            )
        )
    if not arguments_of_each_orbit:
        raise InputError("dof", None, "given: a dof's number, as there is no contact pair")
    n_panels = len(arguments_of_each_orbit)
    picture = Picture(
        n_panels,
        n_columns=n_panels,
        size=(1.0 + 4.2 * n_panels, 4.4),
        comm=solution.structure.comm,
        **picture_options,
    )
    for panel, orbit_arguments in zip(picture, arguments_of_each_orbit, strict=True):
        _draw_orbit(panel, solution, *orbit_arguments)
    return picture.draw_legends_and_save()


DisplacementFunction = Callable[[np.ndarray], np.ndarray]
"""Function of instants (n,) [s] that returns the displacement of a dof or a gap [m]."""


def _draw_orbit(
    axes: Axes,
    solution: PeriodicSolution,
    displacement_function: DisplacementFunction,
    is_closed: np.ndarray,
    quantity: str,
    closed_label: str,
) -> None:
    """Draw the orbit of one displacement, thick while the crack is closed.

    Velocities are central differences of the displacement.

    Parameters
    ----------
    axes : Axes
        Panel to draw on.
    solution : PeriodicSolution
        Solution with the motion.
    displacement_function : callable
        Returns the displacement [m] at given instants [s].
    is_closed : (n,) bool
        True while the crack is closed, at n equally spaced instants from 0 to the period's end.
    quantity : str
        Name of the displacement, for the axis.
    closed_label : str
        Legend entry for the thick part.
    """
    central_difference_time_step = CENTRAL_DIFFERENCE_STEP * solution.period

    def evaluate_orbit(time: np.ndarray) -> np.ndarray:
        displacement_before, displacement, displacement_after = (
            np.ravel(displacement_function(time + time_offset))
            for time_offset in (-central_difference_time_step, 0.0, central_difference_time_step)
        )
        return np.array(
            [
                displacement,
                (displacement_after - displacement_before) / (2.0 * central_difference_time_step),
            ]
        )

    orbit = evaluate_orbit(np.linspace(0.0, solution.period, len(is_closed)))
    axes.plot(*orbit, color=CURVE_COLOUR_CODE_BY_NAME["blue"], lw=1.4, label="orbit")
    if is_closed.any():
        axes.plot(
            *np.where(is_closed, orbit, np.nan),
            color=CURVE_COLOUR_CODE_BY_NAME["orange"],
            lw=3.2,
            label=closed_label,
        )
    load_period_start_points = evaluate_orbit(
        2.0 * np.pi / solution.omega * np.arange(solution.subharmonic)
    )
    axes.plot(*load_period_start_points, "o", color="black", ms=5.5, label="a load period begins")
    label_axis(axes.xaxis, quantity, "m")
    label_axis(axes.yaxis, "velocity", "m/s")
    axes.margins(0.08)


MAX_DRAWN_FRICTION_LOOPS = 4
"""Maximum number of drawn friction loops, for the pairs with the largest friction losses."""


def draw_friction_loops(
    solution: PeriodicSolution, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw the friction force over the tangential gap of contact pairs (collective).

    Drawn are the pairs with the largest friction losses, at most four. A loop is thick while the
    pair slips, and the loop's area is the friction loss [J] in a period.

    Parameters
    ----------
    solution : PeriodicSolution
        Solution with friction.
    **picture_options
        ``axes`` (one), ``path``, ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        There is no friction, or there are several axes.

    Examples
    --------
    >>> law = fc.CoulombFriction(fc.UnilateralPenalty(1e9), 0.3)
    >>> rubbing = fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=20)
    >>> figure = fc.draw_friction_loops(rubbing, path="loops.png")
    """
    friction_coefficient = friction_coefficient_of(solution.contact)
    if friction_coefficient is None:
        raise InputError("solution", repr(solution), "a solution with friction (CoulombFriction)")
    time = np.append(solution.instants(), solution.period)
    (_, tangential_gaps), (normal_forces, friction_forces) = (
        np.hsplit(normal_and_tangential_values, 2)
        for normal_and_tangential_values in solution.gaps_and_forces(time)
    )
    is_slipping_by_time_and_pair = is_slipping(friction_coefficient, normal_forces, friction_forces)
    losses = friction_losses(tangential_gaps, friction_forces)
    [panel] = picture = Picture(size=(6.4, 4.6), comm=solution.structure.comm, **picture_options)
    drawn_pairs = np.argsort(-losses, kind="stable")[: min(MAX_DRAWN_FRICTION_LOOPS, len(losses))]
    for pair_index, colour in zip(
        drawn_pairs.tolist(), distinct_colours(len(drawn_pairs)), strict=True
    ):
        place_name = solution.structure.describe_pair(pair_index).removeprefix("of ")
        pair_gaps, pair_forces = tangential_gaps[:, pair_index], friction_forces[:, pair_index]
        label = f"{place_name}: {format_quantity(float(losses[pair_index]), 'J')}"
        panel.plot(pair_gaps, pair_forces, color=colour, lw=1.1, label=label)
        slipping_gaps = np.where(is_slipping_by_time_and_pair[:, pair_index], pair_gaps, np.nan)
        panel.plot(slipping_gaps, pair_forces, color=colour, lw=3.2)
    panel.axhline(0.0, color="black", lw=0.6)
    label_axis(panel.xaxis, "tangential gap", "m")
    label_axis(panel.yaxis, "friction force", "N")
    return picture.draw_legends_and_save()


def draw_stress_intensity(
    found: StressIntensity, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw stress intensity factors at crack tips or along crack fronts.

    For a plate, K_I and K_II at each tip are drawn over time. K_II is dashed. K_I is grey and thick
    while the tip is closed. For a solid there are two panels. The first panel shows the largest
    abs(K_I), abs(K_II) and abs(K_III) along the fronts. The second panel shows all three over time
    at a single front station, a point on a crack front. There the effective range of K_I over the
    period, important for crack growth, is largest.

    Parameters
    ----------
    found : StressIntensity
        Result of :func:`stress_intensity`.
    **picture_options
        ``axes``, ``path``, ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        There is not one axes object for each panel.

    Examples
    --------
    >>> figure = fc.draw_stress_intensity(fc.stress_intensity(fc.solve(scene)), path="tips.png")
    """
    n_panels = 1 if found.K_III is None else 2
    picture = Picture(n_panels, size=(7.0, 1.0 + 3.3 * n_panels), **picture_options)
    if found.K_III is None:
        _draw_intensities_of_tips(found, picture.panels[0])
    else:
        _draw_intensities_of_fronts(found, *picture)
    label_axis(picture.panels[-1].xaxis, "time", "s")
    for panel in picture:
        panel.axhline(0.0, color="black", lw=0.6)
        label_axis(panel.yaxis, "stress intensity", "Pa m^0.5")
    return picture.draw_legends_and_save()


def _draw_intensities_of_tips(intensity: StressIntensity, panel: Axes) -> None:
    """Draw K_I and K_II at each tip in a plate over time."""
    time = intensity.time - intensity.time[0]
    closed_label = "crack tip closed"
    for tip, colour, mode_one, mode_two in zip(
        intensity.tip_names,
        distinct_colours(len(intensity.tip_names)),
        intensity.K_I.T,
        intensity.K_II.T,
        strict=True,
    ):
        panel.plot(time, mode_one, color=colour, lw=1.8, label=f"K_I, {tip}")
        panel.plot(time, mode_two, color=colour, lw=1.0, ls="--", label=f"K_II, {tip}")
        is_closed = mode_one <= 0.01 * max(mode_one.max(), 0.0)  # to drawing accuracy
        if is_closed.any():
            panel.plot(
                time,
                np.where(is_closed, mode_one, np.nan),
                color=CURVE_COLOUR_CODE_BY_NAME["grey"],
                lw=4.0,
                label=closed_label,
            )
            closed_label = "_" + closed_label.lstrip("_")  # once in the legend


def _draw_intensities_of_fronts(
    intensity: StressIntensity, front_panel: Axes, time_panel: Axes
) -> None:
    """Draw stress intensity factors in a solid, along each crack front and over time.

    A station is a point on a crack front. The front panel shows the largest abs(K_I), abs(K_II) and
    abs(K_III) in time at each station. The time panel shows all three over time at a single
    station, with the largest effective range of K_I (``intensity.leading_tip_index``).
    """
    assert intensity.K_III is not None
    for component_name, component_values, colour in zip(
        ("K_I", "K_II", "K_III"),
        (intensity.K_I, intensity.K_II, intensity.K_III),
        distinct_colours(3),
        strict=True,
    ):
        time_panel.plot(
            intensity.time - intensity.time[0],
            component_values[:, intensity.leading_tip_index],
            color=colour,
            lw=1.8,
            label=f"_{component_name}",
        )
        label = component_name
        for station_indices in intensity.station_indices_by_front.values():
            front_panel.plot(
                intensity.distances_along_crack[station_indices],
                np.abs(component_values[:, station_indices]).max(axis=0),
                color=colour,
                lw=1.8,
                marker="o",
                label=label,
            )
            label = f"_{component_name}"  # once in the legend
    time_panel.set_title(
        f"at {intensity.tip_names[intensity.leading_tip_index]}", fontsize="medium"
    )
    label_axis(front_panel.xaxis, "distance along the front", "m")
