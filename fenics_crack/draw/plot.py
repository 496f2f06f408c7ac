"""Pictures: waves, responses, maps, contact laws, response curves and mode shapes."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from scipy.signal import find_peaks

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import PARAMETERS, ResponseCurve
from fenics_crack.curves.refine import filled
from fenics_crack.draw.figure import COLOURS, figure_of, finish, label_axis, make_axes
from fenics_crack.errors import InputError
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modes import Modes
from fenics_crack.stability.piecewise_flow import PiecewiseFlow
from fenics_crack.table import readable

__all__ = [
    "Wave",
    "draw_contact_map",
    "draw_content",
    "draw_curve",
    "draw_laws",
    "draw_map",
    "draw_modes",
    "draw_multipliers",
    "draw_response",
    "draw_waves",
]


@dataclass(frozen=True)
class Wave:
    """A displacement over time.

    Attributes
    ----------
    label, colour, style : str
        Legend entry, name in :data:`COLOURS`, line style of matplotlib.
    time, values : (n,)
        [s], [m].
    spread : (n,) [m] or None
        Half-width of a band around the curve, for example the standard deviation of a mean wave.
    """

    label: str
    time: np.ndarray
    values: np.ndarray
    colour: str = "blue"
    style: str = "-"
    spread: np.ndarray | None = None


def draw_waves(
    waves: Sequence[Wave],
    *,
    quantity: str,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    period: float | None = None,
    zero: str | None = None,
) -> Figure:
    """Draw displacements over time.

    Parameters
    ----------
    waves : sequence of Wave
        The curves.
    quantity : str
        Label of the vertical axis without its unit.
    axes : Axes, optional
        Where to draw; default: a new figure.
    path : str or Path, optional
        Where to save the new figure.
    title : str, optional
        Title of the picture.
    period : float [s], optional
        Unit of the time axis; default: seconds.
    zero : str, optional
        Legend entry of a line at zero, for example "lips touch".
    """
    [panel] = make_axes(axes, path)
    for wave in waves:
        time = wave.time / period if period else wave.time
        colour = COLOURS[wave.colour]
        panel.plot(time, wave.values, wave.style, color=colour, label=wave.label, lw=1.6)
        if wave.spread is not None:
            low, high = wave.values - wave.spread, wave.values + wave.spread
            panel.fill_between(time, low, high, color=colour, alpha=0.2, lw=0)
    if zero is not None:
        panel.axhline(0.0, color=COLOURS["grey"], lw=0.8, label=zero)
    if period:
        panel.set_xlabel("time / load period")
    else:
        label_axis(panel.xaxis, "time", "s")
    label_axis(panel.yaxis, quantity, "m")
    return finish(panel, path, title)


def draw_laws(
    laws: Mapping[str, ContactLaw],
    closing: np.ndarray,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the contact forces [N] of laws, by their labels, over the closing of a pair [m].

    ``axes``, ``path`` and ``title`` as of :func:`draw_waves`.
    """
    [panel] = make_axes(axes, path)
    styles = zip(laws.items(), COLOURS.values(), ("-", "--", ":", "-.", "-"), strict=False)
    for (label, law), colour, style in styles:
        force = law.force(closing[:, None])[:, 0]
        panel.plot(closing, force, style, color=colour, label=label, lw=1.8)
    label_axis(panel.xaxis, "closing g (penetration where g > 0)", "m")
    label_axis(panel.yaxis, "contact force", "N")
    return finish(panel, path, title)


