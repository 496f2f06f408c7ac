"""Draw results of studies: posteriors, verifications, crack growth, and rotors' diagrams.

Rotors have Campbell diagrams, arrivals at probes, and vibrations or resonances fitted to arrivals.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, product
from textwrap import fill
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.basics.causes import ERROR_CAUSES
from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.tables import (
    MIN_REPORTED_ERROR,
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    choose_frequency_factor_name_unit,
    choose_speed_factor_name_unit,
    format_quantity,
    heading_with_unit,
)
from fenics_crack.draw.figure import (
    COLOURS_BY_NAME,
    MAX_LETTERS_PER_LINE,
    Picture,
    PictureOptions,
    distinct_colours,
    label_axis,
    label_count_axis,
)
from fenics_crack.errors.convergence import ASYMPTOTIC_SAFETY_FACTOR
from fenics_crack.errors.verification import Verification
from fenics_crack.scene.keys import unit_of_key
from fenics_crack.scene.words import key_in_words

if TYPE_CHECKING:  # which load SciPy's interpolation, and DOLFINx
    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.arrivals.fit_order import TipTrack
    from fenics_crack.arrivals.harmonics import Candidates, TipFit
    from fenics_crack.arrivals.passages import PassageFit
    from fenics_crack.fatigue.growth import Growth
    from fenics_crack.monitoring.identification.result import Identification
    from fenics_crack.study.campbell import Campbell

CONTOUR_PROBABILITIES = (0.5, 0.95, 0.999)
"""Probabilities of the regions that a posterior's contours enclose."""
MARKER_LETTERS = "osD^v<>ph*"
"""Matplotlib's markers for quantities in the picture of a verification, in all colours."""
LABELS_BY_CAUSE = {"shift": "mesh, shift of the resonance"}
"""Legend entries of error causes whose names need more words; others are shown by name."""
StylesByQuantity = dict[str, dict[str, Any]]
"""Matplotlib's options for a line (marker, colour, size), by the name of the quantity."""


