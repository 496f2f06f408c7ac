"""The commands of ``fenics-crack``: what each says, and which files it writes."""

from __future__ import annotations

import dataclasses
import itertools
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.harmonic_balance import check_memory
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli.pictures import draw_run, draw_sweep
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw.plot import PARAMETERS
from fenics_crack.errors import InputError
from fenics_crack.fem.assembly import build_structure
from fenics_crack.files.results import save
from fenics_crack.files.store import kind_of, make_folder
from fenics_crack.model.contact import UnilateralConstraint
from fenics_crack.model.modes import Modes
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import gather_rows, on_root
from fenics_crack.scene.scene import Integration, Scene
from fenics_crack.study.prepare import law_of, reduction_of, with_crack_length
from fenics_crack.study.run import (
    Run,
    find_modes,
    follow_curve,
    integrate,
    load_run,
    solve,
)
from fenics_crack.sweep.file import KIND as SWEEP
from fenics_crack.sweep.plan import Plan
from fenics_crack.sweep.result import SweepResult, run_sweep
from fenics_crack.table import Table
from fenics_crack.time.march import TimeHistory

__all__ = [
    "DONE",
    "NOT_CONVERGED",
    "Console",
    "check",
    "curve",
    "integration",
    "make_writable",
    "modes",
    "new",
    "plot",
    "solution",
    "sweep",
]

DONE, NOT_CONVERGED = 0, 3
"""Exit codes."""
IN_SHORT = ("state", "response [m]", "opening [m]", "multiplier", "verdict", "truncation_error")
"""Columns of a sweep that are shown as text, beside the swept values."""
UNDECIDED = "; more harmonics may decide it, or damping of all modes (damping.modes = 'all')"
SHARE = "of the lips' motion"
MOST_CHECKED = 10_000
"""Cases of a sweep that are looked at before it is run."""
SHOWN_FAILURES = 10
"""Of a sweep; all are in its table."""


