"""The commands that solve a scene: each computes, writes its files and reports."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fenics_crack.basics.atomic_files import remove_file, together
from fenics_crack.basics.errors import FEW_MODES, INTERRUPTED, Exit, InputError, StoppedError
from fenics_crack.basics.ranks import on_root, uninterrupted
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import speed_in_words
from fenics_crack.cli.account import printed
from fenics_crack.cli.drawn import Drawn
from fenics_crack.cli.given import STRUCTURE_FILE, Console, Inputs, command, keep_before
from fenics_crack.cli.kinds import KINDS, draw, report_of
from fenics_crack.runs.run import Run
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.study.sharing import SHELVES

if TYPE_CHECKING:
    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.monitoring.identification.measurements import Measurements
    from fenics_crack.scene.scene import Scene


def compute(
    function: Callable[..., Any], given: Namespace, inputs: Inputs, console: Console
) -> Exit:
    """A command that is a function of the package: call it with the scene and what else it takes of
    the arguments, the folder and the ranks; write and print its result."""
    folder = inputs.folder
    if given.command == "curve" and inputs.scene.curve is None:
        from fenics_crack.cli.scenes import without_curve

        raise without_curve(inputs.scene, console)
    offered = {"comm": console.comm, "progress": console.progress, "few": FEW_MODES}
    offered |= vars(given) | vars(inputs) | {"scene": inputs.prepared or inputs.scene}
    options = {name: offered[name] for name in signature(function).parameters if name in offered}
    with console.stage(given.command, bars="folder" in options):
        result = function(**options)
    name, report = KINDS[result.KIND].name, None
    run = result if isinstance(result, Run) else None
    stopped = run is not None and vars(run.result).get("status") == INTERRUPTED
    try:
        with console.stage("errors"):
            if run is not None and not stopped:
                result = replace(run, stated=run.errors)
            report = report_of(result)
    except KeyboardInterrupt:
        stopped = True
    with uninterrupted():
        if stopped and on_root(console.comm, (folder / f"{name}.h5").exists):
            console.note(
                f"{folder / name}.* is unchanged: the interrupted result has a name of its own"
            )
            name = f"{name}_interrupted"  # a part takes the place of no result
        if report is None:
            _save(result, folder / f"{name}.h5", console)
            raise StoppedError(f"stopped; {folder / name}.h5 has the result so far")
        return tell(report, folder / name, console, result, vars(given).get("pictures"))


def _save(result: Any, path: Path, console: Console) -> None:
    """Write the file of a result; a run is saved by the ranks that share it."""
    result.save(path, **({} if isinstance(result, Run) else {"comm": console.comm}))


def tell(
    report: Report, path: Path, console: Console, result: Any = None, pictures: str | None = None
) -> Exit:
    """Write a result, unless it is there already, the tables of its report, and its pictures if
    their kind is given, under a path without its ending; print what there is to say. Returns how
    that ended."""
    replaced = ""
    for shelf in SHELVES:
        shelf.keep(console.comm)
    if result is not None:
        replaced = keep_before(Path(f"{path}.json"), report.table.formatted("json"), console.comm)
    with together() as files:
        if result is not None:
            _save(result, Path(f"{path}.h5"), console)

        def write() -> None:
            report.table.save(f"{path}.json")
            (report.rows or report.table).save(f"{path}.csv")
            files.close()

        on_root(console.comm, write)
    if pictures:
        on_root(console.comm, lambda: draw(result, Drawn(path.parent, pictures)))
    console.table(printed(report) if console.form == "text" else report.table)
    for heading, further in report.further.items():
        console.note(f"{heading}:\n{further.formatted('text')}".rstrip())
    drawn = f".{pictures}" if pictures else f"pictures: {command('plot', f'{path}.h5')}"
    console.note(f"{path}.h5, .csv, .json{', ' if pictures else '; '}{drawn}", replaced)
    return say(report, console)


def say(report: Report, console: Console) -> Exit:
    """Print the sentences of a report; return how its command ended."""
    console.note(*report.notes)
    console.remark(*report.remarks)
    console.warn(*report.warnings)
    console.note(report.closing)
    return report.exit


def sweep(_: Namespace, inputs: Inputs, console: Console) -> Exit:
    """All cases of a sweep, or those that an earlier run has left."""
    from fenics_crack.sweep.result import run_sweep

    scene, path = inputs.scene, inputs.folder / "sweep"
    with console.stage("sweep", bars=True):
        found = run_sweep(scene, f"{path}.h5", console.comm, progress=console.progress)
    return tell(report_of(found), path, console)


def clean(_: Namespace, inputs: Inputs, console: Console) -> None:
    """Remove the structure that earlier commands have kept."""
    on_root(console.comm, lambda: remove_file(inputs.folder / STRUCTURE_FILE, "--output"))


def reduce(given: Namespace, inputs: Inputs, console: Console) -> None:
    """Write what the mesh of a scene gives to a file."""
    from fenics_crack.study.artefact import save_prepared
    from fenics_crack.study.prepare import prepare

    path = given.output or inputs.folder / f"{given.scene.stem}.h5"
    with console.stage("mesh, modes and statics"):
        save_prepared(prepare(inputs.scene, console.comm, whole=True), path)
    console.note(f"{path}: {inputs.scene!r}; now: {command('solve', path)}")


def disk(given: Namespace, inputs: Inputs, console: Console) -> Exit:
    """Frequencies over the nodal diameter, and amplification by patterns of mistuning."""
    from fenics_crack.disk.bladed_disk import amplification, nodal_diameters

    scene, comm, folder = inputs.scene, console.comm, inputs.folder
    with console.stage("nodal diameters"):
        found = nodal_diameters(scene, comm)
    ended = tell(report_of(found), folder / "disk", console, found, given.pictures)
    if not given.patterns:
        return ended
    with console.stage("patterns of mistuning"):
        many = amplification(scene, given.patterns, given.deviation, comm=comm)
    return tell(report_of(many), folder / "amplification", console, many, given.pictures)


def _measured_by(
    source: dict[int, ArrivalTimes] | Path, scene: Scene, console: Console, *, before: bool = False
) -> Measurements:
    """Return measurements from arrivals: displacements, or in a run-up the natural frequencies
    of the resonances passed, with ``before`` of the blade before it had a crack."""
    from fenics_crack.arrivals.arrival_times import STEADY
    from fenics_crack.monitoring import scene_timing as timing
    from fenics_crack.monitoring.identification.measurements import (
        Measurements,
        list_crack_removal_changes,
    )

    blades, run = timing.arrivals_of_blades(scene, source, console.comm)
    [times] = blades.values()
    console.remark(*([] if run else timing.list_arrival_remarks(times)))
    key = "--before" if before else "arrivals"
    if timing.is_run_up(times, run):
        with console.stage("resonances"):
            blade = scene.replace(list_crack_removal_changes(scene) or {}) if before else scene
            found = timing.find_passed_modes(blade, times)
        console.note(*(timing.describe_passage(*one) for one in found))
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
    order = timing.get_engine_order(scene.given("tip_timing"), scene)
    tip, against = timing.find_probed_displacement(scene)
    return Measurements.from_arrivals(times, order, tip, against=against)


def identify(given: Namespace, inputs: Inputs, console: Console) -> Exit:
    """A crack from measurements: what it is, how sure, and where to measure next."""
    from fenics_crack.draw.plot_study import draw_posterior  # Matplotlib
    from fenics_crack.monitoring.identification import identify as search  # SciPy
    from fenics_crack.monitoring.identification.report import IdentificationOutput

    scene, folder = inputs.scene, inputs.folder
    parts = [] if inputs.measurements is None else [inputs.measurements]
    if inputs.arrivals is not None:
        parts.append(_measured_by(inputs.arrivals, scene, console))
    if inputs.before is not None:
        parts.append(_measured_by(inputs.before, scene, console, before=True))
    how = {"folder": folder, "comm": console.comm, "progress": console.progress}
    with console.stage("identification", bars=True):
        found = search.identify(scene, sum(parts[1:], parts[0]), **how)
    worth = found.where_to_measure()

    def write() -> None:
        with together():
            found.save(folder)
            worth.to_csv(folder / "where_to_measure.csv")
            found.fit_table().save(folder / "fit.csv")
            for kind in {"png", console.pictures}:  # a report takes the first
                draw_posterior(found, path=folder / f"posterior.{kind}")

    fit, others = found.fit_table().formatted("csv"), ("identify", "posterior", "where_to_measure")
    replaced = keep_before(folder / "fit.csv", fit, console.comm, *others)
    on_root(console.comm, write)
    console.table(found.table())
    names = f"posterior.{console.pictures}, fit.csv, where_to_measure.csv"
    console.note(f"{folder / 'identify.h5'}, .json; {names}", replaced)
    report = report_of(IdentificationOutput(scene, found.summary(), folder / "posterior.png"))
    remarks = [*report.remarks, *remarks_on_scene(scene)]
    return say(replace(report, remarks=remarks, done=not found.doubts), console)