def draw_contact_map(
    solution: PeriodicSolution,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    instants: int = 400,
) -> Figure:
    """Draw where along the crack and when in the period the lips touch, and how hard.

    Colours show the contact pressure if the stiffness is given per area, else the force of each
    pair; grey is open. ``axes``, ``path`` and ``title`` as of :func:`draw_waves`.

    Raises
    ------
    InputError
        The structure has fewer than two pairs, or does not know where they are.
    """
    structure, law = solution.structure, solution.contact
    points = structure.pair_points
    if points is None or len(points) < 2:
        found = None if points is None else len(points)
        raise InputError("pairs", found, "two or more, with a mesh")
    time = np.linspace(0.0, solution.period, instants + 1)
    values, label, unit = solution.contact_force(time), "contact force of a pair", "N"
    if structure.pair_areas is not None and law is not None and np.ndim(law.stiffness):
        values, label, unit = values / structure.pair_areas, "contact pressure", "Pa"
    scale, unit = readable(float(values.max()), unit)
    depth = np.linalg.norm(points - points[0], axis=1)
    loads = time * solution.omega / (2.0 * np.pi)
    [panel] = make_axes(axes, path)
    shown = np.ma.masked_less_equal(scale * values.T, 0.0)
    _colour(panel, loads, depth, shown, f"{label} [{unit}] (grey: open)", OPEN)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("time / load period")
    label_axis(panel.yaxis, "distance from the crack's mouth", "m")
    return figure_of(panel, path, title)


def draw_response(
    values: np.ndarray,
    curves: Mapping[str, np.ndarray],
    *,
    quantity: str,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    over: str = "load frequency [rad/s]",
    doubtful: Mapping[str, np.ndarray] | None = None,
) -> Figure:
    """Draw amplitudes [m] on a logarithmic scale over the load frequency [rad/s] or other values.

    A curve has a gap where it is nan, and rings where ``doubtful`` (by label, bool) is true.
    ``axes``, ``path``, ``title`` and ``quantity`` as of :func:`draw_waves`.
    """
    [panel] = make_axes(axes, path)
    panel.set_yscale("log")
    styles = itertools.product((".-", ".--", ".:"), COLOURS.values())
    for (label, found), (style, colour) in zip(curves.items(), styles, strict=False):
        panel.plot(values, found, style, color=colour, label=label, lw=1.4, ms=4)
    ringed = [(values[mask], curves[label][mask]) for label, mask in (doubtful or {}).items()]
    if any(len(x) for x, _ in ringed):
        x, y = np.concatenate(ringed, axis=1)
        panel.plot(x, y, "o", color=COLOURS["grey"], mfc="none", ms=8, label=DOUBTFUL)
    panel.set_xlabel(over)
    label_axis(panel.yaxis, quantity, "m")
    return finish(panel, path, title)


