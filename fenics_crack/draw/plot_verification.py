"""Pictures of a verification: convergence with the mesh, and what each cause contributes."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fenics_crack.draw.figure import COLOURS, finish, label_axis, make_axes
from fenics_crack.study.grid_convergence import SAFE, GridConvergence
from fenics_crack.study.verification import CAUSES, Verification

__all__ = ["draw_verification"]

LEAST = 1e-4
"""Contributions that are drawn, at least [%]."""
MARKS = "osD^v<>ph*"


def draw_verification(
    found: Verification,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the distance of each quantity from its extrapolated value over the size of elements, or
    of what else was varied first, and the contribution of each cause to its uncertainty.

    The slope of a line is the observed order, which the legend has, too; quantities outside of the
    asymptotic range have no line. In the second panel hollow marks stand for a factor of safety of
    3, and black lines for the root of the sum of squares.

    Parameters
    ----------
    found : Verification
        Made by :func:`verify`.
    axes, path, title
        As of :func:`draw_waves`, with two panels.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Examples
    --------
    >>> found = fc.verify(scene)  # doctest: +SKIP
    >>> figure = fc.draw_verification(found, path="verification.png")  # doctest: +SKIP
    """
    left, right = make_axes(axes, path, 2, columns=2, size=(12.0, 5.6))
    if found.causes:
        _draw_orders(left, found, found.causes[0])
    _draw_contributions(right, found)
    finish(right, None, None)
    return finish(left, path, title)


def _draw_orders(panel: Any, found: Verification, cause: str) -> None:
    """|f_i - f| over h, relative to those of the scene's own choice."""
    colours, smallest, largest = cycle(COLOURS.values()), 1.0, LEAST
    for (name, part), mark in zip(found.parts[cause].items(), cycle(MARKS), strict=False):
        look = {"color": next(colours), "marker": mark, "ms": 5}
        label = f"{name}, {_order(part)}"
        away = np.abs(np.array(part.values) - part.extrapolated)
        shares = np.array([100.0 * found.relative(name, distance) for distance in away])
        sizes = np.array(part.sizes) / part.sizes[-1]
        if part.is_asymptotic and np.all(shares > 0.0):
            smallest, largest = min(smallest, sizes[0]), max(largest, shares.max())
            panel.plot(sizes, shares, label=label, **look)
        else:
            panel.plot([], [], ls="", label=label, **look)
    if smallest < 1.0:
        ends = np.array([smallest, 1.0])
        panel.plot(ends, 2.0 * largest * ends, color="black", ls=":", lw=1.2, label="first order")
        ticks = np.array([smallest, np.sqrt(smallest), 1.0])
        panel.set(xscale="log", yscale="log")
        panel.set_xticks(ticks, labels=[f"{tick:.2g}" for tick in ticks])
        panel.set_xticks([], minor=True)
        label_axis(panel.yaxis, "distance from extrapolated", "%")
    own = found.counts[cause][0]
    text = f"{own} {cause} of the scene over their number"
    if cause == "mesh":
        text = f"size of elements over that of the scene's {own} elements"
    panel.set_xlabel(text)


def _order(part: GridConvergence) -> str:
    return f"p = {part.order:.2g}" if np.isfinite(part.order) else part.behaviour


def _draw_contributions(panel: Any, found: Verification) -> None:
    """Relative uncertainties by quantity and cause."""
    names = list(found.values)[::-1]
    colours = dict(zip(CAUSES, COLOURS.values(), strict=False))
    for place, name in enumerate(names):
        total = 100.0 * found.relative(name, found.total(name))
        if total > LEAST:
            panel.plot([total, total], [place - 0.32, place + 0.32], color="black", lw=1.6)
        for cause, error in found.contributions(name).items():
            inside = found.parts[cause][name].factor == SAFE
            share = 100.0 * found.relative(name, error)
            if not share > LEAST:
                continue
            look = {"color": colours[cause], "mfc": colours[cause] if inside else "none"}
            panel.plot(share, place, "o", ms=7, **look)
    for cause in found.causes:
        panel.plot([], [], "o", ms=7, color=colours[cause], label=cause)
    panel.plot([], [], "o", ms=7, color="grey", mfc="none", label="factor of safety 3")
    panel.plot([], [], color="black", lw=1.6, label="root of the sum of squares")
    panel.set(xscale="log", yticks=range(len(names)), ylim=(-0.6, len(names) - 0.4))
    panel.set_yticklabels(names)
    label_axis(panel.xaxis, "uncertainty of the scene's own value", "%")
