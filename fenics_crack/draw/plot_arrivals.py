"""Pictures of blade tip timing: arrivals, what was fitted to them, and a run-up."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.fit_order import TipTrack
from fenics_crack.arrivals.harmonics import Candidates, TipFit
from fenics_crack.draw.figure import (
    COLOURS,
    distinct_colours,
    figure_of,
    finish,
    label_axis,
    make_axes,
)
from fenics_crack.table import frequency_axis, speed_axis, with_unit

__all__ = ["draw_arrivals", "draw_tip_fit", "draw_tip_track"]


def draw_arrivals(
    arrivals: ArrivalTimes,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    in_rpm: bool = False,
) -> Figure:
    """Draw the displacements that the arrivals tell, for each probe.

    They stand over the revolutions, of a run-up over the speed. Each probe sees one point in a
    revolution: a vibration at an engine order is constant to it, any other one appears slow.

    Parameters
    ----------
    arrivals : ArrivalTimes
        What to draw.
    axes : Axes, optional
        Where to draw; default: a new figure.
    path : str or Path, optional
        Where to save the new figure.
    title : str, optional
        Title of the picture.
    in_rpm : bool
        Speeds of a run-up in revolutions per minute, else in rad/s.
    """
    [panel] = make_axes(axes, path)
    pace, *over = speed_axis(in_rpm)
    steady, turns = arrivals.steady, arrivals.first + np.arange(len(arrivals))
    place = turns if steady else pace * arrivals.speed
    size = 3.0 if len(arrivals) > 100 else 4.5
    colours = [COLOURS.get(name, name) for name in distinct_colours(len(arrivals.probes))]
    columns = zip(arrivals.displacement.T, arrivals.probes, colours, cycle("osD^vPX"), strict=False)
    for column, probe, colour, marker in columns:
        label = f"probe at {np.degrees(probe):.4g}°"
        panel.plot(place, column, marker, color=colour, ms=size, mew=0, alpha=0.8, label=label)
    panel.set_xlabel("revolution" if steady else with_unit(*over))
    label_axis(panel.yaxis, "tip displacement", "m")
    return finish(panel, path, title)


def draw_tip_fit(
    fit: TipFit,
    arrivals: ArrivalTimes,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
) -> Figure:
    """Draw a fitted vibration, with the arrivals over its period, and the orders that were tried.

    Parameters
    ----------
    fit, arrivals : TipFit, ArrivalTimes
        A fit, and what it was fitted to.
    axes : two Axes, optional
        Where to draw; default: a new figure.
    path, title
        As of :func:`draw_arrivals`.

    Raises
    ------
    InputError
        The number of axes is wrong.
    """
    upper, lower = make_axes(axes, path, 2, size=(7.0, 7.0))
    loads = max(1, round(1.0 / fit.multiples[0]))  # load periods of a response
    turns = np.linspace(0.0, loads, 500)
    wave = fit.displacement(2.0 * np.pi * turns / fit.order)
    seen = np.isfinite(arrivals.time)
    phase = (fit.order * arrivals.angle[seen] / (2.0 * np.pi)) % loads
    upper.plot(
        phase, arrivals.displacement[seen], "o", color=COLOURS["blue"], ms=3.5, mew=0, alpha=0.4,
        label="arrivals",
    )  # fmt: skip
    label = f"fit, order {fit.order:.6g}"
    upper.plot(turns, wave, color=COLOURS["orange"], lw=1.6, label=label)
    upper.set_xlabel("time / load period")
    label_axis(upper.yaxis, "tip displacement", "m")
    finish(upper, None, None)
    _draw_candidates(lower, fit.candidates, fit.order)
    finish(lower, None, None)
    return figure_of(upper, path, title)


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
    label_axis(axes.yaxis, "what the fit leaves", "m")


def draw_tip_track(
    track: TipTrack,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    in_hertz: bool = False,
) -> Figure:
    """Draw the amplitudes of a run-up over the load's frequency, with their standard errors.

    Parameters
    ----------
    track : TipTrack
        What to draw.
    axes, path, title
        As of :func:`draw_arrivals`.
    in_hertz : bool
        Frequencies in Hz, not rad/s.
    """
    [panel] = make_axes(axes, path)
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
    return finish(panel, path, title)
