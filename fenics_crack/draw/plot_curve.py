"""Pictures of response curves: their size and stability, their harmonics, their multipliers."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.tables import frequency_axis, percent, quantity, with_unit
from fenics_crack.curves.curve import ResponseCurve, kind_in_words, parameter_axis
from fenics_crack.curves.peak import damping_by_width
from fenics_crack.draw.figure import (
    COLOURS,
    FIRST_IN_LEGEND_GID,
    Picture,
    PictureOptions,
    distinct_colours,
    label_axis,
)
from fenics_crack.numerics.fourier import to_complex

BEHIND = ("#8f8f8f", "#cc8fb1", "#6fb59a")
"""Other curves, drawn behind the one in question."""
MARKERS = {"fold": "v", "branch_point": "s", "period_doubling": "D", "neimark_sacker": "^"}
VERDICT_STYLES = {"stable": "-", "unstable": "--", "irregular": "-.", "undecided": ":"}
UNASSESSED = "stability not examined"
INEXACT = f"faint: estimated error above {100 * LARGE_ERROR:g} %"


def draw_curve(
    curve: ResponseCurve,
    dof: int | None = None,
    *,
    colour: str = "blue",
    label: str = "",
    behind: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    points: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    in_hertz: bool = False,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw half the peak-to-peak displacement of a dof along a response curve.

    Stable parts are solid, unstable ones dashed, irregular ones dash-dotted and undecided ones
    dotted; the legend says so where the curve has no multipliers. Parts whose displacement has a
    large estimated error are faint. A ring marks the largest response, whose place and size the
    legend has. Bifurcations are marked, of many in one place only some, and the legend has their
    number. The order of the largest harmonic stands at superharmonic peaks.

    Parameters
    ----------
    curve : ResponseCurve
        Result to draw.
    dof : int, optional
        Whose displacement; default: the watched one.
    colour, label : str
        "blue", "orange", "green", "pink", "grey" or a colour of matplotlib, and the legend entry,
        for several curves on the same axes; with a label, bifurcations have the curve's colour.
    behind, points : mapping, optional
        Other curves, and single points, by their labels: values of the parameter, amplitudes [m].
    in_hertz : bool
        Load frequencies in Hz and speeds in rpm, those of ``behind`` and ``points`` too, which are
        given in rad/s.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Figure of matplotlib, also with given ``axes``.

    Examples
    --------
    >>> figure = fc.draw_curve(curve, tip, in_hertz=True, path="curve.png")
    """
    [panel] = picture = Picture(**picture_options)
    if curve.parameter == "omega":
        panel.set_yscale("log")
    amplitude, factor = curve.amplitude(dof), parameter_axis(curve.parameter, in_hertz)[0]
    for (name, (values, others)), grey in zip((behind or {}).items(), cycle(BEHIND), strict=False):
        panel.plot(factor * values, others, color=grey, lw=0.9, label=name)
    ink = COLOURS.get(colour, colour)
    _draw_parts(panel, curve, factor * curve.values, amplitude, ink, label)
    _mark_peak(panel, curve, dof, in_hertz, ink if label else "")
    _mark_bifurcations(panel, curve, dof, factor, ink if label else "")
    for (name, (values, others)), marker in zip((points or {}).items(), cycle("^v"), strict=False):
        look = {"color": COLOURS["green"], "ms": 4.5, "mfc": "none", "label": name}
        panel.plot(factor * values, others, marker, **look)
    if curve.parameter == "omega":
        _mark_superharmonics(panel, curve, dof, amplitude, factor)
    _label_parameter(panel, curve, in_hertz)
    panel.margins(y=0.1)
    label_axis(panel.yaxis, "half peak-to-peak displacement", "m")
    return picture.finish()


def _draw_parts(
    axes: Axes, curve: ResponseCurve, x: np.ndarray, y: np.ndarray, ink: str, label: str
) -> None:
    """Draw the parts of a curve by their stability and estimated error."""
    known = curve.multipliers is not None
    states = curve.verdicts if known else np.full(len(x), "stable")
    inexact, faint = curve.displacement_errors > LARGE_ERROR, {"alpha": 0.3}
    if label:
        name = label if known else f"{label} ({UNASSESSED})"
        axes.plot([], [], color=ink, lw=1.8, label=name, gid=FIRST_IN_LEGEND_GID)
    for state, style in VERDICT_STYLES.items():
        if not np.any(states == state):
            continue
        for error, look in ((False, {}), (True, faint)):
            at = (states == state) & (inexact == error)
            # the stretch between two points is in the state of the first
            shown = np.where(at | np.append(False, at[:-1]), y, np.nan)
            axes.plot(x, shown, style, color=ink, lw=1.4, **look)
        grey = COLOURS["grey"] if label else ink
        if known or not label:
            name = state if known else f"with contact, {UNASSESSED}"
            axes.plot([], [], style, color=grey, lw=1.4, label=name)
    if inexact.any():
        axes.plot([], [], color=ink, lw=1.4, label=INEXACT, **faint)


