"""Campbell diagrams: natural frequencies over a rotor's speed, with engine-order lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fenics_crack.draw.figure import COLOURS, finish, make_axes
from fenics_crack.errors import check_count
from fenics_crack.study.campbell import Campbell
from fenics_crack.table import frequency_axis, speed_axis, with_unit

__all__ = ["draw_campbell"]


def draw_campbell(
    diagram: Campbell,
    orders: Sequence[int] = range(1, 9),
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    in_hertz: bool = True,
    in_rpm: bool = True,
) -> Figure:
    """Draw natural frequencies over the speed: bilinear ones as lines, in bands from lips open to
    lips tied; engine orders as grey lines with their numbers, and circles where they meet. Modes
    above the reach of all orders are left out, but for the first one.

    Parameters
    ----------
    diagram : Campbell
        What is drawn.
    orders : sequence of int
        Engine orders.
    axes, path, title
        As of :func:`draw_waves`.
    in_hertz, in_rpm : bool
        Frequencies in Hz, else in rad/s; speeds in revolutions per minute, else in rad/s.

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
    [panel] = make_axes(axes, path)
    factor, _, unit = frequency_axis(in_hertz)
    pace, *name = speed_axis(in_rpm)
    speed, bilinear = pace * diagram.speed, factor * diagram.omega_bilinear
    reach = max(orders, default=0) * factor / pace * speed[-1]
    bilinear = bilinear[:, : max(1, int(np.sum(bilinear.min(axis=0) <= reach)))]
    colours = list(COLOURS.values())[:-1]
    for mode, line in enumerate(bilinear.T):
        colour = colours[mode % len(colours)]
        label = f"mode {mode + 1}" + (", breathing" if diagram.cracked else "")
        panel.plot(speed, line, color=colour, label=label)
        if diagram.cracked:
            ends = (factor * ends[:, mode] for ends in (diagram.omega_open, diagram.omega_tied))
            panel.fill_between(speed, *ends, color=colour, alpha=0.25, lw=0.0)
    top = 1.08 * float(bilinear.max())
    panel.set(xlim=(speed[0], speed[-1]), ylim=(0.0, top))
    for order in orders:
        _draw_order(panel, order, order * factor / pace, (speed[0], speed[-1]), top)
        at = diagram.crossings(order)[:, 1] * pace
        panel.plot(at, order * factor / pace * at, "o", color=COLOURS["grey"], mfc="none", ms=6)
    if diagram.cracked:
        panel.fill_between([], [], [], color=COLOURS["grey"], alpha=0.25, label="open to tied lips")
    panel.set(xlabel=with_unit(*name), ylabel=f"natural frequency [{unit}]")
    return finish(panel, path, title)


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