def draw_map(
    x: np.ndarray,
    y: np.ndarray,
    values: np.ndarray,
    *,
    x_label: str,
    y_label: str,
    value_label: str,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    missing: str = "no value",
) -> Figure:
    """Draw values over two swept quantities, such as load frequency and crack length, as colours.

    The scale is logarithmic if the values are positive and span two decades or more.

    Parameters
    ----------
    x, y : (n,), (m,)
        The swept quantities, rising; two or more of each.
    values : (m, n)
        Grey where nan.
    x_label, y_label, value_label : str
        With units.
    axes, path, title
        As of :func:`draw_waves`.
    missing : str
        What grey means.

    Raises
    ------
    InputError
        The shapes do not fit, a quantity does not rise, or there is no finite value.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    for name, swept in (("x", x), ("y", y)):
        if swept.ndim != 1 or len(swept) < 2 or not np.all(np.diff(swept) > 0.0):
            raise InputError(name, swept, "two or more rising numbers")
    shown = np.ma.masked_invalid(np.asarray(values, dtype=float))
    if shown.shape != (len(y), len(x)):
        raise InputError("values", shown.shape, f"of shape (len(y), len(x)) = {len(y), len(x)}")
    if not shown.count():
        raise InputError("values", "nan", "finite somewhere")
    low, high = float(shown.min()), float(shown.max())
    scale = LogNorm if 0.0 < 100.0 * low <= high else Normalize
    explained = f"\n(grey: {missing})" if shown.count() < shown.size else ""
    [panel] = make_axes(axes, path)
    _colour(panel, x, y, shown, value_label + explained, MISSING, norm=scale(low, high))
    panel.set(xlabel=x_label, ylabel=y_label)
    return figure_of(panel, path, title)


def _colour(
    axes: Axes, x: np.ndarray, y: np.ndarray, values: Any, label: str, grey: str, **options: Any
) -> None:
    """Draw values (len(y), len(x)) as coloured cells; masked ones are grey."""
    axes.set_facecolor(grey)
    image = axes.pcolormesh(x, y, values, cmap="viridis", shading="nearest", **options)
    axes.figure.colorbar(image, ax=axes, label=label)


DOUBTFUL = f"not stable, or estimated error above {100 * LARGE_ERROR:g} %"
FARTHEST = 2.0
"""Largest real or imaginary part of the multipliers shown."""
MISSING, OPEN = "#b5b5b5", "#e8e8e8"
"""Cells without a value; an open crack."""
BEHIND = ("#9a9a9a", "#c8a2b8", "#a9c7bb")
"""Other curves, drawn behind the one in question."""

MARKERS = {
    "fold": ("v", "fold"),
    "branch_point": ("s", "branch point"),
    "period_doubling": ("D", "period doubling"),
    "neimark_sacker": ("^", "Neimark-Sacker"),
}


def draw_curve(
    curve: ResponseCurve,
    dof: int,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    colour: str = "blue",
    label: str = "",
    behind: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    points: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> Figure:
    """Draw half the peak-to-peak displacement of a dof along a response curve.

    Stable parts are solid and unstable ones dashed, if the curve has multipliers. A curve in
    frequency without them is drawn with more solutions between those followed
    (:func:`refine_curve`) where these lie far apart. Bifurcations are marked, and so is the order
    of the largest harmonic at superharmonic peaks.

    Parameters
    ----------
    curve : ResponseCurve
        What to draw.
    dof : int
        Whose displacement.
    axes, path, title
        As of :func:`draw_waves`.
    colour, label : str
        Name in :data:`COLOURS` and legend entry, for several curves on the same axes.
    behind, points : mapping, optional
        Other curves, and single points, by their labels: values of the parameter, amplitudes [m].
    """
    [panel] = make_axes(axes, path)
    curve = filled(curve)
    if curve.parameter == "omega":
        panel.set_yscale("log")
    amplitude = curve.amplitude(dof)
    for (name, (values, others)), grey in zip((behind or {}).items(), BEHIND, strict=False):
        panel.plot(values, others, color=grey, lw=1.2, label=name)
    for style, state, shown in _by_stability(curve, amplitude):
        name = ", ".join(filter(None, (label, state))) or "with contact"
        panel.plot(curve.values, shown, style, color=COLOURS[colour], lw=1.4, label=name)
    _mark_bifurcations(panel, curve, dof)
    for (name, (values, others)), marker in zip((points or {}).items(), "^v", strict=False):
        panel.plot(values, others, marker, color=COLOURS["green"], ms=4.5, mfc="none", label=name)
    if curve.parameter == "omega":
        _mark_superharmonics(panel, curve, dof, amplitude)
    _label_parameter(panel, curve)
    panel.margins(y=0.1)
    label_axis(panel.yaxis, "half peak-to-peak displacement", "m")
    return finish(panel, path, title)


def _mark_bifurcations(axes: Axes, curve: ResponseCurve, dof: int) -> None:
    style = {"color": COLOURS["orange"], "ms": 4.0 if len(curve.bifurcations) <= 20 else 2.0}
    for kind, (marker, label) in MARKERS.items():
        at = [b for b in curve.bifurcations if b.kind == kind]
        heights = [b.solution.amplitude(dof) for b in at]
        if at:
            axes.plot([b.value for b in at], heights, marker, label=label, **style)


def _mark_superharmonics(axes: Axes, curve: ResponseCurve, dof: int, amplitude: np.ndarray) -> None:
    """Write at each peak the order of its largest harmonic, if that is above the load's."""
    style = {"ha": "center", "fontsize": 8, "color": COLOURS["grey"]}
    peaks, _ = find_peaks(np.log10(np.maximum(amplitude, 1e-300)), prominence=0.05)
    for peak, sizes in zip(peaks, _harmonic_amplitudes(curve, dof)[peaks], strict=True):
        order, rest = divmod(int(np.argmax(sizes)) + 1, curve.subharmonic)
        if order > 1 and not rest:
            at = curve.omega[peak], amplitude[peak]
            axes.annotate(f"{order}$\\omega$", at, (0, 5), textcoords="offset points", **style)