def _mark_peak(axes: Axes, curve: ResponseCurve, dof: int | None, in_hertz: bool, ink: str) -> None:
    """Mark the largest response unless it is an end of the curve; ``ink`` as of bifurcations."""
    top, (factor, _, unit) = curve.top(dof), parameter_axis(curve.parameter, in_hertz)
    if top.at_end:
        return
    place, height = factor * top.value, top.amplitude
    words = f"largest: {quantity(height, 'm')} at {place:.5g} {unit}".removesuffix(" -")
    if curve.parameter == "omega":
        waves = curve.coefficients_at(dof)
        damping = damping_by_width(curve.values, waves, curve.subharmonic, top.index)
        words += f",\nhalf-power damping {percent(damping)}" if np.isfinite(damping) else ""
    look = {"color": ink or COLOURS["blue"], "mfc": "none", "ms": 7.0, "mew": 1.1}
    axes.plot(place, height, "o", label="" if ink else words, **look)


def _mark_bifurcations(
    axes: Axes, curve: ResponseCurve, dof: int | None, factor: float, ink: str
) -> None:
    """Mark them; ``ink`` is the colour where several curves are drawn, else empty."""
    if not curve.bifurcations:
        return
    x = np.array([factor * one.value for one in curve.bifurcations])
    y = curve.at_bifurcations.amplitude(dof)[1:-1]
    kinds = np.array([one.kind for one in curve.bifurcations])
    shown = _apart(axes, x, y, kinds)
    for kind, marker in MARKERS.items():
        at, name = kinds == kind, kind_in_words(kind)
        if not at.any():
            continue
        look: dict[str, Any] = {"ls": "none", "marker": marker, "ms": 3.8, "mew": 0.8, "zorder": 3}
        axes.plot(x[shown & at], y[shown & at], color=ink or COLOURS["orange"], **look)
        if not ink:
            total, drawn = int(at.sum()), int((shown & at).sum())
            name += f" ({total})" if drawn == total else f" ({total}, {drawn} marked)"
        axes.plot([], [], color=COLOURS["grey"] if ink else COLOURS["orange"], label=name, **look)


