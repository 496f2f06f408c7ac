"""Pictures of studies: a posterior of measurements, errors by their causes, a crack that grows; of
rotors Campbell diagrams, arrivals at probes, what was fitted to them, a run-up."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, product
from textwrap import fill
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.basics.causes import CAUSES
from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.observables import QUANTITIES
from fenics_crack.basics.tables import (
    LEAST_ERROR,
    RPM,
    TURN,
    frequency_axis,
    quantity,
    speed_axis,
    with_unit,
)
from fenics_crack.draw.figure import (
    COLOURS,
    MAX_LETTERS_PER_LINE,
    Picture,
    PictureOptions,
    distinct_colours,
    label_axis,
    label_count_axis,
)
from fenics_crack.errors.convergence import SAFE
from fenics_crack.errors.verification import Verification
from fenics_crack.scene.scene import unit_of
from fenics_crack.scene.words import key_in_words

if TYPE_CHECKING:  # which load SciPy's interpolation, and DOLFINx
    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.arrivals.fit_order import TipTrack
    from fenics_crack.arrivals.harmonics import Candidates, TipFit
    from fenics_crack.arrivals.passages import PassageFit
    from fenics_crack.fatigue.growth import Growth
    from fenics_crack.monitoring.identification.result import Identification
    from fenics_crack.study.campbell import Campbell

CONTOUR_PROBABILITIES = (0.5, 0.95, 0.999)
"""Probabilities within the contours."""
MARKER_SHAPES = "osD^v<>ph*"
CAUSE_WORDS = {"shift": "mesh, shift of the resonance"}
Looks = dict[str, dict[str, Any]]
"""Marks and colours of quantities by their names."""


def draw_posterior(
    found: Identification,
    x: str | None = None,
    y: str | None = None,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw the regions that hold 50, 95 and 99.9 % of the probability of two unknowns, or the
    density of one, with the interval that holds 95 %.

    Whatever the other unknowns are. Each choice of an unknown that is a word, such as the edge of
    the crack, has its own colour.

    Parameters
    ----------
    found : Identification
        Made by :func:`identify`.
    x, y : str, optional
        The two unknowns, or one. Default: the first two, or the only one.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Matplotlib's figure, also with given ``axes``.

    Raises
    ------
    InputError
        These are not unknowns, or the same.

    Examples
    --------
    >>> found = fc.identify(scene, "measured.csv")  # doctest: +SKIP
    >>> figure = fc.draw_posterior(found, path="posterior.png")  # doctest: +SKIP
    """
    x, *others = [key for key in (x, y) if key is not None] or found.unknown[:2]
    for name, key in zip("xy", (x, *others), strict=False):
        if key not in found.unknown or others == [x]:
            raise InputError(name, key, f"one or two different ones of {', '.join(found.unknown)}")
    [panel] = picture = Picture(size=(6.0, 4.6), **picture_options)
    if not others:
        _draw_density(panel, found, x)
        return picture.finish()
    [y] = others
    first, second = (found.unknown.index(key) for key in (x, y))
    posterior = found.posterior
    grids = {
        name: (branch.axes[first], branch.axes[second], *posterior.pair(name, first, second))
        for name, branch in posterior.branches.items()
    }
    levels = _levels(list(grids.values()))
    within = [np.array([[found.estimate[x], found.estimate[y]]])]
    colours = distinct_colours(len(grids))
    for (name, (right, up, _, density)), colour in zip(grids.items(), colours, strict=True):
        at, shown = (right, up), _log(density.T)
        if shown.max() <= levels[0]:
            continue
        look: dict[str, Any] = {"linewidths": [0.6, 1.2, 1.8], "linestyles": "solid"}
        panel.contour(*at, shown, levels=levels, colors=colour, **look)
        for level in levels:
            panel.contourf(*at, shown, levels=[level, np.inf], alpha=0.2, colors=colour)
        label = f"50, 95 and 99.9 %{', ' if name else ''}{name}"
        panel.plot([], [], color=colour, lw=1.8, label=label)
        across, upwards = np.nonzero(shown.T > levels[0])
        within.append(np.column_stack([right[across], up[upwards]]))
    look = {"color": "black", "ms": 10, "mew": 1.5, "clip_on": False, "label": "estimate"}
    panel.plot(*within[0].T, "+", **look)
    axes = next(iter(posterior.branches.values())).axes
    _set_limits(panel, np.concatenate(within), (axes[first], axes[second]))
    label_axis(panel.xaxis, key_in_words(x), unit_of(x))
    label_axis(panel.yaxis, key_in_words(y), unit_of(y))
    return picture.finish()


