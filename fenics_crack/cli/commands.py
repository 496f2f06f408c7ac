"""The commands that solve a scene: each computes, writes its files and reports."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fenics_crack.basics.errors import FEW_MODES, INTERRUPTED, Exit, InputError, StoppedError
from fenics_crack.basics.ranks import on_root, uninterrupted
from fenics_crack.basics.tables import RPM, TURN, Table, counted, quantity, speed_in_words
from fenics_crack.cli.account import Account, account_of_sweep
from fenics_crack.cli.given import Console, Inputs, command, keep_before
from fenics_crack.cli.results import account_of, priors_in_words
from fenics_crack.cli.scenes import without_curve
from fenics_crack.study import run as runs
from fenics_crack.study.plausibility import coriolis_in_words, remarks_on_scene
from fenics_crack.study.run import Run

if TYPE_CHECKING:
    from fenics_crack.monitoring.identification.measurements import Measurements
    from fenics_crack.monitoring.tip_timing.arrival_times import ArrivalTimes
    from fenics_crack.scene.scene import Scene
    from fenics_crack.study.bladed_disk import Amplification

RUNS: dict[str, tuple[str, Callable[..., Run]]] = {
    "modes": ("modes", runs.modes),
    "solve": ("solution", runs.solve),
    "curve": ("curve", runs.curve),
    "integrate": ("integration", runs.integrate),
}
"""Commands that make a run: their result, and the name of its files."""


def solved(given: Namespace, inputs: Inputs, console: Console) -> Exit:
    """``modes``, ``solve``, ``curve``, ``integrate``: a run, a file of its result, its account."""
    name, compute = RUNS[given.command]
    own = {"count": given.count} if given.command == "modes" else {}
    if given.command in ("curve", "integrate"):
        own = {"progress": console.progress}
    if given.command == "curve" and inputs.scene.curve is None:
        raise without_curve(inputs.scene, console)
    with console.stage(name):
        run = compute(inputs.scene, comm=console.comm, **own)
    folder, account = inputs.folder, None
    stopped = name == "curve" and run.result.status == INTERRUPTED
    try:
        with console.stage("errors"):
            if not stopped:
                run = replace(run, stated=run.errors)
            account = account_of(run)
    except KeyboardInterrupt:
        stopped = True
    with uninterrupted():
        if stopped and on_root(console.comm, (folder / f"{name}.h5").exists):
            console.note(
                f"{folder / name}.* is unchanged: the interrupted result has a name of its own"
            )
            name = f"{name}_interrupted"  # a part takes the place of no result
        if account is None:
            run.save(folder / f"{name}.h5")
            raise StoppedError(f"stopped; {folder / name}.h5 has the result so far")
        return tell(replace(account, name=name), folder, console, save=run.save)


modes = solve = curve = integrate = solved


def tell(
    account: Account,
    folder: Path,
    console: Console,
    draw: Callable[..., Any] | None = None,
    save: Callable[[Path], None] | None = None,
) -> Exit:
    """Write the file of a result by ``save(path)``, the tables of its account, and its picture by
    ``draw(path=...)``; print what there is to say. Returns how that ended."""
    path, replaced = folder / account.name, ""
    if account.name != "sweep":  # whose file is of one scene
        text = account.summary.formatted("json")
        replaced = keep_before(Path(f"{path}.json"), text, console.comm)
    if save:
        save(Path(f"{path}.h5"))

    def write() -> None:
        account.summary.save(f"{path}.json")
        (account.rows or account.summary).save(f"{path}.csv")
        if draw:
            draw(path=Path(f"{path}.{console.pictures}"))

    on_root(console.comm, write)
    shown = account.shown if console.form == "text" else None
    console.table(shown or account.summary)
    h5 = f"{path}.h5"
    drawn = f"{f'{h5}, ' if Path(h5).exists() else path}.csv, .json, .{console.pictures}"
    console.note(drawn if draw else f"{h5}, .csv, .json; pictures: {command('plot', h5)}")
    console.note(replaced)
    if account.run is not None:
        away = {w.name.partition(".")[0]: w.distance for w in account.run.watched if w.distance > 0}
        places = [f"{name} {quantity(distance, 'm')}" for name, distance in away.items()]
        note = f"watched at the nearest node, at a distance of: {', '.join(places)}"
        note += "; not part of the stated errors" if account.run.stated is not None else ""
        console.note(note if places else "")
    console.note(*account.notes)
    console.remark(*account.remarks)
    console.warn(*account.warnings)
    console.note(account.closing)
    return account.exit


def sweep(_: Namespace, inputs: Inputs, console: Console) -> Exit:
    """All cases of a sweep, or those that an earlier run has left."""
    from fenics_crack.sweep.result import run_sweep

    scene, folder = inputs.scene, inputs.folder
    with console.stage("sweep", bars=True):
        found = run_sweep(scene, folder / "sweep.h5", console.comm, progress=console.progress)
    return tell(account_of_sweep(found), folder, console)


def grow(_: Namespace, inputs: Inputs, console: Console) -> Exit:
    """The crack's growth: lengths that an earlier run has left, and the cycles between all."""
    from fenics_crack.draw.plot_study import draw_growth
    from fenics_crack.fatigue import growth

    scene, folder = inputs.scene, inputs.folder
    with console.stage("growth", bars=True):
        found = growth.grow(scene, folder, console.comm, progress=console.progress)
    draw = partial(draw_growth, found, in_hertz=scene.in_hertz)
    return tell(account_of(found), folder, console, draw, partial(found.save, comm=console.comm))


