"""All pictures of a result, and its files for ParaView."""

from __future__ import annotations

import itertools
from collections.abc import Callable
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
from fenics_crack.scene.fields import Axis
from fenics_crack.study.run import Run
from fenics_crack.sweep.result import SweepResult, axis_name
from fenics_crack.table import readable
from fenics_crack.time.march import TimeHistory

__all__ = ["draw_run", "draw_sweep"]


def draw_run(run: Run, folder: Path, *, show: bool = False) -> list[Path]:
    """Draw all that fits a result, which one rank has loaded; return the files.

    With ``show`` a periodic solution is shown in a window, too; InputError if that is impossible.
    """
    found = run.result
    if show and not isinstance(found, PeriodicSolution):
        raise InputError("--show", type(found).__name__, "used with a periodic solution")
    if show:
        show_period(found, material=run.scene.material)
    draw: dict[type, Callable[..., list[Path]]] = {
        Modes: _modes,
        PeriodicSolution: _solution,
        ResponseCurve: _curve,
        TimeHistory: _history,
    }
    return draw[type(found)](run, found, folder)


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
    files = []

    def file(name: str) -> Path:
        files.append(folder / f"solution_{name}")
        return files[-1]

    dof, material = run.watched_dof, run.scene.material
    time = np.linspace(0.0, found.period, 801)
    motion = found.displacement(time, [dof])
    _waves(run, time, motion, found.gap(time), found.period, path=file("waves.png"), title=title)
    draw_spectrum(found, dof, path=file("spectrum.png"), title=title)
    draw_orbits(found, dof, path=file("orbits.png"), title=title)
    if found.gap_coefficients.shape[1] > 1:
        heading = "Where and when the crack is closed"
        draw_contact_map(found, path=file("contact_map.png"), title=heading)
    write_period(found, file("period.pvd"), material=material)
    animate_period(found, file("breathing_crack.gif"), material=material)
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
    omega, file = run.scene.excitation.omega, folder / "integration_waves.png"
    time, motion = found.time - found.time[0], found.displacement([run.watched_dof])
    title = f"The last periods of {found.periods}, {omega:.6g} rad/s"
    _waves(run, time, motion, found.gap, 2.0 * np.pi / omega, path=file, title=title)
    return [file]


def _waves(
    run: Run, time: np.ndarray, motion: np.ndarray, gap: np.ndarray, period: float, **file: Any
) -> None:
    """Draw the displacement of the load's dof and the gap at the mouth over time."""
    waves, touch = [Wave(run.watched_name, time, motion[:, 0])], None
    if gap.size:
        mouth = "closing of the lips at the mouth"
        waves.append(Wave(mouth, time, gap[:, 0], "orange", "--"))
        touch = "lips touch"
    draw_waves(waves, quantity="displacement", period=period, zero=touch, **file)


# --- sweeps ---------------------------------------------------------------------------------------


def draw_sweep(found: SweepResult, folder: Path) -> list[Path]:
    """Draw the response and the opening over the swept numbers; return the files.

    To the right goes the frequency, else the longest axis. The next in length gets a line for each
    value, or makes a map if it has many. Each combination of the other axes has its own pictures,
    up to a limit. Raises InputError if no axis has two or more numbers, or no case has converged.
    """
    axes = found.axes
    numbers = [
        place
        for place, axis in enumerate(axes)
        if len(axis.values) > 1 and all(isinstance(value, float | int) for value in axis.values)
    ]
    if not numbers:
        raise InputError("sweep.over", [a.key for a in axes], "over numbers, to be drawn")
    if not np.any(found.converged):
        raise InputError("path", str(found.path), "a sweep with a case that converged")
    numbers.sort(key=lambda place: (axes[place].key != OMEGA, -len(axes[place].values)))
    shown = numbers[:2]
    others = [place for place in range(len(axes)) if place not in shown]

    def pages(values: np.ndarray) -> np.ndarray:
        """Values by picture, then to the right, then up if there are two axes: (n, x, y)."""
        sizes = [*(len(axes[place].values) for place in shown), 1][:2]
        return values.transpose(*others, *shown).reshape(-1, *sizes)

    doubtful = pages(found.converged & (found.not_stable | found.inexact))
    files = []
    fixed = itertools.product(*(axes[place].values for place in others))
    for number, at in enumerate(itertools.islice(fixed, MAX_PICTURES)):
        words = [f"{axes[place].key} = {value}" for place, value in zip(others, at, strict=True)]
        title = ", ".join(words) or f"Sweep of {axes[shown[0]].key}"
        for name, quantity in QUANTITIES.items():
            values = pages(np.where(found.converged, found[name], np.nan))[number]
            if np.any(np.isfinite(values)):
                files.append(folder / f"sweep_{name}{f'_{number + 1}' if others else ''}.png")
                how = {"path": files[-1], "title": title}
                _page([axes[place] for place in shown], values, doubtful[number], quantity, **how)
    return files


OMEGA = "excitation.omega"
QUANTITIES = {
    "response": "half peak-to-peak at the load's point",
    "opening": "largest opening of the crack",
}
FEW_LINES, MAX_PICTURES = 6, 12


def _page(
    axes: list[Axis], values: np.ndarray, doubtful: np.ndarray, quantity: str, **file: Any
) -> None:
    """Draw values (x, y) over one axis or two."""
    over, name = [*map(axis_name, axes), ""][:2]
    x, y = [*(np.array(axis.values, dtype=float) for axis in axes), np.zeros(0)][:2]
    order, rising = np.argsort(x), np.argsort(y)
    if len(y) > FEW_LINES:
        scale, unit = readable(float(np.nanmax(values)), "m")
        shown = scale * values[np.ix_(order, rising)].T
        labels = {"x_label": over, "y_label": name, "value_label": f"{quantity} [{unit}]"}
        draw_map(x[order], y[rising], shown, missing="not converged", **labels, **file)
        return
    names = [f"{name} = {at:g}" for at in y] or [quantity]
    lines, rings = (dict(zip(names, v[order].T, strict=True)) for v in (values, doubtful))
    draw_response(x[order], lines, quantity=quantity, over=over, doubtful=rings, **file)