def _draw_density(panel: Axes, found: Identification, x: str) -> None:
    """Draw the probability of one unknown, by a line for each choice of words."""
    place, posterior = found.unknown.index(x), found.posterior
    low, high = found.intervals[x]
    lines = {}
    for name, branch in posterior.branches.items():
        others = tuple(k for k in range(len(branch.axes)) if k != place)
        density = posterior.mass[name].sum(axis=others) / branch.weight.sum(axis=others)
        values = np.unique([*branch.axes[place], low, high])
        lines[name] = values, np.interp(values, branch.axes[place], density)
    most = max(density.max() for _, density in lines.values())
    colours = distinct_colours(len(lines))
    for (name, (values, density)), colour in zip(lines.items(), colours, strict=True):
        panel.plot(values, density / most, color=colour, label=name or "probability")
        within = (values >= low) & (values <= high)
        look = {"color": colour, "alpha": 0.2, "lw": 0.0, "label": "95 %"}
        panel.fill_between(values[within], density[within] / most, **look)
    panel.axvline(found.estimate[x], color="black", ls="--", label="estimate")
    panel.set_ylim(bottom=0.0)
    label_axis(panel.xaxis, key_in_words(x), unit_of(x))
    panel.set_ylabel("probability density over the largest")


def _levels(grids: list[tuple[np.ndarray, ...]]) -> list[float]:
    """log of the density at the borders of the regions, outermost first."""
    masses = np.concatenate([grid[2].ravel() for grid in grids])
    logs = _log(np.concatenate([grid[3].ravel() for grid in grids]))
    order = np.argsort(-logs)
    held = np.cumsum(masses[order])
    places = np.minimum(np.searchsorted(held, CONTOUR_PROBABILITIES), len(order) - 1)[::-1]
    return list(logs[order[places]] + 1e-6 * np.arange(len(places)))  # of one point rising, too


def _log(density: np.ndarray) -> np.ndarray:
    """The logarithm of a density, which is finite also where it is zero."""
    return np.log(np.maximum(density, np.finfo(float).tiny))


def _set_limits(panel: Any, within: np.ndarray, axes: tuple[np.ndarray, np.ndarray]) -> None:
    """Show the regions, with their points (n, 2), and some room around them, within the bounds."""
    for values, axis, change in zip(within.T, axes, (panel.set_xlim, panel.set_ylim), strict=True):
        room = 0.35 * np.ptp(values) + 0.02 * np.ptp(axis)
        change(max(axis[0], values.min() - room), min(axis[-1], values.max() + room))


