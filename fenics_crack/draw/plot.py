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
from fenics_crack.draw.figure import COLOURS, figure_of, finish, label_axis, make_axes
from fenics_crack.errors import InputError
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modes import Modes
from fenics_crack.stability.floquet import PiecewiseFlow
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
    """One curve: values [m] over time [s], and for averaged waves their spread.

    Attributes
    ----------
    label, colour, style : str
        Legend, name in :data:`COLOURS`, matplotlib's line style.
    time, values : (n,)
        [s], [m].
    spread : (n,) [m] or None
        Half-width of the band drawn around the curve.
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
        Name of the vertical axis without its unit.
    axes : Axes, optional
        Where to draw; default: a new figure.
    path : str or Path, optional
        Where to save the new figure.
    title : str, optional
        Heading.
    period : float, optional
        Show time in periods of this length [s]; default: in seconds.
    zero : str, optional
        Name a line at zero, for example "lips touch".
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
    """Draw contact forces [N] over the closing of a pair [m], one curve a law.

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

    Colours are the pressure on the lips where the contact stiffness is one per area, else the force
    of a pair; grey: open. ``axes``, ``path`` and ``title`` as of :func:`draw_waves`.

    Raises
    ------
    InputError
        The structure has no positions of its pairs, or fewer than two pairs.
    """
    structure, law = solution.structure, solution.contact
    points = structure.pair_points
    if points is None or len(points) < 2:
        raise InputError(
            "pairs", None if points is None else len(points), "two or more, with a mesh"
        )
    time = np.linspace(0.0, solution.period, instants + 1)
    values, label, unit = solution.contact_force(time), "contact force of a pair", "N"
    if structure.pair_areas is not None and law is not None and np.ndim(law.stiffness):
        values, label, unit = values / structure.pair_areas, "contact pressure", "Pa"
    scale, unit = readable(float(values.max()), unit)
    depth = np.linalg.norm(points - points[0], axis=1)
    loads = time * solution.omega / (2.0 * np.pi)
    [panel] = make_axes(axes, path)
    panel.set_facecolor(OPEN)
    shown = np.ma.masked_less_equal(scale * values.T, 0.0)
    image = panel.pcolormesh(loads, depth, shown, cmap="viridis", shading="nearest")
    panel.set_ylim(bottom=0.0)
    panel.figure.colorbar(image, ax=panel, label=f"{label} [{unit}] (grey: open)")
    panel.set_xlabel("time / load period")
    label_axis(panel.yaxis, "distance from the crack's mouth", "m")
    if title is not None:
        panel.set_title(title)
    return figure_of(panel, path)


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
    """Draw amplitudes [m] over the load's frequency [rad/s] or something else; gaps where nan.

    The amplitudes are drawn logarithmically; those of curves that are doubtful (bool) have a ring.
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

    The colours are logarithmic where the values are positive and span two decades or more.

    Parameters
    ----------
    x, y : (n,), (m,)
        The swept quantities, rising; two or more of each.
    values : (m, n)
        What was found; nan where nothing was, drawn grey.
    x_label, y_label, value_label : str
        Names of the axes and of the colours, with their units.
    axes, path, title
        As of :func:`draw_waves`.
    missing : str
        What a grey cell means.

    Raises
    ------
    InputError
        The shapes do not fit, a quantity does not rise, or there is no finite value.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    values = np.asarray(values, dtype=float)
    for name, swept in (("x", x), ("y", y)):
        if swept.ndim != 1 or len(swept) < 2 or not np.all(np.diff(swept) > 0.0):
            raise InputError(name, swept, "two or more rising numbers")
    if values.shape != (len(y), len(x)):
        raise InputError("values", values.shape, f"of shape (len(y), len(x)) = {len(y), len(x)}")
    shown = np.ma.masked_invalid(values)
    if not shown.count():
        raise InputError("values", "nan", "finite somewhere")
    low, high = float(shown.min()), float(shown.max())
    scale = LogNorm if 0.0 < 100.0 * low <= high else Normalize
    [panel] = make_axes(axes, path)
    panel.set_facecolor(MISSING)
    image = panel.pcolormesh(
        x, y, shown, cmap="viridis", norm=scale(low, high), shading="nearest", rasterized=True
    )
    explained = f"\n(grey: {missing})" if shown.count() < values.size else ""
    panel.figure.colorbar(image, ax=panel, label=value_label + explained)
    panel.set_xlabel(x_label)
    panel.set_ylabel(y_label)
    if title is not None:
        panel.set_title(title)
    return figure_of(panel, path)


