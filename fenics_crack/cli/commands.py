"""The commands that solve a scene, and ``plot``: each computes, writes its files and reports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli import judgements, tables
from fenics_crack.cli.console import Console
from fenics_crack.cli.exit_codes import Exit
from fenics_crack.cli.undamped import remark_on, remark_on_sweep
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError, check_count
from fenics_crack.files.results import save
from fenics_crack.files.store import kind_of
from fenics_crack.model.modes import Modes
from fenics_crack.parallel import on_root
from fenics_crack.scene.quantities import SHORT
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Integration
from fenics_crack.study.key_figures import highest_omega
from fenics_crack.study.run import Run, find_modes, follow_curve, integrate, load_run, solve
from fenics_crack.sweep.file import KIND as SWEEP
from fenics_crack.table import RPM, Table, ranging
from fenics_crack.time.march import TimeHistory

if TYPE_CHECKING:
    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.identification.measurements import Measurements

__all__ = [
    "campbell_diagram",
    "curve",
    "identification",
    "integration",
    "modes",
    "plot",
    "report",
    "solution",
    "sweep",
    "verification",
]

MOST_SPEEDS = 10_000


def modes(scene: Scene, count: int | None, folder: Path, console: Console) -> Exit:
    """Natural frequencies and mode shapes with the crack open."""
    with console.stage("modes"):
        run = find_modes(scene, count, console.comm)
    _finish(run, folder, "modes", console, run.result.table())
    return Exit.DONE


def campbell_diagram(
    scene: Scene, span: list[float] | None, count: int, folder: Path, console: Console
) -> Exit:
    """Natural frequencies over the speed, and where engine orders meet the first breathing one."""
    from fenics_crack.study.campbell import campbell

    check_count("--count", count, 1)
    scene.given("rotation")
    factor = RPM if scene.in_rpm else 1.0
    start, stop, steps = span or (0.0, 1.5 * scene.speed / factor, 13)
    if not (0.0 <= start < stop < np.inf and 2 <= steps <= MOST_SPEEDS and steps % 1 == 0):
        allowed = f"0 <= START < STOP, and COUNT a whole number from 2 to {MOST_SPEEDS}"
        raise InputError("--speeds", span or (start, stop, steps), allowed)
    with console.stage("campbell"):
        found = campbell(scene, factor * np.linspace(start, stop, int(steps)), count, console.comm)
    in_hertz = scene.in_hertz or scene.in_rpm
    table, picture = found.table(), folder / "campbell.png"
    kinds = [f"{'frequency' if in_hertz else 'omega'}_{kind}" for kind in found.kinds]
    shown = found.table("rpm" if scene.in_rpm else "speed", "mode", *kinds)

    def draw() -> None:
        from fenics_crack.draw.plot_campbell import draw_campbell  # matplotlib

        orders = {*range(1, 9), scene.excitation.order or 1}
        draw_campbell(found, sorted(orders), path=picture, in_hertz=in_hertz, in_rpm=scene.in_rpm)
        table.save(folder / "campbell.csv")
        table.save(folder / "campbell.json")

    on_root(console.comm, draw)
    console.table(shown if console.form == "text" else table)
    for order in [scene.excitation.order] if scene.excitation.order else range(1, 9):
        for mode, speed in found.crossings(order):
            words = f"{speed:.5g} rad/s = {speed / RPM:.5g} rpm"
            console.note(f"engine order {order} meets mode {mode:.0f} at {words}")
    console.note(f"{folder / 'campbell.csv'}, .json, .png")
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
        console.warn(f"not converged: {found.status}{judgements.of_modes(scene, found.report)}")
        return Exit.NOT_CONVERGED
    missed = judgements.of_tolerance(scene, found)
    console.warnings(missed or judgements.of_error(scene, found.report, found.harmonics))
    console.warnings(judgements.of_stability(scene, run, found.stability))
    if found.stability is None and run.structure.n_pairs:
        console.note(
            "the stability is not judged, as that would take long: it is for a reduced structure, "
            "with contact.law = 'unilateral' for lips without mass (reduction.method)"
        )
    return Exit.NOT_CONVERGED if missed else Exit.DONE


def curve(scene: Scene, folder: Path, console: Console) -> Exit:
    """Response curve, through its folds."""
    with console.stage("curve"):
        run = follow_curve(scene, console.comm, progress=console.progress)
    found = run.result
    table, points = tables.special_points(run), tables.curve_points(run)
    shown, hidden = tables.few_special_points(run, table)
    _finish(run, folder, "curve", console, table, points, shown)
    if hidden and console.form == "text":
        what = "more bifurcations and changes of stability"
        console.note(f"{hidden} {what}: {folder / 'curve.json'}")
    console.note(remark_on(run.structure, highest_omega(scene, "curve")))
    if scene.harmonic_balance.tolerance is not None and run.structure.n_pairs:
        console.note(f"harmonics, by the truncation error: {ranging(found.harmonics)}")
    console.warnings(judgements.of_curve(run))
    return Exit.DONE if found.complete else Exit.NOT_CONVERGED


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
    run: Run,
    folder: Path,
    name: str,
    console: Console,
    table: Table,
    rows: Table | None = None,
    shown: Table | None = None,
) -> None:
    """Write a result and print its table, or as text what is ``shown`` of it; save it together if
    its structure is spread over the ranks."""
    path = folder / f"{name}.h5"
    watched = run.motion()
    if run.structure.comm.size > 1 and isinstance(run.result, PeriodicSolution | Modes):
        save(run.result, path, run.scene, watched=watched)
    else:
        on_root(console.comm, lambda: save(run.result, path, run.scene, watched=watched))
    printed = table
    if console.form == "text" and not isinstance(run.result, Modes):
        default = tables.SHORT_CURVE if isinstance(run.result, ResponseCurve) else SHORT
        printed = tables.in_short(shown or table, run.scene, default)
    console.finish(folder, name, printed, rows or table, table)
    console.note(tables.remark_on_points(run.watched))


def sweep(scene: Scene, folder: Path, console: Console) -> Exit:
    """All cases of a sweep, or those that an earlier run has left."""
    from fenics_crack.sweep.result import run_sweep

    with console.timed("sweep"):
        found = run_sweep(scene, folder / "sweep.h5", console.comm, progress=console.progress)
    table = found.table()
    shown, how = table, ""
    if console.form == "text":
        shown, how = tables.few_cases(found)
    console.finish(folder, "sweep", shown, table, table)
    counts = {"converged": int(found.converged.sum()), "failed": len(found.failed)}
    counts["pending"] = found.converged.size - sum(counts.values())
    console.note(remark_on_sweep(scene, console.comm))
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    console.note(f"cases: {told}{how}")
    console.warnings(judgements.of_cases(found))
    return Exit.NOT_CONVERGED if found.failed or not found.complete else Exit.DONE


def identification(
    scene: Scene,
    measured: Measurements | None,
    arrivals: ArrivalTimes | Path | None,
    folder: Path,
    console: Console,
) -> Exit:
    """A crack from measurements: what it is, how sure, and where to measure next."""
    from fenics_crack.identification.identify import identify  # SciPy's optimize and interpolate

    rows = _measurements(scene, measured, arrivals, console)
    with console.timed("identification"):
        found = identify(scene, rows, folder=folder, comm=console.comm, progress=console.progress)
    worth = found.where_to_measure()

    def write() -> None:
        from fenics_crack.draw.plot_posterior import draw_posterior  # matplotlib

        found.save(folder)
        worth.to_csv(folder / "where_to_measure.csv")
        found.fit_table().save(folder / "fit.csv")
        if len(found.unknown) > 1:
            draw_posterior(found, *found.unknown[:2], path=folder / "posterior.png")

    on_root(console.comm, write)
    console.table(found.table())
    ratio = found.log_bayes_factor
    told = "" if np.isnan(ratio) else f": log Bayes factor {ratio:.3g}, crack over no crack"
    console.note(f"{found.verdict}{told}")
    for remark in found.remarks:
        console.note(f"remark: {remark}")
    console.note(f"next to measure: {worth}")
    console.note(f"{folder / 'identify.h5'}, .json; posterior.png, fit.csv, where_to_measure.csv")
    console.warnings(found.warnings)
    return Exit.DONE


def _measurements(
    scene: Scene,
    measured: Measurements | None,
    arrivals: ArrivalTimes | Path | None,
    console: Console,
) -> Measurements:
    """What was measured, what probes have seen, or both."""
    from fenics_crack.identification.measurements import Measurements
    from fenics_crack.study.timing import arrivals_of, engine_order

    parts = [] if measured is None else [measured]
    if arrivals is not None:
        (times, _), table = arrivals_of(scene, arrivals, console.comm), scene.given("tip_timing")
        tip, against = [*scene.point_names, ""][0], table.tangential < 0.0
        order = engine_order(table, scene)
        parts.append(Measurements.from_arrivals(times, order, tip, against=against))
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]


def verification(scene: Scene, folder: Path, console: Console) -> Exit:
    """What mesh, modes, harmonics and samples contribute to the error of the steady vibration."""
    from fenics_crack.study.verification import verify

    with console.stage("verification"):
        found = verify(scene, console.comm)
    table = found.table()

    def write() -> None:
        from fenics_crack.draw.plot_verification import draw_verification  # matplotlib

        table.save(folder / "verify.csv")
        table.save(folder / "verify.json")
        draw_verification(found, path=folder / "verify.png")

    on_root(console.comm, write)
    console.table(found.totals() if console.form == "text" else table)
    for sentence in found.statement[: -len(found.warnings) or None]:
        console.note(sentence)
    console.note(f"{folder / 'verify.csv'}, .json, .png")
    console.warnings(found.warnings)
    return Exit.NOT_CONVERGED if found.failures else Exit.DONE


def plot(
    results: list[Path], labels: list[str], folder: Path, console: Console, *, show: bool
) -> Exit:
    """Pictures of a result, of several in one, or of a scene's mesh; by rank 0."""

    def draw() -> list[Path]:
        first = results[0]
        drawn = "several results" if len(results) > 1 else first.suffix.lower().lstrip(".")
        if show and (drawn != "h5" or kind_of(first) != PeriodicSolution.KIND):
            raise InputError("--show", str(first), "used with one periodic solution")
        if len(results) > 1 or labels:
            from fenics_crack.cli.overlay import draw_overlay

            return draw_overlay(results, labels, folder)
        if drawn == "toml":
            from fenics_crack.cli.pictures import draw_scene

            return draw_scene(Scene.load(first), folder)
        if kind_of(first) == SWEEP:
            from fenics_crack.cli.sweep_pictures import draw_sweep
            from fenics_crack.sweep.result import SweepResult

            return draw_sweep(SweepResult.load(first), folder)
        run = load_run(first, MPI.COMM_SELF)
        meshed = run.structure.whole.nodes is not None
        if not meshed and isinstance(run.result, Modes | PeriodicSolution):
            console.note("no mesh: what would be drawn on one is left out")
        from fenics_crack.cli.pictures import draw_run

        return draw_run(run, folder, show=show)

    with console.stage("pictures"):
        files = on_root(console.comm, draw)
    for file in files:
        console.note(str(file))
    return Exit.DONE


def report(results: list[Path], target: Path | None, console: Console, words: list[str]) -> Exit:
    """One page of HTML with all of some results; by rank 0."""
    page = target or results[0].parent / "report.html"

    def write() -> None:
        from fenics_crack.cli.report import write_report  # VTK and matplotlib

        write_report(results, page, ["fenics-crack", *words])

    with console.stage("report"):
        on_root(console.comm, write)
    console.note(str(page))
    return Exit.DONE
