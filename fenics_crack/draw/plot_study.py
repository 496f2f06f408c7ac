"""Draw results of studies: posteriors, verifications and crack growth."""

from __future__ import annotations

from itertools import product
from textwrap import fill
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.basics.causes import ERROR_CAUSES
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.tables import (
    MIN_REPORTED_RELATIVE_ERROR,
    choose_frequency_factor_name_unit,
    format_quantity,
)
from fenics_crack.draw.figure import (
    CURVE_COLOUR_CODE_BY_NAME,
    MAX_LETTERS_PER_LABEL_LINE,
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
    from fenics_crack.fatigue.growth import Growth
    from fenics_crack.monitoring.identification.result import Identification

CONTOUR_PROBABILITIES = (0.5, 0.95, 0.999)
"""Probabilities of the regions that a posterior's contours enclose."""
QUANTITY_MARKERS = "osD^v<>ph*"
"""Matplotlib's markers for quantities in the picture of a verification, one letter each."""
LEGEND_LABEL_BY_ERROR_CAUSE = {"shift": "mesh, shift of the resonance"}
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
    shows the probability density. A band shows the interval with the probability
    ``identify.confidence``, a key of the scene. All other unknowns are integrated out. If an
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
    for argument_name, key in zip("xy", (x, *second_keys), strict=False):
        if key not in found.unknown or second_keys == [x]:
            raise InputError(
                argument_name, key, f"one of {', '.join(found.unknown)}, with x different from y"
            )
    [panel] = picture = Picture(size=(6.0, 4.6), **picture_options)
    if not second_keys:
        _draw_density(panel, found, x)
        return picture.draw_legends_and_save()
    [y] = second_keys
    x_index, y_index = (found.unknown.index(key) for key in (x, y))
    posterior = found.posterior
    grids_by_branch = {
        branch_name: (
            branch.axes[x_index],
            branch.axes[y_index],
            *posterior.compute_pair_mass_and_density(branch_name, x_index, y_index),
        )
        for branch_name, branch in posterior.posterior_by_text_values.items()
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
        panel.contour(
            *grid_axes,
            log_density,
            levels=log_levels,
            colors=colour,
            linewidths=[0.6, 1.2, 1.8],
            linestyles="solid",
        )
        for level in log_levels:
            panel.contourf(
                *grid_axes, log_density, levels=[level, np.inf], alpha=0.2, colors=colour
            )
        panel.plot(
            [],
            [],
            color=colour,
            lw=1.8,
            label=f"50, 95 and 99.9 %{', ' if branch_name else ''}{branch_name}",
        )
        shown_point_x_indices, shown_point_y_indices = np.nonzero(log_density.T > log_levels[0])
        shown_points.append(
            np.column_stack([x_values[shown_point_x_indices], y_values[shown_point_y_indices]])
        )
    panel.plot(
        *shown_points[0].T, "+", label="estimate", color="black", ms=10, mew=1.5, clip_on=False
    )
    grid_values_of_unknowns = next(iter(posterior.posterior_by_text_values.values())).axes
    _set_limits(
        panel,
        np.concatenate(shown_points),
        (grid_values_of_unknowns[x_index], grid_values_of_unknowns[y_index]),
    )
    label_axis(panel.xaxis, key_in_words(x), unit_of_key(x))
    label_axis(panel.yaxis, key_in_words(y), unit_of_key(y))
    return picture.draw_legends_and_save()


def _draw_density(panel: Axes, identification: Identification, key: str) -> None:
    """Draw the probability density of an unknown, with estimate and credible interval.

    ``key`` names the unknown. Each combination of word values, such as the crack's edge, has its
    own line.
    """
    key_index, posterior = identification.unknown.index(key), identification.posterior
    interval_start, interval_end = identification.intervals[key]
    lines_by_branch = {}
    for branch_name, branch in posterior.posterior_by_text_values.items():
        other_axes = tuple(
            axis_index for axis_index in range(len(branch.axes)) if axis_index != key_index
        )
        density = posterior.grid_probabilities_by_words[branch_name].sum(
            axis=other_axes
        ) / branch.grid_prior_probabilities.sum(axis=other_axes)
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
        is_inside_interval = (unknown_values >= interval_start) & (unknown_values <= interval_end)
        panel.fill_between(
            unknown_values[is_inside_interval],
            density[is_inside_interval] / largest_density,
            color=colour,
            alpha=0.2,
            lw=0.0,
            label=f"{100.0 * identification.priors['confidence']:g} %",
        )
    panel.axvline(identification.estimate[key], color="black", ls="--", label="estimate")
    panel.set_ylim(bottom=0.0)
    label_axis(panel.xaxis, key_in_words(key), unit_of_key(key))
    panel.set_ylabel("probability density over the largest")


def _contour_log_levels(branch_grids: list[tuple[np.ndarray, ...]]) -> list[float]:
    """Return the logarithms of the probability density on three contours.

    The contours enclose 99.9, 95 and 50 % of the probability, in this order. The values are
    strictly ascending.

    Parameters
    ----------
    branch_grids : list of (x, y, mass, density)
        A tuple for each combination of word values, such as the crack's edge. x and y are grid
        values of both unknowns; mass and density are the probability and the probability density at
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
    panel : Axes
        Panel to limit.
    shown_points : (n, 2)
        Values of both unknowns at the points inside the drawn regions.
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

    The first panel has a line for each quantity: the difference from the extrapolated value over
    the element size. If the mesh is not varied, the step size of the first varied cause replaces
    the element size. For example, with modes varied, this is 1 / number. Quantities without regular
    convergence have no line.

    The second panel has a row for each quantity. The row shows the marker from the first panel, the
    uncertainty by cause, and the observed order of convergence, the slope of the line. A filled
    mark means a safety factor of at most 1.25, a hollow mark a larger factor, mostly 3. Black bars
    are the total, the root of the sum of squares.

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
    convergence_panel, contribution_panel = picture = Picture(
        2, n_columns=2, size=(13.0, max(4.2, 1.8 + 0.3 * len(found.values))), **picture_options
    )
    cause_of_convergence_panel = next(iter(found.causes), "")
    styles_by_quantity = (
        _choose_line_styles(found, cause_of_convergence_panel) if cause_of_convergence_panel else {}
    )
    _draw_differences_from_extrapolation(
        convergence_panel, found, cause_of_convergence_panel, styles_by_quantity
    )
    _draw_contributions(contribution_panel, found, styles_by_quantity)
    return picture.draw_legends_and_save()


def _draw_differences_from_extrapolation(
    panel: Axes, verification: Verification, cause: str, styles_by_quantity: StylesByQuantity
) -> None:
    """Draw the differences |f_i - f| over the relative element size h_i.

    f_i is a quantity's value in run i, with the error cause ``cause`` varied. f is the extrapolated
    value. The differences are in percent of the quantity. Sizes are divided by the largest size,
    mostly the scene's. If the cause is not the mesh, h_i is 1 / count, for example with the number
    of harmonics.
    """
    sizes_relative_to_coarsest, largest_difference = np.ones(1), 100.0 * MIN_REPORTED_RELATIVE_ERROR
    for quantity_name, line_options in styles_by_quantity.items():
        convergence = verification.parts[cause][quantity_name]
        distances_from_extrapolated = np.abs(
            np.array(convergence.values) - convergence.extrapolated
        )
        percent_differences = np.array(
            [
                100.0 * verification.relative(quantity_name, distance_from_extrapolated)
                for distance_from_extrapolated in distances_from_extrapolated
            ]
        )
        sizes_relative_to_coarsest = np.array(convergence.sizes) / convergence.sizes[-1]
        largest_difference = max(largest_difference, percent_differences.max())
        panel.plot(sizes_relative_to_coarsest, percent_differences, **line_options)
    if not styles_by_quantity:
        panel.set_axis_off()
        panel.text(0.5, 0.5, "nothing to extrapolate", ha="center", transform=panel.transAxes)
        return
    first_and_last_relative_sizes = sizes_relative_to_coarsest[[0, -1]]
    first_order_reference_line = 2.0 * largest_difference * first_and_last_relative_sizes
    panel.plot(
        first_and_last_relative_sizes,
        first_order_reference_line,
        color="black",
        ls=":",
        lw=1.2,
        label="first order",
    )
    panel.set(xscale="log", yscale="log")
    panel.set_xticks(
        sizes_relative_to_coarsest,
        labels=[
            f"{size_relative_to_coarsest:.2g}"
            for size_relative_to_coarsest in sizes_relative_to_coarsest
        ],
    )
    panel.set_xticks([], minor=True)
    label_axis(panel.yaxis, "difference from the extrapolated value", "%")
    count_in_scene = verification.counts[cause][0]
    panel.set_xlabel(
        f"element size over that of the scene ({count_in_scene} elements)"
        if cause == "mesh"
        else f"{count_in_scene} {cause} of the scene over the number used"
    )


def _choose_line_styles(verification: Verification, cause: str) -> StylesByQuantity:
    """Choose line styles for the quantities with a line in the convergence panel.

    A quantity has no line if its value is zero, or if its error does not follow from an
    extrapolation over runs with varied ``cause``.
    """
    drawn_quantities = [
        quantity_name
        for quantity_name, convergence in verification.parts[cause].items()
        if convergence.has_error_from_limit
        and verification.values[quantity_name]
        and convergence.extrapolated not in convergence.values
    ]
    quantity_markers = zip(
        drawn_quantities,
        product(QUANTITY_MARKERS, CURVE_COLOUR_CODE_BY_NAME.values()),
        strict=False,
    )
    return {
        quantity_name: {"marker": marker, "color": colour, "ms": 5}
        for quantity_name, (marker, colour) in quantity_markers
    }


def _draw_contributions(
    panel: Axes, verification: Verification, styles_by_quantity: StylesByQuantity
) -> None:
    """Draw relative uncertainties in percent, with a row for each quantity.

    A coloured mark is a cause, a black bar the total. To the left stands the quantity's marker from
    the convergence panel. To the right stands the observed order of convergence; without an
    observed order, the behaviour in words.
    """
    quantity_names, axis_transform = list(verification.values)[::-1], panel.get_yaxis_transform()
    colours = dict(zip(ERROR_CAUSES, distinct_colours(len(ERROR_CAUSES)), strict=True))
    for row_position, quantity_name in enumerate(quantity_names):
        total_percent = 100.0 * verification.relative(
            quantity_name, verification.total(quantity_name)
        )
        if total_percent > 100.0 * MIN_REPORTED_RELATIVE_ERROR:
            panel.plot(
                2 * [total_percent],
                [row_position - 0.32, row_position + 0.32],
                color="black",
                lw=1.6,
            )
        for cause, absolute_uncertainty in verification.contributions(quantity_name).items():
            has_small_safety_factor = (
                verification.parts[cause][quantity_name].factor <= ASYMPTOTIC_SAFETY_FACTOR
            )
            error_percent = 100.0 * verification.relative(quantity_name, absolute_uncertainty)
            if error_percent > 100.0 * MIN_REPORTED_RELATIVE_ERROR:
                fill_colour = colours[cause] if has_small_safety_factor else "none"
                panel.plot(
                    error_percent, row_position, "o", ms=7, color=colours[cause], mfc=fill_colour
                )
        if quantity_name in styles_by_quantity:
            panel.plot(
                [-0.06, -0.035, -0.01],
                3 * [row_position],
                markevery=[1],
                transform=axis_transform,
                clip_on=False,
                **styles_by_quantity[quantity_name],
            )
        if verification.causes:
            convergence = verification.parts[verification.causes[0]][quantity_name]
            convergence_order_text = (
                f"{convergence.order:.2g}"
                if np.isfinite(convergence.order)
                else convergence.behaviour
            )
            panel.text(
                1.02,
                row_position,
                convergence_order_text,
                transform=axis_transform,
                va="center",
                fontsize=9,
            )
    for cause in verification.causes:
        panel.plot(
            [],
            [],
            "o",
            ms=7,
            color=colours[cause],
            label=LEGEND_LABEL_BY_ERROR_CAUSE.get(cause, cause),
        )
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
        quantity_text += (
            f", {verification.scene.label_by_displacement_name.get(point_name, point_name)}"
        )
    return (
        f"{fill(quantity_text, MAX_LETTERS_PER_LABEL_LINE)}, "
        f"{format_quantity(verification.values[name], verification.units[name])}"
    )


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
    picture = Picture(3, size=(7.0, 8.6), sharex=True, **picture_options)
    length_panel, frequency_panel, intensity_panel = picture.panels
    frequency_factor, _, unit = choose_frequency_factor_name_unit(in_hertz)
    for label, panel, curve_values, colour, style in (
        ("length", length_panel, found.length, "blue", "-"),
        ("load", frequency_panel, frequency_factor * found.omega, "black", "-"),
        (
            "natural, breathing crack",
            frequency_panel,
            frequency_factor * found.omega_bilinear,
            "orange",
            "-",
        ),
        (
            "natural, open crack",
            frequency_panel,
            frequency_factor * found.omega_open,
            "green",
            "--",
        ),
        (r"effective range of $K_\mathrm{I}$", intensity_panel, found.effective, "blue", "-"),
        (r"$K_\mathrm{max}$", intensity_panel, found.largest, "pink", ":"),
        ("depth", length_panel, found.depth, "orange", "-"),
    ):
        if curve_values is not None:
            panel.plot(
                found.cycles,
                curve_values,
                label=label,
                color=CURVE_COLOUR_CODE_BY_NAME.get(colour, colour),
                ls=style,
            )
    if found.depth is None:
        solved_lengths = found.solved[found.solved <= found.length[-1]]
        solved_cycles, intensity_ranges_at_solved_lengths = (
            np.interp(solved_lengths, found.length, cycles_or_intensity_ranges)
            for cycles_or_intensity_ranges in (found.cycles, found.effective)
        )
        dot_options = {"color": CURVE_COLOUR_CODE_BY_NAME["blue"], "ms": 4.0}
        length_panel.plot(solved_cycles, solved_lengths, "o", label="solved", **dot_options)
        intensity_panel.plot(solved_cycles, intensity_ranges_at_solved_lengths, "o", **dot_options)
    if found.effective.max() > 0.0:
        intensity_panel.set_yscale("log")
    label_axis(length_panel.yaxis, "crack", "m")
    label_axis(frequency_panel.yaxis, "frequency", unit)
    label_axis(intensity_panel.yaxis, "stress intensity", "Pa m^0.5")
    label_count_axis(intensity_panel.xaxis, "load cycles")
    return picture.draw_legends_and_save()
