"""Draw rotors: Campbell diagrams, and blade tips at probes with the vibrations fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.basics.errors import check_count
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    choose_frequency_factor_name_unit,
    choose_speed_factor_name_unit,
    heading_with_unit,
)
from fenics_crack.draw.figure import (
    CURVE_COLOUR_CODE_BY_NAME,
    Picture,
    PictureOptions,
    distinct_colours,
    label_axis,
)

if TYPE_CHECKING:  # which load SciPy's interpolation, and DOLFINx
    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.arrivals.harmonics import Candidates, TipFit
    from fenics_crack.arrivals.resonance import PassageFit
    from fenics_crack.arrivals.track_order import TipTrack
    from fenics_crack.study.campbell import Campbell


def draw_campbell(
    diagram: Campbell,
    orders: Sequence[int] = range(1, 9),
    *,
    in_hertz: bool = True,
    in_rpm: bool = True,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw a Campbell diagram: natural frequencies and engine orders over the rotor speed.

    At each speed the crack has a state: held open, shut or partly open by the mean load, or
    breathing. A mode's line shows the natural frequency in the state at this speed. A band reaches
    from the frequency with open crack to the frequency with bonded crack. Grey lines with numbers
    are engine orders: the frequency is the order times the rotor speed. Circles mark crossings of
    these lines with the modes. A mode above all engine order lines is left out, except the first
    mode.

    Parameters
    ----------
    diagram : Campbell
        Result to draw.
    orders : sequence of int
        Engine orders to draw.
    in_hertz : bool
        Show frequencies in Hz, otherwise in rad/s.
    in_rpm : bool
        Show speeds in revolutions per minute, otherwise in rad/s.
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
    from fenics_crack.study.campbell import CRACK_STATE_BY_FREQUENCY_KIND  # loaded with the diagram

    for order in orders:
        check_count("orders", order, 1)
    [panel] = picture = Picture(**picture_options)
    frequency_factor, _, frequency_unit = choose_frequency_factor_name_unit(in_hertz)
    speed_factor, *speed_name_and_unit = choose_speed_factor_name_unit(in_rpm)
    speeds, frequencies = (
        speed_factor * diagram.speed,
        frequency_factor * diagram.omega_in_actual_state,
    )
    largest_order_frequency = max(orders, default=0) * frequency_factor / speed_factor * speeds[-1]
    frequencies = frequencies[
        :, : max(1, int(np.sum(frequencies.min(axis=0) <= largest_order_frequency)))
    ]
    colours = list(CURVE_COLOUR_CODE_BY_NAME.values())[:-1]
    for mode_index in range(frequencies.shape[1]):
        mode_line_speeds, mode_line_frequencies, mode_line_frequency_kinds = zip(
            *diagram.list_actual_state_line(mode_index + 1), strict=True
        )
        colour, label = colours[mode_index % len(colours)], f"mode {mode_index + 1}"
        if diagram.cracked:
            label = ", ".join(
                [
                    label,
                    *dict.fromkeys(
                        CRACK_STATE_BY_FREQUENCY_KIND[frequency_kind]
                        for frequency_kind in mode_line_frequency_kinds
                    ),
                ]
            )
        panel.plot(
            speed_factor * np.array(mode_line_speeds),
            frequency_factor * np.array(mode_line_frequencies),
            color=colour,
            label=label,
        )
        if diagram.cracked:
            open_and_bonded_frequencies = (
                frequency_factor * state_omega[:, mode_index]
                for state_omega in (diagram.omega_open, diagram.omega_tied)
            )
            panel.fill_between(
                speeds, *open_and_bonded_frequencies, color=colour, alpha=0.25, lw=0.0
            )
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
            color=CURVE_COLOUR_CODE_BY_NAME["grey"],
            mfc="none",
            ms=6,
        )
    if diagram.cracked:
        panel.fill_between(
            [], [], [], color=CURVE_COLOUR_CODE_BY_NAME["grey"], alpha=0.25, label="open to bonded"
        )
    panel.set(
        xlabel=heading_with_unit(*speed_name_and_unit),
        ylabel=f"natural frequency [{frequency_unit}]",
    )
    return picture.draw_legends_and_save()


def _draw_engine_order(
    panel: Any,
    engine_order: int,
    frequency_per_speed: float,
    speed_range: tuple[float, float],
    upper_limit: float,
) -> None:
    """Draw an engine order's line over the rotor speed, and its number at the line's end.

    The line ends at the panel's right or upper edge.

    Parameters
    ----------
    panel : Axes
        Panel to draw on.
    engine_order : int
        Periods of the load in a revolution.
    frequency_per_speed : float
        Slope of the line, in the panel's units.
    speed_range : (float, float)
        First and last speed in the panel, in its unit.
    upper_limit : float
        Largest frequency in the panel, in its unit.
    """
    end_speeds = np.array(speed_range)
    panel.plot(
        end_speeds,
        frequency_per_speed * end_speeds,
        color=CURVE_COLOUR_CODE_BY_NAME["grey"],
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
        Position in data coordinates. If ``text_options`` has ``xycoords``, this option names the
        coordinates.
    point_offset : (int, int) [points]
        Horizontal and vertical offset of the text from the position.
    text_options
        Options of matplotlib's ``annotate``.
    """
    panel.annotate(
        f"{engine_order:g}",
        position,
        xytext=point_offset,
        textcoords="offset points",
        annotation_clip=False,
        fontsize=8,
        color=CURVE_COLOUR_CODE_BY_NAME["grey"],
        **text_options,
    )