def campbell(given: Namespace, inputs: Inputs, console: Console) -> Exit:
    """Natural frequencies over the speed, and where engine orders meet the first breathing one."""
    from fenics_crack.draw.plot_study import draw_campbell
    from fenics_crack.study import campbell as diagrams

    scene, span = inputs.scene, given.speeds
    factor, unit = (RPM, "rpm") if scene.in_rpm else (1.0, "rad/s")
    start, stop, steps = span or (0.0, 1.5 * scene.speed / factor, 13)
    with console.stage("campbell"):
        speeds = factor * np.linspace(start, stop, int(steps))
        found = diagrams.campbell(scene, speeds, given.count, console.comm, few=FEW_MODES)
    in_hertz, own = scene.in_hertz or scene.in_rpm, scene.excitation.order

    kinds = [f"{'frequency' if in_hertz else 'omega'}_{kind}" for kind in found.kinds]
    asked = [own] if own else [*range(1, 9)]
    notes = [text for order in asked for text in found.meetings(order)]
    if not notes:
        of_orders = f"engine order {own} meets none" if own else "engine orders 1 to 8 meet none"
        what = counted(found.omega_open.shape[1], "mode")
        notes = [f"{of_orders} of {what} between {start:g} and {stop:g} {unit}"]
    if text := coriolis_in_words(found.coriolis):
        notes.append(f"remark: at {stop:g} {unit} {text}")
    crack = ["crack"] if found.cracked else []
    shown = found.table("rpm" if scene.in_rpm else "speed", "mode", *kinds, *crack)
    remarks = remarks_on_scene(scene)
    account = Account("campbell", found.table(), shown=shown, notes=notes, remarks=remarks)
    orders = sorted({*range(1, 9), own or 1})
    draw = partial(draw_campbell, found, orders, in_hertz=in_hertz, in_rpm=scene.in_rpm)
    return tell(account, inputs.folder, console, draw)


def disk(given: Namespace, inputs: Inputs, console: Console) -> Exit:
    """Frequencies over the nodal diameter, and amplification by patterns of mistuning."""
    from fenics_crack.draw.plot_disk import draw_amplification, draw_nodal_diameters
    from fenics_crack.study.bladed_disk import amplification, nodal_diameters

    scene, comm = inputs.scene, console.comm
    with console.stage("nodal diameters"):
        found = nodal_diameters(scene, comm)
    omega = found.omega[found.excited] / TURN
    hertz = ", ".join(f"{one:.6g}" for one in omega)
    excited = f"engine order {found.order} excites nodal diameter {found.excited}: {hertz} Hz"
    left = "without the Coriolis force" if found.speed > 0.0 else ""
    account = Account("disk", found.table(), notes=[excited, left], remarks=remarks_on_scene(scene))
    ended = tell(account, inputs.folder, console, partial(draw_nodal_diameters, found))
    if not given.patterns:
        return ended
    with console.stage("patterns of mistuning"):
        many = amplification(scene, given.patterns, given.deviation, comm=comm)
    shares = ", ".join(f"{many.percentile(p):.4g} ({p:g} %)" for p in (50.0, 95.0, 99.0))
    notes = [
        f"amplification factors that a share of the patterns does not exceed: {shares}",
        f"the largest: {many.factor.max():.4g}; Whitehead's bound: {many.bound:.4g}",
        f"the tuned wheel without a crack: {quantity(many.tuned, 'm')} at "
        f"{many.tuned_omega / TURN:.6g} Hz",
    ]
    account = Account("amplification", many.table(), shown=_percentiles(many), notes=notes)
    return tell(account, inputs.folder, console, partial(draw_amplification, many))


