"""The command ``timing``: arrival times of a blade's tip, and the vibration found in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.fit_order import TipTrack
from fenics_crack.arrivals.harmonics import TipFit
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli import judgements
from fenics_crack.cli.console import Console
from fenics_crack.cli.exit_codes import Exit
from fenics_crack.cli.tables import in_one_unit
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Scene
from fenics_crack.study.timing import arrivals_of, vibration_in
from fenics_crack.table import Table, counted, speed_axis

__all__ = ["timing"]


def timing(
    scene: Scene, source: ArrivalTimes | Path | None, folder: Path, console: Console
) -> Exit:
    """Compute arrival times unless they are measured, and fit a vibration to them."""
    with console.stage("arrival times"):
        arrivals, run = arrivals_of(scene, source, console.comm)
    on_root(console.comm, lambda: _write_arrivals(arrivals, scene, folder))
    size = f"{counted(len(arrivals), 'revolution')}, {counted(len(arrivals.probes), 'probe')}"
    pace, _, unit = speed_axis(scene.in_rpm)
    ends = f"{pace * arrivals.speed[0]:.6g}"
    if not arrivals.steady:
        ends += f" to {pace * arrivals.speed[-1]:.6g}"
    console.note(f"arrivals of {size}, {ends} {unit}: {folder / 'arrivals.csv'}, .png")
    with console.stage("vibration"):
        fit = vibration_in(scene, arrivals)
    table = fit.table()
    on_root(console.comm, lambda: _write_fit(fit, arrivals, scene, folder))
    shown = table
    if console.form == "text":
        shown = in_one_unit(_largest(fit) if isinstance(fit, TipTrack) else table, scene)
    console.table(shown)
    console.note(f"{folder / 'timing.csv'}, .json, .png")
    if run is not None and isinstance(run.result, PeriodicSolution):
        found = run.result
        console.warnings(judgements.of_error(run.scene, found.report, found.harmonics))
        console.warnings(judgements.of_stability(run.scene, run, found.stability))
    if isinstance(fit, TipFit):
        _judge(fit, console)
    return Exit.DONE


def _write_arrivals(arrivals: ArrivalTimes, scene: Scene, folder: Path) -> None:
    from fenics_crack.draw.plot_arrivals import draw_arrivals  # matplotlib

    arrivals.to_csv(folder / "arrivals.csv")
    draw_arrivals(arrivals, path=folder / "arrivals.png", in_rpm=scene.in_rpm)


def _write_fit(fit: TipFit | TipTrack, arrivals: ArrivalTimes, scene: Scene, folder: Path) -> None:
    from fenics_crack.draw.plot_arrivals import draw_tip_fit, draw_tip_track  # matplotlib

    for name in ("timing.csv", "timing.json"):
        fit.table().save(folder / name)
    if isinstance(fit, TipFit):
        draw_tip_fit(fit, arrivals, path=folder / "timing.png")
    else:
        draw_tip_track(fit, path=folder / "timing.png", in_hertz=scene.in_hertz)


def _largest(track: TipTrack) -> Table:
    """Where along a run-up each harmonic is largest."""
    table = track.table()
    kept = [n for n, name in enumerate(table.columns) if not name.startswith("amplitude")]
    rows = []
    for place, multiple in enumerate(track.multiples):
        sizes = track.amplitudes[:, place]
        if np.all(np.isnan(sizes)):
            continue
        at = int(np.nanargmax(sizes))
        about = (float(sizes[at]), float(track.amplitude_errors[at, place]))
        rows.append([float(multiple), *(table.rows[at][n] for n in kept), *about])
    columns = ["multiple, where it is largest", *(table.columns[n] for n in kept)]
    return Table([*columns, "amplitude [m]", "amplitude_error [m]"], rows)


def _judge(fit: TipFit, console: Console) -> None:
    """The ratio that tells of a crack, and warnings of what the probes cannot tell."""
    if np.any(np.isclose(fit.multiples, 2.0)):
        ratio, error = fit.ratio()
        console.note(f"second harmonic over first: {ratio:.4g} ± {error:.2g}")
    if fit.does_not_fit:
        console.warn(
            "the fit leaves more between the probes than their scatter: harmonics are missing "
            "(tip_timing.fitted_harmonics), the order is not among tip_timing.orders, or the "
            "vibration follows no order (tip_timing.frequencies)"
        )
    if fit.ambiguous:
        others = ", ".join(f"{order:.6g}" for order in fit.ambiguous[:6])
        more = ", ..." if len(fit.ambiguous) > 6 else ""
        console.warn(f"orders that explain the arrivals as well: {others}{more}")
    if fit.hidden:
        hidden = ", ".join(f"{order:.6g}" for order in fit.hidden[:6])
        more = ", ..." if len(fit.hidden) > 6 else ""
        console.warn(f"orders that these probes cannot measure: {hidden}{more}")
