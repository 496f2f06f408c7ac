"""Pictures of stress intensities at the tips of cracks."""

from __future__ import annotations

from typing import Unpack

import numpy as np
from matplotlib.figure import Figure

from fenics_crack.draw.figure import COLOURS, Picture, Where, distinct_colours, label_axis
from fenics_crack.study.stress_intensity import StressIntensity

__all__ = ["draw_stress_intensity"]

CLOSED = 0.01
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
        closed = np.where(one <= CLOSED * max(one.max(), 0.0), one, np.nan)
        if not np.all(np.isnan(closed)):
            panel.plot(time, closed, color=COLOURS["grey"], lw=4.0, label=shut)
            shut = "_" + shut.lstrip("_")  # once in the legend
    panel.axhline(0.0, color="black", lw=0.6)
    label_axis(panel.xaxis, "time", "s")
    label_axis(panel.yaxis, "stress intensity", "Pa m^0.5")
    return picture.finished()
