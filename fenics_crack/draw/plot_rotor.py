"""Pictures of rotors: Campbell diagrams; arrivals at probes, what was fitted to them, a run-up."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.fit_order import TipTrack
from fenics_crack.arrivals.harmonics import Candidates, TipFit
from fenics_crack.arrivals.passages import PassageFit
from fenics_crack.draw.figure import COLOURS, Picture, Where, distinct_colours, label_axis
from fenics_crack.errors import check_count
from fenics_crack.study.campbell import STATES, Campbell
from fenics_crack.table import RPM, TURN, frequency_axis, speed_axis, with_unit

__all__ = ["draw_arrivals", "draw_campbell", "draw_passages", "draw_tip_fit", "draw_tip_track"]


def draw_campbell(
    diagram: Campbell,
    orders: Sequence[int] = range(1, 9),
    *,
    in_hertz: bool = True,
    in_rpm: bool = True,
    **where: Unpack[Where],
) -> Figure:
    """Draw natural frequencies over the speed: as lines those of the crack as it is held open, shut
    or partly open, or breathes at each speed, in bands from lips open to lips tied; engine orders
    as grey lines with their numbers, and circles where they meet. Modes above the reach of all
    orders are left out, but for the first one.

    Parameters
    ----------
    diagram : Campbell
        What is drawn.
    orders : sequence of int
        Engine orders.
    in_hertz, in_rpm : bool
        Frequencies in Hz, else in rad/s; speeds in revolutions per minute, else in rad/s.
    **where
        ``axes``, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        An order is not a whole number >= 1.

    Examples
    --------
    >>> diagram = fc.campbell(blade, [0.0, 150.0, 300.0], count=2)
    >>> figure = fc.draw_campbell(diagram, orders=[1, 2, 3], path="campbell.png")
    """
    for order in orders:
        check_count("orders", order, 1)
    [panel] = picture = Picture(**where)
    factor, _, unit = frequency_axis(in_hertz)
    pace, *name = speed_axis(in_rpm)
    speed, real = pace * diagram.speed, factor * diagram.omega_real
    reach = max(orders, default=0) * factor / pace * speed[-1]
    real = real[:, : max(1, int(np.sum(real.min(axis=0) <= reach)))]
    colours = list(COLOURS.values())[:-1]
    for mode in range(real.shape[1]):
        along, line, kinds = zip(*diagram.real_line(mode + 1), strict=True)
        colour, label = colours[mode % len(colours)], f"mode {mode + 1}"
        if diagram.cracked:
            label = ", ".join([label, *dict.fromkeys(STATES[kind] for kind in kinds)])
        panel.plot(pace * np.array(along), factor * np.array(line), color=colour, label=label)
        if diagram.cracked:
            ends = (factor * ends[:, mode] for ends in (diagram.omega_open, diagram.omega_tied))
            panel.fill_between(speed, *ends, color=colour, alpha=0.25, lw=0.0)
    top = 1.08 * float(real.max())
    panel.set(xlim=(speed[0], speed[-1]), ylim=(0.0, top))
    for order in orders:
        _draw_order(panel, order, order * factor / pace, (speed[0], speed[-1]), top)
        at = diagram.crossings(order, "real")[:, 1] * pace
        panel.plot(at, order * factor / pace * at, "o", color=COLOURS["grey"], mfc="none", ms=6)
    if diagram.cracked:
        panel.fill_between([], [], [], color=COLOURS["grey"], alpha=0.25, label="open to tied lips")
    panel.set(xlabel=with_unit(*name), ylabel=f"natural frequency [{unit}]")
    return picture.finished()


def _draw_order(
    panel: Any, order: int, slope: float, span: tuple[float, float], top: float
) -> None:
    """The line of an engine order, and its number where it leaves the panel."""
    ends = np.array(span)
    panel.plot(ends, slope * ends, color=COLOURS["grey"], lw=0.8, ls="--", alpha=0.7)
    if slope * span[1] <= top:
        place, align = (span[1], slope * span[1]), {"ha": "left", "va": "center"}
    else:
        place, align = (top / slope, top), {"ha": "center", "va": "bottom"}
    moved = {"xytext": (3, 0) if align["ha"] == "left" else (0, 2)}
    panel.annotate(
        str(order), place, textcoords="offset points", fontsize=8, color=COLOURS["grey"],
        annotation_clip=False, **moved, **align,
    )  # fmt: skip


def draw_arrivals(
    arrivals: ArrivalTimes, *, in_rpm: bool = False, **where: Unpack[Where]
) -> Figure:
    """Draw the displacements that the arrivals tell, for each probe.

    They stand over the revolutions, of a run-up over the speed. Each probe sees one point in a
    revolution: a vibration at an engine order is constant to it, any other one appears slow.

    Parameters
    ----------
    arrivals : ArrivalTimes
        What to draw.
    in_rpm : bool
        Speeds of a run-up in revolutions per minute, else in rad/s.
    **where
        ``axes``, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Examples
    --------
    >>> figure = fc.draw_arrivals(arrivals, path="arrivals.png")
    """
    [panel] = picture = Picture(**where)
    _draw_displacements(panel, arrivals, in_rpm)
    return picture.finished()


def _draw_displacements(panel: Axes, arrivals: ArrivalTimes, in_rpm: bool) -> None:
    """What each probe sees over the revolutions, of a run-up over the speed."""
    pace, *over = speed_axis(in_rpm)
    steady, turns = arrivals.steady, arrivals.first + np.arange(len(arrivals))
    place = turns if steady else pace * arrivals.speed
    size = 3.0 if len(arrivals) > 100 else 4.5
    colours = distinct_colours(len(arrivals.probes))
    columns = zip(arrivals.displacement.T, arrivals.probes, colours, cycle("osD^vPX"), strict=False)
    for column, probe, colour, marker in columns:
        label = f"probe at {np.degrees(probe):.4g}°"
        panel.plot(place, column, marker, color=colour, ms=size, mew=0, alpha=0.8, label=label)
    panel.set_xlabel("revolution" if steady else with_unit(*over))
    label_axis(panel.yaxis, "tip displacement", "m")


def draw_tip_fit(fit: TipFit, arrivals: ArrivalTimes, **where: Unpack[Where]) -> Figure:
    """Draw a fitted vibration, with the arrivals over its period, and the orders that were tried.

    Parameters
    ----------
    fit, arrivals : TipFit, ArrivalTimes
        A fit, and what it was fitted to.
    **where
        ``axes``, two of them, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        The number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_tip_fit(fc.fit_order(arrivals), arrivals, path="fit.png")
    """
    upper, lower = picture = Picture(2, size=(7.0, 7.0), **where)
    loads = max(1, round(1.0 / fit.multiples[0]))  # load periods of a response
    turns = np.linspace(0.0, loads, 500)
    wave = fit.displacement(2.0 * np.pi * turns / fit.order)
    seen = np.isfinite(arrivals.time)
    phase = (fit.order * fit.phases(arrivals)[seen] / (2.0 * np.pi)) % loads
    upper.plot(
        phase, arrivals.displacement[seen], "o", color=COLOURS["blue"], ms=3.5, mew=0, alpha=0.4,
        label="arrivals",
    )  # fmt: skip
    label = f"fit, order {fit.order:.6g}"
    upper.plot(turns, wave, color=COLOURS["orange"], lw=1.6, label=label)
    upper.set_xlabel("time / load period")
    label_axis(upper.yaxis, "tip displacement", "m")
    _draw_candidates(lower, fit.candidates, fit.order)
    return picture.finished()


def _draw_candidates(axes: Axes, tried: Candidates, order: float) -> None:
    """Residuals over orders, those alike and hidden marked."""
    bottom = 0.5 * float(np.nanmin(tried.residuals[tried.residuals > 0.0], initial=np.inf))
    if np.isfinite(bottom):
        axes.set_yscale("log")
    else:
        bottom = 0.0
    best = tried.orders == order
    kinds = {
        "other orders": (~best & ~tried.alike & ~tried.hidden, "o", "grey"),
        "cannot be measured": (tried.hidden & ~best, "X", "pink"),
        "fit as well": (~best & tried.alike & ~tried.hidden, "s", "blue"),
        "best": (best, "o", "orange"),
    }
    for label, (chosen, marker, colour) in kinds.items():
        if np.any(chosen):
            place, height = tried.orders[chosen], np.maximum(tried.residuals[chosen], bottom)
            axes.vlines(place, bottom, height, color=COLOURS[colour], lw=1.0)
            axes.plot(place, height, marker, color=COLOURS[colour], ms=5.0, label=label)
    axes.set_ylim(bottom=bottom)
    axes.set_xlabel("periods of the load in a revolution")
    if not np.any(tried.orders % 1.0):
        axes.xaxis.get_major_locator().set_params(integer=True)
    label_axis(axes.yaxis, "what the fit leaves", "m")


def draw_tip_track(track: TipTrack, *, in_hertz: bool = False, **where: Unpack[Where]) -> Figure:
    """Draw the amplitudes of a run-up over the load's frequency, with their standard errors.

    Parameters
    ----------
    track : TipTrack
        What to draw.
    in_hertz : bool
        Frequencies in Hz, not rad/s.
    **where
        ``axes``, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Examples
    --------
    >>> figure = fc.draw_tip_track(fc.track_order(arrivals, 6), path="track.png")
    """
    [panel] = picture = Picture(**where)
    factor, name, unit = frequency_axis(in_hertz)
    place = factor * track.omega
    series = zip(track.multiples, track.amplitudes.T, track.amplitude_errors.T, strict=True)
    for (multiple, sizes, errors), colour in zip(series, cycle(COLOURS.values()), strict=False):
        label = f"{multiple:g}x the load's frequency"
        panel.plot(place, sizes, ".-", color=colour, lw=0.8, ms=3.0, label=label)
        low, high = np.maximum(sizes - errors, 0.0), sizes + errors
        panel.fill_between(place, low, high, color=colour, alpha=0.25, lw=0)
    panel.set_xlabel(with_unit(name, unit))
    label_axis(panel.yaxis, "amplitude of the tip", "m")
    panel.set_ylim(bottom=0.0)
    return picture.finished()


def draw_passages(
    passages: Sequence[PassageFit], arrivals: ArrivalTimes, **where: Unpack[Where]
) -> Figure:
    """Draw a record over the speed, the resonances found in it, and the clearest of them closely:
    what one probe sees of each passage without drift, and the fit.

    Parameters
    ----------
    passages : sequence of PassageFit
        The clearest one first, as :func:`find_passages` gives them.
    arrivals : ArrivalTimes
        In which they were found.
    **where
        ``axes``, two of them, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        The number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_passages(fc.find_passages(arrivals), arrivals, path="passages.png")
    """
    upper, lower = picture = Picture(2, size=(7.0, 7.0), **where)
    _draw_displacements(upper, arrivals, in_rpm=True)
    for number, fit in enumerate(passages):
        upper.axvline(fit.speed / RPM, color=COLOURS["grey"], lw=0.7, ls="--", zorder=0)
        upper.annotate(
            f"{fit.order:g}", (fit.speed / RPM, 1.0), xycoords=("data", "axes fraction"),
            textcoords="offset points", xytext=(0, 2 + 9 * (number % 2)), ha="center", fontsize=8,
            color=COLOURS["grey"], annotation_clip=False,
        )  # fmt: skip
    if passages:
        fit = passages[0]
        _draw_passage(lower, fit, fit.compared(arrivals))
    else:
        lower.set_axis_off()
    return picture.finished()


def _draw_passage(
    axes: Axes, fit: PassageFit, runs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> None:
    """What the probe that sees most has seen of each passage, and the fit."""
    probe = int(np.argmax(sum(np.sum(motion**2, axis=0) for _, _, motion in runs)))
    for (speed, seen, motion), colour in zip(runs, cycle(COLOURS.values()), strict=False):
        way = "up" if speed[-1] > speed[0] else "down"
        axes.plot(speed / RPM, seen[:, probe], "o", color=colour, ms=3.0, mew=0, alpha=0.6)
        axes.plot(speed / RPM, motion[:, probe], color=colour, lw=1.2, label=f"fit, {way}")
    axes.set_xlabel("rotor speed [rpm]")
    label_axis(
        axes.yaxis, f"order {fit.order:g}, {fit.omega / TURN:.5g} Hz, probe {probe + 1}", "m"
    )