def draw_verification(found: Verification, **picture_options: Unpack[PictureOptions]) -> Figure:
    """Draw the distance of each quantity from its extrapolated value over the size of elements, or
    of what else was varied first, and the contribution of each cause to its uncertainty.

    The second panel has a row for each quantity, with its line in the first one, if there is one,
    and the observed order, the slope of that line. Quantities outside of the asymptotic range have
    no line. Hollow marks stand for a factor of safety of 3, black bars for the root of the sum of
    squares.

    Parameters
    ----------
    found : Verification
        Made by :func:`verify`.
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
    size = 13.0, max(4.2, 1.8 + 0.3 * len(found.values))
    left, right = picture = Picture(2, n_columns=2, size=size, **picture_options)
    cause = next(iter(found.causes), "")
    looks = _looks(found, cause) if cause else {}
    _draw_orders(left, found, cause, looks)
    _draw_contributions(right, found, looks)
    return picture.finish()


def _draw_orders(panel: Axes, found: Verification, cause: str, looks: Looks) -> None:
    """|f_i - f| over h, relative to those of the scene's own choice."""
    widest, largest = np.ones(1), 100.0 * LEAST_ERROR
    for name, look in looks.items():
        part = found.parts[cause][name]
        away = np.abs(np.array(part.values) - part.extrapolated)
        shares = np.array([100.0 * found.relative(name, distance) for distance in away])
        widest, largest = np.array(part.sizes) / part.sizes[-1], max(largest, shares.max())
        panel.plot(widest, shares, **look)
    if not looks:
        panel.set_axis_off()
        panel.text(0.5, 0.5, "nothing to extrapolate", ha="center", transform=panel.transAxes)
        return
    ends = widest[[0, -1]]
    panel.plot(ends, 2.0 * largest * ends, color="black", ls=":", lw=1.2, label="first order")
    panel.set(xscale="log", yscale="log")
    panel.set_xticks(widest, labels=[f"{tick:.2g}" for tick in widest])
    panel.set_xticks([], minor=True)
    label_axis(panel.yaxis, "difference from the extrapolated value", "%")
    own = found.counts[cause][0]
    by_size = f"element size over that of the scene ({own} elements)"
    by_number = f"{own} {cause} of the scene over their number"
    panel.set_xlabel(by_size if cause == "mesh" else by_number)


def _looks(found: Verification, cause: str) -> Looks:
    """Return the looks of the lines, by the names of the quantities that are extrapolated."""
    drawn = [
        name
        for name, part in found.parts[cause].items()
        if part.is_asymptotic and found.values[name] and part.extrapolated not in part.values
    ]
    every = zip(drawn, product(MARKER_SHAPES, COLOURS.values()), strict=False)
    return {name: {"marker": mark, "color": colour, "ms": 5} for name, (mark, colour) in every}


def _draw_contributions(panel: Axes, found: Verification, looks: Looks) -> None:
    """Relative uncertainties by quantity and cause; beside each quantity its line in the other
    panel, and its observed order."""
    names, beside = list(found.values)[::-1], panel.get_yaxis_transform()
    colours = dict(zip(CAUSES, COLOURS.values(), strict=False))
    for place, name in enumerate(names):
        total = 100.0 * found.relative(name, found.total(name))
        if total > 100.0 * LEAST_ERROR:
            panel.plot([total, total], [place - 0.32, place + 0.32], color="black", lw=1.6)
        for cause, error in found.contributions(name).items():
            inside = found.parts[cause][name].factor <= SAFE
            share = 100.0 * found.relative(name, error)
            if share > 100.0 * LEAST_ERROR:
                look = {"color": colours[cause], "mfc": colours[cause] if inside else "none"}
                panel.plot(share, place, "o", ms=7, **look)
        if name in looks:
            at = {"transform": beside, "clip_on": False}
            panel.plot([-0.06, -0.035, -0.01], 3 * [place], markevery=[1], **at, **looks[name])
        if found.causes:
            part = found.parts[found.causes[0]][name]
            order = f"{part.order:.2g}" if np.isfinite(part.order) else part.behaviour
            panel.text(1.02, place, order, transform=beside, va="center", fontsize=9)
    for cause in found.causes:
        panel.plot([], [], "o", ms=7, color=colours[cause], label=CAUSE_WORDS.get(cause, cause))
    panel.plot([], [], "o", ms=7, color="grey", mfc="none", label="factor of safety 3")
    panel.plot([], [], color="black", lw=1.6, label="all together")
    if found.causes:
        panel.text(1.02, len(names) - 0.3, "observed order", transform=beside, fontsize=9)
    panel.set(xscale="log", ylim=(-0.6, len(names) - 0.4))
    panel.set_yticks(range(len(names)), [_in_words(found, name) for name in names], fontsize=9)
    panel.tick_params("y", pad=28, length=0)
    label_axis(panel.xaxis, "uncertainty of the scene's own value", "%")


def _in_words(found: Verification, name: str) -> str:
    """A quantity and its value: "half peak-to-peak, 1.094 µm"."""
    point, _, own = name.rpartition(".")
    kind, _, mode = own.replace("frequency_", "omega_").rpartition("_")
    row = QUANTITIES.get(own)
    words = f"{QUANTITIES[kind].words}, mode {mode}" if row is None else row.words
    if point:
        words += f", {found.scene.point_names.get(point, point)}"
    return f"{fill(words, MAX_LETTERS_PER_LINE)}, {quantity(found.values[name], found.units[name])}"