def _label_parameter(axes: Axes, curve: ResponseCurve) -> None:
    name, _, unit = PARAMETERS[curve.parameter].removesuffix("]").rpartition(" [")
    if unit == "m":
        label_axis(axes.xaxis, name, unit)
    else:
        axes.set_xlabel(PARAMETERS[curve.parameter])


def _by_stability(curve: ResponseCurve, values: np.ndarray) -> list[tuple[str, str, np.ndarray]]:
    """Line styles, legend entries, and the values drawn so: nan elsewhere."""
    if curve.multipliers is None:
        return [("-", "", values)]
    parts, verdicts = [], curve.verdicts
    for style, label in (("-", "stable"), ("--", "unstable"), (":", "undecided")):
        at = verdicts == label
        if at.any():  # the stretch between two points is in the state of the first
            parts.append((style, label, np.where(at | np.append(False, at[:-1]), values, np.nan)))
    return parts


def _harmonic_amplitudes(curve: ResponseCurve, dof: int) -> np.ndarray:
    """Amplitudes of the harmonics 1 to H of the response at every point: (n, H) [m]."""
    rows = curve.coefficients_at(dof)
    return np.asarray(np.hypot(rows[:, 1::2], rows[:, 2::2]))


def draw_content(
    curve: ResponseCurve,
    dof: int,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    highest: int = 5,
) -> Figure:
    """Draw the amplitudes of the lowest harmonics of a dof's displacement over the parameter.

    Parameters
    ----------
    curve, dof, axes, path, title
        As of :func:`draw_curve`.
    highest : int
        Highest harmonic of the load that is drawn.
    """
    [panel] = make_axes(axes, path)
    panel.set_yscale("log")
    harmonics = _harmonic_amplitudes(curve, dof)[:, curve.subharmonic - 1 :: curve.subharmonic]
    shown = harmonics[:, :highest].T
    for order, (values, colour) in enumerate(zip(shown, COLOURS.values(), strict=False), 1):
        panel.plot(curve.values, values, color=colour, lw=1.2, label=f"harmonic {order}")
    panel.set_ylim(1e-5 * shown.max(), 2.0 * shown.max())
    _label_parameter(panel, curve)
    label_axis(panel.yaxis, "amplitude of the harmonic", "m")
    return finish(panel, path, title)