@dataclass(frozen=True)
class Console:
    """Where a command speaks: its table on standard output, remarks on standard error."""

    form: str = "text"
    quiet: bool = False
    verbose: bool = False

    @property
    def progress(self) -> bool:
        """Whether long work shows a bar."""
        return not self.quiet and (self.verbose or sys.stderr.isatty())

    def table(self, table: Table) -> None:
        """Print a table."""
        print(table.formatted(self.form), end="", flush=True)

    def note(self, text: str) -> None:
        """Say something, unless it is to be quiet."""
        if not self.quiet:
            print(text, file=sys.stderr, flush=True)

    def warn(self, text: str) -> None:
        """Say something that must not be missed."""
        print(f"fenics-crack: warning: {text}", file=sys.stderr, flush=True)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Say how long a part took, if it is to be verbose."""
        started = time.perf_counter()
        yield
        if self.verbose:
            print(f"{name}: {time.perf_counter() - started:.2f} s", file=sys.stderr, flush=True)


def make_writable(folder: Path, comm: MPI.Comm) -> None:
    """Make a folder for results; InputError unless a file can be written there."""

    def work() -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            allowed = f"a folder that can be written ({error.strerror})"
            raise InputError("--output", str(folder), allowed) from None

    on_root(comm, work)


# --- scenes ---------------------------------------------------------------------------------------


def new(path: Path, console: Console, comm: MPI.Comm) -> int:
    """Write a commented scene to start from."""

    def write() -> None:
        text = resources.files("fenics_crack.cli").joinpath("new_scene.toml").read_text("utf-8")
        try:
            make_folder(path)
            with open(path, "x", encoding="utf-8") as file:
                file.write(text.replace("SCENE", path.name))
        except FileExistsError:
            raise InputError("scene", str(path), "a new file; there is one already") from None
        except OSError as error:
            allowed = f"a file that can be written ({error.strerror})"
            raise InputError("scene", str(path), allowed) from None

    on_root(comm, write)
    console.note(f"{path}: a scene to start from; now: fenics-crack check {path}")
    return DONE


def check(scene: Scene, console: Console, comm: MPI.Comm) -> int:
    """Mesh and assemble, solve nothing, and say what there is."""
    found = with_crack_length(scene, comm)
    whole = build_structure(found, comm)
    balance = scene.harmonic_balance
    check_memory(whole, balance.harmonics)
    assert whole.nodes is not None
    points = gather_rows(comm, whole.nodes.points)
    rows: list[tuple[str, object]] = [
        ("width x height [m]", "{:g} x {:g}".format(*np.ptp(points, axis=0))),
        ("degrees of freedom", whole.n_dofs),
    ]
    law = law_of(scene, whole)
    if law is not None:
        rows.append(("contact law", scene.contact.law))  # type: ignore[union-attr]
    if law is not None and not isinstance(law, UnilateralConstraint):
        stiffness = np.broadcast_to(law.stiffness, whole.n_pairs)
        rows.append(("softest pair [N/m]", float(stiffness.min())))
        rows.append(("stiffest pair [N/m]", float(stiffness.max())))
    if found.crack is not None and found.crack.length is not None:
        rows.append(("crack length [m]", found.crack.length))
    rows += [
        ("contact pairs", whole.n_pairs),
        ("harmonics", balance.harmonics),
        ("unknowns of harmonic balance", (2 * balance.harmonics + 1) * whole.n_pairs),
        ("solved", _how_solved(scene, whole)),
    ]
    if scene.curve is not None:
        span = f"{scene.curve.parameter} from {scene.curve.start:g} to {scene.curve.stop:g}"
        rows.append(("curve", span))
    if scene.sweep is not None:
        axes = " x ".join(f"{len(axis.values)} {axis.key}" for axis in scene.sweep.over)
        rows += [("sweep", axes), ("cases of the sweep", scene.sweep.n_cases)]
        rows.append(("of them impossible", on_root(comm, lambda: _impossible(scene))))
    console.table(Table(("what", "value"), rows))
    return DONE


def _impossible(scene: Scene) -> str:
    """How many cases of a sweep are no scenes, and why the first one is not."""
    plan = Plan(scene)
    places = itertools.islice(np.ndindex(*plan.shape), MOST_CHECKED)
    reasons = [case for case in map(plan.case, places) if isinstance(case, str)]
    more = f" of the first {MOST_CHECKED}" if np.prod(plan.shape) > MOST_CHECKED else ""
    return f"{len(reasons)}{more}" + (f": {reasons[0]}" if reasons else "")


def _how_solved(scene: Scene, whole: Structure) -> str:
    table = reduction_of(scene, whole)
    if table is None:
        return "as it is"
    return f"reduced, {table.method}, {table.modes or scene.damping.modes} modes"


# --- results --------------------------------------------------------------------------------------


def modes(scene: Scene, count: int, folder: Path, console: Console, comm: MPI.Comm) -> int:
    """Natural frequencies and mode shapes with the crack open."""
    with console.stage("modes"):
        run = find_modes(scene, count, comm)
    assert isinstance(run.result, Modes)
    save(run.result, folder / "modes.h5", run.scene)
    rows = [(n, w, w / (2.0 * np.pi)) for n, w in enumerate(run.result.omega, 1)]
    table = Table(("mode", "omega [rad/s]", "frequency [Hz]"), rows)
    return _finish(folder, "modes", table, table, console, comm)


def solution(scene: Scene, folder: Path, console: Console, comm: MPI.Comm) -> int:
    """Steady vibration at one frequency."""
    with console.stage("solution"):
        run = solve(scene, comm)
    found = run.result
    assert isinstance(found, PeriodicSolution)
    _save(found, folder / "solution.h5", run, comm)
    table = Table(("quantity", "value", "unit"), _quantities(run, found))
    time_ = np.linspace(0.0, found.period, 401)
    waves = [time_, found.displacement(time_, [run.watched_dof])[:, 0]]
    columns = ["time [s]", f"{run.watched_name} [m]"]
    if found.gap_coefficients.size:
        waves += [found.gap(time_)[:, 0], found.contact_force(time_).sum(axis=1)]
        columns += ["closing at the mouth [m]", "contact force, all pairs [N]"]
    code = _finish(
        folder, "solution", table, Table(columns, np.column_stack(waves).tolist()), console, comm
    )
    if not found.converged:
        console.warn(f"not converged: {found.status}")
        return NOT_CONVERGED
    if not found.report.total <= LARGE_ERROR:
        console.warn(
            f"the estimated error is {found.report.total:.2g} of the gap: more harmonics "
            "(harmonic_balance.harmonics) or more modes (reduction.modes) are needed"
        )
    if found.stability is not None and found.stability.verdict != "stable":
        console.warn(
            f"the orbit is {found.stability.verdict}: it may not be what is seen in time"
            + (UNDECIDED if found.stability.verdict == "undecided" else "")
        )
    return code


def _quantities(run: Run, found: PeriodicSolution) -> list[tuple[str, object, str]]:
    """The solution in numbers."""
    time_ = np.linspace(0.0, found.period, 1024, endpoint=False)
    motion = found.displacement(time_, [run.watched_dof])
    rows: list[tuple[str, object, str]] = [
        ("omega", found.omega, "rad/s"),
        ("frequency", found.omega / (2.0 * np.pi), "Hz"),
        *_extremes(run, motion, found.gap(time_)),
    ]
    if found.gap_coefficients.size:
        force = found.contact_force(time_)
        rows += [
            ("largest contact force of a pair", float(force.max()), "N"),
            ("share of the period closed, mean over pairs", float((force > 0.0).mean()), "-"),
        ]
    if found.stability is not None:
        rows += [
            ("verdict", found.stability.verdict, "-"),
            ("largest multiplier", float(np.abs(found.stability.multipliers[0])), "-"),
        ]
    rows += [("converged", found.converged, "-"), ("iterations", found.iterations, "-")]
    if found.gap_coefficients.size:
        errors = dataclasses.asdict(found.report)
        penetration = errors.pop("penetration")
        rows += [(f"estimated error: {name}", value, SHARE) for name, value in errors.items()]
        rows += [
            ("estimated error: total", found.report.total, SHARE),
            ("penetration", penetration, SHARE),
        ]
    return rows


def _extremes(run: Run, motion: np.ndarray, gap: np.ndarray) -> list[tuple[str, float, str]]:
    """How far the load's dof moves, and of the pairs, if there are any, how far they do."""
    rows = [(f"half peak-to-peak, {run.watched_name}", float(np.ptp(motion) / 2.0), "m")]
    if gap.size:
        rows.append(("largest opening", float(-gap.min()), "m"))
        rows.append(("largest penetration", float(max(gap.max(), 0.0)), "m"))
    return rows


