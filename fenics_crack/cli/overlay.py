"""Results of the same kind in one picture: curves, vibrations, sweeps over one axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli.of_sweep import shown_axes
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw.figure import Picture, distinct_colours
from fenics_crack.draw.plot import Wave, draw_response, draw_waves
from fenics_crack.draw.plot_curve import draw_curve
from fenics_crack.draw.plot_motion import draw_spectra
from fenics_crack.errors import InputError
from fenics_crack.files.store import read
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.words import differences, key_in_words, unit_of
from fenics_crack.study.run import Run, run_of
from fenics_crack.sweep.file import KIND as SWEEP
from fenics_crack.sweep.result import SweepResult
from fenics_crack.table import with_unit

__all__ = ["draw_several"]

MOST = 12
"""Results in one picture."""


def draw_several(paths: Sequence[Path], labels: Sequence[str], folder: Path) -> list[Path]:
    """Draw results of the same kind on the same axes; return the files.

    ``labels`` name the results; without any they are called by what differs between their scenes,
    and by their files where nothing does.

    Raises
    ------
    InputError
        The kinds differ or cannot be laid over each other, or the labels are not as many.
    """
    if labels and len(labels) != len(paths):
        raise InputError("--label", list(labels), f"given {len(paths)} times, once for each result")
    if len(paths) > MOST:
        raise InputError("result", f"{len(paths)} files", f"at most {MOST} in one picture")
    files = [read(path) for path in paths]
    kinds = [file.kind for file in files]
    if len(set(kinds)) > 1:
        raise InputError("result", kinds, "results of one kind, to be drawn in one picture")
    if kinds[0] == SWEEP:
        sweeps = [SweepResult.load(path) for path in paths]
        return _sweeps(_named([one.scene for one in sweeps], sweeps, paths, labels), folder)
    if kinds[0] not in (ResponseCurve.KIND, PeriodicSolution.KIND):
        allowed = "solutions, curves or sweeps, where several are given"
        raise InputError("result", kinds[0], allowed)
    runs = [run_of(file, MPI.COMM_SELF) for file in files]
    scenes = [file.scene() or run.scene for file, run in zip(files, runs, strict=True)]
    named = _named(scenes, runs, paths, labels)
    return (_curves if kinds[0] == ResponseCurve.KIND else _solutions)(named, folder)


def _named(
    scenes: list[Scene], found: list[Any], paths: Sequence[Path], labels: Sequence[str]
) -> dict[str, Any]:
    """Results by their labels, all different."""
    names = list(labels) or differences(scenes)
    if len(set(names)) < len(names):
        files = [str(Path(path).with_suffix("")) for path in paths]
        names = [", ".join(filter(None, both)) for both in zip(names, files, strict=True)]
    if len(set(names)) < len(names):
        raise InputError("result", [str(path) for path in paths], "different files")
    return dict(zip(names, found, strict=True))


def _curves(runs: Mapping[str, Run[ResponseCurve]], folder: Path) -> list[Path]:
    """The responses of curves in the same parameter."""
    parameters = {run.result.parameter for run in runs.values()}
    if len(parameters) > 1:
        raise InputError("result", sorted(parameters), "curves in one parameter")
    file = folder / "overlay_curve.png"
    title = _common(run.watched_name for run in runs.values())
    [panel] = picture = Picture(size=(7.0, 4.6), path=file, title=title)
    colours = distinct_colours(len(runs))
    for (label, run), colour in zip(runs.items(), colours, strict=True):
        dof, in_hertz = run.watched_dof, run.scene.in_hertz
        draw_curve(run.result, dof, axes=panel, label=label, colour=colour, in_hertz=in_hertz)
    picture.saved()
    return [file]


def _solutions(runs: Mapping[str, Run[PeriodicSolution]], folder: Path) -> list[Path]:
    """The displacements, the gaps at the mouth and the spectra of solutions."""
    colours = distinct_colours(len(runs))
    motions, gaps, places = [], [], []
    for (label, run), colour in zip(runs.items(), colours, strict=True):
        found = run.result
        time = np.linspace(0.0, found.period, 801)
        loads = time * found.omega / (2.0 * np.pi)
        motion = found.displacement(time, [run.watched_dof])[:, 0]
        motions.append(Wave(label, loads, motion, colour))
        if found.gap_coefficients.size:
            pair = found.structure.first_watched
            places.append(found.structure.where(pair))
            gaps.append(Wave(label, loads, found.gap(time)[:, pair], colour))
    files = [folder / f"overlay_{name}.png" for name in ("waves", "gaps", "spectrum")]
    name = _common(run.watched_name for run in runs.values())
    draw_waves(motions, quantity="displacement", period=1.0, path=files[0], title=name)
    if gaps:
        title = f"Closing of the lips {_common(places) or ''}".rstrip()
        draw_waves(
            gaps, quantity="closing", zero="lips touch", period=1.0, path=files[1], title=title
        )
    else:
        del files[1]
    both = {label: (run.result, run.watched_dof) for label, run in runs.items()}
    draw_spectra(both, path=files[-1], title=name)
    return files


def _sweeps(sweeps: Mapping[str, SweepResult], folder: Path) -> list[Path]:
    """The quantities of sweeps over the same single axis."""
    keys = set()
    for found in sweeps.values():
        long = [axis for axis in found.axes if len(axis.values) > 1]
        if len(long) != 1:
            allowed = "sweeps over one quantity, to be drawn in one picture"
            raise InputError("result", [axis.key for axis in long], allowed)
        keys.add(found.axes[shown_axes(found)[0]].key)
    if len(keys) > 1:
        raise InputError("result", sorted(keys), "sweeps over the same quantity")
    [key] = keys
    files = []
    first, *others = sweeps.values()
    for name, (quantity, unit) in first.quantities.items():
        if any(name not in other.columns for other in others):
            continue
        files.append(folder / f"overlay_sweep_{name}.png")
        [panel] = picture = Picture(size=(7.0, 4.6), path=files[-1])
        for label, found in sweeps.items():
            place = np.array(found.axes[shown_axes(found)[0]].values, dtype=float)
            order = np.argsort(place)
            values = np.where(found.converged, found[name], np.nan).ravel()[order]
            doubtful = (found.converged & (found.not_stable | found.inexact)).ravel()[order]
            over = with_unit(key_in_words(key), unit_of(key))
            how: dict[str, Any] = {"quantity": quantity, "unit": unit, "over": over}
            how["doubtful"] = {label: doubtful}
            draw_response(place[order], {label: values}, axes=panel, **how)
        picture.saved()
    return files


def _common(names: Any) -> str | None:
    """The name that all have; None if they differ."""
    found = set(names)
    return found.pop() if len(found) == 1 else None