def draw_arrivals(
    arrivals: ArrivalTimes, *, in_rpm: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw blade tip displacements from arrivals, for each probe.

    A probe on the casing measures when a blade tip arrives, and so the tip's tangential
    displacement. If the rotor speed varies, the horizontal axis shows the speed, otherwise the
    number of the revolution.

    A probe sees the tip once in a revolution. So a vibration at a whole engine order seems
    constant. Any further vibration seems slower than in reality.

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
    return picture.draw_legends_and_save()


def _draw_displacements(panel: Axes, arrivals: ArrivalTimes, in_rpm: bool) -> None:
    """Draw each probe's tip displacements over the revolutions, or over a varying speed.

    ``in_rpm`` shows speeds in revolutions per minute, otherwise in rad/s.
    """
    speed_factor, *speed_name_and_unit = choose_speed_factor_name_unit(in_rpm)
    is_steady, revolutions = arrivals.steady, arrivals.first + np.arange(len(arrivals))
    revolutions_or_speeds = revolutions if is_steady else speed_factor * arrivals.speed
    for probe_displacements, probe_angle, colour, marker in zip(
        arrivals.displacement.T,
        arrivals.probes,
        distinct_colours(len(arrivals.probes)),
        cycle("osD^vPX"),
        strict=False,
    ):
        panel.plot(
            revolutions_or_speeds,
            probe_displacements,
            marker,
            color=colour,
            ms=3.0 if len(arrivals) > 100 else 4.5,
            mew=0,
            alpha=0.8,
            label=f"probe at {np.degrees(probe_angle):.4g}°",
        )
    panel.set_xlabel("revolution" if is_steady else heading_with_unit(*speed_name_and_unit))
    label_axis(panel.yaxis, "blade tip displacement", "m")


def draw_tip_fit(
    fit: TipFit, arrivals: ArrivalTimes, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw a vibration fitted to tip arrivals, and residuals by engine order.

    The first panel shows a period of the vibration, with the displacements from arrivals. The
    second panel shows the fit's residual over the tried engine orders. If only one order was tried,
    the second panel shows the amplitudes of the harmonics with their standard errors.

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
    n_load_periods = max(1, round(1.0 / fit.multiples[0]))  # load periods in a response period
    times_in_load_periods = np.linspace(0.0, n_load_periods, 500)
    has_arrived = np.isfinite(arrivals.time)
    arrival_periods = (
        fit.order * fit.angles_at_arrivals(arrivals)[has_arrived] / (2.0 * np.pi)
    ) % n_load_periods
    time_panel.plot(
        arrival_periods,
        arrivals.displacement[has_arrived],
        "o",
        color=CURVE_COLOUR_CODE_BY_NAME["blue"],
        ms=3.5,
        mew=0,
        alpha=0.4,
        label="arrivals",
    )
    time_panel.plot(
        times_in_load_periods,
        fit.displacement(2.0 * np.pi * times_in_load_periods / fit.order),
        color=CURVE_COLOUR_CODE_BY_NAME["orange"],
        lw=1.6,
        label=f"fit, order {fit.order:.6g}",
    )
    time_panel.set_xlabel("time / load period")
    label_axis(time_panel.yaxis, "blade tip displacement", "m")
    if len(fit.candidates.orders) > 1:
        _draw_candidates(order_panel, fit.candidates, fit.order)
    else:
        _draw_fitted_harmonics(order_panel, fit)
    return picture.draw_legends_and_save()


def _draw_candidates(axes: Axes, candidates: Candidates, best_order: float) -> None:
    """Draw fit residuals [m] over the tried engine orders.

    ``candidates`` has the tried engine orders with their residuals. ``best_order`` is marked, and
    orders that fit equally well. Orders that the probes cannot measure are marked, too.
    """
    axis_bottom = _set_log_scale_if_any_positive(axes, candidates.residuals)
    is_best = candidates.orders == best_order
    categories_by_label = {
        "other orders": (~is_best & ~candidates.equivalent & ~candidates.hidden, "o", "grey"),
        "cannot be measured": (candidates.hidden & ~is_best, "X", "pink"),
        "fit as well": (~is_best & candidates.equivalent & ~candidates.hidden, "s", "blue"),
        "best": (is_best, "o", "orange"),
    }
    for label, (is_in_category, marker, colour) in categories_by_label.items():
        if np.any(is_in_category):
            engine_orders_in_category = candidates.orders[is_in_category]
            residuals_in_category = np.maximum(candidates.residuals[is_in_category], axis_bottom)
            axes.vlines(
                engine_orders_in_category,
                axis_bottom,
                residuals_in_category,
                color=CURVE_COLOUR_CODE_BY_NAME[colour],
                lw=1.0,
            )
            axes.plot(
                engine_orders_in_category,
                residuals_in_category,
                marker,
                color=CURVE_COLOUR_CODE_BY_NAME[colour],
                ms=5.0,
                label=label,
            )
    axes.set_ylim(bottom=axis_bottom)
    axes.set_xlabel("engine order: load periods in a revolution")
    if not np.any(candidates.orders % 1.0):
        axes.xaxis.get_major_locator().set_params(integer=True)
    label_axis(axes.yaxis, "rms residual of the fit", "m")


def _set_log_scale_if_any_positive(axes: Axes, values: np.ndarray) -> float:
    """Make the vertical axis logarithmic if any value is positive.

    ``values`` are the values drawn over the axis. Return the axis's lower end, half the smallest
    positive value. Without a positive value, return 0.
    """
    positive_values = values[(values > 0.0) & np.isfinite(values)]
    if not len(positive_values):
        return 0.0
    axes.set_yscale("log")
    return 0.5 * float(positive_values.min())


def _draw_fitted_harmonics(axes: Axes, fit: TipFit) -> None:
    """Draw the amplitudes of a fit's harmonics with their standard errors."""
    multiples, amplitudes, standard_errors = fit.multiples, fit.amplitudes, fit.amplitude_errors
    values_for_axis_limits = np.append(amplitudes, standard_errors)
    axis_bottom = _set_log_scale_if_any_positive(axes, values_for_axis_limits)
    if axis_bottom > 0.0:
        axes.set_ylim(axis_bottom, 2.0 * np.nanmax(values_for_axis_limits))
    axes.errorbar(
        multiples,
        amplitudes,
        standard_errors,
        fmt="o",
        color=CURVE_COLOUR_CODE_BY_NAME["orange"],
        ms=5.0,
        capsize=4.0,
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
    for multiple, amplitudes, standard_errors, colour in zip(
        track.multiples,
        track.amplitudes.T,
        track.amplitude_errors.T,
        cycle(CURVE_COLOUR_CODE_BY_NAME.values()),
        strict=False,
    ):
        panel.plot(
            frequencies,
            amplitudes,
            ".-",
            color=colour,
            lw=0.8,
            ms=3.0,
            label=f"{multiple:g}x the load's frequency",
        )
        lower_edge = np.maximum(amplitudes - standard_errors, 0.0)
        upper_edge = amplitudes + standard_errors
        panel.fill_between(frequencies, lower_edge, upper_edge, color=colour, alpha=0.25, lw=0)
    panel.set_xlabel(heading_with_unit(frequency_name, unit))
    label_axis(panel.yaxis, "amplitude of the blade tip", "m")
    panel.set_ylim(bottom=0.0)
    return picture.draw_legends_and_save()


def draw_passages(
    passages: Sequence[PassageFit],
    arrivals: ArrivalTimes,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw a record of tip displacements over the rotor speed, and its resonances.

    The first panel shows the record, with a dashed line at each resonance. The second panel shows
    the first resonance in ``passages``. For each passage through this resonance, the panel shows
    measured displacements without drift, and the fitted displacements. Only the probe with the
    largest fitted motion is shown.

    Parameters
    ----------
    passages : sequence of PassageFit
        Resonances from :func:`find_passages`, in the order found, about the largest first. Without
        resonances the second panel stays empty.
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
    for passage_index, passage in enumerate(passages):
        resonance_speed_in_rpm = passage.speed / RAD_PER_S_PER_RPM
        record_panel.axvline(
            resonance_speed_in_rpm,
            color=CURVE_COLOUR_CODE_BY_NAME["grey"],
            lw=0.7,
            ls="--",
            zorder=0,
            label="_" * bool(passage_index) + "resonance, with its engine order",
        )
        _write_engine_order(
            record_panel,
            passage.order,
            (resonance_speed_in_rpm, 1.0),
            (0, 2 + 9 * (passage_index % 2)),
            ha="center",
            xycoords=("data", "axes fraction"),
        )
    if passages:
        _draw_passage_fit(passage_panel, passages[0], arrivals)
    else:
        passage_panel.set_axis_off()
    return picture.draw_legends_and_save()


def _draw_passage_fit(axes: Axes, passage: PassageFit, arrivals: ArrivalTimes) -> None:
    """Draw measured and fitted displacements for each passage through a resonance.

    Only the probe with the largest fitted motion is shown. The title states engine order,
    frequency and probe.
    """
    measured_and_fitted_runs = passage.compute_measured_and_fitted_motion(arrivals)
    probe_index = int(
        np.argmax(
            sum(
                np.sum(fitted_displacements**2, axis=0)
                for _, _, fitted_displacements in measured_and_fitted_runs
            )
        )
    )
    for (speeds, measured_displacements, fitted_displacements), colour in zip(
        measured_and_fitted_runs, cycle(CURVE_COLOUR_CODE_BY_NAME.values()), strict=False
    ):
        speed_direction_word = "up" if speeds[-1] > speeds[0] else "down"
        axes.plot(
            speeds / RAD_PER_S_PER_RPM,
            measured_displacements[:, probe_index],
            "o",
            color=colour,
            ms=3.0,
            mew=0,
            alpha=0.6,
            label=f"arrivals, {speed_direction_word}",
        )
        axes.plot(
            speeds / RAD_PER_S_PER_RPM,
            fitted_displacements[:, probe_index],
            color=colour,
            lw=1.2,
            label=f"fit, {speed_direction_word}",
        )
    axes.set_xlabel("rotor speed [rpm]")
    label_axis(axes.yaxis, "blade tip displacement", "m")
    axes.set_title(
        f"order {passage.order:g}, {passage.omega / RAD_PER_TURN:.5g} Hz, "
        f"probe at {np.degrees(arrivals.probes[probe_index]):.4g}°",
        fontsize="medium",
    )