def curve(scene: Scene, folder: Path, console: Console, comm: MPI.Comm) -> int:
    """Response curve, through its folds."""
    with console.stage("curve"):
        run = follow_curve(scene, comm, progress=console.progress)
    found = run.result
    assert isinstance(found, ResponseCurve)
    _save(found, folder / "curve.h5", run, comm)
    amplitude = found.amplitude(run.watched_dof)
    columns = [PARAMETERS[found.parameter], f"{run.watched_name} [m]"]
    values = [found.values, amplitude, found.iterations]
    columns.append("iterations")
    if found.multipliers is not None:
        values.append(np.abs(found.multipliers))
        columns.append("largest multiplier")
    points = Table(columns, list(zip(*[v.tolist() for v in values], strict=True)))
    peak = int(np.argmax(amplitude))
    rows = [
        ("start", found.values[0], amplitude[0]),
        ("end", found.values[-1], amplitude[-1]),
        ("largest", found.values[peak], amplitude[peak]),
    ]
    for point in found.bifurcations:
        time_ = np.linspace(0.0, point.solution.period, 257)
        motion = point.solution.displacement(time_, [run.watched_dof])
        rows.append((point.kind.replace("_", " "), point.value, np.ptp(motion) / 2.0))
    changes: list[int] = []
    if found.multipliers is not None:
        changes = [int(index) for index in np.flatnonzero(np.diff(found.stable))]
    for index in changes:
        what = "stability lost after" if found.stable[index] else "stability gained after"
        rows.append((what, found.values[index], amplitude[index]))
    special = Table(("point", columns[0], f"half peak-to-peak, {columns[1]}"), rows)
    code = _finish(folder, "curve", special, points, console, comm)
    looked_at = {peak, *np.linspace(0, len(found) - 1, 8).astype(int).tolist()}
    errors = {index: found.solution(index).report.total for index in sorted(looked_at)}
    worst = max(errors, key=errors.__getitem__)
    console.note(f"estimated error at {len(errors)} of the points: at most {errors[worst]:.2g}")
    if not errors[worst] <= LARGE_ERROR:
        console.warn(
            f"the estimated error is {errors[worst]:.2g} at {found.values[worst]:g}: more "
            "harmonics (harmonic_balance.harmonics) or modes (reduction.modes) are needed there"
        )
    special_values = [point.value for point in found.bifurcations]
    for index in changes:
        low, high = sorted(found.values[index : index + 2])
        if not any(low <= value <= high for value in special_values):
            console.warn(
                f"stability changes between {low:g} and {high:g} without a bifurcation of the "
                "balanced equations: they need more harmonics (harmonic_balance.harmonics) there"
            )
    if not found.complete:
        console.warn(f"the curve ended early: {found.status}")
        return NOT_CONVERGED
    return code