def _apart(axes: Axes, x: np.ndarray, y: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """Choose the places of a picture that are marked, one of a kind in each 3 % of its width and
    height, so that marks do not pile up: (n,) bool."""
    axes.autoscale_view()  # to what is drawn so far
    places = (axes.transData - axes.transAxes).transform(np.column_stack([x, y]))
    cells = np.column_stack([np.floor(places / 0.03), np.unique(kinds, return_inverse=True)[1]])
    _, first = np.unique(cells, axis=0, return_index=True)
    return np.isin(np.arange(len(x)), first)


def _mark_superharmonics(
    axes: Axes, curve: ResponseCurve, dof: int | None, amplitude: np.ndarray, factor: float
) -> None:
    """Write at each peak the order of its largest harmonic, if that is above the load's."""
    largest = np.argmax(_harmonic_amplitudes(curve, dof), axis=1) + 1
    order, rest = np.divmod(largest, curve.subharmonic)
    above = (order > 1) & (rest == 0)
    if not above.any():
        return
    from scipy.signal import find_peaks  # takes as long to load as matplotlib

    style = {"ha": "center", "fontsize": 8, "color": COLOURS["grey"]}
    peaks, _ = find_peaks(np.log10(np.maximum(amplitude, 1e-300)), prominence=0.05)
    for peak in peaks[above[peaks]]:
        at = factor * curve.omega[peak], amplitude[peak]
        axes.annotate(f"{order[peak]}ω", at, (0, 5), textcoords="offset points", **style)


def _label_parameter(axes: Axes, curve: ResponseCurve, in_hertz: bool) -> None:
    """Label the axis of a curve's parameter, after all is drawn; above that of a run-up is the
    frequency of its engine order."""
    factor, name, unit = parameter_axis(curve.parameter, in_hertz)
    if curve.parameter == "speed":
        order = float(curve.omega[0] / curve.values[0])
        hertz, load, of_load = frequency_axis(in_hertz)
        slope, words = order * hertz / factor, with_unit(f"{load}, engine order {order:g}", of_load)
        for above in axes.child_axes:  # of a curve drawn before
            above.set_visible(above.get_visible() and above.get_xlabel() == words)
        if not axes.child_axes:
            both = lambda x: slope * x, lambda x: x / slope
            above = axes.secondary_xaxis("top", functions=both)
            above.set_xlabel(words)
    if unit == "m":
        label_axis(axes.xaxis, name, unit)
    else:
        axes.set_xlabel(with_unit(name, unit))


def _harmonic_amplitudes(curve: ResponseCurve, dof: int | None) -> np.ndarray:
    """Amplitudes of the harmonics 1 to H of the response at every point: (n, H) [m]."""
    return np.abs(to_complex(curve.coefficients_at(dof).T)[1:].T)


def draw_content(
    curve: ResponseCurve,
    dof: int | None = None,
    *,
    highest: int = 5,
    in_hertz: bool = False,
    **picture_options: Unpack[PictureOptions],
) -> Figure:
    """Draw the amplitudes of the lowest harmonics of a dof's displacement over the parameter.

    Parameters
    ----------
    curve, dof, in_hertz
        As of :func:`draw_curve`.
    highest : int
        Highest harmonic of the load that is drawn.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Figure of matplotlib, also with given ``axes``.

    Raises
    ------
    InputError
        The highest harmonic is not a whole number >= 1.

    Examples
    --------
    >>> figure = fc.draw_content(curve, tip, highest=3, path="content.png")
    """
    check_count("highest", highest, 1)
    [panel] = picture = Picture(**picture_options)
    panel.set_yscale("log")
    harmonics = _harmonic_amplitudes(curve, dof)[:, curve.subharmonic - 1 :: curve.subharmonic]
    shown = harmonics[:, :highest].T
    x = parameter_axis(curve.parameter, in_hertz)[0] * curve.values
    colours = distinct_colours(len(shown))
    for order, (values, colour) in enumerate(zip(shown, colours, strict=True), 1):
        panel.plot(x, values, color=colour, lw=1.2, label=f"harmonic {order}")
    panel.set_ylim(1e-5 * shown.max(), 2.0 * shown.max())
    _label_parameter(panel, curve, in_hertz)
    label_axis(panel.yaxis, "amplitude of the harmonic", "m")
    return picture.finish()


def draw_multipliers(
    curve: ResponseCurve, *, in_hertz: bool = False, **picture_options: Unpack[PictureOptions]
) -> Figure:
    """Draw the modulus of the largest Floquet multiplier along a curve.

    An orbit is stable where it is below 1. Colours show where the multiplier is: a real one leaves
    the unit circle at +1 (folds, branch points) or -1 (period doublings), a pair anywhere else
    (Neimark-Sacker). Irregular points have the growth of a small disturbance. Undecided points are
    crosses, at 1 where their multipliers are unknown.

    Parameters
    ----------
    curve : ResponseCurve
        Followed with ``stability=True``.
    in_hertz
        As of :func:`draw_curve`.
    **picture_options
        ``axes``, ``path`` and ``title``; see :func:`draw_waves`.

    Returns
    -------
    Figure
        Figure of matplotlib, also with given ``axes``.

    Raises
    ------
    InputError
        The curve was followed without ``stability=True``.

    Examples
    --------
    >>> figure = fc.draw_multipliers(curve, path="multipliers.png")
    """
    if curve.multipliers is None:
        raise InputError("stability", False, "True when the curve is followed")
    [panel] = picture = Picture(**picture_options)
    x, found = parameter_axis(curve.parameter, in_hertz)[0] * curve.values, curve.multipliers
    sizes, verdicts = np.abs(found), curve.verdicts
    open_ = verdicts == "undecided"
    pair = np.abs(found.imag) > 1e-9 * sizes
    kinds = {"irregular": verdicts == "irregular", "pair": pair, "+1": found.real > 0.0}
    multiplier_kinds = np.select([*kinds.values()], [*kinds], "-1")
    panel.axhline(1.0, color=COLOURS["grey"], lw=0.9, label="limit of stability")
    panel.plot(x, sizes, color=COLOURS["grey"], lw=0.4, alpha=0.6)
    for kind, label, colour in (
        ("+1", "real, positive", "blue"),
        ("-1", "real, negative", "orange"),
        ("pair", "a complex pair", "green"),
        ("irregular", "growth of an irregular motion", "pink"),
    ):
        at = (multiplier_kinds == kind) & ~open_
        if at.any():
            panel.plot(x[at], sizes[at], ".", ms=4.0, color=COLOURS[colour], label=label)
    if open_.any():
        known = np.isfinite(sizes[open_])
        label = "undecided" if known.all() else "undecided; at 1 where unknown"
        shown = np.where(known, sizes[open_], 1.0)
        panel.plot(x[open_], shown, "x", ms=4.0, color=COLOURS["pink"], label=label)
    if far := int(np.sum(sizes > 2.0)):  # else all others would be a line
        panel.set_ylim(top=2.0)
        panel.plot([], [], " ", label=f"{far} of {len(sizes)} lie above")
    _label_parameter(panel, curve, in_hertz)
    panel.set_ylabel("modulus of the largest multiplier [-]")
    return picture.finish()