def _percentiles(found: Amplification) -> Table:
    """Amplification factors by shares of the patterns."""
    shares = (5.0, 25.0, 50.0, 75.0, 95.0, 99.0, 100.0)
    rows = [[share, found.percentile(share)] for share in shares]
    return Table(["share of patterns [%]", "amplification factor"], rows)


def verify(_: Namespace, inputs: Inputs, console: Console) -> Exit:
    """Contributions of mesh, modes, harmonics and samples to the error of the steady vibration."""
    from fenics_crack.draw.plot_study import draw_verification
    from fenics_crack.study import refinement

    with console.stage("verification"):
        found = refinement.verify(inputs.scene, console.comm)
    draw, save = partial(draw_verification, found), partial(found.save, comm=console.comm)
    return tell(account_of(found), inputs.folder, console, draw, save)


def _measured_by(
    source: ArrivalTimes | Path, scene: Scene, console: Console, *, before: bool = False
) -> Measurements:
    """Return the measurements that follow from arrivals: displacements, or in a run-up the natural
    frequencies whose resonances are passed, with ``before`` of the blade before it had a crack."""
    from fenics_crack.monitoring.identification.measurements import Measurements, without_crack
    from fenics_crack.monitoring.tip_timing import scene_timing as timing
    from fenics_crack.monitoring.tip_timing.arrival_times import STEADY

    times, run = timing.arrivals_of(scene, source, console.comm)
    key = "--before" if before else "arrivals"
    if timing.is_run_up(times, run):
        with console.stage("resonances"):
            blade = scene.replace(without_crack(scene) or {}) if before else scene
            found = timing.modes_passed(blade, times)
        console.note(*(timing.passed_in_words(*one) for one in found))
        fits, modes, _ = zip(*found, strict=True) if found else ((), (), ())
        if not any(modes):
            allowed = "of a constant speed, or a run-up through a resonance of the blade"
            raise InputError(key, repr(times), allowed)
        quantity = "frequency_uncracked" if before else "frequency_resonance"
        return Measurements.from_passages(fits, modes, quantity=quantity)
    if before:
        raise InputError(key, repr(times), "those of a run-up, or frequency responses")
    held = scene.speed > 0.0 and scene.excitation.order is None
    if held and abs(times.mean_speed / scene.speed - 1.0) > STEADY:
        seen, own = (speed_in_words(v, scene.in_rpm) for v in (times.mean_speed, scene.speed))
        allowed = f"at {own}, the speed of [rotation], unless the load is an excitation.order"
        raise InputError(key, seen, allowed)
    order = timing.engine_order(scene.given("tip_timing"), scene)
    tip, against = timing.probed_displacement(scene)
    return Measurements.from_arrivals(times, order, tip, against=against)


def identify(given: Namespace, inputs: Inputs, console: Console) -> Exit:
    """A crack from measurements: what it is, how sure, and where to measure next."""
    from fenics_crack.draw.plot_study import draw_posterior  # Matplotlib
    from fenics_crack.monitoring.identification import (
        identify as search,  # SciPy's optimize, interpolate
    )

    scene, folder = inputs.scene, inputs.folder
    parts = [] if inputs.measurements is None else [inputs.measurements]
    assert not isinstance(inputs.arrivals, dict) and not isinstance(inputs.before, dict)
    if inputs.arrivals is not None:
        parts.append(_measured_by(inputs.arrivals, scene, console))
    if inputs.before is not None:
        parts.append(_measured_by(inputs.before, scene, console, before=True))
    rows = sum(parts[1:], parts[0])
    with console.stage("identification", bars=True):
        how = {"comm": console.comm, "progress": console.progress}
        found = search.identify(scene, rows, folder=folder, **how)
    worth = found.where_to_measure()

    def write() -> None:
        found.save(folder)
        worth.to_csv(folder / "where_to_measure.csv")
        found.fit_table().save(folder / "fit.csv")
        for kind in {"png", console.pictures}:  # a report takes the first
            draw_posterior(found, path=folder / f"posterior.{kind}")

    fit, others = found.fit_table().formatted("csv"), ("identify", "posterior", "where_to_measure")
    replaced = keep_before(folder / "fit.csv", fit, console.comm, *others)
    on_root(console.comm, write)
    console.table(found.table())
    console.note(f"{found.conclusion}: {found.reason}")
    console.note(priors_in_words(found.priors))
    console.remark(*found.remarks, *remarks_on_scene(scene))
    console.note(*(f"next to measure: {advice}" for advice in found.advice))
    names = f"posterior.{console.pictures}, fit.csv, where_to_measure.csv"
    console.note(f"{folder / 'identify.h5'}, .json; {names}")
    console.note(replaced)
    console.warn(*found.warnings)
    return Exit.NOT_CONVERGED if found.doubts else Exit.DONE
