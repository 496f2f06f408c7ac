"""Pictures of studies: a posterior of measurements, errors by their causes, a crack that grows."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib.figure import Figure

from fenics_crack.draw.figure import COLOURS, Picture, Where, distinct_colours, label_axis
from fenics_crack.errors import InputError
from fenics_crack.scene.words import key_in_words, unit_of
from fenics_crack.study.verification import CAUSES, SAFE, GridConvergence, Verification
from fenics_crack.table import frequency_axis

if TYPE_CHECKING:  # which load SciPy's interpolation, and DOLFINx
    from fenics_crack.identification.result import Identification
    from fenics_crack.sweep.growth import Growth

__all__ = ["draw_growth", "draw_posterior", "draw_verification"]

SHARES = (0.5, 0.95, 0.999)
"""Of the probability within each contour."""
MARGIN = 0.35
"""Around the outermost contour, over its size."""
EMPTY = 1e-300
LEAST_DRAWN = 1e-4
"""Contributions that are drawn, at least [%]."""
MARKS = "osD^v<>ph*"


def draw_posterior(
    found: Identification, x: str = "crack.length", y: str = "crack.height", **where: Unpack[Where]
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
    **where
        ``axes``, ``path`` and ``title``, as of :func:`draw_waves`.

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
            raise InputError(name, key, f"two different ones of {', '.join(found.unknown)}")
    [panel] = picture = Picture(size=(6.0, 4.6), **where)
    first, second = (found.unknown.index(key) for key in (x, y))
    posterior = found.posterior
    grids = {}
    for name, branch in posterior.branches.items():
        grids[name] = branch.axes[first], branch.axes[second], *posterior.pair(name, first, second)
    levels = _levels(list(grids.values()))
    within = [np.array([[found.estimate[x], found.estimate[y]]])]
    for (name, (right, up, _, density)), colour in zip(
        grids.items(), distinct_colours(len(grids)), strict=True
    ):
        shown = np.log(np.maximum(density.T, EMPTY))
        if shown.max() <= levels[0]:
            continue
        look: dict[str, Any] = {"colors": colour}
        panel.contour(
            right, up, shown, levels=levels, linewidths=[0.6, 1.2, 1.8], linestyles="solid", **look
        )
        for level in levels:
            panel.contourf(right, up, shown, levels=[level, np.inf], alpha=0.2, **look)
        label = f"50, 95 and 99.9 %{', ' if name else ''}{name}"
        panel.plot([], [], color=look["colors"], lw=1.8, label=label)
        across, upwards = np.nonzero(shown.T > levels[0])
        within.append(np.column_stack([right[across], up[upwards]]))
    look = {"color": "black", "ms": 10, "mew": 1.5, "clip_on": False, "label": "estimate"}
    panel.plot(*within[0].T, "+", **look)
    axes = next(iter(posterior.branches.values())).axes
    _set_limits(panel, np.concatenate(within), (axes[first], axes[second]))
    label_axis(panel.xaxis, key_in_words(x), unit_of(x))
    label_axis(panel.yaxis, key_in_words(y), unit_of(y))
    return picture.finished()


def _levels(grids: list[tuple[np.ndarray, ...]]) -> list[float]:
    """log of the density at the borders of the regions, outermost first."""
    masses = np.concatenate([grid[2].ravel() for grid in grids])
    logs = np.log(np.maximum(np.concatenate([grid[3].ravel() for grid in grids]), EMPTY))
    order = np.argsort(-logs)
    held = np.cumsum(masses[order])
    places = np.minimum(np.searchsorted(held, SHARES), len(order) - 1)[::-1]
    rising = 1e-6 * np.arange(len(places))  # of a region of one point, too
    return list(logs[order[places]] + rising)


def _set_limits(panel: Any, within: np.ndarray, axes: tuple[np.ndarray, np.ndarray]) -> None:
    """Show the regions, with their points (n, 2), and some room around them, within the bounds."""
    for values, axis, change in zip(within.T, axes, (panel.set_xlim, panel.set_ylim), strict=True):
        room = MARGIN * np.ptp(values) + 0.02 * np.ptp(axis)
        change(max(axis[0], values.min() - room), min(axis[-1], values.max() + room))


def draw_verification(found: Verification, **where: Unpack[Where]) -> Figure:
    """Draw the distance of each quantity from its extrapolated value over the size of elements, or
    of what else was varied first, and the contribution of each cause to its uncertainty.

    The slope of a line is the observed order, which the legend has, too; quantities outside of the
    asymptotic range have no line. In the second panel hollow marks stand for a factor of safety of
    3, and black lines for the root of the sum of squares.

    Parameters
    ----------
    found : Verification
        Made by :func:`verify`.
    **where
        ``axes``, two of them, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Examples
    --------
    >>> found = fc.verify(scene)  # doctest: +SKIP
    >>> figure = fc.draw_verification(found, path="verification.png")  # doctest: +SKIP
    """
    left, right = picture = Picture(2, columns=2, size=(12.0, 5.6), **where)
    if found.causes:
        _draw_orders(left, found, found.causes[0])
    _draw_contributions(right, found)
    return picture.finished()


def _draw_orders(panel: Any, found: Verification, cause: str) -> None:
    """|f_i - f| over h, relative to those of the scene's own choice."""
    colours, smallest, largest = cycle(COLOURS.values()), 1.0, LEAST_DRAWN
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
        if total > LEAST_DRAWN:
            panel.plot([total, total], [place - 0.32, place + 0.32], color="black", lw=1.6)
        for cause, error in found.contributions(name).items():
            inside = found.parts[cause][name].factor <= SAFE
            share = 100.0 * found.relative(name, error)
            if not share > LEAST_DRAWN:
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
    if found.effective.max() > 0.0:
        strength.set_yscale("log")
    label_axis(length.yaxis, "length of the crack", "m")
    label_axis(frequency.yaxis, "frequency", unit)
    label_axis(strength.yaxis, "stress intensity", "Pa m^0.5")
    strength.set_xlabel("cycles")
    return picture.finished()
