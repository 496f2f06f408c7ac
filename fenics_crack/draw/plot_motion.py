"""Pictures of one vibration: the harmonics it is made of, and its orbit in the phase plane."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fenics_crack.balance.fourier import evaluate
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.draw.figure import COLOURS, figure_of, label_axis, make_axes
from fenics_crack.errors import InputError

__all__ = ["draw_orbits", "draw_spectrum"]

DECADES = 9
"""Of a spectrum: what is smaller than the largest by more is left out as rounding."""


def draw_spectrum(
    solution: PeriodicSolution,
    dof: int | None = None,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the amplitudes of the harmonics, logarithmically, over their orders (collective).

    Above, of the gap of the pair that moves most and of the displacement of a dof; below, of the
    contact force, the sum of all pairs. Order 1 is the load's, 0 the mean;
    the orders of a subharmonic response are fractions. How fast the amplitudes fall says whether
    there are enough harmonics.

    Parameters
    ----------
    solution : PeriodicSolution
        What to draw.
    dof : int, optional
        Whose displacement.
    axes : Axes or sequence of them, optional
        One for the displacements, or two; default: a new figure, with both where there is contact.
    path : str or Path, optional
        Where to save the new figure.
    title : str, optional
        Heading.

    Raises
    ------
    InputError
        There is neither a pair nor a dof, or the axes do not fit.
    """
    lengths: dict[str, np.ndarray] = {}
    if solution.structure.n_pairs:
        time = np.linspace(0.0, solution.period, 257)
        pair = int(np.argmax(np.ptp(solution.gap(time), axis=0)))
        name = "gap at the mouth" if pair == 0 else f"gap of pair {pair + 1} from the mouth"
        lengths[name] = _amplitudes(solution.gap_coefficients[:, pair])
    if dof is not None:
        lengths[solution.structure.dof_name(dof)] = _amplitudes(
            solution.coefficients_at([dof])[:, 0]
        )
    if not lengths:
        raise InputError("dof", None, "given where there is no contact pair")
    force = _amplitudes(solution.force_coefficients.sum(axis=1))
    series = [(lengths, "displacement", "m")]
    if np.any(force) if axes is None else np.size(axes) > 1:
        series.append(({"contact force, all pairs": force}, "contact force", "N"))
    size = (7.0, 2.4 + 2.2 * len(series))
    panels = make_axes(axes, path, len(series), size=size, sharex=True)
    for panel, content in zip(panels, series, strict=True):
        _stems(panel, *content, solution.subharmonic)
    panels[-1].set_xlabel("order of the harmonic, in load frequencies (0: mean)")
    if title is not None:
        panels[0].set_title(title)
    if axes is None:
        panels[0].figure.align_ylabels()
    return figure_of(panels[0], path, solution.structure.comm)


def _amplitudes(column: np.ndarray) -> np.ndarray:
    """|a0|, |X_1|, ... of coefficients a0, a1, b1, ...: (H+1,)."""
    return np.concatenate([np.abs(column[:1]), np.hypot(column[1::2], column[2::2])])


def _stems(
    axes: Axes, series: dict[str, np.ndarray], quantity: str, unit: str, subharmonic: int
) -> None:
    """Draw amplitudes as stems; several series side by side."""
    seen = np.concatenate(list(series.values()))
    top = float(seen.max()) or 1.0
    lowest = np.min(seen, where=seen > 10.0**-DECADES * top, initial=0.1 * top)
    bottom = 10.0 ** np.floor(np.log10(0.5 * lowest))
    highest = max(map(len, series.values())) - 1
    size = 4.5 if highest < 25 else 3.0
    styles = zip(series.items(), COLOURS.values(), "os", strict=False)
    for number, ((label, values), colour, marker) in enumerate(styles):
        shift = 0.25 * (number - 0.5 * (len(series) - 1)) / subharmonic
        kept = np.flatnonzero(values >= bottom)
        order, shown = kept / subharmonic + shift, values[kept]
        axes.vlines(order, bottom, shown, color=colour, lw=1.2)
        axes.plot(order, shown, marker, color=colour, ms=size, label=label)
    axes.set_xlim(-0.5, highest / subharmonic + 0.5)
    axes.set_yscale("log")
    axes.set_ylim(bottom, top * (top / bottom) ** 0.25)  # room for the legend
    axes.xaxis.get_major_locator().set_params(integer=True)
    label_axis(axes.yaxis, f"amplitude of the\n{quantity}", unit)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize=8, framealpha=0.9)