def draw_growth(
    found: Growth, *, in_hertz: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw a crack's length, the frequencies and its stress intensity over the cycles.

    Dots are the lengths that were solved; of a half-ellipse its depth and length are drawn.

    Parameters
    ----------
    found : Growth
        Of :func:`grow`.
    in_hertz : bool
        Frequencies in Hz instead of rad/s.
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
    size, solved = (7.0, 8.6), np.zeros(0)
    if found.depth is None:
        solved = found.solved[found.solved <= found.length[-1]]
    picture = Picture(3, size=size, sharex=True, **picture_options)
    length, frequency, strength = picture.panels
    at = np.interp(solved, found.length, found.cycles)
    factor, _, unit = frequency_axis(in_hertz)
    lines = {
        "length": (length, found.length, "blue", "-"),
        "load": (frequency, factor * found.omega, "black", "-"),
        "natural, breathing crack": (frequency, factor * found.omega_bilinear, "orange", "-"),
        "natural, open crack": (frequency, factor * found.omega_open, "green", "--"),
        r"effective range of $K_\mathrm{I}$": (strength, found.effective, "blue", "-"),
        r"$K_\mathrm{max}$": (strength, found.largest, "pink", ":"),
    }
    if found.depth is not None:
        lines["depth"] = length, found.depth, "orange", "-"
    for label, (panel, values, colour, style) in lines.items():
        look = {"color": COLOURS.get(colour, colour), "ls": style}
        panel.plot(found.cycles, values, label=label, **look)
    if len(solved):
        length.plot(at, solved, "o", color=COLOURS["blue"], ms=4.0, label="solved")
    there = np.interp(solved, found.length, found.effective)
    strength.plot(at, there, "o", color=COLOURS["blue"], ms=4.0)
    if found.effective.max() > 0.0:
        strength.set_yscale("log")
    label_axis(length.yaxis, "crack", "m")
    label_axis(frequency.yaxis, "frequency", unit)
    label_axis(strength.yaxis, "stress intensity", "Pa m^0.5")
    label_count_axis(strength.xaxis, "load cycles")
    return picture.finish()


# --- rotors ---------------------------------------------------------------------------------------


def draw_campbell(
    diagram: Campbell,
    orders: Sequence[int] = range(1, 9),
    *,
    in_hertz: bool = True,
    in_rpm: bool = True,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw natural frequencies over the speed: as lines those of the crack as it is held open, shut
    or partly open, or breathes at each speed, in bands from open to bonded; engine orders
    as grey lines with their numbers, and circles where they meet. Modes above the reach of all
    orders are left out, but for the first one.

    Parameters
    ----------
    diagram : Campbell
        Result to draw.
    orders : sequence of int
        Engine orders.
    in_hertz, in_rpm : bool
        Frequencies in Hz, else in rad/s; speeds in revolutions per minute, else in rad/s.
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
    from fenics_crack.study.campbell import STATES  # loaded with the diagram

    for order in orders:
        check_count("orders", order, 1)
    [panel] = picture = Picture(**picture_options)
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
        panel.fill_between([], [], [], color=COLOURS["grey"], alpha=0.25, label="open to bonded")
    panel.set(xlabel=with_unit(*name), ylabel=f"natural frequency [{unit}]")
    return picture.finish()


def _draw_order(
    panel: Any, order: int, slope: float, span: tuple[float, float], top: float
) -> None:
    """The line of an engine order, and its number where it leaves the panel."""
    ends = np.array(span)
    panel.plot(ends, slope * ends, color=COLOURS["grey"], lw=0.8, ls="--", alpha=0.7)
    if slope * span[1] <= top:
        _write_order(panel, order, (span[1], slope * span[1]), (3, 0), ha="left", va="center")
    else:
        _write_order(panel, order, (top / slope, top), (0, 2), ha="center", va="bottom")


def _write_order(panel: Any, order: float, place: Any, by: tuple[int, int], **look: Any) -> None:
    """Write an engine order beside a place, also outside of the panel."""
    look |= {"textcoords": "offset points", "fontsize": 8, "color": COLOURS["grey"]}
    panel.annotate(f"{order:g}", place, xytext=by, annotation_clip=False, **look)


def draw_arrivals(
    arrivals: ArrivalTimes, *, in_rpm: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw the displacements that follow from the arrivals, for each probe.

    They stand over the revolutions, of a run-up over the speed. Each probe sees one point in a
    revolution: a vibration at an engine order is constant to it, any other one appears slow.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Result to draw.
    in_rpm : bool
        Speeds of a run-up in revolutions per minute, else in rad/s.
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
    return picture.finish()


def _draw_displacements(panel: Axes, arrivals: ArrivalTimes, in_rpm: bool) -> None:
    """Draw each probe's displacements over the revolutions, in a run-up over the speed."""
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
    label_axis(panel.yaxis, "blade tip displacement", "m")


def draw_tip_fit(
    fit: TipFit, arrivals: ArrivalTimes, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw a fitted vibration, with the arrivals over its period, and the engine orders that were
    tried; of one order alone the amplitudes of its harmonics, with their standard errors.

    Parameters
    ----------
    fit, arrivals : TipFit, ArrivalTimes
        A fit, and what it was fitted to.
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
    upper, lower = picture = Picture(2, size=(7.0, 7.0), **picture_options)
    loads = max(1, round(1.0 / fit.multiples[0]))  # load periods of a response
    turns = np.linspace(0.0, loads, 500)
    wave = fit.displacement(2.0 * np.pi * turns / fit.order)
    seen = np.isfinite(arrivals.time)
    phase = (fit.order * fit.phases(arrivals)[seen] / (2.0 * np.pi)) % loads
    look: dict[str, Any] = {"color": COLOURS["blue"], "ms": 3.5, "mew": 0, "alpha": 0.4}
    upper.plot(phase, arrivals.displacement[seen], "o", **look, label="arrivals")
    upper.plot(turns, wave, color=COLOURS["orange"], lw=1.6, label=f"fit, order {fit.order:.6g}")
    upper.set_xlabel("time / load period")
    label_axis(upper.yaxis, "blade tip displacement", "m")
    if len(fit.candidates.orders) > 1:
        _draw_candidates(lower, fit.candidates, fit.order)
    else:
        _draw_harmonics(lower, fit)
    return picture.finish()


def _draw_candidates(axes: Axes, tried: Candidates, order: float) -> None:
    """Residuals over orders; those that fit as well, and hidden ones, are marked."""
    bottom = 0.5 * float(np.nanmin(tried.residuals[tried.residuals > 0.0], initial=np.inf))
    if np.isfinite(bottom):
        axes.set_yscale("log")
    else:
        bottom = 0.0
    best = tried.orders == order
    kinds = {
        "other orders": (~best & ~tried.equivalent & ~tried.hidden, "o", "grey"),
        "cannot be measured": (tried.hidden & ~best, "X", "pink"),
        "fit as well": (~best & tried.equivalent & ~tried.hidden, "s", "blue"),
        "best": (best, "o", "orange"),
    }
    for label, (chosen, marker, colour) in kinds.items():
        if np.any(chosen):
            place, height = tried.orders[chosen], np.maximum(tried.residuals[chosen], bottom)
            axes.vlines(place, bottom, height, color=COLOURS[colour], lw=1.0)
            axes.plot(place, height, marker, color=COLOURS[colour], ms=5.0, label=label)
    axes.set_ylim(bottom=bottom)
    axes.set_xlabel("engine order: load periods in a revolution")
    if not np.any(tried.orders % 1.0):
        axes.xaxis.get_major_locator().set_params(integer=True)
    label_axis(axes.yaxis, "rms residual of the fit", "m")


def _draw_harmonics(axes: Axes, fit: TipFit) -> None:
    """Amplitudes of the harmonics with their standard errors."""
    at, sizes, errors = fit.multiples, fit.amplitudes, fit.amplitude_errors
    both = np.append(sizes, errors)
    bottom = 0.5 * float(np.min(both, where=both > 0.0, initial=np.inf))
    if np.isfinite(bottom):
        axes.set_yscale("log")
        axes.set_ylim(bottom, 2.0 * both.max(where=both > 0.0, initial=bottom))
    look: dict[str, Any] = {"color": COLOURS["orange"], "ms": 5.0, "capsize": 4.0}
    axes.errorbar(at, sizes, errors, fmt="o", **look, label="fit, with standard errors")
    axes.set(xticks=at, xlim=(0.0, at[-1] + 0.5))
    axes.set_xlabel("harmonic of the load")
    label_axis(axes.yaxis, "amplitude of the blade tip", "m")


def draw_tip_track(
    track: TipTrack, *, in_hertz: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw the amplitudes of a run-up over the load's frequency, with their standard errors.

    Parameters
    ----------
    track : TipTrack
        Result to draw.
    in_hertz : bool
        Frequencies in Hz, not rad/s.
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
    factor, name, unit = frequency_axis(in_hertz)
    place = factor * track.omega
    series = zip(track.multiples, track.amplitudes.T, track.amplitude_errors.T, strict=True)
    for (multiple, sizes, errors), colour in zip(series, cycle(COLOURS.values()), strict=False):
        label = f"{multiple:g}x the load's frequency"
        panel.plot(place, sizes, ".-", color=colour, lw=0.8, ms=3.0, label=label)
        low, high = np.maximum(sizes - errors, 0.0), sizes + errors
        panel.fill_between(place, low, high, color=colour, alpha=0.25, lw=0)
    panel.set_xlabel(with_unit(name, unit))
    label_axis(panel.yaxis, "amplitude of the blade tip", "m")
    panel.set_ylim(bottom=0.0)
    return picture.finish()


def draw_passages(
    passages: Sequence[PassageFit],
    arrivals: ArrivalTimes,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw a record over the speed, the resonances found in it, and the clearest of them closely:
    what one probe sees of each passage without drift, and the fit.

    Parameters
    ----------
    passages : sequence of PassageFit
        The clearest one first, as :func:`find_passages` gives them.
    arrivals : ArrivalTimes
        In which they were found.
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
    upper, lower = picture = Picture(2, size=(7.0, 7.0), **picture_options)
    _draw_displacements(upper, arrivals, in_rpm=True)
    upper_edge = "data", "axes fraction"
    for number, fit in enumerate(passages):
        label = "_" * bool(number) + "resonance, with its engine order"
        look: dict[str, Any] = {"color": COLOURS["grey"], "lw": 0.7, "ls": "--", "zorder": 0}
        upper.axvline(fit.speed / RPM, **look, label=label)
        place, above = (fit.speed / RPM, 1.0), (0, 2 + 9 * (number % 2))
        _write_order(upper, fit.order, place, above, ha="center", xycoords=upper_edge)
    if passages:
        _draw_passage(lower, passages[0], arrivals)
    else:
        lower.set_axis_off()
    return picture.finish()


def _draw_passage(axes: Axes, fit: PassageFit, arrivals: ArrivalTimes) -> None:
    """Draw each passage as measured by the probe with the largest motion, and the fit."""
    runs = fit.compared(arrivals)
    probe = int(np.argmax(sum(np.sum(motion**2, axis=0) for _, _, motion in runs)))
    for (speed, seen, motion), colour in zip(runs, cycle(COLOURS.values()), strict=False):
        way = "up" if speed[-1] > speed[0] else "down"
        look: dict[str, Any] = {"color": colour, "ms": 3.0, "mew": 0, "alpha": 0.6}
        axes.plot(speed / RPM, seen[:, probe], "o", **look, label=f"arrivals, {way}")
        axes.plot(speed / RPM, motion[:, probe], color=colour, lw=1.2, label=f"fit, {way}")
    axes.set_xlabel("rotor speed [rpm]")
    label_axis(axes.yaxis, "blade tip displacement", "m")
    angle = np.degrees(arrivals.probes[probe])
    title = f"order {fit.order:g}, {fit.omega / TURN:.5g} Hz, probe at {angle:.4g}°"
    axes.set_title(title, fontsize="medium")
