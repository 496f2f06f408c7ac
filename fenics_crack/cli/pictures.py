"""All pictures of a result, and its files for ParaView."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw.animation import animate_period, show_period
from fenics_crack.draw.paraview import write_modes, write_period
from fenics_crack.draw.plot import (
    Wave,
    draw_contact_map,
    draw_content,
    draw_curve,
    draw_map,
    draw_modes,
    draw_multipliers,
    draw_response,
    draw_waves,
)
from fenics_crack.draw.plot_motion import draw_orbits, draw_spectrum
from fenics_crack.errors import InputError
from fenics_crack.model.modes import Modes
from fenics_crack.study.run import Run
from fenics_crack.sweep.result import SweepResult, axis_name
from fenics_crack.table import readable
from fenics_crack.time.march import TimeHistory

__all__ = ["draw_run", "draw_sweep"]


def draw_run(run: Run, folder: Path, *, show: bool = False) -> list[Path]:
    """Draw everything that fits a result, which one rank has loaded.

    Parameters
    ----------
    run : Run
        What to draw.
    folder : Path
        Where to; names begin with what is drawn.
    show : bool
        Show a periodic solution in a window, too.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        There is nothing to be shown in a window, or no screen.
    """
    found = run.result
    if show and not isinstance(found, PeriodicSolution):
        raise InputError("--show", type(found).__name__, "used with a periodic solution")
    if isinstance(found, Modes):
        return _modes(run, found, folder)
    if isinstance(found, PeriodicSolution):
        if show:
            show_period(found, material=run.scene.material)
        return _solution(run, found, folder)
    if isinstance(found, ResponseCurve):
        return _curve(run, found, folder)
    assert isinstance(found, TimeHistory)
    return _history(run, found, folder)


def _modes(run: Run, found: Modes, folder: Path) -> list[Path]:
    files = [folder / "modes.png", folder / "modes.vtu"]
    draw_modes(found, path=files[0])
    write_modes(found, files[1])
    return files


def _solution(run: Run, found: PeriodicSolution, folder: Path) -> list[Path]:
    title = f"{found.omega:.6g} rad/s, H = {found.harmonics}"
    if found.gap_coefficients.size:
        title += f", estimated error {found.report.total:.1%}"
    if found.stability is not None:
        title += f", {found.stability.verdict}"
    if not found.converged:
        title += ", NOT CONVERGED"
    dof, material = run.watched_dof, run.scene.material
    names = ["waves.png", "spectrum.png", "orbits.png", "period.pvd", "breathing_crack.gif"]
    waves, spectrum, orbits, period, animation = (folder / f"solution_{name}" for name in names)
    draw_spectrum(found, dof, path=spectrum, title=title)
    draw_orbits(found, dof, path=orbits, title=title)
    write_period(found, period, material=material)
    animate_period(found, animation, material=material)
    files = [spectrum, orbits, period, animation]
    time = np.linspace(0.0, found.period, 801)
    lines = [Wave(run.watched_name, time, found.displacement(time, [dof])[:, 0])]
    if found.gap_coefficients.size:
        mouth = found.gap(time)[:, 0]
        lines.append(Wave("closing of the lips at the mouth", time, mouth, "orange", "--"))
    zero = "lips touch" if len(lines) > 1 else None
    draw_waves(
        lines, quantity="displacement", path=waves, title=title, period=found.period, zero=zero
    )
    files.insert(0, waves)
    if found.gap_coefficients.shape[1] > 1:
        files.insert(3, folder / "solution_contact_map.png")
        draw_contact_map(found, path=files[3], title="Where and when the crack is closed")
    return files


def _curve(run: Run, found: ResponseCurve, folder: Path) -> list[Path]:
    dof = run.watched_dof
    title = f"{run.watched_name}, H = {int(found.harmonics.max())}"
    files = [folder / "curve.png", folder / "curve_content.png"]
    draw_curve(found, dof, path=files[0], title=title)
    draw_content(found, dof, path=files[1], title=title)
    if found.multipliers is not None and found.parameter == "omega":
        files.append(folder / "curve_multipliers.png")
        draw_multipliers(found, path=files[2], title="Floquet multipliers along the curve")
    return files


def _history(run: Run, found: TimeHistory, folder: Path) -> list[Path]:
    files = [folder / "integration_waves.png"]
    time = found.time - found.time[0]
    lines = [
        Wave(run.watched_name, time, found.displacement([run.watched_dof])[:, 0]),
        Wave("closing of the lips at the mouth", time, found.gap[:, 0], "orange", "--"),
    ]
    period = 2.0 * np.pi / run.scene.excitation.omega
    title = f"The last periods of {found.periods}, {run.scene.excitation.omega:.6g} rad/s"
    draw_waves(
        lines, quantity="displacement", path=files[0], title=title, period=period, zero="lips touch"
    )
    return files


# --- sweeps ---------------------------------------------------------------------------------------


def draw_sweep(found: SweepResult, folder: Path) -> list[Path]:
    """Draw the response and the opening over the swept numbers.

    The frequency, else the longest axis, goes to the right. With few values on the axis next in
    length there is a line for each of them, with many a map. All others get pictures of their own,
    up to a limit.

    Raises
    ------
    InputError
        No axis has two or more numbers, or no case has converged.
    """
    numbers = [
        place
        for place, axis in enumerate(found.axes)
        if len(axis.values) > 1 and all(isinstance(value, float | int) for value in axis.values)
    ]
    if not numbers:
        raise InputError("sweep.over", [a.key for a in found.axes], "over numbers, to be drawn")
    if not np.any(found.converged):
        raise InputError("path", str(found.path), "a sweep with a case that converged")
    length = {place: len(found.axes[place].values) for place in numbers}
    keys = [found.axes[place].key for place in numbers]
    if OMEGA in keys:
        length[numbers[keys.index(OMEGA)]] = MOST_PICTURES**9
    right, *more = sorted(numbers, key=lambda place: -length[place])
    up = more[0] if more else None
    others = [place for place in range(len(found.axes)) if place not in (right, up)]
    files = []
    all_doubtful = found.converged & (found.not_stable | found.inexact)
    places = itertools.product(*(range(found.shape[place]) for place in others))
    for number, fixed in enumerate(itertools.islice(places, MOST_PICTURES)):
        index: list[Any] = [slice(None)] * len(found.axes)
        for place, at in zip(others, fixed, strict=True):
            index[place] = at
        words = [f"{found.axes[p].key} = {found.axes[p].values[index[p]]}" for p in others]
        ending = f"_{number + 1}" if others else ""
        for name, quantity in QUANTITIES.items():
            values = np.where(found.converged, found[name], np.nan)[tuple(index)]
            if up is not None and up < right:
                values = values.T  # (right, up)
            if not np.any(np.isfinite(values)):
                continue
            files.append(folder / f"sweep_{name}{ending}.png")
            title = ", ".join(words) or f"Sweep of {found.axes[right].key}"
            doubtful = all_doubtful[tuple(index)]
            if up is not None and up < right:
                doubtful = doubtful.T
            _sweep_picture(files[-1], found, right, up, values, doubtful, title, quantity)
    return files


OMEGA = "excitation.omega"
QUANTITIES = {
    "response": "half peak-to-peak at the load's point",
    "opening": "largest opening of the crack",
}
FEW_LINES, MOST_PICTURES = 6, 12


def _sweep_picture(
    file: Path,
    found: SweepResult,
    right: int,
    up: int | None,
    values: np.ndarray,
    doubtful: np.ndarray,
    title: str,
    quantity: str,
) -> None:
    x, over = np.array(found.axes[right].values, dtype=float), axis_name(found.axes[right])
    y = np.array([] if up is None else found.axes[up].values, dtype=float)
    name = "" if up is None else axis_name(found.axes[up])
    order, rising = np.argsort(x), np.argsort(y)
    if len(y) > FEW_LINES:
        scale, unit = readable(float(np.nanmax(values)), "m")
        draw_map(
            x[order], y[rising], scale * values[np.ix_(order, rising)].T, x_label=over,
            y_label=name, value_label=f"{quantity} [{unit}]", path=file, title=title,
            missing="not converged",
        )  # fmt: skip
        return
    names = [f"{name} = {at:g}" for at in y] or [quantity]
    lines, rings = (
        dict(zip(names, rows[order].reshape(len(x), -1).T, strict=True))
        for rows in (values, doubtful)
    )
    draw_response(
        x[order], lines, quantity=quantity, path=file, title=title, over=over, doubtful=rings
    )
