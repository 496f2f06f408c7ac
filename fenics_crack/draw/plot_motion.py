"""Pictures of motions: spectra, the orbit of one in the phase plane, what opens a crack's tips."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.draw.figure import (
    COLOURS,
    Picture,
    Where,
    distinct_colours,
    given_axes,
    label_axis,
)
from fenics_crack.errors import InputError
from fenics_crack.numerics.equations import DIFFERENCE
from fenics_crack.numerics.fourier import to_complex

if TYPE_CHECKING:  # which loads DOLFINx
    from fenics_crack.study.over_time import StressIntensity

__all__ = ["draw_orbits", "draw_spectra", "draw_spectrum", "draw_stress_intensity"]

DECADES = 9
"""Range of a spectrum below its largest amplitude; what is smaller is rounding."""
MANY_STEMS = 150
"""Harmonics beyond which a spectrum is points."""
SHOWN_CLOSED = 0.01
"""Part of the largest K_I below which a tip is shown as closed."""


def draw_spectrum(
    solution: PeriodicSolution, dof: int | None = None, **where: Unpack[Where]
) -> Figure:
    """Draw the amplitudes of the harmonics, logarithmically, over their orders (collective).

    The upper panel shows the gap of the pair that moves most and the displacement of a dof, the
    lower one the contact force, summed over the pairs. Order 1 is the load's, 0 the mean; the
    orders of a subharmonic response are fractions. There are enough harmonics where the amplitudes
    have fallen far.

    Parameters
    ----------
    solution : PeriodicSolution
        What to draw.
    dof : int, optional
        Whose displacement.
    **where
        ``axes`` (one, or two with the force), ``path``, ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        There is neither a pair nor a dof, or the number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_spectrum(solution, tip, path="spectrum.png")
    """
    lengths: Series = {}
    loads = solution.subharmonic
    if solution.structure.n_pairs:
        time = np.linspace(0.0, solution.period, 257)
        pair = int(np.argmax(np.ptp(solution.gap(time), axis=0)))
        gap = solution.gap_coefficients[:, pair]
        lengths[f"gap {solution.structure.where(pair)}"] = _amplitudes(gap), loads
    if dof is not None:
        name = solution.structure.dof_name(dof)
        lengths[name] = _amplitudes(solution.coefficients_at([dof])[:, 0]), loads
    if not lengths:
        raise InputError("dof", None, "given where there is no contact pair")
    force = _amplitudes(solution.force_coefficients.sum(axis=1))
    forces: Series = {"contact force, all pairs": (force, loads)}
    parts = [(lengths, "displacement", "m"), (forces, "contact force", "N")]
    return _spectra(parts, solution.structure.comm, where)


def draw_spectra(
    solutions: Mapping[str, tuple[PeriodicSolution, int]], **where: Unpack[Where]
) -> Figure:
    """Draw the amplitudes of the harmonics of several vibrations, side by side.

    The upper panel shows the displacement of a dof of each, the lower one, if all have pairs, the
    gap at the mouth (of the first crack; in the middle of a crack inside).

    Parameters
    ----------
    solutions : mapping
        By their labels: a solution and whose displacement.
    **where
        ``axes``, one or two, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        The number of axes is wrong.

    Examples
    --------
    >>> figure = fc.draw_spectra({"breathing": (solution, tip)}, path="spectra.png")
    """
    motions, gaps, places = {}, {}, set()
    for label, (solution, dof) in solutions.items():
        motions[label] = _amplitudes(solution.coefficients_at([dof])[:, 0]), solution.subharmonic
        if solution.structure.n_pairs:
            pair = solution.structure.first_watched
            gaps[label] = _amplitudes(solution.gap_coefficients[:, pair]), solution.subharmonic
            places.add(solution.structure.where(pair))
    gap = f"gap {places.pop()}" if len(places) == 1 else "gap"
    all_gaps = gaps if len(gaps) == len(motions) else {}
    comm = next(iter(solutions.values()))[0].structure.comm
    return _spectra([(motions, "displacement", "m"), (all_gaps, gap, "m")], comm, where)


Series = dict[str, tuple[np.ndarray, int]]
"""Amplitudes and the loads in a period, by their labels."""


def _spectra(parts: Sequence[tuple[Series, str, str]], comm: MPI.Comm, where: Where) -> Figure:
    """Draw series, each part with its quantity and unit in a panel: as many as there are axes, or
    the first and those that are not zero."""
    axes = given_axes(where.get("axes"), where.get("ax"))
    first, *others = (part for part in parts if part[0])
    if axes is None:
        others = [part for part in others if any(np.any(found) for found, _ in part[0].values())]
    shown = [first, *others][: None if axes is None else np.size(axes)]
    size = (7.0, 2.4 + 2.2 * len(shown))
    picture = Picture(len(shown), size=size, sharex=True, comm=comm, **where)
    for panel, part in zip(picture, shown, strict=True):
        _stems(panel, *part)
    picture.panels[-1].set_xlabel("order of the harmonic, in load frequencies (0: mean)")
    return picture.finished()


def _amplitudes(column: np.ndarray) -> np.ndarray:
    """|a0|, |X_1|, ... of coefficients a0, a1, b1, ...: (H+1,)."""
    return np.abs(to_complex(column))


def _stems(axes: Axes, series: Series, quantity: str, unit: str) -> None:
    """Draw amplitudes, each with the loads in its period, as stems, or as points where
    they are many, several series side by side."""
    seen = np.concatenate([values for values, _ in series.values()])
    top = float(seen.max()) or 1.0
    lowest = np.min(seen, where=seen > 10.0**-DECADES * top, initial=0.1 * top)
    bottom = 10.0 ** np.floor(np.log10(0.5 * lowest))
    highest = max((len(values) - 1) / loads for values, loads in series.values())
    most = max(len(values) for values, _ in series.values()) - 1
    size = 4.5 if most < 25 else 3.0 if most <= MANY_STEMS else 1.5
    step = 0.5 / max(2, len(series))
    styles = zip(series.items(), distinct_colours(len(series)), 3 * "osD^", strict=False)
    for number, ((label, (values, loads)), colour, marker) in enumerate(styles):
        shift = step * (number - 0.5 * (len(series) - 1)) / loads
        kept = np.flatnonzero(values >= bottom)
        order, shown = kept / loads + shift, values[kept]
        if most <= MANY_STEMS:
            axes.vlines(order, bottom, shown, color=colour, lw=1.2)
        axes.plot(order, shown, marker, color=colour, ms=size, label=label)
    axes.set_xlim(-0.5, highest + 0.5)
    axes.set_yscale("log")
    axes.set_ylim(bottom, top * (top / bottom) ** 0.08)
    axes.xaxis.get_major_locator().set_params(integer=True)
    label_axis(axes.yaxis, f"amplitude of the\n{quantity}", unit)


def draw_orbits(
    solution: PeriodicSolution,
    dof: int | None = None,
    *,
    instants: int = 2000,
    **where: Unpack[Where],
) -> Figure:
    """Draw the motion in the phase plane, velocity over displacement (collective).

    One panel shows the gap at the mouth (of the first crack; in the middle of a crack inside), one
    the displacement of a dof. The orbit is thick where the lips touch there, or in the panel of the
    dof anywhere. A dot marks the beginning of
    each load period; the motion runs clockwise.

    Parameters
    ----------
    solution, dof
        As of :func:`draw_spectrum`.
    instants : int
        Points of the orbit.
    **where
        ``axes``, one or two, ``path`` and ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        As of :func:`draw_spectrum`.

    Examples
    --------
    >>> figure = fc.draw_orbits(solution, tip, path="orbits.png")
    """
    time = np.linspace(0.0, solution.period, instants + 1)
    closed = solution.contact_force(time) > 0.0
    orbits: list[tuple[Motion, int, np.ndarray, str, str]] = []
    if solution.structure.n_pairs:
        pair = solution.structure.first_watched
        place = solution.structure.where(pair)
        closing = f"closing {place}"
        orbits.append((solution.gap, pair, closed[:, pair], closing, "lips touch there"))
    if dof is not None:
        moved, name = partial(solution.displacement, dofs=[dof]), solution.structure.dof_name(dof)
        orbits.append((moved, 0, np.any(closed, axis=1), name, "lips touch somewhere"))
    if not orbits:
        raise InputError("dof", None, "given where there is no contact pair")
    count = len(orbits)
    size, comm = (1.0 + 4.2 * count, 4.4), solution.structure.comm
    picture = Picture(count, columns=count, size=size, comm=comm, **where)
    for panel, content in zip(picture, orbits, strict=True):
        _orbit(panel, solution, *content)
    return picture.finished()


Motion = Callable[[np.ndarray], np.ndarray]
"""Displacements at times [s], a column each, with the kinks of lips, which harmonics round off."""


def _orbit(
    axes: Axes,
    solution: PeriodicSolution,
    motion: Motion,
    column: int,
    closed: np.ndarray,
    quantity: str,
    touching: str,
) -> None:
    """Draw the orbit of one displacement, thick where lips are closed."""
    step = DIFFERENCE * solution.period

    def orbit_at(time: np.ndarray) -> np.ndarray:
        before, now, after = (motion(time + by)[:, column] for by in (-step, 0.0, step))
        return np.array([now, (after - before) / (2.0 * step)])

    orbit = orbit_at(np.linspace(0.0, solution.period, len(closed)))
    axes.plot(*orbit, color=COLOURS["blue"], lw=1.4, label="orbit")
    if closed.any():
        touch = np.where(closed, orbit, np.nan)
        axes.plot(*touch, color=COLOURS["orange"], lw=3.2, label=touching)
    starts = 2.0 * np.pi / solution.omega * np.arange(solution.subharmonic)
    beginnings = orbit_at(starts)
    axes.plot(*beginnings, "o", color="black", ms=5.5, label="a load period begins")
    label_axis(axes.xaxis, quantity, "m")
    label_axis(axes.yaxis, "its velocity", "m/s")
    axes.margins(0.08)


def draw_stress_intensity(found: StressIntensity, **where: Unpack[Where]) -> Figure:
    """Draw K_I at each tip over time, grey and thick where the tip is closed, and K_II dashed.

    Parameters
    ----------
    found : StressIntensity
        Of :func:`stress_intensity`.
    **where
        ``axes``, ``path``, ``title``, as of :func:`draw_waves`.

    Returns
    -------
    Figure
        Of matplotlib, also where ``axes`` are given.

    Raises
    ------
    InputError
        There are several axes.

    Examples
    --------
    >>> figure = fc.draw_stress_intensity(fc.stress_intensity(fc.solve(scene)), path="tips.png")
    """
    [panel] = picture = Picture(**where)
    time, shut = found.time - found.time[0], "the tip is closed"
    styles = zip(found.tips, distinct_colours(len(found.tips)), strict=True)
    for number, (tip, colour) in enumerate(styles):
        one, two = found.one[:, number], found.two[:, number]
        panel.plot(time, one, color=colour, lw=1.8, label=f"K_I, {tip}")
        panel.plot(time, two, color=colour, lw=1.0, ls="--", label=f"K_II, {tip}")
        closed = np.where(one <= SHOWN_CLOSED * max(one.max(), 0.0), one, np.nan)
        if not np.all(np.isnan(closed)):
            panel.plot(time, closed, color=COLOURS["grey"], lw=4.0, label=shut)
            shut = "_" + shut.lstrip("_")  # once in the legend
    panel.axhline(0.0, color="black", lw=0.6)
    label_axis(panel.xaxis, "time", "s")
    label_axis(panel.yaxis, "stress intensity", "Pa m^0.5")
    return picture.finished()