def draw_orbits(
    solution: PeriodicSolution,
    dof: int | None = None,
    *,
    axes: Any = None,
    path: str | Path | None = None,
    title: str | None = None,
    instants: int = 2000,
) -> Figure:
    """Draw the motion in the phase plane: velocity over displacement (collective).

    Of the gap at the mouth, and of a dof; where the lips touch the orbit is drawn thick: at the
    mouth, for the dof anywhere. A dot marks the beginning of every period of the load; the motion
    goes round clockwise.

    Parameters
    ----------
    solution, dof, axes, path, title
        As of :func:`draw_spectrum`; the panels are side by side.
    instants : int
        Points of the orbit.

    Raises
    ------
    InputError
        As of :func:`draw_spectrum`.
    """
    closed = solution.contact_force(np.linspace(0.0, solution.period, instants + 1)) > 0.0
    orbits: list[tuple[np.ndarray, np.ndarray, str, str]] = []
    if solution.structure.n_pairs:
        mouth = solution.gap_coefficients[:, :1]
        orbits.append((mouth, closed[:, 0], "closing of the mouth", "mouth closed"))
    if dof is not None:
        column = solution.coefficients_at([dof])
        name = solution.structure.dof_name(dof)
        orbits.append((column, np.any(closed, axis=1), name, "lips touch somewhere"))
    if not orbits:
        raise InputError("dof", None, "given where there is no contact pair")
    count = len(orbits)
    panels = make_axes(axes, path, count, columns=count, size=(1.0 + 4.2 * count, 4.4))
    for panel, content in zip(panels, orbits, strict=True):
        _orbit(panel, solution, *content)
    if title is not None:
        panels[0].figure.suptitle(title, fontsize="large")
    return figure_of(panels[0], path, solution.structure.comm)


def _orbit(
    axes: Axes,
    solution: PeriodicSolution,
    coefficients: np.ndarray,
    closed: np.ndarray,
    quantity: str,
    touching: str,
) -> None:
    """Draw one orbit of coefficients (2H+1, 1), thick where it is closed."""
    base = solution.base_omega
    order = base * np.arange(1, solution.harmonics + 1)[:, None]
    rates = np.zeros_like(coefficients)
    rates[1::2], rates[2::2] = order * coefficients[2::2], -order * coefficients[1::2]
    time = np.linspace(0.0, solution.period, len(closed))
    place, speed = evaluate(coefficients, base, time)[:, 0], evaluate(rates, base, time)[:, 0]
    axes.plot(place, speed, color=COLOURS["blue"], lw=1.4, label="orbit")
    if closed.any():
        axes.plot(
            np.where(closed, place, np.nan), np.where(closed, speed, np.nan),
            color=COLOURS["orange"], lw=3.2, label=touching,
        )  # fmt: skip
    starts = 2.0 * np.pi / solution.omega * np.arange(solution.subharmonic)
    axes.plot(
        evaluate(coefficients, base, starts)[:, 0], evaluate(rates, base, starts)[:, 0],
        "o", color="black", ms=5.5, label="a load period begins",
    )  # fmt: skip
    label_axis(axes.xaxis, quantity, "m")
    label_axis(axes.yaxis, "its velocity", "m/s")
    axes.margins(0.08)
    axes.grid(alpha=0.3)
    axes.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3, fontsize=7.5, frameon=False,
        columnspacing=1.2, handletextpad=0.5,
    )  # fmt: skip
