"""A picture of what measurements tell: how probable each length and place is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fenics_crack.draw.figure import COLOURS, distinct_colours, finish, label_axis, make_axes
from fenics_crack.errors import InputError
from fenics_crack.identification.posterior import trapezoid
from fenics_crack.identification.result import Identification
from fenics_crack.scene.words import key_in_words, unit_of

__all__ = ["draw_posterior"]

SHARES = (0.5, 0.95, 0.999)
"""Of the probability within each contour."""
ROOM = 0.35
"""Around the outermost contour, over its size."""
EMPTY = 1e-300


def draw_posterior(
    found: Identification,
    x: str = "crack.length",
    y: str = "crack.height",
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the regions that hold 50, 95 and 99.9 % of the probability of two unknowns.

    Whatever the other unknowns are. Each choice of an unknown that is a word, such as the edge of
    the crack, has its own colour.

    Parameters
    ----------
    found : Identification
        Made by :func:`identify`.
    x, y : str
        The two unknowns.
    axes, path, title
        As of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        These are not two of the unknowns.

    Examples
    --------
    >>> found = fc.load("identify.h5")  # doctest: +SKIP
    >>> figure = fc.draw_posterior(found, path="posterior.png")  # doctest: +SKIP
    """
    for name, key in (("x", x), ("y", y)):
        if key not in found.unknown or x == y:
            allowed = f"two different ones of {', '.join(found.unknown)}"
            raise InputError(name, key, allowed)
    [panel] = make_axes(axes, path, size=(6.0, 4.6))
    first, second = (found.unknown.index(key) for key in (x, y))
    posterior = found.posterior
    grids = {}
    for name, branch in posterior.branches.items():
        right, up = branch.axes[first], branch.axes[second]
        mass = posterior.pair(name, first, second)
        grids[name] = right, up, mass, mass / np.multiply.outer(trapezoid(right), trapezoid(up))
    levels = _levels(list(grids.values()))
    ends = []
    for (name, (right, up, _, density)), colour in zip(
        grids.items(), distinct_colours(len(grids)), strict=True
    ):
        shown = np.log(np.maximum(density.T, EMPTY))
        if shown.max() <= levels[0]:
            continue
        look: dict[str, Any] = {"colors": COLOURS.get(colour, colour)}
        panel.contour(
            right, up, shown, levels=levels, linewidths=[0.6, 1.2, 1.8], linestyles="solid", **look
        )
        for level in levels:
            panel.contourf(right, up, shown, levels=[level, np.inf], alpha=0.2, **look)
        label = f"50, 95 and 99.9 %{', ' if name else ''}{name}"
        panel.plot([], [], color=look["colors"], lw=1.8, label=label)
        within = np.argwhere(shown.T > levels[0])
        for low, high in ((within.min(axis=0), within.max(axis=0)),):
            ends += [(right[low[0]], up[low[1]]), (right[high[0]], up[high[1]])]
    best = found.estimate
    panel.plot(
        best[x], best[y], "+", color="black", ms=10, mew=1.5, clip_on=False, label="estimate"
    )
    _set_limits(panel, np.array([*ends, (best[x], best[y])]), found, (first, second))
    label_axis(panel.xaxis, key_in_words(x), unit_of(x))
    label_axis(panel.yaxis, key_in_words(y), unit_of(y))
    return finish(panel, path, title)


def _levels(grids: list[tuple[np.ndarray, ...]]) -> list[float]:
    """log of the density at the borders of the regions, outermost first."""
    masses = np.concatenate([grid[2].ravel() for grid in grids])
    logs = np.log(np.maximum(np.concatenate([grid[3].ravel() for grid in grids]), EMPTY))
    order = np.argsort(-logs)
    held = np.cumsum(masses[order])
    places = [min(int(np.searchsorted(held, share)), len(order) - 1) for share in SHARES]
    found = [float(logs[order[place]]) for place in places][::-1]
    for number in (1, 2):  # of a region of one point, too
        found[number] = max(found[number], found[number - 1] + 1e-6)
    return found


def _set_limits(
    panel: Any, ends: np.ndarray, found: Identification, places: tuple[int, int]
) -> None:
    """Show the regions and some room around them, within the bounds."""
    branch = next(iter(found.posterior.branches.values()))
    low, high = ends.min(axis=0), ends.max(axis=0)
    for column, (place, change) in enumerate(
        zip(places, (panel.set_xlim, panel.set_ylim), strict=True)
    ):
        axis = branch.axes[place]
        least = 0.02 * (axis[-1] - axis[0])
        room = ROOM * (high[column] - low[column]) + least
        change(max(axis[0], low[column] - room), min(axis[-1], high[column] + room))
