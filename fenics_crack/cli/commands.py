"""The commands that solve a scene, and ``plot``: each computes, writes its files and reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli import tables
from fenics_crack.cli.console import Console
from fenics_crack.cli.exit_codes import Exit
from fenics_crack.cli.remarks import highest_omega, remark_on, remark_on_sweep
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError
from fenics_crack.files.results import save
from fenics_crack.files.store import kind_of
from fenics_crack.model.modes import Modes, damped_range
from fenics_crack.parallel import on_root
from fenics_crack.scene.scene import Integration, Scene
from fenics_crack.study.run import Run, find_modes, follow_curve, integrate, load_run, solve
from fenics_crack.sweep.file import KIND as SWEEP
from fenics_crack.sweep.result import SweepResult, run_sweep
from fenics_crack.table import Table
from fenics_crack.time.march import TimeHistory

__all__ = ["curve", "integration", "modes", "plot", "solution", "sweep"]

IN_SHORT = ("state", "response", "opening", "multiplier", "verdict", "truncation_error")
"""Columns of a sweep printed as text, beside the swept values."""
UNDECIDED = "; more harmonics may decide it"
UNDAMPED = ", or damping of all modes (damping.modes = 'all')"
SHOWN_FAILURES = 10
"""Failures of a sweep that are printed; its table has all."""


def modes(scene: Scene, count: int, folder: Path, console: Console) -> Exit:
    """Natural frequencies and mode shapes with the crack open."""
    with console.stage("modes"):
        run = find_modes(scene, count, console.comm)
    _finish(run, folder, "modes", console, run.result.table())
    return Exit.DONE


def solution(scene: Scene, folder: Path, console: Console) -> Exit:
    """Steady vibration at one frequency."""
    with console.stage("solution"):
        run = solve(scene, console.comm)
    found = run.result
    table, waves = tables.solution_quantities(run), tables.solution_waves(run)
    _finish(run, folder, "solution", console, table, waves)
    console.note(remark_on(run.structure, highest_omega(scene, "solve")))
    if not found.converged:
        console.warn(f"not converged: {found.status}")
        return Exit.NOT_CONVERGED
    _judge_error(found.report.total, "", console)
    if found.stability is not None and found.stability.verdict != "stable":
        damped = scene.damping.of_all_modes or damped_range(run.structure) is None
        hint = UNDECIDED + ("" if damped else UNDAMPED)
        console.warn(
            f"the orbit is {found.stability.verdict}: a motion in time may leave it"
            + (hint if found.stability.verdict == "undecided" else "")
        )
    return Exit.DONE


def curve(scene: Scene, folder: Path, console: Console) -> Exit:
    """Response curve, through its folds."""
    with console.stage("curve"):
        run = follow_curve(scene, console.comm, progress=console.progress)
    found = run.result
    table, points = tables.special_points(run), tables.curve_points(run)
    _finish(run, folder, "curve", console, table, points)
    console.note(remark_on(run.structure, highest_omega(scene, "curve")))
    _judge_errors(run, console)
    special = [point.value for point in found.bifurcations]
    for index in tables.stability_changes(found) if found.undecided is None else ():
        low, high = sorted(found.values[index : index + 2])
        if not any(low <= value <= high for value in special):
            console.warn(
                f"stability changes between {low:g} and {high:g} without a bifurcation of the "
                "balanced equations: they need more harmonics (harmonic_balance.harmonics) there"
            )
    if not found.complete:
        console.warn(f"the curve ended early: {found.status}")
        return Exit.NOT_CONVERGED
    return Exit.DONE


def _judge_errors(run: Run[ResponseCurve], console: Console) -> None:
    """Report the estimated errors of a few points of a curve, the largest among them."""
    found = run.result
    peak = int(np.argmax(found.amplitude(run.watched_dof)))
    looked_at = {peak, *np.linspace(0, len(found) - 1, 8).astype(int).tolist()}
    errors = {index: found.solution(index).report.total for index in sorted(looked_at)}
    worst = max(errors, key=errors.__getitem__)
    console.note(f"estimated error at {len(errors)} of the points: at most {errors[worst]:.2g}")
    _judge_error(errors[worst], f" at {found.values[worst]:g}", console)


def _judge_error(error: float, where: str, console: Console) -> None:
    """Warn of a large estimated error."""
    if not error <= LARGE_ERROR:
        console.warn(
            f"the estimated error is {error:.2g} of the gap{where}: more harmonics "
            "(harmonic_balance.harmonics) or modes (reduction.modes) are needed"
        )


def integration(scene: Scene, folder: Path, console: Console) -> Exit:
    """Motion in time, from rest until it repeats."""
    with console.stage("integration"):
        run = integrate(scene, console.comm, progress=console.progress)
    found = run.result
    table, waves = tables.history_quantities(run), tables.history_waves(run)
    _finish(run, folder, "integration", console, table, waves)
    asked = scene.integration or Integration()
    if not found.settled <= asked.settle:
        console.warn(
            f"the motion has not settled after {found.periods} of {asked.periods} periods: "
            f"a period changes it by {found.settled:.2g}{_longer_period(found)}"
        )
        return Exit.NOT_CONVERGED
    return Exit.DONE


def _longer_period(found: TimeHistory) -> str:
    """A hint why a motion has not settled: it may repeat after two or three load periods."""
    waves = found.by_period(found.gap)
    for count in range(2, len(waves)):
        change = np.linalg.norm(waves[-1] - waves[-1 - count]) / np.linalg.norm(waves[-1])
        if change < 0.1 * found.settled:
            return f", {count} periods only by {change:.2g}: its period is {count} times the load's"
    return "; it may need more of them (integration.periods), or be irregular"


def _finish(
    run: Run, folder: Path, name: str, console: Console, table: Table, rows: Table | None = None
) -> None:
    """Write and print a result; save it together if its structure is spread over the ranks."""
    path = folder / f"{name}.h5"
    if run.structure.comm.size > 1 and isinstance(run.result, PeriodicSolution | Modes):
        save(run.result, path, run.scene)
    else:
        on_root(console.comm, lambda: save(run.result, path, run.scene))
    console.finish(folder, name, table, rows or table, table)


def sweep(scene: Scene, folder: Path, console: Console) -> Exit:
    """All cases of a sweep, or those that an earlier run has left."""
    with console.stage("sweep"):
        found = run_sweep(scene, folder / "sweep.h5", console.comm, progress=console.progress)
    table = found.table()
    keys = [axis.key for axis in found.axes]
    shown = found.table(*keys, *IN_SHORT) if console.form == "text" else table
    console.finish(folder, "sweep", shown, table, table)
    counts = {"converged": int(found.converged.sum()), "failed": len(found.failed)}
    counts["pending"] = found.converged.size - sum(counts.values())
    console.note(remark_on_sweep(scene, console.comm))
    console.note("cases: " + ", ".join(f"{count} {name}" for name, count in counts.items()))
    for index, reason in found.failed[:SHOWN_FAILURES]:
        values = [axis.values[at] for axis, at in zip(found.axes, index, strict=True)]
        console.warn(f"{', '.join(map(str, values))}: {reason}")
    if len(found.failed) > SHOWN_FAILURES:
        console.warn(f"and {len(found.failed) - SHOWN_FAILURES} more cases have failed")
    if large := int(np.sum(found.inexact)):
        console.warn(f"{large} cases estimate an error above {LARGE_ERROR:.0%}: more harmonics")
    if not_stable := int(np.sum(found.not_stable)):
        console.warn(f"{not_stable} cases are unstable or undecided")
    if not found.complete:
        console.warn("the sweep was stopped; the same command goes on with it")
    return Exit.NOT_CONVERGED if found.failed or not found.complete else Exit.DONE


def plot(result: Path, folder: Path, console: Console, *, show: bool) -> Exit:
    """Pictures of a result, and files for ParaView: by rank 0."""

    def draw() -> list[Path]:
        from fenics_crack.cli.pictures import draw_run, draw_sweep  # VTK and matplotlib

        if kind_of(result) != SWEEP:
            return draw_run(load_run(result, MPI.COMM_SELF), folder, show=show)
        if show:
            raise InputError("--show", "sweep", "used with a periodic solution")
        return draw_sweep(SweepResult.load(result), folder)

    with console.stage("pictures"):
        files = on_root(console.comm, draw)
    for file in files:
        console.note(str(file))
    return Exit.DONE
