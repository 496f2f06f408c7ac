"""Pictures: waves, responses, laws and contact maps (matplotlib), mode shapes (pyvista)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from scipy.signal import find_peaks

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import PARAMETERS, ResponseCurve
from fenics_crack.draw.figure import COLOURS, finish, new_figure, off_screen_plotter, readable, save
from fenics_crack.draw.nodal import edge_lines, moved_grid
from fenics_crack.draw.plot_motion import draw_orbits, draw_spectrum
from fenics_crack.errors import InputError
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.files.store import make_folder
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import on_root
from fenics_crack.stability.floquet import PiecewiseFlow

__all__ = [
    "COLOURS",
    "Wave",
    "draw_contact_map",
    "draw_content",
    "draw_curve",
    "draw_laws",
    "draw_map",
    "draw_modes",
    "draw_multipliers",
    "draw_orbits",
    "draw_response",
    "draw_spectrum",
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
    path: str | Path,
    waves: Sequence[Wave],
    *,
    title: str,
    quantity: str,
    period: float | None = None,
    zero: str | None = None,
) -> None:
    """Draw displacements over time.

    Parameters
    ----------
    path : str or Path
        The picture file.
    waves : sequence of Wave
        The curves.
    title, quantity : str
        Heading, and the name of the vertical axis without its unit.
    period : float, optional
        Show time in periods of this length [s]; default: in seconds.
    zero : str, optional
        Name a line at zero, for example "lips touch".
    """
    figure, axes = new_figure()
    largest = max(float(np.abs(wave.values).max()) for wave in waves)
    scale, unit = readable(largest, "m")
    for wave in waves:
        time = wave.time / period if period else wave.time
        colour = COLOURS[wave.colour]
        axes.plot(time, scale * wave.values, wave.style, color=colour, label=wave.label, lw=1.6)
        if wave.spread is not None:
            low, high = wave.values - wave.spread, wave.values + wave.spread
            axes.fill_between(time, scale * low, scale * high, color=colour, alpha=0.2, lw=0)
    if zero is not None:
        axes.axhline(0.0, color=COLOURS["grey"], lw=0.8)
        axes.annotate(
            zero, (0.01, 0.0), (0, 3), xycoords=("axes fraction", "data"),
            textcoords="offset points", color=COLOURS["grey"], fontsize=8,
        )  # fmt: skip
    axes.set_xlabel("time / load period" if period else "time [s]")
    axes.set_ylabel(f"{quantity} [{unit}]")
    finish(figure, axes, title, path)


def draw_laws(path: str | Path, laws: Mapping[str, ContactLaw], closing: np.ndarray) -> None:
    """Draw contact forces [N] over the closing of a pair [m], one curve a law."""
    figure, axes = new_figure()
    styles = zip(laws.items(), COLOURS.values(), ("-", "--", ":", "-.", "-"), strict=False)
    for (label, law), colour, style in styles:
        force = law.force(closing[:, None])[:, 0]
        axes.plot(1e6 * closing, 1e-3 * force, style, color=colour, label=label, lw=1.8)
    axes.set_xlabel("closing g [µm]  (g > 0: penetration)")
    axes.set_ylabel("contact force [kN]")
    finish(figure, axes, "Contact laws", path)


def draw_contact_map(path: str | Path, solution: PeriodicSolution, *, instants: int = 400) -> None:
    """Draw where along the crack and when in the period the lips touch, and how hard.

    Colours are the pressure on the lips where the contact stiffness is one per area, else the force
    of a pair.

    Raises
    ------
    InputError
        The structure has no positions of its pairs, or fewer than two pairs.
    """
    points = solution.structure.pair_points
    if points is None or len(points) < 2:
        raise InputError(
            "pairs", None if points is None else len(points), "two or more, with a mesh"
        )
    structure = solution.structure
    time = np.linspace(0.0, solution.period, instants + 1)
    values, label, unit = solution.contact_force(time), "contact force of a pair", "N"
    if structure.pair_areas is not None and np.ndim(getattr(solution.contact, "stiffness", 0.0)):
        values, label, unit = values / structure.pair_areas, "contact pressure", "Pa"
    scale, unit = readable(float(values.max()), unit)
    depth = 1e3 * np.linalg.norm(points - points[0], axis=1)
    figure, axes = new_figure()
    shown = np.ma.masked_less_equal(scale * values.T, 0.0)
    axes.set_facecolor("#e8e8e8")
    loads = time * solution.omega / (2.0 * np.pi)
    image = axes.pcolormesh(loads, depth, shown, cmap="viridis", shading="nearest")
    axes.set_ylim(bottom=0.0)
    figure.colorbar(image, ax=axes, label=f"{label} [{unit}]")
    axes.set_xlabel("time / load period")
    axes.set_ylabel("distance from the crack's mouth [mm]")
    axes.set_title("Where and when the crack is closed (grey: open)")
    save(figure, path)


def draw_response(
    path: str | Path,
    values: np.ndarray,
    curves: Mapping[str, np.ndarray],
    *,
    title: str,
    quantity: str,
    over: str = "load frequency [rad/s]",
    doubtful: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Draw amplitudes [m] over the load's frequency [rad/s] or something else; gaps where nan.

    The amplitudes are drawn logarithmically; those of curves that are doubtful (bool) have a ring.
    """
    figure, axes = new_figure()
    finite = [found[np.isfinite(found)] for found in curves.values()]
    scale, unit = readable(max((float(f.max()) for f in finite if len(f)), default=1.0), "m")
    styles = itertools.product((".-", ".--", ".:"), COLOURS.values())
    for (label, found), (style, colour) in zip(curves.items(), styles, strict=False):
        axes.semilogy(values, scale * found, style, color=colour, label=label, lw=1.4, ms=4)
    ringed = [
        (values[mask], scale * curves[label][mask]) for label, mask in (doubtful or {}).items()
    ]
    if any(len(x) for x, _ in ringed):
        x, y = np.concatenate(ringed, axis=1)
        axes.semilogy(x, y, "o", color=COLOURS["grey"], mfc="none", ms=8, label=DOUBTFUL)
    axes.set_xlabel(over)
    axes.set_ylabel(f"{quantity} [{unit}]")
    finish(figure, axes, title, path)