def integration(scene: Scene, folder: Path, console: Console, comm: MPI.Comm) -> int:
    """Motion in time, from rest until it repeats."""
    with console.stage("integration"):
        run = integrate(scene, comm, progress=console.progress)
    found = run.result
    assert isinstance(found, TimeHistory)
    _save(found, folder / "integration.h5", run, comm)
    motion = found.displacement([run.watched_dof])[:, 0]
    rows = [
        ("periods", found.periods, "-"),
        ("steps in a period", found.steps_per_period, "-"),
        ("change over the last period", found.settled, "-"),
        ("energy created", found.created_energy, "-"),
        *_extremes(run, motion, found.gap),
    ]
    table = Table(("quantity", "value", "unit"), rows)
    waves = np.column_stack([found.time, motion, found.gap[:, 0], found.contact_force.sum(axis=1)])
    columns = (
        "time [s]", f"{run.watched_name} [m]", "closing at the mouth [m]",
        "contact force, all pairs [N]",
    )  # fmt: skip
    code = _finish(folder, "integration", table, Table(columns, waves.tolist()), console, comm)
    asked = run.scene.integration or Integration()
    if not found.settled <= asked.settle:
        console.warn(
            f"the motion has not settled after {found.periods} of {asked.periods} periods: "
            f"a period changes it by {found.settled:.2g}{_longer_period(found)}"
        )
        return NOT_CONVERGED
    return code


def _longer_period(found: TimeHistory) -> str:
    """A hint where the motion repeats after two or three load periods."""
    waves = found.by_period(found.gap)
    for count in range(2, len(waves)):
        change = np.linalg.norm(waves[-1] - waves[-1 - count]) / np.linalg.norm(waves[-1])
        if change < 0.1 * found.settled:
            return f", {count} periods only by {change:.2g}: its period is {count} times the load's"
    return "; it may need more of them (integration.periods), or be irregular"


def _save(
    found: PeriodicSolution | ResponseCurve | TimeHistory, path: Path, run: Run, comm: MPI.Comm
) -> None:
    """Write a result: together where its structure is spread over the ranks, else on rank 0."""
    if run.structure.comm.size > 1 and isinstance(found, PeriodicSolution):
        save(found, path, run.scene)
    else:
        on_root(comm, lambda: save(found, path, run.scene))


def _finish(
    folder: Path,
    name: str,
    shown: Table,
    stored: Table,
    console: Console,
    comm: MPI.Comm,
    *,
    summary: Table | None = None,
) -> int:
    """Print a table, store it (or another summary) as JSON and one as CSV, and say where."""

    def write() -> None:
        (summary or shown).save(folder / f"{name}.json")
        stored.save(folder / f"{name}.csv")

    on_root(comm, write)
    console.table(shown)
    result = folder / f"{name}.h5"
    console.note(f"{result}, .csv, .json; pictures: fenics-crack plot {result}")
    return DONE


def sweep(scene: Scene, folder: Path, console: Console, comm: MPI.Comm) -> int:
    """All cases of a sweep, or those that an earlier run has left."""
    result = folder / "sweep.h5"
    with console.stage("sweep"):
        found = run_sweep(scene, result, comm, progress=console.progress)
    table = Table(*found.table())
    short = [*range(len(found.axes)), *(table.columns.index(name) for name in IN_SHORT)]
    shown = table.of_columns(short) if console.form == "text" else table
    code = _finish(folder, "sweep", shown, table, console, comm, summary=table)
    counts = {"converged": int(found.converged.sum()), "failed": len(found.failed)}
    counts["pending"] = found.converged.size - sum(counts.values())
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
    return NOT_CONVERGED if found.failed or not found.complete else code


def _draw(result: Path, folder: Path, show: bool) -> list[Path]:
    if kind_of(result) != SWEEP:
        return draw_run(load_run(result, MPI.COMM_SELF), folder, show=show)
    if show:
        raise InputError("--show", "sweep", "used with a periodic solution")
    return draw_sweep(SweepResult.load(result), folder)


def plot(result: Path, folder: Path, show: bool, console: Console, comm: MPI.Comm) -> int:
    """Pictures of a result, and files for ParaView: by rank 0."""
    with console.stage("pictures"):
        files = on_root(comm, lambda: _draw(result, folder, show))
    for file in files:
        console.note(str(file))
    return DONE