def draw_posterior(
    found: Identification,
    x: str | None = None,
    y: str | None = None,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw the posterior probability of one or two unknowns.

    For two unknowns, contours enclose 50, 95 and 99.9 % of the probability. For one unknown, a line
    shows the density, and a band the 95 % interval. All other unknowns are integrated out. If an
    unknown is a word, such as the crack's edge, each word has its own colour.

    Parameters
    ----------
    found : Identification
        Result of :func:`identify`.
    x, y : str, optional
        Keys of one or two unknowns; default: the first two, or the only unknown.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        A name is not an unknown, or both are the same.

    Examples
    --------
    >>> found = fc.identify(scene, "measured.csv")  # doctest: +SKIP
    >>> figure = fc.draw_posterior(found, path="posterior.png")  # doctest: +SKIP
    """
    x, *second_keys = [key for key in (x, y) if key is not None] or found.unknown[:2]
    for name, key in zip("xy", (x, *second_keys), strict=False):
        if key not in found.unknown or second_keys == [x]:
            raise InputError(
                name, key, f"one of {', '.join(found.unknown)}, with x different from y"
            )
    [panel] = picture = Picture(size=(6.0, 4.6), **picture_options)
    if not second_keys:
        _draw_density(panel, found, x)
        return picture.finish()
    [y] = second_keys
    x_index, y_index = (found.unknown.index(key) for key in (x, y))
    posterior = found.posterior
    grids_by_branch = {
        branch_name: (
            branch.axes[x_index],
            branch.axes[y_index],
            *posterior.compute_pair_mass_and_density(branch_name, x_index, y_index),
        )
        for branch_name, branch in posterior.branch_by_words.items()
    }
    log_levels = _contour_log_levels(list(grids_by_branch.values()))
    shown_points = [np.array([[found.estimate[x], found.estimate[y]]])]
    colours = distinct_colours(len(grids_by_branch))
    for (branch_name, (x_values, y_values, _, density)), colour in zip(
        grids_by_branch.items(), colours, strict=True
    ):
        grid_axes, log_density = (x_values, y_values), _log_density(density.T)
        if log_density.max() <= log_levels[0]:
            continue
        contour_options: dict[str, Any] = {"linewidths": [0.6, 1.2, 1.8], "linestyles": "solid"}
        panel.contour(*grid_axes, log_density, levels=log_levels, colors=colour, **contour_options)
        for level in log_levels:
            panel.contourf(
                *grid_axes, log_density, levels=[level, np.inf], alpha=0.2, colors=colour
            )
        label = f"50, 95 and 99.9 %{', ' if branch_name else ''}{branch_name}"
        panel.plot([], [], color=colour, lw=1.8, label=label)
        x_indices, y_indices = np.nonzero(log_density.T > log_levels[0])
        shown_points.append(np.column_stack([x_values[x_indices], y_values[y_indices]]))
    cross_options = {"color": "black", "ms": 10, "mew": 1.5, "clip_on": False}
    panel.plot(*shown_points[0].T, "+", label="estimate", **cross_options)
    branch_axes = next(iter(posterior.branch_by_words.values())).axes
    _set_limits(panel, np.concatenate(shown_points), (branch_axes[x_index], branch_axes[y_index]))
    label_axis(panel.xaxis, key_in_words(x), unit_of_key(x))
    label_axis(panel.yaxis, key_in_words(y), unit_of_key(y))
    return picture.finish()


def _draw_density(panel: Axes, identification: Identification, key: str) -> None:
    """Draw the probability density of the unknown ``key``, with estimate and 95 % interval.

    Each combination of words, such as the crack's edge, has its own line.
    """
    key_index, posterior = identification.unknown.index(key), identification.posterior
    interval_start, interval_end = identification.intervals[key]
    lines_by_branch = {}
    for branch_name, branch in posterior.branch_by_words.items():
        other_axes = tuple(k for k in range(len(branch.axes)) if k != key_index)
        density = posterior.grid_masses_by_words[branch_name].sum(
            axis=other_axes
        ) / branch.prior_masses.sum(axis=other_axes)
        unknown_values = np.unique([*branch.axes[key_index], interval_start, interval_end])
        lines_by_branch[branch_name] = (
            unknown_values,
            np.interp(unknown_values, branch.axes[key_index], density),
        )
    largest_density = max(density.max() for _, density in lines_by_branch.values())
    colours = distinct_colours(len(lines_by_branch))
    for (branch_name, (unknown_values, density)), colour in zip(
        lines_by_branch.items(), colours, strict=True
    ):
        panel.plot(
            unknown_values,
            density / largest_density,
            color=colour,
            label=branch_name or "probability",
        )
        is_inside = (unknown_values >= interval_start) & (unknown_values <= interval_end)
        band_options = {"color": colour, "alpha": 0.2, "lw": 0.0, "label": "95 %"}
        panel.fill_between(
            unknown_values[is_inside], density[is_inside] / largest_density, **band_options
        )
    panel.axvline(identification.estimate[key], color="black", ls="--", label="estimate")
    panel.set_ylim(bottom=0.0)
    label_axis(panel.xaxis, key_in_words(key), unit_of_key(key))
    panel.set_ylabel("probability density over the largest")


def _contour_log_levels(branch_grids: list[tuple[np.ndarray, ...]]) -> list[float]:
    """Return the log densities on the contours for 99.9, 95 and 50 % of the probability.

    The values are strictly ascending.

    Parameters
    ----------
    branch_grids : list of (x, y, mass, density)
        For each combination of words: grid values of both unknowns, and probability and density at
        each grid point.
    """
    probability_masses = np.concatenate([branch_grid[2].ravel() for branch_grid in branch_grids])
    log_densities = _log_density(
        np.concatenate([branch_grid[3].ravel() for branch_grid in branch_grids])
    )
    descending_order = np.argsort(-log_densities)
    cumulative_mass = np.cumsum(probability_masses[descending_order])
    level_positions = np.minimum(
        np.searchsorted(cumulative_mass, CONTOUR_PROBABILITIES), len(descending_order) - 1
    )[::-1]
    # Strictly ascending, also if one point holds several regions.
    return list(
        log_densities[descending_order[level_positions]] + 1e-6 * np.arange(len(level_positions))
    )


def _log_density(density: np.ndarray) -> np.ndarray:
    """Return the natural logarithm of a density; zeros count as 2.2e-308."""
    return np.log(np.maximum(density, np.finfo(float).tiny))


def _set_limits(
    panel: Any, shown_points: np.ndarray, branch_axes: tuple[np.ndarray, np.ndarray]
) -> None:
    """Limit a panel's axes to the shown points and a margin.

    The limits stay within the ranges of both unknowns.

    Parameters
    ----------
    shown_points : (n, 2)
        Points in the drawn regions.
    branch_axes : pair of (m,)
        Ascending grid values of both unknowns.
    """
    for coordinates, grid_values, set_limits in zip(
        shown_points.T, branch_axes, (panel.set_xlim, panel.set_ylim), strict=True
    ):
        margin = 0.35 * np.ptp(coordinates) + 0.02 * np.ptp(grid_values)
        set_limits(
            max(grid_values[0], coordinates.min() - margin),
            min(grid_values[-1], coordinates.max() + margin),
        )


def draw_verification(found: Verification, **picture_options: Unpack[PictureOptions]) -> Figure:
    """Draw the convergence of each quantity, and its uncertainty by cause.

    The first panel shows differences from the extrapolated value over the element size, or over the
    first varied cause if the mesh is not varied. Quantities that do not converge regularly have no
    line. The second panel has a row for each quantity: contributions of the causes, the marker of
    the first panel, and the observed order of convergence, the slope of its line. Hollow marks
    stand for a safety factor of 3, black bars for the root of the sum of squares.

    Parameters
    ----------
    found : Verification
        Result of :func:`verify`.
    **picture_options
        ``axes``, two of them, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Examples
    --------
    >>> found = fc.verify(scene)  # doctest: +SKIP
    >>> figure = fc.draw_verification(found, path="verification.png")  # doctest: +SKIP
    """
    figure_size = 13.0, max(4.2, 1.8 + 0.3 * len(found.values))
    convergence_panel, contribution_panel = picture = Picture(
        2, n_columns=2, size=figure_size, **picture_options
    )
    first_cause = next(iter(found.causes), "")
    styles_by_quantity = _choose_line_styles(found, first_cause) if first_cause else {}
    _draw_differences_from_extrapolation(convergence_panel, found, first_cause, styles_by_quantity)
    _draw_contributions(contribution_panel, found, styles_by_quantity)
    return picture.finish()


def _draw_differences_from_extrapolation(
    panel: Axes, verification: Verification, cause: str, styles_by_quantity: StylesByQuantity
) -> None:
    """Draw the differences |f_i - f| over the relative element size h_i.

    The differences are in percent of the quantity. The values f_i are from solutions in which
    ``cause`` was varied, and f is their extrapolation. Sizes are relative to the largest, mostly
    the scene's. For causes other than the mesh, h_i is the inverse number, for example of
    harmonics.
    """
    relative_sizes, largest_difference = np.ones(1), 100.0 * MIN_REPORTED_ERROR
    for quantity_name, line_options in styles_by_quantity.items():
        convergence = verification.parts[cause][quantity_name]
        distances = np.abs(np.array(convergence.values) - convergence.extrapolated)
        percent_differences = np.array(
            [100.0 * verification.relative(quantity_name, distance) for distance in distances]
        )
        relative_sizes = np.array(convergence.sizes) / convergence.sizes[-1]
        largest_difference = max(largest_difference, percent_differences.max())
        panel.plot(relative_sizes, percent_differences, **line_options)
    if not styles_by_quantity:
        panel.set_axis_off()
        panel.text(0.5, 0.5, "nothing to extrapolate", ha="center", transform=panel.transAxes)
        return
    end_sizes = relative_sizes[[0, -1]]
    first_order_differences = 2.0 * largest_difference * end_sizes
    panel.plot(
        end_sizes, first_order_differences, color="black", ls=":", lw=1.2, label="first order"
    )
    panel.set(xscale="log", yscale="log")
    panel.set_xticks(
        relative_sizes, labels=[f"{relative_size:.2g}" for relative_size in relative_sizes]
    )
    panel.set_xticks([], minor=True)
    label_axis(panel.yaxis, "difference from the extrapolated value", "%")
    count_in_scene = verification.counts[cause][0]
    size_label = f"element size over that of the scene ({count_in_scene} elements)"
    inverse_number_label = f"{count_in_scene} {cause} of the scene over the number used"
    panel.set_xlabel(size_label if cause == "mesh" else inverse_number_label)


def _choose_line_styles(verification: Verification, cause: str) -> StylesByQuantity:
    """Choose line styles for the quantities with a line in the convergence panel.

    Left out are quantities that are zero, or for which no error follows from the extrapolation over
    ``cause``.
    """
    drawn_quantities = [
        quantity_name
        for quantity_name, convergence in verification.parts[cause].items()
        if convergence.has_error_from_limit
        and verification.values[quantity_name]
        and convergence.extrapolated not in convergence.values
    ]
    quantity_markers = zip(
        drawn_quantities, product(MARKER_LETTERS, COLOURS_BY_NAME.values()), strict=False
    )
    return {
        quantity_name: {"marker": marker, "color": colour, "ms": 5}
        for quantity_name, (marker, colour) in quantity_markers
    }


def _draw_contributions(
    panel: Axes, verification: Verification, styles_by_quantity: StylesByQuantity
) -> None:
    """Draw relative uncertainties in percent, with a row for each quantity.

    Coloured marks are causes, black bars the total. To the left is the quantity's marker of the
    convergence panel, to the right the observed order of convergence, or its behaviour in words.
    """
    quantity_names, axis_transform = list(verification.values)[::-1], panel.get_yaxis_transform()
    colours = dict(zip(ERROR_CAUSES, distinct_colours(len(ERROR_CAUSES)), strict=True))
    for row_position, quantity_name in enumerate(quantity_names):
        total_percent = 100.0 * verification.relative(
            quantity_name, verification.total(quantity_name)
        )
        if total_percent > 100.0 * MIN_REPORTED_ERROR:
            panel.plot(
                2 * [total_percent],
                [row_position - 0.32, row_position + 0.32],
                color="black",
                lw=1.6,
            )
        for cause, absolute_uncertainty in verification.contributions(quantity_name).items():
            has_small_factor = (
                verification.parts[cause][quantity_name].factor <= ASYMPTOTIC_SAFETY_FACTOR
            )
            error_percent = 100.0 * verification.relative(quantity_name, absolute_uncertainty)
            if error_percent > 100.0 * MIN_REPORTED_ERROR:
                fill_colour = colours[cause] if has_small_factor else "none"
                panel.plot(
                    error_percent, row_position, "o", ms=7, color=colours[cause], mfc=fill_colour
                )
        if quantity_name in styles_by_quantity:
            placement_options = {"transform": axis_transform, "clip_on": False}
            panel.plot(
                [-0.06, -0.035, -0.01],
                3 * [row_position],
                markevery=[1],
                **placement_options,
                **styles_by_quantity[quantity_name],
            )
        if verification.causes:
            convergence = verification.parts[verification.causes[0]][quantity_name]
            order_text = (
                f"{convergence.order:.2g}"
                if np.isfinite(convergence.order)
                else convergence.behaviour
            )
            panel.text(
                1.02, row_position, order_text, transform=axis_transform, va="center", fontsize=9
            )
    for cause in verification.causes:
        panel.plot([], [], "o", ms=7, color=colours[cause], label=LABELS_BY_CAUSE.get(cause, cause))
    panel.plot([], [], "o", ms=7, color="grey", mfc="none", label="factor of safety 3")
    panel.plot([], [], color="black", lw=1.6, label="all causes together")
    if verification.causes:
        panel.text(
            1.02, len(quantity_names) - 0.3, "observed order", transform=axis_transform, fontsize=9
        )
    panel.set(xscale="log", ylim=(-0.6, len(quantity_names) - 0.4))
    panel.set_yticks(
        range(len(quantity_names)),
        [_describe_quantity(verification, quantity_name) for quantity_name in quantity_names],
        fontsize=9,
    )
    panel.tick_params("y", pad=28, length=0)
    label_axis(panel.xaxis, "uncertainty of the scene's own value", "%")


def _describe_quantity(verification: Verification, name: str) -> str:
    """Describe a quantity and its value: "half peak-to-peak, 1.094 µm"."""
    point_name, _, quantity_name = name.rpartition(".")
    quantity_kind, _, mode_number = quantity_name.replace("frequency_", "omega_").rpartition("_")
    observable = OBSERVABLES_BY_NAME.get(quantity_name)
    quantity_text = (
        f"{OBSERVABLES_BY_NAME[quantity_kind].words}, mode {mode_number}"
        if observable is None
        else observable.words
    )
    if point_name:
        quantity_text += f", {verification.scene.label_by_point_name.get(point_name, point_name)}"
    value_text = format_quantity(verification.values[name], verification.units[name])
    return f"{fill(quantity_text, MAX_LETTERS_PER_LINE)}, {value_text}"


def draw_growth(
    found: Growth, *, in_hertz: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw a crack's length, frequencies and stress intensity over the load cycles.

    Dots are the crack lengths at which the vibration was solved. For a half-ellipse, depth and
    length are drawn, without dots.

    Parameters
    ----------
    found : Growth
        Result of :func:`grow`.
    in_hertz : bool
        Show frequencies in Hz instead of rad/s.
    **picture_options
        ``axes`` (three), ``path``, ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        There are not three axes.

    Examples
    --------
    >>> figure = fc.draw_growth(fc.grow(growing), path="growth.png")  # doctest: +SKIP
    """
    figure_size, solved_lengths = (7.0, 8.6), np.zeros(0)
    if found.depth is None:
        solved_lengths = found.solved[found.solved <= found.length[-1]]
    picture = Picture(3, size=figure_size, sharex=True, **picture_options)
    length_panel, frequency_panel, intensity_panel = picture.panels
    solved_cycles = np.interp(solved_lengths, found.length, found.cycles)
    frequency_factor, _, unit = choose_frequency_factor_name_unit(in_hertz)
    lines_by_label = {
        "length": (length_panel, found.length, "blue", "-"),
        "load": (frequency_panel, frequency_factor * found.omega, "black", "-"),
        "natural, breathing crack": (
            frequency_panel,
            frequency_factor * found.omega_bilinear,
            "orange",
            "-",
        ),
        "natural, open crack": (
            frequency_panel,
            frequency_factor * found.omega_open,
            "green",
            "--",
        ),
        r"effective range of $K_\mathrm{I}$": (intensity_panel, found.effective, "blue", "-"),
        r"$K_\mathrm{max}$": (intensity_panel, found.largest, "pink", ":"),
    }
    if found.depth is not None:
        lines_by_label["depth"] = length_panel, found.depth, "orange", "-"
    for label, (panel, curve_values, colour, style) in lines_by_label.items():
        line_options = {"color": COLOURS_BY_NAME.get(colour, colour), "ls": style}
        panel.plot(found.cycles, curve_values, label=label, **line_options)
    if len(solved_lengths):
        length_panel.plot(
            solved_cycles,
            solved_lengths,
            "o",
            color=COLOURS_BY_NAME["blue"],
            ms=4.0,
            label="solved",
        )
    solved_ranges = np.interp(solved_lengths, found.length, found.effective)
    intensity_panel.plot(solved_cycles, solved_ranges, "o", color=COLOURS_BY_NAME["blue"], ms=4.0)
    if found.effective.max() > 0.0:
        intensity_panel.set_yscale("log")
    label_axis(length_panel.yaxis, "crack", "m")
    label_axis(frequency_panel.yaxis, "frequency", unit)
    label_axis(intensity_panel.yaxis, "stress intensity", "Pa m^0.5")
    label_count_axis(intensity_panel.xaxis, "load cycles")
    return picture.finish()


# --- rotors ---------------------------------------------------------------------------------------


def draw_campbell(
    diagram: Campbell,
    orders: Sequence[int] = range(1, 9),
    *,
    in_hertz: bool = True,
    in_rpm: bool = True,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw a Campbell diagram: natural frequencies and engine orders over the rotor speed.

    The mean load holds the crack open, shut or partly open, or the crack breathes; at each speed a
    mode's line shows the frequency in this state. A band goes from the open to the bonded crack.
    Engine orders are grey lines with numbers, and circles mark their crossings with the modes.
    Modes above all engine orders are left out, except the first mode.

    Parameters
    ----------
    diagram : Campbell
        Result to draw.
    orders : sequence of int
        Engine orders to draw.
    in_hertz, in_rpm : bool
        Show frequencies in Hz, otherwise in rad/s; speeds in revolutions per minute, otherwise in
        rad/s.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        An order is not a whole number >= 1.

    Examples
    --------
    >>> diagram = fc.campbell(blade, [0.0, 150.0, 300.0], count=2)
    >>> figure = fc.draw_campbell(diagram, orders=[1, 2, 3], path="campbell.png")
    """
    from fenics_crack.study.campbell import STATE_TEXT_BY_KIND  # loaded with the diagram

    for order in orders:
        check_count("orders", order, 1)
    [panel] = picture = Picture(**picture_options)
    frequency_factor, _, frequency_unit = choose_frequency_factor_name_unit(in_hertz)
    speed_factor, *speed_name_and_unit = choose_speed_factor_name_unit(in_rpm)
    speeds, frequencies = speed_factor * diagram.speed, frequency_factor * diagram.omega_real
    largest_order_frequency = max(orders, default=0) * frequency_factor / speed_factor * speeds[-1]
    frequencies = frequencies[
        :, : max(1, int(np.sum(frequencies.min(axis=0) <= largest_order_frequency)))
    ]
    colours = list(COLOURS_BY_NAME.values())[:-1]
    for mode_index in range(frequencies.shape[1]):
        line_speeds, line_frequencies, line_states = zip(
            *diagram.real_line(mode_index + 1), strict=True
        )
        colour, label = colours[mode_index % len(colours)], f"mode {mode_index + 1}"
        if diagram.cracked:
            label = ", ".join(
                [label, *dict.fromkeys(STATE_TEXT_BY_KIND[state] for state in line_states)]
            )
        panel.plot(
            speed_factor * np.array(line_speeds),
            frequency_factor * np.array(line_frequencies),
            color=colour,
            label=label,
        )
        if diagram.cracked:
            band_edges = (
                frequency_factor * state_omega[:, mode_index]
                for state_omega in (diagram.omega_open, diagram.omega_tied)
            )
            panel.fill_between(speeds, *band_edges, color=colour, alpha=0.25, lw=0.0)
    upper_limit = 1.08 * float(frequencies.max())
    panel.set(xlim=(speeds[0], speeds[-1]), ylim=(0.0, upper_limit))
    for order in orders:
        slope = order * frequency_factor / speed_factor
        _draw_engine_order(panel, order, slope, (speeds[0], speeds[-1]), upper_limit)
        crossing_speeds = diagram.crossings(order, "real")[:, 1] * speed_factor
        panel.plot(
            crossing_speeds,
            slope * crossing_speeds,
            "o",
            color=COLOURS_BY_NAME["grey"],
            mfc="none",
            ms=6,
        )
    if diagram.cracked:
        panel.fill_between(
            [], [], [], color=COLOURS_BY_NAME["grey"], alpha=0.25, label="open to bonded"
        )
    panel.set(
        xlabel=heading_with_unit(*speed_name_and_unit),
        ylabel=f"natural frequency [{frequency_unit}]",
    )
    return picture.finish()


def _draw_engine_order(
    panel: Any,
    engine_order: int,
    frequency_per_speed: float,
    speed_range: tuple[float, float],
    upper_limit: float,
) -> None:
    """Draw the line of an engine order, and its number at an edge.

    The edge is the panel's right or upper edge, at which the line ends.

    Parameters
    ----------
    frequency_per_speed : float
        Slope of the line, in the units of the panel.
    speed_range, upper_limit
        First and last speed, and largest frequency, of the panel, in its units.
    """
    end_speeds = np.array(speed_range)
    panel.plot(
        end_speeds,
        frequency_per_speed * end_speeds,
        color=COLOURS_BY_NAME["grey"],
        lw=0.8,
        ls="--",
        alpha=0.7,
    )
    last_frequency = frequency_per_speed * speed_range[1]
    if last_frequency <= upper_limit:
        label_position = speed_range[1], last_frequency
        _write_engine_order(panel, engine_order, label_position, (3, 0), ha="left", va="center")
    else:
        label_position = upper_limit / frequency_per_speed, upper_limit
        _write_engine_order(panel, engine_order, label_position, (0, 2), ha="center", va="bottom")


def _write_engine_order(
    panel: Any,
    engine_order: float,
    position: Any,
    point_offset: tuple[int, int],
    **text_options: Any,
) -> None:
    """Write the number of an engine order next to a position, even outside the panel.

    Parameters
    ----------
    position : (float, float)
        Position in data coordinates, or in the coordinates of ``xycoords`` in ``text_options``.
    point_offset : (int, int) [points]
        Offset of the text from the position.
    text_options
        Options of matplotlib's ``annotate``.
    """
    text_options |= {"textcoords": "offset points", "fontsize": 8, "color": COLOURS_BY_NAME["grey"]}
    panel.annotate(
        f"{engine_order:g}", position, xytext=point_offset, annotation_clip=False, **text_options
    )


def draw_arrivals(
    arrivals: ArrivalTimes, *, in_rpm: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw blade tip displacements from arrivals, for each probe.

    The horizontal axis has the revolutions, or the rotor speed if it varies. A probe sees the tip
    once in a revolution: a vibration at a whole engine order appears constant, any other vibration
    slow.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Result to draw.
    in_rpm : bool
        Show speeds of a run-up in revolutions per minute, otherwise in rad/s.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Examples
    --------
    >>> figure = fc.draw_arrivals(arrivals, path="arrivals.png")
    """
    [panel] = picture = Picture(**picture_options)
    _draw_displacements(panel, arrivals, in_rpm)
    return picture.finish()


def _draw_displacements(panel: Axes, arrivals: ArrivalTimes, in_rpm: bool) -> None:
    """Draw each probe's tip displacements over the revolutions, or over a varying speed.

    ``in_rpm``: speeds in revolutions per minute, otherwise in rad/s.
    """
    speed_factor, *speed_name_and_unit = choose_speed_factor_name_unit(in_rpm)
    is_steady, revolutions = arrivals.steady, arrivals.first + np.arange(len(arrivals))
    abscissa = revolutions if is_steady else speed_factor * arrivals.speed
    marker_size = 3.0 if len(arrivals) > 100 else 4.5
    colours = distinct_colours(len(arrivals.probes))
    probes_with_styles = zip(
        arrivals.displacement.T, arrivals.probes, colours, cycle("osD^vPX"), strict=False
    )
    for probe_displacements, probe_angle, colour, marker in probes_with_styles:
        label = f"probe at {np.degrees(probe_angle):.4g}°"
        panel.plot(
            abscissa,
            probe_displacements,
            marker,
            color=colour,
            ms=marker_size,
            mew=0,
            alpha=0.8,
            label=label,
        )
    panel.set_xlabel("revolution" if is_steady else heading_with_unit(*speed_name_and_unit))
    label_axis(panel.yaxis, "blade tip displacement", "m")


def draw_tip_fit(
    fit: TipFit, arrivals: ArrivalTimes, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw a vibration fitted to tip arrivals, and residuals by engine order.

    The first panel shows a period of the vibration, with the displacements from arrivals. If only
    one engine order was tried, the second panel shows the amplitudes of its harmonics with their
    standard errors.

    Parameters
    ----------
    fit : TipFit
        Fitted vibration.
    arrivals : ArrivalTimes
        Arrivals to which the vibration was fitted.
    **picture_options
        ``axes``, two of them, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_tip_fit(fc.fit_order(arrivals), arrivals, path="fit.png")
    """
    time_panel, order_panel = picture = Picture(2, size=(7.0, 7.0), **picture_options)
    n_load_periods = max(1, round(1.0 / fit.multiples[0]))  # in a response period
    load_periods = np.linspace(0.0, n_load_periods, 500)
    fitted_displacement = fit.displacement(2.0 * np.pi * load_periods / fit.order)
    has_arrived = np.isfinite(arrivals.time)
    arrival_periods = (
        fit.order * fit.phases(arrivals)[has_arrived] / (2.0 * np.pi)
    ) % n_load_periods
    marker_options: dict[str, Any] = {
        "color": COLOURS_BY_NAME["blue"],
        "ms": 3.5,
        "mew": 0,
        "alpha": 0.4,
    }
    time_panel.plot(
        arrival_periods, arrivals.displacement[has_arrived], "o", **marker_options, label="arrivals"
    )
    time_panel.plot(
        load_periods,
        fitted_displacement,
        color=COLOURS_BY_NAME["orange"],
        lw=1.6,
        label=f"fit, order {fit.order:.6g}",
    )
    time_panel.set_xlabel("time / load period")
    label_axis(time_panel.yaxis, "blade tip displacement", "m")
    if len(fit.candidates.orders) > 1:
        _draw_candidates(order_panel, fit.candidates, fit.order)
    else:
        _draw_fitted_harmonics(order_panel, fit)
    return picture.finish()


def _draw_candidates(axes: Axes, candidates: Candidates, best_order: float) -> None:
    """Draw fit residuals [m] over the tried engine orders.

    Marked are the best order, orders that fit as well, and orders that the probes cannot measure.
    """
    axis_bottom = 0.5 * float(
        np.nanmin(candidates.residuals[candidates.residuals > 0.0], initial=np.inf)
    )
    if np.isfinite(axis_bottom):
        axes.set_yscale("log")
    else:
        axis_bottom = 0.0
    is_best = candidates.orders == best_order
    categories_by_label = {
        "other orders": (~is_best & ~candidates.equivalent & ~candidates.hidden, "o", "grey"),
        "cannot be measured": (candidates.hidden & ~is_best, "X", "pink"),
        "fit as well": (~is_best & candidates.equivalent & ~candidates.hidden, "s", "blue"),
        "best": (is_best, "o", "orange"),
    }
    for label, (is_in_category, marker, colour) in categories_by_label.items():
        if np.any(is_in_category):
            category_orders = candidates.orders[is_in_category]
            category_residuals = np.maximum(candidates.residuals[is_in_category], axis_bottom)
            axes.vlines(
                category_orders,
                axis_bottom,
                category_residuals,
                color=COLOURS_BY_NAME[colour],
                lw=1.0,
            )
            axes.plot(
                category_orders,
                category_residuals,
                marker,
                color=COLOURS_BY_NAME[colour],
                ms=5.0,
                label=label,
            )
    axes.set_ylim(bottom=axis_bottom)
    axes.set_xlabel("engine order: load periods in a revolution")
    if not np.any(candidates.orders % 1.0):
        axes.xaxis.get_major_locator().set_params(integer=True)
    label_axis(axes.yaxis, "rms residual of the fit", "m")


def _draw_fitted_harmonics(axes: Axes, fit: TipFit) -> None:
    """Draw the amplitudes of a fit's harmonics with their standard errors."""
    multiples, amplitudes, standard_errors = fit.multiples, fit.amplitudes, fit.amplitude_errors
    amplitudes_and_errors = np.append(amplitudes, standard_errors)
    axis_bottom = 0.5 * float(
        np.min(amplitudes_and_errors, where=amplitudes_and_errors > 0.0, initial=np.inf)
    )
    if np.isfinite(axis_bottom):
        axes.set_yscale("log")
        axes.set_ylim(
            axis_bottom,
            2.0 * amplitudes_and_errors.max(where=amplitudes_and_errors > 0.0, initial=axis_bottom),
        )
    bar_options: dict[str, Any] = {"color": COLOURS_BY_NAME["orange"], "ms": 5.0, "capsize": 4.0}
    axes.errorbar(
        multiples,
        amplitudes,
        standard_errors,
        fmt="o",
        **bar_options,
        label="fit, with standard errors",
    )
    axes.set(xticks=multiples, xlim=(0.0, multiples[-1] + 0.5))
    axes.set_xlabel("harmonic of the load")
    label_axis(axes.yaxis, "amplitude of the blade tip", "m")


def draw_tip_track(
    track: TipTrack, *, in_hertz: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw blade tip amplitudes in a run-up over the load frequency.

    Bands are standard errors. Each harmonic of the load frequency has a line.

    Parameters
    ----------
    track : TipTrack
        Result to draw.
    in_hertz : bool
        Show frequencies in Hz instead of rad/s.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Examples
    --------
    >>> figure = fc.draw_tip_track(fc.track_order(arrivals, 6), path="track.png")
    """
    [panel] = picture = Picture(**picture_options)
    frequency_factor, frequency_name, unit = choose_frequency_factor_name_unit(in_hertz)
    frequencies = frequency_factor * track.omega
    multiples_with_amplitudes = zip(
        track.multiples, track.amplitudes.T, track.amplitude_errors.T, strict=True
    )
    for (multiple, amplitudes, standard_errors), colour in zip(
        multiples_with_amplitudes, cycle(COLOURS_BY_NAME.values()), strict=False
    ):
        label = f"{multiple:g}x the load's frequency"
        panel.plot(frequencies, amplitudes, ".-", color=colour, lw=0.8, ms=3.0, label=label)
        upper_edge = amplitudes + standard_errors
        lower_edge = np.maximum(amplitudes - standard_errors, 0.0)
        panel.fill_between(frequencies, lower_edge, upper_edge, color=colour, alpha=0.25, lw=0)
    panel.set_xlabel(heading_with_unit(frequency_name, unit))
    label_axis(panel.yaxis, "amplitude of the blade tip", "m")
    panel.set_ylim(bottom=0.0)
    return picture.finish()


def draw_passages(
    passages: Sequence[PassageFit],
    arrivals: ArrivalTimes,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw a record of tip displacements over the rotor speed, and its resonances.

    The second panel shows the first resonance of ``passages``: for each passage in the record, the
    displacements at the probe with the largest fitted motion, without drift, and the fit.

    Parameters
    ----------
    passages : sequence of PassageFit
        Resonances from :func:`find_passages`, about the largest first; without resonances the
        second panel stays empty.
    arrivals : ArrivalTimes
        Record in which the resonances were found.
    **picture_options
        ``axes``, two of them, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        The number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_passages(fc.find_passages(arrivals), arrivals, path="passages.png")
    """
    record_panel, passage_panel = picture = Picture(2, size=(7.0, 7.0), **picture_options)
    _draw_displacements(record_panel, arrivals, in_rpm=True)
    coordinate_systems = "data", "axes fraction"
    for passage_index, passage in enumerate(passages):
        label = "_" * bool(passage_index) + "resonance, with its engine order"
        line_options: dict[str, Any] = {"color": COLOURS_BY_NAME["grey"], "lw": 0.7, "ls": "--"}
        record_panel.axvline(
            passage.speed / RAD_PER_S_PER_RPM, **line_options, zorder=0, label=label
        )
        text_position = (passage.speed / RAD_PER_S_PER_RPM, 1.0)
        text_offset = (0, 2 + 9 * (passage_index % 2))
        text_options = {"ha": "center", "xycoords": coordinate_systems}
        _write_engine_order(record_panel, passage.order, text_position, text_offset, **text_options)
    if passages:
        _draw_passage_fit(passage_panel, passages[0], arrivals)
    else:
        passage_panel.set_axis_off()
    return picture.finish()


def _draw_passage_fit(axes: Axes, passage: PassageFit, arrivals: ArrivalTimes) -> None:
    """Draw measured and fitted displacements for each passage through a resonance.

    Only the probe with the largest fitted motion is shown. The title states engine order,
    frequency and probe.
    """
    measured_and_fitted_runs = passage.compared(arrivals)
    probe_index = int(
        np.argmax(
            sum(
                np.sum(fitted_displacements**2, axis=0)
                for _, _, fitted_displacements in measured_and_fitted_runs
            )
        )
    )
    for (speeds, measured_displacements, fitted_displacements), colour in zip(
        measured_and_fitted_runs, cycle(COLOURS_BY_NAME.values()), strict=False
    ):
        direction = "up" if speeds[-1] > speeds[0] else "down"
        marker_options: dict[str, Any] = {"color": colour, "ms": 3.0, "mew": 0, "alpha": 0.6}
        axes.plot(
            speeds / RAD_PER_S_PER_RPM,
            measured_displacements[:, probe_index],
            "o",
            **marker_options,
            label=f"arrivals, {direction}",
        )
        axes.plot(
            speeds / RAD_PER_S_PER_RPM,
            fitted_displacements[:, probe_index],
            color=colour,
            lw=1.2,
            label=f"fit, {direction}",
        )
    axes.set_xlabel("rotor speed [rpm]")
    label_axis(axes.yaxis, "blade tip displacement", "m")
    probe_angle = np.degrees(arrivals.probes[probe_index])
    title = f"order {passage.order:g}, {passage.omega / RAD_PER_TURN:.5g} Hz, "
    title += f"probe at {probe_angle:.4g}°"
    axes.set_title(title, fontsize="medium")