DOUBTFUL = f"not stable, or estimated error above {100 * LARGE_ERROR:g} %"
FARTHEST = 2.0
"""Modulus of the largest multiplier shown."""
MISSING, OPEN = "#b5b5b5", "#e8e8e8"
"""Greys of cells without a value, and of an open crack."""

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
    """Draw a response curve: half the peak-to-peak displacement of a dof over the
    curve's parameter.

    Stable parts are solid and unstable ones dashed where the curve knows; bifurcations are marked,
    and peaks whose largest harmonic is not the load's carry that harmonic's order.

    Parameters
    ----------
    curve : ResponseCurve
        What to draw.
    dof : int
        Whose displacement.
    axes, path, title
        As of :func:`draw_waves`.
    colour, label : str
        Name in :data:`COLOURS`, and what the legend calls the curve, to tell several on the same
        axes apart.
    behind, points : mapping, optional
        Other curves, and single points, by their labels: values of the parameter, amplitudes [m].
    """
    [panel] = make_axes(axes, path)
    if curve.parameter == "omega":
        panel.set_yscale("log")
    amplitude = curve.amplitude(dof)
    for (name, (values, others)), grey in zip(
        (behind or {}).items(), ("#9a9a9a", "#c8a2b8", "#a9c7bb"), strict=False
    ):
        panel.plot(values, others, color=grey, lw=1.2, label=name)
    for style, state, shown in _by_stability(curve, amplitude):
        name = ", ".join(filter(None, (label, state))) or "with contact"
        panel.plot(curve.values, shown, style, color=COLOURS[colour], lw=1.4, label=name)
    _mark_bifurcations(panel, curve, dof)
    for (name, (values, others)), marker in zip((points or {}).items(), "^v", strict=False):
        panel.plot(values, others, marker, color=COLOURS["green"], ms=4.5, mfc="none", label=name)
    if curve.parameter == "omega":
        for at_omega, height, order in _superharmonic_peaks(curve, dof, amplitude):
            panel.annotate(
                f"{order}$\\omega$", (at_omega, height), (0, 5), textcoords="offset points",
                ha="center", fontsize=8, color=COLOURS["grey"],
            )  # fmt: skip
    _label_parameter(panel, curve)
    panel.margins(y=0.1)
    label_axis(panel.yaxis, "half peak-to-peak displacement", "m")
    return finish(panel, path, title)


def _mark_bifurcations(axes: Axes, curve: ResponseCurve, dof: int) -> None:
    size = 4.0 if len(curve.bifurcations) <= 20 else 2.0
    for kind, (marker, label) in MARKERS.items():
        at = [b for b in curve.bifurcations if b.kind == kind]
        heights = []
        for solution in (b.solution for b in at):
            time = np.linspace(0.0, solution.period, 257)
            heights.append(0.5 * np.ptp(solution.displacement(time, [dof])))
        if at:
            axes.plot(
                [b.value for b in at], heights, marker, color=COLOURS["orange"], ms=size,
                label=label,
            )  # fmt: skip


def _label_parameter(axes: Axes, curve: ResponseCurve) -> None:
    name, _, unit = PARAMETERS[curve.parameter].removesuffix("]").rpartition(" [")
    if unit == "m":
        label_axis(axes.xaxis, name, unit)
    else:
        axes.set_xlabel(PARAMETERS[curve.parameter])


def _by_stability(curve: ResponseCurve, values: np.ndarray) -> list[tuple[str, str, np.ndarray]]:
    """Line styles, labels, and the values shown so: nan elsewhere."""
    if curve.multipliers is None:
        return [("-", "", values)]
    parts = []
    for stable, style, label in ((True, "-", "stable"), (False, "--", "unstable")):
        # A stretch between two points belongs to the state of its first one.
        shown = np.where(curve.stable == stable, values, np.nan)
        shown[1:] = np.where(curve.stable[:-1] == stable, values[1:], shown[1:])
        if not np.all(np.isnan(shown)):
            parts.append((style, label, shown))
    return parts