def draw_map(
    path: str | Path,
    x: np.ndarray,
    y: np.ndarray,
    values: np.ndarray,
    *,
    title: str,
    x_label: str,
    y_label: str,
    value_label: str,
    missing: str = "no value",
) -> None:
    """Draw values over two swept quantities, such as load frequency and crack length, as colours.

    The colours are logarithmic where the values are positive and span two decades or more.

    Parameters
    ----------
    path : str or Path
        The picture file.
    x, y : (n,), (m,)
        The swept quantities, rising; two or more of each.
    values : (m, n)
        What was found; nan where nothing was, drawn grey.
    title, x_label, y_label, value_label : str
        Heading; names of the axes and of the colours, with their units.
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
    figure, axes = new_figure()
    axes.set_facecolor(MISSING)
    image = axes.pcolormesh(
        x, y, shown, cmap="viridis", norm=scale(low, high), shading="nearest", rasterized=True
    )
    explained = f"\n(grey: {missing})" if shown.count() < values.size else ""
    figure.colorbar(image, ax=axes, label=value_label + explained)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.set_title(title)
    save(figure, path)


DOUBTFUL = f"not stable, or estimated error above {100 * LARGE_ERROR:g} %"
FARTHEST = 2.0
"""Modulus of the largest multiplier shown."""
MISSING = "#b5b5b5"
"""Grey of cells without a value."""

MARKERS = {
    "fold": ("v", "fold"),
    "branch_point": ("s", "branch point"),
    "period_doubling": ("D", "period doubling"),
    "neimark_sacker": ("^", "Neimark-Sacker"),
}


def draw_curve(
    path: str | Path,
    curve: ResponseCurve,
    dof: int,
    *,
    title: str,
    behind: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    points: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> None:
    """Draw a response curve: half the peak-to-peak displacement of a dof over the
    curve's parameter.

    Stable parts are solid and unstable ones dashed where the curve knows; bifurcations are marked,
    and peaks whose largest harmonic is not the load's carry that harmonic's order.

    Parameters
    ----------
    path : str or Path
        The picture file.
    curve : ResponseCurve
        What to draw.
    dof : int
        Whose displacement.
    title : str
        Heading.
    behind, points : mapping, optional
        Other curves, and single points, by their labels: values of the parameter, amplitudes [m].
    """
    figure, axes = new_figure()
    if curve.parameter == "omega":
        axes.set_yscale("log")
    amplitude = curve.amplitude(dof)
    marker_size = 4.0 if len(curve.bifurcations) <= 20 else 2.0
    scale, unit = readable(float(amplitude.max()), "m")
    for (label, (values, others)), colour in zip(
        (behind or {}).items(), ("#9a9a9a", "#c8a2b8", "#a9c7bb"), strict=False
    ):
        axes.plot(values, scale * others, color=colour, lw=1.2, label=label)
    for style, label, shown in _by_stability(curve, scale * amplitude):
        axes.plot(curve.values, shown, style, color=COLOURS["blue"], lw=1.4, label=label)
    for kind, (marker, label) in MARKERS.items():
        at = [b for b in curve.bifurcations if b.kind == kind]
        if at:
            heights = [
                0.5 * scale * np.ptp(b.solution.displacement(_instants(b.solution.period), [dof]))
                for b in at
            ]
            axes.plot(
                [b.value for b in at],
                heights,
                marker,
                color=COLOURS["orange"],
                ms=marker_size,
                label=label,
            )
    for (label, (values, others)), marker in zip((points or {}).items(), "^v", strict=False):
        axes.plot(
            values, scale * others, marker, color=COLOURS["green"], ms=4.5, mfc="none", label=label
        )
    if curve.parameter == "omega":
        for at_omega, height, order in _superharmonic_peaks(curve, dof, scale * amplitude):
            axes.annotate(
                f"{order}$\\omega$", (at_omega, height), (0, 5), textcoords="offset points",
                ha="center", fontsize=8, color=COLOURS["grey"],
            )  # fmt: skip
    axes.set_xlabel(PARAMETERS[curve.parameter])
    axes.set_ylabel(f"half peak-to-peak displacement [{unit}]")
    axes.margins(y=0.1)
    finish(figure, axes, title, path)


def _by_stability(curve: ResponseCurve, values: np.ndarray) -> list[tuple[str, str, np.ndarray]]:
    """Line styles, labels, and the values shown so: nan elsewhere."""
    if curve.multipliers is None:
        return [("-", "with contact", values)]
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
    path: str | Path, curve: ResponseCurve, dof: int, *, title: str, highest: int = 5
) -> None:
    """Draw the amplitudes of the lowest harmonics of a dof's displacement over the parameter.

    Parameters
    ----------
    path, curve, dof, title
        As in :func:`draw_curve`.
    highest : int
        How many harmonics of the load.
    """
    figure, axes = new_figure()
    harmonics = _harmonic_amplitudes(curve, dof)[:, curve.subharmonic - 1 :: curve.subharmonic]
    count = min(highest, harmonics.shape[1])
    top = float(harmonics[:, :count].max())
    scale, unit = readable(top, "m")
    for order, colour in zip(range(1, count + 1), COLOURS.values(), strict=False):
        axes.semilogy(
            curve.values, scale * harmonics[:, order - 1], color=colour, lw=1.2,
            label=f"harmonic {order}",
        )  # fmt: skip
    axes.set_ylim(1e-5 * scale * top, 2.0 * scale * top)
    axes.set_xlabel(PARAMETERS[curve.parameter])
    axes.set_ylabel(f"amplitude of the harmonic [{unit}]")
    finish(figure, axes, title, path)


def draw_multipliers(
    path: str | Path, curve: ResponseCurve, *, title: str, points: int = 200
) -> None:
    """Draw all Floquet multipliers along a curve in the complex plane, with the unit circle.

    They are computed for at most so many points, spread evenly along a curve in frequency.
    """
    if curve.parameter != "omega":
        raise InputError("curve", f"in {curve.parameter!r}", "in 'omega'")
    flow = PiecewiseFlow(curve.structure, curve.contact)
    chosen = np.unique(np.linspace(0, len(curve) - 1, points).astype(int))
    multipliers = np.array(
        [flow.multipliers(curve.gap(i), curve.omega[i] / curve.subharmonic) for i in chosen]
    )
    figure, axes = new_figure(size=(6.0, 4.8))
    shown = axes.scatter(
        multipliers.real.ravel(), multipliers.imag.ravel(), s=4.0, cmap="viridis",
        c=np.repeat(curve.omega[chosen], multipliers.shape[1]), linewidths=0.0,
    )  # fmt: skip
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(np.cos(angle), np.sin(angle), color=COLOURS["orange"], lw=1.2, label="unit circle")
    axes.set_aspect("equal")
    far = int(np.sum(np.abs(multipliers) > FARTHEST))
    if far:  # else the unit circle would be a dot
        axes.set_xlim(-FARTHEST, FARTHEST)
        axes.set_ylim(-FARTHEST, FARTHEST)
        title += f" ({far} of {multipliers.size} lie outside)"
    axes.set_xlabel("real part of the multiplier [-]")
    axes.set_ylabel("imaginary part [-]")
    figure.colorbar(shown, ax=axes, label="load frequency [rad/s]")
    finish(figure, axes, title, path)


def _instants(period: float) -> np.ndarray:
    return np.linspace(0.0, period, 257)


def draw_modes(
    structure: Structure, modes: Modes, path: str | Path, *, columns: int = 3, rows: int = 2
) -> None:
    """Draw the first mode shapes with pyvista, off screen (collective)."""
    mesh = NodalMesh(structure)
    shapes = mesh.field(structure.expand(modes.shapes.T[: columns * rows]))

    def draw() -> None:
        plotter = off_screen_plotter(shape=(rows, columns), window_size=(1200, 840))
        for number, shape in enumerate(shapes):
            plotter.subplot(number // columns, number % columns)
            amplitude = np.linalg.norm(shape, axis=1)
            moved = 0.12 * mesh.size / amplitude.max() * shape
            grid = moved_grid(mesh, moved)
            grid["amplitude"] = amplitude
            plotter.add_mesh(
                grid, scalars="amplitude", cmap="viridis", lighting=False, show_scalar_bar=False
            )
            for edges, displacement, colour, width in (
                (mesh.edges, moved, "#777777", 0.5),
                (mesh.boundary, 0.0, COLOURS["grey"], 1),
                (mesh.boundary, moved, "black", 2),
            ):
                lines = edge_lines(mesh, edges, displacement, height=1e-3 * width * mesh.size)
                plotter.add_mesh(lines, color=colour, line_width=width, lighting=False)
            plotter.add_text(
                f"mode {number + 1}: {modes.omega[number] / (2.0 * np.pi):.1f} Hz",
                font_size=11,
                color="black",
            )
            plotter.view_xy()
            plotter.camera.zoom(1.1)
        plotter.background_color = "white"
        make_folder(path)
        plotter.screenshot(str(path))
        plotter.close()

    on_root(structure.comm, draw)
