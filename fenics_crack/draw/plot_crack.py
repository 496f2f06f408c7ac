"""Pictures of a crack's tips: what opens them over a period, and how they grow over many."""

from __future__ import annotations

from typing import Unpack

import numpy as np
from matplotlib.figure import Figure

from fenics_crack.draw.figure import COLOURS, Picture, Where, distinct_colours, label_axis
from fenics_crack.growth.result import Growth
from fenics_crack.study.over_time import StressIntensity
from fenics_crack.table import frequency_axis

__all__ = ["draw_growth", "draw_stress_intensity"]

SHOWN_CLOSED = 0.01
"""Part of the largest K_I below which a tip is shown as closed."""


def draw_stress_intensity(found: StressIntensity, **where: Unpack[Where]) -> Figure:
    """Draw K_I at each tip over time, grey and thick where the tip is closed, and K_II dashed.

    Parameters
    ----------
    found : StressIntensity
        Of :func:`stress_intensity`.
    **where
        ``axes``, ``path``, ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        There are several axes.

    Examples
    --------
    >>> figure = fc.draw_stress_intensity(fc.stress_intensity(fc.solve(scene)), path="tips.png")
    """
    [panel] = picture = Picture(**where)
    time, shut = found.time - found.time[0], "the tip is closed"
    styles = zip(found.tips, distinct_colours(len(found.tips)), strict=True)
    for number, (tip, colour) in enumerate(styles):
        one, two = found.one[:, number], found.two[:, number]
        panel.plot(time, one, color=colour, lw=1.8, label=f"K_I, {tip}")
        panel.plot(time, two, color=colour, lw=1.0, ls="--", label=f"K_II, {tip}")
        closed = np.where(one <= SHOWN_CLOSED * max(one.max(), 0.0), one, np.nan)
        if not np.all(np.isnan(closed)):
            panel.plot(time, closed, color=COLOURS["grey"], lw=4.0, label=shut)
            shut = "_" + shut.lstrip("_")  # once in the legend
    panel.axhline(0.0, color="black", lw=0.6)
    label_axis(panel.xaxis, "time", "s")
    label_axis(panel.yaxis, "stress intensity", "Pa m^0.5")
    return picture.finished()


def draw_growth(found: Growth, *, in_hertz: bool = False, **where: Unpack[Where]) -> Figure:
    """Draw a crack's length, the frequencies and its stress intensity over the cycles.

    Dots are the lengths that were solved.

    Parameters
    ----------
    found : Growth
        Of :func:`grow`.
    in_hertz : bool
        Frequencies in Hz instead of rad/s.
    **where
        ``axes`` (three), ``path``, ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        There are not three axes.

    Examples
    --------
    >>> figure = fc.draw_growth(fc.grow(growing), path="growth.png")  # doctest: +SKIP
    """
    size, solved = (7.0, 8.6), found.solved[found.solved <= found.length[-1]]
    picture = Picture(3, size=size, sharex=True, **where)
    length, frequency, strength = picture.panels
    at = np.interp(solved, found.length, found.cycles)
    length.plot(found.cycles, found.length, color=COLOURS["blue"], label="crack")
    length.plot(at, solved, "o", color=COLOURS["blue"], ms=4.0, label="solved")
    factor, name, unit = frequency_axis(in_hertz)
    lines = {
        name: (found.omega, "black", "-"),
        "natural frequency, crack breathing": (found.omega_bilinear, COLOURS["orange"], "-"),
        "lips open": (found.omega_open, COLOURS["green"], "--"),
    }
    for label, (omega, colour, style) in lines.items():
        frequency.plot(found.cycles, factor * omega, color=colour, ls=style, label=label)
    strength.plot(
        found.cycles, found.effective, color=COLOURS["blue"], label="effective range of K_I"
    )
    strength.plot(found.cycles, found.largest, color=COLOURS["pink"], ls=":", label="K_max")
    there = np.interp(solved, found.length, found.effective)
    strength.plot(at, there, "o", color=COLOURS["blue"], ms=4.0)
    strength.set_yscale("log")
    label_axis(length.yaxis, "length of the crack", "m")
    label_axis(frequency.yaxis, "frequency", unit)
    label_axis(strength.yaxis, "stress intensity", "Pa m^0.5")
    strength.set_xlabel("cycles")
    return picture.finished()