def _harmonic_amplitudes(curve: ResponseCurve, dof: int) -> np.ndarray:
    """Amplitudes of the harmonics 1 to H of the response at every point: (n, H) [m]."""
    rows = curve.coefficients_at(dof)
    return np.asarray(np.hypot(rows[:, 1::2], rows[:, 2::2]))


def _superharmonic_peaks(
    curve: ResponseCurve, dof: int, amplitude: np.ndarray
) -> list[tuple[float, float, int]]:
    """Frequency and height of peaks, and the order > 1 of the harmonic that makes them."""
    peaks, _ = find_peaks(np.log10(np.maximum(amplitude, 1e-300)), prominence=0.05)
    harmonics = _harmonic_amplitudes(curve, dof)[peaks]
    found = []
    for peak, sizes in zip(peaks, harmonics, strict=True):
        order = int(np.argmax(sizes)) + 1
        if order > curve.subharmonic and order % curve.subharmonic == 0:
            found.append((curve.omega[peak], amplitude[peak], order // curve.subharmonic))
    return found


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
        How many harmonics of the load.
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

    They are computed for at most so many points, spread evenly along a curve in frequency.
    ``axes``, ``path`` and ``title`` as of :func:`draw_waves`.

    Raises
    ------
    InputError
        The curve is one in another parameter.
    """
    if curve.parameter != "omega":
        raise InputError("curve", f"in {curve.parameter!r}", "in 'omega'")
    [panel] = make_axes(axes, path, size=(6.0, 4.8))
    flow = PiecewiseFlow(curve.structure, curve.contact)
    chosen = np.unique(np.linspace(0, len(curve) - 1, points).astype(int))
    multipliers = np.array(
        [flow.multipliers(curve.gap(i), curve.omega[i] / curve.subharmonic) for i in chosen]
    )
    shown = panel.scatter(
        multipliers.real.ravel(), multipliers.imag.ravel(), s=4.0, cmap="viridis",
        c=np.repeat(curve.omega[chosen], multipliers.shape[1]), linewidths=0.0,
    )  # fmt: skip
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    label = "unit circle"
    far = int(np.sum(np.abs(multipliers) > FARTHEST))
    if far:  # else the unit circle would be a dot
        panel.set_xlim(-FARTHEST, FARTHEST)
        panel.set_ylim(-FARTHEST, FARTHEST)
        label += f" ({far} of {multipliers.size} multipliers lie outside the picture)"
    panel.plot(np.cos(angle), np.sin(angle), color=COLOURS["orange"], lw=1.2, label=label)
    panel.set_aspect("equal")
    panel.set_xlabel("real part of the multiplier [-]")
    panel.set_ylabel("imaginary part [-]")
    panel.figure.colorbar(shown, ax=panel, label="load frequency [rad/s]")
    return finish(panel, path, title)


TRIANGLES = {
    3: [(0, 1, 2)],
    4: [(0, 1, 2), (0, 2, 3)],
    6: [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    9: [(0, 4, 8), (4, 1, 8), (1, 5, 8), (5, 2, 8), (2, 6, 8), (6, 3, 8), (3, 7, 8), (7, 0, 8)],
}
"""Into which cells with so many nodes are cut to be coloured; VTK's order of nodes."""


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
        Which, from 1; default: all.
    axes : Axes or sequence of them, optional
        One for each mode; default: a new figure.
    path, title
        As of :func:`draw_waves`.
    columns : int
        Of the new figure.

    Raises
    ------
    InputError
        The structure has no mesh, there is no such mode, or the axes do not fit.
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
    return figure_of(panels[0], path, mesh.structure.comm)


def _mode_shape(axes: Axes, mesh: NodalMesh, shape: np.ndarray) -> None:
    """Draw a displacement (n_nodes, 2), magnified, its size in colours."""
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