def draw_multipliers(
    curve: ResponseCurve,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    points: int = 200,
) -> Figure:
    """Draw all Floquet multipliers along a curve in the complex plane, with the unit circle.

    They are computed at ``points`` points at most, spread evenly along a curve in frequency.
    ``axes``, ``path`` and ``title`` as of :func:`draw_waves`.

    Raises
    ------
    InputError
        The curve is one in another parameter.
    """
    if curve.parameter != "omega":
        raise InputError("curve", f"in {curve.parameter!r}", "in 'omega'")
    [panel] = make_axes(axes, path, size=(6.0, 4.8))
    flow = PiecewiseFlow(curve.structure, curve.contact, curve.static_above)
    chosen = np.unique(np.linspace(0, len(curve) - 1, points).astype(int))
    multipliers = np.array(
        [flow.multipliers(curve.unknown(i), curve.omega[i] / curve.subharmonic) for i in chosen]
    )
    x, y = multipliers.real.ravel(), multipliers.imag.ravel()
    omega = np.repeat(curve.omega[chosen], multipliers.shape[1])
    shown = panel.scatter(x, y, s=4.0, c=omega, cmap="viridis", linewidths=0.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    label = "unit circle"
    far = int(np.sum(np.abs(multipliers) > FARTHEST))
    if far:  # else the unit circle would be a dot
        panel.set(xlim=(-FARTHEST, FARTHEST), ylim=(-FARTHEST, FARTHEST))
        label += f" ({far} of {multipliers.size} multipliers lie outside the picture)"
    panel.plot(np.cos(angle), np.sin(angle), color=COLOURS["orange"], lw=1.2, label=label)
    panel.set(xlabel="real part of the multiplier [-]", ylabel="imaginary part [-]")
    panel.set_aspect("equal")
    panel.figure.colorbar(shown, ax=panel, label="load frequency [rad/s]")
    return finish(panel, path, title)


TRIANGLES = {
    3: [(0, 1, 2)],
    4: [(0, 1, 2), (0, 2, 3)],
    6: [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    9: [(0, 4, 8), (4, 1, 8), (1, 5, 8), (5, 2, 8), (2, 6, 8), (6, 3, 8), (3, 7, 8), (7, 0, 8)],
}
"""Into which a cell is cut to be coloured, by its number of nodes, in VTK's order."""


def draw_modes(
    modes: Modes,
    *,
    numbers: Sequence[int] | None = None,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    columns: int = 3,
) -> Figure:
    """Draw mode shapes over the structure at rest, coloured by their displacement (collective).

    Parameters
    ----------
    modes : Modes
        Of a structure with a mesh.
    numbers : sequence of int, optional
        Which modes, from 1; default: all.
    axes : Axes or sequence of them, optional
        One for each mode; default: a new figure.
    path, title
        As of :func:`draw_waves`.
    columns : int
        Panels side by side in a new figure.

    Raises
    ------
    InputError
        The structure has no mesh, there is no such mode, or the number of axes is wrong.
    """
    every = range(1, len(modes.omega) + 1)
    numbers = list(every if numbers is None else numbers)
    if not numbers or any(number not in every for number in numbers):
        raise InputError("numbers", numbers, f"one or more of 1 to {every[-1]}")
    columns = min(columns, len(numbers))
    size = (2.7 * columns, 2.8 * -(-len(numbers) // columns))
    panels = make_axes(axes, path, len(numbers), columns=columns, size=size)
    mesh = NodalMesh(modes.structure)
    shapes = mesh.field(modes.structure.expand(modes.shapes.T))
    for panel, number in zip(panels, numbers, strict=True):
        _mode_shape(panel, mesh, shapes[number - 1])
        panel.set_title(f"mode {number}: {modes.omega[number - 1] / (2.0 * np.pi):.1f} Hz")
    if title is not None:
        panels[0].figure.suptitle(title, fontsize="large")
    return figure_of(panels[0], path, None, mesh.structure.comm)


def _mode_shape(axes: Axes, mesh: NodalMesh, shape: np.ndarray) -> None:
    """Draw a displacement (n_nodes, 2), magnified and coloured by its length."""
    amplitude = np.linalg.norm(shape, axis=1)
    moved = mesh.points + 0.12 * mesh.size / amplitude.max() * shape
    triangles = mesh.cells[:, TRIANGLES[mesh.cells.shape[1]]].reshape(-1, 3)
    axes.tripcolor(*moved.T, triangles, amplitude, shading="gouraud", cmap="viridis")
    for edges, points, colour, width in (
        (mesh.edges, moved, "#777777", 0.3),
        (mesh.boundary, mesh.points, COLOURS["grey"], 0.6),
        (mesh.boundary, moved, "black", 1.2),
    ):
        axes.add_collection(LineCollection(points[edges], colors=colour, linewidths=width))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.axis("off")
