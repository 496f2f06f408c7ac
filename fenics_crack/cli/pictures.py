"""All pictures of a result, and its files for ParaView; the mesh of a scene."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.error_report import UNKNOWN
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw.animation import animate_period, show_period
from fenics_crack.draw.paraview import write_modes, write_period
from fenics_crack.draw.plot import Wave, draw_contact_map, draw_waves
from fenics_crack.draw.plot_curve import draw_content, draw_curve, draw_multipliers
from fenics_crack.draw.plot_mesh import draw_mesh, draw_modes
from fenics_crack.draw.plot_motion import draw_orbits, draw_spectrum
from fenics_crack.errors import InputError
from fenics_crack.files.results import Result
from fenics_crack.model.modes import Modes
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import prepare
from fenics_crack.study.run import Run
from fenics_crack.table import frequency_axis, ranging
from fenics_crack.time.march import TimeHistory

__all__ = ["draw_run", "draw_scene"]


def draw_run(run: Run, folder: Path, *, show: bool = False, paraview: bool = True) -> list[Path]:
    """Draw all that fits a result, which one rank has loaded; return the files.

    With ``show`` a periodic solution is shown in a window, too; with ``paraview`` there are files
    for ParaView beside the pictures.
    """
    found = run.result
    if show:
        show_period(found, material=run.scene.material)
    draw: dict[type[Result], Callable[..., list[Path]]] = {
        Modes: _modes,
        PeriodicSolution: _solution,
        ResponseCurve: _curve,
        TimeHistory: _history,
    }
    if type(found) not in draw:
        allowed = f"a result that is drawn: {', '.join(kind.KIND for kind in draw)}"
        raise InputError("result", found.KIND, allowed)
    files = draw[type(found)](run, found, folder)
    return files + _for_paraview(run, folder) if paraview else files


def _for_paraview(run: Run, folder: Path) -> list[Path]:
    """Files of modes and of a period; none without a mesh."""
    found = run.result
    if found.structure.whole.nodes is None:
        return []
    if isinstance(found, Modes):
        write_modes(found, folder / "modes.vtu")
        return [folder / "modes.vtu"]
    if isinstance(found, PeriodicSolution):
        file = folder / "solution_period.pvd"
        write_period(found, file, material=run.scene.material)
        return [file]
    return []


def draw_scene(scene: Scene, folder: Path) -> list[Path]:
    """Draw the mesh of a scene; return the file."""
    structure, file = prepare(scene, MPI.COMM_SELF, whole=True).structure, folder / "mesh.png"
    title = f"{structure.n_dofs} degrees of freedom"
    draw_mesh(structure, path=file, title=title)
    return [file]


def _modes(run: Run, found: Modes, folder: Path) -> list[Path]:
    if found.structure.whole.nodes is None:
        return []
    file = folder / "modes.png"
    draw_modes(found, path=file)
    return [file]


def _solution(run: Run, found: PeriodicSolution, folder: Path) -> list[Path]:
    title = f"{_frequency(run, found.omega)}, H = {found.harmonics}"
    if found.gap_coefficients.size:
        error = found.report.total
        title += ", error unknown" if error >= UNKNOWN else f", estimated error {100 * error:.2g} %"
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
    meshed = found.structure.whole.nodes is not None
    if found.gap_coefficients.shape[1] > 1 and meshed:
        heading = "Where and when the crack is closed"
        draw_contact_map(found, path=file("contact_map.png"), title=heading)
    if meshed:
        animate_period(found, file("breathing_crack.gif"), material=material)
    return files


def _curve(run: Run, found: ResponseCurve, folder: Path) -> list[Path]:
    dof = run.watched_dof
    title = f"{run.watched_name}, H = {ranging(found.harmonics)}"
    files = [folder / "curve.png", folder / "curve_content.png"]
    in_hertz = run.scene.in_hertz
    draw_curve(found, dof, path=files[0], title=title, in_hertz=in_hertz)
    draw_content(found, dof, path=files[1], title=title, in_hertz=in_hertz)
    if found.multipliers is not None:
        files.append(folder / "curve_multipliers.png")
        title = "Largest Floquet multiplier along the curve"
        draw_multipliers(found, path=files[2], title=title, in_hertz=in_hertz)
    return files


def _history(run: Run, found: TimeHistory, folder: Path) -> list[Path]:
    omega, file = run.scene.excitation.omega, folder / "integration_waves.png"
    time, motion = found.time - found.time[0], found.displacement([run.watched_dof])
    title = f"The last periods of {found.periods}, {_frequency(run, omega)}"
    _waves(run, time, motion, found.gap, 2.0 * np.pi / omega, path=file, title=title)
    return [file]


def _frequency(run: Run, omega: float) -> str:
    """A load frequency in words, in the scene's unit."""
    factor, _, unit = frequency_axis(run.scene.in_hertz)
    return f"{factor * omega:.6g} {unit}"


STYLES = (("orange", "--"), ("green", "-."), ("pink", ":"))
"""Colour and line of the closing of one crack after the other."""


def _waves(
    run: Run, time: np.ndarray, motion: np.ndarray, gap: np.ndarray, period: float, **file: Any
) -> None:
    """Draw the displacement of the load's dof and the gap at the mouth over time."""
    waves, touch = [Wave(run.watched_name, time, motion[:, 0])], None
    if gap.size:
        structure = run.structure.whole
        for pair, style in zip(
            structure.watched_pairs.values(), itertools.cycle(STYLES), strict=False
        ):
            waves.append(Wave(f"closing {structure.where(pair)}", time, gap[:, pair], *style))
        touch = "lips touch"
    draw_waves(waves, quantity="displacement", period=period, zero=touch, **file)
